"""Numbers that say that a log is not what it is written as: kelvin, a sensor that was not ready, one channel of
two."""

import numpy as np
import pytest
from refusal import refused
from test_missing import F0, RISE, SWEEP, TAU, F, T, V, noise, table

import sysid
from sysid.adoption.description import with_article
from sysid.logs.log import Log
from sysid.logs.read import read_logs

WARM = "frequency_Hz,wd_um,wq_um,temperature_{}"


def warmed(temperature, unit="degC"):
    return table(WARM.format(unit), (F, SWEEP.real, SWEEP.imag, temperature))


@pytest.mark.parametrize(("temperature", "doubts"), [(291.45, True), (250.0, True), (85.0, False)])
def test_temperatures_that_seem_to_be_kelvin_are_asked_for(save, temperature, doubts):
    (log,) = read_logs(save(warmed(np.full(len(F), temperature))))
    assert any("are these kelvin? then call it temperature_K" in said for said in log.warnings) == doubts
    (log,) = read_logs(save(warmed(np.full(len(F), temperature + 273.15), "K"), "k.csv"))
    assert not log.warnings  # they are said to be


@pytest.mark.parametrize(("hertz", "doubts"), [(32.29, True), (32290.0, False)])
def test_a_transient_within_a_period_asks_whether_its_frequency_is_in_kilohertz(save, hertz, doubts):
    """24 ms are 0.77 periods of 32.29 Hz."""
    rows = "".join(f"{1e-4 * k:.4f},{100 * (k > 20)},{k / 240},0.1\n" for k in range(240))
    (log,) = read_logs(save(f"# frequency_Hz: {hertz}\ntime_s,voltage_V,wd_um,wq_um\n{rows}"))
    assert any("call it frequency_kHz" in said for said in log.warnings) == doubts


@pytest.mark.parametrize("wrong", [85.0, 0.0, -127.0])
def test_readings_of_a_sensor_that_was_not_ready_are_left_out(save, wrong):
    """Of a temperature that creeps, beside a set point that is another from the middle on."""
    true = 20 + 0.01 * np.arange(len(F)) + np.where(np.arange(len(F)) > 100, 14.0, 0.0)
    bad = [0, 40, 41, 42, 99, 150, 200]
    read = true.copy()
    read[bad] = wrong
    (log,) = read_logs(save(warmed(read)))
    (warning,) = log.warnings
    assert f"log.csv: 7 of its 201 temperatures ({wrong:.4g} degC) are far" in warning
    np.testing.assert_allclose(log.temperature, true, atol=0.03)
    made = Log.from_arrays(SWEEP, frequency=F, drive=1.0, temperature=read)
    np.testing.assert_allclose(made.temperature, log.temperature)


def test_temperatures_of_points_in_turn_are_kept(save):
    """Two set points, that every second row has; steps up and down; one reading of 4 degC."""
    index = np.arange(len(F))
    for true in (np.where(index % 2, 20.0, 35.0), 20.0 + 15 * (index // 51 % 2), 20 + 4.0 * (index == 77)):
        (log,) = read_logs(save(warmed(true)))
        np.testing.assert_array_equal(log.temperature, true)
        assert not log.warnings


@pytest.mark.parametrize(("zero", "column"), [("wd", 1), ("wq", 2)])
def test_a_sweep_of_one_channel_is_refused(save, zero, column):
    columns = [F, SWEEP.real, SWEEP.imag]
    columns[column] = 0 * F
    refused(save(table("frequency_Hz,wd_um,wq_um", columns)), f"{zero} is 0 in every row", "w alone")


def test_a_step_of_one_channel_is_named(save):
    """Driven at its resonance without noise it may be so: the fit has the say."""
    head = "time_s,voltage_V,frequency_Hz,wd_um,wq_um"
    (log,) = read_logs(save(table(head, (T, V, np.full(len(T), F0), RISE, 0 * T))))
    (warning,) = log.warnings
    assert "log.csv: wq is 0 in every row, and wd alone is no amplitude" in warning
    both = RISE + noise(len(T), 3).real  # the same noise in both would be that of one
    assert not read_logs(save(table(head, (T, V, np.full(len(T), F0), RISE, both))))[0].warnings


def test_a_channel_that_is_a_copy_or_dead_is_refused(save):
    """Either was a second mode, with G up to a hundred errors off."""
    rng, head = np.random.default_rng(2), "time_s,voltage_V,frequency_Hz,wd_um,wq_um"
    d = RISE + 0.01 * np.max(RISE) * rng.standard_normal(len(T))
    refused(save(table(head, (T, V, np.full(len(T), F0), d, d))), "wq the same as wd", "w alone")
    dead = 5e-4 * np.max(RISE) * rng.standard_normal(len(T))
    refused(
        save(table(head, (T, V, np.full(len(T), F0), d, dead))), "wq shows less than the noise", "w alone"
    )


def test_columns_of_drive_and_frequency_that_are_swapped_are_refused(save):
    """A step of the voltage is then one from 0 Hz; rows of a sweep, or the first of a chirp, may be at 0 Hz."""
    head = "time_s,voltage_V,frequency_Hz,wd_um,wq_um"
    volts = np.where(np.arange(len(T)) < 20, 0.0, V.max())
    swapped = table(
        head, (T, np.full(len(T), F0), volts, RISE + noise(len(T), 3).real, noise(len(T), 4).real)
    )
    refused(save(swapped), "its first 20 rows with a drive at a frequency of 0", "a drive of 0")
    chirp = table(
        head, (T, np.full(len(T), V.max()), np.linspace(0, 50, len(T)), RISE, noise(len(T), 4).real)
    )
    assert len(read_logs(save(chirp))[0]) > 300


@pytest.mark.parametrize(("low", "said"), [(True, "-0.025 in q"), (False, "0.025 in q")])
def test_a_channel_that_is_clipped_is_named_with_its_sign(low, said):
    """Wq goes from +A/2 to -A/2 through the resonance."""
    rng = np.random.default_rng(5)
    clean = 0.06 / (1 + 2j * np.pi * (F - F0) * TAU)
    y = clean + 1e-4 * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))
    q = np.maximum(y.imag, -0.025) if low else np.minimum(y.imag, 0.025)
    fit = sysid.fit(Log.from_arrays(y.real + 1j * q, frequency=F, drive=1.0))
    assert any(f"rows lie exactly at {said};" in warning for warning in fit.warnings)


def test_the_article_goes_with_the_word():
    assert [with_article(x) for x in ("image", "second_mode")] == ["an image", "a second mode"]


FOLDED = """\
amplitude = "peak"
quantity = "displacement"
phase_sign = 1
[columns]
frequency = { column = "f", unit = "Hz" }
voltage = { column = "u", unit = "V" }
magnitude = { column = "a", unit = "um" }
phase = { column = "p", unit = "deg" }
"""


def turned_by(angle, response):
    response = response * np.exp(1j * angle)
    return response, np.degrees(np.arctan(response.imag / response.real))


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2, 2.5, -2.0])
def test_a_phase_that_is_an_arctangent_is_carried_on(save, angle):
    response, phase = turned_by(angle, SWEEP)
    mapping = save(FOLDED, "map.toml")
    content = table("f,u,a,p", (F, np.ones(len(F)), np.abs(response), phase))
    (log,) = read_logs(save(content), mapping)
    folds = np.ptp(np.degrees(np.unwrap(np.angle(response)))) > 90 and np.any(np.abs(np.diff(phase)) > 90)
    assert any("its phase stays within 90 degrees" in said for said in log.warnings) == folds
    ratio = log.response / response
    np.testing.assert_allclose(ratio, ratio[0], atol=1e-6)  # but for the half turn, which no reading has
    assert abs(ratio[0]) == pytest.approx(1.0, abs=1e-6)


def test_a_narrow_resonance_between_two_rows_is_no_arctangent(save):
    """Its phase jumps from one end of the half turn to the other as well, and must not be carried on."""
    far = 1 / (1 + 2j * np.pi * 200 * TAU * (F - F0 - 0.5 * (F[1] - F[0])))
    response = far * 1j  # as of a velocity: from 90 degrees to -90
    content = table("f,u,a,p", (F, np.ones(len(F)), np.abs(response), np.degrees(np.angle(response))))
    (log,) = read_logs(save(content), save(FOLDED, "map.toml"))
    assert not any("its phase stays" in said for said in log.warnings)
    ratio = log.response / response  # whatever a quantity is multiplied by
    np.testing.assert_allclose(ratio, ratio[0], atol=1e-6)


def test_a_phase_beside_an_amplitude_is_named_with_the_way_to_read_it(save):
    content = table("frequency_Hz,w_um,phase_deg", (F, np.abs(SWEEP), np.degrees(np.angle(SWEEP))))
    (log,) = read_logs(save(content))
    assert any('magnitude = "w_um" and phase = "phase_deg"' in said for said in log.notes)


def swing(periods, noise=0.02, seed=0, n=400, lead=60):
    """Rows of noise, then of an oscillation that falls by e over so many periods, 20 rows each."""
    t = np.arange(n) - lead
    w = np.where(t > 0, np.sin(2 * np.pi * t / 20) * np.exp(-t / (20 * periods)), 0.0)
    return w + noise * np.random.default_rng(seed).standard_normal(n)


def undriven(save, w):
    rows = "".join(f"{0.01 * k:.9g},{y:.9g}\n" for k, y in enumerate(w))
    return save("time_s,w_m/s^2\n" + rows)


@pytest.mark.parametrize("periods", [2, 5, 50])
def test_an_oscillation_is_not_its_amplitude(save, periods):
    refused(undriven(save, swing(periods)), "w that swings about zero", "amplitude over time")


@pytest.mark.parametrize("seed", range(20))
def test_what_passes_through_zero_once_is_no_oscillation(save, seed):
    """A decay to below zero, of whatever height and slowness, in noise; and noise alone, white or brown."""
    rng = np.random.default_rng(seed)
    t, noise = np.arange(400), rng.standard_normal(400)
    decay = np.exp(-t / rng.uniform(5, 400)) - rng.uniform(0, 1) + 0.1 * noise
    for w in (decay, noise, np.cumsum(noise)):
        assert len(read_logs(undriven(save, w))) == 1
