"""What is known of each log, anew from its residual: its noise, which of its rows are outliers, its nuisances, its cost."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sysid.experiment import Trial, freedom, joined, with_noise
from sysid.extra import asked
from sysid.noise import ALIKE, Level, apart, apart_in_colour, estimate, independent, rice_spread, spikes, tails
from sysid.perturbed import Course
from sysid.projected import efficiency
from sysid.span import times

MUCH = 0.3  # of a log
HELD = 10  # rounds after which rows keep their weights: weights that follow the fit may circle
SETTLED = 20  # rounds after which noise keeps its correlation time, for the same reason


def update(trials, members, found, courses: Sequence[Course], round_: int):
    """Noise and nuisances of each log from the residual at the present theta; the modelled rows; the cost there; the largest
    relative move."""
    updated, models, cost, moved = list(trials), list(trials), 0.0, 0.0
    for logs, detail in zip(members, found, strict=True):
        for k, i in enumerate(logs):
            driven = np.empty_like(detail.driven[k][: len(trials[i].log)])
            driven[trials[i].order] = detail.driven[k][: len(driven)]
            models[i] = trials[i].completed(driven)
            own = complex(detail.start[k]), float(detail.floor[k]), float(detail.late[k])
            new = replace(_renew(trials[i], models[i], courses[i], *own, round_), turn=complex(detail.turn[k]))
            cost += _cost(trials[i], models[i], float(np.sum(np.abs(detail.rows[k]) ** 2)))
            moved = max(moved, _moved(trials[i], new))
            updated[i] = new
    return tuple(updated), tuple(models), cost, moved


def _moved(trial: Trial, new: Trial) -> float:
    """The largest relative change of a level or a correlation time."""
    if len(trial.parts) != len(new.parts) or trial.left_out != new.left_out:
        return 1.0
    pairs = list(zip(trial.parts, new.parts, strict=True))
    levels = [abs(b.noise_std / a.noise_std - 1) for a, b in pairs]
    return float(max(levels + [abs(b.noise_time - a.noise_time) / (b.noise_time or 1.0) for a, b in pairs]))


def _cost(trial: Trial, model: np.ndarray, total: float) -> float:
    """Negative log-likelihood of one log whose whitened residual has the sum of squares `total`, its level integrated out."""
    parts = replace(trial, tail=None).parts
    channels = (1 if trial.log.amplitude_only else 2) / len(parts)
    shrink = sum(0.5 * np.sum(np.log1p(-(p.memory() ** 2))) - np.sum(np.log(p.weight[p.used])) for p in parts)
    dof = freedom(trial)
    level = dof / len(parts) * sum(np.log(p.noise_std) for p in parts)
    return float(0.5 * dof * np.log(total / dof + trial.rounding) + level + channels * shrink + _cost_of_outliers(trial, model))


def _cost_of_outliers(trial: Trial, model: np.ndarray) -> float:
    """Of the rows that are left out, whose noise is normal with a level of its own."""
    outliers = trial.left_out - trial.lost
    if not outliers:
        return 0.0
    there = True if trial.there is None else trial.there
    left = np.abs((trial.log.response - model) * trial.weight)[~trial.kept & there]
    channels = 1 if trial.log.amplitude_only else 2
    return 0.5 * outliers * channels * float(np.log(np.mean(left**2) / channels))


def _renew(trial: Trial, model: np.ndarray, course: Course, start: complex, floor: float, late: float, round_: int) -> Trial:
    """The trial with the noise that its residual shows, and the nuisances of an amplitude log."""
    model = model.real if trial.log.amplitude_only else model
    if trial.steady and not trial.signed:
        trial = replace(trial, spread=rice_spread(model / np.sqrt(floor)))
    new = _with_noise_of(trial, model, lambda: course.design(model), round_)
    if new.noise_time > 0 and not new.signed:
        new = replace(new, efficiency=efficiency(new, course, model))
    new = replace(new, late=late * trial.lateness / trial.looseness, extra=asked(new, course))
    if trial.log.relative_noise and round_ < HELD:
        new = replace(new, level=np.abs(model))
    if trial.signed:
        return new
    # Rice: noise alone lifts the mean of w^2 by its variance; a free floor holds whatever else is there.
    free = new.floor_free and not trial.steady and floor > 0
    held = new.noise_std**2 if trial.steady else 1e-6 * new.noise_std**2
    return replace(new, start=start, floor=floor if free else held, floor_free=bool(free))


def _with_noise_of(trial: Trial, model: np.ndarray, design: Callable[[], np.ndarray], round_: int) -> Trial:
    """The trial with the noise that its residual shows. Which rows are outliers, and whether d and q are apart, is decided anew
    in each round between the first and HELD."""
    trial = trial if round_ else replace(trial, kept=trial.there, levels=(), tail=None)
    chosen, plain = 0 < round_ < HELD, replace(trial, tail=None, kept=trial.there)
    rows = np.arange(len(trial.log))[plain.used]  # those that hold a signal; arrays below are of them
    clock, left = trial.clock[rows], times(joined([p.weight for p in plain.parts]), trial.log.response - model)[rows]
    ratio = trial.levels[1].std / trial.levels[0].std if trial.levels else 1.0
    even = _scaled(left, ratio)

    def shapes(used: slice | np.ndarray = slice(None)) -> np.ndarray:
        return (design() * plain.weight[:, None])[rows][used]

    held = trial.noise_time if round_ > SETTLED else None
    std, time = estimate(even, clock, freedom(plain), None if trial.levels else shapes, held)
    weight, told = np.ones(len(left)), 1.0
    regular = None if trial.kept is None else trial.kept[rows]
    if chosen:
        weight, told = tails(independent(even, clock, time))
        regular = spikes(even, clock) if told < 1 else None
    elif trial.tail is not None:
        weight, told = trial.tail[rows], trial.efficiency
    used: slice | np.ndarray = slice(None)
    counted = freedom(plain)
    if regular is not None and not np.all(regular):
        used = np.flatnonzero(regular)
        plain = replace(plain, kept=np.isin(np.arange(len(trial.log)), rows[used]))
        counted = freedom(plain)
        std, time = estimate(even[used], clock[used], counted, None if trial.levels else lambda: shapes(used), held)
    if time > 0 or plain.left_out > plain.lost:
        weight, told = np.ones(len(left)), 1.0
    time = _halfway(time, trial.noise_time) if round_ > 2 else time
    if chosen and np.iscomplexobj(left) and _is_noise(trial, model):
        ratio = apart_in_colour(left[used], clock[used]) if time > 0 else apart(left, weight)
        if ratio != 1 and told < 1:
            weight, told = tails(_scaled(left, ratio))
    if told < 1:
        std = float(np.sqrt(np.sum(weight * np.abs(left) ** 2) / counted))
    levels: tuple[Level, ...] = ()
    if ratio != 1:
        known = trial.levels if round_ > SETTLED else ()
        levels = _levels((np.sqrt(weight) * left)[used], clock[used], counted, None if told < 1 else shapes(used), known)
        if round_ > 2 and trial.levels:
            levels = tuple(x._replace(time=_halfway(x.time, y.time)) for x, y in zip(levels, trial.levels, strict=True))
        std = float(np.sqrt(np.mean([x.std**2 for x in levels])))
    new = replace(with_noise(plain, std, time, levels), efficiency=told)
    if told == 1:
        return new
    tail = np.ones(len(trial.log))
    tail[rows] = weight
    return replace(new, tail=tail)


def _is_noise(trial: Trial, model: np.ndarray) -> bool:
    """Whether the residual is small enough for noise: what a wrong model leaves, if it is much, differs in d and q too."""
    return bool(np.std(trial.log.response - model) < MUCH * np.std(trial.log.response))


def _levels(
    left: np.ndarray, clock: np.ndarray, counted: float, shapes: np.ndarray | None, known: Sequence[Level]
) -> tuple[Level, ...]:
    """The noise of d and of q, in which the fit can make complex multiples of `shapes`; None: weighted rows, of white noise.
    `known`: levels whose correlation times stay."""
    found = []
    for k, (channel, turn) in enumerate(((left.real, 1.0), (left.imag, -1j))):
        if known:
            found.append(Level(*estimate(channel, clock, 0.5 * counted, time=known[k].time)))
        elif shapes is None:
            found.append(Level(float(np.sqrt(2 * np.sum(channel**2) / counted)), 0.0))
        else:
            made = _orthonormal(np.concatenate([(turn * shapes).real, -(turn * shapes).imag], axis=1))
            found.append(Level(*estimate(channel, clock, 0.5 * counted, partial(np.asarray, made))))
    return tuple(found)


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """A basis of columns (n, K) of which some may be zero or alike: in one channel those that differ by their phase alone are."""
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return u[:, s > ALIKE * s[0]] if len(s) else u


def _scaled(left: np.ndarray, ratio: float) -> np.ndarray:
    """With the noise of q, `ratio` times that of d, as large as that of d."""
    return left if ratio == 1 else left.real + 1j * left.imag / ratio


def _halfway(time: float, before: float) -> float:
    """The fit follows the noise and the noise the fit: half steps do not circle."""
    return float(np.sqrt(time * before)) if time > 0 and before > 0 else time
