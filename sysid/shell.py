"""A command and its shell: the name that it was called by, how a line that was begun may go on, and a reader
who leaves."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress

# environment variable of a shell that asks: the place of the command in its line, from 1
ASKED = "_ARGCOMPLETE"


def called(name: str) -> str:
    """The name that the command `name` was called by: its own, or that below `sysid`
    (`sysid.command.commands`)."""
    return sys.argv[0] if sys.argv[0] == f"sysid {name}" else name


def completed(
    parser: argparse.ArgumentParser, words: Callable[[], Iterable[str]] = tuple
) -> argparse.ArgumentParser:
    """The parser. A shell that asks how its line may go on is answered by it, and the process ends. `words`:
    what `--columns` may be beside a file."""
    if ASKED in os.environ:
        import argcomplete

        for action in parser._actions:
            if action.dest == "columns":
                vars(action)["completer"] = _words_or_files(words)
        argcomplete.autocomplete(parser)
    return parser


def _words_or_files(words: Callable[[], Iterable[str]]) -> Callable[..., list[str]]:
    """What completes a word that is one of several or a file."""
    from argcomplete.completers import FilesCompleter

    return lambda prefix, **_: [
        *(word for word in words() if word.startswith(prefix)),
        *FilesCompleter()(prefix),
    ]


def seed(text: str) -> int:
    """A whole number that a generator of numbers starts from."""
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(
            f"found {text or 'nothing'}, expected a whole number from 0 to {2**32 - 1}"
        )
    return value


def add_folder(command: argparse.ArgumentParser, default: str, what: str = "where the files go") -> None:
    """The option -o."""
    command.add_argument(
        "-o", dest="folder", type=_folder, metavar="DIR", default=default, help=f"{what} (%(default)s)"
    )


def _folder(text: str) -> str:
    """A folder's name: of a variable that the shell does not know nothing is left."""
    if not text:
        raise argparse.ArgumentTypeError("found nothing, expected a folder")
    return text


@contextmanager
def reader() -> Iterator[None]:
    """Around what is printed: a reader that has closed the pipe, as `head` does, or that there never was, has
    what it wanted, and changes no exit code. Of an output that cannot be written, as to a full disk, this is
    said, and the process ends with 2."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit):  # rich makes the other of the one
        _silence()
    except OSError as error:
        _silence()
        print(f"{os.path.basename(sys.argv[0])}: standard output cannot be written: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _silence() -> None:
    """What is left in the buffer would fail on the way out."""
    with suppress(OSError, ValueError):  # of what is no file nothing is left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
