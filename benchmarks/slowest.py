"""Processor time of each hard log, and the ten slowest.  python benchmarks/slowest.py [--logs FILES...]

Each case of the catalogue (benchmarks/hard_logs) is fitted twice, the second time with all programs compiled, and so are other
files. Times are of the processor, all threads together, and hang on the machine; beside them stands that of numpy's solution of 300
linear equations of 300 unknowns in the same run, 100 times. Writes slowest.md, unless files are given.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import date
from pathlib import Path
from time import process_time

import numpy as np
from rich.progress import track

from sysid import LogError, fit, read_logs
from sysid.precision import keep_programs

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "hard_logs"))
from cases import CASES  # noqa: E402
from verdicts import logs_of  # noqa: E402


def seconds(work: Callable[[], object]) -> float:
    """Processor time of the second of two runs."""
    for _ in range(2):
        begun = process_time()
        with suppress(LogError):
            work()
    return process_time() - begun


def measured(files: list[str]) -> Iterator[tuple[float, str]]:
    """Of each log, its name last."""
    if files:
        yield from ((seconds(lambda f=f: fit(read_logs(f))), f) for f in track(files))
        return
    for name, case in track(CASES.items()):
        yield seconds(lambda case=case: fit(logs_of(case, 0))), name


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--logs", nargs="*", default=[])
    files = parser.parse_args().logs
    a = np.random.default_rng(0).standard_normal((300, 300))
    floor = seconds(lambda: [np.linalg.solve(a, a) for _ in range(100)])
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        found = sorted(measured(files), reverse=True)
    median = float(np.median([t for t, _ in found]))
    rows = [f"| {name} | {t:.2f} |" for t, name in found[:10]]
    table = [
        "# The slowest logs", "", f"Made by `python benchmarks/slowest.py` on {date.today()}.", "", __doc__.partition("\n\n")[2].partition(" Writes")[0],
        "", f"{len(found)} logs; median {median:.2f} s; the linear equations {floor:.2f} s.", "", "| log | s |", "|---|---|", *rows, "",
    ]  # fmt: skip
    if files:
        print("\n".join(table))
    else:
        (HERE / "slowest.md").write_text("\n".join(table), encoding="utf-8")


if __name__ == "__main__":
    main()
