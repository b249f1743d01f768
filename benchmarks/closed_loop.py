"""Controllers side by side on random plates and scenes, and how long a thousand runs take:  python benchmarks/closed_loop.py

Writes closed_loop.md beside itself.
"""

import argparse
import dataclasses
import math
import os
import time
from pathlib import Path

import numpy as np

import controller
from sysid import Plant, Profile, Scene
from sysid.scene.effects import FingerDamping, FrequencyResolution, WhiteNoise

HERE = Path(__file__).parent
TAU, T, TIMER = 5e-3 / math.log(20), 1e-4, 10.4
PLATE = Plant(0.02, TAU, 32300.0, -10.16)
GIVEN = {"voltage_limit": 350.0, "frequency_window": (31900, 32700), "guard": False}
METHODS = ("paper", "pi", "pll", "adaptive")
SLEWS = (None, 1e6, 3e5, 1e5)  # V/s; the steady voltage is 100 V


def scene(plate: Plant, length: int, *effects, **inputs) -> Scene:
    given = {"drive": 100.0, "frequency": 32300.0} | inputs
    profiles = {name: v if isinstance(v, Profile) else Profile.constant(v) for name, v in given.items()}
    return Scene(plate, profiles, length, 1e4, effects, fidelity="envelope")


def spread(values) -> str:
    return f"{np.median(values):.3g} | {np.max(values):.3g}"


# --- settling against the bound -------------------------------------------------------------------------------------------------


def settled(trace: controller.Trace) -> float:
    """When |W| comes within 5 % of 2 um, between two samples, s."""
    k = round(controller.settling_time(trace.time, trace.W, 2.0) / T)
    return float(np.interp(1.9, trace.W[k - 1 : k + 1], trace.time[k - 1 : k + 1]))


def bound_rows(count: int) -> list[str]:
    rng, rows = np.random.default_rng(1), []
    tau, r = np.exp(rng.uniform(np.log(1e-3), np.log(1e-2), count)), rng.uniform(1.2, 3.0, count)
    bound = tau * np.log(r / (r - 0.95))
    plates = [Plant(0.02, float(t), 32300.0, -10.16) for t in tau]
    scenes = [scene(p, 1200) for p in plates]
    for method in ("pi", "adaptive"):  # the amplitude loop of the others is that of "pi"
        given = {"method": method, "frequency_window": (31900, 32700), "guard": False}
        loops = [controller.design(p, voltage_limit=100.0 * x, **given) for p, x in zip(plates, r, strict=True)]
        for slew in SLEWS if method == "adaptive" else SLEWS[:1]:
            if slew is not None:
                loops = [dataclasses.replace(loop, control=loop.law._replace(slew=slew * T)) for loop in loops]
            took = np.array([settled(t) for t in controller.closed_loops(loops, scenes, reference=2.0)])
            ratio, late = (took - 2 * T) / bound, 1e3 * (took - bound)
            said = f"{method}, {slew:.0e} V/s" if slew else method
            rows.append(f"| {said} | {spread(ratio)} | {np.sum(ratio <= 1.10)} | {spread(late)} |")
    return rows


# --- random scenes --------------------------------------------------------------------------------------------------------------


def drawn(rng: np.random.Generator) -> Scene:
    """From rest at 2 um, 10 to 100 Hz off, -10 to 15 degC; a press of 0.2 to 1.5 N within 1 to 30 ms, at 60 ms; noise of 1 %."""
    off, press, warm = rng.uniform(10, 100) * rng.choice([-1, 1]), rng.uniform(0.2, 1.5), rng.uniform(-10, 15)
    plate = Plant(0.02 * rng.uniform(0.98, 1.02), TAU * rng.uniform(0.98, 1.02), 32300.0 + off, -10.16)
    force = Profile(np.array([0.0, 0.06, 0.06 + rng.uniform(1e-3, 30e-3)]), np.array([0.0, 0.0, press]), held=False)
    return scene(plate, 1401, FingerDamping(), WhiteNoise(0.02), temperature=24.0 + warm, force=force)


def judged(trace: controller.Trace, plate: Plant, warm: float) -> dict[str, float]:
    resonance = plate.f0 + plate.k_T * (warm - 24.0)
    away = np.flatnonzero(np.abs(trace.f[:600] - resonance) > 15)
    rest = trace.f[300:600] - resonance
    return {
        "settled, 5 % (ms)": 1e3 * controller.settling_time(trace.time[:600], trace.W[:600], 2.0, 0.05),
        "within 15 Hz (ms)": 1e3 * trace.time[away[-1] + 1] if len(away) and away[-1] < 599 else (0.0 if not len(away) else np.inf),
        "rest of f (Hz rms)": float(np.sqrt(np.mean(rest**2))),
        "dip of the press (%)": 100 * (1 - trace.W[600:].min() / 2),
        "rms of V at rest (V)": float(np.std(trace.V[400:600])),
    }


def scene_rows(count: int) -> list[str]:
    rng = np.random.default_rng(0)
    scenes = [drawn(rng) for _ in range(count)]
    rows = []
    for method in METHODS:
        traces = controller.closed_loops(controller.design(PLATE, method=method, **GIVEN), scenes, reference=2.0)
        warm = [float(s.inputs["temperature"].values[0]) for s in scenes]
        found = [judged(t, s.plant, w) for t, s, w in zip(traces, scenes, warm, strict=True)]
        rows += [(name, f"| {name} | {method} | {spread([f[name] for f in found])} |") for name in found[0]]
    return [row for name in found[0] for key, row in rows if key == name]


# --- lock, rest and press -------------------------------------------------------------------------------------------------------


def lock_rows(count: int) -> list[str]:
    """Plates exactly 100 Hz away, and a source that makes multiples of 10.4 Hz."""
    rng, rows = np.random.default_rng(2), []
    for method in METHODS:
        for step in (None, TIMER):
            if method == "paper" and step:
                continue  # its steps are its own
            loop = controller.design(PLATE, method=method, rig=controller.Rig(frequency_step=step), **GIVEN)
            effects = (WhiteNoise(0.02), *([FrequencyResolution(step)] if step else []))
            off = 100.0 * rng.choice([-1, 1], count) + (0 if step is None else rng.uniform(-0.5, 0.5, count) * step)
            plates = [Plant(0.02, TAU, 32300.0 + float(o), -10.16) for o in off]
            traces = controller.closed_loops(loop, [scene(p, 4001, *effects) for p in plates], reference=2.0)
            away = [t.f - p.f0 for t, p in zip(traces, plates, strict=True)]
            lock = [1e3 * T * (np.flatnonzero(np.abs(a) > 15)[-1] + 1) for a in away]
            rest = [float(np.sqrt(np.mean(a[500:] ** 2))) for a in away]
            said = f"{method}, steps of {step} Hz" if step else method
            rows.append(f"| {said} | {spread(lock)} | {spread(rest)} |")
    return rows


def press_rows(count: int) -> list[str]:
    rows = []
    for name, within in (("at once", (0.0, 0.0)), ("within 1 to 10 ms", (1e-3, 1e-2)), ("within 10 to 30 ms", (1e-2, 3e-2))):
        rng = np.random.default_rng(3)
        scenes, floor = [], []
        for _ in range(count):
            force, long = rng.uniform(0.5, 1.5), rng.uniform(*within)
            held = long == 0.0
            at, to = ([0.0, 0.03], [0.0, force]) if held else ([0.0, 0.03, 0.03 + long], [0.0, 0.0, force])
            scenes.append(scene(PLATE, 801, FingerDamping(), force=Profile(np.array(at), np.array(to), held=held)))
            rho = (1 - math.exp(-((force / 0.6) ** (2 / 3)))) / (1 - math.exp(-((1.5 / 0.6) ** (2 / 3))))
            floor.append(100 * (1 - (1 + rho * math.exp(-(1 + rho) * 2 * T / TAU)) / (1 + rho)))
        found = {}
        for method in ("paper", "adaptive"):
            traces = controller.closed_loops(controller.design(PLATE, method=method, **GIVEN), scenes, reference=2.0)
            dips = [100 * (1 - t.W[300:].min() / 2) for t in traces]
            back = [1e3 * controller.settling_time(t.time[300:], t.W[300:], 2.0) for t in traces]
            found[method] = np.array([dips, back])
        for k, what in enumerate(("dip (%)", "back within 5 % (ms)")):
            theirs, mine = (found[m][k] for m in ("paper", "adaptive"))
            felt = theirs > 0  # a dip of less than 5 % has no recovery
            ratio = spread(mine[felt] / theirs[felt]) if felt.any() else "- | -"
            least = f"{np.median(floor):.3g}" if name == "at once" and k == 0 else ""
            rows.append(f"| {name} | {what} | {spread(theirs)} | {spread(mine)} | {ratio} | {least} |")
    return rows


# --- time -----------------------------------------------------------------------------------------------------------------------


def timed(runs: int) -> tuple[float, float]:
    """Seconds, and seconds of processor time, that `runs` runs of 1 s at 10 kHz take once compiled."""
    loop = controller.design(PLATE, voltage_limit=350.0, frequency_window=(31900, 32700))
    force = Profile(np.array([0.0, 0.03]), np.array([0.0, 1.0]))
    one = scene(PLATE, 10001, FingerDamping(), WhiteNoise(0.02), force=force)
    controller.closed_loops(loop, [one] * 128)
    begun, spent = time.perf_counter(), time.process_time()
    for first in range(0, runs, 256):
        controller.closed_loops(loop, [one] * min(256, runs - first), seeds=range(first, first + min(256, runs - first)))
    return time.perf_counter() - begun, time.process_time() - spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--runs", type=int, default=1000)
    given = parser.parse_args()
    n, line = given.scenes, "\n"
    took, busy = timed(given.runs)
    text = f"""# Controllers side by side

Made by `python benchmarks/closed_loop.py --scenes {n} --runs {given.runs}`: simulated, 10 kHz, one sample of latency, 2 um for 100 V. Each
figure is the median and the worst of {n} random plates or scenes.

## Settling against the time-optimal bound

From rest to 2 um at resonance; tau 1 to 10 ms (log-uniform), voltage up to r = 1.2 to 3 times the steady one. At full voltage 95 % is reached after
tau ln(r/(r - 0.95)), the bound. Ratio: settling less latency and one sample, over the bound. `paper` and `pll` have the amplitude
loop of `pi`. Below, what a limit of the voltage's slew costs.

| | ratio, median | worst | of {n} within 1.10 | ms beyond the bound, median | worst |
|---|---|---|---|---|---|
{line.join(bound_rows(n))}

## Random scenes

{drawn.__doc__}
Gains from the plate of the middle, voltage up to 3.5 times the steady one.

| | method | median | worst |
|---|---|---|---|
{line.join(scene_rows(n))}

## Lock and rest of the tracker

The resonance lies 100 Hz beside the start, to either side; noise of 1 %. Locked: within 15 Hz from then on. Rest: rms of f less the resonance from 50 ms
on; a source of steps leaves half a step, {TIMER / 2:g} Hz, and a dead band of a tenth besides.

| | lock (ms), median | worst | rest (Hz rms), median | worst |
|---|---|---|---|---|
{line.join(lock_rows(n))}

## A finger

Of 0.5 to 1.5 N, without noise. Ratio: `adaptive` over `paper`, scene by scene. Least: a finger that is there at once is seen after one sample and
answered after two, whatever the controller.

| pressed | | `paper`, median | worst | `adaptive`, median | worst | ratio, median | worst | least, median |
|---|---|---|---|---|---|---|---|---|
{line.join(press_rows(n))}

## Time

{given.runs} runs of 1 s at 10 kHz, with guard, finger and noise, warm: {took:.1f} s on {os.cpu_count()} hyperthreads that others shared (load \
{os.getloadavg()[0]:.1f}), {busy:.1f} s of processor time.
"""
    (HERE / "closed_loop.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
