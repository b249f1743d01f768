"""Numbers that say that a log is not what it is written as: kelvin, a sensor that was not ready, one channel of
two."""

import numpy as np
import pytest
from refusal import refused
from test_missing import F0, RISE, SWEEP, TAU, F, T, V, table

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
    assert not read_logs(save(table(head, (T, V, np.full(len(T), F0), RISE, RISE))))[0].warnings


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
