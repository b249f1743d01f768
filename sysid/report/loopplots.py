"""The figures of the controller, of controller.json's content: the step that is promised beside that of the
plate alone, and the loop over frequency."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from sysid.report.canvas import BAND, BLUE, GREY, ORANGE, WIDE, Picture, blank, time_axis
from sysid.report.text import clean, seconds

Content = Mapping[str, Any]
Draws = Mapping[str, np.ndarray]
SETTLED = 3.0  # time constants, after which a first-order step is within 5 %


def of_loop(controller: Content | None, draws: Draws) -> list[Picture]:
    """What there is to draw of a controller; `draws` of the plant's parameters."""
    if not controller:
        return []
    note = (
        "Medians and 5 to 95 % of the plants that the logs allow; dashed the voltage limit, dotted the plate"
    )
    note += " alone, at the resonance and untouched, under the constant voltage that leads there."
    title = "Step response, open and closed loop"
    found = [Picture(title, lambda: step_of(controller, draws), lambda: _seen_step(controller), note)]
    if controller["promise"].get("bode"):
        note = "Medians and 5 to 95 % of the plants that the logs allow."
        title = "Open loop and sensitivity over frequency"
        found.append(Picture(title, lambda: bode_of(controller), lambda: _seen_bode(controller), note))
    return found


def step_of(controller: Content, draws: Draws | None = None) -> Figure:
    """The median over the plants in the band from 5 to 95 % of them, and the 5 % within which it counts as
    settled; beside it the voltage, with its limit. Dotted the plate alone under a constant voltage, with the
    band of its `draws`."""
    shown = {name: np.array(values) for name, values in controller["promise"]["step_response"].items()}
    time, unit = time_axis(shown["time_s"])
    wanted, drive = controller["range"]["amplitude"], wanted_drive(controller)
    figure = blank(WIDE, 2.3)
    axes, beside = figure.subplots(1, 2)
    axes.axhspan(0.95 * wanted, 1.05 * wanted, color=BAND, lw=0)
    _open_loop(axes, controller, draws)
    axes.fill_between(time, shown["W_5"], shown["W_95"], color=BLUE, alpha=0.3, lw=0)
    axes.plot(time, shown["W_50"], color=BLUE, label="closed loop")
    axes.set(xlim=(0, time[-1]), ylim=(0, None), xlabel=unit)
    axes.set_ylabel(clean(f"|W| ({controller['units']['response'] or '1'})"))
    axes.legend(frameon=False, loc="lower right")
    if drive is not None:
        beside.axhline(drive, color=ORANGE, ls=":")
    if "V_50" in shown:
        beside.fill_between(time, shown["V_5"], shown["V_95"], color=BLUE, alpha=0.3, lw=0, step="post")
        beside.plot(time, shown["V_50"], color=BLUE, drawstyle="steps-post")
    if (limit := controller["voltage_limit"]) is not None:
        beside.axhline(limit, color=GREY, lw=0.8, ls="--")
    beside.set(xlim=(0, time[-1]), ylim=(min(0.0, *shown.get("V_5", [0.0])), None), xlabel=unit)
    beside.set_ylabel(clean(f"V ({controller['units']['drive'] or '1'})"))
    figure.subplots_adjust(0.1, 0.19, 0.985, 0.97, 0.36)
    return figure


def wanted_drive(controller: Content) -> float | None:
    """The constant voltage that leads to the amplitude at resonance; None where G is not known."""
    gain = controller["plant"].get("G")
    return controller["range"]["amplitude"] / gain if gain else None


def _open_loop(axes: Axes, controller: Content, draws: Draws | None) -> None:
    """|W| = V G (1 - e^(-t/tau)) of the plate, at resonance."""
    plant, wanted = controller["plant"], controller["range"]["amplitude"]
    time = np.linspace(0, controller["promise"]["step_response"]["time_s"][-1], 80)
    scaled, _ = time_axis(time)
    if draws is not None and {"G", "tau"} <= set(draws) and plant.get("G"):
        G, tau = (np.ravel(draws[name])[:, None] for name in ("G", "tau"))
        low, high = np.quantile(wanted * G / plant["G"] * -np.expm1(-time / tau), [0.05, 0.95], axis=0)
        axes.fill_between(scaled, low, high, color=ORANGE, alpha=0.25, lw=0)
    axes.plot(scaled, -wanted * np.expm1(-time / plant["tau"]), color=ORANGE, ls=":", label="plate alone")


def bode_of(controller: Content) -> Figure:
    """|L| and the sensitivity |1 / (1 + L)|, and the phase of L, over frequency: medians, and 5 to 95 % of
    the plants."""
    shown = {name: np.array(values) for name, values in controller["promise"]["bode"].items()}
    figure = blank(WIDE, 2.3)
    size, phase = figure.subplots(1, 2)
    for name, label, color in (("L", "|L|", BLUE), ("S", "|1 / (1 + L)|", ORANGE)):
        size.fill_between(
            shown["frequency_Hz"], shown[f"{name}_5"], shown[f"{name}_95"], color=color, alpha=0.3, lw=0
        )
        size.plot(
            shown["frequency_Hz"],
            shown[f"{name}_50"],
            color=color,
            label=label,
            ls="-" if name == "L" else "--",
        )
    size.axhline(1.0, color=GREY, lw=0.5)
    size.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylim=(0.02, None))
    size.legend(frameon=False)
    phase.fill_between(
        shown["frequency_Hz"], shown["phase_deg_5"], shown["phase_deg_95"], color=BLUE, alpha=0.3, lw=0
    )
    phase.plot(shown["frequency_Hz"], shown["phase_deg_50"], color=BLUE)
    phase.axhline(-180.0, color=GREY, lw=0.8, ls="--")
    phase.set(xscale="log", xlabel="frequency (Hz)", ylim=(-270, -60))
    phase.set_ylabel("phase of L (degrees)")
    for axis in (size.xaxis, size.yaxis, phase.xaxis):
        plain_ticks(axis)
    figure.subplots_adjust(0.1, 0.19, 0.985, 0.97, 0.36)
    return figure


def plain_ticks(axis: Any, subs: tuple[float, ...] = (1.0,)) -> None:
    """Plain numbers at each decade, or at `subs` of it, of a logarithmic axis."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _seen_step(controller: Content) -> str:
    promise, units = controller["promise"], controller["units"]
    to = f"From rest to {controller['range']['amplitude']:.4g} {units['response'] or ''}".rstrip()
    taken = f"within {seconds(promise['settling_s'])}" if promise["settling_s"] is not None else "not at all"
    volts, unit = promise["step_response"].get("V_50"), units["drive"] or ""
    said = f" under up to {max(volts):.3g} {unit}, then {volts[-1]:.3g} {unit}" if volts else ""
    alone = seconds(SETTLED * controller["plant"]["tau"])
    return clean(f"{to} the closed loop settles to 5 % {taken}{said}; the plate alone takes {alone}.")


def _seen_bode(controller: Content) -> str:
    bode = {name: np.array(values) for name, values in controller["promise"]["bode"].items()}
    frequency, L, S = bode["frequency_Hz"], bode["L_50"], bode["S_50"]
    peak = f"the sensitivity is at most {np.max(S):.3g}, at {frequency[np.argmax(S)]:.3g} Hz"
    below = np.flatnonzero(L < 1)
    if not len(below) or not below[0]:
        return f"|L| over {frequency[0]:.3g} to {frequency[-1]:.3g} Hz; {peak}."
    k = below[0]
    at = np.interp(0.0, np.log(L[[k, k - 1]]), np.log(frequency[[k, k - 1]]))
    turn = np.interp(at, np.log(frequency), bode["phase_deg_50"])
    crossing = f"is 1 at {np.exp(at):.3g} Hz, where its phase is {turn:.0f} degrees"
    return f"|L| falls with frequency and {crossing}; {peak}."
