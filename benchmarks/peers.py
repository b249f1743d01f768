"""What the comparisons of results.py share: logs of one plate, its model as a user of scipy writes it, times taken in turns."""

import gc
import time
from collections.abc import Callable

import numpy as np

import sysid

G, TAU, F0, K_T = 0.02, 5e-3 / np.log(20), 32300.0, -10.15
DRIVE, FREQUENCY = 100.0, 32290.0
FAR = np.array([1.2, 0.8])  # by what a peer's start of G and tau is off


def step(rows: int, seed: int = 0, noise: float = 0.05, degC: float = 24.0) -> sysid.Log:
    """30 ms of a step behind 6 ms of rest, 10 Hz below the resonance at 24 degC, with an output offset."""
    rng = np.random.default_rng(seed)
    at = 0.036 / rows * np.arange(rows)
    drive = np.where(at < 0.006, 0.0, DRIVE)
    clean = stepped(np.array([G, TAU, F0 + K_T * (degC - 24) - FREQUENCY, 0.01, -0.02]), since(at, drive))
    response = clean + noise * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    given = {
        "time": at,
        "drive": drive,
        "frequency": np.full(rows, FREQUENCY),
        "temperature": np.full(rows, degC),
    }
    return sysid.Log(f"step {seed}", response, kind="transient", sampling="instant", **given)


def since(at: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Seconds of each row since the step; before it 0."""
    return np.maximum(at - at[np.argmax(drive > 0)], 0.0)


def stepped(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Response to the step t seconds ago: p = G, tau, detuning (Hz), offset in d and in q."""
    pole = -1 / p[1] + 2j * np.pi * p[2]
    return p[0] / p[1] * DRIVE * np.expm1(pole * t) / pole + p[3] + 1j * p[4]


def slopes(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Its derivatives (5, n)."""
    pole, gain = -1 / p[1] + 2j * np.pi * p[2], p[0] / p[1] * DRIVE
    shape = np.expm1(pole * t) / pole
    by_pole = gain * (t * np.exp(pole * t) - shape) / pole
    one = np.ones(len(t))
    return np.stack(
        [gain / p[0] * shape, by_pole / p[1] ** 2 - gain / p[1] * shape, 2j * np.pi * by_pole, one, 1j * one]
    )


def settled(G, tau, f0, frequency, xp=np):
    """Response to a settled drive of 1 V: G (w0/omega) / (1 - j (w0^2 - omega^2) tau / (2 omega)), exact."""
    w0, omega = 2 * np.pi * f0, 2 * np.pi * frequency
    return G * (w0 / omega) / (1 - 1j * (w0 - omega) * (w0 + omega) * tau / (2 * omega))


def in_turns(
    ways: dict[str, Callable[[], object]], repeat: int
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Seconds of each way's first call, and of `repeat` later ones, in alternating order: a busy machine slows all alike."""
    first = {name: seconds(way) for name, way in ways.items()}
    later: dict[str, list[float]] = {name: [] for name in ways}
    for k in range(repeat):
        for name in list(ways)[:: 1 if k % 2 else -1]:
            later[name].append(seconds(ways[name]))
    return first, {name: np.array(took) for name, took in later.items()}


def seconds(way: Callable[[], object]) -> float:
    gc.collect()
    begun = time.perf_counter()
    way()
    return time.perf_counter() - begun


def spread(x: np.ndarray) -> str:
    """Median (least to most)."""
    return f"{np.median(x):.3g} ({np.min(x):.3g} to {np.max(x):.3g})"


def reached(ratio: float, wanted: float, at_most: bool = False) -> str:
    """A ratio beside what is wanted of it."""
    kept = ratio <= wanted if at_most else ratio >= wanted
    return f"{ratio:.3g} (wanted: {'at most' if at_most else 'at least'} {wanted:g}; {'reached' if kept else 'not reached'})"
