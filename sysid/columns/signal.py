"""How numbers of a column become the response: decibels, impedances, currents and velocities."""

import re

import numpy as np

from sysid.columns.plan import ANGLES, Plan, Source, of_gravity, per_drive
from sysid.tables import units
from sysid.tables.csvfile import LogError
from sysid.tables.densities import amplitude_of, is_decibel, reference
from sysid.tables.scattered import RATIOS, SCATTERED, admittance

# How often what a signal shows is the time derivative of what moves, each of which is a factor j omega.
ORDERS = {"displacement": 0, "charge": 0, "velocity": 1, "current": 1, "acceleration": 2}


def lock_in(
    signal: np.ndarray,
    plan: Plan,
    frequency: np.ndarray | None,
    unit: str,
    where: str,
    drive: tuple[np.ndarray | None, str] = (None, "V"),
) -> tuple[np.ndarray, str]:
    """Wd + jWq and its unit from s = X + jY (or W from |s|, when `signal` is real), as the module's docstring
    says. `drive`: its values (n,) and their unit."""
    complete = np.iscomplexobj(signal)
    signal = turned(signal, plan, frequency) if complete else signal
    if plan.quantity == "impedance":
        signal, unit = _inverted(units.convert(signal, unit, "ohm"), where), "S"
    elif plan.quantity in SCATTERED:
        if not complete:
            said = f"found the magnitude alone of a {plan.quantity}, expected its phase or both parts"
            raise LogError(f"{where}: {said}")
        signal, unit = admittance(units.convert(signal, unit, "1"), plan.metadata, where), "S"
    signal, unit = driven(signal, unit, drive)
    order = ORDERS.get(plan.quantity, 1)
    if order and frequency is None:
        what = "the current through an impedance" if plan.quantity == "impedance" else f"a {plan.quantity}"
        raise LogError(f"{where}: found no frequency, expected one: {what} is divided by omega")
    for _ in range(order):
        signal, unit = signal / (2 * np.pi * frequency), _time_integral(unit)
    return (signal * 1j * (-1j) ** order if complete else signal), unit


def driven(signal: np.ndarray, unit: str, drive: tuple[np.ndarray | None, str]) -> tuple[np.ndarray, str]:
    """A signal that is stated by its drive, as it is under that: the current (A) of an admittance under its
    voltage, the voltage of a coil's impedance under its current, m/s of m/s/V; any other as it is."""
    values, its = drive
    if values is None or (of := per_drive(unit)) is None:
        return signal, unit
    ratio = {("A", "V"): "S", ("V", "A"): "ohm"}.get(of)
    signal = units.convert(signal, unit, ratio) if ratio else signal
    return signal * units.convert(values, its, of[1]), of[0]


def _time_integral(unit: str) -> str:
    """The unit of the time integral of a signal: C of A, m of m/s, m/s of m/s^2."""
    if current := re.fullmatch(r"([fpnumk]?)A", unit):
        return f"{current[1]}C"
    unit = re.sub(r"/s(\^2|\*\*2|²|2)", "/s/s", unit)
    return unit.removesuffix("/s") if unit.endswith("/s") else "s" if unit == "1" else f"{unit}*s"


def is_analysed(plan: Plan) -> bool:
    """Whether a response is a ratio as analysers measure it, an impedance, which of a coil in a magnet is its
    velocity, an admittance or of S."""
    shown = [plan.sources[name].unit for name in ("x", "magnitude") if name in plan.sources]
    of = {"current": "S", "velocity": "ohm"}.get(plan.quantity)
    return plan.quantity in RATIOS or (of is not None and any(units.is_of(unit, of) for unit in shown))


def _inverted(impedance: np.ndarray, where: str) -> np.ndarray:
    """1/Z in S of an impedance in ohm."""
    if not impedance.all():
        row = int(np.argmin(impedance != 0))
        raise LogError(
            f"{where}, row {row} (counted from 0): found an impedance of 0 ohm, expected one that can be"
            f" inverted"
        )
    return 1 / impedance


FEW = 6  # rows, of which fewer tell no circle: it has four numbers, and where it begins and ends


def turned(signal: np.ndarray, plan: Plan, frequency: np.ndarray | None = None) -> np.ndarray:
    """A complex signal, or Wd + jWq, with the sign of its phase and what is added to it as the mapping file
    says; where it does not say the sign, that by which the phase falls with the frequency, as it does where a
    response comes after its drive."""
    rises = frequency is not None and not plan.phase_sign and _area(signal, frequency) > 0
    signal = np.conj(signal) if rises or plan.phase_sign < 0 else signal
    return signal * np.exp(1j * plan.phase_offset) if plan.phase_offset else signal


def _area(signal: np.ndarray, frequency: np.ndarray) -> float:
    """Twice the area that a signal goes round counter-clockwise as the frequency goes up, closed by a chord:
    a resonance goes round clockwise, wherever the origin is. 0 at one frequency, and of few rows."""
    known = np.isfinite(signal) & np.isfinite(frequency)
    at, s = frequency[known], signal[known]
    if len(at) < FEW or np.ptp(at) == 0:
        return 0.0
    s = s[np.argsort(at, kind="stable")]
    return float(np.sum((s.conj() * np.roll(s, -1)).imag))


def decode(values: np.ndarray, source: Source) -> tuple[np.ndarray, str]:
    """Numbers of a source, as peak values in the returned unit; phases in rad, of power densities the root
    (of less than none, which `read` refuses, below zero)."""
    if source.scale != 1.0 or source.offset:
        values = values * source.scale + source.offset
    unit = source.unit
    if is_decibel(unit):
        values, unit = 10.0 ** (values / 20), reference(unit)
    if power := amplitude_of(unit):
        values, unit = np.sign(values) * np.sqrt(np.abs(values)), power
    gravity, behind = of_gravity(unit)
    if gravity:
        values, unit = units.convert(values, gravity, "m/s^2"), f"m/s^2{behind}"
    if unit in ("deg", "°"):
        values, unit = values * ANGLES["deg"], "rad"
    return (values if source.amplitude == "peak" else values * units.PEAK[source.amplitude]), unit
