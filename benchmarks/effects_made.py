"""Logs of one plate with an effect of the registry, by code that shares none with the package.

    made("softening", "clear", "pair", seed) -> logs
    right("softening", "clear", degC) -> truths, any of which will do

`KINDS` says what is put in, at a small and a clear size, and by which names a fit may find it."""

import cmath
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from effects_plate import (
    BENCHES,
    DEGC,
    F0,
    HALF,
    K_T,
    LEAK,
    NOISE,
    STEP_OF_PAIR,
    SWEEP,
    TAU,
    TOP,
    TURN,
    Bench,
    G,
    Law,
    answered,
    behind,
    beside,
    between,
    blurred,
    clipped,
    coupled,
    failing,
    filtered,
    hurried,
    late,
    lost,
    overdriven,
    rows,
    second_order,
    stirred,
    while_,
)

from sysid import Log


def transient_only(shown):
    """Of transients; settled points are as ever."""
    return lambda bench, size: rows(bench) if bench.settled else shown(bench, size)


def sweep_only(shown):
    """Of the sweep, where there is one beside a step."""
    return lambda bench, size: rows(bench) if bench is STEP_OF_PAIR else shown(bench, size)


ALL, TIMED, DRIVEN = ("step", "sweep", "pair"), ("step", "pair"), ("levels", "levels, no frequency")


def apart(bench, size):
    """Driven by so many half bandwidths above its resonance."""
    return replace(bench, f=F0 + size * HALF + np.zeros(len(bench.time)))


def unstated(log, size):
    """Without its frequency, as an oscilloscope has it."""
    return replace(log, frequency=None, temperature=None)


@dataclass(frozen=True)
class Kind:
    """What is put in at two sizes: what the plate and its sensor show of a bench, and what the recorder makes
    of the log; by which names it may be found; `moved` the truth of that size at a temperature, as it differs
    from the plate's."""

    sizes: tuple[float, float]
    found: tuple[str, ...]
    benches: tuple[str, ...]
    shown: Callable[[Bench, float], np.ndarray] = lambda bench, size: rows(bench)
    recorder: Callable[[Log, float], Log] = lambda log, size: log
    driven: Callable[[Bench, float], Bench] = lambda bench, size: bench
    moved: Callable[[float, float], list[dict]] = lambda size, degC: [{}]
    amplitude: bool = False
    warmth: bool = True


def _acting(size_to_law, found=("drive",), **more):
    return {
        "found": found,
        "benches": DRIVEN,
        "shown": lambda b, s: rows(b, Law(acts=lambda v: size_to_law(v, s))),
        **more,
    }


KINDS = {
    "hardening": Kind(
        (2.0, 30.0), ("duffing",), ALL, lambda b, s: rows(b, Law(shift=lambda w: 4 * s * w**2))
    ),
    "amplitude damping": Kind((0.05, 0.6), ("amplitude_damping",), ALL, stirred),
    "blur": Kind((0.1, 0.5), ("blur",), ("sweep", "pair"), sweep_only(blurred)),
    "doublet": Kind(
        (0.7, 1.5),
        ("second_mode",),
        ALL,
        lambda b, s: beside(b, s, 0.8, TAU),
        moved=lambda s, degC: [{}, {"f0": s * HALF, "G": -0.2 * G}],
    ),
    "temperature damping": Kind(
        (1e-3, 0.015),
        ("temperature_damping",),
        ("four sweeps", "four steps"),
        lambda b, s: rows(b, Law(damping=1 + s * b.warm)),
        moved=lambda s, degC: [{x: v / (1 + s * (degC - DEGC)) - v for x, v in (("G", G), ("tau", TAU))}],
    ),
    "curved": Kind(
        (0.05, 0.5),
        ("curved",),
        ("four sweeps", "four steps"),
        lambda b, s: rows(b, Law(shifts=s * b.warm**2 / 2)),
        moved=lambda s, degC: [{"f0": s * (degC - DEGC) ** 2 / 2, "k_T": s * (degC - DEGC)}],
    ),
    "f0 drift": Kind(
        (3.0, 40.0), ("f0_drift",), (*ALL, "there and back"), lambda b, s: rows(b, Law(shifts=s * b.place))
    ),
    "self-heating": Kind(
        (-3.0, -40.0),
        ("self_heating",),
        ("step", "there and back"),
        lambda b, s: rows(b, Law(heats=(s, b.time[-1] / 6))),
    ),
    "resonance of its own": Kind(
        (2.0, 40.0),
        ("resonance",),
        ("pair",),
        lambda b, s: rows(b, Law(shifts=s * b.settled)),
        moved=lambda s, degC: [{}, {"f0": s}],
        warmth=False,
    ),
    "offset drift": Kind(
        (0.01, 0.1),
        ("offset_drift",),
        TIMED,
        transient_only(lambda b, s: rows(b) + s * TOP * cmath.exp(1j) * (b.place + 0.5)),
    ),
    "phase drift": Kind(
        (0.03, 0.3),
        ("phase_drift",),
        (*TIMED, "there and back"),
        lambda b, s: rows(b) * np.exp(1j * s * b.place * (b is not SWEEP)),
    ),
    "cable": Kind((8e-6, 160e-6), ("phase_delay", "delay"), ("sweep", "pair"), late),
    "image": Kind(
        (0.005, 0.06),
        ("image",),
        ALL,
        recorder=lambda log, s: answered(lambda y: (1 - s / 2) * y.real + 1j * (1 + s / 2) * y.imag)(log),
    ),
    "tone": Kind(
        (0.006, 0.05),
        ("tone",),
        TIMED,
        transient_only(lambda b, s: rows(b) + s * TOP * np.exp(1j * (2 * np.pi * 170 * b.time + 1))),
    ),
    "AC coupling": Kind((1.0, 0.015), ("ac_coupling",), TIMED, transient_only(coupled)),
    "edges": Kind((0.25, 0.75), ("edges",), ("burst", "levels"), driven=between),
    "rows lost": Kind((2.0, 6.0), ("rows_lost",), TIMED, recorder=lost),
    "thermometer's lag": Kind((0.3, 3.0), ("thermometer_lag",), ("warming",), recorder=behind),
    "dwell": Kind(
        (4.0, 0.8), ("dwell",), ("sweep", "pair"), lambda b, s: hurried(b, s) if b.settled else rows(b)
    ),
    "overshoot": Kind((0.9, 0.4), ("overshoot",), ("step, no frequency",), second_order),
    "second pole": Kind(
        (0.03, 0.3),
        ("second_pole",),
        ("step, no frequency",),
        lambda b, s: (1 - s) * rows(b) + s * rows(b, Law(tau=5 * TAU)),
    ),
    "drive overshoot": Kind(
        (0.05, 0.25), ("drive_overshoot",), ("step", "pair", "burst"), transient_only(overdriven)
    ),
    "dead band": Kind((1.0, 15.0), **_acting(lambda v, s: np.maximum(v - s, 0.0))),
    "drive limit": Kind((158.0, 130.0), **_acting(np.minimum)),
    "drive compressed": Kind((0.01, 0.15), **_acting(lambda v, s: v * (1 - s * (v / 160) ** 2))),
    "power of the drive": Kind((1.03, 2.0), **_acting(lambda v, s: 100 * (v / 100) ** s)),
    "falls faster": Kind(
        (0.05, 0.5), ("asymmetric",), ("burst", *DRIVEN), lambda b, s: rows(b, Law(damping=1 + s * b.falls))
    ),
    "saturation": Kind(
        (0.25, 0.7),
        ("saturation",),
        ALL,
        lambda b, s: (w := rows(b)) * np.tanh(s * np.abs(w) / TOP) / np.maximum(s * np.abs(w) / TOP, 1e-300),
    ),
    "saturation, carrier": Kind((1.9, 1.5), ("saturation",), ALL, lambda b, s: clipped(rows(b), s)),
    "saturation, clip": Kind(
        (1.96, 1.8),
        ("saturation", "rows"),
        ALL,
        recorder=lambda log, s: answered(lambda y: np.clip(y.real, -s, s) + 1j * np.clip(y.imag, -s, s))(log),
    ),
    "feedthrough, amplitudes": Kind(
        (0.1, 1.0), ("feedthrough",), ("sweep",), lambda b, s: rows(b) + s * (0.04 + 0.2j), amplitude=True
    ),
    "slope": Kind(
        (0.02, 0.2),
        ("slope", "offset_drift"),
        ("sweep", "chirp"),
        lambda b, s: rows(b) + s * TOP * cmath.exp(1j) * b.place,
    ),
    "finger for a while": Kind(
        (0.05, 0.6),
        ("stretch", "finger"),
        ALL,
        sweep_only(
            lambda b, s: rows(b, Law(damping=while_(b, 1 + s), shifts=while_(b, -0.5 * s * HALF, 0.0)))
        ),
    ),
    "another range": Kind(
        (0.05, 0.6), ("stretch",), ALL, sweep_only(lambda b, s: rows(b) * while_(b, 1 - s))
    ),
    "drive fails": Kind((0.1, 1.0), ("stretch",), ALL, sweep_only(failing)),
    "off resonance": Kind((0.5, 3.0), ("off_resonance",), ("step", "burst"), recorder=unstated, driven=apart),
    "off resonance, amplitudes": Kind(
        (0.5, 3.0), ("off_resonance",), ("step", "burst"), recorder=unstated, driven=apart, amplitude=True
    ),
    "nothing": Kind((0.0,), (), tuple(BENCHES)),
    "softening": Kind(
        (2.0, 30.0), ("duffing",), ALL, lambda b, s: rows(b, Law(shift=lambda w: -4 * s * w**2))
    ),
    "second mode": Kind((0.05, 0.4), ("second_mode",), ALL, lambda b, s: beside(b, 4.0, s, 1.5e-3)),
    "delay": Kind((0.15e-3, 0.5e-3), ("delay", "filter"), TIMED, transient_only(late)),
    "filter of one pole": Kind(
        (0.15e-3, 0.6e-3), ("filter", "delay"), TIMED, transient_only(lambda b, s: filtered(b, s, 1))
    ),
    "filter of four poles": Kind(
        (40e-6, 150e-6), ("filter", "delay"), TIMED, transient_only(lambda b, s: filtered(b, s, 4))
    ),
}
NO_G = ("power of the drive", "overshoot", "second pole")  # of which there is no such G
SIZES = ("small", "clear")


def made(name: str, word: str, bench: str, seed: int) -> list[Log]:
    """Logs of a bench with that in them, as someone writes them down who does not know of it."""
    kind, size = KINDS[name], KINDS[name].sizes[SIZES.index(word)]
    rng = np.random.default_rng([seed, zlib.crc32(f"{name}, {bench}".encode())])
    return [kind.recorder(_log(rng, kind, kind.driven(b, size), size), size) for b in BENCHES[bench]]


def _log(rng: np.random.Generator, kind: Kind, bench: Bench, size: float) -> Log:
    """What a bench records: turned, with a little feedthrough, an offset and noise."""
    w, n, volts = kind.shown(bench, size), len(bench.time), bench.volts(bench.time)
    fed = volts if bench.settled else np.append(volts[0], volts[:-1])  # a row shows what was driven before it
    y = TURN * (w + LEAK * fed) + (0.0 if kind.amplitude else 4e-3 - 3e-3j)
    y = y + NOISE * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    if bench.f is None:
        y = (w + NOISE * rng.standard_normal(n)).real
    more = {"kind": "steady"} if bench.settled else {"kind": "transient", "sampling": "instant"}
    if kind.warmth and bench.f is not None:
        more["temperature"] = DEGC + np.broadcast_to(bench.warm, n)
    time = bench.time if bench.timed else None
    y = np.abs(y) if kind.amplitude else y
    return Log(bench.name, y, time=time, drive=volts, frequency=bench.f, **more)


def right(name: str, word: str, degC: float | None) -> list[dict[str, float]]:
    """Truths, at the temperature of which f0 is told; any of them will do."""
    degC = DEGC if degC is None else degC
    plate = {"G": G, "tau": TAU, "f0": F0 + K_T * (degC - DEGC), "k_T": K_T}
    kept = ("f0", "k_T") if name in ("overshoot", "second pole") else tuple(plate)
    plate = {x: v for x, v in plate.items() if x in kept and not (x == "G" and name in NO_G)}
    moved = KINDS[name].moved(KINDS[name].sizes[SIZES.index(word)], degC)
    return [{x: v + more.get(x, 0.0) for x, v in plate.items()} for more in moved]
