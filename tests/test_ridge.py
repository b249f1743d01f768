"""An amplitude that was recorded on the resonance itself, where its derivative by f0 vanishes."""

import numpy as np
import pytest
import reference
from conftest import study, tiers
from scipy.stats import binom

import sysid
from sysid import Result
from sysid.minimum import ridge

TAU = 1.67e-3
PLANT = reference.Plant(0.01, TAU, 32290.0, 0.0)


def log(seed, detuning=0.0):
    """The amplitude of a step, `detuning` half bandwidths above resonance."""
    time = 1e-4 * np.arange(200)
    drive, frequency = (
        np.where(time >= 2e-3, 100.0, 0.0),
        np.full(200, PLANT.f0 + detuning / (2 * np.pi * TAU)),
    )
    clean = reference.ringing(PLANT, time, drive, frequency, np.full(200, 24.0))
    return sysid.Log(
        "step", np.abs(clean + reference.noise(200, 0.01, seed)), time=time, drive=drive, frequency=frequency
    )


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("at", [1e-4, 0.02, 0.7, 5.0])
def test_where_a_cost_has_risen(power, at):
    looked = []
    off, _ = ridge.risen(lambda x: (looked.append(x) or ridge.RISE * (x / at) ** power, []), 0.02, 8.0)
    assert off == pytest.approx(at, rel=0.11) and len(looked) < 12  # a tenth of the rise, or a factor of 1.1


@pytest.mark.parametrize(
    ("cost", "ends"),
    [
        (lambda x: 0.5, 8.0),
        (lambda x: 0.0 if x < 0.5 else np.inf, 0.5),
        (lambda x: np.nan if x > 0.5 else 0.1, 0.5),
        (lambda x: -1.0 if x < 0.5 else 1e9, 0.5),
        (lambda x: np.inf, 0.0),
        (lambda x: np.nan, 0.0),
    ],
)
def test_a_cost_that_jumps_ends_the_search(cost, ends):
    off, _ = ridge.risen(lambda x: (cost(x), []), 0.02, 8.0)
    assert off == pytest.approx(ends, rel=0.11, abs=1e-7)


@pytest.fixture(scope="module", params=tiers(range(12), range(40)))
def fits(request):
    return [sysid.fit([log(seed)]) for seed in request.param]


@pytest.mark.study
def test_gain_and_time_constant_are_known_on_resonance(fits):
    """J^T J takes what noise leaves of the derivative by f0 for information, and of some of these logs told
    neither."""
    assert all(f.result is Result.successful for f in fits)
    for name, truth in (("G", PLANT.G), ("tau", TAU)):
        found = np.array([(f.parameters[name].value, f.parameters[name].std) for f in fits])
        held = np.abs(found[:, 0] - truth) < 1.96 * found[:, 1]
        assert held.sum() >= binom.ppf(0.004, len(fits), 0.95)  # of 40, 34
        spread = np.std(found[:, 0])
        few = (
            1 + 3 / np.sqrt(2 * len(fits)) - 3 / np.sqrt(2 * 40)
        )  # by how much less a spread is known of fewer than 40
        assert (
            0.7 / few * spread < np.median(found[:, 1]) < 2.5 * few * spread
        )  # x^2 >= 0 is 0 here, which the logs do not know


@pytest.mark.study
def test_what_it_says_of_f0_is_as_wide_as_the_posterior(fits):
    """The chains have the density itself."""
    vague = [f for f in fits if f.parameters["f0"].determined and len(f.modes) == 1][: len(fits) // 10]
    assert len(vague) == len(fits) // 10
    for f in vague:
        drawn = np.std(sysid.sample(f, seed=1).draws["f0"])
        assert 0.6 < f.parameters["f0"].std / drawn < 1.6


def test_off_resonance_the_two_sides_stay_apart():
    f = sysid.fit([log(0, detuning=0.5)])
    assert len(f.modes) == 2 and not f.parameters["f0"].determined and "which side" in f.parameters["f0"].why


@pytest.mark.study
@pytest.mark.parametrize("detuning", [study(0.0), 0.14, study(0.25)])
def test_a_curved_posterior_is_sampled_to_the_end(detuning):
    """A normal about each minimum proposes next to nothing of it: 150 000 evaluations were not enough."""
    posterior = sysid.sample(sysid.fit([log(3, detuning)]), seed=0)
    assert posterior.result is Result.successful and posterior.ess >= 1000 and posterior.rhat < 1.01
    assert posterior.evaluations < 10_000
    for name in ("G", "tau"):
        low, high = np.quantile(posterior.draws[name], [0.0005, 0.9995])
        assert low < getattr(PLANT, name) < high
