"""The sheet's predictions against simulated stages; the check of a closed loop against loops that are as
designed, or not."""

import dataclasses
import json
import math

import lanes
import numpy as np
import pytest
from conftest import study

import controller
from controller.check import check
from controller.commission import SLOWER, sheet
from sysid import Log, LogError, Plant, Profile, Scene
from sysid.command.cli import main
from sysid.scene.effects import EFFECTS

TAU, T = 5e-3 / math.log(20), 1e-4
PLATE = Plant(0.02, TAU, 32300.0, -10.16)
LOOP = controller.design(PLATE, voltage_limit=160.0, amplitude=2.0, frequency_window=(31800.0, 32800.0))
NOTE = json.loads(
    json.dumps(controller.as_dict(dataclasses.replace(LOOP, drive_unit="V", response_unit="um")))
)
STAGES = {stage.name: stage for stage in sheet(NOTE)}


def number(text, before):
    """The number that stands before a word."""
    return float(text.split(before)[0].split()[-1])


def run(plant=PLATE, loop=LOOP, seed=0, std=0.01, **changes):
    """A record of the loop at a plate, asked for 2 um after 3 ms, with noise of 10 nm."""
    volts = Profile(np.array([0.0, 0.003]), np.array([0.0, 100.0]))
    given = {"drive": volts, "frequency": Profile.constant(32300.0)}
    scene = Scene(
        plant,
        given,
        501,
        1e4,
        (EFFECTS["white_noise"](std=std), *changes.pop("effects", ())),
        fidelity="envelope",
    )
    trace = controller.closed_loop(
        loop, scene, reference=Profile(np.array([0.0, 0.003]), np.array([0.0, 2.0])), seed=seed
    )
    columns = {
        "time": trace.time,
        "drive": np.append(
            0.0, trace.V[:-1]
        ),  # a row holds the command of the step before, as the header says
        "frequency": np.append(trace.f[0], trace.f[:-1]),
        "kind": "transient",
        "sampling": "instant",
    }
    return Log("loop.csv", trace.measured, **columns | changes)


def verdicts(log):
    return {f.what: f.kept for f in check(NOTE, log)}


def test_every_stage_is_there_in_its_order():
    assert list(STAGES) == ["demodulator", "sign of q", "slow loop", "tracker", "full", "touch", "fault"]


def test_the_demodulator_s_stage_is_the_open_loop():
    assert number(STAGES["demodulator"].expect, " um") == pytest.approx(0.02 * 16, rel=1e-3)
    assert number(STAGES["demodulator"].expect, " ms") == pytest.approx(5.0, rel=1e-3)


def test_half_a_bandwidth_below_q_is_as_large_as_d_and_positive():
    frequency = float(STAGES["sign of q"].do.split(" Hz")[0].split()[-1])
    W = complex(PLATE.steady(16.0, frequency, 24.0))
    assert (
        W.real
        == pytest.approx(W.imag, rel=5e-3)
        == pytest.approx(number(STAGES["sign of q"].expect, " um"), rel=5e-3)
    )


def test_the_slow_loop_takes_as_long_as_it_says():
    # W+ = alpha W + G (1 - alpha) V, V a latency later, by hand
    gains, W, before, integral, rows = NOTE["gains"]["d"], 0.0, 0.0, 0.0, []
    alpha = math.exp(-T / TAU)
    for _ in range(1000):
        rows.append(W)
        error = 0.32 - W
        integral += gains["Ki_Ts"] / SLOWER * error
        now = (gains["Kp"] - gains["Ki_Ts"]) / SLOWER * error + integral
        W, before = alpha * W + 0.02 * (1 - alpha) * before, now
    taken = T * np.flatnonzero(np.array(rows) < 0.95 * 0.32)[-1]
    assert max(rows) < 0.32 * 1.001
    # the sample of delay, which the sheet leaves out, speeds a loop of K = 0.018 up by as much
    assert number(STAGES["slow loop"].expect, " ms") == pytest.approx(1e3 * taken, rel=0.025)


def test_the_tracker_is_there_when_it_is_said_to_be():
    tracker, period = LOOP.law.tracker, NOTE["tracker"]["period_s"]
    hb, f, W = 1 / (2 * math.pi * TAU), 32300.0 + 1 / (2 * math.pi * TAU), 0.32 / (1 + 1j)
    taken = number(STAGES["tracker"].expect, " ms") * 1e-3
    for _ in range(round(taken / period)):
        f += max(min(tracker.gain * W.imag / W.real, tracker.max_step), -tracker.max_step)
        pole = -1 / TAU + 2j * np.pi * (32300.0 - f)
        settled = -0.02 / TAU * 16 / pole
        W = settled + (W - settled) * np.exp(pole * period)
    assert abs(f - 32300.0) <= 0.1 * hb


def test_without_f0_there_is_no_tracker_to_commission():
    loop = controller.design(Plant(0.02, TAU, None, None), voltage_limit=160.0, amplitude=2.0)
    assert [s.name for s in sheet(controller.as_dict(loop))] == [
        "demodulator",
        "slow loop",
        "full",
        "touch",
        "fault",
    ]


def test_a_loop_as_designed_is_called_that():
    for seed in range(5):
        assert all(verdicts(run(seed=seed)).values()), check(NOTE, run(seed=seed))


@pytest.mark.parametrize("method", ["pi", study("paper"), study("pll"), "adaptive"])
@pytest.mark.parametrize("std", [0.002, 0.02, 0.04])
def test_noise_that_the_loop_amplifies_is_no_beginning(method, std):
    """Up to 2 % of the amplitude, at which the voltage of a loop at rest flickers by up to 20 V of its 160 V.
    Each is within the promise, and no quicker than the plate at full voltage to 5 %, less four deviations of
    the noise."""
    given = {"voltage_limit": 160.0, "amplitude": 2.0, "frequency_window": (31800.0, 32800.0)}
    loop = controller.design(PLATE, method=method, **given)
    note = controller.as_dict(dataclasses.replace(loop, drive_unit="V", response_unit="um"))
    fastest = 1e3 * TAU * math.log(3.2 / (3.2 - 1.9 + 4 * std))
    for seed in range(8):
        found = check(note, run(loop=loop, seed=seed, std=std))
        assert all(f.kept for f in found), found
        assert number(found[0].found, " ms") > fastest - 0.2  # two rows


def test_a_record_of_another_plate_is_refused():
    named = json.loads(
        json.dumps(
            controller.as_dict(dataclasses.replace(LOOP, plate="A7", drive_unit="V", response_unit="um"))
        )
    )
    assert check(named, run(metadata={"plate": "A7"})) and check(named, run())
    with pytest.raises(LogError, match="found the plate 'B8', expected 'A7'"):
        check(named, run(metadata={"Plate": "B8"}))


def started(lane, seed=0, samples=900):
    """A record of what is exported, switched on at a plate: what was driven while each reading was taken, as
    the header says."""
    found = lanes.play(LOOP, [lane], samples, 2.0, noise=0.01)
    V, f = (np.append(first, found[name][:-1, 0]) for name, first in (("V", 0.0), ("f", 32300.0)))
    columns = {
        "time": T * np.arange(samples),
        "drive": V,
        "frequency": f,
        "kind": "transient",
        "sampling": "instant",
    }
    return Log("loop.csv", found["told"][:, 0], **columns)


def test_a_normal_start_is_called_that():
    """From enabling to within 5 % takes 20 ms: a record of that once was called a slower plate."""
    for lane in (lanes.Lane(), lanes.Lane(f0=15.0)):
        found = check(NOTE, started(lane))
        assert found[0].what == "switched on, to 5 %" and all(f.kept for f in found), found
    assert 15 < number(found[0].found, " ms") < number(found[0].expected, " ms") < 25


def test_a_sensor_that_is_turned_is_seen_in_the_frequency():
    """By 20 degrees: 35 Hz, which Wq/Wd does not show."""
    found = {f.what: f for f in check(NOTE, started(lanes.Lane(rotation=20.0), samples=1500))}
    assert found["resonance less frequency"].kept and not found["frequency less f0"].kept
    assert (
        "by +20 degrees" in found["frequency less f0"].hint
        or "by -20 degrees" in found["frequency less f0"].hint
    )


@pytest.mark.parametrize("more", [0.0, 1e-4, 3e-4])
def test_a_missing_delay_is_named(more):
    """In a step of a loop that is designed for a sample and the demodulator: that sample is over in a row that
    holds the command of the step before, and a second one was once taken for it."""
    for seed in range(3):
        found = {
            f.what: f for f in check(NOTE, run(loop=dataclasses.replace(LOOP, latency=T + more), seed=seed))
        }
        assert abs(number(found["delay"].found, " us") - 1e6 * (LOOP.delay - T + more)) < 20
        assert found["delay"].kept == (more == 0.0)
    assert more == 0.0 or abs(number(found["delay"].hint, " us more") - 1e6 * more) < 20


@pytest.mark.parametrize(("share", "swings"), [(0.8, False), (1.2, True)])
def test_a_loop_that_oscillates_is_said_to(share, swings):
    """Beyond its delay margin. It was taken for noise, within which it had settled at once."""
    late = dataclasses.replace(LOOP, latency=LOOP.latency + share * LOOP.promise.delay)
    found = verdicts(run(loop=late))
    assert (found.get("at the end", True), found["settled to 5 %"]) == (not swings, False)
    assert found["overshoot"] is False


def test_a_loop_that_is_not_as_designed_is_told_by_what():
    damped = verdicts(run(Plant(0.012, 0.6 * TAU, 32300.0, -10.16)))
    assert not damped["voltage at the end"]
    late = run(loop=dataclasses.replace(LOOP, latency=6e-4))
    assert not verdicts(late)["overshoot"]
    still = dataclasses.replace(LOOP, control=LOOP.law._replace(tracker=None))
    beside = verdicts(run(Plant(0.02, TAU, 32360.0, -10.16), still))
    assert not beside["resonance less frequency"] and not beside["voltage at the end"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"drive": None}, "no voltage_* column"),
        ({"drive": np.full(501, 100.0)}, "expected it to begin at rest"),
        ({"response_unit": "nm"}, "expected um as in controller.json"),
        ({"frequency": None, "time": None, "kind": "steady", "sampling": None}, "no time_* column"),
    ],
)
def test_a_record_that_cannot_be_judged_is_refused(changes, said):
    with pytest.raises(LogError, match=said.replace("*", r"\*")):
        check(NOTE, run(**changes))


def test_the_command_judges_a_record(tmp_path, capsys):
    log, folder = run(), tmp_path / "identified"
    folder.mkdir()
    (folder / "controller.json").write_text(json.dumps(NOTE))
    rows = zip(log.time, log.response.real, log.response.imag, log.drive, log.frequency, strict=True)
    record = tmp_path / "closed_loop.csv"
    record.write_text(
        "time_s,wd_um,wq_um,voltage_V,frequency_Hz\n"
        + "\n".join(",".join(map(repr, map(float, r))) for r in rows)
    )
    assert main(["--check", str(record), "-o", str(folder)]) == 0
    assert "as predicted" in capsys.readouterr().out
    assert main(["--check", str(record), "-o", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kept"] is True
    assert main(["--check", str(record), "-o", str(tmp_path / "nowhere")]) == 2
    assert "controller.json: cannot be read" in capsys.readouterr().err
    for broken in ("[1]", "{}", '{"schema": 9}'):
        (folder / "controller.json").write_text(broken)
        assert main(["--check", str(record), "-o", str(folder)]) == 2
        assert "found no controller of schema 1" in capsys.readouterr().err


def test_a_sensor_that_shows_nothing_is_refused():
    log = run()
    with pytest.raises(LogError, match="found no response at its end"):
        check(NOTE, dataclasses.replace(log, response=0 * log.response))


def test_logs_or_a_check_but_not_both_nor_none(capsys):
    for arguments in ([], ["a.csv", "--check", "b.csv"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
    capsys.readouterr()


@pytest.mark.study
def test_a_start_at_a_fiftieth_of_the_amplitude_finds_the_resonance():
    """300 Hz away: in run a tracker holds below a fiftieth, and a start would be lost if it did as well."""
    given = [lanes.Lane(f0=off) for off in (-300.0, 0.0, 300.0)]
    rows = lanes.play(LOOP, given, 3000, 0.04, noise=2e-4)
    assert (rows["mode"][-1] == 4).all()
    np.testing.assert_allclose(rows["f"][-500:].mean(axis=0) - 32300.0, [-300.0, 0.0, 300.0], atol=2.0)
    np.testing.assert_allclose(rows["W"][-1], 0.04, rtol=0.05)
