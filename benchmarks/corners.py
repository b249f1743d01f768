"""The plant at the corners of its numbers: finite everywhere, and right to rounding.  python benchmarks/corners.py

Each corner draws a plant and inputs: Q from 0.6 to 1e8, f0 from 1 mHz to 10 GHz, rows from 1e-9 to 1e9 tau apart (every tenth not
at all), drives beside the resonance by nothing, or by 1e-6 to 1e6 half bandwidths as far as frequencies stay above zero, and
amplitudes from 1e-15 to 1e15. Counted are values, and derivatives with respect to G, tau and f0, of `Plant.transient` (with both
modes and without the fast one's ripple) and `Plant.steady` that are not finite. For a sample, the values stand beside the same
equations in 60 digits (mpmath); the error, over the largest size of a mode in the log, is given in units of

    eps (1 + |a| T)            of a transient, a its pole, T its length, eps = 2.2e-16
    eps (1 + omega/omega0)     of a settled point, over its own size

which is what the rounding of a, T and the detuning themselves makes. So do the derivatives, by the differentiated equations in
60 digits, in the same units over the largest term of the sums that they are. Writes corners.md beside itself.

    --corners N   how many (default 1000000)    --sample N   of them in 60 digits (default 1000)    --seed N (default 0)
"""

import argparse
from dataclasses import dataclass
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
PART = 0.5  # of the imaginary parts in the sum whose derivatives are taken


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


def held(c: dict[str, np.ndarray]) -> Hold:
    """The inputs as the plant takes them, a row at each interval's end."""
    n = len(c["tau"])
    zeros = np.zeros((n, INTERVALS))
    own = np.broadcast_to(np.arange(INTERVALS, dtype=np.int32), (n, INTERVALS))
    inputs = c["duration"], c["drive"], 2 * np.pi * c["frequency"], -c["frequency"]
    return Hold(*inputs, zeros, zeros, own, c["duration"], zeros, zeros + 0j, np.zeros(n))


def size(p: Any, hold: Hold, both_modes: bool) -> Any:
    """A real number of the rows that G, tau and f0 all move, and the rows."""
    rows = p[0] * respond(p[1], 2 * jnp.pi * (p[2] + hold.offset), hold, both_modes).forced
    return jnp.sum(rows.real + PART * rows.imag), rows


def size_settled(p: Any, drive: Any, frequency: Any) -> Any:
    """The same of settled points."""
    rows = p[0] * drive * steady(p[1], 2 * jnp.pi * (p[2] - frequency), 2 * jnp.pi * frequency)
    return jnp.sum(rows.real + PART * rows.imag), rows


def finite(c: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Whether each corner's values, and its derivatives, are finite; of each function."""
    hold = held(c)
    p = np.stack([c["G"], c["tau"], c["f0"]], axis=1)
    found = {}
    for name, (values, slopes) in {
        "transient": MODES[False](p, hold),
        "transient, both modes": MODES[True](p, hold),
        "steady": SETTLED(p, c["drive"], c["frequency"]),
    }.items():
        found[name] = np.isfinite(values[1]).all(1), np.isfinite(slopes).all(1)
    return found


MODES = {both: jax.jit(jax.vmap(jax.value_and_grad(lambda p, h, both=both: size(p, h, both), has_aux=True))) for both in (False, True)}
SETTLED = jax.jit(jax.vmap(jax.value_and_grad(size_settled, has_aux=True)))


# --- the same in 60 digits --------------------------------------------------------------------------------------------------


@dataclass
class Mode:
    """z' = s z + push over held intervals from rest; derivatives with respect to tau and f0, and the largest of their terms."""

    z: Any = 0
    slopes: tuple = (0, 0)
    largest: tuple = (0, 0)

    def after(self, s: Any, ds: tuple, push: Any, dpush: tuple, terms: tuple, T: Any) -> "Mode":
        """`ds`, `dpush`: derivatives; `terms`: the largest term of each of the latter. An infinite T: settled."""
        grown = mpmath.expm1(s * T) if not mpmath.isinf(T) else mpmath.mpf(-1)
        kept, q = 1 + grown, push / s
        stretch = kept * T if not mpmath.isinf(T) else mpmath.mpf(0)
        dq = [dp / s - q * d / s for d, dp in zip(ds, dpush, strict=True)]
        slopes = [x * kept + stretch * d * (self.z + q) + grown * e for x, d, e in zip(self.slopes, ds, dq, strict=True)]
        sizes = [
            max(x * abs(kept), abs(stretch * d) * max(abs(self.z), abs(q)), abs(grown / s) * max(term, abs(q * d)))
            for x, d, term in zip(self.largest, ds, terms, strict=True)
        ]
        return Mode(self.z + grown * (self.z + q), tuple(slopes), tuple(sizes))


def exactly(c: dict[str, np.ndarray], k: int, both_modes: bool) -> tuple[list[Mode], list[Mode], Any]:
    """The modes of corner `k` at each interval's end, slow and fast; and |a| T."""
    mp = mpmath.mp
    G, tau, f0 = (mp.mpf(float(c[name][k])) for name in ("G", "tau", "f0"))
    w0 = 2 * mp.pi * f0
    wd = mp.sqrt(w0**2 - tau**-2)
    dwd = (tau**-3 / wd, 2 * mp.pi * w0 / wd)  # by tau and f0
    slow, fast, turns = [Mode()], [Mode()], mp.mpf(0)
    for f, T, V in zip(c["frequency"][k], c["duration"][k], c["drive"][k], strict=True):
        omega, T, push = 2 * mp.pi * mp.mpf(float(f)), mp.mpf(float(T)), G * w0 / (tau * wd) * mp.mpf(float(V))
        dpush = (-push * (1 / tau + dwd[0] / wd), push * (1 / f0 - dwd[1] / wd))
        terms = (abs(push) * max(1 / tau, dwd[0] / wd), abs(push) * max(1 / f0, dwd[1] / wd))
        s1, s2 = mp.mpc(-1 / tau, wd - omega), mp.mpc(-1 / tau, -(wd + omega))
        ds1, ds2 = ((mp.mpc(tau**-2, sign * dwd[0]), mp.mpc(0, sign * dwd[1])) for sign in (1, -1))
        slow.append(slow[-1].after(s1, ds1, push, dpush, terms, T))
        fast.append(fast[-1].after(s2, ds2, -push, tuple(-d for d in dpush), terms, T if both_modes else mp.inf))
        turns += abs(s2 if both_modes else s1) * T
    return slow[1:], fast[1:], turns


def settled_exactly(c: dict[str, np.ndarray], k: int) -> tuple[list[Any], list[tuple], list[tuple]]:
    """Points of corner `k`; their derivatives by G, tau and f0; and the largest terms of these."""
    mp = mpmath.mp
    G, tau, f0 = (mp.mpf(float(c[name][k])) for name in ("G", "tau", "f0"))
    rows, slopes, largest = [], [], []
    for f, V in zip(c["frequency"][k], c["drive"][k], strict=True):
        w, w0, push = 2 * mp.pi * mp.mpf(float(f)), 2 * mp.pi * f0, G * mp.mpf(float(V))
        x, dx = (w0**2 - w**2) * tau / (2 * w), ((w0**2 - w**2) / (2 * w), 2 * mp.pi * w0 * tau / w)
        z = push * (w0 / w) / (1 - 1j * x)
        rows.append(z)
        slopes.append((z / G, z * 1j * dx[0] / (1 - 1j * x), z / f0 + z * 1j * dx[1] / (1 - 1j * x)))
        turned = abs(push) * (w0 / w) / (1 + x**2) * max(1, 2 * abs(x) * max(1, abs(x)) / (1 + x**2))
        moved = abs(push) / (1 + x**2) * max(1, abs(x)) * 2 * mp.pi / w
        largest.append((abs(z / G), turned * abs(dx[0]), max(moved, turned * 2 * mp.pi * tau * max(1, w0 / w))))
    return rows, slopes, largest


def part(z: Any) -> Any:
    """What `size` sums."""
    return z.real + mpmath.mpf(PART) * z.imag


def plants(c: dict[str, np.ndarray], k: int) -> tuple[Plant, np.ndarray, np.ndarray, np.ndarray]:
    """Corner `k` as `Plant.transient` takes it: the plant, and times, drives and frequencies of the rows."""
    time = np.append(0.0, c["time"][k])
    last = np.append(c["drive"][k], 0.0), np.append(c["frequency"][k], c["frequency"][k][-1])
    return Plant(float(c["G"][k]), float(c["tau"][k]), float(c["f0"][k])), time, *last


def errors(c: dict[str, np.ndarray], k: int) -> dict[str, float]:
    """Of corner `k`, in units of eps (1 + |a| T)."""
    mpmath.mp.dps = 60
    hold = jax.tree.map(lambda x: x[k : k + 1], held(c))
    p = np.stack([c["G"], c["tau"], c["f0"]], axis=1)[k : k + 1]
    found = {}
    plant, time, drive, frequency = plants(c, k)
    for name, both in (("transient", False), ("transient, both modes", True)):
        slow, fast, turns = exactly(c, k, both)
        truth = [a.z + b.z for a, b in zip(slow, fast, strict=True)]
        largest = max(abs(mode.z) for mode in (*slow, *fast))
        (_, rows), slopes = MODES[both](p, hold)
        found[name] = _apart(np.asarray(rows)[0], truth, largest * (1 + turns))
        if not both:
            found["Plant.transient"] = _apart(plant.transient(time, drive, frequency)[1:], truth, largest * (1 + turns))
        exact = [sum(map(part, truth)) / plant.G]
        exact += [sum(part(a.slopes[i] + b.slopes[i]) for a, b in zip(slow, fast, strict=True)) for i in (0, 1)]
        terms = [largest / plant.G, *(max(mode.largest[i] for mode in (*slow, *fast)) for i in (0, 1))]
        found[f"{name}, derivatives"] = _furthest(slopes, exact, terms, 1 + turns)
    truth, exact, terms = settled_exactly(c, k)
    near = [1 + f / plant.f0 for f in c["frequency"][k]]
    values = plant.steady(c["drive"][k], c["frequency"][k])
    found["steady"] = max(_apart([v], [t], abs(t) * n) for v, t, n in zip(values, truth, near, strict=True))
    largest = [max(term[i] * n for term, n in zip(terms, near, strict=True)) for i in range(3)]
    summed = [sum(part(e[i]) for e in exact) for i in range(3)]
    found["steady, derivatives"] = _furthest(SETTLED(p, c["drive"][k : k + 1], c["frequency"][k : k + 1])[1], summed, largest, 1)
    return found


def _furthest(slopes: Any, truth: list[Any], terms: list[Any], grown: Any) -> float:
    """The largest error of derivatives by G, tau and f0, each over its own largest term."""
    return max(_apart([s], [t], u * grown) for s, t, u in zip(np.asarray(slopes)[0], truth, terms, strict=True))


def _apart(values: Any, truth: list[Any], unit: Any) -> float:
    return float(max(abs(mpmath.mpc(complex(v)) - t) for v, t in zip(values, truth, strict=True)) / unit / EPS) if unit else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--corners", type=int, default=1_000_000)
    parser.add_argument("--sample", type=int, default=1000)
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
    lines += ["| | corners | not finite | in 60 digits | median error | 99 % | largest |", "|---|---|---|---|---|---|---|"]
    for name, errors_of in worst.items():
        shown = " | ".join(f"{x:.2g}" for x in np.quantile(errors_of, [0.5, 0.99, 1.0]))
        base = name.removesuffix(", derivatives")
        flags = infinite["transient" if base == "Plant.transient" else base][int(name != base)]
        lines.append(f"| {name} | {given.corners} | {flags} | {given.sample} | {shown} |")
    text = "\n".join(lines) + "\n"
    (HERE / "corners.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
