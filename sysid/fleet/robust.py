"""Where the plates of a lot lie, and how far each is from there, though some do not belong to it.

    x_i = B^T z_i + u_i + e_i,    u_i ~ N(0, S) of the lot,    e_i ~ N(0, C_i) of the plate's own fit

The covariances C_i are known, and hold nothing where a parameter is not determined. B and S are those of the
greatest likelihood of the plates within the distance that KEPT of all plates would keep; of the rest the
likelihood knows that they are farther out, so that both are consistent (a reweighted estimate: Rousseeuw &
van Zomeren, J. Am. Stat. Assoc. 85, 633, 1990; the normal's truncated moments: Croux & Haesbroeck, J.
Multivar. Anal. 71, 161, 1999). The squared distance of a plate that belongs to the lot

    d_i^2 = (x_i - B^T z_i)^T (S + C_i)^-1 (x_i - B^T z_i)

is a chi-square, which few plates turn into Hotelling's T^2.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtr, chdtri, fdtrc

KEPT = 0.975  # of the plates that belong to a lot, those that tell of it
TELLING = 0.8  # of a plate, what one that is kept tells of the scatter: the limit depends on the scatter too
STEPS, CLOSE = 500, 1e-6  # of the iteration, and the relative change of S at which it ends
NORMAL_MAD = 1.4826  # standard deviations in a median absolute deviation of normal numbers
RANKED = np.pi / 6  # of normal numbers the correlation is 2 sin of so much of that of their ranks


@dataclass(frozen=True)
class Lot:
    """`values` x (n, p), NaN where not determined, with their `covariances` (n, p, p); `given` z (n, q), the
    first a one. `centre` B (q, p), `scatter` S (p, p); `kept` (n,): which plates these are from."""

    values: np.ndarray
    covariances: np.ndarray
    given: np.ndarray
    centre: np.ndarray
    scatter: np.ndarray
    kept: np.ndarray

    @cached_property
    def known(self) -> np.ndarray:
        """(n, p) which parameters are determined."""
        return np.isfinite(self.values)

    @cached_property
    def left(self) -> np.ndarray:
        """(n, p) what a plate is away from where the lot is; 0 where it is not determined."""
        return np.where(self.known, self.values - self.given @ self.centre, 0.0)

    @cached_property
    def precisions(self) -> np.ndarray:
        """(n, p, p) (S + C_i)^-1 of what is determined, 0 of what is not."""
        return _inverted(self.scatter + self.covariances, self.known)

    @cached_property
    def distances(self) -> np.ndarray:
        """(n,) d_i^2."""
        return np.einsum("ni,nij,nj->n", self.left, self.precisions, self.left)

    @cached_property
    def pooled(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, p) what plates of the lot have by their own logs and by the lot, B^T z + S (S + C)^-1 (x - B^T
        z), and (n, p, p) its covariance, which holds that of B, not that of S (Lindley & Smith, J. R. Stat.
        Soc. B 34, 1, 1972)."""
        weights = self.scatter @ self.precisions
        rest = np.eye(len(self.scatter)) - weights
        q, p = self.centre.shape
        told = np.linalg.pinv(_normal(self.given[self.kept], self.precisions[self.kept]), hermitian=True)
        centre = np.einsum("na,nb,aibj->nij", self.given, self.given, told.reshape(q, p, q, p))
        values = self.given @ self.centre + np.einsum("nij,nj->ni", weights, self.left)
        return values, rest @ self.scatter + rest @ centre @ rest.transpose(0, 2, 1)

    @property
    def single(self) -> np.ndarray:
        """(n, p) each parameter's distance in its own standard deviations."""
        variances = np.diag(self.scatter) + np.diagonal(self.covariances, axis1=1, axis2=2)
        return self.left / np.sqrt(variances)

    @property
    def beside(self) -> np.ndarray:
        """(n, p) the same from where the plate's other parameters have it."""
        own = np.diagonal(self.precisions, axis1=1, axis2=2)
        pull = np.einsum("nij,nj->ni", self.precisions, self.left)
        return pull / np.sqrt(np.where(self.known, own, 1.0))

    @cached_property
    def chances(self) -> np.ndarray:
        """(n,) the probability of a distance as large in a plate that belongs to the lot; 1 of one of which
        nothing is determined.

        S is told by so many plates, by what they scatter, S + C: T^2 = d^2 has (m - p + 1)/(p m) T^2 ~ F(p, m
        - p + 1) with m degrees of freedom, more where a plate's own C_i is larger than theirs.
        """
        dof = np.maximum(self.known.sum(1), 1)
        typical = self.scatter + np.median(self.covariances[self.kept], axis=0)
        part = np.einsum("nij,ji->n", self.precisions, typical) / dof
        count, q = int(self.kept.sum()), self.given.shape[1]
        m = max(TELLING * (count - q), 1.0) / np.maximum(part, 1e-3) ** 2
        rest = np.maximum(m - dof + 1, 1e-3)
        grown = 1 + q / max(count, 1) * part  # the centre has an error too
        found = fdtrc(dof, rest, self.distances / grown * rest / (dof * m))
        return np.where(self.known.any(1), found, 1.0)


def lot(values: np.ndarray, covariances: np.ndarray, given: np.ndarray | None = None) -> Lot:
    """The lot of these plates; `given` None: one centre for all."""
    n = len(values)
    given = np.ones((n, 1)) if given is None else given
    known = np.isfinite(values)
    shift = np.array([np.median(x[k]) if k.any() else 0.0 for x, k in zip(values.T, known.T, strict=True)])
    size = np.array([_size(x[k]) for x, k in zip((values - shift).T, known.T, strict=True)])
    both = known[:, :, None] & known[:, None, :]
    own = np.where(both, covariances, 0.0) / np.outer(size, size)
    start = _start((values - shift) / size, own, given)
    found = _likeliest((values - shift) / size, own, given, *start)
    centre, scatter, kept = found
    centre = centre * size
    centre[0] += shift
    return Lot(values, own * np.outer(size, size), given, centre, scatter * np.outer(size, size), kept)


def _size(x: np.ndarray) -> float:
    """A scale of numbers about zero, which half of them may be wild to leave as it is."""
    spread = NORMAL_MAD * float(np.median(np.abs(x))) if len(x) else 0.0
    return spread or float(np.std(x) if len(x) else 0.0) or 1.0


def _inverted(total: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(n, p, p) inverses of the parts of matrices that are known, 0 elsewhere."""
    both = known[:, :, None] & known[:, None, :]
    whole = np.where(both, total, np.eye(total.shape[-1]))
    return np.where(both, np.linalg.inv(whole), 0.0)


def _start(x: np.ndarray, own: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A centre of least absolute deviations, and a scatter of their medians and of the correlations of
    ranks."""
    p = x.shape[1]
    centre, spread = np.zeros((given.shape[1], p)), np.zeros(p)
    left = np.full_like(x, np.nan)
    for j in range(p):
        here = np.isfinite(x[:, j])
        if not here.any():
            continue
        centre[:, j] = _absolute(x[here, j], given[here])
        left[here, j] = x[here, j] - given[here] @ centre[:, j]
        noise = float(np.median(own[here, j, j]))
        spread[j] = np.sqrt(max(_size(left[here, j]) ** 2 - noise, 0.01 * noise))
    ranks = np.eye(p)
    for i in range(p):
        for j in range(i):
            here = np.isfinite(left[:, i]) & np.isfinite(left[:, j])
            ranks[i, j] = ranks[j, i] = 2 * np.sin(RANKED * _of_ranks(left[here, i], left[here, j]))
    level, axes = np.linalg.eigh(ranks)
    ranks = axes @ np.diag(np.maximum(level, 1e-3)) @ axes.T
    return centre, ranks * np.outer(spread, spread)


def _absolute(y: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Least absolute deviations, by least squares that are weighted anew."""
    weight = np.ones(len(y))
    for _ in range(60):
        found = np.linalg.lstsq(given * weight[:, None], y * weight, rcond=None)[0]
        left = np.abs(y - given @ found)
        weight = 1 / np.sqrt(np.maximum(left, 1e-4 * max(float(np.median(left)), 1e-12)))
    return found


def _of_ranks(x: np.ndarray, y: np.ndarray) -> float:
    """Spearman's correlation; 0 of fewer than three."""
    if len(x) < 3:
        return 0.0
    a, b = (np.argsort(np.argsort(v)) - (len(v) - 1) / 2 for v in (x, y))
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _likeliest(
    x: np.ndarray, own: np.ndarray, given: np.ndarray, centre: np.ndarray, scatter: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """B, S and the plates they are from, by expectation and maximisation from a robust start."""
    known = np.isfinite(x)
    dof = known.sum(1)
    limit = np.where(dof > 0, chdtri(np.maximum(dof, 1), 1 - KEPT), -1.0)
    short = np.where(
        dof > 0, chdtr(dof + 2, limit) / KEPT, 1.0
    )  # of the second moments that the limit leaves
    y = np.where(known, x, 0.0)
    for _ in range(STEPS):
        precision = _inverted(scatter + own, known)
        left = np.where(known, y - given @ centre, 0.0)
        kept = np.einsum("ni,nij,nj->n", left, precision, left) <= limit
        if not kept.any():
            break
        centre = _weighted(y[kept], given[kept], precision[kept])
        left = np.where(known, y - given @ centre, 0.0)[kept]
        pull = np.einsum("ij,njk,nk->ni", scatter, precision[kept], left)
        grown = kept.sum() / max(int(kept.sum()) - given.shape[1], 1)
        spread = scatter - scatter @ precision[kept] @ scatter
        moment = np.einsum("ni,nj->nij", pull, pull) * (grown / short[kept])[:, None, None]
        after = np.mean(moment + spread, axis=0)
        change = np.max(np.abs(after - scatter)) / max(np.max(np.abs(after)), 1e-300)
        scatter = after
        if change < CLOSE:
            break
    return centre, scatter, kept


def _weighted(y: np.ndarray, given: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(q, p) the centre by least squares with these precisions."""
    q, p = given.shape[1], y.shape[1]
    normal = _normal(given, precision)
    right = np.einsum("na,nij,nj->ai", given, precision, y).ravel()
    return np.linalg.lstsq(normal, right, rcond=1e-12)[0].reshape(q, p)


def _normal(given: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(q p, q p) the normal matrix of the centre's least squares."""
    size = given.shape[1] * precision.shape[1]
    return np.einsum("na,nb,nij->aibj", given, given, precision).reshape(size, size)
