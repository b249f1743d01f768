"""Metadata that seem to be factors of the drive or of the response, and that nothing applies: gains,
attenuators, probes, sensitivities, ranges. On which side of them a column was recorded, a file does not say.
"""

import re

from sysid.columns.labels import INPUTS, folded
from sysid.columns.mapping import MappingFile
from sysid.columns.plan import ERRORS, Plan
from sysid.tables import units
from sysid.tables.cells import is_number, listed, to_number
from sysid.tables.csvfile import Head

# How words for them begin, in the languages of `labels`, without accents.
STEMS = (
    *("gain", "attenuat", "amplif", "preamp", "sensitiv", "sensib", "probe", "divider", "range", "scal"),
    *("verstark", "abschwach", "empfindlich", "messbereich", "tastkopf", "atenua", "ganancia", "guadagno"),
    *("усилени", "ослаблени", "чувствительност"),
)
OTHERS = {"sweep", "horizontal", "x", "phase"}.union(
    *(INPUTS[name] for name in ("time", "frequency", "temperature"))
)
_VALUE = re.compile(r"[x×]?\s*([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*((?::\s*\d+)|\S*)", re.IGNORECASE)
_PER_VOLT = re.compile(r"[^/].*/[pnuµmk]?[VA]|[pnuµmk]?[VC]/.+")  # mm/s/V, mV/g, pC/N


def not_applied(head: Head, plan: Plan, mapping: MappingFile | None) -> tuple[str, ...]:
    """A note on the metadata that seem to be factors, where no mapping file states a scale, nor knows the
    instrument by a preset."""
    columns = mapping.options.get("columns", {}) if mapping else {}
    known = mapping is not None and (mapping.base or any("scale" in entry for entry in columns.values()))
    stated = {**head.remarks, **plan.metadata}
    found = [] if known else [key for key in stated if _is_factor(key, stated[key])]
    if not found:
        return ()
    signals = {*units.AMPLITUDES} - {*ERRORS}
    parts = [name for name, of in plan.sources.items() if name in signals and of.column is not None]
    lines = f'a mapping file of the lines find = true, amplitude = "peak", columns.{parts[0]}.scale = FACTOR'
    how = f"scale = FACTOR in its entry of {listed(parts)}" if columns else lines
    keys = listed([repr(key) for key in found])
    are = "are" if found[1:] else "is"
    told = f"metadata {keys} {are} not used: {listed(parts)} are as their columns say"
    return (f"{told}; where one of them wants a factor, {how} says it",)


def _is_factor(key: str, value: str) -> bool:
    """Whether metadata are called so, or are so many of a unit per volt, and are not 1 or 0 dB."""
    number = _VALUE.fullmatch(value.strip())
    if units.is_key(key) or number is None or not is_number(number[1]):
        return False
    words = {word for word in re.split(r"[\W_]+", folded(key)) if word}
    unit = number[2] or units.split_unit(key)[1]
    called = any(word.startswith(STEMS) for word in words) and not words & OTHERS
    of_others = unit and any(units.fits(name, unit) for name in ("time", "frequency", "temperature"))
    per_volt = bool(_PER_VOLT.fullmatch(unit)) and units.is_known(unit)
    size = to_number(number[1].replace(",", "."))
    decibel = "db" in words or unit.casefold() == "db"
    none = size == 0 if decibel else size == 1 and unit.casefold() in ("", "1", "x", ":1")
    return (called or per_volt) and not of_others and not none
