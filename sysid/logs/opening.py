"""From paths and patterns to the heads of files, or of captures that are in several files each."""

import contextlib
import csv
import glob
import lzma
import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from sysid.asked import every
from sysid.columns.mapping import MappingFile
from sysid.logs.capture import captures, side_by_side
from sysid.tables.cells import Dialect
from sysid.tables.csvfile import Head, LogError
from sysid.tables.head import open_head
from sysid.tables.textfile import parts, unchanged
from sysid.tables.workbook import file_of


def groups(paths: str | Path | Iterable[str | Path], mapping: MappingFile | None) -> list[dict[str, str]]:
    """The files to read, each once: of each the path, or of each capture of several the paths by the patterns
    that the mapping file has for them. Raises LogError."""
    paths = every("paths", paths, str | Path, "the path of a file, a pattern, or several of these")
    files = list(dict.fromkeys(expanded(paths)))
    return captures(files, mapping) if mapping and mapping.files else [{"": path} for path in files]


@contextlib.contextmanager
def opened(group: dict[str, str], mapping: MappingFile | None) -> Iterator[Head]:
    """The head of a file, or of the several of one capture, which must not change while they are read. Raises
    LogError."""
    path = next(iter(group.values()))
    for part in group.values():
        _check_file(part)
    try:
        with (
            contextlib.ExitStack() as stack,
            np.errstate(all="ignore"),
        ):  # a log refuses what is not finite
            for part in group.values():
                stack.enter_context(unchanged(part))
            several = mapping is not None and bool(mapping.files)
            yield (
                side_by_side(group, mapping)
                if several
                else open_head(path, mapping.dialect if mapping else Dialect())
            )
    except (OSError, EOFError, zlib.error, lzma.LZMAError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read: {error}") from None


def expanded(paths: Iterable[str | Path]) -> list[str]:
    """The files that patterns such as `logs/*.csv` stand for."""
    files: list[str] = []
    for path in map(str, paths):
        plain = os.path.exists(file_of(path)) or not glob.has_magic(path)
        found = [path] if plain else sorted(glob.glob(path, recursive=True))
        if not found:
            raise LogError(f"{path}: found no file that fits this pattern, expected at least one")
        files += (part for file in found for part in parts(file))
    if not files:
        raise LogError("found no logs, expected at least one file")
    return files


def _check_file(path: str) -> None:
    """Raise LogError where a path is not that of a file."""
    file = file_of(path)
    if os.path.isdir(file):
        instead = f"give {path.rstrip('/')}/*.csv for all logs in it"
        raise LogError(f"{path}: found a directory, expected a file; {instead}")
    if not os.path.isfile(file):
        found = "a pipe, a socket or a device" if os.path.exists(file) else "no such file"
        raise LogError(f"{path}: found {found}, expected a log")
