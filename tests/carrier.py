"""The bench at the level of the carrier, slow and obvious: what scenes are compared with, and random scenes.

    w'' + ds w' + w0^2 w = N v,   v = jV e^{j theta},  theta' = omega,  Z = w e^{-j theta}      (m = 1, N = G ds w0)

The drive is complex, and so is w: its real part is what a plate does under Re v, and Z is then unique. G is
the response per drive at resonance wherever the resonance is, as everywhere in the package. `by_expm`
exponentiates the matrix of the equation in the frame that turns; `by_carrier` integrates it as it stands.
Both take a scene's numbers and none of its equations.
"""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sysid import Plant, Profile, Scene


def reads(scene):
    """Times at which rows are read: those of the rows less the delay, never before the scene begins."""
    effects = named(scene)
    time = np.arange(scene.rows) / scene.rate
    return np.maximum(time - (effects["delay"].time if "delay" in effects else 0.0), 0.0)


def named(scene):
    return {e.name: e for e in scene.effects}


def edges(scene, end):
    """Times within (0, end) at which an input steps or bends, or a ramp's frequency is rounded to the next
    step."""
    bends = {float(t) for p in scene.inputs.values() for t in p.times if 0 < t < end}
    profile, resolution = scene.inputs["frequency"], named(scene).get("frequency_resolution")
    if resolution and not profile.held:
        for a, b in pairwise([0.0, *sorted(bends), end]):
            f = np.interp([a, b], profile.times, profile.values) / resolution.step - 0.5
            for k in range(math.ceil(min(f)), math.floor(max(f)) + 1):
                if f[1] != f[0]:
                    bends.add(float(a + (b - a) * (k - f[0]) / (f[1] - f[0])))
    return sorted(t for t in bends if 0 < t < end)


def value(profile, time):
    """A profile at one time that is not that of a step."""
    if not profile.held:
        return float(np.interp(time, profile.times, profile.values))
    return float(
        [v for t, v in zip(profile.times, profile.values, strict=True) if t < time or t == profile.times[0]][
            -1
        ]
    )


def conditions(scene, time):
    """V, omega and, for each resonance, G, w0, ds and its weight in what the sensor sees, at a time between
    steps."""
    e, plant = named(scene), scene.plant
    given = {name: value(profile, time) for name, profile in scene.inputs.items()}
    V, f = given["drive"], given["frequency"]
    if "inverter" in e:
        V = e["inverter"].supply * (
            V if e["inverter"].law == "linear" else 4 / math.pi * math.sin(math.pi * V / 2)
        )
    if "amplifier_limit" in e:
        V = min(max(V, -e["amplifier_limit"].limit), e["amplifier_limit"].limit)
    if "frequency_resolution" in e:
        f = e["frequency_resolution"].step * round(f / e["frequency_resolution"].step)
    rho = finger(e["finger_damping"], given["force"]) if "finger_damping" in e else 0.0
    modes = [(plant.G, plant.tau, plant.f0, plant.k_T or 0.0, 1.0)]
    if "second_mode" in e:
        m = e["second_mode"]
        weight = e["two_ceramics"].mismatch / 2 if "two_ceramics" in e else 1.0
        modes.append((m.G, m.tau, m.f0, m.k_T, weight))
    found = []
    for G, tau, f0, k_T, weight in modes:
        w0 = (
            2
            * math.pi
            * (
                f0
                + k_T * (given.get("temperature", plant.reference_temperature) - plant.reference_temperature)
            )
        )
        if "finger_detuning" in e:
            w0 -= e["finger_detuning"].ratio * rho / tau
        # the force N does not change when a finger adds to ds
        found.append(
            SimpleNamespace(N=G * (2 / tau) * w0, w0=w0, ds=2 / tau * (1 + rho), weight=weight, k_T=k_T)
        )
    return SimpleNamespace(V=V, omega=2 * math.pi * f, f=f, modes=found)


def finger(e, force):
    """Added damping over the plate's own; powers begin at 1e-9, as documented."""

    def power(x):
        return (x + 1e-9) ** e.exponent - 1e-9**e.exponent

    if e.law == "power":
        return e.rho * power(force) / power(1.5)
    return e.rho * (1 - math.exp(-power(force / e.scale))) / (1 - math.exp(-power(1.5 / e.scale)))


def sensor(scene, c):
    """(gain, leak): the demodulator's input is gain Z + leak."""
    e, gain, leak = named(scene), 1.0 + 0j, 0j
    if "two_ceramics" in e:
        gain = np.exp(
            1j * math.atan2(1, c.omega * e["two_ceramics"].resistance * e["two_ceramics"].capacitance)
        )
    if "feedthrough" in e:
        leak = (e["feedthrough"].d + 1j * e["feedthrough"].q) * c.V
    turn = np.exp(1j * math.pi * e["rotation"].angle / 180) if "rotation" in e else 1.0
    return gain * turn, leak * turn


def stretches(scene):
    """(begin, end, indices of the rows that are read at its end), held or bending nowhere within."""
    read = reads(scene)
    knots = [0.0, *sorted(set(edges(scene, read[-1])) | {float(t) for t in read if t > 0})]
    for begin, end in pairwise(knots):
        yield begin, end, np.flatnonzero(read == end)


def finish(scene, rows):
    """Rows after what acts behind the filter."""
    offset = named(scene).get("offset")
    return rows + (offset.d + 1j * offset.q if offset else 0.0)


def by_expm(scene):
    """Rows of a scene of held inputs. State: (Z, w' e^{-j theta}/w0) of each resonance, the stages of the
    filter, and 1."""
    lock_in = named(scene).get("lock_in")
    order = lock_in.order if lock_in else 0
    rows = np.zeros(scene.rows, complex)
    count = len(conditions(scene, 0.0).modes)
    scale = [
        m.w0 for m in conditions(scene, 0.0).modes
    ]  # one for all stretches: the velocity is continuous, not its ratio
    state = np.zeros(2 * count + order + 1, complex)
    state[-1] = 1
    since, f_before = 0.0, None
    for begin, end, reading in stretches(scene):
        c = conditions(scene, 0.5 * (begin + end))
        if "phase_reset" in named(scene) and f_before not in (None, c.f):
            state[: 2 * count] *= np.exp(2j * math.pi * math.fmod(f_before * (begin - since), 1.0))
            since = begin
        f_before = c.f
        matrix = np.zeros((len(state), len(state)), complex)
        gain, leak = sensor(scene, c)
        seen = np.zeros(len(state), complex)
        seen[-1] = leak
        for k, m in enumerate(c.modes):
            z, u = 2 * k, 2 * k + 1
            matrix[z, z], matrix[z, u] = -1j * c.omega, scale[k]
            matrix[u, z], matrix[u, u] = -(m.w0**2) / scale[k], -1j * c.omega - m.ds
            matrix[u, -1] = 1j * m.N * c.V / scale[k]
            seen[z] = gain * m.weight
        for j in range(order):
            at = 2 * count + j
            matrix[at] = (seen if j == 0 else np.eye(len(state))[at - 1]) / lock_in.tau
            matrix[at, at] -= 1 / lock_in.tau
        state = expm(matrix * (end - begin)) @ state
        rows[reading] = state[-2] if order else seen @ state
    return finish(scene, rows)


def by_carrier(scene, rtol=1e-12):
    """Rows of a scene, also of ramps, of softening and of self-heating (which the amplitude |w| decides); no
    filter."""
    e = named(scene)
    heat, duffing = e.get("self_heating"), e.get("duffing")
    rows = np.zeros(scene.rows, complex)
    count = len(conditions(scene, 0.0).modes)
    unit = [
        m.w0 for m in conditions(scene, 0.0).modes
    ]  # of velocity, so that one absolute tolerance serves all
    state, theta, f_before = np.zeros(2 * count + 1, complex), 0.0, None
    size = 1e-30
    held = all(p.held for p in scene.inputs.values())
    for begin, end, reading in stretches(scene):
        middle = conditions(scene, 0.5 * (begin + end))
        if "phase_reset" in e:
            theta = 0.0 if f_before not in (None, middle.f) else theta
            f_before = middle.f
        first, last = (conditions(scene, t).omega for t in inside(begin, end))
        slope = 0.0 if held or "frequency_resolution" in e else (last - first) / (end - begin)
        omega0 = middle.omega - slope * (end - begin) / 2

        def rate(t, y, begin=begin, middle=middle, omega0=omega0, slope=slope, theta=theta):
            now = middle if held else conditions(scene, begin + t)
            omega = omega0 + slope * t
            v = 1j * now.V * np.exp(1j * (theta + (omega0 + slope * t / 2) * t))
            made = np.zeros_like(y)
            for k, m in enumerate(now.modes):
                w, u = y[2 * k], y[2 * k + 1]
                w0 = m.w0
                if duffing:
                    w0 -= 2 * math.pi * duffing.softening * abs(w) ** 2
                if heat:
                    w0 += 2 * math.pi * m.k_T * y[-1].real
                made[2 * k] = unit[k] * u
                made[2 * k + 1] = (m.N * w0 / m.w0 * v - w0**2 * w) / unit[k] - m.ds * u
            if heat:
                power = 0.5 * heat.damping * (omega * heat.metres * abs(y[0])) ** 2
                made[-1] = (power - heat.loss * y[-1]) / heat.capacity
            return made

        scale = max(abs(m.N * middle.V / (m.ds * m.w0)) for m in middle.modes)  # of the settled response
        size = max(size, scale)
        done = solve_ivp(rate, (0.0, end - begin), state, method="DOP853", rtol=rtol, atol=rtol * size)
        assert done.success, done.message
        state, span = done.y[:, -1], end - begin
        theta += (omega0 + slope * span / 2) * span
        seen = sum(
            m.weight * state[2 * k] for k, m in enumerate(conditions(scene, inside(begin, end)[1]).modes)
        )
        gain, leak = sensor(scene, conditions(scene, inside(begin, end)[1]))
        rows[reading] = gain * seen * np.exp(-1j * theta) + leak
    return finish(scene, rows)


def inside(begin, end):
    """The ends of a stretch, from within: at the same values of what bends there, before what steps."""
    tiny = 1e-12 * (end - begin)
    return begin + tiny, end - tiny


# --- random scenes
# --------------------------------------------------------------------------------------------------------

PLATE = Plant(G=0.02, tau=5e-3 / math.log(20), f0=32300.0, k_T=-10.16)
ROWS = 60  # one length for all random scenes: one program for each set of effects


def random_profile(rng, duration, kind, level, spread):
    """Steps at random times, a few straight lines, or one value, about `level`."""
    if kind == "constant":
        return Profile.constant(level)
    count = rng.integers(2, 6)
    times = np.append(0.0, np.sort(rng.uniform(0, duration, count)))
    return Profile(times, level + spread * rng.normal(size=count + 1), kind == "steps")


def random_scene(seed, effects=(), *, plant=None, kinds=("steps",), spacing=(0.02, 0.5), rows=ROWS, **more):
    """A scene of `rows` rows, `spacing` time constants apart; each input of one of `kinds`. `plant` None: one
    of its own."""
    rng = np.random.default_rng(seed)
    if plant is None:
        Q = math.exp(rng.uniform(math.log(8), math.log(2000)))
        plant = Plant(
            G=math.exp(rng.normal()), tau=Q / (math.pi * 32300), f0=32300.0, k_T=rng.normal(0, 3e3 / Q)
        )
    rate = 1 / (plant.tau * math.exp(rng.uniform(*np.log(spacing))))
    duration, half_bandwidth = (rows - 1) / rate, 1 / (2 * math.pi * plant.tau)
    warm = 0.5 * half_bandwidth / abs(plant.k_T or 1.0)
    levels = {
        "drive": (50.0, 50.0),
        "frequency": (plant.f0, half_bandwidth),
        "temperature": (24.0, warm),
        "force": (1.0, 0.3),
    }
    inputs = {
        name: random_profile(rng, duration, rng.choice(kinds), *level) for name, level in levels.items()
    }
    force = inputs["force"]
    inputs["force"] = Profile(force.times, np.abs(force.values), force.held)
    return Scene(plant, inputs, rows, rate, effects, **more)
