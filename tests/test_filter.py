"""A transient behind a stated lock-in filter that begins amid a drive: the filter holds what was before the
first row.

The truth is a matrix exponential of plant (slow mode) and filter, a chain of equal poles whose input is the
plant's response and the drive's feedthrough. It shares no code with the package.
"""

import re
from itertools import pairwise

import jax
import numpy as np
import pytest
from conftest import most, seeds, study
from scipy.linalg import expm
from scipy.signal import lfilter

import sysid
from sysid.model.plant import respond
from sysid.rows.hold import hold_inputs
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

G, TAU, F0, DRIVEN = 0.02, 1.67e-3, 32300.0, 32280.0
LOCKIN_TAU, SPACING, ROWS = 5e-5, 5e-5, 160
LEVELS = np.repeat([60.0, 100.0, 30.0, 80.0], ROWS // 4)


def through(order, feedthrough, state, levels=LEVELS):
    """(n,) what the filter's last pole shows just before each row's inputs act; `state` at the first row: of
    the plant, the filter's poles."""
    a = np.zeros((order + 2, order + 2), complex)  # plant, poles, drive
    a[0, 0], a[0, -1] = -1 / TAU + 2j * np.pi * (F0 - DRIVEN), G / TAU
    a[1, 0], a[1, -1] = 1 / LOCKIN_TAU, feedthrough * G / LOCKIN_TAU
    for k in range(1, order + 1):
        a[k, k] = -1 / LOCKIN_TAU
        a[k, k - 1] = 1 / LOCKIN_TAU
    step, z, found = expm(a * SPACING), np.append(state, 0.0).astype(complex), []
    for volts in levels:
        found.append(z[-2])
        z[-1] = volts
        z = step @ z
    return np.array(found)


def log(order, seed, state=None):
    rng = np.random.default_rng(seed)
    clean = through(order, 0.03 * np.exp(0.6j), np.zeros(order + 1) if state is None else state)
    rows = np.exp(0.4j) * clean + 0.01 + 2e-3 * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    given = {"drive": LEVELS, "frequency": np.full(ROWS, DRIVEN), "kind": "transient", "sampling": "instant"}
    return sysid.Log(
        "amid",
        rows,
        time=SPACING * np.arange(ROWS),
        bench={"lockin_tau_s": LOCKIN_TAU, "lockin_order": order},
        **given,
    )


@pytest.mark.parametrize("order", [study(1), 2, study(4)])
@pytest.mark.parametrize("begins", ["at rest", "anywhere"])
@seeds(2, 20)
def test_what_the_filter_holds_at_the_first_row_is_no_feedthrough(seeds, order, begins):
    """Taken for settled it moves G, whose error is small here, by some twenty errors."""
    z = []
    for seed in seeds:
        state = None if begins == "at rest" else np.random.default_rng([seed, 1]).uniform(-1, 1, order + 1)
        fit = sysid.fit([log(order, seed, state)])
        assert fit.result.name == "successful", fit.warnings
        z.append(
            [
                (fit.parameters[n].value - truth) / fit.parameters[n].std
                for n, truth in (("G", G), ("tau", TAU), ("f0", F0))
            ]
        )
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds, 3))  # G is covered too often by design


@pytest.mark.parametrize("order", [study(1), study(2), 4])
@seeds(2, 20)
def test_a_decay_from_the_row_on_where_the_drive_ended(seeds, order):
    """The filter holds what had settled, and no decay: taken for one since ever the log had one or two other
    resonances."""
    z, a = [], -1 / TAU + 2j * np.pi * (F0 - DRIVEN)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        clean = through(order, 0.0, np.full(order + 1, -G / TAU * 60.0 / a), np.zeros(ROWS))
        rows = clean + 2e-3 * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
        given = {"time": SPACING * np.arange(ROWS), "frequency": np.full(ROWS, DRIVEN), "kind": "transient"}
        bench = {"lockin_tau_s": LOCKIN_TAU, "lockin_order": order}
        fit = sysid.fit([sysid.Log("decay", rows, sampling="instant", bench=bench, **given)])
        assert fit.result.name == "successful", fit.warnings
        assert not any(f.outcome in ("fitted", "refused") for f in fit.findings)
        p, rings = fit.parameters, np.hypot(F0, 1 / (2 * np.pi * TAU))  # at F0, as it is damped
        z.append([(p[n].value - truth) / p[n].std for n, truth in (("tau", TAU), ("f0", rings))])
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds, 2))


def test_it_is_not_reported_as_a_quantity_of_the_bench():
    assert not any("memory" in name for name in sysid.nuisances(sysid.fit([log(2, 0)]))[0])


def behind(order, rows, step):
    """Rows `step` apart, held from each to the next, behind the filter."""
    keep = np.exp(-step / LOCKIN_TAU)
    for _ in range(order):
        rows = lfilter([1 - keep], [1, -keep], rows)
    return rows


@pytest.mark.parametrize("order", [study(2), 4])
@seeds(2, 30)
def test_noise_that_came_through_the_filter_too(seeds, order):
    """Ten rows to its time constant: smoother than an Ornstein-Uhlenbeck process, by which errors were half
    as large."""
    step, rows, fine = LOCKIN_TAU / 10, 2000, 8
    a = -1 / TAU + 2j * np.pi * (F0 - DRIVEN)
    since = step / fine * np.maximum(np.arange(rows * fine) - rows * fine // 10, 0)
    clean = behind(order, -G / TAU * 60.0 / a * (1 - np.exp(a * since)), step / fine)[::fine]
    drive, z = np.where(np.arange(rows) < rows // 10, 0.0, 60.0), []
    given = {
        "time": step * np.arange(rows),
        "drive": drive,
        "frequency": np.full(rows, DRIVEN),
        "sampling": "instant",
    }
    for seed in seeds:
        rng, n = np.random.default_rng(seed), rows * fine + 8000
        noise = behind(order, rng.standard_normal(n) + 1j * rng.standard_normal(n), step / fine)[8000::fine]
        bench, response = (
            {"lockin_tau_s": LOCKIN_TAU, "lockin_order": order},
            clean + 0.012 / np.std(noise) * noise,
        )
        fit = sysid.fit([sysid.Log("step", response, kind="transient", bench=bench, **given)])
        z.append(
            [
                (fit.parameters[n].value - truth) / fit.parameters[n].std
                for n, truth in (("G", G), ("tau", TAU), ("f0", F0))
            ]
        )
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds, 3))


GRIDS = {
    "even": 1e-5 * np.arange(1000),
    "jittered": 1e-5 * np.arange(1000) + np.random.default_rng(0).uniform(-4e-6, 4e-6, 1000),
    "denser at the step": np.append(2e-6 * np.arange(500), 1e-3 + 2e-5 * np.arange(500)),
}


@pytest.mark.study
@pytest.mark.parametrize(
    ("late", "lockin_tau"),
    [(0.0, 1e-9), study(0.0, 1e-4), study(0.0, 1.0), study(2e-4, 1e-9), study(2e-4, 1.0)],
)
@pytest.mark.parametrize("grid", ["even", study("jittered"), study("denser at the step")])
def test_a_filter_that_was_not_there_on_rows_of_any_times(grid, late, lockin_tau):
    """Nothing but one that is too short to matter is believed, and no late trigger: the filter or the delay that
    there is is found, with the plate as it is, or the log is refused."""
    time, rng = GRIDS[grid] - GRIDS[grid][0], np.random.default_rng(1)
    a, on = -1 / TAU + 2j * np.pi * (F0 - DRIVEN), np.arange(len(time)) >= 100
    clean = -G / TAU * 60.0 / a * (1 - np.exp(a * np.maximum(time - time[100] - late, 0.0)))
    response = clean + 0.012 * (rng.standard_normal(len(time)) + 1j * rng.standard_normal(len(time)))
    bench = {"lockin_tau_s": lockin_tau, "lockin_order": 4}
    given = {
        "drive": np.where(on, 60.0, 0.0),
        "frequency": np.full(len(time), DRIVEN),
        "sampling": "instant",
        "bench": bench,
    }
    fit = sysid.fit([sysid.Log("step", response, time=time, kind="transient", **given)])
    found = {f.key for f in fit.findings if f.outcome == "fitted"}
    if lockin_tau == 1e-9 and late == 0.0:
        assert fit.result.name == "successful" and not found, fit.warnings
    if fit.result.name == "successful":
        assert found <= {"filter", "delay"} and (found or (lockin_tau == 1e-9 and late == 0.0)), fit.warnings
        truth = {"G": G, "tau": TAU, "f0": F0}
        for name, p in fit.parameters.items():
            assert not p.determined or abs(p.value - truth[name]) < 4 * p.std, name
    assert not any("record ten points" in (p.why or "") for p in fit.parameters.values())


def course(order, step, rows, f0=1500.0, tau=10e-3):
    """A step at a tenth of the rows, by 3 Hz above a plate of Q 47: its trial, the course, and the fit's own
    model, per G V."""
    time, drive = step * np.arange(rows), np.where(np.arange(rows) < rows // 10, 0.0, 1.0)
    bench = {"lockin_tau_s": 1e-3, "lockin_order": order} if order else {}
    given = {
        "drive": drive,
        "frequency": np.full(rows, f0 + 3.0),
        "kind": "transient",
        "sampling": "instant",
        "bench": bench,
    }
    trial = Trial.of(sysid.Log("step", np.ones(rows, complex), time=time, **given), "transient")
    found = LogResponse(trial, trial.hold((f0, 0.0)), np.array([0.0, np.log(tau), 0.0, 0.0, 0.0, 0.0]))
    with jax.enable_x64(True):
        return trial, found, np.asarray(respond(tau, found.detuning, found.hold, order=order).forced)


@pytest.mark.parametrize("order", [0, study(1), 4])
def test_the_course_is_that_of_the_fit_at_any_q(order):
    """The ripple of the fast mode and what it pulls the slow one by cancel where the response has settled."""
    _, found, model = course(order, 1e-4, 4000)
    np.testing.assert_allclose(found.forced, model, rtol=0, atol=1e-12)


def test_a_response_that_is_later_is_later_behind_the_filter():
    _, found, _ = course(1, 1e-4, 4000)
    np.testing.assert_array_equal(found.later(0.0), found.forced)
    np.testing.assert_allclose(found.later(3e-4)[3:], found.forced[:-3], atol=1e-12)


@pytest.mark.parametrize("order", [study(2), 4])
def test_a_block_of_rows_shows_their_mean(order):
    """To fourth order in the block's length."""
    trial, found, model = course(order, 2e-5, 4000)
    assert len(trial.log) < 1000
    fine = hold_inputs(trial.whole.time, trial.whole.drive, trial.whole.frequency, reference=(1500.0, 0.0))
    with jax.enable_x64(True):
        every = np.asarray(
            respond(found.tau, 2 * np.pi * fine.offset, fine._replace(smoothing=1e-3), order=order).forced
        )
    ends = np.append(0, np.cumsum(trial.noise.count).astype(int))
    mean = [np.mean(every[a:b]) for a, b in pairwise(ends)]
    np.testing.assert_allclose(model, mean, rtol=0, atol=2e-5)


@pytest.mark.parametrize("dark", [study(0.05), 0.3])
@pytest.mark.parametrize("order", [0, study(4)])
def test_rows_without_a_signal_are_no_part_of_the_mean_of_their_block(order, dark):
    rng, rows, step = np.random.default_rng(3), 20_000 if not order else 4000, LOCKIN_TAU / 10
    a = -1 / TAU + 2j * np.pi * (F0 - DRIVEN)
    clean = -G / TAU * 60.0 / a * (1 - np.exp(a * step * np.maximum(np.arange(rows) - rows // 10, 0)))
    response = behind(order, clean, step) + 0.012 * (
        rng.standard_normal(rows) + 1j * rng.standard_normal(rows)
    )
    response[gone := rng.random(rows) < dark] = 0.0
    bench = {"lockin_tau_s": LOCKIN_TAU, "lockin_order": order} if order else {}
    given = {
        "drive": np.where(np.arange(rows) < rows // 10, 0.0, 60.0),
        "frequency": np.full(rows, DRIVEN),
        "bench": bench,
    }
    fit = sysid.fit(
        [
            sysid.Log(
                "step", response, time=step * np.arange(rows), kind="transient", sampling="instant", **given
            )
        ]
    )
    said = re.search(r"(\d+) of (\d+) rows read exactly zero", " ".join(fit.warnings))
    assert abs(int(said[1]) - np.sum(gone[rows // 10 :])) < 0.2 * np.sum(gone) and int(said[2]) == rows
    for name, truth in (("G", G), ("tau", TAU), ("f0", F0)):
        p = fit.parameters[name]
        assert abs(p.value - truth) < 4 * p.std
    assert fit.parameters["tau"].std < 0.01 * TAU  # most blocks have rows that hold a signal


@pytest.mark.parametrize("filtered", [True, False])
@pytest.mark.parametrize("offset", [0.01, 0.03, 0.3])
def test_an_offset_under_a_step_that_begins_at_its_first_row_is_no_feedthrough(offset, filtered):
    """A feedthrough is not there yet in the first row, and rises behind a filter; an offset is there. The
    plate and its filter are at rest before."""
    rng, f0, time = np.random.default_rng(4), 6750.0, np.sort(np.random.default_rng(1).uniform(0, 0.5, 250))
    time[0] = 0.0
    plate, lag, size = -10.0 + 1j * 7.0, -37.0, 1e-3  # rates (1/s), and the response where it has settled
    y = 1 - np.exp(plate * time)
    if filtered:
        y = 1 + (lag * np.exp(plate * time) - plate * np.exp(lag * time)) / (plate - lag)
    response = size * (1j * y * (10 / abs(plate)) + offset * np.exp(1j))
    response += 5e-7 * (rng.standard_normal(250) + 1j * rng.standard_normal(250))
    rows = np.full(250, 0.1), np.full(250, f0), None
    bench = {"lockin_tau_s": -1 / lag, "lockin_order": 1.0} if filtered else {}
    found = sysid.fit(
        [sysid.Log("s", response, time, *rows, kind="transient", sampling="instant", bench=bench)]
    )
    assert not [f for f in found.findings if f.outcome in ("refused", "fitted")]
    tau, shown = found.parameters["tau"], found.parameters["f0"]
    assert abs(tau.value - 0.1) < 4 * tau.std
    assert abs(shown.value - (f0 + 7.0 / (2 * np.pi))) < 4 * shown.std
