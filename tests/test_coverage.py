"""A short version of the study benchmarks/coverage.py: three of its cases, of 10 seeds each, and of 60 behind
the marker."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import study as kept_for_study
from conftest import tiers
from scipy.stats import binom

STUDY = Path(__file__).parents[1] / "benchmarks" / "coverage.py"
CASES = ("white, step", "white, sweep", "amplitude, sweep, noise 1 %")
CHANCE = 1e-3  # of each bound below, if the intervals are true


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location(
        "coverage_study", STUDY
    )  # not by its name: a package has the same
    study = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    yield study
    del sys.modules[spec.name]


@pytest.fixture(scope="module", params=tiers(range(10), range(60)))
def outcomes(study, request):
    chosen = [case for case in study.every_case() if case.name in CASES]
    return [study.outcome(case, seed) for case in chosen for seed in request.param]


def bounds(seeds):
    """Limits of the share of covered intervals: the three parameters of a seed count as one, for their errors
    are related."""
    return binom.ppf(CHANCE, seeds, 0.95) / seeds, binom.ppf(1 - CHANCE, seeds, 0.95) / seeds


@pytest.mark.always
def test_intervals_hold_the_truth_as_often_as_they_say(outcomes):
    assert all(o.result == "successful" for o in outcomes), {o.said for o in outcomes}
    held = [h for o in outcomes for h in o.held.values()]
    assert len(held) == 3 * len(outcomes)
    low, high = bounds(len(outcomes))
    assert low <= np.mean(held) <= high
    scores = np.array([list(o.scores.values()) for o in outcomes])
    narrow = (
        0.7 if len(outcomes) > 100 else 0.5
    )  # this test sees intervals that are 30 % too narrow, of few seeds half as wide
    assert np.mean(np.abs(scores) < narrow * 1.96) < low


def test_stated_errors_are_those_of_the_estimates(outcomes):
    scores = np.array([list(o.scores.values()) for o in outcomes])
    # The standard deviation of n scores is known to 1/sqrt(2 n), their mean to 1/sqrt(n); 3.3 of these are
    # CHANCE.
    n = len(outcomes)
    assert abs(np.std(scores) - 1) < 3.3 / np.sqrt(2 * n)
    assert np.all(np.abs(scores.mean(axis=0)) < 3.3 / np.sqrt(n))


UNSTEADY = {  # logs whose noise once went to and fro for as long as the fit ran
    "amplitude, step 50 Hz off + sweep": (11, 16, 31),
    "q noise 3 times d noise, correlation 0.9, step of 400 rows": (25, 29),
}


@pytest.mark.parametrize(
    ("name", "seeds"),
    [x for name, seeds in UNSTEADY.items() for x in ((name, seeds[:1]), kept_for_study(name, seeds[1:]))],
)
def test_noise_and_fit_come_to_rest(study, name, seeds):
    case = next(case for case in study.every_case() if case.name == name)
    for seed in seeds:
        assert study.outcome(case, seed).result == "successful", seed


@pytest.mark.parametrize("rotation", [kept_for_study(0.0), 1.9])
def test_a_hurried_sweep_tells_as_much_as_the_bound_allows(study, rotation):
    """A response that is late has no imaginary part worth speaking of: with one as free, G and tau would be
    seven times wider."""
    case = next(case for case in study.every_case() if case.name.startswith("hurried"))
    case = replace(case, benches=(replace(case.benches[0], rotation=rotation),))
    outcomes, bound = [study.outcome(case, seed) for seed in range(6)], study.bounds(case)
    for name in ("G", "tau", "f0"):
        # The bound is where nothing is late; a lateness of half a row, which noise may look like, is taken to
        # first order.
        assert 0.8 < np.median([o.stds[name] for o in outcomes]) / bound[-1, name] < 1.3
        assert max(abs(o.scores[name]) for o in outcomes) < 4
