"""Ridges of the likelihood that no normal follows: curved ones, and those that fall to one side more slowly.

Amplitudes at a single frequency are curved along f0:

    |W| = G V/sqrt(1 + x^2),   x = 2 pi (f - f0) tau

An amplitude at one frequency depends on x^2, and so do G and tau along the ridge of the likelihood. Near x =
0 no normal has this shape: there J^T J says nothing about f0, and takes the noise in its derivative for
information on the other parameters. So the ridge is followed: everything else is fitted anew with f0 held at
several places, until the cost has risen by DEEP. Each place gives one normal of a mixture.

Two sweeps whose temperatures hardly differ give k_T = df/(dT + what the thermometers are off), which has a
long tail where the divisor may be small. That ridge is straight, and its places differ in what they weigh.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.images import as_settled
from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import Prior
from sysid.model.span import inverted
from sysid.model.theta import NAMES
from sysid.trials.perturbed import LogResponse
from sysid.trials.rounds import Rounds
from sysid.trials.trial import Trial

F0 = NAMES.index("f0")
VAGUE = 0.25  # half bandwidths: f0 is vague if its first-order standard deviation is larger
BENT = 2.0  # of these standard deviations: half of h beyond this shows that they are far too small
RISE = 2.0  # of the cost: two standard deviations
NEAR, FAR = 0.02, 8.0  # half bandwidths between which the rise is looked for
GAINED = 0.1  # of the cost: a minimum at the f0 of a state is the state if it gains no more
WELL = 5.0  # of the cost: a ridge that rises less than this as far as FAR holds more of the posterior
CLOSE = 0.1  # of the rise, to which it is found: the distance goes with its root or less, and is known to 5 %
NARROW = 1.1  # a factor between two distances that are as good as one
FURTHER, TINY = 8.0, 1e-9  # times as far is looked next; of the furthest, where nobody looks any more
HELD = 1e-4  # half bandwidths to which f0 is held, and standard deviations to which another parameter is
STEP = 0.5  # standard deviations from place to place on a ridge, and of the normal at each
DEEP = 12.5  # rise of the cost at which a ridge ends: five standard deviations
MOST = 40  # places on one side of a minimum


def bent(minimiser: Minimiser, state: State) -> bool:
    """Whether all information on f0 comes from amplitudes at one frequency each."""
    if "f0" not in minimiser.free or "k_T" in minimiser.free:
        return False
    told = [t for t in state.trials if t.resonant and t.driven]
    return bool(told) and all(t.log.amplitude_only and np.ptp(t.log.frequency) == 0 for t in told)


def unfolded(minimiser: Minimiser, state: State) -> State:
    """The state with a covariance as wide as the likelihood, where f0 is vague and the ridge is bent:

        std f0 = h/2,   covariance = that with f0 held + (std/h)^2 s s^T + 2 (std/h)^4 d d^T

    h is the distance at which the cost has risen by RISE, at most FAR, as an amplitude that had settled and
    then rings down is the same at any x. s is the part of theta's move to +-h that is odd in x, d the part
    that is even. (A fourth power that rises by 2 at h has a standard deviation of 0.489 h; for a normal x the
    variance of x^2 is 2 std^4.)
    """
    first, begun = float(np.sqrt(state.covariance[F0, F0])), _begun(state)
    told = first < VAGUE * state.half_bandwidth
    if not bent(minimiser, state) or (told and not begun):
        return state
    middle = _held(minimiser, state, F0, state.theta[F0], state.theta)
    h, (above, below) = _rises(minimiser, state, middle.cost)
    # On a ridge a step may be long and gain nothing: what is left to gain tells better.
    state = replace(state, converged=state.converged or abs(state.cost - middle.cost) < GAINED)
    if told and 0.5 * h < BENT * first:
        return state
    along, across = 0.5 * (above - below), 0.5 * (above + below) - middle.theta
    if begun and h == FAR * state.half_bandwidth:  # G goes with sqrt(1 + x^2) there
        along[0] = 0.5 * np.log1p(FAR**2)
    covariance = middle.covariance + np.outer(along, along) / 4 + np.outer(across, across) / 8
    return replace(state, covariance=covariance, alone=covariance)


def along(minimiser: Minimiser, modes: Sequence[State], name: str) -> list[State]:
    """The places on the ridges through the minima along a parameter: states with it held, whose covariances
    reach the neighbouring places."""
    least, k = min(s.cost for s in modes), NAMES.index(name)
    ridges: list[list[State]] = []
    for mode in modes:
        if any(_near(ridge, mode, k) for ridge in ridges):
            continue
        middle = _held(minimiser, mode, k, mode.theta[k], mode.theta)
        step = float(np.sqrt(mode.covariance[k, k]))
        if k == F0 and bent(minimiser, mode):
            step = min(step, 0.5 * _rises(minimiser, mode, middle.cost)[0])
        step *= STEP
        sides = [_followed(minimiser, mode, k, sign * step, least) for sign in (-1, 1)]
        places = [*sides[0][::-1], middle, *sides[1]]
        tangents = np.gradient([s.theta for s in places], step, axis=0)
        wide = (s.covariance + step**2 * np.outer(v, v) for s, v in zip(places, tangents, strict=True))
        ridges.append([replace(s, covariance=c) for s, c in zip(places, wide, strict=True)])
    return [s for ridge in ridges for s in ridge]


def _near(ridge: Sequence[State], mode: State, k: int) -> bool:
    """Whether a minimum is on a ridge along the k-th parameter."""
    place = min(ridge, key=lambda s: abs(s.theta[k] - mode.theta[k]))
    off = mode.theta - place.theta
    return bool(0.5 * off @ inverted(place.covariance) @ off < RISE)


def _followed(minimiser: Minimiser, mode: State, k: int, step: float, least: float) -> list[State]:
    """The places on one side of a minimum."""
    places = [mode]
    while len(places) <= MOST and places[-1].cost < least + DEEP:
        places.append(_held(minimiser, mode, k, mode.theta[k] + len(places) * step, places[-1].theta))
    return places[1:]


def _begun(state: State) -> list[Trial]:
    """Amplitudes driven at their first row; the phase of their start is not seen."""
    return [t for t in state.trials if t.begun]


def _held(minimiser: Minimiser, mode: State, k: int, value: float, near: np.ndarray) -> State:
    """The minimum near a theta with its k-th parameter held there; it starts from the noise of `mode`, so
    that costs compare."""
    precision, mean = np.zeros((len(NAMES), len(NAMES))), near.copy()
    width = mode.half_bandwidth if k == F0 else float(np.sqrt(mode.covariance[k, k]))
    precision[k, k], mean[k] = (HELD * width) ** -2, value
    both = minimiser.prior.precision + precision
    pull = minimiser.prior.precision @ minimiser.prior.mean + precision @ mean
    prior = Prior(np.linalg.lstsq(both, pull, rcond=None)[0], both)
    held, begun = replace(minimiser, prior=prior), _begun(mode)
    found = held.refine(mode.trials, mean, Rounds(1))
    if not begun or found.cost < mode.cost + RISE:
        return found
    # As well with the gain that a settled response has there.
    sizes = [abs(LogResponse.of(begun[0], minimiser.reference, theta).free[0]) for theta in (near, mean)]
    other = held.refine(*as_settled(mode.trials, mean, sizes[0] / sizes[1]), Rounds(1))
    return min(found, other, key=lambda s: s.cost)


def _rises(minimiser: Minimiser, mode: State, least: float) -> tuple[float, list[np.ndarray]]:
    """How far f0 can go (Hz), at most FAR, until the mean cost of both sides has risen by RISE; and theta
    above and below. Where the start's phase is not seen, there are minima side by side: then each side has to
    rise."""

    def both(off: float) -> tuple[float, list[np.ndarray]]:
        sides = [_held(minimiser, mode, F0, mode.theta[F0] + sign * off, mode.theta) for sign in (1, -1)]
        cost = (min if _begun(mode) else np.mean)([s.cost for s in sides])
        return float(cost) - least, [s.theta for s in sides]

    far = FAR * mode.half_bandwidth
    if _begun(mode) and (furthest := both(far))[0] < WELL:
        return far, furthest[1]
    return risen(both, NEAR * mode.half_bandwidth, far)


def risen(
    cost: Callable[[float], tuple[float, list[np.ndarray]]], off: float, far: float
) -> tuple[float, list[np.ndarray]]:
    """The distance at which a `cost` has risen by RISE, at most `far`, looked for from `off` on; and what
    else it has there."""
    low, below, high, above = 0.0, 0.0, far, None
    while True:
        rise, thetas = cost(off)
        low, below, high, above = (off, rise, high, above) if rise < RISE else (low, below, off, rise)
        if abs(rise - RISE) < CLOSE * RISE or high < NARROW * low or high < TINY * far:
            return off, thetas
        off = _between(low, below, high, above)


def _between(low: float, below: float, high: float, above: float | None) -> float:
    """Where a cost that rises as a power of the distance may have risen by RISE: between two distances at
    which it has risen `below` and `above` that, further out where the latter is not known yet, and nearer
    where no distance below is; halfway where a cost is no number to go by."""
    if low == 0:
        return high / FURTHER
    if above is None:
        return min(FURTHER * low, high)
    numbers = below > 0 and np.isfinite(above)
    share = np.log(RISE / below) / np.log(above / below) if numbers else 0.5
    return float(low * (high / low) ** np.clip(share, 0.25, 0.75))  # no end stays for long
