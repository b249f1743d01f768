"""Notes that lie among the logs of a fleet are no plates; a log that is broken is one, with its error."""

import gzip

import pandas as pd
import pytest

from sysid.command.fleet import main
from sysid.fleet.groups import grouped
from sysid.tables.prose import is_prose

BROKEN = "# plate: P9\ntime_s,voltage_V,wd_um,wq_um\n0,1,2,3\n1,x,2,3\n"
NOTE = "notes of the bench, 3.2.2026\n\nAmplifier at 100 V, lock-in with 300 us; 24 degC.\nPlate P3, P4: scratched\n"


@pytest.mark.parametrize(
    ("text", "prose"),
    [
        (NOTE, True),
        ("todo", True),
        ("Größe, Ort\n".encode("cp1252"), True),
        (gzip.compress(NOTE.encode()), True),
        (BROKEN, False),
        ("time_s\tvoltage_V\twd_um\n", False),  # of a log that was never written
        ("settings of a recorder\n" + 2 * "2026-02-03T12:00:00\t1,5\t2,5\n", False),
        ("a word\n0.25\n0.5\n", False),  # one channel
        ("", False),
        ("\n\n", False),
        (b"\x00\x01\x02\x00words", False),
        (b"PK\x03\x04 of a workbook", False),
    ],
)
def test_prose_has_words_and_neither_rows_nor_a_header(save, text, prose):
    assert is_prose(str(save(text))) is prose


@pytest.mark.parametrize("by", ["plate", "folder", "(P.)"])
def test_notes_of_a_folder_are_left_out_by_name(tmp_path, by):
    (tmp_path / "P9.csv").write_text(BROKEN)
    (tmp_path / "prose.csv").write_text(NOTE)  # whose ending says that it was to be a log
    (tmp_path / "P9 readme.txt").write_text(NOTE)
    aside = []
    groups = grouped([tmp_path], by, aside=aside)
    assert aside == [str(tmp_path / "P9 readme.txt")]
    assert sorted(str(path) for group in groups for path in group.logs) == [
        str(tmp_path / "P9.csv"),
        str(tmp_path / "prose.csv"),
    ]
    assert any(
        str(tmp_path / "P9 readme.txt") in group.logs
        for group in grouped([tmp_path / "P9 readme.txt"], "P(.)")
    )


def test_the_command_lists_them_beside_the_broken_log(tmp_path, capsys):
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "P9.csv").write_text(BROKEN)
    (logs / "readme.txt").write_text(NOTE)
    assert main([str(logs), "-o", str(tmp_path / "fleet"), "--jobs", "1"]) == 1
    said = capsys.readouterr().out
    assert f"left out, no log of a plate: {logs / 'readme.txt'}" in " ".join(said.split())
    table = pd.read_csv(tmp_path / "fleet" / "fleet.csv")
    assert list(table["plate"]) == ["P9"]
    assert "'x'" in table["error"].iloc[0]
    assert "readme.txt" in (tmp_path / "fleet" / "fleet.html").read_text(encoding="utf-8")
