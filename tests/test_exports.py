"""Files as instruments and people export them, each from a plate in closed form: what is drafted for them, what is
asked, and what is read once a person has answered."""

import datetime
import json
import pickle
import re

import numpy as np
import pytest
import scipy.io
from refusal import draft_of, refused
from test_drafts import F, S, answered, asked, polar, re_im, table

from sysid.logs.read import read_logs

W = 1j * S  # of a displacement, with the reference at the drive's cosine
TIME = 1e-4 * np.arange(60)
DRIVE = np.where(TIME > 0.00105, 50.0, 0.0)
STEP = 1.0 - np.exp(-np.clip(TIME - 0.0011, 0, None) / 1.67e-3) + 1e-4j * np.cos(1e4 * TIME)


def read(save, content, name="log.csv", unit="V"):
    """The log of a file, and what its draft asked; of one that needs none, nothing."""
    path = save(content, name)
    text = draft_of(path)
    return read_logs(path, columns=save(answered(text, unit), "map.toml"))[0], asked(text)


# What heads say


@pytest.mark.parametrize("unit, scale", [("mHz", 1e3), ("kHz", 1e-3), ("MHz", 1e-6)])
@pytest.mark.parametrize("name", ["f", "freq", "Frequency"])
def test_a_prefix_is_part_of_the_unit_behind_an_underscore(save, name, unit, scale):
    """f_kHz was read as f_k, in Hz."""
    log, _ = read(save, table(f"{name}_{unit},X_V,Y_V", scale * F, *re_im(S)))
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)


@pytest.mark.parametrize(
    "unit, turn",
    [("turns", 1), ("cycles", 1), ("gon", 400), ("mrad", 2e3 * np.pi), ("deg", 360), ("rad", 2 * np.pi)],
)
def test_a_phase_is_read_in_whatever_angle_it_is_stated(save, unit, turn):
    log, questions = read(
        save,
        table(f"Frequency (Hz),Amplitude (um),Phase ({unit})", F, abs(S), turn * np.angle(S) / 2 / np.pi),
    )
    assert questions == ["amplitude", "phase_sign"]
    np.testing.assert_allclose(log.response, W, rtol=1e-10)


AMPLITUDES = {
    "Frequency (Hz),X (Vrms),Y (Vrms),Vosc (Vpk)": (np.sqrt(0.5), 1.0, "V"),
    "Frequenz [Hz],X [Veff],Y [Veff],Uosc [Vss]": (np.sqrt(0.5), 2.0, "V"),
    "f (Hz),X (um 0-p),Y (um 0-p),Drive (V 0-p)": (1.0, 1.0, "um"),
    "f (Hz),X peak-to-peak (um),Y peak-to-peak (um),Excitation amplitude (Vpp)": (2.0, 2.0, "um"),
    "f_Hz,X_um_pp,Y_um_pp,Drive eff [V]": (2.0, np.sqrt(0.5), "um"),
}


@pytest.mark.parametrize("head", AMPLITUDES)
def test_peak_effective_and_peak_to_peak_are_told_by_the_heads(save, head):
    response, drive, unit = AMPLITUDES[head]
    log, questions = read(save, table(head, F, *re_im(response * S), 5 * drive + 0 * F))
    assert "amplitude" not in questions
    np.testing.assert_allclose(log.response, W, rtol=1e-11)
    np.testing.assert_allclose(log.drive, 5.0, rtol=1e-12)
    assert (log.response_unit, log.drive_unit) == (unit, "V")


@pytest.mark.parametrize(
    "head", ["Vss [V]", "VSS (V)", "w_ss", "Coeff [1]", "mass (g)", "Peak (V)", "steady_ss_V"]
)
def test_what_ends_like_an_amplitude_states_none(save, head):
    text = draft_of(save(table(f"Frequency (Hz),X (um),Y (um),{head}", F, *re_im(S), 1 + 0 * F)))
    assert "amplitude" in asked(text) and not re.search(r'"(rms|pp|peak)" }', text)


@pytest.mark.parametrize(
    "head, unit",
    [
        ("Frequency [Hz],Real (m/s)/V,Imag (m/s)/V", "m"),
        ("Hz,Real mm/s/V,Imaginary mm/s/V", "mm"),
        ("kHz,Real m/s/N,Imag m/s/N", "m"),
    ],
)
def test_a_ratio_at_the_end_of_a_head_is_one_unit(save, head, unit):
    """Of (m/s)/V the V alone was read, and of a head Hz nothing."""
    scale = 1e-3 if head.startswith("k") else 1.0
    log, questions = read(save, table(head, scale * F, *re_im(S)))
    assert questions == ["phase_sign"]
    np.testing.assert_allclose(log.response, S / (2 * np.pi * F), rtol=1e-11)
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)
    assert log.response_unit == unit and log.drive.tolist() == [1.0] * len(F)


def test_a_logarithm_has_no_unit_of_what_it_is_of(save):
    """ln(A) was read in amperes; the draft says how a logarithm is read."""
    time = 1e-4 * np.arange(80)
    path = save(table("t (ms),ln(A)", 1e3 * time, -time / 1.67e-3))
    text = draft_of(path)
    assert "8.685889638 of ln(A)" in text
    text = answered(text, "dB").replace('unit = "dB"', 'unit = "dB", scale = 8.685889638')
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response.real, np.exp(-time / 1.67e-3), rtol=1e-9)


# How lines stand in a file

LOG = table("time_ms,voltage_V,frequency_Hz,wd_um,wq_um", 1e3 * TIME, DRIVE, 32300 + 0 * TIME, *re_im(STEP))


def check_step(log):
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    np.testing.assert_allclose(log.response, STEP, rtol=1e-12)
    assert log.drive.tolist() == DRIVE.tolist() and log.kind == "transient"


def test_lines_that_end_in_carriage_returns_alone(save):
    check_step(read_logs(save(LOG.replace("\n", "\r")))[0])


def test_the_times_of_a_serial_monitor_are_a_column(save):
    """They were glued to the first column, which was left out: a step was read as settled points."""
    lines = [f"12:00:00.{k:03d} -> {line}" for k, line in enumerate(LOG.splitlines())]
    check_step(read_logs(save("\n".join(lines) + "\n", "monitor.txt"))[0])
    later = re.sub(r"-> [^,]*,", "-> ", "\n".join(lines))  # without a time of its own
    (log,) = read_logs(save(later, "later.txt"))
    np.testing.assert_allclose(log.time, 1e-3 * np.arange(len(TIME)), atol=1e-12)


@pytest.mark.parametrize("says", [False, True])
def test_the_times_of_a_serial_monitor_are_coarser_than_the_board_s_own(save, says):
    """The stamps of a burst are all alike: read as its time, they were kept out, and the step was none."""
    names, *rows = LOG.replace("time_ms", "t_ms").splitlines()
    if says:  # cells that say their names, as for a plotter
        each = [zip(names.split(","), row.split(","), strict=True) for row in rows]
        lines = [",".join(f"{name}:{cell}" for name, cell in row) for row in each]
    else:
        lines = [names, *rows]
    (log,) = read_logs(save("".join(f"12:00:00.000 -> {line}\n" for line in lines), "burst.txt"))
    check_step(log)
    if says:  # without a time of the board's, over midnight, and with a line on which nothing came
        stamps = [
            f"{23 if k < 50 else 0:02d}:{59 if k < 50 else 0:02d}:{59 if k < 50 else 0:02d}"
            for k in range(len(lines))
        ]
        parts = [f".{(950 + k) % 1000:03d}" for k in range(len(lines))]
        rest = [line.partition(",")[2] for line in lines]
        text = [f"{a}{b} -> {c}\n" for a, b, c in zip(stamps, parts, rest, strict=True)]
        (later,) = read_logs(save("".join([*text[:70], "00:00:00.500 -> \n", *text[70:]]), "night.txt"))
        np.testing.assert_allclose(later.time - later.time[0], 1e-3 * np.arange(len(lines)), atol=1e-9)


@pytest.mark.parametrize(
    "content, words",
    [
        (b"SQLite format 3\0", "a database"),
        (b'<?xml version="1.0"?>\n', "XML"),
        (b"<!DOCTYPE html>\n", "a web page"),
        (pickle.dumps({"f": 1.0}), "a pickle of Python, which is never opened"),
    ],
)
def test_files_that_hold_no_table_are_called_what_they_are(tmp_path, content, words):
    path = tmp_path / "log.csv"
    path.write_bytes(content + b"1,2\n3,4\n")
    refused(path, words, "save it as CSV")


def test_a_spectrum_in_tdms_is_one_over_frequency(save, tmp_path):
    """Its step in Hz was read as one in seconds, and the spectrum as a record over time."""
    nptdms = pytest.importorskip("nptdms")
    axis = {
        "wf_start_offset": F[0],
        "wf_increment": F[1] - F[0],
        "wf_xname": "Frequency",
        "wf_xunit_string": "Hz",
    }
    columns = {"Magnitude": (abs(S), "um"), "Phase": (np.degrees(np.angle(S)), "deg")}
    with nptdms.TdmsWriter(str(tmp_path / "frf.tdms")) as file:
        file.write_segment(
            [nptdms.ChannelObject("FRF", k, x, axis | {"unit_string": u}) for k, (x, u) in columns.items()]
        )
    text = draft_of(tmp_path / "frf.tdms")
    (log,) = read_logs(tmp_path / "frf.tdms", columns=save(answered(text), "map.toml"))
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)
    np.testing.assert_allclose(log.response, W, rtol=1e-10)
    assert log.kind == "steady"


# Where the header is

AROUND = {
    "merged names above them": (",Lock-in,,Drive\nFrequency,X,Y,Voltage\n(Hz),(um),(um),(V)\n", ""),
    "a line of remarks below the units": (
        "Frequency\tX\tY\tVoltage\nHz\tum\tum\tV\n\tleft arm\t20 degC\t\n",
        "",
    ),
    "an empty first column": (
        "TAG\tSWEEP\nCURVE\tTABLE\n\tFrequency\tX\tY\tVoltage\n\tHz\tum\tum\tV\n",
        "\t",
    ),
    "a word below the names": ("sweep 4\nFrequency (Hz), X (um), Y (um), Voltage (V)\nEnd Comments\n", ""),
}


@pytest.mark.parametrize("name", AROUND)
def test_the_header_is_found_among_the_lines_above_the_rows(save, name):
    above, before = AROUND[name]
    rows = table("", F, *re_im(S), 5 + 0 * F).splitlines(keepends=True)
    text = above + "".join(before + (row.replace(",", "\t") if "\t" in above else row) for row in rows)
    log, questions = read(save, text, unit="um")
    assert questions == ["amplitude", "phase_sign"]
    np.testing.assert_allclose(log.response, W, rtol=1e-11)
    assert log.drive.tolist() == [5.0] * len(F)


@pytest.mark.parametrize("word", ["DATA,,", "Waveform Data,", "Values"])
def test_settings_that_end_in_a_word_are_no_header(save, word):
    settings = (
        "Swept SA\nA.14.53,N9010A,503 F32\nSegment,\nPoints,51\nSweep Time,0.01\nRBW,10\nX Axis Units,Hz\n"
    )
    log, _ = read(save, f"{settings}{word}\n" + table("", F, abs(S)))
    np.testing.assert_allclose(log.frequency, F)
    np.testing.assert_allclose(abs(log.response), abs(S), rtol=1e-12)


def test_a_time_that_stands_there_again_is_no_response(save):
    """As of an oscilloscope that writes one before each channel."""
    time = 1e-6 * np.arange(200)
    text = draft_of(save(table("", time, np.sin(2e5 * time), time, np.cos(2e5 * time))))
    assert "drive = { column = 1," in text and "response = { column = 3," in text


def numbered(form):
    return "".join(form % (k, f, s.real, s.imag) for k, (f, s) in enumerate(zip(F, S, strict=True)))


NUMBERED = {
    "R": '"freq_Hz" "x_V" "y_V"\n' + numbered('"%d" %.2f %.12g %.12g\n'),
    "R, by commas": '"","freq_Hz","x_V","y_V"\n' + numbered('"%d",%.2f,%.12g,%.12g\n'),
    "pandas, as it prints": "   freq_Hz   x_V   y_V\n" + numbered("%-3d %.2f %.12g %.12g\n"),
}


@pytest.mark.parametrize("name", NUMBERED)
def test_row_names_without_a_name_of_their_own(save, name):
    log, _ = read(save, NUMBERED[name])
    np.testing.assert_allclose(log.response, W, rtol=1e-9)
    np.testing.assert_allclose(log.frequency, F)


@pytest.mark.parametrize("header", ["freq_Hz x_V y_V\n", "time_s freq_Hz x_V\n"])
def test_a_header_that_may_lack_its_last_name_is_refused(save, header):
    text = header + numbered("%d %.2f %.12g %.12g\n")
    refused(
        save(text),
        "line 2",
        "found 4 columns, expected 3",
        columns=save('amplitude = "peak"\n[columns]\nfrequency = "freq_Hz"\nw = "x_V"\n', "m.toml"),
    )


def test_a_header_of_two_rows_again_begins_a_log(save):
    """Its units were taken for names, and the sweeps for traces side by side."""
    one = "Frequency,Amplitude,Phase\nHz,um,deg\n" + table("", F, abs(S), np.degrees(np.angle(S)))
    path = save(one + one)
    text = draft_of(path)
    assert "join" not in text
    first, second = read_logs(path, columns=save(answered(text), "map.toml"))
    for log in (first, second):
        np.testing.assert_allclose(log.response, W, rtol=1e-10)


def test_steps_of_a_simulator_are_experiments(save):
    def step(k):
        rows = (
            f"{f:.15e}\t({20 * np.log10(abs(s)):.15e}dB,{np.degrees(np.angle(s)):.15e}°)\n"
            for f, s in zip(F, k * S, strict=True)
        )
        return f"Step Information: R={k}K  (Run: {k}/2)\n" + "".join(rows)

    path = save("Freq.\tV(out)\n" + step(1) + step(2), "lt.txt")
    logs = read_logs(path, columns=save(answered(draft_of(path)), "map.toml"))
    assert [log.name for log in logs] == [f"lt.txt[Step Information: R={k}K  (Run: {k}/2)]" for k in (1, 2)]
    for k, log in enumerate(logs, 1):
        np.testing.assert_allclose(log.response, k * W, rtol=1e-12)
    refused(
        save(path.read_text().replace("Step Information: R=2K", "Aborted at 2K"), "bad.txt"),
        "line 54",
        "1 cells",
    )


def test_complex_numbers_without_a_header_are_all_rows(save):
    """As numpy saves them; the first row was taken for the names."""
    path = save(
        "".join(f" ({f:.6e}+0.0e+00j) ({s.real:.15e}{s.imag:+.15e}j)\n" for f, s in zip(F, S, strict=True))
    )
    text = answered(draft_of(path)).replace(
        "[columns]", '[columns]\nfrequency = { column = "column 0", unit = "Hz" }'
    )
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, W, rtol=1e-12)
    np.testing.assert_allclose(log.frequency, F)


# Objects and arrays

OWN = {"frequency_Hz": F, "wd_um": W.real, "wq_um": W.imag, "voltage_V": 50 + 0 * F}
LISTS = {name: values.tolist() for name, values in OWN.items()}
BESIDE = {"frequency": "Hz", "wd": "um", "wq": "um", "voltage": "V"}
JSON = {
    "a message a line": "\n".join(
        json.dumps({"topic": "plate", "payload": dict(zip(LISTS, row, strict=True))})
        for row in zip(*LISTS.values(), strict=True)
    ),
    "an object within": json.dumps({"metadata": {"operator": "x"}, "data": LISTS}),
    "columns and data": json.dumps(
        {"columns": [*LISTS], "data": [*map(list, zip(*LISTS.values(), strict=True))]}
    ),
    "units beside the values": json.dumps(
        {name: {"values": LISTS[f"{name}_{unit}"], "unit": unit} for name, unit in BESIDE.items()}
    ),
}


def check_own(log):
    np.testing.assert_allclose(log.frequency, F)
    np.testing.assert_allclose(log.response, W, rtol=1e-12)
    assert (log.response_unit, log.drive_unit, log.drive.tolist()) == ("um", "V", [50.0] * len(F))


@pytest.mark.parametrize("name", JSON)
def test_names_of_logs_within_objects_of_json(save, name):
    check_own(read_logs(save(JSON[name], "log.json"))[0])


def test_names_of_logs_behind_a_point_are_theirs(save):
    """As a message's fields are called; of two of one name it is asked."""
    names = ",".join(f"field.{name}" for name in OWN)
    check_own(read_logs(save(table(names, *OWN.values())))[0])
    refused(save(table(f"{names},other.wq_um", *OWN.values(), F)), "found wq twice")
    text = draft_of(save(table("frequency_Hz,x.std_um,x.mean_um", F, F, F)))
    assert 'std = { column = "x.std_um", unit = "um" }  # if' in text


def test_structures_in_a_cell_array_are_experiments(tmp_path):
    cells = np.empty((1, 2), object)
    cells[0, 0] = cells[0, 1] = OWN
    scipy.io.savemat(tmp_path / "sweeps.mat", {"sweeps": cells})
    first, second = read_logs(tmp_path / "sweeps.mat")
    check_own(first)
    check_own(second)
    assert (first.name, second.name) == ("sweeps.mat[/sweeps[1]]", "sweeps.mat[/sweeps[2]]")


def test_the_columns_of_an_array_alone_are_told_by_their_numbers(save, tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"data": np.column_stack([F, S.real, S.imag])})
    text = answered(draft_of(tmp_path / "a.mat"))
    assert "x = { column = 1," in text
    for mapping in (text, re.sub(r"column = (\d)", r'column = "data[\1]"', text)):
        (log,) = read_logs(tmp_path / "a.mat", columns=save(mapping, "map.toml"))
        np.testing.assert_allclose(log.response, W, rtol=1e-12)


@pytest.mark.parametrize("cell", ["#DIV/0!", "#NV", "<NA>", "NaT", "None"])
def test_what_a_spreadsheet_cannot_work_out_is_no_number(save, cell):
    lines = table(",".join(OWN), *OWN.values()).splitlines()
    lines[2] = re.sub(r",[^,]*,", f",{cell},", lines[2], count=1)
    (log,) = read_logs(save("\n".join(lines) + "\n"))
    assert len(log.frequency) == len(F) - 1 and "line 3" in " ".join(log.notes)
    refused(save("\n".join(lines).replace(cell, "#####") + "\n"), "line 3", "#####")


# Times

INPUTS = "voltage_V,frequency_Hz,wd_um,wq_um"


def timed(name, stamps, above=""):
    rows = table("", DRIVE, 32300 + 0 * TIME, *re_im(STEP)).splitlines()
    return f"{above}{name},{INPUTS}\n" + "".join(f"{t},{row}\n" for t, row in zip(stamps, rows, strict=True))


def test_an_index_of_dates_has_no_name(save):
    """As pandas writes it. It was left out, and a step read as settled points without a word."""
    noon = datetime.datetime(2024, 3, 31, 12)
    stamps = [noon + datetime.timedelta(microseconds=100 * k) for k in range(len(TIME))]
    (log,) = read_logs(save(timed("", stamps)))
    check_step(log)
    assert "column without a name is read as time" in log.notes
    path = save(
        ",Channel 1 (V),Speed (rpm)\n"
        + "".join(f"{s},{v},{v / 2}\n" for s, v in zip(stamps, DRIVE, strict=True))
    )
    assert "time = { column = 0," in draft_of(path)


def test_an_index_that_goes_up_without_a_name_is_told(save):
    (log,) = read_logs(save(timed("", TIME)))
    assert "a column without a name that goes up and states no unit of time" in " ".join(log.warnings)


@pytest.mark.parametrize(
    "form",
    [
        lambda k: f"{(k + 599900) // 600000:02d}:{(k + 599900) % 600000 / 1e4:07.4f}",
        lambda k: f"7:09:{k // 1000:02d}:{k % 1000:03d}",
    ],
)
def test_minutes_and_seconds_and_thousandths_behind_a_colon(save, form):
    (log,) = read_logs(save(timed("Time", [form(k) for k in range(len(TIME))])))
    scale = log.time[1] / TIME[1]
    assert scale == pytest.approx(10 if "7:" in form(0) else 1)
    np.testing.assert_allclose(log.time, scale * TIME, atol=1e-9)
    assert log.kind == "transient"


@pytest.mark.parametrize("stated", ["sample_rate: 10 kHz", "sample_rate: 10000 Hz", "sample_rate_Hz: 10 kHz"])
def test_a_sample_rate_whose_unit_stands_behind_it(save, stated):
    check_step(read_logs(save(timed("sample", range(len(TIME)), f"# {stated}\n")))[0])


def test_a_frequency_from_a_centre_gets_it_from_the_mapping_file(save):
    """Above the centre alone it was read as it stands, and the resonance found at some hundred hertz."""
    path = save(table("Detuning (Hz),Amplitude (um),Phase (deg)", F - 31800, *polar(S)))
    text = draft_of(path)
    assert 'offset = "?"' in text
    text = answered(text.replace('offset = "?"', "offset = 31800.0"))
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)
    np.testing.assert_allclose(log.response, W, rtol=1e-10)
    path = save(table(",".join(OWN), F - 32300, *list(OWN.values())[1:]))
    refused(path, "line 2", "find = true and columns.frequency.offset = 32300")
    text = 'find = true\namplitude = "peak"\ncolumns.frequency.offset = 32300\n'
    check_own(read_logs(path, columns=save(text, "map.toml"))[0])


@pytest.mark.parametrize("mark, of", [(",", ":"), ("\t", ": "), (";", " = ")])
def test_numbers_behind_their_names_in_every_cell(save, mark, of):
    """As a microcontroller prints them; the first row was taken for the header."""
    names, *lines = (line.split(",") for line in LOG.splitlines())
    rows = [mark.join(f"{name}{of}{cell}" for name, cell in zip(names, row, strict=True)) for row in lines]
    check_step(read_logs(save("\n".join(rows) + "\n", "log.txt"))[0])
    broken = "\n".join([*rows[:55], rows[55].replace("wd_um", "wq_um"), *rows[56:]])
    refused(save(broken + "\n", "broken.txt"), "line 56", "wd_um")


def test_a_speed_in_a_row_of_units(save):
    text = draft_of(save("Time,PWM,Speed\nms,%,rpm\n" + table("", 1e3 * TIME, DRIVE, STEP.real)))
    assert asked(text) == [] and 'w = { column = "Speed_rpm", unit = "rpm" }' in text


LONG = {
    "tidy": ("time_s,channel,value\n", "{t:.4f},{name},{x:.12g}\n", "channel"),
    "a database's": (
        "#group,false,true\n#datatype,string,long\n,result,table,_time,_value,_field\n",
        ",,{k},2024-03-31T12:00:00.{us:06d}Z,{x:.12g},{name}\n",
        "_field",
    ),
}


@pytest.mark.parametrize("form", LONG)
@pytest.mark.parametrize("by", ["time", "name"])
def test_a_reading_a_line_is_a_column_a_name(save, form, by):
    """All readings were taken for one signal."""
    above, line, key = LONG[form]
    columns = dict(zip(INPUTS.split(","), (DRIVE, 32300 + 0 * TIME, STEP.real, STEP.imag), strict=True))
    readings = [
        (line.format(t=t, us=round(1e6 * t), name=name, x=x[row], k=k), row)
        for k, (name, x) in enumerate(columns.items())
        for row, t in enumerate(TIME)
    ]
    readings = sorted(readings, key=lambda reading: reading[1]) if by == "time" else readings
    text = above + "".join(text for text, _ in readings)
    (log,) = read_logs(save(text))
    np.testing.assert_allclose(log.response, STEP, rtol=1e-10)
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    assert (
        log.drive.tolist() == DRIVE.tolist()
        and f"the readings of each {key} are read as a column" in " ".join(log.notes)
    )
    refused(save(text + readings[-1][0]), f"line {len(text.splitlines()) + 1}", "again")


def test_a_column_of_one_name_is_no_long_table(save):
    """It says of what plate, or sensor, the readings are."""
    text = draft_of(
        save("time_s,sensor,value\n" + "".join(f"{t},A7,{x}\n" for t, x in zip(TIME, STEP.real, strict=True)))
    )
    assert 'w = { column = "value"' in text


OPEN = {
    "ω (1/s),X (um),Y (um)": (2 * np.pi * F, *re_im(S)),
    "f (Hz),|X|^2 (um^2)": (F, abs(S) ** 2),
    "f (Hz),Power (mW)": (F, abs(S) ** 2),
    "f (Hz),Intensity (a.u.)": (F, abs(S) ** 2),
    "f (Hz),H (um/Vpp),Phase (deg)": (F, abs(S), np.degrees(np.angle(S))),
    "f (Hz),H (nm/Vrms),Phase (deg)": (F, abs(S), np.degrees(np.angle(S))),
}


@pytest.mark.parametrize("head", OPEN)
def test_what_a_unit_leaves_open_is_asked(save, head):
    """1/s was taken for Hz, a square for an amplitude, and um/Vpp for um/V."""
    text = draft_of(save(table(head, *OPEN[head])))
    assert {"frequency" if head.startswith("ω") else "magnitude"} <= {*asked(text)}, text
    assert not re.search(r'unit = "\?"[^}]*amplitude', text)


@pytest.mark.parametrize(
    "head", ["f (Hz),I (V),Q (V)", "f (Hz),Cos (V),Sin (V)", "f_Hz,In phase (V),Out of phase (V)"]
)
def test_both_parts_of_a_signal_are_read(save, head):
    """Of I and Q the first alone was taken for an amplitude."""
    log, questions = read(save, table(head, F, *re_im(S)))
    assert questions == ["amplitude", "quantity", "phase_sign"]
    np.testing.assert_allclose(log.response, W, rtol=1e-11)


@pytest.mark.parametrize("head", ["f (Hz),Q (um),D (um)", "f (Hz),Response_q_(um),Response_d_(um)"])
def test_d_and_q_behind_the_same_words_are_the_response(save, head):
    """Of the second the first column alone was taken for an amplitude, or for samples of a carrier."""
    (log,) = read_logs(save(table(head, F, W.imag, W.real)))
    np.testing.assert_allclose(log.response, W, rtol=1e-12)


@pytest.mark.parametrize("head", ["f (Hz),A (V),B (V)"])
def test_one_of_two_signed_columns_is_not_taken_for_the_whole(save, head):
    text = draft_of(save(table(head, F, *re_im(S))))
    assert "no column is known to be the response" in text
    refused(save(table(head, F, *re_im(S))), "found no response")


@pytest.mark.parametrize(
    "head, said",
    [
        ("Time (s),ax (m/s^2),ay (m/s^2)", "found no response"),
        ("Time (s),Pump (%),Valve (%),Level (cm)", "Pump (%) or Valve (%) or Level (cm)"),
    ],
)
def test_of_several_signals_none_is_read_without_being_named(save, head, said):
    noise = np.random.default_rng(0).standard_normal((head.count(","), len(F)))
    refused(save(table(head, 0.1 * np.arange(len(F)), *noise)), said)


@pytest.mark.parametrize(
    "head, drive, signal",
    [
        ("Time (min),Power (W),Temperature (K)", "drive", "Temperature (K)"),
        ("Time (s),Pressure (bar),Level (cm)", "drive", "Level (cm)"),
        ("Time (h),Heater (%),Temp 1 (°C),Temp 2 (°C)", "duty", "Temp 2 (°C)"),
    ],
)
def test_what_is_held_is_the_drive_of_what_is_left(save, head, drive, signal):
    """A heater's power was taken for the response, as was its duty beside two thermometers."""
    columns = [300 + 5 * STEP.real] * (head.count(",") - 1)
    text = draft_of(save(table(head, TIME, DRIVE, *columns)))
    assert re.search(
        rf'^{drive} = {{ column = "{head.split(",")[1]}"'.replace("(", r"\(").replace(")", r"\)"), text, re.M
    ), text
    assert f'w = {{ column = "{signal}"' in text


def test_an_increment_at_the_header_s_end(save):
    """As Rigol writes it, without a column of times."""
    time = 2e-6 * np.arange(4000)
    drive, answer = 5 * np.cos(2e5 * time), 0.7 * np.cos(2e5 * time - 0.6)
    rows = "".join(f"{a},{b},,,\n" for a, b in zip(drive, answer, strict=True))
    log, questions = read(save, "CH1V,CH2V,,t0 = -4.0e-03, tInc = 2.000000e-06,\n" + rows)
    assert questions == ["quantity", "drive", "response"]
    np.testing.assert_allclose(log.frequency, 2e5 / 2 / np.pi, rtol=1e-9)
    np.testing.assert_allclose(log.response, 0.7 * np.exp(-0.6j) * 1j, rtol=1e-5)
    assert "sampled every 2e-06 s, as tInc says in the header" in log.notes


def test_powers_as_mathematica_prints_them(save):
    names, *rows = table(",".join(OWN), *OWN.values()).splitlines()
    rows = [
        re.sub(r",([^,]*),", lambda found: f",{float(found[1]):.12e},".replace("e", "*^"), row, count=1)
        for row in rows
    ]
    check_own(read_logs(save("\n".join([names, *rows]) + "\n"))[0])


# Numbers


@pytest.mark.parametrize("unit, prefix, scale", [("Hz", "k", 1e-3), ("MHz", "m", 1e3), ("Hz", "K", 1e-3)])
def test_prefixes_behind_numbers_whose_unit_stands_in_the_head(save, unit, prefix, scale):
    """32.3k was read as 32.3."""
    head = ",".join(OWN).replace("_Hz", f"_{unit}")
    lines = [
        line.split(",")
        for line in table(head, F * (1e-6 if unit == "MHz" else 1), *list(OWN.values())[1:]).splitlines()
    ]
    rows = "".join(f"{float(f) * scale!r}{prefix},{','.join(others)}\n" for f, *others in lines[1:])
    check_own(read_logs(save(f"{head}\n{rows}"))[0])


def test_a_milli_that_may_be_a_metre_and_a_unit_of_another_kind_are_refused(save):
    for cell in ("25.0m", "25.0 V", "25.0 s"):
        text = ",".join(OWN) + "\n" + "".join(f"{f},{cell},0.1,50\n" for f in F)
        refused(save(text), "line 2", "'wd_um'", cell)


def test_an_amplitude_behind_a_number_is_refused_with_the_key_that_says_it(save):
    rows = table("frequency_Hz,wd_um,wq_um", F, *re_im(W))
    refused(save(f"# voltage_V: 100 Vpp\n{rows}"), "write voltage_V_pp: 100")
    check_own(read_logs(save(f"# voltage_V_pp: 100\n{rows}"))[0])


@pytest.mark.parametrize("cell", ["24.5C", "24.5 °C", "297.65K", "297.65 K", "76.1F"])
def test_degrees_behind_a_temperature(save, cell):
    rows = table(",".join(OWN), *OWN.values()).splitlines()
    (log,) = read_logs(
        save("\n".join([f"{rows[0]},temperature_degC", *(f"{row},{cell}" for row in rows[1:])]) + "\n")
    )
    check_own(log)
    np.testing.assert_allclose(log.temperature, 24.5, atol=1e-9)


def test_a_prefix_behind_numbers_without_a_unit_is_no_unit(save):
    rows = "".join(f"{f / 1e3!r}k,{x!r}\n" for f, x in zip(F.tolist(), abs(S).tolist(), strict=True))
    log, questions = read(save, "Frequency,Amplitude (um)\n" + rows)
    assert "frequency" in questions
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)


def test_truths_are_no_volts(save):
    """A drive that is True was read as 1 V."""
    rows = [line.replace(",0,", ",False,").replace(",50,", ",True,") for line in LOG.splitlines()]
    refused(save("\n".join(rows) + "\n"), "line 2", "'voltage_V'", "'False'")


def test_a_row_of_groups_above_a_log_s_names_is_left_out(save):
    check_step(read_logs(save(",Drive,Drive,Response,Response\n" + LOG))[0])


def test_a_mapping_file_may_read_a_long_table_as_it_is(save):
    text = "time_s,channel,value\n" + "".join(
        f"{t},{name},{x}\n" for name in ("left", "right") for t, x in zip(TIME, STEP.real, strict=True)
    )
    mapping = 'amplitude = "peak"\nsplit_by = "channel"\n[columns]\ntime = "time_s"\nw = { column = "value", unit = "um" }\n'
    logs = read_logs(save(text), columns=save(mapping, "map.toml"))
    assert [log.name for log in logs] == ["log.csv[left]", "log.csv[right]"]
    np.testing.assert_allclose(logs[1].response.real, STEP.real, rtol=1e-12)


def test_a_name_behind_a_point_stands_back_behind_the_name_itself(save):
    (log,) = read_logs(save(table(",".join([*OWN, "raw.wq_um"]), *OWN.values(), F)))
    check_own(log)
    assert "column raw.wq_um is kept out of the fit" in log.notes
