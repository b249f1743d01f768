"""Where a response without a recorded drive begins to decay: a recorder that is triggered shows the level
before as well.

    y(t) = c + A e^(-max(t - t0, 0)/tau)

by least squares; t0 is 0 of a log that decays from its first row on."""

import numpy as np
from scipy.optimize import minimize

from sysid.logs.log import Log

FEW = 8  # rows of a level, of fewer of which nothing is told
ENOUGH = 1000  # rows, of which the course is told
BETTER = 1.1  # times the sum of squares, by which a course without a level is the worse, at least
FLAT = 0.05  # of the slope of the decay where it begins, less than which a level has
ERRORS = 1.0  # of its slope, by which a level may seem to fall
SEEN = 2.0  # rows in tau, at least
GRID = 30  # values of t0, and of tau, to begin with


def onset(log: Log) -> int:
    """The row from which an undriven transient decays; 0 where that is the first, or where it does not tell.

    A level that falls itself, as under friction that does not go with the speed, is part of the decay.
    """
    if log.kind != "transient" or (log.drive is not None and np.any(log.drive)) or len(log) < 4 * FEW:
        return 0
    time, rows = (
        log.time - log.time[0],
        np.abs(log.response) if np.iscomplexobj(log.response) else log.response,
    )
    skip = len(rows) // ENOUGH + 1
    t, y = time[::skip], rows[::skip]
    if not t[-1] > 0 or np.ptp(y) == 0:
        return 0
    begin, tau = _fitted(t, y)
    first = int(np.searchsorted(time, begin)) + 1
    if first <= FEW or len(rows) - first < 2 * FEW or tau < SEEN * time[-1] / len(time):
        return 0
    left, size, end = _left(t, y, begin, tau)
    alone = min(_left(t, y, 0.0, tau)[0] for tau in t[-1] / np.geomspace(0.3, len(t), 10 * GRID))
    level = time[: first - 1]
    if level[-1] <= 0:
        return 0
    slope, error = abs(np.polyfit(level, rows[: first - 1], 1)[0]), np.sqrt(left / len(t)) / np.std(level)
    falls = tau * (slope - ERRORS * error / np.sqrt(len(level)))
    decays = abs(end) < abs(end + size) and falls < FLAT * abs(size)
    return first if decays and alone > BETTER * left else 0


def _fitted(t: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """t0 and tau, s."""
    begins, taus = t[:: len(t) // GRID + 1], t[-1] / np.geomspace(0.3, len(t), GRID)
    _, begin, tau = min((_left(t, y, begin, tau)[0], begin, tau) for begin in begins for tau in taus)
    corner = np.array([begin, np.log(tau)])
    within = [(0.0, t[-1]), (np.log(taus[-1]), np.log(taus[0]))]
    ways = {"initial_simplex": corner + [[0, 0], [t[-1] / GRID, 0], [0, 0.3]]}
    found = minimize(
        lambda p: _left(t, y, p[0], np.exp(p[1]))[0],
        corner,
        method="Nelder-Mead",
        bounds=within,
        options=ways,
    )
    return float(found.x[0]), float(np.exp(found.x[1]))


def _left(t: np.ndarray, y: np.ndarray, begin: float, tau: float) -> tuple[float, float, float]:
    """The sum of squares that A and c leave, and these two."""
    shape = np.exp(-np.maximum(t - begin, 0.0) / tau)
    about, of = shape - np.mean(shape), y - np.mean(y)
    square = float(about @ about)
    size = float(about @ of) / square if square > 0 else 0.0
    return float(np.sum((of - size * about) ** 2)), size, float(np.mean(y) - size * np.mean(shape))
