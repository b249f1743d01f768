"""The fit of many plates: `fit_fleet`, which the command `sysid fleet` calls too."""

import os
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.asked import number
from sysid.fleet.engine import Dask, Engine, Here, Processes
from sysid.fleet.groups import PLATE, Group, grouped
from sysid.fleet.parts import Parts
from sysid.fleet.plate import Row
from sysid.fleet.settings import Settings

if TYPE_CHECKING:
    import pandas as pd

PARTS, PLATES = "parts", "plates"  # folders of the rows so far, and of each plate's own files


def fit_fleet(
    groups: Any,
    *,
    by: str = PLATE,
    folder: str | Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    lane: bool = True,
    accuracy: str = "quick",
    full: bool = False,
    shrink: bool = False,
    seed: int = 0,
    columns: str | Path | None = None,
    nuisances: Sequence[str] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    reference_temperature: float = 24.0,
    meanwhile: Callable[[int, int], None] | None = None,
) -> "pd.DataFrame":
    """Fit many plates, each from its own logs, and judge them as a lot: a DataFrame, one row a plate.

    `groups`: a mapping from a plate's name to its logs (Logs, or paths of files); a sequence of such logs,
    each of one plate; or files, folders and patterns, whose logs are parted `by` the "plate" that they state,
    by "folder", or by a regular expression with one group that is searched for in the file's name. `folder`:
    where the table, its report and the parts of it go, by which a later call goes on with what is not done;
    `full`: with each plate's own set of files in it. `jobs`: processes of this machine (None: one for each
    core; 0: this process alone); `scheduler`: the address of a Dask scheduler instead. `lane`: fit plates
    that are recorded alike together, where nothing but plate, bench and white noise shows, and each of the
    others by itself; else each by itself. `shrink`: with further columns, p_pooled and p_pooled_std of each
    parameter p, what a plate that is not odd has by its own logs and by the lot. What is left is told to each
    plate's fit: see `sysid.fit`, `sysid.sample` and, for `columns`, `sysid.read_logs`. `meanwhile`:
    is given how many plates are done, and of how many, as it goes on.

    A plate whose logs cannot be read is a row with the reader's sentence under `error`; files of a folder
    that hold no table are in `attrs["left_out"]`. Raises LogError where there is nothing to fit, OSError
    where the folder cannot be written, ValueError for a setting that is none.
    """
    from sysid.columns.mapfile import load_mapping
    from sysid.model.prior import checked

    _check(nuisances or ())
    if full and folder is None:
        raise ValueError("found full=True without a folder, expected where the plates' own files go")
    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()) if folder is None else folder)
        own = str(place.absolute() / PLATES) if full else None
        mapping = None if columns is None else str(columns)
        told = (None if nuisances is None else tuple(nuisances)), checked(priors or {})
        settings = Settings(accuracy, seed, mapping, *told, reference_temperature, own, lane)
        engine, aside = _engine(jobs, scheduler), list[str]()
        read_by = None if mapping is None else load_mapping(mapping)
        plates = grouped(groups, by, read_by, None if folder is None else place, aside)
        settings = settings.of_run(len(plates))
        if folder is not None:
            import sysid.fleet.page  # noqa: F401  while processes load what they need
        parts = Parts(place / PARTS)
        frame = _fitted(plates, settings, parts, engine, meanwhile)
        frame.attrs["left_out"] = aside
        rows = lambda plates: parts.of(plates, settings)  # noqa: E731
        return _finished(frame, rows, None if folder is None else place, full, shrink)


def _fitted(
    plates: Sequence[Group],
    settings: Settings,
    parts: Parts,
    engine: Engine,
    meanwhile: Callable[[int, int], None] | None,
) -> "pd.DataFrame":
    """The table of all plates, of which those that are in the parts already are not fitted again."""
    from sysid.fleet.table import Told

    told, done = Told(), set[str]()

    def add(rows: Sequence[Row]) -> None:
        told.add(rows)
        done.update(row["plate"] for row in rows)

    for rows in parts.done(plates, settings):
        add(rows)
    left = [group for group in plates if group.plate not in done]
    for rows in engine.rows(left, settings) if left else ():
        parts.write(rows)
        add(rows)
        if meanwhile is not None:
            meanwhile(len(done), len(plates))
    return told.framed([group.plate for group in plates])


def _check(nuisances: Sequence[str]) -> None:
    """Raise ValueError where one of these is none."""
    if nuisances:  # what names them takes a second to load
        from sysid.effects.registry import ADOPTED
        from sysid.trials.extra import EXTRA
        from sysid.trials.trial import NUISANCES

        if unknown := {*nuisances} - {*NUISANCES, *EXTRA, *ADOPTED}:
            raise ValueError(f"found {', '.join(sorted(unknown))}, expected nuisances that sysid.fit knows")


def _engine(jobs: int | None, scheduler: str | None) -> Engine:
    if scheduler is not None:
        return Dask(scheduler)
    if jobs is not None and number("jobs", jobs) < 0:
        raise ValueError(f"found {jobs} jobs, expected 0 or more")
    jobs = cores() if jobs is None else jobs
    return Processes(jobs) if jobs else Here()


def cores() -> int:
    """Cores that this process may use."""
    usable = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(usable(0)) if usable else os.cpu_count() or 1


def _finished(
    frame: "pd.DataFrame",
    rows: Callable[[Collection[str]], Mapping[str, Row]],
    folder: Path | None,
    full: bool,
    shrink: bool,
) -> "pd.DataFrame":
    """The table with what is known of its lot, and its files in the folder; `rows` gives those of plates."""
    from sysid.fleet.lot import with_pooled
    from sysid.fleet.odd import with_odd
    from sysid.fleet.table import CSV, PARQUET, as_csv, as_parquet

    frame, found = with_odd(frame)
    if shrink:
        frame = with_pooled(frame, found)
    if folder is not None:
        from sysid.command.outputs import add
        from sysid.fleet.page import PAGE, pictured, render

        drawn = {at: frame["plate"].iloc[at] for at in pictured(frame)}
        told = rows({*drawn.values()})
        shown = {at: told.get(plate, {}) for at, plate in drawn.items()}
        page = render(frame, found, shown, PLATES if full else None)
        files = {PAGE: page.encode(), CSV: as_csv(frame)}
        with suppress(ImportError):  # the extra fleet
            files[PARQUET] = as_parquet(frame)
        add(folder, files)
        frame.attrs["files"] = list(files)
    return frame
