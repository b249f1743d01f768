"""Pictures of what accuracy costs: numerical error against work, for the report; against wall time, for the
user's own logs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid.report.canvas import BLUE, GREY, ORANGE, WIDE, Picture, blank, png, styled
from sysid.report.loopplots import plain_ticks

ERROR = "error / standard deviation"


def of_ladder(rungs: Sequence[Mapping[str, Any]]) -> list[Picture]:
    """What there is to draw of the `rungs` of fit.json. Work is counted, not timed: the same logs give the
    same figure."""
    known = [r for r in rungs if r["error"]]
    return (
        [Picture("What accuracy costs", lambda: _ladder(known), lambda: _seen_ladder(known))] if known else []
    )


def curve_figure(points: Sequence[Any]) -> bytes:
    """PNG image of a cost curve's points."""
    return png(styled(lambda: _curve(points)))


def _seen_ladder(rungs: Sequence[Mapping[str, Any]]) -> str:
    each = [f"{r['accuracy']} {r['error']:.1g} after {r['evaluations']} evaluations" for r in rungs]
    return f"Numerical errors in standard deviations, which fall with the work: {'; '.join(each)}."


def _ladder(rungs: Sequence[Mapping[str, Any]]) -> Figure:
    figure = blank(WIDE, 2.4)
    axes = figure.add_subplot()
    work, error = [r["evaluations"] for r in rungs], [r["error"] for r in rungs]
    axes.loglog(work, error, "o-", color=BLUE, ms=6)
    for rung in rungs:
        _named(axes, rung["accuracy"], rung["evaluations"], rung["error"])
    n = np.geomspace(min(work), 4 * max(work), 50)
    axes.loglog(
        n, 2.7 / np.sqrt(n), ls="--", color=GREY
    )  # of an interval's end: sqrt(p (1 - p) / n) / density
    axes.text(n[25], 3.2 / np.sqrt(n[25]), "interval of as many draws", color=GREY)
    axes.set(xlabel="evaluations of the density", ylabel=ERROR, xlim=(0.6 * min(work), 5 * max(work)))
    axes.set_ylim(0.4 * min(error), 2.5 * max(*error, 2.7 / np.sqrt(n[0])))
    _ticks(axes)
    figure.subplots_adjust(0.13, 0.19, 0.98, 0.96)
    return figure


def _curve(points: Sequence[Any]) -> Figure:
    figure = blank(6.4, 3.6)
    axes = figure.add_subplot()
    for name, colour, times in (
        ("first run, which compiles", ORANGE, [p.cold_s for p in points]),
        ("later runs", BLUE, [p.warm_s for p in points]),
    ):
        axes.loglog(
            times, [p.error for p in points], "o-", color=colour, ms=6, label=f"{name}: error as stated"
        )
        apart = [(t, p.distance) for t, p in zip(times, points, strict=True) if p.distance]
        label = f"found, by the distance from {points[-1].accuracy}" if colour == BLUE else None
        axes.loglog(*zip(*apart, strict=True), "x", color=colour, ms=7, label=label)
        for t, p in zip(times, points, strict=True):
            _named(axes, p.accuracy, t, p.error)
    every = [t for p in points for t in (p.cold_s, p.warm_s)]
    axes.set(
        xlabel="seconds until the numbers are there", ylabel=ERROR, xlim=(0.7 * min(every), 2 * max(every))
    )
    _ticks(axes)
    axes.legend(frameon=False)
    figure.subplots_adjust(0.11, 0.14, 0.98, 0.97)
    return figure


def _ticks(axes: Axes) -> None:
    """Plain numbers at 1, 2, 5 of each decade."""
    for axis in (axes.xaxis, axes.yaxis):
        plain_ticks(axis, (1, 2, 5))


def _named(axes: Axes, name: str, x: float, y: float) -> None:
    axes.annotate(name, (x, y), (6, 5), textcoords="offset points")
