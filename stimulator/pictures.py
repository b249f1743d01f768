"""Pictures of a plate: its patches and their poling, and the shape of a mode with its nodal lines."""

from typing import TYPE_CHECKING

import numpy as np

from stimulator.modal import Mode, Neighbour
from stimulator.plate import Patch, PlateGeometry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM = 1e3
UP, DOWN, SENSING = "#D55E00", "#0072B2", "#009E73"  # told apart by colour-blind eyes too


def draw_layout(ax: "Axes", plate: PlateGeometry, poling: tuple[int, ...] = ()) -> None:
    """The plate's outline and its patches: orange poled up, blue poled down, green those that sense."""
    from matplotlib.patches import Rectangle

    poling = poling or tuple(patch.poling for patch in plate.patches)
    for patch, pole in zip(plate.patches, poling, strict=True):
        x0, x1, y0, y1 = (MM * edge for edge in patch.box)
        colour = _colour(patch, pole)
        ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, facecolor=colour, alpha=0.35))
        ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, edgecolor=colour, fill=False, lw=1.2))
    ax.set(xlim=(0, MM * plate.length), ylim=(0, MM * plate.width), xlabel="x (mm)", ylabel="y (mm)")
    ax.set_aspect("equal")
    ax.grid(False)


def draw_mode(ax: "Axes", mode: Mode | Neighbour) -> None:
    """The shape of a mode, from -1.5 to 1.5 of its amplitude in the middle, and its nodal lines."""
    x, y, values = MM * mode.shape.x, MM * mode.shape.y, mode.shape.values.T
    ax.imshow(values, origin="lower", extent=(0, x[-1], 0, y[-1]), cmap="RdBu", vmin=-1.5, vmax=1.5)
    ax.contour(x, y, values, levels=[0.0], colors="k", linewidths=0.5)
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
    ax.grid(False)


def draw_section(ax: "Axes", mode: Mode | Neighbour, y_m: float) -> None:
    """The amplitude along the length at `y_m` (m)."""
    x = np.linspace(0, mode.shape.x[-1], 2000)
    ax.plot(MM * x, mode.weight(x, y_m), lw=1)
    ax.axhline(0, color="k", lw=0.5)
    ax.set(xlabel="x (mm)", ylabel="amplitude / W", xlim=(0, MM * x[-1]))


def _colour(patch: Patch, pole: int) -> str:
    return SENSING if patch.role == "sense" else {1: UP, -1: DOWN, 0: "#666666"}[pole]
