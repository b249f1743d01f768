"""Minima of the cost, from the likeliest starting points; the noise of each log is estimated from its
residual along the way."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.minimum.descent import DONE, GaussNewton, levenberg_marquardt, prepare
from sysid.minimum.images import images
from sysid.minimum.search import SEARCH_ROWS, Search
from sysid.minimum.start import joint, local
from sysid.model.experiment import Residual
from sysid.model.plant import LOW_Q, Plant
from sysid.model.prior import FLAT, Prior
from sysid.model.theta import FINGER, NAMES, Theta
from sysid.precision import makes_beside
from sysid.trials import jitter, mixed
from sysid.trials.experiment import group
from sysid.trials.perturbed import LogResponse
from sysid.trials.renew import update
from sysid.trials.rounds import Rounds
from sysid.trials.trial import LEAST_WARMING, Trial, freedom, numbers_taken, warmed, with_noise

log = logging.getLogger(__name__)
NEAR = 0.1  # of a sum of squares in units of the noise: a third of a standard deviation
SHORT = 0.3  # of a factor e in G and tau, of a half bandwidth in f0: longer Newton steps are not trusted
# relative to the largest information along a direction: added to all, so that none is singular
ROUNDING = 1e-28
ROUNDED = 1e-12  # change of the noise, and of a sum of squares, that is only rounding
STARTS = 4
NEW = Rounds()  # for logs of whose noise nothing is known
ESTIMATED = Rounds(known=1)  # for logs whose noise was estimated at a minimum nearby
RUNAWAY = 9.0  # change of log tau in one search, a factor of 8000, that no start from the data needs
MODES = 8.0  # log-likelihood within which a second minimum counts as a mode
ALL = 1e100  # of noise: what nobody misses
SHARE = 0.9  # of a log's degrees of freedom that the plant takes at most
RIPPLES = 9.0  # log-likelihood, less than which none of sixty things shows beyond chance (`verdict.misfit`)


@dataclass(frozen=True)
class State:
    """A converged minimum: theta as in `model.theta`, the likelihood's covariance, and the trials
    with their noise and nuisances. `dispersion`: what logs that differ by more than their errors add to it
    (`verdict.differing`)."""

    theta: np.ndarray
    covariance: np.ndarray
    trials: tuple[Trial, ...]
    models: tuple[np.ndarray, ...] = field(repr=False)  # modelled rows of each trial
    cost: float
    volume: float  # of the logs' nuisances, as `model.experiment.Residual` has it
    converged: bool
    low_q: bool  # with the ripple of the fast mode
    alone: np.ndarray = field(repr=False)  # the covariance of the logs alone, without the prior
    prior: Prior = field(default=FLAT, repr=False)
    dispersion: np.ndarray = field(default_factory=lambda: np.zeros((len(NAMES), len(NAMES))), repr=False)

    @property
    def spread(self) -> np.ndarray:
        """(6, 6) covariance of the estimate: the likelihood's, and what logs that differ add."""
        return self.covariance + self.dispersion

    @property
    def named(self) -> Theta:
        """theta by name."""
        return Theta.of(self.theta)

    @property
    def G(self) -> float:
        """Response per drive."""
        return float(np.exp(self.named.log_G))

    @property
    def tau(self) -> float:
        """Time constant, s."""
        return float(np.exp(self.named.log_tau))

    @property
    def half_bandwidth(self) -> float:
        """1/(2 pi tau), Hz."""
        return 1 / (2 * np.pi * self.tau)

    @property
    def likelihood(self) -> float:
        """Log-likelihood of the logs, every number of theirs at its optimum, up to a constant of the same
        logs in the same unit. By its difference descriptions with other nuisances compare, whatever the
        units: `cost` counts each number that a description leaves to a log by the logarithm of its noise, in
        the unit of the response."""
        return -self.cost - sum(numbers_taken(t) * float(np.log(t.noise.std)) for t in self.trials)

    @property
    def evidence(self) -> float:
        """Log of the posterior mass about this minimum (Laplace), up to a constant of the logs."""
        bounded = np.diag(self.covariance) > 0
        return (
            0.5 * float(np.linalg.slogdet(self.covariance[np.ix_(bounded, bounded)])[1])
            - self.volume
            - self.cost
        )


def shares(states: Sequence[State]) -> np.ndarray:
    """(n,) share of the posterior about each of its minima."""
    evidence = np.array([s.evidence for s in states])
    weight = np.exp(evidence - evidence.max())
    return weight / weight.sum()


def rippling(state: State, q: float) -> float:
    """What the fast mode's ripple may be worth, in log-likelihood: it rings with 1/(4 Q) of what the response
    changes by for about tau after each change of the drive."""
    worth = 0.0
    for t in (t for t in state.trials if t.ripples):
        most = max(np.abs(t.inputs.drive).max(), 1e-300)  # an effect may leave no drive at all
        changes = np.sum(np.abs(np.diff(t.inputs.drive, prepend=0.0) / most) ** 2)
        rows = min(changes * state.tau / t.spacing, len(t.log)) if t.spacing else len(t.log)
        share = min(t.scale / (4 * max(q * t.noise.std, 1e-300)), ALL)  # of a step that went astray q is none
        worth += 0.5 * rows * share**2
    return worth


def hopeful(state: State, cost: float) -> bool:
    """Whether a minimum by a first estimate of the noise is not far above another's cost, but for what it may
    gain if the noise turns out to be coloured."""
    searched = sum(min(freedom(t), 2 * SEARCH_ROWS) for t in state.trials)
    return state.cost <= cost + 10 * MODES + 0.05 * searched


@dataclass(frozen=True)
class Minimiser:
    """The search for minima in the parameters `free`; `reference` (Hz, degC) is where theta's offsets are
    taken from. `plain`: with numpy alone, as where many layouts of logs are looked at a few times each, whose
    programs would take longer to compile."""

    reference: tuple[float, float]
    free: tuple[str, ...]
    prior: Prior = FLAT
    plain: bool = False

    def beside(self, trials: Sequence[Trial]) -> "Minimiser":
        """The search for what some of the logs tell beside the others: of logs at one temperature k_T is what
        the others tell."""
        if warmed(trials) > LEAST_WARMING:
            return self
        return replace(self, free=tuple(n for n in self.free if n != "k_T"))

    def minima(self, trials: tuple[Trial, ...], start: Plant | None = None) -> list[State]:
        """Minima of the cost, the best first, from the likeliest starting points, or from `start`."""
        return self.distinct(self.roughly(trials, start))

    def roughly(self, trials: tuple[Trial, ...], start: Plant | None = None) -> list[State]:
        """What those starting points lead to, the best first, by a first estimate of the noise."""
        self.prepare(trials, np.zeros(len(NAMES)))  # while starting points are looked for
        log.info("where to start")
        search = Search(trials, (self._frequency, self.reference[1]))
        points, score, cost = self._starts(search, start)
        level = 0.05 * np.sqrt(np.where(np.isfinite(cost), cost, 1.0) / search.freedom)
        trials = tuple(with_noise(t, s * t.scale, 0.0) for t, s in zip(trials, level, strict=True))
        points[:, 1] *= "f0" in self.free  # else all are driven at the resonance
        untouched = np.zeros((len(points), len(FINGER)))
        starts = np.column_stack([_log_gains(search, points), points, untouched])
        # what an amplitude began with is found with the plant
        rounds = Rounds(4 if any(t.begun for t in trials) else 1)
        log.info("start 1 of %d", len(starts))
        found = [self.refine(trials, starts[0], rounds)]
        reached = search.score(found[0].theta[None, 1:4], cost)[0]
        # A start that is far worse than where the best one ended leads nowhere new; where the ends differ,
        # all are tried.
        for k, (theta, short) in enumerate(zip(starts[1:], score[1:], strict=True), 2):
            if short < reached + 10 * MODES or reached > 0.25 * search.freedom.sum():
                log.info("start %d of %d", k, len(starts))
                found.append(self.refine(trials, theta, rounds))
        found.sort(key=lambda s: s.cost)
        found = sorted([*found, *self._images(found, rounds)], key=lambda s: s.cost)
        return [s for s in found if hopeful(s, found[0].cost)]

    def imaged(self, states: Sequence[State]) -> list[State]:
        """The minima and the images of the best of them, the best first, as far as they count as modes: for
        whoever changed what the logs are behind or what of the bench is fitted, as an image may then be where
        none was."""
        log.info("mirror images of the minimum")
        best = sorted(states, key=lambda s: s.cost)
        more = self._images(best, NEW)
        return self.distinct([*best, *more]) if more else [s for s in best if s.cost <= best[0].cost + MODES]

    def _images(self, found: Sequence[State], rounds: Rounds) -> list[State]:
        """Mirror images of the best minimum that are not among `found`."""
        latest, every, drifts = list(found[:1]), list(found), "k_T" in self.free
        for _ in range(2):  # an image of an image is on the other side of two drives
            begins = [begin for s in latest for begin in images(s.trials, s.theta, self.reference, drifts)]
            latest = [self.refine(*begin, rounds) for begin in begins]
            latest = [
                s
                for s in latest
                if s.cost < found[0].cost + 10 * MODES and all(self._apart(s, f) for f in every)
            ]
            every += latest
        return every[len(found) :]

    def prepare(self, trials: tuple[Trial, ...], theta: np.ndarray, low_q: bool = False) -> None:
        """Begin to make the programs of a search from theta, where that goes on beside."""
        if makes_beside() and not self.plain:
            prepare(group(trials, self.reference, low_q=low_q)[0], theta, self._directions(theta))

    def refine(
        self, trials: tuple[Trial, ...], theta: np.ndarray, rounds: Rounds = NEW, low_q: bool | None = None
    ) -> State:
        """The minimum near `theta`; where the fast mode's ripple may be seen the better of that with it and
        that without, as behind a lock-in that removes it, unless `low_q` says which."""
        if low_q is not None or not any(t.ripples for t in trials):
            return self._descend(trials, theta, bool(low_q), rounds)
        state = self._descend(trials, theta, self._q(theta) < LOW_Q, rounds)
        if not state.low_q and rippling(state, self._q(state.theta)) < RIPPLES:
            return state
        other = self._descend(trials, state.theta, not state.low_q, rounds)
        return min(state, other, key=lambda s: (not s.converged, s.cost))

    def onward(self, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
        """theta after a step (6,), or as it is where the step is too long to trust."""
        directions = self._directions(theta)
        length = np.max(np.abs(directions.T @ step) / np.sum(directions**2, axis=0))
        return theta + step if length < SHORT else theta

    def _descend(self, trials: tuple[Trial, ...], theta: np.ndarray, low_q: bool, rounds: Rounds) -> State:
        """Minimise, re-estimate each log's noise from its residual, and repeat until nothing changes.

        Once a Gauss-Newton step is short and changes the sum of squares by less than NEAR, single steps
        replace the search.
        """
        steps, last, converged, unmoved, begin = GaussNewton(), np.inf, False, False, theta
        if all(t.silent for t in trials):
            return self._unbounded(trials, begin, low_q)
        k = rounds.known
        for _ in range(2 * rounds.most):
            before, directions = (theta, trials), self._directions(theta)
            first, far = (theta, rounds.steps) if steps.next is None else (theta + steps.next, 0)
            if not unmoved:  # else what was seen stands
                groups, members = group(trials, self.reference, low_q=low_q)
                seen = levenberg_marquardt(groups, first, directions, far, self.prior, self.plain)
                theta = seen.theta
            if _ran_away(theta, begin):
                return self._unbounded(trials, begin, low_q)
            gradient, inverse = seen.sums.gradient, _invert(seen.sums.gram)
            left, newton = float(gradient @ inverse @ gradient), -inverse @ gradient
            whole = directions @ newton if left <= NEAR and np.max(np.abs(newton)) < SHORT else None
            if steps.taken_back(left, whole):
                theta, trials = before
                continue
            courses = [LogResponse.of(t, self.reference, theta) for t in trials]
            trials, models, cost, moved = update(trials, members, seen.found, courses, k, rounds.white)
            cost += float(self.prior.cost(theta))
            steps.kept(left, whole, moved)
            change, last, k, unmoved = abs(last - cost), cost, k + 1, max(moved, left) < ROUNDED
            # Where a derivative vanishes, `left` counts what no step gains: a search that goes nowhere tells.
            lowest = left < NEAR or bool(far and np.isfinite(left) and np.array_equal(theta, first))
            converged = bool(moved < 0.02 and change < 1e-3 + 1e-9 * abs(cost) and lowest)
            if k == rounds.most or (
                converged and max(change, 0.0 if whole is None else left) < DONE + 1e-13 * abs(cost)
            ):
                break
        if rounds.known:
            jitters = map(jitter.found, trials, models, courses)
            shares = map(mixed.efficiency, trials, models, courses)
            trials = tuple(
                t.in_noise(replace(t.noise, jitter=j, slow=share))
                for t, j, share in zip(trials, jitters, shares, strict=True)
            )
        held, freedom = np.concatenate(seen.grams), np.concatenate([x.freedom for _, x in groups])
        told = np.array([trials[i].noise.told for logs in members for i in logs])
        information = _informed(freedom, told[:, None, None] * held, inverse)
        alone, covariance = self._covariances(information, directions)
        at = theta, covariance, trials, models, float(cost), _volume(seen.found)
        return State(*at, converged, low_q, alone, self.prior)

    def _covariances(self, information: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(6, 6) of theta: from the logs alone, whose information along the directions is given, and with the
        prior."""
        alone = directions @ _invert(information) @ directions.T
        if not np.any(self.prior.precision):
            return alone, alone
        held = directions.T @ self.prior.precision @ directions
        return alone, directions @ _invert(information + held) @ directions.T

    def _unbounded(self, trials: tuple[Trial, ...], theta: np.ndarray, low_q: bool) -> State:
        """The state where the search began, for logs that do not bound tau: any tau far from it fits as
        well."""
        groups, members = group(trials, self.reference, low_q=low_q)
        directions = self._directions(theta)
        found = levenberg_marquardt(groups, theta, directions, 0, self.prior, self.plain).found
        courses = [LogResponse.of(t, self.reference, theta) for t in trials]
        trials, models, cost, _ = update(trials, members, found, courses, round_=0)
        alone, covariance = self._covariances(np.eye(directions.shape[1]) / RUNAWAY**2, directions)
        cost = cost if np.isfinite(cost) else 0.0
        return State(theta, covariance, trials, models, cost, _volume(found), True, low_q, alone, self.prior)

    def _starts(self, search: Search, start: Plant | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (n, 3), the log-likelihood by which each falls short, and the least residual sum of each
        log."""
        if start is not None:
            f0 = 0.0 if start.f0 is None else start.f0 - self.reference[0]
            k_T = start.k_T or 0.0
            shift = f0 + k_T * (self.reference[1] - start.reference_temperature)
            points = np.array([[np.log(start.tau), shift, k_T]])
            return points, np.zeros(1), search.sums(points)[0]
        best, cost = local(search, np.random.default_rng(0))
        points, score = joint(search, best, cost, "k_T" in self.free)
        return *_spread(points, score), cost

    def distinct(self, found: Sequence[State]) -> list[State]:
        """The minima that `found` lead to, each once, as far as they count as modes."""
        states: list[State] = []
        for k, first in enumerate(found):
            if any(not self._apart(first, other) for other in (*states, *found[:k])):
                continue
            state = self.refine(first.trials, first.theta, ESTIMATED)
            if all(self._apart(state, other) for other in states):
                states.append(state)
        states.sort(key=lambda s: s.cost)
        return [s for s in states if s.cost <= states[0].cost + MODES]

    def _apart(self, state: State, other: State) -> bool:
        index = [NAMES.index(n) for n in self.free]
        step = (state.theta - other.theta)[index]
        spread = np.sqrt(np.diag(state.covariance)[index] + np.diag(other.covariance)[index])
        return bool(np.any(np.abs(step) > 0.5 * spread + 1e-9))

    def _directions(self, theta: np.ndarray) -> np.ndarray:
        """(6, free) unit steps in theta: a factor e in G and tau; a half bandwidth in f0; a tenth of one per
        degC; for a finger the plate's own damping and a half bandwidth."""
        half_bandwidth = 1 / (2 * np.pi * np.exp(Theta.of(theta).log_tau))
        size = [1.0, 1.0, half_bandwidth, 0.1 * half_bandwidth, 1.0, half_bandwidth]
        return np.diag(size)[:, [NAMES.index(n) for n in self.free]]

    @property
    def _frequency(self) -> float:
        return self.reference[0] if np.isfinite(self.reference[0]) else 0.0

    def _q(self, theta: np.ndarray) -> float:
        at = Theta.of(theta)
        return float(np.pi * max(self.reference[0] + at.f0, 1e-300) * np.exp(at.log_tau))


def _spread(points: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first few points, with their scores, that differ by half a bandwidth or a factor of two in tau from
    all before them."""
    kept: list[int] = []
    for i, p in enumerate(points):
        half_bandwidth = 1 / (2 * np.pi * np.exp(p[0]))
        scale = np.array([0.7, 0.5 * half_bandwidth, 0.1 * half_bandwidth])
        if all(np.any(np.abs(p - points[k]) > scale) for k in kept):
            kept.append(i)
        if len(kept) == STARTS:
            break
    return points[kept], score[kept]


def _log_gains(search: Search, points: np.ndarray) -> list[float]:
    """Log of the median gain of the driven logs at each point."""
    driven = np.array([t.driven for t in search.trials])
    gains = [row[driven & np.isfinite(row) & (row > 0)] for row in search(points)[1]]
    return [float(np.log(np.median(g))) if len(g) else 0.0 for g in gains]


def _ran_away(theta: np.ndarray, begin: np.ndarray) -> bool:
    return not (np.all(np.isfinite(theta)) and abs(Theta.of(theta - begin).log_tau) < RUNAWAY)


def _volume(found: Sequence[Residual]) -> float:
    """Volume of the nuisances of all logs."""
    return float(sum(np.sum(x.volume) for x in found))


def _invert(gram: np.ndarray) -> np.ndarray:
    """Inverse of an information matrix; where it holds no information the variance becomes very large, not
    infinite."""
    gram = gram + ROUNDING * np.max(np.diag(gram)) * np.eye(len(gram))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    values, vectors = np.linalg.eigh(np.nan_to_num(gram / np.outer(size, size)))
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
    return inverse / np.outer(size, size)


def _informed(freedom: np.ndarray, grams: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Information of all logs, from (logs, p, p), each less the share of its residual that the plant's
    parameters have absorbed.

    The noise is that of the largest likelihood, S/freedom; a log of leverage tr(gram inverse) has that many
    degrees fewer.
    """
    leverage = np.einsum("lpq,pq->l", grams, inverse)
    left = 1 - np.minimum(leverage / np.maximum(freedom, 1.0), SHARE)
    return np.einsum("l,lpq->pq", left, grams)
