"""Effects: what a scene may add to the bare plate, each a small final type with its equation, units, default
and source.

An effect that a scene does not name is not there: no equation, no parameter. Four kinds, in the order in
which they act:

    drive   (inputs) -> inputs                 what the amplifier makes of what was asked for
    plate   (motion, inputs, plant, felt) -> motion     time constant, detuning and drive of one interval
    sense   (response, inputs) -> response     what the sensor makes of the motion
    noise   (response, key, ...) -> response   drawn, never fitted

Effects on damping act on 1/tau alone: b = G/tau holds no damping, so that a finger scales G and tau together.
Fields carry the unit in which they are kept; a scene file may state another of the same kind.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from sysid.model.carry import carried
from sysid.model.plant import Plant
from sysid.rows.hold import Leaf, contact

T = TypeVar("T")
LEAST_DAMPED = 0.05  # of the damping: with none of it the plate would run away


class Inputs(NamedTuple):
    """What holds over each interval (M,), or at each row: `drive` peak, `omega` rad/s, `offset` = reference -
    drive frequency rad/s, `warming` degC above the plant's reference temperature, `force` N and `contact`,
    the mean square of the mode's shape under the finger over its mean on the plate; None where the scene has
    none."""

    drive: Leaf
    omega: Leaf
    offset: Leaf
    warming: Leaf
    force: Leaf
    contact: Leaf = None


class Motion(NamedTuple):
    """What drives the plate over each interval: time constant s, detuning omega0 - omega rad/s, drive per
    untouched gain."""

    tau: Leaf
    detuning: Leaf
    drive: Leaf


EFFECTS: dict[str, Any] = {}  # by the name that scene files use, in the order in which they act


def effect(name: str, kind: str) -> Callable[[type[T]], type[T]]:
    """Make a class a final, frozen effect: a JAX pytree whose numbers are leaves, listed in EFFECTS."""

    def register(cls: type[T]) -> type[T]:
        cls = dataclass(frozen=True)(cls)
        own = fields(cls)  # type: ignore[arg-type]
        static = [f.name for f in own if f.metadata.get("static")]
        leaves = [f.name for f in own if not f.metadata.get("static")]
        jax.tree_util.register_dataclass(cls, data_fields=leaves, meta_fields=static)
        cls.name, cls.kind = name, kind  # type: ignore[attr-defined]
        EFFECTS[name] = cls
        return cls

    return register


def number(default: float, unit: str = "1", sign: str = "") -> Any:
    """A leaf in `unit`; "response" and "drive" stand for the scene's own units. `sign`: of scene.SIGNS."""
    return field(default=default, metadata={"unit": unit, "sign": sign})


def word(default: Any, *choices: str) -> Any:
    """What decides which equations there are."""
    return field(default=default, metadata={"static": True, "choices": choices})


# --- drive
# ------------------------------------------------------------------------------------------------------------


@effect("inverter", "drive")
class Inverter:
    """Duty cycle to voltage: V = supply * duty, or the fundamental of a three-level inverter, (4/pi) supply
    sin(pi duty/2)."""

    supply: float = number(200.0, "drive", "+")
    law: str = word("linear", "linear", "sine")

    def drive(self, inputs: Inputs) -> Inputs:
        gain = inputs.drive if self.law == "linear" else 4 / jnp.pi * jnp.sin(0.5 * jnp.pi * inputs.drive)
        return inputs._replace(drive=self.supply * gain)


@effect("amplifier_limit", "drive")
class AmplifierLimit:
    """The amplifier saturates: -limit <= V <= limit. Default: 3.5 times the drive of 2 um at 0.02 um/V."""

    limit: float = number(350.0, "drive", "+")

    def drive(self, inputs: Inputs) -> Inputs:
        return inputs._replace(drive=jnp.clip(inputs.drive, -self.limit, self.limit))


@effect("frequency_resolution", "drive")
class FrequencyResolution:
    """A timer or synthesiser whose frequency is a multiple of `step`: f = step * round(f/step). It reports
    that frequency."""

    step: float = number(10.0, "Hz", "+")


@effect("phase_reset", "drive")
class PhaseReset:
    """A synthesiser that starts at phase zero on each new frequency: at time t the frame turns by 2 pi
    f_before t, and so does the response in it, Z -> Z exp(j 2 pi f_before t). Without it the phase goes
    on."""


# --- plate
# ------------------------------------------------------------------------------------------------------------


@effect("finger_damping", "plate")
class FingerDamping:
    """A finger adds damping: 1/tau -> (1 + rho(F))/tau with b = G/tau untouched. At 1.5 N the default halves
    the amplitude, as Ben Messaoud et al. (ACTUATOR 2014, figure 3) measured; the laws between are
    contact-area laws. Where the scene has an input `contact`, rho is that times it: a finger on a nodal line
    takes less than one beside it."""

    rho: float = number(1.0, sign="0+")
    scale: float = number(0.6, "N", "+")
    exponent: float = number(2 / 3, sign="+")
    law: str = word("saturating", "saturating", "power")

    def ratio(self, inputs: Inputs) -> Array:
        damping = self.rho * contact(inputs.force, self.law, self.scale, self.exponent, jnp)
        return damping if inputs.contact is None else damping * inputs.contact

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        damped = 1 + self.ratio(inputs)
        return motion._replace(tau=motion.tau / damped, drive=motion.drive / damped)


@effect("finger_detuning", "plate")
class FingerDetuning:
    """A finger of impedance r + jX shifts the resonance by -(X/r) rho(F)/(2 pi tau): `ratio` is X/r,
    mass-like above zero.

    The damping rho(F) is that of the scene's finger_damping."""

    ratio: float = number(0.3)
    finger: FingerDamping = field(default_factory=FingerDamping, metadata={"given": True})

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        return motion._replace(detuning=motion.detuning - self.ratio * self.finger.ratio(inputs) / plant.tau)


@effect("curved", "plate")
class Curved:
    """f0 is not linear in the temperature: f0 + k_T w + change w^2/2, w degC above the plant's reference
    temperature, as that of a quartz: k_T changes by `change` per degC."""

    change: float = number(0.1, "Hz/degC^2")

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        return motion._replace(detuning=motion.detuning + jnp.pi * self.change * inputs.warming**2)


@effect("temperature_damping", "plate")
class TemperatureDamping:
    """The damping, 1 where the plant's reference temperature is, grows by `more` per degC above it."""

    more: float = number(0.02, "1/degC")

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        damping = jnp.maximum(1 + self.more * inputs.warming, LEAST_DAMPED)
        return motion._replace(tau=motion.tau / damping, drive=motion.drive / damping)


@effect("duffing", "plate")
class Duffing:
    """Softening: f0(W) = f0 - softening W^2. Bistable when the shift exceeds 1.54 half bandwidths."""

    feels: ClassVar[bool] = True
    softening: float = number(5.0, "Hz/response^2")

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        return motion._replace(detuning=motion.detuning - 2 * jnp.pi * self.softening * felt.power)


@effect("self_heating", "plate")
class SelfHeating:
    """The plate warms by what it dissipates: C dT/dt = 1/2 d (omega W)^2 - h T, and f0 moves by k_T T.

    T in degC above the surroundings, C J/K, h W/K, d N s/m; the defaults are those of an aluminium plate of
    88 g."""

    feels: ClassVar[bool] = True
    capacity: float = number(80.0, "J/K", "+")
    loss: float = number(0.55, "W/K", "+")
    damping: float = number(53.0, "N*s/m", "0+")
    metres: float = field(default=1e-6, metadata={"given": True})  # of one unit of the response

    def plate(self, motion: Motion, inputs: Inputs, plant: Plant, felt: Any) -> Motion:
        return motion._replace(detuning=motion.detuning + 2 * jnp.pi * plant.k_T * felt.heat)

    def warmed(self, heat: Array, power: Array, omega: Array, duration: Array) -> Array:
        """Temperature after `duration` at a squared amplitude `power`."""
        target = 0.5 * self.damping * (omega * self.metres) ** 2 * power / self.loss
        return heat - jnp.expm1(-self.loss / self.capacity * duration) * (target - heat)


@effect("second_mode", "plate")
class SecondMode:
    """A further resonance on the same drive, Z + Z2, from rest; a scene may hold several. G in units of the
    scene, tau s, f0 Hz, k_T Hz/degC. A sensor that is elsewhere than where the response is meant sees `seen`
    times its motion; `parity` is that across two ceramics in parallel, which cancel an odd resonance."""

    repeats: ClassVar[bool] = True
    G: float = number(0.002, "response/drive")
    tau: float = number(1.5e-3, "s", "+")
    f0: float = number(33500.0, "Hz", "+")
    k_T: float = number(0.0, "Hz/degC")
    seen: float = number(1.0)
    parity: str = word("odd", "odd", "even")


# --- sense
# ------------------------------------------------------------------------------------------------------------


@effect("two_ceramics", "sense")
class TwoCeramics:
    """Two ceramics in parallel give the mean of their motions: a further mode that is odd across them leaks
    by half their mismatch, Z + (mismatch/2) Z2, an even one whole; and an input resistance leads by
    atan(1/(omega R C))."""

    mismatch: float = number(0.05)
    resistance: float = number(1e6, "ohm", "+")
    capacitance: float = number(4e-9, "F", "+")

    def sense(self, response: Array, inputs: Inputs) -> Array:
        return response * jnp.exp(1j * jnp.arctan(1 / (inputs.omega * self.resistance * self.capacitance)))


@effect("feedthrough", "sense")
class Feedthrough:
    """The drive leaks into the sensor: Z + (d + j q) V. The voltage lies along q, so resistive pickup is
    q."""

    d: float = number(0.0, "response/drive")
    q: float = number(0.0, "response/drive")

    def sense(self, response: Array, inputs: Inputs) -> Array:
        return response + (self.d + 1j * self.q) * inputs.drive


@effect("rotation", "sense")
class Rotation:
    """The demodulator's phase: Z exp(j angle)."""

    angle: float = number(0.0, "deg")

    def sense(self, response: Array, inputs: Inputs) -> Array:
        return response * jnp.exp(1j * jnp.deg2rad(self.angle))


@effect("lock_in", "sense")
class LockIn:
    """The demodulator's filter: `order` one-pole low-passes of time constant `tau` in a row, solved
    exactly."""

    tau: float = number(50e-6, "s", "+")
    order: int = word(1)


@effect("delay", "sense")
class Delay:
    """A row shows the response of `time` before it."""

    time: float = number(10e-6, "s", "0+")


@effect("offset", "sense")
class Offset:
    """An output offset: Z + d + j q."""

    d: float = number(0.0, "response")
    q: float = number(0.0, "response")

    def sense(self, response: Array, inputs: Inputs) -> Array:
        return response + (self.d + 1j * self.q)


# --- noise, and what the recorder makes of it
# -----------------------------------------------------------------------------


@effect("white_noise", "noise")
class WhiteNoise:
    """Gaussian, `std` in each of Wd and Wq, independent from row to row."""

    std: float = number(0.02, "response", "0+")

    def noise(self, response: Array, key: Array, step: Array, state: Any) -> tuple[Array, Any]:
        return response + self.std * _normal(key, len(response)), state


@effect("coloured_noise", "noise")
class ColouredNoise:
    """Gaussian, `std` in each of Wd and Wq, correlated by exp(-|t|/time): Ornstein-Uhlenbeck, exact on the
    rows."""

    std: float = number(0.02, "response", "0+")
    time: float = number(1e-3, "s", "0+")

    def init(self, key: Array) -> Array:
        return self.std * _normal(key, 1)[0]

    def noise(self, response: Array, key: Array, step: Array, state: Array) -> tuple[Array, Array]:
        lost = jnp.expm1(-step / self.time)
        fresh = self.std * jnp.sqrt(-jnp.expm1(-2 * step / self.time)) * _normal(key, len(response))
        growth = jnp.full(len(response), lost, complex)
        (forced, free), (end, share) = carried(growth, fresh / growth)
        return response + forced + free * state, end + share * state


@effect("outliers", "noise")
class Outliers:
    """Each row is, with probability `fraction`, off by a Gaussian of `std` in each of Wd and Wq."""

    fraction: float = number(0.01, sign="share")
    std: float = number(0.5, "response", "0+")

    def noise(self, response: Array, key: Array, step: Array, state: Any) -> tuple[Array, Any]:
        which, size = jax.random.split(key)
        hit = jax.random.uniform(which, (len(response),)) < self.fraction
        return response + jnp.where(hit, self.std * _normal(size, len(response)), 0.0), state


@effect("drop_outs", "noise")
class DropOuts:
    """The signal is lost (zero) for `duration`, on average `rate` times a second: a vibrometer's speckle."""

    rate: float = number(5.0, "1/s", "0+")
    duration: float = number(1e-3, "s", "0+")

    def init(self, key: Array) -> Array:
        return jnp.asarray(-jnp.inf)

    def noise(self, response: Array, key: Array, step: Array, state: Array) -> tuple[Array, Array]:
        row = jnp.arange(len(response))
        begins = jax.random.uniform(key, (len(response),)) < -jnp.expm1(-self.rate * step)
        last = jax.lax.cummax(jnp.maximum(jnp.where(begins, row * step, -jnp.inf), state))
        lost = row * step - last < self.duration
        return jnp.where(lost, 0.0, response), last[-1] - len(response) * step


@effect("saturation", "noise")
class Saturation:
    """The recorder clips Wd and Wq at +-limit."""

    limit: float = number(2.0, "response", "+")

    def noise(self, response: Array, key: Array, step: Array, state: Any) -> tuple[Array, Any]:
        return jnp.clip(response.real, -self.limit, self.limit) + 1j * jnp.clip(
            response.imag, -self.limit, self.limit
        ), state


@effect("quantisation", "noise")
class Quantisation:
    """The recorder's steps: Wd and Wq to the nearest multiple of `step`."""

    step: float = number(0.01, "response", "+")

    def noise(self, response: Array, key: Array, step: Array, state: Any) -> tuple[Array, Any]:
        return self.step * (
            jnp.round(response.real / self.step) + 1j * jnp.round(response.imag / self.step)
        ), state


def _normal(key: Array, n: int) -> Array:
    pair = jax.random.normal(key, (2, n), float)
    return pair[0] + 1j * pair[1]
