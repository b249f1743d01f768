"""Which fidelity a scene needs: the cheapest, with the largest step, whose error the scene's tolerance allows.

Nothing is looked up: each candidate is simulated, without noise, on those stretches of the scene where its inputs do most, and
compared with the exact envelope at steps so small that halving them changes nothing any more.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from sysid.scene import engine
from sysid.scene.effects import PhaseReset
from sysid.scene.scene import Scene, SceneError

MOST = 64  # steps between two rows
PILOT = 16384  # rows of a long scene that are tried


def choose(scene: Scene) -> Scene:
    """The scene with its rung and steps. Raises SceneError when MOST steps do not suffice."""
    stretches = _stretches(scene)
    truth, steps, left = _converged(scene, stretches)
    size = max(float(np.max(np.abs(rows))) for rows in truth)
    allowed = scene.tolerance * size - left
    rungs = engine.RUNGS[-1:] if scene.find(PhaseReset) else engine.RUNGS
    for rung in rungs:
        if rung == "steady" and any(hasattr(e, "feels") or e.name in ("lock_in", "delay") for e in scene.effects):
            continue
        substeps = 1
        while substeps <= steps:
            if _error(scene, stretches, truth, rung, substeps) <= allowed:
                return dataclasses.replace(scene, fidelity=rung, substeps=substeps)
            if rung in ("steady", "amplitude"):
                break  # their error is that of the model: smaller steps do not mend it
            substeps *= 2
    raise SceneError(f"{scene.name}: found no fidelity within tolerance {scene.tolerance:g}, expected a larger one: the error"
                     f" that is left at {steps} steps between rows is {left / max(size, 1e-300):.2g}")  # fmt: skip


def _converged(scene: Scene, stretches: list[tuple[int, int]]) -> tuple[list[np.ndarray], int, float]:
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


def _stretches(scene: Scene) -> list[tuple[int, int]]:
    """The whole of a short scene; of a long one its beginning, and the stretches about its largest changes."""
    if scene.rows <= PILOT:
        return [(0, scene.rows)]
    width, edges = PILOT // 8, [np.zeros(1)]
    for profile in scene.inputs.values():
        jumps = np.abs(np.diff(profile.values))
        edges.append(profile.times[1:][np.argsort(-jumps, kind="stable")[:3]])
    starts = {int(np.clip(t * scene.rate - 16, 0, scene.rows - width)) for t in np.concatenate(edges)}
    return [(s, s + width) for s in sorted(starts)]


def _rows(scene: Scene, stretches: list[tuple[int, int]], rung: str, substeps: int) -> list[np.ndarray]:
    """The plate's response in each stretch, as the filter passes it; a stretch begins as the scene does, from rest."""
    plate = tuple(e for e in scene.effects if e.kind != "noise")
    quiet = dataclasses.replace(scene, effects=plate, fidelity=rung, substeps=substeps)
    found = []
    for first, last in stretches:
        rows = []
        with jax.enable_x64(True):
            state = engine.start(rung, quiet.plant, quiet.effects, jax.random.key(0))
            while first < last:
                count = min(quiet._chunk_rows, last - first)
                chunk, _ = quiet._chunk(first, count)
                response, state = engine.advance(
                    jax.tree.map(float, quiet.plant), quiet.effects, state, chunk, jax.random.key(0), jnp.asarray(0),
                    1 / quiet.rate, rung, quiet._reference,
                )  # fmt: skip
                rows.append(np.asarray(response)[:count])
                first += count
        found.append(np.concatenate(rows))
    return found
