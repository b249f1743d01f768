"""The command `identify`: reads logs, fits, samples, designs the controller, writes the files, prints one screen.

Exit codes: 0 identified; 1 not converged, not described or not determined; 2 bad usage or unreadable input; 130 interrupted;
70 a defect of the program itself.
"""

import argparse
import gc
import io
import math
import os
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid import __version__
from sysid.accuracy import NAMES

if TYPE_CHECKING:
    from sysid.clock import Budget, Stages


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if bool(arguments.logs) == bool(arguments.check):
        parser.error("expected LOGS to fit, or --check FILE" if arguments.check else "the following arguments are required: LOGS")
    try:
        return _check(arguments) if arguments.check else _identify(arguments)
    except KeyboardInterrupt:
        print("identify: interrupted", file=sys.stderr)
        return 130
    except Exception:  # a defect of the program is none of the results that exit 1 stands for
        traceback.print_exc()
        return 70
    finally:
        gc.freeze()  # or the interpreter would search all that JAX has loaded for cycles on its way out: half a second


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="identify",
        description="From bench logs of a resonant actuator to its plant, error bars, and a tuned d/q controller.",
        epilog="exit: 0 identified; 1 not identified, and says why and what to record; 2 bad usage or unreadable input",
        allow_abbrev=False,
    )
    parser.add_argument("logs", nargs="*", metavar="LOGS", help="CSV files of one plate, or patterns such as 'logs/*.csv'")
    parser.add_argument("-o", dest="folder", metavar="DIR", default="identified", help="where the files go (%(default)s)")
    parser.add_argument("--columns", metavar="FILE", help="mapping file (TOML) for logs of other instruments")
    parser.add_argument(
        "--reference-temperature", type=_number, metavar="DEGC", default=24.0, help="where f0 is reported (%(default)g degC)"
    )
    parser.add_argument(
        "--effects",
        type=_effects,
        metavar="LIST",
        help="what the bench may have added to the logs, all unless stated: rotation,background,offset,start,late; or none;"
        " --effects=-late leaves one out",
    )
    parser.add_argument(
        "--advise",
        choices=("G", "tau", "f0", "k_T", "worst"),
        help="say which step or sweep shrinks the error of this parameter (or of the one that is known worst) most per second",
    )
    parser.add_argument(
        "--check", metavar="FILE", help="a log of the closed loop, judged by the controller.json in DIR; no LOGS are fitted"
    )
    spent = parser.add_mutually_exclusive_group()
    spent.add_argument(
        "--accuracy",
        choices=NAMES,
        help="quick: the fit's normal approximation, checked; standard: Markov chains (unless stated); exact: ten times as long,"
        " over every row",
    )
    spent.add_argument("--budget", type=_seconds, metavar="SECONDS", help="the best accuracy that fits; refused if none does")
    parser.add_argument("--rig", metavar="FILE", help="rig file (TOML): clock, limits and sensor of what the controller runs on")
    parser.add_argument("--seed", type=_seed, metavar="N", default=0, help="of the sampler (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print fit.json instead of the screen")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _seed(text: str) -> int:
    if not 0 <= (value := int(text)) < 2**32:
        raise argparse.ArgumentTypeError(f"found {text}, expected 0 to {2**32 - 1}")
    return value


def _effects(text: str) -> tuple[str, ...]:
    """`rotation,late`: those alone; `-late,-offset`: all but those; `none`."""
    from sysid.experiment import NUISANCES

    names = [] if text == "none" else [name.strip() for name in text.split(",")]
    if unknown := {name.removeprefix("-") for name in names} - set(NUISANCES):
        raise argparse.ArgumentTypeError(f"found {', '.join(sorted(unknown))}, expected some of {', '.join(NUISANCES)}, or none")
    out = {name[1:] for name in names if name.startswith("-")}
    if out and len(out) < len(names):
        raise argparse.ArgumentTypeError(f"found {text}, expected either those that are in or, with a minus, those that are out")
    return tuple(name for name in NUISANCES if (name not in out if out else name in names))


def _seconds(text: str) -> float:
    if not 0 < (value := float(text)) < math.inf:
        raise argparse.ArgumentTypeError(f"found {text}, expected seconds above 0")
    return value


_number.__name__, _seed.__name__, _seconds.__name__ = "temperature", "seed", "time"  # argparse says: invalid temperature value


def _identify(arguments: argparse.Namespace) -> int:
    from sysid.clock import Budget, BudgetError, Stages

    begun, stages = time.perf_counter(), Stages()
    try:
        with Budget(arguments.budget, begun, stages, _cache() / "seconds.json") as budget:
            return _run(arguments, stages, budget)
    except BudgetError as error:
        return _refuse(f"--budget: {error}")


def _run(arguments: argparse.Namespace, stages: "Stages", budget: "Budget") -> int:
    from sysid import outputs
    from sysid.log import LogError, read_logs

    folder = Path(arguments.folder)
    try:
        outputs.check_writable(folder)
    except OSError as error:
        return _refuse(f"{folder}: cannot be written: {error}")
    try:
        with stages("read", "reading the logs"):
            logs = read_logs(arguments.logs, arguments.columns)
    except LogError as error:
        return _refuse(str(error), error.mapping)
    try:
        rig = _rig(arguments.rig, logs[0].drive_unit)
    except ValueError as error:
        return _refuse(str(error))
    posterior, drawn = _posterior(logs, arguments, stages, budget)
    loop, warnings = _design(posterior, rig)
    try:
        content, text = _write(posterior, loop, warnings, drawn, arguments.advise, folder, stages, budget)
    except OSError as error:
        return _refuse(f"{folder}: cannot be written: {error}")
    budget.remember()
    _say(content, text, posterior, folder, arguments.json)
    return 0 if content["result"] == "successful" else 1


def _check(arguments: argparse.Namespace) -> int:
    """Whether a closed loop does what its controller.json predicts: 0 or 1; 2 when one of them cannot be read."""
    import json

    from controller.check import check
    from sysid import outputs
    from sysid.log import LogError, read_logs
    from sysid.report.screen import findings

    path = Path(arguments.folder) / outputs.CONTROLLER
    try:
        predicted = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(predicted, dict) or predicted.get("schema") != outputs.SCHEMA or "promise" not in predicted:
            return _refuse(f"{path}: found no controller of schema {outputs.SCHEMA}; identify writes it")
        found = check(predicted, read_logs([arguments.check], arguments.columns)[0])
    except LogError as error:
        return _refuse(str(error), error.mapping)
    except (OSError, ValueError) as error:
        return _refuse(f"{path}: cannot be read: {error}; identify writes it")
    if arguments.json:
        sys.stdout.write(outputs.to_json({"kept": all(f.kept for f in found), "findings": [f._asdict() for f in found]}))
    else:
        findings(found, sys.stdout)
    return 0 if all(f.kept for f in found) else 1


def _posterior(logs: list, arguments: argparse.Namespace, stages: "Stages", budget: "Budget") -> tuple[Any, dict[str, bytes]]:
    """The posterior, and the figures of the logs: the compiled density leaves the interpreter free to draw beside it."""
    with ThreadPoolExecutor(1) as beside:
        with stages("load", "starting"):
            _keep_programs()
            from sysid.fitting import fit
            from sysid.posterior import sample
        if not (budget.seconds or arguments.accuracy == NAMES[0]):
            beside.submit(budget.load_chains)
        with stages("fit", "fitting the plant"):
            given = {} if arguments.effects is None else {"nuisances": arguments.effects}
            fitted = fit(logs, reference_temperature=arguments.reference_temperature, **given)
        with stages("sample", "sampling the posterior"):
            drawing = beside.submit(_draw, fitted)
            return sample(fitted, arguments.seed, arguments.accuracy, budget.left, budget.starting), drawing.result()


def _draw(fitted: Any) -> dict[str, bytes]:
    from sysid.report.plots import log_figures

    return log_figures(fitted)


def _keep_programs() -> None:
    """Keep compiled programs between runs: the first run's compilation costs more than all of its arithmetic."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    from sysid.precision import keep_programs

    keep_programs(_cache())


def _cache() -> Path:
    """The user's folder for what a later run saves time with."""
    from platformdirs import user_cache_path

    return user_cache_path("sysid")


def _rig(path: str | None, drive_unit: str) -> Any:
    """The rig of a file, None without one. Raises RigError."""
    if path is None:
        return None
    from controller import Rig

    return Rig.from_toml(path, drive_unit)


def _design(posterior: Any, rig: Any) -> tuple[Any, list[str]]:
    """The controller, None when there is none, and all warnings."""
    import controller

    warnings = list(posterior.fit.warnings)
    if posterior.result.value != "successful":
        return None, warnings
    try:
        return controller.design(posterior, rig=rig), warnings
    except ValueError as error:  # no drive was recorded, or the rig cannot do it
        return None, [*warnings, str(error)]


def _write(
    posterior: Any,
    loop: Any,
    warnings: list[str],
    drawn: dict[str, bytes],
    wanted: str | None,
    folder: Path,
    stages: "Stages",
    budget: "Budget",
) -> tuple[dict, str]:
    """Write the set into `folder`; returns the content of fit.json and its text."""
    import controller
    from sysid import outputs
    from sysid.bench import nuisances
    from sysid.bill import bill
    from sysid.comparison import compare
    from sysid.planning import advise
    from sysid.report import html

    with stages("compare", "comparing descriptions"):
        compared = compare(posterior.fit) if posterior.fit.result.bounded else ()
        added = nuisances(posterior.fit)
        advice = None if wanted is None else advise(posterior.fit, wanted)
    content = outputs.document(posterior, loop and controller.as_dict(loop), warnings, compared, added, advice)
    with outputs.staging(folder) as fresh:
        budget.fresh = fresh
        with stages("report", "writing the report"):
            outputs.write_draws(posterior, fresh / outputs.DRAWS)
            (fresh / outputs.REPORT).write_text(html.render(content, posterior, drawn), encoding="utf-8", newline="\n")
        if loop is not None:
            (fresh / outputs.CONTROLLER).write_text(outputs.to_json(content["controller"]), encoding="ascii", newline="\n")
            controller.export_c(loop, fresh / outputs.HEADER)
        content |= {"files": outputs.digests(fresh), "cost": bill(posterior, budget)}
        text = outputs.to_json(content)
        (fresh / outputs.FIT).write_text(text, encoding="ascii", newline="\n")
        budget.keep()
        outputs.place(fresh, folder)
    return content, text


def _say(content: dict, text: str, posterior: Any, folder: Path, as_json: bool) -> None:
    from sysid.report.text import clean, derived

    for warning in content["warnings"]:
        print(f"warning: {clean(warning)}", file=sys.stderr)
    if as_json:
        sys.stdout.write(text)
        return
    from sysid.report.screen import show

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that has no ± gets a question mark
    show(content, derived(posterior.draws, content["parameters"]), folder, sys.stdout)


def _refuse(message: str, mapping: str | None = None) -> int:
    from sysid.report.text import clean

    print(f"identify: {clean(message)}", file=sys.stderr)
    if mapping:
        print("\nSave the following as map.toml, complete it, and run: identify --columns map.toml LOGS\n", file=sys.stderr)
        print(clean(mapping), file=sys.stderr)
    return 2
