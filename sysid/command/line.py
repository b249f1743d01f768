"""One line on a terminal while a run goes on: what is being done, what of it is being tried, and the time so
far.

What is tried is what the package logs (`logging`, level INFO), which any other program may listen to as well.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from sysid.report.text import clean


class Line:
    """The line, on standard error; it is there while something is done, and leaves nothing behind."""

    def __init__(self) -> None:
        one = Column(no_wrap=True, overflow="ellipsis")
        shown = (SpinnerColumn(), TextColumn("{task.description}", table_column=one), TimeElapsedColumn())
        self._progress = Progress(*shown, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("")

    @contextmanager
    def __call__(self, doing: str) -> Iterator[None]:
        def show(tried: str = "") -> None:
            said = f"{doing}: {tried}" if tried else doing
            self._progress.update(self._task, description=escape(clean(said)))

        show()
        with self._progress, _listening(show):
            yield


@contextmanager
def _listening(hear: Callable[[str], None]) -> Iterator[None]:
    """Give what the package logs to `hear`, and leave its logger as it was."""
    logger, handler = logging.getLogger("sysid"), _Ear(hear)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)


class _Ear(logging.Handler):
    """A handler of logging that passes on what is said."""

    def __init__(self, hear: Callable[[str], None]) -> None:
        super().__init__(logging.INFO)
        self._hear = hear

    def emit(self, record: logging.LogRecord) -> None:
        self._hear(record.getMessage())
