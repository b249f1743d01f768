"""What the minima amount to: the plant, what the logs leave open, and whether the model describes them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.minimise import Minimiser, State
from sysid.model.plant import Plant
from sysid.model.prior import FINGER, NAMES, PLANT, carried, in_units
from sysid.trials.trial import Trial
from sysid.verdict import identify, lone, wording
from sysid.verdict.compressed import compressed
from sysid.verdict.determined import alone, informed, parameter, undescribed, usable
from sysid.verdict.fitted import Fit, beside
from sysid.verdict.hurried import hurried
from sysid.verdict.immediate import responds_at_once
from sysid.verdict.late import SIDES, timed
from sysid.verdict.leaning import leaning
from sysid.verdict.mirrored import mirrored
from sysid.verdict.misfit import Found, misfits
from sysid.verdict.odd import odd_one
from sysid.verdict.result import Result
from sysid.verdict.unexplained import left_of

BETWEEN = ("gain", "tau", "resonance", "finger")  # what is found when a log contradicts the others
NEARLY = 3.0  # log-likelihood within which two explanations of one misfit are both named
ALTERNATIVES = 2  # that are named for one misfit
CONTRADICTS = 3.0  # standard deviations between what the logs tell and what is stated beforehand
SHARES = 0.9  # of the error that the logs alone leave of a parameter: below, the prior speaks too


@dataclass(frozen=True)
class Question:
    """What is asked of the logs: the parameters that are free, and the priors that are stated of them."""

    minimiser: Minimiser
    trials: tuple[Trial, ...]  # as they were read at first
    stated: dict[str, tuple[float, float]]
    reference_temperature: float  # degC, at which f0 is told if k_T is
    warnings: tuple[str, ...]  # what had to be assumed
    dispersion: np.ndarray  # (6, 6) what readings of the logs that cannot be told apart add to the covariance


def conclude(question: Question, states: Sequence[State], hung: Sequence[str]) -> Fit:
    """The fit whose minima are `states`, the best first, of which the error of G is that of the nuisances `hung`."""
    best, free = states[0], question.minimiser.free
    fit = _fit(question, states)
    fit = replace(fit, lone=lone.resting(best, question.minimiser.reference, free, fit.reference_temperature))
    wrong, doubts = _judged(question, best, fit.reference_temperature, "late" in hung)
    coarse = [f"{t.log.name}: {said}" for t in best.trials if (said := wording.coarse(t))]
    turned = [f"{t.log.name}: {said}" for t in best.trials if not wrong and (said := wording.turned(t))]
    believed = _believed(fit, question.reference_temperature)
    parameters = {n: parameter(fit, n, *fit.estimate(n)) for n in NAMES if n in PLANT or n in free}
    result = fit.result
    if result is Result.successful and not usable(parameters, best.trials):
        result = Result.undetermined
    told = result is not Result.undetermined or any(parameters[n].determined for n in PLANT)
    if wrong and (told or any(w.mostly for w in wrong)):
        result = Result.misfit  # a value from logs that the model does not describe is none
        mostly = any(w.mostly for w in wrong)
        parameters = {n: undescribed(p) if n in free and (mostly or not p.determined) else p for n, p in parameters.items()}
    aside = [fit.flank.said()] if fit.flank is not None and informed(fit, "f0", *fit.estimate("f0")) else []
    warnings = (*question.warnings, *coarse, *aside, *doubts, *(w.sentence for w in wrong), *turned, *believed)
    return replace(fit, parameters=parameters, result=result, warnings=warnings)


def _fit(question: Question, states: Sequence[State]) -> Fit:
    """The plant and its covariance, as if the model described the logs."""
    best, free, reference = states[0], question.minimiser.free, question.minimiser.reference
    G, tau = best.G, best.tau
    index = [NAMES.index(n) for n in free]
    drifts = "k_T" in free and np.sqrt((best.alone + best.dispersion)[3, 3]) <= identify.limits(G, tau)["k_T"]
    drifts = drifts and not identify.within_errors(best.trials)
    warm = any(t.log.temperature is not None for t in best.trials)
    at = question.reference_temperature if drifts else (reference[1] if warm else None)
    carry = carried(at - reference[1] if drifts else 0.0)
    values = dict(zip(NAMES, in_units(carry @ best.theta, reference[0]), strict=True))
    known = {n: float(values[n]) if n in free else None for n in PLANT}
    carry = np.diag([G, tau, 1.0, 1.0, 1.0, 1.0]) @ carry  # theta's covariance is of logarithms
    return Fit(
        plant=Plant(**known, reference_temperature=question.reference_temperature if at is None else at),
        parameters={},
        names=free,
        covariance=(carry @ best.spread @ carry.T)[np.ix_(index, index)],
        result=Result.successful if best.converged or identify.hopeless(best.trials, free) else Result.not_converged,
        reference_temperature=at,
        logs=beside(best),
        warnings=(),
        units=_units(best.trials[0].log),
        modes=tuple(states),
        reference=reference,
        priors=question.stated,
    )


class Said(NamedTuple):
    """A sentence on what the model does not describe; `mostly`: it leaves most of a log, of which it then tells nothing."""

    sentence: str
    mostly: bool = False


def _judged(question: Question, best: State, at: float | None, hangs: bool) -> tuple[list[Said], list[str]]:
    """What the model does not describe, which makes the fit a misfit; and sentences on what is only a warning. `at` (degC):
    where f0 is told. `hangs`: G does, on how late the response is."""
    reference, free = question.minimiser.reference, question.minimiser.free
    if (said := identify.overdamped(best, reference)) is not None:
        return [Said(said, True)], []
    found, unseen = misfits(best, reference, free, at)
    likely = _likeliest(timed(_likeliest(found, tried=False), best, reference, free))
    doubted = {f.log for f in likely if f.name == "saturation" and f.harmful and "background" in best.trials[f.log].nuisances}
    full = {i: compressed(question.minimiser, best, i) for i in doubted}
    likely = [f for f in likely if f.name != "saturation" or full.get(f.log, True)]
    wrong, doubts = _described(best, found, likely, FINGER[0] in free)
    for another in (hurried, leaning) if wrong or doubts else ():
        if said := another(question.minimiser, best, found):
            return [Said(said)], []
    if (wrong or doubts) and (said := mirrored(question.minimiser, question.trials, best, likely)):
        return [Said(said)], []
    odd = best.trials if wrong or doubts else [t for t in best.trials if not t.steady]  # a sweep's other range shows in its fit
    if ranges := [f"{t.log.name}: {said}" for t in odd if (said := wording.ranged(t))]:
        return [Said(said) for said in ranges], []
    between = likely and (likely[0].name in BETWEEN or likely[0].log is None)
    gain = likely[0].log if between and likely[0].name == "gain" else None  # to first order, which of a factor of two says little
    if wrong and (not between or gain is not None) and (said := odd_one(question.minimiser, question.trials, best, gain)):
        wrong, doubts = [Said(said)], []
    wrong = wrong or [Said(said) for said in responds_at_once(best, reference)]
    doubts = doubts if wrong else [*doubts, *unseen]
    if hangs and not wrong and not identify.hopeless(best.trials, free):
        doubts = [*doubts, wording.hangs_on_lateness(float(np.sqrt(best.spread[0, 0])))]
    if FINGER[0] in free and (carried := wording.extrapolated(best.trials)):
        doubts = [*doubts, carried]
    return wrong, doubts


def _likeliest(found: Sequence[Found], tried: bool = True) -> list[Found]:
    """Of what explains what the model leaves, the best and those that are hardly worth less; what is worth much less may be a
    shadow of it, and of something that explains nothing by itself as well. More than two alike explain nothing. Whether a delay
    explains it is not known before it is `tried` in full."""
    near = [f for f in found if f.worth >= found[0].worth - NEARLY]
    alike = [f for f in near if f.explains or not (tried or f.name not in SIDES)]
    return alike if len({f.name for f in alike}) <= ALTERNATIVES else []


def _described(state: State, found: Sequence[Found], likely: Sequence[Found], fingered: bool) -> tuple[list[Said], list[str]]:
    """What the model does not describe: what makes the fit a misfit; and sentences on what is only a warning. `found`: all that
    the logs hold, `likely` what of it they say; `fingered`: what a finger does is fitted."""
    harmful = any(f.harmful and f.certain for f in likely)
    shown = [f.log for f in found if f.harmful and f.certain]  # something is there, whatever it is
    named = {f.log: f.sentence for f in reversed(likely)}
    wrong, doubts = [], []
    for i, trial in enumerate(state.trials):
        if trial.silent:
            continue
        if what := (None if fingered else wording.touched(trial)) or wording.clipped(trial):
            wrong.append(Said(f"{trial.log.name}: {what}"))
            continue
        known = harmful and (i in named or None in named)
        left = None if known else left_of(state, i, not harmful and i in shown)
        if left is not None and left.noise:
            doubts.append(f"{trial.log.name}: {left.said}")
        elif left is not None:
            wrong.append(Said(named.get(i, f"{trial.log.name}: {left.said}"), left.mostly and i not in named))
    if harmful:
        names = {f.name: f.sentence for f in reversed(likely)}
        return [*wrong, Said("; or else ".join(reversed(names.values())))], []
    if None in shown and not wrong:
        wrong = [Said(next(f.sentence for f in found if f.log is None and f.harmful and f.certain))]  # in no log by itself
    return wrong, [*doubts, *(f"{f.sentence} ({_unharmed(f)})" for f in likely[:1])]


def _unharmed(found: Found) -> str:
    """Why what the logs hold is no more than a warning."""
    if not found.harmful:
        return "no parameter leaves its interval"
    moved = f"move {found.farthest} by {found.moves[found.farthest]:+.2g} of its standard deviations"
    return f"perhaps: chance alone looks like this in one good fit of a hundred; it would {moved}"


def _believed(fit: Fit, reference_temperature: float) -> list[str]:
    """Sentences on where what was stated beforehand speaks, and where the logs contradict it."""
    said = []
    for name, (value, std) in fit.priors.items():
        found, error = alone(fit, name, reference_temperature)
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


def _units(log: Log) -> dict[str, str]:
    gain = log.response_unit if log.drive is None else f"{log.response_unit}/{log.drive_unit}"
    return {"G": gain, "tau": "s", "f0": "Hz", "k_T": "Hz/degC", "finger_damping": "1", "finger_detuning": "Hz"}
