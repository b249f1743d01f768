"""Heads of strangers' files: of several columns of a kind the one that is meant, and what is no unit."""

import datetime

import numpy as np
import pytest
from refusal import draft_of, refused
from test_drafts import F, S, table

import sysid
from sysid.logs.read import read_logs

X, Y, LEVEL = S.real, S.imag, 0 * F


@pytest.mark.parametrize(
    "head, columns, entry, column",
    [
        ("f (Hz),X (um),Y (um),{}", (F, X, Y, LEVEL + 10), "voltage", head)
        for head in ("V_dc (V)", "Supply voltage (V)", "Drive offset (V)", "Tension d'alimentation (V)")
    ]
    + [
        ("f (Hz),X (um),Y (um),{}", (F, X, Y, LEVEL + 10), "temperature", head)
        for head in ("CPU temp (°C)", "Dew point temperature (°C)", "Delta T (°C)")
    ],
)
def test_what_is_not_the_plate_s_own_is_no_input(save, head, columns, entry, column):
    """A bias beside a sweep was drafted as the drive, a processor's temperature as the plate's."""
    text = draft_of(save(table(head.format(column), *columns)))
    assert f"\n{entry} =" not in text and '\nx = { column = "X (um)"' in text
    assert f'"{column}"' in text  # it is named, for whom it is all the same


@pytest.mark.parametrize(
    "head, entry, wanted",
    [
        ("f_set (Hz),f_meas (Hz),X (um),Y (um)", "frequency", "f_meas (Hz)"),
        ("Center frequency (Hz),Frequency (Hz),X (um),Y (um)", "frequency", "Frequency (Hz)"),
        ("Nominal frequency (Hz),Actual frequency (Hz),X (um),Y (um)", "frequency", "Actual frequency (Hz)"),
        (
            "Temperatur Soll (°C),Temperatur Ist (°C),f (Hz),X (um),Y (um)",
            "temperature",
            "Temperatur Ist (°C)",
        ),
        ("V_set (V),V_meas (V),f (Hz),X (um),Y (um)", "voltage", "V_meas (V)"),
        ("R min (um),R max (um),R mean (um),f (Hz),Theta (deg)", "magnitude", "R mean (um)"),
        ("Setpoint temperature (°C),f (Hz),X (um),Y (um)", "temperature", "Setpoint temperature (°C)"),
    ],
)
def test_what_there_was_goes_before_what_was_asked_for(save, head, entry, wanted):
    count = head.count(",") + 1
    columns = [F + k if "Hz" in name else abs(S) + k for k, name in enumerate(head.split(","))]
    text = draft_of(save(table(head, *columns[:count])))
    assert f'\n{entry} = {{ column = "{wanted}"' in text, text


def test_a_setpoint_is_the_drive_where_nothing_else_is(save):
    time = 0.01 * np.arange(60)
    text = draft_of(save(table("Time (s),Command (V),Speed (rpm)", time, 5 * (time > 0.2), time)))
    assert 'voltage = { column = "Command (V)"' in text and 'w = { column = "Speed (rpm)"' in text
    text = draft_of(save(table("Time (s),Soll (um),u (V),Ist (um)", time, 1 + time, 5 * (time > 0.2), time)))
    assert 'w = { column = "Ist (um)"' in text


@pytest.mark.parametrize("symbol", ["S", "A", "C", "H"])
def test_a_symbol_behind_a_function_is_no_unit(save, symbol):
    """abs(S) was an admittance in siemens, that 1 V drives, without a question."""
    text = draft_of(save(table(f"f (Hz),abs({symbol}),arg({symbol})", F, abs(S), np.degrees(np.angle(S)))))
    assert f'magnitude = {{ column = "abs({symbol})", unit = "?"' in text, text
    assert f'phase = {{ column = "arg({symbol})", unit = "?"' in text and 'quantity = "current"' not in text
    text = draft_of(save(table("f (Hz),Re(V),Im(V)", F, X, Y)))
    assert 'x = { column = "Re(V)", unit = "V" }' in text


# Times

TIME = 1e-4 * np.arange(60)
DRIVE = np.where(TIME > 0.00105, 50.0, 0.0)
STEP = 1.0 - np.exp(-np.clip(TIME - 0.0011, 0, None) / 1.67e-3)
START = datetime.datetime(2024, 3, 3, 23, 59, 59, 998000)
STAMPS = [START + datetime.timedelta(microseconds=100 * k) for k in range(60)]


def stamped(cells, name="time"):
    rows = zip(cells, DRIVE.tolist(), STEP.tolist(), strict=True)
    return f"{name},voltage_V,w_um\n" + "".join(f'"{cell}",{u},{w!r}\n' for cell, u, w in rows)


FORMS = {
    "a word": "%d-%b-%Y %H:%M:%S.%f",
    "two digits": "%d-%b-%y %H:%M:%S.%f",
    "American": "%b %d, %Y %I:%M:%S.%f %p",
    "a web server's": "%d/%b/%Y:%H:%M:%S.%f",
    "C's": "%a %b %d %H:%M:%S.%f %Y",
    "without marks": "%Y%m%dT%H%M%S.%fZ",
    "Japanese": "%Y年%m月%d日 %H時%M分%S.%f秒",
}


@pytest.mark.parametrize("form", FORMS)
def test_dates_of_other_forms(save, form):
    (log,) = read_logs(save(stamped([stamp.strftime(FORMS[form]) for stamp in STAMPS])))
    np.testing.assert_allclose(log.time, TIME, atol=1e-9)
    assert log.kind == "transient" and log.response.tolist() == STEP.tolist()


def test_german_months(save):
    cells = [stamp.strftime("%d. Mai %Y %H:%M:%S.%f") for stamp in STAMPS]
    np.testing.assert_allclose(read_logs(save(stamped(cells)))[0].time, TIME, atol=1e-9)


@pytest.mark.parametrize("cell", ["2024-063T12:00:00", "PT0.5S", "31-Foo-2024 12:00", "later"])
def test_a_time_of_an_unknown_form_is_shown(save, cell):
    """It was said to have no unit, and left out of the draft: a step was read as settled points."""
    error = refused(save(stamped([cell] * 60)), repr(cell), "2024-03-31T12:00:00.001", "time_s")
    assert error.mapping is None


@pytest.mark.parametrize(
    "name, cells",
    [
        ("micros()", [100 * k for k in range(60)]),
        ("Ticks", [638474832000000000 + 1000 * k for k in range(60)]),
        ("datenum", [739342.5 + 1e-4 * k / 86400 for k in range(60)]),
        ("経過 (秒)", TIME.tolist()),
        ("Time of day", [f"12:00:{k:02d}.5" for k in range(60)]),
    ],
)
def test_what_may_be_a_time_and_is_not_read_is_warned_of(save, name, cells):
    """There was a note alone that it is kept out, and a step was read as settled points."""
    (log,) = read_logs(save(stamped(cells, name)))
    assert any(f"{name!r} that goes up and may be one" in warning for warning in log.warnings)


@pytest.mark.parametrize("name, cells", [("level (dB)", range(60)), ("state", [k % 7 for k in range(60)])])
def test_what_is_no_time_is_not(save, name, cells):
    (log,) = read_logs(save(stamped([*cells], name)))
    assert not log.warnings


@pytest.mark.parametrize(
    "unit, scale", [("Sekunden", 1), ("Millisekunden", 1e3), ("secondes", 1), ("segundos", 1)]
)
def test_seconds_in_words(save, unit, scale):
    (log,) = read_logs(save(stamped((scale * TIME).tolist(), f"Zeit ({unit})")))
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)


def test_drive_and_response_without_a_carrier_are_told_their_names(save):
    text = "Time (s),Drive (V),Response (um)\n" + stamped(TIME.tolist()).partition("\n")[2]
    refused(save(text), "periods of the drive", "amplitudes are called voltage and w")


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_of_the_columns_below_their_names_are_no_row(save, first):
    """1 um at 1 V after 1 s was the first row of the log."""
    text = stamped(TIME.tolist(), "time_s")
    names, rows = text.split("\n", 1)
    (log,) = read_logs(save(f"{names}\n{first},{first + 1},{first + 2}\n{rows}"))
    assert log.response.tolist() == STEP.tolist()
    refused(
        save(f"{names}\n{first},{first + 1},{first + 2}\n{rows}".replace(repr(STEP[20].item()), "OL")),
        "line 23",
    )


# Amplitudes

PEAKS = {
    0.5**0.5: ["voltage_rms_V", "Voltage (rms) [V]", "Voltage [V] (rms)", "Voltage [V] eff", "u_rms_V"]
    + ["Spannung eff. [V]", "Tension efficace [V]", "Tensión eficaz (V)", "Spannung Effektivwert (V)"]
    + ["Tension valeur efficace (V)"],
    2.0: ["voltage_pp_V", "Voltage peak-peak [V]", "Voltage [V] (p-p)", "Spannung Spitze-Spitze [V]"]
    + ["Tension crête à crête [V]", "Tensión pico a pico (V)", "Spannung SS (V)"],
    1.0: ["voltage_peak_V", "Voltage (0-p) [V]", "Spannung Spitzenwert (V)"],
}


@pytest.mark.parametrize(
    "factor, head", [(factor, head) for factor, heads in PEAKS.items() for head in heads]
)
def test_what_a_head_says_of_its_amplitude(save, head, factor):
    """The column was left out, and the note said to call it voltage_V."""
    text = f"frequency_Hz;wd_um;wq_um;{head}\n" + "".join(
        f"{f};{w.real};{w.imag};{50 * factor!r}\n" for f, w in zip(F, 1j * S, strict=True)
    )
    (log,) = read_logs(save(text))
    np.testing.assert_allclose(log.drive, 50.0, rtol=1e-12)


def test_what_to_call_a_column_keeps_its_amplitude(save):
    (log,) = read_logs(save(table("frequency_Hz,wd_um,wq_um,Uss [V]", F, X, Y, LEVEL + 100)))
    assert log.drive is None and any("call it voltage_V_pp" in note for note in log.notes)


@pytest.mark.parametrize("name", ["Upp [V]", "Urms [V]", "Vrms", "Vpp (V)"])
def test_a_letter_and_its_amplitude_are_the_drive(save, name):
    text = draft_of(save(table(f"f (Hz),X (um),Y (um),{name}", F, X, Y, LEVEL + 100)))
    assert f'\nvoltage = {{ column = "{name}"' in text
    text = draft_of(save(table(f"frequency_Hz,{name},phase_deg,voltage_V", F, abs(S), X, LEVEL + 100)))
    assert '\nvoltage = { column = "voltage_V"' in text


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_heads_of_several_lines(save, end):
    """As a spreadsheet writes them; the first line alone was the header."""
    head = '"Frequency\n(Hz)","wd\n(um)","wq\n(um)","Voltage\n(V rms)"\n'.replace("\n", end)
    body = table("-", F, X, Y, LEVEL + 50).partition("\n")[2].replace("\n", end)
    (log,) = read_logs(save(b"\xef\xbb\xbf" + (head + body).encode()))
    assert log.frequency.tolist() == F.tolist() and log.drive[0] == pytest.approx(50 * 2**0.5)
    cells = (head + body).split(end)
    cells[9] = cells[9].replace(",", ",x", 1)
    refused(save(end.join(cells)), "line 10")


@pytest.mark.parametrize("unit", ["℃", "deg C", "° C", "ºC", "oC", "Deg. C", "degrees C", "°C", "DEGC"])
def test_degrees_however_they_are_written(save, unit):
    text = table(f"frequency_Hz,wd_um,wq_um,temperature ({unit})", F, X, Y, LEVEL + 24)
    assert {*read_logs(save(text))[0].temperature} == {24.0}
    text = draft_of(save(table(f"f (Hz),X (um),Y (um),T ({unit})", F, X, Y, LEVEL + 24)))
    assert (
        'temperature = { column = "T (' in text
        and 'unit = "?"' not in text.partition("temperature =")[2].split("\n")[0]
    )


def test_numbers_between_their_names_and_their_units(save):
    """As a program prints them; the first two rows were taken for names and units."""
    text = "".join(
        f"frequency={f} Hz, wd = {w.real} um, wq: {w.imag} um\n" for f, w in zip(F, 1j * S, strict=True)
    )
    (log,) = read_logs(save(text))
    assert log.frequency.tolist() == F.tolist() and log.response.tolist() == (1j * S).tolist()
    refused(save(text.replace("wd", "w", 1)), "expected columns")
    refused(save(text.replace(f"{F[20]} Hz", f"{F[20]} kHz")), "line 21", "kHz")


def test_samples_of_a_carrier_under_plain_heads_are_asked_about(save):
    """They were rows of a plant without a frequency; a sine that drives one is no carrier."""
    t = 4e-6 * np.arange(4000)
    carrier, slow = (np.sin(2 * np.pi * f * t) for f in (25310.0, 500.0))
    for drive, asked in ((carrier, True), (slow, False)):
        (log,) = read_logs(save(table("time_s,voltage_V,w_um", t, 40 * drive, 0.3 * np.roll(drive, 3))))
        assert any("samples of a carrier" in said for said in log.warnings) is asked


@pytest.mark.parametrize("head", ["", "# frequency_Hz: 25310\n"])
def test_a_decay_in_decibels_has_noise_of_one_level(save, head):
    """|2 e^(-t/tau) + noise| nm as 20 log10: the noise is of the sensor, and no share of what is left."""
    t, rng = 2e-5 * np.arange(300), np.random.default_rng(0)
    w = np.abs(2000 * np.exp(-t / 9e-4) + 4 * rng.standard_normal((2, 300)).T @ [1, 1j])
    level = table("Time [ms],Level [dB re 1 nm]", 1e3 * t, 20 * np.log10(w))
    fit = sysid.fit(read_logs(save(head + level)))
    assert fit.result is sysid.Result.successful
    assert abs(fit.parameters["tau"].value - 9e-4) < 4 * fit.parameters["tau"].std < 1e-5


def test_dates_that_are_days_of_a_spreadsheet(save):
    days = 45382.5 + np.arange(30) * 10 / 86400
    heater, oven = np.where(np.arange(30) < 10, 0.0, 12.0), 20 + np.arange(30.0)
    for names in ("Date,Heater (V),Temp (degC)", "Date/Time,voltage_V,w_degC"):
        rows = "".join(f"{d:.8f},{u:g},{w:g}\n" for d, u, w in zip(days, heater, oven, strict=True))
        (log,) = read_logs(save(f"{names}\n{rows}"))
        np.testing.assert_allclose(np.diff(log.time), 10, atol=2e-3)  # of 1e-8 days 0.9 ms
        assert log.drive.tolist() == heater.tolist() and log.response.tolist() == oven.tolist()
    refused(save("time,voltage_V,w_degC\n" + rows), "unit of time")  # seconds of an uptime go up so, too


def test_rows_that_begin_with_dates_stand_below_a_preamble(save):
    """And a drive that is off in the first rows is none of them by its numbers: by its unit."""
    rows = "".join(
        f"{k},05/17/2024 10:00:{k:02d}:000,{40.0 * (k > 30):g},{20 + k / 7:.4f}\n" for k in range(60)
    )
    text = f"Name:,heater\nOwner:,me\nInstrument:,34970A\n\nScan,Time,101 <SETPOINT> (VDC),102 <TEMP> (C)\n{rows}"
    (log,) = read_logs(save(text))
    assert len(log) == 60 and log.time[-1] == 59 and log.drive_unit == "V" and log.drive[-1] == 40
    (log,) = read_logs(save(text.replace("101 <SETPOINT> (VDC)", "Coil current (mA)")))
    assert log.drive_unit == "mA"


def test_an_acceleration_of_a_sweep_is_no_power(save):
    head = "Frequency (Hz),Drive (V peak),Acceleration (m/s^2 peak),Phase (deg)"
    size, angle = np.abs(S), np.degrees(np.unwrap(np.angle(S)))
    (log,) = read_logs(save(table(head, F, np.full(len(F), 40.0), size, angle)))
    np.testing.assert_allclose(np.abs(log.response), size / (2 * np.pi * F) ** 2, rtol=1e-6)
