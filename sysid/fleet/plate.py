"""One plate as one row: its logs read and fitted, as a tree of plain values that any process may send to
another."""

import hashlib
import re
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from sysid.fleet.groups import Given, Group, alike
from sysid.fleet.settings import Settings
from sysid.tables.textfile import LogError

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.posterior import Posterior

# How a plate's row may end beside the results of a fit.
UNREADABLE, FAILED, DIED = "the logs cannot be read", "the program failed", "the fit ended its process twice"
# the ways of a plate: fitted by `sysid.fit` by itself, or with those that are recorded alike
BY_FIT, BY_BATCH = "fit", "batch"
# noise for which a plate is fitted by itself
NOISES = (
    "noise that rows share",
    "outliers",
    "noise of the channels that differs",
    "noise in proportion to the response",
    "time stamps that scatter",
    "noise of the phase",
)
TRACED, POINTS = 3, 40  # logs of a plate, and rows of each, that its small picture shows
DIGITS = 1000  # of the largest value, to which it shows them
Row = dict[str, Any]


def row_of(group: Group, settings: Settings, logs: "Sequence[Log] | None" = None, why: str = "") -> Row:
    """The row of one plate by `sysid.fit`, which it goes through for the reason `why`; `logs`: as they are
    read, if they are. Whatever is wrong with its logs, or with the program, is told in the row; OSError where
    its own folder cannot be written."""
    begun = time.perf_counter()
    row = blank(group, settings, why=why)
    try:
        if group.refused:
            raise LogError(group.refused)
        from sysid.fitting import fit
        from sysid.posterior.posterior import sample

        logs = logs or read(group.logs, settings.columns)
        posterior = sample(fit(logs, **settings.given), settings.seed, settings.accuracy)
        row |= _told(posterior)
        if settings.full is not None:
            from sysid.command.sets import save_whole

            save_whole(posterior, folder_of(group.plate, settings.full))
    except LogError as error:
        row |= {"result": UNREADABLE, "error": str(error)}
    except OSError:
        raise
    except Exception as error:  # of one plate in a thousand, which must not take the others along
        where = traceback.extract_tb(error.__traceback__)[-1]
        said = f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
        row |= {"result": FAILED, "error": " ".join(said.split())}
    return row | {"seconds": round(time.perf_counter() - begun, 4)}


def blank(
    group: Group, settings: Settings, way: str = BY_FIT, why: str = "", read: "Sequence[Log]" = ()
) -> Row:
    """The row of a plate of which nothing is known yet but its logs, and the way that it goes; `read`: its
    logs, by which the bytes of their files are known already, unless each is made of several."""
    known = {log.path: log.sha256 for log in read} if settings.columns is None else {}
    logs = [{"name": _name(item), "sha256": known.get(str(item)) or digest(item)} for item in group.logs]
    row: Row = {"plate": group.plate, "settings": settings.digest, "logs": logs}
    return row | {"way": way, "way_why": why, "seconds": 0.0}


def dead(group: Group, settings: Settings) -> Row:
    """The row of a plate whose fit killed its process."""
    said = "its process was killed, by a lack of memory or a library, and twice more as it was fitted alone"
    return blank(group, settings) | {"result": DIED, "error": said}


def digest(item: Given) -> str:
    """sha256 of a file's bytes, or of all that a Log holds; "" of a file that cannot be read."""
    from sysid.logs.log import Log

    if not isinstance(item, Log):
        try:
            with open(item, "rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError:
            return ""
    found = hashlib.sha256()
    for name, value in sorted(vars(item).items()):
        told = value.tobytes() if hasattr(value, "tobytes") else repr(value).encode()
        found.update(name.encode() + b"\0" + told)
    return found.hexdigest()


def folder_of(plate: str, root: str | Path) -> Path:
    """Where a plate's own files go: its name with what a file's name cannot hold as %XX."""
    quoted = quote(plate, safe=" ()+,=@", errors="surrogateescape")  # by the bytes of a file's name
    return Path(root) / re.sub(r"^\.+", lambda dots: "%2E" * len(dots[0]), quoted)


def _name(item: Given) -> str:
    return str(getattr(item, "path", "") or getattr(item, "name", "")) if not isinstance(item, str) else item


def read(given: Sequence[Given], columns: str | None) -> "list[Log]":
    """The logs of one plate, in common units."""
    from sysid.logs.log import Log
    from sysid.logs.read import read_logs
    from sysid.logs.together import in_common_units, of_one_plate

    made = [item for item in given if isinstance(item, Log)]
    files = [item for item in given if not isinstance(item, Log)]
    if not made and not files:
        raise LogError("found no logs of this plate, expected at least one")
    if files and not made and columns is None:
        return alike.read([str(path) for path in files])
    read = read_logs(files, columns) if files else []
    return in_common_units(of_one_plate([*made, *read])) if made else read


def read_ahead(given: Sequence[Given]) -> None:
    """Parse the files of many plates together, before each plate's are `read`."""
    alike.ahead([str(item) for item in given if isinstance(item, str | Path)])


def _told(posterior: "Posterior") -> Row:
    """What a posterior says of its plate."""
    from sysid.command.outputs import finding, plain
    from sysid.posterior.change import covariance
    from sysid.verdict import wording

    fit, parameters = posterior.fit, posterior.summary()
    names, matrix = covariance(fit, parameters)
    return {
        "result": posterior.result.value,
        "parameters": {name: _parameter(p) for name, p in parameters.items()},
        "names": list(names),
        "covariance": matrix.tolist(),
        "reference_temperature_degC": fit.reference_temperature,
        "nrmse_percent": max(float(f.nrmse_percent) for f in fit.logs),
        "warnings": list(fit.warnings),
        "findings": [plain(finding(f)) for f in fit.findings],
        "notes": [*fit.notes, *wording.assumed(fit.assumed)],
        "traces": [
            {"name": f.log.name, **traces(f.log, f.kind, f.log.response[None], f.response[None])[0]}
            for f in fit.logs[:TRACED]
        ],
        "stated": stated([f.log for f in fit.logs]),
    }


def stated(logs: "Sequence[Log]") -> dict[str, str]:
    """The date and the serial number that logs state, the first that does."""
    found = {key.casefold(): value for log in reversed(logs) for key, value in log.metadata.items()}
    return {key: found[key] for key in ("date", "serial") if found.get(key)}


def traces(log: "Log", kind: str, recorded: np.ndarray, model: np.ndarray) -> list[Row]:
    """Of plates with the inputs of `log` their responses (P, n) beside the modelled ones as a few numbers:
    `x`, what they go by, and as `parts` d and q, or the amplitude, each recorded and modelled, in whole
    `digit`s."""
    swept = False
    x, label = np.arange(len(log), dtype=float), "row"
    if kind == "steady" and log.frequency is not None:
        x, label, swept = log.frequency, "Hz", bool(np.ptp(log.frequency) > 0)
    if not swept and log.time is not None:
        x, label = log.time - log.time[0], "s"
    order = np.argsort(x, kind="stable")
    keep = order[np.linspace(0, len(log) - 1, min(len(log), POINTS)).astype(int)]
    both = np.stack([recorded[:, keep], model[:, keep]], axis=1)
    parts = np.stack([np.real(both)] if log.amplitude_only else [np.real(both), np.imag(both)], axis=1)
    digit = np.maximum(np.max(np.abs(parts), axis=(1, 2, 3)), 1e-300) / DIGITS
    whole = np.rint(parts / digit[:, None, None, None]).astype(int).tolist()
    shared: Row = {"label": label, "unit": log.response_unit, "x": _rounded(x[keep])}
    return [shared | {"digit": d, "parts": p} for d, p in zip(digit.tolist(), whole, strict=True)]


def _rounded(values: np.ndarray) -> list[float]:
    """Numbers to a millionth of the largest."""
    places = 6 - int(np.ceil(np.log10(np.max(np.abs(values)) or 1.0)))
    return np.round(values, places).tolist()


def _parameter(p: Any) -> Row:
    low, high = p.ci95 or (None, None)
    row = {"value": p.value, "std": p.std, "ci95_low": low, "ci95_high": high, "unit": p.unit}
    return {k: v if v is None or isinstance(v, str) else float(v) for k, v in row.items()} | {
        "determined": bool(p.determined),
        "why": p.why,
    }
