"""A stretch of a log that is not of the plate that the rest shows: a finger for a while, another range of the
sensor, a drive that failed, a cable that was touched.

Its rows are left out of the fit. For them stands the best that plate and bench can make of them alone, with
columns D (n, K) about a plate near by and noise of a level of its own: each side of it leaves

    min over c of |r - D c|^2 = r^H r - g^H H^-1 g,    H = D^H D, g = D^H r,

with r (n,) what that plate leaves. A transient begins anew where a stretch begins and behind where it ends,
from a state that nobody knows: it decays as exp(sum of a dt) from there, one more column. Sums over some rows
are differences of sums up to a row, so that all stretches are weighed at once; those of a decay follow from
the sums a row later. A law that the plate follows and nobody knows looks alike where it matters most, so that
a stretch is named and never adopted.
"""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sysid.effects.effect import About, Effect, Told, always, fixed, nowhere, undone
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
    first, last = np.rint(np.clip(values[:2], 0.0, 1.0) * len(trial.log)).astype(int)
    return int(first), int(last)


def _without(trial: Trial, values: np.ndarray, about: About) -> Trial:
    first, last = _rows(trial, values)
    there = trial.there.copy()
    there[first:last] = False
    trial = replace(trial, there=there, noise=replace(trial.noise, kept=trial.noise.kept & there))
    if not (_begins_anew(trial) and np.any(values[2:])):
        return trial
    course = LogResponse.of(trial, about.reference, about.near)
    behind = _decay(trial, course.pole)
    anew = np.append(np.zeros(last), np.exp(behind[last:] - behind[min(last, len(behind) - 1)]))
    more = about.top * (values[2] + 1j * values[3]) * anew
    more = more if trial.channels > 1 else more.real
    return undone(trial, lambda log: log.response - more)


def _begins_anew(trial: Trial) -> bool:
    """Whether a log goes on from where a stretch left its plate."""
    return trial.signed and not trial.steady and trial.whole is None


def _decay(trial: Trial, pole: np.ndarray) -> np.ndarray:
    """(n,) logarithm of how a plate decays up to each row."""
    return np.append(0.0, np.cumsum(pole[1:] * np.diff(trial.log.time)))


def _stretched(trial: Trial, values: np.ndarray, about: About) -> float:
    """The log density of the rows that are left out, as the cost of a log counts it, and of the choice."""
    first, last = _rows(trial, values)
    sums = _sums(trial, about.reference, tuple(about.near.tolist()))
    if not (inside := sums.used[last] - sums.used[first]):
        return -float(GUESSES)
    own, _ = sums.sides(np.array([[first, last]]))
    level = 0.5 * np.log(sums.unit / trial.channels) * inside - (sums.weights[last] - sums.weights[first])
    return -float(GUESSES + trial.channels * (own[0] + level))


class _Sums(NamedTuple):
    """Of D and r, in this order and of unit size: `products` (n + 1, K + 1, K + 1) up to a row; of a decay
    from a row on with these, `anew` (n + 1, K + 1), and with itself, `decays` (n + 1,), and the logarithm of
    one from the first row on, `behind` (n + 1,), where there is one; the power of r, `unit`; the logarithms
    of `weights`, and the rows that are `used`, (n + 1,) up to a row."""

    products: np.ndarray
    anew: np.ndarray
    decays: np.ndarray
    behind: np.ndarray
    unit: float
    weights: np.ndarray
    used: np.ndarray

    @classmethod
    def of(cls, trial: Trial, course: LogResponse) -> "_Sums":
        used = trial.there
        if trial.signed:
            left = trial.log.response - course.forced * trial.bench.turn
        else:
            left = trial.residual(np.abs(course.plate))
        weight = trial.noise.weight * used
        rows = np.column_stack([course.design(), left]) * weight[:, None]
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        rows = rows / size
        products = np.cumsum(rows[:, :, None].conj() * rows[:, None, :], axis=0)
        behind = np.zeros(len(rows) + 1, rows.dtype)
        anew, decays = np.zeros((len(rows) + 1, rows.shape[1]), rows.dtype), np.zeros(len(rows) + 1)
        if _begins_anew(trial):
            decayed = _decay(trial, course.pole)
            behind[:-1] = decayed if trial.channels > 1 else decayed.real
            behind[-1] = behind[-2]
            decay = np.exp(np.diff(behind)).conj()
            for k in reversed(range(len(rows))):
                anew[k] = weight[k] * rows[k] + decay[k] * anew[k + 1]
                decays[k] = weight[k] ** 2 + abs(decay[k]) ** 2 * decays[k + 1]
        return cls(
            np.concatenate([0 * products[:1], products]),
            anew,
            decays,
            behind,
            float(size[-1] ** 2),
            np.append(0.0, np.cumsum(np.where(used, np.log(trial.noise.weight), 0.0))),
            np.append(0, np.cumsum(used)),
        )

    def within(self, pairs: np.ndarray) -> np.ndarray:
        """(m, K + 2, K + 2) sums over stretches of what decays from where they begin, D and r."""
        first, last = pairs.T
        gone = np.exp(self.behind[last] - self.behind[first])
        cross = self.anew[first] - gone.conj()[:, None] * self.anew[last]
        own = self.decays[first] - np.abs(gone) ** 2 * self.decays[last]
        return _bordered(self.products[last] - self.products[first], cross, own)

    def beside(self, pairs: np.ndarray) -> np.ndarray:
        """The same over all other rows, of what decays from where the stretches end."""
        first, last = pairs.T
        products = self.products[-1] - (self.products[last] - self.products[first])
        return _bordered(products, self.anew[last], self.decays[last])

    def sides(self, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) the costs of the rows inside and outside of stretches (m, 2): half of the logarithm of each
        row's noise, whose level is nowhere less than outside, and of what numbers cost."""
        within, beside = self.within(pairs), self.beside(pairs)
        rows, plate = self.used[pairs[:, 1]] - self.used[pairs[:, 0]], self.products.shape[1] - 1
        numbers, others = (plate + (x[:, 0, 0].real > 0) for x in (within, beside))
        own = np.maximum(rows - numbers, 1)
        rest = np.maximum(self.used[-1] - rows - others, 1)
        level = _left(beside) / rest
        inside = np.maximum(_left(within) / own, level)
        cost = 0.5 * numbers * np.log(np.maximum(rows, 1))
        return 0.5 * rows * np.log(inside) + cost, 0.5 * (self.used[-1] - rows) * np.log(level)

    def costs(self, pairs: np.ndarray) -> np.ndarray:
        """(m,) of all rows."""
        return np.add(*self.sides(pairs))

    def goes_on(self, pair: np.ndarray) -> complex:
        """The state behind a stretch, of the plate that the rest shows."""
        gram = self.beside(pair[None])
        return complex(_solved(gram)[0, 0]) * np.sqrt(self.unit)


def _bordered(products: np.ndarray, cross: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Sums of products with one more column in front."""
    top = np.concatenate([own[:, None], cross], axis=1)
    below = np.concatenate([cross.conj()[:, :, None], products], axis=2)
    return np.concatenate([top[:, None, :], below], axis=1)


def _solved(gram: np.ndarray) -> np.ndarray:
    """(m, K) the coefficients of the columns by which these leave the least of the last."""
    h, g = gram[:, :-1, :-1], gram[:, :-1, -1]
    size = np.sqrt(np.maximum(np.diagonal(h, axis1=1, axis2=2).real, 1.0))
    h = h / (size[:, :, None] * size[:, None, :]) + REGULAR * np.eye(h.shape[1])
    return np.linalg.solve(h, (g / size)[..., None])[..., 0] / size


def _left(gram: np.ndarray) -> np.ndarray:
    """(m,) the power of rows of which plate and bench make what they can."""
    known = np.sum(gram[:, :-1, -1].conj() * _solved(gram), axis=1).real
    return np.maximum(gram[:, -1, -1].real - known, ROUNDED)


@lru_cache(maxsize=1)  # for all stretches of a log
def _sums(trial: Trial, reference: tuple[float, float], theta: tuple[float, ...]) -> _Sums:
    return _Sums.of(trial, LogResponse.of(trial, reference, np.array(theta)))


def _pairs(begins: np.ndarray, ends: np.ndarray, rows: int) -> np.ndarray:
    """(m, 2) all stretches between these places that are long, and short, enough."""
    pairs = np.stack(np.meshgrid(begins, ends, indexing="ij"), axis=-1).reshape(-1, 2)
    lengths = pairs[:, 1] - pairs[:, 0]
    return pairs[(lengths >= SHORTEST) & (2 * lengths <= rows)]


def _likeliest(trial: Trial, about: About, most: int = STARTS) -> np.ndarray:
    """(m, 4) the likeliest stretches that differ, seen from a plate, in shares of the log, and the states
    behind them, in shares of the largest response: the best first."""
    sums = _sums(trial, about.reference, tuple(about.near.tolist()))
    n = len(trial.log)
    places = np.unique(np.rint(np.linspace(0, n, EDGES + 1)).astype(int))
    apart = max(b - a for a, b in pairwise(places))
    pairs = _pairs(places, places, n)
    pairs = pairs[np.argsort(sums.costs(pairs), kind="stable")]
    found: list[np.ndarray] = []
    while len(pairs) and len(found) < most:
        best = _closer(sums, pairs[0], apart)
        state = sums.goes_on(best) / about.top
        found.append(np.array([*best / n, state.real, state.imag]))
        pairs = pairs[np.max(np.abs(pairs - pairs[0]), axis=1) > ALIKE * n]
    return np.array(found)


def _closer(sums: _Sums, pair: np.ndarray, apart: int) -> np.ndarray:
    """(2,) the likeliest stretch near one whose ends are known to so many rows: to the row."""
    n = len(sums.used) - 1
    while apart:
        step = -(-apart // FINER)
        begins, ends = (np.clip(x + step * np.arange(-FINER, FINER + 1), 0, n) for x in pair)
        near = _pairs(begins, ends, n)
        pair = near[int(np.argmin(sums.costs(near)))]
        apart = step // 2
    return pair


def _best(trial: Trial, about: About) -> np.ndarray:
    """(4,) the likeliest."""
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
    stds=fixed(np.ones(4)),
    starts=_likeliest,
    applied=_without,
    hop=_best,
    stretched=_stretched,
    numbers=_numbers,
    said=_said,
    rough=always,
    linear=(2, 3),  # a state
    places=nowhere,
    makes_sense=lambda trial, fitted: bool(fitted.values[1] > fitted.values[0]),
)
