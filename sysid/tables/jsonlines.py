"""JSON: an object a line, or of a list, is a row of numbers and texts, or a table where its values are lists;
names within names are joined by a point. Objects before the rows that share no name with them state
constants. A file that is one object or one list over many lines is read whole."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sysid.tables.store import Store
from sysid.tables.textfile import LogError, open_text, read_line

LARGEST = 1 << 28  # bytes of a file that is one object, which is in memory as such
BLOCK = 1 << 12  # rows that are in memory as objects, before they are arrays
MOST_NAMES = 1 << 12  # of columns: as many as rows would fill the memory with what is not there
DEEPEST = 8  # objects within objects
Object = dict[str, Any]


def read_jsonlines(path: str, kind: str) -> Store:
    """The contents of a file of JSON. Raises LogError where an object is none of numbers and texts, or there
    are too many."""
    store, rows = Store(path, kind), _Rows()
    constants: Object = {}
    held: Object = {}  # the last object, while it may state constants
    for where, found in _objects(path):
        store.claim(where, len(found))
        if any(isinstance(value, list) for value in found.values()):
            _add_table(store, where, found)
        elif rows.count or held.keys() & found.keys():
            rows.add(held)
            rows.add(found)
            held = {}
        else:
            constants, held = constants | held, found
        if len(rows.names) > MOST_NAMES:
            said = f"found more than {MOST_NAMES} names, expected the same ones in each"
            raise LogError(f"{path}, {where}: {said}")
    if store.tables and rows.count:
        raise LogError(f"{path}: found lines of rows and lines of lists, expected one of them")
    if store.tables:
        constants |= held
    else:
        rows.add(held)
        store.claim("the rows", len(rows.names) * rows.count)
        store.tables[""] = rows.columns()
    store.constants |= {
        name: value if isinstance(value, str) else repr(value) for name, value in constants.items()
    }
    return store


def is_jsonlines(path: str) -> bool:
    """Whether a text, packed or not, begins as an object does, or as a list of objects."""
    with open_text(path) as file:
        return re.match(rb"(\xef\xbb\xbf)?\s*(\[\s*)?\{", file.read(64)) is not None


def _objects(path: str) -> Iterator[tuple[str, Object]]:
    """Each object, by its place, as a flat one: of each line that is not empty, or of the file as a whole
    where its first line is none."""
    with open_text(path) as file:
        number = 0
        while raw := read_line(path, file, number + 1):
            number += 1
            if not (line := raw.decode("utf-8-sig", errors="replace").strip()):
                continue
            where = f"line {number}"
            try:
                found = json.loads(line, object_pairs_hook=_once)
            except (ValueError, RecursionError) as error:
                if number == 1 and line in ("{", "["):
                    yield from _of_document(path, _whole(path))
                    return
                said = f"found no JSON object ({error}), expected one a line"
                raise LogError(f"{path}, {where}: {said}") from None
            if number == 1 and (isinstance(found, list) or _holding(found)):
                yield from _of_document(path, found)
                return
            if not isinstance(found, dict):
                raise LogError(
                    f"{path}, {where}: found {_kind(found)}, expected an object with a name for each column"
                )
            yield where, dict(_flat(f"{path}, {where}", _listed(found), 0))


def _whole(path: str) -> Any:
    """What a file holds that is one JSON text. Raises LogError where it is none, or too long."""
    with open_text(path) as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        said = f"found more than {LARGEST >> 20} MiB of one JSON text, expected an object a line"
        raise LogError(f"{path}: {said}")
    try:
        return json.loads(content.decode("utf-8-sig", errors="replace"), object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: found no JSON ({error}), expected one object or list of them") from None


def _of_document(path: str, whole: Any) -> Iterator[tuple[str, Object]]:
    """The objects of a list, or that of the whole file; of one that holds a list of objects these, below what
    it states besides."""
    rows = whole
    if isinstance(whole, dict):
        held = _holding(whole)
        beside = {name: value for name, value in whole.items() if name not in held}
        if len(held) != 1:
            yield "the file's object", dict(_flat(path, _listed(whole), 0))
            return
        rows = whole[held[0]]
        yield "the file's object", dict(_flat(path, _listed(beside), 0))
    for number, found in enumerate(rows, 1):
        where = f"object {number} (counted from 1)"
        if not isinstance(found, dict):
            said = f"found {_kind(found)}, expected an object with a name for each column"
            raise LogError(f"{path}, {where}: {said}")
        yield where, dict(_flat(f"{path}, {where}", _listed(found), 0))


def _holding(found: Any) -> list[str]:
    """The names in an object under which lists of objects stand."""
    lists = found.items() if isinstance(found, dict) else ()
    return [
        name for name, of in lists if isinstance(of, list) and of and all(isinstance(x, dict) for x in of)
    ]


def _listed(found: Object) -> Object:
    """An object with lists for columns that are objects of rows by their numbers, {"f": {"0": 1, "1": 2}}, or
    rows of the columns that it names, {"columns": ["f"], "data": [[1], [2]]}: pandas writes a table so."""
    names, whole = found.get("columns"), found.get("data")
    named = isinstance(names, list) and isinstance(whole, list) and len({*map(str, names)}) == len(names)
    if named and names and whole and all(isinstance(row, list) and len(row) == len(names) for row in whole):
        return {str(name): [row[k] for row in whole] for k, name in enumerate(names)}
    lengths = {len(value) for value in found.values() if isinstance(value, dict)}
    if len(lengths) != 1 or not found or not all(isinstance(value, dict) for value in found.values()):
        return found
    (rows,) = lengths
    numbers = [str(row) for row in range(rows)]
    if rows < 2 or any([*value] != numbers for value in found.values()):
        return found
    return {name: [*value.values()] for name, value in found.items()}


def _once(pairs: list[tuple[str, Any]]) -> Object:
    """An object whose names are each there once. Raises ValueError."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the name {twice!r} is there twice")
    return found


def _flat(where: str, found: Mapping[str, Any], depth: int, before: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values; those of an object within under its name and theirs."""
    if depth > DEEPEST:
        raise LogError(f"{where}: found objects within objects {depth} deep, expected {DEEPEST} at most")
    for name, value in found.items():
        if isinstance(value, dict) and (stated := _with_unit(value)):
            yield f"{before}{name} [{stated[1]}]", stated[0]
        elif isinstance(value, dict):
            yield from _flat(where, value, depth + 1, f"{before}{name}.")
        elif isinstance(value, list) and not all(isinstance(x, int | float | str | None) for x in value):
            raise LogError(f"{where}, {before}{name}: found lists within a list, expected numbers")
        else:
            yield f"{before}{name}", value


def _with_unit(found: Mapping[str, Any]) -> tuple[Any, str] | None:
    """The numbers and the unit of an object of both alone, {"values": [1, 2], "unit": "V"}; else None."""
    unit = next((found[key] for key in ("unit", "units") if isinstance(found.get(key), str)), "")
    held = [found[key] for key in ("value", "values", "data") if key in found]
    return (held[0], unit) if unit and len(held) == 1 and len(found) == 2 else None


class _Rows:
    """Rows so far: a column for each name, NaN where a row has none."""

    def __init__(self) -> None:
        self.names: set[str] = set()
        self.count = 0
        self._open: list[Object] = []
        self._blocks: list[tuple[int, dict[str, np.ndarray]]] = []

    def add(self, row: Object) -> None:
        """One row more, if it holds anything."""
        if not row:
            return
        self.names |= row.keys()
        self.count += 1
        self._open.append(row)
        if len(self._open) == BLOCK:
            self._close()

    def columns(self) -> dict[str, np.ndarray]:
        """(n,) each, in the order in which their names came."""
        self._close()
        names = dict.fromkeys(name for _, block in self._blocks for name in block)
        return {
            name: _joined([block.get(name, np.full(n, np.nan)) for n, block in self._blocks])
            for name in names
        }

    def _close(self) -> None:
        names = dict.fromkeys(name for row in self._open for name in row)
        block = {name: _array([row.get(name) for row in self._open]) for name in names}
        if self._open:
            self._blocks.append((len(self._open), block))
        self._open = []


def _array(values: list[Any]) -> np.ndarray:
    """Numbers as float64, NaN for none; texts as they are where there is one."""
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values], object)
    return np.array([np.nan if value is None else _number(value) for value in values], float)


def _number(value: float) -> float:
    try:
        return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        return np.inf


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    if any(part.dtype == object for part in parts):
        parts = [
            part
            if part.dtype == object
            else np.array(["" if np.isnan(x) else repr(float(x)) for x in part], object)
            for part in parts
        ]
    return np.concatenate(parts)


def _add_table(store: Store, where: str, found: Object) -> None:
    """An object of lists: a column each; what is one value there is in every row."""
    lengths = {len(value) for value in found.values() if isinstance(value, list)}
    if len(lengths) > 1:
        said = " and ".join(map(str, sorted(lengths)[:2]))
        raise LogError(f"{store.path}, {where}: found lists of {said} values, expected as many in each")
    (rows,) = lengths
    for name, value in found.items():
        store.claim(where, rows)
        whole = value if isinstance(value, list) else [value] * rows
        store.tables.setdefault(where, {})[name] = _array(whole)


def _kind(value: Any) -> str:
    return "a list" if isinstance(value, list) else "a text" if isinstance(value, str) else f"{value}"
