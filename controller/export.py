"""A Loop for other programs: a C99 header with the same arithmetic, sample for sample, and controller.json."""

import re
from controller.scalar import NO_LIMIT
from pathlib import Path
from typing import Any

from controller.design import Loop

SCHEMA = 1

_PI_C = """\
static const double dq_pi_sample_time = {sample_time}; /* s, call both steps once in this time */
static const double dq_pi_kp = {Kp}; /* {drive} per {response} */
static const double dq_pi_ki_ts = {Ki_Ts}; /* {drive} per {response}, integral gain times sample time */
static const double dq_pi_anti_windup = {anti_windup}; /* 1, ki_ts / kp */
static const double dq_pi_limit = {limit}; /* {drive}, largest |V|{no_limit} */

typedef struct {{
    double integral; /* {drive} */
    double output;   /* {drive}, peak; negative: turned by half a carrier period */
    int missing;     /* 1: this measurement was not finite, output and integral were held */
    int saturated;   /* 1: the output is clipped */
}} dq_pi_state;

static inline void dq_pi_init(dq_pi_state *s)
{{
    s->integral = 0.0;
    s->output = 0.0;
    s->missing = 0;
    s->saturated = 0;
}}

/* reference, wd, wq in {response}, peak; returns the voltage in {drive}, peak */
static inline double dq_pi_step(dq_pi_state *s, double reference, double wd, double wq)
{{
    double error, wanted, output;
    s->missing = !(isfinite(reference) && isfinite(wd) && isfinite(wq));
    if (s->missing) {{
        s->saturated = fabs(s->output) >= dq_pi_limit;
        return s->output;
    }}
    error = reference - wd;
    wanted = dq_pi_kp * error + s->integral;
    output = wanted > dq_pi_limit ? dq_pi_limit : (wanted < -dq_pi_limit ? -dq_pi_limit : wanted);
    s->integral = s->integral + dq_pi_ki_ts * error + (output - wanted) * dq_pi_anti_windup;
    s->output = output;
    s->saturated = output != wanted;
    return output;
}}
"""

_TRACKER_C = """\

static const double tracker_gain = {gain}; /* Hz per unit of wq / wd */
static const double tracker_max_step = {max_step}; /* Hz */
static const double tracker_start = {start}; /* Hz */
static const double tracker_gate = {gate}; /* 1, of the reference */
static const long tracker_every = {every}; /* samples between two updates */

typedef struct {{
    double frequency; /* Hz */
    double step;      /* Hz, of this sample */
    long count;       /* samples since the last update */
    int missing;      /* 1: this measurement was not finite */
    int held;         /* 1: an update was due, the frequency was held */
}} tracker_state;

static inline void tracker_init(tracker_state *s)
{{
    s->frequency = tracker_start;
    s->step = 0.0;
    s->count = 0;
    s->missing = 0;
    s->held = 0;
}}

/* reference, wd, wq in {response}, peak; returns the drive frequency in Hz */
static inline double tracker_step(tracker_state *s, double reference, double wd, double wq)
{{
    const double threshold = tracker_gate * reference;
    double step;
    s->missing = !(isfinite(reference) && isfinite(wd) && isfinite(wq));
    s->held = 0;
    s->step = 0.0;
    s->count += 1;
    if (s->count < tracker_every)
        return s->frequency;
    s->count = 0;
    s->held = s->missing || !(reference > 0.0 && wd > 0.0 && wd * wd + wq * wq > threshold * threshold);
    if (s->held)
        return s->frequency;
    step = tracker_gain * (wq / wd);
    s->step = step > tracker_max_step ? tracker_max_step : (step < -tracker_max_step ? -tracker_max_step : step);
    s->frequency += s->step;
    return s->frequency;
}}
"""

_HEADER_C = """\
/* Amplitude PI and resonance tracker of one identified plate, in double precision. Generated: do not edit.
 * Compile without contraction and without fast math (-ffp-contract=off): a fused multiply-add changes the last bit,
 * and fast math removes the test for a missing (not finite) measurement. */
#ifndef {guard}
#define {guard}

#include <math.h>

{body}
#endif
"""


def export_c(loop: Loop, path: str | Path) -> None:
    """Write the header with dq_pi_init, dq_pi_step and, when the loop has a tracker, tracker_init, tracker_step.

    Of the loop's texts only the two units go out, and of those only letters, digits and / ^ . - so that no text from a
    log can end a comment. Notes stay in the JSON.
    """
    units = {
        "drive": _unit_text(loop.drive_unit or "drive-unit"),
        "response": _unit_text(loop.response_unit or "response-unit"),
    }
    body = _PI_C.format(**units, **_pi_numbers(loop)) + _tracker_text(loop, units)
    text = _HEADER_C.format(guard=_guard(Path(path).name), body=body)
    Path(path).write_text(text, encoding="ascii", newline="\n")


def as_dict(loop: Loop) -> dict[str, Any]:
    """The content of controller.json, ready for json.dumps: numbers, units, notes; null for what there is not.

    Gains are in drive unit per response unit. They serve either axis; the step in C and in Python closes d.
    """
    limited = loop.control.amplitude.voltage_limit < sys.float_info.max
    gains = {"Kp": loop.control.amplitude.Kp, "Ki_Ts": loop.control.amplitude.Ki_Ts}
    return {
        "schema": SCHEMA,
        "plant": {"G": loop.G, "tau": loop.tau, "f0": loop.f0},
        "reference_temperature_degC": loop.reference_temperature,
        "sample_time_s": loop.sample_time,
        "bandwidth_Hz": loop.bandwidth_hz,
        "bandwidth_limit_Hz": loop.bandwidth_limit_hz,
        "bandwidth_bound": loop.bandwidth_bound,
        "gains": {"d": gains, "q": dict(gains)},
        "continuous": {"Kp": loop.Kp_continuous, "Ti_s": loop.Ti},
        "anti_windup": loop.control.amplitude.anti_windup,
        "voltage_limit": loop.control.amplitude.voltage_limit if limited else None,
        "tracker": _tracker_dict(loop),
        "units": {"drive": loop.drive_unit, "response": loop.response_unit},
        "notes": list(loop.notes),
    }


def _tracker_dict(loop: Loop) -> dict[str, float] | None:
    t = loop.control.tracker
    if t is None:
        return None
    numbers = {"gain_Hz": t.gain, "max_step_Hz": t.max_step, "start_Hz": t.start, "gate": t.gate}
    return numbers | {"every_samples": t.every, "period_s": t.every * loop.sample_time}


def _pi_numbers(loop: Loop) -> dict[str, str]:
    pi = loop.control.amplitude
    numbers = {"sample_time": loop.sample_time, "Kp": pi.Kp, "Ki_Ts": pi.Ki_Ts, "anti_windup": pi.anti_windup}
    texts = {name: _number(value) for name, value in numbers.items()}
    no_limit = "" if pi.highest < NO_LIMIT else " (none was given)"
    return texts | {"limit": _number(pi.highest), "no_limit": no_limit}


def _tracker_text(loop: Loop, units: dict[str, str]) -> str:
    t = loop.control.tracker
    if t is None:
        return ""
    numbers = {name: _number(getattr(t, name)) for name in ("gain", "max_step", "start", "gate")}
    return _TRACKER_C.format(**units, **numbers, every=int(t.every))


def _number(value: float) -> str:
    """17 digits give the same double back; a whole number keeps a point, so that C reads a double."""
    text = f"{value:.17g}"
    return text if re.search("[.e]", text) else text + ".0"


def _unit_text(unit: str) -> str:
    return re.sub(r"[^A-Za-z0-9/^.-]", "_", unit)[:24]


def _guard(name: str) -> str:
    """An identifier from a file name; the prefix keeps it from starting with a digit or a reserved underscore."""
    return "SYSID_" + re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_")
