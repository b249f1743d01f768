"""A fit: the plant that explains the logs, and each log beside its model."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.model.plant import Plant
from sysid.model.theta import NAMES
from sysid.rows.condense import taken
from sysid.shown import Shown
from sysid.trials.noise import Level
from sysid.verdict import wording
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.flank import Flank, seen
from sysid.verdict.result import Parameter, Result


@dataclass(frozen=True)
class FittedLog:
    """One log and what the fit makes of it; arrays are in the order of the log's rows."""

    log: Log  # means of neighbouring rows where the file is long
    kind: str
    rows: int  # of the file
    response: np.ndarray = field(repr=False)  # modelled
    residual: np.ndarray = field(repr=False)  # recorded - modelled
    nrmse_percent: float
    noise_std: float
    noise_time: float  # correlation time of the noise, s (rows where no time is recorded); 0: white
    description: str
    noise: str  # what it was taken for, in words
    levels: tuple[
        Level, ...
    ] = ()  # of d and q, where their noise differs: `noise_std` is then its root mean square


@dataclass(frozen=True, repr=False)
class Fit(Shown):
    """The plant that explains the logs. `covariance` is over `names`, in the units of `units`."""

    plant: Plant
    parameters: dict[str, Parameter]
    names: tuple[str, ...]
    covariance: np.ndarray = field(repr=False)
    result: Result
    reference_temperature: float | None
    logs: tuple[FittedLog, ...]
    warnings: tuple[str, ...]
    units: dict[str, str] = field(repr=False)
    modes: tuple[State, ...] = field(repr=False)  # the best first
    reference: tuple[float, float] = field(repr=False)  # Hz, degC: where theta's offsets are taken from
    priors: dict[str, tuple[float, float]] = field(
        default_factory=dict
    )  # that were stated: value and standard deviation
    notes: tuple[str, ...] = ()  # what is only information: nothing is asked for
    findings: tuple[Finding, ...] = ()  # what the logs show besides plant, bench and noise
    assumed: tuple[Assumed, ...] = ()  # what they would not show, and is taken not to be there
    judged: Any = field(default=None, repr=False)  # while the fit goes on, what its minimum leaves
    lone: dict[str, str] = field(
        default_factory=dict, repr=False
    )  # why parameters that one reading decides are not determined

    def to_frame(self) -> Any:
        """A pandas DataFrame, a row for each parameter: value, std, ci95_low, ci95_high, unit, determined,
        why."""
        from sysid.report.frames import of_fit

        return of_fit(self)

    def plot(self) -> Any:
        """Figures of matplotlib by title, those of the report: logs and fit over time, sweeps, what each log
        says, residuals."""
        from sysid.report.plots import Figures, of_fit

        return Figures.of(of_fit(self))

    @cached_property
    def posterior(self) -> Any:
        """Its `Posterior`: of a fit that was loaded the one that was saved, else that of
        `sysid.sample(fit)`."""
        from sysid.posterior.posterior import sample

        return sample(self)

    def save(self, folder: str | Path, loop: Any = None, zoomable: bool = False) -> Path:
        """Write fit, posterior and report into a folder; see `Posterior.save`."""
        return self.posterior.save(folder, loop, zoomable)

    def report(self, path: str | Path, loop: Any = None, zoomable: bool = False) -> Path:
        """Write the report, one HTML file, to `path`; see `Posterior.report`."""
        return self.posterior.report(path, loop, zoomable)

    def predict(self, log: Log, bench: bool = True) -> Any:
        """What the plate answers to the inputs of a log that the fit need not have seen, a `Prediction` with
        its errors.

        `bench`: with what is no plate's but each d/q log's own, the turn of its demodulator, an offset and a
        feedthrough, found from its rows by least squares; else the plate alone. A transient begins at rest.
        Where no temperature is recorded the plate is at the mean of the fit's logs. Raises LogError for a log
        in other units or without a drive, ValueError where the fit tells no plate.
        """
        from sysid.posterior.prediction import predict

        return predict(self, log, bench)

    def _brief(self) -> Any:
        from sysid.report.brief import of_fit

        return of_fit(self)

    def estimate(self, name: str) -> tuple[float, float]:
        """What the best minimum makes of a parameter, and its standard deviation; NaN and infinity where it
        is not fitted."""
        if name not in self.names:
            return float("nan"), float("inf")
        k = self.names.index(name)
        value = getattr(self.plant, name, self.modes[0].theta[NAMES.index(name)])
        return float(value), float(np.sqrt(self.covariance[k, k]))

    @property
    def usable(self) -> bool:
        """Whether its values are the plate's. A value of logs that the model does not describe is determined
        where they bound it, and is that of a model all the same."""
        return self.result.usable

    @property
    def warming(self) -> float:
        """degC from the temperature of theta's f0 to that at which f0 is reported."""
        return 0.0 if self.reference_temperature is None else self.reference_temperature - self.reference[1]

    @cached_property
    def flank(self) -> Flank | None:
        """What the logs show of the resonance, where its peak lies outside of all that was driven."""
        return seen(self.modes[0], self.reference)

    @property
    def cost(self) -> float:
        """Negative log-likelihood, noise levels and nuisances eliminated, up to a constant of the logs."""
        return self.modes[0].cost


def beside(state: State) -> tuple[FittedLog, ...]:
    """Each log beside its model."""
    fitted = []
    for trial, model in zip(state.trials, state.models, strict=True):
        rows = np.flatnonzero(trial.there)
        log = taken(trial.log, rows) if trial.lost else trial.log
        model = trial.as_recorded(model)[rows]
        left = log.response - model
        fitted.append(
            FittedLog(
                log=log,
                kind=trial.kind,
                rows=len(trial.whole or trial.log),
                response=model,
                residual=left,
                nrmse_percent=_percent(left, log.response - np.mean(log.response)),
                noise_std=trial.noise.std,
                noise_time=trial.noise.time,
                description=wording.describe(trial),
                noise=wording.noise(trial),
                levels=trial.noise.levels,
            )
        )
    return tuple(fitted)


def _percent(left: np.ndarray, moved: np.ndarray) -> float:
    """Of what a response moves, the share that is left; NaN for one that does not."""
    return 100 * float(np.linalg.norm(left) / np.linalg.norm(moved)) if np.any(moved) else float("nan")
