"""Is the description chosen that made the logs?  python benchmarks/right_model.py --seeds 400 --jobs 2

A voltage step and a sweep of one plate, with one thing of the bench in them at five of its own standard deviations (each as the
joint fit of logs without any states it), at a random phase; and the same logs with nothing in them. Counted is how often
`sysid.compare` calls the description without that thing worse: it should in 95 %, and in at most 5 % where there is nothing.
Responses: `tests/reference.py`, which shares no code with the package. Writes right_model.md beside itself.

    --seeds N   of each (default 400)      --jobs N   processes (default 1)
"""

import argparse
import os
import runpy
import tempfile
from collections import Counter
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track

from sysid import Log, compare, fit, nuisances
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(
    **runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference")
)
PLANT = reference.Plant(G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=0.0)
NOISE, TIMES = 0.02, 5.0  # um per channel, 1 % of the resonance; standard deviations of what is put in
TIME, DRIVE = 1e-4 * np.arange(240), np.repeat([0.0, 100.0], [20, 220])
SWEPT = np.linspace(31800.0, 32800.0, 101)
# What it is, of which log (0: the step, 1: the sweep), under which name its error is stated.
TERMS = {"rotation": (1, "rotation"), "background": (1, "feedthrough_d"), "offset": (0, "offset_d")}
TERMS |= {"start": (0, "start_d"), "late": (0, "delay")}
CHUNK = 20


def step(late: float = 0.0) -> np.ndarray:
    """The response to a step, `late` s behind."""
    moments, held = (
        np.stack([TIME, TIME + late], axis=1).ravel(),
        np.stack([np.append(0.0, DRIVE[:-1]), DRIVE], axis=1).ravel(),
    )
    if late == 0.0:
        moments, held = TIME, DRIVE
    constant = np.ones(len(moments))
    found = reference.ringing(PLANT, moments, held, 32290.0 * constant, 24.0 * constant)
    return found[:: 1 if late == 0.0 else 2]


def logs(seed: int, term: str | None = None, size: float = 0.0) -> list[Log]:
    """A step and a sweep with `size` of one term in them."""
    rng = np.random.default_rng([seed, 11])
    phase, sign = np.exp(2j * np.pi * rng.random()), rng.choice([-1.0, 1.0])
    transient = step(size if term == "late" else 0.0)
    swept = reference.steady(PLANT, np.full(101, 100.0), SWEPT, np.full(101, 24.0))
    if term == "offset":
        transient = transient + size * phase
    if term == "start":
        pole = -1 / PLANT.tau + 2j * np.pi * (PLANT.f0 - 32290.0)
        transient = transient + size * phase * np.exp(pole * TIME)
    if term == "background":
        swept = swept + size * phase * 100.0
    if term == "rotation":
        swept = swept * np.exp(1j * np.deg2rad(sign * size))
    transient, swept = (
        y + NOISE * (rng.standard_normal((2, len(y))).T @ [1, 1j]) for y in (transient, swept)
    )
    return [
        Log("step", transient, time=TIME, drive=DRIVE, frequency=np.full(240, 32290.0), sampling="instant"),
        Log("sweep", swept, drive=np.full(101, 100.0), frequency=SWEPT),
    ]


def sizes() -> dict[str, float]:
    """What is put in of each term."""
    found = nuisances(fit(logs(0)))
    return {term: TIMES * found[log][name].std for term, (log, name) in TERMS.items()}


def work(task: tuple[str | None, float, range]) -> list[tuple[str | None, tuple[str, ...], str]]:
    """Of each seed: the term that was put in, the terms that were called needed, and how the fit ended."""
    term, size, seeds = task
    found = []
    for seed in seeds:
        fitted = fit(logs(seed, term, size))
        needed = tuple(c.description.removeprefix("without ") for c in compare(fitted) if c.worse)
        found.append((term, needed, fitted.result.name))
    return found


def table(found: list, put: dict[str, float], seeds: int) -> str:
    """The study as Markdown."""
    units = {"rotation": "deg", "background": "um/V", "offset": "um", "start": "um", "late": "s"}
    lines = ["# Is the description chosen that made the logs?", ""]
    lines += [f"Made by `python benchmarks/right_model.py --seeds {seeds}`.", ""]
    lines += [
        f"A step and a sweep, {seeds} seeds a row. `needed`: the description without it is called worse.",
        "",
    ]
    lines += [
        "| what | put in, five of its errors | needed where it is, % | needed where nothing is, % | fits |",
        "|---|---|---|---|---|",
    ]
    for term, size in put.items():
        there = [needed for t, needed, _ in found if t == term]
        absent = [needed for t, needed, _ in found if t is None]
        ends = Counter(end for t, _, end in found if t == term)
        share, false = (
            100 * np.mean([term in needed for needed in of]) if of else np.nan for of in (there, absent)
        )
        said = ", ".join(f"{end} {count}" for end, count in ends.items())
        lines.append(f"| {term} | {size:.2g} {units[term]} | {share:.1f} | {false:.1f} | {said} |")
    ends = Counter(end for t, _, end in found if t is None)
    return (
        "\n".join(
            [*lines, "", f"Logs with nothing in them: {', '.join(f'{e} {n}' for e, n in ends.items())}."]
        )
        + "\n"
    )


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    put = sizes()
    begins = range(1000, 1000 + given.seeds, CHUNK)
    todo = [
        (term, put.get(term, 0.0), range(b, min(b + CHUNK, 1000 + given.seeds)))
        for term in (None, *put)
        for b in begins
    ]
    found: list = []
    pool = {"processes": given.jobs, "initializer": _begin, "maxtasksperchild": 20}
    with (
        tempfile.TemporaryDirectory() as folder,
        get_context("spawn").Pool(**pool, initargs=(folder,)) as workers,
    ):
        for part in track(workers.imap(work, todo), total=len(todo), console=Console(stderr=True)):
            found += part
    (HERE / "right_model.md").write_text(table(found, put, given.seeds), encoding="utf-8")
    print(table(found, put, given.seeds))


if __name__ == "__main__":
    main()
