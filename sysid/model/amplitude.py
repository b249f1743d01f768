"""The nuisances of an amplitude log: at their optimum near the values that they have, as the mean of Rice's
distribution (`model.rice`) is linear in them only nearby."""

import jax
import jax.numpy as jnp

from sysid.model import rice
from sysid.model.experiment import Experiment, Layout, Residual, modelled, off, priors, whiten
from sysid.model.plant import Response
from sysid.model.span import Span, module
from sysid.rows.hold import Leaf

MOST = 30  # steps to the nuisances of an amplitude log
LEAST = 0.1  # of its floor that the steps of one look leave
GAIN = 1e-8  # of a sum of squares, less than which a step is not worth taking
DAMPED = (1e-9, 1e-3, 1e9)  # of the information of each number: least, at first, and where a step is given up


def amplitude(shapes: Response, x: Experiment, layout: Layout):
    """The residual of an amplitude log, the nuisances of a transient at their optimum near their present
    values; these; and the projection of a vector off all that they can adjust."""
    xp = module(shapes.forced)
    now: tuple[Leaf, ...] = (xp.ones(()), x.start, x.late, x.floor, x.offset)
    if layout.steady:
        size = modelled(shapes, now, layout)
        rows = x.response - off(whiten(size, x), x)
        kept = (x.start, x.floor, x.late, x.offset, now[0])
        return Residual(rows, size, *kept, xp.zeros(()), xp.zeros(0)), now, lambda v: off(v, x)
    now = _settled(now, shapes, x, layout)
    size, rows, columns = _linear(now, shapes, x, layout)
    span, found = _about(rows, columns, now, x, layout)
    floor = xp.where(x.floor_free > 0, found[-1] / x.tightness, x.floor)
    kept = (now[1], floor, now[2], now[4], now[0])
    return Residual(rows, size, *kept, span.volume, xp.zeros(0)), now, span.off


def _settled(now: tuple[Leaf, ...], shapes: Response, x: Experiment, layout: Layout) -> tuple[Leaf, ...]:
    """Nuisances of an amplitude log at their optimum near `now`, by Marquardt's steps: the mean of Rice's
    distribution is linear in them only nearby. Their damping follows from what a step gained of what it would
    have in a linear problem (Nielsen, IMM-REP-1999-05, Technical University of Denmark, 1999)."""
    xp = module(shapes.forced)
    start, offset, late = x.start_free > 0, x.offset_free > 0, [xp.asarray(True)] * layout.late
    free = xp.stack([start, start, *late, offset, offset, x.floor_free > 0])
    least = xp.where(_last(free), LEAST * x.tightness * now[3], -xp.inf)  # of each of their values

    def seen(now: tuple[Leaf, ...]) -> tuple[Leaf, Leaf, Leaf]:
        _, left, columns = _linear(now, shapes, x, layout)
        along = columns @ x.basis.T
        return xp.sum(left**2), columns @ left, columns @ columns.T - along @ along.T

    def going(state: tuple) -> Leaf:
        rounds, damping, _, gained, _, (cost, *_) = state
        return (rounds < MOST) & (gained > GAIN * cost) & (damping < DAMPED[2])

    def step(state: tuple) -> tuple:
        rounds, damping, growth, _, values, (cost, slope, gram) = state
        able = free & ((slope > 0) | (values > least))
        gram_of = xp.where(able & able[:, None], gram, 0.0)
        whole = xp.linalg.solve(gram_of + xp.diag(damping * xp.diag(gram)), xp.where(able, slope, 0.0))
        new = xp.maximum(values + whole, least)
        whole = new - values
        there = seen(_unpacked(new, now, x, layout))
        better, foreseen = there[0] < cost, whole @ (2 * slope - gram_of @ whole)
        less = 1 - (2 * (cost - there[0]) / xp.maximum(foreseen, 1e-300) - 1) ** 3
        damping = damping * xp.where(better, xp.maximum(0.1, less), growth)
        growth = xp.where(better, 2.0, 2 * growth)
        kept = jax.tree.map(lambda a, b: xp.where(better, a, b), (new, there), (values, (cost, slope, gram)))
        gained = xp.where(better, cost - there[0], xp.abs(foreseen))
        return rounds + 1, xp.maximum(damping, DAMPED[0]), growth, gained, *kept

    begun = (0, *map(xp.asarray, (DAMPED[1], 2.0, xp.inf)))
    state = (*begun, _packed(now, x, layout), seen(now))
    if xp is jnp:
        return _unpacked(jax.lax.while_loop(going, step, state)[4], now, x, layout)
    while going(state):
        state = step(state)
    return _unpacked(state[4], now, x, layout)


def _last(values: Leaf) -> Leaf:
    """Which of these is the last, the floor's."""
    return module(values).arange(len(values)) == len(values) - 1


def _packed(now: tuple[Leaf, ...], x: Experiment, layout: Layout) -> Leaf:
    """The nuisances of a transient's amplitude in units of their priors over their tightness."""
    _, start, late, floor, offset = now
    xp = module(floor)
    offset = offset / xp.where(x.offset_free > 0, x.offset_free, 1.0)
    values = [start.real, start.imag, *[late] * layout.late, offset.real, offset.imag, x.tightness * floor]
    return xp.stack(values)


def _unpacked(values: Leaf, now: tuple[Leaf, ...], x: Experiment, layout: Layout) -> tuple[Leaf, ...]:
    """The nuisances by their `_packed` values, but for those that are held."""
    xp = module(values)
    start = xp.where(x.start_free > 0, values[0] + 1j * values[1], now[1])
    late = values[2] if layout.late else now[2]
    offset = xp.where(x.offset_free > 0, x.offset_free * (values[-3] + 1j * values[-2]), now[4])
    floor = xp.where(x.floor_free > 0, values[-1] / x.tightness, now[3])
    return now[0], start, late, floor, offset


def _loose(values: Leaf, x: Experiment) -> Leaf:
    """The nuisances by their `_packed` values as their prior holds them: not a floor that is not free."""
    return module(values).where(_last(values), x.floor_free * values, values)


def _linear(
    now: tuple[Leaf, ...], shapes: Response, x: Experiment, layout: Layout
) -> tuple[Leaf, Leaf, Leaf]:
    """A transient's mean amplitude (N,); its whitened residual (N,), with a row for the prior of each of the
    `_packed` nuisances; and what a little more of each adds (K, N), whitened, of the floor as if it were
    free."""
    plate = modelled(shapes, now[:3], layout) + now[4]
    size, towards, by_floor = rice.linear(plate, now[3])
    along, held, xp = towards * shapes.free, towards * x.offset_free, module(plate)
    late = [(towards * shapes.rate).real] if layout.late else []
    own = xp.stack([along.real, -along.imag, *late, held.real, -held.imag, by_floor / x.tightness])
    own_rows = x.tightness * priors(len(own), layout, xp)
    left = off(x.response - whiten(size, x), x) - _loose(_packed(now, x, layout), x) @ own_rows
    return size, left, whiten(own, x) + own_rows


def _about(
    left: Leaf, columns: Leaf, now: tuple[Leaf, ...], x: Experiment, layout: Layout
) -> tuple[Span, Leaf]:
    """What the nuisances of a transient's amplitude can make, `_linear` about their values `now`; and what
    they are at best."""
    columns = off(off(columns, x), x)  # twice is enough
    span = Span(list(columns))
    # A floor that would be below zero is held there: it has its share of the volume, and makes nothing.
    unit, made_of = span.units[-1]
    span.units[-1] = x.floor_free * unit, made_of
    free = _loose(_packed(now, x, layout), x)
    return span, span.weights(left + free @ columns)
