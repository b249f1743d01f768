"""Steps of a search for an effect's numbers, no longer than they are trusted."""

import numpy as np
import pytest
from scipy.optimize import minimize

from sysid.adoption.point import Looked

RNG = np.random.default_rng(7)


def looked(d, seed):
    """A quadratic of the cost in d numbers, with its minimum far outside of the trust."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((d, d)) * 10.0 ** rng.uniform(-1, 1, d)
    covariance = np.linalg.inv(root @ root.T + np.eye(d))
    score = np.linalg.solve(covariance, rng.standard_normal(d))
    gain = 0.5 * float(score @ covariance @ score) + 1.5  # the plant's own part of it stays
    nothing = np.zeros((6, d))
    return Looked(covariance @ score, covariance, np.zeros((6, 6)), gain, np.zeros(6), nothing, score)


@pytest.mark.parametrize("d, seed", [(1, 0), (2, 1), (5, 2), (5, 3)])
def test_a_step_within_the_trust_is_the_best_of_its_length(d, seed):
    """Levenberg's: of all steps of its length, in standard deviations of the prior, none gains more."""
    look, stds = looked(d, seed), 10.0 ** np.random.default_rng(seed).uniform(-2, 2, d)
    look = look._replace(covariance=look.covariance * np.outer(stds, stds), score=look.score / stds)
    look = look._replace(step=look.covariance @ look.score)
    information = np.linalg.inv(look.covariance)

    def gained(step):
        return look.score @ step - 0.5 * step @ information @ step

    whole, foreseen = look.within(np.inf, stds)
    np.testing.assert_allclose(whole, look.step, rtol=1e-9)
    assert foreseen == pytest.approx(look.gain, rel=1e-9)
    step, foreseen = look.within(0.1, stds)
    assert 0.03 < np.max(np.abs(step / stds)) <= 0.1
    assert foreseen == pytest.approx(gained(step) + 1.5, rel=1e-9)
    length = np.linalg.norm(step / stds)
    on = {"type": "eq", "fun": lambda x: np.linalg.norm(x) - length}
    for way in RNG.standard_normal((5, d)):
        best = minimize(lambda x: -gained(stds * x), length * way / np.linalg.norm(way), constraints=on)
        # SLSQP keeps to the length to about a millionth
        assert gained(step) >= -best.fun * (1 - 1e-5)


def test_numbers_that_a_log_follows_in_steps_stay():
    look = looked(3, 4)
    look = look._replace(step=look.step * [1.0, 0.0, 1.0])
    assert look.within(0.1, np.ones(3))[0][1] == 0.0
