"""The controller in fixed point: C against its twin in Python bit for bit, both against float64, and on a simulated bench."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from replay import SANITIZERS, array_of, beside_float64, full, in_c, in_twin, rounding, together, worded

import controller
from controller import Rig
from controller.actuator import Adc, Dac, Inverter
from controller.fixed import FixedRecord
from controller.guard import FAULTS
from controller.machine import LOST, MODES, RUN
from controller.recording import record
from controller.scalar import Span

TAU, T = 5e-3 / math.log(20), 1e-4
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
RIG = Rig(timer=1e8, thermometer=True, adc=Adc(12.0, 6.0, 1e6), dac=Dac(12.0, 400.0), inverter=Inverter(300.0, True))
FULL = 2 * 1.5 * 0.02 * 150.0  # um, of a reading


def designed(**given):
    """With a machine that a hundred samples bring to its end."""
    given = {"voltage_limit": 150.0, "frequency_window": (32000.0, 32600.0)} | given
    loop = controller.design(PLATE, **given)
    return dataclasses.replace(loop, machine=loop.machine._replace(patience=5.0, ramp=loop.amplitude / 20, limit=400.0))


# --- words ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [16, 32])
def test_the_arithmetic_is_that_of_fractions(bits):
    """Every operation against numbers: within half of its last place, or saturated."""
    rng, top = np.random.default_rng(bits), 2 ** (bits - 1) - 1
    a, b = rng.uniform(-3, 3, 4000), rng.uniform(-0.02, 0.02, 4000)
    xp = FixedRecord(bits, quotient=8.0)
    x, y = xp.input("a", Span(-3.0, 3.0)), xp.input("b", Span(-0.02, 0.02))
    results = {"sum": x + y, "less": x - y, "product": x * y, "square": x * x, "turned": -x, "scaled": 0.3 * x}
    results |= {"floor": xp.floor(x), "ratio": y / xp.where(x > 0.1, x, 0.1), "larger": xp.where(x > y, x, y)}
    results["both"] = (x > y) & (x > 1.0)
    exact = {"sum": a + b, "less": a - b, "product": a * b, "square": a * a, "turned": -a, "scaled": 0.3 * a}
    exact |= {"floor": np.floor(a), "ratio": b / np.where(a > 0.1, a, 0.1), "larger": np.maximum(a, b)}
    exact["both"] = (a > b) & (a > 1.0)
    points = {"a": xp.known(x).point, "b": xp.known(y).point}
    points |= {name: xp.known(value).point for name, value in results.items()}
    twin = xp.twin({}, {}, results, {}, points)
    words = {"a": twin.word("a", a), "b": twin.word("b", b)}
    near = {name: twin.number(name, w) for name, w in words.items()}
    _, found = twin.step({}, **words)
    for name, word in found.items():
        assert np.abs(word.astype(float)).max() <= top
        if name == "both":
            assert np.mean(word == exact[name]) > 0.99  # but where a rounded word lies on the other side
            continue
        # what a and b were rounded by, and half a unit of the result's last place, a whole one of a quotient
        error = np.abs(near["a"] - a).max() * 6 + np.abs(near["b"] - b).max() * 10 + 2.0 ** -points[name] * 1.01
        if name == "floor":
            error = 1.0 * (np.abs(a - np.round(a)) < error)
        assert (np.abs(twin.number(name, word) - exact[name]) <= error).all(), name
        if bits == 32 and name != "floor":
            assert np.abs(twin.number(name, word) - exact[name]).max() < 1e-6


def test_words_saturate():
    xp = FixedRecord(16)
    x = xp.input("x", Span(-1.0, 1.0))
    twin = xp.twin({}, {}, {"more": x + x, "much": 3.0 * (x * x)}, {}, {"more": 15, "much": 15, "x": 14})
    for word, more, much in ((32767, 32767, 32767), (-32767, -32767, 32767), (8192, 32767, 24576), (-1, -4, 0)):
        assert twin.step({}, x=word)[1] == {"more": more, "much": much}


def test_what_a_word_cannot_hold_is_refused():
    xp = FixedRecord(16)
    with pytest.raises(ValueError, match=r"found 1 added to what goes up to 5e\+05, expected a longer word"):
        xp.input("x", Span(0.0, 5e5)) + 1.0
    with pytest.raises(ValueError, match="expected a control without one, or a bound"):
        _ = xp.input("y", Span(0.0, 1.0)) / xp.input("z", Span(0.0, 1.0))
    with pytest.raises(ValueError, match="found no voltage limit or no frequency window"):
        record(controller.design(PLATE), "q31")
    with pytest.raises(ValueError, match="found q31 for the method 'adaptive'"):
        record(designed(method="adaptive"), "q31")
    with pytest.raises(ValueError, match="expected a longer word"):
        record(designed(rig=Rig(dds=1e6)), "q15")


# --- a log replayed -------------------------------------------------------------------------------------------------------------


def hard(sequences, samples):
    """As in test_export: comes to run, then saturates, rests, misses, sticks, drops to zero, is switched off and reset."""
    rng = np.random.default_rng(3)
    shape, t = (sequences, samples), np.arange(samples)
    kind = np.arange(sequences)[:, None] % 8
    start, noise, at = np.where(t < 40, 0.19, 1.8), rng.standard_normal((3, *shape)), rng.random(shape)
    late = t > samples // 2
    d = np.where(t < 140, start, 1.9 + 0.4 * noise[0])
    q = np.where(t < 140, 0.05 * start, 0.8 * noise[1])
    reference = np.where((t > 140) & (t % 400 < 80), 0.0, 1.8 + 0.5 * noise[2] * (t > 140))
    d = np.where((kind == 1) & (at < 0.02), np.nan, d)
    reference = np.where((kind == 2) & (at < 0.02), np.nan, reference)
    d, q = (np.where((kind == 3) & late, v[:, samples // 2, None], v) for v in (d, q))
    d, q = (np.where((kind == 4) & late, 0.0, v) for v in (d, q))
    d = np.where((kind == 5) & (at < 1e-2), 1e6, d)  # as far as a word goes
    q = np.where((kind == 6) & late, np.nan, q)
    found = {"reference": reference, "share": np.where((kind == 7) & (t > 300), 0.4, 1.0), "wd": d, "wq": q}
    found["temperature"] = 24 + np.cumsum(0.02 * noise[2], 1)
    found["enable"] = np.where((kind == 7) & (t % 300 > 280), 0, 1)
    return found | {"reset": ((at < 2e-3) & (kind > 4)).astype(int)}


CASES = {"pi-rig": {"rig": RIG}, "paper": {"method": "paper"}, "pll": {"method": "pll"}}


@pytest.mark.parametrize(("name", "precision"), [("pi-rig", "q31"), ("pi-rig", "q15"), ("paper", "q31"), ("pll", "q15")])
def test_c_gives_the_bits_of_its_twin(tmp_path, name, precision):
    """A hundred thousand samples; a million of each case: benchmarks/fixed_point.py."""
    loop = designed(**CASES[name])
    inputs = worded(loop, hard(200, 500), precision)
    mine, theirs = in_twin(loop, inputs, precision), in_c(loop, tmp_path, inputs, precision, *SANITIZERS)
    for output in mine.dtype.names:
        np.testing.assert_array_equal(theirs[output], mine[output])
    twin = record(loop, precision).twin
    V, f = twin.number("voltage", mine["voltage"]), 32300.0 + twin.number("frequency", mine["frequency"])
    assert np.abs(V).max() == 150.0 and f.min() >= 32000.0 and f.max() <= 32600.0
    assert set(np.unique(mine["mode"])) == set(range(len(MODES))) and len(np.unique(mine["fault"])) >= 3
    assert (mine["voltage"][(mine["mode"] == 0) | (mine["mode"] == 5)] == 0).all()


@pytest.mark.parametrize(
    ("name", "precision"), [("pi", "q31"), ("pi", "q15"), ("paper", "q15"), ("pll", "q15"), ("pi", "single"), ("pll", "single")]
)
def test_it_is_near_float64(name, precision):
    """The same words in, as numbers, to float64, within what `rounding` derives: looked at are sequences as long as they are
    together."""
    loop = designed(**CASES.get(name, {}))
    mine, exact = beside_float64(loop, hard(80, 500), precision, FULL)
    agree = together(mine, exact)
    assert agree.mean() > 0.95
    room, n = rounding(loop, precision, FULL), np.arange(1, 501)
    off, away = (np.abs(mine[field] - exact[field]) for field in ("voltage", "frequency"))
    assert (off <= room.volts * (n + 1))[agree].all()
    if precision != "single":
        assert off[agree].max() > 0.1 * room.volts  # and it is no bound for another scale
    assert (away <= room.hertz + (n + 1) * room.drift)[agree].all()


# --- a bench --------------------------------------------------------------------------------------------------------------------

REPLAYS = {  # the spoilt reading, of the true and the last one; ms within which the voltage has to end; how it is called
    "dead": (lambda told, last: 0j, 10, {"dead"}),
    "missing": (lambda told, last: complex(math.nan, 0.0), 10, {"missing"}),
    "stuck": (lambda told, last: last, 50, {"stuck", "edge"}),
    "wrong sign of q": (lambda told, last: told.conjugate(), 50, {"reversed"}),
}
AT, SAMPLES = 550, 1080


def played(loop, precision, wanted, noise=0.01):
    """V, f, mode, fault, |W| (samples, replays) of the machine on the simulated plate, whose reading is spoilt from AT on."""
    rng, twin, xp = np.random.default_rng(0), record(loop, precision).twin, array_of(np.float64)
    count = len(REPLAYS)
    state = full(loop.machine.init(), count, float) if twin is None else {n: np.full(count, v) for n, v in twin.first.items()}
    W, pending, frequency = np.zeros(count, complex), np.zeros(count), np.full(count, 32300.0)
    last, rows = np.zeros(count, complex), []
    for k in range(SAMPLES):
        told = W + noise * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
        if k >= AT:
            told = np.array([spoil(*pair) for (spoil, *_), *pair in zip(REPLAYS.values(), told, last, strict=True)])
        last = told
        if twin is None:
            state, command, said = loop.machine.step(state, wanted, told, None, xp, enable=np.full(count, True), reset=False)
            row = (*command, said.mode, said.fault)
        else:
            given = {"reference": wanted, "share": 1.0, "wd": told.real, "wq": told.imag}
            given = {f"in->{n}": twin.word(n, v) for n, v in given.items()} | {"in->enable": True, "in->reset": False}
            state, out = twin.step(state, **given)
            V, f, *rest = (twin.number(n, out[n]) for n in ("voltage", "frequency", "mode", "fault"))
            row = (V, 32300.0 + f, *rest)
        pole = -1 / TAU + 2j * math.pi * (32340.0 - frequency)
        settled = -0.02 / TAU * pending / pole
        W = settled + (W - settled) * np.exp(pole * T)
        pending, frequency = row[:2]
        rows.append((*row, np.abs(W)))
    return np.array(rows).transpose(1, 0, 2)


@pytest.mark.parametrize("precision", ["double", "q31", "q15"])
def test_it_finds_starts_runs_and_a_fault_ends_it(precision):
    """The resonance lies 40 Hz off. It comes to run, at the amplitude; then the reading is spoilt, and the voltage ends."""
    loop = controller.design(PLATE, voltage_limit=350.0, amplitude=1.5, frequency_window=(32150.0, 32490.0))
    V, f, mode, fault, W = played(loop, precision, 1.5)
    assert np.abs(V).max() <= 350.0 and f.min() >= 32150.0 and f.max() <= 32490.0
    assert W[:AT].max() < 1.5 * 1.1
    np.testing.assert_allclose(W[AT - 100 : AT].mean(0), 1.5, rtol=0.005)
    np.testing.assert_allclose(f[AT - 100 : AT].mean(0), 32340.0, atol=1.0)  # the tracker's noise
    for k, (name, (_, within, expected)) in enumerate(REPLAYS.items()):
        begun = int(np.argmax(mode[:, k] == RUN))
        assert 0 < begun < AT - 100 and sorted(set(mode[:begun, k])) == [1, 2, 3]  # find, soft start, lock
        ends = AT + round(1e-3 * within / T)
        assert fault[AT - 1, k] == 0 and (V[ends:, k] == 0.0).all() and (mode[ends:, k] == 5).all(), name
        assert (fault[ends:, k] == fault[-1, k]).all() and FAULTS[int(fault[-1, k])] in expected, name


@pytest.mark.parametrize("precision", ["double", "q31", "q15"])
def test_noise_of_a_twentieth_does_not_keep_it_from_running(precision):
    """Half of what is looked with: single readings are as often near as not, their means are."""
    loop = controller.design(PLATE, voltage_limit=350.0, amplitude=1.5, frequency_window=(32150.0, 32490.0))
    _, _, mode, fault, _ = played(loop, precision, 1.5, noise=0.05 * 1.5)
    assert (fault[AT - 1] == 0).all() and (mode[AT - 1] == RUN).all()


def test_only_a_reset_ends_a_fault():
    loop = designed()
    state, modes = loop.machine.init(), []
    for k in range(300):
        lost, reset, enable = k < 60, k in (150, 250), k % 97 != 0
        W = complex(math.nan, 0.0) if lost else 0.18 + 0.01j * (k % 2)
        state, _, said = loop.machine.step(state, 1.8, W, enable=enable, reset=reset)
        modes.append(said.mode)
    assert modes[57:150] == [5.0] * 93  # 50 samples of patience; neither the reading nor the switch ends it
    assert modes[150:152] == [0.0, 1.0] and 5.0 not in modes[152:]


def test_a_resonance_that_is_not_there_is_lost():
    loop = designed(latency=0.0)
    state = loop.machine.init()
    for k in range(450):
        state, command, said = loop.machine.step(state, 1.8, 0.35 + 1e-4j * (k % 3))  # twice what is asked, whatever is driven
    assert said.fault == LOST and said.mode == 5.0 and command.voltage == 0.0


def test_the_share_of_the_bandwidth_makes_it_slower():
    """K of the loop times the share: without delay the error falls as (1 - share K)^n."""
    pi = controller.design(PLATE, latency=0.0, bandwidth_hz=200.0).law.amplitude
    K, alpha = -math.expm1(-2 * math.pi * 200.0 * T), math.exp(-T / TAU)
    for share in (1.0, 0.4):
        state, W = pi.init(), 0.0
        for _ in range(30):
            state, V, _ = pi.step(state, 1.0, complex(W, 0.0), share=share)
            W = alpha * W + 0.02 * (1 - alpha) * V
        assert pytest.approx((1 - share * K) ** 30, rel=1e-9) == 1 - W  # 30 roundings of 1e-16, of an error of 1e-2 and more
