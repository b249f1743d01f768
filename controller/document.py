"""The content of controller.json."""

from collections.abc import Iterable, Mapping
from typing import Any

from controller.adaptive import Adaptive
from controller.commission import sheet
from controller.design import Loop
from controller.dq import DQ
from controller.machine import Machine
from controller.margins import Bode
from controller.promise import Promise
from controller.scalar import NO_LIMIT
from controller.tracker import SignTracker
from sysid.asked import LOOP, given

SCHEMA = 1


def as_dict(loop: Loop) -> dict[str, Any]:
    """The content of controller.json, ready for json.dumps: numbers, units, notes; null for what there is
    not.

    Gains are in drive unit per response unit. They serve either axis; the step in C and in Python closes d.
    """
    given("loop", loop, Loop, LOOP)
    T, machine, limits, d = loop.sample_time, loop.switched, loop.limits, loop.demodulator
    guard = machine and machine.control
    heard = d and {"rate_Hz": d.rate, "share": d.share, "poles": d.order}
    heard = d and heard | {"delay_s": d.delay, "scale": d.scale}
    content = {
        "schema": SCHEMA,
        "plate": loop.plate,
        "plant": {"G": loop.G, "tau": loop.tau, "f0": loop.f0, "k_T": loop.k_T},
        "reference_temperature_degC": loop.reference_temperature,
        "sample_time_s": T,
        "latency_s": loop.latency,
        "delay_s": loop.delay,
        "bandwidth_Hz": loop.bandwidth_hz,
        "bandwidth_limit_Hz": loop.bandwidth_limit_hz,
        "bandwidth_bound": loop.bandwidth_bound,
        "method": loop.method,
        **_law(loop.law),
        "continuous": {"Kp": loop.Kp_continuous, "Ti_s": loop.Ti},
        "voltage_limit": limits.voltage,
        "frequency_window_Hz": None if limits.frequency is None else list(limits.frequency),
        "limits_from": limits.said,
        "tracker": _tracker(loop.law, T),
        "range": {
            "finger": loop.finger,
            "force_N": loop.force,
            "warming_degC": list(loop.warming),
            "amplitude": loop.amplitude,
        },
        "promise": _promise(loop.promise),
        # for how long it looks on
        "guard": guard and {"patience_s": guard.patience * T, "stuck_after_s": guard.repeats * T},
        "rig": _rig(loop.rig),
        "demodulator": heard,
        "start_up": None if machine is None else _start_up(machine, T),
        "units": {"drive": loop.drive_unit, "response": loop.response_unit},
        "notes": list(loop.notes),
    }
    return content | {"commissioning": [stage._asdict() for stage in sheet(content)]}


def _law(law: DQ | Adaptive) -> dict[str, Any]:
    """Its gains, and the model that a PI follows."""
    if isinstance(law, Adaptive):
        observer = {"K": law.K, "keep_d": law.keep[0], "keep_q": law.keep[1], "push": law.push}
        observer["damping"] = law.damping
        return {"gains": observer, "anti_windup": None, "feed_forward": None}
    pi, m = law.amplitude, law.amplitude.model
    gains = {"Kp": pi.Kp, "Ki_Ts": pi.Ki_Ts}
    fed = m and {"keep": m.keep, "push": m.push, "latest": m.latest, "remembered": len(m.line)}
    return {"gains": {"d": gains, "q": dict(gains)}, "anti_windup": pi.anti_windup, "feed_forward": fed}


def _start_up(m: Machine, T: float) -> dict[str, float]:
    found = {"find": m.find, "ramp_per_s": m.ramp / T, "headroom": m.headroom, "heaviest": m.heaviest}
    return found | {"settled_s": m.patience * T, "lost_s": m.limit * T}


def _rig(value: Any) -> Any:
    """A rig, and what it is made of, by names; nothing for what it does not have."""
    if hasattr(value, "_fields"):
        return {name: _rig(v) for name, v in zip(value._fields, value, strict=True) if v is not None}
    return value


def _tracker(law: DQ | Adaptive, T: float) -> dict[str, float] | None:
    t: Any = law if isinstance(law, Adaptive) else law.tracker
    if t is None:
        return None
    every = getattr(t, "every", 1.0)
    numbers = {"start_Hz": t.start, "gate": t.gate, "every_samples": every, "period_s": every * T}
    if isinstance(t, Adaptive):
        return numbers
    if isinstance(t, SignTracker):
        return numbers | {"step_Hz": t.size}
    return numbers | {"gain_Hz": t.gain, "max_step_Hz": t.max_step}


def _promise(p: Promise) -> dict[str, Any]:
    names = {"settling": "settling_s", "overshoot": "overshoot", "small": "small_overshoot"}
    names |= {"gain": "gain_margin", "phase": "phase_margin_deg"}
    names |= {"disk": "disk_margin", "delay": "delay_margin_s"}
    kept: dict[str, Any] = {said: _known(getattr(p, name)) for name, said in names.items()}
    kept["startup_s"] = _known(p.startup)
    kept["quantiles_5_50_95"] = {said: [_known(q) for q in p.spread[name]] for name, said in names.items()}
    shown = ("time_s", "W_5", "W_50", "W_95", "V_5", "V_50", "V_95")
    step = dict(zip(shown, (*p.response[:4], *p.response.voltage), strict=True))
    return kept | {"step_response": _digits(step), "bode": None if p.bode is None else _bode(p.bode)}


def _bode(shown: Bode) -> dict[str, list[float]]:
    """The loop over frequency: |L|, its phase in degrees, and the sensitivity, each at three quantiles."""
    rows = {"frequency_Hz": shown.frequency}
    for name, band in zip(("L", "phase_deg", "S"), shown[1:], strict=True):
        rows |= {f"{name}_{q}": row for q, row in zip((5, 50, 95), band, strict=True)}
    return _digits(rows)


def _digits(rows: Mapping[str, Iterable[float]]) -> dict[str, list[float]]:
    """To five digits."""
    return {name: [float(f"{v:.5g}") for v in row] for name, row in rows.items()}


def _known(value: float) -> float | None:
    """None for what is not finite: it does not settle, or no gain is too much."""
    return value if abs(value) < NO_LIMIT else None
