"""Which parameters the logs determine: the limits, the reasons in words, and what to record next.

A parameter is determined when its interval is finite, comes from the data, belongs to a single solution and
is narrow enough to use:

    G, tau    standard deviation below 20 % of the value
    f0        standard deviation below half of the half bandwidth 1/(2 pi tau)
    k_T       carries f0 over 10 degC with a standard deviation below one half bandwidth, and the logs'
              temperatures are three errors of their thermometers apart

and when no single reading decides it (`verdict.lone`).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sysid.minimum.minimise import State
from sysid.trials.trial import LEAST_WARMING, Trial, numbers_left

RELATIVE = 0.2
WARMING = 10.0
SPARE = 4  # numbers beyond the unknowns, below which the noise, and with it every error, is a guess
HIDDEN = "noise or background hide the response; record it at a larger drive"
SETTLED_AMPLITUDE = (
    "the settled amplitude at one frequency does not say how far that is from the"
    " resonance; record a sweep across the resonance"
)
UNTUNED = "no frequency is recorded; add a frequency_* column, or its value as metadata"
FINER = "a finer range of the recorder, or noise of half one of its steps (dither), would tell more"
CREEPING = (
    "the drive only moves slowly, and the response follows it from row to row: no transient shows, and a"
    " gain, a feedthrough and a resonance beside the drive look alike; record a voltage step, or a sweep"
    " across the resonance"
)
NO_ENVELOPE = (
    "rows differ from their neighbours as from any others, as noise does, or an"
    " oscillation that was not demodulated; record its amplitude, or wd and wq, or the oscillation as kind:"
    " waveform"
)
# errors of their thermometers, by which the logs' temperatures are apart where an interval of k_T holds
NARROW = 3.0
WHOLE = 4.0  # tau, that a log covers that shows how its response settles
BENDS = 0.1  # tau: over less a rise is straight but for a twentieth, and whether it settles is not seen
LEVEL = 3.0  # times the noise, from which what all rows have in common is a response
BURIED = 0.5  # of the variance of a log's rows lies between neighbours where noise hides the rest


def limits(G: float, tau: float) -> dict[str, float]:
    """Largest standard deviation at which each parameter counts as determined."""
    half_bandwidth = 1 / (2 * np.pi * tau)
    touch = {"finger_damping": RELATIVE, "finger_detuning": 0.5 * half_bandwidth}
    return {
        "G": RELATIVE * G,
        "tau": RELATIVE * tau,
        "f0": 0.5 * half_bandwidth,
        "k_T": half_bandwidth / WARMING,
        **touch,
    }


def why(name: str, trials: Sequence[Trial], tau: float, free: Sequence[str], modes: int) -> str:
    """One sentence: why `name` cannot be told from these logs, and what to record."""
    said = _why(name, trials, tau, free, modes)
    return f"cannot tell{'' if said.startswith('to ') else ', because'} {said}"


def _why(name: str, trials: Sequence[Trial], tau: float, free: Sequence[str], modes: int) -> str:
    if said := hopeless(trials, free):
        return said
    if modes > 1:
        return _why_modes(name, trials)
    if name in ("tau", "f0") and "k_T" in free and any(_drifts_along(t) for t in trials):
        return (
            "the temperature drifted along with the frequency, which k_T and the width"
            " of the resonance explain alike; record another sweep at a temperature 10 degC away, or the"
            " same one downwards"
        )
    said = _cause(name, trials, tau, free)
    hidden = "noise" in said or "half a bandwidth" in said  # by which the steps of a recorder are as well
    return f"{said}; {FINER}" if hidden and any(t.noise.rounded is not None for t in trials) else said


def _cause(name: str, trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    driven = [t for t in trials if t.driven]
    if name != "k_T" and driven and all(t.creeps for t in driven):
        return CREEPING
    causes = {"G": _why_gain, "tau": _why_tau, "f0": _why_f0, "k_T": _why_drift}
    return causes.get(name, _why_finger)(trials, tau, free)


def hopeless(trials: Sequence[Trial], free: Sequence[str]) -> str | None:
    """A sentence when nothing can be determined from these logs; else None."""
    if sum(numbers_left(t) for t in trials) - len(free) < SPARE:
        return (
            "the readings are hardly more than the unknowns, so that their noise cannot"
            " be told; record ten points or more"
        )
    if all(t.silent for t in trials):
        return "the response is the same in every row; see whether the sensor and what reads it were on"
    return None


def overdamped(state: State, reference: tuple[float, float]) -> bool:
    """Whether the best plant does not oscillate, Q = pi f0 tau < 1/2 or f0 < 0: the logs show no resonance.
    Where all is at one frequency, that says nothing of it."""
    resonant = any(t.resonant for t in state.trials) and not _one_frequency(state.trials)
    if not resonant or all(t.silent for t in state.trials):
        return False
    return bool(np.pi * (reference[0] + state.named.f0) * state.tau < 0.5)


def buried(trials: Sequence[Trial]) -> bool:
    """Whether all variation in the logs is noise, judged by neighbouring rows."""
    return all(t.silent or _buried(t) for t in trials)


def ambiguous(name: str, trials: Sequence[Trial], free: Sequence[str]) -> bool:
    """Whether settled amplitudes at one frequency each leave a parameter as one of many images, one for each
    temperature."""
    return name in ("G", "f0", "k_T") and "k_T" in free and _one_amplitude(trials)


def shows_transient(trials: Sequence[Trial]) -> bool:
    """Whether a log shows part of a transient; else the estimate of an undetermined tau is a guess."""
    return not _one_frequency(trials) and any(
        not (t.steady or _settles_between(t) or _buried(t)) for t in trials
    )


def _one_frequency(trials: Sequence[Trial]) -> bool:
    """All that has a frequency was recorded at the same one, settled: a level, and no transient."""
    resonant = [t for t in trials if t.resonant]
    level = all(t.steady or (t.one_level and not t.from_rest) for t in resonant)
    return bool(resonant) and level and np.ptp(np.concatenate([t.log.frequency for t in resonant])) == 0


def _one_amplitude(trials: Sequence[Trial]) -> bool:
    """All that has a frequency are amplitudes at one each, of which none begins at rest."""
    held = [t for t in trials if t.resonant and t.driven]
    return bool(held) and all(t.begun and np.ptp(t.log.frequency) == 0 for t in held)


def _buried(trial: Trial) -> bool:
    """Neighbouring rows differ about as much as any two: noise, and little else."""
    y = trial.log.response
    apart = np.mean(np.abs(np.diff(y)) ** 2) / 2
    return bool(len(y) > 8 and apart > BURIED * np.mean(np.abs(y - np.mean(y)) ** 2))


def within_errors(trials: Sequence[Trial]) -> bool:
    """Whether the logs' temperatures are as close together as their thermometers' errors. Then a small k_T
    has small errors and a large one large errors, so that no interval about the estimate tells which it
    is."""
    told = [t for t in trials if t.resonant and t.log.temperature is not None]
    if not any("thermometer" in t.nuisances for t in told):
        return False
    means = np.array([t.log.temperature.mean() for t in told])
    spread = np.mean([np.mean((t.log.temperature - means.mean()) ** 2) for t in told])
    return bool(
        spread < NARROW**2 * np.mean([t.log.bench.get("temperature_std_degC", 0.0) ** 2 for t in told])
    )


def _settles_between(trial: Trial) -> bool:
    """After every change of the inputs the first row is already where the next change, or the end, finds the
    response."""
    y, hold = trial.log.response, trial.inputs
    edges = np.append(np.flatnonzero(np.diff(hold.interval) > 0), len(y) - 1)
    stretches = [(a, b) for a, b in pairwise(edges) if b > a + 2]
    if not stretches or not trial.driven:
        return False
    left = [np.abs(y[a + 1] - np.mean(y[(a + b) // 2 : b + 1])) for a, b in stretches]
    moved = [np.abs(y[a] - np.mean(y[(a + b) // 2 : b + 1])) for a, b in stretches]
    return bool(np.max(moved) > 5 * trial.noise.std and np.max(left) < 0.3 * np.max(moved))


def _drifts_along(trial: Trial) -> bool:
    """A sweep whose temperature is a straight line of its frequency."""
    log = trial.log
    if (
        not trial.resonant
        or log.temperature is None
        or np.ptp(log.frequency) == 0
        or np.ptp(log.temperature) < LEAST_WARMING
    ):
        return False
    return bool(abs(np.corrcoef(log.frequency, log.temperature)[0, 1]) > 0.9)


def _why_modes(name: str, trials: Sequence[Trial]) -> str:
    if name in ("G", "tau") and any(t.bench.standing for t in trials):
        return (
            "the amplitude does not say whether the offset under it adds to the response"
            " or takes from it, and two solutions fit alike; record wd and wq, or how it rings down once the"
            " drive is off"
        )
    if all(t.log.amplitude_only for t in trials if t.resonant):
        return (
            "the amplitude alone does not say on which side of the drive the resonance"
            " lies and two solutions fit alike; record wd and wq, or a sweep across the resonance"
        )
    return "separate solutions fit these logs alike; record a sweep across the resonance and a voltage step"


def _why_gain(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if all(t.log.drive is None for t in trials):
        return (
            "no drive is recorded, or zero throughout; record a voltage step, its drive"
            " as a voltage_* or drive_* column"
        )
    if not any(t.driven for t in trials):
        return "the drive is zero in every row; record a voltage step"
    if all(t.one_level for t in trials if t.driven):
        return (
            "no row shows the response without drive, so that an output offset, a plate"
            f" that still rings and a gain look alike; record {seconds(tau)} before the step, with the drive"
            " at zero"
        )
    if _one_amplitude(trials):
        return SETTLED_AMPLITUDE
    driven = [t for t in trials if t.driven]
    if _one_frequency(driven):
        return (
            "at one frequency a gain and a resonance beside the drive look alike; record"
            " a sweep across the resonance"
        )
    if said := _too_short(driven, tau) or _too_narrow(driven, tau):
        return said
    if all(not t.steady and t.lateness > 0.5 * RELATIVE * tau for t in driven):
        return (
            "a feedthrough, a response that is late by a row and a gain look alike in a"
            f" step; record a sweep across the resonance, or rows {seconds(0.05 * tau)} apart or closer"
        )
    held = (not (t.steady or t.from_rest or t.log.drive is None or np.ptp(t.log.drive)) for t in driven)
    if all(held):
        return (
            "the drive does not change, and no row shows the response without it or away"
            " from the resonance, where a background and a gain differ; record a sweep across the resonance"
        )
    return HIDDEN


def _why_tau(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    moving = [t for t in trials if not t.steady]
    swept = [t for t in trials if t.steady and t.resonant and np.ptp(t.log.frequency) > 0]
    if not moving and not swept:
        return (
            "settled points at one frequency hold no time constant; record a voltage"
            " step or a sweep across the resonance"
        )
    hidden = "noise hides the transient; record a larger step, or the average of several"
    if not any(t.resonant or t.driven for t in moving + swept):
        hidden = NO_ENVELOPE
    if _one_frequency(trials):
        return (
            "one frequency at a constant drive holds no time constant; record a voltage"
            " step or a sweep across the resonance"
        )
    if moving and not swept:
        window = max(t.log.time[-1] - t.log.time[0] for t in moving)
        if window == 0:
            return "all rows are of one moment; see whether the time is in the column that was taken for it"
        step = min(np.median(np.diff(t.log.time)) for t in moving if len(t.log) > 1)
        if all(_buried(t) for t in moving):
            return hidden
        if all(_settles_between(t) for t in moving):
            return (
                f"rows are {seconds(step)} apart and the response settles between two"
                f" of them; record rows {seconds(step / 100)} apart or closer"
            )
        if said := _too_short(moving, tau):
            return said
    if swept and not moving:
        return _too_narrow(swept, tau) or (
            "noise hides the resonance; record it at a larger drive, or the average of several sweeps"
        )
    return hidden


def _too_short(trials: Sequence[Trial], tau: float) -> str:
    """Of transients alone, that they end before the response has settled; "" where one does not, and of
    noise."""
    if any(t.steady for t in trials) or all(_buried(t) for t in trials):
        return ""
    window = max(t.log.time[-1] - t.log.time[0] for t in trials)
    if not 0 < window < WHOLE * tau:
        return ""
    if window < BENDS * tau and any(t.driven for t in trials):
        return (
            "the response goes on at the same rate to the end of the longest log, as"
            " that of a plant that integrates (the angle of a motor, the level of a tank), which has no G and"
            f" no tau: record its rate of change; or, if it settles, {seconds(10 * window)} or more after a"
            " step"
        )
    return (
        f"the longest log covers {window / tau:.2g} tau; record {seconds(10 * window)}"
        " or more after a voltage step"
    )


def _too_narrow(trials: Sequence[Trial], tau: float) -> str:
    """Of sweeps alone, that they do not show how wide the resonance is; "" of others, and where noise hides
    it."""
    span = _span(trials)
    if span == 0 or not all(t.steady for t in trials):
        return ""
    if not any(_level(t) for t in trials) and all(
        _buried(t) or (t.noise.time > 0 and span > 3 / (np.pi * tau)) for t in trials
    ):
        return ""
    return (
        f"a sweep over {span:.4g} Hz does not show the width of the resonance; sweep"
        f" over at least {max(10 * span, 3 / (np.pi * tau)):.3g} Hz about the peak, with ten points or more"
        " across it"
    )


def _span(trials: Sequence[Trial]) -> float:
    """Hz, of the widest sweep."""
    return max((float(np.ptp(t.log.frequency)) for t in trials if t.steady and t.resonant), default=0.0)


def _level(trial: Trial) -> bool:
    """Whether the rows of a log have something in common that is larger than noise."""
    y = trial.log.response
    return bool(np.abs(np.mean(y)) ** 2 > LEVEL**2 * np.mean(np.abs(np.diff(y)) ** 2) / 2)


def _why_f0(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if "f0" not in free:
        return UNTUNED
    if all(t.log.amplitude_only and not t.swept for t in trials if t.resonant):
        return (
            "the amplitude of a step near resonance does not depend on the detuning;"
            " record wd and wq, or a sweep across the resonance"
        )
    if _one_frequency(trials):
        return (
            "at one frequency a rotation of the demodulator's phase and a resonance"
            " beside the drive look alike; record a sweep across the resonance"
        )
    if all(t.silent or (_buried(t) and not _level(t)) for t in trials):
        return "noise hides the resonance; record it at a larger drive, or the average of several logs"
    width = max(3 / (np.pi * tau), 10 * _span(trials))
    return f"to half a bandwidth; record a sweep across the resonance, {width:.3g} Hz wide or more"


def _why_drift(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    warm = [t.log.temperature for t in trials if t.resonant and t.log.temperature is not None]
    if "f0" not in free:
        return UNTUNED
    if not warm:
        return (
            "no temperature is recorded; record sweeps at two temperatures, 10 degC"
            " apart, and fit those instead"
        )
    lowest, highest = min(w.min() for w in warm), max(w.max() for w in warm)
    if "k_T" not in free:
        return (
            f"all logs are at one temperature ({(lowest + highest) / 2:.1f} degC);"
            f" record a sweep 10 degC away from it"
        )
    if _one_amplitude(trials):
        return SETTLED_AMPLITUDE
    if _one_frequency(trials):
        return (
            "at one frequency only the product of k_T and tau follows from how the"
            " response changes with the temperature; record a voltage step, and a sweep at each of two"
            " temperatures 10 degC apart"
        )
    if within_errors(trials):
        return (
            f"{highest - lowest:.2g} degC of change is too little beside the error of"
            f" the thermometer (temperature_std_degC); record sweeps at temperatures further apart"
        )
    return (
        f"{highest - lowest:.2g} degC of change is too little beside the errors of the"
        " resonance; record sweeps at temperatures further apart"
    )


def _why_finger(trials: Sequence[Trial], tau: float, free: Sequence[str]) -> str:
    if all(t.log.amplitude_only for t in trials if t.touched):
        return (
            "the amplitude alone does not say whether a finger damps the plate or moves"
            " its resonance; record wd and wq under the finger"
        )
    return "noise hides what the finger does; press for longer, or to 1.5 N"


def seconds(t: float) -> str:
    """A time in the unit that suits it: "1.67 ms"."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if t >= size:
            return f"{t / size:.3g} {unit}"
    return f"{t / 1e-9:.3g} ns"
