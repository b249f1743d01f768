"""The log of a scene: its fidelity, its rows and its metadata."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from sysid.logs.log import Log
from sysid.scene.auto import choose
from sysid.scene.carrier import behind_lock_in
from sysid.scene.effects import Delay, Inverter, LockIn
from sysid.scene.scene import Scene
from sysid.scene.timeline import Columns, rows


def simulate(scene: Scene, seed: int) -> Log:
    """The whole log."""
    parts = list(_pieces(scene, seed))
    return _log(
        scene, {k: None if v is None else np.concatenate([p[k] for p in parts]) for k, v in parts[0].items()}
    )


def stream(scene: Scene, seed: int) -> Iterator[Log]:
    """The log in successive pieces, in bounded memory."""
    return (_log(scene, columns) for columns in _pieces(scene, seed))


def resolved(scene: Scene) -> Scene:
    """The scene with its fidelity chosen: "auto" replaced by a rung and a number of steps between rows."""
    if scene.kind == "steady":
        return dataclasses.replace(scene, fidelity="steady")
    return choose(scene) if scene.fidelity == "auto" else scene


def _pieces(scene: Scene, seed: int) -> Iterator[Columns]:
    scene = resolved(scene)
    if scene.fidelity == "carrier":
        yield behind_lock_in(scene, seed)
        return
    for columns in rows(scene, seed, 0, scene.rows):
        yield columns | {
            "response": np.abs(columns["response"]) if scene.amplitude_only else columns["response"]
        }


def _log(scene: Scene, columns: Columns) -> Log:
    for values in columns.values():
        if values is not None:
            values.flags.writeable = False  # they are the log's alone, which then need not copy them
    bench = {}
    if lock_in := scene.find(LockIn):
        bench = {"lockin_tau_s": float(lock_in.tau), "lockin_order": float(lock_in.order)}
    if delay := scene.find(Delay):
        bench["delay_s"] = float(delay.time)
    return Log(
        scene.name,
        columns["response"],
        time=columns["time"],
        drive=columns["drive"],
        frequency=columns["frequency"],
        temperature=columns["temperature"],
        force=columns["force"],
        kind=scene.kind,
        sampling=None if scene.kind == "steady" else "instant",
        response_unit=scene.response_unit,
        drive_unit="duty" if scene.find(Inverter) else scene.drive_unit,
        metadata=scene.metadata,
        bench=bench,
    )
