"""The update of each log in every round of a fit: its noise, its nuisances and its cost at the present
theta."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.model.experiment import Residual
from sysid.rows import rounding
from sysid.trials.extra import renewed
from sysid.trials.perturbed import LogResponse
from sysid.trials.residuals import update_noise
from sysid.trials.rounds import HELD
from sysid.trials.trial import Trial, freedom, freedoms, numbers_left
from sysid.trials.whitening import Noise


def update(
    trials: Sequence[Trial],
    members: Sequence[Sequence[int]],
    found: Sequence[Residual],
    courses: Sequence[LogResponse],
    round_: int,
    white: bool = False,
) -> tuple[tuple[Trial, ...], tuple[np.ndarray, ...], float, float]:
    """Noise and nuisances of each log from the residual at the present theta; of the noise nothing but its
    level where it is taken for `white`. Returns the updated trials, the
    modelled rows of each, the total cost, and the largest relative change."""
    updated, models, cost, moved = list(trials), [t.log.response for t in trials], 0.0, 0.0
    for logs, detail in zip(members, found, strict=True):
        for k, i in enumerate(logs):
            driven = np.empty_like(detail.driven[k][: len(trials[i].log)])
            driven[trials[i].noise.order] = detail.driven[k][: len(driven)]
            models[i] = trials[i].completed(driven)
            turn = complex(detail.turn[k])
            start = trials[i].started * complex(detail.start[k]) / (turn or 1.0)
            own = abs(turn) if trials[i].undriven_sweep else 1.0
            floor, late = float(detail.floor[k]) * own**2, float(detail.late[k])
            offset = complex(detail.offset[k]) if trials[i].bench.alongside is None else 0.0
            new = _renew(trials[i], models[i], courses[i], start, floor, late, offset, round_, white)
            new = new.with_bench(turn=turn, fed=models[i] - driven if new.signed else 0.0)
            new = renewed(new, courses[i], np.asarray(detail.extra[k])).floored(driven, models[i], floor)
            new = new if new.signed else new.lifted(courses[i].plate)
            cost += _cost(trials[i], models[i], float(np.sum(np.abs(detail.rows[k]) ** 2)))
            moved = max(
                moved, _moved(trials[i].noise, new.noise), _elsewhere(trials[i], new, courses[i].named.k_T)
            )
            updated[i] = new
    return tuple(updated), tuple(models), cost, moved


def _moved(noise: Noise, new: Noise) -> float:
    """The largest relative change of a level or a correlation time; 1 where the kind of noise has changed."""
    if len(noise.parts) != len(new.parts) or noise.left_out != new.left_out:
        return 1.0
    pairs = list(zip(noise.parts, new.parts, strict=True))
    levels = [abs(b.std / a.std - 1) for a, b in pairs]
    times = [abs(b.time - a.time) / (b.time or 1.0) for a, b in pairs]
    return float(max(levels + times))


def _elsewhere(trial: Trial, new: Trial, k_T: float) -> float:
    """How far a resonance of the log's own has moved, in errors of its thermometer; 1 where it is new,
    or has gone."""
    if not (trial.tied and new.tied):
        return float(trial.tied is not new.tied)
    return abs(new.bench.resonance - trial.bench.resonance) / (
        abs(k_T) * trial.bench.extra["thermometer"].prior + np.finfo(float).tiny
    )


def _cost(trial: Trial, model: np.ndarray, total: float) -> float:
    """Negative log-likelihood of one log whose whitened residual has the sum of squares `total`, its level
    integrated out."""
    parts = replace(trial.noise, tail=None).parts
    channels = (1 if trial.log.amplitude_only else 2) / len(parts)
    shrink = sum(0.5 * np.sum(np.log1p(-(p.memory() ** 2))) - np.sum(np.log(p.weight[p.used])) for p in parts)
    dof = freedom(trial)
    if (
        trial.noise.rounded is not None
    ):  # rows that share a rounding error count as one, and the level is known
        shrink -= sum(np.sum(np.log(p.rounded[p.used])) for p in parts)
        least = [rounding.least(step) or p.std for step, p in zip(trial.steps, parts, strict=True)]
        level = numbers_left(trial) / len(parts) * np.sum(np.log(least))
        level += sum(n * np.log(p.std / low) for n, p, low in zip(freedoms(trial), parts, least, strict=True))
        return float(0.5 * (total - dof) + level + channels * shrink + _cost_of_outliers(trial, model))
    level = dof / len(parts) * sum(np.log(p.std) for p in parts)
    return float(
        0.5 * dof * np.log(total / dof + trial.rounding)
        + level
        + channels * shrink
        + _cost_of_outliers(trial, model)
    )


def _cost_of_outliers(trial: Trial, model: np.ndarray) -> float:
    """The share of rows that are left out: their noise is normal, with a level of its own."""
    outliers = trial.noise.left_out - trial.lost
    if not outliers:
        return 0.0
    left = np.abs((trial.log.response - model) * trial.noise.weight)[~trial.noise.kept & trial.there]
    channels = 1 if trial.log.amplitude_only else 2
    return 0.5 * outliers * channels * float(np.log(np.mean(left**2) / channels))


def _renew(
    trial: Trial,
    model: np.ndarray,
    course: LogResponse,
    start: complex,
    floor: float,
    late: float,
    offset: complex,
    round_: int,
    white: bool,
) -> Trial:
    """The trial with the noise that its residual shows, its start and its lateness; for an amplitude log also
    its floor and an offset."""
    new = update_noise(trial, trial.as_recorded(model), course, floor, round_, white)
    late = late * trial.lateness / trial.looseness
    if trial.signed:
        return new.with_bench(start=start, late=late)
    if round_ > HELD:  # linear only about where they are, they may circle as well: ever shorter steps
        share, before = 1 / (round_ - HELD + 1), trial.bench
        start, late = share * start + (1 - share) * before.start, share * late + (1 - share) * before.late
        offset = share * offset + (1 - share) * before.offset
    # Rice: noise alone lifts the mean of w^2 by its variance; a free floor holds whatever else is there, but
    # for an offset.
    free = new.bench.floor_free and not trial.floor_held and floor > 0
    held = (1 - new.noise.share if trial.floor_held else 1e-6) * new.noise.std**2
    floor = floor if free else held
    return new.with_bench(start=start, late=late, offset=offset, floor=floor, floor_free=bool(free))
