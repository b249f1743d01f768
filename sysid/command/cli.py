"""The command `identify`: reads logs, fits, samples, designs the controller, writes the files, prints one screen.

Exit codes: 0 identified; 1 not converged, not described or not determined; 2 bad usage or unreadable input; 130 interrupted;
70 a defect of the program itself.
"""

import argparse
import gc
import io
import os
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.command.arguments import arguments_of
from sysid.kept import user_cache
from sysid.posterior.accuracy import NAMES

if TYPE_CHECKING:
    from sysid.command.clock import Budget, Stages


LATER = (
    *("sysid.report.plots", "controller", "sysid.report.html", "jinja2", "h5netcdf"),
    *("sysid.verdict.comparison", "sysid.report.screen"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    # Matrices are small here: on a busy machine threads that wait for one another take fifty times as long as one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = arguments_of(argv)
    arguments.alone = argv is None  # the process is the command's own
    work = _check if arguments.check else _cost_curve if arguments.cost_curve else _identify
    collects = gc.isenabled()
    gc.disable()  # what the libraries leave on loading is searched for cycles again and again: a twentieth of a run's time
    try:
        return work(arguments)
    except KeyboardInterrupt:
        print("identify: interrupted", file=sys.stderr)
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
        return _refuse(f"--budget: {error}")


def _run(arguments: argparse.Namespace, stages: "Stages", budget: "Budget") -> int:
    from sysid.command import outputs
    from sysid.logs.textfile import LogError

    folder = Path(arguments.folder)
    try:
        outputs.check_writable(folder)
    except OSError as error:
        return _refuse(f"{folder}: cannot be written: {error}")
    try:
        with stages("read", "reading the logs"):
            from sysid.logs.log import read_logs

            logs = read_logs(arguments.logs, arguments.columns)
    except LogError as error:
        return _refuse(str(error), error.mapping)
    try:
        rig = _rig(arguments.rig, logs[0].drive_unit, logs[0].response_unit)
    except ValueError as error:
        return _refuse(str(error))
    posterior, drawn = _posterior(logs, arguments, stages, budget)
    with stages("design", "designing the controller"):
        loop, warnings = _design(posterior, rig)
    try:
        content, text = _write(posterior, loop, warnings, drawn, (arguments.advise, rig), folder, stages, budget)
    except OSError as error:
        return _refuse(f"{folder}: cannot be written: {error}")
    budget.remember()
    with _reader():
        _say(content, text, posterior, folder, arguments.json)
    return 0 if content["result"] == "successful" else 1


def _check(arguments: argparse.Namespace) -> int:
    """Whether a closed loop does what its controller.json predicts: 0 or 1; 2 when one of them cannot be read."""
    import json

    from controller.check import check
    from sysid.command import outputs
    from sysid.logs.log import LogError, read_logs
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
    with _reader():
        if arguments.json:
            sys.stdout.write(outputs.to_json({"kept": all(f.kept for f in found), "findings": [f._asdict() for f in found]}))
        else:
            findings(found, sys.stdout)
    return 0 if all(f.kept for f in found) else 1


def _cost_curve(arguments: argparse.Namespace) -> int:
    """Measure what each accuracy costs on these logs: 0; 1 when there is no posterior to approach; 2 when they cannot be read."""
    from sysid.command import outputs
    from sysid.command.costcurve import CostCurve, measure, table
    from sysid.logs.log import LogError, read_logs
    from sysid.report.text import advice

    folder = Path(arguments.folder)
    try:
        outputs.check_writable(folder)
        found = measure(lambda: read_logs(arguments.logs, arguments.columns), _settings(arguments), arguments.seed)
        if not isinstance(found, CostCurve):
            print(f"identify: {found.result.value}: {advice(found.result.value, len(found.fit.logs))}", file=sys.stderr)
            return 1
        from sysid.report import costs, screen

        text = outputs.to_json(found.as_dict())
        outputs.add(folder, {"cost_curve.json": text.encode(), "cost_curve.png": costs.curve_figure(found.points)})
    except LogError as error:
        return _refuse(str(error), error.mapping)
    except OSError as error:
        return _refuse(f"{folder}: cannot be written: {error}")
    with _reader():
        if arguments.json:
            sys.stdout.write(text)
        else:
            screen.rows(table(found.points), sys.stdout)
            print(f"errors in standard deviations; {folder}: cost_curve.json, cost_curve.png")
    return 0


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the fit is told."""
    given = {} if arguments.effects is None else {"nuisances": arguments.effects}
    return given | {"reference_temperature": arguments.reference_temperature, "priors": dict(arguments.prior or ())}


def _posterior(logs: list, arguments: argparse.Namespace, stages: "Stages", budget: "Budget") -> tuple[Any, dict[str, bytes]]:
    """The posterior, and the figures of the logs: the compiled density leaves the interpreter free to draw beside it."""
    with ThreadPoolExecutor(1) as beside:
        with stages("load", "starting"):
            from sysid.fitting import fit
            from sysid.posterior.posterior import sample
            from sysid.posterior.surrogate import prepare
            from sysid.precision import make_beside

            if arguments.alone:
                make_beside()
        if not (budget.seconds or arguments.accuracy == NAMES[0]):
            beside.submit(budget.load_chains, arguments.alone)
        for module in LATER:  # while compiled programs load and run, which leaves the interpreter idle
            beside.submit(import_module, module)
        with stages("fit", "fitting the plant"):
            fitted = fit(logs, **_settings(arguments), meanwhile=prepare)
        with stages("sample", "sampling the posterior"):
            drawing = beside.submit(_draw, fitted)
            return sample(fitted, arguments.seed, arguments.accuracy, budget.left, budget.starting), drawing.result()


def _draw(fitted: Any) -> dict[str, bytes]:
    from sysid.report.plots import log_figures

    return log_figures(fitted)


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
    drawn: dict[str, bytes],
    wanted: tuple[str | None, Any],
    folder: Path,
    stages: "Stages",
    budget: "Budget",
) -> tuple[dict, str]:
    """Write the set into `folder`; returns the content of fit.json and its text. `wanted`: what to advise on, and the rig."""
    import controller
    from sysid.command import outputs
    from sysid.command.bill import bill
    from sysid.report import html
    from sysid.verdict.bench import nuisances
    from sysid.verdict.comparison import compare

    with stages("compare", "comparing descriptions"):
        compared = compare(posterior.fit) if posterior.fit.result.bounded else ()
        added = nuisances(posterior.fit)
        advice = _advised(posterior.fit, *wanted)
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


def _advised(fit: Any, wanted: str | None, rig: Any) -> tuple | None:
    """What to record next; None where it was not asked for."""
    if wanted is None:
        return None
    import controller
    from sysid.posterior.planning import advise

    try:
        return advise(fit, wanted, design=partial(controller.design, rig=rig))
    except ValueError:  # no drive is recorded, or the rig cannot do it, which a warning says already
        return ()


def _say(content: dict, text: str, posterior: Any, folder: Path, as_json: bool) -> None:
    from sysid.report.text import clean, derived

    for warning in content["warnings"]:
        print("warning:", *clean(warning).split("\n"), file=sys.stderr)  # one line each
    if as_json:
        sys.stdout.write(text)
        return
    from sysid.report.screen import show

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that has no ± gets a question mark
    show(content, derived(posterior.draws, content["parameters"]), folder, sys.stdout)


@contextmanager
def _reader() -> Iterator[None]:
    """Around what is printed: a reader that has closed the pipe, as `head` does, has what it wanted, and changes no exit code."""
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit):  # rich makes the other of the one
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or what is left in the buffer fails on the way out


def _refuse(message: str, mapping: str | None = None) -> int:
    from sysid.report.text import clean

    print(f"identify: {clean(message)}", file=sys.stderr)
    if mapping:
        print("\nSave the following as map.toml, complete it, and run: identify --columns map.toml LOGS\n", file=sys.stderr)
        print(clean(mapping), file=sys.stderr)
    return 2
