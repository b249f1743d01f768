"""What a recorder makes of a response: it is compressed at its largest, or lies on a sloping background."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import SEEN, About, Effect, Told, number
from sysid.trials.trial import SLOPED, Trial
from sysid.verdict.finding import Number

TAKEN = np.array([0.02, 0.07, 0.2, 0.5])  # of the largest row


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


def _sloped(trial: Trial, values: np.ndarray, about: About) -> Trial:
    place = 2 * (trial.log.frequency - np.mean(trial.log.frequency)) / np.ptp(trial.log.frequency)
    more = (values[0] + 1j * values[1]) * about.top * place
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


def _sloped_said(trial: Trial, found: dict[str, Number]) -> Told:
    d, q = found["in_phase"], found["in_quadrature"]
    change, error = 200 * float(np.hypot(d.value, q.value)), 200 * float(np.hypot(d.std, q.std))
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
    numbers=lambda trial, values, stds, about: {
        "in_phase": number(values[0], stds[0], "of the largest response"),
        "in_quadrature": number(values[1], stds[1], "of the largest response"),
    },
    said=_sloped_said,
    alike=("offset", "background", "drift", "second_mode", "duffing", "late", "early", "astray"),
)
