"""The density that is sampled, against its definition: a response that is late in a sweep, and all that the bench
adds to an amplitude, integrated out by hand; and what programs see of a log against what differences show."""

import jax
import numpy as np
import pytest
import reference
from conftest import study
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import i0e, i1e

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
SETTLED = {"frequency": PLANT.f0 + np.linspace(-300, 300, ROWS), "drive": np.full(ROWS, 100.0)}
WARM = {"temperature": np.full(ROWS, 29.0)}
STEP_LOG = {"time": 1e-4 * np.arange(ROWS), "drive": DRIVE, "frequency": np.full(ROWS, PLANT.f0 + 40)}
DECAY = {**STEP_LOG, "drive": 100.0 * (np.arange(ROWS) < 20)}
RISE = {**DECAY, "drive": np.append(0.0, DECAY["drive"][1:])}  # and falls, from rest


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


def rayleigh(size, level):
    """Mean of the amplitude of `size` in noise of `level` in d and in q."""
    x = size**2 / (4 * level**2)
    return level * np.sqrt(np.pi / 2) * ((1 + 2 * x) * i0e(x) + 2 * x * i1e(x))


def rising(G, tau, f0):
    """Of RISE, and its rate just before each row's inputs act."""
    time = RISE["time"]
    moments = np.union1d(time, time[1:] - SHORT)
    row, at = np.searchsorted(time, moments, side="right") - 1, np.searchsorted(moments, time)
    plant, given = reference.Plant(G, tau, f0, 0.0), (RISE["drive"][row], RISE["frequency"][row])
    z = reference.ringing(plant, moments, *given, np.full(len(moments), 24.0))
    return z[at], np.append(0, z[at[1:]] - z[at[1:] - 1]) / SHORT


def test_density_of_an_amplitude_is_that_of_its_definition():
    """-dof/2 log S - 1/2 log det B of lateness and floor, which another search finds."""
    noise = 0.05 * np.random.default_rng(3).standard_normal((2, ROWS)).T @ [1, 1j]
    w = np.abs(rising(PLANT.G, PLANT.tau, PLANT.f0)[0] + noise)
    found = sysid.fit([sysid.Log("decay", w, **RISE, kind="transient", sampling="instant")])
    trial, target = found.modes[0].trials[0], Target(found)
    assert trial.bench.floor_free and not (trial.start_free or trial.bench.standing or trial.noise.time)
    priors, weight = np.array([trial.lateness, trial.looseness**2]), trial.noise.whitening()[0]
    ((_, x),) = target.density.groups

    def expected(theta):
        h, rate = rising(np.exp(theta[0]), np.exp(theta[1]), found.reference[0] + theta[2])

        def left(numbers):
            late, floor = numbers * priors
            size = rayleigh(np.abs(h - late * rate), np.sqrt(max(floor, 1e-9)))
            return np.append(weight * (w - size), numbers)

        first = np.array([trial.bench.late, trial.bench.floor]) / priors
        best = least_squares(left, first, x_scale=np.abs(first), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        volume = 0.5 * np.linalg.slogdet(best.jac.T @ best.jac)[1]
        return -0.5 * float(x.freedom[0]) * np.log(2 * best.cost) - volume, volume

    target.density.about = None
    z = np.random.default_rng(2).standard_normal((8, len(target.names)))
    with jax.enable_x64(True):
        value, (wanted, volume) = target(z), np.transpose([expected(t) for t in target.theta(z)])
    # Rice's mean is 6e-5 of the noise off in 120 rows; the volume differs by far more from plant to plant
    assert np.ptp(value - wanted) < 0.01 < 0.1 * np.ptp(volume)


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
def test_what_differences_show_of_a_log_is_what_a_compiled_program_sees(given, amplitude, levels, low_q):
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
    plain, compiled = (_seen(groups, theta, directions, FLAT, how) for how in (True, False))
    for here, there in zip(plain.found[0], compiled.found[0], strict=True):
        # the rounding of a few hundred terms, times what nearly parallel columns lose of it
        np.testing.assert_allclose(here, there, rtol=1e-7, atol=1e-9)
    size = np.sqrt(np.diag(compiled.sums.gram)) + 1e-12
    here, there = (seen.sums.gram / np.outer(size, size) for seen in (plain, compiled))
    np.testing.assert_allclose(here, there, atol=1e-5)  # a difference over 1e-7 of a step is right to that
    off = 1e-5 * np.sqrt(2 * compiled.sums.cost)
    np.testing.assert_allclose(plain.sums.gradient / size, compiled.sums.gradient / size, atol=off)
