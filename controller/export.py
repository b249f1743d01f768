"""A Loop as a C99 header: the step's own operations, recorded, so that C and Python compute the same bits."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from controller.design import Loop
from controller.guard import FAULTS
from controller.rig import Vector
from controller.symbols import Record, Symbol

Precision = Literal["double", "single"]

_HEADER = """\
/* Amplitude and frequency controller of one identified plate. Generated: do not edit.
 *
 * {stamp}
 *
 * Call dq_init once, then dq_step every {sample_time} s with the demodulated response; it returns what to drive with.
 * One step: {operations}.
 * No loop, no branch, no heap, no memory but the state; what is divided by has been compared with its limit before.
 * Compile without contraction and without fast math (-ffp-contract=off): a fused multiply-add changes the last bit,
 * and fast math removes the test for a missing (not finite) measurement. */
#ifndef {guard}
#define {guard}

#include <math.h>

typedef {type} dq_real;
#define dq_floor {floor}

typedef struct {{
{fields}
}} dq_state;

typedef struct {{
{outputs}
}} dq_output;

static inline void dq_init(dq_state *s)
{{
{init}
}}

/* {arguments} */
static inline dq_output dq_step(dq_state *s, {parameters})
{{
    dq_output out;
{lines}
{after}
{out}
    return out;
}}

#endif
"""


class Recorded(NamedTuple):
    """A step in C: its `lines`, the state by field with its initial and its next value, the output by name, and the number of
    each operation."""

    lines: list[str]
    state: dict[str, tuple[str, str]]
    output: dict[str, str]
    counts: Counter[str]


def export_c(loop: Loop, path: str | Path, precision: Precision = "double") -> None:
    """Write the header with dq_state, dq_init, dq_step; `precision` "single" computes in float.

    Of the loop's texts only units and hashes go out, and of those only letters, digits and / ^ . - so that no text from a log
    can end a comment. Notes stay in the JSON.
    """
    if precision not in ("double", "single"):
        raise ValueError(f"found precision {precision!r}, expected 'double' or 'single'")
    step = record(loop, precision)
    measured = _measures_temperature(loop)
    names = ["reference", "wd", "wq", *(["temperature"] if measured else [])]
    drive, response = (_text(unit) for unit in (loop.drive_unit or "drive-unit", loop.response_unit or "response-unit"))
    says = f"reference, wd, wq in {response}, peak" + ("; temperature of the plate in degC" if measured else "")
    units = {"voltage": f"{drive}, peak; negative: turned by half a carrier period", "frequency": "Hz"}
    units |= {"fault": ", ".join(f"{i} {name}" for i, name in enumerate(FAULTS))}
    text = _HEADER.format(
        stamp="\n * ".join(_stamp(loop, drive, response)),
        sample_time=f"{loop.sample_time:.9g}",
        operations=", ".join(f"{n} {name}" for name, n in sorted(_named(step.counts).items())),
        guard=_guard(Path(path).name),
        type="double" if precision == "double" else "float",
        floor="floor" if precision == "double" else "floorf",
        fields="\n".join(f"    dq_real {name};" for name in step.state),
        outputs="\n".join(f"    dq_real {name}; /* {units[name]} */" for name in step.output),
        init="\n".join(f"    s->{name} = {first};" for name, (first, _) in step.state.items()),
        arguments=says,
        parameters=", ".join(f"dq_real {name}" for name in names),
        lines="\n".join(f"    {line}" for line in step.lines),
        after="\n".join(f"    s->{name} = {then};" for name, (_, then) in step.state.items()),
        out="\n".join(f"    out.{name} = {value};" for name, value in step.output.items()),
    )
    Path(path).write_text(text, encoding="ascii", newline="\n")


def record(loop: Loop, precision: Precision = "double") -> Recorded:
    """The step of `loop.control` as it is computed."""
    number = _number if precision == "double" else _single
    record = Record(number)
    first = loop.control.init()
    fields = dict(_leaves("", first))
    # A state that is read where it is written would be read too late: each is loaded first.
    loaded = {name: record.made("load", f"s->{name}") for name in fields}
    W = Vector(record.input("wd"), record.input("wq"))
    temperature = record.input("temperature") if _measures_temperature(loop) else None
    state = _filled(first, iter(loaded.values()))
    after, command, info = loop.control.step(state, record.input("reference"), W, temperature, record)
    then = {name: record.text(value) for name, value in _leaves("", after)}
    output = {"voltage": command.voltage, "frequency": command.frequency, "fault": getattr(info, "fault", None)}
    said = {name: record.text(value) for name, value in output.items() if value is not None}
    lines, counts = record.needed([*then.values(), *said.values()])
    return Recorded(lines, {n: (number(float(v)), then[n]) for n, v in fields.items()}, said, counts)


def _measures_temperature(loop: Loop) -> bool:
    return loop.rig.thermometer and loop.f0 is not None


def _leaves(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers of nested states by a name each; None is no number."""
    if isinstance(value, Symbol | float | int):
        yield prefix, value
    elif value is not None:
        named = zip(value._fields, value, strict=True) if hasattr(value, "_fields") else enumerate(value)
        for name, item in named:
            yield from _leaves(f"{prefix}_{name}" if prefix else str(name), item)


def _filled(like: Any, values: Iterator[Any]) -> Any:
    """`like` with its numbers replaced in order."""
    if like is None:
        return None
    if isinstance(like, tuple):
        items = [_filled(item, values) for item in like]
        return type(like)(*items) if hasattr(like, "_fields") else tuple(items)
    return next(values)


def _named(counts: Counter[str]) -> dict[str, int]:
    names = {"+": "additions", "-": "additions", "*": "multiplications", "/": "divisions", "load": "loads", "floor": "floors"}
    found: Counter[str] = Counter()
    for operation, n in counts.items():
        found[names.get(operation, "comparisons and selections")] += n
    return dict(found)


def _stamp(loop: Loop, drive: str, response: str) -> list[str]:
    """What it is for: plate, logs, ranges."""
    lines = [f"plate: G {loop.G:.6g} {response} per {drive}, tau {loop.tau:.6g} s"]
    lines[0] += "" if loop.f0 is None else f", f0 {loop.f0:.8g} Hz"
    if loop.reference_temperature is not None:
        low, high = (loop.reference_temperature + w for w in loop.warming)
        lines.append(f"temperature: {low:.4g} to {high:.4g} degC")
    if loop.limits.voltage is not None:
        lines.append(f"voltage: {loop.limits.voltage:.6g} {drive} at most ({_text(loop.limits.said, 60)})")
    if loop.limits.frequency is not None:
        lines.append("frequency: {:.8g} to {:.8g} Hz".format(*loop.limits.frequency))
    lines.append(f"finger: damping up to {loop.finger:.4g} of the plate's own")
    return lines + [f"log sha256 {_text(digest, 64)}" for digest in loop.logs]


def _number(value: float) -> str:
    """17 digits give the same double back; a whole number keeps a point, so that C reads a double."""
    return _pointed(f"{value:.17g}")


def _single(value: float) -> str:
    return _pointed(f"{np.float32(value):.9g}") + "f"


def _pointed(text: str) -> str:
    return text if re.search("[.e]", text) else text + ".0"


def _text(unit: str, most: int = 24) -> str:
    return re.sub(r"[^A-Za-z0-9/^.-]", "_", unit)[:most]


def _guard(name: str) -> str:
    """An identifier from a file name; the prefix keeps it from starting with a digit or a reserved underscore."""
    return "SYSID_" + re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_")
