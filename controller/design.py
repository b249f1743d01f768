"""From an identified plate, and what a person wants, to a Loop whose promise holds over the posterior.

One axis of the plate under a held voltage is  W[k+1] = alpha W[k] + G (1 - alpha) V[k],  alpha = exp(-Ts / tau).
The controller  C(z) = Kp (z - alpha) / (z - 1)  leaves  K / (z - p)  when nothing delays the voltage:

    p = exp(-2 pi bandwidth Ts),  K = 1 - p,  Kp = K / (G (1 - alpha)),  Ki Ts = K / G.

With d samples of delay the poles are the roots of z^d (z - 1) + K: real, so without oscillation, for
K <= d^d / (d+1)^(d+1), which is 1/4 for one sample. The true K is that of a plate's own G/tau, which a finger leaves alone and
the posterior spreads: the limit holds for 99 % of it, so that a posterior that says little gives a slower loop.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np

from controller.adaptive import Adaptive
from controller.demodulator import Demodulator
from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.guard import Guard
from controller.laws import SAMPLES, Asked, Method, calibrated, demodulated, guarded, switched
from controller.limits import Limits, amplitude_of, limits_of
from controller.machine import Machine
from controller.plate import plate_of, positive, units_of
from controller.promise import Promise, settling
from controller.rig import Calibrated, Rig

PREDICTED_SHARE, PREDICTED_K = 0.1, 0.5  # the same where the delay is predicted, and the largest K there: disk margin 0.8
CLOSED_LOOP_SHARE = 0.3  # default tau_cl / tau, the paper's 0.5 ms for 1.67 ms: V peaks at 1/0.3 of its end value

Bound = Literal["stated", "plant", "delay", "posterior", "settling"]


@final
@dataclass(frozen=True)
class Loop:
    """A designed controller. `control` is what runs (`init`, `step`): the `law` behind its sensor's correction and its guard;
    `machine` is that with what switches it on, as it is exported, None without a guard; `demodulator` what gives it Wd and Wq,
    None without f0. The rest says what it was made of, and for.

    A `DQ` has no tracker when f0 is not determined; `notes` then says why. `bandwidth_bound` is what decided the bandwidth:
    "stated" by the caller, "settling" that was asked for, "plant" (a closed loop of 0.3 tau), "delay" (no oscillation with the
    delay that there is: `bandwidth_limit_hz`) or "posterior" (that, for what the logs leave open of G/tau). `Kp_continuous`
    and `Ti` (s) are the gains of the same loop in continuous time. `amplitude` (response unit) is the one `promise` is for,
    `finger` and `warming` the range. `sample_time` and `latency` are in s, `reference_temperature` (where f0 holds) in degC;
    units are None when nobody stated them.
    """

    control: DQ | Adaptive | Calibrated | Guard
    law: DQ | Adaptive
    machine: Machine | Calibrated | None
    demodulator: Demodulator | None
    method: Method
    G: float
    tau: float
    f0: float | None
    sample_time: float
    latency: float
    bandwidth_hz: float
    bandwidth_limit_hz: float
    bandwidth_bound: Bound
    Kp_continuous: float
    Ti: float
    limits: Limits
    amplitude: float
    finger: float
    warming: tuple[float, float]
    promise: Promise
    rig: Rig
    drive_unit: str | None = None
    response_unit: str | None = None
    reference_temperature: float | None = None
    notes: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()  # sha256


def design(
    source: Any,
    *,
    sample_time: float | None = None,
    latency: float | None = None,
    bandwidth_hz: float | None = None,
    settling_time: float | None = None,
    amplitude: float | None = None,
    voltage_limit: float | None = None,
    frequency_window: tuple[float, float] | None = None,
    finger: float = 0.0,
    warming: tuple[float, float] = (0.0, 0.0),
    method: Method = "pi",
    rig: Rig | None = None,
    guard: bool = True,
) -> Loop:
    """The controller for what is wanted: a closed-loop bandwidth 1 / (2 pi tau_cl) in Hz, or a settling time (5 %) in s.

    `source` is a posterior (has `summary()`: gains from the means, the promise over the draws), a fit (has `parameters`) or a
    plant (`G`, `tau`, `f0`). `sample_time` is 100 us and `latency` one sample where neither they nor a `rig` say otherwise.
    Default bandwidth: the slower of tau_cl = 0.3 tau and the delay's limit. `amplitude` (response unit) is the largest that
    will be asked for. `voltage_limit` (drive unit) and `frequency_window` (Hz) default to what the logs have seen; where there
    are no logs, to none. `finger`: the damping that a finger adds at most, in units of the plate's own (1: it halves the
    amplitude); `warming`: degC above the reference temperature, from and to. `method`: "pi", PI and proportional tracker;
    "paper", the rules of the paper; "pll", PI and phase-locked loop; "adaptive", an observer of the
    pole. `guard`: faults end the drive (see `controller.guard`); only with it there is a `machine`, and an export.

    Raises ValueError when G or tau is not determined, and for what cannot be had, with the limit that stands in the way and
    the nearest that can.
    """
    rig = rig or Rig()
    T = positive("sample_time", sample_time if sample_time is not None else rig.sample_time)
    latency = T if (given := latency if latency is not None else rig.latency) is None else float(given)
    if not 0.0 <= latency < 1000 * T:
        raise ValueError(f"found latency = {latency:g} s, expected 0 to a thousand samples")
    if method == "adaptive":
        latency = math.ceil(latency / T - 1e-9) * T  # its commands are latched at the next sample
    plate = plate_of(source)
    limits = limits_of(plate, rig, voltage_limit, frequency_window, warming)
    late = rig.delay(plate.f0) / T
    most = -math.log1p(-PREDICTED_K / (1 + late)) if method == "adaptive" else _delay_limit(latency / T + late)
    bandwidth_limit = most / (2 * math.pi * T)
    plants = Ensemble.of(source, plate.means, finger, warming if plate.f0 is not None and plate.k_T is not None else (0.0, 0.0))
    amplitude = amplitude_of(plate, limits, amplitude, finger)
    asked = Asked(plate, T, latency, limits, rig, method, plants, amplitude, float(finger))
    bandwidth, bound = _bandwidth(asked, bandwidth_hz, settling_time, bandwidth_limit)
    law = asked.control(bandwidth)
    safe = guarded(law, asked) if guard else None
    response_unit, drive_unit = units_of(plate.fit)
    return Loop(
        control=calibrated(safe or law, asked),
        law=law,
        machine=None if safe is None else calibrated(switched(safe, asked), asked),
        demodulator=demodulated(asked),
        method=method,
        G=plate.G,
        tau=plate.tau,
        f0=plate.f0,
        sample_time=T,
        latency=latency,
        bandwidth_hz=bandwidth,
        bandwidth_limit_hz=bandwidth_limit,
        bandwidth_bound=bound,
        Kp_continuous=2 * math.pi * bandwidth * plate.tau / plate.G,
        Ti=plate.tau,
        limits=limits,
        amplitude=amplitude,
        finger=float(finger),
        warming=(float(warming[0]), float(warming[1])),
        promise=asked.promise(law),
        rig=rig,
        drive_unit=drive_unit,
        response_unit=response_unit,
        reference_temperature=getattr(plate.fit, "reference_temperature", None),
        notes=tuple(_notes(asked, bandwidth, bound)),
        logs=tuple(fitted.log.sha256 for fitted in getattr(plate.fit, "logs", ()) if fitted.log.sha256),
    )


def _delay_limit(samples: float) -> float:
    """-ln(1 - K) of the largest K whose poles are real with so many samples of delay: K = d^d / (d+1)^(d+1)."""
    K = samples**samples / (samples + 1) ** (samples + 1)
    return -math.log1p(-K) if K < 1 else 2.0  # without delay every K has a real pole; 2 leaves 14 % of the error each sample


def _bandwidth(asked: Asked, bandwidth: float | None, settling: float | None, limit: float) -> tuple[float, Bound]:
    if bandwidth is not None and settling is not None:
        raise ValueError("found bandwidth_hz and settling_time, expected one of them: each decides the other")
    plate, T = asked.plate, asked.T
    share = PREDICTED_SHARE if asked.method == "adaptive" else CLOSED_LOOP_SHARE
    plant = 1 / (2 * math.pi * share * plate.tau)
    safe = min(limit, -math.log1p(math.expm1(-2 * math.pi * limit * T) / plate.spread) / (2 * math.pi * T))
    if settling is not None:
        return _settled(asked, settling, safe), "settling"
    if bandwidth is None:
        return (plant, "plant") if plant <= safe else (safe, "delay" if safe > 0.98 * limit else "posterior")
    if not bandwidth > 0:
        raise ValueError(
            f"bandwidth_hz = {bandwidth:g} cannot be had: any above 0 and up to {safe:.6g} Hz can; "
            f"the default is {min(plant, safe):.6g} Hz"
        )
    if bandwidth > safe * (1 + 1e-5):  # the six digits that the message below prints are accepted
        why = f" for 99 % of what the logs leave of G/tau (up to {100 * (plate.spread - 1):.2g} % above its mean)"
        raise ValueError(
            f"bandwidth_hz = {bandwidth:g} cannot be had: with a delay of {asked.delay:g} s the loop oscillates above"
            f" {safe:.6g} Hz{why if plate.spread > 1.005 else ''}; the nearest that can be had is {safe:.6g} Hz"
        )
    return min(float(bandwidth), safe), "stated"


def _settled(asked: Asked, wanted: float, fastest: float) -> float:
    """The lowest bandwidth whose promise settles within `wanted` s. Raises ValueError with the limit that stands in the way."""
    positive("settling_time", wanted)

    def taken(bandwidth: float) -> float:
        return settling(asked.control(bandwidth), asked.plants, asked.T, asked.delay, asked.amplitude, asked.plate.f0)

    tried = np.geomspace(fastest / 8, fastest, 10)
    times = [taken(b) for b in tried[::-1]]  # from the fastest: overshoot may make it settle later than a slower one
    if (best := min(times)) > wanted * (1 + 1e-9):
        bound = _voltage_bound(asked)
        if bound > wanted:
            why = (
                f"the voltage limit {asked.limits.voltage:g} stands in the way ({asked.limits.said}): at full voltage the"
                f" slowest of the plates takes {1e3 * bound:.3g} ms to 95 % of {asked.amplitude:g}"
            )
        else:
            why = f"the sample time {asked.T:g} s and the delay {asked.delay:g} s stand in the way: a faster loop oscillates"
        nearest = f"the nearest that can be had is {1e3 * best:.4g} ms" if math.isfinite(best) else "no setting settles at all"
        raise ValueError(f"settling_time = {1e3 * wanted:g} ms cannot be had: {why}; {nearest}")
    return float(next(b for b, t in zip(tried, times[::-1], strict=True) if t <= wanted * (1 + 1e-9)))


def _voltage_bound(asked: Asked) -> float:
    """Time at full voltage to 95 % of the amplitude, of the slowest plant: tau ln(r / (r - 0.95)), r = limit / steady voltage."""
    if asked.limits.voltage is None:
        return 0.0
    plants = asked.plants
    r = asked.limits.voltage * np.abs(plants.push) / plants.rate / abs(asked.amplitude)
    short = r <= 0.95
    times = np.log(np.where(short, 2.0, r) / np.where(short, 1.0, r - 0.95)) / plants.rate
    return float(np.max(np.where(short, np.inf, times)))


def _notes(asked: Asked, bandwidth: float, bound: Bound) -> list[str]:
    plate, found = asked.plate, []
    if plate.f0 is None:
        found.append(f"no tracker: f0 is not determined: {plate.why}")
    if bound == "posterior":
        found.append(
            f"slower than the delay alone asks for: 1 % of the plates that the logs allow have a G/tau more than"
            f" {100 * (plate.spread - 1):.2g} % above its mean; a voltage step with rows close together determines it"
        )
    sensor = asked.rig.sensor
    if sensor is None:
        turn = f": 1 us of it turns W by {360e-6 * plate.f0:.3g} degrees" if plate.f0 else ""
        found.append(f"the loop's sensor is taken to be that of the logs, without a delay of its own{turn}")
    elif sensor.gain_error or sensor.angle_error:
        beside = math.tan(math.radians(sensor.angle_error)) / (2 * math.pi * plate.tau)
        found.append(
            f"the loop's sensor is known to {100 * sensor.gain_error / sensor.gain:.2g} % and {sensor.angle_error:.2g} degrees"
            f" (standard deviations): the amplitude to as much, and the tracker settles within {beside:.2g} Hz of the resonance"
        )
    if plate.f0 is not None and asked.rig.adc is None:
        found.append(f"the exported demodulator is for {SAMPLES} samples of the sensor in a period of the carrier: no rig says")
    return found
