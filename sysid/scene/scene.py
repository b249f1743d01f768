"""A scene: the plant, its inputs over time, and the effects that it names; simulated to a log.

[plant]
G_um_per_V = 0.02
tau_ms = 1.669
f0_kHz = 32.3
k_T = -10.16

[log]
rate_kHz = 10
duration_ms = 30

[inputs]
voltage_V = {steps = [[0, 0], [2e-3, 100]]}
frequency_Hz = 32300

[effects.white_noise]
std_nm = 20
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sysid.logs.log import Log
from sysid.model.plant import Plant
from sysid.scene import engine
from sysid.scene.effects import (
    EFFECTS,
    Delay,
    FingerDamping,
    FingerDetuning,
    FrequencyResolution,
    Inputs,
    Inverter,
    LockIn,
    PhaseReset,
    SelfHeating,
)
from sysid.scene.profile import Profile

FIDELITIES = (*engine.RUNGS, "carrier", "auto")
Phase = Callable[[int, int], np.ndarray]
LANES = 65536  # intervals of a chunk
SPARE = 256  # of them, for changes between rows
NEAR = 1e-6  # of the time between rows: a change of the inputs as near as that to a row is at the row


class SceneError(ValueError):
    """A scene that cannot be: says the file, the key, what was found and what was expected."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What happens on the bench. `inputs`: a Profile each of "drive", "frequency" (Hz), and as wanted "temperature" (degC) and
    "force" (N). `rows` rows at `rate` Hz; `kind` "transient" or "steady". `fidelity`: one of FIDELITIES; "carrier" are raw
    samples behind a lock-in; "auto" is the cheapest envelope, with the largest time step, whose error stays below `tolerance`
    times the largest response.

    Raises SceneError for what cannot be combined.
    """

    plant: Plant
    inputs: Mapping[str, Profile]
    rows: int
    rate: float
    effects: tuple = ()
    name: str = "scene"
    kind: str = "transient"
    fidelity: str = "exact"
    tolerance: float = 1e-4
    substeps: int = 1
    amplitude_only: bool = False
    timed: bool = False  # settled points with a time stamp each
    response_unit: str = "um"
    drive_unit: str = "V"
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        order = list(EFFECTS.values())
        effects: list[Any] = sorted(self.effects, key=lambda e: order.index(type(e)))
        if finger := next((e for e in effects if isinstance(e, FingerDamping)), None):
            effects = [dataclasses.replace(e, finger=finger) if e.name == "finger_detuning" else e for e in effects]
        object.__setattr__(self, "effects", tuple(effects))
        for said in _contradictions(self):
            raise SceneError(f"{self.name}: {said}")
        object.__setattr__(self, "inputs", {name: p.snapped(self.rate, NEAR) for name, p in self.inputs.items()})

    @classmethod
    def from_toml(cls, path: str | Path) -> "Scene":
        """The scene of a TOML file. Raises SceneError that points at the key."""
        from sysid.scene.toml import load

        return load(Path(path))

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return (self.rows - 1) / self.rate

    def with_plant(self, plant: Plant) -> "Scene":
        """The same scene with another plant: a fit's, or a draw of its posterior."""
        return dataclasses.replace(self, plant=plant)

    def simulate(self, seed: int = 0) -> Log:
        """The log of this scene. The same seed gives the same noise, whatever else the scene holds; a scene of another name has
        noise of its own."""
        parts = list(self._stream(seed))
        return self._log({k: None if v is None else np.concatenate([p[k] for p in parts]) for k, v in parts[0].items()})

    def stream(self, seed: int = 0) -> Iterator[Log]:
        """The log in successive pieces, in bounded memory."""
        return (self._log(columns) for columns in self._stream(seed))

    def _stream(self, seed: int, theta: Phase | None = None) -> Iterator[dict[str, np.ndarray | None]]:
        """Columns in successive pieces; with the carrier's phase `theta`, as a function of first row and count, rows are what
        samples of the carrier hold."""
        scene = self.resolved()
        if scene.fidelity == "carrier":
            from sysid.scene.carrier import behind_lock_in

            yield behind_lock_in(scene, seed)
            return
        for columns in scene._chunks(seed, 0, scene.rows, theta):
            yield columns | {"response": np.abs(columns["response"]) if scene.amplitude_only else columns["response"]}

    def _chunks(self, seed: int, first: int, last: int, theta: Phase | None = None) -> Iterator[dict[str, np.ndarray]]:
        """Columns of the rows from `first` up to `last`, chunk by chunk; the plate is at rest at `first`."""
        plant = jax.tree.map(float, self.plant)  # an integer would be another program
        with jax.enable_x64(True):
            key = engine.key_of(seed, self.name)
            state = engine.start(self.fidelity, plant, self.effects, key)
        for at in range(first, last, self._chunk_rows):
            count = min(self._chunk_rows, last - at)
            with jax.enable_x64(True):
                chunk, columns = self._chunk(at, count)
                if theta:
                    chunk = chunk._replace(theta=theta(at, len(chunk.take)))
                response, state = engine.advance(
                    plant, self.effects, state, chunk, key, jnp.asarray(at // self._chunk_rows), 1 / self.rate, self.fidelity,
                    self._reference,
                )  # fmt: skip
            yield columns | {"response": np.asarray(response)[:count]}

    def resolved(self) -> "Scene":
        """This scene with its fidelity chosen: "auto" replaced by a rung and a number of steps between rows."""
        if self.kind == "steady":
            return dataclasses.replace(self, fidelity="steady")
        if self.fidelity != "auto":
            return self
        from sysid.scene.auto import choose

        return choose(self)

    @property
    def _reference(self) -> float:
        return float(self.plant.f0)

    @property
    def _chunk_rows(self) -> int:
        most = (LANES - SPARE) // self.substeps
        return min(most, 1 << (max(self.rows, 64) - 1).bit_length())

    @property
    def _chunk_intervals(self) -> int:
        """Intervals that a chunk is padded to; of few sizes where steps are tried out, as each size is a program of its own."""
        wanted = self._chunk_rows * self.substeps + SPARE
        return wanted if self.substeps == 1 else 4 ** math.ceil(math.log(wanted, 4) - 1e-9)

    @property
    def _asks_for_rows(self) -> bool:
        """Whether what is read depends on the inputs at a row, beside those of the intervals."""
        return self.fidelity == "steady" or any(hasattr(e, "sense") for e in self.effects)

    def find(self, kind: Any) -> Any:
        """The scene's effect of a kind, or None."""
        return next((e for e in self.effects if isinstance(e, kind)), None)

    def _chunk(self, first: int, count: int) -> tuple[engine.Chunk, dict[str, np.ndarray | None]]:
        """Rows `first` to `first + count` as intervals; durations count from the chunk's first row: long scenes lose nothing."""
        size, exact = self._chunk_rows, Fraction(self.rate)
        begin, before = float(Fraction(first) / exact), max(first - 1, 0)
        time = (first + np.arange(count)) / self.rate
        late = delay.time if (delay := self.find(Delay)) else 0.0
        # The row before is where the chunk begins; nothing is read before the scene does.
        read = np.maximum(np.append(before / self.rate, time) - late, 0.0)
        near = np.append(float(Fraction(before - first) / exact), np.arange(count) / self.rate) - late
        knots, span = self._knots(read, np.maximum(near, -begin), begin)
        middle = 0.5 * (span[1:] + span[:-1]) + begin
        padded = self._chunk_intervals
        padded += -(-max(len(span) - padded, 0) // 4096) * 4096  # one more than the intervals: the last row is read after them
        fill = padded - len(middle)
        rows = self._held(self._felt(time if self.kind == "steady" else read[1:]), size - count) if self._asks_for_rows else None
        chunk = engine.Chunk(
            duration=np.pad(np.diff(span), (0, fill)),
            inputs=self._held(self._inputs(middle), fill),
            take=np.pad(np.searchsorted(knots, read[1:]) * self.substeps, (0, size - count), mode="edge"),
            rows=rows,
            turn=self._turns(knots, padded) if self.find(PhaseReset) else None,
        )
        recorded = self._inputs(time, commanded=True)
        return engine.folded(chunk), {"time": time if self.timed or self.kind != "steady" else None, **recorded}

    def _knots(self, read: np.ndarray, near: np.ndarray, begin: float) -> tuple[np.ndarray, np.ndarray]:
        """Times (s) at which inputs change or rows are read; and, from `begin` on, those with the steps between.

        Which of two comes first is decided by their times as they are written, `read` and those of the profiles, also where a
        row and a change share one; `near` are the times of `read` from `begin` on, exact also late in a scene.
        """
        edges = np.concatenate([p.edges(read[0], read[-1]) for p in self.inputs.values()] + [self._roundings(read[0], read[-1])])
        knots, at = np.unique(np.append(read, edges), return_index=True)
        span = np.maximum.accumulate(np.append(near, edges - begin)[at])
        span = np.repeat(span, 2) if len(span) == 1 else span  # a single row: an interval without length
        if self.substeps > 1:
            share = np.arange(self.substeps) / self.substeps
            span = np.append((span[:-1, None] + np.diff(span)[:, None] * share).ravel(), span[-1])
        return knots, span

    def _roundings(self, begin: float, end: float) -> np.ndarray:
        """Times at which a ramp's frequency is rounded to the next step; none where they are more than a chunk holds."""
        profile, resolution = self.inputs["frequency"], self.find(FrequencyResolution)
        if resolution is None or profile.held:
            return np.empty(0)
        bends = np.concatenate([[begin], profile.edges(begin, end), [end]])
        level = profile.at(bends) / resolution.step - 0.5
        first = np.ceil(np.minimum(level[:-1], level[1:]))
        count = np.maximum(np.ceil(np.maximum(level[:-1], level[1:])) - first, 0)
        if not 0 < count.sum() <= LANES:
            return np.empty(0)
        piece = np.repeat(np.arange(len(count)), count.astype(int))
        crossed = first[piece] + np.arange(len(piece)) - (np.cumsum(count) - count)[piece]
        share = (crossed - level[piece]) / (level[piece + 1] - level[piece])
        return bends[piece] + share * (bends[piece + 1] - bends[piece])

    def _felt(self, read: np.ndarray) -> dict[str, np.ndarray | None]:
        """Inputs that the rows' sensor sees: those just before a row is read, and no drive where the scene only begins."""
        if self.kind == "steady":
            return self._inputs(read)
        found = self._inputs(read, early=1e-6 / self.rate)
        return found | {"drive": np.where(read > 0, found["drive"], 0.0)}

    def _inputs(self, time: np.ndarray, commanded: bool = False, early: float = 0.0) -> dict[str, np.ndarray | None]:
        """Drive, frequency, temperature and force at `time`, of what is held those `early` s before; the frequency is the one
        that the source makes."""
        found: dict[str, Any] = dict.fromkeys(INPUTS)
        found |= {name: p.at(time - early if p.held else time) for name, p in self.inputs.items()}
        resolution = self.find(FrequencyResolution)
        if resolution:
            found["frequency"] = resolution.step * np.round(found["frequency"] / resolution.step)
        if commanded:
            return found
        for e in self.effects:
            if hasattr(e, "drive"):
                given = Inputs(found["drive"], None, None, None, None)
                found["drive"] = np.asarray(e.drive(given).drive)
        return found

    def _held(self, columns: dict[str, np.ndarray | None], fill: int) -> Inputs:
        drive, frequency, temperature, force = (columns[name] for name in INPUTS)
        warming = None if temperature is None else temperature - self.plant.reference_temperature
        held = (drive, 2 * np.pi * frequency, 2 * np.pi * (self._reference - frequency), warming, force)
        return Inputs(*(None if v is None else np.pad(v, (0, fill), mode="edge") for v in held))

    def _turns(self, knots: np.ndarray, size: int) -> np.ndarray:
        """exp(j phase before) at the beginning of each interval that begins with another frequency, else 1."""
        turn = np.ones(size, complex)
        times = self.inputs["frequency"].edges(0.0, knots[-1])
        made = self._inputs(np.append(0.0, times))["frequency"]
        times, before = times[made[1:] != made[:-1]], made[:-1][made[1:] != made[:-1]]
        since = np.append(0.0, times[:-1])
        for i in np.flatnonzero(times >= knots[0]):
            cycles = Fraction(before[i]) * (Fraction(times[i]) - Fraction(since[i]))
            turn[np.searchsorted(knots, times[i]) * self.substeps] = np.exp(2j * np.pi * float(cycles % 1))
        return turn

    def _log(self, columns: dict[str, np.ndarray | None]) -> Log:
        for values in columns.values():
            if values is not None:
                values.flags.writeable = False  # they are the log's alone, which then need not copy them
        bench = {}
        if lock_in := self.find(LockIn):
            bench = {"lockin_tau_s": float(lock_in.tau), "lockin_order": float(lock_in.order)}
        if delay := self.find(Delay):
            bench["delay_s"] = float(delay.time)
        return Log(
            self.name,
            columns["response"],
            time=columns["time"],
            drive=columns["drive"],
            frequency=columns["frequency"],
            temperature=columns["temperature"],
            force=columns["force"],
            kind=self.kind,
            sampling=None if self.kind == "steady" else "instant",
            response_unit=self.response_unit,
            drive_unit="duty" if self.find(Inverter) else self.drive_unit,
            metadata=self.metadata,
            bench=bench,
        )


INPUTS = ("drive", "frequency", "temperature", "force")


def _contradictions(scene: Scene) -> Iterator[str]:
    """What cannot be combined, and why."""
    plant, find = scene.plant, scene.find
    names = [e.name for e in scene.effects]
    if double := next((n for n in names if names.count(n) > 1), None):
        yield f"found effects.{double} twice, expected it once"
    if plant.G is None or plant.f0 is None:
        yield "found a plant without " + ("G" if plant.G is None else "f0") + ", expected G, tau and f0"
    for name in ("drive", "frequency"):
        if name not in scene.inputs:
            yield f"found no profile of the {name}, expected one"
    if find(FingerDamping) and "force" not in scene.inputs:
        yield "found effects.finger_damping and no force, expected inputs.force_N: a finger damps by its force"
    if find(FingerDetuning) and not find(FingerDamping):
        yield "found effects.finger_detuning without effects.finger_damping, expected both: the shift is a share of the damping"
    if find(SelfHeating) and plant.k_T is None:
        yield "found effects.self_heating and a plant without k_T, expected k_T: heat moves nothing else"
    for kind in (EFFECTS["duffing"], EFFECTS["self_heating"]):
        if find(kind) and (scene.kind == "steady" or scene.fidelity == "steady"):
            yield (
                f"found effects.{kind.name} in a scene of settled points, expected kind = 'transient': the response"
                " decides its own resonance, and where it settles depends on what was before"
            )
    for kind in (EFFECTS["lock_in"], EFFECTS["delay"], EFFECTS["phase_reset"]):
        if find(kind) and scene.kind == "steady":
            yield f"found effects.{kind.name} in a scene of settled points, expected kind = 'transient': nothing moves in it"
    if find(PhaseReset) and scene.fidelity not in ("exact", "auto"):
        yield f"found effects.phase_reset at fidelity '{scene.fidelity}', expected 'exact': the others have no phase of their own"
    if find(PhaseReset) and not scene.inputs["frequency"].held:
        yield "found effects.phase_reset and a frequency that ramps, expected steps: a reset at every instant is no drive"
    if scene.fidelity not in FIDELITIES:
        yield f"found fidelity {scene.fidelity!r}, expected one of {', '.join(FIDELITIES)}"
    if scene.kind not in ("transient", "steady"):
        yield f"found kind {scene.kind!r}, expected 'transient' or 'steady'"
    if not (scene.rows >= 1 and np.isfinite(scene.rate) and scene.rate > 0):
        yield f"found {scene.rows} rows at {scene.rate:g} Hz, expected one row or more and a rate above zero"
    if scene.substeps < 1 or scene.substeps > LANES // 4:
        yield f"found {scene.substeps} steps between rows, expected 1 to {LANES // 4}"
