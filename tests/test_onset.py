"""Decays without a recorded drive, of a recorder that shows the level before as well.

The truth is A e^(-(t - t0)/tau) + c in closed form, after a level A + c.
"""

import numpy as np
import pytest
from conftest import most, sampled, seeds, study

import sysid
from sysid import Result
from sysid.rows.onset import onset

T = 0.01 * np.arange(600)  # s


def decaying(t0, tau=0.9, size=1.0, offset=0.0):
    return offset + size * np.exp(-np.maximum(T - t0, 0.0) / tau)


def log(rows, noise, seed=0, both=False):
    rng = np.random.default_rng(seed)
    added = rng.standard_normal(len(T)) + (1j * rng.standard_normal(len(T)) if both else 0.0)
    return sysid.Log("decay", rows + noise * added, time=T, kind="transient", response_unit="V")


@pytest.mark.parametrize(("t0", "offset"), [(0.5, 0.02), (2.0, 0.0)])
@seeds(3, 20)
def test_a_decay_after_a_level_is_fitted_from_where_it_begins(seeds, t0, offset):
    """As if the level were part of it, it was an amplitude in noise without a sign, whose damping depends on
    the amplitude, and tau was 8 % off."""
    z = []
    for seed in seeds:
        fit = sysid.fit([log(decaying(t0, offset=offset), 0.005, seed)])
        assert fit.result is Result.successful, fit.warnings
        said = " ".join(fit.warnings)
        begin = int(said.partition("it decays only from row ")[2].partition(" ")[0])
        assert 0 <= begin - 100 * t0 <= 4 and "record the drive" in said
        assert "without a sign" not in said and "damping" not in said
        assert len(fit.logs[0].log) == len(T) - begin
        z.append((fit.parameters["tau"].value - 0.9) / fit.parameters["tau"].std)
    assert np.sqrt(np.mean(np.square(z))) < most(seeds)


def test_one_that_is_cut_there_is_the_same():
    whole = log(decaying(1.0), 0.01)
    fit = sysid.fit([whole])
    begin = len(T) - len(fit.logs[0].log)
    cut = sysid.Log("cut", whole.response[begin:], time=T[begin:], kind="transient", response_unit="V")
    assert sysid.fit([cut]).parameters["tau"].value == fit.parameters["tau"].value


@pytest.mark.parametrize("noise", [0.003, 0.03])
@pytest.mark.parametrize("t0", [0.5, 1.0, 3.0])
@pytest.mark.parametrize(("size", "offset"), [study(1.0, 0.0), (1.0, 0.1), study(-1.0, 0.0), (60.0, 20.0)])
def test_the_row_is_told(t0, noise, size, offset):
    for seed in range(5):
        found = onset(log(decaying(t0, 0.9, size, offset), noise * abs(size), seed))
        assert -1 <= found - 100 * t0 <= 5 + 100 * noise


def test_of_d_and_q_too():
    turned = decaying(1.0) * np.exp(2j * np.maximum(T - 1.0, 0.0))
    assert 99 <= onset(log(turned, 0.01, both=True)) <= 105


RATE = np.exp(-T)
OTHERS = {
    "a decay": decaying(0.0),
    "one on an offset": decaying(0.0, offset=0.1),
    "one of d and q": decaying(0.0) * np.exp(2j * T),
    "dry friction": np.maximum(1 - T / 3, 0.0),
    "dry friction beside": np.maximum(1.3 * RATE - 0.3, 0.0),
    "drag of the air": RATE / (1 + 2 * (1 - RATE)),
    "damping of small amplitudes": 1 / np.sqrt(1 + 0.1 * (np.exp(2 * T) - 1)),
    "two time constants": 0.5 * np.exp(-T / 2) + 0.5 * np.exp(-T / 0.3),
    "two modes": np.abs(np.exp(-T / 2) * (1 + 0.5 * np.exp(3j * T))),
    "an oscillation": np.exp(-T / 2) * np.cos(3 * T),
    "a ramp": 1 - T / 6,
    "noise": 0 * T,
    "a step upwards": 1 - decaying(1.0),
    "a burst": np.where(T < 2, 1 - np.exp(-T / 0.5), 0.98 * np.exp(-(T - 2) / 0.5)),
    "a fall from row to row": np.where(T < 2, 1.0, 0.0),
}


@pytest.mark.parametrize("name", sampled(OTHERS))
def test_what_does_not_stay_at_a_level_is_left_whole(name):
    for noise in (0.003, 0.03):
        for seed in range(4):
            both = np.iscomplexobj(OTHERS[name])
            assert onset(log(OTHERS[name], noise, seed, both)) == 0, (noise, seed)


def test_a_log_with_a_drive_is_left_whole():
    drive = np.where(T < 1.0, 1.0, 0.0)
    driven = sysid.Log("step", decaying(1.0), time=T, drive=drive, kind="transient")
    assert onset(driven) == 0
