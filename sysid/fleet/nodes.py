"""The places in a cell where tests are linearised, and what each counts for a plate between them.

Along each axis of a cell, from -1/2 to 1/2, tests are a polynomial through those of Chebyshev's points, where
no such polynomial strays far in between: of n points the error goes as the width of a cell to the n.
"""

import numpy as np

AXES = 3  # of a cell: time constant, detuning, and how wide narrowed priors are
COUNTS = (4, 4, 2)


def places(narrowed: bool) -> np.ndarray:
    """(N, AXES) of all nodes; of priors that are as they are, the last axis is nothing."""
    along = np.meshgrid(*map(_points, _counts(narrowed)), indexing="ij")
    return np.stack(along, axis=-1).reshape(-1, AXES)


def shares(away: np.ndarray, narrowed: bool) -> np.ndarray:
    """(P, N) what each node counts for plates that are `away` (P, AXES) from the middle."""
    found = np.ones((len(away), 1))
    for x, count in zip(away.T, _counts(narrowed), strict=True):
        found = (found[:, :, None] * _lagrange(_points(count), x)[:, None]).reshape(len(away), -1)
    return found


def _counts(narrowed: bool) -> tuple[int, ...]:
    return COUNTS if narrowed else (*COUNTS[:-1], 1)


def _points(count: int) -> np.ndarray:
    return 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)


def _lagrange(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(P, n) the polynomials that are 1 at one of the points and 0 at the others, at x (P,)."""
    apart, off = points[:, None] - points, np.eye(len(points), dtype=bool)
    return np.prod(np.where(off, 1.0, (x[:, None, None] - points) / np.where(off, 1.0, apart)), axis=2)
