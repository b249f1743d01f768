"""Flexural modes by finite elements, beside Ritz, a free square plate, another element family, and their own
shapes."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from conftest import study
from skfem import ElementQuadP, ElementVector

import stimulator.modes as fe
from stimulator import Material, Patch, PlateGeometry, RangeWarning, StimulatorError
from stimulator.layouts import markdown, table
from stimulator.modal import STRAIGHT
from stimulator.modes import calibrated, modes
from stimulator.plate import BARE, DEFAULT_LAYOUT, LAYOUTS
from stimulator.section import moment_per_volt, section
from stimulator.theory import bare_modes, weyl_count

TAU = 1.669e-3
DEFAULT = LAYOUTS[DEFAULT_LAYOUT]
COARSE = 5.0  # elements a wavelength, where a test looks at what no mesh changes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Modes that more than one test looks at are computed once, by the package's own means."""
    return tmp_path_factory.mktemp("modes")


@pytest.fixture(scope="module")
def default(folder):
    return modes(DEFAULT, cache=folder).mode


def every_mode(plate, theory, near, reach, per_wavelength):
    """Frequencies of all parity classes."""
    model = fe._Model(plate, theory, near + reach, per_wavelength)
    return np.sort([m.f0 for parity in model.parities for m in model.spectrum(parity, near, reach)])


def ritz(low, high):
    found = np.concatenate([bare_modes(BARE, parity) for parity in product((0, 1), repeat=2)])
    return np.sort(found[(found > low) & (found < high)])


# --- the elements -----------------------------------------------------------------------------------------


def test_kirchhoff_s_bare_plate_is_ritz_s():
    """All nine modes in 1 kHz around the chosen one, none missing; a conforming element errs upwards."""
    found, exact = every_mode(BARE, "kirchhoff", 32300.0, 500.0, 7.5), ritz(31750, 32820)
    exact = exact[(exact > 31795) & (exact < 32795)]  # one of Ritz' lies just outside the window of both
    assert len(exact) == 9
    off = np.array([found[np.argmin(np.abs(found - f))] / f - 1 for f in exact])
    assert np.all(off > -1e-6) and np.all(off < 1.5e-3)


@pytest.mark.study
def test_kirchhoff_s_elements_converge():
    """Cubics: the error of an eigenvalue falls as the fourth power of the mesh."""
    exact = bare_modes(BARE, (1, 0))
    exact = exact[np.argmin(np.abs(exact - 31123.5))]
    errors = [modes(BARE, per_wavelength=n, cache=False).mode.f0 / exact - 1 for n in (4.0, 8.0)]
    assert 0 < errors[1] < errors[0] / 10 and errors[1] < 5e-4


@pytest.mark.parametrize(("theory", "wide"), [("kirchhoff", 10), ("mindlin", 4)])
def test_the_free_square_plate(theory, wide):
    """lambda = omega a^2 sqrt(rho h/D), nu = 0.3; Mindlin's at a thousandth of thickness is less by 1e-4 at
    most."""
    square = PlateGeometry(1.0, 1.0, 1e-3, Material("unit", 12 * (1 - 0.3**2), 1.0, 0.3))
    found = 2 * math.pi * every_mode(square, theory, 6e-3, 5e-3, wide) / 1e-3
    published = [13.46820, 19.59614, 24.27020, 34.80089, 34.80089, 61.09323]
    np.testing.assert_allclose(found[:6], published, rtol=1.5e-3)


def thinned(monkeypatch):
    """Mindlin's plate rigid in shear and without rotary inertia, which is Kirchhoff's."""

    def thin(*given):
        return replace(section(*given), shear=1e3 * section(*given).shear, inertia=0.0)

    monkeypatch.setattr(fe, "section", thin)


@pytest.mark.study
def test_mindlin_in_the_limit_of_kirchhoff(monkeypatch):
    """Its form, with elements of sixth order, gives Ritz' mode to 1e-4: no locking."""
    thinned(monkeypatch)
    sixth = replace(fe._THEORIES["mindlin"], element=lambda: ElementVector(ElementQuadP(6), 3), order=12)
    monkeypatch.setitem(fe._THEORIES, "mindlin", sixth)
    found = fe._Model(BARE, "mindlin", 31200.0, 1.5).spectrum((1, 0), 31123.5, 50.0)
    exact = bare_modes(BARE, (1, 0))
    exact = exact[np.argmin(np.abs(exact - 31123.5))]
    assert exact == pytest.approx(31123.5, abs=0.1)
    assert found[0].f0 == pytest.approx(exact, rel=1e-4)


@pytest.mark.study
def test_two_meshes_of_mindlin_agree():
    """3e-4; and the prototype of sixth order, 30239.7 Hz."""
    models = [fe._Model(BARE, "mindlin", 30300.0, n) for n in (3.0, 4.0)]
    coarse, fine = (model.spectrum((1, 0), 30240.0, 50.0)[0].f0 for model in models)
    assert coarse == pytest.approx(fine, rel=3e-4)
    assert fine == pytest.approx(30239.7, rel=3e-4)


@pytest.mark.study
def test_two_meshes_of_a_layout_agree(default):
    fine = modes(DEFAULT, per_wavelength=10.0, cache=False).mode
    assert default.f0 == pytest.approx(fine.f0, rel=5e-4)
    assert default.b == pytest.approx(fine.b, rel=0.03)


@pytest.mark.study
def test_two_families_of_elements_agree_on_a_layout(monkeypatch, default):
    """Mindlin's quartics, made thin, beside Kirchhoff's cubics: composite stiffness, mass and moments enter
    both apart."""
    thinned(monkeypatch)
    other = modes(DEFAULT, default.f0, "mindlin", per_wavelength=2.5, company=1.0, cache=False).mode
    assert other.f0 == pytest.approx(default.f0, rel=1e-3)
    assert other.m == pytest.approx(default.m, rel=0.03)
    assert abs(other.N / default.N - 1) < 0.03


@pytest.mark.study
def test_halves_and_the_whole_are_one_plate(monkeypatch):
    """What the mirrors leave, against all of it: four sensors that meet in the middle make both meshes
    one."""
    middle = [
        Patch(0.099 + i, 0.069 + j, 4e-3, 4e-3, role="sense", weightless=True)
        for i in (-2e-3, 2e-3)
        for j in (-2e-3, 2e-3)
    ]
    both = replace(DEFAULT, patches=(*(p for p in DEFAULT.patches if p.role == "drive"), *middle))
    halved = modes(both, per_wavelength=4.0, cache=False).mode
    monkeypatch.setattr(PlateGeometry, "mirrored", lambda self: (False, False))
    whole = modes(both, per_wavelength=4.0, cache=False).mode
    assert whole.f0 == pytest.approx(halved.f0, rel=1e-9)
    assert (whole.m, whole.N, whole.sense) == pytest.approx((halved.m, halved.N, halved.sense), rel=1e-6)
    for one, other in zip(whole.neighbours, halved.neighbours, strict=True):
        assert one.f0 == pytest.approx(other.f0, rel=1e-9)
        assert (one.drive, one.sense) == pytest.approx((other.drive, other.sense), abs=1e-5)


@pytest.mark.parametrize("gap", [1e-4, 1e-5, 1e-6])
def test_narrow_elements_lose_no_digits(default, gap):
    """The edge of a weightless sensor so close to a strip's: the mesh gains a line, the plate nothing. 5e-5,
    the mesh's error."""
    sensor = Patch(0.0845 + gap + 2e-3, 0.7e-3, 4e-3, 1e-3, role="sense", weightless=True)
    beside = replace(DEFAULT, patches=(*DEFAULT.patches, sensor))
    found = fe._Model(beside, "kirchhoff", 33000.0, 7.5).spectrum((1, 0), default.f0, 30.0)
    assert [m.f0 for m in found] == pytest.approx([default.f0], rel=5e-5)


def test_no_mode_is_missed():
    """Sylvester's law counts modes by the signs of the factors, without finding any; Weyl's law within 3."""
    model = fe._Model(DEFAULT, "kirchhoff", 32000.0, COARSE)
    counted = model.below(31800) - model.below(30800)
    found = [m for parity in model.parities for m in model.spectrum(parity, 31300.0, 500.0)]
    assert len(found) == counted
    assert abs(counted - weyl_count(DEFAULT, 30800, 31800)) <= 3


# --- the chosen mode
# ----------------------------------------------------------------------------------------------------------

TABLE = {  # f Hz, u, m g, N N/V, b um/(s V), {offset Hz: |drive|}
    "2 rows x 10, 0.5 mm": (31120, 0.88, 75, 0.263, 8.9, {121: 1.9, 144: 0.36}),
    "2 rows x 10, 0.3 mm": (31154, 0.91, 66, 0.346, 13.4, {-52: 1.9, -164: 0.42}),
    "4 strips x 5, 0.5 mm": (31094, 0.87, 56, 0.547, 25.2, {-448: 0.52, -264: 0.41}),
    "4 strips x 5, 0.3 mm": (31131, 0.91, 65, 0.741, 29.0, {-121: 0.16, 128: 0.13}),
}


@pytest.mark.parametrize("name", [n if n == "4 strips x 5, 0.3 mm" else study(n) for n in TABLE])
def test_the_table_of_layouts(name, folder):
    """f to 0.1 %, b to 5 %, as a mesh of another make gave them; driven neighbours to 10 Hz and 5 % of b0."""
    f0, u, m, N, b, driven = TABLE[name]
    found = modes(LAYOUTS[name], cache=folder).mode
    assert found.f0 == pytest.approx(f0, rel=1e-3)
    assert found.uniformity == pytest.approx(u, abs=0.02)
    assert 1e3 * found.m == pytest.approx(m, rel=0.05)
    assert abs(found.N / N - 1) < 0.05
    assert 1e6 * found.b == pytest.approx(b, rel=0.05)
    for offset, drive in driven.items():
        near = min(found.neighbours, key=lambda n: abs(n.f0 - found.f0 - offset))
        assert near.f0 - found.f0 == pytest.approx(offset, abs=10)
        assert abs(near.drive) == pytest.approx(drive, abs=0.05)
    assert sum(abs(n.drive) > 0.05 for n in found.neighbours) == len(driven)


def test_a_coarse_mesh_chooses_the_same_mode(default):
    """It shifts and reorders the neighbours; the shape stays."""
    coarse = modes(DEFAULT, per_wavelength=4.0, cache=False).mode
    assert coarse.f0 == pytest.approx(default.f0, rel=0.01)
    x, y = np.linspace(0, 0.198, 60)[:, None], np.linspace(0, 0.138, 40)
    assert np.corrcoef(coarse.weight(x, y).ravel(), default.weight(x, y).ravel())[0, 1] > 0.99


def test_modal_mass_and_force_follow_from_the_shape(default):
    """m = int rho h phi^2, and of each patch N = its moment times the slope integrated around its edge: no
    finite elements."""
    x, y = (np.linspace(0, side, n) for side, n in ((0.198, 1201), (0.138, 901)))
    squared = default.weight(x[:, None], y) ** 2
    bare = section(DEFAULT).mass * np.trapezoid(np.trapezoid(squared, y), x)
    glued = sum(
        (section(DEFAULT, p).mass - section(DEFAULT).mass)
        * p.length
        * p.width
        * default.shape.mean(np.square, p.box)
        for p in DEFAULT.patches
    )
    assert bare + glued == pytest.approx(default.m, rel=2e-3)
    force = sum(
        pole * moment_per_volt(DEFAULT, p) * flux(default.shape, p.box)
        for pole, p in zip(default.poling, DEFAULT.patches, strict=True)
        if p.role == "drive"
    )
    assert force == pytest.approx(default.N, rel=0.02)  # slopes of a spline over stiffness that jumps


def flux(shape, box):
    """The integral of the outward slope around a rectangle, by central differences of the shape."""
    d, (x0, x1, y0, y1) = 1e-4, box
    x, y = np.linspace(x0, x1, 401), np.linspace(y0, y1, 801)
    slope_x = [np.trapezoid(shape(at + d, y) - shape(at - d, y), y) / (2 * d) for at in (x0, x1)]
    slope_y = [np.trapezoid(shape(x, at + d) - shape(x, at - d), x) / (2 * d) for at in (y0, y1)]
    return slope_x[1] - slope_x[0] + slope_y[1] - slope_y[0]


def test_the_plant_is_n_tau_over_2_m_omega(default):
    plant = default.plant(TAU)
    assert plant.tau == TAU and plant.f0 == default.f0 and plant.k_T is None
    assert (
        pytest.approx(1e6 * default.N * TAU / (2 * default.m * 2 * math.pi * default.f0), rel=1e-12)
        == plant.G
    )
    static = 1e6 * default.N / default.c  # um/V; at resonance Q times that
    assert abs(plant.G / (static * plant.Q) - 1) < 1e-12
    assert abs(plant.steady(100.0, default.f0)) == pytest.approx(100 * plant.G, rel=1e-12)


def test_the_default_layout_s_gain_is_near_the_scenes_one(default):
    """0.02 um/V of the scenes within a factor of 3: nothing in the paper pins it better."""
    assert 0.02 / 3 < default.plant(TAU).G < 0.02 * 3


def test_w_at_a_point_scales_the_gain(default):
    there = default.plant(TAU, at=(0.0, 0.0))
    assert abs(there.G / (default.plant(TAU).G * abs(default.weight(0.0, 0.0))) - 1) < 1e-12


def test_a_tau_that_the_air_does_not_allow_is_named(default):
    with pytest.warns(RangeWarning, match="radiation"):
        default.plant(9e-3)


@pytest.mark.study
def test_a_measured_frequency_calibrates_the_modulus(folder):
    plate = calibrated(DEFAULT, 32300.0, per_wavelength=COARSE, cache=folder)
    found = modes(plate, 32300.0, per_wavelength=COARSE, cache=folder).mode
    assert found.f0 == pytest.approx(32300.0, rel=2e-5)
    assert 60e9 < plate.material.E < 80e9  # of an aluminium alloy


# --- what drives and senses the neighbours
# --------------------------------------------------------------------------------------


def across(neighbour):
    """1 for a shape that is even over the width, -1 for an odd one."""
    y = np.linspace(0, 0.138, 41)
    shape = neighbour.weight(np.linspace(0, 0.198, 50)[:, None], y)
    return float(np.sign(np.sum(shape * shape[:, ::-1])))


def test_two_ceramics_in_parallel_cancel_odd_neighbours_and_not_even_ones(default):
    odd = [n for n in default.neighbours if across(n) < 0]
    even = [n for n in default.neighbours if across(n) > 0]
    assert odd and even
    assert all(abs(n.drive) < 1e-9 and abs(n.sense) < 1e-9 for n in odd)
    assert max(abs(n.sense) for n in even) > 0.1


def test_one_ceramic_alone_sees_odd_neighbours():
    one = replace(DEFAULT, patches=DEFAULT.patches[:-1])
    found = modes(one, per_wavelength=COARSE, cache=False).mode
    assert max(abs(n.sense) for n in found.neighbours if across(n) < 0) > 0.1


@pytest.mark.study
def test_the_sign_of_a_shape_does_not_matter(default):
    """drive times sense is what a voltage shows of a neighbour: the same from the other corner, up to its own
    parity."""
    patches = tuple(p.mirrored(DEFAULT.length, None) for p in DEFAULT.patches)
    turned = modes(replace(DEFAULT, patches=patches), cache=False).mode
    for one, other in zip(default.neighbours, turned.neighbours, strict=True):
        assert other.f0 == pytest.approx(one.f0, rel=1e-6)
        assert other.drive * other.sense == pytest.approx(one.drive * one.sense, abs=1e-4)


def test_poling_against_the_mode_s_parity_drives_nothing():
    """All alike drive no mode that is odd along the length."""
    alike = tuple(replace(p, poling=1) for p in DEFAULT.patches)
    found = modes(replace(DEFAULT, patches=alike), per_wavelength=4.0, cache=False).mode
    assert abs(found.N) < 1e-9
    with pytest.raises(StimulatorError, match="drive the mode"):
        found.plant(TAU)


# --- weights ----------------------------------------------------------------------------------------------


def test_w_is_the_amplitude_in_the_middle(default):
    x, y = np.linspace(0.2 * 0.198, 0.8 * 0.198, 401), np.linspace(0.2 * 0.138, 0.8 * 0.138, 301)
    assert 2 * np.mean(default.weight(x[:, None], y) ** 2) == pytest.approx(1.0, rel=0.01)
    corners = [default.ceramic(x, y, 7e-3) for x, y in product((4.5e-3, 0.1935), (4.5e-3, 0.1335))]
    assert all(0.9 < corner < 3.5 for corner in corners)


def test_a_finger_s_weight_is_the_mean_over_its_contact(default):
    """Beside a plain sum over a fine raster of the disc; and one on average where W is taken."""
    u = np.linspace(-1, 1, 201)
    inside = u[:, None] ** 2 + u**2 < 1
    for x, y in ((0.099, 0.069), (0.060, 0.045), (0.1037, 0.069)):
        disc = default.weight(x + 4e-3 * u[:, None], y + 4e-3 * u) ** 2
        assert default.contact(x, y) == pytest.approx(2 * disc[inside].mean(), abs=0.02)
    x, y = np.linspace(0.045, 0.153, 300)[:, None], np.linspace(0.035, 0.103, 200)
    assert default.contact(x, y).mean() == pytest.approx(1.0, abs=0.03)
    assert np.ptp(default.contact(x, y)) > 0.2  # a finger that moves over nodal lines changes the plate


def test_a_small_contact_feels_the_nodal_lines(default):
    small = default.contact(np.linspace(0.06, 0.14, 801), 0.069, diameter_m=0.5e-3)
    assert small.min() < 0.05 and small.max() > 1.2


# --- the cache --------------------------------------------------------------------------------------------


def test_a_second_call_reads_what_the_first_one_found(tmp_path, monkeypatch):
    first = modes(BARE, per_wavelength=4.0, cache=tmp_path)
    monkeypatch.setattr(fe, "_solved", None)  # whoever computes now fails
    second = modes(BARE, per_wavelength=4.0, cache=tmp_path)
    assert (second.mode.f0, second.mode.m, second.straight) == (first.mode.f0, first.mode.m, first.straight)
    np.testing.assert_array_equal(second.mode.shape.values, first.mode.shape.values)
    with pytest.raises(TypeError):
        modes(BARE, per_wavelength=4.1, cache=tmp_path)  # another request


def test_a_spoilt_or_forbidden_cache_is_done_without(tmp_path):
    first = modes(BARE, per_wavelength=4.0, cache=tmp_path)
    (kept,) = tmp_path.glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:1000])
    assert modes(BARE, per_wavelength=4.0, cache=tmp_path).mode.f0 == first.mode.f0
    (tmp_path / "file").write_text("not a folder")
    assert modes(BARE, per_wavelength=4.0, cache=tmp_path / "file").mode.f0 == first.mode.f0
    assert [p.suffix for p in tmp_path.iterdir() if p.name != "file"] == [".npz"]


# --- what cannot be
# -----------------------------------------------------------------------------------------------------------


def patch(**changed):
    return Patch(**({"x": 0.1, "y": 0.07, "length": 9e-3, "width": 9e-3} | changed))


def plate(*patches, **changed):
    return PlateGeometry(patches=patches, **changed)


def coarse(of, per_wavelength=4.0, **options):
    return modes(of, per_wavelength=per_wavelength, cache=False, **options)


WRONG = {
    "two patches overlap": (lambda: plate(patch(), patch(x=0.108)), r"patches\[1\].*overlaps patches\[0\]"),
    "two patches in one place": (lambda: plate(patch(), patch()), "overlaps"),
    "a sensor under a driver": (lambda: plate(patch(), patch(role="sense")), "overlaps"),
    "off the left edge": (lambda: plate(patch(x=0.004)), r"patches\[0\].*x from -0.0005"),
    "off the right edge": (lambda: plate(patch(x=0.195)), "on the plate"),
    "off the upper edge": (lambda: plate(patch(), patch(y=0.2)), r"patches\[1\].*y from"),
    "a patch in millimetres": (lambda: plate(patch(x=100.0)), "on the plate, from 0 to 0.198 m"),
    "a patch nowhere": (lambda: patch(x=math.nan), "patch.x"),
    "a patch of no length": (lambda: patch(length=0.0), "patch.length"),
    "a patch of negative thickness": (lambda: patch(thickness=-1e-4), "patch.thickness"),
    "a patch thicker than the plate": (lambda: plate(patch(thickness=2e-3)), r"patches\[0\].thickness"),
    "a poling of two": (lambda: patch(poling=2), "patch.poling"),
    "an unknown role": (lambda: patch(role="heat"), "patch.role"),
    "a patch of steel": (lambda: patch(material=BARE.material), "patch.material"),
    "a patch that is none": (lambda: plate("patch"), r"patches\[0\]"),
    "a plate of no width": (lambda: plate(width=0.0), "plate.width"),
    "a plate of endless length": (lambda: plate(length=math.inf), "plate.length"),
    "a thickness in words": (lambda: plate(thickness="1.2 mm"), "plate.thickness"),
    "a block": (lambda: plate(thickness=0.05), "plate.thickness"),
    "a modulus of zero": (lambda: Material("jelly", 0.0, 1e3, 0.3), "jelly.E"),
    "no density": (lambda: Material("void", 1e9, math.nan, 0.3), "void.rho"),
    "Poisson's ratio of one half": (lambda: Material("rubber", 1e6, 1e3, 0.5), "rubber.nu"),
    "a mesh too coarse": (lambda: coarse(BARE, 2.0), "too coarse for the wavelength"),
    "a mesh too coarse for mindlin": (lambda: coarse(BARE, 1.0, theory="mindlin"), "too coarse"),
    "a mesh too fine": (lambda: coarse(BARE, 40.0), "unknowns"),
    "an unknown theory": (lambda: coarse(BARE, theory="timoshenko"), "theory.*kirchhoff"),
    "one thick patch on a quarter": (
        lambda: coarse(plate(patch(x=0.05, y=0.035, length=0.09, width=0.06, thickness=1.2e-3))),
        "no mode with straight nodal lines",
    ),
    "a frequency of zero": (lambda: coarse(BARE, near=0.0), "near"),
    "a frequency that is none": (lambda: coarse(BARE, near=math.nan), "near"),
    "no company": (lambda: coarse(BARE, company=-1.0), "company"),
    "too slow for nodal lines": (lambda: coarse(BARE, near=100.0), "near.*wavelengths along the plate"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_geometry_is_refused_by_name(name):
    make, key = WRONG[name]
    with pytest.raises(StimulatorError, match=key):
        make()


@pytest.mark.parametrize(
    ("ask", "key"),
    [
        (lambda mode: mode.weight(0.2, 0.05), "x_m"),
        (lambda mode: mode.weight(0.1, -1e-3), "y_m"),
        (lambda mode: mode.weight(math.nan, 0.05), "x_m"),
        (lambda mode: mode.contact(0.1, 0.05, diameter_m=0.0), "diameter_m"),
        (lambda mode: mode.plant(0.0), "tau"),
        (lambda mode: mode.plant(math.nan), "tau"),
        (lambda mode: mode.plant(TAU, at=(0.1, 0.3)), "y_m"),
    ],
)
def test_a_wrong_question_is_refused_by_name(default, ask, key):
    with pytest.raises(StimulatorError, match=key):
        ask(default)


def test_a_bare_plate_has_a_mode_that_nothing_drives(folder):
    found = modes(BARE, per_wavelength=4.0, cache=folder)
    assert found.mode.uniformity > STRAIGHT and found.mode.N == 0
    with pytest.raises(StimulatorError, match="drive the mode"):
        found.mode.plant(TAU)
    assert all(math.isnan(n.drive) for n in found.mode.neighbours)


def test_a_thick_plate_in_thin_theory_is_named(tmp_path):
    """Also where the modes are read from the cache."""
    thick = PlateGeometry(0.1, 0.08, 4e-3)
    for _ in range(2):
        with pytest.warns(RangeWarning, match="mindlin"):
            modes(thick, 40e3, cache=tmp_path)


def test_a_poling_turned_round_drives_as_well():
    """All patches of the other direction: the same plant, and neighbours as loud."""
    layout = replace(DEFAULT, patches=DEFAULT.patches)
    one = modes(layout, per_wavelength=4.0, cache=False).mode
    turned = [replace(p, poling=-pole) for p, pole in zip(DEFAULT.patches, one.poling, strict=True)]
    other = modes(replace(DEFAULT, patches=turned), per_wavelength=4.0, cache=False).mode
    assert abs(other.N / one.N - 1) < 1e-9
    for a, b in zip(one.neighbours, other.neighbours, strict=True):
        assert b.drive * b.sense == pytest.approx(a.drive * a.sense, abs=1e-9)


def test_layouts_side_by_side(folder):
    rows = table({"one": modes(DEFAULT, cache=folder), "two": modes(DEFAULT, cache=folder)}, TAU)
    lines = markdown(rows).splitlines()
    assert lines[0].startswith("| layout | f0 (Hz) |") and len(lines) == 4
    assert "| one | 31131 |" in lines[2] and "+128 (" in lines[2]
