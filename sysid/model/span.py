"""Least squares over a few columns, with complex or real coefficients; and over an angle."""

from collections.abc import Sequence
from types import ModuleType

import jax.numpy as jnp
import numpy as np

from sysid.rows.hold import Leaf

REAL = 1e-3  # share of the prior of a real coefficient that its imaginary part has
ANGLES = 32  # at which a rotation is tried before Newton's method
TRIED = np.exp(2j * np.pi * np.arange(ANGLES) / ANGLES)
NEWTON = 5  # of its steps: from a 32nd of a turn to rounding


def module(array: Leaf) -> ModuleType:
    """numpy or jax.numpy, whichever the array is of."""
    return np if isinstance(array, (np.ndarray, np.generic)) else jnp


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
    determinant of the coefficients' information. Vectors may be several, (..., N).
    """

    def __init__(self, columns: Sequence[Leaf], real: bool = False):
        self.units: list[tuple[Leaf, Leaf]] = []
        self.real, self.volume = real, 0.0
        for i, unit in enumerate(columns):
            xp = module(unit)
            made_of = xp.eye(len(columns), dtype=unit.real.dtype if real else unit.dtype)[i]
            for other, weights in 2 * self.units:
                along = self._along(other, unit)
                unit, made_of = unit - along * other, made_of - along * weights
            size = xp.sqrt(xp.vdot(unit, unit).real)
            self.units.append((unit / size, made_of / size))
            self.volume = self.volume + (1 if real else 2) * xp.log(size)

    def off(self, v: Leaf) -> Leaf:
        for unit, _ in self.units:
            v = v - self._along(unit, v)[..., None] * unit
        return v

    def weights(self, v: Leaf) -> Leaf:
        """Least-squares weights of the columns in `v`."""
        none = module(v).zeros(len(self.units))
        return sum((self._along(unit, v) * made_of for unit, made_of in self.units), none)

    def _along(self, unit: Leaf, v: Leaf) -> Leaf:
        along = v @ unit.conj()
        return along.real if self.real else along


def turn_towards(left: Leaf, shape: Leaf) -> Leaf:
    """e^{j phi} that makes |left - e^{j phi} shape|^2 smallest; 1 where they have nothing in common."""
    xp = module(left)
    overlap = xp.vdot(shape, left)
    safe = xp.where(overlap == 0, 1.0, overlap)
    return safe / xp.hypot(safe.real, safe.imag)


def best_turn(left: Leaf, shape: Leaf, ahead: Leaf) -> Leaf:
    """e^{j phi} that makes |left - cos phi shape - sin phi ahead|^2 smallest: the best of ANGLES, then
    Newton's method, whose steps turn by 2 atan(step/2), so that no sine is compiled."""
    xp = module(left)
    p, q = (xp.vdot(v, left).real for v in (shape, ahead))
    a, b, d = (xp.vdot(u, v).real for u, v in ((shape, shape), (shape, ahead), (ahead, ahead)))
    c, s = xp.asarray(TRIED.real), xp.asarray(TRIED.imag)
    best = xp.argmin(0.5 * (a * c**2 + d * s**2) + b * c * s - p * c - q * s)
    c, s = c[best], s[best]
    for _ in range(NEWTON):
        slope = (d - a) * c * s + b * (c**2 - s**2) + p * s - q * c
        bend = (d - a) * (c**2 - s**2) - 4 * b * c * s + p * c + q * s
        half = -0.5 * xp.where(bend > 0, slope / xp.where(bend > 0, bend, 1.0), 0.0)
        less, more = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
        c, s = less * c - more * s, less * s + more * c
    return c + 1j * s


def inverted(gram: np.ndarray) -> np.ndarray:
    """(p, p) inverse of an information matrix, scaled to unit diagonal; what it holds nothing of has neither
    error nor weight."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
