"""The residual sums that starting points are chosen by, against dense least squares on a response made
another way."""

import numpy as np
import pytest
import reference
from scipy.special import i0e, i1e

from sysid import Log
from sysid.minimum.search import SEARCH_ROWS, Search
from sysid.model.carry import ONE_LANE
from sysid.trials.trial import Trial

ROWS = 120
DEGC = 27.0
POINTS = np.array(
    [
        [np.log(1.67e-3), 10.0, 0.0],
        [np.log(4e-4), -150.0, -10.0],
        [np.log(0.03), 300.0, 4.0],
        [np.log(2e-5), 0.0, 1.0],
    ]
)
F0 = 32300.0
TIME = 2e-4 * np.arange(ROWS)
STEP = np.where(np.arange(ROWS) < 15, 0.0, 100.0)
STAIRCASE = np.append(0.0, np.random.default_rng(3).uniform(-100, 100, ROWS - 1))
SWEEP = F0 + np.linspace(-400, 300, ROWS)


def plant(point):
    """The candidate, of unit gain."""
    tau, shift, k_T = np.exp(point[0]), point[1], point[2]
    return reference.Plant(1.0, tau, F0 + shift, k_T)


def ringing(point, drive, frequency):
    """The response per unit gain, and the decay of a unit start."""
    p, degC = plant(point), np.full(ROWS, DEGC)
    slow = [reference.modes(p, f, DEGC, p.tau)[0] for f in frequency[:-1]]
    return reference.ringing(p, TIME, drive, frequency, degC), np.exp(
        np.append(0, np.cumsum(slow * np.diff(TIME)))
    )


def noisy(clean):
    """Of a rotated demodulator with an offset."""
    size, rng = np.max(np.abs(clean)), np.random.default_rng(0)
    return np.exp(0.4j) * clean + 0.02 * size * (
        1 + rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS)
    )


def least(y, shapes, top=1.0):
    """The residual sum of squares and the coefficient of the first of the shapes (K, n), each with its prior;
    that of the first is in the unit of the response for a drive of `top`."""
    scale = np.max(np.abs(y))
    level, loose = 0.05 * scale, 10 * scale
    design = np.concatenate([np.transpose(shapes) / level, np.diag([top, *np.ones(len(shapes) - 1)]) / loose])
    data = np.concatenate([y / level, np.zeros(len(shapes))])
    found = np.linalg.lstsq(design, data, rcond=None)[0]
    return np.sum(np.abs(data - design @ found) ** 2), np.abs(found[0])


def agrees(log, expected):
    trial = Trial.of(log, log.kind)
    sums, found = Search([trial], (F0, 24.0))(POINTS)
    truth = np.array([expected(point, trial) for point in POINTS])
    np.testing.assert_allclose(sums[:, 0], truth[:, 0], rtol=1e-8)
    np.testing.assert_allclose(found[:, 0], truth[:, 1], rtol=1e-6)


def transient(drive, frequency, amplitude=False, sampling="instant"):
    y = noisy(0.02 * ringing(POINTS[0], drive, frequency)[0])
    if sampling == "settled":  # the inputs of each row are those that have led to it
        drive, frequency = (np.append(v[0], v[:-1]) for v in (drive, frequency))
    given = {"time": TIME, "drive": drive, "frequency": frequency, "temperature": np.full(ROWS, DEGC)}
    return Log("log", np.abs(y) if amplitude else y, kind="transient", sampling=sampling, **given)


@pytest.mark.parametrize("sampling", ["instant", "settled"])
@pytest.mark.parametrize("frequency", [np.full(ROWS, F0 - 40.0), SWEEP], ids=["held", "swept"])
@pytest.mark.parametrize("drive", [STEP, STAIRCASE], ids=["step", "staircase"])
def test_a_transient(drive, frequency, sampling):
    """Gain, start, offset and feedthrough have complex coefficients."""
    log = transient(drive, frequency, sampling=sampling)
    felt = np.append(drive[0], drive[:-1])  # over the step that ends at each row

    def expected(point, trial):
        shapes = [*ringing(point, drive, frequency), np.ones(ROWS), felt / np.max(np.abs(felt))]
        return least(log.response, shapes, np.max(np.abs(log.drive)))

    assert len(STAIRCASE) > ONE_LANE  # more than are taken one after the other
    agrees(log, expected)


@pytest.mark.parametrize("drive", [STEP, STAIRCASE], ids=["step", "staircase"])
def test_an_amplitude(drive):
    log = transient(drive, np.full(ROWS, F0 - 40.0), amplitude=True)

    def expected(point, trial):
        h, e = np.abs(ringing(point, drive, log.frequency))
        return least(log.response, [h, e] if trial.start_free else [h], np.max(np.abs(log.drive)))

    agrees(log, expected)


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("amplitude", [False, True])
def test_a_sweep(amplitude, recorded):
    """A background with a slope beside the resonance of the d/q log."""
    degC, drive = np.full(ROWS, DEGC), np.full(ROWS, 50.0 if recorded else 1.0)
    y = noisy(0.02 * reference.steady(plant(POINTS[0]), drive, SWEEP, degC))
    y = np.abs(y) if amplitude else y
    log = Log("log", y, drive=drive if recorded else None, frequency=SWEEP, temperature=degC, kind="steady")

    def expected(point, trial):
        h, slope = reference.steady(plant(point), drive, SWEEP, degC), SWEEP - SWEEP.mean()
        top = 1.0 if log.drive is None else np.max(np.abs(log.drive))
        return least(y, [np.abs(h)] if amplitude else [h, np.ones(ROWS), slope / np.max(np.abs(slope))], top)

    agrees(log, expected)


def test_an_amplitude_that_only_decays():
    """The mean of Rice's distribution is linear in its start and its floor about what is known of them."""
    y = np.abs(noisy(2 * ringing(POINTS[0], np.zeros(ROWS), np.full(ROWS, F0))[1]))
    log = Log(
        "log",
        y,
        time=TIME,
        drive=np.zeros(ROWS),
        frequency=np.full(ROWS, F0),
        temperature=np.full(ROWS, DEGC),
    )
    trial = Trial.of(log, "transient")
    loose, level, floor = 10 * trial.scale, 0.05 * trial.scale, (1e-3 * trial.scale) ** 2

    def modelled(values, free):
        square = loose * values[2]
        h = np.abs((values[0] + 1j * values[1]) * free) ** 2 / (4 * square)
        return np.sqrt(0.5 * np.pi * square) * ((1 + 2 * h) * i0e(h) + 2 * h * i1e(h))

    trial, now = trial.with_bench(start=1.8 - 0.4j), np.array([1.8, -0.4, floor / loose])
    found = Search([trial], (F0, 24.0)).sums(POINTS)[:, 0]
    for point, value in zip(POINTS[:3], found, strict=False):
        free = ringing(point, np.zeros(ROWS), log.frequency)[1]
        small = 1e-4 * np.abs(now)
        slopes = [
            (modelled(now + d, free) - modelled(now - d, free)) / (2 * np.sum(d)) for d in np.diag(small)
        ]
        design = np.concatenate([np.transpose(slopes) / level, np.eye(3) / loose])
        data = np.concatenate([(y - modelled(now, free) + now @ slopes) / level, np.zeros(3)])
        left = data - design @ np.linalg.lstsq(design, data, rcond=None)[0]
        # The mean is a fit, right to 6e-5 of the level, and moves with the floor by one that is right to
        # 1e-3.
        assert value == pytest.approx(left @ left, rel=1e-4)


def test_of_a_long_log_a_few_rows_are_seen_and_what_is_beyond_all_numbers_is_worst():
    rows = 20_000
    rng = np.random.default_rng(1)
    given = {
        "time": 1e-4 * np.arange(rows),
        "drive": rng.uniform(0, 100, rows),
        "frequency": np.full(rows, F0),
    }
    log = Log("log", rng.standard_normal(rows) + 0j, kind="transient", sampling="instant", **given)
    search = Search([Trial.of(log, "transient")], (F0, 24.0))
    assert search.freedom[0] == 2 * SEARCH_ROWS
    sums = search.sums(np.array([[np.log(1e-3), 0.0, 0.0], [800.0, 0.0, 0.0], [0.0, np.nan, 0.0]]))
    assert np.isfinite(sums[0, 0]) and np.isinf(sums[2, 0])
