"""Arrays kept on disk: what the same code was asked for before is read instead of computed."""

import tempfile
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

Arrays = dict[str, Any]  # of arrays


def kept(folder: bool | str | Path, request: tuple, code: list[str], compute: Callable[[], Arrays]) -> Arrays:
    """The arrays of `compute()`, from `folder` if it holds them; they are written there otherwise.

    `folder`: True for the user's own cache, False for none. They belong to the `repr` of the request and to
    the contents of the files `code`. A file that cannot be read is made anew; a folder that cannot be written
    is done without.
    """
    if folder is False:
        return compute()
    path = _folder(folder) / f"{_name(request, code)}.npz"
    try:
        with path.open("rb") as file, np.load(file) as archive:
            return dict(archive)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        arrays = compute()
    _write(path, arrays)
    return arrays


def _folder(folder: bool | str | Path) -> Path:
    from platformdirs import user_cache_path

    return user_cache_path("sysid") / "modes" if isinstance(folder, bool) else Path(folder)


def _name(request: tuple, code: list[str]) -> str:
    found = sha256(repr(request).encode())
    for path in code:
        found.update(Path(path).read_bytes())
    return found.hexdigest()


def _write(path: Path, arrays: Arrays) -> None:
    """Whole or not at all: others may read it meanwhile."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            part = Path(folder) / path.name
            np.savez(part, **arrays)
            part.replace(path)
    except OSError:
        return
