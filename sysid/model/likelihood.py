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

lifted as noise does it (`model.rice`), is linear in its nuisances only about their values: steps lead to the
best at each plant. Where it is driven at its first row, h is the response that had settled by then, e the
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

The same lines are a program of JAX or numpy's, by the arrays that they are given (`model.span.module`).
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sysid.model.amplitude import amplitude
from sysid.model.experiment import Experiment, Layout, Residual, basis, modelled, off, priors, whiten
from sysid.model.plant import Response
from sysid.model.span import REAL, Span, best_turn, module, turn_towards
from sysid.model.theta import Theta
from sysid.rows.hold import Leaf

LATE = 1  # of the columns that depend on the plant, which is the lateness
# rows of an experiment, its last, for the priors of what depends on the plant: start, lateness, and each of
# `extra`
OWN = 8


def residual(theta: Leaf, x: Experiment, layout: Layout) -> Residual:
    """Whitened residual of one experiment in units of its noise, all nuisances at their optimum."""
    return _eliminated(theta, _shapes(theta, x, layout), x, layout)[0]


def linearised(theta: Leaf, x: Experiment, layout: Layout) -> tuple[Residual, Callable[[Leaf], Leaf]]:
    """`residual`, and the derivatives (p, N) of its rows along steps (p, 6) of theta: those of the model with
    the nuisances held, projected off all that the nuisances can adjust (Kaufman, BIT 15, 49, 1975). The
    gradient of the sum of squares is then exact, and J^T J is the information with the nuisances
    eliminated. Arrays of JAX, differentiated by it; or of numpy, by differences."""
    shapes = _shapes(theta, x, layout)
    found, nuisances, unexplained = _eliminated(theta, shapes, x, layout)

    def seen(theta: Leaf, shapes: Response) -> tuple[Leaf, ...]:
        model = modelled(shapes, nuisances, layout)
        return (model, _pull(theta, x, layout)) if layout.extra else (model,)

    def along(steps: Leaf) -> Leaf:
        if module(theta) is np:
            there = theta + DIFFERENCE * steps
            pairs = zip(seen(there, _shapes(there, _across(x), layout)), seen(theta, shapes), strict=True)
            model, *pull = ((moved.T - now) / DIFFERENCE for moved, now in pairs)
        else:
            _, change = jax.linearize(lambda t: seen(t, _shapes(t, x, layout)), theta)
            model, *pull = jax.vmap(change)(steps)
        return -unexplained(sum(pull, whiten(model, x)))

    return found, along


# of a step: a difference is right to it, and to the rounding of numbers over it
DIFFERENCE = 1e-7


def _across(x: Experiment) -> Experiment:
    """What it holds of intervals and rows (M, 1) and (N, 1), for several plants."""
    held = {k: v[:, None] if np.ndim(v) and k != "interval" else v for k, v in x.hold._asdict().items()}
    return x._replace(hold=x.hold._replace(**held), alongside=x.alongside[:, None])


def _shapes(theta: Leaf, x: Experiment, layout: Layout) -> Response:
    """Response to the drive, its rate and the free decay; without G where the log has a gain of its own."""
    xp = module(theta)
    if layout.extra:
        at = Theta.of(theta)
        tied = xp.where(x.tied[2] > 0, x.tied[0] - at.k_T * x.tied[1], at.f0)
        theta = xp.stack(at._replace(f0=tied), axis=-1)
    forced, rate, free = basis(theta, x.hold, layout)
    gain = 1.0 if layout.own_gain else xp.exp(Theta.of(theta).log_G)
    forced = gain * forced + x.alongside
    if layout.own_gain and layout.amplitude:  # the size is all there is, beside a floor whose power adds
        forced = xp.sqrt(xp.abs(forced) ** 2 + x.floor)
    unit = xp.where(x.hold.begun[0] > 0, gain, 1.0) if layout.amplitude else 1.0
    found = Response(forced, -gain * x.lateness * rate, x.start_free * unit * free)
    # Without the barrier the compiler evaluates the plant anew in each of the sums that use it: twice the
    # time.
    return found if xp is np else jax.lax.optimization_barrier(found)


def _eliminated(theta: Leaf, shapes: Response, x: Experiment, layout: Layout):
    """The residual, the nuisances at their optimum, and the projection of a vector off all that the nuisances
    can adjust."""
    x = x._replace(response=x.response - _pull(theta, x, layout)) if layout.extra else x
    if layout.amplitude and not layout.own_gain:
        return amplitude(shapes, x, layout)
    return _own_gain(shapes, x, layout) if layout.own_gain else _turned(shapes, x, layout)


def _pull(theta: Leaf, x: Experiment, layout: Layout) -> Leaf:
    """(N,) what the prior of the thermometer's error, the last of the extra shapes, holds against a resonance
    of the log's own: by how much warmer the plate is, in standard deviations."""
    at, xp = Theta.of(theta), module(theta)
    warmer = (x.tied[0] - at.f0 - at.k_T * x.tied[1]) / xp.where(at.k_T == 0, 1.0, at.k_T)
    row = layout.rows - layout.extra - (0 if layout.steady else 1 + layout.late)
    return xp.tensordot(1.0 * (xp.arange(layout.rows) == row), warmer * x.tied[2], axes=0)


def _own(shapes: Response, layout: Layout) -> tuple[Leaf, ...]:
    """The columns of a d/q log that depend on the plant as it is."""
    if layout.steady:
        return ()
    return (shapes.free, shapes.rate) if layout.late else (shapes.free,)


def _extra(x: Experiment, layout: Layout) -> tuple[Leaf, ...]:
    return tuple(x.extra[k] for k in range(layout.extra))


def _with_extra(driven: Leaf, weights: Leaf, x: Experiment, layout: Layout) -> Leaf:
    """With what the last of the weights make of the log's own shapes."""
    return driven + weights[len(weights) - layout.extra :] @ x.extra if layout.extra else driven


def _numbers(weights: Leaf, x: Experiment, layout: Layout) -> Leaf:
    """(E,) of the log's own shapes, which are real in the plate's frame."""
    return (weights[len(weights) - layout.extra :] * x.toward[0].conj()).real


def _filled(weights: Leaf, layout: Layout) -> tuple[Leaf, Leaf]:
    """Start and lateness of the weights that `_own` was given."""
    zero = module(weights).zeros((), weights.dtype)
    return (zero if layout.steady else weights[0]), (weights[1] if layout.late else zero)


def _turned(shapes: Response, x: Experiment, layout: Layout):
    """A log whose gain is G, and whose phase is turned by what the demodulator may have done: h and j h are
    two columns, whose coefficients are cos phi and sin phi."""
    xp = module(shapes.forced)
    span = _span((*_own(shapes, layout), *_extra(x, layout)), x, layout)
    white = off(whiten(shapes.forced, x), x)
    white_ahead = off(whiten(1j * shapes.forced, x), x) if layout.split else 1j * white
    left, shape = span.off(x.response), span.off(white)
    ahead = span.off(white_ahead) if layout.split else 1j * shape
    turn = best_turn(left, shape, ahead) if layout.split else turn_towards(left, shape)
    turn = xp.where(x.rotated > 0, turn, 1.0)
    weights = _weights(span, x.response - turn.real * white - turn.imag * white_ahead, x, layout)
    nuisances = (turn, *_filled(weights, layout))
    phase = turn.real * ahead - turn.imag * shape  # what a little more rotation adds
    squares = xp.sum(phase.real**2 + phase.imag**2)
    share = x.rotated / xp.maximum(squares, 1e-300)

    def unexplained(v: Leaf) -> Leaf:
        v = span.off(off(v, x))
        return v - (share * (v @ phase.conj()).real)[..., None] * phase

    driven = _with_extra(modelled(shapes, nuisances, layout), weights, x, layout)
    late = (nuisances[2] * turn.conj()).real
    rows = left - turn.real * shape - turn.imag * ahead
    volume = span.volume + 0.5 * x.rotated * xp.log1p(squares)
    numbers = _numbers(weights, x, layout)
    return (
        Residual(rows, driven, nuisances[1], x.floor, late, x.offset, turn, volume, numbers),
        nuisances,
        unexplained,
    )


def _own_gain(shapes: Response, x: Experiment, layout: Layout):
    """A sweep whose drive is not recorded: its gain, complex for d/q rows, is one more nuisance."""
    span = _span((shapes.forced, *_extra(x, layout)), x, layout)
    weights = _weights(span, x.response, x, layout)
    nuisances = (weights[0], *_filled(weights[1:], layout))
    driven = _with_extra(modelled(shapes, nuisances, layout), weights, x, layout)
    numbers = _numbers(weights, x, layout)
    found = Residual(
        span.off(x.response), driven, x.start, x.floor, x.late, x.offset, weights[0], span.volume, numbers
    )
    return found, nuisances, lambda v: span.off(off(v, x))


def _span(columns: Sequence[Leaf], x: Experiment, layout: Layout) -> Span:
    """What columns can make, whitened, each with the row of its prior, off the columns that do not depend on
    the plant; with complex coefficients or, where these are split, with real ones of each and of j times
    it."""
    if not columns:
        return Span(())
    xp = module(x.now)
    made, prior = xp.stack(columns), priors(len(columns), layout, xp)
    if layout.split:
        made = (_turns(len(columns), x, layout)[..., None] * made[:, None]).reshape(-1, layout.rows)
        prior = (xp.array([[1.0], [1j]]) * prior[:, None]).reshape(-1, layout.rows)
    held = off(off(whiten(made, x) + x.tightness * prior, x), x)  # twice is enough
    return Span(list(held), real=layout.split)


def _turns(columns: int, x: Experiment, layout: Layout) -> Leaf:
    """(K, 2) the two complex numbers of each column whose real multiples its coefficient is the sum of. Those
    of the log's own shapes are real in the plate's frame."""
    xp = module(x.toward)
    turns = columns * [xp.asarray([1.0, 1j])]
    if layout.late:
        turns[LATE] = x.toward
    turns[columns - layout.extra :] = layout.extra * [x.toward[0] * xp.asarray([1.0, 1j * REAL])]
    return xp.array(turns).reshape(columns, 2)


def _weights(span: Span, v: Leaf, x: Experiment, layout: Layout) -> Leaf:
    """Complex coefficients of the columns of `_span` in `v`."""
    found = span.weights(v)
    if not layout.split:
        return found
    return (found.reshape(-1, 2) * _turns(len(found) // 2, x, layout)).sum(axis=1)


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
