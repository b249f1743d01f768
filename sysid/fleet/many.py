"""Many plates in one Parquet file: a column `plate`, perhaps one that tells the `log`s of each, and else the
columns that each one's file would have; what is one text or one number of its metadata stands in every row of
a log."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.logs.log import Log
from sysid.tables import units
from sysid.tables.textfile import LogError

if TYPE_CHECKING:
    import pandas as pd

PLATE, LOG = "plate", "log"
MARK = b"PAR1"  # by which a Parquet file begins
Told = tuple[str | None, Sequence[Log], str]


def plates(path: str | Path) -> Iterator[Told] | None:
    """Of each plate its name, its logs, and why these cannot be read, else ""; None of a file that is no
    such table. Raises LogError for one that is damaged."""
    with suppress(OSError), open(path, "rb") as file:
        if file.read(len(MARK)) == MARK:
            from sysid.tables.arrow import read_parquet

            columns = read_parquet(str(path), "a Parquet file").tables.get("", {})
            return _parted(columns, str(path)) if PLATE in columns else None
    return None


def _parted(columns: Mapping[str, np.ndarray], path: str) -> Iterator[Told]:
    """The plates in the order of their first rows."""
    import pandas as pd

    frame = pd.DataFrame(dict(columns))
    for key, rows in frame.groupby(PLATE, sort=False, dropna=False):
        if not (plate := _text(key)):
            yield None, [], f"{path}: found {len(rows)} rows without a plate, expected its name in each"
            continue
        each = rows.groupby(LOG, sort=False, dropna=False) if LOG in rows else [("", rows)]
        try:
            yield plate, [_log(part, plate, _text(log)) for log, part in each], ""
        except LogError as error:
            yield plate, [], f"{path}: {error}"


def _log(rows: "pd.DataFrame", plate: str, log: str) -> Log:
    """That of these rows of the table."""
    from sysid.logs.made import of_table

    name, series, constants = f"{plate} {log}".strip(), dict[str, np.ndarray](), {PLATE: plate}
    for column in (column for column in rows if column not in (PLATE, LOG)):
        values = rows[column].to_numpy()
        texts = values.dtype.kind in "OUS"
        some = {_text(value) for value in (values if texts else values[:1])} - {""}
        if texts and len(some) > 1:
            raise LogError(f"{name}, column {column!r}: found {len(some)} texts, expected one in a log")
        if texts or (units.parse_name(column) is None and np.all(values == values[0])):
            constants[column] = "".join(some)
        elif np.any(np.isfinite(values)):
            series[column] = values
    return of_table(series, name, {key: text for key, text in constants.items() if text})


def _text(value: Any) -> str:
    """A name or a number as text, a whole one without decimals; "" of nothing."""
    if isinstance(value, str):
        return value
    return "" if value != value else str(int(value)) if value == round(value) else repr(float(value))
