"""Many intervals side by side: states of one and of two modes before each, in lanes that are joined."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array


class Mode(NamedTuple):
    """State of one resonance: the response Z in the frame of the drive, its velocity U in the frame of the
    plate."""

    response: Array
    velocity: Array


def split(response: Array, velocity: Array, still: tuple[Array, ...]) -> tuple[Array, Array]:
    """(Z1, Z2) of (Z, U). The poles of the plate differ by 2j wd, without a real part."""
    slow, fast = still
    turned = (velocity - fast * response) * (1 / (slow.imag - fast.imag))
    first = jax.lax.complex(turned.imag, -turned.real)
    return first, response - first


def gathered(growth: Array, target: Array, state: Array) -> tuple[Array, Array]:
    """z before each interval (steps, lanes) of z+ = z + growth (z + target), and after the last: what each
    lane does as a whole, then the lanes joined, then each lane from where it begins. |1 + growth| <= 1 keeps
    that stable."""

    if growth.shape == (1, 1):
        return jnp.reshape(state, (1, 1)), state + growth[0, 0] * (state + target[0, 0])

    def whole(done, now):
        share, offset = done
        growth, target = now
        return (share + growth * share, offset + growth * (offset + target)), None

    def along(z, now):
        growth, target = now
        return z + growth * (z + target), z

    def join(z, lane):
        share, offset = lane
        return share * z + offset, z

    one, zero = jnp.ones(growth.shape[1], complex), jnp.zeros(growth.shape[1], complex)
    lanes, _ = jax.lax.scan(whole, (one, zero), (growth, target))
    last, begins = jax.lax.scan(join, state, lanes)
    return jax.lax.scan(along, begins, (growth, target))[1], last


class Interval(NamedTuple):
    """What both modes do over an interval: growth e^{s t} - 1, the response they settle at, negated (None:
    not driven), poles of the plate, and the turn of the frame as it begins."""

    growths: tuple[Array, ...]
    targets: tuple[Array, ...] | None
    still: tuple[Array, ...]
    turn: Array | None

    def over(self, mode: Mode) -> tuple[Mode, tuple[Array, ...]]:
        """The state after the interval, and each mode's response as it begins."""
        mode = mode if self.turn is None else Mode(*(v * self.turn for v in mode))
        parts = split(*mode, self.still)
        away = parts if self.targets is None else [z + t for z, t in zip(parts, self.targets, strict=True)]
        first, second = (g * z for g, z in zip(self.growths, away, strict=True))
        slow, fast = self.still
        return Mode(mode.response + (first + second), mode.velocity + (slow * first + fast * second)), parts


def gathered_modes(interval: Interval, mode: Mode) -> tuple[tuple[Array, ...], Mode]:
    """As `gathered`, of both modes, which change into one another where the resonance itself changes: (Z1,
    Z2)."""
    if interval.growths[0].shape == (1, 1):
        last, parts = jax.tree.map(lambda v: v[0, 0], interval).over(mode)
        return tuple(jnp.reshape(z, (1, 1)) for z in parts), last

    def whole(done, now):
        by_response, by_velocity, offset = done
        free = now._replace(targets=None)
        return (free.over(by_response)[0], free.over(by_velocity)[0], now.over(offset)[0]), None

    def join(mode, lane):
        (a, c), (b, d), (p, q) = lane
        return Mode(
            a * mode.response + b * mode.velocity + p, c * mode.response + d * mode.velocity + q
        ), mode

    one, zero = (fill(interval.growths[0].shape[1], complex) for fill in (jnp.ones, jnp.zeros))
    lanes, _ = jax.lax.scan(whole, (Mode(one, zero), Mode(zero, one), Mode(zero, zero)), interval)
    last, begins = jax.lax.scan(join, mode, lanes)
    return jax.lax.scan(lambda mode, now: now.over(mode), begins, interval)[1], last
