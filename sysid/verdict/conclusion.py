"""What the minima amount to: the plant, what the logs leave open, and whether the model describes them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.images import seldom_alias
from sysid.minimum.minimise import Minimiser, State
from sysid.model.plant import Plant
from sysid.model.theta import FINGER, NAMES, PLANT, carried, in_units, std_of
from sysid.trials.trial import Trial
from sysid.verdict import identify, lone, recorder, wording
from sysid.verdict.conjugate_phase import mirrored
from sysid.verdict.determined import alone, enough, informed, parameter, undescribed
from sysid.verdict.differing import dispersion
from sysid.verdict.finding import Finding
from sysid.verdict.fitted import Fit, beside
from sysid.verdict.immediate import responds_at_once
from sysid.verdict.inconsistent_log import odd_ones
from sysid.verdict.linear import Found
from sysid.verdict.low_pass import low_pass
from sysid.verdict.misfit import Misfits, misfits
from sysid.verdict.remains import remains
from sysid.verdict.result import Parameter, Result
from sysid.verdict.unexplained import left_of, slow

BETWEEN = ("gain", "tau", "resonance", "finger")  # what is found when a log contradicts the others
NEARLY = 3.0  # log-likelihood within which two explanations of one misfit are both named
ALTERNATIVES = 2  # that are named for one misfit
CONTRADICTS = 3.0  # standard deviations between what the logs tell and what is stated beforehand
SHARES = 0.9  # of the error that the logs alone leave of a parameter: below, the prior speaks too


@dataclass(frozen=True)
class FitProblem:
    """What is asked of the logs: the parameters that are free, and the priors that are stated of them."""

    minimiser: Minimiser
    trials: tuple[Trial, ...]  # as they were read at first
    stated: dict[str, tuple[float, float]]
    reference_temperature: float  # degC, at which f0 is told if k_T is
    warnings: tuple[str, ...]  # what had to be assumed
    dispersion: np.ndarray  # (6, 6) what readings of the logs that cannot be told apart add to the covariance
    # of logs of which it is not stated, as the plate alone decided it, by their places
    sampling: dict[int, str] = field(default_factory=dict)
    effects: tuple[Finding, ...] = ()  # with which the logs are read
    told: float | None = None  # degC, where f0 and k_T are told, about which effects were fitted


class Judged(NamedTuple):
    """What a minimum leaves undescribed: by which the fit is `wrong`, and `doubts` that are only a warning.
    `found`: what the logs hold to first order; `open`: an effect that is tried in full may explain it. Else
    the cause is plain, or nothing is there. `apart`: each log is described, and they differ, which adds so
    much to the covariance (6, 6): that may be what the plate does, and no log by itself. `looked`: all that
    was tried to first order."""

    wrong: list[Finding]
    doubts: list[Finding]
    found: list[Found]
    open: bool = False
    apart: np.ndarray | None = None
    looked: Misfits = Misfits([], [])
    unsure: bool = False
    bend: float = 0.0


def conclude(
    question: FitProblem, states: Sequence[State], hung: Sequence[str], judged: Judged | None = None
) -> Fit:
    """The fit whose minima are `states`, the best first, of which the error of G is that of the nuisances
    `hung`; `judged` unless that is known."""
    best, free = states[0], question.minimiser.free
    fit = _fit(question, states)
    alone = lone.resting(best, question.minimiser.reference, free, fit.reference_temperature)
    fit = replace(fit, lone=alone, findings=tuple(question.effects))
    judged = judged or _judged(question, best, fit.reference_temperature, "late" in hung)
    wrong, doubts = judged.wrong, judged.doubts
    coarse = [f"{t.log.name}: {said}" for t in best.trials if (said := recorder.coarse(t))]
    turned = [f"{t.log.name}: {said}" for t in best.trials if not wrong and (said := wording.turned(t))]
    believed = _believed(fit, question.reference_temperature)
    parameters, result = _parameters(fit), fit.result
    bare = _parameters(_fit(question, [_bare(s) for s in states])) if wrong else parameters
    if result is Result.successful and not enough(parameters, best.trials):
        result = Result.undetermined
    # but for what errors span beside what is wrong
    any_told = result is not Result.undetermined or any(bare[n].determined for n in PLANT)
    mostly = any(w.mostly for w in wrong)
    if wrong and (any_told or mostly):
        result = Result.misfit  # a value from logs that the model does not describe is none
        wider = question.dispersion + _undescribed(best, question.minimiser, judged)
        states = [replace(s, dispersion=s.dispersion + wider) for s in states]
        fit = replace(_fit(question, states), lone=alone, findings=fit.findings)
        parameters = {
            n: undescribed(p) if n in free and (mostly or not p.determined) else p
            for n, p in _parameters(fit).items()
        }
    aside = [fit.flank.said()] if fit.flank is not None and informed(fit, "f0", *fit.estimate("f0")) else []
    told = [f.sentence for f in (*question.effects, *doubts, *wrong)]
    warnings = (*question.warnings, *coarse, *aside, *told, *turned, *believed)
    findings = (*question.effects, *wrong, *doubts)
    return replace(
        fit, parameters=parameters, result=result, warnings=warnings, findings=findings, judged=judged
    )


def _bare(state: State) -> State:
    """A minimum with the errors of its noise alone."""
    return replace(state, dispersion=np.zeros_like(state.dispersion))


def _parameters(fit: Fit) -> dict[str, Parameter]:
    """What the fit tells of each."""
    return {n: parameter(fit, n, *fit.estimate(n)) for n in NAMES if n in PLANT or n in fit.names}


def _undescribed(best: State, minimiser: Minimiser, judged: Judged) -> np.ndarray:
    """(6, 6) what logs that no plate describes add to the covariance of theta: what is left of them, and one
    plate is no better known than its logs agree."""
    left = remains(best, minimiser.reference, minimiser.free)
    if judged.apart is not None:
        return left + judged.apart
    differ = any(w.key in (*BETWEEN, "odd") for w in judged.wrong)
    return left + dispersion(best, minimiser.reference, minimiser.free)[0] if differ else left


def _fit(question: FitProblem, states: Sequence[State]) -> Fit:
    """The plant and its covariance, as if the model described the logs."""
    best, free, reference = states[0], question.minimiser.free, question.minimiser.reference
    G, tau = best.G, best.tau
    index = [NAMES.index(n) for n in free]
    drifts = "k_T" in free and std_of(best.alone + best.dispersion, "k_T") <= identify.limits(G, tau)["k_T"]
    drifts = drifts and not identify.within_errors(best.trials)
    warm = any(t.log.temperature is not None for t in best.trials)
    at = question.reference_temperature if drifts else (reference[1] if warm else None)
    at = at if question.told is None else question.told
    carry = carried(0.0 if at is None else at - reference[1])
    values = dict(zip(NAMES, in_units(carry @ best.theta, reference[0]), strict=True))
    known = {n: float(values[n]) if n in free else None for n in PLANT}
    carry = np.diag([G, tau, 1.0, 1.0, 1.0, 1.0]) @ carry  # theta's covariance is of logarithms
    return Fit(
        plant=Plant(**known, reference_temperature=question.reference_temperature if at is None else at),
        parameters={},
        names=free,
        covariance=(carry @ best.spread @ carry.T)[np.ix_(index, index)],
        result=Result.successful
        if best.converged or identify.hopeless(best.trials, free)
        else Result.not_converged,
        reference_temperature=at,
        logs=beside(best),
        warnings=(),
        units=_units([t.log for t in best.trials]),
        modes=tuple(states),
        reference=reference,
        priors=question.stated,
    )


def _judged(question: FitProblem, best: State, at: float | None, hangs: bool) -> Judged:
    """What the model does not describe. `at` (degC): where f0 is told. `hangs`: G does, on how late the
    response is."""
    reference, free = question.minimiser.reference, question.minimiser.free
    if identify.overdamped(best, reference):
        numbers = low_pass(best, len(free)) or {}
        said = wording.without_resonance(numbers)
        return Judged([Finding("overdamped", "refused", said, numbers=numbers, mostly=True)], [], [])
    found, unseen, *_ = looked = misfits(best, reference, free, at)
    likely = likeliest(found)
    wrong, doubts = _described(best, found, FINGER[0] in free)
    some = (
        best.trials if wrong or doubts else [t for t in best.trials if not t.steady]
    )  # a sweep's other range shows in its fit
    if ranges := [(t.log.name, said) for t in some if (said := recorder.ranged(t))]:
        return Judged(
            [Finding("range", "refused", f"{name}: {said}", (name,), mostly=True) for name, said in ranges],
            [],
            [],
        )
    if (wrong or doubts) and (turned := mirrored(question.minimiser, question.trials, best, likely)):
        found = [turned, *found]
        wrong, doubts = _described(best, found, FINGER[0] in free)
        return Judged(wrong, doubts, found, looked=looked)
    alike = likely and likely[0].log is None  # what is in all logs contradicts none
    if wrong and not alike and (odd := odd_ones(question.minimiser, question.trials, best)):
        tells = bool(np.any(odd.dispersion))
        return Judged([odd.finding], [], found, tells, odd.dispersion, looked, bend=odd.bend)
    described = not (
        wrong or any(f.certain for f in found) or any(slow(best, i) for i in range(len(best.trials)))
    )
    wrong = wrong or [Finding("immediate", "refused", said) for said in responds_at_once(best, reference)]
    doubts = doubts if wrong else [*doubts, *(Finding("unseen", "noted", said) for said in unseen)]
    if hangs and not wrong and not identify.hopeless(best.trials, free):
        sweeps = [t.log.name for t in best.trials if t.steady and t.driven and "gain" in t.nuisances]
        said = wording.hangs_on_lateness(std_of(best.spread, "G"), sweeps)
        doubts = [*doubts, Finding("late", "noted", said)]
    told = not (wrong or identify.hopeless(best.trials, free) or identify.buried(best.trials))
    if told and (other := seldom_alias(best.trials, best.theta, reference)):
        trial, *of = other
        said = wording.aliased(trial.log.name, trial.spacing, *of)
        doubts = [*doubts, Finding("alias", "noted", said, (trial.log.name,))]
    if FINGER[0] in free and (carried := recorder.extrapolated(best.trials)):
        doubts = [*doubts, Finding("finger", "noted", carried)]
    # Rows that are to be recorded again before anything is told of them.
    spoilt = any(f.key == "rows" for f in wrong)
    return Judged(wrong, doubts, found, not described and not spoilt, looked=looked)


def retold(
    judged: Judged,
    state: State,
    named: Sequence[Finding],
    refuted: Collection[tuple[str, int]],
    unsure: Collection[str],
    fingered: bool,
) -> Judged:
    """The same after effects were tried in full: those `named` explain most of their logs, and what is
    `refuted` explains nothing, nor is it there where it harms nothing; nor does it show that anything is, if
    it is `unsure` to be there. `fingered`: what a finger does is fitted."""
    if not (judged.wrong or named):
        out = {(name, state.trials[i].log.name) for name, i in refuted}
        return judged._replace(
            doubts=[d for d in judged.doubts if not out.intersection(product((d.key,), d.logs))]
        )
    found = [
        replace(f, explains=False, certain=f.certain and f.name not in unsure)
        if (f.name, f.log) in refuted
        else f
        for f in judged.found
    ]
    wrong, doubts = _described(state, found, fingered)
    if named:
        about = {name for f in named for name in f.logs}
        wrong = [*(w for w in wrong if w.logs and about.isdisjoint(w.logs)), *named]
        doubts = [d for d in doubts if about.isdisjoint(d.logs)]
    return Judged(wrong, doubts, found, looked=judged.looked)


def likeliest(found: Sequence[Found]) -> list[Found]:
    """Of what explains what the model leaves, the best and those that are hardly worth less; what is worth
    much less may be a shadow of it, and of something that explains nothing by itself as well. More than two
    alike explain nothing."""
    alike = [f for f in found if f.worth >= found[0].worth - NEARLY and f.explains]
    return alike if len({f.name for f in alike}) <= ALTERNATIVES else []


def _described(state: State, found: Sequence[Found], fingered: bool) -> tuple[list[Finding], list[Finding]]:
    """What the model does not describe: what makes the fit a misfit; and what is only a warning. `found`: all
    that the logs hold; `fingered`: what a finger does is fitted."""
    spoilt = {i: what for i, t in enumerate(state.trials) if not t.silent and (what := _spoilt(t, fingered))}
    if spoilt:  # what all logs may hold is seen in these as well
        found = [f for f in found if f.log is not None and f.log not in spoilt]
    likely = likeliest(found)
    harmful = any(f.harmful and f.certain for f in likely)
    shown = [f.log for f in found if f.harmful and f.certain]  # something is there, whatever it is
    kinds = {f.name for f in likely}  # what is in one log may be in others, and worth less there
    named = {f.log: f for f in reversed(found) if f.explains and f.name in kinds}
    wrong, doubts = [], []
    for i, trial in enumerate(state.trials):
        if trial.silent:
            continue
        name = (trial.log.name,)
        if i in spoilt:
            wrong.append(Finding("rows", "refused", f"{name[0]}: {spoilt[i]}", name))
            continue
        known = harmful and (i in named or None in named)
        left = None if known else left_of(state, i, not harmful and i in shown)
        if left is not None and left.noise:
            doubts.append(Finding("noise", "noted", f"{name[0]}: {left.said}", name))
        elif left is not None and (cause := named.get(i, named.get(None))):
            told = _told(cause, state, "refused", cause.sentence)
            wrong += [] if told in wrong else [told]  # what is in all logs is told once
        elif left is not None:
            wrong.append(
                Finding("unexplained", "refused", f"{name[0]}: {left.said}", name, mostly=left.mostly)
            )
    if harmful:
        names = {f.name: f.sentence for f in reversed(likely)}
        return [*wrong, _told(likely[0], state, "refused", "; or else ".join(reversed(names.values())))], []
    if None in shown and not wrong:  # in no log by itself
        every = next(f for f in found if f.log is None and f.harmful and f.certain)
        wrong = [_told(every, state, "refused", every.sentence)]
    said = {(w.key, w.sentence) for w in wrong}
    noted = [f for f in likely[:1] if (f.name, f.sentence) not in said]
    return wrong, [*doubts, *doubted(noted, [t.log.name for t in state.trials])]


def _spoilt(trial: Trial, fingered: bool) -> str | None:
    """What rows of a log show by themselves, without which nothing else is told of it."""
    return (None if fingered else recorder.touched(trial)) or recorder.clipped(trial)


def doubted(likely: Sequence[Found], names: Sequence[str]) -> list[Finding]:
    """The first of what is `likely` in logs of these names as a warning, where nothing that is certain moves
    a parameter far."""
    return [_finding(f, names, "noted", f"{f.sentence} ({_unharmed(f)})") for f in likely[:1]]


def _told(found: Found, state: State, outcome: str, sentence: str) -> Finding:
    return _finding(found, [t.log.name for t in state.trials], outcome, sentence)


def _finding(found: Found, names: Sequence[str], outcome: str, sentence: str) -> Finding:
    logs = () if found.log is None else (names[found.log],)
    return Finding(found.name, outcome, sentence, logs, found.numbers, found.worth, found.moves, found.mostly)


def _unharmed(found: Found) -> str:
    """Why what the logs hold is no more than a warning."""
    if not found.harmful:
        return "no parameter leaves its interval"
    moved = f"move {found.farthest} by {found.moves[found.farthest]:+.2g} of its standard deviations"
    often = "hundred" if found.plates == 1 else f"thousand, and this run has up to {found.plates}"
    return f"perhaps: chance alone looks like this in one good fit of a {often}; it would {moved}"


def _believed(fit: Fit, reference_temperature: float) -> list[str]:
    """Sentences on where what was stated beforehand speaks, or contradicts logs that are not described
    without it either."""
    said = []
    for name, (value, std) in fit.priors.items():
        found, error = alone(fit, name, reference_temperature)
        known = f"{value:.7g} ± {std:.2g} {fit.units[name]}"
        if abs(found - value) > CONTRADICTS * np.hypot(error, std):
            said.append(
                f"{name}: the logs contradict what is stated beforehand, {known}; check which is wrong, and"
                " in which unit"
            )
        elif 1 / np.hypot(1 / error, 1 / std) < SHARES * error:
            said.append(
                f"{name}: what is stated beforehand speaks, {known}; the logs alone leave ± {error:.2g}"
            )
    return said


def opposed(fit: Fit, stated: Mapping[str, tuple[float, float]], at: float) -> Fit | None:
    """The fit without what was stated beforehand, of f0 `at` (degC), if the logs are described without it and
    contradict it in every minimum, which it says."""
    said = []
    for name, (value, std) in stated.items() if fit.result is Result.successful else ():
        each = [alone(replace(fit, modes=(mode,)), name, at) for mode in fit.modes]
        apart = [abs(found - value) / float(np.hypot(error, std)) for found, error in each]
        if name in fit.names and min(apart) > CONTRADICTS:
            said.append(wording.contradicts(name, fit.units[name], each[0], (value, std), apart[0]))
    return replace(fit, warnings=(*said, *fit.warnings)) if said else None


def tells(fit: Fit, before: Fit) -> bool:
    """Whether a fit, of logs that leave something open, determines what another did."""
    known = [n for n, p in before.parameters.items() if p.determined]
    told = [n for n, p in fit.parameters.items() if p.determined]
    return fit.result is Result.undetermined and bool(told) and set(known) <= set(told)


def _units(logs: Sequence[Log]) -> dict[str, str]:
    drive, unit = next((log.drive_unit for log in logs if log.drive is not None), ""), logs[0].response_unit
    gain = f"{unit}/{drive}" if drive else unit
    return {
        "G": gain,
        "tau": "s",
        "f0": "Hz",
        "k_T": "Hz/degC",
        "finger_damping": "1",
        "finger_detuning": "Hz",
    }
