"""From an identified plate, and what a person wants, to a Loop whose promise holds over the posterior."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from controller.adaptive import Adaptive
from controller.bandwidth import Bandwidth, Bound, abrupt, bandwidth_of, unkept, unpromised
from controller.demodulator import SAMPLES, Demodulator
from controller.dq import DQ
from controller.ensemble import Ensemble
from controller.guard import Guard
from controller.laws import Asked, calibrated, guarded, switched
from controller.limits import Limits, amplitude_of, check_rig, limits_of, range_of
from controller.machine import Machine
from controller.plate import plate_of, positive, units_of
from controller.promise import Promise
from controller.rig import METHODS, Calibrated, Method, Rig
from sysid.asked import given, number
from sysid.shown import Shown


@final
@dataclass(frozen=True, repr=False)
class Loop(Shown):
    """A designed controller. `control` is what runs (`init`, `step`): the `law` behind its sensor's
    correction and its guard; `machine` is that with what switches it on, as it is exported, None without a
    guard; `demodulator` what gives it Wd and Wq, None without f0. The rest says what it was made of, and for.

    A `DQ` has no tracker when f0 is not determined; `notes` then says why. `bandwidth_bound` is what decided
    the bandwidth: "stated" by the caller, "settling" that was asked for, "plant" (a closed loop of 0.3 tau),
    "delay" (no oscillation with the delay that there is: `bandwidth_limit_hz`) or "posterior" (that, for what
    the logs leave open of G/tau). `Kp_continuous` and `Ti` (s) are the gains of the same loop in continuous
    time. `amplitude` (response unit) is the one `promise` is for, `finger`, the `force` (N) at which it is as
    much, where the fit knows it, and `warming` the range; `plate` its name in the logs. `sample_time` and
    `latency` are in s, `reference_temperature` (where f0 holds) in degC; units are None when nobody stated
    them.
    """

    control: DQ | Adaptive | Calibrated | Guard
    law: DQ | Adaptive
    machine: Machine | Calibrated | None
    demodulator: Demodulator | None
    method: Method
    G: float
    tau: float
    f0: float | None
    k_T: float | None
    sample_time: float
    latency: float
    bandwidth_hz: float
    bandwidth_limit_hz: float
    bandwidth_bound: Bound
    Kp_continuous: float
    Ti: float
    limits: Limits
    amplitude: float
    plate: str | None
    finger: float
    force: float | None
    warming: tuple[float, float]
    promise: Promise
    rig: Rig
    drive_unit: str | None = None
    response_unit: str | None = None
    reference_temperature: float | None = None
    notes: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()  # sha256

    def _brief(self) -> Any:
        """What it is made for, and what it promises."""
        from sysid.report.brief import Brief
        from sysid.report.text import seconds

        promise, limit, unit = self.promise, self.limits.voltage, self.response_unit or ""
        plate = "" if self.plate is None else f" for the plate {self.plate}"
        head = f"Loop: {self.method}{plate}, a sample every {seconds(self.sample_time)}"
        settling = seconds(promise.settling) if math.isfinite(promise.settling) else "none, as a note says"
        margins = f"gain {promise.gain:.3g}, phase {promise.phase:.3g} deg, disk {promise.disk:.3g}"
        f0 = "not known: no tracker" if self.f0 is None else f"{self.f0:.8g} Hz"
        rows = (
            ("plate", f"G {self.G:.6g}, tau {seconds(self.tau)}, f0 {f0}"),
            ("closed loop", f"{self.bandwidth_hz:.4g} Hz, by {self.bandwidth_bound}"),
            ("settling to 5 %", f"{settling}, to {self.amplitude:.4g} {unit}".rstrip()),
            ("margins", margins),
            ("voltage limit", "none" if limit is None else f"{limit:.4g} {self.drive_unit or ''}".rstrip()),
        )
        return Brief(head, ("", "kept by 99 % of the plants"), rows, self.notes[:3])

    def plot(self, path: str | Path | None = None) -> tuple[Any, Any]:
        """Figures of matplotlib: the promised step response beside its voltage; loop and sensitivity over
        frequency. `path`: a folder into which both are written, step.png and bode.png."""
        from controller.document import as_dict
        from sysid.report.plots import loop_figures

        figures = loop_figures(as_dict(self))
        if path is not None:
            for name, figure in zip(("step.png", "bode.png"), figures, strict=True):
                figure.savefig(Path(path) / name)
        return figures

    @property
    def switched(self) -> Machine | None:
        """The machine without its sensor's correction."""
        return self.machine.control if isinstance(self.machine, Calibrated) else self.machine

    @property
    def delay(self) -> float:
        """s, from a motion of the plate to the command for it: drive, sensor, demodulator and latency."""
        return self.latency + self.rig.delay(self.f0)


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
    finger: float | None = None,
    warming: tuple[float, float] | None = None,
    method: Method | None = None,
    rig: Rig | None = None,
    guard: bool = True,
) -> Loop:
    """The controller for what is wanted: a closed-loop bandwidth 1 / (2 pi tau_cl) in Hz, or a settling time
    (5 %) in s.

    `source` is a posterior (has `summary()`: gains from the means, the promise over the draws), a fit (has
    `parameters`) or a plant (`G`, `tau`, `f0`). `sample_time` is 100 us and `latency` one sample where
    neither they nor a `rig` say otherwise. Default bandwidth: the slower of tau_cl = 0.3 tau and the delay's
    limit. `amplitude` (response unit) is the largest that will be asked for. `voltage_limit` (drive unit) and
    `frequency_window` (Hz) default to what the logs have seen; where there are no logs, to none. `finger`:
    the damping that a finger adds at most, in units of the plate's own (1: it halves the amplitude);
    `warming`: degC above the reference temperature, from and to; both default to the rig's, else to none.
    `method`: "pi", PI and proportional tracker; "paper", the rules of the paper; "pll", PI and phase-locked
    loop; "adaptive", an observer of the pole. The PI of "pi" and "pll" feeds the reference forward where the
    voltage has a limit and no slew limit, unless a bandwidth is stated, or a settling time that the loop
    alone keeps. `guard`: faults end the drive (see `controller.guard`); only with it there is a `machine`,
    and an export.

    Raises ValueError when G or tau is not determined, and for what cannot be had, with the limit that stands
    in the way and the nearest that can; TypeError for what is of another kind.
    """
    given("rig", rig, Rig | None, "a Rig, as controller.Rig.from_toml(path) reads it")
    rig = rig or Rig()
    method = method or rig.method or "pi"
    if method not in METHODS:
        raise ValueError(f"found method = {method!r}, expected one of {', '.join(METHODS)}")
    if settling_time is None and bandwidth_hz is None:
        settling_time = rig.settling
    amplitude = rig.amplitude if amplitude is None else amplitude
    T = positive("sample_time", sample_time if sample_time is not None else rig.sample_time)
    plate = plate_of(source)
    ranged = range_of(plate, rig, finger, warming)
    limits = limits_of(plate, rig, voltage_limit, frequency_window, ranged.warming)
    plants = Ensemble.of(plate, ranged, rig.thermometer)
    amplitude = amplitude_of(plate, limits, amplitude, ranged.finger, plants)
    check_rig(plate, rig, limits, amplitude)
    late = _latency(T, latency if latency is not None else rig.latency, method)
    asked = Asked(plate, T, late, limits, rig, method, plants, amplitude, ranged)
    return _loop(asked, bandwidth_of(asked, bandwidth_hz, settling_time), guard)


def _latency(T: float, stated: float | None, method: Method) -> float:
    latency = T if stated is None else number("latency", stated)
    if not 0.0 <= latency < 1000 * T:
        raise ValueError(f"found latency = {latency:g} s, expected 0 to a thousand samples")
    # The commands of the observer are latched at the next sample.
    return math.ceil(latency / T - 1e-9) * T if method == "adaptive" else latency


def _loop(asked: Asked, bandwidth: Bandwidth, guard: bool) -> Loop:
    """Raises ValueError where the promise cannot be kept."""
    plate, law = asked.plate, asked.control(bandwidth.hz, bandwidth.lead)
    safe = guarded(law, asked) if guard else None
    promise = asked.promise(law, safe)
    long = None if math.isfinite(promise.settling) else unpromised(asked, law)
    if not math.isfinite(promise.settling) and long is None:
        raise ValueError(unkept(asked, bandwidth.hz, bandwidth.lead))
    machine = None if safe is None else switched(safe, asked)
    touched = None if machine is None else abrupt(asked, bandwidth.hz, machine)
    response_unit, drive_unit = units_of(plate.fit)
    return Loop(
        control=calibrated(safe or law, asked),
        law=law,
        machine=None if machine is None else calibrated(machine, asked),
        demodulator=asked.demodulator,
        method=asked.method,
        G=plate.G,
        tau=plate.tau,
        f0=plate.f0,
        k_T=plate.k_T,
        sample_time=asked.T,
        latency=asked.latency,
        bandwidth_hz=bandwidth.hz,
        bandwidth_limit_hz=bandwidth.limit,
        bandwidth_bound=bandwidth.bound,
        Kp_continuous=2 * math.pi * bandwidth.hz * plate.tau / plate.G,
        Ti=plate.tau,
        limits=asked.limits,
        amplitude=asked.amplitude,
        plate=plate.name,
        **asked.ranged._asdict(),
        promise=promise,
        rig=asked.rig,
        drive_unit=drive_unit,
        response_unit=response_unit,
        reference_temperature=getattr(plate.fit, "reference_temperature", None),
        notes=tuple(_notes(asked, bandwidth.bound, long, touched)),
        logs=tuple(fitted.log.sha256 for fitted in getattr(plate.fit, "logs", ()) if fitted.log.sha256),
    )


def _notes(asked: Asked, bound: Bound, *known: str | None) -> list[str]:
    plate, found = asked.plate, [said for said in known if said is not None]
    if plate.tau < asked.T:
        found.append(
            f"the sample time, {asked.T:g} s, is longer than the plate's time constant, {plate.tau:.3g} s:"
            " what touches it is seen when it has settled, and a fault ends the drive after"
            f" {1e3 * asked.patience * asked.T:.3g} ms"
        )
    if plate.f0 is None:
        found.append(f"no tracker: {plate.why}")
    if bound == "posterior":
        found.append(
            "slower than the delay alone asks for: 1 % of the plates that the logs allow have a G/tau more"
            f" than {100 * (plate.spread - 1):.2g} % above its mean; a voltage step with rows close together"
            " determines it"
        )
    most, limits = asked.rig.voltage_limit, asked.limits
    if most is not None and limits.voltage is not None and limits.voltage < most and limits.said != "stated":
        found.append(
            f"the voltage limit is {limits.voltage:.4g}, {limits.said}, and not the rig's {most:.4g}: a log"
            " with a larger drive raises it, or controller.design(voltage_limit=...)"
        )
    sensor = asked.rig.sensor
    if sensor is None:
        turn = f": 1 us of it turns W by {360e-6 * plate.f0:.3g} degrees" if plate.f0 else ""
        found.append(f"the loop's sensor is taken to be that of the logs, without a delay of its own{turn}")
    elif sensor.gain_error or sensor.angle_error:
        beside = math.tan(math.radians(sensor.angle_error)) * plate.half_bandwidth
        found.append(
            f"the loop's sensor is known to {100 * sensor.gain_error / sensor.gain:.2g} % and"
            f" {sensor.angle_error:.2g} degrees (standard deviations): the amplitude to as much, and the"
            f" tracker settles within {beside:.2g} Hz of the resonance"
        )
    if plate.f0 is not None and asked.rig.adc is None:
        found.append(
            f"the exported demodulator is for {SAMPLES} samples of the sensor in a period of the carrier:"
            f" no rig says"
        )
    return found
