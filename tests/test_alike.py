"""Files that are read by the plan of another with the same head: their logs and their errors are those of the
exact reader."""

import dataclasses

import numpy as np
import pytest

import sysid
from sysid.fleet.groups import grouped
from sysid.logs import alike
from sysid.logs.alike import Alike
from sysid.logs.read import read_logs

STEP = "time_s,voltage_V,frequency_Hz,wd_um,wq_um"
SWEEP = "frequency_kHz,wd_nm,wq_nm"


def told(plate="A1", more=""):
    return f"# plate: {plate}\n# temperature_degC: 24.0\n# sampling: instant\n{more}"


def rows(seed=0, count=60):
    """Rows of a step as text, with digits that no rounding leaves alone."""
    y = np.random.default_rng(seed).standard_normal((count, 2))
    return "".join(
        f"{1e-4 * k:.4f},{100 * (k > 9)},32290,{a!r},{b:.3e}\n" for k, (a, b) in enumerate(y.tolist())
    )


def swept(seed=0):
    y = np.random.default_rng(seed).standard_normal((50, 2))
    return "".join(f"{32 + 0.01 * k:.2f},{a:.6g},{b:.6g}\n" for k, (a, b) in enumerate(y.tolist()))


def written(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def outcome(reader, paths):
    """The fields of the logs, or the sentence that refuses them."""
    try:
        logs = reader(paths)
    except sysid.LogError as error:
        return str(error)
    return [{f.name: getattr(log, f.name) for f in dataclasses.fields(log)} for log in logs]


def assert_same(found, expected):
    assert type(found) is type(expected), (found, expected)
    if isinstance(expected, str):
        assert found == expected
        return
    for one, other in zip(found, expected, strict=True):
        for name, value in other.items():
            if isinstance(value, np.ndarray):
                assert one[name].dtype == value.dtype and not one[name].flags.writeable
                np.testing.assert_array_equal(one[name], value, err_msg=name)
            else:
                assert one[name] == value, name


def taught(where, head, body):
    """A reader that knows files of such a head."""
    reader = Alike()
    for k in range(2):
        outcome(reader.read, [written(where / f"taught{k}.csv", head(f"T{k}") + body(90 + k))])
    return reader


STEPS = {
    "another plate": told("B 7/x") + f"{STEP}\n" + rows(1),
    "fewer rows": told() + f"{STEP}\n" + rows(2, 41),
    "another temperature": told().replace("24.0", "25.25") + f"{STEP}\n" + rows(3),
    "another drive": told() + f"{STEP}\n" + rows(4).replace(",100,", ",60,"),
    "a time that lasts": told() + f"{STEP}\n" + rows(5).replace("0.0059,", "0.0069,"),
    "a plate behind blanks": told().replace("# plate: ", "#  plate :  ") + f"{STEP}\n" + rows(6),
    "no last line end": told() + f"{STEP}\n" + rows(7).rstrip(),
    "lines that end in CR LF": (told() + f"{STEP}\n" + rows(8)).replace("\n", "\r\n"),
    "rows that end in CR LF": told() + f"{STEP}\n" + rows(8).replace("\n", "\r\n"),
    "a carriage return": told() + f"{STEP}\n" + rows(9).replace("\n", "\r", 3),
    "a word": told() + f"{STEP}\n" + rows(10).replace(",100,", ",on,", 1),
    "an empty cell": told() + f"{STEP}\n" + rows(11).replace(",0,32290,", ",0,,", 1),
    "an overload": told() + f"{STEP}\n" + rows(12).replace(",100,", ",9.9e37,", 1),
    "infinity": told() + f"{STEP}\n" + rows(12).replace(",100,", ",1e999,", 1),
    "a sign": told() + f"{STEP}\n" + rows(13).replace(",100,", ",+-1,", 1),
    "a cell too few": told() + f"{STEP}\n" + rows(14).replace(",32290,", ",", 1),
    "a cell too many": told() + f"{STEP}\n" + rows(15).replace(",32290,", ",32290,1,", 1),
    "one too few and one too many": told()
    + f"{STEP}\n"
    + rows(15).replace("0.0020,100,32290,", "0.0020,100,32290,1,").replace("0.0021,100,", "0.0021,"),
    "a blank line": told() + f"{STEP}\n" + rows(16).replace("\n", "\n\n", 1),
    "a comment below": told() + f"{STEP}\n" + rows(17) + "# the end\n",
    "the header again": told() + f"{STEP}\n" + rows(18) + f"{STEP}\n" + rows(19),
    "no rows": told() + f"{STEP}\n",
    "one row": told() + f"{STEP}\n" + rows(20, 1),
    "nothing": "",
    "the head alone": told(),
    "half a head": told()[:20],
    "time that goes back": told() + f"{STEP}\n" + rows(21).replace("0.0030,", "0.0010,"),
    "a frequency below zero": told() + f"{STEP}\n" + rows(22).replace(",32290,", ",-32290,", 1),
    "below absolute zero": told().replace("24.0", "-300") + f"{STEP}\n" + rows(23),
    "a temperature that is none": told().replace("24.0", "1e40") + f"{STEP}\n" + rows(23),
    "a room in kelvin": told().replace("24.0", "297.0") + f"{STEP}\n" + rows(23),
    "a plate with an equals sign": told("a=b") + f"{STEP}\n" + rows(24),
    "a plate with a colon": told("a: b") + f"{STEP}\n" + rows(24),
    "a plate in Greek": told("\u03b17") + f"{STEP}\n" + rows(25),
    "a plate in another encoding": (told("\u00fc7") + f"{STEP}\n" + rows(25)).encode("cp1252"),
    "no plate": told().replace("# plate: A1\n", "") + f"{STEP}\n" + rows(26),
    "an empty plate": told("") + f"{STEP}\n" + rows(26),
    "two plates": told() + f"# plate: A2\n{STEP}\n" + rows(26),
    "plates in capitals": told() + f"# PLATE: A2\n{STEP}\n" + rows(26),
    "other metadata": told(more="# humidity: 40\n") + f"{STEP}\n" + rows(27),
    "a delay": told(more="# delay_s: 1e-5\n") + f"{STEP}\n" + rows(27),
    "a byte order mark": b"\xef\xbb\xbf" + (told() + f"{STEP}\n" + rows(28)).encode(),
    "a zero byte": told() + f"{STEP}\n" + rows(28).replace("32290", "322\x0090", 1),
    "other names": told() + "time_s,voltage_V,frequency_Hz,wq_um,wd_um\n" + rows(29),
    "a column more": told() + f"{STEP},note\n" + rows(29).replace("\n", ",1\n"),
    "an end of another kind": told() + f"{STEP}\n" + rows(30) + ",,,,\n",
    "no numbers in the last column": told() + f"{STEP}\n" + "".join(f"{k},0,32290,1,--\n" for k in range(60)),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_file_is_read_as_by_the_exact_reader(name, tmp_path):
    reader = taught(tmp_path, lambda plate: told(plate) + f"{STEP}\n", rows)
    path = written(tmp_path / "own.csv", STEPS[name])
    assert reader.known
    assert_same(outcome(reader.read, [path]), outcome(read_logs, [path]))
    assert_same(outcome(reader.read, [path]), outcome(read_logs, [path]))
    others = [
        written(tmp_path / f"beside{k}.csv", told(f"C{k}") + f"{STEP}\n" + rows(50 + k)) for k in range(2)
    ]
    for ahead in ([path], [others[0], path, others[1]]):
        reader.ahead(ahead)
        for each in ahead:
            assert_same(outcome(reader.read, [each]), outcome(read_logs, [each]))


@pytest.mark.parametrize("name", STEPS)
def test_a_file_s_plate_is_that_of_the_exact_reader(name, tmp_path, monkeypatch):
    found = []
    for quick in (True, False):
        known = taught(tmp_path, lambda plate: told(plate) + f"{STEP}\n", rows) if quick else Alike()
        monkeypatch.setattr("sysid.fleet.groups.alike", known)
        if not quick:
            monkeypatch.setattr(known, "plate", lambda path: (None, False))
        try:
            groups = grouped([written(tmp_path / "own.csv", STEPS[name])], "plate")
            found.append([(g.plate, g.refused) for g in groups])
        except sysid.LogError as error:
            found.append(str(error))
    assert found[0] == found[1]


HEADS = {
    "a sweep": (lambda p: f"# plate: {p}\n# voltage_V: 100\n# date: 2026-03-0{p[1:]}\n{SWEEP}\n", swept),
    "rms, with a serial number": (
        lambda p: f"# plate: {p}\n# serial: 10{p[1:]}\n{STEP.replace('_V', '_V_rms')}\n",
        rows,
    ),
    "with semicolons": (lambda p: told(p) + STEP.replace(",", ";") + "\n", lambda k: rows(k).replace(",", ";")),
    "with tabs": (lambda p: told(p) + STEP.replace(",", "\t") + "\n", lambda k: rows(k).replace(",", "\t")),
    "amplitudes": (lambda p: f"# plate: {p}\ntime_s,voltage_V,w_um\n", lambda k: "".join(f"{i},1,{i + k}\n" for i in range(50))),
    "a temperature a row": (
        lambda p: f"# plate: {p}\n{STEP},temperature_K\n",
        lambda k: rows(k).replace("\n", ",297.25\n"),
    ),
    "a number of no use": (lambda p: f"# plate: {p}\n# voltage_V: 10{p[1:]}\n# bench: {p[1:]}\n{SWEEP}\n", swept),
    "a duty cycle": (
        lambda p: f"# plate: {p}\n# volts_per_duty: 50\n{STEP.replace('voltage_V', 'duty')}\n",
        lambda k: rows(k).replace(",100,", ",0.5,"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADS)
def test_the_third_file_of_a_head_is_read_quickly_and_alike(name, tmp_path, monkeypatch):
    head, body = HEADS[name]
    reader = taught(tmp_path, head, body)
    path = written(tmp_path / "own.csv", head("T3").replace("# bench: 3", "# bench: 1") + body(3))
    expected = outcome(read_logs, [path])
    monkeypatch.setattr(alike, "read_logs", None)
    monkeypatch.setattr(alike, "logs_of", None)
    assert_same(outcome(reader.read, [path]), expected)
    assert reader.plate(path) == ("T3", True)
    reader.ahead([path])
    assert bool(reader.waiting) == (name != "a temperature a row")
    assert_same(outcome(reader.read, [path]), expected)


def test_a_file_that_changed_since_it_was_parsed_with_others_is_read_as_it_is(tmp_path):
    reader = taught(tmp_path, lambda plate: told(plate) + f"{STEP}\n", rows)
    path = written(tmp_path / "own.csv", told() + f"{STEP}\n" + rows(1))
    reader.ahead([path])
    written(tmp_path / "own.csv", told() + f"{STEP}\n" + rows(2, 50))
    assert_same(outcome(reader.read, [path]), outcome(read_logs, [path]))


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (lambda p: f"# plate: {p}\nsample,voltage_V,frequency_Hz,wd_um,wq_um\n", rows),
        (lambda p: f"# plate: {p}\nlog,voltage_V,frequency_Hz,wd_um,wq_um\n", rows),
        (lambda p: f"# plate: {p}\n# kind: waveform\ntime_s,drive_V,response_um\n", lambda k: "0,1,2\n1,2,3\n" * 30),
        (lambda p: f"# plate: {p}\n# samplng: instant\n{STEP}\n", rows),
        (lambda p: f"# plate: {p}\n", rows),
        (lambda p: f"plate {p}\nmore\n{STEP}\n", rows),
        (lambda p: f"# plate: {p}\nomega_rad/s,voltage_V,X_V,Y_V\n", lambda k: "1,2,3,4\n" * 50),
    ],
)  # fmt: skip
def test_other_tables_are_the_exact_reader_s(head, body, tmp_path):
    reader = taught(tmp_path, head, body)
    path = written(tmp_path / "own.csv", head("T3") + body(3))
    assert_same(outcome(reader.read, [path]), outcome(read_logs, [path]))


def test_two_files_of_one_plate(tmp_path):
    head, body = HEADS["a sweep"]
    reader = taught(tmp_path, head, body)
    paths = [written(tmp_path / f"own{k}.csv", head("T3") + body(k)) for k in (3, 4, 3)]
    other = written(tmp_path / "other.csv", head("T4") + body(5))
    for some in (
        paths[:2],
        paths,
        [paths[0], paths[0]],
        [paths[0], other],
        [*paths[:1], str(tmp_path / "no.csv")],
    ):
        assert_same(outcome(reader.read, some), outcome(read_logs, some))


def test_date_and_serial_change_no_sentence(tmp_path):
    """What they are is told of nothing else: no value of theirs is taken for a misspelt key of ours."""
    for value in ("instant", "steady", "A7", "24.0", "24.0 degC", "1e-4 s", "rms", "-1"):
        text = f"# plate: P\n# date: {value}\n# serial: {value}\n# sampling: instant\n{STEP}\n" + rows()
        (log,) = read_logs([written(tmp_path / "own.csv", text)])
        assert not log.warnings and not log.notes
