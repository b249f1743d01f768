"""What a scene costs, effect by effect and beside an integrated carrier:  python benchmarks/scenes.py --repeats 5

Everything is compiled and warm. What is compared is run in turns; figures are the least of the turns, as what else runs on a
machine only adds. Times are those of the processor, summed over threads. Needs the extra `bench`. Writes scenes.md beside itself.
"""

import argparse
import dataclasses
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import programs  # noqa: E402
from scene_truth import PLATE, carrier, error, made  # noqa: E402

from sysid import Plant, Profile, Scene  # noqa: E402
from sysid.scene import EFFECTS  # noqa: E402

RATE = 1e5  # rows a second


Clock = Callable[[], float]


def seconds(
    runs: dict[str, Callable[[], object]], repeats: int, clock: Clock = time.process_time
) -> dict[str, float]:
    """Processor time of each run, the least of `repeats` turns, after one that compiles."""
    found: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(repeats + 1):
        for name, run in runs.items():
            begun = clock()
            run()
            found[name] += [clock() - begun] if turn else []
    return {name: min(times) for name, times in found.items()}


# --- each effect ---------------------------------------------------------------------------------------------------------

NEEDS = {"finger_detuning": ("finger_damping",)}
ON_INPUTS = ("inverter", "amplifier_limit", "frequency_resolution", "delay")


def scene_with(names: tuple[str, ...], fidelity: str = "exact") -> Scene:
    """One second of the plate, everything about it changing now and then."""
    times = np.array([0.0, 0.2, 0.5])
    levels = {
        "drive": [0.0, 0.5, 0.25],
        "frequency": [32290.0, 32310.0, 32300.0],
        "temperature": [24.0, 25.0, 23.0],
    }
    inputs = {name: Profile(times, values) for name, values in (levels | {"force": [0.0, 1.5, 0.5]}).items()}
    return Scene(PLATE, inputs, int(RATE), RATE, made(*names), fidelity=fidelity)


def equations(scene: Scene) -> int:
    return len(programs.program(dataclasses.replace(scene, rows=60))[0])


def effects_table(repeats: int) -> str:
    """Equations and time of each effect alone and among all the others."""
    every = tuple(EFFECTS)
    lines = ["| effect | equations | alone, ms | in the full scene, ms |", "|---|---|---|---|"]
    whole, bare = scene_with(every), scene_with(())
    least, most = equations(bare), equations(whole)
    for name in track(every, "effects"):
        below = NEEDS.get(name, ())
        beside = tuple(
            n for n in every if n != name and name not in NEEDS.get(n, ())
        )  # what needs it goes with it
        scenes = {"below": scene_with(below), "alone": scene_with((*below, name))}
        scenes |= {"without": scene_with(beside), "whole": scene_with((*beside, name))}
        took = seconds({key: scene.simulate for key, scene in scenes.items()}, repeats)
        count = equations(scenes["alone"]) - equations(scenes["below"])
        where = "0, made with the inputs" if name in ON_INPUTS else str(count)
        alone, among = took["alone"] - took["below"], took["whole"] - took["without"]
        lines.append(f"| {name} | {where} | {1e3 * alone:+.1f} | {1e3 * among:+.1f} |")
    took = seconds({"bare": bare.simulate, "whole": whole.simulate}, repeats)
    lines.append(f"| none: the bare resonator | {least} in all | {1e3 * took['bare']:.1f} in all | |")
    lines.append(f"| all of them | {most} in all | | {1e3 * took['whole']:.1f} in all |")
    return "\n".join(lines)


# --- the carrier, integrated -----------------------------------------------------------------------------------------------

SETTINGS = {  # steps in a period, or tolerance of a step: from coarse to fine
    "Dopri8, even steps": (3, 4, 5, 6, 8, 11, 16, 23, 32, 64),
    "Dopri8, PID steps": tuple(10.0 ** np.arange(-2, -13.5, -0.5)),
    "Tsit5, PID steps": tuple(10.0 ** np.arange(-2, -13.5, -0.5)),
}
SHARE = 0.04  # s of a scene of a second that are integrated: 24 time constants, 1292 periods
Integrator = Callable[[float], jax.Array]


def integrator(scene: Scene, setting: str) -> Integrator:
    """d/q rows of w'' + (2/tau) w' + w0^2 w = N v by diffrax, compiled, as a function of its fineness: one drive, from rest.

    w and v are complex, Z = w e^{-j theta}, so that no filter is needed; the state is real, (w, w'/w0) by real and imaginary
    part.
    """
    import diffrax

    w0, omega, tau = (
        2 * np.pi * scene.plant.f0,
        2 * np.pi * float(scene.inputs["frequency"].values[0]),
        scene.plant.tau,
    )
    force = scene.plant.G * 2 / tau * float(scene.inputs["drive"].values[0])
    times, even = np.arange(scene.rows) / scene.rate, setting.endswith("even steps")
    solver = diffrax.Dopri8() if setting.startswith("Dopri8") else diffrax.Tsit5()

    def slope(t, y, _):
        (w, u), turn = y, omega * t
        return jnp.stack([w0 * u, -w0 * w - 2 / tau * u + force * jnp.stack([-jnp.sin(turn), jnp.cos(turn)])])

    @jax.jit
    def rows(fineness):
        size = scene.plant.G * 100  # of the settled response
        control = (
            diffrax.ConstantStepSize() if even else diffrax.PIDController(rtol=fineness, atol=fineness * size)
        )
        first = 2 * np.pi / omega / (fineness if even else 20)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(slope), solver, 0.0, times[-1], first, jnp.zeros((2, 2)), saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=control, max_steps=None, throw=False, adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        w = found.ys[:, 0]
        return (w[:, 0] + 1j * w[:, 1]) * jnp.exp(-1j * omega * times)

    def run(fineness: float) -> jax.Array:
        with jax.enable_x64(True):
            return jax.block_until_ready(rows(fineness))

    return run


def coarsest(run: Integrator, setting: str, truth: np.ndarray, wanted: float) -> tuple[float, float]:
    """The coarsest of a setting's steps whose d/q error is `wanted` or less, and that error."""
    errors = (
        (fineness, error(np.asarray(run(fineness)), truth)) for fineness in map(float, SETTINGS[setting])
    )
    return next(((fineness, off) for fineness, off in errors if off <= wanted), (np.nan, np.inf))


def carrier_table(repeats: int) -> str:
    """The exact envelope and the integrated carrier, for the same rows."""
    lines = [
        "| rows a second | error wanted | diffrax at its best | its error | s | exact envelope: its error | ms | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    inputs = {"drive": Profile.constant(100.0), "frequency": Profile.constant(32290.0)}
    for rate in (1e3, 1e4):
        scene = Scene(PLATE, inputs, int(rate), rate)
        short = dataclasses.replace(scene, rows=int(SHARE * rate))
        truth, integrators = (
            carrier.by_expm(short),
            {setting: integrator(short, setting) for setting in SETTINGS},
        )
        own = error(short.simulate().response, truth)
        for wanted in track((1e-3, 1e-6, 1e-9), f"carrier, {rate:g} rows a second"):
            found = {setting: coarsest(run, setting, truth, wanted) for setting, run in integrators.items()}
            runs = {s: partial(integrators[s], fine) for s, (fine, off) in found.items() if np.isfinite(off)}
            took = seconds(runs | {"": scene.simulate}, repeats)
            best = min(runs, key=lambda setting: took[setting])
            took[best] /= SHARE
            cells = [f"{rate:g}", f"{wanted:g}", f"{best}, {found[best][0]:.2g}", f"{found[best][1]:.1e}"]
            cells += [
                f"{took[best]:.2f}",
                f"{own:.1e}",
                f"{1e3 * took['']:.2f}",
                f"{took[best] / took['']:.0f}",
            ]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


# --- long scenes -----------------------------------------------------------------------------------------------------------


def streamed(scene: Scene) -> None:
    for _ in scene.stream():
        pass


def bench_log(rows: int, fidelity: str = "exact") -> Scene:
    """A log at 100 kHz of a plate that is driven, warms and is touched, with noise and the recorder's steps."""
    slow = np.linspace(0.0, 10.0, 101)
    inputs = {
        "drive": Profile([0.0, 1.0, 3.0], [0.0, 100.0, 50.0]),
        "frequency": Profile.constant(32290.0),
        "temperature": Profile(slow, 24 + 3 * np.sin(slow), held=False),
        "force": Profile([0.0, 2.0, 2.1, 5.0, 5.2], [0.0, 0.0, 1.5, 1.5, 0.0], held=False),
    }
    return Scene(
        PLATE, inputs, rows, RATE, made("finger_damping", "white_noise", "quantisation"), fidelity=fidelity
    )


def rows_table(repeats: int) -> str:
    """Time over the number of rows."""
    lines = ["| rows | s | ns a row |", "|---|---|---|"]
    for rows in (10**4, 10**5, 10**6, 10**7):
        took = seconds({"": partial(streamed, bench_log(rows))}, repeats if rows < 10**7 else 1)[""]
        lines.append(f"| {rows} | {took:.3g} | {1e9 * took / rows:.0f} |")
    return "\n".join(lines)


def log_table(repeats: int) -> str:
    """Ten seconds at 100 kHz, as a log in memory."""
    scenes = {name: bench_log(10**6, name) for name in ("exact", "envelope")}
    runs = {name: scene.simulate for name, scene in scenes.items()}
    wall, took = seconds(runs, repeats, time.perf_counter), seconds(runs, repeats)
    lines = ["| envelope | s on the clock | s of the processor |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {name} | {wall[name]:.2f} | {took[name]:.2f} |" for name in runs)])


def memory_table() -> str:
    """A day, streamed: what the process holds on to."""
    quartz = Plant(0.3, 1e6 / (np.pi * 5e6), 5e6, -3.0)
    lines = ["| simulated | rows | s | growth of the peak memory, MB |", "|---|---|---|---|"]
    minutes = np.arange(0.0, 86400, 60.0) + 0.0123
    drift = Profile(minutes, 24 + 3 * np.sin(2 * np.pi * minutes / 86400))
    constants = {"drive": Profile.constant(2.0), "frequency": Profile.constant(5e6 + 3)}
    for rate, hours in ((100.0, 1), (100.0, 24)):
        scene = Scene(quartz, constants | {"temperature": drift}, int(3600 * hours * rate) + 1, rate)
        streamed(dataclasses.replace(scene, rows=200_000))
        before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        streamed(scene)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        took = time.process_time() - begun
        lines.append(f"| {hours} h at {rate:g} rows a second | {scene.rows} | {took:.1f} | {grown:.1f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    memory = memory_table()  # first: what others leave in memory would hide its growth
    print(memory, flush=True)
    log, rows = log_table(repeats), rows_table(repeats)
    print(log, rows, sep="\n\n", flush=True)
    beside = carrier_table(repeats)
    print(beside, flush=True)
    effects = effects_table(repeats)
    text = f"""# What a scene costs

Made by `python benchmarks/scenes.py --repeats {repeats}`. Everything is compiled and warm; what is compared was run in turns, {repeats} of each, and the
least time is given: what else runs on a machine only adds. Times are those of the processor, summed over threads, unless said otherwise.

## Ten seconds at 100 kHz

A plate that is driven, warms and is touched, with noise and the recorder's steps; a million rows, as a log in memory.

{log}

## Over the number of rows

The same, exact envelope, streamed.

{rows}

## A day

A quartz of 5 MHz whose temperature drifts in steps of a minute.

{memory}

## Beside the carrier, integrated

The plate of 32.3 kHz, driven 10 Hz below its resonance from rest, which nothing disturbs: no switching, which would cost the integrator
more. diffrax integrates w'' + (2/tau) w' + w0^2 w = N v, with complex w and v so that no filter is needed to see d/q, and is given each time
the best of Dopri8 at even steps, Dopri8 and Tsit5 at steps that a PID controller chooses, each at its coarsest steps (per period, or the tolerance,
after the name) whose error is the wanted one or less. It does so over {SHARE:g} s, and its time is scaled to the second that the envelope
simulates. The truth is the matrix exponential from row to row. The exact envelope has one error.

{beside}

## Each effect

One second at 100 kHz of a scene in which drive, frequency, temperature and force change twice, exact envelope, as a log in memory. Equations are those
of the compiled program, inner programs included, over the scene without the effect ("finger_detuning": over "finger_damping"). "In the full
scene": all effects but this one (and what needs it), and then with it. "duffing" and "self_heating" take one interval after the other. Each is a
difference of two times; what is below zero says how well it is known.

{effects}
"""
    (HERE / "scenes.md").write_text(text, encoding="utf-8")
    print(effects)


if __name__ == "__main__":
    main()
