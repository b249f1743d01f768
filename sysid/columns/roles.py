"""Which column of another instrument's file is probably which: by its head, its unit, the columns beside it
and its numbers."""

from collections.abc import Mapping

import numpy as np

from sysid.columns.factors import STEMS
from sysid.columns.labels import DRIVEN, INPUTS, NOT_DATA, NOT_MEANT, SECOND, Label
from sysid.columns.survey import LEVELS, Columns, fits, is_hertz
from sysid.tables import units
from sysid.tables.densities import is_decibel

TURN = 360.0  # degrees, beyond which a principal angle does not go
FLICKER = 3  # times as often as a drive a reading of few digits changes, at least
COUNTERS = {
    "sample",
    "samples",
    "index",
    "point",
    "points",
    "no",
    "nr",
    "number",
    "chunk",
    "sweep",
    "run",
    "log",
    "repeat",
    "segment",
    "shot",
    "cycle",
    "grid",
    "frame",
    "frames",
    "#",
}
SAY_NOTHING = {
    *"ab12",
    "table",
    "trace",
    "data",
    "real",
    "imag",
    "value",
    "values",
    "formatted",
}  # of what a trace is
DRIVES = {"V": "voltage", "%": "duty", "A": "drive", "N": "drive", "W": "drive"}  # by the unit
BOUNDS = ("threshold", "trigger", "limit", "complian")  # of what is set, how their words begin
# of one signal in one unit, else: a current is no part of a signal in V
LETTER_PAIRS = {("i", "q"): ("x", "y"), ("cos", "sin"): ("x", "y"), ("d", "q"): ("wd", "wq")}
_PAIRS = (("wd", "wq"), ("x", "y"), ("magnitude", "phase"))


def roles(columns: Columns) -> dict[str, int]:
    """The columns by the names of a mapping file: inputs, and a response where it is whole, of one channel
    where it can be."""
    if not any(columns.head.names):
        return _by_numbers(columns)
    found = _named(columns)
    guessed = {name: indices[0] for name, indices in found.items()}
    whole = _response(columns, found)
    if columns.head.dialect.join is not None and len(whole) < 2:
        whole = _response(columns, found | _two_traces(columns, found))
    spare = {"wd", "wq", "w", "x", "y", "magnitude", "phase"}
    told = {name: index for name, index in guessed.items() if name not in spare} | whole
    return told | (_held(columns, told) if whole else {})


def lone_signal(columns: Columns, guessed: Mapping[str, int]) -> dict[str, int]:
    """The columns with the one that is left as the response, whatever it shows: a speed, a temperature. As
    they are where there is none, or where it is one of several that do not say what they are."""
    found = dict(guessed)
    if found.keys() & {"wd", "x", "y", "magnitude", "response"} or not found.keys() & {"time", "frequency"}:
        return found
    left = _telling(columns, _first(columns, _left(columns, found)))
    left = _without_drive(columns, found, [k for k in left if "w" not in found or columns.unit(k)])
    if "w" not in found:
        if undecided(columns, found):
            return found
        told = bool(left) and (
            len(left) == 1 or (bool(columns.unit(left[0])) and not _are_parts(columns, found, left))
        )
        one = left[0] if told else None if left else _lone_input(columns, found)
        if one is None:
            return found
        found["w"] = one
    found |= _off_at_first(columns, found)
    unit = columns.shows(found["w"])
    derivative = any(unit and units.same_kind(unit, kind) for kind in ("m/s", "m/s^2", "A"))
    phases = [k for k, label in enumerate(columns.labels) if label.part == "phase" and columns.moves(k)]
    as_magnitude = "w" not in guessed or derivative or len(phases) == 1
    if "frequency" in found and not columns.is_signed(found["w"]) and as_magnitude:
        found["magnitude"] = found.pop("w")
        found |= {"phase": phases[0]} if len(phases) == 1 else {}
    return found | _held(columns, found)


def rivals(columns: Columns) -> list[int]:
    """Other columns that may be the response as well as the one that is taken for it alone, an amplitude or a
    signal."""
    named = roles(columns)
    found = lone_signal(columns, named)
    alone = {"w", "magnitude"} & found.keys() and "phase" not in found
    left = (
        "magnitude" in found.keys() - named.keys() and "w" not in named
    )  # what there was, whatever it shows
    others = _left(columns, found)
    return others if alone else _telling(columns, _first(columns, others)) if left else []


def _are_parts(columns: Columns, found: Mapping[str, int], left: list[int]) -> bool:
    """Whether columns beside a frequency may be parts of one signal: of one unit, some below zero."""
    alike = [k for k in left if columns.unit(k) == columns.unit(left[0])]
    return "frequency" in found and len(alike) > 1 and any(map(columns.is_signed, alike))


def _left(columns: Columns, found: Mapping[str, int]) -> list[int]:
    """Columns that are not found to be something else, and may be a response."""
    return [k for k in range(len(columns.labels)) if k not in found.values() and _may_respond(columns, k)]


def _first(columns: Columns, left: list[int]) -> list[int]:
    """Columns without what was asked for beside what there was, in the same unit."""
    known = {columns.unit(k) for k in left if not {*columns.labels[k].words} & SECOND}
    return [k for k in left if columns.unit(k) not in known or not {*columns.labels[k].words} & SECOND]


def undecided(columns: Columns, found: Mapping[str, int]) -> list[int]:
    """The two columns of which one may be the drive and one the response, where neither their heads nor their
    numbers tell which is which; empty where something does."""
    inputs = {"frequency", "temperature", *units.DRIVES, *"wxy", "wd", "magnitude", "response"}
    left = _left(columns, found)
    told = len(left) != 2 or not any(map(columns.unit, left)) or found.keys() & inputs
    return [] if told else left


def _telling(columns: Columns, left: list[int]) -> list[int]:
    """Of columns that may be a response those that state a unit, where any does; with the one beside it that
    does not, where the one that does is held at levels as a drive is."""
    stated = [index for index in left if columns.unit(index)]
    if len(left) == 2 and len(stated) == 1 and columns.is_held(stated[0]):
        (other,) = set(left) - set(stated)
        return stated if columns.is_held(other) else left
    return stated or left


def _off_at_first(columns: Columns, found: Mapping[str, int]) -> dict[str, int]:
    """The drive, where nothing is called so: the one column of its kind that is left, and 0 in the first
    rows."""
    may = _may_drive(columns, found) if "time" in found else {}
    off = [k for k in may if not columns.numbers(k).any()]
    return {may[off[0]]: off[0]} if len(off) == 1 else {}


def _held(columns: Columns, found: Mapping[str, int]) -> dict[str, int]:
    """The drive of a sweep, where nothing is called so: the one column of its kind that is left, and held: no
    share, as of humidity, and no power, to which a response is not linear."""
    may = _may_drive(columns, found) if "frequency" in found else {}
    proportional = [k for k in may if any(units.same_kind(columns.unit(k), of) for of in "VAN")]
    held = [k for k in proportional if columns.is_held(k) and columns.numbers(k).any()]
    return {may[held[0]]: held[0]} if len(held) == 1 else {}


def _is_a_setting(label: Label) -> bool:
    """Whether a column is called a bias, a supply, a range, a sensitivity or a limit, which drive nothing."""
    return bool({*label.words} & NOT_MEANT["voltage"]) or any(
        w.startswith((*STEMS, *BOUNDS)) for w in label.words
    )


def _may_drive(columns: Columns, found: Mapping[str, int]) -> dict[int, str]:
    """Columns that are left and in the unit of a drive, by what it is called; none where one is found."""
    if found.keys() & {*units.DRIVES}:
        return {}
    free = [k for k in range(len(columns.labels)) if k not in found.values() and columns.holds_data(k)]
    free = [k for k in free if columns.unit(k) and not _is_a_setting(columns.labels[k])]
    return {k: name for k in free for of, name in DRIVES.items() if units.same_kind(columns.unit(k), of)}


def _without_drive(columns: Columns, found: dict[str, int], left: list[int]) -> list[int]:
    """Columns that may be a response, without one beside it that is held at levels, which is put into `found`
    as the drive."""
    held = sorted((index for index in left if columns.is_held(index)), key=columns.changes)
    if len(held) == 2 and FLICKER * columns.changes(held[0]) <= columns.changes(held[1]):
        del held[1]
    others = len(left) + ("w" in found) + ("temperature" in found and columns.moves(found["temperature"]))
    if others < 2 or len(held) != 1 or found.keys() & {*units.DRIVES}:
        return left
    unit = columns.unit(held[0])
    found["voltage" if not unit or fits("voltage", unit) else "duty" if fits("duty", unit) else "drive"] = (
        held[0]
    )
    return [index for index in left if index not in held]


def _lone_input(columns: Columns, found: dict[str, int]) -> int | None:
    """A column that looked like an input, or like a phase, and is all there is that may be a response; it
    leaves `found`: an angle, a motor's speed, a heater's temperature, one channel of an oscilloscope."""
    angles = [
        k
        for k, label in enumerate(columns.labels)
        if label.part == "phase" and label.unit and columns.moves(k)
    ]
    if len(angles) == 1 and "time" in found:
        return angles[0]
    for name in ("frequency", "temperature", "voltage"):
        speed = name != "frequency" or ("time" in found and not is_hertz(columns.unit(found.get(name, 0))))
        told = name != "frequency" or columns.unit(found.get(name, 0))
        if name in found and speed and told and columns.moves(found[name]):
            return found.pop(name)
    return None


def plausible(columns: Columns, name: str, used: Mapping[str, int]) -> list[int]:
    """Unused columns that may be what a mapping file calls so: of its kind by their units, or without one."""
    parts = {"x": ("x", ""), "y": ("y", "")}.get(name, ("",))
    found = []
    for index, label in enumerate(columns.labels):
        data = (
            label.words
            and not set(label.words[:1]) & COUNTERS
            and not NOT_DATA.search(columns.head.names[index])
        )
        of_kind = label.part in parts and (not label.unit or fits(name, label.unit))
        data = data and columns.holds_data(index)
        if index not in used.values() and data and of_kind and (name != "time" or columns.moves(index)):
            found.append(index)
    return found


def _may_respond(columns: Columns, index: int) -> bool:
    label, name = columns.labels[index], columns.head.names[index]
    data = bool(label.words) and not NOT_DATA.search(name) and not set(label.words[:1]) & COUNTERS
    part = columns.is_circuit or any(
        label.unit and units.same_kind(label.unit, kind) for kind in ("ohm", "S")
    )
    inputs = columns.head.dated(index) or (label.unit and (fits("time", label.unit) or is_hertz(label.unit)))
    data = data and columns.holds_data(index) and not columns.counts(index)
    return data and not part and not inputs and label.part != "phase" and columns.moves(index)


def _named(columns: Columns) -> dict[str, list[int]]:
    """Every column under the name that its head suggests."""
    found: dict[str, list[int]] = {}
    for index, label in enumerate(columns.labels):
        nothing = not (label.words or label.unit) or not columns.holds_data(index)
        if NOT_DATA.search(columns.head.names[index]) or nothing:
            continue
        if name := _name(label, columns.ratio, found, columns.moves(index)):
            found.setdefault(name, []).append(index)
    found = {name: of for name in found if (of := _meant(columns, name, found))}
    if not found.keys() & {
        "frequency",
        "phase",
    }:  # a level, or a heater's power, over time is what it is called
        called = [k for k in found.pop("magnitude", ()) if columns.labels[k].part]
        found |= {"magnitude": called} if called else {}
    # beside a frequency two letters are parts of one signal; three, or over time alone, are directions
    parts = {("x", "y"): ("x", "y")} if "frequency" in found and not _called(columns, "z") else {}
    for pair, names in (LETTER_PAIRS | parts).items():
        both = [_called(columns, word) for word in pair]
        alike = {(columns.unit(k), columns.labels[k].words[:-1]) for of in both for k in of}
        if [len(of) for of in both] == [1, 1] and len(alike) == 1 and not found.keys() & {*names}:
            found |= dict(zip(names, both, strict=True))
    dated = next((k for k, name in enumerate(columns.head.names) if not name and columns.head.dated(k)), None)
    found |= {"time": [dated]} if "time" not in found and dated is not None else {}  # an index without a name
    for name in ("time", "frequency"):
        free = columns.labels and columns.holds_data(0) and not any(0 in of for of in found.values())
        if name not in found and free and fits(name, columns.unit(0)):
            found[name] = [0]
    return found


def _called(columns: Columns, letter: str) -> list[int]:
    """The columns whose last word is a letter."""
    return [k for k, label in enumerate(columns.labels) if label.words[-1:] == (letter,)]


def _meant(columns: Columns, name: str, found: Mapping[str, list[int]]) -> list[int]:
    """The columns of a name that may be meant by it, those called so by a log's names first, and what was
    asked for behind what there was. A voltage may be the drive whatever it is called where nothing is swept:
    of a motor it is the supply."""
    words = {k: {*columns.labels[k].words} for k in found[name]}
    spare = NOT_MEANT.get(name, set()) if "frequency" in found or name != "voltage" else set()
    own = {k: (said := units.parse_name(columns.head.names[k])) and said.quantity == name for k in words}
    meant = [k for k in words if not words[k] & spare]
    return sorted(meant, key=lambda k: (not own[k], bool(words[k] & SECOND)))


def _name(label: Label, ratio: str, found: Mapping[str, list[int]], moving: bool) -> str:
    """What a column is called: an input, or a part of a response, which a column is not whose numbers are all
    the same (not `moving`), nor is it a time."""
    of_ratio = ratio and label.letter(ratio)
    driven = label.part == "magnitude" and {*label.words[:1]} & DRIVEN and fits("voltage", label.unit)
    if (not label.part or driven) and not of_ratio:
        fitting = [
            name for name in INPUTS if label.is_called(name) and (not label.unit or fits(name, label.unit))
        ]
        fitting = [name for name in fitting if name != "time" or moving]
        if fitting:
            return next((name for name in fitting if name not in found), fitting[0])
    if label.part == "phase" or not moving:
        return label.part if moving else ""
    if ratio and label.unit and not is_decibel(label.unit) and not units.is_of(label.unit, ratio):
        return ""
    return label.part or of_ratio or label.letter("")


def _response(columns: Columns, found: Mapping[str, list[int]]) -> dict[str, int]:
    """The columns of a whole response; empty where there is none."""
    if "w" in found and "phase" in found and "magnitude" not in found:
        found = {**found, "magnitude": found["w"]}
    for first, second in _PAIRS:
        if first in found and second in found:
            both = [(a, b) for a in found[first] for b in found[second] if a != b]
            alike = [(a, b) for a, b in both if columns.labels[a].channel == columns.labels[b].channel]
            pair = next(iter(alike or both))
            return {first: pair[0], second: pair[1]}
    sure = {part: [k for k in found.get(part, ()) if _is_half(columns, k)] for part in ("x", "y")}
    for name, indices in (("w", found.get("w")), ("magnitude", found.get("magnitude")), *sure.items()):
        if indices:
            return {name: indices[0]}
    return {}


def _is_half(columns: Columns, index: int) -> bool:
    """Whether a column is one part of two by more than a letter that means other things elsewhere."""
    return bool(columns.labels[index].part) or bool(columns.ratio and columns.unit(index))


def _by_numbers(columns: Columns) -> dict[str, int]:
    """The columns of a file without a header: one that goes on from row to row is a time, or a swept
    frequency; then come a drive of few levels, and a response's two parts or one alone."""
    count = len(columns.labels)
    going = next((index for index in range(count) if columns.rises(index)), None)
    if going is None or len(columns.numbers(going)) < 3:
        return {}
    found = {"time" if _counts_from_zero(columns.numbers(going)) else "frequency": going}
    if count > going + 2 and _is_even(columns.numbers(going)) and _is_even(columns.numbers(going + 1)):
        found = {"time": going, "frequency": going + 1}
    others = [index for index in range(count) if index not in found.values()]
    if "frequency" not in found and len(others) > 1:
        few = [index for index in others if len(np.unique(columns.numbers(index))) <= LEVELS]
        found |= {"voltage": few[0]} if few else {}
    others = [index for index in others if index not in found.values() and columns.moves(index)]
    if len(others) == 2:
        parts = ("magnitude", "phase") if _is_angle(*map(columns.numbers, others)) else ("x", "y")
        return found | dict(zip(parts, others, strict=True))
    one = "magnitude" if "frequency" in found else "w"
    return found | ({one: others[0]} if len(others) == 1 else {})


def _two_traces(columns: Columns, found: Mapping[str, list[int]]) -> dict[str, list[int]]:
    """Two traces that do not say what they show: by their numbers a magnitude and its angle, else two
    parts."""
    inputs = {index for name in ("time", "frequency") for index in found.get(name, ())}
    traces = [index for index in range(len(columns.labels)) if index not in inputs and columns.moves(index)]
    if len(traces) != 2 or any(set(columns.labels[index].words) - SAY_NOTHING for index in traces):
        return {}
    parts = ("magnitude", "phase") if _is_angle(*map(columns.numbers, traces)) else ("x", "y")
    return {part: [index] for part, index in zip(parts, traces, strict=True)}


def _is_even(numbers: np.ndarray) -> bool:
    """Whether they go on by one step, as far as they are written."""
    steps = np.diff(numbers)
    return len(steps) > 1 and bool(steps[0] != 0 and np.ptp(steps) < 0.01 * abs(steps[0]))


def _counts_from_zero(numbers: np.ndarray) -> bool:
    """Whether they begin near zero, as times do, by their own steps."""
    return bool(abs(numbers[0]) <= 2 * abs(numbers[1] - numbers[0]))


def _is_angle(magnitude: np.ndarray, angle: np.ndarray) -> bool:
    """Whether the second numbers look like the degrees that belong to the first."""
    if not len(magnitude) or not len(angle) or np.max(np.abs(angle)) > TURN:
        return False
    one_sign = bool(np.all(magnitude > 0) or np.all(magnitude < 0))
    return one_sign and bool(np.max(np.abs(angle)) > 2 * np.pi) and bool(np.ptp(angle) > 0)
