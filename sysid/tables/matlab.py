"""MATLAB files of version 5: a variable is a column, a structure a table of its fields. Objects and functions
are left out."""

import struct
import zlib
from typing import Any

import numpy as np

from sysid.tables.hdf import read_hdf
from sysid.tables.store import MOST, Store, library, readable

DEEPEST = 8  # structures within structures
HEADER, COMPRESSED = (
    128,
    15,
)  # bytes before the first variable; the type of one that is compressed (MAT-File Format)
PIECE = 1 << 20  # bytes unpacked at a time


def read_matlab(path: str, kind: str) -> Store:
    """The contents of a MATLAB file; of version 7.3 as HDF5. Raises LogError where it is damaged."""
    with open(path, "rb") as file:
        if file.read(16).startswith(b"MATLAB 7.3"):
            return read_hdf(path, kind)
    matlab = library("scipy.io", path, kind, "files")
    store = Store(path, kind)
    with readable(store, "MATLAB file"):
        store.claim("the variables", _unpacked(path) // 8)
        store.claimed = 0
        for name, shape, _ in matlab.whosmat(path):
            store.claim(name, int(np.prod([int(n) for n in shape], dtype=object)))
        store.claimed = 0
        variables = matlab.loadmat(path, chars_as_strings=True, struct_as_record=True)
    for name, values in variables.items():
        if not name.startswith("__"):
            _enter(store, "", name, values, 0)
    return store


def _unpacked(path: str) -> int:
    """How many bytes the compressed variables of a file are when they are unpacked, counted without keeping
    them."""
    total = 0
    with open(path, "rb") as file:
        order = "<" if file.read(HEADER)[-2:] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            unpacker, end = zlib.decompressobj(), file.tell() + size
            while kind == COMPRESSED and not unpacker.eof and total <= 8 * MOST:
                if not (piece := unpacker.unconsumed_tail or file.read(min(PIECE, end - file.tell()))):
                    break
                total += len(unpacker.decompress(piece, PIECE))
            file.seek(end)
    return total


def _enter(store: Store, table: str, name: str, values: Any, depth: int) -> None:
    values = np.asarray(values)
    if (
        values.dtype.names
        and values.dtype.kind == "V"
        and depth < DEEPEST
        and not hasattr(values, "classname")
    ):
        several = values.size > 1
        for k, element in enumerate(values.reshape(-1)):
            place = f"{table}/{name}" + (f"[{k + 1}]" if several else "")
            for part in values.dtype.names:
                _enter(store, place, part, element[part], depth + 1)
    elif (
        values.dtype.kind == "O"
        and values.size == 1
        and depth < DEEPEST
        and isinstance(values.reshape(-1)[0], np.ndarray)
    ):
        _enter(store, table, name, values.reshape(-1)[0], depth + 1)
    elif values.dtype.kind == "O" and all(
        getattr(of, "dtype", None) and of.dtype.names for of in values.flat
    ):
        for k, element in enumerate(values.flat, 1):  # a cell array of structures
            _enter(store, table, f"{name}[{k}]", element, depth + 1)
    else:
        store.add(table, name, values)
