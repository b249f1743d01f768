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
from typing import Any, Literal, NamedTuple, final

import numpy as np

from controller.adaptive import Adaptive
from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.guard import Guard
from controller.limits import Limits, amplitude_of, limits_of
from controller.pi import PI
from controller.plate import Plate, plate_of, positive, units_of
from controller.promise import Promise, promise, settling
from controller.rig import Calibrated, Rig
from controller.tracker import SignTracker, Tracker

PREDICTED_SHARE, PREDICTED_K = 0.1, 0.5  # the same where the delay is predicted, and the largest K there: disk margin 0.8
CLOSED_LOOP_SHARE = 0.3  # default tau_cl / tau, the paper's 0.5 ms for 1.67 ms: V peaks at 1/0.3 of its end value
BETA = 0.3  # share of the detuning that one tracker update removes
TRACKER_PERIOD = 1e-3  # s, the shortest time between two updates
FAULT_AFTER, STUCK_AFTER = 5e-3, 2e-2  # s, for which the guard looks on
OBSERVER = 5e-4, 2.5e-4  # s, time constants of the observer for the resonance, whose noise is heard, and for the damping

Bound = Literal["stated", "plant", "delay", "posterior", "settling"]
Method = Literal["pi", "paper", "adaptive"]


@final
@dataclass(frozen=True)
class Loop:
    """A designed controller. `control` is what runs (`init`, `step`): the `law` behind its sensor's correction and its guard. The
    rest says what it was made of, and for.

    A `DQ` has no tracker when f0 is not determined; `notes` then says why. `bandwidth_bound` is what decided the bandwidth:
    "stated" by the caller, "settling" that was asked for, "plant" (a closed loop of 0.3 tau), "delay" (no oscillation with the
    delay that there is: `bandwidth_limit_hz`) or "posterior" (that, for what the logs leave open of G/tau). `Kp_continuous`
    and `Ti` (s) are the gains of the same loop in continuous time. `amplitude` (response unit) is the one `promise` is for,
    `finger` and `warming` the range. `sample_time` and `latency` are in s, `reference_temperature` (where f0 holds) in degC;
    units are None when nobody stated them.
    """

    control: DQ | Adaptive | Calibrated | Guard
    law: DQ | Adaptive
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
    "paper", the rules of the paper; "adaptive", an observer of the pole. `guard`: faults end the drive (see `controller.guard`).

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
    most = -math.log1p(-PREDICTED_K) if method == "adaptive" else _delay_limit((latency + rig.sensor_delay) / T)
    bandwidth_limit = most / (2 * math.pi * T)
    plants = Ensemble.of(source, plate.means, finger, warming if plate.f0 is not None and plate.k_T is not None else (0.0, 0.0))
    amplitude = amplitude_of(plate, limits, amplitude, finger)
    asked = _Asked(plate, T, latency, limits, rig, method, plants, amplitude, float(finger))
    bandwidth, bound = _bandwidth(asked, bandwidth_hz, settling_time, bandwidth_limit)
    law = asked.control(bandwidth)
    response_unit, drive_unit = units_of(plate.fit)
    return Loop(
        control=_guarded(_calibrated(law, rig, plate), asked) if guard else _calibrated(law, rig, plate),
        law=law,
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


def _calibrated(control: DQ | Adaptive, rig: Rig, plate: Plate) -> DQ | Adaptive | Calibrated:
    if rig.sensor is None:
        return control
    if rig.sensor.delay and plate.f0 is None:
        raise ValueError(f"the sensor's delay cannot be corrected: f0 is not determined: {plate.why}")
    correction = rig.sensor.correction(plate.f0 or 0.0)
    return Calibrated(control, correction.real, correction.imag)


def _guarded(control: DQ | Adaptive | Calibrated, asked: "_Asked") -> Guard:
    """Faults after 5 ms; the largest amplitude is that of the voltage limit on the untouched plate, and a fifth more."""
    plate, limits, T = asked.plate, asked.limits, asked.T
    gain = (asked.rig.sensor.gain if asked.rig.sensor else 1.0) * abs(plate.G)
    limit = PI(1.0, 1.0).highest if limits.voltage is None else limits.voltage
    ceiling = limit if limits.voltage is None else 1.2 * gain * limit
    window = limits.frequency or (0.0, PI(1.0, 1.0).highest)
    patience, repeats = (math.ceil(t / T) for t in (FAULT_AFTER, STUCK_AFTER))
    finger = 1.0 + asked.finger
    return Guard(control, limit, ceiling, gain / finger, -math.expm1(-T / plate.tau), *window, float(patience), float(repeats))


class _Asked(NamedTuple):
    """All that a control is made from, but the bandwidth."""

    plate: Plate
    T: float
    latency: float
    limits: Limits
    rig: Rig
    method: Method
    plants: Ensemble
    amplitude: float
    finger: float

    def control(self, bandwidth: float) -> DQ | Adaptive:
        if self.method == "adaptive":
            return self._adaptive(bandwidth)
        plate, T = self.plate, self.T
        lowest, highest = self._voltages()
        K = -math.expm1(-2 * math.pi * bandwidth * T)
        Kp = K / (plate.G * -math.expm1(-T / plate.tau))
        pi = PI(Kp, K / plate.G, lowest, highest, self.rig.slew(T))
        return DQ(pi, None if plate.f0 is None else self._tracker(plate.f0))

    def promise(self, control: DQ | Adaptive) -> Promise:
        seen = self.latency + self.rig.sensor_delay
        return promise(control, self.plants, self.T, seen, self.amplitude, self.plate.f0)

    def _voltages(self) -> tuple[float, float]:
        limit = self.limits.voltage
        free = PI(1.0, 1.0)
        return (free.lowest if self.rig.bipolar else 0.0, free.highest) if limit is None else (-limit * self.rig.bipolar, limit)

    def _tracker(self, f0: float) -> Tracker | SignTracker:
        if self.method == "paper":
            return SignTracker(start=f0, every=float(max(1, round(TRACKER_PERIOD / self.T))))
        # With q = Wq / Wd: q' = -q / tau + delta, delta' = -beta q / (period tau), damping sqrt(period / (4 beta tau)).
        # 1 ms gives the paper's plate 0.7; a plate that rings longer is updated less often, or its tracker would oscillate.
        period = max(TRACKER_PERIOD, 2 * BETA * self.plate.tau)
        half_bandwidth = 1 / (2 * math.pi * self.plate.tau)
        every = float(max(1, round(period / self.T)))
        return Tracker(BETA * half_bandwidth, half_bandwidth, f0, every, BETA, **self._frequency())

    def _frequency(self) -> dict[str, Any]:
        window = self.limits.frequency or (0.0, PI(1.0, 1.0).highest)
        quantum = self.rig.frequency_step
        k_T = self.plate.k_T if self.rig.thermometer else None
        if self.rig.thermometer and k_T is None:
            raise ValueError("no temperature feed-forward: k_T is not determined; record a sweep at another temperature")
        at = float(getattr(self.plate.fit, "reference_temperature", None) or 24.0)
        dead_band = 0.0 if quantum is None else 0.1 * quantum
        given = {"lowest": window[0], "highest": window[1], "quantum": quantum, "dead_band": dead_band}
        return given | {"k_T": k_T, "temperature": at}

    def _adaptive(self, bandwidth: float) -> Adaptive:
        plate, T = self.plate, self.T
        if plate.f0 is None:
            raise ValueError(f"no adaptive controller: f0 is not determined: {plate.why}; method 'pi' does without")
        lowest, highest = self._voltages()
        heard, fast = OBSERVER
        # Between the steps of a coarse source only a quiet estimate decides: its noise goes with t^-1.5.
        slow, fast = (math.exp(-T / max(t, 2 * T)) for t in (heard if self.rig.frequency_step is None else 4 * heard, fast))
        return Adaptive(
            plate.G / plate.tau * T, T / plate.tau, 2 * math.pi * T, plate.f0, -math.expm1(-2 * math.pi * bandwidth * T),
            (fast, slow), (0.0,) * round(self.latency / T), lowest, highest, self.rig.slew(T), **self._frequency(),
        )  # fmt: skip


def _delay_limit(samples: float) -> float:
    """-ln(1 - K) of the largest K whose poles are real with so many samples of delay: K = d^d / (d+1)^(d+1)."""
    K = samples**samples / (samples + 1) ** (samples + 1)
    return -math.log1p(-K) if K < 1 else 2.0  # without delay every K has a real pole; 2 leaves 14 % of the error each sample


def _bandwidth(asked: _Asked, bandwidth: float | None, settling: float | None, limit: float) -> tuple[float, Bound]:
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
        delay = asked.latency + asked.rig.sensor_delay
        why = f" for 99 % of what the logs leave of G/tau (up to {100 * (plate.spread - 1):.2g} % above its mean)"
        raise ValueError(
            f"bandwidth_hz = {bandwidth:g} cannot be had: with a delay of {delay:g} s the loop oscillates above {safe:.6g} Hz"
            f"{why if plate.spread > 1.005 else ''}; the nearest that can be had is {safe:.6g} Hz"
        )
    return min(float(bandwidth), safe), "stated"


def _settled(asked: _Asked, wanted: float, fastest: float) -> float:
    """The lowest bandwidth whose promise settles within `wanted` s. Raises ValueError with the limit that stands in the way."""
    positive("settling_time", wanted)

    def taken(bandwidth: float) -> float:
        seen = asked.latency + asked.rig.sensor_delay
        return settling(asked.control(bandwidth), asked.plants, asked.T, seen, asked.amplitude, asked.plate.f0)

    tried = np.geomspace(fastest / 8, fastest, 10)
    times = [taken(b) for b in tried[::-1]]  # from the fastest: overshoot may make it settle later than a slower one
    if (best := min(times)) > wanted * (1 + 1e-9):
        bound = _voltage_bound(asked)
        delay = asked.latency + asked.rig.sensor_delay
        if bound > wanted:
            why = (
                f"the voltage limit {asked.limits.voltage:g} stands in the way ({asked.limits.said}): at full voltage the"
                f" slowest of the plates takes {1e3 * bound:.3g} ms to 95 % of {asked.amplitude:g}"
            )
        else:
            why = f"the sample time {asked.T:g} s and the delay {delay:g} s stand in the way: a faster loop oscillates"
        nearest = f"the nearest that can be had is {1e3 * best:.4g} ms" if math.isfinite(best) else "no setting settles at all"
        raise ValueError(f"settling_time = {1e3 * wanted:g} ms cannot be had: {why}; {nearest}")
    return float(next(b for b, t in zip(tried, times[::-1], strict=True) if t <= wanted * (1 + 1e-9)))


def _voltage_bound(asked: _Asked) -> float:
    """Time at full voltage to 95 % of the amplitude, of the slowest plant: tau ln(r / (r - 0.95)), r = limit / steady voltage."""
    if asked.limits.voltage is None:
        return 0.0
    plants = asked.plants
    r = asked.limits.voltage * np.abs(plants.push) / plants.rate / abs(asked.amplitude)
    short = r <= 0.95
    times = np.log(np.where(short, 2.0, r) / np.where(short, 1.0, r - 0.95)) / plants.rate
    return float(np.max(np.where(short, np.inf, times)))


def _notes(asked: _Asked, bandwidth: float, bound: Bound) -> list[str]:
    plate, found = asked.plate, []
    if plate.f0 is None:
        found.append(f"no tracker: f0 is not determined: {plate.why}")
    if bound == "posterior":
        found.append(
            f"slower than the delay alone asks for: 1 % of the plates that the logs allow have a G/tau more than"
            f" {100 * (plate.spread - 1):.2g} % above its mean; a voltage step with rows close together determines it"
        )
    if asked.rig.sensor is None:
        turn = f": 1 us of it turns W by {360e-6 * plate.f0:.3g} degrees" if plate.f0 else ""
        found.append(f"the loop's sensor is taken to be that of the logs, without a delay of its own{turn}")
    return found
