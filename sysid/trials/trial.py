"""A `Trial`: a `Record` with the current estimates of its noise (`trials.whitening`) and of what the bench
added (`trials.bench`)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sysid.logs.log import Log
from sysid.model import rice
from sysid.model.plant import smoothed
from sysid.rows import rounding
from sysid.rows.hold import Hold
from sysid.rows.prepare import OFFSET_UNITS, prepare
from sysid.trials.bench import Bench
from sysid.trials.noise import Level
from sysid.trials.record import Record, scale_of
from sysid.trials.whitening import Noise, clock_of, joined, uneven, whitened

NUISANCES = ("rotation", "background", "offset", "start", "late", "thermometer")
LEAST_WARMING = 0.02  # degC; a smaller span of temperatures is one temperature
LEAST_TOUCH = 0.05  # span of a finger's contact; less tells nothing of what it does
# of the response at the first row: if its inputs sustain no more than that, the log begins with a free decay
DIED = 0.1
UNKNOWN = 0.05  # of the largest response: the noise level while nothing is known of it
FLOOR = 1e-10  # of the largest response: the least noise level, above the model's rounding errors
SLOPED = 8  # points of a sweep, of whose numbers plant, rotation, feedthrough and slope take half
NONE = 1e-6  # of a lateness: as good as none, and a prior of it can be divided by
SHAPING = {"under", "narrow", "filter"}  # of what the bench added: of all else no shape depends
DECIBEL = {
    "steady": 0.999,
    "transient": 1 - 1e-8,
}  # share of the noise of a log in dB proportional to the response, at first


@dataclass(frozen=True, eq=False)
class Trial(Record):
    """One log as it is read, with what is known at present of its noise and of its bench."""

    noise: Noise = field(kw_only=True)
    bench: Bench = field(default_factory=Bench)
    nuisances: tuple[str, ...] = NUISANCES  # what the bench may have added

    def with_bench(self, **found: Any) -> "Trial":
        """With these of what the bench added."""
        bench = replace(self.bench, **found)
        return replace(self, bench=bench) if found.keys() & SHAPING else self._with(bench=bench)

    def in_noise(self, noise: Noise) -> "Trial":
        """With another noise."""
        return self._with("spans", noise=noise)

    def _with(self, *but: str, **found: Any) -> "Trial":
        """Another trial of the same rows, of which is known what is known of this one, `but` for these. A
        search makes tens of thousands, which need no checks: `replace` takes five times as long."""
        new = object.__new__(type(self))
        known = vars(self) | found
        for name in but:
            known.pop(name, None)
        vars(new).update(known)
        return new

    @classmethod
    def of(
        cls, log: Log, kind: str, nuisances: tuple[str, ...] = NUISANCES, spoilt: np.ndarray | None = None
    ) -> "Trial":
        """A log as it is first read: nothing is known of its noise, nor of what is `spoilt` (n,) unless
        given."""
        read = prepare(log, kind, spoilt=spoilt)
        steps = np.zeros(0) if log.time is None else np.diff(log.time)
        spacing = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
        rectified = (
            kind != "steady"
            and log.frequency is None
            and log.response_unit not in OFFSET_UNITS
            and rice.rectified(log)
        )
        share = DECIBEL[kind] if log.relative_noise else 0.0
        level, spread = UNKNOWN * scale_of(read.log.response), uneven(share, read.log.response)
        stated = as_stated(read.log, log)
        noise = Noise(
            clock_of(read.log), read.count, read.there, level, share=share, spread=spread, stated=stated
        )
        return cls(
            read.log,
            kind,
            read.inputs,
            read.there,
            spacing,
            gap=read.gap,
            dark=read.dark,
            spoilt=read.spoilt,
            most=read.most,
            rectified=rectified,
            recorded=log,
            whole=log if len(read.log) < len(log) else None,
            steps=() if log.relative_noise or log.std is not None else rounding.steps(log.response),
            noise=noise,
            nuisances=nuisances,
        )

    @property
    def lift(self) -> float:
        """Square of the noise that lifts a mean amplitude (`model.rice`), as known so far; negligible where
        the log has a gain of its own."""
        if self.steady and self.log.drive is None:
            return FLOOR * self.scale**2
        return self.bench.floor or (1e-3 * self.scale) ** 2

    @property
    def rounding(self) -> float:
        """Square of float64's rounding noise over the log's; 1 where the noise comes from a recorder's steps,
        so that its level is known."""
        return 1.0 if self.noise.rounded is not None else (FLOOR * self.scale / self.noise.std) ** 2

    @property
    def floor_held(self) -> bool:
        """The floor of an amplitude is its noise's: of a settled sweep, and of a ring-down alone on an
        offset, whose every row shows that. In a step the offset's direction may be where what it adds has its
        largest; the free floor holds the rest."""
        return self.steady or (self.bench.standing and not self.driven)

    @property
    def turned(self) -> bool:
        """The demodulator may have turned d and q; a decay begins at any angle."""
        decays = not (self.steady or self.driven)
        return "rotation" in self.nuisances and not (self.log.amplitude_only or decays)

    @cached_property
    def start_free(self) -> bool:
        """The state at the first row is fitted."""
        if self.steady or "start" not in self.nuisances:
            return False
        if self.from_rest:  # one that moves, or is off zero: of real rows the offset is told by that alone
            return bool(np.iscomplexobj(self.log.response))
        amid = self.resonant and self.driven and self.inputs.drive[0] != 0 and np.ptp(self.log.frequency) > 0
        return self.signed or bool(amid) or abs(self.log.response[0]) > 0.2 * self.scale

    @cached_property
    def begun(self) -> bool:
        """An amplitude log with more than an offset at its first, driven row: its start is relative to the
        settled response, and in units of it."""
        if not self.start_free or self.signed or not self.driven or self.inputs.drive[0] == 0:
            return False
        first = np.abs(self.log.response[self.inputs.interval == 0])
        return bool(np.median(first[-5:]) > DIED * first[0])

    @cached_property
    def at_one_frequency(self) -> bool:
        """Settled d/q points at one frequency: they show only the sum of the plate's response and a
        feedthrough."""
        if not (self.steady and self.signed and self.driven and "background" in self.nuisances):
            return False
        return not self.resonant or bool(np.ptp(self.log.frequency) == 0)

    @cached_property
    def shapes(self) -> dict[str, np.ndarray]:
        """Known shapes (n,) of what the bench adds, by name: an offset; feedthrough of the drive and, over a
        sweep, its slope (per Hz); a baseline that drifts (per s); what a lock-in's filter still holds from
        before a log that begins amid a drive, or with its end."""
        if self.bench.under is not None:
            return {"floor": self.bench.under}
        if not self.signed or (not self.driven and self.steady and not self.resonant):
            return {}
        drive, n = self.inputs.drive[self.inputs.interval], len(self.log)
        offset, background = "offset" in self.nuisances, "background" in self.nuisances
        shapes: dict[str, np.ndarray] = {}
        if self.steady:
            if background and self.resonant and np.ptp(self.log.frequency) > 0:
                shapes["feedthrough"] = drive
                if n >= SLOPED:
                    shapes["slope"] = drive * self.off_middle
            if background and self.at_one_frequency and "feedthrough" in self.bench.narrow:
                shapes["feedthrough"] = drive
            if offset and np.ptp(drive) > 0:
                shapes["offset"] = np.ones(n)
        else:
            if offset:
                shapes["offset"] = np.ones(n)
            if background and (np.ptp(drive) > 0 or not offset):
                shapes["feedthrough"] = self._filtered()
            if "baseline" in self.nuisances:
                shapes["baseline"] = self.log.time - self.log.time[0]
            if self.start_free and (drive[0] or not self.driven):
                shapes |= self._remembered()
        return {name: shape for name, shape in shapes.items() if np.any(shape)}

    @cached_property
    def columns(self) -> np.ndarray:
        """The known shapes, (K, n), each scaled to at most 1."""
        columns = [shape / np.max(np.abs(shape)) for shape in self.shapes.values()]
        return np.array(columns).reshape(len(columns), len(self.log))

    def _filtered(self) -> np.ndarray:
        """(n,) the drive behind the lock-in's filter, which had settled at its first level."""
        (tau, order), drive = self.smoothing, self.inputs.drive
        if order <= 0:
            return drive[self.inputs.interval]
        hold = self.inputs._replace(smoothing=tau, spread=np.zeros(len(self.log)))
        step = (drive - drive[0]).astype(complex)
        still = np.zeros_like(step)  # a plate that nothing pushes, whatever its pole
        return drive[0] + smoothed(still - 1.0, still, step, hold, order, None, np).forced.real

    def _remembered(self) -> dict[str, np.ndarray]:
        """How the initial states of the lock-in's filter die away, (n,) each: e^-x x^k for each of its
        poles."""
        tau, order = self.smoothing
        x = (self.log.time - self.log.time[0]) / tau if order > 0 else self.log.time
        return {f"memory{k}": np.exp(-x) * x**k for k in range(order)}

    @property
    def extra_columns(self) -> dict[str, np.ndarray]:
        """Shapes (n,) of the effects in `trials.extra`, scaled so that each coefficient's prior is as wide as
        `looseness`."""
        return {
            name: e.shape * (e.prior / self.looseness)
            for name, e in self.bench.extra.items()
            if name in self.nuisances
        }

    @property
    def tied(self) -> bool:
        """The log has a resonance of its own, tied to those of the other logs only by the error of its
        thermometer."""
        return self.bench.resonance is not None and "thermometer" in self.nuisances

    @property
    def looseness(self) -> float:
        """Standard deviation of the prior of what the bench adds: ten times the response."""
        return 10.0 * self.scale

    @cached_property
    def smoothing(self) -> tuple[complex, int]:
        """Time constant (s) and number of poles of the lock-in's filter, stated or fitted; (0, 0) where it
        does not matter."""
        if self.bench.filter is not None:
            return self.bench.filter
        tau, order = self.log.bench.get("lockin_tau_s", 0.0), int(self.log.bench.get("lockin_order", 1))
        return (tau, order) if tau > 0 and not self.steady and self.log.theta is None else (0.0, 0)

    @property
    def ripples(self) -> bool:
        """Whether it may show the ringing at twice the frequency after each change of the drive, of which a
        filter lets nothing through."""
        moving = self.resonant and self.driven and not self.steady
        return moving and self.log.theta is None and not self.smoothing[1]

    @cached_property
    def lateness(self) -> float:
        """Standard deviation (s) of the prior of the lateness: that of the delay, as stated, or a row, or the
        gap in which an input changed, combined with a radian of the carrier where its phase is not known. 0
        where the lateness is known or nothing depends on it."""
        if self.steady or "late" not in self.nuisances or not self.driven:
            return 0.0
        bench = self.log.bench
        row = bench.get("delay_std_s", 0.0 if "delay_s" in bench else self.spacing)
        usual = float(np.hypot(max(row, self.gap), self.radian if self.log.theta is None else 0.0))
        return min(usual, self.bench.narrow.get("lateness", np.inf))

    @cached_property
    def sideways(self) -> float:
        """The same for the imaginary part of the lateness, over `lateness`. A trigger or a filter has none,
        and the carrier's phase is within a radian; using this makes G and tau several times more accurate
        over a sweep. In a step it brings nothing, and 1 is faster."""
        swept = self.resonant and not self.log.amplitude_only and np.ptp(self.log.frequency) > 0
        if not (swept and self.lateness):
            return 1.0
        return NONE if self.log.theta is not None else min(self.radian / self.lateness, 1.0)

    def prior(self, shape: str) -> float:
        """Standard deviation of the prior of the start or of a shape's coefficient, in the unit of the
        response. That of `extra` is in its shape, as `extra_columns` has it."""
        narrow = np.inf if shape in self.bench.extra else self.bench.narrow.get(shape, np.inf)
        return min(self.looseness, narrow)

    @property
    def started(self) -> float:
        """Standard deviation of the start's prior over `looseness`; of a start in units of the settled
        response that is one of these."""
        return (1.0 if self.begun else self.prior("start")) / self.looseness

    @cached_property
    def spans(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each part of the noise: an orthonormal basis (n + K, K) of the whitened columns of the used
        rows, with a row for each prior, and the triangular factor R."""
        columns = self.columns[:, self.noise.used]
        prior = np.diag([1 / self.prior(name) for name in self.shapes])
        return [
            np.linalg.qr(np.concatenate([whitened(columns, *p.whitening()).T, prior]))
            for p in self.noise.parts
        ]

    def completed(self, driven: np.ndarray) -> np.ndarray:
        """The modelled rows: `driven`, the plate's, and the bench's columns at their optimum beside it."""
        if not len(self.columns):
            return driven
        white = whitened((self.log.response - driven)[self.noise.used], *self.noise.whitening())
        channels = (white.real, white.imag) if self.noise.levels else (white,)
        found = [
            np.linalg.solve(r, q[: len(v)].T @ v) for (q, r), v in zip(self.spans, channels, strict=True)
        ]
        return driven + joined(found) @ self.columns

    def lifted(self, plate: np.ndarray) -> "Trial":
        """The amplitudes of a driven sweep with how their means rise with the noise's square, which is known
        as well as its scatter tells it; `plate` (n,) is the plate's response."""
        if not self.steady or self.signed or self.log.drive is None:
            return self
        under, error = rice.by_floor(plate, self.lift), 2 * self.noise.relative_error(numbers_left(self))
        narrow = self.bench.narrow | {"floor": self.lift * error * float(np.max(under))}
        return self.with_bench(under=under, narrow=narrow)

    def floored(self, before: np.ndarray, model: np.ndarray, floor: float) -> "Trial":
        """An undriven sweep with the floor that it shows; `before` (n,) are the modelled rows of the plate
        and a `floor`, `model` (n,) what more of that makes of them.

        A floor is noise of a sensor, whose power adds to the plate's: w^2 = |W|^2 + floor, of which a change
        is linear in the floor, by 1/(2 w).
        """
        if not self.undriven_sweep or "background" not in self.nuisances:
            return self
        power, under = np.abs(before) ** 2 - floor, self.bench.under
        if under is not None:
            floor += float((model.real - np.abs(before)) @ under / (under @ under))
        floor = max(floor, 0.0)
        return self.with_bench(floor=floor, under=0.5 / np.sqrt(power + max(floor, self.lift)))

    def sized(self, plate: np.ndarray) -> np.ndarray:
        """(n,) the amplitude as which a plate's response (n,) is recorded."""
        if self.undriven_sweep:
            return np.sqrt(np.abs(plate) ** 2 + self.bench.floor)
        return rice.mean(plate, self.lift)

    def towards(self, plate: np.ndarray) -> np.ndarray:
        """(n,) of which the real part, times a change of the plate's response (n,), is an amplitude's."""
        if self.undriven_sweep:
            return plate.conj() / np.sqrt(np.abs(plate) ** 2 + self.bench.floor)
        return rice.towards(plate, self.lift)

    def hold(self, reference: tuple[float, float]) -> Hold:
        """The log's inputs, as offsets from `reference` (Hz, degC)."""
        warming = self.inputs.warming - (reference[1] if self.log.temperature is not None else 0.0)
        offset = np.nan_to_num(reference[0]) + self.inputs.offset
        offset, begun = np.where(np.isnan(offset), 0.0, offset), np.zeros(len(offset))
        begun[0] = self.begun
        return self.inputs._replace(smoothing=self.smoothing[0], offset=offset, warming=warming, begun=begun)


def freedom(trial: Trial) -> float:
    """Degrees of freedom of a log's residual, at least 1."""
    return sum(freedoms(trial)) if trial.noise.rounded is not None else float(max(numbers_left(trial), 1))


def freedoms(trial: Trial) -> tuple[float, ...]:
    """The same for each part of the noise, at least 1: rows that share a rounding error count as one."""
    parts = trial.noise.parts
    alike = [0.0 if p.own is None else float(np.sum(1 - p.own[p.used])) for p in parts]
    return tuple(max(numbers_left(trial) / len(parts) - shared, 1.0) for shared in alike)


def numbers_left(trial: Trial) -> int:
    """Real numbers in a log, less those of its nuisances."""
    columns, late = len(trial.columns), trial.lateness > 0
    if trial.log.amplitude_only:
        columns += 2 * trial.start_free + 2 * trial.bench.standing + (not trial.floor_held)
        return len(trial.log) - trial.noise.left_out - columns - late
    columns += len(trial.extra_columns)
    taken = (
        2 * columns
        + 2 * trial.start_free
        + ("rotation" in trial.nuisances)
        + late * (2 if trial.sideways == 1 else 1)
    )
    return 2 * (len(trial.log) - trial.noise.left_out) - taken


def numbers_taken(trial: Trial) -> float:
    """Degrees of freedom that a log's nuisances take from its residual."""
    return float(trial.channels * (len(trial.log) - trial.noise.left_out)) - freedom(trial)


def warmed(trials: Sequence["Trial"]) -> float:
    """The span of temperatures (degC) of those at a resonance, as far as these are recorded."""
    warm = [t.log.temperature for t in trials if t.resonant and t.log.temperature is not None]
    return max((float(w.max()) for w in warm), default=0.0) - min((float(w.min()) for w in warm), default=0.0)


def with_noise(trial: Trial, std: float, time: float, levels: tuple[Level, ...] = ()) -> Trial:
    """The trial with a noise level (never below float64's resolution) and correlation time; `levels`: those
    of d and q."""
    return trial.in_noise(trial.noise.at(std, time, levels, FLOOR * trial.scale))


def as_stated(log: Log, whole: Log) -> np.ndarray | None:
    """(n,) noise of each row over the median of the whole log's, as it states them; None where it states
    none."""
    return None if log.std is None else log.std / np.median(whole.std)
