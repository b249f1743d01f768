"""Ten thousand plates as files through processes and through Dask, while workers and the run itself are killed
and one file of a hundred is damaged: is every plate there once, and what does it cost? `fleet.py` writes its
table.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

import sysid

ENGINES = ("processes", "Dask")
DAMAGE: dict[str, Callable[[bytes], bytes]] = {  # what happens to the bytes of a file
    "a cell that is no number": lambda text: _row(text, 60, lambda row: b"x" + row[1:]),
    "a row that is cut off": lambda text: _row(text, 60, lambda row: row[: row.rindex(b",")]),
    "columns of unknown names": lambda text: text.replace(b"wd_um,wq_um", b"left,right"),
    "no rows": lambda text: text[: text.index(b"_um\n") + 4],
    "nothing": lambda text: b"",
    "zeros, as a disk leaves them": lambda text: bytes(len(text)),
}
SHARE = 100  # plates of which one has a damaged file
KILLED = (0.25, 0.5, 0.75)  # of the plates are done as a worker is killed, a second one, and the run itself
GONE = 20.0  # s that processes have to end by themselves after the run was killed
PARAMETERS = ("G", "tau", "f0")
COMMAND = "import sys; from sysid.command.fleet import main; sys.exit(main())"


def _row(text: bytes, number: int, change: Callable[[bytes], bytes]) -> bytes:
    lines = text.split(b"\n")
    lines[number] = change(lines[number])
    return b"\n".join(lines)


def damaged(folder: Path, count: int) -> dict[Path, str]:
    """Damage one file of a hundred plates each, steps and sweeps in turn; {path: kind}."""
    found = {}
    for k, plate in enumerate(range(SHARE // 2, count, SHARE)):
        kind = list(DAMAGE)[k % len(DAMAGE)]
        path = folder / f"P{plate:05d}_{'sweep' if k // len(DAMAGE) % 2 else 'step'}.csv"
        path.write_bytes(DAMAGE[kind](path.read_bytes()))
        found[path] = kind
    return found


@dataclass
class Watched:
    """What a run is seen to do: the `done` plates at some times (s), peaks of memory in MiB of each worker and
    of the run itself, and how long it took from its start to its end, or until it was killed."""

    times: list[float] = field(default_factory=list)
    done: list[int] = field(default_factory=list)
    worker: float = 0.0
    own: float = 0.0  # not shared with others
    run: float = 0.0
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Plates a second, from the start on."""
        return (self.done[-1] - self.done[0]) / self.seconds


class Parts:
    """The parts of a folder, of which each is counted once."""

    def __init__(self, folder: Path):
        self.folder, self.known = folder / "parts", dict[str, int]()

    def count(self) -> int:
        """Rows in all of them."""
        for path in self.folder.glob("*.jsonl"):
            if path.name not in self.known:
                self.known[path.name] = path.read_bytes().count(b"\n")
        return sum(self.known.values())

    def twice(self) -> int:
        """Rows of plates that have another."""
        rows = Counter(
            json.loads(line)["plate"]
            for path in self.folder.glob("*.jsonl")
            for line in path.read_text(encoding="utf-8").splitlines()
        )
        return rows.total() - len(rows)


def children(pid: int) -> list[int]:
    """The processes that one has begun, on Linux."""
    found = []
    for place in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += map(int, place.read_text().split())
    return found


def _server(pid: int) -> list[int]:
    """Of a run the server whose forks its workers are."""
    found = []
    for child in children(pid):
        with suppress(OSError):
            if b"forkserver" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(child)
    return found


def memory(pid: int, name: str = "VmHWM", file: str = "status") -> float:
    """MiB; 0 of a process that has ended."""
    with suppress(OSError):
        text = Path(f"/proc/{pid}/{file}").read_text()
        return sum(float(size) for size in re.findall(rf"^{name}:\s+(\d+) kB", text, re.MULTILINE)) / 1024
    return 0.0


def watched(
    command: Sequence[str],
    out: Path,
    count: int,
    workers: Callable[[int], list[int]],
    kills: Sequence[float],
) -> tuple[Watched, str]:
    """Run a command to its end, or until it is killed as the last of the `kills`, before which a worker is
    killed at each; and what it says."""
    seen, parts, waiting = Watched(), Parts(out), list(kills)
    begun = time.monotonic()
    with tempfile.TemporaryFile("w+") as said:
        run = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT)
        before = parts.count()
        while run.poll() is None:
            time.sleep(0.1)
            done, pids = parts.count(), workers(run.pid)
            if not seen.done or done > seen.done[-1]:
                seen.times.append(time.monotonic() - begun)
                seen.done.append(done)
                seen.worker = max([seen.worker, *map(memory, pids)])
                seen.own = max([seen.own, *(memory(p, "Private_.*", "smaps_rollup") for p in pids)])
                seen.run = max(seen.run, memory(run.pid))
            if waiting and done > waiting[0] * count and pids:
                waiting.pop(0)
                os.kill(pids[len(waiting) % len(pids)] if waiting else run.pid, signal.SIGKILL)
        seen.seconds = time.monotonic() - begun
        said.seek(0)
        text = said.read()
    if kills and (waiting or run.returncode != -signal.SIGKILL):
        raise RuntimeError(f"the run ended before it was killed, at {before} plates: {text}")
    if not kills and run.returncode:
        raise RuntimeError(text)
    return seen, text


@contextmanager
def engine(name: str, jobs: int) -> Iterator[tuple[list[str], Callable[[int], list[int]]]]:
    """Options of the command, and what tells the workers of a run by its process."""
    if name == ENGINES[0]:
        yield ["--jobs", str(jobs)], lambda run: [w for s in _server(run) for w in children(s)]
        return
    import dask
    import distributed

    spawn = dict(dask.config.get("distributed.nanny.pre-spawn-environ"))
    spawn.pop("MALLOC_TRIM_THRESHOLD_", None)
    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": spawn}),
        distributed.LocalCluster(
            n_workers=jobs, threads_per_worker=1, memory_limit=0, dashboard_address=None, silence_logs=40
        ) as cluster,
    ):
        yield (
            ["--scheduler", cluster.scheduler_address],
            lambda run: [n.pid for n in list(cluster.workers.values()) if n.pid],
        )


def _left_behind(pids: Sequence[int]) -> int:
    """How many of a killed run's processes are still there after a while."""
    until = time.monotonic() + GONE
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < until:
        time.sleep(0.1)
    return sum(Path(f"/proc/{pid}").exists() for pid in pids)


@dataclass(frozen=True)
class Outcome:
    """A run that was killed, and what the same command made of it."""

    engine: str
    plates: int
    first: Watched
    second: Watched
    missing: int
    twice: int
    again: int
    behind: int
    sentences: str
    covered: list[float]
    table: pd.DataFrame = field(repr=False)
    bytes: dict[str, int]

    @property
    def seconds(self) -> float:
        """s of both."""
        return self.first.seconds + self.second.seconds

    @property
    def finish(self) -> float:
        """s from the last row to the end."""
        return self.second.seconds - self.second.times[-1]


def hurt(name: str, folder: Path, count: int, jobs: int, bad: dict[Path, str], truth: np.ndarray) -> Outcome:
    """A run of so many plates whose workers are killed, and that is killed; then it is done."""
    with tempfile.TemporaryDirectory() as where, engine(name, jobs) as (options, workers):
        out, mine = Path(where) / "out", set[int]()

        def known(run: int) -> list[int]:
            pids = workers(run)
            mine.update(pids if name == ENGINES[0] else [])
            return pids

        command = [sys.executable, "-c", COMMAND, str(folder), "-o", str(out), *options]
        first, _ = watched(command, out, count, known, KILLED)
        behind = _left_behind(sorted(mine))
        rows = Parts(out).count()
        second, _ = watched(command, out, count, workers, ())
        table = pd.read_parquet(out / "fleet.parquet")
        sizes = {path.name: path.stat().st_size for path in out.glob("fleet.*")}
        sizes["parts"] = sum(path.stat().st_size for path in (out / "parts").iterdir())
        parts = Parts(out)
        return Outcome(
            name,
            count,
            first,
            second,
            *_present(table, count, bad),
            parts.twice(),
            behind,
            _sentences(table, bad),
            _covered(table, truth),
            table.set_index("plate"),
            sizes | {"rows": rows},
        )


def _present(table: pd.DataFrame, count: int, bad: dict[Path, str]) -> tuple[int, int]:
    """How many plates, and files that state none, have no row, and how many rows are too many."""
    names = Counter(table["plate"])
    nameless = {str(path) for path, kind in bad.items() if kind in [*DAMAGE][3:]}
    wanted = {f"P{seed:05d}" for seed in range(count)} | nameless
    return len(wanted - {*names}), names.total() - len(wanted & {*names})


def _sentences(table: pd.DataFrame, bad: dict[Path, str]) -> str:
    """Of the damaged files how many are one row with the sentence of `sysid.read_logs`, of how many."""
    good = 0
    rows = dict(zip(table["plate"], table["error"], strict=True))
    for path in bad:
        try:
            sysid.read_logs(path)
        except sysid.LogError as refused:
            errors = [rows.get(path.name.partition("_")[0]), rows.get(str(path))]
            good += [e for e in errors if isinstance(e, str)] == [str(refused)]
    return f"{good} of {len(bad)}"


def _covered(table: pd.DataFrame, truth: np.ndarray) -> list[float]:
    """The share of identified plates whose 95 % interval of each parameter holds the truth."""
    good = table[(table["result"] == "successful") & table["plate"].str.fullmatch(r"P\d+")]
    right = truth[good["plate"].str[1:].astype(int)]
    return [
        float(np.mean((right[:, k] > good[f"{n}_ci95_low"]) & (right[:, k] < good[f"{n}_ci95_high"])))
        for k, n in enumerate(PARAMETERS)
    ]


def apart(a: Outcome, b: Outcome) -> str:
    """By how many of its errors any plate's number differs between two engines, and how many go another way."""
    one, other = a.table, b.table.loc[a.table.index]
    off = [((one[n] - other[n]) / one[f"{n}_std"]).abs().max() for n in PARAMETERS]
    ways = int((one["way"] != other["way"]).sum() + (one["result"] != other["result"]).sum())
    return f"Between the engines no number differs by more than {max(off):.1g} of its error; {ways} plates went another way or ended otherwise."


def line(o: Outcome) -> str:
    """A row of the table."""
    workers = max(o.first.worker, o.second.worker), max(o.first.own, o.second.own)
    cells = [
        o.engine,
        str(o.plates),
        f"{o.first.rate:.0f}",
        f"{o.first.seconds:.0f} + {o.second.seconds:.0f}",
        f"{o.finish:.1f}",
        f"{workers[0]:.0f} ({workers[1]:.0f})",
        f"{max(o.first.run, o.second.run):.0f}",
        f"{o.missing}, {o.twice}, {o.again}, {o.behind}",
        o.sentences,
        ", ".join(f"{100 * x:.1f}" for x in o.covered),
    ]
    return f"| {' | '.join(cells)} |"


def million(few: Outcome, many: Outcome) -> str:
    """What a million plates would take, by what grows from the one to the other."""
    far = 1e6 - many.plates

    def grown(of: Callable[[Outcome], float]) -> float:
        return of(many) + far * (of(many) - of(few)) / (many.plates - few.plates)

    hours, finish = grown(lambda o: o.seconds) / 3600, grown(lambda o: o.finish) / 60
    memory = grown(lambda o: max(o.first.run, o.second.run)) / 1024
    disk = grown(lambda o: sum(v for k, v in o.bytes.items() if k != "rows")) / 2**30
    return (
        f"{many.engine}: {hours:.1f} h, of them {finish:.0f} min behind the last row; {memory:.0f} GiB in the run"
        f" itself, {disk:.1f} GiB of results."
    )


def compared(
    counts: Sequence[int],
    jobs: int,
    write: Callable[[Path, int], np.ndarray],
    report: Callable[[str], None] = print,
) -> str:
    """The table: of each number of plates both engines; `write` makes their files in a folder and tells the
    truth (n, 3)."""
    found: dict[tuple[str, int], Outcome] = {}
    for count in counts:
        with tempfile.TemporaryDirectory() as where:
            truth = write(Path(where), count)
            if not found:
                sysid.fit_fleet([where], jobs=jobs)  # programs are compiled, and kept
            bad = damaged(Path(where), count)
            for name in ENGINES:
                found[name, count] = hurt(name, Path(where), count, jobs, bad, truth)
                report(line(found[name, count]))
    rows = "\n".join(map(line, found.values()))
    last = counts[-1]
    slopes = "\n".join(
        f"- {million(found[n, counts[0]], found[n, last])}" for n in ENGINES if len(counts) > 1
    )
    return f"""| engine | plates | plates a second until killed | s until killed + resumed | s behind the last row | MiB a worker (not shared) | MiB the run | plates missing, twice in the table, done twice, processes left behind | bad files with the reader's sentence | 95 % intervals that hold G, tau, f0, % |
|---|---|---|---|---|---|---|---|---|---|
{rows}

{apart(found[ENGINES[0], last], found[ENGINES[1], last])}

For a million plates, by the slopes between {counts[0]} and {last}, the resume included:

{slopes}
"""
