"""What a rig says is used: the loop's sensor by a calibration log, its timer, its converters; the PLL beside
the trackers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import study

import controller
from controller import Rig, RigError
from controller.actuator import Adc, Dac, Dds, Inverter
from controller.calibration import calibrate
from controller.source import Timer

TAU, T = 5e-3 / math.log(20), 1e-4
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
GIVEN = {"voltage_limit": 350.0, "amplitude": 2.0, "frequency_window": (32000.0, 32600.0)}


def written(path, seed, gain=0.31, rotation=12.0, delay=1.3e-6, noise=0.01, span=500.0):
    """A log of both sensors over a resonance; the loop's is late, turned, in volts, and noisy."""
    rng = np.random.default_rng(seed)
    f = np.linspace(32300 - span, 32300 + span, 101)
    W = 2.0 / (1 + 2j * np.pi * (f - 32300) * TAU)
    S = gain * np.exp(1j * (math.radians(rotation) - 2 * np.pi * f * delay)) * W
    S = S + noise * 2 * gain * (rng.standard_normal(101) + 1j * rng.standard_normal(101))
    rows = np.stack([f / 1e3, W.real, W.imag, S.real, S.imag], 1)
    lines = [
        "frequency_kHz,wd_um,wq_um,sensor_wd_V,sensor_wq_V",
        *(",".join(f"{v:.17g}" for v in row) for row in rows),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_calibration_log_gives_gain_angle_and_delay_with_errors(tmp_path):
    """Over thirty logs each is off by its own standard deviation: the mean square of 30 normal numbers is 1
    +- 0.26."""
    scores = []
    for seed in range(30):
        found = calibrate(written(tmp_path / "both.csv", seed))
        angle = found.rotation - 360 * found.frequency * found.delay - (12.0 - 360 * 32300 * 1.3e-6)
        angle = (angle + 180) % 360 - 180
        off = (
            (found.gain - 0.31) / found.gain_error,
            angle / found.angle_error,
            (found.delay - 1.3e-6) / found.delay_error,
        )
        scores.append(off)
    assert np.mean(np.square(scores), 0).min() > 0.3 and np.mean(np.square(scores), 0).max() < 1.8
    assert found.angle_error < 0.3 and found.gain_error < 0.005 * 0.31


def test_at_one_frequency_the_angle_is_whole(tmp_path):
    found = calibrate(written(tmp_path / "both.csv", 0, span=0.0))
    assert found.delay == 0.0 and found.delay_error == math.inf
    assert found.rotation == pytest.approx(12.0 - 360 * 32300 * 1.3e-6, abs=4 * found.angle_error)


def test_the_rig_uses_it_and_says_how_well_it_is_known(tmp_path):
    written(tmp_path / "both.csv", 1)
    (tmp_path / "rig.toml").write_text('[sensor]\ncalibration = "both.csv"\n')
    loop = controller.design(PLATE, rig=Rig.from_toml(tmp_path / "rig.toml"), **GIVEN)
    turned = loop.control.d + 1j * loop.control.q
    true = 0.31 * np.exp(1j * (math.radians(12.0) - 2 * np.pi * 32300 * 1.3e-6))
    assert turned * true == pytest.approx(
        1.0, abs=0.006
    )  # 1 % of noise in 101 points across the resonance: 0.15 %, four of them
    assert (
        "the loop's sensor is known to" in loop.notes[0] and "degrees (standard deviations)" in loop.notes[0]
    )


@pytest.mark.parametrize(("text", "said"), [
    ("wd_um,wq_um\n1,2\n", "found 0 columns frequency_*"),
    ("frequency_Hz,wd_um,wq_um,sensor_wd_V,sensor_wq_V\n1,2,3,4,5\n", "found 1 rows, expected"),
    ("frequency_Hz,wd_um,wq_um,sensor_wd_V,sensor_wq_mV\n1,2,3,4,5\n", "expected one unit"),
    (None, "both.csv"),
])  # fmt: skip
def test_a_calibration_that_cannot_be_used(tmp_path, text, said):
    if text is not None:
        (tmp_path / "both.csv").write_text(text)
    (tmp_path / "rig.toml").write_text('[sensor]\ncalibration = "both.csv"\n')
    with pytest.raises(RigError) as error:
        Rig.from_toml(tmp_path / "rig.toml")
    assert said in str(error.value) and "rig.toml: sensor.calibration" in str(error.value)


FULL = """
timer_MHz = 100
tracker_period_ms = 2
arithmetic = "double"
[adc]
bits = 12
full_scale = 5
rate_MHz = 1
[dac]
bits = 10
full_scale_V = 400
[inverter]
supply_V = 300
law = "sine"
"""


def test_converters_and_clocks(tmp_path):
    (tmp_path / "rig.toml").write_text(FULL)
    rig = Rig.from_toml(tmp_path / "rig.toml")
    assert (
        rig.adc == (12, 5, 1e6)
        and rig.adc.unit == 5 / 2048
        and rig.dac == (10, 400)
        and rig.inverter == (300, True)
    )
    loop = controller.design(PLATE, rig=rig, **GIVEN)
    assert loop.law.tracker.every == 2 * controller.design(PLATE, **GIVEN).law.tracker.every
    # the demodulator's delay counts, with and without a rig: about 16 samples in a period without one, 31
    # with this
    for one in (loop, controller.design(PLATE, **GIVEN)):
        assert (
            one.delay == pytest.approx(1e-4 + one.demodulator.delay) and 45e-6 < one.demodulator.delay < 60e-6
        )
        d = one.delay / 1e-4
        K = -math.expm1(-2 * math.pi * one.bandwidth_limit_hz * 1e-4)
        assert pytest.approx(d**d / (d + 1) ** (d + 1), rel=1e-9) == K
    controller.export_c(loop, tmp_path / "dq_pi.h")
    assert "#define DQ_DOUBLE 1" in (tmp_path / "dq_pi.h").read_text()


@pytest.mark.parametrize(("text", "said"), [
    ("timer_MHz = 100\ndds_MHz = 1", "expected one source of the frequency"),
    ("force_N = 1.5\nfinger = 1", "finger: found 'force as well', expected one of them"),
    ("coldest_degC = 30\nwarmest_degC = 20", "warmest: found 20.0, expected coldest, 30, or more"),
    ("lowest_frequency_kHz = 33\nhighest_frequency_Hz = 32000", "highest_frequency: found 32000.0, expected lowest_frequency"),
    ("force_mN = -3", "force: found -0.003, expected zero or more"),
    ("arithmetic = 'q31'", "expected one of single, double"),
    ("[adc]\nbits = 12\nrate_MHz = 1", "adc.full_scale: found None, expected a number above zero"),
    ("[dac]\nbits = 40\nfull_scale_V = 3", "dac.bits: found 40.0, expected 4 to 24"),
    ("[inverter]\nlaw = 'sine'", "inverter.supply: found None"),
    ("[sensor]\ncalibration = 'a.csv'\ngain = 2", "the path of a log, and nothing beside it"),
])  # fmt: skip
def test_a_rig_that_is_wrong(tmp_path, text, said):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(RigError) as error:
        Rig.from_toml(tmp_path / "rig.toml")
    assert said in str(error.value)


WHOLE = {
    "a small sensor": (
        Rig(adc=Adc(12.0, 0.5, 517e3)),
        r"adc\.full_scale = 0\.5: an amplitude of 2 shows.*full_scale = 2\.7, or",
    ),
    "a coarse sensor": (
        Rig(adc=Adc(5.0, 5.0, 517e3)),
        r"adc\.bits = 5: a count is 0\.312.*nearest that can be had is bits = 8",
    ),
    "a small converter": (
        Rig(dac=Dac(12.0, 50.0)),
        r"dac\.full_scale: it makes 50 at most.*limit is 350.*voltage_limit = 50",
    ),
    "a weak supply": (
        Rig(inverter=Inverter(200.0, False)),
        r"inverter\.supply: it makes 200 at most.*voltage_limit = 200",
    ),
    "a slow synthesiser": (
        Rig(dds=40e3),
        r"dds = 40000 Hz: it cannot make a carrier of 32300 Hz.*dds = 8\.075e\+04 Hz",
    ),
    "a coarse timer": (
        Rig(timer=4e6),
        r"frequencies 26\d\.?\d* Hz apart: half of the plate's bandwidth is 95\.4.*timer = 5\.4\de\+06",
    ),
    "a slow sensor": (
        Rig(adc=Adc(12.0, 5.0, 9e3)),
        r"adc\.rate = 9000 Hz: a step every 0\.0001 s is less than a sample",
    ),
    "a drive in steps": (Rig(drive_update=1e5), r"drive_update = 100000 Hz.*is no sine.*1\.292e\+05 Hz"),
    "a slow slew": (
        Rig(voltage_slew=3e3),
        r"voltage_slew = 3000 a second stands in the way.*nearest that can be had is \d",
    ),
}


@pytest.mark.parametrize("name", WHOLE)
def test_a_rig_that_cannot_do_what_is_asked_is_refused_for_its_own_cause(name):
    rig, said = WHOLE[name]
    with pytest.raises(ValueError, match=said):
        controller.design(PLATE, rig=rig, **GIVEN)


def test_a_drive_that_is_held_is_corrected():
    """Half of the time between two of its samples: at 517 kS/s 11.2 degrees, with which the tracker settled
    18.9 Hz off."""
    loop = controller.design(PLATE, rig=Rig(drive_update=517e3), **GIVEN)
    turned = math.degrees(np.angle(loop.control.d + 1j * loop.control.q))
    assert turned == pytest.approx(360 * 32300 * 0.5 / 517e3) == pytest.approx(11.25, abs=0.01)
    assert math.tan(math.radians(turned)) / (2 * math.pi * TAU) == pytest.approx(18.9, abs=0.1)
    assert loop.delay == pytest.approx(1e-4 + loop.demodulator.delay + 0.5 / 517e3)


def test_a_rig_may_choose_method_amplitude_and_settling(tmp_path):
    (tmp_path / "rig.toml").write_text(
        'method = "pll"\namplitude_nm = 1500\nsettling_ms = 2\ndrive_update_MHz = 1\n'
    )
    rig = Rig.from_toml(tmp_path / "rig.toml", "V", "um")
    loop = controller.design(PLATE, rig=rig, voltage_limit=350.0, frequency_window=(32000.0, 32600.0))
    assert loop.method == "pll" and loop.amplitude == pytest.approx(1.5) and loop.promise.settling <= 2e-3
    assert controller.design(PLATE, rig=rig, method="pi", **GIVEN).method == "pi"
    content = controller.as_dict(loop)
    assert content["rig"]["drive_update"] == 1e6 and content["rig"]["method"] == "pll"
    assert content["demodulator"]["delay_s"] == loop.demodulator.delay and content["delay_s"] == loop.delay
    assert content["start_up"]["find"] == pytest.approx(0.15)


def identified(touched=None):
    """A fit at 24 degC of a plate called A/7 */; a finger of 1.5 N adds `touched` of its damping."""
    why = None if touched else "no force was recorded"
    known = {"G": 0.02, "tau": TAU, "f0": 32300.0, "k_T": -10.16, "finger_damping": touched}
    found = {n: SimpleNamespace(value=v, determined=v is not None, why=why) for n, v in known.items()}
    log = SimpleNamespace(
        drive=np.array([0.0, 350.0]), frequency=None, sha256="ab" * 32, metadata={"Plate": "A/7 */"}
    )
    return SimpleNamespace(
        parameters=found, units={"G": "um/V"}, reference_temperature=24.0, logs=(SimpleNamespace(log=log),)
    )


def test_the_rig_states_the_frequencies_that_the_tracker_may_drive_at(tmp_path):
    """Over 14 to 39 degC the resonance goes from 32402 to 32148 Hz, beyond the 10 Hz on either side that a
    sweep has seen."""
    warm = "coldest_degC = 14\nwarmest_degC = 39\n"
    found = identified()
    found.logs[0].log.frequency = np.linspace(32290.0, 32310.0, 2)
    (tmp_path / "rig.toml").write_text(warm)
    with pytest.raises(ValueError, match="lowest_frequency and highest_frequency, state another"):
        controller.design(found, rig=Rig.from_toml(tmp_path / "rig.toml"))
    (tmp_path / "rig.toml").write_text(warm + "lowest_frequency_kHz = 32.1\nhighest_frequency_kHz = 32.5\n")
    loop = controller.design(found, rig=Rig.from_toml(tmp_path / "rig.toml"))
    assert loop.limits.frequency == (32100.0, 32500.0)
    (tmp_path / "rig.toml").write_text("lowest_frequency_kHz = 32.1")
    with pytest.raises(ValueError, match="found one end of the frequency window, expected both"):
        controller.design(identified(), rig=Rig.from_toml(tmp_path / "rig.toml"))


def test_the_range_of_a_rig_is_designed_for_and_stamped(tmp_path):
    (tmp_path / "rig.toml").write_text("coldest_K = 287.15\nwarmest_degC = 39\nforce_mN = 500\n")
    rig = Rig.from_toml(tmp_path / "rig.toml")
    loop = controller.design(identified(touched=1.2), rig=rig, frequency_window=(32000.0, 32600.0))
    area = (1 - math.exp(-((0.5 / 0.6) ** (2 / 3)))) / (1 - math.exp(-((1.5 / 0.6) ** (2 / 3))))
    assert (
        loop.finger == pytest.approx(1.2 * area, rel=1e-6) and loop.force == 0.5
    )  # 1e-9 N keep its slope finite
    assert loop.warming == pytest.approx((-10.0, 15.0))
    assert controller.as_dict(loop)["range"]["force_N"] == 0.5
    controller.export_c(loop, tmp_path / "dq_pi.h")
    header = (tmp_path / "dq_pi_plate.h").read_text()
    for said in (
        "plate: A/7__/, G 0.02",
        "temperature: 14 to 39 degC",
        "force: 0 to 0.5 N; finger: damping up to 0.83",
        "ab" * 32,
    ):
        assert said in header, said
    stated = controller.design(
        identified(), rig=rig, finger=0.0, warming=(0.0, 0.0), frequency_window=(32000.0, 32600.0)
    )
    assert stated.finger == 0.0 and stated.warming == (0.0, 0.0)
    cold = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=None)
    with pytest.raises(
        ValueError, match=r"warming = \(-5, 5\) cannot be answered for: k_T is not determined"
    ):
        controller.design(cold, warming=(-5.0, 5.0))
    with pytest.raises(
        ValueError, match=r"force = 0\.5 N says nothing.*no force was recorded; finger states"
    ):
        controller.design(identified(), rig=rig)


def test_words_of_the_source_are_the_frequency():
    timer, clock = Timer.of(1e8, 32300.0), 1e8
    for wanted in np.linspace(31000.0, 33600.0, 997):  # 4 %: the series is right to 0.04^4, 0.1 Hz
        ticks = timer.periods + timer.ticks(wanted - 32300.0, controller.tracker.scalar)
        assert abs(clock / ticks - wanted) <= 0.5 * wanted**2 / clock + 0.1
    dds = Dds(1e6, 32300.0)
    assert (
        dds.base + dds.fraction == pytest.approx(32300 / 1e6 * 2**32, abs=1e-6) and abs(dds.fraction) <= 0.5
    )


@pytest.mark.parametrize("sine", [True, False])
def test_the_duty_law_is_turned_round(sine):
    inverter = Inverter(300.0, sine)
    V = np.linspace(-285.0, 285.0, 101)
    a = inverter.series(285.0)
    duty = (V / 285)[:, None] ** (2 * np.arange(len(a)) + 1) @ a
    made = 300.0 * (4 / np.pi * np.sin(np.pi / 2 * duty) if sine else duty)
    np.testing.assert_allclose(
        made, V, rtol=0, atol=1e-4 * 300 * 2
    )  # the duty ratio to 1e-4, its slope 2 supply at most
    with pytest.raises(ValueError, match="which the inverter can make"):
        inverter.check(1000.0)


# --- trackers
# -------------------------------------------------------------------------------------------------------------------


def tracked(loop, f0, samples, noise=0.02, timer=None):
    """f (samples, n), |W| (samples, n) of the law on plates with resonances f0 (n,), one sample of
    latency."""
    rng, xp, law = np.random.default_rng(1), np, loop.law
    state, W = law.init(), np.zeros(len(f0), complex)
    voltage, frequency, rows = np.zeros(len(f0)), np.full(len(f0), 32300.0), []
    for _ in range(samples):
        told = W + noise * (rng.standard_normal(len(f0)) + 1j * rng.standard_normal(len(f0)))
        state, command, _ = law.step(state, 2.0, told, None, xp)
        made = frequency if timer is None else timer / np.round(timer / frequency)
        pole = -1 / TAU + 2j * math.pi * (f0 - made)
        settled = -0.02 / TAU * voltage / pole
        W = settled + (W - settled) * np.exp(pole * T)
        voltage, frequency = (v + 0.0 * f0 for v in command)
        rows.append((frequency, np.abs(W)))
    return np.array(rows).transpose(1, 0, 2)


def test_the_pll_locks_and_rests():
    """100 Hz off and 1 % of noise; kp = 1/tau, so that without noise it passes by nothing."""
    loop = controller.design(PLATE, method="pll", **GIVEN)
    off = np.array([-100.0, -30.0, 30.0, 100.0])
    f, W = tracked(loop, 32300.0 + off, 600, noise=0.0)
    past = (f - 32300.0 - off) * np.sign(off)
    assert (
        past.max() < 10.0
    )  # a detuning of one half bandwidth bends arctan into tan: beyond linear by a tenth
    assert np.abs(past[300:]).max() < 0.01  # 30 ms: 18 tau
    np.testing.assert_allclose(W[-1], 2.0, rtol=1e-3)
    f, W = tracked(loop, 32300.0 + off, 4000)
    locked = [np.flatnonzero(np.abs(v) > 15)[-1] * T for v in (f - 32300.0 - off).T]
    assert max(locked) < 15e-3
    # an update adds kp/2pi = 95 Hz times 1 % of noise, and the next takes most of it away again
    assert np.std(f[500:], 0).max() < 2.5


@pytest.mark.study
@pytest.mark.parametrize("method", [study("pi"), "pll"])  # the other: in test_closed_loop.py
def test_a_timer_of_100_MHz_does_not_chatter(method):
    """Its steps are 10.4 Hz. For a second after it has come to rest the frequency stands, or a plate at the
    edge of the dead band leaves it once, wherever the resonance lies between two; with 1 % of noise, of each
    of Wd and Wq and each sample."""
    loop = controller.design(PLATE, method=method, rig=Rig(timer=1e8), **GIVEN)
    f0 = 32300.0 + np.linspace(-10.4, 10.4, 100)
    f, W = tracked(loop, f0, 11000, timer=1e8)
    changes = (np.diff(f[1000:], axis=0) != 0).sum(0)
    assert changes.max() <= 1 and changes.sum() <= 5  # of a hundred plates
    assert np.abs(f[-1] - f0).max() < 0.67 * 10.45  # half a step and a dead band of 0.15, and noise
    # the PI holds Wd, so that nothing is lost: |W| is above it by up to 7 Hz / 95 Hz squared and halved, 0.27
    # %
    lost = 1 - W[1000:].mean(0) / 2.0
    assert lost.max() < 0.0015 and lost.min() > -0.0030


def test_a_rig_file_may_bear_the_mark_of_windows(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("sample_time_us = 50\r\n", encoding="utf-8-sig")
    assert controller.Rig.from_toml(path).sample_time == 5e-5
