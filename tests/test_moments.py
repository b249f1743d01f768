"""Drives that change from row to row: to which moment of them does a row belong?"""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import study

import sysid
from sysid import Result
from sysid.trials.trial import NUISANCES

PLANT = reference.Plant(0.01, 1.67e-3, 32300.0, -10.0)
ROWS, STEP, FINE = 350, 2e-4, 40  # rows, s from one to the next, and how many steps of the truth that is
NOT_LATE = tuple(n for n in NUISANCES if n != "late")
FAR = 4.0  # standard deviations: by chance in one of 16 000


def edge(t):
    """A drive that is switched on and goes up and down."""
    return np.where(t > 0.004, 60 + 40 * np.sin(2 * np.pi * 90 * (t - 0.004)), 0.0)


def smooth(t):
    return 60 + 40 * np.sin(2 * np.pi * 90 * t)


def held(t):
    return smooth(np.floor(t / STEP + 1e-9) * STEP)


def recorded(drive, seed, frequency=lambda t: np.full(len(t), 32290.0)):
    """What a plate does whose drive has its value at every moment, and what is written down of it every
    STEP."""
    t = np.arange(ROWS * FINE) * STEP / FINE
    middle = t + 0.5 * STEP / FINE
    response = reference.ringing(PLANT, t, drive(middle), frequency(middle), np.full(len(t), 24.0))[::FINE]
    y = np.exp(0.3j) * response + reference.noise(ROWS, 0.003, seed)
    time = t[::FINE]
    return sysid.Log(
        "moving", y, time=time, drive=drive(time), frequency=frequency(time), temperature=np.full(ROWS, 24.0)
    )


def off(fit):
    """By how many standard deviations, each parameter that is told."""
    return {n: abs(p.value - getattr(PLANT, n)) / p.std for n, p in fit.parameters.items() if p.determined}


@pytest.mark.parametrize(("sampling", "said"), [(None, "runs on"), ("settled", "the drive runs on")])
def test_a_drive_that_is_switched_on_and_then_runs_on_between_rows_is_named(sampling, said, nuisances):
    """Neither reading of its rows is right: an edge is at the row before, and what runs on is half way."""
    fit = sysid.fit([replace(recorded(edge, 0), sampling=sampling)], nuisances=nuisances)
    assert off(fit)["tau"] > 2  # what would be reported
    assert fit.result is Result.misfit and said in fit.warnings[-1]


@pytest.mark.parametrize("seed", [0, study(1), study(2)])
def test_a_drive_that_runs_on_throughout_is_half_a_row_early_and_known(seed):
    fit = sysid.fit([recorded(smooth, seed)])
    assert fit.result is Result.successful and max(off(fit).values()) < FAR


@pytest.mark.parametrize("seed", [0, 1, *map(study, range(2, 10))])
def test_a_drive_that_is_held_from_row_to_row_is_not_doubted(seed):
    fit = sysid.fit([recorded(held, seed)])
    assert fit.result is Result.successful and max(off(fit).values()) < FAR
    assert not any("runs on" in w for w in fit.warnings)


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, study(1), study(2)])
def test_rows_that_belong_to_their_own_inputs_are_known_where_that_is_stated_and_not_denied_where_it_is_not(
    seed, nuisances
):
    levels = np.repeat(np.random.default_rng(seed).uniform(0, 100, ROWS // 5), 5)
    log = recorded(lambda t: levels[np.minimum((t / STEP + 1e-9).astype(int), ROWS - 1)], seed)
    own = replace(log, drive=np.append(0.0, log.drive[:-1]))  # what was applied until the row
    for sampling in ("settled", None):
        fit = sysid.fit([replace(own, sampling=sampling)], nuisances=nuisances)
        assert fit.result is Result.successful and max(off(fit).values()) < FAR
        assert any("say sampling: settled" in w for w in fit.warnings) == (sampling is None)


@pytest.mark.parametrize(
    ("sampling", "nuisances"), [(None, NOT_LATE), ("instant", NOT_LATE), (None, NUISANCES)]
)
def test_rows_whose_inputs_are_not_stated_are_doubted_where_nothing_may_be_late(sampling, nuisances):
    """A step whose rows belong to their own inputs, read as if they showed those of the row before: G is off
    by many errors."""
    log = recorded(lambda t: np.where(t < 40 * STEP, 0.0, 100.0), seed=0)
    noisy = log.response + reference.noise(ROWS, 0.03, 1)
    own = replace(log, response=noisy, drive=np.append(log.drive[0], log.drive[:-1]), sampling=sampling)
    fit = sysid.fit([own], nuisances=nuisances)
    said = [
        w
        for w in fit.warnings
        if "is not stated and matters here; taken as sampling: instant; settled would move" in w
    ]
    assert bool(said) == (sampling is None and nuisances is NOT_LATE), fit.warnings
