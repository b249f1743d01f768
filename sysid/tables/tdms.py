"""TDMS files of LabVIEW: a group is a table, its channels are the columns, properties are constants."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from sysid.tables.store import Store, library
from sysid.tables.textfile import LogError

# The step of a channel's rows and where they begin, and in what: a spectrum's are no times.
AXIS = ("wf_increment", "wf_start_offset", "wf_xunit_string", "wf_xname")


def read_tdms(path: str, kind: str) -> Store:
    """The contents of a TDMS file. Raises LogError where it is damaged, cut off, or claims too many
    samples."""
    nptdms, store = library("nptdms", path, kind, "tdms"), Store(path, kind)
    said: list[str] = []
    try:
        with _heard(nptdms.log.log_manager.console_handler, said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for group in nptdms.TdmsFile.read_metadata(path).groups():
                for channel in group.channels():
                    store.claim(f"{group.name}/{channel.name}", len(channel))
            store.claimed = 0
            _enter(store, nptdms.TdmsFile.read(path))
    except LogError:
        raise
    except Exception as error:  # the library answers damaged files with errors of many types
        said = [f"{type(error).__name__}: {error}"]
    if said:
        expected = "one that was written to its end"
        raise LogError(f"{path}: found a damaged TDMS file ({said[0][:200]}), expected {expected}")
    return store


@contextmanager
def _heard(console: logging.Handler, said: list[str]) -> Iterator[None]:
    """What the library logs as warnings, of a file that is cut off say, put into `said` rather than on its
    console."""
    log, handler, level = logging.getLogger("nptdms"), logging.Handler(logging.WARNING), console.level
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    propagate, log.propagate = log.propagate, False
    console.setLevel(logging.CRITICAL + 1)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        console.setLevel(level)
        log.propagate = propagate


def _enter(store: Store, file: Any) -> None:
    axes = set()
    for item in (file, *file.groups()):
        for key, value in item.properties.items():
            if isinstance(value, str | int | float):
                store.add("", key, np.asarray(value))
    for group in file.groups():
        for channel in group.channels():
            unit = channel.properties.get("unit_string", "")
            axes.add(tuple(channel.properties.get(key) for key in AXIS))
            store.add(group.name, channel.name, channel[:], unit if isinstance(unit, str) else "")
    step, start, unit, name = next(iter(axes)) if len(axes) == 1 else (None,) * 4
    if not (isinstance(step, int | float) and step > 0):
        return
    if str(unit).endswith("Hz") or str(name).casefold() == "frequency":
        for table, columns in store.tables.items():
            count = len(next(iter(columns.values())))
            store.add(table, "frequency", (start or 0.0) + step * np.arange(count), str(unit or "Hz"))
    else:
        store.constants["sample_rate_Hz"] = f"{1 / step:.12g}"
