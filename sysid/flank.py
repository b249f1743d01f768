"""A resonance outside of all frequencies at which it was driven: what settled points then tell of it.

At x half bandwidths beside its resonance a plate answers with 1/sqrt(1 + x^2) of its peak, and its phase has arctan(1/x) left to
turn. Of the flank beyond that a background, a second resonance or another physics make what G, tau and f0 make. A transient is
another matter: its beat is the difference of drive and resonance, however far they lie apart.
"""

from collections.abc import Sequence

import numpy as np

from sysid.dwell import dwells
from sysid.minimise import State
from sysid.prior import NAMES
from sysid.trial import Trial

BESIDE = 1.0  # half bandwidths, from which it is said: the points show less than half of the peak's power
TAIL = 3.0  # half bandwidths, from which settled points alone determine nothing: less than a third of the peak


def doubt(state: State, reference: tuple[float, float]) -> str | None:
    """A sentence when f0 lies more than BESIDE half bandwidths outside of all driven frequencies, and no beat tells it."""
    return _said(state, reference) if abs(_outside(state, reference)) > BESIDE else None


def why(state: State, reference: tuple[float, float]) -> str | None:
    """Why nothing is determined when no more than the tail of a resonance was seen, by settled points alone; else None."""
    tau = float(np.exp(state.theta[1]))
    if abs(_outside(state, reference)) <= TAIL or not all(_settled(t, tau) for t in state.trials):
        return None
    return f"cannot tell, because {_said(state, reference)}"


def _said(state: State, reference: tuple[float, float]) -> str:
    x, tau = _outside(state, reference), float(np.exp(state.theta[1]))
    driven = np.concatenate([t.log.frequency for t in state.trials if t.resonant])
    side, edge = ("above", driven.max()) if x > 0 else ("below", driven.min())
    return (
        f"the best resonance lies {abs(x) / (2 * np.pi * tau):.3g} Hz, {abs(x):.2g} half bandwidths, {side} all frequencies that"
        f" were driven ({driven.min():.7g} to {driven.max():.7g} Hz): they show its flank, and not its peak; sweep on from"
        f" {edge:.7g} Hz, through it"
    )


def _outside(state: State, reference: tuple[float, float]) -> float:
    """Half bandwidths by which the resonance lies above (below: negative) all frequencies that were driven, each at its own
    temperature; 0 where it lies among them, or a transient has a frequency."""
    tau, k_T = float(np.exp(state.theta[1])), state.theta[NAMES.index("k_T")]
    resonant = [t for t in state.trials if t.resonant]
    if not resonant or not all(_settled(t, tau) for t in resonant):
        return 0.0
    above = _above(resonant, reference, state.theta[NAMES.index("f0")], k_T)
    nearest = above[np.argmin(np.abs(above))]
    return float(2 * np.pi * tau * nearest) if np.all(np.sign(above) == np.sign(nearest)) else 0.0


def _above(trials: Sequence[Trial], reference: tuple[float, float], f0: float, k_T: float) -> np.ndarray:
    """By how much (Hz) the resonance lies above the drive of each row."""
    warm = [0.0 if t.log.temperature is None else t.log.temperature - reference[1] for t in trials]
    return np.concatenate([reference[0] + f0 + k_T * w - t.log.frequency for t, w in zip(trials, warm, strict=True)])


def _settled(trial: Trial, tau: float) -> bool:
    """Whether a log shows settled points and nothing of how they settled."""
    return trial.steady or dwells(trial.log, tau)
