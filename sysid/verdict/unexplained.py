"""What the model leaves of a log that is not noise, where no known effect explains it: how much, and where.

Noise of each row's own shares nothing with the row before; what a wrong model leaves does. The root of the
mean product of neighbouring residuals is the size of that part. Noise that rows share looks alike, but is as
large where the response is small, and its rows are independent once what each shares with the row before is
taken out.
"""

from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.model.span import times
from sysid.trials.mixed import mixed
from sysid.trials.trial import Trial
from sysid.trials.whitening import joined, whitened
from sysid.verdict.identify import seconds
from sysid.verdict.wording import stamps_shared

# standard deviations of G, tau or f0: of what is left, no more than half would have been taken for one of
# them
STRUCTURE = 4.0
AT_MOST = 0.02  # of the response, however wide the intervals are
SIGNIFICANT = 4.0  # standard deviations of a lag-one correlation that chance makes
# correlation of neighbouring rows: where a fifth of the residual is noise of its own, the rest is no noise at
# all
SMOOTH = 0.96
EVEN = 0.94  # the same where a quarter of it may be: what is looked into
MOSTLY = 0.3  # of a log's variation: what leaves more is not what the model is about
FAST = 0.1  # of tau: noise of a shorter memory is none of the plate's
LEAST_ROWS = 40  # of which it can be told whether what is left of them is their own, at these
LAGS = (1, 2, 3)  # rows, and by chance no more than
CHANCE = 3.0  # standard deviations
SHARED = 0.5  # of the rows that have the time stamp of another, above which the time is not that of the rows


class Left(NamedTuple):
    """A sentence on what is left; whether it is only noise that may hide as much; whether it is most of the
    log."""

    said: str
    noise: bool
    mostly: bool


def left_of(state: State, i: int, sure: bool = False) -> Left | None:
    """What the model of a minimum leaves of its i-th log, by an amount that could matter; None where that is
    noise. `sure`: something is known to be left, however small."""
    trial = state.trials[i]
    if trial.silent:
        return None
    model = trial.as_recorded(state.models[i])
    residual = trial.residual(model)
    size = _size(trial, model)
    if trial.noise.rounded is not None:  # what rows share of it is known
        residual = times(joined([1 / p.rounded for p in trial.noise.parts]), residual)
    rows, part, chance = _most_shared(trial, residual)
    mostly = part > MOSTLY * float(np.std(trial.log.response))
    if not sure and (part < least_that_matters(state) * size or chance < SIGNIFICANT):
        return None
    even = not (trial.steady or _near_changes(residual[rows], trial.since_change[rows], state.tau))
    if even and not (sure or mostly or slow(state, i)):
        return None  # faster than anything of the plate
    much = f"{100 * part / size:.2g} % of the response"
    smooth = mostly and chance > SMOOTH * np.sqrt(trial.channels * len(rows))
    if not (sure or smooth) and is_coloured_noise(trial, residual, model):
        return Left(
            f"noise that neighbouring rows share is {much}, and may hide as much of a misfit", True, False
        )
    where = _where(trial, rows, residual[rows])
    amount = much if part else "something"  # neighbours share nothing of what jumps from row to row
    return Left(f"{amount} is left that is not noise, half of it {where}; {_why(trial)}", False, mostly)


def left_share(state: State, i: int) -> float:
    """Of the response of the i-th log at its largest, the part that neighbouring rows share of what the model
    leaves."""
    trial = state.trials[i]
    model = trial.as_recorded(state.models[i])
    return _most_shared(trial, trial.residual(model))[1] / _size(trial, model)


def slow(state: State, i: int) -> bool:
    """Whether what was taken for noise of the i-th log may be what a wrong plate leaves: smooth from row to
    row, and in a transient not much shorter than tau. Of a plate's nothing stands out: noise with outliers,
    which is no more than noise between them, is noise."""
    trial = state.trials[i]
    if trial.silent or not trial.noise.coloured:
        return False
    model = trial.as_recorded(state.models[i])
    both = mixed(trial, trial.residual(model))
    if both is not None and both.time * trial.spacing >= FAST * state.tau:
        return True
    if trial.noise.left_out > trial.lost and is_coloured_noise(trial, trial.residual(model), model):
        return False
    longest = max(trial.noise.parts, key=lambda p: p.time)
    smooth = bool(np.median(longest.memory()[1:]) >= EVEN)
    return smooth and (trial.steady or longest.time >= FAST * state.tau)


def least_that_matters(state: State) -> float:
    """Of the response, the part that moves G, tau or f0 out of its 95 % interval: a relative change of G or
    tau changes the response at resonance by as much, one of f0 by 2 pi tau times itself."""
    firm = min(t.noise.firm for t in state.trials)
    error = np.sqrt(firm * np.diag(state.spread)[:3]) * (1.0, 1.0, 2 * np.pi * state.tau)
    claimed = error[error > 0]
    return min(AT_MOST, STRUCTURE * float(np.min(claimed))) if len(claimed) else AT_MOST


def _size(trial: Trial, model: np.ndarray) -> float:
    """The largest that the response of a log is beside its usual one."""
    middle = np.median(model.real) + 1j * np.median(np.imag(model))
    return float(np.max(np.abs(model - middle))) or trial.scale


def _why(trial: Trial) -> str:
    if not trial.steady and stamps_shared(trial) > SHARED * len(trial.whole or trial.log):
        return "rows share their time stamps; record the time with more digits"
    return (
        "no known effect explains it: check the columns, their units and signs, and what else the bench"
        " does to the response"
    )


def _where(trial: Trial, rows: np.ndarray, residual: np.ndarray) -> str:
    """From the quarter to three quarters of its power."""
    power = np.cumsum(np.abs(residual) ** 2)
    first, last = (int(rows[np.searchsorted(power, share * power[-1])]) for share in (0.25, 0.75))
    if trial.swept:
        return f"from {trial.log.frequency[first]:.7g} to {trial.log.frequency[last]:.7g} Hz"
    if trial.log.time is None:
        return f"in rows {first} to {last} (counted from 0)"
    begin = trial.log.time[0]
    return (
        f"from {seconds(trial.log.time[first] - begin)} to {seconds(trial.log.time[last] - begin)} after"
        f" its first row"
    )


def shared(trial: Trial, model: np.ndarray) -> tuple[float, float]:
    """Power that neighbouring rows of a log share beside `model` (n,), and its significance in standard
    deviations of chance."""
    _, part, chance = _most_shared(trial, trial.residual(trial.as_recorded(model)))
    return part**2, chance


def _most_shared(trial: Trial, residual: np.ndarray) -> tuple[np.ndarray, float, float]:
    """The rows of a log in the order in which neighbours share most, and what they do, as `_structure`. What
    a wrong plate leaves of a sweep goes with the frequency, what moves meanwhile with the order in which it
    was recorded."""
    rows = np.flatnonzero(trial.there)
    if (stated := trial.noise.stated) is not None:  # few rows of much noise share something by chance
        residual = residual / stated
    orders = [rows]
    if trial.swept:
        orders = [rows[np.argsort(trial.log.frequency[rows], kind="stable")], rows]
    each = [(rows, *_structure(residual[rows])) for rows in orders]
    return max(each, key=lambda x: x[2])


def _structure(residual: np.ndarray) -> tuple[float, float]:
    """Root mean square of what neighbouring rows share, and its significance in standard deviations of
    chance."""
    n = len(residual)
    power = float(np.mean(np.abs(residual) ** 2))
    if n < 8 or power == 0:
        return 0.0, 0.0
    shared = float(np.mean((residual[1:] * residual[:-1].conj()).real))
    channels = 2 if np.iscomplexobj(residual) else 1
    return float(np.sqrt(max(shared, 0.0))), shared / power * np.sqrt(n * channels)


def is_coloured_noise(trial: Trial, residual: np.ndarray, model: np.ndarray) -> bool:
    """Whether the residual is what it was taken for: noise of its own in each row once what rows share with
    the row before is taken out, and as large where the response is small. What a wrong model leaves is
    smoother, and largest at the resonance."""
    if not trial.noise.coloured or len(residual) < LEAST_ROWS:
        return False
    own = whitened(residual[trial.noise.used], *trial.noise.whitening())
    channels, power = 2 if np.iscomplexobj(own) else 1, float(np.sum(np.abs(own) ** 2))
    shared = [np.sum((own[k:] * own[:-k].conj()).real) / power * np.sqrt(len(own) * channels) for k in LAGS]
    strong = np.abs(model[trial.noise.used]) ** 2
    strong = (strong - np.mean(strong)) / (np.std(strong) or 1.0)
    uneven = np.sum(strong * np.abs(own) ** 2) / power * np.sqrt(0.5 * channels * len(own))
    return bool(np.max(np.abs([*shared, uneven])) < CHANCE)


def noise_like(trial: Trial, model: np.ndarray) -> bool:
    """Whether what is left of a log beside a model is noise, of each row's own or coloured."""
    if shared(trial, model)[1] > SIGNIFICANT:
        recorded = trial.as_recorded(model)
        return is_coloured_noise(trial, trial.residual(recorded), recorded)
    return True


def _near_changes(residual: np.ndarray, since: np.ndarray, tau: float) -> bool:
    """Whether the residual is larger soon than long `since` the inputs changed: a misfit; coloured noise is
    everywhere."""
    near = since < 5 * tau
    if near.sum() < 8 or (~near).sum() < 20:
        return True
    ratio = np.mean(np.abs(residual[near]) ** 2) / max(np.mean(np.abs(residual[~near]) ** 2), 1e-300)
    return bool(ratio > 4)
