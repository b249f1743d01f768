"""A mapping file drafted for a log whose columns are not understood: what is left to its reader is "?" or commented out."""

import json
import re
from collections.abc import Mapping
from itertools import pairwise
from statistics import median

from sysid import units
from sysid.cells import listed, to_number
from sysid.csvfile import Head
from sysid.mapping import ANGLES, RESPONSES, is_decibel, split_ending

QUICK = 1e-5  # s from row to row, below which rows are samples of a carrier rather than its amplitudes
_WORDS: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "zeit", "x-axis"),
    "frequency": ("f", "freq", "frequency", "frequenz"),
    "temperature": ("temp", "temperature", "t"),
    "force": ("force",),
    "duty": ("duty", "pwm"),
    "voltage": ("v", "u", "voltage", "volt", "vin", "drive", "excitation"),
    "wd": ("wd",),
    "wq": ("wq",),
    "x": ("x", "re", "real", "inphase", "in-phase", "u1", "g"),
    "y": ("y", "im", "imag", "imaginary", "quadrature", "quad", "u2", "b"),
    "magnitude": ("magnitude", "mag", "amplitude", "amp", "r", "power"),
    "phase": ("phase", "phi", "theta", "arg"),
    "w": ("w", "displacement", "velocity", "response"),
}


def template(head: Head) -> str:
    """A mapping file for this file, filled in as far as the names tell; what is left to say is "?" or commented out."""
    guessed = _guess(head.names)
    waveform = _waveform(head, guessed)
    lines = [f"# How to read {_in_comment(head.name)}: fill in every ?, and save; then read the logs with --columns FILE"]
    if not head.dialect.header:
        lines += [f"# {_in_comment(f'{head.path} has no header; first row: {listed(head.sample[0])}')}"]
    lines += _of_samples(head, waveform) if waveform else _of_rows(head, guessed)
    dialect = head.dialect
    lines += [f"delimiter = {_quote(str(dialect.delimiter))}"] if dialect.delimiter != "," else []
    lines += ['decimal = ","'] if dialect.decimal == "," else []
    lines += [f"comment = {_quote(dialect.comment)}"] if dialect.comment != "#" else []
    lines += ["", "[columns]"]
    found = waveform or guessed
    lines += [_column(head, name, index) for name, index in found.items()]
    unused = [index for index in range(len(head.names)) if index not in found.values()]
    example = _place(head, unused[0]) if unused else '"?"'
    lines += [f'# {name} = {{ column = {example}, unit = "?" }}' for name in _missing(found)]
    lines += [f"# not used: {_in_comment(listed([head.names[index] or str(index) for index in unused]))}"] if unused else []
    lines += ["", "# [constants]"] + ([] if waveform else ['# voltage = "1 V"']) + ['# temperature = "20 degC"']
    lines += ["", "# [metadata]", "# sample_rate_Hz = 1e6"] if waveform and "time" not in waveform else []
    return "\n".join([*lines, ""])


def _of_rows(head: Head, guessed: Mapping[str, int]) -> list[str]:
    """What is to be said of rows of amplitudes."""
    lines = ['# kind = "steady"  # or "transient", or "waveform": raw samples of a carrier']
    lines += ['amplitude = "?"  # how drive and response are stated: "peak", "rms" or "pp"']
    if guessed.keys() & {"x", "magnitude"} or not guessed.keys() & {"w", "wd"}:
        lines += [_quantity(head, guessed.get("x", guessed.get("magnitude")))]
        if "phase" in guessed or "magnitude" not in guessed:
            lines += ['phase_sign = "?"  # 1 when the phase falls through the resonance, -1 when it rises']
    return lines


def _of_samples(head: Head, waveform: Mapping[str, int]) -> list[str]:
    """What is to be said of raw samples."""
    kind = 'kind = "waveform"  # it looks like raw samples of a carrier; of amplitudes "transient", with x and y, or w'
    return [
        kind,
        _quantity(head, waveform["response"]),
        "# which of the columns is the drive, and which the response, is a guess",
    ]


def _column(head: Head, name: str, index: int) -> str:
    unit = split_ending(head.names[index], False)[0]
    return f"{name} = {{ column = {_place(head, index)}, unit = {_quote(unit if _fits(name, unit) else '?')} }}"


def _place(head: Head, index: int) -> str:
    """A column by its name, or by its position where the name does not tell."""
    label = head.names[index]
    return _quote(label) if label and head.names.count(label) == 1 else str(index)


def _missing(found: Mapping[str, int]) -> list[str]:
    if "response" in found:
        return [name for name in ("time", "frequency", "temperature") if name not in found]
    missing = [name for name in ("time", "frequency", "voltage", "temperature") if name not in found]
    return missing + ([] if found.keys() & {"x", "w", "wd", "magnitude"} else ["x", "y"])


def _waveform(head: Head, guessed: Mapping[str, int]) -> dict[str, int]:
    """Time, drive and response of what looks like an oscilloscope's record: steps too short for amplitudes, or a column
    beside two of volts. Empty for any other file."""
    time = guessed.get("time")
    others = [index for index in range(len(head.names)) if index != time]
    volts = [index for index in others if _fits("voltage", split_ending(head.names[index], False)[0])]
    pair = len(head.names) == 3 and len(volts) == 2
    quick = time is not None and 0 < _step(head, time) < QUICK
    if guessed.keys() & {"wd", "x", "magnitude", "frequency"} or len(others) < 2 or not (pair or quick):
        return {}
    others = volts if pair else others
    drive = guessed.get("voltage", next(index for index in others if index != guessed.get("w")))
    response = guessed.get("w", next(index for index in others if index != drive))
    return ({} if time is None else {"time": time}) | {"drive": drive, "response": response}


def _step(head: Head, time: int) -> float:
    """Seconds between the first rows; of a column that does not say its unit, as if it held seconds."""
    numbers = [to_number(row[time], str(head.dialect.decimal)) for row in head.sample if len(row) > time]
    unit = split_ending(head.names[time], False)[0]
    steps = [after - before for before, after in pairwise(numbers)]
    return float(units.convert(median(steps), unit if _fits("time", unit) else "s", "s")) if steps else 0.0


def _quantity(head: Head, index: int | None) -> str:
    """What the signal in a column shows, by its unit; "?" where that does not tell, as of a sensor's volts."""
    unit = split_ending(head.names[index], False)[0] if index is not None else ""
    kinds = {"displacement": "m", "velocity": "m/s", "charge": "C", "current": "A"}
    quantity = next((kind for kind, of in kinds.items() if unit and units.same_kind(unit, of)), "?")
    return f'quantity = "{quantity}"  # what the signal shows: "displacement", "velocity", "charge" or "current"'


def _guess(names: tuple[str, ...]) -> dict[str, int]:
    """Which column is probably which, from the first word of its name; a response only when it is whole."""
    guessed: dict[str, int] = {}
    polar = {*_WORDS["magnitude"], *_WORDS["phase"]}  # often behind the name of a channel or a parameter
    known = {word for words in _WORDS.values() for word in words}
    for index, label in enumerate(names):
        words = re.split(r"[\s_\[(]", label.strip().casefold())
        word = next((later for later in words if words[0] not in known and later in polar), words[0])
        ending = label.casefold().rpartition("_")[2]
        word = ending if ending in ("re", "im") else "" if "_err" in label.casefold() else word
        for name in (name for name, words in _WORDS.items() if word in words and name not in guessed):
            unit = split_ending(label, False)[0]
            if _fits(name, unit) or not _is_unit(unit):
                guessed[name] = index
                break
    whole = next((set(names) for names in RESPONSES if set(names) <= guessed.keys()), set())
    spare = {"wd", "wq", "w", "x", "y", "magnitude", "phase"} - whole
    return {name: index for name, index in guessed.items() if name not in spare}


def _fits(name: str, unit: str) -> bool:
    if name == "phase" or (is_decibel(unit) and name in ("magnitude", "w")):
        return unit in ANGLES or is_decibel(unit)
    try:
        units.check_unit(name, unit)
    except ValueError:
        return False
    return True


def _is_unit(text: str) -> bool:
    return text in ANGLES or is_decibel(text) or _fits("w", text)


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")  # else a JSON text is a TOML text


def _in_comment(text: str) -> str:
    """Text that ends no comment: TOML allows no control characters in one, a line end in a file's name least of all."""
    return "".join(c if c.isprintable() else " " for c in text)
