"""The house: imports run one way, every module says what it is, what is imported is declared, importing is quick."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# A module may import those before it.
ORDER = [
    "accuracy",
    "precision",
    "units",
    "textfile",
    "cells",
    "stamps",
    "pieces",
    "preamble",
    "csvfile",
    "csvbody",
    "mapping",
    "draft",
    "header",
    "lockin",
    "switched",
    "carrier",
    "waveform",
    "benchwords",
    "log",
    "dwell",
    "hold",
    "rounding",
    "thermometer",
    "plant",
    "lost",
    "glitch",
    "condense",
    "span",
    "rice",
    "likelihood",
    "noise",
    "whitening",
    "trial",
    "experiment",
    "perturbed",
    "projected",
    "jitter",
    "extra",
    "residuals",
    "renew",
    "guess",
    "prior",
    "result",
    "search",
    "start",
    "identify",
    "wording",
    "reading",
    "images",
    "minimise",
    "ridge",
    "flank",
    "fitted",
    "determined",
    "view",
    "lone",
    "coincidence",
    "term",
    "moments",
    "terms",
    "misfit",
    "odd",
    "leaning",
    "late",
    "conclusion",
    "fitting",
    "bench",
    "comparison",
    "diagnostics",
    "estimate",
    "mixture",
    "foreseen",
    "planning",
    "surrogate",
    "target",
    "chain",
    "posterior",
    "clock",
    "bill",
    "outputs",
    "costcurve",
    "report",
    "scene",
    "arguments",
    "cli",
    "__main__",
]
MODULES = sorted(p for folder in ("sysid", "controller") for p in (ROOT / folder).rglob("*.py"))
SOURCES = sorted((ROOT / "sysid").rglob("*.py"))
TEXTS = {".py", ".md", ".toml", ".csv", ".j2", ".ipynb", ".h", ".c", ".txt", ".yml", ".yaml", ".cfg", ""}
HOSTS = ("pypi" + ".org", "pythonhosted" + ".org", "conda" + ".anaconda", "npmjs" + ".")
FORBIDDEN = ("/wo" + "rk/", "/t" + "mp/", "uv" + ".lock", *HOSTS)
LOOKS_FOR_THEM = {"tests/test_notebooks.py"}  # refuses such folders itself
NAMES = {"PIL": "pillow", "yaml": "pyyaml"}  # imported under another name than it is declared under


def relative(path):
    return path.relative_to(ROOT).as_posix()


def imported(path):
    """Dotted names of all imports of a file, those within functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{relative(path)}: relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names if node.module == "sysid"}
    return found


def place(path):
    return path.relative_to(ROOT / "sysid").with_suffix("").parts[0]


def test_every_module_has_its_place():
    assert {place(p) for p in SOURCES} - {"__init__"} == set(ORDER)


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_imports_run_one_way(path):
    if place(path) == "__init__":
        return
    for name in imported(path):
        parts = name.split(".")
        if parts[0] != "sysid" or len(parts) == 1 or parts[1] not in ORDER:
            continue
        mine, theirs = ORDER.index(place(path)), ORDER.index(parts[1])
        assert theirs < mine or (theirs == mine and place(path) in ("report", "scene")), f"{relative(path)} imports {name}"


def test_only_the_command_knows_the_controller():
    users = {relative(p) for p in SOURCES if any(name.split(".")[0] == "controller" for name in imported(p))}
    assert users <= {"sysid/cli.py"}


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_every_module_says_what_it_is(path):
    said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    assert said and len(said) > 15


def test_what_is_imported_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [d for name, of in project["optional-dependencies"].items() if name not in ("test", "bench") for d in of]
    declared = {re.split(r"[<>=\[ ]", d)[0].lower() for d in (*project["dependencies"], *extras)}
    used = {name.split(".")[0] for path in MODULES for name in imported(path)} - {"sysid", "controller"}
    foreign = {NAMES.get(name, name).lower() for name in used - sys.stdlib_module_names}
    assert foreign <= declared, foreign - declared


def test_the_import_is_quick():
    slow = "{'jax', 'pandas', 'matplotlib', 'scipy', 'pint', 'optimistix'}"
    script = f"import sys, sysid; dir(sysid); print(sorted({slow} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_public_names_stay_what_they_are():
    # a submodule must not take the place of a function of the same name once it has been imported
    script = "import sysid; first = sysid.fit; assert callable(first) and sysid.fit is first"
    script += "; from sysid import *; assert callable(fit)"
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True, cwd=ROOT)
    import sysid

    assert all(not hasattr(getattr(sysid, name), "__path__") for name in sysid.__all__)


def texts():
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, cwd=ROOT)
    if listed.returncode:  # not a checkout: the files of an archive
        return [p for p in ROOT.rglob("*") if p.is_file() and p.suffix in TEXTS and ".git" not in p.parts]
    return [ROOT / name for name in listed.stdout.splitlines() if Path(name).suffix in TEXTS and (ROOT / name).is_file()]


def test_no_file_names_a_machine_s_folder_or_a_registry():
    found = {}
    for path in texts():
        text = path.read_text(encoding="utf-8", errors="replace")
        if (hits := [word for word in FORBIDDEN if word in text]) and relative(path) not in LOOKS_FOR_THEM:
            found[relative(path)] = hits
    assert not found


def test_no_lockfile():
    assert not (ROOT / ("uv" + ".lock")).exists()
