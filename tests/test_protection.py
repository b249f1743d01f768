"""What is exported is safe from its first power-up: miswirings, runaways and bad inputs, at simulated
plates."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import study
from lanes import AT, F0, TAU, G, Lane, T, play

import controller
from controller.guard import FAULTS
from controller.machine import FAULT, FIND, LOCK, OFF, OPEN, RUN, SOFT, SWEEP

PLATE = SimpleNamespace(G=G, tau=TAU, f0=F0, k_T=-10.16)
ASKED = 1.995  # um: 100 V


def designed(limit=160.0, **given):
    return controller.design(
        PLATE, voltage_limit=limit, amplitude=ASKED, frequency_window=(32000.0, 32600.0), **given
    )


NAN = complex(math.nan, math.nan)
MISWIRED = {
    "polarity": Lane(-1.0), "gain 0.1": Lane(0.1), "gain 0.3": Lane(0.3), "gain 0.55": Lane(0.55), "gain 0.8": Lane(0.8),
    "gain 1.5": Lane(1.5), "gain 10": Lane(10.0), "45 degrees": Lane(rotation=45.0), "-90 degrees": Lane(rotation=-90.0),
    "135 degrees": Lane(rotation=135.0), "half the plate": Lane(G=0.5), "twice the plate": Lane(G=2.0),
    "400 Hz off": Lane(f0=400.0),
    "dead": Lane(0.0), "nothing": Lane(spoil=lambda W, k: NAN), "stuck": Lane(spoil=lambda W, k: 0.19 + 0j),
    "clips at half": Lane(clip=0.5 * ASKED), "offset": Lane(spoil=lambda W, k: W + 0.5),
}  # fmt: skip
SOUND = {
    "as it is": Lane(), "a shorter gain": Lane(0.95), "20 degrees": Lane(rotation=20.0), "150 Hz off": Lane(f0=150.0),
    "three of ten missing": Lane(spoil=lambda W, k: NAN if k * 7919 % 10 < 3 else W),
}  # fmt: skip
# In run; the ms until the drive has ended, which the plate's header states.
BROKEN = {
    "polarity": (Lane(-1.0, at=AT), 8.0, {"missing"}), "gain 0.1": (Lane(0.1, at=AT), 101.0, {"missing"}),
    "gain 0.3": (Lane(0.3, at=AT), 101.0, {"follow", "model", "missing"}), "gain 1.25": (Lane(1.25, at=AT), 101.0, {"model"}),
    "loop gain 5.2": (Lane(G=5.2, at=AT), 40.0, {"oscillates", "above", "missing"}), "dead": (Lane(0.0, at=AT), 8.0, {"dead"}),
    "clips at 0.7": (Lane(clip=0.7 * ASKED, at=AT), 101.0, {"follow"}),
    "180 degrees": (Lane(rotation=180.0, at=AT), 8.0, {"missing"}),
}  # fmt: skip


@pytest.mark.parametrize(("method", "limit"), [("pi", 160.0), study("adaptive", 350.0)])
def test_nothing_that_is_miswired_exceeds_what_was_asked_for(method, limit):
    """Never 1.5 times the amplitude, before the fault nor after it, and never in run; what is sound comes to
    run."""
    lanes = MISWIRED | SOUND
    found = play(designed(limit, method=method), list(lanes.values()), 5600, ASKED)
    for n, name in enumerate(lanes):
        W, mode, fault = (found[field][:, n] for field in ("W", "mode", "fault"))
        assert W.max() < 1.5 * ASKED, name
        assert (
            np.abs(found["V"][(mode >= FIND) & (mode < RUN), n]).max(initial=0.0) <= 1.25 * ASKED / G + 1e-9
        )
        find = (mode == FIND) & (np.arange(len(mode)) > 0)  # a tenth is asked, as much is driven
        assert np.abs(found["V"][find, n]).max(initial=0.0) <= 1.25 * 0.1 * ASKED / G + 1e-9
        if name in SOUND:
            assert mode[-1] == RUN and not fault.any() and abs(W[-1] / ASKED - 1) < 0.06, name
        else:
            assert (
                mode[-1] == FAULT
                and RUN not in mode
                and W[-1] < 1e-3
                and (found["V"][mode == FAULT, n] == 0.0).all()
            ), name


@pytest.mark.always
@pytest.mark.parametrize(("method", "limit"), [("pi", 160.0), study("pi", 350.0), study("adaptive", 350.0)])
def test_what_breaks_in_run_ends_within_the_stated_time(method, limit):
    found = play(designed(limit, method=method), [lane for lane, *_ in BROKEN.values()], AT + 1100, ASKED)
    for n, (name, (_, within, called)) in enumerate(BROKEN.items()):
        mode, fault = found["mode"][:, n], found["fault"][:, n]
        assert mode[AT - 1] == RUN and mode[-1] == FAULT, name
        ends = int(np.argmax(fault > 0))
        assert (ends - AT) * 1e3 * T <= within, name
        assert FAULTS[int(fault[-1])] in called | ({"oscillates"} if method == "adaptive" else set()), name
        assert found["W"][:AT, n].max() < 1.5 * ASKED and (found["V"][ends:, n] == 0.0).all()


DROPS = {
    "nothing": lambda W, k: 0.0 if k < AT + 40 else W, "every other": lambda W, k: W if k % 2 else 0.0,
    "two of three": lambda W, k: 0.0 if k % 3 else W, "turned round": lambda W, k: -W if k < AT + 40 else W,
    "no number": lambda W, k: NAN if k < AT + 40 else W, "twice": lambda W, k: 2 * W if k == AT else W,
}  # fmt: skip


@pytest.mark.parametrize("method", ["pi", study("adaptive")])
def test_a_sensor_that_shows_what_no_plate_can_do_moves_no_plate(method):
    """For 4 ms, as a vibrometer in a dark speckle, or in single samples. The plate once came to 3.4 times what
    was asked, at the voltage's limit, as the loop made up for what was not shown."""
    lanes = [Lane(spoil=spoil, at=AT) for spoil in DROPS.values()]
    found = play(designed(350.0, method=method), lanes, AT + 900, ASKED)
    W, V = found["W"][AT:], np.abs(found["V"][AT:])
    assert np.abs(W / ASKED - 1).max() < 0.1 and V.max() < 1.5 * ASKED / G
    assert (found["mode"][-1] == RUN).all()


@pytest.mark.study
def test_a_sensor_that_shows_less_by_what_a_finger_could_do_is_no_fault():
    """What no loop can tell from a finger, it takes for one: the header and docs/controller.md say so."""
    found = play(designed(350.0), [Lane(0.8, at=AT)], AT + 1300, ASKED)
    assert found["mode"][-1, 0] == RUN and found["W"][-1, 0] == pytest.approx(1.25 * ASKED, rel=0.02)


@pytest.mark.parametrize("bad", [math.nan, study(math.inf), study(-math.inf)])
def test_an_input_that_is_not_finite_is_held_and_counted(bad):
    """One in `share` once left V = 0 for ever, in run, without a fault."""
    loop = designed()
    given = {"share": lambda k: bad if k == 1600 else 1.0}
    once = play(loop, [Lane()], 1900, lambda k: bad if k == 1700 else ASKED, **given)
    assert (once["mode"][1599:] == RUN).all() and np.abs(once["V"][1599:] - 100).max() < 30
    state, machine = loop.machine.init(), loop.machine
    for k in range(10):
        odd = {"share": bad, "voltage": bad, "offset": bad} if k == 5 else {}
        state, *_ = machine.step(
            state, bad if k == 5 else 1.0, 0j, None, enable=False, task=9.0 if k == 5 else 0.0, **odd
        )
    assert state.held.count == 5 and state.held[:2] == (1.0, 1.0)
    state, *_ = machine.step(state, 2 * ASKED, 0j, None, enable=False, share=1.5)
    assert state.held.count == 7 and state.held[:2] == (
        ASKED,
        1.0,
    )  # what is out of range is taken for the end


@pytest.mark.study
def test_a_quiet_sensor_at_rest_is_not_dead():
    """Reference zero, noise below a tenth of a bit: what is left of the drive is less than the sensor can
    show."""
    loop = designed(rig=controller.Rig(adc=controller.rig.Adc(12.0, 2.75, 517e3)))
    asked = lambda k: ASKED if k < AT else 0.0  # noqa: E731
    found = play(
        loop,
        [Lane(spoil=lambda W, k: complex(*(1.2e-3 * np.round(v / 1.2e-3) for v in (W.real, W.imag))))],
        AT + 3000,
        asked,
        noise=1e-4,
    )
    assert (found["fault"] == 0).all() and found["mode"][-1, 0] == RUN


@pytest.mark.study
def test_a_thermometer_s_85_degrees_move_the_frequency_within_the_range():
    """What a sensor says at power-on: -10.16 Hz/degC times 61 degC would be 620 Hz."""
    rig = controller.Rig(thermometer=True, coldest=14.0, warmest=39.0)
    fit = SimpleNamespace(parameters={n: SimpleNamespace(value=v, determined=True, why=None) for n, v in vars(PLATE).items()},
                          units={"G": "um/V"}, reference_temperature=24.0, logs=())  # fmt: skip
    loop = controller.design(
        fit, voltage_limit=160.0, amplitude=ASKED, frequency_window=(31500.0, 33100.0), rig=rig
    )
    found = play(loop, [Lane()], 2500, ASKED, temperature=lambda k: 85.0 if k < 30 else 24.0)
    assert np.abs(found["f"] - F0).max() < 15 * 10.16 + 10 and found["mode"][-1, 0] == RUN


def test_a_clipped_converter_ends_the_drive():
    found = play(designed(), [Lane()], 1700, ASKED, clipped=lambda k: k >= 1600)
    assert (
        FAULTS[int(found["fault"][-1, 0])] == "clipped" and int(np.argmax(found["fault"][:, 0] > 0)) == 1649
    )


def test_a_fault_ends_by_a_reset_with_enable_low_alone():
    """A reset with enable held did restart at once; and a restart forgot the frequency that was learned."""
    lost = lambda k: k in (1600, 1601) or (1602 <= k < 1700)  # noqa: E731
    resets = {"reset": lambda k: 1750 <= k < 1760 or k == 1800, "enable": lambda k: not 1800 <= k < 1810}
    lane = Lane(f0=60.0, spoil=lambda W, k: NAN if lost(k) else W)
    found = play(designed(), [lane], 3300, ASKED, **resets)
    mode, f = found["mode"][:, 0], found["f"][:, 0]
    assert (
        (mode[1660:1800] == FAULT).all()
        and (mode[1801:1810] == OFF).all()
        and mode[1811] == FIND
        and mode[-1] == RUN
    )
    assert f[1700] == F0  # after a fault nothing that was learned is believed
    again = play(designed(), [Lane(f0=60.0)], 3300, ASKED, enable=lambda k: not 1600 <= k < 1700)
    mode, f = again["mode"][:, 0], again["f"][:, 0]
    assert (mode[1601:1700] == OFF).all() and mode[-1] == RUN
    # It goes on where it was, within four times the tracker's noise: 0.004 of the small amplitude moves an
    # update by 0.3/(2 pi tau) times as much, of which the next leaves 0.7.
    noise = 0.3 / (2 * math.pi * TAU) * 0.004 / (0.1 * ASKED) / math.sqrt(1 - 0.7**2)
    assert np.abs(f[1601:] - F0 - 60).max() < 4 * noise


@pytest.mark.study
def test_tasks_of_commissioning():
    """Open loop at a voltage and a frequency; a sweep; the amplitude loop without its tracker; a tracker
    begun at an offset."""
    half, one = 1 / (2 * math.pi * TAU), designed()
    opened = play(one, [Lane()], 400, 0.0, task=2.0, voltage=16.0, offset=-half)
    assert (
        (opened["mode"][1:] == OPEN).all()
        and (opened["V"][1:] == 16.0).all()
        and opened["f"][1:] == pytest.approx(F0 - half)
    )
    assert opened["W"][-1, 0] == pytest.approx(G * 16 / math.sqrt(2), rel=1e-3)
    swept = play(one, [Lane()], 2200, 0.0, task=3.0, voltage=16.0, offset=-250.0)
    f, W = swept["f"][1:, 0], swept["W"][1:, 0]
    assert (
        (swept["mode"][1:] == SWEEP).all()
        and (np.diff(f) >= -1e-9).all()
        and f[-1] == pytest.approx(F0 + 250, abs=0.3)
    )
    at = int(np.argmax(W))
    assert (
        abs(f[at] - F0) < 0.15 * half
        and W[at] == pytest.approx(G * 16, rel=0.02)
        and swept["V"][-1, 0] == 0.0
    )
    held = play(one, [Lane(f0=20.0)], 1500, 0.4, task=1.0)
    assert (held["f"] == F0).all() and held["mode"][-1, 0] == RUN
    far = play(one, [Lane()], 1500, 0.4, offset=half)
    assert (
        far["f"][1, 0] == pytest.approx(F0 + half)
        and abs(far["f"][-1, 0] - F0) < 0.1 * half
        and far["mode"][-1, 0] == RUN
    )
    assert {FIND, SOFT, LOCK} <= set(far["mode"][:, 0])
    wrong = play(
        one, [Lane(G=3.0)], 400, 0.0, task=2.0, voltage=16.0
    )  # a plate that answers three times as much
    assert FAULTS[int(wrong["fault"][-1, 0])] == "above"


@pytest.mark.study
def test_what_is_asked_in_run_may_change_at_once():
    """Two hundred changes a second, braking and all: nothing is a fault."""
    found = play(
        designed(350.0),
        [Lane(), Lane(f0=80.0)],
        6000,
        lambda k: ASKED if k < AT or k % 100 < 50 else 0.05 * ASKED,
    )
    assert (found["fault"] == 0).all() and (found["mode"][-1] == RUN).all()


def pressed(loop, phi, takes, f0=80.0, tau=10e-3, T=1e-3, asked=2.0):
    """The fault, 0 if none, of a plate at resonance on which a finger of `phi` comes within `takes` s, once
    the loop runs, and goes again; its demodulator is a delay. First order, exact under held inputs."""
    state, Z, V, late = loop.machine.init(), 0.0, 0.0, (loop.delay - loop.latency) / T
    shown, ran, stay = [0.0] * (int(late) + 3), None, 1.5 + takes
    for k in range(20000):
        told = shown[-1 - int(late)] + (late - int(late)) * (shown[-2 - int(late)] - shown[-1 - int(late)])
        state, command, said = loop.machine.step(state, asked, complex(told))
        if said.fault:
            return FAULTS[int(said.fault)]
        ran = k if ran is None and said.mode == RUN else ran
        since = -1.0 if ran is None else (k - ran) * T - 0.5
        there = min(max(since / takes, 0.0), 1.0) - min(max((since - stay) / takes, 0.0), 1.0)
        rate = (1 + phi * there) / tau
        settled = G / tau * V / rate
        Z = settled + (Z - settled) * math.exp(-rate * T)
        shown, V = [*shown[1:], Z], command.voltage
        if since > 2 * stay:
            return None
    raise AssertionError("it does not run")


@pytest.mark.parametrize(("finger", "ends"), [(0.3, None), (1.0, "follow")])
def test_a_loop_that_is_too_slow_for_its_finger_says_how_slowly_it_must_come(finger, ends):
    """At 80 Hz the demodulator's delay leaves a loop of 2.6 Hz, 62 ms: of half of the amplitude a tenth is
    left after twice as long times ln 5, the 0.2 s that the guard waits."""
    plate = SimpleNamespace(G=G, tau=10e-3, f0=80.0, k_T=None)
    given = {"voltage_limit": 350.0, "amplitude": 2.0, "frequency_window": (64.0, 96.0), "sample_time": 1e-3}
    loop = controller.design(plate, finger=finger, **given)
    assert pressed(loop, finger, 1e-3) == ends
    said = [note for note in loop.notes if "at once ends the drive" in note]
    assert len(said) == (ends is not None)
    for note in said:
        takes = float(note.partition("one that takes ")[2].split()[0])
        assert 1.0 < takes < 1.5 and pressed(loop, finger, takes) is None
