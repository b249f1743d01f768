"""The fast lane of fleets beside scipy and beside `sysid.fit`: speed, what it passes on, agreement, and plates
that something spoils. `fleet.py` writes its tables.
"""

import gc
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
from peers import F0, FAR, TAU, G, in_turns, settled, spread
from scipy.optimize import least_squares

import sysid
from sysid.fleet.groups import Group
from sysid.fleet.lane import rows_of
from sysid.fleet.plate import row_of
from sysid.fleet.settings import Settings
from sysid.precision import one_thread

POINTS, DRIVE, AT, NOISE, LENGTH, REST = np.linspace(31800, 32800, 101), 100.0, 32290.0, 0.02, 0.036, 0.006
FINE = 24  # steps of the integration between two rows
WRONG = 3.0  # errors, from which a parameter is wrong
NAMES = ("G", "tau", "f0")
LAYOUTS = ((100, False), (300, False), (1000, False), (300, True))  # rows of a step; with a sweep beside it
# what spoils a plate's step, or its sweep, and the sizes
SPOILED = {
    "late, tau": (0.1, 0.3),
    "behind a filter, tau": (0.1, 0.3),
    "drifts, half bandwidths": (0.3, 1.0),
    "offset creeps, of the response": (0.01, 0.05),
    "lost rows": (3, 8),
    "coloured, rows": (1.0, 3.0),
    "outliers, share": (0.02, 0.05),
    "clipped, share of a channel": (0.03, 0.1),
    "second mode, of the first": (0.03, 0.1),
    "softens, half bandwidths": (0.2, 0.6),
    "overshoots, of the drive": (0.1, 0.3),
    "sweep off, Hz": (6.0, 20.0),
}


def truths(seeds: Sequence[int]) -> np.ndarray:
    """(P, 3) G, tau, f0 of plates of a lot that scatters by 10 % and 20 Hz."""
    z = np.array([np.random.default_rng([7, seed]).standard_normal(3) for seed in seeds])
    return np.stack([G * np.exp(0.1 * z[:, 0]), TAU * np.exp(0.1 * z[:, 1]), F0 + 20 * z[:, 2]], axis=1)


def steps(seeds: Sequence[int], rows: int = 300, kind: str = "", size: float = 0.0) -> list[sysid.Log]:
    """Steps of 100 V behind a rest, in d and q, with what the bench adds: a rotation, an offset, a feedthrough
    and a trigger that is late by a part of a row; and with what spoils them."""
    at, numbers = LENGTH / rows * np.arange(rows), truths(seeds)
    drive = np.where(at < REST, 0.0, DRIVE)
    since = np.maximum(at - at[np.argmax(drive > 0)], 0.0)
    rngs = [np.random.default_rng([1, seed]) for seed in seeds]
    late = np.array([abs(0.3 * at[1] * rng.standard_normal()) for rng in rngs])
    if kind.startswith("late"):
        late = late + size * numbers[:, 1]
    if kind == "lost rows":
        gone = since > np.median(numbers[:, 1])
        since = since + gone * size * at[1]
    clean = _spoiled(numbers, np.maximum(since - late[:, None], 0.0), drive > 0, kind, size)
    logs = []
    for seed, rng, y in zip(seeds, rngs, clean, strict=True):
        top = np.max(np.abs(y))
        if kind.startswith("offset creeps"):
            y = y + size * top * at / at[-1]
        add = rng.standard_normal(5)
        y = y * np.exp(0.2j * add[0]) + 0.02 * (add[1] + 1j * add[2])
        y = y + 0.003 * top * (add[3] + 1j * add[4]) * (drive > 0)
        if kind.startswith("clipped"):
            edge = (1 - size) * np.max(np.abs(y.real))
            y = np.clip(y.real, -edge, edge) + 1j * y.imag
        y = y + NOISE * _noise(rng, rows, kind, size)
        given = {
            "time": at,
            "drive": drive,
            "frequency": np.full(rows, AT),
            "temperature": np.full(rows, 24.0),
        }
        logs.append(sysid.Log(f"step {seed}", y, kind="transient", sampling="instant", **given))
    return logs


def _spoiled(
    numbers: np.ndarray, since: np.ndarray, driven: np.ndarray, kind: str, size: float
) -> np.ndarray:
    """(P, n) responses of plates since (P, n) s behind the step; driven (n,)."""
    gain, tau, f0 = (x[:, None] for x in numbers.T)
    pole, push, ripple = _modes(gain, tau, f0)
    if kind.startswith(("drifts", "softens")):
        return _integrated(numbers, since, kind, size) + ripple * driven
    y = push / pole * np.expm1(pole * since) + ripple * driven
    if kind.startswith("second mode"):
        other, pushed, rest = _modes(size * gain, tau, f0 + 3 / (2 * np.pi * tau))
        y = y + pushed / other * np.expm1(other * since) + rest * driven
    if kind.startswith("behind a filter"):
        a = -1 / (size * tau)  # y' = a (y - W): by partial fractions
        y = push / pole * (-a * (np.exp(pole * since) - np.exp(a * since)) / (pole - a) + np.expm1(a * since))
    if kind.startswith("overshoots"):
        a = -3 / tau
        y = y + size * push * (np.exp(pole * since) - np.exp(a * since)) / (pole - a)
    return y


def _modes(gain: np.ndarray, tau: np.ndarray, f0: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The slow pole, what pushes it, and the settled ripple of the fast one."""
    omega, omega0 = 2 * np.pi * AT, 2 * np.pi * f0
    damped = np.sqrt(omega0**2 - tau**-2)
    push = gain * DRIVE * omega0 / (damped * tau)
    return -1 / tau + 1j * (damped - omega), push, push / (-1 / tau - 1j * (damped + omega))


def _integrated(numbers: np.ndarray, since: np.ndarray, kind: str, size: float) -> np.ndarray:
    """The slow mode where the resonance drifts by `size` half bandwidths from the first row to the last, or
    softens by as much at its settled amplitude; exact over short intervals of a pole that is held."""
    gain, tau, f0 = numbers.T
    pole, push, _ = _modes(gain, tau, f0)
    top, w, found = np.abs(push / pole), np.zeros(len(gain), complex), np.zeros(since.shape, complex)
    for k in range(1, since.shape[1]):
        h = (since[:, k] - since[:, k - 1]) / FINE
        for step in range(FINE):
            share = (since[:, k - 1] + (step + 0.5) * h) / since[:, -1]
            moved = share if kind.startswith("drifts") else -(np.abs(w / top) ** 2)
            p = pole + 1j * size * moved / tau
            w = w * np.exp(p * h) + push * np.expm1(p * h) / p
        found[:, k] = w
    return found


def _noise(rng: np.random.Generator, n: int, kind: str, size: float) -> np.ndarray:
    """(n,) of unit standard deviation per channel: white, correlated over `size` rows, or with outliers."""
    e = rng.standard_normal((2, n)).T @ (1, 1j)
    if kind.startswith("coloured"):
        a = np.exp(-1 / size)
        for k in range(1, n):
            e[k] = a * e[k - 1] + np.sqrt(1 - a * a) * e[k]
    if kind.startswith("outliers"):
        e = e + 12 * (rng.random(n) < size) * (rng.standard_normal((2, n)).T @ (1, 1j))
    return e


def sweeps(seeds: Sequence[int], kind: str = "", size: float = 0.0) -> list[sysid.Log]:
    """Settled points of a sweep, with a rotation and a feedthrough of 0.1 %; `sweep off`: of a warmer plate."""
    logs = []
    for seed, (gain, tau, f0) in zip(seeds, truths(seeds), strict=True):
        rng = np.random.default_rng([2, seed])
        y = DRIVE * settled(gain, tau, f0 + size * kind.startswith("sweep off"), POINTS)
        y = y * np.exp(0.2j * rng.standard_normal()) + 0.001 * gain * DRIVE * (
            rng.standard_normal(2) @ (1, 1j)
        )
        y = y + NOISE * _noise(rng, len(POINTS), "", 0.0)
        given = {"drive": np.full(len(POINTS), DRIVE), "temperature": np.full(len(POINTS), 24.0)}
        logs.append(sysid.Log(f"sweep {seed}", y, kind="steady", frequency=POINTS, **given))
    return logs


def groups(seeds: Sequence[int], rows: int, pair: bool, kind: str = "", size: float = 0.0) -> list[Group]:
    """Plates with a step, or with a sweep beside it."""
    logs = [steps(seeds, rows, kind, size), *([sweeps(seeds, kind, size)] if pair else [])]
    return [Group(str(seed), each) for seed, *each in zip(seeds, *logs, strict=True)]


def by_scipy(group: Group, truth: np.ndarray) -> np.ndarray:
    """A plate's numbers by `least_squares`, as a user of scipy writes it, from a start 20 % off; with its
    rotation, offset and feedthrough (late is a lateness that it does not look for)."""
    step, *others = group.logs
    t, y = np.maximum(step.time - step.time[np.argmax(step.drive > 0)], 0), step.response
    f, z = (others[0].frequency, others[0].response) if others else (None, None)

    def left(p: np.ndarray) -> np.ndarray:
        pole = -1 / p[1] + 2j * np.pi * (p[2] - AT)
        model = np.exp(1j * p[3]) * p[0] / p[1] * DRIVE * np.expm1(pole * t) / pole + p[4] + 1j * p[5]
        r = y - model
        if f is not None:
            other = np.exp(1j * p[6]) * DRIVE * settled(p[0], p[1], p[2], f) + p[7] + 1j * p[8]
            r = np.concatenate([r, z - other])
        return r.view(float)

    n = 9 if others else 6
    start = np.array([*FAR * truth[:2], truth[2] + 20, 0, 0, 0, 0, 0, 0])[:n]
    return least_squares(left, start, x_scale=np.array([G, TAU, 50, 0.3, 0.1, 0.1, 0.3, 0.1, 0.1])[:n]).x


def throughput(plates: int = 512, repeat: int = 5) -> str:
    """Milliseconds of one core a plate, in turns: from logs in memory, templates made before."""
    lines = [_turns(rows, pair, plates, repeat) for rows, pair in LAYOUTS]
    return "\n".join(
        [
            "Templates made before (once for each process, for each cell of plates that are nearly alike)."
            f" {plates} plates.\n",
            "| rows | scipy | fit and screen | with the table's rows | with those passed on | scipy over fit and"
            " screen | over rows | over all |",
            "|---|---|---|---|---|---|---|---|",
            *lines,
            "",
        ]
    )


def _turns(rows: int, pair: bool, plates: int, repeat: int) -> str:
    """One row of that table."""
    seeds, settings = range(plates), Settings().of_run(plates)
    some, truth = groups(seeds, rows, pair), truths(seeds)
    kept = {row["plate"] for row in rows_of(some, settings) if row["way"] == "batch"}
    gc.freeze()  # as processes of a fleet do
    clean = [group for group in some if group.plate in kept]
    few = range(32)
    ways: dict[str, Callable[[], object]] = {
        "solved": lambda: _solved(clean),
        "batch": lambda: list(rows_of(clean, settings)),
        "all": lambda: list(rows_of(some, settings)),
        "scipy": lambda: [by_scipy(some[k], truth[k]) for k in few],
    }
    _, took = in_turns(ways, repeat)
    counts = {"solved": len(clean), "batch": len(clean), "all": plates, "scipy": len(few)}
    each = {name: 1e3 * took[name] / count for name, count in counts.items()}
    shown = " | ".join(spread(each[name]) for name in ("scipy", "solved", "batch", "all"))
    ratio = " | ".join(
        f"{np.median(each['scipy']) / np.median(each[n]):.1f}" for n in ("solved", "batch", "all")
    )
    what = f"step of {rows}" + (" and sweep of 101" if pair else "")
    return f"| {what} | {shown} | {ratio} |"


@one_thread
def _solved(some: Sequence[Group]) -> None:
    """Fit and screen of plates of one layout, without what makes rows of them."""
    from sysid.fleet import lane
    from sysid.fleet.screen import residual, screened

    plates = [(group, list(group.logs)) for group in some]
    key, size = lane.layout(plates[0][1]), lane.together(plates[0][1])
    for k in range(0, len(plates), size):
        with np.errstate(all="ignore"):
            batch = lane.fit_together(plates[k : k + size])
            cells = lane.cells_of(key, plates[0][1])
            lefts = [residual(log, batch.step) for log in batch.logs]
            screened(batch, lefts, cells, plates=len(plates))


def _lane(some: Sequence[Group], settings: Settings) -> list[dict]:
    return list(rows_of(some, settings))


def _full(some: Sequence[Group], settings: Settings) -> list[dict]:
    return [row_of(group, settings) for group in some]


def _in_processes(way: Callable, some: Sequence[Group], jobs: int) -> dict[str, dict]:
    parts = [some[k::jobs] for k in range(jobs)]
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        found = pool.map(partial(way, settings=Settings()), parts)
        return {row["plate"]: row for rows in found for row in rows}


def off(row: dict, other: dict | np.ndarray) -> np.ndarray:
    """(3,) by how many of its errors a row's parameters are off another row's, or the truth; NaN where it
    tells none."""
    found = []
    for k, name in enumerate(NAMES):
        p = row.get("parameters", {}).get(name, {})
        value = other[k] if isinstance(other, np.ndarray) else other["parameters"][name]["value"]
        known = p.get("std") is not None and value is not None
        found.append((p["value"] - value) / p["std"] if known else np.nan)
    return np.array(found)


def chance(plates: int = 4000) -> str:
    """What is passed on of clean plates, and coverage of the others."""
    lines, seeds = [], range(10_000, 10_000 + plates)
    for what in ("step", "sweep", "step and sweep"):
        some = groups(seeds, 300, what != "step")
        if what == "sweep":
            some = [Group(group.plate, group.logs[1:]) for group in some]
        table = list(rows_of(some, Settings()))
        rows, truth = (
            {row["plate"]: row for row in table},
            dict(zip(map(str, seeds), truths(seeds), strict=True)),
        )
        batch = [plate for plate, row in rows.items() if row["way"] == "batch"]
        z = np.abs([off(rows[plate], truth[plate]) for plate in batch])
        covered = " | ".join(f"{100 * x:.1f} %" for x in np.mean(z < 1.96, axis=0))
        why = [row["way_why"] for row in table if row["way"] != "batch"]
        most = ", ".join(
            f"{name} {why.count(name)}" for name in sorted(set(why), key=why.count, reverse=True)[:4]
        )
        lines.append(f"| {what} | {plates} | {100 * len(why) / plates:.2f} % | {most} | {covered} |")
    head = "White noise of 1 % of the response, a bench that turns, offsets, feeds through and triggers late.\n\n"
    head += "| logs | plates | passed on | why | G within 95 % | tau | f0 |\n|---|---|---|---|---|---|---|"
    return "\n".join([head, *lines, ""])


def agreement(plates: int = 300, jobs: int = 2) -> str:
    """How far rows of the batch are from those of `sysid.fit`, in its errors."""
    lines = []
    for pair in (False, True):
        some = groups(range(20_000, 20_000 + plates), 300, pair)
        full, ours = _in_processes(_full, some, jobs), {r["plate"]: r for r in rows_of(some, Settings())}
        both = [p for p in full if ours[p]["way"] == "batch" and full[p]["result"] == "successful"]
        z = np.max(np.abs([off(full[p], ours[p]) for p in both]), axis=1)
        std = [
            np.max(
                [abs(ours[p]["parameters"][n]["std"] / full[p]["parameters"][n]["std"] - 1) for n in NAMES]
            )
            for p in both
        ]
        other = sum(full[p]["result"] != ours[p]["result"] for p in full if ours[p]["way"] == "batch")
        said = sum(full[p]["findings"] != ours[p]["findings"] for p in both)
        what = "step and sweep" if pair else "step"
        lines.append(
            f"| {what} | {len(both)} | {np.median(z):.2g} | {np.quantile(z, 0.98):.2g} | {np.max(z):.2g} |"
            f" {np.mean(z > 0.1) * 100:.1f} % | {np.median(std):.1g}, {np.max(std):.2g} | {other} | {said} |"
        )
    head = (
        "| logs | plates | median | 98 % | largest | over 0.1 | errors differ by (median, largest) |"
        " other result | other findings |\n|---|---|---|---|---|---|---|---|---|"
    )
    return "\n".join([head, *lines, ""])


def spoiled(plates: int = 24, jobs: int = 2, pairs: Sequence[bool] = (False, True)) -> str:
    """What spoiled plates come to: in the fleet, and by `sysid.fit` on all of them."""
    lines = []
    for pair in pairs:
        for kind, sizes in SPOILED.items():
            if kind.startswith("sweep") and not pair:
                continue
            for size in sizes:
                lines.append(_of_kind(plates, jobs, pair, kind, size))
                print(lines[-1], flush=True)
    head = (
        f"{plates} plates each. Told: the row names a finding or a warning, or has another result than successful."
        f" Silently wrong: it does not, and a parameter is more than {WRONG:g} of its errors off.\n\n"
        "| logs | spoiled by | passed on | fleet: told | harmless | silently wrong | `sysid.fit`: told | harmless |"
        " silently wrong |\n|---|---|---|---|---|---|---|---|---|"
    )
    return "\n".join([head, *lines, ""])


def _of_kind(plates: int, jobs: int, pair: bool, kind: str, size: float) -> str:
    seeds = range(30_000, 30_000 + plates)
    some, truth = groups(seeds, 300, pair, kind, size), dict(zip(map(str, seeds), truths(seeds), strict=True))
    rows = _in_processes(_lane, some, jobs)
    passed = [plate for plate, row in rows.items() if row["way"] == "fit"]  # and so by `sysid.fit` already
    rest = [group for group in some if group.plate not in passed]
    full = {plate: rows[plate] for plate in passed} | _in_processes(_full, rest, jobs)

    def counted(found: dict[str, dict]) -> str:
        told = [
            p
            for p, row in found.items()
            if row["result"] != "successful" or row["findings"] or row["warnings"]
        ]
        wrong = [p for p in found if p not in told and np.nanmax(np.abs(off(found[p], truth[p]))) > WRONG]
        return f"{len(told)} | {len(found) - len(told) - len(wrong)} | {len(wrong)}"

    what = "step and sweep" if pair else "step"
    return f"| {what} | {kind} {size:g} | {len(passed)} of {plates} | {counted(rows)} | {counted(full)} |"
