"""Reading and writing logs: the contract's header, every way a bench file can be odd, and what each refusal
says."""

import gzip
import hashlib
import math
import re
import tomllib
import unicodedata

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from refusal import draft_of, refused

from sysid import fit
from sysid.logs.log import Log, LogError
from sysid.logs.read import read_logs
from sysid.logs.written import write_log
from sysid.tables import csvbody, units

HEADER = "time_s,voltage_V,frequency_Hz,wd_um,wq_um\n"
ROWS = "0.0,5.0,32300.0,0.0,0.0\n0.1,5.0,32300.0,0.25,-0.5\n0.2,4.0,32300.0,0.5,-0.25\n"


def read_one(path, **options):
    (log,) = read_logs([path], **options)
    return log


def check_usual(log):
    assert log.time.tolist() == [0.0, 0.1, 0.2]
    assert log.drive.tolist() == [5.0, 5.0, 4.0]
    assert log.frequency.tolist() == [32300.0] * 3
    assert log.response.tolist() == [0j, 0.25 - 0.5j, 0.5 - 0.25j]
    assert (log.drive_unit, log.response_unit, log.kind) == ("V", "um", "transient")


# The contract's file


def test_the_contract_file(save):
    content = (
        "# plate: A7\n# temperature_degC: 24.0\n# sampling: settled\n# lockin_tau_us: 300\n" + HEADER + ROWS
    )
    path = save(content)
    log = read_one(path)
    check_usual(log)
    assert log.temperature.tolist() == [24.0] * 3
    assert log.sampling == "settled"
    assert log.bench == {"lockin_tau_s": 0.0003}
    assert log.metadata == {
        "plate": "A7",
        "temperature_degC": "24.0",
        "sampling": "settled",
        "lockin_tau_us": "300",
    }
    assert (log.name, log.path) == ("log.csv", str(path))
    assert log.sha256 == hashlib.sha256(content.encode()).hexdigest()
    assert log.notes == ()
    assert len(log) == 3
    assert not log.amplitude_only


def test_every_input_may_be_metadata_and_any_unit(save):
    metadata = (
        "# time: 12:31\n# frequency_kHz: 32.25\n# Temperature [K]: 297.15\n# voltage_mV: 500\n# force_mN:"
        " 250\n"
    )
    log = read_one(save(metadata + "time_ms,w_nm\n0,1\n12.5,2\n"))
    assert log.time.tolist() == [0.0, 0.0125]
    assert log.frequency.tolist() == [32250.0] * 2
    assert log.temperature.tolist() == pytest.approx([24.0] * 2, abs=1e-12)  # 297.15 - 273.15 is rounded
    assert (log.drive.tolist(), log.drive_unit) == ([500.0] * 2, "mV")
    assert log.force.tolist() == [0.25] * 2
    assert (log.response.tolist(), log.response_unit) == ([1.0, 2.0], "nm")
    assert log.amplitude_only
    assert log.response.dtype == np.float64
    assert log.notes == ("metadata 'time' has no unit and is kept out; write it as in temperature_degC",)


def test_rms_and_peak_to_peak_become_peak(save):
    log = read_one(save("time_s,voltage_V_rms,w_um_pp\n0,1,3\n1,2,4\n"))
    assert log.drive.tolist() == [math.sqrt(2), 2 * math.sqrt(2)]
    assert log.response.tolist() == [1.5, 2.0]
    log = read_one(save("frequency_Hz,wd_um_rms,wq_nm_pp\n1,1,3000\n2,2,4000\n", "second.csv"))
    assert log.response.tolist() == [math.sqrt(2) + 1.5j, 2 * math.sqrt(2) + 2j]


def test_duty_with_and_without_volts(save):
    log = read_one(save("# volts_per_duty: 24\ntime_s,duty,w_um\n0,0.25,0\n1,0.5,1\n"))
    assert (log.drive.tolist(), log.drive_unit) == ([6.0, 12.0], "V")
    log = read_one(save("time_s,duty [%],w_um\n0,25,0\n1,50,1\n", "second.csv"))
    assert (log.drive.tolist(), log.drive_unit) == ([0.25, 0.5], "duty")


def test_a_drive_in_another_unit(save):
    log = read_one(save("time_s,drive_mA,w_m/s\n0,1,0\n1,2,1\n"))
    assert (log.drive_unit, log.response_unit) == ("mA", "m/s")


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        ("frequency_Hz,w_um\n1,1\n2,1\n", "steady"),
        ("time_s,frequency_Hz,w_um\n0,1,1\n1,2,1\n2,1,1\n", None),
        ("time_s,frequency_Hz,w_um\n0,1,1\n1,2,1\n2,2,1\n", "transient"),
        ("time_s,frequency_Hz,w_um\n0,1,1\n", "transient"),
        ("# kind: steady\ntime_s,frequency_Hz,w_um\n0,1,1\n1,2,1\n", "steady"),
        ("# Kind: Transient\ntime_s,frequency_Hz,w_um\n0,1,1\n1,2,1\n", "transient"),
    ],
)
def test_kind(save, content, kind):
    assert read_one(save(content)).kind == kind


def test_a_column_log_splits_the_file(save):
    log_a, log_b = read_logs(save("Log,frequency_Hz,w_um\nhot,1,1\ncold,1,2\nhot,2,3\n", "sweeps.csv"))
    assert (log_a.name, log_b.name) == ("sweeps.csv[hot]", "sweeps.csv[cold]")
    assert (log_a.response.tolist(), log_b.response.tolist()) == ([1.0, 3.0], [2.0])
    first, second = read_logs(save("log,time_s,w_um\n24.0,5,1\n24.0,6,2\n25.5,0,3\n", "steps.csv"))
    assert (first.name, second.name) == ("steps.csv[24.0]", "steps.csv[25.5]")
    assert second.time.tolist() == [0.0]  # time begins anew in each part


def repeats(count, rows=4, **more):
    """So many runs of one ramp below one another, each with time from -1, and columns that may tell them
    apart."""
    lines = [",".join([*more, "time_s,voltage_V,w_um"])]
    for run in range(count):
        for row in range(rows):
            cells = [of(run, row) for of in more.values()]
            lines.append(",".join(map(str, [*cells, row - 1, 5, 10 * run + row])))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("rows", [4, 70])  # within the first rows that are looked at, and beyond
@pytest.mark.parametrize("name", ["repeat", "Bias (mA)", "frequency_Hz"])
def test_a_column_that_changes_where_time_begins_anew_tells_logs_apart(save, name, rows):
    columns = {"n": lambda run, row: row, "same": lambda run, row: 7, name: lambda run, row: 3 - run}
    logs = read_logs(save(repeats(3, rows, **columns)))
    assert [log.name for log in logs] == [f"log.csv[{k}]" for k in (3, 2, 1)]
    for run, log in enumerate(logs):
        assert log.time.tolist() == [row - 1 for row in range(rows)]
        assert log.response.tolist() == [10 * run + row for row in range(rows)]
        assert "frequency" not in name or log.frequency.tolist() == [3.0 - run] * rows
        assert f"column {name} tells 3 logs apart: the time begins anew where it changes" in log.notes
        assert f"column {name} is kept out of the fit" not in log.notes


@pytest.mark.parametrize(
    "columns",
    [
        {"cycle": lambda run, row: 2 * run + row // 2},  # changes where the time goes on as well
        {"cycle": lambda run, row: run % 2},  # two runs of one value
        {"cycle": lambda run, row: 7},
    ],
)
def test_a_column_that_may_tell_logs_apart_is_named(save, columns):
    columns |= {"n": lambda run, row: 4 * run + row}  # which numbers the rows
    error = str(refused(save(repeats(3, **columns)), "line 6", "'time_s'", "'-1'", "a column `log`"))
    assert 'split_by = "cycle"' in error and '"n"' not in error


@pytest.mark.parametrize("columns", [{}, {"n": lambda run, row: 4 * run + row}])
def test_a_time_that_begins_again_at_the_same_tells_logs_apart(save, columns):
    """A clock that was started anew with its record; one that only goes back is another's, or was set."""
    logs = read_logs(save(repeats(3, **columns)))
    assert [log.name for log in logs] == ["log.csv[1]", "log.csv[2]", "log.csv[3]"]
    for run, log in enumerate(logs):
        assert log.time.tolist() == [-1.0, 0.0, 1.0, 2.0]
        assert log.response.tolist() == [10 * run + row for row in range(4)]
        assert "its time begins anew 2 times: read as 3 logs" in log.notes
    later = repeats(1, 10).splitlines() + [f"{time},5,{time}" for time in range(2, 9)]  # which began at 2 s
    refused(save("\n".join(later) + "\n"), "line 12", "not below the one before")


def newest_first(save, text, name):
    header, *rows = text.splitlines()
    return save("\n".join([header, *reversed(rows)]) + "\n", name)


def test_rows_that_stand_newest_first_are_turned(save):
    """As the same file in the order of time, also where a cell is empty or rows are of two experiments."""
    rows = [f"{k / 10},{5 * (k > 4)},{k if k != 3 else ''},{k * k}" for k in range(30)]
    text = "time_s,voltage_V,wd_um,wq_um\n" + "\n".join(rows) + "\n"
    plain, turned = read_one(save(text)), read_one(newest_first(save, text, "turned.csv"))
    for name in ("time", "drive", "response"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(plain, name))
    assert "its rows stand newest first: read in the order of their times" in turned.notes
    assert "line 5" in " ".join(plain.notes) and "line 28" in " ".join(turned.notes)  # the empty cell
    several = newest_first(save, repeats(2, log=lambda run, row: run), "two.csv")
    assert [log.time.tolist() for log in read_logs(several)] == [[-1.0, 0.0, 1.0, 2.0]] * 2
    refused(newest_first(save, text.replace("\n0.7,5,7", "\n0.6,5,7"), "odd.csv"), "not below the one before")
    refused(
        newest_first(save, text.replace("0,,9", "0,3,9").replace(",7,49", ",x,49"), "word.csv"),
        "line 24",
        "'x'",
    )


def test_the_named_line_tells_them_apart(save):
    """Also where the time of a run goes on from that of the one before, in which nothing goes back."""
    path, columns = save(repeats(2, cycle=lambda run, row: 2 * run + row // 2)), 'split_by = "cycle"\n'
    refused(path, columns.strip())
    logs = read_logs(path, columns=save(columns, "map.toml"))
    assert [log.time.tolist() for log in logs] == [[-1.0, 0.0], [1.0, 2.0]] * 2


def test_a_clock_that_is_set_back_amid_a_step_begins_no_log(save):
    rows = "".join(f"{row - (row > 4)},{5 * (row > 4)},{row}\n" for row in range(10))
    refused(
        save("time_s,voltage_V,w_um\n0,0,0\n" + rows.replace("4,5,5", "3,5,5")), "not below the one before"
    )


def test_one_log_stays_one(save):
    log = read_one(save(repeats(1, repeat=lambda run, row: row // 2)))
    assert log.name == "log.csv" and log.notes == ("column repeat is kept out of the fit",)


@pytest.mark.parametrize("unit, first", [("°F", -155 / 9), ("°C", 1.0), ("K", -272.15)])
def test_a_temperature_in_french_has_any_unit_of_its_kind(save, unit, first):
    log = read_one(save(f"frequency_Hz,w_um,Température ({unit})\n1,1,1\n2,1,2\n"))
    assert log.temperature[0] == pytest.approx(first)


@pytest.mark.parametrize(
    ("header", "name", "values"),
    [
        ("freq_kHz,w_um", "frequency", [1000.0, 2000.0]),
        ("timestamp_ms,w_um", "time", [1e-3, 2e-3]),
        ("T [s],w_um", "time", [1.0, 2.0]),
        ("U (V) pp,w_um", "drive", [0.5, 1.0]),
        ("Zeit in ms,w_um", "time", [1e-3, 2e-3]),
        ("Fréquence [kHz],w_um", "frequency", [1000.0, 2000.0]),
    ],
)
def test_inputs_by_other_usual_names_are_read_and_noted(save, header, name, values):
    log = read_one(
        save(
            f"# temp_degC: 25\n{header}\n1,1\n2,1\n"
            if name != "drive"
            else f"{header},freq_Hz\n1,1,5\n2,1,5\n"
        )
    )
    assert getattr(log, name).tolist() == pytest.approx(values)
    assert f"column {header.split(',')[0]} is read as {'voltage' if name == 'drive' else name}" in log.notes
    if name != "drive":
        assert (
            log.temperature.tolist() == [25.0, 25.0]
            and "metadata 'temp_degC' is read as temperature" in log.notes
        )


LANGUAGES = (
    "Zeit [ms];Spannung [V];Frequenz [kHz];Temperatur [°C]",
    "Temps (ms);Tension (V);Fréquence (kHz);Température (°C)",
    "TEMPS_ms;TENSION_V;FREQUENCE_kHz;TEMPERATURE_C",
    "Tiempo (ms);Tensión (V);Frecuencia (kHz);Temperatura (°C)",
    "tiempo_ms;voltaje_V;frecuencia_kHz;temperatura_degC",
    "Tempo [ms];Tensione [V];Frequenza [kHz];Temperatura [°C]",
    "Время, мс;Напряжение, В;Частота, кГц;Температура, °C",
)


@pytest.mark.parametrize("form", ["NFC", "NFD"])  # an accent of its own, as some systems write it
@pytest.mark.parametrize("header", LANGUAGES)
def test_inputs_are_known_in_other_languages(save, header, form):
    log = read_one(
        save(unicodedata.normalize(form, header) + ";wd_um;wq_um\n0;0;32,25;24,5;0;1\n100;5;32,25;24,5;2;1\n")
    )
    assert log.time.tolist() == [0.0, 0.1] and log.drive.tolist() == [0.0, 5.0] and log.drive_unit == "V"
    assert log.frequency.tolist() == [32250.0] * 2 and log.temperature.tolist() == [24.5] * 2
    assert len(log.notes) >= 2 and all("is read as" in note for note in log.notes)


def test_volts_of_another_name_may_be_the_drive_of_a_log_without_one(save):
    said = "column Amp out [V] is kept out of the fit"
    kinds = "voltage_V, voltage_V_rms or voltage_V_pp (its peak, rms, or from peak to peak)"
    way = f"; if it is the drive, call it {kinds}"
    rows = "time_s,Amp out [V],{}\n0,3,1\n1,4,2\n"
    assert read_one(save(rows.format("w_um"))).notes == (said + way,)
    assert read_one(save(rows.format("w_V"))).notes == (said,)
    assert read_one(save("# voltage_V: 3\n" + rows.format("w_um"))).notes == (said,)


def test_a_tension_in_newton_is_no_drive(save):
    log = read_one(save("time_s,Tension (N),w_um\n0,3,1\n1,4,2\n"))
    assert log.drive is None and log.notes == ("column Tension (N) is kept out of the fit",)


def test_another_name_gives_way_to_ours_and_to_a_unit_of_another_kind(save):
    log = read_one(save("t_s,time_s,w_um,duty,u_V,temp_V\n9,0,1,0.1,5,24\n9,1,2,0.1,5,24\n"))
    assert log.time.tolist() == [0.0, 1.0] and log.drive.tolist() == [0.1, 0.1] and log.temperature is None
    assert log.notes == tuple(f"column {name} is kept out of the fit" for name in ("t_s", "u_V", "temp_V"))


def test_other_columns_are_noted_and_never_read(save):
    log = read_one(save("time_s,note,w_um,wd_err_um\n0,start,1,\n1,a;b,2,nan\n"))
    assert log.notes == ("column note is kept out of the fit", "column wd_err_um is kept out of the fit")
    assert log.response.tolist() == [1.0, 2.0]


# Ways to write it


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(("\ufeff" + HEADER + ROWS).encode(), id="byte order mark"),
        pytest.param((HEADER + ROWS).replace("\n", "\r\n").encode(), id="CR LF"),
        pytest.param((HEADER + ROWS + "\n\n\r\n").encode(), id="blank lines at the end"),
        pytest.param((HEADER + "\n" + ROWS.replace("\n", "\n\n")).encode(), id="blank lines between"),
        pytest.param((HEADER + ROWS).rstrip("\n").encode(), id="no line end at the end"),
        pytest.param(
            ('"time_s", "voltage_V" ,"frequency_Hz" , wd_um,wq_um\n' + ROWS).encode(), id="quotes and blanks"
        ),
        pytest.param((HEADER + ROWS.replace(",", " , ")).encode(), id="blanks around numbers"),
        pytest.param(
            (HEADER + ROWS.replace("0.5", '"0.5"').replace('-"0.5"', "-0.5")).encode(), id="quoted numbers"
        ),
        pytest.param((HEADER + ROWS).replace("\n", ",\n").encode(), id="empty column at the end"),
        pytest.param((HEADER + ROWS.replace("\n", ",\n")).encode(), id="empty column at the end of rows"),
        pytest.param(
            (HEADER + ROWS.replace("\n", ",\r\n")).encode(), id="empty column at the end of rows, CR LF"
        ),
        pytest.param(
            (HEADER + ROWS.replace("\n", ",, \n")).encode(), id="two empty columns at the end of rows"
        ),
        pytest.param(gzip.compress((HEADER + ROWS).encode(), mtime=0), id="gzip"),
        pytest.param((HEADER + ROWS).replace(",", ";").encode(), id="semicolons"),
        pytest.param((HEADER + ROWS).replace(",", ";").replace(".", ",").encode(), id="decimal commas"),
        pytest.param((HEADER + ROWS).replace(",", "\t").encode(), id="tabs"),
        pytest.param((HEADER + ROWS).replace(",", "  ").encode(), id="runs of blanks"),
        pytest.param(("# " + HEADER + ROWS).encode(), id="header in a comment, as numpy writes it"),
        pytest.param(("# " + HEADER + ROWS).replace(",", " ").encode(), id="the same with blanks"),
        pytest.param(("time,voltage,frequency,wd,wq\ns,V,Hz,um,um\n" + ROWS).encode(), id="row of units"),
        pytest.param(("# by Zoë, 24 °C\n" + HEADER + ROWS).encode("cp1252"), id="Windows-1252"),
    ],
)
def test_spellings_of_one_table(save, content):
    check_usual(read_one(save(content)))


@settings(max_examples=80, deadline=None)
@given(arrays.arrays(np.float64, st.integers(1, 20), elements=st.floats(-9.8e37, 9.8e37)))
def test_numbers_are_read_to_the_last_bit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("bits") / "log.csv"
    path.write_text("frequency_Hz,w_um\n" + "".join(f"1,{value!r}\n" for value in values.tolist()))
    assert read_one(path).response.tobytes() == values.tobytes()


def test_blocks_and_their_lines(save, monkeypatch):
    """Small blocks change nothing, and lines are still counted right."""
    monkeypatch.setattr(csvbody, "BLOCK", 37)
    rows = "".join(f"{k},{k * k}\n" + ("\n" if k % 7 == 0 else "") for k in range(300))
    log = read_one(save("time_s,w_um\n" + rows))
    assert log.response.tolist() == [k * k for k in range(300)]
    lines = ("time_s,w_um\n" + rows).replace("\n250,", "\nx,").splitlines()
    refused(save("\n".join(lines)), f"line {lines.index('x,62500') + 1}", "'time_s'", "'x'")
    lines = ("time_s,w_um\n" + rows).replace("\n250,", "\n").splitlines()
    refused(save("\n".join(lines)), f"line {lines.index('62500') + 1}", "found 1 columns", "expected 2")


# Lines above the header that carry no comment mark

SETTINGS = (
    "Model,MSO4034\nFirmware Version,2.93\n\ntemperature_degC: 80\nplate,B2\nSample"
    " Interval,1e-06,\n\nLabel,,\n"
)
BARE = "time,voltage,frequency,wd,wq\n"


@pytest.mark.parametrize(
    ("content", "lines"),
    [
        pytest.param(SETTINGS + HEADER + ROWS, "lines 1 to 8", id="settings"),
        pytest.param(SETTINGS + BARE + "s,V,Hz,um,um\n" + ROWS, "lines 1 to 8", id="row of units"),
        pytest.param(
            SETTINGS + HEADER.strip() + ",Comment,\n" + ROWS, "Comment", id="a name without a column"
        ),
        pytest.param("BEGIN CH1_DATA\n" + HEADER + "\n" + ROWS + "END\n\n", "line 1", id="BEGIN and END"),
        pytest.param("BEGIN\n" + HEADER + ROWS + "END", "line 1", id="END without a line end"),
        pytest.param(
            (SETTINGS + HEADER + ROWS).replace("\n", "\r\n") + ",,,,\r\nEND\r\n", "lines 1 to 8", id="CR LF"
        ),
        pytest.param(
            (SETTINGS + HEADER + ROWS).replace(",", "\t").replace(".", ","),
            "lines 1 to 8",
            id="decimal commas",
        ),
        pytest.param("---\nby hand\n" + (HEADER + ROWS).replace(",", "  "), "lines 1 to 2", id="blanks"),
        pytest.param("sep=;\n" + (HEADER + ROWS).replace(",", ";"), "line 1", id="the word of a spreadsheet"),
        pytest.param(gzip.compress((SETTINGS + HEADER + ROWS).encode(), mtime=0), "lines 1 to 8", id="gzip"),
        pytest.param(
            SETTINGS.encode() + "Messung,größer\n".encode("cp1252") + (HEADER + ROWS).encode(),
            "1 to 9",
            id="cp1252",
        ),
        pytest.param("a,b,c\n" * 190 + HEADER + ROWS, "lines 1 to 190", id="long"),
    ],
)
def test_a_preamble_is_left_out_and_noted(save, monkeypatch, content, lines):
    for block in (csvbody.BLOCK, 37):
        monkeypatch.setattr(csvbody, "BLOCK", block)
        log = read_one(save(content))
        check_usual(log)
        assert lines in " ".join(log.notes)
        assert (log.metadata, log.temperature) == ({}, None)  # what a preamble states changes no fit


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("temperature_degC: 80", "# temperature_degC: 80"),
        ("Temperature,24,°C", "# Temperature: 24 °C"),
        ("Frequency = 32.3 kHz", "# Frequency: 32.3 kHz"),
        ("Sample Interval,1e-06,", ""),
        ("Temperature,24", ""),
    ],
)
def test_it_is_said_how_a_preamble_s_constants_are_read(save, line, said):
    log = read_one(save(f"Model,X\n{line}\n" + HEADER + ROWS))
    how = f"; to have them read, write '{said}'" if said else ""
    assert log.notes == (f"lines 1 to 2, above the header, left out{how}",)


def test_comments_are_metadata_wherever_they_stand_above_the_header(save):
    log = read_one(save("# temperature_degC: 24\nBEGIN\n# force_N: 3\n" + HEADER + ROWS))
    assert (log.temperature.tolist(), log.force.tolist()) == ([24.0] * 3, [3.0] * 3)
    assert log.notes == ("line 2, above the header, left out",)
    below = "Operator,me\n\n# plate: A7\n#sampling: settled\nplate,B2\n\n# delay_us: 3\n"
    for header in (HEADER, BARE + "s,V,Hz,um,um\n"):
        log = read_one(save(below + header + ROWS))
        check_usual(log)
        assert (log.metadata["plate"], log.sampling, log.bench) == ("A7", "settled", {"delay_s": 3e-6})
        assert log.notes == ("lines 1, 5, above the header, left out",)
    log = read_one(save(below.encode() + "# note: größer\n".encode("cp1252") + (HEADER + ROWS).encode()))
    assert log.metadata["note"] == "größer"
    refused(save(below + "# force_N: much\n" + HEADER + ROWS), "metadata 'force_N'", "'much'")


def test_plates_that_are_named_below_a_line_without_a_mark_are_told_apart(save):
    paths = [save(f"Operator,me\n# plate: {plate}\n{HEADER}{ROWS}", f"{plate}.csv") for plate in ("A7", "B2")]
    refused(paths, "'A7'", "'B2'", "expected logs of one plate")


def test_a_row_of_units_below_names_that_are_numbers(save, tmp_path):
    """As an oscilloscope writes its channels."""
    (tmp_path / "map.toml").write_text(
        '[columns]\ntime = "x-axis_second"\nvoltage = "1_Volt"\nw = "2_Volt"\n'
    )
    log = read_one(save("x-axis,1,2\nsecond,Volt,Volt\n0,1,2\n1,3,4\n2,5,6\n"), columns=tmp_path / "map.toml")
    assert (log.time.tolist(), log.drive.tolist(), log.response.tolist()) == ([0, 1, 2], [1, 3, 5], [2, 4, 6])


def test_rows_below_a_preamble_are_as_strict(save):
    text = "BEGIN\n" + HEADER + ROWS
    refused(save(text + "0.3,5,1,x,0\n"), "line 6", "'wd_um'", "'x'")
    refused(save(text + "0.3,5,1,0\n"), "line 6", "found 4 columns", "expected 5")
    refused(save(text + "END\n" + ROWS), "line 6", "found 1 columns")
    refused(save(text + "0.3,5,1,0,0,7\nEND\n"), "line 6", "found 6 columns")
    refused(save(HEADER + ROWS + "END\n" + ROWS), "line 5", "found 1 columns")
    refused(save("a,b,c\n" * 200 + HEADER + ROWS), "no response")


@pytest.mark.parametrize(
    ("above", "words"),
    [
        (HEADER + "0.0,5.0,x,0.0,0.0\n", ["line 2", "'x'"]),
        (HEADER + "OL,OL,OL,OL,OL\n", ["line 2", "'OL'"]),
        (HEADER + "0.0,OL,OL,OL,OL\nOL,OL,OL,OL,OL\n", ["line 3", "'OL'"]),
        (HEADER + "# plate: A7\n", ["line 2", "'plate'"]),
        (HEADER + "s,V,Hz,um,um\n", ["line 2", "'s'"]),
        (HEADER.replace("\n", ",note\n"), ["line 2", "found 5 columns"]),
    ],
)
def test_a_bad_row_is_no_preamble(save, above, words):
    refused(save(above + ROWS), *words)


# Refusals of cells and rows


@pytest.mark.parametrize(
    "cell", ["", "nan", "NaN", "inf", "-inf", "1e999", "abc", "1_000", "0x10", "#", "1,5"]
)
def test_a_bad_cell_is_named(save, cell):
    quoted = f'"{cell}"' if "," in cell else cell
    path = save("# plate: A7\n" + HEADER + ROWS.replace("0.25,-0.5", f"{quoted},-0.5"))
    refused(
        path, path, "line 4", "'wd_um'", repr(cell) if cell else "an empty cell", "expected a finite number"
    )


def test_a_refusal_names_the_way_out(save, tmp_path):
    rows = "".join(f"{k},{k * k}\n" for k in range(9))
    table = ("time_s,w_um\n" + rows).replace("\n5,25\n", "\n\n5,nan\n")
    path = save(table)
    refused(
        path,
        "line 8",
        "leave the row out of the file, or read the others by rows = [[0, 5], [6, 9]] in a mapping file",
    )
    (tmp_path / "map.toml").write_text(
        'rows = [[0, 5], [6, 9]]\namplitude = "peak"\n[columns]\ntime = "time_s"\nw = "w_um"\n'
    )
    assert read_one(path, columns=tmp_path / "map.toml").time.tolist() == [0, 1, 2, 3, 4, 6, 7, 8]
    refused(save(table.replace("nan", "25").replace("8,64", "8,OL")), "rows = [[0, 8]] in")
    refused(save(table.replace("nan", "25").replace("0,0", "0,OL")), "rows = [[1, 9]] in")
    refused(save("time_s,w_um\n0,x\n"), "leave the row out of the file")
    split = save("time_s,w_um,log\n0,1,a\n1,x,a\n")
    assert "rows =" not in str(
        refused(split, "leave the row out of the file")
    )  # which are counted in each experiment
    assert "leave the row" not in str(refused(save("time_s,w_um\n2,1\n1,1\n"), "not below"))


@pytest.mark.parametrize("remark", ["pause", "--- pause ---"])
def test_a_remark_among_the_rows_is_to_be_left_out(save, remark):
    refused(
        save(HEADER + ROWS + remark + "\n" + ROWS),
        "line 5",
        "expected 5 as in the header; leave it out of the file",
    )
    assert "leave it" not in str(refused(save(HEADER + ROWS + "1,2,3,4\n"), "line 5"))


def test_a_row_with_the_wrong_number_of_cells_is_named(save):
    refused(save(HEADER + ROWS.replace("0.1,5.0,", "0.1,")), "line 3", "found 4 columns", "expected 5")
    refused(save(HEADER + ROWS.replace("0.1,5.0,", "0.1,5,5,")), "line 3", "found 6 columns", "expected 5")
    refused(
        save(HEADER + ROWS + "0.3,5.0,32"), "line 5", "found 3 columns", "last line", "still being written"
    )
    refused(
        save(HEADER + ROWS + "0.3,5.0,32300.0,0.1,1e-"), "line 5", "'wq_um'", "'1e-'", "still being written"
    )
    refused(save(HEADER + ROWS + "0.3,5.0,32" + "\x00" * 40), "line 5", "found 3 columns")


def test_decreasing_time_is_named_and_equal_times_are_not(save):
    refused(save("time_s,w_um\n0,1\n\n2,1\n1,1\n"), "line 5", "'time_s'", "'1'", "not below the one before")
    assert read_one(save("time_s,w_um\n0,1\n1,1\n1,1\n")).time.tolist() == [0, 1, 1]


# Units written out


@pytest.mark.parametrize(
    "header",
    [
        "Time (sec),Voltage (Volts),Frequency (Hertz),Wd (micron),Wq (microns)",
        "time_seconds,voltage_Volt,frequency_hertz,wd_Micrometers,wq_micrometres",
        "TIME [Second],VOLTAGE [VOLTS] peak,FREQUENCY [Hertz],WD [MicroMeter],WQ [um]",
        "t (Sec),Volts (Volt),freq_HERTZ,wd_Microns,wq_micron",
    ],
)
def test_units_written_out_are_their_signs(save, header):
    check_usual(read_one(save(header + "\n" + ROWS)))


@pytest.mark.parametrize(
    ("unit", "factor"), [("kilohertz", 1e3), ("Megahertz", 1e6), ("MHz", 1e6), ("mHz", 1e-3)]
)
def test_a_unit_written_out_has_its_prefix(save, unit, factor):
    log = read_one(save(f"# temperature_Kelvin: 273.15\nfrequency_{unit},w_Volts_rms\n2,1\n"))
    assert log.frequency[0] == pytest.approx(2 * factor, rel=1e-15)  # one product
    assert (log.temperature[0], log.response[0], log.response_unit) == (0.0, math.sqrt(2), "V")


# Refusals of headers and metadata


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time_s,time_ms,w_um", ["time twice", "time_s", "time_ms"]),
        ("time_s,w_um,w_um", ["w twice"]),
        ("voltage_V,duty,w_um", ["the drive twice", "voltage_V", "duty"]),
        ("time_s,voltage_V,wd_um", ["found wd", "expected columns such as wd_um and wq_um"]),
        ("time_s,wd_um,w_um", ["w and wd"]),
        ("time_s,w_um,log,log", ["2 columns 'log'"]),
        ("tiem_s,voltage_V,w_um", ["'tiem_s'", "did you mean time_s"]),
        ("freqency_Hz,voltage_V,w_um", ["'freqency_Hz'", "did you mean frequency_Hz"]),
        ("time_s,Frequncy [kHz],w_um", ["did you mean frequency_kHz"]),
        ("time_s,frequency_MHZ,w_um", ["'MHZ'", "did you mean 'MHz'"]),
        ("TIME_MS,W_UM", ["column 'TIME_MS'", "of a million", "did you mean 'ms'"]),
        ("time_s,frequency_s,w_um", ["column 'frequency_s'", "unit of frequency"]),
        ("time,voltage_V,w_um", ["column 'time'", "no unit", "time_s"]),
        ("time_s,voltage_V,w_dB", ["decibels"]),
        ("note,force_N,w_um", ["neither time, frequency nor drive"]),
        ("time_s,voltage_V,velocity", ["no response", "time_s, voltage_V, velocity"]),
        ("drive_V,response_um,note", ["a waveform without time", "sample_rate_Hz"]),
    ],
)
def test_headers_that_are_refused(save, header, words):
    count = header.count(",") + 1
    refused(save(header + "\n" + ",".join("1" * count) + "\n"), *words)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("kind: waveform", ["wd and wq in a waveform", "raw samples alone"]),
        ("kind: stedy", ["metadata 'kind'", "'stedy'", "did you mean 'steady'"]),
        ("sampling: later", ["metadata 'sampling'", "instant or settled"]),
        ("temperature_degC: warm", ["metadata 'temperature_degC'", "'warm'", "finite number"]),
        ("temperature_degC: nan", ["metadata 'temperature_degC'", "'nan'"]),
        ("frequency_MHZ: 3", ["did you mean 'MHz'"]),
        ("voltage_V: 3", ["the drive twice"]),
        ("lockin_tau_V: 3", ["metadata 'lockin_tau_V'", "unit of time"]),
        ("force_N: 1\n# force_N: 2", ["metadata 'force_N'", "twice"]),
    ],
)
def test_metadata_that_is_refused(save, line, words):
    refused(save(f"# {line}\n" + HEADER + ROWS), *words)


@pytest.mark.parametrize("key", ["temperature_Hz", "force_V", "frequency_MHZ", "lockin_tau_V"])
def test_metadata_in_a_unit_of_the_wrong_kind_is_called_metadata(save, key):
    """And no mapping file is offered, which could say nothing of it."""
    error = refused(
        save(f"# {key}: 3\n" + HEADER + ROWS), f"metadata {key!r}: found the unit", "expected a unit of"
    )
    assert "column" not in str(error) and error.mapping is None


# Lines that are nearly metadata


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("samplng: settled", "sampling"), ("smapling: setled", "sampling"), ("sample: settled", "sampling"),
        ("knid: steady", "kind"), ("plat: A7", "plate"), ("Palte: A7", "plate"), ("plate id: A7", "plate"),
        ("plate_no = 7", "plate"),
        ("lockin_tua_s: 0.0001", "lockin_tau_s"), ("lockin_tau: 0.1 ms", "lockin_tau_ms"), ("lockin tau s: 1e-4", "lockin_tau_s"),
        ("Lock-in tau [ms]: 0.1", "lockin_tau_ms"), ("lockin_tau: 0.1", "lockin_tau_s"), ("lockin_oder: 4", "lockin_order"),
        ("delay: 3 us", "delay_us"), ("delay = 3 us", "delay_us"), ("dealy_us: 3", "delay_us"), ("settle: 0.1", "settle_s"),
        ("temperature_std: 0.1", "temperature_std_degC"), ("temperature_std_K: 0.1", "temperature_std_degC"),
        ("volt_per_duty: 24", "volts_per_duty"), ("temperature: 24", "temperature_degC"),
        ("temparature_degC: 24", "temperature_degC"),
        ("Temperatur: 24 °C", "temperature_degC"), ("T_degC: 24", "temperature_degC"), ("T: 24 degC", "temperature_degC"),
        ("temp = 24", "temperature_degC"), ("temperature degC: 24", "temperature_degC"),
        ("temperature_Hz = 24", "temperature_degC"), ("fource_N: 3", "force_N"),
    ],
)  # fmt: skip
def test_a_line_that_is_nearly_metadata_is_a_warning(save, line, expected):
    """And none once it is written as expected."""
    log = read_one(save(f"# {line}\n" + HEADER + ROWS))
    check_usual(log)
    key, value = re.split(" *[:=] *", line)
    assert log.warnings == (f"log.csv: metadata {key!r} is not used; did you mean {expected!r}?",)
    assert (log.notes, log.bench, log.sampling, log.temperature, log.force) == ((), {}, None, None, None)
    right = {"setled": "settled"}.get(value, value if expected in units.WORDS else value.split()[0])
    assert read_one(save(f"# {expected}: {right}\n" + HEADER + ROWS, "right.csv")).warnings == ()


@pytest.mark.parametrize(
    ("line", "name", "value"),
    [
        ("temperature: 297.15 K", "temperature", 24.0), ("Temperature: 24 °C", "temperature", 24.0),
        ("Frequency: 32.3 kHz", "frequency", 32300.0), ("voltage: 5 Vpp", "drive", 2.5),
        ("Force: 300 mN", "force", 0.3),
    ],
)  # fmt: skip
def test_a_unit_may_stand_behind_the_number(save, line, name, value):
    log = read_one(save(f"# {line}\ntime_s,w_um\n0,1\n1,2\n"))
    np.testing.assert_allclose(getattr(log, name), [value, value], rtol=1e-12)
    assert log.warnings == ()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("Frequency: 32300", "frequency_Hz"), ("freq: 32.3 kHz", "frequency_kHz"), ("f_Hz: 32300", "frequency_Hz"),
        ("frequncy_kHz: 32.3", "frequency_kHz"), ("voltage: 5", "voltage_V"),
        ("U_mV: 5", "voltage_mV"), ("voltage_V = 5 volt, at most", None),
    ],
)  # fmt: skip
def test_an_input_that_is_nearly_stated_is_a_warning_where_the_log_lacks_it(save, line, expected):
    said = (
        f"; did you mean {expected!r}?" if expected else ": found '5 volt, at most', expected a finite number"
    )
    key = re.split(" *[:=]", line)[0]
    assert read_one(save(f"# {line}\ntime_s,w_um\n0,1\n")).warnings == (
        f"log.csv: metadata {key!r} is not used{said}",
    )
    assert read_one(save(f"# {line}\n" + HEADER + ROWS)).warnings == ()


@pytest.mark.parametrize(
    "line",
    [
        "attenuator_dB: 20", "drive attenuator: 20 dB", "attenuation: 1:10", "amplifier gain = 20", "probe: 10x", "PROBE: x10",
        "vibrometer: 125 mm/s/V", "sensitivity_mV_per_g: 100", "Sensor: 10 pC/N", "range: 2 V", "scale: 0.5",
        "Verstärkung: 20", "Sensibilité: 5 mV/g", "коэффициент усиления: 20",
    ],
)  # fmt: skip
def test_a_factor_that_is_stated_and_not_applied_is_told_once(save, line):
    """And the lines of the mapping file that are named apply one, and are the last word."""
    path = save(f"# {line}\n" + HEADER + ROWS)
    log = read_one(path)
    check_usual(log)
    key = re.split(" *[:=] *", line)[0]
    assert log.warnings == () and len(log.notes) == 1
    assert log.notes[0].startswith(f"metadata {key!r} is not used: voltage, wd, wq are as their columns say")
    lines = log.notes[0].partition("of the lines ")[2].partition(" says it")[0]
    assert lines == 'find = true, amplitude = "peak", columns.voltage.scale = FACTOR'
    columns = save(lines.replace(", ", "\n").replace("FACTOR", "0.1"), "map.toml")
    scaled = read_one(path, columns=columns)
    assert scaled.drive.tolist() == [0.5, 0.5, 0.4] and scaled.response.tolist() == log.response.tolist()
    assert not any("not used" in note for note in scaled.notes)


@pytest.mark.parametrize(
    "line",
    [
        "gain: 0 dB", "gain: 1", "probe: 1x", "Probe: PT100", "range: 10 kHz", "Frequency range: 800", "time scale: 1 ms",
        "Temperature probe: 3", "Sweep scale: log", "slope: 24 dB/oct", "volts_per_duty: 24", "gain: 1,234.5.6", "Volts/Div: 2",
    ],
)  # fmt: skip
def test_what_is_no_factor_is_no_note(save, line):
    assert read_one(save(f"# {line}\n" + HEADER + ROWS)).notes == ()


PREAMBLES = {
    "network analyser": """
        CSV A.01.01|Keysight Technologies,E5061B,MY49304567,A.03.50|Date: Monday, March 31, 2024 12:00:00
        Source: Standard|Sweep Type: Linear|Start Frequency: 32000|Stop Frequency: 32600|IF Bandwidth: 100|Points: 401
        Power: -10 dBm|Averaging: 16""",
    "oscilloscope": """
        Model: DSOX3024T|Serial Number: MY58100123|Time/Div: 1.0E-3|Trigger Level: 0.5 V|Horizontal Delay: 0.0
        Sample Rate: 1 GSa/s|Volts/Div: 2|Probe: 10|XINC = 1e-06|YUNIT = V|Firmware Version: 2.93|Waveform Type: ANALOG
        Offset: 0""",
    "Zurich Instruments": """
        Device: DEV3456|Demodulator: 1|Time Constant (s): 8.1e-4|Order: 4|Rate: 837.1|Sampling Rate: 13392.86
        Settling: 0.001|Sweep param: oscs/0/freq|Sample Count: 401|TC: 0.0008|harmonic: 1|amplitude: 0.1|phaseshift: 0""",
    "LabVIEW": """
        LabVIEW Measurement|Writer_Version: 2|Decimal_Separator: .|X_Columns: One|Time_Pref: Relative|Operator: me
        Date: 2024/03/31|Time: 12:00:00.123|Channels: 2|Samples: 100|X_Dimension: Time|X0: 0.0|Delta_X: 0.001
        Notes: at 24 degC""",
    "Stanford": """
        SR830 DSP Lock-in|Sensitivity: 10 mV|Sens = 10 mV|Time Constant: 100 ms|Filter slope: 24 dB/oct
        Reference: external|Phase: 0.00|Reserve: normal|Sine out: 1.000 V|Aux 1: 0.24|Frequency: 32300.0|Freq = 32300
        Amplitude: 1.000|Ref phase: 90""",
    "by hand": """
        Place: lab 3|State: ok|Delayed trigger: off|Temperature sensor: PT100|Drivers: NI 21|Force sensor: HBM U9
        fs = 1e6|Mode: transient|Kind regards: me|Plane: xy|Plates: 3|Title = step of 100 V|T = 0.01|V = 3|f = f0 + df
        fit: y = a*x + b|sampling = 10 kHz|Sampling = 10000|time_s = seconds since the start|wd_um = displacement
        voltage_V = drive|x=1:y=2""",
}  # fmt: skip


@pytest.mark.parametrize("name", PREAMBLES)
@pytest.mark.parametrize("above", ["", "Operator,me\n"])
def test_what_instruments_write_is_no_warning(save, name, above):
    lines = [line.strip() for line in re.split(r"[|\n]", PREAMBLES[name].strip())]
    log = read_one(save(above + "".join(f"# {line}\n" for line in lines) + HEADER + ROWS))
    check_usual(log)
    assert (log.warnings, log.bench, log.sampling, log.temperature, log.force) == ((), {}, None, None, None)


def test_an_equals_sign_states_metadata_too(save):
    log = read_one(
        save(
            "#plate = A 7\n#sampling=settled\n#temperature_degC = 24\n#lockin_tau_us=300\n#x = 3\n"
            + HEADER
            + ROWS
        )
    )
    check_usual(log)
    assert log.metadata == {
        "plate": "A 7",
        "sampling": "settled",
        "temperature_degC": "24",
        "lockin_tau_us": "300",
    }
    assert (log.temperature.tolist(), log.bench, log.sampling) == (
        [24.0] * 3,
        {"lockin_tau_s": 0.0003},
        "settled",
    )
    assert log.warnings == log.notes == ()
    refused(save("# plate: A7\n# plate = B2\n" + HEADER + ROWS), "metadata 'plate'", "twice")
    refused(save("# sampling = later\n" + HEADER + ROWS), "metadata 'sampling'", "'later'")
    first, second = read_logs(save(HEADER + ROWS + "# temperature_degC = 60\n" + HEADER + ROWS))
    assert (first.temperature, second.temperature[0]) == (None, 60.0)


def test_one_log_of_several_may_state_its_phase(save):
    """Whatever a mapping file says of all of them."""
    plain = read_one(save(HEADER + ROWS, "plain.csv")).response
    turned = save("# phase_sign: -1\n" + HEADER + ROWS, "turned.csv")
    np.testing.assert_array_equal(read_one(turned).response, plain.conj())
    columns = save("phase_sign = -1\n", "map.toml")
    every = save("# phase_sign: 1\n" + HEADER + ROWS, "every.csv")
    np.testing.assert_array_equal(read_one(every, columns=columns).response, plain)
    assert read_one(turned).warnings == ()
    refused(save("# phase_sign: up\n" + HEADER + ROWS, "up.csv"), "'phase_sign'", "'up'", "1 or -1")


def test_an_amplitude_beside_its_parts_is_kept_out(save):
    log = read_one(save("time_s,w_um,wd_um,wq_um\n0,5,3,4\n1,5,3,4\n"))
    assert log.response.tolist() == [3 + 4j] * 2
    assert log.notes == ("w_um is kept out: wd and wq tell it",)


@pytest.mark.parametrize(
    "line", ["Phase sign: -1", "Phase sign = -1", "phase_offset_deg: 30", "amplitude: rms"]
)
def test_an_option_of_a_mapping_file_in_the_metadata_is_a_warning(save, line):
    (said,) = read_one(save(f"# {line}\n" + HEADER + ROWS)).warnings
    key, value = re.split(" *[:=] *", line.lower().replace("se s", "se_s"))
    assert (
        "is not used" in said and f"a mapping file (--columns) of the line {key} = " in said and value in said
    )
    columns = save('phase_offset_deg = 0\nphase_sign = 1\namplitude = "peak"\n', "map.toml")
    assert read_one(save(f"# {line}\n" + HEADER + ROWS), columns=columns).warnings == ()
    stated = HEADER.replace("voltage_V", "voltage_V_rms").replace("_um", "_um_rms")
    assert read_one(save("# amplitude: rms\n# phase_sign: 1\n" + stated + ROWS)).warnings == ()


def test_transient_without_time_and_steady_without_inputs(save):
    refused(save("# kind: transient\nvoltage_V,w_um\n1,1\n"), "without time", "time_s")
    refused(save("# kind: steady\ntime_s,w_um\n1,1\n"), "without frequency or drive", "frequency_Hz")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["empty file"]),
        (b"# plate: A7\n", ["only comment lines"]),
        (HEADER.encode(), ["a header and no rows"]),
        ((HEADER + "\n\n").encode(), ["a header and no rows"]),
        ((HEADER + ROWS).encode("utf-16")[:-1], ["damaged UTF-16"]),
        (b"\x89PNG\x00\x00", ["binary data"]),
        (gzip.compress((HEADER + ROWS).encode(), mtime=0)[:-12], ["cannot be read"]),
        ((HEADER + ROWS.replace(",0.25", ",\r0.25")).encode(), ["line 3", "carriage return"]),
        ((HEADER + '0,1,2,3,"4\n').encode(), ["line 2", "a quote that is not closed"]),
    ],
)
def test_files_that_are_refused(save, content, words):
    path = save(content)
    refused(path, path, *words)


def test_paths(save, tmp_path):
    for name in ("b.csv", "a.csv"):
        save(HEADER + ROWS.replace("0.25", "0.2" if name == "a.csv" else "0.3"), name)
    assert [log.name for log in read_logs(str(tmp_path / "*.csv"))] == ["a.csv", "b.csv"]
    assert [log.name for log in read_logs([tmp_path / "b.csv", tmp_path / "a.csv"])] == ["b.csv", "a.csv"]
    refused(tmp_path / "*.txt", "*.txt", "no file that fits this pattern")
    refused(tmp_path / "none.csv", "none.csv", "no such file")
    refused(tmp_path, "a directory", "*.csv")
    refused([], "no logs")
    save(HEADER + ROWS, "odd[1].csv")
    assert read_one(tmp_path / "odd[1].csv").name == "odd[1].csv"


def test_the_same_bytes_count_once(save):
    first, second = save(HEADER + ROWS), save(HEADER + ROWS, "copy.csv")
    log = read_one(first)
    (again,) = read_logs([first, second])
    assert again.notes == (f"{second} holds the same bytes: counted once",)
    assert again.response.tolist() == log.response.tolist()


def test_logs_of_two_plates_are_refused(save):
    a7 = save("# plate: A7\n" + HEADER + ROWS, "a.csv")
    b2 = save("# plate: B2\n" + HEADER + ROWS, "b.csv")
    unnamed = save(HEADER + ROWS, "c.csv")
    refused([a7, unnamed, b2], a7, "'A7'", b2, "'B2'")
    assert len(read_logs([a7, unnamed])) == 2


def test_units_follow_the_first_log(save):
    um = save("time_s,voltage_V,w_um\n0,1,1\n", "um.csv")
    nm = save("time_s,voltage_mV,w_nm\n0,500,250\n", "nm.csv")
    still = save("time_s,w_um\n0,1\n", "still.csv")
    _, _, log = read_logs([still, um, nm])
    assert (log.response.tolist(), log.response_unit) == ([0.25], "um")
    assert (log.drive.tolist(), log.drive_unit) == ([0.5], "V")
    refused(
        [um, save("time_s,voltage_V,w_m/s\n0,1,1\n", "v.csv")], "v.csv", "response in m/s", "um", "um.csv"
    )
    refused([um, save("time_s,duty,w_um\n0,1,1\n", "d.csv")], "d.csv", "drive in duty", "V")


# The mapping file that a refusal brings


def complete(text, quantity):
    """What a person would do: say what the mapping file asks for."""
    for key, value in (("amplitude", '"peak"'), ("quantity", f'"{quantity}"'), ("phase_sign", "1")):
        assert f'{key} = "?"' in text
        text = text.replace(f'{key} = "?"', f"{key} = {value}")
    return text


def test_a_file_that_is_not_understood_brings_a_mapping(save, tmp_path):
    path = save("time_unix_s,f_Hz,X_V,Y_V\n10,100,1,2\n11,101,3,4\n")
    text = draft_of(path)
    completed = complete(text, "displacement")
    (tmp_path / "map.toml").write_text(completed)
    log = read_one(path, columns=tmp_path / "map.toml")
    assert log.response.tolist() == [1j * (1 + 2j), 1j * (3 + 4j)]
    assert log.time.tolist() == [10.0, 11.0]
    assert log.frequency.tolist() == [100.0, 101.0]
    (tmp_path / "map.toml").write_text(text)
    refused(path, "map.toml", "amplitude", "'?'", columns=tmp_path / "map.toml")


SAMPLES = [
    'kind = "waveform"  # it looks like raw samples of a carrier; of amplitudes "transient", with x and y, or w'
]
KINDS = (
    '  # what the signal shows: "displacement", "velocity", "acceleration", "charge", "current",'
    ' "impedance"; of S11 "reflection", of S21 "transmission"'
)


@pytest.mark.parametrize(
    ("content", "lines"),
    [
        ("T_degC,T_err_degC,t_s,f [kHz],S21_re,S21_im\n1,1,1,1,1,1\n", [
            'temperature = { column = "T_degC", unit = "degC" }', 'time = { column = "t_s", unit = "s" }',
            'frequency = { column = "f [kHz]", unit = "kHz" }', 'x = { column = "S21_re", unit = "?" }',
            "# not used: T_err_degC", 
        ]),
        ("% ID: 7\n% time [s], power [dBm]\n0, 1\n1, 2\n", [
            'time = { column = "time [s]", unit = "s" }',
            'magnitude = { column = "power [dBm]", unit = "dBm" }',
        ]),
        ("t\tmag\tphase\n1\t2\t3\n", [
            'delimiter = "\\t"', 'time = { column = "t", unit = "?" }', 'phase = { column = "phase", unit = "?" }',
        ]),
        ("BEGIN CH1_DATA\nFreq(Hz),S21 Log Mag(dB),S21 Phase(deg)\n1,2,3\n2,3,4\n3,4,5\nEND\n", [
            'frequency = { column = "Freq(Hz)", unit = "Hz" }', 'magnitude = { column = "S21 Log Mag(dB)", unit = "dB" }',
            'phase = { column = "S21 Phase(deg)", unit = "deg" }', '# temperature = { column = "?", unit = "?" }',
        ]),
        ("x-axis,1,2\nsecond,Volt,Volt\n0,1,2\n1,3,4\n2,5,6\n", [
            *SAMPLES, 'time = { column = "x-axis_second", unit = "s" }', 'drive = { column = "1_Volt", unit = "V" }',
            'response = { column = "2_Volt", unit = "V" }', 'quantity = "?"' + KINDS,
            '# temperature = { column = "?", unit = "?" }',
        ]),
        ("X,CH1,CH2,Start,Increment,,\nSequence,Volt,Volt,-2e-3,1e-6,\n0,1,2,\n1,3,4,\n2,5,6,\n", [
            *SAMPLES, 'drive = { column = "CH1_Volt", unit = "V" }', "# not used: X_Sequence",
        ]),
        ("Model,A,B,C\nTIME,CH1,CH2\n0,1,2\n1e-6,3,4\n2e-6,5,6\n", [
            *SAMPLES, 'time = { column = "TIME", unit = "?" }', 'drive = { column = "CH1", unit = "?" }',
            'response = { column = "CH2", unit = "?" }',
        ]),
        ("Time (us),Velocity [mm/s],Volts\n0,1,2\n1,3,4\n2,5,6\n", [
            *SAMPLES, 'drive = { column = "Volts", unit = "?" }', 'quantity = "velocity"' + KINDS,
            'response = { column = "Velocity [mm/s]", unit = "mm/s" }',
        ]),
        ("Time (s),a,b\n0,1,2\n1e-3,3,4\n2e-3,5,6\n", ['# x = { column = "a", unit = "?" }']),
    ],
)  # fmt: skip
def test_what_a_mapping_is_guessed_from(save, content, lines):
    text = draft_of(save(content))
    assert not set(lines) - set(text.splitlines()), text


def test_the_mapping_of_an_oscilloscope_s_record_reads_it(save, tmp_path):
    """Once the reader has said what the signal shows."""
    t = np.arange(4000) * 1e-6
    drive = np.sin(2 * np.pi * 40e3 * t)
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in np.transpose([t, drive, 0.1 * drive]).tolist())
    path = save("x-axis,1,2\nsecond,Volt,Volt\n" + rows)
    text = refused(path, "no response").mapping
    assert "phase_sign" not in text and "x =" not in text
    (tmp_path / "map.toml").write_text(text.replace('quantity = "?"', 'quantity = "displacement"'))
    log = read_one(path, columns=tmp_path / "map.toml")
    assert log.frequency[0] == pytest.approx(40e3, rel=1e-6)  # of 160 periods, free of noise


def test_a_file_without_header_brings_a_mapping_by_position(save, tmp_path):
    path = save("10;100;1,5;2\n11;101;3,5;-4\n12;102;2,5;1\n".replace(";", "\t").replace(",", "."))
    text = refused(path, "4 columns without a header").mapping
    assert "10, 100, 1.5, 2" in text
    text = complete(text, "velocity")
    for column, (name, unit) in enumerate((("time", "s"), ("frequency", "Hz"), ("x", "V"), ("y", "V"))):
        assert f'{name} = {{ column = {column}, unit = "?" }}' in text.splitlines()
        text = text.replace(f'column = {column}, unit = "?"', f'column = {column}, unit = "{unit}"')
    (tmp_path / "map.toml").write_text(text)
    log = read_one(path, columns=tmp_path / "map.toml")
    expected = np.array([1.5 + 2j, 3.5 - 4j, 2.5 + 1j]) / (2 * np.pi * np.array([100, 101, 102]))
    np.testing.assert_allclose(log.response, expected, rtol=1e-15)  # one division, the last bit aside


# Log itself


def test_a_log_copies_and_is_read_only():
    time, response = np.array([0.0, 1.0]), np.array([1.0, 2.0])
    log = Log("made", response, time)
    response[0] = 7.0
    assert log.response.tolist() == [1.0, 2.0]
    assert response.flags.writeable
    assert not log.response.flags.writeable
    view = np.broadcast_to(3.0, 2)
    assert Log("made", view, time).response.flags.owndata
    assert log.kind == "transient"
    assert Log("made", [1, 2], frequency=[1, 2]).response.dtype == np.float64


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"time": [0.0]}, "time of shape (1,)"),
        ({"time": [1.0, 0.0]}, "decreases"),
        ({"drive": [1.0, math.nan]}, "row 1"),
        ({"kind": "stedy"}, "did you mean 'steady'"),
        ({"sampling": "never"}, "instant or settled"),
        ({"kind": "transient"}, "without time"),
        ({"response": []}, "n > 0"),
        ({"response": [[1.0], [2.0]]}, "shape (2, 1)"),
    ],
)
def test_a_log_checks_itself(fields, words):
    with pytest.raises(LogError) as error:
        Log("made", **({"response": [1.0, 2.0]} | fields))
    assert words in str(error.value)


# Writing

LARGEST = 9.8e37  # what is larger is no number, as instruments write it
FINITE = st.floats(-LARGEST, LARGEST, width=64)
BENCH = {"lockin_order": st.sampled_from([1.0, 4.0]), "settle_s": st.floats(0, LARGEST)}
TIMES = {"lockin_tau_s": st.floats(0, 0.9), "delay_s": st.floats(-0.9, 0)}  # of what the record lasts


@st.composite
def any_log(draw):
    """A log with any of its parts there or not."""
    count = draw(st.integers(1, 7))  # of eight rows one channel that shows nothing is refused
    column = arrays.arrays(np.float64, count, elements=FINITE)
    maybe = st.none() | column
    unit = draw(st.sampled_from(["V", "duty", "mA", "%"]))
    response = draw(column) + 0.0
    if draw(st.booleans()):
        imaginary, real = draw(column), response
        response = np.empty(count, complex)
        response.real, response.imag = real, imaginary
    time = np.sort(draw(column))
    lasts = min(float(time[-1] - time[0]) or 1.0, LARGEST)
    times = {key: share * lasts for key, share in draw(st.fixed_dictionaries({}, optional=TIMES)).items()}
    return Log(
        "made",
        response,
        time=time,
        drive=draw(
            st.none()
            | (arrays.arrays(np.float64, count, elements=st.floats(-1, 1)) if unit == "duty" else column)
        ),
        frequency=draw(st.none() | arrays.arrays(np.float64, count, elements=st.floats(1e-300, LARGEST))),
        temperature=draw(st.none() | arrays.arrays(np.float64, count, elements=st.floats(-273.15, LARGEST))),
        force=draw(maybe),
        sampling=draw(st.sampled_from([None, "instant", "settled"])),
        response_unit=draw(st.sampled_from(["um", "m/s", "A*s", "1", "degree_Celsius"])),
        drive_unit=unit,
        relative_noise=draw(st.booleans()),
        analysed=draw(st.booleans()),
        metadata={"plate": "A7", "note": "a: b, c", "temperature_degC": "7", "kind": "gone"},
        bench={**draw(st.fixed_dictionaries({}, optional=BENCH)), **times},
    )


def test_metadata_that_is_written_stays_metadata(tmp_path):
    """No key and no value can end its line and begin rows."""
    metadata = {"note\n0,9": "a\r\n1,9", "x\x00": "\x00", "y\u2028": "\x85"}
    write_log(Log("made", [1.0, 2.0], [0.0, 1.0], metadata=metadata), tmp_path / "log.csv")
    assert read_one(tmp_path / "log.csv").response.tolist() == [1.0, 2.0]


def test_what_others_note_of_their_noise_is_kept(tmp_path):
    """And our word for it goes where it is no longer so."""
    for noted, kept in (("3 nV", "3 nV"), ("relative", None)):
        write_log(Log("made", [1.0, 2.0], [0.0, 1.0], metadata={"noise": noted}), tmp_path / "log.csv")
        again = read_one(tmp_path / "log.csv")
        assert again.metadata.get("noise") == kept and not again.relative_noise


@settings(max_examples=80, deadline=None)
@given(any_log())
def test_a_written_log_reads_back_to_the_last_bit(tmp_path_factory, log):
    path = tmp_path_factory.mktemp("round") / "log.csv"
    write_log(log, path)
    again = read_one(path)
    for name in ("response", "time", "drive", "frequency", "temperature", "force"):
        written, read = getattr(log, name), getattr(again, name)
        assert (written is None) == (read is None)
        assert written is None or (written.dtype, written.tobytes()) == (read.dtype, read.tobytes())
    for name in ("kind", "sampling", "response_unit", "relative_noise", "analysed", "even"):
        assert getattr(again, name) == getattr(log, name)
    exact = (
        log.temperature is not None and np.ptp(log.temperature) == 0
    )  # which nobody read, and the file says so
    assert again.bench == ({"temperature_std_degC": 0.0} if exact else {}) | dict(log.bench)
    assert log.drive is None or again.drive_unit == log.drive_unit
    assert again.metadata["plate"] == "A7"
    assert again.metadata["note"] == "a: b, c"


MESS = st.sampled_from(
    [b",", b"\n", b'"', b"#", b"\x00", b"\xff", b";", b"nan", b"\t", b" ", b"\r", b":", b"_", b"[", b"9"]
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 180), st.integers(0, 3), MESS), min_size=1, max_size=3))
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, edits):
    """Whatever stands in the file, the answer is a log or a LogError, and its mapping file is TOML."""
    content = f"# plate: A7\n# temperature_degC: 24.0\n{HEADER}{ROWS}".encode()
    for place, cut, mess in edits:
        content = content[:place] + mess + content[place + cut :]
    path = tmp_path_factory.mktemp("mess") / "log.csv"
    path.write_bytes(content)
    try:
        logs = read_logs(path)
    except LogError as error:
        tomllib.loads(error.mapping or "")
    else:
        assert all(np.isfinite(log.response).all() for log in logs)


def test_what_was_probably_meant_is_told_with_the_fit(save, bench):
    log = bench.sweep()
    rows = "\n".join(
        f"{f},{v},{w.real},{w.imag}" for f, v, w in zip(log.frequency, log.drive, log.response, strict=True)
    )
    path = save(f"# samplng: settled\nfrequency_Hz,voltage_V,wd_um,wq_um\n{rows}\n", "x.csv")
    assert (
        "x.csv: metadata 'samplng' is not used; did you mean 'sampling'?" in fit(read_logs([path])).warnings
    )


def test_a_part_of_the_response_that_was_constant_may_stand_above_the_header(tmp_path):
    """As every column may; but not all of the response."""
    path = tmp_path / "log.csv"
    path.write_text("# wq_nm: 500\ntime_s,wd_um\n0,1.5\n1,2.5\n")
    assert list(read_logs(path)[0].response) == [1.5 + 0.5j, 2.5 + 0.5j]
    path.write_text("# w_um: 1\ntime_s,voltage_V\n0,1\n1,2\n")
    with pytest.raises(LogError, match="in the metadata alone, expected a column"):
        read_logs(path)


NAMES = [
    (["sweep_18C.csv", "sweep_24C.csv", "sweep_35C.csv"], "18, 24, 35"),
    (["18degC.csv", "24.5degC.csv"], "18, 24.5"),
    (["run1 at -5 °C.csv", "run2 at 20 °C.csv"], "-5, 20"),
    (["a-18_deg.csv", "a-35_deg.csv"], "18, 35"),
    (["sweep_18C.csv", "sweep_24.csv"], ""),  # not all of them
    (["18C_up.csv", "24C_down.csv"], ""),  # not in one pattern
    (["18C_1.csv", "18C_2.csv"], ""),  # one
    (["CH1.csv", "CH2.csv"], ""),
    (["12cm.csv", "14cm.csv"], ""),
]


@pytest.mark.parametrize(("names", "said"), NAMES)
def test_temperatures_that_stand_in_the_names_alone_are_no_data_and_are_named(save, names, said):
    """Three sweeps at three temperatures contradict each other, and nothing said why."""
    sweep = "frequency_Hz,wd_um,wq_um\n" + "".join(f"{32000 + k},0.{k},0.1\n" for k in range(10, 30))
    paths = [save(sweep.replace("0.1\n", f"0.{k + 2}\n"), name) for k, name in enumerate(names)]
    logs = read_logs(paths)
    warnings = [warning for log in logs for warning in log.warnings]
    assert all(log.temperature is None for log in logs)
    assert [f"names seem to hold one ({said} degC)" in warning for warning in warnings] == [True] * bool(said)
    stated = [save(f"# temperature_degC: {20 + k}\n{sweep}", name) for k, name in enumerate(names)]
    assert not any(log.warnings for log in read_logs(stated))


def test_a_name_is_not_doubted_where_no_temperature_matters(save):
    step = "time_s,voltage_V,w_um\n" + "".join(f"{k},1,0.{k}\n" for k in range(10, 30))
    assert not any(
        log.warnings for log in read_logs([save(step, "18C.csv"), save(step + "30,1,0.3\n", "24C.csv")])
    )
