"""A record of the closed loop, compared with the predictions of its controller.json.

The record begins before the amplitude is asked for, and holds it to its end: time, Wd and Wq, the voltage and
the frequency.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from sysid.columns.metadata import stated
from sysid.logs.log import Log, LogError

BAND = 0.05  # about the last amplitude, within which it counts as settled
LAST = 0.2  # share of the rows that are its end
ROWS = 9  # of which the median is little disturbed by noise
NOISE = 4.0  # standard deviations of a row about the end, for which noise may carry it beyond a promise
# Of what is left about the end, at one frequency, that is no noise: of the 30 frequencies of SWINGING rows
# three neighbours have so much by chance once in a thousand.
TONAL, SWINGING = 0.5, 60
# A voltage that has risen: above what the loop makes of the noise, which is at rest what it is at the end,
# and above a share of the largest. From rest the voltage goes at once to the steady one and beyond, so that
# half of that has risen, however noisy.
FLICKER, SHARE, RISEN = 5.0, 0.05, 0.5
NEAR_STEADY = 0.1  # relative, for the voltage at the end
TRACKED = 0.1  # of the half bandwidth, for the frequency's distance from the resonance
TURNED = 0.25  # of it, for the frequency's distance from f0: 14 degrees of a sensor that is turned, or 2 degC
# The delay is read to a tenth of a sample, with a finger's damping, where the plate's equation leaves 3 % of
# the amplitude; half a sample more than was designed for is called missing.
FINE, DAMPINGS, TOLD, MORE = 10, (0.0, 0.25, 0.5, 1.0, 2.0), 0.03, 0.5


class Finding(NamedTuple):
    """One prediction: what was found and expected, whether it was kept, and a likely cause if not."""

    what: str
    found: str
    expected: str
    kept: bool
    hint: str = ""


class _Record(NamedTuple):
    """A record and the controller.json that predicts it: from `begin`, the last row before the voltage rises,
    to `end`, from which on the amplitude is at its `target`, with a standard deviation of `noise` beside a
    `swing` of so much at so many Hz, zero where there is none; `row`: s from one to the next."""

    controller: Mapping[str, Any]
    log: Log
    begin: int
    end: int
    target: float
    noise: float
    row: float
    swing: tuple[float, float]

    @classmethod
    def of(cls, controller: Mapping[str, Any], log: Log) -> "_Record":
        """Raises LogError for a record that cannot be judged."""
        for why in _refusals(controller, log):
            raise LogError(f"{log.name}: a record of a closed loop: {why}")
        end = int((1 - LAST) * len(log))
        last, row = np.abs(log.response[end:]), float(np.median(np.diff(log.time)))
        noise, swing = _swings(last, row)
        return cls(
            controller, log, int(_resting(log, end)[-1]), end, float(np.median(last)), noise, row, swing
        )

    @property
    def W(self) -> np.ndarray:
        """The amplitude (n,)."""
        return np.abs(self.log.response)

    @property
    def half_bandwidth(self) -> float:
        """Hz, of the plate."""
        return 1 / (2 * math.pi * self.controller["plant"]["tau"])


def check(controller: Mapping[str, Any], log: Log) -> list[Finding]:
    """The predictions of a controller.json against a record of its loop. Raises LogError for one that cannot
    be judged."""
    record = _Record.of(controller, log)
    found = [_settling(record), _overshoot(record), _steady(record), _delay(record), _voltage(record)]
    if controller["plant"]["f0"] is not None and controller["tracker"]:
        found.append(_tracked(record))
        if log.frequency is not None:
            found += [_beside(record), _window(record)]
    return [f._replace(hint="") if f.kept else f for f in found if f is not None]


def _refusals(controller: Mapping[str, Any], log: Log) -> Iterator[str]:
    """Why a record cannot be judged."""
    named, expected = stated(log.metadata, "plate"), controller.get("plate")
    if named and expected and named != expected:
        yield f"found the plate {named!r}, expected {expected!r}, for which controller.json was designed"
    for name, values in (("voltage_*", log.drive), ("time_*", log.time)):
        if values is None:
            yield f"found no {name} column, expected one"
    if log.amplitude_only:
        yield "found an amplitude alone, expected wd and wq"
    for kind, unit in (("response", log.response_unit), ("drive", log.drive_unit)):
        if controller["units"][kind] not in (None, unit):
            yield f"found {unit}, expected {controller['units'][kind]} as in controller.json"
    end = int((1 - LAST) * len(log))
    resting = _resting(log, end)
    if not len(resting) or resting[0] != 0 or not np.any(log.drive):
        yield f"found {log.drive[0]:g} {log.drive_unit} in its first row, expected it to begin at rest"
    if (rows := len(log) - resting[-1] - 1) < 19:
        yield f"found {rows} rows after the voltage rises, expected 20 or more"
    if not np.median(np.abs(log.response[end:])):
        yield "found no response at its end, expected the amplitude that was asked for"


def _resting(log: Log, end: int) -> np.ndarray:
    """Rows before the voltage rises, to bring the amplitude to where it is from row `end` on."""
    V, W = np.abs(log.drive), np.abs(log.response)
    steady = np.median(V[end:])
    flicker = 1.4826 * np.median(np.abs(V[end:] - steady))  # the standard deviation of normal noise
    risen = max(SHARE * np.max(V), min(FLICKER * flicker, RISEN * steady)) < V
    half = int(np.argmax(0.5 * np.median(W[end:]) < W))
    return np.flatnonzero(~risen[: max(half, int(np.argmax(risen)))])


def _swings(last: np.ndarray, row: float) -> tuple[float, tuple[float, float]]:
    """The standard deviation of noise, and how far it swings beside it and at how many Hz."""
    std = float(np.std(last))
    power = np.abs(np.fft.rfft((last - np.mean(last)) * np.hanning(len(last)))) ** 2
    k = int(np.argmax(power))
    share = float(np.sum(power[max(k - 1, 0) : k + 2]) / max(float(np.sum(power)), 1e-300))
    if share < TONAL or len(last) < SWINGING:
        return std, (0.0, 0.0)
    return std * math.sqrt(1 - min(share, 1.0)), (std * math.sqrt(2 * share), k / (len(last) * row))


def _settling(record: _Record) -> Finding | None:
    controller, log, target = record.controller, record.log, record.target
    started = _switched_on(record)
    begin = record.begin if started is None else started
    promised = controller["promise"]["settling_s" if started is None else "startup_s"]
    if promised is None:
        return None
    outside = np.flatnonzero(np.abs(record.W[begin:] - target) > BAND * target + NOISE * record.noise)
    last = begin + (int(outside[-1]) if len(outside) else 0)
    # The promise counts from when the amplitude was asked for, a latency before the voltage follows.
    taken = float(log.time[min(last + 1, len(log) - 1)] - log.time[begin])
    late = (controller.get("demodulator") or {}).get("delay_s", 0.0)  # by which what is recorded is
    kept = taken <= promised + record.row + controller["sample_time_s"] + late
    hint = "a slower plate (a finger?), a voltage at its limit, or more delay than was designed for"
    what = "settled to 5 %" if started is None else "switched on, to 5 %"
    return Finding(what, f"{1e3 * taken:.3g} ms", f"at most {1e3 * promised:.3g} ms", kept, hint)


def _switched_on(record: _Record) -> int | None:
    """The row at which the loop was switched on, where the record is of that: at first it holds the small
    amplitude with which it looks. Before, the voltage is zero, whatever the noise."""
    start, log, W = record.controller.get("start_up"), record.log, record.W
    if start is None or record.target < 2 * start["find"]:
        return None
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(W, ROWS), axis=1)
    there = int(np.argmax(smooth > 0.5 * start["find"]))
    looks = (log.time >= log.time[there]) & (log.time <= log.time[there] + 0.5 * start["settled_s"])
    small = 0.1 * start["find"] / abs(record.controller["plant"]["G"])
    resting = np.flatnonzero(np.abs(log.drive[: there + ROWS]) < small)
    holds = abs(float(np.median(W[looks])) / start["find"] - 1) < 0.5
    return int(resting[-1]) if len(resting) and holds else None


def _overshoot(record: _Record) -> Finding | None:
    promised, target = record.controller["promise"]["overshoot"], record.target
    if promised is None:
        return None
    most = max(float(np.max(record.W[record.begin :])) / target - 1, 0.0)
    kept = most <= promised + 0.01 + NOISE * record.noise / target
    hint = "more delay in the loop than latency_s says, or a sensor with another gain"
    expected = f"at most {100 * promised:.2g} %, and noise"
    return Finding("overshoot", f"{100 * most:.2g} %", expected, kept, hint)


def _steady(record: _Record) -> Finding | None:
    size, f = record.swing
    if not size:
        return None
    share, hint = size / record.target, "the loop oscillates, with more delay or gain than was designed for"
    found = f"swings by {100 * share:.2g} % at {f:.3g} Hz"
    hint += "; or what its sensor shows beside the plate does"
    return Finding("at the end", found, f"at most {100 * BAND:.2g} %", share <= BAND, hint)


def _delay(record: _Record) -> Finding | None:
    """From the recorded voltage to the reading that shows it: the lateness, gain and damping with which the
    plate's own equation, driven with that voltage, comes nearest to Wd. None where the record does not tell.

    A row holds the command of the step before, so that a sample of the designed delay is not seen in it."""
    controller, log, begin = record.controller, record.log, record.begin
    designed, T, tau = controller.get("delay_s"), controller["sample_time_s"], controller["plant"]["tau"]
    rows = slice(begin, begin + int(6 * tau / record.row) + 20)
    V, Wd = np.real(log.drive[rows]), log.response.real[rows]
    if designed is None or abs(record.row / T - 1) > 0.01 or len(Wd) < 20:
        return None
    expected = max(designed - T, 0.0)
    fine = np.repeat(V, FINE)  # the command holds from row to row
    best, lates = [], range(int(designed / T) * FINE + 5 * FINE)
    for damping in DAMPINGS:
        keep = math.exp(-T / FINE * (1 + damping) / tau)
        W = lfilter([1 - keep], [1.0, -keep], fine)
        for late in lates:
            shape = np.concatenate([np.zeros(late + 1), W])[: len(W) : FINE]
            gain = float(shape @ Wd) / max(float(shape @ shape), 1e-300)
            best.append((float(np.sum((Wd - gain * shape) ** 2)), late))
    left, late = min(best)
    if math.sqrt(left / len(Wd)) > TOLD * record.target or np.ptp(V) < TOLD * np.max(np.abs(V)):
        return None
    found, most = late * T / FINE, expected + MORE * T
    hint = f"{1e6 * (found - expected):.0f} us more than latency_s and the demodulator's delay:"
    hint += " state latency in the rig file; or rows hold their own commands, not those of the step before"
    return Finding("delay", f"{1e6 * found:.0f} us", f"at most {1e6 * most:.0f} us", found <= most, hint)


def _voltage(record: _Record) -> Finding:
    controller, V = record.controller, np.abs(record.log.drive)
    steady, most = float(np.median(V[record.end :])), float(np.max(V))
    expected = record.target / abs(controller["plant"]["G"])
    unit, ratio, limit = controller["units"]["drive"] or "", steady / expected, controller["voltage_limit"]
    beyond = limit is not None and most > limit * (1 + 1e-6)
    hint = f"{ratio:.3g} times as much: the plate is damped, beside its resonance, or the sensor's gain is"
    hint += " another"
    if beyond:
        hint = f"up to {most:.4g} {unit}, above the limit of {limit:.4g}"
    kept, said = abs(ratio - 1) <= NEAR_STEADY and not beyond, f"{expected:.4g} {unit} within 10 %"
    return Finding("voltage at the end", f"{steady:.4g} {unit}", said, kept, hint)


def _tracked(record: _Record) -> Finding:
    hb, last = record.half_bandwidth, np.mean(record.log.response[record.end :])
    beside = float(last.imag / last.real) * hb if last.real else math.inf
    hint = "the tracker is off or has not come so far; by Wq/Wd, a rotation of the sensor is not seen in it"
    kept, said = abs(beside) <= TRACKED * hb, f"within {TRACKED * hb:.3g} Hz"
    return Finding("resonance less frequency", f"{beside:+.3g} Hz", said, kept, hint)


def _beside(record: _Record) -> Finding:
    """The frequency at the end beside the plate's own: by Wq/Wd alone a sensor that is turned is not seen."""
    controller, log, hb = record.controller, record.log, record.half_bandwidth
    k_T, (low, high) = controller["plant"].get("k_T"), controller["range"]["warming_degC"]
    at = controller["reference_temperature_degC"]
    if log.temperature is not None and k_T is not None and at is not None:
        low = high = float(np.median(log.temperature[record.end :])) - at
    ends = sorted((k_T or 0.0) * warm for warm in (low, high))
    beside = float(np.median(log.frequency[record.end :])) - controller["plant"]["f0"]
    over = beside - min(max(beside, ends[0]), ends[1])
    turned = math.degrees(math.atan(over / hb))
    hint = f"a sensor or a drive that is late or turned, by {turned:+.0f} degrees;"
    hint += " or another temperature than that of the logs"
    expected = f"{ends[0] - TURNED * hb:+.3g} to {ends[1] + TURNED * hb:+.3g} Hz"
    return Finding("frequency less f0", f"{beside:+.4g} Hz", expected, abs(over) <= TURNED * hb, hint)


def _window(record: _Record) -> Finding:
    f, (low, high) = record.log.frequency, record.controller["frequency_window_Hz"] or (0.0, math.inf)
    seen, said = f"{np.min(f):.7g} to {np.max(f):.7g} Hz", f"{low:.7g} to {high:.7g} Hz"
    inside = bool(np.all((f >= low) & (f <= high)))
    return Finding("frequency", seen, said, inside, "beyond the window that was designed for")
