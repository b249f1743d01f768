"""Logs of the kinds that people bring, with known truth: what is said of them.  python benchmarks/kinds.py --seeds 7

Each kind is made in three variants or more, from closed forms that share no code with the package. An answer is

    right            successful, and every determined number within FAR of its standard deviations of the truth
    told             not successful, or no number that is further off is determined, and no cause is named that is not there
    wrong cause      a cause is named that is not there
    perhaps          the same, but of it is said that chance alone looks like this in one good fit of a hundred
    silently wrong   successful with a determined number further off

"No known effect explains it" names no cause. Where the program has no model of the kind, "told" is all that can be had.
Writes kinds.md beside itself.

    --seeds N   of each variant (default 7)        --only NAME   kinds whose name holds NAME; printed, not written
    --jobs N    so many at once (default 1)
"""

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import date
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path

import numpy as np
from kinds_made import (
    amplitude_feedthrough,
    beats,
    cabled,
    coupled,
    creeping,
    damped,
    drifting,
    heating,
    hurried,
    k_T_untold,
    lagging,
    late_sensor,
    low_pass,
    modes,
    overshoot,
    raw_oscillation,
    restless,
    ring_down,
    small_drive,
    staircase,
    two_modes,
    two_rates,
    unlike,
    wait_and_read,
)

from sysid import Log, fit

WHERE = Path(__file__).with_suffix(".md")
FAR = 4.0  # standard deviations: chance does it once in 16 000
CAUSES = {
    "saturation": "compressed|saturated",
    "second resonance": "a second resonance",
    "late": "begins late|s behind the inputs",
    "early": "before it should|s before the inputs",
    "too fast": "swept too fast",
    "drift": "drifts",
    "amplitude": "depends? on the amplitude",
    "noise": "noise hides|noise or background hide",
    "filter": "filter is stated; one of",
    "contradiction": "contradict",
    "immediate": "is there within a row",
    "restless": "restless",
    "no resonance": "no resonance is seen",
    "one reading": "one reading decides",
    "offset": "an offset of d and q",
    "feedthrough": "lies a feedthrough",
    "mirrored": "turns the other way",
    "overshoot": "of second order: it overshoots",
    "oscillation": "an oscillation itself",
    "drive": "not proportional to the drive",
    "asymmetric": "another time constant than it rises",
    "second pole": "a second time constant",
    "image": "d and q are not alike",
    "high-pass": "AC coupling",
    "cable": "as behind a delay",
    "lag": "behind the plate's",
}


@dataclass(frozen=True)
class Kind:
    """A kind: its variants by what they are called, each from a generator of random numbers; the truth of what they determine;
    the causes that are there."""

    variants: dict[str, Callable[[np.random.Generator], tuple[list[Log], dict[str, float]]]]
    causes: tuple[str, ...] = ()
    modelled: bool = field(default=True)


KINDS = {
    "half of the step settles at once": Kind(
        {"fast 1 ms": two_rates(1e-3, 0.5), "fast 2 ms": two_rates(2e-3, 0.4), "at once": two_rates(1e-5, 0.6)}, ("immediate",)),
    "a second-order step": Kind({f"zeta {z}": overshoot(z) for z in (0.05, 0.3, 0.6)}, ("overshoot",), False),
    "ring-down of amplitudes on an offset": Kind(
        {"below": ring_down(-0.3, 0.6), "above": ring_down(0.3, 0.6), "far": ring_down(0.8, 1.0)}, ("offset",)),
    "sweep, set, wait, read": Kind(
        {"own": wait_and_read(True, 2.5), "before": wait_and_read(False, 2.5), "own, slow": wait_and_read(True, 3.5),
         "own, back": wait_and_read(True, 1.5, back=True)}),
    "chirp": Kind({f"dwell {d} tau": wait_and_read(True, d, runs=True) for d in (0.5, 1.0, 2.0)}),
    "sweep too fast, without times": Kind({f"dwell {d} tau": hurried(d) for d in (0.4, 0.7, 1.0)}, ("too fast",)),
    "feedthrough under amplitudes": Kind({f"{s:.0%}": amplitude_feedthrough(s) for s in (0.02, 0.05, 0.1)}, ("feedthrough",)),
    "two modes, amplitudes": Kind(
        {"3 apart": two_modes(3.0, 0.7), "4 apart": two_modes(4.5, 0.9), "6 apart": two_modes(6.0, 0.5)}, ("second resonance",)),
    "an oscillation that was not demodulated": Kind(
        {f"period {p} s": raw_oscillation(p) for p in (0.3, 0.53, 0.9)}, ("oscillation",), False),
    "a low-pass": Kind({f"tau {t:g} s": low_pass(t) for t in (1e-4, 7e-4, 1e-2)}, ("no resonance",), False),
    "a drive of 1e-9 to 1e7 V": Kind({f"{v:g} V": small_drive(v) for v in (1e-9, 1e-7, 1e7)}),
    "a step that is late, beside a sweep": Kind({f"{t * 1e3:g} ms": late_sensor(t) for t in (0.1e-3, 0.3e-3, 0.5e-3)}, ("late", "filter")),
    "k_T not told": Kind({f"{s} degC": k_T_untold(s) for s in (0.5, 0.8, 1.0)}),
    "another mode": Kind({
        f"{a} half bandwidths off, {s:.0%}, {w} times as slow": modes(a, s, w)
        for a, s, w in ((4, 0.2, 0.6), (9, 0.05, 1.7), (-7, 0.5, 1.0), (14.3, 0.2, 0.6))
    }, ("second resonance",)),
    "a decay that beats": Kind({f"{a} / tau, {s:.0%}": beats(a, s) for a, s in ((3, 0.2), (9, 0.05), (-12, 0.1))}, ("second resonance",)),
    "a resonance that drifts": Kind({f"{s} half bandwidths": drifting(s) for s in (0.1, -0.4, 1.2)}, ("drift",)),
    "a plate that heats itself": Kind({f"{s}, {t} s": heating(s, t) for s, t in ((0.3, 3.0), (1.0, 10.0), (-0.5, 40.0))}, ("drift",)),
    "a thermometer that lags": Kind({f"{t} s": lagging(t) for t in (1.0, 3.0, 8.0)}, ("lag",)),
    "an offset that drifts": Kind({f"{s:.0%}": creeping(s) for s in (0.03, 0.1, 0.4)}, ("drift", "high-pass")),  # of what has settled the same
    "AC coupling": Kind({f"{t * 1e3:g} ms": coupled(t) for t in (6e-3, 12e-3, 50e-3)}, ("high-pass",)),
    "channels that are not alike": Kind({f"{g}": unlike(g) for g in (0.97, 0.9, 1.2)}, ("image",)),
    "a cable": Kind({f"{x} rad": cabled(x) for x in (0.3, 2.5, -6.0)}, ("cable",)),
    "damping by the amplitude": Kind({f"{c}, power {p}": damped(c, p) for c, p in ((0.2, 2), (0.8, 2), (0.5, 1))}, ("amplitude",)),
    "a drive that does not act in proportion": Kind({
        "its square": staircase(np.square, [0.0, 2.0, 4.0, 6.0, 8.0]), "its root": staircase(np.sqrt, [0.0, 8.0, 4.0, 1.0]),
        "a dead band": staircase(lambda v: max(v - 1.0, 0.0), [0.0, 2.0, 4.0, 8.0]),
    }, ("drive",), False),
    "a heater with a fan": Kind({f"{x} times as fast": staircase(float, [0.0, 5.0, 0.0, 8.0, 3.0], x) for x in (1.1, 1.6, 0.5)}, ("asymmetric",), False),
    "two time constants": Kind({f"{x:.0%}": staircase(float, [0.0, 5.0, 0.0, 8.0], body=x) for x in (0.1, 0.3, 0.6)}, ("second pole",), False),
    "restless, then a decay": Kind({f"swing {s}": restless(s) for s in (0.02, 0.05, 0.1)}, ("restless",)),
}  # fmt: skip


def verdict(kind: Kind, logs: list[Log], truth: dict[str, float]) -> tuple[str, str]:
    """The answer's class, and what was said."""
    found = fit(logs)
    values = {n: p for n, p in found.parameters.items() if p.determined and n in truth}
    off = {n: abs(p.value - truth[n]) / p.std for n, p in values.items()}
    why = [p.why or "" for p in found.parameters.values()]
    said = " | ".join(
        [
            found.result.name,
            *(f"{n} {p.value:.8g} +- {p.std:.2g}" for n, p in values.items()),
            *found.warnings,
        ]
    )
    sure = [w for w in found.warnings if "perhaps: chance" not in w]
    named, hinted = (
        {name for name, words in CAUSES.items() if re.search(words, " ".join((*said_of, *why)))}
        for said_of in (sure, found.warnings)
    )
    if found.result.name == "successful" and (
        max(off.values(), default=0.0) > FAR or not (truth or kind.modelled)
    ):
        return "silently wrong", said
    if wrong := named - set(kind.causes):
        return "wrong cause", f"({', '.join(sorted(wrong))}) {said}"
    if wrong := hinted - set(kind.causes):
        return "perhaps", f"({', '.join(sorted(wrong))}) {said}"
    return ("right" if found.result.name == "successful" else "told"), said


def answer(at: tuple[str, str, int]) -> tuple[str, str]:
    """Of a variant of a kind, from a seed: the answer's class, and what was said."""
    name, variant, seed = at
    k, kind = list(KINDS).index(name), KINDS[name]
    made = kind.variants[variant](np.random.default_rng([k, list(kind.variants).index(variant), seed]))
    return verdict(kind, *made)


def rows(kinds: dict[str, Kind], seeds: int, workers: Pool) -> Iterator[str]:
    """A row of the table for each variant; what is wrong is printed in full."""
    each = [(name, variant) for name, kind in kinds.items() for variant in kind.variants]
    every = workers.imap(answer, [(*at, seed) for at in each for seed in range(seeds)])
    for name, variant in each:
        answers = [next(every) for _ in range(seeds)]
        counts = Counter(a for a, _ in answers)
        for word, said in answers:
            if word in ("silently wrong", "wrong cause", "perhaps"):
                print(f"{name}, {variant}: {word}: {said}", flush=True)
        first = answers[0][1].replace("|", "/")[:160]
        cells = [str(counts[a]) for a in ("right", "told", "wrong cause", "perhaps", "silently wrong")]
        yield f"| {name} | {variant} | {' | '.join(cells)} | {first} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=7)
    parser.add_argument("--only", default="")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    kinds = {name: kind for name, kind in KINDS.items() if given.only in name}
    with get_context("spawn").Pool(given.jobs) as workers:
        made = list(rows(kinds, given.seeds, workers))
    table = [
        "# Logs of the kinds that people bring", "",
        f"Made by `python benchmarks/kinds.py --seeds {given.seeds}` on {date.today()}.", "", __doc__.partition("\n\n")[2].partition("Writes")[0],
        "| kind | variant | right | told | wrong cause | perhaps | silently wrong | the first answer |", "|---|---|---|---|---|---|---|---|",
        *made, "",
    ]  # fmt: skip
    if given.only:
        print("\n".join(table))
    else:
        WHERE.write_text("\n".join(table), encoding="utf-8")


if __name__ == "__main__":
    main()
