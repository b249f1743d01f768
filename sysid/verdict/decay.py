"""The free decay at the end of a log whose driven part is not that of a plate that stays as it is.

A plate that is driven at an unlocked frequency, or while something else moves it, is restless; what is left
when the drive is off decays with its tau all the same. Where the model leaves most of the whole, the decay is
read by itself.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.rows.condense import taken
from sysid.trials.trial import Trial
from sysid.verdict.conclusion import CONTRADICTS
from sysid.verdict.fitted import Fit
from sysid.verdict.identify import seconds
from sysid.verdict.result import Result
from sysid.verdict.unexplained import left_of

LEAST_ROWS = 20  # of a decay: its tau to a few per cent in noise of a tenth
LEFT_OUT = "cannot tell, because the rows that are driven are left out; record a step with the bench at rest"


RESTLESS = "are not those of a plate that is driven and stays as it is: restless"


class Cause(NamedTuple):
    """What is surely the cause of most of what the plant alone leaves of whole logs: `tau` (s) beside it and
    its standard deviation, and whether it is `all` that is there, though the fit refuses it."""

    tau: float
    std: float
    all: bool

    def contradicts(self, decay: Fit) -> bool:
        """Whether it is all that is there, and the decay has not its tau: nor is that the plate's, then, as
        of one that falls faster than it rises."""
        return self.all and not self._agrees(decay)

    def holds(self, decay: Fit) -> bool:
        """Whether it stands beside what the decay tells."""
        return self.all or self._agrees(decay)

    def _agrees(self, decay: Fit) -> bool:
        alone = decay.parameters["tau"]
        return abs(self.tau - alone.value) < CONTRADICTS * float(np.hypot(alone.std, self.std))


def decays(state: State, whole: Fit | None = None) -> tuple[list[Log], list[str]]:
    """The logs, those of which the model leaves most cut to the decay at their end, and a sentence on each;
    none if it leaves most of none. `whole`: those of which it leaves less as well, of logs of which this fit
    tells no tau."""
    cause = RESTLESS if whole is None or not _described(whole) else f"leave tau open ({_cause(whole)})"
    logs, said = [], []
    for i, trial in enumerate(state.trials):
        log = trial.whole or trial.log
        begin = _free_from(trial, log)
        left = None if begin is None or whole else left_of(state, i)
        if begin is None or not (whole or (left is not None and left.mostly)):
            logs.append(log)
            continue
        logs.append(taken(log, np.arange(begin, len(log))))
        since = seconds(float(log.time[begin] - log.time[0]))
        said.append(
            f"{log.name}: its rows 0 to {begin - 1}, before the drive is off for good {since} after the"
            f" first, {cause}; they are left out, and tau is that of the decay after them"
        )
    return (logs, said) if said else ([], [])


def _described(fit: Fit) -> bool:
    """Whether the plate describes the logs, be they enough or not."""
    return fit.result is Result.undetermined


def _cause(fit: Fit) -> str:
    """Why a fit tells no tau, and what would."""
    return (fit.parameters["tau"].why or "").removeprefix("cannot tell, because ")


def _free_from(trial: Trial, log: Log) -> int | None:
    """The row from which on the log is not driven, if it was before."""
    if trial.steady or not trial.driven or log.drive[-1] != 0:
        return None
    begin = int(np.flatnonzero(log.drive)[-1]) + 2  # the row at the change still shows the drive
    return begin if LEAST_ROWS <= len(log) - begin < len(log) else None


def of_decays(found: Fit, said: list[str], whole: Fit | None = None) -> Fit | None:
    """The fit of the decays with what was left out, of logs of which the fit `whole` tells no tau; None where
    they tell none either."""
    if not found.parameters["tau"].determined:
        return None
    parameters = dict(found.parameters)
    if not parameters["G"].determined:
        parameters["G"] = replace(parameters["G"], why=LEFT_OUT)
    for name in whole.names if whole is not None and _described(whole) else ():
        if not parameters[name].determined:
            why = whole.parameters[name].why or whole.parameters["tau"].why
            parameters[name] = replace(parameters[name], why=why)
    return replace(found, parameters=parameters, warnings=(*said, *found.warnings))
