"""What is read from a file: a source for each quantity, and the plan of all."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sysid.tables import units

# standard errors of a response, or of d and of q, which count as one: their mean square is both's
ERRORS = ("std", "std_q")
# of columns that number experiments
SPLITS = ("log", "chunk", "sweep", "run", "segment", "block", "experiment")
ANGLES = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}
# of a column that is called a phase: a displacement may be in mrad
PHASES = ANGLES | {"mrad": 1e-3, "urad": 1e-6, "mdeg": math.pi / 180e3}
PHASES |= dict.fromkeys(("turn", "turns", "cycle", "cycles"), 2 * math.pi) | {"gon": math.pi / 200}


def in_gravity(unit: str) -> str:
    """The unit of an acceleration, in g, mg, g^2/Hz or dB:g/V as well: for the library of units a g is a
    gram."""
    return re.sub(r"(^|:)([muµ]?)g(?=$|[/^])", r"\1\2g_0", unit)


def of_gravity(unit: str) -> tuple[str, str]:
    """A unit of an acceleration in g and what is behind it, as /V; "" of any other."""
    found = re.match(r"[muµ]?g_0(?=$|/)", unit)
    return (found[0], unit[found.end() :]) if found else ("", unit)


@dataclass(frozen=True)
class Source:
    """Where a quantity comes from: (column's number or constant) * scale + offset, in `unit`."""

    label: str
    unit: str
    amplitude: str = "peak"
    column: int | None = None
    constant: float = 0.0
    scale: float = 1.0
    offset: float = 0.0
    dated: bool = False  # the column holds dates, read as seconds since the first
    # the column does not bear the quantity's name, and is kept out where its dates do not serve
    spare: bool = False
    written: str = ""  # the constant, as text
    counted: bool = False  # no column and no constant: the row's number, from 0 on


@dataclass(frozen=True)
class Plan:
    """How one file becomes logs: the sources of the quantities, and what was said about the whole."""

    sources: dict[str, Source]
    metadata: dict[str, str]
    split: int | None = None
    rows: Any = None
    quantity: str = "displacement"
    phase_sign: int = 1  # 0: that by which the phase falls with the frequency
    phase_offset: float = 0.0  # rad
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    taken: tuple[str, ...] = ()  # what a mapping file may say, and nothing does: taken as usual


def per_drive(unit: str) -> tuple[str, str] | None:
    """The units of the signal and of the drive where one is stated by the other: um and V of um/V, A and V of
    S, V and A of ohm; None of any other unit."""
    signal, _, drive = unit.rpartition("/")
    if re.fullmatch(r"[pnuµmkM]?[VNA]", drive) and units.is_known(signal) and not units.is_of(unit, "ohm"):
        return signal, drive
    named = re.search(
        r"S|siemens|mho|ohm|V/", unit
    )  # only of these the library is asked, which takes its time
    ratios = {"S": ("A", "V"), "ohm": ("V", "A")} if named else {}
    return next((of for ratio, of in ratios.items() if units.is_of(unit, ratio)), None)


def is_absent(quantity: str, sources: Mapping[str, Source]) -> bool:
    """Whether nothing states an input, of which there is one drive."""
    return not sources.keys() & ({*units.DRIVES} if quantity in units.DRIVES else {quantity})


def drive_as(options: Mapping[str, Any], sources: Mapping[str, Source]) -> list[str]:
    """A note on a drive beside a mapping file's `amplitude` of rms or pp: it holds of a column that says
    nothing itself, and not of a constant, which is peak unless its unit says otherwise."""
    name = next((name for name in ("voltage", "drive") if name in sources), None)
    said = options.get("amplitude", "peak")
    if name is None or said == "peak":
        return []
    source, entry = sources[name], options.get("columns", {}).get(name, {})
    if source.column is None and source.amplitude == "peak":
        return [f"the constant {name} is taken as peak; write V_{said}, say, where it is {said}"]
    if source.column is None or "amplitude" in entry or source.amplitude != said:
        return []
    return [
        f"the {name} in column {source.label} is taken as {said}, as amplitude says of drive and response;"
        f' say amplitude = "peak" in its entry where it is'
    ]
