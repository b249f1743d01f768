"""Does an experiment that is advised do what is promised of it?  python benchmarks/advice.py --logs 300

Each seed is one of `cannot_tell.py`: a random plant, and logs that leave one parameter open. `sysid.advise` is asked for that
parameter, its first experiment is recorded (by `tests/reference.py`, which shares no code with the package) with the bench's own
noise and rotation, and all logs are fitted again. Counted is the standard deviation that was promised over the one there is.
Nothing can be advised where tau is not known at all. Where the logs leave open what the experiment brings, the promise is two
numbers, between which the standard deviation will be in nine plates of ten: it is kept if the one there is lies no more than 20 %
beyond the nearer of them. Writes advice.md beside itself.

    --logs N    how many seeds (default 300)    --seed S    the first one (default 0)
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from cannot_tell import CAUSES, LOUD, Bench, bench, farthest  # noqa: E402

from sysid import Log, advise, fit  # noqa: E402
from sysid.precision import keep_programs  # noqa: E402

REACHED = (24.0, 34.0)  # degC that the bench can be brought to


@dataclass(frozen=True)
class Outcome:
    """One seed. `ratio`: promised over had (NaN: the parameter is not determined afterwards, or nothing was advised)."""

    seed: int
    cause: str
    advised: bool
    rough: bool = False
    ratio: float = np.nan
    beyond: float = np.nan  # by what factor it is outside what was promised (1: it is not)
    z: float = 0.0  # largest |value - truth|/std of what is then called determined
    said: str = ""


def recorded(made: Bench, experiment, like: Log) -> Log:
    """The bench's log of an experiment."""
    blank = experiment.log(np.zeros(experiment.rows, complex), like)
    log = made.log(experiment.kind, blank.drive, blank.frequency, blank.temperature, blank.time)
    return experiment.log(np.abs(log.response) if like.amplitude_only else log.response, like)


def outcome(seed: int) -> Outcome:
    cause, made = bench(seed)
    name, logs = CAUSES[cause].parameter, CAUSES[cause].logs(made)
    if cause == "noise hides the transient":  # of the logs there are, and of those to come
        made = replace(made, noise=LOUD * made.noise)
    found = fit(logs)
    if not (advice := advise(found, name, temperatures=REACHED)):
        return Outcome(seed, cause, False)
    best = advice[0]
    after = fit([*logs, recorded(made, best.experiment, logs[0])])
    p = after.parameters[name]
    told = p.determined and after.result.name == "successful"
    ratio = best.after / p.std if told else np.nan
    low, high = best.between
    beyond = max(low / p.std, p.std / high, 1.0) if told else np.inf
    said = f"{best}; then {f'{p.std:.2g}' if told else after.result.name}"
    return Outcome(seed, cause, True, best.rough, ratio, beyond, farthest(made, after), said)


def row(name: str, of: Sequence[Outcome]) -> str:
    ratios = np.array([o.ratio for o in of if np.isfinite(o.ratio)])
    advised = sum(o.advised for o in of)
    cells = [name, len(of), advised, len(ratios)]
    if len(ratios):
        low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
        kept = np.mean([o.beyond <= 1.2 for o in of if o.advised])
        cells += [
            f"{middle:.3f}",
            f"{low:.3f} to {high:.3f}",
            f"{100 * np.mean(np.abs(ratios - 1) <= 0.2):.1f} %",
            f"{100 * kept:.1f} %",
        ]
    else:
        cells += ["-", "-", "-", "-"]
    return "| " + " | ".join(map(str, cells)) + f" | {max((o.z for o in of), default=0.0):.2g} |"


def table(outcomes: Sequence[Outcome], command: str) -> str:
    """The study as Markdown."""
    lines = [
        "# Advice that is followed",
        "",
        f"Made by `{command}`.",
        "",
        __doc__.partition("\n\n")[2].partition("\n\n    --")[0],
        "",
    ]
    lines += [
        "| cause | logs | advised | then determined | promised/had, median | 5 to 95 % | within 20 % | kept | largest z |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    lines += [row(name, of) for name in CAUSES if (of := [o for o in outcomes if o.cause == name])]
    far = sorted((o for o in outcomes if o.advised and not o.beyond <= 1.2), key=lambda o: o.seed)
    sure = [o for o in outcomes if not o.rough]
    lines += [row("**all**", outcomes), row("**all of one number**", sure), "", "Not kept:", ""]
    return "\n".join([*lines, *(f"- seed {o.seed}, {o.cause}: {o.said}" for o in far[:40])]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        seeds = range(given.seed, given.seed + given.logs)
        outcomes = [outcome(seed) for seed in track(seeds, console=Console(stderr=True))]
    text = table(outcomes, f"python benchmarks/advice.py --logs {given.logs} --seed {given.seed}")
    (HERE / "advice.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
