"""The ladder of accuracies: mixtures against known moments, estimates against a known posterior, the
budget."""

import io
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from matplotlib.image import imread
from scipy import stats

import sysid
from sysid.command import bill, clock, costcurve, outputs
from sysid.posterior import accuracy
from sysid.posterior import posterior as module
from sysid.posterior.chain import Chain
from sysid.posterior.estimate import Estimate
from sysid.posterior.mixture import Mixture
from sysid.posterior.target import Target
from sysid.report import costs, text
from sysid.trials.trial import Trial
from sysid.trials.whole import uncondensed
from sysid.verdict.result import Result

SWEEP = Path(__file__).parents[1] / "data" / "synthetic" / "sweep_24C.csv"
Z = 4.5  # standard deviations of chance


def test_even_draws_have_the_moments_of_the_mixture():
    one = Mixture(np.array([[1.0, -2.0]]), np.array([[[2.0, 0.0], [0.5, 0.3]]]), np.ones(1))
    z = one.spread(4096, np.random.default_rng(0))
    np.testing.assert_allclose(z.mean(axis=0), one.centres[0], atol=1e-12)
    np.testing.assert_allclose(np.cov(z.T, ddof=0), one.scales[0] @ one.scales[0].T, atol=1e-12)
    # Evenness: the quantiles of 4096 even draws are a tenth as far off as chance would have them, 0.04
    # standard deviations
    assert np.quantile(z[:, 0], 0.975) == pytest.approx(1 + 2 * 1.959964, abs=2 * 0.01)
    two = Mixture(np.array([[-50.0], [50.0]]), np.ones((2, 1, 1)), np.array([0.25, 0.75]))
    assert np.mean(two.spread(1000, np.random.default_rng(0)) > 0) == 0.75


def test_log_densities_are_those_of_scipy():
    centre, scale = np.array([1.0, -1.0]), np.array([[2.0, 0.0], [0.5, 0.3]])
    normal = Mixture(centre[None], scale[None], np.ones(1))
    z = np.random.default_rng(0).normal(size=(20, 2))
    for found, known in (
        (normal, stats.multivariate_normal(centre, scale @ scale.T)),
        (normal.heavy(), stats.multivariate_t(centre, scale @ scale.T, df=12)),
    ):
        apart = found.log_density(z) - known.logpdf(z)  # a constant
        np.testing.assert_allclose(apart, apart[0], atol=1e-12)


class Skewed:
    """A posterior known by heart: the logarithm of a gamma variable, of skewness -0.2, and a normal beside
    it."""

    shape, index, names, pace, evaluations = 25.0, (0, 1), ("a", "b"), 1e-6, 0
    known = stats.loggamma(25.0, loc=-np.log(25.0))  # its mode at zero

    def __init__(self):
        known = SimpleNamespace(determined=True)
        self.fit = SimpleNamespace(result=Result.successful, parameters=dict.fromkeys(self.names, known))

    def __call__(self, z):
        self.evaluations += len(z)
        a = z[:, 0] / np.sqrt(self.shape)  # z in units of the normal approximation at the mode
        return self.known.logpdf(a) - 2 * z[:, 1] ** 2

    def parameters(self, z):
        return {"a": z[:, 0] / np.sqrt(self.shape), "b": z[:, 1]}

    def marginals(self):
        even = stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000)
        return {
            "a": (even / np.sqrt(self.shape), np.full(20_000, 1 / 20_000)),
            "b": (0.5 * even, np.full(20_000, 1 / 20_000)),
        }

    def normal(self):
        return Mixture(np.zeros((1, 2)), np.diag([1.0, 0.5])[None], np.ones(1))


class Whole(Skewed):
    """The same moved by a twentieth of a standard deviation: what means of rows might have lost."""

    rows, shift = 1000, 0.01

    def __call__(self, z):
        return super().__call__(z - [self.shift * np.sqrt(self.shape), 0.0])


@pytest.fixture(scope="module")
def skewed():
    """Truth, the first rung's estimates and errors, and those of 1000 and 10 000 effective draws."""
    target = Skewed()
    first = {n: Estimate.of(*even) for n, even in target.marginals().items()}
    chain, found = Chain(target, target.normal().heavy(), 0), []
    for effective in (1000, 10_000):
        assert chain.extend(effective) and chain.reached(effective)
        found.append((*module._corrected(chain), chain.ess))
    found.append(module._corrected(chain, Whole()))
    low, high = target.known.ppf([0.025, 0.975])
    truth = {
        "a": Estimate(target.known.mean(), target.known.std(), low, high),
        "b": Estimate(0.0, 0.5, -0.5 * 1.959964, 0.5 * 1.959964),
    }
    return truth, first, module._off(target, first), found


def test_the_first_rung_says_how_far_it_is_off(skewed):
    truth, first, errors, _ = skewed
    off = abs(first["a"].value - truth["a"].value)
    # Of skewness 0.2: the mean is off by 0.1 standard deviations. Each of 64 points is 1/64 of the weight:
    # 0.03 deviations of a moment, and twice that at the ends, where the density is low.
    assert off == pytest.approx(0.1 * truth["a"].std, rel=0.05)
    for name, known in truth.items():
        for part in ("value", "std", "low", "high"):
            off = abs(getattr(first[name], part) - getattr(known, part))
            assert getattr(errors[name], part) == pytest.approx(
                off, abs=(0.06 if part in ("low", "high") else 0.03) * known.std
            ), (name, part)


def test_corrected_estimates_are_right_within_their_errors_and_far_better_than_draws(skewed):
    truth, _, _, found = skewed
    for (estimates, errors, effective), plain in zip(found[:2], (1000, 10_000), strict=True):
        assert effective >= plain
        for name, known in truth.items():
            for part in ("value", "std", "low", "high"):
                left = 1e-3 * known.std  # of the quantiles of the normal; errors that 16 blocks show: Z + 1
                off = abs(getattr(estimates[name], part) - getattr(known, part))
                assert off < (Z + 1) * getattr(errors[name], part) + left, (name, part)
        assert errors["a"].value < 0.3 * truth["a"].std / np.sqrt(effective)
    # ten times the draws: a third of the error, known to a fifth each
    assert found[1][1]["a"].value < 0.6 * found[0][1]["a"].value


def test_the_last_rung_is_that_of_every_row(skewed):
    estimates, errors = skewed[-1][2]
    before, _, _ = skewed[-1][1]
    for part in ("value", "low", "high"):
        moved = getattr(estimates["a"], part) - getattr(before["a"], part)
        # 256 points see a shift of a twentieth of a deviation to a sixteenth of it, an interval's end to a
        # quarter
        assert abs(moved - Whole.shift) < (0.3 if part == "value" else 1.2) * Whole.shift, part
    assert errors["a"].value < 0.3 * Whole.shift


def test_a_condensed_log_has_its_rows_back():
    time_s = 1e-5 * np.arange(30_000)
    drive = np.where(time_s < 0.01, 0.0, 100.0)
    noise = np.random.default_rng(0).normal(size=(2, 30_000))
    log = sysid.Log(
        "long",
        noise[0] + 1j * noise[1],
        time=time_s,
        drive=drive,
        frequency=np.full(30_000, 3e4),
        kind="transient",
    )
    trial = Trial.of(log, "transient")
    whole = uncondensed(trial)
    assert (
        len(trial.log) < 5000
        and len(whole.log) == 30_000
        and whole.noise.count.sum() == trial.noise.count.sum() == 30_000
    )
    np.testing.assert_array_equal(whole.log.response, log.response)
    assert uncondensed(whole) is whole and Trial.of(whole.log, "transient", ()).whole is not None


def test_a_last_rung_without_time_for_every_row_leaves_the_one_before(monkeypatch):
    time_s, frequency = 1e-6 * np.arange(20_000), np.full(20_000, 3e4)
    drive, noise = np.where(time_s < 2e-3, 0.0, 100.0), np.random.default_rng(0).normal(size=(2, 20_000))
    response = 2 * -np.expm1(-np.maximum(time_s - 2e-3, 0) / 1.5e-3) + 0.02 * (noise[0] + 1j * noise[1])
    given = {
        "time": time_s,
        "drive": drive,
        "frequency": frequency,
        "kind": "transient",
        "sampling": "instant",
    }
    fit = sysid.fit([sysid.Log("long", response, **given)])
    standard = sysid.sample(fit, accuracy="standard")
    # Every row is dearer than means of rows, of which there are a quarter.
    assert standard.offer().seconds > 4 * module.ROWS * standard.exact_pace

    def late(fit, every_row=False, until=np.inf, seed=0):
        return Target(fit, every_row, 0.0 if every_row else until, seed)

    monkeypatch.setattr(module, "Target", late)
    left = sysid.sample(fit, accuracy="exact")
    assert left.accuracy == "standard" and left.result is fit.result


# --- the budget of a run
# --------------------------------------------------------------------------------------------------


def budget(seconds, tmp_path, runs="", spent=0.0, **stages):
    record = tmp_path / "seconds.json"
    if runs:
        record.write_text(runs)
    measured = clock.Stages()
    measured.seconds |= stages
    return clock.Budget(seconds, time.perf_counter() - spent, measured, record)


def test_a_budget_below_the_measured_floor_is_refused(tmp_path):
    runs = '[{"load": 2.0, "files": 1.0, "chains": 0.5}, {"load": 4.0, "files": 0.5, "chains": 0}]'
    with pytest.raises(clock.BudgetError, match=r"found 2.5 s, expected at least 3 s"):
        budget(2.5, tmp_path, runs)
    with budget(2.5, tmp_path) as found:  # that hour was a busy one, perhaps: the next run is measured anew
        assert found.left is not None
    with pytest.raises(clock.BudgetError, match=r"found 3 s, expected at least 3.01 s"):
        budget(3, tmp_path, runs.replace("2.0", "2.0004"))
    with budget(10, tmp_path, runs, load=2.0, fit=1.0, spent=3.0) as found:
        # What the files took at most is set aside; half a second is a busy machine's pause.
        assert found.left == pytest.approx(10 - 3 - 1, abs=0.5)
    said = r"found 10 s, expected at least 12 s for these logs: load 2 s, files 1 s"
    with (
        budget(10, tmp_path, runs, load=2.0, spent=11.1) as found,
        pytest.raises(clock.BudgetError, match=said),
    ):
        assert found.left
    with budget(None, tmp_path, runs) as found:
        assert found.left is None


def test_runs_are_remembered_and_a_broken_record_is_none(tmp_path):
    found = budget(None, tmp_path, "{", load=2.0, fit=5.0, design=0.25, compare=0.125, report=0.375)
    assert found.runs == [] and found.files == 2.0  # nothing known yet: as long as starting
    for _ in range(2 * clock.RUNS):
        found.remember()
    again = budget(None, tmp_path)
    assert again.runs == [{"load": 2.0, "files": 0.75, "chains": 0.0}] and again.files == 0.75
    assert not list(tmp_path.glob("*.json.*"))


def test_a_run_is_stopped_at_its_budget_and_leaves_nothing(tmp_path):
    command = [sys.executable, "-m", "sysid", str(SWEEP), "--budget", "0.4"]
    nowhere = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path / "cache")
    }  # no record yet: nothing is known before it begins
    done = subprocess.run(command, cwd=tmp_path, env=nowhere, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == "" and not list(tmp_path.iterdir()), done.stderr
    said = re.search(
        r"--budget: found 0.4 s, expected more .* after (\S+) s; nothing was written", done.stderr
    )
    assert 0.4 < float(said[1]) < 1.2 * 0.4 + 5  # how late a busy machine may be to look at the clock


def test_the_bill_says_what_more_would_take():
    offer = module.Offer("exact", 7.04, "more")
    said = bill.sentence(0.0123, 0.84, offer)
    assert said == (
        "means and intervals are exact to 0.01 standard deviations; twice as exact would take 0.84 s more;"
        " --accuracy exact would take 7 s more, for more"
    )
    assert "not known" in bill.sentence(float("nan"), None, None)
    assert [text.span(s) for s in (0.0123, 99.0, 600.0, 36000.0)] == ["0.012 s", "99 s", "10 min", "10 h"]
    assert [r.name for r in accuracy.up_to("standard")] == ["quick", "standard"] and accuracy.above(
        "exact"
    ) is None


def test_a_cost_curve_adds_up_what_each_rung_stands_on():
    def rung(accuracy, value, error, below):
        estimates = {"tau": Estimate(value, 0.5, value - 1, value + 1)}
        return SimpleNamespace(
            accuracy=accuracy, estimates=estimates, error=error, evaluations=64, below=below, seconds=0.0
        )

    quick = rung("quick", 1.2, 0.5, None)
    top = rung("exact", 1.0, 0.01, rung("standard", 1.05, 0.1, quick))
    warm = {
        "load": 1.0,
        "load chains": 2.0,
        "read": 0.1,
        "fit": 3.0,
        "quick": 0.5,
        "standard": 4.0,
        "exact": 30.0,
    }
    found = costcurve.curve(top, {name: 10 * s for name, s in warm.items()}, warm)
    assert [p.warm_s for p in found.points] == pytest.approx([4.6, 10.6, 40.6])
    assert [p.cold_s for p in found.points] == pytest.approx([46, 106, 406])
    assert [p.distance for p in found.points] == [
        pytest.approx(0.4),
        pytest.approx(0.1),
        None,
    ]  # in standard deviations, 0.5
    assert costcurve.table(found.points)[1] == ("quick", "46 s", "4.6 s", "64", "0.5", "0.4")
    assert imread(io.BytesIO(costs.curve_figure(found.points)))[..., :3].std() > 0.01
    assert json.loads(outputs.to_json(found.as_dict()))["points"][0]["accuracy"] == "quick"


def test_what_this_process_compiled_is_forgotten(monkeypatch):
    from sysid import precision

    jax_too = []  # JAX's own, which the tests after this one need, is asked and stays
    monkeypatch.setattr(jax, "clear_caches", lambda: jax_too.append(True))
    double = precision.compiled(lambda x, layouts, groups: 2 * x)
    with jax.enable_x64(True):
        assert double(np.ones(3), (), ()).sum() == 6 and double.programs
        precision.forget_programs()
        assert jax_too and not double.programs and double(np.ones(3), (), ()).sum() == 6
