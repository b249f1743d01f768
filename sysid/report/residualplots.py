"""The figures of what a fit leaves of its logs: residuals in units of their noise, and how neighbours among
them are correlated."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.report.canvas import BAND, GREY, PALETTE, WIDE, Picture, blank, thin
from sysid.report.logplots import Numbered, is_sweep, named, parts
from sysid.trials.noise import independent
from sysid.trials.whitening import clock_of

if TYPE_CHECKING:
    from sysid.verdict.fitted import FittedLog

STRIPS = 16  # residuals side by side
LAGS = 20  # rows
NAMED = 3  # logs whose correlation stands out, by name
RARE = 4.0  # standard errors: one correlation in 16 000 of white noise
INSIDE = 1.96  # standard deviations, between which 95 % of normal noise are


def of_residuals(logs: "Sequence[FittedLog]") -> list[Picture]:
    """What the fit leaves."""
    numbered = list(enumerate(logs, 1))
    note = "Each log from its first row to its last; the band holds 95 % of normal noise."
    found = [
        Picture(
            "Residuals, in units of the noise",
            lambda: _residuals(numbered),
            lambda: _seen_residuals(numbered),
            note,
        )
    ]
    lines = [(number, f, line) for number, f in numbered if len(line := correlation(f)) > 1]
    note = "Of neighbours so many rows apart, the noise's own correlation taken out;"
    note += " 95 % lie in the band where only noise is left."
    said = Picture(
        "Correlation of the residuals", lambda: _correlations(lines), lambda: _seen_correlations(lines), note
    )
    return found + ([said] if lines else [])


def _residuals(logs: Sequence[Numbered]) -> Figure:
    """Every log in a strip of its own width one, row by row; the band holds 95 % of normal noise."""
    rows = [logs[k : k + STRIPS] for k in range(0, len(logs), STRIPS)]
    high = 0.55 + 1.25 * len(rows) + 0.35 * (len(rows) == 1)
    figure = blank(WIDE, high)
    for axes, few in zip(
        np.ravel(figure.subplots(len(rows), 1, sharey=True, squeeze=False)), rows, strict=True
    ):
        axes.axhspan(-INSIDE, INSIDE, color=BAND, lw=0)
        for place, (_, fitted) in enumerate(few):
            for values, colour in _scaled(fitted):
                keep = thin(len(values))
                x = place + 0.04 + 0.92 * (np.arange(len(values)) + 0.5)[keep] / len(values)
                axes.plot(x, values[keep], ".", color=colour, alpha=0.6, mew=0, rasterized=True)
        axes.set_xticks(np.arange(len(few)) + 0.5, [str(number) for number, _ in few])
        axes.vlines(
            np.arange(1, len(few)), 0, 1, transform=axes.get_xaxis_transform(), color=GREY, lw=0.4, alpha=0.6
        )
        axes.set(xlim=(0, STRIPS if len(rows) > 1 else len(few)))
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False, axis="x")
    axes.set_xlabel("log")
    figure.supylabel("residual / noise", fontsize=8, x=0.005)
    figure.subplots_adjust(0.09, 0.4 / high, 0.985, 1 - 0.06 / high, hspace=0.25)
    return figure


def _scaled(fitted: "FittedLog") -> list[tuple[np.ndarray, str]]:
    """Real parts (n,) of a residual in units of their noise, and the colour of each."""
    stds = [level.std for level in fitted.levels] or 2 * [fitted.noise_std or 1.0]
    return [
        (part(fitted.residual) / std, colour)
        for (part, colour, _), std in zip(parts(fitted.log), stds, strict=False)
    ]


def _seen_residuals(logs: Sequence[Numbered]) -> str:
    each = [(number, f, np.concatenate([values for values, _ in _scaled(f)])) for number, f in logs]
    every = np.abs(np.concatenate([values for _, _, values in each]))
    number, f, _ = max(each, key=lambda x: np.nan_to_num(np.max(np.abs(x[2]))))
    inside = (
        f"{100 * np.mean(every < INSIDE):.1f} % of {len(every)} residuals lie within {INSIDE} of their noise"
    )
    return f"{inside}; the largest is {np.max(every):.3g}, of {named(number, f.log.name)}."


def correlation(fitted: "FittedLog") -> np.ndarray:
    """(k,) of residuals 1 to k rows apart, in its standard errors, 1/sqrt(numbers); the noise's own
    correlation is taken out. Of a sweep the rows go by frequency."""
    order = np.argsort(fitted.log.frequency, kind="stable") if is_sweep(fitted) else slice(None)
    clock = clock_of(fitted.log)
    levels = [(level.std, level.time) for level in fitted.levels] or 2 * [
        (fitted.noise_std or 1.0, fitted.noise_time)
    ]
    sums, power, numbers = np.zeros(min(LAGS, len(clock) // 4)), 0.0, 0
    for (part, _, _), (std, time) in zip(parts(fitted.log), levels, strict=False):
        x = independent(part(fitted.residual) / std, clock, time)[order]
        sums += [x[k:] @ x[:-k] for k in range(1, len(sums) + 1)]
        power, numbers = power + float(x @ x), numbers + len(x)
    return sums / power * np.sqrt(numbers) if power > 0 else sums[:0]


Line = tuple[int, "FittedLog", np.ndarray]


def _standing_out(lines: Sequence[Line]) -> list[Line]:
    """The logs whose residuals are no noise, the worst first."""
    found = [line for line in lines if np.max(np.abs(line[2])) > RARE]
    return sorted(found, key=lambda line: -np.max(np.abs(line[2])))[:NAMED]


def _correlations(lines: Sequence[Line]) -> Figure:
    """One thin line for each log; those that stand out in colour and by name."""
    figure = blank(WIDE, 2.2)
    axes = figure.add_subplot()
    axes.axhspan(-INSIDE, INSIDE, color=BAND, lw=0)
    out = _standing_out(lines)
    for number, _, values in lines:
        if number not in [o[0] for o in out]:
            axes.plot(np.arange(1, len(values) + 1), values, color=GREY, lw=0.8, alpha=0.5)
    for (number, f, values), colour in zip(out, PALETTE, strict=False):
        axes.plot(
            np.arange(1, len(values) + 1), values, "o-", color=colour, label=named(number, f.log.name, 30)
        )
    axes.set(
        xlabel="rows apart",
        ylabel="correlation / its error",
        xlim=(0.5, max(len(v) for _, _, v in lines) + 0.5),
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if out:
        axes.legend(frameon=False)
    figure.subplots_adjust(0.1, 0.19, 0.985, 0.97)
    return figure


def _seen_correlations(lines: Sequence[Line]) -> str:
    every = np.abs(np.concatenate([values for _, _, values in lines]))
    share = 100 * np.mean(every < INSIDE)
    inside = f"Of {len(every)} correlations of residuals {share:.0f} % are within {INSIDE} standard errors"
    number, f, values = max(lines, key=lambda line: np.max(np.abs(line[2])))
    lag = int(np.argmax(np.abs(values)))
    return (
        f"{inside}; the largest is {values[lag]:+.2g}, {lag + 1} rows apart, of {named(number, f.log.name)}."
    )
