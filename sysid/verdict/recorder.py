"""What a recorder did to a log, as its rows show: clipped, touched, rounded, of more than one range."""

from collections.abc import Sequence

import numpy as np

from sysid.rows.hold import FULL_TOUCH, force_of
from sysid.trials.trial import Trial
from sysid.verdict.identify import FINER

NEAR_FULL = 0.1  # of a full contact, from 1.0 to 2.5 N
LEAST_ROWS = 40  # among which a range that was changed stands out
LEVELLED = 0.5  # of a recorder's step, below which its noise leaves a plateau on one level
BESIDE = 3  # rows on each side, by which it is judged what a response does anyway
# of a power of ten, by which rows beside a jump may leave it uncertain: three of these are half of one
MOST_BLURRED = 0.15
AROUND = 4  # rows on each side of it, with two second differences, whose inputs do not change
ASKEW = 0.5  # rad, by which the phase may turn at a range that is changed: noise and bend, no change of sign
AS_IF = 0.05  # of a power of ten, by which a jump is off it: a tenth of the response
TIED = 3  # rows on the largest value where no other two rows are alike: noise makes no ties
# of the response, from which it is noise that parts rows: without, a settled response repeats itself, as it
# does at a rail
NOISY = 1e-6
CLIPPED = 0.02  # share of the rows that lie on one value, its largest or smallest, when a channel is clipped


def clipped(trial: Trial) -> str | None:
    """A sentence when rows share the largest or smallest value of a channel: many, or a few where no others
    do; else None."""
    y = trial.log.response
    channels = _channels(trial)
    if np.all(trial.noise.count > 1) or any(
        p.std < LEVELLED * s for p, s in zip(trial.noise.parts, trial.steps, strict=False)
    ):
        return None  # a mean is never clipped exactly; and a coarse plateau lies on one level, clipped or not
    names = [f" in {c}" for c in "dq"] if len(channels) > 1 else [""]
    sides = [(1, *one) for one in zip(channels, names, strict=True)]
    sides += [(-1, c, name) for _, c, name in sides if trial.signed]
    for sign, channel, name in (*sides, (1, np.abs(y), " in amplitude" if len(channels) > 1 else "")):
        rows = np.round(sign * channel / trial.scale, 9)
        values, count = np.unique(rows, return_counts=True)
        if len(values) <= 20 or values[-1] == 0 or _rough(rows[rows < values[-1]]) < NOISY:
            continue
        beyond = count[-1] > max(CLIPPED * len(channel), 4) and count[-1] > max(
            5 * np.median(count), 2 * np.max(count[-6:-1])
        )
        if beyond or (count[-1] >= TIED and np.max(count[:-1]) == 1):
            return (
                f"saturated: {count[-1]} rows lie exactly at {sign * values[-1] * trial.scale:.4g}{name};"
                f" record it again within the range"
            )
    return None


def _rough(rows: np.ndarray) -> float:
    """Standard deviation of the noise of `rows`, where most of them lie on curves: third differences have 20
    times its variance, and half of all lie within 0.67 of it."""
    return float(np.median(np.abs(np.diff(rows, 3)))) / (0.67 * 20**0.5)


def ranged(trial: Trial) -> str | None:
    """A sentence when from one row on the response is a power of ten larger, as no resonance makes it; else
    None."""
    found = _ranged_sweep(trial) if trial.steady else _ranged_transient(trial)
    if found is None:
        return None
    row, power = found
    said = f"from row {row} (counted from 0) on its response is {10.0**power:g} times as large"
    return (
        f"{said}, as by a range that was changed; scale these rows, or give the rows of each range as a log"
        f" of their own"
    )


def _ranged_sweep(trial: Trial) -> tuple[int, int] | None:
    """The first row of another range, and by which power of ten."""
    w = np.abs(trial.log.response)
    if not trial.resonant or len(w) < LEAST_ROWS or np.any(w == 0):
        return None
    drive = np.abs(trial.inputs.drive) if trial.driven else np.ones(len(w))
    steps = np.diff(np.log(w / drive)) if np.all(drive > 0) else np.zeros(len(w) - 1)
    k = int(np.argmax(np.abs(steps)))
    beside = steps[max(k - BESIDE, 0) : k + BESIDE + 1]
    jump = float(steps[k] - np.median(beside)) / np.log(10)
    if (
        round(jump) == 0
        or abs(jump - round(jump)) > AS_IF
        or np.sort(np.abs(steps))[-2] > 0.5 * abs(steps[k])
    ):
        return None
    return k + 1, round(jump)


def _ranged_transient(trial: Trial) -> tuple[int, int] | None:
    """The same of rows that follow one another in time: whatever the drive, a response goes on where it was.
    It does not where the lines through two rows before and two rows after do not meet, by far more than rows
    beside scatter and bend."""
    z = trial.log.response
    if len(z) < LEAST_ROWS or trial.whole is not None:
        return None
    k = np.arange(AROUND, len(z) - AROUND)  # the first row after
    before, after = 1.5 * z[k - 1] - 0.5 * z[k - 2], 1.5 * z[k] - 0.5 * z[k + 1]
    rough = np.abs(np.diff(z, 2))  # of rows j to j + 2, at j
    near = np.arange(AROUND - 2)
    error = [np.max(rough[k[:, None] + first], axis=1) for first in (near - AROUND, near)]
    around = k[:, None] + np.arange(-AROUND, AROUND)
    held = (np.ptp(trial.inputs.interval[around], axis=1) == 0) & np.all(trial.there[around], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.log10(np.abs(after / before))
        beyond = np.abs(np.log10(np.abs(z[k + 1] / z[k - 2])))
        blur = (error[0] / np.abs(before) + error[1] / np.abs(after)) / np.log(10)
        steady = np.abs(np.angle(after / before)) < ASKEW
        found = (
            held
            & steady
            & (beyond > 0.5)
            & (blur < MOST_BLURRED)
            & (np.abs(power - np.rint(power)) < AS_IF + blur)
        )
    found &= np.rint(power) != 0
    rows = np.flatnonzero(found)
    if len(rows) == 0:
        return None
    best = rows[np.argmin(blur[rows])]
    return int(k[best]), round(float(power[best]))


def _channels(trial: Trial) -> list[np.ndarray]:
    y = trial.log.response
    return [y.real] if trial.log.amplitude_only else [y.real, y.imag]


def coarse(trial: Trial) -> str | None:
    """A sentence when a channel is recorded in steps so large beside its noise that rows share their
    rounding; else None."""
    if trial.noise.rounded is None:
        return None
    unit, parts = trial.log.response_unit, trial.noise.parts
    each = [f"{step:.2g} {unit}" for step in trial.steps]
    steps = (
        each[0]
        if len(set(each)) == 1
        else " and ".join(f"{x} in {c}" for x, c in zip(each, "dq", strict=True))
    )
    own = [p.own[p.used] for p in parts if p.own is not None]
    return (
        f"recorded in steps of {steps}, larger than its noise: rows of one value share one rounding error,"
        f" of up to half a step,"
        f" so that its {sum(map(len, own))} readings tell as much as {sum(map(np.sum, own)):.0f}, as its"
        f" intervals say; {FINER}"
    )


def touched(trial: Trial) -> str | None:
    """A sentence when a force is recorded that is the same throughout all logs, so that what it does is not
    known; else None."""
    if not trial.touched:
        return None
    return (
        f"a force of {np.max(np.abs(trial.log.force)):.2g} N is recorded, and none without it: a finger"
        f" lowers G and tau by one"
        " factor, which is not known from these logs; add a log with nothing on the plate, or leave this"
        " one out"
    )


def extrapolated(trials: Sequence[Trial]) -> str | None:
    """A sentence when no log holds a force near that of which the finger's parameters are told; else None."""
    contacts = np.concatenate([t.inputs.contact for t in trials if t.touched])
    nearest = contacts[np.argmin(np.abs(contacts - 1))]
    if abs(nearest - 1) < NEAR_FULL:
        return None
    return (
        f"finger_damping and finger_detuning are those of {FULL_TOUCH} N, carried there from"
        f" {float(force_of(nearest)):.2g} N by"
        f" the law of its contact area, which these logs do not show; press with {FULL_TOUCH} N"
    )
