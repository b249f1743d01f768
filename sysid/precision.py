"""How JAX is used, decided in one place: float64, and programs that are compiled once and kept.

Public functions run under `float64` and leave the host program's JAX flags as they were.
"""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial, wraps
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.export

P = ParamSpec("P")
R = TypeVar("R")


def float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with JAX in 64 bits: at 32.3 kHz a float32 carrier is off by a radian after 100 s."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return run


def _options(seldom: bool, largest: int) -> dict[str, Any]:
    """Compiler options, by whether a program is seldom called and the numbers of its largest array. Without fusion emitters the
    fit compiles in two thirds of the time. At level 1 of 3 a program is as fast and compiles in three quarters of the time; at 0
    it takes twice the time and compiles in a third. Sums in stages, which keep the rounding of long ones small, are half of what
    there is to compile. The optimization barriers of a program, which the CPU's compiler drops by itself, halve the time of the
    density."""
    large = largest >= LARGE
    return {
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": min(os.cpu_count() or 1, 32),
        "xla_backend_optimization_level": 0 if seldom and not large else 1,
        "xla_disable_hlo_passes": "cse_barrier_expander" if large else "cse_barrier_expander,tree_reduction_rewriter",
    }


LARGE = 1 << 16  # numbers in the largest array, from which on sums are long, and what is seldom called is worth optimising
_traced: list[Path] = []  # the folder of traced programs, when there is one
_all: list["compiled"] = []
_beside: list[ThreadPoolExecutor] = []  # threads that make programs, in a process of one's own


def keep_programs(folder: Path) -> None:
    """Keep compiled and traced programs in `folder` for later processes; for a program that owns its process."""
    with suppress(OSError):
        (folder / "traced").mkdir(parents=True, exist_ok=True)
        _traced[:] = [folder / "traced"]
        jax.config.update("jax_compilation_cache_dir", str(folder / "compiled"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def make_beside() -> None:
    """Let programs be made by threads, as compilers and loaders leave the interpreter to others. For a process of one's own, that
    does not fork: a host program's threads are its own business."""
    if not _beside:
        _beside.append(ThreadPoolExecutor(2, "compiler"))


def forget_programs() -> None:
    """Forget what this process compiled, as if it had just begun; what is kept on disk stays."""
    for function in _all:
        function.programs.clear()
    jax.clear_caches()


@cache
def _version() -> str:
    """What a traced program depends on beside its layout: this package's text and JAX."""
    text = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py")))
    return f"{jax.__version__} {jax.default_backend()} {sha256(text).hexdigest()}"


class compiled:
    """`function(*arrays, layouts, groups)` compiled once for each layout; with `keep_programs`, traced once for all time.
    The arrays, and those in the groups, are of 64 bits.

    `seldom`: called so few times that compiling it well costs more than it saves.
    A trace is kept as StableHLO, which is data: nothing in it runs when it is read.
    """

    def __init__(self, function: Callable[..., Any], seldom: bool = False):
        self.function, self.seldom = function, seldom
        self.programs: dict[tuple, Future[Callable[..., Any]]] = {}
        _all.append(self)

    def __call__(self, *args: Any) -> Any:
        *arrays, _, groups = args
        return self._made(args).result()(*arrays, groups)

    def prepare(self, arguments: Callable[[], Sequence]) -> None:
        """Begin to make the program of such arguments beside what goes on here, where `make_beside` has allowed it."""
        if _beside:
            self._made(arguments(), _beside[0].submit)

    def _made(self, args: Sequence, begin: Callable[..., Future] | None = None) -> Future[Callable[..., Any]]:
        *arrays, layouts, groups = args
        key = (layouts, *(x.shape for x in arrays), *(x.shape for x in jax.tree.leaves(groups)))
        if key not in self.programs:
            shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (*arrays, groups))
            self.programs[key] = (begin or _at_once)(float64(self._program), layouts, shapes)
        return self.programs[key]

    def _program(self, layouts: tuple, shapes: tuple) -> Callable[..., Any]:
        def program(*args):
            return self.function(*args[:-1], layouts, args[-1])

        traced: Any = jax.jit(program)
        if _traced:
            key = f"{_version()} {layouts} {shapes}"
            traced = _kept(_traced[0] / f"{self.function.__name__}-{sha256(key.encode()).hexdigest()}", traced, shapes)
        largest = max(math.prod(x.shape) for x in jax.tree.leaves(shapes))
        lowered = jax.jit(traced).lower(*shapes)
        try:
            return lowered.compile(compiler_options=_options(self.seldom, largest))
        except jax.errors.JaxRuntimeError:  # an option that another version does not know is not worth a failure
            return lowered.compile()


def _at_once(function: Callable[..., R], *args: Any) -> Future[R]:
    done: Future[R] = Future()
    done.set_result(function(*args))
    return done


seldom = partial(compiled, seldom=True)


def _kept(path: Path, program: Any, shapes: tuple) -> Callable[..., Any]:
    """The trace in `path`, or a new one that is put there."""
    try:
        return jax.export.deserialize(bytearray(path.read_bytes())).call
    except Exception:  # absent, cut off, or of another kind: made anew
        exported = jax.export.export(program)(*shapes)
    with suppress(OSError):
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(exported.serialize())
        part.replace(path)
    return exported.call
