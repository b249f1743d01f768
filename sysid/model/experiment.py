"""What the likelihood is told of a log: arrays, and the layout that says which of its lines apply."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import numpy as np

from sysid.model.span import times
from sysid.rows.hold import Hold, Leaf


class Layout(NamedTuple):
    """How an experiment is looked at; experiments of one layout are stacked, and looked at together."""

    amplitude: bool  # amplitude only: |W|
    own_gain: bool  # a sweep of which no drive is recorded: a gain of its own
    both_modes: bool  # low Q
    carrier: bool  # its phase is known where the inputs change
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

    @property
    def driven(self) -> "Layout":
        """As far as the plant's course goes with it: layouts that are alike there share a program."""
        return self._replace(apart=False, split=False, extra=min(self.extra, 1))


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
    N): shapes of the log's own, held at a plate. `tied` (4,): its own resonance where its thermometer's error
    is fitted, Hz above the reference, its mean warming, degC, one over that error, and the k_T at which the
    error's shape is held, Hz/degC; zeros elsewhere.
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
    the log determinant of the nuisances' information, as far as it depends on the plant. Of several logs or
    plants each has leading axes."""

    rows: np.ndarray
    driven: np.ndarray
    start: np.ndarray
    floor: np.ndarray
    late: np.ndarray
    offset: np.ndarray
    turn: np.ndarray
    volume: np.ndarray
    extra: np.ndarray


Groups = tuple[tuple[Layout, Experiment], ...]


def each(x: Experiment) -> list[Experiment]:
    """The logs of a group, one by one."""
    hold = [Hold(*leaves) for leaves in zip(*x.hold, strict=True)]
    return [Experiment(*leaves) for leaves in zip(hold, *x[1:], strict=True)]


def stacks(x: Experiment) -> list[Experiment]:
    """The logs of a group in stacks of 16, 4 or 1, say: so that as few programs as possible serve any number
    of logs."""
    n, begins = len(x.response), [0]
    while (left := n - begins[-1]) > 0:
        begins.append(begins[-1] + 4 ** ((left.bit_length() - 1) // 2))
    return [jax.tree.map(lambda leaf, some=slice(a, b): leaf[some], x) for a, b in pairwise(begins)]


def stacked(vectors: Sequence[np.ndarray]) -> np.ndarray:
    """(..., m, N) vectors (..., N) of the same or fewer leading axes."""
    return np.stack(np.broadcast_arrays(*vectors), axis=-2)


def priors(count: int, layout: Layout) -> np.ndarray:
    """(K, N) the row of each one's prior: the first one's is the last."""
    return np.eye(count, layout.rows)[:, ::-1]


def whiten(v: np.ndarray, x: Experiment) -> np.ndarray:
    """Remove what the noise of each row shares with the row before (Ornstein-Uhlenbeck, any time grid), of
    vectors (..., m, N); padding is zero."""
    found = times(x.now[..., None, :], v)
    found[..., 1:] -= times(x.before[..., None, 1:], v[..., :-1])
    return found


def off(v: np.ndarray, x: Experiment) -> np.ndarray:
    """Vectors (..., m, N) less their parts in the span of the columns that do not depend on the plant."""
    if np.iscomplexobj(x.basis):
        return _off(v.real, x.basis.real) + 1j * _off(v.imag, x.basis.imag)
    return _off(v, x.basis)


def _off(v: np.ndarray, basis: np.ndarray) -> np.ndarray:
    return v - (v @ np.swapaxes(basis, -1, -2)) @ basis
