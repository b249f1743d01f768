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
"""

import argparse
import os
from collections import Counter
from pathlib import Path

import peers
from cases import CASES, GROUPS, NO_LOG_CAN_TELL
from rich.console import Console
from rich.progress import track
from verdicts import VERDICTS, Answer, as_it_must, ours

WHERE = Path(__file__).parents[1] / "hard_logs.md"
Answers = dict[str, dict[str, list[Answer]]]  # by program and case


def answered(name: str, seeds: int) -> dict[str, list[Answer]]:
    """By program."""
    case = CASES[name]
    found = {"sysid": [ours(case, seed) for seed in range(seeds)]}
    return found | {peer: [peers.theirs(peer, case, seed) for seed in range(seeds)] for peer in peers.PEERS}


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
    lines = [
        "# Hard logs",
        "",
        f"Made by `{command}`.",
        "",
        __doc__.partition("\n\n")[2].partition(" Writes")[0],
        "",
    ]
    lines += [peers.__doc__.partition("\n\n")[2], ""]
    seen = [name for group in GROUPS.values() for name in group]
    lines += [f"## {len(seen)} cases whose logs hold what is wrong", "", *counted(found, seen), ""]
    wrong = {n: next((a for a in found["sysid"][n] if not as_it_must(CASES[n], a)), None) for n in seen}
    odd = [
        f"- {n}, where it must be {CASES[n].must}: {a.verdict}: {a.said}"
        for n, a in wrong.items()
        if a is not None
    ]
    lines += [
        "Each answer of sysid is what it must be, and says why."
        if not odd
        else "Answers of sysid that are not what they must be:",
        "",
        *odd,
    ]
    lines += [
        "In brackets the largest number of standard deviations by which something that was called determined is off.",
        "",
    ]
    for title, group in GROUPS.items():
        lines += [
            f"### {title}",
            "",
            "| case | must | " + " | ".join(found) + " |",
            "|" + "---|" * (len(found) + 2),
        ]
        lines += [
            f"| {name} | {case.must} | " + " | ".join(summary(of[name]) for of in found.values()) + " |"
            for name, case in group.items()
        ]
        lines.append("")
    lines += [
        "## Undetectable",
        "",
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
        first = found["sysid"][name][0]
        lines.append(f"| {name} | {summary(found['sysid'][name])} | {printed(first)} |")
    lines += [
        "",
        "## What was said",
        "",
        "Of the first answer of sysid that is not right (`--only NAME` shows all).",
        "",
        "```",
    ]
    told = {n: next((a for a in found["sysid"][n] if a.verdict != "right"), None) for n in CASES}
    return (
        "\n".join([*lines, *(f"{a.verdict}: {n}: {a.said}" for n, a in told.items() if a is not None), "```"])
        + "\n"
    )


def printed(answer: Answer) -> str:
    shown = answer.shown or {}
    tau, f0 = shown.get("tau"), shown.get("f0")
    Q = f"{3.141592653589793 * f0 * tau:.4g}" if f0 and tau else "-"
    return " | ".join([Q, f"{tau:.4g} s" if tau else "-", f"{f0:.7g} Hz" if f0 else "-"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only")
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    names = [name for name in CASES if given.only is None or given.only in name]
    found: Answers = {who: {} for who in ("sysid", *peers.PEERS)}
    for name in track(names, console=Console(stderr=True), disable=given.only is not None):
        for who, answers in answered(name, given.seeds).items():
            found[who][name] = answers
            for a in answers if given.only is not None else ():
                fits = "" if who != "sysid" or as_it_must(CASES[name], a) else f", must be {CASES[name].must}"
                print(
                    f"{name}: {who}: {a.verdict} (z {a.z:.3g}){fits}\n    " + a.said.replace(" | ", "\n    "),
                    flush=True,
                )
    if given.only is None:
        WHERE.write_text(table(found, f"python benchmarks/hard_logs --seeds {given.seeds}"), encoding="utf-8")


if __name__ == "__main__":
    main()
