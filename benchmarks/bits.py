"""A million samples through the exported C and through the same step in Python:  python benchmarks/bits.py

Needs a C compiler. Writes bits.md beside itself.
"""

import datetime
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import replay  # noqa: E402
import test_export as export  # noqa: E402

SEQUENCES = 1680  # of 600 samples: a million


def row(name: str, precision: str) -> str:
    loop, inputs = export.designed(**export.LOOPS[name]), export.hard_samples(SEQUENCES, 7)
    mine = replay.in_arrays(loop, inputs, precision)
    with tempfile.TemporaryDirectory() as folder:
        theirs = replay.in_c(loop, Path(folder), inputs, precision, "-O2")
    fields = ["voltage", "fault", "mode", "held", *(["frequency"] if loop.f0 else [])]
    differ = sum(int((mine[field] != theirs[field]).sum()) for field in fields)
    faults = ", ".join(export.FAULTS[code] for code in np.unique(mine["fault"]) if code)
    saturated = 100 * np.mean(np.abs(mine["voltage"]) == 150.0)
    return f"| {name} | {precision} | {mine.size} | {differ} | {saturated:.1f} % | {len(np.unique(mine['mode']))} of 8 | {faults} |"


def main() -> None:
    rows = [row(name, precision) for name in export.LOOPS for precision in ("double", "single")]
    text = f"""# The exported C against Python

Made by `python benchmarks/bits.py` on {datetime.date.today():%Y-%m-%d}: sequences of 600 samples in which a controller comes to run and then
saturates, rests, misses readings, sticks, jumps, overflows, clips, is told nonsense, is switched off and reset; three of fourteen are tasks of
commissioning (`hard_samples` in `tests/test_export.py`). Compared are voltage, frequency, fault, mode and the count of inputs that were held.

| loop | type | samples | outputs that differ | at the voltage's limit | modes | faults |
|---|---|---|---|---|---|---|
""" + "\n".join(rows)
    (HERE / "bits.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
