"""The house: imports run one way, every module says what it is, what is imported is declared, importing is
quick."""

import ast
import re
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# What stands above may be imported: folders and modules from the top, and the modules of a folder from its
# left.
HOUSE = """
asked
kept
precision
whole
shell
shown
tables     densities units ruled workbook textfile cells scattered stamps prose pieces preamble axis sheet layout csvfile csvbody joined compound melted store
           hdf matlab
           arrays arrow audio tdms jsonlines influx spice uff touchstone citi head
columns    preset plan metadata signal mapping mapfile labels factors survey roles samples draft found unknown synonyms timebase owntimes abreast header
demodulation  lockin switched carrier waveform
logs       capture opening missing filled stated parted wrapped timed benchwords together within doubts copies log read alike taken written made
rows       clock onset dwell hold rounding thermometer lost glitch condense level gap prepare
model      carry plant span rice theta experiment course nuisances amplitude likelihood prior
trials     noise whitening bench record trial experiment heat perturbed projected mixed jitter extra rounds rounded residuals renew whole
minimum    guess search start images descent minimise ridge
effects    number effect clock filter plate drive sensor drift mode beside blur stretch registry
verdict    result finding identify low_pass wording recorder unexplained flank fitted determined linearised lone gain_confounding immediate
           sensor_delay differing term firstorder timing between throughout terms linear lines averaged misfit amplitude_offset
           inconsistent_log conjugate_phase remains conclusion ownership decay bench comparison
reading
adoption   description candidates point profile search adopt
fitting
posterior  accuracy diagnostics estimate mixture foreseen planning surrogate target chain circuit posterior
           prediction change each
report     text canvas logplots residualplots plateplots loopplots plots costs screen dryrun html
           traces zoom brief frames inference
scene      profile lanes effects engine scene timeline auto carrier simulation toml cli
fleet      many groups settings plate arrays closed batch delayed nodes near tests template cells screen differ told lane parts engine table robust tails halves
           lot odd words pictures page run
command    refusal line clock bill outputs kept sets costcurve arguments check presets fleet cli commands
__main__
"""


def ordered():
    """Dotted names below `sysid`, in their order."""
    order, folder = [], ""
    for line in HOUSE.strip().splitlines():
        words = line.split()
        if not line.startswith(" "):
            folder = words.pop(0)
            order.append(folder)
        order += [f"{folder}.{word}" for word in words]
    return order


ORDER = ordered()
# Results have methods, as thin as can be, that show them, and that do what a user looks for there.
SHOWN = {"report.brief", "report.frames", "report.plots"}
WITHIN = {
    "scene.scene": {"scene.simulation", "scene.toml", *SHOWN},
    "logs.log": {"logs.made", *SHOWN},
    "logs.together": {"logs.log"},  # the type alone
    "logs.within": {"logs.log"},  # the same
    "logs.doubts": {"logs.log"},  # the same
    "logs.copies": {"logs.log"},  # the same
    "verdict.fitted": {"posterior.posterior", "posterior.prediction", "command.sets", *SHOWN},
    "verdict.comparison": SHOWN,
    "posterior.change": SHOWN,
    "posterior.circuit": SHOWN,
    "posterior.foreseen": SHOWN,
    "posterior.planning": SHOWN,
    "posterior.prediction": SHOWN,
    "posterior.posterior": {"command.sets", "report.inference", *SHOWN},
    "fleet.plate": {"command.outputs", "command.sets"},  # each plate's own files
    "fleet.told": {"command.outputs"},
    "fleet.run": {"command.outputs"},
}
PACKAGES = ("sysid", "controller", "stimulator")
MODULES = sorted(p for folder in PACKAGES for p in (ROOT / folder).rglob("*.py"))
SOURCES = sorted((ROOT / "sysid").rglob("*.py"))
STIMULATOR = sorted((ROOT / "stimulator").rglob("*.py"))
TEXTS = {
    ".py",
    ".md",
    ".toml",
    ".csv",
    ".j2",
    ".css",
    ".ipynb",
    ".h",
    ".c",
    ".txt",
    ".yml",
    ".yaml",
    ".cfg",
    "",
}
HOSTS = ("pypi" + ".org", "pythonhosted" + ".org", "conda" + ".anaconda", "npmjs" + ".")
FORBIDDEN = ("/wo" + "rk/", "/t" + "mp/", "uv" + ".lock", *HOSTS)
LOOKS_FOR_THEM = {"tests/test_notebooks.py"}  # refuses such folders itself
# imported under another name than it is declared under
NAMES = {"PIL": "pillow", "skfem": "scikit-fem", "skrf": "scikit-rf", "yaml": "pyyaml"}


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
            found |= {node.module} | {
                f"{node.module}.{alias.name}" for alias in node.names if node.module.startswith("sysid")
            }
    return found


def place(path):
    """The dotted name below `sysid`; of a folder's own file that of the folder."""
    return ".".join(path.relative_to(ROOT / "sysid").with_suffix("").parts).removesuffix(".__init__")


def test_every_module_has_its_place():
    assert {place(p) for p in SOURCES} - {"__init__"} == set(ORDER)


@pytest.mark.parametrize("path", SOURCES, ids=relative)
def test_imports_run_one_way(path):
    mine = place(path)
    if path.name == "__init__.py":  # gives the names of its folder
        return
    for name in imported(path):
        parts = name.removeprefix("sysid.").split(".")
        theirs = ".".join(parts[:2]) if ".".join(parts[:2]) in ORDER else parts[0]
        if (
            name.startswith("sysid.")
            and theirs in ORDER
            and theirs != mine.split(".")[0]
            and theirs not in WITHIN.get(mine, ())
        ):
            assert ORDER.index(theirs) < ORDER.index(mine), f"{relative(path)} imports {name}"


def test_only_the_command_knows_the_controller():
    users = {relative(p) for p in SOURCES if any(name.split(".")[0] == "controller" for name in imported(p))}
    assert users <= {"sysid/command/check.py", "sysid/command/cli.py", "sysid/command/sets.py"}


def test_neither_package_knows_the_stimulator():
    users = {relative(p) for p in MODULES if any(name.split(".")[0] == "stimulator" for name in imported(p))}
    assert all(user.startswith("stimulator/") for user in users)


def test_the_stimulator_s_imports_run_one_way():
    modules = {f"stimulator.{p.stem}": p for p in STIMULATOR if p.name != "__init__.py"}
    graph = {name: imported(path) & set(modules) for name, path in modules.items()}
    tuple(TopologicalSorter(graph).static_order())  # raises CycleError


def test_finite_elements_stay_in_one_module():
    users = {relative(p) for p in MODULES if any(name.split(".")[0] == "skfem" for name in imported(p))}
    assert users == {"stimulator/modes.py"}


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_every_module_says_what_it_is(path):
    said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    assert said and len(said) > 15


def test_what_is_imported_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [
        d
        for name, of in project["optional-dependencies"].items()
        if name not in ("test", "bench", "docs")
        for d in of
    ]
    declared = {re.split(r"[<>=\[ ]", d)[0].lower() for d in (*project["dependencies"], *extras)}
    used = {name.split(".")[0] for path in MODULES for name in imported(path)} - set(PACKAGES)
    foreign = {NAMES.get(name, name).lower() for name in used - sys.stdlib_module_names}
    assert foreign <= declared, foreign - declared


def test_the_import_is_quick():
    slow = "{'jax', 'pandas', 'matplotlib', 'scipy', 'pint', 'optimistix', 'skfem'}"
    script = "import sys, sysid, stimulator; dir(sysid); dir(stimulator); "
    script += f"print(sorted({slow} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.always
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
    return [
        ROOT / name
        for name in listed.stdout.splitlines()
        if Path(name).suffix in TEXTS and (ROOT / name).is_file()
    ]


def test_no_file_names_a_machine_s_folder_or_a_registry():
    found = {}
    for path in texts():
        text = path.read_text(encoding="utf-8", errors="replace")
        if (hits := [word for word in FORBIDDEN if word in text]) and relative(path) not in LOOKS_FOR_THEM:
            found[relative(path)] = hits
    assert not found


def test_no_lockfile():
    assert not (ROOT / ("uv" + ".lock")).exists()


def test_every_test_that_is_named_as_slow_is_there():
    for name in (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines():
        path, _, test = name.partition("::")
        assert f"def {test.partition('[')[0]}(" in (ROOT / path).read_text(encoding="utf-8"), name
