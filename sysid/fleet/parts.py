"""Rows on disk while a run goes on: parts of the table, each written whole, by which a later run knows what
is done."""

import hashlib
import json
import os
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from sysid.fleet.groups import Group
from sysid.fleet.plate import Row, digest
from sysid.fleet.settings import Settings

ENDING = ".jsonl"  # a row a line


class Parts:
    """The parts in a folder, which is made. Raises OSError where it cannot be written."""

    def __init__(self, folder: Path):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def write(self, rows: Sequence[Row]) -> None:
        """One part more, under a name of its content: there whole or not at all, whenever the process is
        killed."""
        text = "".join(json.dumps(row) + "\n" for row in rows).encode()
        file, fresh = tempfile.mkstemp(dir=self.folder, prefix=".part-")
        try:
            with os.fdopen(file, "wb") as out:
                out.write(text)
                out.flush()
                os.fsync(out.fileno())
            os.replace(fresh, self.folder / (hashlib.sha256(text).hexdigest()[:24] + ENDING))
        finally:
            with suppress(OSError):
                os.unlink(fresh)

    def done(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """The rows of plates whose logs and settings are those of an earlier run, each once, a part at a
        time."""
        wanted, latest = {g.plate: g for g in groups}, dict[str, tuple[Path, int]]()
        for path, rows in self._each():
            latest |= {
                row["plate"]: (path, k) for k, row in enumerate(rows) if row["settings"] == settings.digest
            }
        for path, rows in self._each():
            here = [row for k, row in enumerate(rows) if latest.get(row["plate"]) == (path, k)]
            group = (wanted.get(row["plate"]) for row in here)
            yield [row for row, g in zip(here, group, strict=True) if g is not None and _same(g, row)]

    def of(self, plates: Collection[str], settings: Settings) -> dict[str, Row]:
        """The latest rows of these plates, by plate."""
        return {
            row["plate"]: row
            for _, rows in (self._each() if plates else ())
            for row in rows
            if row["plate"] in plates and row["settings"] == settings.digest
        }

    def _each(self) -> Iterator[tuple[Path, list[Row]]]:
        """The rows of each part, the latest part last."""
        files = [path for path in self.folder.iterdir() if path.suffix == ENDING]
        for path in sorted(files, key=lambda path: path.stat().st_mtime_ns):
            with suppress(ValueError):  # a part that something has damaged is done anew
                yield path, [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def _same(group: Group, row: Row) -> bool:
    """Whether a row is of these very logs."""
    before = [log["sha256"] for log in row["logs"]]
    return len(before) == len(group.logs) and all(
        then and then == now for then, now in zip(before, map(digest, group.logs), strict=True)
    )
