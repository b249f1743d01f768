"""The time of a run: seconds of each stage, a line while it lasts, and a budget that is kept or refused.

What starting and writing take is measured in every run and kept in the user's cache folder, never assumed: it
is the floor below which a budget is refused, and what is set aside for the files when the rung is chosen.
"""

import json
import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

GRACE = 1.2  # times the budget, which no run takes
STOP = 1.15  # times the budget, when it is stopped: the rest is the process's own end
RUNS = 5  # that are remembered
FILES = ("design", "compare", "report")  # stages after the posterior


class Stages:
    """Seconds that each stage took, and a line on a terminal while it lasts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.now = "starting"
        self._line: Callable[[str], Any] = nullcontext
        if sys.stderr.isatty():
            from sysid.command.line import Line

            self._line = Line()

    @contextmanager
    def __call__(self, name: str, doing: str) -> Iterator[None]:
        begun, self.now = time.perf_counter(), doing
        with self._line(doing):
            yield
        self.seconds[name] = round(time.perf_counter() - begun, 3)


class BudgetError(ValueError):
    """A budget that cannot be kept."""


class Budget:
    """At most `seconds` (None: any) from `begun` (perf_counter) on. The `record` holds the stages of the last
    runs."""

    def __init__(self, seconds: float | None, begun: float, stages: Stages, record: Path):
        self.seconds, self.begun, self.stages, self.path = seconds, begun, stages, record
        # files on their way, which are of no use to anybody when the run is stopped
        self.fresh: Path | None = None
        self.chains = 0.0  # seconds that the libraries of the chains took to load
        self._leave = threading.Lock()
        self._timer: threading.Timer | None = None
        try:
            self.runs: list[dict[str, float]] = json.loads(record.read_text(encoding="utf-8"))
            self.floor = min(run["load"] + run["files"] for run in self.runs)
        except (OSError, ValueError, KeyError, TypeError):
            self.runs, self.floor = [], 0.0
        if seconds is None:
            return
        if seconds < self.floor:
            with suppress(OSError):  # the hour may have been a busy one: the next run is measured anew
                record.unlink()
            needed = math.ceil(100 * self.floor) / 100
            raise BudgetError(
                f"found {seconds:g} s, expected at least {needed:g} s, which starting and writing took here"
            )
        self._timer = threading.Timer(STOP * seconds - self.spent, self._stop)
        self._timer.daemon = True
        self._timer.start()

    def __enter__(self) -> "Budget":
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()

    @property
    def spent(self) -> float:
        """Seconds since the run began."""
        return time.perf_counter() - self.begun

    @property
    def files(self) -> float:
        """Seconds to set aside for what comes after the posterior: the most of the last runs; at first, as
        long as starting."""
        known = [run["files"] for run in self.runs]
        return max(known, default=self.stages.seconds.get("load", 0.0))

    @property
    def left(self) -> float | None:
        """Seconds that the posterior may take. Raises BudgetError when they are over."""
        if self.seconds is None:
            return None
        spent = self.spent
        if spent + self.files > GRACE * self.seconds:
            said = ", ".join(f"{name} {took:.2g} s" for name, took in self.stages.seconds.items())
            needed = f"at least {spent + self.files:.2g} s for these logs: {said}, files {self.files:.2g} s"
            raise BudgetError(f"found {self.seconds:g} s, expected {needed}")
        return max(self.seconds - spent - self.files, 0.0)

    @property
    def starting(self) -> float:
        """Seconds that the libraries of the chains take to load, where they are not: the most of the last
        runs; at first, as long as all others."""
        if "emcee" in sys.modules:
            return 0.0
        known = [run["chains"] for run in self.runs if run.get("chains")]
        return max(known, default=self.stages.seconds.get("load", 0.0))

    def load_chains(self, alone: bool) -> None:
        """Load what chains need: as long as all other imports, and beside a fit, which leaves the interpreter
        idle. `alone`: in a process of the command's own."""
        begun = time.perf_counter()
        # For a move that is not used here emcee loads scipy.stats, a third of the time of all imports; it
        # does without where there is none. Another program's process must not be told so.
        hidden = alone and "scipy.stats" not in sys.modules
        if hidden:
            sys.modules["scipy.stats"] = None  # type: ignore[assignment]
        import_module("sysid.posterior.chain")
        if hidden:
            del sys.modules["scipy.stats"]
        self.chains = time.perf_counter() - begun

    def keep(self) -> None:
        """From here on the run is not stopped any more."""
        self._leave.acquire()  # for ever: whoever stops the run needs it

    def remember(self) -> None:
        """Add this run to the record."""
        took = self.stages.seconds
        run = {"load": took["load"], "files": sum(took[name] for name in FILES), "chains": self.chains}
        with suppress(OSError):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            part = self.path.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps([*self.runs, run][-RUNS:]), encoding="utf-8")
            part.replace(self.path)

    def _stop(self) -> None:
        """End the process, wherever it is: a compiler at work hears no signal."""
        self._leave.acquire()
        if self.fresh is not None:
            shutil.rmtree(self.fresh, ignore_errors=True)
        shown = "\x1b[?25h\n" if sys.stderr.isatty() else ""  # the line hides the cursor
        print(
            f"{shown}identify: --budget: found {self.seconds:g} s, expected more for these logs: still"
            f" {self.stages.now} after"
            f" {self.spent:.2g} s; nothing was written",
            file=sys.stderr,
            flush=True,
        )
        os._exit(2)
