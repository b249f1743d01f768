"""The air film beside exact solutions: the linear strip, the second-order mean, a film that cannot leak, and
the fast law beside Reynolds."""

import math
import warnings

import numpy as np
import pytest

from stimulator import Pad, RangeWarning, Reynolds, StimulatorError, film_pressure, overpressure
from stimulator.film import FLAT_PAD, GROOVED_PAD, RIDGE, infinite_overpressure, second_order, squeeze_number


@pytest.mark.parametrize("sigma", [1, 10, 100, 1000])
def test_a_thin_film_is_langlois_linear_strip(sigma):
    """Stiffness and damping of a strip at small e, exact (Langlois 1962, Blech 1983); the film's error is of
    the mesh."""
    film = Reynolds(1e-3, sigma, cells=160, phases=9).periodic()
    k = math.sqrt(sigma / 2)
    below = k * (math.cosh(k) + math.cos(k))
    stiffness = 1 - (math.sinh(k) + math.sin(k)) / below
    damping = (math.sinh(k) - math.sin(k)) / below
    assert -film.first_harmonic / 1e-3 == pytest.approx(stiffness + 1j * damping, abs=1e-4)


@pytest.mark.parametrize("sigma", [3, 10, 30, 100, 1000])
def test_the_mean_of_second_order(sigma):
    """3/2 S - A/4 with S and A integrated here; e = 0.02 leaves terms of e^2 = 4e-4 of it."""
    x = np.linspace(0, 1, 20001)
    kappa = np.sqrt(0.25j * sigma)
    p = -(1 - np.cosh(kappa * x) / np.cosh(kappa))
    exact = 1.5 * -np.trapezoid(p.real, x) - np.trapezoid(np.abs(p) ** 2, x) / 4
    assert second_order(sigma) == pytest.approx(exact, rel=1e-6)
    found = Reynolds(0.02, sigma, cells=120, phases=9).periodic().overpressure / 0.02**2
    assert found == pytest.approx(exact, rel=2e-3)


def test_the_mean_of_second_order_at_the_ends():
    assert second_order(1e12) == pytest.approx(1.25, rel=1e-5)
    assert second_order(1e-3) == pytest.approx(1e-6 / 96, rel=0.01)  # 3/2 <p_2>: of order sigma^2


@pytest.mark.parametrize("e", [0.1, 0.25, 0.5, 0.75])
def test_a_film_that_cannot_leak(e):
    """sigma = 1e4: below the closed form by its edge layer, of order sigma^-1/2 = 1 %."""
    reynolds = Reynolds(e, 1e4, phases=33 if e < 0.7 else 65).periodic().overpressure
    exact = math.sqrt((1 + 1.5 * e**2) / (1 - e**2)) - 1
    assert infinite_overpressure(e) == pytest.approx(exact, rel=1e-12)
    assert 0.98 * exact < reynolds < exact


def test_the_closed_form_follows_from_trapped_air():
    """P H = c and <P^2 H^3> = <H^3> at the edge, c the mass that no longer changes: integrated over a
    period."""
    t = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    H = 1 + 0.5 * np.cos(t)
    c = math.sqrt(np.mean(H**3) / np.mean(H))
    assert 1 + infinite_overpressure(0.5) == pytest.approx(np.mean(c / H), rel=1e-12)


def test_a_film_at_full_width_300_leaks_seven_per_cent():
    lost = 1 - Reynolds(0.25, 300).periodic().overpressure / infinite_overpressure(0.25)
    assert 0.07 < lost < 0.085


@pytest.mark.parametrize("sigma", [30, 100, 300, 1e3, 1e4])
@pytest.mark.parametrize("e", [0.1, 0.25, 0.5])
def test_the_fast_law_in_its_range(e, sigma):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fast = overpressure(e, sigma)
    assert fast == pytest.approx(Reynolds(e, sigma).periodic().overpressure, rel=0.025)


@pytest.mark.parametrize(("e", "sigma", "off"), [(0.5, 10, 0.09), (0.25, 3, 0.17), (0.75, 30, 0.037)])
def test_the_fast_law_beyond_its_range_says_so(e, sigma, off):
    with pytest.warns(RangeWarning, match="within 2.5 %"):
        fast = overpressure(e, sigma)
    assert 1 - fast / Reynolds(e, sigma).periodic().overpressure == pytest.approx(off, abs=0.01)


def test_the_fast_law_takes_arrays():
    found = overpressure(np.array([[0.1], [0.3]]), np.array([100.0, 1000.0]))
    assert found.shape == (2, 2)
    assert np.all(np.diff(found, axis=0) > 0) and np.all(np.diff(found, axis=1) > 0)


@pytest.mark.parametrize(("e", "sigma"), [(0.5, 30), (0.25, 300), (0.5, 3000)])
def test_the_default_mesh_is_fine_enough(e, sigma):
    coarse = Reynolds(e, sigma).periodic().overpressure
    assert coarse == pytest.approx(Reynolds(e, sigma, cells=320, phases=65).periodic().overpressure, rel=5e-4)


def test_air_is_neither_made_nor_lost():
    """What flows out of the edge over a period is nothing: the mass P H of the film is periodic, and its mean
    flow zero."""
    film = Reynolds(0.5, 30).periodic()
    H = 1 + 0.5 * np.cos(film.t)
    outermost = film.P[-1] ** 2 - 1
    assert abs(np.mean(H**3 * outermost)) < 1e-9 * np.mean(H**3 * np.abs(outermost))


@pytest.mark.parametrize(
    ("pad", "gap", "kPa"),
    [
        (FLAT_PAD, 2, 35.4),
        (RIDGE, 2, 22.9),
        (GROOVED_PAD, 2, 8.1),
        (FLAT_PAD, 5, 5.0),
        (RIDGE, 5, 0.37),
        (GROOVED_PAD, 4, 1.3),
    ],
)
def test_what_a_finger_s_film_carries(pad, gap, kPa):
    """At 32.3 kHz and 1 um, to the two digits that are published with the prototype of this table."""
    assert film_pressure(1.0, gap, pad) / 1e3 == pytest.approx(kPa, rel=0.02)


def test_grooves_of_no_depth_are_a_flat_pad_and_deep_ones_are_single_ridges():
    assert film_pressure(1.0, 2.0, Pad(10e-3, 1e-12)) == pytest.approx(film_pressure(1.0, 2.0), rel=0.01)
    alone = film_pressure(1.0, 2.0, Pad(0.24e-3))  # between grooves that stay at the atmosphere's pressure
    assert film_pressure(1.0, 2.0, Pad(10e-3, 1e-3)) == pytest.approx(0.6 * alone, rel=0.02)


def test_the_squeeze_number_is_on_the_full_width():
    assert squeeze_number(10e-3, 5e-6, 32300.0) == pytest.approx(1779, rel=1e-3)
    assert squeeze_number(20e-3, 5e-6, 32300.0) == pytest.approx(4 * 1779, rel=1e-3)


@pytest.mark.parametrize(
    ("W", "gap", "f", "named"),
    [
        (1, 0.9999, 32300, None),
        (1.0, 6.0, 32300, "inertia"),
        (1.0, 5.0, 20e3, "25000 Hz"),
        (0.5, 5.0, 32300, "1 um"),
        (0.5, 0.8, 32300, "slip"),
    ],
)
def test_a_law_beyond_its_range_is_named(W, gap, f, named):
    if named is None:
        with pytest.raises(StimulatorError, match="W_um"):
            film_pressure(W, gap, frequency_Hz=f)
    else:
        with pytest.warns(RangeWarning, match=named), warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=RangeWarning, message="(?!.*" + named + ")")
            film_pressure(W, gap, frequency_Hz=f)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: overpressure(1.0, 100), "film.e"),
        (lambda: overpressure(-0.1, 100), "film.e"),
        (lambda: overpressure(math.nan, 100), "film.e"),
        (lambda: overpressure(0.1, 0), "film.sigma"),
        (lambda: overpressure(0.1, math.inf), "film.sigma"),
        (lambda: Reynolds(1.0, 100), "film.e"),
        (lambda: Reynolds(0.1, -1), "film.sigma"),
        (lambda: Reynolds(0.1, 100, phases=8), "phases"),
        (lambda: Reynolds(0.5, 100, profile=lambda x: 1 - 0.6 * x).periodic(), "film.profile"),
        (lambda: Pad(0.0), "pad.width_m"),
        (lambda: Pad(1e-2, -1e-6), "pad.groove_m"),
        (lambda: Pad(1e-2, 1e-6, ridges=1.0), "pad.ridges"),
        (lambda: squeeze_number(1e-2, -1e-6, 3e4), "film.gap_m"),
    ],
)
def test_what_cannot_be_is_refused(make, key):
    with pytest.raises(StimulatorError, match=key):
        make()


def test_a_period_that_is_not_resolved_is_named():
    """e = 0.98 needs more than 33 phases; with 129 it is silent."""
    with pytest.warns(RangeWarning, match="33 phases"):
        coarse = Reynolds(0.98, 300).periodic()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fine = Reynolds(0.98, 300, cells=40, phases=129).periodic()
        Reynolds(0.95, 300).periodic()
    assert coarse.overpressure == pytest.approx(fine.overpressure, rel=0.01)
