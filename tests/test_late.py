"""A response that begins late: the delay that is named is the one to state."""

import re
from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds, study

import sysid
from sysid import Result
from sysid.rows.condense import taken

FINE = 20  # steps of the simulation from row to row


def late_by(bench, rows, seed, order=0):
    """A step that is seen `rows` rows of 0.1 ms late, or behind a filter of `order` poles which are late by as much in all."""
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


def named(fit):
    """Of the warnings: the delay (s), and between which ones it may be."""
    number = r"of about (\S+) s(?: \((\S+) to (\S+) s fit as well\))?"
    found = re.search(rf"begins late, .* {number}, .*lockin_tau_s and lockin_order", " ".join(fit.warnings))
    assert found, fit.warnings
    return [float(x) for x in found.groups() if x]


@pytest.mark.parametrize("rows", [study(1.5), study(2.5), 3.5, study(6.0)])
@seeds(1, 3)
def test_the_delay_that_is_named_is_the_one_to_state(bench, seeds, rows):
    for seed in seeds:
        log = late_by(bench, rows, seed)
        fit = sysid.fit([log])
        if fit.result is Result.successful:  # a late row or two is within what is expected
            assert rows < 3
            continue
        delay, low, high = named(fit)
        assert low <= delay <= high and low < 1e-4 * rows + 5e-6 and high > 1e-4 * rows - 5e-6  # a step of the simulation
        stated = sysid.fit([replace(log, bench={"delay_s": delay})])
        assert stated.result is Result.successful, stated.warnings
        for name in ("G", "tau", "f0"):
            p = stated.parameters[name]
            # the bench's feedthrough, 0.6 % of the response along it, passes for a delay: of G by as much
            assert abs(p.value - getattr(bench.plant, name)) < 4 * p.std + 0.006 * bench.plant.G * (name == "G"), (name, delay)


@pytest.mark.parametrize("rows", [study(3), 6, study(10)])
@seeds(1, 3)
def test_a_response_that_begins_before_its_change_is_named_and_known_once_that_is_stated(bench, seeds, rows):
    """Inputs that are written down late: what the rows before the change show passed for noise that they share."""
    for seed in seeds:
        log = late_by(bench, 0.0, seed)
        log = replace(log, drive=np.concatenate([np.zeros(rows), log.drive[:-rows]]))
        fit = sysid.fit([log])
        assert fit.result is Result.misfit and any("before it should" in w for w in fit.warnings), fit.warnings
        stated = sysid.fit([replace(log, bench={"delay_s": -1e-4 * rows})])
        assert stated.result is Result.successful, stated.warnings
        for name in ("G", "tau", "f0"):
            p = stated.parameters[name]
            assert abs(p.value - getattr(bench.plant, name)) < 4 * p.std + 0.006 * bench.plant.G * (name == "G"), name


def test_a_delay_that_is_stated_too_short_is_named_anew(bench):
    log = late_by(bench, 3.5, 1)
    fit = sysid.fit([replace(log, bench={"delay_s": 1.7e-4})])
    assert fit.result is Result.misfit, fit.parameters
    assert named(fit)[0] == pytest.approx(3.5e-4, abs=5e-5)  # half a row


@seeds(1, 3)
def test_a_delay_that_is_stated_too_long_is_no_noise(bench, seeds):
    """Two rows late, and said to be five: what is read in the three between passed for noise that rows share."""
    for seed in seeds:
        fit = sysid.fit([replace(late_by(bench, 2.0, seed), bench={"delay_s": 5e-4})])
        assert fit.result is Result.misfit, fit.parameters
        found = re.search(r"before it should .* delay_s of (\S+)", " ".join(fit.warnings))
        assert float(found[1]) == pytest.approx(2e-4, abs=5e-5), fit.warnings  # half a row


def test_behind_a_filter_no_delay_is_the_right_one(bench):
    """One pole of a tenth of tau: as a delay it fits better than not, and is still a misfit."""
    log = late_by(bench, 1.67, 2, order=1)
    delay = named(sysid.fit([log]))[0]
    fit = sysid.fit([replace(log, bench={"delay_s": delay})])
    assert fit.result is Result.misfit
    assert any("in another way than by the" in said and "lockin_tau_s" in said for said in fit.warnings), fit.warnings
    right = sysid.fit([replace(log, bench={"lockin_tau_s": 1.67e-4, "lockin_order": 1.0})])
    assert right.result is Result.successful, right.warnings
