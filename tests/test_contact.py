"""A finger's place on the mode shape, and further modes beside the plate's own: scenes, open and closed."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import controller
from sysid import Plant, Profile, Scene, SceneError
from sysid.scene import EFFECTS
from sysid.scene.effects import FingerDamping, Inputs, SecondMode, TwoCeramics

PLATE = Plant(0.02, 1.669e-3, 32300.0, -10.16)
RATE = 1e4


def scene(*effects, rows=401, frequency=32290.0, **inputs):
    given = {"drive": 100.0, "frequency": frequency} | inputs
    held = {name: v if isinstance(v, Profile) else Profile.constant(v) for name, v in given.items()}
    return Scene(PLATE, held, rows, RATE, effects)


def test_a_constant_contact_is_as_much_more_damping():
    touched = scene(FingerDamping(rho=1.0), force=1.5, contact=0.7).simulate().response
    np.testing.assert_allclose(
        touched, scene(FingerDamping(rho=0.7), force=1.5).simulate().response, rtol=1e-13
    )


def test_a_finger_that_crosses_nodal_lines_is_the_slow_equation_s_solution():
    # contact changes over 8 ms, the plate's time constant is 1.7 ms: neither quasi-static nor averaged out
    time = np.arange(401) / RATE
    contact = 1 + 0.9 * np.cos(2 * np.pi * time / 8e-3)
    given = scene(FingerDamping(), force=1.5, contact=Profile(time, contact, held=False))
    found = dataclasses.replace(given, fidelity="envelope").simulate().response
    delta = 2 * np.pi * (PLATE.f0 - 32290.0)

    def slow(t, z):
        damping = (1 + np.interp(t, time, contact)) / PLATE.tau
        return [-damping * z[0] + 1j * delta * z[0] + PLATE.G / PLATE.tau * 100.0]

    truth = solve_ivp(slow, (0, time[-1]), [0j], t_eval=time, rtol=1e-9, atol=1e-12, max_step=1e-4).y[0]
    # contact is held over each row of 0.1 ms at its middle: (2 pi 0.1/8)^2/24 = 3e-4 of it
    assert np.max(np.abs(found - truth)) < 3e-4 * np.max(np.abs(truth))


def test_the_closed_loop_feels_the_contact():
    """What is left of W where the finger's damping swings by a fifth at 125 Hz: that of the linear loop.

    s W = -2/tau W + b V - swing/tau,    V = Kp (z - a)/(z - 1) (1 - W e^(-s theta)),    z = e^(s Ts)

    with a = e^(-Ts/tau) and Kp = (1 - e^(-Ts/tau_cl))/(G (1 - a)): a PI that cancels the free plate's pole, a
    plate that the finger damps twice as much, a sample of delay and half a sample of hold.
    """
    time = np.arange(2001) / RATE
    contact = Profile(time, 1 + 0.2 * np.cos(2 * np.pi * 125 * time), held=False)
    loop = controller.design(PLATE, method="paper", voltage_limit=350.0, amplitude=1.0, finger=2.0)
    loop = dataclasses.replace(loop, demodulator=None)  # Wd and Wq are read at once
    asked = {"drive": 50.0, "frequency": 32300.0, "force": 1.5, "rows": 2001}
    still = controller.closed_loop(loop, scene(FingerDamping(), **asked, contact=1.0))
    moved = controller.closed_loop(loop, scene(FingerDamping(), **asked, contact=contact))
    s, tau = 2j * np.pi * 125, PLATE.tau
    z, a, Ts = np.exp(s * loop.sample_time), np.exp(-loop.sample_time / tau), loop.sample_time
    gain = -np.expm1(-2 * np.pi * loop.bandwidth_hz * Ts) / (PLATE.G * (1 - a))
    action = PLATE.G / tau * gain * (z - a) / (z - 1) * np.exp(-(loop.latency + Ts / 2) * s)
    late = slice(1000, None)
    assert np.ptp(still.W[late]) < 0.002  # the tracker's steps of 10 Hz: 0.07 %
    assert np.ptp(moved.W[late]) == pytest.approx(2 * 0.2 / tau / abs(s + 2 / tau + action), rel=0.05)


@pytest.mark.parametrize(
    "inputs, effects, key",
    [
        ({"contact": 1.0}, (), "inputs.contact without effects.finger_damping"),
        ({"contact": -0.1, "force": 1.0}, (FingerDamping(),), "a contact of -0.1"),
    ],
)
def test_a_contact_that_cannot_be_is_refused(inputs, effects, key):
    with pytest.raises(SceneError, match=key):
        scene(*effects, **inputs)


def test_a_scene_without_a_contact_has_no_equation_of_it():
    def equations(**contact):
        inputs = Inputs(1.0, 1.0, 0.0, None, jnp.ones(3), **contact)
        return str(jax.make_jaxpr(FingerDamping().ratio)(inputs)).count("=")

    assert equations(contact=jnp.ones(3)) == equations() + 1
    one = scene(FingerDamping(), SecondMode(), TwoCeramics(), force=1.5).simulate().response
    contact = scene(FingerDamping(), SecondMode(), TwoCeramics(), force=1.5, contact=1.0).simulate().response
    np.testing.assert_allclose(one, contact, rtol=1e-14)


BESIDE = (
    SecondMode(G=0.004, f0=32421.0, seen=0.7),
    SecondMode(G=-0.01, f0=32180.0, tau=2e-3, parity="even", seen=1.3),
)


@pytest.mark.study
@pytest.mark.parametrize("drive", ["held", "swept"])
def test_several_modes_add(drive):
    """The plate is linear: what several modes do is the sum of what each does by itself."""
    frequency = (
        32290.0
        if drive == "held"
        else Profile(np.array([0.0, 0.04]), np.array([32100.0, 32500.0]), held=False)
    )
    both = scene(*BESIDE, frequency=frequency).simulate().response
    alone = [scene(e, frequency=frequency).simulate().response for e in BESIDE]
    bare = scene(frequency=frequency).simulate().response
    np.testing.assert_allclose(both, alone[0] + alone[1] - bare, atol=1e-12)
    quiet = dataclasses.replace(
        scene(frequency=frequency), plant=Plant(BESIDE[1].G, BESIDE[1].tau, BESIDE[1].f0, 0.0)
    )
    # `seen` of the mode's own motion; its own scene counts detunings from elsewhere
    np.testing.assert_allclose(alone[1] - bare, 1.3 * quiet.simulate().response, atol=2e-9)


def test_two_ceramics_cancel_odd_modes_and_see_even_ones():
    pair = TwoCeramics(mismatch=0.1, resistance=1e12)
    bare, whole = scene().simulate().response, [scene(e).simulate().response for e in BESIDE]
    seen = [scene(e, pair).simulate().response for e in BESIDE]
    np.testing.assert_allclose(
        seen[0] - bare, 0.05 * (whole[0] - bare), atol=1e-8
    )  # a resistance of 1e12 ohm turns by 1e-9
    np.testing.assert_allclose(seen[1] - bare, whole[1] - bare, atol=1e-8)


@pytest.mark.study
def test_a_loop_holds_what_its_ceramics_read_of_all_modes():
    """Settled at its voltage and frequency, by the response of each mode; what moves is another sum of
    them."""
    loop = controller.design(PLATE, method="pi", voltage_limit=350.0, amplitude=1.0, finger=1.0)
    trace = controller.closed_loop(loop, scene(*BESIDE, drive=50.0, rows=2001))
    V, f = trace.V[-1], trace.f[-1]
    modes = [PLATE, *(Plant(m.G, m.tau, m.f0) for m in BESIDE)]
    Z = np.array([mode.steady(V, f) for mode in modes])
    read = Z @ np.array([1.0, *(m.seen for m in BESIDE)])
    assert [trace.measured[-1], read] == pytest.approx([1.0, 1.0], abs=1e-9)  # 200 ms: all has settled
    assert trace.W[-1] == pytest.approx(abs(Z.sum()), abs=1e-9)
    assert trace.W[-1] > 1.05 and f > PLATE.f0 + 20.0


@pytest.mark.study
def test_a_lock_in_sees_the_same_share():
    filtered = EFFECTS["lock_in"](tau=1e-5)
    both = [scene(*BESIDE, *more, rows=2001).simulate().response[-1] for more in ((), (filtered,))]
    assert both[1] == pytest.approx(both[0], rel=1e-6)  # all has settled


TOML = """
[plant]
G_um_per_V = 0.02
tau_ms = 1.669
f0_Hz = 32300
[log]
rate_kHz = 10
rows = 11
[inputs]
voltage_V = 100
frequency_Hz = 32300
force_N = 1
contact = {ramp = [[0, 0.5], [1e-3, 1.5]]}
[effects.finger_damping]
[[effects.second_mode]]
f0_kHz = 32.42
parity = "even"
[[effects.second_mode]]
f0_kHz = 32.18
G_nm_per_V = -3
seen = 2.0
"""


def test_a_scene_file_names_several_modes_and_a_contact(save):
    found = Scene.from_toml(save(TOML, "scene.toml"))
    modes = [e for e in found.effects if isinstance(e, SecondMode)]
    assert [(m.f0, m.parity, m.seen) for m in modes] == [(32420.0, "even", 1.0), (32180.0, "odd", 2.0)]
    assert pytest.approx(-0.003) == modes[1].G and found.inputs["contact"].at(np.array([5e-4]))[0] == 1.0
    found.simulate()


@pytest.mark.parametrize(
    "old, new, key",
    [
        ('parity = "even"', 'parity = "none"', r"effects.second_mode\[0\].parity"),
        ("seen = 2.0", "sene = 2.0", r"effects.second_mode\[1\].sene"),
        ("tau_ms = 1.669", "tau_ms = 1.669\ntau_s = 0.001", "plant.tau: found tau_ms and tau_s"),
        ("[effects.finger_damping]", "[[effects.finger_damping]]", "effects.finger_damping: found"),
        ("contact =", "contact_mm =", "inputs.contact_mm"),
    ],
)
def test_what_a_scene_file_may_not_say(save, old, new, key):
    with pytest.raises(SceneError, match=key):
        Scene.from_toml(save(TOML.replace(old, new), "scene.toml"))


def test_neighbours_are_those_of_the_mode():
    from stimulator import neighbours

    beside = [
        SimpleNamespace(f0=f, drive=d, sense=s)
        for f, d, s in ((31010.0, -0.16, 1.2), (31259.0, -0.13, 0.1), (29e3, 1, 1))
    ]
    mode = SimpleNamespace(f0=31131.0, neighbours=beside)
    first, second = neighbours(mode, PLATE)
    assert (first.f0, second.f0) == (32300.0 - 121, 32300.0 + 128)
    assert pytest.approx(-0.16 * PLATE.G) == first.G and first.tau == PLATE.tau and second.seen == 0.1
