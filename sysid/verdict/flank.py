"""A resonance outside all driven frequencies, and what settled points then tell of it.

At x half bandwidths from its resonance a plate responds with 1/sqrt(1 + x^2) of its peak, and its phase has
arctan(1/x) left to turn. In the flank beyond, a background, a second resonance or other physics look like
changes of G, tau and f0. A transient is different: its beat is the difference of drive and resonance, however
far apart they are.
"""

from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.model.theta import NAMES, std_of
from sysid.rows.dwell import dwells
from sysid.trials.trial import Trial

BESIDE = 1.0  # half bandwidths, from which it is said: the points show less than half of the peak's power
# half bandwidths, from which settled points alone determine nothing: less than a third of the peak
TAIL = 3.0
SURE = 2.0  # errors of f0, by which it lies outside: of less the logs do not tell on which side it is


class Flank(NamedTuple):
    """How far a resonance lies above (negative: below) all driven frequencies, in Hz and in half bandwidths;
    the lowest and the highest of these; whether the logs hold settled points `alone`."""

    beyond: float
    halves: float
    lowest: float
    highest: float
    alone: bool

    @property
    def undetermined(self) -> bool:
        """No more than the tail of the resonance was seen."""
        return self.alone and abs(self.halves) > TAIL

    def said(self, wide: bool = True) -> str:
        """In words; `wide`: the logs tell how wide the resonance is."""
        side, edge = ("above", self.highest) if self.beyond > 0 else ("below", self.lowest)
        halves = f", {abs(self.halves):.2g} half bandwidths," if wide else ""
        return (
            f"the best resonance lies {abs(self.beyond):.3g} Hz{halves} {side} all frequencies"
            f" that were driven ({self.lowest:.7g} to {self.highest:.7g} Hz): they show its flank, and not"
            f" its peak; sweep on"
            f" from {edge:.7g} Hz, through it"
        )


def seen(state: State, reference: tuple[float, float]) -> Flank | None:
    """The flank, where f0 surely lies more than BESIDE half bandwidths outside of all driven frequencies,
    each at its own temperature; None where it does not, where there is none to sweep through (f0 <= 0), or
    where a transient has a frequency: its beat tells f0."""
    theta, tau = dict(zip(NAMES, state.theta, strict=True)), state.tau
    resonant = [t for t in state.trials if t.resonant]
    if not resonant or not all(_settled(t, tau) for t in resonant) or reference[0] + theta["f0"] <= 0:
        return None
    driven = np.concatenate([t.log.frequency for t in resonant])
    warm = [
        (0.0 if t.log.temperature is None else t.log.temperature - reference[1]) + np.zeros(len(t.log))
        for t in resonant
    ]
    above = reference[0] + theta["f0"] + theta["k_T"] * np.concatenate(warm) - driven
    nearest = float(above[np.argmin(np.abs(above))])
    halves, error = 2 * np.pi * tau * nearest, std_of(state.spread, "f0")
    if abs(halves) <= BESIDE or np.any(np.sign(above) != np.sign(nearest)) or abs(nearest) < SURE * error:
        return None
    return Flank(nearest, halves, driven.min(), driven.max(), all(_settled(t, tau) for t in state.trials))


def _settled(trial: Trial, tau: float) -> bool:
    """Whether a log shows settled points and nothing of how they settled."""
    return trial.steady or dwells(trial.log, tau)
