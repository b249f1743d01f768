"""Wavelengths, counts, a bare plate's modes and the loss to the air, beside closed forms and published
values."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq

from stimulator import Material, PlateGeometry
from stimulator.plate import ALUMINIUM, BARE, COPPER_BERYLLIUM, STEEL
from stimulator.theory import bare_modes, radiation_tau, wavelength, weyl_count

H, F = 1.2e-3, 32300.0
KEY = Material("wave", 69e9, 2700.0, 0.33)


def bare(plate, **options):
    """Modes of all four parity classes, ascending, without the three of a rigid body."""
    classes = product((0, 1), repeat=2)
    return np.sort(np.concatenate([bare_modes(plate, parity, **options) for parity in classes]))[3:]


def test_mindlin_is_within_a_fifth_of_a_per_cent_of_the_exact_wave():
    exact = wavelength(ALUMINIUM, H, F, "rayleigh_lamb")
    assert exact == pytest.approx(18.728e-3, abs=1e-6)
    assert wavelength(ALUMINIUM, H, F, "mindlin") == pytest.approx(exact, rel=2e-3)


def test_kirchhoff_s_wave_is_longer_by_1_4_per_cent():
    ratio = wavelength(ALUMINIUM, H, F, "kirchhoff") / wavelength(ALUMINIUM, H, F, "rayleigh_lamb")
    assert 1.012 < ratio < 1.016


def test_slow_waves_are_kirchhoff_s_in_all_theories():
    thin = wavelength(STEEL, H, 20.0, "kirchhoff")
    # of (k h)^2 = 5e-5, what the theories differ by at this frequency
    for theory in ("mindlin", "rayleigh_lamb"):
        assert wavelength(STEEL, H, 20.0, theory) == pytest.approx(thin, rel=1e-4)


def test_fast_waves_of_the_exact_theory_are_rayleigh_s():
    """Where the layer is many wavelengths thick, each face carries Rayleigh's surface wave, whose cubic is
    solved here."""
    ratio2 = (1 - 2 * KEY.nu) / (2 * (1 - KEY.nu))  # (c_t/c_l)^2
    x = brentq(
        lambda x: x**3 - 8 * x**2 + (24 - 16 * ratio2) * x - 16 * (1 - ratio2), 0.5, 0.999
    )  # (c/c_t)^2
    speed = math.sqrt(x * KEY.shear / KEY.rho)
    frequency = 8 * speed / H
    assert wavelength(KEY, H, frequency, "rayleigh_lamb") == pytest.approx(speed / frequency, rel=1e-6)


def test_mindlin_s_wave_satisfies_his_two_equations():
    k, omega = 2 * math.pi / wavelength(ALUMINIUM, H, F), 2 * math.pi * F
    shear, D = math.pi**2 / 12 * 69e9 / 2.66 * H, 69e9 * H**3 / 12 / (1 - 0.33**2)
    motion = [
        [shear * k**2 - 2700 * H * omega**2, -shear * k],
        [-shear * k, D * k**2 + shear - 2700 * H**3 / 12 * omega**2],
    ]
    assert abs(np.linalg.det(motion)) < 1e-9 * motion[0][0] * motion[1][1] + 1e-9 * (shear * k) ** 2


def test_ritz_gives_the_free_square_plate():
    """lambda = omega a^2 sqrt(rho h/D) at nu = 0.3; Leissa's five lie up to 0.5 % above these converged
    ones."""
    square = PlateGeometry(1.0, 1.0, 1e-3, Material("unit", 12 * (1 - 0.3**2), 1.0, 0.3))  # D = h^3, mass h
    found = 2 * math.pi * bare(square, terms=(12, 12)) / 1e-3
    published = [13.46820, 19.59614, 24.27020, 34.80089, 34.80089, 61.09323]
    np.testing.assert_allclose(found[:6], published, rtol=2e-6)


def test_ritz_gives_a_strip_s_beam_modes():
    """With nu = 0 the modes that do not depend on y are those of a free beam, cos kL cosh kL = 1."""
    strip = PlateGeometry(0.2, 0.05, 1e-3, Material("no contraction", 70e9, 2700.0, 0.0))
    roots = [brentq(lambda x: math.cos(x) - 1 / math.cosh(x), g - 1, g + 1) for g in (4.73, 7.853, 10.996)]
    beam = np.array(roots) ** 2 / (2 * math.pi * 0.2**2) * math.sqrt(70e9 * 1e-6 / 12 / 2700)
    found = np.concatenate([bare_modes(strip, (i, 0), (14, 4)) for i in (0, 1)])
    assert all(np.min(np.abs(found / f - 1)) < 1e-6 for f in beam)


@pytest.mark.parametrize("low", range(27000, 37000, 1000))
def test_weyl_s_count_is_within_three(low):
    """The term left out is of the edges: two modes in 1 kHz here."""
    found = bare(BARE)
    counted = np.sum((found > low) & (found < low + 1000))
    assert abs(counted - weyl_count(BARE, low, low + 1000)) <= 3


@pytest.mark.parametrize(("material", "ms"), [(ALUMINIUM, 6.5), (STEEL, 18.7), (COPPER_BERYLLIUM, 18.4)])
def test_the_air_bounds_tau(material, ms):
    """Three digits of a hand calculation with rho0 c = 412: 1 %."""
    tau = radiation_tau(material.rho * H, wavelength(material, H, F), F)
    assert 1e3 * tau == pytest.approx(ms, rel=0.01)


def test_a_wave_slower_than_sound_does_not_radiate():
    assert radiation_tau(3.0, 5e-3, 30e3) == math.inf


def test_radiation_is_the_power_of_a_plane_wave():
    """From p = rho0 omega v/k_z on both faces: energy m <v^2> falls at 2/tau."""
    omega, k = 2 * math.pi * F, 2 * math.pi / 18.7e-3
    k_z = math.sqrt((omega / 343) ** 2 - k**2)
    power, energy = 2 * 1.2 * omega / k_z, 3.24
    assert radiation_tau(3.24, 18.7e-3, F) == pytest.approx(2 * energy / power, rel=1e-9)
