"""How a state is carried from interval to interval, in jax and in numpy."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import lapack

from sysid.rows.hold import Leaf

FEW = 32  # plants at once, each of which is solved for itself
ONE_LANE = 64  # intervals that are taken one after the other


def carried(
    growth: Leaf, target: Leaf, kick: Leaf | None = None, xp: Any = jnp
) -> tuple[tuple[Leaf, Leaf], tuple[Leaf, Leaf]]:
    """State before each interval, and after the last, of Z+ = Z + growth (Z + target): from rest, and of a
    unit start.

    Arrays (M, ...) of the module `xp`. `kick` is added to the state from rest as each interval begins.

    Many intervals are taken in lanes that run side by side and are joined at the end; |1 + growth| <= 1 keeps
    that stable.
    """
    if xp is np and growth[0].size <= FEW:
        return _solved(growth, target, kick)
    count, *plants = growth.shape
    lanes = 1 if count <= ONE_LANE else 1 << (math.isqrt(count).bit_length() - 1)
    idle = xp.zeros((-count % lanes, *plants), growth.dtype)  # intervals in which nothing happens

    def advance(state, interval):
        forced, free = state
        growth, target, *kick = interval
        forced = forced + kick[0] if kick else forced
        return (forced + growth * (forced + target), free + growth * free), state

    def join(state, lane):
        forced, free = state
        return (lane[0] + lane[1] * forced, lane[1] * free), state

    scan = jax.lax.scan if xp is jnp else _scan
    rest = (xp.zeros((lanes, *plants), growth.dtype), xp.ones((lanes, *plants), growth.dtype))
    given = (xp.concatenate([v, idle]) if len(idle) else v for v in (growth, target, kick) if v is not None)
    steps = tuple(v.reshape(lanes, -1, *plants).swapaxes(0, 1) for v in given)
    ends, (forced, free) = scan(advance, rest, steps)
    if lanes == 1:
        return (forced[:, 0], free[:, 0]), (ends[0][0], ends[1][0])
    last, (before, share) = scan(join, (rest[0][0], rest[1][0]), ends)
    forced, free = (
        v.swapaxes(0, 1).reshape(-1, *plants)[:count] for v in (forced + free * before, free * share)
    )
    return (forced, free), last


def _solved(growth: np.ndarray, target: np.ndarray, kick: np.ndarray | None) -> tuple:
    """`carried` of few plants."""
    plants, factor = growth.shape[1:], (1 + growth).reshape(len(growth), -1)
    push = (growth * target if kick is None else growth * target + (1 + growth) * kick).reshape(factor.shape)
    after = np.stack([accumulated(f, p) for f, p in zip(factor.T, push.T, strict=True)], axis=1)
    free = np.cumprod(factor, axis=0)
    before = (
        np.concatenate([first, v[:-1]])
        for first, v in ((0 * after[:1], after), (np.ones_like(free[:1]), free))
    )
    forced, share = (v.reshape(-1, *plants) for v in before)
    return (forced, share), (after[-1].reshape(plants), free[-1].reshape(plants))


def accumulated(factor: np.ndarray, push: np.ndarray) -> np.ndarray:
    """z after each step of z+ = factor z + push from zero: a bidiagonal system, solved row after row."""
    band = np.ones((2, len(push)), complex, order="F")
    band[1, :-1] = -factor[1:]
    return lapack.ztbtrs(band, push, uplo="L", diag="U")[0].reshape(len(push))


def _scan(step: Callable, state: tuple, inputs: tuple[np.ndarray, ...]) -> tuple[tuple, list[np.ndarray]]:
    """`jax.lax.scan` in numpy."""
    seen = []
    for given in zip(*inputs, strict=True):
        state, found = step(state, given)
        seen.append(found)
    return state, [np.stack(v) for v in zip(*seen, strict=True)]
