"""Touches: contrasts and who feels them, what position noise leaves, the paper's test foreseen, the neighbours, and the time.

python benchmarks/touch.py > benchmarks/touch.md
"""

import argparse
import dataclasses
import os
import platform
import time
from collections.abc import Callable, Iterator
from datetime import date

import numpy as np

from controller import settling_time
from stimulator import (
    CornerForces,
    Exponential,
    Finger,
    Intensities,
    Observer,
    PartialLevitation,
    Prior,
    Stroke,
    TouchScene,
    neighbours,
    predicted,
    run_all,
    spectral_contrast,
)
from stimulator.contrast import plateau
from stimulator.experiment import proportion, quantile
from stimulator.filters import Kalman, OnePole
from stimulator.modes import modes
from stimulator.observer import preference
from stimulator.plate import LAYOUTS
from stimulator.texture import Square
from sysid import Plant, Profile, Scene
from sysid.scene import EFFECTS

PLANT = Plant(0.02, 5e-3 / np.log(20), 32300.0, -10.16)
FINGERS = {"L1": EFFECTS["finger_damping"](), "L2": EFFECTS["finger_damping"](law="power", exponent=0.6)}
LAWS = {"F1": Exponential(), "F2": PartialLevitation()}
PAPER = {"method": "paper", "voltage_limit": 350.0}
FORCES = (0.1, 0.2, 0.5, 1.0, 1.5)  # N
WEBER = (0.11, 0.15, 0.18, 0.25, 0.30)


def plate(damping: str = "L1", seconds: float = 1.2, effects: tuple = (), **inputs: float | Profile) -> Scene:
    given = {"drive": 0.0, "frequency": PLANT.f0, "force": 0.0} | inputs
    held = {name: v if isinstance(v, Profile) else Profile.constant(v) for name, v in given.items()}
    return Scene(PLANT, held, round(seconds * 1e4) + 1, 1e4, (FINGERS[damping], *effects))


def grating(force: float, amplitude: float = 1.0, damping: str = "L1", **parts: object) -> TouchScene:
    stroke = Stroke.line(20.0, 80.0, 1.2, 69.0, force)
    given = {
        "stroke": stroke,
        "texture": Square(amplitude=amplitude),
        "forces": CornerForces(noise=0.0),
    } | parts
    return TouchScene(plate(damping), **given)


def loop_of(amplitude: float) -> object:
    return grating(1.0, amplitude, loop=PAPER).designed


def contrasts() -> dict[tuple[float, str, str, float], tuple[float, float]]:
    """{(amplitude, finger, law, force): contrasts in open and closed loop}."""
    found = {}
    for amplitude in (1.0, 2.0):
        keys = [(finger, force) for finger in FINGERS for force in FORCES]
        scenes = [grating(force, amplitude, finger) for finger, force in keys]
        closed = run_all(scenes, loop_of(amplitude))
        for (finger, force), scene, touch in zip(keys, scenes, closed, strict=True):
            pair = scene.run(), touch
            for name, law in LAWS.items():
                S = [plateau(t.x, law.friction(t.W, t.force), 5.0) for t in pair]
                found[amplitude, finger, name, force] = S[0], S[1]
    return found


def table_of(found: dict) -> Iterator[str]:
    yield "## Contrasts of a grating of 5 mm at 80 mm/s, and who feels them"
    yield ""
    yield "Plateaus of friction, finger L1, no position noise. P(closed): the closed loop is said to be the stronger,"
    yield "at a Weber fraction k and lapses of 0.03, without a floor."
    yield ""
    yield f"| W*, um | law | F, N | open | closed | ratio | {' | '.join(f'P, k {k:.2f}' for k in WEBER)} |"
    yield "|---|---|---|---|---|---|" + "---|" * len(WEBER)
    for (amplitude, finger, law, force), (opened, closed) in found.items():
        if finger == "L1" and force in (0.2, 0.5, 1.0):
            P = " | ".join(f"{preference(closed, opened, k, 0.03):.3f}" for k in WEBER)
            yield f"| {amplitude:g} | {law} | {force:g} | {opened:.3f} | {closed:.3f} | {closed / opened:.2f} | {P} |"


def foreseen(found: dict) -> Iterator[str]:
    cells = {}
    for amplitude, finger, law in dict.fromkeys(key[:3] for key in found):
        pairs = np.array([found[amplitude, finger, law, force] for force in FORCES])
        cells[amplitude, finger, law] = Intensities(np.array(FORCES), *pairs.T)
    prior = Prior()
    distributions = predicted(cells, prior)
    yield "## The paper's test, foreseen"
    yield ""
    yield "10 volunteers of 5 trials each. The prior was written down before and is fitted to nothing:"
    yield f"`{prior}`."
    yield "It allows much, so that 46 of 50 within it is a weak test; that open lies below closed everywhere is not."
    yield ""
    yield "| W*, um | finger | law | open < closed | 2.5 % | 25 % | 50 % | 75 % | 97.5 % | P(46) | P(46 or fewer) |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    everything = np.mean(list(distributions.values()), axis=0)
    for key, distribution in (distributions | {("all", "all", "all"): everything}).items():
        counts = " | ".join(str(quantile(distribution, q)) for q in (0.025, 0.25, 0.5, 0.75, 0.975))
        below = "yes" if key not in cells or np.all(cells[key].opened < cells[key].closed) else "no"
        yield f"| {' | '.join(map(str, key))} | {below} | {counts} | {distribution[46]:.3f} | {distribution[:47].sum():.3f} |"
    said = proportion(46, 50)
    low, high = said.clopper_pearson
    yield ""
    yield f"46 of 50: p {said.two_sided:.3g} against 1/2 (two-sided), 95 % interval {low:.4f} to {high:.4f}."


SENSORS = {
    "none": CornerForces(noise=0.0),
    "1.5 mN raw": CornerForces(),
    "1.5 mN, one pole of 5 ms": CornerForces(filter=OnePole()),
    "1.5 mN, Kalman": CornerForces(filter=Kalman()),
}


def noise(seeds: int) -> Iterator[str]:
    yield "## Position noise"
    yield ""
    yield f"Strokes to and fro over 90 mm in 1.2 s, up to 236 mm/s, closed loop, 1 um, F2, finger L1; {seeds} seeds each, mean and"
    yield "standard deviation from stroke to stroke. Contrast at 1/period; wrong: the share of the time in which what is asked for"
    yield "is not what lies under the finger."
    yield ""
    yield "| F, N | noise | spectral contrast | plateaus | wrong |"
    yield "|---|---|---|---|---|"
    loop = loop_of(1.0)
    for force in (0.2, 0.5, 1.0):
        stroke = Stroke.to_and_fro(99.0, 45.0, 1.2, 69.0, force, 1.2)
        for name, sensors in SENSORS.items():
            count = 1 if name == "none" else seeds
            scene = grating(force, forces=sensors, friction=LAWS["F2"], stroke=stroke)
            touches = list(run_all([dataclasses.replace(scene, seed=seed) for seed in range(count)], loop))
            S = np.array([spectral_contrast(t) for t in touches])
            flat = np.mean([plateau(t.x, t.friction, 5.0) for t in touches])
            wrong = np.mean([np.mean((t.reference > 0) != (np.mod(t.x, 5.0) < 2.5)) for t in touches])
            said = f"{S.mean():.3f}" + (f" ({S.std(ddof=1):.3f})" if count > 1 else "")
            yield f"| {force:g} | {name} | {said} | {flat:.3f} | {100 * wrong:.0f} % |"


def company() -> Iterator[str]:
    yield "## Figures 6 and 8 with the neighbours of the finite elements"
    yield ""
    yield "The plate of the scenes, beside which stand the modes within 500 Hz that a layout drives; W is that in the middle of the"
    yield "plate, the loop sees what the two ceramics read. Figure 6: settled, 2 um at resonance. Figure 8: 1 um asked for from rest,"
    yield "1.5 N from 30 ms on, the paper's loop."
    yield ""
    yield "| layout | neighbours: Hz, drive, sense | Fig. 6: largest dW, um | where Wq = 0, Hz | W there | Fig. 8: 5 % settling, ms | W at 29 ms | W at 60 ms, 1.5 N | what the ceramics say then |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for name in (None, *LAYOUTS):
        beside = () if name is None else neighbours(modes(LAYOUTS[name], 31100.0).mode, PLANT)
        said = (
            ", ".join(f"{m.f0 - PLANT.f0:+.0f} {m.G / PLANT.G:+.2f} {m.seen:+.2f}" for m in beside) or "none"
        )
        yield f"| {name or 'none'} | {said} | {' | '.join(figure_6(beside))} | {' | '.join(figure_8(beside))} |"


def figure_6(beside: tuple) -> Iterator[str]:
    """What the sensors read of a settled sweep, and the motion in the middle at the frequency at which the tracker rests."""
    f = np.linspace(31800.0, 32800.0, 100_001)
    read, moves = (settled(f, beside, seen=seen) for seen in (True, False))
    yield f"{np.max(np.abs(np.abs(read) - np.abs(settled(f, ())))):.3f}"
    near = np.abs(f - PLANT.f0) < 150
    zero = np.argmin(np.where(near, np.abs(read.imag), np.inf))
    yield f"{f[zero] - PLANT.f0:+.2f}"
    yield f"{np.abs(moves[zero]):.4f}"


def settled(f: np.ndarray, beside: tuple, seen: bool = True) -> np.ndarray:
    total = PLANT.steady(100.0, f)
    for m in beside:
        total = total + (m.seen if seen else 1.0) * Plant(m.G, m.tau, m.f0).steady(100.0, f)
    return total


def figure_8(beside: tuple) -> Iterator[str]:
    steps = Profile(np.array([0.0, 0.002]), np.array([0.0, 50.0]))
    press = Profile(np.array([0.0, 0.032, 0.062]), np.array([0.0, 1.5, 0.0]))
    touch = TouchScene(
        plate(seconds=0.1, effects=beside, drive=steps, force=press),
        loop=PAPER | {"finger": 1.0, "amplitude": 1.0},
    ).run()
    W = touch.W
    yield f"{1e3 * settling_time(touch.time[20:310], W[20:310], W[309]):.2f}"
    yield f"{W[309]:.3f}"
    yield f"{W[610]:.3f}"
    yield f"{touch.measured[610].real:.3f}"


def speed(strokes: int) -> Iterator[str]:
    everything = {
        "forces": CornerForces(filter=Kalman()),
        "finger": Finger(),
        "friction": LAWS["F2"],
        "observer": Observer(),
    }
    one = grating(0.5, **everything, loop=PAPER)
    one = dataclasses.replace(one, loop=one.designed)
    rng = np.random.default_rng(0)

    def random(seed: int) -> TouchScene:
        """A finger that presses and moves as it likes."""
        force, v = min(0.5 * np.exp(0.4 * rng.standard_normal()), 3.0), rng.uniform(40.0, 110.0)
        stroke = Stroke.line(rng.uniform(20.0, 50.0), v, 1.2, rng.uniform(20.0, 118.0), force)
        return dataclasses.replace(one, stroke=stroke, seed=seed)

    yield "## Time"
    yield ""
    yield "Strokes of 1.2 s by fingers at random: noisy force sensors behind a Kalman filter, a finger on the mode shape, the paper's loop at 10 kHz,"
    yield "friction, the same in open loop, and the observer's judgement. Warm; of one stroke the best of 20."
    yield ""
    yield "| strokes | simulated, s | wall, s | processor, s | times real time (wall) | (processor) | wanted |"
    yield "|---|---|---|---|---|---|---|"
    scenes = [random(seed) for seed in range(strokes)]
    busy = os.getloadavg()[0]
    ways: dict[int, Callable[[], object]] = {
        1: lambda: one.run().judgement,
        strokes: lambda: [t.judgement for t in run_all(scenes)],
    }
    for count, way in ways.items():
        way()
        took = min((measured(way) for _ in range(20 if count == 1 else 1)), key=lambda pair: pair[0])
        wanted = 10 if count == 1 else 50
        yield f"| {count} | {1.2 * count:g} | {took[0]:.3g} | {took[1]:.3g} | {1.2 * count / took[0]:.1f} | {1.2 * count / took[1]:.1f} | {wanted} |"
    yield ""
    yield f"Load average when this was measured: {busy:.1f}, of {os.cpu_count()} cores: wall times hold what else the machine did."


def measured(way: Callable[[], object]) -> tuple[float, float]:
    wall, processor = time.perf_counter(), time.process_time()
    way()
    return time.perf_counter() - wall, time.process_time() - processor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=48)
    parser.add_argument("--strokes", type=int, default=1000)
    arguments = parser.parse_args()
    print("# Touches\n")
    print(f"`python benchmarks/touch.py`, {date.today()}, {os.cpu_count()} cores, {platform.machine()}.\n")
    found = contrasts()
    for part in (
        table_of(found),
        foreseen(found),
        noise(arguments.seeds),
        company(),
        speed(arguments.strokes),
    ):
        print("\n".join(part), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
