"""What the logs say about a plant: whitened residuals and the log density, with every nuisance of the bench
eliminated.

For given (G, tau, f0, k_T) a d/q log is linear in all that the bench adds to it,

    y = G e^{j phi} h + sum_c nu_c column_c + noise

with h the plant's response per unit G, and for columns an offset, the feedthrough and its slope, the free
decay from the unknown start, and -G dh/dt of a response that is late. Lateness covers, to first order, a
trigger and a demodulator's filter and, as nu is complex, the phase at which the carrier was switched (1/(2Q)
of a step). The nu_c are projected out (variable projection; Golub & Pereyra, SIAM J. Numer. Anal. 10, 413,
1973): the columns that do not depend on the plant once and for all, the others at each plant; phi by its
closed-form optimum, so that a fit and a posterior over any number of logs have four parameters, with a finger
six. Each nu_c has a zero-mean normal prior ten times as wide as the log's response, lateness one of a row, or
of a radian of the carrier where that is longer, which is all that its imaginary part has over a sweep; it
enters as one more row and keeps columns apart that a log cannot separate (where a lone step cannot, the
priors of feedthrough and lateness are narrower: `verdict.gain_confounding`). An amplitude log,

    w^2 = |G h + nu_1 e - nu_3 G h' + nu_4|^2 + nu_2,

lifted as noise does it (`model.rice`), is linear in its nuisances only about their values: steps to these are
taken at each plant. Where it is driven at its first row, h is the response that had settled by then, e the
decay of that one, and nu_1, of prior 1, how much of it there is besides: no phase shows what else it began
with. nu_4, an offset of d and q, is there where the log shows one (`verdict.amplitude_offset`). Of a sweep
nu_2 is the noise's square, given as well as its scatter tells it: how the means rise with it is a column like
an offset.

Where the noise of d and q differs, rows are whitened channel by channel, and what was linear with complex
coefficients is so with real ones, two for each: the same shapes, and j times them. So it is where real and
imaginary part have priors of their own.

The noise level of each log has the scale-free prior 1/sigma and is integrated out: a Student-t form in the
residual sum S, log p = -sum_logs (degrees of freedom / 2) log S. So are the nuisances: with the information B
of their coefficients, log p = - 1/2 log det B, which depends on the plant where their columns do.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from sysid.model import rice
from sysid.model.experiment import Experiment, Layout, Residual, basis
from sysid.model.plant import Response
from sysid.model.span import REAL, Span, best_turn, times, turn_towards
from sysid.model.theta import Theta
from sysid.rows.hold import Leaf

LATE = 1  # of the columns that depend on the plant, which is the lateness
# rows of an experiment, its last, for the priors of what depends on the plant: start, lateness, and each of
# `extra`
OWN = 8


@partial(jax.jit, static_argnames="layout")  # traced once, however many programs call it
def residual(theta: Array, x: Experiment, layout: Layout) -> Residual:
    """Whitened residual of one experiment in units of its noise, all nuisances at their optimum."""
    return _eliminated(theta, x, layout)[0]


def linearised(theta: Array, x: Experiment, layout: Layout) -> tuple[Residual, Callable[[Array], Array]]:
    """`residual`, and the derivative of its rows by theta: that of the model with the nuisances held,
    projected off all that the nuisances can adjust (Kaufman, BIT 15, 49, 1975). The gradient of the sum of
    squares is then exact, and J^T J is the information with the nuisances eliminated."""
    found, nuisances, off = _eliminated(theta, x, layout)
    if not layout.extra:
        _, change = jax.linearize(lambda t: _modelled(_shapes(t, x, layout), nuisances, layout), theta)
        return found, lambda step: -off(_whiten(change(step), x))
    _, change = jax.linearize(
        lambda t: (_modelled(_shapes(t, x, layout), nuisances, layout), _pull(t, x, layout)), theta
    )

    def along(step: Array) -> Array:
        model, pull = change(step)
        return -off(_whiten(model, x) + pull)

    return found, along


def _shapes(theta: Array, x: Experiment, layout: Layout) -> Response:
    """Response to the drive, its rate and the free decay; without G where the log has a gain of its own."""
    if layout.extra:
        at = Theta.of(theta)
        tied = jnp.where(x.tied[2] > 0, x.tied[0] - at.k_T * x.tied[1], at.f0)
        theta = jnp.stack(at._replace(f0=tied))
    forced, rate, free = basis(theta, x.hold, layout)
    gain = 1.0 if layout.own_gain else jnp.exp(Theta.of(theta).log_G)
    forced = gain * forced + x.alongside
    if layout.own_gain and layout.amplitude:  # the size is all there is, beside a floor whose power adds
        forced = jnp.sqrt(jnp.abs(forced) ** 2 + x.floor)
    # Without the barrier the compiler evaluates the plant anew in each of the sums that use it: twice the
    # time.
    unit = jnp.where(x.hold.begun[0] > 0, gain, 1.0) if layout.amplitude else 1.0
    return jax.lax.optimization_barrier(
        Response(forced, -gain * x.lateness * rate, x.start_free * unit * free)
    )


def _modelled(shapes: Response, nuisances: tuple[Array, ...], layout: Layout) -> Array:
    """Rows that the plant drives: turn h + start e + late h' or, for an amplitude, the mean of Rice's
    distribution about its size beside an offset, whose level is the root of the floor."""
    turn, start, late, *amplitude = nuisances
    w = turn * shapes.forced + start * shapes.free
    w = w + late * shapes.rate if layout.late else w
    if not amplitude:
        return w
    floor, offset = amplitude
    return rice.mean(w + offset, floor)


def _eliminated(theta: Array, x: Experiment, layout: Layout):
    """The residual, the nuisances at their optimum, and the projection of a vector off all that the nuisances
    can adjust."""
    shapes = _shapes(theta, x, layout)
    x = x._replace(response=x.response - _pull(theta, x, layout)) if layout.extra else x
    if layout.amplitude and not layout.own_gain:
        return _amplitude(shapes, x, layout)
    return _own_gain(shapes, x, layout) if layout.own_gain else _turned(shapes, x, layout)


def _pull(theta: Array, x: Experiment, layout: Layout) -> Array:
    """(N,) what the prior of the thermometer's error, the last of the extra shapes, holds against a resonance
    of the log's own: by how much warmer the plate is, in standard deviations."""
    at = Theta.of(theta)
    warmer = (x.tied[0] - at.f0 - at.k_T * x.tied[1]) / jnp.where(at.k_T == 0, 1.0, at.k_T)
    row = layout.rows - layout.extra - (0 if layout.steady else 1 + layout.late)
    return jnp.zeros(layout.rows).at[row].set(warmer * x.tied[2])


def _own(shapes: Response, layout: Layout) -> tuple[Array, ...]:
    """The columns of a d/q log that depend on the plant as it is."""
    if layout.steady:
        return ()
    return (shapes.free, shapes.rate) if layout.late else (shapes.free,)


def _extra(x: Experiment, layout: Layout) -> tuple[Array, ...]:
    return tuple(x.extra[k] for k in range(layout.extra))


def _with_extra(driven: Array, weights: Array, x: Experiment, layout: Layout) -> Array:
    """With what the last of the weights make of the log's own shapes."""
    return driven + weights[len(weights) - layout.extra :] @ x.extra if layout.extra else driven


def _numbers(weights: Array, x: Experiment, layout: Layout) -> Array:
    """(E,) of the log's own shapes, which are real in the plate's frame."""
    return (weights[len(weights) - layout.extra :] * x.toward[0].conj()).real


def _filled(weights: Array, layout: Layout) -> tuple[Array, Array]:
    """Start and lateness of the weights that `_own` was given."""
    zero = jnp.zeros((), weights.dtype)
    return (zero if layout.steady else weights[0]), (weights[1] if layout.late else zero)


def _turned(shapes: Response, x: Experiment, layout: Layout):
    """A log whose gain is G, and whose phase is turned by what the demodulator may have done: h and j h are
    two columns, whose coefficients are cos phi and sin phi."""
    span = _span((*_own(shapes, layout), *_extra(x, layout)), x, layout)
    white = _off(_whiten(shapes.forced, x), x)
    white_ahead = _off(_whiten(1j * shapes.forced, x), x) if layout.split else 1j * white
    left, shape = span.off(x.response), span.off(white)
    ahead = span.off(white_ahead) if layout.split else 1j * shape
    turn = jnp.where(
        x.rotated > 0, best_turn(left, shape, ahead) if layout.split else turn_towards(left, shape), 1.0
    )
    weights = _weights(span, x.response - turn.real * white - turn.imag * white_ahead, x, layout)
    nuisances = (turn, *_filled(weights, layout))
    phase = turn.real * ahead - turn.imag * shape  # what a little more rotation adds
    share = x.rotated / jnp.maximum(jnp.sum(phase.real**2 + phase.imag**2), 1e-300)

    def off(v: Array) -> Array:
        v = span.off(_off(v, x))
        return v - share * jnp.vdot(phase, v).real * phase

    driven = _with_extra(_modelled(shapes, nuisances, layout), weights, x, layout)
    late = (nuisances[2] * jnp.conj(turn)).real
    rows = left - turn.real * shape - turn.imag * ahead
    volume = span.volume + 0.5 * x.rotated * jnp.log1p(jnp.sum(phase.real**2 + phase.imag**2))
    numbers = _numbers(weights, x, layout)
    return (
        Residual(rows, driven, nuisances[1], x.floor, late, x.offset, turn, volume, numbers),
        nuisances,
        off,
    )


def _own_gain(shapes: Response, x: Experiment, layout: Layout):
    """A sweep whose drive is not recorded: its gain, complex for d/q rows, is one more nuisance."""
    span = _span((shapes.forced, *_extra(x, layout)), x, layout)
    weights = _weights(span, x.response, x, layout)
    nuisances = (weights[0], *_filled(weights[1:], layout))
    driven = _with_extra(_modelled(shapes, nuisances, layout), weights, x, layout)
    numbers = _numbers(weights, x, layout)
    found = Residual(
        span.off(x.response), driven, x.start, x.floor, x.late, x.offset, weights[0], span.volume, numbers
    )
    return found, nuisances, lambda v: span.off(_off(v, x))


def _amplitude(shapes: Response, x: Experiment, layout: Layout):
    """An amplitude log, the nuisances of a transient at their optimum near their present values."""
    now = (jnp.ones(()), x.start, x.late, x.floor, x.offset)
    if layout.steady:
        size = _modelled(shapes, now, layout)
        rows = x.response - _off(_whiten(size, x), x)
        kept = (x.start, x.floor, x.late, x.offset, now[0])
        return Residual(rows, size, *kept, jnp.zeros(()), jnp.zeros(0)), now, lambda v: _off(v, x)
    now = jax.lax.fori_loop(0, ROUNDS, lambda _, now: _stepped(now, shapes, x, layout), now)
    span, found = _about(now, shapes, x, layout)
    size = _modelled(shapes, now, layout)
    floor = jnp.where(x.floor_free > 0, found[2] / x.tightness, x.floor)
    rows = _left(now, shapes, x, layout)
    return (
        Residual(rows, size, now[1], floor, now[2], now[4], now[0], span.volume, jnp.zeros(0)),
        now,
        span.off,
    )


ROUNDS = 4  # of steps to the nuisances of an amplitude log
LEAST = 0.1  # of its floor that a step leaves
SHARES = (
    0.0,
    0.1,
    0.3,
    1.0,
)  # of such a step, of which the best is taken: near resonance the whole is too long


def _stepped(now: tuple[Array, ...], shapes: Response, x: Experiment, layout: Layout) -> tuple[Array, ...]:
    """Nuisances of an amplitude log after a step of Gauss and Newton, as much of it as leaves least."""
    _, found = _about(now, shapes, x, layout)
    start = jnp.where(x.start_free > 0, found[0] + 1j * found[1], now[1])
    late = found[3] if layout.late else now[2]
    floor = jnp.where(x.floor_free > 0, jnp.maximum(found[2] / x.tightness, LEAST * now[3]), now[3])
    offset = jnp.where(x.offset_free > 0, x.offset_free * (found[-2] + 1j * found[-1]), now[4])

    def part(share: Array) -> tuple[Array, ...]:
        return now[0], *(
            old + share * (new - old) for old, new in zip(now[1:], (start, late, floor, offset), strict=True)
        )

    left = jax.vmap(lambda share: jnp.sum(_left(part(share), shapes, x, layout) ** 2))(jnp.array(SHARES))
    return part(jnp.array(SHARES)[jnp.argmin(left)])


def _left(now: tuple[Array, ...], shapes: Response, x: Experiment, layout: Layout) -> Array:
    """Whitened residual of a transient's amplitude, with a row for the prior of each nuisance."""
    offset = now[4] / jnp.where(x.offset_free > 0, x.offset_free, 1.0)
    values = [
        now[1].real,
        now[1].imag,
        x.floor_free * x.tightness * now[3],
        *([now[2]] if layout.late else []),
    ]
    values = [*values, offset.real, offset.imag]
    rows = _off(x.response - _whiten(_modelled(shapes, now, layout), x), x)
    return rows.at[-len(values) :].add(-x.tightness * jnp.stack(values[::-1]))


def _about(now: tuple[Array, ...], shapes: Response, x: Experiment, layout: Layout) -> tuple[Span, Array]:
    """What the nuisances of a transient's amplitude can make, linear about their values `now`; and what they
    are at best."""
    size = _modelled(shapes, now, layout)
    plate = _modelled(shapes, now[:3], layout) + now[4]
    towards = rice.towards(plate, now[3])
    along = towards * shapes.free
    scale = 1 / x.tightness
    own = [along.real, -along.imag, rice.by_floor(plate, now[3]) * x.floor_free * scale]
    values = [now[1].real, now[1].imag, now[3] / scale]
    if layout.late:
        own, values = [*own, (towards * shapes.rate).real], [*values, now[2]]
    held, offset = towards * x.offset_free, now[4] / jnp.where(x.offset_free > 0, x.offset_free, 1.0)
    own, values = [*own, held.real, -held.imag], [*values, offset.real, offset.imag]
    span = Span([_held(c, i, x) for i, c in enumerate(own)])
    return span, span.weights(
        x.response - _whiten(size - sum(value * c for value, c in zip(values, own, strict=True)), x)
    )


def _held(column: Array, i: int, x: Experiment, turn: complex = 1.0) -> Array:
    """A whitened column with the row of its prior, the last but `i`, off the columns that do not depend on
    the plant. `turn`: by what the column is turned, and its prior with it."""
    prior = (jnp.arange(len(column)) == len(column) - 1 - i).astype(column.dtype)
    prior = prior if turn == 1.0 else turn * prior
    return _off(_off(_whiten(column, x) + x.tightness * prior, x), x)  # twice is enough


def _span(columns: Sequence[Array], x: Experiment, layout: Layout) -> Span:
    """What columns can make, with complex coefficients; where these are split, with real ones of each and of
    j times it."""
    if not layout.split:
        return Span([_held(c, i, x) for i, c in enumerate(columns)])
    turns = _turns(len(columns), x, layout)
    return Span(
        [_held(turns[i, k] * c, i, x, (1.0, 1j)[k]) for i, c in enumerate(columns) for k in range(2)],
        real=True,
    )


def _turns(columns: int, x: Experiment, layout: Layout) -> Array:
    """(K, 2) the two complex numbers of each column whose real multiples its coefficient is the sum of. Those
    of the log's own shapes are real in the plate's frame."""
    turns = jnp.tile(jnp.array([1.0, 1j]), (columns, 1))
    turns = turns.at[LATE].set(x.toward) if layout.late else turns
    return (
        turns.at[columns - layout.extra :].set(x.toward[0] * jnp.array([1.0, 1j * REAL]))
        if layout.extra
        else turns
    )


def _weights(span: Span, v: Array, x: Experiment, layout: Layout) -> Array:
    """Complex coefficients of the columns of `_span` in `v`."""
    found = span.weights(v)
    return (
        jnp.sum(found.reshape(-1, 2) * _turns(len(found) // 2, x, layout), axis=1) if layout.split else found
    )


def _whiten(v: Array, x: Experiment) -> Array:
    """Remove what the noise of each row shares with the row before (Ornstein-Uhlenbeck, any time grid);
    padding is zero."""
    return times(x.now, v) - times(x.before, jnp.concatenate([jnp.zeros_like(v[:1]), v[:-1]]))


def _off(v: Array, x: Experiment) -> Array:
    """`v` less its part in the span of the columns that do not depend on the plant."""
    along = jnp.sum(
        times(x.basis, v), axis=1
    )  # a sum, not a matrix product: several times faster for a handful of columns
    made = times(x.basis, along[:, None]) if jnp.iscomplexobj(x.basis) else along[:, None] * x.basis
    return v - jnp.sum(made, axis=0)


def density(
    squares: Sequence[Leaf], volumes: Sequence[Leaf], groups: Sequence[Experiment], xp: Any = jnp
) -> Leaf:
    """Log posterior density up to a constant, by the sums of squares (..., logs) of each group's whitened
    residual rows and the nuisances' volumes: flat in log G, log tau, f0 and k_T, nuisances and noise levels
    integrated out. `xp`: numpy or jax.numpy.

    No level is below that of rounding, so that the density of logs without noise is finite and of its width.
    """
    total = 0.0
    for square, volume, x in zip(squares, volumes, groups, strict=True):
        blank = x.freedom == 0  # padding of its group
        total = total - xp.sum(xp.where(blank, 0.0, volume), axis=-1)
        total = total - 0.5 * xp.sum(
            x.freedom * xp.log(xp.where(blank, 1.0, square + x.freedom * x.rounding)), axis=-1
        )
    return total
