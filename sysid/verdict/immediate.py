"""What of a step's response is there at once, and whether a bench feeds so much through.

A step settles at (G + nu) V: the plate's part rises with tau, the feedthrough nu is there within a row. Where
no sweep tells the two apart, G is what the feedthrough leaves of the settled level, whatever responds at
once: a second, faster rate, or a plant of another order. So the share |nu|/|G + nu| is told, and beyond FED
of it the plant is not of first order.
"""

import numpy as np

from sysid.minimum.minimise import State
from sysid.trials.trial import Trial
from sysid.verdict.gain_confounding import complex_of
from sysid.verdict.linearised import LinearisedLog

# of the settled response: more than any bench is known to feed through to a sensor of the plate's own motion
FED = 0.15
SEEN = 2.0  # errors of the share, from which it is there


def responds_at_once(state: State, reference: tuple[float, float]) -> list[str]:
    """A sentence for each log of which more than FED of the settled response is there within a row; none
    beside a sweep."""
    if any(t.resonant and np.ptp(t.log.frequency) > 0 for t in state.trials):
        return []
    views = (
        LinearisedLog(t, m, state, reference, coloured=True)
        for t, m in zip(state.trials, state.models, strict=True)
        if _steps(t)
    )
    return [said for view in views if (said := _of(view, state)) is not None]


def _steps(trial: Trial) -> bool:
    moves = not trial.steady and trial.driven and not trial.creeps
    return moves and trial.signed and "feedthrough" in trial.shapes


def _of(view: LinearisedLog, state: State) -> str | None:
    through = complex_of(view, "feedthrough", np.conj(view.turn))
    value = complex(through @ np.array([c.value for c in view.columns]))
    error = float(
        np.sqrt((through @ view.covariance(state.covariance) @ through.conj()).real / view.trial.channels)
    )
    settled = abs(view.course.gain * float(np.max(np.abs(view.trial.shapes["feedthrough"]))) + value)
    share = abs(value) / settled
    if share <= FED or abs(value) <= SEEN * error:
        return None
    about = f"{100 * share:.2g} ± {100 * error / settled:.1g} %"
    shorter = ", or the lock-in's filter is shorter than is stated" if view.trial.smoothing[1] else ""
    return (
        f"{view.trial.log.name}: {about} of the settled response is there within a row, more than a bench"
        f" feeds through: the plant has a faster part beside tau{shorter}, and G is not what is left; record"
        " rows closer together about the step, or a sweep"
    )
