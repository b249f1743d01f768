"""A short version of the study benchmarks/fuzz_reader.py, and what it found: whatever stands in a file, a log
or a LogError."""

import importlib.util
import random
import sys
from pathlib import Path

import pytest

from sysid.logs.read import read_logs

STUDY = Path(__file__).parents[1] / "benchmarks" / "fuzz_reader.py"
FOUND = [
    (b"\x17\n,", b""),  # a control character in a comment of the mapping file
    (b"\xa0", b""),  # a header that is blank to Python alone
    (b"\xe2\x80\xa8\n,", b""),  # a header without a name
    (b'"",""\n1,2\n', b""),
    (b"f_Hz,X_V,w\n0,1,\n0,3,\n", b'quantity="velocity"\nphase_sign=1\n[columns]\nfrequency="f_Hz"\nx="X_V"\n'
     b'y={column=1,unit="V",offset=5}'),  # a velocity at 0 Hz
]  # fmt: skip


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("fuzz_study", STUDY)
    found = sys.modules[spec.name] = importlib.util.module_from_spec(
        spec
    )  # its dataclass looks itself up there
    spec.loader.exec_module(found)
    yield found
    del sys.modules[spec.name]


def fault(study, folder, table, toml):
    (folder / "log.csv").write_bytes(table)
    (folder / "map.toml").write_bytes(toml)
    return study._fault(
        lambda: read_logs(folder / "log.csv", folder / "map.toml" if toml else None), table, toml
    )


@pytest.mark.skipif(sys.platform == "win32", reason="late answers are told by a signal")
@pytest.mark.parametrize("pair", FOUND, ids=ascii)
def test_what_was_found_once(study, tmp_path, pair):
    assert fault(study, tmp_path, *pair) is None


@pytest.mark.skipif(sys.platform == "win32", reason="late answers are told by a signal")
def test_the_corpus_is_read_or_refused(study, tmp_path):
    """What the study kept: short files that together run through nearly every line of the reader."""
    assert len(study.kept()) > 40
    for pair in study.kept():
        assert fault(study, tmp_path, *pair) is None, pair


@pytest.mark.skipif(sys.platform == "win32", reason="late answers are told by a signal")
def test_mutated_files_are_read_or_refused(study, tmp_path):
    rng = random.Random(7)
    for _ in range(400):
        pair = study.mutated(rng.choice(study.SEEDS), study.SEEDS, rng)
        assert fault(study, tmp_path, *pair) is None, pair


def test_numbers_that_are_not_those_of_the_file_are_told(study, tmp_path):
    """The study's own truth: it sees a number that is off by a bit, and rows that are missing."""
    (tmp_path / "log.csv").write_bytes(study.LOG)
    (log,) = read_logs(tmp_path / "log.csv")
    assert study._fault_of_logs([log], study.LOG) is None
    assert (
        study._fault_of_logs([log], study.LOG.replace(b"0.25", b"0.25000000000000006"))
        == "other numbers than were written"
    )
    assert fault(study, tmp_path, b"# kind: steady\n" + study.LOG, b"") is None  # whose times are not kept
    assert study._fault_of_logs([log], study.LOG + b"0.3,1,1,1,1\n") == "other numbers than were written"
    assert (
        study._fault_of_logs([log], study.LOG.replace(b"0.25", b"x")) == "numbers from cells that hold none"
    )
