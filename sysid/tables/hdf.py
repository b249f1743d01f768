"""HDF5 files, those of MATLAB 7.3 among them: a group is a table, its datasets are the columns, attributes
are constants.

Links out of the file, datasets that lie in other files, and such as claim numbers that the file does not hold
are refused."""

from typing import Any

import numpy as np

from sysid.tables.store import Store, library, readable
from sysid.tables.textfile import LogError

DEEPEST = 32  # groups within groups
UNITS = ("units", "unit", "Unit", "Units")  # attributes of a dataset
OURS = ("MATLAB_",)  # attributes of MATLAB's own


def read_hdf(path: str, kind: str) -> Store:
    """The contents of an HDF5 file. Raises LogError where it is damaged, or points out of itself."""
    h5py = library("h5py", path, kind, "files")
    store = Store(path, kind)
    with readable(store, kind.partition(" ")[2]), h5py.File(path, "r") as file:
        _enter(h5py, store, file, "", 0)
    return store


def _enter(h5py: Any, store: Store, group: Any, place: str, depth: int) -> None:
    if depth > DEEPEST:
        raise LogError(
            f"{store.path}, {place}: found groups within groups {depth} deep, expected {DEEPEST} at most"
        )
    for key, value in group.attrs.items():
        _add_attribute(store, key, value)
    for name in group:
        within = f"{place}/{name}"
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise LogError(
                f"{store.path}, {within}: found a link to another file, {link.filename!r}, expected the"
                f" data themselves"
            )
        if isinstance(link, h5py.SoftLink) or name == "#refs#":
            store.left_out.append(f"{within} (a link)" if name != "#refs#" else "#refs# (objects)")
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            _enter(h5py, store, item, within, depth + 1)
        elif isinstance(item, h5py.Dataset):
            _add_dataset(h5py, store, item, place, name)


def _add_dataset(h5py: Any, store: Store, item: Any, place: str, name: str) -> None:
    within = f"{place}/{name}"
    if item.external or item.is_virtual:
        raise LogError(
            f"{store.path}, {within}: found data that lie in other files, expected the data themselves"
        )
    if item.shape is None or item.dtype.kind not in "biufcSUV" or h5py.check_ref_dtype(item.dtype):
        text = h5py.check_string_dtype(item.dtype) is not None and item.shape is not None
        if not text:
            store.left_out.append(f"{within} (objects)")
            return
    count = int(item.size) * max(item.dtype.itemsize // 8, 1)
    store.claim(within, count)
    if item.size and not item.id.get_storage_size():
        raise LogError(
            f"{store.path}, {within}: found {item.size} numbers claimed and none stored, expected the data"
            f" themselves"
        )
    store.claimed -= count
    unit = next((_word(item.attrs[key]) for key in UNITS if key in item.attrs), "")
    values = item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]
    if (names := getattr(np.asarray(values).dtype, "names", None)) and {*names} == {
        "real",
        "imag",
    }:  # of MATLAB
        values = values["real"] + 1j * values["imag"]
    store.add(place, name, values, unit)


def _add_attribute(store: Store, key: str, value: Any) -> None:
    if not key.startswith(OURS) and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "biufUSO":
        value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if isinstance(value, str | int | float | np.number | np.bool_):
            store.add("", key, np.asarray(value))


def _word(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
