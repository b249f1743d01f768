"""The closed loop: a sampled controller against the continuous plate of a scene, in one compiled scan.

Time is cut where something happens: where the sensor is sampled, a command takes effect, or an input of the
scene changes. Over each piece the plate moves exactly as it does in an open-loop scene of the same effects
(`sysid.scene.engine`). The controller runs every `sample_time`; what it is told is the sensor's reading of
then (or of the sensor's delay before), what it asks for takes effect `latency` later, and holds. The loop's
own demodulator makes its readings late besides: they lie on straight lines between those of two samples.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from controller.dq import Command
from controller.trace import Trace
from sysid.asked import LOOP, PROFILE, every, number, refuse
from sysid.precision import jitted
from sysid.scene import engine
from sysid.scene.effects import (
    Delay,
    FrequencyResolution,
    Inputs,
    Inverter,
    PhaseReset,
    Quantisation,
    Saturation,
)
from sysid.scene.profile import Profile
from sysid.scene.scene import Scene, SceneError
from sysid.scene.timeline import divided, held, inputs_at

LANES = 128  # runs that are played side by side
NEAR = 1e-6  # of a sample time: events as near as that happen at once
RECORDER = (Saturation, Quantisation)


def closed_loop(loop: Any, scene: Scene, reference: Profile | float | None = None, seed: int = 0) -> Trace:
    """The scene with `loop` (a `Loop`) in place of its drive and its frequency.

    `reference`: the amplitude that is asked for; by default what the scene's drive makes of the plate of the
    design, G V, so that one scene serves both open and closed. A loop without a tracker takes the frequency
    of the scene. The same seed gives the same noise, one value for each sample of the controller. Raises
    SceneError for a scene that has no time of its own.
    """
    return closed_loops(loop, [scene], reference, [seed])[0]


def closed_loops(
    loop: Any,
    scenes: Sequence[Scene],
    reference: Profile | float | None = None,
    seeds: Sequence[int] | None = None,
) -> list[Trace]:
    """`closed_loop` of many scenes side by side, in one compiled program: they name the same effects;
    numbers, profiles and lengths may differ. `loop` may be one, or one for each scene, of one kind."""
    scenes = every("scenes", scenes, Scene, "Scenes, as sysid.Scene.from_toml(path) reads them")
    if not hasattr(loop, "control") and not isinstance(loop, Sequence):
        refuse("loop", loop, LOOP)
    loops = [loop] * len(scenes) if hasattr(loop, "control") else list(loop)
    seeds = range(len(scenes)) if seeds is None else seeds
    cut: dict[tuple[int, int], _Run] = {}  # one scene may have many seeds
    runs = []
    for one, scene, seed in zip(loops, scenes, seeds, strict=True):
        key = id(one), id(scene)
        cut[key] = cut.get(key) or _Run.of(one, _playable(scene), reference)
        runs.append(replace(cut[key], seed=seed))
    if len(found := {r.scene.fidelity for r in runs}) > 1:
        why = f"found fidelities {', '.join(sorted(found))}, expected one for all"
        raise SceneError(f"{scenes[0].name}: {why}")
    readings, commands, samples, pieces = (
        max(n) for n in zip(*((*r.depths, len(r.time), len(r.knots)) for r in runs), strict=True)
    )
    shape = _Shape(readings, commands, _rounded(samples), _rounded(pieces), runs[0].scene.fidelity)
    size = min(len(runs), LANES)
    groups = [runs[k : k + size] for k in range(0, len(runs), size)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(chain.from_iterable(pool.map(partial(_side_by_side, size=size, shape=shape), groups)))


def _side_by_side(runs: list["_Run"], size: int, shape: "_Shape") -> list[Trace]:
    """The traces of `runs`, filled up to `size` of them."""
    filled = runs + runs[:1] * (size - len(runs))
    with jax.enable_x64(True):
        given = [
            (r.loop.control, r.scene.plant, r.scene.effects, r.scene.reference, r.loop.sample_time, r.lag[1])
            for r in filled
        ]
        if len({jax.tree.structure(g) for g in given}) > 1:
            why = "found scenes or loops of different kinds, expected the same effects in all"
            raise SceneError(f"{runs[0].scene.name}: {why}")
        # An integer would be another program.
        numbers = jax.tree.map(lambda *leaves: np.stack(leaves).astype(float), *given)
        once = {id(r.knots): r for r in filled}
        pieces = {key: r.schedule(shape.pieces) for key, r in once.items()}
        schedule = jax.tree.map(lambda *leaves: np.stack(leaves, 1), *(pieces[id(r.knots)] for r in filled))
        rows = jax.tree.map(np.asarray, _play(numbers, schedule, np.array([r.seed for r in filled]), shape))
    return [r.trace(jax.tree.map(lambda v, i=i: v[:, i], rows)) for i, r in enumerate(runs)]


class Schedule(NamedTuple):
    """What happens at the beginning of each piece (M,), and the `inputs` that hold over it, without those of
    the controller. `reads`: the sensor is sampled; `runs`: the controller runs, with the reading of `reading`
    samples before and the scene's numbers of the `latest` sample; `acting`: which command holds, counted back
    from the latest."""

    duration: Any
    reads: Any
    runs: Any
    latest: Any
    reading: Any
    acting: Any
    inputs: Inputs
    reference: Any
    frequency: Any
    temperature: Any


class _Shape(NamedTuple):
    """What decides which program it is: readings and commands on their way, samples, pieces, fidelity."""

    readings: int
    commands: int
    samples: int
    pieces: int
    rung: str


@dataclass(frozen=True, eq=False)
class _Run:
    """One scene, cut at its events: `knots` (M,) s, those that are samples, the amplitude `asked` there."""

    loop: Any
    scene: Scene
    asked: np.ndarray
    time: np.ndarray
    knots: np.ndarray
    sample: np.ndarray  # index of the knot of each sample
    # samples run, readings taken, commands in force, counted up to each knot
    marks: list[np.ndarray]
    early: int  # readings from before the scene began
    depths: tuple[int, int]  # readings and commands that are on their way at most
    lag: tuple[int, float]  # whole samples, and the rest of one, by which the demodulator is late
    seed: int = 0

    @classmethod
    def of(cls, loop: Any, scene: Scene, reference: Any) -> "_Run":
        """A loop in a scene, asked for `reference`."""
        Ts = loop.sample_time
        late = delay.time if (delay := scene.find(Delay)) else 0.0
        time = np.arange(int(scene.duration / Ts * (1 + 1e-12)) + 1) * Ts
        if reference is None:
            asked = loop.G * inputs_at(scene, time)["drive"]
        else:
            if not isinstance(reference, Profile):
                reference = Profile.constant(number("reference", reference, PROFILE))
            asked = reference.at(time)
        end = time[-1] if len(time) else 0.0
        events = [time, time - late, time + loop.latency]
        moving = scene.inputs.keys() & {"temperature", "force", "contact"}
        at = np.concatenate([*events, *(scene.inputs[name].edges(0.0, end) for name in moving)]) / Ts
        whole = np.round(at)
        # a shared instant is one, whatever rounding made of it
        at = np.where(np.abs(at - whole) < NEAR, whole, at)
        knots = divided(np.unique(at[(at >= 0) & (at <= end / Ts * (1 + 1e-15))]), scene.substeps)
        instants = np.split(at[: 3 * len(time)], 3)
        marks = [np.searchsorted(i, knots, side="right") for i in instants]
        ran, read, acted = marks
        demodulator = getattr(loop, "demodulator", None)
        back, between = divmod(0.0 if demodulator is None else demodulator.delay / Ts, 1.0)
        depths = int(np.max(read - ran)) + int(back) + 2, int(np.max(ran - acted)) + 1
        sample, early = np.searchsorted(knots, instants[0]), int(np.searchsorted(instants[1], 0.0))
        lag = int(back), between
        return cls(loop, scene, asked, time, knots * Ts, sample, marks, early, depths, lag)

    def schedule(self, count: int) -> Schedule:
        """The pieces, filled up to `count` with some in which nothing happens."""
        scene, (ran, read, acted) = self.scene, self.marks
        duration = np.diff(self.knots, append=self.knots[-1])
        inputs = held(scene, inputs_at(scene, self.knots + 0.5 * duration, commanded=True), 0)
        given, latest = inputs_at(scene, self.time), np.maximum(ran - 1, 0)
        pieces = Schedule(
            duration=duration,
            reads=np.diff(read, prepend=self.early) > 0,
            runs=np.diff(ran, prepend=0) > 0,
            latest=latest,
            reading=read - ran + self.lag[0],
            acting=ran - acted,
            inputs=inputs._replace(drive=None, omega=None, offset=None),
            reference=self.asked[latest],
            frequency=given["frequency"][latest],
            temperature=None if given["temperature"] is None else given["temperature"][latest],
        )
        fill = count - len(duration)
        quiet = pieces._replace(duration=0 * duration, reads=pieces.reads & False, runs=pieces.runs & False)
        return jax.tree.map(lambda v, w: np.append(v, np.repeat(w[-1:], fill)), pieces, quiet)

    def trace(self, rows: tuple) -> Trace:
        """What the program gave, piece by piece, at the scene's own times."""
        motion, measured, voltage, frequency = (v[self.sample] for v in rows)
        # of a law alone nobody says
        units = (getattr(self.loop, name, None) for name in ("response_unit", "drive_unit"))
        return Trace(self.time, motion.real, motion.imag, voltage, frequency, self.asked, measured, *units)


def _playable(scene: Scene) -> Scene:
    why = None
    if scene.kind == "steady" or scene.fidelity == "steady":
        why = "a scene of settled points, expected kind = 'transient': a loop takes time"
    elif scene.fidelity == "carrier":
        known = ", ".join(engine.RUNGS[1:])
        why = f"fidelity 'carrier', expected one of {known}, or auto, which is exact here"
    elif scene.find(Inverter):
        why = "effects.inverter, expected a drive in the controller's own unit"
    if why:
        raise SceneError(f"{scene.name}: found {why}")
    # What is cheap enough for the scene's own drive says nothing of what a controller does.
    return replace(scene, fidelity="exact") if scene.fidelity == "auto" else scene


def _rounded(count: int) -> int:
    """The next of few lengths, so that scenes of about the same length share a compiled program."""
    step = max(1 << (count - 1).bit_length() - 3, 512)
    return -(-count // step) * step


class _Carry(NamedTuple):
    plate: engine.State
    control: Any
    commands: tuple  # (depth,) voltages and frequencies, the latest first
    readings: Any  # (depth,) the latest first
    before: Inputs  # what has held until now
    cycles: Any  # of the drive since its phase was last reset


@partial(jitted, static="shape")
def _play(numbers: tuple, schedule: Schedule, seeds: Any, shape: _Shape) -> Any:
    """(M, runs) of motion, measurement and command at the beginning of each piece."""
    control, plant, effects, reference, sample_time, between = numbers
    first = jax.tree.map(lambda v: v[0], schedule)
    carry = jax.vmap(partial(_begin, shape=shape))(control, plant, effects, reference, first)
    noise = jax.vmap(partial(_noise_of, samples=shape.samples))(effects, seeds, sample_time)
    noise = jax.tree.map(lambda v: jnp.take_along_axis(v.T, schedule.latest, 0), noise)

    def body(carry, now):
        """One piece, of all runs side by side."""
        piece = jax.vmap(partial(_piece, rung=shape.rung))
        return piece(carry, now, control, plant, effects, reference, between)

    return jax.lax.scan(body, carry, (schedule, noise))[1]


def _begin(
    control: Any, plant: Any, effects: tuple, reference: Any, first: Schedule, shape: _Shape
) -> _Carry:
    state = jax.tree.map(lambda v: jnp.asarray(v, float), control.init())
    start = control.rest().frequency
    frequency = _made(effects, first.frequency if start is None else jnp.asarray(start, float))
    inputs = _inputs(effects, reference, Command(jnp.zeros(()), frequency), first)
    quiet = tuple(e for e in effects if e.kind != "noise")
    plate = engine.start(plant, quiet, jax.random.key(0))
    readings = jnp.full(shape.readings, engine.seen(effects, plate, inputs))
    commands = (jnp.zeros(shape.commands), jnp.full(shape.commands, frequency))
    return _Carry(plate, state, commands, readings, inputs, jnp.zeros(()))


def _piece(
    carry: _Carry, happening: tuple, control: Any, plant: Any, effects: tuple, reference: Any, between: Any,
    *, rung: str,
) -> tuple:  # fmt: skip
    """What happens at the beginning of one piece, in this order: the sensor is read, the controller runs, a
    command takes effect; then the piece."""
    now, noise = happening
    readings = _pushed(now.reads, carry.readings, engine.seen(effects, carry.plate, carry.before))
    told, before = readings[now.reading], readings[now.reading + 1]
    measured = _recorded(effects, told + between * (before - told), noise)
    state, command, _ = control.step(carry.control, now.reference, measured, now.temperature, jnp)
    frequency = now.frequency if command.frequency is None else command.frequency
    state = jax.tree.map(lambda new, old: jnp.where(now.runs, new, old), state, carry.control)
    asked = (command.voltage, _made(effects, frequency))
    commands = tuple(_pushed(now.runs, old, new) for old, new in zip(carry.commands, asked, strict=True))
    inputs = _inputs(effects, reference, Command(*(c[now.acting] for c in commands)), now)
    turn, cycles = _turn(effects, carry, inputs, now.duration)
    motion = sum(mode.response for mode in carry.plate.modes)
    plate = engine.held(plant, effects, carry.plate, inputs, now.duration, turn, rung, reference)
    after = _Carry(plate, state, commands, readings, inputs, cycles)
    return after, (motion, measured, commands[0][0], commands[1][0])


def _pushed(happens: Any, line: Any, value: Any) -> Any:
    """`value` at the head of a line of the latest values, where it happens."""
    return jnp.where(happens, jnp.concatenate([jnp.reshape(value, 1), line[:-1]]), line)


def _inputs(effects: tuple, reference: Any, command: Command, now: Schedule) -> Inputs:
    omega, offset = 2 * jnp.pi * command.frequency, 2 * jnp.pi * (reference - command.frequency)
    inputs = now.inputs._replace(drive=command.voltage, omega=omega, offset=offset)
    for e in effects:
        if hasattr(e, "drive"):
            inputs = e.drive(inputs)
    return inputs


def _made(effects: tuple, frequency: Any) -> Any:
    """The frequency that the source makes."""
    steps = next((e.step for e in effects if isinstance(e, FrequencyResolution)), None)
    return frequency if steps is None else steps * jnp.round(frequency / steps)


def _turn(effects: tuple, carry: _Carry, inputs: Inputs, duration: Any) -> tuple[Any, Any]:
    """The turn of the frame where a source starts at phase zero with another frequency; its cycles since."""
    if not any(isinstance(e, PhaseReset) for e in effects):
        return None, carry.cycles
    changed = inputs.omega != carry.before.omega
    turn = jnp.where(changed, jnp.exp(2j * jnp.pi * carry.cycles), 1.0)
    since = jnp.where(changed, 0.0, carry.cycles) + inputs.omega / (2 * jnp.pi) * duration
    return turn, since - jnp.floor(since)


def _noise_of(effects: tuple, seed: Any, sample_time: Any, samples: int) -> tuple[Any, Any] | None:
    """What noise adds to each reading, and the share that it leaves of it: those effects are linear in it."""
    drawn = tuple(e for e in effects if e.kind == "noise" and not isinstance(e, RECORDER))
    if not drawn:
        return None
    key = jax.random.key(seed)
    states = tuple(e.init(engine.key_for(key, e, 0)) if hasattr(e, "init") else None for e in drawn)

    def made(value: float) -> Any:
        """(samples,) readings of a response that stays at `value`."""
        return engine.noisy(drawn, jnp.full(samples, value, complex), states, key, 0, sample_time)[0]

    offset = made(0.0)
    return offset, jnp.round((made(1.0) - offset).real)


def _recorded(effects: tuple, response: Any, noise: Any) -> Any:
    """The reading of a response, in the noise that `_noise_of` made of it."""
    response = response if noise is None else noise[0] + noise[1] * response
    for e in effects:
        if isinstance(e, RECORDER):
            response = e.noise(response, None, None, None)[0]
    return response
