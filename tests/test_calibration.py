"""A short version of benchmarks/calibration.py: plates and lateness drawn from the stated priors, ranks among
the draws."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import study, tiers
from scipy.stats import kstest

STUDY = SimpleNamespace(
    **runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "calibration.py"), run_name="calibration")
)
CASES = {case.name: case for case in STUDY.CASES}


def ranks(name, runs, **given):
    found = [STUDY.run(CASES[name], seed, **given) for seed in range(runs)]
    return found, lambda parameter: [r.ranks[parameter] for r in found if r.bounded]


@pytest.mark.parametrize("name", ["lone step", study("step without a frequency")])
@pytest.mark.parametrize("runs", tiers(10, 30))
def test_the_truth_is_any_draw_of_its_posterior(name, runs):
    found, of = ranks(name, runs)
    assert all(r.bounded for r in found)
    assert all(
        kstest(of(parameter), "uniform").pvalue > 1e-3 for parameter in CASES[name].box
    )  # of five: once in 200 runs


@pytest.mark.study
def test_a_posterior_without_its_prior_s_width_is_found_out():
    """Lateness taken as known: G is then far from its draws, on either side, which the same ranks show."""
    found, of = ranks(
        "lone step", 24, nuisances=("rotation", "background", "offset", "start"), accuracy="quick"
    )
    assert sum(0.01 < r < 0.99 for r in of("G")) < 0.5 * len(found)


def test_ranks_are_of_the_draws_within_the_box():
    rng = np.random.default_rng(0)
    draws = np.linspace(-1, 1, 2001)
    assert STUDY._rank(draws, draws > 0, 0.25, rng) == pytest.approx(0.25, abs=0.01)
    assert (STUDY._rank(draws, draws > 5, 2.0, rng), STUDY._rank(draws, draws > 5, -2.0, rng)) == (1.0, 0.0)


def test_holm():
    assert STUDY.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
