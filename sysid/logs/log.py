"""Logs: what was driven and what answered, read from CSV. Units, column names and files end here.

A log is a table with a header whose names end in their units; lines `# key: value` above it are metadata:

    # plate: A7
    # temperature_degC: 24.0
    time_s,voltage_V,frequency_Hz,wd_um,wq_um
    0.0000,5.0,32300.0,0.0,0.0

`read_logs` reads such files, and those of other instruments through a mapping file (see `columns.mapping`).
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.logs.timed import decrease_of
from sysid.shown import Shown
from sysid.tables import units
from sysid.tables.csvfile import LogError

__all__ = ["Log", "LogError"]

KINDS = ("transient", "steady")
SAMPLINGS = ("instant", "settled")
MEASURED = ("noise", "measured_at")  # metadata of how a response was measured, and their words:
RELATIVE, EVEN = "relative", "even"  # noise, see `Log`
TERMINALS = "terminals"


@dataclass(frozen=True, eq=False, repr=False)
class Log(Shown):
    """One experiment: n rows of inputs and the measured response, peak amplitudes, in rows as recorded.

    `response` is (n,) complex Wd + j Wq, or the real amplitude W where only that was recorded, in
    `response_unit`; `drive` is (n,) peak in `drive_unit`. What was not recorded is None; arrays are owned,
    read-only copies. `kind` None: not stated, and a frequency that changes on every row leaves it open
    (steady at a dwell of four tau). Raises LogError when lengths differ, a value is not finite, time
    decreases, or a word is unknown.
    """

    name: str
    response: np.ndarray
    time: np.ndarray | None = None  # s
    drive: np.ndarray | None = None
    frequency: np.ndarray | None = None  # Hz
    temperature: np.ndarray | None = None  # degC
    force: np.ndarray | None = None  # N
    kind: str | None = None
    sampling: str | None = None
    response_unit: str = "um"
    drive_unit: str = "V"
    metadata: Mapping[str, str] = field(default_factory=dict)
    bench: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[
        str, ...
    ] = ()  # what stands above the rows and was probably meant to be metadata; each names the file
    path: str = ""
    sha256: str = ""
    # standard error of each row's response, per channel, but for a factor of all
    std: np.ndarray | None = None
    theta: np.ndarray | None = None  # rad, the carrier's phase at each row's time; of raw waveforms
    # degC, one of the last digit that its temperature was written with; 0: not read from text
    temperature_digit: float = 0.0
    # read in decibels, or by an impedance analyser: the noise is a fraction of the response
    relative_noise: bool = False
    # measured at the terminals that drive it, as by an impedance analyser: no sensor of its own is late
    analysed: bool = False
    # `std` is not stated by rows but how noise that is even in what was measured goes with them
    even: bool = False

    def __post_init__(self) -> None:
        for name in ("response", "time", "drive", "frequency", "temperature", "force", "std", "theta"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, self._own(name, values))
        if self.time is not None and (decrease := decrease_of(self.time)) is not None:
            raise LogError(
                f"{self.path or self.name}: time decreases at row {decrease} (counted from 0), expected it"
                f" to go on"
            )
        if self.std is not None and (row := int(np.argmin(self.std > 0))) >= 0 and not self.std[row] > 0:
            found = f"row {row} (counted from 0): found a standard error of {self.std[row]:g}"
            raise LogError(f"{self.path or self.name}, {found}, expected one above zero")
        if self.kind is None:
            object.__setattr__(self, "kind", self._tell_kind())
        for word, words in ((self.kind, KINDS), (self.sampling, SAMPLINGS)):
            if word is not None and word not in words:
                raise LogError(f"{self.path or self.name}: found {word!r}, expected {either(word, words)}")
        if self.kind == "transient" and self.time is None:
            raise LogError(
                f"{self.path or self.name}: found a transient log without time, expected a column such as"
                f" time_s"
            )

    def again(self, response: np.ndarray, **told: Any) -> "Log":
        """The same inputs with another response, a complex one of as many rows, and what is `told` of it.
        Raises LogError for a response that is none."""
        new = copy(self)
        for name, value in told.items():
            object.__setattr__(new, name, value)
        object.__setattr__(new, "response", new._own("response", response))
        return new

    def _own(self, name: str, values: Any) -> np.ndarray:
        array = np.asarray(values)
        if array.dtype.kind not in "biufc":
            found = f"found {name} of {array.dtype.name}, for example {array.ravel()[:1].tolist()}"
            raise LogError(f"{self.path or self.name}: {found}, expected numbers")
        array = array.astype(np.complex128 if np.iscomplexobj(array) else np.float64, copy=False)
        if array.ndim != 1 or not len(array) or len(array) != len(self.response):
            raise LogError(
                f"{self.path or self.name}: found {name} of shape {array.shape}, expected"
                f" ({len(self.response)},), n > 0"
            )
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array))[0])
            raise LogError(
                f"{self.path or self.name}, row {row} (counted from 0): found {name} {array[row]}, expected"
                f" finite"
            )
        if (
            array.flags.writeable or not array.flags.owndata
        ):  # a log's own arrays may be shared with another log
            array = array.copy()
            array.flags.writeable = False
        return array

    def _tell_kind(self) -> str | None:
        if self.time is None:
            return "steady"
        if self.frequency is None or len(self) == 1:
            return "transient"
        return None if (self.frequency[1:] != self.frequency[:-1]).all() else "transient"

    @classmethod
    def from_frame(cls, frame: Any, name: str = "log", **constants: Any) -> "Log":
        """The log of a table, a pandas DataFrame or a mapping of columns (n,), whose names are the contract's
        and end in their units. `constants`: what a file states above its header. A frame's `attrs` that state
        something of the kind are taken too, as `log.to_frame()` has them. Raises LogError as `read_logs`
        does, and where the table holds several experiments.

        >>> columns = {"frequency_kHz": [32.2, 32.3], "wd_nm": [900, 2000], "wq_nm": [1000, 0]}
        >>> Log.from_frame(columns, voltage_V=100, temperature_degC=24).frequency
        array([32200., 32300.])
        """
        from sysid.logs.made import of_table

        return of_table(frame, name, constants)

    @classmethod
    def from_arrays(cls, response: Any, *, name: str = "log", **fields: Any) -> "Log":
        """The log of arrays (n,), in the units of the fields of a Log; a number stands for a constant.

        >>> Log.from_arrays([1j, 2, -1j], drive=100, frequency=[32200, 32300, 32400], temperature=24.0).drive
        array([100., 100., 100.])
        """
        from sysid.logs.made import of_arrays

        return of_arrays(response, name, fields)

    @classmethod
    def from_waveform(
        cls, drive: Any, response: Any, rate: float, *, name: str = "log", **constants: Any
    ) -> "Log":
        """The log of raw carrier samples (n,) of drive (V) and response (um) at `rate` Hz, demodulated by the
        drive's own phase. `drive_unit`, `response_unit`: other units; further constants as in `from_frame`.
        Raises LogError where the drive is no carrier, or is sampled too seldom.

        >>> t = np.arange(20_000) / 1e6
        >>> log = Log.from_waveform(100 * np.cos(2e5 * t), np.sin(2e5 * t), 1e6)
        >>> print(f"{log.frequency[0]:.0f} Hz, {abs(log.response[5]):.3f} {log.response_unit}")
        31831 Hz, 1.000 um
        """
        from sysid.logs.made import of_waveform

        return of_waveform(drive, response, rate, name, constants)

    @property
    def amplitude_only(self) -> bool:
        """Whether the response is the real amplitude W, not the vector Wd + j Wq."""
        return not np.iscomplexobj(self.response)

    def __len__(self) -> int:
        return len(self.response)

    def to_frame(self) -> Any:
        """A pandas DataFrame of the rows by the contract's names; what is known of the whole log stands in
        `attrs`."""
        from sysid.report.frames import of_log

        return of_log(self)

    def plot(self) -> Any:
        """A figure of matplotlib: the rows over time, or a sweep with its circle."""
        from sysid.report.plots import log_figure

        return log_figure(self)

    def _brief(self) -> Any:
        from sysid.report.brief import of_log

        return of_log(self)


def either(word: str, words: tuple[str, ...]) -> str:
    """The words that were expected, and the one that was meant, if any is near."""
    return " or ".join(words) + units.did_you_mean(word, words)
