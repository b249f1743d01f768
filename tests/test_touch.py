"""A touch as a whole: contrasts, what is absent, position noise, predictions of the paper's test, logs."""

import dataclasses
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import study
from scipy.stats import t as t_distribution

import stimulator
import sysid
from stimulator import (
    CornerForces,
    Finger,
    Intensities,
    Observer,
    Prior,
    Stroke,
    TouchScene,
    predicted,
    run_all,
)
from stimulator.contrast import plateau
from stimulator.experiment import quantile
from stimulator.filters import Kalman, OnePole
from stimulator.friction import Exponential, PartialLevitation
from stimulator.observer import preference
from stimulator.texture import Square
from sysid import Plant, Profile, Scene
from sysid.scene import EFFECTS

ROOT = Path(__file__).parents[1]
FILES = ROOT / "data" / "synthetic" / "touch_scenes"
PLANT = Plant(0.02, 5e-3 / np.log(20), 32300.0, -10.16)
RATE, ROWS = 1e4, 3201  # 0.32 s, in which a finger crosses four whole periods
FINGERS = {"L1": EFFECTS["finger_damping"](), "L2": EFFECTS["finger_damping"](law="power", exponent=0.6)}
LAWS = {"F1": Exponential(), "F2": PartialLevitation()}
PAPER = {"method": "paper", "voltage_limit": 350.0}
FORCES = (0.1, 0.2, 0.5, 1.0, 1.5)  # N


def plate(finger="L1", rows=ROWS):
    inputs = {"drive": 0.0, "frequency": 32300.0, "force": 0.0}
    held = {name: Profile.constant(v) for name, v in inputs.items()}
    return Scene(PLANT, held, rows, RATE, (FINGERS[finger],))


def grating(force, amplitude=1.0, finger="L1", **parts):
    stroke = Stroke.line(19.0, 80.0, 0.32, 69.0, force)
    return TouchScene(plate(finger), stroke, texture=Square(amplitude=amplitude), **parts)


@cache
def paper(amplitude):
    """The paper's loop as the published numbers have it: Wd and Wq are read at once, without a demodulator's
    delay."""
    return dataclasses.replace(grating(1.5, amplitude, loop=PAPER).designed, demodulator=None)


@cache
def touches():
    """{(amplitude, finger law, force): (open, closed)}, all strokes side by side."""
    keys = [(a, finger, force) for a in (1.0, 2.0) for finger in FINGERS for force in FORCES]
    scenes = [grating(force, a, finger, forces=CornerForces(noise=0.0)) for a, finger, force in keys]
    loops = {a: paper(a) for a in (1.0, 2.0)}
    closed = run_all(
        [dataclasses.replace(s, loop=loops[key[0]]) for s, key in zip(scenes, keys, strict=True)]
    )
    return {key: (scene.run(), touch) for key, scene, touch in zip(keys, scenes, closed, strict=True)}


def contrasts(amplitude, finger, force, law):
    return [plateau(t.x, LAWS[law].friction(t.W, t.force), 5.0) for t in touches()[amplitude, finger, force]]


@pytest.mark.parametrize(
    "amplitude, law, force, opened, closed",
    [
        (1.0, "F2", 0.2, 0.336, 0.588), (1.0, "F2", 0.5, 0.193, 0.459), (1.0, "F2", 1.0, 0.130, 0.386),
        (1.0, "F1", 0.2, 0.390, 0.552), (1.0, "F1", 0.5, 0.329, 0.552), (1.0, "F1", 1.0, 0.289, 0.552),
        (2.0, "F2", 0.2, 0.825, 0.978), (2.0, "F2", 0.5, 0.574, 0.914), (2.0, "F2", 1.0, 0.417, 0.841),
        (2.0, "F1", 0.2, 0.679, 0.771), (2.0, "F1", 0.5, 0.621, 0.771), (2.0, "F1", 1.0, 0.575, 0.771),
    ],
)  # fmt: skip
def test_contrasts_are_those_of_an_independent_simulation(amplitude, law, force, opened, closed):
    """Of one written before this package, with its own envelope and the loop's equations in a Python loop."""
    assert contrasts(amplitude, "L1", force, law) == pytest.approx([opened, closed], abs=0.005)


@pytest.mark.parametrize(
    "amplitude, law, force, published",
    [
        (1.0, "F2", 0.2, {0.11: 0.985, 0.15: 0.982, 0.18: 0.974, 0.25: 0.941, 0.30: 0.912}),
        (1.0, "F2", 0.5, {0.11: 0.985, 0.15: 0.985, 0.18: 0.985, 0.25: 0.981, 0.30: 0.973}),
        (1.0, "F2", 1.0, {0.11: 0.985, 0.15: 0.985, 0.18: 0.985, 0.25: 0.985, 0.30: 0.983}),
        (1.0, "F1", 0.2, {0.18: 0.909}), (1.0, "F1", 0.5, {0.18: 0.968}), (1.0, "F1", 1.0, {0.18: 0.981}),
        (2.0, "F2", 0.2, {0.18: 0.748}), (2.0, "F2", 0.5, {0.18: 0.957}), (2.0, "F2", 1.0, {0.18: 0.983}),
        (2.0, "F1", 0.2, {0.18: 0.691}), (2.0, "F1", 0.5, {0.18: 0.802}), (2.0, "F1", 1.0, {0.18: 0.873}),
    ],
)  # fmt: skip
def test_the_closed_loop_is_preferred_as_often(amplitude, law, force, published):
    opened, closed = contrasts(amplitude, "L1", force, law)
    assert opened < closed
    for weber, p in published.items():
        assert preference(closed, opened, weber, lapse=0.03) == pytest.approx(p, abs=0.005)


def test_open_loop_settles_at_what_the_finger_leaves():
    for force, share in ((0.5, 0.59), (1.5, 0.50)):  # physics of a finger: 41 % and 50 % are taken
        opened, closed = touches()[1.0, "L1", force]
        on = (opened.reference > 0) & (np.mod(opened.x, 5.0) > 2.0)  # 25 ms into a plateau: 15 time constants
        assert np.median(opened.W[on]) == pytest.approx(share, abs=0.005)
        late = (closed.reference > 0) & (np.mod(closed.x, 5.0) > 2.0)
        assert np.median(closed.W[late]) == pytest.approx(1.0, abs=0.005)


# --- the grating under 1.5 N, and its edges
# ---------------------------------------------------------------------


@cache
def fast():
    """{mm/s: (open, closed)} of strokes without force sensors."""
    speeds = (20.0, 100.0, 200.0, 500.0)
    scenes = [dataclasses.replace(grating(1.5), stroke=Stroke.line(19.0, v, 0.32, 69.0, 1.5)) for v in speeds]
    closed = run_all(scenes, paper(1.0))
    return {v: (s.run(), touch) for v, s, touch in zip(speeds, scenes, closed, strict=True)}


def depth(touch):
    """Mean of the largest amplitude in a period less that of the smallest, in whole periods."""
    cell = np.floor(touch.x / 5.0 + 1e-9)
    rows = [touch.W[cell == k] for k in np.unique(cell)[1:-1]]
    return np.mean([W.max() for W in rows]) - np.mean([W.min() for W in rows])


@pytest.mark.parametrize(
    "speed, opened, closed", [(20.0, 0.5, 1.0), (100.0, 0.5, 1.0), (200.0, 0.5, 1.0), (500.0, 0.5, 0.93)]
)
def test_the_loop_keeps_the_depth_of_the_grating(speed, opened, closed):
    assert [depth(t) for t in fast()[speed]] == pytest.approx([opened, closed], abs=0.005)


def test_the_error_of_the_amplitude_at_100_mm_per_s():
    late = fast()[100.0][0].time > 0.0125  # from the first edge on
    found = [np.sqrt(np.mean((t.W - t.reference)[late] ** 2)) for t in fast()[100.0]]
    assert found == pytest.approx([0.37, 0.13], abs=0.01)  # two digits are published


def test_edges_are_as_wide_as_the_response_is_slow():
    """5 ms and 1.5 ms (5 %) of an untouched plate are 0.5 and 0.15 mm at 100 mm/s; 20 edges of 5 mm a
    second."""
    stroke = Stroke.line(19.0, 100.0, 0.32, 69.0, 0.0)
    scene = dataclasses.replace(grating(0.0), stroke=stroke)
    loop = paper(1.0)
    for touch, width in ((scene.run(), 0.5), (scene.run(loop), 0.15)):
        rising = np.flatnonzero(np.diff(touch.reference) > 0)[1:] + 1
        assert len(rising) == 6 and np.allclose(np.diff(touch.time[rising]), 0.05, atol=2e-4)
        plateau = [touch.W[k : k + 240] for k in rising]
        settled = [np.flatnonzero(np.abs(W - 1.0) > 0.05)[-1] + 1 for W in plateau]
        assert np.mean(settled) / RATE * 100.0 == pytest.approx(width, abs=0.03)


# --- the paper's test of volunteers -------------------------------------------------------------------------


def cells():
    found = {}
    for a in (1.0, 2.0):
        for finger in FINGERS:
            for law in LAWS:
                pairs = np.array([contrasts(a, finger, force, law) for force in FORCES])
                found[a, finger, law] = Intensities(np.array(FORCES), *pairs.T)
    return found


def test_open_is_below_closed_in_every_cell():
    assert all(np.all(cell.opened < cell.closed) for cell in cells().values())


def test_46_of_50_lies_within_what_was_foreseen():
    """A weak test: the prior of `Prior`, written before, allows much. 46 is in no number of it."""
    found = predicted(cells(), Prior())
    mixture = np.mean(list(found.values()), axis=0)
    assert quantile(mixture, 0.025) <= 46 <= quantile(mixture, 0.975)
    assert (
        quantile(mixture, 0.025) >= 28 and mixture[46] > 0.02
    )  # and it does not allow everything: half of 50 is guessing
    assert mixture[:26].sum() < 0.01


# --- position noise -----------------------------------------------------------------------------------------

SENSORS = {
    "none": CornerForces(noise=0.0),
    "raw": CornerForces(),
    "one pole": CornerForces(filter=OnePole(5e-3)),
    "kalman": CornerForces(filter=Kalman()),
}
SEEDS = 6


@cache
def noisy():
    """{(sensors, force): closed-loop strokes to and fro, up to 236 mm/s, one for each seed}, side by side."""
    keys = [
        (kind, force, seed)
        for force in (0.2, 0.5, 1.0)
        for kind in SENSORS
        for seed in range(SEEDS if kind != "none" else 1)
    ]
    scenes = []
    for kind, force, seed in keys:
        stroke = Stroke.to_and_fro(99.0, 45.0, 1.2, 69.0, force, 1.2)
        parts = {"stroke": stroke, "forces": SENSORS[kind], "friction": LAWS["F2"], "seed": seed}
        scenes.append(dataclasses.replace(grating(force), plate=plate(rows=12001), **parts))
    found = {}
    for (kind, force, _), touch in zip(keys, run_all(scenes, paper(1.0)), strict=True):
        found.setdefault((kind, force), []).append(touch)
    return found


def spectral(touch):
    return stimulator.spectral_contrast(touch)


def wrong(kind, force):
    """The share of the time in which what is asked for is not what is under the finger."""
    found = [np.mean((t.reference > 0) != (np.mod(t.x, 5.0) < 2.5)) for t in noisy()[kind, force]]
    return float(np.mean(found))


@pytest.mark.parametrize(
    "force, none, raw, kalman",
    [(0.2, 0.783, 0.140, 0.646), (0.5, 0.553, 0.425, 0.521), (1.0, 0.437, 0.409, 0.430)],
)
def test_position_noise_destroys_a_grating_where_the_finger_is_light(force, none, raw, kalman):
    """Of that independent simulation, one stroke each: 0.005 as without noise, and where it is random as far
    as one more draw lies from the mean of `SEEDS`, once in a hundred."""
    assert spectral(noisy()["none", force][0]) == pytest.approx(none, abs=0.005)
    for kind, published in (("raw", raw), ("kalman", kalman)):
        found = np.array([spectral(t) for t in noisy()[kind, force]])
        spread = t_distribution.ppf(0.995, SEEDS - 1) * np.std(found, ddof=1) * np.sqrt(1 + 1 / SEEDS)
        assert found.mean() == pytest.approx(published, abs=0.005 + spread)
    assert raw < kalman < none


def test_a_filter_that_lags_has_the_wrong_edge():
    """One pole of 5 ms and 1 ms of latency are 1.2 mm behind at 200 mm/s, of 2.5; the prediction is not."""
    assert wrong("one pole", 0.5) == pytest.approx(0.33, abs=0.04)
    assert wrong("kalman", 0.5) == pytest.approx(0.09, abs=0.02)


def test_a_plateau_hides_what_the_spectrum_shows():
    clean, raw = noisy()["none", 0.2][0], noisy()["raw", 0.2]
    assert stimulator.plateau_contrast(clean) - np.mean([stimulator.plateau_contrast(t) for t in raw]) < 0.05
    assert np.mean([spectral(t) for t in raw]) < 0.3 * spectral(clean)
    assert "lies below what the sensors resolve" in raw[0].warnings[0] and clean.warnings == ()


# --- what is absent -----------------------------------------------------------------------------------------

PARTS = {
    "stroke": {"stroke": Stroke.line(20.0, 80.0, 0.1, 69.0, 0.5)},
    "forces": {"forces": CornerForces(noise=2e-3)},
    "texture": {"texture": Square()},
    "friction": {"friction": PartialLevitation()},
    "loop": {"loop": PAPER},
    "observer": {"observer": Observer()},
}


def short(*names):
    given = {}
    for name in names:
        given |= PARTS[name]
    noise = EFFECTS["white_noise"](std=0.01)
    bare = plate(rows=1001)
    return TouchScene(dataclasses.replace(bare, effects=(*bare.effects, noise)), **given, seed=3)


COLUMNS = ("time", "Wd", "Wq", "measured", "V", "f", "reference")


@pytest.mark.parametrize(
    "without, names",
    [
        (("friction",), ("stroke", "forces", "texture", "friction")),
        study(("observer",), ("stroke", "texture", "friction", "loop", "observer")),
        (("friction", "observer"), ("stroke", "forces", "texture", "loop", "friction", "observer")),
    ],
)
def test_what_comes_after_the_plate_changes_no_bit_of_it(without, names):
    whole, less = short(*names).run(), short(*[n for n in names if n not in without]).run()
    for name in COLUMNS:
        assert np.array_equal(getattr(whole, name), getattr(less, name)), name
    assert less.judgement is None and (less.friction is None) == ("friction" in without)


def test_a_touch_without_parts_is_the_plate_s_own_scene():
    scene = short()
    log, touch = scene.plate.simulate(3), scene.run()
    assert np.array_equal(touch.measured, log.response) and np.array_equal(touch.V, log.drive)
    assert (touch.x, touch.force, touch.sensed, touch.friction, touch.compared, touch.judgement) == (
        None,
    ) * 6
    other = short("stroke").run()
    assert np.array_equal(other.V, touch.V) and other.force[0] == 0.5


LOADS = """
import sys
from stimulator import TouchScene
for path in sys.argv[1:]:
    touch = TouchScene.from_toml(path).run()
    touch.warnings, touch.judgement, touch.log()
    print(*sorted(name for name in sys.modules if name.split(".")[0] in ("stimulator", "controller", "skfem")))
"""
OWN = {
    None: ({"errors", "touch", "toml", "stroke", "limits"}, ""),
    "finger": ({"finger"}, "width_mm = 9"),
    "friction": ({"friction"}, 'law = "partial_levitation"'),
    "texture": ({"texture", "draws"}, 'kind = "square"\namplitude_um_peak = 1.0'),
    "forces": ({"forces", "filters"}, "noise_mN = 1.5"),
}


def test_what_a_file_does_not_name_is_not_imported(tmp_path):
    """In a fresh process, one file after the other: each table brings its own modules, and nothing else
    does."""
    (tmp_path / "plate.toml").write_text(
        (FILES / "plate.toml").read_text().replace("duration_s = 1.2", "rows = 101")
    )
    text = 'plate_scene = "plate.toml"\n[stroke]\nx_mm = 50\ny_mm = 69\nforce_N = 0.5\n'
    paths = [tmp_path / f"{table}.toml" for table in OWN]
    for path, (table, (_, content)) in zip(paths, OWN.items(), strict=True):
        path.write_text(text + (f"[{table}]\n{content}\n" if table else ""))
    command = [sys.executable, "-c", LOADS, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    expected = {"stimulator"}
    for line, (names, _) in zip(done.stdout.splitlines(), OWN.values(), strict=True):
        expected |= {f"stimulator.{name}" for name in names}
        assert set(line.split()) == expected


# --- the whole, from a file ---------------------------------------------------------------------------------


@cache
def from_file():
    return TouchScene.from_toml(FILES / "grating.toml").run()


@pytest.mark.always
def test_a_file_with_everything():
    touch = from_file()
    assert touch.loop.method == "paper" and touch.warnings == ()
    assert touch.judgement > 0.9 and touch.friction.max() == pytest.approx(0.8, abs=1e-3)
    assert np.max(np.abs(touch.sensed.x - touch.scene.stroke.x.at(touch.sensed.time))) < 3.0
    assert stimulator.plateau_contrast(touch.compared) < stimulator.plateau_contrast(touch)


def test_a_finger_on_nodal_lines_is_felt_at_the_rate_of_the_lines():
    driven = plate(rows=12001)
    driven = dataclasses.replace(driven, inputs=driven.inputs | {"drive": Profile.constant(50.0)})
    still = TouchScene(driven, Stroke.line(20.0, 80.0, 1.2, 69.0, 1.0))
    moved = dataclasses.replace(still, finger=Finger(width=6.0))
    W = moved.run().W[3000:]
    spectrum = np.abs(np.fft.rfft((W - W.mean()) * np.hanning(len(W)), 1 << 16))
    lines = np.fft.rfftfreq(1 << 16, 1 / RATE)[np.argmax(spectrum)]
    assert lines == pytest.approx(80.0 / (18.7 / 2), rel=0.05)  # half a wavelength apart
    assert np.ptp(still.run().W[3000:]) < 1e-6 < 0.05 < np.ptp(W)
    assert np.ptp(moved.run(paper(1.0)).W[3000:]) < 0.3 * np.ptp(W)


@pytest.mark.study
def test_logs_of_touches_are_those_of_the_plate(tmp_path):
    """A finger that comes down tells its own damping, and G, tau and f0 stay, where a loop drives."""
    force = Profile(np.array([0.0, 0.03, 0.035, 0.2]), np.array([0.0, 0.0, 1.0, 1.0]), held=False)
    stroke = Stroke(
        Profile(np.array([0.0, 0.2]), np.array([20.0, 60.0]), held=False), Profile.constant(69.0), force
    )
    bare = plate(rows=1501)
    noise = EFFECTS["white_noise"](std=0.005)
    scene = TouchScene(
        dataclasses.replace(bare, effects=(*bare.effects, noise)),
        stroke,
        texture=Square(),
        loop=PAPER,
        seed=5,
    )
    touch = scene.run()
    sysid.write_log(touch.log(), tmp_path / "touch.csv", further=touch.columns())
    fit = sysid.fit(sysid.read_logs(tmp_path / "touch.csv"))
    assert fit.result == sysid.Result.successful, fit.warnings
    found = {name: fit.parameters[name] for name in ("G", "tau", "f0")}
    for name, truth in (("G", PLANT.G), ("tau", PLANT.tau), ("f0", PLANT.f0)):
        assert abs(found[name].value - truth) < 4 * found[name].std, (name, found[name])
