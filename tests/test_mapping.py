"""Mapping files: every key, what lock-in signals become, what is refused, and real files of other
instruments."""

import math
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest
import refusal
from refusal import changed

from sysid.columns import mapfile, mapping
from sysid.logs.log import LogError
from sysid.logs.read import read_logs

ROOT = Path(__file__).resolve().parents[1]
MAPS = Path(__file__).parent / "mappings"
REAL = ROOT.parent / "shared" / "real"

XY = """
quantity = "displacement"
phase_sign = 1
amplitude = "peak"
[columns]
frequency = "f_Hz"
x = "X_V"
y = "Y_V"
"""
TABLE = "f_Hz,X_V,Y_V,T_C,sweep\n100,1,2,20,a\n200,3,-4,21,a\n400,5,6,22,b\n"
SIGNAL = np.array([1 + 2j, 3 - 4j, 5 + 6j])
OMEGA = 2 * np.pi * np.array([100.0, 200.0, 400.0])


@pytest.fixture
def read(save):
    """Reads a table through a mapping, both given as text."""
    return lambda toml, table=TABLE: read_logs(save(table), columns=save(toml, "map.toml"))


@pytest.fixture
def refused(save):
    def refuse(toml, *words, table=TABLE):
        message = str(refusal.refused(save(table), *words, columns=save(toml, "map.toml")))
        assert "map.toml" in message or "log.csv" in message

    return refuse


def near(log, expected):
    # 4e-16 is two roundings: of the product with j e^{j phase}, and of the division by omega
    np.testing.assert_allclose(log.response, expected, rtol=1e-15, atol=4e-16 * np.abs(expected).max())


# What a lock-in's signal becomes


@pytest.mark.parametrize(
    ("quantity", "expected", "unit"),
    [
        ("displacement", 1j * SIGNAL, "V"),
        ("charge", 1j * SIGNAL, "V"),
        ("velocity", SIGNAL / OMEGA, "V*s"),
        ("current", SIGNAL / OMEGA, "V*s"),
    ],
)
def test_quantities(read, quantity, expected, unit):
    (log,) = read(XY.replace("displacement", quantity))
    near(log, expected)
    assert log.response_unit == unit
    assert log.kind == "steady"
    assert log.notes == ()


def test_signs_of_the_contract(read):
    """A displacement has Wd = -Y, Wq = X; a velocity Wd = X / omega, Wq = Y / omega."""
    (log,) = read(XY)
    assert log.response.real.tolist() == [-2, 4, -6]
    assert log.response.imag.tolist() == [1, 3, 5]


@pytest.mark.parametrize(
    ("unit", "integral"), [("m/s", "m"), ("mm/s", "mm"), ("A", "C"), ("nA", "nC"), ("1", "s"), ("V", "V*s")]
)
def test_the_unit_of_a_velocity(read, unit, integral):
    toml = XY.replace("displacement", "velocity").replace('"X_V"', f'{{column = 1, unit = "{unit}"}}')
    toml = toml.replace('"Y_V"', f'{{column = 2, unit = "{unit}"}}')
    assert read(toml)[0].response_unit == integral


def test_phase_sign_and_offset(read):
    (log,) = read(XY.replace("phase_sign = 1", "phase_sign = -1\nphase_offset_deg = 30"))
    near(log, 1j * np.conj(SIGNAL) * np.exp(1j * math.pi / 6))


@pytest.mark.parametrize(("unit", "scale"), [("deg", 180 / math.pi), ("rad", 1.0)])
def test_magnitude_and_phase_are_x_and_y(read, unit, scale):
    rows = zip([100, 200, 400], np.abs(SIGNAL), np.angle(SIGNAL) * scale, strict=True)
    table = "f_Hz,R_V,phi\n" + "".join(f"{f},{r!r},{p!r}\n" for f, r, p in np.array(list(rows)).tolist())
    toml = XY.replace(
        'x = "X_V"\ny = "Y_V"', f'magnitude = "R_V"\nphase = {{ column = "phi", unit = "{unit}" }}'
    )
    near(read(toml, table)[0], 1j * SIGNAL)


def test_magnitude_alone_is_an_amplitude(read):
    (log,) = read(XY.replace('x = "X_V"\ny = "Y_V"', 'magnitude = "X_V"').replace("displacement", "velocity"))
    assert log.amplitude_only
    near(log, SIGNAL.real / OMEGA)


@pytest.mark.parametrize(("unit", "result"), [("dB", "1"), ("dBm", "mW^0.5"), ("dBV", "V")])
def test_decibels(read, unit, result):
    (log,) = read(
        f'amplitude = "peak"\n[columns]\ntime = "t_s"\nw = "P [{unit}]"', f"t_s,P [{unit}]\n0,-20\n1,6\n"
    )
    # 10^(6/20) = 1.995262314968880 as a table gives it, to 15 digits
    np.testing.assert_allclose(log.response, [0.1, 1.99526231496888], rtol=1e-14)
    assert log.response_unit == result


# Amplitudes, units, constants


def test_amplitude_is_for_drive_and_response(read):
    table = "t_s,U_V,d_um\n0,1,1\n1,2,2\n"
    toml = 'amplitude = "rms"\n[columns]\ntime = "t_s"\nvoltage = "U_V"\nw = "d_um"\n'
    (log,) = read(toml, table)
    assert log.drive.tolist() == log.response.tolist() == [math.sqrt(2), 2 * math.sqrt(2)]
    (log,) = read(toml.replace('"U_V"', '{ column = "U_V", amplitude = "pp" }'), table)
    assert log.drive.tolist() == [0.5, 1.0]
    (log,) = read(toml.replace('"d_um"', '{ column = "d_um", unit = "um_pp" }'), table)
    assert log.response.tolist() == [0.5, 1.0]


def test_whether_a_drive_is_rms_is_said_where_it_does_not_say_so_itself(read):
    """Of a column it is what `amplitude` says, a constant is peak."""
    table = "t_s,U_V,d_um\n0,1,1\n1,2,2\n"
    toml = 'amplitude = "rms"\n[columns]\ntime = "t_s"\nw = "d_um"\n'
    (log,) = read(toml + 'voltage = "U_V"\n', table)
    assert log.drive[0] == math.sqrt(2)
    assert any("voltage in column U_V is taken as rms, as amplitude says" in note for note in log.notes)
    (log,) = read(toml + '[constants]\nvoltage = "1 V"\n', table)
    assert log.drive[0] == 1
    assert any("constant voltage is taken as peak; write V_rms" in note for note in log.notes)
    for said in ('voltage = { column = "U_V", amplitude = "rms" }\n', '[constants]\nvoltage = "1 V_rms"\n'):
        (log,) = read(toml + said, table)
        assert log.drive[0] == math.sqrt(2) and not log.notes


def test_nothing_is_taken_for_granted_in_silence(read):
    (log,) = read(
        '[columns]\nfrequency = "f_Hz"\nx = "X_V"\ny = "Y_V"\nvoltage = { column = "T_C", unit = "V" }'
    )
    near(log, 1j * SIGNAL)
    said = " ".join(log.notes)
    assert all(
        word in said for word in ("voltage is taken as peak", "x is taken as peak", "quantity", "phase_sign")
    )
    assert "map.toml" in said
    (log,) = read('[columns]\ntime = "f_s"\nw = "d_um_rms"', "f_s,d_um_rms\n0,1\n")
    assert (log.notes, log.response.tolist()) == ((), [math.sqrt(2)])


def test_scale_offset_and_unit(read):
    column = '{ column = "T_C", unit = "mK", scale = 1000.0, offset = 273150 }'
    (log,) = read(XY + f"temperature = {column}\n")
    assert log.temperature.tolist() == pytest.approx(
        [20, 21, 22], abs=1e-10
    )  # 273.15 is taken off numbers near 293


def test_constants_and_metadata(read):
    toml = 'kind = "transient"\nsampling = "settled"\n' + XY.replace("frequency", "time").replace(
        "f_Hz", "t_s"
    )
    toml += '[constants]\nvoltage = "1 V_rms"\ntemperature = "293.15 K"\n'
    toml += '[metadata]\nplate = "A7"\nlockin_tau_ms = 3\n'
    (log,) = read(toml, TABLE.replace("f_Hz", "t_s"))
    assert log.drive.tolist() == [math.sqrt(2)] * 3
    assert log.temperature.tolist() == pytest.approx([20.0] * 3, abs=1e-12)
    assert (log.kind, log.sampling) == ("transient", "settled")
    assert log.bench == {"lockin_tau_s": 0.003}
    assert log.metadata["plate"] == "A7"


def test_duty_needs_no_unit(read):
    (log,) = read(XY + '[constants]\nduty = "0.5"\n[metadata]\nvolts_per_duty = 24\n')
    assert (log.drive.tolist(), log.drive_unit) == ([12.0] * 3, "V")


# A mapping file without [columns]

CONTRACT = "time_s,voltage_V,frequency_Hz,wd_um,wq_um\n0,1,100,1,2\n1,1,100,3,-4\n2,1,100,5,6\n"


def test_a_phase_sign_alone_is_of_the_contract_s_columns(read):
    """As the screen says to do where the phase rises through the resonance."""
    (plain,) = read("phase_sign = 1\n", CONTRACT)
    (log,) = read("phase_sign = -1\n", "# plate: A7\n" + CONTRACT)
    assert plain.response.tolist() == SIGNAL.tolist() and log.response.tolist() == np.conj(SIGNAL).tolist()
    assert (log.time.tolist(), log.drive.tolist(), log.frequency.tolist()) == ([0, 1, 2], [1] * 3, [100] * 3)
    assert (log.kind, log.metadata, log.notes, log.warnings) == ("transient", {"plate": "A7"}, (), ())
    (log,) = read("phase_sign = -1\nphase_offset_deg = 30\n", CONTRACT)
    near(log, np.conj(SIGNAL) * np.exp(1j * np.pi / 6))


def test_a_phase_sign_of_named_columns_wd_and_wq(read):
    """It was taken, and did nothing."""
    toml = 'amplitude = "peak"\nphase_sign = -1\n[columns]\nfrequency = "f_Hz"\nwd = "X_V"\nwq = "Y_V"\n'
    assert read(toml)[0].response.tolist() == np.conj(SIGNAL).tolist()


def test_a_phase_sign_where_there_is_no_phase_is_noted(read):
    said = "map.toml is not used: an amplitude has no phase"
    (log,) = read("phase_sign = -1\n", "time_s,w_um\n0,1\n1,2\n")
    assert log.response.tolist() == [1.0, 2.0] and said in " ".join(log.notes)
    (log,) = read('amplitude = "peak"\nphase_sign = -1\n[columns]\nfrequency = "f_Hz"\nw = "X_V"\n')
    assert log.kind == "steady" and said in " ".join(log.notes)


def test_what_else_a_mapping_without_columns_says(read, refused):
    toml = 'kind = "steady"\namplitude = "rms"\nrows = [0, 2]\n[constants]\ntemperature = "20 degC"\n[metadata]\nplate = "A7"\n'
    (log,) = read(toml, CONTRACT.replace("voltage_V", "voltage_V_pp"))
    np.testing.assert_allclose(log.response, math.sqrt(2) * SIGNAL[:2], rtol=1e-15)
    assert (log.drive.tolist(), log.temperature.tolist(), log.kind) == ([0.5] * 2, [20.0] * 2, "steady")
    assert log.metadata["plate"] == "A7"
    (log,) = read('decimal = ","\ndelimiter = ";"\n', CONTRACT.replace(",", ";").replace(";100;", ";100,5;"))
    assert log.frequency.tolist() == [100.5] * 3
    first, second = read('split_by = "run"\n', "run,time_s,w_um\na,0,1\nb,0,2\n")
    assert (first.name, second.name) == ("log.csv[a]", "log.csv[b]")
    refused(
        '[constants]\nvoltage = "1 V"\n', "[constants] voltage", "found voltage_V", "once", table=CONTRACT
    )
    refused('[constants]\nduty = "1"\n', "[constants] duty", "found voltage_V", table=CONTRACT)
    refused('quantity = "velocity"\n', "quantity", "belongs to x and y", table=CONTRACT)
    refused("", "[columns]", "found no response", table=CONTRACT)
    refused("phase_sign = -1\n[columns]\n", "[columns]", "found no response", table=CONTRACT)
    refused("phase_sign = -1\n", "no response", "columns such as wd_um and wq_um")


def test_constant_inputs_of_the_metadata_stand_where_the_mapping_says_nothing(read):
    """It was left out with a note, and no temperature was recorded."""
    above = (
        "# temperature_K: 297.15\n# Frequency [Hz]: 3\n# voltage_V_pp: 4\n# lockin_tau_s: 1\n# delay: 3 us\n"
    )
    (log,) = read(XY, above + TABLE)
    np.testing.assert_allclose(log.temperature, 24.0)
    assert log.drive.tolist() == [2.0] * 3 and log.frequency.tolist() == [100, 200, 400]
    assert log.bench == {"lockin_tau_s": 1.0}
    assert [note.partition(": ")[0] for note in log.notes] == [
        "metadata 'temperature_K' is read as the temperature",
        "metadata 'voltage_V_pp' is read as the voltage",
    ]
    assert log.warnings == ("log.csv: metadata 'delay' is not used; did you mean 'delay_us'?",)
    (log,) = read(XY + '[constants]\ntemperature = "20 degC"\nvoltage = "1 V"\n', above + TABLE)
    assert (log.drive[0], log.temperature[0], log.notes) == (1.0, 20.0, ())


def test_metadata_that_hold_no_number_stay_no_error(read):
    (log,) = read(XY, "# temperature_degC: room\n" + TABLE)
    assert log.temperature is None
    assert log.notes[0].startswith("metadata 'temperature_degC' is not used: found 'room', expected a finite")


def test_an_admittance_is_that_of_the_voltage_that_the_file_states(read):
    """Of an impedance the current is that of 1 V, whatever drove it."""
    siemens = XY.replace("displacement", "current")
    for name in ("X_V", "Y_V"):
        siemens = siemens.replace(f'"{name}"', f'{{ column = "{name}", unit = "S" }}')
    stated, plain = (read(siemens, above + TABLE)[0] for above in ("# voltage_V: 2\n", ""))
    assert (stated.drive[0], plain.drive[0]) == (2.0, 1.0)
    np.testing.assert_allclose(stated.response / stated.drive, plain.response / plain.drive)


# Which rows


def test_the_mapping_s_metadata_takes_the_place_of_the_file_s(read):
    table = "# Plate: B2\n# plate: C3\n" + TABLE
    assert read(XY + '[metadata]\nplate = "A7"\n', table)[0].metadata == {"plate": "A7"}


def test_split_by_and_rows(read):
    first, second = read('split_by = "sweep"\n' + XY)
    assert (first.name, second.name) == ("log.csv[a]", "log.csv[b]")
    near(second, 1j * SIGNAL[2:])
    assert read("split_by = 4\n" + XY)[0].name == "log.csv[a]"
    near(read("rows = [1, 3]\n" + XY)[0], 1j * SIGNAL[1:])
    near(read("rows = [[0, 1], [2, 3]]\n" + XY)[0], 1j * SIGNAL[[0, 2]])
    first, second = read('split_by = "sweep"\nrows = { a = [1, 2] }\n' + XY)
    near(first, 1j * SIGNAL[1:2])
    near(second, 1j * SIGNAL[2:])


def test_rows_that_are_not_used_may_hold_anything(read, refused):
    broken = TABLE.replace("200,3,-4", "200,overload,")
    near(read("rows = [[0, 1], [2, 3]]\n" + XY, broken)[0], 1j * SIGNAL[[0, 2]])
    refused("rows = [1, 3]\n" + XY, "line 3", "'X_V'", "'overload'", table=broken)


def test_a_date_for_a_time_is_called_one(refused):
    toml = '[columns]\ntime = {column = "f_Hz", unit = "s"}\nw = "X_V"'
    refused(
        toml,
        "line 3",
        "a date '2024-03-01T12:00'",
        "the seconds since",
        table=TABLE.replace("\n200", "\n2024-03-01T12:00"),
    )


# How the file is written


@pytest.mark.parametrize(
    ("options", "table"),
    [
        ('delimiter = ";"\ndecimal = ","\n', TABLE.replace(",", ";").replace(";1;", ";1,0;")),
        ('delimiter = "\\t"\n', TABLE.replace(",", "\t")),
        ('delimiter = " "\n', TABLE.replace(",", "   ").replace("\n", " \n  ")),
        ('comment = "%"\n', "% Time: 12\n%\n" + TABLE),
        ("header = true\n", TABLE),
        ("skip = 0\n", TABLE),
        ("skip = 1\n", "# temperature_degC: 3\n" + TABLE),
        ("skip = 3\n", "x: 1\n\x00\xff\n1,2,3,4,5\n# b: c\n" + TABLE),
        ("", "x: 1\n\ny,2\n" + TABLE.replace(",a", ",0").replace(",b", ",0")),
    ],
)
def test_dialects(read, options, table):
    near(read(options + XY, table)[0], 1j * SIGNAL)


def test_positions_without_header(read):
    toml = XY.replace('"f_Hz"', '{column = 0, unit = "Hz"}').replace('"X_V"', '{column = 1, unit = "V"}')
    toml = toml.replace('"Y_V"', '{column = 2, unit = "V"}')
    table = TABLE.partition("\n")[2]
    near(read("header = false\n" + toml, table)[0], 1j * SIGNAL)
    near(read(toml, "# a comment\n" + table)[0], 1j * SIGNAL)


def test_a_first_row_of_another_width_is_named(refused):
    """As where a line of another comment mark stands above the rows."""
    toml = 'comment = "!"\nheader = false\n[columns]\nfrequency = {column = 0, unit = "Hz"}\nw = {column = 1, unit = "V"}\n'
    table = "! Keysight\n# HZ S DB R 50\n1 2 3\n2 3 4\n"
    refused(toml, "line 3: found 3 columns", "expected 6 as in the first row, line 2", table=table)


def test_lines_that_are_skipped_are_counted_and_never_read(read, refused):
    table = "# temperature_degC: 80\nx,y\n# plate: A7\n" + TABLE
    (log,) = read("skip = 2\n" + XY, table)
    assert (log.metadata, log.temperature) == ({"plate": "A7"}, None)
    refused("skip = 2\n" + XY, "line 6", "'x'", table=table.replace("200,3", "200,x"))
    refused("skip = 9\n" + XY, "found 7 lines", "9", table=table)
    refused(
        "skip = 0\n" + XY, "no column 'f_Hz'", table="BEGIN\n" + TABLE.replace("a", "1").replace("b", "1")
    )


# Refusals


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("phase_sign", "phase_sing", ["phase_sing", "not a known key", "did you mean 'phase_sign'"]),
        ("frequency =", "frequenzy =", ["[columns] frequenzy", "did you mean 'frequency'"]),
        ('"X_V"', '"X_W"', ["[columns] x", "no column 'X_W'", "did you mean 'X_V'"]),
        ('"X_V"', "7", ["[columns] x", "position 7", "0 to 4"]),
        ('"X_V"', '{ unit = "V" }', ["[columns] x", "found no column"]),
        ('"X_V"', '{ column = "X_V", units = "V" }', ["[columns] x.units", "did you mean 'unit'"]),
        ('"X_V"', '{ column = "X_V", unit = "?" }', ["[columns] x", "the unit"]),
        ('"X_V"', '{ column = "X_V", scale = "2" }', ["[columns] x.scale", "'2'", "int or float"]),
        ('"X_V"', '"sweep"', ["[columns] x", "no unit", "x_um"]),
        ('"f_Hz"', '{ column = "f_Hz", unit = "khz" }', ["[columns] frequency", "did you mean 'kHz'"]),
        ('"peak"', '"RMS"', ["amplitude", "'RMS'", "'rms'"]),
        ('"displacement"', '"speed"', ["quantity", "'speed'", "'velocity'"]),
        ("phase_sign = 1", "phase_sign = 2", ["phase_sign", "2", "1, -1"]),
        ("phase_sign = 1", "phase_sign = true", ["phase_sign", "True"]),
        ('y = "Y_V"\n', "", ["[columns]", "found x", "x and y"]),
        ('y = "Y_V"\n', 'y = "Y_V"\nw = "X_V"\n', ["found w, x, y"]),
        ('x = "X_V"\ny = "Y_V"', 'w = "X_V"', ["quantity", "belongs to x and y"]),
        ('y = "Y_V"\n', 'y = "Y_V"\n[constants]\nfrequency = "3 Hz"\n', ["[constants] frequency", "once"]),
        (
            'y = "Y_V"\n',
            'y = "Y_V"\n[constants]\ntemperature = "warm"\n',
            ["temperature", "'warm'", "20 degC"],
        ),
        (
            'y = "Y_V"\n',
            'y = "Y_V"\n[constants]\nvoltage = "1 V"\nduty = "1"\n',
            ["duty and voltage", "one of them"],
        ),
        ('frequency = "f_Hz"\n', "", ["without frequency or drive"]),
        ("phase_sign", "delimiter = ''\nphase_sign", ["delimiter", "one character"]),
        ("phase_sign", "rows = [2, 9]\nphase_sign", ["rows", "[2, 9]", "0 to 3"]),
        ("phase_sign", "rows = []\nphase_sign", ["rows", "[]", "[first, last]"]),
        ("phase_sign", "rows = [[0, 1], 3]\nphase_sign", ["rows", "[[0, 1], 3]", "[first, last]"]),
        ("phase_sign", "rows = [true, false]\nphase_sign", ["rows", "True", "[first, last]"]),
        ("phase_sign", "rows = {a = [0, 1]}\nphase_sign", ["rows", "split_by"]),
        ("phase_sign", "split_by = 'sweep'\nrows = {a = 3}\nphase_sign", ["rows", "3", "[first, last]"]),
        ("phase_sign", "split_by = 'sweep'\nrows = {c = [0, 1]}\nphase_sign", ["experiment 'c'", "a, b"]),
        ("phase_sign", "skip = -1\nphase_sign", ["skip", "-1", "0 or more"]),
        ("phase_sign", "skip = 1.0\nphase_sign", ["skip", "1.0", "int"]),
        ("phase_sign", "skip = true\nphase_sign", ["skip", "True"]),
        ("phase_sign", "phase_offset_deg = nan\nphase_sign", ["phase_offset_deg", "finite"]),
        ("phase_sign", 'delimiter = "\\n"\nphase_sign', ["delimiter", "one character"]),
        ("phase_sign", "delimiter = 'é'\nphase_sign", ["delimiter", "one character"]),
        ('"X_V"', '{ column = "X_V", scale = inf }', ["[columns] x.scale", "finite"]),
        ('"X_V"', '{ column = "X_V", scale = 0 }', ["[columns] x.scale", "0"]),
        ('"X_V"', '{ column = "X_V", unit = "9**9**9**9" }', ["[columns] x", "unit"]),
        ('y = "Y_V"\n', 'y = "Y_V"\n[constants]\nwd = "1 um"\n', ["[constants] wd", "a column"]),
        (
            'y = "Y_V"\n',
            'y = "Y_V"\n[constants]\ntemperature = "-300 degC"\n',
            ["temperature", "-300", "absolute zero"],
        ),
        ("[columns]", "a = " + "[" * 2000 + "]" * 2000 + "\n[columns]", ["TOML"]),
        ("[columns]", "a = " + "1" * 5000 + "\n[columns]", ["TOML"]),
        ("phase_sign", "split_by = 'swep'\nphase_sign", ["split_by", "did you mean 'sweep'"]),
        ("[columns]", "[columns", ["TOML"]),
    ],
)
def test_a_wrong_mapping_is_refused_by_its_key(refused, old, new, words):
    refused(changed(XY, old, new), *words)


def test_a_velocity_needs_a_frequency(refused):
    toml = XY.replace("frequency", "time").replace("f_Hz", "t_s").replace("displacement", "velocity")
    refused(toml, "no frequency", "omega", table=TABLE.replace("f_Hz", "t_s"))


def test_a_column_name_that_stands_twice_needs_its_position(refused):
    refused(XY, "several columns 'X_V'", "position", table=TABLE.replace("Y_V", "X_V").replace("T_C", "Y_V"))


def test_a_mapping_file_that_is_not_there(tmp_path):
    with pytest.raises(LogError, match=r"none\.toml"):
        read_logs(tmp_path / "log.csv", columns=tmp_path / "none.toml")


def test_the_example_in_the_documentation_is_a_mapping(tmp_path):
    example = mapping.__doc__.partition("A full example:\n")[2].partition("\nThe names of")[0]
    path = tmp_path / "map.toml"
    path.write_text(textwrap.dedent(example))
    assert set(mapfile.load_mapping(path).options) == set(mapfile._OPTIONS)
    assert tomllib.loads(path.read_text())["rows"] == [100, 380]


def test_the_mapping_files_of_the_page_on_logs_are_some(save):
    """Those that it shows whole: each reads as a mapping file."""
    blocks = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8").split("```toml\n")[1:]
    shown = [mapfile.load_mapping(save(block.partition("```")[0], "map.toml")) for block in blocks]
    assert [bool(of.files) for of in shown] == [False, False, False, False, False, True]
    assert [of.dialect.join for of in shown] == [None, None, None, "Frequency", None, None]


# Files of other people's instruments

pytestmark_real = pytest.mark.skipif(not REAL.is_dir(), reason="the measured sets are not here")


def real(name, pattern):
    return read_logs(str(REAL / pattern), columns=MAPS / f"{name}.toml")


@pytestmark_real
def test_reed_temperature_sweeps():
    logs = real("reed_temperature_sweeps", "02*/reed_temperature_sweeps.csv")
    assert [len(log) for log in logs] == [501] * 11
    assert logs[0].name == "reed_temperature_sweeps.csv[0]"
    assert logs[0].temperature[0] == 33.287042
    assert logs[10].frequency[-1] == 169.0
    expected = 5.6975583e-05 * np.exp(1j * 1.2738765)  # j turned back by 90 degrees
    assert logs[0].response[0] == pytest.approx(expected, rel=1e-14)
    assert all(phase_falls(log, 140, 148) for log in logs)


@pytestmark_real
def test_reed_three_modes():
    logs = real("reed_three_modes", "02*/reed_three_modes.csv")
    assert [len(log) for log in logs] == [701] * 3
    assert logs[0].response[0] == pytest.approx(1j * (5.0061905e-05 - 1.9366667e-05j), rel=1e-14)
    assert all(phase_falls(*window) for window in zip(logs, (140, 900, 2545), (148, 916, 2565), strict=True))


@pytestmark_real
def test_microwave_resonators():
    (notch,) = real("microwave_notch", "05*/S21testdata.csv")
    assert len(notch) == 1001
    assert notch.response[0] == pytest.approx(1j * (1.473788 - 1.447411j), rel=1e-14)
    assert notch.response_unit == "1"
    (reflection,) = real("microwave_reflection", "05*/S11.txt")
    assert len(reflection) == 501
    expected = 1j * 10 ** (-29.0414199829 / 20) * np.exp(1j * np.radians(40.6561698914))
    assert reflection.response[0] == pytest.approx(expected, rel=1e-12)


@pytestmark_real
@pytest.mark.parametrize(
    ("name", "rows", "low", "high"),
    [
        ("mcta_1", 200, 1097, 1098.2), ("mcta_2", 200, 1095, 1099), ("mcta_3", 51, 1090, 1102),
        ("mcta_d1", 101, 0, 0), ("mcta_d2", 100, 0, 0), ("mcta_ov", 199, 0, 0),
        ("mctf_1", 51, 32110, 32160), ("w2ta_1", 51, 2064.215, 2064.235),
    ],
)  # fmt: skip
def test_wires_and_fork(name, rows, low, high):
    (log,) = real("fork" if name == "mctf_1" else "wires", f"06*/{name}.csv")
    assert (len(log), log.kind, log.response_unit) == (rows, "steady", "V*s")
    assert not high or phase_falls(log, low, high)


@pytestmark_real
def test_wire_values():
    (log,) = real("wires", "06*/mcta_1.csv")
    assert log.response[0] == pytest.approx(-(0.000114799 - 0.000119329j) / (2 * math.pi * 1082), rel=1e-14)
    assert log.time[0] == 1577276001.406


@pytestmark_real
def test_pzt_admittance():
    (log,) = real("pzt_admittance", "10*/pzt_bar_admittance.csv")
    assert (len(log), log.drive.tolist(), log.response_unit) == (301, [1.0] * 301, "C")
    assert log.response[0] == pytest.approx((1.47e-05 + 0.000357j) / (2 * math.pi * 110e3), rel=1e-14)
    assert phase_falls(log, 127.5e3, 128.8e3)


@pytestmark_real
@pytest.mark.parametrize(
    ("number", "rows", "start", "stop", "tau"),
    [
        (2542, 421, 24, 125, 31.459), (722, 99, 7.2, 19, 2.3275), (3413, 72, 15, 18, 0.47425),
        (795, 192, 45, 68, 4.4711), (488, 750, 0, 300, 158.69), (596, 28, 4.35, 4.75, 0.10507),
        (1838, 746, 0, 200, 46.436), (962, 233, 1.6, 2.3, 0.41364),
    ],
)  # fmt: skip
def test_membrane_ring_downs(number, rows, start, stop, tau):
    """The window of each file, and tau as a straight line through ln W gave it when the data were
    collected."""
    (log,) = real(f"ringdown_{number}", f"12*/measID_{number}_*")
    assert (len(log), log.kind, log.drive, log.response_unit) == (rows, "transient", None, "mW^0.5")
    assert log.relative_noise
    assert start <= log.time[0] <= log.time[-1] <= stop
    slope = np.polyfit(log.time, np.log(log.response), 1)[0]
    assert -1 / slope == pytest.approx(tau, rel=1e-4)  # it was printed with 5 digits


@pytestmark_real
def test_heater_steps():
    logs = real("heater", "13*/*.csv")
    assert [len(log) for log in logs] == [300, 7040, 648]
    assert all((log.response_unit, log.drive_unit, log.kind) == ("degC", "%", "transient") for log in logs)
    assert (np.diff(logs[1].time) == 0).any()
    (step,) = real("heater_step_30_35", "13*/step_data.csv")
    assert (len(step), step.drive[99], step.drive[100]) == (4141, 0.0, 5.0)
    assert step.response[-1] == pytest.approx(31.8 - 29.6, abs=1e-12)


def phase_falls(log, low, high):
    """Whether the phase falls through the resonance, once the background at the sweep's ends is taken off."""
    ends = np.interp(log.frequency, log.frequency[[0, -1]], [0, 1])
    signal = log.response - (1 - ends) * log.response[0] - ends * log.response[-1]
    near = (log.frequency >= low) & (log.frequency <= high)
    return np.polyfit(log.frequency[near], np.unwrap(np.angle(signal[near])), 1)[0] < 0


def test_rms_is_of_drive_and_response_alone(read):
    log = read(
        'amplitude = "rms"\n[columns]\nfrequency = "f_Hz"\ntemperature = {column = "T_C", unit = "degC"}\nw = "X_V"\n'
    )[0]
    np.testing.assert_array_equal(log.frequency, [100, 200, 400])
    np.testing.assert_array_equal(log.temperature, [20, 21, 22])
    np.testing.assert_allclose(log.response, np.sqrt(2) * np.array([1, 3, 5]), rtol=1e-15)  # one rounding


@pytest.mark.parametrize(
    ("stated", "constant", "told"),
    [
        ("voltage_V: 100", "50 V", True),
        ("voltage_V: 100", "0.1 kV", False),
        ("voltage_V_pp: 100", "50 V", False),
        ("Voltage: 100 Vpp", "100 V", True),
        ("voltage_V: 100", "100 V_rms", True),
    ],
)
def test_a_constant_that_a_file_states_otherwise_is_a_warning(tmp_path, stated, constant, told):
    """The mapping file's is taken, which holds for all files; the draft leaves it to each of them."""
    (tmp_path / "a.csv").write_text(f"# {stated}\nf (Hz),X (um),Y (um)\n32000,1,2\n32010,1,3\n32020,2,3\n")
    (tmp_path / "m.toml").write_text(
        'amplitude = "peak"\nphase_sign = 1\nquantity = "displacement"\n[columns]\n'
        'frequency = { column = "f (Hz)", unit = "Hz" }\nx = { column = "X (um)", unit = "um" }\n'
        f'y = {{ column = "Y (um)", unit = "um" }}\n[constants]\nvoltage = "{constant}"\n'
    )
    (log,) = read_logs(tmp_path / "a.csv", columns=tmp_path / "m.toml")
    assert any("which is taken" in warning for warning in log.warnings) is told
