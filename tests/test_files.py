"""Files that are no text, each by its field's library: the columns as written, and hostile files refused.

What was written here is the truth; each file is made by the library's own writer, or byte by byte.
"""

import gzip
import io
import json
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from refusal import draft_of, refused
from test_drafts import answered, asked

from sysid.logs.log import LogError
from sysid.logs.read import read_logs
from sysid.tables import csvbody, store

F = np.arange(31800.0, 32801.0, 20.0)
S = 0.05 / (1 + 2j * np.pi * (F - 32300) * 1.67e-3) * np.exp(0.4j)
Y = 2j * np.pi * F * 2e-9 + 5e-4 / (1 + 2j * np.pi * (F - 32300) * 1.67e-3)  # S
COLUMNS = {"frequency_Hz": F, "X_V": S.real, "Y_V": S.imag}
OURS = {"frequency_Hz": F, "wd_um": S.real, "wq_um": S.imag}


def hdf(path, columns, group="sweep", **attributes):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        place = file.create_group(group)
        place.attrs.update(attributes)
        for name, values in columns.items():
            place[name] = values


def mat5(path, columns, **constants):
    io_ = pytest.importorskip("scipy.io")
    io_.savemat(path, {"meas": {**columns, **constants}}, do_compression=True)


def mat73(path, columns, **constants):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {**columns, **constants}.items():
            file.create_dataset(f"meas/{name}", data=np.atleast_2d(values))
    block = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(block.ljust(512, b"\x00") + path.read_bytes()[512:])


def parquet(path, columns):
    pytest.importorskip("pyarrow.parquet").write_table(pytest.importorskip("pyarrow").table(columns), path)


def feather(path, columns):
    pytest.importorskip("pyarrow.feather").write_feather(pytest.importorskip("pyarrow").table(columns), path)


def tdms(path, columns, **properties):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [nptdms.RootObject(properties), *(nptdms.ChannelObject("run", k, v) for k, v in columns.items())]
        )


def uff(path, frequency, signal, kind=8):
    pyuff = pytest.importorskip("pyuff")
    function = pyuff.prepare_58(
        binary=0, func_type=4, rsp_node=1, rsp_dir=3, ref_node=1, ref_dir=3, id1="plate A7", data=signal, x=frequency,
        abscissa_spec_data_type=18, ordinate_spec_data_type=kind, orddenom_spec_data_type=0, z_axis_spec_data_type=0,
    )  # fmt: skip
    pyuff.UFF(str(path)).write_sets(function, "overwrite")


def jsonlines(path, columns, **constants):
    lines = [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]
    path.write_text(
        "".join(json.dumps(line) + "\n" for line in [*([constants] if constants else []), *lines])
    )


WRITERS = {
    "a.h5": hdf, "b.mat": mat5, "c.mat": mat73, "d.parquet": parquet, "e.feather": feather, "f.tdms": tdms, "k.jsonl": jsonlines,
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_columns_of_the_contract_s_names_are_read_as_they_are(tmp_path, name):
    WRITERS[name](tmp_path / name, OURS)
    (log,) = read_logs(tmp_path / name)
    np.testing.assert_array_equal(log.response, S)
    np.testing.assert_array_equal(log.frequency, F)
    assert (log.kind, log.response_unit, log.name) == ("steady", "um", name)
    assert len(log.sha256) == 64


@pytest.mark.parametrize("name", WRITERS)
def test_other_columns_are_drafted_and_mapped_as_those_of_a_text(save, tmp_path, name):
    WRITERS[name](tmp_path / name, COLUMNS)
    draft = draft_of(tmp_path / name)
    assert asked(draft) == ["amplitude", "quantity", "phase_sign"]
    (log,) = read_logs(tmp_path / name, columns=save(answered(draft), "map.toml"))
    np.testing.assert_array_equal(log.response, 1j * S)
    columns = save(answered(draft).replace('"X_V"', '"X_W"'), "map.toml")
    refused(tmp_path / name, "[columns] x", "'X_W'", "did you mean 'X_V'", columns=columns)


@pytest.mark.parametrize("name", WRITERS)
def test_a_number_that_is_none_is_refused_by_its_row(tmp_path, name):
    WRITERS[name](tmp_path / name, OURS | {"wq_um": np.where(F == 32300, np.nan, S.imag)})
    refused(
        tmp_path / name,
        f"{name}, row 26",
        "'wq_um'",
        "found 'nan'",
        "a finite number",
        "% of what the log tells",
    )


CONSTANTS = [("a.h5", hdf), ("b.mat", mat5), ("c.mat", mat73), ("f.tdms", tdms), ("k.jsonl", jsonlines)]


@pytest.mark.parametrize(("name", "write"), CONSTANTS)
def test_what_is_constant_is_read(save, tmp_path, name, write):
    write(tmp_path / name, COLUMNS, drive_V=10.0, temperature_degC=24.0)
    draft = draft_of(tmp_path / name)
    assert "# drive: as each file states it, 10.0 V here" in draft and "24.0 degC here" in draft
    (log,) = read_logs(tmp_path / name, columns=save(answered(draft), "map.toml"))
    assert (set(log.drive), set(log.temperature)) == ({10.0}, {24.0})
    write(tmp_path / name, OURS, drive_V=10.0, temperature_degC=24.0)
    assert set(read_logs(tmp_path / name)[0].drive) == {10.0}


def test_complex_numbers_are_two_columns(save, tmp_path):
    for name, write in (("a.h5", hdf), ("b.mat", mat5)):
        write(tmp_path / name, {"f": F, "response": S})
        draft = refused(tmp_path / name, "response re, response im").mapping
        (log,) = read_logs(
            tmp_path / name,
            columns=save(answered(draft).replace('"f", unit = "V"', '"f", unit = "Hz"'), "map.toml"),
        )
        np.testing.assert_array_equal(log.response, 1j * S)


def test_groups_are_experiments_or_are_chosen(save, tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for k, name in enumerate(("first", "second"), 1):
            for column, values in OURS.items():
                file[f"{name}/{column}"] = values * (k if column != "frequency_Hz" else 1)
    logs = read_logs(path)
    assert [log.name for log in logs] == ["a.h5[/first]", "a.h5[/second]"]
    np.testing.assert_array_equal(logs[1].response, 2 * S)
    with h5py.File(path, "a") as file:
        file["third/settings"], file["third/names"] = np.arange(9.0), np.arange(9.0)
    refused(path, "3 tables (/first, /second, /third)", 'table = "/first"')
    (log,) = read_logs(path, columns=save('table = "/second"\n', "map.toml"))
    np.testing.assert_array_equal(log.response, 2 * S)
    refused(path, "no table '/fourth'", "/third", columns=save('table = "/fourth"\n', "map.toml"))


def test_what_belongs_to_text_is_noted_and_a_table_to_other_files(save, tmp_path):
    hdf(tmp_path / "a.h5", OURS)
    (log,) = read_logs(tmp_path / "a.h5", columns=save('delimiter = ";"\nskip = 3\n', "map.toml"))
    assert "delimiter, skip of the mapping file: of text, not used of an HDF5 file" in log.notes
    text = save("frequency_Hz,w_um\n1,2\n2,3\n")
    refused(text, "log.csv", "a text table", "'/sweep'", columns=save('table = "/sweep"\n', "map.toml"))


def test_units_that_are_attributes(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, unit in (("frequency", "kHz"), ("wd", "nm"), ("wq", "nm")):
            file[name] = {"frequency": F / 1e3, "wd": S.real, "wq": S.imag}[name]
            file[name].attrs["units"] = unit
    (log,) = read_logs(tmp_path / "a.h5")
    assert log.response_unit == "nm"
    np.testing.assert_allclose(log.frequency, F, rtol=1e-15)


def test_a_table_of_pandas_with_dates(tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    stamps = pandas.date_range("2024-03-01 12:00", periods=50, freq="100us")
    pandas.DataFrame({"timestamp": stamps, "voltage_V": 1.0, "w_um": np.arange(50.0)}).to_parquet(
        tmp_path / "a.parquet"
    )
    (log,) = read_logs(tmp_path / "a.parquet")
    np.testing.assert_allclose(log.time, 1e-4 * np.arange(50), rtol=0, atol=1e-12)


# Sound, universal files, Touchstone


@pytest.mark.parametrize("form", ["int16", "int32", "uint8", "float32"])
def test_samples_of_a_wav_file(save, tmp_path, form):
    wavfile = pytest.importorskip("scipy.io.wavfile")
    t = np.arange(9600) / 192000
    drive = 0.5 * np.sin(2 * np.pi * 32300 * t)
    full = {"int16": 2**15, "int32": 2**31, "uint8": 128, "float32": 1}[form]
    samples = np.stack([drive, 0.2 * drive], axis=1) * full + (128 if form == "uint8" else 0)
    wavfile.write(
        tmp_path / "a.wav", 192000, np.rint(samples).astype(form) if full > 1 else samples.astype(form)
    )
    draft = draft_of(tmp_path / "a.wav")
    assert asked(draft) == ["quantity", "drive", "response"]
    (log,) = read_logs(tmp_path / "a.wav", columns=save(answered(draft), "map.toml"))
    rough = 0.05 if form == "uint8" else 2e-4  # steps of 1/128 and 1/32768, over the response's 0.1
    np.testing.assert_allclose(np.abs(log.response[2:-2]), 0.1, rtol=rough)
    np.testing.assert_allclose(log.frequency[2:-2], 32300, rtol=1e-5)


def test_a_universal_file(save, tmp_path):
    uff(tmp_path / "a.uff", F, S)
    draft = refused(tmp_path / "a.uff", "frequency_Hz, displacement re, displacement im").mapping
    assert asked(draft) == ["amplitude", "phase_sign", "x", "y"]
    (log,) = read_logs(tmp_path / "a.uff", columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-6, atol=1e-8)  # of 6 digits
    (tmp_path / "b.txt").write_bytes((tmp_path / "a.uff").read_bytes())
    assert refused(tmp_path / "b.txt", "displacement re").mapping == draft.replace("a.uff", "b.txt")
    uff(tmp_path / "a.uff", F, S, kind=11)
    assert 'quantity = "velocity"' in draft_of(tmp_path / "a.uff")


def test_one_channel_alone_has_no_drive(tmp_path):
    """A struck fork: a draft would ask for columns that are not there."""
    wavfile = pytest.importorskip("scipy.io.wavfile")
    struck = np.exp(-np.arange(4000) / 1e3) * np.cos(0.06 * np.arange(4000))
    wavfile.write(tmp_path / "fork.wav", 44100, (3e4 * struck).astype(np.int16))
    error = refused(
        tmp_path / "fork.wav",
        "one channel alone (channel 1; sample_rate_Hz: 44100)",
        "a second channel",
        "time_s",
    )
    assert error.mapping is None


def one_port(y, r):
    return (1 - r * y) / (1 + r * y)


def touchstone(head, columns):
    return (
        head + "\n" + "".join(" ".join(f"{x:.15g}" for x in row) + "\n" for row in zip(*columns, strict=True))
    )


FORMS = {
    "# Hz S RI R 50": lambda s: (F, s.real, s.imag),
    "# HZ S RI R 50": lambda s: (F, s.real, s.imag),
    "! a VNA\n# kHz S MA R 50": lambda s: (F / 1e3, np.abs(s), np.degrees(np.angle(s))),
    "# MHz S DB R 50\n!freq dBS11 angS11": lambda s: (
        F / 1e6,
        20 * np.log10(np.abs(s)),
        np.degrees(np.angle(s)),
    ),
}


@pytest.mark.parametrize("head", FORMS)
@pytest.mark.parametrize("r", [50, 75])
def test_one_port_is_the_admittance_that_it_means(save, tmp_path, head, r):
    """A loaded Q without a word is what the reflection alone would give."""
    pytest.importorskip("skrf")
    path = tmp_path / "a.s1p"
    path.write_text(touchstone(head.replace("R 50", f"R {r}"), FORMS[head](one_port(Y, r))))
    draft = draft_of(path)
    assert asked(draft) == []
    for (log,) in (read_logs(path), read_logs(path, columns=save(draft, "map.toml"))):
        np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-9)
        assert log.response_unit == "C" and set(log.drive) == {1.0}


@pytest.mark.parametrize("place", ["series", "across"])
def test_two_ports_tell_where_the_plate_is(save, tmp_path, place):
    skrf = pytest.importorskip("skrf")
    r = 50.0
    z = 1 / Y
    s11, s21 = (
        (z / (z + 2 * r), 2 * r / (z + 2 * r))
        if place == "series"
        else (-r / (2 * z + r), 2 * z / (2 * z + r))
    )
    path = tmp_path / "a.s2p"
    path.write_text(
        touchstone("# Hz S RI R 50", (F, *(part for s in (s11, s21, s21, s11) for part in (s.real, s.imag))))
    )
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-8)
    turned = s21 * np.exp(1j)  # behind a cable of its own length: it may be either
    path.write_text(
        touchstone(
            "# Hz S RI R 50", (F, *(part for s in (s11, turned, turned, s11) for part in (s.real, s.imag)))
        )
    )
    refused(path, "neither in series nor across", 'table = "series" or table = "across"')
    table = save(f'table = "{place}"\n', "map.toml")
    network = skrf.Network(path)
    stated = -network.y[:, 1, 0] if place == "series" else 1 / network.z[:, 1, 0]
    (log,) = read_logs(path, columns=table)
    np.testing.assert_allclose(log.response, stated / (2 * np.pi * F), rtol=1e-9)
    assert "as preset:touchstone says" in " ".join(log.notes)


WRITTEN = {  # of CITI files, and how an array is written in each form
    "RI": lambda s: (s.real, s.imag),
    "MAGANGLE": lambda s: (np.abs(s), np.degrees(np.angle(s))),
    "DBANGLE": lambda s: (20 * np.log10(np.abs(s)), np.degrees(np.angle(s))),
}


def citi(f, arrays, form="RI", listed=False, mark=","):
    """A package as an HP 8753D writes it: segments of even steps, or a list of frequencies; then the arrays."""
    lines = ["CITIFILE A.01.00", "#NA VERSION HP8753D.06.14", "NAME DATA", f"VAR FREQ MAG {len(f)}"]
    lines += [f"DATA {name} {form}" for name in arrays]
    half = len(f) // 2
    parts = [f"SEG {of[0]:.17g} {of[-1]:.17g} {len(of)}" for of in (f[:half], f[half:])]
    stated = [f"{x:.17g}" for x in f] if listed else parts
    word = "VAR" if listed else "SEG"
    lines += [
        f"{word}_LIST_BEGIN",
        *stated,
        f"{word}_LIST_END",
        "COMMENT taken by hand",
        "CONSTANT TIME 1999 7 1",
    ]
    for s in arrays.values():
        rows = zip(*WRITTEN[form](s), strict=True)
        lines += ["BEGIN", *(f"{a:.15E}{mark}{b:.15E}" for a, b in rows), "END"]
    return "\n".join([*lines, ""])


@pytest.mark.parametrize("form", WRITTEN)
@pytest.mark.parametrize(("listed", "mark"), [(False, ","), (True, ", "), (True, "\t")])
def test_a_citi_file_is_the_touchstone_file_of_the_same_numbers(save, tmp_path, form, listed, mark):
    pytest.importorskip("skrf")
    path = tmp_path / "coil.CTI"
    path.write_text("\r\n".join(citi(F, {"S[1,1]": one_port(Y, 50)}, form, listed, mark).split("\n")))
    draft = draft_of(path)
    assert asked(draft) == []
    for (log,) in (read_logs(path), read_logs(path, columns=save(draft, "map.toml"))):
        np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-9)
        np.testing.assert_allclose(log.frequency, F, rtol=1e-15)
        assert log.response_unit == "C" and set(log.drive) == {1.0}
    assert "the reference impedance is taken as 50 ohm" in " ".join(log.notes)
    seventy_five = {"S[1,1]": one_port(Y, 75), "PORTZ[1]": np.full(len(F), 75 + 0j)}
    path.write_text(citi(F, seventy_five, form))
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-9)
    assert log.metadata["reference_ohm"] == "75" and "50 ohm" not in " ".join(log.notes)


def test_a_citi_file_of_two_ports_or_of_a_transmission(save, tmp_path):
    pytest.importorskip("skrf")
    z, r = 1 / Y, 50.0
    s11, s21 = z / (z + 2 * r), 2 * r / (z + 2 * r)
    path = tmp_path / "a.citi"
    path.write_text(citi(F, {"S[1,1]": s11, "S[2,1]": s21, "S[1,2]": s21, "S[2,2]": s11}))
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-8)
    assert log.metadata["device"] == "in series"
    path.write_text(citi(F, {"S[2,1]": s21}))
    draft = refused(path, "found no response", "S21 re").mapping
    assert asked(draft) == ["quantity"]
    text = draft.replace('quantity = "?"', 'quantity = "transmission"').replace('unit = "?"', 'unit = "1"')
    (log,) = read_logs(path, columns=save(text + '[metadata]\ndevice = "in series"\n', "map.toml"))
    np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-8)


def test_what_a_citi_file_may_not_be_is_said(tmp_path):
    pytest.importorskip("skrf")
    path, s = tmp_path / "a.cti", one_port(Y, 50)
    whole = citi(F, {"S[1,1]": s})
    for text, *words in (
        (whole[: whole.index("\n", len(whole) // 2) + 1], "line 1", "was the file written to its end?"),
        (whole.removesuffix("END\n"), "line 1", "was the file written to its end?"),
        (whole.replace("VAR FREQ", "VAR POWER MAG 2\nVAR FREQ"), "POWER, FREQ", "FREQ alone"),
        (whole.replace(" RI", " MAG"), "an array in MAG", "MAGANGLE"),
        (whole.replace("S[1,1]", "V1"), "0 packages", "such as S[1,1]"),
        (whole + whole, "2 packages", "a file of its own"),
        (whole.replace("\nBEGIN\n", "\nBEGIN\nx\n"), "found 'x'", "two numbers"),
        (re.sub(r"SEG (.*) \d+\n", r"SEG \1 1000000000000\n", whole), "1000000000000'", "a segment"),
        (whole.replace("CITIFILE ", "CITIFILES "), "0 packages"),
        (whole.replace(f"MAG {len(F)}", f"MAG {len(F) + 1}"), f"found {len(F)} frequencies"),
    ):
        assert text != whole
        path.write_text(text)
        refused(path, "a.cti", *words)


def test_three_ports_are_refused(tmp_path):
    pytest.importorskip("skrf")
    rows = "".join("1000 " + " ".join(["0.1 0.2"] * 3) + "\n" + 2 * ("0.1 0.2 " * 3 + "\n") for _ in range(3))
    (tmp_path / "a.s3p").write_text("# Hz S RI R 50\n" + rows)
    refused(tmp_path / "a.s3p", "a.s3p", "3 ports")


def test_lines_of_lists_are_an_experiment_each(tmp_path):
    lines = [
        {"frequency_Hz": F.tolist(), "voltage_V": v, "w_um": (v * np.abs(S)).tolist()} for v in (1.0, 2.0)
    ]
    (tmp_path / "a.json").write_text("\n\n".join(map(json.dumps, lines)))
    first, second = read_logs(tmp_path / "a.json")
    np.testing.assert_array_equal(second.response, 2 * first.response)
    assert (set(first.drive), set(second.drive), len(first)) == ({1.0}, {2.0}, len(F))


def test_json_lines_may_be_packed_nested_and_hold_texts(save, tmp_path):
    rows = [
        {"at": f"2026-04-03T12:00:{k:02d}", "demod": {"x": k, "y": 2 * k}, "note": "ok"} for k in range(6)
    ]
    with gzip.open(tmp_path / "a.jsonl.gz", "wt") as file:
        file.write("\n".join(map(json.dumps, rows)))
    columns = 'quantity = "charge"\namplitude = "peak"\nphase_sign = 1\n[columns]\ntime = "at"\n'
    columns += 'x = { column = "demod.x", unit = "C" }\ny = { column = "demod.y", unit = "C" }\n'
    (log,) = read_logs(tmp_path / "a.jsonl.gz", columns=save(columns, "map.toml"))
    np.testing.assert_array_equal(log.time, np.arange(6.0))
    np.testing.assert_array_equal(log.response, 1j * (1 + 2j) * np.arange(6))


def test_a_row_without_a_name_has_an_empty_cell_there(tmp_path):
    rows = [{"frequency_Hz": f, "w_um": abs(s)} for f, s in zip(F, S, strict=True)]
    del rows[3]["w_um"]
    rows[4]["w_um"] = None
    jsonl = "\n".join(map(json.dumps, rows))
    (tmp_path / "a.jsonl").write_text(jsonl)
    (log,) = read_logs(tmp_path / "a.jsonl")
    assert len(log) == len(F) - 2 and "left out" in " ".join(log.notes)


HOSTILE_LINES = {
    '{"w_um": 1}\n{"w_um"\n': ("line 2", "no JSON object"),
    '{"w_um": 1, "w_um": 2}': ("line 1", "'w_um' is there twice"),
    '{"a":' * 100_000: ("line 1", "no JSON object"),
    '{"a":' * 20 + "1" + "}" * 20: ("line 1", "objects within objects"),
    '{"w_um": [[1, 2], [3, 4]]}': ("line 1", "lists within a list"),
    '{"w_um": [1, 2], "time_s": [1]}': ("line 1", "lists of 1 and 2 values"),
    '{"w_um": 1}\n{"w_um": 2}\n{"w_um": [1, 2]}': ("lines of rows and lines of lists",),
    '{"w_um": 1}\n[1, 2]\n': ("line 2", "a list"),
    '{"w_um": 1' + "0" * 5000 + "}": ("line 1", "no JSON object"),
}


@pytest.mark.parametrize("text", HOSTILE_LINES, ids=lambda text: text[:24])
def test_json_lines_that_are_none_are_refused_by_line(tmp_path, text):
    (tmp_path / "a.jsonl").write_text(text)
    refused(tmp_path / "a.jsonl", "a.jsonl", *HOSTILE_LINES[text])


@pytest.mark.study
def test_rows_of_ever_new_names_do_not_fill_the_memory(tmp_path):
    (tmp_path / "a.jsonl").write_text("".join(f'{{"a": 1, "b{k}": 1}}\n' for k in range(10_000)))
    refused(tmp_path / "a.jsonl", "a.jsonl, line 409", "4096 names")


# Hostile files


def bytes_of(name, tmp_path):
    path = tmp_path / f"whole_{name}"
    if name in WRITERS:
        WRITERS[name](path, OURS)
    elif name == "g.uff":
        uff(path, F, S)
    elif name == "h.wav":
        pytest.importorskip("scipy.io.wavfile").write(
            path, 192000, np.arange(4000, dtype=np.int16).reshape(-1, 2)
        )
    elif name == "j.cti":
        pytest.importorskip("skrf")
        path.write_text(citi(F, {"S[1,1]": one_port(Y, 50)}))
    else:
        pytest.importorskip("skrf")
        path.write_text(touchstone("# Hz S RI R 50", FORMS["# Hz S RI R 50"](one_port(Y, 50))))
    return path.read_bytes()


@pytest.mark.filterwarnings("ignore")  # of the libraries, in what they leave open
@pytest.mark.parametrize("name", [*WRITERS, "g.uff", "h.wav", "i.s1p", "j.cti"])
def test_damaged_files_are_read_or_refused_by_name(tmp_path, name):
    """Cut off at any place, with bytes changed or doubled: a log, or a LogError that names the file."""
    whole, path = bytes_of(name, tmp_path), tmp_path / name
    rng = np.random.default_rng(len(name) + ord(name[0]))
    for k in range(24):
        content = bytearray(whole[: int(rng.integers(1, len(whole)))] if k % 2 else whole)
        for _ in range(0 if k < 10 else 3):
            at = int(rng.integers(0, len(content)))
            content[at : at + 1] = bytes(rng.integers(0, 256, int(rng.integers(0, 4)), dtype=np.uint8))
        path.write_bytes(bytes(content))
        try:
            logs = read_logs(path)
        except LogError as error:
            assert name in str(error)
        else:
            assert all(np.isfinite(log.response).all() for log in logs)


def test_numbers_that_are_claimed_and_not_there(tmp_path, monkeypatch):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("frequency_Hz", (10**9,), "f8", chunks=(1000,))
    assert path.stat().st_size < 20_000
    refused(path, "a.h5, /frequency_Hz", "1000000000 numbers claimed", str(store.MOST))
    with h5py.File(path, "w") as file:
        file.create_dataset("w_um", (1000,), "f8", chunks=(1000,))
    refused(path, "a.h5, /w_um", "1000 numbers claimed and none stored")
    monkeypatch.setattr(store, "MOST", 100_000)
    pyarrow, parquet_ = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    column = pyarrow.DictionaryArray.from_arrays(pyarrow.array(np.zeros(1000, np.int8)), pyarrow.array([1.5]))
    table = pyarrow.table({"w_um": pyarrow.chunked_array([column] * 150)})
    parquet_.write_table(table, tmp_path / "a.parquet")
    refused(tmp_path / "a.parquet", "a.parquet", "150000 numbers claimed")


def peak(path):
    """Megabytes that a process of its own takes at most to read a file, and what it says."""
    script = "from sysid import LogError, read_logs\n"
    script += f"try: read_logs({str(path)!r})\nexcept LogError as error: print(error)\n"
    # not getrusage, which begins with what the process had that started this one
    script += "print(next(int(line.split()[1]) // 1024 for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    *said, used = done.stdout.splitlines()
    return int(used), " ".join(said)


def test_a_feather_file_is_counted_before_it_is_unpacked(tmp_path):
    """49 kB that would be 1.6 GB."""
    if not Path("/proc/self/status").exists():
        pytest.skip("how much memory a process took at most is not told here")
    feather_, pyarrow = pytest.importorskip("pyarrow.feather"), pytest.importorskip("pyarrow")
    zeros = pyarrow.array(np.zeros(1_000_000))
    table = pyarrow.table({"w_um": pyarrow.chunked_array([zeros] * 150)})
    feather_.write_feather(table, tmp_path / "a.feather", compression="zstd", chunksize=1_000_000)
    used, said = peak(tmp_path / "a.feather")
    assert "150000000 numbers claimed" in said and used < 600


def test_a_packed_text_ends_where_it_holds_too_much(tmp_path, monkeypatch):
    with gzip.open(tmp_path / "a.csv.gz", "wt") as file:
        file.write("time_s,w_um\n" + "".join(f"{k},1\n" for k in range(3000)))
    assert len(read_logs(tmp_path / "a.csv.gz")[0]) == 3000
    monkeypatch.setattr(csvbody, "UNPACKED", 2000)
    refused(tmp_path / "a.csv.gz", "a.csv.gz", "more than 2000 numbers in a packed file", "unpack it")


def test_texts_and_samples_are_counted_before_they_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "MOST", 1000)
    wavfile = pytest.importorskip("scipy.io.wavfile")
    wavfile.write(tmp_path / "a.wav", 192000, np.zeros((600, 2), np.int16))
    refused(tmp_path / "a.wav", "a.wav", "1200 numbers claimed")
    for name in ("a.s1p", "a.uff"):
        (tmp_path / name).write_text("# Hz S RI R 50\n" + "1 2 3\n" * 1000)
        refused(tmp_path / name, name, "numbers claimed")
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("w_um", (100,), "S800", chunks=(10,))
    refused(tmp_path / "a.h5", "a.h5, /w_um", "10000 numbers claimed")
    jsonlines(tmp_path / "a.jsonl", {"time_s": np.arange(600.0), "w_um": np.arange(600.0)})
    refused(tmp_path / "a.jsonl", "a.jsonl, line 501", "numbers claimed")


def test_what_a_compressed_file_would_unpack_to_is_counted_first(tmp_path, monkeypatch):
    """Within a structure, of which a list of variables says nothing."""
    io_ = pytest.importorskip("scipy.io")
    path = tmp_path / "a.mat"
    io_.savemat(
        path, {"meas": {"w_um": np.zeros(1_000_000), "time_s": np.zeros(1_000_000)}}, do_compression=True
    )
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(store, "MOST", 1_000_000)
    refused(path, "a.mat", "numbers claimed")
    monkeypatch.undo()
    assert len(read_logs(path)[0]) == 1_000_000


def test_links_out_of_a_file_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    hdf(tmp_path / "other.h5", OURS)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frequency_Hz"] = h5py.ExternalLink("other.h5", "/sweep/frequency_Hz")
    refused(tmp_path / "a.h5", "a.h5, /frequency_Hz", "a link to another file", "other.h5")
    (tmp_path / "raw.bin").write_bytes(F.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("w_um", F.shape, "f8", external=[(str(tmp_path / "raw.bin"), 0, F.nbytes)])
    refused(tmp_path / "a.h5", "a.h5, /w_um", "in other files")
    layout = h5py.VirtualLayout(F.shape, "f8")
    layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "sweep/frequency_Hz", F.shape)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_virtual_dataset("w_um", layout)
    refused(tmp_path / "a.h5", "a.h5, /w_um", "in other files")


def test_groups_that_hold_themselves_end(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_group("a")
        file["a/again"] = file["a"]  # a hard link: the tree has no end
    refused(tmp_path / "a.h5", "groups within groups")


def test_objects_are_named_and_never_made(tmp_path):
    """An array of objects, a reference, a text where numbers are expected."""
    io_, h5py = pytest.importorskip("scipy.io"), pytest.importorskip("h5py")
    cells = np.empty(51, object)
    cells[:] = [np.arange(k + 1) for k in range(51)]
    io_.savemat(tmp_path / "a.mat", OURS | {"cells": cells, "note": "hello"})
    (log,) = read_logs(tmp_path / "a.mat")
    assert "cells (objects of shape" in " ".join(log.notes) and len(log) == 51
    io_.savemat(tmp_path / "b.mat", {"cells": cells})
    refused(tmp_path / "b.mat", "b.mat", "a MATLAB file without columns of numbers", "cells (objects")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.arange(5.0)
        file.create_dataset("references", (3,), h5py.ref_dtype)[:] = file["x"].ref
        file["frequency_Hz"] = np.array([b"a", b"b", b"c", b"d", b"e"])
        file["w_um"] = np.arange(5.0)
        file["voltage_V"] = np.arange(5.0)
    error = refused(tmp_path / "a.h5", "a.h5, row 1", "'frequency_Hz'", "found 'a'", "a finite number")
    assert error.mapping is None


def test_a_tdms_file_that_is_cut_off_is_refused(tmp_path, monkeypatch):
    """The library would read what is left of it."""
    tdms(tmp_path / "whole.tdms", OURS)
    (tmp_path / "a.tdms").write_bytes((tmp_path / "whole.tdms").read_bytes()[:-100])
    console = io.StringIO()
    monkeypatch.setattr(pytest.importorskip("nptdms.log").log_manager.console_handler, "stream", console)
    refused(tmp_path / "a.tdms", "a.tdms", "a damaged TDMS file", "less data than expected")
    assert console.getvalue() == ""


def test_a_wav_that_claims_more_than_it_holds(tmp_path):
    head = struct.pack(
        "<4sI4s4sIHHIIHH4sI",
        b"RIFF",
        36 + 2**31,
        b"WAVE",
        b"fmt ",
        16,
        1,
        2,
        192000,
        768000,
        4,
        16,
        b"data",
        2**31,
    )
    (tmp_path / "a.wav").write_bytes(head + np.arange(400, dtype=np.int16).tobytes())
    refused(tmp_path / "a.wav", "a.wav", "WAV file")


def test_a_pickle_under_another_name_is_never_opened(tmp_path):
    import pickle

    class Boom:
        def __reduce__(self):
            return (exec, ("raise SystemExit('it ran')",))

    buffer = io.BytesIO()
    pickle.dump(Boom(), buffer)
    for name in ("a.s1p", "a.ts", "a.mat", "a.uff", "a.h5", "a.csv", "a.ntwk"):
        (tmp_path / name).write_bytes(buffer.getvalue())
        refused(tmp_path / name, name)


def test_a_library_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "import_module", lambda name: (_ for _ in ()).throw(ImportError(name)))
    (tmp_path / "a.s1p").write_text("# Hz S RI R 50\n1 2 3\n")
    refused(
        tmp_path / "a.s1p",
        "a.s1p",
        "a Touchstone file",
        "skrf",
        "pip install 'sysid[touchstone]'",
        "save the log as CSV",
    )
