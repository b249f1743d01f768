"""Rows as a table: a pandas DataFrame, one row a plate, and its files."""

import io
import json
import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import pandas as pd

from sysid.fleet.plate import Row
from sysid.model.theta import NAMES, PLANT

FIELDS = ("value", "std", "ci95_low", "ci95_high", "unit", "determined", "why")
LISTS = (
    "warnings",
    "findings",
    "notes",
    "logs",
    "sha256",
)  # columns of lists; of findings as fit.json has them, else of texts
SHOWN = "backslashreplace"  # how bytes of a file's name that are no text are shown
HEAD = ("plate", "result")
TAIL = (
    *("reference_temperature_degC", "nrmse_percent", "serial", "date", "warnings", "findings", "notes"),
    *("logs", "sha256", "error", "way", "way_why", "seconds"),
)
CSV, PARQUET = "fleet.csv", "fleet.parquet"


class Told:
    """What a table tells of rows, as they come: columns, which take a tenth of the rows' memory."""

    def __init__(self) -> None:
        self.parts: list[pd.DataFrame] = []

    def add(self, rows: Sequence[Row]) -> None:
        """More rows."""
        if rows:
            self.parts.append(_part(rows))

    def framed(self, plates: Sequence[str]) -> pd.DataFrame:
        """The table of rows, which are those of these plates, in this order. Of a parameter p stand p (its
        value), p_std, p_ci95_low, p_ci95_high, p_unit, p_determined and p_why, and the correlations of each
        two; NaN and None where nothing is known."""
        names = [n for n in NAMES if n in PLANT or any(n in part for part in self.parts)]
        pairs = [f"correlation_{a}_{b}" for k, a in enumerate(names) for b in names[k + 1 :]]
        pairs = [pair for pair in pairs if any(pair in part for part in self.parts)]
        columns = [*HEAD, *(c for name in names for c in _columns(name)), *pairs, *TAIL]
        parts = [_filled(part, names, pairs)[columns] for part in self.parts]
        whole = pd.concat(parts, ignore_index=True) if parts else _filled(_part([]), names, [])[columns]
        self.parts = []
        place = {plate: k for k, plate in enumerate(whole["plate"])}
        return whole.iloc[[place[plate] for plate in plates]].reset_index(drop=True)


def _part(rows: Sequence[Row]) -> pd.DataFrame:
    """The columns of rows, of the parameters that these tell."""
    known = {*PLANT, *(name for row in rows for name in row.get("parameters", ()))}
    names = [name for name in NAMES if name in known]
    told: dict[str, Any] = {
        "plate": texts([row["plate"] for row in rows]),
        "result": [row["result"] for row in rows],
    }
    for name in names:
        told |= _of_parameter(name, [row.get("parameters", {}).get(name, {}) for row in rows])
    for one, other in combinations(names, 2):
        values = [_correlation(row, one, other) for row in rows]
        if any(value is not None for value in values):
            told[f"correlation_{one}_{other}"] = pd.Series(values, dtype=float)
    for field in ("reference_temperature_degC", "nrmse_percent"):
        told[field] = pd.Series([row.get(field) for row in rows], dtype=float)
    told["serial"] = pd.Series([serial(row) for row in rows], dtype=float)
    told["date"] = texts([row.get("stated", {}).get("date") for row in rows])
    for field in ("warnings", "findings", "notes"):
        told[field] = texts([row.get(field, []) for row in rows])
    told["logs"] = texts([[log["name"] for log in row["logs"]] for row in rows])
    told["sha256"] = texts([[log["sha256"] for log in row["logs"]] for row in rows])
    told["error"] = texts([row.get("error") for row in rows])
    for field in ("way", "way_why"):
        told[field] = [row[field] for row in rows]
    return pd.DataFrame(told | {"seconds": pd.Series([row["seconds"] for row in rows], dtype=float)})


def _columns(name: str) -> list[str]:
    """Those of a parameter."""
    return [name if field == "value" else f"{name}_{field}" for field in FIELDS]


def _of_parameter(name: str, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {column: _column(field, found) for column, field in zip(_columns(name), FIELDS, strict=True)}


def _filled(part: pd.DataFrame, names: Sequence[str], pairs: Sequence[str]) -> pd.DataFrame:
    """A part with columns of all these parameters and correlations."""
    lacking: dict[str, Any] = {}
    for name in names:
        lacking |= {} if name in part else _of_parameter(name, [{}] * len(part))
    lacking |= {pair: pd.Series([None] * len(part), dtype=float) for pair in pairs if pair not in part}
    return part.assign(**lacking)


def _column(field: str, found: Sequence[Mapping[str, Any]]) -> Any:
    values = [p.get(field) for p in found]
    if field == "determined":
        return pd.Series([bool(value) for value in values], dtype=bool)
    return texts(values) if field in ("unit", "why") else pd.Series(values, dtype=float)


def texts(values: Sequence[Any]) -> pd.Series:
    """A column of texts, or of lists of them, None where there is none, whatever pandas would make of it."""
    return pd.Series(list(values), dtype=object)


def _correlation(row: Row, one: str, other: str) -> float | None:
    names = row.get("names", [])
    if one not in names or other not in names:
        return None
    matrix, i, j = row["covariance"], names.index(one), names.index(other)
    return float(matrix[i][j] / (matrix[i][i] * matrix[j][j]) ** 0.5)


def serial(row: Row) -> float | None:
    """The serial number that the logs state, else the last whole number in the plate's name."""
    told = row.get("stated", {}).get("serial", "")
    found = re.findall(r"\d+", told) or re.findall(r"\d+", row["plate"])
    return float(found[-1]) if found else None


def as_csv(frame: pd.DataFrame) -> bytes:
    """The table as CSV, UTF-8: numbers in full, lists as JSON."""
    flat = frame.copy()
    for name in LISTS:
        flat[name] = texts([json.dumps(value, ensure_ascii=False) for value in flat[name]])
    return flat.to_csv(index=False, lineterminator="\n").encode(errors=SHOWN)


def _encodable(value: Any) -> Any:
    """A text, or a list of them, as UTF-8 can have it."""
    if isinstance(value, list):
        return [_encodable(item) for item in value]
    return value.encode(errors=SHOWN).decode() if isinstance(value, str) else value


def as_parquet(frame: pd.DataFrame) -> bytes:
    """The table as Parquet. Raises ImportError without the package pyarrow."""
    import pyarrow
    from pyarrow import parquet

    frame = frame.assign(findings=[[json.dumps(f) for f in found] for found in frame["findings"]])
    for name in (name for name in frame if frame[name].dtype.kind == "O"):
        frame[name] = texts([_encodable(value) for value in frame[name]])
    fields = []
    for name in frame:
        kind = frame[name].dtype.kind
        plain = pyarrow.bool_() if kind == "b" else pyarrow.float64() if kind == "f" else pyarrow.string()
        fields.append(
            (
                name,
                pyarrow.list_(pyarrow.string())
                if name in LISTS
                else pyarrow.int64()
                if kind == "i"
                else plain,
            )
        )
    table = pyarrow.Table.from_pandas(frame, pyarrow.schema(fields), preserve_index=False)
    whole = io.BytesIO()
    parquet.write_table(table, whole)
    return whole.getvalue()
