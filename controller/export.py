"""A Loop as C99, a header and its source: the steps' own operations, recorded, so that C and Python compute the same bits."""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from controller import ctext
from controller.demodulator import IMAGE, Turn, example
from controller.design import Loop
from controller.guard import FAULTS
from controller.laws import SAMPLES
from controller.machine import MODES
from controller.recording import BITS, Precision, Recorded, measures_temperature, record, record_demodulator, sampled
from controller.scalar import nan

TYPES = {"double": "double", "single": "float", "q31": "int32_t", "q15": "int16_t"}
WHOLE = {"fault": "int32_t", "mode": "int32_t", "code": "int32_t", "ticks": "uint32_t", "increment": "uint32_t"}


def export_c(loop: Loop, path: str | Path, precision: Precision | None = None) -> None:
    """Write the header at `path` and the source beside it, of the same name with .c.

    `precision`: "double", "single", or fixed point in words of 32 or 16 bits, "q31" and "q15"; None: as the rig says, else
    double. Of the loop's texts only units, the plate's name and hashes go out, and of those only letters, digits and / ^ . - so
    that no text from a log can end a comment. Notes stay in the JSON. Raises ValueError for what cannot be exported: a loop
    without its guard, fixed point without the limits that scale it, or of the method "adaptive".
    """
    path = Path(path)
    if path.suffix == ".c" or not re.fullmatch(r"[A-Za-z0-9_.+-]+", path.name):
        raise ValueError(f"found {path.name!r}, expected the name of a header that C can include, such as dq_pi.h")
    header, source = texts(loop, path.name, precision)
    path.write_text(header, encoding="ascii", newline="\n")
    path.with_suffix(".c").write_text(source, encoding="ascii", newline="\n")


def texts(loop: Loop, name: str, precision: Precision | None = None) -> tuple[str, str]:
    """Header, called `name`, and source."""
    precision = precision or loop.rig.arithmetic
    step = record(loop, precision)
    measured = measures_temperature(loop)
    number, bits = ("dq_word", BITS[precision]) if BITS[precision] else ("dq_real", None)
    drive, response = (_text(unit) for unit in (loop.drive_unit or "drive-unit", loop.response_unit or "response-unit"))
    says = {"reference": f"wanted amplitude in {response}, peak", "share": "of the bandwidth, 0 to 1"}
    says |= {"wd": f"as the sensor shows it, in {response}, peak", "wq": "the same"}
    says |= {"temperature": "of the plate, degC"} if measured else {}
    gives = {"voltage": f"{drive}, peak; negative: turned by half a carrier period", "duty": "duty ratio"}
    gives["frequency"] = f"Hz above {loop.f0:.12g}" if bits and loop.f0 else "Hz"
    gives |= {"fault": _listed((*FAULTS, "lost")), "mode": _listed(MODES), "code": "of the converter for the peak voltage"}
    gives |= {"ticks": "of the timer in a period of the carrier", "increment": "of the accumulator of 32 bits"}
    demodulator = record_demodulator(loop, precision) if loop.demodulator is not None else None
    parts = _demodulator(loop, demodulator, precision, number) if demodulator is not None else ("", "")
    header = ctext.HEADER.format(
        stamp="\n * ".join(_stamp(loop, drive, response)),
        use=_use(loop),
        sample_time=f"{loop.sample_time:.9g}",
        operations=_counted(step.counts),
        arithmetic=ctext.FIXED_NOTES.format(sign=bits - 1) if bits else ctext.FLOAT_NOTES,
        guard=_guard(name),
        type=TYPES[precision],
        number=number,
        missing=ctext.FIXED_MISSING.format(top=2 ** (bits - 1) - 1) if bits else "",
        fields=_fields(number, step.state),
        inputs="\n".join(
            [f"    {number} {name}; /* {said}{_point(step, name)} */" for name, said in says.items()]
            + ["    int enable; /* not zero: on */", "    int reset; /* not zero: ends a fault */"]
        ),
        outputs="\n".join(
            f"    {WHOLE.get(name, number)} {name}; /* {gives[name]}{'' if name in WHOLE else _point(step, name)} */"
            for name in step.output
        ),
        demodulator=parts[0],
    )
    lines = [line for part in (step, demodulator) if part is not None for line in part.lines]
    source = ctext.SOURCE.format(
        header=name,
        helpers=_helpers(precision, "\n".join(lines)),
        init=_assigned({name: first for name, (first, _) in step.state.items()}),
        lines=_indented(step.lines),
        after=_assigned({name: then for name, (_, then) in step.state.items()}),
        out="\n".join(f"    out.{name} = {_given(name, text, base)};" for name, (text, base) in step.output.items()),
        demodulator=parts[1],
    )
    return header, source


def _demodulator(loop: Loop, step: Recorded, precision: Precision, number: str) -> tuple[str, str]:
    """What it adds to header and source."""
    demodulator, bits = sampled(loop, precision), BITS[precision]
    counts = bits is not None or loop.rig.adc is not None
    rate = SAMPLES * loop.f0 if loop.rig.adc is None else loop.rig.adc.rate
    samples, advance = example(counts, loop.f0 / rate)
    sample_type = number if bits or not counts else "dq_real"
    turn = f"({number})((int32_t)(turn & 0x3fffffffu) * 2 - 1073741824)"
    if bits is None:
        turn += f" * {'9.31322574615478516e-10' + ('' if precision == 'double' else 'f')}"
    elif bits == 16:
        turn = "(dq_word)((int32_t)((turn & 0x3fffffffu) >> 15) - 16384)"
    wd, wq = expected(loop, step, precision)
    wanted = {"out.wd": wd, "out.wq": wq}
    near = " && ".join(f"{name} == {v}" if bits else _within(name, v, precision) for name, v in wanted.items())
    unit = f"in counts of {demodulator.scale:.6g}" if counts else "in the response's unit"
    missing = "DQ_MISSING where there is none" if bits else "not finite where there is none"
    shown = [str(int(v)) if bits else _real(v, precision) for v in samples]
    header = ctext.DEMODULATOR_H.format(
        fields=_fields(number, step.state), number=number, sample=f"{unit}, {missing}", rate=f"{rate:.9g}",
        sample_type=sample_type, operations=_counted(step.counts), image=IMAGE,
        delay=demodulator.delay / rate, count=len(samples),
        coarse=", and to a few units of a word" if bits else "",
    )  # fmt: skip
    source = ctext.DEMODULATOR_C.format(
        init=_assigned({name: first for name, (first, _) in step.state.items()}),
        sample_type=sample_type, number=number, turn=turn, lines=_indented(step.lines),
        after=_assigned({name: then for name, (_, then) in step.state.items()}),
        out="\n".join(f"    out.{name} = {text};" for name, (text, _) in step.output.items()),
        samples="\n".join("        " + ", ".join(shown[k : k + 8]) + "," for k in range(0, len(shown), 8)),
        phase=0, advance=advance, near=near,
    )  # fmt: skip
    return header, source


def expected(loop: Loop, step: Recorded, precision: Precision) -> tuple[Any, Any]:
    """Wd and Wq that the demodulator makes, in Python, of the samples of the self-test: words in fixed point."""
    demodulator = sampled(loop, precision)
    rate = SAMPLES * loop.f0 if loop.rig.adc is None else loop.rig.adc.rate
    samples, advance = example(BITS[precision] is not None or loop.rig.adc is not None, loop.f0 / rate)
    phases = (np.arange(len(samples)) * advance) & 0xFFFFFFFF
    if step.twin is None:
        state, d, q = demodulator.init(), nan, nan
        for sample, phase in zip(samples.tolist(), phases, strict=True):
            u, odd, half = Turn.of(phase)
            state, d, q = demodulator.step(state, sample, Turn(float(u), bool(odd), bool(half)))
        return d, q
    words: dict[str, Any] = dict(step.twin.first)
    out: dict[str, Any] = {}
    for sample, phase in zip(samples.astype(int).tolist(), phases, strict=True):
        words, out = step.twin.step(words, **turned(step.twin, sample, phase))
    return int(out["wd"]), int(out["wq"])


def turned(twin: Any, sample: Any, phase: Any) -> dict[str, Any]:
    """The inputs of a demodulator's twin for a sample, or an array of them, at a phase, as C makes them."""
    u, odd, half = Turn.of(phase)
    return {"sample": sample, "u": np.floor(np.ldexp(u, twin.points["u"])).astype(np.int64), "odd": odd, "half": half}


def _within(name: str, value: float, precision: Precision) -> str:
    """A comparison that a fused multiply-add passes and a wrong sign does not."""
    room = max(abs(value), 1e-30) * (1e-9 if precision == "double" else 1e-4)
    low, high = (_real(value + sign * room, precision) for sign in (-1, 1))
    return f"{name} > {low} && {name} < {high}"


def _real(value: float, precision: Precision) -> str:
    text = f"{value:.17g}" if precision == "double" else f"{np.float32(value):.9g}"
    return (text if re.search("[.e]", text) else text + ".0") + ("" if precision == "double" else "f")


def _given(name: str, text: str, base: int | None) -> str:
    if base is None:
        return text
    whole = f"(int32_t){text}"
    return whole if WHOLE[name] == "int32_t" else f"{base}u + (uint32_t){whole}"


def _helpers(precision: Precision, lines: str) -> str:
    """Those that the lines call."""
    bits = BITS[precision]
    if bits:
        used = [(ctext.FIT, "dq_fit("), (ctext.RATIO, "dq_ratio("), (ctext.FIXED_FLOOR, "dq_floor(")]
        called = "".join(text for text, call in used if call in lines)
        return ctext.FIXED.format(wide=f"int{2 * bits}_t", called=called)
    whole, integer, one = ("4503599627370496.0", "int64_t", "1.0") if precision == "double" else ("8388608.0f", "int32_t", "1.0f")
    floor = ctext.FLOOR.format(whole=whole, integer=integer, one=one) if "dq_floor(" in lines else ""
    return ctext.FLOATING.format(floor=floor)


def _fields(number: str, state: dict[str, Any]) -> str:
    return "\n".join(f"    {number} {name};" for name in state)


def _assigned(values: dict[str, str]) -> str:
    return "\n".join(f"    s->{name} = {value};" for name, value in values.items())


def _indented(lines: list[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)


def _point(step: Recorded, name: str) -> str:
    return "" if step.twin is None else f"; k = {step.twin.points[name]}"


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f"{i} {name}" for i, name in enumerate(names))


def _counted(counts: Counter[str]) -> str:
    names = {"+": "additions", "-": "additions", "*": "multiplications", "/": "divisions", "load": "loads", "floor": "floors"}
    found: Counter[str] = Counter()
    for operation, n in counts.items():
        plain = operation in ("select", "logic", "test", "<", ">", "<=", ">=", "==", "!=")
        found["comparisons and selections" if plain else names.get(operation, operation)] += n
    return ", ".join(f"{n} {name}" for name, n in sorted(found.items()))


def _use(loop: Loop) -> str:
    first = "Call dq_init once, then dq_step with the demodulated response; it returns what to drive with."
    return first if loop.demodulator is None else f"{first} dq_demodulate\n * gives the response from samples of the sensor."


def _stamp(loop: Loop, drive: str, response: str) -> list[str]:
    """What it is for: plate, logs, ranges."""
    named = "" if loop.plate is None else f"{_text(loop.plate, 40)}, "
    lines = [f"plate: {named}G {loop.G:.6g} {response} per {drive}, tau {loop.tau:.6g} s"]
    lines[0] += "" if loop.f0 is None else f", f0 {loop.f0:.8g} Hz"
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
    return lines + [f"log sha256 {_text(digest, 64)}" for digest in loop.logs]


def _text(unit: str, most: int = 24) -> str:
    return re.sub(r"[^A-Za-z0-9/^.-]", "_", unit)[:most]


def _guard(name: str) -> str:
    """An identifier from a file name; the prefix keeps it from starting with a digit or a reserved underscore."""
    return "SYSID_" + re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_")
