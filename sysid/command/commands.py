"""The command `sysid`: all commands under one name, as `identify` is another program's too.

Which there are stands in the metadata of what is installed (entry points `sysid.commands`): none is imported
before it is asked for, this package knows no other by name, and a package may add its own.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points

from sysid import __version__
from sysid.shell import ASKED, completed

GROUP = "sysid.commands"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (None: the process's own arguments) begins with, and return its exit
    code."""
    known = {entry.name: entry for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name)}
    asked = argv is None and ASKED in os.environ
    words = _begun() if asked else sys.argv[1:] if argv is None else list(argv)
    if not words or words[0] not in known:
        parser = _parser(known)
        if words:
            parser.parse_args(words[:1])  # ends the process, with what it knows of an option, or a refusal
        parser.print_help(sys.stderr)
        return 2
    if asked:
        os.environ[ASKED] = str(int(os.environ[ASKED]) + 1)  # the command's own name begins the line
    if argv is None:
        sys.argv = [f"sysid {words[0]}", *words[1:]]  # as if it had been called so
    return known[words[0]].load()(None if argv is None else words[1:])


def _begun() -> list[str]:
    """The words of the shell's line between the command and the one that is being written."""
    import argcomplete

    words = argcomplete.split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))[3]
    return words[int(os.environ[ASKED]) :]


def _parser(known: Mapping[str, EntryPoint]) -> argparse.ArgumentParser:
    """The parser of a line that begins with none of the `known` commands."""
    parser = argparse.ArgumentParser(
        prog="sysid",
        usage="%(prog)s [-h] [--version] COMMAND ...",
        description="From bench logs of a resonant actuator to its plant, error bars, and a controller.",
        epilog="sysid COMMAND --help lists the options of one",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", prog="sysid")
    for name, entry in known.items():
        commands.add_parser(name, help=_told(entry), add_help=False)
    return completed(parser)


def _told(entry: EntryPoint) -> str:
    """What a command does: its module's first line says it behind a colon."""
    said = sys.modules[entry.load().__module__].__doc__ or ""
    return said.partition("\n")[0].partition(": ")[2].rstrip(".").replace("`", "").replace("%", "%%")
