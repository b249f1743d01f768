"""The columns of another instrument's file: what their heads say, and what their first numbers show."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from statistics import median

import numpy as np

from sysid.columns.labels import RATIOS, Label, counts_days, parse
from sysid.columns.plan import ANGLES, PHASES, per_drive
from sysid.tables import units
from sysid.tables.cells import to_number
from sysid.tables.csvfile import Head
from sysid.tables.densities import is_decibel, shown

LEVELS = 3  # of a drive that is stepped, at most


@dataclass(frozen=True)
class Columns:
    """The columns of a file with what their heads say, and what their first numbers show."""

    head: Head

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """What the head of each column says."""
        return tuple(self._by_numbers(k, parse(self.head.says(k))) for k in range(len(self.head.names)))

    def _by_numbers(self, column: int, label: Label) -> Label:
        """The label of a column in C or F, whose numbers say whether they are degrees: no plate holds a
        coulomb, or has a farad; and of one of dates that are numbers of days."""
        if not label.unit and counts_days(label.text, self.numbers(column)):
            return replace(label, unit="d")
        degrees = {"C": "degC", "F": "degF"}.get(label.unit)
        large = degrees is not None and np.max(np.abs(self.numbers(column)), initial=0.0) >= 1
        return replace(label, unit=degrees) if degrees and large else label

    @cached_property
    def ratio(self) -> str:
        """ "ohm" where the columns hold an impedance, by their units, or R beside X, or |Z|; "S" of an
        admittance; else ""."""
        for of in RATIOS:
            for label in self.labels:
                said = label.unit and not is_decibel(label.unit) and label.unit not in ANGLES
                if said and units.is_of(label.unit, of) and (label.part or label.letter(of)):
                    return of
        bare = [set(label.words) for label in self.labels if not label.unit or label.unit in ANGLES]
        alone = {label.words[0] for label in self.labels if not label.unit and label.words}
        for of, sign, pair, name in (
            ("ohm", "z", {"r", "x"}, "impedance"),
            ("S", "y", {"g", "b"}, "admittance"),
        ):
            parts = [label for label in self.labels if not label.unit and sign in label.words and label.part]
            if (
                (pair <= alone and not (of == "ohm" and "y" in alone))
                or parts
                or any(name in words for words in bare)
            ):
                return of
            if of == "ohm" and "z" in alone:
                return of
        return ""

    @cached_property
    def is_circuit(self) -> bool:
        """Whether an analyser wrote the elements of a circuit, Cp beside D say, which are no response as they
        stand."""
        stated = [label.unit for label in self.labels if label.unit and label.unit not in ANGLES]
        return any(
            units.same_kind(unit, kind) for unit in stated for kind in ("F", "H") if not is_decibel(unit)
        )

    def numbers(self, column: int) -> np.ndarray:
        """Its first numbers, as far as they are any."""
        cells = [row[column] for row in self.head.sample if column < len(row)]
        found = np.array([to_number(cell, str(self.head.dialect.decimal)) for cell in cells] or [np.nan])
        return found[np.isfinite(found)]

    def unit(self, column: int) -> str:
        """The unit as its label states it."""
        return self.labels[column].unit

    def shows(self, column: int) -> str:
        """The unit of the signal that it shows: without its level, its density, or its drive."""
        unit = shown(self.unit(column))
        return (per_drive(unit) or (unit, ""))[0]

    def is_signed(self, column: int) -> bool:
        """Whether some of its numbers are below zero, for another reason than that they are in decibels."""
        found = self.numbers(column)
        return bool(np.any(found < 0) and not is_decibel(self.unit(column)))

    def moves(self, column: int) -> bool:
        """Whether its first numbers are not all the same; of few that is not asked."""
        found = self.numbers(column)
        return len(found) < 3 or bool(np.ptp(found) > 0)

    def holds_data(self, column: int) -> bool:
        """Whether its first rows hold numbers, or dates: no remarks; and it has a name where others have."""
        if any(self.head.names) and not self.head.says(column):
            return False
        return len(self.numbers(column)) > 0 or self.head.dated(column)

    def repeats(self, column: int, other: int | None) -> bool:
        """Whether its first numbers are those of another column, as of a time that each channel has."""
        return other is not None and np.array_equal(self.numbers(column), self.numbers(other))

    def counts(self, column: int) -> bool:
        """Whether it counts rows, frames say: whole numbers that go on by one step."""
        found = self.numbers(column)
        steps = np.diff(found)
        return len(steps) > 2 and bool(steps[0] != 0 and np.all(steps == steps[0]) and np.all(found % 1 == 0))

    def is_held(self, column: int) -> bool:
        """Whether it goes from level to level, as a drive does that is stepped."""
        found = self.numbers(column)
        few = len(np.unique(found)) <= LEVELS
        return len(found) > LEVELS and (few or 2 * self.changes(column) < len(found) - 1)

    def changes(self, column: int) -> int:
        """How often its first numbers change."""
        return int(np.count_nonzero(np.diff(self.numbers(column))))

    def rises(self, column: int) -> bool:
        """Whether its numbers go on in one direction, as times and swept frequencies do."""
        steps = np.diff(self.numbers(column))
        return len(steps) > 0 and bool(np.all(steps > 0) or np.all(steps < 0))

    def step(self, time: int) -> float:
        """Seconds between the first rows; of a column that does not say its unit, as if it held seconds."""
        steps = [after - before for before, after in pairwise(self.numbers(time).tolist())]
        unit = self.unit(time)
        return float(units.convert(median(steps), unit if fits("time", unit) else "s", "s")) if steps else 0.0


def fits(name: str, unit: str) -> bool:
    """Whether a unit is of the kind of what a mapping file calls so."""
    if name == "phase":
        return unit in PHASES
    if name in ("magnitude", "w") and (unit in ANGLES or is_decibel(unit)):
        return is_decibel(unit)
    return units.fits(name, unit)


def is_hertz(unit: str) -> bool:
    """Whether a unit is one of Hz, and not of something per Hz."""
    return unit.endswith("Hz") and "/" not in unit
