"""How JAX and BLAS are used, decided in one place: float64, programs compiled once and kept, one thread.

Public functions run under `float64` and leave the host program's JAX flags as they were.
"""

import inspect
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial, update_wrapper, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
from threadpoolctl import ThreadpoolController

from sysid import kept

P = ParamSpec("P")
R = TypeVar("R")


def float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with JAX in 64 bits: at 32.3 kHz a float32 carrier is off by a radian after 100 s."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return run


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with one thread of BLAS, for the whole process while it runs: its matrices are of a few
    hundred rows and a dozen columns, and threads that wait for one another take twice as long as one, on a
    busy machine fifty times."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with _blas().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return run


@cache
def _blas() -> ThreadpoolController:
    """The libraries of numpy and scipy, which are loaded when something is first fitted."""
    return ThreadpoolController()


def _options(seldom: bool, largest: int) -> dict[str, Any]:
    """Compiler options, by whether a program is seldom called and the numbers of its largest array. Without
    fusion emitters the fit compiles in two thirds of the time. At level 1 of 3 a program is as fast and
    compiles in three quarters of the time; at 0 it takes twice the time and compiles in a third. Sums in
    stages, which keep the rounding of long ones small, are half of what there is to compile. The optimization
    barriers of a program, which the CPU's compiler drops by itself, halve the time of the density."""
    large = largest >= LARGE
    return {
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": min(os.cpu_count() or 1, 32),
        "xla_backend_optimization_level": 0 if seldom and largest < SLOW else 1,
        "xla_disable_hlo_passes": "cse_barrier_expander"
        if large
        else "cse_barrier_expander,tree_reduction_rewriter",
    }


# Numbers in the largest array, from which on sums are long; and from which on what is seldom called is worth
# compiling well: 1.4 s are then less than a hundred calls gain.
LARGE, SLOW = 1 << 16, 1 << 13
_all: list[Any] = []  # whatever keeps programs
_beside: list[ThreadPoolExecutor] = []  # threads that make programs, in a process of one's own


def keep_programs(folder: Path) -> None:
    """Keep this process's programs in `folder` instead of the user's own (`sysid.kept`)."""
    kept.choose(folder / "programs")


def make_beside() -> None:
    """Let programs be made by threads, as compilers and loaders leave the interpreter to others. For a
    process of one's own, that does not fork: a host program's threads are its own business."""
    if not _beside:
        _beside.append(ThreadPoolExecutor(2, "compiler"))


def makes_beside() -> bool:
    """Whether programs are made by threads."""
    return bool(_beside)


def forget_programs() -> None:
    """Forget what this process compiled, as if it had just begun; what is kept on disk stays."""
    for function in _all:
        function.programs.clear()
    jax.clear_caches()


class compiled:
    """`function(*arrays, layout, given)` compiled once for each layout, anything that can be a key, and
    shapes, and kept on disk (`sysid.kept`). The arrays, and those in the pytree `given`, are of 64 bits.

    `seldom`: called so few times that compiling it well costs more than it saves.
    """

    def __init__(self, function: Callable[..., Any], seldom: bool = False):
        self.function, self.seldom = function, seldom
        self.programs: dict[tuple, Future[Callable[..., Any]]] = {}
        _all.append(self)

    def __call__(self, *args: Any) -> Any:
        *arrays, _, given = args
        return self._made(args).result()(*arrays, given)

    def prepare(self, *args: Any) -> None:
        """Begin to make the program of such arguments beside what goes on here, where this `makes_beside`."""
        if _beside:
            self._made(args, _beside[0].submit)

    def _made(self, args: Sequence, begin: Callable[..., Future] | None = None) -> Future[Callable[..., Any]]:
        *arrays, layout, given = args
        key = (layout, *(x.shape for x in arrays), *(x.shape for x in jax.tree.leaves(given)))
        if key not in self.programs:
            shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (*arrays, given))
            self.programs[key] = (begin or _at_once)(float64(self._program), layout, shapes)
        return self.programs[key]

    def _program(self, layout: Any, shapes: tuple) -> Callable[..., Any]:
        options = _options(self.seldom, max(math.prod(x.shape) for x in jax.tree.leaves(shapes)))

        def program(*args):
            return self.function(*args[:-1], layout, args[-1])

        identity = f"{options} {layout} {shapes}"
        return kept.program(
            self.function, identity, lambda: _compiled(jax.jit(program).lower(*shapes), options)
        )


def _compiled(lowered: Any, options: dict[str, Any]) -> Callable[..., Any]:
    try:
        return lowered.compile(compiler_options=options)
    except jax.errors.JaxRuntimeError:  # an option that another version does not know is not worth a failure
        return lowered.compile()


def _at_once(function: Callable[..., R], *args: Any) -> Future[R]:
    done: Future[R] = Future()
    done.set_result(function(*args))
    return done


seldom = partial(compiled, seldom=True)


class jitted:
    """`jax.jit(function, static_argnames=static)`, its programs kept on disk; within another program it is a
    part of that."""

    def __init__(self, function: Callable[..., Any], static: str):
        self.function, self.static = function, static
        self.inner = jax.jit(function, static_argnames=static)
        self.signature = inspect.signature(function)
        self.programs: dict[tuple, Callable[..., Any]] = {}
        update_wrapper(self, function)
        _all.append(self)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        given = self.signature.bind(*args, **kwargs).arguments
        leaves, tree = jax.tree.flatten({name: value for name, value in given.items() if name != self.static})
        plain = jax.config.jax_disable_jit  # type: ignore[attr-defined]
        if plain or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return self.inner(*args, **kwargs)
        static, types = {self.static: given[self.static]}, tuple(map(jax.typeof, leaves))
        real = jax.dtypes.canonicalize_dtype(float)  # of 32 or 64 bits
        key = (given[self.static], tree, types, real)
        if key not in self.programs:

            def program(leaves):
                return self.function(**jax.tree.unflatten(tree, leaves), **static)

            options = _options(False, max(math.prod(x.shape) for x in types))
            identity = f"{options} {static} {tree} {types} {real}"
            make = lambda: _compiled(jax.jit(program).lower(leaves), options)  # noqa: E731
            self.programs[key] = kept.program(self.function, identity, make)
        return self.programs[key](leaves)
