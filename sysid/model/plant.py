"""The plant: one resonance, seen in the frame that turns with the drive.

With W = Wd + j Wq and the drive along +q the rotating-frame equation of m w'' + ds w' + c w = N v has two
poles,

    s1 = -1/tau + j (wd - omega)        the slow one, which a lock-in sees
    s2 = -1/tau - j (wd + omega)        the fast one, a ripple of twice the drive;   wd = sqrt(w0^2 - 1/tau^2)

and W = Z1 + Z2 with  Z1' = s1 Z1 + b V,  Z2' = s2 Z2 - b V,  b = G w0 / (tau wd): exact, also while frequency
and drive change from one interval to the next. Where the resonance itself jumps, a fraction (change of w0)/(2
w0) passes from one mode to the other; that is left out. The steady response of the sum is the exact one,

    W = G V (w0/omega) / (1 - j (w0^2 - omega^2) tau / (2 omega)),

at any Q. A lock-in removes the ripple, so Z2 follows its steady value at once, unless `both_modes` asks for
the whole. A log without a frequency is driven at resonance: the first-order model tau W' = -W + G V.

All frequencies enter as offsets from a reference, in Hz: their differences are exact near the resonance, and
are turned into rad/s last, so that float64 resolves a micro-hertz at a gigahertz. Everything here is a pure
function of JAX arrays: differentiable, any time grid, no resampling. What takes `xp`, the module of its
arrays, is as well one of numpy's, with nothing to compile.
"""

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sysid.model.carry import carried
from sysid.precision import float64
from sysid.rows.hold import Hold, Leaf, hold_inputs


class Poles(NamedTuple):
    """Poles of the rotating frame and what the drive does to them; each of the shape of `detuning`."""

    slow: Leaf  # s1, rad/s
    fast: Leaf  # s2, rad/s
    gain: Leaf  # b/G, 1/s


def poles(tau: Leaf, detuning: Leaf, omega: Leaf, omega0: Leaf | None = None, xp: Any = jnp) -> Poles:
    """Poles at drive `omega` (rad/s; NaN: driven at resonance) with `detuning` = omega0 - omega (rad/s), tau
    in s.

    `omega0`: where it is known otherwise than as their sum, which cancels for drives far above it.
    """
    known = xp.isfinite(omega)
    omega = xp.where(known, omega, 1.0)
    omega0 = xp.where(known, omega + detuning if omega0 is None else omega0, 1.0)
    rate = xp.where(known, 1.0 / tau, 0.0)
    # Q = 0.5 is the end of the domain; the floor keeps a search that strays beyond it finite.
    damped = xp.sqrt(xp.maximum(omega0**2 - rate**2, 0.04 * omega0**2))
    pull = rate**2 / (omega0 + damped)  # omega0 - damped, without cancellation
    slow = -1.0 / tau + 1j * xp.where(known, detuning - pull, 0.0)
    fast = -1.0 / tau - 1j * xp.where(known, damped + omega, xp.inf)
    return Poles(slow, fast, xp.where(known, omega0 / damped, 1.0) / tau)


def steady(tau: Leaf, detuning: Leaf, omega: Leaf, xp: Any = jnp) -> Any:
    """Settled response W/(G V) at drive `omega` (rad/s; NaN: at resonance) with `detuning` = omega0 - omega
    (rad/s); arrays of the module `xp`."""
    known = xp.isfinite(omega)
    omega = xp.where(known, omega, 1.0)
    detuning = xp.where(known, detuning, 0.0)
    x = detuning * (2.0 * omega + detuning) / (2.0 * omega) * tau
    size = (1.0 + detuning / omega) / (1.0 + x**2)
    return size + 1j * (size * x)


class Response(NamedTuple):
    """(N,) per row: response to the drive from rest, per unit G; its rate of change, 1/s; free decay of a
    unit start."""

    forced: Leaf
    rate: Leaf
    free: Leaf


def respond(
    tau: Leaf,
    detuning: Leaf,
    hold: Hold,
    both_modes: bool = False,
    carrier: bool = False,
    begun: bool = False,
    order: int = 0,
    omega0: Leaf | None = None,
    xp: Any = jnp,
) -> Response:
    """Response of each row, per unit G, to the drive from rest and of a unit start. The rate is that of the
    slow mode; of a carrier in the frame of its first frequency.

    `detuning` (M,) is omega0 - omega of each interval, rad/s. `carrier`: what a lock-in makes of the whole,
    exactly, where theta is known at each change: in a real signal the free part U of Z2, Re[U e^{j theta}],
    is conj(U) e^{-2j theta} of Z1. `begun`: not from rest where `hold.begun` says that an interval begins
    settled; a unit start is then that state once more. `order`: behind so many poles of a lock-in's filter,
    of time constant `hold.smoothing`, that were at rest as the log began, or settled. SECOND: no lock-in, but
    a plant without a frequency that is of second order (`_second_order`). `omega0` (M,) as `poles` has it.
    With numpy for `xp`, of B plants at once, (N, B): tau (B,), detuning (M, B), and what `hold` has of
    intervals and rows (M, 1) and (N, 1), but for `interval`.
    """
    if order == SECOND:
        return _second_order(tau, hold, xp)
    s = poles(tau, detuning, hold.omega, omega0, xp)
    push = s.gain * hold.drive
    ripple = xp.where(xp.isfinite(s.fast.imag), (_over if xp is jnp else np.divide)(push, s.fast), 0.0)
    kick = -xp.diff(ripple, axis=0, prepend=ripple[:1]).conj() * hold.turn if carrier else None
    settled = _settled(s.slow, push, hold, xp) if begun else None
    if order:
        found = smoothed(s.slow, push, ripple, hold, order, settled, xp)
    else:
        found = _propagate(s.slow, push, hold, settled if begun else kick, xp)
        fast = _settled(s.fast, -push, hold, xp) if begun and both_modes else None
        rest = _propagate(s.fast, -push, hold, fast, xp).forced if both_modes else ripple[hold.interval]
        found = found._replace(forced=found.forced + rest)
    if carrier:  # one that is late is turned by the frequency of its interval, which theta has told
        turning = 1j * (hold.omega - hold.omega[:1])[hold.interval]
        found = found._replace(rate=found.rate + turning * found.forced)
    return found if settled is None else found._replace(free=(settled[0] + (1 - hold.begun[0])) * found.free)


SECOND = -1  # instead of a number of poles
# of tau^2, by which the discriminant of two poles is off zero: costs six digits of sixteen where they
# coincide
APART = 1e-12


def _second_order(tau: Leaf, hold: Hold, xp: Any) -> Response:
    """Response of T^2 w'' + tau w' + w = V, which overshoots for tau < 2 T (damping ratio tau/(2 T)), with T
    e^{j phi} (s) for `hold.smoothing`. By partial fractions in its poles p and q,

        1/(1 + tau s + T^2 s^2) = a (-p)/(s - p) + (1 - a) (-q)/(s - q),    a = q/(q - p),

    and a start cos(phi) that moves at sin(phi)/T decays as

        cos(phi) (a e^{p t} + (1 - a) e^{q t}) + sin(phi) (e^{p t} - e^{q t})/((p - q) T).
    """
    time, phase, ones = xp.abs(hold.smoothing), xp.angle(hold.smoothing), xp.ones_like(hold.drive)
    root = xp.sqrt(tau**2 - 4 * time**2 + APART * tau**2 + 0j)
    p, q = (ones * (way * root - tau) / (2 * time**2) for way in (1, -1))
    share = q[0] / (q[0] - p[0])
    slow, fast = (_propagate(pole, -pole * hold.drive, hold, None, xp) for pole in (p, q))
    forced, rate, still = (share * x + (1 - share) * y for x, y in zip(slow, fast, strict=True))
    moving = (slow.free - fast.free) / ((p[0] - q[0]) * time)
    return Response(forced, rate, xp.cos(phase) * still + xp.sin(phase) * moving)


def _settled(pole: Leaf, push: Leaf, hold: Hold, xp: Any) -> Leaf:
    """(M,) the settled response of Z' = pole Z + push as an interval begins of which `hold.begun` says that
    it is there."""
    return -hold.begun * (_over if xp is jnp else np.divide)(push, pole)


@jax.custom_jvp
def _over(real: Array, z: Array) -> Array:
    """real/z of a z that neither over- nor underflows when squared: a fifth of the code of a division of
    complex numbers. Of the terms that its derivative has as it stands, two nearly cancel; that of a quotient
    has none such."""
    return (real / (z.real**2 + z.imag**2)) * z.conj()


@_over.defjvp
def _over_changes(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (real, z), (change, dz) = primals, tangents
    found = _over(real, z)
    return found, (change - found * dz) * (z.conj() / (z.real**2 + z.imag**2))


@jax.custom_jvp
def expm1(z: Array) -> Array:
    """exp(z) - 1 of a complex z without cancellation in either part; its derivative is exp(z), which 1 +
    value is only to the rounding of a turn: over a long interval, times its length, that of a mode which has
    long died away would be seen."""
    grown = jnp.expm1(z.real)
    s, c = jnp.sin(0.5 * z.imag), jnp.cos(0.5 * z.imag)  # each sine is much to compile
    return grown - 2 * (1 + grown) * s**2 + 2j * ((1 + grown) * s * c)


expm1.defjvps(lambda dz, value, z: jnp.exp(z) * dz)


def _propagate(pole: Leaf, push: Leaf, hold: Hold, kick: Leaf | None, xp: Any) -> Response:
    """Exact response of Z' = pole Z + push over held inputs, from rest, kicked as each begins; and the decay
    of a unit start.

    Z(t) = Z + (Z + push/pole) expm1(pole t): no difference of near-equal numbers as t or the detuning goes to
    zero, and nothing is divided by a time, so that zero-length intervals need no special case.
    """
    over, grow = (_over, expm1) if xp is jnp else (np.divide, np.expm1)
    target = over(push, pole)
    (forced, free), _ = carried(grow(pole * hold.duration), target, kick, xp)
    forced = forced if kick is None else forced + kick
    pole, target, forced, free = _of_rows([pole, target, forced, free], hold, xp)
    grown = grow(pole * hold.elapsed + _spread(pole, hold.spread))
    forced = forced + grown * (forced + target)
    return Response(forced, pole * (forced + target), free + grown * free)


def _spread(pole: Leaf, variance: Leaf) -> Leaf:
    """(N,) log of the mean of exp(pole t) over samples that are even over a row about t = 0, with this
    variance: log(sinh(a)/a), a^2 = 3 variance pole^2, to its eighth order in a."""
    square = pole**2 * variance
    return square * (0.5 - square * (1 / 20 - square / 105))


def _of_rows(parts: list[Leaf], hold: Hold, xp: Any) -> list[Leaf]:
    """Of numbers (M, ...) of the intervals those of each row's, (N, ...)."""
    if xp is np:
        return [v.take(hold.interval, axis=0) for v in parts]
    at = xp.stack(parts, axis=-1)[hold.interval]  # one look-up is less to compile than several
    return [at[..., i] for i in range(len(parts))]


def smoothed(
    pole: Leaf, push: Leaf, ripple: Leaf, hold: Hold, order: int, settled: Leaf | None, xp: Any
) -> Response:
    """As `_propagate`, behind a cascade of one-pole filters.

    Over an interval the slow mode is Z = -q + (Z_0 + q) e^{p t}, q = push/pole, on top of the settled
    `ripple`. With x = t/smoothing, stage j of the cascade is then, exactly,

        y_j = e^{-x} (sum_{m<j} y_(j-m)(0) x^m/m! + (ripple - q) x^j phi_j(x) + (Z_0 + q) x^j phi_j(p t + x))
    """
    over, grow = (_over, expm1) if xp is jnp else (np.divide, np.expm1)
    target = over(push, pole)
    (forced, free), _ = carried(grow(pole * hold.duration), target, settled, xp)
    forced = forced if settled is None else forced + settled
    rest, swing = ripple - target, forced + target

    def pushed(
        j: int, x: Leaf, flat: list[Leaf], swung: list[Leaf], passed: list[Leaf], rest: Leaf, swing: Leaf
    ) -> Leaf:
        known = sum(
            (passed[j - m - 1] * (x**m / math.factorial(m)) for m in range(1, j)), xp.zeros_like(rest)
        )
        return xp.exp(-x) * known + x**j * (rest * flat[j - 1] + swing * swung[j - 1])

    x = hold.duration / hold.smoothing
    flat, swung = phis(xp.zeros_like(x) + 0j, x, order, xp), phis(pole * hold.duration, x, order, xp)
    lost = xp.expm1(-x)
    held = xp.where(lost == 0, 1.0, lost)
    passed: list[Leaf] = []
    for j in range(1, order + 1):
        target = xp.where(lost == 0, 0.0, pushed(j, x, flat, swung, passed, rest, swing)) / held
        begun = None if settled is None else hold.begun * rest
        shown = carried(xp.broadcast_to(lost, target.shape).astype(complex), target, begun, xp)[0][0]
        passed.append(shown if begun is None else shown + begun)
    pole, rest, swing, free, *passed = _of_rows([pole, rest, swing, free, *passed], hold, xp)
    x = hold.elapsed / hold.smoothing
    flat, swung = phis(xp.zeros_like(x) + 0j, x, order, xp), phis(pole * hold.elapsed, x, order, xp)
    stages = [
        xp.exp(-x) * passed[j - 1] + pushed(j, x, flat, swung, passed, rest, swing)
        for j in range(1, order + 1)
    ]
    decay = xp.exp(pole * hold.elapsed)
    chain = [rest + swing * decay, *stages]
    rates = [pole * swing * decay, *((before - y) / hold.smoothing for before, y in pairwise(chain))]
    # The mean over the samples of a row is y + y'' variance / 2, to third order; long after a change, of the
    # plate's alone.
    late = (x > SETTLED) & (xp.abs(pole * hold.smoothing) < 0.5)
    left = pole**2 * swing * decay / (1 + xp.where(late, pole * hold.smoothing, 0.0)) ** order
    bent = xp.where(late, left, (rates[-2] - rates[-1]) / hold.smoothing)
    return Response(stages[-1] + 0.5 * hold.spread * bent, rates[-1], free * decay)


SETTLED = 50.0  # time constants of a pole of the filter, after which it has forgotten


def phis(turned: Leaf, x: Leaf, order: int, xp: Any = jnp) -> list[Leaf]:
    """e^{-x} phi_j(turned + x) for j = 1 to `order`, phi_j(z) = (phi_(j-1)(z) - 1/(j-1)!)/z, phi_0 = exp.

    That recursion where |z| > 1; elsewhere the last by its series and the recursion backwards: none of them
    cancels, also where a pole of the plate is that of the filter, z = 0.
    """
    z, decay = turned + x, xp.exp(-x)
    near = xp.abs(z) < 1
    small, large = xp.where(near, z, 0.0), xp.where(near, 1.0, z)
    series: Any = 0.0
    for k in reversed(range(18)):
        series = series * small + 1 / math.factorial(k + order)
    below, above = [decay * series], [xp.exp(turned)]
    for j in range(1, order + 1):
        above.append((above[-1] - decay / math.factorial(j - 1)) / large)
    for j in range(order - 1, 0, -1):
        below.append(small * below[-1] + decay / math.factorial(j))
    return [xp.where(near, a, b) for a, b in zip(reversed(below), above[1:], strict=True)]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["G", "tau", "f0", "k_T"],
    meta_fields=["reference_temperature"],
)
@dataclass(frozen=True)
class Plant:
    """One resonance: G (response per drive), tau (s), f0 (Hz) at `reference_temperature` (degC), k_T
    (Hz/degC).

    A JAX pytree: `jax.grad`, `jax.vmap` and `jax.jit` go through it. `f0` None: a first-order plant, driven
    at resonance.

    >>> plant = Plant(G=0.02, tau=1.669e-3, f0=32300.0)
    >>> round(plant.Q, 1)
    169.4
    >>> print(f"{plant.steady(100.0, 32300.0):.2f}")
    2.00+0.00j
    """

    G: float | None
    tau: float
    f0: float | None = None
    k_T: float | None = None
    reference_temperature: float = 24.0

    @property
    def Q(self) -> float | None:
        """Quality factor pi f0 tau."""
        return None if self.f0 is None else math.pi * self.f0 * self.tau

    @float64
    def steady(self, drive, frequency=None, temperature=None) -> Leaf:
        """Settled response Wd + j Wq to peak `drive` at `frequency` (Hz) and `temperature` (degC), of their
        common shape."""
        frequency = jnp.asarray(np.nan if frequency is None or self.f0 is None else frequency)
        warming = 0.0 if temperature is None else jnp.asarray(temperature) - self.reference_temperature
        detuning = 2 * jnp.pi * (self._resonance(warming) - frequency)
        return _plain(self._gain * jnp.asarray(drive) * steady(self.tau, detuning, 2 * jnp.pi * frequency))

    @float64
    def transient(
        self, time, drive, frequency=None, temperature=None, *, start=0.0, settled=False, both_modes=False
    ) -> Leaf:
        """Response Wd + j Wq (n,) of inputs held from row to row, beginning at `start` (complex) with no
        drive before it.

        time: (n,) s, non-decreasing. Row k's response is the one just before row k's inputs act, or, when
        `settled`, the one that row k's inputs have led to since row k-1. `both_modes`: with the ripple of the
        fast pole, for Q below LOW_Q. Arrays of numpy come back; within `jax.grad`, `jit` or `vmap` those of
        JAX, in 64 bits under `jax.enable_x64(True)`.
        """
        if self.f0 is None:
            frequency = None
        time = np.asarray(time, float)
        reference = (0.0, self.reference_temperature)
        hold = hold_inputs(
            time, drive, frequency, temperature, settled=settled, reference=reference, at_rest=True
        )
        resonance = self._resonance(hold.warming)
        detuning = 2 * jnp.pi * (resonance + hold.offset)
        found = respond(self.tau, detuning, hold, both_modes=both_modes, omega0=2 * jnp.pi * resonance)
        return _plain(self._gain * found.forced + start * found.free)

    @property
    def _gain(self):
        if self.G is None:
            raise ValueError("this plant has no gain G: the logs it was fitted to record no drive")
        return self.G

    def _resonance(self, warming):
        """Resonance (Hz) `warming` degC above the reference; 0 for a plant that has none."""
        f0 = 0.0 if self.f0 is None else self.f0
        return f0 if self.k_T is None else f0 + self.k_T * warming


LOW_Q = 20.0  # below, the ripple of the fast mode (1/(4Q) of the response) outlasts what a lock-in can remove


def _plain(value: Array) -> Leaf:
    return value if isinstance(value, jax.core.Tracer) else np.asarray(value)
