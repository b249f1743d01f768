"""What these logs determine and what they do not: the limits, the reasons in words, and what to record next.

A parameter is determined when its interval is finite, comes from the data, belongs to one mode, and is narrow enough to use:

    G, tau    standard deviation below 20 % of the value
    f0        standard deviation below half of the half bandwidth 1/(2 pi tau)
    k_T       carries f0 over 10 degC with a standard deviation below one half bandwidth
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sysid.condense import OFFSET_UNITS
from sysid.guess import phase_falls
from sysid.hold import FULL_TOUCH, force_of
from sysid.trial import LEAST_WARMING, Trial

RELATIVE = 0.2
WARMING = 10.0
NEAR_FULL = 0.1  # of a full contact, from 1.1 to 2.2 N: laws that meet at 1.5 N differ by as little there
STRUCTURE = 0.02  # residual that is not noise, relative to the response: more moves G, tau or f0 out of a 1 % interval
BURIED = 0.5  # of the variance of a log's rows lies between neighbours where noise hides the rest
SIGNIFICANT = 4.0  # standard deviations of a lag-one correlation that chance makes


def limits(G: float, tau: float) -> dict[str, float]:
    """Largest standard deviation at which each parameter counts as determined."""
    half_bandwidth = 1 / (2 * np.pi * tau)
    touch = {"finger_damping": RELATIVE, "finger_detuning": 0.5 * half_bandwidth}
    return {"G": RELATIVE * G, "tau": RELATIVE * tau, "f0": 0.5 * half_bandwidth, "k_T": half_bandwidth / WARMING, **touch}


def why(name: str, trials: Sequence[Trial], tau: float, free: Sequence[str], modes: int) -> str:
    """One sentence: why `name` cannot be told from these logs, and what to record."""
    if modes > 1:
        return _why_modes(trials)
    if name in ("tau", "f0") and "k_T" in free and any(_drifts_along(t) for t in trials):
        return (
            "cannot tell, because the temperature drifted along with the frequency, which k_T and the width of the resonance"
            " explain alike; record another sweep at a temperature 10 degC away, or the same one downwards"
        )
    causes = {"G": _why_gain, "tau": _why_tau, "f0": _why_f0, "k_T": _why_drift}
    return causes.get(name, _why_finger)(trials, tau, free)


def shows_transient(trials: Sequence[Trial]) -> bool:
    """Whether a log shows part of a transient: else what a fit says of a tau that it does not determine is a guess."""
    return not _one_frequency(trials) and any(not (t.steady or _settles_between(t) or _buried(t)) for t in trials)


def _one_frequency(trials: Sequence[Trial]) -> bool:
    """All that has a frequency was recorded at the same one, settled: a level, and no transient."""
    resonant = [t for t in trials if t.resonant]
    level = all(t.steady or (t.one_level and not t.from_rest) for t in resonant)
    return bool(resonant) and level and np.ptp(np.concatenate([t.log.frequency for t in resonant])) == 0


def _buried(trial: Trial) -> bool:
    """Neighbouring rows differ about as much as any two: noise, and little else."""
    y = trial.log.response
    apart = np.mean(np.abs(np.diff(y)) ** 2) / 2
    return bool(len(y) > 8 and apart > BURIED * np.mean(np.abs(y - np.mean(y)) ** 2))


def _settles_between(trial: Trial) -> bool:
    """After every change of the inputs the first row is already where the next change, or the end, finds the response."""
    y, hold = trial.log.response, trial.inputs
    edges = np.append(np.flatnonzero(np.diff(hold.interval) > 0), len(y) - 1)
    stretches = [(a, b) for a, b in pairwise(edges) if b > a + 2]
    if not stretches or not trial.driven:
        return False
    left = [np.abs(y[a + 1] - np.mean(y[(a + b) // 2 : b + 1])) for a, b in stretches]
    moved = [np.abs(y[a] - np.mean(y[(a + b) // 2 : b + 1])) for a, b in stretches]
    return bool(np.max(moved) > 5 * trial.noise_std and np.max(left) < 0.3 * np.max(moved))


def _drifts_along(trial: Trial) -> bool:
    """A sweep whose temperature is a straight line of its frequency."""
    log = trial.log
    if not trial.resonant or log.temperature is None or np.ptp(log.frequency) == 0 or np.ptp(log.temperature) < LEAST_WARMING:
        return False
    return bool(abs(np.corrcoef(log.frequency, log.temperature)[0, 1]) > 0.9)


def _why_modes(trials: Sequence[Trial]) -> str:
    if all(t.log.amplitude_only for t in trials if t.resonant):
        return (
            "cannot tell, because the amplitude alone does not say on which side of the drive the resonance lies and two"
            " solutions fit alike; record wd and wq, or a sweep across the resonance"
        )
    return "cannot tell, because separate solutions fit these logs alike; record a sweep across the resonance and a voltage step"


def _why_gain(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if all(t.log.drive is None for t in trials):
        return "cannot tell, because no drive is recorded; add a voltage_* or drive_* column, or its value as metadata"
    if not any(t.driven for t in trials):
        return "cannot tell, because the drive is zero in every row; record a voltage step"
    if all(t.one_level for t in trials if t.driven):
        return (
            "cannot tell, because no row shows the response without drive, so that an output offset, a plate that still rings"
            f" and a gain look alike; record {seconds(tau)} before the step, with the drive at zero"
        )
    driven = [t for t in trials if t.driven]
    if all(not t.steady and t.lateness > 0.5 * RELATIVE * tau for t in driven):
        return (
            "cannot tell, because a feedthrough, a response that is late by a row and a gain look alike in a step; record a sweep"
            f" across the resonance, or rows {seconds(0.05 * tau)} apart or closer"
        )
    return "cannot tell, because noise or background hide the response to the drive; record a larger voltage step"


def _why_tau(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    moving = [t for t in trials if not t.steady]
    swept = [t for t in trials if t.steady and t.resonant and np.ptp(t.log.frequency) > 0]
    if not moving and not swept:
        return (
            "cannot tell, because settled points at one frequency hold no time constant; record a voltage step or a sweep"
            " across the resonance"
        )
    hidden = "cannot tell, because noise hides the transient; record a larger step, or the average of several"
    if _one_frequency(trials):
        return (
            "cannot tell, because one frequency at a constant drive holds no time constant; record a voltage step or a sweep"
            " across the resonance"
        )
    if moving and not swept:
        window = max(t.log.time[-1] - t.log.time[0] for t in moving)
        if window == 0:
            return "cannot tell, because all rows are of one moment; see whether the time is in the column that was taken for it"
        step = min(np.median(np.diff(t.log.time)) for t in moving if len(t.log) > 1)
        if all(_buried(t) for t in moving):
            return hidden
        if all(_settles_between(t) for t in moving):
            return (
                f"cannot tell, because rows are {seconds(step)} apart and the response settles between two of them;"
                f" record rows {seconds(step / 100)} apart or closer"
            )
        if window < 4 * tau:
            return (
                f"cannot tell, because the longest log covers {window / tau:.2g} tau; record {seconds(10 * window)} or more"
                " after a voltage step"
            )
    if swept and not moving:
        span = max(np.ptp(t.log.frequency) for t in swept)
        if all(_buried(t) or (t.noise_time > 0 and span > 3 / (np.pi * tau)) for t in swept):
            return "cannot tell, because noise hides the resonance; record it at a larger drive, or the average of several sweeps"
        return (
            f"cannot tell, because a sweep over {span:.4g} Hz does not show the width of the resonance; sweep over at least"
            f" {max(10 * span, 3 / (np.pi * tau)):.3g} Hz about the peak, with ten points or more across it"
        )
    return hidden


def _why_f0(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if "f0" not in free:
        return "cannot tell, because no frequency is recorded; add a frequency_* column, or its value as metadata"
    if all(t.log.amplitude_only for t in trials if t.resonant):
        return (
            "cannot tell, because the amplitude of a step near resonance does not depend on the detuning; record wd and wq,"
            " or a sweep across the resonance"
        )
    if _one_frequency(trials):
        return (
            "cannot tell, because at one frequency a rotation of the demodulator's phase and a resonance beside the drive look"
            " alike; record a sweep across the resonance"
        )
    return f"cannot tell to half a bandwidth; record a sweep across the resonance, {3 / (np.pi * tau):.3g} Hz wide or more"


def _why_drift(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    warm = [t.log.temperature for t in trials if t.resonant and t.log.temperature is not None]
    if "f0" not in free:
        return "cannot tell, because no frequency is recorded; add a frequency_* column, or its value as metadata"
    if not warm:
        return (
            "cannot tell, because no temperature is recorded; record sweeps at two temperatures, 10 degC apart, and fit those"
            " instead"
        )
    lowest, highest = min(w.min() for w in warm), max(w.max() for w in warm)
    if "k_T" not in free:
        return (
            f"cannot tell, because all logs are at one temperature ({(lowest + highest) / 2:.1f} degC); record a sweep"
            " 10 degC away from it"
        )
    if _one_frequency(trials):
        return (
            "cannot tell, because at one frequency only the product of k_T and tau follows from how the response changes with the"
            " temperature; record a voltage step, and a sweep at each of two temperatures 10 degC apart"
        )
    return (
        f"cannot tell, because {highest - lowest:.2g} degC of change is too little beside the errors of the resonance;"
        " record sweeps at temperatures further apart"
    )


def _why_finger(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if all(t.log.amplitude_only for t in trials if t.touched):
        return (
            "cannot tell, because the amplitude alone does not say whether a finger damps the plate or moves its resonance;"
            " record wd and wq under the finger"
        )
    return "cannot tell, because noise hides what the finger does; press for longer, or to 1.5 N"


def seconds(t: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if t >= size:
            return f"{t / size:.3g} {unit}"
    return f"{t / 1e-9:.3g} ns"


def assumptions(trial: Trial) -> list[str]:
    """What had to be taken for granted to read a log at all, and what of it could not be read."""
    log, found = trial.log, []
    if trial.lost:
        gone = f"{trial.lost} of {len(log)} rows read exactly zero, or what the row before them reads, amid a response that moves"
        found.append(f"{gone}: the signal was lost; they are left out")
    if trial.from_rest and log.response_unit not in OFFSET_UNITS:
        found.append("no row shows the response without drive; taken as at rest, with no output offset, before its first row")
    elif trial.from_rest:
        found.append("taken as settled, with the drive at zero, before its first row")
    if not trial.steady and log.sampling is None and trial.changes > 0.1 * len(log):
        found.append(
            "whether a row's response belongs to its own inputs is not stated and matters here; taken as sampling: instant"
        )
    if log.amplitude_only and trial.resonant and trial.driven:
        found.append("amplitude only: a feedthrough of the drive cannot be told from the resonance and is taken as zero")
    if not trial.resonant and not trial.steady:
        found.append("no frequency is recorded; taken as driven at resonance (first-order model)")
    return found


def hangs_on_lateness(error: float) -> str:
    """For a G whose relative `error` is that of not knowing how late the response is."""
    return (
        f"G is known to {100 * error:.2g} %, as a feedthrough, a trigger that is late by a row and a gain look alike in a step;"
        " record a sweep beside it, or state delay_s (0 if nothing is late)"
    )


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
        shape += f", drive changes {'once' if changes == 1 else f'{changes} times'}" if changes else ", one level"
    shape += f", a finger of up to {np.max(np.abs(log.force)):.2g} N" if trial.touched else ""
    shape += ", amplitude only" if log.amplitude_only and trial.resonant else "" if trial.resonant else ", at resonance"
    return shape if log.temperature is None else f"{shape}, {log.temperature.mean():.1f} degC"


def noise(trial: Trial) -> str:
    """What the noise of a log was taken for, in a few words."""
    unit, parts = trial.log.response_unit, trial.parts
    colours = [_colour(p) for p in parts]
    said = colours[0]
    if len(parts) == 2:
        apart = [f"{p.noise_std:.3g} {unit} in {channel}" for p, channel in zip(parts, "dq", strict=True)]
        if colours[0] == colours[1]:
            said = f"{', '.join(apart)}, {colours[0]}"
        else:
            said = ", ".join(f"{level}, {colour}" for level, colour in zip(apart, colours, strict=True))
    if outliers := trial.left_out - trial.lost:
        return f"{said}, {outliers} outliers left out"
    return said if trial.tail is None else f"{said}, with outliers"


def _colour(trial: Trial) -> str:
    if trial.noise_time == 0:
        return "white"
    over = f"{trial.noise_time:.2g} rows" if trial.log.time is None else seconds(trial.noise_time)
    return f"correlated over {over}{'' if trial.signed else ', of Wd and Wq alike (for an amplitude an approximation)'}"


def misfit(trial: Trial, model: np.ndarray, residual: np.ndarray, tau: float) -> str | None:
    """A sentence when the residual of a log holds more than noise, by an amount that could matter; else None."""
    size = float(np.max(np.abs(model - np.median(model.real) - 1j * np.median(np.imag(model)))))
    order = np.argsort(trial.log.frequency, kind="stable") if trial.steady and trial.resonant else slice(None)
    part, chance = _structure(residual[order])
    if size == 0 or part < STRUCTURE * size or chance < SIGNIFICANT:
        return None
    if not trial.steady and not _near_changes(trial, residual, tau):
        return None
    said = f"the residual holds {100 * part / size:.1f} % of the response that is not noise"
    if trial.steady and not trial.log.amplitude_only and not phase_falls(trial):
        return f"{said}: the phase rises through the resonance; if the demodulator's sign is the other one, say phase_sign = -1"
    moved = "" if _warm(trial) or not trial.resonant else ", a resonance that moved with an unrecorded temperature"
    what = "saturated, a second resonance, an interfering line, a background that is not a slope"
    return f"{said}: {what}{moved}, or noise that many rows share"


def _warm(trial: Trial) -> bool:
    """Whether the log records its temperature."""
    return trial.log.temperature is not None


CLIPPED = 0.02  # share of the rows that lie on one value, its largest or smallest, when a channel is clipped


def clipped(trial: Trial) -> str | None:
    """A sentence when many rows of a channel share its largest or smallest value exactly; else None."""
    y = trial.log.response
    channels = _channels(trial)
    if np.all(trial.count > 1) or coarse(trial):
        return None  # a mean is never clipped exactly; and a coarse plateau lies on one level, clipped or not
    for channel in (*channels, *(-c for c in channels if trial.signed), np.abs(y)):
        values, count = np.unique(np.round(channel / trial.scale, 9), return_counts=True)
        beyond = values[-1] != 0 and count[-1] > max(CLIPPED * len(channel), 4)
        if beyond and len(values) > 20 and count[-1] > max(5 * np.median(count), 2 * np.max(count[-6:-1])):
            return f"saturated: {count[-1]} rows lie exactly at {values[-1] * trial.scale:.4g}; record it again within the range"
    return None


def _channels(trial: Trial) -> list[np.ndarray]:
    y = trial.log.response
    return [y.real] if trial.log.amplitude_only else [y.real, y.imag]


def coarse(trial: Trial) -> str | None:
    """A sentence when a channel's values are steps of a recorder that are larger than its noise; else None."""
    for channel in _channels(trial):
        steps = np.diff(np.unique(np.round(channel / trial.scale, 9)))
        least = float(np.min(steps, initial=np.inf))
        on_grid = len(steps) > 1 and np.all(np.abs(steps / least - np.rint(steps / least)) < 1e-3)
        if on_grid and trial.noise_std < 0.5 * least * trial.scale:
            return (
                f"recorded in steps of {least * trial.scale:.2g} {trial.log.response_unit}, larger than its noise, so that errors"
                " are approximate; record it again at a finer range"
            )
    return None


def touched(trial: Trial) -> str | None:
    """A sentence when a force is recorded that is the same throughout all logs, so that what it does is not known; else None."""
    if not trial.touched:
        return None
    return (
        f"a force of {np.max(np.abs(trial.log.force)):.2g} N is recorded, and none without it: a finger lowers G and tau by one"
        " factor, which is not known from these logs; add a log with nothing on the plate, or leave this one out"
    )


def extrapolated(trials: Sequence[Trial]) -> str | None:
    """A sentence when no log holds a force near that of which the finger's parameters are told; else None."""
    contacts = np.concatenate([t.inputs.contact for t in trials if t.touched])
    nearest = contacts[np.argmin(np.abs(contacts - 1))]
    if abs(nearest - 1) < NEAR_FULL:
        return None
    return (
        f"finger_damping and finger_detuning are those of {FULL_TOUCH} N, carried there from {float(force_of(nearest)):.2g} N by"
        f" the law of its contact area, which these logs do not show; press with {FULL_TOUCH} N"
    )


def _structure(residual: np.ndarray) -> tuple[float, float]:
    """Root mean square of what neighbouring rows share, and its significance in standard deviations of chance."""
    n = len(residual)
    power = float(np.mean(np.abs(residual) ** 2))
    if n < 8 or power == 0:
        return 0.0, 0.0
    shared = float(np.mean((residual[1:] * residual[:-1].conj()).real))
    channels = 2 if np.iscomplexobj(residual) else 1
    return float(np.sqrt(max(shared, 0.0))), shared / power * np.sqrt(n * channels)


def _near_changes(trial: Trial, residual: np.ndarray, tau: float) -> bool:
    """Whether the residual is larger after changes of the inputs than at rest: a misfit; coloured noise is everywhere."""
    since = trial.since_change
    near = since < 5 * tau
    if near.sum() < 8 or (~near).sum() < 20:
        return True
    ratio = np.mean(np.abs(residual[near]) ** 2) / max(np.mean(np.abs(residual[~near]) ** 2), 1e-300)
    return bool(ratio > 4)
