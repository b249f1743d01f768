"""A plate's cross-section, bare or with a patch on one face: bending, shear and inertia per area, and the
moment per volt."""

from dataclasses import dataclass

import numpy as np

from stimulator.plate import Patch, PlateGeometry

SHEAR_CORRECTION = np.pi**2 / 12  # Mindlin's: the first thickness-shear frequency is exact


@dataclass(frozen=True)
class Section:
    """D (N m) and its Poisson's ratio, mass (kg/m^2), rotary inertia (kg), shear stiffness (N/m).

    Of layers i at heights z_i from the lower face's opposite: with the neutral axis z0 = sum Q h z / sum Q h
    and Q = E/(1 - nu^2),

        D = sum Q (h^3/12 + h (z - z0)^2),    D nu = sum Q nu (...)
    """

    D: float
    nu: float
    mass: float
    inertia: float
    shear: float


def section(plate: PlateGeometry, patch: Patch | None = None) -> Section:
    """Of the plate, and of the patch on it unless that is weightless."""
    layers = [(plate.material, plate.thickness, 0.0)]
    if patch is not None and not patch.weightless:
        layers.append((patch.material, patch.thickness, (plate.thickness + patch.thickness) / 2))
    z0 = _neutral_axis(layers)
    moments = [(of, h**3 / 12 + h * (z - z0) ** 2) for of, h, z in layers]
    D = sum(of.plane_stress * second for of, second in moments)
    return Section(
        D=D,
        nu=sum(of.plane_stress * of.nu * second for of, second in moments) / D,
        mass=sum(of.rho * h for of, h, _ in layers),
        inertia=sum(of.rho * second for of, second in moments),
        shear=SHEAR_CORRECTION * sum(of.shear * h for of, h, _ in layers),
    )


def moment_per_volt(plate: PlateGeometry, patch: Patch) -> float:
    """Bending moment per length and volt of a patch poled up, N/V: d31 E/(1 - nu) times its height over the
    neutral axis.

    The same number is the charge per area that a curvature of both directions' sum 1/m makes, C/m.
    """
    height = (plate.thickness + patch.thickness) / 2
    layers = [(plate.material, plate.thickness, 0.0)]
    if not patch.weightless:
        layers.append((patch.material, patch.thickness, height))
    of = patch.material
    return of.d31 * of.E / (1 - of.nu) * (height - _neutral_axis(layers))


def _neutral_axis(layers: list) -> float:
    """Its height over the plate's middle, m."""
    stiffness = [of.plane_stress * h for of, h, _ in layers]
    return sum(q * z for q, (_, _, z) in zip(stiffness, layers, strict=True)) / sum(stiffness)
