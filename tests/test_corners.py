"""A short version of the study benchmarks/corners.py: finite, and right to rounding, where numbers are at
their ends."""

import importlib.util
from pathlib import Path

import jax
import mpmath
import numpy as np
import pytest

from sysid import Plant
from sysid.model.plant import expm1

STUDY = Path(__file__).parents[1] / "benchmarks" / "corners.py"
SAMPLE = 12
# Each of some ten operations rounds by half an eps, and so do the sine, the cosine and the exponential.
ROUNDINGS = 16.0


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("corners_study", STUDY)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_values_and_derivatives_are_finite(study):
    with jax.enable_x64(True):
        for name, (values, slopes) in study.computed(study.corners(500, seed=1)).items():
            assert np.isfinite(values).all() and np.isfinite(slopes).all(), name


def test_values_and_derivatives_are_those_of_sixty_digits(study):
    corners = study.corners(SAMPLE, seed=1)
    with jax.enable_x64(True), mpmath.workdps(60):
        found = study.errors(corners, study.SIXTY)
    for name, errors in found.items():
        assert np.all(errors < ROUNDINGS), (name, np.argmax(errors))


@pytest.mark.study
@pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="a long double is no longer than a double here"
)
def test_extended_numbers_stand_for_sixty_digits(study):
    corners = study.corners(5000, seed=20)
    with jax.enable_x64(True):
        assert (
            study.between({name: values[:SAMPLE] for name, values in corners.items()}) < 0.1
        )  # of one rounding
        for name, errors in study.errors(corners).items():
            assert np.all(errors < ROUNDINGS), (name, np.argmax(errors))


def test_a_drive_far_above_the_resonance_costs_no_digits(study):
    """omega0 is no sum of the drive and the detuning: at Q of 0.65 the damped frequency hangs on its last
    digits."""
    corners = {name: np.array(values) for name, values in FAR_ABOVE.items()}
    with jax.enable_x64(True), mpmath.workdps(60):
        exact = study.truths(corners, study.SIXTY)["transient"]
        error = study.furthest(study.transients(corners), exact, study.SIXTY)
    assert error[0] < ROUNDINGS


TAU = 0.65 / np.pi  # of Q 0.65 at 1 Hz
FAR_ABOVE = {
    "G": [1.0],
    "tau": [TAU],
    "f0": [1.0],
    "frequency": [[1.0, 1.8e4, 3.2e4, 1.0]],
    "time": [np.cumsum([0.1, 1e-4, 2e-4, 0.5]) * TAU],
    "duration": [np.diff(np.cumsum([0.1, 1e-4, 2e-4, 0.5]) * TAU, prepend=0.0)],
    "drive": [[0.0, 1.0, -1.0, 0.0]],
}


def test_over_a_long_turn_a_dead_mode_leaves_nothing_in_the_derivative():
    """exp(z) where it is 1e-200: 1 + expm1(z) is the rounding of a turn, which a derivative multiplies by its
    length."""
    with jax.enable_x64(True):
        z, length = (jax.numpy.asarray(v, complex) for v in (-460.0 + 1.3e8j, 1e8))
        slope = complex(jax.jvp(expm1, (z,), (length,))[1])
    with mpmath.workdps(60):
        exact = complex(mpmath.exp(mpmath.mpc(-460.0, 1.3e8)) * mpmath.mpf(1e8))
    assert abs(slope - exact) <= 4 * np.finfo(float).eps * (1 + 1.3e8) * abs(
        exact
    )  # a turn of |z| rounds to eps |z|


def test_a_frequency_far_off_at_first_costs_a_later_one_no_digits():
    """Detunings are differences of frequencies, not of offsets from the first of them."""
    tau, f0 = 0.1, 32e3
    half = 1 / (2 * np.pi * tau)
    time, volts = np.array([0.0, 1e-3, 1e-2]), np.array([0.0, 1.0, 1.0])
    frequency = f0 + half * np.array([2e5, 0.06, 0.06])
    found = Plant(1.0, tau, f0).transient(time, volts, frequency)[-1]
    with mpmath.workdps(60):
        w0, omega, late = (
            2 * mpmath.pi * f0,
            2 * mpmath.pi * mpmath.mpf(frequency[1]),
            mpmath.mpf(time[2]) - mpmath.mpf(time[1]),
        )
        wd = mpmath.sqrt(w0**2 - mpmath.mpf(tau) ** -2)
        slow, fast = (
            mpmath.mpc(-1 / mpmath.mpf(tau), wd - omega),
            mpmath.mpc(-1 / mpmath.mpf(tau), -(wd + omega)),
        )
        exact = complex(w0 / (tau * wd) * (mpmath.expm1(slow * late) / slow + 1 / fast))
    assert abs(found - exact) < ROUNDINGS * np.finfo(float).eps * abs(exact)
