"""Raw files of circuit simulators (ngspice, LTspice, Xyce): plots, each a header with its variables and then
their values, as text or as float64, of which LTspice writes all but the time as float32.

A plot whose first variable, its scale, begins anew holds runs, as of a stepped value, each a table."""

import os
import re
from typing import NamedTuple

import numpy as np

from sysid.tables.store import SHORTEST, Store
from sysid.tables.textfile import LogError

_VALUES = re.compile(rb"^(Values|Binary):[ \t]*\r?\n", re.MULTILINE)
_UNITS = {
    "time": "s",
    "frequency": "Hz",
    "voltage": "V",
    "current": "A",
    "device_current": "A",
    "subckt_current": "A",
    "temp-sweep": "degC",
}


class _Plot(NamedTuple):
    """What the header of a plot says: its name, whether its numbers are complex, its variables' names and
    units, and how many points it has."""

    name: str
    complex: bool
    names: tuple[str, ...]
    units: tuple[str, ...]
    points: int


def is_spice(first: bytes) -> bool:
    """Whether a file begins as these do."""
    text = first.replace(b"\x00", b"")
    return text.startswith(b"Title:") and b"\nPlotname:" in text and b"\nNo. Variables:" in text


def read_spice(path: str, kind: str) -> Store:
    """The contents of a raw file. Raises LogError where it is damaged."""
    store = Store(path, kind)
    store.claim("its bytes", os.path.getsize(path) // SHORTEST)
    store.claimed = 0
    with open(path, "rb") as file:
        rest = file.read()
    wide = rest.startswith(b"T\x00")  # UTF-16, the values below it aside
    while rest.strip(b"\x00\r\n "):
        text = rest.replace(b"\x00", b"") if wide else rest  # a byte a letter, up to the values
        if (found := _VALUES.search(text)) is None:
            raise LogError(f"{path}: found a plot without Values or Binary, expected its values")
        plot = _plot(path, text[: found.start()].decode("utf-8", errors="replace"))
        store.claim(f"plot {plot.name!r}", plot.points * len(plot.names))
        body = rest[found.end() * (1 + wide) :]
        values, rest = (_listed if found[1] == b"Values" else _packed)(path, plot, body)
        _enter(store, plot, values)
    return store


def _plot(path: str, header: str) -> _Plot:
    said, _, variables = header.partition("\nVariables:")
    stated = {
        key.strip().casefold(): value.strip()
        for key, _, value in (line.partition(":") for line in said.splitlines())
    }
    cells = [line.split() for line in variables.splitlines() if line.strip()]
    counts = [stated.get(key, "") for key in ("no. variables", "no. points")]
    if (
        not all(count.isdigit() for count in counts)
        or len(cells) != int(counts[0])
        or any(len(of) < 3 for of in cells)
    ):
        found = (
            f"found {len(cells)} variables where No. Variables says {counts[0]!r}, No. Points {counts[1]!r}"
        )
        raise LogError(f"{path}: {found}, expected as many, each with its number, name and kind")
    units = tuple(_UNITS.get(of[2].casefold(), "") for of in cells)
    name = re.sub(r"\W+", " ", stated.get("plotname", "")).strip()
    return _Plot(
        name,
        "complex" in stated.get("flags", "").split(),
        tuple(of[1] for of in cells),
        units,
        int(counts[1]),
    )


def _listed(path: str, plot: _Plot, body: bytes) -> tuple[np.ndarray, bytes]:
    """The values (points, variables) of a plot as text, each point's number before them, and what follows."""
    text, following, rest = body.partition(b"\nTitle:")
    cells = text.split()
    width = len(plot.names) + 1
    try:
        numbers = np.array([complex(*map(float, cell.split(b","))) for cell in cells])
    except (ValueError, TypeError):
        numbers = np.zeros(0)
    if (
        len(numbers) != plot.points * width
        or (numbers[::width] != np.arange(plot.points)).any()
        or text[-1:].strip()
    ):
        found = f"found {len(cells)} cells in the plot {plot.name!r}, expected {plot.points} points"
        raise LogError(
            f"{path}: {found} of a number and {width - 1} values; was the file written to its end?"
        )
    values = numbers.reshape(plot.points, width)[:, 1:]
    return values if plot.complex else values.real, following.lstrip() + rest


def _packed(path: str, plot: _Plot, body: bytes) -> tuple[np.ndarray, bytes]:
    """The values (points, variables) of a plot in binary, and what follows."""
    width, full = len(plot.names), np.dtype(np.complex128 if plot.complex else np.float64)
    forms = [np.dtype([("", full)] * width), np.dtype([("", np.float64)] + [("", np.float32)] * (width - 1))]
    sizes = [plot.points * form.itemsize for form in forms]
    ends = [body[size:].lstrip() for size in sizes]
    k = next((k for k in (0, 1) if len(body) >= sizes[k] and ends[k][:6] in (b"", b"Title:")), None)
    if k is None:
        found = f"found {len(body)} bytes of the plot {plot.name!r}, expected {sizes[0]}"
        raise LogError(f"{path}: {found}; was the file written to its end?")
    points = np.frombuffer(body, forms[k], plot.points)
    return np.stack([points[name].astype(full) for name in forms[k].names or ()], -1), ends[k]


def _enter(store: Store, plot: _Plot, values: np.ndarray) -> None:
    """Enter the runs of a plot, each as a table."""
    scale = np.abs(values[:, 0].real)  # LTspice marks times by their sign
    values = np.column_stack([scale, values[:, 1:]])
    up = np.sign(scale[1] - scale[0]) if len(scale) > 1 else 1.0
    runs = np.split(values, np.flatnonzero(up * np.diff(scale) < 0) + 1)
    for number, run in enumerate(runs, 1):
        table = " ".join(filter(None, (plot.name, str(number) if runs[1:] else "")))
        for k, (name, unit) in enumerate(zip(plot.names, plot.units, strict=True)):
            store.add(table, name, run[:, k] if k else run[:, 0].real, unit)
