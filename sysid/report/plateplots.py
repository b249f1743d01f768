"""The figures of the plate: what each log makes of it beside all of them, its resonance over temperature, the
circle of its responses, and the draws of its parameters."""

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid.posterior.each import OWN, Own
from sysid.report.canvas import BAND, BLACK, BLUE, DOTS, ORANGE, WIDE, Picture, blank, thin
from sysid.report.logplots import Colours, Numbered, Plane, named
from sysid.report.text import clean, listed, measured

if TYPE_CHECKING:
    from sysid.posterior.posterior import Posterior
    from sysid.verdict.fitted import Fit

LISTED = 40  # logs one below the other
FAR = 3.0  # standard deviations, from which a log is marked
WIDEST = 12.0  # errors of the log that tells most, to which an axis reaches at least
INSIDE = 1.96
LEAST_WARMING = 0.1  # degC between logs, from which f0 is drawn over temperature


def of_plate(fit: "Fit", each: Sequence[Own]) -> list[Picture]:
    """What there is to draw of the plate: of each log beside all, over temperature, and as a circle."""
    found, several = [], len(each) > 1 and any(own.off for own in each)
    if several:
        ranked = sorted(each, key=lambda own: -own.worst)[:LISTED]
        note = (
            "What each log makes of the plate by itself, with errors of 95 %, off what all logs make of it"
            " (the band); to first order, so that large differences are roughly as large. The log that"
            " differs most stands first."
        )
        note += f" {len(each) - LISTED} logs that differ less are not drawn." if len(each) > LISTED else ""
        found.append(
            Picture(
                "Each log beside the joint fit", lambda: _each(fit, ranked), lambda: _seen_each(ranked), note
            )
        )
    warm = [own for own in each if own.warming is not None and "f0" in own.off]
    if fit.parameters["k_T"].determined and warm and np.ptp([own.warming for own in warm]) > LEAST_WARMING:
        title = "Resonance over temperature"
        note = "Each log's own f0 with its error of 95 %; the line and its band of 95 % are of the joint fit."
        found.append(Picture(title, lambda: _warmed(fit, warm), lambda: _seen_warmed(fit, warm), note))
    if round_ := [own for own in each if own.circle is not None]:
        note = "Response over drive; each log's turn of the demodulator and its background are taken out."
        found.append(
            Picture(
                "Resonance circle", lambda: _circles(fit, round_), lambda: _seen_circles(fit, round_), note
            )
        )
    return found


def of_posterior(posterior: "Posterior", parameters: Mapping[str, Any]) -> list[Picture]:
    """The draws, of parameters whose draws the logs bound: others may reach to infinity."""
    bounded = [name for name, p in parameters.items() if p["determined"] or _modes(p)]
    names = [name for name in bounded if name in posterior.draws]
    if not names:
        return []
    flat = {name: posterior.draws[name].ravel() for name in names}
    note = "Draws of the posterior; the marks are at the mean and two standard deviations."
    return [Picture("Posterior", lambda: _corner(flat, parameters), lambda: _seen_posterior(flat), note)]


def _modes(parameter: Any) -> bool:
    """Whether a parameter, of fit.json or of a summary, has separate values."""
    return bool(parameter.get("modes") if isinstance(parameter, Mapping) else parameter.modes)


# --- each log beside all ---


def _each(fit: "Fit", logs: Sequence[Own]) -> Figure:
    """A column for each parameter, a row for each log."""
    names = [n for n in OWN if any(n in own.off for own in logs)]
    high = 0.75 + 0.17 * len(logs)
    figure = blank(WIDE, high)
    row = np.arange(len(logs))
    for k, name in enumerate(names):
        axes = figure.add_subplot(1, len(names), k + 1)
        factor, unit = (1.0, "Hz") if name == "f0" else (100.0, "%")
        wide = INSIDE * factor * _joint_std(fit, name)
        axes.axvspan(-wide, wide, color=BAND, lw=0)
        axes.axvline(0.0, color=BLACK, lw=0.6)
        told = [i for i, own in enumerate(logs) if name in own.off]
        off, error = (
            np.array([factor * getattr(logs[i], key)[name] for i in told]) for key in ("off", "error")
        )
        for i, x, dx in zip(told, off, error, strict=True):
            colour = ORANGE if abs(logs[i].apart[name]) > FAR else BLUE
            axes.plot([x - INSIDE * dx, x + INSIDE * dx], [i, i], color=colour, lw=1.0)
            axes.plot(
                [x], [i], "D" if colour == ORANGE else "o", color=colour, ms=4 if colour == ORANGE else 3
            )
        reach = np.max(np.where(error < WIDEST * np.min(error), np.abs(off) + INSIDE * error, np.abs(off)))
        axes.set(
            xlim=(-1.1 * reach, 1.1 * reach), ylim=(len(logs) - 0.4, -0.6), xlabel=f"{name} - joint ({unit})"
        )
        axes.locator_params(axis="x", nbins=3)
        axes.grid(visible=False, axis="y")
        axes.set_yticks(row, [named(own.number, own.name, 22) for own in logs] if k == 0 else [])
        axes.tick_params(axis="y", length=0)
    figure.subplots_adjust(0.335, 0.42 / high, 0.98, 1 - 0.08 / high, 0.12)
    return figure


def _joint_std(fit: "Fit", name: str) -> float:
    """Of the joint estimate: of G and tau as a share of the value."""
    value, std = fit.estimate(name)
    return std if name == "f0" else std / value


def _seen_each(logs: Sequence[Own]) -> str:
    told = [(own, name, z) for own in logs for name, z in own.apart.items()]
    far = sum(abs(z) > FAR for _, _, z in told)
    own, name, z = max(told, key=lambda x: abs(x[2]))
    off = f"more than {FAR:g} standard deviations off the joint fit"
    where = f"{abs(z):.2g} {'above' if z > 0 else 'below'} it"
    said = f"{far} of {len(told)} estimates of single logs are {off}"
    return f"{said}; the farthest is {name} of {named(own.number, own.name)}, {where}."


# --- over temperature ---


def _line(fit: "Fit", warming: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) f0, Hz, so many degC above the fit's temperature, and its standard deviation."""
    f0, k_T = fit.estimate("f0")[0], fit.estimate("k_T")[0]
    index = [fit.names.index(n) for n in ("f0", "k_T")]
    rows = np.stack([np.ones_like(warming), warming], axis=1)
    return f0 + k_T * warming, np.sqrt(
        np.einsum("ni,ij,nj->n", rows, fit.covariance[np.ix_(index, index)], rows)
    )


def _warmed(fit: "Fit", logs: Sequence[Own]) -> Figure:
    """f0 on the left, less the line on the right."""
    at = fit.reference_temperature or 0.0
    figure = blank(WIDE, 2.3)
    left, right = figure.subplots(1, 2)
    warming = np.array([own.warming for own in logs], float)
    off, error = (np.array([getattr(own, key)["f0"] for own in logs]) for key in ("off", "error"))
    span = 0.06 * np.ptp(warming)
    along = np.linspace(warming.min() - span, warming.max() + span, 60)
    (middle, std), (there, _) = _line(fit, along), _line(fit, warming)
    shift = float(np.round(np.median(middle)))
    for axes, line, points in ((left, middle - shift, there - shift + off), (right, 0 * middle, off)):
        axes.fill_between(at + along, line - INSIDE * std, line + INSIDE * std, color=BLUE, alpha=0.3, lw=0)
        axes.plot(at + along, line, color=BLUE)
        axes.errorbar(at + warming, points, INSIDE * error, fmt="o", color=ORANGE, elinewidth=0.8, ms=3)
        axes.set_xlabel("temperature (degC)")
        axes.locator_params(nbins=5)
    reach = 1.15 * np.max(np.abs(off) + np.where(error < WIDEST * np.min(error), INSIDE * error, 0.0))
    right.set(ylim=(-reach, reach), ylabel="f0 - line (Hz)")
    left.set_ylabel(f"f0 - {shift:.0f} Hz (Hz)")
    figure.subplots_adjust(0.115, 0.19, 0.985, 0.97, 0.34)
    return figure


def _seen_warmed(fit: "Fit", logs: Sequence[Own]) -> str:
    k_T, std = fit.estimate("k_T")
    (slope, error), _ = measured(k_T, std)
    low, high = (f(own.warming for own in logs) + (fit.reference_temperature or 0.0) for f in (min, max))
    own = max(logs, key=lambda own: abs(own.apart["f0"]))
    way = "falls" if k_T < 0 else "rises"
    line = f"along a line of {slope} ± {error} Hz/degC"
    said = f"f0 of {len(logs)} logs at {low:.3g} to {high:.3g} degC {way} {line}"
    off = f"{abs(own.apart['f0']):.2g} standard deviations off"
    return f"{said}; the log farthest from it, {named(own.number, own.name)}, is {off}."


# --- circle ---


def _circles(fit: "Fit", logs: Sequence[Own]) -> Figure:
    """All sweeps in one plane."""
    numbered: Any = [(own.number, fit.logs[own.number - 1]) for own in logs]
    colours = Colours.of(numbered)
    figure = blank(WIDE, 3.6 + colours.room)
    axes, plane = figure.add_subplot(), _plane(fit, logs)
    for own in logs:
        recorded, model = _round(fit, own, plane)
        order = np.argsort(_frequency(numbered, own), kind="stable")[thin(len(model))]
        label = named(own.number, own.name, 30)
        axes.plot(recorded[order].real, recorded[order].imag, color=colours.by_number[own.number], **DOTS)
        axes.plot(
            model[order].real, model[order].imag, color=colours.by_number[own.number], lw=1.0, label=label
        )
    axes.set(aspect="equal", xlabel=plane.label("Wd"), ylabel=plane.label("Wq"), adjustable="datalim")
    axes.locator_params(nbins=6)
    high = figure.get_figheight()
    figure.subplots_adjust(0.14, 0.42 / high, 0.985, 1 - colours.room / high)
    colours.explained(figure, {"": axes})
    return figure


def _plane(fit: "Fit", logs: Sequence[Own]) -> Plane:
    """The responses over their drives."""
    plane = Plane.of([fit.logs[own.number - 1].log for own in logs])
    if plane.names["W"] == "|Y|":
        return plane
    return Plane({"Wd": "Wd / V", "Wq": "Wq / V", "W": "W / V"}, clean(fit.units["G"]), plane.factor)


def _round(fit: "Fit", own: Own, plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """The circle (n,) of a log, recorded and modelled, which is over the drive already."""
    recorded, model = own.circle or (np.zeros(0), np.zeros(0))
    log = fit.logs[own.number - 1].log
    factor = plane.factor(log) * (log.drive if plane.names["W"] == "|Y|" else 1.0)
    return factor * recorded, factor * model


def _frequency(logs: Sequence[Numbered], own: Own) -> np.ndarray:
    return next(f.log.frequency for number, f in logs if number == own.number)


def _seen_circles(fit: "Fit", logs: Sequence[Own]) -> str:
    plane = _plane(fit, logs)
    circles = [_round(fit, own, plane) for own in logs if own.circle]
    off = [float(np.sqrt(np.mean(np.abs(recorded - model) ** 2))) for recorded, model in circles]
    size = max(float(np.max(np.abs(model))) for _, model in circles)
    of = f"{len(logs)} sweeps" if len(logs) > 1 else "The sweep"
    beside = f"{of} beside the fit's circle of diameter {size:.4g} {plane.unit} through zero"
    return f"{beside}, off it by {100 * max(off) / size:.2g} % (rms) at most."


# --- the draws ---


def _corner(flat: Mapping[str, np.ndarray], parameters: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Marginals on the diagonal, pairs below it."""
    names, count = list(flat), len(flat)
    size = max(WIDE, 0.95 * count + 0.9)
    wide, high = size, size * 0.72 if count > 1 else 2.2
    figure = blank(wide, high)
    figure.subplots_adjust(0.85 / wide, 0.72 / high, 0.985, 1 - 0.06 / high, 0.08, 0.08)
    for j, i in combinations_with_replacement(range(count), 2):
        axes = figure.add_subplot(count, count, count * i + j + 1)
        axes.grid(visible=False)
        if i == j:
            axes.stairs(*np.histogram(flat[names[i]], 30), fill=True, color=BLUE, alpha=0.7)
            axes.spines["left"].set_visible(False)
        else:
            keep = thin(len(flat[names[i]]))
            x, y = flat[names[j]][keep], flat[names[i]][keep]
            axes.plot(x, y, ".", color=BLUE, alpha=0.35, mew=0, ms=2, rasterized=True)
        _mark(axes, "x", names[j], flat[names[j]], parameters[names[j]]["unit"], i == count - 1)
        if i == j:
            axes.set_yticks([])
        else:
            _mark(axes, "y", names[i], flat[names[i]], parameters[names[i]]["unit"], j == 0)
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
    axis.set_ticks(ticks, texts[2:], fontsize=7)
    if which == "x":
        for label in axis.get_ticklabels():
            label.set(rotation=35, ha="right", rotation_mode="anchor")
    axis.set_label_text(clean(f"{name} ({shown})"))
    (wide, high), box = axes.figure.get_size_inches(), axes.get_position()  # type: ignore[union-attr]
    axis.set_label_coords(
        *((0.5, -0.6 / (high * box.height)) if which == "x" else (-0.72 / (wide * box.width), 0.5))
    )


def _seen_posterior(flat: Mapping[str, np.ndarray]) -> str:
    names = list(flat)
    if len(names) == 1:
        return f"The draws of {names[0]}, as a histogram."
    table = np.corrcoef([flat[name] for name in names])
    pairs = [(table[i, j], names[j], names[i]) for i in range(len(names)) for j in range(i)]
    size, first, second = max(pairs, key=lambda pair: np.nan_to_num(abs(pair[0])))
    tied = f"{first} and {second} have the correlation {size:+.2f}, the others less"
    return f"Draws of {listed(names)}: histograms, and clouds of each pair; {tied}."
