"""Files as instruments, spreadsheets and loggers export them: what is written here in their dialect must read
back as it was."""

import datetime
import gzip
import math

import numpy as np
import pytest
from refusal import draft_of, refused

from sysid.fitting import fit
from sysid.logs.read import read_logs
from sysid.tables import csvbody
from sysid.tables.cells import to_number
from sysid.tables.stamps import seconds_since, told
from sysid.verdict.result import Result

NOON = datetime.datetime(2024, 3, 1, 12)
HEADER = "time_s,voltage_V,frequency_Hz,wd_um,wq_um\n"
TIME = np.arange(24) * 1e-4
STEP = np.array(
    [TIME, np.where(TIME > 4e-4, 10.0, 0.0), np.full(24, 32290.5), 0.1 * np.sin(1e4 * TIME), -1e-3 * TIME]
)
STEPS = [",".join(map(repr, row)) for row in STEP.T.tolist()]
ROWS = "".join(f"{row}\n" for row in STEPS)
FREQUENCY = np.linspace(31900, 32700, 9)
SIGNAL = -0.01j / (1 + 2j * math.pi * (FREQUENCY - 32300) * 1.67e-3)  # of a displacement: Wd + jWq = j s


def check_step(log, start=0.0):
    np.testing.assert_allclose(
        log.time, TIME + start, rtol=0, atol=1e-12
    )  # a stamp's microseconds are exact, its floats nearly
    assert log.drive.tolist() == STEP[1].tolist()
    assert log.frequency.tolist() == STEP[2].tolist()
    np.testing.assert_allclose(log.response, STEP[3] + 1j * STEP[4], rtol=1e-15)
    assert log.kind == "transient"


# Dates


def stamped(form, name="timestamp", header=HEADER):
    stamps = [form(NOON + datetime.timedelta(microseconds=100 * k)) for k in range(24)]
    rows = [f"{stamp},{row.partition(',')[2]}\n" for stamp, row in zip(stamps, STEPS, strict=True)]
    return header.replace("time_s", name) + "".join(rows)


FORMS = {
    "T": datetime.datetime.isoformat,
    "blank, and no fraction where it is zero": str,
    "Z": lambda at: f"{at.isoformat()}Z",
    "zone": lambda at: f"{at.isoformat()}+01:00",
    "slashes": lambda at: at.strftime("%Y/%m/%d %H:%M:%S.%f"),
    "clock": lambda at: at.strftime("%H:%M:%S.%f"),
    "nanoseconds": lambda at: f"{at.isoformat('T', 'microseconds')}000",
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize(
    "name", ["time", "time_s", "timestamp", "Timestamp (UTC)", "Time [s]", "datetime", "Date/Time"]
)
def test_dates_are_seconds_since_the_first_row(save, form, name):
    (log,) = read_logs(save(stamped(form, name)))
    check_step(log)
    assert f"column {name} is counted from its first row" in " ".join(log.notes)


def test_dates_with_a_decimal_comma(save):
    text = stamped(lambda at: at.isoformat(" ", "microseconds")).replace(",", ";").replace(".", ",")
    check_step(read_logs(save(text))[0])


@pytest.mark.parametrize(
    "form",
    ["03/31/2024 12:00:{}", "31.03.2024 12:00:{}", "2024-03-31 12:00:{}", "Mar 31, 2024 12:00:{} PM"],
)
@pytest.mark.parametrize("end", ["05:250", "05.25", "05,25"])
def test_dates_with_a_colon_before_the_milliseconds(form, end):
    passed = told(seconds_since(form.format("00"), [form.format("01"), form.format(end)]))
    assert passed.tolist() == [1.0, 5.25]


def test_a_zone_may_be_a_word():
    stamps = ["2024-03-31 12:00:00.5 UTC", "2024-03-31 12:00:01GMT", "2024-03-31T14:00:02+02:00"]
    assert seconds_since(stamps[0], stamps).tolist() == [0.0, 0.5, 1.5]


def test_dates_across_midnight_and_a_change_of_the_clocks():
    stamps = [
        f"2024-{at}"
        for at in ("03-31T01:59:59.9+01", "03-31T03:00:00.1+02:00", "03-31T23:59:59+0200", "04-01T00:00:01Z")
    ]
    assert seconds_since(stamps[0], stamps).tolist() == [0.0, 0.2, 75599.1, 82801.1]
    bad = ["", "nan", "2024-13-01", "2024-03-32 1:00", "12:00:00", "5", "01/03/2024 12:00"]
    assert np.isnan(seconds_since("2024-03-01 12:00", bad)).all()
    assert np.isnan(seconds_since("12:00:00", ["2024-03-01T12:00:00", "12:00", "25:61:00x"])).all()


def test_dates_through_a_mapping_file(save):
    table = save('amplitude = "peak"\n[columns]\ntime = "when"\nw = "wq_um"\n', "map.toml")
    path = save(stamped(datetime.datetime.isoformat, "when"))
    (log,) = read_logs(path, columns=table)
    np.testing.assert_allclose(log.time, TIME, rtol=0, atol=1e-12)
    save(
        'amplitude = "peak"\n[columns]\nfrequency = { column = "when", unit = "Hz" }\nw = "wd_um"\n',
        "map.toml",
    )
    refused(path, "line 2", "'when'", "a date", columns=table)


LOCAL = {
    "German": "%d.%m.%Y %H:%M:%S.%f",
    "American": "%m/%d/%Y %I:%M:%S.%f %p",
    "of two digits": "%d-%m-%y %H:%M:%S.%f",
    "T": "%d/%m/%YT%H:%M:%S.%f",
}
EVE = datetime.datetime(
    2024, 4, 5, 23, 59, 59, 999100
)  # nine rows before a day that might be the fourth of June


def locally(form, first, name="time", step=datetime.timedelta(microseconds=100)):
    rows = [row.partition(",")[2] for row in STEPS]
    stamps = [(first + k * step).strftime(form) for k in range(len(rows))]
    header = HEADER.replace("time_s", name)
    return header + "".join(f"{stamp},{row}\n" for stamp, row in zip(stamps, rows, strict=True))


@pytest.mark.parametrize("form", LOCAL.values(), ids=LOCAL)
@pytest.mark.parametrize("name", ["time", "time_s", "timestamp"])
def test_local_dates_within_a_day_are_read_whatever_their_order(save, form, name):
    for hour in (0, 11, 12, 23):  # noon and midnight are 12 of a half day
        (log,) = read_logs(save(locally(form, NOON.replace(hour=hour), name)))
        check_step(log)
        assert f"column {name} is counted from its first row" in " ".join(log.notes)
    (log,) = read_logs(save(locally(form, NOON.replace(minute=59, second=59, microsecond=999000), name)))
    check_step(log)  # across one o'clock


@pytest.mark.parametrize("form", [form for name, form in LOCAL.items() if name != "of two digits"])
@pytest.mark.parametrize("block", [1 << 24, 200])
def test_a_day_above_twelve_tells_the_order_of_local_dates(save, form, block, monkeypatch):
    """Wherever it stands in the column, which is read in blocks."""
    monkeypatch.setattr(csvbody, "BLOCK", block)
    check_step(read_logs(save(locally(form, EVE.replace(day=30))))[0])  # of April, to the first of May
    rows = "".join(f"{row.partition(',')[2]}\n" for row in STEPS).splitlines()
    days = [datetime.datetime(2024, 3, 1) + datetime.timedelta(days=k) for k in range(24)]
    text = HEADER.replace("time_s", "time") + "".join(
        f"{day.strftime(form)},{row}\n" for day, row in zip(days, rows, strict=True)
    )
    (log,) = read_logs(save(text))
    np.testing.assert_allclose(log.time, 86400.0 * np.arange(24))


@pytest.mark.parametrize("form", LOCAL.values(), ids=LOCAL)
def test_a_day_that_could_be_a_month_is_refused(save, form):
    for name in ("time", "time_s"):
        path = save(locally(form, EVE, name))
        error = refused(path, "line 11", "cannot be told apart", "2024-03-31T12:00:00.001", "since the first")
        assert error.mapping is None  # which would not help
    (log,) = read_logs(save(locally(form, EVE, "timestamp")))
    assert log.time is None and "day and month cannot be told apart" in " ".join(log.notes)


@pytest.mark.parametrize(
    "cell",
    ["31.02.2024 12:00:00", "32.01.2024 12:00:00", "01.03.2024 13:00:00 PM", "01.03.2024 25:00:00", "x"],
)
def test_a_local_date_that_is_none_is_refused(save, cell):
    lines = locally(LOCAL["German"], NOON).splitlines()
    lines[5] = f"{cell},{lines[5].partition(',')[2]}"
    refused(save("\n".join(lines)), "line 6", repr(cell), "a date as in the first row")


def test_times_of_day_go_on_past_midnight_once(save):
    text = locally("%H:%M:%S.%f", EVE)
    (log,) = read_logs(save(text))
    check_step(log)
    assert "column time holds times of day, which pass midnight before line 11" in log.notes
    check_step(read_logs(save(locally("%I:%M:%S.%f %p", EVE)))[0])
    check_step(read_logs(save(locally("%H:%M:%S.%f", EVE, "timestamp")))[0])
    twice = locally("%H:%M:%S", EVE, step=datetime.timedelta(hours=7))
    refused(save(twice), "line 3", "a time not below the one before")
    half = locally("%I:%M:%S.%f", EVE.replace(hour=12))  # of half a day, from 12:59:59 to 01:00:00
    refused(save(half), "line 11", "a time not below the one before")


def test_a_timestamp_that_is_not_read_says_why(save):
    odd = read_logs(save(stamped(lambda at: at.strftime("%d.%m.%Y %Hh%M"))))[0]
    assert "a date of a form that is not read" in " ".join(odd.notes)
    ticks = read_logs(save(HEADER.replace("time_s", "timestamp") + ROWS))[0]
    assert "it states no unit of time; call it timestamp_s" in " ".join(ticks.notes)
    swept = "timestamp,frequency_Hz,w_um,time_s\n1,2,3,4\n2,3,4,5\n"
    assert read_logs(save(swept))[0].notes == ("column timestamp is kept out of the fit",)


def test_a_row_without_its_date_is_named(save):
    text = stamped(datetime.datetime.isoformat, "time").splitlines()
    text[5] = "," + text[5].partition(",")[2]
    refused(save("\n".join(text)), "line 6", "'time'", "an empty cell", "a date as in the first row")
    text[5] = "2023-03-01T12:00:00" + text[5]
    refused(save("\n".join(text)), "line 6", "'time'", "a time not below the one before")


@pytest.mark.parametrize("cell", ["", "2023-03-01T12:00:00", "01/03/2024"])
def test_dates_in_a_column_of_another_name_are_never_an_error(save, cell):
    text = stamped(datetime.datetime.isoformat).splitlines()
    text[5] = cell + "," + text[5].partition(",")[2]
    (log,) = read_logs(save("\n".join(text)))
    assert log.time is None and "timestamp is kept out of the fit" in " ".join(log.notes)


def test_dates_that_are_too_coarse(save):
    """Of a step they are refused in a column time, kept out in another; a slow sweep does not need them."""
    refused(
        save(stamped(lambda at: at.isoformat("T", "milliseconds"), "time")),
        "line 3",
        "'time'",
        "fractions of a second",
    )
    (log,) = read_logs(save(stamped(lambda at: at.isoformat("T", "milliseconds"))))
    assert "timestamp is kept out of the fit: its dates are too coarse" in " ".join(log.notes)
    text = "timestamp,frequency_Hz,wd_um,wq_um\n" + "".join(
        f"2024-03-01T12:00:0{k // 3},{100 + k},{k},1\n" for k in range(9)
    )
    (log,) = read_logs(save(text))
    assert (log.kind, log.time) == ("steady", None)
    assert "its dates are too coarse" in " ".join(log.notes)
    (log,) = read_logs(save(text.replace("timestamp", "time")))
    assert (log.kind, log.time) == ("steady", None)


def test_epoch_seconds_of_a_waveform_keep_their_steps(save, tmp_path):
    """Beside 1.7e9 s double precision has steps of 0.24 us."""
    t = np.arange(4000) / 1e6
    drive = np.sin(2 * np.pi * 40e3 * t)
    cells = zip(
        [f"1709290800.{k:06d}" for k in range(4000)], drive.tolist(), (0.1 * drive).tolist(), strict=True
    )
    text = "time_s,drive_V,response_um\n" + "".join(f"{a},{b!r},{c!r}\n" for a, b, c in cells)
    (log,) = read_logs(save(text))
    np.testing.assert_allclose(log.frequency[log.drive != 0], 40e3, rtol=1e-8)
    columns = 'time = "time_s"\ndrive = "drive_V"\nresponse = "response_um"\n'
    (tmp_path / "map.toml").write_text('kind = "waveform"\nquantity = "displacement"\n[columns]\n' + columns)
    (mapped,) = read_logs(save(text), columns=tmp_path / "map.toml")
    assert mapped.response.tobytes() == log.response.tobytes()


# A header that stands again


@pytest.mark.parametrize("block", [csvbody.BLOCK, 37])
@pytest.mark.parametrize(
    "between",
    ["", "\n\n", "END\n\nBEGIN CH2_DATA\n", "# a note: of the second run\n", "\t\nSamples,24,24\n***\n"],
    ids=["none", "blank", "BEGIN", "comment", "settings"],
)
def test_a_header_again_begins_a_log(save, monkeypatch, block, between):
    monkeypatch.setattr(csvbody, "BLOCK", block)
    above = "BEGIN CH1_DATA\n" if "BEGIN" in between else ""
    below = "END\n" if above else ""
    first, second = read_logs(
        save(above + HEADER + ROWS + between + HEADER + ROWS.replace("32290.5", "32291.5") + below)
    )
    check_step(first)
    assert (first.name, second.name) == ("log.csv[1]", "log.csv[2]")
    assert second.frequency.tolist() == [32291.5] * 24
    assert second.response.tobytes() == first.response.tobytes()
    lines = (26 + len(above.splitlines()), 26 + len((above + between).splitlines()))
    where = f"line {lines[0]}:" if lines[0] == lines[1] else f"lines {lines[0]} to {lines[1]}:"
    assert where in " ".join(first.notes)


@pytest.mark.parametrize("form", ["crlf", "gzip", "blanks", "comment", "units", "cells", "many", "utf-16"])
def test_a_header_again_however_it_is_written(save, form):
    text = (HEADER + ROWS) * 2
    if form == "comment":
        text = text.replace("time_s", "# time_s")
    if form == "units":
        text = text.replace(HEADER, "time,voltage,frequency,wd,wq\ns,V,Hz,um,um\n")
    if form == "many":
        text = text * 4
    if form == "blanks":
        text = text.replace(",", "   ").replace("\n", "  \n ")
    content = text.replace("\n", "\r\n").encode() if form == "crlf" else text.encode()
    content = (
        gzip.compress(content) if form == "gzip" else text.encode("utf-16") if form == "utf-16" else content
    )
    logs = read_logs(save(content))
    assert len(logs) == (8 if form == "many" else 2)
    for log in logs:
        check_step(log)


def test_rows_of_every_table_and_lines_of_messages(save):
    text = HEADER + ROWS + "\n# again\n" + HEADER + ROWS
    lines = text.splitlines()
    lines[40] = lines[40].replace("32290.5", "x")
    refused(save("\n".join(lines)), "line 41", "'frequency_Hz'", "'x'")
    lines[40] = lines[40].rpartition(",")[0]
    refused(save("\n".join(lines)), "line 41", "found 4 columns")


def test_the_last_row_above_a_header_is_no_part_of_a_gap(save):
    """A bad row is refused, not left out with the header below it."""
    bad = ROWS.removesuffix(STEPS[-1] + "\n") + "OL" + STEPS[-1].removeprefix(repr(float(TIME[-1]))) + "\n"
    refused(save(HEADER + bad + HEADER + ROWS), "line 25", "'time_s'", "'OL'")
    refused(save(HEADER + ROWS + "0.1,5\n" + HEADER + ROWS), "line 26", "found 2 columns")


def test_each_table_has_the_metadata_above_it(save):
    first, second = read_logs(
        save("# temperature_degC: 24\n" + HEADER + ROWS + "# temperature_degC: 60\n" + HEADER + ROWS)
    )
    assert (first.temperature[0], second.temperature[0]) == (24.0, 60.0)
    bare, stated = read_logs(
        save(HEADER + ROWS + "# temperature_degC: 60\n# sampling: settled\n" + HEADER + ROWS)
    )
    assert (bare.temperature, bare.sampling, stated.temperature[0], stated.sampling) == (
        None,
        None,
        60.0,
        "settled",
    )
    refused(save(HEADER + ROWS + "# kind: odd\n" + HEADER + ROWS), "'odd'")


def test_a_header_again_in_other_units_is_refused(save):
    text = "time,wd,wq\ns,um,um\n0,1,2\n1,2,3\ntime,wd,wq\nms,um,um\n0,1,2\n1,2,3\n"
    refused(save(text), "line 6", "other units", "file of its own")


def test_a_column_log_tells_experiments_apart_where_the_header_stands_again(save):
    text = HEADER.replace("time_s", "log,time_s")
    first, second = ("".join(f"{of},{row}\n" for row in STEPS) for of in "ab")
    logs = read_logs(save(text + first + text + second))
    assert [log.name for log in logs] == ["log.csv[a]", "log.csv[b]"]
    refused(save(text + first + "# temperature_degC: 3\n" + text + second), "lines 26 to 27", "metadata")


def test_another_table_below_is_named(save):
    """Of a network analyser that writes trace after trace."""
    text = "BEGIN\nfrequency_Hz,w_um\n1,2\n2,3\n3,4\nEND\nBEGIN\nfrequency_Hz,phase_deg\n1,2\n2,3\n3,4\nEND\n"
    refused(save(text), "line 6", "another table begins in line 8", "file of its own")


def test_comments_below_the_last_row_are_left_out_and_noted(save):
    (log,) = read_logs(save(HEADER + ROWS + "\n# end of measurement\n# 24 points\n"))
    check_step(log)
    assert (
        "lines 27, 28: comments among or below the rows, left out: # end of measurement, # 24 points"
        in log.notes
    )


@pytest.mark.parametrize(
    "footer", ["; end of log", "END", "stopped by hand; all good;", "recorder 3: done\r\n\r\n-- eof"]
)
@pytest.mark.parametrize("block", [64, 1 << 24])
def test_words_below_the_last_row_are_left_out_and_noted(save, monkeypatch, footer, block):
    """What no recorder leaves of a row that it was writing: words, no number, and of another width."""
    monkeypatch.setattr(csvbody, "BLOCK", block)
    text = (HEADER + ROWS).replace(",", ";")
    for below in (footer, footer + "\n", footer + "\n;;;\n"):
        (log,) = read_logs(save(text + below))
        check_step(log)
        (note,) = [said for said in log.notes if "left out" in said]
        assert note.startswith("line") and " 26" in note and footer.splitlines()[-1] in note, note
    refused(save(text + footer + "\n" + ROWS.replace(",", ";")), "line 26", "columns")
    for part in ("0.5", "0.5;1", "nan", "0.5;x"):  # of a row
        refused(save(text + part), "line 26", "still being written")


@pytest.mark.parametrize("mark", "#%")
@pytest.mark.parametrize("block", [64, 1 << 24])
def test_comments_among_the_rows_are_left_out_and_noted(save, monkeypatch, mark, block):
    """As a note that the operator typed; lines are counted with them, and what holds of rows is refused."""
    monkeypatch.setattr(csvbody, "BLOCK", block)
    rows = ROWS.splitlines(keepends=True)
    above = "% of a lock-in\n" if mark == "%" else ""
    remark = f"{mark} paused, for 10,5 min\r\n"
    text = above + HEADER + "".join([*rows[:7], remark, *rows[7:12], remark, *rows[12:]])
    (log,) = read_logs(save(text))
    check_step(log)
    first = 9 + bool(above)
    assert f"lines {first}, {first + 6}: comments among or below the rows, left out" in " ".join(log.notes)
    refused(save(text + "x" + rows[-1]), f"line {len(text.splitlines()) + 1}")
    stated = text.replace("paused, for", "temperature_degC: 31")
    refused(save(stated), f"line {first}", "metadata 'temperature_degC' among the rows")


# Comment marks, numbers, encodings


@pytest.mark.parametrize("mark", ["%", "!"])
def test_comments_of_lock_ins_and_analysers(save, mark):
    (log,) = read_logs(save(f"{mark} Moku:Go Lock-in\n{mark} temperature_degC: 24\n{mark} {HEADER}{ROWS}"))
    check_step(log)
    assert log.temperature[0] == 24.0
    check_step(read_logs(save(f"{mark} Moku:Go Lock-in\n{HEADER}{ROWS}"))[0])


def test_a_touchstone_s_rows_have_no_header(save):
    error = refused(
        save("! Date: today\n# Hz S RI R 50\n1000 0.5 0.25\n2000 0.25 0.5\n"), "3 columns without a header"
    )
    assert "1000, 0.5, 0.25" in error.mapping


GROUPS = {
    "32,290.5": (",", ".", '"'), "32'290.5": (",", ".", ""), "32\u2019290.5": (",", ".", ""), "32.290,5": (";", ",", ""),
    "32\u00a0290,5": (";", ",", ""), "32\u202f290,5": (";", ",", ""), "3.22905D+04": (",", ".", ""), "32290,5": (",", ",", '"'),
}  # fmt: skip


@pytest.mark.parametrize("cell", GROUPS)
def test_thousands_that_can_be_nothing_else(save, cell):
    delimiter, decimal, quote = GROUPS[cell]
    rows = [[value.replace(".", decimal) for value in row.split(",")] for row in STEPS]
    cells = [[f"{quote}{cell if k == 2 else value}{quote}" for k, value in enumerate(row)] for row in rows]
    text = HEADER.replace(",", delimiter) + "".join(delimiter.join(row) + "\n" for row in cells)
    check_step(read_logs(save(text))[0])
    if "\u00a0" in cell:  # as a spreadsheet of Windows writes it
        check_step(read_logs(save(text.encode("cp1252"), "windows.csv"))[0])


@pytest.mark.parametrize("cell", ['"32,290"', '"0,290.5"', "32 290", '"3,22,90.5"', '"1,5"'])
def test_thousands_that_may_be_something_else_are_refused(save, cell):
    refused(save(HEADER + ROWS.replace("32290.5", cell, 1)), "line 2", "'frequency_Hz'")


def test_thousands_of_thousands():
    assert to_number("1,234,567") == 1234567
    assert math.isnan(to_number("32,290")) and math.isnan(to_number("32.290", ","))


def test_a_printed_minus(save):
    check_step(read_logs(save(HEADER + ROWS.replace("-", "\N{MINUS SIGN}")))[0])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_utf_16(save, encoding):
    text = ("" if encoding == "utf-16" else "\ufeff") + (HEADER + ROWS).replace(",", "\t")
    check_step(read_logs(save(text.encode(encoding)))[0])


def test_a_refusal_counts_the_rows_like_it(save):
    rows = ["nan,1" if k in (3, 4, 7) else f"{k},1" for k in range(9)]
    refused(
        save("w_um,time_s\n" + "\n".join(rows)), "line 5", "the 3 rows", "rows = [[0, 3], [5, 7], [8, 9]]"
    )
    refused(save("w_um,time_s\n" + "x,1\n" * 5), "none of the 5 rows")


@pytest.mark.parametrize("cell", ["9.91E+37", "9.9E37", "-9.9E+37", "9.90000031e+37"])
@pytest.mark.parametrize("column", [0, 1, 3])
def test_what_scpi_writes_for_no_number_is_none(save, cell, column):
    rows = [row.split(",") for row in STEPS]
    for row in rows[7:9]:
        row[column] = cell
    text = HEADER + "".join(",".join(row) + "\n" for row in rows)
    named = HEADER.strip().split(",")[column]
    refused(
        save(text),
        "line 9",
        named,
        f"found '{cell}'",
        "no number",
        "a finite number",
        "rows = [[0, 7], [9, 24]]",
    )
    kept_out = text.replace(named, "other_V") if column == 1 else text
    if column == 1:  # what is not used is no error, as with nan
        assert read_logs(save(kept_out))[0].drive is None
    decimal = text.replace(",", ";").replace(".", ",")
    refused(save(decimal), "line 9", cell.replace(".", ","), "no number")


def test_metadata_that_is_no_number(save):
    refused(
        save("# temperature_degC: 9.91E+37\n" + HEADER + ROWS),
        "'temperature_degC'",
        "9.91E+37",
        "a finite number",
    )


def test_the_largest_number_that_is_one_is_fitted_in_silence(save):
    """A warning is an error here: of a value that overflows where its powers are looked at numpy says
    nothing."""
    rows = [row.split(",") for row in STEPS]
    rows[12][3] = "9.8e37"
    (log,) = read_logs(save(HEADER + "".join(",".join(row) + "\n" for row in rows)))
    assert fit([log]).result is not Result.successful


@pytest.mark.parametrize(
    ("above", "delimiter", "decimal"),
    [
        ("TIME,VOLTAGE,FREQUENCY,WD,WQ\nms,V,kHz,nm,nm", ",", "."),
        ("TIME;VOLTAGE;FREQUENCY;WD;WQ\n[ms];[V];[kHz];[nm];[nm]", ";", ","),
        ("TIME\tDRIVE\tFREQ\tW_D\tW_Q\nms\tV\tkHz\tnm\tnm", "\t", "."),
        ("TIME;U;FREQ;WD;WQ\nms;V;KHZ;NM;NM", ";", ","),
        ("time [ms];U [V];freq [kHz];wd [nm];wq [nm]", ";", ","),
    ],
)
def test_names_in_capitals_and_units_below_them(save, above, delimiter, decimal):
    rows = [[0.0, 0.0, 32.25, 0.0, 1.5], [0.5, 50.0, 32.25, 20.0, -2.5]]
    text = "".join(delimiter.join(f"{x}".replace(".", decimal) for x in row) + "\n" for row in rows)
    (log,) = read_logs(save(f"{above}\n{text}"))
    assert log.time.tolist() == [0.0, 0.0005] and log.drive.tolist() == [0.0, 50.0]
    assert log.frequency.tolist() == [32250.0] * 2 and log.response.tolist() == [1.5j, 20 - 2.5j]
    assert (log.drive_unit, log.response_unit) == ("V", "nm")


@pytest.mark.parametrize("head", ["Date time", "Date & Time", "Date and time (UTC)", "Datum Zeit"])
def test_a_date_and_a_time_in_one_column_are_a_time(save, head):
    rows = "".join(f"2024-03-31 12:00:0{k};{k};1\n" for k in range(4))
    (log,) = read_logs(save(f"{head};Spannung [V];w [um]\n" + rows))
    assert log.time.tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_time_of_day_goes_before_a_date_beside_it(save):
    rows = "".join(f"2024-03-31;12:00:0{k};{k};1\n" for k in range(4))
    (log,) = read_logs(save("Datum;Uhrzeit;Spannung [V];w [um]\n" + rows))
    assert log.time.tolist() == [0.0, 1.0, 2.0, 3.0] and log.drive.tolist() == [0.0, 1.0, 2.0, 3.0]


# Drafts


def draft(save, text):
    return draft_of(save(text)).splitlines()


@pytest.mark.parametrize(
    ("header", "lines"),
    [
        ("Frequency (Hz),Channel 1 Magnitude (dB),Channel 2 Magnitude (dB),Channel 2 Phase (Deg)", [
            'magnitude = { column = "Channel 2 Magnitude (dB)", unit = "dB" }',
            'phase = { column = "Channel 2 Phase (Deg)", unit = "deg" }',
        ]),
        ("freq[Hz],re:Trc1_S21,im:Trc1_S21", [
            'x = { column = "re:Trc1_S21", unit = "1" }  # as it is written by Rohde & Schwarz\' network analysers',
            'y = { column = "im:Trc1_S21", unit = "1" }  # as it is written by Rohde & Schwarz\' network analysers',
        ]),
        ("freq[Hz],db:Trc1_S21,ang:Trc1_S21", ['magnitude = { column = "db:Trc1_S21", unit = "dB" }']),
        ("Frequency[Hz],Gain[dB],Phase[deg]", ['magnitude = { column = "Gain[dB]", unit = "dB" }']),
        ("Frequency (Hz),Trace 1: Gain: Real,Trace 1: Gain: Imaginary,Trace 2: Gain: Phase (°)", [
            'x = { column = "Trace 1: Gain: Real", unit = "1" }  # as it is written by the Bode 100',
            'y = { column = "Trace 1: Gain: Imaginary", unit = "1" }  # as it is written by the Bode 100',
        ]),
        ("X_Value,Lockin X,Lockin Y", ['time = { column = "X_Value", unit = "?" }', 'x = { column = "Lockin X", unit = "?" }']),
        ("% Time (s),Input A - X (V),Input B - Y (V)", [
            'time = { column = "Time (s)", unit = "s" }', 'x = { column = "Input A - X (V)", unit = "V" }',
        ]),
        ("chunk,timestamp,frequency,x,y", ['split_by = "chunk"  # each of its values is one experiment']),
        ("Temps (s),Tension (V),Fréquence (Hz),R,Phase", [
            'time = { column = "Temps (s)", unit = "s" }', 'voltage = { column = "Tension (V)", unit = "V" }',
            'frequency = { column = "Fréquence (Hz)", unit = "Hz" }',
        ]),
        ("Seconds [s],CH1 [V],CH2 [V]", ['time = { column = "Seconds [s]", unit = "s" }']),
    ],
)  # fmt: skip
def test_a_draft_knows_the_columns_of(save, header, lines):
    cells = len(header.split(","))
    rows = "".join(",".join(f"{k + 1}" for _ in range(cells)) + "\n" for k in range(3))
    text = draft(save, header + "\n" + rows)
    assert not set(lines) - set(text), text


def test_a_network_analyser_s_export_reads_once_its_draft_is_filled_in(save):
    magnitude, phase = 20 * np.log10(np.abs(SIGNAL)), np.degrees(np.angle(SIGNAL))
    columns = np.transpose([FREQUENCY, 0 * magnitude, magnitude, phase]).tolist()
    header = "Frequency (Hz),Channel 1 Magnitude (dB),Channel 2 Magnitude (dB),Channel 2 Phase (deg)\n"
    path = save("#Digilent WaveForms Network Analyzer - Bode\n#Start: 31900 Hz\n\n" + header
                + "".join(",".join(map(repr, row)) + "\n" for row in columns))  # fmt: skip
    text = draft_of(path)
    for key, value in (("amplitude", '"peak"'), ("quantity", '"displacement"'), ("phase_sign", "1")):
        text = text.replace(f'{key} = "?"', f"{key} = {value}")
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 1j * SIGNAL, rtol=1e-13)  # some roundings of dB and degrees


@pytest.mark.parametrize("table", [ROWS.replace("\n", "\r\r\n"), ROWS + "\0" * 700], ids=["returns", "zeros"])
def test_what_loggers_leave_at_the_ends_of_lines_and_files(tmp_path, table):
    """A text file of Windows, written again as text; a file that was laid out beforehand on a card."""
    path = tmp_path / "log.csv"
    head = HEADER.replace("\n", "\r\r\n") if "\r" in table else HEADER
    path.write_bytes((head + table).encode())
    check_step(read_logs([path])[0])
    path.write_bytes((head + table.replace("0.0002", "0.0\x00002", 1)).encode())
    with pytest.raises(ValueError, match=r"log\.csv, line 4, column 'time_s'"):
        read_logs([path])


def test_cells_that_say_what_their_amplitude_is(tmp_path):
    rows = [f'"{f / 1e3:.3f} kHz","50 Vrms","{1e3 * d:.6g} nm","{q:.6g} um"' for f, d, q in
            zip(FREQUENCY, SIGNAL.real, SIGNAL.imag, strict=True)]  # fmt: skip
    path = tmp_path / "log.csv"
    path.write_text("frequency,drive,wd,wq\n" + "\n".join(rows) + "\n")
    (log,) = read_logs([path])
    np.testing.assert_allclose(log.drive, 50 * math.sqrt(2))
    np.testing.assert_allclose(log.response, 1e3 * SIGNAL, rtol=1e-5, atol=1e-9)
    assert log.drive_unit == "V" and log.response_unit == "nm"
