"""Faults of the sensor, and a coarse timer, on random plates:  python benchmarks/faults.py

Writes faults.md beside itself.
"""

import argparse
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from closed_loop import drawn

import controller
from controller.guard import FAULTS
from controller.machine import MODES, RUN

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import replay  # noqa: E402

TAU, T, AT, LAST = 5e-3 / math.log(20), 1e-4, 1000, 1000  # samples until the fault, and after it
SPREAD = 0.2  # of tau: what a bench's plates differ by, and what the design is told that they do; G/tau is that of the design
DRAWS = {
    "tau": TAU * np.linspace(1 - SPREAD, 1 + SPREAD, 400),
    "G": 0.02 * np.linspace(1 - SPREAD, 1 + SPREAD, 400),
}
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16, draws=DRAWS)
LIMIT, WINDOW = 350.0, (32100.0, 32500.0)
LONG = 100_000  # samples of a long run
METHODS = ("paper", "pi", "pll", "adaptive")
REPLAYS = {  # the spoilt reading, of the true and the last one; ms within which the voltage has to end
    "W = 0": (lambda told, last: 0 * told, 10),
    "not a number": (lambda told, last: told * math.nan, 10),
    "stuck": (lambda told, last: last, 50),
    "q reversed": (lambda told, last: np.conj(told), 50),
    "none": (lambda told, last: told, None),
}


def bench(control, f0, tau, spoil, samples, switched=True, timer=None, noise=0.015):
    """V, f, mode, fault, |W|, samples for which Wq answered the wrong way, all (samples, n): n plates of tau and f0 (n,), asked for
    1.5 um, noise of 1 %, one sample of latency."""
    rng, count, xp = np.random.default_rng(0), len(f0), replay.array_of(np.float64)
    state, W = replay.full(control.init(), count, float), np.zeros(count, complex)
    voltage, frequency, last, rows = np.zeros(count), np.full(count, 32300.0), W, []
    knobs = {"enable": np.full(count, True), "reset": np.full(count, False)} if switched else {}
    for k in range(samples):
        told = W + noise * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
        last = told = spoil(told, last) if k >= AT else told
        state, command, said = control.step(state, 1.5, told, None, xp, **knobs)
        made = frequency if timer is None else timer / np.round(timer / frequency)
        pole = -1 / tau + 2j * math.pi * (f0 - made)
        settled = -0.02 / TAU * voltage / pole
        W = settled + (W - settled) * np.exp(pole * T)
        voltage, frequency = command
        found = (
            (said.mode, said.fault, np.abs(W), state.control.suspected.turned)
            if switched
            else (0 * W.real, 0 * W.real, np.abs(W), 0 * W.real)
        )
        rows.append(np.broadcast_arrays(voltage, frequency, *found))  # a number where there was none yet
    return np.array(rows).transpose(1, 0, 2)


def fault_rows(count: int) -> list[str]:
    rng = np.random.default_rng(1)
    f0, tau = 32300.0 + rng.uniform(-60, 60, count), TAU * rng.uniform(1 - SPREAD, 1 + SPREAD, count)
    rows = []
    for method in METHODS:
        loop = controller.design(
            PLATE, method=method, voltage_limit=LIMIT, amplitude=1.5, frequency_window=WINDOW
        )
        for name, (spoil, within) in REPLAYS.items():
            V, f, mode, fault, *_ = bench(loop.machine, f0, tau, spoil, AT + LAST)
            running = int((mode[AT - 1] == RUN).sum())
            driven = 1e3 * T * (V[AT:] != 0).sum(0)  # a latched fault: what was driven lies before it
            called = ", ".join(sorted({FAULTS[int(c)] if c < len(FAULTS) else "lost" for c in fault[-1]}))
            latched = bool((V[-1] == 0).all() and (mode[-1] == MODES.index("fault")).all()) if within else "-"
            inside = bool(np.abs(V).max() <= LIMIT and f.min() >= WINDOW[0] and f.max() <= WINDOW[1])
            ends = (
                f"{np.median(driven):.1f} | {driven.max():.1f} | {(driven > within).sum()} beyond {within} ms"
                if within
                else "- | - | -"
            )
            rows.append(f"| {method} | {name} | {running} | {ends} | {latched} | {called} | {inside} |")
    return rows


def alarm_rows(count: int) -> list[str]:
    """Sound benches: the scenes of closed_loop.md, a resonance to be caught under noise of 1 %, and ten seconds of noise of 5 %."""
    rng, rows = np.random.default_rng(0), []
    scenes = [drawn(rng) for _ in range(count)]
    f0, tau = 32300.0 + rng.uniform(-60, 60, count), TAU * rng.uniform(1 - SPREAD, 1 + SPREAD, count)
    for method in METHODS:
        given = {"method": method, "voltage_limit": LIMIT}
        loop = controller.design(PLATE, **given, frequency_window=(31900.0, 32700.0))
        ended = sum(t.V[-1] == 0 for t in controller.closed_loops(loop, scenes, reference=2.0))
        loop, said = controller.design(PLATE, **given, amplitude=1.5, frequency_window=WINDOW), []
        for noise, samples in ((0.015, 2000), (0.075, LONG)):
            fault, turned = bench(loop.machine, f0, tau, REPLAYS["none"][0], samples, noise=noise)[[3, 5]]
            said.append(f"{(fault[-1] > 0).sum()} | {turned.max():.0f}")
        rows.append(f"| {method} | {ended} | {' | '.join(said)} |")
    return rows


def timer_rows(count: int) -> list[str]:
    f0, rows = 32300.0 + np.linspace(-10.4, 10.4, count), []
    for method in METHODS[1:]:
        rig = controller.Rig(timer=1e8)
        given = {"voltage_limit": LIMIT, "amplitude": 1.5, "frequency_window": WINDOW, "guard": False}
        law = controller.design(PLATE, method=method, rig=rig, **given).law
        _, f, _, _, W, _ = bench(law, f0, np.full(count, TAU), lambda told, last: told, 11000, False, 1e8)
        lost = 100 * (1 - W[1000:].mean(0) / 1.5)
        changes = (np.diff(f[1000:], axis=0) != 0).sum(0)
        rows.append(
            f"| {method} | {(changes == 1).sum()} | {(changes > 1).sum()} | {lost.max():.3f} | {-lost.min():.3f} | {np.abs(f[-1] - f0).max():.2f} |"
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plates", type=int, default=200)
    given = parser.parse_args()
    line = "\n"
    doubts = controller.design(PLATE, voltage_limit=LIMIT, frequency_window=WINDOW).machine.control.doubts
    text = f"""# Faults, and a coarse timer

Made by `python benchmarks/faults.py --plates {given.plates}`. Plates of tau {100 * SPREAD:g} % (the design is told so) and f0 60 Hz about the design's, at 10 kHz with one
sample of latency; 1.5 um asked for, noise of 1 %, voltage up to {LIMIT:g} V, frequencies {WINDOW[0]:g} to {WINDOW[1]:g} Hz.

## Faults

What is exported is switched on; after {1e3 * AT * T:g} ms the reading is spoilt, for another {1e3 * LAST * T:g} ms. Driven: how long the voltage is not zero from
then on. "none": a sound sensor, as long.

| method | reading | in run before it, of {given.plates} | driven (ms), median | most | plates beyond what is allowed | all latched | called | V and f within limits |
|---|---|---|---|---|---|---|---|---|
{line.join(fault_rows(given.plates))}

"reversed" is called after {doubts:g} samples in a row for which Wq answers the moves of the frequency the wrong way round. How near sound benches come
to it, {given.plates} of each: the random scenes of closed_loop.md (guarded, how many ended); the plates above, switched on, for 200 ms; the same for
{LONG * T:g} s with noise of 5 %. Faults, and the most such samples in a row.

| method | scenes that ended | noise 1 %: faults | in a row | noise 5 %: faults | in a row |
|---|---|---|---|---|---|
{line.join(alarm_rows(given.plates))}

The scenes that end with `paper` do so in the guard's `above`: it begins at the whole amplitude beside the resonance, holds Wd alone, and its |W|
comes to 1.5 to 1.8 times what is asked.

## A timer of 100 MHz

Its steps are 10.4 Hz; the resonance lies anywhere between two. Over one second, begun 100 ms after the start: on how many of {given.plates}
plates the frequency changes once, and more often; the most of the mean amplitude that is lost and that is too much; the furthest that it rests beside
the resonance. The loops hold Wd: beside the resonance |W| is larger.

| method | once | more often | lost (%), most | too much (%), most | beside (Hz), most |
|---|---|---|---|---|---|
{line.join(timer_rows(given.plates))}
"""
    (HERE / "faults.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
