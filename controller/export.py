"""A Loop as C: the law (`controller/c/`), the same for every plate, and a header of a plate's parameters."""

import re
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np

from controller.actuator import Dds
from controller.adaptive import Adaptive
from controller.demodulator import Demodulator
from controller.design import Loop
from controller.guard import Guard
from controller.machine import Machine
from controller.rig import Calibrated
from controller.scalar import NO_LIMIT, typed
from controller.source import Multiples, Timer
from controller.tracker import PLL, SignTracker
from sysid import __version__
from sysid.asked import LOOP, given
from sysid.whole import in_place_of

Precision = Literal["single", "double"]
KINDS = {"single": np.float32, "double": np.float64}
LONGEST = 8  # samples on their way, for which the source has room as it is


def export_c(loop: Loop, path: str | Path, precision: Precision | None = None, prefix: str = "dq") -> None:
    """Write the law as a header at `path` and a source beside it, of the same name with .c, and the plate's
    parameters as a third file, NAME_plate.h.

    `precision`: "single" or "double"; None: as the rig says, else single. `prefix` stands before all names:
    two programs' laws, or a law in two precisions, can then be linked together; several plates share one law.
    Of the loop's texts only units, the plate's name and hashes go out, and of those only letters, digits and
    / ^ . - so that no text from a log can end a comment. Notes stay in the JSON. Raises ValueError for what
    cannot be exported: a loop without its guard.
    """
    given("loop", loop, Loop, LOOP)
    path = Path(path)
    if path.suffix == ".c" or not re.fullmatch(r"[A-Za-z0-9_.+-]+", path.name):
        raise ValueError(
            f"found {path.name!r}, expected the name of a header that C can include, such as dq_pi.h"
        )
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", prefix):
        raise ValueError(f"found the prefix {prefix!r}, expected small letters, digits and _, a letter first")
    targets = path, path.with_suffix(".c"), plate_header(path)
    made = texts(loop, path.name, precision, prefix)
    with in_place_of(*targets) as fresh:
        for file, text in zip(fresh, made, strict=True):
            file.write_text(text, encoding="ascii", newline="\n")


def plate_header(path: Path) -> Path:
    """Where the plate's parameters go, beside the header of the law."""
    return path.with_name(f"{path.stem}_plate{path.suffix}")


def texts(
    loop: Loop, name: str, precision: Precision | None = None, prefix: str = "dq"
) -> tuple[str, str, str]:
    """Header of the law, called `name`, its source, and the header of the plate."""
    precision = precision or loop.rig.arithmetic
    if precision not in KINDS:
        raise ValueError(f"found precision {precision!r}, expected one of {', '.join(map(repr, KINDS))}")
    values = parameters(loop, precision)
    law = files("controller") / "c"
    header, source = ((law / f"dq.{end}").read_text(encoding="ascii") for end in ("h", "c"))
    header = header.replace("#define DQ_DOUBLE 0", f"#define DQ_DOUBLE {int(precision == 'double')}")
    room = max(LONGEST, values["model_delay"], values["sent"], values["late"])
    header = header.replace(f"#define DQ_DELAY_MAX {LONGEST}", f"#define DQ_DELAY_MAX {room}")
    header = re.sub(r"\bDQ_H\b", _guard(name), header)
    source = source.replace('#include "dq.h"', f'#include "{name}"')
    plate = _plate(loop, name, values)
    return _renamed(header, prefix), _renamed(source, prefix), _renamed(plate, prefix)


def _renamed(text: str, prefix: str) -> str:
    """Its names with another prefix than dq and DQ; the names of files stay."""
    return re.sub(r"\bdq_(?!pi\b|pi_)", f"{prefix}_", re.sub(r"\bDQ_", f"{prefix.upper()}_", text))


def parameters(loop: Loop, precision: Precision) -> dict[str, Any]:
    """The fields of dq_params by name, in the header's order: an int, or a number of that precision."""
    if loop.machine is None:
        raise ValueError(
            "found a loop without its guard, expected one with it: what is exported drives a bench"
        )
    outer = typed(loop.machine, KINDS[precision])
    m: Machine = outer.control if isinstance(outer, Calibrated) else outer
    law = m.control.control
    values = _start(m) | _guard_of(m.control) | _law(law) | _tracker(law)
    values |= {"layout": 4, "sensor_d": getattr(outer, "d", 1.0), "sensor_q": getattr(outer, "q", 0.0)}
    d = typed(loop.demodulator or Demodulator(0.0, 1.0, 1.0, 1.0), KINDS[precision])
    names = "demodulator_share=share demodulator_scale=scale sample_most=most sample_patience=patience"
    values |= _of(d, names)
    header = (files("controller") / "c" / "dq.h").read_text(encoding="ascii")
    struct = header[header.index("uint32_t layout;") : header.index("} dq_params;")]
    return {
        name: int(min(values[name], 2**24)) if kind.endswith("int32_t") else values[name]
        for kind, name in re.findall(r"\b(dq_real|u?int32_t) (\w+);", struct)
    }


def _of(part: Any, names: str, otherwise: float = 0.0) -> dict[str, Any]:
    """Numbers of a part, as field=name or both in one; `otherwise` for what it does not have."""
    pairs = (name.partition("=") for name in names.split())
    found = {field: getattr(part, name or field, None) for field, _, name in pairs}
    return {field: otherwise if value is None else value for field, value in found.items()}


def _ends(names: str, values: tuple) -> dict[str, Any]:
    return dict(zip(names.split(), values, strict=True))


def _start(m: Machine) -> dict[str, Any]:
    names = "gain f0 amplitude temperature find ramp headroom heaviest memory sweep swing swing_time follows"
    return (
        _of(m, f"{names} swings settled=patience lost=limit")
        | _ends("voltage_lowest voltage_highest", m.voltages)
        | _ends("tracker_lowest tracker_highest", m.window)
        | _ends("temperature_lowest temperature_highest", m.temperatures or (m.temperature,) * 2)
        | _ends("beside_find beside_lock beside_run", m.beside)
        | _ends("voltage_least voltage_most voltage_run", m.fits)
    )


def _guard_of(g: Guard) -> dict[str, Any]:
    names = "patience samples repeats doubts ceiling ceiling_least=least dead_share=floor dead_least=quiet"
    names += " frequency_lowest=lowest frequency_highest=highest guard_gain=gain guard_decay=decay"
    return _of(g, f"{names} guard_edge=edge guard_turn=turn guard_memory=memory jump jumps")


def _law(law: Any) -> dict[str, Any]:
    """The amplitude loop with its feed-forward, and the observer; of what is not there, what does nothing."""
    observer = "K push damping turn sweep_most=sweep"
    if isinstance(law, Adaptive):
        found = {"law": 1, "kp": 1.0 * np.sign(law.push), "ki": 0.0, "voltage_slew": law.slew}
        found |= {"sent": len(law.delay), "late": len(law.late), "between": law.between}
        found |= _of(law, observer) | _ends("keep_d keep_q", law.keep)
        model = None
    else:
        found = {"law": 0, **_of(law.amplitude, "kp=Kp ki=Ki_Ts voltage_slew=slew")}
        found |= {"sent": 0, "late": 0, "between": 0.0} | _of(None, f"{observer} keep_d keep_q", 1.0)
        model = law.amplitude.model
    found["model_delay"] = -1 if model is None else len(model.line) - 2
    return found | _of(model, "model_keep=keep") | _of(model, "model_push=push model_latest=latest", 1.0)


def _tracker(law: Any) -> dict[str, Any]:
    """What follows the resonance, a tracker or an observer; None: nothing does."""
    t = law if isinstance(law, Adaptive) else law.tracker
    source = getattr(t, "source", None)
    names = "tracker_share=share tracker_lead=lead tracker_max_step=max_step tracker_most=most gate k_T"
    gain = "size" if isinstance(t, SignTracker) else "gain"
    found = _of(t, f"tracker_gain={gain} {names} dead_band")
    found |= _of(t, "every tracker_half_bandwidth=half_bandwidth", 1.0)
    found |= _of(source, "source_step=step source_first=first source_periods=periods source_centre=centre")
    found["tracker"] = 0 if t is None else 2 if isinstance(t, SignTracker) else 3 if isinstance(t, PLL) else 1
    return found | {"source": 0 if source is None else 1 if isinstance(source, Multiples) else 2}


PLATE = """\
/* Parameters of one identified plate, for the law in {law}. Generated by sysid {version}:
 * do not edit, but copy and dq_set.
 * Free to use as the law is: MIT licence.
 *
 * {stamp}
 *
 * Before a fault has ended the drive, whatever the wiring (largest voltage; amplitude at
 * resonance, of the untouched plate):
{reach} */
#ifndef {guard}
#define {guard}

#include "{law}"

{macros}

#define DQ_PLATE_PARAMS {{ \\
{values} \\
}}

#endif
"""


def _plate(loop: Loop, name: str, values: dict[str, Any]) -> str:
    drive, response = _text(loop.drive_unit or "drive-unit"), _text(loop.response_unit or "response-unit")
    rows = [f"    {_c(value)}, /* {field} */" for field, value in values.items()]
    macros = [f"#define DQ_PLATE_{field} {text}" for field, text in _macros(loop).items()]
    return PLATE.format(
        law=name, version=_text(__version__), stamp="\n * ".join(_stamp(loop, drive, response)),
        reach="".join(f" *   {line}\n" for line in _reach(loop, drive, response)),
        guard=_guard(plate_header(Path(name)).name), macros="\n".join(macros), values=" \\\n".join(rows),
    )  # fmt: skip


def _macros(loop: Loop) -> dict[str, str]:
    """Limits, scales and times, for the code around the law; none for what there is not."""
    d, rig, limit = loop.demodulator, loop.rig, loop.limits.voltage
    found: dict[str, Any] = {"SAMPLE_TIME": loop.sample_time, "LATENCY": loop.latency, "DELAY": loop.delay}
    found |= {"VOLTAGE_LIMIT": limit, "AMPLITUDE": loop.amplitude}
    found |= {"GAIN": loop.G, "TAU": loop.tau, "F0": loop.f0}
    if d is not None:
        found |= {"SAMPLE_RATE": d.rate, "SAMPLE_SCALE": d.scale}
    if rig.dac is not None:
        found |= {"DAC_BITS": int(rig.dac.bits), "DAC_FULL_SCALE": rig.dac.full_scale}
    if rig.inverter is not None:
        rig.inverter.check(limit)
        series = [_real(a) for a in rig.inverter.series(limit)]
        found |= {"DUTY_TERMS": len(series), "DUTY": "{" + ", ".join(series) + "}"}
    if rig.dds is not None and loop.f0 is not None:
        dds = Dds(rig.dds, loop.f0)
        found |= {"DDS_BASE": f"{dds.base}u", "DDS_FRACTION": dds.fraction, "DDS_PER_HZ": 2**32 / rig.dds}
    if rig.timer is not None and loop.f0 is not None:
        found |= {"TIMER_TICKS": f"{int(Timer.of(rig.timer, loop.f0).periods)}u"}
    found |= {"RECORD_HEADER": f'"{_record_header(loop)}"', "RECORD_FORMAT": '"%.6f,%.7g,%.7g,%.7g,%.3f\\n"'}
    return {
        name: str(value) if isinstance(value, int | str) else _real(value)
        for name, value in found.items()
        if value is not None
    }


def _record_header(loop: Loop) -> str:
    """The first lines of a record, for a C string: what `identify` has to know. A unit not stated is 1."""
    lines = ["# sampling: instant"]
    if (d := loop.demodulator) is not None:  # the rows are behind its filters, each of one pole
        lines += [f"# lockin_tau_s: {d.delay / d.order:.6g}", f"# lockin_order: {d.order}"]
    # Another name would be another plate's.
    if loop.plate is not None and _text(loop.plate, 40) == loop.plate:
        lines.append(f"# plate: {loop.plate}")
    drive, response = (_text(unit or "1") for unit in (loop.drive_unit, loop.response_unit))
    named = "voltage" if drive == "V" else "drive"
    lines.append(f"time_s,wd_{response},wq_{response},{named}_{drive},frequency_Hz")
    return "".join(f"{line}\\n" for line in lines)


def _reach(loop: Loop, drive: str, response: str) -> list[str]:
    """For each phase the largest voltage and amplitude, and for each fault after how long it ends them."""
    machine = loop.switched
    assert machine is not None  # texts has refused it
    guard, limit, gain = machine.control, machine.voltages[1], abs(loop.G)

    def most(volts: float) -> str:
        """A limit of the drive and of the response."""
        if volts >= NO_LIMIT / 2:
            return "no limit of the voltage was stated"
        return f"{volts:.4g} {drive}, {gain * volts:.4g} {response}"

    def after(samples: float) -> str:
        """So many samples as a time."""
        return f"{1e3 * loop.sample_time * samples:.4g} ms"

    needed = machine.headroom * machine.amplitude / gain
    finds = machine.headroom * machine.heaviest * machine.find / gain
    touched = ""
    if machine.heaviest > 1:
        heaviest = most(min(limit, machine.heaviest * needed))
        touched = f"; {heaviest} where find has seen the heaviest finger"
    lines = [
        f"find: {most(min(limit, finds))}",
        f"soft start and lock: {most(min(limit, needed))}{touched}",
        f"run, and the tasks in open loop: {most(limit)}",
        f"missing, dead, above, edge, clipped: in each of these after {after(guard.patience)}, above from"
        f" {guard.ceiling:g} times what is asked",
        f"stuck: in each of these {after(guard.repeats)} after the drive has moved; reversed: after"
        f" {after(guard.doubts)}",
        f"lost: find or lock after {after(machine.limit)}; model: the same, and run as follow",
        f"follow: run after {after(machine.follows)} more than it was right",
        f"oscillates: lock or run after {after(machine.swings * machine.swing_time)} at most",
        "parameters: no voltage at all",
    ]
    if machine.fits[2] < NO_LIMIT / 2:
        lines += [
            "A sensor that reads low by as much as the stated finger explains is not seen: the amplitude is"
            " then up to",
            f"{machine.fits[1]:.3g} times what is asked, and {machine.fits[2]:.3g} times where it comes about"
            " in run, within the voltage.",
        ]
    return lines


def _c(value: Any) -> str:
    return str(int(value)) if isinstance(value, int) else f"(dq_real){_real(float(value))}"


def _real(value: float) -> str:
    text = f"{float(value):.17g}"
    return text if re.search("[.e]", text) else text + ".0"


def _stamp(loop: Loop, drive: str, response: str) -> list[str]:
    """What it is for: plate, logs, ranges."""
    named = "" if loop.plate is None else f"{_text(loop.plate, 40)}, "
    lines = [f"plate: {named}G {loop.G:.6g} {response} per {drive}, tau {loop.tau:.6g} s"]
    lines[0] += "" if loop.f0 is None else f", f0 {loop.f0:.8g} Hz"
    lines.append(f"method {loop.method}, a step every {loop.sample_time:.9g} s")
    if loop.reference_temperature is not None:
        low, high = (loop.reference_temperature + w for w in loop.warming)
        lines.append(f"temperature: {low:.4g} to {high:.4g} degC")
    if loop.limits.voltage is not None:
        lines.append(f"voltage: {loop.limits.voltage:.6g} {drive} at most ({_text(loop.limits.said, 60)})")
    if loop.limits.frequency is not None:
        lines.append("frequency: {:.8g} to {:.8g} Hz".format(*loop.limits.frequency))
    lines.append(f"amplitude: {loop.amplitude:.6g} {response} at most")
    force = "" if loop.force is None else f"force: 0 to {loop.force:.4g} N; "
    lines.append(f"{force}finger: damping up to {loop.finger:.4g} of the plate's own")
    if loop.demodulator is not None:
        lines.append(
            f"sensor: {loop.demodulator.rate:.9g} samples a second, W late by {loop.demodulator.delay:.3g} s"
        )
    return lines + [f"log sha256 {_text(digest, 64)}" for digest in loop.logs]


def _text(unit: str, most: int = 24) -> str:
    return re.sub(r"[^A-Za-z0-9/^.-]", "_", unit)[:most]


def _guard(name: str) -> str:
    """An identifier from a file name; the prefix keeps it from starting with a digit or an underscore."""
    return "SYSID_" + re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_")
