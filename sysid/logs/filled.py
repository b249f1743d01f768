"""Rows that hold less than the others and are read all the same: a thermometer that is read less often, a
drive and a frequency that are written only while there is a drive, and points at 0 Hz."""

import dataclasses

import numpy as np

from sysid.columns.plan import Plan
from sysid.logs.missing import all_empty, placed, response_of
from sysid.tables import units
from sysid.tables.cells import listed
from sysid.tables.csvbody import Body
from sysid.tables.csvfile import Head

MOVES = 0.5  # of what the drive makes of the response, by which rows show that it is off
SOON, SLOWER = 1, 1.5  # rows; times those to a quarter of the way, those to half of it

Arrays = dict[str, tuple[np.ndarray, str]]


def filled(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays, kind: str | None
) -> Plan:
    """The plan with what is said of the cells that `arrays` get: temperatures between readings, a drive of 0
    and a frequency where the drive is off. Cells that hold anything else stay NaN, and are refused later."""
    plan = _temperature(head, body, plan, rows, arrays)
    if kind in ("steady", "waveform") or "time" not in arrays:
        return plan
    return _frequency(head, body, _drive(head, body, plan, rows, arrays), rows, arrays)


def without_direct(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays, kind: str | None
) -> tuple[np.ndarray | None, str]:
    """(n,) which rows are not at 0 Hz, and a note on those that are; None where all are kept."""
    if kind == "waveform" or "frequency" not in arrays:
        return None, ""
    settled = kind == "steady" or "time" not in arrays
    keep = not_direct(arrays["frequency"][0], settled)
    if keep is None:
        return None, ""
    numbers = np.flatnonzero(~keep) if rows is None else rows[~keep]
    return keep, direct(listed([placed(head, body, int(number)) for number in numbers]))


def not_direct(frequency: np.ndarray, settled: bool) -> np.ndarray | None:
    """(n,) which points of a sweep are not at 0 Hz, where no resonance is driven, and where a velocity says
    nothing of a displacement; None of a transient (not `settled`), and where all or none are."""
    keep = frequency != 0
    if keep.all() or not keep.any() or not (settled or np.all(np.diff(frequency) != 0)):
        return None
    return keep


def direct(where: str) -> str:
    """What is said of rows at 0 Hz."""
    return f"rows at 0 Hz are left out, as no resonance is driven there: {where}"


def driven_frequency(frequency: np.ndarray, drive: np.ndarray) -> np.ndarray | None:
    """(n,) frequencies of a transient, where nothing (0 or NaN) is recorded: in rows without a drive that of
    the last row with a drive, before all of them of the first; in driven rows that of those on both sides,
    where it is one. None where nothing is to be changed."""
    unknown = ~(np.abs(frequency) > 0)
    driven = np.flatnonzero((drive != 0) & ~unknown)
    if not len(driven) or not unknown.any():
        return None
    after = np.searchsorted(driven, np.arange(len(drive)))
    last, following = (frequency[driven[np.clip(after - k, 0, len(driven) - 1)]] for k in (1, 0))
    between = (after > 0) & (after < len(driven)) & (last == following)
    known = unknown & ((drive == 0) | between)
    return np.where(known, last, frequency) if known.any() else None


def of_the_driven(rows: int) -> str:
    """What is said of the frequency of rows that have none."""
    return (
        f"in {rows} rows no frequency is recorded; taken as that of the driven row before them, or of the"
        f" first"
    )


def _temperature(head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays) -> Plan:
    if not _is_empty_in_part(head, body, plan, rows, arrays, "temperature"):
        return plan
    label = plan.sources["temperature"].label
    values, unit = arrays["temperature"]
    known = np.isfinite(values)
    if not known.any():
        del arrays["temperature"]
        return _noted(plan, f"column {label} holds no number: no temperature is recorded")
    along = arrays["time"][0] if "time" in arrays else np.empty(0)
    if not (len(along) and np.isfinite(along).all() and (np.diff(along) >= 0).all()):
        along = np.arange(len(values), dtype=float)
    arrays["temperature"] = (np.interp(along, along[known], values[known]), unit)
    said = f"column {label} holds a number in {int(known.sum())} of {len(known)} rows"
    return _noted(plan, f"{said}: taken as linear between these, and as the nearest one before and after")


def _drive(head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays) -> Plan:
    name = next((name for name in units.DRIVES if name in arrays), None)
    if name is None or not _is_empty_in_part(head, body, plan, rows, arrays, name):
        return plan
    values, unit = arrays[name]
    if not _is_off(values, response_of(arrays)):
        return plan
    off = np.isnan(values)
    arrays[name] = (np.where(off, 0.0, values), unit)
    where = " and ".join(
        [*(["before the first"] if off[0] else []), *(["after the last"] if off[-1] else [])]
    )
    warning = (
        f"{head.name}: column {plan.sources[name].label} is empty in {int(off.sum())} rows {where} driven"
        f" one, where the response shows no drive: taken as 0; write 0 where the drive is off"
    )
    return dataclasses.replace(plan, warnings=(*plan.warnings, warning))


def _is_off(drive: np.ndarray, response: np.ndarray) -> bool:
    """Whether a drive (n,) that is NaN before and after its rows is off there: the response rests before it,
    or moves as it ends."""
    on = np.flatnonzero(np.isfinite(drive))
    if not len(on) or len(on) != on[-1] - on[0] + 1 or not np.all(drive[on]):
        return False
    before, within, after = response[: on[0]], response[on[0] : on[-1] + 1], response[on[-1] + 1 :]
    rest = np.nanmean(before) if np.isfinite(before).any() else 0.0
    made = MOVES * float(np.nanmax(np.abs(within - rest), initial=0.0))
    rests = not len(before) or float(np.nanmax(np.abs(before - rest), initial=0.0)) < made
    return rests and (not len(after) or _falls(np.abs(after - within[-1]), made))


def _falls(moved: np.ndarray, half: float) -> bool:
    """Whether a response has `moved` (n,) by half of what it was from the first rows on: e^{-t/tau} is half
    way there at 2.4 times the time of a quarter, while one that falls later is there at once."""
    there, begun = moved > half, moved > 0.5 * half
    first, quarter = int(np.argmax(there)), int(np.argmax(begun))
    return bool(there.any()) and (quarter <= SOON or first >= SLOWER * quarter)


def _frequency(head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays) -> Plan:
    name = next((name for name in units.DRIVES if name in arrays), None)
    if name is None or "frequency" not in arrays:
        return plan
    frequency, unit = arrays["frequency"]
    if np.isnan(frequency).any() and not _is_empty_in_part(head, body, plan, rows, arrays, "frequency"):
        return plan
    found = driven_frequency(frequency, arrays[name][0])
    if found is None:
        return plan
    arrays["frequency"] = (found, unit)
    return _noted(plan, of_the_driven(int(np.sum(~(found == frequency)))))


def _is_empty_in_part(
    head: Head, body: Body, plan: Plan, rows: np.ndarray | None, arrays: Arrays, name: str
) -> bool:
    """Whether cells of a quantity hold no number, and all of these are empty."""
    if name not in arrays or plan.sources[name].column is None:
        return False
    none = np.isnan(arrays[name][0])
    return bool(none.any()) and all_empty(head, body, plan, rows, {name: none}, blank=name != "temperature")


def _noted(plan: Plan, note: str) -> Plan:
    return dataclasses.replace(plan, notes=(*plan.notes, note))
