"""Least squares over a few columns, with complex or real coefficients; and over an angle. Leading axes are of
logs, or of plants."""

import numpy as np

REAL = 1e-3  # share of the prior of a real coefficient that its imaginary part has
ANGLES = 32  # at which a rotation is tried before Newton's method
TRIED = np.exp(2j * np.pi * np.arange(ANGLES) / ANGLES)
NEWTON = 5  # of its steps: from a 32nd of a turn to rounding


def times(a: np.ndarray, v: np.ndarray) -> np.ndarray:
    """a v; where `a` is complex, real part by real part and imaginary part by imaginary part."""
    return a.real * v.real + 1j * (a.imag * v.imag) if np.iscomplexobj(a) else a * v


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...,) the sum of conj(a) b over the last axis."""
    return np.einsum("...n,...n->...", a.conj(), b)


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
    """The span of columns (..., K, N). `real`: with real coefficients, of complex columns too. `volume`
    (...,): half the logarithm of the determinant of the coefficients' information.
    """

    def __init__(self, columns: np.ndarray, real: bool = False):
        self.real = real
        self.units, self.made = np.linalg.qr(np.swapaxes(self._rows(columns), -1, -2))
        numbers = 2 if np.iscomplexobj(self.made) else 1  # in a coefficient
        size = np.abs(np.diagonal(self.made, axis1=-2, axis2=-1))
        self.volume: np.ndarray = numbers * np.sum(np.log(size), axis=-1)

    def off(self, v: np.ndarray) -> np.ndarray:
        """Vectors (..., m, N) less their parts in the span."""
        rows = self._rows(v)
        return (rows - self._along(rows) @ np.swapaxes(self.units, -1, -2)).view(v.dtype)

    def weights(self, v: np.ndarray) -> np.ndarray:
        """(..., K) least-squares weights of the columns in a vector (..., N)."""
        return np.linalg.solve(self.made, np.swapaxes(self._along(self._rows(v[..., None, :])), -1, -2))[
            ..., 0
        ]

    def _along(self, rows: np.ndarray) -> np.ndarray:
        return rows @ self.units.conj()

    def _rows(self, v: np.ndarray) -> np.ndarray:
        """Vectors as they are, or real and imaginary parts side by side."""
        return np.ascontiguousarray(v, complex).view(float) if self.real else v


def best_turn(left: np.ndarray, shape: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """(...,) e^{j phi} that makes |left - cos phi shape - sin phi ahead|^2 smallest: the best of ANGLES, then
    Newton's method, whose steps turn by 2 atan(step/2)."""
    p, q = (dot(v, left).real for v in (shape, ahead))
    a, b, d = (dot(u, v).real for u, v in ((shape, shape), (shape, ahead), (ahead, ahead)))
    squares = np.stack([0.5 * a, 0.5 * d, b, -p, -q], axis=-1)
    c, s = TRIED.real, TRIED.imag
    best = np.argmin(squares @ np.stack([c**2, s**2, c * s, c, s]), axis=-1)
    c, s = c[best], s[best]
    for _ in range(NEWTON):
        slope = (d - a) * c * s + b * (c**2 - s**2) + p * s - q * c
        bend = (d - a) * (c**2 - s**2) - 4 * b * c * s + p * c + q * s
        half = -0.5 * np.where(bend > 0, slope / np.where(bend > 0, bend, 1.0), 0.0)
        less, more = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
        c, s = less * c - more * s, less * s + more * c
    return c + 1j * s


def inverted(gram: np.ndarray) -> np.ndarray:
    """(p, p) inverse of an information matrix, scaled to unit diagonal; what it holds nothing of has neither
    error nor weight."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
