"""The two laws of friction beside a root found by bisection, their limits, and what they refuse."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from stimulator import Exponential, PartialLevitation, RangeWarning, StimulatorError


def force_of(kPa):
    """N at which a fingertip of 1 cm^2 (F/1 N)^(1/3) presses with `kPa`."""
    return (kPa * 1e3 * 1e-4) ** 1.5


@pytest.mark.parametrize("W", [0.0, 0.01, 0.25, 1.0, 3.0])
@pytest.mark.parametrize("force", [0.01, 0.2, 1.0, 5.0])
def test_the_film_and_the_contacts_carry_the_load(W, force):
    """The gap of p_c0 exp(-u/u_rms) + 5/4 p0 (W/u)^2 = p_f by bisection."""
    load, stiffest = force / (1e-4 * force ** (1 / 3)), 10e3 * math.exp(5 / 1.5)
    gap = brentq(
        lambda u: stiffest * math.exp(-u / 1.5) + 1.25 * 1.013e5 * (W / u) ** 2 - load, 1e-3, 1e4, xtol=1e-13
    )
    law = PartialLevitation()
    assert law.gap(W, force) == pytest.approx(gap, rel=1e-9)
    assert law.friction(W, force) == pytest.approx(0.8 * stiffest * math.exp(-gap / 1.5) / load, rel=1e-7)


@pytest.mark.parametrize(
    ("kPa", "falls"),
    [
        (3, [0.94, 0.79, 0.59, 0.38, 0.10, 0.015]),
        (10, [0.97, 0.88, 0.76, 0.61, 0.35, 0.16]),
        (20, [0.98, 0.91, 0.81, 0.69, 0.46, 0.27]),
    ],
)
def test_partial_levitation_as_tabulated(kPa, falls):
    found = PartialLevitation().friction([0.25, 0.5, 0.75, 1, 1.5, 2], force_of(kPa)) / 0.8
    np.testing.assert_allclose(found, falls, atol=0.0051)  # two digits


def test_exponential_as_tabulated():
    found = Exponential().friction([0.5, 1, 2], 1.0) / 0.8
    np.testing.assert_allclose(found, [0.73, 0.45, 0.23], atol=0.0051)


@pytest.mark.parametrize("law", [Exponential(), PartialLevitation()], ids=["F1", "F2"])
def test_friction_is_mu0_at_rest_and_falls_with_the_amplitude(law):
    W = np.linspace(0, 4, 200)
    mu = law.friction(W, 0.5)
    assert mu[0] == pytest.approx(0.8, rel=1e-12)
    assert np.all(np.diff(mu) < 0) and np.all(mu >= 0)


def test_a_lighter_finger_is_lifted_sooner_by_the_film_only():
    forces = np.array([0.05, 0.2, 0.5, 1.0, 2.0])
    assert np.all(np.diff(PartialLevitation().friction(1.0, forces)) > 0)
    assert np.ptp(Exponential().friction(1.0, forces)) == 0


@pytest.mark.parametrize("law", [Exponential(), PartialLevitation()], ids=["F1", "F2"])
def test_shapes_are_those_of_numpy(law):
    assert law.friction(np.ones((3, 1)), np.ones(4)).shape == (3, 4)
    assert law.friction(1.0, 0.5).shape == ()


def test_no_force_is_no_special_case():
    np.testing.assert_allclose(PartialLevitation().friction([0.0, 1.0], 0.0), [0.8, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Exponential(mu0=0.0), "friction.mu0"),
        (lambda: Exponential(least=1.5), "friction.least"),
        (lambda: Exponential(scale_um=math.nan), "friction.scale_um"),
        (lambda: PartialLevitation(u_rms_um=-1.0), "friction.u_rms_um"),
        (lambda: PartialLevitation(area_cm2=math.inf), "friction.area_cm2"),
        (lambda: Exponential().friction(-0.1, 1.0), "friction.W_um"),
        (lambda: Exponential().friction(1.0, -1.0), "friction.force_N"),
        (lambda: PartialLevitation().friction([1.0, math.nan], 1.0), "friction.W_um"),
        (lambda: PartialLevitation().friction(1.0, math.inf), "friction.force_N"),
        (lambda: PartialLevitation(area_cm2=0.01).friction(1.0, 9.0), "friction.force_N"),
    ],
)
def test_what_cannot_be_is_refused(make, key):
    with pytest.raises(StimulatorError, match=key):
        make()


def test_a_hard_press_is_named():
    with pytest.warns(RangeWarning, match="12 N"):
        Exponential().friction(1.0, 12.0)
