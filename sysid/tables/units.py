"""Names and units of log columns: `frequency_kHz`, `Voltage [V] rms`, `w_um_pp`; conversion to the units used
inside. Names of metadata: `kind`, `lockin_tau_us`.

Inside, time is in s, frequency in Hz, temperature in degC, force in N; drive and response keep the user's own
unit and are peak amplitudes. The library `pint` knows the units; it is loaded only for units that are not the
internal ones.
"""

import difflib
import functools
import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from sysid.tables.densities import level_at_end, level_of_volts, plain, reference

INTERNAL = {
    "time": "s",
    "frequency": "Hz",
    "temperature": "degC",
    "force": "N",
    "duty": "1",
    "carrier": "rad",
}
REFERENCE = INTERNAL | {
    "voltage": "V"
}  # a unit must be of this one's kind; quantities not named here take any unit
# These may be rms or peak to peak.
AMPLITUDES = ("voltage", "drive", "wd", "wq", "w", "x", "y", "magnitude", "response", "std", "std_q")
QUANTITIES = (
    *(
        "time",
        "frequency",
        "temperature",
        "force",
        "duty",
        "carrier",
        "voltage",
        "drive",
        "wd",
        "wq",
        "w",
        "response",
    ),
    *("std", "std_q"),  # standard errors of the response, or of d and of q
)
DRIVES = ("voltage", "drive", "duty")  # of which a log has one
CONSTANTS = ("temperature", "frequency", "force", *DRIVES)  # what may be constant over a log
WORDS = ("kind", "sampling", "plate", "phase_sign", "volts_per_duty")  # metadata without a unit
BENCH_TIMES = (
    "lockin_tau",
    "lockin_boxcar",
    "delay_std",
    "delay",
    "settle",
)  # in s inside; their metadata may carry another unit of time
BENCH_NUMBERS = {
    "lockin_order": "lockin_order",
    "temperature_std_degc": "temperature_std_degC",
}  # in one unit, in any case
PEAK = {"peak": 1.0, "rms": math.sqrt(2.0), "pp": 0.5}  # peak = factor * value, for a sine

_USUAL = {
    "time": ("s", "ms", "us", "ns", "min", "h"),
    "frequency": ("Hz", "kHz", "MHz", "GHz", "rad/s"),
    "temperature": ("degC", "K", "degF"),
    "force": ("N", "mN", "uN"),
    "duty": ("1", "%"),
    "carrier": ("rad", "deg"),
    "voltage": ("V", "mV", "kV", "uV"),
}
_PLAIN = (
    *("um", "nm", "mm", "m", "m/s", "mm/s", "um/s"),
    *("V", "mV", "uV", "A", "mA", "uA", "S", "C", "degC", "1", "%"),
)
_POWERS = {"n": -9, "u": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}
_PREFIXED = re.compile(r"([numkMG]?)(s|Hz|m|V|A|N|m/s)")
LONGEST = 60  # characters in a unit
_STRANGE = re.compile(r"[^\w\s*/^.,()%‰°√·⋅−+-]")  # of V~, an rms perhaps: the library leaves them out
_TOWER = re.compile(r"[\d)]\s*(\*\*|\^)")  # 9**9**9, which the library would work out
_CELSIUS = {"C": "degC", "F": "degF"}  # of a temperature; elsewhere a coulomb, a farad
_ALIASES = {
    "%": "percent", "pct": "percent", "°C": "degC", "°F": "degF",
    "tr/min": "rpm", "U/min": "rpm", "rev/min": "rpm",  # of French, of German
    "mil": "thou", "mils": "thou",  # of an inch: for the library it is an angle
}  # fmt: skip
# Units written out, in one or more, with or without a capital, and their signs.
_FULL = {
    "hertz": "Hz", "volt": "V", "second": "s", "sec": "s", "meter": "m", "metre": "m", "micron": "um",
    "newton": "N",
    "ampere": "A", "coulomb": "C", "kelvin": "K", "celsius": "degC", "fahrenheit": "degF", "radian": "rad",
    "percent": "%",
    "sekunde": "s", "sekunden": "s", "seconde": "s", "segundo": "s", "secondo": "s", "secondi": "s",
    "minute": "min", "minuten": "min", "hour": "h", "stunde": "h", "stunden": "h", "degree": "deg",
    "deg": "deg", "grad": "deg", "vdc": "V", "v dc": "V", "adc": "A", "a dc": "A",
}  # fmt: skip
_PREFIXES = {"nano": "n", "micro": "u", "milli": "m", "kilo": "k", "mega": "M", "giga": "G", "": ""}
_DEGREES = re.compile(r"(?:deg(?:rees?)?\.?|[°º˚o])\s*([CF])", re.IGNORECASE)  # deg C, ° C, ºC, oC
_CYRILLIC = {
    "гц": "Hz", "кгц": "kHz", "мгц": "MHz", "град": "deg", "рад": "rad", "дб": "dB", "в": "V", "мв": "mV",
    "с": "s", "мс": "ms", "мкс": "us", "м": "m", "мм": "mm", "мкм": "um", "нм": "nm", "ом": "ohm",
}  # fmt: skip
_OHM = re.compile(
    r"([numkMG]?)(?:[oO]hms?|\u03a9|\u2126)"
)  # the last two: a capital omega, and the sign of the ohm
_WRITTEN = re.compile(rf"({'|'.join(_PREFIXES)})({'|'.join(_FULL)})s?", re.I)
# f/Hz, a table's head by ISO 80000: a quantity over its unit; f, Hz as Russian has it
_QUOTIENT = re.compile(r"([^/_,]*[^/_,\s])(?:\s*/\s*|,\s+)(\S.*)")
_PART = re.compile(r"([wW])_([dDqQ])(?=[_\s\[(])")  # W_d (um), w_q_um
_IN = re.compile(r"(|.*\S)[\s_]+in\s+(\S.*)")  # Zeit in s; of R&S also "in s" alone, or below a name
# Of Veff and Vss (Spitze-Spitze); behind other letters they end a word, and w_ss is the steady state. A
# Spannung SS is one of a voltage.
_WORD = (
    r"rms|pp|peak|p-p|pk-?pk|pk|0-?p|(?<=(?-i:[VAUIm]))eff|(?<![A-Za-z])eff\.?|(?<=(?-i:[VAmU]))ss"
    r"|(?:(?<=ung )|(?<=age ))ss|peak[ -](?:to[ -])?peak|spitze-spitze|cr[eê]te [aà] cr[eê]te"
    r"|pico a pico|picco-picco|(?:valeur |valore )?efficace|(?:valor )?eficaz|effektiv(?:-?wert)?|rms-?wert"
    r"|scheitelwert|spitzenwert|(?<=(?-i:[VA]))AC"
)
_BRACKETS = re.compile(
    rf"([^\[(]*?)[\s_]*(?:[\[(]({_WORD})[\])])?\s*[\[(]\s*([^\])]*?)\s*[\])][\s_]*[\[(]?({_WORD})?[\])]?",
    re.I,
)
_BEFORE = re.compile(rf"({_WORD})_([^_]+)", re.I)  # rms_V of voltage_rms_V
_AMPLITUDE = re.compile(rf"(?P<unit>.*?)[\s_]*(?P<amplitude>{_WORD})", re.I)
_PEAKS = {"pk": "peak", "0-p": "peak", "0p": "peak"}
_PEAKS |= dict.fromkeys(("scheitelwert", "spitzenwert"), "peak")


class Name(NamedTuple):
    """What a column name says: `voltage_V_rms` is ("voltage", "V", "rms"); the unit is "" when the name has
    none."""

    quantity: str
    unit: str
    amplitude: str


@functools.lru_cache(1024)  # of a lot's logs, whose names are the same
def parse_name(label: str) -> Name | None:
    """The quantity, unit and kind of amplitude that a column name states, behind the object that it stands in
    (`payload.time_s`) too; None for a column that is not one of ours."""
    name, unit, amplitude = split_unit(label)
    quantity = name.casefold()
    if quantity not in QUANTITIES:
        own = parse_name(end) if (end := label.rpartition(".")[2]) != label else None
        return own if own and own.unit and own.quantity not in ("std", "std_q") else None
    if quantity == "duty":
        return Name(quantity, short(unit) or "1", "peak")
    if quantity in AMPLITUDES:
        unit, stated = split_amplitude(unit)
        amplitude = stated or amplitude
    unit = _in_case(quantity, short(unit))
    level = level_of_volts(unit) if quantity in DRIVES else ""
    return Name(quantity, unit, amplitude or level or "peak")


def bench_time(key: str) -> tuple[str, str] | None:
    """`lockin_tau_us` is ("lockin_tau", "us"); None for a key that is not a time of the bench."""
    name = next((name for name in BENCH_TIMES if key.casefold().startswith(f"{name}_")), None)
    return (name, key[len(name) + 1 :]) if name else None


def is_key(key: str) -> bool:
    """Whether metadata may be called so: a word, what is known of the bench, or a constant input, in a unit
    of its kind."""
    if key.casefold() in (*WORDS, *BENCH_NUMBERS):
        return True
    time, name = bench_time(key), parse_name(key)
    if time:
        return fits("time", time[1])
    return name is not None and name.quantity in CONSTANTS and fits(name.quantity, name.unit)


def fits(quantity: str, unit: str) -> bool:
    """Whether `unit` is one, and of the quantity's kind."""
    try:
        check_unit(quantity, unit)
    except ValueError:
        return False
    return True


@functools.lru_cache(1 << 17)  # of a hundred thousand heads each is looked at several times
def split_unit(label: str) -> tuple[str, str, str]:
    """Name, unit and amplitude word of `Name [unit] rms`, `Name/unit`, `Name, unit`, `Name in unit` or
    `name_unit`; `name_word_unit` is a name without one."""
    label = _PART.sub(r"\1\2", plain(label.strip()), count=1)
    if found := _BRACKETS.fullmatch(label):
        name, stated = (found[1], "") if found[1] == "Vss" else split_amplitude(found[1])  # a supply
        return name, found[3], _in_words(found[4] or found[2] or stated)
    if apart := level_at_end(label) or split_in(label):
        return *apart, ""
    if (found := _QUOTIENT.fullmatch(label)) and _is_unit(split_amplitude(found[2])[0]):
        return found[1], found[2], ""
    name, _, rest = label.partition("_")
    if found := _BEFORE.fullmatch(rest):
        return name, found[2], _in_words(found[1])
    if "_" in split_amplitude(rest)[0]:
        return label, "", ""
    return name, rest.strip(), ""


def split_in(label: str) -> tuple[str, str] | None:
    """Name and unit of `Name in unit`; None of any other label."""
    found = _IN.fullmatch(f" {label}")
    return (found[1].strip(), found[2]) if found and _is_unit(split_amplitude(found[2])[0]) else None


def split_amplitude(unit: str) -> tuple[str, str]:
    """`V_rms`, `V rms` and `Vrms` are ("V", "rms"); the second is "" when nothing is stated."""
    found = _AMPLITUDE.fullmatch(unit)
    return (found["unit"], _in_words(found["amplitude"])) if found else (unit, "")


def _in_words(amplitude: str) -> str:
    word = amplitude.lower()
    if word == "ac" or re.search("eff|rms|efi", word):  # VAC, as meters have it
        return "rms"
    return _PEAKS.get(word, word if word in ("", *PEAK) else "pp")


def short(unit: str) -> str:
    """The sign of a unit that is written out: `Volts` is `V`, `kilohertz` is `kHz`. Any other text as it
    is."""
    if known := _CYRILLIC.get(unit.casefold()):
        return known
    if unit not in _ALIASES and (found := _DEGREES.fullmatch(unit.translate({0x2103: "°C", 0x2109: "°F"}))):
        return f"deg{found[1].upper()}"  # of the signs for both, too
    if ohm := _OHM.fullmatch(unit):
        return f"{ohm[1]}ohm"
    found = _WRITTEN.fullmatch(unit)
    return _PREFIXES[found[1].casefold()] + _FULL[found[2].casefold()] if found else unit


def _in_case(quantity: str, unit: str) -> str:
    """The usual unit of a quantity that differs in capitals alone, as instruments write `HZ`; not where an m
    might be an M."""
    usual = _USUAL.get(quantity, _PLAIN)
    if quantity == "temperature":
        unit = _CELSIUS.get(unit.upper(), unit)
    same = [other for other in usual if other.casefold() == unit.casefold()]
    return (
        same[0] if len(same) == 1 and unit not in usual and (len(unit) == 1 or unit[0] not in "mM") else unit
    )


def check_unit(quantity: str, unit: str) -> None:
    """Raise ValueError when `unit` is unknown or of the wrong kind for `quantity`, with what was expected."""
    kind = REFERENCE.get(quantity)
    if unit == kind or unit in _USUAL.get(quantity, ()) or (kind is None and unit in _PLAIN):
        return
    if quantity in DRIVES and unit not in ("", "dB"):
        unit = reference(unit)  # dBV, of which the amplitude is read
    usual = _USUAL.get(quantity, _PLAIN)
    expected = f"expected a unit of {quantity} such as {', '.join(usual[:4])}"
    if not unit:
        raise ValueError(f"found no unit, {expected}, as in {quantity}_{usual[0]}")
    if re.fullmatch(r"dB\w*|dB:.*", unit):
        raise ValueError(f"found decibels ({unit}), {expected}; decibels are read through a mapping file")
    if (
        len(unit) > 1 and unit[0] == "M" and (milli := nearest(unit, usual, 1.0))
    ):  # MV: of a header in capitals, a millivolt
        raise ValueError(f"found the unit {unit!r}, of a million, {expected}; did you mean {milli!r}?")
    parsed = _parse(unit)
    if parsed is None or (kind and parsed.dimensionality != _parse(kind).dimensionality):
        named = (
            "; a current, a force or a pressure that drives is called drive"
            if _drives(quantity, unit)
            else ""
        )
        raise ValueError(f"found the unit {unit!r}, {expected}{named or did_you_mean(unit, usual)}")


def _drives(quantity: str, unit: str) -> bool:
    """Whether what is called a voltage is a drive of another kind."""
    return quantity == "voltage" and any(same_kind(unit, kind) for kind in ("A", "N", "Pa"))


def is_known(unit: str) -> bool:
    """Whether a text is a unit, of whatever kind."""
    return (
        unit in _PLAIN or _parse(unit) is not None or re.fullmatch(r"dB\w{0,2}|dB:.*|deg|°", unit) is not None
    )


def _is_unit(text: str) -> bool:
    """Whether what stands below a name is a unit, in whatever capitals: V of `u/V`, and not q of `d/q`."""
    return is_known(text) or any(_in_case(quantity, text) != text for quantity in QUANTITIES)


def same_kind(unit: str, other: str) -> bool:
    """Whether values in `unit` can be converted to `other`."""
    if unit == other or _power(unit, other) is not None:
        return True
    first, second = _parse(unit), _parse(other)
    return first is not None and second is not None and first.dimensionality == second.dimensionality


def is_of(unit: str, kind: str) -> bool:
    """Whether values in `unit` can be converted to `kind`, an ohm or a siemens; of usual units without
    loading the library."""
    return unit == kind or (unit not in _PLAIN and same_kind(unit, kind))


def convert(values: Any, unit: str, to: str) -> Any:
    """`values` in `unit` as values in `to` (s, Hz, degC, ...); both units must have passed `check_unit`."""
    if unit == to:
        return values
    scale, zero = _line(unit, to)
    small = 1 / scale
    # 12.5 ms is exactly 0.0125 s when divided by 1000, and not always when multiplied by 0.001
    scaled = (
        values / round(small)
        if small > 1 and math.isclose(small, round(small), rel_tol=1e-12)
        else values * scale
    )
    return scaled + zero if zero else scaled


def nearest(word: str, choices: Sequence[str], cutoff: float = 0.6) -> str | None:
    """The choice that is spelt most like `word`, or ends like it (C for degC); None when no one is near."""
    folded = {choice.casefold(): choice for choice in reversed(choices)}
    near = difflib.get_close_matches(word.casefold(), list(folded), n=1, cutoff=cutoff)
    near = near or [choice for choice in folded if word and choice.endswith(word.casefold())]
    return folded[near[0]] if near else None


def did_you_mean(word: str, choices: Sequence[str]) -> str:
    """`; did you mean 'kHz'?`, or nothing when no choice is near."""
    near = nearest(word, choices)
    return f"; did you mean {near!r}?" if near else ""


@functools.cache
def _line(unit: str, to: str) -> tuple[float, float]:
    """Scale and zero of the straight line that takes a value in `unit` to one in `to`."""
    if (power := _power(unit, to)) is not None:
        return 10.0**power, 0.0
    quantity, source, target = _registry().Quantity, _parse(unit), _parse(to)
    zero = quantity(0.0, source).to(target).magnitude
    scale = quantity(1.0, source).to(target).magnitude - zero
    if to == "Hz" and "radian" in str(quantity(1.0, source).to_base_units().units):
        scale /= 2 * math.pi  # pint takes a radian for 1, so that 1 rad/s would be 1 Hz
    if str(target) == "degree_Celsius":
        scale, zero = (
            round(scale, 12),
            round(zero, 12),
        )  # differences of two temperatures carry rounding errors
    return scale, zero


def _power(unit: str, to: str) -> int | None:
    """The power of ten that takes `unit` to `to`, where they differ by a prefix alone; else None. The library
    takes as long to load as a dozen logs to read."""
    first, second = _PREFIXED.fullmatch(unit), _PREFIXED.fullmatch(to)
    return _POWERS[first[1]] - _POWERS[second[1]] if first and second and first[2] == second[2] else None


@functools.cache
def _parse(unit: str) -> Any:
    """The unit as pint's object, or None when pint does not know it."""
    if not (unit.isprintable() and 0 < len(unit) <= LONGEST) or _TOWER.search(unit) or _STRANGE.search(unit):
        return None
    try:
        parsed = _registry().parse_units(_ALIASES.get(unit) or short(unit))
        return (
            parsed if parsed.dimensionality is not None else None
        )  # of nepers times kelvin there is none: it raises
    except (
        Exception
    ):  # pint answers odd text with AttributeError, ValueError, AssertionError and tokenizer errors
        return None


@functools.cache
def _registry() -> Any:
    import pint

    try:
        return pint.UnitRegistry(
            cache_folder=":auto:"
        )  # ten times faster than without, where the cache can be written
    except Exception:
        return pint.UnitRegistry()
