"""A step or a ring-down whose q has the other sign than that of the logs beside it."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import seeds, study

import sysid
from sysid import Result
from sysid.effects.registry import EVERY

SAYS = "the phase turns the other way than in the other logs"
HALF_BANDWIDTH = np.log(20) / (2 * np.pi * 5e-3)


def conjugate(log):
    return replace(log, response=log.response.conj())


def said(logs, nuisances=EVERY):
    fit = sysid.fit(logs, nuisances=nuisances)
    return fit.result, [w for w in fit.warnings if SAYS in w]


@pytest.mark.parametrize("beside", [study(0.3), 1.0, study(4.0)])
@seeds(1, 3)
def test_it_is_named_beside_a_sweep(bench, seeds, beside):
    """The resonance seems to be on the other side of the drive; the sweep was accused, or the step taken for
    noise."""
    for seed in seeds:
        step = bench.transient(seed=seed, frequency=bench.plant.f0 + beside * HALF_BANDWIDTH)
        result, sentences = said([conjugate(step), replace(bench.sweep(seed=seed + 9), name="sweep")])
        assert result is Result.misfit and sentences and sentences[0].startswith("step:")
        result, sentences = said([step, replace(bench.sweep(seed=seed + 9), name="sweep")])
        assert result is Result.successful and not sentences


@pytest.mark.study
def test_two_steps_are_named_together(bench, nuisances):
    """Of one lock-in, beside a sweep of another."""
    steps = [
        replace(bench.transient(seed=k, frequency=bench.plant.f0 + 60 + 30 * k), name=f"step {k}")
        for k in (1, 2)
    ]
    _, sentences = said([*map(conjugate, steps), replace(bench.sweep(seed=9), name="sweep")], nuisances)
    assert sentences and sentences[0].startswith("step 1, step 2:")


def test_a_step_on_its_resonance_is_as_good_either_way(bench):
    step = bench.transient(seed=3, frequency=bench.plant.f0)
    assert said([conjugate(step), replace(bench.sweep(seed=4), name="sweep")]) == (Result.successful, [])
