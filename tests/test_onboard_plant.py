"""The bench at the carrier that the exported C is tested on, against closed forms: what it finds is only
worth what it is."""

import math

import numpy as np
import onboard
import pytest
from scipy.linalg import expm

G, TAU, F0 = 0.02, 1.669e-3, 32300.0
W0, Q = 2 * math.pi * F0, math.pi * F0 * TAU
TURN = 2.0**32
STEP = 64 * F0 / TURN  # of the frequency, Hz: 16 samples in a period, 4 ticks in each


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    if onboard.compiler() is None:
        pytest.skip("no C compiler")
    return onboard.open_loop(tmp_path_factory.mktemp("open"), G=G, tau=TAU, f0=F0, reference=100.0, share=F0)


def steady(f, damping=1.0):
    """Wd + j Wq per volt: the paper's signs, exact in the frequency."""
    w = 2 * math.pi * f
    return 2j * G * W0 / TAU / (W0**2 - w**2 + 2j * w * damping / TAU)


def moved(volts, f, times, state, phase):
    """(n, 2) of w and w' under V sin(phase + 2 pi f t): the matrix of the equation and of its drive,
    exponentiated."""
    w = 2 * math.pi * f
    A = np.array(
        [[0, 1, 0, 0], [-(W0**2), -2 / TAU, 2 * G * W0 / TAU * volts, 0], [0, 0, 0, w], [0, 0, -w, 0]]
    )
    scale = np.diag([1, W0, 1, 1])
    begin = np.append(state, [math.sin(phase), math.cos(phase)])
    unit = np.linalg.inv(scale) @ A @ scale
    return np.array([scale @ expm(unit * t) @ np.linalg.inv(scale) @ begin for t in times])[:, :2]


def turned(state, f, phase):
    """Wd + j Wq of w and w' at a phase of the drive."""
    return -(state[..., 0] - 1j * state[..., 1] / (2 * math.pi * f)) * np.exp(-1j * phase)


@pytest.mark.parametrize("beside", [-4000.0, -500.0, -95.4, 0.0, 95.4, 500.0, 4000.0])
def test_settled_response_below_at_and_above_the_resonance(bench, beside):
    rows = bench.run(share=F0 + beside, duration=0.06)  # 36 time constants: 1e-15 is left of the transient
    found = rows.Wd[-1] + 1j * rows.Wq[-1]
    assert found == pytest.approx(100 * steady(rows.made[-1]), rel=1e-9)
    assert rows.made[-1] == pytest.approx(F0 + beside, abs=STEP)
    assert (rows.Wq[-1] > 0) == (beside < 0) or beside == 0  # the frequency must rise where Wq > 0


def test_damping_of_a_finger_and_warmth(bench):
    rows = bench.run(finger=1.0, duration=0.04)
    assert rows.Wd[-1] + 1j * rows.Wq[-1] == pytest.approx(100 * steady(F0, 2.0), rel=1e-9)
    warm = bench.run(k_T=-10.0, temperature=26.0, share=F0 - 20.0, duration=0.06)
    assert warm.Wd[-1] + 1j * warm.Wq[-1] == pytest.approx(100 * G, abs=STEP * 2 * math.pi * TAU * 100 * G)


@pytest.mark.parametrize("beside", [-300.0, 0.0, 95.0])
def test_a_step_from_rest(bench, beside):
    """Against the exponential of the matrix; and at resonance against e^{-t/tau}, from which it differs by
    1/(4 Q) of its end at most, twice in a period."""
    rows = bench.run(share=F0 + beside, duration=8e-3, latency=0.0)
    f = rows.made[-1]
    # The first command acts after its interrupt, at time zero and phase zero.
    exact = moved(100.0, f, rows.time, [0.0, 0.0], 0.0)
    Z = turned(exact, f, 2 * math.pi * f * rows.time)
    np.testing.assert_allclose(
        rows.Wd + 1j * rows.Wq, Z, rtol=0, atol=2e-7
    )  # of 2: the frequency's 1e-8, over 8 ms
    if beside == 0.0:
        rise = 2.0 * -np.expm1(-rows.time / TAU)
        np.testing.assert_allclose(np.hypot(rows.Wd, rows.Wq), rise, rtol=0, atol=2.0 / (4 * Q) * 1.1)


def test_a_free_decay(bench):
    rows = bench.run([(0.05, "reference", 0.0)], duration=0.06, latency=0.0)
    free = rows[rows.time > 0.05002]
    first = (free.Wd + 1j * free.Wq)[0]
    elapsed = free.time - free.time[0]
    amplitude = np.abs(free.Wd + 1j * free.Wq)
    # w and w'/omega trace an ellipse whose axes differ by (1/tau)/omega = 1/(2 Q)
    np.testing.assert_allclose(amplitude, abs(first) * np.exp(-elapsed / TAU), rtol=1 / (2 * Q) * 2)
    slope = np.polyfit(elapsed, np.log(amplitude), 1)[0]
    assert slope == pytest.approx(-1 / TAU, rel=1e-3)


@pytest.mark.parametrize("count", [8, 16, 64])
def test_a_held_synthesiser_lags_by_half_a_hold(bench, count):
    """Held values of n in a period make a sine of sinc(1/n), late by half of one; the images at n f -+ f
    are far away."""
    rows = bench.run(rate=count * F0, ticks=1, hold=1, duration=0.06)
    wanted = 2.0 * np.sinc(1 / count) * np.exp(-1j * math.pi / count)
    assert rows.Wd[-1] + 1j * rows.Wq[-1] == pytest.approx(wanted, rel=1e-3 / count)


def test_rails_clip_the_carrier(bench):
    """The fundamental of a sine clipped at x of its peak is (2/pi) (asin x + x sqrt(1 - x^2))."""
    rows = bench.run(rail=60.0, ticks=8, duration=0.06)
    wanted = 2.0 * 2 / math.pi * (math.asin(0.6) + 0.6 * 0.8)
    assert np.hypot(rows.Wd[-1], rows.Wq[-1]) == pytest.approx(
        wanted, rel=2e-3
    )  # corners between two of 128 ticks
    assert rows.drive.max() == 60.0


def test_a_slow_amplifier_makes_a_triangle(bench):
    """Of slope S: peak S/(4 f), fundamental 8/pi^2 of that, to the tick within which it turns: 4 of 256 in
    a rise."""
    slope = 2e6
    rows = bench.run(slew=slope, ticks=16, duration=0.04)
    assert np.hypot(rows.Wd[-1], rows.Wq[-1]) == pytest.approx(
        G * 8 / math.pi**2 * slope / (4 * F0), rel=4 / 256
    )


def test_the_sensor_shows_what_was_stated(bench):
    """A sample is Re[gain Z e^{j (rotation - omega delay)} e^{j theta}] + offset, theta the drive's phase +
    pi."""
    stated = {"gain": 0.9, "rotation": 20.0, "delay": 3.3e-6, "offset": 0.05}
    rows = bench.run(duration=0.06, share=F0 + 50, **stated)[-50:]
    theta = 2 * math.pi * rows.told_q / TURN + math.pi
    angle = math.radians(20.0) - 2 * math.pi * rows.made * 3.3e-6
    Z = 100 * steady(rows.made[-1])
    wanted = 0.9 * (Z * np.exp(1j * (angle + theta))).real + 0.05
    np.testing.assert_allclose(rows.told_d, wanted, rtol=0, atol=1e-6)


def test_the_converter_rounds_and_clips(bench):
    rows = bench.run(duration=0.06, bits=8, full=2.5, clip=1.2)
    assert (rows.told_d == np.round(rows.told_d)).all() and np.abs(rows.told_d).max() == round(
        1.2 / 2.5 * 128
    )
    small = bench.run(duration=0.06, bits=8, full=1.0)
    assert small.told_d.max() == 127 and small.told_d.min() == -128


def test_noise_and_chance_are_what_they_say(bench):
    quiet = bench.run(reference=0.0, noise=0.3, duration=2.0)
    assert np.std(quiet.told_d) == pytest.approx(0.3, rel=4 / math.sqrt(2 * len(quiet)))
    gone = bench.run(reference=0.0, missing=0.25, duration=2.0)
    share = np.mean(np.isnan(gone.told_d))
    assert share == pytest.approx(0.25, abs=4 * math.sqrt(0.25 * 0.75 / len(gone)))


def test_a_second_resonance_is_seen_beside_the_first(bench):
    rows = bench.run(G2=0.01, tau2=1e-3, f2=F0 + 2000, share=F0 + 2000, duration=0.06)
    assert (rows.Wd + 1j * rows.Wq)[-1] == pytest.approx(
        1.0 + 100 * steady(F0 + 2000), abs=STEP * 2 * math.pi * 1e-3
    )


def test_a_setting_that_there_is_not_is_refused(bench):
    with pytest.raises(AssertionError, match="found the setting gian"):
        bench.run(gian=1.0)
