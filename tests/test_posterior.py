"""The posterior: agrees with the fit where the fit is right, repeats itself, and leaves the host program
alone."""

import jax
import numpy as np
import pytest
from scipy.stats import kstest

import sysid
from sysid import Result

Z = 4.5  # standard deviations of Monte-Carlo error


@pytest.fixture(scope="module")
def fit(bench):
    return sysid.fit([bench.sweep()])


@pytest.fixture(scope="module")
def posterior(fit):
    return sysid.sample(fit, seed=0)


def test_it_says_how_it_went(posterior):
    assert posterior.result is Result.successful
    assert posterior.ess >= 400
    assert posterior.rhat < 1.02
    assert posterior.seed == 0
    assert "emcee" in posterior.method
    assert set(posterior.draws) == {"G", "tau", "f0"}
    assert all(np.isfinite(x).all() and x.ndim == 2 for x in posterior.draws.values())


def test_mean_and_spread_are_the_fit_s(posterior, fit):
    std = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    for name, p in posterior.summary().items():
        if name not in std:
            continue
        # Monte-Carlo error of a mean of n draws, and of a standard deviation; and how far a Student-t of 200
        # degrees of freedom and the curvature of exp(log tau) are from the normal of the fit: 1 % of a
        # standard deviation, 1 %
        error = std[name] / np.sqrt(posterior.ess)
        assert abs(p.value - getattr(fit.plant, name)) < Z * error + 0.01 * std[name]
        assert p.std == pytest.approx(std[name], rel=Z / np.sqrt(2 * posterior.ess) + 0.01)
        assert p.ci95[0] < p.value < p.ci95[1]
        assert (p.ci95[1] - p.ci95[0]) / (2 * 1.96 * p.std) == pytest.approx(1, abs=0.12)


def test_draws_correlate_as_the_covariance_says(posterior, fit):
    draws = np.array([posterior.draws[name].ravel() for name in fit.names])
    std = np.sqrt(np.diag(fit.covariance))
    # a correlation from n draws: 1/sqrt(n)
    np.testing.assert_allclose(
        np.corrcoef(draws), fit.covariance / np.outer(std, std), atol=Z / np.sqrt(posterior.ess)
    )


def test_the_truth_is_a_likely_draw(posterior, bench):
    for name, truth in (("G", bench.plant.G), ("tau", bench.plant.tau), ("f0", 32300.0)):
        p = posterior.summary()[name]
        assert abs(p.value - truth) < Z * p.std


def test_the_same_seed_gives_the_same_draws_and_another_seed_others(fit, posterior):
    state = np.random.get_state()[1].tobytes()
    again, other = sysid.sample(fit, seed=0), sysid.sample(fit, seed=1)
    assert np.random.get_state()[1].tobytes() == state
    assert not jax.config.jax_enable_x64
    for name, x in posterior.draws.items():
        assert x.tobytes() == again.draws[name].tobytes()
        assert not np.array_equal(x[:, :50], other.draws[name][:, :50])


def test_the_seed_decides_whatever_numpy_s_global_state_is(fit, posterior):
    before = np.random.get_state()
    np.random.seed(99)
    try:
        again = sysid.sample(fit, seed=0)
    finally:
        np.random.set_state(before)
    assert again.draws["tau"].tobytes() == posterior.draws["tau"].tobytes()


def test_rungs_agree_within_their_errors(fit, posterior):
    quick, one, two = sysid.sample(fit, accuracy="quick"), posterior, sysid.sample(fit, seed=1)
    assert quick.below is None and quick.accuracy == "quick" and one.below.estimates == quick.estimates
    assert quick.error < 0.2 and one.error < 0.02 and one.moved < 2 * quick.error + Z * one.error
    for name, estimate in one.estimates.items():
        drawn = quick.draws[name].ravel()  # even draws of the same normal, whose quantiles are the estimates
        assert abs(drawn.mean() - quick.estimates[name].value) < 0.01 * estimate.std
        assert drawn.std() == pytest.approx(quick.estimates[name].std, rel=0.01)
        apart = abs(estimate.value - two.estimates[name].value)
        assert apart < Z * np.hypot(one.errors[name].value, two.errors[name].value)
    assert quick.twice() is None and one.twice() > 0
    assert quick.offer().accuracy == "standard" and one.offer().accuracy == "exact"


def test_a_budget_takes_the_best_rung_that_fits_and_its_name_replays_it(fit):
    hurried, at_ease = sysid.sample(fit, budget=1e-3), sysid.sample(fit, accuracy="standard", budget=600)
    assert (hurried.accuracy, at_ease.accuracy) == ("quick", "standard")
    again = sysid.sample(fit, accuracy=hurried.accuracy)
    assert (
        again.draws["tau"].tobytes() == hurried.draws["tau"].tobytes()
        and again.estimates == hurried.estimates
    )
    assert sysid.sample(fit, budget=1.0, starting=1e3, accuracy="standard").accuracy == "quick"
    with pytest.raises(ValueError, match=r"accuracy 'exakt', expected one of quick, standard, exact"):
        sysid.sample(fit, accuracy="exakt")


def test_two_seeds_draw_from_one_distribution(fit, posterior):
    other = sysid.sample(fit, seed=2)
    for name in ("G", "tau", "f0"):
        a, b = posterior.draws[name].ravel(), other.draws[name].ravel()
        a, b = a[:: max(1, int(a.size / posterior.ess))], b[:: max(1, int(b.size / other.ess))]
        assert kstest(a, b).pvalue > 1e-3 / 3


def test_two_modes_are_both_drawn_and_neither_is_reported_as_a_value(bench):
    volts = np.repeat([0.0, 100.0], [10, 111])
    fit = sysid.fit([bench.transient(volts=volts, frequency=32220.0, amplitude=True, noise=0.005)])
    posterior = sysid.sample(fit)
    side = posterior.draws["f0"] > 32220.0
    assert 0.05 < side.mean() < 0.95
    p = posterior.summary()["f0"]
    assert not p.determined and p.value is None and len(p.modes) == 2
    weight = next(mode["weight"] for mode in p.modes if mode["value"] > 32220)
    # weights of equally wide modes; a chain that jumps between two modes counts them as its effective draws
    # allow
    assert abs(side.mean() - weight) < Z * 0.5 / np.sqrt(min(posterior.ess, 400)) + 0.02
    assert posterior.summary()["tau"].determined


def test_a_sampler_that_misses_its_criteria_says_so(fit, monkeypatch):
    from sysid.posterior import accuracy, chain

    monkeypatch.setattr(chain, "ROUNDS", 1)
    monkeypatch.setattr(accuracy, "LADDER", (accuracy.LADDER[0], accuracy.Rung("standard", 10**6, False)))
    stopped = sysid.sample(fit)
    assert stopped.result is Result.sampler_stopped
    assert stopped.summary()["tau"].value is not None  # what was drawn can be looked at


def test_a_chain_that_is_stuck_ends_as_soon_as_that_is_seen(fit):
    """Of a density 400 times as wide as its proposals in each direction, whose weights rise outwards without
    end, few draws are worth anything."""
    from sysid.posterior.chain import Chain
    from sysid.posterior.target import Target

    target = Target(fit, seed=0)
    normal = target.normal().heavy()
    target.__class__ = type(
        "Wide", (Target,), {"__call__": lambda self, z: -0.5 * np.sum((z / 400) ** 2, axis=1)}
    )
    chain = Chain(target, normal, 0)
    chain.extend(1000)
    assert not chain.reached(1000) and len(chain.proposed()[0]) < 20_000


def test_what_the_fit_found_wanting_stays_wanting(bench):
    fit = sysid.fit([bench.transient(dt=0.3 * bench.plant.tau / 220)])
    posterior = sysid.sample(fit)
    assert posterior.result is Result.undetermined
    assert not posterior.summary()["tau"].determined


def test_together_all_logs_of_a_folder_are_sampled_as_they_are_fitted(joint_fit):
    fit = joint_fit("quartz")
    posterior = sysid.sample(fit)
    assert posterior.result is Result.successful
    std = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    for name, p in posterior.summary().items():
        assert abs(p.value - getattr(fit.plant, name)) < std[name] * (Z / np.sqrt(posterior.ess) + 0.02)
