"""The two-interval test: volunteers say which of two gratings is stronger; exact statistics, predictions,
numbers of trials."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri
from scipy.stats import beta, betabinom, binom, binomtest

from stimulator.draws import stream
from stimulator.errors import number as checked
from stimulator.errors import positive, refuse
from stimulator.observer import preference


class Proportion(NamedTuple):
    """What `successes` of `trials` say of a proportion: p-values against 1/2, 95 % intervals, and d' =
    sqrt(2) z of a two-interval test with its interval."""

    estimate: float
    two_sided: float
    one_sided: float
    clopper_pearson: tuple[float, float]
    wilson: tuple[float, float]
    jeffreys: tuple[float, float]
    d_prime: tuple[float, float, float]


def proportion(successes: int, trials: int) -> Proportion:
    """Exact binomial statistics. Raises StimulatorError for counts that are none."""
    if not (trials >= 1 and 0 <= successes <= trials):
        refuse("successes", f"{successes} of {trials}", "0 to as many as there are trials, one or more")
    test = binomtest(successes, trials)
    exact = tuple(float(v) for v in test.proportion_ci(method="exact"))
    wilson = tuple(float(v) for v in test.proportion_ci(method="wilson"))
    jeffreys = beta.interval(0.95, successes + 0.5, trials - successes + 0.5)
    rate = successes / trials
    return Proportion(
        rate,
        float(test.pvalue),
        float(binomtest(successes, trials, alternative="greater").pvalue),
        (exact[0], exact[1]),
        (wilson[0], wilson[1]),
        (float(jeffreys[0]), float(jeffreys[1])),
        tuple(float(np.sqrt(2) * ndtri(p)) for p in (rate, *exact)),  # type: ignore[arg-type]
    )


class Clustered(NamedTuple):
    """`effective` independent trials, the 95 % interval of Clopper and Pearson, and the two-sided p-value,
    for as many."""

    effective: float
    interval: tuple[float, float]
    two_sided: float


def clustered(successes: int, trials: int, each: int, icc: float) -> Clustered:
    """The same of trials that come `each` from one volunteer, whose answers have the intraclass correlation
    `icc`: a design effect of 1 + (each - 1) icc leaves fewer trials at the same proportion."""
    checked("icc", icc, -1e-300, 1.0, "a correlation from 0 to below 1")
    n = trials / (1 + (each - 1) * icc)
    k = n * successes / trials
    low, high = beta.ppf(0.025, k, n - k + 1), beta.ppf(0.975, k + 1, n - k)
    most = max(k, n - k)
    tail = float(beta.cdf(0.5, most, n - most + 1))  # P of as many or more at 1/2
    interval = float(np.nan_to_num(low)), float(np.nan_to_num(high, nan=1.0))
    return Clustered(float(n), interval, min(1.0, 2 * tail))


def counts(p: ArrayLike, each: int = 1) -> np.ndarray:
    """(n + 1,) the distribution of the number of successes in n = `each` trials for each probability of `p`
    (..., m), of which the mean over all leading axes is taken: that of independent volunteers, exact."""
    p = np.asarray(p, float)
    n = each * p.shape[-1]
    turns = np.exp(-2j * np.pi * np.arange(n + 1) / (n + 1))
    waves = np.prod(1 + p[..., None] * (turns - 1), axis=-2) ** each
    mean = waves.reshape(-1, n + 1).mean(axis=0)
    return np.maximum(np.fft.ifft(mean).real, 0.0)


def quantile(distribution: np.ndarray, share: float) -> int:
    """The smallest count up to which the distribution holds at least `share`."""
    return int(np.searchsorted(np.cumsum(distribution), share * (1 - 1e-12)))


def trials_for(p: float, power: float = 0.9, level: float = 0.05) -> int:
    """The smallest number of independent trials from which on an exact two-sided test against 1/2 at
    `level` finds a true `p` with at least `power`; more trials never have less. Raises StimulatorError."""
    checked("p", p, 0.0, 1.0, "a probability between 0 and 1")
    checked("power", power, 0.0, 1.0, "a probability between 0 and 1")
    p = max(p, 1 - p)
    if p == 0.5:
        refuse("p", "1/2", "another: no number of trials tells it from 1/2")
    most = int(np.ceil((ndtri(1 - level / 2) + ndtri(power)) ** 2 / (4 * (p - 0.5) ** 2))) * 2 + 50
    n = np.arange(1, most + 1)
    needed = binom.isf(level / 2, n, 0.5) + 1
    found = binom.sf(needed - 1, n, p)
    short = np.flatnonzero(found < power)
    return int(n[short[-1]] + 1) if len(short) else 1


def volunteers_for(p: float, each: int = 5, icc: float = 0.2, power: float = 0.9, level: float = 0.05) -> int:
    """The number of volunteers of `each` (odd) trials for the same, of a beta-binomial with intraclass
    correlation `icc`: the exact sign test of their majorities, whose level holds whatever the
    correlation is. Raises StimulatorError."""
    if each < 1 or each % 2 == 0:
        refuse("each", repr(each), "an odd number of trials: a volunteer has a majority")
    checked("icc", icc, -1e-300, 1.0, "a correlation from 0 to below 1")
    return trials_for(majority(p, each, icc), power, level)


def majority(p: float, each: int, icc: float) -> float:
    """P that most of a volunteer's `each` answers are for what is chosen with probability p."""
    checked("p", p, 0.0, 1.0, "a probability between 0 and 1")
    if icc == 0:
        return float(binom.sf(each // 2, each, p))
    size = 1 / icc - 1
    return float(betabinom.sf(each // 2, each, p * size, (1 - p) * size))


@dataclass(frozen=True)
class Prior:
    """What was held of volunteers before any count was looked at; never fitted to one.

    A volunteer presses with exp of a Gaussian force (N) and tells a Weber fraction of exp of a Gaussian:
    `*_study` is the standard deviation of what all of a study share, `*_person` that between them, of the
    logarithm. 0.18 times or over 1.5 covers what has been published, 0.11 to 0.27; strokes on such plates
    are made with 0.2 to 1 N. Lapses are beta-distributed with mean `lapse` and a first parameter of
    `lapse_shape`: most volunteers near none, few at 0.1. `floor` as in `Observer`, without a source.
    """

    force: float = 0.5
    force_study: float = 0.4
    force_person: float = 0.3
    weber: float = 0.18
    weber_study: float = 0.4
    weber_person: float = 0.3
    lapse: float = 0.04
    lapse_shape: float = 1.5
    floor: float = 0.02

    def __post_init__(self) -> None:
        for name in ("force", "weber", "lapse", "lapse_shape"):
            positive(f"prior.{name}", getattr(self, name), "1")

    def draw(self, studies: int, volunteers: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(studies, volunteers) forces, Weber fractions and lapses."""
        draws = stream(seed, "prior")

        def around(median: float, study: float, person: float) -> np.ndarray:
            common = study * draws.standard_normal((studies, 1))
            return median * np.exp(common + person * draws.standard_normal((studies, volunteers)))

        force = around(self.force, self.force_study, self.force_person)
        weber = around(self.weber, self.weber_study, self.weber_person)
        lapse = draws.beta(self.lapse_shape, self.lapse_shape * (1 / self.lapse - 1), (studies, volunteers))
        return force, weber, lapse


class Intensities(NamedTuple):
    """Contrasts (k,) in open and closed loop at increasing `force` (k,) N, of one way to see the plate."""

    force: np.ndarray
    opened: np.ndarray
    closed: np.ndarray


def predicted(
    cells: Mapping[Any, Intensities],
    prior: Prior,
    volunteers: int = 10,
    each: int = 5,
    studies: int = 4000,
    seed: int = 0,
) -> dict[Any, np.ndarray]:
    """For each cell the distribution (volunteers each + 1,) of how many answers are for the closed loop;
    the mixture of all, each as likely, is the mean of them. Contrasts are interpolated in the logarithm
    of the force."""
    force, weber, lapse = prior.draw(studies, volunteers, seed)
    found = {}
    for key, cell in cells.items():
        closed, opened = (np.interp(np.log(force), np.log(cell.force), S) for S in (cell.closed, cell.opened))
        found[key] = counts(preference(closed, opened, weber, lapse, prior.floor), each)
    return found
