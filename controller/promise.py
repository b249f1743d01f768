"""The promise of a design: margins and steps of the controller that runs, over the plants it must serve."""

import cmath
import math
from collections.abc import Iterator
from itertools import pairwise
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
    """From rest to `amplitude`, of each of the `plants`; `start`: the design's resonance, Hz, or None."""

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
    """Kept by 99 % of the plants. At most: `settling` (s, 5 %, from rest), `overshoot` (of the amplitude that
    was asked for), and `small`, that of a step from rest to a tenth, of that step; both at the worst phase of
    the carrier. Margins at least: `gain` as a factor, `phase` in degrees, `disk`, `delay` in s. `spread`: of
    each, the 5, 50 and 95 % quantiles over the plants; `response`: those of the amplitude itself, until twice
    the settling time. `startup`: s from enabling what is exported to within 5 % for good; inf without a
    guard. `bode`: the loop over frequency."""

    settling: float
    overshoot: float
    small: float
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
    W, V, tops = rises(law, taken, guard)
    # The largest |W| from sample to sample, with what the carrier's phase may add to it.
    overshoot = judged(tops + by_phase(V, taken), taken)[1]
    each = {"settling": judged(W, taken)[0], "overshoot": overshoot}
    tenth = taken._replace(amplitude=SMALL * taken.amplitude)
    _, V_tenth, tops_tenth = rises(law, tenth)
    each["small"] = judged(tops_tenth + by_phase(V_tenth, tenth), tenth)[1]
    worst = {name: _worst(values, -1) for name, values in each.items()}
    each |= found._replace(phase=np.rad2deg(found.phase))._asdict()
    worst |= {name: _worst(each[name], 1) for name in found._fields}
    rows = [round(q * (len(plants.rate) - 1)) for q in LEVELS]
    spread = {name: tuple(np.sort(values)[rows].tolist()) for name, values in each.items()}
    begun = math.inf if machine is None else startup(machine, law, taken)
    shown, band = _shown(W, V, clock.T, worst["settling"]), bode(law, plants, clock.T, clock.delay)
    return Promise(**worst, spread=spread, response=shown, startup=begun, bode=band)


def settling(law: Any, taken: Steps) -> float:
    """The settling time that is promised, alone."""
    return _worst(judged(rises(law, taken)[0], taken)[0], -1)


def startup(machine: Any, law: Any, taken: Steps) -> float:
    """s from enabling the machine to |W| within 5 % for good, of 99 % of the plants; inf where more fail."""
    few = taken.plants.every(math.ceil(len(taken.plants.rate) / STARTED))
    if taken.amplitude / machine.ramp + 3 * machine.patience > LONGEST:  # more samples than are looked at
        return math.inf
    rows, last = [], 0
    most = int(min(3 * LONGEST, 4 * machine.limit))
    for k, (W, _, _, said) in enumerate(played(machine, law, taken._replace(plants=few), most)):
        rows.append(W)
        last = k if np.any((said.mode > OFF) & (said.mode < RUN)) or k < 2 else last
        beside = np.abs(W - abs(taken.amplitude)) > BAND * abs(taken.amplitude)
        if k > last + 4 * machine.patience and not np.any(
            beside
        ):  # a slow loop comes there long after it runs
            break
    settled, _ = judged(np.reshape(rows, (len(rows), -1)), taken)
    return _worst(np.where(said.mode == RUN, settled, np.inf) + np.zeros_like(few.rate), -1)


def _worst(values: np.ndarray, sign: int) -> float:
    ordered = np.sort(sign * values)
    return float(sign * ordered[int(SHARE * len(ordered))])


def rises(law: Any, taken: Steps, guard: Any = None) -> np.ndarray:
    """|W|, V, and the largest |W| since the sample before (3, m, n) of n plants from rest, at m samples, with
    what runs: the `guard` of the law, or the law."""
    count = min(samples(law, taken.plants, taken.clock.T), LONGEST)
    rows = np.empty((3, count, len(taken.plants.rate)))
    for k, now in enumerate(played(guard or law, law, taken, count)):
        for row, values in zip(rows, now[:3], strict=True):
            row[k] = values
    return rows


def played(control: Any, law: Any, taken: Steps, count: int) -> Iterator[tuple[Any, Any, Any, Any]]:
    """|W|, V, the largest |W| since the sample before and what is said at each of `count` samples: the slow
    envelope of each plant, exact under held inputs. A command takes effect a latency after its sample; the
    demodulator is read as its last sample left it; between two samples what is later still lies on a straight
    line."""
    plants, clock, amplitude, start = taken
    T, late = clock.T, int(np.floor(clock.latency / clock.T + 1e-9))
    part = min(max(clock.latency - late * T, 0.0), T)
    waits, age = divmod(0.0 if clock.filters is None else clock.filters.age, T)
    whole, between = divmod(clock.late / T + waits, 1.0)
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
    heard = T - age
    cuts = list(pairwise(sorted({0.0, part, heard, T})))
    reading, top = Z, np.abs(Z)
    growth = np.exp if xp is np else cmath.exp
    state = control.init()
    for _ in range(count):
        seen = [reading, *seen[:-1]]
        told = seen[-2] + between * (seen[-1] - seen[-2])
        state, command, said = control.step(state, amplitude, told, temperature, xp)
        yield np.abs(Z), command.voltage, top, said
        top = np.abs(Z)
        f = 0.0 if command.frequency is None or start is None else command.frequency - start
        line.insert(0, (command.voltage, f + still[0]))
        for begin, end in cuts:
            (voltage, offset), duration = line[late + (begin < part)], end - begin
            pole = -rate + 2j * np.pi * (detuning - offset)
            settled = -push * voltage / pole
            moves, moved = Z - settled, growth(pole * duration)
            if filters is not None:
                passed, back = duration * filters.rate, growth(-pole / filters.rate)
                outputs = behind(outputs, settled, moves, moved, filters, passed, back)
            Z = settled + moves * moved
            top = np.maximum(top, np.abs(Z))
            if end == heard:
                reading = outputs[-1] if outputs else Z
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
    found, fades = [], [left**samples]
    for k in range(filters.order - 1):
        fades.append(fades[-1] * filters.share * (samples + k) / (k + 1))
    for output in outputs:
        share = share * (filters.share / (1.0 - left * back))
        beside = [output - settled - moves * share, *beside]
        fading = sum(f * b for f, b in zip(fades, beside, strict=False))
        found.append(settled + moves * moved * share + fading)
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


def by_phase(V: np.ndarray, taken: Steps) -> np.ndarray:
    """By how much |W| (m, n) may lie beside its mean over the carrier, whatever the phase p at which commands
    take effect. W' has a part of -push V e^{-2jp} besides: each change of V by dV leaves dV push / (2 omega),
    turned by twice the phase, and decaying with the plate."""
    if taken.start is None:
        return np.zeros_like(V)
    (T, latency), plants = taken.clock[:2], taken.plants
    keep = np.exp((-plants.rate - 4j * np.pi * taken.start) * T)
    changes = np.diff(V, axis=0, prepend=0.0)
    late = math.ceil(latency / T - 1e-9)  # rows from a command to the first that shows it
    left = np.zeros_like(V, complex)
    for k in range(late, len(V)):
        left[k] = left[k - 1] * keep + changes[k - late]
    return np.abs(left) * np.abs(plants.push) / (4 * np.pi * taken.start)


def samples(control: Any, plants: Ensemble, T: float) -> int:
    """After which every plate has come to rest: 14 time constants of the slowest, five of the loop, and what
    the rule of fixed steps needs to reach the furthest resonance."""
    rest = 14 / (np.min(plants.rate) * T) + 20 + 5 / min(_removed(control, plants, T), 1.0)
    if isinstance(control, DQ) and isinstance(control.tracker, SignTracker):
        rest += control.tracker.every * np.max(np.abs(plants.detuning)) / control.tracker.size
    return math.ceil(rest)


def _removed(control: Any, plants: Ensemble, T: float) -> float:
    """Of the amplitude's error, what one sample removes at least: with a PI, the more a plate is damped, the
    more of it is left to the integral alone."""
    if not isinstance(control, DQ):
        return abs(control.K)
    pi, push = control.amplitude, np.abs(plants.push)
    return float(min(abs(pi.Kp) * np.min(push) * T, abs(pi.Ki_Ts) * np.min(push / plants.rate)))


def _shown(W: np.ndarray, V: np.ndarray, T: float, settling: float) -> Response:
    until = min(len(W), math.ceil(2 * settling / T) + 1) if math.isfinite(settling) else len(W)
    rows = np.unique(np.linspace(0, until - 1, min(SHOWN, until)).round().astype(int))
    low, middle, high = np.quantile(W[rows], LEVELS, axis=1)
    return Response(rows * T, low, middle, high, np.quantile(V[rows], LEVELS, axis=1))
