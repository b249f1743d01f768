"""Is the truth any draw of its posterior, where only a prior tells a parameter?  python benchmarks/calibration.py --draws 200

Simulation-based calibration (Talts et al., arXiv:1804.06788; Modrak et al., Bayesian Analysis 20, 461, 2025). Each run draws a plate
and what the bench adds from the priors that the program states, simulates a log, and asks for the rank of the truth among the draws
of `sysid.sample`. If the program's posterior is the posterior, ranks are uniform, for each log and so for any logs that the log itself
picks: that a fit is refused by what its log holds does not bend the ranks of the others.

G, tau and f0 have flat priors, which nothing can be drawn from: they are drawn from a box, and the rank is among the draws within it,
which are the posterior of that box. Lateness is drawn from its normal prior, of one row. Rotation is uniform; offset, feedthrough and
start have priors so wide that a log which moves by their size has the same posterior: any size will do. Responses:
`tests/reference.py`, which shares no code with the package. Writes calibration.md beside itself.

    --draws N      of each case (default 200)       --case NAME    those whose name holds NAME; printed, not written
"""

import argparse
import os
import runpy
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.stats import chisquare, kstest

from sysid import Log, fit, sample
from sysid.effects.registry import EVERY
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(
    **runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference")
)
TAU, DRIVEN = 5e-3 / np.log(20), 32300.0  # s, Hz
HALF = 1 / (2 * np.pi * TAU)  # half bandwidth, Hz
EARLY = 20  # rows before a step
KEPT = 199  # draws that a rank is among
BINS = 20  # of the ranks, for the chi-squared test
WANTED = 0.01  # of the smallest p, after Holm's correction
ADDED = 0.1  # standard deviation of offset, feedthrough and start, in units of G V


@dataclass(frozen=True)
class Case:
    """One kind of log: `noise` per channel (of G = 1), the `box` of each parameter, and how a log is made."""

    name: str
    noise: float
    box: dict[str, tuple[float, float]]
    log: "Callable[[Case, SimpleNamespace, np.random.Generator], Log]"
    window: float = 12.0  # tau after the step
    rows: int = 200


def gaussian(rng: np.random.Generator, size: float) -> complex:
    return complex(*(size * rng.standard_normal(2)))


def noise(case: Case, rng: np.random.Generator, n: int) -> np.ndarray:
    return case.noise * (rng.standard_normal(n) + 1j * rng.standard_normal(n))


def stepped(case: Case, plant: SimpleNamespace) -> tuple[np.ndarray, ...]:
    """Time, drive, the drive that each row has felt, the response, and its rate of change: that of the slow mode."""
    time = case.window * TAU / (case.rows - EARLY) * np.arange(case.rows)
    drive = (np.arange(case.rows) >= EARLY).astype(float)
    felt = np.append(0.0, drive[:-1])
    constant = np.full(case.rows, DRIVEN), np.full(case.rows, 24.0)
    response = reference.ringing(plant, time, drive, *constant)
    slow, fast, push = reference.modes(plant, DRIVEN, 24.0, plant.tau)
    return time, drive, felt, response, slow * (response - push * felt / fast) + push * felt


def step(case: Case, plant: SimpleNamespace, rng: np.random.Generator) -> Log:
    """A step in d/q with all that the bench may add."""
    time, drive, felt, response, rate = stepped(case, plant)
    late = gaussian(rng, np.hypot(time[1], 1 / (2 * np.pi * DRIVEN)))
    decay = np.exp(reference.modes(plant, DRIVEN, 24.0, plant.tau)[0] * time)
    rows = np.exp(2j * np.pi * rng.random()) * (response - late * rate) + gaussian(rng, ADDED) * felt
    rows = rows + gaussian(rng, ADDED) + gaussian(rng, ADDED) * decay + noise(case, rng, case.rows)
    return Log(
        "step",
        rows,
        time=time,
        drive=drive,
        frequency=np.full(case.rows, DRIVEN),
        kind="transient",
        sampling="instant",
    )


def amplitude(case: Case, plant: SimpleNamespace, rng: np.random.Generator) -> Log:
    """The amplitude of a step: no offset, and no feedthrough, which it is taken to be without."""
    time, drive, _, response, rate = stepped(case, plant)
    late = np.hypot(time[1], 1 / (2 * np.pi * DRIVEN)) * rng.standard_normal()
    rows = np.abs(response - late * rate + noise(case, rng, case.rows))
    return Log(
        "step",
        rows,
        time=time,
        drive=drive,
        frequency=np.full(case.rows, DRIVEN),
        kind="transient",
        sampling="instant",
    )


def first_order(case: Case, plant: SimpleNamespace, rng: np.random.Generator) -> Log:
    """A signed amplitude without a frequency: the plate at its resonance."""
    time = case.window * TAU / (case.rows - EARLY) * np.arange(case.rows)
    drive = (np.arange(case.rows) >= EARLY).astype(float)
    since = np.maximum(time - time[EARLY], 0.0)
    late = time[1] * rng.standard_normal()
    rate = np.where(time > time[EARLY], plant.G / plant.tau * np.exp(-since / plant.tau), 0.0)
    rows = plant.G * -np.expm1(-since / plant.tau) - late * rate + ADDED * rng.standard_normal()
    rows = rows + ADDED * rng.standard_normal() * np.exp(-time / plant.tau) + noise(case, rng, case.rows).real
    return Log("step", rows, time=time, drive=drive, kind="transient", sampling="instant")


def sweep(case: Case, plant: SimpleNamespace, rng: np.random.Generator) -> Log:
    """Settled points over one half bandwidth, with a background that has a slope."""
    u = np.linspace(-0.5, 0.5, case.rows)
    frequency = DRIVEN + HALF * u
    rows = np.exp(2j * np.pi * rng.random()) * reference.steady(plant, 1.0, frequency, 24.0)
    rows = rows + gaussian(rng, ADDED) + gaussian(rng, ADDED) * u + noise(case, rng, case.rows)
    return Log("sweep", rows, drive=np.ones(case.rows), frequency=frequency, kind="steady")


WIDE = {"G": (0.5, 2.0), "tau": (TAU / 1.5, 1.5 * TAU)}
NEAR = WIDE | {"f0": (DRIVEN - 1.5 * HALF, DRIVEN + 1.5 * HALF)}
CASES = (
    Case("lone step", 0.01, NEAR, step),
    Case("rows tau/8 apart", 0.01, NEAR, step, window=22.5),
    Case("half a tau of a step", 0.002, NEAR, step, window=0.5),
    Case("step, noise a third of it", 0.33, NEAR, step, rows=1000),
    Case(
        "amplitude of a step off resonance",
        0.01,
        WIDE | {"f0": (DRIVEN - 3 * HALF, DRIVEN + 3 * HALF)},
        amplitude,
    ),
    Case("step without a frequency", 0.03, WIDE, first_order),
    Case("sweep of a half bandwidth", 0.001, NEAR, sweep, rows=101),
)


@dataclass(frozen=True)
class Run:
    """How a fit ended, whether it has a posterior, and of each parameter that was drawn the rank of the truth, 0 to 1."""

    result: str
    bounded: bool
    ranks: dict[str, float]


def run(case: Case, seed: int, nuisances: Sequence[str] = EVERY, accuracy: str = "standard") -> Run:
    """One draw of a case."""
    rng = np.random.default_rng([seed, sum(map(ord, case.name))])
    truth = {
        n: float(np.exp(rng.uniform(*np.log(b))) if n in WIDE else rng.uniform(*b))
        for n, b in case.box.items()
    }
    plant = reference.Plant(G=truth["G"], tau=truth["tau"], f0=truth.get("f0", DRIVEN), k_T=0.0)
    found = fit([case.log(case, plant, rng)], nuisances=nuisances)
    posterior = sample(found, seed=seed, accuracy=accuracy)
    draws = {n: v.ravel() for n, v in posterior.draws.items() if n in case.box}
    within = np.logical_and.reduce([(v > case.box[n][0]) & (v < case.box[n][1]) for n, v in draws.items()])
    return Run(
        posterior.result.name,
        found.result.bounded,
        {n: _rank(v, within, truth[n], rng) for n, v in draws.items()},
    )


def _rank(draws: np.ndarray, within: np.ndarray, truth: float, rng: np.random.Generator) -> float:
    """Share of the draws in the box that lie below the truth; of none, the end beyond which all draws are."""
    if not np.any(within):
        return float(np.median(draws) < truth)
    kept = draws[within]
    kept = kept[np.linspace(0, len(kept) - 1, min(KEPT, len(kept))).astype(int)]
    return float((np.count_nonzero(kept < truth) + rng.random()) / (len(kept) + 1))


def uniformity(ranks: Sequence[float]) -> tuple[float, float]:
    """p of the chi-squared test over BINS (5 or more in each), and of the distance of the ECDF."""
    bins = min(BINS, len(ranks) // 5)
    counts, _ = np.histogram(ranks, bins, (0.0, 1.0))
    return float(chisquare(counts).pvalue), float(kstest(ranks, "uniform").pvalue)


def holm(p: Sequence[float]) -> np.ndarray:
    """Holm's step-down correction (Scand. J. Statist. 6, 65, 1979)."""
    order, n = np.argsort(p), len(p)
    corrected = np.maximum.accumulate(np.minimum(np.sort(p) * np.arange(n, 0, -1), 1.0))
    found = np.empty(n)
    found[order] = corrected
    return found


HEAD = f"""`refused`: fits without a posterior (not converged, or tau or G not determined), whose draws are a broad look and are not ranked.
`held`: of the others, those that say so little of the parameter that it is not drawn. `within 95 %`: share of the ranks between 2.5 and
97.5 %. `chi2` over {BINS} bins, and `ECDF` (Kolmogorov-Smirnov): p; `Holm`: the smaller of the two, corrected for all tests of the table,
which should be above {WANTED:g}. It is not for G of a step under noise of a third of it, more than half of which is refused: what
tells G from a feedthrough and a lateness there is given a prior as wide as the error of their difference
(`sysid/verdict/gain_confounding.py`), too wide rather than too narrow.

| case | draws | refused | parameter | held | mean rank | within 95 % | chi2 | ECDF | Holm |
|---|---|---|---|---|---|---|---|---|---|
"""


def table(found: dict[str, list[Run]], command: str) -> str:
    """The study as Markdown."""
    cells, tests = [], []
    for name, runs in found.items():
        good = [r for r in runs if r.bounded]
        for parameter in sorted({n for r in good for n in r.ranks}, key=("G", "tau", "f0").index):
            ranks = np.array([r.ranks[parameter] for r in good if parameter in r.ranks])
            if len(ranks) < 5 * 2:
                continue
            p = uniformity(ranks)
            inside = 100 * np.mean((ranks > 0.025) & (ranks < 0.975))
            cells.append(
                [
                    name,
                    len(runs),
                    len(runs) - len(good),
                    parameter,
                    len(good) - len(ranks),
                    f"{ranks.mean():.3f}",
                ]
            )
            cells[-1] += [f"{inside:.1f} %", f"{p[0]:.3g}", f"{p[1]:.3g}"]
            tests += p
    corrected = np.min(holm(tests).reshape(-1, 2), axis=1)
    lines = [
        "| " + " | ".join(map(str, [*c, f"{p:.3g}"])) + " |" for c, p in zip(cells, corrected, strict=True)
    ]
    ended = [f"- {name}: {dict(Counter(r.result for r in runs))}" for name, runs in found.items()]
    return (
        f"# Calibration\n\nMade by `{command}`.\n\n{HEAD}"
        + "\n".join([*lines, "", "How the fits ended:", "", *ended])
        + "\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--case", default="")
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        found = {}
        for case in CASES:
            if given.case in case.name:
                seeds = track(range(given.draws), case.name, console=Console(stderr=True))
                found[case.name] = [run(case, seed) for seed in seeds]
                text = table(found, f"python benchmarks/calibration.py --draws {given.draws}")
                if not given.case:  # after each case: what is interrupted leaves what is done
                    (HERE / "calibration.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
