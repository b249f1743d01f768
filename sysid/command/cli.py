"""The command `identify`: reads logs, fits, samples, designs the controller, writes the files, prints one
screen.

Exit codes: 0 identified; 1 not converged, not described or not determined; 2 bad usage or unreadable input;
130 interrupted; 70 a defect of the program itself.
"""

import argparse
import gc
import io
import os
import sys
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.command.arguments import arguments_of
from sysid.command.refusal import offer, refuse
from sysid.kept import user_cache
from sysid.posterior.accuracy import NAMES
from sysid.shell import called, reader

if TYPE_CHECKING:
    from sysid.command.clock import Budget, Stages
    from sysid.posterior.foreseen import Advised
    from sysid.report.canvas import Drawn


LATER = (
    *("sysid.report.plots", "controller", "sysid.report.html", "jinja2", "h5netcdf"),
    *("sysid.verdict.comparison", "sysid.report.screen"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    # Matrices are small here: on a busy machine threads that wait for one another take fifty times as long as
    # one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = arguments_of(argv)
    arguments.alone = argv is None  # the process is the command's own
    works = {"check": _check, "dry_run": _dry_run, "cost_curve": _cost_curve}
    work = next((work for name, work in works.items() if getattr(arguments, name)), _identify)
    collects = gc.isenabled()
    # what the libraries leave on loading is searched for cycles again and again: a twentieth of a run's time
    gc.disable()
    try:
        return work(arguments)
    except KeyboardInterrupt:
        print(f"{called('identify')}: interrupted", file=sys.stderr)
        return 130
    except Exception:  # a defect of the program is none of the results that exit 1 stands for
        traceback.print_exc()
        return 70
    finally:
        gc.freeze()  # or the interpreter would search all of it once more on its way out: half a second
        if collects:
            gc.enable()


def _identify(arguments: argparse.Namespace) -> int:
    from sysid.command.clock import Budget, BudgetError, Stages

    started = time.process_time() if arguments.alone else 0.0  # what the interpreter took to come here
    begun, stages = time.perf_counter() - started, Stages()
    try:
        with Budget(arguments.budget, begun, stages, user_cache() / "seconds.json") as budget:
            return _run(arguments, stages, budget)
    except BudgetError as error:
        return refuse(f"--budget: {error}")


def _run(arguments: argparse.Namespace, stages: "Stages", budget: "Budget") -> int:
    from sysid.command import outputs
    from sysid.tables.textfile import LogError

    folder = Path(arguments.folder)
    try:
        outputs.check_writable(folder)
    except OSError as error:
        return refuse(f"{folder}: cannot be written: {error}")
    if arguments.zoomable and find_spec("plotly") is None:
        return refuse("--zoomable: found no plotly, expected it installed: pip install 'sysid[zoom]'")
    try:
        with stages("read", "reading the logs"):
            from sysid.logs.read import read_logs

            logs = read_logs(arguments.logs, arguments.columns)
    except LogError as error:
        return refuse(str(error), error.mapping)
    try:
        rig = _rig(arguments.rig, logs[0].drive_unit, logs[0].response_unit)
    except ValueError as error:
        return refuse(str(error))
    try:
        older = _older(arguments.compare)
    except ValueError as error:
        return refuse(f"--compare: {error}")
    posterior, drawn = _posterior(logs, arguments, stages, budget)
    try:
        change = _change(posterior, older)
    except ValueError as error:
        return refuse(f"--compare: {arguments.compare}: {error}")
    with stages("design", "designing the controller"):
        loop, warnings = _design(posterior, rig)
    try:
        content, text = _write(
            posterior, loop, warnings, drawn, (arguments, rig, change), folder, stages, budget
        )
    except OSError as error:
        return refuse(f"{folder}: cannot be written: {error}")
    budget.remember()
    with reader():
        _say(content, text, posterior, folder, arguments.json)
    return 0 if content["result"] == "successful" else 1


def _check(arguments: argparse.Namespace) -> int:
    from sysid.command.check import judge

    return judge(arguments.check, arguments.folder, arguments.columns, arguments.json, "identify")


def _dry_run(arguments: argparse.Namespace) -> int:
    """Say what each file is taken for: 0; 2 when one, or all of them together, cannot be read."""
    from sysid.command import outputs
    from sysid.logs.log import LogError
    from sysid.logs.taken import taken
    from sysid.report import dryrun

    try:
        files, apart = taken(arguments.logs, arguments.columns)
    except LogError as error:
        return refuse(str(error), error.mapping)
    told = dryrun.as_dict(files, apart, arguments.columns)
    with reader():
        if arguments.json:
            sys.stdout.write(outputs.to_json(told))
        else:
            dryrun.show(told, sys.stdout)
    for draft in dict.fromkeys(file.error.mapping for file in files if file.error and file.error.mapping):
        offer(draft)
    return 0 if told["readable"] else 2


def _cost_curve(arguments: argparse.Namespace) -> int:
    """Measure what each accuracy costs on these logs: 0; 1 when there is no posterior to approach; 2 when
    they cannot be read."""
    from sysid.command import outputs
    from sysid.command.costcurve import CostCurve, measure, table
    from sysid.logs.log import LogError
    from sysid.logs.read import read_logs
    from sysid.report.text import advice

    folder = Path(arguments.folder)
    try:
        outputs.check_writable(folder)
        found = measure(
            lambda: read_logs(arguments.logs, arguments.columns), _settings(arguments), arguments.seed
        )
        if not isinstance(found, CostCurve):
            said = f"{found.result.value}: {advice(found.result.value, len(found.fit.logs))}"
            print(f"{called('identify')}: {said}", file=sys.stderr)
            return 1
        from sysid.report import costs, screen

        text = outputs.to_json(found.as_dict())
        outputs.add(
            folder, {"cost_curve.json": text.encode(), "cost_curve.png": costs.curve_figure(found.points)}
        )
    except LogError as error:
        return refuse(str(error), error.mapping)
    except OSError as error:
        return refuse(f"{folder}: cannot be written: {error}")
    with reader():
        if arguments.json:
            sys.stdout.write(text)
        else:
            screen.rows(table(found.points), sys.stdout)
            print(f"errors in standard deviations; {folder}: cost_curve.json, cost_curve.png")
    return 0


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the fit is told."""
    given = {} if arguments.effects is None else {"nuisances": arguments.effects}
    return given | {
        "reference_temperature": arguments.reference_temperature,
        "priors": dict(arguments.prior or ()),
    }


def _posterior(
    logs: list, arguments: argparse.Namespace, stages: "Stages", budget: "Budget"
) -> tuple[Any, "tuple[Drawn, ...]"]:
    """The posterior, and the figures of the logs, which are drawn beside it."""
    with ThreadPoolExecutor(1) as beside:
        with stages("load", "starting"):
            from sysid.fitting import fit
            from sysid.posterior.posterior import sample
            from sysid.precision import make_beside

            if arguments.alone:
                make_beside()
        if not (budget.seconds or arguments.accuracy == NAMES[0]):
            beside.submit(budget.load_chains, arguments.alone)
        for module in LATER:  # while compiled programs load and run, which leaves the interpreter idle
            beside.submit(import_module, module)
        with stages("fit", "fitting the plant"):
            fitted = fit(logs, **_settings(arguments))
        with stages("sample", "sampling the posterior"):
            drawing = beside.submit(_draw, fitted)
            return sample(
                fitted, arguments.seed, arguments.accuracy, budget.left, budget.starting
            ), drawing.result()


def _draw(fitted: Any) -> "tuple[Drawn, ...]":
    from sysid.report.plots import fit_figures

    return fit_figures(fitted)


def _rig(path: str | None, drive_unit: str, response_unit: str) -> Any:
    """The rig of a file, None without one. Raises RigError."""
    if path is None:
        return None
    from controller import Rig

    return Rig.from_toml(path, drive_unit, response_unit)


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
    drawn: "tuple[Drawn, ...]",
    wanted: tuple[argparse.Namespace, Any, Any],
    folder: Path,
    stages: "Stages",
    budget: "Budget",
) -> tuple[dict, str]:
    """Write the set into `folder`; returns the content of fit.json and its text. `wanted`: what is asked for,
    the rig, and the change from an older fit."""
    from sysid.command import outputs, sets
    from sysid.command.bill import bill

    with stages("compare", "comparing descriptions"):
        advice = _advised(posterior.fit, wanted[0].advise, wanted[1])
        content = sets.described(posterior, loop, warnings, advice, wanted[2])
    with outputs.staging(folder) as fresh:
        budget.fresh = fresh
        with stages("report", "writing the report"):
            sets.put(fresh, content, posterior, loop, drawn, wanted[0].zoomable)
        text = sets.finish(fresh, content, bill(posterior, budget))
        budget.keep()
        outputs.place(fresh, folder)
    return content, text


def _older(path: str | None) -> Any:
    """What an older fit tells; None where there is none to compare with. Raises ValueError."""
    if path is None:
        return None
    from sysid.posterior.change import Told

    return Told.of(path)


def _change(posterior: Any, older: Any) -> Any:
    """How far the plate is from the older fit's; None where there is none. Raises ValueError."""
    if older is None:
        return None
    from sysid.posterior.change import compare_fits

    return compare_fits(posterior, older)


def _advised(fit: Any, wanted: str | None, rig: Any) -> "Advised | None":
    """What to record next; None where it was not asked for."""
    if wanted is None:
        return None
    import controller
    from sysid.posterior.foreseen import Advised
    from sysid.posterior.planning import advise

    try:
        return advise(fit, wanted, design=partial(controller.design, rig=rig))
    except ValueError as error:  # no drive is recorded, or the rig cannot do it
        return Advised.none(str(error))


def _say(content: dict, text: str, posterior: Any, folder: Path, as_json: bool) -> None:
    from sysid.report.text import clean, derived
    from sysid.verdict.finding import entry

    for warning in content["warnings"]:
        print("warning:", *clean(warning).split("\n"), file=sys.stderr)  # one line each
    if entries := dict.fromkeys(entry(finding["key"]) for finding in content["findings"]):
        print("see", ", ".join(entries), file=sys.stderr)
    if as_json:
        sys.stdout.write(text)
        return
    from sysid.report.screen import show

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that has no ± gets a question mark
    show(content, derived(posterior.draws, content["parameters"]), folder, sys.stdout)
