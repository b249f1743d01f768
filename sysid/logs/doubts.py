"""What a log's own numbers say against the way it is written: temperatures that seem to be kelvin,
frequencies that seem to be kHz, readings of a sensor that was not ready, one channel of two that was not
recorded, and a phase that is one but for a half turn; and an oscillation instead of its amplitude."""

import dataclasses
from collections.abc import MutableMapping
from typing import TYPE_CHECKING

import numpy as np

from sysid.columns.plan import Plan
from sysid.tables import units
from sysid.tables.cells import listed
from sysid.tables.textfile import LogError

if TYPE_CHECKING:
    from sysid.logs.log import Log

HOT = 200.0  # degC, above which a temperature is rather one in kelvin
JUMPS = 5.0  # degC, by which a reading is off those beside it that no plate follows there and back
USUAL = 8.0  # times the usual move from row to row, of readings that move more
FEW = 0.1  # of the rows, of which such readings are at most
BESIDE = 7  # rows among whose readings the middle one is taken: three in succession may be wrong
LEAST = 20  # rows in which this can be told
SOME = 8  # rows in which a channel that is 0 throughout was not recorded
DEAD = 0.2  # of the noise of one channel, less than which the other does not show: they share a lock-in
DIGITS = 1e-4  # of what a channel shows, which four digits leave open
QUARTILE = 0.3186  # of the size of a normal number of unit variance, which a quarter of them does not reach
QUARTER = 0.5 * np.pi  # rad
OPPOSITE = 0.5  # of the power of a signal, of which most then repeats itself with its sign turned
CYCLES = 50  # as many as a burst of a resonator lasts, and no sine by which a plant of first order is told
MOVES = 1.05  # of a coil's resistance, above which it moves: analysers are wrong by less
ROUNDED = 1e-3  # rad, of phases in degrees of one decimal
THERE = 0.1  # of the largest response: of less a phase may be noise


def doubted(log: "Log", celsius: bool = True) -> "Log":
    """The log, without readings of its thermometer that are none, and with a warning of these, and where its
    temperatures, said to be in degrees Celsius (`celsius`), seem to be kelvin, its frequency to be in kHz, or
    its impedance a coil's, or where one channel was not recorded. Raises LogError where that is one of
    a sweep, where rows are the oscillation itself, or driven at 0 Hz."""
    _refuse_oscillation(log)
    _refuse_direct(log)
    return _kelvin(_kilohertz(_recorded(_ready(_carrier(_coil(_power(log)))))), celsius)


def unfolded(name: str, plan: Plan, arrays: MutableMapping[str, tuple[np.ndarray, str]]) -> Plan:
    """The plan of the log of that name, with a warning where the phase (n,) rad among the arrays is one but
    for a half turn, as the arctangent of Wq/Wd has it; it is then carried on from row to row.

    Such a phase stays within a quarter turn of zero and jumps from one end to the other. One of the whole
    turn may jump so over a sweep, across a narrow resonance, but is then at both ends, and nowhere between.
    """
    if not {"phase", "magnitude"} <= arrays.keys():
        return plan
    (phase, unit), size = arrays["phase"], arrays["magnitude"][0]
    there = size > THERE * np.max(size, initial=0.0)
    jumps = (np.abs(np.diff(phase)) > QUARTER) & there[1:] & there[:-1]
    swept = "frequency" in arrays and np.ptp(arrays["frequency"][0]) > 0
    between = there & (np.abs(phase) < 0.5 * QUARTER) if swept else there
    if not (jumps.any() and between.any()) or np.max(np.abs(phase)) > QUARTER + ROUNDED:
        return plan
    arrays["phase"] = 0.5 * np.unwrap(2 * phase), unit
    said = (
        f"{name}: its phase stays within 90 degrees of zero and jumps by 180, {int(jumps.sum())} times, as"
        " that of atan(q/d) does: carried on from row to row; compute it by atan2(q, d), or record d and q"
    )
    return dataclasses.replace(plan, warnings=(*plan.warnings, said))


def _power(log: "Log") -> "Log":
    if log.kind != "transient" or np.any(log.drive) or not units.same_kind(log.response_unit, "W"):
        return log
    unit = log.response_unit
    said = f"its response in {unit} is a power, which decays twice as fast as the amplitude of what moves"
    return _warned(log, f"{said}: tau is that of the power; for the amplitude's save the root, in {unit}^0.5")


def _kelvin(log: "Log", celsius: bool) -> "Log":
    if not celsius or log.temperature is None or np.min(log.temperature) < HOT:
        return log
    typical = float(np.median(log.temperature))
    return _warned(
        log, f"its temperature is taken as {typical:.4g} degC; are these kelvin? then call it temperature_K"
    )


def _kilohertz(log: "Log") -> "Log":
    """With a warning where a transient lasts less than a period of its frequency, in which no demodulator
    tells d and q."""
    if log.kind == "steady" or log.frequency is None or log.time is None or not len(log):
        return log
    hertz, lasts = float(np.median(log.frequency)), float(np.ptp(log.time))
    if not 0 < hertz * lasts < 1:
        return log
    said = (
        f"its frequency is taken as {hertz:.5g} Hz, of which its rows last less than a period; is it in kHz?"
        " then call it frequency_kHz"
    )
    return _warned(log, said)


def _ready(log: "Log") -> "Log":
    """Without one to three readings in succession that are far from those before and after, as the 85 degC of
    a sensor that has just been switched on, or the 0 of one that is not connected."""
    warm = log.temperature
    if warm is None or len(warm) < LEAST or np.ptp(warm) <= JUMPS:
        return log
    from scipy.ndimage import median_filter

    usual = float(np.median(np.abs(np.diff(warm))))
    most, index = max(JUMPS, USUAL * usual), np.arange(len(warm))
    wrong = np.abs(warm - median_filter(warm, BESIDE, mode="mirror")) > most
    right = np.flatnonzero(~wrong)
    after = np.searchsorted(right, index)
    for beside in (right[np.maximum(after - 1, 0)], right[np.minimum(after, len(right) - 1)]):
        wrong &= np.abs(warm - warm[beside]) > most  # the last before a step may stand alone
    if not wrong.any() or np.mean(wrong) > FEW:
        return log
    values = listed([f"{value:.4g}" for value in np.unique(warm[wrong])])
    said = (
        f"{int(wrong.sum())} of its {len(warm)} temperatures ({values} degC) are far from those beside them,"
        f" as of a sensor that was not ready; left out, and taken as between those"
    )
    between = np.interp(index, index[~wrong], warm[~wrong])
    return _warned(dataclasses.replace(log, temperature=between), said)


def _refuse_direct(log: "Log") -> None:
    """Raise LogError where a transient begins with rows that are driven at 0 Hz, of which there is no
    amplitude and no phase, and others are not; the first row of a chirp may be."""
    if log.kind != "transient" or log.frequency is None or log.drive is None:
        return
    rows = int(np.argmax(log.frequency != 0))
    if rows > 1 and np.all(log.drive[:rows] != 0):
        found = f"its first {rows} rows with a drive at a frequency of 0"
        do = "what each row is driven at, or a drive of 0; is one column called the other"
        raise LogError(f"{log.path or log.name}: found {found}; expected {do}?")


def _refuse_oscillation(log: "Log") -> None:
    """Raise LogError where an undriven signal swings about zero: its rows are the oscillation itself, not its
    amplitude.

    What decays without a frequency passes through zero once at most."""
    undriven = log.amplitude_only and log.frequency is None and log.drive is None and log.kind != "steady"
    if undriven and len(log) >= LEAST and _period(log.response.real):
        found = (
            "found a w that swings about zero, without drive or frequency: the oscillation, of whatever it is"
        )
        do = "its amplitude over time (of any quantity it tells tau), or the samples of drive and response"
        raise LogError(f"{log.path or log.name}: {found}; expected {do}, as kind: waveform")


def _carrier(log: "Log") -> "Log":
    """With a warning where drive and response of a transient without a frequency swing about zero together,
    so often that a plant of first order would hardly be driven so."""
    if log.kind == "steady" or log.frequency is not None or log.drive is None or not log.amplitude_only:
        return log
    periods = [_period(x) for x in (log.drive, log.response.real)]
    often = all(periods) and len(log) > CYCLES * max(periods)
    if not often or abs(periods[0] - periods[1]) > 1:
        return log
    said = f"drive and response swing about zero together, every {periods[0]} rows: are they samples of a"
    then = f"carrier? then say kind: waveform, with the response as response_{log.response_unit}"
    return _warned(log, f"{said} {then}")


def _coil(log: "Log") -> "Log":
    """With a warning where an impedance is a resistance at low frequencies, no capacitance at high ones, and
    grows between: it is that of a coil in a magnet, which moves.

    Its voltage is R I + j omega L I and, of the motion, B l times a velocity: the resonance is where the
    resistance is largest. Of a piezoelectric plate both ends are capacitances."""
    if log.amplitude_only or log.drive is None or log.frequency is None or log.kind == "transient":
        return log
    of_charge = log.response_unit.endswith("C") and log.drive_unit.endswith("V")
    at = np.argsort(log.frequency, kind="stable")
    flow = (log.response * log.frequency)[at]
    if not (of_charge and log.relative_noise and np.all(flow != 0) and np.ptp(log.frequency) > 0):
        return log
    z = log.drive[at] / flow
    low, high = z[0], z[-1]
    if abs(low.imag) > low.real or -high.imag > high.real or max(low.real, high.real) * MOVES > max(z.real):
        return log
    said = (
        "its impedance is that of a coil which moves: a resistance that is largest at"
        f" {log.frequency[at][np.argmax(z.real)]:.5g} Hz. Fitted is the motion that a voltage drives, which"
        ' the coil\'s resistance damps; of that which a current drives say quantity = "velocity" in a'
        " mapping file (--columns)"
    )
    return _warned(log, said)


def _period(signal: np.ndarray) -> int:
    """Rows after which a signal that swings about zero is itself again, and halfway its own opposite; 0 of
    any other."""
    if not np.any(signal < 0):
        return 0
    spectrum = np.abs(np.fft.rfft(signal, 2 * len(signal))) ** 2  # padded, so that no end meets a beginning
    alike = np.fft.irfft(spectrum)[: len(signal)]
    half = np.arange(1, (len(signal) + 1) // 2)
    swings = (alike[half] < -OPPOSITE * alike[0]) & (alike[2 * half] > OPPOSITE * alike[0])
    return 2 * int(half[np.argmax(swings)]) if swings.any() else 0


def _recorded(log: "Log") -> "Log":
    """With a warning where Wd or Wq is 0 in every row and the other is not: of one frequency the plate may be
    in phase, or was simulated so. Raises LogError of several frequencies, at which no plate is in phase,
    where one shows less than the other's noise, and where one is the other once more, noise and all."""
    if log.amplitude_only or len(log) < SOME or log.frequency is None:
        return log
    parts = {"wd": log.response.real, "wq": log.response.imag}
    do = "record both, or the amplitude w alone"
    if _rough(parts["wd"]) and np.all(np.abs(parts["wd"]) == np.abs(parts["wq"])):
        raise LogError(f"{log.path or log.name}: found wq the same as wd, expected both channels; {do}")
    least = {"wd": DEAD * _noise(parts["wq"]), "wq": DEAD * _noise(parts["wd"])}
    zero = [name for name, part in parts.items() if np.std(part) < least[name] or not part.any()]
    if len(zero) != 1 or np.ptp(np.abs(log.response)) == 0:
        return log
    (name,), other = zero, "wq" if zero[0] == "wd" else "wd"
    shows = f"shows less than the noise of {other}" if parts[name].any() else "is 0 in every row"
    found = f"{name} {shows}, and {other} alone is no amplitude"
    if _rough(parts[name]) or np.ptp(log.frequency[log.response != 0]) > 0:
        raise LogError(f"{log.path or log.name}: found that {found}, expected both channels; {do}")
    return _warned(log, f"{found}: taken as of a plate whose phase does not turn; {do}")


def _rough(part: np.ndarray) -> bool:
    """Whether there is noise, more than of digits: its differences grow with their order, and those of a
    course shrink."""
    second, third = (float(np.median(np.abs(np.diff(part, order)))) for order in (2, 3))
    return third > second > DIGITS * float(np.ptp(part))


def _noise(part: np.ndarray) -> float:
    """Standard deviation of normal noise by the quietest quarter of the second differences."""
    return float(np.quantile(np.abs(np.diff(part, 2)), 0.25)) / (QUARTILE * 6**0.5)


def _warned(log: "Log", warning: str) -> "Log":
    return dataclasses.replace(log, warnings=(*log.warnings, f"{log.name}: {warning}"))
