"""How far out the plates of a lot lie that belong to it: the tails of a lot, from its inner part.

    d^2 / (p s) ~ F(p, nu),    nu = infinity: chi-square, a normal lot

of the plates within the distance that INNER of all keep; beyond it lie the lot's own and those that do not
belong to it, in a share that is found as well. A lot is taken as normal unless a finite nu is more likely by
GAIN.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import betaln, chdtrc, fdtrc, gammaln

INNER = 0.95  # of the plates, by whose distances the tails are told
FEWEST = 100  # plates that tell tails
GAIN = 1.0  # log-likelihood by which a lot that is not normal is more likely
POINTS = 2000  # distances that are enough
DEGREES = (60, 40, 30, 20, 15, 12, 10, 8, 6, 5, 4, 3)  # nu


class Tails(NamedTuple):
    """`degrees` nu (infinite: normal) and the scale `size` s."""

    degrees: float
    size: float

    def chance(self, distances: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """The probability of a squared distance as large, of so many parameters."""
        return _beyond(distances / self.size, dof, self.degrees)


def tails(distances: np.ndarray, p: int) -> Tails | None:
    """Of a lot by the squared distances of its plates, of p parameters each; None of a normal one, or of few
    plates."""
    n = len(distances)
    if n < FEWEST:
        return None
    body = np.sort(distances)[: int(INNER * n)]
    limit, each = body[-1], max(len(body) // POINTS, 1)
    inner = np.maximum(body[each // 2 :: each], 1e-12)

    def unlikely(size: float, nu: float) -> float:
        outside = _beyond(limit / np.exp(size), p, nu)
        strange = max((1 - INNER - outside) / (1 - outside), 0.0)
        inside = len(body) * (np.mean(_density(inner / np.exp(size), p, nu)) - size + np.log1p(-strange))
        return -float(inside + (n - len(body)) * np.log(strange + (1 - strange) * outside))

    found = {
        nu: minimize_scalar(unlikely, (-2.0, 0.7), args=(nu,), bounds=(-2.0, 0.7))
        for nu in (np.inf, *DEGREES)
    }
    best = min(DEGREES, key=lambda nu: found[nu].fun)
    if found[best].fun > found[np.inf].fun - GAIN:
        return None
    return Tails(float(best), float(np.exp(found[best].x)))


def _beyond(x: Any, p: Any, nu: float) -> Any:
    return chdtrc(p, x) if np.isinf(nu) else fdtrc(p, nu, x / p)


def _density(x: np.ndarray, p: int, nu: float) -> np.ndarray:
    """Logarithm of that of a squared distance of p parameters."""
    if np.isinf(nu):
        return (0.5 * p - 1) * np.log(x) - 0.5 * x - 0.5 * p * np.log(2) - gammaln(0.5 * p)
    scaled = 0.5 * p * np.log(p / nu) + (0.5 * p - 1) * np.log(x / p) - 0.5 * (p + nu) * np.log1p(x / nu)
    return scaled - betaln(0.5 * p, 0.5 * nu) - np.log(p)
