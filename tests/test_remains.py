"""What errors span of what a plate leaves of its logs: sweeps of closed form in which something moves meanwhile."""

import numpy as np
import pytest
from conftest import most, seeds

import sysid
from sysid.fitting import fit
from sysid.verdict.remains import remains

G, TAU, F0, NOISE = 0.02, 1.7e-3, 32300.0, 0.005
GRID = np.linspace(-400.0, 400.0, 101)


PASSES = 4


def to_and_fro(seed, gain=0.0, resonance=0.0):
    """A settled sweep up and down and up again; each pass finds another gain, and another resonance (Hz), by
    so much (rms)."""
    rng = np.random.default_rng(seed)
    f = F0 + np.concatenate([GRID, GRID[::-1]] * (PASSES // 2))
    each = np.repeat(rng.standard_normal((2, PASSES)), len(GRID), axis=1)
    w = 100 * G * (1 + gain * each[0]) / (1 + 2j * np.pi * TAU * (f - F0 - resonance * each[1]))
    w = w + NOISE * 100 * G * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    return sysid.Log.from_arrays(w, frequency=f, time=np.arange(len(f)) * 0.5, drive=100.0)


@seeds(4, 60)
@pytest.mark.parametrize("of", ["gain", "resonance"])
def test_what_is_told_beside_a_misfit_is_within_its_errors(of, seeds):
    """Four passes tell their scatter as Student's t of three degrees of freedom does, 95 % of which is within
    3.2."""
    inside = []
    for seed in seeds:
        found = fit(
            [to_and_fro(seed, **{"gain": {"gain": 0.05}, "resonance": {"resonance": 20.0}}[of])],
            effects="none",
        )
        assert not found.usable
        for name, true in (("G", G), ("tau", TAU), ("f0", F0)):
            told = found.parameters[name]
            inside.append(not told.determined or abs(told.value - true) < 3.2 * told.std)
    assert np.mean(inside) > 0.95 - 3 * np.sqrt(0.05 * 0.95 / len(seeds))  # of one log the three go together


@seeds(4, 60)
def test_noise_of_each_rows_own_adds_about_its_covariance(seeds):
    """The largest over windows of all lengths: no less than half of it, as the plate has taken its part of the
    residual, and not several times as much."""
    ratios = []
    for seed in seeds:
        found = fit([to_and_fro(seed)], effects="none")
        state = found.modes[0]
        added = remains(state, found.reference, found.names)
        ratios.append([added[k, k] / state.covariance[k, k] for k in range(3)])
    assert 0.5 < np.mean(ratios) < 3.0


def sweep(seed, warm=0.0, gain=1.0):
    """A settled sweep at so many degrees above 24 degC."""
    rng, f = np.random.default_rng(seed), F0 + GRID
    w = 100 * G * gain / (1 + 2j * np.pi * TAU * (f - F0 + 10 * warm))
    w = w + NOISE * 100 * G * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    return sysid.Log.from_arrays(w, name=f"{24 + warm:g}", frequency=f, drive=100.0, temperature=24.0 + warm)


@seeds(1, 12)
def test_a_log_that_does_not_answer_its_drive_is_told_as_that(seeds):
    """A resonance of its own was found in its noise, 600 Hz away, and none of G, tau and f0 was told."""
    for seed in seeds:
        rng, time = np.random.default_rng(seed), 1e-4 * np.arange(220)
        noise = NOISE * 100 * G * (rng.standard_normal(220) + 1j * rng.standard_normal(220))
        drive = np.where(time > 2e-3, 100.0, 0.0)
        dead = sysid.Log.from_arrays(
            noise, name="dead", time=time, drive=drive, frequency=np.full(220, F0), temperature=24.0
        )
        found = fit([sweep(seed), dead])
        (odd,) = found.findings
        assert (odd.key, odd.outcome, odd.logs) == (
            "odd",
            "refused",
            ("dead",),
        ) and "do not answer its drive" in odd.sentence
        for name, true in (("G", G), ("tau", TAU), ("f0", F0)):
            told = found.parameters[name]
            assert told.determined and abs(told.value - true) < 4 * told.std


@seeds(1, 8)
def test_what_all_logs_have_in_common_is_told_once(seeds):
    """A sensor whose gain falls with the temperature: each of five logs was "no known effect explains it" above the
    sentence that does."""
    for seed in seeds:
        found = fit(
            [
                sweep(10 * seed + k, warm, 1 - 0.006 * warm)
                for k, warm in enumerate((-10.0, -5.0, 0.0, 5.0, 10.0))
            ]
        )
        refused = [f for f in found.findings if f.outcome == "refused"]
        assert [f.key for f in refused] == ["temperature"] and not found.usable


@seeds(1, 12)
def test_a_plate_that_warms_up_along_a_sweep_is_fitted(seeds):
    """By a straight line tau was 15 of its errors off, beside an offset's drift that was not there."""
    pulls, f = [], F0 + np.concatenate([GRID, GRID[::-1]])
    time = 0.5 * np.arange(len(f))
    for seed in seeds:
        rng = np.random.default_rng(seed)
        w = 100 * G / (1 + 2j * np.pi * TAU * (f - F0 - 250 * np.exp(-time / 12)))
        w = w + NOISE * 100 * G * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
        found = fit([sysid.Log.from_arrays(w, frequency=f, time=time, drive=100.0)])
        (drift,) = (x for x in found.findings if x.outcome == "fitted")
        within = drift.numbers["time_s"]
        assert drift.key == "f0_drift" and abs(within.value - 12) < 4 * within.std < 4
        pulls += [
            (found.parameters[n].value - true) / found.parameters[n].std
            for n, true in (("G", G), ("tau", TAU))
        ]
    assert np.sqrt(np.mean(np.square(pulls))) < most(pulls)
