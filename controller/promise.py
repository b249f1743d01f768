"""The promise of a design: margins and step responses over the plants that it must serve, with the controller
that runs."""

import cmath
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from controller import scalar
from controller.demodulator import Demodulator
from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.machine import OFF, RUN
from controller.margins import Bode, bode, margins
from controller.tracker import SignTracker

SHARE = 0.005  # of the plants that may miss one promise: of margin and settling together, 1 %
BAND = 0.05  # within which the amplitude counts as settled
SHOWN = 50  # points of a step response
LONGEST = 4000  # samples that are looked at
SMALL = 0.1  # of the amplitude: a step for which the voltage has no limit
STARTED = 50  # plants that are switched on
LEVELS = (0.05, 0.5, 0.95)  # quantiles that are shown


class Clock(NamedTuple):
    """Times in s: of a sample; from it to when its command takes effect, `latency`; by which its reading is
    `late` beside the demodulator's `filters` (None: there are none)."""

    T: float
    latency: float
    late: float = 0.0
    filters: Demodulator | None = None

    @property
    def delay(self) -> float:
        """From a motion of the plate to the command that answers it."""
        return self.latency + self.late + (0.0 if self.filters is None else self.filters.delay)


class Steps(NamedTuple):
    """From rest to `amplitude`, of each of the `plants`; `start`: the design's resonance, Hz, None without
    one."""

    plants: Ensemble
    clock: Clock
    amplitude: float
    start: float | None


class Response(NamedTuple):
    """|W| from rest at `time` (m,), s: the 5, 50 and 95 % quantiles over the plants, each (m,); of the
    `voltage` too (3, m)."""

    time: np.ndarray
    low: np.ndarray
    middle: np.ndarray
    high: np.ndarray
    voltage: np.ndarray


class Promise(NamedTuple):
    """Kept by 99 % of the plants. `settling` (s, 5 %, from rest) and `overshoot` (of the amplitude that was
    asked for, or of a tenth of it) at most; margins at least: `gain` as a factor, `phase` in degrees, `disk`,
    `delay` in s. `spread`: of each, the 5, 50 and 95 % quantiles over the plants; `response`: those of the
    amplitude itself, until twice the settling time. `startup`: s from enabling what is exported to within 5 %
    for good; inf without a guard. `bode`: the loop over frequency."""

    settling: float
    overshoot: float
    gain: float
    phase: float
    disk: float
    delay: float
    spread: dict[str, tuple[float, float, float]]
    response: Response
    startup: float = math.inf
    bode: Bode | None = None


def promise(law: Any, taken: Steps, guard: Any = None, machine: Any = None) -> Promise:
    """The promise for steps. With the `guard` of the law a plate whose drive it ends does not settle; the
    `machine` around it is what is switched on."""
    plants, clock = taken.plants, taken.clock
    found = margins(law, plants, clock.T, clock.delay)
    W, V = rises(law, taken, guard)
    settling, overshoot = judged(W, taken)
    small = taken._replace(amplitude=SMALL * taken.amplitude)
    overshoot = np.maximum(overshoot, judged(rises(law, small)[0], small)[1])
    each = {"settling": settling, "overshoot": overshoot}
    each |= found._replace(phase=np.rad2deg(found.phase))._asdict()
    worst = {
        name: _worst(values, -1 if name in ("settling", "overshoot") else 1) for name, values in each.items()
    }
    rows = [round(q * (len(plants.rate) - 1)) for q in LEVELS]
    spread = {name: tuple(np.sort(values)[rows].tolist()) for name, values in each.items()}
    begun = math.inf if machine is None else startup(machine, law, taken)
    shown = _shown(W, V, clock.T, worst["settling"])
    return Promise(
        **worst, spread=spread, response=shown, startup=begun, bode=bode(law, plants, clock.T, clock.delay)
    )


def settling(law: Any, taken: Steps) -> float:
    """The settling time that is promised, alone."""
    return _worst(judged(rises(law, taken)[0], taken)[0], -1)


def startup(machine: Any, law: Any, taken: Steps) -> float:
    """s from enabling the machine to |W| within 5 % for good, of 99 % of the plants; inf where more do not
    come to run."""
    few = taken.plants.every(math.ceil(len(taken.plants.rate) / STARTED))
    if taken.amplitude / machine.ramp + 3 * machine.patience > LONGEST:  # more samples than are looked at
        return math.inf
    rows, last = [], 0
    most = int(min(3 * LONGEST, 4 * machine.limit))
    for k, (W, _, said) in enumerate(played(machine, law, taken._replace(plants=few), most)):
        rows.append(W)
        last = k if np.any((said.mode > OFF) & (said.mode < RUN)) or k < 2 else last
        if k > last + 4 * machine.patience:
            break
    settled, _ = judged(np.reshape(rows, (len(rows), -1)), taken)
    return _worst(np.where(said.mode == RUN, settled, np.inf) + np.zeros_like(few.rate), -1)


def _worst(values: np.ndarray, sign: int) -> float:
    ordered = np.sort(sign * values)
    return float(sign * ordered[int(SHARE * len(ordered))])


def rises(law: Any, taken: Steps, guard: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """|W| and V (m, n) of n plants from rest, at m samples, with what runs: the `guard` of the law, or the
    law."""
    count = min(samples(law, taken.plants, taken.clock.T), LONGEST)
    rows = np.empty((2, count, len(taken.plants.rate)))
    for k, (W, V, _) in enumerate(played(guard or law, law, taken, count)):
        rows[0, k], rows[1, k] = W, V
    return rows[0], rows[1]


def played(control: Any, law: Any, taken: Steps, count: int) -> Iterator[tuple[np.ndarray, Any, Any]]:
    """|W|, V and what is said at each of `count` samples: the slow envelope of each plant, exact under held
    inputs. A command takes effect a latency after its sample; between two samples a late reading lies on a
    straight line."""
    plants, clock, amplitude, start = taken
    T, late = clock.T, int(np.floor(clock.latency / clock.T + 1e-9))
    part = min(max(clock.latency - late * T, 0.0), T)
    whole, between = divmod(clock.late / T, 1.0)
    xp: Any = np
    rate, push, detuning = plants.rate, plants.push, plants.detuning
    Z: Any = np.zeros(len(rate), complex)
    still: Any = (0.0 * rate, 0.0 * rate)
    temperature = _told(law, plants)
    if len(rate) == 1:  # plain numbers are ten times as fast as arrays of one
        xp, rate, push, detuning, Z, still = scalar, rate.item(), push.item(), detuning.item(), 0j, (0.0, 0.0)
        temperature = None if temperature is None else temperature.item()
    line = [still] * (late + 1)  # commands that were given, the latest first
    seen, filters = [Z] * (int(whole) + 2), clock.filters
    outputs = [] if filters is None else [Z] * filters.order
    growth = np.exp if xp is np else cmath.exp
    state = control.init()
    for _ in range(count):
        seen = [outputs[-1] if outputs else Z, *seen[:-1]]
        told = seen[-2] + between * (seen[-1] - seen[-2])
        state, command, said = control.step(state, amplitude, told, temperature, xp)
        yield np.abs(Z), command.voltage, said
        f = 0.0 if command.frequency is None or start is None else command.frequency - start
        line.insert(0, (command.voltage, f + still[0]))
        for (voltage, offset), duration in ((line[late + 1], part), (line[late], T - part)):
            pole = -rate + 2j * np.pi * (detuning - offset)
            settled = -push * voltage / pole
            moves, moved = Z - settled, growth(pole * duration)
            if filters is not None:
                outputs = behind(
                    outputs,
                    settled,
                    moves,
                    moved,
                    filters,
                    duration * filters.rate,
                    growth(-pole / filters.rate),
                )
            Z = settled + moves * moved
        line.pop()


def behind(
    outputs: list[Any], settled: Any, moves: Any, moved: Any, filters: Demodulator, samples: float, back: Any
) -> list[Any]:
    """Outputs of the demodulator's filters, y <- y + share (x - y), after so many `samples`, in which their
    input goes from `settled` + `moves` to `settled` + `moves` `moved`, by `back` from one sample to that
    before. They follow it at a share each; what each was beside that dies away through those after it:
    binomial, for parts of a sample too."""
    left, share = 1.0 - filters.share, 1.0
    beside: list[Any] = []
    found: list[Any] = []
    fades = [left**samples]
    for k in range(filters.order - 1):
        fades.append(fades[-1] * filters.share * (samples + k) / (k + 1))
    for output in outputs:
        share = share * (filters.share / (1.0 - left * back))
        beside = [output - settled - moves * share, *beside]
        found.append(
            settled + moves * moved * share + sum(f * b for f, b in zip(fades, beside, strict=False))
        )
    return found


def _told(law: Any, plants: Ensemble) -> np.ndarray | None:
    """Each plate's temperature (n,), degC, where a thermometer tells the loop."""
    follower = law.tracker if isinstance(law, DQ) else law
    if plants.warming is None or follower is None or isinstance(follower, SignTracker):
        return None
    return follower.temperature + plants.warming


def judged(W: np.ndarray, taken: Steps) -> tuple[np.ndarray, np.ndarray]:
    """Settling time (n,) s, inf where it does not settle, and overshoot (n,) of |W| (m, n)."""
    amplitude = taken.amplitude
    outside = np.abs(W - abs(amplitude)) > BAND * abs(amplitude)
    last = len(W) - 1 - np.argmax(outside[::-1], axis=0)  # the first row is at rest, so one is outside
    settling = np.where(outside[-1], np.inf, (last + 1) * taken.clock.T)
    return settling, np.maximum(np.max(W, axis=0) / abs(amplitude) - 1, 0.0)


def samples(control: Any, plants: Ensemble, T: float) -> int:
    """After which every plate has come to rest: 14 time constants of the slowest, five of the loop, and what
    the rule of fixed steps needs to reach the furthest resonance."""
    share = control.amplitude.Kp * np.min(np.abs(plants.push)) * T if isinstance(control, DQ) else control.K
    rest = 14 / (np.min(plants.rate) * T) + 20 + 5 / min(abs(share), 1.0)
    if isinstance(control, DQ) and isinstance(control.tracker, SignTracker):
        rest += control.tracker.every * np.max(np.abs(plants.detuning)) / control.tracker.size
    return math.ceil(rest)


def _shown(W: np.ndarray, V: np.ndarray, T: float, settling: float) -> Response:
    until = min(len(W), math.ceil(2 * settling / T) + 1) if math.isfinite(settling) else len(W)
    rows = np.unique(np.linspace(0, until - 1, min(SHOWN, until)).round().astype(int))
    low, middle, high = np.quantile(W[rows], LEVELS, axis=1)
    return Response(rows * T, low, middle, high, np.quantile(V[rows], LEVELS, axis=1))
