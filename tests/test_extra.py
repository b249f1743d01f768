"""Drift of the resonance, lag of the temperature's sensor and a gain of each log's own, fitted where they are
asked for.

Responses come from a matrix exponential over steps so short that a drift is followed exactly.
"""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds, study
from scipy import stats

import sysid
from sysid.model.likelihood import OWN
from sysid.trials.extra import UNITS
from sysid.trials.trial import NUISANCES

PLANT = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=-8.0)
T0 = reference.REFERENCE_TEMPERATURE


def noisy(clean, seed, std=0.01):
    rng = np.random.default_rng(seed)
    return clean + std * (rng.standard_normal(len(clean)) + 1j * rng.standard_normal(len(clean)))


def up_and_down(seed, drift=0.0, lag=0.0):
    """A sweep up and down again in 2 s while the plate warms by 3 degC and cools, of which the sensor tells
    `lag` s late."""
    rows = 800
    time = np.linspace(0, 2, rows)
    frequency = PLANT.f0 - 12 + 400 * np.abs(time - 1) - 200
    told, rate = T0 + 3 * np.sin(np.pi * time / 2) ** 2, 1.5 * np.pi * np.sin(np.pi * time)
    plate = told + lag * rate
    moved = plate + drift * (time - 1) / PLANT.k_T  # a drift in Hz, as so many degC
    clean = reference.ringing(PLANT, time, np.full(rows, 100.0), frequency, moved)
    given = {"time": time, "drive": np.full(rows, 100.0), "frequency": frequency, "temperature": told}
    return sysid.Log("sweep", noisy(clean, seed), **given, kind="transient", sampling="instant")


def consistent(scores):
    """Whether sums of squares of values that should be unit normal are what they should be, but for one case
    in 1000."""
    z = np.asarray(scores)
    return bool(0.0005 < stats.chi2.cdf(np.sum(z**2), len(z)) < 0.9995)


@pytest.mark.parametrize(("name", "size"), [study("drift", 4.0), ("lag", 0.03)])
@seeds(2, 10)
def test_it_is_found_and_what_it_moves_is_right(seeds, name, size, nuisances):
    scores, own, plain = [], [], []
    for seed in seeds:
        log = up_and_down(seed, **{name: size})
        found = sysid.fit([log], nuisances=(*NUISANCES, name))
        f0 = found.parameters["f0"]
        assert found.result is sysid.Result.successful, found.warnings
        scores.append((f0.value - PLANT.f0) / f0.std)
        added = sysid.nuisances(found)[0][name]
        own.append((added.value - size) / added.std)
        plain += [sysid.fit([log], nuisances=nuisances).findings[0].key] if seed < 3 else []
    assert consistent(scores) and consistent(own)
    assert set(plain) == {{"drift": "f0_drift", "lag": "thermometer_lag"}[name]}


@pytest.mark.study
def test_logs_of_sensors_of_another_gain():
    """Four steps whose sensors differ: without it one of them contradicts the others."""
    time = np.arange(400) / 2e4
    drive, off = np.where(time < 2e-3, 0.0, 100.0), np.full(400, PLANT.f0 + 20)
    clean = reference.ringing(PLANT, time, drive, off, np.full(400, T0))
    given = {"time": time, "drive": drive, "frequency": off, "kind": "transient", "sampling": "instant"}
    gains = (1.0, 1.06, 0.93, 1.02)
    logs = [sysid.Log(f"step {k}", noisy(g * clean, k), **given) for k, g in enumerate(gains)]
    without = sysid.fit(logs, nuisances=[n for n in NUISANCES if n != "filter"])  # to look for one takes long
    assert without.result is sysid.Result.misfit
    found = sysid.fit(logs, nuisances=(*NUISANCES, "gain"))
    assert found.result is sysid.Result.successful, found.warnings
    G, tau = found.parameters["G"], found.parameters["tau"]
    assert abs(G.value - PLANT.G * np.mean(gains)) < 0.005 * PLANT.G  # with priors alike, their mean
    assert 0.04 < G.std / G.value < 0.06  # a tenth over the root of four
    assert abs(tau.value - PLANT.tau) < 4 * tau.std < 0.01 * PLANT.tau


def test_what_is_not_asked_for_is_not_there():
    log = up_and_down(0)
    plain = sysid.fit([log])
    assert plain.modes[0].trials[0].bench.extra == {}
    silent = sysid.fit(
        [replace(log, temperature=None)], nuisances=(*NUISANCES, "lag")
    )  # no temperature: nothing lags
    assert "lag" not in sysid.nuisances(silent)[0]


def test_every_number_of_a_log_has_a_row_for_its_prior():
    """A start, a lateness and all further effects at once: rows that are shared would mix their priors
    unsaid."""
    assert len(UNITS) + 2 <= OWN
