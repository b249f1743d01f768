"""Raw waveforms: what the lock-in makes of them, against the plant's closed-form motion; fits of them; and
what is refused.

The truth is m w'' + ds w' + c w = N v with the real, gated drive v, solved from change to change of the
drive: a forced motion and a free one each, that fit position and velocity. It shares no code with the
package.
"""

import dataclasses
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from conftest import seeds, study
from scipy.integrate import solve_ivp
from scipy.stats import chi2

import sysid
from sysid.demodulation.carrier import strongest
from sysid.demodulation.lockin import blocks, lock_in, low_pass
from sysid.demodulation.waveform import demodulate
from sysid.logs.log import LogError
from sysid.logs.read import read_logs
from sysid.scene import EFFECTS
from sysid.scene.carrier import waveform, write_waveform

SCENES = Path(__file__).parents[1] / "data" / "synthetic" / "scenes" / "plate"
PLATE = {"G": 0.02, "Q": 169.36, "f0": 32300.0}
QUARTZ = {"G": 3e-4, "Q": 2000.0, "f0": 5e6}  # in water
BLADE = {"G": 0.5, "Q": 8.0, "f0": 900.0}


def tau_of(plant):
    return plant["Q"] / (np.pi * plant["f0"])


def steady(plant, drive, frequency):
    """Exact settled Wd + j Wq: N jV / (c - m omega^2 + j omega ds) of w_c = (Wd + j Wq) e^{j theta}, v_c = jV
    e^{j theta}."""
    w0, omega = 2 * np.pi * plant["f0"], 2 * np.pi * frequency
    return 1j * drive * plant["G"] * 2 / tau_of(plant) * w0 / (w0**2 - omega**2 + 2j * omega / tau_of(plant))


def carrier(plant, time, drive, angle=0.0):
    """Samples (v, w) at `time` of a drive [(begin, V, Hz), ...]: v = -V sin(theta), and theta runs on from
    change to change, or begins anew at a fourth entry. `angle` (deg): by which w is shifted in phase."""
    shift = np.exp(1j * np.deg2rad(angle))
    w0, rate = 2 * np.pi * plant["f0"], 1 / tau_of(plant)
    pole = -rate + 1j * np.sqrt(w0**2 - rate**2)
    v, w = np.zeros((2, len(time)))
    place, speed, theta = 0.0, 0.0, 0.0
    for k, (begin, V, f, *anew) in enumerate(drive):
        end = drive[k + 1][0] if k + 1 < len(drive) else time[-1] + 1.0
        theta = anew[0] if anew else theta
        here = (time >= begin) & (time < end)
        forced, omega = steady(plant, V, f), 2 * np.pi * f

        def motion(t, turn=1.0, begin=begin, theta=theta, forced=forced, omega=omega):
            z = turn * forced * np.exp(1j * (omega * (t - begin) + theta))
            return z.real, (1j * omega * z).real

        off = place - motion(begin)[0], speed - motion(begin)[1]
        free = (
            off[0] + 1j * (rate * -off[0] - off[1]) / pole.imag
        )  # Re free = off[0], Re (pole free) = off[1]
        turned = np.exp(pole * (time[here] - begin))
        w[here] = motion(time[here], shift)[0] + (shift * free * turned).real
        v[here] = -V * np.sin(omega * (time[here] - begin) + theta)
        last = free * np.exp(pole * (end - begin))
        place, speed = motion(end)[0] + last.real, motion(end)[1] + (pole * last).real
        theta += omega * (end - begin)
    return v, w


def samples(plant, drive, duration, rate=1e6, noise=0.0, seed=0):
    """Time, drive, response; `noise` of the largest drive, and of the largest settled response, in each
    sample."""
    time = np.arange(round(duration * rate)) / rate
    v, w = carrier(plant, time, drive)
    rng, top = np.random.default_rng(seed), max(abs(step[1]) for step in drive)
    v = v + noise * top * rng.standard_normal(len(time))
    return time, v, w + noise * plant["G"] * top * rng.standard_normal(len(time))


@pytest.fixture
def save(tmp_path):
    """Writes samples as a waveform log and gives its path."""

    def write(time, v, w, *metadata, header="time_s,drive_V,response_um", digits=9):
        path = tmp_path / "wave.csv"
        columns = [c.tolist() for c in (time, v, w)]
        with open(path, "w") as file:
            file.writelines(f"# {line}\n" for line in ("kind: waveform", *metadata))
            file.write(header + "\n")
            file.writelines(
                f"{t:.9g},{a:.{digits}g},{b:.{digits}g}\n" for t, a, b in zip(*columns, strict=True)
            )
        return path

    return write


def as_log(rows, **changes):
    fields = {"time": rows.time, "drive": rows.drive, "frequency": rows.frequency, "theta": rows.theta}
    bench = {"delay_s": rows.delay, "lockin_boxcar_s": rows.width}
    return sysid.Log(
        "wave", rows.response, kind="transient", sampling="instant", bench=bench, **(fields | changes)
    )


def relative(fit, plant):
    """{name: (error, standard deviation)} over the value."""
    truth, std = plant | {"tau": tau_of(plant)}, np.sqrt(np.diag(fit.covariance))
    return {
        n: ((getattr(fit.plant, n) - truth[n]) / truth[n], s / truth[n])
        for n, s in zip(fit.names, std, strict=True)
    }


# --- the truth, and the kernel
# --------------------------------------------------------------------------------------------


def test_the_closed_form_is_the_integral_of_the_equation_of_motion():
    drive = [
        (0.0, 0.0, 32250.0),
        (1.005e-4, 100.0, 32250.0, 0.7),
        (6.002e-4, 60.0, 32400.0),
        (9.001e-4, 0.0, 32400.0),
    ]
    time = np.arange(1300) * 1e-6
    w = carrier(PLATE, time, drive)[1]
    w0, rate = 2 * np.pi * PLATE["f0"], 1 / tau_of(PLATE)
    push = PLATE["G"] * 2 * rate * w0
    state, found, theta = [0.0, 0.0], [], 0.0
    for k, (begin, V, f, *anew) in enumerate(drive):
        end = drive[k + 1][0] if k + 1 < len(drive) else time[-1] + 1e-6
        theta = anew[0] if anew else theta

        def motion(t, y, begin=begin, V=V, f=f, theta=theta):
            return [
                y[1],
                -push * V * np.sin(2 * np.pi * f * (t - begin) + theta) - 2 * rate * y[1] - w0**2 * y[0],
            ]

        here = time[(time >= begin) & (time < end)]
        solved = solve_ivp(
            motion, (begin, end), state, "DOP853", [*here, end], rtol=1e-11, atol=[1e-12, 1e-7]
        )
        found, state, theta = (
            [*found, *solved.y[0, :-1]],
            solved.y[:, -1],
            theta + 2 * np.pi * f * (end - begin),
        )
    np.testing.assert_allclose(
        w, found, atol=1e-8
    )  # of 0.5: the integrator's tolerance over forty cycles, times 1e3


@pytest.mark.parametrize("order", [0, 1, 2])
def test_blocks_hold_the_mean_whatever_lies_beneath(order):
    # offset, slope, curvature and blocks of 2.03 periods: all of it is in the model, which leaves rounding
    t, theta, omega = np.arange(630), 0.4 + 0.2026 * np.arange(630), 0.2026
    W = (2 - 1j) + (3e-3 + 1e-3j) * t + (2e-6 - 4e-6j) * t**2
    slope, bend = (3e-3 + 1e-3j) + 2 * (2e-6 - 4e-6j) * t, 2 * (2e-6 - 4e-6j)
    spun = [W, 1j * omega * W + slope, -(omega**2) * W + 2j * omega * slope + bend][order]
    signal, start = (spun * np.exp(1j * theta)).real + 7.0, 63 * np.arange(10)
    found = blocks(signal, start, 63, theta[start], omega, order)
    np.testing.assert_allclose(found[:, 0], W.reshape(10, 63).mean(axis=1), atol=1e-11)


def test_the_noise_of_a_row_is_that_of_the_mean():
    noise = np.random.default_rng(0).standard_normal((20000, 62))
    found = lock_in(noise, 2 * np.pi * 0.0323 * np.arange(62) + np.arange(20000)[:, None])[:, 0]
    # 1.5 % above sqrt(2/n) for two periods; 20000 rows tell a standard deviation to 0.35 %
    assert found.real.std() == pytest.approx(1.015 * np.sqrt(2 / 62), rel=0.02)
    assert found.imag.std() == pytest.approx(1.015 * np.sqrt(2 / 62), rel=0.02)


def test_one_pole_filters():
    t = np.arange(60000)
    theta, away, tau = 2 * np.pi * 0.0323 * t, 1e-3, 800.0
    found = low_pass((np.exp(1j * (theta + away * t))).real, theta, tau, 2)[40000:]
    expected = np.exp(1j * away * t[40000:]) / (1 + 1j * away * tau) ** 2
    # the step from sample to sample is 1/1600 of tau; the image is (2 omega tau)^-2 = 1e-5
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_the_frequency_of_the_drive():
    t = np.arange(1_000_000)
    time, v = t * 1e-6, 100 * np.cos(2 * np.pi * 32300.123456 * t * 1e-6)
    v += np.random.default_rng(0).standard_normal(len(t))
    rows = demodulate(time, v, v)
    # the least error that white noise of 1 % allows over 1e6 samples: sqrt(24/N^3) 0.01 rad/sample = 7.8e-6
    # Hz
    assert np.ptp(rows.frequency) == 0
    assert rows.frequency[0] == pytest.approx(32300.123456, abs=5 * 7.8e-6)
    assert strongest(v) * 1e6 / (2 * np.pi) == pytest.approx(
        32300.123, abs=0.5
    )  # the start: a thirtieth of its 15 Hz


# --- steady responses, and signs
# -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency", [32150.0, 32300.0, 32500.0])
def test_steady_responses(frequency, save):
    time, v, w = samples(PLATE, [(0.0, 50.0, frequency)], 0.04)
    (log,) = read_logs(save(time, v, w))
    expected = steady(PLATE, 50.0, frequency)
    # after 38 ms, 23 tau, 1e-10 of the transient is left; nine digits in the file
    np.testing.assert_allclose(log.response[-20:], expected, atol=2e-9)
    assert np.sign(round(expected.imag, 2)) == np.sign(32300 - frequency)  # below resonance Wq > 0
    np.testing.assert_allclose(log.drive, 50.0, rtol=1e-8)
    np.testing.assert_allclose(log.frequency, frequency, atol=1e-5)
    assert (log.kind, log.sampling, log.drive_unit, log.response_unit) == ("transient", "instant", "V", "um")
    assert log.notes == (f"demodulated at {frequency:.3f} Hz, boxcar of 2 periods, {len(log)} rows",)
    # nobody stated how late the sensor is: by a block, maybe
    block = {"lockin_boxcar_s": pytest.approx(62e-6), "delay_std_s": pytest.approx(62e-6, rel=1e-4)}
    assert log.bench == {"delay_s": pytest.approx(31.5e-6), **block}


@pytest.mark.parametrize("V", [50.0, -50.0])
def test_against_its_own_phase_the_drive_is_positive(V):
    rows = demodulate(*samples(PLATE, [(0.0, V, 32250.0)], 0.03))
    np.testing.assert_allclose(rows.drive, 50.0, rtol=1e-8)
    assert rows.response[-1] == pytest.approx(steady(PLATE, 50.0, 32250.0), abs=1e-6)


# --- rows and edges
# ------------------------------------------------------------------------------------------------------


def edges_of(rows):
    k = np.flatnonzero(np.diff(rows.stretch)) + 1
    return rows.time[k], rows.drive[k], rows.frequency[k]


def test_rows_begin_at_the_edges_of_the_drive():
    drive = [
        (0.0, 0.0, 32290.0),
        (3.21e-3, 80.0, 32290.0, 0.5),
        (9.1234e-3, -40.0, 32290.0),
        (14e-3, 0.0, 32290.0),
    ]
    rows = demodulate(*samples(PLATE, drive, 0.02, noise=0.01))
    at, V, f = edges_of(rows)
    np.testing.assert_allclose(
        at, [3.21e-3, 9.1234e-3, 14e-3], atol=1.5e-6
    )  # a sample is 1 us; one more may hide in noise
    np.testing.assert_allclose(V, [80, -40, 0], atol=0.05)  # 1 % of 80 V over some 5000 samples: 0.016
    np.testing.assert_allclose(f, 32290.0, atol=0.1)  # 0.8 V over 11000 samples: 0.01 Hz
    assert np.ptp(f) == 0
    assert np.min(np.diff(rows.time)) == pytest.approx(rows.width)
    assert np.max(np.diff(rows.time)) < 2 * rows.width + 1e-9


@pytest.mark.parametrize("steps", [25, 50, 100])
def test_a_recorder_of_few_steps_does_not_end_a_burst(steps):
    """An oscilloscope of eight bits, of whose range a drive takes a part: its rounding is no change of the
    drive, which is zero to the last bit before it."""
    time, v, w = samples(
        PLATE, [(0.0, 0.0, 32290.0), (2e-3, 80.0, 32290.0, 0.5), (9e-3, 0.0, 32290.0)], 0.015, 3.85e5
    )
    step = 2 * 80.0 / steps
    rows = demodulate(time, np.round(v / step) * step, w)
    at, V, _ = edges_of(rows)
    np.testing.assert_allclose(at, [2e-3, 9e-3], atol=2.6e-6)  # a sample
    # of twelve samples a period, and then the same again: step/sqrt(12) each, 1/sqrt(6) of that in their sum
    np.testing.assert_allclose(V, [80, 0], atol=2 * step / np.sqrt(12) / np.sqrt(6))


def test_a_frequency_that_steps_with_its_phase_continued():
    drive = [
        (0.0, 100.0, 32200.0),
        (7.0003e-3, 100.0, 32250.0),
        (13.1e-3, 100.0, 32255.0),
        (18e-3, 50.0, 32400.0),
    ]
    rows = demodulate(*samples(PLATE, drive, 0.0225, noise=0.003))
    at, V, f = edges_of(rows)
    # phases of 5e-4 in each of some 80 blocks are lines to 1e-4 rad, which meet to 1e-4/(2 pi 5 Hz): 3 us
    np.testing.assert_allclose(at, [7.0003e-3, 13.1e-3, 18e-3], atol=15e-6)
    np.testing.assert_allclose(f, [32250, 32255, 32400], atol=0.05)
    np.testing.assert_allclose(V, [100, 100, 50], rtol=1e-3)
    fit = sysid.fit([as_log(rows)])
    for name, (error, std) in relative(fit, PLATE).items():
        assert abs(error) < 4.5 * std, name


@pytest.mark.study
def test_a_pause_leads_to_the_phase_after_it():
    # A burst that begins anew at any phase: in the pause the frame turns so that theta arrives there.
    drive = [(0.0, 100.0, 32290.0), (8.2e-3, 0.0, 32290.0), (10.5e-3, 100.0, 32290.0, 2.0)]
    rows = demodulate(*samples(PLATE, drive, 0.02))
    _, V, f = edges_of(rows)
    np.testing.assert_allclose(V, [0, 100], atol=1e-6)
    np.testing.assert_allclose(f[1], 32290, atol=1e-3)
    assert abs(f[0] - 32290) < 0.5 / 2.3e-3  # within half a turn of the pause
    fit = sysid.fit([as_log(rows)])
    for error, _ in relative(fit, PLATE).values():
        assert abs(error) < 1e-3  # a sample, 1 us of 1.67 ms


def test_a_stated_frequency_names_the_drive_s(save):
    time, v, w = samples(PLATE, [(0.0, 50.0, 32290.0)], 0.01, noise=0.01)
    assert np.all(read_logs(save(time, v, w, "frequency_Hz: 32290"))[0].frequency == 32290.0)
    (log,) = read_logs(save(time, v, w, "frequency_kHz: 32.28"))
    assert log.frequency[0] == pytest.approx(32290.0, abs=0.1)
    assert any("stated are 32280.000 Hz" in note for note in log.notes)


def test_temperature_follows_the_stretches(save):
    time, v, w = samples(PLATE, [(0.0, 50.0, 32290.0), (5e-3, 25.0, 32290.0)], 0.01)
    (log,) = read_logs(save(time, v, w, "temperature_degC: 31"))
    assert np.all(log.temperature == 31.0)
    rows = demodulate(time, v, w)
    path = save(time, v, w)
    lines = path.read_text().splitlines()
    warm = [f"{line},{24 + t * 100}" for line, t in zip(lines[2:], time, strict=True)]
    path.write_text("\n".join([lines[0], lines[1] + ",temperature_degC", *warm]) + "\n")
    found = read_logs(path)[0].temperature
    assert len(np.unique(found)) == 2
    assert (found[0], found[-1]) == (pytest.approx(24.25, abs=1e-3), pytest.approx(24.75, abs=4e-3))
    assert len(found) == len(rows.time)


# --- fits
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.study
def test_fits_are_unbiased_and_as_good_as_they_say(save):
    # Edges at any sample, carrier at any phase, 1 % noise in each sample of drive and response.
    scores = []
    for seed in range(24):
        rng = np.random.default_rng(1000 + seed)
        begin, end = 1e-6 * rng.integers(2000, 2100), 1e-6 * rng.integers(10000, 10100)
        drive = [(0.0, 0.0, 32290.0), (begin, 100.0, 32290.0, 2 * np.pi * rng.random()), (end, 0.0, 32290.0)]
        fit = sysid.fit(
            read_logs(save(*samples(PLATE, drive, 0.0165, noise=0.01, seed=seed), "temperature_degC: 24"))
        )
        assert fit.result is sysid.Result.successful
        scores.append([error / std for error, std in relative(fit, PLATE).values()])
    scores = np.array(scores)
    # Of each parameter, the mean of 24 unit normals and their sum of squares, at a chance of one in a
    # thousand.
    assert np.all(np.abs(scores.mean(axis=0)) < 3.3 / np.sqrt(24)), scores.mean(axis=0)
    assert np.all(chi2.cdf(np.sum(scores**2, axis=0), 24) < 0.999), scores.std(axis=0)
    assert np.all(chi2.cdf(np.sum(scores**2, axis=0), 24) > 0.001), scores.std(axis=0)


@pytest.mark.study
@seeds(2, 12)
def test_a_delay_turns_each_frequency_by_another_angle(seeds, save):
    # 12 us behind a carrier whose frequency steps through the resonance, which is neither gain nor feedthrough
    drive = [(2e-3 + 6e-3 * k, 100.0, 32150.0 + 30 * k) for k in range(11)]
    for seed in seeds:
        time, v, w = samples(PLATE, [(0.0, 0.0, 32150.0), *drive], 68e-3, noise=0.01, seed=seed)
        here = slice(50, -50)
        fit = sysid.fit(read_logs(save(time[here], v[here], np.roll(w, 12)[here])))
        assert fit.result is sysid.Result.successful
        assert all(abs(error) < 4 * std for error, std in relative(fit, PLATE).values()), relative(fit, PLATE)


@pytest.mark.study
@pytest.mark.parametrize("late", [study(-20), 20])
def test_a_sensor_s_delay_is_in_the_error_of_the_gain(late, save):
    # By 20 us, 1.2 % of tau: a decoder's, or channels that are read one after the other. Stated, it is none.
    scores, errors = [], []
    for seed in range(8):
        drive = [(0.0, 0.0, 32290.0), (2e-3, 100.0, 32290.0, 0.7 * seed), (10e-3, 0.0, 32290.0)]
        time, v, w = samples(PLATE, drive, 0.0165, noise=0.01, seed=seed)
        here = slice(50, -50)
        v, w = v[here], np.roll(w, late)[here]
        told = [
            relative(sysid.fit(read_logs(save(time[here], v, w, *stated))), PLATE)["G"]
            for stated in ((), (f"delay_us: {late}",), ("delay_us: 0", "delay_std_us: 40"))
        ]
        scores.append([error / std for error, std in told])
        errors.append([std for _, std in told])
    assert np.all(np.abs(scores) < 4), scores  # a chance of one in 800 for all of them
    unstated, exact, rough = np.median(errors, axis=0)
    assert 4 * exact < min(unstated, rough) and unstated == pytest.approx(rough, rel=0.1)


@pytest.mark.study
def test_an_edge_between_samples_moves_the_gain_alone():
    drive = [(0.0, 0.0, 32290.0), (2.0003e-3, 100.0, 32290.0, 0.4), (10.0003e-3, 0.0, 32290.0)]
    G, tau, f0 = (
        v[0]
        for v in relative(sysid.fit([as_log(demodulate(*samples(PLATE, drive, 0.0165)))]), PLATE).values()
    )
    # 0.7 us of drive, of 1669 in tau, are missed: none at a zero of the carrier, twice the mean at a peak
    assert -2 * 0.7 / 1669 < G < -1e-4
    assert max(abs(tau), abs(f0)) < 0.05 * 0.7 / 1669  # a twentieth of what the gain may move


@pytest.mark.parametrize("theta", [0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4])
def test_what_is_left_of_the_carrier_s_phase_at_an_edge(theta):
    # Switched on at a peak or at a zero of the carrier, the response differs by 1/(2 Q) = 0.3 %: none of it
    # is left.
    drive = [(0.0, 0.0, 32290.0), (2e-3, 100.0, 32290.0, theta), (10e-3, 0.0, 32290.0)]
    time, v, w = samples(PLATE, drive, 0.0165)
    w += 2e-5 * np.random.default_rng(0).standard_normal(len(w))
    for name, (error, std) in relative(sysid.fit([as_log(demodulate(time, v, w))]), PLATE).items():
        assert std < 1e-5, name
        assert abs(error) < 4.5 * std, name


@pytest.mark.study
def test_a_blade_of_q_8():
    drive = [
        (0.0, 0.0, 880.0),
        (12e-3, 3.0, 880.0, 1.0),
        (0.352, 0.0, 880.0),
        (0.4, 1.0, 920.0, 0.2),
        (0.55, 3.0, 920.0),
    ]
    log = as_log(demodulate(*samples(BLADE, drive, 0.72, rate=1e5, noise=0.01)))
    assert np.median(np.diff(log.time)) == pytest.approx(2 / 880, rel=0.01)  # 0.8 tau
    for name, (error, std) in relative(sysid.fit([log]), BLADE).items():
        assert std < 0.02, name
        assert abs(error) < 4.5 * std, name
    for name, (error, _) in relative(
        sysid.fit([as_log(demodulate(*samples(BLADE, drive, 0.72, rate=1e5)))]), BLADE
    ).items():
        assert abs(error) < 5e-4, (
            name
        )  # the mean of an exponential over 0.8 tau is taken to fourth order: 1e-4


def test_a_quartz_at_four_samples_a_period():
    drive = [(0.0, 0.0, 5.0005e6), (5e-5, 1.0, 5.0005e6, 1.0), (4e-4, 0.0, 5.0005e6)]
    log = as_log(demodulate(*samples(QUARTZ, drive, 6.2e-4, rate=20e6, noise=0.01)))
    for name, (error, std) in relative(sysid.fit([log]), QUARTZ).items():
        assert std < 0.003, name
        assert abs(error) < 4.5 * std, name


def test_eight_bits(save):
    drive = [(0.0, 0.0, 32290.0), (2e-3, 100.0, 32290.0, 0.4), (10e-3, 0.0, 32290.0)]
    time, v, w = samples(PLATE, drive, 0.0165)
    rounded = [np.round(x / full * 127) / 127 * full for x, full in ((v, 120.0), (w, 2.5))]
    fit = sysid.fit(read_logs(save(time, *rounded)))
    for name, (error, std) in relative(fit, PLATE).items():
        # a step of 0.02 um is noise of 0.3 % of the response, but not quite white: within some six of its
        # deviations
        assert abs(error) < 6 * std + 1e-4, name
        assert std < 1e-3, name


@pytest.mark.parametrize("steps", [0, 127])
@pytest.mark.parametrize("level, clipped", [(1.2, True), (3.0, False)])
def test_samples_that_a_recorder_cut_off_are_told(save, steps, level, clipped):
    """A response of 2 um that a recorder takes up to 1.2 um, in 127 steps or in floats: hundreds of samples lie
    on one value, and the fit called it a finger. One of 8 bits that takes all of it is not accused."""
    drive = [(0.0, 0.0, 32290.0), (2e-3, 100.0, 32290.0, 0.4), (10e-3, 0.0, 32290.0)]
    time, v, w = samples(PLATE, drive, 0.0165, noise=0.002)
    w = np.clip(w, -level, level)
    w = np.round(w / level * steps) / steps * level if steps else w
    (log,) = read_logs(save(time, v, w))
    assert (
        any("saturated" in said and "samples lie exactly at 1.2" in said for said in log.warnings) is clipped
    )


def test_a_carrier_of_few_phases_is_not_taken_for_one_that_is_cut_off(save):
    """At 25 samples a period a settled response has one on its top in each, and few on the step below."""
    plate = PLATE | {"f0": 40000.0}
    time, v, w = samples(plate, [(0.0, 0.0, 40000.0), (2e-3, 50.0, 40000.0)], 0.06)
    (log,) = read_logs(save(time, v, np.round(w / 2e-3) * 2e-3))
    assert not any("saturated" in said for said in log.warnings)


@pytest.mark.study
def test_velocity_delay_and_a_drive_beside_an_offset(tmp_path, save):
    drive = [(0.0, 0.0, 32290.0), (2e-3, 100.0, 32290.0, 0.4), (10e-3, 0.0, 32290.0)]
    time = np.arange(16700) * 1e-6
    v, _ = carrier(PLATE, time, drive)
    late, h = 150.3e-6, 1e-9
    after, before = (carrier(PLATE, time - late + s, [(-1.0, 0.0, 32290.0), *drive])[1] for s in (h, -h))
    speed = (
        (after - before) / (2 * h) * 1e-6
    )  # m/s from um/s: central differences over 2 ns, good to (omega h)^2/6 = 7e-9
    columns = tmp_path / "map.toml"
    columns.write_text(
        'kind = "waveform"\nquantity = "velocity"\n[columns]\ntime = "t_s"\ndrive = "u_V"\n'
        'response = { column = "vib", unit = "m/s" }\n[metadata]\ndelay_us = 150.3\n'
    )
    (log,) = read_logs(save(time, v + 100.0, speed, header="t_s,u_V,vib"), columns=columns)
    assert (log.response_unit, log.drive_unit, log.kind) == ("m", "V", "transient")
    assert log.bench["delay_s"] == pytest.approx(
        31e-6, abs=1e-6
    )  # what the delay is in excess of whole samples, and half a block
    G, tau, f0 = (v[0] for v in relative(sysid.fit([log]), PLATE | {"G": 0.02e-6}).values())
    assert (
        max(abs(G), abs(tau), 100 * abs(f0)) < 3e-4
    )  # rounding of 0.3 samples of delay and edges, of 1670 in tau


@pytest.mark.parametrize(("quantity", "order", "unit"), [("velocity", 1, "m/s"), ("acceleration", 2, "g")])
def test_what_rings_at_its_own_frequency_is_no_larger_by_that(tmp_path, save, quantity, order, unit):
    """A plate of Q 14 that is driven 2.4 % below its resonance: in the acceleration the free motion is larger
    by (f0/f)^2, 5 %, beside the forced one, which a feedthrough made up for."""
    plant = {"G": 11.0, "f0": 176.3, "Q": 14.0}
    drive = [(0.0, 0.0, 172.0), (0.1, 1.5, 172.0, 0.4), (0.4, 0.0, 172.0)]
    time, h = np.arange(28000) / 48000, 1e-6
    v, w = carrier(plant, time, drive)
    after, before = (
        carrier(plant, time + s, [(drive[0][0] - 1, *drive[0][1:]), *drive[1:]])[1] for s in (h, -h)
    )
    # central differences over 2 us, good to (omega h)^2/6 = 2e-7 and, of the second, to rounding of 1e-4
    signal = (after - before) / (2 * h) if order == 1 else (after - 2 * w + before) / h**2
    signal = signal * (1e-6 if order == 1 else 1e-6 / 9.80665)
    columns = tmp_path / "map.toml"
    columns.write_text(
        f'kind = "waveform"\nquantity = "{quantity}"\n[columns]\ntime = "time_s"\ndrive = "drive_V"\n'
        f'response = {{ column = "sensor", unit = "{unit}" }}\n[metadata]\ndelay_s = 0\n'
    )
    path = save(time, v, signal, header="time_s,drive_V,sensor")
    fit = sysid.fit(read_logs(path, columns=columns), effects="none")
    for name, (error, _) in relative(fit, plant | {"G": 11.0e-6}).items():
        # half a sample's place of an edge is 1e-3 of tau
        assert abs(error) < (1e-4 if name == "f0" else 2e-3), name


@pytest.mark.study
def test_a_filter_that_is_asked_for_is_named_in_the_fit(save):
    drive = [(0.0, 0.0, 32300.0), (2e-3, 100.0, 32300.0), (10e-3, 0.0, 32300.0)]
    (log,) = read_logs(
        save(*samples(PLATE, drive, 0.0165, noise=0.003), "lockin_tau_us: 100", "lockin_order: 2")
    )
    assert (log.bench["lockin_tau_s"], log.bench["lockin_order"]) == (pytest.approx(1e-4), 2.0)
    fit = sysid.fit([log])
    assert fit.result is sysid.Result.misfit
    assert fit.plant.tau > tau_of(PLATE) + 5 * np.sqrt(fit.covariance[1, 1])
    on = log.drive > 0
    assert log.response[on][-1] == pytest.approx(steady(PLATE, 100.0, 32300.0), abs=0.03)


def test_the_samples_of_a_scene(tmp_path):
    scene = sysid.Scene.from_toml(SCENES / "two_steps.toml")  # at 28.5 degC
    list(write_waveform(scene, 1e6, 0, tmp_path / "wave.csv"))
    fit = sysid.fit(read_logs(tmp_path / "wave.csv"))
    for name, (error, std) in relative(fit, PLATE | {"f0": 32300 - 10.16 * 4.5}).items():
        assert abs(error) < 4.5 * std, name


@pytest.mark.parametrize("angle", [0.0, -9.0, 90.0])
def test_a_rotation_turns_the_response_and_not_the_drive_s_path(angle):
    """A phase shift is that of positive frequencies, of the forced motion and of the free one alike; the
    drive's edges stay."""
    plant = sysid.Plant(PLATE["G"], tau_of(PLATE), PLATE["f0"])
    edges = np.array([0.0, 1.0003e-3, 5.0007e-3])  # between samples, at no particular phase
    inputs = {"drive": sysid.Profile(edges, [0.0, 100.0, 0.0]), "frequency": sysid.Profile.constant(32290.0)}
    scene = sysid.Scene(plant, inputs, 91, 1e4, (EFFECTS["rotation"](angle),))
    (found,) = waveform(scene, 1e6)
    v, w = carrier(
        PLATE, found.time, [(t, V, 32290.0) for t, V in zip(edges, (0.0, 100.0, 0.0), strict=True)], angle
    )
    np.testing.assert_allclose(found.drive, v, rtol=0, atol=1e-9)  # 2000 rad of phase to 2e-16, times 100 V
    np.testing.assert_allclose(found.response, w, rtol=0, atol=1e-9)  # 2 um


@pytest.mark.study
def test_a_rotation_leaves_the_gain_of_a_ring_down_s_samples(tmp_path):
    """Turned with the drive's path, what an edge leaves behind is off by 2 sin(9 deg)/(4 Q) = 5e-4, and G by
    4e-4."""
    given = sysid.Scene.from_toml(SCENES / "ring_down.toml")
    quiet = [e for e in given.effects if e.kind != "noise" and e.name != "rotation"]
    scene = dataclasses.replace(given, effects=(*quiet, EFFECTS["rotation"](-9.0)))
    list(write_waveform(scene, 1e6, 0, tmp_path / "wave.csv"))
    found = sysid.fit(read_logs(tmp_path / "wave.csv")).plant
    assert (
        abs(found.G / PLATE["G"] - 1) < 1e-4
    )  # an edge known to a tenth of a sample, 1e-7 s of tau = 1.67 ms


# --- files
# -----------------------------------------------------------------------------------------------------------------


def test_a_demodulated_log_reads_back_with_its_carrier_s_phase(save, tmp_path):
    (log,) = read_logs(save(*samples(PLATE, [(0, 0, 32290.0), (1e-3, 100.0, 32290.0)], 5e-3)))
    sysid.write_log(log, tmp_path / "rows.csv")
    (read,) = read_logs(tmp_path / "rows.csv")
    for column in ("time", "drive", "frequency", "theta", "response"):
        np.testing.assert_array_equal(getattr(read, column), getattr(log, column))
    assert (read.kind, read.sampling, read.bench) == (log.kind, log.sampling, log.bench)
    assert not any("kept out" in note for note in read.notes)


def test_sample_rate_instead_of_time(save, tmp_path):
    time, v, w = samples(PLATE, [(0.0, 50.0, 32290.0)], 0.01)
    expected = read_logs(save(time, v, w))[0]
    lines = save(time, v, w).read_text().splitlines()
    bare = [line.split(",", 1)[1] for line in lines[1:]]
    path = tmp_path / "bare.csv"
    path.write_text(
        "\n".join(["# sample_rate_MHz: 1", *bare]) + "\n"
    )  # drive and response say that it is a waveform
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.time, expected.time, atol=1e-12)
    np.testing.assert_allclose(log.response, expected.response, atol=1e-7)
    assert log.metadata["kind"] == "waveform"
    coarse = [f"{np.floor(t * 1e5) / 1e5:.5f},{line}" for t, line in zip(time, bare[1:], strict=True)]
    path.write_text("\n".join(["# sample_rate_Hz: 1e6", "time_s," + bare[0], *coarse]) + "\n")
    np.testing.assert_allclose(read_logs(path)[0].response, expected.response, atol=1e-7)


def test_columns_that_are_no_samples_are_kept_out(save, tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("time_s,voltage_V,wd_um,wq_um,response_code\n0,1,1,1,7\n1,1,1,1,8\n")
    assert read_logs(path)[0].notes == ("column response_code is kept out of the fit",)


def test_memory_is_bounded_by_the_columns():
    time, v, w = samples(PLATE, [(0.2 * k, 100.0 * (1 - k % 2), 32290.0) for k in range(10)], 2.0)
    tracemalloc.start()
    rows = demodulate(time, v, w)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(rows.time) == pytest.approx(2.0 / rows.width, rel=0.01)
    assert peak < 3 * time.nbytes + 200e6  # some 150 MB at a time for the blocks at work


GOOD = samples(PLATE, [(0.0, 50.0, 32290.0)], 0.004)


def changed(**columns):
    return {"time": GOOD[0], "v": GOOD[1], "w": GOOD[2]} | columns


def gated(*drive, duration=0.01):
    time, v, w = samples(PLATE, list(drive), duration)
    return {"time": time, "v": v, "w": w}


def chirp(width):
    """A second of a drive that runs from 1 kHz less `width` of it to as much more, 30 samples a period."""
    t = np.arange(30_000) / 3e4
    return np.cos(2e3 * np.pi * (1 - width + width * t) * t)


def test_a_narrow_chirp_is_read_in_pieces():
    """A response of half of its drive, which is Wq alone, at the frequency that runs on."""
    log = sysid.Log.from_waveform(chirp(0.05), 0.5 * chirp(0.05), 3e4)
    np.testing.assert_allclose(log.drive, 1.0, rtol=1e-3)
    np.testing.assert_allclose(log.response, 0.5j, atol=5e-3)
    np.testing.assert_allclose(log.frequency, 950 + 100 * log.time, atol=2.0)


REFUSED = {
    "constant": (changed(v=0 * GOOD[1] + 3.0), (), ["a drive that is 3 throughout", "samples of its carrier"]),
    "zero": (changed(v=0 * GOOD[1]), (), ["a drive that is 0 throughout"]),
    "noise": (changed(v=np.random.default_rng(0).standard_normal(4000)), (), ["no carrier"]),
    "envelope": (changed(v=np.repeat([0.0, 50.0], 2000)), (), ["periods of the drive", "expected 32 or more"]),
    "few": ({"time": GOOD[0][:300], "v": GOOD[1][:300], "w": GOOD[2][:300]}, (), ["periods of the drive", "expected 32"]),
    "gap": (changed(time=np.where(np.arange(4000) < 1000, 0, 1e-3) + GOOD[0]), (), ["line 1003", "'time_s'", "even steps"]),
    "coarse": (changed(time=np.round(GOOD[0], 5)), (), ["'time_s'", "even steps", "too coarse"]),
    "rate": (changed(), ("sample_rate_Hz: 2e6",), ["'sample_rate_Hz'", "2e+06", "1e+06 Hz as in the time stamps"]),
    "rate unit": (changed(), ("sample_rate_V: 2",), ["'sample_rate_V'", "unit of frequency"]),
    "nyquist": (changed(), ("frequency_kHz: 900",), ["900000 Hz sampled at 1e+06 Hz", "more than two samples a period"]),
    "image": (
        dict(zip(("time", "v", "w"), samples(PLATE, [(0.0, 50.0, 32290.0)], 0.1, rate=65e3), strict=True)), (),
        ["32290 Hz sampled at 65000 Hz", "image is at 420 Hz"],
    ),
    "other": (changed(), ("frequency_Hz: 31000",), ["row 0", "31000 Hz stated", "32290 Hz in the drive's samples"]),
    "pulse": (gated((0, 0, 32290.0), (3e-3, 50, 32290.0), (3.05e-3, 0, 32290.0)), (), ["no carrier", "holds for a few periods"]),
    "spike": (
        gated((0, 50, 32290.0), (2e-3, 0, 32290.0), (6e-3, 50, 32290.0), (6.05e-3, 0, 32290.0)), (),
        ["rows 59", "does not hold"],
    ),
    "chirp": (
        {"time": np.arange(30_000) / 3e4, "v": chirp(0.2), "w": chirp(0.2)}, (),
        ["a drive that does not hold", "one frequency and one level", "a chirp over more than a tenth of its frequency"],
    ),
    "swelling": (
        changed(v=50 * np.exp(-GOOD[0] / 5e-4) * np.cos(2 * np.pi * 32290 * GOOD[0])), (),
        ["one frequency and one level", "of a drive that goes on changing", "demodulate the samples by the drive", "level and frequency"],
    ),
    "jump": (gated((0, 50, 32290.0), (3.3e-3, 50, 32290.0, 1.0)), (), ["phase jumps by", "while it is on"]),
    "rows": (changed(), (), ["wq", "raw samples alone"], "time_s,drive_V,wq_um"),
    "no drive": (changed(), (), ["without a column drive_V"], "time_s,note,response_um"),
    "no response": (changed(), (), ["without a column response_um"], "time_s,drive_V,note"),
    "misspelt": (changed(), (), ["'respones_um'", "did you mean response_um"], "time_s,drive_V,respones_um"),
    "duty": (changed(), (), ["without a column drive_V"], "time_s,duty,response_um"),
    "rms": (changed(), (), ["drive_V_rms in rms", "samples as they are"], "time_s,drive_V_rms,response_um"),
    "no time": (changed(), (), ["without time", "sample_rate_Hz"], "note,drive_V,response_um"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name, save):
    columns, metadata, words, *header = REFUSED[name]
    path = save(*columns.values(), *metadata, **({"header": header[0]} if header else {}))
    with pytest.raises(LogError) as error:
        read_logs(path)
    assert all(word in str(error.value) for word in ("wave.csv", *words)), str(error.value)


NAMES = 'time = "time_s"\ndrive = "drive_V"\n'


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        (f'kind = "waveform"\n[columns]\n{NAMES}w = "response_um"\n', ["of a waveform", "response"]),
        (f'[columns]\n{NAMES}response = "response_um"\n', ["found response", "expected wd and wq"]),
        (f'kind = "waveform"\nphase_sign = -1\n[columns]\n{NAMES}response = "response_um"\n', ["phase_sign"]),
    ],
)
def test_mapping_files_that_are_refused(toml, words, save, tmp_path):
    columns = tmp_path / "map.toml"
    columns.write_text(toml)
    with pytest.raises(LogError) as error:
        read_logs(save(*GOOD), columns=columns)
    assert all(word in str(error.value) for word in ("map.toml", *words)), str(error.value)


def test_uneven_time_is_refused_in_python_too():
    time, v, w = GOOD
    with pytest.raises(LogError, match=r"row 7 .*even steps"):
        demodulate(np.where(np.arange(len(time)) < 7, 0, 1e-5) + time, v, w)


@seeds(4, 40)
def test_a_plate_that_dies_away_within_a_row_is_told_by_its_samples(seeds):
    """At a Q of 5 two periods last longer than tau: the image of a cubic within a row left tau and f0 4 and 3
    of their errors off."""
    t, pulls = np.arange(10_000) / 20e3, []
    plant = {"G": 12.0, "Q": 5.0, "f0": 200.0}
    drive, clean = carrier(plant, t, [(0.0, 0.0, 190.0), (0.05, 2.0, 190.0), (0.3, 0.0, 190.0)])
    for seed in seeds:
        rng = np.random.default_rng(seed)
        noisy = clean + 0.024 * rng.standard_normal(len(t))
        found = sysid.fit(sysid.Log.from_waveform(drive, noisy, 20e3, delay_s=0))
        truth = {"G": plant["G"], "tau": tau_of(plant), "f0": plant["f0"]}
        pulls.append([(p.value - truth[n]) / p.std for n in truth if (p := found.parameters[n])])
    assert np.all(np.sqrt(np.mean(np.square(pulls), axis=0)) < 1 + 2 / np.sqrt(len(pulls)))
