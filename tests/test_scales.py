"""A unit decides nothing: logs in units from 1e-9 to 1e9 of what they were get the same verdict, in the same
words."""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import study, tiers
from test_filter_effect import filtered_step, settled_sweep

import sysid

NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?(?: [munp]?s\b)?")  # a time's prefix is of its size
SCALES = [(1e-9, 1, 1), (1e9, 1, 1), (1, 1e-9, 1), (1, 1e9, 1), (1e-9, 1e-9, 1), (1, 1, 1e-9), (1, 1, 1e9)]


def scaled(log, response, drive, time):
    bench = {k: v * time if k in ("lockin_tau_s", "delay_s", "settle_s") else v for k, v in log.bench.items()}
    rest = {
        "drive": None if log.drive is None else log.drive * drive,
        "time": None if log.time is None else log.time * time,
    }
    frequency = None if log.frequency is None else log.frequency / time
    return replace(log, response=log.response * response, frequency=frequency, bench=bench, **rest)


def told(fit, response, drive, time):
    """The result, numbers in the first unit, and sentences without theirs."""
    units = {"G": response / drive, "tau": time, "f0": 1 / time, "k_T": 1 / time}
    numbers = {n: (p.value / units[n], p.std / units[n]) for n, p in fit.parameters.items() if p.determined}
    return fit.result, numbers, [NUMBER.sub("#", w) for w in (*fit.warnings, *fit.notes)]


@pytest.fixture(scope="module")
def logs(bench):
    """What is described; what hangs on a comparison of descriptions with other numbers; what is not
    described."""
    gain = settled_sweep(0, 3e-3)
    return {
        "a step and a sweep": [bench.transient(seed=1), bench.sweep(seed=2)],
        "a step behind a filter": [filtered_step(0, 4e-4, 1, 1.5e-2), settled_sweep(0, 1.5e-2)],
        "a step of another gain": [filtered_step(1, 1e-4, 0, 3e-3), replace(gain, drive=2.0 * gain.drive)],
        "amplitudes": [replace(log := bench.sweep(seed=3), response=np.abs(log.response))],
        "a sweep that is no resonance": [
            replace(log := bench.sweep(seed=4), response=log.response + np.abs(log.response) ** 2)
        ],
    }


@pytest.mark.parametrize(
    "name",
    [
        "a step and a sweep",
        study("a step behind a filter"),
        study("a step of another gain"),
        study("amplitudes"),
        study("a sweep that is no resonance"),
    ],
)
@pytest.mark.parametrize("every", tiers(SCALES[::3], SCALES))
def test_a_unit_decides_nothing(logs, name, every):
    first = told(sysid.fit(logs[name]), 1.0, 1.0, 1.0)
    for scales in every:
        result, numbers, said = told(sysid.fit([scaled(log, *scales) for log in logs[name]]), *scales)
        assert (result, said) == (first[0], first[2]), scales
        for n, pair in first[1].items():
            # the search is by float64 in either unit: a thousandth of an error
            assert abs(numbers[n][0] - pair[0]) < 1e-2 * pair[1], (scales, n)
            assert numbers[n][1] == pytest.approx(pair[1], rel=1e-2), (scales, n)
