"""Logs of the kinds that people bring: nothing silently wrong, no cause that is not there. The study is
benchmarks/kinds.py."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import most, seeds, study

import sysid

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import kinds

CASES = {
    ("half of the step settles at once", "fast 1 ms"): ("told", "is there within a row"),
    ("half of the step settles at once", "at once"): ("told", "is there within a row"),
    ("a second-order step", "zeta 0.3"): ("told", "of second order: it overshoots"),
    ("a second-order step", "zeta 0.6"): ("told", "of second order: it overshoots"),
    ("ring-down of amplitudes on an offset", "below"): ("right", "successful"),
    ("sweep, set, wait, read", "own"): ("right", "the logs do not tell"),
    ("sweep, set, wait, read", "own, back"): ("right", "sampling: settled, as the logs show"),
    ("sweep too fast, without times", "dwell 0.4 tau"): ("right", "swept too fast"),
    ("feedthrough under amplitudes", "5%"): ("right", "lies a feedthrough"),
    ("a low-pass", "tau 0.0007 s"): ("told", "no resonance is seen"),
    ("a drive of 1e-9 to 1e7 V", "1e-07 V"): ("right", "successful"),
    ("a step that is late, beside a sweep", "0.3 ms"): ("right", "s behind the inputs"),
    ("restless, then a decay", "swing 0.1"): ("right", "restless"),
}


LATER = {  # the study's: other variants of these kinds, or tests of their own, say as much
    ("half of the step settles at once", "at once"),
    ("a second-order step", "zeta 0.3"),
    ("a second-order step", "zeta 0.6"),
    ("ring-down of amplitudes on an offset", "below"),
    ("sweep, set, wait, read", "own, back"),
    ("restless, then a decay", "swing 0.1"),
    ("a step that is late, beside a sweep", "0.3 ms"),
    ("sweep too fast, without times", "dwell 0.4 tau"),
    ("feedthrough under amplitudes", "5%"),
}


@pytest.mark.parametrize(
    ("kind", "variant"), [study(*c) if c in LATER else c for c in CASES], ids=lambda x: x
)
def test_what_is_said_of_a_kind(kind, variant):
    answer, said = CASES[kind, variant]
    of = kinds.KINDS[kind]
    found, words = kinds.verdict(of, *of.variants[variant](np.random.default_rng(7)))
    assert found == answer and said in words, words


def test_the_side_of_a_ring_down_on_an_offset_is_not_told():
    """|W + o| is the same for a resonance below the reference and one above it."""
    logs, truth = kinds.ring_down(-0.3, 0.6)(np.random.default_rng(1))
    f0 = sysid.fit(logs).parameters["f0"]
    assert not f0.determined and len(f0.modes) == 2
    assert min(abs(mode["value"] - truth["f0"]) / mode["std"] for mode in f0.modes) < 4


@pytest.mark.parametrize("own", [True, False])
def test_the_error_of_a_sweep_read_half_way_spans_both_readings(own):
    """A step of the sweep is 40 errors of f0; half of it is what is not known."""
    logs, truth = kinds.wait_and_read(own, 2.5)(np.random.default_rng(3))
    f0 = sysid.fit(logs).parameters["f0"]
    step = float(np.diff(logs[0].frequency[:2])[0])
    assert abs(f0.value - truth["f0"]) < 1.5 * f0.std and f0.std == pytest.approx(step / 2, rel=0.05)
    stated = sysid.fit(
        [sysid.Log(**{**_fields(logs[0]), "sampling": "settled" if own else "instant"})]
    ).parameters["f0"]
    assert abs(stated.value - truth["f0"]) < 4 * stated.std < f0.std


def _fields(log):
    return {n: getattr(log, n) for n in ("name", "response", "time", "drive", "frequency", "kind")}


@pytest.mark.parametrize("how", ["as it is", "of a current", study("conjugate"), study("amplitude")])
@seeds(4, 16)
def test_a_low_pass_is_told_with_its_numbers(seeds, how):
    """A coil's current: G 0.28, tau 0.7 ms."""
    off = []
    for seed in seeds:
        ((log,), _) = kinds.low_pass(7e-4)(np.random.default_rng(seed))
        ways = {"as it is": 1, "of a current": 1 / (2 * np.pi * log.frequency)}  # as that is read
        seen = {"conjugate": np.conj, "amplitude": np.abs}.get(how, lambda w: w)(log.response)
        (found,) = sysid.fit([replace(log, response=ways.get(how, 1) * seen)]).findings
        assert found.key == "overdamped" and found.outcome == "refused"
        off.append(
            [(found.numbers[n].value - v) / found.numbers[n].std for n, v in (("G", 0.28), ("tau", 7e-4))]
        )
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < most(seeds))
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) > 0.1)  # no guess


def test_what_falls_otherwise_is_no_low_pass_of_first_order():
    ((log,), _) = kinds.low_pass(7e-4)(np.random.default_rng(0))
    twice = log.response / (1 + 2j * np.pi * log.frequency * 2e-4)
    (found,) = sysid.fit([replace(log, response=twice)]).findings
    assert found.key == "overdamped" and not found.numbers


def test_nothing_is_called_noise_or_frequency_of_a_log_that_is_not_described():
    """No number below zero, and no advice on what the logs would tell."""
    logs, _ = kinds.low_pass(7e-4)(np.random.default_rng(0))
    fit = sysid.fit(logs)
    assert fit.result is sysid.Result.misfit
    assert all(p.value is None and "noise" not in (p.why or "") for p in fit.parameters.values())
