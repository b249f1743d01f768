"""What a sensor or its recorder makes of a response: it compresses it, mirrors a part of it, or forgets what
stays."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sysid.effects.effect import LEAST_ROWS, About, Effect, Told, lasted, positive, shares, size, undone
from sysid.effects.number import Number, number
from sysid.logs.log import Log
from sysid.trials.trial import Trial

FORGOTTEN = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0])  # time constants of a high-pass in a log
TAKEN = np.array([0.02, 0.07, 0.2, 0.5])  # of the largest row


# Of a log, magnitudes as recorded and what is taken: by what they grow when it is undone, and its slope.
Law = Callable[[Trial, np.ndarray, float], tuple[np.ndarray, np.ndarray]]


def _compressed(power: int) -> Law:
    """y (1 + c (|y|/y_max)^p), c of which is what is taken off the largest row over what is left of it."""

    def undone(trial: Trial, size: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
        share = (size / trial.scale) ** power
        return 1 + taken * share, 1 + (1 + power) * taken * share

    return undone


def _clipped(trial: Trial, size: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
    """A sensor whose range C ends below the peaks of its carrier: of A sin(x) it shows the fundamental
    y = (2/pi) (A asin(C/A) + C sqrt(1 - C^2/A^2)) (Gelb & Vander Velde, Multiple-Input Describing Functions,
    1968, 2.3)."""
    over = np.geomspace(1.0, 100.0, 1000)  # A/C
    seen = 2 / np.pi * (over * np.arcsin(1 / over) + np.sqrt(1 - over**-2.0))
    slope = 2 / np.pi * (np.arcsin(1 / over) - np.sqrt(1 - over**-2.0) / over)
    share = 1 / (1 + max(taken, 0.0))
    top = float(np.interp(-share, -seen / over, over))
    relative = size / trial.scale * share * top
    beyond = relative > 1
    whole = np.where(beyond, np.interp(relative, seen, over), relative)
    steeper = np.where(beyond, 1 / np.interp(whole, over, np.maximum(slope, 1e-3)), 1.0)
    return whole / np.maximum(relative, 1e-300), steeper


def _saturated(law: Law, each: bool) -> Effect:
    """What a channel that saturates takes off the largest row, as a share of what is left of it; undone in
    each channel by itself or by the magnitude. For a log of noise s per row the density of the recorded rows
    is that of the undone ones times the derivative of what undoes them."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        y, taken = trial.log.response, float(values[0])
        if each and np.iscomplexobj(y):
            undone = (
                y.real * law(trial, np.abs(y.real), taken)[0]
                + 1j * y.imag * law(trial, np.abs(y.imag), taken)[0]
            )
        else:
            undone = y * law(trial, np.abs(y), taken)[0]
        return replace(trial, log=replace(trial.log, response=undone))

    def stretched(trial: Trial, values: np.ndarray) -> float:
        y, taken = trial.log.response[trial.noise.used], float(values[0])
        if each and np.iscomplexobj(y):
            slopes = np.concatenate([law(trial, np.abs(part), taken)[1] for part in (y.real, y.imag)])
        else:  # along the response and, where it is complex, across it
            grown, slopes = law(trial, np.abs(y), taken)
            slopes = slopes * grown if np.iscomplexobj(y) else slopes
        return float(np.sum(np.log(np.maximum(slopes, 1e-300))))

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        taken, what = found["taken"], "each channel" if each else "the response"
        return Told(
            f"{what} is compressed at its largest, by {100 * taken.value:.2g} ± {100 * taken.std:.1g} %:"
            f" saturated",
            "record it again within the range",
        )

    def shows(trial: Trial) -> bool:
        return (trial.driven or trial.steady) and (np.iscomplexobj(trial.log.response) or not each)

    return Effect(
        name="saturation",
        shows=shows,
        stds=lambda trial, about: np.array([TAKEN[-1]]),
        starts=lambda trial, about: TAKEN[:, None],
        applied=applied,
        rough=True,
        stretched=stretched,
        numbers=lambda trial, values, stds, about: {
            "taken": number(values[0], stds[0], "of the largest row")
        },
        said=said,
        makes_sense=positive,
    )


# softly, and as a clip does, of d and q or of the carrier
SATURATIONS = (
    *(_saturated(_compressed(power), each) for power in (2, 6) for each in (False, True)),
    _saturated(_clipped, False),
)


def _mirrored(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """W of y = W + c conj W, what channels show whose gains, or angles, are not alike."""
    c = values[0] + 1j * values[1]
    return undone(trial, lambda log: (log.response - c * np.conj(log.response)) / (1 - abs(c) ** 2))


def _mirrored_said(trial: Trial, found: dict[str, Number]) -> Told:
    share, error = size(found)
    return Told(
        f"d and q are not alike: {share:.2g} ± {error:.1g} % of the response is mirrored, as by channels"
        " whose gains differ by twice as much or that are not at right angles",
        "calibrate the channels against each other",
    )


IMAGE = Effect(
    name="image",
    shows=lambda trial: np.iscomplexobj(trial.log.response),
    stds=lambda trial, about: np.array([TAKEN[1], TAKEN[1]]),
    starts=lambda trial, about: np.zeros((1, 2)),  # it is linear
    applied=_mirrored,
    numbers=shares,
    said=_mirrored_said,
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
        f"what stays dies away behind its sensor, within {time.value:.3g} ± {time.std:.1g} s, as behind a"
        " high-pass (AC coupling)",
        "couple the sensor to DC",
    )


def _coupled_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time = lasted(trial) / max(float(values[0]), 1e-300)
    return {"time_s": number(time, time * stds[0] / max(float(values[0]), 1e-300), "s")}


AC_COUPLING = Effect(
    name="ac_coupling",
    shows=lambda trial: (
        not trial.steady
        and trial.signed
        and trial.driven
        and len(trial.log) >= LEAST_ROWS
        and lasted(trial) > 0
    ),
    stds=lambda trial, about: np.array([FORGOTTEN[-1]]),
    starts=lambda trial, about: FORGOTTEN[:, None],
    applied=_coupled,
    numbers=_coupled_numbers,
    said=_coupled_said,
    scope="bench",
    makes_sense=positive,
)
