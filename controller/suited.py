"""Whether a rig can do what a design asks of it, as a whole: each refusal has its own cause, and the nearest
that can be had."""

import math
from typing import Any

from controller.limits import Limits
from controller.plate import Plate
from controller.rig import Rig

# of the amplitude, up to which a reading may go before it is a fault, and a converter must show it
CREST = 1.35
# of the amplitude, a count of the converter at most: two tenths of what a loop in lock may be off
FINE = 0.02
OFTEN = 4.0  # updates of the drive in a period of the carrier


def checked(plate: Plate, rig: Rig, limits: Limits, amplitude: float) -> None:
    """Raises ValueError for the first of the rig's parts that cannot work with this plate, limit and
    amplitude."""
    _sensor(rig, amplitude)
    _drive(rig, limits)
    if plate.f0 is not None:
        _source(rig, plate.f0, 1 / (2 * math.pi * plate.tau))
        _rates(rig, plate.f0)


def _refuse(what: str, why: str, nearest: str) -> None:
    raise ValueError(f"the rig cannot do it: {what}: {why}; the nearest that can be had is {nearest}")


def _sensor(rig: Rig, amplitude: float) -> None:
    if rig.adc is None:
        return
    shown = amplitude * (1.0 if rig.sensor is None else rig.sensor.gain)
    if rig.adc.full_scale < CREST * shown:
        _refuse(
            f"adc.full_scale = {rig.adc.full_scale:g}",
            f"an amplitude of {amplitude:g} shows as {shown:g}, and up to {CREST:g} times as much has to be"
            f" seen",
            f"full_scale = {CREST * shown:.4g}, or amplitude ="
            f" {rig.adc.full_scale / CREST * amplitude / shown:.4g}",
        )
    if rig.adc.unit > FINE * shown:
        least = math.ceil(math.log2(rig.adc.full_scale / (FINE * shown)) + 1)
        _refuse(
            f"adc.bits = {rig.adc.bits:g}",
            f"a count is {rig.adc.unit:.3g}, more than 2 % of what {amplitude:g} shows",
            f"bits = {least}",
        )


def _drive(rig: Rig, limits: Limits) -> None:
    limit = limits.voltage
    if limit is None:
        return
    for name, most in (
        ("dac.full_scale", rig.dac and rig.dac.full_scale),
        ("inverter.supply", rig.inverter and rig.inverter.most),
    ):
        if most is not None and most < limit * (1 - 1e-9):
            _refuse(
                f"{name}",
                f"it makes {most:.4g} at most, and the voltage limit is {limit:g}",
                f"voltage_limit = {most:.4g}",
            )


def _source(rig: Rig, f0: float, half_bandwidth: float) -> None:
    for name, clock in (("timer", rig.timer), ("dds", rig.dds)):
        least = 2.5 * f0 if name == "dds" else 2 * f0
        if clock is not None and clock < least:
            _refuse(
                f"{name} = {clock:g} Hz",
                f"it cannot make a carrier of {f0:.6g} Hz",
                f"{name} = {least:.4g} Hz",
            )
    source: Any = rig.source(f0)
    if source is not None and 0.5 * source.step > half_bandwidth:
        if rig.timer is not None:
            needed = f"timer = {f0 * f0 / (2 * half_bandwidth):.3g} Hz"
        else:
            needed = f"frequency_step = {2 * half_bandwidth:.3g} Hz"
        _refuse(
            f"frequencies {source.step:.4g} Hz apart",
            f"half of the plate's bandwidth is {half_bandwidth:.3g} Hz, so that the resonance may lie"
            f" beside all of them",
            needed,
        )


def _rates(rig: Rig, f0: float) -> None:
    if rig.adc is not None and rig.adc.rate * rig.sample_time < 1.0:
        _refuse(
            f"adc.rate = {rig.adc.rate:g} Hz",
            f"a step every {rig.sample_time:g} s is less than a sample of the sensor",
            f"rate = {1 / rig.sample_time:.4g} Hz, or sample_time = {1 / rig.adc.rate:.3g} s",
        )
    if rig.drive_update is not None and rig.drive_update < OFTEN * f0:
        _refuse(
            f"drive_update = {rig.drive_update:g} Hz",
            f"a carrier of {f0:.6g} Hz that is held from one to the next is no sine",
            f"drive_update = {OFTEN * f0:.4g} Hz",
        )
