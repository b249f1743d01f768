"""What is known beforehand: as one more measurement where the logs tell too, and never instead of them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import sysid
from sysid.command.cli import main
from sysid.model.prior import Prior
from sysid.model.theta import NAMES


def noisy(bench, seed=0, **given):
    return bench.transient(seed=seed, noise=0.1, **given)


@pytest.mark.parametrize("name", ["tau", "f0", "G"])
def test_a_prior_counts_as_one_more_measurement(bench, name):
    """Of a normal posterior: precisions add, and the mean is theirs. A lone parameter is stated, half as sure
    as the logs are, one of its standard deviations off what they say."""
    logs = [noisy(bench), bench.sweep(seed=2, noise=0.1)]  # which hold no hint of an effect
    first = sysid.fit(logs)
    told = (*first.warnings, *first.notes)
    assert not any("the logs differ" in w for w in told)  # else the errors are wider than the likelihood
    told = first.parameters[name]
    value, std = told.value + 2 * told.std, 2 * told.std
    found = sysid.fit(logs, priors={name: (value, std)}).parameters[name]
    weights = np.array([told.std**-2, std**-2])
    # The likelihood is normal to the error's share of the value, some per cent.
    assert found.std == pytest.approx(1 / np.sqrt(weights.sum()), rel=0.05)
    assert abs(found.value - weights @ [told.value, value] / weights.sum()) < 0.1 * told.std


def test_chains_and_fit_have_the_same_prior(bench):
    logs = [noisy(bench)]
    fit = sysid.fit(logs, priors={"tau": (bench.plant.tau, 0.02 * bench.plant.tau)})
    drawn = sysid.sample(fit, seed=1).summary()["tau"]
    alone = sysid.sample(sysid.fit(logs), seed=1).summary()["tau"]
    assert drawn.std < 0.02 * bench.plant.tau < 0.5 * alone.std
    assert drawn.std == pytest.approx(fit.parameters["tau"].std, rel=0.05)


def test_what_the_logs_do_not_tell_a_prior_does_not_determine(bench):
    """A twentieth of a time constant: tau is as it was stated, and called undetermined."""
    rows = np.repeat([0.0, 100.0], [20, 80])
    logs = [bench.transient(volts=rows, dt=1e-6)]
    fit = sysid.fit(logs, priors={"tau": (bench.plant.tau, 0.05 * bench.plant.tau)})
    tau = fit.parameters["tau"]
    assert not tau.determined and tau.value is None and "not what the logs tell" in tau.why
    assert np.sqrt(fit.modes[0].covariance[1, 1]) < 0.06  # the posterior has it


@pytest.mark.study
def test_it_says_where_the_prior_speaks_and_where_the_logs_contradict_it(bench):
    logs, tau = [noisy(bench)], bench.plant.tau
    speaks = sysid.fit(logs, priors={"tau": (tau, 0.01 * tau)}).warnings
    assert any(w.startswith("tau: what is stated beforehand speaks") for w in speaks)
    clear = sysid.fit([bench.sweep()], priors={"tau": (tau, 0.5 * tau)}).warnings
    assert not any("beforehand" in w for w in clear)


def test_what_the_logs_contradict_is_told_and_not_used(bench):
    """In ms, or in kHz, it pulled the fit so far away that what the logs say was extrapolated to nonsense."""
    sweep, step, plant = bench.sweep(), noisy(bench), bench.plant
    for logs, priors, unit in (
        ([sweep], {"f0": (plant.f0 + 40.0, 2.0)}, "Hz"),
        ([sweep], {"f0": (1e-3 * plant.f0, 0.1)}, "Hz"),
        ([step], {"tau": (1e3 * plant.tau, 0.1)}, "s"),
    ):
        (name,) = priors
        fit, plain = sysid.fit(logs, priors=priors), sysid.fit(logs)
        told, own = fit.parameters[name], plain.parameters[name]
        assert (told.value, told.std) == (own.value, own.std) and not fit.priors
        said = float(re.match(f"{name}: the logs alone say ([^ ]+)", fit.warnings[0])[1])
        assert said == pytest.approx(own.value, abs=own.std)  # the mean of a posterior of few draws
        assert f" {unit}, " in fit.warnings[0] and "check which is wrong" in fit.warnings[0]


def test_of_two_solutions_it_picks_the_one_that_was_expected(bench):
    """The amplitude of a step beside the resonance: on which side, a data sheet may know."""
    half_bandwidth = 1 / (2 * np.pi * bench.plant.tau)
    step = bench.transient(frequency=bench.plant.f0 + 1.5 * half_bandwidth, seed=3)
    logs = [replace(step, response=np.abs(step.response))]
    assert len(sysid.fit(logs).modes) == 2
    fit = sysid.fit(logs, priors={"f0": (bench.plant.f0 + 20.0, 50.0)})
    f0 = fit.parameters["f0"]
    assert len(fit.modes) == 1 and f0.determined and abs(f0.value - bench.plant.f0) < 4 * f0.std


def test_f0_is_stated_at_the_reference_temperature(bench):
    """Logs at 20 and 30 degC, f0 stated at 24: the line through their resonances is held there."""
    logs = [bench.sweep(temperature=t, seed=int(t), noise=0.3) for t in (20.0, 30.0)]
    stated = (bench.plant.f0 + 3.0, 0.01)
    found = sysid.fit(logs, priors={"f0": stated}).parameters["f0"]
    assert found.value == pytest.approx(stated[0], abs=0.05)


def test_a_prior_is_a_quadratic_form():
    prior = Prior.of({"tau": (2e-3, 1e-4), "f0": (32310.0, 5.0)}, (32300.0, 26.0), -2.0)
    theta = np.array([0.3, np.log(2.1e-3), 4.0, -3.0, 0.0, 0.0])
    f0 = 32300.0 + 4.0 - 3.0 * -2.0
    expected = 0.5 * (np.log(2.1e-3 / 2e-3) / 0.05) ** 2 + 0.5 * ((f0 - 32310.0) / 5.0) ** 2
    assert prior.cost(theta) == pytest.approx(expected, rel=1e-12)
    moves = 1e-5 * np.eye(len(NAMES))
    slope = (prior.cost(theta + moves) - prior.cost(theta - moves)) / 2e-5
    np.testing.assert_allclose(prior.slope(theta), slope, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"Q": (100.0, 1.0)}, "found a prior of 'Q', expected one of G, tau"),
        ({"tau": (1e-3, 0.0)}, "expected a number and a standard deviation above 0"),
        ({"tau": (-1e-3, 1e-4)}, "expected a value above 0"),
        ({"f0": (float("nan"), 1.0)}, "expected a number"),
    ],
)
def test_a_prior_that_is_none_is_refused(bench, given, said):
    with pytest.raises(ValueError, match=said):
        sysid.fit([bench.sweep()], priors=given)


def test_the_command_takes_priors(bench, tmp_path, capsys):
    path = tmp_path / "step.csv"
    sysid.write_log(noisy(bench), path)
    folder = tmp_path / "out"
    given = ["--prior=tau=1.67e-3+-0.02e-3", "--prior", "f0=32300±5", "--accuracy", "quick"]
    assert main([str(path), "-o", str(folder), *given]) == 0
    content = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    assert content["uncertainty"]["priors"]["tau"] == "normal about 0.00167, 2e-05 wide"
    assert content["parameters"]["tau"]["std"] < 2e-5 and "f0" in content["uncertainty"]["priors"]
    for bad in ("tau", "tau=1", "tau=1+-x", "Q=1+-1"):
        with pytest.raises(SystemExit) as stop:
            main([str(path), f"--prior={bad}"])
        assert (
            stop.value.code == 2
            and "expected a name, a value and a standard deviation" in capsys.readouterr().err
        )
