"""All commands under one name, what a shell is offered of them, files that are only looked at, and the line
of a long run."""

import ast
import io
import json
import logging
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from sysid import __version__, shell
from sysid.command import cli, commands
from sysid.command.line import Line

ROOT = Path(__file__).parents[1]
SYNTHETIC = ROOT / "data" / "synthetic"
STEP, SWEEP, TIMED = (SYNTHETIC / f"{name}.csv" for name in ("step_100V_24C", "sweep_24C", "timed_sweep"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DECLARED = PROJECT["entry-points"][commands.GROUP]
HEAVY = {"numpy", "jax", "scipy", "pandas", "matplotlib", "emcee", "rich", "pint", "argcomplete"}


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The commands that the project declares, whatever was installed before; the process's own line is left
    alone."""
    entries = [EntryPoint(name, where, commands.GROUP) for name, where in DECLARED.items()]
    monkeypatch.setattr(commands, "entry_points", lambda group: entries if group == commands.GROUP else [])
    monkeypatch.setattr(sys, "argv", ["sysid"])


def run(capsys, *argv):
    """The exit code, and both outputs."""
    try:
        code = commands.main([str(word) for word in argv])
    except SystemExit as ended:
        code = ended.code
    return code, *capsys.readouterr()


def test_each_command_is_also_its_own_and_says_what_it_is_for(capsys):
    scripts = PROJECT["scripts"]
    assert scripts["sysid"] == "sysid.command.commands:main"
    assert all(scripts[name] == DECLARED[name] for name in ("identify", "simulate"))
    code, out, _ = run(capsys, "--help")
    said = " ".join(out.split())
    assert code == 0 and all(re.search(rf"\b{name} [a-z]+ [a-z]+", said) for name in DECLARED)
    for name in DECLARED:
        code, out, _ = run(capsys, name, "--help")
        assert code == 0 and out.startswith("usage: ")


@pytest.mark.parametrize("argv", [(), ("idntify",), ("--fast",)], ids=str)
def test_no_command_and_one_that_is_none_are_bad_usage(argv, capsys):
    code, out, err = run(capsys, *argv)
    assert (
        code == 2
        and out == ""
        and all(name in err for name in ("usage: sysid", *(DECLARED if argv != ("--fast",) else ())))
    )


def test_the_version_is_that_of_the_package(capsys):
    assert run(capsys, "--version") == (0, f"sysid {__version__}\n", "")


def test_a_command_says_the_name_that_it_was_called_by(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sysid", "identify", "absent.csv"])
    assert commands.main() == 2
    assert capsys.readouterr().err.startswith("sysid identify: absent.csv: ")
    monkeypatch.setattr(sys, "argv", ["identify", "absent.csv"])
    assert cli.main() == 2
    assert capsys.readouterr().err.startswith("identify: absent.csv: ")


@pytest.mark.parametrize("words", [["--help"], *([name, "--help"] for name in DECLARED)], ids=" ".join)
def test_help_waits_for_no_library(words):
    script = f"""
import sys
from importlib.metadata import EntryPoint
from sysid.command import commands
commands.entry_points = lambda group: [EntryPoint(n, w, group) for n, w in {DECLARED!r}.items()]
sys.argv = ["sysid", *{words!r}]
try: commands.main()
except SystemExit: print("##", *sorted(sys.modules))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert "usage: sysid" in done.stdout and not HEAVY & set(done.stdout.rpartition("##")[2].split())


def offered(line, main):
    """What a shell is offered whose line stands so."""
    script = f"""
import os, sys
from importlib.metadata import EntryPoint
from sysid.command import cli, commands
from stimulator import cli as simulate
commands.entry_points = lambda group: [EntryPoint(n, w, group) for n, w in {DECLARED!r}.items()]
sys.argv = {line.split()[:1]!r}
{main}.main()
"""
    read, write = os.pipe()
    # as register-python-argcomplete does it, whose answer comes through a descriptor of its own
    state = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "COMP_TYPE": "9",
    }
    script = f"import os; os.dup2({write}, 8); {script}" if write != 8 else script
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | state,
        cwd=ROOT,
        pass_fds=[write],
        capture_output=True,
    )
    os.close(write)
    with open(read) as answer:
        return done.returncode, [word.strip() for word in answer.read().split("\n")]


@pytest.mark.parametrize(
    ("line", "main", "some"),
    [
        ("sysid ", "commands", ("identify", "simulate", "check", "presets", "--version")),
        ("sysid sim", "commands", ("simulate",)),
        ("sysid identify --accu", "commands", ("--accuracy",)),
        ("sysid identify --accuracy ", "commands", ("quick", "standard", "exact")),
        ("sysid identify -o out data/synthetic/swe", "commands", ("data/synthetic/sweep_24C.csv",)),
        ("sysid simulate --wav", "commands", ("--waveform",)),
        ("sysid check --col", "commands", ("--columns",)),
        ("sysid identify --columns preset:e", "commands", ("preset:e4990a",)),
        ("sysid check --columns preset:pico", "commands", ("preset:picoscope",)),
        ("identify --advise set", "cli", ("settling",)),
        ("simulate --dr", "simulate", ("--draw",)),
    ],
)
def test_a_shell_is_told_how_its_line_may_go_on(line, main, some):
    pytest.importorskip("argcomplete")
    code, words = offered(line, main)
    assert code == 0 and set(some) <= set(words)
    assert all(word.startswith(line.rpartition(" ")[2]) for word in words)


def test_a_dry_run_says_what_each_file_is_taken_for(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["--dry-run", str(STEP), str(TIMED)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("readable: 2 logs of plate A7 in 2 files; nothing was fitted\n") and err == ""
    for words in (
        "240 rows, transient",
        "voltage_V",
        "0 to 100 V",
        "metadata 'frequency_Hz'",
        "32290 Hz",
        "sampling  instant",
    ):
        assert words in out, words
    for words in (
        "201 rows, transient or steady",
        "the fit tells",
        "temperature_degC",
        "plate: A7",
        "Wd + j Wq",
    ):
        assert words in out, words
    assert max(map(len, out.splitlines())) <= 80 and not list(tmp_path.iterdir())


MAP = """amplitude = "rms"
quantity = "velocity"
phase_sign = -1
[columns]
frequency = { column = "f", unit = "kHz" }
x = { column = "X", unit = "mm/s", scale = 2 }
y = { column = "Y", unit = "mm/s", scale = 2 }
[constants]
voltage = "3 V"
"""
LOCK_IN = "f,X,Y,aux\n32.1,0.1,0.2,7\n32.2,0.2,0.5,7\n32.3,0.4,0.1,7\n"


def test_a_dry_run_as_json_holds_roles_units_and_what_is_not_used(save, capsys):
    save(MAP, "map.toml")
    log = save(LOCK_IN)
    assert cli.main(["--dry-run", "--json", "--columns", str(log.parent / "map.toml"), str(log)]) == 0
    told = json.loads(capsys.readouterr().out)
    (file,) = told["files"]
    columns = {c["read_as"]: c for c in file["columns"]}
    assert told["readable"] and told["mapping"].endswith("map.toml") and file["unused"] == ["aux"]
    assert file["logs"] == [{"name": "log.csv", "kind": "steady", "sampling": None, "rows": 3}]
    assert (columns["x"]["unit"], columns["x"]["amplitude"], columns["x"]["scale"]) == ("mm/s", "rms", 2.0)
    assert columns["frequency"]["column"] == "f"
    assert [columns["frequency"][end] for end in ("least", "most")] == pytest.approx(
        [32100.0, 32300.0], rel=1e-12
    )
    assert columns["voltage"]["constant"] and columns["voltage"]["most"] == 3.0
    # the lock-in's numbers as peak velocities over omega
    largest = max(
        abs(complex(x, y)) / f for f, x, y in ((32.1, 0.1, 0.2), (32.2, 0.2, 0.5), (32.3, 0.4, 0.1))
    )
    assert (file["response"]["what"], file["response"]["unit"]) == ("Wd + j Wq", "mm")
    assert file["response"]["most"] == pytest.approx(2 * 2**0.5 * largest / (2e3 * np.pi))


def test_a_dry_run_names_every_file_that_cannot_be_read_and_drafts_their_mappings_once(save, capsys):
    for name in ("a.csv", "b.csv"):
        save(LOCK_IN, name)
    first = save(LOCK_IN, "first.csv")
    code = cli.main(["--dry-run", str(STEP), str(first.parent / "*.csv"), "absent.csv"])
    out, err = capsys.readouterr()
    assert code == 2 and out.startswith("not readable: 4 of 5 files")
    out = "".join(out.split())  # long paths are folded
    assert (
        all(f"{name}:refused" in out for name in ("a.csv", "b.csv", "first.csv", "absent.csv"))
        and "240rows,transient" in out
    )
    assert (
        "nosuchfile" in out
        and "[columns]" in err
        and err.count("[columns]") == err.count("# How to read") == 3
    )


def test_a_dry_run_of_logs_that_do_not_belong_together_says_why(save, capsys):
    other = save(STEP.read_text().replace("plate: A7", "plate: B2"), "other.csv")
    assert cli.main(["--dry-run", str(STEP), str(other)]) == 2
    out = " ".join(capsys.readouterr().out.split())
    assert out.startswith("not readable together: ") and "'A7'" in out and "'B2'" in out


def test_hostile_names_are_text_in_a_dry_run(save, capsys):
    hostile = "x\x1b[2J[bold]"
    log = save(
        f"# plate: {hostile}\ntime_s,voltage_V,w_um,{hostile}\n0,0,0,1\n1,5,1,1\n2,5,2,1\n", "a\x1b[1m.csv"
    )
    assert cli.main(["--dry-run", str(log)]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and "[bold]" in out and "\\u001b[2J" in out


@pytest.mark.parametrize(
    "idle", ["--rig=a.toml", "--accuracy=quick", "--advise=G", "--effects=none", "--compare=a", "--seed=1"]
)
def test_a_dry_run_refuses_what_it_does_nothing_with(idle, capsys):
    with pytest.raises(SystemExit) as refused:
        cli.main(["--dry-run", idle, str(STEP)])
    assert (
        refused.value.code == 2
        and f"found {idle.partition('=')[0]} beside --dry-run" in capsys.readouterr().err
    )


class Terminal(io.StringIO):
    """A terminal's end that keeps what comes."""

    def isatty(self):
        return True


def test_the_line_of_a_long_run_says_what_is_tried_and_leaves_the_logger_as_it_was(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    for name, value in (("TERM", "xterm"), ("COLUMNS", "80")):
        monkeypatch.setenv(name, value)
    logger = logging.getLogger("sysid")
    before = (logger.level, list(logger.handlers))
    line = Line()
    with line("fitting the plant"):
        logging.getLogger("sysid.minimum.minimise").info("start %d of [bold]%d\x1b[2J", 2, 4)
        line._progress.refresh()
    said = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue())
    assert "fitting the plant: start 2 of [bold]4\\u001b[2J" in said and re.search(r"0:00:0\d", said)
    assert (logger.level, list(logger.handlers)) == before


def test_what_a_fit_tries_is_logged_and_printed_nowhere_unasked(bench, caplog, capfd):
    import sysid

    with caplog.at_level(logging.INFO, "sysid"):
        sysid.fit(bench.sweep())
    said = " ".join(record.getMessage() for record in caplog.records if record.name.startswith("sysid"))
    assert "where to start" in said and "start 1 of " in said
    assert capfd.readouterr() == ("", "")


def test_commands_are_found_by_their_names_alone():
    """The module imports no command: not even the one that calls this package's own."""
    tree = ast.parse(Path(commands.__file__).read_text(encoding="utf-8"))
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name for name in names if name.startswith(("sysid.command", "stimulator", "controller"))}
    assert shell.called("identify") == "identify"
