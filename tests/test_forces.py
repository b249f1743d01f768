"""Force sensors, the filters behind them, strokes and textures: against closed forms, and over many draws."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import ndtri
from scipy.stats import chi2

from stimulator import CornerForces, StimulatorError, Stroke
from stimulator.filters import Kalman, OnePole, Unfiltered
from stimulator.forces import shares
from stimulator.texture import ImageRow, Noise, Sine, Square
from sysid import Profile

SIZE = (198.0, 138.0)
QUIET = CornerForces(noise=0.0, filter=Unfiltered(latency=0.0))


def resting(force=0.5, x=60.0, y=40.0):
    return Stroke(Profile.constant(x), Profile.constant(y), Profile.constant(force))


def read(sensors, stroke, duration=1.0, seed=0):
    return sensors.read(stroke, SIZE, duration, seed)


def test_a_rigid_plate_s_centroid_is_exact():
    stroke = Stroke.to_and_fro(99.0, 45.0, 1.2, 40.0, 0.7, 1.0)
    found = read(QUIET, stroke)
    x, y, force = stroke.at(found.time)
    np.testing.assert_allclose([found.x, found.y, found.force], [x, y, force], rtol=1e-12)
    np.testing.assert_allclose(shares(x, y, SIZE).sum(axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize("x, force", [(60.0, 1.0), (60.0, 0.2), (150.0, 0.5)])
def test_noise_moves_the_position_as_its_formula_says(x, force):
    # x = L (F2 + F4)/F has d x = (x - L) and x over F for the sensors on either side: two of each
    sensors = dataclasses.replace(QUIET, noise=1.5e-3)
    found = read(sensors, resting(force, x), duration=40.0)
    n = len(found.x)
    variance = (1.5e-3 / force) ** 2 * (2 * x**2 + 2 * (198.0 - x) ** 2)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], n - 1) / (n - 1)  # one of 5000 such tests fails
    assert low < np.var(found.x, ddof=1) / variance < high * (1 + 3 * variance / 198.0**2)
    assert found.x.mean() == pytest.approx(x, abs=4 * np.sqrt(variance / n) + variance / 198.0)


def test_an_offset_moves_the_position_and_a_null_takes_it_away():
    drifted = dataclasses.replace(QUIET, offset=10e-3)
    off = np.array([read(drifted, resting(), 0.01, seed).x[0] - 60.0 for seed in range(300)])
    std = 10e-3 / 0.5 * np.sqrt(2 * 60.0**2 + 2 * 138.0**2)
    assert np.std(off) == pytest.approx(std, rel=4 / np.sqrt(600))
    nulled = dataclasses.replace(drifted, null=0.1, noise=1e-3)
    left = np.array([read(nulled, resting(), 0.5, seed).x.mean() - 60.0 for seed in range(100)])
    # the null is a mean of 100 readings, the touch one of 501: noise of 1 mN each
    assert np.std(left) == pytest.approx(0.1 * std * np.sqrt(1 / 100 + 1 / 501), rel=4 / np.sqrt(200))


def test_steps_and_range_of_a_sensor():
    coarse = dataclasses.replace(QUIET, quantisation=10e-3)
    found = read(coarse, Stroke.line(20.0, 80.0, 1.0, 40.0, 0.5))
    assert np.allclose(found.force / 10e-3, np.round(found.force / 10e-3))
    error = found.x - Stroke.line(20.0, 80.0, 1.0, 40.0, 0.5).x.at(found.time)
    assert 0 < np.max(np.abs(error)) < 4 * 5e-3 / 0.5 * 198.0
    clipped = read(dataclasses.replace(QUIET, range=0.1), resting(force=2.0))
    assert np.all(clipped.force <= 0.4)


def test_the_position_is_held_while_nothing_touches():
    time = np.array([0.0, 0.2, 0.2001, 0.3, 0.3001, 1.0])
    force = Profile(time, np.array([0.5, 0.5, 0.0, 0.0, 0.5, 0.5]), held=False)
    stroke = Stroke(
        Profile(np.array([0.0, 1.0]), np.array([20.0, 120.0]), held=False), Profile.constant(40.0), force
    )
    for kind in (Unfiltered(0.0), OnePole(1e-6, 0.0), Kalman(latency=0.0)):
        found = read(dataclasses.replace(QUIET, filter=kind), stroke)
        away = (found.time > 0.2005) & (found.time < 0.2995)
        assert np.ptp(found.x[away]) == 0 and found.x[away][0] == pytest.approx(40.0, abs=0.15)
        assert found.x[350] == pytest.approx(55.0, abs=0.05)  # where it came down, nothing is left of before
    assert read(QUIET, resting(force=0.0)).x[0] == 99.0  # never touched: the middle


def test_one_pole_is_that_of_a_signal_processing_library():
    sensors = dataclasses.replace(QUIET, noise=1.5e-3)
    stroke = Stroke.line(20.0, 80.0, 1.0, 40.0, 0.5)
    raw, found = (
        read(dataclasses.replace(sensors, filter=f), stroke).x for f in (Unfiltered(), OnePole(5e-3))
    )
    share = -np.expm1(-1e-3 / 5e-3)
    truth = lfilter([share], [1, share - 1], raw, zi=[(1 - share) * raw[0]])[0]
    np.testing.assert_allclose(found, truth, rtol=1e-12)
    late = raw[500:] - found[500:]
    assert late.mean() == pytest.approx(
        80.0 * 1e-3 * (1 - share) / share, abs=0.3
    )  # lags by v times its delay


def kalman_by_batch(z, r, step, q):
    """The last position and velocity from all readings at once: generalised least squares, the same model."""
    n = len(z)
    F, Q = np.array([[1, step], [0, 1]]), q * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    steps = [np.linalg.matrix_power(F, k) for k in range(n)]
    first = np.diag([r[0], 1e6])  # what is known after the first reading
    ahead = [
        steps[k] @ first @ steps[k].T + sum(steps[j] @ Q @ steps[j].T for j in range(k)) for k in range(n)
    ]
    cov = np.array([[(ahead[min(i, j)] @ steps[abs(i - j)].T)[0, 0] for j in range(n)] for i in range(n)])
    cross = np.array(
        [(steps[n - 1 - i] @ ahead[i])[:, 0] for i in range(n)]
    ).T  # of the last state with each position
    seen = slice(1, None)
    gain = cross[:, seen] @ np.linalg.inv(cov[seen, seen] + np.diag(r[seen]))
    return np.array([z[0], 0.0]) + gain @ (z[seen] - z[0])


def test_kalman_is_the_best_linear_estimate():
    rng = np.random.default_rng(3)
    z = 50 + 80 * 1e-3 * np.arange(25) + 0.6 * rng.standard_normal(25)
    r = rng.uniform(0.2, 0.6, 25)
    kind = Kalman(acceleration=5.0, lasting=0.2, latency=2e-3)
    on = np.ones((25, 1), bool)
    found = kind(z[:, None], on, np.sqrt(r)[:, None], 1e-3, 99.0)[-1, 0]
    x, v = kalman_by_batch(z, r, 1e-3, 2 * 5000.0**2 * 0.2)
    assert found == pytest.approx(x + 2e-3 * v, rel=1e-9)


def test_kalman_predicts_over_its_latency():
    stroke = Stroke.line(20.0, 80.0, 1.0, 40.0, 0.5)
    for latency in (0.0, 1e-3, 5e-3):
        sensors = dataclasses.replace(CornerForces(noise=1e-7), filter=Kalman(latency=latency))
        found = read(sensors, stroke)
        moving = (found.time > 0.2) & (found.time < 1.0)
        np.testing.assert_allclose(found.x[moving], stroke.x.at(found.time[moving]), atol=0.02)


def test_many_strokes_at_once_are_each_alone():
    sensors = dataclasses.replace(CornerForces(), filter=Kalman(), null=0.05, offset=5e-3)
    strokes = [Stroke.line(20.0, v, 1.0, 40.0, F) for v, F in ((60.0, 0.3), (100.0, 0.04), (80.0, 0.8))]
    together = sensors.read(strokes, SIZE, 1.0, [4, 5, 6])
    for k, stroke in enumerate(strokes):
        alone = read(sensors, stroke, seed=4 + k)
        assert np.array_equal(together.x[:, k], alone.x) and np.array_equal(together.force[:, k], alone.force)


def test_each_part_draws_for_itself():
    plain, nulled = (read(dataclasses.replace(CornerForces(), null=n), resting()).force for n in (0.0, 0.5))
    assert np.ptp(nulled - plain) < 1e-12  # the same noise less a constant


@pytest.mark.parametrize(
    "change, key",
    [
        ({"rate": 0.0}, "forces.rate"),
        ({"noise": -1.0}, "forces.noise"),
        ({"noise": np.nan}, "forces.noise"),
        ({"contact": 0.0}, "forces.contact"),
        ({"range": np.inf}, "forces.range"),
        ({"filter": OnePole(tau=0.0)}, "forces.filter.tau"),
        ({"filter": Kalman(acceleration=-1.0)}, "forces.filter.acceleration"),
    ],
)
def test_sensors_that_cannot_be(change, key):
    with pytest.raises(StimulatorError, match=key):
        dataclasses.replace(CornerForces(), **change)


# --- textures -----------------------------------------------------------------------------------------------


def test_a_square_grating_is_on_over_its_share():
    x = np.linspace(0, 100, 100_001)[:-1]
    asked = Square(period=5.0, amplitude=1.5, duty=0.3).at(x)
    assert set(np.unique(asked)) == {0.0, 1.5} and np.mean(asked) == pytest.approx(0.45, abs=1e-3)
    assert np.array_equal(Square(5.0).at(np.array([-0.1, 0.0, 2.4, 2.5, 4.9, 5.0])), [0, 1, 1, 0, 0, 1])


def test_a_sine_and_its_spectrum():
    x = np.arange(1000) * 0.05
    spectrum = np.abs(np.fft.rfft(Sine(period=5.0, amplitude=2.0).at(x))) / 1000
    assert spectrum[0] == pytest.approx(1.0) and spectrum[10] == pytest.approx(0.5)
    assert np.delete(spectrum, [0, 10]).max() < 1e-12


def test_noise_is_uniform_and_has_no_shorter_waves():
    x = np.arange(40_000) * 0.05
    asked = np.concatenate([Noise(period=2.0, amplitude=1.0, seed=s).at(x[::20]) for s in range(40)])
    # 40 stretches of 2000 mm hold some 20 000 independent values
    levels = np.linspace(0.05, 0.95, 19)
    assert np.max(np.abs(np.quantile(asked, levels) - levels)) < 0.03
    waves = ndtri(np.clip(Noise(period=2.0).at(x), 1e-12, 1 - 1e-12))
    power = np.abs(np.fft.rfft(waves * np.hanning(len(x)))) ** 2
    cycles = np.fft.rfftfreq(len(x), 0.05)
    beyond = power[(cycles > 0.501) | (cycles < 0.0623)]
    assert beyond.sum() < 1e-6 * power.sum()


def test_an_image_row_is_read_from_a_file(tmp_path):
    from matplotlib.image import imsave

    grey = np.arange(0, 200, 5)
    rows = np.vstack([grey[::-1], grey]).astype(np.uint8)
    imsave(tmp_path / "wood.png", np.stack([rows, rows, rows], axis=-1))
    texture = ImageRow.of_file(tmp_path / "wood.png", 1, pixel=0.5, start=10.0, amplitude=2.0)
    np.testing.assert_allclose(
        texture.at(10.25 + 0.5 * np.arange(40)), 2.0 * grey / 255, atol=1e-6
    )  # single precision
    assert np.array_equal(texture.at(np.array([9.9, 30.1])), [0, 0])
    with pytest.raises(StimulatorError, match=r"texture\.row"):
        ImageRow.of_file(tmp_path / "wood.png", 2)
    (tmp_path / "no.png").write_text("nothing")
    with pytest.raises(StimulatorError, match=r"texture\.image"):
        ImageRow.of_file(tmp_path / "no.png", 0)


# --- strokes ------------------------------------------------------------------------------------------------


def test_a_recorded_stroke_is_read_in_its_units(save):
    path = save(
        "# finger: 3\ntime_ms,x_cm,y_mm,force_mN\n0,2,40,0\n500,6,40,700\n1000,10,41,300\n", "stroke.csv"
    )
    stroke = Stroke.from_csv(path)
    x, y, force = stroke.at(np.array([0.25, 0.75]))
    np.testing.assert_allclose([x, y, force], [[40, 80], [40, 40.5], [0.35, 0.5]])
    assert stroke.duration == 1.0 and stroke.speed() == pytest.approx(np.hypot(80.0, 2.0))


@pytest.mark.parametrize(
    "text, key",
    [
        ("time_s,x_mm,force_N\n0,1,1\n", "y_mm"),
        ("time_s,x_N,y_mm,force_N\n0,1,1,1\n", "x_N"),
        ("time_s,x_mm,y_mm,force_N\n0,1,1,1\n1,nan,1,1\n", "x_mm: found nan in row 2"),
        ("time_s,x_mm,y_mm,force_N\n0,1,1,1\n0,2,1,1\n", "times that increase"),
        ("time_s,x_mm,y_mm,force_N\n0,1,1,-0.1\n", "stroke.force"),
    ],
)
def test_recorded_strokes_that_cannot_be(save, text, key):
    with pytest.raises(StimulatorError, match=key):
        Stroke.from_csv(save(text, "stroke.csv"))
