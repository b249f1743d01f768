"""Normal and Student-t mixtures about the minima of a fit: the approximation of the posterior, and the
proposal of its chains."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

# degrees of freedom of a proposal: tails heavier than those of the posterior of all but the shortest logs
TAILS = 12.0


@dataclass(frozen=True)
class Mixture:
    """Components in the coordinates z: centres (m, p), triangular scales (m, p, p), weights (m,). Student-t
    with `tails` degrees of freedom; normal where they are infinite."""

    centres: np.ndarray
    scales: np.ndarray
    weights: np.ndarray
    tails: float = np.inf

    def heavy(self) -> "Mixture":
        """The same mixture with the heavier tails of a proposal."""
        return replace(self, tails=TAILS)

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """(n, p) independent draws."""
        m, p = self.centres.shape
        which = rng.choice(m, n, p=self.weights)
        t = rng.standard_normal((n, p)) / np.sqrt(rng.chisquare(self.tails, (n, 1)) / self.tails)
        return self._placed(which, t)

    def spread(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """(n, p) even draws of the normal mixture, n even: a randomly shifted lattice of the generalised
        golden ratio and its mirror image, scaled to unit covariance; each component gets its share to within
        one draw. In random order."""
        m, p = self.centres.shape
        ratio = np.roots([1.0, *np.zeros(p - 1), -1.0, -1.0]).real.max()  # x^(p+1) = x + 1
        lattice = (rng.random(p) + np.arange(1, n // 2 + 1)[:, None] / ratio ** np.arange(1, p + 1)) % 1.0
        z = ndtri(np.clip(lattice, 0.25 / n, 1 - 0.25 / n))
        z = np.concatenate([z, -z])
        z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / n)).T
        which = np.searchsorted(np.cumsum(self.weights), (rng.permutation(n) + 0.5) / n)
        return rng.permutation(self._placed(np.minimum(which, m - 1), z))

    def away(self, k: int, z: np.ndarray) -> np.ndarray:
        """(n, p) points z in standard deviations from the k-th centre."""
        return _away(self.centres[k], self.scales[k], z)

    def log_density(self, z: np.ndarray) -> np.ndarray:
        """(n,) log density at z (n, p), up to a constant."""
        p = z.shape[1]
        parts = []
        for centre, scale, weight in zip(self.centres, self.scales, self.weights, strict=True):
            square = np.sum(_away(centre, scale, z) ** 2, axis=1)
            shape = (
                0.5 * square
                if np.isinf(self.tails)
                else 0.5 * (self.tails + p) * np.log1p(square / self.tails)
            )
            parts.append(np.log(weight) - np.sum(np.log(np.abs(np.diag(scale)))) - shape)
        return np.logaddexp.reduce(parts, axis=0)

    def _placed(self, which: np.ndarray, z: np.ndarray) -> np.ndarray:
        return self.centres[which] + np.einsum("nij,nj->ni", self.scales[which], z)


def _away(centre: np.ndarray, scale: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.linalg.solve(scale, (z - centre).T).T
