"""The figures of logs beside their fit, or alone: over time, and over frequency.

Wd is blue and Wq is orange throughout; what was recorded is dots, the fit is lines.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from sysid.posterior.circuit import admittance
from sysid.report.canvas import BLUE, DOTS, GREY, ORANGE, PALETTE, WIDE, Picture, blank, thin, time_axis
from sysid.report.text import clean, listed, prefixed

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.prediction import Prediction
    from sysid.verdict.fitted import FittedLog

PANELS = 12  # logs over time
TOGETHER = 4  # of them in one figure
RAMP = (0.3, 0.8)  # of viridis: seen on white and on black
Numbered = tuple[int, "FittedLog"]


class Bare(NamedTuple):
    """A log without a model, where a `FittedLog` may stand."""

    log: "Log"
    kind: str
    response: None = None
    nrmse_percent: None = None


def of_logs(logs: "Sequence[FittedLog]") -> list[Picture]:
    """What there is to draw of logs beside their fit."""
    numbered = list(enumerate(logs, 1))
    sweeps = [(i, f) for i, f in numbered if is_sweep(f)]
    others = _worst([(i, f) for i, f in numbered if not is_sweep(f)])
    left_out = len(logs) - len(sweeps) - len(others)
    read = "Dots are recorded, lines are the fit."
    note = (
        f"{read} Of the logs over time these have the largest NRMSE; {left_out} more are not drawn."
        if left_out
        else read
    )
    found = []
    for k in range(0, len(others), TOGETHER):
        few = others[k : k + TOGETHER]
        title = "Over time" + (
            f": log{'s' * (len(few) > 1)} {listed([str(i) for i, _ in few])}"
            if len(others) > TOGETHER
            else ""
        )
        seen = partial(_seen_over_time, few)
        found.append(Picture(title, partial(_panels, few), seen, read if k else note, told=False))
    if sweeps:
        found.append(
            Picture("Sweeps", lambda: _sweeps(sweeps), lambda: _seen_sweeps(sweeps), read, told=False)
        )
    return found


def log_figure(log: "Log") -> Figure:
    """A log as it was recorded: over time, or a sweep and its circle."""
    bare: Any = (1, Bare(log, log.kind or "steady"))
    return _sweeps([bare], circle=True) if is_sweep(bare[1]) else _panels([bare])


def is_sweep(fitted: "FittedLog | Prediction") -> bool:
    """Whether a log's points are settled and over frequency."""
    frequency = fitted.log.frequency
    return fitted.kind == "steady" and frequency is not None and bool(np.ptp(frequency) > 0)


def _worst(logs: Sequence[Numbered]) -> list[Numbered]:
    """PANELS logs of the largest share left by the fit, in their order."""
    sizes = [np.nan_to_num(f.nrmse_percent or 0.0) for _, f in logs]
    kept = set(np.argsort(np.negative(sizes), kind="stable")[:PANELS].tolist())
    return [log for k, log in enumerate(logs) if k in kept]


# --- over time ---


def _panels(logs: Sequence[Numbered]) -> Figure:
    columns = min(2, len(logs))
    rows = ceil(len(logs) / columns)
    figure = blank(WIDE, 0.75 + 1.45 * rows)
    for place, (number, fitted) in enumerate(logs):
        axes = figure.add_subplot(rows, columns, place + 1)
        label = _over_inputs(axes, fitted)
        axes.locator_params(nbins=4)
        axes.text(
            0, 1.03, named(number, fitted.log.name, 30 if columns > 1 else 60), transform=axes.transAxes
        )
        axes.set_xlabel(
            clean(label) if place + columns >= len(logs) or not label.startswith("time") else "", labelpad=1
        )
        axes.set_ylabel(clean(fitted.log.response_unit) if place % columns == 0 else "")
    handles = {
        label: handle
        for axes in figure.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="upper center", ncols=6, frameon=False, borderaxespad=0.1
    )
    high = figure.get_figheight()
    figure.subplots_adjust(0.1, 0.4 / high, 0.985, 1 - 0.46 / high, 0.2, 0.42)
    return figure


def _over_inputs(axes: Axes, fitted: "FittedLog") -> str:
    """One log against time, or settled points against what changes from one to the next; returns the label of
    that axis."""
    log, keep = fitted.log, thin(len(fitted.log))
    x, label = inputs(fitted)
    line = "-" if fitted.kind == "transient" else "x"
    for part, colour, name in parts(log):
        axes.plot(x[keep], part(log.response)[keep], color=colour, label=f"{name} recorded", **DOTS)
        if fitted.response is not None:
            axes.plot(x[keep], part(fitted.response)[keep], line, color=colour, label=f"{name} fitted")
    return label


def inputs(fitted: "FittedLog | Prediction") -> tuple[np.ndarray, str]:
    """(n,) what the rows of one log that is no sweep go by, and the label of that axis."""
    log = fitted.log
    if fitted.kind == "transient" and log.time is not None:
        return time_axis(log.time)
    if log.drive is not None and np.ptp(log.drive) > 0:
        return log.drive, f"drive ({log.drive_unit})"
    return np.arange(len(log)), "row"


def parts(log: "Log") -> list[tuple[Callable[[np.ndarray], np.ndarray], str, str]]:
    """Of the real parts of a response: how to take one, its colour and its name."""
    if log.amplitude_only:
        return [(np.real, GREY, "W")]
    return [(np.real, BLUE, "Wd"), (np.imag, ORANGE, "Wq")]


def _seen_over_time(logs: Sequence[Numbered]) -> str:
    each = []
    for number, f in logs:
        x, label = inputs(f)
        span = f"{np.min(x):.3g} to {np.max(x):.3g} {label.partition('(')[2].rstrip(')') or 'rows'}"
        each.append(f"{named(number, f.log.name)} over {span}, |W| up to {_top(f.log)}{_left(f)}")
    return f"Recorded dots and the lines of the fit: {'; '.join(each)}."


def _top(log: "Log") -> str:
    return f"{np.max(np.abs(log.response)):.3g} {clean(log.response_unit)}"


def _left(fitted: "FittedLog") -> str:
    left = fitted.nrmse_percent
    return "" if left is None or not np.isfinite(left) else f", {left:.2g} % of it left by the fit"


# --- over frequency ---


class Plane(NamedTuple):
    """How sweeps are drawn: their responses as they are, or where all are of an impedance analyser as
    conductance G and susceptance B. `names` of Wd, Wq and W, the `unit`, and the `factor` of a log's rows."""

    names: Mapping[str, str]
    unit: str
    factor: Callable[["Log"], Any]

    @classmethod
    def of(cls, logs: Sequence["Log"]) -> "Plane":
        """Of all that are drawn together."""
        found = [admittance(log) for log in logs]
        tops = [np.max(np.abs(y * log.response)) for y, log in zip(found, logs, strict=True) if y is not None]
        if len(tops) < len(logs):
            return cls({"Wd": "Wd", "Wq": "Wq", "W": "W"}, clean(logs[0].response_unit), lambda log: 1.0)
        unit, scale = prefixed(float(max(tops)), "S")

        def factor(log: "Log") -> Any:
            siemens = admittance(log)
            return 1.0 if siemens is None else scale * siemens

        return cls({"Wd": "G", "Wq": "B", "W": "|Y|"}, unit, factor)

    def label(self, of: str) -> str:
        """Of an axis."""
        return f"{self.names[of]} ({self.unit})"


def _sweeps(logs: Sequence[Numbered], circle: bool = False) -> Figure:
    """Wd and Wq (or W) against frequency, one colour for each log; with a `circle` of both beside them."""
    kinds = [
        name for name in ("Wd", "Wq", "W") if any(part[2] == name for _, f in logs for part in parts(f.log))
    ]
    circle = circle and kinds != ["W"]
    figure = blank(WIDE * (2 if circle else 1), 0.9 + 1.25 * max(len(kinds), 2))
    frequencies = np.concatenate([f.log.frequency for _, f in logs if f.log.frequency is not None])
    middle = float(np.round(np.median(frequencies)))
    shift = middle if np.ptp(frequencies) < 0.2 * middle else 0.0
    stack: dict[str, Axes] = {}
    for k, name in enumerate(kinds):
        stack[name] = figure.add_subplot(
            len(kinds), 2 if circle else 1, (1 + circle) * k + 1, sharex=stack.get(kinds[0])
        )
    beside = figure.add_subplot(1, 2, 2) if circle else None
    plane, colours = Plane.of([f.log for _, f in logs]), Colours.of(logs)
    for number, fitted in logs:
        style = {"color": colours.by_number[number], "label": named(number, fitted.log.name, 30)}
        _one_sweep(stack, beside, fitted, shift, plane.factor(fitted.log), style)
    for name, axes in stack.items():
        axes.set_ylabel(plane.label(name))
        axes.tick_params(labelbottom=name == kinds[-1])
        axes.locator_params(nbins=4)
    stack[kinds[-1]].set_xlabel(f"frequency - {shift:.0f} Hz (Hz)" if shift else "frequency (Hz)")
    if beside:
        beside.set(aspect="equal", xlabel=plane.label("Wd"), ylabel=plane.label("Wq"), adjustable="datalim")
    figure.subplots_adjust(
        0.125 / (1 + circle),
        0.4 / figure.get_figheight(),
        0.985,
        1 - colours.room / figure.get_figheight(),
        0.16,
        0.1,
    )
    colours.explained(figure, stack)
    return figure


def _one_sweep(
    stack: Mapping[str, Axes],
    circle: Axes | None,
    fitted: "FittedLog",
    shift: float,
    factor: Any,
    named_as: Mapping[str, Any],
) -> None:
    log, colour, name = fitted.log, named_as["color"], named_as["label"]
    assert log.frequency is not None
    order = np.argsort(log.frequency, kind="stable")[thin(len(log))]
    x, recorded = log.frequency[order] - shift, (factor * log.response)[order]
    lines: list[tuple[np.ndarray, Any]] = [
        (recorded, DOTS | ({"label": name} if fitted.response is None else {}))
    ]
    lines += (
        [] if fitted.response is None else [((factor * fitted.response)[order], {"lw": 1.0, "label": name})]
    )
    for values, style in lines:
        for part, _, which in parts(log):
            stack[which].plot(x, part(values), color=colour, **style)
        if circle and not log.amplitude_only:
            circle.plot(values.real, values.imag, color=colour, **style)


@dataclass(frozen=True)
class Colours:
    """A colour for each log: one of its own with its name, or where they are many that of its temperature or
    number on a ramp. `room`: inches above the axes for what explains them."""

    by_number: Mapping[int, Any]
    room: float
    scale: Any = None
    label: str = ""

    @classmethod
    def of(cls, logs: Sequence[Numbered]) -> "Colours":
        """Of logs, by their numbers."""
        numbers = [number for number, _ in logs]
        if len(logs) <= len(PALETTE):
            return cls(dict(zip(numbers, PALETTE, strict=False)), 0.12 + 0.16 * ceil(len(logs) / 2))
        known = [None if f.log.temperature is None else float(np.mean(f.log.temperature)) for _, f in logs]
        warmed = None not in known and np.ptp(np.array(known, float)) > 0
        values = np.array(known if warmed else numbers, float)
        ramp = ListedColormap(matplotlib.colormaps["viridis"](np.linspace(*RAMP, 256)))
        scale = ScalarMappable(Normalize(values.min(), values.max()), ramp)
        label = "temperature (degC)" if warmed else "log"
        return cls(dict(zip(numbers, scale.to_rgba(values), strict=True)), 0.48, scale, label)

    def explained(self, figure: Figure, stack: Mapping[str, Axes]) -> None:
        """Above the axes: the logs' names, or the ramp."""
        if self.scale is None:
            found: dict[str, Any] = {}
            for axes in stack.values():
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                    found.setdefault(label, handle)
            names = sorted(found, key=lambda name: int(name.split()[0]))
            figure.legend(
                [found[name] for name in names],
                names,
                loc="upper center",
                ncols=2,
                frameon=False,
                borderaxespad=0.1,
            )
            return
        high = figure.get_figheight()
        bar = figure.colorbar(
            self.scale,
            cax=figure.add_axes((0.35, 1 - 0.42 / high, 0.5, 0.08 / high)),
            orientation="horizontal",
        )
        bar.outline.set_visible(False)
        bar.ax.grid(visible=False)
        figure.text(0.33, 1 - 0.38 / high, self.label, ha="right", va="center")
        bar.ax.xaxis.set_ticks_position("top")
        bar.ax.tick_params(length=0, pad=1)


def _seen_sweeps(logs: Sequence[Numbered]) -> str:
    low = min(float(np.min(f.log.frequency)) for _, f in logs)
    high = max(float(np.max(f.log.frequency)) for _, f in logs)
    names = ", ".join(named(number, f.log.name) for number, f in logs)
    plane = Plane.of([f.log for _, f in logs])
    top = max(float(np.max(np.abs(plane.factor(f.log) * f.log.response))) for _, f in logs)
    size = "|Y|" if plane.names["W"] == "|Y|" else "|W|"
    number, worst = max(logs, key=lambda log: np.nan_to_num(log[1].nrmse_percent or 0.0))
    left = f"; most is left of {named(number, worst.log.name)}{_left(worst)}" if _left(worst) else ""
    of = f"{len(logs)} sweeps" if len(logs) > 1 else "One sweep"
    span = f"{of} from {low:.8g} to {high:.8g} Hz, {size} up to {top:.3g} {plane.unit}"
    return f"{span}, recorded dots and the lines of the fit: {names}{left}."


def named(number: int, name: str, most: int = 44) -> str:
    """A log by number and name, of which the middle is left out where it is long."""
    name = clean(name)
    half = (most - 4) // 2
    return f"{number}  {name if len(name) <= most else name[:half] + '...' + name[-half - 1 :]}"
