"""Programs: made beside what goes on, in 64 bits, whatever options JAX knows, kept on disk; what the command
leaves unloaded."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import sysid
from sysid import kept, precision


def shifted(x, layouts, groups):
    return x + groups[0] if layouts == ("up",) else x - groups[0]


@pytest.fixture
def program():
    made = precision.compiled(shifted)
    yield made
    precision._all.remove(made)


@pytest.fixture
def beside():
    """As in a process of one's own; a program's host is not given threads."""
    assert not precision._beside
    precision.make_beside()
    yield
    precision._beside.pop().shutdown()


@precision.float64
def test_a_program_is_made_beside_and_used(program, beside):
    x, groups = np.array([1.0, 2.0]), (np.array([1e-12, 1.0]),)
    program.prepare(x, ("up",), groups)
    (begun,) = program.programs.values()
    np.testing.assert_array_equal(
        program(x, ("up",), groups), [1 + 1e-12, 3.0]
    )  # float32 would lose the first
    assert list(program.programs.values()) == [begun]
    np.testing.assert_array_equal(program(x, ("down",), groups), [1 - 1e-12, 1.0])
    assert len(program.programs) == 2


@precision.float64
def test_a_host_program_is_given_no_threads(program):
    program.prepare(np.ones(1), ("up",), (np.ones(1),))
    assert not program.programs


@precision.float64
def test_an_unknown_option_is_no_failure(program, monkeypatch):
    monkeypatch.setattr(precision, "_options", lambda seldom, largest: {"xla_no_such_option": True})
    assert program(np.ones(1), ("up",), (np.ones(1),)) == 2.0


@precision.float64
def test_what_fails_beside_fails_where_it_is_used(beside):
    def wrong(x, layouts, groups):
        return jnp.linalg.solve(x, groups[0])

    made = precision.compiled(wrong)
    made.prepare(np.ones(2), (), (np.ones(3),))  # not a matrix
    with pytest.raises((TypeError, ValueError)):
        made(np.ones(2), (), (np.ones(3),))
    precision._all.remove(made)


def test_the_command_does_without_the_libraries_that_emcee_does_not_need():
    script = "import sys, sysid.command.clock as c;"
    script += " b = c.Budget(None, 0.0, c.Stages(), c.Path('none')); b.load_chains(alone=True);"
    script += " assert 'emcee' in sys.modules and 'scipy.stats' not in sys.modules;"
    script += " import scipy.stats; assert scipy.stats.norm.cdf(0.0) == 0.5"
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)


# --- kept on disk
# ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where this test's programs are kept."""
    monkeypatch.setenv(kept.SWITCH, str(tmp_path / "programs"))
    monkeypatch.setattr(kept, "_folder", [])
    return tmp_path / "programs"


@pytest.fixture
def keepable(program, monkeypatch):
    """A program as one of the package, whose text is known."""
    monkeypatch.setattr(shifted, "__module__", "sysid.shifted")
    return program


@pytest.fixture
def made(monkeypatch):
    """Names of the programs that are compiled."""
    names, whole = [], precision._compiled
    monkeypatch.setattr(precision, "_compiled", lambda *given: names.append(1) or whole(*given))
    return names


def asked(program):
    """What a new process would have of it."""
    program.programs.clear()
    with jax.enable_x64(True):
        return program(np.array([1.0, 2.0]), ("up",), (np.array([1e-12, 1.0]),)).tolist()


def test_a_program_is_compiled_once_for_all_processes(keepable, folder, made):
    assert asked(keepable) == asked(keepable) == [1 + 1e-12, 3.0]
    assert len(made) == 1 and len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda b: b"",
        lambda b: b[:-1],
        lambda b: b[:32] + b[33:],
        lambda b: sha256(b"other").digest() + b"other",
    ],
    ids=["empty", "cut off", "a byte less", "foreign"],
)
def test_a_broken_program_is_made_anew_and_mended(keepable, folder, made, spoilt):
    asked(keepable)
    (path,) = folder.iterdir()
    path.write_bytes(spoilt(path.read_bytes()))
    for _ in range(2):
        assert asked(keepable) == [1 + 1e-12, 3.0]
    assert len(made) == 2  # the second time it was there again


def test_another_code_flag_or_shape_is_another_program(keepable, folder, monkeypatch):
    asked(keepable)
    monkeypatch.setattr(kept, "_machine", lambda package: "another")
    asked(keepable)
    monkeypatch.setattr(kept, "_flags", lambda: "others")
    asked(keepable)
    assert len(list(folder.iterdir())) == 3


def test_a_program_that_fails_as_it_runs_is_made_anew(keepable, folder, made, monkeypatch):
    """As one of which JAX finds a function missing when it is called."""

    def fails(*_):
        raise jax.errors.JaxRuntimeError("NOT_FOUND: Function fusion not found")

    asked(keepable)
    with monkeypatch.context() as patch:
        patch.setattr(kept, "_read", lambda path: fails)
        assert asked(keepable) == [1 + 1e-12, 3.0] and len(made) == 2
    assert asked(keepable) == [1 + 1e-12, 3.0] and len(made) == 2  # it was mended


def test_where_jax_keeps_its_own_nothing_is_kept_twice(keepable, folder, made, monkeypatch):
    """What it loads lacks a part when it is written again."""
    monkeypatch.setattr(kept, "_cached_by_jax", lambda: True)
    assert asked(keepable) == asked(keepable) and len(made) == 2 and not folder.exists()


def test_switched_off_nothing_is_kept(keepable, folder, made, monkeypatch):
    monkeypatch.setenv(kept.SWITCH, "off")
    kept.choose(folder)  # not even where a program of its own would have it
    assert asked(keepable) == asked(keepable) and len(made) == 2 and not folder.exists()


def test_a_folder_that_cannot_be_is_done_without(keepable, folder, made):
    folder.write_text("in the way")
    assert asked(keepable) == asked(keepable) == [1 + 1e-12, 3.0] and len(made) == 2


def test_those_who_write_at_once_and_read_find_whole_programs(keepable, folder):
    asked(keepable)
    (path,), (program,) = folder.iterdir(), [p.result() for p in keepable.programs.values()]
    with ThreadPoolExecutor(4) as threads:
        writing = [threads.submit(kept._write, path, program) for _ in range(20)]
        found = [kept._read(path) for _ in range(5)]
    assert all(f is not None for f in found) and all(w.result() is None for w in writing)
    assert [p.name for p in folder.iterdir()] == [path.name]  # nothing on its way is left


def test_arrays_are_made_once_and_anew_where_they_are_damaged(folder, monkeypatch):
    calls = []

    def make():
        calls.append(1)
        return {"a": np.arange(3.0), "said": np.array(["", "why"])}

    def same(found):
        return found["a"].tolist() == [0.0, 1.0, 2.0] and found["said"].tolist() == ["", "why"]

    monkeypatch.setenv(kept.SWITCH, str(folder))
    assert all(same(kept.arrays("x", "one", make)) for _ in range(3)) and len(calls) == 1
    assert same(kept.arrays("x", "two", make)) and len(calls) == 2
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:-1] + b"?")
    assert same(kept.arrays("x", "one", make)) and len(calls) == 3
    assert same(kept.arrays("x", "one", make)) and len(calls) == 3
    monkeypatch.setenv(kept.SWITCH, "off")
    assert same(kept.arrays("x", "one", make)) and len(calls) == 4


@pytest.mark.skipif(sys.platform == "win32", reason="has no such locks")
def test_arrays_that_many_want_at_once_are_made_once(folder, monkeypatch):
    calls = []

    def make():
        calls.append(1)
        time.sleep(0.2)
        return {"a": np.arange(3.0)}

    monkeypatch.setenv(kept.SWITCH, str(folder))
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: kept.arrays("x", "one", make)["a"].tolist(), range(4)))
    assert found == [[0.0, 1.0, 2.0]] * 4 and len(calls) == 1
    assert len(list(folder.iterdir())) == 1  # no lock is left


def test_what_was_not_used_for_longest_goes_first(keepable, folder, monkeypatch):
    asked(keepable)
    (program,) = folder.iterdir()
    for k, name in enumerate(("oldest", "older")):
        (folder / name).write_bytes(bytes(1000))
        os.utime(folder / name, (k, k))
    os.utime(program, (2, 2))
    asked(keepable)  # read again: the youngest
    assert program.stat().st_mtime > 2
    monkeypatch.setattr(kept, "LARGEST", program.stat().st_size + 1000)
    kept._drop(folder)
    assert {p.name for p in folder.iterdir()} == {program.name, "older"}


def test_a_fit_is_the_same_bytes_with_kept_programs_and_without(bundled, folder, made, monkeypatch):
    """And in a new process, whose JAX is left as it was."""
    log = bundled["plate"]["sweep_24C"]

    def bits():
        for function in precision._all:
            function.programs.clear()
        fit = sysid.fit([log])
        return fit.covariance.tobytes().hex() + fit.modes[0].theta.tobytes().hex()

    first, count = bits(), len(made)
    assert count and bits() == first and len(made) == count
    script = (
        "import jax, sysid, sys; before = dict(jax.config.values); fit ="
        " sysid.fit(sysid.read_logs(sys.argv[1]))"
    )
    script += "; assert dict(jax.config.values) == before"
    script += "; print(fit.covariance.tobytes().hex() + fit.modes[0].theta.tobytes().hex(), end='')"
    done = subprocess.run(
        [sys.executable, "-c", script, log.path], capture_output=True, text=True, check=True
    )
    assert done.stdout == first and len(list(folder.iterdir())) == count
    monkeypatch.setenv(kept.SWITCH, "off")
    assert bits() == first and len(made) == 2 * count


def test_a_simulation_is_the_same_bytes_with_kept_programs_and_without(folder, monkeypatch):
    from conftest import SYNTHETIC

    scene = sysid.Scene.from_toml(SYNTHETIC / "scenes" / "touch.toml")

    def bits():
        for function in precision._all:
            function.programs.clear()
        return scene.simulate(seed=3).response.tobytes()

    first, count = bits(), len(list(folder.iterdir()))
    assert count and bits() == first and len(list(folder.iterdir())) == count
    monkeypatch.setenv(kept.SWITCH, "off")
    assert bits() == first


def test_a_fit_takes_one_thread_of_blas_and_gives_the_others_back():
    def threads():
        return {lib["filepath"]: lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}

    inside = precision.one_thread(threads)
    before = threads()
    with threadpool_limits(2, "blas"):
        assert set(inside().values()) == {1}
        assert set(threads().values()) <= {1, 2}
    assert threads() == before
    with pytest.raises(ZeroDivisionError):
        precision.one_thread(lambda: 1 / 0)()
    assert threads() == before
