"""A short version of the study benchmarks/cannot_tell.py: the first seed of each cause."""

import importlib.util
import sys
from pathlib import Path

import pytest

STUDY = Path(__file__).parents[1] / "benchmarks" / "cannot_tell.py"


def load():
    spec = importlib.util.spec_from_file_location("cannot_tell_study", STUDY)
    study = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    return study


study = load()


def seed_of(cause):
    return next(seed for seed in range(1000) if study.bench(seed)[0] == cause)


@pytest.mark.parametrize("cause", study.CAUSES)
def test_what_the_logs_cannot_tell_is_said_with_its_cause(cause):
    found = study.outcome(seed_of(cause))
    assert found.open, found.text
    assert found.named, found.text
    assert found.z < study.FAR, found.text
    assert found.followed is not False, found.text  # the record that was asked for settles it
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
def test_the_record_that_a_sentence_asks_for_is_read(sentence, before, unit, expected):
    found = study.asked(sentence, before, unit)
    assert found is None if expected is None else found == pytest.approx(expected, rel=1e-12)
