"""A log in words: what it was taken for, and what of it is odd enough to be said."""

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.effects.number import Number
from sysid.logs.log import Log
from sysid.model.theta import Theta
from sysid.rows.clock import of_one_moment
from sysid.rows.dwell import of_single_points
from sysid.rows.prepare import OFFSET_UNITS
from sysid.trials.trial import LEAST_WARMING, Trial
from sysid.trials.whitening import Noise
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.identify import seconds

MOST_TAKEN = 0.5  # of a log's information, from which its phase noise is worth a warning
# share of the noise that goes with the response, beside which the rest is not worth a word
NEARLY_ALL = 0.99999
NAMED = 8  # rows that were spoilt, or logs, at most
GROWS = 2.0  # times its beginning, which a plate that rings freely never is
FAINT = 0.3  # of a correlation with the row before, below which it is not known to be there
MOSTLY = 1.5  # times an error, by which more than half of the variance is that of something else
HANGS = 0.5  # of the standard deviation of k_T, by which an error matters that is not in it


TAKEN_AS_ZERO = (
    "amplitude only: a feedthrough of the drive too small to be fitted cannot be told from"  # the resonance
)


def beside_feedthroughs(warnings: Sequence[str], found: Sequence[Finding]) -> tuple[str, ...]:
    """The warnings, but for those of a feedthrough that is taken as zero in logs where one was found."""
    fitted = tuple(f"{name}: {TAKEN_AS_ZERO}" for f in found if f.key == "feedthrough" for name in f.logs)
    return tuple(said for said in warnings if not said.startswith(fitted))


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
        whole = trial.whole or log
        finer = "" if of_one_moment(whole.time, whole.response) else "; record the time with more digits"
        found.append(
            f"{shared} of {len(whole)} rows have the time stamp of the row before, and are taken as rows of"
            f" one moment{finer}"
        )
    if trial.from_rest and log.response_unit not in OFFSET_UNITS:
        rest = "taken as at rest before its first row"
        if trial.start_free:
            rest = "its first may be an offset or a plate that moves already: record rows before the step"
        elif not trial.resonant:
            rest += ", which alone tells an output offset from G: record rows before the step"
        found.append(f"no row shows the response without drive; {rest}")
    elif trial.from_rest:
        found.append("taken as settled, with the drive at zero, before its first row")
    if not trial.signed and trial.driven:
        other = "the resonance" if trial.resonant else "a late trigger and the gain"
        found.append(f"{TAKEN_AS_ZERO} {other} and is taken as zero")
    if not trial.driven and not trial.steady and _grows(np.abs(log.response)):
        found.append(
            "no drive is recorded, or only zero, and the response grows: taken as a free ring-down, which"
            " cannot grow; add a voltage_* or drive_* column, with the step"
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


def unsettled(left: float) -> str:
    """Of settled points behind a filter that still holds a share `left` of the point before."""
    return (
        f"the lock-in's filter that is stated still holds {100 * left:.2g} % of each point as the next is"
        " read: they are not settled; say kind: transient, or wait longer at each"
    )


FALLS = "its response falls where its drive rises: read with the other sign, which G is told without"


def copied(again: np.ndarray) -> str:
    """That these rows are copies."""
    share = f"{np.sum(again)} of {len(again)} rows"
    return f"{share} are the row before once more, in every column; each counts once"


def rounded_stamps(time: np.ndarray, digit: float) -> str:
    """That an even clock's stamps were rounded, and which clock it is taken to be."""
    period = float(np.mean(np.diff(time)))
    return (
        f"its time stamps are whole multiples of {seconds(digit)}; taken as those of an even clock of"
        f" {seconds(period)}"
    )


def rounded_frequencies(frequency: np.ndarray, digit: float) -> str:
    """That the frequencies of an even sweep were rounded, and which they are taken to be."""
    step = float(np.median(np.abs(np.diff(frequency))))
    return (
        f"its frequencies are whole multiples of {digit:.4g} Hz; taken as those of even steps of"
        f" {step:.4g} Hz; write them with more digits"
    )


def stamps_shared(trial: Trial) -> int:
    """How many rows have the time stamp of the row before, those that are left out aside."""
    time = trial.log.time if trial.whole is None else trial.whole.time
    if time is None:
        return 0
    time = time[trial.there] if trial.whole is None else time
    return int(np.count_nonzero(time[1:] == time[:-1]))


SAY_SO = (
    "say so by a mapping file (--columns) of the line phase_sign = -1, or for one log by `# phase_sign: -1`"
    " above its header"
)


UNSAID = (
    "whether a row's response belongs to its own inputs is not stated and matters here; taken as sampling:"
)
OFTEN = 0.1  # changes a row, from which on a transient's `sampling` matters however late its response may be


DWELT = "settled, as at a long dwell they mostly do"


def sampled(trial: Trial, stated: str | None) -> str | None:
    """A sentence on which inputs the rows were taken to belong to, where that is not `stated` and was told
    from the log alone; else None."""
    if stated is not None or trial.log.time is None:
        return None
    if trial.steady:
        return f"{UNSAID} {DWELT}" if trial.log.kind is None else None
    if trial.log.sampling != "settled":
        return None
    alike = "settled, as rows of the same inputs then agree"
    return f"{UNSAID} {DWELT if of_single_points(trial.log) else alike}"


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


def hangs_on_lateness(error: float, sweeps: Sequence[str] = ()) -> str:
    """For a G whose relative `error` is that of not knowing how late the response is, beside these `sweeps`,
    which may be late themselves."""
    percent = float(f"{100 * error:.2g}")  # as 170, not 1.7e+02
    beside = (
        f"state delay_s of {', '.join(sweeps)}" if sweeps else "record a sweep beside it, or state delay_s"
    )
    late = ", and the sweeps beside it may be late as well" if sweeps else ""
    return (
        f"G is known only to {percent:g} %, because a feedthrough, a trigger late by a row and a gain"
        f" look alike in a step{late}; {beside} (0 if nothing is late)"
    )


def contradicts(
    name: str, unit: str, found: tuple[float, float], stated: tuple[float, float], apart: float
) -> str:
    """Of a parameter that is otherwise, by so many standard deviations, than was stated beforehand."""
    logs, known = (f"{value:.7g} ± {std:.2g} {unit}" for value, std in (found, stated))
    return (
        f"{name}: the logs alone say {logs}, {apart:.2g} standard deviations from what is stated beforehand,"
        f" {known}: nothing that is stated is used; check which is wrong, and in which unit"
    )


def aliased(name: str, spacing: float, further: float, odds: float) -> str:
    """Of a log in rows so far apart that its resonance may lie `further` (Hz) than it is told."""
    away = f"{abs(further):.4g} Hz {'higher' if further > 0 else 'lower'}"
    return (
        f"{name}: in rows {seconds(spacing)} apart a resonance {away} looks the same; f0 and G are those of"
        f" the one that is nearer to the drive, likelier by {odds:.2g} to one; record a sweep across the"
        " resonance, or rows closer together"
    )


def assumed(some: Sequence[Assumed]) -> list[str]:
    """A sentence on all that logs would not show, and what would."""
    told = []
    for shown_by in dict.fromkeys(a.shown_by for a in some):
        here = [a for a in some if a.shown_by == shown_by]
        largest = {a.key: a.size for a in sorted(here, key=lambda a: abs(a.size.value))}
        names = ", ".join(f"{key.replace('_', ' ')} ({_sized(size)})" for key, size in largest.items())
        moves = {n: max(a.moves.get(n, 0.0) for a in here) for n in ("G", "tau", "f0")}
        moved = ", ".join(
            f"{n} by {x:.2g} Hz" if n == "f0" else f"{n} by {100 * x:.2g} %" for n, x in moves.items() if x
        )
        about = sorted({name for a in here for name in a.logs})
        logs = ", ".join(about) if len(about) < NAMED else f"{len(about)} logs"
        told.append(
            f"{logs}: taken as without {names}; as much would not show here, and would move {moved}; record"
            f" {shown_by}"
        )
    return told


def without_resonance(numbers: Mapping[str, Number]) -> str:
    """Of logs without one: what they are if their G and tau are told, those of a low-pass."""
    if not numbers:
        return (
            "no resonance is seen: what describes the logs best does not oscillate (Q below 1/2), as a"
            " response that falls evenly with the frequency; sweep across a resonance, and see whether the"
            " frequencies are those of the drive"
        )
    told = " and ".join(f"{name} {n.value:.4g} ± {n.std:.2g} {n.unit}" for name, n in numbers.items())
    return (
        f"no resonance is seen: a low-pass of first order describes the sweep, W = G V/(1 + j omega tau) with"
        f" {told}, which is a plant without a resonance; to design a controller for it, record a step without"
        " a frequency column, or else sweep across a resonance"
    )


def _sized(size: Number) -> str:
    """A size: a share in percent, or a number with its unit."""
    share = size.unit.startswith("of ")
    return f"{100 * abs(size.value):.2g} % {size.unit}" if share else f"{abs(size.value):.3g} {size.unit}"


def of_thermometers(unstated: Sequence[Log], k_T: float, without: Theta, errors: Theta) -> list[str]:
    """Sentences where the `errors` of theta are mostly those of the thermometers, of which nothing but the
    readings is known, as errors `without` them are smaller; and where k_T hangs on one that is not the same
    in all of a log."""
    each = {n: (getattr(errors, n), getattr(without, n)) for n in ("f0", "k_T")}
    wide = [name for name, (now, before) in each.items() if now > MOSTLY * before > 0]
    off = {log.name: log.bench.get("temperature_std_degC", 0.0) for log in unstated}
    warmed = {log.name: np.ptp(log.temperature) for log in unstated if log.temperature is not None}
    found = [
        f"{name}: its thermometer may be {off[name]:.2g} degC off in a part of the rows, which moves k_T by"
        f" {abs(k_T) * off[name] / warming / errors.k_T:.2g} of its standard deviations, which its error"
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
    """What a log was taken for, in a few words: by what was recorded, whatever an effect makes of it."""
    log = trial.recorded or trial.log
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
