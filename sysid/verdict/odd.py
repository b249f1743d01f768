"""Of logs that one plant does not explain: the one that contradicts the others, and in what.

A log that the model describes by itself, beside others that it describes together, holds nothing that the
model leaves out: it is of another plate, at another temperature, or in other units. That asks for less than
an effect that would explain it.
"""

from collections.abc import Sequence

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.model.prior import carried
from sysid.rows.thermometer import was_read
from sysid.trials.trial import Trial
from sysid.verdict.between import finger, own, times, unread, warmer
from sysid.verdict.misfit import described
from sysid.verdict.recorder import clipped, touched

APART = 5.0  # standard deviations by which a log has to contradict the others: once in a million
ALIKE = 3.0  # by which log G and log tau are both lower, and within which by the same, as under a finger


def odd_one(
    minimiser: Minimiser, trials: Sequence[Trial], together: State, which: int | None = None
) -> str | None:
    """A sentence on the log that the fit of all leaves most of, or on `which`, where it and the others are
    each described well; else None."""
    if len(trials) < 2 or any(touched(t) or clipped(t) for t in together.trials):
        return None
    known = [was_read(t.log) for t in trials]
    i = int(np.argmax([_left(t, m) for t, m in zip(together.trials, together.models, strict=True)]))
    i = known.index(False) if len(trials) == 2 and sum(known) == 1 else i  # of two either may be the odd one
    i = i if which is None else which
    others = (*trials[:i], *trials[i + 1 :])
    alone, rest = (minimiser.minima(some)[0] for some in ((trials[i],), others))
    if not (described(minimiser, alone) and described(minimiser, rest)):
        return None
    warm = float(np.mean(trials[i].hold(minimiser.reference).warming))
    said = {
        "G": ("G", times_of),
        "tau": ("tau", times_of),
        "f0": ("the resonance", lambda x: f"{x:+.4g} Hz off that"),
    }
    apart = {n: _apart(alone, rest, k, warm) for k, n in enumerate(said) if n in minimiser.free}
    name = max(apart, key=lambda n: abs(apart[n][0]) / apart[n][1])
    value, error = apart[name]
    if abs(value) < APART * error:
        return None
    if touch := _touch(apart):
        return finger(trials[i].log.name, warmer([t.log for t in trials], i))(np.array([touch]), None)
    if name == "f0" and not known[i] and any(known):
        return unread(trials[i].log.name, value)
    what, about = said[name]
    return own(trials[i].log.name, what, about(value))


def _touch(apart: dict[str, tuple[float, float]]) -> float:
    """By how much log G and log tau are both lower than those of the others; 0 where they are not, or not
    alike."""
    values, errors = np.array([apart.get(n, (0.0, 1.0)) for n in ("G", "tau")]).T
    if np.any(values > -ALIKE * errors) or abs(values[0] - values[1]) > ALIKE * float(np.hypot(*errors)):
        return 0.0
    return float(-np.sum(values / errors**2) / np.sum(errors**-2.0))


def times_of(x: float) -> str:
    """A factor by its logarithm."""
    return times(float(np.expm1(x)) if x > 0 else x)


def _left(trial: Trial, model: np.ndarray) -> float:
    """Root mean square of what the model leaves of a log, over what its neighbouring rows do not share."""
    left = trial.residual(model)
    if len(left) < 3:
        return 0.0
    return float(np.sqrt(2 * np.mean(np.abs(left) ** 2) / max(np.mean(np.abs(np.diff(left)) ** 2), 1e-300)))


def _apart(alone: State, rest: State, k: int, warm: float) -> tuple[float, float]:
    """By how much log G, log tau, or the resonance at `warm` degC, differ, and the standard deviation of
    that."""
    row = carried(warm)[k]
    return float(row @ (alone.theta - rest.theta)), float(
        np.sqrt(row @ (alone.covariance + rest.covariance) @ row)
    )
