"""What a thermometer's readings are taken for: the plate's temperature without the noise of reading."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import seeds, study
from scipy.stats import multivariate_normal, norm

import sysid
from sysid import Log, Result, fit
from sysid.rows.thermometer import HELD, LEVELS, _walk, of_plates, step_of

ROWS = 150


def smooth(readings):
    return of_plates([np.asarray(readings, float)])[0].temperature


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def noise(std, seed=0, rows=ROWS):
    return std * np.random.default_rng(seed).standard_normal(rows)


@pytest.mark.parametrize("s", [0.03, 2.0])
@pytest.mark.parametrize("m", [1, 2])
def test_temperature_is_the_penalised_least_squares_of_the_readings(s, m):
    """min |y - T|^2 + |D T|^2 / s by its normal equations; for m = 2, D'D of a log that goes on as its mirror
    image."""
    y = 24 + noise(0.1, rows=40)
    differences = np.diff(np.eye(40), axis=0)
    penalty = np.linalg.matrix_power(differences.T @ differences, m) / s
    stiff = (2 - 2 * np.cos(np.pi * np.arange(1, 40) / 40)) ** m
    found = _walk(y, np.full(40, y.mean()), stiff, np.array([s]))
    np.testing.assert_allclose(found.level, np.linalg.solve(np.eye(40) + penalty, y), atol=1e-12)


def test_likelihood_of_a_walk_is_that_of_the_normal_moves_from_row_to_row():
    y, s = 24 + noise(0.1, rows=30) + np.cumsum(noise(0.05, 1, 30)), np.array([0.0, 0.1, 3.0])
    stiff = 2 - 2 * np.cos(np.pi * np.arange(1, 30) / 30)
    differences = np.diff(np.eye(30), axis=0)

    def expected(walk, variance):
        return multivariate_normal(cov=variance * (differences @ differences.T + walk * np.eye(29))).logpdf(
            np.diff(y)
        )

    found = [_walk(y, np.full(30, y.mean()), stiff, s[k : k + 1]) for k in range(3)]
    rises = np.diff([f.likely for f in found])
    np.testing.assert_allclose(rises, np.diff([expected(f.walk, f.noise) for f in found]), rtol=1e-9)
    for f in found:  # and r is the likeliest
        assert expected(f.walk, f.noise) > max(
            expected(f.walk, 0.9 * f.noise), expected(f.walk, 1.1 * f.noise)
        )


@pytest.mark.parametrize(
    "course",
    [
        pytest.param(np.full(ROWS, 24.0), id="constant"),
        pytest.param(np.linspace(20, 30, ROWS), id="ramp"),
        pytest.param(np.linspace(24, 24.2, ROWS), id="slow ramp"),
        pytest.param(24 + 4 * (1 - np.exp(-np.arange(ROWS) / 30)), id="warming"),
        pytest.param(24 + 0.3 * np.sin(np.arange(ROWS) / 10), id="thermostat"),
        pytest.param(np.repeat([20.0, 24, 28, 32, 36], ROWS // 5), id="plateaus"),
    ],
)
def test_noise_of_reading_goes_and_the_course_stays(course):
    for std in (0.02, 0.1):
        assert np.mean([rms(smooth(course + noise(std, k)) - course) for k in range(20)]) < 0.6 * std
    np.testing.assert_allclose(
        smooth(course), course, rtol=0, atol=1e-9
    )  # of 36 degC, by the cosines' rounding


def test_a_constant_temperature_is_known_as_well_as_its_mean():
    off = [smooth(24 + noise(0.02, k))[0] - 24 for k in range(200)]
    assert rms(off) == pytest.approx(0.02 / np.sqrt(ROWS), rel=0.2)  # four of the 5 % that 200 seeds leave


def test_a_coarse_reading_that_flickers_is_smoothed_and_one_that_is_set_is_kept():
    slow = np.linspace(24, 24.2, ROWS)
    assert rms(smooth(np.round(slow + noise(0.02), 1)) - slow) < 0.02  # the readings are 0.034 off
    np.testing.assert_allclose(
        smooth(np.round(slow, 1)), slow, atol=0.002
    )  # half of a row's step where the reading changes
    falls = np.linspace(27, 24, ROWS)
    np.testing.assert_allclose(smooth(np.round(falls / 0.25) * 0.25), falls, atol=0.02)
    for kept in (
        np.repeat([24.0, 24.5], ROWS // 2),
        np.repeat([24.0, 25.0, 26.0, 27.0], ROWS // 4),
        np.random.default_rng(0).permutation(np.linspace(20, 30, ROWS)),
    ):
        np.testing.assert_array_equal(smooth(kept), kept)


def test_a_cheap_thermometer_does_not_make_the_plate_flicker():
    """Of 0.5 degC from row to row; temperatures that are set in any order differ by more."""
    assert rms([smooth(24 + noise(0.5, k))[0] - 24 for k in range(50)]) == pytest.approx(
        0.5 / np.sqrt(ROWS), rel=0.4
    )


def test_the_step_of_a_long_log_is_where_its_readings_have_it():
    y = np.where(np.arange(100_000) < 43_210, 24.0, 34.0)
    assert rms(smooth(y + noise(0.02, rows=len(y))) - y) < 0.01


def test_what_is_recorded_of_few_rows_is_kept():
    np.testing.assert_array_equal(smooth([24.01, 24.0, 23.98, 24.02]), [24.01, 24.0, 23.98, 24.02])


def test_temperatures_that_differ_by_the_noise_alone_are_one_and_others_are_not():
    same = of_plates([24 + noise(0.1, 0), None, 24 + noise(0.1, 1)])
    assert same[1] is None
    assert np.ptp(np.concatenate([same[0].temperature, same[2].temperature])) == 0
    apart = of_plates([24 + noise(0.02, 0), 24.5 + noise(0.02, 1)])
    assert apart[1].temperature.mean() - apart[0].temperature.mean() == pytest.approx(0.5, abs=0.01)


def test_the_temperature_of_a_long_log_has_few_levels():
    course = np.linspace(24, 25, 100_000)
    found = smooth(course + noise(0.05, rows=100_000))
    assert LEVELS < len(np.unique(found)) <= 100_000 // HELD  # so that its rows are condensed all the same
    assert rms(found - course) < 2 / LEVELS  # a level is 1/256 degC wide


def sweep(temperature, seed, reading=0.03, noise=0.02):
    """Settled points of the closed form, with noise (um), read by a thermometer."""
    rng = np.random.default_rng(seed)
    f = np.linspace(31800, 32800, 101)
    tau, f0 = 1.67e-3, 32300 - 10 * (temperature - 24)
    turned = (f0**2 - f**2) * np.pi * tau / f  # exact: c - m omega^2 over omega ds
    response = 2 / (1 - 1j * turned) * (f0 / f) + noise * (
        rng.standard_normal(101) + 1j * rng.standard_normal(101)
    )
    read = temperature + reading * rng.standard_normal(101)
    return Log(f"{temperature} degC", response, drive=np.full(101, 100.0), frequency=f, temperature=read)


@seeds(5, 20)
def test_a_thermometers_noise_tells_no_temperature_coefficient(seeds):
    """Its coefficient would be about 0 +- 2 Hz/degC, of -10."""
    for seed in seeds:
        found = fit([sweep(24.0, seed)])
        assert not found.parameters["k_T"].determined
        assert "one temperature" in found.parameters["k_T"].why


@seeds(8, 40)
def test_temperature_coefficient_is_covered_where_the_thermometer_is_noisy(seeds):
    scores = []
    for seed in seeds:
        p = fit([sweep(t, 100 * seed + int(t)) for t in (20.0, 24.0, 30.0)]).parameters
        scores += [((p["k_T"].value + 10) / p["k_T"].std, (p["f0"].value - 32300) / p["f0"].std)]
    assert np.std(scores, axis=0) == pytest.approx(
        [1, 1], abs=3.1 / np.sqrt(2 * len(seeds))
    )  # of 40, three of 0.11
    assert np.max(np.abs(scores)) < 4


@seeds(4, 30)
def test_what_a_thermometers_error_makes_of_the_resonance_is_in_the_interval(seeds):
    """Of sweeps so quiet that 0.05 degC / sqrt(101) of error is several of their own of f0."""
    scores, exact = [], []
    for seed in seeds:
        logs = [sweep(t, 100 * seed + int(t), reading=0.05, noise=1e-3) for t in (20.0, 24.0, 30.0)]
        found = fit(logs)
        p = found.parameters
        scores += [((p["k_T"].value + 10) / p["k_T"].std, (p["f0"].value - 32300) / p["f0"].std)]
        assert found.result.name == "successful"
        exact += [fit(logs, nuisances=("rotation", "background")).parameters["k_T"].std / p["k_T"].std]
    assert np.std(scores, axis=0) == pytest.approx(
        [1, 1], abs=3.1 / np.sqrt(2 * len(seeds))
    )  # of 30, three of 0.13
    assert np.median(exact) < 0.5  # and without it the interval is less than half as wide


def test_a_stated_error_of_the_thermometer_is_in_the_interval():
    """Two sweeps 6 degC apart, each read within 0.5 degC: k_T to 0.5 sqrt(2) / 6."""
    logs = [replace(sweep(t, 1, reading=0.0), bench={"temperature_std_degC": 0.5}) for t in (20.0, 26.0)]
    k_T = fit(logs).parameters["k_T"]
    assert k_T.std == pytest.approx(10 * 0.5 * np.sqrt(2) / 6, rel=0.05)


@pytest.mark.parametrize("apart", [0.3, study(0.27), study(0.5)])
def test_temperatures_that_hardly_differ_have_the_posterior_of_their_quotient(apart):
    """Each read within 0.05 degC: k_T is that of df = k_T (dT + errors), and its density, with flat k_T,

        N(df; k_T dT, 2 (0.05 k_T)^2),

    falls so slowly to one side that chains about the minimum stood still there."""
    logs = [
        replace(sweep(t, 1, 0.0, noise=1e-3), bench={"temperature_std_degC": 0.05})
        for t in (20.0, 20.0 + apart)
    ]
    posterior = sysid.sample(fit(logs))
    assert posterior.result is Result.successful and posterior.evaluations < 10_000
    df, k_T = -10 * apart, np.linspace(-200, -0.5, 400_000)
    density = norm.pdf(df, k_T * apart, np.sqrt(2) * 0.05 * np.abs(k_T))
    below = np.cumsum(density) / density.sum()
    low, middle, high = np.interp([0.025, 0.5, 0.975], below, k_T)
    told = posterior.estimates["k_T"]
    # df by the sweeps to 2 %, the ends by a thousand draws to a twentieth of the interval's length
    assert np.abs(np.array([told.low, told.high]) - (low, high)).max() < 0.07 * (high - low)
    assert np.median(posterior.draws["k_T"]) == pytest.approx(middle, abs=0.03 * (high - low))


def test_where_the_error_is_not_fitted_it_is_said():
    """An amplitude's nuisances are its own."""
    logs = [sweep(t, 1, reading=0.0, noise=1e-3) for t in (20.0, 26.0)]
    logs = [replace(log, response=np.abs(log.response), bench={"temperature_std_degC": 0.5}) for log in logs]
    said = [w for w in fit(logs).warnings if "thermometer may be 0.5 degC off" in w]
    assert len(said) == 2 and all(
        "of its standard deviations, which its error does not include" in w for w in said
    )


def test_the_error_of_a_thermometer_is_read_from_the_metadata(tmp_path):
    path = tmp_path / "sweep.csv"
    table = "voltage_V,frequency_Hz,wd_um,wq_um\n1,32300,1,0\n1,32310,1,0\n"
    path.write_text(f"# temperature_degC: 24\n# temperature_std_degC: 0.5\n{table}")
    assert sysid.read_logs([path])[0].bench["temperature_std_degC"] == 0.5
    path.write_text(f"# temperature_degC: 24\n# temperature_std_degC: -0.5\n{table}")
    with pytest.raises(sysid.LogError, match=r"temperature_std_degC'?: found -0.5 degC, expected 0 or more"):
        sysid.read_logs([path])


def test_a_k_T_that_comes_out_small_by_chance_has_the_thermometers_error_all_the_same():
    """Readings that lie as far apart as they may be off, and by chance go with the plate's temperature not at
    all."""
    true, read = (23.9, 24.0, 24.1), (24.0, 23.9, 24.003)
    logs = [
        replace(sweep(t, 1, noise=1e-3), temperature=np.full(101, r)) for t, r in zip(true, read, strict=True)
    ]
    found = fit([replace(log, bench={"temperature_std_degC": 0.1}) for log in logs])
    assert not found.parameters["k_T"].determined
    assert "too little beside the error of the thermometer" in found.parameters["k_T"].why


def written(folder, temperatures, seed, put, noise=1e-3):
    """Files of sweeps, each with its temperature as metadata, as `put` writes it."""
    paths = []
    for k, t in enumerate(temperatures):
        log = replace(sweep(t, 10 * seed + k, noise=noise), temperature=None)
        paths.append(folder / f"{k}.csv")
        sysid.write_log(log, paths[-1])
        paths[-1].write_text(f"# temperature_degC: {put(t)}\n{paths[-1].read_text()}")
    return paths


@pytest.mark.study
@seeds(2, 15)
def test_a_temperature_is_read_no_better_than_it_is_written(tmp_path, seeds):
    """Sweeps so quiet that only the thermometer's steps of half a degC are left; 25.5 shows that they are
    steps."""
    scores, rng = [], np.random.default_rng(3)
    for seed in seeds:
        paths = written(tmp_path, [25.4, *rng.uniform(20, 32, 4)], seed, lambda t: f"{np.round(2 * t) / 2:g}")
        found = fit(sysid.read_logs(paths))
        p = found.parameters
        assert found.result.name == "successful", found.warnings
        assert any("temperature_std_degC" in w and "error of f0 and of k_T" in w for w in found.warnings)
        scores.append(((p["k_T"].value + 10) / p["k_T"].std, (p["f0"].value - 32300) / p["f0"].std))
    assert np.mean(np.square(scores)) < 1 + 3 / np.sqrt(
        len(seeds)
    )  # three standard deviations; it was 20 and more


@pytest.mark.parametrize(
    ("texts", "step"),
    [
        (("22", "30.5"), 0.5),
        (("22", "30"), 1.0),
        (("24.0", "28.0"), 0.1),  # zeros that are written are readings
        (("22.2", "30.3"), 0.1),
        (("22.25", "30.5"), 0.25),
        (("22.2", "30.123"), 0.001),
        (("24.0125", "2.8e1"), 0.0125),
    ],
)
def test_the_step_of_a_thermometer_is_the_finest_that_all_its_readings_have(tmp_path, texts, step):
    texts = list(texts)
    logs = sysid.read_logs(written(tmp_path, (22.0, 30.0), 0, lambda t: texts[0] if t == 22 else texts[1]))
    digits = [log.temperature_digit for log in logs]
    assert step_of([log.temperature for log in logs], digits) == pytest.approx(step)
    one = of_plates([log.temperature for log in logs], digits)
    if all(float(text).is_integer() for text in texts):  # set points
        assert [x.error for x in one] == [0.0, 0.0]
        return
    assert [x.error for x in one] == pytest.approx(
        [step / np.sqrt(12)] * 2, rel=0.02
    )  # of a sum that is cut off
    k = next(k for k, text in enumerate(texts) if not float(text).is_integer())
    half, digit = logs[k].temperature, digits[k]
    same = of_plates([half] * 4, [digit] * 4)  # off alike: their mean is no better than one of them
    assert same[0].error / np.sqrt(4) == pytest.approx(step_of([half], [digit]) / np.sqrt(12), rel=0.02)


def test_whole_degrees_are_set_points_and_a_warning_says_what_hangs_on_that(tmp_path):
    """Ovens are set to 22 and 30 degC: f0 is as sure as it was, and the warning states half a degree times
    k_T, -10 Hz/degC."""
    logs = sysid.read_logs(written(tmp_path, (22.0, 30.0), 0, "{:.0f}".format))
    found = sysid.fit(logs)
    exact = sysid.fit([replace(log, temperature_digit=0.0) for log in logs])
    assert found.parameters["f0"] == exact.parameters["f0"] and not any(
        "set points" in w for w in exact.warnings
    )
    (said,) = (w for w in found.warnings if "set points" in w)
    assert f"by {10 / np.sqrt(12):.2g} Hz: state temperature_std_degC" in said


def test_a_step_in_kelvin_or_in_a_column_is_that_of_its_text(tmp_path):
    table = "voltage_V,frequency_Hz,wd_um,wq_um,temperature_{}\n1,32300,1,0,{}\n1,32310,1,0,{}\n"
    cases = (
        ("K", ("297", "298"), 1.0),
        ("degF", ("75.5", "75.0"), 0.1 / 1.8),
        ("degC", ("24.0", "24.013"), 1e-3),
    )
    for unit, rows, digit in cases:
        path = tmp_path / f"{unit}.csv"
        path.write_text(table.format(unit, *rows))
        assert sysid.read_logs([path])[0].temperature_digit == pytest.approx(digit)


def test_logs_that_are_made_have_the_temperature_that_they_say():
    assert [x.error for x in of_plates([np.full(9, 22.0), np.full(9, 30.0)])] == [0, 0]


def test_a_thermometer_that_flickers_between_two_steps_is_off_by_what_they_hide():
    """Readings of a constant temperature in steps of half a degC, with noise of a tenth of one, and of
    one."""
    for noise_std, rounded in ((0.05, True), (0.5, False)):
        off, error = [], []
        for seed in range(60):
            true = np.random.default_rng(seed).uniform(23, 25)
            read = np.round(2 * (true + noise(noise_std, seed))) / 2
            found = of_plates([read, np.full(2, 39.5)], [0.5, 0.5])[0]
            off.append(found.temperature.mean() - true)
            error.append(found.error)
        assert (rms(error) > 0.1) == rounded
        assert 0.5 < rms(off) / rms(error) < 1.3


def test_a_temperature_that_rests_passes_and_rests_is_followed_in_steps_of_one_degree():
    course = 24 + 10 * np.clip((np.arange(600) - 50) / 500, 0, 1)
    found = of_plates([np.round(course)], [1.0])[0]
    assert np.max(np.abs(found.temperature - course)) < 0.1
    assert 0.05 < found.error < 1 / np.sqrt(12)


def test_logs_whose_thermometers_are_off_name_what_to_state(nuisances):
    off = 0.5 * np.random.default_rng(4).standard_normal(4)
    logs = [sweep(t, k, reading=0.0) for k, t in enumerate((20.0, 24.0, 28.0, 32.0))]
    logs = [replace(log, temperature=log.temperature + d) for log, d in zip(logs, off, strict=True)]
    assert any("state temperature_std_degC" in w for w in fit(logs, nuisances=nuisances).warnings)
    stated = fit([replace(log, bench={"temperature_std_degC": 0.5}) for log in logs])
    assert stated.result.name == "successful"


def test_a_log_that_was_written_is_fitted_as_it_is_in_memory(tmp_path):
    """Temperatures of a simulation are exact, though 22.5 and 30.5 look like those of a thermometer."""
    logs = [sweep(t, seed, noise=1e-3) for seed, t in enumerate((22.5, 26.0, 30.5))]
    for k, log in enumerate(logs):
        sysid.write_log(log, tmp_path / f"{k}.csv")
    read = sysid.fit(sysid.read_logs([tmp_path / f"{k}.csv" for k in range(3)]))
    assert read.parameters["f0"].std == pytest.approx(sysid.fit(logs).parameters["f0"].std, rel=1e-6)


@pytest.mark.study
def test_a_long_log_that_warms_tells_k_t_and_no_drift():
    """The temperature was held in 256 levels, between which a drift of f0 ran on: k_T was eleven errors off."""
    rng, n, h, tau, f = np.random.default_rng(5), 20000, 1e-4, 1.67e-3, 32290.0
    t, warm = h * np.arange(n), np.linspace(24.0, 30.0, n)
    drive = 100.0 * (np.arange(n) % 1000 > 400)
    pole = -1 / tau + 2j * np.pi * (32300.0 - 10.0 * (warm - 24.0) - f)
    w = np.zeros(n, complex)
    for k in range(n - 1):
        settled = -0.02 / tau * drive[k] / pole[k]
        w[k + 1] = settled + (w[k] - settled) * np.exp(pole[k] * h)
    y = w + 0.01 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    read = np.round(warm + 0.03 * rng.standard_normal(n), 2)
    given = {"time": t, "drive": drive, "frequency": np.full(n, f), "temperature": read}
    fit = sysid.fit(sysid.Log("warms", y, kind="transient", sampling="instant", **given))
    assert fit.result.name == "successful"
    k_T = fit.parameters["k_T"]
    assert k_T.std < 0.05 and abs(k_T.value + 10.0) < 4 * k_T.std
    assert not [x.key for x in fit.findings if x.outcome == "fitted"]


@pytest.mark.parametrize("seconds", [40.0, 80.0, 300.0])
@pytest.mark.parametrize("digit", [0.01, 0.1])
def test_a_smooth_curve_in_steps_of_a_digit_was_not_interpolated(seconds, digit):
    """Warming up by 3 degC: read to half a digit, of which noise is told at most."""
    true = 24 + 3 * (1 - np.exp(-3.0 * np.arange(81) / seconds))
    (found,) = of_plates([np.round(true / digit) * digit], [digit])
    assert np.max(np.abs(found.temperature - true)) < 0.8 * digit and found.error < digit
