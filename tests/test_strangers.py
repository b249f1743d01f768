"""Heads of strangers' files: of several columns of a kind the one that is meant, and what is no unit."""

import numpy as np
import pytest
from refusal import draft_of
from test_drafts import F, S, table

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
