"""The catalogue: each hard log, and what must come out of it.

`must` names the answers that are allowed: right, open, refused or flagged, as the study defines them; open and refused are both the
command's exit 1. `says` are words, a regular expression, of which the answer has to hold one where it is not right. An
"undetectable" case is one whose log is that of another plate: no program can do better than to print numbers that a person doubts.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from bench import (
    EARLY,
    HALF,
    PLATE,
    ROWS,
    VOLTS,
    Bench,
    amplitude,
    called_degC,
    clipped,
    coloured,
    dropped,
    duffing,
    felt,
    held_back,
    hurried,
    irregular,
    jumping_source,
    late,
    levels,
    other,
    outliers,
    picked,
    plates,
    quantised,
    renamed,
    scattered,
    settled,
    smoothed,
    spoilt,
    swapped,
    through_csv,
    touched,
    two_peaks,
    warmed,
)  # fmt: skip

from sysid import Log


@dataclass(frozen=True)
class Case:
    """Logs of the bench of one seed, what must come out of them, and where the plate's numbers are not those of PLATE."""

    make: Callable[[Bench], list[Log]]
    must: str = "right"
    says: str = ""
    truth: Mapping[str, float] = field(default_factory=dict)


LOW, HIGH = (replace(PLATE, f0=Q / (np.pi * PLATE.tau)) for Q in (2, 1e6))
OFF = np.arange(ROWS) < EARLY
HIDDEN = "noise hides|noise or background hide"
COMPRESSED = "saturated|compressed"
UNDETECTABLE = "undetectable"

NOTHING_IS_WRONG = {
    "step": Case(lambda b: [b.step()]),
    "sweep": Case(lambda b: [b.sweep()]),
    "step and sweep": Case(lambda b: [b.step(), b.sweep()]),
    "sweep downwards": Case(lambda b: [picked(b.sweep(), np.arange(ROWS)[::-1])]),
    "sweep in no order": Case(lambda b: [picked(b.sweep(), b.rng.permutation(ROWS))]),
    "step to a negative voltage": Case(lambda b: [b.step(drive=-VOLTS * ~OFF)]),
    "step through zero volts": Case(lambda b: [b.step(window=24.0, drive=levels(b, (1.0, -1.0, 0.5, -0.5)))]),
    "step that beats, 6 half bandwidths off": Case(lambda b: [b.step(off=6.0)]),
    "random steps of the drive": Case(lambda b: [b.step(window=30, drive=VOLTS * np.repeat(b.rng.random(24), 5))]),
    "irregular time stamps": Case(lambda b: [irregular(b)]),
    "gap in time": Case(lambda b: [picked(b.step(window=16), np.r_[0:30, 60:ROWS])]),
    "rows twice, at the same times": Case(lambda b: [picked(b.step(), np.sort(np.r_[0:60, 0:60]))]),
    "time since 1970": Case(lambda b: [(lambda log: replace(log, time=log.time + 1.7e9))(b.step())]),
    "response in 1e12": Case(
        lambda b: [spoilt(b.step(), lambda y: 1e12 * y), spoilt(b.sweep(), lambda y: 1e12 * y)], truth={"G": 1e12 * PLATE.G}),
    "response in 1e-12": Case(
        lambda b: [spoilt(b.step(), lambda y: 1e-12 * y), spoilt(b.sweep(), lambda y: 1e-12 * y)], truth={"G": 1e-12 * PLATE.G}),
    "frequency in single precision": Case(
        lambda b: [(log := b.sweep(), replace(log, frequency=log.frequency.astype(np.float32).astype(float)))[1]]),
    "feedthrough three times the resonance": Case(lambda b: [spoilt(b.sweep(), lambda y: y + 6 * np.exp(1j))]),
    "sweep on a slope": Case(lambda b: [spoilt(b.sweep(), lambda y: y + (0.5 - 0.7j) * np.linspace(-1, 1, ROWS))]),
    "dip": Case(lambda b: [spoilt(b.sweep(), lambda y: 2 * np.exp(0.3j) - y)]),
    "sweeps at two temperatures": Case(lambda b: [b.sweep(degC=24.0), b.sweep(-10, 6, degC=34.0)]),
    "drive off at 0 Hz": Case(lambda b: [replace(log := b.step(), frequency=np.where(log.drive > 0, log.frequency, 0.0))]),
    "finger, recorded": Case(lambda b: [touched(b, recorded=True)]),
    "the same log twice, with other noise": Case(lambda b: [b.step(), b.step()]),
    "noise of 10 %": Case(lambda b: [replace(b, noise=0.1).sweep()]),
    "amplitude alone, sweep": Case(lambda b: [amplitude(b.sweep())]),
    "amplitude alone, far into the noise (Rice)": Case(lambda b: [amplitude(replace(b, noise=0.1).sweep(-20, 20))]),
    "amplitude alone, step beside resonance": Case(lambda b: [amplitude(b.step(off=2.0))]),
    "amplitude alone, step at resonance": Case(lambda b: [amplitude(b.step(off=0.0))]),
    "Q of 2": Case(
        lambda b: [(low := replace(b, plant=LOW)).step(off=0.0), low.sweep(-1.5, 8)], truth={"f0": LOW.f0}),
    "Q of a million": Case(lambda b: [(quartz := replace(b, plant=HIGH)).step(), quartz.sweep()], truth={"f0": HIGH.f0}),
    "filter of half a tau, stated": Case(
        lambda b: [replace(smoothed(b.step(), 0.5 * PLATE.tau), bench={"lockin_tau_s": 0.5 * PLATE.tau})]),
}  # fmt: skip

ROWS_ARE_SPOILT = {
    "clipped on both sides": Case(lambda b: [spoilt(b.step(), clipped(1.2))], "refused", COMPRESSED),
    "clipped on one side": Case(lambda b: [spoilt(b.step(), clipped(1.2, both=False))], "refused", COMPRESSED),
    "clipped at 80 %": Case(lambda b: [spoilt(b.step(off=0.0), clipped(1.6))], "refused", COMPRESSED),
    "clipped by 3 %": Case(lambda b: [spoilt(b.step(off=0.0), clipped(1.85))], "refused", COMPRESSED),
    "sweep clipped at its peak": Case(lambda b: [spoilt(b.sweep(), clipped(1.2))], "refused", COMPRESSED),
    "sweep clipped softly": Case(
        lambda b: [spoilt(b.sweep(), lambda y: 2 * np.tanh(np.abs(y) / 2) * np.exp(1j * np.angle(y)))], "refused", COMPRESSED),
    "5 % outliers, step": Case(lambda b: [spoilt(b.step(), outliers(b, 0.05, 1.0))]),
    "5 % outliers, sweep": Case(lambda b: [spoilt(b.sweep(), outliers(b, 0.05, 1.0))]),
    "20 % outliers, sweep": Case(lambda b: [spoilt(b.sweep(), outliers(b, 0.2, 1.0))], "right or open", HIDDEN),
    "one outlier of a thousand": Case(
        lambda b: [spoilt(b.step(), lambda y: y + 2000.0 * (np.arange(ROWS) == 70))], "right or open", HIDDEN),
    "drop-out to zero": Case(lambda b: [spoilt(b.step(), dropped(60, 75, held=False))]),
    "drop-out in the rise": Case(lambda b: [spoilt(b.step(), dropped(15, 22, held=False))]),
    "single rows of zero, step": Case(lambda b: [spoilt(b.step(), scattered(b, 0.1))]),
    "single rows of zero, sweep": Case(lambda b: [spoilt(b.sweep(), scattered(b, 0.1))]),
    "drop-out that holds": Case(lambda b: [spoilt(b.step(), dropped(16, 30, held=True))]),
    "sweep with a drop-out": Case(lambda b: [spoilt(b.sweep(), dropped(55, 62, held=True))]),
    "three levels": Case(lambda b: [spoilt(b.step(), quantised(3))], "refused or open", "steps of|compressed|cannot tell"),
    "nine levels": Case(lambda b: [spoilt(b.step(), quantised(9))], "right or flagged or open or refused", "recorded in steps of"),
    "sweep of nine levels": Case(lambda b: [spoilt(b.sweep(), quantised(9))], "right or flagged or refused", "recorded in steps of"),
    # noise of which a log holds so little wanders as an offset that drifts does
    "noise that remembers": Case(lambda b: [spoilt(b.step(), coloured(b, 0.95))], "right or refused", "output offset drifts"),
    "noise behind a slow filter": Case(lambda b: [spoilt(b.step(), coloured(b, 0.98))], "right or refused", "output offset drifts"),
    "noise in proportion": Case(lambda b: [spoilt(b.sweep(), lambda y: y * (1 + 0.05 * b.rng.standard_normal(ROWS)))]),
    "noise larger than the response": Case(lambda b: [replace(b, noise=3.0).step()], "open or refused", "cannot tell"),
    "noise alone": Case(lambda b: [spoilt(b.step(), lambda y: 0.02 * b.rng.standard_normal(ROWS) + 0j)], "open or refused", HIDDEN),
    "constant": Case(lambda b: [spoilt(b.step(), lambda y: np.full(ROWS, 1.3 - 0.2j))], "open or refused", "cannot tell"),
    "zeros": Case(lambda b: [spoilt(b.step(), lambda y: np.zeros(ROWS, complex))], "open or refused", "cannot tell"),
    "baseline that drifts": Case(lambda b: [spoilt(b.step(), lambda y: y + 0.4 * np.linspace(0, 1, ROWS))], "right or refused",
        "output offset drifts"),
    "baseline that jumps": Case(lambda b: [spoilt(b.step(), lambda y: y + 0.3 * (np.arange(ROWS) > 60))]),
    "hum": Case(lambda b: [spoilt(b.step(), lambda y: y + 0.1 * np.sin(np.arange(ROWS) / 6))]),
    "demodulator that turns": Case(
        lambda b: [spoilt(b.step(), lambda y: y * np.exp(0.5j * np.linspace(0, 1, ROWS)))], "right or refused", "its phase turns|drifts|no known effect"),
    "phase that jumps": Case(
        lambda b: [spoilt(b.step(), lambda y: y * np.exp(1j * (np.arange(ROWS) > 60)))], "refused or open", "not noise|cannot tell"),
    "a cell without a number": Case(lambda b: through_csv(b.step(), renamed("100.0", "nan")), "refused", "'nan'"),
}  # fmt: skip

WINDOWS = {
    "window of 0.05 tau": Case(lambda b: [b.step(window=0.05)], "open or refused", "cannot tell"),
    "window of 0.1 tau": Case(lambda b: [b.step(window=0.1)], "open or refused", "cannot tell"),
    "window of 0.3 tau": Case(lambda b: [b.step(window=0.3)], "open or refused", "cannot tell"),
    "window of 1 tau": Case(lambda b: [b.step(window=1.0)], "right or open", "cannot tell"),
    "window of 3 tau": Case(lambda b: [b.step(window=3.0)]),
    "window of 100 tau": Case(lambda b: [b.step(window=100.0)]),
    "rows 10 tau apart": Case(lambda b: [b.step(window=1000.0)], "open or refused", "settles between two"),
    "step before the first row": Case(lambda b: [picked(b.step(), np.arange(20, ROWS))], "right or open", "cannot tell"),
    "step long before the first row": Case(lambda b: [picked(b.step(window=24.0), np.arange(60, ROWS))], "open or refused", "cannot tell"),
    "step at the first row": Case(lambda b: [b.step(early=0)]),
    "one row": Case(lambda b: [picked(b.step(), np.arange(60, 61))], "open or refused", "cannot tell"),
    "two rows": Case(lambda b: [picked(b.step(), np.arange(11, 13))], "open or refused", "cannot tell"),
    "three rows": Case(lambda b: [picked(b.step(), np.array([11, 20, 60]))], "open or refused", "cannot tell"),
    "all rows at one time": Case(lambda b: [replace(b.step(), time=np.full(ROWS, 1.7e9))], "open or refused", "one moment"),
    "drive of zero": Case(
        lambda b: [replace(spoilt(b.step(), lambda y: 0.02 * b.rng.standard_normal(ROWS) + 0j), drive=np.zeros(ROWS))],
        "open or refused", "cannot tell"),
    "peak beyond the sweep": Case(lambda b: [b.sweep(5, 12)], "right or open", "cannot tell"),
    "peak at the edge": Case(lambda b: [b.sweep(0, 10)]),
    "half a peak": Case(lambda b: [b.sweep(-0.5, 10)]),
    "far beside the peak": Case(lambda b: [b.sweep(20, 30)], "open or refused", "cannot tell"),
    "sweep of 0.1 half bandwidths": Case(lambda b: [b.sweep(-0.05, 0.05)], "open or refused", "width of the resonance"),
    "sweep of five points": Case(lambda b: [picked(b.sweep(), np.arange(0, ROWS, 25))], "right or open", "cannot tell"),
    "one frequency": Case(
        lambda b: [replace(log := b.sweep(-0.5, -0.5), frequency=np.full(ROWS, log.frequency[0]))], "open or refused", "one frequency"),
    "one frequency while the plate warms": Case(lambda b: [warmed(b)], "open or refused", "one frequency|k_T and tau"),
    "peak between two points": Case(lambda b: [picked(b.sweep(-101, 99), np.arange(0, ROWS, 2))], "right or open", "cannot tell"),
}  # fmt: skip

THE_PLATE_IS_ANOTHER = {
    "two peaks": Case(lambda b: [two_peaks(b, 6.0)], "right or refused", "second resonance"),
    "two peaks in one": Case(lambda b: [two_peaks(b, 1.0)], "right or refused", "second resonance"),
    "resonance that softens": Case(lambda b: [duffing(b, 0.5)], "right or refused", "on the amplitude"),
    "resonance that jumps, upwards": Case(lambda b: [duffing(b, 4.0)], "right or refused or open", "amplitude|one resonance"),
    "resonance that jumps, downwards": Case(
        lambda b: [duffing(b, 4.0, back=True)], "right or refused or open", "amplitude|one resonance"),
    "sweep too fast, 3 tau": Case(lambda b: [hurried(b, 3.0)], "right or refused", "settled|ring"),
    "sweep too fast, 0.3 tau": Case(lambda b: [hurried(b, 0.3)], "right or refused", "second resonance|settled|ring|late"),
    "finger, not recorded": Case(lambda b: [touched(b, recorded=False)], "refused or open", "no known effect|finger"),
    "two plates, far apart": Case(
        lambda b: [b.sweep(), other(b, f0=PLATE.f0 + 20 * HALF).step()], "refused", "contradicts"),
    "two plates, alike": Case(
        lambda b: [b.sweep(), other(b, f0=PLATE.f0 + 0.5 * HALF, tau=1.1 * PLATE.tau).sweep()], "refused", "contradicts"),
    "two plates, named": Case(plates, "refused", "plate"),
}  # fmt: skip

THE_BENCH_IS_ANOTHER = {
    "trigger late by three rows": Case(lambda b: [spoilt(b.step(), late(3))], "right or refused", "begins late"),
    "filter of half a tau": Case(lambda b: [smoothed(b.step(), 0.5 * PLATE.tau)], "right or refused", "filter is stated|begins late|no known effect"),
    "rows settled, said to be instant": Case(lambda b: [replace(settled(b), sampling="instant")]),
    "amplifier clips the larger steps": Case(
        lambda b: [felt(b, v := levels(b, (0.5, 1.0, 0.0, 1.0)), np.minimum(v, 70.0))], "refused", "not proportional to the drive"),
    "amplifier with a dead zone": Case(
        lambda b: [felt(b, v := levels(b, (0.3, 1.0, 0.0, 0.6)), np.maximum(v - 15.0, 0.0))], "refused", "not proportional to the drive"),
    "amplifier with hysteresis": Case(
        lambda b: [felt(b, v := levels(b, (0.3, 1.0, 0.5, 0.8)), held_back(v, 15.0))], "refused", "not proportional to the drive|no known effect|falls with another"),
    "source whose phase jumps": Case(lambda b: [jumping_source(b)], "refused or open", "no known effect|cannot tell|second"),
    "gain that changes between logs": Case(lambda b: [b.step(), spoilt(b.sweep(), lambda y: 1.3 * y)], "refused", "G contradicts"),
    "sign of q, sweep": Case(lambda b: [spoilt(b.sweep(), np.conj)], "refused or open", "phase_sign"),
    "sign of q, step and sweep": Case(lambda b: [spoilt(b.step(off=3.0), np.conj), spoilt(b.sweep(), np.conj)], "refused", "phase_sign"),
    "sign of q, in one of two": Case(lambda b: [spoilt(b.step(off=3.0), np.conj), b.sweep()], "right or refused", "contradicts|phase_sign"),
    "sign of d, sweep": Case(lambda b: [spoilt(b.sweep(), lambda y: -y.conj())], "refused or open", "phase_sign"),
    "d and q swapped, sweep": Case(lambda b: [spoilt(b.sweep(), lambda y: y.imag + 1j * y.real)], "refused or open", "phase_sign"),
    "amplitude and phase called d and q": Case(
        lambda b: [spoilt(b.sweep(), lambda y: np.abs(y) + 1j * np.degrees(np.angle(y)))], "refused or open", "no known effect|phase_sign|cannot tell"),
}  # fmt: skip

THE_FILE_IS_WRONG = {
    "time backwards": Case(
        lambda b: through_csv(b.step(), lambda text: "\n".join([*(r := text.split("\n"))[:3], *r[:2:-1]])), "refused", "time|expected"),
    "voltage and frequency swapped": Case(
        lambda b: through_csv(b.step(), swapped("voltage_V", "frequency_Hz")), "refused or open", "called the other"),
    "time and frequency swapped": Case(
        lambda b: through_csv(b.step(), swapped("time_s", "frequency_Hz")), "refused or open", "one moment|time|cannot tell"),
    "frequency in kHz called Hz, in one of two": Case(
        lambda b: [b.step(), (log := b.sweep(), replace(log, frequency=log.frequency / 1e3))[1]], "refused", "contradicts"),
    "time in ms called s, in one of two": Case(
        lambda b: [(log := b.step(), replace(log, time=1e3 * log.time))[1], b.sweep()], "refused", "contradicts"),
    "time in us called ms, in one of two": Case(
        lambda b: [(log := b.step(), replace(log, time=1e-3 * log.time))[1], b.sweep()], "refused", "contradicts"),
    "response in nm called um, in one of two": Case(
        lambda b: [b.step(), spoilt(b.sweep(), lambda y: 1e3 * y)], "refused", "G contradicts"),
    "drive in mV called V, in one of two": Case(
        lambda b: [b.step(), (log := b.sweep(), replace(log, drive=1e3 * log.drive))[1]], "refused", "G contradicts"),
    "rms called peak, in one of two": Case(lambda b: [b.step(), spoilt(b.sweep(), lambda y: y / np.sqrt(2))], "refused", "G contradicts"),
    "kelvin called degC": Case(lambda b: [called_degC(b.sweep())], "right or flagged", "kelvin"),
    "kelvin called degC, in one of two": Case(
        lambda b: through_csv(b.sweep(), str, called_degC(b.sweep(degC=30.0))), "flagged or refused", "kelvin|temperature"),
    "degC called kelvin": Case(lambda b: through_csv(b.sweep(), renamed("temperature_degC", "temperature_K")), "right or flagged", "temperature"),
    "frequency rounded to 50 Hz": Case(
        lambda b: [(log := b.sweep(), replace(log, frequency=50 * np.round(log.frequency / 50)))[1]], "right or refused", "drifts|not noise"),
    "frequency recorded off, in one of two": Case(
        lambda b: [(log := b.step(), replace(log, frequency=log.frequency + 10 * HALF))[1], b.sweep()], "refused", "contradicts"),
}  # fmt: skip

NO_LOG_CAN_TELL = {
    "lone sweep in kHz called Hz": Case(
        lambda b: [(log := b.sweep(), replace(log, frequency=log.frequency / 1e3))[1]], UNDETECTABLE),
    "clock a thousand times too slow": Case(lambda b: [(log := b.step(), replace(log, time=1e3 * log.time))[1]], UNDETECTABLE),
    "peak to peak called peak": Case(
        lambda b: [spoilt(b.step(), lambda y: 2 * y), spoilt(b.sweep(), lambda y: 2 * y)], UNDETECTABLE),
    "frequency recorded 10 half bandwidths off": Case(
        lambda b: [(log := b.sweep(), replace(log, frequency=log.frequency + 10 * HALF))[1]], UNDETECTABLE),
    "sign of q, lone step": Case(lambda b: [spoilt(b.step(off=3.0), np.conj)], UNDETECTABLE),
    "d and q swapped, lone step": Case(lambda b: [spoilt(b.step(off=3.0), lambda y: y.imag + 1j * y.real)], UNDETECTABLE),
    "warming that is not recorded": Case(
        lambda b: [replace(b.sweep(degC=np.linspace(24, 34, ROWS)), temperature=None)], UNDETECTABLE,
        truth={"f0": PLATE.f0 + 5 * PLATE.k_T}),
}  # fmt: skip

GROUPS = {
    "Nothing is wrong": NOTHING_IS_WRONG,
    "Rows are spoilt": ROWS_ARE_SPOILT,
    "Windows": WINDOWS,
    "The plate is another": THE_PLATE_IS_ANOTHER,
    "The bench is another": THE_BENCH_IS_ANOTHER,
    "The file says what is not so": THE_FILE_IS_WRONG,
}
CASES: dict[str, Case] = {
    name: case for group in (*GROUPS.values(), NO_LOG_CAN_TELL) for name, case in group.items()
}
