"""A step in fixed point: recorded operation by operation in words of 16 or 32 bits, written as C and run in Python alike.

Each value has a range, propagated through the step from the ranges of inputs and state, and from it a scale of its own, a power
of two: a word n stands for n 2^-point. Sums and products are formed in twice the width, rounded to the nearest (halves away from
zero) and saturated at +-(2^(bits-1) - 1). The remaining word, -2^(bits-1), stands for a missing measurement. No operation
overflows, whatever comes in, and none depends on how C rounds or shifts negative numbers.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from controller import operations as op
from controller.operations import MISSING
from controller.scalar import NO_LIMIT, Span
from controller.symbols import Symbol
from controller.twin import Twin

NOBODY: frozenset[str] = frozenset()


class Known(NamedTuple):
    """Of a value: its range, its scale, and the measurements without which it is none; of a condition: which measurements are
    there when it holds, and the two values that it compares."""

    span: Span
    point: int
    missing: frozenset[str] = NOBODY
    present: frozenset[str] = NOBODY
    compares: tuple[str, Any, Any] | None = None


class FixedRecord:
    """Stands in for `xp`: what a step does to symbols becomes operations on words of `bits` bits, each operation once.

    A symbol's range [low, high] follows from those of its parts by interval arithmetic; its word is n = round(x 2^point), with
    point = floor(log2(top / max(|low|, |high|))) and top = 2^(bits-1) - 1, so that it is rounded by max(|low|, |high|) / top at
    most. `quotient` is the size at which a quotient of two values saturates.
    """

    def __init__(self, bits: int, quotient: float | None = None):
        self.bits, self.quotient = bits, quotient
        self.top = 2 ** (bits - 1) - 1
        self.made: dict[str, op.Operation] = {}
        self._known: dict[str, Known] = {}
        self._names: dict[op.Operation, str] = {}

    @property
    def nan(self) -> Symbol:
        """What stands for a measurement that is none."""
        return Symbol(self, MISSING, False)

    def input(self, text: str, span: Span, missing: bool = False, point: int | None = None) -> Symbol:
        """A word from outside, of scale `point` or the finest; `missing`: it may be the one that says so."""
        at = self.point(span) if point is None else point
        self._known[text] = Known(span, at, frozenset([text]) if missing else NOBODY)
        return Symbol(self, text, False)

    def flag(self, text: str) -> Symbol:
        """A condition from outside."""
        self._known[text] = Known(Span(0.0, 1.0), 0)
        return Symbol(self, text, True)

    def load(self, field: str, span: Span) -> Symbol:
        """A number of the state."""
        return self._make(op.Load(field), Known(span, self.point(span)))

    def point(self, span: Span) -> int:
        """The finest scale at which the range fits into a word."""
        most = max(abs(span.low), abs(span.high))
        return math.floor(math.log2(self.top / most)) if most else 0

    def word(self, value: float, point: int) -> int:
        """The word of a plain number, saturated."""
        return int(max(-self.top, min(self.top, round(math.ldexp(value, point)))))

    def known(self, x: Symbol) -> Known:
        """Range and scale of a symbol that was made here."""
        return self._known[x.text]

    def fitted(self, x: Any, point: int) -> int | str:
        """x, a symbol or a number, as a word of the scale `point`."""
        if not isinstance(x, Symbol):
            return int(x) if isinstance(x, bool) else self.word(x, point)
        if x.text == MISSING or x.condition or (k := self.known(x)).point == point:
            return x.text
        made = self.made.get(x.text)
        if isinstance(made, op.Select) and made.a == MISSING:
            there = self.fitted(Symbol(self, str(made.b), False), point)
            return self._make(op.Select(made.condition, MISSING, there), k._replace(point=point)).text
        up = max(point - k.point, 0)
        if up > self.bits - 2:
            raise ValueError(f"found a value whose scale is 2^{up} from the one that is asked for, expected less than a word")
        return self._make(op.Sum(x.text, 1 << up, 0, 0, max(k.point - point, 0)), k._replace(point=point)).text

    def binary(self, sign: str, a: Any, b: Any) -> Any:
        """a `sign` b of symbols or numbers, not both numbers, in the range that theirs allow and the finest scale that holds it,
        no finer than theirs. Sums are formed exactly in twice the width and rounded once. Raises ValueError for a number that
        would be lost in what it is added to, and for a division without a bound."""
        if sign == "*":
            return self._product(a, b)
        if sign == "/":
            return self._quotient(a, b)
        if not isinstance(b, Symbol) and b == 0.0:
            return a
        if not isinstance(a, Symbol) and a == 0.0 and sign == "+":
            return b
        (x, ka), (y, kb) = self._aligned(a, b)
        turn = 1 if sign == "+" else -1
        ends = (kb.span.low, kb.span.high) if sign == "+" else (-kb.span.high, -kb.span.low)
        span = Span(ka.span.low + ends[0], ka.span.high + ends[1])
        common = max(ka.point, kb.point)
        point = min(self.point(span), common)
        for plain in (a, b):
            if not isinstance(plain, Symbol) and plain and self.word(plain, point) == 0:
                raise ValueError(f"found {plain:.3g} added to what goes up to {max(map(abs, span)):.3g}, expected a longer word")
        made = op.Sum(x, 1 << common - ka.point, y, turn * (1 << common - kb.point), common - point)
        return self._make(made, Known(span, point, ka.missing | kb.missing))

    def negative(self, a: Symbol) -> Any:
        """-a, which no word is too small for: -2^(bits-1) is no number."""
        return self.binary("-", 0.0, a)

    def compared(self, sign: str, a: Symbol, b: Any) -> Any:
        """The condition a `sign` b, exact: both are brought to the finer of the two scales in twice the width. One that the limit
        NO_LIMIT decides is a bool and costs nothing."""
        if (limit := self._of(b).span).low >= NO_LIMIT / 2 or limit.high <= -NO_LIMIT / 2:  # no limit: a is within it
            return (limit.low > 0) == (sign in ("<", "<="))
        (x, ka), (y, kb) = self._aligned(a, b)
        common = max(ka.point, kb.point)
        made = op.Compare(sign, x, 1 << common - ka.point, y, 1 << common - kb.point)
        return self._make(made, Known(Span(0.0, 1.0), 0, compares=(sign, a, b)), condition=True)

    def logic(self, sign: str, a: Symbol, b: Symbol) -> Symbol:
        """Both or either of two conditions; both of two that say that measurements are there say it of all."""
        both = self.known(a).present | self.known(b).present if sign == "&&" else NOBODY
        return self._make(op.Logic(sign, a.text, b.text), Known(Span(0.0, 1.0), 0, present=both), condition=True)

    def where(self, condition: Any, yes: Any, no: Any) -> Any:
        """`yes` where the condition holds, else `no`, in one scale. Where the condition compares just these two, the range is
        that of the larger or the smaller one."""
        if isinstance(condition, bool):
            return yes if condition else no
        if all(isinstance(v, bool) or (isinstance(v, Symbol) and v.condition) for v in (yes, no)):
            made = op.Select(condition.text, self.fitted(yes, 0), self.fitted(no, 0))
            return self._make(made, Known(Span(0.0, 1.0), 0), condition=True)
        if isinstance(yes, Symbol) and yes.text == MISSING:
            after = self._make(op.Select(condition.text, MISSING, no.text), self.known(no))
            self._known[after.text] = self.known(no)._replace(missing=frozenset([after.text]))
            return after
        ka, kb = self._of(yes), self._of(no)
        span = self._chosen(condition, yes, no) or Span(min(ka.span.low, kb.span.low), max(ka.span.high, kb.span.high))
        point = self.point(span)
        scales = [self.known(v).point for v in (yes, no) if isinstance(v, Symbol)]
        point = min(point, max(scales)) if scales else point
        missing = (ka.missing - self.known(condition).present) | kb.missing
        made = op.Select(condition.text, self.fitted(yes, point), self.fitted(no, point))
        return self._make(made, Known(span, point, missing))

    def isfinite(self, x: Any) -> Any:
        """Whether all that x was made from is there."""
        names = self.known(x).missing if isinstance(x, Symbol) else NOBODY
        if not names:
            return True
        return self._make(op.Seen(tuple(sorted(names))), Known(Span(0.0, 1.0), 0, present=names), condition=True)

    def logical_not(self, x: Any) -> Any:
        """The condition turned round."""
        return not x if isinstance(x, bool) else self._make(op.Not(x.text), Known(Span(0.0, 1.0), 0), condition=True)

    def floor(self, x: Symbol) -> Symbol:
        """The largest whole number that is not above x: its scale is that of whole numbers."""
        k = self.known(x)
        span = Span(math.floor(k.span.low), math.floor(k.span.high))
        return self._make(op.Floor(x.text, max(k.point, 0)), Known(span, min(k.point, 0), k.missing))

    def twin(
        self, first: Mapping[str, Any], then: Mapping[str, Any], output: Mapping[str, Any], states: dict[str, int],
        points: dict[str, int],
    ) -> Twin:  # fmt: skip
        """The operations without which the next state and the output could not be had, as they run in Python. By name: `first`,
        the state at the beginning, as numbers; `then` and `output`, symbols or numbers; their scales, `states` and `points`."""
        after = {name: self.fitted(value, states[name]) for name, value in then.items()}
        said = {name: self.fitted(value, points[name]) for name, value in output.items()}
        wanted, kept = {*after.values(), *said.values()}, []
        for name, made in reversed(self.made.items()):
            if name in wanted:
                wanted |= op.uses(made)
                kept.append((name, made))
        begun = {name: self.word(float(value), states[name]) for name, value in first.items()}
        return Twin(self.bits, dict(reversed(kept)), begun, after, said, states, points)

    def _make(self, made: op.Operation, known: Known, condition: bool = False) -> Symbol:
        if made not in self._names:
            name = f"{'c' if condition else 'x'}{len(self.made)}"
            self._names[made], self.made[name], self._known[name] = name, made, known
        return Symbol(self, self._names[made], condition)

    def _of(self, x: Any) -> Known:
        """Of a symbol; of a plain number, at its finest scale with no bits to spare."""
        if isinstance(x, Symbol):
            return self.known(x)
        if x == 0:
            return Known(Span(0.0, 0.0), 0)
        point = self.point(Span(x, x))
        n = self.word(x, point)
        spare = min((n & -n).bit_length() - 1, max(point, 0))
        value = math.ldexp(n, -point)
        return Known(Span(value, value), point - spare)

    def _aligned(self, a: Any, b: Any) -> tuple[tuple[int | str, Known], tuple[int | str, Known]]:
        """Both as words, scaled near enough to each other that twice the width holds what is done to them."""
        ka, kb = self._of(a), self._of(b)
        if not isinstance(a, Symbol) and a == 0.0:
            ka = ka._replace(point=kb.point)
        if not isinstance(b, Symbol) and b == 0.0:
            kb = kb._replace(point=ka.point)
        most = min(ka.point, kb.point) + self.bits - 2
        ka, kb = (k._replace(point=min(k.point, most)) for k in (ka, kb))
        return (self.fitted(a, ka.point), ka), (self.fitted(b, kb.point), kb)

    def _product(self, a: Any, b: Any) -> Any:
        for plain, other in ((a, b), (b, a)):
            if not isinstance(plain, Symbol) and plain in (0.0, 1.0):
                return other if plain else 0.0
        ka, kb = self._of(a), self._of(b)
        ends = [x * y for x in ka.span for y in kb.span]
        squared = isinstance(a, Symbol) and isinstance(b, Symbol) and a.text == b.text
        span = Span(0.0 if squared and min(ends) < 0 else min(ends), max(ends))
        point = min(self.point(span), ka.point + kb.point)
        made = op.Product(self.fitted(a, ka.point), self.fitted(b, kb.point), ka.point + kb.point - point)
        return self._make(made, Known(span, point, ka.missing | kb.missing))

    def _quotient(self, a: Any, b: Symbol) -> Symbol:
        """To one unit of its last place, for b > 0; saturated where it is larger than `quotient`, or b is not above zero."""
        if self.quotient is None:
            raise ValueError("found a division, expected a control without one, or a bound for its quotient")
        ka, kb = self._of(a), self.known(b)
        span = Span(-self.quotient, self.quotient)
        point = min(self.point(span), self.bits - 2 + ka.point - kb.point)
        at = min(ka.point, point + kb.point)
        made = op.Ratio(self.fitted(a, at), b.text, 1 << point + kb.point - at, self.word(self.quotient, point))
        return self._make(made, Known(span, point, ka.missing | kb.missing))

    def _chosen(self, condition: Symbol, yes: Any, no: Any) -> Span | None:
        """The range of the larger or the smaller of two, which is narrower than that of either."""
        sign, a, b = self.known(condition).compares or (None, None, None)
        if sign not in ("<", ">"):
            return None
        straight = _same(yes, a) and _same(no, b)
        if not straight and not (_same(yes, b) and _same(no, a)):
            return None
        x, y = self._of(a).span, self._of(b).span
        pick = min if (sign == "<") == straight else max
        return Span(pick(x.low, y.low), pick(x.high, y.high))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, Symbol) and isinstance(b, Symbol):
        return a.text == b.text
    return not isinstance(a, Symbol) and not isinstance(b, Symbol) and a == b
