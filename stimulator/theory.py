"""What is known of flexural modes without finite elements: waves, counts, a bare plate's modes, the loss to
air."""

import math

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eigh
from scipy.optimize import brentq

from stimulator.errors import positive, refuse
from stimulator.plate import Material, PlateGeometry
from stimulator.section import section

AIR_DENSITY, SOUND = 1.20, 343.0  # kg/m^3, m/s, at 20 degC


def wavelength(material: Material, thickness_m: float, frequency_Hz: float, theory: str = "mindlin") -> float:
    """Wavelength (m) of the straight flexural wave. Raises StimulatorError.

    "kirchhoff": omega^2 rho h = D k^4. "mindlin": with shear, kappa = pi^2/12, and rotary inertia.
    "rayleigh_lamb": the exact antisymmetric wave A0 of an elastic layer.
    """
    h, omega = (
        positive("thickness_m", thickness_m, "m"),
        2 * math.pi * positive("frequency_Hz", frequency_Hz, "Hz"),
    )
    if theory not in _WAVENUMBER:
        refuse("theory", repr(theory), " or ".join(_WAVENUMBER))
    return 2 * math.pi / _WAVENUMBER[theory](material, h, omega)


def _kirchhoff(of: Material, h: float, omega: float) -> float:
    return (omega**2 * of.rho * h / (of.plane_stress * h**3 / 12)) ** 0.25


def _mindlin(of: Material, h: float, omega: float) -> float:
    """(S k^2 - m w^2)(D k^2 + S - I w^2) = S^2 k^2, quadratic in k^2; the larger root is the flexural
    wave."""
    bare = section(PlateGeometry(100 * h, 100 * h, h, of))
    m, inertia = bare.mass * omega**2, bare.inertia * omega**2
    a, b, c = bare.shear * bare.D, -(bare.shear * inertia + m * bare.D), -m * (bare.shear - inertia)
    return math.sqrt((-b + math.sqrt(b * b - 4 * a * c)) / (2 * a))


def _lamb(of: Material, h: float, omega: float) -> float:
    """tanh(beta h/2)/tanh(alpha h/2) = (beta^2 + k^2)^2/(4 k^2 alpha beta).

    alpha^2 = k^2 - (omega/c_l)^2, beta^2 = k^2 - (omega/c_t)^2.
    """
    slow = omega / math.sqrt(of.shear / of.rho)
    fast = slow * math.sqrt((1 - 2 * of.nu) / (2 * (1 - of.nu)))

    def mismatch(k: float) -> float:
        alpha, beta = math.sqrt(k**2 - fast**2), math.sqrt(k**2 - slow**2)
        free = 4 * k**2 * alpha * beta * math.tanh(beta * h / 2)
        return free - (beta**2 + k**2) ** 2 * math.tanh(alpha * h / 2)

    # The wave is slower than Kirchhoff's and than a shear wave, by less than a factor of three.
    thin = max(_kirchhoff(of, h, omega), slow * (1 + 1e-9))
    return brentq(mismatch, thin, 3 * thin, xtol=1e-12 * thin)


_WAVENUMBER = {"kirchhoff": _kirchhoff, "mindlin": _mindlin, "rayleigh_lamb": _lamb}
THEORIES = tuple(_WAVENUMBER)


def weyl_count(plate: PlateGeometry, low_Hz: float, high_Hz: float, theory: str = "kirchhoff") -> float:
    """Flexural modes to expect between two frequencies: area (k_high^2 - k_low^2)/(4 pi), Weyl's leading
    term."""
    low, high = (
        2 * math.pi / wavelength(plate.material, plate.thickness, f, theory) for f in (low_Hz, high_Hz)
    )
    return plate.area * (high**2 - low**2) / (4 * math.pi)


def radiation_tau(mass_per_area: float, wavelength_m: float, frequency_Hz: float) -> float:
    """The time constant (s) of a plate that loses energy to the air alone, on both faces: rho h/(rho0 c
    sigma).

    sigma = 1/sqrt(1 - (c/(f lambda))^2) is the efficiency of an infinite plane wave faster than sound; a
    slower one does not radiate, and inf comes back. The edges of a finite plate add what is left out here: a
    bound of 10 %, not of 1 %.
    """
    mach = positive("frequency_Hz", frequency_Hz, "Hz") * positive("wavelength_m", wavelength_m, "m") / SOUND
    if mach <= 1:
        return math.inf
    return (
        positive("mass_per_area", mass_per_area, "kg/m^2")
        / (AIR_DENSITY * SOUND)
        * math.sqrt(1 - 1 / mach**2)
    )


def bare_modes(
    plate: PlateGeometry, parity: tuple[int, int], terms: tuple[int, int] = (26, 20)
) -> np.ndarray:
    """Frequencies (Hz, ascending) of the bare plate in Kirchhoff's theory, by Ritz' method, of one parity
    class.

    `parity`: (0 or 1, 0 or 1), whether the shape is odd along x and along y; `terms`: how many Legendre
    polynomials of that parity in x and y. Free edges are natural to it. Polynomials over the whole plate do
    not converge under patches: those are left out. Ritz, J. reine angew. Math. 135, 1 (1909); values for the
    square plate: Leissa, J. Sound Vib. 31, 257 (1973).
    """
    bare = section(plate)
    X, Y = (
        _products(2 * np.arange(n) + odd, side)
        for n, odd, side in zip(terms, parity, (plate.length, plate.width), strict=True)
    )
    D, nu = bare.D, bare.nu
    bending = np.kron(X[2, 2], Y[0, 0]) + np.kron(X[0, 0], Y[2, 2])
    across = np.kron(X[2, 0], Y[0, 2]) + np.kron(X[0, 2], Y[2, 0])
    K = D * (bending + nu * across + 2 * (1 - nu) * np.kron(X[1, 1], Y[1, 1]))
    squares = eigh(K, bare.mass * np.kron(X[0, 0], Y[0, 0]), eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * math.pi)


def _products(orders: np.ndarray, side: float) -> dict[tuple[int, int], np.ndarray]:
    """Integrals over a side (m) of the products of the i-th and the j-th derivatives of normalised Legendre
    polynomials."""
    x, w = legendre.leggauss(int(orders[-1]) + 4)
    series = np.eye(int(orders[-1]) + 1)[:, orders] * np.sqrt((2 * orders + 1) / side)
    derivatives = [
        legendre.legval(x, legendre.legder(series, d) if d else series) * (2 / side) ** d for d in range(3)
    ]
    return {(i, j): (derivatives[i] * w * side / 2) @ derivatives[j].T for i in range(3) for j in range(3)}
