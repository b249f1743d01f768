"""The page for users of other packages: what it says is here runs, and what it says is there exists."""

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import test_circuit as circuits

import controller
import sysid

PAGE = (Path(__file__).parents[1] / "docs" / "coming_from.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("| `") and line.count("|") == 4
]
CALLED = r"`([^`]+)`"
# MATLAB is no package of Python; what is in capitals or without a call there is a word.
EXPRESSION = re.compile(r"(?!posterior\.nc)(fit|posterior|loop|circuit|controller|sysid|str)\b[.(]")


def expressions():
    """Those of the second column, and of the third those that begin with a name of the page."""
    found = [text for _, here, _ in ROWS for text in re.findall(CALLED, here)]
    beside = [text for *_, note in ROWS for text in re.findall(CALLED, note) if EXPRESSION.match(text)]
    return list(dict.fromkeys([*found, *beside]))


@pytest.fixture(scope="module")
def names(bench, tmp_path_factory):
    """What the page's expressions speak of."""
    logs = [bench.sweep(seed=1), bench.transient(seed=3)]
    fit = sysid.fit(logs)
    older = sysid.fit(bench.sweep(seed=5))
    of, f = circuits.LANGEVIN, circuits.LANGEVIN.sweep(801)
    folder = tmp_path_factory.mktemp("there")
    s = circuits.scattered(of, f, "one", 50.0, np.random.default_rng(3))
    touchstone = circuits.touchstone(folder / "plate.s1p", f, s, 50.0)
    scene = sysid.Scene.from_toml(Path(__file__).parents[1] / "data" / "synthetic" / "scenes" / "touch.toml")
    posterior = fit.posterior
    return {
        "sysid": sysid, "controller": controller, "fit": fit, "posterior": posterior, "log": logs[1],
        "older": older, "loop": controller.design(posterior), "folder": folder / "set", "scene": scene,
        "touchstone": touchstone, "circuit": circuits.circuit(sysid.read_logs(touchstone)),
    }  # fmt: skip


@pytest.mark.study
def test_what_is_here_runs(names):
    names["fit"].save(names["folder"])
    wrong = {}
    for text in expressions():
        try:
            found = eval(text, dict(names))
            if found is None and text != "posterior.circuit":  # of a plate that is no impedance
                wrong[text] = "None"
        except Exception as error:
            wrong[text] = repr(error)
    assert not wrong and len(expressions()) > 40


def test_what_is_there_exists():
    missing, checked = [], 0
    for dotted in (re.findall(CALLED, there)[0] for there, *_ in ROWS):
        package = dotted.partition(".")[0]
        try:
            import_module(package)
        except ImportError:  # MATLAB, and what is not installed
            continue
        checked += 1
        if not resolved(dotted):
            missing.append(dotted)
    assert not missing and checked > 10


def resolved(dotted):
    """Whether a dotted name leads to something: in a module, in a class, or in one of its objects."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:k]))
        except ImportError:
            continue
        for name in parts[k:]:
            found = getattr(found, name, None)
            found = lined() if getattr(found, "__name__", "") == "ModelResult" else found
        return found is not None
    return False


def lined():
    """A fit by lmfit, whose numbers are its object's own."""
    import lmfit

    x = np.linspace(0, 1, 20)
    y = 2 * x + np.random.default_rng(0).normal(0, 0.1, 20)
    return lmfit.models.LinearModel().fit(y, x=x, slope=1, intercept=0)


def test_everything_has_an_answer():
    assert all(re.search(CALLED, here) or here == "not here" for _, here, _ in ROWS) and len(ROWS) > 40
