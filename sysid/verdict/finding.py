"""A `Finding`: one thing that logs show besides plant, bench and noise, as data, of which sentences are
made."""

from dataclasses import dataclass, field

from sysid.effects.number import Number

PAGE = "docs/errors.md"  # with an entry for each key


@dataclass(frozen=True)
class Finding:
    """What was found in the logs called `logs` (none: in all together), by the name of the effect or of the
    check that found it.

    `outcome`: "fitted", the fit contains it, with its `numbers`; "widened", the errors span it; "refused",
    the fit is a misfit by it; "noted", it moves no parameter out of its interval, or may be chance.
    `evidence`: log evidence or, to first order, log likelihood that it gains. `moves`: by parameter, how far
    including it would move the estimate, in its standard deviations. `mostly`: it is most of a log, of which
    the model then tells nothing.
    """

    key: str
    outcome: str
    sentence: str
    logs: tuple[str, ...] = ()
    numbers: dict[str, Number] = field(default_factory=dict)
    evidence: float | None = None
    moves: dict[str, float] = field(default_factory=dict)
    mostly: bool = False


@dataclass(frozen=True)
class Assumed:
    """What logs would not show, and what would; the largest `size` of it that they would not, and what that
    would move far, by how much: G and tau by a share, f0 by Hz."""

    key: str
    logs: tuple[str, ...]
    shown_by: str
    size: Number
    moves: dict[str, float]


def entry(key: str) -> str:
    """Where the documentation has the entry of a finding's key."""
    return f"{PAGE}#{key.replace(' ', '-')}"
