"""Parameters that a single reading decides: nothing in the logs shows whether that reading is right.

Of points many half bandwidths apart, at most one shows the peak, and tau and G are whatever makes the model
pass through it. Its residual is zero whatever it reads, its noise is that of the other rows only by
assumption, and a spike, a point that had not settled or a line that is not Lorentzian look like another tau.
The covariance without the rows R of one reading follows from the fit of all (Cook & Weisberg, Residuals and
Influence in Regression, 1982, 2.2). With the whitened Jacobian X of everything fitted and C = (X'X)^-1,

    C(-R) = C + C X_R' (1 - H_R)^-1 X_R C,        H_R = X_R C X_R'

A reading decides a parameter if without it the variance would be DECIDES times as large, and too large for
the parameter to be determined.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import State
from sysid.model.theta import NAMES, POSITIVE, carried
from sysid.trials.noise import ODD, goes_with
from sysid.trials.trial import Trial, with_noise
from sysid.verdict import identify
from sysid.verdict.linearised import LinearisedLog

# Of two readings that tell alike one leaves twice the variance. At ten times the others hold a tenth of what
# is known, and contradict a reading that is wrong only from ten of the stated errors on, three of theirs.
DECIDES = 10.0
LEAST = 1e-12  # of 1 - H_R, less than which is rounding: the reading alone holds something up
ACROSS = 1.0  # half bandwidths on both sides of f0, across which ten points show the peak


def resting(
    state: State,
    reference: tuple[float, float],
    free: Sequence[str],
    at: float | None,
    views: Sequence[LinearisedLog] | None = None,
) -> dict[str, str]:
    """Why a parameter of `free` is not determined though its interval is narrow: one reading decides it. `at`
    (degC): where f0 is reported; `views`: of the logs at that minimum, where they are made."""
    told = [n for n in free if _error(state, n, reference, at) <= _limit(state, n)]
    if not told or not state.converged or all(t.silent for t in state.trials):
        return {}
    each = views or LinearisedLog.each(state, reference)
    views = [_on_a_floor(_in_even_noise(view, state)) for view in each]
    shown = np.stack([_along(n, reference, at) for n in told])
    grown, errors = _without_one(views, shown, [NAMES.index(n) for n in free])
    said = {}
    for k, name in enumerate(told):
        i = int(np.argmax([np.max(g[:, k], initial=1.0) for g in grown]))
        row = int(np.argmax(grown[i][:, k])) if len(grown[i]) else 0
        ratio = float(np.max(grown[i][:, k], initial=1.0))
        if ratio > DECIDES and np.sqrt(ratio) * errors[k] > _limit(state, name):
            trial = state.trials[i]
            said[name] = _said(
                name, trial, int(np.arange(len(trial.log))[trial.noise.used][row]), state, reference
            )
    return said


def _in_even_noise(view: LinearisedLog, state: State) -> LinearisedLog:
    """A sweep of which no drive is recorded in noise that is alike in all rows, where it was only taken for
    one that scatters as it is large, as a mean of periodograms does: so it is with a drive."""
    trial = view.trial
    known = trial.noise.stated is not None or trial.log.relative_noise
    if known or not (trial.undriven_sweep and trial.noise.share):
        return view
    left, size = (np.abs(v)[trial.noise.used] for v in (view.residual, view.model))
    if goes_with(left, size / trial.scale) > ODD:
        return view
    noise = replace(trial.noise, share=0.0, spread=None)
    even = with_noise(trial.in_noise(noise), float(np.sqrt(np.mean(left**2))), 0.0)
    return LinearisedLog(even, view.model, state, view.reference)


def _on_a_floor(view: LinearisedLog) -> LinearisedLog:
    """The amplitudes of a driven sweep on a floor that is as free as in one without a drive: whether a
    reading decides does not hang on a drive that somebody wrote down."""
    trial, under = view.trial, view.trial.bench.under
    if not trial.steady or trial.signed or under is None:
        return view
    freed, loose = copy(view), trial.looseness**2 / float(np.max(under))
    freed.columns = [c._replace(prior=loose) if c.name == "floor" else c for c in view.columns]
    for name in ("basis", "recorded", "r", "jacobian"):
        freed.__dict__.pop(name, None)
    return freed


def _without_one(
    views: Sequence[LinearisedLog], shown: np.ndarray, index: Sequence[int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Of each log (n, k): by what the variance of each of `shown` (k, 6), combinations of theta, of which
    `index` is free, grows without one reading; 1 of a mean of several. And the standard deviation (k,) with
    all of them."""
    jacobians = [v.jacobian[:, index] for v in views]
    gram = sum(j.T @ j for j in jacobians)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    half = vectors / np.sqrt(np.where(values > LEAST, values, np.inf)) / size[:, None]  # C = half half'
    along = half.T @ shown[:, index].T
    errors = np.sqrt(np.sum(along**2, axis=0))
    return [_of_one(v, j @ half, along) for v, j in zip(views, jacobians, strict=True)], errors


def _of_one(view: LinearisedLog, white: np.ndarray, along: np.ndarray) -> np.ndarray:
    """(n, k) of one log. Its Jacobian, less what its nuisances make of it, is `white` (rows, p), of
    parameters of unit variance; `along` (p, k): the sums of these that are shown."""
    n, channels = view.n, 2 if np.iscomplexobj(view.residual) else 1
    rows = np.arange(n)[:, None] + n * np.arange(channels)  # of each reading
    hat = np.concatenate([view.basis, white], axis=1)[rows]
    values, vectors = np.linalg.eigh(np.eye(channels) - hat @ hat.transpose(0, 2, 1))
    pulls = vectors.transpose(0, 2, 1) @ (white[rows] @ along)
    grown = 1 + np.sum(pulls**2 / np.maximum(values, LEAST)[:, :, None], axis=1) / np.maximum(
        np.sum(along**2, axis=0), 1e-300
    )
    return np.where(view.trial.noise.count[view.trial.noise.used][:, None] > 1, 1.0, grown)


def _along(name: str, reference: tuple[float, float], at: float | None) -> np.ndarray:
    """(6,) the parameter as it is reported, to first order in theta (of G and tau the logarithm)."""
    return carried(0.0 if at is None else at - reference[1])[NAMES.index(name)]


def _error(state: State, name: str, reference: tuple[float, float], at: float | None) -> float:
    """Standard deviation of the parameter as it is reported; of G and tau relative."""
    row = _along(name, reference, at)
    return float(np.sqrt(row @ state.alone @ row))


def _limit(state: State, name: str) -> float:
    """Largest such one with which it is determined."""
    return identify.limits(1.0, 1.0)[name] if name in POSITIVE else identify.limits(1.0, state.tau)[name]


def _said(name: str, trial: Trial, row: int, state: State, reference: tuple[float, float]) -> str:
    """The sentence: which reading it is, by its row in the log, and what to record."""
    log, tau = trial.log, state.tau
    swept = trial.resonant and log.frequency is not None and np.ptp(log.frequency) > 0
    what = "several readings like it"
    if name in ("G", "tau", "f0") and trial.steady and swept:
        f0, beside = reference[0] + state.theta[NAMES.index("f0")], ACROSS / (2 * np.pi * tau)
        what = f"ten points or more from {f0 - beside:.7g} to {f0 + beside:.7g} Hz, across the peak"
    elif not trial.steady:
        what = f"ten rows or more in one tau, {identify.seconds(tau)}"
    where = f"at {log.frequency[row]:.7g} Hz" if trial.steady and swept else f"of row {row} (counted from 0)"
    where = where if trial.steady or log.time is None else f"at {log.time[row]:.6g} s"
    alone = f"one reading decides it, that {where} in {log.name}, and no other would show a fault in it"
    return f"cannot tell, because {alone}; record {what}"
