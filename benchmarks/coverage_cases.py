"""The benches of coverage.py: logs without noise, kinds of noise, and the Cramer-Rao bounds of what each case holds.

Responses are those of `tests/reference.py`, which shares no code with the package; noise and bounds are made here.
"""

import runpy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.special import i0e, i1e

reference = SimpleNamespace(
    **runpy.run_path(str(Path(__file__).parents[1] / "tests" / "reference.py"), run_name="reference")
)
PLANT = reference.Plant(G=1.0, tau=5e-3 / np.log(20), f0=32300.0, k_T=-8.0)
NAMES = ("G", "tau", "f0", "k_T")
MOVES = (
    1e-6,
    1e-6 * PLANT.tau,
    1e-3,
    1e-3,
)  # of finite differences: far above rounding, far below every bound
RATE, EARLY = 1e4, 20  # rows per second of a step; rows before it
ADDED = ("rotation", "feedthrough", "slope", "offset", "start")
FREED = (*ADDED, "delay")  # what the fit eliminates from every log; a delay has a prior of a row


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
    return (
        inputs.drive
        if inputs.time is None
        else np.append(inputs.drive[0] * (inputs.lead > 0), inputs.drive[:-1])
    )


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
        z = reference.ringing(
            plant, moments, drive, inputs.frequency[np.maximum(held, 0)], np.full(len(moments), degC)
        )
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
        white = self.std * (
            self.channels[0] * rng.standard_normal(n) + 1j * self.channels[1] * rng.standard_normal(n)
        )
        if self.outliers and not self.memory:
            return np.where(rng.random(n) < self.outliers, 10.0, 1.0) * white
        noise = white.copy()
        for k in range(1, n):
            noise[k] = self.memory * noise[k - 1] + np.sqrt(1 - self.memory**2) * white[k]
        if self.outliers:
            size = 10 * self.std * (rng.random(n) < self.outliers)
            noise += size * (
                self.channels[0] * rng.standard_normal(n) + 1j * self.channels[1] * rng.standard_normal(n)
            )
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
    if (
        not noise.outliers or noise.memory
    ):  # no bound is known for outliers on top of coloured noise: that without them
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
        sides = [
            response(replace(PLANT, **{name: getattr(PLANT, name) + s * move}), inputs, bench)
            for s in (1, -1)
        ]
        found[name] = (sides[0] - sides[1]) / (2 * move)
    if inputs.amplitude_only:
        return found
    now, drive = response(PLANT, inputs, replace(bench, feedthrough=0.0)), felt(inputs)
    added = {"feedthrough": drive}
    if inputs.time is None:
        added["slope"] = drive * (inputs.frequency - inputs.frequency.mean()) / np.ptp(inputs.frequency)
    else:
        poles = [
            reference.modes(PLANT, f, reference.REFERENCE_TEMPERATURE, PLANT.tau)[0]
            for f in inputs.frequency[:-1]
        ]
        added["offset"] = np.ones(len(drive))
        added["start"] = np.exp(np.append(0, np.cumsum(poles * np.diff(inputs.time))))
    if "rotation" in nuisances:
        found["rotation"] = 1j * now
    for name in (name for name in added if name in nuisances):
        found |= {name: added[name] + 0j, f"{name}, j": 1j * added[name]}
    if "delay" in nuisances and inputs.time is not None:
        late = 1e-3 * np.diff(inputs.time).min()  # forwards: a step cannot come before its edge's row
        found["delay"] = (
            response(PLANT, inputs, replace(bench, feedthrough=0.0, delay=bench.delay + late)) - now
        ) / late
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
    jacobian = np.concatenate(
        [np.stack([p.get(label, np.zeros_like(p[-1, "G"])) for label in labels], axis=1) for p in parts]
    )
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
    std[seen] = np.where(
        lost, np.inf, np.sqrt(np.sum(vectors[:, told] ** 2 / values[told], axis=1)) / size[seen]
    )
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
            yield Case(
                f"5 % outliers on correlation {memory}, {name}",
                logs,
                Noise(memory=memory, outliers=0.05),
                bounded=False,
            )
    for channels, what in (((3.0, 1.0), "d noise 3 times q noise"), ((1.0, 3.0), "q noise 3 times d noise")):
        for name, logs in {"step": one, "sweep": (sweep(),), "step + sweep": two}.items():
            yield Case(f"{what}, {name}", logs, Noise(channels=channels))
        yield Case(
            f"{what}, correlation 0.9, step of 400 rows", (step(400),), Noise(memory=0.9, channels=channels)
        )
    warm = tuple(make(temperature=t) for t in (20.0, 24.0, 30.0) for make in (step, sweep))
    yield Case("joint, 3 steps + 3 sweeps at 20, 24, 30 degC", warm)
    for std in (0.01, 0.03, 0.1, 0.2):
        yield Case(f"amplitude, sweep, noise {100 * std:.0f} %", (sweep(amplitude_only=True),), Noise(std))
    off = (step(detuning=50.0, amplitude_only=True), sweep(amplitude_only=True))
    yield Case("amplitude, step 50 Hz off + sweep", off, bounded=False)
    for std in (0.01, 0.1):  # Rice's distribution, and neighbours that are alike
        slow = Noise(std, memory=0.9)
        yield Case(
            f"amplitude, correlation 0.9, sweep, noise {100 * std:.0f} %", off[1:], slow, bounded=False
        )
        yield Case(
            f"amplitude, correlation 0.9, step 50 Hz off + sweep, noise {100 * std:.0f} %",
            off,
            slow,
            bounded=False,
        )
    for window in (1.0, 0.5):
        yield Case(f"short, step of {window:g} tau", (step(200, 200 / (window * TAU)),))
    for std in (0.1, 0.3):
        for name, logs in {"step": one, "sweep": (sweep(),), "step + sweep": two}.items():
            yield Case(f"noise {100 * std:.0f} %, {name}", logs, Noise(std))
    for level in LEVELS:
        for what in ("rotation", "feedthrough", "delay"):
            yield with_bench(Case(f"{what} at {level:g} of its std, step + sweep", two), what, level, FREED)
        for what in (
            "rotation",
            "feedthrough",
        ):  # a delay and a feedthrough together, one step cannot tell apart
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
