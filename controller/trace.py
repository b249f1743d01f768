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

    def to_frame(self) -> Any:
        """A pandas DataFrame, one row for each sample; names end in their units."""
        from controller.shown import trace_frame

        return trace_frame(self)

    def plot(self) -> Any:
        """A figure of matplotlib: the amplitude beside what was asked for, Wd and Wq, the voltage, the
        frequency."""
        from controller.shown import trace_figure

        return trace_figure(self)

    def _brief(self) -> Any:
        from controller.shown import of_trace

        return of_trace(self)


def settling_time(time: np.ndarray, W: np.ndarray, target: float, tolerance: float = 0.05) -> float:
    """The first time, s from `time[0]`, after which W stays within `tolerance` of `target`; inf when the last
    row is not."""
    outside = np.flatnonzero(~(np.abs(W - target) <= tolerance * abs(target)))
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1] - time[0]) if outside[-1] + 1 < len(time) else float("inf")
