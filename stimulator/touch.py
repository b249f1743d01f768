"""A finger strokes a texture on the plate: where it is, what is sensed and asked for, the plate's motion,
friction, judgement.

Finger and sensors do not depend on the plate, so they come before its run, and friction and the observer
after it:

    stroke -> forces -> texture -> reference -> plate, open or closed -> friction -> contrast -> observer

Each part is optional. One that a scene lacks is not imported, and the others' numbers keep their bits.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stimulator.errors import StimulatorError, refuse
from sysid.logs.log import Log
from sysid.scene.effects import Delay, FingerDamping, Inverter, LockIn
from sysid.scene.profile import Profile
from sysid.scene.scene import Scene, SceneError
from sysid.tables import units

PLATE = (198.0, 138.0)  # mm, of the paper
BATCH = 256  # touches that are held at a time


@dataclass(frozen=True, eq=False)
class TouchScene:
    """What happens, part by part; None: it does not.

    `plate`: a scene of `sysid`, whose drive and force are replaced by what texture and stroke make of them.
    `finger`: its place on the mode shape (`Finger`, `OnMode`); without one it is the same everywhere.
    `forces`: without them the program knows the true position. `loop`: what `controller.design` is told, or
    a Loop; without it the drive is V = reference/G. `size` of the plate in mm. `seed` of whatever is
    random; each part has a stream of its own.

    Raises StimulatorError for parts that need another.
    """

    plate: Scene
    stroke: Any = None
    finger: Any = None
    forces: Any = None
    texture: Any = None
    friction: Any = None
    loop: Any = None
    observer: Any = None
    size: tuple[float, float] = PLATE
    seed: int = 0
    name: str = "touch"

    def __post_init__(self) -> None:
        if self.plate.kind == "steady":
            refuse("plate_scene", "a scene of settled points", "kind = 'transient': a stroke takes time")
        needs = {
            "finger": ("stroke",), "forces": ("stroke",), "texture": ("stroke",), "friction": ("stroke",),
            "observer": ("friction", "texture"),
        }  # fmt: skip
        for part, others in needs.items():
            for other in others:
                if getattr(self, part) is not None and getattr(self, other) is None:
                    refuse(other, "nothing", f"a table [{other}]: [{part}] needs it")
        if self.finger is not None and not self.plate.find(FingerDamping):
            refuse("plate_scene", "no effects.finger_damping", "it: [finger] says where that damping acts")
        if (self.texture or self.friction) and not units.same_kind(self.plate.response_unit, "um"):
            refuse("plate_scene", f"a response in {self.plate.response_unit}", "a length: textures are in um")
        if self.texture is not None and self.plate.find(Inverter):
            refuse("plate_scene", "effects.inverter", "a drive in the plant's own unit: V = reference/G")
        if self.stroke is not None:
            self.stroke.stay(self.size)

    @classmethod
    def from_toml(cls, path: str | Path) -> "TouchScene":
        """The scene of a TOML file. Raises SceneError that points at the key."""
        from stimulator.toml import parts

        try:
            scene = cls(**parts(Path(path)))
            scene.designed  # noqa: B018  a loop that cannot be had is refused with its file
        except StimulatorError as error:
            raise SceneError(f"{path}: {error}") from None
        return scene

    def run(self, loop: Any = None) -> "Touch":
        """What happens, with `loop` (a Loop of `controller.design`) or the scene's own; in open loop where
        there is neither."""
        return next(run_all([self], loop))

    @property
    def opened(self) -> "TouchScene":
        """The same without its loop, and so without the observer who compares the two."""
        return dataclasses.replace(self, loop=None, observer=None)

    @cached_property
    def designed(self) -> Any:
        """The scene's Loop, or None. A table of `controller.design` is designed for the plate, the largest
        amplitude of the texture and what a finger of 1.5 N takes where it takes most. Raises
        StimulatorError for one that cannot be had."""
        if not isinstance(self.loop, dict):
            return self.loop
        import controller

        most = {} if self.texture is None else {"amplitude": self.texture.amplitude * self.per_um}
        if (damping := self.plate.find(FingerDamping)) and self.stroke is not None:
            place = 1.0 if self.finger is None else float(self.contact.values.max())
            most["finger"] = float(damping.rho) * place
        try:
            return controller.design(self.plate.plant, **(most | self.loop))
        except ValueError as error:
            raise StimulatorError(f"loop: {error}") from None

    @property
    def per_um(self) -> float:
        """Of the plate's response unit in 1 um."""
        return float(units.convert(1.0, "um", self.plate.response_unit))

    def with_plant(self, plant: Any) -> "TouchScene":
        """The same touch of another plant: a fit's, or a draw of its posterior."""
        return dataclasses.replace(self, plate=self.plate.with_plant(plant))

    def bench(self, reference: Profile | None, G: float) -> Scene:
        """The plate's scene under the finger, asked for `reference` by its drive over `G`."""
        inputs = dict(self.plate.inputs)
        if reference is not None:
            inputs["drive"] = Profile(reference.times, reference.values / G, reference.held)
        if self.stroke is not None:
            inputs["force"] = self.stroke.force
        if self.finger is not None:
            inputs["contact"] = self.contact
        return dataclasses.replace(self.plate, inputs=inputs)

    @cached_property
    def contact(self) -> Profile:
        """The weight of the mode shape at the finger, on the plate scene's rows and straight between them."""
        time = np.arange(self.plate.rows) / self.plate.rate
        return Profile(time, self.finger.contact(*self.stroke.at(time)), held=False)

    def asked(self, sensed: Any) -> Profile | None:
        """The amplitude that the texture asks for, held between readings; None without a texture."""
        if self.texture is None:
            return None
        if sensed is not None:
            return Profile(sensed.time, self.per_um * self.texture.at(sensed.x))
        time = np.arange(self.plate.rows) / self.plate.rate
        return Profile(time, self.per_um * self.texture.at(self.stroke.x.at(time)))


@dataclass(frozen=True, eq=False)
class Touch:
    """What happened, at `time` (n,) s. `Wd`, `Wq`, `W`: the plate's motion (peak, the scene's unit);
    `measured`: what its sensor told; `V`, `f`: the command; `reference`: what was asked for. None where
    the scene lacks the part: `x`, `y` (mm) and `force` (N) of the finger; `sensed`, a `forces.Sensed`;
    `friction`, mu. `compared`: the same touch in open loop, where there is an observer."""

    scene: TouchScene
    time: np.ndarray
    Wd: np.ndarray
    Wq: np.ndarray
    measured: np.ndarray
    V: np.ndarray
    f: np.ndarray
    reference: np.ndarray
    loop: Any = None
    sensed: Any = None
    compared: "Touch | None" = None

    @property
    def W(self) -> np.ndarray:
        """Peak amplitude |Wd + j Wq|."""
        return np.hypot(self.Wd, self.Wq)

    @property
    def finger(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, y and force of the finger."""
        return self.scene.stroke.at(self.time)

    @property
    def x(self) -> np.ndarray | None:
        """Of the finger, mm; None without a stroke."""
        return None if self.scene.stroke is None else self.scene.stroke.x.at(self.time)

    @property
    def force(self) -> np.ndarray | None:
        """Of the finger, N; None without a stroke."""
        return None if self.scene.stroke is None else self.scene.stroke.force.at(self.time)

    @cached_property
    def friction(self) -> np.ndarray | None:
        """mu. The film lives on the mean square of the motion under the finger: on W where no shape is
        stated, else on W times the root of `contact`, which is W on the average over the plate."""
        law = self.scene.friction
        if law is None:
            return None
        local = 1.0 if self.scene.finger is None else np.sqrt(self.scene.contact.at(self.time))
        return law.friction(self.W / self.scene.per_um * local, self.force)

    @cached_property
    def judgement(self) -> float | None:
        """P that this touch is said to be the stronger of itself and the open loop's; None without an
        observer."""
        observer = self.scene.observer
        if observer is None or self.compared is None:
            return None
        pressed = float(np.mean(self.force))
        return observer.prefers(observer.felt(self), observer.felt(self.compared), pressed)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What reaches beyond what is known, or beyond what the bench can do, as sentences that begin with
        a key."""
        from stimulator.limits import warnings_of

        return tuple(warnings_of(self))

    def log(self) -> Log:
        """As a bench would have recorded it: a Log that `identify` reads.

        In closed loop a command acts `latency` after the reading that it answers: rows are at the times at
        which commands begin to act, and their readings are late by that and by the loop's demodulator.
        """
        scene = self.scene.plate
        late = 0.0 if self.loop is None else float(self.loop.latency)
        delay = late + _demodulated(self.loop) + (effect.time if (effect := scene.find(Delay)) else 0.0)
        bench = {"delay_s": float(delay)} if delay else {}
        if filtered := scene.find(LockIn):
            bench |= {"lockin_tau_s": float(filtered.tau), "lockin_order": float(filtered.order)}
        known = {
            "temperature": scene.inputs.get("temperature"),
            "force": getattr(self.scene.stroke, "force", None),
        }
        time = self.time + late
        felt = {name: None if p is None else p.at(time) for name, p in known.items()}
        return Log(
            self.scene.name,
            self.measured,
            time=time,
            drive=self.V,
            frequency=self.f,
            kind="transient",
            sampling="instant",
            response_unit=scene.response_unit,
            drive_unit=scene.drive_unit,
            metadata=scene.metadata,
            bench=bench,
            **felt,
        )

    def columns(self) -> dict[str, np.ndarray]:
        """What no log holds, by names that end in a unit: the finger, what was sensed of it, what was asked
        for, W, mu."""
        unit = self.scene.plate.response_unit
        found = {
            "x_mm": self.x,
            f"reference_{unit}": self.reference,
            f"motion_{unit}": self.W,
            "friction": self.friction,
        }
        if self.x is not None:
            found["y_mm"] = self.finger[1]
        if (sensed := self.sensed) is not None:
            row = np.maximum(np.searchsorted(sensed.time, self.time * (1 + 1e-12), side="right") - 1, 0)
            found |= {
                "sensed_x_mm": sensed.x[row],
                "sensed_y_mm": sensed.y[row],
                "sensed_force_N": sensed.force[row],
            }
        return {name: v for name, v in found.items() if v is not None}


def _demodulated(loop: Any) -> float:
    """By how much the demodulator makes a loop's readings late, s, where `controller.closed_loop` plays it,
    as it does for loops that have a `delay`."""
    played = loop is not None and loop.demodulator is not None
    return float(loop.demodulator.delay) if played else 0.0


def run_all(scenes: Sequence[TouchScene], loop: Any = None) -> Iterator[Touch]:
    """Each scene's touch in turn; scenes of the same effects are played side by side, `BATCH` at a time."""
    for start in range(0, len(scenes), BATCH):
        batch = scenes[start : start + BATCH]
        sensed = _sensed(batch)
        closed = [scene.designed if loop is None else loop for scene in batch]
        touches = _played(batch, sensed, closed)
        judged = [k for k, scene in enumerate(batch) if scene.observer is not None and closed[k] is not None]
        opened = [batch[k].opened for k in judged]
        compared = _played(opened, [sensed[k] for k in judged], [None] * len(judged))
        for k, other in zip(judged, compared, strict=True):
            touches[k] = dataclasses.replace(touches[k], compared=other)
        yield from touches


def _sensed(scenes: Sequence[TouchScene]) -> list[Any]:
    """What is sensed of each scene's finger; scenes with the same sensors at once, in the order of the
    scenes."""
    found: list[Any] = [None] * len(scenes)
    for members in _alike([s.forces and (s.forces, s.size, s.plate.duration) for s in scenes]):
        first = scenes[members[0]]
        strokes, seeds = [scenes[k].stroke for k in members], [scenes[k].seed for k in members]
        read = first.forces.read(strokes, first.size, first.plate.duration, seeds)
        for j, k in enumerate(members):
            found[k] = read._replace(**{name: getattr(read, name)[:, j] for name in ("x", "y", "force")})
    return found


def _played(scenes: Sequence[TouchScene], sensed: Sequence[Any], loops: Sequence[Any]) -> list[Touch]:
    """The touches of scenes that are all open (None) or each in its loop."""
    asked = [scene.asked(s) for scene, s in zip(scenes, sensed, strict=True)]
    G = [scene.plate.plant.G if loop is None else loop.G for scene, loop in zip(scenes, loops, strict=True)]
    benches = [scene.bench(*given) for scene, given in zip(scenes, zip(asked, G, strict=True), strict=True)]
    traces: dict[int, Any] = {}
    for members in _alike([loop and _kind(bench, loop) for bench, loop in zip(benches, loops, strict=True)]):
        import controller

        given = ([rows[k] for k in members] for rows in (loops, benches))
        run = controller.closed_loops(*given, None, [scenes[k].seed for k in members])
        traces |= dict(zip(members, run, strict=True))
    return [
        _closed(scenes[k], traces[k], loops[k], sensed[k])
        if k in traces
        else _open(scenes[k], benches[k], G[k], sensed[k])
        for k in range(len(scenes))
    ]


def _alike(kinds: Sequence[Any]) -> list[list[int]]:
    """Indices of those of each kind; of None there is none."""
    found: dict[Any, list[int]] = {}
    for k, kind in enumerate(kinds):
        if kind is not None:
            found.setdefault(kind, []).append(k)
    return list(found.values())


def _kind(bench: Scene, loop: Any) -> Any:
    """Equal of what can be played side by side: one law, in scenes of the same effects and inputs."""
    import jax

    structure = jax.tree.structure((loop.control, bench.plant, bench.effects))
    return structure, bench.fidelity, frozenset(bench.inputs)


def _closed(scene: TouchScene, trace: Any, loop: Any, sensed: Any) -> Touch:
    columns = (trace.time, trace.Wd, trace.Wq, trace.measured, trace.V, trace.f, trace.reference)
    return Touch(scene, *columns, loop, sensed)


def _open(scene: TouchScene, bench: Scene, G: float, sensed: Any) -> Touch:
    """In open loop the sensor's noise and phase do not act on the plate: its motion is that of the scene
    without them."""
    log = bench.simulate(scene.seed)
    plain: tuple[Any, ...] = tuple(e for e in bench.effects if e.kind in ("drive", "plate"))
    quiet = tuple(dataclasses.replace(e, seen=1.0) if e.name == "second_mode" else e for e in plain)
    motion = log if quiet == bench.effects else dataclasses.replace(bench, effects=quiet).simulate()
    W = np.asarray(motion.response)
    measured, drive = np.asarray(log.response), np.asarray(log.drive)
    return Touch(scene, log.time, W.real, W.imag, measured, drive, log.frequency, G * drive, None, sensed)
