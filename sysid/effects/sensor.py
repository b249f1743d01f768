"""What a sensor or its recorder makes of a response: it is compressed at its largest, or lies on a background
or an offset that goes on."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import SEEN, About, Effect, Told, number
from sysid.trials.trial import SLOPED, Trial
from sysid.verdict.finding import Number

TAKEN = np.array([0.02, 0.07, 0.2, 0.5])  # of the largest row
LEAST_ROWS = 8


def _compressed(power: int, each: bool) -> Effect:
    """What a channel that saturates takes off the largest row, as a share of it; undone by y (1 + c
    (|y|/y_max)^p), in each channel by itself or by the magnitude. For a log of noise s per row the density of
    the recorded rows is that of the undone ones times the derivative of what undoes them."""

    def grown(trial: Trial, part: np.ndarray, taken: float) -> tuple[np.ndarray, np.ndarray]:
        size = (np.abs(part) / trial.scale) ** power
        return part * (1 + taken * size), 1 + (1 + power) * taken * size

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        y = trial.log.response
        whole, taken = not (each and np.iscomplexobj(y)), float(values[0])
        undone = (
            grown(trial, y, taken)[0]
            if whole
            else grown(trial, y.real, taken)[0] + 1j * grown(trial, y.imag, taken)[0]
        )
        return replace(trial, log=replace(trial.log, response=undone))

    def stretched(trial: Trial, values: np.ndarray) -> float:
        y, taken = trial.log.response[trial.noise.used], float(values[0])
        if each and np.iscomplexobj(y):
            slopes = np.concatenate([grown(trial, y.real, taken)[1], grown(trial, y.imag, taken)[1]])
        elif np.iscomplexobj(y):  # along the response and across it
            slopes = grown(trial, y, taken)[1] * (1 + taken * (np.abs(y) / trial.scale) ** power)
        else:
            slopes = grown(trial, y, taken)[1]
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
        alike=("saturation", "duffing"),
        makes_sense=lambda values, stds: bool(values[0] > SEEN * stds[0]),
    )


SATURATIONS = tuple(
    _compressed(power, each) for power in (2, 6) for each in (False, True)
)  # softly, and as a clip does


def _beside(trial: Trial, values: np.ndarray, about: About, shape: np.ndarray) -> Trial:
    """The trial with a shape (n,) in phase and in quadrature, as shares of the largest response."""
    more = (values[0] + 1j * values[1]) * about.top * shape
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


def _shares(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    names = ("in_phase", "in_quadrature")[: trial.channels]
    each = zip(names, values, stds, strict=False)
    return {name: number(value, std, "of the largest response") for name, value, std in each}


def _size(found: dict[str, Number]) -> tuple[float, float]:
    """Percent of the largest response, and the error."""
    each = np.array([(n.value, n.std) for n in found.values()])
    value, std = 100 * np.hypot.reduce(each)
    return float(value), float(std)


def _sloped(trial: Trial, values: np.ndarray, about: About) -> Trial:
    place = 2 * (trial.log.frequency - np.mean(trial.log.frequency)) / np.ptp(trial.log.frequency)
    return _beside(trial, values, about, place)


def _sloped_said(trial: Trial, found: dict[str, Number]) -> Told:
    change, error = (2 * x for x in _size(found))
    return Told(
        f"its background changes by {change:.2g} ± {error:.1g} % of the largest response from one end of its"
        " frequencies to the other",
        "of what else the drive reaches, or of an output offset that drifts; sweep back as well",
    )


# Of settled points a slope is one of the bench's columns. What is in the plate's frame is turned with it.
SLOPE = Effect(
    name="slope",
    shows=lambda trial: (
        not trial.steady
        and trial.signed
        and trial.resonant
        and trial.driven
        and "background" in trial.nuisances
        and len(np.unique(trial.log.frequency)) >= SLOPED
    ),
    stds=lambda trial, about: np.array([TAKEN[-1], TAKEN[-1]]),
    starts=lambda trial, about: np.zeros((1, 2)),  # it is linear
    applied=_sloped,
    numbers=_shares,
    said=_sloped_said,
    alike=("offset", "background", "drift", "second_mode", "duffing", "late", "early", "astray"),
)


def _creeping(trial: Trial) -> bool:
    """A transient of d and q, or of a signed output, whose offset is not known to stay."""
    log, asked = trial.log, trial.nuisances
    moving = not trial.steady and trial.signed and "offset" in asked and "baseline" not in asked
    return moving and len(log) >= LEAST_ROWS and log.time[-1] > log.time[0]


def _crept(trial: Trial, values: np.ndarray, about: About) -> Trial:
    time = trial.log.time
    return _beside(trial, values, about, (time - time[0]) / (time[-1] - time[0]))


def _crept_said(trial: Trial, found: dict[str, Number]) -> Told:
    share, error = _size(found)
    return Told(
        f"its output offset drifts by {share:.2g} ± {error:.1g} % of the largest response from the first row"
        " to the last",
        "wait until it is constant, or record a shorter log",
    )


OFFSET_DRIFT = Effect(
    name="offset_drift",
    shows=_creeping,
    stds=lambda trial, about: np.array([TAKEN[-1], TAKEN[-1]]),
    starts=lambda trial, about: np.zeros((1, 2)),  # it is linear
    applied=_crept,
    numbers=_shares,
    said=_crept_said,
    known_as=("offset",),
    alike=(
        "offset",
        "drift",
        "late",
        "early",
        "rows_lost",
        "astray",
        "saturation",
        "duffing",
        "off_resonance",
    ),
)
