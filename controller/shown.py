"""A Loop and a Trace as people look at them: a few lines, a table, a figure."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.report.brief import Brief
from sysid.report.text import seconds

if TYPE_CHECKING:
    from controller.design import Loop
    from controller.trace import Trace


def of_loop(loop: "Loop") -> Brief:
    """Of a loop: what it is made for, and what it promises."""
    promise, limit, unit = loop.promise, loop.limits.voltage, loop.response_unit or ""
    plate = "" if loop.plate is None else f" for the plate {loop.plate}"
    head = f"Loop: {loop.method}{plate}, a sample every {seconds(loop.sample_time)}"
    settling = seconds(promise.settling) if np.isfinite(promise.settling) else "none, as a note says"
    margins = f"gain {promise.gain:.3g}, phase {promise.phase:.3g} deg, disk {promise.disk:.3g}"
    f0 = "not known: no tracker" if loop.f0 is None else f"{loop.f0:.8g} Hz"
    rows = [
        ("plate", f"G {loop.G:.6g}, tau {seconds(loop.tau)}, f0 {f0}"),
        ("closed loop", f"{loop.bandwidth_hz:.4g} Hz, by {loop.bandwidth_bound}"),
        ("settling to 5 %", f"{settling}, to {loop.amplitude:.4g} {unit}".rstrip()),
        ("margins", margins),
        ("voltage limit", "none" if limit is None else f"{limit:.4g} {loop.drive_unit or ''}".rstrip()),
    ]
    return Brief(head, ("", "kept by 99 % of the plants"), tuple(rows), tuple(loop.notes[:3]))


def of_trace(trace: "Trace") -> Brief:
    """Of a closed-loop run: where each signal began, was at most, and ended."""
    signals = {name: v for name, v in columns(trace).items() if name != "time_s" and len(v)}
    span = trace.time[-1] - trace.time[0] if len(trace.time) else 0.0
    head = f"Trace: {len(trace.time)} samples over {seconds(float(span))}"
    rows = tuple((name, *(f"{x:.6g}" for x in (v[0], np.max(v), v[-1]))) for name, v in signals.items())
    return Brief(head, ("signal", "first", "largest", "last"), rows, headed=True)


def columns(trace: "Trace") -> dict[str, np.ndarray]:
    """The signals (n,) of a run by the names of a log's columns, which end in their units."""
    from sysid.logs.written import label

    w, v = (lambda name: label(trace.response_unit or "1", name)), label(trace.drive_unit or "1", "drive")
    told = {w("measured_wd"): trace.measured.real, w("measured_wq"): trace.measured.imag}
    moved = {w("wd"): trace.Wd, w("wq"): trace.Wq, w("w"): trace.W, w("reference"): trace.reference}
    return {"time_s": trace.time, v: trace.V, "frequency_Hz": trace.f} | moved | told


def trace_frame(trace: "Trace") -> Any:
    """A DataFrame of the signals."""
    import pandas as pd

    return pd.DataFrame(columns(trace))


def trace_figure(trace: "Trace") -> Any:
    """Four panels over time."""
    from sysid.report.plots import BLUE, GREY, ORANGE, blank, styled, time_axis

    def drawn() -> Any:
        """The figure of matplotlib."""
        figure = blank(8.0, 4.0)
        time, label = time_axis(trace.time)
        unit, drive = trace.response_unit or "1", trace.drive_unit or "1"
        wanted = [
            (f"|W| ({unit})", ((trace.reference, GREY, "asked for"), (trace.W, BLUE, "|W|"))),
            (f"Wd, Wq ({unit})", ((trace.Wd, BLUE, "Wd"), (trace.Wq, ORANGE, "Wq"))),
            (f"V ({drive})", ((trace.V, BLUE, ""),)),
            ("f (Hz)", ((trace.f, BLUE, ""),)),
        ]
        for axes, (name, lines) in zip(figure.subplots(2, 2, sharex=True).flat, wanted, strict=True):
            for values, colour, said in lines:
                axes.plot(time, values, color=colour, label=said)
            axes.set_ylabel(name)
            axes.ticklabel_format(axis="y", useOffset=False)
            if len(lines) > 1:
                axes.legend(frameon=False)
        for axes in figure.axes[-2:]:
            axes.set_xlabel(label)
        figure.subplots_adjust(0.09, 0.13, 0.985, 0.97, 0.28, 0.12)
        return figure

    return styled(drawn)
