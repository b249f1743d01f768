"""Programs: made beside what goes on, in 64 bits, whatever options this JAX knows; what the command leaves unloaded."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import sysid
from sysid import precision


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
    program.prepare(lambda: (x, ("up",), groups))
    (begun,) = program.programs.values()
    np.testing.assert_array_equal(program(x, ("up",), groups), [1 + 1e-12, 3.0])  # float32 would lose the first
    assert list(program.programs.values()) == [begun]
    np.testing.assert_array_equal(program(x, ("down",), groups), [1 - 1e-12, 1.0])
    assert len(program.programs) == 2


@precision.float64
def test_a_host_program_is_given_no_threads(program):
    program.prepare(lambda: (np.ones(1), ("up",), (np.ones(1),)))
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
    made.prepare(lambda: (np.ones(2), (), (np.ones(3),)))  # not a matrix
    with pytest.raises((TypeError, ValueError)):
        made(np.ones(2), (), (np.ones(3),))
    precision._all.remove(made)


def test_the_minimum_is_told_before_the_rest(bench):
    told = []
    fit = sysid.fit([bench.sweep()], meanwhile=lambda state, reference: told.append((state, reference)))
    ((state, reference),) = told
    assert state is fit.modes[0] and reference == fit.reference


def test_the_command_does_without_the_libraries_that_emcee_does_not_need():
    script = "import sys, sysid.command.clock as c;"
    script += " b = c.Budget(None, 0.0, c.Stages(), c.Path('none')); b.load_chains(alone=True);"
    script += " assert 'emcee' in sys.modules and 'scipy.stats' not in sys.modules;"
    script += " import scipy.stats; assert scipy.stats.norm.cdf(0.0) == 0.5"
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)
