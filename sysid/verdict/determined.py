"""Which parameters a fit determines, with which error, and why not the others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import shares
from sysid.model.theta import NAMES, POSITIVE, carried, in_units, std_of
from sysid.trials.trial import Trial
from sysid.verdict import identify
from sysid.verdict.fitted import Fit
from sysid.verdict.result import NORMAL95, Parameter

UNDESCRIBED = "cannot tell, because the model does not describe the logs; do first what the warnings ask for"


def enough(parameters: dict[str, Parameter], trials: Sequence[Trial]) -> bool:
    """Whether tau is determined, and G where a drive was recorded."""
    return parameters["tau"].determined and (
        parameters["G"].determined or all(t.log.drive is None for t in trials)
    )


def parameter(
    fit: Fit, name: str, value: float, std: float, ci95: tuple[float, float] | None = None
) -> Parameter:
    """The estimate of one parameter, or why there is none."""
    std = max(std, _over_modes(fit, name)) if ci95 is None else std  # draws are of all minima
    known, flank = informed(fit, name, value, std), fit.flank
    if flank is not None and (flank.undetermined if known else _for_its_peak(fit, name)):
        why = f"cannot tell, because {flank.said(known)}"
        return Parameter(None, None, None, fit.units[name], False, why)
    if known:
        if name in fit.lone:
            return Parameter(None, None, None, fit.units[name], False, fit.lone[name])
        ci95 = ci95 or (value - NORMAL95 * std, value + NORMAL95 * std)
        return Parameter(value, std, ci95, fit.units[name], True)
    state = fit.modes[0]
    modes = _modes(fit, name) if state.converged else ()
    said = identify.why(name, state.trials, state.tau, fit.names, len(modes) if state.converged else 1)
    if not modes and (spanned := _spanned(fit, name)):
        said = f"cannot tell, because what was found ({spanned}) leaves it open; do what the warnings ask for"
    if not state.converged:
        said = f"{said} (the fit did not converge)"
    elif name in fit.priors and not _told(fit, name):
        said = f"{said} (what is stated of it beforehand is not what the logs tell)"
    return Parameter(None, None, None, fit.units[name], False, said, modes)


def _spanned(fit: Fit, name: str) -> str:
    """What was found besides the plate, where the logs would determine a parameter but for what that leaves
    open; else ""."""
    names = [f.key.replace("_", " ") for f in fit.findings if f.outcome in ("fitted", "widened")]
    state = fit.modes[0]
    certain = replace(fit, modes=(replace(state, dispersion=np.zeros_like(state.dispersion)), *fit.modes[1:]))
    told = names and np.any(state.dispersion) and informed(certain, name, *alone(certain, name))
    return " and ".join(dict.fromkeys(names)) if told else ""


def _for_its_peak(fit: Fit, name: str) -> bool:
    """Whether the logs do not tell a parameter as they show the flank of one resonance, and not its peak."""
    shown = fit.modes[0].converged and not identify.buried(fit.modes[0].trials)
    return shown and fit.flank.alone and _told(fit, name) and not _modes(fit, name)


def undescribed(found: Parameter) -> Parameter:
    """A parameter of logs that the model does not describe: what they tell of it, and what would, is not
    known."""
    return Parameter(None, None, None, found.unit, False, UNDESCRIBED)


def informed(fit: Fit, name: str, value: float, std: float) -> bool:
    """Whether the logs determine a parameter, within its limit and as a single solution, provided that they
    show a peak."""
    told = fit.modes[0].converged and _told(fit, name) and np.isfinite(value)
    return bool(told and std <= _limit(fit, name) and not _modes(fit, name))


def _told(fit: Fit, name: str) -> bool:
    """Whether the logs alone determine it."""
    return (
        name in fit.names
        and (not fit.priors or alone(fit, name)[1] <= _limit(fit, name))
        and _shown(fit, name)
    )


def _limit(fit: Fit, name: str) -> float:
    """The largest error of a determined parameter; where tau is vague, that for the narrowest half bandwidth
    it allows."""
    state = fit.modes[0]
    tau, vague = state.tau, std_of(state.spread, "tau")
    if vague > identify.RELATIVE and name in ("f0", "k_T"):
        tau = tau * np.exp(min(2 * vague, 10.0))
    return identify.limits(state.G, tau)[name]


def _shown(fit: Fit, name: str) -> bool:
    """Whether the logs show more than a few readings show by chance, or than noise shows with an arbitrary
    tau."""
    state = fit.modes[0]
    if not fit.priors and identify.hopeless(state.trials, fit.names):
        return False
    if identify.ambiguous(name, state.trials, fit.names) or (
        name == "k_T" and identify.within_errors(state.trials)
    ):
        return False
    swept = all(t.steady and np.ptp(t.log.frequency) > 0 for t in state.trials if t.resonant)
    of_peak = name in ("f0", "k_T") or (name == "G" and swept and any(t.resonant for t in state.trials))
    known = not of_peak or std_of(state.spread, "tau") <= identify.RELATIVE
    return known or not identify.buried(state.trials)


def alone(fit: Fit, name: str, at: float | None = None) -> tuple[float, float]:
    """First-order estimate of a parameter from the logs alone, without the prior, and its standard deviation;
    f0 at `at` (degC), by default where it is reported."""
    state, k = fit.modes[0], NAMES.index(name)
    row = carried(fit.warming if at is None else at - fit.reference[1])[k]
    value = float(row @ (state.theta + state.alone @ state.prior.slope(state.theta)))
    std = float(np.sqrt(row @ (state.alone + state.dispersion) @ row))
    if name in POSITIVE:
        return float(np.exp(value)), float(np.exp(state.theta[k])) * std
    return value + (fit.reference[0] if name == "f0" else 0.0), std


def _mode_values(fit: Fit, name: str) -> list[tuple[float, float]]:
    """Of each minimum the value of a parameter as it is reported, and its standard deviation."""
    found, k, carry = [], NAMES.index(name), carried(fit.warming)
    for state in fit.modes:
        value = float(in_units(carry @ state.theta, fit.reference[0])[k])
        std = float(np.sqrt(carry[k] @ state.spread @ carry[k]))
        found.append((value, value * std if name in POSITIVE else std))
    return found


def _modes(fit: Fit, name: str) -> tuple[dict, ...]:
    """The values of separate minima and their weights; none where this parameter is the same in all of
    them."""
    if name not in fit.names or len(fit.modes) == 1:
        return ()
    found, weights = _mode_values(fit, name), shares(fit.modes)
    values, errors = np.transpose(found)
    if np.ptp(values) <= 2 * max(errors[0], float(np.sqrt(weights @ errors**2))):
        return ()
    return tuple(
        {"value": value, "std": std, "weight": float(w)}
        for (value, std), w in zip(found, weights, strict=True)
    )


def _over_modes(fit: Fit, name: str) -> float:
    """Standard deviation over all minima, about the value of the best."""
    if name not in fit.names or len(fit.modes) == 1:
        return 0.0
    values, errors = np.transpose(_mode_values(fit, name))
    return float(np.sqrt(shares(fit.modes) @ (errors**2 + (values - values[0]) ** 2)))
