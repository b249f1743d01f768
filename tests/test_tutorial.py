"""The tutorial: its commands and its Python run in its order, with the exits that it says, and find what its
file was made of."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from sysid.command import cli, commands

ROOT = Path(__file__).parents[1]
COMMANDS = {"identify": cli.main, "sysid": commands.main}


def blocks():
    """(language, text) of each block that stands between fences."""
    page = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    return re.findall(r"^```(\w+)\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def run(line):
    words = shlex.split(line, comments=True)
    said = re.search(r"# exit (\d+)", line)
    assert COMMANDS[words[0]](words[1:]) == int(said.group(1) if said else 0), line


@pytest.mark.study
def test_the_tutorial_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    python: dict = {}
    for language, text in blocks():
        if language == "python":
            exec(text, python)
        elif language == "toml":
            Path("map.toml").write_text(text, encoding="utf-8")
        else:
            for line in text.splitlines():
                run(line)
    assert Path("dq_pi.h").stat().st_size > 0 and python["loop"].promise.settling <= 2e-3
    said = capsys.readouterr()
    assert "next " in said.out and "preset" in said.out
    found = json.loads(Path("identified/fit.json").read_text(encoding="utf-8"))["parameters"]
    for name, true in (("G", 20e-6), ("tau", 1.67e-3), ("f0", 32300.0)):
        assert found[name]["value"] == pytest.approx(true, abs=4 * found[name]["std"])
    draft = tomllib.loads(said.err.partition("--columns map.toml LOGS")[2])
    completed = tomllib.loads(Path("map.toml").read_text(encoding="utf-8"))
    assert draft.keys() == completed.keys() - {"constants"}  # what it asks is answered, and no more is said
    assert draft["columns"].keys() == completed["columns"].keys()
