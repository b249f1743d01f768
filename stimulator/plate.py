"""The plate: materials, piezoelectric patches, their layout on a rectangular plate, and what a plate cannot
be.

Lengths are in metres. The origin is a corner of the plate, x runs along its length and y along its width, so
that the middle is (length/2, width/2). All patches are glued to the lower face.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

from stimulator.errors import number, positive, refuse

ROLES = "drive", "sense"
Box = tuple[float, float, float, float]  # edges (x0, x1, y0, y1), m
TOUCHING = 1e-9  # m: edges that rounding has moved over one another by less still only touch


@dataclass(frozen=True)
class Material:
    """An isotropic elastic material: Young's modulus E (Pa), density rho (kg/m^3), Poisson's ratio nu."""

    name: str
    E: float
    rho: float
    nu: float

    def __post_init__(self) -> None:
        positive(f"{self.name}.E", self.E, "Pa")
        positive(f"{self.name}.rho", self.rho, "kg/m^3")
        number(f"{self.name}.nu", self.nu, -1.0, 0.5, "Poisson's ratio of a stable solid, between -1 and 0.5")

    @property
    def plane_stress(self) -> float:
        """E/(1 - nu^2), Pa: the stiffness of a sheet that is kept from contracting across."""
        return self.E / (1 - self.nu**2)

    @property
    def shear(self) -> float:
        """Shear modulus E/(2 (1 + nu)), Pa."""
        return self.E / (2 * (1 + self.nu))


@dataclass(frozen=True)
class Piezo(Material):
    """A ceramic poled through its thickness; E and nu at constant field, d31 in m/V."""

    d31: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        number(f"{self.name}.d31", self.d31, expected="a number in m/V")


ALUMINIUM = Material("aluminium", 69e9, 2700.0, 0.33)
STEEL = Material("steel", 200e9, 7850.0, 0.29)
COPPER_BERYLLIUM = Material("copper beryllium", 128e9, 8250.0, 0.30)
PZT = Piezo("soft PZT", 66.7e9, 7800.0, 0.34, -210e-12)


@dataclass(frozen=True)
class Patch:
    """A rectangular ceramic centred at (x, y), `length` along x and `width` along y, all in m.

    `poling`: 1 or -1, the direction in which it is poled; 0: the direction that serves the chosen mode, which
    is what one finds out before gluing. `role`: "drive", all in parallel on the amplifier; "sense", all in
    parallel on the amplitude's input. `weightless`: neither its mass nor its stiffness counts, as of a thin
    film.
    """

    x: float
    y: float
    length: float
    width: float
    thickness: float = 0.3e-3
    material: Piezo = PZT
    poling: int = 0
    role: str = "drive"
    weightless: bool = False

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            number(f"patch.{name}", getattr(self, name), expected="a number in m")
        for name in ("length", "width", "thickness"):
            positive(f"patch.{name}", getattr(self, name), "m")
        if not isinstance(self.material, Piezo):
            refuse("patch.material", repr(self.material), "a Piezo, which has a d31")
        if self.poling not in (-1, 0, 1):
            refuse("patch.poling", repr(self.poling), "1, -1, or 0 for the direction that serves the mode")
        if self.role not in ROLES:
            refuse("patch.role", repr(self.role), " or ".join(ROLES))

    @property
    def box(self) -> Box:
        """Its edges (x0, x1, y0, y1), m."""
        half, across = self.length / 2, self.width / 2
        return self.x - half, self.x + half, self.y - across, self.y + across

    def shifted(self, x: float = 0.0, y: float = 0.0) -> "Patch":
        """The patch moved by so many metres."""
        return replace(self, x=self.x + x, y=self.y + y)

    def mirrored(self, length: float | None, width: float | None) -> "Patch":
        """The patch seen in a mirror across x at length/2, across y at width/2 (None: not mirrored)."""
        x = self.x if length is None else length - self.x
        y = self.y if width is None else width - self.y
        return replace(self, x=x, y=y)


@dataclass(frozen=True)
class PlateGeometry:
    """A plate `length` x `width` x `thickness` (m) of one `material`, with `patches` on its lower face.

    Raises StimulatorError for a patch that leaves the plate, two that overlap, and what is no number.
    """

    length: float = 198e-3
    width: float = 138e-3
    thickness: float = 1.2e-3
    material: Material = ALUMINIUM
    patches: tuple[Patch, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("length", "width", "thickness"):
            positive(f"plate.{name}", getattr(self, name), "m")
        if self.thickness >= min(self.length, self.width) / 10:
            refuse("plate.thickness", f"{self.thickness:g} m", "less than a tenth of length and width")
        object.__setattr__(self, "patches", tuple(self.patches))
        for i, patch in enumerate(self.patches):
            self._holds(i, patch)
        for (i, one), (j, other) in combinations(enumerate(self.patches), 2):
            if _overlap(one.box, other.box):
                refuse(f"patches[{j}]", f"it overlaps patches[{i}]", "patches side by side")

    def _holds(self, i: int, patch: Patch) -> None:
        if not isinstance(patch, Patch):
            refuse(f"patches[{i}]", repr(patch), "a Patch")
        if patch.thickness > self.thickness:
            own = f"no more than the plate's own {self.thickness:g} m"
            refuse(f"patches[{i}].thickness", f"{patch.thickness:g} m", own)
        x0, x1, y0, y1 = patch.box
        for axis, low, high, limit in (("x", x0, x1, self.length), ("y", y0, y1, self.width)):
            if low < -TOUCHING or high > limit + TOUCHING:
                found, expected = (
                    f"{axis} from {low:g} to {high:g} m",
                    f"it on the plate, from 0 to {limit:g} m",
                )
                refuse(f"patches[{i}]", found, expected)

    @property
    def area(self) -> float:
        """m^2."""
        return self.length * self.width

    @property
    def mass(self) -> float:
        """Of plate and patches, kg."""
        glued = (p.length * p.width * p.thickness * p.material.rho for p in self.patches if not p.weightless)
        return self.area * self.thickness * self.material.rho + math.fsum(glued)

    def mirrored(self) -> tuple[bool, bool]:
        """Whether stiffness and mass are their own image across x = length/2, and across y = width/2."""
        glued = [patch for patch in self.patches if not patch.weightless]
        own = {_weight(patch) for patch in glued}
        mirrors = ((self.length, None), (None, self.width))
        x, y = ({_weight(patch.mirrored(*mirror)) for patch in glued} == own for mirror in mirrors)
        return x, y


def _weight(patch: Patch) -> tuple:
    """What of a patch counts for stiffness and mass."""
    return *(round(edge, 9) for edge in patch.box), patch.thickness, patch.material


def _overlap(a: Box, b: Box) -> bool:
    across = min(a[1], b[1]) - max(a[0], b[0])
    along = min(a[3], b[3]) - max(a[2], b[2])
    return across > TOUCHING and along > TOUCHING


def grid(xs: Iterable[float], ys: Iterable[float], **patch: Any) -> tuple[Patch, ...]:
    """One patch centred at each of `xs` x `ys` (m); `patch` holds what `Patch` takes beside x and y."""
    ys = tuple(ys)
    return tuple(Patch(x, y, **patch) for x in xs for y in ys)


def two_rows(
    plate: PlateGeometry, thickness: float = 0.5e-3, pitch: float = 19e-3, count: int = 10
) -> tuple[Patch, ...]:
    """A row of `count` ceramics of 9 x 9 mm along each long edge, `pitch` apart: one wavelength."""
    xs = [plate.length / 2 + (i - (count - 1) / 2) * pitch for i in range(count)]
    ys = (7e-3, plate.width - 7e-3)
    return grid(xs, ys, length=9e-3, width=9e-3, thickness=thickness)


def four_strips(
    plate: PlateGeometry, thickness: float = 0.3e-3, pitch: float = 38e-3, pieces: int = 5
) -> tuple[Patch, ...]:
    """Four strips over the width, each of `pieces` ceramics of 9 x 25 mm, `pitch` apart: two wavelengths."""
    xs = [plate.length / 2 + (i - 1.5) * pitch for i in range(4)]
    ys = [plate.width / 2 + (j - (pieces - 1) / 2) * 27e-3 for j in range(pieces)]
    return grid(xs, ys, length=9e-3, width=25e-3, thickness=thickness)


def corner_sensors(plate: PlateGeometry, side: float = 7e-3, margin: float = 1e-3) -> tuple[Patch, ...]:
    """Two ceramics in the corners of the side at x = 0; weightless, which keeps a layout's symmetry."""
    near = margin + side / 2
    ys = (near, plate.width - near)
    return tuple(Patch(near, y, side, side, role="sense", weightless=True) for y in ys)


def laid_out(plate: PlateGeometry, patches: Sequence[Patch]) -> PlateGeometry:
    """`plate` with `patches` and the two sensing ceramics."""
    return replace(plate, patches=(*patches, *corner_sensors(plate)))


BARE = PlateGeometry()
LAYOUTS = {
    "2 rows x 10, 0.5 mm": laid_out(BARE, two_rows(BARE, 0.5e-3)),
    "2 rows x 10, 0.3 mm": laid_out(BARE, two_rows(BARE, 0.3e-3)),
    "4 strips x 5, 0.5 mm": laid_out(BARE, four_strips(BARE, 0.5e-3)),
    "4 strips x 5, 0.3 mm": laid_out(BARE, four_strips(BARE, 0.3e-3)),
}
DEFAULT_LAYOUT = "4 strips x 5, 0.3 mm"  # of the four the largest response and the quietest neighbours
