"""The pictures of a lot's report: distributions, pairs, what goes along, and a small one of each odd
plate."""

import io
from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from sysid.fleet.lot import Judged
from sysid.fleet.words import unit_of
from sysid.model.theta import POSITIVE
from sysid.report.canvas import BLUE, DOTS, GREY, ORANGE, STYLE, blank
from sysid.report.text import PREFIXES, clean

MOST = 3000  # ordinary plates that are drawn as points
WITHIN = 2.447  # standard deviations within which 95 % of two normal numbers lie
SMOOTHED = 25  # plates, whose running median shows where a lot goes
SVG = {"svg.fonttype": "none", "svg.hashsalt": "sysid"}  # letters as letters, and the same bytes each time


def image(figure: Figure) -> str:
    """A figure as the source of an image in HTML."""
    whole = io.BytesIO()
    FigureCanvasSVG(figure).print_svg(whole, metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{b64encode(whole.getvalue()).decode()}"


def of_lot(frame: pd.DataFrame, found: Judged) -> dict[str, str]:
    """The pictures of a lot by their titles."""
    with matplotlib.rc_context(STYLE | SVG):  # type: ignore[arg-type]
        lot = _Lot(frame, found)
        pictures = {"Distributions": image(_distributions(lot))}
        if len(found.names) > 1:
            pictures["Parameter against parameter"] = image(_pairs(lot))
        for name, along in _alongs(frame.iloc[found.index]).items():
            pictures[f"Along the {name}"] = image(_along(lot, along, name))
        return pictures


def of_plate(row: Mapping[str, Any], frame: pd.DataFrame, found: Judged | None, at: int) -> str | None:
    """The small picture of the plate in the table's row `at`: its place in the lot, and its logs beside their
    model; None where there is nothing to draw."""
    traces = row.get("traces", [])
    place = None if found is None else np.flatnonzero(found.index == at)
    inside = place is not None and len(place) > 0
    if not traces and not inside:
        return None
    with matplotlib.rc_context(STYLE | SVG):  # type: ignore[arg-type]
        names = found.names if found is not None and inside else ()
        figure = blank(1.7 * bool(names) + 2.2 * len(traces), max(1.5, 0.62 * len(names)))
        columns = [1.4] * bool(names) + [2.0] * len(traces)
        grid = figure.add_gridspec(len(names) or 1, len(columns), width_ratios=columns)
        if found is not None and place is not None:
            for j, name in enumerate(names):
                _strip(figure.add_subplot(grid[j, 0]), _Lot(frame, found), name, int(place[0]))
        for k, trace in enumerate(traces):
            _traced(figure.add_subplot(grid[:, k + bool(names)]), trace)
        wide = figure.get_figwidth()
        figure.subplots_adjust(0.35 / wide, 0.24, 1 - 0.05 / wide, 0.88, 0.25, 1.7)
        return image(figure)


class _Lot:
    """The judged plates in the units that pictures show."""

    def __init__(self, frame: pd.DataFrame, found: Judged):
        self.found, self.names = found, found.names
        told = frame.iloc[found.index]
        self.odd = told["odd"].to_numpy(bool)
        self.factors: dict[str, float] = {}
        self.labels: dict[str, str] = {}
        for j, name in enumerate(self.names):
            unit, factor = unit_of(frame, name), 1.0
            if unit == "s":
                middle = float(np.exp(found.lot.centre[0, j]))
                unit, factor = next((p for p in PREFIXES if middle * p[1] >= 1), PREFIXES[-1])
            self.factors[name], self.labels[name] = factor, clean(f"{name} ({unit})")

    def values(self, name: str, x: np.ndarray | None = None) -> np.ndarray:
        """What is shown of a parameter: of the plates, or of other numbers as the lot has them."""
        x = self.found.lot.values[:, self.names.index(name)] if x is None else x
        return (np.exp(x) if name in POSITIVE else x) * self.factors[name]

    @property
    def drawn(self) -> list[tuple[np.ndarray, dict[str, Any]]]:
        """Which plates are drawn how: not all that are ordinary, where they are many; odd ones on top."""
        ordinary = np.flatnonzero(~self.odd)
        ordinary = ordinary[:: -(-len(ordinary) // MOST) or 1]
        return [
            (ordinary, DOTS | {"color": BLUE}),
            (np.flatnonzero(self.odd), DOTS | {"color": ORANGE, "alpha": 0.9}),
        ]

    def middle(self, name: str) -> tuple[float, float]:
        """Where the lot is, at the median of what it goes along with, and its standard deviation, as it has
        them."""
        lot, j = self.found.lot, self.names.index(name)
        return float((np.median(lot.given, axis=0) @ lot.centre)[j]), float(np.sqrt(lot.scatter[j, j]))


def _distributions(lot: _Lot) -> Figure:
    """Histograms, the lot as the normal one that it is taken for, and odd plates below."""
    figure = blank(10, 2.4)
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(lot.names))), lot.names, strict=True):
        x = lot.values(name)
        seen = x[np.isfinite(x)]
        count, edges, _ = axes.hist(seen, bins=min(max(len(seen) // 12, 8), 60), color=BLUE, alpha=0.55)
        middle, sd = lot.middle(name)
        if lot.found.lot.given.shape[1] == 1 and sd > 0:
            u = np.linspace(middle - 4 * sd, middle + 4 * sd, 200)
            v = lot.values(name, u)
            density = np.exp(-0.5 * ((u - middle) / sd) ** 2) / (np.sqrt(2 * np.pi) * sd) / np.gradient(v, u)
            axes.plot(v, density * len(seen) * (edges[1] - edges[0]), color=GREY)
        axes.plot(
            x[lot.odd], np.full(lot.odd.sum(), -0.03 * count.max()), "^", color=ORANGE, ms=4, clip_on=False
        )
        axes.set_xlabel(lot.labels[name])
        axes.locator_params(nbins=5)
    figure.axes[0].set_ylabel("plates")
    figure.subplots_adjust(0.05, 0.2, 0.99, 0.96, 0.2)
    return figure


def _pairs(lot: _Lot) -> Figure:
    """Each two parameters, and where 95 % of the lot lie."""
    pairs = [(a, b) for i, a in enumerate(lot.names) for b in lot.names[i + 1 :]]
    columns = min(len(pairs), 3)
    rows = -(-len(pairs) // columns)
    figure = blank(10, 3.1 * rows)
    turn = np.linspace(0, 2 * np.pi, 120)
    for k, (a, b) in enumerate(pairs):
        axes = figure.add_subplot(rows, columns, k + 1)
        for which, style in lot.drawn:
            axes.plot(lot.values(a)[which], lot.values(b)[which], **style)
        index = [lot.names.index(a), lot.names.index(b)]
        root = np.linalg.cholesky(lot.found.lot.scatter[np.ix_(index, index)] + 1e-300 * np.eye(2))
        ring = WITHIN * root @ np.stack([np.cos(turn), np.sin(turn)])
        if lot.found.lot.given.shape[1] == 1:
            axes.plot(
                lot.values(a, lot.middle(a)[0] + ring[0]),
                lot.values(b, lot.middle(b)[0] + ring[1]),
                color=GREY,
            )
        axes.set(xlabel=lot.labels[a], ylabel=lot.labels[b])
        axes.locator_params(nbins=5)
    high = figure.get_figheight()
    figure.subplots_adjust(0.065, 0.45 / high, 0.99, 1 - 0.08 / high, 0.3, 0.35)
    return figure


def _alongs(told: pd.DataFrame) -> dict[str, pd.Series]:
    """What plates may be shown along, by its name."""
    dates = pd.to_datetime(told["date"], errors="coerce", utc=True, format="ISO8601")
    found = {
        "serial number": told["serial"],
        "date": dates,
        "temperature": told["reference_temperature_degC"],
    }
    return {name: values for name, values in found.items() if values.nunique() > 1}


def _along(lot: _Lot, along: pd.Series, name: str) -> Figure:
    """Each parameter along something, with its running median."""
    figure = blank(10, 2.4)
    x = along.dt.tz_localize(None).to_numpy() if name == "date" else along.to_numpy(float)
    for axes, parameter in zip(np.atleast_1d(figure.subplots(1, len(lot.names))), lot.names, strict=True):
        y = lot.values(parameter)
        for which, style in lot.drawn:
            axes.plot(x[which], y[which], **style)
        if len(x) > 2 * SMOOTHED:
            path = pd.Series(y, index=x).sort_index().rolling(SMOOTHED, center=True, min_periods=5).median()
            axes.plot(
                path.index[:: -(-len(path) // MOST)], path.to_numpy()[:: -(-len(path) // MOST)], color=GREY
            )
        axes.set(xlabel=f"{name} (degC)" if name == "temperature" else name, ylabel=lot.labels[parameter])
        axes.locator_params(axis="y", nbins=5)
        if name == "date":
            axes.tick_params(axis="x", rotation=20)
    figure.subplots_adjust(0.065, 0.27 if name == "date" else 0.2, 0.99, 0.96, 0.3)
    return figure


def _strip(axes: Axes, lot: _Lot, name: str, k: int) -> None:
    """Where one plate lies in the lot: its middle 95 % as a bar."""
    middle, sd = lot.middle(name)
    value = lot.found.lot.values[k, lot.names.index(name)]
    low, high, mark = lot.values(name, np.array([middle - 1.96 * sd, middle + 1.96 * sd, value]))
    axes.plot([low, high], [0, 0], color=BLUE, lw=5, alpha=0.35, solid_capstyle="butt")
    axes.plot([mark], [0], "o", color=ORANGE, ms=5)
    axes.set(yticks=[], ylim=(-1, 1))
    axes.set_title(lot.labels[name], fontsize=7, pad=2, loc="left")
    axes.spines["left"].set_visible(False)
    axes.tick_params(labelsize=6, pad=1)
    axes.locator_params(axis="x", nbins=4)


def _traced(axes: Axes, trace: Mapping[str, Any]) -> None:
    """A log as dots, its model as lines."""
    x, label = np.array(trace["x"]), trace["label"]
    if label == "s":
        label, factor = next((p for p in PREFIXES if x[-1] * p[1] >= 2), PREFIXES[-1])
        x = factor * x
    parts = trace["digit"] * np.array(trace["parts"])
    colours = [BLUE, ORANGE] if len(parts) > 1 else [GREY]
    for (recorded, fitted), colour in zip(parts, colours, strict=True):
        axes.plot(x, recorded, color=colour, **DOTS)
        axes.plot(x, fitted, color=colour)
    name = clean(trace["name"])
    axes.set_title(name if len(name) <= 30 else f"{name[:14]}...{name[-13:]}", fontsize=7, pad=2)
    axes.set_xlabel(label, labelpad=1)
    axes.tick_params(labelsize=6)
    axes.locator_params(nbins=4)
