"""The options of the command `identify`."""

import argparse
import math
from collections.abc import Sequence

from sysid import __version__
from sysid.asked import ABSOLUTE_ZERO
from sysid.posterior.accuracy import NAMES
from sysid.shell import add_folder, called, completed, seed

COLUMNS = "mapping file (TOML) for logs of other instruments, or preset:NAME (sysid presets lists them)"
REFERENCE = 24.0  # degC
# What a check of a closed loop, a dry run and a cost curve have no use for.
UNCHECKED = (
    "cost_curve",
    "accuracy",
    "budget",
    "advise",
    "rig",
    "effects",
    "prior",
    "seed",
    "reference_temperature",
    "compare",
    "zoomable",
)
UNMEASURED = ("advise", "rig", "compare", "zoomable")
IDLE = {"check": ("dry_run", *UNCHECKED), "dry_run": UNCHECKED, "cost_curve": UNMEASURED}


def arguments_of(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line `argv` (None: the process's own). Exits with 2 where it is not understood, or states
    an option that has nothing to do beside the others."""
    command = completed(parser(), columns_of)
    arguments = command.parse_args(argv)
    if bool(arguments.logs) == bool(arguments.check):
        missing = "the following arguments are required: LOGS"
        command.error("expected LOGS to fit, or --check FILE" if arguments.check else missing)
    work = next((name for name in IDLE if getattr(arguments, name)), None)
    given = {name for name, value in vars(arguments).items() if value is not None and value is not False}
    idle = [name for name in IDLE.get(work, ()) if name in given]
    if found := ", ".join(map(_option, idle)):
        command.error(
            f"found {found} beside {_option(work)}, which does nothing with it: expected it without"
        )
    if arguments.reference_temperature is None:
        arguments.reference_temperature = REFERENCE
    arguments.seed = arguments.seed or 0
    return arguments


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def columns_of() -> list[str]:
    """What `--columns` may be beside a file: the presets."""
    from sysid.columns.preset import PREFIX, presets

    return [f"{PREFIX}{name}" for name in presets()]


def parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    command = argparse.ArgumentParser(
        prog=called("identify"),
        description="From bench logs of a resonant actuator to its plant, error bars, and a tuned d/q"
        " controller.",
        epilog="exit: 0 identified; 1 not identified, and says why and what to record; 2 bad usage or"
        " unreadable input",
        allow_abbrev=False,
    )
    command.add_argument(
        "logs", nargs="*", metavar="LOGS", help="CSV files of one plate, or patterns such as 'logs/*.csv'"
    )
    add_folder(command, "identified")
    command.add_argument("--columns", metavar="FILE", help=COLUMNS)
    _of_the_fit(command)
    _of_other_work(command)
    _of_the_time(command)
    command.add_argument(
        "--rig",
        metavar="FILE",
        help="rig file (TOML): clock, limits and sensor of what the controller runs on",
    )
    command.add_argument(
        "--zoomable",
        action="store_true",
        help="write report_zoomable.html too, the report's figures to zoom into (needs plotly)",
    )
    command.add_argument("--seed", type=seed, metavar="N", help="of the sampler (0)")
    command.add_argument("--json", action="store_true", help="print fit.json instead of the screen")
    command.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return command


def _of_the_fit(command: argparse.ArgumentParser) -> None:
    """What is fitted, and what is known beforehand."""
    command.add_argument(
        "--reference-temperature",
        type=temperature,
        metavar="DEGC",
        help=f"where f0 is reported ({REFERENCE:g} degC)",
    )
    command.add_argument(
        "--effects",
        type=effects,
        metavar="LIST",
        help="what the bench may have added to the logs, with commas between, or none; unless stated"
        " rotation, background, offset, start, late and thermometer, and where the logs call for them all"
        " others that docs/errors.md lists, as delay, filter (of a lock-in), duffing, second_mode and"
        " saturation; --effects=-late leaves one out, --effects=+drift adds one of drift, lag (of the"
        " temperature's sensor), gain and baseline (an output offset that goes on with the time)",
    )
    command.add_argument(
        "--prior",
        type=prior,
        action="append",
        metavar="NAME=VALUE+-STD",
        help="what is known of G, tau (s), f0 (Hz) or k_T beforehand: --prior=k_T=-8+-1; may be repeated",
    )


def _of_other_work(command: argparse.ArgumentParser) -> None:
    """What else may be asked than a fit."""
    command.add_argument(
        "--advise",
        choices=("G", "tau", "f0", "k_T", "worst", "margin", "settling"),
        help="say which step or sweep shrinks the error of this parameter (or of the one that is known"
        " worst), or betters this"
        " promise of the closed loop, most per second",
    )
    command.add_argument(
        "--check",
        metavar="FILE",
        help="a log of the closed loop, judged by the controller.json in DIR; no LOGS are fitted",
    )
    command.add_argument(
        "--compare",
        metavar="FILE",
        help="the fit.json of an older fit, or its folder: say whether the plate has changed since",
    )
    command.add_argument(
        "--dry-run",
        action="store_true",
        help="say what each file is taken for, as which columns, units and constants, and stop",
    )


def _of_the_time(command: argparse.ArgumentParser) -> None:
    """How much time the uncertainty may take."""
    spent = command.add_mutually_exclusive_group()
    spent.add_argument(
        "--accuracy",
        choices=NAMES,
        help="quick: the fit's normal approximation, checked; standard: Markov chains (unless stated);"
        " exact: ten times as long,"
        " over every row",
    )
    spent.add_argument(
        "--cost-curve", action="store_true", help="error against time of every accuracy on these logs"
    )
    spent.add_argument(
        "--budget", type=_seconds, metavar="SECONDS", help="the best accuracy that fits; refused if none does"
    )


def temperature(text: str) -> float:
    """degC."""
    if not ABSOLUTE_ZERO <= (value := _number(text)) < math.inf:
        raise argparse.ArgumentTypeError(
            f"found {text or 'nothing'}, expected a temperature in degC, above absolute zero"
        )
    return value


def _number(text: str) -> float:
    """NaN where the text is no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def effects(text: str) -> tuple[str, ...]:
    """Names of effects, as `effects` of `sysid.fit` takes them."""
    from sysid.effects.registry import chosen

    try:
        return chosen(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def prior(text: str) -> tuple[str, tuple[float, float]]:
    """`k_T=-8+-1`, or with ±."""
    from sysid.model.prior import checked

    name, _, number = text.partition("=")
    value, sign, std = number.replace("±", "+-").partition("+-")
    try:
        return next(iter(checked({name.strip(): (float(value), float(std))}).items()))
    except ValueError as error:
        said = str(error) if sign and number and "convert" not in str(error) else f"found {text}"
        raise argparse.ArgumentTypeError(
            f"{said}; expected a name, a value and a standard deviation, as in k_T=-8+-1"
        ) from None


def _seconds(text: str) -> float:
    if not 0 < (value := _number(text)) < math.inf:
        raise argparse.ArgumentTypeError(f"found {text or 'nothing'}, expected seconds above 0")
    return value
