"""A million samples through the exported C and through the same step in Python:  python benchmarks/fixed_point.py

Needs a C compiler. Writes fixed_point.md beside itself.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import replay  # noqa: E402
import test_fixed as fixed  # noqa: E402

from controller.recording import record  # noqa: E402

SEQUENCES, SAMPLES = 1000, 1000
CASES = {**fixed.CASES, "adaptive-rig": {"method": "adaptive", "rig": fixed.RIG}}


def row(name: str, precision: str) -> str:
    loop = fixed.designed(**CASES[name])
    inputs, step = fixed.hard(SEQUENCES, SAMPLES), record(loop, precision)
    given = inputs if step.twin is None else replay.worded(loop, inputs, precision)
    mine = (replay.in_arrays if step.twin is None else replay.in_twin)(loop, given, precision)
    with tempfile.TemporaryDirectory() as folder:
        theirs = replay.in_c(loop, Path(folder), given, precision, *replay.SANITIZERS)
    differ = sum(int((mine[field] != theirs[field]).sum()) for field in mine.dtype.names)
    counts = f"{sum(step.counts.values())} | {step.counts['*'] + step.counts['multiplications']} | {step.counts['/'] + step.counts['divisions']}"
    head = f"| {name} | {precision} | {counts} | {differ}"
    if precision == "double" or name.startswith("adaptive"):
        return f"{head} | | | | | |"
    mine, exact = replay.beside_float64(loop, inputs, precision, fixed.FULL)
    agree, room, n = replay.together(mine, exact), replay.rounding(loop, precision, fixed.FULL), np.arange(1, SAMPLES + 1) + 1
    off, away = (np.abs(mine[field] - exact[field]) for field in ("voltage", "frequency"))
    shares = (off / (room.volts * n))[agree].max(), (away / (room.hertz + room.drift * n))[agree].max()
    shown = f"{off[agree].max():.2g} | {shares[0]:.2g} | {away[agree].max():.2g} | {shares[1]:.2g}"
    return f"{head} | {100 * agree.mean():.1f} % | {shown} |"


def main() -> None:
    rows = [row(n, p) for n in CASES for p in ("double", "single", "q31", "q15") if not (n.startswith("adaptive") and p[0] == "q")]
    text = f"""# The exported C against Python

Made by `python benchmarks/fixed_point.py`: {SEQUENCES} sequences of {SAMPLES} samples, in which a controller comes to run and then saturates, rests,
misses readings, sticks, jumps, is switched off and reset (`hard` in `tests/test_fixed.py`), through the C, compiled with warnings as errors and run with
the address and undefined-behaviour sanitizers (any finding ends this program), and through the same step in Python of the same number type: arrays of
floats, or the twin in integers. Voltage limit 150 V, window 600 Hz. Operations: of one step, all of them, multiplications, divisions.

Then the same against float64, readings clipped to full scale: samples of a sequence until a threshold lies between the two (of the state machine, of a
voltage that brakes, of a timer's ticks); the largest distance there, and its largest share of the bound that `rounding` in `tests/replay.py` derives.

| method | type | operations | of them x | / | outputs that differ | compared | V, most | of the bound | Hz, most | of the bound |
|---|---|---|---|---|---|---|---|---|---|---|
""" + "\n".join(rows)
    (HERE / "fixed_point.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
