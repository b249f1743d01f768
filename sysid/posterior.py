"""The posterior of the plant: emcee over the compiled density, proposals from the fit's own minima."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import emcee
import numpy as np

from sysid.diagnostics import ess, rhat
from sysid.experiment import group
from sysid.fitting import Fit, parameter, usable
from sysid.identify import limits
from sysid.minimise import FINGER, NAMES
from sysid.precision import float64
from sysid.result import Parameter, Result
from sysid.surrogate import Density

WALKERS = 8
ENOUGH = 1000.0  # effective draws of the worst parameter: Monte-Carlo error 3 % of a standard deviation
AGREED = 1.01  # split R-hat
BURN = 4  # steps: the walkers begin as draws of the proposal, an independence chain forgets them at its first accepted step
FIRST, LEAST = 180, 16  # steps before the first look at the criteria, and before any other
ROUNDS = 100
TAILS = 12.0  # degrees of freedom of the proposal's Student-t: tails heavier than those of all but the shortest logs


@dataclass(frozen=True)
class Posterior:
    """Draws (chain, draw) of each parameter, f0 at the fit's reference temperature."""

    fit: Fit
    draws: dict[str, np.ndarray] = field(repr=False)
    ess: float
    rhat: float
    acceptance: float
    method: str
    result: Result
    seed: int

    def summary(self) -> dict[str, Parameter]:
        """Posterior mean, standard deviation and central 95 % interval of each parameter, or why it is not determined."""
        found = {}
        for name in self.fit.parameters:
            if name in self.draws:
                x = self.draws[name]
                low, high = np.quantile(x, [0.025, 0.975])
                found[name] = parameter(self.fit, name, float(x.mean()), float(x.std(ddof=1)), (float(low), float(high)))
            else:
                found[name] = self.fit.parameters[name]
        return found


@dataclass(frozen=True)
class _Mixture:
    """Student-t components in the coordinates z: centres (m, p), triangular scales (m, p, p), weights (m,)."""

    centres: np.ndarray
    scales: np.ndarray
    weights: np.ndarray

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        m, p = self.centres.shape
        which = rng.choice(m, n, p=self.weights)
        t = rng.standard_normal((n, p)) / np.sqrt(rng.chisquare(TAILS, (n, 1)) / TAILS)
        return self.centres[which] + np.einsum("nij,nj->ni", self.scales[which], t)

    def log_density(self, z: np.ndarray) -> np.ndarray:
        p = z.shape[1]
        parts = []
        for centre, scale, weight in zip(self.centres, self.scales, self.weights, strict=True):
            inside = np.linalg.solve(scale, (z - centre).T)
            size = np.sum(np.log(np.abs(np.diag(scale))))
            parts.append(np.log(weight) - size - 0.5 * (TAILS + p) * np.log1p(np.sum(inside**2, axis=0) / TAILS))
        return np.logaddexp.reduce(parts, axis=0)


@float64
def sample(fit: Fit, seed: int = 0) -> Posterior:
    """Draw from the posterior of `fit` until ENOUGH effective draws of each parameter and R-hat below AGREED.

    Each walker is an independence Metropolis chain whose proposal is the mixture of Student-t about the fit's minima.
    A parameter about which the logs say nothing is held where the fit left it. The same seed gives the same draws. With one
    minimum the density comes from `sysid.surrogate`, where that agrees with the exact one.
    """
    best = fit.modes[0]
    names = _sampled(fit)
    index = [NAMES.index(n) for n in names]
    covariance = best.covariance[np.ix_(index, index)]
    if not fit.result.bounded:  # a broad look at what is left, not an interval
        covariance = np.diag(np.minimum(np.diag(covariance), 1.0))
    triangle = np.linalg.cholesky(covariance)
    groups, _ = group(best.trials, fit.reference, low_q=best.low_q)

    def theta(z: np.ndarray) -> np.ndarray:
        full = np.tile(best.theta, (len(z), 1))
        full[:, index] += z @ triangle.T
        return full

    density = Density(theta, groups, smooth=fit.result.bounded and len(fit.modes) == 1)
    proposal = _proposal(fit, index, triangle)
    sampler, worst, agreed = _run(density, proposal, len(index), seed, ROUNDS if fit.result.bounded else 1)
    chains = np.swapaxes(sampler.get_chain(discard=BURN), 0, 1)
    draws = _parameters(fit, names, theta(chains.reshape(-1, len(index))), chains.shape[:2])
    result = fit.result
    if result is Result.successful and (worst < ENOUGH or not agreed < AGREED):
        result = Result.sampler_stopped
    method = f"emcee, {WALKERS} walkers, independence Metropolis from a Student-t mixture about each minimum ({len(fit.modes)})"
    if density.smooth:
        method += f"; log density by a cubic of the residual, within {density.error:.1g} of the exact one"
    accepted = float(np.mean(sampler.acceptance_fraction))
    posterior = Posterior(fit, draws, worst, agreed, accepted, method, result, seed)
    if result is Result.successful and not usable(posterior.summary(), best.trials):
        return Posterior(fit, draws, worst, agreed, accepted, method, Result.undetermined, seed)
    return posterior


def _sampled(fit: Fit) -> tuple[str, ...]:
    """Parameters that the data bound at all: within ten times the limit of what counts as determined."""
    state = fit.modes[0]
    widest = limits(1.0, np.exp(state.theta[1])) | {"tau": limits(1.0, 1.0)["tau"]}
    std = np.sqrt(np.diag(state.covariance))
    kept = tuple(n for n in fit.names if std[NAMES.index(n)] <= 10 * widest[n])
    return kept or ("tau",)


def _proposal(fit: Fit, index: list[int], triangle: np.ndarray) -> _Mixture:
    centres, scales = [], []
    if not fit.result.bounded:
        return _Mixture(np.zeros((1, len(index))), np.eye(len(index))[None], np.ones(1))
    for state in fit.modes:
        centres.append(np.linalg.solve(triangle, (state.theta - fit.modes[0].theta)[index]))
        scales.append(np.linalg.solve(triangle, np.linalg.cholesky(state.covariance[np.ix_(index, index)])))
    weights = np.exp(-np.array([s.cost for s in fit.modes]) + fit.modes[0].cost) + 0.02
    return _Mixture(np.array(centres), np.array(scales), weights / weights.sum())


class _Independence(emcee.moves.Move):
    """Independence Metropolis of all walkers: what is proposed does not depend on where they are, so that the proposals of many
    steps are evaluated together beforehand."""

    def __init__(self, proposal: _Mixture, density: Callable[[np.ndarray], np.ndarray], rng: np.random.Generator):
        self.proposal, self.density, self.rng = proposal, density, rng
        self.ahead: Iterator[tuple[np.ndarray, np.ndarray]] = iter(())

    def prepare(self, steps: int) -> None:
        """Draw and evaluate what the next `steps` will propose."""
        z = self.proposal.draw(steps * WALKERS, self.rng)
        log_density = self.density(z)
        self.ahead = zip(z.reshape(steps, WALKERS, -1), log_density.reshape(steps, WALKERS), strict=True)

    def propose(self, model, state):
        z, log_density = next(self.ahead)
        rise = log_density - state.log_prob + self.proposal.log_density(state.coords) - self.proposal.log_density(z)
        accepted = np.log(model.random.rand(WALKERS)) < rise
        return self.update(state, emcee.State(z, log_prob=log_density), accepted), accepted


def _run(density, proposal: _Mixture, dimension: int, seed: int, rounds: int):
    """Run emcee in rounds until the criteria hold. Returns the sampler, the smallest ESS and the largest R-hat."""
    rng = np.random.default_rng(seed)
    move = _Independence(proposal, density, rng)
    sampler = emcee.EnsembleSampler(WALKERS, dimension, density, moves=move, vectorize=True)
    # emcee accepts by the legacy generator and takes its state from numpy's global one unless told otherwise.
    state = emcee.State(proposal.draw(WALKERS, rng), random_state=np.random.RandomState(seed).get_state())
    worst, agreed, steps = 0.0, np.inf, FIRST
    for _ in range(rounds):
        move.prepare(steps)
        state = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        chains = np.swapaxes(sampler.get_chain(discard=BURN), 0, 1)
        worst = min(ess(chains[..., k]) for k in range(dimension))
        agreed = max(rhat(chains[..., k]) for k in range(dimension))
        if worst >= ENOUGH and agreed < AGREED:
            break
        short = 1.05 * sampler.iteration * (ENOUGH / max(worst, 1.0) - 1.0)  # steps, at the rate seen so far
        steps = int(np.clip(short, LEAST, sampler.iteration))
    return sampler, float(worst), float(agreed)


def _parameters(fit: Fit, names, thetas: np.ndarray, shape) -> dict[str, np.ndarray]:
    drift = fit.reference_temperature - fit.reference[1] if fit.reference_temperature is not None else 0.0
    values = {
        "G": np.exp(thetas[:, 0]),
        "tau": np.exp(thetas[:, 1]),
        "f0": fit.reference[0] + thetas[:, 2] + drift * thetas[:, 3],
        "k_T": thetas[:, 3],
        **dict(zip(FINGER, thetas[:, 4:].T, strict=True)),
    }
    return {n: values[n].reshape(shape) for n in names}
