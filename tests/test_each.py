"""What each log makes of the plate by itself: beside fits of single logs, and beside what is known of
simulated ones."""

import numpy as np
import pytest
from conftest import PLATE, most, seeds

import sysid
from sysid.posterior.each import own_estimates
from sysid.verdict.result import Result


def logs_of(bench, seed, off=0.0):
    """Sweeps at 20, 25 and 30 degC, and a step; the resonance of the second sweep is `off`, Hz."""
    found = []
    for k, t in enumerate((20.0, 25.0, 30.0)):
        shift = off * (k == 1)
        at = np.linspace(31800, 32800, 101) + PLATE["k_T"] * (t - 24.0)
        log = bench.sweep(10 * seed + k, temperature=t, frequency=at - shift)
        given = {"drive": log.drive, "frequency": at, "temperature": t, "name": f"sweep {k}"}
        found.append(sysid.Log.from_arrays(log.response, **given))
    return [*found, bench.transient(10 * seed + 3)]


@pytest.fixture(scope="module")
def logs(bench):
    return logs_of(bench, 1)


@pytest.fixture(scope="module")
def fit(logs):
    return sysid.fit(logs)


def test_an_estimate_is_that_of_the_log_fitted_alone(fit, logs):
    for k in (0, 2):
        alone, own = sysid.fit(logs[k]), own_estimates(fit)[k]
        f0 = fit.plant.f0 + fit.plant.k_T * (own.warming or 0.0)
        told = {
            "G": alone.plant.G / fit.plant.G - 1,
            "tau": alone.plant.tau / fit.plant.tau - 1,
            "f0": alone.plant.f0 - f0,
        }
        scale = {"G": alone.plant.G, "tau": alone.plant.tau, "f0": 1.0}
        state = alone.modes[0]  # its errors without what they span besides: a hint of an effect
        shares = np.sqrt(np.diag(state.covariance)[:3] / np.diag(state.spread)[:3])
        own_share = dict(zip(told, shares, strict=True))
        for name, off in told.items():
            error = alone.estimate(name)[1] / scale[name] * own_share[name]
            assert own.off[name] == pytest.approx(off, abs=0.15 * error), (
                name
            )  # of second order in the distance
            assert own.error[name] == pytest.approx(error, rel=0.1), (
                name
            )  # the noise's level is each fit's own


def test_a_log_of_another_resonance_stands_out(bench, nuisances):
    """6 Hz, of which one sweep tells 0.5."""
    found = own_estimates(sysid.fit(logs_of(bench, 2, off=6.0), nuisances=nuisances))
    assert max(found, key=lambda own: own.worst).name == "sweep 1"
    first, moved, last = (own.off["f0"] for own in found[:3])
    # halfway between the others, whatever line all of them lie about
    assert moved - (first + last) / 2 == pytest.approx(6.0, abs=4 * np.sqrt(1.5) * found[1].error["f0"])
    assert abs(found[1].apart["f0"]) > 6


@seeds(4, 40)
def test_logs_of_one_plate_are_apart_by_their_errors(bench, seeds):
    z = [
        own.apart[name]
        for seed in seeds
        for own in own_estimates(sysid.fit(logs_of(bench, seed)))
        for name in own.apart
    ]
    # four logs of one plate are three free differences
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < most(range(3 * len(seeds)))


def test_a_circle_has_the_diameter_G_and_goes_through_zero(fit):
    """W = G V (w0/w) / (1 - j x), which is on |W/V - g/2| = g/2 with g = G w0/w."""
    for own, fitted in zip(own_estimates(fit)[:3], fit.logs, strict=False):
        recorded, model = own.circle
        f0 = PLATE["f0"] + PLATE["k_T"] * own.warming
        g = PLATE["G"] * f0 / fitted.log.frequency
        assert np.abs(model - g / 2) == pytest.approx(g / 2, rel=0.02)
        # of the noise, 0.02 um of a drive of 100 V, one part is across the circle
        assert np.std(np.abs(recorded - g / 2) - g / 2) == pytest.approx(2e-4, rel=0.3)
    assert own_estimates(fit)[3].circle is None


def test_amplitudes_tell_of_the_plate_but_have_no_circle(bench):
    own = own_estimates(sysid.fit([bench.sweep(seed=3, amplitude=True), bench.sweep(seed=4)]))
    assert set(own[0].off) == {"G", "tau", "f0"} and own[0].circle is None and own[1].circle is not None


def test_where_nothing_is_known_there_is_nothing_to_compare(bench):
    fit = sysid.fit([bench.transient(volts=np.zeros(240))])
    assert fit.result is Result.undetermined and own_estimates(fit) == ()
