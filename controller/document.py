"""The content of controller.json."""

from typing import Any

from controller.adaptive import Adaptive
from controller.commission import sheet
from controller.design import Loop
from controller.dq import DQ
from controller.scalar import NO_LIMIT
from controller.tracker import SignTracker

SCHEMA = 1


def as_dict(loop: Loop) -> dict[str, Any]:
    """The content of controller.json, ready for json.dumps: numbers, units, notes; null for what there is
    not.

    Gains are in drive unit per response unit. They serve either axis; the step in C and in Python closes d.
    """
    content = {
        "schema": SCHEMA,
        "plate": loop.plate,
        "plant": {"G": loop.G, "tau": loop.tau, "f0": loop.f0, "k_T": loop.k_T},
        "reference_temperature_degC": loop.reference_temperature,
        "sample_time_s": loop.sample_time,
        "latency_s": loop.latency,
        "delay_s": loop.delay,
        "bandwidth_Hz": loop.bandwidth_hz,
        "bandwidth_limit_Hz": loop.bandwidth_limit_hz,
        "bandwidth_bound": loop.bandwidth_bound,
        **_law(loop),
        "feed_forward": _feed_forward(loop),
        "continuous": {"Kp": loop.Kp_continuous, "Ti_s": loop.Ti},
        "voltage_limit": loop.limits.voltage,
        "frequency_window_Hz": None if loop.limits.frequency is None else list(loop.limits.frequency),
        "limits_from": loop.limits.said,
        "tracker": _tracker(loop),
        "range": _range(loop),
        "promise": _promise(loop),
        "guard": _guard(loop),
        "rig": _rig(loop.rig),
        "demodulator": _demodulator(loop),
        "start_up": _start_up(loop),
        "units": {"drive": loop.drive_unit, "response": loop.response_unit},
        "notes": list(loop.notes),
    }
    return content | {"commissioning": [stage._asdict() for stage in sheet(content)]}


def _range(loop: Loop) -> dict[str, Any]:
    touched = {"finger": loop.finger, "force_N": loop.force}
    return touched | {"warming_degC": list(loop.warming), "amplitude": loop.amplitude}


def _law(loop: Loop) -> dict[str, Any]:
    law = loop.law
    if isinstance(law, DQ):
        gains = {"Kp": law.amplitude.Kp, "Ki_Ts": law.amplitude.Ki_Ts}
        return {
            "method": loop.method,
            "gains": {"d": gains, "q": dict(gains)},
            "anti_windup": law.amplitude.anti_windup,
        }
    observer = {
        "K": law.K,
        "keep_d": law.keep[0],
        "keep_q": law.keep[1],
        "push": law.push,
        "damping": law.damping,
    }
    return {"method": loop.method, "gains": observer, "anti_windup": None}


def _guard(loop: Loop) -> dict[str, float] | None:
    """For how long it looks on; None where there is none."""
    if (machine := loop.switched) is None:
        return None
    guard = machine.control
    return {
        "patience_s": guard.patience * loop.sample_time,
        "stuck_after_s": guard.repeats * loop.sample_time,
    }


def _feed_forward(loop: Loop) -> dict[str, Any] | None:
    """The model that the PI follows; None where nothing is fed forward."""
    if not isinstance(loop.law, DQ) or (model := loop.law.amplitude.model) is None:
        return None
    return {"keep": model.keep, "push": model.push, "latest": model.latest, "remembered": len(model.line)}


def _demodulator(loop: Loop) -> dict[str, float] | None:
    """How it is sampled; None without f0."""
    d = loop.demodulator
    return (
        None
        if d is None
        else {"rate_Hz": d.rate, "share": d.share, "poles": d.order, "delay_s": d.delay, "scale": d.scale}
    )


def _start_up(loop: Loop) -> dict[str, float] | None:
    """The machine's numbers; None without one."""
    if (machine := loop.switched) is None:
        return None
    found = {
        "find": machine.find,
        "ramp_per_s": machine.ramp / loop.sample_time,
        "headroom": machine.headroom,
    }
    found |= {"heaviest": machine.heaviest}
    return found | {
        "settled_s": machine.patience * loop.sample_time,
        "lost_s": machine.limit * loop.sample_time,
    }


def _rig(value: Any) -> Any:
    """A rig, and what it is made of, by names; nothing for what it does not have."""
    if hasattr(value, "_fields"):
        return {name: _rig(v) for name, v in zip(value._fields, value, strict=True) if v is not None}
    return value


def _tracker(loop: Loop) -> dict[str, float] | None:
    law = loop.law
    t = law if isinstance(law, Adaptive) else law.tracker
    if t is None:
        return None
    if isinstance(t, Adaptive):
        return {"start_Hz": t.start, "gate": t.gate, "every_samples": 1.0, "period_s": loop.sample_time}
    numbers = {
        "start_Hz": t.start,
        "gate": t.gate,
        "every_samples": t.every,
        "period_s": t.every * loop.sample_time,
    }
    if isinstance(t, SignTracker):
        return numbers | {"step_Hz": t.size}
    return numbers | {"gain_Hz": t.gain, "max_step_Hz": t.max_step}


def _promise(loop: Loop) -> dict[str, Any]:
    p = loop.promise
    names = {
        "settling": "settling_s",
        "overshoot": "overshoot",
        "gain": "gain_margin",
        "phase": "phase_margin_deg",
    }
    names |= {"disk": "disk_margin", "delay": "delay_margin_s"}
    kept: dict[str, Any] = {said: _known(getattr(p, name)) for name, said in names.items()}
    kept["startup_s"] = _known(p.startup)
    kept["quantiles_5_50_95"] = {said: [_known(q) for q in p.spread[name]] for name, said in names.items()}
    shown = zip(("time_s", "W_5", "W_50", "W_95"), p.response[:4], strict=True)
    step = {said: [float(f"{v:.5g}") for v in values] for said, values in shown}
    step |= {
        f"V_{level}": [float(f"{v:.5g}") for v in row]
        for level, row in zip((5, 50, 95), p.response.voltage, strict=True)
    }
    return kept | {"step_response": step, "bode": _bode(p.bode)}


def _bode(shown: Any) -> dict[str, list[float]] | None:
    """The loop over frequency, to five digits: |L|, its phase in degrees, and the sensitivity, each at three
    quantiles."""
    if shown is None:
        return None
    rows = {"frequency_Hz": shown.frequency}
    rows |= {f"{name}_{q}": row for name, band in zip(("L", "phase_deg", "S"), shown[1:], strict=True)
             for q, row in zip((5, 50, 95), band, strict=True)}  # fmt: skip
    return {name: [float(f"{v:.5g}") for v in row] for name, row in rows.items()}


def _known(value: float) -> float | None:
    """None for what is not finite: it does not settle, or no gain is too much."""
    return value if abs(value) < NO_LIMIT else None
