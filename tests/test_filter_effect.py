"""A lock-in's filter that no log states: fitted where the logs show which it is, a misfit where they do
not."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import most, seeds, study
from scipy.linalg import expm
from scipy.signal import lfilter

import sysid
from sysid.effects.filter import FILTERS
from sysid.effects.number import Number
from sysid.effects.registry import EVERY

G, TAU, F0, DT = 0.02, 1.67e-3, 1.9e6, 1e-4


def filtered_step(seed, time, order, noise, beside=40.0, rows=220, late=0.0):
    """A step of 100 V after 20 rows, driven `beside` Hz off the resonance, behind `order` poles of `time`: W'
    = a W + b V and y_j' = (y_(j-1) - y_j)/time as one matrix exponential; white noise after the filter. Q is
    10 000, so that the fast mode is nothing."""
    n, tau = 1 + order, TAU
    A = np.zeros((n + 1, n + 1), complex)
    A[0, 0], A[0, n] = -1 / tau - 2j * np.pi * beside, G / tau * 100
    for j in range(1, n):
        A[j, j - 1], A[j, j] = 1 / time, -1 / time
    t = DT * np.arange(rows)
    y = np.array([0.0 if s <= 0 else (expm(A * s) @ np.eye(n + 1)[n])[order] for s in t - t[20] - late])
    rng = np.random.default_rng([seed, order])
    y = y * np.exp(0.4j) + noise * 2.0 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    drive, frequency = np.where(np.arange(rows) < 20, 0.0, 100.0), np.full(rows, F0 + beside)
    return sysid.Log(
        "step", y, time=t, drive=drive, frequency=frequency, kind="transient", sampling="instant"
    )


def through(seed, time, order, rows, fine=40):
    """Noise of the input behind the same poles, sampled every DT; of one as its level."""
    rng, keep = np.random.default_rng([seed, 7]), np.exp(-DT / fine / time)
    noise = rng.standard_normal((2, (rows + 100) * fine)).T @ (1, 1j)
    for _ in range(order):
        noise = lfilter([1 - keep], [1, -keep], noise)
    noise = noise[::fine][-rows:]
    return noise / np.sqrt(np.mean(np.abs(noise) ** 2) / 2)


def settled_sweep(seed, noise, rows=81):
    """Settled points within four half bandwidths, W = G V/(1 + 2 pi j tau (f - f0))."""
    rng = np.random.default_rng([seed, 99])
    frequency = F0 + np.linspace(-4, 4, rows) / (2 * np.pi * TAU)
    y = G * 100 / (1 + 2j * np.pi * TAU * (frequency - F0)) * np.exp(0.4j)
    y = y + noise * 2.0 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    return sysid.Log("sweep", y, None, np.full(rows, 100.0), frequency, kind="steady")


def fitted(seeds, time, order, late=0.0, noise=3e-3, nuisances=EVERY):
    logs = [[filtered_step(s, time, order, noise, late=late), settled_sweep(s, noise)] for s in seeds]
    return [sysid.fit(of, nuisances=nuisances) for of in logs]


def scores(fits):
    truth = {"G": G, "tau": TAU, "f0": F0}
    return [(p.value - v) / p.std for f in fits for n, v in truth.items() if (p := f.parameters[n])]


@pytest.mark.parametrize(("time", "order"), [study(8e-4, 1), study(5e-4, 3), (1e-4, 4)])
@seeds(1, 4)
def test_a_filter_that_the_logs_show_is_fitted(seeds, time, order, among):
    """Without it all of them are misfits, with tau 3 to 20 of its errors off."""
    fits = fitted(seeds, time, order, nuisances=among("filter"))
    assert all(f.result.name == "successful" for f in fits)
    # of 12 numbers, known to a fifth: two and a half of these above one
    assert np.sqrt(np.mean(np.square(scores(fits)))) < most(3 * [*seeds], 2.45)
    for f in fits:
        (found,) = f.findings
        assert found.key == "filter" and "no lock-in's filter is stated" in " ".join(f.warnings)
        poles, each = (found.numbers[n].value for n in ("lockin_order", "lockin_tau_s"))
        assert (
            abs(poles * each - order * time) < 0.5 * order * time
        )  # the delay; how it is made up is not told


@pytest.mark.parametrize(("time", "order"), [(1e-3, 1), study(3e-4, 4), study(3e-3, 2)])
@seeds(1, 4)
def test_a_filter_that_is_stated_and_not_there_is_told(seeds, time, order, among):
    """G contradicted the sweep's, the drive sagged, or nothing explained it. What is all but no filter has no
    memory of a row."""
    for seed in seeds:
        step = filtered_step(seed, 1e-7, 1, 3e-3)
        step = replace(step, bench={"lockin_tau_s": time, "lockin_order": order})
        found = sysid.fit([step, settled_sweep(seed, 3e-3)], nuisances=among("filter"))
        (told,) = (f for f in found.findings if f.outcome == "fitted")
        assert found.result is sysid.Result.successful
        assert told.key == "filter" and "that it states is not there" in told.sentence
        assert np.max(np.abs(scores([found]))) < 4


def test_a_filter_that_is_hardly_seen_needs_none_that_is_stated():
    """Of means over many rows its error is that of where within them it acts."""
    step = sysid.fit(filtered_step(0, 1e-7, 1, 3e-3), effects="none").modes[0].trials[0]
    found = {"lockin_tau_s": Number(1e-4, 1e-3, "s"), "lockin_order": Number(2.0, 0.0, "1")}
    assert FILTERS[0].said(step, found).what.startswith("no lock-in's filter is stated; one of 2 poles")


@pytest.mark.study
@pytest.mark.parametrize("order", [study(2), 4])
@seeds(1, 6)
def test_noise_that_went_through_the_filter_tells_it_as_well(seeds, order, among):
    """Behind four poles of a quarter of tau, in noise of 2 %, a step was what nothing is known of, with tau
    three times too long. Its numbers are right, be it fitted or named."""
    off = []
    for seed in seeds:
        log = filtered_step(seed, 4e-4, order, 0.0, rows=400)
        log = replace(log, response=log.response + 0.04 * through(seed, 4e-4, order, 400))
        fit = sysid.fit([log], nuisances=among("filter", "delay"))
        (found,) = (f for f in fit.findings if f.outcome in ("fitted", "refused"))
        assert found.key == "filter" and found.numbers["lockin_order"].value == order, fit.warnings
        each = (found.numbers["lockin_tau_s"], 4e-4), (fit.parameters["tau"], TAU)
        off += [(p.value - truth) / p.std for p, truth in each]
    assert max(map(abs, off)) < 4


@pytest.mark.study  # test_scales.py has such a step in other units
def test_whether_a_filter_is_fitted_does_not_hang_on_the_unit():
    """From um to km: the likelihood counts what a filter adds by the noise, of which the logarithm depends on
    the unit."""
    logs = [filtered_step(0, 4e-4, 1, 1.5e-2), settled_sweep(0, 1.5e-2)]
    for unit in (1.0, 1e-9):
        fit = sysid.fit([replace(log, response=unit * log.response) for log in logs])
        assert fit.findings[0].key == "filter" and fit.result.name == "successful"


@pytest.mark.parametrize("rows", [study(3.5), study(8.5)])
@seeds(1, 4)
def test_a_late_trigger_taken_for_a_filter_moves_nothing(seeds, rows):
    """Many poles are a delay: where the sweep tells the plate, either describes the step, and what neither
    does is a misfit."""
    good = [f for f in fitted(seeds, 1e-4, 0, late=rows * DT, noise=1e-2) if f.result.name == "successful"]
    assert not good or np.sqrt(np.mean(np.square(scores(good)))) < most(3 * [*seeds], 2.45)


@pytest.mark.parametrize(
    ("time", "order", "late"), [study(8e-4, 1, 0.0), study(1e-4, 4, 0.0), study(1e-4, 0, 5.5 * DT)]
)
@seeds(1, 4)
def test_behind_an_unknown_filter_a_lone_step_tells_the_plate(seeds, time, order, late):
    """A feedthrough, the gain and how the response begins cancel: G was 40 % off behind a pole of half of
    tau. A bench's feedthrough is small, and of filters and delays that describe the step as well the error of
    G spans all."""
    fits = [sysid.fit([filtered_step(s, time, order, noise=1e-3, late=late)]) for s in seeds]
    assert all(f.result.name == "successful" and f.findings[0].key in ("filter", "delay") for f in fits)
    assert np.sqrt(np.mean(np.square(scores(fits)))) < most(3 * [*seeds], 2.45)


@pytest.mark.study
@seeds(1, 15)
def test_a_wrong_number_of_poles_is_told(seeds, among):
    """Four were stated of two, whose rows were averaged by these: it was late, with G eight errors off."""
    for seed in seeds:
        log = replace(filtered_step(seed, 3e-4, 2, 0.003), bench={"lockin_tau_s": 3e-4, "lockin_order": 4})
        fit = sysid.fit(log, nuisances=among("filter"))
        assert fit.result.name == "successful", fit.warnings
        (found,) = (f for f in fit.findings if f.outcome == "fitted")
        time = found.numbers["lockin_tau_s"]
        assert found.key == "filter" and found.numbers["lockin_order"].value == 2
        assert abs(time.value - 3e-4) < 3 * time.std
        for name, truth in (("G", G), ("tau", TAU), ("f0", F0)):
            assert abs(fit.parameters[name].value - truth) < 4 * fit.parameters[name].std, (seed, name)


@pytest.mark.study
@seeds(1, 4)
def test_noise_of_the_recorder_itself_hides_no_poles(seeds, among):
    """A quarter of what comes through the four poles, by which noise of their colour alone is none: the filter
    was one of two poles, each nearly twice as slow, with its time nine errors off."""
    for seed in seeds:
        log = filtered_step(seed, 2e-4, 4, 5e-4, rows=400)
        log = replace(log, response=log.response + 0.004 * through(seed, 2e-4, 4, 400))
        fit = sysid.fit([log, settled_sweep(seed, 2e-3)], nuisances=among("filter", "delay"))
        (found,) = (f for f in fit.findings if f.outcome in ("fitted", "refused"))
        time = found.numbers["lockin_tau_s"]
        assert found.numbers["lockin_order"].value == 4 and abs(time.value - 2e-4) < 3 * time.std < 3e-5


def test_what_may_as_well_be_another_filter_is_not_fitted():
    """In noise of 3 % a filter of a tenth of tau is a lateness like any other."""
    for fit in fitted(range(2), 1e-4, 2, noise=0.03):
        assert "lock-in's filter is stated" not in " ".join(fit.warnings)
        assert fit.result.name != "successful" or max(map(abs, scores([fit]))) < 4


def test_left_out_it_is_not_looked_for():
    names = ("rotation", "background", "offset", "start", "late")
    logs = [filtered_step(0, 8e-4, 1, 3e-3), settled_sweep(0, 3e-3)]
    assert sysid.fit(logs, nuisances=names).result.name == "misfit"


def lagging_sweep(seed, kind, left=2.0):
    """Points of a plate that has settled behind one pole that has not: of each change e^-left is left."""
    rows, dwell = 121, 0.1
    frequency = F0 + np.linspace(-4, 4, rows) / (2 * np.pi * TAU)
    z, shown = G * 100 / (1 + 2j * np.pi * TAU * (frequency - F0)), []
    for at in z:
        shown.append(at + (shown[-1] - at) * np.exp(-left) if shown else at)
    rng = np.random.default_rng(seed)
    noise = 0.01 * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    return sysid.Log(
        "sweep",
        np.array(shown) + noise,
        dwell * np.arange(rows),
        np.full(rows, 100.0),
        frequency,
        kind=kind,
        bench={"lockin_tau_s": dwell / left, "lockin_order": 1},
    )


@seeds(3, 20)
def test_points_that_have_not_settled_behind_the_stated_filter_are_no_settled_points(seeds):
    """f0 is a sixth of a point, 7 errors, off as settled points."""
    fits = [sysid.fit([lagging_sweep(seed, None)]) for seed in seeds]
    assert all(f.result.name == "successful" for f in fits)
    assert np.sqrt(np.mean(np.square(scores(fits)))) < most(3 * [*seeds], 2.45)
    said = " ".join(sysid.fit([lagging_sweep(0, "steady")]).warnings)
    assert "still holds 14 % of each point" in said
    assert "still holds" not in " ".join(sysid.fit([lagging_sweep(0, "steady", 8.0)]).warnings)


@pytest.mark.study
@pytest.mark.parametrize(
    "offset", [study(-3.1), 3.1]
)  # above its noise, where rows of one sign might be amplitudes
def test_of_two_poles_of_a_step_without_a_frequency_the_slower_is_the_plants(offset):
    """A photodiode behind an oscilloscope's input (closed form): either pole may be the plant's, which is no
    reason to tell none."""
    time = 0.02 * np.arange(-100, 500)
    since = np.maximum(time, 0.0)
    rise = 1 - (2.2 * np.exp(-since / 2.2) - 0.16 * np.exp(-since / 0.16)) / (2.2 - 0.16)
    noise = 0.8 * np.random.default_rng(0).standard_normal(len(time))
    fit = sysid.fit([sysid.Log("rise", 180 * rise + offset + noise, time, np.where(time >= 0, 1.5, 0.0))])
    tau, G = fit.parameters["tau"], fit.parameters["G"]
    assert fit.result == "successful" and [f.key for f in fit.findings][:1] == ["filter"]
    assert abs(tau.value - 2.2) < 3 * tau.std < 0.03
    assert abs(G.value - 120) < 3 * G.std < 0.1 * 120
