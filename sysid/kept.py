"""Compiled programs, and arrays that take long to make, on disk: found by name, checked before they are
loaded, written whole, the longest unused dropped.

They are of this machine, this JAX and this code alone; whoever may write into the folder may run code here.
"""

import io
import logging
import os
import pickle
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # help waits for no library
    import numpy as np

log = logging.getLogger(__name__)
SWITCH = "SYSID_PROGRAMS"  # environment variable: a folder to keep programs in, or `off`
LARGEST = 256 << 20  # bytes that all programs together may take
ROOT = Path(__file__).parents[1]  # of the packages
_folder: list[Path] = []  # that a program of its own has chosen


def user_cache() -> Path:
    """The user's folder for what a later run saves time with."""
    from platformdirs import user_cache_path

    return user_cache_path("sysid")


def choose(where: Path) -> None:
    """Keep this process's programs in the folder `where`, whatever folder the environment names; its `off`
    goes before it."""
    _folder[:] = [where]


def folder() -> Path | None:
    """Where programs are kept; None for nowhere."""
    stated = os.environ.get(SWITCH, "")
    if stated.lower() == "off":
        return None
    return next(iter(_folder), Path(stated) if stated else user_cache() / "programs")


def program(function: Callable, identity: str, make: Callable[[], Any]) -> Any:
    """The compiled program of `function` that `make()` gives, or the one of that `identity` that is kept. One
    that is broken, cut off or of another kind is made anew; a folder that cannot be used is done without."""
    where, package = folder(), function.__module__.partition(".")[0]
    if where is None or not (ROOT / package / "__init__.py").exists():  # code whose text is not known
        return make()
    whole = f"{_machine(package)} {_flags()} {function.__module__} {function.__qualname__} {identity}"
    path = where / f"{function.__name__}-{sha256(whole.encode()).hexdigest()}"

    def anew() -> Any:
        log.info("compiling %s, for later runs too", function.__name__.strip("_").replace("_", " "))
        made = make()
        if (
            not _cached_by_jax()
        ):  # what JAX loads from a cache of its own is not whole when it is written again
            _write(path, made)
        return made

    return anew() if (found := _read(path)) is None else _Loaded(found, anew)


def arrays(
    name: str, identity: str, make: Callable[[], Mapping[str, "np.ndarray"]]
) -> dict[str, "np.ndarray"]:
    """The arrays that `make()` gives, or those of that `identity` that are kept."""
    if (where := folder()) is None:
        return dict(make())
    whole = f"{_machine('sysid')} {identity}"
    path = where / f"{name}-{sha256(whole.encode()).hexdigest()}"
    if found := _arrays(path):
        return found
    with _alone(path):
        return _arrays(path) or _made(path, make)


def _arrays(path: Path) -> "dict[str, np.ndarray]":
    """Those in the file; none where it is not there, or not whole."""
    import numpy as np

    if (content := _content(path)) is not None:
        with suppress(Exception), np.load(io.BytesIO(content)) as found:
            return {key: found[key] for key in found.files}
    return {}


def _made(path: Path, make: Callable[[], Mapping[str, "np.ndarray"]]) -> "dict[str, np.ndarray]":
    """What `make()` gives, which is kept."""
    import numpy as np

    file, made = io.BytesIO(), dict(make())
    np.savez(file, **made)  # type: ignore[arg-type]
    with suppress(Exception):  # no room, or no right
        _put(path, file.getvalue())
    return made


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """While one process makes a file, others that want it wait; a lock ends with its process. Where there are
    no locks, each makes it."""
    with ExitStack() as stack:
        with suppress(ImportError, OSError):
            import fcntl

            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            place = path.with_name(f".lock-{path.name}")
            file = stack.enter_context(open(place, "w"))
            stack.callback(place.unlink, missing_ok=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


class _Loaded:
    """A program from disk. That a part of it is missing JAX may find out only as it runs: it is then made
    `anew`."""

    def __init__(self, found: Callable, anew: Callable[[], Callable]):
        self.found, self.anew, self.ran = found, anew, False

    def __call__(self, *args: Any) -> Any:
        if self.ran:
            return self.found(*args)
        import jax

        try:
            result = jax.block_until_ready(self.found(*args))
        except jax.errors.JaxRuntimeError:
            self.found = self.anew()
            result = self.found(*args)
        self.ran = True
        return result


def _cached_by_jax() -> bool:
    import jax

    return bool(jax.config.values.get("jax_compilation_cache_dir"))


def _content(path: Path) -> bytes | None:
    """What is kept in the file, which was used now; None where it is not whole."""
    with suppress(OSError):
        content = path.read_bytes()
        if sha256(content[32:]).digest() == content[:32]:
            os.utime(path)
            return content[32:]
    return None


def _read(path: Path) -> Any:
    """The program in the file; None where there is none that can be used."""
    if (content := _content(path)) is None:
        return None
    try:
        import jax
        import numpy as np
        from jax.experimental.serialize_executable import deserialize_and_load
        from jaxlib.lapack import prepare_lapack_call

        # JAX looks LAPACK's functions up as it lowers a call of one; a loaded program would call what is not
        # there.
        prepare_lapack_call("potrf", np.dtype(float))
        payload, takes, gives = pickle.loads(content)
        return deserialize_and_load(payload, takes, gives, execution_devices=jax.devices()[:1])
    except Exception:  # whatever is wrong with it, it can be made
        return None


def _write(path: Path, made: Any) -> None:
    """A program, where there is room and right, and JAX can write it."""
    from jax.experimental.serialize_executable import serialize

    with suppress(Exception):
        _put(path, pickle.dumps(serialize(made)))


def _put(path: Path, content: bytes) -> None:
    """Whole or not at all: others may read it, or write the same, meanwhile."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    file, part = tempfile.mkstemp(dir=path.parent, prefix=".part-")
    try:
        with os.fdopen(file, "wb") as out:
            out.write(sha256(content).digest() + content)
        os.replace(part, path)
    finally:
        with suppress(OSError):
            os.unlink(part)
    _drop(path.parent)


def _drop(where: Path) -> None:
    """Remove the files that have not been used for longest, until the others are few enough."""
    files = sorted(((s := path.stat()).st_mtime, s.st_size, path) for path in where.iterdir())
    excess = sum(size for _, size, _ in files) - LARGEST
    for _, size, path in files:
        if excess <= 0:
            return
        path.unlink(missing_ok=True)
        excess -= size


@cache
def _machine(package: str) -> str:
    """What a program depends on beside what it computes: the text of this package and of its own, JAX, the
    processor."""
    import jax
    import jaxlib

    files = [path for name in sorted({"sysid", package}) for path in sorted((ROOT / name).rglob("*.py"))]
    text = sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
    system = (jax.__version__, jaxlib.__version__, jax.default_backend(), platform.platform(), _processor())
    return f"{system} {os.environ.get('XLA_FLAGS')} {text}"


def _processor() -> str:
    """The processor with the instructions that it has, as far as the system tells."""
    with suppress(OSError):
        lines = (
            Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n")[0].splitlines()
        )
        return " ".join(
            line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))
        )
    return f"{platform.machine()} {platform.processor()}"


def _flags() -> str:
    """JAX's flags, any of which may change a program, but for those that say what is logged and kept."""
    import jax

    silent = ("cache", "log", "traceback", "dump")
    return str(
        sorted((k, str(v)) for k, v in jax.config.values.items() if not any(word in k for word in silent))
    )
