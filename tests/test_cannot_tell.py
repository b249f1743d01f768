"""A short version of the study benchmarks/cannot_tell.py: the first seed of the causes whose logs share a few programs."""

import importlib.util
import sys
from pathlib import Path

import pytest

STUDY = Path(__file__).parents[1] / "benchmarks" / "cannot_tell.py"


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("cannot_tell_study", STUDY)
    found = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    yield found
    del sys.modules[spec.name]


def seed_of(study, cause):
    return next(seed for seed in range(1000) if study.bench(seed)[0] == cause)


@pytest.mark.parametrize(
    "cause",
    [
        "one temperature",
        "no temperature",
        "window of 0.1 to 0.5 tau",
        "noise hides the transient",
        "rows coarser than the transient",
        "rotation or f0",
        "fixed frequency while it warms",
        "sweep too narrow",
        "amplitude of a step at resonance",
        "amplitude of a step off resonance",
    ],
)
def test_what_the_logs_cannot_tell_is_said_with_its_cause(study, cause):
    found = study.outcome(seed_of(study, cause), follow=False)
    assert found.open, found.text
    assert found.named, found.text
    assert found.z < study.FAR, found.text


def test_the_record_that_is_asked_for_settles_it(study):
    found = study.outcome(seed_of(study, "window of 0.1 to 0.5 tau"))
    assert found.followed, found.text
    assert found.z_after < study.FAR, found.text


@pytest.mark.parametrize(
    ("sentence", "before", "unit", "expected"),
    [
        ("record 2.5 ms or more after a step", "record", "s", 2.5e-3),
        ("record rows 40 us apart", "record rows", "s", 40e-6),
        ("sweep over at least 1.2e+03 Hz about", "at least", "Hz", 1200.0),
        ("record a larger step", "record", "s", None),
    ],
)
def test_the_record_that_a_sentence_asks_for_is_read(study, sentence, before, unit, expected):
    found = study.asked(sentence, before, unit)
    assert found is None if expected is None else found == pytest.approx(expected, rel=1e-12)
