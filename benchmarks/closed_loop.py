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
SLEWS = (1e6, 3e5, 1e5)  # V/s; the steady voltage is 100 V


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
    wrong = [
        Plant(p.G * g, p.tau * t, p.f0, p.k_T)
        for p, (g, t) in zip(plates, rng.uniform(0.95, 1.05, (count, 2)), strict=True)
    ]
    scenes = [scene(p, 1200) for p in plates]
    for method in ("pi", "adaptive"):  # the amplitude loop of `pll` is that of "pi"
        given = {"method": method, "frequency_window": (31900, 32700), "guard": False}
        known, off = (
            [controller.design(p, voltage_limit=100.0 * x, **given) for p, x in zip(designed, r, strict=True)]
            for designed in (plates, wrong)
        )
        runs = {method: known, f"{method}, G and tau up to 5 % off": off}
        for slew in SLEWS if method == "adaptive" else ():
            slewed = [dataclasses.replace(loop, control=loop.law._replace(slew=slew * T)) for loop in known]
            runs[f"{method}, {slew:.0e} V/s"] = slewed
        for said, loops in runs.items():
            took = np.array([settled(t) for t in controller.closed_loops(loops, scenes, reference=2.0)])
            ratio, late = (took - 2 * T) / bound, 1e3 * (took - bound)
            rows.append(f"| {said} | {spread(ratio)} | {np.sum(ratio <= 1.10)} | {spread(late)} |")
    return rows


# --- random scenes --------------------------------------------------------------------------------------------------------------


def drawn(rng: np.random.Generator) -> Scene:
    """From rest at 2 um, 10 to 100 Hz off, -10 to 15 degC; a press of 0.2 to 1.5 N within 1 to 30 ms, at 60 ms; noise of 1 %."""
    off, press, warm = rng.uniform(10, 100) * rng.choice([-1, 1]), rng.uniform(0.2, 1.5), rng.uniform(-10, 15)
    plate = Plant(0.02 * rng.uniform(0.98, 1.02), TAU * rng.uniform(0.98, 1.02), 32300.0 + off, -10.16)
    force = Profile(
        np.array([0.0, 0.06, 0.06 + rng.uniform(1e-3, 30e-3)]), np.array([0.0, 0.0, press]), held=False
    )
    return scene(plate, 1401, FingerDamping(), WhiteNoise(0.02), temperature=24.0 + warm, force=force)


def judged(trace: controller.Trace, plate: Plant, warm: float) -> dict[str, float]:
    resonance = plate.f0 + plate.k_T * (warm - 24.0)
    away = np.flatnonzero(np.abs(trace.f[:600] - resonance) > 15)
    rest = trace.f[300:600] - resonance
    return {
        "settled, 5 % (ms)": 1e3 * controller.settling_time(trace.time[:600], trace.W[:600], 2.0, 0.05),
        "within 15 Hz (ms)": 1e3 * trace.time[away[-1] + 1]
        if len(away) and away[-1] < 599
        else (0.0 if not len(away) else np.inf),
        "rest of f (Hz rms)": float(np.sqrt(np.mean(rest**2))),
        "dip of the press (%)": 100 * (1 - trace.W[600:].min() / 2),
        "rms of V at rest (V)": float(np.std(trace.V[400:600])),
    }


def scene_rows(count: int) -> list[str]:
    rng = np.random.default_rng(0)
    scenes = [drawn(rng) for _ in range(count)]
    rows = []
    for method in METHODS:
        traces = controller.closed_loops(
            controller.design(PLATE, method=method, **GIVEN), scenes, reference=2.0
        )
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
            off = 100.0 * rng.choice([-1, 1], count) + (
                0 if step is None else rng.uniform(-0.5, 0.5, count) * step
            )
            plates = [Plant(0.02, TAU, 32300.0 + float(o), -10.16) for o in off]
            traces = controller.closed_loops(loop, [scene(p, 4001, *effects) for p in plates], reference=2.0)
            away = [t.f - p.f0 for t, p in zip(traces, plates, strict=True)]
            lock = [1e3 * T * (np.flatnonzero(np.abs(a) > 15)[-1] + 1) for a in away]
            rest = [float(np.sqrt(np.mean(a[500:] ** 2))) for a in away]
            said = f"{method}, steps of {step} Hz" if step else method
            rows.append(f"| {said} | {spread(lock)} | {spread(rest)} |")
    return rows


def damping(force: float) -> float:
    """What a finger adds to the plate's own: `FingerDamping`."""
    return (1 - math.exp(-((force / 0.6) ** (2 / 3)))) / (1 - math.exp(-((1.5 / 0.6) ** (2 / 3))))


def least(force: float, within: float) -> tuple[float, float]:
    """The smallest dip (%), and ms until W is back within 5 %, whatever the controller: a press that begins at a sample is first
    seen at the next one, and answered a latency after that, by the whole voltage until W is back.

    W' = -(1 + rho(t)) W / tau + G V / tau, by exact steps of a fiftieth of a sample with rho at its middle; 120 ms of it.
    """
    h, W, rows = T / 50, 1.0, []
    for k in range(50 * 800):
        pressed = force if (k + 0.5) * h > within else force * (k + 0.5) * h / within
        rate, V = (1 + damping(pressed)) / TAU, 3.5 if k >= 2 * 50 and W < 1.0 else 1.0
        W = V / (rate * TAU) + (W - V / (rate * TAU)) * math.exp(-rate * h)
        rows.append(W)
        if W >= 1.0 and k > 2 * 50 and (k + 0.5) * h > within:
            break
    below = np.flatnonzero(np.array(rows) < 0.95)
    return 100 * (1 - min(rows)), 1e3 * h * (below[-1] + 1) if len(below) else 0.0


def press_rows(count: int) -> list[str]:
    rows = []
    for name, within in (
        ("at once", (0.0, 0.0)),
        ("within 1 to 10 ms", (1e-3, 1e-2)),
        ("within 10 to 30 ms", (1e-2, 3e-2)),
    ):
        rng = np.random.default_rng(3)
        scenes, floor = [], []
        for _ in range(count):
            force, long = rng.uniform(0.5, 1.5), rng.uniform(*within)
            held = long == 0.0
            at, to = ([0.0, 0.03], [0.0, force]) if held else ([0.0, 0.03, 0.03 + long], [0.0, 0.0, force])
            scenes.append(
                scene(PLATE, 801, FingerDamping(), force=Profile(np.array(at), np.array(to), held=held))
            )
            floor.append(least(force, long))
        found = {}
        for method in ("paper", "adaptive"):
            traces = controller.closed_loops(
                controller.design(PLATE, method=method, **GIVEN), scenes, reference=2.0
            )
            dips = [100 * (1 - t.W[300:].min() / 2) for t in traces]
            back = [1e3 * controller.settling_time(t.time[300:], t.W[300:], 2.0) for t in traces]
            found[method] = np.array([dips, back])
        for k, what in enumerate(("dip (%)", "back within 5 % (ms)")):
            theirs, mine, bound = found["paper"][k], found["adaptive"][k], np.array(floor)[:, k]
            felt = theirs > 0  # a dip of less than 5 % has no recovery
            ratio, bounds = (spread(v[felt] / theirs[felt]) if felt.any() else "- | -" for v in (mine, bound))
            can, halved = felt & (bound <= 0.5 * theirs), felt & (mine <= 0.5 * theirs)
            rows.append(
                f"| {name} | {what} | {spread(theirs)} | {spread(mine)} | {ratio} | {bounds} | {can.sum()} | {halved.sum()} |"
            )
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
        controller.closed_loops(
            loop, [one] * min(256, runs - first), seeds=range(first, first + min(256, runs - first))
        )
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
tau ln(r/(r - 0.95)), the bound. Ratio: settling less latency and one sample, over the bound. `pll` has the amplitude loop of `pi`.
Below each, the same designed from a plate of which G and tau are up to 5 % off, each on its own; and what a limit of the voltage's slew costs.

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

Of 0.5 to 1.5 N, without noise. Ratio: `adaptive` over `paper`, scene by scene. Least: the bound over `paper`. A press that begins at a sample is seen one
sample later, and answered a latency after that: until then the plate decays under the voltage that was enough for it alone. The whole voltage from then
on, 3.5 times the steady one, is what no controller can better (`least` in `closed_loop.py`). Can: of {n}, in how many the bound is at most half of what
`paper` leaves; halved: in how many `adaptive` halves it.

| pressed | | `paper`, median | worst | `adaptive`, median | worst | ratio, median | worst | least, median | worst | can | halved |
|---|---|---|---|---|---|---|---|---|---|---|---|
{line.join(press_rows(n))}

## Time

{given.runs} runs of 1 s at 10 kHz, with guard, finger and noise, warm: {took:.1f} s on {os.cpu_count()} hyperthreads that others shared (load \
{os.getloadavg()[0]:.1f}), {busy:.1f} s of processor time.
"""
    (HERE / "closed_loop.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
