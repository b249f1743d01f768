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

Leading axes are of the logs of a group, or of plants: all are looked at together.
"""

from collections.abc import Callable, Sequence

import numpy as np

from sysid.model.amplitude import amplitude
from sysid.model.course import Course
from sysid.model.experiment import Experiment, Layout, Residual, off, priors, stacked, whiten
from sysid.model.nuisances import Nuisances, changed, modelled
from sysid.model.span import REAL, Span, best_turn, dot

# rows of an experiment, its last, for the priors of what depends on the plant: start, lateness, and each of
# `extra`
OWN = 8
LEAST = 1e-6  # of the k_T of a shape: a smaller one, and none, is as good as that
Unexplained = Callable[[np.ndarray], np.ndarray]  # vectors (..., m, N) less what the nuisances can adjust


def residual(course: Course, x: Experiment, layout: Layout) -> Residual:
    """Whitened residual in units of the noise, all nuisances at their optimum, beside a plant of this
    `course`."""
    return _eliminated(course, x, layout)[0]


def linearised(course: Course, change: Course, x: Experiment, layout: Layout) -> tuple[Residual, np.ndarray]:
    """`residual`, and the derivatives (..., p, N) of its rows where the course has these: those of the model
    with the nuisances held, projected off all that the nuisances can adjust (Kaufman, BIT 15, 49, 1975). The
    gradient of the sum of squares is then exact, and J^T J is the information with the nuisances
    eliminated."""
    found, nuisances, unexplained = _eliminated(course, x, layout)
    rows = whiten(changed(course, change, nuisances), x)
    return found, -unexplained(rows if change.warmer is None else rows + _pull(change.warmer, x, layout))


def _eliminated(course: Course, x: Experiment, layout: Layout) -> tuple[Residual, Nuisances, Unexplained]:
    """The residual, the nuisances at their optimum, and the projection off all that these can adjust."""
    if course.warmer is not None:
        x = x._replace(response=x.response - _pull(course.warmer[..., None], x, layout)[..., 0, :])
    if layout.amplitude and not layout.own_gain:
        return amplitude(course, x, layout)
    return _own_gain(course, x, layout) if layout.own_gain else _turned(course, x, layout)


def _pull(warmer: np.ndarray, x: Experiment, layout: Layout) -> np.ndarray:
    """(..., m, N) what the prior of the thermometer's error, the last of the extra shapes, holds against a
    resonance of the log's own: by how much warmer (..., m) the plate is, in standard deviations."""
    row = layout.rows - layout.extra - (0 if layout.steady else 2)
    return (warmer * x.tied[..., 2:3])[..., None] * (np.arange(layout.rows) == row)


def _turned(course: Course, x: Experiment, layout: Layout) -> tuple[Residual, Nuisances, Unexplained]:
    """A log whose gain is G, and whose phase is turned by what the demodulator may have done: h and j h are
    two columns, whose coefficients are cos phi and sin phi."""
    columns = _Columns(() if layout.steady else (course.start, course.late), x, layout, course.steeper)
    white, ahead = _apart(off(whiten(stacked([course.forced, 1j * course.forced]), x), x))
    parts = _apart(columns.off(stacked([x.response, white, ahead])))
    turn = np.where(x.rotated > 0, best_turn(*parts), 1.0)
    c, s, (left, shape, sideways) = turn.real[..., None], turn.imag[..., None], parts
    weights = columns.weights(x.response - c * white - s * ahead)
    phase = (c * sideways - s * shape)[..., None, :]  # what a little more rotation adds
    squares = dot(phase, phase).real
    share = x.rotated[..., None] / np.maximum(squares, 1e-300)

    def unexplained(v: np.ndarray) -> np.ndarray:
        v = columns.off(off(v, x))
        return v - (share * dot(phase, v).real)[..., None] * phase

    at = Nuisances(turn) if layout.steady else Nuisances(turn, weights[..., 0], weights[..., 1])
    volume = columns.volume + 0.5 * x.rotated * np.log1p(squares[..., 0])
    return _found(course, at, left - c * shape - s * sideways, volume, weights, x, layout), at, unexplained


def _own_gain(course: Course, x: Experiment, layout: Layout) -> tuple[Residual, Nuisances, Unexplained]:
    """A sweep whose drive is not recorded: its gain, complex for d/q rows, is one more nuisance."""
    columns = _Columns((course.forced,), x, layout, course.steeper)
    weights, rows = columns.weights(x.response), columns.off(x.response[..., None, :])[..., 0, :]
    at = Nuisances(weights[..., 0])
    found = _found(course, at, rows, columns.volume, weights, x, layout)
    return found, at, lambda v: columns.off(off(v, x))


def _found(
    course: Course,
    at: Nuisances,
    rows: np.ndarray,
    volume: np.ndarray,
    weights: np.ndarray,
    x: Experiment,
    layout: Layout,
) -> Residual:
    """The residual by its rows and its volume, and the weights of all columns."""
    own = weights[..., weights.shape[-1] - layout.extra :]
    driven = modelled(course, at) + (own[..., None, :] @ x.extra)[..., 0, :]
    numbers = (own * x.toward[..., :1].conj()).real  # the log's own shapes are real in the plate's frame
    start = x.start if at.start is None else at.start
    late = x.late if at.late is None else (at.late * at.turn.conj()).real
    return Residual(rows, driven, start, x.floor, late, x.offset, at.turn, volume, numbers)


class _Columns(Span):
    """What columns of the plant's, and the log's own shapes, can make, whitened, each with the row of its
    prior, off the columns that do not depend on the plant; with complex coefficients or, where these are
    split, with real ones of each and of j times it."""

    def __init__(self, own: Sequence[np.ndarray], x: Experiment, layout: Layout, steeper: np.ndarray | None):
        columns = (*own, *np.moveaxis(x.extra, -2, 0))
        made = stacked(columns) if columns else np.zeros((0, layout.rows), complex)
        prior = priors(len(columns), layout)
        self.turns = _turns(len(columns), x, layout) if layout.split else None
        if self.turns is not None:
            made = (self.turns[..., None] * made[..., None, :]).reshape(*made.shape[:-2], -1, layout.rows)
            prior = (np.array([[1.0], [1j]]) * prior[:, None]).reshape(-1, layout.rows)
        held = whiten(made, x)
        if steeper is None:
            held = held + x.tightness[..., None, None] * prior
        else:  # the last, and both its numbers
            scale = np.maximum(np.abs(steeper), LEAST)[..., None, None]
            last = np.arange(len(prior))[:, None] >= len(prior) - (2 if layout.split else 1)
            held = held + x.tightness[..., None, None] * prior / np.where(last, scale, 1.0)
        super().__init__(off(off(held, x), x), real=layout.split)  # twice is enough
        if steeper is not None:  # of a prior whose width goes with k_T, its own determinant
            self.volume = self.volume + 2 * np.log(scale[..., 0, 0])

    def weights(self, v: np.ndarray) -> np.ndarray:
        """(..., K) complex coefficients of the columns in `v` (..., N)."""
        found = super().weights(v)
        if self.turns is None:
            return found
        return (found.reshape(*found.shape[:-1], -1, 2) * self.turns).sum(axis=-1)


def _turns(count: int, x: Experiment, layout: Layout) -> np.ndarray:
    """(..., K, 2) the two complex numbers of each column whose real multiples its coefficient is the sum of.
    Those of the log's own shapes are real in the plate's frame, as is how late the response is."""
    turns = np.empty((*x.toward.shape[:-1], count, 2), complex)
    turns[:] = 1.0, 1j
    if not layout.steady:
        turns[..., 1, :] = x.toward
    turns[..., count - layout.extra :, :] = x.toward[..., None, :1] * [1.0, 1j * REAL]
    return turns


def _apart(v: np.ndarray) -> np.ndarray:
    """(m, ..., N) of vectors (..., m, N)."""
    return np.moveaxis(v, -2, 0)


def density(
    squares: Sequence[np.ndarray], volumes: Sequence[np.ndarray], groups: Sequence[Experiment]
) -> np.ndarray:
    """Log posterior density up to a constant, by the sums of squares (..., logs) of each group's whitened
    residual rows and the nuisances' volumes: flat in log G, log tau, f0 and k_T, nuisances and noise levels
    integrated out.

    No level is below that of rounding, so that the density of logs without noise is finite and of its width.
    """
    total = np.zeros(())
    for square, volume, x in zip(squares, volumes, groups, strict=True):
        total = total - np.sum(volume, axis=-1)
        total = total - 0.5 * np.sum(x.freedom * np.log(square + x.freedom * x.rounding), axis=-1)
    return total
