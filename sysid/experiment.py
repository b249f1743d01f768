"""From logs to the arrays that the likelihood takes: what the bench may have added to each, padding, groups of one layout."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from sysid.condense import prepare
from sysid.likelihood import Experiment, Groups, Layout
from sysid.log import Log
from sysid.plant import LOW_Q, Hold

NUISANCES = ("rotation", "background", "offset", "start")
FLOOR = 1e-10  # of the largest response: least noise level, above what rounding makes of the model
OFFSET_UNITS = {"degC", "degF", "K"}  # scales whose zero means nothing: a start value is an offset, not a response


@dataclass(frozen=True, eq=False)
class Trial:
    """One log, how it is read, and the present knowledge of its noise and of what the bench added."""

    log: Log  # condensed where it is long
    kind: str  # "transient" | "steady"
    inputs: Hold = field(repr=False)  # with offsets from 0 Hz and 0 degC
    count: np.ndarray = field(repr=False)  # (n,) rows of the file that each row is the mean of
    nuisances: tuple[str, ...] = NUISANCES
    noise_std: float = 0.0  # per channel; 0: not yet known
    noise_time: float = 0.0  # correlation time in the unit of `clock`; 0: white
    start: complex = 0.0  # of an amplitude log
    floor: float = 0.0  # of an amplitude log, response squared
    floor_free: bool = True  # until the data want it below zero
    level: np.ndarray | None = field(default=None, repr=False)  # size of the response that a relative noise is a fraction of

    offset_units = OFFSET_UNITS

    @classmethod
    def of(cls, log: Log, kind: str, nuisances: tuple[str, ...] = NUISANCES) -> "Trial":
        """A log as it is read at first: nothing known of its noise."""
        short, inputs, count = prepare(log, kind)
        return cls(short, kind, inputs, count, nuisances)

    @property
    def steady(self) -> bool:
        return self.kind == "steady"

    @property
    def scale(self) -> float:
        """Largest magnitude of the response."""
        return float(np.max(np.abs(self.log.response))) or 1.0

    @property
    def at_floor(self) -> bool:
        """The residual is rounding, not noise."""
        return self.noise_std <= FLOOR * self.scale

    @property
    def driven(self) -> bool:
        """A drive is recorded and not zero throughout."""
        return self.log.drive is not None and bool(np.any(self.log.drive != 0))

    @property
    def resonant(self) -> bool:
        """An excitation frequency is recorded."""
        return self.log.frequency is not None

    @property
    def signed(self) -> bool:
        """d/q rows, or the signed output of a first-order plant: linear in all that the bench adds."""
        return not self.log.amplitude_only or not (self.resonant or self.log.relative_noise)

    @property
    def one_level(self) -> bool:
        """A transient whose inputs never change: nothing in it tells an offset from a response."""
        inputs = [c for c in (self.log.drive, self.log.frequency) if c is not None]
        return not self.steady and self.driven and all(np.all(c == c[0]) for c in inputs)

    @property
    def from_rest(self) -> bool:
        """A single level that begins near zero: read as a step at the first row."""
        return self.one_level and (abs(self.log.response[0]) < 0.1 * self.scale or self.log.response_unit in OFFSET_UNITS)

    @property
    def since_change(self) -> np.ndarray:
        """Seconds since the inputs of each row of a transient last changed."""
        hold = self.inputs
        return np.where(hold.interval > 0, hold.elapsed, hold.elapsed if self.from_rest or not self.driven else np.inf)

    @property
    def changes(self) -> int:
        """How often the inputs of a transient change."""
        return len(self.inputs.drive) - 1

    @property
    def start_free(self) -> bool:
        """The state at the first row is to be found."""
        if self.steady or self.from_rest or "start" not in self.nuisances:
            return False
        return self.signed or abs(self.log.response[0]) > 0.2 * self.scale

    @property
    def clock(self) -> np.ndarray:
        """What orders the noise: time, with equal stamps spread evenly; row number where no time is recorded."""
        if self.log.time is None:
            return np.arange(len(self.log), dtype=float)
        stamps, first, count = np.unique(self.log.time, return_index=True, return_counts=True)
        if len(stamps) == len(self.log.time):
            return np.asarray(self.log.time)
        if len(stamps) == 1:
            return np.arange(len(self.log), dtype=float)
        end = np.append(stamps[1:], 2 * stamps[-1] - stamps[-2])
        within = np.arange(len(self.log)) - np.repeat(first, count)
        return np.repeat(stamps, count) + within * np.repeat((end - stamps) / count, count)

    @property
    def weight(self) -> np.ndarray:
        """(n,) by which each row's noise is smaller: the mean of many rows, or a small response where noise is a fraction."""
        weight = np.sqrt(self.count)
        if self.noise_time > 0 and np.any(self.count > 1):
            # The variance of an OU process averaged over x correlation times is 2 (x - 1 + exp(-x))/x^2 of a row's.
            x = np.maximum(self.count * np.ptp(self.clock) / self.count.sum() / self.noise_time, 1e-4)
            weight = np.sqrt(x**2 / (2 * (x + np.expm1(-x))))
        if not self.log.relative_noise:
            return weight
        level = np.abs(self.log.response) if self.level is None else self.level
        return weight * self.scale / np.maximum(level, 1e-4 * self.scale)

    def memory(self) -> np.ndarray:
        """Correlation of the noise with the row before."""
        if self.noise_time <= 0:
            return np.zeros(len(self.log))
        rho = np.exp(-np.diff(self.clock) / self.noise_time)
        return np.concatenate([[0.0], np.minimum(rho, 1 - 1e-9)])

    def columns(self, hold: Hold) -> np.ndarray:
        """Known shapes that the bench adds, (K, N): offset, feedthrough of the drive, its slope over a sweep."""
        drive, n = hold.drive[hold.interval].copy(), len(self.log)
        offset, background = "offset" in self.nuisances, "background" in self.nuisances and self.resonant
        shapes: list[np.ndarray] = []
        if self.steady:
            swept = background and np.ptp(self.log.frequency) > 0
            if swept:
                f = self.log.frequency - np.mean(self.log.frequency)
                shapes += [drive] + ([drive * f] if n >= 12 else [])
            if offset and np.ptp(drive) > 0:
                shapes.append(np.ones(n))
        elif self.signed:
            if self.from_rest:
                drive[0] = 0.0
            if offset and (not self.from_rest or self.log.response_unit in OFFSET_UNITS):
                shapes.append(np.ones(n))
            if background and (np.ptp(drive) > 0 or not offset):
                shapes.append(drive)
        if not self.signed or (not self.driven and self.steady and not self.resonant):
            shapes = []
        shapes = [s / np.max(np.abs(s)) for s in shapes if np.any(s)]
        return np.array(shapes).reshape(len(shapes), n)

    def hold(self, reference: tuple[float, float]) -> Hold:
        """The log's inputs, as offsets from `reference` (Hz, degC)."""
        known = np.isfinite(self.inputs.omega)
        warming = self.inputs.warming - (reference[1] if self.log.temperature is not None else 0.0)
        return self.inputs._replace(offset=np.where(known, 2 * np.pi * reference[0] - self.inputs.omega, 0.0), warming=warming)


def group(
    trials: Sequence[Trial], reference: tuple[float, float], tau: float | None = None, *, search: bool = False
) -> tuple[Groups, list[list[int]]]:
    """Stack the trials by layout. Returns the groups and, for each, the positions of its logs in `trials`.

    `tau` decides where Q is low. `search`: as a search for starting values wants it, with a gain of its own for every log,
    and no more than SEARCH_ROWS of its rows.
    """
    low_q = tau is not None and np.isfinite(reference[0]) and np.pi * reference[0] * tau < LOW_Q
    holds = [t.hold(reference) for t in trials]
    kept = [_thin(t, h) if search else np.arange(len(t.log)) for t, h in zip(trials, holds, strict=True)]
    sizes = _sizes([max(len(k), len(h.drive)) if not t.steady else len(k) for t, h, k in zip(trials, holds, kept, strict=True)])
    stacks: dict[Layout, list[tuple[int, Experiment]]] = {}
    for i, (trial, hold) in enumerate(zip(trials, holds, strict=True)):
        layout, x = _experiment(trial, hold, kept[i], sizes[i], low_q, search)
        stacks.setdefault(layout, []).append((i, x))
    groups, members = [], []
    for layout, stack in sorted(stacks.items(), key=lambda item: item[0]):
        xs = [x for _, x in stack]
        blank = xs[0]._replace(weight=np.zeros_like(xs[0].weight), freedom=np.zeros(()))
        xs += [blank] * (_bucket(len(xs)) - len(xs))
        stacked = [np.stack(leaves) for leaves in zip(*[(*x.hold, *x[1:]) for x in xs], strict=True)]
        size = len(Hold._fields)
        groups.append((layout, Experiment(Hold(*stacked[:size]), *stacked[size:])))
        members.append([i for i, _ in stack])
    return tuple(groups), members


SEARCH_ROWS = 160


def _thin(trial: Trial, hold: Hold) -> np.ndarray:
    """Rows enough for a search: evenly spread over a sweep; in each stretch of constant inputs densest at its start."""
    n = len(trial.log)
    edges = np.array([0, n]) if trial.steady else np.searchsorted(hold.interval, np.arange(len(hold.drive) + 1))
    if n <= SEARCH_ROWS:
        return np.arange(n)
    if len(edges) - 1 > SEARCH_ROWS // 8:
        return np.unique(np.linspace(0, n - 1, SEARCH_ROWS).astype(int))
    share = np.linspace(0, 1, SEARCH_ROWS // (len(edges) - 1)) ** (1 if trial.steady else 2)
    rows = np.concatenate([a + share * (b - 1 - a) for a, b in pairwise(edges)])
    return np.unique(np.rint(rows).astype(int))


def _sizes(lengths: Sequence[int]) -> list[int]:
    """Rows that each log is padded to: as many as the longest has, unless that is over twice its own."""
    return [_bucket(max(m for m in lengths if m <= 2 * n), 64) for n in lengths]


def _bucket(n: int, least: int = 1) -> int:
    """The next of a few sizes, 1, 2, 3, 4, 6, 8, 12, 16, ..., so that logs of new lengths find a compiled program."""
    size = least
    while size < n:
        size = 1 << size.bit_length() if size & (size - 1) else max(size * 3 // 2, size + 1)
    return size


def _pad(values: Iterable, n: int, fill: complex = 0.0) -> np.ndarray:
    values = np.asarray(values)
    return np.concatenate([values, np.full(n - len(values), fill, values.dtype)])


COLUMNS = 3  # offset, feedthrough or background, slope: absent ones are zero


def _experiment(
    trial: Trial, hold: Hold, keep: np.ndarray, rows: int, low_q: bool, search: bool
) -> tuple[Layout, Experiment]:
    known = trial.columns(hold)
    columns = np.zeros((COLUMNS, rows))
    columns[: len(known), : len(keep)] = known[:, keep]
    amplitude = not trial.signed
    driven = trial.driven or (trial.steady and trial.log.drive is None)
    own_gain = driven and (search or trial.log.drive is None)
    both = low_q and not trial.steady and trial.resonant
    layout = Layout(amplitude, own_gain, both, rows)
    y = trial.log.response[keep] if amplitude else np.asarray(trial.log.response[keep], complex)
    return layout, Experiment(
        hold=_padded_hold(hold, keep, rows, trial.steady),
        response=_pad(y, rows),
        weight=_pad(trial.weight[keep], rows),
        columns=columns.astype(y.dtype),
        memory=np.zeros(rows) if search else _pad(trial.memory(), rows),
        sigma=np.asarray(trial.noise_std or 0.05 * trial.scale),
        looseness=np.asarray(10.0 * trial.scale),
        freedom=np.asarray(freedom(trial, len(known))),
        rotated=np.asarray(float("rotation" in trial.nuisances and not trial.log.amplitude_only)),
        start=np.asarray(complex(trial.start)),
        floor=np.asarray(trial.floor or (1e-3 * trial.scale) ** 2),
        start_free=np.asarray(float(trial.start_free)),
        floor_free=np.asarray(float(trial.floor_free and not trial.steady)),
    )


def _padded_hold(hold: Hold, keep: np.ndarray, rows: int, steady: bool) -> Hold:
    held = keep if steady else slice(None)
    return Hold(
        duration=_pad(hold.duration[held], rows),
        drive=_pad(hold.drive[held], rows),
        omega=_pad(hold.omega[held], rows, np.nan),
        offset=_pad(np.nan_to_num(hold.offset[held]), rows),
        warming=_pad(hold.warming[held], rows),
        interval=np.arange(rows, dtype=np.int32) if steady else _pad(hold.interval[keep], rows),
        elapsed=_pad(hold.elapsed[keep], rows),
        spread=_pad(hold.spread[keep], rows),
        settled=_pad(hold.settled[keep], rows, True),
    )


def freedom(trial: Trial, columns: int | None = None) -> float:
    """Degrees of freedom of a log's residual: real numbers in it less those of its nuisances."""
    if columns is None:
        columns = len(trial.columns(trial.inputs))
    if trial.log.amplitude_only:
        return float(max(len(trial.log) - columns - 2 * trial.start_free - (not trial.steady), 1))
    taken = 2 * columns + 2 * trial.start_free + ("rotation" in trial.nuisances)
    return float(max(2 * len(trial.log) - taken, 1))


def with_noise(trial: Trial, std: float, time: float) -> Trial:
    """The trial with a noise level (never below what float64 resolves) and correlation time."""
    least = FLOOR * trial.scale
    return replace(trial, noise_std=max(std, least), noise_time=time if std > least else 0.0)
