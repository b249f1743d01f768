"""Whether a file of text holds a table at all, or is a note that lies beside the logs."""

from collections.abc import Iterator

from sysid.tables import units
from sysid.tables.cells import MARKS, is_number, split_line
from sysid.tables.stamps import is_stamp
from sysid.tables.textfile import LogError, open_text, read_line


def is_prose(path: str) -> bool:
    """Whether a file holds words, and neither two rows of numbers nor a header of a log. What is empty, cut
    off or no text is none of these: it may have been a log."""
    words, number, before = False, 0, set[tuple[str, int]]()
    try:
        with open_text(path) as file:
            while raw := read_line(path, file, number := number + 1):
                text = raw.decode("utf-8", errors="replace").strip()
                rows = {(mark, len(cells)) for mark, cells in _parted(text) if _are_values(cells)}
                if before & rows or not text.replace("\t", " ").isprintable() or _is_header(text):
                    return False
                words, before = words or any(map(str.isalpha, text)), before | rows
    except (LogError, OSError, EOFError):
        return False
    return words


def _parted(text: str) -> Iterator[tuple[str, list[str]]]:
    """The cells of a line that hold something, by each mark that may part them."""
    for mark in MARKS:
        yield mark, [cell for cell in split_line(text, mark) if cell.strip()]


def _are_values(cells: list[str]) -> bool:
    """Whether more than half of some cells are numbers or dates."""
    return 2 * sum(is_number(cell) or is_stamp(cell) for cell in cells) > len(cells)


def _is_header(text: str) -> bool:
    """Whether a line consists of names of a log's columns."""
    return any(len(cells) > 1 and all(map(units.parse_name, cells)) for _, cells in _parted(text))
