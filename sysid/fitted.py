"""A fit: the plant that explains the logs, each log beside its model, and what is known of each parameter."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid import flank, identify, wording
from sysid.condense import taken
from sysid.log import Log
from sysid.minimise import State, shares
from sysid.noise import Level
from sysid.plant import Plant
from sysid.prior import NAMES, POSITIVE
from sysid.result import Parameter, Result
from sysid.trial import Trial


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
    levels: tuple[Level, ...] = ()  # of d and q, where their noise differs: `noise_std` is then its root mean square


@dataclass(frozen=True)
class Fit:
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
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)  # that were stated: value and standard deviation
    lone: dict[str, str] = field(default_factory=dict, repr=False)  # why parameters that one reading decides are not determined

    def estimate(self, name: str) -> tuple[float, float]:
        """What the best minimum makes of a parameter, and its standard deviation; NaN and infinity where it is not fitted."""
        if name not in self.names:
            return float("nan"), float("inf")
        k = self.names.index(name)
        value = getattr(self.plant, name, self.modes[0].theta[NAMES.index(name)])
        return float(value), float(np.sqrt(self.covariance[k, k]))

    @property
    def cost(self) -> float:
        """Negative log-likelihood, noise levels and nuisances eliminated, up to a constant of the logs."""
        return self.modes[0].cost


def usable(parameters: dict[str, Parameter], trials: Sequence[Trial]) -> bool:
    """Whether tau is determined, and G where a drive was recorded."""
    return parameters["tau"].determined and (parameters["G"].determined or all(t.log.drive is None for t in trials))


def parameter(fit: Fit, name: str, value: float, std: float, ci95: tuple[float, float] | None = None) -> Parameter:
    """The estimate of one parameter, or why there is none."""
    state = fit.modes[0]
    G, tau = np.exp(state.theta[:2])
    if not state.converged:
        said = identify.why(name, state.trials, tau, fit.names, 1)
        return Parameter(None, None, None, fit.units[name], False, f"{said} (the fit did not converge)")
    vague = float(np.sqrt(state.covariance[1, 1]))
    longest = tau * np.exp(min(2 * vague, 10.0)) if vague > identify.RELATIVE else tau  # and the half bandwidth as much narrower
    modes, limit = _modes(fit, name), identify.limits(G, longest if name in ("f0", "k_T") else tau)[name]
    told = name in fit.names and (not fit.priors or alone(fit, name)[1] <= limit) and _shown(fit, name)
    if told and np.isfinite(value) and not modes and std <= limit:
        if tail := flank.why(state, fit.reference):
            return Parameter(None, None, None, fit.units[name], False, tail)
        if name in fit.lone:
            return Parameter(None, None, None, fit.units[name], False, fit.lone[name])
        ci95 = ci95 or (value - 1.959964 * std, value + 1.959964 * std)
        return Parameter(value, std, ci95, fit.units[name], True)
    said = identify.why(name, state.trials, tau, fit.names, len(modes))
    if name in fit.priors and not told:
        said = f"{said} (what is stated of it beforehand is not what the logs tell)"
    return Parameter(None, None, None, fit.units[name], False, said, modes)


def _shown(fit: Fit, name: str) -> bool:
    """Whether the logs show more than what chance makes of a few readings, or of noise with a tau that is anything."""
    state = fit.modes[0]
    if not fit.priors and identify.hopeless(state.trials, fit.names):
        return False
    if identify.ambiguous(name, state.trials, fit.names) or (name == "k_T" and identify.within_errors(state.trials)):
        return False
    known = name not in ("f0", "k_T") or np.sqrt(state.covariance[1, 1]) <= identify.RELATIVE
    return known or not identify.buried(state.trials)


def alone(fit: Fit, name: str, at: float | None = None) -> tuple[float, float]:
    """What the logs alone make of a parameter, to first order, and its standard deviation; f0 at `at` (degC), else where it is
    reported."""
    state, row, k = fit.modes[0], np.zeros(len(NAMES)), NAMES.index(name)
    row[k] = 1.0
    if name == "f0":
        at = fit.reference_temperature if at is None else at
        row[NAMES.index("k_T")] = 0.0 if at is None else at - fit.reference[1]
    value = float(row @ (state.theta + state.alone @ state.prior.slope(state.theta)))
    std = float(np.sqrt(row @ state.alone @ row))
    if name in POSITIVE:
        return float(np.exp(value)), float(np.exp(state.theta[k])) * std
    return value + (fit.reference[0] if name == "f0" else 0.0), std


def _mode_values(fit: Fit, name: str) -> list[tuple[float, float]]:
    found = []
    for state in fit.modes:
        k, value = NAMES.index(name), float(state.theta[NAMES.index(name)])
        std = float(np.sqrt(state.covariance[k, k]))
        if k < 2:
            value, std = np.exp(value), np.exp(value) * std
        elif name == "f0":
            value += fit.reference[0]
        found.append((float(value), float(std)))
    return found


def _modes(fit: Fit, name: str) -> tuple[dict, ...]:
    """The values of separate minima and their weights; none where this parameter is the same in all of them."""
    if name not in fit.names or len(fit.modes) == 1:
        return ()
    found = _mode_values(fit, name)
    if np.ptp([value for value, _ in found]) <= 2 * found[0][1]:
        return ()
    weights = shares(fit.modes)
    return tuple({"value": value, "std": std, "weight": float(w)} for (value, std), w in zip(found, weights, strict=True))


def beside(state: State) -> tuple[FittedLog, ...]:
    """Each log beside its model."""
    fitted = []
    for trial, model in zip(state.trials, state.models, strict=True):
        rows = np.flatnonzero(np.ones(len(model), bool) if trial.there is None else trial.there)
        log = taken(trial.log, rows) if trial.lost else trial.log
        model = (model.real if log.amplitude_only else model)[rows]
        left = log.response - model
        fitted.append(
            FittedLog(
                log=log,
                kind=trial.kind,
                rows=len(trial.whole or trial.log),
                response=model,
                residual=left,
                nrmse_percent=_percent(left, log.response - np.mean(log.response)),
                noise_std=trial.noise_std,
                noise_time=trial.noise_time,
                description=wording.describe(trial),
                noise=wording.noise(trial),
                levels=trial.levels,
            )
        )
    return tuple(fitted)


def _percent(left: np.ndarray, moved: np.ndarray) -> float:
    """Of what a response moves, the share that is left; NaN for one that does not."""
    return 100 * float(np.linalg.norm(left) / np.linalg.norm(moved)) if np.any(moved) else float("nan")
