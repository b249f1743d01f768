"""Layouts of patches side by side: one row of numbers for each, as a table in Markdown or for pandas."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from stimulator.modal import Mode, Neighbour

if TYPE_CHECKING:
    from stimulator.modes import Modes

HEARD = 0.02  # |drive| or |sense| of a neighbour that is named, over that of the chosen mode

Row = dict[str, str]


def row(found: "Modes", tau: float) -> Row:
    """The chosen mode of a layout in numbers, G at the time constant `tau` (s), and the neighbours it drives.

    A neighbour stands as its offset in Hz with drive and sense, both over those of the chosen mode.
    """
    mode = found.mode
    return {
        "f0 (Hz)": f"{mode.f0:.0f}",
        "straight": f"{mode.uniformity:.2f}",
        "m (g)": f"{1e3 * mode.m:.1f}",
        "N (N/V)": f"{mode.N:.3f}",
        "b (um/(s V))": f"{1e6 * mode.b:.1f}",
        "G (nm/V)": f"{1e9 * mode.b * tau:.0f}",
        "corner/middle": f"{abs(float(mode.weight(0.0, 0.0))):.1f}",
        "driven neighbours": ", ".join(named(mode, n) for n in mode.neighbours if abs(n.drive) > HEARD)
        or "none",
    }


def named(mode: Mode, neighbour: Neighbour) -> str:
    """A neighbour as its offset in Hz, with drive and sense in brackets."""
    return f"{neighbour.f0 - mode.f0:+.0f} ({neighbour.drive:.2f}, {neighbour.sense:.2f})"


def table(found: Mapping[str, "Modes"], tau: float) -> list[Row]:
    """A row for each layout, by name."""
    return [{"layout": name, **row(one, tau)} for name, one in found.items()]


def markdown(rows: Iterable[Mapping[str, object]]) -> str:
    """Rows of the same keys as a table in Markdown."""
    rows = list(rows)
    lines = [list(rows[0]), ["---"] * len(rows[0]), *([str(value) for value in one.values()] for one in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
