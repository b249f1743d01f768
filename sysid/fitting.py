"""The fit: all logs in one likelihood, Levenberg-Marquardt from starting values that the data give."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid import reading
from sysid.adoption.adopt import tried
from sysid.adoption.description import Description
from sysid.asked import LOG, every, temperature
from sysid.asked import given as of_kind
from sysid.effects.registry import ADOPTED, EFFECTS, EVERY, chosen
from sysid.logs.log import Log
from sysid.logs.together import in_common_units
from sysid.minimum.minimise import ESTIMATED, Minimiser, State
from sysid.minimum.ridge import unfolded
from sysid.model.plant import Plant
from sysid.model.prior import Prior, checked
from sysid.model.theta import Theta
from sysid.precision import float64, one_thread
from sysid.trials.extra import EXTRA, with_thermometers
from sysid.trials.trial import Trial
from sysid.verdict import wording
from sysid.verdict.amplitude_offset import with_offsets
from sysid.verdict.averaged import Hint
from sysid.verdict.conclusion import FitProblem, Judged, conclude, opposed, retold, tells
from sysid.verdict.decay import Cause, decays, of_decays
from sysid.verdict.differing import Said, dispersion
from sysid.verdict.finding import Finding
from sysid.verdict.fitted import Fit
from sysid.verdict.gain_confounding import confounds_gain, tightened, with_feedthroughs
from sysid.verdict.ownership import OTHER, otherwise, owned
from sysid.verdict.result import Result
from sysid.verdict.sensor_delay import with_delays
from sysid.verdict.unexplained import noise_like, slow

log = logging.getLogger(__name__)
TWICE = 2  # in a first fit the feedthrough of other logs makes up for what points at one frequency lack
WIDER = 1.5  # times the error of G, from which it is that of a feedthrough that may be a delay


@one_thread
@float64
def fit(
    logs: Log | Sequence[Log],
    *,
    nuisances: str | Sequence[str] = EVERY,
    effects: str | Sequence[str] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    reference_temperature: float = 24.0,
    start: Plant | None = None,
) -> Fit:
    """Fit one plant to all `logs`, or to one, from no start values.

    `nuisances`: what the bench may have added to each log and is eliminated: "rotation" of the demodulator,
    "background" (feedthrough of the drive; over a sweep a constant and a slope), "offset" of the output,
    "start" (state at the first row), "late" (a trigger, a demodulator), "thermometer" (the error of its
    readings); and, on request, "drift", "lag" and "gain" (see `trials.extra`), and "baseline" (an offset of a
    transient that goes on with the time). Adopted only where the plate alone does not describe the logs:
    "delay", "filter" (of a lock-in that no log states), "dwell", "duffing", "second_mode" and "feedthrough"
    under an amplitude (see `effects.registry`). `effects`: in the place of these what the command's --effects
    takes, "-late" (the usual ones without it), "-delay,+drift", "rotation,offset" or "none". `priors`: what
    is known of the plant beforehand, value and standard deviation by name, as in {"k_T": (-8.0, 1.0)} (see
    `model.prior`); flat unless stated, or where the logs contradict it. What the logs alone do not determine
    stays undetermined. `start`: a plant to begin from instead of the data. Raises ValueError without logs,
    for an unknown nuisance, or for a prior that is none; TypeError for what are no logs."""
    logs = every("logs", logs, Log, LOG)
    nuisances = _named(nuisances, effects)
    reference_temperature = temperature("reference_temperature", reference_temperature)
    of_kind("start", start, Plant | None, "a sysid.Plant")
    given = {"nuisances": nuisances, "priors": priors, "reference_temperature": reference_temperature}
    if priors:
        stated = checked(priors)
        plain = fit(logs, nuisances=nuisances, reference_temperature=reference_temperature, start=start)
        if (told := opposed(plain, stated, reference_temperature)) is not None:
            return told
    question, states = _asked(logs, nuisances, priors, reference_temperature, start)
    best = states[0]
    found = _concluded(question, states)
    ranged = any(f.key == "range" for f in found.findings)  # whose rows are to be scaled before anything else
    restless, cause = [] if ranged else decays(best)[0], None
    names = _called_for(best, found.judged, nuisances)
    if found.judged.open and names:
        log.info("whether one of %s describes what is left", ", ".join(names))
        question, found, cause = _with_effects(question, found, names, bool(restless))
    # a plant of another kind decays as one of this too
    other = cause and any(f.mostly for f in found.findings)
    # a decay that needs effects of its own is no better witness than a whole that one describes
    plate = {**given, "nuisances": tuple(n for n in nuisances if not (cause and n in ADOPTED))}
    told = _of_decays(best, plate) if restless and not other else None
    if told is not None and not (cause and cause.holds(told)):
        return told
    untold = found.modes[0].converged and not (ranged or found.parameters["tau"].determined or other)
    told = _of_decays(best, given, found) if untold else None
    if told is not None and not (cause and cause.contradicts(told)):
        return told
    if found.result is Result.misfit and (told := _read_otherwise(logs, question, given, start)) is not None:
        return told
    return replace(_widened(question, found, "late" in nuisances), judged=None)


def _read_otherwise(
    logs: Sequence[Log], question: FitProblem, given: Mapping[str, Any], start: Plant | None
) -> Fit | None:
    """The fit of logs that are described once they are read the other way than the plate alone decided, which
    is not all there is to them; else None."""
    if not question.sampling:
        return None
    other = fit(otherwise(logs, question.sampling), start=start, **given)
    if other.result is not Result.successful:
        return None
    told = [f"{logs[i].name}: {wording.owned(OTHER[way])}" for i, way in question.sampling.items()]
    return replace(other, warnings=(*told, *other.warnings))


def _named(nuisances: str | Sequence[str], effects: str | Sequence[str] | None) -> tuple[str, ...]:
    """What may be fitted besides the plate. Raises ValueError where both state it, or for names unknown."""
    if effects is not None:
        if nuisances is not EVERY:
            raise ValueError("found nuisances beside effects, expected one of them: both name what is fitted")
        return chosen(effects)
    nuisances = (nuisances,) if isinstance(nuisances, str) else tuple(nuisances)
    known = (*EVERY, *EXTRA)
    if unknown := set(nuisances) - set(known):
        more = (
            '; with + or - before a name, say effects="-late"' if any(n[:1] in "+-" for n in unknown) else ""
        )
        raise ValueError(f"unknown nuisance {sorted(unknown)}; known are {', '.join(known)}{more}")
    return nuisances


def _called_for(best: State, judged: Judged, names: Sequence[str]) -> list[str]:
    """The effects of these names that a minimum may call for: of logs that only differ, none that lasts for a
    while; nor of those that hold no more than noise, slow as it may be; of what harms nothing, those that it
    is to first order."""
    each = [e for e in EFFECTS if e.hop is None or judged.apart is None]
    if not judged.wrong and all(map(noise_like, best.trials, best.models)):
        each = [e for e in each if e.hop is None]
    if not judged.wrong and not any(slow(best, i) for i in range(len(best.trials))):
        known = {f.name for f in judged.found if f.certain}
        each = [e for e in each if known & {e.name, *e.known_as}]
    return [e.name for e in each if e.name in names]


def _with_effects(
    question: FitProblem, found: Fit, names: Sequence[str], surely: bool
) -> tuple[FitProblem, Fit, Cause | None]:
    """The question with the effects of these names that describe its logs, and its fit; else the fit, which
    says what it can of these effects, `surely` only what leaves noise; and what is surely the cause."""
    minimiser, best, judged = question.minimiser, found.modes[0], found.judged
    outcome = tried(minimiser, best, judged.looked._replace(found=judged.found), names, judged.bend)
    if (told := outcome.adopted) is not None:
        so = "which is fitted" if outcome.wholly else "which is fitted; the errors span what it leaves"
        findings = told.findings("fitted", so)
        again = replace(
            question,
            trials=told.state.trials,
            dispersion=question.dispersion + told.dispersion,
            effects=findings,
            warnings=wording.beside_feedthroughs(question.warnings, findings),
            told=None if found.reference_temperature is None else told.about.told,
        )
        states = minimiser.imaged([told.state])
        anew = _concluded(again, [replace(s, dispersion=again.dispersion) for s in states])
        if anew.result is Result.successful or tells(anew, found):
            return again, anew, _cause(told, False)
    if found.result is Result.successful and not judged.wrong and outcome.named is not None:
        hardly = outcome.named.findings("noted", "which is hardly all that is there")
        return question, _noting(found, hardly), None
    likelier = outcome.surely and outcome.described  # than plates of their own
    if judged.apart is not None and not likelier:
        alike = outcome.named.findings("noted", "which is about as likely") if outcome.described else ()
        return question, _noting(found, alike), None
    named: tuple[Finding, ...] = ()
    states = list(found.modes)
    most = outcome.named if outcome.surely or (found.result is Result.misfit and not surely) else None
    if most is not None:  # values beside it are nearer to the plate's than those without
        named, away = most.findings("refused", "which explains most of it"), most.state.theta - best.theta
        # nor are they sure to be that: two may make up for a third, and a stretch be the plate's
        wider = question.dispersion + most.dispersion + np.outer(away, away)
        hung = confounds_gain(most.state, minimiser.reference, minimiser.free)
        states = _tight(minimiser, most.state, hung) if hung else minimiser.imaged([most.state])
        states = [replace(s, dispersion=wider) for s in states]
    fingered = "finger_damping" in minimiser.free
    judged = retold(judged, best, named, outcome.refuted, outcome.unsure, fingered)
    if not named and outcome.unsure.issuperset(w.key for w in judged.wrong):
        judged = judged._replace(unsure=True)
    if named and outcome.described:
        judged = judged._replace(wrong=[*named], doubts=[])
    hung = confounds_gain(states[0], minimiser.reference, minimiser.free)
    cause = _cause(outcome.named, outcome.described) if outcome.surely else None
    return question, conclude(question, states, hung, judged), cause


def _cause(told: Description, all_of_it: bool) -> Cause:
    """A description as the cause of what the plant alone leaves."""
    variance = told.state.covariance[1, 1] + told.dispersion[1, 1]
    return Cause(told.state.tau, told.state.tau * float(np.sqrt(variance)), all_of_it)


def _noting(fit: Fit, found: Sequence[Finding]) -> Fit:
    """The fit with what was found besides, and changes nothing of it."""
    warnings = (*fit.warnings, *(f.sentence for f in found))
    return replace(fit, findings=(*fit.findings, *found), warnings=warnings)


def _of_decays(best: State, given: Mapping[str, Any], whole: Fit | None = None) -> Fit | None:
    """The fit of what is left of the logs without the driven rows that no plate explains, or with which the
    fit of the `whole` tells no tau; None where there are none, or where what is left tells no tau."""
    logs, said = decays(best, whole)
    return of_decays(fit(logs, **given), said, whole) if logs else None


def _widened(question: FitProblem, found: Fit, late: bool) -> Fit:
    """The fit, its errors those of all that its logs may hold and do not show for sure; what is wrong, and
    may be spanned, is no misfit where the plant stays determined. `late`: so may its responses be."""
    unsure = found.result is Result.misfit and found.judged.unsure
    if not (unsure or found.result is Result.successful):
        return found
    wide = _spanning(question, found) if late else found
    wide = _together(question, wide) if unsure or wide.result is Result.successful else wide
    return found if unsure and wide.result is not Result.successful else wide


def _together(question: FitProblem, found: Fit) -> Fit:
    """The fit, its errors those of logs that differ by more than theirs, that may be read in two ways, or
    that may hold more than they show: of what may be there, as far as it leaves them determined."""
    differ, said = dispersion(found.modes[0], found.reference, found.names)
    differ = differ + question.dispersion
    looked = found.judged.looked.in_colour(found.modes[0], found.reference)
    hints = looked.average([n for n, p in found.parameters.items() if p.determined] or found.names)
    told, spanned, hinted = found, False, False
    for covariance, both in ((differ + hints.covariance, True), (differ, False)):
        if not np.any(covariance):
            break
        wider = _wider(question, found, covariance, bool(np.any(differ)))
        if wider.result is Result.successful or not (said or hints.hint):
            told, spanned, hinted = wider, True, both
            break
    told = _with_words(told, said, spanned, hints.hint, hinted)
    known = {f.key for f in told.findings}
    return replace(told, assumed=tuple(a for a in looked.assumed() if a.key not in known))


def _wider(question: FitProblem, found: Fit, covariance: np.ndarray, anew: bool) -> Fit:
    """The fit with errors that span more; `anew`: it is judged by these, beside which other things harm, but
    for what was only noted, and is refuted."""
    states = [replace(s, dispersion=covariance) for s in found.modes]
    judged = None if anew or found.judged.wrong else found.judged
    hung = confounds_gain(states[0], found.reference, found.names)
    again = conclude(question, states, hung, judged)
    if found.result is Result.successful:
        known = {(f.key, f.logs) for f in found.findings}
        again = _without(again, [f for f in again.findings if (f.key, f.logs) not in known])
    return replace(again, notes=(*again.notes, *found.notes))


def _without(fit: Fit, noted: Sequence[Finding]) -> Fit:
    """The fit without these of what it only notes."""
    out = [f for f in noted if f.outcome == "noted"]
    sentences = {f.sentence for f in out}
    return replace(
        fit,
        findings=tuple(f for f in fit.findings if f not in out),
        warnings=tuple(w for w in fit.warnings if w not in sentences),
    )


def _with_words(told: Fit, differ: Sequence[Said], spanned: bool, hint: Hint | None, hinted: bool) -> Fit:
    """The fit with what is said of logs that `differ` and of what there may be by a `hint`, which its errors
    span or not."""
    alarms = [x.told(spanned) for x in differ if x.rare or not spanned]
    notes = [x.told(spanned) for x in differ if spanned and not x.rare]
    doubts = [] if hint is None else [f for f in told.findings if f.outcome == "noted" and hint.about(f)]
    if hint is not None and (hinted or not doubts):
        finding, told = hint.told(hinted), _without(told, doubts)
        told = replace(told, findings=(*told.findings, finding))
        (alarms if doubts or not hinted else notes).append(finding.sentence)
    return replace(told, warnings=(*alarms, *told.warnings), notes=(*told.notes, *notes))


def _spanning(question: FitProblem, found: Fit) -> Fit:
    """The fit with an error of G that also covers feedthroughs that may be delays. It says so where no other
    log determines G as well."""
    told = [with_delays(s, found.reference) for s in found.modes]
    if not (told[0].spanned or told[0].partly):
        return found
    anew = replace(question, trials=_with_priors(question.trials, told[0].trials))
    again = _concluded(anew, _anew(question.minimiser, found.modes, [t.trials for t in told]))
    others = sum(t.signed and t.driven for t in anew.trials) > told[0].logs
    before, after = (fit.parameters["G"].std or 0.0 for fit in (found, again))
    if others and after <= WIDER * before:
        return again
    return replace(again, warnings=(*told[0].partly, *again.warnings), notes=(*again.notes, *told[0].spanned))


def _concluded(question: FitProblem, states: list[State]) -> Fit:
    """The fit from its minima. Where the error of G is due to nuisances that may cancel, their priors are
    narrowed if that describes the logs, or may with effects that are still to be looked for."""
    minimiser, best = question.minimiser, states[0]
    names = confounds_gain(best, minimiser.reference, minimiser.free)
    if len(states) > 1 or not names:
        return conclude(question, states, names)
    tight = _tight(minimiser, best, names)
    asked = replace(question, trials=_with_priors(question.trials, tight[0].trials))
    narrow = conclude(asked, tight, confounds_gain(tight[0], minimiser.reference, minimiser.free))
    if narrow.result is not Result.misfit or not narrow.judged.open:  # whose cause is plain
        return narrow
    wide = conclude(question, states, names)
    return wide if wide.result is Result.misfit or question.effects else narrow


def _tight(minimiser: Minimiser, state: State, names: Sequence[str]) -> list[State]:
    """The minima near another, its nuisances `names` with priors of the size that they show."""
    tight = minimiser.refine(tightened(state, minimiser.reference, names), state.theta, ESTIMATED)
    return [unfolded(minimiser, s) for s in minimiser.imaged([tight])]


def _asked(
    logs: Sequence[Log],
    nuisances: Sequence[str],
    priors: Mapping[str, tuple[float, float]] | None,
    reference_temperature: float,
    start: Plant | None,
) -> tuple[FitProblem, list[State]]:
    """The question and its minima; logs whose kind or sampling is not stated are read anew at the best
    tau."""
    if not logs:
        raise ValueError("no logs to fit")
    logs, begun = reading.from_onsets(reading.undriven(in_common_units(logs)))
    trials, warnings = reading.trials(logs, tuple(n for n in nuisances if n not in ("thermometer", *ADOPTED)))
    warnings = [*begun, *warnings]
    reference, free = reading.reference(trials), reading.free(trials)
    stated = {name: given for name, given in checked(priors or {}).items() if name in free}
    unused = [name for name in priors or {} if name not in stated]
    warnings += [
        f"{name}: what is stated of it beforehand is not used: these logs say nothing of it"
        for name in unused
    ]
    warm = any(t.log.temperature is not None for t in trials)
    prior = Prior.of(stated, reference, reference_temperature - reference[1] if warm else 0.0)
    minimiser = Minimiser(reference, free, prior)
    states = minimiser.minima(trials, start)
    read = tuple(reading.read_as(t, log.sampling, states[0].tau) for t, log in zip(trials, logs, strict=True))
    if any(now is not before for now, before in zip(read, trials, strict=True)):
        states = minimiser.minima(read, start)
    sampled = (wording.sampled(t, log.sampling) for t, log in zip(read, logs, strict=True))
    warnings += [f"{log.name}: {what}" for log, what in zip(logs, sampled, strict=True) if what]
    read, states, apart, said, sampling = owned(minimiser, read, states, logs)
    warnings += said
    for _ in range(TWICE if any(t.at_one_frequency for t in read) else 1):
        states = _anew(minimiser, states, [with_feedthroughs(s, reference) for s in states])
    states, said = with_offsets(minimiser, states)
    warnings += said
    if "thermometer" in nuisances and "k_T" in free:
        states, doubts = _with_thermometers(minimiser, states, logs)
        warnings += doubts
    states = [unfolded(minimiser, s) for s in states]
    read = _with_priors(read, states[0].trials)
    problem = FitProblem(minimiser, read, stated, reference_temperature, tuple(warnings), apart, sampling)
    return problem, states


def _with_thermometers(
    minimiser: Minimiser, states: list[State], logs: Sequence[Log]
) -> tuple[list[State], list[str]]:
    """The minima with the errors of the thermometers where these matter, and sentences on what depends on
    them."""
    spread = [Theta.of(np.sqrt(np.diag(s.covariance))) for s in states]
    found = [
        with_thermometers(s.trials, s.named.k_T, std.k_T, std.f0)
        for s, std in zip(states, spread, strict=True)
    ]
    states = _anew(minimiser, states, [trials for trials, _ in found])
    each = zip(states[0].trials, logs, strict=True)
    unstated = [t.log for t, log in each if "temperature_std_degC" not in log.bench]
    errors = Theta.of(np.sqrt(np.diag(states[0].covariance)))
    return states, [*found[0][1], *wording.of_thermometers(unstated, states[0].named.k_T, spread[0], errors)]


def _with_priors(trials: Sequence[Trial], found: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials as they were read, with the nuisances and priors that were found."""
    return tuple(
        replace(t, nuisances=f.nuisances).with_bench(
            narrow=f.bench.narrow, standing=f.bench.standing, offset=f.bench.offset
        )
        for t, f in zip(trials, found, strict=True)
    )


def _anew(minimiser: Minimiser, states: Sequence[State], found: Sequence[tuple[Trial, ...]]) -> list[State]:
    """The minima with the trials found at each, refined again where these differ from its own."""
    return [
        s if t == s.trials else minimiser.refine(t, s.theta, ESTIMATED)
        for s, t in zip(states, found, strict=True)
    ]
