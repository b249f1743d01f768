"""Whose inputs the rows of a swept transient show, where no log says so: their own, or those of the row
before.

The two readings are the same log a row apart. Of a sweep that turns back, or beside logs that tell f0, they
differ in how well they are described, and the logs decide. A sweep of one direction is described alike by
both, with f0 a step apart: then it is read half way between them, and the error spans both, as of two
readings that are equally likely,

    D = (theta_settled - theta_instant) (theta_settled - theta_instant)^T / 4
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.minimise import Minimiser, State
from sysid.model.theta import NAMES
from sysid.rows.hold import hold_inputs, read_at
from sysid.trials.trial import Trial
from sysid.verdict import wording

OTHER = {"settled": "instant", "instant": "settled"}
DECIDED = 5.0  # log-likelihood: odds of 150 to 1
FINER = 4  # intervals from row to row, in each of which an input that runs on is held


class Owned(NamedTuple):
    """The minima with each log as it is read; what both readings of logs that cannot tell add to the
    covariance (6, 6) of theta; sentences on what was taken; and the `sampling` that the plate alone decided,
    by the log's place."""

    trials: tuple[Trial, ...]
    states: list[State]
    dispersion: np.ndarray
    said: list[str]
    sampling: dict[int, str]


def owned(minimiser: Minimiser, trials: tuple[Trial, ...], states: list[State], logs: Sequence[Log]) -> Owned:
    """How the logs (as they were given) are read whose `sampling` matters and is not stated; `trials` as they
    were read."""
    dispersion, said = np.zeros((len(NAMES), len(NAMES))), []
    decided: dict[int, str] = {}
    for i, log in enumerate(logs):
        if log.sampling is not None or not _matters(trials[i]):
            continue
        own = _read(trials[i], replace(_log(trials[i]), sampling="settled"))
        settled = _refined(minimiser, states[0], i, own)
        gained = settled.likelihood - states[0].likelihood
        if gained > DECIDED:
            trials, states = _with(trials, i, own), minimiser.imaged([settled])
        elif gained > -DECIDED:
            apart = settled.theta - states[0].theta
            dispersion += np.outer(apart, apart) / 4
            tried = [(t, _refined(minimiser, states[0], i, t)) for t in _half_way(trials[i])]
            between, best = max(tried, key=lambda t: t[1].likelihood)
            trials, states = _with(trials, i, between), minimiser.imaged([best])
        reading = None if abs(gained) <= DECIDED else "settled" if gained > 0 else "instant"
        said.append(f"{log.name}: {wording.owned(reading)}")
        decided |= {} if reading is None else {i: reading}
    return Owned(trials, states, dispersion, said, decided)


def otherwise(logs: Sequence[Log], sampling: Mapping[int, str]) -> list[Log]:
    """The logs read the other way than was decided."""
    return [replace(x, sampling=OTHER[sampling[i]]) if i in sampling else x for i, x in enumerate(logs)]


def _matters(trial: Trial) -> bool:
    """A transient with times whose inputs change on many of its rows, not yet read as showing its own, and of
    which is not stated how late it is."""
    unread = (
        not trial.steady
        and trial.log.theta is None
        and trial.log.sampling is None
        and "delay_s" not in trial.log.bench
    )
    return unread and trial.changes > wording.OFTEN * len(trial.log)


def _log(trial: Trial) -> Log:
    """All rows of it."""
    return trial.whole or trial.log


def _half_way(trial: Trial) -> Iterator[Trial]:
    """The log with inputs half way between those of each row and of the next, which act from one row to the
    other; and with inputs that run on evenly between them."""
    log = _log(trial)
    columns = {n: c for n in ("drive", "frequency") if (c := getattr(log, n)) is not None}
    held: dict[str, Any] = {n: np.append(0.5 * (c[1:] + c[:-1]), c[-1]) for n, c in columns.items()}
    yield _read(trial, replace(log, **held))
    if trial.whole is None:
        time = np.interp(np.arange(FINER * (len(log) - 1)) / FINER, np.arange(len(log)), log.time)
        middle = time + 0.5 * np.diff(np.append(time, log.time[-1]))
        warm = (
            {} if log.temperature is None else {"temperature": np.interp(middle, log.time, log.temperature)}
        )
        drive = np.zeros(len(time)) if log.drive is None else np.interp(middle, log.time, log.drive)
        hold = hold_inputs(
            time, drive, np.interp(middle, log.time, log.frequency) if trial.resonant else None, **warm
        )
        yield replace(trial, inputs=read_at(hold, log.time, 0.0)._replace(spread=np.zeros(len(log))))


def _read(trial: Trial, log: Log) -> Trial:
    """The trial with its rows read as those of `log`."""
    return Trial.of(log, trial.kind, trial.nuisances).with_bench(start=trial.bench.start)


def _refined(minimiser: Minimiser, state: State, i: int, trial: Trial) -> State:
    known = trial.in_noise(trial.noise.at(state.trials[i].noise.std, 0.0, (), 0.0))
    return minimiser.refine(_with(state.trials, i, known), state.theta)


def _with(trials: Sequence[Trial], i: int, trial: Trial) -> tuple[Trial, ...]:
    return (*trials[:i], trial, *trials[i + 1 :])
