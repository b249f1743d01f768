"""The one screen that a run prints."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import IO, Any

from rich.box import Box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sysid.report.text import (
    circuit_reasons,
    circuit_rows,
    clean,
    exactness,
    gains,
    grouped,
    mode,
    moved,
    number,
    row,
    shown,
    taken_for,
)

WIDTH = 80  # columns where the output is no terminal
ROOMY = 100  # columns, from which on a table of logs has room for their noise
UNDERLINED = Box("    \n    \n -- \n    \n    \n    \n    \n    \n", ascii=True)


def show(
    document: Mapping[str, Any], derived: Mapping[str, Mapping[str, Any]], folder: Path, file: IO[str]
) -> None:
    """Print what fit.json says (`document`), the verdict first, with the `derived` quantities and where the
    files are."""
    console = console_of(file)
    console.print(_verdict(document))
    console.print()
    console.print(_parameters(document, derived), "")
    if circuit := document["derived"].get("circuit"):
        console.print(_circuit(circuit), "")
    console.print(_logs(document["logs"], console.width), "")
    console.print(_sentences(document, folder))


def findings(found: Sequence[Any], file: IO[str]) -> None:
    """Print what a closed loop did beside what was predicted of it."""
    table = table_of("", "found", "expected", "")
    for f in found:
        said = Text("as predicted", style="green") if f.kept else Text(clean(f"no: {f.hint}"), style="red")
        table.add_row(*(Text(clean(cell)) for cell in (f.what, f.found, f.expected)), said)
    console_of(file).print(table)


def rows(cells: Sequence[Sequence[str]], file: IO[str], right: bool = True) -> None:
    """Print a table whose first row is its header; all columns but the first hold numbers, which end on the
    `right`."""
    table = table_of(*cells[0], right=tuple(cells[0][1:]) if right else ())
    for row_ in cells[1:]:
        table.add_row(*row_)
    console_of(file).print(table)


def console_of(file: IO[str]) -> Console:
    """Plain text, as wide as the terminal; WIDTH where there is none."""
    return Console(
        file=file, width=None if file.isatty() else WIDTH, markup=False, emoji=False, highlight=False
    )


def _verdict(document: Mapping[str, Any]) -> Text:
    """How the fit ended, in a sentence."""
    good = document["result"] == "successful"
    said = f"{document['result']}: {document['verdict']}" if good else document["verdict"]
    return Text(clean(said), style="bold green" if good else "bold red")


def _logs(logs: list[Mapping[str, Any]], width: int) -> Table:
    """What each log was taken for, and how well it is described; where the lines are wide enough, how noisy
    it is."""
    noisy = (f"noise {clean(logs[0]['response_unit'])}",) if width >= ROOMY else ()
    table = table_of("log", "kind", "rows", "taken for", "NRMSE", *noisy, right=("rows", "NRMSE"))
    table.columns[0].max_width = 30
    for log in logs:
        noise = number(log["noise_std"]) + ("" if log["noise"] == "white" else f", {log['noise']}")
        left = "" if log["nrmse_percent"] is None else f"{log['nrmse_percent']:.2f}%"
        cells = (
            log["name"],
            log["kind"],
            str(log["rows"]),
            taken_for(log),
            left,
            *([noise] if noisy else []),
        )
        table.add_row(*(Text(clean(cell)) for cell in cells))
    return table


def _parameters(document: Mapping[str, Any], derived: Mapping[str, Mapping[str, Any]]) -> Table:
    value = "value" if document["usable"] else "value, not to be used"
    table = table_of("parameter", value, "95 % interval", "unit")
    for name, parameter in shown(document).items():
        cells = row(parameter) if parameter["determined"] else ("not determined", "", parameter["unit"])
        table.add_row(name + _at(name, parameter, document), *(Text(clean(cell)) for cell in cells))
    for name, parameter in derived.items():
        table.add_row(name, *row(parameter))
    return table


def _circuit(circuit: Mapping[str, Any]) -> Table:
    """The equivalent circuit, in two halves side by side."""
    table = table_of("circuit", "value", "unit", "", "value", "unit")
    cells = [
        (name, value, unit if unit != "1" else "") for name, (value, _, unit) in circuit_rows(circuit).items()
    ]
    half = (len(cells) + 1) // 2
    for left, right in zip_longest(cells[:half], cells[half:], fillvalue=("", "", "")):
        table.add_row(*left, *right)
    return table


def _at(name: str, parameter: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    at = document["reference_temperature_degC"]
    return f" at {at:.4g} degC" if name == "f0" and parameter["determined"] and at is not None else ""


def _sentences(document: Mapping[str, Any], folder: Path) -> Table:
    """What is to be read in words: a key, and lines that hang beside it."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    lines = [*_reasons(document), *(("note", note) for note in grouped(document))]
    if circuit := document["derived"].get("circuit"):
        lines += [("circuit", line) for line in circuit_reasons(circuit)]
    if document["models"]:
        lines.append(("models", document["models"]["verdict"]))
    if document["advice"] is not None:
        said = [a["sentence"] for a in document["advice"][:3]] or [document["no_advice"]]
        lines.append(("next", "\n".join(said)))
    if document["change"] is not None:
        lines.append(("change", "\n".join([document["change"]["sentence"], *moved(document["change"])])))
    lines.append(
        (
            "gains",
            "\n".join(gains(document["controller"]))
            if document["controller"]
            else "no controller was designed",
        )
    )
    if cost := document["cost"]:
        lines.append(("cost", exactness(cost)))
    for key, text in lines:
        table.add_row(key, Text(clean(text)))
    table.add_row(
        "files", Text(f"{clean(str(folder))}: {', '.join([*sorted(document['files']), 'fit.json'])}")
    )
    return table


def _reasons(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Why parameters are not determined, and the separate values where there are several."""
    lines = []
    for name, parameter in document["parameters"].items():
        if not parameter["determined"]:
            modes = [f"{mode(m)} {parameter['unit']}" for m in parameter.get("modes", ())]
            lines.append((name, "\n".join([parameter["why"], *modes])))
    return lines


def table_of(*names: str, right: tuple[str, ...] = ()) -> Table:
    """A table without rows; the columns in `right` hold numbers."""
    table = Table(box=UNDERLINED, show_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    for name in names:
        table.add_column(name, justify="right" if name in right else "left", overflow="fold")
    return table
