"""A figure that matplotlib has drawn, as plotly is told of it: line by line and band by band, so that both
show the same numbers. (`plotly.tools.mpl_to_plotly` tells lines and dots alone.)"""

import html
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator

from sysid.report.canvas import BLACK, GREY, GRID
from sysid.report.text import clean

INCH = 124.8  # CSS pixels: 1.3 times as large as in the report
POINT = INCH / 72
DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
STEPS = {"default": "linear", "steps": "vh", "steps-pre": "vh", "steps-mid": "hvh", "steps-post": "hv"}
MARKERS = {"o": "circle", ".": "circle", "x": "x-thin", "s": "square", "D": "diamond", "^": "triangle-up"}
SMALL = 0.5  # of the size of an "o", which a "." has
ACROSS = {"left": "left", "center": "center", "right": "right"}
UP = {"top": "top", "center": "middle", "center_baseline": "middle", "bottom": "bottom", "baseline": "bottom"}
ROUNDED = 0.05  # of the ticks' span, by which their rounded labels may be off them
PLAIN = (1e-3, 1e8)  # between which numbers are written without a power of ten
NONE = ("", " ", "None", None)


def plotly() -> Any:
    """The library, or ImportError that says how to have it."""
    try:
        return import_module("plotly.graph_objects")
    except ImportError:
        raise ImportError("figures to zoom into need plotly: pip install 'sysid[zoom]'") from None


def told_of(figure: Figure) -> str:
    """What plotly draws of a figure, as JSON. Raises TypeError where it holds what cannot be told."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # as `canvas.drawn` does
        figure.draw_without_rendering()  # which settles limits and ticks
    boxes = np.array([axes.get_position().extents for axes in figure.axes])
    frame = Frame(*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0))
    panels = [Panel(axes, k, frame) for k, axes in enumerate(figure.axes, 1)]
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    names = list(dict.fromkeys(text.get_text() for legend in legends for text in legend.get_texts()))
    layout = _layout(figure, frame, bool(names))
    for panel in panels:
        layout |= panel.layout(panels)
    layout["shapes"] = [shape for panel in panels for shape in panel.shapes]
    layout["annotations"] = [note for panel in panels for note in panel.annotations()]
    layout["annotations"] += [frame.note(text, figure) for text in figure.texts]
    traces = [trace for panel in panels for trace in panel.traces]
    return plotly().Figure(_in_legend(traces, names), layout).to_json()


@dataclass(frozen=True)
class Frame:
    """The part of a figure that axes fill: plotly's paper. In fractions of the figure."""

    left: float
    low: float
    right: float
    high: float

    def inside(self, x: float, y: float) -> tuple[float, float]:
        """Fractions of the figure as fractions of the frame."""
        return (x - self.left) / (self.right - self.left), (y - self.low) / (self.high - self.low)

    def note(self, text: Text, figure: Figure) -> dict[str, Any]:
        """A text of the figure; outside of the frame it keeps its distance, however wide that is drawn."""
        x, y = text.get_position()
        near = float(np.clip(x, self.left, self.right)), float(np.clip(y, self.low, self.high))
        shift = (x - near[0]) * INCH * figure.get_figwidth(), (y - near[1]) * INCH * figure.get_figheight()
        return _note(text, *self.inside(*near)) | {"xshift": float(shift[0]), "yshift": float(shift[1])}


@dataclass(frozen=True)
class Scale:
    """An axis of a panel: `key` as in "x2"; what numbers are multiplied with, for the unit of their labels;
    whether it is logarithmic."""

    key: str
    factor: float
    log: bool
    fixed: tuple[float, ...] = ()  # where marks are, where they are at places of their own
    named: tuple[str, ...] = ()  # their names, where these are no numbers of the axis

    @classmethod
    def of(cls, key: str, axis: Any) -> "Scale":
        """Ticks that are numbers are plotly's to choose, which shows more of them further in; where some were
        chosen there are marks."""
        log = axis.get_scale() == "log"
        if not isinstance(axis.get_major_locator(), FixedLocator):
            return cls(key, 1.0, log)
        where, texts = axis.get_ticklocs(), [label.get_text() for label in axis.get_ticklabels()]
        if not any(texts):
            return cls(key, 1.0, log, tuple(map(float, where)))
        if factor := _factor(where, texts):
            return cls(key, factor, log, tuple(factor * float(x) for x in where))
        return cls(key, 1.0, log, tuple(map(float, where)), tuple(map(_text, texts)))


def _factor(where: np.ndarray, texts: Sequence[str]) -> float | None:
    """The power of ten by which labels are larger than the numbers that they stand at; None of others."""
    try:
        numbers = np.array([float(text.replace("−", "-")) for text in texts])
    except ValueError:
        return None
    largest = np.argmax(np.abs(where))
    ratio = numbers[largest] / where[largest] if where[largest] else 0.0
    factor = 10.0 ** np.round(np.log10(ratio)) if ratio > 0 else 1.0
    off = np.abs(numbers - factor * where).max()
    return float(factor) if len(numbers) > 1 and off <= ROUNDED * np.ptp(numbers) else None


@dataclass(frozen=True)
class Panel:
    """One of a figure's axes."""

    axes: Axes
    number: int
    frame: Frame

    @cached_property
    def scales(self) -> tuple[Scale, Scale]:
        """Those of x and y."""
        n = "" if self.number == 1 else str(self.number)
        return Scale.of(f"x{n}", self.axes.xaxis), Scale.of(f"y{n}", self.axes.yaxis)

    def layout(self, panels: "Sequence[Panel]") -> dict[str, Any]:
        """Its two axes, as plotly has them; those that share their limits go together."""
        box = self.axes.get_position()
        corners = self.frame.inside(box.x0, box.y0), self.frame.inside(box.x1, box.y1)
        found, axes = {}, self.axes
        for k, (scale, axis) in enumerate(zip(self.scales, (axes.xaxis, axes.yaxis), strict=True)):
            shared = axes.get_shared_x_axes() if k == 0 else axes.get_shared_y_axes()
            first = next(p for p in panels if p is self or shared.joined(p.axes, axes))
            span = sorted(float(np.clip(corner[k], 0, 1)) for corner in corners)
            told = _axis(axis, scale) | {"domain": span, "anchor": self.scales[1 - k].key}
            if first is not self:
                told["matches"] = first.scales[k].key
            found[f"{'xy'[k]}axis{scale.key[1:]}"] = told
        if axes.get_aspect() == 1.0:
            found[f"yaxis{self.scales[1].key[1:]}"] |= {"scaleanchor": self.scales[0].key}
        return found

    @cached_property
    def _artists(self) -> list[Any]:
        found = [*self.axes.collections, *self.axes.patches, *self.axes.lines]
        return sorted((a for a in found if a.get_visible()), key=lambda a: a.get_zorder())

    @cached_property
    def _told(self) -> list[tuple[bool, dict[str, Any]]]:
        """Whether it is a shape, and what it is, in the order in which they lie upon one another."""
        return [told for artist in self._artists for told in self._tell(artist)]

    @property
    def traces(self) -> list[dict[str, Any]]:
        """Lines, dots and filled areas."""
        return [what for is_shape, what in self._told if not is_shape]

    @property
    def shapes(self) -> list[dict[str, Any]]:
        """What reaches across the panel, wherever it is zoomed to."""
        return [what for is_shape, what in self._told if is_shape]

    def annotations(self) -> Iterator[dict[str, Any]]:
        """Its texts."""
        for text in (t for t in self.axes.texts if t.get_visible() and t.get_text()):
            moved = isinstance(text, Annotation)
            place = text.xy if isinstance(text, Annotation) else text.get_position()
            refs = self._refs(self.axes.transData if moved else text.get_transform())
            known = zip(place, self.scales, refs, strict=True)
            at = [_log(s, s.factor * float(x)) if ref == s.key else float(x) for x, s, ref in known]
            note = _note(text, *at) | {"xref": refs[0], "yref": refs[1]}
            shift = [float(POINT * x) for x in text.get_position()] if moved else [0, 0]
            yield note | {"xshift": shift[0], "yshift": shift[1]}

    def _tell(self, artist: Any) -> Iterator[tuple[bool, dict[str, Any]]]:
        if isinstance(artist, QuadMesh):
            yield False, self._mesh(artist)
        elif isinstance(artist, Line2D):
            yield from self._segments([artist.get_xydata()], artist.get_transform(), _of_line(artist))
        elif isinstance(artist, LineCollection):
            colour, width = np.atleast_2d(artist.get_color())[0], np.ravel(artist.get_linewidth())[0]
            line = {"color": to_hex(colour), "width": POINT * float(width)}
            style = {"mode": "lines", "line": line, "opacity": to_rgba(colour)[3]}
            yield from self._segments(artist.get_segments(), artist.get_transform(), style)
        elif isinstance(artist, PolyCollection):
            paths = [path.vertices for path in artist.get_paths()]
            yield False, self._area(paths, artist.get_facecolor()[0], artist)
        elif isinstance(artist, Rectangle):
            yield True, self._span(artist)
        elif isinstance(artist, Patch) and "data" in self._kind(artist.get_data_transform()):
            yield False, self._area([artist.get_path().vertices], artist.get_facecolor(), artist)
        else:
            raise TypeError(f"found {artist!r} in a figure, expected lines, bands, spans or stairs")

    def _kind(self, transform: Any) -> str:
        return "data" if all(transform.contains_branch_seperately(self.axes.transData)) else "mixed"

    def _refs(self, transform: Any) -> tuple[str, str]:
        """What each coordinate is a number of: the axis, or a part of the panel."""
        x, y = (
            scale.key if there else f"{scale.key} domain"
            for scale, there in zip(
                self.scales, transform.contains_branch_seperately(self.axes.transData), strict=True
            )
        )
        return x, y

    def _scaled(self, points: Any, refs: tuple[str, str] | None = None) -> np.ndarray:
        """(n, 2) in the units of the labels, where they are numbers of the axis."""
        keys = refs or tuple(s.key for s in self.scales)
        factors = [s.factor if key == s.key else 1.0 for s, key in zip(self.scales, keys, strict=True)]
        return np.asarray(np.ma.filled(np.ma.asarray(points, float), np.nan)) * factors

    def _trace(self, points: np.ndarray) -> dict[str, Any]:
        x, y = self._scaled(points).T
        return {"type": "scatter", "x": x, "y": y, "xaxis": self.scales[0].key, "yaxis": self.scales[1].key}

    def _segments(
        self, paths: Sequence[Any], transform: Any, style: Mapping[str, Any]
    ) -> Iterator[tuple[bool, dict[str, Any]]]:
        """Lines of points (n, 2): one trace, or where they reach across the panel shapes."""
        refs = self._refs(transform)
        if refs == tuple(s.key for s in self.scales):
            yield False, self._trace(_joined(paths)) | dict(style)
            return
        line = {key: value for key, value in style["line"].items() if key != "shape"}
        for path in paths:
            (x0, y0), (x1, y1) = self._scaled([path[0], path[-1]], refs).tolist()
            place = {"x0": x0, "y0": y0, "x1": x1, "y1": y1, "xref": refs[0], "yref": refs[1]}
            yield True, {"type": "line", "line": line, "opacity": style["opacity"]} | place

    def _area(self, paths: Sequence[Any], colour: Any, artist: Any) -> dict[str, Any]:
        style: dict[str, Any] = {
            "mode": "lines",
            "line": {"width": 0, "color": to_hex(colour)},
            "fill": "toself",
        }
        style |= {"fillcolor": to_hex(colour), "opacity": to_rgba(colour)[3], "hoverinfo": "skip"}
        return self._trace(_joined(paths)) | style | {"name": _text(str(artist.get_label()))}

    def _span(self, patch: Rectangle) -> dict[str, Any]:
        refs = self._refs(patch.get_data_transform())
        points = self._scaled(patch.get_patch_transform().transform(patch.get_path().vertices), refs)
        (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        place: dict[str, Any] = {"x0": x0, "y0": y0, "x1": x1, "y1": y1, "xref": refs[0], "yref": refs[1]}
        colour = patch.get_facecolor()
        look: dict[str, Any] = {
            "fillcolor": to_hex(colour),
            "opacity": to_rgba(colour)[3],
            "line": {"width": 0},
        }
        return {"type": "rect", "layer": "below"} | look | place

    def _mesh(self, mesh: QuadMesh) -> dict[str, Any]:
        """Colours over a grid, as a ramp has them."""
        grid, steps = self._scaled(mesh.get_coordinates()), np.linspace(0, 1, 32)
        ramp = [[float(at), to_hex(mesh.cmap(at))] for at in steps]
        low, high = mesh.get_clim()
        told: dict[str, Any] = {
            "type": "heatmap",
            "x": grid[0, :, 0],
            "y": grid[:, 0, 1],
            "z": np.asarray(mesh.get_array()),
        }
        told |= {"colorscale": ramp, "zmin": low, "zmax": high, "showscale": False, "hoverinfo": "z"}
        return told | {"xaxis": self.scales[0].key, "yaxis": self.scales[1].key}


def _joined(paths: Sequence[Any]) -> np.ndarray:
    """Paths (n, 2) one after the other, with a gap between."""
    gap, whole = np.full((1, 2), np.nan), []
    for path in paths:
        whole += [np.ma.filled(np.ma.asarray(path, float), np.nan), gap]
    return np.concatenate(whole[:-1]) if whole else np.empty((0, 2))


def _of_line(line: Line2D) -> dict[str, Any]:
    """How a line looks, and its dots."""
    opacity = 1.0 if line.get_alpha() is None else float(line.get_alpha())
    drawn, marked = line.get_linestyle() not in NONE, line.get_marker() not in NONE
    style: dict[str, Any] = {"name": _text(str(line.get_label())), "opacity": opacity}
    style["mode"] = "+".join([*(["lines"] if drawn else []), *(["markers"] if marked else [])]) or "none"
    style["line"] = {"color": to_hex(line.get_color()), "width": POINT * line.get_linewidth()}
    if drawn:
        style["line"] |= {"dash": DASHES[str(line.get_linestyle())], "shape": STEPS[line.get_drawstyle()]}
    if marked:
        marker = str(line.get_marker())
        size = POINT * line.get_markersize() * (SMALL if marker == "." else 1.0)
        width = POINT * line.get_markeredgewidth()
        edge = {"color": to_hex(line.get_markeredgecolor()), "width": width}
        face = {"color": to_hex(line.get_markerfacecolor()), "size": size}
        style["marker"] = face | {"symbol": MARKERS[marker], "line": edge}
    return style


def _in_legend(traces: Sequence[dict[str, Any]], names: Sequence[str]) -> list[dict[str, Any]]:
    """The traces, each name once in the legend, from which all of that name are hidden together."""
    seen: set[str] = set()
    for trace in (t for t in traces if t["type"] == "scatter"):
        name = trace.get("name", "_")
        known = name in {_text(n) for n in names}
        trace |= {"showlegend": known and name not in seen} | ({"legendgroup": name} if known else {})
        seen.add(name)
        if name.startswith("_"):  # matplotlib's for one without a name
            trace["name"] = ""
    return list(traces)


def _layout(figure: Figure, frame: Frame, legend: bool) -> dict[str, Any]:
    wide, high = INCH * figure.get_figwidth(), INCH * figure.get_figheight()
    margin = {"l": frame.left * wide, "r": (1 - frame.right) * wide, "b": frame.low * high, "pad": 0}
    margin["t"] = max((1 - frame.high) * high, 40.0)  # for the buttons and the legend
    top = {"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "top", "yref": "container"}
    font = {"family": '"DejaVu Sans", Verdana, sans-serif', "size": 12, "color": BLACK}
    clear = {"paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)"}
    hover = {"hovermode": "closest", "hoverlabel": {"bgcolor": "#ffffff", "font": font}}
    made = {"autosize": True, "height": high, "margin": margin, "font": font, "template": None}
    made |= {"separators": ". "}
    kept = {"uirevision": "kept", "dragmode": "zoom", "showlegend": legend, "legend": top}
    return made | clear | hover | kept


def _axis(axis: Any, scale: Scale) -> dict[str, Any]:
    ends = [scale.factor * float(x) for x in axis.get_view_interval()]
    if axis.get_inverted():
        ends = ends[::-1]
    labelled, bare = any(label.get_text() for label in axis.get_ticklabels()), not len(axis.get_ticklocs())
    hidden = axis.get_tick_params().get("labelbottom" if axis.axis_name == "x" else "labelleft") is False
    side = axis.get_ticks_position() if axis.get_ticks_position() in ("top", "right") else None
    told: dict[str, Any] = {"type": "log" if scale.log else "linear", "range": [_log(scale, x) for x in ends]}
    told |= {"showticklabels": labelled and (side is not None or not hidden), "zeroline": False}
    told |= {"showline": side is None, "linecolor": GREY, "gridcolor": GRID, "ticklen": 4}
    plain = not scale.log and PLAIN[0] <= max(map(abs, ends)) < PLAIN[1]
    told |= {"tickcolor": GREY, "exponentformat": "none" if plain else "power", "automargin": True}
    told |= {"showgrid": bool(axis.get_tick_params().get("gridOn", True))}
    told |= {"title": {"text": _text(axis.get_label_text())}}
    told |= {"ticks": "" if bare or (scale.fixed and not labelled) else "outside"}
    told |= {"dtick": 1} if scale.log else {"nticks": 6}
    told |= {"side": side} if side else {}
    if scale.named:
        return told | {"tickmode": "array", "tickvals": scale.fixed, "ticktext": scale.named}
    marks: dict[str, Any] = {"tickmode": "array", "tickvals": scale.fixed, "ticks": "inside"}
    marks |= {"ticklen": 6, "tickcolor": BLACK}
    return told | ({"minor": marks} if scale.fixed else {})


def _note(text: Text, x: float, y: float) -> dict[str, Any]:
    """A text at its place, of the paper unless another is said."""
    font = {"color": to_hex(text.get_color()), "size": POINT * float(text.get_fontsize())}
    said = {"text": _text(text.get_text()), "x": x, "y": y, "xref": "paper", "yref": "paper", "font": font}
    turned = {"textangle": -float(text.get_rotation()), "showarrow": False}
    across, up = ACROSS[text.get_horizontalalignment()], UP[text.get_verticalalignment()]
    return said | turned | {"xanchor": across, "yanchor": up}


def _log(scale: Scale, x: float) -> float:
    return float(np.log10(x)) if scale.log else x


def _text(text: str) -> str:
    """A text that plotly takes for no markup."""
    return html.escape(clean(text), quote=False)
