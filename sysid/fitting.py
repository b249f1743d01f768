"""The fit: all logs in one likelihood, Levenberg-Marquardt from starting values that the data give."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from sysid import identify
from sysid.experiment import NUISANCES, Trial, freedom, group, with_noise
from sysid.guess import candidates
from sysid.likelihood import details, stacked_rows
from sysid.log import Log
from sysid.noise import estimate
from sysid.plant import Plant
from sysid.precision import compiled, float64
from sysid.result import Parameter, Result
from sysid.start import Search, joint, local

NAMES = ("G", "tau", "f0", "k_T")
SETTLED = 4.0  # dwell in units of tau from which a point of a timed sweep counts as settled: e^-4 of the change is left
NEAR = 0.1  # of a sum of squares in units of the noise: a third of a standard deviation
STARTS = 4
RUNAWAY = 9.0  # change of log tau in one search, a factor of 8000, that no start from the data is in need of
MODES = 8.0  # a second minimum whose log-likelihood is within this of the best is a mode


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


@dataclass(frozen=True)
class State:
    """A converged minimum: theta = (log G, log tau, f0 - reference, k_T), its covariance, the logs' noise and nuisances."""

    theta: np.ndarray
    covariance: np.ndarray
    trials: tuple[Trial, ...]
    models: tuple[np.ndarray, ...] = field(repr=False)  # modelled rows of each trial
    cost: float
    converged: bool


@dataclass(frozen=True)
class Fit:
    """The plant that explains the logs. `covariance` is over `names`, in the units of `units`."""

    plant: Plant
    parameters: dict[str, Parameter]
    names: tuple[str, ...]
    covariance: np.ndarray
    result: Result
    reference_temperature: float | None
    logs: tuple[FittedLog, ...]
    warnings: tuple[str, ...]
    units: dict[str, str]
    modes: tuple[State, ...] = field(repr=False)  # the best first
    reference: tuple[float, float] = field(repr=False)  # Hz, degC: where theta's offsets are taken from

    @property
    def cost(self) -> float:
        """Negative log-likelihood, noise levels and nuisances eliminated, up to a constant of the logs."""
        return self.modes[0].cost


@compiled
def _levenberg_marquardt(theta, directions, layouts, groups):
    """theta + directions @ x that makes the residual rows smallest."""

    def rows(x, _):
        return stacked_rows(theta + directions @ x, layouts, groups)

    solver: Any = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5)  # the last digits are the rounds' Gauss-Newton steps
    x0 = jnp.zeros(directions.shape[1])
    x = optx.least_squares(rows, solver, x0, max_steps=128, throw=False).value
    return theta + directions @ jnp.where(jnp.all(jnp.isfinite(x)), x, x0)


@compiled
def _linearise(theta, directions, layouts, groups):
    """Gram matrix of the Jacobian and gradient along `directions`; residual and nuisances of each log, group by group."""

    def rows(x):
        return stacked_rows(theta + directions @ x, layouts, groups)

    value, tangent = jax.linearize(rows, jnp.zeros(directions.shape[1]))
    jacobian = jax.vmap(tangent)(jnp.eye(directions.shape[1]))
    return jacobian @ jacobian.T, jacobian @ value, details(theta, layouts, groups)


@float64
def fit(
    logs: Sequence[Log],
    *,
    nuisances: Sequence[str] = NUISANCES,
    reference_temperature: float = 24.0,
    start: Plant | None = None,
) -> Fit:
    """Fit one plant to all `logs`, from no start values.

    `nuisances`: what the bench may have added to each log and is eliminated: "rotation" of the demodulator, "background"
    (feedthrough of the drive; over a sweep a constant and a slope), "offset" of the output, "start" (state at the first row).
    `start`: a plant to begin from instead of the data. Raises ValueError without logs, or for an unknown nuisance.
    """
    if not logs:
        raise ValueError("no logs to fit")
    if unknown := set(nuisances) - set(NUISANCES):
        raise ValueError(f"unknown nuisance {sorted(unknown)}; known are {', '.join(NUISANCES)}")
    _check_units(logs)
    trials, warnings = _trials(logs, tuple(nuisances))
    reference = _reference(trials)
    free = _free(trials)
    trials, states = _minima(trials, reference, free, start)
    flipped = tuple(_settled(t, np.exp(states[0].theta[1])) for t in trials)
    if [t.kind for t in flipped] != [t.kind for t in trials]:
        trials, states = _minima(flipped, reference, free, start)
    return _conclude(states, reference, free, warnings, reference_temperature)


def _check_units(logs: Sequence[Log]) -> None:
    for log in logs:
        drive = log.drive_unit if log.drive is not None and logs[0].drive is not None else logs[0].drive_unit
        if (log.response_unit, drive) != (logs[0].response_unit, logs[0].drive_unit):
            raise ValueError(
                f"{log.name}: found units {log.response_unit} and {log.drive_unit}, expected {logs[0].response_unit} and"
                f" {logs[0].drive_unit} as in {logs[0].name}; logs that are read together by read_logs agree"
            )


def _conclude(states: list[State], reference, free, warnings: list[str], reference_temperature: float) -> Fit:
    best = states[0]
    G, tau = np.exp(best.theta[:2])
    index = [NAMES.index(n) for n in free]
    units = _units(best.trials[0].log)
    # theta's covariance is of logarithms; f0 is carried to the temperature at which it is reported.
    drifts = "k_T" in free and np.sqrt(best.covariance[3, 3]) <= identify.limits(G, tau)["k_T"]
    warm = any(t.log.temperature is not None for t in best.trials)
    at = reference_temperature if drifts else (reference[1] if warm else None)
    carry = np.diag([G, tau, 1.0, 1.0])
    carry[2, 3] = at - reference[1] if drifts else 0.0
    covariance = (carry @ best.covariance @ carry.T)[np.ix_(index, index)]
    values = {"G": G, "tau": tau, "f0": reference[0] + best.theta[2] + carry[2, 3] * best.theta[3], "k_T": best.theta[3]}
    known = {n: float(values[n]) if n in free else None for n in NAMES}
    plant = Plant(**known, reference_temperature=reference_temperature if at is None else at)
    estimates = {n: (float(values[n]), float(s)) for n, s in zip(free, np.sqrt(np.diag(covariance)), strict=True)}
    described, logs = _described(best)
    warnings = warnings + described
    result = Result.successful if best.converged else Result.not_converged
    fitted = Fit(
        plant, {}, free, covariance, result, at, logs, tuple(warnings), units, tuple(states), reference
    )  # fmt: skip
    parameters = {n: parameter(fitted, n, *estimates.get(n, (np.nan, np.inf))) for n in NAMES}
    if result is Result.successful and not usable(parameters, best.trials):
        result = Result.undetermined
    if result is Result.successful and described:
        result = Result.misfit
    return replace(fitted, parameters=parameters, result=result)


def usable(parameters: dict[str, Parameter], trials: Sequence[Trial]) -> bool:
    """Whether tau is determined, and G where a drive was recorded."""
    return parameters["tau"].determined and (parameters["G"].determined or all(t.log.drive is None for t in trials))


def parameter(fit: Fit, name: str, value: float, std: float, ci95: tuple[float, float] | None = None) -> Parameter:
    """The estimate of one parameter, or why there is none."""
    state = fit.modes[0]
    if not state.converged:
        return Parameter(None, None, None, fit.units[name], False, "cannot tell, because the fit did not converge")
    G, tau = np.exp(state.theta[:2])
    modes = _modes(fit, name)
    if name in fit.names and np.isfinite(value) and not modes and std <= identify.limits(G, tau)[name]:
        ci95 = ci95 or (value - 1.959964 * std, value + 1.959964 * std)
        return Parameter(value, std, ci95, fit.units[name], True)
    said = identify.why(name, state.trials, tau, fit.names, len(modes))
    return Parameter(None, None, None, fit.units[name], False, said, modes)


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
    weight = np.exp(-np.array([s.cost for s in fit.modes]) + fit.modes[0].cost)
    return tuple(
        {"value": value, "std": std, "weight": float(w)}
        for (value, std), w in zip(found, weight / weight.sum(), strict=True)
    )


def _units(log: Log) -> dict[str, str]:
    gain = log.response_unit if log.drive is None else f"{log.response_unit}/{log.drive_unit}"
    return {"G": gain, "tau": "s", "f0": "Hz", "k_T": "Hz/degC"}


def _described(state: State) -> tuple[list[str], tuple[FittedLog, ...]]:
    """Each log beside its model; and, for every log that the model does not describe, a sentence."""
    misfits, fitted = [], []
    tau, std = float(np.exp(state.theta[1])), float(np.exp(state.theta[1]) * np.sqrt(state.covariance[1, 1]))
    for trial, model in zip(state.trials, state.models, strict=True):
        model = model.real if trial.log.amplitude_only else model
        left = trial.log.response - model
        said = identify.misfit(trial, model, left, tau) or identify.filtered(trial, tau, std)
        if said:
            misfits.append(f"{trial.log.name}: {said}")
        centred = trial.log.response - np.mean(trial.log.response)
        nrmse = 100 * float(np.linalg.norm(left)) / max(float(np.linalg.norm(centred)), 1e-300)
        fitted.append(
            FittedLog(
                log=trial.log,
                kind=trial.kind,
                rows=int(trial.count.sum()),
                response=model,
                residual=left,
                nrmse_percent=nrmse,
                noise_std=trial.noise_std,
                noise_time=trial.noise_time,
                description=identify.describe(trial),
            )
        )
    return misfits, tuple(fitted)


def _trials(logs: Sequence[Log], nuisances: tuple[str, ...]) -> tuple[tuple[Trial, ...], list[str]]:
    """How each log is read at first, and what had to be assumed."""
    recorded = [log.temperature.mean() for log in logs if log.temperature is not None]
    trials, warnings = [], []
    for log in logs:
        if log.temperature is None and recorded and log.frequency is not None:
            mean = float(np.mean(recorded))
            log = replace(log, temperature=np.full(len(log), mean))
            warnings.append(f"{log.name}: no temperature is recorded; taken as {mean:.4g} degC, the mean of the other logs")
        trial = Trial.of(log, log.kind or "steady", nuisances)
        if log.kind is None:
            trial = _settled(trial, candidates(trial)[0][0])
        if trial.start_free and not trial.signed:
            trial = replace(trial, start=complex(np.mean(log.response[:3])))
        trials.append(trial)
        warnings += [f"{log.name}: {note}" for note in identify.assumptions(trial)]
    return tuple(trials), warnings


def _reference(trials: Sequence[Trial]) -> tuple[float, float]:
    """Frequency (Hz) and temperature (degC) that offsets are taken from; NaN frequency where none is recorded."""
    frequencies = [np.median(t.log.frequency) for t in trials if t.resonant]
    warm = [t.log.temperature.mean() for t in trials if t.log.temperature is not None]
    return (float(np.median(frequencies)) if frequencies else np.nan, float(np.mean(warm)) if warm else 0.0)


def _free(trials: Sequence[Trial]) -> tuple[str, ...]:
    """The parameters that these logs could determine."""
    warm = [t.log.temperature for t in trials if t.resonant and t.log.temperature is not None]
    span = max((w.max() for w in warm), default=0.0) - min((w.min() for w in warm), default=0.0)
    possible = {
        "G": any(t.driven for t in trials),
        "tau": True,
        "f0": any(t.resonant for t in trials),
        "k_T": span > identify.LEAST_WARMING,
    }
    return tuple(name for name in NAMES if possible[name])


def _settled(trial: Trial, tau: float) -> Trial:
    """A timed sweep whose kind is not stated: settled if each row dwells long enough for `tau`, else a transient."""
    if trial.log.kind is not None:
        return trial
    kind = "steady" if np.median(np.diff(trial.log.time)) >= SETTLED * tau else "transient"
    return trial if kind == trial.kind else Trial.of(trial.log, kind, trial.nuisances)


def _minima(trials, reference, free, start) -> tuple[tuple[Trial, ...], list[State]]:
    """Minima of the cost, the best first, from the likeliest starting points."""
    search = Search(trials, (reference[0] if np.isfinite(reference[0]) else 0.0, reference[1]))
    if start is None:
        best, cost = local(search, np.random.default_rng(0))
        warming = np.array([0.0 if t.log.temperature is None else t.log.temperature.mean() - reference[1] for t in trials])
        points, score = joint(search, best, cost, warming, "k_T" in free)
    else:
        f0 = 0.0 if start.f0 is None else start.f0 - reference[0]
        k_T = start.k_T or 0.0
        points = np.array([[np.log(start.tau), f0 + k_T * (reference[1] - start.reference_temperature), k_T]])
        cost, score = search.sums(points)[0], np.zeros(1)
    level = 0.05 * np.sqrt(np.where(np.isfinite(cost), cost, 1.0) / search.freedom)
    trials = tuple(with_noise(t, s * t.scale, 0.0) for t, s in zip(trials, level, strict=True))
    points, score = _distinct(points, score)
    starts = np.column_stack([_log_gains(search, points), points])
    found = [_refine(trials, starts[0], reference, free, rounds=1)]
    reached = search.score(found[0].theta[None, 1:], cost)[0]
    # A start that is far worse than where the best one ended leads nowhere new; where the ends differ, all are tried.
    found += [
        _refine(trials, theta, reference, free, rounds=1)
        for theta, short in zip(starts[1:], score[1:], strict=True)
        if short < reached + 10 * MODES or reached > 0.25 * search.freedom.sum()
    ]
    found += [_refine(trials, theta, reference, free, rounds=1) for theta in _mirrored(found[0], reference)]
    found.sort(key=lambda s: s.cost)
    states: list[State] = []
    for first in found:
        if first.cost > found[0].cost + 10 * MODES + 0.05 * search.freedom.sum():
            continue  # far above the best, also if the noise turns out to be coloured
        if any(not _apart(first, other, free) for other in states):
            continue
        state = _refine(first.trials, first.theta, reference, free)
        if all(_apart(state, other, free) for other in states):
            states.append(state)
    states.sort(key=lambda s: s.cost)
    return trials, [s for s in states if s.cost <= states[0].cost + MODES]


def _distinct(points: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first few points, and their scores, that are half a bandwidth or a factor of two in tau from any before them."""
    kept: list[int] = []
    for i, p in enumerate(points):
        half_bandwidth = 1 / (2 * np.pi * np.exp(p[0]))
        scale = np.array([0.7, 0.5 * half_bandwidth, 0.1 * half_bandwidth])
        if all(np.any(np.abs(p - points[k]) > scale) for k in kept):
            kept.append(i)
        if len(kept) == STARTS:
            break
    return points[kept], score[kept]


def _mirrored(state: State, reference) -> list[np.ndarray]:
    """Where amplitudes are all there is: the resonance as far on the other side of each constant drive frequency."""
    resonant = [t for t in state.trials if t.resonant]
    if any(not t.log.amplitude_only for t in resonant):
        return []
    drives = {float(t.log.frequency[0]) for t in resonant if np.ptp(t.log.frequency) == 0}
    mirrored = [state.theta.copy() for _ in drives]
    for theta, drive in zip(mirrored, sorted(drives), strict=True):
        theta[2] = 2 * (drive - reference[0]) - theta[2]
    return mirrored


def _log_gains(search: Search, points: np.ndarray) -> list[float]:
    """Log of the median gain of the driven logs at each point."""
    driven = np.array([t.driven for t in search.trials])
    gains = [row[driven & np.isfinite(row) & (row > 0)] for row in search(points)[1]]
    return [float(np.log(np.median(g))) if len(g) else 0.0 for g in gains]


def _apart(state: State, other: State, free) -> bool:
    index = [NAMES.index(n) for n in free]
    step = (state.theta - other.theta)[index]
    spread = np.sqrt(np.diag(state.covariance)[index] + np.diag(other.covariance)[index])
    return bool(np.any(np.abs(step) > 0.5 * spread + 1e-9))


def _refine(trials, theta, reference, free, rounds: int = 30) -> State:
    """Minimise, estimate each log's noise from its residual, and again until nothing changes any more.

    Once a Gauss-Newton step would change the sum of squares by less than NEAR, that step replaces the search.
    """
    last, left, converged, begin = np.inf, np.inf, False, theta
    if all(np.all(t.log.response == t.log.response[0]) for t in trials):
        return _unbounded(trials, begin, reference, free)
    for k in range(rounds):
        groups, members = group(trials, reference, np.exp(theta[1]))
        layouts, arrays = tuple(g[0] for g in groups), tuple(g[1] for g in groups)
        directions = _directions(theta, free)
        if left > NEAR:
            theta = np.asarray(_levenberg_marquardt(theta, directions, layouts, arrays))
            if _ran_away(theta, begin):
                return _unbounded(trials, begin, reference, free)
        gram, gradient, found = jax.device_get(_linearise(theta, directions, layouts, arrays))
        inverse = _invert(gram)
        left = float(gradient @ inverse @ gradient)
        trials, cost, moved = _update(trials, members, found, round_=k)
        change, last = abs(last - cost), cost
        converged = bool(moved < 0.02 and change < 1e-3 + 1e-9 * abs(cost) and left < NEAR)
        if converged and change < 1e-7 + 1e-13 * abs(cost):
            break
        if left <= NEAR:
            theta = theta - directions @ (inverse @ gradient)
            if _ran_away(theta, begin):
                return _unbounded(trials, begin, reference, free)
    covariance = directions @ inverse @ directions.T
    return State(theta, covariance, tuple(trials), _models(trials, members, found), float(cost), converged)


def _directions(theta: np.ndarray, free) -> np.ndarray:
    """(4, free) what a step of one is in theta: a factor e, a half bandwidth, a tenth of one per degC."""
    half_bandwidth = 1 / (2 * np.pi * np.exp(theta[1]))
    return np.diag([1.0, 1.0, half_bandwidth, 0.1 * half_bandwidth])[:, [NAMES.index(n) for n in free]]


def _ran_away(theta: np.ndarray, begin: np.ndarray) -> bool:
    return not (np.all(np.isfinite(theta)) and abs(theta[1] - begin[1]) < RUNAWAY)


def _unbounded(trials, theta, reference, free) -> State:
    """The state where the search began, when nothing holds tau: any tau far from it fits as well."""
    groups, members = group(trials, reference, np.exp(theta[1]))
    directions = _directions(theta, free)
    arrays = (tuple(g[0] for g in groups), tuple(g[1] for g in groups))
    found = jax.device_get(_linearise(theta, directions, *arrays))[2]
    trials, cost, _ = _update(trials, members, found, round_=0)
    covariance = RUNAWAY**2 * directions @ directions.T
    return State(theta, covariance, trials, _models(trials, members, found), cost if np.isfinite(cost) else 0.0, True)


def _models(trials, members, found) -> tuple[np.ndarray, ...]:
    """Modelled rows of each trial."""
    by_trial = {i: d.model[k] for logs, d in zip(members, found, strict=True) for k, i in enumerate(logs)}
    return tuple(by_trial[i][: len(t.log)] for i, t in enumerate(trials))


def _invert(gram: np.ndarray) -> np.ndarray:
    """Inverse of the information matrix; what it does not inform about gets an enormous variance, not an infinite one."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    values, vectors = np.linalg.eigh(np.nan_to_num(gram / np.outer(size, size)))
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
    return inverse / np.outer(size, size)


def _update(trials, members, found, round_: int):
    """Noise and nuisances of each log from the residual at the present theta; the cost there; the largest relative move."""
    updated, cost, moved = list(trials), 0.0, 0.0
    for logs, detail in zip(members, found, strict=True):
        for k, i in enumerate(logs):
            new = _renew(trials[i], detail, k, round_)
            cost += _cost(trials[i], float(np.sum(np.abs(detail.rows[k]) ** 2)))
            change = abs(new.noise_time - trials[i].noise_time) / (new.noise_time or 1.0)
            moved = max(moved, abs(new.noise_std / trials[i].noise_std - 1), change)
            updated[i] = new
    return tuple(updated), cost, moved


def _cost(trial: Trial, total: float) -> float:
    """Negative log-likelihood of one log whose whitened residual has the sum of squares `total`, its level integrated out."""
    channels = 1 if trial.log.amplitude_only else 2
    shrink = 0.5 * np.sum(np.log1p(-(trial.memory() ** 2))) - np.sum(np.log(trial.weight))
    dof = freedom(trial)
    shape = 0.5 * dof * np.log(total / dof) if total > dof or not trial.at_floor else 0.5 * (total - dof)
    return float(shape + dof * np.log(trial.noise_std) + channels * shrink) if total > 0 else -np.inf


def _renew(trial: Trial, detail, k: int, round_: int) -> Trial:
    """The trial with the noise and the nuisances that the residual of row `k` of its group shows."""
    model = detail.model[k][: len(trial.log)]
    left = trial.log.response - (model.real if trial.log.amplitude_only else model)
    std, time = estimate(left * trial.weight, trial.clock, freedom(trial))
    if round_ > 2 and time > 0 and trial.noise_time > 0:
        time = np.sqrt(time * trial.noise_time)  # the fit follows the noise and the noise the fit: half steps do not circle
    new = with_noise(trial, std, time)
    if trial.log.relative_noise and round_ < 10:  # held after a while: a weight that follows the fit may circle
        new = replace(new, level=np.abs(model))
    if trial.signed:
        return new
    # Rice: noise alone lifts the mean of w^2 by its variance; a free floor holds whatever else is there.
    free = new.floor_free and not trial.steady and detail.floor[k] > 0
    held = new.noise_std**2 if trial.steady else 1e-6 * new.noise_std**2
    return replace(new, start=complex(detail.start[k]), floor=float(detail.floor[k]) if free else held, floor_free=bool(free))
