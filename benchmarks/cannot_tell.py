"""Logs that cannot tell a parameter: is it said, and is the cause named?  python benchmarks/cannot_tell.py --logs 1000 --jobs 2

Each seed draws one of the causes below, a plant (tau 0.1 to 100 ms, Q 30 to 10 000) and logs that leave one parameter open for
that cause. Counted is how often the parameter is called undetermined; how often the sentence names the cause, decided by the
cause's keywords; how often a fit called successful has any parameter more than FAR standard deviations off; and, where the
sentence asks for a record, how often the parameter is determined once that record is added. Responses: `tests/reference.py`,
which shares no code with the package. Writes cannot_tell.md beside itself.

    --logs N       how many seeds (default 1000)    --seed S       the first one (default 0)
    --cause NAME   those whose name holds NAME; printed, not written
    --jobs N       processes (default 1)            --replay SEED  print one seed's plant, logs and sentences
"""

import argparse
import os
import re
import runpy
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track

from sysid import Fit, Log, fit
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(
    **runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference")
)
ROWS, EARLY = 120, 12  # of every log, and before its step, so that a dozen compiled programs serve all seeds
FAR = 4.0  # standard deviations off: chance alone does it once in 16 000
DEGC = 24.0
LOUD = 300.0  # by which noise of 0.3 to 3 % is larger where it hides the transient
CHUNK = 20  # seeds that a process takes at once


# --- plants and records -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bench:
    """A plant, and the noise (um per channel, 0.3 to 3 % of G times 1 V) and rotation of what records it."""

    plant: SimpleNamespace
    noise: float
    rotation: float
    rng: np.random.Generator = field(repr=False)

    @property
    def half_bandwidth(self) -> float:
        """1/(2 pi tau), Hz."""
        return 1 / (2 * np.pi * self.plant.tau)

    def at(self, temperature: float = DEGC) -> float:
        """The resonance at a temperature, Hz."""
        return self.plant.f0 + self.plant.k_T * (temperature - DEGC)

    def log(
        self,
        name: str,
        drive,
        frequency,
        temperature=None,
        time=None,
        amplitude_only: bool = False,
        rest: bool = True,
    ) -> Log:
        """A noisy record of these inputs (n,); `rest` False: settled at the first row's inputs before."""
        n = len(drive)
        frequency = np.broadcast_to(np.asarray(frequency, float), n)
        degC = np.full(n, DEGC) if temperature is None else np.broadcast_to(np.asarray(temperature, float), n)
        if time is None:
            clean = reference.steady(self.plant, drive, frequency, degC)
        else:
            moments = time if rest else np.append(time[0] - 40 * self.plant.tau, time[1:])
            first = reference.ringing(self.plant, moments, drive, frequency, degC)
            clean = (
                first
                if rest
                else np.append(reference.steady(self.plant, drive[0], frequency[0], degC[0]), first[1:])
            )
        rows = clean * np.exp(1j * self.rotation) + self.noise * (
            self.rng.standard_normal(n) + 1j * self.rng.standard_normal(n)
        )
        return Log(name, np.abs(rows) if amplitude_only else rows, time=time, drive=drive, frequency=frequency,
                   temperature=None if temperature is None else degC, kind="steady" if time is None else "transient",
                   sampling=None if time is None else "instant")  # fmt: skip

    def step(
        self,
        window: float | None = None,
        volts: float = 1.0,
        detuning: float = 0.0,
        temperature=None,
        **given,
    ) -> Log:
        """A step after EARLY rows at rest, over `window` seconds (12 tau), `detuning` half bandwidths above resonance."""
        window = 12 * self.plant.tau if window is None else window
        time = window * (np.arange(ROWS) - EARLY) / (ROWS - 1 - EARLY)
        drive = volts * (np.arange(ROWS) >= EARLY)
        frequency = self.at(DEGC if temperature is None else temperature) + detuning * self.half_bandwidth
        return self.log(f"step of {window:.3g} s", drive, frequency, temperature, time - time[0], **given)

    def sweep(self, span: float | None = None, temperature=None, **given) -> Log:
        """Settled points over `span` Hz (eight bandwidths) about the resonance, which is not quite in the middle."""
        span = 16 * self.half_bandwidth if span is None else span
        middle = self.at(DEGC if temperature is None else temperature) + 0.2 * min(span, self.half_bandwidth)
        f = middle + np.linspace(-0.5, 0.5, ROWS) * min(span, 1.8 * middle)
        return self.log(f"sweep over {span:.3g} Hz", np.ones(ROWS), f, temperature, **given)


def bench(seed: int) -> tuple[str, Bench]:
    """The cause and the bench of one seed."""
    rng = np.random.default_rng([seed, 4])
    cause = list(CAUSES)[rng.integers(len(CAUSES))]
    tau, Q = np.exp(rng.uniform(np.log(1e-4), np.log(0.1))), np.exp(rng.uniform(np.log(30), np.log(1e4)))
    k_T = rng.choice([-1, 1]) * rng.uniform(0.05, 0.3) / (2 * np.pi * tau)
    plant = reference.Plant(G=float(np.exp(rng.normal())), tau=tau, f0=Q / (np.pi * tau), k_T=k_T)
    noise = plant.G * np.exp(rng.uniform(np.log(0.003), np.log(0.03)))
    return cause, Bench(plant, noise, rng.uniform(-np.pi, np.pi), rng)


# --- causes -----------------------------------------------------------------------------------------------------------

Advice = Callable[[Bench, list[Log], str], list[Log] | None]


@dataclass(frozen=True)
class Cause:
    """Logs that leave `parameter` open; every one of `keywords` (a regular expression) stands in a sentence that names why;
    `advised`: the logs, with the record that the sentence asks for (None: it asks for nothing that can be recorded)."""

    parameter: str
    keywords: tuple[str, ...]
    logs: Callable[[Bench], list[Log]]
    advised: Advice


def asked(sentence: str, before: str, unit: str = "s") -> float | None:
    """The number that the sentence asks for: what follows `before`, in s or Hz; None where there is none."""
    sizes = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "Hz": 1.0}
    units = "Hz" if unit == "Hz" else "s|ms|us|ns"
    found = re.search(rf"{before}\s*([\d.]+(?:e[-+]?\d+)?) ({units})\b", sentence)
    return None if found is None else float(found[1]) * sizes[found[2]]


def and_sweep(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    return [*logs, b.sweep()]


def and_step(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    return [*logs, b.step()]


def and_warm_sweep(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    return [*logs, b.sweep(temperature=DEGC + 10)]


def two_temperatures(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    return [b.sweep(temperature=DEGC), b.sweep(temperature=DEGC + 10)]


def and_step_and_sweeps(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    return [*logs, b.step(temperature=DEGC), b.sweep(temperature=DEGC), b.sweep(temperature=DEGC + 10)]


def longer(b: Bench, logs: list[Log], sentence: str) -> list[Log] | None:
    window = asked(sentence, "record")
    return None if window is None else [*logs, b.step(window)]


def wider(b: Bench, logs: list[Log], sentence: str) -> list[Log] | None:
    span = asked(sentence, "at least", "Hz")
    return None if span is None else [*logs, b.sweep(span)]


def closer(b: Bench, logs: list[Log], sentence: str) -> list[Log] | None:
    between = asked(sentence, "record rows")
    return None if between is None else [*logs, b.step(between * (ROWS - 1 - EARLY))]


def loud(b: Bench) -> Bench:
    """The bench with noise from once to ten times the response."""
    return replace(b, noise=LOUD * b.noise)


def larger(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    """The sentence does not say by how much: until it stands 30 times above the noise."""
    return [*logs, loud(b).step(volts=30 * loud(b).noise / b.plant.G)]


def as_dq(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
    log = logs[0]
    return [*logs, b.log("the same in d/q", log.drive, log.frequency, time=log.time)]


def column(name: str) -> Advice:
    """The same logs with the column that was missing."""

    def add(b: Bench, logs: list[Log], sentence: str) -> list[Log]:
        whole = {"drive": (np.arange(ROWS) >= EARLY).astype(float), "frequency": np.full(ROWS, b.at())}
        return [replace(log, **{name: whole[name]}) for log in logs]

    return add


def settled(b: Bench) -> list[Log]:
    """A d/q record at one frequency, of settled points or of a few tau in time, long after its step."""
    frequency = np.full(ROWS, b.at() + b.rng.normal() * b.half_bandwidth)
    clock = b.plant.tau * np.linspace(0, 3, ROWS) if b.rng.random() < 0.5 else None
    return [b.log("settled record", np.ones(ROWS), frequency, time=clock, rest=False)]


def warming(b: Bench) -> list[Log]:
    """Settled points at one frequency while the plate warms by 10 degC."""
    f = b.at() + b.rng.normal() * b.half_bandwidth
    return [b.log("fixed frequency", np.ones(ROWS), f, DEGC + np.linspace(-5, 5, ROWS))]


CAUSES = {
    "one temperature": Cause(
        "k_T",
        ("one temperature",),
        lambda b: [b.step(temperature=DEGC), b.sweep(temperature=DEGC)],
        and_warm_sweep,
    ),
    "window of 0.1 to 0.5 tau": Cause(
        "tau",
        ("longest log covers|window",),
        lambda b: [b.step(b.rng.uniform(0.1, 0.5) * b.plant.tau)],
        longer,
    ),
    "amplitude of a step at resonance": Cause(
        "f0", ("amplitude",), lambda b: [b.step(amplitude_only=True)], and_sweep
    ),
    "amplitude of a step off resonance": Cause(
        "f0",
        ("amplitude", "side|sign"),
        lambda b: [b.step(detuning=b.rng.choice([-1, 1]) * b.rng.uniform(1, 3), amplitude_only=True)],
        as_dq,
    ),
    "rotation or f0": Cause("f0", ("rotation|phase",), settled, and_sweep),
    "fixed frequency while it warms": Cause("k_T", ("product",), warming, and_step_and_sweeps),
    "sweep too narrow": Cause(
        "tau", ("sweep", "width"), lambda b: [b.sweep(b.rng.uniform(0.1, 0.5) * b.half_bandwidth)], wider
    ),
    "rows coarser than the transient": Cause(
        "tau",
        ("rows are", "settles between"),
        lambda b: [b.step(b.rng.uniform(3, 10) * b.plant.tau * (ROWS - 1 - EARLY))],
        closer,
    ),
    "noise hides the transient": Cause("tau", ("noise",), lambda b: [loud(b).step()], larger),
    "no drive recorded": Cause(
        "G", ("no drive is recorded",), lambda b: [replace(b.step(), drive=None)], column("drive")
    ),
    "drive zero throughout": Cause("G", ("zero throughout",), lambda b: [ring_down(b)], and_step),
    "no frequency": Cause(
        "f0",
        ("no frequency is recorded",),
        lambda b: [replace(b.step(), frequency=None)],
        column("frequency"),
    ),
    "no temperature": Cause(
        "k_T", ("no temperature is recorded",), lambda b: [b.step(), b.sweep()], two_temperatures
    ),
}


def ring_down(b: Bench) -> Log:
    """The plate rings down from 1 V; the drive is recorded once it is off."""
    log = b.step(detuning=b.rng.normal())
    held = np.append(1.0, np.zeros(ROWS - 1))
    ringing = b.log("ring-down", held, log.frequency, time=log.time, rest=False)
    return replace(ringing, drive=np.zeros(ROWS))


# --- one seed ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """One seed: whether the parameter is called undetermined, the cause named, a value silently wrong (z: the largest of a
    successful fit); what the advice led to (None: not asked for, or not needed)."""

    seed: int
    cause: str
    result: str
    open: bool
    named: bool
    z: float
    said: str
    followed: bool | None = None
    z_after: float = 0.0
    text: str = ""


def outcome(seed: int, follow: bool = True) -> Outcome:
    """Fit the logs of one seed; then (`follow`), where its sentence asks for a record, with that record. A fit that raises is
    named."""
    name, made = bench(seed)
    cause = CAUSES[name]
    logs = cause.logs(made)
    try:
        found = fit(logs)
        why = found.parameters[cause.parameter].why
        after = fit(more) if follow and why and (more := cause.advised(made, logs, why)) else None
    except Exception as error:
        return Outcome(seed, name, "raised", False, False, np.inf, f"{type(error).__name__}: {error}")
    return Outcome(
        seed,
        name,
        found.result.name,
        why is not None,
        why is not None and all(re.search(word, why) for word in cause.keywords),
        farthest(made, found),
        why or "",
        None
        if after is None
        else after.parameters[cause.parameter].determined and after.result.name == "successful",
        0.0 if after is None else farthest(made, after),
        described(seed, made, name, found, after),
    )


def farthest(made: Bench, found: Fit) -> float:
    """Largest |value - truth|/std of what a successful fit calls determined; 0 for the others, which say that they are not."""
    if found.result.name != "successful":
        return 0.0
    at = found.reference_temperature
    truth = {
        "G": made.plant.G,
        "tau": made.plant.tau,
        "f0": made.at(DEGC if at is None else at),
        "k_T": made.plant.k_T,
    }
    return max(
        (abs(p.value - truth[n]) / p.std for n, p in found.parameters.items() if p.determined), default=0.0
    )


def described(seed: int, made: Bench, name: str, found: Fit, after: Fit | None) -> str:
    """A paragraph about one seed: its plant, its logs, what was said, before and after."""
    t = made.plant
    lines = [
        f"seed {seed}: {name}; G {t.G:.4g}, tau {t.tau:.4g} s, Q {np.pi * t.f0 * t.tau:.4g}, noise {made.noise / t.G:.2g} of G V"
    ]
    for title, one in (("", found), ("with what was asked for: ", after)):
        if one is not None:
            lines.append(f"    {title}{one.result.name}; {'; '.join(log.log.name for log in one.logs)}")
            lines += [f"        {w}" for w in one.warnings]
            for n, p in one.parameters.items():
                truth = {"G": t.G, "tau": t.tau, "f0": made.at(), "k_T": t.k_T}[n]
                lines.append(
                    f"        {n}: {f'{p.value:.6g} +- {p.std:.2g}' if p.determined else p.why} (truth {truth:.6g})"
                )
    return "\n".join(lines)


# --- the table --------------------------------------------------------------------------------------------------------


def table(outcomes: Sequence[Outcome], command: str) -> str:
    """The study as Markdown."""
    lines = ["# Logs that cannot tell", "", f"Made by `{command}`.", "", INTRODUCTION]
    lines += [
        "| cause | parameter | logs | undetermined | cause named | silently wrong | advised | then determined | then wrong |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    for name, cause in CAUSES.items():
        if of := [o for o in outcomes if o.cause == name]:
            lines.append(f"| {name} | {cause.parameter} | {counts(of)} |")
    lines += [f"| **all** | | {counts(outcomes)} |", "", "What was said instead, most often:", ""]
    for name in CAUSES:
        other = [o for o in outcomes if o.cause == name and o.open and not o.named]
        if other:
            common = Counter(re.sub(r"[-+]?[\d.]+(e[-+]?\d+)?", "#", o.said) for o in other).most_common(3)
            lines += [f"- {name}: {'; '.join(f'{n} times “{said}”' for said, n in common)}"]
    worst = sorted(
        (o for o in outcomes if max(o.z, o.z_after) > FAR or o.result == "raised"),
        key=lambda o: -max(o.z, o.z_after),
    )
    lines += [
        "",
        "The worst (`--replay SEED`):",
        "",
        "```",
        *(o.text or f"seed {o.seed}: {o.said}" for o in worst[:12]),
        "```",
    ]
    return "\n".join(lines) + "\n"


INTRODUCTION = f"""`cause named`: of those called undetermined. `silently wrong`: a fit called successful with a parameter more than {FAR:g} standard
deviations off. `advised`: the sentence asks for a record, which was simulated and added; `then determined`: of these, successful
and with the parameter; `then wrong`: more than {FAR:g} standard deviations off.
"""


def counts(of: Sequence[Outcome]) -> str:
    """The cells of one line."""
    left = [o for o in of if o.open]
    advised = [o for o in of if o.followed is not None]
    cells = [
        len(of),
        _percent(o.open for o in of),
        _percent(o.named for o in left),
        sum(o.z > FAR for o in of),
        len(advised),
    ]
    return " | ".join(
        map(str, [*cells, _percent(o.followed for o in advised), sum(o.z_after > FAR for o in advised)])
    )


def _percent(flags) -> str:
    flags = list(flags)
    return f"{100 * np.mean(flags):.1f} %" if flags else "-"


def work(seeds: Sequence[int]) -> list[Outcome]:
    return [outcome(seed) for seed in seeds]


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--cause", default="")
    parser.add_argument("--replay", type=int)
    given = parser.parse_args()
    if given.replay is not None:
        print(outcome(given.replay).text)
        return
    seeds = [s for s in range(given.seed, given.seed + given.logs) if given.cause in bench(s)[0]]
    chunks, outcomes = [seeds[i : i + CHUNK] for i in range(0, len(seeds), CHUNK)], []
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # a process takes one core: threads that wait for one another take many
    # A process that has loaded hundreds of programs runs out of what an operating system maps: each serves 10 chunks.
    pool = {"processes": given.jobs, "initializer": _begin, "maxtasksperchild": 10}
    with (
        tempfile.TemporaryDirectory() as folder,
        get_context("spawn").Pool(**pool, initargs=(folder,)) as workers,
    ):
        for found in track(workers.imap(work, chunks), total=len(chunks), console=Console(stderr=True)):
            outcomes += found
    text = table(outcomes, f"python benchmarks/cannot_tell.py --logs {given.logs} --seed {given.seed}")
    if not given.cause:
        (HERE / "cannot_tell.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
