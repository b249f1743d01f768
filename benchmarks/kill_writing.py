"""Kill the writing of results at random moments: what stands in the folder then?  python benchmarks/kill_writing.py

Processes that do nothing else put one set of files after another into one folder, as the command does with a result that is
finished: sets with a controller and sets without, in turn. One of them is killed (SIGKILL) after a random time of up
to four times what a set takes, and the folder is looked at while no other process moves files. A set is whole when fit.json is
there, every file that it names has the sha256 that it names, and no other file of a set stands beside them. Writes kill_writing.md beside itself; exits 1 when a mixture was seen.

    --kills N     how many (default 2000)        --writers N   processes at once (default 1 and 2, one after the other)
    --seed N      of the moments (default 0)     --print       do not write the table
"""

import argparse
import hashlib
import json
import math
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from sysid.command import outputs

HERE = Path(__file__).parent
SIZES = {
    outputs.REPORT: 400_000,
    outputs.DRAWS: 150_000,
    outputs.CONTROLLER: 4_000,
    outputs.HEADER: 6_000,
}  # as the command's
CONTROLLERS = (outputs.CONTROLLER, outputs.HEADER)
SPAN = 4  # in sets: the longest life of a writer


def write(folder: Path, writer: int, sets: float = math.inf) -> None:
    """Write so many sets."""
    run = 0
    while run < sets:
        run += 1
        with outputs.staging(folder) as fresh:
            for name, size in SIZES.items():
                if run % 2 or name not in CONTROLLERS:
                    (fresh / name).write_bytes(f"{writer} {run} {name} ".encode() * (size // 20))
            content = {"run": f"{writer} {run}", "files": outputs.digests(fresh)}
            (fresh / outputs.FIT).write_text(outputs.to_json(content), encoding="ascii")
            outputs.place(fresh, folder)


def state(folder: Path) -> str:
    """What stands in the folder: a whole set, none, or a mixture, with what is wrong."""
    present = {name: folder / name for name in outputs.FILES if (folder / name).exists()}
    if outputs.FIT not in present:
        torn = [
            name
            for name in CONTROLLERS
            if name in present and len(set(present[name].read_bytes().split(b" ")[1::3])) > 1
        ]
        return f"torn {torn[0]}" if torn else "no set"
    try:
        named = json.loads(present.pop(outputs.FIT).read_text())["files"]
    except ValueError:
        return "torn fit.json"
    found = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in present.items()}
    return "whole" if found == named else f"mixture of {sorted(found)} and {sorted(named)}"


def study(kills: int, writers: int, seed: int) -> Counter[str]:
    """How often each state was found."""
    rng, found = random.Random(seed), Counter()
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "identified"
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
        began = time.monotonic()
        write(folder, 0, SPAN)
        span = time.monotonic() - began  # of a slow or a busy machine, longer
        children = [start(folder, writer) for writer in range(writers)]
        try:
            for _ in range(kills):
                time.sleep(rng.uniform(0, span))
                os.kill(children[0], signal.SIGKILL)
                os.waitpid(children.pop(0), 0)
                with outputs._alone(folder):
                    found[state(folder)] += 1
                    assert (folder / "notes.txt").read_text() == "mine"
                for left in folder.glob(".identify-*") if writers == 1 else ():
                    shutil.rmtree(left, ignore_errors=True)
                children.append(start(folder, rng.randrange(1000)))
        finally:
            for child in children:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
    return found


def start(folder: Path, writer: int) -> int:
    """A process that writes sets."""
    child = os.fork()
    if child == 0:
        write(folder, writer)
    return child


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=2000)
    parser.add_argument("--writers", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--print", action="store_true")
    given = parser.parse_args()
    counts = [given.writers] if given.writers else [1, 2]
    results = {writers: study(given.kills, writers, given.seed) for writers in counts}
    lines = [
        "# Killed while it writes",
        "",
        f"Made by `python benchmarks/kill_writing.py --kills {given.kills} --seed {given.seed}`.",
    ]
    lines += ["", __doc__.partition("\n\n")[2].partition(" Writes")[0], ""]
    lines += ["| writers | kills | a whole set | no set (no fit.json) | a mixture |", "|---|---|---|---|---|"]
    for writers, found in results.items():
        mixed = sum(found.values()) - found["whole"] - found["no set"]
        lines.append(
            f"| {writers} | {sum(found.values())} | {found['whole']} | {found['no set']} | {mixed} |"
        )
    bad = {
        said: n for found in results.values() for said, n in found.items() if said not in ("whole", "no set")
    }
    text = "\n".join([*lines, *(f"- {n} times {said}" for said, n in bad.items())]) + "\n"
    if not given.print:
        (HERE / "kill_writing.md").write_text(text, encoding="utf-8")
    print(text)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
