"""The choice of fidelity for a scene: the cheapest, with the largest step, whose error is within the scene's
tolerance.

Each candidate is simulated without noise on those stretches of the scene where the plate does most, and
compared with the exact envelope at steps so small that halving them changes nothing.
"""

import dataclasses

import jax
import numpy as np

from sysid.model.plant import steady
from sysid.scene import engine
from sysid.scene.effects import LockIn, PhaseReset
from sysid.scene.scene import Scene, SceneError
from sysid.scene.timeline import held, inputs_at, rows

MOST = 256  # steps between two rows
PILOT = 16384  # rows of a long scene that are tried, about
POINTS = 65536  # at which a long scene is looked at, to find them
FORGOTTEN = 20.0  # time constants after which nothing is left of how a stretch began


def choose(scene: Scene) -> Scene:
    """The scene with its rung and steps. Raises SceneError when MOST steps do not suffice."""
    stretches = _stretches(scene)
    truth, steps, left = _converged(scene, stretches)
    size = max(float(np.max(np.abs(rows))) for rows in truth)
    allowed = scene.tolerance * size - left
    moving = any(hasattr(e, "feels") or e.name in ("lock_in", "delay") for e in scene.effects)
    rungs = [*engine.RUNGS[-1:]] if scene.find(PhaseReset) else [*engine.RUNGS[moving:]]
    before: dict[str, float] = {}
    substeps = 1
    while substeps <= steps:
        for rung in tuple(rungs):
            error = _error(scene, stretches, truth, rung, substeps)
            if error <= allowed:
                return dataclasses.replace(scene, fidelity=rung, substeps=substeps)
            if rung == "steady" or (rung != "exact" and error > 0.7 * before.get(rung, np.inf)):
                rungs.remove(rung)  # what is left is the error of the model: smaller steps do not mend it
            before[rung] = error
        substeps *= 2
    raise SceneError(f"{scene.name}: found no fidelity within tolerance {scene.tolerance:g}, expected a"
    f" larger one: the error"
                     f" that is left at {steps} steps between rows is"
                     f" {left / max(size, 1e-300):.2g}")  # fmt: skip


def _converged(scene: Scene, stretches: list[tuple[int, int, int]]) -> tuple[list[np.ndarray], int, float]:
    """The exact envelope at small steps, how many, and the error that is left in it."""
    steps, rows = 1, _rows(scene, stretches, "exact", 1)
    while True:
        finer = _rows(scene, stretches, "exact", 2 * steps)
        # Errors are of second order: halving the step leaves a third of the change, and a margin of three.
        left = max(float(np.max(np.abs(a - b))) for a, b in zip(rows, finer, strict=True))
        rows, steps = finer, 2 * steps
        size = max(float(np.max(np.abs(r))) for r in rows)
        if left <= 0.1 * scene.tolerance * size or steps >= MOST:
            return rows, steps, left


def _error(scene: Scene, stretches, truth: list[np.ndarray], rung: str, substeps: int) -> float:
    rows = _rows(scene, stretches, rung, substeps)
    return max(float(np.max(np.abs(a - b))) for a, b in zip(rows, truth, strict=True))


def _stretches(scene: Scene) -> list[tuple[int, int, int]]:
    """(first row, row from which it counts, last row): the whole of a short scene; of a long one its
    beginning, its end, and where drive, detuning, damping or response are largest, smallest or change
    most."""
    whole = [(0, 0, scene.rows)]
    if scene.rows <= PILOT or any(hasattr(e, "feels") for e in scene.effects):
        return whole
    plates = engine.resonances(scene.plant, scene.effects)
    filters = sum(e.order * e.tau for e in scene.effects if isinstance(e, LockIn))
    memory = FORGOTTEN * (max(p.tau for p in plates) + filters) * scene.rate
    changes = [p.edges(0.0, scene.duration) for p in scene.inputs.values()]
    time = np.unique(
        np.concatenate([np.linspace(0.0, scene.duration, POINTS), *(c for c in changes if len(c) <= POINTS)])
    )
    with jax.enable_x64(True):
        inputs = held(scene, inputs_at(scene, time), 0)
        found = engine.motion(scene.plant, inputs, scene.effects, scene.reference)
        settled = found.drive * steady(found.tau, found.detuning, inputs.omega)
    where = [np.zeros(1, int), np.array([len(time) - 1])]
    for quantity in (*found, np.abs(settled)):
        does = np.broadcast_to(np.asarray(quantity), len(time))
        most = np.argsort(-np.abs(np.diff(does)), kind="stable")[:3] + 1
        where += [most, np.array([np.argmax(does), np.argmin(does)])]
    width = PILOT // 16
    middle = np.unique((time[np.concatenate(where)] * scene.rate).astype(int))
    first = np.unique(np.clip(middle - width // 2, 0, max(scene.rows - width, 0)))
    stretches = [(max(int(s - memory), 0), int(s), int(s) + width) for s in first]
    return whole if sum(last - first for first, _, last in stretches) >= scene.rows else stretches


def _rows(scene: Scene, stretches: list[tuple[int, int, int]], rung: str, substeps: int) -> list[np.ndarray]:
    """The plate's response in each stretch, as the filter passes it; a stretch begins from rest before it
    counts."""
    plate = tuple(e for e in scene.effects if e.kind != "noise")
    longest = max(last - first for first, _, last in stretches)
    quiet = dataclasses.replace(scene, effects=plate, fidelity=rung, substeps=substeps, rows=longest)
    found = []
    for first, counts, last in stretches:
        response = np.concatenate([columns["response"] for columns in rows(quiet, 0, first, last)])
        found.append(response[counts - first :])
    return found
