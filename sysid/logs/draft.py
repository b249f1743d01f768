"""A mapping file drafted for a log whose columns are not understood: what is left to its reader is "?" or commented out."""

import json
import re
from collections.abc import Mapping
from itertools import pairwise
from statistics import median

from sysid.logs import units
from sysid.logs.cells import listed, to_number
from sysid.logs.csvfile import Head
from sysid.logs.mapping import ANGLES, RESPONSES, is_decibel, split_ending

QUICK = 1e-5  # s from row to row, below which rows are samples of a carrier rather than its amplitudes
SPLITS = ("chunk", "sweep", "run", "segment", "block", "experiment")  # of columns that number experiments
_WORDS: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "zeit", "temps", "x-axis", "x_value"),
    "frequency": ("f", "freq", "frequency", "frequenz", "fréquence", "frequence"),
    "temperature": ("temp", "temperature", "temperatur", "température", "t"),
    "force": ("force", "kraft"),
    "duty": ("duty", "pwm"),
    "voltage": ("v", "u", "voltage", "volt", "vin", "drive", "excitation", "spannung", "tension"),
    "wd": ("wd",),
    "wq": ("wq",),
    "x": ("x", "re", "real", "inphase", "in-phase", "u1", "g"),
    "y": ("y", "im", "imag", "imaginary", "quadrature", "quad", "u2", "b"),
    "magnitude": ("magnitude", "mag", "amplitude", "amp", "gain", "r", "power", "db"),
    "phase": ("phase", "phi", "theta", "arg", "ang", "angle", "θ", "θz", "θy", "thetaz", "thetay"),
    "w": ("w", "displacement", "velocity", "response"),
}
# Of what an impedance analyser writes, by the unit.
_RATIOS: dict[str, dict[str, tuple[str, ...]]] = {
    "ohm": {
        "x": ("r", "rs", "resistance", "re", "real", "z'"),
        "y": ("x", "xs", "reactance", "im", "imag", "imaginary", "z''"),
        "magnitude": ("z", "|z|", "zabs", "absz", "impedance", "magnitude", "mag", "abs", "w"),
    },
    "S": {
        "x": ("g", "gp", "conductance", "re", "real", "y'"),
        "y": ("b", "bp", "susceptance", "im", "imag", "imaginary", "y''"),
        "magnitude": ("y", "|y|", "yabs", "absy", "admittance", "magnitude", "mag", "abs"),
    },
}
_KINDS = {"displacement": "m", "velocity": "m/s", "charge": "C", "current": "A", "impedance": "ohm"}
_BEHIND = {word for name in ("x", "y", "magnitude", "phase") for word in _WORDS[name]} - {"g", "b", "u1", "u2"}


def template(head: Head) -> str:
    """A mapping file for this file, filled in as far as the names tell; what is left to say is "?" or commented out."""
    guessed = _guess(head.names)
    ratio = _ratio(head.names) if guessed.keys() & {"x", "magnitude"} else ""
    response = _unit(head.names[guessed["x" if "x" in guessed else "magnitude"]]) if ratio else ""
    ratio = "" if response and not units.same_kind(response, ratio) else ratio  # as of a log that has a thermistor's ohms
    waveform = _waveform(head, guessed)
    lines = [f"# How to read {_in_comment(head.name)}: fill in every ?, and save; then read the logs with --columns FILE"]
    if not head.dialect.header:
        lines += [f"# {_in_comment(f'{head.path} has no header; first row: {listed(head.sample[0])}')}"]
    lines += _of_samples(head, waveform) if waveform else _of_ratio(ratio) if ratio else _of_rows(head, guessed)
    dialect = head.dialect
    lines += [f"delimiter = {_quote(str(dialect.delimiter))}"] if dialect.delimiter != "," else []
    lines += ['decimal = ","'] if dialect.decimal == "," else []
    lines += [f"comment = {_quote(mark)}" for mark in dialect.comment or () if len(dialect.comment or ()) == 1 and mark != "#"]
    lines += [f"split_by = {_place(head, index)}  # each of its values is one experiment" for index in _splits(head)]
    lines += ["", "[columns]"]
    found = waveform or guessed
    lines += [_column(head, name, index, ratio) for name, index in found.items()]
    unused = [index for index in range(len(head.names)) if index not in found.values()]
    example = _place(head, unused[0]) if unused else '"?"'
    missing = [name for name in _missing(found) if not (ratio and name == "voltage")]
    lines += [f'# {name} = {{ column = {example}, unit = "?" }}' for name in missing]
    lines += [f"# not used: {_in_comment(listed([head.names[index] or str(index) for index in unused]))}"] if unused else []
    lines += ["", *_constants(bool(waveform), ratio), '# temperature = "20 degC"']
    untimed = waveform and "time" not in waveform and not any(key.casefold().startswith("sample_rate") for key in head.metadata)
    lines += ["", "# [metadata]", "# sample_rate_Hz = 1e6"] if untimed else []
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


def _of_ratio(ratio: str) -> list[str]:
    """What is to be said of an impedance, or an admittance: they state no amplitude, and analysers agree about the phase."""
    lines = ['# kind = "steady"  # or "transient"']
    if ratio == "ohm":
        return [*lines, 'quantity = "impedance"  # read as the current 1/Z that 1 V drives']
    lines += ['quantity = "current"  # of an admittance, driven by 1 V']
    lines += ['amplitude = "peak"  # of both, or both rms: it is a ratio']
    return [*lines, "phase_sign = 1"]


def _constants(waveform: bool, ratio: str) -> list[str]:
    """The heading of the constants, and the drive where it may be one."""
    if ratio == "S" and not waveform:
        return ["[constants]", 'voltage = "1 V"  # as an admittance is the current per volt']
    return ["# [constants]"] if waveform or ratio else ["# [constants]", '# voltage = "1 V"']


def _of_samples(head: Head, waveform: Mapping[str, int]) -> list[str]:
    """What is to be said of raw samples."""
    kind = 'kind = "waveform"  # it looks like raw samples of a carrier; of amplitudes "transient", with x and y, or w'
    return [
        kind,
        _quantity(head, waveform["response"]),
        "# which of the columns is the drive, and which the response, is a guess",
    ]


def _splits(head: Head) -> list[int]:
    """The first column that numbers experiments, if there is one."""
    return [index for index, label in enumerate(head.names) if label.casefold() in SPLITS][:1]


def _column(head: Head, name: str, index: int, ratio: str) -> str:
    unit = "s" if name == "time" and head.dated(index) else _unit(head.names[index])
    known = unit if _fits(name, unit) else ratio if ratio and name in ("x", "y", "magnitude") else "?"
    return f"{name} = {{ column = {_place(head, index)}, unit = {_quote(known)} }}"


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
    volts = [index for index in others if _fits("voltage", _unit(head.names[index]))]
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
    unit = _unit(head.names[time])
    steps = [after - before for before, after in pairwise(numbers)]
    return float(units.convert(median(steps), unit if _fits("time", unit) else "s", "s")) if steps else 0.0


def _quantity(head: Head, index: int | None) -> str:
    """What the signal in a column shows, by its unit; "?" where that does not tell, as of a sensor's volts."""
    unit = _unit(head.names[index]) if index is not None else ""
    quantity = next((kind for kind, of in _KINDS.items() if unit and units.same_kind(unit, of)), "?")
    return f'quantity = "{quantity}"  # what the signal shows: "displacement", "velocity", "charge", "current" or "impedance"'


def _guess(names: tuple[str, ...]) -> dict[str, int]:
    """Which column is probably which, by name and unit; a response only when it is whole, of one channel where it can be."""
    found: dict[str, list[int]] = {}
    ratio = _ratio(names)
    for index, label in enumerate(names):
        if name := _of_analyser(label, ratio) or _name(label, found):
            found.setdefault(name, []).append(index)
    for name in ("time", "frequency"):
        if name not in found and names and not any(0 in of for of in found.values()) and _fits(name, _unit(names[0])):
            found[name] = [0]
    guessed = {name: indices[0] for name, indices in found.items()}
    whole: tuple[str, ...] = next((of for of in RESPONSES if set(of) <= found.keys()), ())
    if len(whole) == 2:
        alike = ((a, b) for a in found[whole[0]] for b in found[whole[1]] if _channel(names[a]) == _channel(names[b]))
        guessed |= zip(whole, next(alike, (guessed[whole[0]], guessed[whole[1]])), strict=True)
    spare = {"wd", "wq", "w", "x", "y", "magnitude", "phase"} - set(whole)
    return {name: index for name, index in guessed.items() if name not in spare}


def _ratio(names: tuple[str, ...]) -> str:
    """"ohm" where the columns hold an impedance, by their units, or R beside X, or |Z|; "S" of an admittance; else ""."""
    stated = {_unit(label) for label in names}
    for of in _RATIOS:
        if any(unit and _is_unit(unit) and not is_decibel(unit) and units.same_kind(unit, of) for unit in stated):
            return of
    bare = {word for label in names if not _unit(label) for word in _split(label)[:1]}
    if ({"r", "x"} <= bare and "y" not in bare) or {"|z|", "z", "impedance"} & bare:
        return "ohm"
    return "S" if {"g", "b"} <= bare or {"|y|", "admittance"} & bare else ""


def _of_analyser(label: str, ratio: str) -> str | None:
    """What a column of an impedance or an admittance is called, whose letters mean other things elsewhere."""
    unit, word = _unit(label), next(iter(_split(label)), "")
    if not ratio or (unit and not units.same_kind(unit, ratio)):
        return None
    return next((name for name, of in _RATIOS[ratio].items() if word in of), None)


def _name(label: str, found: Mapping[str, list[int]]) -> str | None:
    """What a column is called by the whole of its name, by the first word of it, or by the last that may stand behind that of a
    channel or a parameter."""
    words = _split(label)
    unit = _unit(label)
    if "_err" in label.casefold() or not words:
        return None
    for word in (label.strip().casefold(), words[0], *(word for word in reversed(words[1:]) if word in _BEHIND)):
        fitting = [name for name, of in _WORDS.items() if word in of and (_fits(name, unit) or not _is_unit(unit))]
        if fitting:
            return next((name for name in fitting if name not in found), fitting[0])
    return None


def _split(label: str) -> list[str]:
    return [word for word in re.split(r"[\s_:;,/]+|[\[(].*", label.casefold()) if word]


def _channel(label: str) -> list[str]:
    """The words of a column's name that do not say which part of a response it is."""
    return [word for word in _split(label) if word not in _BEHIND and word != _unit(label).casefold()]


def _unit(label: str) -> str:
    return split_ending(re.sub(r"(?<=[\])])[^\[\]()]*$", "", label), False)[0]  # `|Z|(ohm)-data` has a word behind its unit


def _fits(name: str, unit: str) -> bool:
    if name in ("magnitude", "w") and unit in ANGLES:
        return False
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
