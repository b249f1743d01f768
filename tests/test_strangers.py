"""Heads of strangers' files: of several columns of a kind the one that is meant, and what is no unit."""

import datetime

import numpy as np
import pytest
from refusal import draft_of, refused
from test_drafts import F, S, table

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
        ("時間 (秒)", TIME.tolist()),
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
