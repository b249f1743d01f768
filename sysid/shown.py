"""Results that show themselves: `repr` in a terminal, HTML in a notebook. What they say is made in
`sysid.report.brief`."""

from typing import Any


class Shown:
    """A result with a short `repr` and `_repr_html_`, both made from one `Brief`. Abstract."""

    __slots__ = ()

    def _brief(self) -> Any:
        """What there is to show, a `sysid.report.brief.Brief`."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._brief().text()

    def _repr_html_(self) -> str:
        return self._brief().html()
