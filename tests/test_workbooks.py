"""Logs in workbooks of spreadsheet programs, against the same logs as text."""

import csv
import datetime
import hashlib
import sys
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import openpyxl
import pytest

import sysid
from sysid.command.cli import main
from sysid.tables import workbook

LOGS = Path(__file__).parent.parent / "data" / "synthetic"
STEP, SWEEP = LOGS / "step_100V_24C.csv", LOGS / "sweep_24C.csv"


def cells(path, comments=True):
    """The rows of a text file, numbers as such."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if comments or not row[0].startswith("#")]
    return [
        [float(cell) if cell[-1:].isdigit() and cell[:1] != "#" else cell for cell in row] for row in rows
    ]


@pytest.fixture
def book(tmp_path):
    """A function that saves sheets, by their names, as a workbook."""

    def saved(hidden=(), **sheets):
        made = openpyxl.Workbook()
        made.remove(made.active)
        for name, rows in sheets.items():
            sheet = made.create_sheet(name)
            for row in rows:
                sheet.append(row)
            sheet.sheet_state = "hidden" if name in hidden else "visible"
        made.save(tmp_path / "book.xlsx")
        return tmp_path / "book.xlsx"

    return saved


def same(log, path):
    """Whether a log holds what that of a text file does."""
    (known,) = sysid.read_logs(path)
    for name in ("time", "drive", "frequency", "temperature", "response"):
        np.testing.assert_array_equal(getattr(log, name), getattr(known, name))
    return (log.response_unit, log.kind) == (known.response_unit, known.kind)


def test_a_sheet_is_read_as_its_text_is(book):
    path = book(Sheet1=cells(STEP))
    (log,) = sysid.read_logs(path)
    assert same(log, STEP) and log.name == "book.xlsx"
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_each_sheet_with_a_table_is_a_log(book, tmp_path):
    path = book(step=cells(STEP), sweep=cells(SWEEP), old=cells(STEP), hidden=["old"])
    step, sweep = sysid.read_logs(path)
    assert same(step, STEP) and same(sweep, SWEEP)
    assert [step.name, sweep.name] == ["book.xlsx[step]", "book.xlsx[sweep]"]
    assert step.sha256 != sweep.sha256
    assert same(*sysid.read_logs(f"{path}[sweep]"), SWEEP)
    assert len(sysid.read_logs(tmp_path / "*.xlsx")) == 2
    with pytest.raises(
        sysid.LogError, match=r"book.xlsx\[old\]: found no sheet 'old' with a table.*step, sweep"
    ):
        sysid.read_logs(f"{path}[old]")


def test_a_table_may_stand_anywhere_and_notes_on_a_sheet_of_their_own(book):
    rows = cells(STEP, comments=False)
    units = ["Time\n(s)", "Voltage\n(V)", "Wd (µm)", "Wq (µm)"]
    laid = [[], ["", "My plate"], [], *([["", *row] for row in [units, *rows[1:]]])]
    laid[1] += [""] * 6 + ["a remark"]
    notes = [["Plate", "A7"], ["temperature_degC", 24], ["frequency_Hz", 32290]]
    (log,) = sysid.read_logs(book(data=laid, info=notes))
    np.testing.assert_array_equal(log.response, sysid.read_logs(STEP)[0].response)
    assert log.temperature[0] == 24 and log.frequency[0] == 32290


@pytest.mark.parametrize(
    "above",
    [
        [["temperature_degC: 15.1"]],
        [["Temperature [°C]", 15.1]],
        [["# Temperature [°C]", 15.1], []],
        [["Temperature", 15.1, "°C"], ["Voltage [V]", 1]],
        [["My plate"], ["Temperature:", 15.1, "°C"], []],
    ],
)
def test_what_is_noted_above_a_table_is_read(book, above):
    """A sheet has no mark of its own for a note: each was left out, and k_T was lost. What has the name of a
    column, as the voltage, is not taken for it."""
    (log,) = sysid.read_logs(book(Sheet1=[*above, *cells(SWEEP, False)]))
    (known,) = sysid.read_logs(SWEEP)
    assert np.all(log.temperature == 15.1)
    np.testing.assert_array_equal(log.response, known.response)
    np.testing.assert_array_equal(log.drive, known.drive)


def test_dates_are_read_as_such(book):
    rows = cells(STEP, comments=False)
    begun = datetime.datetime(2026, 3, 1, 12)
    dated = [[begun + datetime.timedelta(seconds=1000 * row[0]), *row[1:]] for row in rows[1:]]
    (log,) = sysid.read_logs(book(s=[["Date/time", "Voltage (V)", "Wd (um)", "Wq (um)"], *dated]))
    # a day is told to 2^-37 of itself in a number of the year 2026, and in whole microseconds
    np.testing.assert_allclose(log.time, [1000 * row[0] for row in rows[1:]], atol=2e-6)


def test_a_bad_cell_is_named_by_its_row(book):
    rows = cells(STEP)
    rows[100][2] = "n/a?"
    with pytest.raises(sysid.LogError, match=r"book.xlsx, line 101.*n/a\?"):
        sysid.read_logs(book(s=rows))


@pytest.mark.parametrize("seed", range(12))
def test_what_is_damaged_is_told_as_such(book, tmp_path, seed):
    """Cut off, or with bytes of others: read all the same, or refused by its name."""
    rng, broken = np.random.default_rng(seed), tmp_path / "broken.xlsx"
    whole = bytearray(book(s=cells(STEP)).read_bytes())
    for place in rng.integers(8, len(whole), 20):
        whole[place] = rng.integers(256)
    broken.write_bytes(whole if seed % 2 else whole[: rng.integers(20, len(whole))])
    with suppress(sysid.LogError):
        sysid.read_logs(broken)
    broken.write_bytes(bytes(whole[:400]))
    with pytest.raises(sysid.LogError, match=r"broken.xlsx: found a zip archive"):
        sysid.read_logs(broken)


def test_a_cell_far_away_costs_nothing(book):
    path = book(s=cells(STEP))
    made = openpyxl.load_workbook(path)
    made.active.cell(200_000, 3).value = " "
    made.save(path)
    assert same(*sysid.read_logs(path), STEP)


def test_what_unpacks_to_more_than_memory_holds_is_refused(book, monkeypatch):
    path = book(s=cells(STEP))
    with zipfile.ZipFile(path) as archive:
        monkeypatch.setattr(workbook, "UNPACKED", sum(info.file_size for info in archive.infolist()) - 1)
    with pytest.raises(sysid.LogError, match="unpacks to more than"):
        sysid.read_logs(path)


def test_without_the_library_it_is_said_how_to_have_it(book, monkeypatch):
    path = book(s=cells(STEP))
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(sysid.LogError, match=r"pip install 'sysid\[excel\]'"):
        sysid.read_logs(path)


def test_the_command_reads_a_book(book, capsys):
    assert main([str(book(step=cells(STEP), sweep=cells(SWEEP))), "--dry-run"]) == 0
    assert "book.xlsx[sweep]:101rows,steady" in "".join(capsys.readouterr().out.split())
