"""Flexural modes of a plate with patches, by finite elements, and the choice of the one that stimulates.

Kirchhoff's theory with Bogner-Fox-Schmit elements for speed, Mindlin's with quartic ones for truth. Meshes
are rectangles whose lines run along all edges of patches. A layout that is its own mirror image is halved,
and its even and its odd shapes are found apart.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import skfem  # the extra "stimulator"
from scipy.interpolate import RectBivariateSpline
from scipy.sparse import csc_matrix
from skfem.element import DiscreteField
from skfem.helpers import dd, ddot, grad

from stimulator.errors import beyond, positive, refuse
from stimulator.kept import Arrays, kept
from stimulator.modal import Eigenmode, Mode, resonator, straight
from stimulator.plate import Box, PlateGeometry
from stimulator.section import moment_per_volt, section
from stimulator.spectrum import around, below
from stimulator.theory import wavelength

CODE = [
    str(Path(__file__).with_name(f"{name}.py"))
    for name in ("modes", "modal", "plate", "section", "shape", "spectrum", "theory")
]
MOST_UNKNOWNS = 60_000  # of one eigenproblem: its factors fit into 1 GB
SAMPLES = 16  # a wavelength, of a kept shape: cubic splines then err by 1e-4
MOST_SECANTS, CALIBRATED = 8, 1e-5  # steps, and the relative error of a frequency at which they end
LEAST_WAVES = 2.0  # along the plate
RIGID = 1e-6  # of the square of the frequency looked at: below, a rigid body's, 0 but for rounding
THIN = 0.1  # thickness over wavelength, from which on Kirchhoff's wavelength is 3 % too long
Parity = tuple[int, int]  # along x and y: 0 even, 1 odd, where the layout is halved


@dataclass(frozen=True, eq=False)
class Modes:
    """What `modes` found: the chosen `mode` with its neighbours, and how it was found.

    `straight`: (Hz, uniformity) of all modes near with straight nodal lines, the nearest first; `unknowns`:
    of the largest eigenproblem.
    """

    plate: PlateGeometry
    theory: str
    mode: Mode
    straight: tuple[tuple[float, float], ...]
    unknowns: int


def modes(
    plate: PlateGeometry,
    near: float = 32300.0,
    theory: str = "kirchhoff",
    *,
    per_wavelength: float | None = None,
    company: float = 500.0,
    cache: bool | str | Path = True,
) -> Modes:
    """The mode nearest to `near` (Hz) with straight nodal lines along the width, and all within `company` Hz.

    `theory`: "kirchhoff" (fast; its wavelength is 1.4 % long at 1.2 mm and 32 kHz) or "mindlin".
    `per_wavelength`: elements a wavelength, at least; the default errs by less than 0.05 % in frequency.
    `cache`: the folder where results are kept; True: the user's own; False: none. Raises StimulatorError for
    a mesh too coarse for the wavelength or too large, and where no such mode lies near.
    """
    if theory not in _THEORIES:
        refuse("theory", repr(theory), " or ".join(_THEORIES))
    if per_wavelength is None:
        per_wavelength = _THEORIES[theory].per_wavelength
    asked = [positive("near", near, "Hz"), positive("company", company, "Hz")]
    asked.append(positive("per_wavelength", per_wavelength, "1"))
    thick = plate.thickness / wavelength(plate.material, plate.thickness, near)
    if theory == "kirchhoff" and thick > THIN:
        beyond(
            f"kirchhoff: a plate {thick:.2f} wavelengths thick; from {THIN:g} on it errs by 3 %; use mindlin"
        )
    request = (plate, theory, *asked, skfem.__version__)
    solved = kept(cache, request, CODE, lambda: _solved(plate, theory, *asked))
    found = [
        Eigenmode(float(f0), solved["x"], solved["y"], values, moments)
        for f0, values, moments in zip(solved["f0"], solved["values"], solved["moments"], strict=True)
    ]
    lined_up = tuple((float(f0), float(u)) for f0, u in solved["straight"])
    return Modes(plate, theory, resonator(plate, found[0], found[1:]), lined_up, int(solved["unknowns"]))


def calibrated(
    plate: PlateGeometry, frequency: float = 32300.0, theory: str = "kirchhoff", **options: Any
) -> PlateGeometry:
    """The plate with its E scaled so that the straight mode nearest to `frequency` (Hz) lies there, to 1e-5.

    What a bench knows is the frequency; a nominal E misses it by some per cent. `options`: those of `modes`.
    """
    aim, slope = math.log(positive("frequency", frequency, "Hz")), 2.0  # of a bare plate E is as f^2
    before = None
    for _ in range(MOST_SECANTS):
        E, f = math.log(plate.material.E), math.log(modes(plate, frequency, theory, **options).mode.f0)
        if abs(f - aim) < CALIBRATED:
            return plate
        slope = slope if before is None else (E - before[0]) / (f - before[1])
        before = E, f
        plate = replace(plate, material=replace(plate.material, E=math.exp(E + slope * (aim - f))))
    refuse("frequency", f"{frequency:g} Hz, not reached", f"a straight mode there in {MOST_SECANTS} steps")


def _solved(plate: PlateGeometry, theory: str, near: float, company: float, per_wavelength: float) -> Arrays:
    """The chosen mode first, then those beside it from the lowest on."""
    # Straight modes lie a share wavelength/length apart: one is nearer than half of that, or a little more.
    waves = plate.length / wavelength(plate.material, plate.thickness, near)
    if waves < LEAST_WAVES:
        expected = f"{LEAST_WAVES:g} wavelengths or more: modes are told by their nodal lines"
        refuse("near", f"{near:g} Hz, {waves:.2g} wavelengths along the plate", expected)
    reach = near / waves
    model = _Model(plate, theory, near + reach, per_wavelength)
    even = [parity for parity in model.parities if not parity[1]]
    seen = [found for parity in even for found in model.spectrum(parity, near, reach + company)]
    lined_up = straight(seen, near, reach)
    chosen = lined_up[0]
    odd = [parity for parity in model.parities if parity[1]]
    seen += [found for parity in odd for found in model.spectrum(parity, chosen.f0, company)]
    beside = [found for found in seen if found is not chosen and abs(found.f0 - chosen.f0) <= company]
    listed = [chosen, *sorted(beside, key=lambda found: found.f0)]
    arrays = {
        name: np.array([getattr(found, name) for found in listed]) for name in ("f0", "values", "moments")
    }
    return arrays | {
        "x": chosen.x,
        "y": chosen.y,
        "straight": np.array([(found.f0, found.shape.uniformity) for found in lined_up]),
        "unknowns": np.array(model.unknowns),
    }


@dataclass(frozen=True)
class _Theory:
    """A plate theory in the forms of scikit-fem.

    `vanish`: the unknowns that are zero on the mirrors across x and across y, of even and of odd shapes.
    """

    element: Callable[[], Any]
    order: int  # of quadrature
    per_element: int  # unknowns
    per_wavelength: float  # elements unless stated otherwise, and
    least: float  # no fewer: a wave needs two points in each half
    stiffness: Callable
    mass: Callable
    curvature: Callable
    vanish: tuple[tuple[list[str], list[str]], ...]


class _Hermite(skfem.ElementQuadBFS):
    """Bogner-Fox-Schmit elements on rectangles, made in the coordinates of each of them.

    In those of the whole plate, as the library makes them, elements narrower than 1/1000 of it lose all
    digits.
    """

    def gbasis(self, mapping: Any, X: np.ndarray, i: int, tind: np.ndarray | None = None) -> tuple:
        """Unknown i belongs to corner i // 4: value, slope along x, slope along y, and both."""
        mesh = mapping.mesh
        corners = mesh.p[:, mesh.t if tind is None else mesh.t[:, tind]]
        low, size = corners.min(axis=1)[..., None], np.ptp(corners, axis=1)[..., None]
        far = corners[:, i // 4, :, None] > low + size / 2
        inside = (mapping.F(X, tind=tind) - low) / size
        slopes = (i % 4) in (1, 3), (i % 4) in (2, 3)
        along = (_cubic(inside[a], size[a], far[a], slopes[a]) for a in (0, 1))
        (f, df, ddf), (g, dg, ddg) = along
        gradient, hessian = np.array([df * g, f * dg]), np.array([[ddf * g, df * dg], [df * dg, f * ddg]])
        return (DiscreteField(value=f * g, grad=gradient, hess=hessian),)


def _cubic(inside: np.ndarray, size: np.ndarray, far: np.ndarray, slope: bool) -> tuple[np.ndarray, ...]:
    """Hermite's cubic that is 1, or whose slope is 1, at one end, and its two derivatives."""
    r, sign = np.where(far, 1 - inside, inside), np.where(far, -1.0, 1.0)
    if slope:
        return sign * size * r * (1 - r) ** 2, (1 - r) * (1 - 3 * r), sign * (6 * r - 4) / size
    return (1 + 2 * r) * (1 - r) ** 2, sign * 6 * r * (r - 1) / size, (12 * r - 6) / size**2


def _kirchhoff(u: Any, v: Any, w: Any) -> Any:
    H, G = dd(u), dd(v)
    return w.D * ((1 - w.nu) * ddot(H, G) + w.nu * (H[0, 0] + H[1, 1]) * (G[0, 0] + G[1, 1]))


def _mindlin(u: Any, v: Any, w: Any) -> Any:
    """Of deflection and two rotations, which are its slopes where the plate is thin."""
    g, q = grad(u), grad(v)
    bending = g[1, 0] * q[1, 0] + g[2, 1] * q[2, 1] + w.nu * (g[1, 0] * q[2, 1] + g[2, 1] * q[1, 0])
    twist = (1 - w.nu) / 2 * (g[1, 1] + g[2, 0]) * (q[1, 1] + q[2, 0])
    shear = (g[0, 0] - u[1]) * (q[0, 0] - v[1]) + (g[0, 1] - u[2]) * (q[0, 1] - v[2])
    return w.D * (bending + twist) + w.shear * shear


_THEORIES = {
    "kirchhoff": _Theory(
        element=_Hermite,
        order=6,
        per_element=4,
        per_wavelength=7.5,
        least=4.0,
        stiffness=_kirchhoff,
        mass=lambda u, v, w: w.mass * u * v,
        curvature=lambda v, w: w.where * (dd(v)[0, 0] + dd(v)[1, 1]),
        vanish=((["u_x", "u_xy"], ["u", "u_y"]), (["u_y", "u_xy"], ["u", "u_x"])),
    ),
    "mindlin": _Theory(
        element=lambda: skfem.ElementVector(skfem.ElementQuadP(4), 3),
        order=8,
        per_element=48,
        per_wavelength=3.0,
        least=1.5,
        stiffness=_mindlin,
        mass=lambda u, v, w: w.mass * u[0] * v[0] + w.inertia * (u[1] * v[1] + u[2] * v[2]),
        curvature=lambda v, w: w.where * (grad(v)[1, 0] + grad(v)[2, 1]),
        vanish=((["u^2"], ["u^1", "u^3"]), (["u^3"], ["u^1", "u^2"])),
    ),
}


class _Model:
    """Stiffness and mass of a plate, or of the part from the corner (0, 0) on that its mirrors leave."""

    def __init__(self, plate: PlateGeometry, theory: str, highest: float, per_wavelength: float):
        self.plate, self.theory, self.per_wavelength = plate, _THEORIES[theory], per_wavelength
        self.wavelength = wavelength(plate.material, plate.thickness, highest, theory)
        if per_wavelength < self.theory.least:
            least = f"{self.theory.least:g} elements of {theory} or more in {1e3 * self.wavelength:.3g} mm"
            refuse("per_wavelength", f"{per_wavelength:g}, a mesh too coarse for the wavelength", least)
        self.halved = plate.mirrored()
        mesh = skfem.MeshQuad.init_tensor(*self._lines(self.wavelength / per_wavelength))
        unknowns = mesh.nelements * self.theory.per_element
        if unknowns > MOST_UNKNOWNS:
            found = f"{per_wavelength:g}, a mesh of {unknowns} unknowns"
            refuse("per_wavelength", found, f"no more than {MOST_UNKNOWNS}, whose factors fit into memory")
        self.basis = skfem.Basis(mesh, self.theory.element(), intorder=self.theory.order)
        self.points = np.asarray(self.basis.global_coordinates())
        self.K, self.M = self._assembled()
        self.moments = self._moments()
        self.unknowns = 0

    @property
    def parities(self) -> list[Parity]:
        """The classes that shapes fall into; of a direction without a mirror, all count as even."""
        along_x, along_y = (range(1 + halved) for halved in self.halved)
        return [(i, j) for i in along_x for j in along_y]

    def spectrum(self, parity: Parity, centre: float, reach: float) -> list[Eigenmode]:
        """All modes of a class within `reach` of `centre`, Hz, without the motions of a rigid body."""
        keep, K, M = self._of(parity)
        self.unknowns = max(self.unknowns, len(keep))
        shift = (2 * math.pi * centre) ** 2
        farthest = (2 * math.pi * (centre + reach)) ** 2 - shift  # downwards, the same reach in Hz is less
        unit, found = 2 ** (-sum(self.halved) / 2), []  # of unit modal mass on the whole plate
        squares, vectors = around(K, M, shift, farthest)
        for square, vector in zip(squares, vectors.T, strict=True):
            f0 = math.sqrt(max(square, 0.0)) / (2 * math.pi)
            if abs(f0 - centre) <= reach and square > RIGID * shift:
                whole = np.zeros(self.basis.N)
                whole[keep] = vector * unit
                found.append(self._eigenmode(f0, whole, parity))
        return found

    def below(self, frequency: float) -> int:
        """How many modes lie below a frequency (Hz), a rigid body's motions among them, found or not."""
        shift = (2 * math.pi * frequency) ** 2
        return sum(below(K, M, shift) for _, K, M in map(self._of, self.parities))

    def _of(self, parity: Parity) -> tuple[np.ndarray, csc_matrix, csc_matrix]:
        """Unknowns that a class leaves free, and their stiffness and mass."""
        keep = self._free(parity)
        return keep, csc_matrix(self.K[keep][:, keep]), csc_matrix(self.M[keep][:, keep])

    def _lines(self, step: float) -> list[np.ndarray]:
        """The lines of the mesh: all edges of patches and of their images, and equal parts between them."""
        boxes = [patch.box for patch in self.plate.patches]
        sides = self.plate.length, self.plate.width
        return [
            _divided(side, halved, [edge for box in boxes for edge in box[2 * axis : 2 * axis + 2]], step)
            for axis, (side, halved) in enumerate(zip(sides, self.halved, strict=True))
        ]

    def _assembled(self) -> tuple[csc_matrix, csc_matrix]:
        bare = section(self.plate)
        fields = {
            name: np.full(self.points.shape[1:], getattr(bare, name))
            for name in ("D", "nu", "mass", "inertia", "shear")
        }
        for patch in self.plate.patches:
            glued, inside = section(self.plate, patch), self._inside(patch.box)
            for name, values in fields.items():
                values[inside] = getattr(glued, name)
        forms = (skfem.BilinearForm(form) for form in (self.theory.stiffness, self.theory.mass))
        K, M = (csc_matrix(form.assemble(self.basis, **fields)) for form in forms)
        return K, M

    def _moments(self) -> dict[Parity, np.ndarray]:
        """Of each class (patches, unknowns): the work of 1 V on each patch, its part here and its images."""
        form, work = skfem.LinearForm(self.theory.curvature), {}
        images = list(product(*((1, -1) if halved else (1,) for halved in self.halved)))
        found = {parity: np.zeros((len(self.plate.patches), self.basis.N)) for parity in self.parities}
        for i, patch in enumerate(self.plate.patches):
            volt = moment_per_volt(self.plate, patch)
            for sign_x, sign_y in images:
                mirrors = self.plate.length if sign_x < 0 else None, self.plate.width if sign_y < 0 else None
                box = patch.mirrored(*mirrors).box
                key = tuple(np.round(box, 9))
                if key not in work:
                    inside = self._inside(box)
                    work[key] = form.assemble(self.basis, where=inside.astype(float)) if inside.any() else 0.0
                for parity, moments in found.items():
                    moments[i] += volt * sign_x ** parity[0] * sign_y ** parity[1] * work[key]
        return found

    def _inside(self, box: Box) -> np.ndarray:
        x, y = self.points
        return (x > box[0]) & (x < box[1]) & (y > box[2]) & (y < box[3])

    def _free(self, parity: Parity) -> np.ndarray:
        """Unknowns that do not vanish on the mirrors."""
        gone = [np.zeros(0, int)]
        for axis, halved in enumerate(self.halved):
            if halved:
                mirror = (self.plate.length, self.plate.width)[axis] / 2
                on = self.basis.get_dofs(lambda x, a=axis, m=mirror: np.abs(x[a] - m) < 1e-9)
                gone.append(on.all(self.theory.vanish[axis][parity[axis]]))
        return np.setdiff1d(np.arange(self.basis.N), np.concatenate(gone))

    def _eigenmode(self, f0: float, whole: np.ndarray, parity: Parity) -> Eigenmode:
        values = self._sampled(whole)
        for axis, halved in enumerate(self.halved):
            if halved:  # the line on the mirror is there once
                image = np.flip(values.take(range(values.shape[axis] - 1), axis), axis)
                values = np.concatenate([values, (-1) ** parity[axis] * image], axis)
        x, y = self._grid
        return Eigenmode(f0, x, y, values, self.moments[parity] @ whole)

    def _sampled(self, whole: np.ndarray) -> np.ndarray:
        """The deflection on the part of the grid that lies within the mesh."""
        basis, column, row, x, y = self._sampler
        found = basis.interpolate(whole)
        deflection = np.asarray(found[0] if isinstance(found, list | tuple) else found)
        deflection = deflection[0] if deflection.ndim == 3 else deflection
        values = np.zeros((len(x), len(y)))
        values[column, row] = deflection
        inner = (
            grid[: (len(grid) + 1) // 2] if halved else grid
            for grid, halved in zip(self._grid, self.halved, strict=True)
        )
        return RectBivariateSpline(x, y, values)(*inner)

    @cached_property
    def _sampler(self) -> tuple:
        """Points of every element that together make a grid of their own, of x and y, and where on it each of
        them lies."""
        per_element = 1 + math.ceil(SAMPLES / self.per_wavelength)
        inner = np.linspace(0, 1, per_element)
        local = np.stack(np.meshgrid(inner, inner, indexing="ij")).reshape(2, -1)
        basis = skfem.Basis(
            self.basis.mesh, self.theory.element(), quadrature=(local, np.ones(local.shape[1]))
        )
        at = np.round(np.asarray(basis.global_coordinates()), 12)
        (x, column), (y, row) = (np.unique(of, return_inverse=True) for of in at)
        return basis, column.reshape(at[0].shape), row.reshape(at[0].shape), x, y

    @cached_property
    def _grid(self) -> list[np.ndarray]:
        """Equidistant x and y over the whole plate, a line on each mirror."""
        points = SAMPLES / 2 / self.wavelength
        return [
            np.linspace(0, side, 2 * math.ceil(side * points) + 1)
            for side in (self.plate.length, self.plate.width)
        ]


def _divided(side: float, halved: bool, edges: list[float], step: float) -> np.ndarray:
    """Lines from 0 to the side's end or its middle: the edges, and parts of at most `step` between them."""
    end = side / 2 if halved else side
    edges = edges + [side - edge for edge in edges] if halved else edges
    inner = {round(edge, 9) for edge in edges if 1e-9 < edge < end - 1e-9}
    lines = [0.0]
    for low, high in pairwise([0.0, *sorted(inner), end]):
        parts = max(math.ceil((high - low) / step - 1e-9), 1)
        lines += list(low + (high - low) * np.arange(1, parts + 1) / parts)
    return np.array(lines)
