"""TDMS files of LabVIEW: a group is a table, its channels are the columns, properties are constants."""

import warnings
from typing import Any

import numpy as np

from sysid.logs.store import Store, library
from sysid.logs.textfile import LogError


def read_tdms(path: str, kind: str) -> Store:
    """The contents of a TDMS file. Raises LogError where it is damaged, or claims too many samples."""
    nptdms, store = library("nptdms", path, kind, "tdms"), Store(path, kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for group in nptdms.TdmsFile.read_metadata(path).groups():
                for channel in group.channels():
                    store.claim(f"{group.name}/{channel.name}", len(channel))
            store.claimed = 0
            file = nptdms.TdmsFile.read(path)
            _enter(store, file)
    except LogError:
        raise
    except Exception as error:  # the library answers damaged files with errors of many types
        raise LogError(
            f"{path}: found a damaged TDMS file ({type(error).__name__}: {error}), expected one that can be read"
        ) from None
    return store


def _enter(store: Store, file: Any) -> None:
    steps = set()
    for item in (file, *file.groups()):
        for key, value in item.properties.items():
            if isinstance(value, str | int | float):
                store.add("", key, np.asarray(value))
    for group in file.groups():
        for channel in group.channels():
            unit = channel.properties.get("unit_string", "")
            steps.add(channel.properties.get("wf_increment"))
            store.add(group.name, channel.name, channel[:], unit if isinstance(unit, str) else "")
    step = next(iter(steps)) if len(steps) == 1 else None
    if isinstance(step, int | float) and step > 0:
        store.constants["sample_rate_Hz"] = f"{1 / step:.12g}"
