"""Simulated logs, written and read back: do the fits return what the scenes were made of?  python benchmarks/read_back.py --draws 40

First every scene of data/synthetic/scenes as it is. Then one effect after the other, added to a step and to sweeps of the plate:
what becomes of its parameters, and does the fit say so? Where an effect makes the very log of another plate, that plate is the
truth. Seeds are 100, 101, ...; scenes without noise are given 20 nm of it. Each log goes through write_log and read_logs. Writes
read_back.md beside itself.

    --draws N      of each scene (default 40)          --effects N    draws of each effect (default 10)
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.stats import chi2

from sysid import Fit, Log, Plant, Profile, Result, Scene, fit, read_logs, write_log
from sysid.model.theta import FINGER
from sysid.precision import keep_programs
from sysid.rows.hold import contact
from sysid.scene import EFFECTS

HERE = Path(__file__).parent
SCENES = HERE.parent / "data" / "synthetic" / "scenes"
FIRST_SEED = 100
NAMES = ("G", "tau", "f0", "k_T")
NOISE = 0.02  # um, of scenes without noise
# standard deviations: a root mean square of scores beyond it is a wrong value with a narrow interval
FAR = 3.0


@dataclass(frozen=True)
class Outcome:
    """One fit: how it ended, (value - truth)/std and the relative error of each parameter that it fitted, the sum of squares
    of the scores over their covariance, and what was said against it."""

    result: Result
    scores: dict[str, float]
    errors: dict[str, float]
    distance: float
    said: str

    @property
    def warned(self) -> bool:
        """Called successful, and something named that would move a parameter."""
        return self.result is Result.successful and self.said != ""


def noisy(scene: Scene) -> Scene:
    """The scene, with noise if it has none."""
    if any(effect.kind == "noise" for effect in scene.effects):
        return scene
    return replace(scene, effects=(*scene.effects, EFFECTS["white_noise"](std=NOISE)))


def outcome(
    scenes: list[Scene], seed: int, told: Callable[[Log], Log], folder: Path, truth: Plant | None = None
) -> Outcome:
    """The fit to one draw of the scenes, whose logs went through files; its `truth` is the scene's plant, unless given."""
    paths = []
    for k, scene in enumerate(scenes):
        paths.append(folder / f"{k}.csv")
        write_log(told(scene.simulate(seed + 1000 * k)), paths[-1])
    found = fit(read_logs(paths))
    true = truth_of(scenes[0] if truth is None else replace(scenes[0], plant=truth), found)
    values = dict(zip(FINGER, found.modes[0].theta[4:], strict=True))
    values |= {name: getattr(found.plant, name) for name in NAMES}
    difference = np.array([values[name] - true[name] for name in found.names])
    std = np.sqrt(np.diag(found.covariance))
    scale = dict.fromkeys(found.names, 1.0) | {"G": true["G"], "tau": true["tau"]}
    known = [name for name in found.names if found.parameters[name].determined]
    said = {
        Result.misfit: found.warnings[-1:],
        Result.undetermined: [p.why for p in found.parameters.values() if p.why],
        Result.successful: [w for w in found.warnings if "of its standard deviations" in w],
    }
    return Outcome(
        found.result,
        {n: float(d / s) for n, d, s in zip(found.names, difference, std, strict=True) if n in known},
        {n: float(d / scale[n]) for n, d in zip(found.names, difference, strict=True)},
        float(difference @ np.linalg.solve(found.covariance, difference)),
        next(iter(said.get(found.result, ())), ""),
    )


def truth_of(scene: Scene, found: Fit) -> dict[str, float]:
    """The plant of a scene, at the fit's temperature, and its finger; the gain of a duty ratio where that was recorded: at small
    ones."""
    plant, at = scene.plant, found.reference_temperature
    gain = plant.G
    if inverter := scene.find(EFFECTS["inverter"]):
        gain *= inverter.supply * (1 if inverter.law == "linear" else 2)
    warming = 0.0 if at is None else at - plant.reference_temperature
    finger, detuning = scene.find(EFFECTS["finger_damping"]), scene.find(EFFECTS["finger_detuning"])
    rho = finger.rho if finger else 0.0
    touch = {
        "finger_damping": rho,
        "finger_detuning": -detuning.ratio * rho / (2 * np.pi * plant.tau) if detuning else 0.0,
    }
    return {
        "G": gain,
        "tau": plant.tau,
        "f0": plant.f0 + (plant.k_T or 0.0) * warming,
        "k_T": plant.k_T,
        **touch,
    }


# --- every scene as it is ---------------------------------------------------------------------------------------------


def scene_files() -> list[Path]:
    return sorted(SCENES.glob("*.toml")) + sorted(SCENES.glob("*/*.toml"))


def scene_table(draws: int, folder: Path) -> tuple[list[str], float, int]:
    """The rows of the first table, and the sum of squares of all scores of fits that are called successful."""
    lines = ["| scene | ends | G | tau | f0 | k_T | says |", "|---|---|---|---|---|---|---|"]
    total, size = 0.0, 0
    for path in track(scene_files(), console=Console(stderr=True), description="scenes"):
        scene = noisy(Scene.from_toml(path))
        found = [outcome([scene], FIRST_SEED + k, lambda log: log, folder) for k in range(draws)]
        good = [o for o in found if o.result is Result.successful]
        total += sum(o.distance for o in good)
        size += sum(len(o.errors) for o in good)
        columns = [spread([o.scores[name] for o in good if name in o.scores]) for name in NAMES]
        name = path.relative_to(SCENES).with_suffix("").as_posix()
        lines.append(f"| {name} | {ends(found)} | {' | '.join(columns)} | {shortened(found)} |")
    return lines, total, size


def spread(scores: list[float]) -> str:
    return f"{np.mean(scores):+.2f}, {np.std(scores):.2f}" if len(scores) > 1 else "-"


def ends(found: list[Outcome]) -> str:
    counts = Counter("warned" if o.warned else o.result.name for o in found)
    return ", ".join(f"{name} {n}" for name, n in counts.most_common())


def shortened(found: list[Outcome]) -> str:
    """What the first fit says that is not called successful, without the file's name and the advice."""
    said = next((o.said for o in found if o.said), "")
    said = said.partition(".csv: ")[2] or said
    return said.partition(";")[0].partition(": ")[0]


# --- one effect at a time ---------------------------------------------------------------------------------------------


def named(name: str) -> Scene:
    return Scene.from_toml(SCENES / f"{name}.toml")


def plus(scene: Scene, *effects, **inputs) -> Scene:
    return replace(scene, effects=(*scene.effects, *effects), inputs={**scene.inputs, **inputs})


def slow_sweep() -> Scene:
    """The sweep of figure 6 as it happens: a second for each frequency, the plate following."""
    scene = named("figure_6_sweep")
    frequency = Profile(np.arange(101.0), scene.inputs["frequency"].at(np.arange(101.0)))
    return replace(
        scene, kind="transient", rows=102, rate=1.0, inputs={**scene.inputs, "frequency": frequency}
    )


def without_bench(log: Log) -> Log:
    """The log of someone who did not write down the lock-in's filter, or the delay."""
    return replace(log, bench={})


def same(log: Log) -> Log:
    return log


def without_force(log: Log) -> Log:
    return replace(log, force=None)


@dataclass(frozen=True)
class Case:
    """An effect, and the scenes that show it: fitted one by one, or `together`. `alike`: the plate that makes the same logs without
    the effect, where there is one."""

    name: str
    scenes: dict[str, Scene]
    told: Callable[[Log], Log] = same
    alike: Plant | None = None


def cases() -> Iterator[Case]:
    step, sweep, stairs = (
        named("plate/step_100V_24C"),
        named("plate/sweep_24C"),
        named("plate/duty_staircase"),
    )
    ringing, jumps, slow = (
        named("plate/sweep_while_ringing"),
        named("plate/frequency_staircase"),
        slow_sweep(),
    )
    e = EFFECTS
    both = {"step": step, "sweep": sweep}

    def added(scenes: dict[str, Scene], *effects, **inputs) -> dict[str, Scene]:
        return {name: plus(scene, *effects, **inputs) for name, scene in scenes.items()}

    yield Case("none", both | {"duty stairs": stairs, "ringing sweep": ringing, "slow sweep": slow})
    press = {"force": Profile.constant(0.5)}
    pressed = added(both, e["finger_damping"](), **press)
    yield Case("finger_damping, 0.5 N throughout", pressed)
    yield Case(
        "finger_damping, 0.5 N throughout, force not recorded",
        pressed,
        without_force,
        damped(step.plant, 0.5),
    )
    touch = Profile([0.0, 0.01, 0.012], [0.0, 0.0, 1.0], held=False)
    touched = added({"step": step, "ringing sweep": ringing}, e["finger_damping"](), force=touch)
    yield Case("finger_damping, a touch on the way", touched)
    yield Case(
        "finger_detuning 0.3 with its damping, 0.5 N",
        added(both, e["finger_damping"](), e["finger_detuning"](), **press),
    )
    yield Case(
        "duffing, 5 Hz/um^2",
        added({"step": step, "ringing sweep": ringing, "slow sweep": slow}, e["duffing"]()),
    )
    yield Case(
        "duffing, 20 Hz/um^2",
        added({"step": step, "ringing sweep": ringing, "slow sweep": slow}, e["duffing"](softening=20.0)),
    )
    yield Case("self_heating", added({"step": step, "slow sweep": slow}, e["self_heating"]()))
    yield Case("second_mode, 10 % at +1.2 kHz", added(both | {"ringing sweep": ringing}, e["second_mode"]()))
    yield Case("second_mode, 10 % at +150 Hz", added(both, e["second_mode"](f0=32450.0)))
    yield Case("two_ceramics", added(both, e["two_ceramics"]()))
    limit = e["amplifier_limit"](limit=80.0)
    yield Case(
        "amplifier_limit, 80 V of 100 V", added(both, limit), alike=replace(step.plant, G=0.8 * step.plant.G)
    )
    yield Case("amplifier_limit, 80 V", added({"duty stairs": stairs}, limit))
    yield Case(
        "inverter, sine law", {"duty stairs": bent(stairs), "figure_5_duty": bent(named("figure_5_duty"))}
    )
    yield Case("frequency_resolution, 10 Hz", added({"ringing sweep": ringing}, e["frequency_resolution"]()))
    yield Case(
        "phase_reset", added({"frequency stairs": jumps, "ringing sweep": ringing}, e["phase_reset"]())
    )
    moving = {"step": step, "ringing sweep": ringing}
    for tau, order in ((50e-6, 1), (300e-6, 1), (300e-6, 2)):
        said = f"lock_in, {1e6 * tau:.0f} us, order {order}"
        filtered = added(moving, e["lock_in"](tau=tau, order=order))
        yield from (Case(said, filtered), Case(f"{said}, not stated", filtered, without_bench))
    for late in (10e-6, 100e-6):
        delayed = added(moving, e["delay"](time=late))
        yield from (
            Case(f"delay, {1e6 * late:.0f} us", delayed),
            Case(f"delay, {1e6 * late:.0f} us, not stated", delayed, without_bench),
        )
    yield Case("coloured_noise, 20 nm over 1 ms, besides", added(both, e["coloured_noise"]()))
    yield Case("outliers, 1 % of 0.5 um", added(both, e["outliers"]()))
    yield Case("drop_outs, 1 ms each, five a second", added(moving, e["drop_outs"]()))
    yield Case("saturation, 1.5 um", added(both, e["saturation"](limit=1.5)))
    yield Case("quantisation, 10 nm", added(both, e["quantisation"]()))
    yield Case("quantisation, 200 nm", added(both, e["quantisation"](step=0.2)))


def damped(plant: Plant, force: float) -> Plant:
    """What a finger that never leaves it makes of a plate."""
    added = 1 + float(contact(force))
    return replace(plant, G=plant.G / added, tau=plant.tau / added)


def bent(scene: Scene) -> Scene:
    """The scene with an inverter of the sine law, of the same gain at small duty ratios."""
    others = tuple(effect for effect in scene.effects if effect.name != "inverter")
    return replace(scene, effects=(*others, EFFECTS["inverter"](supply=100.0, law="sine")))


def effect_table(draws: int, folder: Path) -> tuple[list[str], list[str]]:
    """The rows of the second table, and those of it that are wrong in silence."""
    lines, silent = [], []
    for case in track(list(cases()), console=Console(stderr=True), description="effects"):
        single = {name: [scene] for name, scene in case.scenes.items()}
        pairs = (
            {"step, sweep": [case.scenes["step"], case.scenes["sweep"]]}
            if {"step", "sweep"} <= case.scenes.keys()
            else {}
        )
        for name, scenes in (single | pairs).items():
            loud = [noisy(s) for s in scenes]
            found = [outcome(loud, FIRST_SEED + k, case.told, folder, case.alike) for k in range(draws)]
            good = [o for o in found if o.result is Result.successful and not o.warned]
            wrong = [n for n in NAMES if rms([o.scores[n] for o in good if n in o.scores]) > FAR]
            verdict = (
                "named"
                if not good
                else "**silent**"
                if wrong
                else "covered, as another plate"
                if case.alike
                else "covered"
            )
            verdict += (
                f", {len(found) - len(good)} of {len(found)} named" if good and len(good) < len(found) else ""
            )
            columns = [
                f"{rms([o.scores[n] for o in found if n in o.scores]):.1f} ({off(n, found)})"
                for n in NAMES[:3]
            ]
            line = f"| {case.name} | {name} | {ends(found)} | {' | '.join(columns)} | {verdict} | {shortened(found)} |"
            lines.append(line)
            silent += [line] if wrong and good else []
    return lines, silent


def rms(scores: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(scores)))) if scores else 0.0


def off(name: str, found: list[Outcome]) -> str:
    """The mean error of a parameter: per cent of it, Hz of f0."""
    errors = [o.errors[name] for o in found if name in o.errors]
    if not errors:
        return "-"
    return f"{np.mean(errors):+.2g} Hz" if name == "f0" else f"{100 * np.mean(errors):+.2g} %"


# --- the page ---------------------------------------------------------------------------------------------------------

HEAD = ["| effect | log | ends | G | tau | f0 | verdict | says |", "|---|---|---|---|---|---|---|---|"]


def page(given: argparse.Namespace, folder: Path) -> str:
    begun = time.perf_counter()
    scenes, total, size = scene_table(given.draws, folder)
    effects, silent = effect_table(given.effects, folder)
    chance = 100 * chi2.cdf(total, size)
    return "\n".join(
        [
            "# Simulated logs, read back",
            "",
            f"Made by `python benchmarks/read_back.py --draws {given.draws} --effects {given.effects}`"
            f" in {(time.perf_counter() - begun) / 60:.0f} minutes.",
            "",
            "## Every scene as it is",
            "",
            f"{given.draws} draws of each. The columns hold mean and standard deviation of (value - truth)/std over the fits called",
            f"successful: 0 ± {1 / np.sqrt(given.draws):.2f} and 1 ± {1 / np.sqrt(2 * given.draws):.2f} are expected. All of them"
            " together: squared distances from the",
            f"truth, over each fit's covariance, sum to {total:.0f} on {size} numbers; chance stays below that in {chance:.0f} % of"
            " cases.",
            "",
            *scenes,
            "",
            "## One effect at a time",
            "",
            f"{given.effects} draws of each. The columns hold the root mean square of (value - truth)/std where the parameter was"
            " determined, and in brackets",
            f"its mean error. Verdicts: `covered`, successful and within {FAR:g}; `named`, no fit is called successful, or it is"
            " `warned` of what moves a parameter;",
            "`silent`, called successful, unwarned, with an interval that misses; `as another plate`: nothing in the logs tells the"
            " effect from that plate, which is then the truth.",
            "",
            *HEAD,
            *effects,
            "",
            "## Wrong in silence",
            "",
            *(HEAD + silent if silent else ["None."]),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--effects", type=int, default=10)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        text = page(given, Path(folder))
    (HERE / "read_back.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
