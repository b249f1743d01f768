"""How each log is read at first, what is assumed for it, and which parameters logs read in this way could
determine."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.logs.log import Log
from sysid.minimum.guess import candidates
from sysid.model.theta import NAMES
from sysid.rows import thermometer
from sysid.rows.clock import even, even_sweep, of_one_moment
from sysid.rows.condense import taken
from sysid.rows.dwell import (
    LEFT,
    SETTLED,
    dwells,
    of_own_inputs,
    of_single_points,
    of_the_row_before,
    remembered,
)
from sysid.rows.lost import copies
from sysid.rows.onset import onset
from sysid.rows.prepare import undelayed
from sysid.trials.trial import LEAST_TOUCH, LEAST_WARMING, Trial, warmed
from sysid.verdict import wording
from sysid.verdict.identify import seconds

UPSIDE_DOWN = 0.7  # of a correlation: half of the response's power is the drive's with its sign turned


def undriven(logs: Sequence[Log]) -> tuple[Log, ...]:
    """The logs, those whose drive is zero throughout as those without a drive: nothing drives either. Settled
    points of d and q stay, as without a drive they would have a gain of their own."""
    return tuple(
        replace(log, drive=None)
        if log.drive is not None and not np.any(log.drive) and (log.kind == "transient" or log.amplitude_only)
        else log
        for log in logs
    )


def from_onsets(logs: Sequence[Log]) -> tuple[tuple[Log, ...], list[str]]:
    """The logs, those of a decay without a recorded drive from the row on where it begins, and a sentence on
    each that begins later than its first."""
    begins = [onset(log) for log in logs]
    said = [
        f"{log.name}: no drive is recorded, and it decays only from row {begin} (counted from 0) on,"
        f" {seconds(float(log.time[begin] - log.time[0]))} after the first; the rows before are left out; to"
        f" keep them, record the drive"
        for log, begin in zip(logs, begins, strict=True)
        if begin
    ]
    cut = [taken(log, np.arange(b, len(log))) if b else log for log, b in zip(logs, begins, strict=True)]
    return tuple(cut), said


def _once(logs: Sequence[Log]) -> tuple[list[Log], list[str]]:
    """The logs with each row once, and a sentence on each that had copies."""
    again = [copies(log) for log in logs]
    once = [taken(log, np.flatnonzero(~x)) if np.any(x) else log for log, x in zip(logs, again, strict=True)]
    said = [f"{log.name}: {wording.copied(x)}" for log, x in zip(logs, again, strict=True) if np.any(x)]
    return once, said


def _upright(logs: Sequence[Log]) -> tuple[list[Log], list[str]]:
    """The logs of a plant without a frequency with a response that rises with the drive, and a sentence on
    each that had the other sign: of a cooler, or a sensor the other way round."""
    falls = [_falls(log) for log in logs]
    up = [replace(log, response=-log.response) if f else log for log, f in zip(logs, falls, strict=True)]
    return up, [f"{log.name}: {wording.FALLS}" for log, f in zip(logs, falls, strict=True) if f]


def _falls(log: Log) -> bool:
    """Whether a real response follows the drive, held back by whatever time it shows most of, downwards."""
    moves = log.drive is not None and np.ptp(log.drive) > 0 and np.ptp(log.response) > 0
    if log.frequency is not None or not (log.amplitude_only and moves):
        return False
    from scipy.signal import lfilter  # takes a third of a second to load

    likes = [0.0]
    for rows in (len(log) / 2.0 ** np.arange(1, 11)).tolist():
        left = np.exp(-1 / rows)
        held, _ = lfilter([1 - left], [1, -left], log.drive, zi=[left * log.drive[0]])
        likes.append(float(np.corrcoef(held, log.response)[0, 1]) if np.ptp(held) > 0 else 0.0)
    return max(likes, key=abs) < -UPSIDE_DOWN


def trials(logs: Sequence[Log], nuisances: tuple[str, ...]) -> tuple[tuple[Trial, ...], list[str]]:
    """How each log is read at first, and sentences on what was assumed."""
    logs, again = _once(logs)
    logs, falls = _upright(logs)
    readings = thermometer.of_plates(
        [log.temperature for log in logs], [log.temperature_digit for log in logs]
    )
    recorded = [r.temperature.mean() for r in readings if r is not None]
    found, warnings = [], [*dict.fromkeys(said for log in logs for said in log.warnings), *again, *falls]
    for log, read in zip(logs, readings, strict=True):
        if read is not None:
            log = replace(
                log, temperature=read.temperature, bench={"temperature_std_degC": read.error, **log.bench}
            )
        if log.kind == "steady" or log.time is None or of_one_moment(log.time, log.response):
            clock = None
        else:
            clock = even(log.time)
        if clock:
            log = replace(log, time=clock[0])
            warnings.append(f"{log.name}: {wording.rounded_stamps(log.time, clock[1])}")
        if log.kind == "steady" and log.frequency is not None and (scale := even_sweep(log.frequency)):
            log = replace(log, frequency=scale[0])
            warnings.append(f"{log.name}: {wording.rounded_frequencies(log.frequency, scale[1])}")
        if log.kind == "steady" and remembered(log) > LEFT:
            warnings.append(f"{log.name}: {wording.unsettled(remembered(log))}")
        if (
            log.frequency is not None
            and not np.any(log.frequency)
            and (log.time is not None or log.drive is not None)
        ):
            log = replace(log, frequency=None)
            warnings.append(
                f"{log.name}: its frequency is 0 in every row, as of a source that was not read back; not"
                f" used"
            )
        if log.temperature is None and recorded and log.frequency is not None:
            mean = float(np.mean(recorded))
            log = replace(log, temperature=np.full(len(log), mean))
            warnings.append(
                f"{log.name}: no temperature is recorded; taken as {mean:.4g} degC, the mean of the other"
                f" logs"
            )
        trial = Trial.of(log, log.kind or "steady", nuisances)
        if log.kind is None or (log.kind == "transient" and log.sampling is None and dwells(log, 0.0)):
            trial = read_as(trial, log.sampling, candidates(trial)[0][0])
        if trial.start_free and not (trial.signed or trial.begun):
            trial = trial.with_bench(start=complex(np.mean(log.response[:3])))
        found.append(trial)
        warnings += [f"{log.name}: {note}" for note in wording.assumptions(trial)]
    if any(t.touched for t in found):
        unknown = [t.log.name for t in found if t.log.force is None]
        warnings += [f"{name}: no force is recorded; taken as with nothing on the plate" for name in unknown]
    return tuple(found), warnings


def reference(trials: Sequence[Trial]) -> tuple[float, float]:
    """Frequency (Hz) and temperature (degC) from which offsets are taken; NaN frequency where none is
    recorded."""
    frequencies = [np.median(t.log.frequency) for t in trials if t.resonant]
    warm = [t.log.temperature.mean() for t in trials if t.log.temperature is not None]
    return (float(np.median(frequencies)) if frequencies else np.nan, float(np.mean(warm)) if warm else 0.0)


def free(trials: Sequence[Trial]) -> tuple[str, ...]:
    """The parameters that these logs could determine."""
    contact = [t.inputs.contact for t in trials]
    touched = max(c.max() for c in contact) - min(c.min() for c in contact) > LEAST_TOUCH
    possible = {
        "G": any(t.driven for t in trials),
        "tau": True,
        "f0": any(t.resonant for t in trials),
        "k_T": warmed(trials) > LEAST_WARMING,
        "finger_damping": touched,
        "finger_detuning": touched and any(t.resonant and t.touched for t in trials),
    }
    return tuple(name for name in NAMES if possible[name])


def read_as(trial: Trial, sampling: str | None, tau: float) -> Trial:
    """How a timed sweep is read where its kind or `sampling` is not stated. Its rows are settled points if
    each dwells long enough for `tau`; if its frequency also stays or returns, it is a transient, whose rows
    may belong to their own inputs."""
    log, kind = trial.whole or (undelayed(trial.log, -1.0) if trial.steady else trial.log), trial.kind
    if log.kind is None:
        dwelt = np.median(np.diff(log.time)) >= SETTLED * tau
        kind = "steady" if dwelt and remembered(log) <= LEFT else "transient"
        if dwelt and kind == "transient" and sampling is None and of_single_points(log):
            sampling = "settled"
    if sampling is None and log.kind == "transient":
        sampling = "settled" if dwells(log, tau) and of_own_inputs(log) else None
    if sampling == "instant" and kind == "steady" and log.kind is None:
        log, sampling = of_the_row_before(log) if log.sampling == "instant" else log, "settled"
    elif sampling == "instant" and log.sampling == "settled":
        sampling = "settled"  # as it has been read already
    if (kind, sampling) == (trial.kind, trial.log.sampling):
        return trial
    anew = Trial.of(replace(log, sampling=sampling), kind, trial.nuisances)
    return anew.with_bench(start=trial.bench.start)
