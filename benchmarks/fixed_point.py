"""A million samples through the exported C and through its twin in Python:  python benchmarks/fixed_point.py

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

SEQUENCES, SAMPLES = 1000, 1000


def row(name: str, precision: str) -> str:
    loop = fixed.designed(**fixed.CASES[name])
    words = replay.worded(loop, fixed.hard(SEQUENCES, SAMPLES), precision)
    mine = replay.in_twin(loop, words, precision)
    with tempfile.TemporaryDirectory() as folder:
        theirs = replay.in_c(loop, Path(folder), words, precision, *replay.SANITIZERS)
    differ = sum(int((mine[field] != theirs[field]).sum()) for field in mine.dtype.names)
    exact = replay.in_arrays(loop, replay.unworded(loop, words, precision), "double")
    twin = fixed.record(loop, precision).twin
    within = np.maximum.accumulate(np.abs(words["wd"]) >= 2 ** (twin.bits - 1) - 1, 1) | (mine["mode"] != exact["mode"])
    agree = ~np.maximum.accumulate(within, 1)
    off = np.abs(twin.number("voltage", mine["voltage"]) - exact["voltage"])[agree]
    away = np.abs(twin.number("frequency", mine["frequency"]) - exact["frequency"])[agree]
    shown = (f"{np.median(off):.2g}", f"{off.max():.2g}", f"{np.median(away):.2g}", f"{away.max():.2g}")
    return f"| {name} | {precision} | {differ} | {100 * agree.mean():.1f} % | {' | '.join(shown)} |"


def main() -> None:
    rows = [row(name, precision) for name in fixed.CASES for precision in ("q31", "q15")]
    text = f"""# Fixed point

Made by `python benchmarks/fixed_point.py`: {SEQUENCES} sequences of {SAMPLES} samples, in which a controller comes to run and then saturates, rests,
misses readings, sticks, jumps, is switched off and reset (`tests/test_fixed.py`), through the C, compiled with the address and undefined-behaviour
sanitizers, its twin in Python, and the same step in float64. Voltage limit 150 V. "compared": samples of a sequence before a reading saturates or
a threshold lies between the two.

| method | words | outputs that differ, C and twin | compared with float64 | V, median | V, most | Hz, median | Hz, most |
|---|---|---|---|---|---|---|---|
""" + "\n".join(rows)
    (HERE / "fixed_point.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
