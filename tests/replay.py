"""The exported C compiled and fed with a binary log, and the same steps in Python arrays."""

import shutil
import subprocess
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

import controller
from controller.export import WHOLE
from controller.recording import measures_temperature, record, words

KIND = {"double": np.float64, "single": np.float32, "q31": np.int32, "q15": np.int16}
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror", "-ffp-contract=off"]
SANITIZERS = ["-O0", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]

STEP_C = """\
#include <stdio.h>
#include "dq_pi.h"
int main(void)
{
    dq_input in;
    dq_state s;
    long k = 0;
    while (fread(&in, sizeof in, 1, stdin) == 1) {
        dq_output out;
        if (k++ % SAMPLES == 0)
            dq_init(&s);
        out = dq_step(&s, &in);
        if (fwrite(&out, sizeof out, 1, stdout) != 1)
            return 1;
    }
    return 0;
}
"""
DEMODULATE_C = """\
#include <stdio.h>
#include "dq_pi.h"
struct sample { SAMPLE value; uint32_t phase; };
int main(void)
{
    struct sample in;
    dq_demodulator s;
    long k = 0;
    if (dq_self_test() != 0)
        return 2;
    while (fread(&in, sizeof in, 1, stdin) == 1) {
        dq_response out;
        if (k++ % SAMPLES == 0)
            dq_demodulator_init(&s);
        out = dq_demodulate(&s, in.value, in.phase);
        if (fwrite(&out, sizeof out, 1, stdout) != 1)
            return 1;
    }
    return 0;
}
"""


def compiled(loop, folder, precision, main, *flags):
    """The program that `main` makes of the export."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    controller.export_c(loop, folder / "dq_pi.h", precision)
    (folder / "main.c").write_text(main)
    subprocess.run([compiler, *WARNINGS, *flags, "main.c", "dq_pi.c", "-o", "main"], cwd=folder, check=True)  # no library but C's
    return folder / "main"


def run(program, data):
    done = subprocess.run([program], input=data, capture_output=True, check=True)
    assert not done.stderr
    return done.stdout


def numbers(loop):
    """Names of the numbers that go into a step."""
    return ["reference", "share", "wd", "wq", *(["temperature"] if measures_temperature(loop) else [])]


def output_type(loop, precision):
    kind, names = KIND[precision], record(loop, precision).output
    whole = {"int32_t": np.int32, "uint32_t": np.uint32}
    return np.dtype([(name, whole[WHOLE[name]] if name in WHOLE else kind) for name in names], align=True)


def in_c(loop, folder, inputs, precision, *flags):
    """(sequences, samples) of records of the compiled step, for inputs by name (sequences, samples); in fixed point in words."""
    kind, shape = KIND[precision], inputs["wd"].shape
    fields = [(n, kind) for n in numbers(loop)] + [("enable", np.int32), ("reset", np.int32)]
    given = np.zeros(shape, np.dtype(fields, align=True))
    for name in given.dtype.names:
        given[name] = inputs[name]
    program = compiled(loop, folder, precision, STEP_C, *flags, f"-DSAMPLES={shape[1]}")
    return np.frombuffer(run(program, given.tobytes()), output_type(loop, precision)).reshape(shape)


def array_of(kind):
    """numpy under the names that a step takes, whose results stay of one kind."""

    def where(condition, yes, no):  # of two plain numbers numpy makes a double
        found = np.where(condition, yes, no)
        return found if found.dtype == bool else found.astype(kind)

    return SimpleNamespace(where=where, isfinite=np.isfinite, logical_not=np.logical_not, floor=np.floor, nan=kind(np.nan))


def in_arrays(loop, inputs, precision):
    """The same by the step in floating-point arrays, one element for each sequence."""
    kind, shape = KIND[precision], inputs["wd"].shape
    xp, given = array_of(kind), {n: inputs[n].astype(kind) for n in numbers(loop)}
    out = np.zeros(shape, output_type(loop, precision))
    state, made = full(loop.machine.init(), shape[0], kind), words(loop)
    with np.errstate(invalid="ignore", over="ignore"):
        for k in range(shape[1]):
            now = {name: values[:, k] for name, values in given.items()}
            W = SimpleNamespace(real=now["wd"], imag=now["wq"])
            knobs = {"share": now["share"], "enable": inputs["enable"][:, k] != 0, "reset": inputs["reset"][:, k] != 0}
            state, command, said = loop.machine.step(state, now["reference"], W, now.get("temperature"), xp, **knobs)
            found = {"voltage": (None, command.voltage), "frequency": (None, command.frequency)}
            found |= {"fault": (0, said.fault), "mode": (0, said.mode)} | made.of(command.voltage, command.frequency, xp)
            for name, (base, value) in found.items():
                if value is not None:
                    assert value.dtype == kind
                    out[name][:, k] = value if base is None else base + value.astype(np.int64)
    return out


def full(value, count, kind):
    """A state with arrays in place of numbers."""
    if value is None:
        return None
    if isinstance(value, tuple):
        items = [full(item, count, kind) for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return np.full(count, value, kind)


def in_twin(loop, inputs, precision):
    """The same by the twin in integers; inputs in words."""
    step, shape = record(loop, precision), inputs["wd"].shape
    out = np.zeros(shape, output_type(loop, precision))
    state = {name: np.full(shape[0], first) for name, first in step.twin.first.items()}
    bases = {name: base or 0 for name, (_, base) in step.output.items()}
    for k in range(shape[1]):
        given = {f"in->{name}": values[:, k] for name, values in inputs.items()}
        state, found = step.twin.step(state, **given)
        for name, value in found.items():
            out[name][:, k] = value + bases[name]
    return out


def worded(loop, inputs, precision):
    """Inputs in words, what is not finite as the word for that."""
    twin = record(loop, precision).twin
    return {name: twin.word(name, v) if name in twin.points else v for name, v in inputs.items()}


def beside_float64(loop, inputs, precision, full):
    """The outputs of a step in `precision`, and in float64 of the same inputs, all as numbers; readings within +-`full`."""
    twin = record(loop, precision).twin
    inputs = inputs | {name: np.clip(inputs[name], -full, full) for name in ("wd", "wq")}
    if twin is None:
        given = {name: v.astype(np.float32) if v.dtype.kind == "f" else v for name, v in inputs.items()}
        found = [in_arrays(loop, given, p) for p in (precision, "double")]
        return tuple({name: out[name].astype(float) for name in out.dtype.names} for out in found)
    words = worded(loop, inputs, precision)
    given, out = unworded(loop, words, precision), in_twin(loop, words, precision)
    mine = {name: out[name] if name in WHOLE else twin.number(name, out[name]) for name in out.dtype.names}
    exact = in_arrays(loop, given, "double")
    return mine | {"frequency": loop.f0 + mine["frequency"]}, {name: exact[name] for name in exact.dtype.names}


def together(mine, exact):
    """Samples until one of the thresholds (of the state machine, of a voltage that brakes, of a source's steps) lies between."""
    same = (mine["mode"] == exact["mode"]) & ((mine["voltage"] < 0) == (exact["voltage"] < 0))
    if "ticks" in mine:
        same &= mine["ticks"] == exact["ticks"]
    return np.cumprod(same, 1).astype(bool)


class Rounding(NamedTuple):
    """How far from float64 a loop may be after n samples: n `volts`, and `hertz` + n `drift` Hz."""

    volts: float
    hertz: float
    drift: float


def rounding(loop, precision, full):
    """By what is rounded in a sample, for readings up to `full`. A PI's integral forgets nothing while it is not clipped, and a
    clip brings two numbers no further apart: its error grows by what is rounded in a sample, and no faster. A sign that is taken
    of a word is that of its number; a step of the other trackers is rounded like the PI's. It holds as long as they are
    `together`, and no gate's threshold lies between."""
    pi, tracker, twin = loop.law.amplitude, loop.law.tracker, record(loop, precision).twin
    most = getattr(tracker, "most", 0.0)
    gains = {"gain": getattr(tracker, "gain", 0.0), "lead": 2 * getattr(tracker, "lead", 0.0)}
    warm = abs(getattr(tracker, "k_T", None) or 0.0)
    if twin is None:  # ten operations on what goes up to Kp times the error; the frequency is given out in full
        eps, largest = 2.0**-24, pi.Kp * (full + loop.amplitude) + loop.limits.voltage
        far = loop.limits.frequency[1] - loop.limits.frequency[0]
        update = 8 * eps * (sum(gains.values()) * most + far)
        return Rounding(10 * eps * largest, loop.f0 * eps, update / tracker.every + 8 * eps * (warm * 60 + far) * (warm > 0))
    top = 2.0 ** -(twin.bits - 1)
    volt, asked = (2.0 ** -twin.states[n] for n in ("control_control_amplitude_integral", "asked"))
    # what is asked, to a word; an error of full scale and the amplitude, its gains to half of their last place; the voltage that
    # is wanted goes up to eight times the limit, so that its products and sums have words of eight; twice, as Ki and Kp have both
    room = 2 * (pi.Kp * asked + 2 * (full + loop.amplitude) * pi.Kp * top + 3 * 8 * volt)
    # the amplitude of the model, which forgets its error in a sample or two: what is asked and four words of its own, by the gain
    # of the PI and as the voltage that leads there
    if pi.model is not None:
        room += (asked + 4 * 2.0 ** -twin.states["control_control_amplitude_model_0"]) * (pi.Kp + 1 / pi.model.push)
    # an update: Wq/Wd, of which what is below a word is cut off, its gains, and a word for each of sum and product
    moved = tracker is not None and most > 0
    word = 2.0 ** -twin.states["control_control_tracker_offset"]
    update = (sum(gains.values()) * top * 4 + 3 * word) * moved
    heat = (warm * 2.0 ** -twin.points.get("temperature", 0) + 2 * word) * (warm > 0)
    return Rounding(room, 2.0 ** -twin.points["frequency"], update / tracker.every + heat)


def unworded(loop, inputs, precision):
    """The numbers that words stand for, NaN where one is missing."""
    twin = record(loop, precision).twin
    top = 2 ** (twin.bits - 1)
    return {n: np.where(v == -top, np.nan, twin.number(n, v)) if n in twin.points else v for n, v in inputs.items()}
