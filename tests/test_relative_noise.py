"""Noise that goes with the response, as of impedance analysers and of records in dB: found, named, and the
errors true."""

import numpy as np
import pytest
import reference
from conftest import seeds, study
from scipy.stats import binom

import sysid

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
ROWS = 101
FREQUENCY = PLANT.f0 + np.linspace(
    -1300, 1300, ROWS
)  # 13 half bandwidths: the response falls to a thirteenth


def sweep(seed, relative, floor, amplitude=False, decibel=False):
    """Settled points: of d and q, or the amplitude alone; noise of `relative` of the response and of `floor`
    of its largest."""
    rng = np.random.default_rng([seed, 9])
    clean = reference.steady(PLANT, np.full(ROWS, 100.0), FREQUENCY, np.full(ROWS, 24.0))
    (a, b), largest = rng.standard_normal((2, 2, ROWS)), np.max(np.abs(clean))
    rows = clean + floor * largest * (a[0] + 1j * a[1]) + relative * np.abs(clean) * (b[0] + 1j * b[1])
    given = {
        "drive": np.full(ROWS, 100.0),
        "frequency": FREQUENCY,
        "kind": "steady",
        "relative_noise": decibel,
    }
    return sysid.Log("sweep", np.abs(rows) if amplitude else np.exp(0.7j) * rows, **given)


def deviations(logs):
    """(value - truth)/std of G, tau and f0 of each, all of which must be successful."""
    found = []
    for log in logs:
        fit = sysid.fit([log])
        assert fit.result.name == "successful", fit.warnings
        found.append(
            [
                (fit.parameters[n].value - getattr(PLANT, n)) / fit.parameters[n].std
                for n in ("G", "tau", "f0")
            ]
        )
    return np.array(found)


def held(z):
    """Whether enough intervals hold the truth: of 120 of them 114 +- 2.4 should (three of a log are not
    independent: 4), less 3.5 of these."""
    return np.sum(np.abs(z) < 1.96) >= 0.95 * z.size - 3.5 * 4 * np.sqrt(z.size / 120)


@pytest.mark.parametrize("amplitude", [False, True])
@pytest.mark.parametrize(
    ("relative", "floor", "decibel"),
    [
        (0.01, 0.0, False),
        study(0.01, 0.002, False),
        study(0.01, 0.0, True),
        study(0.0, 0.007, True),
        (0.01, 0.002, True),
    ],
)
@seeds(10, 40)
def test_errors_are_true(seeds, relative, floor, decibel, amplitude):
    z = deviations(sweep(seed, relative, floor, amplitude, decibel) for seed in seeds)
    assert held(z) and np.max(np.abs(z)) < 4.5
    # of 40 numbers the spread is known to 11 %: 2.5 of these, not too wide either
    assert abs(np.sqrt(np.mean(z**2)) - 1.025) < 2.46 / np.sqrt(2 * len(z))


def test_it_is_named_with_its_size():
    said = [sysid.fit([sweep(seed, 0.01, 0.0)]).logs[0].noise for seed in range(3)]
    assert all(s.startswith("white, ") and "% of the response" in s for s in said)
    sizes = [float(s.removeprefix("white, ").partition(" %")[0]) for s in said]
    assert np.allclose(sizes, 1.0, atol=0.2)  # of 202 numbers a level is known to 5 %: four of these


@seeds(25, 100)
def test_of_even_noise_no_part_is_taken_for_relative(seeds):
    found = [sysid.fit([sweep(seed, 0.0, 0.01)]).modes[0].trials[0].noise.share for seed in seeds]
    # a gain of four in log-likelihood: chi-square of one number exceeds eight in 0.5 % of cases
    assert np.count_nonzero(found) <= binom.ppf(0.996, len(seeds), 0.005)


def test_a_wrong_model_at_the_peak_is_no_noise(nuisances):
    """A response that is compressed at its largest: what is left is largest at the peak too, but neighbours
    share it."""
    log = sweep(0, 0.0, 0.001)
    size = np.abs(log.response)
    bent = log.response * (1 - 0.1 * (size / size.max()) ** 2)
    log = sysid.Log("bent", bent, drive=log.drive, frequency=log.frequency, kind="steady")
    fit = sysid.fit([log], nuisances=nuisances)
    assert fit.result.name == "misfit" and fit.modes[0].trials[0].noise.share == 0.0


def swept(seed, relative, floor, ups=1):
    """A sweep with its times, two tau for a row; or a step on resonance after twenty rows at rest."""
    rng, n = np.random.default_rng([seed, 10]), 200
    if ups:
        time, volts, frequency = (
            2 * PLANT.tau * np.arange(n),
            np.full(n, 100.0),
            np.linspace(PLANT.f0 - 700, PLANT.f0 + 700, n),
        )
    else:
        time, volts, frequency = (
            1e-4 * np.arange(n),
            np.where(np.arange(n) < 20, 0.0, 100.0),
            np.full(n, PLANT.f0),
        )
    clean = reference.ringing(PLANT, time, volts, frequency, np.full(n, 24.0))
    (a, b), largest = rng.standard_normal((2, 2, n)), np.max(np.abs(clean))
    rows = clean + floor * largest * (a[0] + 1j * a[1]) + relative * np.abs(clean) * (b[0] + 1j * b[1])
    given = {
        "drive": volts,
        "frequency": frequency,
        "kind": "transient",
        "sampling": "instant",
        "bench": {"delay_s": 0.0},
    }
    return sysid.Log("transient", np.exp(0.7j) * rows, time=time, **given)


@pytest.mark.parametrize("ups", [1, 0])
@seeds(8, 40)
def test_errors_are_true_of_transients(seeds, ups):
    z = deviations(swept(seed, 0.01, 0.0005, ups) for seed in seeds)
    assert held(z) and np.max(np.abs(z)) < 4.5
    assert np.sqrt(np.mean(z[:, 1:] ** 2)) < 1 + 2.68 / np.sqrt(2 * len(z))  # as above
    assert "% of the response" in sysid.fit([swept(0, 0.01, 0.0005, ups)]).logs[0].noise


@pytest.mark.parametrize("ups", [1, 0])
@seeds(15, 60)
def test_of_even_noise_of_transients_no_part_is_taken_for_relative(seeds, ups):
    found = [sysid.fit([swept(seed, 0.0, 0.01, ups)]).modes[0].trials[0].noise.share for seed in seeds]
    assert np.count_nonzero(found) <= binom.ppf(0.996, len(seeds), 0.005)  # as above
