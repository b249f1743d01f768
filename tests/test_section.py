"""Composite sections and the moment per volt, beside closed forms of layered beams."""

import math
from dataclasses import replace

import pytest

from stimulator import Patch, Piezo, PlateGeometry
from stimulator.plate import ALUMINIUM, BARE, DEFAULT_LAYOUT, LAYOUTS, PZT
from stimulator.section import moment_per_volt, section

ALIKE = Piezo("aluminium that moves", ALUMINIUM.E, ALUMINIUM.rho, ALUMINIUM.nu, -210e-12)


def patch(thickness, material=PZT, **changed):
    return Patch(0.1, 0.07, 9e-3, 9e-3, thickness, material, **changed)


@pytest.mark.parametrize("thickness", [0.2e-3, 0.5e-3, 1.2e-3])
def test_a_patch_of_the_plate_s_own_metal_makes_a_thicker_plate(thickness):
    whole = section(PlateGeometry(thickness=1.2e-3 + thickness))
    glued = section(BARE, patch(thickness, ALIKE))
    for name in ("D", "nu", "mass", "inertia", "shear"):
        assert getattr(glued, name) == pytest.approx(getattr(whole, name), rel=1e-12)


@pytest.mark.parametrize("thickness", [0.1e-3, 0.3e-3, 0.5e-3, 1.0e-3])
@pytest.mark.parametrize("stiff", [0.5, 1.0, 2.0])
def test_a_plate_bends_as_timoshenko_s_bimetal(thickness, stiff):
    """Free strain d31 V/h_p in one layer of two, of equal nu, bends both directions alike:

    curvature = 6 strain (1 + m)^2 / (h (3 (1 + m)^2 + (1 + m n)(m^2 + 1/(m n))))

    with m and n the ratios of thickness and of E (Timoshenko, J. Opt. Soc. Am. 11, 233, 1925).
    """
    layer = Piezo("layer", stiff * ALUMINIUM.E, 1.0, ALUMINIUM.nu, 1e-10)
    glued = patch(thickness, layer)
    found = moment_per_volt(BARE, glued) / (section(BARE, glued).D * (1 + ALUMINIUM.nu))
    m, n, strain = thickness / 1.2e-3, stiff, 1e-10 / thickness
    below = 3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))
    assert found == pytest.approx(6 * strain * (1 + m) ** 2 / ((1.2e-3 + thickness) * below), rel=1e-12)


def test_a_weightless_patch_changes_nothing_and_still_pulls():
    film = patch(1e-9, weightless=True)
    assert section(BARE, film) == section(BARE)
    thin = 210e-12 * PZT.E / (1 - PZT.nu) * 0.6e-3
    assert moment_per_volt(BARE, film) == pytest.approx(-thin, rel=1e-5)


def test_the_mass_of_a_layout():
    """Twenty ceramics of 9 x 25 x 0.3 mm, by hand; the sensors count as weightless."""
    bare = 0.198 * 0.138 * 1.2e-3 * 2700
    assert LAYOUTS[DEFAULT_LAYOUT].mass == pytest.approx(bare + 20 * 9e-3 * 25e-3 * 0.3e-3 * 7800, rel=1e-12)


def test_layouts_are_their_own_mirror_images_and_a_shifted_patch_is_not():
    assert all(layout.mirrored() == (True, True) for layout in LAYOUTS.values())
    layout = LAYOUTS[DEFAULT_LAYOUT]
    first, *rest = layout.patches
    assert replace(layout, patches=(first.shifted(x=1e-3), *rest)).mirrored() == (False, False)
    alone = replace(BARE, patches=(patch(0.3e-3).shifted(y=-1e-3),))
    assert alone.mirrored() == (False, True)
    assert math.isclose(alone.patches[0].box[2], 0.0645)
