"""The promise of a design: margins and step responses over the plants that it must serve, with the controller that runs."""

import math
from typing import Any, NamedTuple

import numpy as np

from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.margins import Margins, margins
from controller.tracker import SignTracker

SHARE = 0.005  # of the plants that may miss one promise: of margin and settling together, 1 %
BAND = 0.05  # within which the amplitude counts as settled
SHOWN = 50  # points of a step response
LONGEST = 4000  # samples that are looked at


class Response(NamedTuple):
    """|W| from rest at `time` (m,), s: the 5, 50 and 95 % quantiles over the plants, each (m,)."""

    time: np.ndarray
    low: np.ndarray
    middle: np.ndarray
    high: np.ndarray


class Promise(NamedTuple):
    """Kept by 99 % of the plants. `settling` (s, 5 %, from rest) and `overshoot` (of the amplitude that was asked for) at most;
    margins at least: `gain` as a factor, `phase` in degrees, `disk`, `delay` in s. `spread`: of each, the 5, 50 and 95 %
    quantiles over the plants; `response`: those of the amplitude itself, until twice the settling time."""

    settling: float
    overshoot: float
    gain: float
    phase: float
    disk: float
    delay: float
    spread: dict[str, tuple[float, float, float]]
    response: Response


def promise(
    law: Any, plants: Ensemble, sample_time: float, latency: float, amplitude: float, start: float | None, guard: Any = None
) -> Promise:
    """The promise for steps from rest to `amplitude`; `start` is the design's resonance, Hz, None without one. With the `guard`
    of the law a plate whose drive it ends does not settle."""
    found = margins(law, plants, sample_time, latency)
    W = rises(law, plants, sample_time, latency, amplitude, start, guard)
    settling, overshoot = judged(W, sample_time, amplitude)
    each = {"settling": settling, "overshoot": overshoot} | margins_by_name(found)
    worst = {name: _worst(values, -1 if name in ("settling", "overshoot") else 1) for name, values in each.items()}
    spread = {name: _quantiles(values) for name, values in each.items()}
    return Promise(**worst, spread=spread, response=_shown(W, sample_time, worst["settling"]))


def settling(control: Any, plants: Ensemble, T: float, latency: float, amplitude: float, start: float | None) -> float:
    """The settling time that is promised, alone."""
    return _worst(steps(control, plants, T, latency, amplitude, start)[0], -1)


def margins_by_name(found: Margins) -> dict[str, np.ndarray]:
    """As controller.json names them: the phase in degrees, the delay in s."""
    return {"gain": found.gain, "phase": np.rad2deg(found.phase), "disk": found.disk, "delay": found.delay}


def _worst(values: np.ndarray, sign: int) -> float:
    ordered = np.sort(sign * values)
    return float(sign * ordered[int(SHARE * len(ordered))])


def _quantiles(values: np.ndarray) -> tuple[float, float, float]:
    ordered, last = np.sort(values), len(values) - 1
    return float(ordered[round(0.05 * last)]), float(ordered[round(0.5 * last)]), float(ordered[round(0.95 * last)])


def steps(
    control: Any, plants: Ensemble, T: float, latency: float, amplitude: float, start: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Settling time (n,) s, inf where it does not settle, and overshoot (n,) of |W| from rest to `amplitude`."""
    return judged(rises(control, plants, T, latency, amplitude, start), T, amplitude)


def rises(
    law: Any, plants: Ensemble, T: float, latency: float, amplitude: float, start: float | None, guard: Any = None
) -> np.ndarray:
    """|W| (m, n) of n plants from rest, at m samples, with what runs: the `guard` of the law, or the law.

    The slow envelope of each plant, exact under held inputs; a command takes effect `latency` s after its sample.
    """
    late = int(np.floor(latency / T + 1e-9))
    part = min(max(latency - late * T, 0.0), T)
    Z = np.zeros(len(plants.rate), complex)
    still = (np.zeros_like(plants.rate), np.zeros_like(plants.rate))
    line = [still] * (late + 1)  # commands that were given, the latest first
    control = guard or law
    state, rows = control.init(), np.empty((min(samples(law, plants, T), LONGEST), len(Z)))
    temperature = _told(law, plants)
    for row in rows:
        row[:] = np.abs(Z)
        state, command, _ = control.step(state, amplitude, Z, temperature, np)
        f = 0.0 if command.frequency is None or start is None else command.frequency - start
        line.insert(0, (command.voltage, f + still[0]))
        for (voltage, offset), duration in ((line[late + 1], part), (line[late], T - part)):
            pole = -plants.rate + 2j * np.pi * (plants.detuning - offset)
            settled = -plants.push * voltage / pole
            Z = settled + (Z - settled) * np.exp(pole * duration)
        line.pop()
    return rows


def _told(law: Any, plants: Ensemble) -> np.ndarray | None:
    """Each plate's temperature (n,), degC, where a thermometer tells the loop."""
    follower = law.tracker if isinstance(law, DQ) else law
    if plants.warming is None or follower is None or isinstance(follower, SignTracker):
        return None
    return follower.temperature + plants.warming


def judged(W: np.ndarray, T: float, amplitude: float) -> tuple[np.ndarray, np.ndarray]:
    """Settling time and overshoot, both (n,), of |W| (m, n); see `steps`."""
    outside = np.abs(W - abs(amplitude)) > BAND * abs(amplitude)
    last = len(W) - 1 - np.argmax(outside[::-1], axis=0)  # the first row is at rest, so one is outside
    settling = np.where(outside[-1], np.inf, (last + 1) * T)
    return settling, np.maximum(np.max(W, axis=0) / abs(amplitude) - 1, 0.0)


def samples(control: Any, plants: Ensemble, T: float) -> int:
    """After which every plate has come to rest: 14 time constants of the slowest, five of the loop, and what the rule of fixed
    steps needs to reach the furthest resonance."""
    share = control.amplitude.Kp * np.min(np.abs(plants.push)) * T if isinstance(control, DQ) else control.K
    rest = 14 / (np.min(plants.rate) * T) + 20 + 5 / min(abs(share), 1.0)
    if isinstance(control, DQ) and isinstance(control.tracker, SignTracker):
        rest += control.tracker.every * np.max(np.abs(plants.detuning)) / control.tracker.size
    return math.ceil(rest)


def _shown(W: np.ndarray, T: float, settling: float) -> Response:
    until = min(len(W), math.ceil(2 * settling / T) + 1) if math.isfinite(settling) else len(W)
    rows = np.unique(np.linspace(0, until - 1, min(SHOWN, until)).round().astype(int))
    return Response(rows * T, *np.quantile(W[rows], [0.05, 0.5, 0.95], axis=1))
