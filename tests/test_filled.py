"""Cells that are empty for a reason, and points at 0 Hz: what is taken for them, and what is still refused."""

import numpy as np
import pytest
from refusal import refused
from test_missing import F0, SWEEP, TAU, F, T, table

import sysid
from sysid.logs.log import Log
from sysid.logs.read import read_logs
from sysid.rows.thermometer import of_plates

ON = (T > 4e-3) & (T < 25e-3)
AT = F0 + 20.0
OFF, LATE = np.flatnonzero(T <= 4e-3), np.flatnonzero(T >= 25e-3)
HEAD = "time_s,voltage_V,frequency_Hz,wd_um,wq_um"


def burst():
    """The envelope of a plate that is driven with 10 V from 4 to 25 ms, in its closed form, and noise."""
    pole = -1 / TAU - 2j * np.pi * (AT - F0)
    since, until = np.flatnonzero(ON)[0], LATE[0]
    rise = 1 - np.exp(pole * (T - T[since]))
    fall = (1 - np.exp(pole * (T[until] - T[since]))) * np.exp(pole * (T - T[until]))
    time = T
    shape = np.where(time <= T[since], 0, np.where(time <= T[until], rise, fall))
    rng = np.random.default_rng(4)
    return 0.2 * shape / (-pole * TAU) + 1e-4 * (rng.standard_normal(400) + 1j * rng.standard_normal(400))


BURST = burst()


def rows(drive=None, frequency=None):
    return (
        T,
        np.where(ON, 10.0, 0.0) if drive is None else drive,
        np.full(400, AT) if frequency is None else frequency,
        BURST.real,
        BURST.imag,
    )


def test_a_thermometer_that_is_read_less_often_is_interpolated(save):
    warm = 20 + 0.01 * np.arange(len(F))
    (log,) = read_logs(
        save(
            table(
                "frequency_Hz,wd_um,wq_um,temperature_degC",
                (F, SWEEP.real, SWEEP.imag, warm),
                [k for k in range(len(F)) if k % 10 or k == 0],
            )
        )
    )
    np.testing.assert_allclose(log.temperature, np.clip(warm, warm[10], None), rtol=1e-14)
    assert any("holds a number in 20 of 201 rows: taken as linear" in note for note in log.notes)


def test_noise_of_readings_that_were_interpolated_is_noise():
    """The plate's temperature is constant: of 41 readings the mean, not each of them."""
    rng = np.random.default_rng(1)
    warm = np.interp(np.arange(401), np.arange(0, 401, 10), 24 + 0.02 * rng.standard_normal(41))
    (reading,) = of_plates([warm])
    assert np.ptp(reading.temperature) < 0.005 and abs(np.mean(reading.temperature) - 24) < 0.012


def test_a_temperature_without_a_number_is_none(save):
    head, columns = "frequency_Hz,wd_um,wq_um,temperature_degC", (F, SWEEP.real, SWEEP.imag, F)
    (log,) = read_logs(save(table(head, columns, range(len(F)))))
    assert log.temperature is None and any("no temperature is recorded" in note for note in log.notes)


def test_an_overload_of_a_thermometer_is_not_filled(save):
    head, columns = "frequency_Hz,wd_um,wq_um,temperature_degC", (F, SWEEP.real, SWEEP.imag, F / 1e3)
    refused(save(table(head, columns, [5], "OVLD")), "line 7", "'OVLD'", "a finite number")


@pytest.mark.parametrize("of", [slice(0, 240), slice(60, 400), slice(0, 400)])
def test_a_drive_that_is_written_only_while_there_is_one_is_off_elsewhere(save, of):
    """Before a step, after it, and on both sides of it."""
    (log,) = read_logs(save(table(HEAD, [c[of] for c in rows()], np.flatnonzero(~ON[of]), column=1)))
    np.testing.assert_array_equal(log.drive, np.where(ON, 10.0, 0.0)[of])
    np.testing.assert_array_equal(log.response, BURST[of])
    (warning,) = log.warnings
    assert f"is empty in {np.sum(~ON[of])} rows" in warning and "write 0 where the drive is off" in warning


@pytest.mark.parametrize(
    "gaps", [range(60, 160), [*OFF, 70], np.flatnonzero(ON)[:100], np.flatnonzero(ON)[60:]]
)
def test_a_drive_that_is_lost_while_the_plate_is_driven_is_refused(save, gaps):
    """Amid the rows, and where the response shows that it was on."""
    drive = np.where(ON, 10.0, np.nan)
    drive[list(gaps)] = np.nan
    text = table(HEAD, rows(drive), []).replace("nan", "")
    refused(save(text), "'voltage_V'", "write 0 where the drive is off")


@pytest.mark.parametrize("cell", ["", "0"])
def test_the_frequency_of_rows_without_a_drive_is_that_of_the_driven_ones(save, cell):
    (log,) = read_logs(save(table(HEAD, rows(), [*OFF, *LATE], cell, column=2)))
    np.testing.assert_array_equal(log.frequency, np.full(400, AT))
    assert any(f"in {len(OFF) + len(LATE)} rows no frequency is recorded" in note for note in log.notes)
    made = Log.from_arrays(
        BURST, time=T, drive=np.where(ON, 10.0, 0.0), frequency=np.where(ON, AT, 0.0), temperature=24.0
    )
    np.testing.assert_array_equal(made.frequency, log.frequency)


def test_a_frequency_that_is_lost_while_driven_is_that_of_both_sides(save):
    """Not where they differ, nor before the first."""
    amid, first = np.arange(100, 104), np.flatnonzero(ON)[:3]
    (log,) = read_logs(save(table(HEAD, rows(), amid, "0", column=2)))
    np.testing.assert_array_equal(log.frequency, np.full(400, AT))
    two = np.where(np.arange(400) < 102, AT, AT + 30)
    (log,) = read_logs(save(table(HEAD, rows(frequency=two), amid, "0", column=2)))
    np.testing.assert_array_equal(log.frequency[amid], 0)
    (log,) = read_logs(save(table(HEAD, rows(), first, "0", column=2)))
    np.testing.assert_array_equal(log.frequency[first], 0)


def test_a_burst_whose_frequency_is_0_while_idle_is_fitted(save):
    fit = sysid.fit(read_logs(save(table(HEAD, rows(), [*OFF, *LATE], "0", column=2))))
    found = fit.parameters
    assert fit.result == "successful" and not any("its frequency is 0" in said for said in fit.warnings)
    for name, true in (("G", 0.02), ("tau", TAU), ("f0", F0)):
        assert abs(found[name].value - true) < 5 * found[name].std, name


def test_points_at_no_frequency_are_left_out(save):
    """As of an analyser whose spectrum begins at 0 Hz; a velocity over omega would be 0/0 there."""
    columns = (np.append(0.0, F), *(np.append(7.0, part) for part in (SWEEP.real, SWEEP.imag)))
    (log,) = read_logs(save(table("frequency_Hz,wd_um,wq_um", columns)))
    np.testing.assert_array_equal(log.frequency, F)
    np.testing.assert_array_equal(log.response, SWEEP)
    assert any("rows at 0 Hz are left out" in note and "line 2" in note for note in log.notes)
    speed = 2j * np.pi * columns[0] * np.append(1.0, SWEEP)
    mapping = save(
        'amplitude = "peak"\nquantity = "velocity"\nphase_sign = 1\n[columns]\n'
        'frequency = { column = "f", unit = "Hz" }\nx = { column = "x", unit = "um/s" }\n'
        'y = { column = "y", unit = "um/s" }\n[constants]\nvoltage = "1 V"\n',
        "map.toml",
    )
    (log,) = read_logs(save(table("f,x,y", (columns[0], speed.real, speed.imag)), "v.csv"), columns=mapping)
    np.testing.assert_allclose(log.response, 1j * SWEEP, rtol=1e-12)
    made = Log.from_arrays(np.append(7.0, SWEEP), frequency=np.append(0.0, F), drive=1.0)
    fit = sysid.fit(made)
    assert len(made) == len(F) and abs(fit.parameters["f0"].value - F0) < 5 * fit.parameters["f0"].std


STEP = table(HEAD, rows())
POINTS = table("frequency_Hz,wd_um,wq_um", (F, SWEEP.real, SWEEP.imag))


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (STEP, "delay_s: 0.3", ("'delay_s'", "0.3 s", "less than the 0.0358 s from the drive")),
        (STEP, "delay_ms: -300", ("'delay_ms'", "-0.3 s", "less than the 0.0399 s that the record")),
        (STEP, "lockin_tau_s: 10", ("'lockin_tau_s'", "10 s", "seconds, less than the 0.0399 s")),
        (STEP, "lockin_order: 24", ("1 to 8 poles", "24 are 4 poles")),
        (STEP, "lockin_order: 9", ("found 9, expected 1 to 8 poles",)),
        (POINTS, "delay_s: 0.3", ("'delay_s'", "0.3 s", "less than 0.1 s", "5 Hz apart")),
    ],
)
def test_times_of_the_bench_that_cannot_be_are_refused(save, text, line, words):
    refused(save(f"# {line}\n{text}"), *words)


@pytest.mark.parametrize("line", ["delay_s: 0.03", "delay_s: -0.03", "lockin_tau_s: 0.03", "lockin_order: 8"])
def test_those_that_can_be_are_read(save, line):
    assert len(read_logs(save(f"# {line}\n{STEP}"))[0].bench) == 1
