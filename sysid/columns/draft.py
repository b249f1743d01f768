"""A mapping file drafted for a log whose columns are not understood: what is left to its reader is "?" or
commented out."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.columns.labels import GAINS, NOT_DATA, OFFSETS, SCATTERING, centre, left_open
from sysid.columns.plan import ANGLES, SPLITS, in_gravity, per_drive
from sysid.columns.preset import known_by, known_of
from sysid.columns.roles import lone_signal, plausible, roles, undecided
from sysid.columns.samples import channels, waveform
from sysid.columns.survey import Columns, fits
from sysid.tables import densities, units
from sysid.tables.cells import is_number, listed, to_number
from sysid.tables.csvfile import Head
from sysid.tables.densities import is_decibel, level_of_volts

PERIODS = ("ts", "dt", "tinterval", "sample_time", "sampletime")  # what the time from row to row is called
KINDS = {
    "displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "charge": "C", "current": "A",
    "impedance": "ohm",
}  # fmt: skip
# What a carrier's amplitude is stated in; a signal of another unit, as of a speed or a temperature, is no
# amplitude.
VIBRATIONS = (*KINDS.values(), "S", "V", "N", "1", "Pa")
_CIRCUIT = {"cp", "cs", "lp", "ls", "d", "q", "tan"}  # what analysers show besides, which is no impedance

_OF_A_CIRCUIT = (
    "# Cp, D and the like are elements of a circuit, and no response: have the analyser write Z and theta, or"
    " R and X"
)


def template(head: Head, given: Mapping[str, Any] | None = None) -> str:
    """A mapping file for this file, filled in as far as the names tell, and as is `given` by the options of
    another or known of the instrument; what is left to say is "?" or commented out."""
    columns = Columns(head)
    guessed = roles(columns)
    samples = waveform(columns, guessed)
    files = {} if samples else channels(columns, guessed)
    samples = samples or (
        {"time": guessed["time"], "drive": files["of"], "response": files["of"]} if files else {}
    )
    found = samples or lone_signal(columns, guessed)
    known = known_of(head) if given is None else known_by(given)
    known = known[0] or "the file", {**known[1], **_says(head)}
    unsaid = not {word for label in columns.labels for word in label.words} & (GAINS | _CIRCUIT)
    ratio = columns.ratio or (known[1].get("ratio", "") if unsaid else "")
    ratio = ratio if found.keys() & {"x", "y", "magnitude"} and _is_ratio(columns, found, ratio) else ""
    draft = _Draft(head, columns, found, ratio, *known, files)
    lines = []
    if not head.dialect.header and not any(head.names):
        lines += [f"# {_in_comment(f'{head.path} has no header; first row: {listed(head.sample[0])}')}"]
    lines += [_OF_A_CIRCUIT] if columns.is_circuit and not found.keys() & {"x", "y", "magnitude", "w"} else []
    lines += draft.of_samples() if samples else draft.of_ratio() if ratio else draft.of_rows()
    lines += draft.dialect()
    lines += ["", "[columns]", *draft.columns_found(), *draft.columns_missing()]
    lines += ["", *draft.constants()]
    live = [line.partition("  #")[0] for line in lines if not line.startswith("#")]
    do = "fill in every ?, and save" if any('"?"' in line for line in live) else ""
    if lost := draft.lost():
        do = f"no column is known to be {lost}: name it under [columns]; {do or 'save'}"
    do = do or "nothing is left to fill in: save"
    first = f"# How to read {_in_comment(head.name)}: {do}; then read the logs with --columns FILE"
    return "\n".join([first, *lines, ""])


@dataclass(frozen=True)
class _Draft:
    """The lines of a mapping file for the columns `found`, by the names that mapping files have for them."""

    head: Head
    columns: Columns
    found: Mapping[str, int]
    ratio: str  # "ohm" or "S" of an impedance or an admittance, else ""
    instrument: str  # that wrote the file, "" where nothing tells
    known: Mapping[str, str]  # what it is known to write
    files: Mapping[str, Any]  # of a channel a file: the patterns of the files

    def of_rows(self) -> list[str]:
        """What is to be said of rows of amplitudes, or of a signal that is no carrier's."""
        kind = '# kind = "steady"  # or "transient", or "waveform": raw samples of a carrier'
        lines = [kind, self._amplitude()]
        if self.found.keys() & {"w", "wd"} or undecided(self.columns, self.found):
            return lines
        first = next((self.found[name] for name in ("x", "y", "magnitude") if name in self.found), None)
        lines += [self._quantity(first)]
        if self.found.keys() & {"phase", "x", "y"} or "magnitude" not in self.found:
            sign = "1" if self._words() & SCATTERING else self.known.get("phase_sign", '"?"')
            lines += [
                f"phase_sign = {sign}  # 1 when the phase falls through the resonance, -1 when it rises"
            ]
        return lines

    def _words(self) -> set[str]:
        """The words of the response's heads."""
        places = [self.found[name] for name in ("x", "y", "magnitude", "phase") if name in self.found]
        return {word for index in places for word in self.columns.labels[index].words}

    def _amplitude(self) -> str:
        """How drive and response are stated: asked for unless the instrument, or the response's unit,
        tells."""
        if "amplitude" in self.known:
            return f"amplitude = {_quote(self.known['amplitude'])}  # as {self.instrument} states both"
        if self._by() or (self._words() & GAINS and not self.found.keys() & {*units.DRIVES}):
            return 'amplitude = "peak"  # of a ratio, which states none'
        response = next((self.found[name] for name in ("w", "magnitude") if name in self.found), None)
        if response is not None and densities.ROOT_HERTZ in _root(self.columns.unit(response)):
            return 'amplitude = "peak"  # of a spectral density, which states none'
        index = self.found.get("w")
        if index is not None and "frequency" not in self.found:
            unit = self.columns.unit(index)
            of_carrier = (
                not unit or is_decibel(unit) or any(units.same_kind(unit, kind) for kind in VIBRATIONS)
            )
            if self.columns.is_signed(index) or not of_carrier:
                return (
                    'amplitude = "peak"  # a signal as it stands, with its sign, is no amplitude of a carrier'
                )
        told = [
            self.columns.labels[k].amplitude
            or (name in units.DRIVES and level_of_volts(self.columns.unit(k)))
            for name, k in self.found.items()
            if name in units.AMPLITUDES
        ]
        if told and all(told):
            return "# amplitude: as the columns say"
        return 'amplitude = "?"  # how drive and response are stated: "peak", "rms" or "pp"'

    def _by(self) -> str:
        """The unit of the drive by which the response is stated, V of m/s/V; "" where it is by none."""
        places = [self.found[name] for name in ("x", "y", "magnitude") if name in self.found]
        of = next(filter(None, (per_drive(densities.shown(self.columns.unit(k))) for k in places)), None)
        return of[1] if of else ""

    def of_ratio(self) -> list[str]:
        """What is to be said of an impedance, or an admittance: they state no amplitude, and analysers agree
        about the phase."""
        lines = ['# kind = "steady"  # or "transient"']
        if self.ratio == "ohm":
            return [
                *lines,
                'quantity = "impedance"  # the current 1/Z that 1 V drives; of a coil "velocity"',
            ]
        lines += ['quantity = "current"  # of an admittance, driven by 1 V']
        lines += ['amplitude = "peak"  # of both, or both rms: it is a ratio']
        return [*lines, "phase_sign = 1"] if self.found.keys() & {"x", "phase"} else lines

    def of_samples(self) -> list[str]:
        """What is to be said of raw samples."""
        kind = (
            'kind = "waveform"  # it looks like raw samples of a carrier; of amplitudes "transient", with'
            " x and y, or w"
        )
        guess = "# which of the columns is the drive, and which the response, is a guess"
        guess += "; they are in a file each: give both" if self.files else ""
        return [kind, self._quantity(self.found["response"]), guess]

    def lost(self) -> str:
        """What a log cannot be without, and no column is known to be; "" where it is whole."""
        parts = self.found.keys() & {"x", "y", "w", "wd", "magnitude", "response"}
        response = parts or undecided(self.columns, self.found)
        inputs = {*self.found, *self._stated()} & {"time", "frequency", *units.DRIVES} or self._is_timed()
        named = {"the response": response, "a time or frequency": inputs}
        return " or ".join(name for name, known in named.items() if not known)

    def _is_timed(self) -> bool:
        """Whether a sample rate is stated, or the period from row to row."""
        keys = [key.casefold() for key in self.head.metadata]
        return any(key.startswith("sample_rate") for key in keys) or bool(self._period())

    def dialect(self) -> list[str]:
        """How the file is written, where a mapping file has to say it, and what tells its experiments
        apart."""
        dialect, marks = self.head.dialect, self.head.dialect.comment or ()
        lines = [f"delimiter = {_quote(str(dialect.delimiter))}"] if dialect.delimiter != "," else []
        lines += ['decimal = ","'] if dialect.decimal == "," else []
        lines += [f"comment = {_quote(mark)}" for mark in marks if len(marks) == 1 and mark != "#"]
        lines += [f"table = {_quote(dialect.table)}"] if dialect.table is not None else []
        join = _quote(dialect.join) if isinstance(dialect.join, str) else dialect.join
        lines += (
            [f"join = {join}  # the tables below one another share it"] if dialect.join is not None else []
        )
        splits = [index for index, label in enumerate(self.head.names) if label.casefold() in SPLITS][:1]
        return lines + [
            f"split_by = {self._place(index)}  # each of its values is one experiment" for index in splits
        ]

    def columns_found(self) -> list[str]:
        """The columns that are known, or probably so."""
        lines = [self._column(name, index) for name, index in self.found.items()]
        if either := undecided(self.columns, self.found):
            names = _in_comment(" or ".join(self._place(index) for index in either))
            lines += [
                f'w = {{ column = "?", unit = "?" }}  # the response: {names}; the other may be the drive'
            ]
        half = {"x": "y", "y": "x"}
        lines += [
            f'{half[name]} = {{ column = "?", unit = "?" }}  # the other part: {name} alone is no response'
            for name in half.keys() & self.found.keys()
            if half[name] not in self.found
        ]
        return lines

    def columns_missing(self) -> list[str]:
        """What else a file may hold, commented out, with a column that may be it; and the columns that are
        not used."""
        missing = [name for name in self._missing() if not (self.ratio and name == "voltage")]
        lines, taken = [], dict(self.found)
        for name in missing:
            may = self._candidates(name, taken)
            if name == "voltage" and not may:
                duty = [k for k in plausible(self.columns, "duty", taken) if self.columns.unit(k)]
                name, may = ("duty", duty) if duty else (name, may)
            lines += [f'# {name} = {{ column = {self._place(may[0]) if may else _quote("?")}, unit = "?" }}']
            taken |= {name: may[0]} if may and (name in ("x", "y") or not any(self.head.names)) else {}
        lines += self._errors()
        unused = [index for index in range(len(self.head.names)) if index not in self.found.values()]
        named = [self.head.names[index] or str(index) for index in unused]
        return lines + ([f"# not used: {_in_comment(listed(named))}"] if unused else [])

    def _errors(self) -> list[str]:
        """A column that may hold standard errors of the response, commented out: a spread of single readings
        is none."""
        spread = [
            index
            for index, label in enumerate(self.columns.labels)
            if NOT_DATA.search(self.head.names[index]) and label.part != "phase" and self.columns.moves(index)
        ]
        if not spread or "response" in self.found or self.ratio:
            return []
        unit = self.columns.unit(spread[0]) or "?"
        return [
            f"# std = {{ column = {self._place(spread[0])}, unit = {_quote(unit)} }}  # if these are its"
            f" standard errors"
        ]

    def _candidates(self, name: str, taken: Mapping[str, int]) -> list[int]:
        if any(self.head.names):
            return plausible(self.columns, name, taken)
        return [index for index in range(len(self.head.names)) if index not in taken.values()]

    def constants(self) -> list[str]:
        """What is constant: as the file states it above its rows, and what may be and is not in it."""
        samples, stated = "response" in self.found, self._stated()
        driven = (
            samples or self.ratio or self.found.keys() & {*units.DRIVES} or stated.keys() & {*units.DRIVES}
        )
        told = [f"# {name}: as each file states it, {value} here" for name, value in stated.items()]
        live = ['voltage = "1 V"  # as an admittance is the current per volt'] if self.ratio == "S" else []
        if not driven and (unit := self._by()):
            name, driven = ("voltage" if fits("voltage", unit) else "drive"), True
            live += [f'{name} = "1 {unit}"  # as the response is stated by {unit}']
        spare = [] if driven or self.ratio else ['# voltage = "1 V"']
        spare += [] if "temperature" in {*self.found, *stated} else ['# temperature = "20 degC"']
        lines = [*(["[constants]", *live] if live else ["# [constants]"]), *told, *spare]
        rate = "time" in self.found or any(
            key.casefold().startswith("sample_rate") for key in self.head.metadata
        )
        if not rate and (period := self._period()):
            return [*lines, "", "[metadata]", period]
        return lines + (["", "# [metadata]", "# sample_rate_Hz = 1e6"] if samples and not rate else [])

    def _period(self) -> str:
        """The line that states the sample rate, where a constant of the file is a period in s; else ""."""
        stated = (
            (key, to_number(value)) for key, value in self.head.metadata.items() if key.casefold() in PERIODS
        )
        return next((f"sample_rate_Hz = {1 / of:.12g}  # 1/{key}, in s" for key, of in stated if of > 0), "")

    def _stated(self) -> dict[str, str]:
        """Constant inputs that the file's own metadata state, as a mapping file would."""
        found: dict[str, str] = {}
        for key, value in self.head.metadata.items():
            name = units.parse_name(key)
            if name is None or name.quantity not in units.CONSTANTS or not is_number(value):
                continue
            drive = name.quantity in units.DRIVES
            taken = {*self.found, *found} & ({*units.DRIVES} if drive else {name.quantity})
            if taken or (drive and (self.ratio or "response" in self.found)):
                continue
            amplitude = f"_{name.amplitude}" if drive and name.amplitude != "peak" else ""
            unit = name.unit if units.fits(name.quantity, name.unit) else "?"
            found[name.quantity] = f"{value} {unit}{amplitude}"
        return found

    def _missing(self) -> list[str]:
        found = self.found
        if "response" in found:
            return [name for name in ("time", "frequency", "temperature") if name not in found]
        driven = found.keys() & {*units.DRIVES}
        missing = [name for name in ("time", "frequency") if name not in found] + (
            [] if driven else ["voltage"]
        )
        missing += [] if "temperature" in found else ["temperature"]
        whole = found.keys() & {"x", "y", "w", "wd", "magnitude"} or undecided(self.columns, found)
        return missing + ([] if whole else ["x", "y"])

    def _column(self, name: str, index: int) -> str:
        """One column with its unit, "?" where nothing tells it."""
        unit, why = self._unit(name, index)
        label = self.columns.labels[index]
        more = ", scale = -1.0" if label.sign < 0 else ""
        ratio = self.ratio or per_drive(label.unit)
        stated = label.amplitude if name in units.AMPLITUDES and not ratio else ""
        more += f", amplitude = {_quote(stated)}" if stated else ""
        away = name == "frequency" and {*label.words} & OFFSETS
        begin = centre(self.head.metadata, unit) if away else ""
        more += f", offset = {begin or _quote('?')}" if away else ""
        why = why or ("  # offset: the frequency that it is counted from, in its unit" if away else "")
        more += f", file = {_quote(self.files[name])}" if name in self.files else ""
        return f"{name} = {{ column = {self._place(index)}, unit = {_quote(unit)}{more} }}{why}"

    def _unit(self, name: str, index: int) -> tuple[str, str]:
        unit = self.columns.unit(index)
        if why := left_open(name, self.columns.labels[index], "frequency" in self.found):
            return "?", f"  # {why}"
        if name == "time" and self.head.dated(index):
            return "s", ""
        if name in ("w", "wd", "wq", "x", "y", "magnitude", "response") and fits("time", unit):
            return "?", "  # what ends in _s may be a rate: A/s, or A*s" if "_" in self.head.names[
                index
            ] else ""
        if unit and (fits(name, unit) or (name == "w" and unit in ANGLES)):
            power = densities.amplitude_of(unit)
            return densities.written(unit), "  # a power density: its root is read" if power else ""
        if unit:
            return "?", ""
        if self.ratio and name in ("x", "y", "magnitude"):
            return self.ratio, ""
        if unit := self.known.get({"y": "x"}.get(name, name), ""):
            return unit, f"  # as it is written by {self.instrument}"
        angles = self.columns.numbers(index)
        if name == "phase" and self.ratio and len(angles) and np.max(np.abs(angles)) > 2 * np.pi:
            return "deg", "  # its numbers are too large for rad"
        return "?", ""

    def _place(self, index: int) -> str:
        """A column by its name, or by its position where the name does not tell."""
        label = self.head.names[index]
        return _quote(label) if label and self.head.names.count(label) == 1 else str(index)

    def _quantity(self, index: int | None) -> str:
        """What the signal in a column shows, by its unit; "?" where that does not tell, as of a sensor's
        volts."""
        unit = in_gravity(self.columns.shows(index)) if index is not None else ""
        words = self.columns.labels[index].words if index is not None else ()
        called = next((kind for kind in KINDS if any(is_short_for(kind, word) for word in words)), "?")
        quantity = next((kind for kind, of in KINDS.items() if unit and units.same_kind(unit, of)), called)
        known = self.known.get("quantity", "?")  # of no ratio: its columns are none of an impedance
        quantity = known if quantity == "?" and known != "impedance" else quantity
        return (
            f'quantity = "{quantity}"  # what the signal shows: "displacement", "velocity",'
            f' "acceleration", "charge", "current", "impedance"; of S11 "reflection", of S21 "transmission"'
        )


def is_short_for(kind: str, word: str) -> bool:
    """Whether a word is that of a kind of signal, or short for it: acc, accel, disp, vel."""
    return len(word) > 2 and kind.startswith(word)


def _root(unit: str) -> str:
    """The unit of what is read of a column: the root of a power density."""
    return densities.amplitude_of(unit) or unit


def _is_ratio(columns: Columns, found: Mapping[str, int], ratio: str) -> bool:
    """Whether the response is the ratio that some columns hold: a log may have a thermistor's ohms beside
    it."""
    unit = next(columns.unit(found[name]) for name in ("x", "y", "magnitude") if name in found)
    return bool(ratio) and (not unit or (not is_decibel(unit) and units.same_kind(unit, ratio)))


def _says(head: Head) -> dict[str, str]:
    """What a file's own metadata say of its amplitudes, and of what its signal shows."""
    said: dict[str, Mapping[str, Any]] = {"amplitude": units.PEAK, "quantity": KINDS}
    told = {key.casefold(): value.strip().casefold() for key, value in head.metadata.items()}
    return {key: told[key] for key, words in said.items() if key in told and told[key] in words}


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")  # else a JSON text is a TOML text


def _in_comment(text: str) -> str:
    """Text that ends no comment: TOML allows no control characters in one, a line end in a file's name least
    of all."""
    return "".join(c if c.isprintable() else " " for c in text)
