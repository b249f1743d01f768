"""The command `sysid presets`: the mapping files that ship for instruments' files, or one of them, to save
and change.

Exit codes: 0; 2 for a name that is none.
"""

import argparse
import sys
from collections.abc import Sequence

from sysid.command.refusal import refuse
from sysid.shell import called, completed, reader


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    arguments = _parser().parse_args(argv)
    from sysid.columns.preset import named, presets

    with reader():
        if arguments.name is not None:
            try:
                sys.stdout.write(named(arguments.name).text)
            except KeyError as error:
                return refuse(error.args[0], command="presets")
            return 0
        from sysid.report.screen import rows

        rows(
            [("preset", "files"), *((name, one.title) for name, one in presets().items())],
            sys.stdout,
            right=False,
        )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=called("presets"),
        description="The mapping files that ship for instruments' files, used as identify --columns"
        " preset:NAME.",
        epilog='a mapping file of the line preset = "NAME" says further lines beside it',
        allow_abbrev=False,
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="print this one; without it, list them all")
    return completed(parser)
