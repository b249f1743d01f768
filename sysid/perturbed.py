"""What a small change of the physics adds to a log: the shapes of `sysid.terms`. Plain numpy, no compilation.

Near the fitted plant the slow mode obeys Z' = a Z + b V. A change of the physics that adds epsilon(t) to the right-hand side adds

    dZ(t) = integral of e^{a (t - s)} epsilon(s) ds,        settled: dZ = -epsilon/a

to the response: epsilon = j |Z|^2 Z for a resonance that moves with the amplitude, j t Z for one that drifts, and so on. The
derivatives by tau, f0 and k_T are such changes too. Between two rows epsilon is taken as a straight line.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from sysid import rice
from sysid.hold import Hold
from sysid.plant import poles, steady
from sysid.trial import Trial

LEAST = 1e-9  # of a shape: less is rounding


@dataclass(frozen=True, eq=False)
class Course:
    """The course of one log at theta, as `sysid.likelihood.basis` has it, per unit rotation; arrays over its rows (n,)."""

    trial: Trial
    hold: Hold = field(repr=False)
    theta: np.ndarray

    @cached_property
    def gain(self) -> float:
        """G; 1 for a log whose own gain is free."""
        return 1.0 if self.trial.log.drive is None else float(np.exp(self.theta[0]))

    @cached_property
    def tau(self) -> float:
        return float(np.exp(self.theta[1]))

    @cached_property
    def damped(self) -> np.ndarray:
        """(M,) by what a finger multiplies the damping."""
        return 1 + self.theta[4] * self.hold.contact

    @cached_property
    def detuning(self) -> np.ndarray:
        """(M,) omega0 - omega of each interval, rad/s."""
        hold, (shift, drift, _, touch) = self.hold, self.theta[2:]
        return 2 * np.pi * (hold.offset + shift + drift * hold.warming + touch * hold.contact)

    @cached_property
    def poles(self) -> np.ndarray:
        """(M,) slow pole of each interval; at resonance where no frequency is recorded."""
        return -self.damped / self.tau + 1j * np.where(np.isfinite(self.hold.omega), self.detuning, 0.0)

    @property
    def pole(self) -> np.ndarray:
        """Slow pole over the step that ends at each row."""
        return self.poles[self.hold.interval]

    @property
    def push(self) -> np.ndarray:
        """b V over the step that ends at each row."""
        return self.gain / self.tau * self.hold.drive[self.hold.interval]

    @cached_property
    def forced(self) -> np.ndarray:
        """Response to the drive from rest, behind the lock-in's filter."""
        return self.forced_at(self.poles)

    @cached_property
    def exact(self) -> np.ndarray:
        """`forced` as the fit has it: the exact settled response; in a transient the exact slow pole, and the settled ripple of
        the fast one."""
        hold, tau = self.hold, self.tau / self.damped
        if self.trial.steady:
            settled = steady(tau, self.detuning, hold.omega, np) / self.damped
            return (self.gain * hold.drive * settled)[hold.interval]
        if not self.trial.resonant:
            return self.forced
        slow, fast, gain = poles(tau, self.detuning, hold.omega, xp=np)
        push = self.gain * gain / self.damped * hold.drive
        return self._behind(self._from_rest(slow, push) + (push / fast)[hold.interval])

    def _behind(self, response: np.ndarray) -> np.ndarray:
        """A response from rest behind the lock-in's filter, as far as that is stated."""
        tau, order = self.trial.smoothing
        return self.filtered(response, tau, order) if order else response

    def forced_at(self, poles: np.ndarray, delay: float = 0.0) -> np.ndarray:
        """`forced` of a mode with other poles (M,), by `delay` (s) later or earlier, by one interval at most."""
        push = self.gain / self.tau * self.hold.drive
        if self.trial.steady:
            return (-push / poles)[self.hold.interval]
        return self._behind(self._from_rest(poles, push, delay))

    def _from_rest(self, poles: np.ndarray, push: np.ndarray, delay: float = 0.0) -> np.ndarray:
        """Response of Z' = poles Z + push (M,), or settled where the log begins so, before any filter."""
        hold, target = self.hold, push / poles
        states = _from(-hold.begun[0] * target[0], poles * hold.duration, np.expm1(poles * hold.duration) * target)
        begun, after = states[:-1], states[1:]
        before = begun[hold.interval]
        elapsed = hold.elapsed - delay
        late = elapsed < 0  # still in the interval before: one is enough for a delay shorter than an interval
        if np.any(late):
            row = np.maximum(hold.interval - 1, 0)
            begin = begun[row]
            since = np.maximum(hold.duration[row] + elapsed, 0.0)
            earlier = np.where(hold.interval > 0, begin + np.expm1(poles[row] * since) * (begin + target[row]), begun[0])
        z = before + np.expm1(poles[hold.interval] * np.maximum(elapsed, 0.0)) * (before + target[hold.interval])
        z = np.where(late, earlier, z) if np.any(late) else z
        beyond = (elapsed - hold.duration[hold.interval]) * (delay < 0)
        if not np.any(beyond > 0):
            return z
        row = np.minimum(hold.interval + 1, len(poles) - 1)
        begin = after[hold.interval]
        return np.where(beyond > 0, begin + np.expm1(poles[row] * np.maximum(beyond, 0.0)) * (begin + target[row]), z)

    @cached_property
    def free(self) -> np.ndarray:
        """Decay of a unit start at the beginning of the first interval; of one more settled response, where the log began so."""
        if self.trial.steady:
            return np.zeros(len(self.trial.log), complex)
        begun = np.concatenate([[0.0], np.cumsum(self.poles * self.hold.duration)[:-1]])
        unit = self._settled if self.trial.begun else 1.0
        return unit * np.exp(begun[self.hold.interval] + self.pole * self.hold.elapsed)

    @property
    def _settled(self) -> complex:
        """The response as the log begins, where it has settled by then; else zero."""
        return -self.hold.begun[0] * self.push[0] / self.poles[0]

    @property
    def rate(self) -> np.ndarray:
        """Rate of change of `forced`, 1/s."""
        before = self.forced if self.trial.steady else self._from_rest(self.poles, self.gain / self.tau * self.hold.drive)
        return self._behind(self.pole * before + self.push)

    @cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Exponent a h of the step to each row after the first, and what the step's first and last epsilon weigh."""
        h = np.diff(self.trial.log.time)
        z = self.pole[1:] * h
        first, second = _phi(z)
        return z, h * (first - second), h * second

    def response_to(self, begin: np.ndarray, end: np.ndarray | None = None) -> np.ndarray:
        """What epsilon adds: (n,) its value at each row or, where it jumps, at the `begin` and `end` of the step to each row."""
        if self.trial.steady:
            return -begin / self.pole
        first, last = (begin[:-1], begin[1:]) if end is None else (begin[1:], end[1:])
        z, weigh_first, weigh_last = self._steps
        settled = -self.hold.begun[0] * begin[0] / self.pole[0]
        return self._behind(_from(settled, z, weigh_first * first + weigh_last * last))

    def filtered(self, response: np.ndarray, tau: float, order: int) -> np.ndarray:
        """A response behind a lock-in's low-pass of `order` poles of `tau` seconds."""
        h = np.diff(self.trial.log.time)
        z = np.asarray(-h / tau, complex)
        first, second = _phi(z)
        for _ in range(order):
            response = _from(response[0], z, h / tau * ((first - second) * response[:-1] + second * response[1:]))
        return response

    def design(self) -> np.ndarray:
        """(n, K) what the fit can make of this log, to first order: plant and nuisances, with coefficients of the log's kind."""
        trial = self.trial
        if trial.steady:
            shapes = [self.forced, self.response_to(self.forced)]
        else:
            shapes = [self.forced, self.response_to(self.forced), self.rate]
            shapes += [self.free] if trial.start_free else []
        if trial.signed:
            return np.stack([*shapes, *trial.columns.astype(complex)], axis=1)
        plate = self.forced + trial.start * self.free
        along = rice.towards(plate, trial.lift)
        made = [along * s * turn for s in shapes for turn in (1, 1j)]
        # What is turned by a right angle from the response adds nothing but rounding, which is no shape.
        return np.stack([v.real * (np.max(np.abs(v.real)) > LEAST * np.max(np.abs(v))) for v in made], axis=1)

    def derivatives(self, response: np.ndarray) -> np.ndarray:
        """(n, 6) of the plant's part of the `response` by the numbers of theta; `response` is turned by the same angle as
        `push` is here, zero."""
        interval = self.hold.interval
        warming, contact = self.hold.warming[interval], self.hold.contact[interval]
        turning = 2j * np.pi * response * self.trial.resonant
        begun = self.trial.start * self.free if self.trial.begun else 0.0  # of the settled response's size
        slower = self.response_to(response * self.damped[interval] / self.tau) - self._pushed(self.push) - begun
        own = np.zeros_like(self.forced) if self.trial.log.drive is None else self.forced + begun
        return np.stack([own, slower, *(self._changed(epsilon) for epsilon in (
            turning, turning * warming, -response * contact / self.tau, turning * contact
        ))], axis=1)  # fmt: skip

    def _changed(self, epsilon: np.ndarray) -> np.ndarray:
        return self.response_to(epsilon) if np.any(epsilon) else np.zeros_like(self.forced)

    def _pushed(self, push: np.ndarray) -> np.ndarray:
        return self.response_to(push, push)


def _phi(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(e^z - 1)/z and (e^z - 1 - z)/z^2."""
    near = np.abs(z) < 1e-2
    safe = np.where(near, 1.0, z)
    first = np.where(near, 1 + z / 2 + z**2 / 6 + z**3 / 24, np.expm1(safe) / safe)
    return first, np.where(near, 0.5 + z / 6 + z**2 / 24 + z**3 / 120, (first - 1) / safe)


def _from(start: complex, exponent: np.ndarray, push: np.ndarray) -> np.ndarray:
    """A start, and z after each step of z+ = e^exponent z + push from there."""
    first = push[:1] + np.exp(exponent[:1]) * start
    return np.concatenate([[start], accumulated(exponent, np.concatenate([first, push[1:]]))])


def accumulated(exponent: np.ndarray, push: np.ndarray) -> np.ndarray:
    """z after each step of z+ = e^exponent z + push from zero: a bidiagonal system, solved row after row."""
    band = np.ones((2, len(push)), complex, order="F")
    band[1, :-1] = -np.exp(exponent[1:])
    return lapack.ztbtrs(band, push, uplo="L", diag="U")[0].reshape(len(push))
