"""What a sensor or its recorder makes of a response: it compresses it, mirrors a part of it, or forgets what
stays."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from sysid.effects.effect import (
    About,
    Effect,
    Told,
    always,
    at_others,
    driven_for_a_while,
    fixed,
    lasted,
    one,
    positive,
    shares,
    size,
    undone,
)
from sysid.effects.number import Number, number, pm
from sysid.logs.log import Log
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial

FORGOTTEN = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0])  # time constants of a high-pass in a log
STEEPEST = 1e-3  # of a slope: less is a sensor that shows nothing
TAKEN = np.array([0.02, 0.07, 0.2, 0.5])  # of the largest row


# Of magnitudes as recorded over the largest, and of what is taken: by what they grow when it is undone, and
# its slope.
Law = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]


def _softly(size: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
    """L atanh(|y|/L)/|y|, of a limiter L tanh(|W|/L): to first order 1 + c (|y|/y_max)^2, c of which is what
    is taken off the largest row over what is left of it."""
    share, grown = _limited()
    top = float(np.interp(1 + abs(taken), grown, share))
    x = np.minimum(size, 1.0) * top
    found = np.divide(np.arctanh(x), x, out=np.ones_like(x), where=x > 0)
    if taken < 0:  # it grows
        return 1 / found, 2 / found - 1 / (found**2 * (1 - x**2))
    return found, 1 / (1 - x**2)


@cache
def _limited() -> tuple[np.ndarray, np.ndarray]:
    """|y|/L of that limiter, and |W|/|y|."""
    share = np.linspace(0.0, 1.0, 2000)[:-1]
    return share, np.append(1.0, np.arctanh(share[1:]) / share[1:])


def _hard(size: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
    """1 + c (|y|/y_max)^6."""
    share = size**6
    return 1 + taken * share, 1 + 7 * taken * share


def _clipped(size: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
    """A sensor whose range C ends below the peaks of its carrier: of A sin(x) it shows the fundamental
    y = (2/pi) (A asin(C/A) + C sqrt(1 - C^2/A^2)) (Gelb & Vander Velde, Multiple-Input Describing Functions,
    1968, 2.3)."""
    over, seen, slope = _peaks()
    share = 1 / (1 + max(taken, 0.0))
    top = float(np.interp(-share, -seen / over, over))
    relative = size * share * top
    beyond = relative > 1
    whole = np.where(beyond, np.interp(relative, seen, over), relative)
    steeper = np.where(beyond, 1 / np.interp(whole, over, np.maximum(slope, 1e-3)), 1.0)
    return whole / np.maximum(relative, 1e-300), steeper


@cache
def _peaks() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A/C of that sensor, |y|/C, and its slope."""
    over = np.geomspace(1.0, 100.0, 1000)
    seen = 2 / np.pi * (over * np.arcsin(1 / over) + np.sqrt(1 - over**-2.0))
    return over, seen, 2 / np.pi * (np.arcsin(1 / over) - np.sqrt(1 - over**-2.0) / over)


def _saturated(law: Law, each: bool) -> Effect:
    """What a channel that saturates takes off the largest row of all logs, as a share of what is left of it;
    undone in each channel by itself or by the magnitude. The noise of the recorder comes behind it, and grows
    with the slopes; the density of the recorded rows is that of the undone ones times these."""

    def undone(y: np.ndarray, values: np.ndarray, about: About) -> tuple[np.ndarray, np.ndarray]:
        """(n,) the response before, and the slopes of a row's channels, multiplied."""
        taken = float(values[0])
        if each and np.iscomplexobj(y):
            (d, along), (q, across) = (law(np.abs(part) / about.top, taken) for part in (y.real, y.imag))
            grown, slopes = (y.real * d + 1j * y.imag * q), along * across
        else:
            by, slope = law(np.abs(y) / about.top, taken)
            grown, slopes = y * by, slope * by if np.iscomplexobj(y) else slope
        return grown, np.maximum(slopes, STEEPEST)

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        response, slopes = undone(trial.log.response, values, about)
        wider, noise = slopes ** (1 / trial.channels), trial.noise
        stated = wider if noise.stated is None else noise.stated * wider
        log = replace(trial.log, response=response)
        return replace(trial, log=log, noise=replace(noise, stated=stated))

    def stretched(trial: Trial, values: np.ndarray, about: About) -> float:
        return float(np.sum(np.log(undone(trial.log.response[trial.noise.used], values, about)[1])))

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        taken, what = found["taken"], "each channel" if each else "the response"
        return Told(
            f"{what} is compressed at its largest, by {taken:.2g%}: saturated",
            "record it again within the range",
        )

    def shows(trial: Trial) -> bool:
        return (trial.driven or trial.steady) and (np.iscomplexobj(trial.log.response) or not each)

    return Effect(
        name="saturation",
        shows=shows,
        stds=fixed(np.array([TAKEN[-1]])),
        starts=fixed(TAKEN[:, None]),
        applied=applied,
        rough=always,
        stretched=stretched,
        numbers=one("taken", "of the largest row"),
        said=said,
        makes_sense=positive,
        shown_by=at_others(shows),
        scope="bench",
    )


# softly, and as a clip does, of d and q or of the carrier
SATURATIONS = (
    *(_saturated(law, each) for law in (_softly, _hard) for each in (False, True)),
    _saturated(_clipped, False),
)


def _mirrored(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """W of y = W + c conj W, what channels show whose gains, or angles, are not alike."""
    c = values[0] + 1j * values[1]
    return undone(trial, lambda log: (log.response - c * np.conj(log.response)) / (1 - abs(c) ** 2))


def _mirrored_said(trial: Trial, found: dict[str, Number]) -> Told:
    share, error = size(found)
    return Told(
        f"d and q are not alike: {share:.2g} ± {pm(error)} % of the response is mirrored, as by channels"
        " whose gains differ by twice as much or that are not at right angles",
        "calibrate the channels against each other; which of them is right G's error leaves open",
    )


def _unlike(trial: Trial, values: np.ndarray) -> np.ndarray:
    """Of two channels whose gains are off independently, and by (1 + c)/(1 - c) unlike, the mean is off by a
    standard deviation of c as well."""
    return np.array([float(values[0]) * (name == "G") for name in NAMES])


IMAGE = Effect(
    name="image",
    shows=lambda trial: np.iscomplexobj(trial.log.response),
    stds=fixed(np.array([TAKEN[1], TAKEN[1]])),
    starts=fixed(np.zeros((1, 2))),  # it is linear
    applied=_mirrored,
    numbers=shares,
    vague=lambda trial, values: True,  # half of what anything adds to d and q
    said=_mirrored_said,
    leaves=_unlike,
    linear=(0, 1),
    scope="bench",
)


def _coupled(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """W of dy/dt = dW/dt - y/T: y and its integral over T."""
    rate = max(float(values[0]), 0.0) / lasted(trial)

    def response(log: Log) -> np.ndarray:
        steps = 0.5 * np.diff(log.time) * (log.response[1:] + log.response[:-1])
        return log.response + rate * np.append(0.0, np.cumsum(steps))

    return undone(trial, response)


def _coupled_said(trial: Trial, found: dict[str, Number]) -> Told:
    time = found["time_s"]
    return Told(
        f"what stays dies away behind its sensor, within {time:.3g} s, as behind a high-pass (AC coupling)",
        "couple the sensor to DC",
    )


def _coupled_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time = lasted(trial) / max(float(values[0]), 1e-300)
    return {"time_s": number(time, time * stds[0] / max(float(values[0]), 1e-300), "s")}


AC_COUPLING = Effect(
    name="ac_coupling",
    shows=driven_for_a_while,
    stds=fixed(np.array([FORGOTTEN[-1]])),
    starts=fixed(FORGOTTEN[:, None]),
    applied=_coupled,
    numbers=_coupled_numbers,
    said=_coupled_said,
    scope="bench",
    makes_sense=positive,
)
