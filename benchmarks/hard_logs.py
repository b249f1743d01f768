"""Logs that ought to be hard: read and fitted right, refused, flagged, or silently wrong?  python benchmarks/hard_logs.py

Each case spoils, or merely stretches, logs of the paper's plate (120 rows, noise of 1 % of the settled response per channel, a
rotated demodulator). It is made from each of a few seeds and fitted, and so it is with `scipy.optimize.least_squares`: the exact model
again, with a rotation and an offset per log, started from the peak and the width of a sweep or from the rise of a step. An answer is

    right            successful, tau determined, nothing more than FAR standard deviations off the plate the log was made from
    open             successful as far as it goes, but tau or G is called undetermined
    refused          not read, or not called successful
    flagged          successful and further off, but a warning is printed
    silently wrong   successful and further off, without a warning

Where what is spoiled cannot be seen in the log, as a clock that runs a thousand times too slow, no program can do better than
`silently wrong`; these cases say so. Responses: `tests/reference.py`, which shares no code with the package. Writes hard_logs.md.

    --seeds N       how many of each (default 3)          --only NAME   cases whose name holds NAME; printed in full, not written
"""

import argparse
import os
import re
import runpy
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.optimize import least_squares

from sysid import Log, LogError, fit, read_logs
from sysid.log import write_log
from sysid.precision import keep_programs

HERE = Path(__file__).parent
reference = SimpleNamespace(**runpy.run_path(str(HERE.parent / "tests" / "reference.py"), run_name="reference"))
ROWS, EARLY = 120, 12  # of every log, and before its step, so that few programs are compiled
PLATE = reference.Plant(G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=-10.16)
VOLTS, NOISE = 100.0, 0.01  # settled response 2 um, noise 0.02 um in each channel
HALF = 1 / (2 * np.pi * PLATE.tau)  # half a bandwidth, Hz
FAR = 4.0  # standard deviations: chance does it once in 16 000
Make = Callable[["Bench"], list[Log]]


@dataclass
class Bench:
    """What makes the logs of one seed."""

    rng: np.random.Generator
    plant: SimpleNamespace = PLATE
    noise: float = NOISE

    def rows(self, clean: np.ndarray, turn: float = 0.3) -> np.ndarray:
        """Behind a rotated demodulator, with noise."""
        size = self.noise * self.plant.G * VOLTS
        return clean * np.exp(1j * turn) + size * (self.rng.standard_normal(len(clean)) + 1j * self.rng.standard_normal(len(clean)))

    def step(self, window: float = 12.0, off: float = 0.5, drive=None, frequency=None, degC: float = 24.0, early=EARLY) -> Log:
        """A step to VOLTS at `off` half bandwidths beside resonance, over `window` tau; or another drive."""
        time = window * self.plant.tau * (np.arange(ROWS) - early) / (ROWS - early)
        volts = VOLTS * (np.arange(ROWS) >= early) if drive is None else drive
        f = np.broadcast_to(self.plant.f0 + self.plant.k_T * (degC - 24) + off * HALF if frequency is None else frequency, ROWS)
        clean = reference.ringing(self.plant, time, volts, f, np.full(ROWS, degC))
        return Log("step", self.rows(clean), time - time[0], volts, f, np.full(ROWS, degC), kind="transient", sampling="instant")

    def sweep(self, low: float = -8.0, high: float = 8.0, degC=24.0, drive: float = VOLTS) -> Log:
        """Settled points from `low` to `high` half bandwidths about the resonance at 24 degC."""
        f = self.plant.f0 + HALF * np.linspace(low, high, ROWS)
        warm = np.broadcast_to(np.asarray(degC, float), ROWS)
        clean = reference.steady(self.plant, drive, f, warm)
        return Log("sweep", self.rows(clean), None, np.full(ROWS, drive), f, warm, kind="steady")


# --- ways to spoil a log ---------------------------------------------------------------------------------------------------


def spoilt(log: Log, change: Callable[[np.ndarray], np.ndarray]) -> Log:
    return replace(log, response=change(np.array(log.response)))


def clipped(level: float, both: bool = True) -> Callable[[np.ndarray], np.ndarray]:
    low = -level if both else -np.inf
    return lambda y: np.clip(y.real, low, level) + 1j * np.clip(y.imag, low, level if both else np.inf)


def outliers(b: Bench, share: float, size: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        hit = b.rng.random(len(y)) < share
        return y + hit * size * 2 * (b.rng.standard_normal(len(y)) + 1j * b.rng.standard_normal(len(y)))

    return change


def dropped(first: int, last: int, held: bool) -> Callable[[np.ndarray], np.ndarray]:
    return lambda y: np.where((np.arange(len(y)) >= first) & (np.arange(len(y)) < last), y[first - 1] if held else 0.0, y)


def quantised(levels: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        lsb = 2 * np.max(np.abs(y)) / (levels - 1)
        return lsb * (np.round(y.real / lsb) + 1j * np.round(y.imag / lsb))

    return change


def coloured(b: Bench, rho: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(y):
        extra = 0.02 * (b.rng.standard_normal(len(y)) + 1j * b.rng.standard_normal(len(y)))
        for k in range(1, len(y)):
            extra[k] = rho * extra[k - 1] + np.sqrt(1 - rho**2) * extra[k]
        return y + extra

    return change


def late(rows: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda y: np.concatenate([y[:1].repeat(rows), y[:-rows]])


def smoothed(log: Log, tau: float) -> Log:
    """Behind a one-pole filter, exact for a response that is straight from row to row."""
    y, keep = np.array(log.response), np.exp(-np.diff(log.time) / tau)
    for k in range(1, len(y)):
        y[k] = keep[k - 1] * y[k - 1] + (1 - keep[k - 1]) * (log.response[k] + log.response[k - 1]) / 2
    return replace(log, response=y)


def amplitude(log: Log) -> Log:
    return replace(log, response=np.abs(log.response))


def picked(log: Log, index) -> Log:
    """Some of the rows."""
    names = ("response", "time", "drive", "frequency", "temperature")
    return replace(log, **{n: v[index] for n in names if (v := getattr(log, n)) is not None})


def through_csv(log: Log, edit: Callable[[str], str], *others: Log) -> list[Log]:
    """What the reader makes of the log's file once it is edited, and of the others' files."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"log{k}.csv" for k in range(1 + len(others))]
        for path, one in zip(paths, (log, *others), strict=True):
            write_log(one, path)
        paths[0].write_text(edit(paths[0].read_text(encoding="utf-8")), encoding="utf-8")
        return read_logs(paths)


def called_degC(log: Log) -> Log:
    return replace(log, temperature=log.temperature + 273.15)


def renamed(old: str, new: str) -> Callable[[str], str]:
    def edit(text: str) -> str:
        assert old in text, text[:200]
        return text.replace(old, new, 1)

    return edit


def duffing(b: Bench, shift: float, back: bool = False) -> Log:
    """A sweep whose resonance falls by `shift` half bandwidths at G V, in proportion to W^2; up, or down where `back`."""
    log, w = b.sweep(), 0.0
    f = log.frequency[::-1] if back else log.frequency
    found = np.zeros(ROWS, complex)
    for k in range(ROWS):
        for _ in range(400):
            moved = replace(b.plant, f0=b.plant.f0 - shift * HALF * (w / (b.plant.G * VOLTS)) ** 2)
            new = reference.steady(moved, VOLTS, f[k : k + 1], np.array([24.0]))[0]
            w = 0.9 * w + 0.1 * abs(new)
        found[k] = new
    return replace(log, response=b.rows(found), frequency=f)


def hurried(b: Bench, dwell: float) -> Log:
    """A sweep that stays `dwell` tau at each frequency, said to be settled."""
    log, time = b.sweep(), dwell * b.plant.tau * np.arange(ROWS + 1)
    f = np.append(log.frequency, log.frequency[-1])
    clean = reference.ringing(b.plant, time, np.full(ROWS + 1, VOLTS), f, np.full(ROWS + 1, 24.0))[1:]
    return replace(log, response=b.rows(clean))


def touched(b: Bench, recorded: bool) -> Log:
    """A finger damps the plate twice as much in the second half of a step."""
    log = b.step(window=24.0)
    tau = np.where(np.arange(ROWS) < ROWS // 2, b.plant.tau, b.plant.tau / 2)
    clean = reference.ringing(b.plant, log.time, log.drive, log.frequency, log.temperature, tau)
    return replace(log, response=b.rows(clean), force=1.5 * (tau < b.plant.tau) if recorded else None)


def levels(b: Bench, sizes: Sequence[float]) -> np.ndarray:
    """A staircase of drives."""
    return VOLTS * np.append(np.zeros(EARLY), np.repeat(sizes, (ROWS - EARLY) // len(sizes)))[:ROWS]


def felt(b: Bench, asked: np.ndarray, given: np.ndarray) -> Log:
    """The plate feels another drive than the one recorded."""
    return replace(b.step(window=24.0, drive=given), drive=asked)


def other(b: Bench, **changes: float) -> Bench:
    """The bench with another plate on it."""
    return replace(b, plant=replace(b.plant, **changes))


UNSEEN = " (cannot be seen)"
CASES: dict[str, Make] = {
    # nothing is wrong
    "step": lambda b: [b.step()],
    "sweep": lambda b: [b.sweep()],
    "step and sweep": lambda b: [b.step(), b.sweep()],
    "sweep downwards": lambda b: [picked(b.sweep(), np.arange(ROWS)[::-1])],
    "sweep in no order": lambda b: [picked(b.sweep(), b.rng.permutation(ROWS))],
    "step to a negative voltage": lambda b: [b.step(drive=-VOLTS * (np.arange(ROWS) >= EARLY))],
    "step that beats, 6 half bandwidths off": lambda b: [b.step(off=6.0)],
    "random steps of the drive": lambda b: [b.step(window=30, drive=VOLTS * np.repeat(b.rng.random(24), 5))],
    "window of 100 tau": lambda b: [b.step(window=100.0)],
    "irregular time stamps": lambda b: [irregular(b)],
    "gap in time": lambda b: [picked(b.step(window=16), np.r_[0:30, 60:ROWS])],
    "rows twice": lambda b: [picked(b.step(), np.sort(np.r_[0:60, 0:60]))],
    "time since 1970": lambda b: [(lambda log: replace(log, time=log.time + 1.7e9))(b.step())],
    "response in 1e12": lambda b: [spoilt(b.step(), lambda y: 1e12 * y), spoilt(b.sweep(), lambda y: 1e12 * y)],
    "response in 1e-12": lambda b: [spoilt(b.step(), lambda y: 1e-12 * y), spoilt(b.sweep(), lambda y: 1e-12 * y)],
    "feedthrough three times the resonance": lambda b: [spoilt(b.sweep(), lambda y: y + 6 * np.exp(1j))],
    "sweep on a slope": lambda b: [spoilt(b.sweep(), lambda y: y + (0.5 - 0.7j) * np.linspace(-1, 1, ROWS))],
    "sweeps at two temperatures": lambda b: [b.sweep(degC=24.0), b.sweep(-10, 6, degC=34.0)],
    "drive off at 0 Hz": lambda b: [replace(log := b.step(), frequency=np.where(log.drive > 0, log.frequency, 0.0))],
    # rows
    "clipped on both sides": lambda b: [spoilt(b.step(), clipped(1.2))],
    "clipped on one side": lambda b: [spoilt(b.step(), clipped(1.2, both=False))],
    "clipped by 3 %": lambda b: [spoilt(b.step(off=0.0), clipped(1.85))],
    "sweep clipped at its peak": lambda b: [spoilt(b.sweep(), clipped(1.2))],
    "sweep clipped softly": lambda b: [spoilt(b.sweep(), lambda y: 2 * np.tanh(np.abs(y) / 2) * np.exp(1j * np.angle(y)))],
    "5 % outliers, step": lambda b: [spoilt(b.step(), outliers(b, 0.05, 1.0))],
    "5 % outliers, sweep": lambda b: [spoilt(b.sweep(), outliers(b, 0.05, 1.0))],
    "20 % outliers, sweep": lambda b: [spoilt(b.sweep(), outliers(b, 0.2, 1.0))],
    "one outlier of a thousand": lambda b: [spoilt(b.step(), lambda y: y + 2000.0 * (np.arange(ROWS) == 70))],
    "drop-out to zero": lambda b: [spoilt(b.step(), dropped(60, 75, held=False))],
    "drop-out in the rise": lambda b: [spoilt(b.step(), dropped(15, 22, held=False))],
    "drop-out that holds": lambda b: [spoilt(b.step(), dropped(16, 30, held=True))],
    "sweep with a drop-out": lambda b: [spoilt(b.sweep(), dropped(55, 62, held=True))],
    "three levels": lambda b: [spoilt(b.step(), quantised(3))],
    "nine levels": lambda b: [spoilt(b.step(), quantised(9))],
    "sweep of nine levels": lambda b: [spoilt(b.sweep(), quantised(9))],
    "noise that remembers": lambda b: [spoilt(b.step(), coloured(b, 0.95))],
    "noise in proportion": lambda b: [spoilt(b.sweep(), lambda y: y * (1 + 0.05 * b.rng.standard_normal(ROWS)))],
    "noise larger than the response": lambda b: [replace(b, noise=3.0).step()],
    "noise alone": lambda b: [spoilt(b.step(), lambda y: 0.02 * b.rng.standard_normal(ROWS) + 0j)],
    "constant": lambda b: [spoilt(b.step(), lambda y: np.full(ROWS, 1.3 - 0.2j))],
    "zeros": lambda b: [spoilt(b.step(), lambda y: np.zeros(ROWS, complex))],
    "baseline that drifts": lambda b: [spoilt(b.step(), lambda y: y + 0.4 * np.linspace(0, 1, ROWS))],
    "baseline that jumps": lambda b: [spoilt(b.step(), lambda y: y + 0.3 * (np.arange(ROWS) > 60))],
    "hum": lambda b: [spoilt(b.step(), lambda y: y + 0.1 * np.sin(np.arange(ROWS) / 6))],
    "demodulator that turns": lambda b: [spoilt(b.step(), lambda y: y * np.exp(0.5j * np.linspace(0, 1, ROWS)))],
    "phase that jumps": lambda b: [spoilt(b.step(), lambda y: y * np.exp(1j * (np.arange(ROWS) > 60)))],
    # windows
    "window of 0.05 tau": lambda b: [b.step(window=0.05)],
    "window of 0.1 tau": lambda b: [b.step(window=0.1)],
    "window of 0.3 tau": lambda b: [b.step(window=0.3)],
    "window of 1 tau": lambda b: [b.step(window=1.0)],
    "rows 10 tau apart": lambda b: [b.step(window=1000.0)],
    "step before the first row": lambda b: [picked(b.step(), np.arange(20, ROWS))],
    "step at the first row": lambda b: [b.step(early=0)],
    "one row": lambda b: [picked(b.step(), np.arange(60, 61))],
    "two rows": lambda b: [picked(b.step(), np.arange(11, 13))],
    "three rows": lambda b: [picked(b.step(), np.array([11, 20, 60]))],
    "drive of zero": lambda b: [replace(spoilt(b.step(), lambda y: 0.02 * b.rng.standard_normal(ROWS) + 0j), drive=np.zeros(ROWS))],
    "peak beyond the sweep": lambda b: [b.sweep(5, 12)],
    "peak at the edge": lambda b: [b.sweep(0, 10)],
    "half a peak": lambda b: [b.sweep(-0.5, 10)],
    "far beside the peak": lambda b: [b.sweep(20, 30)],
    "sweep of 0.1 half bandwidths": lambda b: [b.sweep(-0.05, 0.05)],
    "sweep of five points": lambda b: [picked(b.sweep(), np.arange(0, ROWS, 25))],
    "one frequency": lambda b: [replace(log := b.sweep(-0.5, -0.5), frequency=np.full(ROWS, log.frequency[0]))],
    "peak between two points": lambda b: [picked(b.sweep(-101, 99), np.arange(0, ROWS, 2))],
    # the plate is another
    "two peaks": lambda b: [two_peaks(b, 6.0)],
    "two peaks in one": lambda b: [two_peaks(b, 1.0)],
    "dip": lambda b: [spoilt(b.sweep(), lambda y: 2 * np.exp(0.3j) - y)],
    "resonance that softens": lambda b: [duffing(b, 0.5)],
    "resonance that jumps, upwards": lambda b: [duffing(b, 4.0)],
    "resonance that jumps, downwards": lambda b: [duffing(b, 4.0, back=True)],
    "sweep too fast, 3 tau": lambda b: [hurried(b, 3.0)],
    "sweep too fast, 0.3 tau": lambda b: [hurried(b, 0.3)],
    "warming that is not recorded" + UNSEEN: lambda b: [replace(b.sweep(degC=np.linspace(24, 34, ROWS)), temperature=None)],
    "finger, not recorded": lambda b: [touched(b, recorded=False)],
    "finger, recorded": lambda b: [touched(b, recorded=True)],
    "two plates, far apart": lambda b: [b.sweep(), other(b, f0=PLATE.f0 + 20 * HALF).step()],
    "two plates, alike": lambda b: [b.sweep(), other(b, f0=PLATE.f0 + 0.5 * HALF, tau=1.1 * PLATE.tau).sweep()],
    "two plates, named": lambda b: plates(b),
    "Q of 2": lambda b: [(low := other(b, f0=2 / (np.pi * PLATE.tau))).step(off=0.0), low.sweep(-1.5, 8)],
    "Q of a million": lambda b: [(quartz := other(b, f0=1e6 / (np.pi * PLATE.tau))).step(), quartz.sweep()],
    # the bench is another
    "trigger late by three rows": lambda b: [spoilt(b.step(), late(3))],
    "filter of half a tau": lambda b: [smoothed(b.step(), 0.5 * PLATE.tau)],
    "filter of half a tau, stated": lambda b: [replace(smoothed(b.step(), 0.5 * PLATE.tau), bench={"lockin_tau_s": 0.5 * PLATE.tau})],
    "rows settled, said to be instant": lambda b: [replace(settled(b), sampling="instant")],
    "amplifier clips the larger steps": lambda b: [felt(b, v := levels(b, (0.5, 1.0, 0.0, 1.0)), np.minimum(v, 70.0))],
    "amplifier with a dead zone": lambda b: [felt(b, v := levels(b, (0.3, 1.0, 0.0, 0.6)), np.maximum(v - 15.0, 0.0))],
    "gain that changes between logs": lambda b: [b.step(), spoilt(b.sweep(), lambda y: 1.3 * y)],
    "sign of q, sweep": lambda b: [spoilt(b.sweep(), np.conj)],
    "sign of q, step": lambda b: [spoilt(b.step(off=3.0), np.conj)],
    "sign of q, step and sweep": lambda b: [spoilt(b.step(off=3.0), np.conj), spoilt(b.sweep(), np.conj)],
    "sign of q, in one of two": lambda b: [spoilt(b.step(off=3.0), np.conj), b.sweep()],
    "sign of d, sweep": lambda b: [spoilt(b.sweep(), lambda y: -y.conj())],
    "d and q swapped, sweep": lambda b: [spoilt(b.sweep(), lambda y: y.imag + 1j * y.real)],
    "d and q swapped, step": lambda b: [spoilt(b.step(off=3.0), lambda y: y.imag + 1j * y.real)],
    "amplitude alone, sweep": lambda b: [amplitude(b.sweep())],
    "amplitude alone, step beside resonance": lambda b: [amplitude(b.step(off=2.0))],
    "amplitude and phase called d and q": lambda b: [spoilt(b.sweep(), lambda y: np.abs(y) + 1j * np.degrees(np.angle(y)))],
    # the file says what is not so
    "time backwards": lambda b: through_csv(b.step(), lambda text: "\n".join([*(r := text.split("\n"))[:3], *r[:2:-1]])),
    "a cell without a number": lambda b: through_csv(b.step(), renamed("100.0", "nan")),
    "voltage and frequency swapped": lambda b: through_csv(b.step(), swapped("voltage_V", "frequency_Hz")),
    "time and frequency swapped": lambda b: through_csv(b.step(), swapped("time_s", "frequency_Hz")),
    "frequency in kHz called Hz" + UNSEEN: lambda b: [(log := b.sweep(), replace(log, frequency=log.frequency / 1e3))[1]],
    "frequency in kHz called Hz, in one of two": lambda b: [b.step(), (log := b.sweep(), replace(log, frequency=log.frequency / 1e3))[1]],
    "time in ms called s" + UNSEEN: lambda b: [(log := b.step(), replace(log, time=1e3 * log.time))[1]],
    "time in ms called s, in one of two": lambda b: [(log := b.step(), replace(log, time=1e3 * log.time))[1], b.sweep()],
    "time in us called ms, in one of two": lambda b: [(log := b.step(), replace(log, time=1e-3 * log.time))[1], b.sweep()],
    "response in nm called um, in one of two": lambda b: [b.step(), spoilt(b.sweep(), lambda y: 1e3 * y)],
    "drive in mV called V, in one of two": lambda b: [b.step(), (log := b.sweep(), replace(log, drive=1e3 * log.drive))[1]],
    "rms called peak, in one of two": lambda b: [b.step(), spoilt(b.sweep(), lambda y: y / np.sqrt(2))],
    "peak to peak called peak" + UNSEEN: lambda b: [spoilt(b.step(), lambda y: 2 * y), spoilt(b.sweep(), lambda y: 2 * y)],
    "kelvin called degC": lambda b: [called_degC(b.sweep())],
    "kelvin called degC, in one of two": lambda b: through_csv(b.sweep(), str, called_degC(b.sweep(degC=30.0))),
    "degC called kelvin": lambda b: through_csv(b.sweep(), renamed("temperature_degC", "temperature_K")),
    "frequency rounded to 50 Hz": lambda b: [(log := b.sweep(), replace(log, frequency=50 * np.round(log.frequency / 50)))[1]],
    "frequency recorded 10 half bandwidths off" + UNSEEN: lambda b: [(log := b.sweep(), replace(log, frequency=log.frequency + 10 * HALF))[1]],
    "frequency recorded off, in one of two": lambda b: [(log := b.step(), replace(log, frequency=log.frequency + 10 * HALF))[1], b.sweep()],
    "the same log twice, with other noise": lambda b: [b.step(), b.step()],
}  # fmt: skip


def irregular(b: Bench) -> Log:
    log = b.step()
    time = np.sort(b.rng.uniform(0, log.time[-1], ROWS))
    volts = VOLTS * (np.arange(ROWS) >= EARLY)
    clean = reference.ringing(b.plant, time, volts, log.frequency, log.temperature)
    return replace(log, time=time, response=b.rows(clean))


def settled(b: Bench) -> Log:
    """Each row's response is the one that its own inputs have led to."""
    log = b.step()
    return picked(replace(log, drive=np.append(log.drive[1:], VOLTS)), np.arange(ROWS))


def two_peaks(b: Bench, apart: float) -> Log:
    log = b.sweep()
    second = replace(b.plant, f0=b.plant.f0 + apart * HALF, G=0.5 * b.plant.G)
    return spoilt(log, lambda y: y + reference.steady(second, VOLTS, log.frequency, log.temperature) * np.exp(0.3j))


def plates(b: Bench) -> list[Log]:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.csv" for name in ("A7", "B2")]
        for path in paths:
            write_log(replace(b.sweep(), metadata={"plate": path.stem}), path)
        return read_logs(paths)


def swapped(first: str, second: str) -> Callable[[str], str]:
    return lambda text: text.replace(first, "~").replace(second, first).replace("~", second)


# --- answers -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """What one program makes of one case and seed; z: largest |value - truth|/std of what it calls determined."""

    verdict: str
    z: float = 0.0
    said: str = ""


def ours(make: Make, seed: int) -> Answer:
    """The answer of this package."""
    b = Bench(np.random.default_rng(seed))
    try:
        logs = make(b)
        found = fit(logs)
    except LogError as error:
        return Answer("refused", said=str(error).rpartition("/")[2])
    except Exception as error:
        return Answer("raised", np.inf, f"{type(error).__name__}: {error}")
    values = {n: p for n, p in found.parameters.items() if p.determined}
    at = 24.0 if found.reference_temperature is None else found.reference_temperature
    truth = truths(make, seed, at)
    apart = {n: (p.value - truth[n]) / p.std for n, p in values.items()}
    z = max(map(abs, apart.values()), default=0.0)
    lines = [f"{n} {p.value:.6g} +- {p.std:.2g} ({apart[n]:+.1f})" for n, p in values.items()]
    why = [f"{n}: {p.why}" for n, p in found.parameters.items() if not p.determined]
    said = " | ".join([found.result.name, *lines, *why, *(f"warning: {w}" for w in found.warnings)])
    if found.result.name != "successful":
        return Answer("open" if found.result.name == "undetermined" else "refused", z, said)
    if z <= FAR:
        return Answer("right" if "tau" in values else "open", z, said)
    notes = [note for one in logs for note in one.notes]
    return Answer("flagged" if found.warnings or notes else "silently wrong", z, " | ".join([said, *notes]))


def truths(make: Make, seed: int, at: float) -> dict[str, float]:
    """Of the plate that the case is about; f0 at the temperature of the fit's own."""
    plant = Bench(np.random.default_rng(seed)).plant
    for name, f0 in (("Q of 2", 2), ("Q of a million", 1e6)):
        if make is CASES[name]:
            plant = replace(plant, f0=f0 / (np.pi * PLATE.tau))
    unit = {CASES["response in 1e12"]: 1e12, CASES["response in 1e-12"]: 1e-12}.get(make, 1.0)
    recorded = 24.0 if abs(at - 24.0) > 100 else at  # kelvin called degC: the number is another, the temperature is not
    recorded = 29.0 if make is CASES["warming that is not recorded" + UNSEEN] else recorded  # on the average
    return {"G": plant.G * unit, "tau": plant.tau, "f0": plant.f0 + plant.k_T * (recorded - 24.0), "k_T": plant.k_T}


def plain(make: Make, seed: int) -> Answer:
    """The answer of least squares as a user of scipy would write them."""
    try:
        logs = make(Bench(np.random.default_rng(seed)))
    except LogError:
        return Answer("refused")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return _least_squares(logs, truths(make, seed, float(np.mean(logs[0].temperature if logs[0].temperature is not None else 24))))
    except Exception as error:  # a singular matrix, residuals that are not finite: an error is an answer
        return Answer("refused", said=f"{type(error).__name__}: {error}")


def _least_squares(logs: list[Log], truth: dict[str, float]) -> Answer:
    scale = max(float(np.max(np.abs(log.response))) for log in logs) or 1.0
    drive = max(float(np.max(np.abs(log.drive))) for log in logs) or 1.0

    def residual(p: np.ndarray) -> np.ndarray:
        G, tau, f0 = np.exp(p[0]) * scale / drive, np.exp(p[1]), p[2] / np.exp(p[1])
        plant, parts = reference.Plant(G=G, tau=tau, f0=f0, k_T=0.0), []
        for k, log in enumerate(logs):
            zeros = np.zeros(len(log))
            cold = zeros + 24.0
            z = reference.steady(plant, log.drive, log.frequency, cold) if log.time is None or log.kind == "steady" else (
                reference.ringing(plant, log.time, log.drive, log.frequency, cold))  # fmt: skip
            z = z * np.exp(1j * p[3 + 3 * k]) + scale * (p[4 + 3 * k] + 1j * p[5 + 3 * k])
            parts.append((np.abs(z) - log.response) / scale if log.amplitude_only else (z - log.response) / scale)
        stacked = np.concatenate(parts)
        return np.concatenate([stacked.real, stacked.imag]) if np.iscomplexobj(stacked) else stacked

    sweep = next((log for log in logs if log.kind == "steady"), None)
    if sweep is not None:
        size = np.abs(sweep.response)
        near = sweep.frequency[size > np.max(size) / np.sqrt(2)]
        f0, tau = float(sweep.frequency[np.argmax(size)]), 1 / (np.pi * max(float(np.ptp(near)), 1e-3))
    else:
        size, log = np.abs(logs[0].response), logs[0]
        risen = log.time[np.argmax(size > 0.63 * np.median(size[-10:]))] - log.time[np.argmax(log.drive != 0)]
        f0, tau = float(log.frequency[-1]), max(float(risen), 1e-9)
    first = np.concatenate([[0.0, np.log(tau), f0 * tau], np.zeros(3 * len(logs))])
    found = least_squares(residual, first, x_scale=np.append([1.0, 1.0, 0.05], np.ones(3 * len(logs))), max_nfev=300)
    rows = len(found.fun)
    if not found.success or rows <= len(found.x):
        return Answer("refused", said="did not converge")
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (rows - len(found.x))
    carry = np.array([[np.exp(found.x[0]) * scale / drive, 0, 0], [0, np.exp(found.x[1]), 0], [0, -found.x[2] / np.exp(found.x[1]), 1 / np.exp(found.x[1])]])
    std = np.sqrt(np.diag(carry @ covariance[:3, :3] @ carry.T))
    values = dict(zip(("G", "tau", "f0"), (carry[0, 0], carry[1, 1], found.x[2] / np.exp(found.x[1])), strict=True))
    told = [n for n, s in zip(values, std, strict=True) if np.isfinite(s) and s < (0.2 * values[n] if n != "f0" else 0.5 / (2 * np.pi * values["tau"]))]
    apart = {n: abs(values[n] - truth[n]) / std[k] for k, n in enumerate(values) if n in told}
    z = max(apart.values(), default=0.0)
    verdict = "silently wrong" if z > FAR else "right" if "tau" in told else "open"
    return Answer(verdict, z, ", ".join(f"{n} {v:.6g} +- {s:.2g}" for (n, v), s in zip(values.items(), std, strict=True)))


# --- the table ------------------------------------------------------------------------------------------------------------


VERDICTS = ("right", "open", "refused", "flagged", "silently wrong", "raised")


def table(found: dict[str, list[Answer]], plainly: dict[str, list[Answer]], command: str) -> str:
    """The study as Markdown."""
    lines = ["# Hard logs", "", f"Made by `{command}`.", "", __doc__.partition("\n\n")[2].partition("\n\n    --")[0], ""]
    lines += ["| answers of " + " | ".join(["", *VERDICTS]) + " |", "|" + "---|" * (len(VERDICTS) + 1)]
    for who, answers in (("sysid", found), ("scipy", plainly)):
        counts = Counter(a.verdict for of in answers.values() for a in of)
        lines.append(f"| {who} | " + " | ".join(str(counts[v]) for v in VERDICTS) + " |")
    lines += ["", "| case | sysid | largest z | scipy | largest z |", "|---|---|---|---|---|"]
    for name, of in found.items():
        lines.append(f"| {name} | {said(of)} | {said(plainly[name])} |")
    lines += ["", "What was said of the first seed that was not right, silently wrong first (`--only NAME` shows all):", "", "```"]
    odd = {n: next((a for a in of if a.verdict != "right"), None) for n, of in found.items()}
    order = ("raised", "silently wrong", "flagged", "open", "refused")
    odd = {n: a for n, a in sorted(odd.items(), key=lambda item: item[1] is None or order.index(item[1].verdict)) if a is not None}
    return "\n".join([*lines, *(f"{a.verdict}: {n}: {a.said}" for n, a in odd.items()), "```"]) + "\n"


def said(answers: list[Answer]) -> str:
    counts = Counter(a.verdict for a in answers)
    words = ", ".join(v if n == len(answers) else f"{n} {v}" for v, n in counts.items())
    z = max((a.z for a in answers if a.verdict not in ("refused", "open")), default=0.0)
    return f"{words} | {z:.2g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only")
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    cases = {name: make for name, make in CASES.items() if given.only is None or given.only in name}
    found: dict[str, list[Answer]] = {}
    plainly: dict[str, list[Answer]] = {}
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        for name, make in track(cases.items(), console=Console(stderr=True), disable=given.only is not None):
            found[name] = [ours(make, seed) for seed in range(given.seeds)]
            plainly[name] = [plain(make, seed) for seed in range(given.seeds)]
            for a, p in zip(found[name], plainly[name], strict=True) if given.only else ():
                print(f"{name}: {a.verdict} (z {a.z:.3g})\n    {re.sub(r' [|] ', chr(10) + '    ', a.said)}\n  scipy: {p.verdict} (z {p.z:.3g}) {p.said}")
    if given.only is None:
        (HERE / "hard_logs.md").write_text(table(found, plainly, f"python benchmarks/hard_logs.py --seeds {given.seeds}"), encoding="utf-8")


if __name__ == "__main__":
    main()
