"""The scene engine against the carrier's equation of motion, matrix exponentials, closed forms, and itself in
other pieces."""

import dataclasses
import gc
import tracemalloc
from collections import Counter
from fractions import Fraction
from itertools import pairwise

import carrier
import jax
import jax.numpy as jnp
import numpy as np
import programs
import pytest
from carrier import PLATE, random_scene
from conftest import study
from mpmath import mp
from scipy.integrate import solve_ivp
from scipy.special import erf

from sysid import Plant, Profile, Scene
from sysid.model.plant import expm1
from sysid.scene import EFFECTS, effects, engine, timeline
from sysid.scene.effects import Motion
from sysid.scene.simulation import resolved

# expm scales and squares a norm of about 100, 60 times over: 60 * 100 * 2e-16, all errors of one sign
EXPM = 1e-12


def made(*names, **values):
    """Effects by name, with their defaults or `values[name]`."""
    return tuple(EFFECTS[name](**values.get(name, {})) for name in names)


def constant(drive=100.0, frequency=32290.0, **inputs):
    return {
        name: Profile.constant(v) for name, v in ({"drive": drive, "frequency": frequency} | inputs).items()
    }


def error(found, truth):
    """Largest deviation over the largest response."""
    return np.max(np.abs(found - truth)) / np.max(np.abs(truth))


def rows_of(scene, **changes):
    return dataclasses.replace(scene, **changes).simulate().response


# --- the plate
# -----------------------------------------------------------------------------------------------------------

TOUCHED = made("finger_damping", "finger_detuning")
FEEDTHROUGH = {
    "feedthrough": {"d": 1e-3, "q": -2e-3},
    "rotation": {"angle": 30.0},
    "offset": {"d": 0.1, "q": -0.2},
}
NEIGHBOUR = {"second_mode": {"k_T": -3.0}, "two_ceramics": {"resistance": 2e4}, "delay": {"time": 1.23e-4}}
DRIVE = made(
    "inverter", "amplifier_limit", inverter={"supply": 2.0, "law": "sine"}, amplifier_limit={"limit": 2.3}
)
SETS = {
    "bare": (),
    "finger": TOUCHED,
    "finger power law": made("finger_damping", finger_damping={"law": "power", "exponent": 0.6}) + DRIVE,
    "whole sensor": made(
        "second_mode", "two_ceramics", "feedthrough", "rotation", "lock_in", "delay", "offset",
        **FEEDTHROUGH, **NEIGHBOUR, lock_in={"order": 2},
    ),
    "phase reset": made("phase_reset", "frequency_resolution", "delay", frequency_resolution={"step": 7.0}),
    "everything": made(
        "finger_damping", "finger_detuning", "second_mode", "phase_reset", "two_ceramics", "feedthrough", "rotation", "lock_in",
        "delay", "offset", **FEEDTHROUGH, **NEIGHBOUR, lock_in={"order": 3},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", [study(name) if name == "whole sensor" else name for name in SETS])
def test_exact_rows_are_those_of_the_matrix_exponential(name):
    for seed in range(3):
        scene = random_scene(seed, SETS[name], plant=PLATE)
        assert error(scene.simulate().response, carrier.by_expm(scene)) < EXPM


@pytest.mark.parametrize("Q", [3.0, study(30.0), 200.0])
@pytest.mark.parametrize("name", ["bare", "everything"])
def test_exact_rows_are_those_of_the_carrier(Q, name):
    f0 = 900.0 if Q < 100 else 3000.0
    plant = Plant(0.3, Q / (np.pi * f0), f0, -f0 / Q / 20)
    chosen = {
        "second_mode": {"G": 0.03, "tau": plant.tau / 2, "f0": 1.2 * f0, "k_T": 0.0},
        "two_ceramics": {"mismatch": 0.4},
    }
    chosen |= {"two_ceramics": {"resistance": 1e5}, "frequency_resolution": {"step": f0 / Q / 10}}
    names = [e.name for e in SETS[name] if e.name not in ("lock_in", "delay")]
    scene = random_scene(int(Q), made(*names, **(FEEDTHROUGH | chosen)), plant=plant)
    scene = dataclasses.replace(scene, rows=30)
    # 1e-12 a step of the integrator, some thirty steps a period, errors of one sign over the periods of a few
    # time constants
    assert error(scene.simulate().response, carrier.by_carrier(scene)) < 1e-12 * 30 * (10 + 3 * Q)


def test_a_finger_leaves_the_initial_slope_and_halves_amplitude_and_time_constant():
    inputs = constant(frequency=PLATE.f0, temperature=24.0, force=1.5)
    scene = Scene(PLATE, inputs, 60, 60 / PLATE.tau, made("finger_damping"), fidelity="envelope")
    touched, free = scene.simulate().response, rows_of(scene, effects=())
    # (1 - e^(-2x))/2 over 1 - e^(-x), x = t/tau: one slope b = G/tau at first, half the height and half the
    # time at last
    x = np.arange(60) / 60
    np.testing.assert_allclose(touched[1:] / free[1:], 0.5 * (1 + np.exp(-x[1:])), rtol=1e-13)
    assert touched[1] == pytest.approx(PLATE.G * 100 / 60, rel=1 / 60)
    assert abs(rows_of(scene, rate=1 / PLATE.tau)[-1]) == pytest.approx(PLATE.G * 50, rel=1e-13)


def test_a_finger_detunes_by_its_reactance():
    for ratio, shift in ((0.1, -9.5), (0.3, -28.6), (0.5, -47.7)):
        detuned = made("finger_damping", "finger_detuning", finger_detuning={"ratio": ratio})
        sweep = 32200 + 2.0 * np.arange(60)
        inputs = constant(force=1.5) | {"frequency": Profile(np.arange(60) / 1e4, sweep)}
        rows = Scene(PLATE, inputs, 60, 1e4, detuned, kind="steady").simulate().response
        crossing = np.interp(0, -rows.imag, sweep)
        assert crossing == pytest.approx(
            PLATE.f0 + shift, abs=0.1
        )  # a straight line between points 2 Hz apart of 190 Hz


def test_finger_and_detuning_share_one_finger():
    mine = made("finger_detuning", "finger_damping", finger_damping={"rho": 0.25})
    assert Scene(PLATE, constant(force=1.0), 5, 1e4, mine).effects[1].finger.rho == 0.25


def test_a_reset_on_a_row_is_read_before_the_frame_turns():
    steps = Profile([0.0, 3e-3], [32300.0, 32260.0])
    scene = Scene(PLATE, constant(temperature=24.0, force=0.0) | {"frequency": steps}, 60, 1e4)
    plain, reset = scene.simulate().response, rows_of(scene, effects=made("phase_reset"))
    np.testing.assert_allclose(
        reset[:31], plain[:31], rtol=0, atol=1e-14
    )  # row 30 is just before its inputs act
    assert abs(reset[31] - plain[31]) > 0.1


def test_what_leaks_into_a_row_is_the_drive_before_it():
    drive = Profile([0.0, 1e-3, 2.05e-3], [10.0, 0.0, 7.0])
    scene = Scene(PLATE, constant() | {"drive": drive}, 40, 1e4, fidelity="envelope")
    leaked = rows_of(scene, effects=made("feedthrough", feedthrough={"q": 1.0})) - scene.simulate().response
    before = np.array([0.0, *[10.0] * 10, *[0.0] * 10, *[7.0] * 19])  # no drive before the first row
    np.testing.assert_allclose(leaked, 1j * before, atol=1e-14)


# --- effects that the response itself decides
# -------------------------------------------------------------------------------

FELT = {
    "duffing": made("duffing", duffing={"softening": 25.0}),
    # a thermal time constant of 10 ms and 10 degC where it settles, so that a short log sees all of it
    "self_heating": made("self_heating", self_heating={"capacity": 4.4e-3, "loss": 0.44, "damping": 53.0}),
}


@pytest.mark.parametrize("name", FELT)
def test_softening_and_self_heating_are_of_second_order(name):
    """The envelope Z' = (-1/tau + j delta(|Z|^2, T)) Z + b V, integrated, against 1, 2, 4 and 8 steps between
    rows."""
    (effect,) = FELT[name]
    V, omega, rows, rate = 130.0, 2 * np.pi * 32290.0, 40, 2e3
    inputs = constant(V, 32290.0)
    scene = Scene(PLATE, inputs, rows, rate, (effect,), fidelity="envelope")

    def rate_of(t, y):
        z, heat = y[0], y[1].real
        w0 = 2 * np.pi * PLATE.f0
        if name == "duffing":
            w0 -= 2 * np.pi * effect.softening * abs(z) ** 2
        else:
            w0 += 2 * np.pi * PLATE.k_T * heat
        power = 0.5 * 53.0 * (omega * 1e-6 * abs(z)) ** 2
        warms = (power - effect.loss * heat) / effect.capacity if name == "self_heating" else 0.0
        return [(-1 / PLATE.tau + 1j * (w0 - omega)) * z + PLATE.G / PLATE.tau * V, warms]

    time = np.arange(rows) / rate
    truth, state = [0j], np.zeros(2, complex)
    for a, b in pairwise(time):
        state = solve_ivp(rate_of, (a, b), state, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        truth.append(state[0])
    errors = [error(rows_of(scene, substeps=n), np.array(truth)) for n in (4, 8, 16, 32)]
    ratios = np.array(errors[:-1]) / errors[1:]
    # second order quarters the error; third-order terms of steps tau/13 and finer change that by less than a
    # fifth
    assert np.all((ratios > 3.2) & (ratios < 4.8)), errors
    assert errors[-1] < 2e-4
    linear = rows_of(scene, effects=())
    assert error(linear, np.array(truth)) > 0.05  # the effect is there to be seen


@pytest.mark.parametrize("name", FELT)
def test_softening_and_self_heating_agree_with_the_carrier(name):
    plant = Plant(0.02, 30 / (np.pi * 3000), 3000.0, -10.16)
    scale = (3000.0 / 32300.0) ** 2
    chosen = {
        "duffing": {"softening": 8.0},
        "self_heating": {"capacity": 4.4e-3 * scale, "loss": 0.5 * scale, "damping": 53.0},
    }
    fx = made(
        name,
        "second_mode",
        second_mode={"f0": 3400.0, "tau": plant.tau / 2, "G": 1e-3, "k_T": -50.0},
        **chosen,
    )
    scene = random_scene(5, fx if name == "self_heating" else fx[:1], plant=plant, spacing=(0.1, 0.11))
    scene = dataclasses.replace(scene, rows=30)
    truth = carrier.by_carrier(scene, rtol=1e-11)
    coarse, fine = (error(rows_of(scene, substeps=n), truth) for n in (16, 32))
    assert fine < 1e-4
    assert 3.2 < coarse / fine < 4.8  # second order, the ripple at twice the carrier resolved


# --- the sensor
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 4])  # 2 and 3 stand in SETS
def test_the_lock_in_is_exact_also_where_it_is_as_slow_as_the_plate(order):
    for seed, tau in enumerate((50e-6, 0.3e-3, PLATE.tau, PLATE.tau * (1 + 1e-6))):
        filtered = made(
            "feedthrough", "rotation", "lock_in", **FEEDTHROUGH, lock_in={"order": order, "tau": tau}
        )
        scene = random_scene(seed, filtered, plant=PLATE)
        if seed >= 2:  # drive at the pole: detuning and filter cancel to rounding, z = 0
            damped = np.sqrt(PLATE.f0**2 - (2 * np.pi * PLATE.tau) ** -2)
            scene = dataclasses.replace(
                scene, inputs=scene.inputs | constant(frequency=damped, temperature=24.0)
            )
        assert error(scene.simulate().response, carrier.by_expm(scene)) < EXPM


def test_a_lock_in_forgets_over_any_spacing():
    filtered = made("feedthrough", "rotation", "lock_in", lock_in={"order": 4})
    for rate in (1e-3, 1e7):  # rows 2e7 and 2e-3 of the filter's time constants apart
        scene = Scene(PLATE, constant(temperature=24.0, force=0.0), 60, rate, filtered)
        rows = scene.simulate().response
        truth = carrier.by_expm(scene) if rate > 1 else np.append(0, [PLATE.steady(100.0, 32290.0)] * 59)
        assert error(rows, truth) < EXPM


def test_a_delay_shows_earlier_rows_and_nothing_before_the_scene():
    scene = random_scene(4, plant=PLATE)
    scene = dataclasses.replace(scene, rate=1e4)
    late = rows_of(scene, effects=made("delay", delay={"time": 7e-4}))
    np.testing.assert_allclose(
        late, np.append(np.zeros(7), scene.simulate().response[:-7]), rtol=0, atol=1e-13
    )
    never = rows_of(scene, effects=made("delay", delay={"time": 1.0}))
    assert not np.any(never)


def test_the_last_row_is_read_however_many_changes_there_are():
    rows = 64
    for changes in (256, 257, 258, 300):  # 63 + 257 intervals are what such a chunk is padded to
        times = np.linspace(0, (rows - 1) / 1e4, changes + 2)[1:-1] + 1e-7
        inputs = constant(temperature=24.0, force=0.0) | {
            "drive": Profile(times, 100 + 5.0 * (np.arange(changes) % 7))
        }
        scene = Scene(PLATE, inputs, rows, 1e4, fidelity="envelope")
        np.testing.assert_allclose(
            scene.simulate().response[-1], rows_of(scene, rows=70)[rows - 1], rtol=1e-13
        )


def test_one_row_is_a_row():
    assert rows_of(random_scene(0, plant=PLATE), rows=1).tolist() == [0]
    settled = Scene(PLATE, constant(), 1, 1e4, kind="steady").simulate().response
    np.testing.assert_allclose(settled, PLATE.steady(100.0, 32290.0), rtol=1e-14)


# eight sets of effects on a few settled rows: eight programs would take longer than the arithmetic
@jax.disable_jit()
def test_the_sensor_s_closed_forms():
    sweep = Profile(np.arange(64) / 1e4, np.linspace(31800, 32800, 64), held=False)
    scene = Scene(PLATE, constant() | {"frequency": sweep}, 64, 1e4, kind="steady")
    f, z = sweep.values, PLATE.steady(100.0, sweep.values)
    values = {
        "feedthrough": {"d": 1e-3, "q": 2e-3},
        "rotation": {"angle": 30.0},
        "offset": {"d": 0.1, "q": -0.2},
    }
    lead = np.exp(1j * np.arctan(1 / (2 * np.pi * f * 1e4 * 4e-9)))
    turn = np.exp(1j * np.pi / 6)
    other = {"G": 0.004, "tau": 1e-3, "f0": 32500.0}
    closed = {
        "feedthrough": z + (1e-3 + 2e-3j) * 100.0,
        "rotation": z * turn,
        "offset": z + 0.1 - 0.2j,
        "two_ceramics": lead * (z + 0.025 * Plant(**other).steady(100.0, f)),
    }
    for name, truth in closed.items():
        fx = made(name, **values, two_ceramics={"resistance": 1e4})
        fx += made("second_mode", second_mode=other) if name == "two_ceramics" else ()
        np.testing.assert_allclose(rows_of(scene, effects=fx), truth, rtol=1e-13)  # a handful of roundings
    whole = made(
        "two_ceramics", "feedthrough", "rotation", "offset", **values, two_ceramics={"resistance": 1e4}
    )
    np.testing.assert_allclose(
        rows_of(scene, effects=whole), turn * (lead * z + 0.1 + 0.2j) + 0.1 - 0.2j, rtol=1e-13
    )
    stepped = rows_of(scene, effects=made("quantisation", quantisation={"step": 0.03}))
    np.testing.assert_allclose(
        stepped, 0.03 * (np.round(z.real / 0.03) + 1j * np.round(z.imag / 0.03)), atol=1e-14
    )
    clipped = rows_of(scene, effects=made("saturation", saturation={"limit": 0.7}))
    np.testing.assert_allclose(
        clipped, np.clip(z.real, -0.7, 0.7) + 1j * np.clip(z.imag, -0.7, 0.7), rtol=1e-13
    )
    assert np.max(np.abs(z.imag)) > 0.7


# --- noise
# ---------------------------------------------------------------------------------------------------------------

MANY = 131_072


def noise_of(*names, drive=0.0, seed=3, **values):
    """Rows of a plate at rest: what the noise alone makes."""
    scene = Scene(PLATE, constant(drive), MANY, 1e4, made(*names, **values), fidelity="steady")
    return scene.simulate(seed).response


def both(rows):
    return np.concatenate([rows.real, rows.imag])


def test_white_noise_has_its_moments():
    rows = noise_of("white_noise", white_noise={"std": 0.3})
    x = both(rows) / 0.3
    n = len(x)  # of independent normals: standard errors 1/sqrt(n), sqrt(2/n), sqrt(24/n); five of them
    assert abs(x.mean()) < 5 / np.sqrt(n)
    assert abs(x.var() - 1) < 5 * np.sqrt(2 / n)
    assert abs((x**4).mean() - 3) < 5 * np.sqrt(96 / n)
    for lag in (1, 2, 7, 100):
        assert abs(np.mean(x[lag:] * x[:-lag])) < 5 / np.sqrt(n)
    assert abs(np.mean(rows.real * rows.imag)) < 5 * 0.09 / np.sqrt(MANY)
    share = np.mean(np.abs(x)[:, None] < [0.5, 1.0, 2.0, 3.0], axis=0)
    np.testing.assert_allclose(share, erf(np.array([0.5, 1, 2, 3]) / np.sqrt(2)), atol=5 * 0.5 / np.sqrt(n))


@pytest.mark.parametrize("lanes", [65536, 1024])
def test_coloured_noise_has_its_correlation_also_across_chunks(lanes, monkeypatch):
    monkeypatch.setattr(timeline, "LANES", lanes)
    memory = 20  # rows
    rows = noise_of("coloured_noise", coloured_noise={"std": 0.3, "time": memory / 1e4}) / 0.3
    # the mean of x_k x_(k+lag) over n rows varies by (1 + rho^2)/(1 - rho^2)/n = memory/n, by twice that at
    # lag 0; two parts
    independent = 2 * MANY / memory
    for lag in (0, 1, 5, 20, 60):
        found = np.mean((rows[lag:] * rows[: MANY - lag].conj()).real) / 2
        assert found == pytest.approx(np.exp(-lag / memory), abs=5 * np.sqrt(2 / independent))
    assert abs(rows.mean()) < 5 * np.sqrt(2 / (MANY / memory))
    assert abs(np.mean(rows.real * rows.imag)) < 5 * np.sqrt(2 / independent)
    edges = np.arange(lanes - 256, MANY, lanes - 256)
    across, fresh = rows[edges] - np.exp(-1 / memory) * rows[edges - 1], 1 - np.exp(-2 / memory)
    # what a chunk's first row adds to the row before has the variance of every other row
    assert np.mean(np.abs(across) ** 2) / 2 == pytest.approx(fresh, rel=5 / np.sqrt(len(edges)))


def test_outliers_and_drop_outs_have_their_shares():
    rows = noise_of("outliers", outliers={"fraction": 0.02, "std": 0.5})
    hit = np.flatnonzero(rows)
    assert len(hit) / MANY == pytest.approx(0.02, abs=5 * np.sqrt(0.02 / MANY))
    assert both(rows[hit]).var() == pytest.approx(0.25, rel=5 * np.sqrt(1 / len(hit)))
    rate, duration = 40.0, 1.05e-3  # eleven rows are read in 1.05 ms at 10 kHz
    lost = noise_of("drop_outs", drive=100.0, drop_outs={"rate": rate, "duration": duration})[1:] == 0
    share, events = -np.expm1(-rate * 11e-4), MANY / 1e4 * rate
    # each event loses eleven rows: their number is Poisson's
    assert np.mean(lost) == pytest.approx(share, rel=5 / np.sqrt(events))
    ends = np.flatnonzero(np.diff(np.concatenate([[0], lost, [0]])))
    assert np.min(ends[1::2][:-1] - ends[::2][:-1]) == 11


def test_one_seed_is_one_log_and_another_another():
    first, again, other = (
        noise_of("coloured_noise", "outliers", "drop_outs", seed=seed) for seed in (1, 1, 2)
    )
    assert first.tobytes() == again.tobytes()
    assert np.mean(first == other) < 1e-3  # rows lost in both


def test_a_noise_s_draws_do_not_depend_on_which_others_there_are():
    """One effect's rows beside another's, bit for bit: 0 + w is w, and w + 0 too."""
    few = {"outliers": {"fraction": 0.1}, "drop_outs": {"rate": 300.0}}
    hits = noise_of("outliers", **few)
    for name in ("white_noise", "coloured_noise"):
        together = noise_of(name, "outliers", **few)
        assert np.array_equal(together, noise_of(name) + hits)
    dropped = noise_of("coloured_noise", "outliers", "drop_outs", **few)
    lost = dropped == 0
    assert 0.1 < np.mean(lost) < 0.5
    assert np.array_equal(dropped[~lost], together[~lost])


def test_a_noise_s_draws_do_not_depend_on_the_plate():
    scene = Scene(PLATE, constant(100.0, force=1.0), 4000, 1e4, made("white_noise"), fidelity="steady")
    plain = scene.simulate().response - rows_of(scene, effects=())
    touched = rows_of(scene, effects=made("white_noise", "finger_damping")) - rows_of(
        scene, effects=made("finger_damping")
    )
    # the same draws on another motion, to the rounding of a sum with a response of 2
    np.testing.assert_allclose(touched, plain, rtol=0, atol=1e-15)


# --- pieces
# --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["turned", "felt"])
def test_chunks_do_not_show(name, monkeypatch):
    rate, rows = 1e4, 700
    on_rows = np.arange(1, 90) * 7 / rate  # some of them the last or the first row of a chunk
    levels = np.random.default_rng(2).normal(size=(4, 90))
    profiles = zip(
        ("drive", "frequency", "temperature", "force"),
        (50, 32300, 24, 1.0),
        (50, 40, 3, 0.3),
        levels,
        strict=True,
    )
    inputs = {what: Profile(np.append(0, on_rows), np.abs(a + s * level)) for what, a, s, level in profiles}
    fx = made("duffing", "self_heating", "second_mode", second_mode={"k_T": -5.0})
    if name == "turned":
        fx = made("finger_damping", "phase_reset", "lock_in", "delay", **NEIGHBOUR)
    scene = Scene(PLATE, inputs, rows, rate, fx)
    whole = scene.simulate()
    monkeypatch.setattr(timeline, "LANES", 384)  # 128 rows at a time
    pieces = list(scene.stream())
    assert [len(log) for log in pieces] == [128] * 5 + [60]
    for column in ("time", "drive", "frequency", "temperature", "force"):
        joined = np.concatenate([getattr(log, column) for log in pieces])
        assert np.array_equal(joined, getattr(whole, column)), column
        if column != "time":
            assert np.array_equal(joined, inputs[column].at(whole.time))
    # 700 intervals, a rounding or two in each, most of them forgotten
    assert error(np.concatenate([log.response for log in pieces]), whole.response) < 1e-12


def test_a_finger_that_is_not_named_moves_no_bit(monkeypatch):
    sweep = Profile(np.arange(101) / 1e4, np.linspace(31800, 32800, 101), held=False)
    scene = Scene(
        PLATE,
        constant(force=1.0) | {"frequency": sweep},
        101,
        1e4,
        made("feedthrough", "white_noise"),
        kind="steady",
    )
    before = scene.simulate(5).response
    named = rows_of(scene, effects=made("finger_damping"))
    monkeypatch.setattr(effects, "contact", lambda force, *law: 3.0 * force)
    monkeypatch.setenv("SYSID_PROGRAMS", "off")  # those that are kept are of the text of the package
    engine.advance.programs.clear()
    try:
        assert scene.simulate(5).response.tobytes() == before.tobytes()
        assert error(rows_of(scene, effects=made("finger_damping")), named) > 0.1  # the law did change
    finally:
        engine.advance.programs.clear()


def test_one_program_serves_all_chunks_and_scenes_of_a_shape():
    scene = Scene(PLATE, constant(), 140_000, 1e5)
    other = Plant(1.0, 2e-3, 33e3, 1.0)  # a draw of a posterior
    engine.advance.programs.clear()
    for plant, drive in ((PLATE, 100.0), (PLATE, 50.0), (other, 50.0)):
        dataclasses.replace(scene, plant=plant, inputs=constant(drive)).simulate()
    assert len(engine.advance.programs) == 1


# --- no effect, no equation
# ----------------------------------------------------------------------------------------------

# What only moves numbers: it follows their shapes, and the way in which intervals are joined.
MOVES = (
    "broadcast_in_dim",
    "convert_element_type",
    "slice",
    "squeeze",
    "stack",
    "transpose",
    "reshape",
    "iota",
    "eq",
    "scan",
)
MOVES += ("complex",)


def program(effects, rung="exact", **inputs):
    """`programs.program` of a scene of 60 rows."""
    return programs.program(Scene(PLATE, constant(**inputs), 60, 1e4, effects, fidelity=rung))


def bare_envelope(plant, chunk, mode, reference):
    """A resonator by itself: Z' = (-1/tau + j (omega0 - omega)) Z + (G/tau) V."""
    detuning = 2 * jnp.pi * (plant.f0 - reference) + chunk.inputs.offset
    pole = -1 / plant.tau + 1j * detuning
    target = plant.G / plant.tau * chunk.inputs.drive / (pole.real**2 + pole.imag**2) * pole.conj()
    rows, last = engine.gathered(expm1(pole * chunk.duration), target, mode.response)
    return (0 + rows).ravel()[chunk.take], last


def bare_exact(plant, chunk, mode, reference):
    """Both modes of a resonator by itself."""
    detuning = 2 * jnp.pi * (plant.f0 - reference) + chunk.inputs.offset
    steps = engine.step(plant.G, Motion(plant.tau, detuning, chunk.inputs.drive), chunk.inputs, "exact")
    (slow, fast), last = engine._lanes(steps, mode, chunk)
    return (0 + slow + fast).ravel()[chunk.take], last


@pytest.mark.parametrize("rung", ["envelope", "exact"])
def test_a_scene_without_effects_is_the_bare_resonator(rung):
    scene = Scene(PLATE, constant(), 60, 1e4)
    with jax.enable_x64(True):
        chunk, _ = timeline.chunk(scene, 0, 60)
        zero = jnp.zeros((), complex)
        alone = bare_envelope if rung == "envelope" else bare_exact
        bare = jax.make_jaxpr(alone)(jax.tree.map(float, PLATE), chunk, engine.Mode(zero, zero), PLATE.f0)
    assert program((), rung)[0] == programs.equations(bare.jaxpr)


ON_INPUTS = (
    "inverter",
    "amplifier_limit",
    "frequency_resolution",
    "delay",
)  # act where inputs are made, before the program
NEEDS = {"finger_detuning": ("finger_damping",)}
WARM = ("curved", "temperature_damping")


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_adds_its_equations_and_changes_no_other(name):
    inputs = {"force": 1.0} if "finger" in name else {"temperature": 25.0} if name in WARM else {}
    less, fewer = program(made(*NEEDS.get(name, ())), **inputs)
    more, leaves = program(made(*NEEDS.get(name, ()), name), **inputs)
    missing = Counter(less) - Counter(more)
    assert not set(missing) - set(MOVES), missing
    if name in ON_INPUTS:
        assert more == less
    else:
        arithmetic = [n for n in more if n not in MOVES]
        assert len(arithmetic) > len([n for n in less if n not in MOVES])
    with jax.enable_x64(True):
        # its numbers (and its finger's), what it keeps from chunk to chunk, what a phase needs to turn, and
        # the rows' own drive, frequency and offset for what acts on rows
        fx = Scene(PLATE, constant(**inputs), 5, 1e4, made(*NEEDS.get(name, ()), name)).effects
        own = len(jax.tree.leaves(fx)) - len(NEEDS.get(name, ())) * 3
        kept = len(jax.tree.leaves(engine.start(PLATE, fx, jax.random.key(0)))) - 2
    assert leaves - fewer == own + kept + (name == "phase_reset") + 3 * hasattr(EFFECTS[name], "sense")


def test_inputs_that_a_scene_lacks_are_not_in_its_program():
    bare, leaves = program(())
    warm, more = program((), temperature=25.0)
    assert more == leaves + 1  # of the intervals; of the rows where something asks for theirs
    assert len(warm) > len(bare)
    assert program((), force=1.0)[0] == bare  # nothing feels it


# --- automatic fidelity
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [*range(4), *map(study, range(4, 25))])
def test_automatic_fidelity_keeps_its_promise(seed):
    """`benchmarks/scene_truth.py` does it for many more scenes, with effects, and against the carrier."""
    rng = np.random.default_rng([seed, 1])
    tolerance = float(np.exp(rng.uniform(np.log(3e-3), np.log(3e-2))))
    scene = random_scene(
        [seed, 2], plant=PLATE if seed % 2 else None, kinds=("steps", "ramp", "constant"), spacing=(0.02, 1.0)
    )
    chosen = resolved(dataclasses.replace(scene, fidelity="auto", tolerance=tolerance))
    # 256 steps between rows: with second-order errors 16^2 times less than the 16 that the coarsest of these
    # needs
    assert error(chosen.simulate().response, rows_of(scene, substeps=256)) < tolerance


# --- long times
# ----------------------------------------------------------------------------------------------------------


def two_modes(plant, f, T, V, state, span):
    """(Z, U) after `span` s of held inputs, by mpmath; U = w' e^{-j theta}, the velocity. `state` None:
    settled."""
    w0 = 2 * mp.pi * (mp.mpf(plant.f0) + mp.mpf(plant.k_T) * (mp.mpf(T) - 24))
    omega, rate = 2 * mp.pi * mp.mpf(f), 1 / mp.mpf(plant.tau)
    damped = mp.sqrt(w0**2 - rate**2)
    b = mp.mpf(plant.G) * rate * w0 / damped * V
    still = (-rate + 1j * damped, -rate - 1j * damped)  # of the plate; in the frame of the drive less j omega
    ends = (-b / (still[0] - 1j * omega), b / (still[1] - 1j * omega))
    modes = ends
    if state is not None:
        first = (state[1] - still[1] * state[0]) / (still[0] - still[1])
        modes = [
            e + (z - e) * mp.exp((s - 1j * omega) * span)
            for s, e, z in zip(still, ends, (first, state[0] - first), strict=True)
        ]
    return modes[0] + modes[1], still[0] * modes[0] + still[1] * modes[1]


def seconds(value):
    """A Fraction as a number of mpmath's."""
    return mp.mpf(value.numerator) / value.denominator


@pytest.mark.study
def test_a_day_in_bounded_memory_ends_with_the_right_phase():
    quartz = Plant(0.3, 1e6 / (np.pi * 5e6), 5e6, -3.0)  # Q = 1e6
    rate, day = 20.0, 86400
    minutes = np.arange(0.0, day, 60.0) + 0.0123  # not on rows
    drift = 24 + 3 * np.sin(2 * np.pi * minutes / day) + 0.01 * np.cos(minutes)
    inputs = constant(2.0, 5e6 + 3.0) | {"temperature": Profile(minutes, drift)}
    scene = Scene(quartz, inputs, int(day * rate) + 1, rate)

    def peak(scene):
        gc.collect()  # what other tests left
        tracemalloc.start()
        kept = []
        for log in scene.stream():
            steps = np.flatnonzero(np.diff(log.temperature)) + 1
            kept += [(log.time[k], log.temperature[k], log.response[k]) for k in steps[::7]]
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return kept, found

    peak(dataclasses.replace(scene, rows=100_000))  # compiled
    _, short = peak(dataclasses.replace(scene, rows=200_000))
    kept, long = peak(scene)
    # A day takes what three hours take, the rows that this test keeps, and some MB of cycles that were not
    # collected yet: one complex number for each further row would be 24 MB.
    assert long < short + 8e6
    assert len(kept) > 150 and kept[-1][0] > 0.99 * day
    with mp.workdps(40):
        for time, temperature, found in kept[::10]:
            k = int(np.searchsorted(minutes, time)) - 1
            assert temperature == drift[k]
            since = seconds(Fraction(round(time * rate), 20) - Fraction(minutes[k]))
            before = two_modes(quartz, 5e6 + 3, drift[k - 1], 2.0, None, 0)  # a minute is 942 time constants
            truth = complex(two_modes(quartz, 5e6 + 3, drift[k], 2.0, before, since)[0])
            # 2^-36 s is what a time of day is known to; in that time the response moves by |pole| of 100/s;
            # and 50 roundings
            swing = abs(truth - complex(before[0])) / abs(truth)
            assert abs(found - truth) < (2**-36 * 100 * swing + 50 * 2.2e-16) * abs(truth)


@pytest.mark.parametrize("detuning", [0.01, 37.0])
def test_the_phase_after_a_billion_samples_is_that_of_many_digits(detuning):
    """1e4 s, a billion samples at 100 kHz: a resonance that rings all the time, driven beside it."""
    plant = Plant(0.3, 5e3, 1e6, 0.0)  # Q = 1.6e10
    scene = Scene(plant, constant(2.0, 1e6 - detuning), 11, 1e-3)
    found = scene.simulate().response
    with mp.workdps(60):
        truth, state = [], (mp.mpf(0), mp.mpf(0))
        for _ in range(11):
            truth.append(complex(state[0]))
            state = two_modes(plant, 1e6 - detuning, 24.0, 2.0, state, 1000)
    # the phase 2 pi 37 Hz 1e4 s = 2.3e6 rad is a product of rounded numbers, four roundings of 1.1e-16
    # relative, which add up; w0 in rad/s is a difference from its reference, so the carrier's own 6e10 rad do
    # not enter
    bound = 4 * 1.1e-16 * 2 * np.pi * detuning * 1e4 + 50 * 2.2e-16
    assert error(found, np.array(truth)) < bound


def test_a_million_samples_gather_no_phase():
    plant = Plant(0.3, 5.0, 1e6, 0.0)  # two time constants of ringing at 100 kHz
    scene = Scene(plant, constant(2.0, 1e6 - 37.0), 1_000_001, 1e5)
    for log in scene.stream():
        last = log.response[-1]
    with mp.workdps(60):
        state = two_modes(plant, 1e6 - 37.0, 24.0, 2.0, (mp.mpf(0), mp.mpf(0)), 10)
        truth = complex(state[0])
    # 1e6 products, each rounded by 1e-16 at random: 1e3 * 2e-16; and a pole that is rounded once, 2e-16 of
    # 2300 rad
    assert abs(last - truth) < (1e3 * 2.2e-16 * 5 + 2300 * 2.2e-16 * 4) * abs(truth)
