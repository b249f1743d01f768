"""The exported steps of a Loop, its machine's and its demodulator's, recorded in one of the arithmetics."""

import re
from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from controller.actuator import Dds, Words
from controller.demodulator import Turn
from controller.design import Loop
from controller.dq import DQ
from controller.fixed import FixedRecord
from controller.rig import Vector
from controller.scalar import NO_LIMIT, Full, Span
from controller.source import Timer
from controller.symbols import Record, Symbol
from controller.twin import Twin

Precision = Literal["double", "single", "q31", "q15"]
BITS = {"double": None, "single": None, "q31": 32, "q15": 16}
COUNTS = 2.0**15  # full scale of a sample where no rig says
ROOM = 1.5  # full scale of the sensor over what the voltage limit makes of the untouched plate, where no rig says


class Recorded(NamedTuple):
    """A step in C: its `lines`; by field of the state the initial and the next value, by name of the output its value and what
    is added to it as a whole number (None: it is none); the number of each operation; in fixed point its `twin` in Python."""

    lines: list[str]
    state: dict[str, tuple[str, str]]
    output: dict[str, tuple[str, int | None]]
    counts: Counter[str]
    twin: Twin | None


def record(loop: Loop, precision: Precision) -> Recorded:
    """The step of `loop.machine`: inputs reference, share, wd, wq, temperature, enable, reset. In fixed point all frequencies,
    the output too, are counted from f0: a word of 16 bits then resolves hundredths of a Hz instead of one."""
    full = _full(loop) if BITS[precision] else None
    xp, turned = _recorder(loop, precision), words(loop)
    machine = loop.machine
    if full is not None:
        machine, turned = centred(machine, loop.f0 or 0.0), turned._replace(start=0.0)
    first = machine.init()
    state, spans = _loaded(xp, first, None if full is None else machine.span(full))

    def given(name: str, span: Span | None, missing: bool = True) -> Symbol:
        return xp.input(f"in->{name}") if isinstance(xp, Record) else xp.input(f"in->{name}", span, missing)

    asked = W = volts = window = None
    if full is not None:
        asked, W = Span(-loop.amplitude, loop.amplitude), Span(-full.response, full.response)
        volts = Span(-full.voltage, full.voltage)
        window = Span(*(f - (loop.f0 or 0.0) for f in loop.limits.frequency or (0.0, 0.0)))
    temperature = given("temperature", full and full.temperature) if measures_temperature(loop) else None
    after, command, said = machine.step(
        state, given("reference", asked), Vector(given("wd", W), given("wq", W)), temperature, xp,
        share=given("share", Span(0.0, 1.0), False), enable=xp.flag("in->enable"), reset=xp.flag("in->reset"),
    )  # fmt: skip
    output: dict[str, Any] = {"voltage": (None, command.voltage, volts), "frequency": (None, command.frequency, window)}
    output |= {name: (0, getattr(said, name), None) for name in ("fault", "mode")}
    made = turned.of(command.voltage, command.frequency, xp)
    output |= {name: (base, v, Span(-1.0, 1.0)) for name, (base, v) in made.items()}
    inputs = {"reference": asked, "share": Span(0.0, 1.0), "wd": W, "wq": W}
    inputs |= {} if temperature is None else {"temperature": full and full.temperature}
    return _recorded(xp, precision, first, after, output, spans, inputs)


def centred(control: Any, start: float) -> Any:
    """The same with its frequencies less `start`; None stays None."""
    if control is None:
        return None
    inner = {name: centred(getattr(control, name), start) for name in ("control", "tracker") if hasattr(control, name)}
    own = {name: getattr(control, name) - start for name in ("start", "lowest", "highest") if hasattr(control, name)}
    return control._replace(**inner, **own)


def record_demodulator(loop: Loop, precision: Precision) -> Recorded:
    """The step of `loop.demodulator`: inputs sample, and of the accumulator u, odd, half as in `Turn`."""
    xp, demodulator = _recorder(loop, precision), sampled(loop, precision)
    full = _full(loop) if BITS[precision] else None
    first = demodulator.init()
    state, spans = _loaded(xp, first, None if full is None else demodulator.span(full))
    if isinstance(xp, Record):
        sample, u = xp.input("sample"), xp.input("u")
    else:
        sample, u = xp.input("sample", Span(-COUNTS, COUNTS), True, 0), xp.input("u", Span(-1.0, 1.0))
    after, d, q = demodulator.step(state, sample, Turn(u, xp.flag("odd"), xp.flag("half")), xp)
    W = full and Span(-full.response, full.response)
    output = {"wd": (None, d, W), "wq": (None, q, W)}
    return _recorded(xp, precision, first, after, output, spans, {"u": Span(-1.0, 1.0)})


def sampled(loop: Loop, precision: Precision) -> Any:
    """The demodulator for the samples that it will have: counts where a rig says so or in fixed point, else the response."""
    if loop.demodulator is None:
        raise ValueError("no demodulator: f0 is not determined")
    if BITS[precision] and loop.rig.adc is None:
        return loop.demodulator._replace(scale=_full(loop).response / 2 / COUNTS)
    return loop.demodulator


def words(loop: Loop) -> Words:
    """What the rig takes. Raises ValueError where there is no limit or window that it would need."""
    rig = loop.rig
    if rig.inverter is not None:
        rig.inverter.check(loop.limits.voltage)
    if (rig.timer or rig.dds) and loop.limits.frequency is None:
        raise ValueError("found no frequency window, expected one for the words of a timer or a synthesiser")
    timer = None if rig.timer is None or loop.f0 is None else Timer.of(rig.timer, loop.f0)
    dds = None if rig.dds is None or loop.f0 is None else Dds(rig.dds, loop.f0)
    return Words(loop.limits.voltage, loop.f0 or 0.0, rig.dac, rig.inverter, timer, dds)


def measures_temperature(loop: Loop) -> bool:
    """Whether the exported step takes a temperature: the rig measures it and there is a resonance that it moves."""
    return loop.rig.thermometer and loop.f0 is not None


def _full(loop: Loop) -> Full:
    """Full scale: of the response twice what the sensor's converter takes, as products with a cosine are doubled."""
    limit, window = loop.limits.voltage, loop.limits.frequency
    if limit is None or limit >= NO_LIMIT or (loop.f0 is not None and window is None):
        raise ValueError("found no voltage limit or no frequency window, expected both: fixed point takes its scales from them")
    gain = 1.0 if loop.rig.sensor is None else loop.rig.sensor.gain
    sensor = ROOM * abs(loop.G) * limit * gain if loop.rig.adc is None else loop.rig.adc.full_scale
    return Full(2 * sensor, limit)


def _recorder(loop: Loop, precision: Precision) -> Any:
    if precision not in BITS:
        raise ValueError(f"found precision {precision!r}, expected one of {', '.join(map(repr, BITS))}")
    if loop.machine is None:
        raise ValueError("found a loop without its guard, expected one with it: what is exported drives a bench")
    if (bits := BITS[precision]) is None:
        return Record(_number if precision == "double" else _single)
    if not isinstance(loop.law, DQ):
        # Its gate goes with the reference, so that 1 / |W|^2 has no bound that a scale could be taken from.
        raise ValueError(
            f"found {precision} for the method {loop.method!r}, expected 'double' or 'single': it divides by |W|^2, which has no"
            " least value that a word could be scaled by"
        )
    return FixedRecord(bits, getattr(loop.law.tracker, "most", None))


def _loaded(xp: Any, first: Any, span: Any) -> tuple[Any, dict[str, Span]]:
    """The state as symbols: each number is loaded before any is written, or it would be read too late."""
    spans = dict(_leaves("", span))
    loaded = {
        name: xp.made("load", f"s->{name}") if isinstance(xp, Record) else xp.load(name, spans[name])
        for name, _ in _leaves("", first)
    }
    return _filled(first, iter(loaded.values())), spans


def _recorded(
    xp: Any, precision: Precision, first: Any, after: Any, output: dict, spans: dict[str, Span], inputs: dict[str, Any]
) -> Recorded:
    output = {name: v for name, v in output.items() if v[1] is not None}
    firsts, afters = dict(_leaves("", first)), dict(_leaves("", after))
    if isinstance(xp, Record):
        then = {name: xp.text(value) for name, value in afters.items()}
        out = {name: (xp.text(value), base) for name, (base, value, _) in output.items()}
        lines, counts = xp.needed([*then.values(), *(text for text, _ in out.values())])
        return Recorded(lines, {n: (xp.number(float(v)), then[n]) for n, v in firsts.items()}, out, counts, None)
    for name, (base, value, _) in output.items():
        if base is not None and max(map(abs, xp.known(value).span)) > xp.top:
            raise ValueError(f"found {name} up to {max(xp.known(value).span):.6g}, expected what {precision} can hold")
    states = {name: xp.point(span) for name, span in spans.items()}
    points = {name: xp.point(span) for name, span in inputs.items() if span is not None}
    points |= {name: 0 if base is not None else xp.point(span) for name, (base, _, span) in output.items()}
    twin = xp.twin(firsts, afters, {name: value for name, (_, value, _) in output.items()}, states, points)
    lines = [f"const {'int' if name[0] == 'c' else 'dq_word'} {name} = {made.c()};" for name, made in twin.operations.items()]
    state = {name: (str(first), str(twin.then[name])) for name, first in twin.first.items()}
    out = {name: (str(word), output[name][0]) for name, word in twin.output.items()}
    return Recorded(lines, state, out, Counter(made.kind for made in twin.operations.values()), twin)


def _leaves(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers, or spans, of nested states by a name each; None is no number."""
    if isinstance(value, Symbol | Span | float | int):
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


def _number(value: float) -> str:
    """17 digits give the same double back; a whole number keeps a point, so that C reads a double."""
    return _pointed(f"{value:.17g}")


def _single(value: float) -> str:
    return _pointed(f"{np.float32(value):.9g}") + "f"


def _pointed(text: str) -> str:
    return text if re.search("[.e]", text) else text + ".0"
