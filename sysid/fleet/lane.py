"""The fast lane: plates that are recorded alike are fitted together; what that does not cover goes to
`sysid.fit`, plate by plate, and the row says which way it went and why.

A layout is what decides how a plate's logs are read: their kinds, rows and inputs. Drives and frequencies
that are one number in a log may differ from plate to plate. Rows of the batch are those of `sysid.fit` with
the normal approximation of the posterior.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sysid.fleet.groups import Group
from sysid.fleet.plate import Row, read, read_ahead, row_of
from sysid.fleet.settings import Settings

if TYPE_CHECKING:
    from sysid.fleet.batch import Batch
    from sysid.fleet.cells import Cells
    from sysid.fleet.closed import Block
    from sysid.fleet.screen import Screened
    from sysid.logs.log import Log
    from sysid.verdict.differing import Said

LEAST_ROWS = 40  # of a log, of which its noise can be told
Plate = tuple[Group, "list[Log]"]


def rows_of(
    batch: Sequence[Group], settings: Settings, begin: Callable[[Group], None] = lambda group: None
) -> Iterator[Row]:
    """The rows of a batch, not in its order. `begin` is given each plate as it is fitted by itself, and the
    first of those that are fitted together."""
    alone: list[Group] = []
    for rows in rows_together(batch, settings, alone.append, begin):
        yield from rows
    yield from rows_alone(alone, settings, begin)


def rows_alone(groups: Sequence[Group], settings: Settings, begin: Callable[[Group], None]) -> Iterator[Row]:
    """The rows of plates that are fitted by themselves."""
    for group in groups:
        begin(group)
        yield row_of(group, settings, why=group.alone or "")


def rows_together(
    batch: Sequence[Group],
    settings: Settings,
    passed: Callable[[Group], None],
    begin: Callable[[Group], None],
) -> Iterator[list[Row]]:
    """The rows of the plates of a batch that are fitted with others; each other one is `passed` on, with the
    reason why."""
    alike: dict[tuple, list[Plate]] = {}
    closed = settings.alone
    if not closed and settings.columns is None and batch:
        begin(batch[0])
        read_ahead([item for group in batch if not group.refused for item in group.logs])
    for group in batch:
        found: tuple | str = closed
        if not closed and not group.refused:
            begin(group)
            try:
                logs = read(group.logs, settings.columns)
                found = layout(logs)
                if isinstance(found, tuple):
                    alike.setdefault(found, []).append((group, logs))
                    continue
            except Exception:  # `row_of` says what it is, in the plate's row
                found = ""
        passed(replace(group, alone=str(found)))
    for key, plates in alike.items():
        size = together(plates[0][1])
        for k in range(0, len(plates), size):
            begin(plates[k][0])
            yield from _rows(key, plates[k : k + size], settings, passed)


def together(logs: "Sequence[Log]") -> int:
    """How many plates with such logs are fitted at once."""
    from sysid.fleet.arrays import here

    return max(min(here().plates, here().rows // max(map(len, logs))), 1)


def layout(logs: "Sequence[Log]") -> tuple | str:
    """What plates have in common that are recorded alike; a sentence where the batch does not cover these
    logs."""
    from sysid.trials.trial import LEAST_WARMING

    if sorted(log.kind or "" for log in logs) not in (["steady"], ["transient"], ["steady", "transient"]):
        return "its logs are not a step, a sweep, or one of each"
    keys = [_layout(log) for log in logs]
    if said := next((key for key in keys if isinstance(key, str)), None):
        return said
    warm = [log.temperature for log in logs if log.temperature is not None]
    if warm and max(map(np.max, warm)) - min(map(np.min, warm)) > LEAST_WARMING:
        return "its temperature changes"
    return tuple(keys)


def _layout(log: "Log") -> tuple | str:
    """That of one log."""
    bench = {name for name, value in log.bench.items() if (name, value) != ("delay_s", 0.0)}
    given = log.warnings or bench - {"temperature_std_degC"} or log.force is not None
    given = given or log.theta is not None or log.std is not None
    if log.amplitude_only or log.drive is None or log.frequency is None or given or log.relative_noise:
        return "its logs hold other columns or metadata than drive, frequency, d and q"
    if len(log) < LEAST_ROWS:
        return "its logs are short"
    driven = np.flatnonzero(log.drive)
    drive = log.drive[driven[0] :] if len(driven) else log.drive
    if not len(driven) or np.any(drive != drive[0]):
        return "its drive is not one level"
    common = (log.kind, len(log), log.response_unit, log.drive_unit, log.temperature is not None, *log.bench)
    if log.kind == "steady":
        return (*common, log.frequency.tobytes()) if len(drive) == len(log) else "its drive is not one level"
    if np.any(log.frequency != log.frequency[0]) or log.time is None:
        return "its frequency changes"
    if log.sampling is None:
        return "its sampling is not stated"
    row = int(driven[0]) - (log.sampling == "settled")
    if row < 2 or row > len(log) - LEAST_ROWS // 2:
        return "its logs do not show a step behind a rest"
    return (*common, log.sampling, row, (log.time - log.time[0]).tobytes())


def _blocks(logs: "Sequence[Sequence[Log]]") -> "list[Block]":
    """The logs of plates of one layout, stacked, a block for each log of a plate."""
    from sysid.fleet.closed import Step, Sweep

    blocks: list[Block] = []
    for each in zip(*logs, strict=True):
        first, response = each[0], np.stack([log.response for log in each])
        drive, timed = np.array([log.drive[-1] for log in each]), "delay_s" in first.bench
        if first.kind == "steady":
            blocks.append(Sweep(first.frequency, drive, response, timed))
        else:
            row = int(np.flatnonzero(first.drive)[0]) - (first.sampling == "settled")
            blocks.append(
                Step(first.time, row, drive, np.array([log.frequency[0] for log in each]), response, timed)
            )
    return blocks


_cells: dict[tuple, "Cells"] = {}  # of the layouts that this process has met


def cells_of(key: tuple, logs: "Sequence[Log]") -> "Cells":
    """Those of a layout, of which `logs` are a plate's."""
    from sysid.fleet.cells import Cells

    if key not in _cells:
        _cells[key] = Cells(logs, _blocks([logs]))
    return _cells[key]


def _rows(
    key: tuple, plates: Sequence[Plate], settings: Settings, passed: Callable[[Group], None]
) -> Iterator[list[Row]]:
    """The rows of plates of one layout; those that are for `sysid.fit` are `passed` on."""
    from sysid.fleet.told import told
    from sysid.precision import one_thread

    started = time.perf_counter()
    cells = cells_of(key, plates[0][1])
    try:
        batch, lefts, seen, said = one_thread(_judged)(plates, cells, settings.plates)
    except np.linalg.LinAlgError:  # of a plate whose rows tell nothing
        half = len(plates) // 2
        for part in (plates[:half], plates[half:]) if half else ():
            yield from _rows(key, part, settings, passed)
        if not half:
            passed(replace(plates[0][0], alone="its rows tell nothing"))
        return
    why = seen.why[: len(plates)]
    left = [
        f * x.noise(batch.step, x.values(batch.step))[:, None] for f, x in zip(lefts, batch.logs, strict=True)
    ]
    good = np.flatnonzero(why == "").tolist()
    rows = told(batch, good, plates, left, said, seen, cells, settings)
    each = round((time.perf_counter() - started) / len(plates), 6)
    yield [{**row, "seconds": each} for row in rows]
    for p in np.flatnonzero(why != "").tolist():
        passed(replace(plates[p][0], alone=str(why[p])))


def _judged(
    plates: Sequence[Plate], cells: "Cells", of: int
) -> "tuple[Batch, list[np.ndarray], Screened, list[list[Said]]]":
    """The fits of plates of one layout; what each leaves of its logs, and whether it goes to `sysid.fit`; and
    what is said of logs that differ. `of`: so many plates of the run."""
    from sysid.fleet.arrays import padded
    from sysid.fleet.delayed import spanned
    from sysid.fleet.differ import dispersion, widened
    from sysid.fleet.screen import residual, screened, vague

    plates = padded(plates)
    names = [[log.name for log in logs] for _, logs in plates]
    with np.errstate(all="ignore"):
        fit = fit_together(plates)
        own, left = dispersion(fit, names), [residual(log, fit.step) for log in fit.logs]
        std = np.sqrt(np.einsum("pii->pi", fit.covariance))
        wider = np.sqrt(1 + np.einsum("pii->pi", own[0]) / std**2)
        seen = screened(fit, left, cells, wider, of)
        batch = spanned(fit, names)
        if batch is not fit:
            own, left = dispersion(batch, names), [residual(log, batch.step) for log in batch.logs]
        added, said = own
        batch = widened(batch, added + seen.spans * std[:, :, None] * std[:, None])
        return batch, left, seen._replace(why=np.where(seen.why == "", vague(batch), seen.why)), said


def fit_together(plates: Sequence[Plate]) -> "Batch":
    """The fits of plates of one layout."""
    from sysid.fleet.batch import fitted
    from sysid.precision import one_thread

    return one_thread(fitted)(_blocks([logs for _, logs in plates]))
