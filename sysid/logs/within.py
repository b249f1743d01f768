"""What the bench's times cannot be for the log that states them: a delay or a filter that is longer than the
record, or a delay that turns neighbouring points of a sweep by more than half a turn.

Most of these are in milliseconds or microseconds, and are said to be seconds."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.tables import units
from sysid.tables.textfile import LogError

if TYPE_CHECKING:
    from sysid.logs.log import Log

MOST_POLES = 8  # of digital lock-ins: 48 dB per octave (Zurich Instruments); others have 4, of 24 dB
HALF_A_TURN = 0.5


def within(log: "Log") -> "Log":
    """The log. Raises LogError where a time of its bench cannot be, or its filter has more poles than a
    lock-in's."""
    poles = log.bench.get("lockin_order", 1.0)
    if poles > MOST_POLES:
        meant = f"; is it in dB per octave? {poles:g} are {poles / 6:g} poles" if poles % 6 == 0 else ""
        raise _refused(log, "lockin_order", f"{poles:g}", f"1 to {MOST_POLES} poles{meant}")
    if log.kind != "steady" and log.time is not None and len(log) > 1:
        _in_record(log, log.time)
    elif log.kind == "steady" and log.frequency is not None and not log.amplitude_only:
        _in_sweep(log, np.unique(log.frequency))
    return log


def _in_record(log: "Log", time: np.ndarray) -> None:
    """Refuse a delay or a filter that leaves no row which the inputs have acted on."""
    lasts, bench = float(time[-1] - time[0]), log.bench
    if not lasts:
        return
    for name in ("lockin_tau_s", "lockin_boxcar_s"):
        if log.theta is None and bench.get(name, 0.0) >= lasts:
            expected = f"seconds, less than the {lasts:.3g} s that the record lasts"
            raise _refused(log, name, f"{bench[name]:g} s", expected)
    late = bench.get("delay_s", 0.0)
    driven = np.zeros(1, int) if log.drive is None else np.flatnonzero(log.drive)
    most = (float(time[-1] - time[driven[0]]) if late > 0 and len(driven) else lasts) or lasts
    if abs(late) >= most:
        shown = "from the drive to the last row" if most < lasts else "that the record lasts"
        raise _refused(log, "delay_s", f"{late:g} s", f"seconds, less than the {most:.3g} s {shown}")


def _in_sweep(log: "Log", frequency: np.ndarray) -> None:
    """Refuse a delay by which the phase turns by more from point to point than can be told."""
    late = abs(log.bench.get("delay_s", 0.0))
    apart = float(np.median(np.diff(frequency))) if len(frequency) > 1 else 0.0
    if late * apart > HALF_A_TURN:
        expected = (
            f"seconds, less than {HALF_A_TURN / apart:.3g} s, by which the phase of points"
            f" {apart:.3g} Hz apart turns by half a turn"
        )
        raise _refused(log, "delay_s", f"{log.bench['delay_s']:g} s", expected)


def _refused(log: "Log", name: str, found: str, expected: str) -> LogError:
    """The error for a number of the bench, by the key that states it."""
    base = name.removesuffix("_s")
    keys = (key for key in log.metadata if (time := units.bench_time(key)) and time[0] == base)
    key = next(keys, name)
    return LogError(f"{log.path or log.name}, metadata {key!r}: found {found}, expected {expected}")
