"""What is said of a file whose columns are not known, and a mapping file to begin with."""

import contextlib
from collections.abc import Sequence

from sysid.columns.draft import template
from sysid.columns.found import joined
from sysid.columns.metadata import rate_key
from sysid.tables.cells import Dialect, listed
from sysid.tables.csvfile import Head, LogError, read_head


class Unnamed(LogError):
    """Of a file none of whose columns is a response by the contract's names, or an input beside one; with the
    `head` of its draft."""

    def __init__(self, message: str, head: Head) -> None:
        super().__init__(message, drafted(head))
        self.head = head


def not_understood(head: Head, found: str, expected: str, unnamed: bool = False) -> LogError:
    """What to say of a file whose columns are not known: what was found, what was expected, and a mapping
    file to begin with. `unnamed`: by the contract's names it has no response, or no input."""
    path = head.path
    if len(head.names) == 1 and (rate := rate_key(head.metadata)):
        said = f"found one channel alone ({head.names[0] or 'without a name'}; {rate}: {head.metadata[rate]})"
        drive = "expected the drive beside it, recorded at once as a second channel"
        decay = (
            "of a decay that nothing drives, save the amplitude over time, as time_s and w_V: it tells tau"
        )
        return LogError(f"{path}: {said}, which does not tell what drives it; {drive}; {decay}")
    if head.dialect.header and (wide := min(map(_width, head.sample))) > len(head.names) + 1:
        across = "; a table that lies across, one quantity a line, is to be turned: one a column"
        said = f"found {wide} columns, expected {len(head.names)} as in the header{across}"
        return LogError(f"{path}, line {head.first_line}: {said}")
    names = listed(list(filter(None, head.names))) or f"{len(head.names)} columns without a header"
    first = (head.names[0] or head.sample[0][0])[:1]
    if first in (";", "/", "*"):  # it looks like another comment mark
        with contextlib.suppress(LogError):
            head = read_head(head.path, Dialect(comment=(first,)))
    message = f"{path}: found {found} ({names}), expected {expected}"
    return Unnamed(message, head) if unnamed else LogError(message, drafted(head))


def drafted(head: Head) -> str:
    """A mapping file to begin with; of a file whose traces stand one below the other for all of them side by
    side."""
    return template(joined(head, Dialect()))


def _width(row: Sequence[str]) -> int:
    """Cells of a row up to the last that holds something."""
    return max((k for k, cell in enumerate(row, 1) if cell.strip()), default=0)
