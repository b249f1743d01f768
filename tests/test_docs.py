"""README and docs: what they link to is there, what they show runs, and a lock-in wired as they say gives Wd
and Wq."""

import dataclasses
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import study
from scipy.integrate import solve_ivp

from sysid import Result
from sysid.verdict.finding import entry

ROOT = Path(__file__).parents[1]
PACKAGES = ("sysid", "controller", "stimulator")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_what_a_page_links_to_is_there(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    named = re.findall(
        r"`((?:sysid|controller|stimulator|tests|benchmarks)/[\w/]+\.\w+)`", page.read_text(encoding="utf-8")
    )
    missing = [x for x in links if not (page.parent / x).exists()] + [
        x for x in named if not (ROOT / x).exists()
    ]
    assert not missing


@pytest.mark.parametrize("result", Result)
def test_what_fit_json_may_say_of_the_result_is_documented(result):
    assert f"| `{result.value}` |" in (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")


@pytest.mark.always
def test_the_first_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", PAGES[0].read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    found: dict = {}
    exec(code.group(1), found)
    assert capsys.readouterr().out.startswith("tau = 0.00166")
    assert abs(found["trace"].Wd[-1]) > 0
    assert (tmp_path / "dq_pi.h").stat().st_size > 0


def locked_in(signal, phase):
    """X + jY of a signal against cos(phase), over whole periods."""
    return 2 * np.mean(signal * np.exp(-1j * phase))


@pytest.mark.parametrize("beside", [0.0, study(-0.5), study(0.5)], ids=["at", "below", "above"])
def test_a_lock_in_wired_as_the_page_says_gives_wd_and_wq(beside):
    """The carrier's equation with G = 1 and V = 1, integrated until it is settled; at Q = 50 the page's limit
    is 1 % off."""
    f0, Q = 1.0, 50.0
    tau = Q / (np.pi * f0)
    f = f0 + beside / (2 * np.pi * tau)
    omega, w0 = 2 * np.pi * f, 2 * np.pi * f0

    def carrier(t, y):
        return [y[1], 2 * w0 / tau * np.cos(omega * t) - 2 / tau * y[1] - w0**2 * y[0]]

    t = np.linspace(10 * tau, 10 * tau + 5 / f, 2001)[:-1]
    w, velocity = solve_ivp(carrier, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y
    s = locked_in(w, omega * t)
    W = -s.imag + 1j * s.real  # displacement: Wd = -Y, Wq = X
    delta = 2 * np.pi * (f0 - f)
    assert (
        abs(W - 1 / (1 - 1j * delta * tau)) < 0.02
    )  # 1 % of the limit of large Q, and exp(-10) of the start
    assert locked_in(velocity, omega * t) / omega == pytest.approx(
        W, abs=1e-4
    )  # velocity: Wd = X/omega, Wq = Y/omega
    assert np.sign(round(W.imag, 2)) == np.sign(-beside)  # Wq > 0 below the resonance: raise f


def test_the_map_of_the_code_names_every_module_and_none_that_is_not():
    page = (ROOT / "docs" / "code.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+)`", page)) | set(
        re.findall(r"`(?:sysid|controller|stimulator)/(?:\w+/)*(\w+)\.py`", page)
    )
    modules = {p.stem for folder in PACKAGES for p in (ROOT / folder).rglob("*.py")} - {"__init__"}
    assert modules - named == set()
    types = {"Log", "Trial", "Noise", "Experiment", "State", "Fit", "Posterior", "Loop", "Scene", "Term"}
    assert named - modules - types == {"fit", "simulate", *PACKAGES}


@pytest.mark.study
def test_the_examples_of_the_stimulator_run(tmp_path, monkeypatch):
    """On a coarse mesh, and with a cache of their own."""
    from stimulator import modes

    coarse = dataclasses.replace(modes._THEORIES["kirchhoff"], per_wavelength=4.0)
    monkeypatch.setitem(modes._THEORIES, "kirchhoff", coarse)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    page = (ROOT / "docs" / "stimulator.md").read_text(encoding="utf-8")
    found: dict = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(code, found)
    assert found["plant"].f0 == pytest.approx(32300, abs=1)
    assert 0.02 / 3 < found["plant"].G < 0.02 * 3


@pytest.mark.parametrize("package", PACKAGES)
def test_the_reference_has_each_public_name_once(package):
    page = (ROOT / "docs" / f"reference_{package}.md").read_text(encoding="utf-8")
    named = re.findall(rf"^\.\. auto(?:class|function):: {package}\.(\w+)$", page, re.MULTILINE)
    assert sorted(named) == sorted(import_module(package).__all__)


@pytest.mark.study  # `.ci/run` builds it too
def test_the_site_builds_without_a_warning(tmp_path):
    """And each address that the command names is there."""
    pytest.importorskip("sphinx", reason="the extra docs is not installed")
    pytest.importorskip("myst_nb", reason="the extra docs is not installed")
    build = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "-d", str(tmp_path / "read")]
    done = subprocess.run([*build, "docs", str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "errors.html").read_text(encoding="utf-8")
    assert all(
        f'id="{entry(key).partition("#")[2]}"' in page for key in ("second_mode", "rows_lost", "delay")
    )
    assert 'id="e4990a"' in (tmp_path / "site" / "presets.html").read_text(encoding="utf-8")
