"""Plain tables are read the short way, whatever is not plain by pandas: both give the same numbers, to the
last bit, and the same sentences.

The truth of the numbers is numpy's own reader.
"""

import numpy as np
import pandas as pd
import pytest

from sysid.logs import csvbody
from sysid.logs.csvfile import LogError
from sysid.logs.read import read_logs

HEAD = (
    "# plate: A7\n# temperature_degC: 24.0\n# sampling: instant\ntime_s,voltage_V,frequency_Hz,wd_um,wq_um\n"
)
ROWS = 120


def rows(seed):
    """Lines of numbers of all sizes, written in as many digits as tell them, or in few."""
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-30, 20, (ROWS, 2))
    w = sizes * rng.standard_normal((ROWS, 2))
    forms = [lambda x: repr(float(x)), lambda x: f"{x:.7g}", lambda x: f"{x:+.20e}", lambda x: f"{x:.6E}"]
    return [
        f"{k * 1e-4:.7g},{100.0 if k > 20 else 0},32290,{forms[k % 4](w[k, 0])},{forms[k % 3](w[k, 1])}"
        for k in range(ROWS)
    ]


def table(lines, end="\n", delimiter=","):
    text = HEAD + "\n".join(lines) + "\n"
    return text.replace(",", delimiter).replace("\n", end).encode()


def answer(path):
    """What a file comes to: the bits of its numbers, or the sentence that refuses it."""
    try:
        logs = read_logs(path)
    except LogError as error:
        return str(error)
    numbers = [x.tobytes() for log in logs for x in (log.response, log.time, log.drive, log.frequency)]
    return numbers, [(log.notes, log.warnings) for log in logs]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_numbers_to_the_last_bit(tmp_path, monkeypatch, end, delimiter):
    for seed in range(5):
        path = tmp_path / f"{seed}.csv"
        path.write_bytes(table(rows(seed), end, delimiter))
        with monkeypatch.context() as patch:
            patch.setattr(pd, "read_csv", None)
            (log,) = read_logs(path)
            short = answer(path)
        truth = np.loadtxt(path, delimiter=delimiter, skiprows=HEAD.count("\n"))
        np.testing.assert_array_equal(log.time, truth[:, 0])
        np.testing.assert_array_equal(log.response.view(float).reshape(-1, 2), truth[:, 3:])
        with monkeypatch.context() as patch:
            patch.setattr(csvbody, "SMALL", 0)
            assert short == answer(path)


def spoilt(kind):
    """The lines of a file that is not plain, in one row."""
    lines = rows(7)
    cells = lines[60].split(",")
    replaced = {
        "a word": "open", "nothing": "", "nan": "nan", "inf": "inf", "two points": "1.2.3",
        "a range": "1-2", "half a power": "1e", "a quote": '"', "no reading": "9.91e37", "huge": "1e999",
        "thousands": "1'000.5", "underscore": "1_0", "blanks": "  1.5 ", "signs": "+-1", "hex": "0x10",
        "tiny": "-1e-999", "zero": "-0",
    }  # fmt: skip
    if kind in replaced:
        lines[60] = ",".join([*cells[:3], replaced[kind], cells[4]])
    elif kind == "a cell lacks":
        lines[60] = ",".join(cells[:4])
    elif kind == "a cell too many":
        lines[60] += ",1"
    elif kind == "a cell moved":  # as many cells in all
        lines[60], lines[61] = ",".join(cells[:4]), f"{lines[61]},{cells[4]}"
    elif kind == "an end mark":
        lines[60] += ","
    elif kind == "a blank line":
        lines.insert(60, "")
    elif kind == "cut off":
        lines[-1] = lines[-1][:20]
    elif kind == "a remark":
        lines[60] = "the plate was touched"
    else:
        assert kind == "the header again"
        lines.insert(60, HEAD.splitlines()[-1])
    return lines


@pytest.mark.parametrize(
    "kind",
    [
        "a word", "nothing", "nan", "inf", "two points", "a range", "half a power", "a quote", "no reading",
        "huge", "thousands", "underscore", "blanks", "signs", "hex", "tiny", "zero", "a cell lacks",
        "a cell too many", "a cell moved", "an end mark", "a blank line", "cut off", "a remark",
        "the header again",
    ],
)  # fmt: skip
def test_the_same_sentence_either_way(tmp_path, monkeypatch, kind):
    """Among files of the same head too, which are read before."""
    for seed in range(3):
        (tmp_path / f"{seed}.csv").write_bytes(table(rows(seed)))
        assert not isinstance(answer(tmp_path / f"{seed}.csv"), str)
    path = tmp_path / "log.csv"
    path.write_bytes(table(spoilt(kind)))
    short = answer(path)
    monkeypatch.setattr(csvbody, "SMALL", 0)
    assert short == answer(path)
