"""What a log's metadata say of the bench: the lock-in's filter, a delay, how long points settle, the
thermometer's error.

A line that has no effect, though its key is nearly one that has, is told from a remark: what it was probably
meant to be.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from difflib import SequenceMatcher

from sysid.columns.mapping import WORDS
from sysid.columns.metadata import metadata_number, stated
from sysid.columns.plan import Plan, is_absent
from sysid.columns.synonyms import LETTERS, SYNONYMS
from sysid.tables import units
from sysid.tables.cells import amount, is_number
from sysid.tables.csvfile import Head, LogError

BENCH = ("lockin_tau_s", "lockin_boxcar_s", "delay_s", "delay_std_s", "settle_s", *units.BENCH_NUMBERS)
NEAR = 0.85  # likeness of a misspelt key: `samplng` has 0.93, and `place` 0.8 of a plate
LONG = 8  # letters of a quantity that is known by a misspelt name alone, without a unit
PLATES = ("plate_id", "plate_name", "plate_no", "plate_number")
_DEGREES = {"C": "degC", "°C": "degC", "F": "degF", "°F": "degF"}


def bench_of(head: Head, metadata: Mapping[str, str]) -> dict[str, float]:
    """What is known of the bench: times in s, the order of the lock-in's filter, and how far its thermometer
    may be off."""
    bench = {}
    for key, text in metadata.items():
        if name := units.BENCH_NUMBERS.get(key.casefold()):
            bench[name] = metadata_number(head, key, text)
        elif named := units.bench_time(key):
            try:
                units.check_unit("time", named[1])
            except ValueError as error:
                raise LogError(f"{head.path}, metadata {key!r}: {error}") from None
            number = metadata_number(head, key, text, units.Name("time", named[1], "peak"))
            bench[f"{named[0]}_s"] = float(units.convert(number, named[1], "s"))
    for key, value in bench.items():
        if key == "lockin_order" and (value < 1 or value % 1):
            raise LogError(
                f"{head.path}, metadata {key!r}: found {value:g}, expected a whole number of poles"
            )
        if key != "delay_s" and value < 0:
            unit = "degC" if key in units.BENCH_NUMBERS.values() else "s"
            raise LogError(f"{head.path}, metadata {key!r}: found {value:g} {unit}, expected 0 or more")
    return bench


def misread(head: Head, plan: Plan, options: Collection[str]) -> tuple[str, ...]:
    """A sentence on each line above the rows that has no effect, though it nearly is metadata or is an option
    of a mapping file that `options` lack."""
    found = []
    for key, value in {**head.remarks, **plan.metadata}.items():
        if len(key) > units.LONGEST or (key in plan.metadata and units.is_key(key)):
            continue
        if said := _option(_plain(key), value, plan, options):
            found.append(f"{head.name}: metadata {key!r} is not used; {said}")
        elif meant := _meant_word(_plain(key), value, plan) or _meant_number(
            key, value, plan, "columns" in options
        ):
            said = (
                f"; did you mean {meant!r}?"
                if meant != key
                else f": found {value!r}, expected a finite number"
            )
            found.append(f"{head.name}: metadata {key!r} is not used{said}")
    return tuple(found)


def _plain(key: str) -> str:
    """A key in small letters, its words joined by one mark."""
    return re.sub(r"[\s.-]+", "_", key.strip()).casefold()


def _option(key: str, value: str, plan: Plan, options: Collection[str]) -> str | None:
    """How to say what only a mapping file can: that amplitudes are no peaks, and that the phase has another
    sign."""
    if key in options:
        return None
    peaks = any(plan.sources[name].amplitude != value for name in plan.sources.keys() & {*units.AMPLITUDES})
    if key == "amplitude" and value in ("rms", "pp") and peaks:
        option = f'a mapping file (--columns) of the line amplitude = "{value}"'
        return f"the names of the columns say it, as in voltage_V_{value}, or {option}"
    turned = (key == "phase_sign" and value == "-1") or (
        key == "phase_offset_deg" and is_number(value) and value.strip("0.+-")
    )
    return f"a mapping file (--columns) of the line {key} = {value} says it" if turned else None


def _meant_word(key: str, value: str, plan: Plan) -> str | None:
    """The key of a word that is nearly this one: `sampling` by its value too, a plate by its key alone."""
    for word in ("kind", "sampling"):
        likeness = 0.6 if value.casefold() in WORDS[word] else NEAR
        if (
            _is_near(key, word, likeness)
            and units.nearest(value, WORDS[word])
            and not stated(plan.metadata, word)
        ):
            return word
    plate = (_is_near(key, "plate") and key != "plates") or key in PLATES
    return "plate" if plate and value and not stated(plan.metadata, "plate") else None


def _meant_number(key: str, value: str, plan: Plan, mapped: bool) -> str | None:
    """The key of a number that is nearly this one, with the unit that the key or the value states; where a
    mapping file names the columns (`mapped`) the metadata state no inputs."""
    if (found := amount(value)) is None:
        return None
    for name, unit in _partings(key):
        if number := next(
            (number for number in ("lockin_order", "volts_per_duty") if _is_near(name, number) and not unit),
            None,
        ):
            return number
        if _is_near(name, "temperature_std") and (not unit or units.fits("temperature", unit)):
            return "temperature_std_degC"
        if (time := next((time for time in units.BENCH_TIMES if _is_near(name, time)), None)) and _agrees(
            "time", unit
        ):
            return f"{time}_{_unit('time', unit, found[1])}"
        quantity = None if mapped else _meant_quantity(name, unit, found[1], plan)
        if quantity and _agrees(quantity, unit):
            return f"{quantity}_{_unit(quantity, unit, found[1])}"
    return None


def _partings(key: str) -> Iterator[tuple[str, str]]:
    """Name and unit of a key: as brackets or its last word tell, and the whole as a name without a unit."""
    name, unit, _ = units.split_unit(key)
    if key.rstrip().endswith(("]", ")")) and unit:
        yield _plain(name), _DEGREES.get(unit, unit)
        return
    name, _, unit = re.sub(r"[\s.-]+", "_", key.strip()).rpartition("_")
    if name:
        yield _plain(name), _DEGREES.get(unit, unit)
    yield _plain(key), ""


def _meant_quantity(name: str, unit: str, beside: str, plan: Plan) -> str | None:
    """The input that a log lacks and a key names, nearly or by another word; `beside` the number may stand
    its unit."""
    if len(name) == 1:  # t is a time or a temperature, as its unit tells
        letters = [LETTERS.get(name, ""), *(["temperature"] if name == "t" else [])]
        meant = [
            q for q in letters if q in units.CONSTANTS and units.fits(q, unit or _DEGREES.get(beside, beside))
        ]
    else:
        known = dict.fromkeys(units.CONSTANTS) | SYNONYMS
        near = [
            q
            for q in units.CONSTANTS
            if _is_near(name, q) and (unit or len(q) >= LONG or units.fits(q, beside))
        ]
        meant = [SYNONYMS.get(name, name)] if name in known else near
    return next((q for q in meant if q in units.CONSTANTS and is_absent(q, plan.sources)), None)


def _agrees(quantity: str, unit: str) -> bool:
    """Whether a unit is of the quantity's kind, if there is one."""
    return not unit or units.fits(quantity, units.split_amplitude(unit)[0])


def _unit(quantity: str, unit: str, beside: str) -> str:
    """The unit in the key, else that beside the number where it is of the quantity's kind, else the
    quantity's own."""
    bare, amplitude = units.split_amplitude(_DEGREES.get(unit or beside, unit or beside))
    usual = units.REFERENCE.get(quantity, "V")
    return (bare if units.fits(quantity, bare) else usual) + (f"_{amplitude}" if amplitude else "")


def _is_near(name: str, key: str, likeness: float = NEAR) -> bool:
    """Whether a name is a key, one that is misspelt, or one of which letters changed places."""
    swapped = name[:1] == key[0] and sorted(name) == sorted(key)
    return swapped or SequenceMatcher(None, name, key).ratio() >= likeness
