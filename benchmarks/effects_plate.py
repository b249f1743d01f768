"""A plate of known numbers and what may be the matter with it and its sensor, by closed forms and by
integration in fine steps that share no code with the package; what is driven stands in `BENCHES`."""

import cmath
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from sysid import Log

G, TAU, F0, K_T, DEGC = 0.02, 1.669041003e-3, 32300.0, -10.16, 24.0  # um/V, s, Hz, Hz/degC, degC
HALF = 1 / (2 * np.pi * TAU)  # Hz
TOP, NOISE = 2.0, 0.02  # um: of 100 V at the resonance; in each channel
TURN = cmath.exp(0.1j)  # of the demodulator
LEAK = (0.16e-3 - 0.12e-3j) / TURN  # um/V, of the drive into the sensor
FINE = 24  # parts of the time between two rows
WAITED, PART = 400, 8  # tau that a point of a sweep is waited for at the most, and parts of one
STILL = 1e-7  # by which it still moves then


@dataclass(frozen=True, eq=False)
class Bench:
    """What is driven, row by row: `steps` (s, V) from which on, `f` Hz (None: a plant without a resonance),
    `warm` degC above 24."""

    name: str
    time: np.ndarray
    steps: tuple[tuple[float, float], ...] = ((-1.0, 100.0),)
    f: np.ndarray | None = None
    warm: np.ndarray = field(default_factory=lambda: np.zeros(1))
    settled: bool = False
    timed: bool = True

    def volts(self, time: np.ndarray) -> np.ndarray:
        begins, level = np.array([(-np.inf, 0.0), *self.steps]).T
        return level[np.searchsorted(begins, time + 1e-9, side="right") - 1]

    @property
    def place(self) -> np.ndarray:
        """(n,) from -1/2 at the first row to 1/2 at the last."""
        return (self.time - self.time[0]) / np.ptp(self.time) - 0.5

    @property
    def falls(self) -> np.ndarray:
        """(n,) whether the drive was lowered last."""
        levels = np.array([v for _, v in self.steps])
        last = np.searchsorted([t for t, _ in self.steps], self.time + 1e-9, side="right") - 1
        return (last > 0) & (np.diff(levels, prepend=0.0)[last] < 0)


def moving(name, rows, spacing, steps, f, **more):
    time = spacing * np.arange(rows)
    return Bench(name, time, steps, None if f is None else f + np.zeros(rows), **more)


def sweep(name, warm=0.0, **more):
    f = F0 + K_T * warm + np.linspace(-500, 500, 101)
    return Bench(name, np.arange(101.0), f=f, warm=np.full(1, warm), settled=True, timed=False, **more)


THERE = F0 + HALF * np.concatenate([np.linspace(-4, 4, 60), np.linspace(4, -4, 60)])
UP_AND_DOWN = ((2e-3, 40.0), (14e-3, 80.0), (26e-3, 120.0), (38e-3, 160.0), (50e-3, 60.0), (62e-3, 0.0))
STEP, SWEEP = moving("step", 240, 1e-4, ((2e-3, 100.0),), 32290.0), sweep("sweep")
STEP_OF_PAIR = replace(STEP)
WARM = (-9.0, -3.0, 3.0, 9.0)
BENCHES = {
    "step": (STEP,),
    "sweep": (SWEEP,),
    "pair": (STEP_OF_PAIR, SWEEP),
    "there and back": (Bench("there and back", 0.5 * np.arange(120), f=THERE, settled=True),),
    "burst": (moving("burst", 260, 2e-4, ((4e-3, 100.0), (24e-3, 0.0)), 32290.0),),
    "chirp": (moving("chirp", 400, 5e-4, ((-1.0, 100.0),), F0 + np.linspace(-500, 500, 400)),),
    "levels": (moving("levels", 370, 2e-4, UP_AND_DOWN, 32290.0),),
    "levels, no frequency": (moving("levels", 370, 2e-4, UP_AND_DOWN, None),),
    "step, no frequency": (moving("step", 440, 1e-4, ((2e-3, 100.0),), None),),
    "four sweeps": tuple(sweep(f"sweep {24 + w:g} degC", w) for w in WARM),
    "four steps": tuple(
        moving(f"step {24 + w:g} degC", 240, 1e-4, ((2e-3, 100.0),), 32290.0 + K_T * w, warm=np.full(1, w))
        for w in WARM
    ),
    "warming": (
        Bench("warming", 0.5 * np.arange(180), f=np.tile(THERE, 2)[:180], settled=True,
              warm=8 * (1 - np.abs(np.linspace(-1, 1, 180)))),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Law:
    """A plate: its damping over that of a small, cold one, and its shift (Hz), by |W| over 2 um and row by
    row; what acts of the drive; and by how much (Hz), within how many s, its own motion heats it."""

    damped: Callable[[float], float] | None = None
    shift: Callable[[float], float] | None = None
    damping: np.ndarray | float = 1.0
    shifts: np.ndarray | float = 0.0
    acts: Callable[[np.ndarray], np.ndarray] = lambda volts: volts
    heats: tuple[float, float] = (0.0, 1.0)
    tau: float = TAU
    size: float = G


class _Moved:
    """The motion of a plate, interval by interval."""

    def __init__(self, bench: Bench, law: Law):
        n, self.law, self.heat = len(bench.time), law, 0.0
        self.own = np.broadcast_to(law.damping, n).tolist()
        self.f = None if bench.f is None else bench.f.tolist()
        self.bare = (F0 + K_T * bench.warm + law.shifts + np.zeros(n)).tolist()

    def pole(self, k: int, w: complex) -> tuple[complex, float]:
        """And what the drive does, per V."""
        law, size = self.law, abs(w) / TOP
        damping = self.own[k] * (law.damped(size) if law.damped else 1.0)
        if self.f is None:
            return complex(-damping / law.tau), law.size / law.tau
        f, f0 = self.f[k], self.bare[k] + (law.shift(size) if law.shift else 0.0) + law.heats[0] * self.heat
        return complex(-damping / law.tau, np.pi * (f0**2 - f**2) / f), law.size / law.tau * f0 / f

    def after(self, k: int, w: complex, volts: float, seconds: float) -> complex:
        """By the pole halfway."""
        at = w
        for part in (0.5, 1.0):
            pole, by = self.pole(k, at)
            rests = -by * volts / pole
            at = rests + (w - rests) * cmath.exp(pole * part * seconds)
        self.heat += (abs(at / TOP) ** 2 - self.heat) * -np.expm1(-seconds / self.law.heats[1])
        return at

    def settled(self, k: int, w: complex, volts: float) -> complex:
        if not (self.law.damped or self.law.shift):
            pole, by = self.pole(k, w)
            return -by * volts / pole
        for _ in range(WAITED * PART):
            before, w = w, self.after(k, w, volts, self.law.tau / PART)
            if abs(w - before) < STILL * TOP:
                break
        return w


def fine(bench: Bench, law: Law = Law()) -> np.ndarray:
    """((n - 1) FINE + 1,) motion of a transient; it begins at rest, or settled where it is driven already."""
    moved, spacing = _Moved(bench, law), bench.time[1] - bench.time[0]
    middle = (np.arange((len(bench.time) - 1) * FINE) + 0.5) * spacing / FINE
    volts = law.acts(bench.volts(middle)).tolist()
    w = [moved.settled(0, 0j, volts[0])]
    for k, v in enumerate(volts):
        w.append(moved.after(k // FINE, w[-1], v, spacing / FINE))
    return np.array(w)


def rows(bench: Bench, law: Law = Law()) -> np.ndarray:
    """(n,) what a plate shows."""
    if not bench.settled:
        return fine(bench, law)[::FINE]
    moved, found, w = _Moved(bench, law), [], 0j
    spacing = bench.time[1] - bench.time[0]
    for k, v in enumerate(law.acts(bench.volts(bench.time)).tolist()):
        for _ in range(FINE if law.heats[0] else 1):
            w = moved.settled(k, w, v)
            moved.heat += (abs(w / TOP) ** 2 - moved.heat) * -np.expm1(-spacing / FINE / law.heats[1])
        found.append(w)
    return np.array(found)


def overdriven(bench: Bench, share: float) -> np.ndarray:
    """Of a drive that is higher by a share of each of its changes, which decays within half of tau."""
    if bench.settled:
        return rows(bench)
    time, middle = 0.5 * TAU, (np.arange((len(bench.time) - 1) * FINE) + 0.5) * bench.time[1] / FINE
    levels = [0.0, *(v for _, v in bench.steps)]
    more = sum(
        (v - u) * np.exp(-np.maximum(middle - t, 0) / time) * (middle > t)
        for u, v, (t, _) in zip(levels, levels[1:], bench.steps, strict=False)
    )
    return rows(bench, Law(acts=lambda volts: volts + share * more))


def beside(bench: Bench, apart: float, share: complex, tau: float) -> np.ndarray:
    """With another mode, so many half bandwidths above."""
    return rows(bench) + share * rows(bench, Law(shifts=apart * HALF, tau=tau))


def _seen(bench: Bench, law: Law = Law()) -> tuple[np.ndarray, np.ndarray]:
    """((n - 1) FINE + 1,) what a sensor sees of a transient, and what of it is feedthrough."""
    step = (bench.time[1] - bench.time[0]) / FINE
    fed = LEAK * bench.volts((np.arange((len(bench.time) - 1) * FINE + 1) - 0.5) * step)
    return fine(bench, law) + fed, fed


def late(bench: Bench, seconds: float) -> np.ndarray:
    """A transient that is shown so much later; settled points turn."""
    if bench.settled:
        return rows(bench) * np.exp(-2j * np.pi * seconds * (bench.f - F0))
    (w, fed), step = _seen(bench), (bench.time[1] - bench.time[0]) / FINE
    at = np.arange(len(w)) * step
    return (np.interp(at - seconds, at, w, left=w[0]) - fed)[::FINE]


def filtered(bench: Bench, tau: float, order: int) -> np.ndarray:
    """Behind so many poles; by the trapezoidal rule."""
    (w, fed), x = _seen(bench), (bench.time[1] - bench.time[0]) / FINE / (2 * tau)
    for _ in range(order):
        w = lfilter([x, x], [1 + x, x - 1], w)
    return (w - fed)[::FINE]


def coupled(bench: Bench, seconds: float) -> np.ndarray:
    """Behind a high-pass, T y' + y = T w'; by the trapezoidal rule."""
    (w, fed), x = _seen(bench), (bench.time[1] - bench.time[0]) / FINE / (2 * seconds)
    return (lfilter([1, -1], [1 + x, x - 1], w) - fed)[::FINE]


def hurried(bench: Bench, dwell: float) -> np.ndarray:
    """Points of a sweep that are waited for by so many tau."""
    moved, w, found = _Moved(bench, Law()), 0j, []
    w = moved.settled(0, w, 100.0)
    for k in range(len(bench.time)):
        w = moved.after(k, w, 100.0, dwell * TAU)
        found.append(w)
    return np.array(found)


def while_(bench: Bench, inside: float, outside: float = 1.0) -> np.ndarray:
    """(n,) `inside` for a fifth of the log, not in its middle."""
    here = (bench.place > -0.05) & (bench.place < 0.15)
    return np.where(here, inside, outside)


def failing(bench: Bench, share: float) -> np.ndarray:
    """Of a drive that loses a share of itself for a while."""
    lost = while_(bench, 1 - share)
    fails = lost if bench.settled else np.repeat(lost[:-1], FINE)
    return rows(bench, Law(acts=lambda volts: volts * fails))


def clipped(w: np.ndarray, limit: float) -> np.ndarray:
    """The fundamental of a carrier of that amplitude whose peaks are cut off."""
    x = (np.arange(2000) + 0.5) * np.pi / 2000
    seen = [2 * np.mean(np.clip(a * np.sin(x), -limit, limit) * np.sin(x)) for a in np.abs(w)]
    return w * np.array(seen) / np.maximum(np.abs(w), 1e-300)


def second_order(bench: Bench, zeta: float) -> np.ndarray:
    """At 170 Hz."""
    x, w, s = np.maximum(bench.time - 2e-3, 0), 2 * np.pi * 170, np.sqrt(1 - zeta**2)
    return TOP * (1 - np.exp(-zeta * w * x) * (np.cos(s * w * x) + zeta / s * np.sin(s * w * x)))


def between(bench: Bench, size: float) -> Bench:
    """Changed between rows, by unlike shares of one, in whole parts."""
    row = bench.time[1]
    shares = size * np.array([6, 2, 4, 1, 5, 3]) / 6
    return replace(
        bench, steps=tuple((t - x * row, v) for (t, v), x in zip(bench.steps, shares, strict=False))
    )


def lost(log: Log, count: float) -> Log:
    """Without so many rows of the rise, though the times go on."""
    if log.time is None:
        return log
    kept = np.delete(np.arange(len(log)), np.arange(28, 28 + int(count)))
    columns = {n: getattr(log, n)[kept] for n in ("response", "drive", "frequency", "temperature")}
    return replace(log, **columns, time=log.time[: len(kept)])


def behind(log: Log, lag: float) -> Log:
    """A thermometer that lags."""
    at = np.linspace(0, log.time[-1], 18000)
    x = at[1] / lag
    read = lfilter([x], [1, x - 1], np.interp(at, log.time, log.temperature) - DEGC) + DEGC
    return replace(log, temperature=np.interp(log.time, at, read))


def answered(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Log], Log]:
    return lambda log: replace(log, response=change(log.response))


def blurred(bench: Bench, size: float) -> np.ndarray:
    """The mean over a resonance that scatters normally by so many half bandwidths."""
    x = np.linspace(-5, 5, 101)
    each = np.array([rows(bench, Law(shifts=size * HALF * at)) for at in x])
    return np.average(each, axis=0, weights=np.exp(-(x**2) / 2))


def stirred(bench: Bench, size: float) -> np.ndarray:
    return rows(bench, Law(damped=lambda w: 1 + size * w**2))
