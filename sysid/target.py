"""The posterior density of a fit, in coordinates that make it nearly standard normal; counted and timed as it is evaluated."""

from time import perf_counter

import numpy as np

from sysid.experiment import group
from sysid.fitting import Fit
from sysid.identify import limits
from sysid.minimise import FINGER, NAMES
from sysid.mixture import Mixture
from sysid.surrogate import Density


class Target:
    """log p(z) up to a constant, theta = best + triangle z over the parameters `names` that the data bound at all.

    `every_row`: of the files, where the fit took the means of neighbouring rows. `evaluations` counts points, most of which are
    those of `sysid.surrogate` where there is one minimum; `pace` is the seconds that one takes once the programs are there.
    """

    def __init__(self, fit: Fit, every_row: bool = False):
        self.fit, self.names = fit, _bounded(fit)
        best = fit.modes[0]
        self.index = [NAMES.index(n) for n in self.names]
        covariance = best.covariance[np.ix_(self.index, self.index)]
        if not fit.result.bounded:  # a broad look at what is left, not an interval
            covariance = np.diag(np.minimum(np.diag(covariance), 1.0))
        self.triangle = np.linalg.cholesky(covariance)
        trials = tuple(t.uncondensed() for t in best.trials) if every_row else best.trials
        groups, _ = group(trials, fit.reference, low_q=best.low_q)
        smooth = fit.result.bounded and len(fit.modes) == 1 and not every_row
        self.density, self.rows = Density(self.theta, groups, smooth), sum(len(t.log) for t in trials)
        self.evaluations, self._warm, self._seconds = 0, 0, 0.0

    def theta(self, z: np.ndarray) -> np.ndarray:
        """(n, 6) parameters of the fit at z (n, p)."""
        full = np.tile(self.fit.modes[0].theta, (len(z), 1))
        full[:, self.index] += z @ self.triangle.T
        return full

    def parameters(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Each parameter (n,) at z (n, p), f0 at the fit's reference temperature."""
        fit, theta = self.fit, self.theta(z)
        drift = fit.reference_temperature - fit.reference[1] if fit.reference_temperature is not None else 0.0
        f0 = fit.reference[0] + theta[:, 2] + drift * theta[:, 3]
        values = {"G": np.exp(theta[:, 0]), "tau": np.exp(theta[:, 1]), "f0": f0, "k_T": theta[:, 3]}
        values |= dict(zip(FINGER, theta[:, 4:].T, strict=True))
        return {n: values[n] for n in self.names}

    def normal(self) -> Mixture:
        """The normal approximation about each minimum."""
        fit, p = self.fit, len(self.index)
        if not fit.result.bounded:
            return Mixture(np.zeros((1, p)), np.eye(p)[None], np.ones(1))
        best, index = fit.modes[0], self.index
        centres = [np.linalg.solve(self.triangle, (s.theta - best.theta)[index]) for s in fit.modes]
        scales = [np.linalg.solve(self.triangle, np.linalg.cholesky(s.covariance[np.ix_(index, index)])) for s in fit.modes]
        weights = np.exp(-np.array([s.cost for s in fit.modes]) + best.cost) + 0.02
        return Mixture(np.array(centres), np.array(scales), weights / weights.sum())

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """(n,) log density at z (n, p); -inf where it is not finite."""
        begun = perf_counter()
        value = self.density(z)
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


def _bounded(fit: Fit) -> tuple[str, ...]:
    """Parameters that the data bound at all: within ten times the limit of what counts as determined."""
    state = fit.modes[0]
    widest = limits(1.0, np.exp(state.theta[1])) | {"tau": limits(1.0, 1.0)["tau"]}
    std = np.sqrt(np.diag(state.covariance))
    kept = tuple(n for n in fit.names if std[NAMES.index(n)] <= 10 * widest[n])
    return kept or ("tau",)
