"""The bench that makes the logs, and ways to spoil them. Responses: `tests/reference.py`, which shares no code with the package."""

import runpy
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from sysid import Log, read_logs
from sysid.logs.written import write_log

REFERENCE = Path(__file__).parents[2] / "tests" / "reference.py"
reference = SimpleNamespace(**runpy.run_path(str(REFERENCE), run_name="reference"))
ROWS, EARLY = 120, 12  # of every log, and before its step, so that few programs are compiled
PLATE = reference.Plant(G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=-10.16)
VOLTS, NOISE = 100.0, 0.01  # settled response 2 um, noise 0.02 um in each channel
HALF = 1 / (2 * np.pi * PLATE.tau)  # half a bandwidth, Hz


@dataclass
class Bench:
    """What makes the logs of one seed."""

    rng: np.random.Generator
    plant: SimpleNamespace = PLATE
    noise: float = NOISE

    def rows(self, clean: np.ndarray, turn: float = 0.3) -> np.ndarray:
        """Behind a rotated demodulator, with noise."""
        size = self.noise * self.plant.G * VOLTS
        return clean * np.exp(1j * turn) + size * (
            self.rng.standard_normal(len(clean)) + 1j * self.rng.standard_normal(len(clean))
        )

    def step(
        self,
        window: float = 12.0,
        off: float = 0.5,
        drive=None,
        frequency=None,
        degC: float = 24.0,
        early=EARLY,
    ) -> Log:
        """A step to VOLTS at `off` half bandwidths beside resonance, over `window` tau; or another drive."""
        time = window * self.plant.tau * (np.arange(ROWS) - early) / (ROWS - early)
        volts = VOLTS * (np.arange(ROWS) >= early) if drive is None else drive
        f = np.broadcast_to(
            self.plant.f0 + self.plant.k_T * (degC - 24) + off * HALF if frequency is None else frequency,
            ROWS,
        )
        clean = reference.ringing(self.plant, time, volts, f, np.full(ROWS, degC))
        return Log(
            "step",
            self.rows(clean),
            time - time[0],
            volts,
            f,
            np.full(ROWS, degC),
            kind="transient",
            sampling="instant",
        )

    def sweep(self, low: float = -8.0, high: float = 8.0, degC=24.0, drive: float = VOLTS) -> Log:
        """Settled points from `low` to `high` half bandwidths about the resonance at 24 degC."""
        f = self.plant.f0 + HALF * np.linspace(low, high, ROWS)
        warm = np.broadcast_to(np.asarray(degC, float), ROWS)
        clean = reference.steady(self.plant, drive, f, warm)
        return Log("sweep", self.rows(clean), None, np.full(ROWS, drive), f, warm, kind="steady")


# --- ways to spoil a log ---------------------------------------------------------------------------------------------------


def spoilt(log: Log, change: Callable[[np.ndarray], np.ndarray]) -> Log:
    return replace(log, response=change(np.array(log.response)))


def clipped(level: float, both: bool = True) -> Callable[[np.ndarray], np.ndarray]:
    low = -level if both else -np.inf
    return lambda y: np.clip(y.real, low, level) + 1j * np.clip(y.imag, low, level if both else np.inf)


def outliers(b: Bench, share: float, size: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        hit = b.rng.random(len(y)) < share
        return y + hit * size * 2 * (b.rng.standard_normal(len(y)) + 1j * b.rng.standard_normal(len(y)))

    return change


def dropped(first: int, last: int, held: bool) -> Callable[[np.ndarray], np.ndarray]:
    return lambda y: np.where(
        (np.arange(len(y)) >= first) & (np.arange(len(y)) < last), y[first - 1] if held else 0.0, y
    )


def quantised(levels: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        lsb = 2 * np.max(np.abs(y)) / (levels - 1)
        return lsb * (np.round(y.real / lsb) + 1j * np.round(y.imag / lsb))

    return change


def coloured(b: Bench, rho: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        extra = 0.02 * (b.rng.standard_normal(len(y)) + 1j * b.rng.standard_normal(len(y)))
        for k in range(1, len(y)):
            extra[k] = rho * extra[k - 1] + np.sqrt(1 - rho**2) * extra[k]
        return y + extra

    return change


def late(rows: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda y: np.concatenate([y[:1].repeat(rows), y[:-rows]])


def smoothed(log: Log, tau: float) -> Log:
    """Behind a one-pole filter, exact for a response that is straight from row to row."""
    y, keep = np.array(log.response), np.exp(-np.diff(log.time) / tau)
    for k in range(1, len(y)):
        y[k] = keep[k - 1] * y[k - 1] + (1 - keep[k - 1]) * (log.response[k] + log.response[k - 1]) / 2
    return replace(log, response=y)


def amplitude(log: Log) -> Log:
    return replace(log, response=np.abs(log.response))


def picked(log: Log, index) -> Log:
    """Some of the rows."""
    names = ("response", "time", "drive", "frequency", "temperature")
    return replace(log, **{n: v[index] for n in names if (v := getattr(log, n)) is not None})


def through_csv(log: Log, edit: Callable[[str], str], *others: Log) -> list[Log]:
    """What the reader makes of the log's file once it is edited, and of the others' files."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"log{k}.csv" for k in range(1 + len(others))]
        for path, one in zip(paths, (log, *others), strict=True):
            write_log(one, path)
        paths[0].write_text(edit(paths[0].read_text(encoding="utf-8")), encoding="utf-8")
        return read_logs(paths)


def called_degC(log: Log) -> Log:
    return replace(log, temperature=log.temperature + 273.15)


def renamed(old: str, new: str) -> Callable[[str], str]:
    def edit(text: str) -> str:
        assert old in text, text[:200]
        return text.replace(old, new, 1)

    return edit


def duffing(b: Bench, shift: float, back: bool = False) -> Log:
    """A sweep whose resonance falls by `shift` half bandwidths at G V, in proportion to W^2; up, or down where `back`."""
    log, w = b.sweep(), 0.0
    f = log.frequency[::-1] if back else log.frequency
    found = np.zeros(ROWS, complex)
    for k in range(ROWS):
        for _ in range(400):
            moved = replace(b.plant, f0=b.plant.f0 - shift * HALF * (w / (b.plant.G * VOLTS)) ** 2)
            new = reference.steady(moved, VOLTS, f[k : k + 1], np.array([24.0]))[0]
            w = 0.9 * w + 0.1 * abs(new)
        found[k] = new
    return replace(log, response=b.rows(found), frequency=f)


def hurried(b: Bench, dwell: float) -> Log:
    """A sweep that stays `dwell` tau at each frequency, said to be settled."""
    log, time = b.sweep(), dwell * b.plant.tau * np.arange(ROWS + 1)
    f = np.append(log.frequency, log.frequency[-1])
    clean = reference.ringing(b.plant, time, np.full(ROWS + 1, VOLTS), f, np.full(ROWS + 1, 24.0))[1:]
    return replace(log, response=b.rows(clean))


def touched(b: Bench, recorded: bool, finer: int = 20) -> Log:
    """A finger that presses with 1.5 N in the second half of a step, within four tau; `finer`: the steps of a row, as it moves."""
    log = b.step(window=24.0)
    time = np.interp(np.arange(finer * ROWS) / finer, np.arange(ROWS), log.time)
    force = 1.5 * np.clip((time - time[-1] / 2) / (4 * b.plant.tau), 0, 1)
    inputs = (np.repeat(v, finer) for v in (log.drive, log.frequency, log.temperature))
    clean = reference.ringing(b.plant, time, *inputs, reference.touched(b.plant, force)[1])
    return replace(log, response=b.rows(clean[::finer]), force=force[::finer] if recorded else None)


def levels(b: Bench, sizes: Sequence[float]) -> np.ndarray:
    """A staircase of drives."""
    return VOLTS * np.append(np.zeros(EARLY), np.repeat(sizes, (ROWS - EARLY) // len(sizes)))[:ROWS]


def felt(b: Bench, asked: np.ndarray, given: np.ndarray) -> Log:
    """The plate feels another drive than the one recorded."""
    return replace(b.step(window=24.0, drive=given), drive=asked)


def other(b: Bench, **changes: float) -> Bench:
    """The bench with another plate on it."""
    return replace(b, plant=replace(b.plant, **changes))


def irregular(b: Bench) -> Log:
    log = b.step()
    time = np.sort(b.rng.uniform(0, log.time[-1], ROWS))
    volts = VOLTS * (np.arange(ROWS) >= EARLY)
    clean = reference.ringing(b.plant, time, volts, log.frequency, log.temperature)
    return replace(log, time=time, response=b.rows(clean))


def settled(b: Bench) -> Log:
    """Each row's response is the one that its own inputs have led to."""
    log = b.step()
    return picked(replace(log, drive=np.append(log.drive[1:], VOLTS)), np.arange(ROWS))


def two_peaks(b: Bench, apart: float) -> Log:
    log = b.sweep()
    second = replace(b.plant, f0=b.plant.f0 + apart * HALF, G=0.5 * b.plant.G)
    return spoilt(
        log, lambda y: y + reference.steady(second, VOLTS, log.frequency, log.temperature) * np.exp(0.3j)
    )


def plates(b: Bench) -> list[Log]:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.csv" for name in ("A7", "B2")]
        for path in paths:
            write_log(replace(b.sweep(), metadata={"plate": path.stem}), path)
        return read_logs(paths)


def swapped(first: str, second: str) -> Callable[[str], str]:
    return lambda text: text.replace(first, "~").replace(second, first).replace("~", second)


def jumping_source(b: Bench) -> Log:
    """A frequency stepped at every row by a source that makes sin(2 pi f(t) t): its phase jumps by 2 pi (change of f) t."""
    time, f = 0.5 * b.plant.tau * np.arange(ROWS), b.plant.f0 + HALF * np.linspace(-4, 4, ROWS)
    clean = np.zeros(ROWS, complex)
    for k in range(ROWS - 1):
        slow, fast, gain = reference.modes(b.plant, f[k], 24.0, b.plant.tau)
        settled = gain * VOLTS / fast
        moved = reference.advance(clean[k] - settled, slow, gain * VOLTS, time[k + 1] - time[k]) + settled
        clean[k + 1] = moved * np.exp(-2j * np.pi * (f[k + 1] - f[k]) * time[k + 1])
    warm = np.full(ROWS, 24.0)
    return Log(
        "sweep", b.rows(clean), time, np.full(ROWS, VOLTS), f, warm, kind="transient", sampling="instant"
    )


def held_back(asked: np.ndarray, play: float) -> np.ndarray:
    """What is left of a drive behind a hysteresis (backlash) of half width `play`."""
    given = np.zeros(len(asked))
    for k in range(1, len(asked)):
        given[k] = np.clip(given[k - 1], asked[k] - play, asked[k] + play)
    return given


def warmed(b: Bench) -> Log:
    """Settled points at one frequency while the plate warms by 16 degC."""
    warm = np.linspace(20, 36, ROWS)
    f = np.full(ROWS, b.plant.f0)
    clean = reference.steady(b.plant, VOLTS, f, warm)
    return Log("warming", b.rows(clean), None, np.full(ROWS, VOLTS), f, warm, kind="steady")


def scattered(b: Bench, share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Single rows that read exactly zero."""
    return lambda y: np.where(b.rng.random(len(y)) < share, 0.0, y)
