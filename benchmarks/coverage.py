"""Do the 95 % intervals hold the truth 95 times in 100?  python benchmarks/coverage.py --seeds 2000 --jobs 2

Each case is one or more noiseless logs of one plant (f0 32.3 kHz, tau 1.67 ms) and a kind of noise; each seed draws that noise
anew and fits from nothing. Counted is how often the interval of a parameter that the fit calls determined, in a fit that it
calls successful, holds the truth; what it refuses is counted beside it. Responses: `tests/reference.py`, which shares no code
with the package; the noise, and the Cramer-Rao bounds, are made here. Writes coverage.md beside itself.

    --seeds N      of each case (default 2000)      --posterior N  of these also sampled (default 200)
    --case NAME    those whose name holds NAME; printed, not written
    --seed S       the first one (default 0)        --jobs N       processes (default 1)
    --keep FOLDER  what is done already, by the same code, is read from there, and what is done now is kept there
"""

import argparse
import json
import os
import re
import runpy
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.special import i0e, i1e

from sysid import Fit, Log, Parameter, fit, sample
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(**runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference"))
PLANT = reference.Plant(G=1.0, tau=5e-3 / np.log(20), f0=32300.0, k_T=-8.0)
NAMES = ("G", "tau", "f0", "k_T")
MOVES = (1e-6, 1e-6 * PLANT.tau, 1e-3, 1e-3)  # of finite differences: far above rounding, far below every bound
RATE, EARLY = 1e4, 20  # rows per second of a step; rows before it
ADDED = ("rotation", "feedthrough", "slope", "offset", "start")
FREED = (*ADDED, "delay")  # what the fit eliminates from every log; a delay has a prior of a row
MOSTLY = 0.9  # of the seeds determine a parameter that the case determines; of fewer, the noise has chosen which
CHUNK = 25  # seeds that a process takes at once


# --- logs without noise -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Inputs:
    """What was driven in one log, row by row; `time` None: settled points. `lead` seconds at the first row's inputs, before."""

    name: str
    drive: np.ndarray
    frequency: np.ndarray
    time: np.ndarray | None = None
    temperature: float | None = None  # degC; None: not recorded, and 24
    amplitude_only: bool = False
    lead: float = 0.0


@dataclass(frozen=True)
class Bench:
    """What the bench adds to a log: a rotation (rad), a feedthrough of the drive (um/V), a delay of the response (s)."""

    rotation: float = 0.0
    feedthrough: complex = 0.0
    delay: float = 0.0


def step(rows: int = 200, rate: float = RATE, early: int = EARLY, detuning: float = 0.0, **given) -> Inputs:
    """1 V from row `early` on, and `rows` rows of it, driven `detuning` Hz above f0."""
    n = early + rows
    drive = (np.arange(n) >= early).astype(float)
    return Inputs("step", drive, np.full(n, PLANT.f0 + detuning), np.arange(n) / rate, **given)


def sweep(rows: int = 101, span: float = 500.0, **given) -> Inputs:
    """Settled points within `span` Hz of f0, at 1 V."""
    return Inputs("sweep", np.ones(rows), PLANT.f0 + np.linspace(-span, span, rows), **given)


def hurried(dwell: float, rows: int = 101, span: float = 500.0) -> Inputs:
    """The sweep at one row per `dwell` seconds, settled only where it begins."""
    return replace(sweep(rows, span), name="hurried", time=dwell * np.arange(rows), lead=40 * PLANT.tau)


def felt(inputs: Inputs) -> np.ndarray:
    """The drive that acts while each row's response is taken: that of the row before, where rows follow one another in time."""
    return inputs.drive if inputs.time is None else np.append(inputs.drive[0] * (inputs.lead > 0), inputs.drive[:-1])


def response(plant, inputs: Inputs, bench: Bench = Bench()) -> np.ndarray:
    """Wd + j Wq (n,) of a noiseless log."""
    degC = reference.REFERENCE_TEMPERATURE if inputs.temperature is None else inputs.temperature
    if inputs.time is None:
        clean = reference.steady(plant, inputs.drive, inputs.frequency, degC)
    else:
        acts = inputs.time + bench.delay
        if inputs.lead:
            acts = np.append(acts[0] - inputs.lead, acts[1:])
        moments = np.union1d(acts, inputs.time)
        held = np.searchsorted(acts, moments, side="right") - 1
        drive = np.where(held < 0, 0.0, inputs.drive[held])
        z = reference.ringing(plant, moments, drive, inputs.frequency[np.maximum(held, 0)], np.full(len(moments), degC))
        clean = z[np.searchsorted(moments, inputs.time)]
    return clean * np.exp(1j * bench.rotation) + bench.feedthrough * felt(inputs)


# --- noise ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Noise:
    """`std` per channel; `memory`: correlation from row to row; `outliers`: share of the rows whose noise is ten times as large, or
    that of coloured noise to which ten times as much is added; `channels`: by what the noise of d and of q is larger than `std`."""

    std: float = 0.01
    memory: float = 0.0
    outliers: float = 0.0
    channels: tuple[float, float] = (1.0, 1.0)

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Complex noise (n,), stationary."""
        white = self.std * (self.channels[0] * rng.standard_normal(n) + 1j * self.channels[1] * rng.standard_normal(n))
        if self.outliers and not self.memory:
            return np.where(rng.random(n) < self.outliers, 10.0, 1.0) * white
        noise = white.copy()
        for k in range(1, n):
            noise[k] = self.memory * noise[k - 1] + np.sqrt(1 - self.memory**2) * white[k]
        if self.outliers:
            size = 10 * self.std * (rng.random(n) < self.outliers)
            noise += size * (self.channels[0] * rng.standard_normal(n) + 1j * self.channels[1] * rng.standard_normal(n))
        return noise


def informative(noise: Noise, size: np.ndarray, amplitude_only: bool) -> np.ndarray:
    """Square root of the Fisher information about each row's mean, per channel, in units of 1/std.

    One for normal noise. For an amplitude w about a mean a, both in units of std, Rice: E (w I1(aw)/I0(aw) - a)^2. For d/q rows
    with outliers: half of E |grad log p|^2 of the mixture of two normal densities in the plane.
    """
    w = np.linspace(0, 200, 40001)[1:]
    if amplitude_only:
        found = []
        for a in size / noise.std:
            x = np.linspace(max(a - 8, 1e-6), a + 8, 4001)
            density = x * np.exp(-0.5 * (x - a) ** 2) * i0e(a * x)
            found.append(np.trapezoid(density * (x * i1e(a * x) / i0e(a * x) - a) ** 2, x))
        return np.sqrt(found)
    if not noise.outliers or noise.memory:  # no bound is known for outliers on top of coloured noise: that without them
        return np.ones_like(size)
    parts = [(1 - noise.outliers, 1.0), (noise.outliers, 10.0)]
    density = sum(share / s**2 * np.exp(-0.5 * (w / s) ** 2) for share, s in parts)
    slope = sum(share * w / s**4 * np.exp(-0.5 * (w / s) ** 2) for share, s in parts)
    return np.full_like(size, np.sqrt(0.5 * np.trapezoid(w * slope**2 / density, w)))


# --- Cramer-Rao bounds ------------------------------------------------------------------------------------------------


def derivatives(inputs: Inputs, bench: Bench, nuisances: Sequence[str]) -> dict[str, np.ndarray]:
    """How the noiseless rows change with each parameter and each nuisance: complex (n,), of d/q rows."""
    found = {}
    for name, move in zip(NAMES, MOVES, strict=True):
        sides = [response(replace(PLANT, **{name: getattr(PLANT, name) + s * move}), inputs, bench) for s in (1, -1)]
        found[name] = (sides[0] - sides[1]) / (2 * move)
    if inputs.amplitude_only:
        return found
    now, drive = response(PLANT, inputs, replace(bench, feedthrough=0.0)), felt(inputs)
    added = {"feedthrough": drive}
    if inputs.time is None:
        added["slope"] = drive * (inputs.frequency - inputs.frequency.mean()) / np.ptp(inputs.frequency)
    else:
        poles = [reference.modes(PLANT, f, reference.REFERENCE_TEMPERATURE, PLANT.tau)[0] for f in inputs.frequency[:-1]]
        added["offset"] = np.ones(len(drive))
        added["start"] = np.exp(np.append(0, np.cumsum(poles * np.diff(inputs.time))))
    if "rotation" in nuisances:
        found["rotation"] = 1j * now
    for name in (name for name in added if name in nuisances):
        found |= {name: added[name] + 0j, f"{name}, j": 1j * added[name]}
    if "delay" in nuisances and inputs.time is not None:
        late = 1e-3 * np.diff(inputs.time).min()  # forwards: a step cannot come before its edge's row
        found["delay"] = (response(PLANT, inputs, replace(bench, feedthrough=0.0, delay=bench.delay + late)) - now) / late
    return found


def bounds(case: "Case", nuisances: Sequence[str] = FREED) -> dict[tuple[int, str], float]:
    """Cramer-Rao standard deviations: of (-1, parameter), and of each (log, nuisance). Infinite where something else can take
    its place."""
    parts, labels = [], [(-1, name) for name in NAMES]
    for i, (inputs, bench) in enumerate(zip(case.logs, case.benches, strict=True)):
        rows = derivatives(inputs, bench, nuisances)
        z = response(PLANT, inputs, bench)
        weight = informative(case.noise, np.abs(z), inputs.amplitude_only) / case.noise.std
        parts.append({(i if name not in NAMES else -1, name): _real(v, z, weight, case.noise, inputs)
                      for name, v in rows.items()})  # fmt: skip
        labels += [label for label in parts[-1] if label not in labels]
    jacobian = np.concatenate([np.stack([p.get(label, np.zeros_like(p[-1, "G"])) for label in labels], axis=1) for p in parts])
    rows = {i: np.diff(inputs.time).min() for i, inputs in enumerate(case.logs) if inputs.time is not None}
    priors = [[(label == (i, "delay")) / row for label in labels] for i, row in rows.items()]
    jacobian = np.concatenate([jacobian, np.array(priors).reshape(len(priors), len(labels))])
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > 1e-9 * size.max()  # what no row depends on
    unit = jacobian[:, seen] / size[seen]
    values, vectors = np.linalg.eigh(unit.T @ unit)
    told = values > 1e-12  # the rest are sums of columns that cancel to rounding
    lost = np.any(np.abs(vectors[:, ~told]) > 1e-4, axis=1)
    std = np.full(len(labels), np.inf)
    std[seen] = np.where(lost, np.inf, np.sqrt(np.sum(vectors[:, told] ** 2 / values[told], axis=1)) / size[seen])
    return dict(zip(labels, std, strict=True))


def _real(change: np.ndarray, z: np.ndarray, weight: np.ndarray, noise: Noise, inputs: Inputs) -> np.ndarray:
    """Real rows of a change, whitened, in units of the noise."""
    if inputs.amplitude_only:
        return weight * (change * z.conj()).real / np.abs(z)
    white = weight * (change - noise.memory * np.append(0, change[:-1])) / np.sqrt(1 - noise.memory**2)
    white[0] = weight[0] * change[0]
    return np.concatenate([white.real / noise.channels[0], white.imag / noise.channels[1]])


# --- cases ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """Logs of one plant and their noise; `bounded`: the bound of its parameters is known here."""

    name: str
    logs: tuple[Inputs, ...]
    noise: Noise = Noise()
    benches: tuple[Bench, ...] = ()
    bounded: bool = True

    def __post_init__(self) -> None:
        if not self.benches:
            object.__setattr__(self, "benches", tuple(Bench() for _ in self.logs))


LEVELS = (0.5, 1.0, 2.0, 4.0)  # of a nuisance's own standard deviation
TAU = PLANT.tau


def cases() -> Iterator[Case]:
    """Every case of the study."""
    one, two = (step(),), (step(), sweep())
    for name, logs in {"step": one, "sweep": (sweep(),), "step + sweep": two}.items():
        yield Case(f"white, {name}", logs)
    for memory in (0.5, 0.9, 0.98):
        yield Case(f"correlation {memory}, step of 400 rows", (step(400),), Noise(memory=memory))
    yield Case("correlation 0.9, sweep", (sweep(),), Noise(memory=0.9))
    for name, logs in {"step": one, "sweep": (sweep(),)}.items():
        yield Case(f"5 % outliers, {name}", logs, Noise(outliers=0.05))
    for memory in (0.5, 0.9):
        for name, logs in {"step of 400 rows": (step(400),), "sweep": (sweep(),)}.items():
            yield Case(f"5 % outliers on correlation {memory}, {name}", logs, Noise(memory=memory, outliers=0.05), bounded=False)
    for channels, what in (((3.0, 1.0), "d noise 3 times q noise"), ((1.0, 3.0), "q noise 3 times d noise")):
        for name, logs in {"step": one, "sweep": (sweep(),), "step + sweep": two}.items():
            yield Case(f"{what}, {name}", logs, Noise(channels=channels))
        yield Case(f"{what}, correlation 0.9, step of 400 rows", (step(400),), Noise(memory=0.9, channels=channels))
    warm = tuple(make(temperature=t) for t in (20.0, 24.0, 30.0) for make in (step, sweep))
    yield Case("joint, 3 steps + 3 sweeps at 20, 24, 30 degC", warm)
    for std in (0.01, 0.03, 0.1, 0.2):
        yield Case(f"amplitude, sweep, noise {100 * std:.0f} %", (sweep(amplitude_only=True),), Noise(std))
    off = (step(detuning=50.0, amplitude_only=True), sweep(amplitude_only=True))
    yield Case("amplitude, step 50 Hz off + sweep", off, bounded=False)
    for std in (0.01, 0.1):  # Rice's distribution, and neighbours that are alike
        slow = Noise(std, memory=0.9)
        yield Case(f"amplitude, correlation 0.9, sweep, noise {100 * std:.0f} %", off[1:], slow, bounded=False)
        yield Case(f"amplitude, correlation 0.9, step 50 Hz off + sweep, noise {100 * std:.0f} %", off, slow, bounded=False)
    for window in (1.0, 0.5):
        yield Case(f"short, step of {window:g} tau", (step(200, 200 / (window * TAU)),))
    for std in (0.1, 0.3):
        for name, logs in {"step": one, "sweep": (sweep(),), "step + sweep": two}.items():
            yield Case(f"noise {100 * std:.0f} %, {name}", logs, Noise(std))
    for level in LEVELS:
        for what in ("rotation", "feedthrough", "delay"):
            yield with_bench(Case(f"{what} at {level:g} of its std, step + sweep", two), what, level, FREED)
        for what in ("rotation", "feedthrough"):  # a delay and a feedthrough together, one step cannot tell apart
            yield with_bench(Case(f"{what} at {level:g} of its std, step", one), what, level, ADDED)
    yield Case("hurried sweep, dwell 1 tau, with its times", (hurried(TAU),))


@cache
def every_case() -> tuple[Case, ...]:
    return tuple(cases())


def with_bench(case: Case, what: str, level: float, free: Sequence[str]) -> Case:
    """The case with one nuisance present in each log that can have it, at `level` of its Cramer-Rao standard deviation when all
    of `free` is."""
    known, benches = bounds(case, free), []
    for i in range(len(case.logs)):
        size = [level * known.get((i, f"{what}{part}"), 0.0) for part in ("", ", j")]
        benches.append(Bench(**{what: complex(*size) if what == "feedthrough" else size[0]}))
    return replace(case, benches=tuple(benches))


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
        said = found.warnings[-1:] if found.result.name == "misfit" else [w for w in (why.get("tau"), why.get("G")) if w]
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
        ratio = f"{np.median(stds) / known[-1, name]:.3f}" if np.isfinite(known.get((-1, name), np.inf)) else ""
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
    lines += ["|---|---|---|---|---|---|---|---|", *(row for case in done for row in coverage_rows(case, by_case[case.name]))]
    refused = [row for case in done if (row := refusal_row(case, by_case[case.name]))]
    lines += ["", "Seeds that were refused, and parameters left open:", "", "| case | ends | said most often |", "|---|---|---|"]
    return "\n".join(lines + (refused or ["| none | | |"])) + "\n"


INTRODUCTION = """A plant of f0 32.3 kHz, tau 1.67 ms; a step of 200 rows at 10 kHz after 20 rows at rest, driven at f0; a sweep of 101 settled
points over +-500 Hz; noise of 1 % of the amplitude at resonance in each of Wd and Wq, unless the case says otherwise; every
nuisance free. `determined`: share of all seeds in which the fit is successful and the parameter determined; `covered`: share of
these whose interval, value +- 1.96 std, holds the truth, with its binomial error; bold outside 93 to 97 % where nine seeds in ten
or more determine the parameter (of fewer, the noise has chosen which). `posterior`: the same for the central interval of the
posterior's draws, over fewer seeds; an error is never below that of one seed. `std/bound`: median stated standard deviation over the
Cramer-Rao bound for the noise and the nuisances as they are. z = (value - truth)/std.

G of a lone step is covered too often, and far below the bound: what tells it from a feedthrough and a lateness is that these
would have to cancel (`sysid/coincidence.py`). On these benches neither is there, or one of them; where both are drawn from their
priors calibration.md counts. Amplitudes of coloured noise: the likelihood is an approximation (`sysid/projected.py`).
Noise of 20 % and 30 %: this interval is symmetric and normal, which the posterior of such logs is not; what the program reports is the
posterior's.
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
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process takes one core: threads that wait for one another take many
    # A process that has loaded hundreds of programs runs out of what an operating system maps: each serves 10 chunks.
    pool = {"processes": given.jobs, "initializer": _begin, "maxtasksperchild": 10}
    with tempfile.TemporaryDirectory() as folder, get_context("spawn").Pool(**pool, initargs=(folder,)) as workers:
        for chunk, found in zip(todo, track(workers.imap(work, todo), total=len(todo), console=Console(stderr=True)), strict=True):
            outcomes += found
            if given.keep:
                kept(given.keep, chunk).write_text(json.dumps([vars(o) for o in found]), encoding="utf-8")
    if not given.case:
        (HERE / "coverage.md").write_text(table(outcomes, chosen, command), encoding="utf-8")
    print(table(outcomes, chosen, command))


if __name__ == "__main__":
    main()
