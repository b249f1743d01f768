"""A mapping file drafted for a log whose columns are not understood: what is left to its reader is "?" or commented out."""

import json
import re
from collections.abc import Mapping

from sysid import units
from sysid.cells import listed
from sysid.csvfile import Head
from sysid.mapping import ANGLES, RESPONSES, is_decibel, split_ending

_WORDS: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "zeit"),
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
    lines = [f"# How to read {_in_comment(head.name)}: fill in every ?, and save; then read the logs with --columns FILE"]
    if not head.dialect.header:
        lines += [f"# {_in_comment(f'{head.path} has no header; first row: {listed(head.sample[0])}')}"]
    lines += ['# kind = "steady"  # or "transient"']
    lines += ['amplitude = "?"  # how drive and response are stated: "peak", "rms" or "pp"']
    if guessed.keys() & {"x", "magnitude"} or not guessed.keys() & {"w", "wd"}:
        quantity = _quantity(head, guessed)
        lines += [f'quantity = "{quantity}"  # what the signal shows: "displacement", "velocity", "charge" or "current"']
        if "phase" in guessed or "magnitude" not in guessed:
            lines += ['phase_sign = "?"  # 1 when the phase falls through the resonance, -1 when it rises']
    dialect = head.dialect
    lines += [f"delimiter = {_quote(str(dialect.delimiter))}"] if dialect.delimiter != "," else []
    lines += ['decimal = ","'] if dialect.decimal == "," else []
    lines += [f"comment = {_quote(dialect.comment)}"] if dialect.comment != "#" else []
    lines += ["", "[columns]"]
    for name, index in guessed.items():
        label = head.names[index]
        unit = split_ending(label, False)[0]
        column = _quote(label) if head.names.count(label) == 1 else str(index)
        lines.append(f"{name} = {{ column = {column}, unit = {_quote(unit if _fits(name, unit) else '?')} }}")
    missing = [name for name in ("time", "frequency", "voltage", "temperature") if name not in guessed]
    missing += [] if guessed.keys() & {"x", "w", "wd", "magnitude"} else ["x", "y"]
    example = _quote(head.names[0]) if head.names[0] else "0"
    lines += [f'# {name} = {{ column = {example}, unit = "?" }}' for name in missing]
    unused = [name or str(index) for index, name in enumerate(head.names) if index not in guessed.values()]
    lines += [f"# not used: {_in_comment(listed(unused))}"] if unused else []
    return "\n".join([*lines, "", "# [constants]", '# voltage = "1 V"', '# temperature = "20 degC"', ""])


def _quantity(head: Head, guessed: Mapping[str, int]) -> str:
    """What a signal shows, by its unit; "?" where that does not tell, as of a sensor's volts."""
    index = guessed.get("x", guessed.get("magnitude"))
    unit = split_ending(head.names[index], False)[0] if index is not None else ""
    kinds = {"displacement": "m", "velocity": "m/s", "charge": "C", "current": "A"}
    return next((kind for kind, of in kinds.items() if unit and units.same_kind(unit, of)), "?")


def _guess(names: tuple[str, ...]) -> dict[str, int]:
    """Which column is probably which, from the first word of its name; a response only when it is whole."""
    guessed: dict[str, int] = {}
    for index, label in enumerate(names):
        word = re.split(r"[\s_\[(]", label.strip().casefold(), maxsplit=1)[0]
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
