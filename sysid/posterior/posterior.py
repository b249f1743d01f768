"""The posterior of the plant, by level of accuracy: the fit's normal approximation; Markov chains that
correct it; every row.

Reported are the mean, standard deviation and interval of the normal approximation, corrected by importance
sampling: see `posterior.estimate`.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.asked import FIT, given, number, whole_number
from sysid.posterior.accuracy import Rung, above, up_to
from sysid.posterior.circuit import Circuit, circuit
from sysid.posterior.diagnostics import Convergence, ess, rhat
from sysid.posterior.estimate import Estimate, moved
from sysid.posterior.target import Target, bounded
from sysid.precision import float64, one_thread
from sysid.shown import Shown
from sysid.verdict.determined import enough, parameter
from sysid.verdict.fitted import Fit
from sysid.verdict.result import Parameter, Result

if TYPE_CHECKING:
    from sysid.posterior.chain import Chain

CHAINS, EVEN = 8, 512  # of the normal approximation, and its draws in each
CHECKED, WIDER = (
    64,
    1.3,
)  # points at which the first rung asks for the density, from a normal that is so much wider
ROWS = 256  # proposals at which the last rung asks for the density of every row
BLOCKS = 16  # of proposals, whose spread is the error of what all together give
PER_DRAW = 1.3  # proposals for one effective draw where the posterior is nearly normal
WIDENED = "; widened by what the logs leave open"


@dataclass(frozen=True)
class Offer:
    """What the next rung would take, beyond what has been spent, and what it would bring."""

    accuracy: str
    seconds: float
    brings: str


@dataclass(frozen=True, repr=False)
class Posterior(Shown):
    """Draws (chain, draw) of each parameter, f0 at the fit's reference temperature.

    `errors`: numerical errors of the `estimates`, apart from what the data leave open: Monte-Carlo errors, or
    how far the normal approximation is off. `below`: the rung before. `evaluations` of the density,
    `seconds`, and `pace` in seconds for one; `exact_pace` for one without a polynomial of the residual.
    `log_density` (chain, draw): of the draws, up to a constant.
    """

    fit: Fit
    draws: dict[str, np.ndarray] = field(repr=False)
    log_density: np.ndarray
    ess: float
    rhat: float
    method: str
    result: Result
    seed: int
    accuracy: str
    estimates: dict[str, Estimate] = field(repr=False)
    errors: dict[str, Estimate] = field(repr=False)
    evaluations: int
    seconds: float
    pace: float
    exact_pace: float
    below: "Posterior | None" = field(repr=False)

    @cached_property
    def circuit(self) -> Circuit | None:
        """The equivalent circuit of logs of an impedance, an admittance or a current under a voltage; None of
        others."""
        return circuit(self.fit, self.draws, self.summary(), self.seed)

    def to_frame(self) -> Any:
        """A pandas DataFrame, a row for each (chain, draw); the units of its columns stand in `attrs`."""
        from sysid.report.frames import of_posterior

        return of_posterior(self)

    def plot(self) -> Any:
        """A figure of matplotlib: marginals of the draws, and pairs; None where the logs bound no
        parameter."""
        from sysid.report.plots import Figures, of_posterior

        return Figures.of(of_posterior(self, self.summary())).get("Posterior")

    def save(self, folder: str | Path, loop: Any = None, zoomable: bool = False) -> Path:
        """Write the set of files that `identify` writes into a folder, in the place of an older one, with
        `loop`, the controller that was designed for it, where one is given; returns the folder. `sysid.load`
        gives all of it back. The bytes are the command's but for `created` and `cost` in fit.json.
        `zoomable` as in `report`. Raises OSError where it cannot be written; older files then stay."""
        from sysid.command.sets import save

        return save(self, folder, loop, zoomable=zoomable)

    def report(self, path: str | Path, loop: Any = None, zoomable: bool = False) -> Path:
        """Write the report alone, one HTML file with all its figures, to `path`, which is returned; `loop` as
        in `save`. `zoomable`: beside it a page of the same figures to zoom into, `report_zoomable.html` of
        `report.html`; raises ImportError where plotly is not installed."""
        from sysid.command.sets import report

        return report(self, path, loop, zoomable)

    def to_inferencedata(self) -> Any:
        """ArviZ's own type, with posterior, sample_stats (lp), observed_data, and prior where one was stated.
        Raises ImportError where ArviZ is not installed."""
        from sysid.report.inference import of_posterior

        return of_posterior(self)

    def _brief(self) -> Any:
        from sysid.report.brief import of_posterior

        return of_posterior(self)

    def summary(self) -> dict[str, Parameter]:
        """Posterior mean, standard deviation and central 95 % interval of each parameter, or why it is not
        determined: draws about its minima do not settle what the fit leaves open."""
        told = {n: e for n, e in self.estimates.items() if self.fit.parameters[n].determined}
        return self.fit.parameters | {
            n: parameter(self.fit, n, e.value, e.std, (e.low, e.high)) for n, e in told.items()
        }

    @property
    def convergence(self) -> dict[str, Convergence]:
        """Of each parameter's draws."""
        return {name: Convergence.of(draws) for name, draws in self.draws.items()}

    @property
    def error(self) -> float:
        """The largest numerical error of a mean or of an interval's end, in standard deviations of its
        parameter."""
        off = [(self.errors[n], e.std) for n, e in self.estimates.items() if e.std > 0]
        return max((max(o.value, o.low, o.high) / std for o, std in off), default=float("nan"))

    @property
    def moved(self) -> float | None:
        """The largest distance of an estimate from that of the rung before, in standard deviations; None at
        the first."""
        if self.below is None:
            return None
        return max(e.distance(self.below.estimates[n]) for n, e in self.estimates.items())

    def offer(self) -> Offer | None:
        """The next rung; None above the last."""
        rung = above(self.accuracy)
        if rung is None or not bounded(self.fit):
            return None
        share = PER_DRAW if self.below is None else self.evaluations / self.ess
        trials = self.fit.modes[0].trials
        kept, rows = sum(len(t.log) for t in trials), sum(t.most for t in trials)
        seconds = (
            max(rung.effective * share - (0 if self.below is None else self.evaluations), 0.0) * self.pace
        )
        if rung.every_row and rows > kept:
            seconds += ROWS * self.exact_pace * rows / kept
            return Offer(
                rung.name,
                seconds,
                f"{rung.effective} effective draws, and all {rows} rows in place of {kept} means",
            )
        if self.below is None:
            return Offer(
                rung.name, seconds, f"draws in place of a normal that is off by about {self.error:.2g}"
            )
        left = self.error * np.sqrt(self.ess / rung.effective)
        return Offer(
            rung.name, seconds, f"{rung.effective} effective draws and numerical errors of {left:.1g}"
        )

    def twice(self) -> float | None:
        """Seconds that half the Monte-Carlo error would take beyond what has been spent; None without
        chains."""
        return None if self.below is None else 3 * self.evaluations * self.pace


@float64
@one_thread
def sample(
    fit: Fit, seed: int = 0, accuracy: str | None = None, budget: float | None = None, starting: float = 0.0
) -> Posterior:
    """The posterior of `fit` at an accuracy: "quick" (its normal approximation, and how far off it is),
    "standard" (Markov chains until 1000 effective draws of each parameter and R-hat below 1.01) or "exact"
    (10 000, and the density of every row).

    `budget`: seconds; the best rung that ends within them, up to `accuracy`; the first is always there.
    `starting`: seconds to allow for loading emcee where the program has not done it. A parameter about which
    the logs say nothing is held where the fit left it. The same seed and accuracy give the same draws. Raises
    ValueError for a budget that is no time.
    """
    given("fit", fit, Fit, FIT)
    seed = whole_number("seed", seed)
    if budget is not None and not number("budget", budget) >= 0:
        raise ValueError(f"found budget = {budget:g}, expected seconds, 0 or more")
    until = np.inf if budget is None else perf_counter() + budget
    first, *higher = up_to(accuracy or ("standard" if budget is None else "exact"))
    begun = perf_counter()
    target = Target(fit, seed=seed)
    posterior = _normal(target, seed, first, begun)
    chain = None
    for rung in higher:
        begun, offer = perf_counter(), posterior.offer()
        if begun + (offer.seconds if offer else 0.0) + (0.0 if chain else starting) > until:
            break
        # what emcee imports takes as long as all else, and the first rung has no chains
        from sysid.posterior.chain import (
            ROUNDS,
            Chain,
        )

        chain = chain or Chain(target, target.normal().heavy(), seed)
        if not chain.extend(rung.effective, ROUNDS if target.bounded else 1, until):
            break
        open_ = [n for n in target.names if not fit.parameters[n].determined]
        if fit.result is Result.successful and open_ and not chain.reached(rung.effective):
            along = f"chains that wander along {' and '.join(open_)}, which cannot be told, are left out"
            return replace(posterior, method=f"{posterior.method}; {along}")
        longer = rung.every_row and any(t.whole for t in fit.modes[0].trials)
        whole = Target(fit, every_row=True, until=until) if longer else None
        try:
            posterior = _drawn(chain, whole, posterior, rung, begun)
        except TimeoutError:
            break
    return posterior


def _normal(target: Target, seed: int, rung: Rung, begun: float) -> Posterior:
    """The first rung: the normal approximation, checked at a few points."""
    fit, normal = target.fit, target.normal()
    z = normal.spread(CHAINS * EVEN, np.random.default_rng(seed))
    x = target.parameters(z)
    estimates = {n: Estimate.of(*even) for n, even in target.marginals().items()}
    errors = _off(target, estimates) if target.bounded else _unknown(estimates)
    draws = {n: v.reshape(CHAINS, EVEN) for n, v in x.items()}
    method = (
        f"normal approximation about each minimum ({len(fit.modes)}), compared with the density at"
        f" {CHECKED} points"
    )
    method += WIDENED * (target.dispersion is not None)
    return Posterior(
        fit,
        draws,
        normal.log_density(z).reshape(CHAINS, EVEN),
        ess=min(ess(v) for v in draws.values()),
        rhat=max(rhat(v) for v in draws.values()),
        method=method,
        result=_judged(fit, fit.result, estimates),
        seed=seed,
        accuracy=rung.name,
        estimates=estimates,
        errors=errors,
        evaluations=target.evaluations,
        pace=target.pace if target.bounded else 0.0,
        exact_pace=target.density.pace,
        seconds=perf_counter() - begun,
        below=None,
    )


def _off(target: Target, estimates: dict[str, Estimate]) -> dict[str, Estimate]:
    """By how much the equation moves the estimates of the normal approximation, over a few even points
    further out."""
    normal = target.normal()
    wide = replace(normal, scales=WIDER * normal.scales)
    z = wide.spread(CHECKED, np.random.default_rng(0))
    proposed = wide.log_density(z)
    ratios = target(z) - proposed, normal.log_density(z) - proposed
    even = target.marginals()
    after = {n: moved(even[n], (x, ratios)) for n, x in target.parameters(z).items()}
    return {n: Estimate(*np.abs(np.subtract(after[n], e)).tolist()) for n, e in estimates.items()}


def _drawn(chain: "Chain", whole: Target | None, below: Posterior, rung: Rung, begun: float) -> Posterior:
    """A rung of Markov chains; `whole`: the density of every row, by which the estimates are corrected."""
    target, fit = chain.target, chain.target.fit
    z = chain.draws()
    draws = {n: v.reshape(z.shape[:2]) for n, v in target.parameters(z.reshape(-1, z.shape[-1])).items()}
    if target.bounded:
        estimates, errors = _corrected(chain, whole)
    else:
        estimates = {n: Estimate.of(v.ravel(), np.full(v.size, 1 / v.size)) for n, v in draws.items()}
        errors = _unknown(estimates)
    result = fit.result
    if result is Result.successful and not chain.reached(rung.effective):
        result = Result.sampler_stopped
    method = (
        f"emcee, {z.shape[0]} walkers, independence Metropolis from a Student-t mixture about each minimum"
        f" ({len(fit.modes)}),"
        f" {rung.effective} effective draws; estimates corrected by importance"
    )
    if target.density.smooth:
        method += f"; density by a cubic of the residual, within {target.density.error:.1g} of the exact one"
    if whole is not None:
        method += f", with the density of all {whole.rows} rows at {whole.evaluations} points"
    method += WIDENED * (target.dispersion is not None)
    return Posterior(
        fit,
        draws,
        chain.log_density(),
        ess=chain.ess,
        rhat=chain.rhat,
        method=method,
        result=_judged(fit, result, estimates),
        seed=below.seed,
        accuracy=rung.name,
        estimates=estimates,
        errors=errors,
        evaluations=target.evaluations,
        pace=target.pace,
        exact_pace=target.density.pace,
        seconds=perf_counter() - begun,
        below=below,
    )


def _corrected(
    chain: "Chain", whole: Target | None = None
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Estimates by the equation of `posterior.estimate`, and their Monte-Carlo errors from BLOCKS blocks of
    the proposals."""
    target, normal = chain.target, chain.target.normal()
    even = target.marginals()
    z, density, proposed = chain.proposed()
    few = slice(0, ROWS if whole else 0)  # proposals are independent: the first are as good as any
    ratios = [density - proposed, normal.log_density(z) - proposed]
    rows = [(whole(z[few]) if whole else density[few]) - proposed[few], ratios[0][few]]
    estimates, errors = {}, {}
    for name, x in target.parameters(z).items():
        blocks = [slice(k, None, BLOCKS) for k in range(BLOCKS)]
        parts = [
            moved(even[name], (x[b], [r[b] for r in ratios]), (x[few][b], [r[b] for r in rows]))
            for b in blocks
        ]
        spread = np.std(parts, axis=0, ddof=1) / np.sqrt(BLOCKS)
        estimates[name], errors[name] = (
            moved(even[name], (x, ratios), (x[few], rows)),
            Estimate(*map(float, spread)),
        )
    return estimates, errors


def _unknown(estimates: dict[str, Estimate]) -> dict[str, Estimate]:
    return dict.fromkeys(estimates, Estimate(np.nan, np.nan, np.nan, np.nan))


def _judged(fit: Fit, result: Result, estimates: dict[str, Estimate]) -> Result:
    """`result`, unless an estimate shows that the logs do not determine tau or G."""
    if result is not Result.successful:
        return result
    known = {n: parameter(fit, n, e.value, e.std, (e.low, e.high)) for n, e in estimates.items()}
    return result if enough(fit.parameters | known, fit.modes[0].trials) else Result.undetermined
