"""A step recorded instead of computed: the operations that a controller applies to symbols become its C code.

The record is of the same arithmetic that runs in Python, operation by operation, so what is tested is what is exported. It has no
loop, no branch and no memory but the state, and a known number of operations.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any


class Record:
    """Operations in order, as lines of C, each value once. Stands in for `xp`."""

    def __init__(self, number: Callable[[float], str]):
        self.number = number
        self._made: dict[str, tuple[str, str]] = {}  # by name: operation, line
        self._known: dict[str, Symbol] = {}

    @property
    def nan(self) -> "Symbol":
        """What stands for a measurement that is none."""
        return Symbol(self, "DQ_MISSING", False)

    def input(self, text: str) -> "Symbol":
        """A value from outside."""
        return Symbol(self, text, False)

    def flag(self, text: str) -> "Symbol":
        """A condition from outside."""
        return Symbol(self, text, True)

    def text(self, value: Any) -> str:
        """How C writes a symbol, a condition or a number."""
        if isinstance(value, Symbol):
            return value.text
        return str(int(value)) if isinstance(value, bool) else self.number(float(value))

    def made(self, operation: str, expression: str, condition: bool = False) -> "Symbol":
        if expression not in self._known:
            name = f"{'c' if condition else 'x'}{len(self._made)}"
            self._made[name] = (operation, f"const {'int' if condition else 'dq_real'} {name} = {expression};")
            self._known[expression] = Symbol(self, name, condition)
        return self._known[expression]

    def needed(self, results: Iterable[str]) -> tuple[list[str], Counter[str]]:
        """The lines without which `results` could not be had, in order, and how many of each operation they are."""
        wanted = set(results)
        kept = []
        for name, (operation, line) in reversed(self._made.items()):
            if name in wanted:
                wanted |= set(re.findall(r"\b[xc]\d+\b", line))
                kept.append((operation, line))
        return [line for _, line in reversed(kept)], Counter(operation for operation, _ in kept)

    def binary(self, sign: str, a: Any, b: Any) -> "Symbol":
        return self.made(sign, f"{self.text(a)} {sign} {self.text(b)}")

    def negative(self, a: "Symbol") -> "Symbol":
        return self.made("-", f"-{a.text}")

    def compared(self, sign: str, a: "Symbol", b: Any) -> "Symbol":
        return self.made(sign, f"{a.text} {sign} {self.text(b)}", True)

    def logic(self, sign: str, a: "Symbol", b: "Symbol") -> "Symbol":
        return self.made("logic", f"{a.text} {sign} {b.text}", True)

    def where(self, condition: Any, yes: Any, no: Any) -> Any:
        if isinstance(condition, bool):
            return yes if condition else no
        boolean = all(isinstance(v, bool) or (isinstance(v, Symbol) and v.condition) for v in (yes, no))
        return self.made("select", f"{condition.text} ? {self.text(yes)} : {self.text(no)}", boolean)

    def isfinite(self, x: Any) -> Any:
        return self.made("test", f"isfinite({x.text})", True) if isinstance(x, Symbol) else x - x == 0.0

    def logical_not(self, x: Any) -> Any:
        return not x if isinstance(x, bool) else self.made("logic", f"!{x.text}", True)

    def floor(self, x: Any) -> Any:
        return self.made("floor", f"dq_floor({x.text})")


class Symbol:
    """A value, or a condition, of a record, which makes what is done to it."""

    __hash__ = None  # type: ignore[assignment]  # what is equal is a question for the machine that runs the record

    def __init__(self, record: Any, text: str, condition: bool):
        self.record, self.text, self.condition = record, text, condition

    def __bool__(self) -> bool:
        raise TypeError("found a branch on a value that is known only when the step runs, expected xp.where")

    def __add__(self, other):
        return self.record.binary("+", self, other)

    def __radd__(self, other):
        return self.record.binary("+", other, self)

    def __sub__(self, other):
        return self.record.binary("-", self, other)

    def __rsub__(self, other):
        return self.record.binary("-", other, self)

    def __mul__(self, other):
        return self.record.binary("*", self, other)

    def __rmul__(self, other):
        return self.record.binary("*", other, self)

    def __truediv__(self, other):
        return self.record.binary("/", self, other)

    def __rtruediv__(self, other):
        return self.record.binary("/", other, self)

    def __neg__(self):
        return self.record.negative(self)

    def __lt__(self, other):
        return self.record.compared("<", self, other)

    def __le__(self, other):
        return self.record.compared("<=", self, other)

    def __gt__(self, other):
        return self.record.compared(">", self, other)

    def __ge__(self, other):
        return self.record.compared(">=", self, other)

    def __eq__(self, other):
        return self.record.compared("==", self, other)

    def __ne__(self, other):
        return self.record.compared("!=", self, other)

    def __and__(self, other):
        if isinstance(other, bool):
            return self if other else False
        return self.record.logic("&&", self, other)

    __rand__ = __and__

    def __or__(self, other):
        if isinstance(other, bool):
            return True if other else self
        return self.record.logic("||", self, other)

    __ror__ = __or__
