"""Logs in steps of a recorder: what their rounding does is in the intervals, is no misfit, and is said."""

import numpy as np
import pytest
from conftest import most, seeds, study

import sysid
from sysid.rows import rounding

TAU, F0, G, VOLTS = 2e-3, 40e3, 0.05, 2.0
HALF_BANDWIDTH = 1 / (2 * np.pi * TAU)
SIZE = G * VOLTS


def rounded(response, step, noise, rng):
    """Nearest whole steps, of noise of so many steps."""
    n = len(response)
    shown = response / step + noise * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    return step * (np.round(shown.real) + 1j * np.round(shown.imag))


def step_log(bits, noise, seed, rows=160, spacing=0.07, response=None):
    """A step off resonance by the closed form of its envelope: W = G V (1 - e^(lambda t))/(1 - j x), x the
    detuning in half bandwidths, over a range of 2.4 times its size. Q is 250: the fast mode is a fifth of a
    step of eight bits."""
    rng = np.random.default_rng(seed)
    x, turn = rng.normal(), np.exp(1j * rng.uniform(-np.pi, np.pi))
    time = spacing * TAU * np.arange(rows)
    drive = np.where(np.arange(rows) >= rows // 8, VOLTS, 0.0)
    since = np.maximum(time - time[rows // 8], 0.0) / TAU
    clean = SIZE * turn * (1 - np.exp((-1 + 1j * x) * since)) / (1 - 1j * x)
    shown = rounded(clean, 2.4 * SIZE / 2**bits, noise, rng)
    frequency = np.full(rows, F0 - x * HALF_BANDWIDTH)
    shown = shown if response is None else response(shown)
    return sysid.Log(
        "step", shown, time=time, drive=drive, frequency=frequency, kind="transient", sampling="instant"
    )


def sweep_log(bits, noise, seed, rows=100):
    """Settled points by the Lorentzian, W = G V/(1 - j x)."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-6, 6, rows) + rng.uniform(-0.06, 0.06)
    turn = np.exp(1j * rng.uniform(-np.pi, np.pi))
    shown = rounded(SIZE * turn / (1 - 1j * x), 2.4 * SIZE / 2**bits, noise, rng)
    frequency = F0 - x * HALF_BANDWIDTH
    return sysid.Log("sweep", shown, drive=np.full(rows, VOLTS), frequency=frequency, kind="steady")


def errors(logs):
    """Of G, tau and f0 in their standard deviations; every log tells them."""
    found = []
    for log in logs:
        fit = sysid.fit([log])
        assert fit.result is sysid.Result.successful, fit.warnings
        known = fit.parameters
        assert all(known[n].determined for n in ("G", "tau", "f0")), known
        found.append(
            [(known[n].value - true) / known[n].std for n, true in (("G", G), ("tau", TAU), ("f0", F0))]
        )
    return np.array(found)


@pytest.mark.parametrize(("bits", "noise"), [(8, 0.0), study(8, 0.05), study(8, 0.2), (6, 0.1)])
@seeds(2, 16)
def test_steps_of_few_bits_are_fitted_with_true_intervals(seeds, bits, noise):
    """Without its rounding in the noise most are taken for a drift or a second resonance, or are off by ten
    errors."""
    rows, spacing = (160, 0.07) if bits == 8 else (400, 0.03)
    z = errors(step_log(bits, noise, seed, rows, spacing) for seed in seeds)
    assert np.max(np.abs(z)) < 4
    assert np.all(
        np.sqrt(np.mean(z**2, axis=0)) < most(seeds, 2.8)
    )  # 1.5 of 16: by chance in one of a thousand
    least = 0.3 if len(seeds) > 4 else 0.15  # few may all be near by chance
    assert np.all(
        np.sqrt(np.mean(z[:, 1:] ** 2, axis=0)) > least
    )  # the intervals are no guess: G's hangs on lateness


@pytest.mark.parametrize("bits", [study(5), 8])
def test_sweeps_of_few_bits_are_fitted_with_true_intervals(bits):
    z = errors(sweep_log(bits, 0.05, seed) for seed in range(16))
    assert np.max(np.abs(z)) < 4
    assert np.all((np.sqrt(np.mean(z**2, axis=0)) < 1.5) & (np.sqrt(np.mean(z**2, axis=0)) > 0.3))


def test_the_steps_of_each_channel_are_recognised():
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.standard_normal((2, 400)), axis=1)
    d, q = 0.05 * np.round(values[0] / 0.05), 0.4 * np.round(values[1] / 0.4)
    assert rounding.steps(d + 1j * q) == pytest.approx((0.05, 0.4))
    assert rounding.steps(d) == pytest.approx((0.05,))
    printed = np.array([float(f"{v:.3f}") for v in (5 / 256) * np.round(values[0] / (5 / 256))])
    assert rounding.steps(printed)[0] == pytest.approx(5 / 256, rel=0.01)
    still = np.full(400, 0.2)  # a channel that does not move has the steps of the other
    assert rounding.steps(d + 1j * still) == pytest.approx((0.05, 0.05))


def test_what_is_not_rounded_has_no_steps():
    rng = np.random.default_rng(2)
    exact = rng.standard_normal(400)
    held = np.repeat(exact[:100], 4)
    resting = np.append(np.zeros(100), exact)
    settled = 1 - np.exp(-np.arange(400) / 10)  # to the last digit of a float, which no recorder rounded
    for values in (exact, held, resting, settled, exact + 1j * held):
        assert not any(rounding.steps(values))


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_the_shared_part_of_a_rounding_error_is_that_of_many_readings(noise):
    """By brute force: the mean of many readings of one value, less the value, for values all over a step."""
    rng = np.random.default_rng(3)
    value, readings = np.linspace(-0.5, 0.5, 401)[:-1, None], noise * rng.standard_normal((400, 4000))
    error = np.round(value + readings) - value
    # Of the variance of a mean of 4000 readings their own noise is a part in 4000.
    shared = np.var(np.mean(error, axis=1)) - np.mean(np.var(error, axis=1)) / 4000
    assert rounding.shared(noise**2 + 1 / 12) * np.mean(error**2) == pytest.approx(shared, rel=0.05, abs=5e-5)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.25])
def test_no_sum_of_rows_has_a_smaller_variance_than_their_weights_say(noise):
    """Rows of a rise and its plateau, wherever the steps lie: their mean, their slope, the mean of the
    plateau."""
    rng, rows = np.random.default_rng(4), np.arange(200)
    clean = 20 * (1 - np.exp(-rows / 25))
    places = (np.arange(2000)[:, None] + rng.uniform(size=(2000, 1))) / 2000
    shown = np.round(clean + places + noise * rng.standard_normal((2000, 200))) - places - clean
    std = np.sqrt(noise**2 + 1 / 12)
    spread, own = rounding.spread(clean, 1.0, std, np.ones(200))
    assert np.all((own > 0) & (own <= 1)) and own[-1] < 0.5
    for sums in (np.ones(200), rows - 100.0, rows > 150, rows < 30):
        weight = sums / spread**2
        assert np.std(shown @ weight) <= 1.03 * std * np.linalg.norm(
            weight * spread
        )  # 2000 draws tell it to 1.6 %


def test_a_log_in_steps_says_what_they_cost_and_one_in_fine_ones_does_not():
    said = sysid.fit([step_log(8, 0.05, 0)]).warnings
    assert any("recorded in steps of 0.00094 um" in w and "dither" in w for w in said), said
    for quiet in (step_log(14, 3.0, 0), step_log(8, 0.6, 0)):
        assert not any("recorded in steps" in w for w in sysid.fit([quiet]).warnings)


def test_what_steps_hide_is_named_with_what_to_record():
    fit = sysid.fit([step_log(3, 0.0, 1)])
    hidden = [p for name, p in fit.parameters.items() if name in ("G", "tau", "f0") and not p.determined]
    assert hidden and any("dither" in w for w in fit.warnings)


@pytest.mark.study
def test_an_amplitude_in_steps_is_fitted_with_true_intervals():
    """The output of a first-order plant, without a frequency, in 64 steps."""
    found = []
    for seed in range(16):
        rng, rows, step = np.random.default_rng(seed), np.arange(200), 2.4 * SIZE / 128
        drive = np.where(rows >= 20, VOLTS, 0.0)
        clean = (
            SIZE * np.where(rows >= 20, 1 - np.exp(-0.05 * (rows - 20)), 0.0) + rng.uniform(-0.5, 0.5) * step
        )
        shown = step * np.round(clean / step + 0.05 * rng.standard_normal(200))
        log = sysid.Log(
            "plant", shown, time=0.05 * TAU * rows, drive=drive, kind="transient", sampling="instant"
        )
        known = sysid.fit([log]).parameters
        found.append([(known[n].value - true) / known[n].std for n, true in (("G", G), ("tau", TAU))])
    z = np.array(found)
    assert np.max(np.abs(z)) < 4 and np.all(np.sqrt(np.mean(z**2, axis=0)) < 1.5)


def test_slow_noise_beside_the_rounding_is_still_seen():
    """Noise of 0.3 steps that neighbouring rows share: rounding does not make it white."""
    rng = np.random.default_rng(5)
    slow = rng.standard_normal(400) + 1j * rng.standard_normal(400)
    for k in range(1, 400):
        slow[k] = 0.95 * slow[k - 1] + np.sqrt(1 - 0.95**2) * slow[k]
    step = 2.4 * SIZE / 256

    def beside(shown):
        clean = step_log(24, 0.0, 6, rows=400, spacing=0.03).response
        return rounded(clean + 0.4 * step * slow, step, 0.0, rng)

    fit = sysid.fit([step_log(8, 0.0, 6, rows=400, spacing=0.03, response=beside)])
    assert "correlated" in fit.logs[0].noise
