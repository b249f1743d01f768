"""From an identified plate to a Loop: PI gains by exact discrete pole-zero cancellation, and the tracker's gain.

One axis of the plate under a held voltage is  W[k+1] = alpha W[k] + G (1 - alpha) V[k],  alpha = exp(-Ts / tau).
The controller  C(z) = Kp (z - alpha) / (z - 1)  leaves  K / (z - p)  when nothing delays the voltage:

    p = exp(-2 pi bandwidth Ts),  K = 1 - p,  Kp = K / (G (1 - alpha)),  Ki Ts = K / G.

With one sample of computing delay the poles are the roots of z (z - 1) + K: real, so without oscillation, for K <= 1/4.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, final

from controller.pi import PI
from controller.tracker import Tracker

CLOSED_LOOP_SHARE = 0.3  # default tau_cl / tau, the paper's 0.5 ms for 1.67 ms: V peaks at 1/0.3 of its end value
DELAY_K = 0.25  # the largest K whose poles are real with one sample of delay
BETA = 0.3  # share of the detuning that one tracker update removes
TRACKER_PERIOD = 1e-3  # s, the shortest time between two updates

Bound = Literal["stated", "plant", "delay"]


class Known(NamedTuple):
    """A parameter of a bare plant, in the form that a fit and a posterior give theirs."""

    value: float | None
    determined: bool
    why: str | None


@final
@dataclass(frozen=True)
class Loop:
    """A designed controller. `pi` and `tracker` are what runs; the rest says what they were made of, and for.

    `tracker` is None when f0 is not determined; `notes` then says why. `bandwidth_bound` is what decided the bandwidth:
    "stated" by the caller, "plant" (a closed loop of 0.3 tau) or "delay" (no oscillation with one sample of computing
    delay: `bandwidth_limit_hz`). `Kp_continuous` and `Ti` (s) are the gains of the same loop in continuous time.
    `sample_time` is in s, `reference_temperature` (where f0 holds) in degC; units are None when nobody stated them.
    """

    pi: PI
    tracker: Tracker | None
    G: float
    tau: float
    f0: float | None
    sample_time: float
    bandwidth_hz: float
    bandwidth_limit_hz: float
    bandwidth_bound: Bound
    Kp_continuous: float
    Ti: float
    drive_unit: str | None = None
    response_unit: str | None = None
    reference_temperature: float | None = None
    notes: tuple[str, ...] = ()


def design(
    source: Any, *, sample_time: float = 1e-4, bandwidth_hz: float | None = None, voltage_limit: float | None = None
) -> Loop:
    """The controller for a sample time in s and a closed-loop bandwidth 1 / (2 pi tau_cl) in Hz.

    `source` is a posterior (has `summary()`: the gains come from the means), a fit (has `parameters`) or a plant (`G`,
    `tau`, `f0`). Default bandwidth: the slower of tau_cl = 0.3 tau and the delay limit K = 1/4. `voltage_limit` is the
    largest |V| in the drive unit (None: no clip).

    Raises ValueError when G or tau is not determined, and for a bandwidth that cannot be had.
    """
    _positive("sample_time", sample_time)
    if voltage_limit is not None:
        _positive("voltage_limit", voltage_limit)
    parameters, fit = _read(source)
    G, tau = _needed(parameters, "G"), _needed(parameters, "tau")
    if G == 0.0 or tau <= 0.0:
        raise ValueError(f"no controller: a plant with G = {G:g} and tau = {tau:g} s cannot be controlled")
    limit = -math.log1p(-DELAY_K) / (2 * math.pi * sample_time)
    bandwidth, bound = _bandwidth(bandwidth_hz, tau, limit)
    f0, why = _value(parameters, "f0")
    response_unit, drive_unit = _units(fit)
    return Loop(
        pi=_pi(G, tau, sample_time, bandwidth, voltage_limit),
        tracker=None if f0 is None else _tracker(f0, tau, sample_time),
        G=G,
        tau=tau,
        f0=f0,
        sample_time=float(sample_time),
        bandwidth_hz=bandwidth,
        bandwidth_limit_hz=limit,
        bandwidth_bound=bound,
        Kp_continuous=2 * math.pi * bandwidth * tau / G,
        Ti=tau,
        drive_unit=drive_unit,
        response_unit=response_unit,
        reference_temperature=getattr(fit, "reference_temperature", None),
        notes=() if f0 is not None else (f"no tracker: f0 is not determined: {why}",),
    )


def _pi(G: float, tau: float, sample_time: float, bandwidth: float, voltage_limit: float | None) -> PI:
    K = -math.expm1(-2 * math.pi * bandwidth * sample_time)
    Kp = K / (G * -math.expm1(-sample_time / tau))
    return PI(Kp=Kp, Ki_Ts=K / G, voltage_limit=sys.float_info.max if voltage_limit is None else float(voltage_limit))


def _tracker(f0: float, tau: float, sample_time: float) -> Tracker:
    # With q = Wq / Wd: q' = -q / tau + delta, delta' = -beta q / (period tau), damping sqrt(period / (4 beta tau)).
    # 1 ms gives the paper's plate 0.7; a plate that rings longer is updated less often, or its tracker would oscillate.
    period = max(TRACKER_PERIOD, 2 * BETA * tau)
    half_bandwidth = 1 / (2 * math.pi * tau)
    every = max(1, round(period / sample_time))
    return Tracker(gain=BETA * half_bandwidth, max_step=half_bandwidth, start=f0, every=every)


def _bandwidth(asked: float | None, tau: float, limit: float) -> tuple[float, Bound]:
    plant = 1 / (2 * math.pi * CLOSED_LOOP_SHARE * tau)
    if asked is None:
        return (plant, "plant") if plant <= limit else (limit, "delay")
    if not asked > 0:
        raise ValueError(
            f"bandwidth_hz = {asked:g} cannot be had: any above 0 and up to {limit:.6g} Hz can; "
            f"the default is {min(plant, limit):.6g} Hz"
        )
    if asked > limit * (1 + 1e-5):  # the six digits that the message below prints are accepted
        raise ValueError(
            f"bandwidth_hz = {asked:g} cannot be had: with one sample of computing delay the loop oscillates above "
            f"{limit:.6g} Hz (1 - p <= 1/4 at this sample time); the nearest that can be had is {limit:.6g} Hz"
        )
    return min(float(asked), limit), "stated"


def _read(source: Any) -> tuple[Mapping[str, Any], Any]:
    """The parameters by name, and the object that knows units and reference temperature."""
    if hasattr(source, "summary"):
        # A posterior may name only what was sampled; for the rest the fit says why.
        return {**source.fit.parameters, **source.summary()}, source.fit
    if hasattr(source, "parameters"):
        return source.parameters, source
    values = {name: getattr(source, name) for name in ("G", "tau", "f0")}
    return {name: Known(value, value is not None, f"the plant has no {name}") for name, value in values.items()}, source


def _value(parameters: Mapping[str, Any], name: str) -> tuple[float | None, str]:
    """The value, None when not determined, and then why."""
    p = parameters.get(name, Known(None, False, "the fit does not have it"))
    if p.determined and p.value is not None and math.isfinite(p.value):
        return float(p.value), ""
    return None, p.why or "the fit gives no reason"


def _needed(parameters: Mapping[str, Any], name: str) -> float:
    value, why = _value(parameters, name)
    if value is None:
        raise ValueError(f"no controller: {name} is not determined: {why}")
    return value


def _units(fit: Any) -> tuple[str | None, str | None]:
    """Response and drive unit, None when not stated: "m/s/V" is m/s per V."""
    response, slash, drive = getattr(fit, "units", {}).get("G", "").rpartition("/")
    return (response, drive) if slash else (None, None)


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value:g} must be a finite number above 0")
