"""Random plants fitted from nothing, against fits that start at the truth:  python benchmarks/random_plants.py --plants 300

Each plant has tau from 0.05 to 500 ms and Q from 10 to 50 000, and 1 to 10 logs of mixed kinds with rotation, feedthrough, offset
and noise. A fit from nothing has found the minimum when its cost is no higher than that of a fit that began at the truth.
The responses come from `data/synthetic/make.py`, which shares no code with the package. Writes random_plants.md beside itself.

    --plants N     how many (default 200)         --seed S     the first one's seed (default 0)
    --replay SEED  fit one plant again and print its logs and both fits
"""

import argparse
import runpy
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from sysid import Fit, Log, Plant, fit

HERE = Path(__file__).parent
make = SimpleNamespace(**runpy.run_path(str(HERE.parent / "data" / "synthetic" / "make.py")))
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
    truth = make.Plant("R", G=float(np.exp(rng.normal())), tau=tau, f0=f0, k_T=k_T, ripple=Q < LOW_Q)
    weights = np.array([m[2] for m in MIXES], float)
    dq, amplitude, _ = MIXES[rng.choice(len(MIXES), p=weights / weights.sum())] if Q >= LOW_Q else MIXES[rng.choice([0, 4])]
    logs, lines, aliased = [], [], False
    for i in range(dq + amplitude):
        only = i >= dq
        kind = str(rng.choice(AMPLITUDE_KINDS if only else KINDS))
        temperature = 24.0 + (rng.uniform(-10, 20) if warm == "spread" else 0.0)
        log, line, fast = one_log(rng, truth, kind, only, temperature, warm != "none", f"log{i}")
        logs.append(log)
        lines.append(line)
        aliased |= fast
    return Case(seed, Plant(truth.G, tau, f0, k_T), logs, lines, aliased)


def one_log(rng, plant, kind: str, amplitude_only: bool, temperature: float, warm: bool, name: str) -> tuple[Log, str, bool]:
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
        said, fast = f"+-{width / half_bandwidth:.2g} hb about {(centre - at) / half_bandwidth:+.2g} hb", False
    else:
        window = plant.tau * np.exp(rng.uniform(0, np.log(20)))
        clock, sampling = window * rows / (ROWS - 10), "instant"
        detuning = half_bandwidth * rng.normal(0, 2)
        detuning = np.clip(detuning, -0.5 * at, None)
        levels = {"step": (0, 1), "ring-down": (0, 1, 0), "double step": (0, 0.5, 1), "frequency staircase": (0, 1)}[kind]
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
        clean, felt = make.steady(plant, drive, frequency, temperatures), drive
    else:
        clean, felt = make.ringing(plant, clock, drive, frequency, temperatures), np.append(0.0, drive[:-1])
    size = np.max(np.abs(clean))
    white = noise * size * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    if amplitude_only:
        response = np.abs(clean + white)
    else:
        leak, offset = 0.02 * plant.G * complex(*rng.normal(size=2)), 0.01 * size * complex(*rng.normal(size=2))
        response = clean * np.exp(2j * np.pi * rng.random()) + leak * felt + offset + white
    log = Log(name, response, time=clock, drive=drive, frequency=frequency, sampling=sampling,
              temperature=temperatures if warm else None)  # fmt: skip
    return log, f"{kind}{' (amplitude)' if amplitude_only else ''} {said}, noise {100 * noise:.1f} %", fast


@dataclass(frozen=True)
class Outcome:
    """What became of one plant."""

    case: Case
    found: Fit
    best: Fit
    seconds: float

    @property
    def excess(self) -> float:
        """Cost of the fit from nothing above that of the fit from the truth."""
        return self.found.cost - self.best.cost

    @property
    def informed(self) -> bool:
        """The logs can tell: bound on tau below 20 %, no transient faster than its rows."""
        return bool(self.best.modes[0].covariance[1, 1] < 0.2**2) and not self.case.aliased

    @property
    def verdict(self) -> str:
        if not np.isfinite(self.excess):
            return "not finite"
        return "found" if self.excess <= 1e-6 else "within 0.01" if self.excess < 0.01 else "missed"

    @property
    def score(self) -> tuple[float, ...]:
        """(value - truth)/std of log tau, and of f0 where both have it."""
        state = self.found.modes[0]
        theta, std = state.theta, np.sqrt(np.diag(state.covariance))
        return (float((theta[1] - np.log(self.case.truth.tau)) / std[1]),)


def outcome(seed: int) -> Outcome:
    made = case(seed)
    begun = time.perf_counter()
    found = fit(made.logs)
    seconds = time.perf_counter() - begun
    return Outcome(made, found, fit(made.logs, start=made.truth), seconds)


def described(o: Outcome) -> str:
    """A paragraph about one plant: its truth, its logs, both fits."""
    t, a, b = o.case.truth, o.found, o.best
    head = (
        f"seed {o.case.seed}: {o.verdict}, cost {o.excess:+.3g} above the truth's; tau {t.tau:.4g} s, Q {t.Q:.4g},"
        f" found tau {a.plant.tau:.4g} s, f0 {(a.plant.f0 - t.f0) * 2 * np.pi * t.tau:+.3g} half bandwidths off;"
        f" from the truth tau {b.plant.tau:.4g} s; results {a.result.name} / {b.result.name}; modes {len(a.modes)}"
    )
    return "\n".join([head, *(f"    {line}" for line in o.case.lines)])


def table(outcomes: list[Outcome], command: str) -> str:
    """The study as Markdown."""
    informed = [o for o in outcomes if o.informed]
    others = [o for o in outcomes if not o.informed]
    counts = Counter(o.verdict for o in informed)
    results = Counter(o.found.result.name for o in informed)
    scores = np.array([o.score[0] for o in informed if o.verdict == "found" and o.found.result.name == "successful"])
    lines = ["# Random plants, fitted from nothing", "", f"Made by `{command}`.", ""]
    lines += [f"{len(outcomes)} plants, of which the logs of {len(informed)} can tell tau (Cramer-Rao bound below 20 %, no transient"]
    lines += ["that turns half a turn or more between two rows). The cost of the fit from nothing, against a fit from the truth:", ""]
    lines += ["| | plants |", "|---|---|"]
    lines += [f"| {name} | {counts[name]} |" for name in ("found", "within 0.01", "missed", "not finite") if counts[name] or name == "found"]
    lines += ["", "`found`: no higher than 1e-6 above. How those fits end: "]
    lines[-1] += ", ".join(f"{name} {n}" for name, n in sorted(results.items())) + "."
    lines += ["", f"The other {len(others)} end: " + ", ".join(f"{k} {n}" for k, n in sorted(Counter(o.found.result.name for o in others).items())) + "."]
    if len(scores):
        lines += ["", f"(log tau - truth)/std of the successful: mean {scores.mean():+.2f}, standard deviation {scores.std():.2f},"]
        lines += [f"largest {np.abs(scores).max():.1f} ({len(scores)} plants)."]
    lines += ["", f"Median time of a fit once its program is compiled: {np.median([o.seconds for o in outcomes]):.2f} s."]
    bad = [o for o in informed if o.verdict in ("missed", "not finite")]
    if bad:
        lines += ["", "Missed (replay with `--replay SEED`):", "", "```", *(described(o) for o in bad), "```"]
    odd = [o for o in informed if o.verdict == "found" and o.found.result.name not in ("successful",)]
    if odd:
        lines += ["", "Found, but not called successful:", "", "```", *(described(o) for o in odd), "```"]
    far = [o for o in informed if o.verdict == "found" and o.found.result.name == "successful" and abs(o.score[0]) > 4]
    if far:
        lines += ["", "Successful, but tau more than four standard deviations off:", "", "```", *(described(o) for o in far), "```"]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--replay", type=int)
    given = parser.parse_args()
    if given.replay is not None:
        print(described(outcome(given.replay)))
        return
    outcomes, broken = [], []
    for seed in range(given.seed, given.seed + given.plants):
        try:
            outcomes.append(outcome(seed))
        except Exception as error:  # a fit that raises is the worst outcome: it is counted and named
            broken.append(f"seed {seed}: {type(error).__name__}: {error}")
            print(broken[-1], flush=True)
            continue
        o = outcomes[-1]
        if o.informed and (o.verdict != "found" or o.found.result.name != "successful"):
            print(described(o), flush=True)
        if (seed - given.seed) % 10 == 9:
            print(f"{seed - given.seed + 1} of {given.plants}", file=sys.stderr, flush=True)
    text = table(outcomes, f"python benchmarks/random_plants.py --plants {given.plants} --seed {given.seed}")
    text += "".join(f"\nRaised: {line}\n" for line in broken)
    (HERE / "random_plants.md").write_text(text, encoding="utf-8")
    print(text.split("\n\nMissed")[0])


if __name__ == "__main__":
    main()
