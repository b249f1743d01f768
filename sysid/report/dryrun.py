"""What files were taken for, before anything is fitted: as data, and on the screen."""

from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
from rich.table import Table
from rich.text import Text

from sysid.columns.plan import Source
from sysid.logs.log import Log
from sysid.logs.taken import Taken
from sysid.report.screen import console_of, table_of
from sysid.report.text import clean
from sysid.tables.csvfile import LogError

UNTOLD = {
    "kind": "steady where its points dwell for four tau, else transient: the fit tells",
    "sampling": "not stated: instant, unless the fit tells that the points had settled",
}


def as_dict(files: Sequence[Taken], error: LogError | None, columns: str | None) -> dict[str, Any]:
    """What each file was taken for, by the mapping file `columns`, and whether all can be read together."""
    named = {log.metadata.get("plate") for file in files for log in file.logs} - {None}
    together = None if error is None else str(error)
    return {
        "readable": not (error or any(file.error for file in files)),
        "plate": min(named) if len(named) == 1 else None,
        "mapping": columns,
        "error": together,
        "files": [_file(file) for file in files],
    }


def show(told: Mapping[str, Any], file: IO[str]) -> None:
    """Print it: the verdict first, then each file."""
    console = console_of(file)
    console.print(_verdict(told))
    for one in told["files"]:
        console.print()
        console.print(Text(clean(_head(one)), style="bold" if one["error"] is None else "bold red"))
        if one["columns"]:
            console.print(_columns(one))
        console.print(_words(one, told["mapping"]))


def _file(file: Taken) -> dict[str, Any]:
    first = file.logs[0] if file.logs else None
    return {
        "path": file.path,
        "error": None if file.error is None else str(file.error),
        "logs": [_log(log) for log in file.logs],
        "columns": [_column(name, source, file.logs) for name, source in _sources(file).items()],
        "response": None if first is None else _response(file.logs),
        "unused": _unused(file),
        "metadata": dict(first.metadata if first else file.head.metadata if file.head else {}),
        "bench": dict(first.bench) if first else {},
        "notes": list(dict.fromkeys(note for log in file.logs for note in log.notes)),
        "warnings": list(dict.fromkeys(said for log in file.logs for said in log.warnings)),
    }


def _log(log: Log) -> dict[str, Any]:
    return {"name": log.name, "kind": log.kind, "sampling": log.sampling, "rows": len(log)}


def _sources(file: Taken) -> dict[str, Source]:
    return file.plan.sources if file.plan else {}


def _column(name: str, source: Source, logs: Sequence[Log]) -> dict[str, Any]:
    """Where one quantity comes from, how it is read, and between which values it lies, in the units used
    inside."""
    values, unit = _values(name, logs)
    found: dict[str, Any] = {
        "read_as": name,
        "column": source.label,
        "unit": source.unit,
        "amplitude": source.amplitude,
    }
    found |= {
        "scale": source.scale,
        "offset": source.offset,
        "constant": source.column is None and not source.counted,
    }
    return found | {"least": min(values, default=None), "most": max(values, default=None), "inside": unit}


def _values(name: str, logs: Sequence[Log]) -> tuple[list[float], str]:
    """The least and the largest values of an input in each log, and their unit; none of what is no input."""
    inputs = {"time": "s", "frequency": "Hz", "temperature": "degC", "force": "N"}
    field = name if name in inputs else "drive"
    unit = inputs.get(name) or (logs[0].drive_unit if logs else "")
    if field == "drive" and name not in ("voltage", "drive", "duty"):
        return [], ""
    arrays = [array for log in logs if (array := getattr(log, field)) is not None]
    return [float(end(array)) for array in arrays for end in (np.min, np.max)], unit


def _response(logs: Sequence[Log]) -> dict[str, Any]:
    """What the response is after all, and its size."""
    sizes = [np.abs(log.response) for log in logs]
    what = "amplitude W" if logs[0].amplitude_only else "Wd + j Wq"
    ends = {
        "least": float(min(size.min() for size in sizes)),
        "most": float(max(size.max() for size in sizes)),
    }
    return {"what": what, "unit": logs[0].response_unit, **ends}


def _unused(file: Taken) -> list[str]:
    """The columns that are read as nothing."""
    if file.head is None or file.plan is None:
        return []
    read = {source.column for source in file.plan.sources.values()} | {file.plan.split}
    return [name or f"column {k}" for k, name in enumerate(file.head.names) if k not in read]


def _verdict(told: Mapping[str, Any]) -> Text:
    files = told["files"]
    bad = sum(one["error"] is not None for one in files)
    logs = sum(len(one["logs"]) for one in files)
    if bad:
        said = f"not readable: {bad} of {len(files)} file{'s' * (len(files) > 1)}"
    elif told["error"]:
        said = f"not readable together: {told['error']}"
    else:
        of = f" of plate {told['plate']}" if told["plate"] else ""
        said = f"readable: {logs} log{'s' * (logs > 1)}{of} in {len(files)} file{'s' * (len(files) > 1)}"
    return Text(clean(f"{said}; nothing was fitted"), style="bold green" if told["readable"] else "bold red")


def _head(one: Mapping[str, Any]) -> str:
    """A file and its logs, those of a kind together."""
    kinds: dict[str, list[int]] = {}
    for log in one["logs"]:
        kinds.setdefault(log["kind"] or "transient or steady", []).append(log["rows"])
    said = []
    for kind, rows in kinds.items():
        count = (
            f"{rows[0]} rows" if len(rows) == 1 else f"{len(rows)} logs of {min(rows)} to {max(rows)} rows"
        )
        said.append(f"{count}, {kind}")
    return f"{one['path']}: {'; '.join(said) or 'refused'}"


def _columns(one: Mapping[str, Any]) -> Table:
    table = table_of("read as", "from", "in", "values")
    for c in one["columns"]:
        unit = c["unit"] + ("" if c["amplitude"] == "peak" else f" {c['amplitude']}")
        unit += (f" * {c['scale']:g}" if c["scale"] != 1 else "") + (
            f" {c['offset']:+g}" if c["offset"] else ""
        )
        table.add_row(
            *(Text(clean(cell)) for cell in (c["read_as"], c["column"], unit, _range(c, c["inside"])))
        )
    if response := one["response"]:
        table.add_row("response", response["what"], "", f"|W| {_range(response, response['unit'])}")
    return table


def _range(of: Mapping[str, Any], unit: str) -> str:
    if of["least"] is None:
        return ""
    low, high = f"{of['least']:.6g}", f"{of['most']:.6g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def _words(one: Mapping[str, Any], mapping: str | None) -> Table:
    """What else is known of a file, a key a line."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    stated = one["metadata"] | {key: f"{value:g}" for key, value in one["bench"].items()}
    rows = [("error", one["error"])] if one["error"] else []
    rows += [("kind", UNTOLD["kind"])] if any(log["kind"] is None for log in one["logs"]) else []
    moving = [log["sampling"] for log in one["logs"] if log["kind"] != "steady"]
    rows += [("sampling", said or UNTOLD["sampling"]) for said in dict.fromkeys(moving)]
    rows += [("mapping", mapping)] if mapping else []
    rows += [("metadata", "\n".join(f"{key}: {value}" for key, value in stated.items()))] if stated else []
    rows += [("not used", ", ".join(one["unused"]))] if one["unused"] else []
    rows += [("warning", said) for said in one["warnings"]] + [("note", said) for said in one["notes"]]
    for key, text in rows:
        table.add_row(key, Text(clean(text)))
    return table
