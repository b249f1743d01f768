"""Where plates are fitted: in processes of this machine, through a Dask scheduler, or in this process.

An engine maps one function over batches of plates and gives their rows as they come, each plate once. What a
batch passes on, to be fitted by itself, makes small batches of its own: only processes that get one load the
programs of `sysid.fit`, and no process has all of them.
Processes may be killed: a new pool goes on with what is left, the plates that were being fitted are tried one
by one, and one that ends its process twice more becomes a row that says so.
"""

import gc
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol, TextIO

from sysid.fleet.groups import Group
from sysid.fleet.lane import rows_alone, rows_of, rows_together
from sysid.fleet.plate import Row, dead
from sysid.fleet.settings import Settings

if sys.platform == "linux":
    from multiprocessing.context import ForkServerContext as Context
else:  # where libraries do not survive a fork
    from multiprocessing.context import SpawnContext as Context

LARGEST = 500  # plates in a batch, a part of the table each
EACH = 8  # batches of a worker, so that all end at about the same time
FITS = 8  # plates that are fitted one by one, in a batch: takes about as long as loading what fits them
# read as a process loads its libraries: one thread for matrices too small for more, and of an accelerator,
# which they share, no more memory than is needed
SURROUNDINGS = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
}
LOADED = ("sysid.fleet.told", "sysid.fleet.differ", "sysid.fitting", "sysid.posterior.posterior")
TRIES = 3  # to begin processes, which something may kill
GONE = 0.5  # s that a server takes to go once it was killed, before which no other begins; more at each try
REFUSED = 1  # exit code of a process that cannot load the script, which none that is killed has
COMES = 60  # s that a Dask scheduler may have no worker, as they begin
# how a pool says that one of its processes, or the server whose forks they are, was killed
KILLED = (BrokenProcessPool, EOFError, ConnectionError)
NO_GUARD = (
    "the processes that fit end before they begin; in a script, what calls this must stand under"
    " `if __name__ == '__main__':`, as each loads the script; jobs=0 needs none"
)
BYTES = "surrogateescape"  # how a name that a file's gives, which may be any bytes, is written as it is
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
    """So many processes of this machine, with one thread each for matrices. The server whose forks they are
    begins to load what they need at once."""

    def __init__(self, jobs: int):
        self.jobs = jobs
        if sys.platform == "linux":
            with _surroundings():
                _Anew().served()

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """As `Engine.rows`. Raises EngineError where no process begins."""
        jobs = min(self.jobs, len(groups))
        waiting, moved = batches(groups, jobs), True
        while waiting:
            before = moved
            left, begun, moved = yield from self._through(waiting, jobs, settings)
            suspects = [g for g in left if g.plate in begun]
            for group in suspects:
                yield [self._alone(group, settings)]
            rest, moved = [g for g in left if g.plate not in begun], moved or bool(suspects)
            if rest and not (moved or before):
                raise EngineError(
                    "the processes that fit end between two plates, without a word: something kills them"
                )
            waiting = batches(rest, jobs) if rest else []

    def _through(
        self, waiting: Sequence[Batch], jobs: int, settings: Settings
    ) -> Generator[list[Row], None, tuple[list[Group], set[str], bool]]:
        """The rows of these batches until a process is killed; returns the plates that are left, the names of
        those that were being fitted, and whether any batch came back."""
        left, alone, moved = list[Group](), _Alone(), False
        with tempfile.TemporaryDirectory(prefix="fleet-") as where, _pool(jobs, where) as pool:
            going: dict[Future, Batch] = {}
            while waiting or going:
                for batch in waiting:
                    try:
                        going[pool.submit(_fitted, batch, settings)] = batch
                    except KILLED:
                        left += batch
                for future in wait_for(going, return_when=FIRST_COMPLETED).done:
                    batch = going.pop(future)
                    try:
                        rows, passed = future.result()
                    except BrokenProcessPool:
                        left += batch
                        continue
                    moved = True
                    alone.groups += passed
                    yield rows
                waiting = alone.batches(last=not going)
            begun = {path.read_text("utf-8", BYTES) for path in Path(where).iterdir()} - {""}
        return left, begun, moved

    def _alone(self, group: Group, settings: Settings) -> Row:
        """The row of a plate that may have killed its process, from a process of its own; tried twice, as
        something else may have killed either."""
        for _ in range(2):
            with (
                tempfile.TemporaryDirectory(prefix="fleet-") as where,
                _pool(1, where) as pool,
                suppress(*KILLED),
            ):
                rows, passed = pool.submit(_fitted, [group], settings).result()
                return (rows or pool.submit(_fitted, passed, settings).result()[0])[0]
        return dead(group, settings)


class Dask:
    """The workers of a Dask scheduler, by its address; they must see the logs under the same paths."""

    def __init__(self, address: str):
        self.address = address

    def rows(self, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """As `Engine.rows`. Raises EngineError without the package distributed, where no worker comes, or as
        the scheduler ends; OSError where none answers."""
        try:
            import distributed
        except ImportError:
            said = "a Dask scheduler needs the package distributed: pip install 'sysid[dask]'"
            raise EngineError(said) from None
        with distributed.Client(self.address) as client:
            try:
                client.wait_for_workers(1, timeout=COMES)
                yield from self._through(client, groups, settings)
            except TimeoutError:
                raise EngineError(f"{self.address}: found no worker within {COMES} s, expected one") from None
            except CancelledError:
                said = "the Dask scheduler ended; what is done is kept, and the same command goes on"
                raise EngineError(f"{self.address}: {said}") from None

    def _through(self, client: Any, groups: Sequence[Group], settings: Settings) -> Iterator[list[Row]]:
        """The rows of all plates. A batch that Dask gives up, as workers were killed with it, is tried by
        plates."""
        from distributed import KilledWorker, as_completed

        fitted = partial(_fitted, settings=settings)
        waiting, alone = batches(groups, max(sum(client.nthreads().values()), 1)), _Alone()
        going = dict(zip(client.map(fitted, waiting, pure=False), waiting, strict=True))
        done = as_completed(going)
        for future in done:
            batch, more = going.pop(future), list[Batch]()
            try:
                rows, passed = future.result()
                alone.groups += passed
                yield rows
            except KilledWorker:
                if len(batch) == 1:
                    yield [dead(batch[0], settings)]
                else:
                    more += [[group] for group in batch]
            more += alone.batches(last=not going and not more)
            for batch in more:
                future = client.submit(fitted, batch, pure=False)
                going[future] = batch
                done.add(future)


class _Alone:
    """Plates that batches have passed on, and that wait to be fitted one by one."""

    def __init__(self) -> None:
        self.groups: list[Group] = []

    def batches(self, last: bool) -> list[Batch]:
        """Those of them that make a batch; all where it is the last of them."""
        whole = len(self.groups) if last else len(self.groups) - len(self.groups) % FITS
        taken, self.groups = self.groups[:whole], self.groups[whole:]
        return [taken[k : k + FITS] for k in range(0, whole, FITS)]


class _Anew(Context):
    """Makes processes anew, as a fork of one with JAX's threads may wait for ever, and knows those that it
    made. On Linux they are forks of a server, which has loaded what they need and has no threads."""

    def __init__(self) -> None:
        super().__init__()
        self.set_forkserver_preload(list(LOADED))
        self.made: list[BaseProcess] = []

    def served(self) -> None:
        """Begin the server, where none has begun."""
        from multiprocessing.forkserver import ensure_running

        ensure_running()

    def Process(self, *args: Any, **kwargs: Any) -> BaseProcess:  # type: ignore[override]
        """One of a pool's."""
        self.made.append(super().Process(*args, **kwargs))
        return self.made[-1]


@contextmanager
def _pool(jobs: int, where: str) -> Iterator[Executor]:
    """A pool whose processes begin, with one thread each for matrices; they end with the block, or with this
    process. Raises EngineError where they do not begin."""
    context, pools = _Anew(), list[Executor]()
    with _surroundings():
        try:
            while not (pools and _answers(pools[-1], jobs)):
                for pool in pools[-1:]:
                    pool.shutdown(cancel_futures=True)  # tells how its processes ended
                if len(pools) == TRIES or any(process.exitcode == REFUSED for process in context.made):
                    raise EngineError(NO_GUARD)
                time.sleep(GONE * len(pools))
                pools.append(ProcessPoolExecutor(jobs, context, _begin, (where,)))
            yield pools[-1]
            pools[-1].shutdown()
        finally:
            for pool in pools:
                pool.shutdown(wait=False, cancel_futures=True)
            begun = [process for process in context.made if process.pid is not None]
            for process in begun:
                process.terminate()
            for process in begun:
                process.join()


@contextmanager
def _surroundings() -> Iterator[None]:
    """SURROUNDINGS for what begins meanwhile."""
    before = {name: os.environ.get(name) for name in SURROUNDINGS}
    os.environ.update(SURROUNDINGS)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _answers(pool: Executor, jobs: int) -> bool:
    """Whether the processes of a pool begin."""
    try:
        begun = [pool.submit(os.getpid) for _ in range(jobs)]  # so that all of them begin at once
        begun[0].result()
    except KILLED:
        return False
    return True


_place: list[TextIO] = []  # this process's file that names the plate that it fits


def _begin(where: str) -> None:
    """In a process of a pool: interruptions are the parent's to answer, without which it ends; programs
    compile beside."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()  # what the server has loaded stays, and need not be gone through again
    place = Path(where) / str(os.getpid())
    _place[:] = [open(place, "w", encoding="utf-8", errors=BYTES)]  # noqa: SIM115
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    from sysid.precision import make_beside

    make_beside()


def _end_with(sentinel: Any) -> None:
    wait([sentinel])
    os._exit(1)


def _names(plate: str) -> None:
    """Write down, in a process of a pool, which plate it fits; "" none."""
    for file in _place:
        file.seek(0)
        file.truncate()
        file.write(plate)
        file.flush()


def _fitted(batch: Batch, settings: Settings) -> tuple[list[Row], list[Group]]:
    """The rows of a batch, and the plates of it that are to be fitted one by one, as this one's are if that
    is known of them; while a plate is fitted in a pool, a file names it, or the first of those that are
    fitted together."""
    passed: list[Group] = []
    begin = lambda group: _names(group.plate)  # noqa: E731
    fresh = [group for group in batch if group.alone is None]
    rows = [row for part in rows_together(fresh, settings, passed.append, begin) for row in part]
    rows += rows_alone([group for group in batch if group.alone is not None], settings, begin)
    _names("")
    return rows, passed
