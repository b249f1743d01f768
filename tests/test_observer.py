"""Contrasts, the observer and the two-interval test: against published and independently computed numbers."""

import itertools

import numpy as np
import pytest
from scipy.special import comb
from scipy.stats import beta, binom, binomtest

from stimulator import Intensities, Observer, Prior, StimulatorError, predicted
from stimulator.contrast import plateau, spectral
from stimulator.experiment import (
    clustered,
    counts,
    majority,
    proportion,
    quantile,
    trials_for,
    volunteers_for,
)
from stimulator.observer import PUBLISHED, preference


def test_46_of_50():
    """The paper's count; the intervals are those of any statistics package."""
    found = proportion(46, 50)
    assert found.two_sided == pytest.approx(4.46e-10, rel=1e-3) and found.one_sided == pytest.approx(
        2.23e-10, rel=1e-3
    )
    assert found.clopper_pearson == pytest.approx((0.8077, 0.9778), abs=5e-5)
    assert found.wilson == pytest.approx((0.8116, 0.9685), abs=5e-5)
    assert found.jeffreys == pytest.approx((0.8209, 0.9724), abs=5e-5)
    assert found.d_prime == pytest.approx((1.987, 1.229, 2.842), abs=5e-4)


@pytest.mark.parametrize("icc, n, low, high", [(0.2, 28, 0.75, 0.99), (0.5, 17, 0.68, 0.996)])
def test_clusters_leave_fewer_trials(icc, n, low, high):
    found = clustered(46, 50, 5, icc)
    assert found.effective == pytest.approx(n, abs=0.5) and found.interval == pytest.approx(
        (low, high), abs=0.005
    )
    assert found.two_sided < 1e-3


def test_without_clusters_nothing_changes():
    found, plain = clustered(46, 50, 5, 0.0), proportion(46, 50)
    assert found.interval == pytest.approx(plain.clopper_pearson, rel=1e-10)
    assert found.two_sided == pytest.approx(plain.two_sided, rel=1e-10)
    low, high = clustered(4, 50, 5, 0.0).interval
    assert (1 - high, 1 - low) == pytest.approx(plain.clopper_pearson, rel=1e-10)
    assert clustered(50, 50, 5, 0.0).interval == pytest.approx(tuple(binomtest(50, 50).proportion_ci()))


def test_counts_are_those_of_all_outcomes():
    p = np.array([0.1, 0.7, 0.95])
    truth = np.zeros(4)
    for outcome in itertools.product((0, 1), repeat=3):
        truth[sum(outcome)] += np.prod(np.where(outcome, p, 1 - p))
    np.testing.assert_allclose(counts(p), truth, atol=1e-15)
    np.testing.assert_allclose(counts(np.full(10, 0.9), 5), binom.pmf(np.arange(51), 50, 0.9), atol=1e-15)
    mixed = counts(np.stack([np.full(10, 0.9), np.full(10, 0.6)]), 5)
    np.testing.assert_allclose(
        mixed, 0.5 * (counts(np.full(10, 0.9), 5) + counts(np.full(10, 0.6), 5)), atol=1e-15
    )


def power_of(n, p, level):
    """By the definition: the outcomes whose exact two-sided p-value is at most `level`."""
    rejected = [k for k in range(n + 1) if binomtest(k, n).pvalue <= level and k > n / 2]
    return sum(comb(n, k, exact=True) * p**k * (1 - p) ** (n - k) for k in rejected)


@pytest.mark.parametrize("p, power, level", [(0.92, 0.9, 0.05), (0.75, 0.8, 0.05), (0.75, 0.9, 0.01)])
def test_the_number_of_trials_has_the_power_and_no_smaller_one_keeps_it(p, power, level):
    n = trials_for(p, power, level)
    assert all(power_of(more, p, level) >= power for more in range(n, n + 25))
    assert power_of(n - 1, p, level) < power
    assert trials_for(1 - p, power, level) == n


def test_a_volunteer_s_majority():
    draws = np.random.default_rng(0)
    shares = draws.beta(0.75 * 4, 0.25 * 4, 200_000)  # a + b = 4: a correlation of 1/(4 + 1)
    won = (draws.binomial(5, shares) >= 3).mean()
    assert majority(0.75, 5, 0.2) == pytest.approx(won, abs=4 * np.sqrt(0.25 / 200_000))
    assert majority(0.75, 5, 0.0) == pytest.approx(binom.sf(2, 5, 0.75))
    assert volunteers_for(0.75, 5, 0.5) > volunteers_for(0.75, 5, 0.2) > volunteers_for(0.75, 5, 0.0)


@pytest.mark.parametrize("k, ratio", [(0.11, 1.24), (0.15, 1.34), (0.18, 1.41), (0.25, 1.59), (0.30, 1.73)])
def test_the_ratio_that_gives_92_percent(k, ratio):
    assert preference(ratio, 1.0, k) == pytest.approx(0.92, abs=0.004)  # ratios are published with two digits


def test_an_observer():
    plain = Observer(weber=0.18, lapse=0.0, floor=0.0)
    assert plain.prefers(1.18, 1.0) == pytest.approx(0.75) and plain.prefers(1.0, 1.18) == pytest.approx(0.25)
    assert Observer(lapse=0.1, floor=0.0).prefers(1e6, 1.0) == pytest.approx(0.95)
    assert plain.prefers(0.0, 0.0) == 0.5 and plain.prefers(0.1, 0.0) == 1.0
    # a ratio of nothing to next to nothing is not felt
    assert Observer().prefers(2e-4, 1e-4) == pytest.approx(0.5, abs=0.01)
    light = Observer(weber=0.1, light_weber=0.2, lapse=0.0)
    assert light.prefers(0.3, 0.2, 0.4) == Observer(weber=0.2, lapse=0.0).prefers(0.3, 0.2)
    assert light.prefers(0.3, 0.2, 0.5) == Observer(weber=0.1, lapse=0.0).prefers(0.3, 0.2)
    np.testing.assert_array_equal(
        light.prefers([0.3, 0.3], 0.2, [0.4, 0.6]), [light.prefers(0.3, 0.2, f) for f in (0.4, 0.6)]
    )


@pytest.mark.parametrize(
    "given", [{"weber": 0.0}, {"light_weber": -1.0}, {"lapse": 1.0}, {"floor": -0.1}, {"intensity": "no"}]
)
def test_observers_that_cannot_be(given):
    with pytest.raises(StimulatorError, match=f"observer.{next(iter(given))}"):
        Observer(**given)


def grating(x, high=0.8, low=0.4):
    return np.where(np.mod(x / 5, 1) < 0.5, low, high)


def test_contrasts_of_an_ideal_grating():
    for x in (np.linspace(3, 93, 90_001), 60 - 40 * np.cos(np.linspace(0, 2 * np.pi, 200_001))):
        assert plateau(x, grating(x), 5.0) == pytest.approx(0.5)
        assert spectral(x, grating(x), 5.0) == pytest.approx(
            0.4 / 0.6, rel=0.03
        )  # of a period that is cut off in some 16


def test_a_grating_that_is_elsewhere_has_plateaus_and_no_spectrum():
    x = np.linspace(0, 200, 200_001)
    places = np.random.default_rng(0).permutation(np.tile([0.4, 0.8], 200)).repeat(500)
    lost = np.append(places, places[-1])
    assert plateau(x, lost, 5.0) > 0.25 and spectral(x, lost, 5.0) < 0.2


def test_a_period_that_is_not_crossed_does_not_count():
    x = np.concatenate([np.linspace(1, 18, 17_001), np.linspace(18, 1, 17_001)])
    mu = np.where((x > 15) | (x < 5), 0.1, grating(x))  # whole crossings lie between 5 and 15 mm
    assert plateau(x, mu, 5.0) == pytest.approx(0.5)
    for x in (np.linspace(0, 4, 100), np.full(100, 3.0)):
        with pytest.raises(StimulatorError, match=r"stroke\.x"):
            plateau(x, grating(x), 5.0)


def test_predictions_mix_studies_exactly():
    cell = Intensities(np.array([0.1, 2.0]), np.array([0.2, 0.2]), np.array([0.3, 0.3]))
    certain = Prior(weber_study=0.0, weber_person=0.0, lapse=0.03, floor=0.0)
    found = predicted({"one": cell}, certain, studies=20_000)["one"]
    # the mean over lapses is linear in p, and so is the mean count
    p = preference(0.3, 0.2, 0.18, 0.03)
    assert found.sum() == pytest.approx(1.0) and found @ np.arange(51) == pytest.approx(50 * p, abs=0.02)
    wide = predicted({"one": cell}, Prior(floor=0.0), studies=2000)["one"]
    assert quantile(wide, 0.025) < quantile(found, 0.025)


def test_the_prior_covers_what_is_published():
    # 0.07 above 0.5 N is of a force by itself, not of a texture; the rest are within two standard deviations
    _, weber, lapse = Prior().draw(4000, 10, 0)
    low, high = np.quantile(weber, [0.025, 0.975])
    assert all(low < p.low and p.high < high for p in PUBLISHED if p.low > 0.1)
    assert lapse.mean() == pytest.approx(0.04, abs=0.001)
    assert np.quantile(lapse, 0.9) == pytest.approx(beta.ppf(0.9, 1.5, 36.0), abs=0.003)
