"""Limits of voltage, amplitude and frequency: what the logs have seen, unless others are stated; and whether
a rig can do what is asked of it, as a whole."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from controller.ensemble import Ensemble, Range, Span
from controller.plate import Plate, positive
from controller.rig import Rig
from sysid.asked import number

# limit over steady voltage at which 5 ms become 1.5 ms: for a promise whose amplitude is not stated
HEADROOM = 1.6
# of the amplitude, up to which a reading may go before it is a fault, and a converter must show it
CREST = 1.35
# of the amplitude, a count of the converter at most: two tenths of what a loop in lock may be off
FINE = 0.02
OFTEN = 4.0  # updates of the drive in a period of the carrier
Refusal = tuple[str, str, str]  # what, why, and the nearest that can be had


class Limits(NamedTuple):
    """Largest |V| (drive unit; None: no limit), the window of the drive frequency (Hz; None: no window), and
    where they come from."""

    voltage: float | None
    frequency: Span | None
    said: str


def range_of(plate: Plate, rig: Rig, finger: float | None, warming: Span | None) -> Range:
    """The stated range, else the rig's, else the untouched plate at its reference temperature."""
    force = rig.force if finger is None else None
    if finger is None:
        finger = rig.finger or 0.0 if force is None else _damping(plate, force)
    low, high = _warming(plate, rig) if warming is None else _pair("warming", warming)
    if not (math.isfinite(number("finger", finger)) and finger >= 0):
        raise ValueError(f"found finger = {finger:g}, expected the damping that a finger adds, zero or more")
    if (low, high) != (0.0, 0.0) and plate.k_T is None:
        raise ValueError(
            f"warming = ({low:g}, {high:g}) cannot be answered for: k_T is not determined; record a sweep"
            " at another temperature, or design for one temperature"
        )
    return Range(float(finger), 0.0 if finger == 0.0 else force, (float(low), float(high)))


def _pair(name: str, stated: Span) -> Span:
    """From and to, both finite. Raises ValueError."""
    try:
        low, high = (float(v) for v in stated)
        good = -math.inf < low <= high < math.inf
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ValueError(
            f"found {name} = {stated!r}, expected two numbers, from and to, the first no larger than the"
            " second"
        )
    return low, high


def _damping(plate: Plate, force: float) -> float:
    from sysid.rows.hold import contact

    if plate.finger.value is None:
        raise ValueError(
            f"force = {force:g} N says nothing of a finger: {plate.finger.why}; finger states its damping"
            f" itself"
        )
    return plate.finger.value * float(contact(force))


def _warming(plate: Plate, rig: Rig) -> Span:
    reference = getattr(plate.fit, "reference_temperature", None)
    if rig.coldest is None and rig.warmest is None:
        return 0.0, 0.0
    if reference is None:
        raise ValueError(
            "found coldest or warmest, expected logs whose temperature was recorded: there is no reference"
        )
    low, high = (reference if end is None else end for end in (rig.coldest, rig.warmest))
    return low - reference, high - reference


def amplitude_of(plate: Plate, limits: Limits, asked: float | None, finger: float, plants: Ensemble) -> float:
    """The amplitude of the promise. Refused if the voltage does not suffice for it under the finger; if none
    is asked for, one that leaves HEADROOM to the weakest of the plants."""
    if limits.voltage is None:
        return abs(plate.G) if asked is None else positive("amplitude", asked)
    if asked is None:
        return limits.voltage * float(np.min(np.abs(plants.push) / plants.rate)) / HEADROOM
    most = abs(plate.G) * limits.voltage / (1 + finger)
    if positive("amplitude", asked) > most * (1 + 1e-9):
        under = f" under a finger of {finger:g}" if finger else ""
        raise ValueError(
            f"amplitude = {asked:g} cannot be had: it needs"
            f" {asked * (1 + finger) / abs(plate.G):.4g}{under}, and the voltage"
            f" limit is {limits.voltage:g} ({limits.said}); the nearest that can be had is {most:.4g}"
        )
    return float(asked)


def limits_of(plate: Plate, rig: Rig, voltage: float | None, window: Span | None, warming: Span) -> Limits:
    """The stated limits, else the rig's, but no further than the logs have seen."""
    logs = [fitted.log for fitted in getattr(plate.fit, "logs", ())]
    driven = [float(np.max(np.abs(log.drive))) for log in logs if log.drive is not None]
    said = "stated" if voltage is not None else "the largest drive of the logs" if driven else "the rig's"
    seen = [v for v in (max(driven, default=None), rig.voltage_limit) if v is not None]
    if voltage is None:
        voltage = min(seen, default=None)
        said = "the rig's" if voltage is not None and voltage == rig.voltage_limit else said
    elif rig.voltage_limit is not None and number("voltage_limit", voltage) > rig.voltage_limit:
        most = f"{rig.voltage_limit:g} at most"
        raise ValueError(f"found voltage_limit = {voltage:g}, expected the rig's {most}")
    if voltage is not None:
        positive("voltage_limit", voltage)
    if plate.f0 is None:
        return Limits(voltage, None, said)
    window = _window(plate, rig, logs) if window is None else _pair("frequency_window", window)
    reached = sorted([plate.f0, *(plate.f0 + (plate.k_T or 0.0) * w for w in warming)])
    if window is not None and not (window[0] < reached[0] and reached[-1] < window[1]):
        raise ValueError(
            "the tracker cannot follow: over the stated temperatures the resonance goes from"
            f" {reached[0]:.6g} to {reached[-1]:.6g} Hz, and the frequency window is {window[0]:.6g} to"
            f" {window[1]:.6g} Hz (frequency_window, or a rig's lowest_frequency and highest_frequency,"
            f" state another){_coolest(plate, window, warming)}"
        )
    return Limits(voltage, window, said)


def _window(plate: Plate, rig: Rig, logs: Sequence[Any]) -> Span | None:
    """The rig's frequency window; an end not stated lies half a bandwidth beyond where logs were driven."""
    swept = [log.frequency for log in logs if log.frequency is not None]
    low, high = rig.lowest_frequency, rig.highest_frequency
    if swept:
        seen = np.concatenate([[plate.f0], *swept])
        low = float(seen.min()) - plate.half_bandwidth if low is None else low
        return low, float(seen.max()) + plate.half_bandwidth if high is None else high
    if (low is None) != (high is None):
        raise ValueError(
            "found one end of the frequency window, expected both: no log says at which frequencies it was"
            " driven"
        )
    return None if low is None or high is None else (low, high)


def _coolest(plate: Plate, window: Span, warming: Span) -> str:
    """The temperatures at which the resonance stays within a window, in words."""
    if not (plate.k_T and window[0] < plate.f0 < window[1]):
        return ""
    ends = sorted(0.99 * (edge - plate.f0) / plate.k_T for edge in window)
    low, high = (min(max(w, ends[0]), ends[1]) for w in warming)
    return f"; the nearest that can be had is warming = ({low:.3g}, {high:.3g})"


def check_rig(plate: Plate, rig: Rig, limits: Limits, amplitude: float) -> None:
    """Raises ValueError for the first of the rig's parts that cannot work with this plate, limit and
    amplitude: each refusal has its own cause, and the nearest that can be had."""
    for what, why, nearest in _refusals(plate, rig, limits, amplitude):
        raise ValueError(f"the rig cannot do it: {what}: {why}; the nearest that can be had is {nearest}")


def _refusals(plate: Plate, rig: Rig, limits: Limits, amplitude: float) -> Iterator[Refusal]:
    yield from _sensor(rig, amplitude)
    for name, part in (("dac.full_scale", rig.dac), ("inverter.supply", rig.inverter)):
        if part is not None and limits.voltage is not None and part.most < limits.voltage * (1 - 1e-9):
            why = f"it makes {part.most:.4g} at most, and the voltage limit is {limits.voltage:g}"
            yield name, why, f"voltage_limit = {part.most:.4g}"
    if plate.f0 is not None:
        yield from _clocks(rig, plate.f0, plate.half_bandwidth)


def _sensor(rig: Rig, amplitude: float) -> Iterator[Refusal]:
    if (adc := rig.adc) is None:
        return
    shown = amplitude * rig.shown.gain
    if adc.full_scale < CREST * shown:
        why = f"an amplitude of {amplitude:g} shows as {shown:g}, and up to {CREST:g} times as much has to be"
        why += " seen"
        most = adc.full_scale / CREST * amplitude / shown
        nearest = f"full_scale = {CREST * shown:.4g}, or amplitude = {most:.4g}"
        yield f"adc.full_scale = {adc.full_scale:g}", why, nearest
    if adc.unit > FINE * shown:
        why = f"a count is {adc.unit:.3g}, more than 2 % of what {amplitude:g} shows"
        least = math.ceil(math.log2(adc.full_scale / (FINE * shown)) + 1)
        yield f"adc.bits = {adc.bits:g}", why, f"bits = {least}"


def _clocks(rig: Rig, f0: float, half_bandwidth: float) -> Iterator[Refusal]:
    for name, clock, least in (("timer", rig.timer, 2 * f0), ("dds", rig.dds, 2.5 * f0)):
        if clock is not None and clock < least:
            why = f"it cannot make a carrier of {f0:.6g} Hz"
            yield f"{name} = {clock:g} Hz", why, f"{name} = {least:.4g} Hz"
    source: Any = rig.source(f0)
    if source is not None and 0.5 * source.step > half_bandwidth:
        why = f"half of the plate's bandwidth is {half_bandwidth:.3g} Hz, so that the resonance may lie"
        why += " beside all of them"
        nearest = f"frequency_step = {2 * half_bandwidth:.3g} Hz"
        if rig.timer is not None:
            nearest = f"timer = {f0 * f0 / (2 * half_bandwidth):.3g} Hz"
        yield f"frequencies {source.step:.4g} Hz apart", why, nearest
    if rig.adc is not None and rig.adc.rate * rig.sample_time < 1.0:
        why = f"a step every {rig.sample_time:g} s is less than a sample of the sensor"
        nearest = f"rate = {1 / rig.sample_time:.4g} Hz, or sample_time = {1 / rig.adc.rate:.3g} s"
        yield f"adc.rate = {rig.adc.rate:g} Hz", why, nearest
    if rig.drive_update is not None and rig.drive_update < OFTEN * f0:
        why = f"a carrier of {f0:.6g} Hz that is held from one to the next is no sine"
        yield f"drive_update = {rig.drive_update:g} Hz", why, f"drive_update = {OFTEN * f0:.4g} Hz"
