"""Files that nobody would write on purpose: each is read to the numbers that were written, or refused by
name.

Refused by name: a LogError that names the file, and says what was found and what was expected. Nothing else
may happen.
"""

import bz2
import gzip
import io
import itertools
import lzma
import os
import socket
import time
import zipfile

import numpy as np
import pytest
from conftest import study

from sysid.logs.log import LogError
from sysid.logs.read import read_logs
from sysid.tables import csvbody, csvfile, textfile

NAMES = ("time", "voltage", "frequency", "wd", "wq")
UNITS = ("s", "V", "Hz", "um", "um")
ROWS = (
    (0.0, 5.0, 32300.0, 0.125, -0.5),
    (0.1, 5.0, 32300.5, 0.25, 1e-7),
    (0.2, -4.0, 32301.0, 1234.5, -0.25),
)
HEADER = "time_s,voltage_V,frequency_Hz,wd_um,wq_um\n"
TEXT = HEADER + "".join(",".join(map(repr, row)) + "\n" for row in ROWS)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.csv"


def write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def check_rows(log, rows=ROWS, said=""):
    """The log holds these numbers, to the last bit."""
    columns = np.array(rows).T
    found = log.time, log.drive, log.frequency, log.response.real, log.response.imag
    for written, read in zip(columns, found, strict=True):
        assert written.tolist() == read.tolist(), said


def check_refused(path, *words):
    with pytest.raises(LogError) as error:
        read_logs([path])
    message = str(error.value)
    assert all(word in message for word in (str(path), *words)), message
    assert "cannot be read: " in message or (
        "found" in message and ("expected" in message or "did you mean" in message)
    ), message
    assert len(message) - len(str(path)) < 1000, "a message that no screen holds"


# --- one table in many spellings: 7 separators x 5 headers x 8 frames = 280 files
# -----------------------------------------

SEPARATORS = {
    "comma": (",", "."), "semicolon": (";", "."), "semicolon, decimal comma": (";", ","), "tab": ("\t", "."),
    "tab, decimal comma": ("\t", ","), "blanks": ("  ", "."), "blanks, decimal comma": ("   ", ","),
}  # fmt: skip
HEADERS = {
    "names": lambda mark: mark.join(f"{n}_{u}" for n, u in zip(NAMES, UNITS, strict=True)),
    "brackets": lambda mark: mark.join(f"{n.title()}[{u}]" for n, u in zip(NAMES, UNITS, strict=True)),
    "row of units": lambda mark: mark.join(NAMES) + "\n" + mark.join(UNITS),
    "comment": lambda mark: "# " + mark.join(f"{n}_{u}" for n, u in zip(NAMES, UNITS, strict=True)),
    "quotes": lambda mark: mark.join(f'"{n}_{u}"' for n, u in zip(NAMES, UNITS, strict=True)),
}
PACKED = (lambda raw: raw, gzip.compress, bz2.compress, lzma.compress)


BEFORE = ("", "\ufeff", "# plate: A7\n# temperature_degC: 24\n", "\n\n")  # what may stand around a table
AFTER = ("\n", "", "\n\n\n")


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("separator", SEPARATORS)
def test_spellings(path, separator, header):
    mark, decimal = SEPARATORS[separator]
    lines = [HEADERS[header](mark), *(mark.join(map(repr, row)).replace(".", decimal) for row in ROWS)]
    for k, (before, end) in enumerate(itertools.product(BEFORE, ("\n", "\r\n"))):
        text = (before + "\n".join(lines) + AFTER[k % 3]).replace("\n", end)
        (log,) = read_logs(write(path, PACKED[k % 4](text.encode())))
        check_rows(log, said=text)
        assert log.temperature is None or log.temperature.tolist() == [24.0] * 3


# --- cells
# -------------------------------------------------------------------------------------------------------------

CELLS = [
    "1.", ".5", "+.5", "-0", "1E-3", "1e+3", "9.8e37", "4.9e-324", "2.4e-324", "1e-400", "9007199254740993", "１", "١٢",
    "\u00a00.25", "0.25 ", '"0.25"', '" 0.25"', "123456789012345678901234567890", "0" * 400 + "1", "0." + "0" * 400 + "1e401",
    "1" + "0" * 400 + "e-400", "2.2250738585072011e-308", "0.1000000000000000055511151231257827021181583404541015625",
    "8.41e21", "6.0221407621e23", "5e-324", "0.3" + "0" * 200_000,
]  # fmt: skip


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: ascii(cell[:24]))
def test_a_number_however_it_is_written(path, cell):
    (log,) = read_logs(write(path, TEXT.replace("1234.5", cell)))
    assert log.response[2].real == float(cell.strip('" '))  # Python's own reading, which rounds correctly


NO_NUMBERS = [
    "", " ", "nan", "NaN", "inf", "-Infinity", "1e400", "-1e309", "1.#QNAN", "1.#INF", "NA", "N/A", "null", "None", "TRUE",
    "False", "#DIV/0!", "#N/A", "=1+1", "0x1F", "0b1", "1_000", "1 000", '"1,000"', '"1.000,5"', '"0,5"',
    "1e", "e5", "1e5.5", "1e+", "--5", "+-5", ".", "+", "1.5 V", "50%", "1j", "½", "0.25f", "0.25;1", "0.25#",
    "0.2\t5", "0.25\x009", "\x000.25", "0.25\u200b", '"0.2""5"', "'0.25'", "12:30:01", "2024-01-01", "2024-01-01T12:30:01Z",
    "OL", "overload", "-", "\ufffd", "nan(5)", "１２e", "1,,", "\ufeff1",
]  # fmt: skip


@pytest.mark.parametrize("cell", NO_NUMBERS, ids=ascii)
def test_a_cell_that_is_no_number(path, cell):
    check_refused(write(path, TEXT.replace("1234.5", cell)), "line 4")


# --- whole files that are refused
# -----------------------------------------------------------------------------------------


def zipped():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("log.csv", TEXT)
    return file.getvalue()


SEMICOLONS = "time_s;voltage_V;frequency_Hz;wd_um;wq_um\n"
PAIR = "time_s,w_um\n0,1\n1,2\n"
REFUSED = {
    "empty": (b"", "empty"),
    "line ends alone": (b"\n\r\n\n", "empty"),
    "blanks alone": (b"   \n \t ", "empty"),
    "byte order mark alone": ("\ufeff", "empty"),
    "commas alone": (b",,,\n,,,\n", "empty"),
    "comments alone": (b"#\n# a: b\n#", "only comment lines"),
    "header alone": (HEADER, "no rows"),
    "header without a line end": (HEADER[:-1], "no rows"),
    "one quote": (b'"', "no rows"),
    "quotes": (b'""""""""', "no rows"),
    "one number": (b"5", "without a header"),
    "numbers alone": (b"1,2,3\n4,5,6\n", "without a header"),
    "UTF-16 LE": (TEXT.encode("utf-16-le"), "binary"),
    "UTF-16 BE": (TEXT.encode("utf-16-be"), "binary"),
    "UTF-32": (TEXT.encode("utf-32"), "UTF-32"),
    "UTF-32 BE": (TEXT.encode("utf-32-be"), "binary"),
    "EBCDIC": (TEXT.encode("cp500"), ""),
    "packed UTF-16": (gzip.compress(TEXT.encode("utf-16")), "UTF-16"),
    "two byte order marks": ("\ufeff\ufeff" + TEXT, "did you mean time_s"),
    "carriage returns among the rows": (HEADER + TEXT[len(HEADER) :].replace("\n", "\r"), "carriage return"),
    "LF CR": (TEXT.replace("\n", "\n\r"), "carriage return"),
    "next line (U+0085)": (TEXT.replace("\n", "\u0085"), ""),
    "line separator (U+2028)": (TEXT.replace("\n", "\u2028"), ""),
    "form feed at the end": (TEXT + "\x0c\n", "line 5"),
    "control-Z at the end": (TEXT + "\x1a", "line 5"),
    "zeros among the rows": (TEXT + "\0" * 4096 + "\n", "line 5"),
    "gzip cut off": (gzip.compress(TEXT.encode())[:-9], "cannot be read"),
    "gzip and garbage": (gzip.compress(TEXT.encode()) + b"garbage", "cannot be read"),
    "gzip of another sum": (gzip.compress(TEXT.encode())[:-8] + b"\0" * 8, "cannot be read"),
    "gzip, two bytes of it": (b"\x1f\x8b", "cannot be read"),
    "gzip within gzip": (gzip.compress(gzip.compress(TEXT.encode())), "binary"),
    "bzip2 cut off": (bz2.compress(TEXT.encode())[:-9], "cannot be read"),
    "bzip2 broken": (b"BZh91AY&SY" + b"x" * 40, "cannot be read"),
    "xz cut off": (lzma.compress(TEXT.encode())[:-9], "cannot be read"),
    "xz broken": (b"\xfd7zXZ\x00" + b"x" * 40, "cannot be read"),
    "zip archive": (zipped(), "zip archive"),
    "old workbook": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 512, "a workbook of an old kind"),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + b"\0" * 512, "HDF5"),
    "MATLAB": (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + b" " * 90 + b"\0\1IM", "MATLAB"),
    "image": (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", ""),
    "web page": ("<!DOCTYPE html>\n<html><body>404</body></html>\n", ""),
    "JSON over several lines that is cut off": ('{\n"time_s": [0, 1],\n"w_um": [1, 2', "found no JSON ("),
    "JSON lines that are cut off": (
        '{"time_s": 0, "w_um": 1}\n{"time_s": 1, "w_um"',
        "line 2: found no JSON object",
    ),
    "pointer of large file storage": (
        "version https://git-lfs.github.com/spec/v1\noid sha256:ab\nsize 12\n",
        "",
    ),
    "one line without an end": (b"a" * (textfile.LONGEST + 1), "without a line end"),
    "short row": (TEXT + "0.3,5.0\n", "line 5"),
    "long row": (TEXT + "0.3,5,1,0,0,7\n", "line 5"),
    "cut-off row": (TEXT + "0.3,5.0,32", "still being written"),
    "cut-off number": (TEXT + "0.3,5.0,1,0.1,1e-", "still being written"),
    "commas in place of a row": (TEXT + ",,,,\n0.3,5,1,0,0\n", "line 5"),
    "blanks in place of a row": (HEADER + "   \n" + TEXT[len(HEADER) :], "line 2"),
    "a word among the rows": (TEXT + "pause\n" + TEXT[len(HEADER) :], "line 5"),
    "words with commas": (TEXT + "a,b,c,d,e\n0.3,1,1,1,1\n", "line 5"),
    "comment behind a row": (TEXT.replace("-0.25\n", "-0.25 # end\n"), "line 4"),
    "comment below the header": (HEADER + "# plate: A7\n" + TEXT[len(HEADER) :], "line 2"),
    "three header rows": ("time,w\ns,um\nch1,ch2\n0,1\n1,2\n", "line 3"),
    "units missing": ("time,wd,wq\ns,,um\n0,1,2\n1,1,2\n", "no unit"),
    "semicolons above, commas below": (TEXT.replace(HEADER, SEMICOLONS), "line 2"),
    "commas above, semicolons below": (TEXT.replace(",", ";").replace(SEMICOLONS, HEADER), "line 2"),
    "full-width commas": (TEXT.replace(",", "，"), "no response"),
    "quote over two lines": ('time_s,w_um,note\n0,1,"a\nb"\n1,2,c\n', ""),
    "quote that swallows rows": (
        'time_s,w_um,note\n0,1,"5 plate\n1,2,c\n2,3,"6 plate\n3,4,d\n',
        "line 2: found a quote",
    ),
    "quote that is not closed": (TEXT + '0.3,5,1,0,"1\n', "line 5: found a quote"),
    "field over two lines, of no numbers": ('t_s,f[Hz],w_mpp,e\n",,,\n,,",\n,,,\n', "line 2: found a quote"),
    "field over two lines": ('time_s,w_um,note\n0,1,"a\n1,2,b"\n2,3,c\n', "line 2: found a quote"),
    "thousands, decimal comma": (SEMICOLONS + "0;5;32.300;0,25;1\n1;5;32.300;0,5;2\n", "'32.300'"),
    "thousands, decimal point": (SEMICOLONS + "0;5;32,300;0.25;1\n1;5;32,300;0.5;2\n", "'32,300'"),
    "thousands or a decimal comma": (SEMICOLONS + "0;5;32,300;0;1\n1;5;32,300;0;2\n", "decimal ="),
    "decimal comma between commas": ("time_s,w_um\n0,0,25\n1,0,5\n", "line 2"),
    "decimal comma that begins late": (SEMICOLONS + "0;5;1;2;3\n" * 99 + "0;5;1;2,5;3\n", "line 101"),
    "column twice": (PAIR.replace("time_s,w_um", "w_um,w_um"), "w twice"),
    "column twice in two units": ("time_s,time_ms,w_um\n0,0,1\n1,1,2\n", "time twice"),
    "column and metadata": ("# time_s: 3\n" + PAIR, "time twice"),
    "units of two kinds": ("time_s,wd_um,wq_V\n0,1,2\n1,1,2\n", "one kind"),
    "unit that is none": (PAIR.replace("time_s", "time_hms"), "did you mean"),
    "unit of another kind": (PAIR.replace("time_s", "time_Hz"), "unit of time"),
    "unit that never ends": (PAIR.replace("w_um", "w [" + "V*" * 99 + "V]"), "unit"),
    "unit that is worked out for ever": (PAIR.replace("w_um", "w [V**9**9**9**9]"), "unit"),
    "dates": (PAIR.replace("0,", "2024-01-01,"), "'2024-01-01'"),
    "clock": (PAIR.replace("0,", "12:30:00,"), "'12:30:00'"),
    "time backwards": ("time_s,w_um\n2,1\n1,2\n1.5,3\n0,3\n", "line 3"),
    "below absolute zero": ("time_s,temperature_K,w_um\n0,300,1\n1,-300,2\n", "line 3"),
    "Celsius called Kelvin, in winter": ("# temperature_K: -5\n" + PAIR, "absolute zero"),
    "frequency below zero": ("frequency_Hz,w_um\n1,1\n-2,1\n", "line 3"),
    "per cent called a share": ("time_s,duty,w_um\n0,25,1\n1,50,2\n", "duty [%]"),
    "metadata that overflows": ("# temperature_degC: 1e400\n" + PAIR, "'1e400'"),
    "metadata with another unit": ("# voltage_V: 5 m\n" + PAIR, "'5 m'"),
    "metadata twice": ("# force_N: 1\n# force_N: 2\n" + PAIR, "twice"),
    "metadata twice in capitals": ("# lockin_tau_s: 1\n# Lockin_tau_s: 2\n" + PAIR, "twice"),
    "two plates": ("# plate: A7\n# plate: B2\n" + PAIR, "twice"),
    "two kinds": ("# kind: steady\n# Kind: transient\n" + TEXT, "twice"),
    "two samplings": ("# sampling: instant\n# sampling: settled\n" + TEXT, "twice"),
    "metadata of thousands": (
        "# frequency_Hz: 32.300\n" + PAIR.replace(",", ";").replace(";1", ";1,5"),
        "'32.300'",
    ),
    "filter that looks ahead": ("# lockin_tau_ms: -3\n" + PAIR, "0 or more"),
    "two and a half poles": ("# lockin_order: 2.5\n" + PAIR, "whole number"),
    "values that overflow": ("time_s,voltage_V_rms,w_um\n0,1.7e308,1\n1,1,2\n", "finite"),
    "names by the thousand": (
        ",".join(f"c{k}" for k in range(3000)) + "\n" + ",".join("1" * 3000) + "\n",
        "2980 more",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_files_that_are_refused_by_name(path, name):
    content, word = REFUSED[name]
    check_refused(write(path, content), word)


# --- odd files that are read
# ------------------------------------------------------------------------------------------------

READ = {
    "CR CR LF": TEXT.replace("\n", "\r\r\n"),
    "zeros at the end": TEXT + "\0" * 4096,
    "a spreadsheet's sep=": "sep=,\n" + TEXT,
    "commas below the rows": TEXT + ",,,,\n , ,\n,\n",
    "commas below the rows, without a line end": TEXT + ",,,,",
    "line ends of both kinds": TEXT.replace("\n", "\r\n", 2),
    "gzip in two parts": gzip.compress(HEADER.encode()) + gzip.compress(TEXT[len(HEADER) :].encode()),
    "gzip and zeros": gzip.compress(TEXT.encode()) + b"\0" * 512,
    "Latin-1 metadata": ("# by Zoë, 24 °C\n" + TEXT).encode("latin-1"),
    "bytes of no letter": b"# \x81\x8d\n" + TEXT.encode(),
    "metadata of three megabytes": "# x: " + "a,b,0;" * 500_000 + "\n" + TEXT,
    "empty metadata": "#\n# :\n# a:\n#: b\n" + TEXT,
    "the same metadata twice": "# plate: A7\n# Plate: A7\n" + TEXT,
    "index column": "".join(f"{k}," + line + "\n" for k, line in enumerate(TEXT.splitlines())).replace("0,time", ",time"),
    "commas in a note": TEXT.replace("\n", ',"a, b; c"\n').replace('"a, b; c"', "note", 1),
    "quotes in a note": TEXT.replace("\n", ',5" wide\n').replace('5" wide', "note", 1),
    "NUL in a note": TEXT.replace("\n", ",a\0b\n").replace("a\0b", "note", 1),
    "no UTF-8 in a note": TEXT.replace("\n", ",ü\n").replace("ü", "note", 1).encode("latin-1"),
    "a note of three megabytes": TEXT.replace("\n", ",note\n", 1).replace(".5\n", ".5," + "a" * 3_000_000 + "\n", 1)
    .replace("e-07\n", "e-07,\n").replace("-0.25\n", "-0.25,\n"),
    "notes that are twice": TEXT.replace("\n", ",1,2\n").replace("1,2", "a,a", 1),
    "empty columns at the end": TEXT.replace("\n", ",,\n"),
    "BZh is no name": TEXT.replace("\n", ",1\n").replace(",1\n", ",BZh\n", 1),
}  # fmt: skip


@pytest.mark.parametrize("name", [study(n) if "megabytes" in n else n for n in READ])
def test_odd_files_that_are_read(path, name):
    (log,) = read_logs(write(path, READ[name]))
    check_rows(log)


def test_labels_of_experiments_are_texts(path):
    """Two experiments that are called NA and None are two; 1 and 1.0 too."""
    labels = ["NA", "None", "nan", "", "1", "1.0", "é"]
    rows = "".join(f"{k},{label},{k + 0.5}\n" for k, label in enumerate(labels))
    logs = read_logs(write(path, "frequency_Hz,log,w_um\n" + rows))
    assert [log.name for log in logs] == [f"log.csv[{label}]" for label in labels]
    assert [log.response.tolist() for log in logs] == [[k + 0.5] for k in range(7)]


def test_parts_of_one_response_in_two_units(path):
    (log,) = read_logs(write(path, "time_s,wd_um,wq_nm\n0,1,500\n1,2,-250\n"))
    assert (log.response.tolist(), log.response_unit) == ([1 + 0.5j, 2 - 0.25j], "um")


def test_times_may_stand_still_and_long_since(path):
    (log,) = read_logs(write(path, "time_s,w_um\n1700000000.0001,1\n1700000000.0001,2\n1700000000.0002,3\n"))
    assert log.time.tolist() == [1700000000.0001, 1700000000.0001, 1700000000.0002]


@pytest.mark.study  # 30 MB
def test_a_hundred_thousand_columns(path):
    """Read in seconds (0.8 s where this was written), noted in one line; before, names by the thousand took
    minutes."""
    names, count = ",".join(f"channel_{k:06d}_V" for k in range(100_000)), 100_000
    rows = "".join(f"{k},{k * k},{','.join(['1'] * count)}\n" for k in range(3))
    began = time.process_time()
    (log,) = read_logs(write(path, f"time_s,w_um,{names}\n{rows}"))
    assert time.process_time() - began < 20
    assert log.response.tolist() == [0.0, 1.0, 4.0]
    assert len(log.notes) == 1 and "100000 columns" in log.notes[0] and len(log.notes[0]) < 600


# --- what is no file, and files that change
# ---------------------------------------------------------------------------------


def directory(path):
    path.mkdir()


def pipe(path):
    os.mkfifo(path)


def unix_socket(path):
    with socket.socket(socket.AF_UNIX) as listener:
        here = os.getcwd()
        os.chdir(path.parent)  # such an address may have a hundred characters
        try:
            listener.bind(path.name)
        finally:
            os.chdir(here)


def loop(path):
    path.symlink_to(path.with_name("other"))
    path.with_name("other").symlink_to(path)


def dangling(path):
    path.symlink_to("gone")


@pytest.mark.skipif(os.name != "posix", reason="made by calls of POSIX")
@pytest.mark.parametrize(
    ("make", "word"),
    [
        (directory, "a directory"),
        (pipe, "a pipe"),
        (unix_socket, "a socket"),
        (loop, "no such file"),
        (dangling, "no such file"),
    ],
)
def test_what_is_no_file(path, make, word):
    make(path)
    check_refused(path, word)


@pytest.mark.parametrize(
    "name", ["a\0b.csv", "a" * 300 + ".csv", "/".join(["a" * 200] * 30), os.fsdecode(b"\xff.csv"), "[.csv"]
)
def test_names_that_no_file_can_have_or_has_not(name):
    check_refused(name)


def test_a_file_that_may_not_be_read(path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied", str(path))

    write(path, TEXT)
    monkeypatch.setattr(csvfile, "open_text", refuse)  # an administrator may read what is forbidden
    with pytest.raises(LogError, match=r"log\.csv: cannot be read: .*Permission denied"):
        read_logs([path])


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    ("meanwhile", "word"),
    [
        (lambda path: path.write_bytes(path.read_bytes() * 2), ""),
        (lambda path: path.write_bytes(path.read_bytes()[:60]), ""),
        (lambda path: path.write_bytes(b""), ""),
        (lambda path: path.unlink(), "cannot be read"),
        (
            lambda path: (
                path.with_name("new").write_bytes(path.read_bytes()) and path.with_name("new").replace(path)
            ),
            "changed",
        ),
    ],
    ids=["grows", "shrinks", "is emptied", "is removed", "is another"],
)
def test_a_file_that_changes_while_it_is_read(path, monkeypatch, meanwhile, word, packed):
    """Between the header and the rows."""
    write(path, gzip.compress(TEXT.encode()) if packed else TEXT)
    read_body = csvbody.read_body

    def changed(*arguments):
        meanwhile(path)
        return read_body(*arguments)

    monkeypatch.setattr("sysid.logs.read.read_body", changed)
    with pytest.raises(LogError) as error:
        read_logs([path])
    assert str(path) in str(error.value) and word in str(error.value)
