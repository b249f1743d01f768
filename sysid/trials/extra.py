"""Further effects of the bench on a d/q log: one number nu each, times a shape that depends on the plate.

    drift         Hz     the resonance goes from -nu at the first row to +nu at the last    prior: a half
                  bandwidth
    lag           s      the plate is warmer by nu dT/dt than the temperature sensor        prior: a tenth of
                  the log's duration
    gain          1      the sensor shows 1 + nu times what those of the other logs do      prior: a tenth
    thermometer   degC   the plate is warmer by nu than the reading                         prior: the error
                  of reading

Drift, lag and thermometer each add 2 pi j Z times a shift of the resonance (Hz) to the slow mode's Z' = a Z +
b V, as in `trials.perturbed`. This is to first order, so the shift should stay well within the half
bandwidth. Shapes are computed at the current plate and anew in each round. Where the thermometer's error is
fitted, the log gets a resonance of its own, about which the shape is taken; only the prior of that error ties
it to f0 and k_T.

Drift and lag are fitted on request only: in a sweep of one direction a drift hides in f0 and tau. A gain is
fitted on request, and where a sweep's feedthrough may be a delay (`verdict.sensor_delay`); the thermometer's
error where it moves the resonance by as much as the logs could show. A drifting baseline, also on request,
does not depend on the plate and is one of `Trial.shapes`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sysid.trials.bench import Extra
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

EXTRA = ("drift", "lag", "gain", "baseline")
UNITS = {"drift": "Hz", "lag": "s", "gain": "1", "thermometer": "degC"}
STRIDE = 0.5  # half bandwidths: the most that a resonance moves in one round, within reach of the first order
SHARE = 0.1  # prior, as a share of the log's duration and of the gain
TOLD, UNTOLD = (
    0.2,
    1.0,
)  # standard deviations of f0 from which a thermometer's error is fitted, and mentioned where it cannot be


def asked(trial: Trial, course: LogResponse, beside: tuple[complex, complex]) -> dict[str, Extra]:
    """The effects that are asked for and that the log can show, by name; arguments as in `possible`."""
    if set(UNITS).isdisjoint(trial.nuisances):
        return {}
    return {name: extra for name, extra in possible(trial, course, beside).items() if name in trial.nuisances}


def renewed(new: Trial, course: LogResponse, numbers: np.ndarray) -> Trial:
    """The trial with new shapes for the effects asked for. With its thermometer's error it has a resonance of
    its own: first that of theta, then moved to first order by `numbers` (E,), the coefficients of the
    course's columns. A resonance far away is reached in several rounds."""
    if set(UNITS).isdisjoint(new.nuisances):
        return new
    trial, f0, k_T = course.trial, course.named.f0, course.named.k_T
    if "thermometer" in trial.nuisances:
        own, most = (
            f0 + k_T * course.warming if trial.bench.resonance is None else trial.bench.resonance,
            STRIDE / (2 * np.pi * course.tau),
        )
        more = 0.0
        if trial.tied:
            size = k_T * trial.bench.extra["thermometer"].prior / trial.looseness
            more = size * float(numbers[list(trial.extra_columns).index("thermometer")])
        new = new.with_bench(resonance=own + float(np.clip(more, -most, most)), k_T=k_T)
        course = replace(course, trial=new)
    extra = asked(new, course, (new.bench.start, -new.bench.late))
    if "thermometer" not in extra:  # where k_T is zero its error moves nothing
        new = new.with_bench(resonance=None)
    return new.with_bench(extra=extra)


def with_thermometers(
    trials: Sequence[Trial], k_T: float, k_T_std: float, f0_std: float
) -> tuple[tuple[Trial, ...], list[str]]:
    """The trials of a fit, each with its thermometer's error where that matters; and a sentence for each log
    where it matters but cannot be fitted. Judged by the largest k_T that the logs allow: one that is not
    known may be small by chance."""
    found, said, largest = [], [], abs(k_T) + 2 * k_T_std
    for trial in trials:
        error = trial.log.bench.get("temperature_std_degC", 0.0)
        share = largest * error / f0_std
        fitted = share > TOLD and trial.signed and trial.driven
        found.append(replace(trial, nuisances=(*trial.nuisances, "thermometer")) if fitted else trial)
        if share > UNTOLD and not fitted:
            said.append(
                f"{trial.log.name}: its thermometer may be {error:.2g} degC off, which would move f0 by"
                f" {share:.2g} of its"
                " standard deviations, which its error does not include; record wd and wq with their drive,"
                " or more rows"
            )
    return tuple(found), said


def possible(trial: Trial, course: LogResponse, beside: tuple[complex, complex]) -> dict[str, Extra]:
    """The effects that the log can show, by name; `beside`: start and lateness, as `LogResponse.changed` has
    them."""
    if not (trial.signed and trial.driven):
        return {}
    found = {name: Extra(shape, prior) for name, shape, prior in _shapes(trial, course, beside)}
    return {name: extra for name, extra in found.items() if np.any(extra.shape)}


def _shapes(
    trial: Trial, course: LogResponse, beside: tuple[complex, complex]
) -> Iterator[tuple[str, np.ndarray, float]]:
    log, tau = trial.log, course.tau
    turning, held = 2j * np.pi * np.ones(len(log)), np.ones(len(course.hold.drive))
    along = np.arange(len(log)) if log.time is None else log.time - log.time[0]
    sorted_by_frequency = trial.steady and trial.whole is not None  # the means of a long sweep
    if trial.resonant and along[-1] > 0 and not sorted_by_frequency:
        yield "drift", course.along((2 * along / along[-1] - 1) * turning, *beside), 1 / (2 * np.pi * tau)
    if trial.resonant and log.temperature is not None and log.time is not None and log.time[-1] > log.time[0]:
        stamps, first = np.unique(log.time, return_index=True)
        rate = (
            np.interp(log.time, stamps, np.gradient(log.temperature[first], stamps))
            if len(stamps) > 1
            else 0 * log.time
        )
        yield "lag", course.along(course.named.k_T * rate * turning, *beside), SHARE * float(np.ptp(log.time))
    yield "gain", course.forced, trial.bench.narrow.get("gain", SHARE)
    error = log.bench.get("temperature_std_degC", 0.0)
    if trial.resonant and error:  # the last, as `model.likelihood` has its prior
        yield "thermometer", course.changed(2j * np.pi * course.named.k_T * held, *beside), error
