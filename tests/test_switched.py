"""Raw samples of a drive that is switched between levels, against the equation of motion solved from edge to
edge."""

import numpy as np
import pytest

import sysid
from sysid import Result
from sysid.demodulation.waveform import demodulate
from sysid.tables.csvfile import LogError

G, TAU, F0 = 0.01, 1.67e-3, 32300.0
FAR = 4.0  # standard deviations: by chance in one of 16 000


def edges_of(pattern, frequency, begin, end, turn=0.13):
    """(times, levels) of a pattern [(share of the period, level), ...], from `turn` of a period on; zero
    after `end`."""
    shares, levels = zip(*pattern, strict=True)
    starts = np.append(0.0, np.cumsum(shares)[:-1])
    periods = np.arange(int((end - begin) * frequency) + 2)
    times = begin + (periods[:, None] + starts - turn).ravel() / frequency
    values = np.tile(levels, len(periods))
    first = np.searchsorted(times, begin, side="right") - 1
    inside = (np.arange(len(times)) >= first) & (times < end)
    return np.append(np.maximum(times[inside], begin), end), np.append(values[inside], 0.0)


def motion(times, levels, at):
    """w (um) at the times `at` (s) of w'' + 2/tau w' + w0^2 w = (2 G w0/tau) v, from rest; v has `levels`
    from `times` on."""
    w0 = 2 * np.pi * F0
    pole = -1 / TAU + 1j * np.sqrt(w0**2 - TAU**-2)
    still = 2 * G / (TAU * w0) * np.append(0.0, levels)  # where w would come to rest
    begin, state = np.append(0.0, times), np.zeros(2)
    found = np.zeros(len(at))
    where = np.searchsorted(begin, at, side="right") - 1
    held = np.append(begin[1:], np.inf)
    first = np.searchsorted(where, np.arange(len(begin) + 1))
    for k in range(len(begin)):
        off = state[0] - still[k]
        z = off - 1j * (state[1] + off / TAU) / pole.imag  # w - still = Re z e^{pole t}
        rows = slice(*first[k : k + 2])
        found[rows] = still[k] + (z * np.exp(pole * (at[rows] - begin[k]))).real
        if np.isfinite(held[k]):
            moved = z * np.exp(pole * (held[k] - begin[k]))
            state = np.array([still[k] + moved.real, (pole * moved).real])
    return found


def recorded(pattern, drives, rate, duration, seed=0):
    """Samples of [(begin, end, Hz), ...]: time, drive, response with noise."""
    pieces = [edges_of(pattern, f, begin, end) for begin, end, f in drives]
    times, levels = (np.concatenate(p) for p in zip(*pieces, strict=True))
    time = np.arange(round(duration * rate)) / rate
    held = np.append(0.0, levels)[np.searchsorted(times, time, side="right")]
    return (
        time,
        held,
        motion(times, levels, time) + 0.002 * np.random.default_rng(seed).standard_normal(len(time)),
    )


def as_log(rows):
    fields = {"time": rows.time, "drive": rows.drive, "frequency": rows.frequency, "theta": rows.theta}
    bench = {"delay_s": rows.delay, "lockin_boxcar_s": rows.width}
    return sysid.Log("switched", rows.response, kind="transient", sampling="instant", bench=bench, **fields)


SQUARE = [(0.5, 5.0), (0.5, -5.0)]
PATTERNS = {  # and the amplitude of the fundamental: of two levels a apart, of share D, (2 a/pi) sin(pi D)
    "square": (SQUARE, 20 / np.pi),
    "half bridge": ([(0.5, 10.0), (0.5, 0.0)], 20 / np.pi),
    "full bridge, a third at zero": (
        [(1 / 3, 5.0), (1 / 6, 0.0), (1 / 3, -5.0), (1 / 6, 0.0)],
        20 / np.pi * np.sin(np.pi / 3),
    ),
    "duty of 0.4": ([(0.4, 5.0), (0.6, -5.0)], 20 / np.pi * np.sin(0.4 * np.pi)),
}
RATES = (6.5e5, 1e6, 3.229e6, 1e7)  # 20 to 310 samples a period, at 3.229e6 100 exactly


@pytest.mark.parametrize(("rate", "frequency"), [*((rate, 32290.0) for rate in RATES), (1e6, 32250.0)])
def test_a_square_wave_is_as_good_as_a_sine(rate, frequency):
    """1e6/32250 is 31.008 samples a period: its edges stay at the same samples for 60 of them."""
    rows = demodulate(*recorded(SQUARE, [(0.002, 1.0, frequency)], rate, 0.02))
    lit = rows.drive != 0
    assert np.allclose(
        rows.drive[lit], 20 / np.pi, rtol=3e-4
    )  # at worst a sample of 100 is 2e-4 of the sum over the period
    assert np.ptp(rows.frequency[lit]) == 0 and abs(rows.frequency[-1] - frequency) < 0.02
    fit = sysid.fit([as_log(rows)])
    assert fit.result is Result.successful
    for name, truth in (("G", G), ("tau", TAU), ("f0", F0)):
        found = fit.parameters[name]
        assert abs(found.value - truth) < FAR * found.std, name


@pytest.mark.parametrize("name", PATTERNS)
def test_the_fundamental_of_an_inverter(name):
    pattern, amplitude = PATTERNS[name]
    rows = demodulate(*recorded(pattern, [(0.002, 0.012, 32290.0)], 5e6, 0.02))
    fit = sysid.fit([as_log(rows)])
    middle = (rows.time > 0.003) & (rows.time < 0.011)
    assert np.allclose(rows.drive[middle], amplitude, rtol=2e-3)  # 2 samples of 155 in a period
    assert fit.result is Result.successful
    assert abs(fit.parameters["tau"].value - TAU) < FAR * fit.parameters["tau"].std
    # Half a period in which a half bridge is still low, or off, is 1 % of tau.
    assert abs(fit.parameters["G"].value / G - 1) < FAR * fit.parameters["G"].std / G + 0.01


def test_a_square_wave_that_changes_its_frequency():
    drives = [(0.002, 0.012, 32250.0), (0.012, 0.022, 32340.0)]
    rows = demodulate(*recorded(SQUARE, drives, 2e6, 0.03))
    for begin, end, f in drives:
        inside = (rows.time > begin + 2e-3) & (rows.time < end - 2e-3)
        assert np.max(np.abs(rows.frequency[inside] - f)) < 0.1
    fit = sysid.fit([as_log(rows)])
    assert abs(fit.parameters["f0"].value - F0) < max(FAR * fit.parameters["f0"].std, 0.1)


def test_a_square_wave_of_few_samples_a_period_is_refused():
    with pytest.raises(LogError, match="switched between levels"):
        demodulate(*recorded(SQUARE, [(0.002, 1.0, 32290.0)], 3e5, 0.02))
