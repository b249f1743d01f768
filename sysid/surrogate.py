"""The posterior's density at a fraction of its price: each log's sum of squares as a polynomial, checked against the exact one.

Near a minimum the residual rows of a log are close to a cubic polynomial of the parameters. From the points of a design, where
they are evaluated, that polynomial is r(z) = sum_i w_i(z) r_i with w = m(z) M^+, m the monomials at z and M those at the design's
points; so its sum of squares is w K w^T with K_ij = Re r_i^* r_j, whatever the number of rows. Points further than FAR are
evaluated exactly, and where the polynomial is not FAITHFUL at other points, all are.
"""

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement
from math import comb

import jax
import jax.numpy as jnp
import numpy as np

from sysid.likelihood import Groups, density, residual_rows
from sysid.precision import compiled

FAR = 5.0  # standard deviations: of a hundred draws of the proposal one is further away
CHECKS = 32  # points at which the polynomial is compared; it is made from twice as many as it has coefficients
FAITHFUL = 1e-3  # of a log density: an acceptance changes by a thousandth
BATCH = 16  # points that are evaluated together: as many as the processor's cache takes
LARGEST = 1 << 18  # rows times points that are evaluated together, above which memory is what it waits for


@compiled
def _products(thetas, layouts, groups):
    """Of each log, group by group, the products (logs, n, n) of its residual rows at the points `thetas` (n, 6)."""

    def one(x, layout):
        batches = thetas.reshape(-1, BATCH, thetas.shape[1])
        rows = jax.lax.map(jax.vmap(lambda theta: residual_rows(theta, x, layout)), batches)
        rows = rows.reshape(len(thetas), -1)
        return rows.real @ rows.real.T + (rows.imag @ rows.imag.T if jnp.iscomplexobj(rows) else 0.0)

    return tuple(jax.lax.map(lambda x, layout=layout: one(x, layout), g) for layout, g in zip(layouts, groups, strict=True))


@compiled
def _log_densities(thetas, layouts, groups):
    def square(theta, x, layout):
        return jnp.sum(jnp.abs(residual_rows(theta, x, layout)) ** 2)

    def one(theta):
        each = [jax.vmap(lambda x, y=y: square(theta, x, y))(g) for y, g in zip(layouts, groups, strict=True)]
        return density(each, groups)

    return jax.vmap(one)(thetas)


class Density:
    """Log density at points z (n, p), in standard deviations from a minimum; `theta` makes parameters (n, 6) of them.

    `smooth`: whether the polynomial is used; `error` its largest deviation where it was checked.
    """

    def __init__(self, theta: Callable[[np.ndarray], np.ndarray], groups: Groups, smooth: bool):
        self.theta, self.smooth, self.error = theta, smooth, 0.0
        self.layouts, self.groups = tuple(g[0] for g in groups), tuple(g[1] for g in groups)
        self.batch = int(np.clip(LARGEST // max(layout.rows for layout in self.layouts), 1, BATCH))
        self.forms: list[np.ndarray] = []  # (logs, coefficients, coefficients) of each group

    def __call__(self, z: np.ndarray) -> np.ndarray:
        if self.smooth and not self.forms:
            self._build(z.shape[1])
        if not self.smooth:
            return self._exact(z)
        far = np.linalg.norm(z, axis=1) > FAR
        value = self._polynomial(z)
        if np.any(far):
            value[far] = self._exact(z[far])
        return value

    def _build(self, p: int) -> None:
        """The polynomial, unless it misses the exact density somewhere."""
        design, checks = _points(comb(p + 3, 3), p, seed=0), _points(CHECKS // 2, p, seed=1)
        n, z = len(design), np.concatenate([design, checks])
        z = np.concatenate([z, np.repeat(z[-1:], -len(z) % BATCH, axis=0)])
        products = [np.asarray(x) for x in _products(self.theta(z), self.layouts, self.groups)]
        weights = np.linalg.pinv(_monomials(design))
        self.forms = [weights @ x[:, :n, :n] @ weights.T for x in products]
        exact = self._of([np.diagonal(x, axis1=1, axis2=2)[:, n : n + CHECKS].T for x in products])
        self.error = float(np.max(np.abs(self._polynomial(checks) - exact)))
        self.smooth = bool(self.error <= FAITHFUL)

    def _polynomial(self, z: np.ndarray) -> np.ndarray:
        m = _monomials(z)
        pairs = (m[:, :, None] * m[:, None, :]).reshape(len(m), -1)
        return self._of([pairs @ form.reshape(len(form), -1).T for form in self.forms])

    def _exact(self, z: np.ndarray) -> np.ndarray:
        full = self.theta(np.concatenate([z, np.repeat(z[-1:], -len(z) % self.batch, axis=0)]))
        parts = [_log_densities(part, self.layouts, self.groups) for part in full.reshape(-1, self.batch, full.shape[1])]
        return _finite(np.concatenate(parts)[: len(z)])

    def _of(self, squares: Sequence[np.ndarray]) -> np.ndarray:
        return _finite(density(squares, self.groups, np))


def _finite(value: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(value), value, -np.inf)


def _points(pairs: int, p: int, seed: int) -> np.ndarray:
    """(2 pairs, p) points, each with the opposite one, at all distances up to FAR in random directions."""
    towards = np.random.default_rng(seed).standard_normal((pairs, p))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    z = FAR * np.sqrt((np.arange(pairs) + 0.5) / pairs)[:, None] * towards
    return np.concatenate([z, -z])


def _monomials(z: np.ndarray) -> np.ndarray:
    """(n, coefficients) of a cubic in z (n, p)."""
    n, p = z.shape
    powers = [c for degree in range(4) for c in combinations_with_replacement(range(p), degree)]
    return np.stack([np.prod(z[:, c] / FAR, axis=1) if c else np.ones(n) for c in powers], axis=1)
