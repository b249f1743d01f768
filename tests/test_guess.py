"""Starting values: among the candidates of a log is a point near the truth, over random plants. Plain numpy,
nothing compiles."""

import numpy as np
import pytest

from sysid import Log
from sysid.minimum.guess import candidates, phase_falls
from sysid.trials.trial import Trial

ROWS = 200
PLANTS = 25
NEAR_F = 0.5  # of the bandwidth 1/(pi tau)
NEAR_TAU = {"amplitude step": 0.4, "amplitude ring-down": 0.4}  # squares of two poles that beat; all others:
ELSE = 0.3  # of tau: from there Levenberg-Marquardt goes to the minimum


def random_plant(rng):
    """tau from 50 us to 0.5 s, Q from 20 to 50 000."""
    tau, Q = np.exp(rng.uniform(np.log(5e-5), np.log(0.5))), np.exp(rng.uniform(np.log(20), np.log(5e4)))
    return tau, Q / (np.pi * tau)


def noisy(rng, clean, level=0.01):
    size = np.max(np.abs(clean))
    return clean + level * size * (rng.standard_normal(len(clean)) + 1j * rng.standard_normal(len(clean)))


def sweep(rng, tau, f0, amplitude):
    half_bandwidth = 1 / (2 * np.pi * tau)
    width = half_bandwidth * rng.uniform(3, 12)
    f = f0 + rng.uniform(-0.4, 0.4) * width + np.linspace(-width, width, ROWS)
    u = (f - f.mean()) / width
    clean = 1 / (1 + 1j * (f - f0) / half_bandwidth)
    if not amplitude:  # a background as large as a third of the resonance
        clean = np.exp(2j * np.pi * rng.random()) * clean + 0.3 * np.exp(2j * np.pi * rng.random()) * (
            1 + 0.2 * u
        )
    y = noisy(rng, clean)
    return Log("sweep", np.abs(y) if amplitude else y, drive=np.ones(ROWS), frequency=f)


def transient(rng, tau, f0, amplitude, levels):
    """The slow mode at held drive; the offset and the rotation of a bench."""
    detuning = rng.uniform(-2, 2) / tau
    time = np.linspace(0, len(levels) * rng.uniform(3, 8) * tau, ROWS)
    edges = np.linspace(0, ROWS, len(levels) + 1).astype(int)
    edges[1] = 20
    drive = np.repeat(levels, np.diff(edges)).astype(float)
    pole = -1 / tau + 1j * detuning
    grown = np.exp(pole * (time[1] - time[0]))
    W = np.zeros(ROWS, complex)
    for k in range(ROWS - 1):
        W[k + 1] = grown * W[k] + drive[k] * (grown - 1) / (pole * tau)
    y = noisy(rng, W * np.exp(2j * np.pi * rng.random()))
    if not amplitude:
        y = y + 0.05 * np.exp(2j * np.pi * rng.random())
    frequency = np.full(ROWS, f0 - detuning / (2 * np.pi))
    return Log(
        "transient",
        np.abs(y) if amplitude else y,
        time=time,
        drive=drive,
        frequency=frequency,
        sampling="instant",
    )


CASES = {
    "sweep": lambda *plant: sweep(*plant, amplitude=False),
    "amplitude sweep": lambda *plant: sweep(*plant, amplitude=True),
    "step": lambda *plant: transient(*plant, False, (0, 1)),
    "ring-down": lambda *plant: transient(*plant, False, (0, 1, 0)),
    "double step": lambda *plant: transient(*plant, False, (0, 0.4, 1)),
    "amplitude step": lambda *plant: transient(*plant, True, (0, 1)),
    "amplitude ring-down": lambda *plant: transient(*plant, True, (0, 1, 0)),
}


@pytest.mark.parametrize("kind", CASES)
def test_a_candidate_is_near_the_truth(kind):
    for seed in range(PLANTS):
        rng = np.random.default_rng(seed)
        tau, f0 = random_plant(rng)
        log = CASES[kind](rng, tau, f0)
        found = candidates(Trial.of(log, log.kind))
        bandwidths = np.abs(found[:, 1] - f0) * np.pi * tau
        if "amplitude" in kind and "sweep" not in kind:  # either side of the drive fits alike
            mirror = 2 * log.frequency[0] - f0
            bandwidths = np.minimum(bandwidths, np.abs(found[:, 1] - mirror) * np.pi * tau)
        near = (np.abs(found[:, 0] / tau - 1) < NEAR_TAU.get(kind, ELSE)) & (bandwidths < NEAR_F)
        assert near.any(), f"seed {seed}: tau {tau:.3g} s, f0 {f0:.6g} Hz"


def test_a_staircase_of_few_frequencies_breaks_nothing():
    for seed in range(PLANTS):
        rng = np.random.default_rng(seed)
        tau, f0 = random_plant(rng)
        log = transient(rng, tau, f0, False, (0, 1))
        stairs = np.repeat(f0 + rng.normal(0, 1 / tau, 5) / (2 * np.pi), ROWS // 5)
        log = Log("stairs", log.response, time=log.time, drive=log.drive, frequency=stairs)
        found = candidates(Trial.of(log, log.kind))
        assert len(found) and np.all(np.isfinite(found)) and np.all(found[:, 0] > 0)


@pytest.mark.parametrize("response", [np.zeros(ROWS, complex), np.ones(ROWS), np.full(ROWS, 1e-300 + 0j)])
def test_logs_without_content_break_nothing(response):
    frequency, time = np.linspace(990, 1010, ROWS), np.linspace(0, 1, ROWS)
    for log in (
        Log("sweep", response, drive=np.ones(ROWS), frequency=frequency),
        Log("transient", response, time=time, drive=np.ones(ROWS), frequency=np.full(ROWS, 1e3)),
    ):
        found = candidates(Trial.of(log, log.kind))
        assert np.all(found[:, 0] > 0)


def test_the_turning_sense_of_a_sweep():
    rng = np.random.default_rng(0)
    log = sweep(rng, 1e-3, 32300.0, amplitude=False)
    mirrored = Log("mirrored", log.response.conj(), drive=log.drive, frequency=log.frequency)
    assert phase_falls(Trial.of(log, "steady"))
    assert not phase_falls(Trial.of(mirrored, "steady"))
