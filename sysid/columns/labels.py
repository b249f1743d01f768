"""What the head of a column says, whoever wrote it: its unit, and which part of which signal or which input
it may be.

A head is taken apart into words. `Z re (Ohm)`, `Re[Z]`, `Zre`, `ReS11`, `S11(REAL)` and `TR1: Gain (Real)`
say the same of different signals: the real part. Letters that mean different things to different instruments
(x, y, r, g, b) are decided by the columns beside them."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.columns.mapping import split_ending
from sysid.columns.plan import ANGLES, PHASES, per_drive
from sysid.tables import densities, units
from sysid.tables.cells import amount, to_number
from sysid.tables.densities import is_decibel


def folded(text: str) -> str:
    """A text in small letters without accents, with which half of the files leave them out.

    >>> folded("Fréquence"), folded("TENSIÓN"), folded("Größe")
    ('frequence', 'tension', 'grosse')
    """
    if text.isascii():
        return text.casefold()
    apart = unicodedata.normalize("NFD", text.casefold())
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def _words(text: str) -> tuple[str, ...]:
    return tuple(folded(text).split())


# What English, German, French, Spanish, Italian, Portuguese, Dutch, Swedish, Polish and Russian call the
# inputs and a response. A word that means something else in another of them is left out, but where the unit
# tells: a tension in V is no force.
INPUTS = {
    name: _words(text)
    for name, text in {
        "time": "t time timestamp zeit uhrzeit temps heure tiempo hora tempo tijd tid czas время 時間 时间"
        " x-axis x_value xvalue second seconds sec elapsed",
        "frequency": "f freq frequency frequenz fréquence frecuencia frequenza частота frq omega ω"
        " frequência frequentie frekvens częstotliwość 周波数 频率",
        "temperature": "temp temperature temperatur température temperatura температура temperatuur t 温度",
        "force": "force kraft fuerza forza força kracht siła",
        "duty": "duty pwm tastgrad",
        "voltage": "v u voltage volt volts spannung tension voltaje tensione напряжение"
        " tensão voltagem spanning spänning napięcie 電圧 电压"
        " drive excitation anregung anregungsspannung excitación eccitazione возбуждение"
        " vin vdrive udrive vexc uexc vosc uosc oscillator",
        "wd": "wd",
        "wq": "wq",
        "w": "w displacement velocity response position deflection speed vibration"
        " auslenkung verschiebung geschwindigkeit antwort déplacement vitesse réponse"
        " desplazamiento velocidad respuesta spostamento velocità risposta перемещение скорость отклик"
        " deslocamento velocidade resposta verplaatsing snelheid förskjutning hastighet przemieszczenie",
    }.items()
}
# A drive whatever is said of its amplitude, as a voltage is none: a response may be one.
DRIVEN = {*_words("drive excitation anregung excitación eccitazione возбуждение oscillator")}
# Words that name a part wherever they stand: a phase before a magnitude, a magnitude in bars before the rest.
PHASE = {*_words(
    "phase phi theta θ φ ϕ arg ang angle argument thetaz thetay θz θy phz phas"
    " phasenwinkel phasenverschiebung winkel déphasage fase ángulo angolo фаза угол fas faz vaihe fáze"
    " 位相 相位"
)}  # fmt: skip
REAL = {*_words("re real realpart inphase realteil réel réelle reale действительная вещественная")}
IMAGINARY = {*_words(
    "im imag imaginary imagpart quadrature quad"
    " imaginärteil imaginaire imaginario imaginaria immaginaria мнимая"
)}  # fmt: skip
MAGNITUDE = {*_words(
    "abs mag magn magnitude modulus amplitude amp ampl db logmag linmag"
    " betrag amplitud módulo ampiezza modulo амплитуда модуль 振幅 幅值"
)}  # fmt: skip
SCATTERING = {"s11", "s12", "s21", "s22", "return", "vswr", "swr"}  # as a return loss
GAINS = SCATTERING | {"gain", "transmission", "reflection"}  # ratios of two of a kind
SIGNAL = GAINS | {"power", "level", "r"}  # magnitudes where nothing else is said
# Letters of a lock-in, and of what calls its channels otherwise.
LETTERS = {"x": {"x", "u1", "g", "vx", "ux"}, "y": {"y", "u2", "b", "vy", "uy"}}
ALONE = {"g", "b"}  # letters that also call channels
AXES = {"vx", "vy", "ux", "uy"}  # of a lock-in's volts; of another unit they are directions
# Of what an impedance analyser writes, by the unit: letters that mean other things elsewhere.
RATIOS: dict[str, dict[str, set[str]]] = {
    "ohm": {
        "x": {"r", "rs", "resistance"},
        "y": {"x", "xs", "reactance"},
        "magnitude": {"z", "impedance", "zabs", "absz", "w"},
    },
    "S": {
        "x": {"g", "gp", "conductance"},
        "y": {"b", "bp", "susceptance"},
        "magnitude": {"y", "admittance", "yabs", "absy"},
    },
}
# Of an input what is not the plate's own: a voltage that does not drive it, what a sweep is about, another
# place's temperature.
NOT_MEANT = {
    "voltage": {*_words(
        "dc vdc udc offset bias supply battery sensor detector photodiode pd laser sens fullscale fs"
        " versorgung"
        " versorgungsspannung gleichspannung alimentation d'alimentation alimentación alimentazione"
    )},
    "frequency": {*_words("center centre mittenfrequenz span rbw vbw")},
    "temperature": {*_words("dt delta δ δt dew dewpoint taupunkt cpu pcb board")},
}  # fmt: skip
# What holds dates, as text or as days since 1900, as spreadsheets have it: so many of 1982 to 2119.
STAMPED = _words("date datetime date/time zeitstempel datum datum/zeit fecha дата")
DAYS = (3e4, 8e4)
# What was asked for, or the edge of a range, where a column beside it says what there was.
SECOND = {*_words(
    "set setpoint soll sollwert target nominal nom cmd command commanded requested consigne"
    " min max minimum maximum"
)}  # fmt: skip
NOT_DATA = re.compile(r"_err|std|stdev|sigma|error|uncert|variance", re.I)  # of how sure another column is
ANGULAR = ("omega", "\u03c9")  # of radians alone: one of hertz leaves open whether 2 pi is in it
OFFSETS = {
    "offset",
    "detuning",
    "delta",
    "δ",
    "δf",
    "df",
    "shift",
    "verstimmung",
    "désaccord",
}  # of a frequency
# from which these are counted
CENTRES = {*_words("center centre mittenfrequenz centrale carrier reference ref lo")}
POWERS = {"power", "intensity", "leistung", "intensität", "puissance", "squared"}
LOGARITHM = re.compile(r"(ln|log|log10|lg)[\s_]*[(\[|]", re.I)  # of which the unit behind it is none
_TITLES = {("r",), ("x",), ("g",), ("b",), ("rs",), ("xs",), ("gp",), ("bp",)}  # of an analyser's traces
_TRACE = re.compile(r"\W*(data|memory) trace (real|imag)\W*", re.IGNORECASE)  # whatever it shows
_PARTS = PHASE | REAL | IMAGINARY | MAGNITUDE
_PLAIN = {
    "hz": "Hz", "khz": "kHz", "mhz": "MHz", "ghz": "GHz", "deg": "deg", "rad": "rad", "db": "dB",
    "dbm": "dBm",
    "dbv": "dBV", "ohm": "ohm", "ohms": "ohm", "kohm": "kohm",
}  # fmt: skip
# How a unit stands at the end of a head without brackets: behind a slash or a comma, behind a blank, or glued
# to a word; in the last two it is a usual one. A letter alone before it is a prefix: f_kHz is no f_k in Hz.
# abs(S), of a symbol and in no unit, unlike Re(V), which is in volts either way
_OF_A_SYMBOL = re.compile(r"\b(re|im|real|imag|abs|mag|mod|arg|ang|phase|db)\(([A-UW-Z])\)", re.IGNORECASE)
_USUAL = {
    *_PLAIN.values(),
    "V",
    "mV",
    "uV",
    "A",
    "mA",
    "s",
    "ms",
    "us",
    "um",
    "nm",
    "mm",
    "m/s",
    "mm/s",
    "degC",
    "°C",
    "°F",
    "S",
    "%",
}
_ENDINGS: tuple[tuple[str, set[str]], ...] = (
    (r"[/,]\s*([^/,\s_]+)$", set()),
    (r"\s(\S{2,})$", _USUAL),
    (r"(?<=[A-Za-z][a-z])(k?Hz|[MG]Hz|Deg|dB|DB|Rad|Ohm)$", _USUAL),
)
_DEGREES = {"C": "degC", "F": "degF", "c": "degC"}
# Parts that are glued to the sign of what they are of: ReS11, dBS21, Zre, absZ.
_OF = r"s\d\d|[zy]"
_PART = r"re|real|im|imag|mag|abs|mod|ang|arg|db|deg|phase|phz|ph"
_GLUED = re.compile(rf"(?P<a>{_PART})(?P<b>{_OF})|(?P<d>{_OF})(?P<c>{_PART})")
_SPELT = {"mod": "abs", "ph": "phase", "deg": "phase"}


@dataclass(frozen=True)
class Label:
    """A column's head taken apart: its words in small letters, its unit ("" where it states none), and its
    sign."""

    text: str  # in small letters, without the unit
    words: tuple[str, ...]
    unit: str
    sign: int = 1  # -1 of a column that is called minus something, as -Im(Z)
    amplitude: str = ""  # "rms" or "pp" of one that says so

    def is_called(self, name: str) -> bool:
        """Whether the whole of it, its first word or its last is one of an input's names."""
        return bool({self.text, *self.words[:1], *self.words[-1:]} & set(INPUTS[name]))

    @property
    def part(self) -> str:
        """ "phase", "x", "y" or "magnitude" by the words that say so wherever they stand; "" where none
        does."""
        words = set(self.words)
        if self.unit in ANGLES or (words & PHASE and self.unit in ("", *PHASES)):
            return "phase"
        if "|" in words:
            return "magnitude"
        named = (
            (words & REAL, "x"),
            (words & IMAGINARY, "y"),
            (words & MAGNITUDE or is_decibel(self.unit), "magnitude"),
        )
        return next((part for said, part in named if said), "")

    def letter(self, ratio: str) -> str:
        """The part that a letter or a signal's name stands for, in a file of a `ratio` ("ohm" or "S") or of
        none ("")."""
        if ratio and (not self.unit or units.same_kind(self.unit, ratio)):
            first = self.words[:1]
            return next((part for part, names in RATIOS[ratio].items() if set(first) & names), "")
        if set(self.words) & AXES and self.unit and not units.same_kind(self.unit, "V"):
            return ""
        behind = {self.text, *self.words[:1], *self.words[1:][-1:]}
        behind -= ALONE if len(self.words) > 1 else set()
        part = next((part for part, names in LETTERS.items() if behind & names), "")
        return part or ("magnitude" if set(self.words) & SIGNAL else "")

    @property
    def channel(self) -> tuple[str, ...]:
        """The words that do not say which part of a response it is, but of which channel or parameter."""
        letters = {"x", "y", "r", "|"}
        return tuple(word for word in self.words if word not in _PARTS | letters)


def parse(text: str) -> Label:
    """A head taken apart. Where a trace's title before it names a part, as `A |Z|: Data Trace Real` does, the
    head itself is of no use: analysers write every trace as a real part beside an imaginary one."""
    title, parted, own = text.rpartition(": ")
    words = title.split()
    if parted and words:
        lettered = len(words) > 1 and len(words[0]) == 1  # A |Z|, of a trace A
        label = parse(" ".join(words[1:] if lettered else words))
        told = label.part in ("phase", "magnitude") or (lettered and label.words[-1:] in _TITLES)
        if told or (lettered and _TRACE.fullmatch(own)):
            return label
    plain = densities.plain(text.strip()).replace("′", "'").replace("″", "''").replace("∠", " angle ")
    plain = re.sub(r"\bin[-_ ]phase", "inphase", plain, flags=re.IGNORECASE)
    plain = re.sub(r"out[-_ ]of[-_ ]phase", "quadrature", plain, flags=re.IGNORECASE)
    plain = re.sub(r"([ZYzy])(''|\")", r"\1 imag", plain)
    plain = re.sub(r"([ZYzy])'", r"\1 real", plain)
    plain = _OF_A_SYMBOL.sub(r"\1 \2", plain)
    plain, sign = (plain[1:].strip(), -1) if plain[:1] in "-−" and plain else (plain, 1)
    unit, rest = ("", plain) if LOGARITHM.match(plain) else _unit(plain)
    stated = _stated(plain)
    rest = re.sub(r"\|\s*([^|]*?)\s*\|", r" | \1 ", rest)
    apart = re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])(?!(?<=\bd)B)", " ", rest)
    words = [word for word in re.split(r"[\s_:;,/()\[\]{}<>.=-]+", folded(apart)) if word]
    words = [re.sub(r"^([uv])(rms|pp|eff|ss)$", r"\1", word) for word in words if word != "vss"]  # a supply
    parts = tuple(part for word in words for part in _apart(word) if part not in ("rms", "pp"))
    unit = unit or ("s" if parts in (("second",), ("seconds",), ("sec",)) else "")
    unit = unit or ("dB" if "db" in parts else "")  # db:Trc1_S21
    unit = _DEGREES.get(unit, unit) if set(parts) & set(INPUTS["temperature"]) else unit
    if unit in ("S", "MS") and parts[:1] and parts[0] in INPUTS["time"]:  # TIME_S; an M may be a mega
        unit = "s" if unit == "S" else ""
    return Label(folded(rest.strip(" :;,")), parts, unit, sign, stated)


def _stated(head: str) -> str:
    """What a word of a head says of its amplitude: of Vrms "rms", of Upp "pp"; of `peak` alone ""."""
    plain = re.sub(r"(pk|peak|pico|cr[eê]te)[- _](to|a|à)[- _]\1", "pp", head, flags=re.IGNORECASE)
    for word in re.split(r"[\s\[(){}\],;:_]+", re.sub(r"^vss\b", "", plain, flags=re.IGNORECASE)):  # a supply
        of, stated = units.split_amplitude(word)
        if stated and (len(of) < 4 or is_decibel(of) or per_drive(of)) and word.casefold() != "peak":
            return stated
    return ""


def left_open(name: str, label: Label, sweep: bool) -> str:
    """Why a column leaves its unit open although it seems to state one, as a remark; "" where it does not."""
    words, unit = {*label.words}, label.unit
    if LOGARITHM.match(label.text):
        return 'of a logarithm "dB" alone is read, with scale = 20 of log10(A), 8.685889638 of ln(A)'
    if label.amplitude and per_drive(unit):
        return f'"{unit}" where both are {label.amplitude}, else with a scale'
    if name == "frequency" and words & {*ANGULAR, "angular"} and "rad" not in unit:
        return "rad/s, or Hz where it is no angular frequency"
    squared = re.search(r"(?<!/s)(\^2|²)$|^[numkM]?W$", unit)
    power = squared or (words & POWERS and not densities.amplitude_of(unit))
    response = sweep and name in ("magnitude", "w") and not is_decibel(unit)
    return "of a power, or a square, save the root" if power and response else ""


def counts_days(name: str, numbers: Sequence[float] | np.ndarray) -> bool:
    """Whether a column that is called a date, and whose first numbers these are, counts days since 1900."""
    steps = np.diff(numbers)
    within = len(steps) > 0 and bool(np.all((DAYS[0] < np.array(numbers)) & (np.array(numbers) < DAYS[1])))
    return within and folded(name) in STAMPED and bool(np.all((steps >= 0) & (steps < 1)) and np.any(steps))


def centre(metadata: Mapping[str, str], unit: str) -> str:
    """The frequency that offsets in a unit are counted from, in that unit, as metadata state it; "" where
    they do not."""
    for key, value in metadata.items():
        label, (number, behind) = parse(key), amount(value) or ("", "")
        of = label.unit or behind
        if number and {*label.words} & CENTRES and units.fits("frequency", of):
            return f"{units.convert(to_number(number), of, unit):.15g}"
    return ""


def is_unit(text: str) -> bool:
    """Whether a text is a unit, and not one of the words for a part of a signal, some of which the library
    takes for units."""
    return (
        bool(text)
        and text.casefold() not in _PARTS - {"db"}
        and (text in ANGLES or is_decibel(text) or units.fits("w", text))
    )


def _is_rate(text: str) -> bool:
    """Whether a text is one unit over another: of time, of the drive, or one that is usual."""
    return is_unit(text) and (
        text in _USUAL or re.search(r"/(s|min|h)\b", text) is not None or per_drive(text) is not None
    )


def in_usual_letters(unit: str) -> str:
    """A unit as it is usually written: DB is dB, DEG is deg, OHM is ohm, RAD/S is rad/s; any other as it is,
    and one whose M may be a mega."""
    small = unit.casefold()
    if small in _PLAIN and unit not in ("mHz", "MHz"):
        return _PLAIN[small]
    shouted = len(unit) > 1 and unit.isupper() and unit[0] != "M" and not units.is_known(unit)
    return small if shouted and {*small.split("/")} <= _USUAL else unit


def _unit(text: str) -> tuple[str, str]:
    """The unit that a head states ("": none), and the head without it."""
    if (unit := in_usual_letters(text)).endswith("Hz") and unit in _USUAL:  # and nothing else
        return unit, ""
    for found in reversed(list(re.finditer(r"[\[(]([^\[\]()]*)[\])]", text))):
        unit = in_usual_letters(units.short(units.split_amplitude(found[1].strip())[0]))
        if is_unit(unit):
            return unit, f"{text[: found.start()]} {text[found.end() :]}"
    if level := densities.level_at_end(text):
        return level[1], level[0]
    if apart := units.split_in(text):
        return in_usual_letters(units.short(units.split_amplitude(apart[1])[0])), apart[0]
    bare = re.sub(r"[\[(][^\[\]()]*[\])]", "", text)
    if (found := re.search(r"[_\s]([^_\s]+/[^_\s]+)$", bare)) and _is_rate(
        whole := in_usual_letters(found[1])
    ):
        return whole, text.removesuffix(found[0])  # acceleration_m/s^2, Real g/V: all of it
    stem = units.split_amplitude(bare.strip())[0]
    if found := re.fullmatch(r"(?i)(acc|accel|acceleration)[_\s](m?g)", stem):
        return found[2].lower(), found[1]
    for pattern, usual in _ENDINGS:
        found = re.search(pattern, bare)
        unit = in_usual_letters(units.short(found[1])) if found and found.start() else ""
        if is_unit(unit) and (unit in usual or not usual):
            return unit, text.removesuffix(found[0])
    ending, _, last = text.rpartition("_")
    unit = in_usual_letters(units.short(last)) if ending else ""  # freq_hz
    unit = unit if unit in _USUAL else in_usual_letters(split_ending(text, False)[0])
    return (unit, ending or text) if is_unit(unit) else ("", text)


def _apart(word: str) -> list[str]:
    """A word, and where a part is glued to what it is of, both."""
    if word in _PARTS or not (found := _GLUED.fullmatch(word)):
        return [word]
    part, of = found["a"] or found["c"], found["b"] or found["d"]
    return [of, _SPELT.get(part, part)]
