"""How well the fit's description of the logs predicts them beside others with something left out, by
leave-one-out.

A row left out is predicted from all others, without a new fit, as normal about its fitted value: with its
leverage h the residual is r/(1 - h) and the variance sigma^2/(1 - h). The sum of the log densities is the
elpd of a description (Vehtari, Gelman & Gabry, Stat. Comput. 27, 1413, 2017; exact for a linear model: Allen,
Technometrics 16, 125, 1974). Descriptions are compared row by row, which gives their difference a standard
error. The plant is linearised about the fit, and each log keeps the noise colour of the fit.

The comparison is for information and selects nothing: intervals computed as if a selected description were
certain would be too narrow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from sysid.asked import FIT, given
from sysid.model.theta import NAMES
from sysid.shown import Shown
from sysid.trials.extra import EXTRA, UNITS
from sysid.trials.trial import NUISANCES, Trial
from sysid.verdict.fitted import Fit
from sysid.verdict.linearised import LinearisedLog

# Leaving out k numbers that are not needed changes elpd by k - chi^2_k/2: it falls by more than this in 3.6 %
# of cases if k = 1, in 4.1 % if k = 2, and more seldom the larger k is; of logs as short as a bench's a
# little more often.
NEEDED = 1.2


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """A description beside the fit's: `difference` of elpd (negative: it predicts worse) and its standard
    `error`; `moves`, by parameter, how far the estimate would go, in standard deviations."""

    description: str
    difference: float
    error: float
    moves: dict[str, float]

    def _brief(self) -> Any:
        from sysid.report.brief import of_comparison

        return of_comparison(self)

    @property
    def worse(self) -> bool:
        """Whether the logs need what it leaves out."""
        return self.difference < -NEEDED


def compare(fit: Fit) -> tuple[Comparison, ...]:
    """Every description that leaves out one part of the fit's, the worst first."""
    given("fit", fit, Fit, FIT)
    logs = _Logs(fit)
    every = (*NUISANCES, *EXTRA)  # effects that are fitted are part of all descriptions
    full = logs.described(every)
    others = {
        f"without {n}": logs.described(tuple(m for m in every if m != n)) for n in every if logs.hold(n)
    }
    if logs.first_order:
        others["first order, without detuning"] = logs.described(every, "first order")
    if "f0" in fit.names:
        others["slowly varying envelope"] = logs.described(every, "envelope")
    found = []
    for name, (elpd, estimate) in others.items():
        by_row = elpd - full[0]
        moves = (estimate - full[1]) / logs.std
        known = {n: float(m) for n, m in zip(fit.names, moves, strict=True) if np.isfinite(m)}
        error = float(np.sqrt(len(by_row)) * np.std(by_row))
        found.append(Comparison(name, float(np.sum(by_row)), error, known))
    return tuple(sorted(found, key=lambda c: c.difference))


def verdict(found: Sequence[Comparison]) -> str:
    """One line on which descriptions the logs tell from the fit's."""
    worse = [f"{c.description} ({c.difference:+.3g})" for c in found if c.worse]
    alike = [f"{c.description} ({c.difference:+.2g})" for c in found if not c.worse]
    said = [f"worse: {', '.join(worse)}"] if worse else []
    said += [f"no worse, so the result does not depend on: {', '.join(alike)}"] if alike else []
    return "; ".join(said) or "there is nothing to leave out"


class _Logs:
    """The logs of a fit, to be described in several ways; `std` of the parameters in `fit.names`, in theta's
    units."""

    def __init__(self, fit: Fit):
        self.fit, self.state = fit, fit.modes[0]
        self.index = [NAMES.index(n) for n in fit.names]
        self.std = np.sqrt(np.diag(self.state.spread))[self.index]
        self.view = cache(self._view)  # of a log, by its place, with these nuisances

    def _view(self, log: int, kept: tuple[str, ...]) -> LinearisedLog:
        trial, model = self.state.trials[log], self.state.models[log]
        return LinearisedLog(
            replace(trial, nuisances=kept), model, self.state, self.fit.reference, coloured=True
        )

    def described(self, nuisances: tuple[str, ...], physics: str = "exact") -> tuple[np.ndarray, np.ndarray]:
        """elpd of each row, and the change of the plant's parameters from the fit's; NaN for one that the
        physics has not."""
        index = self.index if physics != "first order" else [k for k in self.index if k < 2]
        views, left = [], []
        for i, trial in enumerate(self.state.trials):
            kept = tuple(n for n in trial.nuisances if n in nuisances)
            views.append(self.view(i, kept))
            left.append(views[-1].off(_left(self.view(i, trial.nuisances), kept, physics)))
        jacobians = [v.jacobian[:, index] for v in views]
        size = np.sqrt(sum(np.sum(j**2, axis=0) for j in jacobians))
        size = np.where(size > 1e-150, size, 1.0)  # nothing depends on it, as where tau ran away
        jacobians = [j / size for j in jacobians]
        prior = self.state.prior
        held = prior.precision[np.ix_(index, index)] / np.outer(size, size)
        inverse = np.linalg.pinv(sum(j.T @ j for j in jacobians) + held, rcond=1e-12, hermitian=True)
        pulled = prior.slope(self.state.theta)[index] / size
        shift = inverse @ (sum(j.T @ y for j, y in zip(jacobians, left, strict=True)) - pulled)
        parts = zip(views, jacobians, left, strict=True)
        moved = np.full(len(NAMES), np.nan)
        moved[index] = shift / size
        return np.concatenate([_elpd(v, j, y - j @ shift, inverse) for v, j, y in parts]), moved[self.index]

    def hold(self, nuisance: str) -> bool:
        """Whether some log may hold it."""
        return any(nuisance in t.nuisances and _can_hold(t, nuisance) for t in self.state.trials)

    @property
    def first_order(self) -> bool:
        """Whether a model without a frequency could describe the logs: d/q transients, each at one
        frequency."""
        moving = all(t.signed and not t.steady for t in self.state.trials)
        return moving and all(
            t.resonant and np.ptp(t.log.frequency) == 0 for t in self.state.trials if t.driven
        )


def _can_hold(trial: Trial, nuisance: str) -> bool:
    if nuisance == "rotation":
        return not trial.log.amplitude_only
    if trial.bench.standing and nuisance == "offset":
        return True
    if nuisance == "start":
        return trial.start_free
    if nuisance == "late":
        return trial.lateness > 0
    if nuisance in UNITS:
        return nuisance in trial.bench.extra
    return len(replace(trial, nuisances=(nuisance,)).columns) > 0


def _left(view: LinearisedLog, kept: tuple[str, ...], physics: str) -> np.ndarray:
    """The log (n,) less what the plate does at the fit, with nothing of what the bench adds taken away."""
    trial, log, course = view.trial, view.trial.log, view.course
    if not trial.signed:
        started = "start" in trial.nuisances and "start" not in kept
        if trial.bench.standing and "offset" not in kept:
            return log.response - np.abs(course.forced if started else course.plate - trial.bench.offset)
        return log.response - np.abs(course.forced + trial.bench.offset) if started else view.residual
    turn = view.turn if "rotation" in kept else 1.0
    if physics == "exact":
        return log.response - turn * (view.model - view.bench) / view.turn
    if physics == "envelope":
        return log.response - turn * course.envelope.forced
    settling = course.envelope.at(-1j * course.detuning).forced
    along = np.vdot(settling, log.response - view.bench)
    return log.response - settling * (along / abs(along) if along and "rotation" in kept else 1.0)


def _elpd(view: LinearisedLog, jacobian: np.ndarray, left: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Log density of each real row of a log, predicted from the others; up to a constant of the log."""
    rows = len(view.recorded) - view.priors
    leverage = np.sum(view.basis[:rows] ** 2, axis=1) + np.einsum(
        "ri,ij,rj->r", jacobian[:rows], inverse, jacobian[:rows]
    )
    free = 1 - np.minimum(leverage, 0.99)
    variance = max(np.sum(left**2) / max(np.sum(free), 1.0), 1e-300)
    return -0.5 * np.log(variance / free) - 0.5 * left[:rows] ** 2 / (variance * free)
