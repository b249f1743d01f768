"""The places in a cell where tests are linearised, and what each counts for a plate between them.

Over time constant and detuning, from -1/2 to 1/2 each, tests are a polynomial through those at Padua's
points, of which there are as many as terms of its degree, and between which no such polynomial strays far
(Caliari, De Marchi & Vianello, Appl. Math. Comput. 165, 261, 2005). Every second cell along the time constant
has them the other way round, so that cells side by side have those on the edge between them in common. Where
priors are narrowed, tests change in proportion to how wide these are as well, by a plane over the other two
axes.
"""

from functools import cache

import numpy as np

AXES = 3  # of a cell: time constant, detuning, and how wide narrowed priors are
DEGREE = 3
PLANE = 1  # degree of what changes along the last axis
ALONG = 0.5 * np.cos(np.pi / 4)  # where nodes are on that axis, to both sides: Chebyshev's two points


def turned(cell: np.ndarray) -> np.ndarray:
    """(AXES,) which way round a cell's nodes are along each axis, 1 or -1."""
    return np.where(np.arange(AXES) == 0, 1 - 2 * (cell[0] % 2), 1)


def places(narrowed: bool) -> np.ndarray:
    """(N, AXES) of all nodes, the one nearest to the middle first; of priors that are as they are, the last
    axis is nothing."""
    found = np.concatenate([_on(DEGREE, ALONG), _on(PLANE, -ALONG)]) if narrowed else _on(DEGREE, 0.0)
    return found[np.argsort(np.linalg.norm(found[:, : AXES - 1], axis=1), kind="stable")]


def shares(away: np.ndarray, narrowed: bool) -> np.ndarray:
    """(P, N) what each node counts for plates that are `away` (P, AXES) from the middle."""
    return _terms(away, narrowed) @ _inverse(narrowed)


@cache
def _inverse(narrowed: bool) -> np.ndarray:
    return np.linalg.inv(_terms(places(narrowed), narrowed))


def _on(degree: int, along: float) -> np.ndarray:
    """Padua's points of a degree, there on the last axis."""
    each = ((j, k) for j in range(degree + 1) for k in range(degree + 2) if (j + k) % 2 == 0)
    return np.array(
        [(0.5 * np.cos(np.pi * j / degree), 0.5 * np.cos(np.pi * k / (degree + 1)), along) for j, k in each]
    )


def _terms(away: np.ndarray, narrowed: bool) -> np.ndarray:
    """(P, N) the terms of the polynomial there."""
    x, y, z = 2 * away.T
    found = [x**j * y**k for j in range(DEGREE + 1) for k in range(DEGREE + 1 - j)]
    more = [z * x**j * y**k for j in range(PLANE + 1) for k in range(PLANE + 1 - j)]
    return np.stack(found + (more if narrowed else []), axis=1)
