"""Files of numpy: an array (`.npy`), whose columns have no names unless it is structured, or several by their
names (`.npz`). Objects, which numpy pickles, are left out and never made."""

import zipfile
from typing import BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from sysid.tables.store import Store, readable
from sysid.tables.textfile import LogError

NUMBER = 8  # bytes of one
ENDING = ".npy"  # of the members of a .npz, which is a zip archive of them


def read_npy(path: str, kind: str) -> Store:
    """The contents of a file of one array. Raises LogError where it is damaged, or holds objects."""
    store = Store(path, kind)
    with open(path, "rb") as file:
        array = _array(store, "the array", file)
    if array is None:
        raise LogError(f"{path}: found an array of objects, expected numbers: they are not made")
    store.add("", "" if array.dtype.names else "array", array)
    store.nameless = not array.dtype.names
    return store


def read_npz(path: str, kind: str) -> Store:
    """The contents of an archive of arrays. Raises LogError where it is damaged."""
    store = Store(path, kind)
    with readable(store, kind.partition(" ")[2]), zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(ENDING)
            with archive.open(info) as file:
                array = _array(store, name, cast(BinaryIO, file))
            if array is None:
                store.left_out.append(f"{name} (objects)")
            else:
                store.add("", name, array)
    return store


def is_npz(path: str) -> bool:
    """Whether a zip archive holds arrays of numpy and nothing else."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError):
        return False
    return bool(names) and all(name.endswith(ENDING) for name in names)


def _array(store: Store, name: str, file: BinaryIO) -> np.ndarray | None:
    """The array at the place of a file, as many numbers as its head claims; None of objects. Damaged:
    LogError."""
    with readable(store, store.kind.partition(" ")[2]):
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(file)
        if dtype.hasobject:
            return None
        count = int(np.prod([int(n) for n in shape], dtype=object))
        store.claim(name, count * max(-(-dtype.itemsize // NUMBER), 1))
        store.claimed = 0  # `add` counts what is entered
        content = file.read(count * dtype.itemsize)
        flat = np.frombuffer(content, dtype, count)
        return flat.reshape(shape, order="F" if fortran else "C")
