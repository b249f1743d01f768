"""One term that a log may hold beside what the model has: a shape to first order and a sentence."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.effects.effect import Effect
from sysid.effects.number import Number

Kind = tuple[str, int | None]  # of effects: their name, and the log that they are in
UNNAMED = ""  # what is said of a size that the logs may show, but that is not what the term is about


@dataclass(frozen=True, eq=False)
class Term:
    """Something left out: `shapes`, of some logs (by position), (n, m) in the unit of the response, complex
    or real."""

    name: str
    shapes: dict[int, np.ndarray] = field(repr=False)
    # of the m coefficients and their standard deviations; None: that makes no sense; UNNAMED
    say: Callable[[np.ndarray, np.ndarray], str | None]
    log: int | None = None  # the one log that it is about
    freedom: int = 1  # numbers that it has, its place on a grid among them
    beside: tuple[str, float] | None = (
        None  # a parameter that it moves besides, by so much for a coefficient of one
    )
    shown_by: str = ""  # what to record so that it shows, where it may hide
    # what every plate has a little of: not one of many things that chance may look like
    expected: bool = False
    # what several logs may have alike, which then do not contradict each other
    alike: bool = False
    # what one log would have for itself, of which few are tried beside all that a log may hold
    between: bool = False
    parts: tuple["Term", ...] = field(
        default=(), repr=False
    )  # of one log each, in place of shapes of its own
    sense: Callable[[np.ndarray], bool] | None = None  # whether `say` of such coefficients is not None
    source: tuple[Effect, int] | None = None  # the effect that it is of, and which of its places
    # by name, of the same as `say`, in units of the bench
    numbers: Callable[[np.ndarray, np.ndarray], dict[str, Number]] = lambda value, std: {}

    @property
    def kind(self) -> Kind:
        """Of which effect it is, and in which log."""
        return self.name, self.log


def together(terms: Sequence[Term]) -> Iterator[Term]:
    """The same thing in several logs at once, in each by what it has: where all are off alike, none
    contradicts the rest."""
    alike: dict[tuple[str, int], list[Term]] = {}
    met: Counter[tuple[str, int]] = Counter()
    for t in terms:
        if t.log is not None:
            alike.setdefault((t.name, met[t.name, t.log]), []).append(t)
            met[t.name, t.log] += 1
    return (_all(parts) for parts in alike.values() if len(parts) > 1)


def _all(parts: Sequence[Term]) -> Term:
    ends = np.cumsum([next(iter(t.shapes.values())).shape[1] for t in parts])[:-1]

    def say(value: np.ndarray, std: np.ndarray) -> str | None:
        each = zip(parts, np.split(value, ends), np.split(std, ends), strict=True)
        said = [t.say(v, s) for t, v, s in each]
        if None in said or UNNAMED in said:
            return None if None in said else UNNAMED
        return f"{said[0]}; and so in {len(said) - 1} other log{'s' if len(said) > 2 else ''}"

    return Term(
        parts[0].name, {}, say, parts[0].log, freedom=sum(t.freedom for t in parts), parts=tuple(parts)
    )


def of_one(i: int, name: str, shape: np.ndarray, sentence: str, alike: bool = False) -> Term:
    """A term of one real number in one log, which is not negative."""

    def say(value: np.ndarray, std: np.ndarray) -> str | None:
        return sentence if value[0] >= 0 else None

    return Term(name, {i: shape[:, None]}, say, i, alike=alike)
