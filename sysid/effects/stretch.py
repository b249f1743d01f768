"""A stretch of a log that is not of the plate that the rest shows: a finger for a while, another range of the
sensor, a drive that failed, a cable that was touched.

Its rows are left out of the fit. For them stands the best that plate and bench can make of them alone, with
columns D (n, K) about a plate near by and noise of a level of its own: each side of it leaves

    min over c of |r - D c|^2 = r^H r - g^H H^-1 g,    H = D^H D, g = D^H r,

with r (n,) what that plate leaves. These sums over some rows are differences of sums up to a row, so that
all stretches are weighed at once. A law that the plate follows and nobody knows looks alike where it matters
most, so that a stretch is named and never adopted.
"""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from sysid.effects.effect import About, Effect, Told, nowhere
from sysid.effects.number import Number, number
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

EDGES = 64  # places of a log where a stretch may begin or end, at first; then others near the best,
FINER = 8  # to either side of each end, ever closer
STARTS = 4  # that differ at an end by more than
ALIKE = 0.1  # of the log: seen from a wrong plate the right one need not be the best
LEAST_ROWS = 40  # of a log, half of which at the most may be the stretch
SHORTEST = 4  # rows: fewer are outliers
REGULAR = 1e-9  # of the power of a column, added to it: what no row of a part shows is then zero
ROUNDED = 1e-12  # of the power of a log: less is rounding
GUESSES = np.log(EDGES * (EDGES - 1) / 2)  # log of how many stretches there are


def _moves(trial: Trial) -> bool:
    """A sweep, or a transient whose inputs change: what stands still tells two plates from none."""
    moves = trial.swept or (not trial.steady and trial.changes > 0)
    return trial.driven and moves and len(trial.log) >= LEAST_ROWS


def _rows(trial: Trial, values: np.ndarray) -> tuple[int, int]:
    """The first row of a stretch, and the first behind it, of shares of the log."""
    first, last = np.rint(np.clip(values, 0.0, 1.0) * len(trial.log)).astype(int)
    return int(first), int(last)


def _without(trial: Trial, values: np.ndarray, about: About) -> Trial:
    first, last = _rows(trial, values)
    there = trial.there.copy()
    there[first:last] = False
    return replace(trial, there=there, noise=replace(trial.noise, kept=trial.noise.kept & there))


def _stretched(trial: Trial, values: np.ndarray, about: About) -> float:
    """The log density of the rows that are left out, as the cost of a log counts it, and of the choice."""
    first, last = _rows(trial, values)
    sums, unit, weights = _sums(trial, about.reference, tuple(about.theta.tolist()))
    used = np.append(0, np.cumsum(trial.there))
    if not (inside := used[last] - used[first]):
        return -float(GUESSES)
    own, _ = _sides(sums, used, np.array([[first, last]]))
    level = 0.5 * np.log(unit / trial.channels) * inside - (weights[last] - weights[first])
    return -float(GUESSES + trial.channels * (own[0] + level))


@lru_cache(maxsize=1)  # for all stretches of a log
def _sums(
    trial: Trial, reference: tuple[float, float], theta: tuple[float, ...]
) -> tuple[np.ndarray, float, np.ndarray]:
    """(n + 1, K + 1, K + 1) sums of the products of D and r, in this order and of unit size, up to a row; the
    power of r; and (n + 1,) the sums of the logarithms of the rows' weights."""
    course, used = LogResponse.of(trial, reference, np.array(theta)), trial.there
    if trial.signed:
        left = trial.log.response - course.forced * trial.bench.turn
    else:
        left = trial.residual(np.abs(course.plate))
    rows = np.column_stack([course.design(), left]) * (trial.noise.weight * used)[:, None]
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    rows = rows / size
    products = np.cumsum(rows[:, :, None].conj() * rows[:, None, :], axis=0)
    weights = np.cumsum(np.where(used, np.log(trial.noise.weight), 0.0))
    return np.concatenate([0 * products[:1], products]), float(size[-1] ** 2), np.append(0.0, weights)


def _left(sums: np.ndarray) -> np.ndarray:
    """(m,) the power of rows of which plate and bench make what they can."""
    h, g, r = sums[:, :-1, :-1], sums[:, :-1, -1], sums[:, -1, -1].real
    h = h + REGULAR * np.eye(h.shape[1])
    return np.maximum(r - np.sum(g.conj() * np.linalg.solve(h, g[..., None])[..., 0], axis=1).real, ROUNDED)


def _sides(sums: np.ndarray, used: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m,) the costs of the rows inside and outside of stretches (m, 2), of `used` (n + 1,) rows up to a row:
    half of the logarithm of each row's noise, whose level is nowhere less than outside, and of what K numbers
    cost."""
    within, rows = sums[pairs[:, 1]] - sums[pairs[:, 0]], used[pairs[:, 1]] - used[pairs[:, 0]]
    numbers = sums.shape[1] - 1
    own, rest = np.maximum(rows - numbers, 1), np.maximum(used[-1] - rows - numbers, 1)
    level = _left(sums[-1] - within) / rest
    inside = np.maximum(_left(within) / own, level)
    cost = 0.5 * numbers * np.log(np.maximum(rows, 1))
    return 0.5 * rows * np.log(inside) + cost, 0.5 * (used[-1] - rows) * np.log(level)


def _pairs(begins: np.ndarray, ends: np.ndarray, rows: int) -> np.ndarray:
    """(m, 2) all stretches between these places that are long, and short, enough."""
    pairs = np.stack(np.meshgrid(begins, ends, indexing="ij"), axis=-1).reshape(-1, 2)
    lengths = pairs[:, 1] - pairs[:, 0]
    return pairs[(lengths >= SHORTEST) & (2 * lengths <= rows)]


def _likeliest(trial: Trial, about: About, most: int = STARTS) -> np.ndarray:
    """(m, 2) the likeliest stretches that differ, seen from a plate, in shares of the log: the best first."""
    sums, *_ = _sums(trial, about.reference, tuple(about.theta.tolist()))
    n, used = len(trial.log), np.append(0, np.cumsum(trial.there))
    places = np.unique(np.rint(np.linspace(0, n, EDGES + 1)).astype(int))
    apart = max(b - a for a, b in pairwise(places))
    pairs = _pairs(places, places, n)
    pairs = pairs[np.argsort(np.add(*_sides(sums, used, pairs)), kind="stable")]
    found: list[np.ndarray] = []
    while len(pairs) and len(found) < most:
        found.append(_closer(sums, used, pairs[0], apart) / n)
        pairs = pairs[np.max(np.abs(pairs - pairs[0]), axis=1) > ALIKE * n]
    return np.array(found)


def _closer(sums: np.ndarray, used: np.ndarray, pair: np.ndarray, apart: int) -> np.ndarray:
    """(2,) the likeliest stretch near one whose ends are known to so many rows: to the row."""
    n = len(used) - 1
    while apart:
        step = -(-apart // FINER)
        begins, ends = (np.clip(x + step * np.arange(-FINER, FINER + 1), 0, n) for x in pair)
        near = _pairs(begins, ends, n)
        pair = near[int(np.argmin(np.add(*_sides(sums, used, near))))]
        apart = step // 2
    return pair


def _best(trial: Trial, about: About) -> np.ndarray:
    """(2,) the likeliest."""
    return _likeliest(trial, about, 1)[0]


def _numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    first, last = _rows(trial, values)
    if trial.log.time is not None:
        what, unit = trial.log.time - trial.log.time[0], "s"
    elif trial.swept:
        what, unit = trial.log.frequency, "Hz"
    else:
        what, unit = np.arange(len(trial.log)), "rows"
    ends = (number(what[k], 0.0, unit) for k in (first, max(last - 1, first)))
    return dict(zip(("begins", "ends"), ends, strict=True))


def _said(trial: Trial, found: dict[str, Number]) -> Told:
    begins, ends = found["begins"], found["ends"]
    where = {"s": " s after its first row", "Hz": " Hz", "rows": " (rows, from 0 on)"}[begins.unit]
    return Told(
        f"from {begins.value:.6g} to {ends.value:.6g}{where} it is not of the plate that the rest shows, as"
        " if a finger, another range, a failing drive or another resonance were in it for a while",
        "see what happened then, and record it again or leave these rows out",
    )


STRETCH = Effect(
    name="stretch",
    shows=_moves,
    stds=lambda trial, about: np.ones(2),
    starts=_likeliest,
    applied=_without,
    hop=_best,
    stretched=_stretched,
    numbers=_numbers,
    said=_said,
    rough=True,
    linear=(),
    places=nowhere,
    makes_sense=lambda values, stds, own: bool(values[1] > values[0]),
)
