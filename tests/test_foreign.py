"""Files as other programs write them whose tables lie otherwise than a row a line, each from a plate in closed form."""

import re

import numpy as np
import pytest
from refusal import draft_of, refused

from sysid.logs.read import read_logs

TIME = 1e-4 * np.arange(60)
DRIVE = np.where(TIME > 0.00105, 50.0, 0.0)
STEP = 1.0 - np.exp(-np.clip(TIME - 0.0011, 0, None) / 1.67e-3) + 1e-4j * np.cos(1e4 * TIME)


def rows(*columns, mark=","):
    return "".join(mark.join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def step(stamps, name="time_us"):
    return f"{name},voltage_V,wd_um,wq_um\n" + rows(stamps, DRIVE, STEP.real, STEP.imag)


# A clock of 32 bits


@pytest.mark.parametrize(
    "name, scale, begin", [("time_us", 1, 0), ("time_ms", 1e-3, 0), ("time_s", 1e-6, -(2**31))]
)
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


@pytest.mark.parametrize(
    "names, mark", [("f|x in um|y in um", "|"), ("Frequency, Hz|X, um|Y, um", "|"), ("f |X|/um phi/deg", " ")]
)
def test_a_bar_parts_cells_or_stands_for_a_magnitude(save, names, mark):
    text = draft_of(save(names + "\n" + rows(F, W.real, W.imag, mark=mark)))
    assert len(re.findall(r"^\w+ = \{ column", text, re.M)) == 3 and ('"|X|/um"' in text) == (mark == " "), (
        text
    )


def test_a_bar_within_a_cell_of_markdown(save):
    text = (
        r"| f/Hz | \|Z\|/ohm | phi/deg |"
        + "\n|---|---|---|\n"
        + "".join(
            f"| {f} | {1e4 * abs(w)} | {np.degrees(np.angle(w))} |\n" for f, w in zip(F, W, strict=True)
        )
    )
    assert 'magnitude = { column = "|Z|/ohm", unit = "ohm" }' in draft_of(save(text))


# Circuit simulators


def raw(values, names, flags, body, plot="AC Analysis"):
    """The header of a plot and its body."""
    kinds = {"frequency": "frequency", "time": "time"}
    variables = "".join(f"\t{k}\t{name}\t{kinds.get(name, 'voltage')}\n" for k, name in enumerate(names))
    head = f"Title: plate\nDate: Sun Mar 31 12:00:00 2024\nPlotname: {plot}\nFlags: {flags}\n"
    return f"{head}No. Variables: {len(names)}\nNo. Points: {len(values)}\nVariables:\n{variables}{body}:\n"


AC = np.column_stack([F, 50.0 + 0 * F, W]).astype(complex)
TRAN = np.column_stack([TIME, DRIVE, STEP.real])
LISTED = "".join(
    f" {k}" + "".join(f"\t{x.real!r},{x.imag!r}\n" for x in row) + "\n" for k, row in enumerate(AC.tolist())
)
AC_HEAD = raw(AC, ("frequency", "v(in)", "v(out)"), "complex", "Values")
MAP = """kind = "steady"
columns.frequency = { column = "frequency [Hz]", unit = "Hz" }
columns.voltage = { column = "v(in) re [V]", unit = "V" }
columns.x = { column = "v(out) re [V]", unit = "V" }
columns.y = { column = "v(out) im [V]", unit = "V" }
amplitude = "peak"
quantity = "velocity"
phase_sign = 1
"""
RAW = {
    "text": (AC_HEAD + LISTED).encode(),
    "binary": AC_HEAD.replace("Values", "Binary").encode() + AC.tobytes(),
    "LTspice": AC_HEAD.replace("Values", "Binary").encode("utf-16-le") + AC.tobytes(),
    "after an operating point": raw([0], ("v(in)", "v(out)"), "real", "Values", "Operating Point").encode()
    + b" 0\t0.0\n\t0.0\n\n" + (AC_HEAD + LISTED).encode(),
}  # fmt: skip


@pytest.mark.parametrize("form", RAW)
def test_a_sweep_of_a_circuit_simulator(save, form):
    (log,) = read_logs(save(RAW[form], "plate.raw"), columns=save(MAP, "map.toml"))
    assert log.frequency.tolist() == F.tolist() and log.drive.tolist() == [50.0] * 61
    np.testing.assert_allclose(log.response, W / (2j * np.pi * F) * 1j, rtol=1e-12)


@pytest.mark.parametrize("form", ["float32", "float64"])
def test_a_transient_of_ltspice(save, form):
    """Times are float64, negative where points were left out; the others float32, unless all are double."""
    fields = [("t", "f8"), ("u", form), ("y", form)]
    body = np.array([(-t if k % 3 else t, u, y) for k, (t, u, y) in enumerate(TRAN.tolist())], fields)
    head = raw(TRAN, ("time", "V(in)", "V(out)"), "real forward", "Binary", "Transient Analysis")
    text = 'columns.time = { column = "time [s]" , unit = "s" }\ncolumns.w = { column = "V(out) [V]", unit = "V" }\n'
    text += 'columns.voltage = { column = "V(in) [V]", unit = "V" }\namplitude = "peak"\n'
    (log,) = read_logs(
        save(head.encode("utf-16-le") + body.tobytes(), "a.raw"), columns=save(text, "map.toml")
    )
    np.testing.assert_allclose(log.time, TIME, rtol=1e-15)
    np.testing.assert_allclose(log.response, STEP.real, atol=1e-7)
    assert log.drive.tolist() == DRIVE.tolist()


def test_steps_of_a_raw_file_are_experiments(save):
    twice = np.concatenate([AC, AC * [1, 1, 0.5]])
    head = AC_HEAD.replace("Points: 61", "Points: 122").replace("Values", "Binary")
    logs = read_logs(
        save(head.encode() + twice.tobytes(), "a.raw"), columns=save(MAP + 'split_by = "log"\n', "map.toml")
    )
    assert [log.name for log in logs] == ["a.raw[AC Analysis 1]", "a.raw[AC Analysis 2]"]
    np.testing.assert_allclose(logs[1].response, logs[0].response / 2)


@pytest.mark.parametrize("form, change, said", [
    ("binary", lambda raw: raw[:-8], "was the file written to its end"),
    ("text", lambda raw: raw[:-40], "was the file written to its end"),
    ("text", lambda raw: raw.replace(b"No. Points: 61", b"No. Points: x"), "No. Points 'x'"),
    ("text", lambda raw: raw.replace(b"Values:", b"values"), "expected its values"),
])  # fmt: skip
def test_damaged_raw_files(save, form, change, said):
    refused(save(change(RAW[form]), "plate.raw"), "plate.raw", said)


# Lines of InfluxDB


def lines(stamp="{ns}", tags="plate=A7,run=1", apart=False, response=STEP):
    text = ""
    for k, (u, y) in enumerate(zip(DRIVE.tolist(), response.tolist(), strict=True)):
        at = stamp.format(
            ns=1711886400000000000 + 100000 * k, us=1711886400000000 + 100 * k, s=1711886400 + k
        )
        fields = [f"voltage_V={u:.0f}i", f"wd_um={y.real!r}", f"wq_um={y.imag!r}", 'state="on, or off"']
        text += "".join(
            f"lock\\ in,{tags} {part} {at}\n" for part in (fields if apart else [",".join(fields)])
        )
    return text


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("unit", ["ns", "us", "s"])
def test_lines_of_influx(save, unit, apart):
    (log,) = read_logs(save("# DML\n" * apart + lines(f"{{{unit}}}", apart=apart), "export.lp"))
    np.testing.assert_allclose(log.time, TIME * (1e4 if unit == "s" else 1), rtol=1e-12)
    assert log.drive.tolist() == DRIVE.tolist() and log.response.tolist() == STEP.tolist()


def test_series_of_influx_are_experiments(save):
    logs = read_logs(save(lines() + lines(tags="plate=A7,run=2", response=2 * STEP)))
    assert [log.name for log in logs] == [
        "log.csv[lock\\ in,plate=A7,run=1]",
        "log.csv[lock\\ in,plate=A7,run=2]",
    ]
    assert logs[1].response.tolist() == (2 * STEP).tolist()


@pytest.mark.parametrize("line, said", [
    ("lock\\ in,plate=A7,run=1 wd_um=1 1711886400005900000", "again"),
    ("lock\\ in,plate=A7,run=1 wd_um=1 17118864", "a time since 1970"),
    ("lock\\ in,plate=A7,run=1 wd_um= 1711886400005900000", "expected a measurement"),
    ("lock\\ in,plate=A7,run=1 wd_um=0.5.5 1711886400005900000", "expected a measurement"),
    ("lock\\ in,plate=A7,run=1 wd_um=OL 1711886400005900000", "expected a measurement"),
    ("lock\\ in,plate=A7,run=1 wd_um=1 1711886500", "ns and s"),
])  # fmt: skip
def test_odd_lines_of_influx(save, line, said):
    refused(save(lines() + line), "log.csv", said)


# Sweeps side by side

TWO = [(F, W), (F + 7.0, 0.5 * W)]
BESIDE = {
    "counted": "frequency{}_Hz,wd{}_um,wq{}_um",
    "counted at the end": "frequency_Hz_{},wd_um_{},wq_um_{}",
    "counted behind a point": "Frequency (Hz).{},wd_um.{},wq_um.{}",
    "at temperatures": "frequency_Hz {}0C,wd_um {}0C,wq_um {}0C",
    "at drives": "frequency_Hz @{}V,wd_um @{}V,wq_um @{}V",
    "in groups": "frequency_Hz,wd_um,wq_um",
}


def beside(form, sweeps=TWO, mark=","):
    names = [form.format(*[k] * form.count("{")) for k in range(1, len(sweeps) + 1)]
    return ",".join(names) + "\n" + rows(*(x for f, w in sweeps for x in (f, w.real, w.imag)))


@pytest.mark.parametrize("form", BESIDE)
def test_sweeps_side_by_side(save, form):
    above = "10 °C,,,20 °C,,\n" if form == "in groups" else ""
    logs = read_logs(save(above + beside(BESIDE[form])))
    for log, (f, w) in zip(logs, TWO, strict=True):
        assert log.frequency.tolist() == f.tolist() and log.response.tolist() == w.tolist()
        assert "2 sweeps side by side" in " ".join(log.notes)
    stated = [{10.0}, {20.0}] if form in ("in groups", "at temperatures") else [set(), set()]
    assert [set() if log.temperature is None else {*log.temperature} for log in logs] == stated


def test_sweeps_over_one_frequency(save):
    text = "frequency_Hz,w_um (293.15 K),w_um (303.15 K),voltage_V\n" + rows(
        F, abs(W), 2 * abs(W), 50 + 0 * F
    )
    logs = read_logs(save(text))
    assert [{*log.temperature} for log in logs] == [{20.0}, {30.0}] and {*logs[0].drive} == {50.0}
    assert logs[1].response.tolist() == (2 * abs(W)).tolist()


@pytest.mark.parametrize("form", ["w_{0}_um", "{0} w (um)", "w [um] ({0})"])
@pytest.mark.parametrize("pair", [("up", "down"), ("Forward", "Backward"), ("hin", "rück")])
def test_sweeps_up_and_down(save, form, pair):
    """The first of them alone was drafted."""
    text = f"frequency_Hz,{','.join(form.format(word) for word in pair)},voltage_V\n"
    logs = read_logs(save(text + rows(F, abs(W), 2 * abs(W), 50 + 0 * F)))
    assert [log.name for log in logs] == [f"log.csv[{word}]" for word in pair]
    assert [log.response.tolist() for log in logs] == [abs(W).tolist(), (2 * abs(W)).tolist()]


def test_a_shorter_sweep_ends_above_the_others_and_a_bad_cell_is_named(save):
    lines = beside(BESIDE["counted"]).splitlines()
    text = "\n".join(lines[:40] + [line[: len(",".join(line.split(",")[:3]))] + ",,," for line in lines[40:]])
    logs = read_logs(save(text))
    assert [len(log) for log in logs] == [61, 39]
    refused(save(text.replace(repr(W.real[5].item()), "OL", 1)), "line 7, sweep 1", "'OL'")


@pytest.mark.parametrize(
    "names", ["f_Hz,X1_V,Y1_V,X2_V,Y2_V", "time_s,f1_Hz,X1_V,f2_Hz,X2_V", "f_Hz,S11,S21,S12,S22"]
)
def test_channels_are_no_sweeps(save, names):
    text = draft_of(save(names + "\n" + rows(F, W.real, W.imag, W.real, W.imag)))
    assert "split_by" not in text


def test_a_mapping_file_may_take_one_of_the_sweeps(save):
    text = beside("f{} [Hz],X{} [um],Y{} [um]")
    told = 'kind="steady"\namplitude="peak"\nquantity="displacement"\nphase_sign=1\n[columns]\n'
    form = "frequency = {{ column = {} }}\nx = {{ column = {} }}\ny = {{ column = {} }}\n"
    whole, one, third = [told + form.format(*of) for of in (
        ('"f [Hz]"', '"X [um]"', '"Y [um]"'), ('"f2 [Hz]"', '"X2 [um]"', '"Y2 [um]"'), ("3", "4", "5"))]  # fmt: skip
    path = save(text)
    assert [
        len(log)
        for log in read_logs(path, columns=save(whole.replace("[col", 'split_by = "log"\n[col'), "a.toml"))
    ] == [61, 61]
    for form in (one, third):
        (log,) = read_logs(path, columns=save(form, "b.toml"))
        assert log.frequency.tolist() == (F + 7).tolist()
