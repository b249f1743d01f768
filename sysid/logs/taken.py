"""What a file was taken for: which column is what, what is constant, and the logs that it holds."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sysid.columns.mapfile import load_mapping
from sysid.columns.plan import Plan
from sysid.logs.log import Log
from sysid.logs.opening import groups, opened
from sysid.logs.read import logs_in, of_one_bench, tabled
from sysid.tables.csvfile import Head, LogError


@dataclass(frozen=True)
class Taken:
    """One file, or the several of one capture: its `head` and `plan` and the `logs` that were read from it,
    or the `error` for which it is refused, with what was known of it before."""

    path: str
    head: Head | None = None
    plan: Plan | None = None
    logs: tuple[Log, ...] = ()
    error: LogError | None = None


def taken(
    paths: str | Path | Iterable[str | Path], columns: str | Path | None = None
) -> tuple[list[Taken], LogError | None]:
    """What `read_logs` takes each file for, and why it refuses all of them together where each one is read.

    Raises LogError where there are no files, or the mapping file is none."""
    mapping = None if columns is None else load_mapping(columns)
    found = []
    for group in groups(paths, mapping):
        path, head, plan = next(iter(group.values())), None, None
        try:
            with opened(group, mapping) as head:
                head, of, plan, body = tabled(head, mapping)
                found.append(Taken(path, head, plan, tuple(logs_in(head, of, plan, body))))
        except LogError as error:
            found.append(Taken(path, head, plan, error=error))
    if any(file.error for file in found):
        return found, None
    try:
        of_one_bench([log for file in found for log in file.logs])
    except LogError as error:
        return found, error
    return found, None
