"""The C header computes the bits that Python computes; the guard ends the drive; controller.json is strict JSON."""

import dataclasses
import json
import math
import shutil
import subprocess
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import controller
from controller import Rig, Sensor
from controller.export import record
from controller.guard import FAULTS

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
SEQUENCES, SAMPLES = 1000, 1000
FEW = 160  # sequences, a multiple of their kinds, where a million samples are not needed

MAIN_C = """\
#include <stdio.h>
#include "dq_pi.h"
int main(void)
{
    dq_real in[INPUTS];
    long k = 0;
    dq_state s;
    dq_init(&s);
    while (fread(in, sizeof in, 1, stdin) == 1) {
        if (k++ % SAMPLES == 0)
            dq_init(&s);
        dq_output out = dq_step(&s, ARGUMENTS);
        if (fwrite(&out, sizeof out, 1, stdout) != 1)
            return 1;
    }
    return 0;
}
"""
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror", "-ffp-contract=off"]


def replay(loop, folder, inputs, precision, *flags):
    """(sequences, samples, outputs) of the compiled header for inputs (sequences, samples, reference and the rest)."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    controller.export_c(loop, folder / "dq_pi.h", precision)
    (folder / "main.c").write_text(MAIN_C)
    n = inputs.shape[-1]
    says = [f"-DINPUTS={n}", f"-DSAMPLES={inputs.shape[1]}", f"-DARGUMENTS={','.join(f'in[{i}]' for i in range(n))}"]
    subprocess.run([compiler, *WARNINGS, *flags, *says, "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
    kind = np.float64 if precision == "double" else np.float32
    done = subprocess.run([folder / "main"], input=inputs.astype(kind).tobytes(), capture_output=True, check=True)
    assert not done.stderr
    return np.frombuffer(done.stdout, kind).reshape(*inputs.shape[:2], -1)


def in_python(loop, inputs, kind):
    """The same by the step in arrays of `kind`, one element for each sequence."""
    inputs = inputs.astype(kind)

    def full(value):
        if value is None:
            return None
        if isinstance(value, tuple):
            return type(value)(*map(full, value)) if hasattr(value, "_fields") else tuple(map(full, value))
        return np.full(len(inputs), value, kind)

    def where(condition, yes, no):  # of two plain numbers numpy makes a double
        found = np.where(condition, yes, no)
        return found if found.dtype == bool else found.astype(kind)

    xp = SimpleNamespace(where=where, isfinite=np.isfinite, logical_not=np.logical_not, floor=np.floor)
    state, rows = full(loop.control.init()), []
    with np.errstate(invalid="ignore", over="ignore"):
        for k in range(inputs.shape[1]):
            reference, d, q, *temperature = inputs[:, k].T
            W = SimpleNamespace(real=d, imag=q)
            state, command, info = loop.control.step(state, reference, W, *temperature or (None,), xp)
            fault = [info.fault] if hasattr(info, "fault") else []
            found = [v for v in (*command, *fault) if v is not None]
            assert all(v.dtype == kind for v in found)
            rows.append(np.stack(found, -1))
    return np.stack(rows, 1)


@cache
def hard_samples(temperature):
    """A million samples that saturate, rest at zero, stick, miss, drop to zero, jump and overflow."""
    rng = np.random.default_rng(4)
    shape = (SEQUENCES, SAMPLES)
    reference = np.where(np.arange(SAMPLES) % 400 < 80, 0.0, 2.0 + 0.5 * rng.standard_normal(shape))
    d, q = 1.9 + 0.4 * rng.standard_normal(shape), 0.8 * rng.standard_normal(shape)
    kind = np.arange(SEQUENCES)[:, None] % 8
    at = rng.random(shape)
    d = np.where((kind == 1) & (at < 0.02), np.nan, d)
    q = np.where((kind == 2) & (at < 0.02), np.inf, q)
    reference = np.where((kind == 3) & (at < 0.02), np.nan, reference)
    late = np.arange(SAMPLES) > 500
    d, q = (np.where((kind == 4) & late, v[:, 500:501], v) for v in (d, q))
    d, q = (np.where((kind == 5) & late, 0.0, v) for v in (d, q))
    d = np.where((kind == 6) & (at < 1e-3), 1e30, d)
    d = np.where((kind == 7) & late, np.nan, d)
    rest = [24 + np.cumsum(0.02 * rng.standard_normal(shape), 1)] if temperature else []
    return np.stack([reference, d, q, *rest], -1)


FULL = Rig(frequency_step=10.4, thermometer=True, voltage_slew=1e6, sensor=Sensor(0.98, 3.0, 1e-6))
LOOPS = {
    "pi": {},
    "pi-rig": {"rig": FULL},
    "pi-no-f0": {"source": SimpleNamespace(G=0.02, tau=TAU, f0=None)},
    "paper": {"method": "paper"},
    "adaptive": {"method": "adaptive"},
    "adaptive-rig-3-samples": {"method": "adaptive", "rig": FULL, "latency": 3e-4},
    "unguarded": {"guard": False},
}


def designed(source=PLATE, **given):
    window = {} if source.f0 is None else {"frequency_window": (32000.0, 32600.0)}
    return controller.design(source, voltage_limit=150.0, **window, **given)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_gives_the_same_bits_as_python(tmp_path, name, precision):
    loop = designed(**LOOPS[name])
    inputs = hard_samples(loop.rig.thermometer)[: None if "rig" in name else FEW]
    mine = in_python(loop, inputs, np.float64 if precision == "double" else np.float32)
    theirs = replay(loop, tmp_path, inputs, precision, "-O2")
    # the same operations in the same order, not contracted: equal to the last bit
    np.testing.assert_array_equal(theirs, mine)
    assert np.ptp(mine[..., 0]) > 100 and np.abs(mine[..., 0]).max() <= 150.0
    if loop.f0 is not None and name != "unguarded":
        assert mine[..., 1].min() >= 32000.0 and mine[..., 1].max() <= 32600.0
        assert len(np.unique(mine[..., 2])) >= 3  # more than one kind of fault
        assert (mine[..., 0][mine[..., 2] > 0] == 0.0).all()


def test_a_plain_float_gives_the_same_bits_as_an_array():
    """What needs neither numpy nor JAX."""
    for name in ("pi-rig", "adaptive-rig-3-samples"):
        loop = designed(**LOOPS[name])
        inputs = hard_samples(True)[:16, 300:700]
        mine = in_python(loop, inputs, np.float64)
        for sequence, rows in zip(inputs, mine, strict=True):
            state = loop.control.init()
            for (reference, d, q, temperature), row in zip(sequence.tolist(), rows, strict=True):
                state, command, info = loop.control.step(state, reference, complex(d, q), temperature)
                assert [*command, info.fault] == row.tolist()


@pytest.mark.parametrize("precision", ["double", "single"])
def test_no_sanitizer_finds_anything(tmp_path, precision):
    loop = designed(**LOOPS["adaptive-rig-3-samples"])
    flags = ["-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    replay(loop, tmp_path, hard_samples(True)[:80], precision, *flags)


def test_single_precision_is_near_double():
    """Along a quiet start: rounding of 6e-8 in each of some fifty operations, which the contracting loop adds up about tau/T = 17
    times, on a voltage of gain Kp = 150 V/um: 2 um * 6e-8 * 50 * 17 * 150 = 15 mV; the frequency is stored to 2 mHz."""
    loop = designed()
    inputs = np.stack(np.broadcast_arrays(2.0, 2 - 2 * np.exp(-np.arange(300) / 5), 0.01 * np.sin(np.arange(300))), -1)[None]
    double, single = in_python(loop, inputs, np.float64), in_python(loop, inputs, np.float32)
    np.testing.assert_allclose(single[..., 0], double[..., 0], rtol=0, atol=0.015)
    np.testing.assert_allclose(single[..., 1], double[..., 1], rtol=0, atol=0.002 * 30)


def test_operations_are_few_and_counted():
    for name in LOOPS:
        counts = record(designed(**LOOPS[name])).counts
        assert sum(counts.values()) < 300 and counts["/"] <= 1


def test_a_branch_on_a_value_is_refused():
    class Branches:
        def init(self):
            return (0.0,)

        def step(self, state, reference, W, temperature, xp):
            return (1.0 if reference > 0 else 0.0,), None, None

    loop = dataclasses.replace(designed(), control=Branches())
    with pytest.raises(TypeError, match="found a branch"):
        record(loop)


# --- faults ---------------------------------------------------------------------------------------------------------------------

T = 1e-4


def faulty(loop, spoilt, samples=1500, at=500):
    """V, f, fault (samples,): the plate with noise of 1 %, whose reading is spoilt from sample `at` on."""
    rng = np.random.default_rng(0)
    state, W, pending, frequency, rows, last = loop.control.init(), 0j, 0.0, 32300.0, [], 0j
    for k in range(samples):
        told = W + complex(*(0.02 * rng.standard_normal(2)))
        told = spoilt(told, last) if k >= at else told
        last = told
        state, command, info = loop.control.step(state, 2.0, told)
        pole = -1 / TAU + 2j * math.pi * (32300.0 - frequency)
        settled = -0.02 / TAU * pending / pole
        W = settled + (W - settled) * np.exp(pole * T)
        pending, frequency = command
        rows.append((*command, info.fault))
    return np.array(rows).T


REPLAYS = {
    "dead": (lambda told, last: 0j, 10e-3, {"dead"}),
    "missing": (lambda told, last: complex(math.nan, 0.0), 10e-3, {"missing"}),
    "stuck": (lambda told, last: last, 50e-3, {"stuck", "edge"}),
    "wrong sign of q": (lambda told, last: told.conjugate(), 50e-3, {"edge"}),
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


def test_too_large_an_amplitude_is_a_fault():
    loop = controller.design(PLATE, voltage_limit=100.0, frequency_window=(32100.0, 32500.0))
    _, _, fault = faulty(loop, lambda told, last: 2.6 + 0.1 * told)  # the voltage limit makes 2
    assert FAULTS[int(fault[-1])] == "above"


# --- texts ----------------------------------------------------------------------------------------------------------------------


def test_no_text_of_a_log_reaches_the_header(tmp_path):
    loop = dataclasses.replace(designed(), notes=('*/ #error "why"',), logs=('"*/ #error',))
    hostile = dataclasses.replace(loop, drive_unit='V */\n#include "/etc/passwd" \\', response_unit="µm?/")
    path = tmp_path / "7-é#.h"
    controller.export_c(hostile, path)
    text = path.read_text(encoding="ascii")
    assert text.count("#") == 5  # guard twice, one include, one define, endif
    assert "why" not in text and '"' not in text and "\\" not in text and "?/" not in text
    assert text.count("/*") == text.count("*/")
    assert "#ifndef SYSID_7_H\n#define SYSID_7_H\n" in text


@pytest.mark.parametrize("name", LOOPS)
def test_controller_json_is_strict_json(name):
    loop = designed(**LOOPS[name])
    content = controller.as_dict(loop)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["schema"] == 1 and content["voltage_limit"] == 150.0
    assert (content["tracker"] is None) == (loop.f0 is None)
    assert content["promise"]["disk_margin"] > 0.5
    assert content["notes"] == list(loop.notes)
