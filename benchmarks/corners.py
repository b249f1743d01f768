"""The plant at the corners of its numbers: finite everywhere, and right to rounding.  python benchmarks/corners.py

Each corner draws a plant and inputs: Q from 0.6 to 1e8, f0 from 1 mHz to 10 GHz, rows from 1e-9 to 1e9 tau apart (every tenth not
at all), drives beside the resonance by nothing, or by 1e-6 to 1e6 half bandwidths as far as frequencies stay above zero, and
amplitudes from 1e-15 to 1e15. Counted are values, and derivatives with respect to G, tau and f0, of `Plant.transient` (with both
modes and without the fast one's ripple) and `Plant.steady` that are not finite. For a sample, the values stand beside the same
equations in 60 digits (mpmath); the error, over the largest size of a mode in the log, is given in units of

    eps (1 + |a| T)            of a transient, a its pole, T its length, eps = 2.2e-16
    eps (1 + omega/omega0)     of a settled point, over its own size

which is what the rounding of a, T and the detuning themselves makes. Writes corners.md beside itself.

    --corners N   how many (default 1000000)    --sample N   of them in 60 digits (default 3000)    --seed N (default 0)
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

from sysid import Plant
from sysid.plant import Hold, respond, steady

HERE = Path(__file__).parent
EPS = np.finfo(float).eps
INTERVALS, CHUNK = 4, 20_000


def corners(n: int, seed: int) -> dict[str, np.ndarray]:
    """Plants (n,) and inputs (n, INTERVALS): interval k of a corner has its own drive, frequency and length."""
    rng = np.random.default_rng(seed)

    def decades(low: float, high: float, *shape: int) -> np.ndarray:
        return 10.0 ** rng.uniform(low, high, shape)

    f0, Q = decades(-3, 10, n), 0.6 * (1e8 / 0.6) ** rng.random(n)
    tau = Q / (np.pi * f0)
    off = decades(-6, 6, n, INTERVALS) * rng.choice([-1, 0, 1], (n, INTERVALS)) / (2 * np.pi * tau[:, None])
    low = f0[:, None] + off < 1e-3 * f0[:, None]
    frequency = f0[:, None] + np.where(low, -off, off)
    time = np.cumsum(tau[:, None] * decades(-9, 9, n, INTERVALS) * (rng.random((n, INTERVALS)) > 0.1), axis=1)
    duration = np.diff(time, axis=1, prepend=0.0)  # as they can be told from time stamps
    drive = decades(-15, 15, n, INTERVALS) * rng.choice([-1, 0, 1], (n, INTERVALS), p=[0.4, 0.1, 0.5])
    return {"G": decades(-15, 15, n), "tau": tau, "f0": f0, "frequency": frequency, "time": time, "duration": duration, "drive": drive}


def held(c: dict[str, np.ndarray]) -> tuple[Hold, np.ndarray]:
    """The inputs as the plant takes them, a row at each interval's end; and the frequency that offsets are taken from."""
    n = len(c["tau"])
    reference, zeros = c["frequency"][:, :1], np.zeros((n, INTERVALS))
    own = np.broadcast_to(np.arange(INTERVALS, dtype=np.int32), (n, INTERVALS))
    omega, offset = 2 * np.pi * c["frequency"], 2 * np.pi * (reference - c["frequency"])
    hold = Hold(c["duration"], c["drive"], omega, offset, zeros, zeros, own, c["duration"], zeros, zeros + 0j, np.zeros(n))
    return hold, reference[:, 0]


def size(p: Any, hold: Hold, reference: Any, both_modes: bool) -> Any:
    """A real number of the rows that G, tau and f0 all move, and the rows."""
    detuning = 2 * jnp.pi * (p[2] - reference) + hold.offset
    rows = p[0] * respond(p[1], detuning, hold, both_modes).forced
    return jnp.sum(rows.real + 0.5 * rows.imag), rows


def size_settled(p: Any, drive: Any, frequency: Any) -> Any:
    """The same of settled points."""
    rows = p[0] * drive * steady(p[1], 2 * jnp.pi * (p[2] - frequency), 2 * jnp.pi * frequency)
    return jnp.sum(rows.real + 0.5 * rows.imag), rows


def finite(c: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Whether each corner's values, and its derivatives, are finite; of each function."""
    hold, reference = held(c)
    p = np.stack([c["G"], c["tau"], c["f0"]], axis=1)
    found = {}
    for name, (values, slopes) in {
        "transient": MODES[False](p, hold, reference),
        "transient, both modes": MODES[True](p, hold, reference),
        "steady": SETTLED(p, c["drive"], c["frequency"]),
    }.items():
        found[name] = np.isfinite(values[1]).all(1), np.isfinite(slopes).all(1)
    return found


MODES = {both: jax.jit(jax.vmap(jax.value_and_grad(lambda p, h, r, both=both: size(p, h, r, both), has_aux=True))) for both in (False, True)}
SETTLED = jax.jit(jax.vmap(jax.value_and_grad(size_settled, has_aux=True)))


# --- the same in 60 digits --------------------------------------------------------------------------------------------------


def exactly(c: dict[str, np.ndarray], k: int, both_modes: bool) -> tuple[list[Any], Any, Any]:
    """Rows of corner `k`, one per interval's end, |a| T, and the largest size of a mode."""
    mp = mpmath.mp
    G, tau, f0 = (mp.mpf(float(c[name][k])) for name in ("G", "tau", "f0"))
    w0 = 2 * mp.pi * f0
    wd = mp.sqrt(w0**2 - tau**-2)
    slow = fast = mp.mpc(0)
    rows, turns, largest = [], mp.mpf(0), mp.mpf(0)
    for f, T, V in zip(c["frequency"][k], c["duration"][k], c["drive"][k], strict=True):
        omega, T, push = 2 * mp.pi * mp.mpf(float(f)), mp.mpf(float(T)), G * w0 / (tau * wd) * mp.mpf(float(V))
        s1, s2 = mp.mpc(-1 / tau, wd - omega), mp.mpc(-1 / tau, -(wd + omega))
        slow = slow * mp.exp(s1 * T) + push * mp.expm1(s1 * T) / s1
        fast = fast * mp.exp(s2 * T) - push * mp.expm1(s2 * T) / s2 if both_modes else push / s2
        rows.append(slow + fast)
        turns += abs(s2 if both_modes else s1) * T
        largest = max(largest, abs(slow), abs(fast))
    return rows, turns, largest


def settled_exactly(c: dict[str, np.ndarray], k: int) -> list[Any]:
    mp = mpmath.mp
    G, tau, f0 = (mp.mpf(float(c[name][k])) for name in ("G", "tau", "f0"))
    rows = []
    for f, V in zip(c["frequency"][k], c["drive"][k], strict=True):
        w, w0 = 2 * mp.pi * mp.mpf(float(f)), 2 * mp.pi * f0
        rows.append(G * mp.mpf(float(V)) * (w0 / w) / (1 - 1j * (w0**2 - w**2) * tau / (2 * w)))
    return rows


def plants(c: dict[str, np.ndarray], k: int) -> tuple[Plant, np.ndarray, np.ndarray, np.ndarray]:
    """Corner `k` as `Plant.transient` takes it: the plant, and times, drives and frequencies of the rows."""
    time = np.append(0.0, c["time"][k])
    last = np.append(c["drive"][k], 0.0), np.append(c["frequency"][k], c["frequency"][k][-1])
    return Plant(float(c["G"][k]), float(c["tau"][k]), float(c["f0"][k])), time, *last


def errors(c: dict[str, np.ndarray], k: int) -> dict[str, float]:
    """Of corner `k`, in units of eps (1 + |a| T)."""
    mpmath.mp.dps = 60
    hold, reference = jax.tree.map(lambda x: x[k : k + 1], held(c))
    p = np.stack([c["G"], c["tau"], c["f0"]], axis=1)[k : k + 1]
    found = {}
    plant, time, drive, frequency = plants(c, k)
    for name, both in (("transient", False), ("transient, both modes", True)):
        truth, turns, largest = exactly(c, k, both)
        rows = np.asarray(MODES[both](p, hold, reference)[0][1])[0]
        found[name] = _apart(rows, truth, largest * (1 + turns))
        if not both:
            found["Plant.transient"] = _apart(plant.transient(time, drive, frequency)[1:], truth, largest * (1 + turns))
    points = zip(plant.steady(c["drive"][k], c["frequency"][k]), settled_exactly(c, k), c["frequency"][k], strict=True)
    found["steady"] = max(_apart([value], [true], abs(true) * (1 + f / plant.f0)) for value, true, f in points)
    return found


def _apart(values: Any, truth: list[Any], unit: Any) -> float:
    return float(max(abs(mpmath.mpc(complex(v)) - t) for v, t in zip(values, truth, strict=True)) / unit / EPS) if unit else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--corners", type=int, default=1_000_000)
    parser.add_argument("--sample", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    infinite: dict[str, np.ndarray] = {}
    worst: dict[str, list[float]] = {}
    with jax.enable_x64(True):
        for chunk in range(0, given.corners, CHUNK):
            c = corners(CHUNK, given.seed + chunk)
            for name, flags in finite(c).items():
                infinite[name] = infinite.get(name, np.zeros(2, int)) + [int(np.sum(~f)) for f in flags]
        c = corners(given.sample, given.seed)
        for k in range(given.sample):
            for name, error in errors(c, k).items():
                worst.setdefault(name, []).append(error)
    lines = ["# Corners", "", f"Made by `python benchmarks/corners.py --corners {given.corners} --sample {given.sample} --seed {given.seed}`."]
    lines += ["", __doc__.partition("\n\n")[2].partition(" Writes")[0], ""]
    lines += ["| | corners | values not finite | derivatives not finite | in 60 digits | median error | 99 % | largest |", "|---|---|---|---|---|---|---|---|"]
    infinite["Plant.transient"] = infinite["transient"]
    for name, (values, slopes) in infinite.items():
        shown = " | ".join(f"{x:.2g}" for x in np.quantile(worst[name], [0.5, 0.99, 1.0]))
        lines.append(f"| {name} | {given.corners} | {values} | {slopes} | {given.sample} | {shown} |")
    text = "\n".join(lines) + "\n"
    (HERE / "corners.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
