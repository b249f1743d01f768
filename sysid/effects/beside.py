"""What is seen beside the plate: a feedthrough of the drive, a sloping background, a tone."""

import numpy as np

from sysid.effects.effect import (
    About,
    Effect,
    Told,
    beside,
    driven_for_a_while,
    fixed,
    lasted,
    nowhere,
    oscillating,
    shares,
    size,
)
from sysid.effects.mode import TURNS, Left
from sysid.effects.number import Number, number, pm
from sysid.trials.trial import SLOPED, Trial

# Of the largest response: a capacitance in parallel is in quadrature; its loss, and a path that is resistive,
# are in phase.
CAPACITIVE, RESISTIVE = 0.3, 0.05
WIDE = 1.5  # a ratio of frequencies, over which what is even in a velocity bends in a displacement
SLOPING = 0.5  # of the largest response
TONE_SIZE = 0.1  # of the largest response, in each part of what turns either way
ROUND, MANY = 1.0, 3.0  # turns in a log: less is a drift; of fewer a bump that other things make as well


def _fed_through(trial: Trial, values: np.ndarray, about: About) -> Trial:
    drive = trial.inputs.drive[trial.inputs.interval]
    return beside(trial, values, about, drive / np.max(np.abs(drive)))


def _fed_said(trial: Trial, found: dict[str, Number]) -> Told:
    share, error = size(found)
    return Told(
        f"under its amplitude lies a feedthrough of the drive, {share:.2g} ± {pm(error)} % of the largest"
        f" response",
        "of a capacitance in parallel, of a resonance outside of the sweep, or as a velocity or an"
        " acceleration is no displacement (state its quantity in a mapping file); record wd and wq, or both"
        " parts of the admittance",
    )


FEEDTHROUGH = Effect(
    name="feedthrough",
    shows=lambda trial: trial.driven and not trial.signed and "background" in trial.nuisances,
    shown_by=lambda trial, about: "wd and wq" if trial.driven and not trial.signed else "",
    stds=fixed([RESISTIVE, CAPACITIVE]),
    starts=lambda trial, about: np.array(
        [[s * turn.real, s * turn.imag] for s in (0.01, 0.05, 0.2, 0.6) for turn in TURNS]
    ),
    applied=_fed_through,
    numbers=lambda trial, values, stds, about: {
        name: number(value, std, "of the largest response")
        for name, value, std in zip(("in_phase", "in_quadrature"), values, stds, strict=True)
    },
    said=_fed_said,
    linear=(0, 1),
    usual=True,
)


def _crossing(order: int) -> Effect:
    """A path beside the plate that is even in a derivative of the response of this order, as crosstalk of an
    accelerometer's cable, or what the whole bench moves by: 1/f^2 in a displacement. Over a narrow sweep it
    is the background that every bench has."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        drive, f = trial.inputs.drive[trial.inputs.interval], trial.log.frequency
        shape = drive / np.max(np.abs(drive)) * (np.min(f) / f) ** order
        return beside(trial, values, about, shape)

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        share, error = size(found)
        what = "velocity" if order == 1 else "acceleration"
        return Told(
            f"beside its resonance lies what is even in the {what}, {share:.2g} ± {pm(error)} % of the"
            " largest response at its lowest frequency",
            "as crosstalk of cables, or of a bench that moves as a whole; sweep a narrower range",
        )

    return Effect(
        name="crosstalk",
        shows=lambda trial: (
            trial.steady
            and trial.signed
            and trial.resonant
            and trial.driven
            and "background" in trial.nuisances
            and np.max(trial.log.frequency) > WIDE * np.min(trial.log.frequency) > 0
        ),
        stds=fixed([1.0, 1.0]),
        starts=fixed(np.zeros((1, 2))),  # it is linear
        applied=applied,
        numbers=shares,
        said=said,
        usual=True,
        linear=(0, 1),
    )


CROSSTALK = tuple(map(_crossing, (1, 2)))


def _sloped(trial: Trial, values: np.ndarray, about: About) -> Trial:
    place = 2 * (trial.log.frequency - np.mean(trial.log.frequency)) / np.ptp(trial.log.frequency)
    return beside(trial, values, about, place)


def _sloped_said(trial: Trial, found: dict[str, Number]) -> Told:
    change, error = (2 * x for x in size(found))
    return Told(
        f"its background changes by {change:.2g} ± {pm(error)} % of the largest response from one end of its"
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
        and trial.tuned >= SLOPED
        and np.ptp(trial.log.frequency) > 0  # measured ones may be one that flickers
    ),
    stds=fixed([SLOPING, SLOPING]),
    starts=fixed(np.zeros((1, 2))),  # it is linear
    applied=_sloped,
    numbers=shares,
    said=_sloped_said,
    usual=True,
    linear=(0, 1),
)


def turning(trial: Trial, turns: float) -> np.ndarray:
    """(n, d) of unit size: what turns so many times in a log, either way; cosine and sine of a real log."""
    at = 2j * np.pi * turns * (trial.log.time - trial.log.time[0]) / lasted(trial)
    forth, back = np.exp(at), np.exp(-at)
    if trial.channels == 1:
        return np.stack([forth.real, forth.imag], axis=1)
    return np.stack([forth, 1j * forth, back, 1j * back], axis=1)


def _tones(trial: Trial, about: About) -> np.ndarray:
    left, found = Left(trial, about).rows, []
    left = left if trial.channels > 1 else left.real
    for rate in oscillating(trial.log.time, left):
        turns = rate * lasted(trial) / (2 * np.pi)
        shapes = turning(trial, turns)
        rows, target = (np.concatenate([x.real, x.imag]) for x in (shapes, left))
        found.append(np.append(turns, np.linalg.lstsq(rows, target, rcond=None)[0]))
    return np.array(found).reshape(len(found), 1 + 2 * trial.channels)


def _toned(trial: Trial, values: np.ndarray, about: About) -> Trial:
    more = about.top * turning(trial, float(values[0])) @ values[1:].astype(complex)
    return trial.with_bench(alongside=trial.bench.moves + more)


def _tone_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    per = 1 / lasted(trial)
    size, std = float(np.linalg.norm(values[1:])), float(np.max(stds[1:]))
    return {
        "tone_Hz": number(values[0], stds[0], "Hz", per),
        "size": number(size, std, "of the largest response"),
    }


def _tone_said(trial: Trial, found: dict[str, Number]) -> Told:
    hertz, share = found["tone_Hz"], found["size"]
    beside = "beside the drive's frequency" if trial.resonant else "in it"
    return Told(
        f"a tone of {hertz:.5g} Hz {beside}, of {share:.2g%} of the largest response, as of hum or of"
        " another source",
        "find what it comes from, or record longer",
    )


# What is left turns at a rate of its own, in both directions where channels pick it up by unlike shares.
TONE = Effect(
    name="tone",
    shows=driven_for_a_while,
    stds=lambda trial, about: np.array([0.5 * len(trial.log), *2 * trial.channels * [TONE_SIZE]]),
    starts=_tones,
    applied=_toned,
    numbers=_tone_numbers,
    said=_tone_said,
    linear=(1, 2, 3, 4),
    many=True,
    vague=lambda trial, values: bool(values[0] < MANY),
    places=nowhere,
    makes_sense=lambda trial, fitted: fitted.values[0] > ROUND and fitted.seen(*range(1, len(fitted.values))),
)
