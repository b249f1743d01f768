"""Heads that strangers met: what is no drive, which of two is the response, in which code page, counted from where.

The truth is a resonance in closed form, as in `test_drafts`.
"""

import numpy as np
import pytest
from refusal import refused
from test_drafts import DRIVE, F, S, T, polar, re_im, table

from sysid.logs.read import read_logs

LOCK_IN = "Freq (Hz),X (V),Y (V),Sens"


def with_units(text, unit):
    """The last column's cells with their unit."""
    head, *rows = text.splitlines()
    return "\n".join([head, *(f"{row} {unit}" for row in rows)]) + "\n"


def test_the_sensitivity_of_a_lock_in_is_no_drive(save):
    path = save(with_units(table(LOCK_IN, F, *re_im(S), 0 * F + 500), "mV"))
    (log,) = read_logs(path)
    assert log.drive is None
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-9)


def test_a_constant_that_a_mapping_file_states_comes_before_a_column_that_seems_to_be_the_drive(save):
    path = save(table("Freq (Hz),X (V),Y (V),Vref (V)", F, *re_im(S), 0 * F + 2.5))
    assert np.all(read_logs(path)[0].drive == 2.5)
    said = 'preset = "sr865"\nquantity = "displacement"\n[constants]\nvoltage = "1 V"\n'
    assert np.all(read_logs(path, columns=save(said, "map.toml"))[0].drive == 1.0)


def test_of_two_signals_beside_one_phase_it_is_asked_which_is_the_response(save):
    amplitude, phase = polar(S)
    rows = table(
        "f [kHz],Phase [deg],PD current [uA],Sensor [mVrms]", F / 1e3, phase, 3 + amplitude, amplitude
    )
    refused(save(rows), "PD current [uA] or Sensor [mVrms]", "mapping file")


def test_a_reflection_is_no_displacement(save):
    """Of S21 it may be what a sensor makes of the drive, and that is a warning."""
    rows = table("Freq(Hz),S11 Log Mag(dB),S11 Phase(deg)", F, *polar(S))
    refused(
        save(
            "!CSV A.01.01\n!Keysight Technologies,E5061B,MY49300000,A.03.01\n!Source: Standard\n\nBEGIN CH1_DATA\n"
            + rows
            + "END\n"
        ),
        "quantity",
    )


@pytest.mark.parametrize("name", ["w_um", "w"])
def test_complex_numbers_of_numpy_are_both_parts(tmp_path, name):
    path = tmp_path / "log.npz"
    np.savez(path, frequency_Hz=F, voltage_V=0 * F + 50, **{name: S})
    if name == "w":
        refused(path, "expected")  # in no unit
        return
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-12)
    assert log.response_unit == "um"


def test_the_last_name_above_a_table_that_lies_across_may_be_that_of_all_numbers(save):
    parts = {"frequency": F, "x": S.real, "y": S.imag}
    lines = [f"0;12;{len(F)};{name};" + ";".join(f"{v:.15g}" for v in of) for name, of in parts.items()]
    (log,) = read_logs(save("\n".join(["chunk;timestamp;size;fieldname;data", *lines]) + "\n"))
    np.testing.assert_allclose(log.response, 1j * np.sqrt(2) * S, rtol=1e-9)


def test_settings_of_an_oscilloscope_tell_the_units_of_its_columns(save):
    above = "Model,MSO24\n\nWaveform Type,ANALOG\nHorizontal Units,ms\nSample Interval,50\nVertical Units,V\nLabel,\n\n"
    (log,) = read_logs(save(above + table("TIME,CH1", 1e3 * T, np.exp(-T / 0.4))))
    np.testing.assert_allclose(log.time, T, rtol=1e-9)
    assert log.response_unit == "V"


def test_comments_behind_stars_are_those_of_any_file(save):
    path = save(
        "* Measurement data measured by REW V5.20\n*\n* Freq(Hz) SPL(dB) Phase(degrees)\n"
        + table("", F, *polar(S)).replace(",", " ")
    )
    said = """quantity = "displacement"
amplitude = "peak"
phase_sign = 1
[columns]
frequency = { column = "Freq(Hz)", unit = "Hz" }
magnitude = { column = "SPL(dB)", unit = "V" }
phase = { column = "Phase(degrees)", unit = "deg" }
"""
    np.testing.assert_allclose(read_logs(path, columns=save(said, "map.toml"))[0].response, 1j * S, rtol=1e-9)


def test_a_line_of_comments_between_the_units_and_the_rows_is_left_out_and_noted(save):
    rows = "Frequency,Amplitude,Phase\nHz,um,deg\nComments,LDV,LDV\n" + table("", F, *polar(S))
    (log,) = read_logs(save(rows))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-9)
    assert "line 3, between the header and the rows, left out" in log.notes


@pytest.mark.parametrize("stated", ["f_center_Hz: 32300", "centre frequency: 32.3 kHz"])
def test_a_detuning_is_counted_from_the_centre_that_the_file_states(save, stated):
    rows = table("detuning (Hz),X (um),Y (um)", F - 32300, *re_im(S))
    np.testing.assert_allclose(read_logs(save(f"# {stated}\n" + rows))[0].frequency, F, rtol=1e-12)
    refused(save(rows), "found no response")


@pytest.mark.parametrize(
    ("head", "page"),
    [
        ("周波数[Hz],電圧[V],振幅[nm],位相[deg]", "cp932"),
        ("频率(Hz),电压(V),幅值(nm),相位(deg)", "gbk"),
        ("Частота (Гц),Напряжение (В),Амплитуда (нм),Фаза (град)", "cp1251"),
        ("Fréquence d’excitation (Hz),Tension d’entrée (V),Amplitude (nm),Déphasage (°)", "cp1252"),
    ],
)
def test_heads_are_read_in_the_code_page_that_they_were_written_in(tmp_path, head, page):
    path = tmp_path / "log.csv"
    path.write_bytes(table(head, F, 0 * F + 50, *polar(S)).encode(page))
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-9)
    assert np.all(log.drive == 50)
    assert any(head.split(",")[0] in note for note in log.notes)


def test_a_unit_of_degrees_stands_in_a_row_of_units(save):
    rows = "Zeit;Spannung;Auslenkung;Temperatur\nms;V;nm;°C\n" + table(
        "", 1e3 * T, DRIVE, 1 - np.exp(-T), 0 * T + 24
    ).replace(",", ";")
    (log,) = read_logs(save(rows))
    assert np.all(log.temperature == 24)
