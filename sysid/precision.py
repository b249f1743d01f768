"""How JAX is used, decided in one place: float64, and programs that compile fast.

Public functions run under `float64` and leave the host program's JAX flags as they were.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")


def float64(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with JAX in 64 bits: at 32.3 kHz a float32 carrier is off by a radian after 100 s."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return run


@cache
def _options() -> dict[str, bool]:
    """Compiler options that this JAX knows: without fusion emitters the fit compiles in two thirds of the time."""
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(1.0).compile()
    except Exception:  # an option that another version does not know is not worth a failure
        return {}
    return options


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """`function`, jitted on first use, with the static argument `layouts`."""
    program = cache(lambda: jax.jit(function, static_argnames="layouts", compiler_options=_options()))

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        return program()(*args, **kwargs)

    return run
