"""What a design promises against plates that it has not seen, and what it refuses:  python benchmarks/promise.py

Writes promise.md beside itself.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import controller
import sysid
from controller.ensemble import Ensemble
from controller.margins import margins
from sysid import Plant, Profile, Scene
from sysid.scene.effects import FingerDamping

HERE = Path(__file__).parent
LOGS = [
    HERE.parent / "data" / "synthetic" / f"{name}.csv" for name in ("step_100V_24C", "sweep_24C", "sweep_32C")
]
ASKED = {
    "amplitude": 1.0,
    "voltage_limit": 200.0,
    "frequency_window": (31900.0, 32700.0),
    "finger": 1.0,
    "warming": (-10.0, 15.0),
}
T = 1e-4


def fresh(posterior, count: int) -> tuple[list[Scene], Ensemble]:
    """`count` draws, each with a finger of 0 to 1.5 N that halves the amplitude at most, and -10 to +15 degC."""
    rng = np.random.default_rng(7)
    size = posterior.draws["tau"].size
    which = rng.choice(size, count, replace=False)
    names = ("G", "tau", "f0", "k_T")
    plates = [Plant(*(float(np.ravel(posterior.draws[name])[i]) for name in names)) for i in which]
    force, warm = rng.uniform(0, 1.5, count), rng.uniform(-10, 15, count)
    finger = FingerDamping(law="power", exponent=1.0)  # damping in proportion to the force
    at = float(posterior.fit.reference_temperature)
    scenes = []
    for plate, F, w in zip(plates, force, warm, strict=True):
        given = {"drive": 100.0, "frequency": plates[0].f0, "force": float(F), "temperature": at + float(w)}
        profiles = {name: Profile.constant(value) for name, value in given.items()}
        scenes.append(Scene(plate, profiles, 400, 1e4, (finger,), fidelity="envelope"))
    G, tau = (np.array([getattr(p, name) for p in plates]) for name in ("G", "tau"))
    return scenes, Ensemble(G / tau, (1 + force / 1.5) / tau, np.zeros(count))


def kept(loop, scenes: list[Scene], plants: Ensemble) -> str:
    traces = controller.closed_loops(loop, scenes, reference=ASKED["amplitude"])
    taken = np.array([controller.settling_time(t.time, t.W, ASKED["amplitude"]) for t in traces])
    found, p = margins(loop.law, plants, T, loop.delay), loop.promise
    late = taken > p.settling + 1e-9
    thin = (
        (found.gain < p.gain)
        | (np.rad2deg(found.phase) < p.phase)
        | (found.disk < p.disk)
        | (found.delay < p.delay)
    )
    said = f"{1e3 * p.settling:.2f} ms | {p.gain:.2f}, {p.phase:.0f}°, {p.disk:.2f}, {1e3 * p.delay:.2f} ms"
    return f"| {loop.method} | {said} | {late.sum()} | {thin.sum()} | {(late | thin).sum()} | {1e3 * np.median(taken):.2f} ms |"


def said(what: str, **given) -> str:
    """What `design` answers."""
    try:
        loop = controller.design(**given)
    except ValueError as error:
        return f"| {what} | refused: {error} |"
    p = loop.promise
    return f"| {what} | {loop.bandwidth_hz:.4g} Hz ({loop.bandwidth_bound}), settles within {1e3 * p.settling:.3g} ms |"


def wide(posterior, share: float):
    """The posterior with tau spread to a standard deviation of `share` of itself, as logs that hardly determine it leave it."""
    rng = np.random.default_rng(0)
    tau = posterior.summary()["tau"].value * np.exp(share * rng.standard_normal(posterior.draws["tau"].shape))
    return dataclasses.replace(posterior, draws={**posterior.draws, "tau": tau})


def low(posterior):
    """The same fit as if its logs had been driven up to 20 V."""
    logs = tuple(
        dataclasses.replace(
            f, log=dataclasses.replace(f.log, drive=f.log.drive * (20.0 / np.max(np.abs(f.log.drive))))
        )
        for f in posterior.fit.logs
    )
    return dataclasses.replace(posterior, fit=dataclasses.replace(posterior.fit, logs=logs))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=1000)
    given = parser.parse_args()
    fit = sysid.fit(sysid.read_logs([str(path) for path in LOGS]))
    posterior, other = sysid.sample(fit, seed=0), sysid.sample(fit, seed=1)
    scenes, plants = fresh(other, given.draws)
    rows = [
        kept(controller.design(posterior, method=m, **ASKED), scenes, plants)
        for m in ("pi", "paper", "pll", "adaptive")
    ]
    tau, cold = (
        posterior.summary()["tau"],
        {**ASKED, "voltage_limit": 102.0, "finger": 0.0, "frequency_window": (30000, 34600)},
    )
    bare = {"source": posterior}
    answers = [
        said("the same logs driven up to 20 V, 2 um asked for", source=low(posterior), amplitude=2.0),
        said(
            "1 um under a finger that halves it, 90 V at most",
            **bare,
            amplitude=1.0,
            finger=1.0,
            voltage_limit=90.0,
        ),
        said("1 um in 0.5 ms, 200 V", **bare, amplitude=1.0, settling_time=0.5e-3, voltage_limit=200.0),
        said("1 um in 0.8 ms, 60 V", **bare, amplitude=1.0, settling_time=0.8e-3, voltage_limit=60.0),
        said("a bandwidth of 1 kHz", **bare, bandwidth_hz=1000.0),
        said(
            "2 um from 102 V over -90 to +90 degC",
            **bare,
            **{**cold, "warming": (-90.0, 90.0), "amplitude": 2.0},
        ),
        said(
            "a window of 32.2 to 32.4 kHz over +15 degC",
            **bare,
            warming=(0.0, 15.0),
            frequency_window=(32200.0, 32400.0),
        ),
    ]
    rows_of_tau = [
        said(f"tau known to {100 * s:.2g} %", source=wide(posterior, s), voltage_limit=200.0, amplitude=1.0)
        for s in (tau.std / tau.value, 0.05, 0.1, 0.2)
    ]
    note = controller.design(wide(posterior, 0.2), voltage_limit=200.0, amplitude=1.0).notes[0]
    line = "\n"
    text = f"""# What a design promises

Made by `python benchmarks/promise.py --draws {given.draws}`, from the posterior of three logs in `data/synthetic`.

## Kept by fresh draws

Designed on the draws of one seed for 1 um, 200 V, a finger that halves the amplitude and -10 to +15 degC. Each of {given.draws} draws of another seed, with
a finger of 0 to 1.5 N and a temperature of that range, is a scene. Missed: settling later than promised, or one of the margins smaller. At most
{given.draws // 50} may.

| method | settling promised | gain, phase, disk, delay margin promised | settling missed | a margin missed | either | settling, median |
|---|---|---|---|---|---|---|
{line.join(rows)}

## What cannot be had

| asked | answer |
|---|---|
{line.join(answers)}

## Logs that hardly determine tau

| | answer |
|---|---|
{line.join(rows_of_tau)}

It says why: "{note}".
"""
    (HERE / "promise.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
