"""What the bench added to each log, with its error: rotation, offset, feedthrough, delay, the start, the
noise.

At the fit a log is linear in them, A nu + J (theta - theta_0) in whitened rows, each prior one row of A. With
C the covariance of the plant's parameters from all logs, the covariance of nu is

    S + B C B^T,    S = (A^T A)^-1,    B = S A^T J

which is exact for a linear model and normal noise (Gelman et al., Bayesian Data Analysis, 3rd ed., ch. 14).
"""

from typing import NamedTuple

import numpy as np

from sysid.asked import FIT, given
from sysid.trials.extra import UNITS
from sysid.trials.trial import Trial, freedom
from sysid.verdict.fitted import Fit
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.result import NORMAL95, Parameter

TOLD = 0.5  # of its prior's standard deviation: above, the log says little of it
ANY_ANGLE = 180.0 / np.sqrt(3.0)  # deg, the standard deviation of an angle of which nothing is known


class _Shown(NamedTuple):
    """How a column of the view is reported: under which name, in which unit, by which factor."""

    name: str
    unit: str
    factor: float


def nuisances(fit: Fit) -> tuple[dict[str, Parameter], ...]:
    """Of each log, by name, what the bench added to it. `delay` (s) and `rotation` (deg) are those of the
    demodulator beyond what the log states; `drift`, `lag`, `gain`, `thermometer` those of `trials.extra`;
    `offset`, `feedthrough` (per unit of the drive), `slope` (per Hz besides), `baseline` (per s) and `start`
    have d and q as the log records them, the start of an amplitude that is driven at its first row what it
    has beside the settled response, along it and across, and an offset under an amplitude what it has along
    the response at resonance; `noise` is one channel's standard deviation; where those of d and q differ it
    is their root mean square, with `noise_d` and `noise_q`."""
    given("fit", fit, Fit, FIT)
    state = fit.modes[0]
    return tuple(
        _of_one(view, state.spread) for view in LinearisedLog.each(state, fit.reference, coloured=True)
    )


def _of_one(view: LinearisedLog, covariance: np.ndarray) -> dict[str, Parameter]:
    found = {}
    if view.columns:
        values, errors = (
            np.array([c.value for c in view.columns]),
            np.sqrt(np.diag(view.covariance(covariance))),
        )
        for column, value, error in zip(view.columns, values, errors, strict=True):
            if shown := _shown(column.name, view.trial):
                prior = min(column.prior * shown.factor, ANY_ANGLE if shown.name == "rotation" else np.inf)
                number = float(value) * shown.factor
                found[shown.name] = _parameter(number, float(error) * shown.factor, shown.unit, prior)
    return found | _noises(view.trial)


def _noises(trial: Trial) -> dict[str, Parameter]:
    """The level of the noise and, where d and q have their own, of each; the former is then their root mean
    square."""
    unit, noise, parts = trial.log.response_unit, trial.noise, trial.noise.parts
    stds = np.array([p.std for p in parts])
    errors = stds * [p.relative_error(freedom(trial) / len(parts)) for p in parts]
    both = float(np.linalg.norm(stds * errors) / np.linalg.norm(stds) / np.sqrt(len(parts)))
    found = {"noise": _parameter(noise.std, both, unit, np.inf)}
    for name, std, error in zip(("noise_d", "noise_q"), stds, errors, strict=False):
        found |= {name: _parameter(float(std), float(error), unit, np.inf)} if noise.levels else {}
    return found


def _shown(name: str, trial: Trial) -> _Shown | None:
    """None for what is no quantity of the bench (a gain, an amplitude's floor), or absent from a log of real
    rows."""
    unit, drive = trial.log.response_unit, trial.log.drive_unit if trial.log.drive is not None else None
    kind, _, channel = name.partition("_")
    real = not np.iscomplexobj(trial.log.response)
    if kind in trial.bench.extra and channel:
        scale = trial.bench.extra[kind].prior / trial.looseness
        return None if channel == "q" else _Shown(kind, UNITS[kind], scale)
    if kind in ("gain", "floor") or kind.startswith("memory") or (real and channel == "q"):
        return None
    shown = kind if real else name
    if kind == "rotation":
        return _Shown("rotation", "deg", float(np.rad2deg(1.0)))
    if kind == "late":
        factor = trial.lateness / (trial.looseness if channel else trial.lateness)
        return None if channel == "q" else _Shown("delay", "s", factor)
    if kind == "start" or trial.bench.standing:  # of an amplitude
        return _Shown(shown, unit, 1.0)
    per_drive, per_both = (f"{unit}/{drive}", f"{unit}/({drive} Hz)") if drive else (unit, f"{unit}/Hz")
    per = {"offset": unit, "feedthrough": per_drive, "slope": per_both, "baseline": f"{unit}/s"}[kind]
    return _Shown(shown, per, 1 / float(np.max(np.abs(trial.shapes[kind]))))


def _parameter(value: float, error: float, unit: str, prior: float) -> Parameter:
    if not np.isfinite(error) or error > TOLD * prior:
        why = (
            f"cannot tell, because the log says no more about it than what was assumed, {prior:.3g} {unit}"
            f" about zero"
        )
        return Parameter(
            None, None, None, unit, False, f"{why}; record rows closer together, or a larger drive"
        )
    interval = (value - NORMAL95 * error, value + NORMAL95 * error)
    return Parameter(value, error, interval, unit, True)
