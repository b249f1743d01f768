"""Whole benches drawn at random: which answers are wrong without a word?  python benchmarks/random_benches.py --benches 1000 --jobs 2

Each bench has a plate (f0 from 300 Hz to 5 MHz, Q from 16 to 30 000, k_T) and one to four logs of mixed kinds at one or several
temperatures, with what benches do to logs: a rotated demodulator, a feedthrough, an offset, a lock-in's filter that is stated or not,
noise of four kinds, a thermometer that flickers, rows off their even times, units and scales that differ from file to file. Logs
are written as CSV files and fitted from those. An answer is wrong without a word where it is called successful and a determined
parameter is more than FAR of its standard deviations off, unless a warning says what would move one so far.

The response is a matrix exponential of the plate's slow mode (below RINGS both) and the filter's poles from row to row; it shares
no code with the package. Writes random_benches.md beside itself.

    --benches N    how many (default 1000)       --seed S     the first one's seed (default 0)
    --jobs N       processes (default 1)         --keep FOLDER  for the logs (default: a temporary one)
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.linalg import expm

from sysid import fit, read_logs
from sysid.precision import keep_programs

HERE = Path(__file__).parent
NAMES = ("G", "tau", "f0", "k_T")
FAR = 5.0
RINGS = 60.0  # Q, below which a stated filter lets the fast mode's ripple through; elsewhere it has settled, as its mean has
FLICKER = 0.02  # degC, of a thermometer from row to row
TIMES, HERTZ, LENGTHS = {"s": 1.0, "ms": 1e3, "us": 1e6}, {"Hz": 1.0, "kHz": 1e-3}, {"um": 1.0, "nm": 1e3}
SCALES = {"": 1.0, "_rms": np.sqrt(0.5), "_pp": 2.0}


# --- what is drawn ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plate:
    """G (um/V), tau (s), f0 (Hz) at 24 degC, k_T (Hz/degC)."""

    G: float
    tau: float
    f0: float
    k_T: float

    @classmethod
    def drawn(cls, rng) -> "Plate":
        f0, q = 10 ** rng.uniform(2.5, 6.7), 10 ** rng.uniform(1.2, 4.5)
        return cls(10 ** rng.uniform(-3, 1), q / (np.pi * f0), f0, f0 * rng.normal(-2e-4, 1.5e-4))

    @property
    def half_bandwidth(self) -> float:
        return 1 / (2 * np.pi * self.tau)

    def at(self, temperature: float) -> float:
        return self.f0 + self.k_T * (temperature - 24.0)


@dataclass(frozen=True)
class Bench:
    """What is done to all logs of a run. `filter` over tau, and its poles; `stated`: whether the logs say so."""

    drive: float
    noise: str
    level: float
    amplitude: bool
    turn: complex
    feedthrough: complex
    offset: complex
    filter: float
    poles: int
    stated: bool
    warm: bool

    @classmethod
    def drawn(cls, rng) -> "Bench":
        def sometimes(chance: float) -> complex:
            return (rng.random() < chance) * 10 ** rng.uniform(-3, -1) * np.exp(2j * np.pi * rng.random())

        amplitude, lockin = rng.random() < 0.15, rng.choice(["none", "stated", "hidden"], p=[0.6, 0.3, 0.1])
        poles = int(rng.choice([1, 2, 4])) * (lockin != "none")
        return cls(
            10 ** rng.uniform(-1, 2),
            str(rng.choice(["white", "coloured", "outliers", "of the reading"], p=[0.5, 0.15, 0.2, 0.15])),
            10 ** rng.uniform(-3.5, -1.5),
            amplitude,
            np.exp(1j * rng.choice([0.0, rng.normal(0, 0.1), rng.uniform(-np.pi, np.pi)])),
            0.0 if amplitude else sometimes(1 / 3),
            0.0 if amplitude else sometimes(1 / 3),
            rng.uniform(0.02, 0.3) / max(poles, 1) * (lockin != "none"),
            poles,
            lockin == "stated",
            rng.random() < 0.5,
        )


@dataclass(frozen=True)
class Inputs:
    """Of one log: `kind`, time (s; None: settled points of no time), drive (V), frequency (Hz)."""

    kind: str
    time: np.ndarray | None
    drive: np.ndarray
    frequency: np.ndarray
    settled: bool = False  # at the first row already


KINDS = {
    "step": 0.3,
    "staircase": 0.15,
    "ring-down": 0.05,
    "sweep": 0.3,
    "timed sweep": 0.1,
    "fast sweep": 0.1,
}


def inputs(rng, plate: Plate, bench: Bench, f0: float) -> Inputs:
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if "sweep" not in kind:
        return _held(rng, plate, bench, f0, kind)
    n, half = int(rng.integers(15, 300)), rng.uniform(1.5, 10) * plate.half_bandwidth
    frequency = f0 + rng.uniform(-0.5, 0.5) * half + np.linspace(-half, half, n)
    order = rng.choice(["up", "down", "mixed"], p=[0.6, 0.2, 0.2])
    frequency = (
        frequency[::-1] if order == "down" else rng.permutation(frequency) if order == "mixed" else frequency
    )
    dwell = {"sweep": np.nan, "timed sweep": rng.uniform(8, 25), "fast sweep": rng.uniform(0.5, 3)}[
        kind
    ] * plate.tau
    return Inputs(kind, None if kind == "sweep" else dwell * np.arange(n), np.full(n, bench.drive), frequency)


def _held(rng, plate: Plate, bench: Bench, f0: float, kind: str) -> Inputs:
    """A transient at one frequency."""
    spacing, before = plate.tau * 10 ** rng.uniform(-2, -0.3), int(rng.choice([0, 5, 20, 60]))
    n = min(int(rng.uniform(2.5, 9) * plate.tau / spacing) + 1, 3000)
    if kind == "ring-down":
        before = max(before, 5)
        drive = np.repeat([bench.drive, 0.0], [before, n])
    elif kind == "step":
        drive = np.repeat([0.0, bench.drive], [before, n])
    else:
        levels = bench.drive * rng.uniform(0.2, 1.2, int(rng.integers(2, 6)))
        drive = np.append(np.zeros(before), np.repeat(levels, max(n // 2, 5)))
    rows = len(drive)
    time = spacing * (np.arange(rows) + (rng.random() < 0.2) * rng.uniform(-0.3, 0.3, rows))
    frequency = np.full(rows, f0 + np.clip(rng.normal(0, 1.5), -4, 4) * plate.half_bandwidth)
    return Inputs(kind, time - time[0], drive, frequency, settled=kind == "ring-down")


# --- what is recorded -------------------------------------------------------------------------------------------------


def settled(plate: Plate, f0: float, drive: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Z = j N V / (c - m omega^2 + j omega ds), exact."""
    w0, omega = 2 * np.pi * f0, 2 * np.pi * frequency
    return 2j * plate.G * drive * w0 / plate.tau / (w0**2 - omega**2 + 2j * omega / plate.tau)


def ringing(plate: Plate, bench: Bench, f0: float, given: Inputs) -> np.ndarray:
    """What the filter shows just before each row's inputs act, plate and filter at rest (or settled) at the first row."""
    size, cache, found = 3 + bench.poles, {}, []
    z = np.zeros(size, complex)
    for k, f in enumerate(given.frequency):
        rates = _rates(plate, bench, f0, f) if f not in cache else cache[f]
        cache[f] = rates
        if k == 0 and given.settled:
            z[:-1] = np.linalg.solve(rates[:-1, :-1], -rates[:-1, -1] * given.drive[0])
            z[-1] = given.drive[0]
        if k:
            held, step = cache[given.frequency[k - 1]], given.time[k] - given.time[k - 1]
            key = (given.frequency[k - 1], step)
            cache[key] = cache[key] if key in cache else expm(held * step)
            z = cache[key] @ z
        found.append(
            z[-2] if bench.poles else z[0] + z[-1] * (_ripple(plate, f0, f) + bench.feedthrough * plate.G)
        )
        z[-1] = given.drive[k]
    return np.array(found)


def _rates(plate: Plate, bench: Bench, f0: float, f: float) -> np.ndarray:
    """d/dt of (slow mode, fast mode, filter's poles, drive), the drive held."""
    w0, omega, damping = 2 * np.pi * f0, 2 * np.pi * f, 1 / plate.tau
    wd = np.sqrt(w0**2 - damping**2)
    b, a = plate.G * damping * w0 / wd, np.zeros((3 + bench.poles,) * 2, complex)
    a[0, 0], a[0, -1] = -damping + 1j * (wd - omega), b
    a[1, 1], a[1, -1] = -damping - 1j * (wd + omega), -b
    rate = 1 / (bench.filter * plate.tau) if bench.poles else 0.0
    for k in range(2, 2 + bench.poles):
        a[k, k], a[k, k - 1] = -rate, rate
    if bench.poles:
        rings = np.pi * f0 * plate.tau < RINGS
        a[2, 0], a[2, 1] = rate, rate * rings
        a[2, -1] += rate * (bench.feedthrough * plate.G + (0 if rings else _ripple(plate, f0, f)))
    return a


def _ripple(plate: Plate, f0: float, f: float) -> complex:
    """The fast mode where it has settled, per volt."""
    wd = np.sqrt((2 * np.pi * f0) ** 2 - plate.tau**-2)
    return -plate.G / plate.tau * 2 * np.pi * f0 / wd / (1 / plate.tau + 1j * (wd + 2 * np.pi * f))


def noise(rng, bench: Bench, clean: np.ndarray) -> np.ndarray:
    n = len(clean)
    white = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    if bench.noise == "coloured":
        rho = rng.choice([0.5, 0.9])
        for k in range(1, n):
            white[k] = rho * white[k - 1] + np.sqrt(1 - rho**2) * white[k]
    if bench.noise == "outliers":
        white[rng.random(n) < 0.04] *= 10
    if bench.noise == "of the reading":
        white = white * np.hypot(0.1, np.abs(clean) / np.max(np.abs(clean)))
    return white


def recorded(rng, plate: Plate, bench: Bench, f0: float, given: Inputs) -> np.ndarray:
    if given.kind in ("sweep", "timed sweep"):
        clean = settled(plate, f0, given.drive, given.frequency) + bench.feedthrough * plate.G * given.drive
    else:
        clean = ringing(plate, bench, f0, given)
    size = plate.G * bench.drive
    rows = clean * bench.turn + bench.offset * size
    return rows + bench.level * size * noise(rng, bench, rows)


def text(rng, bench: Bench, given: Inputs, rows: np.ndarray, temperature: float, tau: float) -> str:
    """The log as a CSV file, in units, scales and an order of columns of its own."""
    time, hertz, length, scale = (str(rng.choice(list(c))) for c in (TIMES, HERTZ, LENGTHS, SCALES))
    metadata, columns = {}, {}
    if given.time is not None:
        columns[f"time_{time}"] = given.time * TIMES[time]
        metadata["sampling"] = "settled" if given.kind == "timed sweep" else "instant"
        if given.kind != "timed sweep":
            metadata["kind"] = "transient"
            metadata |= (
                {"lockin_tau_s": bench.filter * tau, "lockin_order": bench.poles} if bench.stated else {}
            )
    columns |= {"voltage_V": given.drive, f"frequency_{hertz}": given.frequency * HERTZ[hertz]}
    parts = {"w": np.abs(rows)} if bench.amplitude else {"wd": rows.real, "wq": rows.imag}
    columns |= {f"{name}_{length}{scale}": v * LENGTHS[length] * SCALES[scale] for name, v in parts.items()}
    if bench.warm and rng.random() < 0.5:
        metadata["temperature_degC"] = temperature
    elif bench.warm:
        columns["temperature_degC"] = temperature + FLICKER * rng.standard_normal(len(rows))
    names = [str(n) for n in rng.permutation(list(columns))]
    head = "".join(f"# {key}: {value}\n" for key, value in metadata.items())
    lines = (",".join(f"{x:.12g}" for x in row) for row in zip(*(columns[n] for n in names), strict=True))
    return f"{head}{','.join(names)}\n" + "\n".join(lines) + "\n"


# --- what is answered -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """One bench: what it was, how the fit ended, what it said, and (value - truth)/std of what it called determined."""

    seed: int
    traits: tuple[str, ...]
    result: str
    said: tuple[str, ...] = ()
    scores: dict[str, float] = field(default_factory=dict)

    @property
    def far(self) -> bool:
        return self.result == "successful" and any(abs(z) > FAR for z in self.scores.values())

    @property
    def silent(self) -> bool:
        return self.far and not any("standard deviations" in said for said in self.said)


def outcome(seed: int, folder: Path) -> Outcome:
    """Draw, write, read and fit one bench. A fit that raises is counted and named."""
    rng = np.random.default_rng([seed, 31])
    plate, bench = Plate.drawn(rng), Bench.drawn(rng)
    paths, kinds, degrees = [], [], []
    (folder / str(seed)).mkdir(parents=True, exist_ok=True)
    for k in range(int(rng.choice([1, 2, 3, 4], p=[1 / 3, 1 / 3, 1 / 6, 1 / 6]))):
        temperature = 24.0 + bench.warm * rng.uniform(-6, 10)
        given = inputs(rng, plate, bench, plate.at(temperature))
        rows = recorded(rng, plate, bench, plate.at(temperature), given)
        paths.append(folder / str(seed) / f"{k}-{given.kind.replace(' ', '-')}.csv")
        paths[-1].write_text(text(rng, bench, given, rows, temperature, plate.tau), encoding="utf-8")
        kinds.append(given.kind)
        degrees.append(temperature)
    traits = tuple(traits_of(bench, kinds))
    try:
        found = fit(read_logs(paths))
    except Exception as error:
        return Outcome(seed, traits, "raised", (f"{type(error).__name__}: {error}",))
    told = {n: p for n, p in found.parameters.items() if n in NAMES and p.determined}
    at = 24.0 if "k_T" in told else float(np.mean(degrees))
    truth = {"G": plate.G, "tau": plate.tau, "f0": plate.at(at), "k_T": plate.k_T}
    truth["G"] *= LENGTHS[found.parameters["G"].unit.partition("/")[0]]
    scores = {n: (p.value - truth[n]) / p.std for n, p in told.items()}
    return Outcome(seed, traits, found.result.name, tuple(found.warnings), scores)


def traits_of(bench: Bench, kinds: Sequence[str]) -> Iterator[str]:
    yield "all"
    yield "amplitude only" if bench.amplitude else "d and q"
    yield f"noise: {bench.noise}"
    yield f"filter: {'none' if not bench.poles else 'stated' if bench.stated else 'not stated'}"
    yield "several temperatures" if bench.warm and len(kinds) > 1 else "one temperature"
    yield from sorted({f"with a {kind}" for kind in kinds})
    yield "one log" if len(kinds) == 1 else "several logs"


def table(outcomes: Sequence[Outcome], command: str) -> str:
    """The study as Markdown."""
    head = f"""# Random benches

Made by `{command}`.

Benches as `random_benches.py` draws them, in a file for each log. `successful`: share of the benches; `misfit`, `open` (undetermined)
and `stopped` (not converged) the others, all with why. A filter that is not stated is what a misfit should say. `G`, `tau`, `f0`,
`k_T`: share of the intervals value +- 1.96 std of the successful that hold the truth; of a step alone G is covered too often by design
(coverage.md). `warned`, `silent`: called successful, and a parameter more than {FAR:g} standard deviations off; with a warning that
something unseen would move one by so many of them, and without.

| | benches | successful, % | misfit | open | stopped | {" | ".join(NAMES)} | warned | silent |
|---|---|---|---|---|---|{"---|" * len(NAMES)}---|---|
"""
    traits = sorted({t for o in outcomes for t in o.traits}, key=lambda t: (t != "all", t))
    rows = (_row(t, [o for o in outcomes if t in o.traits]) for t in traits)
    return f"{head}{chr(10).join(rows)}\n{_named(outcomes)}"


def _row(trait: str, outcomes: Sequence[Outcome]) -> str:
    ends = Counter(o.result for o in outcomes)
    good = [o for o in outcomes if o.result == "successful"]
    covered = []
    for name in NAMES:
        z = np.array([o.scores[name] for o in good if name in o.scores])
        covered.append(f"{100 * np.mean(np.abs(z) < 1.96):.1f} of {len(z)}" if len(z) else "")
    silent = sum(o.silent for o in outcomes)
    warned = sum(o.far for o in outcomes) - silent
    counts = [ends["misfit"], ends["undetermined"], ends["not_converged"], *covered, warned, silent]
    return f"| {trait} | {len(outcomes)} | {100 * len(good) / len(outcomes):.1f} | {' | '.join(map(str, counts))} |"


def _named(outcomes: Sequence[Outcome]) -> str:
    """Those that are far off, and those that raised."""
    lines = []
    for o in outcomes:
        if o.far or o.result == "raised":
            scores = ", ".join(f"{n} {z:+.1f}" for n, z in o.scores.items())
            lines.append(
                f"- seed {o.seed} ({', '.join(o.traits[1:])}): {o.result}; {scores}; said: {'; '.join(o.said) or 'nothing'}"
            )
    return "\nFar off, or raised:\n\n" + "\n".join(lines) + "\n" if lines else ""


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--benches", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        one, seeds = (
            partial(outcome, folder=given.keep or Path(folder, "logs")),
            range(given.seed, given.seed + given.benches),
        )
        # A process that has loaded hundreds of programs runs out of what an operating system maps.
        with get_context("spawn").Pool(given.jobs, _begin, (folder,), maxtasksperchild=60) as workers:
            made = workers.imap(one, seeds, chunksize=2)
            outcomes = list(track(made, total=len(seeds), console=Console(stderr=True)))
    command = f"python benchmarks/random_benches.py --benches {given.benches} --seed {given.seed} --jobs {given.jobs}"
    (HERE / "random_benches.md").write_text(table(outcomes, command), encoding="utf-8")
    print(table(outcomes, command))


if __name__ == "__main__":
    main()
