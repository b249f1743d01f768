"""A table that does not lie in its file as one row a line: its columns in memory, and where in the file each
cell stands."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sysid.tables.cells import NO_NUMBER, to_number


@dataclass(frozen=True, eq=False)
class Sheet:
    """The columns of a table, (n,) each: numbers, or the texts of a file. `where(row, column)`, both from 0,
    names the file and the place of a cell in it."""

    columns: tuple[np.ndarray, ...]
    where: Callable[[int, int], str]
    sha256: str | None = None  # of all its files, where there are several; "" of a table that is in none

    def __len__(self) -> int:
        return len(self.columns[0])

    def numbers(self, column: int, decimal: str) -> np.ndarray:
        """A column as float64 (n,), NaN where a cell is no number."""
        values = self.columns[column]
        if values.dtype == object:
            return np.array([to_number(cell, decimal) for cell in values], np.float64)
        values = values.astype(np.float64)
        return np.where(np.abs(values) >= NO_NUMBER, np.nan, values)

    def texts(self, column: int) -> np.ndarray:
        """A column as text (n,)."""
        return np.array([self.text(row, column) for row in range(len(self))], object)

    def text(self, row: int, column: int) -> str:
        """A cell as text, "" where it is empty."""
        cell = self.columns[column][row]
        return cell.strip() if isinstance(cell, str) else repr(cell.item())

    def first(self, rows: int) -> tuple[tuple[str, ...], ...]:
        """The first rows as text."""
        return tuple(
            tuple(self.text(row, k) for k in range(len(self.columns))) for row in range(min(rows, len(self)))
        )
