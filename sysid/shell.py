"""A command and its shell: the name that it was called by, how a line that was begun may go on, and a reader who leaves."""

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

ASKED = "_ARGCOMPLETE"  # environment variable of a shell that asks: the place of the command in its line, from 1


def called(name: str) -> str:
    """The name that the command `name` was called by: its own, or that below `sysid` (`sysid.command.commands`)."""
    return sys.argv[0] if sys.argv[0] == f"sysid {name}" else name


def completed(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """The parser. A shell that asks how its line may go on is answered by it, and the process ends."""
    if ASKED in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
    return parser


@contextmanager
def reader() -> Iterator[None]:
    """Around what is printed: a reader that has closed the pipe, as `head` does, has what it wanted, and changes no exit code."""
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit):  # rich makes the other of the one
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or what is left in the buffer fails on the way out
