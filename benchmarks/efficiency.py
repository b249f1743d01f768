"""Spread of the estimates over noise draws against the Cramer-Rao bound:  python benchmarks/efficiency.py --draws 300

A step of 20 ms at 10 kHz (200 rows) and a sweep of 101 points over +-500 Hz, noise of 1 % of the resonance amplitude in each of
Wd and Wq. The bound is computed here, by finite differences of a model in plain numpy with exactly the nuisances that the
fit has; a reference table stands beside it. Writes efficiency.md beside itself.

    --draws N      of each row (default 1000)       --noisy        noise of a tenth and a third instead: efficiency_noisy.md
    --jobs N       processes (default 1)
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from sysid import Log, fit
from sysid.precision import keep_programs

G, TAU, F0 = 1.0, 5e-3 / np.log(20), 32300.0
ROW = 1e-4  # s
TIME, FREQUENCY = ROW * np.arange(200), F0 + np.linspace(-500, 500, 101)
U = (FREQUENCY - F0) / 500
TRUTH = np.array([G, TAU, F0])
STEPS = np.array([1e-6, 1e-6 * TAU, 1e-3])  # of finite differences
Model = Callable[[np.ndarray], np.ndarray]


def step(p: np.ndarray) -> np.ndarray:
    """Slow mode from rest, driven at F0; the fast mode at its settled value once the drive acts."""
    w0, omega = 2 * np.pi * p[2], 2 * np.pi * F0
    wd = np.sqrt(w0**2 - p[1] ** -2)
    s1, s2, b = -1 / p[1] + 1j * (wd - omega), -1 / p[1] - 1j * (wd + omega), p[0] * w0 / (p[1] * wd)
    return b * np.where(TIME > 0, (np.exp(s1 * TIME) - 1) / s1 + 1 / s2, 0)


def first_order(p: np.ndarray) -> np.ndarray:
    return p[0] * -np.expm1(-TIME / p[1])


def sweep(p: np.ndarray) -> np.ndarray:
    w0, omega = 2 * np.pi * p[2], 2 * np.pi * FREQUENCY
    return p[0] * (w0 / omega) / (1 - 1j * (w0**2 - omega**2) * p[1] / (2 * omega))


def rising(turning: complex) -> np.ndarray:
    """Rate of change, per row, of a step's response: what "late" adds to it."""
    return ROW * G / TAU * np.where(TIME > 0, np.exp((turning - 1 / TAU) * TIME), 0)


@dataclass(frozen=True)
class Kind:
    """One log: its noiseless rows, the shapes that "background" adds to them, the log made of noisy rows, and what "late" adds."""

    model: Model
    amplitude: bool
    shapes: tuple[np.ndarray, ...]
    log: Callable[[np.ndarray], Log]
    late: np.ndarray | None = None


ON = (TIME > 0).astype(float)
ONE, ONES = np.ones(len(TIME)), np.ones(len(FREQUENCY))
KINDS = {
    "step W": Kind(
        first_order,
        True,
        (),
        lambda y: Log("step", y, time=TIME, drive=ONE, sampling="instant"),
        rising(0).real,
    ),
    "step dq": Kind(
        step,
        False,
        (ON,),
        lambda y: Log("step", y, time=TIME, drive=ONE, frequency=F0 * ONE, sampling="instant"),
        rising(1j * (np.sqrt((2 * np.pi * F0) ** 2 - TAU**-2) - 2 * np.pi * F0)),
    ),
    "sweep W": Kind(
        lambda p: np.abs(sweep(p)), True, (), lambda y: Log("sweep", y, drive=ONES, frequency=FREQUENCY)
    ),
    "sweep dq": Kind(sweep, False, (ONES, U), lambda y: Log("sweep", y, drive=ONES, frequency=FREQUENCY)),
}


@dataclass(frozen=True)
class Row:
    """A row of the table: logs, nuisances, the reference bounds on G and tau (%) and f0 (Hz), where it differs, and the noise."""

    kinds: tuple[str, ...]
    nuisances: tuple[str, ...]
    reference: tuple[float | None, float | None, float | None] = (None, None, None)
    differs: str = ""
    noise: float = 0.01


PHI, KAPPA, LATE = ("rotation",), ("rotation", "background"), ("late",)
SLOPE, OWN = "background with a slope", "a rotation (and background) for each log"
ROWS = (
    Row(
        ("step W",), (), (0.085, 0.55, None), "no frequency recorded; noise on the signed first-order output"
    ),
    Row(("step dq",), (), (0.085, 0.55, 0.077)),
    Row(("sweep W",), (), (0.33, 0.60, 0.50)),
    Row(("sweep dq",), (), (0.26, 0.39, 0.25)),
    Row(("step W", "sweep W"), (), (0.081, 0.33, 0.50)),
    Row(("step dq", "sweep dq"), (), (0.078, 0.28, 0.073)),
    Row(("step dq",), PHI, (0.085, 0.55, 0.53)),
    Row(("sweep dq",), PHI, (0.26, 0.39, 0.37)),
    Row(("step dq", "sweep dq"), PHI, (0.078, 0.28, 0.27), OWN),
    Row(("step dq",), KAPPA, (0.52, 0.80, 0.76)),
    Row(("sweep dq",), KAPPA, (0.26, 0.46, 0.44), SLOPE),
    Row(("step dq", "sweep dq"), KAPPA, (0.14, 0.31, 0.30), f"{SLOPE}; {OWN}"),
    Row(
        ("step W",),
        LATE,
        (0.087, 0.80, None),
        "no frequency recorded; noise on the signed first-order output",
    ),
    Row(
        ("step dq", "sweep dq"),
        (*KAPPA, *LATE),
        (0.14, 0.32, 0.30),
        f"{SLOPE}; {OWN}; a lateness that may be complex",
    ),
)
NOISY = tuple(  # no lateness: beside noise like this its prior of a row says more than the rows, and the bound knows no prior
    Row(kinds, nuisances, differs=f"signal to noise {ratio}", noise=1 / ratio)
    for ratio in (10, 3)
    for kinds, nuisances in (
        (("step W",), ()),
        (("step dq",), PHI),
        (("sweep dq",), KAPPA),
        (("step dq", "sweep dq"), KAPPA),
    )
)


CURVED = """The bound is that of a model that is linear within the errors, which at a signal to noise of 3 it is not: for G of a step that is
driven at f0 and turned by an unknown angle, |W| = G V / sqrt(1 + x^2), x = 2 pi (f - f0) tau, so that an error of f0 moves G by x^2/2. x is
known to 0.18, which adds 2.4 % of spread to the 2.85 % of the bound (3.7 % together), and 1.7 % of bias; both fall with its square. What no
estimate can do better is seen from scipy's `least_squares`, in `spread/scipy`: the same model in numpy, the same nuisances, white noise known to
be so, begun at the truth, the same draws.

"""
DIFFERING = """Where a step and a sweep differ in G, tau or f0 by more than they would by chance once in twenty, the stated error spans the difference
(`sysid/verdict/differing.py`), and by chance they do: that is how `stated` of two logs comes to lie above the bound. Its median does not
(coverage.md), and the estimate itself stays what it is.

"""


def real(y: np.ndarray) -> np.ndarray:
    return np.concatenate([y.real, y.imag]) if np.iscomplexobj(y) else y


def slopes(row: Row) -> np.ndarray:
    """Derivatives of all noiseless rows by (G, tau, f0), what the nuisances can imitate taken away."""
    parts = []
    for name in row.kinds:
        kind = KINDS[name]
        y = kind.model(TRUTH)
        sides = [(kind.model(TRUTH + d), kind.model(TRUTH - d)) for d in np.diag(STEPS)]
        J = np.array([real(a - b) / (2 * s) for (a, b), s in zip(sides, STEPS, strict=True)]).T
        others = [real(1j * y)] if "rotation" in row.nuisances and not kind.amplitude else []
        if "background" in row.nuisances:
            others += [real(c * shape.astype(complex)) for shape in kind.shapes for c in (1, 1j)]
        if (
            "late" in row.nuisances and kind.late is not None
        ):  # its prior, of one row, is wide beside what the rows say of it
            others += [kind.late] if kind.amplitude else [real(c * kind.late) for c in (1, 1j)]
        if others:
            A = np.array(others).T
            J = J - A @ np.linalg.lstsq(A, J, rcond=None)[0]
        parts.append(J)
    return np.concatenate(parts)


def efficient(row: Row) -> np.ndarray:
    """(3, rows) weights of the noise in the error of an efficient estimate; NaN for a parameter that no log depends on.

    The Cramer-Rao bound is the noise times the length of each.
    """
    J = slopes(row) * STEPS
    known = np.any(J != 0, axis=0)
    found = np.full(J.T.shape, np.nan)
    found[known] = np.linalg.pinv(J[:, known]) * STEPS[known, None]
    return found


def draw(row: Row, rng: np.random.Generator) -> tuple[list[Log], np.ndarray]:
    """One noisy record of each log, with a rotation where the fit is to find it; and the noise before that rotation."""
    logs, noises = [], []
    for name in row.kinds:
        kind = KINDS[name]
        y, turn = (sweep if name == "sweep W" else kind.model)(TRUTH), 1.0
        noise = row.noise * (rng.standard_normal(len(y)) + 1j * rng.standard_normal(len(y)))
        if name == "sweep W":  # the amplitude of noisy Wd and Wq
            noise = np.abs(y + noise) - np.abs(y)
            y = np.abs(y)
        elif kind.amplitude:
            noise = noise.real
        elif "rotation" in row.nuisances:
            turn = np.exp(2j * np.pi * rng.random())
        logs.append(kind.log((y + noise) * turn))
        noises.append(real(noise))
    return logs, np.concatenate(noises)


def by_scipy(row: Row, logs: list[Log]) -> np.ndarray:
    """(3,) G, tau and f0 of least squares from the truth: the likeliest where the noise is white, and known to be."""
    kinds = [KINDS[name] for name in row.kinds]
    background = [
        np.linalg.qr(np.array([real(c * s.astype(complex)) for s in k.shapes for c in (1, 1j)]).T)[0]
        if "background" in row.nuisances and k.shapes
        else np.zeros((len(real(log.response)), 0))
        for k, log in zip(kinds, logs, strict=True)
    ]
    turned = [
        float(np.angle(np.vdot(k.model(TRUTH), log.response))) for k, log in zip(kinds, logs, strict=True)
    ]

    def plant(q: np.ndarray) -> np.ndarray:
        return np.array([G * np.exp(q[0]), TAU * np.exp(q[1]), F0 + 100 * q[2]])

    def residual(q: np.ndarray) -> np.ndarray:
        parts = []
        for kind, log, basis, phi in zip(kinds, logs, background, q[3:], strict=True):
            off = real(log.response - kind.model(plant(q)) * (1.0 if kind.amplitude else np.exp(1j * phi)))
            parts.append(off - basis @ (basis.T @ off))
        return np.concatenate(parts)

    return plant(least_squares(residual, [0.0, 0.0, 0.0, *turned], method="lm").x)


def spread(
    row: Row, draws: int, peer: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, int], float]:
    """Estimates, stated standard deviations, errors of an efficient estimate on the same noise and, with `peer`, scipy's estimates
    (each (draws, 3)); how the fits ended; seconds per fit."""
    rng, weights = np.random.default_rng(0), efficient(row)
    values, stated, ideal, theirs = (np.full((draws, 3), np.nan) for _ in range(4))
    results: dict[str, int] = {}
    begun = time.perf_counter()
    for k in range(draws):
        logs, noise = draw(row, rng)
        ideal[k] = weights @ noise
        found = fit(logs, nuisances=row.nuisances)
        std = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
        for i, name in enumerate(("G", "tau", "f0")):
            if name in found.names:
                values[k, i], stated[k, i] = getattr(found.plant, name), std[name]
        results[found.result.name] = results.get(found.result.name, 0) + 1
        if peer:
            theirs[k] = by_scipy(row, logs)
    return values, stated, ideal, theirs, results, (time.perf_counter() - begun) / draws


def lines_of(row: Row, draws: int) -> list[str]:
    """The row's lines of the table, one for each parameter."""
    limit, noisy = row.noise * np.linalg.norm(efficient(row), axis=1), row in NOISY
    values, stated, ideal, theirs, results, seconds = spread(row, draws, peer=noisy)
    data, free = " + ".join(row.kinds), ", ".join(row.nuisances) or "none"
    lines = []
    for i, (name, scale, unit) in enumerate(
        (("G", 100 / G, "%"), ("tau", 100 / TAU, "%"), ("f0", 1.0, "Hz"))
    ):
        if np.isnan(limit[i]):
            continue
        std = values[:, i].std(ddof=1)
        bias = (values[:, i].mean() - TRUTH[i]) / (std / np.sqrt(draws))
        table = "" if row.reference[i] is None else f"{row.reference[i]:.3g}"
        level = np.sqrt(np.mean(stated[:, i] ** 2))
        cells = [
            data,
            free,
            f"{name}, {unit}",
            table,
            f"{limit[i] * scale:.3g}",
            f"{std * scale:.3g}",
            f"{std / limit[i]:.3f}",
        ]
        cells += [f"**{std / ideal[:, i].std(ddof=1):.3f}**"] + noisy * [
            f"**{std / theirs[:, i].std(ddof=1):.3f}**"
        ]
        cells += [f"{level / limit[i]:.3f}", f"{bias:+.1f}", row.differs]
        lines.append("| " + " | ".join(cells) + " |")
    print(*lines, f"    {results}, {seconds:.2f} s a fit", sep="\n", flush=True)
    odd = {name: n for name, n in results.items() if name != "successful"}
    return lines + ([f"| | | {odd} of {draws} | | | | | | | | |{noisy * ' |'}"] if odd else [])


def _begin(folder: str) -> None:
    keep_programs(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--noisy", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    draws, rows = given.draws, NOISY if given.noisy else ROWS
    command = f"python benchmarks/efficiency.py --draws {draws}{' --noisy' if given.noisy else ''}"
    head = (
        f"# Spread against the Cramer-Rao bound\n\nMade by `{command}`.\n\n"
        f"A step of 20 ms at 10 kHz, driven at f0, and a sweep of 101 points over +-500 Hz; noise {_said(rows)} of the resonance amplitude per\n"
        f"channel. {draws} draws for each row, fitted from nothing: the spread of the estimates is known to {100 / np.sqrt(2 * draws):.1f} %.\n"
        "`bound` is for exactly the nuisances that the fit has; `reference` is a table computed elsewhere. `stated` is the fit's own standard\n"
        "deviation (root mean square), `bias` the mean error in units of its own error. `spread/efficient` compares with an estimate\n"
        "that attains the bound, made from the same noise, so that the chance of the draws cancels: it is what to look at.\n\n"
        f"{given.noisy * CURVED}{DIFFERING}"
        "| data | nuisances | parameter | reference | bound | spread | spread/bound | spread/efficient |"
        f"{given.noisy * ' spread/scipy |'} stated/bound | bias | differs |\n|{'---|' * (11 + given.noisy)}\n"
    )
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process takes one core
    with tempfile.TemporaryDirectory() as folder:
        pool = {"processes": given.jobs, "initializer": _begin, "initargs": (folder,)}
        with get_context("spawn").Pool(**pool) as workers:
            lines = [line for of in workers.imap(partial(lines_of, draws=draws), rows) for line in of]
    name = "efficiency_noisy.md" if given.noisy else "efficiency.md"
    (Path(__file__).parent / name).write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


def _said(rows: tuple[Row, ...]) -> str:
    return " and ".join(f"{100 * noise:.3g} %" for noise in dict.fromkeys(row.noise for row in rows))


if __name__ == "__main__":
    main()
