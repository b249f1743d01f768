"""The exported C computes the bits that Python computes; the guard ends the drive; controller.json is strict
JSON."""

import dataclasses
import json
import math
import shutil
import subprocess
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import sampled
from replay import KIND, PLAIN, SANITIZERS, WARNINGS, compiled, in_arrays, in_c, run

import controller
from controller import Rig, Sensor
from controller.actuator import Adc, Dac, Dds, Inverter
from controller.export import parameters
from controller.guard import FAULTS
from controller.machine import MODES, TASKS
from controller.scalar import typed
from controller.source import Timer

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
SEQUENCES, SAMPLES = 200, 600  # a million samples: benchmarks/bits.py


@cache
def hard_samples(sequences=SEQUENCES, seed=4):
    """120 000 samples in which a controller first comes to run, and then saturates, rests at zero, sticks,
    misses, drops to zero, jumps, overflows, clips, is told nonsense, is switched off and reset; three of
    fourteen are tasks of commissioning."""
    rng = np.random.default_rng(seed)
    shape, t = (sequences, SAMPLES), np.arange(SAMPLES)
    reference = np.where((t > 140) & (t % 400 < 80), 0.0, 1.8 + 0.5 * rng.standard_normal(shape) * (t > 140))
    noise = rng.standard_normal((2, *shape))
    start = np.where(t < 40, 0.19, 1.8)
    d = np.where(t < 140, start, 1.9 + 0.4 * noise[0])
    q = np.where(t < 140, 0.05 * start, 0.8 * noise[1])
    kind = np.arange(sequences)[:, None] % 14
    at, late = rng.random(shape), t > 400
    d = np.where((kind == 1) & (at < 0.02), np.nan, d)
    q = np.where((kind == 2) & (at < 0.02), np.inf, q)
    reference = np.where((kind == 3) & (at < 0.02), np.nan, reference)
    d, q = (np.where((kind == 4) & late, v[:, 400:401], v) for v in (d, q))
    d, q = (np.where((kind == 5) & late, 0.0, v) for v in (d, q))
    d = np.where((kind == 6) & (at < 1e-3), 1e30, d)
    d = np.where((kind == 7) & late, np.nan, d)
    found = {"reference": reference, "wd": d, "wq": q}
    found["share"] = np.where((kind == 8) & (t > 300), np.where(at < 0.01, np.nan, 0.4), 1.0)
    found["temperature"] = (
        24 + np.cumsum(0.02 * rng.standard_normal(shape), 1) + np.where(at < 5e-3, np.nan, 0.0)
    )
    found["enable"] = np.where(((kind == 9) | (kind == 6)) & (t % 300 > 280), 0, 1)
    found["reset"] = ((at < 2e-2) & (kind > 4)).astype(int)
    found["clipped"] = ((kind == 10) & (t > 350)).astype(int)
    found["task"] = np.where(kind >= 11, kind - 10, 0) + np.where((kind == 0) & (at > 0.99), 7, 0)
    found["voltage"] = np.where(kind == 12, 80 + 20 * noise[0], 60.0)
    # of the sensor, in a step: half of them or so, but for some that are lost, or whose steps are
    few, many = (kind == 2) & late, (kind == 8) & (at > 0.998)
    found["samples"] = np.cumsum(np.where(few, 10, np.where(many, 2000, 60)), 1)
    return found | {"offset": np.where(kind == 13, -100.0, np.where(kind == 12, 3 * noise[1], 0.0))}


FULL = Rig(
    timer=1e8, thermometer=True, voltage_slew=1e6, sensor=Sensor(0.98, 3.0, 1e-6), adc=Adc(12.0, 6.0, 1e6), dac=Dac(12.0, 400.0),
    inverter=Inverter(300.0, True), drive_update=4e6,
)  # fmt: skip
LOOPS = {
    "pi": {},
    "pi-rig": {"rig": FULL},
    "pi-no-f0": {"source": SimpleNamespace(G=-0.02, tau=TAU, f0=None)},
    "pi-negative": {"source": SimpleNamespace(G=-0.02, tau=TAU, f0=32300.0, k_T=-10.16)},
    "paper": {"method": "paper"},
    "pll-rig": {"method": "pll", "rig": FULL},
    "adaptive": {"method": "adaptive"},
    "adaptive-rig-3-samples": {"method": "adaptive", "rig": FULL, "latency": 3e-4},
}


def inner(loop, **changes):
    """The loop with another machine, behind its sensor's correction or not."""
    machine = loop.machine
    if hasattr(machine, "d"):
        return dataclasses.replace(
            loop, machine=machine._replace(control=machine.control._replace(**changes))
        )
    return dataclasses.replace(loop, machine=machine._replace(**changes))


def designed(source=PLATE, **given):
    """With a machine that a hundred samples bring to its end, and that takes much for a sound plate."""
    window = {} if source.f0 is None else {"frequency_window": (32000.0, 32600.0)}
    loop = controller.design(source, **{"voltage_limit": 150.0, **window, **given})
    machine = loop.machine.control if hasattr(loop.machine, "d") else loop.machine
    quick = {"patience": 5.0, "ramp": loop.amplitude / 20, "limit": 400.0, "fits": (0.0, 1e3, 1e3)}
    quick |= {"headroom": 1.5, "heaviest": 5.0}
    guard = machine.control._replace(ceiling=4.0, jump=2.0 * loop.amplitude)
    follows, swings = (150.0, 200.0) if loop.method == "adaptive" else (90.0, 12.0)
    return inner(loop, control=guard, follows=follows, swings=swings, **quick)


@pytest.mark.parametrize("name", sampled(LOOPS))
@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_gives_the_same_bits_as_python(tmp_path, name, precision):
    loop = designed(**LOOPS[name])
    inputs = hard_samples()
    mine, theirs = in_arrays(loop, inputs, precision), in_c(loop, tmp_path, inputs, precision, "-O2")
    same = ["voltage", "fault", "mode", "held", *(["frequency"] if loop.f0 else [])]
    for output in same:  # the same operations in the same order, not contracted: equal to the last bit
        np.testing.assert_array_equal(theirs[output], mine[output])
    V, fault, mode = mine["voltage"], mine["fault"], mine["mode"]
    assert np.ptp(V) > 100 and np.abs(V).max() <= 150.0
    assert set(np.unique(mode)) == set(range(len(MODES)))  # each was reached
    assert len(np.unique(fault)) >= 5 and ((fault > 0) == (mode == 5)).all()
    assert (V[(mode == 0) | (mode == 5)] == 0.0).all()
    if loop.f0 is not None:
        assert mine["frequency"].min() >= 32000.0 and mine["frequency"].max() <= 32600.0


def test_a_plain_float_gives_the_same_bits_as_an_array():
    """What needs neither numpy nor JAX."""
    for name in ("pi-rig", "adaptive-rig-3-samples"):
        loop = designed(**LOOPS[name])
        inputs = {n: v[:14, :250] for n, v in hard_samples().items()}
        arrived = np.diff(inputs["samples"], prepend=0)
        mine = in_arrays(loop, inputs, "double")
        for i, row in enumerate(mine):
            state = loop.machine.init()
            for k, wanted in enumerate(row):
                now = {n: v[i, k].item() for n, v in inputs.items()}
                knobs = {n: now[n] != 0 for n in ("enable", "reset", "clipped")} | {
                    n: now[n] for n in ("share", "voltage", "offset")
                }
                W, task = complex(now["wd"], now["wq"]), float(now["task"])
                state, command, said = loop.machine.step(
                    state,
                    now["reference"],
                    W,
                    now["temperature"],
                    task=task,
                    arrived=float(arrived[i, k]),
                    **knobs,
                )
                assert (*command, said.fault, said.mode) == tuple(
                    wanted[n] for n in ("voltage", "frequency", "fault", "mode")
                )


@pytest.mark.parametrize("precision", ["double", "single"])
def test_no_sanitizer_finds_anything(tmp_path, precision):
    inputs = {name: values[:84] for name, values in hard_samples().items()}
    name = {"double": "adaptive-rig-3-samples", "single": "pi-rig"}[precision]
    in_c(designed(**LOOPS[name]), tmp_path, inputs, precision, *SANITIZERS)


def test_single_precision_is_near_double():
    """Along a quiet start: rounding of 6e-8 in each of some fifty operations, which the contracting loop adds
    up about tau/T = 17 times, on a voltage of gain Kp = 150 V/um: 2 um * 6e-8 * 50 * 17 * 150 = 15 mV; the
    frequency is put out to 2 mHz."""
    loop = designed()
    t = np.arange(300)
    inputs = {"reference": 1.8, "wd": 1.8 - 1.6 * np.exp(-t / 20), "wq": 0.01 * np.sin(t)}
    inputs = {n: np.broadcast_to(v, (1, 300)) for n, v in inputs.items()}
    double, single = (in_arrays(loop, inputs, p) for p in ("double", "single"))
    assert np.ptp(double["voltage"]) > 50
    np.testing.assert_allclose(single["voltage"], double["voltage"], rtol=0, atol=0.015)
    np.testing.assert_allclose(single["frequency"], double["frequency"], rtol=0, atol=0.004)


def test_what_drives_a_bench_has_its_guard(tmp_path):
    with pytest.raises(ValueError, match="found a loop without its guard"):
        controller.export_c(controller.design(PLATE, guard=False), tmp_path / "dq_pi.h")


# --- parameters
# -----------------------------------------------------------------------------------------------------------------


def program(body, before=""):
    return f"""#include <stdio.h>
#include <string.h>
#include "dq_pi_plate.h"
{before}
int main(void)
{{
    static dq_state s;
    static dq_input in;
    static dq_demodulator sensor;
    dq_params p = DQ_PLATE_PARAMS;
    (void)in; (void)sensor; (void)s;
{body}
    return 0;
}}
"""


@pytest.mark.parametrize("precision", ["double", "single"])
def test_each_parameter_is_where_its_name_is(tmp_path, precision):
    loop = designed(**LOOPS["adaptive-rig-3-samples"])
    wanted = parameters(loop, precision)
    lines = "\n".join(f'    printf("%.17g\\n", (double)p.{name});' for name in wanted)
    said = run(compiled(loop, tmp_path, precision, program(lines)), b"").split()
    assert [float(v) for v in said] == [float(v) for v in wanted.values()]
    assert len({float(v) for v in said}) > 40  # few of them are alike


BAD = {
    "layout": ("p.layout = 0xffffffffu", "LAYOUT"), "gain": ("p.gain = 0", "PLATE"),
    "a NaN": ("p.kp = (dq_real)NAN", "AMPLITUDE_LOOP"),
    "sign of kp": ("p.kp = -p.kp", "AMPLITUDE_LOOP"), "f0": ("p.f0 = 40000", "LIMITS"),
    "limit": ("p.voltage_highest = -1", "LIMITS"),
    "every": ("p.every = 0", "TRACKER"), "patience": ("p.patience = 0", "GUARD"), "samples": ("p.samples = -1", "GUARD"), "find": ("p.find = p.amplitude * 2", "START"),
    "erased flash": ("memset(&p, 0xff, sizeof p)", "LAYOUT"), "share": ("p.demodulator_share = 2", "DEMODULATOR"),
}  # fmt: skip


def test_parameters_are_checked_when_they_are_set(tmp_path):
    """What cannot be is refused: at first the loop stays in a fault that no reset ends; later it goes on as
    it was."""
    lines = ["    const dq_params good = p;", "    dq_output out;", "    int k;"]
    for change, said in BAD.values():
        lines.append(f"    p = good; {change}; if (dq_check_params(&p) != DQ_PARAMS_{said}) return __LINE__;")
        lines.append("    if (dq_init(&s, &p) == DQ_PARAMS_OK) return __LINE__;")
        lines.append("    in.reference = 1; in.enable = 0; in.reset = 1; dq_step(&s, &in); in.enable = 1;")
        lines.append("    for (k = 0; k < 30; k++) { out = dq_step(&s, &in);")
        lines.append(
            "        if (out.fault != DQ_FAULT_PARAMETERS || out.voltage > 0 || out.voltage < 0) return"
            " __LINE__; }"
        )
        lines.append(
            "    if (dq_init(&s, &good) != DQ_PARAMS_OK || dq_set(&s, &p) == DQ_PARAMS_OK) return __LINE__;"
        )
        lines.append("    if (memcmp(&s.params, &good, sizeof good) != 0) return __LINE__;")
    lines.append("    p = good; p.kp *= 2; p.ki *= 2; p.voltage_highest /= 2; p.voltage_lowest /= 2;")
    lines.append("    return dq_set(&s, &p) != DQ_PARAMS_OK || s.params.kp < good.kp;")
    main = program("\n".join(lines)).replace("#include <stdio.h>", "#include <math.h>\n#include <stdio.h>")
    run(compiled(designed(), tmp_path, "single", main), b"")


def test_no_count_grows_while_a_sound_loop_runs(tmp_path):
    """At 10 kHz 2^31 samples are 60 hours: a number that goes up in each of them overflows then."""
    counts = "near waited off swung missing dead above edge turned clips"
    body = """
    int k;
    if (dq_init(&s, &p) != DQ_PARAMS_OK) return 1;
    in.reference = p.amplitude; in.share = 1; in.temperature = 24; in.enable = 1; s.mode = DQ_MODE_RUN;
    s.integral = s.output = s.mean_voltage = s.voltage = p.amplitude / p.gain;
    s.mean_d = s.mean_asked = p.amplitude;
    for (k = 0; k < 1000; k++) {
        in.wd = p.amplitude * ((dq_real)1 + (dq_real)0.001 * (dq_real)(k % 3));
        if (dq_step(&s, &in).mode != DQ_MODE_RUN)
            return 1;
    }
""" + "\n".join(f"    if (s.{name} > 3) return __LINE__;" for name in counts.split())  # fmt: skip
    run(compiled(designed(), tmp_path, "double", program(body), *SANITIZERS), b"")


@pytest.mark.parametrize("precision", ["double", "single"])
def test_words_of_a_rig(tmp_path, precision):
    """Converter, duty ratio, timer and accumulator beside what they stand for."""
    kind, rng = KIND[precision], np.random.default_rng(0)
    given = np.stack([rng.uniform(-150, 150, 500), rng.uniform(-290, 290, 500)], 1).astype(kind)
    body = """
    static const dq_real duty[] = DQ_PLATE_DUTY;
    dq_real given[2];
    while (fread(given, sizeof given, 1, stdin) == 1)
        printf("%d %.9g %u %u\\n", (int)dq_dac_code(given[0], DQ_PLATE_DAC_BITS, DQ_PLATE_DAC_FULL_SCALE),
            (double)dq_duty(given[0], DQ_PLATE_VOLTAGE_LIMIT, duty, DQ_PLATE_DUTY_TERMS), (unsigned)dq_timer_ticks(&p, given[1]),
            (unsigned)dq_dds_increment(given[1], BASEu, (dq_real)FRACTION, (dq_real)4294.967296));
""".replace("\\\\n", "\\n")
    loop, dds = designed(**LOOPS["pi-rig"]), Dds(1e6, 32300.0)
    main = program(body).replace("BASE", str(dds.base)).replace("FRACTION", f"{dds.fraction:.9g}")
    said = run(compiled(loop, tmp_path, precision, main, "-Wno-conversion"), given.tobytes())
    code, duty, ticks, increment = np.array([line.split() for line in said.decode().splitlines()], float).T
    V, f = given.astype(float).T
    np.testing.assert_allclose(code * 400 / 2**11, V, rtol=0, atol=0.5 * 400 / 2**11 * (1 + 1e-4))
    made = 4 / np.pi * 300.0 * np.sin(np.pi / 2 * duty)
    np.testing.assert_allclose(
        made, V, rtol=0, atol=4 / np.pi * 300.0 * np.pi / 2 * 1e-4
    )  # the duty ratio is right to 1e-4
    # half a tick, and the series at 1 % of the frequency: 1e-8 of it
    assert np.abs(1e8 / ticks - 32300 - f).max() < 0.5 * 32600**2 / 1e8 * 1.01
    # to a unit, and what single precision leaves of an offset of 290 Hz times 4295
    assert np.abs(increment - (32300 + f) / 1e6 * 2**32).max() < (1.01 if precision == "double" else 1.3)
    timer = typed(Timer.of(1e8, 32300.0), kind)
    np.testing.assert_array_equal(
        ticks, timer.periods + timer.ticks(given[:, 1], SimpleNamespace(floor=np.floor))
    )


# --- what it is compiled with
# ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_and_cplusplus_compile_without_a_word_and_link(tmp_path, precision):
    """The source as C; the source as C++; a C++ program with the source in C, and two plates with laws of two
    prefixes."""
    if shutil.which("gcc") is None or shutil.which("g++") is None:
        pytest.skip("no gcc and g++")
    one, other = designed(), designed(**LOOPS["adaptive"])
    controller.export_c(one, tmp_path / "left.h", precision, prefix="left")
    controller.export_c(other, tmp_path / "right.h", precision, prefix="right")
    main = '#include "left_plate.h"\n#include "right_plate.h"\nstatic left_state a;\nstatic right_state b;\nint main()\n{\n'
    main += "    const left_params p = LEFT_PLATE_PARAMS;\n    const right_params q = RIGHT_PLATE_PARAMS;\n"
    main += "    return left_init(&a, &p) != LEFT_PARAMS_OK || right_init(&b, &q) != RIGHT_PARAMS_OK || left_self_test();\n}\n"
    (tmp_path / "main.cc").write_text(main)

    def built(compiler, *files):
        done = subprocess.run(
            [compiler, *files, *WARNINGS, "-O2", "-ffp-contract=off"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert (done.returncode, done.stderr) == (0, "")

    for name in ("left", "right"):
        built("gcc", "-std=c99", "-c", f"{name}.c")
    built("g++", "-x", "c++", "-c", "left.c", "-o", "left-cc.o")
    built("g++", "main.cc", "left.o", "right.o", "-o", "both")
    assert subprocess.run([tmp_path / "both"]).returncode == 0
    symbols = subprocess.run(
        ["nm", "-u", "left.o"], cwd=tmp_path, capture_output=True, text=True
    ).stdout.split()
    assert set(symbols) <= {
        "U",
        "memcpy",
        "memset",
        "memmove",
        "_GLOBAL_OFFSET_TABLE_",
    }  # no library but what a compiler needs itself


def test_cppcheck_has_nothing_to_say(tmp_path):
    if shutil.which("cppcheck") is None:
        pytest.skip("no cppcheck")
    controller.export_c(designed(), tmp_path / "dq_pi.h")
    for double in (0, 1):
        command = [
            "cppcheck",
            "-q",
            "--enable=warning,style,performance,portability",
            "--std=c99",
            f"-DDQ_DOUBLE={double}",
            "dq_pi.c",
        ]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.stdout + done.stderr == ""


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_fast_math_is_refused(tmp_path, flag):
    compiler = shutil.which("gcc") or pytest.skip("no gcc")
    controller.export_c(designed(), tmp_path / "dq_pi.h")
    done = subprocess.run(
        [compiler, *PLAIN, flag, "-c", "dq_pi.c"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode != 0 and "compile without -ffast-math" in done.stderr


def test_names_are_those_of_c():
    """Python and C say the same of modes, tasks and faults."""
    from importlib.resources import files

    text = (files("controller") / "c" / "dq.h").read_text(encoding="ascii")
    for kind, names in (("MODE", MODES), ("FAULT", FAULTS), ("TASK", TASKS)):
        for code, name in enumerate(names):
            assert f"DQ_{kind}_{name.upper().replace(' ', '_')} = {code}" in text


# --- faults
# ---------------------------------------------------------------------------------------------------------------------

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
        loop = controller.design(
            PLATE, method=method, voltage_limit=350.0, frequency_window=(32100.0, 32500.0)
        )
        _, _, fault = faulty(loop, lambda told, last: told, samples=5000)
        assert (fault == 0).all()


@pytest.mark.parametrize("method", ["pi", "paper", "pll", "adaptive"])
def test_a_reversed_q_is_called_by_its_answer_and_a_chase_is_not(method):
    """In a window of 3 kHz, whose edge is far, though an observer may be there sooner than its answer is
    sure; a resonance that jumps by 80 Hz, and back, is what looks most like it."""
    loop = controller.design(PLATE, method=method, voltage_limit=350.0, frequency_window=(31000.0, 34000.0))
    V, _, fault = faulty(loop, REPLAYS["wrong sign of q"][0])
    assert (
        FAULTS[int(fault[-1])] in ({"reversed", "edge"} if method == "adaptive" else {"reversed"})
        and (V[1000:] == 0.0).all()
    )
    _, f, fault = faulty(
        loop, lambda told, last: told, 5000, resonance=lambda k: 32260.0 + 80.0 * (k // 300 % 2)
    )
    assert (fault == 0).all() and np.ptp(f[200:]) > 60.0


def test_too_large_an_amplitude_is_a_fault():
    loop = controller.design(PLATE, voltage_limit=100.0, frequency_window=(32100.0, 32500.0))
    _, _, fault = faulty(loop, lambda told, last: 2.95 + 0.1 * told)  # 1.35 times 2 is allowed
    assert FAULTS[int(fault[-1])] == "above"


# --- texts
# ----------------------------------------------------------------------------------------------------------------------


def test_no_text_of_a_log_reaches_the_files(tmp_path):
    loop = dataclasses.replace(designed(), notes=('*/ #error "why"',), logs=('"*/ #error',))
    hostile = dataclasses.replace(loop, drive_unit='V */\n#include "/etc/passwd" \\', response_unit="µm?/")
    controller.export_c(hostile, tmp_path / "7-a.h")
    header = (tmp_path / "7-a_plate.h").read_text(encoding="ascii")
    assert header.count("#include") == 1 and '#include "7-a.h"' in header and "#error" not in header
    assert "why" not in header and "um?/" not in header
    assert header.count("/*") == header.count("*/") and "?/" not in header
    assert "#ifndef SYSID_7_A_PLATE_H\n#define SYSID_7_A_PLATE_H\n" in header
    assert "#ifndef SYSID_7_A_H\n#define SYSID_7_A_H\n" in (tmp_path / "7-a.h").read_text(encoding="ascii")
    for name in ('a".h', "é.h", "dq_pi.c"):
        with pytest.raises(ValueError, match="expected the name of a header that C can include"):
            controller.export_c(hostile, tmp_path / name)
    with pytest.raises(ValueError, match="found the prefix '7a', expected small letters"):
        controller.export_c(hostile, tmp_path / "a.h", prefix="7a")


def test_the_header_says_what_it_is_for(tmp_path):
    loop = dataclasses.replace(designed(), logs=("ab" * 32,), reference_temperature=24.0, warming=(-4.0, 8.0))
    controller.export_c(loop, tmp_path / "dq_pi.h")
    header = (tmp_path / "dq_pi_plate.h").read_text(encoding="ascii")
    for said in (
        *(
            "log sha256 " + "ab" * 32,
            "temperature: 20 to 32 degC",
            "voltage: 150 drive-unit at most",
            "32000 to 32600 Hz",
        ),
        *(
            "MIT licence",
            "Generated by sysid",
            "find: ",
            "run, and the tasks in open loop: 150 drive-unit, 3 response-unit",
        ),
        *("A sensor that reads low", "DQ_PLATE_F0 32300.0"),
    ):
        assert said in header


@pytest.mark.parametrize("name", LOOPS)
def test_controller_json_is_strict_json(name):
    loop = designed(**LOOPS[name])
    content = controller.as_dict(loop)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["schema"] == 1 and content["voltage_limit"] == 150.0
    assert (content["tracker"] is None) == (loop.f0 is None)
    assert content["promise"]["disk_margin"] > 0.5
    assert content["notes"] == list(loop.notes)
