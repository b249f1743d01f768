"""The operations of a step in fixed point, each in C and in Python: words in, one word or condition out.

Each is `c()` as an expression of C, where `dq_word` is a word and `dq_wide` twice as wide; and in Python what `run` gives, of the
words made before it (`values`) and those of the `state`, all within +-`top`. An argument is the name of a value, or a number.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeAlias

import numpy as np

Argument: TypeAlias = int | str
MISSING = "DQ_MISSING"  # the word of a measurement that is not there
COMPARE = {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal}


def value(values: Mapping[str, Any], argument: Argument) -> Any:
    """The number, or the value of that name."""
    return values[argument] if isinstance(argument, str) else argument


def fit(x: Any, shift: int, top: int) -> Any:
    """x 2^-shift, to the nearest and halves away from zero, within +-top."""
    if shift:
        x = (x + ((1 << shift - 1) - (x < 0))) >> shift
    return np.minimum(np.maximum(x, -top), top)


def _times(argument: Argument, factor: int) -> str:
    wide = f"(dq_wide){argument}" if isinstance(argument, str) else f"(dq_wide)({argument})"
    return wide if factor == 1 else f"{wide} * {factor}"


@dataclass(frozen=True)
class Load:
    """A number of the state, loaded before anything is written."""

    field: str
    kind: ClassVar[str] = "loads"

    def c(self) -> str:
        return f"s->{self.field}"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return state[self.field]


@dataclass(frozen=True)
class Sum:
    """(a up + b more) 2^-shift; with b = 0 a change of scale."""

    a: Argument
    up: int
    b: Argument
    more: int
    shift: int
    kind: ClassVar[str] = "additions and scalings"

    def c(self) -> str:
        second = "" if self.more == 0 else f" {'+' if self.more > 0 else '-'} {_times(self.b, abs(self.more))}"
        return f"dq_fit({_times(self.a, self.up)}{second}, {self.shift})"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return fit(value(values, self.a) * self.up + value(values, self.b) * self.more, self.shift, top)


@dataclass(frozen=True)
class Product:
    """a b 2^-shift."""

    a: Argument
    b: Argument
    shift: int
    kind: ClassVar[str] = "multiplications"

    def c(self) -> str:
        return f"dq_fit({_times(self.a, 1)} * {self.b}, {self.shift})"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return fit(value(values, self.a) * value(values, self.b), self.shift, top)


@dataclass(frozen=True)
class Ratio:
    """a up / b, its fraction cut off, within +-most; b below one counts as one."""

    a: Argument
    b: Argument
    up: int
    most: int
    kind: ClassVar[str] = "divisions"

    def c(self) -> str:
        return f"dq_ratio({_times(self.a, self.up)}, {self.b}, {self.most})"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        a, b = value(values, self.a) * self.up, np.maximum(value(values, self.b), 1)
        return np.clip(np.where(a >= 0, a // b, -(-a // b)), -self.most, self.most)


@dataclass(frozen=True)
class Floor:
    """The largest whole number that is not above a 2^-point."""

    a: Argument
    point: int
    kind: ClassVar[str] = "floors"

    def c(self) -> str:
        return f"dq_floor({self.a}, {self.point})"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return value(values, self.a) >> self.point


@dataclass(frozen=True)
class Compare:
    """Whether a up is less than, ... b more."""

    sign: str
    a: Argument
    up: int
    b: Argument
    more: int
    kind: ClassVar[str] = "comparisons and selections"

    def c(self) -> str:
        return f"{_times(self.a, self.up)} {self.sign} {_times(self.b, self.more)}"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return COMPARE[self.sign](value(values, self.a) * self.up, value(values, self.b) * self.more)


@dataclass(frozen=True)
class Logic:
    """Both, or either."""

    sign: str
    a: Argument
    b: Argument
    kind: ClassVar[str] = "comparisons and selections"

    def c(self) -> str:
        return f"{self.a} {self.sign} {self.b}"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        both = np.logical_and if self.sign == "&&" else np.logical_or
        return both(value(values, self.a), value(values, self.b))


@dataclass(frozen=True)
class Not:
    """Not a."""

    a: Argument
    kind: ClassVar[str] = "comparisons and selections"

    def c(self) -> str:
        return f"!{self.a}"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return np.logical_not(value(values, self.a))


@dataclass(frozen=True)
class Seen:
    """Whether none of the words is the one that says missing."""

    names: tuple[str, ...]
    kind: ClassVar[str] = "comparisons and selections"

    def c(self) -> str:
        return " && ".join(f"{name} != DQ_MISSING" for name in self.names)

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        there = value(values, self.names[0]) != -top - 1
        for name in self.names[1:]:
            there = there & (value(values, name) != -top - 1)
        return there


@dataclass(frozen=True)
class Select:
    """a where the condition holds, else b."""

    condition: str
    a: Argument
    b: Argument
    kind: ClassVar[str] = "comparisons and selections"

    def c(self) -> str:
        return f"{self.condition} ? {self.a} : {self.b}"

    def run(self, values: Mapping[str, Any], state: Mapping[str, Any], top: int) -> Any:
        return np.where(value(values, self.condition), value(values, self.a), value(values, self.b))


Operation: TypeAlias = Load | Sum | Product | Ratio | Floor | Compare | Logic | Not | Seen | Select


def uses(made: Operation) -> set[str]:
    """Names of the values that it is made from."""
    given = [getattr(made, f.name) for f in fields(made) if f.name not in ("field", "sign")]
    each = (v if isinstance(v, tuple) else (v,) for v in given)
    return {name for names in each for name in names if isinstance(name, str)}
