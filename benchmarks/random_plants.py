"""Random plants fitted from nothing, against fits that start at the truth:  python benchmarks/random_plants.py --plants 300

Each plant has tau from 0.05 to 500 ms and Q from 10 to 50 000, and 1 to 10 logs of mixed kinds with rotation, feedthrough, offset
and noise. A fit from nothing has found the minimum when its cost is no higher than that of a fit that began at the truth.
The responses come from `tests/reference.py`, which shares no code with the package. Writes random_plants.md beside itself.

    --plants N     how many (default 200)         --seed S     the first one's seed (default 0)
    --jobs N       processes (default 1)
    --replay SEED  fit one plant again and print its logs and both fits
"""

import argparse
import runpy
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track

from sysid import Fit, Log, Plant, fit
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(
    **runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference")
)
ROWS = 120  # of every log, so that a dozen compiled programs serve all plants
LOW_Q = 20.0
# d/q logs, amplitude logs, weight. Few sizes of a group: each is one compilation.
MIXES = ((1, 0, 8), (2, 0, 3), (3, 0, 2), (6, 0, 2), (0, 1, 4), (0, 2, 2), (1, 1, 3), (8, 2, 2))
KINDS = ("step", "ring-down", "double step", "sweep", "frequency staircase")
AMPLITUDE_KINDS = ("sweep", "step")


@dataclass(frozen=True)
class Case:
    """A plant and its logs, with a line on what each log is."""

    seed: int
    truth: Plant
    logs: list[Log]
    lines: list[str]
    aliased: bool  # some transient turns by half a turn or more between two rows


def case(seed: int) -> Case:
    """The plant and the logs of one seed."""
    rng = np.random.default_rng(seed)
    tau, Q = np.exp(rng.uniform(np.log(5e-5), np.log(0.5))), np.exp(rng.uniform(np.log(10), np.log(5e4)))
    f0, half_bandwidth = Q / (np.pi * tau), 1 / (2 * np.pi * tau)
    warm = rng.choice(["none", "one", "spread"])
    k_T = half_bandwidth * rng.normal(0, 0.3) if warm == "spread" else 0.0
    truth = reference.Plant(G=float(np.exp(rng.normal())), tau=tau, f0=f0, k_T=k_T, ripple=Q < LOW_Q)
    weights = np.array([m[2] for m in MIXES], float)
    dq, amplitude, _ = (
        MIXES[rng.choice(len(MIXES), p=weights / weights.sum())] if Q >= LOW_Q else MIXES[rng.choice([0, 4])]
    )
    logs, lines, aliased = [], [], False
    for i in range(dq + amplitude):
        only = i >= dq
        kind = str(rng.choice(_kinds(i, dq, only)))
        temperature = 24.0 + (rng.uniform(-10, 20) if warm == "spread" else 0.0)
        log, line, fast = one_log(rng, truth, kind, only, temperature, warm != "none", f"log{i}")
        logs.append(log)
        lines.append(line)
        aliased |= fast
    return Case(seed, Plant(truth.G, tau, f0, k_T), logs, lines, aliased)


def _kinds(i: int, dq: int, amplitude_only: bool) -> tuple[str, ...]:
    """What the log at place i may be. Of three or more d/q logs half are sweeps: with every number of sweeps from none to all, each
    a compiled program, the study would compile for most of its time."""
    if amplitude_only:
        return AMPLITUDE_KINDS
    if dq < 3:
        return KINDS
    return ("sweep",) if i < dq // 2 else tuple(k for k in KINDS if k != "sweep")


def one_log(
    rng, plant, kind: str, amplitude_only: bool, temperature: float, warm: bool, name: str
) -> tuple[Log, str, bool]:
    """A log of one kind, a line on it, and whether it turns too fast for its rows."""
    half_bandwidth = 1 / (2 * np.pi * plant.tau)
    at = plant.f0 + plant.k_T * (temperature - 24.0)
    noise = np.exp(rng.uniform(np.log(0.003), np.log(0.05)))
    volts, clock, sampling = 1.0 + rng.random(), None, None
    rows = np.arange(ROWS)
    if kind == "sweep":
        width = half_bandwidth * np.exp(rng.uniform(np.log(2), np.log(20)))
        width = min(width, 0.8 * at)
        centre = max(at + rng.uniform(-0.5, 0.5) * width, 1.05 * width)
        frequency, drive = centre + np.linspace(-width, width, ROWS), np.full(ROWS, volts)
        said, fast = (
            f"+-{width / half_bandwidth:.2g} hb about {(centre - at) / half_bandwidth:+.2g} hb",
            False,
        )
    else:
        window = plant.tau * np.exp(rng.uniform(0, np.log(20)))
        clock, sampling = window * rows / (ROWS - 10), "instant"
        detuning = half_bandwidth * rng.normal(0, 2)
        detuning = np.clip(detuning, -0.5 * at, None)
        levels = {
            "step": (0, 1),
            "ring-down": (0, 1, 0),
            "double step": (0, 0.5, 1),
            "frequency staircase": (0, 1),
        }[kind]
        edges = np.linspace(10, ROWS, len(levels)).astype(int)[: len(levels) - 1]
        drive = volts * np.array(levels)[np.searchsorted(edges, rows, side="right")]
        frequency = np.full(ROWS, at + detuning)
        if kind == "frequency staircase":
            frequency = at + detuning + half_bandwidth * np.repeat(rng.normal(0, 1.5, 6), ROWS // 6)
            frequency = np.maximum(frequency, 0.3 * at)
        dt = clock[1] - clock[0]
        fast = bool(np.max(np.abs(frequency - at)) > 0.5 / dt)
        said = f"{window / plant.tau:.2g} tau, {detuning / half_bandwidth:+.2g} hb"
    temperatures = np.full(ROWS, temperature)
    if clock is None:
        clean, felt = reference.steady(plant, drive, frequency, temperatures), drive
    else:
        clean, felt = (
            reference.ringing(plant, clock, drive, frequency, temperatures),
            np.append(0.0, drive[:-1]),
        )
    size = np.max(np.abs(clean))
    white = noise * size * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    if amplitude_only:
        response = np.abs(clean + white)
    else:
        leak, offset = (
            0.02 * plant.G * complex(*rng.normal(size=2)),
            0.01 * size * complex(*rng.normal(size=2)),
        )
        response = clean * np.exp(2j * np.pi * rng.random()) + leak * felt + offset + white
    log = Log(name, response, time=clock, drive=drive, frequency=frequency, sampling=sampling,
              temperature=temperatures if warm else None)  # fmt: skip
    return log, f"{kind}{' (amplitude)' if amplitude_only else ''} {said}, noise {100 * noise:.1f} %", fast


@dataclass(frozen=True)
class Outcome:
    """What became of one plant."""

    seed: int
    verdict: str
    informed: bool  # bound on tau below 20 %, no transient faster than its rows
    result: str
    score: float  # (log tau - truth)/std
    seconds: float
    text: str  # truth, logs, both fits


def outcome(seed: int) -> Outcome:
    """Fit the plant of `seed` from nothing and from the truth. A fit that raises is the worst outcome: counted and named."""
    made = case(seed)
    try:
        begun = time.perf_counter()
        found = fit(made.logs)
        seconds = time.perf_counter() - begun
        best = fit(made.logs, start=made.truth)
    except Exception as error:
        return Outcome(
            seed, "raised", True, "raised", np.nan, np.nan, f"seed {seed}: {type(error).__name__}: {error}"
        )
    excess = found.cost - best.cost
    verdict = "found" if excess <= 1e-6 else "within 0.01" if excess < 0.01 else "missed"
    state = found.modes[0]
    informed = bool(best.modes[0].covariance[1, 1] < 0.2**2) and not made.aliased
    score = float((state.theta[1] - np.log(made.truth.tau)) / np.sqrt(state.covariance[1, 1]))
    return Outcome(
        seed,
        verdict,
        informed,
        found.result.name,
        score,
        seconds,
        described(made, found, best, verdict, excess),
    )


def described(made: Case, a: Fit, b: Fit, verdict: str, excess: float) -> str:
    """A paragraph about one plant: its truth, its logs, both fits."""
    t = made.truth
    head = (
        f"seed {made.seed}: {verdict}, cost {excess:+.3g} above the truth's; tau {t.tau:.4g} s, Q {t.Q:.4g},"
        f" found tau {a.plant.tau:.4g} s, f0 {(a.plant.f0 - t.f0) * 2 * np.pi * t.tau:+.3g} half bandwidths off;"
        f" from the truth tau {b.plant.tau:.4g} s; results {a.result.name} / {b.result.name}; modes {len(a.modes)}"
    )
    return "\n".join([head, *(f"    {line}" for line in made.lines)])


def table(outcomes: list[Outcome], command: str) -> str:
    """The study as Markdown."""
    informed = [o for o in outcomes if o.informed]
    others = [o for o in outcomes if not o.informed]
    counts = Counter(o.verdict for o in informed)
    results = Counter(o.result for o in informed)
    good = [o for o in informed if o.verdict == "found" and o.result == "successful"]
    scores = np.array([o.score for o in good])
    lines = ["# Random plants, fitted from nothing", "", f"Made by `{command}`.", ""]
    lines += [
        f"{len(outcomes)} plants, of which the logs of {len(informed)} can tell tau (Cramer-Rao bound below 20 %, no transient"
    ]
    lines += [
        "that turns half a turn or more between two rows). The cost of the fit from nothing, against a fit from the truth:",
        "",
    ]
    lines += ["| | plants | % |", "|---|---|---|"]
    verdicts = [v for v in ("found", "within 0.01", "missed", "raised") if counts[v] or v == "found"]
    lines += [f"| {v} | {counts[v]} | {100 * counts[v] / max(len(informed), 1):.2f} |" for v in verdicts]
    lines += ["", f"`found`: no higher than 1e-6 above. How those fits end: {_counted(results)}."]
    lines += ["", f"The other {len(others)} end: {_counted(Counter(o.result for o in others))}."]
    if len(scores):
        lines += [
            "",
            f"(log tau - truth)/std of the successful: mean {scores.mean():+.3f}, standard deviation {scores.std():.3f},",
        ]
        lines += [f"largest {np.abs(scores).max():.1f} ({len(scores)} plants)."]
    lines += [
        "",
        f"Median time of a fit once its program is compiled: {np.nanmedian([o.seconds for o in outcomes]):.2f} s.",
    ]
    sections = {
        "Not found (replay with `--replay SEED`)": [o for o in informed if o.verdict != "found"],
        "Found, but not called successful": [
            o for o in informed if o.verdict == "found" and o.result != "successful"
        ],
        "Successful, but tau more than four standard deviations off": [o for o in good if abs(o.score) > 4],
    }
    for title, chosen in sections.items():
        if chosen:
            lines += ["", f"{title}:", "", "```", *(o.text for o in chosen[:MOST]), "```"]
            lines += [f"and {len(chosen) - MOST} more."] if len(chosen) > MOST else []
    return "\n".join(lines) + "\n"


MOST = 40  # plants described under each title


def _counted(names: Counter) -> str:
    return ", ".join(f"{name} {n}" for name, n in sorted(names.items()))


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--replay", type=int)
    given = parser.parse_args()
    if given.replay is not None:
        print(outcome(given.replay).text)
        return
    seeds, outcomes = range(given.seed, given.seed + given.plants), []
    # A process that has loaded hundreds of programs runs out of what an operating system maps: each serves 240 plants.
    spawn = get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        spawn.Pool(given.jobs, _begin, (folder,), maxtasksperchild=60) as workers,
    ):
        for o in track(
            workers.imap(outcome, seeds, chunksize=4), total=len(seeds), console=Console(stderr=True)
        ):
            outcomes.append(o)
            if o.informed and (o.verdict != "found" or o.result != "successful"):
                print(o.text, flush=True)
            if len(outcomes) % 500 == 0:
                write(outcomes, given)
    print(write(outcomes, given).split("\n\nNot found")[0])


def write(outcomes: list[Outcome], given: argparse.Namespace) -> str:
    """The table so far, into random_plants.md: a study that is cut short still counts."""
    text = table(
        outcomes,
        f"python benchmarks/random_plants.py --plants {len(outcomes)} --seed {given.seed} --jobs {given.jobs}",
    )
    (HERE / "random_plants.md").write_text(text, encoding="utf-8")
    return text


if __name__ == "__main__":
    main()
