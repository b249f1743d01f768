"""What a design promises, against simulated plants; what it refuses; margins against closed forms and a root
finder."""

import cmath
import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import study

import controller
from controller import Rig, RigError, Sensor, closed_loops, settling_time
from controller.actuator import Adc
from controller.ensemble import Ensemble
from controller.margins import margins
from controller.promise import Clock, Steps, judged, rises
from sysid import Plant, Profile, Scene
from sysid.report.text import gains
from sysid.scene.effects import FingerDamping

TAU = 5e-3 / math.log(20)
T = 1e-4
PLATE = Plant(0.02, TAU, 32300.0, -10.16)


def posterior(seed=0, tau=0.003, logs=(), G=0.001):
    """4000 draws about the paper's plate; `tau`, `G`: their relative spread."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((4, 4, 1000))
    draws = {"G": 0.02 * np.exp(G * z[0]), "tau": TAU * np.exp(tau * z[1])}
    draws |= {"f0": 32300 + 0.1 * z[2], "k_T": -10.16 + 0.05 * z[3]}
    known = {
        name: SimpleNamespace(value=float(v.mean()), determined=True, why=None) for name, v in draws.items()
    }
    fit = SimpleNamespace(parameters=known, units={"G": "um/V"}, reference_temperature=24.0, logs=logs)
    return SimpleNamespace(fit=fit, summary=lambda: known, draws=draws)


def logs_up_to(volts):
    log = SimpleNamespace(
        drive=np.array([0.0, volts]), frequency=np.array([31800.0, 32800.0]), sha256="ab" * 32
    )
    return (SimpleNamespace(log=log),)


# --- margins
# ------------------------------------------------------------------------------------------------------------------


def plants(*rates):
    return Ensemble(np.full(len(rates), 0.02 / TAU), np.array(rates) / TAU, np.zeros(len(rates)))


@pytest.mark.parametrize(("samples", "largest"), [(1, 1.0), (2, (math.sqrt(5) - 1) / 2)])
def test_gain_margin_of_the_zero_cancelling_loop(samples, largest):
    """z^d (z - 1) + K = 0 is stable to K = 1 (d = 1) and to the golden ratio's inverse (d = 2)."""
    loop = controller.design(PLATE, bandwidth_hz=200.0)
    found = margins(loop.law, plants(1.0), T, samples * T)
    K = -math.expm1(-2 * math.pi * 200.0 * T)
    assert found.gain[0] == pytest.approx(
        largest / K, rel=2e-3
    )  # 400 points to the Nyquist frequency, straight between
    # L = K / (z^d (z - 1)): |L| = 1 at w = 2 asin(K/2), where the phase is -pi/2 - w (d + 1/2)
    w = 2 * math.asin(K / 2)
    assert found.phase[0] == pytest.approx(math.pi / 2 - w * (samples + 0.5), abs=2e-3)
    assert found.delay[0] == pytest.approx((math.pi / 2 - w * (samples + 0.5)) / w * T, rel=5e-3)


@pytest.mark.parametrize("method", ["pi", "adaptive"])
@pytest.mark.parametrize("finger", [1.0, 2.0])
def test_margins_are_those_of_a_loop_that_is_disturbed(method, finger):
    """Gain multiplied by a little less or more than the margin: the simulated loop, with the step that runs,
    dies or grows."""
    loop = controller.design(PLATE, method=method, guard=False)
    found = margins(loop.law, plants(finger), T, loop.delay)
    grown, late = [], loop.delay / T - 1  # a reading is late by a part of a sample
    for factor in (0.97, 1.03):
        # a plate of another G/tau than the design's: the loop's gain times the margin. An observer has learnt
        # a smaller damping: G/tau is known to it, and the voltage has become smaller
        push, rate = 0.02 / TAU * T * found.gain[0] * factor, finger / TAU * T
        law, Z, state, pending, centre, size = loop.law, 0.02 + 0j, loop.law.init(), 0.0, 0.0, []
        if method == "adaptive":  # linear only about where it rests, so a small disturbance of that
            rest = finger * T / TAU
            sent = centre = rest / push
            learnt = rest / found.gain[0] / factor
            state = state._replace(d=1.0, damping=learnt, voltages=(sent,) * len(state.voltages))
            state = state._replace(past=((1.0, 0.0),) * len(state.past))
            pending, Z = sent, 1.0 + 1e-6 + 0j
        reference = 1.0 if method == "adaptive" else 0.0
        before = Z
        for _ in range(400):
            state, command, _ = law.step(state, reference, Z + late * (before - Z))
            before = Z
            Z = (
                reference
                + (Z - reference) * math.exp(-rate)
                - push * (pending - centre) * math.expm1(-rate) / rate
            )
            pending = command.voltage
            size.append(abs(Z - reference))
        grown.append(max(size[300:]) > max(size[50:150]))
    assert grown == [False, True]


def test_a_loop_beyond_its_margin_has_none():
    loop = controller.design(PLATE, latency=0.0)
    assert margins(loop.law, plants(1.0), T, 20 * T).gain[0] == 0.0


# --- the promise
# --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["pi", study("adaptive")])
def test_a_promise_holds_for_fresh_draws(method):
    """1000 draws of another seed, each with a finger up to one that halves the amplitude and -10 to +15 degC,
    in scenes."""
    given = {"amplitude": 2.0, "voltage_limit": 400.0, "frequency_window": (31800.0, 32800.0)}
    given |= {"finger": 1.0, "warming": (-10.0, 15.0)}
    loop = controller.design(posterior(), method=method, **given)
    rng, draws = np.random.default_rng(5), posterior(seed=1).draws
    scenes, which = [], rng.choice(4000, 1000, replace=False)
    finger = FingerDamping(law="power", exponent=1.0)  # rho = F / 1.5 N
    for i in which:
        plate = Plant(*(float(draws[name].ravel()[i]) for name in ("G", "tau", "f0", "k_T")))
        inputs = {
            "drive": 100.0,
            "frequency": 32300.0,
            "force": rng.uniform(0, 1.5),
            "temperature": 24 + rng.uniform(-10, 15),
        }
        profiles = {name: Profile.constant(value) for name, value in inputs.items()}
        scenes.append(Scene(plate, profiles, 300, 1e4, (finger,), fidelity="envelope"))
    traces = closed_loops(loop, scenes, reference=2.0)
    settling = np.array([settling_time(t.time, t.W, 2.0) for t in traces])
    rho = np.array([float(s.inputs["force"].values[0]) / 1.5 for s in scenes])
    tau = np.array([s.plant.tau for s in scenes])
    G = np.array([s.plant.G for s in scenes])
    fresh = margins(loop.law, Ensemble(G / tau, (1 + rho) / tau, np.zeros(1000)), T, loop.delay)
    missed = (
        (settling > loop.promise.settling + 1e-9)
        | (fresh.disk < loop.promise.disk)
        | (fresh.gain < loop.promise.gain)
    )
    assert missed.sum() <= 20  # 1 % is promised
    # and it is no empty promise: a tenth of them come near it
    assert np.mean(settling > 0.5 * loop.promise.settling) > 0.1
    assert np.quantile(fresh.disk, 0.1) < 1.2 * loop.promise.disk


def test_steps_are_those_of_the_closed_loop():
    loop = controller.design(PLATE, voltage_limit=300.0, guard=False, latency=0.4e-4)
    taken = Steps(plants(1.0, 2.0), Clock(T, 0.4e-4, loop.delay - 0.4e-4), 2.0, 32300.0)
    settling, overshoot = judged(rises(loop.law, taken)[0], taken)
    finger = FingerDamping(law="power", exponent=1.0)
    inputs = [{"drive": 100.0, "frequency": 32300.0, "force": force} for force in (0.0, 1.5)]
    profiles = [{name: Profile.constant(value) for name, value in given.items()} for given in inputs]
    scenes = [Scene(PLATE, given, 200, 1e4, (finger,), fidelity="envelope") for given in profiles]
    for k, trace in enumerate(closed_loops(loop, scenes, reference=2.0)):
        assert settling[k] == pytest.approx(settling_time(trace.time, trace.W, 2.0), abs=1e-9)
        assert overshoot[k] == pytest.approx(max(trace.W.max() / 2 - 1, 0.0), abs=1e-6)


@pytest.mark.parametrize("finger", [0.0, 1.0])
def test_a_promise_knows_the_filters_before_it(finger):
    """Of a plate that is as fast as the filters, against the plate and the filters from sample to sample of
    the sensor: as pure lateness they would leave the overshoot of 1 % out."""
    tau, step, n = 0.34e-3, 5e-5, 22
    rig = Rig(sample_time=step, adc=Adc(12.0, 5.0, n / step))
    loop = controller.design(
        Plant(0.04, tau, 32600.0), method="adaptive", rig=rig, voltage_limit=100.0, amplitude=3.2
    )
    filters, law = loop.demodulator, loop.law
    state, W, outputs, rows, asked, driven = law.init(), 0j, [0j] * 4, [], [], (0.0, 0.0)
    for k in range(200 * n):
        if k % n == 0:
            state, command, _ = law.step(state, 3.2, outputs[-1])
            rows.append(abs(W))
            asked.append((command.voltage, command.frequency - 32600.0))
            driven = asked[-2] if k else driven  # one sample of latency
        pole = -(1 + finger) / tau - 2j * math.pi * driven[1]
        settled = -0.04 / tau * driven[0] / pole
        W = settled + (W - settled) * cmath.exp(pole * 0.5 * step / n)
        for i in range(4):  # the sample lies between two steps of this loop: as old as that of other clocks
            seen = W if i == 0 else outputs[i - 1]
            outputs[i] += filters.share * (seen - outputs[i])
        W = settled + (W - settled) * cmath.exp(pole * 0.5 * step / n)
    one = Ensemble(np.array([0.04 / tau]), np.array([(1 + finger) / tau]), np.zeros(1))
    taken = Steps(one, Clock(step, step, 0.0, filters), 3.2, 32600.0)
    found = rises(law, taken)[0]
    # a step's voltage begins between two samples: to the square of what is between, of a rise with tau
    np.testing.assert_allclose(found[:, 0], rows[: len(found)], rtol=0, atol=3.2 * (step / n / tau) ** 2)
    assert finger or 0.005 < max(rows) / 3.2 - 1 < loop.promise.overshoot + 1e-9
    two = taken._replace(plants=Ensemble(*(np.repeat(v, 2) for v in one[:3])))  # in arrays, as plain numbers
    np.testing.assert_allclose(rises(law, two)[0][:, 1], found[:, 0], atol=1e-9)


def test_logs_that_say_little_give_a_slower_loop_that_says_why():
    sure, unsure = controller.design(posterior()), controller.design(posterior(tau=0.25))
    assert unsure.bandwidth_hz < 0.9 * sure.bandwidth_hz
    assert unsure.bandwidth_bound == "posterior"
    assert "1 % of the plates that the logs allow have a G/tau more than" in unsure.notes[0]
    # no plant that the logs allow oscillates: 1 % may
    K = -math.expm1(-2 * math.pi * unsure.bandwidth_hz * T)
    draws = posterior(tau=0.25).draws
    ratio = (draws["G"] / draws["tau"]).ravel() * unsure.tau / unsure.G
    assert np.mean(K * ratio > 0.25) <= 0.0101


# --- refusals
# -------------------------------------------------------------------------------------------------------------------


def test_what_the_sample_time_does_not_allow_is_refused():
    refused = r"settling_time = 1\.5 ms cannot be had: the sample time 0\.001 s and the delay.*nearest"
    with pytest.raises(ValueError, match=refused) as said:
        controller.design(PLATE, sample_time=1e-3, settling_time=1.5e-3)
    nearest = float(str(said.value).split("nearest that can be had is ")[1].split()[0]) * 1e-3
    assert (
        controller.design(PLATE, sample_time=1e-3, settling_time=nearest * 1.0001).promise.settling
        <= nearest * 1.0002
    )


def test_what_the_voltage_does_not_allow_is_refused():
    with pytest.raises(
        ValueError, match=r"the voltage limit 150 stands in the way \(stated\).*takes 1\.67 ms to 95 %"
    ):
        controller.design(PLATE, settling_time=1.5e-3, voltage_limit=150.0, amplitude=2.0)
    loop = controller.design(PLATE, settling_time=1.5e-3, voltage_limit=200.0, amplitude=2.0)
    assert loop.bandwidth_bound == "settling" and loop.promise.settling <= 1.5e-3 + 1e-12


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"method": "foo"}, "found method = 'foo', expected one of pi, paper, pll, adaptive"),
        ({"method": "PI"}, "found method = 'PI', expected one of"),
        ({"finger": -0.5}, "found finger = -0.5, expected"),
        ({"finger": math.nan}, "found finger = nan, expected"),
        ({"rig": Rig(finger=-1.0)}, "found finger = -1, expected"),
        ({"warming": (math.nan, 1.0)}, r"found warming = \(nan, 1.0\), expected two numbers, from and to"),
        ({"warming": (5.0, -5.0)}, r"found warming = \(5.0, -5.0\), expected"),
        ({"warming": 3.0}, "found warming = 3.0, expected"),
    ],
)
def test_what_makes_no_sense_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        controller.design(PLATE, **given)


WANTED = {
    "amplitude": 1.0,
    "voltage_limit": 350.0,
    "settling_time": 2e-3,
    "frequency_window": (31800.0, 32800.0),
}


def test_what_stands_in_the_way_is_what_would_do_when_it_is_taken_away():
    with pytest.raises(
        ValueError,
        match=r"the range of temperatures, warming = \(-10, 15\), stands in the way.*up to 15\d Hz",
    ):
        controller.design(PLATE, warming=(-10.0, 15.0), **WANTED)
    assert controller.design(PLATE, **WANTED).promise.settling <= 2e-3


@pytest.mark.study
def test_two_things_may_stand_in_the_way_each_or_together():
    with pytest.raises(
        ValueError, match="the finger, which adds 2 times the plate's own damping, stands in the way"
    ):
        controller.design(PLATE, finger=2.0, **WANTED)
    with pytest.raises(
        ValueError, match=r"the finger, .* and the range of temperatures, .*, stand in the way"
    ):
        controller.design(PLATE, finger=2.0, warming=(-10.0, 15.0), **WANTED)


@pytest.mark.study
def test_a_thermometer_is_promised_with():
    """A plate that is 15 degC warm begins 152 Hz beside the design's resonance; a loop that is told begins at
    its own."""
    given = {
        "amplitude": 1.0,
        "voltage_limit": 350.0,
        "frequency_window": (31800.0, 32800.0),
        "warming": (-10.0, 15.0),
    }
    blind, told = (controller.design(PLATE, rig=Rig(thermometer=t), **given) for t in (False, True))
    assert (
        told.promise.settling == controller.design(PLATE, **given | {"warming": (0.0, 0.0)}).promise.settling
    )
    assert told.promise.settling < 0.2 * blind.promise.settling
    constant = {"drive": 50.0, "frequency": 32300.0, "temperature": 39.0}
    warm = Scene(
        PLATE,
        {name: Profile.constant(value) for name, value in constant.items()},
        300,
        1e4,
        fidelity="envelope",
    )
    for loop in (blind, told):
        trace = closed_loops(loop, [warm], 1.0)[0]
        assert settling_time(trace.time, trace.W, 1.0) <= loop.promise.settling + 1e-9


def test_the_paper_s_steps_are_refused_where_the_plate_is_narrower():
    """10 Hz to and fro on a plate whose amplitude falls to 0.7 within 0.08 Hz; G and tau are known, and a
    sweep was fitted."""
    slow = Plant(0.02, 2.0, 200.0, 0.0)
    with pytest.raises(
        ValueError, match=r"method = 'paper' cannot be had.*by 10 Hz.*is 0\.0796 Hz; methods.*: pi,"
    ):
        controller.design(slow, sample_time=1e-2, method="paper")
    assert math.isfinite(controller.design(slow, sample_time=1e-2).promise.settling)


@pytest.mark.parametrize("given", [{"sample_time": 10.0}, {"rig": Rig(sample_time=1.0)}])
def test_a_sample_time_in_which_nothing_is_seen_is_refused(given):
    """As of a number in us that was taken for s. What the message offers can be had: six samples of it last
    as long as a loop that runs may be off, 0.1 s."""
    with pytest.raises(ValueError, match=r"sample_time = .* the longest that can be had") as refused:
        controller.design(PLATE, **given)
    longest = float(str(refused.value).split()[-2])
    assert longest == pytest.approx(0.1 / 6, rel=0.01)
    assert controller.design(PLATE, sample_time=0.99 * longest).control.patience * longest < 0.13
    assert math.isfinite(controller.design(Plant(0.02, 10.0, 32300.0), sample_time=10.0).promise.settling)


def test_a_promise_that_would_take_too_long_says_which_sample_time_has_one():
    slow = Plant(0.02, 2.0, 200.0, 0.0)
    loop = controller.design(slow)
    assert math.isinf(loop.promise.settling) and "no settling time is promised" in loop.notes[0]
    enough = float(loop.notes[0].split("a longer sample_time, ")[1].split(" s")[0])
    assert math.isfinite(controller.design(slow, sample_time=enough).promise.settling)
    # what settles well before the last sample that is looked at is promised, and nothing is said
    assert not any(
        "no settling time" in note for note in controller.design(slow, sample_time=0.8 * enough).notes
    )
    note = controller.as_dict(dataclasses.replace(loop, drive_unit="V", response_unit="um"))
    lines = gains(note)
    assert loop.notes[0] in lines and not any("does not settle" in line for line in lines)
    assert any("have margins of at least: gain" in line for line in lines)


@pytest.mark.parametrize(
    ("range_", "said"),
    [
        ({}, "without a finger, at 24 degC"),
        ({"finger": 1.0}, "under a finger that adds up to 1 times the plate's damping, at 24 degC"),
        ({"warming": (-4.0, 8.0)}, "without a finger, at 20 to 32 degC"),
    ],
)
def test_the_screen_says_what_a_promise_covers(range_, said):
    loop = controller.design(posterior(), voltage_limit=300.0, amplitude=1.0, **range_)
    note = controller.as_dict(dataclasses.replace(loop, drive_unit="V", response_unit="um"))
    assert said in " ".join(gains(note))


@pytest.mark.study
def test_a_rig_s_voltage_that_the_logs_have_not_seen_is_said_to_be_cut():
    source, rig = posterior(logs=logs_up_to(20.0)), Rig(voltage_limit=350.0)
    loop = controller.design(source, rig=rig)
    assert loop.limits.voltage == 20.0
    assert any(
        "the voltage limit is 20, the largest drive of the logs, and not the rig's 350" in note
        for note in loop.notes
    )
    for other in (
        controller.design(source, rig=rig, voltage_limit=40.0),
        controller.design(source, rig=Rig(voltage_limit=10.0)),
    ):
        assert not any("the voltage limit is" in note for note in other.notes)


def test_limits_are_those_that_the_logs_have_seen():
    refused = r"amplitude = 2 cannot be had: it needs 100.*limit is 20 \(the largest drive of the logs\).*that can be had is 0\.4"
    with pytest.raises(ValueError, match=refused):
        controller.design(posterior(logs=logs_up_to(20.0)), amplitude=2.0)
    loop = controller.design(posterior(logs=logs_up_to(20.0)))
    assert loop.law.amplitude.highest == 20.0 == -loop.law.amplitude.lowest
    low, high = loop.limits.frequency
    assert (low, high) == pytest.approx(
        (31800 - 95.36, 32800 + 95.36), abs=0.5
    )  # half a bandwidth beyond what was swept
    beyond = controller.design(posterior(logs=logs_up_to(20.0)), amplitude=2.0, voltage_limit=120.0)
    assert beyond.limits.said == "stated" and beyond.law.amplitude.highest == 120.0


def test_a_finger_needs_twice_the_voltage():
    refused = r"needs 200 under a finger of 1, and the voltage limit is 150.*nearest that can be had is 1\.5"
    with pytest.raises(ValueError, match=refused):
        controller.design(PLATE, amplitude=2.0, voltage_limit=150.0, finger=1.0)


def test_a_resonance_that_leaves_the_window_is_refused():
    with pytest.raises(
        ValueError, match=r"the tracker cannot follow.*32147\.6 to 32300 Hz.*window is 32200 to 32400"
    ):
        controller.design(PLATE, warming=(0.0, 15.0), frequency_window=(32200.0, 32400.0))
    with pytest.raises(ValueError, match="cannot follow") as error:
        controller.design(PLATE, warming=(-20.0, 5.0), frequency_window=(32200.0, 32400.0))
    low, high = nearest(error, "warming = (", ")")
    assert low == pytest.approx(-100 / 10.16, rel=0.011) and high == 5.0  # a hundredth is kept clear
    controller.design(PLATE, warming=(low, high), frequency_window=(32200.0, 32400.0))


def nearest(error, before="", after=""):
    """The numbers that a refusal offers."""
    said = str(error.value).split("nearest that can be had is ")[1].removeprefix(before).removesuffix(after)
    return [float(v) for v in said.split(",")]


@pytest.mark.study
def test_a_resonance_too_far_away_to_be_tracked_is_refused():
    """The tracker rests below a fifth of the amplitude. What 1.2 times the voltage makes so far away beats as
    it begins, up to twice what it settles at."""
    given = {"voltage_limit": 120.0, "amplitude": 2.0, "frequency_window": (30000.0, 34600.0)}
    with pytest.raises(
        ValueError, match=r"cannot lock: the resonance lies up to 8\d\d\.?\d* Hz beside"
    ) as error:
        controller.design(PLATE, warming=(-80.0, 80.0), **given)
    low, high = nearest(error, "warming = (", ")")
    assert 0.1 < 1.2 / math.hypot(1.0, 2 * math.pi * TAU * 10.16 * high) < 0.2 and low == -high
    # three digits of it are kept
    assert math.isfinite(
        controller.design(PLATE, warming=(0.99 * low, 0.99 * high), **given).promise.settling
    )


@pytest.mark.study
def test_a_gain_too_little_known_for_the_voltage_is_refused():
    """The mean plate needs 95 V, the weakest of the logs' plates more than the limit."""
    unsure, given = posterior(G=0.05), {"voltage_limit": 100.0}
    with pytest.raises(
        ValueError, match=r"more than 1 % of the plates.*do not come within 5 %.*limit 100 \(stated\)"
    ) as error:
        controller.design(unsure, amplitude=1.9, **given)
    weakest = np.quantile(unsure.draws["G"], 0.005)
    # 0.95 of what the weakest makes at full voltage, within what 400 of its 4000 draws leave open of that
    # quantile
    assert nearest(error)[0] == pytest.approx(weakest * 100 / 0.95, rel=0.03)
    unstated = controller.design(unsure, **given)
    assert unstated.amplitude < 0.9 * controller.design(posterior(), **given).amplitude
    assert math.isfinite(unstated.promise.settling)


def test_the_step_response_is_a_band_about_that_of_the_closed_loop():
    loop = controller.design(posterior(), voltage_limit=300.0, amplitude=2.0, finger=1.0, guard=False)
    shown = loop.promise.response
    inputs = {"drive": Profile.constant(100.0), "frequency": Profile.constant(32300.0)}
    force = Profile.constant(0.75)  # rho = 0.5, the middle of the range
    finger = FingerDamping(law="power", exponent=1.0)
    trace = closed_loops(
        loop, [Scene(PLATE, inputs | {"force": force}, 200, 1e4, (finger,), fidelity="envelope")], 2.0
    )[0]
    W = np.interp(shown.time, trace.time, trace.W)
    assert (shown.low <= W + 1e-9).all() and (shown.high >= W - 1e-9).all()
    np.testing.assert_allclose(shown.middle, W, rtol=0, atol=0.02)
    assert (shown.high - shown.low).max() > 0.1 and len(shown.time) <= 50
    note = controller.as_dict(loop)["promise"]["step_response"]
    assert list(note) == ["time_s", "W_5", "W_50", "W_95", "V_5", "V_50", "V_95"]
    np.testing.assert_allclose(note["W_50"], shown.middle, rtol=1e-4)


def test_one_wish_at_a_time():
    with pytest.raises(ValueError, match="expected one of them"):
        controller.design(PLATE, bandwidth_hz=100.0, settling_time=2e-3)


# --- the rig
# --------------------------------------------------------------------------------------------------------------

RIG = """
sample_time_us = 200
latency_us = 150
voltage_limit_V = 300
bipolar = false
voltage_slew_V_per_s = 1e6
frequency_step_Hz = 10.4
thermometer = true
[sensor]
gain = 0.98
rotation_deg = 3
delay_us = 1
"""


def test_a_rig_file(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    rig = Rig.from_toml(tmp_path / "rig.toml")
    assert rig.sample_time == pytest.approx(2e-4) and rig.latency == pytest.approx(1.5e-4)
    assert rig[2:7] == (300.0, False, 1e6, 10.4, True)
    assert rig.sensor[:3] == (0.98, 3.0, pytest.approx(1e-6))
    loop = controller.design(PLATE, rig=rig)
    pi, tracker = loop.law
    assert (pi.lowest, pi.highest) == (0.0, 300.0) and pi.slew == pytest.approx(200.0)
    assert tracker.source.step == 10.4 and tracker.k_T == -10.16
    assert loop.latency == pytest.approx(1.5e-4)
    # 1 us at 32.3 kHz turns by -11.6 degrees, the sensor by 3: both are taken back
    turned = loop.control.d + 1j * loop.control.q
    assert abs(turned) == pytest.approx(1 / 0.98) and math.degrees(np.angle(turned)) == pytest.approx(
        11.628 - 3, abs=1e-3
    )
    assert not any("taken to be that of the logs" in note for note in loop.notes)


@pytest.mark.parametrize(("text", "said"), [
    ("sampletime_us = 1", "sampletime_us: found 'an unknown key', expected one of"),
    ("latency_V = 1", "latency_V: found \"the unit 'V'\", expected s or another of its kind"),
    ("bipolar = 1", "bipolar: found 1, expected true or false"),
    ("voltage_limit = -3", "voltage_limit: found -3.0, expected a number above zero"),
    ("sensor = 1", "sensor: found 1, expected a table"),
    ("[sensor]\ngain = 0", "expected a gain above zero"),
    ("latency = 'soon'", "latency: found 'soon', expected a number in s"),
    ("a = ", "cannot be read"),
])  # fmt: skip
def test_a_rig_file_that_is_wrong(tmp_path, text, said):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(RigError) as error:
        Rig.from_toml(tmp_path / "rig.toml")
    assert said in str(error.value) and "rig.toml" in str(error.value)


def test_the_sensor_is_assumed_aloud():
    assert "taken to be that of the logs" in controller.design(PLATE).notes[0]
    assert Sensor(2.0, 0.0, 0.0).correction(32300.0) == 0.5


def test_a_slew_limit_is_kept_and_costs_time():
    rig = Rig(voltage_slew=2e5)  # 20 V in a sample
    fast, slow = (controller.design(PLATE, voltage_limit=350.0, amplitude=2.0, rig=r) for r in (Rig(), rig))
    assert slow.promise.settling > fast.promise.settling
    inputs = {"drive": Profile.constant(100.0), "frequency": Profile.constant(32300.0)}
    scene = Scene(PLATE, inputs, 200, 1e4, fidelity="envelope")
    for loop in (slow, dataclasses.replace(slow, control=slow.law)):
        trace = closed_loops(loop, [scene])[0]
        assert np.abs(np.diff(trace.V, prepend=0.0)).max() <= 20.0 + 1e-9
        assert trace.W[-1] == pytest.approx(2.0, rel=1e-6)


def test_a_resonance_that_is_drawn_but_not_determined_is_left_out():
    """Two values of f0 fit alike, say: the loop is at resonance, as without a frequency, and still
    settles."""
    told = posterior()
    why = SimpleNamespace(value=None, determined=False, why="two values fit alike")
    known = told.summary() | {"f0": why, "k_T": why}
    fit = SimpleNamespace(**vars(told.fit) | {"parameters": known})
    drawn = controller.design(SimpleNamespace(fit=fit, summary=lambda: known, draws=told.draws))
    without = {name: told.draws[name] for name in ("G", "tau")}
    promise = controller.design(SimpleNamespace(fit=fit, summary=lambda: known, draws=without)).promise
    assert drawn.promise._replace(response=None, bode=None) == promise._replace(response=None, bode=None)
    assert (
        drawn.f0 is None and drawn.promise.settling < 3e-3
    )  # five times the 0.3 tau of the default, and a few samples
