"""Where plates are fitted: in processes of this machine, through a Dask scheduler, or in this process.

An engine maps one function over batches of plates and gives their rows as they come, each plate once.
Processes may be killed: a new pool goes on with what is left, the plates that were being fitted are tried one
by one, and one that ends its process again becomes a row that says so.
"""

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from sysid.fleet.groups import Group
from sysid.fleet.lane import rows_of
from sysid.fleet.plate import Row, dead
from sysid.fleet.settings import Settings

LARGEST = 250  # plates in a batch, a part of the table each
EACH = 8  # batches of a worker, so that all end at about the same time
THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
)  # of matrices too small for more than one
Batch = Sequence[Group]


class EngineError(RuntimeError):
    """That nothing can be fitted where it was asked to be."""


class Engine(Protocol):
    """What gives the rows of plates."""

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """The rows of all plates, a batch at a time, as they are done."""


def batches(groups: Sequence[Group], workers: int) -> list[Batch]:
    """The plates in batches, of a size for so many workers."""
    size = min(max(len(groups) // (EACH * workers), 1), LARGEST)
    return [groups[k : k + size] for k in range(0, len(groups), size)]


class Here:
    """This process, one plate after the other."""

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """As `Engine.rows`."""
        for batch in batches(groups, 1):
            yield list(rows_of(batch, settings))


class Processes:
    """So many processes of this machine, with one thread each for matrices."""

    def __init__(self, jobs: int):
        self.jobs = jobs

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """As `Engine.rows`. Raises EngineError where no process begins."""
        waiting = batches(groups, self.jobs)
        while waiting:
            left, begun = yield from self._through(waiting, settings)
            suspects = [g for batch in left for g in batch if g.plate in begun]
            for group in suspects:
                yield [self._alone(group, settings)]
            rest = [g for batch in left for g in batch if g.plate not in begun]
            if rest and not suspects and len(left) == len(waiting):
                raise EngineError(
                    "the processes that fit end between two plates, without a word: something kills them"
                )
            waiting = batches(rest, self.jobs) if rest else []

    def _through(
        self, waiting: Sequence[Batch], settings: Settings
    ) -> Generator[list[Row], None, tuple[list[Batch], set[str]]]:
        """The rows of these batches until a process is killed; returns the batches that are left, and the
        plates that were being fitted."""
        left, broken = {id(batch): batch for batch in waiting}, False
        with tempfile.TemporaryDirectory(prefix="fleet-") as where, _pool(self.jobs, where) as pool:
            futures = {pool.submit(_fitted, batch, settings): batch for batch in waiting}
            for future in as_completed(futures):
                try:
                    rows = future.result()
                except BrokenProcessPool:
                    broken = True
                    continue
                del left[id(futures[future])]
                yield rows
            begun = {path.read_text(encoding="utf-8") for path in Path(where).iterdir()} if broken else set()
        return list(left.values()), begun

    def _alone(self, group: Group, settings: Settings) -> Row:
        """The row of a plate that may have killed its process, from a process of its own."""
        with tempfile.TemporaryDirectory(prefix="fleet-") as where, _pool(1, where) as pool:
            try:
                return pool.submit(_fitted, [group], settings).result()[0]
            except BrokenProcessPool:
                return dead(group, settings)


class Dask:
    """The workers of a Dask scheduler, by its address; they must see the logs under the same paths."""

    def __init__(self, address: str):
        self.address = address

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """As `Engine.rows`. Raises EngineError without the package distributed, OSError where no scheduler
        answers."""
        try:
            import distributed
        except ImportError:
            said = "a Dask scheduler needs the package distributed: pip install 'sysid[dask]'"
            raise EngineError(said) from None
        with distributed.Client(self.address) as client:
            workers = max(sum(client.nthreads().values()), 1)
            waiting = batches(groups, workers)
            while waiting:
                futures = client.map(_fitted, waiting, settings=settings, pure=False)
                ordered, waiting = dict(zip(futures, waiting, strict=True)), []
                for future in distributed.as_completed(futures):
                    try:
                        yield future.result()
                    except distributed.KilledWorker:
                        batch = ordered[future]
                        waiting += [] if len(batch) == 1 else [[group] for group in batch]
                        if len(batch) == 1:
                            yield [dead(batch[0], settings)]


class _Spawned(SpawnContext):
    """Makes processes anew, as a fork of one with JAX's threads may wait for ever, and knows those that it
    made."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[BaseProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> BaseProcess:  # type: ignore[override]
        """One of a pool's."""
        self.made.append(super().Process(*args, **kwargs))
        return self.made[-1]


@contextmanager
def _pool(jobs: int, where: str) -> Iterator[Executor]:
    """A pool whose processes begin, with one thread each for matrices; they end with the block, or with this
    process. Raises EngineError where they do not begin."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read as a process loads its libraries
    context = _Spawned()
    pool = ProcessPoolExecutor(jobs, context, _begin, (where,))
    try:
        _answer(pool, jobs)
        yield pool
        pool.shutdown()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in context.made:
            process.terminate()
        for process in context.made:
            process.join()
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _answer(pool: Executor, jobs: int) -> None:
    begun = [pool.submit(os.getpid) for _ in range(jobs)]  # so that all of them begin at once
    try:
        begun[0].result()
    except BrokenProcessPool:
        guard = "in a script, what calls this must stand under `if __name__ == '__main__':`"
        said = "the processes that fit end before they begin"
        raise EngineError(f"{said}; {guard}, as each loads the script; jobs=0 needs none") from None


_place: list[Path] = []  # of this process's file that names the plate that it fits


def _begin(where: str) -> None:
    """In a process of a pool: interruptions are the parent's to answer, without which it ends; programs
    compile beside."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _place[:] = [Path(where) / str(os.getpid())]
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    from sysid.precision import make_beside

    make_beside()


def _end_with(sentinel: Any) -> None:
    wait([sentinel])
    os._exit(1)


def _fitted(batch: Batch, settings: Settings) -> list[Row]:
    """The rows of a batch; while a plate is fitted in a pool, a file names it, or the first of those that are
    fitted together."""

    def begin(group: Group) -> None:
        for path in _place:
            path.write_text(group.plate, encoding="utf-8")

    rows = list(rows_of(batch, settings, begin))
    for path in _place:
        path.unlink()
    return rows
