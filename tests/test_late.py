"""A response that begins late: the delay that is fitted is the one to state."""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds, study

import sysid
from sysid import Result
from sysid.effects.number import Number
from sysid.rows.condense import taken

FINE = 20  # steps of the simulation from row to row


def late_by(bench, rows, seed, order=0):
    """A step that is seen `rows` rows of 0.1 ms late, or behind a filter of `order` poles which are late by
    as much in all."""
    log = bench.transient(dt=1e-4 / FINE, volts=np.repeat([0.0, 100.0], [30 * FINE, 300 * FINE]), noise=0.0)
    response, steps = log.response, round(rows * FINE)
    for _ in range(order):
        response = behind_a_pole(response, steps / order)
    if not order:
        response = np.concatenate([np.repeat(response[:1], steps), response])[: len(response)]
    seen = taken(replace(log, response=response), np.arange(0, len(log), FINE))
    return replace(seen, response=seen.response + reference.noise(len(seen), 0.01, seed))


def behind_a_pole(response, steps):
    """What a low-pass with a time constant of so many steps makes of it."""
    keep, found = np.exp(-1 / steps), np.empty_like(response)
    found[0] = response[0]
    for k in range(1, len(response)):
        found[k] = keep * found[k - 1] + (1 - keep) * response[k]
    return found


TRUE = ("G", "tau", "f0")


def right(bench, fit):
    """Whether the plate is; the bench's feedthrough, 0.6 % of the response along it, passes for a delay: of G
    by as much."""
    off = {n: abs(fit.parameters[n].value - getattr(bench.plant, n)) for n in TRUE}
    return all(off[n] < 4 * fit.parameters[n].std + 0.006 * bench.plant.G * (n == "G") for n in TRUE)


def delay(fit):
    """The one that is fitted, beyond what is stated (s), and its error; of four poles or two in all, which
    are nearly one."""
    (found,) = [f for f in fit.findings if f.outcome == "fitted"]
    if found.key == "delay":
        return found.numbers["delay_s"]
    time, poles = (found.numbers[n] for n in ("lockin_tau_s", "lockin_order"))
    assert found.key == "filter" and poles.value > 1
    return Number(poles.value * time.value, poles.value * time.std, "s")


@pytest.mark.parametrize("rows", [study(1.5), study(2.5), 3.5, study(6.0)])
@seeds(1, 3)
def test_the_delay_that_is_fitted_is_the_one_to_state(bench, seeds, rows, among):
    for seed in seeds:
        log = late_by(bench, rows, seed)
        fit = sysid.fit([log], nuisances=among("delay"))
        assert fit.result is Result.successful and right(bench, fit), fit.warnings
        if not fit.findings:  # a late row or two is within what is expected
            assert rows < 3
            continue
        late = delay(fit)
        assert abs(late.value - 1e-4 * rows) < 4 * late.std + 5e-6  # a step of the simulation
        stated = sysid.fit([replace(log, bench={"delay_s": late.value})], nuisances=among("delay"))
        assert stated.result is Result.successful and right(bench, stated), stated.warnings


@pytest.mark.parametrize("rows", [study(3), 6, study(10)])
@seeds(1, 3)
def test_a_response_that_begins_before_its_change_is_fitted_and_known_once_that_is_stated(
    bench, seeds, rows, among
):
    """Inputs that are written down late: what the rows before the change show passed for noise that they
    share."""
    for seed in seeds:
        log = late_by(bench, 0.0, seed)
        log = replace(log, drive=np.concatenate([np.zeros(rows), log.drive[:-rows]]))
        fit = sysid.fit([log], nuisances=among("delay"))
        assert fit.result is Result.successful and right(bench, fit), fit.warnings
        early = delay(fit)
        assert abs(early.value + 1e-4 * rows) < 4 * early.std and "before the inputs" in " ".join(
            fit.warnings
        )
        stated = sysid.fit([replace(log, bench={"delay_s": -1e-4 * rows})], nuisances=among("delay"))
        assert stated.result is Result.successful and right(bench, stated), stated.warnings


@pytest.mark.parametrize(("rows", "stated"), [study(3.5, 1.7e-4), study(2.0, 5e-4)])
def test_a_delay_that_is_stated_wrongly_is_found_anew(bench, rows, stated):
    """Two rows late, and said to be five: what is read in the three between passed for noise that rows
    share."""
    fit = sysid.fit([replace(late_by(bench, rows, 1), bench={"delay_s": stated})])
    assert fit.result is Result.successful and right(bench, fit), fit.warnings
    assert abs(delay(fit).value + stated - 1e-4 * rows) < 4 * delay(fit).std


@pytest.mark.study  # test_filter_effect.py fits filters in every run
def test_behind_a_filter_it_is_that_which_is_fitted(bench):
    """One pole of a fifth of tau."""
    fit = sysid.fit([late_by(bench, 3.0, 2, order=1)])
    assert fit.result is Result.successful and right(bench, fit), fit.warnings
    (found,) = [f for f in fit.findings if f.outcome == "fitted"]
    time, poles = (found.numbers[n].value for n in ("lockin_tau_s", "lockin_order"))
    assert (
        found.key == "filter" and abs(poles * time - 3e-4) < 0.5 * 3e-4
    )  # the delay; how it is made up is not told
