"""Plants of the study benchmarks/random_plants.py that once were missed, each for a reason of its own."""

import sys
from pathlib import Path

import pytest
from conftest import study as for_the_study

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(BENCHMARKS))
    import random_plants

    yield random_plants
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize(
    ("seed", "result"),
    [
        (1132, "successful"),  # Q of 19: with or without the ripple of the fast mode
        for_the_study(5062, "successful"),  # two amplitudes at two temperatures: an image of an image
        (100104, "successful"),  # sweeps a sixth of a degree apart
    ],
)
def test_a_fit_from_nothing_is_as_good_as_one_from_the_truth(study, seed, result):
    found = study.outcome(seed)
    assert found.verdict == "found", found.text
    assert found.result == result, found.text
