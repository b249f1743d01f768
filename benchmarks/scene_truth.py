"""Scenes against the carrier, and automatic fidelity against its promise:  python benchmarks/scene_truth.py --scenes 200

Random scenes are simulated by the engine and by what is slow and obvious: the carrier's equation of motion integrated by DOP853,
matrix exponentials (`tests/carrier.py`), numbers of forty digits. Writes scene_truth.md beside itself.

    --scenes N     random scenes of automatic fidelity (default 200)     --long N     long ones (default 20)
    --replay SEED  one of the random scenes again, with what was tried
"""

import argparse
import dataclasses
import math
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from rich.progress import track

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import carrier  # noqa: E402
from carrier import PLATE, random_scene  # noqa: E402

from sysid import Plant, Profile, Scene, SceneError  # noqa: E402
from sysid.precision import keep_programs  # noqa: E402
from sysid.scene import EFFECTS  # noqa: E402
from sysid.scene.simulation import resolved  # noqa: E402


def made(*names, **values):
    return tuple(EFFECTS[name](**values.get(name, {})) for name in names)


def error(found, truth) -> float:
    """Largest deviation over the largest response."""
    return float(np.max(np.abs(found - truth)) / np.max(np.abs(truth)))


# --- the engine ----------------------------------------------------------------------------------------------------------

SENSOR = {"feedthrough": {"d": 1e-3, "q": -2e-3}, "rotation": {"angle": 30.0}, "second_mode": {"k_T": -3.0}}
EXACT = {
    "none": (),
    "finger_damping": made("finger_damping"),
    "finger_damping, power law": made("finger_damping", finger_damping={"law": "power"}),
    "finger_damping, finger_detuning": made("finger_damping", "finger_detuning"),
    "second_mode": made("second_mode", **SENSOR),
    "phase_reset": made("phase_reset"),
    "phase_reset, frequency_resolution": made("phase_reset", "frequency_resolution"),
    "two_ceramics, feedthrough, rotation": made("second_mode", "two_ceramics", "feedthrough", "rotation", **SENSOR),
    "delay": made("delay", delay={"time": 1.23e-4}),
    **{f"lock_in, order {order}": made("lock_in", lock_in={"order": order}) for order in (1, 2, 3, 4)},
    "lock_in as slow as the plate, order 4": made("lock_in", lock_in={"order": 4, "tau": PLATE.tau}),
    "all of them": made("finger_damping", "finger_detuning", "second_mode", "phase_reset", "two_ceramics", "feedthrough",
                        "rotation", "lock_in", "delay", **SENSOR, lock_in={"order": 2}),
}  # fmt: skip


def exact_table() -> str:
    """The exact rung: largest errors over a few seeds, against expm at the plate's own numbers and the carrier at low ones."""
    lines = [
        "| effects | matrix exponential, 32.3 kHz, Q 169 | carrier by DOP853, 3 kHz, Q 3 to 200 |",
        "|---|---|---|",
    ]
    for name, effects in track(EXACT.items(), "exact"):
        scenes = [random_scene(seed, effects, plant=PLATE) for seed in range(5)]
        by_expm = max(error(s.simulate().response, carrier.by_expm(s)) for s in scenes)
        by_carrier = (
            "" if "lock_in" in name else f"{max(_carried(e, effects) for e in (3.0, 30.0, 200.0)):.1e}"
        )
        if name == "all of them":
            by_carrier = f"{max(_carried(Q, effects) for Q in (3.0, 30.0, 200.0)):.1e} (no lock_in, no delay)"
        lines.append(f"| {name} | {by_expm:.1e} | {by_carrier} |")
    return "\n".join(lines)


def _carried(Q: float, effects: tuple) -> float:
    plant = Plant(0.3, Q / (np.pi * 3000), 3000.0, -3000 / Q / 20)
    own = {
        "second_mode": {"G": 0.03, "tau": plant.tau / 2, "f0": 3600.0, "k_T": 0.0},
        "delay": {"time": plant.tau / 9},
    }
    own["frequency_resolution"] = {"step": 300 / Q}
    moved = tuple(dataclasses.replace(e, **own.get(e.name, {})) for e in effects if e.name != "lock_in")
    moved = tuple(e for e in moved if e.name != "delay" or len(effects) == 1)
    scene = dataclasses.replace(random_scene(int(Q), moved, plant=plant), rows=30)
    return error(scene.simulate().response, carrier.by_carrier(scene))


# --- automatic fidelity ---------------------------------------------------------------------------------------------------

KINDS = (("steps",), ("ramp",), ("steps", "ramp", "constant"), ("constant", "ramp"))
PERIODS = 2000  # of the carrier that are worth integrating


def effects_of(name: str, plant: Plant) -> tuple:
    """A set of effects in sizes that this plant notices."""
    half_bandwidth, settled = 1 / (2 * np.pi * plant.tau), plant.G * 50
    heats = {"capacity": 0.5 * 5 * plant.tau, "loss": 0.5, "damping": 1.0}
    full = (
        0.5 * (2 * np.pi * plant.f0 * settled * 1e-6) ** 2 / heats["loss"] * abs(plant.k_T)
    )  # Hz by 1 N s/m
    values = {
        "duffing": {"softening": 0.1 * half_bandwidth / settled**2},
        "self_heating": heats | {"damping": 0.3 * half_bandwidth / full},
        "second_mode": {"G": 0.1 * plant.G, "tau": plant.tau, "f0": plant.f0 + 12 * half_bandwidth},
        "amplifier_limit": {"limit": 80.0},
        "frequency_resolution": {"step": 0.4 * half_bandwidth},
        "lock_in": {"tau": 0.05 * plant.tau, "order": 2},
    }
    return made(*SETS[name], **values)


SETS = {
    "none": (),
    "finger": ("finger_damping", "finger_detuning"),
    "lock-in": ("finger_damping", "feedthrough", "lock_in"),
    "second mode": ("second_mode",),
    "drive": ("amplifier_limit", "frequency_resolution"),
    "softening": ("duffing",),
    "self-heating": ("self_heating",),
}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One scene: what was chosen (None: refused), its error over the tolerance, and that against the carrier, where tried."""

    seed: int
    line: str
    tolerance: float
    chosen: tuple[str, int] | None
    ratio: float = math.nan
    carrier_ratio: float = math.nan


def scene_of(seed: int) -> tuple[str, Scene]:
    rng = np.random.default_rng([seed, 1])
    name = str(rng.choice(list(SETS)))
    tolerance = float(np.exp(rng.uniform(np.log(1e-4), np.log(3e-2))))
    kinds = KINDS[rng.integers(len(KINDS))]
    plant = None if rng.random() < 0.6 else PLATE
    scene = random_scene(
        [seed, 2], plant=plant, kinds=kinds, spacing=(0.02, 50.0), fidelity="auto", tolerance=tolerance
    )
    return name, dataclasses.replace(scene, effects=effects_of(name, scene.plant))


def outcome(seed: int) -> Outcome:
    name, scene = scene_of(seed)
    line = f"{name}, Q {scene.plant.Q:.3g}, rows {1 / scene.rate / scene.plant.tau:.2g} tau apart, tolerance {scene.tolerance:.2g}"
    try:
        chosen = resolved(scene)
    except SceneError as refusal:
        return Outcome(seed, f"{line}: {refusal}", scene.tolerance, None)
    rows = chosen.simulate().response
    truth = dataclasses.replace(scene, fidelity="exact", substeps=1024).simulate().response
    ratio, other = error(rows, truth) / scene.tolerance, math.nan
    if name != "lock-in" and scene.duration * scene.plant.f0 < PERIODS:
        other = error(rows, carrier.by_carrier(scene, rtol=1e-9)) / scene.tolerance
    return Outcome(seed, line, scene.tolerance, (chosen.fidelity, chosen.substeps), ratio, other)


def wandering(rng, duration: float, level: float, spread: float) -> Profile:
    """An input of a long scene: rare steps, a smooth table, one short bump, or a constant."""
    kind = rng.integers(4)
    times = np.linspace(0, duration, 400)
    if kind == 0:
        return Profile(
            np.append(0.0, np.sort(rng.uniform(0, duration, 3))), level + spread * rng.normal(size=4)
        )
    if kind == 1:
        phase = rng.uniform(0, 2 * np.pi, 3)
        waves = (np.sin(2 * np.pi * (k + 1) * times / duration + p) for k, p in enumerate(phase))
        return Profile(times, level + spread * sum(waves), held=False)
    if kind == 2:
        return Profile(
            times,
            level + 2 * spread * np.exp(-(((times - duration * rng.random()) / duration * 150) ** 2)),
            held=False,
        )
    return Profile.constant(level)


def long_outcome(seed: int) -> Outcome:
    """40 000 rows, of which automatic fidelity tries some; the error is that of all."""
    rng = np.random.default_rng([seed, 3])
    name = str(rng.choice(["none", "finger", "lock-in"]))
    tolerance = float(np.exp(rng.uniform(np.log(3e-4), np.log(3e-2))))
    Q = math.exp(rng.uniform(math.log(30), math.log(1e5)))
    plant = Plant(0.02, Q / (math.pi * 32300), 32300.0, -10.0)
    rate, half_bandwidth = (
        1 / (plant.tau * math.exp(rng.uniform(math.log(1e-3), math.log(30)))),
        32300 / Q / 2,
    )
    duration = 39_999 / rate
    levels = {
        "drive": (50, 30),
        "frequency": (32300, half_bandwidth),
        "temperature": (24, 0.1 * half_bandwidth),
        "force": (1, 0.3),
    }
    inputs = {what: wandering(rng, duration, *level) for what, level in levels.items()}
    inputs["force"] = dataclasses.replace(inputs["force"], values=np.abs(inputs["force"].values))
    effects = effects_of(name, plant)
    scene = Scene(plant, inputs, 40_000, rate, effects, fidelity="auto", tolerance=tolerance)
    line = f"{name}, Q {Q:.3g}, rows {1 / rate / plant.tau:.2g} tau apart, tolerance {tolerance:.2g}"
    try:
        chosen = resolved(scene)
    except SceneError as refusal:
        return Outcome(seed, f"{line}: {refusal}", tolerance, None)
    truth = dataclasses.replace(scene, fidelity="exact", substeps=64).simulate().response
    found = (chosen.fidelity, chosen.substeps)
    return Outcome(seed, line, tolerance, found, error(chosen.simulate().response, truth) / tolerance)


def automatic_table(outcomes: list[Outcome]) -> str:
    """How often each rung was chosen, by tolerance."""
    bands = [(1e-4, 1e-3), (1e-3, 1e-2), (1e-2, 1e-1)]
    lines = [
        "| tolerance | scenes | "
        + " | ".join((*RUNGS, "refused"))
        + " | steps between rows (median, most) | kept |",
        "|" + "---|" * 9,
    ]
    for low, high in bands:
        of = [o for o in outcomes if low <= o.tolerance < high]
        counts = Counter(o.chosen[0] if o.chosen else "refused" for o in of)
        steps = [o.chosen[1] for o in of if o.chosen] or [0]
        kept, ran = sum(o.ratio < 1 for o in of), sum(o.chosen is not None for o in of)
        shares = " | ".join(str(counts[rung]) for rung in (*RUNGS, "refused"))
        lines.append(
            f"| {low:g} to {high:g} | {len(of)} | {shares} | {np.median(steps):g}, {max(steps)} | {kept} of {ran} |"
        )
    return "\n".join(lines)


RUNGS = ("steady", "amplitude", "envelope", "exact")


def told(outcomes: list[Outcome]) -> str:
    """What a table does not show."""
    ran = [o for o in outcomes if o.chosen]
    by_carrier = [o.carrier_ratio for o in ran if math.isfinite(o.carrier_ratio)]
    said = f"Error over tolerance: median {np.median([o.ratio for o in ran]):.2f}, largest {max(o.ratio for o in ran):.2f}."
    if by_carrier:
        said += (
            f" {len(by_carrier)} of them also against the carrier, integrated: largest {max(by_carrier):.2f}."
        )
    broken = [
        f"seed {o.seed}: {o.line}: {o.chosen}, error {o.ratio:.2f} tolerances" for o in ran if not o.ratio < 1
    ]
    refused = [f"seed {o.seed}: {o.line}" for o in outcomes if not o.chosen]
    for title, lines in (("Not kept", broken), ("Refused", refused)):
        said += f"\n\n{title}:\n\n```\n" + "\n".join(lines) + "\n```" if lines else f"\n\n{title}: none."
    return said


# --- long times ----------------------------------------------------------------------------------------------------------


def phase_table() -> str:
    """1e4 s, a billion samples at 100 kHz, in intervals of 1000 s."""
    from mpmath import mp

    lines = ["| detuning, Hz | phase turned, rad | largest error | bound |", "|---|---|---|---|"]
    for detuning in (0.01, 1.0, 37.0, 400.0):
        plant, f = Plant(0.3, 5e3, 1e6, 0.0), 1e6 - detuning
        scene = Scene(plant, {"drive": Profile.constant(2.0), "frequency": Profile.constant(f)}, 11, 1e-3)
        truth = []
        with mp.workdps(60):
            w0, omega, rate = 2 * mp.pi * mp.mpf(plant.f0), 2 * mp.pi * mp.mpf(f), 1 / mp.mpf(plant.tau)
            damped = mp.sqrt(w0**2 - rate**2)
            b = mp.mpf(plant.G) * rate * w0 / damped * 2
            poles = ((-rate + 1j * (damped - omega), b), (-rate - 1j * (damped + omega), -b))
            truth = [complex(sum(push / s * mp.expm1(s * 1000 * k) for s, push in poles)) for k in range(11)]
        turned = 2 * np.pi * detuning * 1e4
        found, bound = error(scene.simulate().response, np.array(truth)), 4 * 1.1e-16 * turned + 50 * 2.2e-16
        lines.append(f"| {detuning:g} | {turned:.2g} | {found:.1e} | {bound:.1e} |")
    return "\n".join(lines)


def report(exact: str, outcomes: list[Outcome], long: list[Outcome], phase: str) -> str:
    return f"""# Scenes against the truth

Made by `python benchmarks/scene_truth.py --scenes {len(outcomes)} --long {len(long)}`. Errors are the largest deviation of a row over the
largest response.

## The exact envelope

Random steps of drive, frequency, temperature and force, some on rows and some between them, 60 rows.

{exact}

What is left is rounding; on the right also the integrator's tolerance, 1e-12 a step.

## Automatic fidelity

{len(outcomes)} random scenes of 60 rows, 0.02 to 50 time constants apart, Q from 8 to 2000 and the plate's own, inputs held, ramped and
constant, effects of {len(SETS)} sets. The truth is the exact envelope at 1024 steps between rows, and where a scene has fewer than {PERIODS}
periods of the carrier also the carrier.

{automatic_table(outcomes)}

{told(outcomes)}

{len(long)} long ones: 40 000 rows, of which automatic fidelity tries some; the truth is the exact envelope at 64 steps, the error that
of all rows.

{automatic_table(long)}

{told(long)}

## Long times

A resonance of 1 MHz and tau = 5000 s, driven aside of it from rest, after 1e4 s (a billion samples at 100 kHz) against 60 digits.
The phase is a product of rounded numbers: four roundings of 1.1e-16 of it.

{phase}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--long", type=int, default=20)
    parser.add_argument("--replay", type=int)
    given = parser.parse_args()
    if given.replay is not None:
        print(outcome(given.replay))
        return
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        exact, phase = exact_table(), phase_table()
        long = [long_outcome(seed) for seed in track(range(given.long), "long")]
        outcomes = []
        for seed in track(range(given.scenes), "automatic"):
            outcomes.append(outcome(seed))
            if len(outcomes) % 10 == 0 or len(outcomes) == given.scenes:  # what stands so far
                (HERE / "scene_truth.md").write_text(report(exact, outcomes, long, phase), encoding="utf-8")


if __name__ == "__main__":
    main()
