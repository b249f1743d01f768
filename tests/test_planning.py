"""What to record next: an experiment does what was promised of it, and the promise comes before it is recorded."""

import numpy as np
import pytest
import reference

import sysid

SEEDS = 8


def recorded(bench, experiment, seed):
    """The log that the bench gives of an experiment, by tests/reference.py, with rotation and noise of 0.02 um a channel."""
    log = experiment.log(np.zeros(experiment.rows, complex), bench.transient())
    inputs = log.drive, log.frequency, log.temperature
    clean = reference.steady(bench.plant, *inputs) if log.time is None else reference.ringing(bench.plant, log.time, *inputs)
    noise = reference.noise(len(log), 0.02, seed, np.zeros(len(log)), 0.0)
    return experiment.log(np.exp(0.7j) * clean + noise, log)


def after(bench, logs, parameter, seed):
    """The error that was promised over the one that there is, once the first advice is followed."""
    best = sysid.advise(sysid.fit(logs), parameter)[0]
    return best.after / sysid.fit([*logs, recorded(bench, best.experiment, 100 + seed)]).parameters[parameter].std


@pytest.mark.parametrize(
    ("parameter", "given"),
    [("k_T", "sweep"), ("G", "step"), ("tau", "sweep"), ("f0", "step")],
)
def test_the_error_shrinks_to_what_was_promised(bench, parameter, given):
    make = {"sweep": lambda s: bench.sweep(seed=s, noise=0.01), "step": lambda s: bench.transient(seed=s)}[given]
    ratios = [after(bench, [make(seed)], parameter, seed) for seed in range(SEEDS)]
    # each log's noise is estimated from 100 to 240 rows: 3 to 5 % of an error, twice in a ratio
    assert np.all(np.abs(np.array(ratios) - 1) < 0.2)


def test_one_temperature_is_cured_by_another(bench):
    best = sysid.advise(sysid.fit([bench.sweep(), bench.transient()]))[0]
    assert best.parameter == "k_T" and best.settles and abs(best.experiment.temperature - 24.0) == 10.0
    assert best.seconds > 600  # the plate has to warm


def test_what_the_bench_can_do_is_asked(bench):
    fit = sysid.fit([bench.sweep()])
    few = sysid.advise(fit, "k_T", drive=50.0, temperatures=[24.0, 27.0])
    assert {a.experiment.drive for a in few} == {50.0} and {a.experiment.temperature for a in few} == {27.0}
    more = sysid.advise(fit, "k_T", drive=50.0, temperatures=[24.0, 34.0])
    assert more[0].after < 0.5 * few[0].after


def test_the_best_per_second_is_first_and_no_experiment_is_for_nothing(bench):
    found = sysid.advise(sysid.fit([bench.transient()]), "tau", warming=0.0)
    rates = [a.rate for a in found]
    assert rates == sorted(rates, reverse=True) and all(a.after < a.before for a in found)
    assert "tau from ±" in str(found[0]) and str(found[0]).endswith(" s")


def test_without_a_drive_or_a_frequency_there_is_no_advice(bench):
    assert sysid.advise(sysid.fit([bench.sweep(drive=False)])) == ()


def test_a_parameter_that_there_is_not_is_refused(bench):
    with pytest.raises(ValueError, match="found 'Q', expected one of G, tau, f0, k_T, worst"):
        sysid.advise(sysid.fit([bench.sweep()]), "Q")
