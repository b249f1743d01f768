"""A file of any kind as the head of a table: text, or what is told by its first bytes, or by its ending, to
be something else."""

import re
from collections.abc import Callable
from dataclasses import replace

from sysid.tables import arrays, arrow, audio, citi, matlab, spice, tdms, touchstone, uff
from sysid.tables.cells import Dialect, listed
from sysid.tables.compound import simple
from sysid.tables.csvfile import Head, LogError, read_head
from sysid.tables.hdf import read_hdf
from sysid.tables.influx import is_influx, read_influx
from sysid.tables.jsonlines import is_jsonlines, read_jsonlines
from sysid.tables.store import Store
from sysid.tables.workbook import file_of

Reader = Callable[[str, str], Store]
BY_MARK: dict[bytes, tuple[Reader, str]] = {
    b"\x89HDF\r\n\x1a\n": (read_hdf, "an HDF5 file"),
    b"MATLAB 5.0 MAT-file": (matlab.read_matlab, "a MATLAB file"),
    b"MATLAB 7.3 MAT-file": (matlab.read_matlab, "a MATLAB file"),
    b"PAR1": (arrow.read_parquet, "a Parquet file"),
    b"ARROW1": (arrow.read_feather, "a Feather file"),
    b"RIFF": (audio.read_wav, "a WAV file"),
    b"CITIFILE": (citi.read_citi, "a CITI file"),
    b"TDSm": (tdms.read_tdms, "a TDMS file"),
    b"\x93NUMPY": (arrays.read_npy, "a numpy array"),
}
BEGINNING = 1 << 12  # bytes that tell what a file is
ZIP = b"PK\x03\x04"  # of archives of many kinds
USER_BLOCKS = (512, 1024, 2048)  # bytes that may stand before an HDF5 file's own
JSON = r"\.(jsonl|ndjson|json)(\.(gz|bz2|xz))?$"
UFF = r"\.uff|\.unv"
BY_ENDING: dict[str, tuple[Reader, str]] = {
    r"\.s\d+p|\.ts": (touchstone.read_touchstone, "a Touchstone file"),
    UFF: (uff.read_uff, "a universal file"),
}


def open_head(path: str, dialect: Dialect) -> Head:
    """The head of a file's table. Raises LogError where it holds none."""
    if (found := _reader(path)) is None:
        if dialect.table is not None:
            raise LogError(
                f"{path}: found a text table, expected a file of several tables, as table ="
                f" {dialect.table!r} says"
            )
        return simple(read_head(path, dialect))
    reader, kind = found
    head = reader(path, kind).head(dialect)
    spare = [
        name
        for name in ("delimiter", "comment", "decimal", "skip", "join")
        if getattr(dialect, name) is not None
    ]
    note = f"{listed(spare)} of the mapping file: of text, not used of {kind}"
    return replace(head, notes=(*head.notes, note)) if spare else head


def _reader(path: str) -> tuple[Reader, str] | None:
    """What reads a file that is no text table, and what it is called; None of text."""
    with open(file_of(path), "rb") as file:
        first = file.read(BEGINNING)
        for place in USER_BLOCKS if first.startswith(b"\x00") else ():
            file.seek(place)
            first = mark if (mark := file.read(8)) == b"\x89HDF\r\n\x1a\n" else first
    if re.match(rb"\s*-1\s*\n\s*(58|151|164)b?\s", first):  # how a universal file begins, whatever its ending
        return BY_ENDING[UFF]
    if found := next((of for mark, of in BY_MARK.items() if first.startswith(mark)), None):
        return found
    if found := next(
        (of for ending, of in BY_ENDING.items() if re.search(rf"({ending})$", path, re.I)), None
    ):
        return found
    if first.startswith(ZIP) and arrays.is_npz(path):
        return arrays.read_npz, "a numpy archive"
    if spice.is_spice(first):
        return spice.read_spice, "a raw file of a circuit simulator"
    if is_influx(first):
        return read_influx, "a file of InfluxDB's lines"
    begins = first.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"{", b"["))
    may_be = begins or re.search(JSON, path, re.IGNORECASE)
    return (read_jsonlines, "a file of JSON") if may_be and is_jsonlines(path) else None
