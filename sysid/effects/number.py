"""Numbers of effects, in units of the bench."""

from typing import NamedTuple


class Number(NamedTuple):
    """A fitted number of an effect, in a unit of the bench."""

    value: float
    std: float
    unit: str

    def __abs__(self) -> "Number":
        return self._replace(value=abs(self.value))

    def __format__(self, form: str) -> str:
        """Value and error as people write them; a form that ends in % is one of percent.

        >>> f"{Number(1.234, 0.0312, 's'):.3g} s, {Number(0.05, 0.002, '1'):+.2g%}"
        '1.23 ± 0.03 s, +5 ± 0.2 %'
        """
        per, unit = (100, " %") if form.endswith("%") else (1, "")
        return f"{per * self.value:{form.removesuffix('%')}} ± {pm(per * self.std)}{unit}"


def number(value: float, std: float, unit: str, per: float = 1.0) -> Number:
    """Of plain floats, of which one is `per` of the unit."""
    return Number(float(value) * per, float(std) * per, unit)


def pm(std: float) -> str:
    """An error to one digit, as people write it.

    >>> pm(43.2), pm(0.0312), pm(1280.0)
    ('40', '0.03', '1000')
    """
    return f"{float(f'{std:.1g}'):.6g}"
