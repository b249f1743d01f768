"""The simulation: a plant and its effects under held inputs, chunk by chunk, in one compiled program per
scene.

Between two changes of the inputs the equation of motion is linear with constant coefficients and is solved
exactly by its two modes (see `model.plant`). The state carried from one interval to the next is (Z, U): the
response in the frame of the drive, and its velocity in the frame of the plate, U = p1 Z1 + p2 Z2 with p = s +
j omega. Both are continuous whatever changes: drive, frequency, damping or resonance. The intervals of a
chunk are taken in lanes side by side. Only effects that depend on the response itself (softening,
self-heating) need one interval after the other; they are frozen at the middle of each interval, with an error
of second order.
"""

import math
from functools import partial
from typing import Any, NamedTuple
from zlib import crc32

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sysid.model.plant import Plant, expm1, phis, poles, steady
from sysid.precision import jitted
from sysid.rows.hold import Leaf
from sysid.scene.effects import Inputs, LockIn, Motion, SecondMode, TwoCeramics
from sysid.scene.lanes import Interval, Mode, gathered, gathered_modes, split

RUNGS = ("steady", "amplitude", "envelope", "exact")  # from cheap to true


class Felt(NamedTuple):
    """What an effect that depends on the response receives: the squared amplitude, and the temperature that
    it has caused."""

    power: Array
    heat: Array


class State(NamedTuple):
    """The state passed from chunk to chunk: each resonance, self-heating, the filter's stages, the noise."""

    modes: tuple[Mode, ...]
    heat: Array | None
    filter: tuple[Array, ...]
    noise: tuple[Any, ...]


class Chunk(NamedTuple):
    """Held inputs over intervals of `duration` s, the interval at whose beginning each row (R,) is read, the
    rows' own inputs (None: nothing asks for them), the turn of the frame at the beginning of an interval
    (None: the phase goes on), and the carrier's phase theta at each row (None: rows are those of the frame,
    not samples of a carrier).

    Intervals are (steps, lanes), each lane a stretch of time: lanes run side by side, and nothing is
    transposed.
    """

    duration: Leaf
    inputs: Inputs
    take: Leaf
    rows: Inputs | None
    turn: Leaf
    theta: Leaf = None


def folded(chunk: Chunk) -> Chunk:
    """A chunk of intervals (M,) in order of time with its lanes laid side by side; numpy."""
    steps = len(chunk.duration) // _lanes_of(len(chunk.duration))
    lanes = len(chunk.duration) // steps
    duration, inputs, turn = jax.tree.map(
        lambda v: np.ascontiguousarray(_fold(v)), (chunk.duration, chunk.inputs, chunk.turn)
    )
    lane = chunk.take // steps
    take = (chunk.take - lane * steps) * lanes + lane
    return chunk._replace(duration=duration, inputs=inputs, take=take, turn=turn)


def _lanes_of(count: int) -> int:
    return math.gcd(count, 1 << (math.isqrt(count).bit_length() - 1))


def _fold(v: Leaf) -> Leaf:
    return v.reshape(_lanes_of(len(v)), -1).T


def resonances(plant: Plant, effects: tuple) -> tuple[Plant, ...]:
    """The plate's own resonance, and further ones."""
    more = [e for e in effects if isinstance(e, SecondMode)]
    temperature = plant.reference_temperature
    return (plant, *(Plant(e.G, e.tau, e.f0, e.k_T, reference_temperature=temperature) for e in more))


def motion(plant: Plant, inputs: Inputs, effects: tuple, reference: Leaf, felt: Felt | None = None) -> Motion:
    """Time constant, detuning and drive of each interval; `reference` (Hz) is where the inputs' offsets are
    taken from."""
    detuning = 2 * jnp.pi * (plant.f0 - reference) + inputs.offset
    if inputs.warming is not None and plant.k_T is not None:
        detuning = detuning + 2 * jnp.pi * plant.k_T * inputs.warming
    found = Motion(plant.tau, detuning, inputs.drive)
    for e in effects:
        if hasattr(e, "plate"):
            found = e.plate(found, inputs, plant, felt)
    return found


class Step(NamedTuple):
    """One interval's poles in the frame of the drive, those of the plate, and the response that each mode
    settles at, negated."""

    poles: tuple[Array, ...]
    still: tuple[Array, ...]
    targets: tuple[Array, ...]


def step(gain: Leaf, m: Motion, inputs: Inputs, rung: str) -> Step:
    """Slow mode alone (`amplitude`: at resonance; `envelope`: detuning omega0 - omega, b = G/tau), or both
    (`exact`)."""
    if rung == "exact":
        s = poles(m.tau, m.detuning, inputs.omega)
        push = gain * s.gain * m.drive
        turning = 1j * inputs.omega
        return Step(
            (s.slow, s.fast),
            (s.slow + turning, s.fast + turning),
            (_over(push, s.slow), _over(-push, s.fast)),
        )
    detuning = jnp.zeros_like(m.detuning) if rung == "amplitude" else m.detuning
    slow = -1 / m.tau + 1j * detuning
    return Step((slow,), (), (_over(gain / m.tau * m.drive, slow),))


def _over(real: Array, z: Array) -> Array:
    return (real / (z.real**2 + z.imag**2)) * z.conj()


def start(plant: Plant, effects: tuple, key: Array) -> State:
    """At rest, with nothing heated and empty filters."""
    zero = jnp.zeros((), complex)
    modes = tuple(Mode(zero, zero) for _ in resonances(plant, effects))
    filters = tuple(zero for e in effects if isinstance(e, LockIn) for _ in range(e.order))
    drawn = tuple(
        e.init(key_for(key, e, 0)) if hasattr(e, "init") else None for e in effects if e.kind == "noise"
    )
    heated = any(hasattr(e, "warmed") for e in effects)
    return State(modes, jnp.zeros(()) if heated else None, filters, drawn)


@partial(jitted, static="rung")
def advance(
    plant: Plant,
    effects: tuple,
    state: State,
    chunk: Chunk,
    key: Array,
    count: Array,
    spacing: Array,
    rung: str,
    reference: Leaf,
) -> tuple[Array, State]:
    """Rows (R,) of one chunk, and the state after it. `count` numbers the chunk, `spacing` is the time
    between rows."""
    response, state = _plate(plant, effects, state, chunk, rung, reference)
    response = _sensed(effects[len(_before_filter(effects)) :], response, chunk.rows)
    response, drawn = noisy(effects, response, state.noise, key, count, spacing)
    return response, state._replace(noise=drawn)


def noisy(
    effects: tuple, response: Array, states: tuple, key: Array, count: Leaf, spacing: Leaf
) -> tuple[Array, tuple]:
    """Rows of chunk `count` with noise and the recorder's effects added; and the state of the noise
    afterwards."""
    drawn = []
    for e, before in zip((e for e in effects if e.kind == "noise"), states, strict=True):
        response, after = e.noise(response, key_for(key, e, count + 1), spacing, before)
        drawn.append(after)
    return response, tuple(drawn)


def _plate(
    plant: Plant, effects: tuple, state: State, chunk: Chunk, rung: str, reference: Leaf
) -> tuple[Array, State]:
    """The response at each row behind the lock-in's filter, before the sensor effects that follow it."""
    if rung == "steady":
        settled = [_settled(p, chunk, effects, reference) for p in resonances(plant, effects)]
        return _together(settled, effects), state
    found, modes, heat, warmth = [], [], state.heat, None
    for p, mode in zip(resonances(plant, effects), state.modes, strict=True):
        if any(getattr(e, "feels", False) for e in effects):
            before, steps, last, warmth, heat = _one_by_one(
                p, effects, mode, heat, warmth, chunk, rung, reference
            )
        else:
            steps = step(p.G, motion(p, chunk.inputs, effects, reference), chunk.inputs, rung)
            before, last = _lanes(steps, mode, chunk)
        found.append((before, steps))
        modes.append(last)
    state = state._replace(modes=tuple(modes), heat=heat)
    lock_in = next((e for e in effects if isinstance(e, LockIn)), None)
    if lock_in is not None:
        filtered, stages = _filtered(lock_in, found, effects, state.filter, chunk)
        return filtered.ravel()[chunk.take], state._replace(filter=stages)
    response = _together([_read(before, steps, chunk) for before, steps in found], effects)
    # A row is read just before its inputs act, so before the frame turns.
    return response if chunk.turn is None else response * chunk.turn.ravel()[chunk.take].conj(), state


def _read(before: tuple[Array, ...], steps: Step, chunk: Chunk) -> Array:
    """Response at each row of one resonance, from that of its modes at the beginning of each interval.

    In samples of a carrier the free part U of the fast mode, Re[U e^{j theta}], has a positive frequency as
    conj(U) e^{-2j theta}: what a sensor's phase shift turns.
    """
    if chunk.theta is None:
        total: Any = sum(before)
        return total.ravel()[chunk.take]
    (slow, fast), settled = before, -steps.targets[1]
    turns = (slow + settled).ravel()[chunk.take]
    return turns + (fast - settled).ravel()[chunk.take].conj() * jnp.exp(-2j * chunk.theta)


def seen(effects: tuple, state: State, inputs: Inputs) -> Array:
    """What the sensor shows in a state, before noise; `inputs` are those held until now."""
    response = (
        state.filter[-1] if state.filter else _together([mode.response for mode in state.modes], effects)
    )
    return _sensed(effects[len(_before_filter(effects)) :], response, inputs)


def held(
    plant: Plant,
    effects: tuple,
    state: State,
    inputs: Inputs,
    duration: Leaf,
    turn: Any,
    rung: str,
    reference: Leaf,
):
    """The state after `inputs`, scalars, have been held for `duration` s: one interval of a chunk."""
    duration, inputs, turn = jax.tree.map(lambda v: jnp.reshape(v, (1, 1)), (duration, inputs, turn))
    rows = jax.tree.map(jnp.ravel, inputs)
    return _plate(
        plant, effects, state, Chunk(duration, inputs, jnp.zeros(1, int), rows, turn), rung, reference
    )[1]


def _before_filter(effects: tuple) -> tuple:
    """The effects in front of the lock-in's filter; none where there is no filter."""
    return effects[: next((i for i, e in enumerate(effects) if isinstance(e, LockIn)), 0)]


def _sensed(effects: tuple, response: Array, inputs: Inputs) -> Array:
    for e in effects:
        if hasattr(e, "sense"):
            response = e.sense(response, inputs)
    return response


def _settled(plant: Plant, chunk: Chunk, effects: tuple, reference: Leaf) -> Array:
    m = motion(plant, chunk.rows, effects, reference)
    return plant.G * m.drive * steady(m.tau, m.detuning, chunk.rows.omega)


def _together(responses: list[Array], effects: tuple) -> Array:
    """What the sensor sees of the resonances: their sum, or less of those that two ceramics cancel."""
    first, *rest = responses
    for response, share in zip(rest, _shares(effects), strict=True):
        first = first + share * response
    return first


def _shares(effects: tuple) -> list[Any]:
    """Share of each further resonance that the sensor sees."""
    odd = next((e.mismatch / 2 for e in effects if isinstance(e, TwoCeramics)), 1.0)
    return [e.seen * (odd if e.parity == "odd" else 1.0) for e in effects if isinstance(e, SecondMode)]


def _lanes(steps: Step, mode: Mode, chunk: Chunk) -> tuple[tuple[Array, ...], Mode]:
    """Each mode's response at the beginning of every interval, and the state after the last."""
    growths = tuple(expm1(p * chunk.duration) for p in steps.poles)
    if len(steps.poles) == 1:
        if chunk.turn is not None:
            raise ValueError("a phase that is reset needs the exact envelope")
        alone, end = gathered(growths[0], steps.targets[0], mode.response)
        return (alone,), Mode(end, mode.velocity)
    return gathered_modes(Interval(growths, steps.targets, steps.still, chunk.turn), mode)


def _one_by_one(
    plant: Plant,
    effects: tuple,
    mode: Mode,
    heat: Array | None,
    warmth: Any,
    chunk: Chunk,
    rung: str,
    reference: Leaf,
) -> tuple:
    """As `_lanes`, where the response itself decides its time constant or its resonance: one interval after
    the other.

    The first resonance makes the heat; `warmth`, what it has made by the beginning and by the middle of each
    interval, is what a further one feels.
    """
    heating = next((e for e in effects if hasattr(e, "warmed")), None)

    def over(mode: Mode, felt: Felt, inputs: Inputs, duration: Array) -> tuple[Step, Mode]:
        steps = step(plant.G, motion(plant, inputs, effects, reference, felt), inputs, rung)
        parts = (mode.response,) if rung != "exact" else split(mode.response, mode.velocity, steps.still)
        after = [
            z + expm1(p * duration) * (z + t)
            for z, p, t in zip(parts, steps.poles, steps.targets, strict=True)
        ]
        if rung != "exact":
            return steps, Mode(after[0], mode.velocity)
        return steps, Mode(after[0] + after[1], steps.still[0] * after[0] + steps.still[1] * after[1])

    def advance(carry, now):
        mode, heat = carry
        inputs, duration, turn, warmth = now
        if turn is not None:
            mode = Mode(mode.response * turn, mode.velocity * turn)
        felt = Felt(jnp.abs(mode.response) ** 2, heat if warmth is None else warmth[0])
        _, half = over(mode, felt, inputs, 0.5 * duration)
        middle = Felt(jnp.abs(half.response) ** 2, heat if warmth is None else warmth[1])
        if heating is not None and warmth is None:
            middle = middle._replace(heat=heating.warmed(heat, felt.power, inputs.omega, 0.5 * duration))
            heat = heating.warmed(heat, middle.power, inputs.omega, duration)
        steps, after = over(mode, middle, inputs, duration)
        parts = (mode.response,) if rung != "exact" else split(mode.response, mode.velocity, steps.still)
        return (after, heat), (parts, steps, (felt.heat, middle.heat))

    now = jax.tree.map(lambda v: v.T.ravel(), (chunk.inputs, chunk.duration, chunk.turn))
    (last, heat), (before, steps, warmth) = jax.lax.scan(advance, (mode, heat), (*now, warmth))
    before, steps = jax.tree.map(_fold, (before, steps))
    return before, steps, last, warmth, heat


def _filtered(
    lock_in: LockIn, found: list, effects: tuple, stages: tuple[Array, ...], chunk: Chunk
) -> tuple[Array, tuple]:
    """The response behind a cascade of one-pole filters, at the beginning of each interval, and the stages
    after the last.

    Over an interval the input is A + sum_i c_i e^{s_i t}. With x = t/tau stage j is then, exactly,

        y_j(t) = e^{-x} (sum_{m<j} y_(j-m)(0) x^m/m! + A x^j phi_j(x) + sum_i c_i x^j phi_j(s_i t + x))
    """
    front = _before_filter(effects)
    x = chunk.duration / lock_in.tau
    decay, lost = jnp.exp(-x), jnp.expm1(-x)
    rest: Any = 0.0
    terms = []
    for weight, (before, steps) in zip((1.0, *_shares(effects)), found, strict=True):
        for z, p, target in zip(before, steps.poles, steps.targets, strict=True):
            rest = rest - weight * target
            swing = _sensed(front, weight * (z + target), chunk.inputs._replace(drive=jnp.zeros_like(x)))
            terms.append((swing, phis(p * chunk.duration, x, lock_in.order)))
    terms.append((_sensed(front, rest, chunk.inputs), phis(jnp.zeros_like(x), x, lock_in.order)))
    passed: list[Array] = []
    after: list[Array] = []
    for j in range(1, lock_in.order + 1):
        known = sum(passed[j - m - 1] * (x**m / math.factorial(m)) for m in range(1, j))
        push = decay * known + x**j * sum(c * phi[j - 1] for c, phi in terms)
        # y+ = push + decay y: as growth (y + target) with growth = decay - 1
        target = jnp.where(lost == 0, 0.0, push) / jnp.where(lost == 0, -1.0, lost)
        stage, last = gathered(lost.astype(complex), target, stages[j - 1])
        passed.append(stage)
        after.append(last)
    return passed[-1], tuple(after)


def key_of(seed: int, scene: str) -> Array:
    """The stream of a scene's noise: two scenes of one seed, which may be fitted together, have no noise in
    common."""
    return _named(jax.random.key(seed), scene)


def key_for(key: Array, e: Any, count: Any) -> Array:
    """A stream of its own for each effect and chunk: adding one effect changes no other's noise."""
    return jax.random.fold_in(_named(key, e.name), count)


def _named(key: Array, name: str) -> Array:
    return jax.random.fold_in(key, crc32(name.encode()) & 0x7FFFFFFF)
