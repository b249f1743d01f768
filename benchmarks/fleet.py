"""Lots of plates: how fast `sysid.fit_fleet` is beside a loop of pandas and scipy, and which odd plates it
finds.

OPENBLAS_NUM_THREADS=1 python benchmarks/fleet.py [--only NAME] [--plates N] [--jobs 2]: writes benchmarks/fleet.md, of
which one section is made anew, or all of them; what stands below the line "Notes" of a section stays. `engines` is
the table of `fleet_engines.py`, of so many plates and of a tenth of them; from `speed` on they are those of
`fleet_lane.py`.
"""

import argparse
import os
import re
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from datetime import date
from multiprocessing import get_context
from pathlib import Path

import fleet_engines
import fleet_lane
import numpy as np
import pandas as pd
from peers import F0, FAR, TAU, G, settled
from scipy.optimize import least_squares

import sysid
from sysid.fleet.odd import with_odd

ROWS, POINTS, DRIVE, AT, NOISE = 240, np.linspace(31800, 32800, 101), 100.0, 32290.0, 0.02
NAMES = ("G", "tau", "f0")
NOTES = "\nNotes\n"  # below which a section is what somebody wrote
KINDS = (
    "G and tau at 0.6",
    "f0 3 sd off",
    "softens by 0.2 half bandwidths",
    "softens by 0.05 half bandwidths",
)


def numbers(seed: int, kind: str = "") -> tuple[float, float, float, float]:
    """G, tau, f0 and by how many Hz f0 falls at 2 um, of a plate of the lot or of an odd one."""
    a, b, c = np.random.default_rng([7, seed]).standard_normal(3)
    g, tau, f0, soft = G * np.exp(0.1 * a), TAU * np.exp(0.1 * b), F0 + 20 * c, 0.0
    if kind == KINDS[0]:
        g, tau = 0.6 * g, 0.6 * tau
    elif kind == KINDS[1]:
        f0 = F0 + 60 * np.sign(c)
    elif kind:
        soft = float(kind.split()[2]) / (2 * np.pi * tau)
    return g, tau, f0, soft


def step(seed: int, kind: str = "") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, drive and response of a step; dW/dt = (-1/tau + j 2 pi (f0 - soft |W/2|^2 - f)) W + G/tau V in
    fine steps."""
    g, tau, f0, soft = numbers(seed, kind)
    time_, drive = 1e-4 * np.arange(ROWS), np.repeat([0.0, DRIVE], [20, ROWS - 20])
    response, w, fine = np.zeros(ROWS, complex), 0j, 40 if soft else 1
    for k in range(ROWS - 1):
        for _ in range(fine):
            pole = -1 / tau + 2j * np.pi * (f0 - soft * abs(w / 2) ** 2 - AT)
            grown = np.exp(pole * 1e-4 / fine)
            w = w * grown + g / tau * drive[k] * (grown - 1) / pole
        response[k + 1] = w
    rng = np.random.default_rng([1, seed])
    bench = np.exp(0.3j) * response + 0.004 - 0.003j
    return time_, drive, bench + NOISE * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))


def sweep(seed: int, kind: str = "") -> np.ndarray:
    """Response at settled points, upwards, where f0 falls with the squared amplitude."""
    g, tau, f0, soft = numbers(seed, kind)
    response, w = np.zeros(len(POINTS), complex), 0j
    for k, f in enumerate(POINTS):
        for _ in range(200 if soft else 1):
            w = (
                0.5 * w + 0.5 * DRIVE * settled(g, tau, f0 - soft * abs(w / 2) ** 2, f)
                if soft
                else DRIVE * settled(g, tau, f0, f)
            )
        response[k] = w
    rng = np.random.default_rng([2, seed])
    return np.exp(0.1j) * response + NOISE * (
        rng.standard_normal(len(POINTS)) + 1j * rng.standard_normal(len(POINTS))
    )


def written(folder: Path, count: int, odd: dict[int, str]) -> None:
    """The logs of a lot as files."""
    for seed in range(count):
        t, v, y = step(seed, odd.get(seed, ""))
        head = f"# plate: P{seed:05d}\n# temperature_degC: 24.0\n"
        rows = np.column_stack([t, v, np.full(ROWS, AT), y.real, y.imag])
        names = "time_s,voltage_V,frequency_Hz,wd_um,wq_um"
        _save(folder / f"P{seed:05d}_step.csv", f"{head}# sampling: instant\n{names}\n", rows)
        z = sweep(seed, odd.get(seed, ""))
        rows = np.column_stack([POINTS, z.real, z.imag])
        _save(
            folder / f"P{seed:05d}_sweep.csv", f"{head}# voltage_V: {DRIVE}\nfrequency_Hz,wd_um,wq_um\n", rows
        )


def _save(path: Path, head: str, rows: np.ndarray) -> None:
    path.write_text(head + "".join(",".join(f"{x:.7g}" for x in row) + "\n" for row in rows))


def by_scipy(folder: Path, seed: int) -> np.ndarray:
    """A plate's numbers from both files as a user of pandas and scipy has them, from a start 20 % off."""
    a, b = (pd.read_csv(folder / f"P{seed:05d}_{which}.csv", comment="#") for which in ("step", "sweep"))
    t, y = np.maximum(a["time_s"].to_numpy() - a["time_s"][20], 0), (a["wd_um"] + 1j * a["wq_um"]).to_numpy()
    f, z = b["frequency_Hz"].to_numpy(), (b["wd_um"] + 1j * b["wq_um"]).to_numpy()

    def left(p: np.ndarray) -> np.ndarray:
        pole = -1 / p[1] + 2j * np.pi * (p[2] - AT)
        model = np.exp(1j * p[3]) * p[0] / p[1] * DRIVE * np.expm1(pole * t) / pole + p[4] + 1j * p[5]
        other = np.exp(1j * p[6]) * DRIVE * settled(p[0], p[1], p[2], f) + p[7] + 1j * p[8]
        return np.concatenate([y - model, z - other]).view(float)

    start = np.array([*FAR * [G, TAU], F0 + 20, 0, 0, 0, 0, 0, 0])
    found = least_squares(left, start, x_scale=[G, TAU, 50, 0.3, 0.1, 0.1, 0.3, 0.1, 0.1])
    return found.x


def throughput(counts: Sequence[int], jobs: int, turns: int = 3) -> str:
    """Plates a second of lots of so many, from files to the table, in turns with the loop of scipy, and
    processor time."""
    rows = []
    for count in counts:
        with tempfile.TemporaryDirectory() as where:
            written(Path(where), count, {})
            rows.append(_anew(Path(where), count, jobs, turns))
    table = "\n".join(rows)
    return f"""Two files a plate ({ROWS} and {len(POINTS)} rows); {jobs} processes, their start and the reading of files included; in
turns with a loop of one process over 400 plates, medians of {turns}; programs compiled before, tests of cells made before, and the server
whose forks the processes are begun before; what the first run on a machine takes, which does all of that, stands beside. Of a busy machine
only the ratios of processor time tell something.

| plates | fitted together | plates a second | ms of processor a plate | in the first run | the loop: a second | ms | loop over fleet (each turn) | over the first run | 95 % intervals hold G, tau, f0, % |
|---|---|---|---|---|---|---|---|---|---|
{table}
"""


def _anew(folder: Path, count: int, jobs: int, turns: int) -> str:
    """`_turns` in a process of its own, with nothing kept on disk."""
    with (
        tempfile.TemporaryDirectory() as kept,
        ProcessPoolExecutor(1, get_context("spawn"), _keep_in, (kept,)) as pool,
    ):
        return pool.submit(_turns, folder, count, jobs, turns).result()


def _keep_in(folder: str) -> None:
    os.environ["SYSID_PROGRAMS"] = folder


def _turns(folder: Path, count: int, jobs: int, turns: int) -> str:
    """A row of that table."""
    mark = _clocks()
    sysid.fit_fleet([str(folder)], jobs=jobs)  # programs are compiled, tests made, and both kept
    first = 1e3 * (_clocks() - mark)[1] / count
    spent = np.zeros((turns, 2, 2))
    for turn in spent:
        mark = _clocks()
        found = np.array([by_scipy(folder, seed) for seed in range(min(count, 400))])
        turn[0] = (_clocks() - mark) / len(found)
        mark = _clocks()
        table = sysid.fit_fleet([str(folder)], jobs=jobs)
        turn[1] = (_clocks() - mark) / count
    truth = np.array([numbers(seed)[:3] for seed in range(count)])
    good = (table["result"] == "successful").to_numpy()
    inside = [
        np.mean((table[n][good] - truth[good, k]).abs() < 1.96 * table[f"{n}_std"][good])
        for k, n in enumerate(NAMES)
    ]
    (theirs, ours), (their_cost, our_cost) = np.median(spent, axis=0).T
    each = ", ".join(f"{a / b:.1f}" for a, b in spent[:, :, 1])
    covered = ", ".join(f"{100 * x:.1f}" for x in inside)
    together = (table["way"] == "batch").sum()
    return (
        f"| {count} | {together} | {1 / ours:.1f} | {1e3 * our_cost:.2f} | {first:.2f} | {1 / theirs:.1f} | {1e3 * their_cost:.2f} |"
        f" **{their_cost / our_cost:.1f}** ({each}) | {1e3 * their_cost / first:.1f} | {covered} |"
    )


def _clocks() -> np.ndarray:
    """(2,) s: of the wall, and of the processor in this process, those that it waited for and, on Linux, those
    below it and what they waited for (the server that workers are forks of)."""
    ticks, pids = 0, []
    for place in Path("/proc/self/task").glob("*/children"):
        pids += place.read_text().split()
    for pid in pids:
        with suppress(OSError):
            ticks += sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:15]))
    return np.array([time.perf_counter(), sum(os.times()[:4]) + ticks / os.sysconf("SC_CLK_TCK")])


def found_in_fits(count: int, jobs: int) -> str:
    """Which odd plates of one fitted lot are found."""
    kinds = [KINDS[0], KINDS[2], KINDS[3], KINDS[1]]
    odd = {
        int(k): kinds[i % 4]
        for i, k in enumerate(np.random.default_rng(0).choice(count, count // 25, replace=False))
    }
    with tempfile.TemporaryDirectory() as where:
        written(Path(where), count, odd)
        table = sysid.fit_fleet([where], jobs=jobs)
    rows = []
    for kind in ("", *kinds):
        here = [seed for seed in range(count) if odd.get(seed, "") == kind]
        part = table.iloc[here]
        said = next((why for why in part["odd_why"] if why), "")
        rows.append(f"| {kind or 'of the lot'} | {len(part)} | {int(part['odd'].sum())} | {said[:150]} |")
    return "\n".join(
        [
            f"{count} plates.\n",
            "| kind | plates | called odd | the first reason |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


def found_in_tables(lots: int) -> str:
    """Which odd plates of a thousand are found, by how f0 goes with G in the lot, of tables drawn at
    random."""
    lines = []
    for pair, correlation in (
        (None, 0.0),
        (("G", "tau"), 0.9),
        *((("G", "f0"), r) for r in (0.5, 0.8, 0.9, 0.95)),
    ):
        rng, found, alarms = np.random.default_rng(5), [], []
        for _ in range(lots):
            frame, kind = drawn(rng, pair, correlation)
            odd = with_odd(frame)[0]["odd"].to_numpy()
            found.append([odd[kind == k].mean() for k in (1, 2, 3)])
            alarms.append(odd[kind == 0].sum())
        shares = " | ".join(f"{100 * x:.0f} %" for x in np.mean(found, axis=0))
        named = "none" if pair is None else f"{' and '.join(pair)} {correlation:g}"
        lines.append(
            f"| {named} | {shares} | {np.mean(alarms):.2f} | {100 * np.mean(np.array(alarms) > 1):.0f} % |"
        )
    table = "\n".join(lines)
    return f"""{lots} lots each of 1000 plates: ln G and ln tau scatter by 0.1, f0 by 20 Hz; errors of each plate 0.3 %, 0.45 %,
0.45 Hz. 20 plates are odd.

| correlation in the lot | G and tau at 0.6 | f0 at 3 sd | f0 moved by 3 sd | false alarms | lots with two |
|---|---|---|---|---|---|
{table}

f0 at 3 sd is what 2.7 of a thousand plates have by chance: with at most one false alarm it cannot be told by f0
alone, but it can where something else tells f0.
"""


def drawn(
    rng: np.random.Generator, pair: tuple[str, str] | None, correlation: float
) -> tuple[pd.DataFrame, np.ndarray]:
    """A table of 1000 plates as fits would tell them, and of each the kind: 0, or 1 to 3 as the table's
    columns have them."""
    n, shape, kind = 1000, np.eye(3), np.zeros(1000, int)
    if pair is not None:
        i, j = (NAMES.index(name) for name in pair)
        shape[i, j] = shape[j, i] = correlation
    kind[rng.choice(n, 20, replace=False)] = 1 + np.arange(20) % 3
    places = rng.standard_normal((n, 3)) @ np.linalg.cholesky(shape).T
    sign = rng.choice([-1, 1], n)
    places[kind == 1, :2] += np.log(0.6) / 0.1
    places[kind == 2, 2] = 3 * sign[kind == 2]
    places[kind == 3, 2] += 3 * sign[kind == 3]
    errors = np.array([0.003, 0.0045, 0.45])
    values = (
        np.array([np.log(G), np.log(TAU), F0])
        + places * [0.1, 0.1, 20.0]
        + errors * rng.standard_normal((n, 3))
    )
    frame = pd.DataFrame(
        {"plate": np.arange(n).astype(str), "result": "successful", "error": None, "date": None}
    )
    frame["warnings"], frame["findings"] = [[]] * n, [[]] * n
    frame["serial"], frame["reference_temperature_degC"] = np.arange(n, dtype=float), 24.0
    for k, (name, unit) in enumerate(zip((*NAMES, "k_T"), ("um/V", "s", "Hz", "Hz/degC"), strict=True)):
        told = k < 3
        frame[name] = np.nan if not told else np.exp(values[:, k]) if k < 2 else values[:, k]
        frame[f"{name}_std"] = np.nan if not told else errors[k] * (frame[name] if k < 2 else 1.0)
        frame[f"{name}_unit"], frame[f"{name}_determined"] = unit, told
    return frame, kind


def engines(plates: int, jobs: int) -> str:
    """The table of runs that are killed on the way."""

    def write(folder: Path, count: int) -> np.ndarray:
        written(folder, count, {})
        return np.array([numbers(seed)[:3] for seed in range(count)])

    table = fleet_engines.compared([plates // 10, plates], jobs, write)
    return f"""{jobs} workers. Two files a plate ({ROWS} and {len(POINTS)} rows), one plate of {fleet_engines.SHARE} with a damaged file:
{", ".join(fleet_engines.DAMAGE)}. As a quarter of the plates were done a worker was killed by its pid, as half were a
second one, and the run itself as three quarters were; then the same command went on.

{table}
"""


# of each section the heading, and what makes it of a count of plates, or its own, and of processes
SECTIONS: dict[str, tuple[str, Callable[[int | None, int], str]]] = {
    "tables": ("## Odd plates of a thousand, in tables", lambda n, jobs: found_in_tables(n or 100)),
    "fits": ("## Odd plates of a lot, fitted", lambda n, jobs: found_in_fits(n or 400, jobs)),
    "throughput": ("## Throughput", lambda n, jobs: throughput([n] if n else [1000, 4000, 10_000], jobs)),
    "engines": ("## Killed on the way", lambda n, jobs: engines(n or 10_000, jobs)),
    "speed": (
        "## The fast lane: milliseconds a plate, one core, in turns with `least_squares` from starts 20 % off",
        lambda n, jobs: fleet_lane.throughput(n or 512),
    ),
    "chance": (
        "## The fast lane: what is passed on of clean plates, and 95 % intervals of the others",
        lambda n, jobs: fleet_lane.chance(n or 2000),
    ),
    "agreement": (
        "## The fast lane: its rows beside those of `sysid.fit`, in its errors (the largest of G, tau and f0)",
        lambda n, jobs: fleet_lane.agreement(n or 100, jobs),
    ),
    "spoiled": (
        "## The fast lane: plates that something spoils, and the same plates all by `sysid.fit`",
        lambda n, jobs: fleet_lane.spoiled(n or 16, jobs),
    ),
}


def section(name: str, plates: int | None, jobs: int, before: str) -> str:
    """One section made anew, with the notes of the one before."""
    heading, make = SECTIONS[name]
    told = f"--only {name}" + (f" --plates {plates}" if plates else "")
    begun = os.getloadavg()[2]
    table = make(plates, jobs)
    loads = f"load average {begun:.0f} as it began, {os.getloadavg()[2]:.0f} as it ended"
    made = f"Made by `OPENBLAS_NUM_THREADS=1 python benchmarks/fleet.py {told}` on {date.today()}, {os.cpu_count()} cores, {loads}."
    _, mark, notes = before.partition(NOTES)
    return f"{heading}\n\n{made}\n\n{table}{mark}{notes}".rstrip("\n") + "\n\n"


if __name__ == "__main__":
    command = argparse.ArgumentParser(description=__doc__)
    command.add_argument("--plates", type=int, help="of each table (its own counts); lots, of `tables`")
    command.add_argument("--jobs", type=int, default=2)
    command.add_argument("--only", choices=SECTIONS)
    arguments = command.parse_args()
    page = Path(__file__).with_suffix(".md")
    for name in [arguments.only] if arguments.only else list(SECTIONS):
        top, *parts = re.split("^(?=## )", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
        here = [k for k, part in enumerate(parts) if part.splitlines()[0] == SECTIONS[name][0]]
        at = slice(here[0], here[0] + 1) if here else slice(len(parts), None)  # all others stay as they are
        parts[at] = [section(name, arguments.plates, arguments.jobs, "".join(parts[at]))]
        text = "\n\n".join(part.strip("\n") for part in (top, *parts))
        page.write_text(text + "\n", encoding="utf-8")
