"""What a controller would promise after a further experiment, from the posterior that is expected then.

After the experiment the posterior is expected to be nearly normal about the same mean, with a covariance
shrunk by the new information. Draws of it stand for the posterior, a controller is designed for them, and its
promise is read. All experiments share the same even draws, so that promises differ by the experiments alone.
The gap between a margin and that of an exactly known plate is predicted to 15 % of the gap before; the margin
of the known plate itself moves with the estimate of tau, by which the bandwidth is chosen.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sysid.model.theta import NAMES, PLANT, carried, in_units
from sysid.posterior.mixture import Mixture
from sysid.shown import Shown
from sysid.verdict.fitted import Fit
from sysid.verdict.identify import limits, seconds
from sysid.verdict.result import NORMAL95, Parameter

EVEN = 512  # draws, of which a design takes 400
MOVED = 1.01  # by which a promise must change: the worst of so few plants is not known much better
Design = Callable[[Any], Any]


class Quantity(NamedTuple):
    """A promised quantity: its name in a sentence, the field of the promise, its unit, its value without a
    controller."""

    said: str
    field: str
    unit: str
    without: float


PROMISES = {
    "margin": Quantity("disk margin", "disk", "1", 0.0),
    "settling": Quantity("settling time", "settling", "s", np.inf),
}


@dataclass(frozen=True)
class Foreseen:
    """A posterior with what `controller.design` reads: `draws` (EVEN,) of each determined parameter, f0 at
    the fit's reference temperature; means and standard deviations."""

    fit: Fit
    draws: dict[str, np.ndarray] = field(repr=False)
    known: dict[str, Parameter]

    @classmethod
    def of(cls, fit: Fit, covariance: np.ndarray) -> "Foreseen":
        """`covariance` (6, 6) of theta, about the fit's best minimum."""
        theta = fit.modes[0].theta
        z = Mixture(np.zeros((1, 6)), np.linalg.cholesky(covariance)[None], np.ones(1)).spread(
            EVEN, np.random.default_rng(0)
        )
        x = in_units((theta + z) @ carried(fit.warming).T, fit.reference[0])
        values = {n: x[:, NAMES.index(n)] for n in PLANT}
        most = limits(*np.exp(theta[:2]))
        known = {n: _known(v, most[n], fit.units[n]) for n, v in values.items()}
        return cls(fit, {n: v for n, v in values.items() if known[n].determined}, known)

    def summary(self) -> dict[str, Parameter]:
        """Mean, standard deviation and 95 % interval of each parameter, or that it is not determined."""
        return self.known


def _known(values: np.ndarray, most: float, unit: str) -> Parameter:
    mean, std = float(np.mean(values)), float(np.std(values))
    if std > most:
        return Parameter(None, None, None, unit, False, "cannot be told yet")
    return Parameter(mean, std, (mean - NORMAL95 * std, mean + NORMAL95 * std), unit, True)


def promised(fit: Fit, covariance: np.ndarray, design: Design, quantity: Quantity) -> float:
    """What `design` promises if theta is known with this covariance (6, 6). Raises ValueError if it
    refuses."""
    return float(getattr(design(Foreseen.of(fit, covariance)).promise, quantity.field))


@dataclass(frozen=True, repr=False)
class Raised(Shown):
    """An experiment with the promise for the closed loop `before` and `after` it, its seconds at the bench,
    and the promise for an exactly known plate (`best`). `parameter`: "margin" (1) or "settling" (s)."""

    experiment: Any
    parameter: str
    before: float
    after: float
    best: float
    seconds: float

    def _brief(self) -> Any:
        from sysid.report.brief import of_advice

        return of_advice(self)

    def __str__(self) -> str:
        quantity, (before, after, best) = PROMISES[self.parameter], self._told
        promise = f"{quantity.said} promised from {before} to {after} (a plate known exactly: {best})"
        return f"{self.experiment}: {promise}, in {self.seconds:.3g} s"

    @property
    def had(self) -> str:
        """That no experiment betters the promise, in words."""
        before, _, best = self._told
        return (
            f"no step or sweep betters the {PROMISES[self.parameter].said} promised by as much as"
            f" {100 * (MOVED - 1):.0f} %: {before}, for a plate known exactly {best}"
        )

    @property
    def _told(self) -> tuple[str, str, str]:
        """Before, after and for a plate known exactly, in words."""
        quantity = PROMISES[self.parameter]
        before, after, best = (
            f"{x:.3g}" if quantity.unit == "1" else seconds(x) for x in (self.before, self.after, self.best)
        )
        return "no controller" if self.before == quantity.without else before, after, best

    @property
    def unit(self) -> str:
        return PROMISES[self.parameter].unit

    @property
    def rate(self) -> float:
        """Gain of the margin, or of 1/settling (1/s), per second at the bench."""
        after, before = (
            (self.after, self.before) if self.parameter == "margin" else (1 / self.after, 1 / self.before)
        )
        return (after - before) / self.seconds

    @property
    def settles(self) -> bool:
        """Whether a controller exists afterwards."""
        return self.after != PROMISES[self.parameter].without

    @property
    def worthwhile(self) -> bool:
        """Whether the promise improves by more than its own uncertainty."""
        worse, better = (self.before, self.after) if self.parameter == "margin" else (self.after, self.before)
        return better > MOVED * worse


class Advised(tuple):
    """Experiments to record next, the best first; `why` there is none, a sentence."""

    why: str = ""

    @classmethod
    def none(cls, why: str) -> "Advised":
        """No experiment."""
        empty = cls()
        empty.why = why
        return empty
