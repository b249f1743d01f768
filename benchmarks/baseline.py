"""Freeze what fits answer, and say what a change of the code has changed of it.  python benchmarks/baseline.py before.json

    python benchmarks/baseline.py before.json ...                         freeze
    python benchmarks/baseline.py after.json ... --against before.json    freeze again, and compare

Fitted are the catalogue of hard logs and the kinds that people bring, each of so many seeds, and all FILES: each by itself, through the
mapping file of its name (.toml) where one lies beside it; of a folder all its files together, as of one bench. Frozen are result,
values, errors, findings and processor seconds, one entry a fit. Compared are answers, not speed on another machine: seconds are those of
a second fit of the same logs, and only their median ratio is told.

    FILES         more logs          --seeds N   of the catalogue and the kinds (default 1; 0: none)
    --against F   frozen before      --only NAME entries whose name holds NAME
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from rich.progress import track

from sysid import Log, LogError, fit, read_logs

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "hard_logs")]
import kinds  # noqa: E402
from cases import CASES  # noqa: E402
from verdicts import logs_of  # noqa: E402

MOVED = 0.1  # errors; a change of an error by as much of itself
Made = Callable[[], Sequence[Log]]


def entries(files: Sequence[str], seeds: int) -> Iterator[tuple[str, Made]]:
    """Names, and what makes or reads the logs."""
    for seed in range(seeds):
        for name, case in CASES.items():
            yield f"hard/{name}/{seed}", lambda case=case, seed=seed: logs_of(case, seed)
        for k, (name, kind) in enumerate(kinds.KINDS.items()):
            for v, (variant, made) in enumerate(kind.variants.items()):
                rng = [k, v, seed]
                yield (
                    f"kinds/{name}/{variant}/{seed}",
                    lambda made=made, rng=rng: made(np.random.default_rng(rng))[0],
                )
    for path in map(Path, files):
        one = sorted(p for p in path.iterdir() if p.suffix != ".toml") if path.is_dir() else [path]
        beside = path.with_suffix(".toml")
        given = {"columns": beside} if beside.exists() else {}
        yield (
            f"files/{path.parent.name}/{path.name}",
            lambda one=one, given=given: read_logs(one, **given),
        )


def answer(made: Made) -> dict[str, Any]:
    """What is said of these logs."""
    try:
        logs = made()
        fit(logs)
        begun = process_time()
        found = fit(logs)
    except LogError as error:
        return {
            "result": f"not read: {error}".partition("\n")[0],
            "values": {},
            "findings": [],
            "seconds": 0.0,
        }
    return {
        "result": found.result.name,
        "values": {n: [p.value, p.std] for n, p in found.parameters.items() if p.determined},
        "findings": sorted({f"{f.key} {f.outcome}" for f in found.findings}),
        "seconds": round(process_time() - begun, 3),
    }


def changes(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """What is another answer, in words."""
    said = [f"{key}: {old[key]} -> {new[key]}" for key in ("result", "findings") if old[key] != new[key]]
    for name in old["values"].keys() | new["values"].keys():
        before, after = old["values"].get(name), new["values"].get(name)
        if before is None or after is None:
            said.append(f"{name}: {before} -> {after}")
            continue
        moved, wider = (after[0] - before[0]) / before[1], after[1] / before[1]
        if abs(moved) > MOVED or abs(np.log(wider)) > MOVED:
            said.append(f"{name}: moved by {moved:+.2g} of its errors, which are {wider:.3g} times as large")
    return sorted(said)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("frozen", type=Path)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    tried = [(name, made) for name, made in entries(given.files, given.seeds) if given.only in name]
    now = {name: answer(made) for name, made in track(tried)}
    given.frozen.write_text(json.dumps(now, indent=1), encoding="utf-8")
    if given.against is None:
        return
    before = json.loads(given.against.read_text(encoding="utf-8"))
    both = [name for name in now if name in before]
    for name in both:
        for said in changes(before[name], now[name]):
            print(f"{name}: {said}")
    ratios = [now[n]["seconds"] / before[n]["seconds"] for n in both if before[n]["seconds"] > 0]
    print(
        f"{len(both)} compared; seconds in the median {np.median(ratios) if ratios else 1:.2f} times those before"
    )


if __name__ == "__main__":
    main()
