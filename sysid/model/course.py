"""What the plant does in a log, as far as its parameters decide, and how that changes with them: by a program
of JAX, made for a layout of logs; or with numpy, by differences, where a layout is looked at but a few
times."""

from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sysid.model.experiment import Experiment, Layout, each, stacks
from sysid.model.plant import Response, respond, steady
from sysid.model.theta import PLANT, Theta
from sysid.precision import seldom
from sysid.rows.hold import Hold, Leaf

# of a step: a difference is right to it, and to the rounding of numbers over it
DIFFERENCE = 1e-7


class Course(NamedTuple):
    """(..., N) the response to the drive, with G unless the log has a gain of its own; unless its points are
    settled, the change with the start and with lateness, each of a unit of its prior; and where the log has a
    resonance of its own, (...,) by how many degC the plate is warmer than its thermometer says, and how many
    times `Experiment.tied`'s k_T is."""

    forced: Leaf
    start: Leaf | None
    late: Leaf | None
    warmer: Leaf | None
    steeper: Leaf | None


def module(array: Leaf) -> ModuleType:
    """numpy or jax.numpy, whichever the array is of."""
    return np if isinstance(array, (np.ndarray, np.generic)) else jnp


def of_plants(thetas: np.ndarray, x: Experiment, layout: Layout) -> Course:
    """Of one log, beside each plant `thetas` (P, 6)."""
    held = {k: v[:, None] if np.ndim(v) and k != "interval" else v for k, v in x.hold._asdict().items()}
    across = x._replace(hold=x.hold._replace(**held), alongside=x.alongside[:, None])
    return jax.tree.map(np.transpose, _course(thetas, across, layout))


def by_differences(
    theta: np.ndarray, directions: np.ndarray, x: Experiment, layout: Layout
) -> tuple[Course, Course]:
    """Of each log of a group (logs, ...), and its derivatives along the directions (6, d) of theta, (logs, d,
    ...)."""
    plants = np.concatenate([theta[None], theta + DIFFERENCE * directions.T])
    seen = jax.tree.map(lambda *logs: np.stack(logs), *(of_plants(plants, log, layout) for log in each(x)))
    change = jax.tree.map(lambda v: (v[:, 1:] - v[:, :1]) / DIFFERENCE, seen)
    return jax.tree.map(lambda v: v[:, 0], seen), change


def by_program(
    theta: np.ndarray, directions: np.ndarray, x: Experiment, layout: Layout
) -> tuple[Course, Course]:
    """The same along directions that are each of one number."""
    sizes, free = _along(directions)
    parts = [_compiled(theta, sizes, layout.driven, _needed(stack)) for stack in stacks(x)]
    now, change = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    return now, jax.tree.map(lambda v: v[:, free], change)


def prepare(theta: np.ndarray, directions: np.ndarray, x: Experiment, layout: Layout) -> None:
    """Begin to make these programs, where that goes on beside."""
    for stack in stacks(x):
        _compiled.prepare(theta, _along(directions)[0], layout.driven, _needed(stack))


def _along(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of steps in the first numbers of theta, as many as may be free: a plate's, and a finger's; and
    which the directions (6, d), each of one number, go along."""
    free = np.argmax(directions != 0, axis=0)
    sizes = np.ones(len(directions) if np.any(free >= len(PLANT)) else len(PLANT))
    sizes[free] = directions[free, np.arange(len(free))]
    return sizes, free


@seldom
def _compiled(theta, sizes, layout, x):
    """Of each log of a stack, along steps of these sizes (p,) in the first p numbers of theta: a program for
    all parameters serves whichever are free."""
    steps = jnp.eye(len(sizes), len(theta)) * sizes[:, None]

    def of_log(x):
        found, change = jax.linearize(lambda t: _course(t, x, layout), theta)
        return found, jax.vmap(change)(steps)

    return jax.vmap(of_log)(x)


def _needed(x: Experiment) -> Experiment:
    """What the course of the plant goes with."""
    needed = ("hold", "alongside", "lateness", "start_free", "floor", "tied")
    return Experiment(**{name: getattr(x, name) if name in needed else None for name in Experiment._fields})


def _course(theta: Leaf, x: Experiment, layout: Layout) -> Course:
    """Of one log at theta (6,); with numpy of several plants (P, 6), with what `x` has of intervals and rows
    (M, 1) and (N, 1), but for `hold.interval`, each (N, P)."""
    xp, warmer, steeper = module(theta), None, None
    if layout.extra:
        at = Theta.of(theta)
        warmer = (x.tied[0] - at.f0 - at.k_T * x.tied[1]) / xp.where(at.k_T == 0, 1.0, at.k_T)
        steeper = xp.where(x.tied[3] == 0, 1.0, at.k_T / xp.where(x.tied[3] == 0, 1.0, x.tied[3]))
        tied = xp.where(x.tied[2] > 0, x.tied[0] - at.k_T * x.tied[1], at.f0)
        theta = xp.stack(at._replace(f0=tied), axis=-1)
    unit = _unit(theta, x.hold, layout)
    gain = 1.0 if layout.own_gain else xp.exp(Theta.of(theta).log_G)
    forced = gain * unit.forced + x.alongside
    if layout.own_gain and layout.amplitude:  # the size is all there is, beside a floor whose power adds
        forced = xp.sqrt(xp.abs(forced) ** 2 + x.floor)
    if layout.steady:
        return Course(forced, None, None, warmer, steeper)
    size = xp.where(x.hold.begun[0] > 0, gain, 1.0) if layout.amplitude else 1.0
    return Course(forced, x.start_free * size * unit.free, -gain * x.lateness * unit.rate, warmer, steeper)


def _unit(theta: Leaf, hold: Hold, layout: Layout) -> Response:
    """The plant's response per unit G, its rate of change, and its free decay from a unit start; (N,) complex
    arrays. A finger, or what else damps, divides tau and G by one factor, and with G the drive."""
    xp = module(theta)
    at = Theta.of(theta) if layout.touched else Theta.of(theta[..., : len(PLANT)])
    tau, detuning = xp.exp(at.log_tau), at.detuning(hold)
    if layout.touched:
        damped = at.damped(hold)
        tau, hold = tau / damped, hold._replace(drive=hold.drive / damped)
    if layout.steady:
        forced = hold.drive * steady(tau, detuning, hold.omega, xp)
        return Response(forced, xp.zeros_like(forced), xp.zeros_like(forced))
    return respond(
        tau, detuning, hold, layout.both_modes, layout.carrier, layout.amplitude, layout.order, xp=xp
    )
