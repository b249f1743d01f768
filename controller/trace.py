"""What a closed loop did: its signals over time, and when it has settled."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.shown import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Shown):
    """A closed-loop run, one row for each sample (n,): `time` s; the plate's own motion `Wd`, `Wq`, `W` and
    what the controller was told, `measured`, in the `response_unit`; the command V (`drive_unit`) and f (Hz);
    the `reference` that was asked for. Units are None when nobody stated them."""

    time: np.ndarray
    Wd: np.ndarray
    Wq: np.ndarray
    V: np.ndarray
    f: np.ndarray
    reference: np.ndarray
    measured: np.ndarray
    response_unit: str | None = None
    drive_unit: str | None = None

    @property
    def W(self) -> np.ndarray:
        """Peak amplitude |Wd + j Wq|."""
        return np.hypot(self.Wd, self.Wq)

    def _columns(self) -> dict[str, np.ndarray]:
        """The signals (n,) by the names of a log's columns, which end in their units."""
        from sysid.logs.written import label

        w, v = (lambda name: label(self.response_unit or "1", name)), label(self.drive_unit or "1", "drive")
        told = {w("measured_wd"): self.measured.real, w("measured_wq"): self.measured.imag}
        moved = {w("wd"): self.Wd, w("wq"): self.Wq, w("w"): self.W, w("reference"): self.reference}
        return {"time_s": self.time, v: self.V, "frequency_Hz": self.f} | moved | told

    def to_frame(self) -> Any:
        """A pandas DataFrame, one row for each sample; names end in their units."""
        import pandas as pd

        return pd.DataFrame(self._columns())

    def plot(self) -> Any:
        """A figure of matplotlib: the amplitude beside what was asked, Wd and Wq, voltage, frequency."""
        from sysid.report.plots import BLUE, GREY, ORANGE, blank, styled, time_axis

        unit, drive = self.response_unit or "1", self.drive_unit or "1"
        panels = {
            f"|W| ({unit})": ((self.reference, GREY, "asked for"), (self.W, BLUE, "|W|")),
            f"Wd, Wq ({unit})": ((self.Wd, BLUE, "Wd"), (self.Wq, ORANGE, "Wq")),
            f"V ({drive})": ((self.V, BLUE, ""),),
            "f (Hz)": ((self.f, BLUE, ""),),
        }

        def drawn() -> Any:
            figure = blank(8.0, 4.0)
            time, label = time_axis(self.time)
            for axes, (name, lines) in zip(
                figure.subplots(2, 2, sharex=True).flat, panels.items(), strict=True
            ):
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

    def _brief(self) -> Any:
        """Where each signal began, was at most, and ended."""
        from sysid.report.brief import Brief
        from sysid.report.text import seconds

        signals = {name: v for name, v in self._columns().items() if name != "time_s" and len(v)}
        span = self.time[-1] - self.time[0] if len(self.time) else 0.0
        head = f"Trace: {len(self.time)} samples over {seconds(float(span))}"
        rows = tuple((name, *(f"{x:.6g}" for x in (v[0], np.max(v), v[-1]))) for name, v in signals.items())
        return Brief(head, ("signal", "first", "largest", "last"), rows, headed=True)


def settling_time(time: np.ndarray, W: np.ndarray, target: float, tolerance: float = 0.05) -> float:
    """The first time, s from `time[0]`, after which W stays within `tolerance` of `target`; inf when the last
    row is not."""
    outside = np.flatnonzero(~(np.abs(W - target) <= tolerance * abs(target)))
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1] - time[0]) if outside[-1] + 1 < len(time) else float("inf")
