"""A log in words: what it was taken for, and what of it is odd enough to be said."""

from collections.abc import Sequence

import numpy as np

from sysid.logs.log import Log
from sysid.rows.hold import FULL_TOUCH, force_of
from sysid.rows.prepare import OFFSET_UNITS
from sysid.trials.trial import LEAST_WARMING, Trial
from sysid.trials.whitening import Noise
from sysid.verdict.identify import FINER, seconds

NEAR_FULL = 0.1  # of a full contact, from 1.0 to 2.5 N
MOST_TAKEN = 0.5  # of a log's information, from which its phase noise is worth a warning
# share of the noise that goes with the response, beside which the rest is not worth a word
NEARLY_ALL = 0.99999
NAMED = 8  # rows that were spoilt
GROWS = 2.0  # times its beginning, which a plate that rings freely never is
LEAST_ROWS = 40  # among which a range that was changed stands out
FAINT = 0.3  # of a correlation with the row before, below which it is not known to be there
LEVELLED = 0.5  # of a recorder's step, below which its noise leaves a plateau on one level
MOSTLY = 1.5  # times an error, by which more than half of the variance is that of something else
HANGS = 0.5  # of the standard deviation of k_T, by which an error matters that is not in it
BESIDE = 3  # rows on each side, by which it is judged what a response does anyway
# of a power of ten, by which rows beside a jump may leave it uncertain: three of these are half of one
MOST_BLURRED = 0.15
AROUND = 4  # rows on each side of it, with two second differences, whose inputs do not change
ASKEW = 0.5  # rad, by which the phase may turn at a range that is changed: noise and bend, no change of sign
AS_IF = 0.05  # of a power of ten, by which a jump is off it: a tenth of the response
TIED = 3  # rows on the largest value where no other two rows are alike: noise makes no ties
NOISY = 1e-6  # of the response, from which it is noise that parts rows, not a settling response
CLIPPED = 0.02  # share of the rows that lie on one value, its largest or smallest, when a channel is clipped


def assumptions(trial: Trial) -> list[str]:
    """What had to be taken for granted to read a log at all, and what of it could not be read."""
    log, found = trial.log, []
    if trial.dark:
        gone = (
            f"{trial.dark} of {len(trial.whole or log)} rows read exactly zero, or what the row before them"
            f" reads"
        )
        found.append(f"{gone}, amid a response that moves: the signal was lost; they are left out")
    if trial.spoilt:
        found.append(_spoilt(trial))
    if not trial.steady and (shared := stamps_shared(trial)):
        found.append(
            f"{shared} of {len(trial.whole or log)} rows have the time stamp of the row before, and are"
            f" taken as rows of one"
            " moment; record the time with more digits"
        )
    if trial.from_rest and log.response_unit not in OFFSET_UNITS:
        rest = "taken as at rest, with no output offset, before its first row"
        alone = (
            "taken as at rest before its first row, which alone tells an output offset from G: record rows"
            " before the step"
        )
        found.append(f"no row shows the response without drive; {rest if trial.resonant else alone}")
    elif trial.from_rest:
        found.append("taken as settled, with the drive at zero, before its first row")
    if not trial.signed and trial.driven:
        other = "the resonance" if trial.resonant else "a late trigger and the gain"
        found.append(
            f"amplitude only: a feedthrough of the drive cannot be told from {other} and is taken as zero"
        )
    if not trial.driven and not trial.steady and _grows(np.abs(log.response)):
        drive = "no drive is recorded" if log.drive is None else "the drive is zero in every row"
        found.append(
            f"{drive}, and the response grows: taken as a free ring-down, which cannot grow; add a"
            f" voltage_* or drive_* column,"
            " with the step"
        )
    if trial.rectified:
        found.append(
            "its rows at rest are of noise without a sign: taken as an amplitude, with no output offset"
        )
    if not trial.resonant and not trial.steady:
        found.append("no frequency is recorded; taken as driven at resonance (first-order model)")
    return found


def _spoilt(trial: Trial) -> str:
    """Which rows were, by number as far as these are few."""
    rows, many = [str(row) for row in trial.spoilt[:NAMED]], len(trial.spoilt) > 1
    named = ", ".join(rows) + (
        f" and {len(trial.spoilt) - NAMED} others" if len(trial.spoilt) > NAMED else ""
    )
    off = (
        f"far off what the rows beside {'them' if many else 'it'} say, by more than anything else in the log"
    )
    return (
        f"row{'s' if many else ''} {named} (counted from 0): {off}; left out, as a recorder's or a sensor's"
        f" fault"
    )


def _grows(size: np.ndarray) -> bool:
    """Whether a response is larger at its end than at its beginning."""
    part = max(len(size) // 10, 1)
    return bool(np.mean(size[-part:]) > GROWS * np.mean(size[:part]))


def rounded_stamps(time: np.ndarray, digit: float) -> str:
    """That an even clock's stamps were rounded, and which clock it is taken to be."""
    period = float(np.mean(np.diff(time)))
    return (
        f"its time stamps are whole multiples of {seconds(digit)}; taken as those of an even clock of"
        f" {seconds(period)}"
    )


def stamps_shared(trial: Trial) -> int:
    """How many rows have the time stamp of the row before, those that are left out aside."""
    time = trial.log.time if trial.whole is None else trial.whole.time
    if time is None:
        return 0
    time = time[trial.there] if trial.whole is None else time
    return int(np.count_nonzero(time[1:] == time[:-1]))


SAY_SO = "say so by a mapping file (--columns) of the line phase_sign = -1"


UNSAID = (
    "whether a row's response belongs to its own inputs is not stated and matters here; taken as sampling:"
)
OFTEN = 0.1  # changes a row, from which on a transient's `sampling` matters however late its response may be


def sampled(trial: Trial, stated: str | None) -> str | None:
    """A sentence on which inputs the rows were taken to belong to, where that is not `stated` and was told
    from the log alone; else None."""
    if stated is not None or trial.log.time is None:
        return None
    if trial.steady:
        return f"{UNSAID} settled, as at a long dwell they mostly do" if trial.log.kind is None else None
    return (
        f"{UNSAID} settled, as rows of the same inputs then agree"
        if trial.log.sampling == "settled"
        else None
    )


def owned(reading: str | None) -> str:
    """A sentence on the reading that the logs show, or that they do not tell which it is."""
    if reading is not None:
        return f"{UNSAID} {reading}, as the logs show; say sampling: settled or sampling: instant"
    return (
        "whether a row's response belongs to its own inputs, or to those of the row before, is not stated,"
        " and the logs do not"
        " tell: read half way, and the errors include both; say sampling: settled or instant, or sweep back"
        " as well"
    )


def hangs_on_lateness(error: float) -> str:
    """For a G whose relative `error` is that of not knowing how late the response is."""
    return (
        f"G is known only to {100 * error:.2g} %, because a feedthrough, a trigger late by a row and a gain"
        f" look alike in a step;"
        " record a sweep beside it, or state delay_s (0 if nothing is late)"
    )


def of_thermometers(
    unstated: Sequence[Log], k_T: float, without: np.ndarray, errors: np.ndarray
) -> list[str]:
    """Sentences where the `errors` of theta are mostly those of the thermometers, of which nothing but the
    readings is known, as errors `without` them are smaller; and where k_T hangs on one that is not the same
    in all of a log."""
    wide = [name for k, name in ((2, "f0"), (3, "k_T")) if errors[k] > MOSTLY * without[k] > 0]
    off = {log.name: log.bench.get("temperature_std_degC", 0.0) for log in unstated}
    warmed = {log.name: np.ptp(log.temperature) for log in unstated if log.temperature is not None}
    found = [
        f"{name}: its thermometer may be {off[name]:.2g} degC off in a part of the rows, which moves k_T by"
        f" {abs(k_T) * off[name] / warming / errors[3]:.2g} of its standard deviations, which its error"
        f" does not include; read it"
        " in finer steps"
        for name, warming in warmed.items()
        if warming > LEAST_WARMING and abs(k_T) * off[name] > HANGS * errors[3] * warming
    ]
    if wide and any(off.values()):
        found.append(
            f"the error of {' and of '.join(wide)} is mostly that of the thermometer, up to"
            f" {max(off.values()):.2g} degC as"
            " its readings are written and flicker; state temperature_std_degC where it is known better, or"
            " record temperatures"
            " farther apart"
        )
    return found + _of_set_points(unstated, abs(k_T), errors[2])


def _of_set_points(unstated: Sequence[Log], k_T: float, error: float) -> list[str]:
    """A sentence on temperatures that `rows.thermometer` took for exact, where they would decide f0 if they
    had been read."""
    exact = [
        (log.temperature, log.temperature_digit)
        for log in unstated
        if log.bench.get("temperature_std_degC") == 0
    ]
    kept = [(float(t[0]), digit) for t, digit in exact if t is not None and np.ptp(t) == 0]
    digit = max((digit for _, digit in kept), default=0.0)
    if len(dict(kept)) < 2 or k_T * digit < error * np.sqrt(12):
        return []
    return [
        f"whole degrees are taken for set points that were kept exactly; as readings to {digit:g} degC they"
        f" would leave f0"
        f" uncertain by {k_T * digit / np.sqrt(12):.2g} Hz: state temperature_std_degC"
    ]


def describe(trial: Trial) -> str:
    """What a log was taken for, in a few words."""
    log = trial.log
    shape = "settled points" if trial.steady else "transient"
    if log.frequency is not None and np.ptp(log.frequency) > 0:
        shape += f", {log.frequency.min():.6g} to {log.frequency.max():.6g} Hz"
    elif not trial.steady and not trial.driven:
        shape += ", undriven"
    elif not trial.steady:
        changes = np.count_nonzero(np.diff(trial.inputs.drive))
        shape += (
            f", drive changes {'once' if changes == 1 else f'{changes} times'}" if changes else ", one level"
        )
    shape += f", a finger of up to {np.max(np.abs(log.force)):.2g} N" if trial.touched else ""
    shape += (
        ", amplitude only"
        if log.amplitude_only and trial.resonant
        else ""
        if trial.resonant
        else ", at resonance"
    )
    return shape if log.temperature is None else f"{shape}, {log.temperature.mean():.1f} degC"


def noise(trial: Trial) -> str:
    """What the noise of a log was taken for, in a few words."""
    unit, known = trial.log.response_unit, trial.noise
    colours = [_colour(trial, p) for p in known.parts]
    said = colours[0]
    if len(colours) == 2:
        apart = [f"{p.std:.3g} {unit} in {channel}" for p, channel in zip(known.parts, "dq", strict=True)]
        if colours[0] == colours[1]:
            said = f"{', '.join(apart)}, {colours[0]}"
        else:
            said = ", ".join(f"{level}, {colour}" for level, colour in zip(apart, colours, strict=True))
    if known.share:
        largest = f"{100 * known.std * np.sqrt(known.share) / trial.scale:.2g} % of the response"
        least = f" and {known.std * np.sqrt(1 - known.share):.2g} {unit}" if known.share < NEARLY_ALL else ""
        said = f"{said}, {largest}{least}"
    if known.scatter:
        said = f"{said}, in time stamps that scatter by {seconds(known.scatter * known.std)}"
    if known.jitter is not None:
        said = (
            f"{said}, of which the phase's is {known.jitter.std:.2g} rad, correlated over"
            f" {_time(trial, known.jitter.time)}"
        )
    if outliers := known.left_out - trial.lost:
        return f"{said}, {outliers} outliers left out"
    said = said if known.rounded is None else f"{said} but for its rounding"
    return said if known.tail is None else f"{said}, with outliers"


def _time(trial: Trial, time: float) -> str:
    """A correlation time in words."""
    return f"{time:.2g} rows" if trial.log.time is None else seconds(time)


def turned(trial: Trial) -> str | None:
    """A sentence when the noise of a log's phase takes most of what it tells; else None."""
    jitter = trial.noise.jitter
    if jitter is None or jitter.left > MOST_TAKEN:
        return None
    over = _time(trial, jitter.time)
    return (
        f"phase noise of {jitter.std:.2g} rad that is correlated over {over} makes errors"
        f" {jitter.left**-0.5:.2g} times as large;"
        " lock drive and demodulator to one clock, or record the average of several logs"
    )


def _colour(trial: Trial, part: Noise) -> str:
    if part.time == 0:
        return "white"
    if np.median(part.memory()[1:]) < FAINT:
        return "white, as far as so few rows tell"
    over = _time(trial, part.time)
    return (
        f"correlated over"
        f" {over}{'' if trial.signed else ', of Wd and Wq alike (for an amplitude an approximation)'}"
    )


def clipped(trial: Trial) -> str | None:
    """A sentence when rows share the largest or smallest value of a channel: many, or a few where no others
    do; else None."""
    y = trial.log.response
    channels = _channels(trial)
    if np.all(trial.noise.count > 1) or any(
        p.std < LEVELLED * s for p, s in zip(trial.noise.parts, trial.steps, strict=False)
    ):
        return None  # a mean is never clipped exactly; and a coarse plateau lies on one level, clipped or not
    for channel in (*channels, *(-c for c in channels if trial.signed), np.abs(y)):
        values, count = np.unique(np.round(channel / trial.scale, 9), return_counts=True)
        if len(values) <= 20 or values[-1] == 0:
            continue
        beyond = count[-1] > max(CLIPPED * len(channel), 4) and count[-1] > max(
            5 * np.median(count), 2 * np.max(count[-6:-1])
        )
        tied = count[-1] >= TIED and np.max(count[:-1]) == 1 and trial.noise.std > NOISY * trial.scale
        if beyond or tied:
            return (
                f"saturated: {count[-1]} rows lie exactly at {values[-1] * trial.scale:.4g}; record it"
                f" again within the range"
            )
    return None


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
