"""Files as other programs write them whose tables lie otherwise than a row a line, each from a plate in closed form."""

import re

import numpy as np
import pytest
from refusal import refused

from sysid.logs.read import read_logs

TIME = 1e-4 * np.arange(60)
DRIVE = np.where(TIME > 0.00105, 50.0, 0.0)
STEP = 1.0 - np.exp(-np.clip(TIME - 0.0011, 0, None) / 1.67e-3) + 1e-4j * np.cos(1e4 * TIME)


def rows(*columns, mark=","):
    return "".join(mark.join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def step(stamps, name="time_us"):
    return f"{name},voltage_V,wd_um,wq_um\n" + rows(stamps, DRIVE, STEP.real, STEP.imag)


# A clock of 32 bits


@pytest.mark.parametrize("name, scale, begin", [("time_us", 1, 0), ("time_ms", 1e-3, 0), ("time_s", 1e-6, -(2**31))])
@pytest.mark.parametrize("start", [2**32 - 2500, 3 * 2**31 - 1000])
def test_a_counter_of_microseconds_goes_on_past_its_end(save, name, scale, begin, start):
    """As micros() is printed after 71.6 minutes, also as a number with a sign."""
    counts = (start + 100 * np.arange(60) - begin) % 2**32 + begin
    (log,) = read_logs(save(step([f"{scale * count:.6f}" for count in counts], name)))
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-9)
    assert ("a clock of 32 bits" in " ".join(log.notes)) == (np.diff(counts) < 0).any()


@pytest.mark.parametrize("change", [-5000, 700, -3e6])
def test_another_jump_back_is_no_end_of_a_counter(save, change):
    """By less than a turn and a step, or by more."""
    counts = (2**32 - 2500 + 100.0 * np.arange(60)) % 2**32
    counts[counts < 2**31] += change
    refused(save(step([*map(int, counts)])), "line 27", "expected a time not below the one before")


# Tables that are drawn

NAMES = ("frequency_Hz", "wd_um", "wq_um", "voltage_V")
F = 32300.0 + 20.0 * np.arange(-30, 31)
W = 1.0 / (1.0 + 2j * np.pi * (F - 32300.0) * 1.67e-3)
CELLS = [NAMES, *zip(*(map(repr, x.tolist()) for x in (F, W.real, W.imag, 50.0 + 0 * F)), strict=True)]
WIDE = [[f"{cell:>24}" for cell in row] for row in CELLS]


def drawn(left, bar, right, above="", below="", between="", last="", rows=CELLS):
    lines = [f"{left}{bar.join(row)}{right}" for row in rows]
    body = f"\n{between}\n".join(lines[1:]) if between else "\n".join(lines[1:])
    return "".join(f"{part}\n" for part in (above, lines[0], below, body, last) if part)


DRAWN = {
    "bars alone": drawn("", "|", ""),
    "Markdown": "# Sweep\n\n" + drawn("| ", " | ", " |", "", "|---:|:---:|---|---:|"),
    "Markdown without ends": drawn("", " | ", "", "", "--- | --- | --- | ---"),
    "psql": drawn(" ", " | ", "", "", "-----+----+---+------", "", "(61 rows)\n", WIDE),
    "mysql": drawn(*("| ", " | ", " |"), *2 * ("+----+-----+----+---+",), "", "+----+-----+----+---+\n61 rows in set (0.01 sec)\n"),
    "Org": drawn("| ", " | ", " |", "", "|------+------+---+---|"),
    "grid": drawn("| ", " | ", " |", "+---+---+---+---+", "+===+===+===+===+", "+---+---+---+---+", "+---+---+---+---+"),
    "sqlcmd": drawn("", " ", "", "", "----------- --------- ------- -----", "", "\n(61 rows affected)", WIDE),
    "reStructuredText": drawn("", "  ", "", "=====  ===== ===== ====", "=====  ===== ===== ====", "", "=====  ===== ===== ====", WIDE),
    "a box": drawn("│ ", " │ ", " │", "┌────┬────┬────┬───┐", "├────┼────┼────┼───┤", "", "└────┴────┴────┴───┘"),
    "a wiki": drawn("|", "|", "|"),
}  # fmt: skip


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("form", DRAWN)
def test_tables_that_are_drawn(save, form, end):
    (log,) = read_logs(save(DRAWN[form].replace("\n", end)))
    assert log.frequency.tolist() == F.tolist() and log.response.tolist() == W.tolist()
    assert log.drive.tolist() == [50.0] * 61


def test_lines_are_counted_with_the_rules(save):
    text = DRAWN["grid"].replace("32300.0", "OL")
    assert refused(save(text)).args[0].count(f"line {text[: text.index('OL')].count(chr(10)) + 1}")


@pytest.mark.parametrize("names, mark", [("f|x in um|y in um", "|"), ("Frequency, Hz|X, um|Y, um", "|"), ("f |X|/um phi/deg", " ")])
def test_a_bar_parts_cells_or_stands_for_a_magnitude(save, names, mark):
    text = refused(save(names + "\n" + rows(F, W.real, W.imag, mark=mark))).mapping
    assert len(re.findall(r"^\w+ = \{ column", text, re.M)) == 3 and ('"|X|/um"' in text) == (mark == " "), text


def test_a_bar_within_a_cell_of_markdown(save):
    text = r"| f/Hz | \|Z\|/ohm | phi/deg |" + "\n|---|---|---|\n" + "".join(
        f"| {f} | {1e4 * abs(w)} | {np.degrees(np.angle(w))} |\n" for f, w in zip(F, W, strict=True)
    )
    assert 'magnitude = { column = "|Z|/ohm", unit = "ohm" }' in refused(save(text)).mapping
