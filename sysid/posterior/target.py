"""The posterior density of a fit, in coordinates in which it is nearly standard normal; evaluations are
counted and timed."""

from collections.abc import Sequence
from functools import cached_property
from time import perf_counter

import numpy as np
from scipy.special import ndtri

from sysid.minimum.minimise import Minimiser, State, shares
from sysid.minimum.ridge import along, bent
from sysid.model.theta import NAMES, POSITIVE, carried
from sysid.posterior.mixture import Mixture
from sysid.posterior.surrogate import Density
from sysid.trials.experiment import group
from sysid.trials.extra import asked
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial
from sysid.trials.whole import uncondensed
from sysid.verdict.fitted import Fit
from sysid.verdict.identify import limits

QUANTILES = 4096  # of a normal: its standard deviation to 2e-4
LINE = np.linspace(-5, 5, 11)  # standard deviations, at which a ridge is compared with a normal
LARGEST = 300.0  # of a logarithm, beyond which squares of what cannot be told are no numbers
LEAST = 1e-12  # of the correlations, relative: of less no Cholesky factor is to be had
WASTE = 1.2  # draws for an effective one from which a ridge is followed: of a normal it is 1.01


class Target:
    """log p(z) up to a constant, theta = best + triangle z, over those parameters `names` that the data bound
    at all.

    Where logs differ, the plant is farther from what they tell together: `parameters` draws by how much, with
    `seed`. `every_row`: of the files, where the fit used averages of neighbouring rows. `evaluations` counts
    points; with a single minimum most of them are those of `posterior.surrogate`. `pace`: seconds per point,
    loading of programs aside.
    """

    def __init__(self, fit: Fit, every_row: bool = False, until: float = np.inf, seed: int = 0):
        self.fit, self.names = fit, _bounded(fit) or ("tau",)
        best = fit.modes[0]
        self.index = [NAMES.index(n) for n in self.names]
        covariance = best.covariance[np.ix_(self.index, self.index)]
        self.bounded = bounded(fit)
        if not self.bounded:  # a broad look at what is left, not an interval
            most = [1.0 if n in POSITIVE else np.inf for n in self.names]  # of a logarithm
            covariance = np.diag(np.minimum(np.diag(covariance), most))
        self.triangle = np.linalg.cholesky(covariance)
        self._carried = carried(fit.warming)[
            self.index
        ]  # f0 is reported at another temperature than the fit's own
        self._along = self._carried[:, self.index] @ self.triangle
        differing = self.bounded and bool(np.any(best.dispersion))
        self.dispersion = (
            self._carried @ best.dispersion @ self._carried.T if differing else None
        )  # of what is reported
        self._rng = np.random.default_rng(seed)
        trials = tuple(self._whole(t) for t in best.trials) if every_row else best.trials
        groups, _ = group(trials, fit.reference, low_q=best.low_q)
        about = self._about(fit.modes) if self.bounded and not every_row else None
        self.density, self.rows = Density(self.theta, groups, about, until), sum(len(t.log) for t in trials)
        self.evaluations, self._warm, self._seconds = 0, 0, 0.0

    def _whole(self, trial: Trial) -> Trial:
        """The trial over all rows of the file."""
        whole, best = uncondensed(trial), self.fit.modes[0]
        course = LogResponse.of(whole, self.fit.reference, best.theta)
        return whole.with_bench(extra=asked(whole, course, (whole.bench.start, -whole.bench.late)))

    def theta(self, z: np.ndarray) -> np.ndarray:
        """(n, 6) parameters of the fit at z (n, p)."""
        full = np.tile(self.fit.modes[0].theta, (len(z), 1))
        full[:, self.index] += z @ self.triangle.T
        return full

    def parameters(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Each parameter (n,) at z (n, p), f0 at the fit's reference temperature."""
        x = self.fit.modes[0].theta @ self._carried.T + z @ self._along.T
        if self.dispersion is not None:
            x = x + self._rng.multivariate_normal(
                np.zeros(len(self.dispersion)), self.dispersion, len(z), method="eigh"
            )
        return self._named(x)

    def marginals(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Even quantiles of each parameter under the normal approximation, and their weights."""
        normal = self.normal()
        centres = self.fit.modes[0].theta @ self._carried.T + normal.centres @ self._along.T
        widths = np.linalg.norm(self._along @ normal.scales, axis=2)  # (components, parameters)
        if self.dispersion is not None:
            widths = np.sqrt(widths**2 + np.diag(self.dispersion))
        even = ndtri((np.arange(QUANTILES) + 0.5) / QUANTILES)
        x = (centres[:, None] + even[:, None] * widths[:, None]).reshape(-1, len(self.names))
        weight = np.repeat(normal.weights / QUANTILES, QUANTILES)
        return {name: (values, weight) for name, values in self._named(x).items()}

    def _named(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters by name, from their components of theta."""
        f0 = self.fit.reference[0]
        return {
            n: np.exp(np.clip(v, -LARGEST, LARGEST)) if n in POSITIVE else f0 + v if n == "f0" else v
            for n, v in zip(self.names, x.T, strict=True)
        }

    @cached_property
    def _places(self) -> Sequence[State]:
        """The minima; where no normal follows a ridge through them, the places along it."""
        fit = self.fit
        minimiser = Minimiser(fit.reference, fit.names, fit.modes[0].prior)
        curved = "f0" in self.names and bent(minimiser, fit.modes[0])
        ridge = "f0" if curved else self._slow()
        if ridge is None:
            return fit.modes
        return [s for s in along(minimiser, fit.modes, ridge) if self._tells(s)] or fit.modes

    def _tells(self, state: State) -> bool:
        """Whether a place on a ridge has a covariance of all parameters."""
        covariance = state.covariance[np.ix_(self.index, self.index)]
        size = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        return (
            bool(np.isfinite(state.evidence))
            and np.linalg.eigvalsh(covariance / np.outer(size, size))[0] > LEAST
        )

    def _slow(self) -> str | None:
        """The parameter along which a chain that proposes from the normal about the best minimum would take
        the most draws for an effective one, if it takes more than WASTE. With p the density and q the
        proposal along theta's line of that parameter, the others at their means given it, these are

            int p^2/q int q / (int p)^2
        """
        best, p = self.fit.modes[0], len(self.index)
        covariance = best.covariance[np.ix_(self.index, self.index)]
        lines = np.linalg.solve(self.triangle, covariance / np.sqrt(np.diag(covariance))).T  # (parameters, p)
        z = LINE[:, None] * lines[:, None]
        density = self(z.reshape(-1, p)).reshape(p, -1)
        proposed = self._about([best]).heavy().log_density(z.reshape(-1, p)).reshape(p, -1)
        shown, drawn = (np.exp(v - v.max(axis=1, keepdims=True)) for v in (density, proposed))
        draws = np.sum(shown**2 / drawn, axis=1) * np.sum(drawn, axis=1) / np.sum(shown, axis=1) ** 2
        worst = int(np.argmax(draws))
        return self.names[worst] if draws[worst] > WASTE else None

    def normal(self) -> Mixture:
        """The normal approximation about each minimum, or along each ridge."""
        p = len(self.index)
        if not self.bounded:
            return Mixture(np.zeros((1, p)), np.eye(p)[None], np.ones(1))
        return self._about(self._places)

    def _about(self, places: Sequence[State]) -> Mixture:
        """The normal approximation about each of these."""
        best, index = self.fit.modes[0], self.index
        centres = [np.linalg.solve(self.triangle, (s.theta - best.theta)[index]) for s in places]
        scales = [
            np.linalg.solve(self.triangle, np.linalg.cholesky(s.covariance[np.ix_(index, index)]))
            for s in places
        ]
        weights = shares(places)
        if places is self.fit.modes:
            weights = weights + 0.02 / len(places)  # one that is next to nothing is proposed too
        return Mixture(np.array(centres), np.array(scales), weights / weights.sum())

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """(n,) log density at z (n, p); -inf where it is not finite."""
        begun = perf_counter()
        value = self.density(z) - self.fit.modes[0].prior.cost(self.theta(z))
        if self.evaluations:  # the first call also loads programs
            self._seconds, self._warm = self._seconds + perf_counter() - begun, self._warm + len(z)
        self.evaluations += len(z)
        return value

    @property
    def pace(self) -> float:
        """Seconds per point of the evaluations so far, the first call aside."""
        while not self._warm:
            self(np.zeros((self.density.batch, len(self.index))))
        return self._seconds / self._warm


def bounded(fit: Fit) -> bool:
    """Whether the logs bound any parameter, so that there is a posterior to draw from. Of logs that the model
    does not describe they may bound none."""
    return fit.result.bounded and bool(_bounded(fit))


def _bounded(fit: Fit) -> tuple[str, ...]:
    """Parameters that the data bound at all: within ten times the limit of what counts as determined."""
    state = fit.modes[0]
    widest = limits(1.0, state.tau) | {"tau": limits(1.0, 1.0)["tau"]}
    std = np.sqrt(np.diag(state.spread))
    return tuple(n for n in fit.names if std[NAMES.index(n)] <= 10 * widest[n])
