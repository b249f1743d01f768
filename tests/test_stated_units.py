"""Metadata whose numbers have a unit behind them, beside the one in their key: the truth is arithmetic."""

import numpy as np
import pytest
import reference
from refusal import refused

import sysid
from sysid.logs.read import read_logs

ROWS = "time_s,wd_um,wq_um\n" + "".join(f"{k / 1000:g},{k},{2 * k}\n" for k in range(1, 9))


def read(save, *stated):
    (log,) = read_logs([save("".join(f"# {line}\n" for line in stated) + ROWS)])
    return log


@pytest.mark.parametrize(
    ("stated", "volts"),
    [
        ("voltage_V: 100 V", 100),
        ("voltage_V: 100V", 100),
        ("voltage_V = 0.1 kV", 100),
        ("voltage_V: 100 Volts", 100),
        ("voltage_V: 100 V pk", 100),
        ("voltage_V_rms: 100 V", 100 * 2**0.5),
        ("voltage_V_rms: 100 V rms", 100 * 2**0.5),
        ("volts_V: 2e5 mV", 200),
    ],
)
def test_a_unit_behind_a_drive(save, stated, volts):
    log = read(save, stated)
    assert log.drive.tolist() == pytest.approx([volts] * 8) and log.drive_unit == "V"


@pytest.mark.parametrize(
    ("stated", "of", "value"),
    [
        ("temperature_degC: 24.0 °C", lambda log: log.temperature[0], 24.0),
        ("temperature_degC: 24.0 C", lambda log: log.temperature[0], 24.0),
        ("temperature_degC: 297.1 K", lambda log: log.temperature[0], 23.95),
        ("temperature_degC: 297.1 K", lambda log: log.temperature_digit, 0.1),
        ("temperature_degC: 75.2 °F", lambda log: log.temperature[0], 24.0),
        ("frequency_Hz: 32.28 kHz", lambda log: log.frequency[0], 32280.0),
        ("delay_s: 3 us", lambda log: log.bench["delay_s"], 3e-6),
        ("lockin_tau_us: 0.3 ms", lambda log: log.bench["lockin_tau_s"], 3e-4),
    ],
)
def test_a_unit_behind_another_number(save, stated, of, value):
    assert of(read(save, stated)) == pytest.approx(value, rel=1e-9)


def test_a_duty_in_percent_and_its_volts(save):
    assert read(save, "duty: 50 %", "volts_per_duty: 10 V").drive.tolist() == [5.0] * 8


def test_a_sample_rate_with_its_unit(save):
    rows = ROWS.replace("time_s", "sample").replace("0.00", "")
    log = read_logs([save("# sample_rate_Hz: 2 kHz\n# kind: transient\n" + rows)])[0]
    assert (log.time - log.time[0]).tolist() == pytest.approx([k / 2000 for k in range(8)])


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ("voltage_V: 100 mm", "expected a finite number of V; write the number alone"),
        ("voltage_V: 100 V rms", "expected a finite number of V; write voltage_V_rms: 100"),  # another number
        ("voltage_V: 0.1 kVpp", "expected a finite number of V; write voltage_kV_pp: 0.1"),
        ("voltage_V: 100 V at the plate", "write the number alone"),
        ("delay_s: 3 V", "expected a finite number of s; write the number alone"),
        ("frequency_Hz: a lot", "expected a finite number of Hz"),
    ],
)
def test_another_unit_is_refused_with_what_to_do(save, stated, words):
    key, _, text = stated.partition(": ")
    refused(save(f"# {stated}\n{ROWS}"), f"metadata {key!r}: found {text!r}", words)


def test_lengths_in_different_units_are_read_in_the_first(save):
    """25.4 um are a mil, which the library of units takes for an angle."""
    first, second, third = read_logs(
        [
            save("frequency_Hz,wd_um,wq_um\n1,25.4,0\n2,0,25.4\n", "a.csv"),
            save("# voltage_V: 1\nfrequency_Hz,wd_mil,wq_mil\n1,1,0\n2,0,1\n3,0,2\n", "b.csv"),
            save("# voltage_kV: 1\nfrequency_Hz,w_mm\n1,0.0254\n2,0.0254\n3,0\n", "c.csv"),
        ]
    )
    np.testing.assert_allclose(second.response[:2], first.response, rtol=1e-12)
    np.testing.assert_allclose(third.response, [25.4, 25.4, 0], rtol=1e-12)
    assert {log.response_unit for log in (first, second, third)} == {"um"} and third.drive[0] == 1000
    assert second.notes == (f"its response in mil is read in um, the unit of {first.path}",)
    assert [note.split(" is read")[0] for note in third.notes] == ["its response in mm", "its drive in kV"]


def test_logs_that_were_read_apart_are_fitted_in_the_unit_of_the_first():
    """It was a refusal; G has that unit."""
    plant = reference.Plant(0.02, 1.67e-3, 32300.0, 0.0)
    frequency = plant.f0 + np.linspace(-300, 300, 41)
    rows = [
        reference.steady(plant, v, frequency, 24.0) + reference.noise(41, 0.002, int(v)) for v in (80, 40)
    ]
    um, other = (
        sysid.Log.from_arrays(y, drive=v, frequency=frequency)
        for y, v in zip(rows, (80.0, 40.0), strict=True)
    )
    mm = sysid.Log.from_arrays(1e-3 * rows[1], drive=40.0, frequency=frequency, response_unit="mm")
    found, alike = sysid.fit([um, mm]).parameters["G"], sysid.fit([um, other]).parameters["G"]
    assert found.unit == "um/V" and abs(found.value - plant.G) < 4 * found.std
    assert found.value == pytest.approx(alike.value, rel=1e-6)
    inverse = sysid.fit([mm, um]).parameters["G"]
    assert inverse.unit == "mm/V" and inverse.value == pytest.approx(1e-3 * found.value, rel=1e-6)
    with pytest.raises(ValueError, match="found the response in V, expected a unit such as um as in log"):
        sysid.fit([um, sysid.Log.from_arrays(rows[1], drive=40.0, frequency=frequency, response_unit="V")])
