"""The command `sysid fleet`: fits every plate that it finds, writes one table with its report, prints one
screen.

Exit codes: 0 every plate has its row and one at least is identified; 1 the table is written, and none is; 2
bad usage, nothing to fit, or a folder that cannot be written (what is done stays, and is not done again); 130
interrupted; 70 a defect of the program.
"""

import argparse
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from sysid import __version__
from sysid.command.arguments import COLUMNS, REFERENCE, columns_of, effects, prior, seed, temperature
from sysid.command.refusal import refuse
from sysid.posterior.accuracy import NAMES
from sysid.shell import add_folder, called, completed, reader

if TYPE_CHECKING:
    import pandas as pd


SHOWN = 12  # odd plates, and kinds of warnings, on one screen


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as for `identify`
    arguments = completed(parser(), columns_of).parse_args(argv)
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        said = "interrupted; the same command goes on with what is left"
        print(f"{called('fleet')}: {said}", file=sys.stderr)
        return 130
    except Exception:
        traceback.print_exc()
        return 70


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    command = argparse.ArgumentParser(
        prog=called("fleet"),
        description="Many plates, each from its own logs: one table, and those that are not like the others.",
        epilog="exit: 0 the table is written; 1 no plate in it is identified; 2 bad usage, or nothing to fit",
        allow_abbrev=False,
    )
    command.add_argument(
        "logs", nargs="+", metavar="LOGS_OR_FOLDERS", help="files, folders (with those below), patterns"
    )
    add_folder(command, "fleet")
    command.add_argument(
        "--by",
        type=_way,
        default="plate",
        metavar="WAY",
        help="how logs are told apart: plate, which they state above the header (%(default)s); folder; or a"
        " regular expression with one group, the plate, that is searched for in each file's name",
    )
    command.add_argument("--jobs", type=_jobs, metavar="N", help="processes (one for each core)")
    command.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask scheduler, whose workers fit (extra dask)"
    )
    command.add_argument(
        "--lane",
        choices=("on", "off"),
        default="on",
        help="off: fit each plate by itself, not those together that are recorded alike (%(default)s)",
    )
    command.add_argument(
        "--accuracy",
        choices=NAMES,
        default=NAMES[0],
        help="of each plate's posterior, as for identify (%(default)s)",
    )
    command.add_argument(
        "--full", action="store_true", help="write every plate's own files, as identify does, into DIR/plates"
    )
    command.add_argument(
        "--shrink", action="store_true", help="with columns of what each plate has by its logs and by the lot"
    )
    command.add_argument("--columns", metavar="FILE", help=COLUMNS)
    command.add_argument("--effects", type=effects, metavar="LIST", help="as for identify")
    command.add_argument(
        "--prior", type=prior, action="append", metavar="NAME=VALUE+-STD", help="as for identify"
    )
    command.add_argument(
        "--reference-temperature",
        type=temperature,
        default=REFERENCE,
        metavar="DEGC",
        help="where f0 is reported (%(default)g degC)",
    )
    command.add_argument("--seed", type=seed, default=0, metavar="N", help="of the sampler (%(default)s)")
    command.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return command


def _way(text: str) -> str:
    from sysid.fleet.groups import FOLDER, PLATE, pattern

    try:
        return text if text in (PLATE, FOLDER) else pattern(text).pattern
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _jobs(text: str) -> int:
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(
            f"found {text or 'nothing'}, expected a whole number of processes from 1 on"
        )
    return int(text)


def _run(arguments: argparse.Namespace) -> int:
    from sysid.command.outputs import check_writable
    from sysid.fleet.engine import EngineError
    from sysid.fleet.run import fit_fleet
    from sysid.tables.textfile import LogError

    try:
        check_writable(Path(arguments.folder))
    except OSError as error:
        return refuse(f"{arguments.folder}: cannot be written: {error}", command="fleet")
    told = ("by", "folder", "jobs", "scheduler", "accuracy", "full", "shrink", "seed", "columns")
    names = (*told, "reference_temperature")
    given = {name: getattr(arguments, name) for name in names}
    given |= {"nuisances": arguments.effects, "priors": dict(arguments.prior or ())}
    given |= {"lane": arguments.lane == "on"}
    try:
        with _progress() as meanwhile:
            frame = fit_fleet(arguments.logs, **given, meanwhile=meanwhile)
    except LogError as error:
        return refuse(str(error), error.mapping, "fleet")
    except EngineError as error:
        return refuse(str(error), command="fleet")
    except OSError as error:
        return refuse(f"{error}; what is done is kept, and the same command goes on", command="fleet")
    with reader():
        _say(frame, Path(arguments.folder))
    return 0 if (frame["result"] == "successful").any() else 1


@contextmanager
def _progress() -> "Iterator[Callable[[int, int], None] | None]":
    """What shows how many plates are done, on a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("plates", total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def _say(frame: "pd.DataFrame", where: Path) -> None:
    """One screen: the lot, the plates that are odd and why, what many plates warn of, where the files are."""
    from sysid.fleet import words
    from sysid.report import screen
    from sysid.report.text import clean

    print(
        f"{len(frame)} plates: {', '.join(f'{count} {result}' for result, count in words.counted(frame))}\n"
    )
    if measures := words.measures(frame):
        screen.rows(
            [["parameter", "lot's median", "lot's sd", "a plate's error", "unit"], *measures], sys.stdout
        )
        print()
    odd = frame[frame["odd"]]
    print(f"odd: {len(odd)}")
    for plate, why in zip(odd["plate"][:SHOWN], odd["odd_why"][:SHOWN], strict=True):
        print(f"  {clean(plate)}: {clean(why)}")
    if len(odd) > SHOWN:
        print(f"  and {len(odd) - SHOWN} more in the table")
    for line in words.said(frame):
        print(clean(line))
    for count, warning in words.repeated(frame)[:SHOWN]:
        print(f"warning of {count} plate{'s' if count > 1 else ''}: {clean(warning)}")
    print(f"\n{clean(str(where))}: {', '.join(frame.attrs['files'])}")
