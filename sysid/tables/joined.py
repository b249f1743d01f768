"""Small tables of plain numbers, of one form, that are parsed together, as to begin takes longer than to read
one."""

from collections.abc import Collection, Sequence

import numpy as np


def parsed(
    texts: Sequence[bytes], delimiter: str, width: int, wanted: Collection[int]
) -> list[dict[int, np.ndarray]]:
    """Of each text, lines of `width` cells, the `wanted` columns (n,), to the last bit of each number. Raises
    ImportError without the package pyarrow, ValueError where a cell is no number."""
    import pyarrow
    from pyarrow import csv

    names, body = [str(k) for k in range(width)], b"\n".join(texts) + b"\n"
    table = csv.read_csv(
        pyarrow.BufferReader(body),
        csv.ReadOptions(column_names=names, use_threads=False, block_size=len(body) + 1),
        csv.ParseOptions(delimiter=delimiter),
        csv.ConvertOptions(
            include_columns=[names[k] for k in wanted],
            column_types=dict.fromkeys(names, pyarrow.float64()),
            null_values=[],
        ),
    )
    ends = np.cumsum([text.count(b"\n") + 1 for text in texts])
    if len(table) != ends[-1]:
        raise ValueError(f"found {len(table)} rows, expected {ends[-1]}")
    each = {k: table[names[k]].chunks for k in wanted}  # whose `to_numpy` would load pandas
    columns = {k: np.split(np.concatenate(list(map(np.from_dlpack, x))), ends[:-1]) for k, x in each.items()}
    return [{k: column[i] for k, column in columns.items()} for i in range(len(texts))]
