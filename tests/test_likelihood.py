"""The density that is sampled, against its definition: a response that is late in a sweep, integrated out by
hand."""

import jax
import numpy as np
import pytest
import reference
from conftest import study
from scipy.optimize import minimize_scalar

import sysid
from sysid.minimum.descent import _seen
from sysid.model.prior import FLAT
from sysid.model.span import best_turn
from sysid.posterior.target import Target
from sysid.precision import float64
from sysid.trials.experiment import group
from sysid.trials.extra import asked
from sysid.trials.noise import Level
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import NUISANCES, Trial, with_noise

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
        target.density.about = None
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


SETTLED = {"frequency": PLANT.f0 + np.linspace(-300, 300, ROWS), "drive": np.full(ROWS, 100.0)}
WARM = {"temperature": np.full(ROWS, 29.0)}
STEP_LOG = {"time": 1e-4 * np.arange(ROWS), "drive": DRIVE, "frequency": np.full(ROWS, PLANT.f0 + 40)}
DECAY = {**STEP_LOG, "drive": 100.0 * (np.arange(ROWS) < 20)}
TWO = (Level(0.02, 0.0), Level(0.05, 3e-4))  # noise that differs between d and q


@pytest.mark.parametrize(
    "given, amplitude, levels, low_q",
    [
        (STEP_LOG, False, (), False),
        study(STEP_LOG, False, (), True),
        (STEP_LOG, False, TWO, False),
        study(STEP_LOG, True, (), False),
        (DECAY, True, (), False),
        ({**STEP_LOG, "theta": 2 * np.pi * (PLANT.f0 + 40) * STEP_LOG["time"]}, False, (), False),
        study({**STEP_LOG, "force": np.linspace(0, 1, ROWS)}, False, (), False),
        ({**STEP_LOG, "bench": {"lockin_tau_s": 3e-4, "lockin_order": 2}}, False, (), False),
        study({k: v for k, v in STEP_LOG.items() if k != "frequency"}, False, (), False),
        ({"time": TIME, "drive": DRIVE, "frequency": FREQUENCY}, False, (), False),
        (SETTLED | WARM, False, (), False),
        study(SETTLED, True, (), False),
        study({"frequency": SETTLED["frequency"]}, False, (), False),
        study({"frequency": SETTLED["frequency"]}, True, (), False),
    ],
)
@float64
def test_what_numpy_sees_of_a_log_is_what_a_compiled_program_sees(given, amplitude, levels, low_q):
    kind, rng = "transient" if "time" in given else "steady", np.random.default_rng(1)
    h, _ = response(PLANT.G, PLANT.tau, PLANT.f0)
    w = h + 0.05 * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    w = np.abs(w) if amplitude else w if "frequency" in given else w.real
    trial = Trial.of(sysid.Log("log", w, kind=kind, **given), kind, (*NUISANCES, "gain"))
    trial, reference = with_noise(trial, 0.05, 2e-4 if kind == "transient" else 0.0, levels), (PLANT.f0, 24.0)
    theta = np.array([np.log(0.021), np.log(1.7e-3), 15.0, -8.0, 0.3, 5.0])
    trial = trial.with_bench(extra=asked(trial, LogResponse.of(trial, reference, theta), (0.0, 0.0)))
    groups, _ = group((trial,), reference, low_q=low_q)
    directions = np.diag([1.0, 1.0, 95.0, 9.5, 1.0, 95.0])[:, : 6 if "force" in given else 4]
    by_numpy, compiled = (_seen(groups, theta, directions, FLAT, plain) for plain in (True, False))
    for here, there in zip(by_numpy.found[0], compiled.found[0], strict=True):
        # the rounding of a few hundred terms, times what nearly parallel columns lose of it
        np.testing.assert_allclose(here, there, rtol=1e-7, atol=1e-9)
    size = np.sqrt(np.diag(compiled.sums.gram)) + 1e-12
    here, there = (seen.sums.gram / np.outer(size, size) for seen in (by_numpy, compiled))
    np.testing.assert_allclose(here, there, atol=1e-5)  # a difference over 1e-7 of a step is right to that
    off = 1e-5 * np.sqrt(2 * compiled.sums.cost)
    np.testing.assert_allclose(by_numpy.sums.gradient / size, compiled.sums.gradient / size, atol=off)
