"""The one screen that a run prints."""

from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from sysid.report.text import ADVICE, clean, gains, grouped, row, seconds

WIDTH = 100  # columns where the output is no terminal


def show(document: Mapping[str, Any], derived: Mapping[str, Mapping[str, Any]], folder: Path, file: IO[str]) -> None:
    """Print what fit.json says (`document`), with the `derived` quantities and where the files are."""
    console = Console(file=file, width=None if file.isatty() else WIDTH, markup=False, emoji=False, highlight=False)
    console.print(_logs(document["logs"]))
    console.print(_parameters(document, derived))
    console.print(Group(*map(_paragraph, _reasons(document) + _controller(document) + _notes(document))))
    console.print(_result(document["result"]))
    names = [*sorted(document["files"]), "fit.json"]
    console.print(_paragraph(f"files    {clean(str(folder))}: {', '.join(names)}"))


def _logs(logs: list[Mapping[str, Any]]) -> Table:
    table = _table("log", "kind", "rows", "taken for", "NRMSE %", "noise", right=("rows", "NRMSE %"))
    table.columns[0].overflow = table.columns[3].overflow = "fold"
    for log in logs:
        said = log["description"].removeprefix("transient").removeprefix("settled points").removeprefix(", ")
        noise = f"{log['noise_std']:.2g} {log['response_unit']}"
        noise += f", {seconds(log['noise_time_s'])}" if log["noise_time_s"] else ""
        cells = (log["name"], log["kind"], str(log["rows"]), said, f"{log['nrmse_percent']:.2f}", noise)
        table.add_row(*(Text(clean(cell)) for cell in cells))
    return table


def _parameters(document: Mapping[str, Any], derived: Mapping[str, Mapping[str, Any]]) -> Table:
    table = _table("parameter", "value", "95 % interval", "unit")
    for name, parameter in document["parameters"].items():
        cells = row(parameter) if parameter["determined"] else ("not determined", "", parameter["unit"])
        table.add_row(name + _at(name, parameter, document), *map(Text, cells))
    for name, parameter in derived.items():
        table.add_row(name, *row(parameter))
    return table


def _at(name: str, parameter: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    at = document["reference_temperature_degC"]
    return f" at {at:.4g} degC" if name == "f0" and parameter["determined"] and at is not None else ""


def _reasons(document: Mapping[str, Any]) -> list[str]:
    """Why parameters are not determined, and the separate values where there are several."""
    lines = []
    for name, parameter in document["parameters"].items():
        if not parameter["determined"]:
            lines.append(f"{name:<8} {parameter['why']}")
            for mode in parameter.get("modes", ()):
                said = row({**mode, "unit": parameter["unit"], "ci95": ()} | {"ci95": (mode["value"], mode["value"])})
                lines.append(f"         {said[0]} {said[2]}, weight {mode['weight']:.2g}")
    return lines


def _controller(document: Mapping[str, Any]) -> list[str]:
    if document["controller"] is None:
        return ["gains    none: no controller was designed"]
    first, *others = gains(document["controller"])
    return [f"gains    {first}", *(f"         {line}" for line in others)]


def _notes(document: Mapping[str, Any]) -> list[str]:
    return [f"note     {note}" for note in grouped(document["logs"])]


def _result(result: str) -> Padding:
    good = result == "successful"
    said = result if good else f"{result}: {ADVICE.get(result, 'see the warnings')}"
    return _paragraph(f"result   {said}", "bold green" if good else "bold red")


def _paragraph(text: str, style: str = "") -> Padding:
    """A line whose continuation stands under its ninth column."""
    return Padding(Text(clean(text), style=style), (0, 0, 0, 1))


def _table(*names: str, right: tuple[str, ...] = ()) -> Table:
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=True, padding=(0, 1))
    for name in names:
        table.add_column(name, justify="right" if name in right else "left", overflow="fold")
    return table
