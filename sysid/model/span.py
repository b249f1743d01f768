"""Least squares over a few columns, with complex or real coefficients; and over an angle."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sysid.rows.hold import Leaf

REAL = 1e-3  # share of the prior of a real coefficient that its imaginary part has
ANGLES = 32  # at which a rotation is tried before Newton's method
TRIED = np.exp(2j * np.pi * np.arange(ANGLES) / ANGLES)
NEWTON = 5  # of its steps: from a 32nd of a turn to rounding


def times(a: Leaf, v: Leaf) -> Leaf:
    """a v; where `a` is complex, real part by real part and imaginary part by imaginary part. numpy or
    jax.numpy."""
    return a.real * v.real + 1j * (a.imag * v.imag) if np.iscomplexobj(a) else a * v


def orthonormal(columns: np.ndarray, alike: float) -> np.ndarray:
    """(n, r) basis of columns (n, K) in numpy; some may be zero, or sums of others but for `alike` of their
    size."""
    size = np.linalg.norm(columns, axis=0)
    if not np.any(size > 0):
        return columns[:, :0]
    q, r = np.linalg.qr(columns[:, size > 0] / size[size > 0])
    u, s, _ = np.linalg.svd(r, full_matrices=False)
    return q @ u[:, s > alike * s[0]]


class Span:
    """The span of a few columns (N,): Gram-Schmidt, twice, remembering each unit vector's weights of the
    columns. `real`: with real coefficients, of complex columns too. `volume`: half the logarithm of the
    determinant of the coefficients' information.
    """

    def __init__(self, columns: Sequence[Array], real: bool = False):
        self.units: list[tuple[Array, Array]] = []
        self.real, self.volume = real, jnp.zeros(())
        for i, unit in enumerate(columns):
            made_of = jnp.eye(len(columns), dtype=unit.real.dtype if real else unit.dtype)[i]
            for other, weights in 2 * self.units:
                along = self._along(other, unit)
                unit, made_of = unit - along * other, made_of - along * weights
            size = jnp.sqrt(jnp.vdot(unit, unit).real)
            self.units.append((unit / size, made_of / size))
            self.volume += (1 if real else 2) * jnp.log(size)

    def off(self, v: Array) -> Array:
        for unit, _ in self.units:
            v = v - self._along(unit, v) * unit
        return v

    def weights(self, v: Array) -> Array:
        """Least-squares weights of the columns in `v`."""
        return sum(
            (self._along(unit, v) * made_of for unit, made_of in self.units), jnp.zeros(len(self.units))
        )

    def _along(self, unit: Array, v: Array) -> Array:
        along = jnp.vdot(unit, v)
        return along.real if self.real else along


def turn_towards(left: Array, shape: Array) -> Array:
    """e^{j phi} that makes |left - e^{j phi} shape|^2 smallest; 1 where they have nothing in common."""
    overlap = jnp.vdot(shape, left)
    safe = jnp.where(overlap == 0, 1.0, overlap)
    return safe / jnp.hypot(safe.real, safe.imag)


def best_turn(left: Array, shape: Array, ahead: Array) -> Array:
    """e^{j phi} that makes |left - cos phi shape - sin phi ahead|^2 smallest: the best of ANGLES, then
    Newton's method, whose steps turn by 2 atan(step/2), so that no sine is compiled."""
    p, q = (jnp.vdot(v, left).real for v in (shape, ahead))
    a, b, d = (jnp.vdot(u, v).real for u, v in ((shape, shape), (shape, ahead), (ahead, ahead)))
    c, s = jnp.array(TRIED.real), jnp.array(TRIED.imag)
    best = jnp.argmin(0.5 * (a * c**2 + d * s**2) + b * c * s - p * c - q * s)
    turn = jnp.array(TRIED)[best]
    for _ in range(NEWTON):
        c, s = turn.real, turn.imag
        slope = (d - a) * c * s + b * (c**2 - s**2) + p * s - q * c
        bend = (d - a) * (c**2 - s**2) - 4 * b * c * s + p * c + q * s
        half = -0.5 * jnp.where(bend > 0, slope / jnp.where(bend > 0, bend, 1.0), 0.0)
        turn = turn * jax.lax.complex(1 - half**2, 2 * half) / (1 + half**2)
    return turn


def inverted(gram: np.ndarray) -> np.ndarray:
    """(p, p) inverse of an information matrix, scaled to unit diagonal; what it holds nothing of has neither
    error nor weight."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
