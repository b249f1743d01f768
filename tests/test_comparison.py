"""Descriptions of the same logs: leave-one-out against leaving out, nuisances against fits without them,
chance findings."""

from types import SimpleNamespace

import numpy as np
import pytest
import reference
from scipy.stats import binom, norm

import sysid
from sysid.trials.trial import NUISANCES
from sysid.verdict.comparison import _elpd, compare, verdict

VOLTS, FREQUENCY = np.full(101, 100.0), np.linspace(31800, 32800, 101)


def sweep(bench, seed, turn=0.0, leak=0.0):
    """A sweep with 1 % of noise, turned by `turn` (rad), with `leak` of the drive in it; the bench adds
    nothing else."""
    clean = reference.steady(bench.plant, VOLTS, FREQUENCY, np.full(101, 24.0))
    noise = reference.noise(101, 0.02, seed, np.zeros(101), 0.0)
    return sysid.Log(
        "sweep", np.exp(1j * turn) * clean + leak * VOLTS + noise, drive=VOLTS, frequency=FREQUENCY
    )


def found(fit):
    return {c.description: c for c in compare(fit)}


def test_a_row_s_density_is_that_of_a_fit_without_it():
    """Linear regression: columns of a bench with priors, columns of a plant; each row left out and fitted
    anew by numpy."""
    rng = np.random.default_rng(0)
    n, sigma = 30, 0.7
    bench, plant = rng.normal(size=(n, 3)), rng.normal(size=(n, 2))
    y = bench @ [1.0, -1.0, 0.5] + plant @ [2.0, 1.0] + sigma * rng.normal(size=n)
    priors = np.diag([2.0, 0.5, 0.1])
    basis = np.linalg.qr(np.concatenate([bench, priors]))[0]

    def off(v):
        padded = np.concatenate([v, np.zeros((3, *v.shape[1:]))])
        return padded - basis @ (basis.T @ padded)

    jacobian, rest = off(plant), off(y)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    left = rest - jacobian @ (inverse @ jacobian.T @ rest)
    view = SimpleNamespace(recorded=np.zeros(n + 3), priors=3, basis=basis)
    leverage = np.sum(basis[:n] ** 2, axis=1) + np.einsum("ri,ij,rj->r", jacobian[:n], inverse, jacobian[:n])
    level = np.sqrt(np.sum(left**2) / np.sum(1 - leverage))

    columns = np.concatenate([np.column_stack([bench, plant]), np.column_stack([priors, np.zeros((3, 2))])])
    target = np.append(y, np.zeros(3))
    expected = []
    for i in range(n):
        others = np.arange(n + 3) != i
        gram = np.linalg.inv(columns[others].T @ columns[others])
        predicted = columns[i] @ gram @ columns[others].T @ target[others]
        expected.append(norm.logpdf(y[i], predicted, level * np.sqrt(1 + columns[i] @ gram @ columns[i])))
    density = _elpd(view, jacobian, left, inverse) - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(density, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "name"), [({"turn": 0.006}, "rotation"), ({"leak": 1e-5 + 2e-5j}, "background")]
)
def test_moves_are_those_of_a_fit_without_it(bench, changes, name):
    log = sweep(bench, 1, **changes)
    fit = sysid.fit([log])
    without = sysid.fit([log], nuisances=tuple(n for n in NUISANCES if n != name))
    std = np.sqrt(np.diag(fit.covariance))
    for k, symbol in enumerate(fit.names):
        actual = (getattr(without.plant, symbol) - getattr(fit.plant, symbol)) / std[k]
        # second order in moves of about one standard deviation, of parameters known to 1 %
        assert found(fit)[f"without {name}"].moves[symbol] == pytest.approx(actual, abs=0.05)


def test_what_the_logs_need_is_worse_left_out_and_is_said(bench):
    fit = sysid.fit([sweep(bench, 2, turn=0.3, leak=0.002)])
    told = found(fit)
    assert told["without rotation"].worse and told["without background"].worse
    assert not told["slowly varying envelope"].worse  # 0.1 Hz of f0 at this Q, below what one sweep can see
    assert verdict(compare(fit)).startswith("worse: without background (-")


def test_a_step_beside_resonance_needs_its_detuning(bench):
    near, far = (sysid.fit([bench.transient(seed=3, frequency=f)]) for f in (32300.0, 32250.0))
    assert found(far)["first order, without detuning"].worse
    assert not found(near)["first order, without detuning"].worse


@pytest.mark.study
def test_what_is_not_there_is_seldom_needed(bench):
    """Neither a rotation nor a background: each is called needed in one of twenty by design."""
    fits = [sysid.fit([sweep(bench, 100 + k)]) for k in range(40)]
    for name in ("rotation", "background"):
        count = sum(found(fit)[f"without {name}"].worse for fit in fits)
        assert count <= binom.ppf(0.999, 40, 0.05), name


def test_five_of_its_own_errors_are_seldom_missed(bench):
    """A rotation of five of its own standard deviations (0.17 degrees each, for such a sweep without a
    background)."""
    logs = [sweep(bench, 200 + k, turn=5 * np.deg2rad(0.17)) for k in range(20)]
    fits = [sysid.fit([log], nuisances=("rotation",)) for log in logs]
    assert sum(found(fit)["without rotation"].worse for fit in fits) >= binom.ppf(1e-3, 20, 0.95)
