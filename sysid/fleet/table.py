"""Rows as a table: a pandas DataFrame, one row a plate, and its files."""

import io
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from sysid.fleet.plate import Row
from sysid.model.prior import PLANT

FIELDS = ("value", "std", "ci95_low", "ci95_high", "unit", "determined", "why")
LISTS = (
    "warnings",
    "findings",
    "notes",
    "logs",
    "sha256",
)  # columns of lists; of findings as fit.json has them, else of texts
SHOWN = "backslashreplace"  # how bytes of a file's name that are no text are shown
CSV, PARQUET = "fleet.csv", "fleet.parquet"


def framed(rows: Sequence[Row]) -> pd.DataFrame:
    """The table of rows, in their order. Of a parameter p stand p (its value), p_std, p_ci95_low,
    p_ci95_high, p_unit, p_determined and p_why, and the correlations of each two; NaN and None where nothing
    is known."""
    names = list(dict.fromkeys([*PLANT, *(name for row in rows for name in row.get("parameters", ()))]))
    frame = pd.DataFrame(
        {"plate": texts([row["plate"] for row in rows]), "result": [row["result"] for row in rows]}
    )
    for name in names:
        found = [row.get("parameters", {}).get(name, {}) for row in rows]
        for field in FIELDS:
            frame[name if field == "value" else f"{name}_{field}"] = _column(field, found)
    for k, one in enumerate(names):
        for other in names[k + 1 :]:
            values = [_correlation(row, one, other) for row in rows]
            if any(value is not None for value in values):
                frame[f"correlation_{one}_{other}"] = pd.array(values, "Float64").to_numpy(
                    float, na_value=float("nan")
                )
    for field in ("reference_temperature_degC", "nrmse_percent"):
        frame[field] = pd.Series([row.get(field) for row in rows], dtype=float)
    frame["serial"] = pd.Series([serial(row) for row in rows], dtype=float)
    frame["date"] = texts([row.get("stated", {}).get("date") for row in rows])
    for field in ("warnings", "findings", "notes"):
        frame[field] = [row.get(field, []) for row in rows]
    frame["logs"] = [[log["name"] for log in row["logs"]] for row in rows]
    frame["sha256"] = [[log["sha256"] for log in row["logs"]] for row in rows]
    frame["error"] = texts([row.get("error") for row in rows])
    for field in ("way", "way_why", "seconds"):
        frame[field] = [row[field] for row in rows]
    return frame


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
