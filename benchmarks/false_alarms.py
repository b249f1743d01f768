"""How many clean fits carry a warning that asks for something?  python benchmarks/false_alarms.py --fits 1000

Two usual benches, half of the fits each: a step and a sweep; three steps and three sweeps at several temperatures. All logs are of
one plate, from the scenes' own files of a step and a sweep with new seeds: nothing is wrong with them. Writes false_alarms.md.

    --fits N    how many (default 1000)
    --jobs N    so many at once (default 1)
"""

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from functools import partial
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path

from rich.progress import track

from sysid import Log, Scene, fit
from sysid.precision import keep_programs

SCENES = Path(__file__).parents[1] / "data/synthetic/scenes/plate"
WHERE = Path(__file__).with_suffix(".md")
PAIR, SIX = (
    ("step_100V_24C", "sweep_24C"),
    ("step_100V_24C", "step_60V_27C", "step_140V_31C", "sweep_24C", "sweep_28C", "sweep_32C"),
)
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")


def simulated(names: tuple[str, ...], seed: int) -> list[Log]:
    """Logs of these scenes, each with a noise of its own; responses in one unit."""
    scenes = (Scene.from_toml(SCENES / f"{name}.toml") for name in names)
    return [
        replace(scene.simulate(seed * len(names) + k), name=name)
        for k, (scene, name) in enumerate(zip(scenes, names, strict=True))
    ]


def told(seed: int, names: tuple[str, ...]) -> tuple[list[str], bool]:
    """What a fit of these logs asks for, and whether it notes something."""
    found = fit(simulated(names, seed + 1000))
    failed = [] if found.result.name == "successful" else [found.result.name]
    return [*found.warnings, *failed], bool(found.notes)


def counted(names: tuple[str, ...], fits: int, workers: Pool) -> Iterator[str]:
    """Rows of the table for one bench."""
    warned, noted, said = 0, 0, Counter()
    each = workers.imap(partial(told, names=names), range(fits))
    for asked, notes in track(each, f"{len(names)} logs", total=fits):
        warned, noted = warned + bool(asked), noted + notes
        said.update({NUMBER.sub("#", w)[:110].replace("|", "/") for w in asked})
    yield f"| {len(names)} logs: {', '.join(names)} | {fits} | {100 * warned / fits:.2g} % | {100 * noted / fits:.2g} % |"
    for sentence, times in said.most_common():
        yield f"| &nbsp;&nbsp;{sentence} ... | | {times} | |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    fits = given.fits
    with (
        tempfile.TemporaryDirectory() as folder,
        get_context("spawn").Pool(given.jobs, keep_programs, (Path(folder),)) as workers,
    ):
        rows = [row for names in (PAIR, SIX) for row in counted(names, fits // 2, workers)]
    head = [
        "# False alarms",
        "",
        f"Made by `python benchmarks/false_alarms.py --fits {fits}` on {date.today()}.",
        "",
    ]
    table = ["| bench | fits | with a warning | with a note |", "|---|---|---|---|", *rows, ""]
    WHERE.write_text(
        "\n".join([*head, __doc__.partition("\n\n")[2].partition(" Writes")[0], "", *table]), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
