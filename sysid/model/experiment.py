"""What the likelihood is told of a log: arrays and the layout of its program."""

from typing import Any, NamedTuple

from sysid.model import rice
from sysid.model.plant import Response, respond, steady
from sysid.model.span import module, times
from sysid.model.theta import PLANT, Theta
from sysid.rows.hold import Hold, Leaf


class Layout(NamedTuple):
    """What decides which program evaluates an experiment; experiments of one layout are stacked and share
    one."""

    amplitude: bool  # amplitude only: |W|
    own_gain: bool  # a sweep of which no drive is recorded: a gain of its own
    both_modes: bool  # low Q
    carrier: bool  # its phase is known where the inputs change
    late: bool  # a transient, by an unknown time
    touched: bool  # a finger's force is recorded
    apart: bool  # the noise of d and q differs
    # real and imaginary parts of coefficients are apart: where the noise is, a swept log may be late, or
    # `extra`
    split: bool
    order: int  # poles of the lock-in's filter
    extra: int  # shapes of the log's own
    steady: bool  # settled points
    rows: int
    intervals: int


class Experiment(NamedTuple):
    """One log as arrays, padded to its layout; in a group each has a leading axis of logs.

    `hold`: inputs. `response` (N,): complex d/q or real amplitude, whitened, off the span of `basis`. `now`,
    `before` (N,) of the whitening a_k v_k - b_k v_(k-1) in units of the noise, 0 for padding. `basis` (K, N):
    orthonormal, of the whitened columns that do not depend on the plant, with a row for each one's prior.
    Where the noise of d and q differs, these three are complex: real parts act on d, imaginary ones on q.
    `tightness`: one over the standard deviation of the nuisances' prior; `freedom` degrees of freedom of the
    residual; `rounding` square of float64's noise over the log's; `rotated` 1 when the demodulator's phase is
    unknown; `lateness` s, the standard deviation of how late the response is, over that of the other
    nuisances, `toward` (2,) the angles along which it is real and imaginary, times the share of s that each
    may have; `start`, `floor`, `late` and `offset` the amplitude log's nu_1 (complex), nu_2, nu_3 and nu_4
    (complex); `alongside` (N,) what moves beside the plate; `start_free` and `offset_free` the priors of
    start and offset over that of the other nuisances, `floor_free` 1, when they are to be found. `extra` (E,
    N): shapes of the log's own, held at a plate. `tied` (3,): its own resonance where its thermometer's error
    is fitted, Hz above the reference, its mean warming, degC, and one over that error; zeros elsewhere.
    """

    hold: Hold
    response: Leaf
    now: Leaf
    before: Leaf
    basis: Leaf
    tightness: Leaf
    freedom: Leaf
    rounding: Leaf
    rotated: Leaf
    lateness: Leaf
    toward: Leaf
    start: Leaf
    floor: Leaf
    late: Leaf
    offset: Leaf
    alongside: Leaf
    start_free: Leaf
    floor_free: Leaf
    offset_free: Leaf
    extra: Leaf
    tied: Leaf


class Residual(NamedTuple):
    """Whitened residual rows (including the priors'), the modelled rows (N,) that the plant drives, and the
    nuisances' values: `late` in units of `lateness`, `offset` as `Experiment` has it, `extra` (E,) of the
    columns, `turn` the demodulator's rotation times the gain where that is the log's own. `volume` is half
    the log determinant of the nuisances' information, as far as it depends on the plant."""

    rows: Leaf
    driven: Leaf
    start: Leaf
    floor: Leaf
    late: Leaf
    offset: Leaf
    turn: Leaf
    volume: Leaf
    extra: Leaf


def basis(theta: Leaf, hold: Hold, layout: Layout) -> Response:
    """The plant's response per unit G, its rate of change, and its free decay from a unit start; (N,) complex
    arrays; of several plants with numpy (N, P).

    `theta` (6,) as `model.theta` has it, or (P, 6), with what `hold` has of intervals and rows (M, 1) and
    (N, 1), but for `interval`. A finger, or what else damps, divides tau and G by one factor, and with G the
    drive.
    """
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


def modelled(shapes: Response, nuisances: tuple[Leaf, ...], layout: Layout) -> Leaf:
    """Rows that the plant drives: turn h + start e + late h' or, for an amplitude, the mean of Rice's
    distribution about its size beside an offset, whose level is the root of the floor."""
    turn, start, late, *amplitude = nuisances
    w = turn * shapes.forced + start * shapes.free
    w = w + late * shapes.rate if layout.late else w
    if not amplitude:
        return w
    floor, offset = amplitude
    return rice.mean(w + offset, floor)


def priors(count: int, layout: Layout, xp: Any) -> Leaf:
    """(K, N) the row of each one's prior: the first one's is the last."""
    return xp.eye(count, layout.rows)[:, ::-1]


def whiten(v: Leaf, x: Experiment) -> Leaf:
    """Remove what the noise of each row shares with the row before (Ornstein-Uhlenbeck, any time grid), of
    vectors (..., N); padding is zero."""
    before = module(v).concatenate([0.0 * v[..., :1], v[..., :-1]], axis=-1)
    return times(x.now, v) - times(x.before, before)


def off(v: Leaf, x: Experiment) -> Leaf:
    """Vectors (..., N) less their part in the span of the columns that do not depend on the plant."""
    # sums, not matrix products: several times faster for a handful of columns
    along = times(x.basis, v[..., None, :]).sum(axis=-1)[..., None]
    made = times(x.basis, along) if module(v).iscomplexobj(x.basis) else along * x.basis
    return v - made.sum(axis=-2)


Groups = tuple[tuple[Layout, Experiment], ...]
