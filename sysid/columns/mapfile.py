"""Mapping files as they are read and checked: every key is known, every value of its type.

Beside a path stands the name of a preset (`columns.preset`), `preset:e4990a`."""

import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.columns import preset
from sysid.columns.mapping import WORDS, MappingFile
from sysid.tables import units
from sysid.tables.cells import Dialect
from sysid.tables.csvfile import LogError
from sysid.tables.scattered import RATIOS

RESPONSES = (("wd", "wq"), ("w",), ("x", "y"), ("magnitude", "phase"), ("magnitude",))
_NAMES = (*units.QUANTITIES, "x", "y", "magnitude", "phase")
_OPTIONS: dict[str, tuple[type, ...]] = {
    "kind": (str,), "sampling": (str,), "amplitude": (str,), "quantity": (str,), "phase_sign": (int,),
    "phase_offset_deg": (int, float), "delimiter": (str,), "decimal": (str,), "comment": (str,),
    "header": (bool,),
    "skip": (int,), "join": (str, int), "table": (str,), "rows": (list, dict), "split_by": (str, int),
    "columns": (dict,),
    "constants": (dict,), "metadata": (dict,), "preset": (str,), "find": (bool,), "units": (dict,),
}  # fmt: skip
_NUMBER = (int, float)
_COLUMN_KEYS = {
    "column": (str, int), "unit": (str,), "scale": _NUMBER, "offset": _NUMBER, "amplitude": (str,),
    "file": (str,),
}  # fmt: skip


def load_mapping(path: str | Path) -> MappingFile:
    """Read and check a mapping file, or the preset of that name. Raises LogError that names the key."""
    if (name := str(path)).startswith(preset.PREFIX):
        return checked(name, {"preset": name.removeprefix(preset.PREFIX)})
    try:
        options = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise LogError(f"{path}: cannot be read as a mapping file (TOML): {error}") from None
    return checked(str(path), options)


def checked(path: str, options: dict[str, Any]) -> MappingFile:
    """The mapping file of that content. Raises LogError that names the key."""
    mapping = MappingFile(path, options)
    _check_keys(mapping, "", options, _OPTIONS)
    for key in ("columns", "constants", "units"):
        _check_keys(
            mapping, f"[{key}] ", options.get(key, {}), dict.fromkeys(_NAMES, (str, int, float, dict))
        )
    base = _base(mapping)
    finds = bool(options.get("find", base.get("find", False)))
    if "columns" in options:
        options["columns"] = {
            name: _as_table(mapping, name, entry, finds) for name, entry in options["columns"].items()
        }
    _check_response(mapping, set(options.get("columns", {})), set(options.get("constants", {})), finds)
    _check_rows(mapping)
    stated = {key: value for key, value in (base | options).items() if value is not None}
    delimiter = stated.get("delimiter")
    if (delimiter is not None and not re.fullmatch(r"[ -~\t]", delimiter)) or delimiter in ('"', "."):
        raise mapping.fail("delimiter", f"found {delimiter!r}, expected one character such as ; or a tab")
    if stated.get("skip", 0) < 0:
        raise mapping.fail("skip", f"found {stated['skip']}, expected how many lines to leave out, 0 or more")
    comment = (stated["comment"],) if "comment" in stated else None
    dialect = Dialect(
        delimiter, comment, *(stated.get(key) for key in ("decimal", "header", "skip", "table", "join"))
    )
    return MappingFile(path, options, dialect, base, finds)


def _base(mapping: MappingFile) -> dict[str, Any]:
    """What the preset of a mapping file says; empty where it has none."""
    if "preset" not in mapping.options:
        return {}
    try:
        return preset.named(mapping.options["preset"]).options
    except KeyError as error:
        where = "" if mapping.path.startswith(preset.PREFIX) else ", preset"
        raise LogError(f"{mapping.path}{where}: {error.args[0]}") from None


def _check_keys(
    mapping: MappingFile, where: str, table: dict[str, Any], known: Mapping[str, tuple[type, ...]]
) -> None:
    for key, value in table.items():
        if key not in known:
            raise mapping.fail(f"{where}{key}", f"not a known key{units.did_you_mean(key, list(known))}")
        if not isinstance(value, known[key]) or (isinstance(value, bool) and bool not in known[key]):
            names = " or ".join(kind.__name__ for kind in known[key])
            raise mapping.fail(f"{where}{key}", f"found {value!r}, expected {names}")
        if isinstance(value, float) and not math.isfinite(value):
            raise mapping.fail(f"{where}{key}", f"found {value!r}, expected a finite number")
        if key in WORDS and value not in WORDS[key]:
            raise mapping.fail(
                f"{where}{key}", f"found {value!r}, expected one of {', '.join(map(repr, WORDS[key]))}"
            )


def _as_table(mapping: MappingFile, name: str, entry: Any, finds: bool) -> dict[str, Any]:
    table = entry if isinstance(entry, dict) else {"column": entry}
    _check_keys(mapping, f"[columns] {name}.", table, _COLUMN_KEYS)
    if "column" not in table and not finds:
        raise mapping.fail(f"[columns] {name}", "found no column, expected its name or position")
    if table.get("scale") == 0:
        raise mapping.fail(
            f"[columns] {name}.scale", "found 0, expected a factor that keeps the column's numbers apart"
        )
    return table


def _check_rows(mapping: MappingFile) -> None:
    """Rows are [first, last], several of those, or either for each value of the split column; they become
    lists of several."""
    stated = mapping.options.get("rows")
    if isinstance(stated, dict) and "split_by" not in mapping.options:
        raise mapping.fail("rows", "found rows of single experiments, expected split_by beside them")
    for value, ranges in (
        stated if isinstance(stated, dict) else {None: stated} if stated is not None else {}
    ).items():
        several = (
            [ranges] if isinstance(ranges, list) and all(type(edge) is int for edge in ranges) else ranges
        )
        pairs = isinstance(several, list) and all(
            isinstance(edges, list) and len(edges) == 2 for edges in several
        )
        if not pairs or not all(type(edge) is int for edges in several for edge in edges):
            raise mapping.fail("rows", f"found {ranges!r}, expected [first, last], or several such in a list")
        stated = stated | {value: several} if value is not None else several
    mapping.options["rows"] = stated


def _check_response(mapping: MappingFile, columns: set[str], constants: set[str], finds: bool) -> None:
    """Raise LogError where the response is not whole, or anything is there twice; what is found by its head
    cannot be missing here."""
    parts = {"wd", "wq", "w", "x", "y", "magnitude", "phase", "response"}
    response = columns & parts
    if constant := constants & parts:
        raise mapping.fail(
            f"[constants] {min(constant)}", "found a response that is constant, expected a column"
        )
    waveform = mapping.options.get("kind") == "waveform"
    named = not finds and (mapping.names_columns or not mapping.options)
    if waveform and named and (response != {"response"} or not columns & {"voltage", "drive"}):
        found = ", ".join(sorted(columns)) or "no columns"
        raise mapping.fail(
            "[columns]", f"found {found} of a waveform, expected drive (or voltage) and response"
        )
    if waveform and "phase_sign" in mapping.options:
        raise mapping.fail(
            "phase_sign",
            "belongs to wd and wq, to x and y, or to phase; found a waveform, whose sign is known",
        )
    if not waveform and named and response not in map(set, RESPONSES):
        expected = "wd and wq, or w, or x and y, or magnitude (and phase)"
        raise mapping.fail(
            "[columns]", f"found {', '.join(sorted(response)) or 'no response'}, expected {expected}"
        )
    if waveform and columns & {"std", "std_q"}:
        raise mapping.fail(
            "[columns] std", "belongs to rows of amplitudes; found a waveform, whose noise its samples show"
        )
    if "std_q" in columns and "std" not in columns:
        raise mapping.fail(
            "[columns] std_q", "found the standard errors of q alone, expected std, those of d, beside them"
        )
    if both := columns & constants:
        raise mapping.fail(f"[constants] {min(both)}", "found it in [columns] too, expected it once")
    if len(drives := (columns | constants) & {*units.DRIVES}) > 1:
        raise mapping.fail("[columns]", f"found {' and '.join(sorted(drives))}, expected one of them")
    if waveform and (ratio := mapping.options.get("quantity")) in RATIOS:
        raise mapping.fail("quantity", f"found the {ratio} of a waveform, expected what its response shows")
    if "quantity" in mapping.options and named and not response & {"x", "magnitude", "response"}:
        raise mapping.fail(
            "quantity",
            "belongs to x and y, to magnitude, or to a waveform; found a response that is one already",
        )
