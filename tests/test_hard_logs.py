"""A short version of the study benchmarks/hard_logs: what must come out of hard logs, of a seed fixed before
it was run."""

import re
from pathlib import Path

import pytest
from conftest import study as whole

from sysid.effects.registry import EVERY
from sysid.trials.trial import NUISANCES

STUDY = Path(__file__).parents[1] / "benchmarks" / "hard_logs"
SEED = 7
# Of each group those that differ most in what they ask of the reader, the fit and its doubts.
CHOSEN = (
    "step that beats, 6 half bandwidths off", "rows twice, at the same times", "response in 1e-12", "dip", "finger, recorded",
    "feedthrough three times the resonance", "amplitude alone, far into the noise (Rice)", "filter of half a tau, stated",
    "clipped on one side", "20 % outliers, sweep", "drop-out in the rise", "drop-out that holds", "three levels",
    "constant", "zeros", "noise alone", "noise that remembers", "demodulator that turns", "a cell without a number",
    "window of 0.05 tau",
    "window of 100 tau", "Q of 2", "rows 10 tau apart", "one row", "two rows", "three rows", "all rows at one time", "drive of zero",
    "sweep with a drop-out",
    "far beside the peak", "half a peak", "one frequency while the plate warms", "two peaks", "two peaks in one",
    "resonance that softens", "finger, not recorded", "two plates, far apart", "two plates, named", "filter of half a tau",
    "amplifier clips the larger steps", "gain that changes between logs", "sign of q, sweep", "sign of q, in one of two",
    "time backwards", "time and frequency swapped", "frequency in kHz called Hz, in one of two",
    "time in us called ms, in one of two", "drive in mV called V, in one of two", "kelvin called degC, in one of two",
    "sign of q, lone step",
)  # fmt: skip


@pytest.fixture(scope="module")
def study():
    """The modules of the study, which find each other by the folder that they stand in."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(STUDY)
        import cases
        import verdicts
    return cases, verdicts


# Of these the effects that would describe them as well are searched for as long as ten others take together: the
# default run takes what is said to first order.
LONG = {
    "three levels",
    "all rows at one time",
    "finger, not recorded",
    "noise that remembers",
    "demodulator that turns",
    "filter of half a tau",
    "filter of half a tau, stated",
    "sign of q, sweep",
    "20 % outliers, sweep",
    "two peaks in one",
    "drive in mV called V, in one of two",
    "two plates, far apart",
    "time in us called ms, in one of two",
    "gain that changes between logs",
    "frequency in kHz called Hz, in one of two",
    "resonance that softens",
    "amplifier clips the larger steps",
}


@pytest.mark.parametrize(
    ("name", "nuisances"),
    [pytest.param(name, EVERY, id=name) for name in CHOSEN if name not in LONG]
    + [whole(name, NUISANCES, id=name) for name in CHOSEN if name in LONG]
    + [whole(name, EVERY, id=f"{name}, searched") for name in CHOSEN if name in LONG],
)
def test_what_must_come_out(study, name, nuisances):
    cases, verdicts = study
    answer = verdicts.ours(cases.CASES[name], SEED, nuisances=nuisances)
    assert verdicts.as_it_must(cases.CASES[name], answer), f"must be {cases.CASES[name].must}: {answer}"


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "seed"),
    [("response in nm called um, in one of two", 0), whole("frequency recorded off, in one of two", 1)],
)
def test_a_second_mode_that_cancels_the_first_is_another_plate(study, name, seed):
    """Of these seeds such a mode describes the logs as well, whose share is -99 to -100 %."""
    cases, verdicts = study
    answer = verdicts.ours(cases.CASES[name], seed)
    assert verdicts.as_it_must(cases.CASES[name], answer), answer


def test_the_catalogue_allows_no_silence(study):
    cases, _ = study
    seen = {name: case for group in cases.GROUPS.values() for name, case in group.items()}
    assert len(seen) >= 60 and len(seen) == sum(map(len, cases.GROUPS.values()))
    for name, case in seen.items():
        allowed = set(case.must.split(" or "))
        assert allowed <= {"right", "open", "refused", "flagged"}, name
        assert bool(allowed - {"right"}) == bool(case.says), name  # what is not right says why
        assert re.compile(case.says)
    for case in cases.NO_LOG_CAN_TELL.values():
        assert case.must == cases.UNDETECTABLE


def test_an_answer_that_does_not_say_why_is_not_what_it_must_be(study):
    cases, verdicts = study
    case = cases.CASES["gain that changes between logs"]
    assert verdicts.as_it_must(
        case, verdicts.Answer("refused", said="misfit | warning: step: G contradicts the other logs")
    )
    assert not verdicts.as_it_must(
        case, verdicts.Answer("refused", said="misfit | warning: a second resonance")
    )
    assert not verdicts.as_it_must(case, verdicts.Answer("silently wrong", 70.0, "G contradicts"))
    assert not verdicts.as_it_must(case, verdicts.Answer("right"))
    assert not verdicts.as_it_must(cases.CASES["sign of q, lone step"], verdicts.Answer("raised"))
