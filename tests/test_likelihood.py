"""The density that is sampled, against its definition: a response that is late in a sweep, integrated out by
hand."""

import jax
import numpy as np
import pytest
import reference
from scipy.optimize import minimize_scalar

import sysid
from sysid.model.span import best_turn
from sysid.posterior.target import Target
from sysid.precision import float64

ROWS, STEP = 120, 1e-3  # s; far longer than a radian of the carrier
PLANT = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=0.0)
TIME, FREQUENCY, DRIVE = (
    STEP * np.arange(ROWS),
    PLANT.f0 + np.linspace(-300, 300, ROWS),
    np.append(0.0, np.full(ROWS - 1, 100.0)),
)
RADIAN = 1 / (2 * np.pi * np.median(FREQUENCY))
SHORT = 1e-6 * PLANT.tau  # of a difference: its error is a millionth of the rate


def response(G, tau, f0):
    """Of the sweep from rest, and its rate just before each row's inputs act."""
    plant, moments = reference.Plant(G, tau, f0, 0.0), np.union1d(TIME, TIME[1:] - SHORT)
    row = np.searchsorted(TIME, moments, side="right") - 1
    z = reference.ringing(plant, moments, DRIVE[row], FREQUENCY[row], np.full(len(moments), 24.0))
    at = np.searchsorted(moments, TIME)
    return z[at], np.append(0, z[at[1:]] - z[at[1:] - 1]) / SHORT


def log_density(found, theta):
    """-dof/2 log S - 1/2 log det B of a lateness whose real part has the deviation of a row, its imaginary
    part of a radian."""
    log, std = found.logs[0].log, found.logs[0].noise_std
    h, rate = response(*theta)
    row = np.hypot(STEP, RADIAN)
    shapes = -np.stack([row * rate, 1j * RADIAN * rate], axis=1)
    design = np.concatenate([shapes.real / std, shapes.imag / std, np.eye(2)])
    left = np.concatenate([(log.response - h).real / std, (log.response - h).imag / std, np.zeros(2)])
    square = np.sum((left - design @ np.linalg.lstsq(design, left, rcond=None)[0]) ** 2)
    return -0.5 * (2 * ROWS - 1) * np.log(square) - 0.5 * np.linalg.slogdet(design.T @ design)[1]


@pytest.mark.parametrize("late", [0.0, 2e-4])
def test_density_of_a_late_sweep_is_that_of_its_definition(late):
    h, rate = response(PLANT.G, PLANT.tau, PLANT.f0)
    noise = 0.02 * np.random.default_rng(1).standard_normal((2, ROWS)).T @ [1, 1j]
    given = {"time": TIME, "drive": DRIVE, "frequency": FREQUENCY, "kind": "transient", "sampling": "instant"}
    found = sysid.fit([sysid.Log("swept", h - late * rate + noise, **given)], nuisances=("late",))
    assert not found.logs[0].noise_time  # white, as here
    z = 1.5 * np.random.default_rng(2).standard_normal((6, 3))
    with jax.enable_x64(True):
        target = Target(found)
        target.density.smooth = False
        theta, value = target.theta(z), target(z)
    expected = [log_density(found, (np.exp(t[0]), np.exp(t[1]), found.reference[0] + t[2])) for t in theta]
    # The log's own level is integrated out with the priors in its units: a hundredth of two rows in 240.
    assert np.ptp(value - expected) < 0.01 * np.ptp(expected)


@float64
@pytest.mark.parametrize("seed", range(20))
def test_the_best_turn_is_that_of_a_search_over_all_angles(seed):
    """|left - cos phi shape - sin phi ahead|^2 has up to two minima; a grid and a line search know no
    derivative."""
    rng = np.random.default_rng(seed)
    left, shape, ahead = rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))

    def cost(phi):
        return np.sum(np.abs(left - np.cos(phi) * shape - np.sin(phi) * ahead) ** 2)

    around = np.linspace(0, 2 * np.pi, 2000)
    best = around[np.argmin([cost(phi) for phi in around])]
    exact = minimize_scalar(
        cost, bounds=(best - 0.01, best + 0.01), method="bounded", options={"xatol": 1e-12}
    ).x
    turn = complex(best_turn(left, shape, ahead))
    # a line search knows its minimum to the root of float64's rounding
    assert abs(turn - np.exp(1j * exact)) < 1e-7 and abs(abs(turn) - 1) < 1e-14
