"""Effects of the registry, as fits find them.  python benchmarks/effects.py --seeds 3

Each effect is put into logs of one plate, small and clear (`effects_made`), and these are fitted with the
effects that logs may call for and without. Of each bench and size the table says what was found ("-":
nothing; what is only noted is left out), how often the fit was successful, the largest |value -
truth|/error of the determined G, tau and f0 (and k_T) of successful fits, before (without effects) and
after, and the root mean square of those after.

    --seeds N      of each (default 3)
    --only NAME    kinds whose name holds NAME
    --cases FILE   a line of JSON of each fit is appended to it, and those that it holds are not made again:
                   what was stopped goes on
    --minutes M    after which it stops, and writes what there is
    --jobs N       so many at once (default 1)

Writes effects.md beside itself, unless --only is given.
"""

import argparse
import json
import signal
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from datetime import date
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from effects_made import KINDS, SIZES, made, right

from sysid import Fit, fit
from sysid.trials.trial import NUISANCES

WHERE = Path(__file__).with_suffix(".md")
FAR = 5.0  # errors: by chance in one of two million
LONG, LONGEST = 30.0, 120.0  # s of processor time of a fit, and when it is stopped
FIRST_SEED = 50
Case = dict  # kind, size, bench, seed; named, said, noted, result, before, after, seconds


def off(found: Fit, name: str, word: str) -> dict[str, float]:
    """|value - truth|/error of what is determined, by the nearest of truths."""
    if found.result.name != "successful":
        return {}
    each = []
    for truth in right(name, word, found.reference_temperature):
        known = {n: found.parameters[n] for n in truth if found.parameters[n].determined}
        each.append({n: round(abs(p.value - truth[n]) / p.std, 2) for n, p in known.items()})
    return min(each, key=lambda z: max(z.values(), default=0.0))


class StoppedError(BaseException):
    """A fit that goes on."""


def _stop(*_: object) -> None:
    raise StoppedError


def case(name: str, word: str, bench: str, seed: int) -> Case:
    logs, begun = made(name, word, bench, seed), time.process_time()
    at = {"kind": name, "size": word, "bench": bench, "seed": seed}
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        found = fit(logs)
    except StoppedError:
        stopped = {"named": "stopped", "said": "stopped", "result": "stopped", "before": {}, "after": {}}
        return {**at, **stopped, "seconds": LONGEST}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    seconds, without = time.process_time() - begun, fit(logs, nuisances=NUISANCES)
    named = [f for f in found.findings if f.outcome != "noted"]
    return {
        **at,
        "named": named[0].key if named else "-",
        "said": ", ".join(f"{f.key} {f.outcome}" for f in named) or "-",
        "noted": ", ".join(f.key for f in found.findings if f.outcome == "noted"),
        "result": found.result.name,
        "before": off(without, name, word), "after": off(found, name, word),
        "seconds": round(seconds, 1),
    }  # fmt: skip


def cells(only: str) -> Iterator[tuple[str, str, str]]:
    for name, kind in KINDS.items():
        for bench in kind.benches if only in name else ():
            for word, _ in zip(SIZES, kind.sizes, strict=False):
                yield name, word, bench


def _said(c: Case) -> str:
    return f"- ({c['result']})" if c["said"] == "-" and c["result"] != "successful" else c["said"]


def row(cases: list[Case]) -> str:
    """Of one kind, size and bench."""
    names = Counter(_said(c) for c in cases)
    before, after = ([z for c in cases for z in c[when].values()] for when in ("before", "after"))
    said = "; ".join(f"{name} {n}" for name, n in names.most_common())
    worst = [f"{max(z):.1f}" if z else "-" for z in (before, after)]
    rms = f"{np.sqrt(np.mean(np.square(after))):.2f}" if after else "-"
    succeeded = sum(c["result"] == "successful" for c in cases)
    first = cases[0]
    at = f"{first['kind']} | {first['size'] if first['kind'] != 'nothing' else ''} | {first['bench']}"
    return f"| {at} | {said} | {succeeded} of {len(cases)} | {worst[0]} | {worst[1]} | {rms} |"


def confusion(cases: Iterable[Case]) -> list[str]:
    """What was named first of what was put in, small and clear."""
    counts: dict[tuple[str, str], Counter] = defaultdict(Counter)
    for c in cases:
        counts[c["kind"], c["size"]][c["named"]] += 1
    names = [name for name, _ in sum(counts.values(), Counter()).most_common()]
    lines = []
    for kind in dict.fromkeys(name for name in KINDS if (name, "small") in counts):
        small, clear = (counts[kind, size] for size in SIZES)
        each = (f"{small[n] or '.'}/{clear[n] or '.'}" if small[n] or clear[n] else "" for n in names)
        lines.append(f"| {kind} | {' | '.join(each)} |")
    return [f"| put in | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|", *lines]


def listed(cases: Iterable[Case]) -> list[str]:
    return [
        f"- `made({c['kind']!r}, {c['size']!r}, {c['bench']!r}, {c['seed']})`: {_said(c)}"
        f"{' (noted: ' + c['noted'] + ')' if c.get('noted') else ''}; {c['result']};"
        f" {', '.join(f'{n} {z:.1f}' for n, z in c['after'].items()) or '-'}; {c['seconds']:.0f} s"
        for c in cases
    ]


def wrong(c: Case) -> bool:
    """Whether a clear effect is named first as something else, or spoils the fit without a name."""
    silent = c["named"] == "-" and c["result"] == "successful"
    return c["size"] == "clear" and not silent and c["named"] not in KINDS[c["kind"]].found


def report(cases: list[Case], given: argparse.Namespace, every: list[tuple[str, str, str]]) -> str:
    cell: dict[tuple, list[Case]] = defaultdict(list)
    for c in cases:
        cell[c["kind"], c["size"], c["bench"]].append(c)
    missing = [", ".join(x) for x in every if x not in cell]
    few = [", ".join(x) for x in every if 0 < len(cell[x]) < given.seeds]
    far = [c for c in cases if max(c["after"].values(), default=0.0) > FAR]
    return "\n".join([
        "# Effects of the registry, as fits find them", "",
        f"Made by `python benchmarks/effects.py --seeds {given.seeds}` on {date.today()}, seeds from"
        f" {FIRST_SEED} on.", "",
        f"Not made: {'; '.join(missing) or 'nothing'}.", "",
        *([f"Of fewer seeds: {'; '.join(few)}.", ""] if few else []),
        __doc__.partition("\n\n")[2].partition("    --seeds")[0].rstrip(), "",
        "| effect | size | logs | found | successful | worst before | worst after | rms after |",
        "|---|---|---|---|---|---|---|---|",
        *(row(cell[x]) for x in every if cell[x]), "",
        "## What was named first, of small ones/of clear ones", "", *confusion(cases), "",
        f"## Successful, and more than {FAR:g} errors off", "",
        "`import sysid; from effects_made import made; print(sysid.fit(made(...)))` in `benchmarks/` makes"
        " one of them again.", "",
        *(listed(far) or ["None."]), "",
        "## A clear effect that is named first as something else, or spoils the fit without a name", "",
        *(listed(filter(wrong, cases)) or ["None."]), "",
        f"## Fits that took more than {LONG:g} s of processor time, compiling included", "",
        *(listed(c for c in cases if c["seconds"] > LONG) or ["None."]), "",
    ])  # fmt: skip


def fits(wanted: list[tuple], jobs: int, until: float) -> Iterator[Case]:
    """Each as it is done, those that are begun before `until` (s, `time.monotonic`)."""
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        left, running = iter(wanted), set()
        while True:
            fresh = islice(left, jobs - len(running) if time.monotonic() < until else 0)
            running |= {pool.submit(case, *at) for at in fresh}
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (each.result() for each in done)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", default="")
    parser.add_argument("--cases", type=Path)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--jobs", type=int, default=1)
    given, begun = parser.parse_args(), time.monotonic()
    every = list(cells(given.only))
    kept = given.cases.read_text().splitlines() if given.cases and given.cases.exists() else []
    cases = {(c["kind"], c["size"], c["bench"], c["seed"]): c for c in map(json.loads, kept)}
    wanted = [(*x, FIRST_SEED + k) for k in range(given.seeds) for x in every]
    left = [at for at in wanted if at not in cases]
    for made_now in fits(left, given.jobs, begun + 60 * given.minutes):
        cases[made_now["kind"], made_now["size"], made_now["bench"], made_now["seed"]] = made_now
        print(*listed([made_now]), flush=True)
        if given.cases:
            with given.cases.open("a") as file:
                file.write(json.dumps(made_now) + "\n")
    if not given.only:
        WHERE.write_text(report([cases[at] for at in wanted if at in cases], given, every))


if __name__ == "__main__":
    main()
