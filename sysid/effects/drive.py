"""What acts on a plate when it is not in proportion to the drive that is recorded."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import SEEN, About, Effect, Told
from sysid.effects.number import Number, number
from sysid.trials.trial import Trial

POWERS = np.array([-0.9, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0])  # over the first
DEAD = np.array([0.05, 0.15, 0.3, 0.6])  # of the largest drive
LOST = np.array([0.1, 0.3, 0.5, 0.9])  # of the largest drive, above an amplifier's limit
ALIKE = (
    "drive",
    "gain",
    "saturation",
    "duffing",
    "offset",
    "late",
    "early",
    "astray",
    "drift",
    "off_resonance",
    "rows_lost",
)


def _acting(trial: Trial, share: np.ndarray, about: About) -> Trial:
    """The trial where `share` (M,) of the largest drive acts, with the sign of the recorded one."""
    drive = np.sign(trial.inputs.drive) * share * about.drive
    return replace(trial, inputs=trial.inputs._replace(drive=drive))


def _share(trial: Trial, about: About) -> np.ndarray:
    return np.abs(trial.inputs.drive) / about.drive


def _raised(trial: Trial, values: np.ndarray, about: About) -> Trial:
    share = _share(trial, about)
    power = np.maximum(share, 1e-300) ** max(1 + float(values[0]), 0.0)
    return _acting(trial, np.where(share > 0, power, 0.0), about)


def _raised_said(trial: Trial, found: dict[str, Number]) -> Told:
    power = found["power"]
    return Told(
        f"the response is not proportional to the drive: it goes with its power {power.value:.3g} ±"
        f" {power.std:.1g}",
        "record what acts (for a heater the voltage's square), or fit logs of one level",
    )


POWER = Effect(
    name="drive",
    shows=lambda trial: trial.driven,
    stds=lambda trial, about: np.array([1.0]),
    starts=lambda trial, about: POWERS[:, None],
    applied=_raised,
    numbers=lambda trial, values, stds, about: {"power": number(1 + values[0], stds[0], "1")},
    said=_raised_said,
    scope="plate",
    rough=True,
    alike=ALIKE,
)


def _dead(trial: Trial, values: np.ndarray, about: About) -> Trial:
    return _acting(trial, np.maximum(_share(trial, about) - max(float(values[0]), 0.0), 0.0), about)


def _dead_said(trial: Trial, found: dict[str, Number]) -> Told:
    dead = found["dead"]
    return Told(
        f"the response is not proportional to the drive: of that, {dead.value:.3g} ± {dead.std:.1g}"
        f" {trial.log.drive_unit} do nothing, as a dead band or friction",
        "record the drive less what is lost of it, or fit logs of one level",
    )


DEAD_BAND = Effect(
    name="drive",
    shows=lambda trial: trial.driven,
    stds=lambda trial, about: np.array([DEAD[-1]]),
    starts=lambda trial, about: DEAD[:, None],
    applied=_dead,
    numbers=lambda trial, values, stds, about: {
        "dead": number(values[0], stds[0], trial.log.drive_unit, about.drive)
    },
    said=_dead_said,
    scope="plate",
    rough=True,
    alike=ALIKE,
    makes_sense=lambda values, stds: bool(values[0] > SEEN * stds[0]),
)


def _limited(trial: Trial, values: np.ndarray, about: About) -> Trial:
    return _acting(
        trial, np.minimum(_share(trial, about), 1 - min(max(float(values[0]), 0.0), LOST[-1])), about
    )


def _limited_said(trial: Trial, found: dict[str, Number]) -> Told:
    limit = found["limit"]
    return Told(
        f"the response is not proportional to the drive: above {limit.value:.4g} ± {limit.std:.1g}"
        f" {trial.log.drive_unit} no more of it acts, as of an amplifier at its limit",
        "record what the amplifier gives, or leave the larger levels out",
    )


LIMIT = Effect(
    name="drive",
    shows=lambda trial: trial.driven,
    stds=lambda trial, about: np.array([LOST[-1]]),
    starts=lambda trial, about: LOST[:-1, None],
    applied=_limited,
    numbers=lambda trial, values, stds, about: {
        "limit": number(1 - values[0], stds[0], trial.log.drive_unit, about.drive)
    },
    said=_limited_said,
    scope="plate",
    rough=True,
    alike=ALIKE,
    makes_sense=lambda values, stds: bool(values[0] > SEEN * stds[0]),
)
