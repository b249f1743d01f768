"""The response of a log at theta, in plain numpy, and how a small change of the physics alters it.

The model is that of the fit, `model.plant.respond`. Near theta the slow mode obeys Z' = s Z + b V. A change
of the physics that adds epsilon c(t) to s changes the response by epsilon dZ,

    dZ = (Z[s + epsilon c] - Z[s - epsilon c]) / (2 epsilon),

with c = j |Z|^2 for a resonance that moves with the amplitude, j t for one that drifts, and so on. The
derivatives by tau, f0 and k_T are such changes too. What changes from row to row is held between rows at its
value halfway.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sysid.model.plant import Response, respond, steady
from sysid.model.theta import Theta
from sysid.rows.hold import Hold, cut, read_at
from sysid.trials.trial import Trial

LEAST = 1e-9  # of a shape: less is rounding
# of 1/tau: the step of a central difference, whose error is its square, and which costs four digits of
# sixteen
STEP = 1e-4
FAR = 1e150  # rad/s, a carrier so fast that only the slow mode is left


@dataclass(frozen=True, eq=False)
class LogResponse:
    """The response of one log at theta, per unit rotation, as `model.theta` computes it; arrays
    over the rows (n,). At low Q the fast mode is taken as settled: how it rings depends on the carrier's
    phase, which may be far off."""

    trial: Trial
    hold: Hold = field(repr=False)
    theta: np.ndarray

    @classmethod
    def of(cls, trial: Trial, reference: tuple[float, float], theta: np.ndarray) -> "LogResponse":
        """Of a log whose inputs are offsets from `reference` (Hz, degC)."""
        return cls(trial, trial.hold(reference), theta)

    @property
    def named(self) -> Theta:
        """theta by name."""
        return Theta.of(self.theta)

    @cached_property
    def gain(self) -> float:
        """G; 1 for a log whose own gain is free."""
        return 1.0 if self.trial.log.drive is None else float(np.exp(self.named.log_G))

    @cached_property
    def tau(self) -> float:
        return float(np.exp(self.named.log_tau))

    @cached_property
    def damped(self) -> np.ndarray:
        """(M,) factor by which a finger, and what else damps, multiplies the damping."""
        return self.named.damped(self.hold)

    @cached_property
    def detuning(self) -> np.ndarray:
        """(M,) omega0 - omega of each interval, rad/s; zero where no frequency is recorded."""
        at = self.named
        if self.trial.tied:
            at = at._replace(f0=self.trial.bench.resonance - at.k_T * self.warming)
        return np.where(np.isfinite(self.hold.omega), at.detuning(self.hold), 0.0)

    @property
    def warming(self) -> float:
        """Mean temperature of the rows as read, degC above the reference."""
        return float(np.mean(self.hold.warming[self.hold.interval]))

    @property
    def warmer(self) -> float:
        """By how many degC the plate is warmer than read, where the log has a resonance of its own."""
        f0, k_T = self.named.f0, self.named.k_T
        own = self.trial.tied and k_T
        return (self.trial.bench.resonance - f0) / k_T - self.warming if own else 0.0

    @property
    def pole(self) -> np.ndarray:
        """Slow pole at each row, rad/s, of the slowly varying envelope."""
        return (-self.damped / self.tau + 1j * self.detuning)[self.hold.interval]

    @property
    def push(self) -> np.ndarray:
        """b V, the drive of the slow mode, over the interval of each row."""
        return self.gain / self.tau * self.hold.drive[self.hold.interval]

    @cached_property
    def response(self) -> Response:
        return self.at(np.zeros(len(self.hold.drive)))

    @property
    def forced(self) -> np.ndarray:
        """Response to the drive from rest."""
        return self.response.forced

    @property
    def free(self) -> np.ndarray:
        """Decay of a unit start at the first interval; in units of the settled response where the log began
        settled."""
        return self.response.free

    @property
    def settled(self) -> complex:
        """What the first drive of the log leads to."""
        first = steady(self.tau, self.detuning[:1], np.nan_to_num(self.hold.omega[:1], nan=FAR), np)
        return complex(self.gain * self.hold.drive[0] * first[0])

    @property
    def begins_settled(self) -> bool:
        """Whether the state at the first row is nearer to what its drive leads to than to rest."""
        start = self.trial.bench.start
        return not self.trial.begun and abs(start - self.settled) < abs(start)

    @property
    def rate(self) -> np.ndarray:
        """Rate of change of `forced`, 1/s."""
        return self.response.rate

    @cached_property
    def envelope(self) -> "LogResponse":
        """The same in the approximation of a slowly varying envelope, without terms of order 1/Q."""
        return replace(
            self, hold=self.hold._replace(omega=np.where(np.isfinite(self.hold.omega), FAR, np.nan))
        )

    def later(self, delay: float) -> np.ndarray:
        """`forced` with a further `delay` (s), which may be negative."""
        log = self.trial.log
        return replace(self, hold=read_at(self.hold, log.time, log.bench.get("delay_s", 0.0) + delay)).forced

    def behind(self, taus: np.ndarray, order: int) -> np.ndarray:
        """(n, K) `forced` behind `order` poles of a lock-in's filter with each of the time constants (K,),
        whatever the log states."""
        return self.at(np.zeros((len(self.hold.drive), len(taus))), (taus, order)).forced

    @property
    def ripple(self) -> np.ndarray:
        """(n,) by how much `forced` is another where the fast mode rings after each change of the inputs."""
        return self.at(np.zeros(len(self.hold.drive)), rings=True).forced - self.forced

    @cached_property
    def plate(self) -> np.ndarray:
        """What an amplitude shows the size of: response, start and an offset."""
        bench = self.trial.bench
        return self.forced + bench.start * self.free + bench.offset + bench.moves

    def driven(self, drive: np.ndarray) -> np.ndarray:
        """Response to another drive (M,), V."""
        return replace(self, hold=self.hold._replace(drive=drive)).forced

    def at(self, rates: np.ndarray, filter: tuple[Any, int] | None = None, rings: bool = False) -> Response:
        """Response of each row, (n,) or (n, K), with `rates` (M,) or (M, K), rad/s, added to the slow pole.
        `filter`: time constant and number of poles, instead of the stated ones; `rings`: the fast mode does,
        which a filter removes."""
        trial, hold, (smoothing, order) = self.trial, self.hold, filter or self.trial.smoothing
        own = [
            v if rates.ndim == 1 else v[:, None]
            for v in (self.damped / self.tau, self.detuning, hold.drive / self.tau)
        ]
        if rates.ndim > 1:
            hold = hold._replace(
                **{k: v[:, None] for k, v in hold._asdict().items() if np.ndim(v) and k != "interval"}
            )
        tau, detuning = 1 / (own[0] - rates.real), own[1] + rates.imag
        omega = np.where(np.isfinite(hold.omega), hold.omega, FAR)
        hold = hold._replace(omega=omega, drive=own[2] * tau, smoothing=smoothing)
        if trial.steady:
            forced = self.gain * (hold.drive * steady(tau, detuning, omega, np))[hold.interval]
            return Response(forced, np.zeros_like(forced), np.zeros_like(forced))
        carrier = trial.resonant and trial.log.theta is not None
        found = respond(tau, detuning, hold, rings, carrier, trial.begun, order, xp=np)
        free = self.gain * found.free if trial.begun else found.free
        return Response(self.gain * found.forced, self.gain * found.rate, free)

    def changed(self, rates: np.ndarray, start: complex = 0.0, late: complex = 0.0) -> np.ndarray:
        """(n,) or (n, K): by how much `rates` (M,) or (M, K), rad/s, added to the slow pole change forced +
        start free + late rate."""
        each = rates if rates.ndim > 1 else rates[:, None]
        size = np.max(np.abs(each), axis=0) * self.tau
        step = STEP / np.where(size > 0, size, 1.0)
        found = self.at(np.concatenate([step * each, -step * each], axis=1))
        above, below = np.split(found.forced + start * found.free + late * found.rate, 2, axis=1)
        return ((above - below) / (2 * step)).reshape(len(above), *rates.shape[1:])

    def along(self, rates: np.ndarray, start: complex = 0.0, late: complex = 0.0) -> np.ndarray:
        """`changed` for rates (n,) that vary from row to row."""
        if self.trial.steady:
            return self.changed(rates)
        row = self.towards
        return self.by_row.changed(0.5 * (rates[np.maximum(row - 1, 0)] + rates[row]), start, late)

    @cached_property
    def by_row(self) -> "LogResponse":
        """The same with the intervals (M') also cut at each row."""
        return replace(self, hold=self._cut[0])

    @property
    def towards(self) -> np.ndarray:
        """(M',) the row at which each interval of `by_row` ends."""
        return self._cut[1]

    @cached_property
    def _cut(self) -> tuple[Hold, np.ndarray]:
        return cut(self.hold)

    def design(self) -> np.ndarray:
        """(n, K) derivatives of this log by all that the fit can adjust, plant and nuisances; real or complex
        as its coefficients are."""
        trial = self.trial
        shapes = [self.forced, self.changed(np.ones(len(self.hold.drive)), trial.bench.start)]
        if not trial.steady:
            shapes += [self.rate, *([self.free] if trial.start_free else [])]
        if trial.signed:
            return np.stack([*shapes, *trial.columns.astype(complex)], axis=1)
        shapes += [np.ones(len(self.forced))] if trial.bench.standing else []
        own = abs(trial.bench.turn) if trial.undriven_sweep else 1.0
        towards = trial.towards(own * self.plate)
        made = [towards * s * turn for s in shapes for turn in (1, 1j)]
        # What is turned by a right angle from the response adds nothing but rounding, which is no shape.
        return np.stack([v.real * (np.max(np.abs(v.real)) > LEAST * np.max(np.abs(v))) for v in made], axis=1)

    def derivatives(self, start: complex = 0.0, late: complex = 0.0) -> np.ndarray:
        """(n, 6) of forced + start free + late rate by the six components of theta."""
        hold, tau = self.hold, self.tau
        turning = 2j * np.pi * np.isfinite(hold.omega)
        rates = (
            self.damped / tau,
            turning,
            turning * hold.warming,
            -hold.damped * hold.contact / tau,
            turning * hold.contact,
        )
        found = np.zeros((len(self.forced), 1 + len(rates)), complex)
        some = [k for k, x in enumerate(rates) if np.any(x)]
        found[:, 1 + np.array(some)] = self.changed(
            np.stack([rates[k] for k in some], axis=1).astype(complex), start, late
        )
        pushed = (
            self.forced + late * self.rate + (start * self.free if self.trial.begun else 0.0)
        )  # in proportion to b V
        found[:, 0] = 0.0 if self.trial.log.drive is None else pushed
        found[:, 1] -= pushed
        return found
