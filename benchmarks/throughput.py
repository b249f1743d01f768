"""Fits of many plates one by one, and one joint fit of many logs, beside scipy with the same model in numpy."""

import cProfile
import pstats
from functools import partial

import numpy as np
from peers import (
    F0,
    FAR,
    FREQUENCY,
    K_T,
    TAU,
    G,
    in_turns,
    reached,
    seconds,
    since,
    slopes,
    spread,
    step,
    stepped,
)
from scipy.optimize import curve_fit, least_squares

import sysid

LENGTHS = {
    100: 10.0,
    300: None,
    1000: 4.0,
    3000: None,
}  # rows of a log, and by what the throughput is wanted above scipy's
START = np.array([*FAR * [G, TAU], F0 - FREQUENCY + 20, 0.0, 0.0])
SCALE = np.array([G, TAU, 50.0, 0.1, 0.1])
PARTS = ("minima", "_starts", "_descend", "update", "misfits", "tightened")


def by_scipy(log: sysid.Log) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and covariance of one log by itself."""
    t = since(log.time, log.drive)
    found = least_squares(lambda p: (stepped(p, t) - log.response).view(float), START, x_scale=SCALE)
    return found.x, np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (2 * len(t) - len(START))


def many(repeat: int, plates: int = 10) -> str:
    rows = []
    for length, wanted in LENGTHS.items():
        logs = [step(length, seed) for seed in range(plates)]
        sysid.fit(logs[:1])
        ways = {
            "sysid": lambda logs=logs: [sysid.fit([x]) for x in logs],
            "scipy": lambda logs=logs: [by_scipy(x) for x in logs],
        }
        _, took = in_turns(ways, repeat)
        each = {name: 1e3 * t / plates for name, t in took.items()}
        ratio = float(np.median(each["scipy"] / each["sysid"]))
        said = f"{ratio:.2g}" if wanted is None else reached(ratio, wanted)
        rows.append(f"| {length} | {spread(each['sysid'])} | {spread(each['scipy'])} | {said} |")
    table = "\n".join(rows)
    return f"""## Many plates

One log each, {plates} plates, fitted one by one: ms per plate, median (range). scipy's `least_squares` has the plate, a detuning and an offset in
numpy, starts 20 % off, and takes the noise for white. `sysid.fit` finds its start, the noise's level and colour, rotation, background,
offset, start and lateness, tests the residual for what the model leaves out and writes what it cannot tell.

| rows of a log | sysid | scipy | sysid's throughput over scipy's |
|---|---|---|---|
{table}

{shares([[step(100, seed)] for seed in range(plates)])}
"""


def shares(runs: list[list[sysid.Log]]) -> str:
    """Where the time of one fit after another goes."""
    profile = cProfile.Profile()
    profile.enable()
    for logs in runs:
        sysid.fit(logs)
    profile.disable()
    known = pstats.Stats(profile)
    found = known.stats
    total = max(v[3] for v in found.values())
    of = {name: sum(v[3] for k, v in found.items() if k[2] == name and "sysid" in k[0]) for name in PARTS}
    waited = sum(v[3] for k, v in found.items() if k[2] == "_seen" and "minimise" in k[0])
    said = ", ".join(f"`{name}` {100 * t / total:.0f} %" for name, t in of.items())
    return f"""Of the time of such a fit (cProfile; each with all that it calls): {said}; of these the compiled programs, until
their results are there, {100 * waited / total:.0f} %. What is left is numpy, in {known.total_calls / len(runs):.0f} calls of functions for one fit: a microsecond and more for each."""


def joint(repeat: int, logs: int = 10, length: int = 1250) -> str:
    """25 000 residuals in one fit: the plate is shared, each log has a temperature and an offset of its own."""
    warm = np.linspace(20, 34, logs)
    data = [step(length, seed, degC=degC) for seed, degC in enumerate(warm)]
    t, y = since(data[0].time, data[0].drive), np.stack([x.response for x in data])
    start = np.concatenate([START[:3], [0.8 * K_T], np.zeros(2 * logs)])
    scale = np.concatenate([SCALE[:3], [10.0], np.full(2 * logs, 0.1)])

    def of(p: np.ndarray, k: int) -> np.ndarray:
        return np.array([*p[:2], p[2] + p[3] * (warm[k] - 24), *p[4 + 2 * k : 6 + 2 * k]])

    def model(p: np.ndarray) -> np.ndarray:
        return np.concatenate([stepped(of(p, k), t) for k in range(logs)]).view(float)

    def derivative(p: np.ndarray) -> np.ndarray:
        jacobian = np.zeros((len(p), logs, length), complex)
        for k in range(logs):
            own = slopes(of(p, k), t)
            jacobian[:3, k], jacobian[3, k] = own[:3], own[2] * (warm[k] - 24)
            jacobian[4 + 2 * k : 6 + 2 * k, k] = own[3:]
        return jacobian.reshape(len(p), -1).view(float).T

    flat = y.ravel().view(float)

    def once() -> None:
        model(start), derivative(start)

    # curve_fit's Levenberg-Marquardt knows no scales: it is given parameters of about one.
    ways = {
        "sysid.fit": partial(sysid.fit, data),
        "scipy `least_squares`, default Jacobian": lambda: least_squares(
            lambda p: model(p) - flat, start, x_scale=scale
        ),
        "scipy `curve_fit`, analytic Jacobian": lambda: curve_fit(
            lambda _, *x: model(scale * x),
            t,
            flat,
            start / scale,
            jac=lambda _, *x: derivative(scale * x) * scale,
        ),
    }
    _, took = in_turns(ways, repeat)
    ours, floor = took["sysid.fit"], min(seconds(once) for _ in range(5))
    most = float(np.median(took["scipy `least_squares`, default Jacobian"])) / 10
    wanted = {"scipy `least_squares`, default Jacobian": 10, "scipy `curve_fit`, analytic Jacobian": 1}
    lines = [
        f"| {n} | {spread(x)} | {reached(float(np.median(x / ours)), wanted[n]) if n in wanted else 1} |"
        for n, x in took.items()
    ]
    table = "\n".join(lines)
    return f"""## One joint fit

{logs} logs at as many temperatures, {2 * logs * length} residuals, {len(start)} parameters for scipy (start 20 % off); warm, with covariance.

| | s: median (range) | over sysid |
|---|---|---|
{table}

What is wanted, {1e3 * most:.2g} ms, is {most / floor:.2g} evaluations of residuals and Jacobian in numpy ({1e3 * floor:.2g} ms each), start and noise known. {shares([data])}

{large(repeat)}"""


def large(repeat: int) -> str:
    """One long log beside one evaluation of residuals and Jacobian in numpy."""
    rows = []
    for residuals in (10**6, 10**7):
        log = step(residuals // 2)
        t = since(log.time, log.drive)

        def once(t=t, log=log):
            return stepped(START, t) - log.response, slopes(START, t)

        ways = {"fit": partial(sysid.fit, [log]), "once": once}
        _, took = in_turns(ways, min(repeat, 3))
        ratio = float(np.median(took["fit"] / took["once"]))
        rows.append(
            f"| {residuals:.0e} | {spread(took['fit'])} | {spread(took['once'])} | {reached(ratio, 5, at_most=True)} |"
        )
    table = "\n".join(rows)
    return f"""| residuals of one log | `sysid.fit`, warm, s | residuals and Jacobian once in numpy, s | ratio |
|---|---|---|---|
{table}
"""


def section(repeat: int) -> str:
    seconds(lambda: sysid.fit([step(100)]))
    return f"{many(repeat)}\n{joint(repeat)}"
