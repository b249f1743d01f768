"""The levels of accuracy and what each requires of the posterior; nothing here depends on the machine."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Rung:
    """One level: at least `effective` draws of the worst parameter from Markov chains; 0: the normal
    approximation, without chains. `every_row`: estimates use all rows of the files, where the fit used
    averages."""

    name: str
    effective: int
    every_row: bool


LADDER = (Rung("quick", 0, False), Rung("standard", 1000, False), Rung("exact", 10_000, True))
NAMES = tuple(rung.name for rung in LADDER)


def up_to(name: str) -> tuple[Rung, ...]:
    """The rungs from the first to `name`. Raises ValueError for a name that is none."""
    if name not in NAMES:
        raise ValueError(f"found accuracy {name!r}, expected one of {', '.join(NAMES)}")
    return LADDER[: NAMES.index(name) + 1]


def above(name: str) -> Rung | None:
    """The next rung, None above the last."""
    return next(iter(LADDER[NAMES.index(name) + 1 :]), None)
