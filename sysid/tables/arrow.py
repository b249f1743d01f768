"""Tables of Apache Arrow: Parquet, and Feather of version 2. Columns are theirs, the metadata of the file its
constants."""

from typing import Any

import numpy as np

from sysid.tables.store import Store, library, readable


def read_parquet(path: str, kind: str) -> Store:
    """The contents of a Parquet file. Raises LogError where it is damaged, or claims too many rows."""
    parquet, store = library("pyarrow.parquet", path, kind, "files"), Store(path, kind)
    with readable(store, "Parquet file"):
        file = parquet.ParquetFile(path)
        store.claim("the table", file.metadata.num_rows * file.metadata.num_columns)
        store.claimed = 0
        _enter(store, file.read())
    return store


def read_feather(path: str, kind: str) -> Store:
    """The contents of a Feather file, whose rows are counted first. Raises LogError as `read_parquet`
    does."""
    ipc, store = library("pyarrow.ipc", path, kind, "files"), Store(path, kind)
    pyarrow = library("pyarrow", path, kind, "files")
    with readable(store, "Feather file"):
        # What is packed is counted before it is unpacked: the batches say their rows themselves.
        dataset = library("pyarrow.dataset", path, kind, "files").dataset(path, format="ipc")
        store.claim("the table", dataset.count_rows() * len(dataset.schema))
        store.claimed = 0
        with pyarrow.memory_map(path) as source:
            reader = ipc.open_file(source)
            batches = [reader.get_batch(k) for k in range(reader.num_record_batches)]
            table = pyarrow.Table.from_batches(batches, reader.schema)
            table.validate(full=True)
            _enter(store, table)
    return store


def _enter(store: Store, table: Any) -> None:
    for key, value in (table.schema.metadata or {}).items():
        if key not in (b"pandas", b"ARROW:schema") and len(value) < 1000:
            store.constants[key.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = column.to_numpy()
        if values.dtype.kind == "O":
            values = np.array(["" if x is None else x for x in values], object)
        store.add("", name, values)
