"""What scenes cost: every effect, ten seconds at 100 kHz, and the carrier by an integrator:  python benchmarks/scenes.py

Needs the extra `bench` (diffrax). Writes scenes.md beside itself. Times are medians of alternating runs of warm programs, in
processor seconds where that is said, else in seconds on the clock.

    --repeats N    runs of each (default 7)
"""

import argparse
import dataclasses
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

from sysid import Plant, Profile, Scene
from sysid.scene import EFFECTS, engine

HERE = Path(__file__).parent
PLATE = Plant(G=0.02, tau=5e-3 / float(np.log(20)), f0=32300.0, k_T=-10.16)
SECONDS, RATE = 2.0, 1e5
NEEDS = {"finger_detuning": ("finger_damping",)}


def inputs(seconds: float) -> dict[str, Profile]:
    """A drive that is switched, a frequency that is stepped, a plate that warms, a finger that comes and goes."""
    steps = np.arange(0.0, seconds, 0.05)
    return {
        "drive": Profile(steps, np.where(np.arange(len(steps)) % 2, 60.0, 100.0)),
        "frequency": Profile(steps + 0.012, 32290.0 + 10.0 * (np.arange(len(steps)) % 4)),
        "temperature": Profile([0.0, seconds], [24.0, 26.0], held=False),
        "force": Profile(np.linspace(0, seconds, 9), np.arange(9) % 2 * 1.5, held=False),
    }


def scene(names: tuple[str, ...], seconds: float = SECONDS) -> Scene:
    """A scene of these effects. Full scale of the inverter's duty is the drive that the others get."""
    values = {"inverter": {"supply": 1.0}, "amplifier_limit": {"limit": 90.0}}
    effects = tuple(EFFECTS[name](**values.get(name, {})) for name in names)
    return Scene(PLATE, inputs(seconds), int(seconds * RATE), RATE, effects)


def equations(names: tuple[str, ...]) -> int:
    """Equations of the program that advances a scene, those of inner programs too."""
    of = scene(names)
    with jax.enable_x64(True):
        key, plant = jax.random.key(0), jax.tree.map(float, of.plant)
        state, (chunk, _) = engine.start("exact", plant, of.effects, key), of._chunk(0, 64)
        traced = jax.make_jaxpr(engine.advance, static_argnums=7)(
            plant, of.effects, state, chunk, key, jnp.asarray(0), 1 / RATE, "exact", PLATE.f0
        )
    return _count(traced.jaxpr)


def _count(jaxpr) -> int:
    inner = [v for e in jaxpr.eqns for v in e.params.values() if hasattr(v, "eqns") or hasattr(v, "jaxpr")]
    wrappers = sum(e.primitive.name in ("pjit", "jit", "closed_call", "custom_jvp_call") for e in jaxpr.eqns)
    return len(jaxpr.eqns) - wrappers + sum(_count(getattr(v, "jaxpr", v)) for v in inner)


def alternating(runs: list[Callable[[], object]], repeats: int, clock: Callable[[], float] = time.process_time) -> list[float]:
    """Median seconds of each, taken in turns, so that a busy machine slows all alike; the first turn compiles."""
    spent: list[list[float]] = [[] for _ in runs]
    for turn in range(repeats + 1):
        for run, seconds in zip(runs, spent, strict=True):
            begun = clock()
            run()
            if turn:
                seconds.append(clock() - begun)
    return [median(seconds) for seconds in spent]


def effects_table(repeats: int) -> str:
    """Each effect alone, and what the full scene saves without it."""
    everything = tuple(EFFECTS)
    bare, bare_equations = scene(()), equations(())
    full, full_equations = scene(everything), equations(everything)
    lines = ["| effect | equations | ms a simulated second, alone | ms a simulated second, in the full scene |", "|---|---|---|---|"]
    for name in track(EFFECTS, "effects"):
        needs = NEEDS.get(name, ())
        less = tuple(n for n in everything if n != name and name not in NEEDS.get(n, ()))
        base, alone = scene(needs), scene((*needs, name))
        without, with_it = scene(less), full if len(less) == len(everything) - 1 else scene((*less, name))
        a, b, c, d = alternating([s.simulate for s in (base, alone, without, with_it)], repeats)
        own = equations((*needs, name)) - equations(needs)
        lines.append(f"| {name} | {own} | {(b - a) / SECONDS * 1e3:.1f} | {(d - c) / SECONDS * 1e3:.1f} |")
    a, d = alternating([bare.simulate, full.simulate], repeats)
    lines.append(f"| none | {bare_equations} | {a / SECONDS * 1e3:.1f} | |")
    lines.append(f"| all | {full_equations} | | {d / SECONDS * 1e3:.1f} |")
    return "\n".join(lines)


def log_table(repeats: int) -> str:
    """The 100 kHz log at growing lengths: time per row does not grow."""
    names = ("finger_damping", "white_noise", "quantisation")
    lines = ["| simulated | rows | processor s | clock s | processor us a row |", "|---|---|---|---|---|"]
    lengths = (0.7, 1.25, 2.5, 5.0, 10.0)  # the first is one chunk
    runs = [scene(names, seconds) for seconds in lengths]
    spent = alternating([s.simulate for s in runs], repeats)
    clocked = alternating([s.simulate for s in runs], repeats, time.perf_counter)
    for s, seconds, a, b in zip(runs, lengths, spent, clocked, strict=True):
        lines.append(f"| {seconds:g} s | {s.rows} | {a:.2f} | {b:.2f} | {a / s.rows * 1e6:.2f} |")
    return "\n".join(lines)


# --- the carrier by an integrator -------------------------------------------------------------------------------------------


def by_diffrax(of: Scene, tolerance: float) -> Callable[[], np.ndarray]:
    """Rows of a bare scene with a constant drive and straight lines, by Dopri8 on w'' + ds w' + w0^2 w = N Re[jV e^{j theta}].

    The rows are w - j w'/omega in the frame of the drive: Z, but for the fast mode's image, which the truth is given too.
    """
    import diffrax

    (V,), omega = of.inputs["drive"].values, 2 * np.pi * float(of.inputs["frequency"].values[0])
    finger = of.find(EFFECTS["finger_damping"])
    warm, pressed = (of.inputs[name] for name in ("temperature", "force"))
    time_of_rows = jnp.arange(of.rows) / of.rate
    N = PLATE.G * 2 / PLATE.tau

    def slope(t, y, args):
        w, u = y
        w0 = 2 * np.pi * (PLATE.f0 + PLATE.k_T * (jnp.interp(t, warm.times, warm.values) - 24.0))
        force = jnp.interp(t, pressed.times, pressed.values)
        rho = 0.0 if finger is None else effects_contact(finger, force)
        return jnp.stack([omega * u, (-N * w0 * V * jnp.sin(omega * t) - w0**2 * w) / omega - 2 / PLATE.tau * (1 + rho) * u])

    def solve():
        # tolerances are of the largest response, G V
        controller = diffrax.PIDController(rtol=tolerance, atol=tolerance * PLATE.G * float(V))
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(slope), diffrax.Dopri8(), 0.0, time_of_rows[-1], 1e-7, jnp.zeros(2),
            saveat=diffrax.SaveAt(ts=time_of_rows), stepsize_controller=controller, max_steps=None,
        )  # fmt: skip
        return found.ys

    program = jax.jit(solve)
    return lambda: np.asarray(program())


def effects_contact(finger, force):
    return finger.ratio(engine.Inputs(None, None, None, None, force))


def carrier_of(of: Scene, steps: int) -> np.ndarray:
    """(rows, 2): w and w'/omega of the exact envelope, from rows a quarter of a period apart in pairs... by its own modes."""
    fine = dataclasses.replace(of, substeps=steps)
    rows, chunk_state = [], None
    del chunk_state
    for log in fine.stream():
        rows.append(log.response)
    return np.concatenate(rows)


def integrator_table(repeats: int) -> str:
    raise NotImplementedError
