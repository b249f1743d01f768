"""Units of spectral densities, and decibels of a reference: how people write them, and whose amplitude they
show.

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
_REFERENCE = re.compile(
    rf"(?<![A-Za-z])dB\s*(?:[(\[]\s*(?:re\b:?[^()\[\]]*|(?:1\s*)?{_UNIT})\s*[)\]]|re\b:?[^()\[\]]*)"
)
_POWER = re.compile(r"([^\s/]+)\^2(?:/([^\s/^]+)\^([24]))?/Hz")


def plain(text: str) -> str:
    """A head, or a unit, with its density written in one way that the library of units knows, and without
    the reference of its decibels.

    >>> plain("ASD [pm/√Hz]"), plain("(m/s)²/Hz"), plain("Vrms2/Hz"), plain("PSD (dBm/Hz)")
    ('ASD [pm/Hz^0.5]', 'm^2/s^2/Hz', 'V^2/Hz rms', 'PSD (dBm)')
    >>> plain("Magnitude [dB(m/s/V)]"), plain("Mag dB re 1 mm/s"), plain("dB (S21)")
    ('Magnitude [dB]', 'Mag dB', 'dB (S21)')
    """
    if "dB" in text:
        text = _REFERENCE.sub("dB", text)
    if "hz" not in text.casefold():
        return text
    text = text.replace("²", "^2").replace("**", "^")
    text = _NEGATIVE.sub(f"/{ROOT_HERTZ}", _ROOT.sub(f"/{ROOT_HERTZ}", text))
    text = _DIGIT.sub(r"\1^2", _RMS.sub(r"\1 rms", text))
    return _LEVEL.sub(r"\1", _QUOTIENT.sub(r"\1^2/\2^2", text))


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
    """The unit of the signal whose density is in `unit`: m of m^2/Hz and of m/Hz^0.5; of any other unit it
    itself."""
    return (amplitude_of(unit) or unit).removesuffix(f"/{ROOT_HERTZ}")
