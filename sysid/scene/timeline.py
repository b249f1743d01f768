"""The timeline of a scene: its inputs at any moment, the intervals in which they hold, in chunks, and the
rows of these."""

import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sysid.scene import engine
from sysid.scene.effects import Delay, FrequencyResolution, Inputs, PhaseReset
from sysid.scene.scene import MOST_STEPS, Scene

INPUTS = ("drive", "frequency", "temperature", "force", "contact")
LANES = 4 * MOST_STEPS  # intervals of a chunk
SPARE = 256  # of them, for changes between rows
Columns = dict[str, np.ndarray | None]
Phase = Callable[[int, int], np.ndarray]


def rows(scene: Scene, seed: int, first: int, last: int, theta: Phase | None = None) -> Iterator[Columns]:
    """Columns of the rows from `first` up to `last`, chunk by chunk; the plate is at rest at `first`.
    `theta`: the phase of the carrier by first row and count, where rows are samples of it."""
    plant = jax.tree.map(float, scene.plant)  # an integer would be another program
    with jax.enable_x64(True):
        key = engine.key_of(seed, scene.name)
        state = engine.start(plant, scene.effects, key)
    size = _chunk_rows(scene)
    for at in range(first, last, size):
        count = min(size, last - at)
        with jax.enable_x64(True):
            intervals, columns = chunk(scene, at, count)
            if theta:
                intervals = intervals._replace(theta=theta(at, len(intervals.take)))
            which = jnp.asarray(at // size)
            response, state = engine.advance(
                plant,
                scene.effects,
                state,
                intervals,
                key,
                which,
                1 / scene.rate,
                scene.fidelity,
                scene.reference,
            )
        yield columns | {"response": np.asarray(response)[:count]}


def chunk(scene: Scene, first: int, count: int) -> tuple[engine.Chunk, Columns]:
    """Rows `first` to `first + count` as intervals; durations count from the chunk's first row: long scenes
    lose nothing."""
    size, exact = _chunk_rows(scene), Fraction(scene.rate)
    begin, before = float(Fraction(first) / exact), max(first - 1, 0)
    time = (first + np.arange(count)) / scene.rate
    late = delay.time if (delay := scene.find(Delay)) else 0.0
    # The row before is where the chunk begins; nothing is read before the scene does.
    read = np.maximum(np.append(before / scene.rate, time) - late, 0.0)
    near = np.append(float(Fraction(before - first) / exact), np.arange(count) / scene.rate) - late
    knots, span = _knots(scene, read, np.maximum(near, -begin), begin)
    middle = 0.5 * (span[1:] + span[:-1]) + begin
    padded = _chunk_intervals(scene)
    padded += (
        -(-max(len(span) - padded, 0) // 4096) * 4096
    )  # one more than the intervals: the last row is read after them
    fill = padded - len(middle)
    moments = time if scene.kind == "steady" else read[1:]
    felt = held(scene, _felt(scene, moments), size - count) if _asks_for_rows(scene) else None
    intervals = engine.Chunk(
        duration=np.pad(np.diff(span), (0, fill)),
        inputs=held(scene, inputs_at(scene, middle), fill),
        take=np.pad(np.searchsorted(knots, read[1:]) * scene.substeps, (0, size - count), mode="edge"),
        rows=felt,
        turn=_turns(scene, knots, padded) if scene.find(PhaseReset) else None,
    )
    recorded = inputs_at(scene, time, commanded=True)
    return engine.folded(intervals), {
        "time": time if scene.timed or scene.kind != "steady" else None,
        **recorded,
    }


def inputs_at(scene: Scene, time: np.ndarray, commanded: bool = False, early: float = 0.0) -> Columns:
    """Drive, frequency, temperature, force and contact at `time`, of what is held those `early` s before; the
    frequency is the one that the source makes."""
    found: dict[str, Any] = dict.fromkeys(INPUTS)
    found |= {name: p.at(time - early if p.held else time) for name, p in scene.inputs.items()}
    resolution = scene.find(FrequencyResolution)
    if resolution:
        found["frequency"] = resolution.step * np.round(found["frequency"] / resolution.step)
    if commanded:
        return found
    for e in scene.effects:
        if hasattr(e, "drive"):
            given = Inputs(found["drive"], None, None, None, None)
            found["drive"] = np.asarray(e.drive(given).drive)
    return found


def held(scene: Scene, columns: Columns, fill: int) -> Inputs:
    """Inputs as the engine takes them, in rad/s and degC from the references, the last `fill` more times."""
    drive, frequency, temperature, *finger = (columns[name] for name in INPUTS)
    warming = None if temperature is None else temperature - scene.plant.reference_temperature
    held = (drive, 2 * np.pi * frequency, 2 * np.pi * (scene.reference - frequency), warming, *finger)
    return Inputs(*(None if v is None else np.pad(v, (0, fill), mode="edge") for v in held))


def _chunk_rows(scene: Scene) -> int:
    most = (LANES - SPARE) // scene.substeps
    return min(most, 1 << (max(scene.rows, 64) - 1).bit_length())


def _chunk_intervals(scene: Scene) -> int:
    """Intervals that a chunk is padded to; of few sizes where steps are tried out, as each size is a program
    of its own."""
    wanted = _chunk_rows(scene) * scene.substeps + SPARE
    return wanted if scene.substeps == 1 else 4 ** math.ceil(math.log(wanted, 4) - 1e-9)


def _asks_for_rows(scene: Scene) -> bool:
    """Whether what is read depends on the inputs at a row, beside those of the intervals."""
    return scene.fidelity == "steady" or any(hasattr(e, "sense") for e in scene.effects)


def _knots(scene: Scene, read: np.ndarray, near: np.ndarray, begin: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) at which inputs change or rows are read; and, from `begin` on, those with the steps between.

    Which of two comes first is decided by their times as they are written, `read` and those of the profiles,
    also where a row and a change share one; `near` are the times of `read` from `begin` on, exact also late
    in a scene.
    """
    edges = np.concatenate(
        [p.edges(read[0], read[-1]) for p in scene.inputs.values()] + [_roundings(scene, read[0], read[-1])]
    )
    knots, at = np.unique(np.append(read, edges), return_index=True)
    span = np.maximum.accumulate(np.append(near, edges - begin)[at])
    span = np.repeat(span, 2) if len(span) == 1 else span  # a single row: an interval without length
    return knots, divided(span, scene.substeps)


def divided(span: np.ndarray, substeps: int) -> np.ndarray:
    """Times with `substeps` intervals of one length between each two of them."""
    if substeps == 1 or len(span) < 2:
        return span
    share = np.arange(substeps) / substeps
    return np.append((span[:-1, None] + np.diff(span)[:, None] * share).ravel(), span[-1])


def _roundings(scene: Scene, begin: float, end: float) -> np.ndarray:
    """Times at which a ramp's frequency is rounded to the next step; none where they are more than a chunk
    holds."""
    profile, resolution = scene.inputs["frequency"], scene.find(FrequencyResolution)
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


def _felt(scene: Scene, read: np.ndarray) -> Columns:
    """Inputs that the rows' sensor sees: those just before a row is read, and no drive where the scene only
    begins."""
    if scene.kind == "steady":
        return inputs_at(scene, read)
    found = inputs_at(scene, read, early=1e-6 / scene.rate)
    return found | {"drive": np.where(read > 0, found["drive"], 0.0)}


def _turns(scene: Scene, knots: np.ndarray, size: int) -> np.ndarray:
    """exp(j phase before) at the beginning of each interval that begins with another frequency, else 1."""
    turn = np.ones(size, complex)
    times = scene.inputs["frequency"].edges(0.0, knots[-1])
    made = inputs_at(scene, np.append(0.0, times))["frequency"]
    times, before = times[made[1:] != made[:-1]], made[:-1][made[1:] != made[:-1]]
    since = np.append(0.0, times[:-1])
    for i in np.flatnonzero(times >= knots[0]):
        cycles = Fraction(before[i]) * (Fraction(times[i]) - Fraction(since[i]))
        turn[np.searchsorted(knots, times[i]) * scene.substeps] = np.exp(2j * np.pi * float(cycles % 1))
    return turn
