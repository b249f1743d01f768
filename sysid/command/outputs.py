"""The files of a run: fit.json, the draws, and how a whole set takes the place of an older one."""

import hashlib
import io
import json
import math
import os
import platform
import signal
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.posterior.change import Change
    from sysid.posterior.foreseen import Advised, Raised
    from sysid.posterior.planning import Advice
    from sysid.posterior.posterior import Posterior
    from sysid.verdict.comparison import Comparison
    from sysid.verdict.finding import Finding
    from sysid.verdict.fitted import FittedLog
    from sysid.verdict.result import Parameter

SCHEMA = 1
PRIORS = {  # sysid/model/likelihood.py has the equations
    "G, tau": "flat in the logarithm",
    "f0, k_T, finger_damping, finger_detuning, rotation": "flat",
    "offset, feedthrough, slope, baseline, start": "normal about zero, ten times as wide as the log's"
    " largest response;"
    " narrower where the logs show their size",
    "delay": "normal about zero, as wide as one row, or as a radian of the carrier where that is longer",
    "noise": "flat in the logarithm of its level; its colour as estimated",
}
FIT, DRAWS, REPORT, KEPT = "fit.json", "posterior.nc", "report.html", "fit.npz"
ZOOMABLE = "report_zoomable.html"
CONTROLLER, HEADER, SOURCE, PLATE = "controller.json", "dq_pi.h", "dq_pi.c", "dq_pi_plate.h"
# As an older set goes out; a new one comes in the other way.
FILES = (FIT, CONTROLLER, HEADER, SOURCE, PLATE, DRAWS, REPORT, ZOOMABLE, KEPT)
PACKAGES = ("sysid", "jax", "optimistix", "emcee", "numpy", "pandas")


def document(
    posterior: "Posterior",
    controller: Mapping[str, Any] | None,
    warnings: Sequence[str],
    compared: "Sequence[Comparison]" = (),
    added: "Sequence[Mapping[str, Parameter]]" = (),
    advice: "Advised | None" = None,
    change: "Change | None" = None,
) -> dict[str, Any]:
    """The content of fit.json, with what the bench `added` to each log, and where they were asked for
    `advice`, and the `change` from an older fit. `files` and `cost` are empty until the other files are
    written; `created` and `cost` alone differ from run to run."""
    from sysid.posterior.change import covariance, plate_of
    from sysid.report.text import derived, verdict
    from sysid.verdict import wording

    fit, plate = posterior.fit, plate_of(posterior.fit)
    parameters = {name: _parameter(p) for name, p in posterior.summary().items()}
    made, (names, matrix) = derived(posterior.draws, parameters), covariance(fit, parameters)
    content = {
        "schema": SCHEMA,
        "result": posterior.result.value,
        "usable": posterior.result.usable,
        "verdict": verdict(posterior.result.value, parameters, len(fit.logs), plate),
        "plate": plate,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "parameters": parameters,
        "derived": {name.replace(" ", "_"): p for name, p in made.items()} | _circuit(posterior),
        "covariance": {"names": names, "matrix": matrix.tolist()},
        "reference_temperature_degC": fit.reference_temperature,
        "uncertainty": _uncertainty(posterior),
        "warnings": list(warnings),
        "notes": [*fit.notes, *wording.assumed(fit.assumed)],
        "findings": [finding(f) for f in fit.findings],
        "logs": [
            _log(fitted, own) for fitted, own in zip(fit.logs, added or [{}] * len(fit.logs), strict=True)
        ],
        "models": _models(compared) if compared else None,
        "advice": None if advice is None else [_advice(a) for a in advice],
        "no_advice": advice.why if advice is not None and not advice else None,
        "change": None if change is None else _change(change),
        "controller": controller,
        "files": {},
        "seed": posterior.seed,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
        "cost": {},
    }
    return plain(content)


def _circuit(posterior: "Posterior") -> dict[str, Any]:
    """The equivalent circuit, where the logs show one."""
    from sysid.posterior.circuit import circuit

    found = circuit(posterior.fit, posterior.draws, posterior.summary(), posterior.seed)
    if found is None:
        return {}
    told: dict[str, Any] = {"parameters": {name: _parameter(p) for name, p in found.parameters.items()}}
    told |= {"correlation": {"names": list(found.names), "matrix": found.correlation.tolist()}}
    return {"circuit": told | {"reference_ohm": found.reference, "device": found.device}}


def _uncertainty(posterior: "Posterior") -> dict[str, Any]:
    """How the posterior was had, and the numerical error of each estimate, in its unit; of the rungs, in
    standard deviations."""
    from sysid.command.bill import ladder

    errors = {
        n: {"value": e.value, "std": e.std, "ci95": [e.low, e.high]} for n, e in posterior.errors.items()
    }
    rungs = [
        {"accuracy": p.accuracy, "evaluations": p.evaluations, "error": p.error, "moved": p.moved}
        for p in ladder(posterior)
    ]
    how = {
        "accuracy": posterior.accuracy,
        "method": posterior.method,
        "ess": posterior.ess,
        "rhat": posterior.rhat,
    }
    how["convergence"] = {n: c._asdict() for n, c in posterior.convergence.items()}
    stated = {n: f"normal about {value:g}, {std:g} wide" for n, (value, std) in posterior.fit.priors.items()}
    return how | {"numerical_error": errors, "rungs": rungs, "priors": PRIORS | stated}


def to_json(content: Mapping[str, Any]) -> str:
    """JSON text, ASCII, that any strict reader takes: what is not finite is null."""
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def _parameter(p: "Parameter") -> dict[str, Any]:
    shown = {
        "value": p.value,
        "std": p.std,
        "ci95": p.ci95,
        "unit": p.unit,
        "determined": p.determined,
        "why": p.why,
    }
    return shown | ({"modes": list(p.modes)} if p.modes else {})


def finding(f: "Finding") -> dict[str, Any]:
    """A finding as it stands in fit.json."""
    numbers = {name: x._asdict() for name, x in f.numbers.items()}
    found = {
        "key": f.key,
        "outcome": f.outcome,
        "logs": list(f.logs),
        "numbers": numbers,
        "evidence": f.evidence,
    }
    return found | {"moves": f.moves, "sentence": f.sentence}


def _log(fitted: "FittedLog", own: "Mapping[str, Parameter]") -> dict[str, Any]:
    log = fitted.log
    return {
        "path": log.path,
        "sha256": log.sha256,
        "kind": fitted.kind,
        "rows": len(log),
        "nrmse_percent": fitted.nrmse_percent,
        "name": log.name,
        "description": fitted.description,
        "response_unit": log.response_unit,
        "noise": fitted.noise,
        "noise_std": fitted.noise_std,
        # Without time the correlation is known in rows, which are no seconds.
        "noise_time_s": None if log.time is None and fitted.noise_time else fitted.noise_time,
        "parameters": {name: _parameter(p) for name, p in own.items()},
        "notes": log.notes,
    }


def _models(compared: "Sequence[Comparison]") -> dict[str, Any]:
    """Descriptions of the logs that leave something out of the fit's, and what the logs say of them in one
    line."""
    from sysid.verdict.comparison import verdict

    rows = [
        {
            "description": c.description,
            "elpd_difference": c.difference,
            "elpd_error": c.error,
            "moves": c.moves,
            "worse": c.worse,
        }
        for c in compared
    ]
    return {"verdict": verdict(compared), "compared": rows}


def _advice(a: "Advice | Raised") -> dict[str, Any]:
    """An experiment to record next, as numbers and as a sentence."""
    from sysid.posterior.planning import Advice

    e = a.experiment
    experiment = {
        "kind": e.kind,
        "drive": e.drive,
        "drive_unit": e.unit,
        "frequency_Hz": e.frequency,
        "rows": e.rows,
    }
    experiment |= {"temperature_degC": e.temperature, "record_s": e.record}
    if isinstance(a, Advice):
        found = {"parameter": a.parameter, "std_before": a.before, "std_after": a.after, "unit": a.unit}
        found |= {"std_after_between": a.between}
    else:
        found = {
            "promise": a.parameter,
            "before": a.before,
            "after": a.after,
            "exactly_known": a.best,
            "unit": a.unit,
        }
    return {"sentence": str(a), **found, "seconds": a.seconds, "experiment": experiment}


def _change(change: "Change") -> dict[str, Any]:
    """How far the plate is from an older fit's."""
    rows = {
        name: {
            "old": d.old,
            "new": d.new,
            "change": d.change,
            "std": d.std,
            "sigmas": d.sigmas,
            "p": d.p,
            "unit": d.unit,
        }
        for name, d in change.parameters.items()
    }
    told = {
        "sentence": str(change),
        "changed": change.changed,
        "chi_square": change.chi_square,
        "p": change.p,
    }
    return told | {"parameters": rows, "left_out": change.left_out, "notes": list(change.notes)}


def plain(value: Any) -> Any:
    """Dicts, lists, strings, numbers; None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    return float(value) if math.isfinite(value) else None


def write_draws(posterior: "Posterior", path: Path) -> None:
    """The draws as NetCDF4, group "posterior", dimensions (chain, draw): `arviz.from_netcdf(path)` opens
    it."""
    import h5netcdf
    import numpy as np

    chains, count = next(iter(posterior.draws.values())).shape
    whole = (
        io.BytesIO()
    )  # a disk that is full is an OSError of ours, and none within a library that then cannot close its file
    with h5netcdf.File(whole, "w") as file:
        group = file.create_group("posterior")
        group.dimensions = {"chain": chains, "draw": count}
        for name in ("chain", "draw"):
            group.create_variable(name, (name,), data=np.arange(len(group.dimensions[name])))
        for name, draws in posterior.draws.items():
            variable = group.create_variable(name, ("chain", "draw"), data=np.asarray(draws, np.float64))
            variable.attrs["units"] = posterior.fit.units.get(name, "1")
    path.write_bytes(whole.getvalue())


def check_writable(folder: Path) -> None:
    """Raise OSError when a set could not be placed in `folder`; leaves nothing behind."""
    _refuse_directories(folder)
    with staging(folder):
        pass


def _refuse_directories(folder: Path) -> None:
    for name in FILES:
        if (folder / name).is_dir():
            raise IsADirectoryError(f"{folder / name} is a directory, expected a file or nothing")


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """A fresh directory on the file system of `folder`, removed in every case. Raises OSError."""
    ground = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not ground.is_dir():
        raise NotADirectoryError(f"{ground} is a file, expected a directory or nothing")
    with tempfile.TemporaryDirectory(prefix=".identify-", dir=ground, ignore_cleanup_errors=True) as fresh:
        yield Path(fresh)


def add(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put files into `folder`, beside what is there, each as a whole. Raises OSError."""
    with staging(folder) as fresh:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (fresh / name).write_bytes(content)
            os.replace(fresh / name, folder / name)


def digests(folder: Path) -> dict[str, str]:
    """sha256 of every file in a folder, by name."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def place(fresh: Path, folder: Path) -> None:
    """Put the files of `fresh` in the place of an older set in `folder`. Raises OSError, and the older set
    stands as it was.

    fit.json goes out first and comes in last, so that it stands beside the files of its own run and no
    others, whenever the process is killed; older controller files go out next. Of two runs that end at once
    one waits. Ctrl-C waits too.
    """
    main = threading.current_thread() is threading.main_thread()  # no other is interrupted
    with _uninterrupted() if main else nullcontext():
        for path in fresh.iterdir():
            _sync(path)
        folder.mkdir(parents=True, exist_ok=True)
        older = fresh / "older"
        older.mkdir()
        with _alone(folder):
            _refuse_directories(folder)
            moves = [(folder / name, older / name) for name in FILES if (folder / name).exists()]
            moves += [(fresh / name, folder / name) for name in reversed(FILES) if (fresh / name).exists()]
            _move(moves)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _move(moves: Sequence[tuple[Path, Path]]) -> None:
    """Rename all or none, in this order."""
    for done, (source, target) in enumerate(moves):
        try:
            os.replace(source, target)
        except OSError:
            for moved, back in reversed(moves[:done]):
                os.replace(back, moved)
            raise


def _sync(path: Path) -> None:
    """Have the content on the disk before its name: after a power cut a file that is there is whole."""
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other process is within this block for the folder, where the system can lock one; a
    killed one lets go."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network file systems know no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
