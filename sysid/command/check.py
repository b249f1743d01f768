"""The command `sysid check`: whether a closed loop does what its controller.json predicts.

Exit codes: 0 it does; 1 it does not; 2 bad usage or unreadable input.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from sysid.command.arguments import COLUMNS, columns_of
from sysid.command.refusal import refuse
from sysid.shell import add_folder, called, completed, reader


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    a = _parser().parse_args(argv)
    return judge(a.record, a.folder, a.columns, a.json, "check")


def judge(record: str, folder: str, columns: str | None, as_json: bool, command: str) -> int:
    """Print what the loop of `record` does beside what the controller.json in `folder` predicts; returns the
    exit code of the `command`."""
    from controller.check import check
    from sysid.command import outputs
    from sysid.logs.log import LogError
    from sysid.logs.read import read_logs
    from sysid.report.screen import findings

    path = Path(folder) / outputs.CONTROLLER
    try:
        predicted = json.loads(path.read_text(encoding="utf-8"))
        kept = isinstance(predicted, dict) and predicted.get("schema") == outputs.SCHEMA
        if not kept or "promise" not in predicted:
            said = f"{path}: found no controller of schema {outputs.SCHEMA}; identify writes it"
            return refuse(said, command=command)
        found = check(predicted, read_logs([record], columns)[0])
    except LogError as error:
        return refuse(str(error), error.mapping, command)
    except (OSError, ValueError) as error:
        return refuse(f"{path}: cannot be read: {error}; identify writes it", command=command)
    kept = all(f.kept for f in found)
    with reader():
        if as_json:
            sys.stdout.write(outputs.to_json({"kept": kept, "findings": [f._asdict() for f in found]}))
        else:
            findings(found, sys.stdout)
    return 0 if kept else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=called("check"),
        description="Whether a closed loop does what its controller.json predicts.",
        epilog="exit: 0 as predicted; 1 not, and says what and why; 2 bad usage or unreadable input",
        allow_abbrev=False,
    )
    parser.add_argument("record", metavar="FILE", help="a log of the closed loop, which begins at rest")
    add_folder(parser, "identified", "the folder of controller.json")
    parser.add_argument("--columns", metavar="FILE", help=COLUMNS)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    return completed(parser, columns_of)
