"""Shared by all tests: compiled programs that the session keeps, flags that must not leak, the bundled logs
and their fits.

A fit compiles for some ten seconds, so every fit that more than one test looks at is a fixture of the
session.
"""

import os
import tomllib
import warnings
from functools import cache, partial
from importlib.util import find_spec
from mmap import ACCESS_READ, mmap
from pathlib import Path

# Before numpy is imported. Workers take all cores: threads that wait for one another take many times as long
# as one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
import reference

# The tests compile many programs and run each a few times. The fit's and the sampler's say themselves how
# they are compiled.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
# Programs that the fit does not compile itself, as it does those: in half the time. XLA ends a process that sets
# a flag which it does not know.
FLAG = "xla_cpu_use_fusion_emitters"
XLA = max(Path(find_spec("jaxlib").origin).parent.iterdir(), key=lambda file: file.stat().st_size)
with XLA.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as text:
    if text.find(FLAG.encode()) >= 0:
        os.environ.setdefault("XLA_FLAGS", f"--{FLAG}=false")
SYNTHETIC = Path(__file__).parents[1] / "data" / "synthetic"
FOLDERS = ("plate", "quartz", "low_q")


LONG = 0.8  # s, from which a test is the study's unless it is marked `always`
SLOW = Path(__file__).with_name("slow.txt")  # the names of these


def pytest_addoption(parser):
    parser.addoption("--times", action="store_true", help=f"run what is slow too, and write {SLOW.name} anew")


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(config, items):
    slow = set() if config.getoption("times") else set(SLOW.read_text(encoding="utf-8").splitlines())
    for item in items:
        if item.nodeid in slow and item.get_closest_marker("always") is None:
            item.add_marker("study")


def pytest_runtest_logreport(report):
    if report.when == "call" and report.duration > LONG:
        took.add(report.nodeid)


def pytest_sessionfinish(session):
    if session.config.getoption("times") and "PYTEST_XDIST_WORKER" not in os.environ:
        SLOW.write_text("".join(f"{name}\n" for name in sorted(took)), encoding="utf-8")


took = set[str]()  # tests of this run that took long


@pytest.fixture(scope="session", autouse=True)
def programs_are_kept(tmp_path_factory):
    """Subprocesses of the tests find what this process compiled; an outer folder, if one is set, is kept."""
    base = tmp_path_factory.getbasetemp()  # workers that share the tests share what they compile
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "programs"
    os.environ.setdefault("SYSID_PROGRAMS", str(folder))


# a value of a parameter that the default run leaves to the study
study = partial(pytest.param, marks=pytest.mark.study)


def tiers(few, every):
    """Two values of a parameter: a quick one, and the whole, which is the study's."""
    return [pytest.param(few, id="few"), study(every, id="all")]


def sampled(values, every=2):
    """Of many values of a parameter each `every`-th, and in the study all."""
    return [v if k % every == 0 else study(v) for k, v in enumerate(values)]


def seeds(few, every):
    """The test is one of `seeds`: few, and in the study every one. Its bounds follow from their number."""
    return pytest.mark.parametrize("seeds", tiers(range(few), range(every)))


def most(seeds, sure=3.5):
    """What the root mean square of that many standard normal scores may be: it is 1, known to 1/sqrt(2 n);
    `sure` of these."""
    return 1 + sure / np.sqrt(2 * len(seeds))


MAPS = Path("/proc/self/maps")
# pieces of memory that a process may have mapped, of the 65 530 that Linux allows: a compiled program has
# several
MOST = 30_000


@pytest.fixture(scope="module", autouse=True)
def programs_are_forgotten():
    """A worker that has compiled thousands of programs would end without a word."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST:
        from sysid.precision import forget_programs

        forget_programs()


@pytest.fixture(autouse=True)
def jax_flags_stay():
    """A test that leaves JAX's flags changed fails: host programs keep theirs."""
    import jax

    before = dict(jax.config.values)
    yield
    after = dict(jax.config.values)
    assert before == after, f"flags of JAX changed: { {k for k in before if before[k] != after.get(k)} }"


@pytest.fixture(params=[pytest.param(False, id="first order"), study(True, id="searched")])
def nuisances(request):
    """What a fit may adopt of logs that the plate alone does not describe. What is left is named to first
    order; the study searches effects that would describe it as well, which takes seconds."""
    from sysid.effects.registry import EVERY
    from sysid.trials.trial import NUISANCES

    return EVERY if request.param else NUISANCES


@pytest.fixture
def among(nuisances):
    """`among("delay")`: what a fit may adopt of logs that show this effect; the study searches every other one
    beside it."""
    return lambda *names: tuple(dict.fromkeys((*nuisances, *names)))


@pytest.fixture
def save(tmp_path):
    """Writes a file and gives its path."""

    def write(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def folder_of(name):
    return SYNTHETIC if name == "plate" else SYNTHETIC / name


@pytest.fixture(scope="session")
def truths():
    """{folder: the [plant] table of its truth.toml}."""
    return {
        name: tomllib.loads((folder_of(name) / "truth.toml").read_text(encoding="utf-8"))["plant"]
        for name in FOLDERS
    }


@pytest.fixture(scope="session")
def bundled():
    """{folder: {log name: Log}} of data/synthetic."""
    import sysid

    logs = {name: sysid.read_logs(sorted(folder_of(name).glob("*.csv"))) for name in FOLDERS}
    return {name: {Path(log.path).stem: log for log in of} for name, of in logs.items()}


@pytest.fixture(scope="session")
def joint_fit(bundled):
    """The fit of all logs of a folder, made when it is first asked for."""
    import sysid

    @cache
    def of(folder):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return sysid.fit(list(bundled[folder].values()))

    return of


# --- simulated logs: physics and noise are those of tests/reference.py, which shares no code with the package
# -------------

PLATE = {"G": 0.02, "tau": 5e-3 / np.log(20), "f0": 32300.0, "k_T": -10.16}


class Bench:
    """Logs of one plate: 240 rows of a transient or 101 of a sweep, sizes for which the bundled logs compile
    programs too."""

    def __init__(self):
        self.plant = reference.Plant(**PLATE)

    def transient(self, seed=0, **changes):
        """A step by 10 Hz below resonance; what is given replaces it: volts, dt, frequency, amplitude, noise,
        noise_time."""
        given = {
            "volts": np.repeat([0.0, 100.0], [20, 220]),
            "dt": 1e-4,
            "frequency": 32290.0,
            "amplitude": False,
            "noise": 0.01,
        }
        given |= {"noise_time": 0.0, "drive": True, "temperature": 24.0} | changes
        rows = len(given["volts"])
        time = given["dt"] * np.arange(rows)
        frequency = np.broadcast_to(given["frequency"], rows).astype(float)
        temperature = np.full(rows, given["temperature"])
        clean = reference.ringing(self.plant, time, given["volts"], frequency, temperature)
        felt = np.append(0.0, given["volts"][:-1])
        return self._log(
            "step",
            seed,
            given,
            clean,
            felt,
            time=time,
            frequency=frequency,
            temperature=temperature,
            sampling="instant",
        )

    def sweep(self, seed=0, **changes):
        """101 settled points over +-500 Hz."""
        given = {
            "volts": 100.0,
            "frequency": np.linspace(31800, 32800, 101),
            "amplitude": False,
            "noise": 0.01,
            "noise_time": 0.0,
        }
        given |= {"drive": True, "temperature": 24.0, "time": None} | changes
        rows = len(given["frequency"])
        given["volts"] = np.full(rows, given["volts"])
        temperature = np.full(rows, given["temperature"])
        clean = reference.steady(self.plant, given["volts"], given["frequency"], temperature)
        clean = given["distort"](clean, given["frequency"]) if "distort" in given else clean
        inputs = {"frequency": given["frequency"], "temperature": temperature, "time": given["time"]}
        return self._log("sweep", seed, given, clean, given["volts"], **inputs)

    def _log(self, name, seed, given, clean, felt, **inputs):
        from sysid import Log

        std = given["noise"] * 2.0
        times = inputs["time"] if inputs["time"] is not None else np.zeros(len(felt))
        noise = reference.noise(len(felt), std, seed, times, given["noise_time"])
        if given["amplitude"]:
            response = np.abs(clean + noise)
        else:
            response = np.exp(0.3j) * clean + (1.6e-4 - 1.2e-4j) * felt + (0.004 - 0.003j) + noise
        if "limit" in given:
            low, high = -given["limit"], given["limit"]
            response = np.clip(response.real, low, high) + 1j * np.clip(response.imag, low, high)
        return Log(name, response, drive=given["volts"] if given["drive"] else None, **inputs)


@pytest.fixture(scope="session")
def bench():
    """Simulated logs of the plate."""
    return Bench()
