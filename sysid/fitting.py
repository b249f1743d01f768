"""The fit: all logs in one likelihood, Levenberg-Marquardt from starting values that the data give."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sysid import identify, wording
from sysid.coincidence import hangs, tightened
from sysid.condense import taken, undelayed
from sysid.dwell import SETTLED, dwells, of_own_inputs
from sysid.extra import EXTRA
from sysid.guess import candidates
from sysid.late import timed
from sysid.log import Log
from sysid.minimise import Minimiser, State, shares
from sysid.misfit import Found, misfits
from sysid.noise import Level
from sysid.odd import odd_one
from sysid.plant import Plant
from sysid.precision import float64
from sysid.prior import FINGER, NAMES, PLANT, POSITIVE, Prior, checked
from sysid.result import Parameter, Result
from sysid.trial import LEAST_TOUCH, LEAST_WARMING, NUISANCES, Trial


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
    covariance: np.ndarray
    result: Result
    reference_temperature: float | None
    logs: tuple[FittedLog, ...]
    warnings: tuple[str, ...]
    units: dict[str, str]
    modes: tuple[State, ...] = field(repr=False)  # the best first
    reference: tuple[float, float] = field(repr=False)  # Hz, degC: where theta's offsets are taken from
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)  # that were stated: value and standard deviation

    @property
    def cost(self) -> float:
        """Negative log-likelihood, noise levels and nuisances eliminated, up to a constant of the logs."""
        return self.modes[0].cost


@float64
def fit(
    logs: Sequence[Log],
    *,
    nuisances: Sequence[str] = NUISANCES,
    priors: Mapping[str, tuple[float, float]] | None = None,
    reference_temperature: float = 24.0,
    start: Plant | None = None,
    meanwhile: Callable[[State, tuple[float, float]], None] | None = None,
) -> Fit:
    """Fit one plant to all `logs`, from no start values.

    `nuisances`: what the bench may have added to each log and is eliminated: "rotation" of the demodulator, "background"
    (feedthrough of the drive; over a sweep a constant and a slope), "offset" of the output, "start" (state at the first row),
    "late" (a trigger, a demodulator); and, on request, "drift", "lag" and "gain" (see `sysid.extra`).
    `priors`: what is known of the plant beforehand, value and standard deviation by name, for example {"k_T": (-8.0, 1.0)}
    (see `sysid.prior`); flat unless stated. What the logs alone do not determine stays undetermined.
    `start`: a plant to begin from instead of the data. `meanwhile`: is given the best minimum, and the reference (Hz, degC) of
    its offsets, before the fit looks for what the model leaves out. Raises ValueError without logs, for an unknown nuisance, or
    for a prior that is none.
    """
    if not logs:
        raise ValueError("no logs to fit")
    if unknown := set(nuisances) - {*NUISANCES, *EXTRA}:
        raise ValueError(f"unknown nuisance {sorted(unknown)}; known are {', '.join((*NUISANCES, *EXTRA))}")
    _check_units(logs)
    trials, warnings = _trials(logs, tuple(nuisances))
    reference = _reference(trials)
    free = _free(trials)
    stated = {name: given for name, given in checked(priors or {}).items() if name in free}
    unused = [name for name in priors or {} if name not in stated]
    warnings += [f"{name}: what is stated of it beforehand is not used: these logs say nothing of it" for name in unused]
    warm = any(t.log.temperature is not None for t in trials)
    prior = Prior.of(stated, reference, reference_temperature - reference[1] if warm else 0.0)
    minimiser = Minimiser(reference, free, prior)
    states = minimiser.minima(trials, start)
    flipped = tuple(_read_as(t, log.sampling, np.exp(states[0].theta[1])) for t, log in zip(trials, logs, strict=True))
    if any(now is not before for now, before in zip(flipped, trials, strict=True)):
        states = minimiser.minima(flipped, start)
    said = (wording.sampled(t, log.sampling) for t, log in zip(flipped, logs, strict=True))
    warnings += [f"{log.name}: {what}" for log, what in zip(logs, said, strict=True) if what]
    odd = partial(odd_one, minimiser, flipped)
    known, best = (reference, free, warnings, reference_temperature, stated, odd), states[0]
    if meanwhile is not None:
        meanwhile(best, reference)
    if len(states) > 1 or not (names := hangs(best, reference, free)):
        return _conclude(states, *known)
    narrow = _conclude([minimiser.refine(tightened(best, reference, names), best.theta)], *known)
    if narrow.result is not Result.misfit:
        return narrow
    wide = _conclude(states, *known)
    return wide if wide.result is Result.misfit else narrow


def _check_units(logs: Sequence[Log]) -> None:
    for log in logs:
        drive = log.drive_unit if log.drive is not None and logs[0].drive is not None else logs[0].drive_unit
        if (log.response_unit, drive) != (logs[0].response_unit, logs[0].drive_unit):
            raise ValueError(
                f"{log.name}: found units {log.response_unit} and {log.drive_unit}, expected {logs[0].response_unit} and"
                f" {logs[0].drive_unit} as in {logs[0].name}; logs that are read together by read_logs agree"
            )


def _conclude(
    states: list[State],
    reference,
    free,
    warnings: list[str],
    reference_temperature: float,
    stated,
    odd: Callable[[State], str | None],
) -> Fit:
    best = states[0]
    G, tau = np.exp(best.theta[:2])
    index = [NAMES.index(n) for n in free]
    units = _units(best.trials[0].log)
    # theta's covariance is of logarithms; f0 is carried to the temperature at which it is reported.
    drifts = "k_T" in free and np.sqrt(best.alone[3, 3]) <= identify.limits(G, tau)["k_T"]
    warm = any(t.log.temperature is not None for t in best.trials)
    at = reference_temperature if drifts else (reference[1] if warm else None)
    carry = np.diag([G, tau, 1.0, 1.0, 1.0, 1.0])
    carry[2, 3] = at - reference[1] if drifts else 0.0
    covariance = (carry @ best.covariance @ carry.T)[np.ix_(index, index)]
    values = dict(zip(NAMES, best.theta, strict=True))
    values |= {"G": G, "tau": tau, "f0": reference[0] + best.theta[2] + carry[2, 3] * best.theta[3]}
    known = {n: float(values[n]) if n in free else None for n in PLANT}
    plant = Plant(**known, reference_temperature=reference_temperature if at is None else at)
    estimates = {n: (float(values[n]), float(s)) for n, s in zip(free, np.sqrt(np.diag(covariance)), strict=True)}
    found, unseen = misfits(best, reference, free, at)
    found = timed(_likeliest(found), best, reference, free)
    described, doubts = _described(best, found, FINGER[0] in free)
    between = found and (found[0].name in BETWEEN or found[0].log is None)
    if described and not between and (said := odd(best)):
        described, doubts = [said], []
    doubts = doubts if described else [*doubts, *unseen]
    if "late" in hangs(best, reference, free) and not identify.hopeless(best.trials, free):
        doubts = [*doubts, wording.hangs_on_lateness(float(np.sqrt(best.covariance[0, 0])))]
    if FINGER[0] in free and (carried := wording.extrapolated(best.trials)):
        doubts = [*doubts, carried]
    coarse = [f"{t.log.name}: {said}" for t in best.trials if (said := wording.coarse(t))]
    warnings = warnings + coarse + doubts + described
    result = Result.successful if best.converged or identify.hopeless(best.trials, free) else Result.not_converged
    fitted = Fit(
        plant, {}, free, covariance, result, at, _fitted(best), tuple(warnings), units, tuple(states), reference, stated
    )
    fitted = replace(fitted, warnings=(*fitted.warnings, *_believed(fitted, reference_temperature)))
    named = [n for n in NAMES if n in PLANT or n in free]
    parameters = {n: parameter(fitted, n, *estimates.get(n, (np.nan, np.inf))) for n in named}
    if result is Result.successful and not usable(parameters, best.trials):
        result = Result.undetermined
    if described and (result is not Result.undetermined or any(parameters[n].determined for n in PLANT)):
        result = Result.misfit  # a value from logs that the model does not describe is none
    return replace(fitted, parameters=parameters, result=result)


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
    modes, limit = _modes(fit, name), identify.limits(G, tau)[name]
    told = name in fit.names and (not fit.priors or _alone(fit, name)[1] <= limit) and _shown(fit, name)
    if told and np.isfinite(value) and not modes and std <= limit:
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
    known = name not in ("f0", "k_T") or np.sqrt(state.covariance[1, 1]) <= identify.RELATIVE
    return known or not identify.buried(state.trials)


def _alone(fit: Fit, name: str, at: float | None = None) -> tuple[float, float]:
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


CONTRADICTS = 3.0  # standard deviations between what the logs tell and what is stated beforehand
SHARES = 0.9  # of the error that the logs alone leave of a parameter: below, the prior speaks too


def _believed(fit: Fit, reference_temperature: float) -> list[str]:
    """Sentences on where what was stated beforehand speaks, and where the logs contradict it."""
    said = []
    for name, (value, std) in fit.priors.items():
        found, error = _alone(fit, name, reference_temperature)
        unit = fit.units[name]
        apart = abs(found - value) / np.hypot(error, std)
        if apart > CONTRADICTS:
            said.append(
                f"{name}: the logs alone say {found:.7g} ± {error:.2g} {unit}, {apart:.2g} standard deviations from what is"
                f" stated beforehand, {value:.7g} ± {std:.2g}; check which is wrong"
            )
        elif 1 / np.hypot(1 / error, 1 / std) < SHARES * error:
            known = f"{value:.7g} ± {std:.2g} {unit}"
            said.append(f"{name}: what is stated beforehand speaks, {known}; the logs alone leave ± {error:.2g}")
    return said


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


def _units(log: Log) -> dict[str, str]:
    gain = log.response_unit if log.drive is None else f"{log.response_unit}/{log.drive_unit}"
    return {"G": gain, "tau": "s", "f0": "Hz", "k_T": "Hz/degC", "finger_damping": "1", "finger_detuning": "Hz"}


BETWEEN = ("gain", "tau", "resonance", "finger")  # what is found when a log contradicts the others
NEARLY = 3.0  # log-likelihood within which two explanations of one misfit are both named


def _likeliest(found: Sequence[Found]) -> list[Found]:
    """What is worth less may be a shadow of what is worth more."""
    return [f for f in found if f.worth >= found[0].worth - NEARLY]


def _described(state: State, found: Sequence[Found], fingered: bool) -> tuple[list[str], list[str]]:
    """Sentences on what the model does not describe: what makes the fit a misfit, and what is only a warning. `fingered`: what a
    finger does is fitted."""
    harmful = any(f.harmful and f.certain for f in found)
    named = {f.log for f in found} if harmful else set()
    said = []
    for i, (trial, model) in enumerate(zip(state.trials, state.models, strict=True)):
        if trial.silent:
            continue
        model = model.real if trial.log.amplitude_only else model
        what = (None if fingered else wording.touched(trial)) or wording.clipped(trial)
        if not what and not named & {i, None}:
            what = wording.misfit(trial, model, trial.residual(model), float(np.exp(state.theta[1])))
        said += [f"{trial.log.name}: {what}"] if what else []
    if harmful:
        likely = {f.name: f.sentence for f in reversed(found)}
        return [*said, "; or else ".join(reversed(likely.values()))], []
    steps = {i for i, trial in enumerate(state.trials) if wording.coarse(trial)}  # which are no noise, and look like anything
    return said, [f"{f.sentence} ({_unharmed(f)})" for f in found[:1] if f.log not in steps]


def _unharmed(found: Found) -> str:
    """Why what the logs hold is no more than a warning."""
    if not found.harmful:
        return "no parameter leaves its interval"
    moved = f"move {found.farthest} by {found.moves[found.farthest]:+.2g} of its standard deviations"
    return f"perhaps: one good fit in a hundred looks so by chance; it would {moved}"


def _fitted(state: State) -> tuple[FittedLog, ...]:
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
                rows=int(trial.count.sum()),
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
        if log.kind is None or (log.kind == "transient" and log.sampling is None and dwells(log, 0.0)):
            trial = _read_as(trial, log.sampling, candidates(trial)[0][0])
        if trial.start_free and not trial.signed:
            trial = replace(trial, start=complex(np.mean(log.response[:3])))
        trials.append(trial)
        warnings += [f"{log.name}: {note}" for note in wording.assumptions(trial)]
    if any(t.touched for t in trials):
        unknown = [t.log.name for t in trials if t.log.force is None]
        warnings += [f"{name}: no force is recorded; taken as with nothing on the plate" for name in unknown]
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
    contact = [t.inputs.contact for t in trials]
    touched = max(c.max() for c in contact) - min(c.min() for c in contact) > LEAST_TOUCH
    possible = {
        "G": any(t.driven for t in trials),
        "tau": True,
        "f0": any(t.resonant for t in trials),
        "k_T": span > LEAST_WARMING,
        "finger_damping": touched,
        "finger_detuning": touched and any(t.resonant and t.touched for t in trials),
    }
    return tuple(name for name in NAMES if possible[name])


def _read_as(trial: Trial, sampling: str | None, tau: float) -> Trial:
    """A timed sweep as it is read where its kind or its `sampling` is not stated. Its rows are settled points if each dwells long
    enough for `tau`; if its frequency also stays or returns it is a transient, whose rows may belong to their own inputs."""
    log, kind = trial.whole or (undelayed(trial.log, -1.0) if trial.steady else trial.log), trial.kind
    if log.kind is None:
        kind = "steady" if np.median(np.diff(log.time)) >= SETTLED * tau else "transient"
    if sampling is None and log.kind == "transient":
        sampling = "settled" if dwells(log, tau) and of_own_inputs(log) else None
    if (kind, sampling) == (trial.kind, log.sampling):
        return trial
    return replace(Trial.of(replace(log, sampling=sampling), kind, trial.nuisances), start=trial.start)
