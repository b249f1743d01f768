"""Stability margins of a sampled amplitude loop, with its delay, for many plants at once.

A plant at resonance under a held voltage that takes effect `delay` s after its sample, with delay = (d + x) T
and 0 <= x < 1:

    P(z) = (g0 + g1/z) z^-d / (z - alpha),   alpha = e^{-T rate},
    g0 = push (1 - e^{-rate (1-x) T})/rate,   g1 = push (e^{-rate (1-x) T} - alpha)/rate.

The controller is linearised by differences of its own step, about the state that it settles in: what is
examined is what runs. An observer of the pole takes a plate of k times the gain for one of 1/k of the
damping, so that its loop at a gain k is another loop, not k times the one at gain one: its gain margin is the
smallest k at which that loop is unstable.
"""

from typing import Any, NamedTuple

import numpy as np

from controller.adaptive import AdaptiveState
from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.pi import PIState
from controller.scalar import NO_LIMIT

POINTS = 400  # frequencies
SHOWN = 40  # of a picture
# gains that are tried for an observer: up to this one, so many; between two of them by bisection to 0.1 %
MOST, TRIED = 40.0, 24


class Margins(NamedTuple):
    """Each (n,), of L = C P: `gain` (largest factor), `phase` (rad), `disk` (symmetric disk margin, 2 / max
    |(1-L)/(1+L)|) and `delay` (s); all zero where the closed loop is unstable."""

    gain: np.ndarray
    phase: np.ndarray
    disk: np.ndarray
    delay: np.ndarray


def margins(control: Any, plants: Ensemble, sample_time: float, delay: float) -> Margins:
    """Margins of the voltage loop of `control` around each plant at resonance."""
    # From far below the plant's bandwidth to the Nyquist frequency, where the last point lies.
    low = 1e-2 * float(np.min(plants.rate)) * sample_time
    angle = np.geomspace(min(low, 1e-3), np.pi, POINTS)
    L = response(control, plants, sample_time, angle) * plant(plants, sample_time, delay, np.exp(1j * angle))
    found = _read(L, angle, sample_time)
    if isinstance(control, DQ):
        return found
    return found._replace(gain=_learned(control, plants, sample_time, delay, found.gain > 0))


def _learned(control: Any, plants: Ensemble, T: float, delay: float, stable: np.ndarray) -> np.ndarray:
    """Gain margin (n,) of an observer, which learns another damping at another gain; 0 if unstable at one."""

    def unstable(gain: np.ndarray) -> np.ndarray:
        """Whether a pole of the loop lies outside of the unit circle."""
        stronger = plants._replace(push=gain * plants.push)
        return np.max(np.abs(np.linalg.eigvals(_closed(control, stronger, T, delay, gain))), axis=1) > 1.0

    tried = np.geomspace(1.0, MOST, TRIED)
    beyond = np.array([unstable(np.full(len(plants.rate), k)) for k in tried])
    at = np.argmax(beyond, axis=0)
    high, low = tried[at], tried[np.maximum(at - 1, 0)]
    for _ in range(8):
        middle = np.sqrt(low * high)
        over = unstable(middle)
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return np.where(stable & ~beyond[0], np.where(np.any(beyond, axis=0), low, np.inf), 0.0)


def _closed(control: Any, plants: Ensemble, T: float, delay: float, gain: np.ndarray) -> np.ndarray:
    """What a sample makes (n, s, s) of the controller's state, Wd, and the last d + 1 voltages."""
    A, B, C, D = linearised(control, plants.rate * T, gain)
    n, s = B.shape
    g0, g1, alpha, d = held(plants, T, delay)
    M = np.zeros((n, s + d + 2, s + d + 2))
    M[:, :s, :s], M[:, :s, s] = A, B
    M[:, s + 1, :s], M[:, s + 1, s] = C, D  # the voltage of this sample, next to be the one before
    M[:, range(s + 2, s + d + 2), range(s + 1, s + d + 1)] = 1.0
    M[:, s, s + d + 1], M[:, s, s] = g1, alpha
    M[:, s] += g0[:, None] * (M[:, s + 1] if d == 0 else np.eye(s + d + 2)[s + d])
    return M


class Bode(NamedTuple):
    """`frequency` (m,) Hz; the 5, 50 and 95 % quantiles (3, m) over the plants of |L|, of the phase of L in
    degrees, and of the `sensitivity` |1 / (1 + L)|."""

    frequency: np.ndarray
    size: np.ndarray
    phase: np.ndarray
    sensitivity: np.ndarray


def bode(control: Any, plants: Ensemble, sample_time: float, delay: float) -> Bode:
    """The loop at SHOWN frequencies up to the Nyquist frequency, with bands over the plants."""
    angle = np.geomspace(0.1 * float(np.min(plants.rate)) * sample_time, np.pi, SHOWN)
    L = response(control, plants, sample_time, angle) * plant(plants, sample_time, delay, np.exp(1j * angle))
    phase = np.rad2deg(np.unwrap(np.angle(L), axis=1))
    bands = (np.quantile(v, [0.05, 0.5, 0.95], axis=0) for v in (np.abs(L), phase, np.abs(1 / (1 + L))))
    return Bode(angle / (2 * np.pi * sample_time), *bands)


def plant(plants: Ensemble, T: float, delay: float, z: np.ndarray) -> np.ndarray:
    """P(z) (n, m) of n plants."""
    *parts, d = held(plants, T, delay)
    g0, g1, alpha = (part[:, None] for part in parts)
    return (g0 + g1 / z) * z**-d / (z - alpha)


def held(plants: Ensemble, T: float, delay: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """g0, g1, alpha, each (n,), and d."""
    d = int(np.floor(delay / T + 1e-9))
    x = max(delay / T - d, 0.0)
    late, alpha = np.exp(-plants.rate * (1 - x) * T), np.exp(-plants.rate * T)
    return plants.push * (1 - late) / plants.rate, plants.push * (late - alpha) / plants.rate, alpha, d


def response(control: Any, plants: Ensemble, T: float, angle: np.ndarray) -> np.ndarray:
    """C(z) = -V/Wd, (n, m) or (1, m) where it is the same for all plants."""
    z = np.exp(1j * angle)
    A, B, C, D = linearised(control, plants.rate * T)
    values, vectors = np.linalg.eig(A)
    # Modes, unless two coincide: then the resolvent itself.
    if np.all(np.linalg.cond(vectors) < 1e8):
        shares = np.linalg.solve(vectors, B[..., None].astype(complex))[..., 0]
        C, solved = (C[:, None, :] @ vectors)[:, 0] * shares, 1 / (z[None, :, None] - values[:, None, :])
    else:
        resolved = z[None, :, None, None] * np.eye(A.shape[-1]) - A[:, None]
        solved = np.linalg.solve(resolved, B[:, None, :, None].astype(complex))[..., 0]
    return -(np.einsum("ni,nmi->nm", C, solved) + D[:, None])


def linearised(
    control: Any, damping: np.ndarray, gain: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A (n, s, s), B (n, s), C (n, s), D (n,) of Wd -> V about a settled amplitude of one, without limits, at
    resonance.

    One n for a `DQ`, whose PI is linear; for an `Adaptive` one for each plant's `damping` T/tau (n,) and
    `gain` over that of the design: it has learnt damping / gain, or the nearest that it believes.
    """
    if isinstance(control, DQ):
        pi = control.amplitude._replace(lowest=-NO_LIMIT, highest=NO_LIMIT, slew=NO_LIMIT, model=None)

        def step(state: tuple, W: Any) -> tuple[tuple, Any]:
            """One step of the PI, whose state is its integral."""
            after, voltage, _ = pi.step(PIState(state[0], 0.0), 1.0, W, np)
            return (after.integral,), voltage

        return differences(step, (np.zeros(1),), np.ones(1, complex), 1e-3)
    free = control._replace(lowest_voltage=-NO_LIMIT, highest_voltage=NO_LIMIT, slew=NO_LIMIT)
    one = np.ones_like(damping)
    sent = len(control.delay) + 1

    def adaptive(state: tuple, W: Any) -> tuple[tuple, Any]:
        """One step of the observer and its law, without limits."""
        d, now, *rest = state
        past = tuple((v, 0.0) for v in rest[sent:])
        before = AdaptiveState(d, 0.0, now, 0.0, control.temperature, tuple(rest[:sent]), (0.0,) * sent, past)
        after, command, _ = free.step(before, 1.0, W, None, np)
        return (after.d, after.damping, *after.voltages, *(v for v, _ in after.past)), command.voltage

    learnt = damping / gain
    settled = (one, learnt, *[learnt / control.push] * sent, *[one] * (1 + len(control.late)))
    return differences(adaptive, settled, one + 0j, 1e-5)


def _read(L: np.ndarray, angle: np.ndarray, T: float) -> Margins:
    size, phase = np.abs(L), np.unwrap(np.angle(L), axis=1)
    # Where the phase passes -180 degrees (also in Nyquist's point, where L is real) and the size passes one.
    turned = phase - np.round((phase[:, :1] + np.pi / 2) / (2 * np.pi)) * 2 * np.pi
    gain = np.full(len(L), np.inf)
    lead, late = np.full(len(L), np.inf), np.full(len(L), np.inf)
    for n, (p, s) in enumerate(zip(turned, np.log(size), strict=True)):
        at = _crossed(np.flatnonzero((p[:-1] > -np.pi) & (p[1:] <= -np.pi)), p, -np.pi, s)
        ends = [s[-1]] if abs(np.sin(p[-1])) < 1e-6 and np.cos(p[-1]) < 0 else []
        gain[n] = min(np.exp(-np.array([*at, *ends])), default=np.inf)
        cuts = np.flatnonzero(np.diff(np.sign(s)))
        w, left = _crossed(cuts, s, 0.0, angle), _crossed(cuts, s, 0.0, p) + np.pi
        lead[n], late[n] = min(left, default=np.inf), min(left / w * T, default=np.inf)
    disk = 2 / np.max(np.abs((1 - L) / (1 + L)), axis=1)
    stable = (gain > 1) & (lead > 0)
    return Margins(*(np.where(stable, m, 0.0) for m in (gain, lead, disk, late)))


def _crossed(i: np.ndarray, values: np.ndarray, level: float, of: np.ndarray) -> np.ndarray:
    """`of`, on straight lines, where `values` pass `level` between rows i and i + 1."""
    share = (values[i] - level) / (values[i] - values[i + 1])
    return of[i] + share * (of[i + 1] - of[i])


def differences(
    step: Any, state: tuple, W: Any, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A (n, s, s), B (n, s), C (n, s), D (n,) of (state, Wd) -> (state, V) by central differences.

    `step` takes a tuple of (n,) and W to a tuple and V. The step is smooth about its settled state, so that
    the error is that of the square of `size`, relative.
    """
    given = (*state, W)
    scale = np.stack([*(np.maximum(np.abs(s), 1e-3) * size for s in state), np.full(len(W), size)])
    # Each number that goes in, and out, up and down with the k-th of them shifted: (2, k, n).
    shifts = np.array([1.0, -1.0])[:, None, None, None] * np.eye(len(given))[:, :, None] * scale
    *into, reading = (v + shifts[:, :, i] for i, v in enumerate(given))
    after, V = step(tuple(into), reading)
    ends = np.stack([np.broadcast_to(out, shifts[:, :, 0].shape) for out in (*after, V)], -1)
    J = ((ends[0] - ends[1]) / (2 * scale[..., None])).transpose(1, 2, 0)
    return J[:, :-1, :-1], J[:, :-1, -1], J[:, -1, :-1], J[:, -1, -1]
