"""Whether a rig can do what a design asks of it, as a whole: each refusal has its own cause, and the nearest
that can be had."""

import math
from collections.abc import Iterator
from typing import Any

from controller.limits import Limits
from controller.plate import Plate
from controller.rig import Rig

# of the amplitude, up to which a reading may go before it is a fault, and a converter must show it
CREST = 1.35
# of the amplitude, a count of the converter at most: two tenths of what a loop in lock may be off
FINE = 0.02
OFTEN = 4.0  # updates of the drive in a period of the carrier
Refusal = tuple[str, str, str]  # what, why, and the nearest that can be had


def checked(plate: Plate, rig: Rig, limits: Limits, amplitude: float) -> None:
    """Raises ValueError for the first of the rig's parts that cannot work with this plate, limit and
    amplitude."""
    for what, why, nearest in _refusals(plate, rig, limits, amplitude):
        raise ValueError(f"the rig cannot do it: {what}: {why}; the nearest that can be had is {nearest}")


def _refusals(plate: Plate, rig: Rig, limits: Limits, amplitude: float) -> Iterator[Refusal]:
    yield from _sensor(rig, amplitude)
    for name, part in (("dac.full_scale", rig.dac), ("inverter.supply", rig.inverter)):
        if part is not None and limits.voltage is not None and part.most < limits.voltage * (1 - 1e-9):
            why = f"it makes {part.most:.4g} at most, and the voltage limit is {limits.voltage:g}"
            yield name, why, f"voltage_limit = {part.most:.4g}"
    if plate.f0 is not None:
        yield from _source(rig, plate.f0, 1 / (2 * math.pi * plate.tau))
        yield from _rates(rig, plate.f0)


def _sensor(rig: Rig, amplitude: float) -> Iterator[Refusal]:
    if (adc := rig.adc) is None:
        return
    shown = amplitude * (1.0 if rig.sensor is None else rig.sensor.gain)
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


def _source(rig: Rig, f0: float, half_bandwidth: float) -> Iterator[Refusal]:
    for name, clock, least in (("timer", rig.timer, 2 * f0), ("dds", rig.dds, 2.5 * f0)):
        if clock is not None and clock < least:
            why = f"it cannot make a carrier of {f0:.6g} Hz"
            yield f"{name} = {clock:g} Hz", why, f"{name} = {least:.4g} Hz"
    source: Any = rig.source(f0)
    if source is not None and 0.5 * source.step > half_bandwidth:
        why = (
            f"half of the plate's bandwidth is {half_bandwidth:.3g} Hz, so that the resonance may lie beside"
            " all of them"
        )
        nearest = f"frequency_step = {2 * half_bandwidth:.3g} Hz"
        if rig.timer is not None:
            nearest = f"timer = {f0 * f0 / (2 * half_bandwidth):.3g} Hz"
        yield f"frequencies {source.step:.4g} Hz apart", why, nearest


def _rates(rig: Rig, f0: float) -> Iterator[Refusal]:
    if rig.adc is not None and rig.adc.rate * rig.sample_time < 1.0:
        why = f"a step every {rig.sample_time:g} s is less than a sample of the sensor"
        nearest = f"rate = {1 / rig.sample_time:.4g} Hz, or sample_time = {1 / rig.adc.rate:.3g} s"
        yield f"adc.rate = {rig.adc.rate:g} Hz", why, nearest
    if rig.drive_update is not None and rig.drive_update < OFTEN * f0:
        why = f"a carrier of {f0:.6g} Hz that is held from one to the next is no sine"
        yield f"drive_update = {rig.drive_update:g} Hz", why, f"drive_update = {OFTEN * f0:.4g} Hz"
