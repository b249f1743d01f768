"""A cheap posterior density: each log's sum of squares as a polynomial, checked against the exact density.

Near a minimum the residual rows of a log are close to a cubic polynomial of the parameters. Evaluated at the
points u_i of a design, in standard deviations from the minimum, that polynomial is r(u) = sum_i w_i(u) r_i
with w = m(u) M^+, where m are the monomials at u and M those at the design's points. Its sum of squares is
w K w^T with K_ij = Re r_i^* r_j, at a cost independent of the number of rows. Each of several minima has one.
Points further than FAR from all of them are evaluated exactly, and so are those about a minimum whose
polynomial is not FAITHFUL at other points.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations_with_replacement
from math import comb
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np

from sysid.model.course import of_plants
from sysid.model.experiment import Experiment, Groups, Layout, each
from sysid.model.likelihood import density, residual
from sysid.posterior.mixture import Mixture

FAR = 5.0  # standard deviations: of a hundred draws of the proposal one is further away
# points at which the polynomial is compared; it is made from twice as many as it has coefficients
CHECKS = 32
FAITHFUL = 1e-3  # of a log density: an acceptance changes by a thousandth
BATCH = 16  # points that are evaluated together: as many as the processor's cache takes
LARGEST = 1 << 18  # rows times points that are evaluated together, above which memory is what it waits for
MANY = 1 << 19  # rows of all logs whose products are taken together: a hundred points of them are a gigabyte


def _batch(groups: Groups) -> int:
    """Points that are evaluated together."""
    return int(np.clip(LARGEST // max(layout.rows for layout, _ in groups), 1, BATCH))


class _Cubic(NamedTuple):
    """About one minimum, of each group: `forms` (logs, coefficients, coefficients) of the sums of squares,
    and `volumes` (coefficients, logs)."""

    forms: list[np.ndarray]
    volumes: list[np.ndarray]


class Density:
    """Log density at points z (n, p), in standard deviations from the best minimum; `theta` converts them to
    parameters (n, 6).

    `about`: the minima about which it may be a polynomial; None where all points are evaluated. `error`: its
    largest deviation where it was checked. `pace`: seconds per exact evaluation. None is begun after `until`
    (perf_counter): TimeoutError.
    """

    def __init__(
        self,
        theta: Callable[[np.ndarray], np.ndarray],
        groups: Groups,
        about: Mixture | None,
        until: float = np.inf,
    ):
        self.theta, self.about, self.error, self.until, self.pace = theta, about, 0.0, until, 0.0
        self.groups, self.batch = groups, _batch(groups)
        self.cubics: list[_Cubic | None] = []  # about each minimum; None where it is not faithful

    def __call__(self, z: np.ndarray) -> np.ndarray:
        if self.about is None:
            return self._exact(z)
        if not self.cubics:
            self._build(self.about)
        places = np.array([self.about.away(k, z) for k in range(len(self.cubics))])
        far = np.linalg.norm(places, axis=2)
        nearest, value = np.argmin(far, axis=0), np.empty(len(z))
        exact = np.min(far, axis=0) > FAR
        for k, cubic in enumerate(self.cubics):
            here = (nearest == k) & ~exact
            if cubic is None:
                exact |= here
            elif np.any(here):
                value[here] = self._by_cubic(cubic, places[k, here])
        if np.any(exact):
            value[exact] = self._exact(z[exact])
        return value

    @property
    def smooth(self) -> bool:
        """Whether it is a polynomial anywhere."""
        return any(cubic is not None for cubic in self.cubics)

    def _build(self, about: Mixture) -> None:
        """Make the polynomials; one that misses the exact density somewhere is dropped."""
        p = about.centres.shape[1]
        design, checks = _points(comb(p + 3, 3), p, seed=0), _points(CHECKS // 2, p, seed=1)
        n, weights = len(design), np.linalg.pinv(_monomials(design))
        for centre, scale in zip(about.centres, about.scales, strict=True):
            products, volumes = self._products(centre + np.concatenate([design, checks]) @ scale.T)
            cubic = _Cubic(
                [weights @ x[:, :n, :n] @ weights.T for x in products], [weights @ v[:n] for v in volumes]
            )
            squares = [np.diagonal(x, axis1=1, axis2=2)[:, n:].T for x in products]
            error = np.max(
                np.abs(self._by_cubic(cubic, checks) - self._of(squares, [v[n:] for v in volumes]))
            )
            self.cubics.append(cubic if error <= FAITHFUL else None)
            self.error = max(self.error, float(error) if error <= FAITHFUL else 0.0)

    def _by_cubic(self, cubic: _Cubic, u: np.ndarray) -> np.ndarray:
        """At points (n, p) in standard deviations from its minimum."""
        m = _monomials(u)
        pairs = (m[:, :, None] * m[:, None, :]).reshape(len(m), -1)
        squares = [pairs @ form.reshape(len(form), -1).T for form in cubic.forms]
        return self._of(squares, [m @ v for v in cubic.volumes])

    def _exact(self, z: np.ndarray) -> np.ndarray:
        squares = [
            [(np.einsum("nlk,nlk->nl", r, r), v) for r, v in rows] for rows in self._batches(z, self.groups)
        ]
        found = [
            [np.concatenate(x) for x in zip(*parts, strict=True)] for parts in zip(*squares, strict=True)
        ]
        return self._of(*zip(*found, strict=True))

    def _products(self, z: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Of each log, group by group, the products (logs, n, n) of its residual rows at the points z (n, p);
        and volumes (n, logs)."""
        products: list[list[np.ndarray]] = [[] for _ in self.groups]
        volumes: list[list[np.ndarray]] = [[] for _ in self.groups]
        for index, groups in self._few():
            for i, parts in zip(index, zip(*self._batches(z, groups), strict=True), strict=True):
                rows, volume = (np.concatenate(x) for x in zip(*parts, strict=True))
                products[i] += [r @ r.T for r in np.moveaxis(rows, 1, 0)]
                volumes[i].append(volume)
        return [np.stack(x) for x in products], [np.concatenate(v, axis=1) for v in volumes]

    def _few(self) -> Iterator[tuple[Sequence[int], Groups]]:
        """Positions of groups and these: all, or one log at a time where there are MANY rows."""
        if sum(x.response.size for _, x in self.groups) <= MANY:
            yield range(len(self.groups)), self.groups
            return
        for i, (layout, x) in enumerate(self.groups):
            for k in range(len(x.response)):
                yield (i,), ((layout, jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], x)),)

    def _batches(self, z: np.ndarray, groups: Groups) -> Iterator[list[tuple[np.ndarray, np.ndarray]]]:
        """Residual rows (n, logs, N) of each group at a few points of z at a time, real and imaginary parts
        side by side; and volumes (n, logs)."""
        for k in range(0, len(z), self.batch):
            if (begun := perf_counter()) > self.until:
                raise TimeoutError
            thetas = self.theta(z[k : k + self.batch])
            found = [_of_group(thetas, layout, x) for layout, x in groups]
            self.pace = (perf_counter() - begun) / len(thetas)
            yield found

    def _of(self, squares: Sequence[np.ndarray], volumes: Sequence[np.ndarray]) -> np.ndarray:
        return _finite(density(squares, volumes, [x for _, x in self.groups]))


@np.errstate(all="ignore")  # a point where the density is not finite has none
def _of_group(thetas: np.ndarray, layout: Layout, x: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residual rows (n, logs, N) of all logs of a group, real and imaginary parts side by side, and
    volumes (n, logs), at the points `thetas` (n, 6)."""
    found = [residual(of_plants(thetas, log, layout), log, layout) for log in each(x)]
    rows = np.stack([f.rows for f in found], axis=1)
    return rows.view(float), np.stack([np.broadcast_to(f.volume, len(thetas)) for f in found], axis=1)


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
