"""What amplitudes tell whose noise is coloured in Wd and Wq, against estimates from drawn noise and dense
covariances."""

import numpy as np
from reference import Plant, steady

from sysid import Log
from sysid.trials.perturbed import LogResponse
from sysid.trials.projected import efficiency
from sysid.trials.trial import Trial, with_noise

PLANT = Plant(G=1.0, tau=1.67e-3, f0=32300.0, k_T=0.0)
MEMORY = 9.5  # rows
N = 101


def test_errors_are_those_of_estimates_from_noise_of_both_channels():
    frequency = PLANT.f0 + np.linspace(-500, 500, N)
    response = steady(PLANT, np.ones(N), frequency, 24.0)
    log = Log("sweep", np.abs(response), drive=np.ones(N), frequency=frequency, kind="steady")
    trial = with_noise(Trial.of(log, "steady"), 0.01, MEMORY).with_bench(floor=1e-4)
    course = LogResponse(
        trial, trial.hold((PLANT.f0, 24.0)), np.array([0.0, np.log(PLANT.tau), 0.0, 0.0, 0.0, 0.0])
    )
    design = course.design()
    design = design[:, np.any(design != 0, axis=0)]
    assert design.shape[1] == 3  # gain, width, place

    rng, memory = np.random.default_rng(5), np.exp(-1 / MEMORY)
    noise = rng.standard_normal((8000, N)) + 1j * rng.standard_normal((8000, N))
    for k in range(1, N):
        noise[:, k] = memory * noise[:, k - 1] + np.sqrt(1 - memory**2) * noise[:, k]
    seen = 0.01 * (noise * np.exp(-1j * np.angle(response))).real

    rows = np.arange(N)
    weights = np.linalg.inv(1e-4 * np.exp(-np.abs(rows[:, None] - rows) / MEMORY))
    stated = np.linalg.inv(design.T @ weights @ design)
    estimates = seen @ weights @ design @ stated
    ratio = np.diag(stated) / np.var(estimates, axis=0)
    # A variance from 8000 draws is known to 1.6 %; three of these.
    assert abs(efficiency(trial, course) / np.min(ratio) - 1) < 0.05
    assert np.min(ratio) < 0.8  # there is something to see


def test_a_phase_that_stays_costs_nothing():
    """Far from resonance the phase does not turn, and the noise is what it is taken for."""
    frequency = PLANT.f0 + 1e4 + np.linspace(-50, 50, N)
    response = steady(PLANT, np.ones(N), frequency, 24.0)
    log = Log("sweep", np.abs(response), drive=np.ones(N), frequency=frequency, kind="steady")
    trial = with_noise(Trial.of(log, "steady"), 1e-5, MEMORY).with_bench(floor=1e-10)
    course = LogResponse(
        trial, trial.hold((PLANT.f0, 24.0)), np.array([0.0, np.log(PLANT.tau), 0.0, 0.0, 0.0, 0.0])
    )
    assert efficiency(trial, course) > 0.999
