"""What every plate's fit of one run is told, and a digest of it by which rows of an earlier run are known to
be the same."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sysid.posterior.accuracy import NAMES


@dataclass(frozen=True)
class Settings:
    """`columns`: a mapping file; `nuisances`, `priors` and `reference_temperature` as `sysid.fit` takes them
    (None: its own); `accuracy` and `seed` as `sysid.sample` does; `full`: a folder for each plate's own set
    of files; `plates`: up to so many are of the run, by which it is weighed what may be chance. Raises
    ValueError for an accuracy that is none."""

    accuracy: str = NAMES[0]
    seed: int = 0
    columns: str | None = None
    nuisances: tuple[str, ...] | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    reference_temperature: float = 24.0
    full: str | None = None
    lane: bool = True
    plates: int = 1

    def __post_init__(self) -> None:
        if self.accuracy not in NAMES:
            raise ValueError(f"found accuracy {self.accuracy!r}, expected one of {', '.join(NAMES)}")

    def of_run(self, count: int) -> "Settings":
        """Those of a run of so many plates. It is weighed as one of the next power of two, so that a run to
        which a few plates come weighs them as those that are done, and one that doubles weighs all anew."""
        return replace(self, plates=1 << max(count - 1, 0).bit_length())

    @property
    def alone(self) -> str:
        """Why no plate is fitted with others; "" where they may be."""
        if not self.lane:
            return "the lane is off"
        if self.accuracy != NAMES[0] or self.full is not None:
            return "each plate's own posterior is asked for"
        return "nuisances or priors are stated" if self.nuisances is not None or self.priors else ""

    @property
    def given(self) -> dict[str, Any]:
        """The keywords of `sysid.fit`."""
        named = {} if self.nuisances is None else {"nuisances": self.nuisances}
        return named | {"priors": self.priors, "reference_temperature": self.reference_temperature}

    @cached_property
    def digest(self) -> str:
        """Of all that a row depends on beside its logs: these settings, the mapping file's bytes, and the
        program's own text. Raises LogError for a mapping file that is none."""
        told = asdict(self) | {"full": self.full is not None}
        told["plates"] = None if self.alone else self.plates  # of which a plate by itself knows nothing
        if self.columns is not None:
            from sysid.columns.mapfile import load_mapping

            mapping = load_mapping(self.columns)
            told["columns"] = repr((mapping.options, mapping.dialect))
        text = json.dumps([told, _program()], sort_keys=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()


@cache
def _program() -> list[str]:
    """A digest of the package's text, and the versions of what it computes with."""
    root = Path(__file__).parents[1]
    text = b"".join(path.read_bytes() for path in sorted(root.rglob("*.py")))
    return [hashlib.sha256(text).hexdigest(), *(version(name) for name in ("jax", "numpy", "scipy"))]
