"""What acts on a plate when it is not in proportion to the drive that is recorded, or not at once."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from sysid.effects.effect import (
    LEAST_ROWS,
    SEEN,
    SWEEP,
    About,
    Effect,
    Fitted,
    Told,
    always,
    fixed,
    nowhere,
    positive,
)
from sysid.effects.number import Number, number, pm
from sysid.model.theta import NAMES
from sysid.rows.hold import cut
from sysid.trials.trial import Trial

POWERS = np.array([-0.9, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0])  # over the first
DEAD = np.array([0.05, 0.15, 0.3, 0.6])  # of the largest drive
LOST = np.array([0.1, 0.3, 0.5])  # of the largest drive, above an amplifier's limit
BENT = np.array([-0.3, -0.1, 0.1, 0.3])  # of the largest drive, as a sine or an amplifier bends it
LEAST_LIMIT = 0.1  # of the largest drive
OVER = 0.3  # of a change of the drive, by which an amplifier usually overshoots it at the most
SETTLES = np.log([0.1, 0.3, 1.0, 3.0, 10.0])  # of the times, over tau, within which it may settle
LONG = np.log(30.0)  # of a supply that sags: as long as a log of a step that is recorded until it has settled
STEPS = 16  # of the drive: of more it is no record of steps

# What acts, as a share of the largest drive, by the share that is recorded and the law's number.
Law = Callable[[np.ndarray, float], np.ndarray]


def _drive(
    law: Law,
    starts: np.ndarray,
    numbers: Callable[[Trial, float, float, About], tuple[str, Number]],
    said: Callable[[str, Number], Told],
    only_more: bool = True,
) -> Effect:
    """A law of one number, at zero of which all that is recorded acts; `only_more`: less than zero makes no
    sense."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        share = law(np.abs(trial.inputs.drive) / about.drive, float(values[0]))
        drive = np.sign(trial.inputs.drive) * share * about.drive
        return replace(trial, inputs=trial.inputs._replace(drive=drive))

    return Effect(
        name="drive",
        shows=lambda trial: trial.driven,
        stds=fixed(starts[-1:]),
        starts=fixed(starts[:, None]),
        applied=applied,
        numbers=lambda trial, values, stds, about: dict([numbers(trial, values[0], stds[0], about)]),
        said=lambda trial, found: said(trial.log.drive_unit, next(iter(found.values()))),
        scope="plate",
        rough=always,
        makes_sense=positive if only_more else None,
    )


def _raised(share: np.ndarray, more: float) -> np.ndarray:
    power = np.maximum(share, 1e-300) ** max(1 + more, 0.0)
    return np.where(share > 0, power, 0.0)


POWER = _drive(
    _raised,
    POWERS,
    lambda trial, more, std, about: ("power", number(1 + more, std, "1")),
    lambda unit, power: Told(
        f"the response is not proportional to the drive: it goes with its power {power:.3g}",
        "record what acts (for a heater the voltage's square), or fit logs of one level",
    ),
    only_more=False,
)
DEAD_BAND = _drive(
    lambda share, dead: np.maximum(share - max(dead, 0.0), 0.0),
    DEAD,
    lambda trial, dead, std, about: ("dead", number(dead, std, trial.log.drive_unit, about.drive)),
    lambda unit, dead: Told(
        f"the response is not proportional to the drive: of that, {dead:.3g}"
        f" {unit} do nothing, as a dead band or friction",
        "record the drive less what is lost of it, or fit logs of one level",
    ),
)
LIMIT = _drive(
    lambda share, lost: np.minimum(share, max(1 - max(lost, 0.0), LEAST_LIMIT)),
    LOST,
    lambda trial, lost, std, about: ("limit", number(1 - lost, std, trial.log.drive_unit, about.drive)),
    lambda unit, limit: Told(
        f"the response is not proportional to the drive: above {limit:.4g}"
        f" {unit} no more of it acts, as of an amplifier at its limit",
        "record what the amplifier gives, or leave the larger levels out",
    ),
)
COMPRESSED = _drive(
    lambda share, more: share * (1 + more * share**2),
    BENT,
    lambda trial, more, std, about: ("more", number(more, std, "of the largest drive")),
    lambda unit, more: Told(
        f"the response is not proportional to the drive, by {more:+.2g%}"
        " at its largest: an amplifier that bends, or a duty ratio whose voltage is not stated",
        "state the voltage itself",
    ),
    only_more=False,
)


def _steps(trial: Trial) -> bool:
    """A transient at a recorded frequency, whose drive is changed a few times."""
    still = not trial.steady and trial.resonant and trial.driven and trial.log.theta is None
    changed = np.count_nonzero(_changes(trial, trial.inputs.drive))
    return still and bool(0 < changed <= STEPS) and len(trial.log) >= LEAST_ROWS


def _changes(trial: Trial, drive: np.ndarray) -> np.ndarray:
    """(M,) by how much the drive changes as each interval begins: a log that begins settled was driven
    before."""
    return np.diff(drive, prepend=drive[0] if trial.begun else 0.0)


def _overshot(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """The trial whose drive is higher, behind each of its changes, by a share of it that decays: over each
    interval by its mean."""
    hold, _ = cut(trial.inputs)
    time = about.tau * float(np.exp(values[1]))
    begins = np.append(0.0, np.cumsum(hold.duration))
    changes = _changes(trial, hold.drive)
    those = np.flatnonzero(changes)
    since = np.maximum(begins[:, None] - begins[those], 0.0)
    passed = time * -np.expm1(-since / time) @ changes[those]  # the integral of what decays
    lasts = np.where(hold.duration > 0, hold.duration, 1.0)
    return replace(trial, inputs=hold._replace(drive=hold.drive + values[0] * np.diff(passed) / lasts))


def _overshot_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time = about.tau * float(np.exp(values[1]))
    return {
        "over": number(values[0], stds[0], "of each change"),
        "time_s": number(time, time * stds[1], "s"),
    }


def _overshot_said(trial: Trial, found: dict[str, Number]) -> Told:
    over, time = found["over"], found["time_s"]
    return Told(
        f"its drive overshoots by {over:.2g%} of each change, and settles"
        f" within about {time.value:.2g} s; G is by what it settles to, taken for the drive that is recorded:"
        f" if it sags from that, G is {100 * over.value:.2g} % more",
        "record the drive as the plate gets it, or wait with the response until the drive has settled",
    )


def _overshoots(trial: Trial, fitted: Fitted) -> bool:
    """Whether share times time, which is what the plate gets too much, is seen, and more than zero: the
    longer it takes, the less it is."""
    share, along = float(fitted.values[0]), np.array([1.0, fitted.values[0]])
    return bool(share > SEEN * np.sqrt(along @ fitted.covariance @ along))


def _either_level(trial: Trial, values: np.ndarray) -> np.ndarray:
    """What is recorded may be what the drive settles to or, of a supply that sags, what it begins at, with
    even odds: about the first the second moment of log G is log(1 + over)^2/2."""
    return np.eye(1, len(NAMES))[0] * np.log1p(max(float(values[0]), 0.0)) / np.sqrt(2)


DRIVE_OVERSHOOT = Effect(
    name="drive_overshoot",
    shows=_steps,
    stds=fixed(np.array([OVER, SETTLES[-1]])),
    starts=fixed([*product((0.1, OVER), SETTLES), (0.1, LONG)]),
    applied=_overshot,
    numbers=_overshot_numbers,
    said=_overshot_said,
    scope="bench",
    places=fixed(np.array([[0.0, ratio] for ratio in SETTLES])),
    shown_by=lambda trial, about: SWEEP if _steps(trial) else "",
    leaves=_either_level,
    makes_sense=_overshoots,
)


def _sagged(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """The same of a drive that begins as it is recorded, and is lower once it has settled."""
    over = _overshot(trial, values, about)
    level = 1 / (1 + max(float(values[0]), 0.0))
    return replace(over, inputs=over.inputs._replace(drive=level * over.inputs.drive))


def _sagged_said(trial: Trial, found: dict[str, Number]) -> Told:
    over, time = found["over"], found["time_s"]
    return Told(
        f"its drive sags from what is recorded by {100 * over.value / (1 + over.value):.2g} ±"
        f" {pm(100 * over.std)} % of each change, within about {time.value:.2g} s",
        "record the drive as the plate gets it, or wait with the response until the drive has settled",
    )


# Which of the two levels is recorded only other logs tell.
DRIVE_SAG = replace(
    DRIVE_OVERSHOOT,
    applied=_sagged,
    said=_sagged_said,
    relative=True,
    places=nowhere,
    known_as=("drive_overshoot",),
    shown_by=lambda trial, about: "",
    leaves=lambda trial, values: np.zeros(len(NAMES)),
)
