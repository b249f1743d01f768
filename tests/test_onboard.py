"""The exported C on the bench at the carrier: it starts, steps and tracks as promised, and each fault ends
the drive."""

import dataclasses
import math
import re
import subprocess
from types import SimpleNamespace

import numpy as np
import onboard
import pytest
from conftest import study

import controller
import sysid
from controller.actuator import Adc
from controller.commission import sheet
from controller.export import texts

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
ASKED, LIMIT, WINDOW = 1.8, 250.0, (31900.0, 32700.0)
AT = 0.2  # s; by then it runs
OFF, RUN, FAULT = 0, 4, 5


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """{method: the loop and its bench}, with a converter of 12 bits and noise of 2 LSB."""
    if onboard.compiler() is None:
        pytest.skip("no C compiler")
    found = {}
    for method in ("pi", "adaptive"):
        given = {
            "voltage_limit": LIMIT,
            "amplitude": ASKED,
            "frequency_window": WINDOW,
            "finger": 0.5,
            "method": method,
        }
        loop = controller.design(PLATE, rig=controller.Rig(adc=Adc(12.0, 4.0, 16 * PLATE.f0)), **given)
        found[method] = (
            loop,
            onboard.closed_loop(loop, tmp_path_factory.mktemp(method), ticks=2.0, noise=4e-3),
        )
    return found


@pytest.fixture(params=["pi", "adaptive"])
def each(made, request):
    return made[request.param]


@pytest.fixture
def pi(made):
    return made["pi"]


def amplitude(rows):
    return np.hypot(rows.Wd, rows.Wq)


def overshoot(rows, asked, step):
    return (amplitude(rows).max() - asked) / step


@pytest.mark.always
def test_it_starts_and_holds_the_amplitude(each):
    loop, bench = each
    rows = bench.run(duration=0.4)
    modes = [int(m) for m, before in zip(rows["mode"], [OFF, *rows["mode"]], strict=False) if m != before]
    assert modes == [1, 2, 3, 4] and not rows.fault.any()
    assert rows.peak.max() < 1.05 * ASKED
    late = rows[rows.time > 0.3]
    np.testing.assert_allclose(amplitude(late).mean(), ASKED, rtol=2e-3)
    assert abs(late.made.mean() - PLATE.f0) < 1.0
    assert rows.drive.max() <= LIMIT
    outside = np.flatnonzero(np.abs(amplitude(rows) / ASKED - 1) > 0.05)
    assert 0.01 < rows.time[outside[-1] + 1] <= loop.promise.startup + loop.sample_time


def test_each_line_of_the_commissioning_sheet_can_be_done(pi):
    """What it says that the step is told: it drives as is said, and nothing is a fault."""
    loop, bench = pi
    tasks = {f"DQ_TASK_{word.upper().replace(' ', '_')}": n for n, word in onboard.named("DQ_TASK_").items()}
    stages, names = sheet(controller.as_dict(loop)), {"voltage": "volts", "offset": "begin"}
    for stage in (stage for stage in stages if stage.inputs):
        told = dict(part.split(" = ") for part in stage.inputs.split(", "))
        told = {names.get(name, name): float(tasks.get(value, value)) for name, value in told.items()}
        told = {"reference": 0.0} | told
        rows = bench.run(duration=0.5, **told)
        assert not rows.fault.any() and rows["mode"][-1] == (6 if told["task"] == 2 else RUN)
        last = rows[-500:]
        if told["task"] == 2:
            detuned = 1 + 2j * math.pi * told["begin"] * TAU
            wanted = PLATE.G * told["volts"] / abs(detuned)
            np.testing.assert_allclose(last.V, told["volts"], rtol=1e-4)
        else:
            wanted = told["reference"]
        np.testing.assert_allclose(amplitude(last).mean(), wanted, rtol=5e-3)
        begun = told["begin"] if told["task"] else 0.0
        assert abs(last.made.mean() - PLATE.f0 - begun) < 2.0
    assert [stage.name for stage in stages if stage.inputs] == [
        "demodulator",
        "sign of q",
        "slow loop",
        "tracker",
        "full",
    ]


def test_a_plate_that_is_not_quite_the_design_s(each):
    """A finger within the range of the design, a resonance beside it, as the promise covers."""
    _, bench = each
    rows = bench.run(duration=0.4, finger=0.5, f0=PLATE.f0 - 40)
    assert rows["mode"][-1] == RUN and abs(rows.made[-1000:].mean() - PLATE.f0 + 40) < 1.0
    np.testing.assert_allclose(amplitude(rows[-500:]).mean(), ASKED, rtol=2e-3)


def test_a_step_settles_as_promised(each):
    loop, bench = each
    rows = bench.run([(AT, "reference", 0.0), (AT + 0.05, "reference", ASKED)], duration=AT + 0.08)
    after = rows[rows.time >= AT + 0.05 - 1e-6]
    outside = np.flatnonzero(np.abs(amplitude(after) - ASKED) > 0.05 * ASKED)
    settled = after.time[outside[-1] + 1] - after.time[0]
    assert settled <= loop.promise.settling + loop.sample_time
    assert (
        overshoot(after, ASKED, ASKED) <= loop.promise.overshoot + 0.01
    )  # four standard deviations of noise, 0.2 % each


def test_small_steps_overshoot_as_promised(each):
    """From rest to a tenth, in a sample at full voltage: how much that moves the plate depends on the
    carrier's phase at which it begins, and one of these is near the worst."""
    loop, bench = each
    most, asked = 0.0, 0.1 * ASKED
    for begin in AT + 0.03 + loop.sample_time * np.arange(8):
        events = [(AT, "reference", 0.0), (begin, "reference", asked)]
        rows = bench.run(events, duration=begin + 0.01, noise=1e-4)
        most = max(most, rows.peak[rows.time > begin + 0.5 * loop.sample_time].max() / asked - 1)
    assert most < loop.promise.small + 0.005  # the image of a thousandth, and noise of a twentieth of a count
    assert loop.method != "pi" or 0.7 * loop.promise.small < most


def test_the_tracker_follows_a_plate_that_warms(each):
    _, bench = each
    events = [(AT + 0.2 * x, "temperature", 24.0 + 4.0 * x) for x in np.linspace(0, 1, 100)]
    rows = bench.run(events, duration=AT + 0.3, k_T=-10.16)
    assert rows["mode"][-1] == RUN and abs(rows.made[-300:].mean() - PLATE.f0 + 4 * 10.16) < 1.0
    late = rows[rows.time > AT]
    assert np.abs(amplitude(late) / ASKED - 1).max() < 0.02


def test_a_drive_that_is_held_settles_beside_unless_it_is_counted(pi):
    """Half a hold of 1/16 period is 11.25 degrees: tan of that, times half the bandwidth of 95.4 Hz, is
    18.97 Hz."""
    _, bench = pi
    beside = 1 / (2 * math.pi * TAU) * math.tan(math.pi / 16)
    for counted, wanted in ((0.0, -beside), (1.0, 0.0)):
        rows = bench.run(duration=0.3, hold=2.0, counted=counted)  # two ticks are a sample
        assert abs(rows.made[-1000:].mean() - PLATE.f0 - wanted) < 0.5


def test_margins_are_where_the_promise_says(pi):
    """The plate's gain, and the latency: at 95 % of the margin a kick dies away, at 110 % the loop swings."""
    loop, bench = pi

    def swing(name, value):
        rows = bench.run(
            [(AT, name, value), (AT, "guard", 0.0), (AT + 0.1, "reference", 0.99 * ASKED)], duration=AT + 0.25
        )
        return np.ptp(amplitude(rows[-300:])) / ASKED

    gain, delay = PLATE.G * (loop.promise.gain - 1), loop.promise.delay
    for name, nominal, more in (("G", PLATE.G, gain), ("latency", loop.latency, delay)):
        assert swing(name, nominal + 0.95 * more) < 0.02 < 0.05 < swing(name, nominal + 1.1 * more)


# What goes wrong in run: the changes, the faults that may be called, ms within which the drive must be off.
WRONG = {
    "sensor's polarity": ({"gain": -1.0}, {"missing"}, 10),
    "sensor's gain": ({"gain": 0.3}, {"follow", "model", "missing"}, 150),
    "no sensor": ({"gain": 0.0, "noise": 0.0}, {"dead", "missing"}, 10),
    "stuck": ({"frozen": 1.0}, {"missing"}, 10),  # no samples come
    "missing": ({"missing": 1.0}, {"missing"}, 10),
    "most of the samples missing": ({"missing": 0.85}, {"missing"}, 10),
    "most of the samples lost": ({"lost": 0.75}, {"missing"}, 10),
    "most of the steps left out": ({"skipped": 0.95}, {"missing"}, 60),
    "converter at its end": ({"gain": 3.0, "offset": 3.0}, {"clipped", "above"}, 20),
    "front end clips": ({"clip": 0.5 * ASKED}, {"follow", "model", "clipped"}, 150),
    "loop gain": ({"G": PLATE.G * 8}, {"oscillates", "above", "missing"}, 150),
    "another resonance": ({"f0": PLATE.f0 - 800}, {"edge", "follow", "dead", "reversed", "model"}, 150),
    "phase turned": ({"rotation": 180.0}, {"missing"}, 10),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_goes_wrong_in_run_ends_the_drive(pi, name):
    changes, faults, within = WRONG[name]
    _, bench = pi
    rows = bench.run([(AT, setting, value) for setting, value in changes.items()], duration=AT + 0.2)
    assert rows["mode"][int(AT / 1e-4) - 5] == RUN
    assert rows["mode"][-1] == FAULT and onboard.fault_name(rows.fault[-1]) in faults
    driven = rows.time[rows["mode"] == RUN].max() - AT
    assert driven < 1e-3 * within
    off = rows[rows.time > AT + driven + 2e-3]
    assert not off.V.any() and not off.drive.any()  # and it stays off


@pytest.mark.parametrize(
    "changes", [{"gain": -1.0}, {"amplifier": -1.0}, {"rotation": 120.0}, {"gain": 0.0}, {"frozen": 1.0}]
)
def test_miswired_at_power_up_it_never_drives_hard(each, changes):
    loop, bench = each
    rows = bench.run(duration=0.8, **changes)
    assert rows.peak.max() < 0.5 * ASKED
    stated = re.search(r"find: ([\d.]+) drive-unit, ([\d.]+) response-unit\n", texts(loop, "dq_pi.h")[2])
    assert np.abs(rows.V).max() <= 1.001 * float(stated[1]) and rows.peak.max() <= 1.02 * float(stated[2])
    assert rows["mode"][-1] == FAULT and not rows.V[-10:].any()


def test_only_a_reset_with_enable_low_arms_it_again(pi):
    _, bench = pi
    events = [
        (AT, "gain", -1.0),
        (AT + 0.05, "gain", 1.0),
        (AT + 0.1, "reset", 1.0),
        (AT + 0.15, "enable", 0.0),
    ]
    events += [(AT + 0.16, "reset", 0.0), (AT + 0.17, "enable", 1.0)]
    rows = bench.run(events, duration=AT + 0.4)
    held = rows[(rows.time > AT + 0.05) & (rows.time < AT + 0.15)]
    assert (held["mode"] == FAULT).all() and not held.V.any()
    assert (rows["mode"][(rows.time > AT + 0.1502) & (rows.time < AT + 0.17)] == OFF).all()
    assert rows["mode"][-1] == RUN and not rows.fault[-1]


@pytest.mark.parametrize("name", ["share", "reference", "told_d", "told_q"])
def test_an_input_that_is_no_number_for_a_while_is_held(pi, name):
    _, bench = pi
    back = {"share": 1.0, "reference": ASKED}.get(name, -1e300)
    rows = bench.run([(AT, name, math.nan), (AT + 2e-3, name, back)], duration=AT + 0.05)
    assert (rows["mode"][rows.time > AT] == RUN).all()
    assert np.abs(amplitude(rows[rows.time > AT]) / ASKED - 1).max() < 0.05


def test_a_quiet_sensor_at_rest_is_not_dead(pi):
    _, bench = pi
    rows = bench.run([(AT, "reference", 0.0), (AT + 0.3, "reference", ASKED)], duration=AT + 0.4, noise=1e-5)
    assert rows["mode"][-1] == RUN and not rows.fault.any()
    np.testing.assert_allclose(amplitude(rows[-100:]).mean(), ASKED, rtol=5e-3)


@pytest.mark.parametrize("method", ["pll", study("adaptive")])
def test_whatever_comes_in_what_goes_out_is_within_its_limits(tmp_path, method):
    """Inputs that are no numbers, huge or tiny, at once, and parameters that are changed at random: no
    undefined behaviour, no voltage or frequency beyond the limits, no voltage while it is off."""
    if onboard.compiler() is None:
        pytest.skip("no C compiler")
    given = {"voltage_limit": LIMIT, "amplitude": ASKED, "frequency_window": WINDOW, "method": method}
    controller.export_c(controller.design(PLATE, **given), tmp_path / "dq_pi.h")
    flags = ["-O1", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    sources = [onboard.HERE / "fuzz.c", tmp_path / "dq_pi.c"]
    words = [onboard.compiler(), *flags, f"-I{tmp_path}", *sources, "-lm", "-o", tmp_path / "fuzz"]
    subprocess.run(words, check=True)
    done = subprocess.run([tmp_path / "fuzz", "100000", "1"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_steps_that_do_not_come_while_the_plate_moves_are_no_fault(each):
    """Between two that come the plate moves by as many times as much; with three of ten left out it was called
    missing, as no plate moves so far in one."""
    _, bench = each
    steps = [(AT + 0.02 * k, "reference", ASKED * (k % 2)) for k in range(1, 10)]
    rows = bench.run([(AT, "skipped", 0.3), *steps], duration=AT + 0.2)
    assert rows["mode"][-1] == RUN and not rows.fault.any()


def test_open_loop_drives_with_what_is_stated(pi):
    """The demodulator tells the plate's response: Wq above zero below the resonance, as much as Wd half a
    bandwidth away."""
    _, bench = pi
    half = 1 / (2 * math.pi * TAU)
    rows = bench.run(duration=0.05, task=2.0, volts=20.0, begin=-half, noise=1e-4)
    assert (rows["mode"][5:] == 6).all() and not rows.fault.any()
    late = rows[rows.time > 0.03]
    np.testing.assert_allclose(
        [late.told_d.mean(), late.told_q.mean()], 0.2, rtol=5e-3
    )  # half of 20 V times 0.02 um/V
    np.testing.assert_allclose(late.made, PLATE.f0 - half, rtol=0, atol=0.01)


def test_a_sweep_traces_the_resonance_and_ends_without_voltage(pi):
    _, bench = pi
    rows = bench.run(duration=1.5, task=3.0, volts=20.0, begin=-200.0, noise=1e-4)
    driven = rows[rows.V > 0]
    assert driven.f.min() == PLATE.f0 - 200 and abs(driven.f.max() - PLATE.f0 - 200) < 1
    # slow beside the plate: the largest amplitude is that of the resonance, some time constants after it was
    # passed
    best = np.argmax(amplitude(driven))
    np.testing.assert_allclose(amplitude(driven)[best], 0.4, rtol=0.01)
    assert 0 <= driven.f[best] - PLATE.f0 < 3 * TAU * 400 / np.ptp(driven.time)
    assert not rows.V[-50:].any() and not rows.fault.any()


def test_the_tracker_comes_from_a_stated_offset(pi):
    _, bench = pi
    rows = bench.run(duration=0.3, begin=1 / (2 * math.pi * TAU))
    assert rows["mode"][-1] == RUN and abs(rows.made[-1000:].mean() - PLATE.f0) < 1.0
    assert rows.made[5] > PLATE.f0 + 90


@pytest.mark.study
@pytest.mark.parametrize("units", [study("um/V"), None])
def test_the_loop_s_own_record_refits_the_plate(pi, tmp_path, units, nuisances):
    """A start and two steps, under the lines that the plate's header has firmware print: within four standard
    deviations, and a thousandth for the image at twice the carrier, of the plate on the bench."""
    loop, bench = pi
    response, drive = (None, None) if units is None else units.split("/")
    loop = dataclasses.replace(loop, response_unit=response, drive_unit=drive)
    text = texts(loop, "dq_pi.h")[2].split('RECORD_HEADER "')[1].split('"')[0].replace("\\n", "\n")
    rows = bench.run(
        [(0.06, "reference", 0.5 * ASKED), (0.08, "reference", ASKED)], duration=0.1, f0=PLATE.f0 + 12.0
    )
    told = zip(
        rows.time,
        rows.told_d,
        rows.told_q,
        np.append(0.0, rows.V[:-1]),
        np.append(PLATE.f0, rows.f[:-1]),
        strict=True,
    )
    text += "".join("{:.6f},{:.7g},{:.7g},{:.7g},{:.3f}\n".format(*row) for row in told)
    (tmp_path / "loop.csv").write_text(text)
    (log,) = sysid.read_logs([tmp_path / "loop.csv"])
    assert (log.response_unit, log.drive_unit) == (response or "1", drive or "1")
    fit = sysid.fit([log], nuisances=nuisances)
    for name, true in (("G", PLATE.G), ("tau", TAU), ("f0", PLATE.f0 + 12.0)):
        p = fit.parameters[name]
        assert p.determined and abs(p.value - true) < 4 * p.std + 1e-3 * (name != "f0") * true, (
            name,
            p.value,
            p.std,
        )
    assert fit.parameters["tau"].std < 0.005 * TAU
