"""Units of rates, of spectral densities, and decibels of a reference: how people write them, and whose
amplitude they show.

A name that a program has to take holds no slash: rad_s is rad/s, um_per_V is um/V. A second behind a volt or
an ampere may as well be a factor, and stays what it is.

A spectrum analyser, or a plotter of a thermal spectrum, shows how a signal's power is spread over frequency,
S(f) in V^2/Hz, or its root in V/sqrt(Hz). The root is proportional to the amplitude of the response to a
force of the same density at all frequencies; the power is the square of that, and no response."""

import re

ROOT_HERTZ = "Hz^0.5"
_ROOT = re.compile(
    r"/\s*(?:sqrt|√|rt|root\s)\s*(?:\(\s*Hz\s*\)|Hz)|/\s*Hz\s*(?:\^\s*(?:\(1/2\)|1/2|½|0?\.5)|½)", re.I
)
_NEGATIVE = re.compile(r"[\s*·]+Hz\s*\^?\s*(?:\(-1/2\)|-1/2|-0?\.5)")  # V Hz^-1/2
_QUOTIENT = re.compile(r"\(\s*([^\s()/]+)\s*/\s*([^\s()/]+)\s*\)\^2(?=\s*/\s*Hz)")  # (m/s)^2/Hz
_DIGIT = re.compile(
    r"(?:(?<=[\s_(\[])|^)([fpnumkMG]?(?:V|m|A|g|W|N|Pa))2(?=\s*/\s*Hz)"
)  # V2/Hz, and not Ch2/Hz
_RMS = re.compile(r"(?<=[A-Za-z])_?rms((?:\^?2)?\s*/\s*Hz(?:\^0\.5)?)", re.I)  # Vrms/sqrt(Hz)
_LEVEL = re.compile(r"(dBm?)V?\s*/\s*Hz(?:\^0\.5)?")  # of a level per hertz the ratios are those of the level
# dB(m/s/V), dB re 1 V: what 0 dB is, of which only ratios are read
_UNIT = r"[fpnuµmkMG]?(?:V|A|W|N|Pa|C|S|m|g|ohm|Ω)(?:\s*[/*·^²]\s*[^\s()\[\]]+)*"
_RE = rf"(?:re\b:?\s*)?(?:1(?:\.0*)?\s*)?(?P<{{}}>{_UNIT})"
_REFERENCE = re.compile(
    rf"(?<![A-Za-z])dB\s*(?:[(\[]\s*(?:{_RE.format('a')}|re\b:?[^()\[\]]*)\s*[)\]]"
    rf"|re\b:?\s*(?:1(?:\.0*)?\s*)?(?P<b>{_UNIT})(?![A-Za-z])|re\b:?[^()\[\]]*)"
)
_VOLTS = re.compile(r"(?<![A-Za-z])dB([muµ]V)(?![A-Za-z])")
_QUOTIENTS = re.compile(r"\(\s*([^\s()/]+\s*/\s*[^\s()/]+)\s*\)\s*/\s*([A-Za-zµ]+)")  # (m/s) / V
_OF_TIME = re.compile(
    r"(?<=_)([fpnuµmck]?m|m?rad|deg|rev)_(s|min|h)(?:_?\^?-?1|_?\^?-?(2)|(²))?(?=(?:_(?:rms|pp|peak))?$)",
    re.I,
)
_PER = re.compile(r"(?<=_)([A-Za-zµ]+)_per_([A-Za-z]+)(?=(?:_(?:rms|pp|peak))?$)", re.I)
_DEGREE = re.compile(r"(?<=_)deg_([CF])$", re.I)
LEVEL = "dB:"  # and the unit of 0 dB, without a bracket, so that it may stand in one
_ROOTS = {"dBm": "mW^0.5", "dB:mW": "mW^0.5", "dB:W": "W^0.5"}  # of a power
_POWER = re.compile(r"([^\s/]+)\^2(?:/([^\s/^]+)\^([24]))?/Hz")


def plain(text: str) -> str:
    """A head, or a unit, with its rate, its density, and the reference of its decibels, written in one way
    that the library of units knows.

    >>> plain("ASD [pm/√Hz]"), plain("(m/s)²/Hz"), plain("Vrms2/Hz"), plain("PSD (dBm/Hz)")
    ('ASD [pm/Hz^0.5]', 'm^2/s^2/Hz', 'V^2/Hz rms', 'PSD (dBm)')
    >>> plain("Magnitude [dB(m/s/V)]"), plain("Mag dB re 1 mm/s"), plain("dB (S21)"), plain("dB re max")
    ('Magnitude [dB:m/s/V]', 'Mag dB:mm/s', 'dB (S21)', 'dB')
    >>> plain("Real [ (m/s) / V ]")
    'Real [ m/s/V ]'
    >>> plain("w_rad_s"), plain("wd_um_s2_rms"), plain("G_um_per_V"), plain("T_deg_C"), plain("charge_A_s")
    ('w_rad/s', 'wd_um/s^2_rms', 'G_um/V', 'T_degC', 'charge_A_s')
    """
    if "_" in text:
        text = _DEGREE.sub(r"deg\1", _PER.sub(r"\1/\2", _OF_TIME.sub(_rated, text)))
    text = _QUOTIENTS.sub(lambda found: f"{found[1]}/{found[2]}".replace(" ", ""), text)
    if "dB" in text:
        text = _VOLTS.sub(rf"{LEVEL}\1", _REFERENCE.sub(_referred, text))
    if "hz" not in text.casefold():
        return text
    text = text.replace("²", "^2").replace("**", "^")
    text = _NEGATIVE.sub(f"/{ROOT_HERTZ}", _ROOT.sub(f"/{ROOT_HERTZ}", text))
    text = _DIGIT.sub(r"\1^2", _RMS.sub(r"\1 rms", text))
    return _LEVEL.sub(r"\1", _QUOTIENT.sub(r"\1^2/\2^2", text))


def _rated(found: re.Match[str]) -> str:
    """A rate with its slash; the M of a header in capitals may be a mega, and stays."""
    above = found[1] if found[1][-1] in "mM" else found[1].casefold()
    return f"{above}/{found[2].casefold()}{'^2' if found[3] or found[4] else ''}"


def _referred(found: re.Match[str]) -> str:
    """Decibels with their reference, those of another reference than one of a unit without any; dB(A) is a
    level of sound."""
    unit = re.sub(r"\s+", "", found["a"] or found["b"] or "").replace("·", "*")
    return f"{LEVEL}{unit}" if unit not in ("", "A") else "dB"


def reference(unit: str) -> str:
    """The unit of what is 1 at 0 dB: of decibels of a power its root; of any other unit it itself.

    >>> reference("dB"), reference("dBV"), reference("dB:mm/s"), reference("dBm"), reference("dB:V^2/Hz")
    ('1', 'V', 'mm/s', 'mW^0.5', 'V/Hz^0.5')
    """
    if unit in _ROOTS:
        return _ROOTS[unit]
    of = unit.removeprefix(LEVEL) if unit.startswith(LEVEL) else {"dB": "1", "dBV": "V"}.get(unit, unit)
    return amplitude_of(of) or of


def is_decibel(unit: str) -> bool:
    """Whether a column in this unit is 20 log10 of an amplitude."""
    return unit in ("dB", "dBm", "dBV") or unit.startswith(LEVEL)


def level_of_volts(unit: str) -> str:
    """ "rms" of decibels over a volt, as 0 dBV is one of 1 V rms; "" of any other unit.

    >>> level_of_volts("dBV"), level_of_volts("dB:mV"), level_of_volts("dB:mm/s"), level_of_volts("V")
    ('rms', 'rms', '', '')
    """
    return "rms" if is_decibel(unit) and re.fullmatch(r"[fpnuµmk]?V", reference(unit)) else ""


def written(unit: str) -> str:
    """A unit as people write it: dB(mm/s)."""
    return f"dB({unit.removeprefix(LEVEL)})" if unit.startswith(LEVEL) else unit


def level_at_end(label: str) -> tuple[str, str] | None:
    """A head without brackets, and the decibels of a reference at its end; None of any other."""
    found = re.fullmatch(rf"(.*?)[\s_]*({LEVEL}[^\s()\[\]]+)", label)
    return (found[1], found[2]) if found else None


def amplitude_of(unit: str) -> str | None:
    """The unit of the root of a power density, None of any other unit.

    >>> amplitude_of("pm^2/Hz"), amplitude_of("m^2/s^4/Hz"), amplitude_of("W/Hz"), amplitude_of("V/Hz^0.5")
    ('pm/Hz^0.5', 'm/s^2/Hz^0.5', 'W^0.5/Hz^0.5', None)
    """
    if watts := re.fullmatch(r"([fpnumkMG]?W)/Hz", unit):
        return f"{watts[1]}^0.5/{ROOT_HERTZ}"
    if not (found := _POWER.fullmatch(unit)):
        return None
    below = {None: "", "2": f"/{found[2]}", "4": f"/{found[2]}^2"}[found[3]]
    return f"{found[1]}{below}/{ROOT_HERTZ}"


def shown(unit: str) -> str:
    """The unit of the signal whose density, or level, is in `unit`: m of m^2/Hz, of m/Hz^0.5 and of dB(m); of
    any other unit it itself."""
    unit = reference(unit)
    return (amplitude_of(unit) or unit).removesuffix(f"/{ROOT_HERTZ}")
