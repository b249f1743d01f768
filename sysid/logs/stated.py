"""Standard errors that a log states, a column beside its response: those of each row's response, per channel.

They say how the rows compare; how large they are altogether the residual tells, as of any log."""

import math
from collections.abc import Mapping

import numpy as np

from sysid.columns.plan import ERRORS, Plan, Source
from sysid.columns.signal import ORDERS, driven
from sysid.logs.missing import refuse_row
from sysid.tables import units
from sysid.tables.csvbody import Body
from sysid.tables.csvfile import Head, LogError
from sysid.tables.densities import amplitude_of, is_decibel
from sysid.tables.scattered import SCATTERED, steepness

WIDE = 1.2  # a ratio of frequencies, over which a displacement and its velocity differ by more than a gain
NEPER = math.log(10) / 20  # of a decibel
Arrays = Mapping[str, tuple[np.ndarray, str]]


def read_errors(values: np.ndarray, source: Source) -> tuple[np.ndarray, str]:
    """Numbers of a column of standard errors, and their unit: decibels are none of a level, and a share has
    no peak."""
    values = values * source.scale + source.offset
    share = is_decibel(source.unit) or _is_share(source.unit)
    return (values if share else values * units.PEAK.get(source.amplitude, 1.0)), source.unit


def stated_in(
    head: Head,
    body: Body,
    plan: Plan,
    rows: np.ndarray | None,
    arrays: dict[str, tuple[np.ndarray, str]],
) -> Arrays:
    """The standard errors among the `arrays`, which they leave. Raises LogError where one is not above
    zero."""
    stated = {name: arrays.pop(name) for name in ERRORS if name in arrays}
    for name, (values, _) in stated.items():
        if (values <= 0).any():
            row = int(np.argmax(values <= 0))
            refuse_row(head, body, plan.sources[name], rows, row, "a standard error above zero")
    return stated


def errors(
    where: str,
    plan: Plan,
    arrays: Arrays,
    stated: Arrays,
    frequency: np.ndarray | None,
    drive: tuple[np.ndarray | None, str],
) -> np.ndarray | None:
    """(n,) standard errors in the unit of the response, which `arrays` hold as it was recorded, under
    `drive`, its values and their unit; None where none are `stated`. Raises LogError where a unit does not
    fit."""
    if not stated:
        return None
    if plan.quantity in SCATTERED:
        raise LogError(f"{where}: found standard errors of a {plan.quantity}, expected none beside it")
    first = next(name for name in ("w", "wd", "x", "magnitude") if name in arrays)
    signal, unit = arrays[first]
    size = np.abs(signal)
    if first in ("wd", "x"):
        other, its = arrays["wq" if first == "wd" else "y"]
        size = np.hypot(signal, units.convert(other, its, unit))
    power = plan.sources[first].unit if amplitude_of(plan.sources[first].unit) else ""
    each = [_in(where, values, its, unit, size, power) for values, its in stated.values()]
    std = np.sqrt(np.mean(np.square(each), axis=0))
    return std if first in ("w", "wd") else std * _slope(plan, size, unit, frequency, drive)


def of_scattering(
    s: np.ndarray, plan: Plan, frequency: np.ndarray | None, drive: tuple[np.ndarray | None, str]
) -> np.ndarray:
    """(n,) standard errors of a response that is made of a scattering parameter, in which noise is even."""
    return driven(steepness(s, plan.metadata), "S", drive)[0] / (2 * np.pi * frequency)


def of_derivative(
    plan: Plan, arrays: Arrays, frequency: np.ndarray | None, drive: tuple[np.ndarray | None, str]
) -> np.ndarray | None:
    """(n,) those of a response over a wide sweep that is made of a velocity or an acceleration, in which
    noise is even; None of another, and of decibels, in which it is even."""
    order, name = ORDERS.get(plan.quantity, 0), next((n for n in ("x", "magnitude") if n in arrays), "")
    if not (order and name) or frequency is None or is_decibel(plan.sources[name].unit):
        return None
    if not 0 < WIDE * np.min(frequency) < np.max(frequency):
        return None
    factor = np.abs(driven(np.ones(len(frequency)), arrays[name][1], drive)[0])
    return factor / (2 * np.pi * frequency) ** order if np.all(factor > 0) else None


def _in(
    where: str, values: np.ndarray, unit: str, wanted: str, size: np.ndarray, power: str = ""
) -> np.ndarray:
    """Standard errors in the unit of the signal, which is the root of a column in the unit `power`, if
    any."""
    if is_decibel(unit):
        return NEPER * values * size
    if power and (units.same_kind(unit, power) or _is_share(unit)):  # of a square, d(w^2) = 2 w dw
        share = units.convert(values, unit, "1") if _is_share(unit) else None
        return size / 2 * share if share is not None else units.convert(values, unit, power) / (2 * size)
    if units.same_kind(unit, wanted):
        return units.convert(values, unit, wanted)
    if _is_share(unit):
        return units.convert(values, unit, "1") * size
    expected = power or wanted
    raise LogError(f"{where}: found standard errors in {unit}, expected {expected}, as its response, dB or %")


def _slope(
    plan: Plan,
    size: np.ndarray,
    unit: str,
    frequency: np.ndarray | None,
    drive: tuple[np.ndarray | None, str],
) -> np.ndarray | float:
    """By how much the response moves per unit of the signal that shows it (`signal.lock_in`)."""
    if plan.quantity != "impedance":
        factor = driven(np.ones_like(size), unit, drive)[0]
        order = ORDERS[plan.quantity]
        return factor if not order else factor / (2 * np.pi * frequency) ** order
    omega = 2 * np.pi * frequency
    return units.convert(1.0, unit, "ohm") / (units.convert(size, unit, "ohm") ** 2 * omega)


def _is_share(unit: str) -> bool:
    return unit in ("%", "1") or units.same_kind(unit, "1")
