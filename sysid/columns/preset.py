"""Presets: mapping files that ship with the package, one for each kind of file that an instrument writes.

`presets/index.toml` says of each what it is for, by what its files are recognised, and what it assumes that
no file tells; `presets/NAME.toml` is the mapping file."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from sysid.tables import units
from sysid.tables.csvfile import Head

FOLDER = Path(__file__).parent / "presets"
PREFIX = "preset:"


@dataclass(frozen=True)
class Preset:
    """One kind of file. `instrument`: what comments call it. `recognised`: patterns, one of which is found in
    a line above the rows of its files, the header among them. `assumed`: keys whose values are usual, and no
    fact of the file."""

    name: str
    title: str
    instrument: str
    recognised: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    also: tuple[str, ...] = field(default=(), repr=False)  # other names

    @property
    def text(self) -> str:
        """The mapping file."""
        return (FOLDER / f"{self.name}.toml").read_text(encoding="utf-8")

    @property
    def options(self) -> dict[str, Any]:
        """What the mapping file says."""
        return tomllib.loads(self.text)

    def wrote(self, lines: Iterable[str]) -> bool:
        """Whether lines above the rows of a file are those of this kind."""
        return any(re.search(pattern, line) for line in lines for pattern in self.recognised)


@cache
def presets() -> dict[str, Preset]:
    """All presets by their names."""
    index = tomllib.loads((FOLDER / "index.toml").read_text(encoding="utf-8"))
    several = ("recognised", "assumed", "also")
    return {
        name: Preset(name, told["title"], told["instrument"], *(tuple(told.get(key, ())) for key in several))
        for name, told in index.items()
    }


def named(name: str) -> Preset:
    """The preset of a name. Raises KeyError with what to say of any other."""
    known = presets()
    found = known.get(name) or next((one for one in known.values() if name in one.also), None)
    if found is None:
        names = [*known, *(other for one in known.values() for other in one.also)]
        raise KeyError(
            f"found no preset {name!r}, expected one of {', '.join(known)}{units.did_you_mean(name, names)}"
        )
    return found


def recognised(lines: Iterable[str]) -> Preset | None:
    """The preset of the instrument that wrote a file with these lines above its rows; None of any other."""
    lines = list(lines)
    return next((one for one in presets().values() if one.wrote(lines)), None)


def known_of(head: Head) -> tuple[str, dict[str, str]]:
    """The instrument that wrote a file, by the lines above its rows, and what it is known to write."""
    found = recognised((*head.above, str(head.dialect.delimiter).join(head.names)))
    if found is None:
        return "", {}
    known = {key: value for key, value in found.options.items() if key not in found.assumed}
    return found.instrument, _facts(known)


def known_by(options: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """What wrote a file, by the preset that a mapping file's options name, and what they say of it."""
    wrote = named(options["preset"]).instrument if "preset" in options else "an instrument that states none"
    return wrote, _facts(options)


def _facts(options: Mapping[str, Any]) -> dict[str, str]:
    """What a mapping file says of files that do not say it: units by name, and words."""
    words = {key: str(options[key]) for key in ("amplitude", "quantity", "phase_sign") if key in options}
    ratio = {"ratio": "ohm"} if words.get("quantity") == "impedance" else {}
    return {**options.get("units", {}), **words, **ratio}
