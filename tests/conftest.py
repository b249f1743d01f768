"""Shared by all tests: one compilation cache for the session, flags that must not leak, the bundled logs and their fits.

A fit compiles for some ten seconds, so every fit that more than one test looks at is a fixture of the session.
"""

import os
import tomllib
import warnings
from pathlib import Path

import pytest

SYNTHETIC = Path(__file__).parents[1] / "data" / "synthetic"
FOLDERS = ("plate", "quartz", "low_q")


@pytest.fixture(scope="session", autouse=True)
def compilation_cache(tmp_path_factory):
    """Subprocesses of the tests find what this process compiled; an outer cache, if one is set, is kept."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        base = tmp_path_factory.getbasetemp()  # workers that share the tests share what they compile
        folder = str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled")
        os.environ |= {"JAX_COMPILATION_CACHE_DIR": folder, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.5"}
        import jax

        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture(autouse=True)
def jax_flags_stay():
    """A test that leaves JAX's flags changed fails: host programs keep theirs."""
    import jax

    before = dict(jax.config.values)
    yield
    after = dict(jax.config.values)
    assert before == after, f"flags of JAX changed: { {k for k in before if before[k] != after.get(k)} }"


def folder_of(name):
    return SYNTHETIC if name == "plate" else SYNTHETIC / name


@pytest.fixture(scope="session")
def truths():
    """{folder: the [plant] table of its truth.toml}."""
    return {name: tomllib.loads((folder_of(name) / "truth.toml").read_text(encoding="utf-8"))["plant"] for name in FOLDERS}


@pytest.fixture(scope="session")
def bundled():
    """{folder: {log name: Log}} of data/synthetic."""
    import sysid

    logs = {name: sysid.read_logs(sorted(folder_of(name).glob("*.csv"))) for name in FOLDERS}
    return {name: {Path(log.path).stem: log for log in of} for name, of in logs.items()}


@pytest.fixture(scope="session")
def joint_fits(bundled):
    """{folder: the fit of all its logs}."""
    import sysid

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return {name: sysid.fit(list(logs.values())) for name, logs in bundled.items()}
