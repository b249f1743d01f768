"""Do the 95 % intervals hold the truth 95 times in 100?  python benchmarks/coverage.py --seeds 2000 --jobs 2

Each case of `coverage_cases.py` is one or more noiseless logs of one plant (f0 32.3 kHz, tau 1.67 ms) and a kind of noise; each
seed draws that noise anew and fits from nothing. Counted is how often the interval of a parameter that the fit calls determined,
in a fit that it calls successful, holds the truth; what it refuses is counted beside it. Writes coverage.md beside itself.

    --seeds N      of each case (default 2000)      --posterior N  of these also sampled (default 200)
    --case NAME    those whose name holds NAME; printed, not written
    --seed S       the first one (default 0)        --jobs N       processes (default 1)
    --keep FOLDER  what is done already, by the same code, is read from there, and what is done now is kept there
"""

import argparse
import json
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

HERE = Path(__file__).parent
sys.path.append(str(HERE))  # at its end: a package is called coverage too

from coverage_cases import NAMES, PLANT, Case, bounds, every_case, reference, response  # noqa: E402

from sysid import Fit, Log, Parameter, fit, sample  # noqa: E402
from sysid.precision import keep_programs  # noqa: E402

# of the seeds determine a parameter that the case determines; of fewer, the noise has chosen which
MOSTLY = 0.9
CHUNK = 25  # seeds that a process takes at once


# --- one seed ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """One seed of a case: how the fit ended and what it said; of each parameter that it called determined, (value - truth)/std
    and std; of the sampled, whether the posterior's interval holds the truth; why the others are not determined."""

    case: str
    result: str
    said: str = ""
    scores: dict[str, float] = field(default_factory=dict)
    stds: dict[str, float] = field(default_factory=dict)
    held: dict[str, bool] = field(default_factory=dict)
    sampled: dict[str, bool] = field(default_factory=dict)
    why: dict[str, str] = field(default_factory=dict)


def logs_of(case: Case, seed: int) -> list[Log]:
    """The case's logs with the noise of one seed."""
    rng, logs = np.random.default_rng([seed, *case.name.encode()]), []
    for i, (inputs, bench) in enumerate(zip(case.logs, case.benches, strict=True)):
        n = len(inputs.drive)
        rows = response(PLANT, inputs, bench) + case.noise.draw(n, rng)
        warm = None if inputs.temperature is None else np.full(n, inputs.temperature)
        logs.append(
            Log(f"{inputs.name} {i + 1}", np.abs(rows) if inputs.amplitude_only else rows, time=inputs.time, drive=inputs.drive,
                frequency=inputs.frequency, temperature=warm, kind="steady" if inputs.time is None else "transient",
                sampling=None if inputs.time is None else "instant")
        )  # fmt: skip
    return logs


def outcome(case: Case, seed: int, posterior: bool = False) -> Outcome:
    """Fit one seed of a case. A fit that raises is counted and named."""
    try:
        found = fit(logs_of(case, seed))
        drawn = sample(found, seed=seed) if posterior and found.result.name == "successful" else None
    except Exception as error:
        return Outcome(case.name, "raised", f"{type(error).__name__}: {error}")
    why = {name: p.why for name, p in found.parameters.items() if not p.determined}
    if found.result.name != "successful":
        said = (
            found.warnings[-1:]
            if found.result.name == "misfit"
            else [w for w in (why.get("tau"), why.get("G")) if w]
        )
        return Outcome(case.name, found.result.name, next(iter(said), ""), why=why)
    known = {name: p for name, p in found.parameters.items() if p.determined}
    truth = truth_of(found)
    sampled = {}
    if drawn is not None and drawn.result.name == "successful":
        sampled = {n: _holds(p, truth[n]) for n, p in drawn.summary().items() if p.determined}
    return Outcome(
        case.name,
        found.result.name,
        scores={n: (p.value - truth[n]) / p.std for n, p in known.items()},
        stds={n: p.std for n, p in known.items()},
        held={n: _holds(p, truth[n]) for n, p in known.items()},
        sampled=sampled,
        why=why,
    )


def truth_of(found: Fit) -> dict[str, float]:
    """The plant, with f0 at the temperature of the fit."""
    at = found.reference_temperature
    warming = 0.0 if at is None else at - reference.REFERENCE_TEMPERATURE
    return {"G": PLANT.G, "tau": PLANT.tau, "f0": PLANT.f0 + PLANT.k_T * warming, "k_T": PLANT.k_T}


def _holds(p: Parameter, truth: float) -> bool:
    return bool(p.ci95[0] <= truth <= p.ci95[1])


# --- the tables -------------------------------------------------------------------------------------------------------


def coverage_rows(case: Case, outcomes: Sequence[Outcome]) -> list[str]:
    """The case's lines of the first table, one for each parameter that some seed determines."""
    known = bounds(case) if case.bounded else {}
    lines = []
    for name in NAMES:
        good = [o for o in outcomes if name in o.scores]
        if not good:
            continue
        scores, stds = np.array([o.scores[name] for o in good]), np.array([o.stds[name] for o in good])
        ratio = (
            f"{np.median(stds) / known[-1, name]:.3f}" if np.isfinite(known.get((-1, name), np.inf)) else ""
        )
        sampled = [o.sampled[name] for o in outcomes if name in o.sampled]
        told = len(good) / len(outcomes)
        judged = told >= MOSTLY
        shares = [_share([o.held[name] for o in good], judged), _share(sampled, judged) if sampled else ""]
        cells = [case.name, name, f"{100 * told:.1f}", *shares, ratio]
        lines.append("| " + " | ".join(cells) + f" | {scores.mean():+.2f} | {scores.std():.2f} |")
    return lines


def _share(held: Sequence[bool], judged: bool) -> str:
    """Percentage and its binomial error; bold when it is `judged` and lies outside 93 to 97 %."""
    p, n = float(np.mean(held)), len(held)
    text = f"{100 * p:.1f}"
    return f"{f'**{text}**' if judged and not 0.93 <= p <= 0.97 else text} ± {100 * np.sqrt(max(p * (1 - p), 1 / n) / n):.1f}"


def refusal_row(case: Case, outcomes: Sequence[Outcome]) -> str | None:
    """How the seeds of a case ended, if any was refused or left a parameter open, and what was said most often."""
    results = Counter(o.result for o in outcomes)
    ends = ", ".join(f"{name} {n}" for name, n in results.most_common())
    said = [f"{name}: {text}" for name, text in _most_said(outcomes).items()]
    if len(results) == 1 and "successful" in results and not said:
        return None
    return f"| {case.name} | {ends} | {'<br>'.join(said)} |"


def _most_said(outcomes: Iterable[Outcome]) -> dict[str, str]:
    """The sentence most often given, numbers aside, for each result that refuses, and for each parameter left open in a fit
    that is successful."""
    texts: dict[str, list[str]] = {}
    for o in outcomes:
        if o.result != "successful":
            texts.setdefault(o.result, []).append(o.said)
        else:
            for name, why in o.why.items():
                if name != "k_T":  # no temperatures
                    texts.setdefault(name, []).append(why)
    found = {}
    for name, sentences in texts.items():
        common, n = Counter(re.sub(r"[-+]?[\d.]+(e[-+]?\d+)?", "#", s) for s in sentences).most_common(1)[0]
        example = next(s for s in sentences if re.sub(r"[-+]?[\d.]+(e[-+]?\d+)?", "#", s) == common)
        found[f"{name} ({n} of {len(sentences)})"] = example
    return found


def table(outcomes: Sequence[Outcome], chosen: Sequence[Case], command: str) -> str:
    """The study as Markdown."""
    by_case = {case.name: [o for o in outcomes if o.case == case.name] for case in chosen}
    by_case = {name: found for name, found in by_case.items() if found}
    done = [case for case in chosen if case.name in by_case]
    lines = ["# Coverage of the 95 % intervals", "", f"Made by `{command}`.", "", INTRODUCTION]
    lines += ["| case | parameter | determined, % | covered, % | posterior, % | std/bound | mean z | sd z |"]
    lines += [
        "|---|---|---|---|---|---|---|---|",
        *(row for case in done for row in coverage_rows(case, by_case[case.name])),
    ]
    refused = [row for case in done if (row := refusal_row(case, by_case[case.name]))]
    lines += [
        "",
        "Seeds that were refused, and parameters left open:",
        "",
        "| case | ends | said most often |",
        "|---|---|---|",
    ]
    return "\n".join(lines + (refused or ["| none | | |"])) + "\n"


INTRODUCTION = """A plant of f0 32.3 kHz, tau 1.67 ms; a step of 200 rows at 10 kHz after 20 rows at rest, driven at f0; a sweep of 101 settled
points over +-500 Hz; noise of 1 % of the amplitude at resonance in each of Wd and Wq, unless the case says otherwise; every
nuisance free. `determined`: share of all seeds in which the fit is successful and the parameter determined; `covered`: share of
these whose interval, value +- 1.96 std, holds the truth, with its binomial error; bold outside 93 to 97 % where nine seeds in ten
or more determine the parameter (of fewer, the noise has chosen which). `posterior`: the same for the central interval of the
posterior's draws, over fewer seeds; an error is never below that of one seed. `std/bound`: median stated standard deviation over the
Cramer-Rao bound for the noise and the nuisances as they are. z = (value - truth)/std.

G of a lone step is covered too often, and far below the bound: what tells it from a feedthrough and a lateness is that these
would have to cancel (`sysid/verdict/gain_confounding.py`). On these benches neither is there, or one of them; where both are drawn from their
priors calibration.md counts. Amplitudes of coloured noise: the likelihood is an approximation (`sysid/trials/projected.py`).
Noise of 20 % and 30 %: this interval is symmetric and normal, which the posterior of such logs is not; what the program reports is the
posterior's. Over all 2000 seeds (`--case "noise 30 %, sweep" --posterior 2000`) it covers G in 96.1, tau in 94.0, f0 in 93.6 %, and of the
amplitudes with noise of 20 % 94.7, 94.6 and 94.5 %.
"""


def chunks(chosen: Sequence[Case], given: argparse.Namespace) -> list[tuple[str, int, int, int]]:
    """(case, first seed, one past the last, how many of them are sampled): what one process does at once."""
    found = []
    for case in chosen:
        for k in range(0, given.seeds, CHUNK):
            n = min(CHUNK, given.seeds - k)
            found.append((case.name, given.seed + k, given.seed + k + n, min(max(given.posterior - k, 0), n)))
    return found


def work(chunk: tuple[str, int, int, int]) -> list[Outcome]:
    name, first, last, sampled = chunk
    case = next(case for case in every_case() if case.name == name)
    return [outcome(case, seed, seed - first < sampled) for seed in range(first, last)]


def kept(folder: Path, chunk: tuple[str, int, int, int]) -> Path:
    name, *rest = chunk
    return folder / f"{re.sub(r'[^a-z0-9.]+', '_', name.lower())}-{'-'.join(map(str, rest))}.json"


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2000)
    parser.add_argument("--posterior", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", default="")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    chosen = [case for case in every_case() if given.case in case.name]
    todo, outcomes = chunks(chosen, given), []
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
        done = [path for chunk in todo if (path := kept(given.keep, chunk)).exists()]
        outcomes = [Outcome(**o) for path in done for o in json.loads(path.read_text(encoding="utf-8"))]
        todo = [chunk for chunk in todo if not kept(given.keep, chunk).exists()]
    command = f"python benchmarks/coverage.py --seeds {given.seeds} --posterior {given.posterior} --seed {given.seed}"
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # a process takes one core: threads that wait for one another take many
    # A process that has loaded hundreds of programs runs out of what an operating system maps: each serves 10 chunks.
    pool = {"processes": given.jobs, "initializer": _begin, "maxtasksperchild": 10}
    with (
        tempfile.TemporaryDirectory() as folder,
        get_context("spawn").Pool(**pool, initargs=(folder,)) as workers,
    ):
        for chunk, found in zip(
            todo, track(workers.imap(work, todo), total=len(todo), console=Console(stderr=True)), strict=True
        ):
            outcomes += found
            if given.keep:
                kept(given.keep, chunk).write_text(json.dumps([vars(o) for o in found]), encoding="utf-8")
    if not given.case:
        (HERE / "coverage.md").write_text(table(outcomes, chosen, command), encoding="utf-8")
    print(table(outcomes, chosen, command))


if __name__ == "__main__":
    main()
