"""The exported C compiled and fed with a binary log, and the same steps in Python arrays."""

import atexit
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import controller
from controller.scalar import typed

KIND = {"double": np.float64, "single": np.float32}
WARNINGS = [
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
    "-Wfloat-equal",
    "-Werror",
]
PLAIN = ["-std=c99", "-ffp-contract=off"]
SANITIZERS = ["-O1", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]

STEP_C = """\
#include <stdio.h>
#include "dq_pi_plate.h"
int main(void)
{
    static const dq_params params = DQ_PLATE_PARAMS;
    dq_input in;
    dq_state s;
    long k = 0;
    while (fread(&in, sizeof in, 1, stdin) == 1) {
        dq_output out;
        if (k++ % SAMPLES == 0 && dq_init(&s, &params) != DQ_PARAMS_OK)
            return 3;
        out = dq_step(&s, &in);
        if (fwrite(&out, sizeof out, 1, stdout) != 1)
            return 1;
    }
    return 0;
}
"""
DEMODULATE_C = """\
#include <stdio.h>
#include "dq_pi_plate.h"
struct sample { dq_real value; uint32_t phase; };
int main(void)
{
    static const dq_params params = DQ_PLATE_PARAMS;
    struct sample in;
    dq_demodulator s;
    long k = 0;
    if (dq_self_test() != 0)
        return 2;
    while (fread(&in, sizeof in, 1, stdin) == 1) {
        dq_response out;
        if (k++ % SAMPLES == 0)
            dq_demodulator_init(&s, &params);
        out = dq_demodulate(&s, in.value, in.phase);
        if (fwrite(&out, sizeof out, 1, stdout) != 1)
            return 1;
    }
    return 0;
}
"""
REALS = ("reference", "share", "wd", "wq", "temperature", "voltage", "offset")
WHOLE = ("task", "clipped", "samples", "enable", "reset")
STILL = dict.fromkeys((*REALS, *WHOLE), 0.0) | {"share": 1.0, "temperature": 24.0, "enable": 1.0}


def compiled(loop, folder, precision, main, *flags, compiler=None):
    """The program that `main` makes of the export."""
    compiler = compiler or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    controller.export_c(loop, folder / "dq_pi.h", precision)
    (folder / "main.c").write_text(main)
    plain = tuple(flag for flag in flags if not flag.startswith("-D"))
    law = _law((folder / "dq_pi.h").read_text(), (folder / "dq_pi.c").read_text(), compiler, plain)
    command = [compiler, *PLAIN, *WARNINGS, *flags, "main.c", law, "-o", "main"]  # no library but C's
    subprocess.run(command, cwd=folder, check=True)
    return folder / "main"


@cache
def _law(header, source, compiler, flags):
    """The object of a law, which is the same for every plate: compiled once."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "dq_pi.h").write_text(header)
    (folder / "dq_pi.c").write_text(source)
    subprocess.run([compiler, *PLAIN, *WARNINGS, *flags, "-c", "dq_pi.c"], cwd=folder, check=True)
    return folder / "dq_pi.o"


def run(program, data):
    done = subprocess.run([program], input=data, capture_output=True, check=True)
    assert not done.stderr
    return done.stdout


def output_type(precision):
    kind = KIND[precision]
    named = [(name, kind) for name in ("voltage", "frequency", "offset")]
    return np.dtype([*named, ("fault", np.int32), ("mode", np.int32), ("held", np.uint32)], align=True)


def given(inputs):
    """All inputs (sequences, samples), with those that are not given at rest."""
    shape = inputs["wd"].shape
    return {name: np.broadcast_to(inputs.get(name, still), shape) for name, still in STILL.items()}


def in_c(loop, folder, inputs, precision, *flags):
    """(sequences, samples) of records of the compiled step, for inputs by name (sequences, samples)."""
    shape = inputs["wd"].shape
    rows = np.zeros(
        shape, np.dtype([*((n, KIND[precision]) for n in REALS), *((n, np.int32) for n in WHOLE)], align=True)
    )
    for name, values in given(inputs).items():
        rows[name] = values
    program = compiled(loop, folder, precision, STEP_C, *flags, f"-DSAMPLES={shape[1]}")
    return np.frombuffer(run(program, rows.tobytes()), output_type(precision)).reshape(shape)


def array_of(kind):
    """numpy under the names that a step takes, whose results stay of one kind."""

    def where(condition, yes, no):  # of two plain numbers numpy makes a double
        found = np.where(condition, yes, no)
        return found if found.dtype == bool else found.astype(kind)

    return SimpleNamespace(
        where=where, isfinite=np.isfinite, logical_not=np.logical_not, floor=np.floor, nan=kind(np.nan)
    )


def in_arrays(loop, inputs, precision):
    """The same by the step in floating-point arrays, one element for each sequence."""
    kind, shape = KIND[precision], inputs["wd"].shape
    arrived = np.diff(inputs["samples"], prepend=0).astype(kind) if "samples" in inputs else None
    rows = {n: v.astype(kind) for n, v in given(inputs).items()}
    out, xp, machine = np.zeros(shape, output_type(precision)), array_of(kind), typed(loop.machine, kind)
    state = full(machine.init(), shape[0], kind)
    with np.errstate(invalid="ignore", over="ignore"):
        for k in range(shape[1]):
            now = {name: values[:, k] for name, values in rows.items()}
            W = SimpleNamespace(real=now["wd"], imag=now["wq"])
            knobs = {name: now[name] for name in ("share", "voltage", "offset", "task")}
            knobs |= {name: now[name] != 0 for name in ("enable", "reset", "clipped")}
            knobs["arrived"] = None if arrived is None else arrived[:, k]
            state, command, said = machine.step(state, now["reference"], W, now["temperature"], xp, **knobs)
            found = {
                "voltage": command.voltage,
                "fault": said.fault,
                "mode": said.mode,
                "held": state.held.count,
            }
            if command.frequency is not None:
                found |= {"frequency": command.frequency}
            for name, value in found.items():
                assert value.dtype == kind, name
                out[name][:, k] = value
    return out


def full(value, count, kind):
    """A state with arrays in place of numbers."""
    if value is None:
        return None
    if isinstance(value, tuple):
        items = [full(item, count, kind) for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return np.full(count, value, kind)
