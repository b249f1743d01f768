"""Files that are written whole or not at all: a disk that is full leaves the older ones."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def in_place_of(*paths: str | Path) -> Iterator[list[Path]]:
    """Fresh paths in the place of `paths`, of one folder: once all are written they take the places of these;
    where one cannot be, none does. What is no file, such as a pipe, is written as it is. Raises OSError."""
    targets = [Path(os.path.realpath(path)) for path in paths]
    folder = targets[0].parent
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "found no such folder", str(folder))
    for target in (t for t in targets if t.exists()):
        if target.is_dir() or not os.access(target, os.W_OK):
            why = errno.EISDIR if target.is_dir() else errno.EACCES
            raise OSError(why, os.strerror(why), str(target))
    if any(target.exists() and not target.is_file() for target in targets):
        yield targets
        return
    with tempfile.TemporaryDirectory(prefix=".sysid-", dir=folder, ignore_cleanup_errors=True) as fresh:
        begun = [Path(fresh) / target.name for target in targets]
        yield begun
        for new, target in zip(begun, targets, strict=True):
            if target.exists():
                shutil.copymode(target, new)
        for new, target in zip(begun, targets, strict=True):
            os.replace(new, target)
