"""Rows that a recorder spoilt are left out, counted and named; what a resonance, a step or a decay shows is
not."""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds, study
from scipy import stats

import sysid
from sysid.rows.glitch import glitches

PLANT = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=-8.0)
HALF_BANDWIDTH = 1 / (2 * np.pi * PLANT.tau)
DRIVE, STD = 100.0, 0.01  # V, and the noise of a response whose peak is 2 um


def noise(rng, rows):
    return STD * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))


def sweep(rng, rows=81, spacing=0.15, plant=PLANT):
    """Settled points, `spacing` half bandwidths apart."""
    f = plant.f0 + spacing * HALF_BANDWIDTH * (np.arange(rows) - rows // 2 + rng.uniform(-0.5, 0.5))
    y = reference.steady(plant, np.full(rows, DRIVE), f, reference.REFERENCE_TEMPERATURE) + noise(rng, rows)
    return sysid.Log("sweep", y, drive=np.full(rows, DRIVE), frequency=f, kind="steady")


def step(rng, rows=200, early=20):
    time, drive = 0.05 * PLANT.tau * np.arange(rows), np.where(np.arange(rows) < early, 0.0, DRIVE)
    f = np.full(rows, PLANT.f0 + 30.0)
    y = reference.ringing(PLANT, time, drive, f, np.full(rows, reference.REFERENCE_TEMPERATURE)) + noise(
        rng, rows
    )
    return sysid.Log("step", y, time=time, drive=drive, frequency=f, kind="transient", sampling="instant")


def amplitudes(rng):
    log = sweep(rng)
    return replace(log, response=np.abs(log.response))


def spoilt(log, rng, rows, times):
    """The log with some neighbouring rows off by as many times its largest response."""
    begin = rng.integers(3, len(log) - 6)
    at = np.arange(begin, begin + rows)
    if log.kind == "transient":
        at = at[(at < 18) | (at > 24)]  # what happens at the step itself is no less than a late trigger
    y, off = log.response.copy(), times * DRIVE * PLANT.G
    y[at] = y[at] + off * (1.0 if log.amplitude_only else np.exp(1j * rng.uniform(-np.pi, np.pi)))
    return replace(log, response=y), at.tolist()


@pytest.mark.parametrize("times", [study(3.0), study(20.0), 1e3, study(1e6)])
@pytest.mark.parametrize("record", [sweep, step, amplitudes])
def test_a_fit_is_as_good_as_that_of_the_other_rows(record, times):
    scores = []
    for seed in range(8):
        rng = np.random.default_rng([seed, int(times)])
        log, at = spoilt(record(rng), rng, 1 + seed % 3, times)
        found = sysid.fit([log])
        assert found.result is sysid.Result.successful, (seed, at, found.warnings)
        if at:
            named = ", ".join(map(str, at))
            said = (
                f"{log.name}: row{'s' if len(at) > 1 else ''} {named} (counted from 0): far off what the"
                f" rows beside"
            )
            assert any(w.startswith(said) and "left out" in w for w in found.warnings), (
                seed,
                at,
                found.warnings,
            )
            assert len(found.logs[0].residual) == len(log) - len(at)
        scores.append(
            [(p.value - getattr(PLANT, n)) / p.std for n, p in found.parameters.items() if p.determined]
        )
    for name, z in zip(
        ("tau", "f0"), np.array(scores).T[1:], strict=True
    ):  # of a step, G's interval is that of what may be late
        assert 0.005 < stats.chi2.cdf(np.sum(z**2), len(z)) < 0.995, name


@seeds(6, 20)
def test_rows_that_are_spoilt_here_and_there_are_all_found(seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        log, at = (
            sweep(rng),
            np.arange(5, 75, 15) + rng.integers(0, 8, 5),
        )  # each seven rows from the next, or more
        y = log.response.copy()
        y[at] += 20 * DRIVE * PLANT.G * np.exp(1j * rng.uniform(-np.pi, np.pi, 5))
        assert np.flatnonzero(glitches(replace(log, response=y))).tolist() == at.tolist(), seed


@pytest.mark.parametrize("spacing", [0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0])
@pytest.mark.parametrize("amplitude_only", [False, True])
def test_a_resonance_of_few_rows_is_none(spacing, amplitude_only):
    high = replace(PLANT, f0=5e6)
    for seed in range(20):
        log = sweep(np.random.default_rng(seed), spacing=spacing, plant=high)
        log = replace(log, response=np.abs(log.response)) if amplitude_only else log
        assert not np.any(glitches(log)), seed


@pytest.mark.parametrize("spacing", [0.02, 0.3, 1.0, 3.0, 30.0])  # time constants from row to row
def test_what_a_drive_that_switches_makes_is_none(spacing):
    rng = np.random.default_rng(5)
    pulses, gates, chance = np.zeros((3, 300))
    pulses[[40, 41, 120, 200, 202]] = DRIVE
    gates[100:180] = DRIVE
    chance[:] = DRIVE * rng.integers(0, 2, 300)
    time, f = spacing * PLANT.tau * np.arange(300), np.full(300, PLANT.f0 + HALF_BANDWIDTH)
    for drive in (pulses, gates, chance):
        y = reference.ringing(
            PLANT, time, drive, f, np.full(300, reference.REFERENCE_TEMPERATURE)
        ) + 0.01 * noise(rng, 300)
        for response in (y, np.abs(y)):
            log = sysid.Log(
                "switched",
                response,
                time=time,
                drive=drive,
                frequency=f,
                kind="transient",
                sampling="instant",
            )
            assert not np.any(glitches(log))


@pytest.mark.parametrize("rows", [0.3, 1.0, 3.0])
def test_what_decays_from_a_blow_is_none(rows):
    """A plate that nothing drives is hit amid the log, and rings for so many rows."""
    rng, n = np.random.default_rng(2), np.arange(200)
    y = np.where(n >= 60, np.exp(-(n - 60.0) / rows + 0.4j * (n - 60)), 0.0)
    for response in (y + 1e-4 * noise(rng, 200), np.abs(y + 1e-4 * noise(rng, 200))):
        found = glitches(sysid.Log("blow", response, time=1e-3 * n, kind="transient", sampling="instant"))
        assert rows < 1 or not np.any(found)  # one that is over within a row is a row of its own


def test_noise_alone_holds_none():
    for seed in range(300):
        rng = np.random.default_rng(seed)
        y = noise(rng, 100)
        assert not np.any(
            glitches(
                sysid.Log("noise", y if seed % 2 else np.abs(y), time=np.arange(100.0), kind="transient")
            )
        )
