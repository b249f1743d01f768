"""What settings above the rows, or beside them, say of the columns: which is the axis, in which unit, and how
far apart its rows are.

LabVIEW (.lvm) calls the axis X_Value and says above what it is; it may leave its cells empty and state the
step alone, as Rigol does. Tektronix writes settings in the first columns of the rows themselves.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise

from sysid.tables import units
from sysid.tables.cells import is_number, split_line, to_number
from sysid.tables.textfile import LogError

AXIS = "x_value"  # what LabVIEW calls it
DIMENSIONS = {"time": "time_s", "frequency": "frequency_Hz"}  # of an axis, in the units that LabVIEW has
WIDEST = 16  # columns of rows with settings beside them
SETTING = re.compile(r"([A-Za-z]\w*)\s*=\s*([-+.\deE]+)\s*[a-z]*")
HELD = 3  # settings, a name and its value each, at least


def named(lines: Sequence[str], names: Sequence[str], delimiter: str) -> dict[int, str]:
    """The name, with its unit, of a column that settings above it explain and that does not say it itself;
    not where another column bears that name."""
    settings = _settings(lines, delimiter)
    if told := _of_an_oscilloscope(settings, names):
        return told
    said = {word.casefold() for word in settings.get("x_dimension", ())}
    name = DIMENSIONS.get(said.pop(), "") if len(said) == 1 else ""
    axes = [k for k, column in enumerate(names) if column.casefold() == AXIS]
    others = (units.parse_name(column) for column in names)
    if not (name and axes) or any(other and name.startswith(other.quantity) for other in others):
        return {}
    return {axes[0]: name}


def _of_an_oscilloscope(settings: Mapping[str, Sequence[str]], names: Sequence[str]) -> dict[int, str]:
    """The same of a column TIME and of channels, whose units Tektronix states above them, one for each, or
    one."""
    axes = [k for k, column in enumerate(names) if column.casefold() == "time"]
    across, up = (settings.get(f"{way} units", ()) for way in ("horizontal", "vertical"))
    if len(axes) != 1 or len({*across}) != 1:
        return {}
    channels = [k for k, column in enumerate(names) if column and k not in axes]
    each = up if len(up) == len(channels) else [*up] * len(channels) if len({*up}) == 1 else ()
    stated = {axes[0]: across[0], **dict(zip(channels, each, strict=False))}
    return {k: f"{names[k]} [{unit}]" for k, unit in stated.items()}


def sample_rate(
    path: str, lines: Sequence[str], told: Mapping[int, str], row: Sequence[str], delimiter: str, decimal: str
) -> str:
    """The sample rate (Hz), where the axis that is `told` is a time whose first cell is empty, and the step
    of its rows stands above; else "". Raises LogError where channels have different ones."""
    settings = _settings(lines, delimiter)
    empty = [
        k for k, name in told.items() if name == DIMENSIONS["time"] and not "".join(row[k : k + 1]).strip()
    ]
    if not empty or "delta_x" not in settings:
        return ""
    for key in ("x0", "delta_x"):
        if len(apart := sorted({to_number(cell, decimal) for cell in settings.get(key, ())})) > 1:
            found = f"found channels whose {key} is {apart[0]:g} and {apart[-1]:g}"
            raise LogError(f"{path}: {found}, expected one clock for all; save an X column (X_Columns One)")
    step = to_number(settings["delta_x"][0], decimal)
    return f"{1 / step:.12g}" if step > 0 else ""


def stated_at_end(names: tuple[str, ...]) -> tuple[tuple[str, ...], str, str]:
    """The names of a header without settings at its end, `t0 = -1e-3, tInc = 1e-6` as of Rigol, the sample
    rate (Hz) that they state, and a note on it; of any other all names, and two empty texts."""
    kept = [k for k, name in enumerate(names, 1) if name and not SETTING.fullmatch(name)]
    settings = (SETTING.fullmatch(name) for name in names[max(kept, default=len(names)) :])
    step = {one[1].casefold(): to_number(one[2]) for one in settings if one}.get("tinc", 0.0)
    if not step > 0:
        return names, "", ""
    return names[: max(kept)], f"{1 / step:.12g}", f"sampled every {step:g} s, as tInc says in the header"


def beside(lines: Sequence[str], delimiter: str) -> dict[int, str]:
    """The names, with units, of the two columns of rows that have settings beside them; empty of any other.

    The first column holds names or nothing, the second their values; two behind them hold numbers in every
    row, of which the first rise."""
    first = split_line(lines[0], delimiter)
    if is_number(first[0]) or not any(map(is_number, first[2:WIDEST])):
        return {}
    rows = [split_line(line, delimiter) for line in lines if line.strip()]
    width = min(map(len, rows), default=0)
    stated = {row[0].strip().casefold(): row[1].strip() for row in rows if width > 3 and row[0].strip()}
    full = [k for k in range(min(width, WIDEST)) if all(is_number(row[k]) for row in rows)]
    if len(stated) < HELD or any(map(is_number, stated)) or len(full) != 2 or full[0] < 2:
        return {}
    axis = [to_number(row[full[0]]) for row in rows]
    if not all(after > before for before, after in pairwise(axis)):
        return {}
    units_of = (stated.get(key, "") for key in ("horizontal units", "vertical units"))
    said = zip(full, ("time", "value"), units_of, strict=True)
    return {place: f"{name} [{unit}]" if unit else name for place, name, unit in said}


def _settings(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """Lines of a name and values, those that hold something; of a name that stands again the last."""
    cells = ([cell.strip() for cell in split_line(line, delimiter)] for line in lines)
    return {row[0].casefold(): filled for row in cells if row and (filled := [*filter(None, row[1:])])}
