"""Markov chains of the posterior: emcee over the compiled density, proposals from the mixture about the fit's
own minima."""

import logging
from collections.abc import Iterator
from time import perf_counter

import emcee
import numpy as np

from sysid.posterior.diagnostics import ess, rhat
from sysid.posterior.mixture import Mixture
from sysid.posterior.target import Target

log = logging.getLogger(__name__)
WALKERS = 8
AGREED = 1.01  # split R-hat
# steps: the walkers begin as draws of the proposal, an independence chain forgets them at its first accepted
# step
BURN = 4
FIRST, LEAST = 150, 16  # steps before the first look at the criteria, and before any other
ROUNDS = 100
# draws for an effective one: a chain that takes more is stuck, and rounds that double would go on for hours
MOST = 100


class _Independence(emcee.moves.Move):
    """Independence Metropolis of all walkers. Proposals do not depend on where the walkers are, so those of
    many steps are evaluated together beforehand and kept: z, the target's log density and the proposal's."""

    def __init__(self, proposal: Mixture, target: Target, rng: np.random.Generator):
        self.proposal, self.target, self.rng = proposal, target, rng
        self.ahead: Iterator[tuple[np.ndarray, ...]] = iter(())
        self.seen: list[tuple[np.ndarray, ...]] = []
        self.now: np.ndarray | None = None  # of each walker, the proposal's log density where it is

    def prepare(self, steps: int) -> None:
        """Draw and evaluate what the next `steps` will propose."""
        z = self.proposal.draw(steps * WALKERS, self.rng)
        self.seen.append((z, self.target(z), self.proposal.log_density(z)))
        self.ahead = zip(*(x.reshape(steps, WALKERS, *x.shape[1:]) for x in self.seen[-1]), strict=True)

    def propose(self, model, state):
        z, log_density, proposed = next(self.ahead)
        now = self.proposal.log_density(state.coords) if self.now is None else self.now
        rise = log_density - state.log_prob + now - proposed
        accepted = np.log(model.random.rand(WALKERS)) < rise
        self.now = np.where(accepted, proposed, now)
        return self.update(state, emcee.State(z, log_prob=log_density), accepted), accepted


class Chain:
    """Walkers that continue until they hold enough effective draws. The same seed gives the same draws."""

    def __init__(self, target: Target, proposal: Mixture, seed: int):
        rng = np.random.default_rng(seed)
        dimension = len(target.index)
        self._move = _Independence(proposal, target, rng)
        self._sampler = emcee.EnsembleSampler(WALKERS, dimension, target, moves=self._move, vectorize=True)
        # emcee accepts by the legacy generator and takes its state from numpy's global one unless told
        # otherwise.
        self._state = emcee.State(
            proposal.draw(WALKERS, rng), random_state=np.random.RandomState(seed).get_state()
        )
        self.target, self.ess, self.rhat = target, 0.0, np.inf

    def extend(self, effective: float, rounds: int = ROUNDS, until: float = np.inf) -> bool:
        """Continue in rounds until every determined parameter has `effective` draws and an R-hat below
        AGREED, for `rounds`, or until it takes more than MOST draws for one.

        False where the next round would have ended after `until` (perf_counter) and was not begun.
        """
        for _ in range(rounds):
            if self.reached(effective) or self._sampler.iteration * WALKERS > MOST * min(self.ess, effective):
                break
            done = self._sampler.iteration
            short = 1.05 * done * (effective / max(self.ess, 1.0) - 1.0)  # steps, at the rate seen so far
            steps = int(np.clip(short, LEAST, done)) if done else FIRST
            if until < np.inf and perf_counter() + steps * WALKERS * self.target.pace > until:
                return False
            log.info("%.0f of %g effective draws", self.ess, effective)
            self._move.prepare(steps)
            self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)
            told = self._told()
            self.ess, self.rhat = float(min(map(ess, told))), float(max(map(rhat, told)))
        return True

    def _told(self) -> list[np.ndarray]:
        """(chain, draw) of each parameter that the criteria are about: those that are determined, if any are.
        One that cannot be had anyway, whose tails may be long, is no reason to have nothing."""
        z = self.draws()
        draws = self.target.parameters(z.reshape(-1, z.shape[-1]))
        known = [n for n in draws if self.target.fit.parameters[n].determined] or list(draws)
        return [draws[n].reshape(z.shape[:2]) for n in known]

    def reached(self, effective: float) -> bool:
        """Whether the criteria hold."""
        return self.ess >= effective and self.rhat < AGREED

    def draws(self) -> np.ndarray:
        """(chain, draw, parameter) in z."""
        return np.swapaxes(self._sampler.get_chain(discard=BURN), 0, 1)

    def log_density(self) -> np.ndarray:
        """(chain, draw) of the draws."""
        return np.swapaxes(self._sampler.get_log_prob(discard=BURN), 0, 1)

    def proposed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All proposals z (n, p), the target's log density and the proposal's at them."""
        z, density, proposed = (np.concatenate(part) for part in zip(*self._move.seen, strict=True))
        return z, density, proposed
