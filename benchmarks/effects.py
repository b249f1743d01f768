"""Effects of scenes, as fits find them.  python benchmarks/effects.py --seeds 10

Each effect is put into simulated logs of one plate, small and clear, and these are fitted with the effects that logs may call for and
without. Of each bench (a step, a sweep, both, three of each) and size the table says what was found ("-": nothing), how often the fit
was successful, the largest |value - truth|/error of the determined G, tau and f0 of successful fits, before (without effects) and
after, and the root mean square of those after.

    --seeds N   of each (default 10)       --only NAME   effects whose name holds NAME; printed, not written

Writes effects.md beside itself.
"""

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from sysid import Fit, Log, Scene, fit
from sysid.scene.effects import EFFECTS
from sysid.trials.trial import NUISANCES

SCENES = Path(__file__).parents[1] / "data/synthetic/scenes/plate"
WHERE = Path(__file__).with_suffix(".md")
STEP, SWEEP = "step_100V_24C", "sweep_24C"
BENCHES = {
    "step": (STEP,),
    "sweep": (SWEEP,),
    "pair": (STEP, SWEEP),
    "three of each": (STEP, "step_60V_27C", "step_140V_31C", SWEEP, "sweep_28C", "sweep_32C"),
}
HALF = 95.4  # Hz, half a bandwidth of the plate
MOVING = ("delay", "lock_in")  # what settled points do not show


@dataclass(frozen=True)
class Kind:
    """An effect of scenes at two sizes, the names by which a fit may find it, and whether amplitudes alone are recorded."""

    small: dict
    clear: dict
    found: tuple[str, ...]
    name: str = ""
    amplitude: bool = False


KINDS = {
    "nothing": Kind({}, {}, (), ""),
    "delay": Kind({"time": 0.15e-3}, {"time": 0.5e-3}, ("delay", "filter"), "delay"),
    "filter of one pole": Kind({"tau": 0.15e-3}, {"tau": 0.6e-3}, ("filter", "delay"), "lock_in"),
    "filter of four poles": Kind(
        {"tau": 40e-6, "order": 4}, {"tau": 150e-6, "order": 4}, ("filter", "delay"), "lock_in"
    ),
    "softening": Kind({"softening": 2.0}, {"softening": 30.0}, ("duffing",), "duffing"),
    "second mode": Kind(
        {"f0": 32300 + 4 * HALF, "G": 0.001},
        {"f0": 32300 + 4 * HALF, "G": 0.008},
        ("second_mode",),
        "second_mode",
    ),
    "feedthrough, amplitudes": Kind(
        {"d": 1e-4, "q": 2e-4}, {"d": 4e-4, "q": 2e-3}, ("feedthrough",), "feedthrough", True
    ),
    "saturation": Kind({"limit": 3.0}, {"limit": 1.9}, ("saturation",), "saturation"),
}


def simulated(bench: Sequence[str], kind: Kind, size: dict, seed: int) -> list[Log]:
    """Logs of a bench with an effect of that size, as someone writes them down who does not know of it."""
    logs = []
    for k, name in enumerate(bench):
        scene = Scene.from_toml(SCENES / f"{name}.toml")
        if kind.name and not (scene.kind == "steady" and kind.name in (*MOVING, "duffing")):
            kept = tuple(
                e
                for e in scene.effects
                if e.name != kind.name and not (kind.amplitude and e.name == "offset")
            )
            scene = replace(scene, effects=(*kept, EFFECTS[kind.name](**size)))
        log = replace(scene.simulate(seed * len(bench) + k), name=name, bench={}, force=None)
        log = softened(log, scene, **size) if kind.name == "duffing" and scene.kind == "steady" else log
        logs.append(replace(log, response=np.abs(log.response)) if kind.amplitude else log)
    return logs


def softened(log: Log, scene: Scene, softening: float) -> Log:
    """Settled points of a plate whose resonance falls by `softening` |W|^2 (Hz), each on the branch of the one before: |W|^2 is a root
    of a cubic. Scenes have no softening of settled points."""
    plant, before, rows = scene.plant, 0.0, []
    drive, warm = np.asarray(log.drive), np.asarray(log.temperature) - 24.0
    linear = plant.G * drive / (1 + 2j * np.pi * plant.tau * (log.frequency - plant.f0 - plant.k_T * warm))
    for f, volts, degC in zip(log.frequency, drive, warm, strict=True):
        x, s = 2 * np.pi * plant.tau * np.array([f - plant.f0 - plant.k_T * degC, softening])
        power = np.roots([s**2, 2 * s * x, 1 + x**2, -((plant.G * volts) ** 2)])
        power = np.sort(power[np.abs(power.imag) < 1e-9 * np.max(np.abs(power))].real)
        before = float(
            power[np.argmin(np.abs(power[:: max(len(power) - 1, 1)] - before)) * max(len(power) - 1, 1)]
        )
        rows.append(plant.G * volts / (1 + 1j * (x + s * before)))
    turn = np.vdot(linear, log.response)
    return replace(log, response=log.response + turn / abs(turn) * (np.array(rows) - linear))


def off(found: Fit, truth: dict[str, float]) -> list[float]:
    """|value - truth|/error of what is determined."""
    if found.result.name != "successful":
        return []
    known = {n: found.parameters[n] for n in truth if found.parameters[n].determined}
    return [abs(p.value - truth[n]) / p.std for n, p in known.items()]


def row(bench: str, kind: Kind, size: dict, seeds: int) -> str:
    """Cells of the table for one bench and size."""
    names, before, after, right = Counter(), [], [], 0
    for seed in range(seeds):
        logs = simulated(BENCHES[bench], kind, size, seed + 50)
        plant = Scene.from_toml(SCENES / f"{BENCHES[bench][0]}.toml").plant
        found, without = fit(logs), fit(logs, nuisances=NUISANCES)
        warm = found.reference_temperature
        truth = {
            "G": plant.G,
            "tau": plant.tau,
            "f0": plant.f0 + plant.k_T * ((24.0 if warm is None else warm) - 24.0),
        }
        before += off(without, truth)
        after += off(found, truth)
        right += found.result.name == "successful"
        names[", ".join(f"{f.key} {f.outcome}" for f in found.findings if f.outcome != "noted") or "-"] += 1
    said = "; ".join(f"{name} {n}" for name, n in names.most_common())
    worst = [f"{max(z):.1f}" if z else "-" for z in (before, after)]
    rms = f"{np.sqrt(np.mean(np.square(after))):.2f}" if after else "-"
    return f"{said} | {right} of {seeds} | {worst[0]} | {worst[1]} | {rms}"


def rows(kinds: dict[str, Kind], seeds: int) -> Iterator[str]:
    for name, kind in kinds.items():
        for bench in BENCHES:
            if (kind.amplitude and bench != "sweep") or (kind.name in MOVING and bench == "sweep"):
                continue
            for word, size in (("small", kind.small), ("clear", kind.clear)) if kind.name else (("", {}),):
                line = f"| {name} | {word} | {bench} | {row(bench, kind, size, seeds)} |"
                print(line, flush=True)
                yield line


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    kinds = {name: kind for name, kind in KINDS.items() if given.only in name}
    table = [
        "# Effects of scenes, as fits find them", "",
        f"Made by `python benchmarks/effects.py --seeds {given.seeds}` on {date.today()}.", "",
        __doc__.partition("\n\n")[2].partition("    --seeds")[0],
        "| effect | size | logs | found | successful | worst before | worst after | rms after |", "|---|---|---|---|---|---|---|---|",
        *rows(kinds, given.seeds), "",
    ]  # fmt: skip
    if not given.only:
        WHERE.write_text("\n".join(table), encoding="utf-8")


if __name__ == "__main__":
    main()
