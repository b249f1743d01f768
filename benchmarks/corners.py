"""The plant at the corners of its numbers: finite everywhere, and right to rounding.  python benchmarks/corners.py

Each corner draws a plant and inputs: Q from 0.6 to 1e8, f0 from 1 mHz to 10 GHz, rows from 1e-9 to 1e9 tau apart (every tenth not
at all), drives beside the resonance by nothing, or by 1e-6 to 1e6 half bandwidths as far as frequencies stay above zero, and
amplitudes from 1e-15 to 1e15. Counted are rows, and derivatives of each row with respect to G, tau and f0, of the functions behind
`Plant.transient` (with both modes and without the fast one's ripple) and `Plant.steady` that are not finite. All stand beside the
same equations in extended numbers (64 bits), and those, for a sample, beside 60 digits (mpmath); the error, over the largest size
of a mode in the log, also between its rows, is given in units of

    eps (1 + |a| T)            of a transient, a its pole, T its length, eps = 2.2e-16
    eps (1 + omega/omega0)     of a settled point, over its own size

which is what the rounding of a, T and the detuning themselves makes. So do the derivatives, by the differentiated equations, in
the same units over the largest term of the sums that they are. Writes corners.md beside itself. Needs a processor whose long
double is longer than a double.

    --corners N   how many (default 1000000)    --sample N   of them in 60 digits (default 300)    --seed N (default 0)
"""

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
from rich.console import Console
from rich.progress import track

from sysid import Plant
from sysid.model.plant import respond, steady
from sysid.rows.hold import Hold

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
    return {
        "G": decades(-15, 15, n),
        "tau": tau,
        "f0": f0,
        "frequency": frequency,
        "time": time,
        "duration": duration,
        "drive": drive,
    }


def held(c: dict[str, np.ndarray]) -> Hold:
    """The inputs as the plant takes them, a row at each interval's end."""
    n = len(c["tau"])
    zeros = np.zeros((n, INTERVALS))
    own = np.broadcast_to(np.arange(INTERVALS, dtype=np.int32), (n, INTERVALS))
    inputs = c["duration"], c["drive"], 2 * np.pi * c["frequency"], -c["frequency"]
    return Hold(
        *inputs, zeros, zeros, np.ones_like(zeros), own, c["duration"], zeros, zeros + 0j, zeros, np.zeros(n)
    )


def moving(p: Any, hold: Hold, both_modes: bool) -> Any:
    """Rows of a transient, by p = (G, tau, f0)."""
    return (
        p[0]
        * respond(p[1], 2 * jnp.pi * (p[2] + hold.offset), hold, both_modes, omega0=2 * jnp.pi * p[2]).forced
    )


def settled(p: Any, drive: Any, frequency: Any) -> Any:
    """Settled points, by p = (G, tau, f0)."""
    return p[0] * drive * steady(p[1], 2 * jnp.pi * (p[2] - frequency), 2 * jnp.pi * frequency)


def _with_derivatives(rows: Callable) -> Callable:
    return jax.jit(jax.vmap(lambda p, *inputs: (rows(p, *inputs), jax.jacfwd(rows)(p, *inputs))))


TRANSIENTS = {"transient": False, "transient, both modes": True}
MODES = {both: _with_derivatives(partial(moving, both_modes=both)) for both in TRANSIENTS.values()}
SETTLED = _with_derivatives(settled)


def computed(c: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rows (n, INTERVALS) of each function, and their derivatives (n, INTERVALS, 3) by G, tau and f0, in float64."""
    hold, p = held(c), np.stack([c["G"], c["tau"], c["f0"]], axis=1)
    found = {name: MODES[both](p, hold) for name, both in TRANSIENTS.items()}
    found["steady"] = SETTLED(p, c["drive"], c["frequency"])
    return {name: (np.asarray(rows), np.asarray(slopes)) for name, (rows, slopes) in found.items()}


# --- the same in more digits ------------------------------------------------------------------------------------------------


class Numbers(NamedTuple):
    """Arithmetic in more digits than float64 has: what makes arrays of such numbers, and functions of these."""

    of: Callable[[Any], Any]
    exp: Callable[[Any], Any]
    expm1: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    pi: Any
    i: Any


def _each(function: Callable) -> Callable[[Any], Any]:
    return np.frompyfunc(function, 1, 1)


def _mpf(x: Any) -> Any:
    """A number of mpmath, of a float or an extended one."""
    high = float(x)
    return mpmath.mpf(high) + mpmath.mpf(float(x - high))


PI = "3.14159265358979323846264338327950288419716939937510582097494459"
EXTENDED = Numbers(
    lambda x: np.asarray(x, np.longdouble), np.exp, np.expm1, np.sqrt, np.longdouble(PI), np.clongdouble(1j)
)
with mpmath.workdps(60):
    SIXTY = Numbers(
        _each(_mpf),
        _each(mpmath.exp),
        _each(mpmath.expm1),
        _each(mpmath.sqrt),
        mpmath.mpf(PI),
        mpmath.mpc(0, 1),
    )


def largest(*sizes: Any) -> Any:
    return reduce(np.maximum, sizes)


@dataclass
class Mode:
    """z' = s z + push over held intervals from rest, of corners (n,); derivatives with respect to tau and f0, the largest of
    their terms, and about the largest size that z has had, also within an interval, at whose end it may have come full circle.
    """

    z: Any
    slopes: tuple
    terms: tuple
    reached: Any

    def after(self, s: Any, ds: tuple, push: Any, dpush: tuple, terms: tuple, T: Any, by: Numbers) -> "Mode":
        """`ds`, `dpush`: derivatives; `terms`: the largest term of each of the latter. T None: settled."""
        grown, kept = (-1 + 0 * s, 0 * s) if T is None else (by.expm1(s * T), by.exp(s * T))
        stretch, q = (kept if T is None else kept * T), push / s
        dq = [dp / s - q * d / s for d, dp in zip(ds, dpush, strict=True)]
        slopes = [
            x * kept + stretch * d * (self.z + q) + grown * e
            for x, d, e in zip(self.slopes, ds, dq, strict=True)
        ]
        swing = (
            abs(grown) if T is None else np.minimum(abs(s) * T, 2 + 0 * T)
        )  # what it has grown by at most meanwhile
        sizes = [
            largest(
                x * abs(kept),
                abs(stretch * d) * largest(self.reached, abs(q)),
                swing / abs(s) * largest(term, abs(q * d)),
            )
            for x, d, term in zip(self.terms, ds, terms, strict=True)
        ]
        reached = largest(self.reached, swing * abs(self.z + q))
        return Mode(self.z + grown * (self.z + q), tuple(slopes), tuple(sizes), reached)


def exactly(c: dict[str, np.ndarray], both_modes: bool, by: Numbers) -> tuple[list[Mode], list[Mode], Any]:
    """The modes at each interval's end, slow and fast; and |a| T."""
    G, tau, f0 = (by.of(c[name]) for name in ("G", "tau", "f0"))
    w0 = 2 * by.pi * f0
    wd = by.sqrt(w0**2 - 1 / tau**2)
    pull = 1 / tau**2 / (wd + w0)  # w0 - wd
    dwd = (1 / (tau**3 * wd), 2 * by.pi * w0 / wd)  # by tau and f0
    zero, turns = 0 * tau, 0 * tau
    slow, fast = ([Mode(by.i * zero, (by.i * zero,) * 2, (zero,) * 2, zero)] for _ in range(2))
    for f, T, V in zip(*(by.of(c[name]).T for name in ("frequency", "duration", "drive")), strict=True):
        push = G * w0 / (tau * wd) * V
        dpush = (-push * (1 / tau + dwd[0] / wd), push * (1 / f0 - dwd[1] / wd))
        terms = (abs(push) * largest(1 / tau, dwd[0] / wd), abs(push) * largest(1 / f0, dwd[1] / wd))
        s1, s2 = -1 / tau + by.i * (2 * by.pi * (f0 - f) - pull), -1 / tau - by.i * (wd + 2 * by.pi * f)
        ds1, ds2 = ((1 / tau**2 + sign * by.i * dwd[0], sign * by.i * dwd[1]) for sign in (1, -1))
        slow.append(slow[-1].after(s1, ds1, push, dpush, terms, T, by))
        fast.append(
            fast[-1].after(s2, ds2, -push, tuple(-d for d in dpush), terms, T if both_modes else None, by)
        )
        turns = turns + abs(s2 if both_modes else s1) * T
    return slow[1:], fast[1:], turns


def settled_exactly(c: dict[str, np.ndarray], by: Numbers) -> tuple[list[Any], list[tuple], list[tuple]]:
    """The points; their derivatives by G, tau and f0; and the largest terms of these."""
    G, tau, f0 = (by.of(c[name]) for name in ("G", "tau", "f0"))
    one, rows, slopes, terms = 1 + 0 * tau, [], [], []
    for f, V in zip(*(by.of(c[name]).T for name in ("frequency", "drive")), strict=True):
        w, w0, push = 2 * by.pi * f, 2 * by.pi * f0, G * V
        off = 2 * by.pi * (f0 - f) * (w0 + w) / (2 * w)
        x, dx = off * tau, (off, 2 * by.pi * w0 * tau / w)
        z = push * (w0 / w) / (1 - by.i * x)
        rows.append(z)
        slopes.append((z / G, z * by.i * dx[0] / (1 - by.i * x), z / f0 + z * by.i * dx[1] / (1 - by.i * x)))
        turned = (
            abs(push) * (w0 / w) / (1 + x**2) * largest(one, 2 * abs(x) * largest(one, abs(x)) / (1 + x**2))
        )
        moved = abs(push) / (1 + x**2) * largest(one, abs(x)) * 2 * by.pi / w
        terms.append(
            (abs(z / G), turned * abs(dx[0]), largest(moved, turned * 2 * by.pi * tau * largest(one, w0 / w)))
        )
    return rows, slopes, terms


def truths(c: dict[str, np.ndarray], by: Numbers) -> dict[str, list[tuple[Any, Any]]]:
    """Of each function the rows, and the derivatives of each row, each with the unit of its error over eps."""
    found = {}
    for name, both in TRANSIENTS.items():
        slow, fast, turns = exactly(c, both, by)
        size = largest(*(mode.reached for mode in (*slow, *fast)))
        terms = [size / by.of(c["G"]), *(largest(*(m.terms[i] for m in (*slow, *fast))) for i in (0, 1))]
        rows = [a.z + b.z for a, b in zip(slow, fast, strict=True)]
        slopes = [
            (row / by.of(c["G"]), *(a.slopes[i] + b.slopes[i] for i in (0, 1)))
            for row, a, b in zip(rows, slow, fast, strict=True)
        ]
        found[name] = [(row, size * (1 + turns)) for row in rows]
        found[f"{name}, derivatives"] = [
            (v, term * (1 + turns)) for of in slopes for v, term in zip(of, terms, strict=True)
        ]
    rows, slopes, each = settled_exactly(c, by)
    near = [1 + f / by.of(c["f0"]) for f in by.of(c["frequency"]).T]
    found["steady"] = [(row, abs(row) * n) for row, n in zip(rows, near, strict=True)]
    found["steady, derivatives"] = [
        (v, term * n)
        for of, terms, n in zip(slopes, each, near, strict=True)
        for v, term in zip(of, terms, strict=True)
    ]
    return found


def errors(c: dict[str, np.ndarray], by: Numbers = EXTENDED) -> dict[str, np.ndarray]:
    """(n,) of each function, the largest of its rows' or derivatives' errors, in units of eps (1 + |a| T)."""
    exact, found = truths(c, by), {}
    for name, (rows, slopes) in computed(c).items():
        found[name] = furthest(rows, exact[name], by)
        found[f"{name}, derivatives"] = furthest(
            slopes.reshape(len(slopes), -1), exact[f"{name}, derivatives"], by
        )
    return found


def transients(c: dict[str, np.ndarray]) -> np.ndarray:
    """(n, INTERVALS) rows of `Plant.transient`."""
    found = []
    for k in range(len(c["tau"])):
        plant, time = (
            Plant(float(c["G"][k]), float(c["tau"][k]), float(c["f0"][k])),
            np.append(0.0, c["time"][k]),
        )
        drive, frequency = np.append(c["drive"][k], 0.0), np.append(c["frequency"][k], c["frequency"][k][-1])
        found.append(plant.transient(time, drive, frequency)[1:])
    return np.array(found)


def furthest(values: np.ndarray, truth: list[tuple[Any, Any]], by: Numbers) -> np.ndarray:
    """(n,) the largest error of values (n, m), in units of eps."""
    apart = []
    for value, (exact, unit) in zip(values.T, truth, strict=True):
        away = abs(by.of(value.real) + by.i * by.of(value.imag) - exact)
        apart.append(np.where(unit > 0, away / np.where(unit > 0, unit, 1), 0).astype(float) / EPS)
    return np.max(apart, axis=0)


def between(c: dict[str, np.ndarray]) -> float:
    """The largest distance of the extended numbers from 60 digits, in the same units."""
    with mpmath.workdps(60):
        exact, near = truths(c, SIXTY), truths(c, EXTENDED)
        found = []
        for name in exact:
            for (a, unit), (b, _) in zip(exact[name], near[name], strict=True):
                away = abs(SIXTY.of(b.real) + SIXTY.i * SIXTY.of(b.imag) - a)
                found.append(
                    np.max(np.where(unit > 0, away / np.where(unit > 0, unit, 1), 0).astype(float)) / EPS
                )
        return float(np.max(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--corners", type=int, default=1_000_000)
    parser.add_argument("--sample", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    infinite: Counter[str] = Counter()
    found: dict[str, list[np.ndarray]] = {}
    with jax.enable_x64(True):
        for chunk in track(range(0, given.corners, CHUNK), console=Console(stderr=True)):
            c = corners(min(CHUNK, given.corners - chunk), given.seed + chunk)
            for name, (rows, slopes) in computed(c).items():
                infinite[name] += int(np.sum(~np.isfinite(rows).all(axis=1)))
                infinite[f"{name}, derivatives"] += int(np.sum(~np.isfinite(slopes).all(axis=(1, 2))))
            for name, of in errors(c).items():
                found.setdefault(name, []).append(of)
        c = corners(given.sample, given.seed)
        public = np.max(furthest(transients(c), truths(c, EXTENDED)["transient"], EXTENDED))
    lines = [
        "# Corners",
        "",
        f"Made by `python benchmarks/corners.py --corners {given.corners} --sample {given.sample} --seed {given.seed}`.",
    ]
    lines += ["", __doc__.partition("\n\n")[2].partition(" Writes")[0], ""]
    lines += [
        "| | corners | not finite | median error | 99 % | 99.99 % | largest | beyond 16 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, of in found.items():
        error = np.concatenate(of)
        shown = " | ".join(f"{x:.2g}" for x in np.quantile(error, [0.5, 0.99, 0.9999, 1.0]))
        lines.append(f"| {name} | {len(error)} | {infinite[name]} | {shown} | {np.sum(error > 16)} |")
    lines += [
        "",
        f"Of {given.sample} corners the extended numbers are within {between(c):.2g} of 60 digits, in the same units;",
    ]
    lines += [
        f"`Plant.transient`, which calls the first function and holds the inputs itself, is within {public:.2g}."
    ]
    text = "\n".join(lines) + "\n"
    (HERE / "corners.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
