"""The figures of the report, which `plot()` of a result gives too: one per kind of log, the residuals, the posterior.

Wd is blue and Wq is orange throughout; what was recorded is dots, the fit is lines.
"""

import io
import warnings
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sysid.report.text import PREFIXES, clean, measured

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.posterior import Posterior
    from sysid.posterior.prediction import Prediction
    from sysid.verdict.fitted import Fit, FittedLog

POINTS = 2000  # of one log in one figure
PANELS = 15  # logs over time in one figure
BLUE, ORANGE, GREY = "#1f6fb4", "#e07b1a", "#666666"
STYLE: dict[str, Any] = {
    "text.parse_math": False,  # names of files are shown as they are
    "text.usetex": False,
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "lines.markersize": 3.0,
}
DOTS: dict[str, Any] = {"ls": "", "marker": "o", "alpha": 0.35, "mew": 0}
Numbered = tuple[int, "FittedLog"]


Wanted = Sequence[tuple[str, Callable[[], Figure], Any]]  # a title, what draws it, and whether there is anything to draw


class Bare(NamedTuple):
    """A log without a model, where a `FittedLog` may stand."""

    log: "Log"
    kind: str
    response: None = None


def log_figures(fit: "Fit") -> dict[str, bytes]:
    """PNG images of the logs and their fit by title, of the kinds that there are."""
    return drawn(of_logs(fit.logs))


def of_logs(logs: "Sequence[FittedLog]") -> Wanted:
    """What there is to draw of logs and their fit."""
    numbered = list(enumerate(logs, 1))
    sweeps = [(i, f) for i, f in numbered if _is_sweep(f)]
    others = [(i, f) for i, f in numbered if not _is_sweep(f)]
    return [
        ("Over time", lambda: _panels(others[:PANELS]), others),
        ("Sweeps", lambda: _sweeps(sweeps), sweeps),
        ("Residuals, in units of the noise", lambda: _residuals(numbered), True),
    ]


def log_figure(log: "Log") -> Figure:
    """A log as it was recorded: over time, or a sweep and its circle."""
    bare: Any = (1, Bare(log, log.kind or "steady"))
    return styled(lambda: _sweeps([bare]) if _is_sweep(bare[1]) else _panels([bare]))


def posterior_figure(posterior: "Posterior", parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, bytes]:
    """PNG image of the draws by its title; `parameters` as in fit.json. The same draws give the same bytes."""
    return drawn(of_posterior(posterior, parameters))


def of_posterior(posterior: "Posterior", parameters: Mapping[str, Any]) -> Wanted:
    """The draws, of parameters whose draws the logs bound: others may reach to infinity."""
    bounded = [name for name, p in parameters.items() if p["determined"] or _modes(p)]
    names = [name for name in bounded if name in posterior.draws]
    return [("Posterior", lambda: _corner(posterior, parameters, names), names)]


def _modes(parameter: Any) -> bool:
    """Whether a parameter, of fit.json or of a summary, has separate values."""
    return bool(parameter.get("modes") if isinstance(parameter, Mapping) else parameter.modes)


def prediction_figure(prediction: "Prediction") -> Figure:
    """What was recorded of a log, what is predicted, the model's error about that, and the noise's beside it."""
    return styled(lambda: _predicted(prediction))


def step_figure(controller: Mapping[str, Any] | None) -> dict[str, bytes]:
    """PNG image of the promised step response by its title, of controller.json's content; none where there is no controller."""
    loop = controller and controller["promise"].get("bode")
    wanted: Wanted = [("Step response of the closed loop", lambda: step_of(controller), controller)]
    return drawn([*wanted, ("Open loop and sensitivity over frequency", lambda: bode_of(controller), loop)])


def drawn(wanted: Wanted) -> dict[str, bytes]:
    """PNG images of the wanted figures, by title."""
    with warnings.catch_warnings(), matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        warnings.filterwarnings("ignore", "Glyph")  # a name in letters that the font lacks is shown as boxes
        return {title: _png(draw()) for title, draw, needed in wanted if needed}


def styled(draw: Callable[[], Figure]) -> Figure:
    """A figure in the report's style."""
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        return draw()


class Figures(dict[str, Figure]):
    """Figures by title, which a notebook shows one below the other."""

    @classmethod
    def of(cls, wanted: Wanted) -> "Figures":
        """The wanted figures."""
        return cls({title: styled(draw) for title, draw, needed in wanted if needed})

    def _repr_html_(self) -> str:
        return "".join(
            f'<p>{title}</p><img alt="{title}" src="data:image/png;base64,{b64encode(_png(figure)).decode()}">'
            for title, figure in self.items()
        )


def _png(figure: Figure) -> bytes:
    """The image without the program's name or any time in it."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def blank(width: float, height: float) -> Figure:
    """An empty figure; sizes in inches."""
    return Figure((width, height), dpi=110)


def _is_sweep(fitted: "FittedLog | Prediction") -> bool:
    frequency = fitted.log.frequency
    return fitted.kind == "steady" and frequency is not None and bool(np.ptp(frequency) > 0)


def _panels(logs: Sequence[Numbered]) -> Figure:
    columns = min(3, len(logs))
    rows = ceil(len(logs) / columns)
    figure = blank(10, 0.75 + 1.55 * rows)
    for place, (number, fitted) in enumerate(logs):
        axes = figure.add_subplot(rows, columns, place + 1)
        label = _over_inputs(axes, fitted)
        axes.locator_params(nbins=4)
        axes.text(0, 1.03, _name(number, fitted), transform=axes.transAxes)
        axes.set_xlabel(clean(label) if place + columns >= len(logs) or not label.startswith("time") else "", labelpad=1)
        axes.set_ylabel(clean(fitted.log.response_unit) if place % columns == 0 else "")
    handles = {label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="upper right", ncols=6, frameon=False, borderaxespad=0.1)
    high = figure.get_figheight()
    figure.subplots_adjust(0.06, 0.42 / high, 0.995, 1 - 0.42 / high, 0.13, 0.38)
    return figure


def _over_inputs(axes: Axes, fitted: "FittedLog") -> str:
    """One log against time, or settled points against what changes from one to the next; returns the label of that axis."""
    log, keep = fitted.log, _thin(len(fitted.log))
    x, label = _inputs(fitted)
    line = "-" if fitted.kind == "transient" else "x"
    for part, colour, name in _parts(log):
        axes.plot(x[keep], part(log.response)[keep], color=colour, label=f"{name} recorded", **DOTS)
        if fitted.response is not None:
            axes.plot(x[keep], part(fitted.response)[keep], line, color=colour, label=f"{name} fitted")
    return label


def _inputs(fitted: "FittedLog | Prediction") -> tuple[np.ndarray, str]:
    """(n,) what the rows of one log that is no sweep go by, and the label of that axis."""
    log = fitted.log
    if fitted.kind == "transient" and log.time is not None:
        return time_axis(log.time)
    if log.drive is not None and np.ptp(log.drive) > 0:
        return log.drive, f"drive ({log.drive_unit})"
    return np.arange(len(log)), "row"


def time_axis(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Time from its first in a unit that gives short numbers, and the label of its axis."""
    time = time - time[0]
    unit, factor = next((p for p in PREFIXES if time[-1] * p[1] >= 2), PREFIXES[-1])
    return factor * time, f"time ({unit})"


def _parts(log: "Log") -> list[tuple[Callable[[np.ndarray], np.ndarray], str, str]]:
    if log.amplitude_only:
        return [(np.real, GREY, "W")]
    return [(np.real, BLUE, "Wd"), (np.imag, ORANGE, "Wq")]


def _sweeps(logs: Sequence[Numbered]) -> Figure:
    """Wd and Wq (or W) against frequency on the left, the resonance circle on the right; one colour for each log."""
    figure = blank(10, 4.6)
    frequencies = np.concatenate([f.log.frequency for _, f in logs if f.log.frequency is not None])
    middle = float(np.round(np.median(frequencies)))
    shift = middle if np.ptp(frequencies) < 0.2 * middle else 0.0
    kinds = [name for name in ("Wd", "Wq", "W") if any(part[2] == name for _, f in logs for part in _parts(f.log))]
    stack: dict[str, Axes] = {}
    for k, name in enumerate(kinds):
        stack[name] = figure.add_subplot(len(kinds), 2, 2 * k + 1, sharex=stack.get(kinds[0]))
    unit = clean(logs[0][1].log.response_unit)
    circle = figure.add_subplot(1, 2, 2)
    colours = matplotlib.colormaps["tab10"].colors  # type: ignore[attr-defined]
    for k, (number, fitted) in enumerate(logs):
        _one_sweep(stack, circle, fitted, shift, colours[k % 10], _name(number, fitted))
    for name, axes in stack.items():
        axes.set_ylabel(f"{name} ({unit})")
        axes.tick_params(labelbottom=name == kinds[-1])
        axes.locator_params(nbins=4)
    stack[kinds[-1]].set_xlabel(f"frequency - {shift:.0f} Hz (Hz)" if shift else "frequency (Hz)")
    circle.set(aspect="equal", xlabel=f"Wd ({unit})", ylabel=f"Wq ({unit})", adjustable="datalim")
    circle.legend(*_handles(stack, 12), loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    figure.subplots_adjust(0.065, 0.1, 0.99, 0.85, 0.16, 0.08)
    return figure


def _one_sweep(stack: Mapping[str, Axes], circle: Axes, fitted: "FittedLog", shift: float, colour: Any, name: str) -> None:
    log = fitted.log
    assert log.frequency is not None
    order = np.argsort(log.frequency, kind="stable")[_thin(len(log))]
    x, recorded = log.frequency[order] - shift, log.response[order]
    lines: list[tuple[np.ndarray, Any]] = [(recorded, DOTS | ({"label": name} if fitted.response is None else {}))]
    lines += [] if fitted.response is None else [(fitted.response[order], {"lw": 1.0, "label": name})]
    for values, style in lines:
        for part, _, which in _parts(log):
            stack[which].plot(x, part(values), color=colour, **style)
        if not log.amplitude_only:
            circle.plot(values.real, values.imag, color=colour, **style)


def _handles(stack: Mapping[str, Axes], most: int) -> tuple[list, list[str]]:
    found: dict[str, Any] = {}
    for axes in stack.values():
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values())[:most], list(found)[:most]


def _residuals(logs: Sequence[Numbered]) -> Figure:
    """Every log in a strip of its own width one, row by row; the band holds 95 % of normal noise."""
    figure = blank(10, 2.3)
    axes = figure.add_subplot()
    axes.axhspan(-1.96, 1.96, color="#eef2f7", lw=0)
    for place, (_, fitted) in enumerate(logs):
        keep = _thin(len(fitted.log))
        x = place + 0.04 + 0.92 * (np.arange(len(fitted.log)) + 0.5)[keep] / len(fitted.log)
        stds = [level.std for level in fitted.levels] or 2 * [fitted.noise_std or 1.0]
        for (part, colour, _), std in zip(_parts(fitted.log), stds, strict=False):
            axes.plot(x, part(fitted.residual)[keep] / std, ".", color=colour, alpha=0.5, mew=0)
    axes.set_xticks(np.arange(len(logs)) + 0.5, [str(number) for number, _ in logs])
    axes.vlines(np.arange(1, len(logs)), 0, 1, transform=axes.get_xaxis_transform(), color="#bbbbbb", lw=0.6)
    axes.set(xlim=(0, len(logs)), xlabel="log, each from its first row to its last", ylabel="residual / noise")
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")
    figure.subplots_adjust(0.065, 0.2, 0.995, 0.97)
    return figure


def _corner(posterior: "Posterior", parameters: Mapping[str, Mapping[str, Any]], names: Sequence[str]) -> Figure:
    """Marginals on the diagonal, pairs below it."""
    flat = [posterior.draws[name].ravel() for name in names]
    count = len(names)
    figure = blank(2 + 1.7 * count, 0.8 + 1.5 * count)
    for i in range(count):
        for j in range(i + 1):
            axes = figure.add_subplot(count, count, count * i + j + 1)
            axes.grid(visible=False)
            if i == j:
                axes.stairs(*np.histogram(flat[i], 30), fill=True, color=BLUE, alpha=0.7)
                axes.spines["left"].set_visible(False)
            else:
                keep = _thin(len(flat[i]))
                axes.plot(flat[j][keep], flat[i][keep], ".", color=BLUE, alpha=0.25, mew=0)
            _mark(axes, "x", names[j], flat[j], parameters[names[j]]["unit"], i == count - 1)
            if i == j:
                axes.set_yticks([])
            else:
                _mark(axes, "y", names[i], flat[i], parameters[names[i]]["unit"], j == 0)
    high = figure.get_figheight()
    figure.subplots_adjust(1.1 / figure.get_figwidth(), 0.75 / high, 0.985, 1 - 0.08 / high, 0.1, 0.1)
    return figure


def _predicted(prediction: "Prediction") -> Figure:
    """A panel each of Wd and Wq, or of W."""
    log, keep = prediction.log, _thin(len(prediction.log))
    sweep = _is_sweep(prediction)
    x, label = (log.frequency, "frequency (Hz)") if sweep else _inputs(prediction)
    order = np.argsort(x, kind="stable")[keep]
    parts = _parts(log)
    figure = blank(5.0 * len(parts), 2.9)
    for axes, (part, colour, name) in zip(figure.subplots(1, len(parts), squeeze=False).flat, parts, strict=True):
        middle, std, noise = (part(v)[order] for v in (prediction.response, prediction.std, prediction.total_std))
        for width, alpha, said in ((noise, 0.15, "with the noise"), (std, 0.5, "of the model")):
            axes.fill_between(x[order], middle - width, middle + width, color=colour, alpha=alpha, lw=0, label=f"± 1 std {said}")
        axes.plot(x[order], part(log.response)[order], color=colour, label="recorded", **DOTS)
        axes.plot(x[order], middle, color=colour, label="predicted")
        axes.set_ylabel(clean(f"{name} ({log.response_unit})"))
        axes.set_xlabel(label)
        axes.legend(frameon=False)
    figure.subplots_adjust(0.35 / figure.get_figwidth() * 1.6, 0.17, 0.985, 0.97, 0.22)
    return figure


def step_of(controller: Mapping[str, Any]) -> Figure:
    """The median over the plants in the band from 5 to 95 % of them, and the 5 % within which it counts as settled; beside it the
    voltage, with its limit."""
    shown = {name: np.array(values) for name, values in controller["promise"]["step_response"].items()}
    time, unit = time_axis(shown["time_s"])
    wanted = controller["range"]["amplitude"]
    figure = blank(5.2, 2.2)
    axes, beside = figure.subplots(1, 2)
    axes.axhspan(0.95 * wanted, 1.05 * wanted, color=GREY, alpha=0.15, lw=0)
    axes.fill_between(time, shown["W_5"], shown["W_95"], color=BLUE, alpha=0.3, lw=0)
    axes.plot(time, shown["W_50"], color=BLUE)
    axes.set(xlim=(0, time[-1]), ylim=(0, None), xlabel=unit)
    axes.set_ylabel(clean(f"|W| ({controller['units']['response'] or '1'})"))
    if "V_50" in shown:
        beside.fill_between(time, shown["V_5"], shown["V_95"], color=BLUE, alpha=0.3, lw=0, step="post")
        beside.plot(time, shown["V_50"], color=BLUE, drawstyle="steps-post")
    if (limit := controller["voltage_limit"]) is not None:
        beside.axhline(limit, color=GREY, lw=0.8, ls="--")
    beside.set(xlim=(0, time[-1]), ylim=(min(0.0, *shown.get("V_5", [0.0])), None), xlabel=unit)
    beside.set_ylabel(clean(f"V ({controller['units']['drive'] or '1'})"))
    figure.subplots_adjust(0.1, 0.21, 0.985, 0.97, 0.38)
    return figure


def bode_of(controller: Mapping[str, Any]) -> Figure:
    """|L| and the sensitivity |1 / (1 + L)|, and the phase of L, over frequency: medians, and 5 to 95 % of the plants."""
    shown = {name: np.array(values) for name, values in controller["promise"]["bode"].items()}
    figure = blank(5.2, 2.2)
    size, phase = figure.subplots(1, 2)
    for name, label, color in (("L", "|L|", BLUE), ("S", "|1 / (1 + L)|", GREY)):
        size.fill_between(shown["frequency_Hz"], shown[f"{name}_5"], shown[f"{name}_95"], color=color, alpha=0.3, lw=0)
        size.plot(shown["frequency_Hz"], shown[f"{name}_50"], color=color, label=label)
    size.axhline(1.0, color=GREY, lw=0.5)
    size.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylim=(0.02, None))
    size.legend(frameon=False, fontsize="small")
    phase.fill_between(shown["frequency_Hz"], shown["phase_deg_5"], shown["phase_deg_95"], color=BLUE, alpha=0.3, lw=0)
    phase.plot(shown["frequency_Hz"], shown["phase_deg_50"], color=BLUE)
    phase.axhline(-180.0, color=GREY, lw=0.8, ls="--")
    phase.set(xscale="log", xlabel="frequency (Hz)", ylim=(-270, -60))
    phase.set_ylabel("phase of L (degrees)")
    figure.subplots_adjust(0.1, 0.21, 0.985, 0.97, 0.38)
    return figure


def _mark(axes: Axes, which: str, name: str, draws: np.ndarray, unit: str, labelled: bool) -> None:
    """Ticks at the mean and two standard deviations, in digits that tell them apart."""
    mean, std = float(draws.mean()), float(draws.std())
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = float(draws.min()), float(draws.max())
    (axes.set_xlim if which == "x" else axes.set_ylim)((low, high) if high > low else None)
    ticks = [mean - 2 * std, mean, mean + 2 * std]
    if not labelled:
        axis.set_ticks(ticks, labels=[])
        return
    texts, shown = measured(mean, std, ticks, unit)
    axis.set_ticks(ticks, texts[2:], rotation=30, ha="right")
    axis.set_label_text(clean(f"{name} ({shown})"))
    axis.set_label_coords(*((0.5, -0.42) if which == "x" else (-0.47, 0.5)))


def _name(number: int, fitted: "FittedLog") -> str:
    name = clean(fitted.log.name)
    return f"{number}  {name if len(name) <= 44 else name[:20] + '...' + name[-21:]}"


def _thin(rows: int) -> slice:
    return slice(None, None, ceil(rows / POINTS))
