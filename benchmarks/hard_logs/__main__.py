"""Logs that ought to be hard: read and fitted right, refused, flagged, or silently wrong?  python benchmarks/hard_logs

Each case spoils, or merely stretches, logs of the paper's plate (120 rows, noise of 1 % of the settled response per channel, a
rotated demodulator). It is made from each of a few seeds and fitted, and so it is by other programs. An answer is

    right            successful, tau determined, nothing more than FAR standard deviations off the plate the log was made from
    open             successful as far as it goes, but tau or G is called undetermined, with why
    refused          not read, or not called successful, with why
    flagged          successful and further off, but a warning is printed
    silently wrong   successful and further off, without a warning

`must` is what has to come out, and in cases.py beside it the words that have to be said. Writes hard_logs.md.

    --seeds N   how many of each (default 3)        --only NAME   cases whose name holds NAME; printed in full, not written
    --jobs N    processes (default 1)
"""

import argparse
import os
from collections import Counter
from datetime import date
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import peers
from answered import answered
from cases import CASES, GROUPS, NO_LOG_CAN_TELL
from rich.console import Console
from rich.progress import track
from verdicts import VERDICTS, Answer, as_it_must

WHERE = Path(__file__).parents[1] / "hard_logs.md"
Answers = dict[str, dict[str, list[Answer]]]  # by program and case


def counted(found: Answers, cases: dict) -> list[str]:
    """Rows of how often each verdict was given."""
    lines = ["| answers of | " + " | ".join(VERDICTS) + " |", "|" + "---|" * (len(VERDICTS) + 1)]
    for who, answers in found.items():
        counts = Counter(a.verdict for name in cases for a in answers[name])
        lines.append(f"| {who} | " + " | ".join(str(counts[v]) for v in VERDICTS) + " |")
    return lines


def summary(answers: list[Answer]) -> str:
    counts = Counter(a.verdict for a in answers)
    words = ", ".join(v if n == len(answers) else f"{n} {v}" for v, n in counts.items())
    z = max((a.z for a in answers if a.verdict in ("right", "flagged", "silently wrong")), default=None)
    return words if z is None else f"{words} ({z:.2g})"


def table(found: Answers, command: str) -> str:
    """The study as Markdown."""
    said = __doc__.partition("\n\n")[2].partition(" Writes")[0]
    by_peers = peers.__doc__.partition("\n\n")[2]
    lines = ["# Hard logs", "", f"Made by `{command}` on {date.today()}.", "", said, "", by_peers, ""]
    seen = [name for group in GROUPS.values() for name in group]
    lines += [f"## {len(seen)} cases whose logs hold what is wrong", "", *counted(found, seen), ""]
    lines += [*not_as_they_must(found["sysid"], seen), ""]
    for title, group in GROUPS.items():
        lines += [f"### {title}", "", "| case | must | " + " | ".join(found) + " |"]
        lines += ["|" + "---|" * (len(found) + 2)]
        lines += [
            f"| {name} | {case.must} | " + " | ".join(summary(of[name]) for of in found.values()) + " |"
            for name, case in group.items()
        ]
        lines.append("")
    return "\n".join([*lines, *undetectable(found), *was_said(found["sysid"])]) + "\n"


def not_as_they_must(found: dict[str, list[Answer]], cases: list[str]) -> list[str]:
    """The first answer of each case that is not what it must be."""
    wrong = {n: next((a for a in found[n] if not as_it_must(CASES[n], a)), None) for n in cases}
    odd = [f"- {n}, where it must be {CASES[n].must}: {a.verdict}: {a.said}" for n, a in wrong.items() if a]
    head = "Answers of sysid that are not what they must be:"
    return [
        *([head, "", *odd, ""] if odd else ["Each answer of sysid is what it must be, and says why.", ""]),
        "In brackets the largest number of standard deviations by which something that was called determined is off.",
    ]


def undetectable(found: Answers) -> list[str]:
    """The section of the logs of another plate."""
    lines = ["## Undetectable", ""]
    lines += [
        "Each of these logs is that of another plate. What is printed is there to be doubted by a person.",
        "",
    ]
    lines += [
        *counted(found, NO_LOG_CAN_TELL),
        "",
        "| case | sysid | prints Q | tau | f0 |",
        "|---|---|---|---|---|",
    ]
    for name in NO_LOG_CAN_TELL:
        answers = found["sysid"][name]
        lines.append(f"| {name} | {summary(answers)} | {printed(answers[0])} |")
    return [*lines, ""]


def was_said(found: dict[str, list[Answer]]) -> list[str]:
    """The words of the first answer of each case that is not right."""
    told = {n: next((a for a in found[n] if a.verdict != "right"), None) for n in CASES}
    said = [f"{a.verdict}: {n}: {a.said}" for n, a in told.items() if a is not None]
    about = "Of the first answer of sysid that is not right (`--only NAME` shows all)."
    return ["## What was said", "", about, "", "```", *said, "```"]


def printed(answer: Answer) -> str:
    shown = answer.shown or {}
    tau, f0 = shown.get("tau"), shown.get("f0")
    Q = f"{3.141592653589793 * f0 * tau:.4g}" if f0 and tau else "-"
    return " | ".join([Q, f"{tau:.4g} s" if tau else "-", f"{f0:.7g} Hz" if f0 else "-"])


def tell(name: str, who: str, answers: list[Answer]) -> None:
    """Prints them in full."""
    for a in answers:
        fits = "" if who != "sysid" or as_it_must(CASES[name], a) else f", must be {CASES[name].must}"
        said = a.said.replace(" | ", "\n    ")
        print(f"{name}: {who}: {a.verdict} (z {a.z:.3g}){fits}\n    {said}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    names = [name for name in CASES if given.only is None or given.only in name]
    found: Answers = {who: {} for who in ("sysid", *peers.PEERS)}
    with get_context("spawn").Pool(given.jobs) as workers:
        every = workers.imap(partial(answered, given.seeds), names)
        shown = track(every, total=len(names), console=Console(stderr=True), disable=given.only is not None)
        for name, by_program in zip(names, shown, strict=True):
            for who, answers in by_program.items():
                found[who][name] = answers
                if given.only is not None:
                    tell(name, who, answers)
    if given.only is None:
        WHERE.write_text(table(found, f"python benchmarks/hard_logs --seeds {given.seeds}"), encoding="utf-8")


if __name__ == "__main__":
    main()
