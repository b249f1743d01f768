"""The exported C computes the bits that Python computes; the guard ends the drive; controller.json is strict JSON."""

import dataclasses
import json
import math
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from replay import SANITIZERS, in_arrays, in_c

import controller
from controller import Rig, Sensor
from controller.actuator import Adc, Dac, Inverter
from controller.guard import FAULTS
from controller.machine import MODES
from controller.recording import record, record_demodulator

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
SEQUENCES, SAMPLES = 200, 600  # a million samples: benchmarks/fixed_point.py


@cache
def hard_samples():
    """120 000 samples in which a controller first comes to run, and then saturates, rests at zero, sticks, misses, drops to
    zero, jumps, overflows, is switched off and reset."""
    rng = np.random.default_rng(4)
    shape, t = (SEQUENCES, SAMPLES), np.arange(SAMPLES)
    reference = np.where((t > 140) & (t % 400 < 80), 0.0, 1.8 + 0.5 * rng.standard_normal(shape) * (t > 140))
    noise = rng.standard_normal((2, *shape))
    start = np.where(t < 40, 0.19, 1.8)
    d = np.where(t < 140, start, 1.9 + 0.4 * noise[0])
    q = np.where(t < 140, 0.05 * start, 0.8 * noise[1])
    kind = np.arange(SEQUENCES)[:, None] % 10
    at, late = rng.random(shape), t > 400
    d = np.where((kind == 1) & (at < 0.02), np.nan, d)
    q = np.where((kind == 2) & (at < 0.02), np.inf, q)
    reference = np.where((kind == 3) & (at < 0.02), np.nan, reference)
    d, q = (np.where((kind == 4) & late, v[:, 400:401], v) for v in (d, q))
    d, q = (np.where((kind == 5) & late, 0.0, v) for v in (d, q))
    d = np.where((kind == 6) & (at < 1e-3), 1e30, d)
    d = np.where((kind == 7) & late, np.nan, d)
    found = {"reference": reference, "wd": d, "wq": q, "share": np.where((kind == 8) & (t > 300), 0.4, 1.0)}
    found["temperature"] = 24 + np.cumsum(0.02 * rng.standard_normal(shape), 1)
    found["enable"] = np.where((kind == 9) & (t % 300 > 280), 0, 1)
    found["reset"] = ((at < 2e-3) & (kind > 4)).astype(int)
    return found


def few(count):
    return {name: values[:count] for name, values in hard_samples().items()}


FULL = Rig(
    timer=1e8, thermometer=True, voltage_slew=1e6, sensor=Sensor(0.98, 3.0, 1e-6), adc=Adc(12.0, 6.0, 1e6), dac=Dac(12.0, 400.0),
    inverter=Inverter(300.0, True),
)  # fmt: skip
LOOPS = {
    "pi": {},
    "pi-rig": {"rig": FULL},
    "pi-no-f0": {"source": SimpleNamespace(G=0.02, tau=TAU, f0=None)},
    "paper": {"method": "paper"},
    "pll-rig": {"method": "pll", "rig": FULL},
    "adaptive": {"method": "adaptive"},
    "adaptive-rig-3-samples": {"method": "adaptive", "rig": FULL, "latency": 3e-4},
}


def designed(source=PLATE, **given):
    """With a machine that a hundred samples bring to its end."""
    window = {} if source.f0 is None else {"frequency_window": (32000.0, 32600.0)}
    loop = controller.design(source, voltage_limit=150.0, **window, **given)
    quick = {"patience": 5.0, "ramp": loop.amplitude / 20, "limit": 400.0}
    machine = loop.machine
    if hasattr(machine, "d"):
        return dataclasses.replace(loop, machine=machine._replace(control=machine.control._replace(**quick)))
    return dataclasses.replace(loop, machine=machine._replace(**quick))


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_gives_the_same_bits_as_python(tmp_path, name, precision):
    loop = designed(**LOOPS[name])
    inputs = hard_samples()
    mine, theirs = in_arrays(loop, inputs, precision), in_c(loop, tmp_path, inputs, precision, "-O2")
    for output in mine.dtype.names:  # the same operations in the same order, not contracted: equal to the last bit
        np.testing.assert_array_equal(theirs[output], mine[output])
    V, fault, mode = mine["voltage"], mine["fault"], mine["mode"]
    assert np.ptp(V) > 100 and np.abs(V).max() <= 150.0
    assert set(np.unique(mode)) == set(range(len(MODES)))  # each was reached
    assert len(np.unique(fault)) >= 3 and ((fault > 0) == (mode == 5)).all()
    assert (V[(mode == 0) | (mode == 5)] == 0.0).all()
    if loop.f0 is not None:
        assert mine["frequency"].min() >= 32000.0 and mine["frequency"].max() <= 32600.0
    if "rig" in name:
        kept = np.abs(V) > 0  # what is made of the voltage is the voltage
        # half a code, and a rounding of single precision
        np.testing.assert_allclose(mine["code"][kept] * 400 / 2**11, V[kept], rtol=0, atol=0.5 * 400 / 2**11 * (1 + 1e-4))
        made = 4 / np.pi * 300.0 * np.sin(np.pi / 2 * mine["duty"].astype(float))
        np.testing.assert_allclose(made, V, rtol=0, atol=4 / np.pi * 300.0 * np.pi / 2 * 1e-4)  # the duty ratio is right to 1e-4
        # the tracker knows the timer's frequency to x^4 of itself, x = 1 % at the edge of the window, and single precision 4 mHz
        np.testing.assert_allclose(1e8 / mine["ticks"], mine["frequency"], rtol=2e-8 + (2e-7 if precision == "single" else 0))


def test_a_plain_float_gives_the_same_bits_as_an_array():
    """What needs neither numpy nor JAX."""
    for name in ("pi-rig", "adaptive-rig-3-samples"):
        loop = designed(**LOOPS[name])
        inputs = {n: v[:12, :250] for n, v in hard_samples().items()}
        mine = in_arrays(loop, inputs, "double")
        for i, row in enumerate(mine):
            state = loop.machine.init()
            for k, wanted in enumerate(row):
                now = {n: v[i, k].item() for n, v in inputs.items()}
                knobs = {"share": now["share"], "enable": now["enable"] != 0, "reset": now["reset"] != 0}
                W = complex(now["wd"], now["wq"])
                state, command, said = loop.machine.step(state, now["reference"], W, now["temperature"], **knobs)
                assert (*command, said.fault, said.mode) == tuple(wanted[n] for n in ("voltage", "frequency", "fault", "mode"))


@pytest.mark.parametrize("precision", ["double", "single"])
def test_no_sanitizer_finds_anything(tmp_path, precision):
    in_c(designed(**LOOPS["adaptive-rig-3-samples"]), tmp_path, few(80), precision, *SANITIZERS)


def test_single_precision_is_near_double():
    """Along a quiet start: rounding of 6e-8 in each of some fifty operations, which the contracting loop adds up about tau/T = 17
    times, on a voltage of gain Kp = 150 V/um: 2 um * 6e-8 * 50 * 17 * 150 = 15 mV; the frequency is put out to 2 mHz."""
    loop = designed()
    t = np.arange(300)
    inputs = {"reference": 1.8, "share": 1.0, "wd": 1.8 - 1.6 * np.exp(-t / 20), "wq": 0.01 * np.sin(t), "enable": 1, "reset": 0}
    inputs = {n: np.broadcast_to(v, (1, 300)) for n, v in inputs.items()}
    double, single = (in_arrays(loop, inputs, p) for p in ("double", "single"))
    assert np.ptp(double["voltage"]) > 50
    np.testing.assert_allclose(single["voltage"], double["voltage"], rtol=0, atol=0.015)
    np.testing.assert_allclose(single["frequency"], double["frequency"], rtol=0, atol=0.004)


def test_operations_are_few_and_counted():
    """5 us of a processor that does 100 million in a second, of the 100 us that a sample lasts at 10 kHz."""
    for name in LOOPS:
        counts = record(designed(**LOOPS[name]), "double").counts
        assert sum(counts.values()) < 500 and counts["/"] <= 1


def test_a_branch_on_a_value_is_refused():
    class Branches:
        def init(self):
            return (0.0,)

        def step(self, state, reference, *given, **knobs):
            return (1.0 if reference > 0 else 0.0,), None, None

    loop = dataclasses.replace(designed(), machine=Branches())
    with pytest.raises(TypeError, match="found a branch"):
        record(loop, "double")


def test_what_drives_a_bench_has_its_guard(tmp_path):
    with pytest.raises(ValueError, match="found a loop without its guard"):
        controller.export_c(controller.design(PLATE, guard=False), tmp_path / "dq_pi.h")


# --- faults ---------------------------------------------------------------------------------------------------------------------

T = 1e-4


def faulty(loop, spoilt, samples=1500, at=500, resonance=lambda k: 32300.0):
    """V, f, fault (samples,): the plate with noise of 1 %, whose reading is spoilt from sample `at` on."""
    rng = np.random.default_rng(0)
    state, W, pending, frequency, rows, last = loop.control.init(), 0j, 0.0, 32300.0, [], 0j
    for k in range(samples):
        told = W + complex(*(0.02 * rng.standard_normal(2)))
        told = spoilt(told, last) if k >= at else told
        last = told
        state, command, info = loop.control.step(state, 2.0, told)
        pole = -1 / TAU + 2j * math.pi * (resonance(k) - frequency)
        settled = -0.02 / TAU * pending / pole
        W = settled + (W - settled) * np.exp(pole * T)
        pending, frequency = command
        rows.append((*command, info.fault))
    return np.array(rows).T


REPLAYS = {
    "dead": (lambda told, last: 0j, 10e-3, {"dead"}),
    "missing": (lambda told, last: complex(math.nan, 0.0), 10e-3, {"missing"}),
    "stuck": (lambda told, last: last, 50e-3, {"stuck", "edge"}),
    "wrong sign of q": (lambda told, last: told.conjugate(), 50e-3, {"reversed"}),
}


@pytest.mark.parametrize("method", ["pi", "paper", "adaptive"])
@pytest.mark.parametrize("name", REPLAYS)
def test_a_fault_ends_the_drive(method, name):
    spoilt, within, expected = REPLAYS[name]
    loop = controller.design(PLATE, method=method, voltage_limit=350.0, frequency_window=(32100.0, 32500.0))
    V, f, fault = faulty(loop, spoilt)
    assert fault[499] == 0 and V[400:499].mean() == pytest.approx(100.0, rel=0.02)
    ends = 500 + round(within / T)
    assert (V[ends:] == 0.0).all() and (fault[ends:] == fault[-1]).all()  # latched
    assert FAULTS[int(fault[-1])] in expected
    assert np.abs(V).max() <= 350.0 and f.min() >= 32100.0 and f.max() <= 32500.0


def test_a_sound_bench_is_no_fault():
    for method in ("pi", "paper", "adaptive"):
        loop = controller.design(PLATE, method=method, voltage_limit=350.0, frequency_window=(32100.0, 32500.0))
        _, _, fault = faulty(loop, lambda told, last: told, samples=5000)
        assert (fault == 0).all()


@pytest.mark.parametrize("method", ["pi", "paper", "pll", "adaptive"])
def test_a_reversed_q_is_called_by_its_answer_and_a_chase_is_not(method):
    """In a window of 3 kHz, whose edge is far, though an observer may be there sooner than its answer is sure; a resonance that
    jumps by 80 Hz, and back, is what looks most like it."""
    loop = controller.design(PLATE, method=method, voltage_limit=350.0, frequency_window=(31000.0, 34000.0))
    V, _, fault = faulty(loop, REPLAYS["wrong sign of q"][0])
    assert FAULTS[int(fault[-1])] in ({"reversed", "edge"} if method == "adaptive" else {"reversed"}) and (V[1000:] == 0.0).all()
    _, f, fault = faulty(loop, lambda told, last: told, 5000, resonance=lambda k: 32260.0 + 80.0 * (k // 300 % 2))
    assert (fault == 0).all() and np.ptp(f[200:]) > 60.0


def test_too_large_an_amplitude_is_a_fault():
    loop = controller.design(PLATE, voltage_limit=100.0, frequency_window=(32100.0, 32500.0))
    _, _, fault = faulty(loop, lambda told, last: 2.6 + 0.1 * told)  # the voltage limit makes 2
    assert FAULTS[int(fault[-1])] == "above"


# --- texts ----------------------------------------------------------------------------------------------------------------------


def test_no_text_of_a_log_reaches_the_files(tmp_path):
    loop = dataclasses.replace(designed(), notes=('*/ #error "why"',), logs=('"*/ #error',))
    hostile = dataclasses.replace(loop, drive_unit='V */\n#include "/etc/passwd" \\', response_unit="µm?/")
    controller.export_c(hostile, tmp_path / "7-a.h")
    header, source = ((tmp_path / name).read_text(encoding="ascii") for name in ("7-a.h", "7-a.c"))
    assert header.count("#") == 4  # guard twice, one include, endif
    assert source.count("#") == 3 and source.count('"') == 2  # the header, math.h, and what says missing
    assert "why" not in header + source and '"' not in header and "\\" not in header + source and "?/" not in header + source
    assert header.count("/*") == header.count("*/")
    assert "#ifndef SYSID_7_A_H\n#define SYSID_7_A_H\n" in header
    for name in ('a".h', "é.h", "dq_pi.c"):
        with pytest.raises(ValueError, match="expected the name of a header that C can include"):
            controller.export_c(hostile, tmp_path / name)


def test_the_header_says_what_it_is_for(tmp_path):
    loop = dataclasses.replace(designed(), logs=("ab" * 32,), reference_temperature=24.0, warming=(-4.0, 8.0))
    controller.export_c(loop, tmp_path / "dq_pi.h")
    header = (tmp_path / "dq_pi.h").read_text(encoding="ascii")
    for said in ("log sha256 " + "ab" * 32, "temperature: 20 to 32 degC", "voltage: 150 drive-unit at most", "32000 to 32600 Hz"):
        assert said in header
    said = sum(int(n) for n in re.findall(r"(\d+) (?:additions|comparisons|multiplications|loads|divisions|floors)", header))
    steps = (record(loop, "double"), record_demodulator(loop, "double"))
    assert said == sum(sum(step.counts.values()) for step in steps)
    assert [len(step.lines) for step in steps] == [sum(step.counts.values()) for step in steps]  # a line an operation


@pytest.mark.parametrize("name", LOOPS)
def test_controller_json_is_strict_json(name):
    loop = designed(**LOOPS[name])
    content = controller.as_dict(loop)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["schema"] == 1 and content["voltage_limit"] == 150.0
    assert (content["tracker"] is None) == (loop.f0 is None)
    assert content["promise"]["disk_margin"] > 0.5
    assert content["notes"] == list(loop.notes)
