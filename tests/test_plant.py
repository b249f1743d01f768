"""The plant against the matrix exponential of its differential equation, the closed transfer function, and
itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import study
from scipy.linalg import expm

from sysid import Plant
from sysid.model.plant import poles, respond, steady
from sysid.rows.hold import hold_inputs

PLATE = Plant(G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=-10.16)
LOW_Q = Plant(G=0.5, tau=8 / (np.pi * 900), f0=900.0)
ROWS = 60  # one length for all random logs: one program


def exact(plant, time, drive, frequency, temperature, start=0j):
    """Rows of the two-state equation

        Z'' + (2 j omega + ds) Z' + (w0^2 - omega^2 + j omega ds) Z = j N V        (m = 1, ds = 2/tau, N = G ds w0)

    just before each row's inputs act, by `expm`. Where omega jumps with a continuous phase, w and w' do not: Z' jumps by
    -j (omega' - omega) Z.
    """
    state = np.array([start, 0, 1], complex)
    out = [start]
    last = None
    for k, duration in enumerate(np.diff(time)):
        omega = 2 * np.pi * frequency[k]
        w0 = 2 * np.pi * (plant.f0 + (plant.k_T or 0.0) * (temperature[k] - plant.reference_temperature))
        ds = 2 / plant.tau
        if last is not None:
            state[1] -= 1j * (omega - last) * state[0]
        last = omega
        row = [-(w0**2 - omega**2 + 1j * omega * ds), -(2j * omega + ds), 1j * plant.G * ds * w0 * drive[k]]
        # Z'/w0 for Z': a matrix whose entries are alike, so that expm loses no digits
        scale = np.diag([1, w0, 1])
        matrix = np.linalg.inv(scale) @ np.array([[0, 1, 0], row, [0, 0, 0]]) @ scale
        state = scale @ expm(matrix * duration) @ np.linalg.inv(scale) @ state
        out.append(state[0])
    return np.array(out)


def random_inputs(plant, rng, rows=ROWS, warms=False):
    """Irregular times, some of them equal, and inputs that change at random rows; the temperature only when
    it `warms`."""
    time = np.cumsum(rng.exponential(0.3 * plant.tau, rows) * (rng.random(rows) > 0.1))
    levels = rng.integers(0, 6, rows // 10)
    held = np.repeat(levels, 10)
    half_bandwidth = 1 / (2 * np.pi * plant.tau)
    drive = rng.normal(0, 50, 6)[held]
    frequency = plant.f0 + half_bandwidth * rng.normal(0, 2, 6)[held]
    temperature = 24 + rng.normal(0, 5, 6)[np.roll(held, 3)] if warms else np.full(rows, 26.0)
    return time, drive, frequency, temperature


@pytest.mark.parametrize("Q", [0.8, 3.0, 8.0, 40.0, 170.0])
@pytest.mark.parametrize("seed", range(3))
def test_both_modes_are_the_matrix_exponential_of_the_equation_of_motion(Q, seed):
    plant = Plant(G=0.3, tau=Q / (np.pi * 900), f0=900.0, k_T=-1.0)
    inputs = random_inputs(plant, np.random.default_rng(seed))
    found = plant.transient(*inputs, both_modes=True)
    truth = exact(plant, *inputs)
    # 1e-10: what expm keeps of a product of 60 matrices whose phases go through hundreds of turns
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-10 * np.max(np.abs(truth)))


@pytest.mark.parametrize("Q", [20.0, 170.0, 50_000.0])
def test_without_the_ripple_the_error_is_a_quarter_of_one_over_q(Q):
    plant = Plant(G=1.0, tau=1e-3, f0=Q / (np.pi * 1e-3))
    time = np.linspace(0, 6e-3, ROWS)
    drive = np.where(np.arange(ROWS) < 5, 0.0, 1.0)
    frequency = np.full(ROWS, plant.f0 - 120.0)
    slaved = plant.transient(time, drive, frequency)
    whole = plant.transient(time, drive, frequency, both_modes=True)
    since = np.maximum(time - time[5], 0)
    # b V/|s2| = G V/(4 Q) to first order in 1/Q and in the relative detuning; it decays with tau
    bound = (1 + 2 / Q) / (4 * Q) * np.exp(-since / plant.tau) + 1e-13
    assert np.all(np.abs(slaved - whole) <= bound)
    assert np.max(np.abs(slaved - whole)) > 0.3 / (4 * Q)


def test_a_resonance_that_moves_keeps_the_slow_mode_continuous():
    inputs = random_inputs(PLATE, np.random.default_rng(7), warms=True)
    found, truth = np.asarray(PLATE.transient(*inputs, both_modes=True)), exact(PLATE, *inputs)
    moves = PLATE.k_T * np.ptp(inputs[3]) / PLATE.f0
    # w and w' are continuous: a jump of the resonance passes d w0/(2 w0) of one mode to the other, six times
    # at most
    assert np.max(np.abs(found - truth)) < 3 * abs(moves) * np.max(np.abs(truth))
    assert np.max(np.abs(found - truth)) < 5e-3 * np.max(np.abs(truth))


@pytest.mark.parametrize("Q", [0.6, 2.0, 8.0, 170.0, 5e4, 1e7])
def test_steady_is_the_closed_transfer_function(Q):
    plant = Plant(G=0.7, tau=Q / (np.pi * 5e6), f0=5e6)
    detuning = np.concatenate([[0.0], np.geomspace(1e-3, 3, 20), -np.geomspace(1e-3, 1, 20)]) / (
        2 * np.pi * plant.tau
    )
    frequency = plant.f0 + detuning
    frequency = frequency[frequency > 0.05 * plant.f0]
    w, w0, ds = 2 * np.pi * frequency, 2 * np.pi * plant.f0, 2 / plant.tau
    N = plant.G * ds * w0
    # c - m w^2 as (w0 - w)(w0 + w): the truth must not cancel either
    truth = 1j * N * 3.0 / ((w0 - w) * (w0 + w) + 1j * w * ds)
    # 2e-16 of frequency is 2e-16 Q of a half bandwidth
    np.testing.assert_allclose(plant.steady(3.0, frequency), truth, rtol=1e-13 + 1e-15 * Q)


def test_a_transient_ends_at_the_steady_response():
    time = np.array([0.0, 60 * PLATE.tau])
    for detuning in (-200.0, 0.0, 35.0):
        frequency = PLATE.f0 + detuning
        end = PLATE.transient(time, 10.0, frequency, 24.0)[-1]
        np.testing.assert_allclose(end, PLATE.steady(10.0, frequency, 24.0), rtol=1e-12)  # e^-60 is left


def test_signs_are_the_paper_s():
    below, at, above = np.asarray(PLATE.steady(100.0, PLATE.f0 + np.array([-50.0, 0.0, 50.0])))
    assert below.imag > 0 > above.imag  # W_q > 0 below resonance: the frequency must rise
    assert at == pytest.approx(2.0, abs=1e-12)  # G V along d
    assert below.real > 0 and above.real > 0
    np.testing.assert_allclose(
        [below / 2, above / 2], [0.785 + 0.412j, 0.785 - 0.411j], atol=2e-3
    )  # a carrier integration
    warmer = np.asarray(PLATE.steady(100.0, PLATE.f0, 28.0))
    assert warmer.imag < 0  # k_T < 0: the resonance falls below the drive
    np.testing.assert_allclose(
        abs(warmer) / 2, 0.920, atol=2e-3
    )  # 8 % in 4 degC; w0/omega is 0.1 % below one


def test_a_free_decay_turns_at_the_detuning():
    time = np.linspace(0, 4 * PLATE.tau, ROWS)
    found = np.asarray(PLATE.transient(time, 0.0, PLATE.f0 - 80.0, start=1 - 2j))
    w0 = 2 * np.pi * PLATE.f0
    detuning = np.sqrt(w0**2 - PLATE.tau**-2) - 2 * np.pi * (PLATE.f0 - 80.0)
    np.testing.assert_allclose(found, (1 - 2j) * np.exp((-1 / PLATE.tau + 1j * detuning) * time), atol=1e-11)


def test_without_a_frequency_it_is_the_first_order_model():
    plant = Plant(G=0.02, tau=2e-3)
    time = np.linspace(0, 8e-3, ROWS)
    np.testing.assert_allclose(plant.transient(time, 100.0), 2 * -np.expm1(-time / 2e-3), atol=1e-14)
    np.testing.assert_allclose(
        plant.transient(time, 100.0, np.full(ROWS, 32e3)), 2 * -np.expm1(-time / 2e-3), atol=1e-14
    )
    assert np.asarray(plant.steady(100.0)) == pytest.approx(2.0)
    assert plant.Q is None


@pytest.mark.parametrize("both_modes", [False, True])
def test_splitting_an_interval_changes_nothing(both_modes):
    rng = np.random.default_rng(1)
    time, drive, frequency, temperature = random_inputs(LOW_Q, rng, 30)
    whole = LOW_Q.transient(time, drive, frequency, temperature, both_modes=both_modes)
    middle = time[:-1] + rng.random(29) * np.diff(time)
    halves = np.insert(time, np.arange(1, 30), middle)
    doubled = [np.repeat(c, 2)[:-1] for c in (drive, frequency, temperature)]
    # a tiny change on every second row, taken back: intervals are split although equal inputs would be joined
    doubled[0][1::2] *= 1 + 2e-16
    split = LOW_Q.transient(halves, *doubled, both_modes=both_modes)
    np.testing.assert_allclose(
        split[::2], whole, rtol=0, atol=3e-14 * np.max(np.abs(whole))
    )  # 60 roundings of 2e-16


@pytest.mark.parametrize("both_modes", [False, True])
def test_laws_of_scale_hold_to_the_last_bit(both_modes):
    """Twice the drive or the gain, half of every time at twice every frequency: powers of two round
    nothing."""
    time, drive, frequency, temperature = random_inputs(LOW_Q, np.random.default_rng(5), 30)
    rows = LOW_Q.transient(time, drive, frequency, temperature, both_modes=both_modes)
    louder = LOW_Q.transient(time, 2.0**40 * drive, frequency, temperature, both_modes=both_modes)
    np.testing.assert_array_equal(louder, 2.0**40 * rows)
    stronger = Plant(LOW_Q.G / 8, LOW_Q.tau, LOW_Q.f0).transient(
        time, drive, frequency, both_modes=both_modes
    )
    np.testing.assert_array_equal(stronger, rows / 8)
    quicker = Plant(LOW_Q.G, LOW_Q.tau / 2**20, LOW_Q.f0 * 2**20)
    found = quicker.transient(time / 2**20, drive, frequency * 2**20, both_modes=both_modes)
    np.testing.assert_array_equal(found, rows)


def test_a_mirrored_detuning_mirrors_q():
    detuning = np.array([1.0, 30.0, 95.0, 400.0])
    above, below = (np.asarray(PLATE.steady(100.0, PLATE.f0 + s * detuning)) for s in (1, -1))
    # (w0/omega) and (w0^2 - omega^2)/(2 omega) differ from their mirror images by the relative detuning,
    # twice that in W
    assert np.all(np.abs(above - below.conj()) <= 4 * detuning / PLATE.f0 * np.abs(above))


def test_an_interval_without_length_changes_nothing():
    time = np.array([0.0, 1e-3, 1e-3, 1e-3, 2e-3])
    drive = np.array([1.0, 7.0, -3.0, 1.0, 1.0])
    plain = PLATE.transient(time[[0, 1, 4]], 1.0, PLATE.f0 - 20)
    found = np.asarray(PLATE.transient(time, drive, PLATE.f0 - 20))
    np.testing.assert_allclose(found[[0, 1, 4]], plain, rtol=1e-13)  # a handful of roundings


def test_settled_rows_belong_to_their_own_inputs():
    time, drive, frequency, temperature = random_inputs(PLATE, np.random.default_rng(3))
    rows = PLATE.transient(time, drive, frequency, temperature, settled=True)
    ahead = [np.append(c[1:], c[-1]) for c in (drive, frequency, temperature)]
    np.testing.assert_array_equal(rows, PLATE.transient(time, *ahead))


@pytest.mark.parametrize("start", [0.0, 0.3 - 0.1j])
@pytest.mark.parametrize("both_modes", [False, True])
def test_the_first_row_is_the_start_also_under_drive(start, both_modes):
    time = np.linspace(0, 1e-3, 5)
    rows = LOW_Q.transient(time, 3.0, 880.0, start=start, both_modes=both_modes)
    assert rows[0] == start
    assert type(rows) is np.ndarray and rows.dtype == complex


def test_a_delay_is_a_response_that_comes_later():
    time, tau, delay = np.arange(50) * 1e-4, 8e-4, 2.37e-4
    drive = np.where(time < 0.95e-3, 0.0, 1.0)
    hold = hold_inputs(time, drive, delay=delay)
    with jax.enable_x64(True):
        forced = respond(tau, np.zeros(len(hold.drive)), hold).forced
    since = np.maximum(time - 1e-3 - delay, 0)
    np.testing.assert_allclose(forced, 1 - np.exp(-since / tau), atol=1e-15)  # the step's closed form


@pytest.mark.parametrize(("order", "smoothing"), [(1, 3e-4), (4, 1e-4), study(3, 2e-3), study(2, 1e-6)])
def test_a_lock_ins_filter_is_a_cascade_of_poles(order, smoothing):
    """Against the matrix exponential of the slow mode and its stages, at resonance and beside it, slower and
    faster than tau."""
    tau, time = 8e-4, np.arange(60) * 1e-4
    drive = np.select([time < 0.95e-3, time < 3e-3], [0.0, 1.0], 0.3)
    frequency = np.where(time < 4e-3, 32e3, 31.7e3)
    hold = hold_inputs(time, drive, frequency, reference=(32.1e3, 0.0))._replace(smoothing=smoothing)
    with jax.enable_x64(True):
        detuning = 2 * np.pi * hold.offset
        s = poles(tau, detuning, hold.omega)
        found = respond(tau, detuning, hold, order=order)
    state, rows = np.zeros(order + 2, complex), [0.0]
    state[-1] = 1.0
    for k, h in enumerate(np.diff(time)):
        i = hold.interval[k + 1]
        push = complex(s.gain[i]) * hold.drive[i]
        matrix = np.zeros((order + 2, order + 2), complex)
        matrix[0, 0], matrix[0, -1] = complex(s.slow[i]), push
        for j in range(1, order + 1):
            matrix[j, j - 1], matrix[j, j] = 1 / smoothing, -1 / smoothing
        matrix[1, -1] += (
            push / complex(s.fast[i]) / smoothing
        )  # what the fast mode settles at goes through the filter too
        state = expm(matrix * h) @ state
        rows.append(state[order])
    # a filter of a microsecond has e^-100 left of a step: expm loses digits to its largest entries, not the
    # cascade
    np.testing.assert_allclose(found.forced, rows, atol=1e-11)


def test_equal_inputs_are_one_interval_and_arrays_stay_as_they_were():
    time = np.linspace(0, 1e-3, 9)
    drive = np.repeat([0.0, 2.0, 0.0], 3)
    given = time.copy(), drive.copy()
    hold = hold_inputs(time, drive)
    PLATE.transient(time, drive, np.full(9, 32e3))
    assert len(hold.drive) == 3
    assert hold.interval.tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2]  # row 3 is read just before its drive acts
    np.testing.assert_array_equal(time, given[0])
    np.testing.assert_array_equal(drive, given[1])


# --- derivatives
# --------------------------------------------------------------------------------------------------------


def scalar(p, time, drive, frequency, both_modes):
    """A real number that all of G, tau, f0, k_T move."""
    plant = Plant(p[0], p[1], p[2], p[3])
    rows = plant.transient(
        time, drive, frequency, np.linspace(24, 27, len(time)), both_modes=both_modes, start=p[4]
    )
    return jnp.sum(rows.real * np.arange(len(time))) + jnp.sum(jnp.abs(rows - 0.3) ** 2)


CASES = {
    "zero detuning": (1.0, 0.0, 1e-4),
    "zero drive": (0.0, 10.0, 1e-4),
    "zero-length steps": (1.0, 10.0, 0.0),
    "all": (0.0, 0.0, 0.0),
    "long": (1.0, 50.0, 1.0),
}


@pytest.mark.parametrize(
    ("case", "both_modes"),
    [
        (c, both) if c == "all" or (c, both) == ("long", True) else study(c, both)
        for c in CASES
        for both in (True, False)
    ],
)
def test_gradients_are_finite_and_those_of_differences(case, both_modes):
    drive, detuning, dt = CASES[case]
    # Q = 12 exactly at f0; the temperature ramp makes every row an interval of its own
    p = np.array([0.5, 12 / (np.pi * 900), 900.0, 0.0, 0.7])
    time = dt * np.arange(8.0)
    value = jax.jit(lambda p: scalar(p, time, drive, 900.0 - detuning, both_modes))
    with jax.enable_x64(True):
        gradient = np.asarray(jax.grad(value)(p))
        steps = np.array([1e-5, 1e-5 * p[1], 1e-3, 1e-3, 1e-5])
        differences = [(value(p + s) - value(p - s)) / (2 * s.max()) for s in np.diag(steps)]
    assert np.all(np.isfinite(gradient))
    # central differences of relative step 1e-5 keep nine digits of the value, five or six of its derivative
    np.testing.assert_allclose(
        gradient, differences, rtol=2e-5, atol=1e-6 * max(1.0, np.max(np.abs(gradient)))
    )


def test_gradients_go_through_the_plant_itself():
    with jax.enable_x64(True):
        slope = jax.grad(lambda plant: jnp.abs(plant.steady(100.0, 32250.0, 26.0)))(PLATE)
        assert isinstance(slope, Plant)
        found = np.array([slope.G, slope.tau, slope.f0, slope.k_T])
        assert (
            pytest.approx(abs(np.asarray(PLATE.steady(100.0, 32250.0, 26.0))) / PLATE.G) == slope.G
        )  # linear in G
        assert slope.k_T == pytest.approx(2 * slope.f0)  # 2 degC above the reference
        assert np.all(np.isfinite(found)) and np.all(found != 0)


def test_many_plants_at_once():
    time = np.linspace(0, 5e-3, 12)
    taus = np.array([1e-3, 2e-3, 4e-3])
    with jax.enable_x64(True):
        many = jax.jit(jax.vmap(lambda tau: Plant(1.0, tau, 1000.0).transient(time, 1.0, 990.0)))(taus)
        one_by_one = np.array([Plant(1.0, tau, 1000.0).transient(time, 1.0, 990.0) for tau in taus])
    np.testing.assert_allclose(many, one_by_one, rtol=1e-14, atol=1e-16)


def test_double_precision_without_touching_the_flag():
    before = jax.config.jax_enable_x64
    value = np.asarray(PLATE.steady(100.0, PLATE.f0 + 1e-6))
    assert value.dtype == np.complex128
    assert jax.config.jax_enable_x64 == before
    # a micro-hertz in 32.3 kHz: 1e-8 of a half bandwidth, which float32 loses
    assert value.imag == pytest.approx(-2 * 2 * np.pi * 1e-6 * PLATE.tau, rel=1e-4)


def test_a_plant_without_gain_says_so():
    with pytest.raises(ValueError, match="no gain"):
        Plant(None, 1e-3, 1000.0).steady(1.0, 990.0)


def test_far_beyond_its_domain_it_stays_finite():
    with jax.enable_x64(True):
        for tau in (1e-12, 1e12):
            s = poles(jnp.asarray(tau), jnp.asarray(3.0), jnp.asarray(1000.0))
            assert all(np.isfinite(part) for part in s)
            assert np.isfinite(steady(jnp.asarray(tau), jnp.asarray(3.0), jnp.asarray(1000.0)))


@pytest.mark.parametrize("mode", [{}, {"carrier": True}, {"both_modes": True}], ids=str)
def test_many_plants_in_numpy_are_each_the_same_as_compiled(mode):
    rng, rows = np.random.default_rng(0), 161
    time, level = (
        np.cumsum(rng.exponential(3e-4, rows)),
        np.minimum(np.arange(rows), 144),
    )  # 144 intervals: lanes of 9
    drive, frequency = (v[level] for v in (rng.normal(0, 50, rows), rng.normal(32.2e3, 100, rows)))
    hold = hold_inputs(
        time, drive, frequency, reference=(32.2e3, 0.0), theta=rng.uniform(0, 6, rows), delay=1e-5
    )
    hold = hold._replace(spread=np.full(rows, 1e-10))
    tau, shift = np.array([1e-5, 8e-4, 0.3]), np.array([-200.0, 3.0, 90.0])
    many = hold._replace(
        **{k: v[:, None] for k, v in hold._asdict().items() if np.ndim(v) and k != "interval"}
    )
    found = respond(tau, 2 * np.pi * (many.offset + shift), many, xp=np, **mode)
    assert all(type(v) is np.ndarray and v.shape == (rows, len(tau)) for v in found)
    compiled = jax.jit(lambda tau, shift: respond(tau, 2 * np.pi * (hold.offset + shift), hold, **mode))
    for i in range(len(tau)):
        with jax.enable_x64(True):
            one = compiled(tau[i], shift[i])
        for batch, alone in zip(found, one, strict=True):
            np.testing.assert_allclose(batch[:, i], alone, rtol=0, atol=1e-11 * np.max(np.abs(alone)))
