"""Errors span effects that logs allow and do not show, by the evidence of each."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import SYNTHETIC, seeds
from scipy.optimize import brentq
from scipy.stats import multivariate_normal

import sysid
from sysid import Scene
from sysid.effects.effect import About
from sysid.effects.number import Number
from sysid.model.theta import NAMES
from sysid.scene import EFFECTS
from sysid.trials.trial import NUISANCES
from sysid.verdict import averaged as averaging
from sysid.verdict import misfit, wording
from sysid.verdict.averaged import Allowed, Average, Hint, averaged
from sysid.verdict.finding import Assumed
from sysid.verdict.linear import USUAL, Linear
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.terms import terms

INPUTS = ("response", "drive", "frequency", "temperature")


@pytest.fixture(scope="module")
def linear(bench):
    """A step with its fit, linearised, and the terms that are tried beside it."""
    fit = sysid.fit(bench.transient(seed=3, noise=0.01))
    state = fit.modes[0]
    views = LinearisedLog.each(state, fit.reference)
    return Linear(views, state, [n for n in NAMES if n in fit.names], 0.0), terms(
        views, fit.names, About.of(state, fit.reference), 0.0
    )


def shows(scored):
    """Whether logs would show an effect of a usual size."""
    return np.min(scored.usual) > averaging.SHOWS**2


def spanned(linear):
    fit, tried = linear
    scored = [(t, s) for t, s in zip(tried, fit.scored(tried), strict=True) if s is not None]
    return [Allowed(t, s) for t, s in scored if averaging.spanned(t) and shows(s)]


def designs(fit, term):
    """The whitened rows of the plant's parameters, of the term for coefficients of a usual size, and of what
    is left."""
    view, shapes = fit.views[0], term.shapes[0]
    usual = USUAL * view.trial.scale / np.max(np.abs(shapes), axis=0)
    return fit.jacobians[0], view.off((shapes * usual).T).T, view.r


def test_an_effect_is_as_likely_as_normal_densities_say(linear):
    """log B = log N(y; 0, 1 + A A^T) - log N(y; 0, 1), y and A off what the plant can adjust."""
    for x in spanned(linear)[::7]:
        plant, effect, left = designs(linear[0], x.term)
        basis = np.linalg.svd(plant, full_matrices=True)[0][:, plant.shape[1] :]
        y, a = basis.T @ left, basis.T @ effect
        absent, there = (
            multivariate_normal(np.zeros(len(y)), np.eye(len(y)) + more).logpdf(y) for more in (0.0, a @ a.T)
        )
        assert x.evidence(x.scored.numbers) == pytest.approx(there - absent, abs=1e-4)


def test_what_it_moves_is_what_least_squares_with_it_say(linear):
    for x in spanned(linear)[::7]:
        plant, effect, left = designs(linear[0], x.term)
        m = effect.shape[1]
        scale = np.linalg.norm(plant, axis=0)
        known = np.concatenate([np.zeros((m, plant.shape[1])), np.eye(m)], axis=1)  # its prior
        both = np.concatenate([np.concatenate([plant / scale, effect], axis=1), known])
        moved = (np.linalg.lstsq(both, np.append(left, np.zeros(m)))[0][: plant.shape[1]]) / scale
        moved -= np.linalg.lstsq(plant / scale, left)[0] / scale
        grown = np.linalg.inv(both.T @ both)[: len(scale), : len(scale)] / np.outer(scale, scale)
        grown -= np.linalg.inv(plant.T @ plant)
        size = np.sqrt(np.diag(np.linalg.inv(plant.T @ plant)))
        expected = (grown + np.outer(moved, moved)) / np.outer(size, size)
        found = x.spans(x.scored.shifts, x.scored.numbers) / np.outer(size, size)
        np.testing.assert_allclose(found, expected, atol=1e-4, rtol=1e-3)


def test_an_effect_that_the_logs_speak_against_adds_nothing(linear):
    quiet = [x.term for x in spanned(linear) if x.evidence(x.scored.numbers) < 0]
    assert len(quiet) > 10
    assert not np.any(averaged(linear[0], quiet).covariance)


def growth(fit):
    """By which factor the errors of theta span effects."""
    state = fit.modes[0]
    some = np.diag(state.covariance) > 0
    return np.sqrt(1 + np.diag(state.dispersion)[some] / np.diag(state.covariance)[some])


@seeds(10, 200)
def test_clean_logs_keep_their_errors(bench, seeds):
    """Most of them to the digit; all of them by 4 % on average, which is what spanning may cost."""
    fits = [sysid.fit([bench.transient(seed=s), bench.sweep(seed=s)]) for s in seeds]
    grown = [growth(f) for f in fits if not any("differ by more" in n for n in (*f.notes, *f.warnings))]
    assert np.median(grown) == 1
    assert np.mean(grown) < 1.04


def without_rows(log, begin, rows):
    """The log, as of a recorder that lost rows and counts on."""
    kept = np.delete(np.arange(len(log)), np.arange(begin, begin + rows))
    return replace(
        log, time=log.time[: len(kept)], **{name: np.asarray(getattr(log, name))[kept] for name in INPUTS}
    )


@pytest.mark.study
@seeds(40, 200)
def test_rows_that_are_missing_and_hardly_show_leave_true_intervals(bench, seeds):
    """A row, a sixteenth of tau, is lost somewhere on the rise. Where it hardly shows tau is four of its errors
    off without what they span. With it a root mean square of 3 is allowed: what is a usual effect is known to
    a factor, by which less evidence leaves more to the prior."""
    z, grown = [], []
    for s in seeds:
        fit = sysid.fit([without_rows(bench.transient(seed=s), 22 + s % 12, 1)], nuisances=NUISANCES)
        if fit.result.name == "successful":
            tau = fit.parameters["tau"]
            z.append((tau.value - bench.plant.tau) / tau.std)
            grown.append(growth(fit)[1])
    z, grown = np.array(z), np.array(grown)
    assert np.sqrt(np.mean((z * grown) ** 2)) > 4
    assert np.sqrt(np.mean(z**2)) < 3


def test_what_an_error_spans_is_told(bench):
    """As a finding, and in words that say how likely it is and which error spans it."""
    logs = (without_rows(bench.transient(seed=s), 22 + s % 12, 2) for s in range(20))
    fits = (sysid.fit(log, nuisances=NUISANCES) for log in logs)
    spans = ((fit, f) for fit in fits for f in fit.findings if f.outcome == "widened")
    fit, hint = next((fit, f) for fit, f in spans if f.key == "rows_lost")
    assert hint.logs == ("step",) and hint.evidence > 0
    assert "rows seem to be missing" in hint.sentence
    assert "the error of tau spans it" in hint.sentence
    assert hint.sentence in (*fit.notes, *fit.warnings)


def test_what_an_error_cannot_span_is_told(bench, monkeypatch):
    """Where tau would not be determined with it: its error stays narrow, and a warning says so."""
    fit = sysid.fit(bench.transient(seed=3))
    hint = Hint(
        "rows_lost", ("step",), "step: rows seem to be missing", 0.2, "tau", 90.0, 1.0, {"tau": 180.0}
    )
    wide = np.diag([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # of log tau: a factor of e
    monkeypatch.setattr(misfit, "averaged", lambda *_: Average(wide, hint))
    narrow = sysid.fit(bench.transient(seed=3))
    assert narrow.parameters["tau"] == fit.parameters["tau"]
    said = next(f for f in narrow.findings if f.key == "rows_lost")
    assert said.outcome == "noted"
    assert "the error of tau does not include it" in said.sentence
    assert said.sentence in narrow.warnings


def test_an_effect_that_logs_would_not_show_counts_once_it_is_worth_more_than_chance(linear):
    """Of one kind at n places, at odds (B - 1)/n."""
    fit, tried = linear
    each = [Allowed(t, s) for t, s in zip(tried, fit.scored(tried), strict=True) if s is not None]
    each = [x for x in each if averaging.spanned(x.term) and not shows(x.scored)]
    told = 0
    for x in each:
        places, usual, log_b = 3, x.scored.usual, 2.0
        together = averaging.Together.of([x] * places)
        long = np.sqrt((2 * log_b + np.sum(np.log1p(usual))) * (1 + usual[0]) / usual[0])
        for number in (long, -long):
            numbers = np.zeros((1, len(usual) * places))
            numbers[0, 0] = number
            if not x.sensible(x.scored.values @ x.mean(numbers[0, : len(usual)])):
                continue
            seen, odds = np.array([[True], [False], [False]]), np.expm1(log_b) / places
            of_all = np.tile(usual, places)[None], np.tile(x.scored.values.T, (places, 1))[None]
            assert not together.likely(numbers, *of_all).any()
            share = together.likely(numbers, *of_all, seen=seen)
            assert share[:, 0] == pytest.approx([odds / (1 + odds), 0, 0])
            told += 1
    assert told > 2


def damped(bench, volts, power, taken=0.1):
    """A sweep of a plate that is damped by 1 + c |W|^power, which takes that share off its peak at 100 V: the
    root of |W|^2 ((1 + c |W|^power)^2 + x^2) = (G V)^2 at x half bandwidths."""
    f, hb = np.linspace(31800, 32800, 101), 1 / (2 * np.pi * bench.plant.tau)
    x, drive = (f - bench.plant.f0) / hb, bench.plant.G * volts
    c = (1 / (1 - taken) - 1) / ((1 - taken) * bench.plant.G * 100) ** power
    size = [brentq(lambda w, a=a: w * np.hypot(1 + c * w**power, a) - drive, 0, drive) for a in x]
    clean = drive / (1 + c * np.array(size) ** power + 1j * x)
    noise = np.random.default_rng(3).standard_normal((2, 101)) * 0.01 * bench.plant.G * volts
    each = np.full(101, volts), f, np.full(101, 24.0)
    return sysid.Log(f"at {volts:g} V", clean * 1j + noise[0] + 1j * noise[1], None, *each)


def test_a_sweep_at_one_level_tells_what_it_takes_not_to_be_there(bench):
    """As much damping by the amplitude as the note says moves the fit as far as it says, to first order."""
    plain = sysid.fit([damped(bench, 100.0, 2, 0.0)])
    (told,) = [a for a in plain.assumed if a.key == "amplitude_damping"]
    assert told.logs == ("at 100 V",) and told.shown_by == "levels of the drive that are far apart"
    taken = told.size.value / (1 + told.size.value)
    found = sysid.fit([damped(bench, 100.0, 1, taken)], effects="rotation,offset,background").parameters
    assert set(told.moves) == {"G", "tau"}
    for name, size in told.moves.items():
        moved = abs(np.log(found[name].value / plain.parameters[name].value))
        assert moved == pytest.approx(size, rel=0.25)  # what moves it is of first order


def test_what_shows_is_not_taken_not_to_be_there(bench):
    """Two levels of the drive show damping by the amplitude."""
    found = sysid.fit([damped(bench, 100.0, 2, 0.0), damped(bench, 30.0, 2, 0.0)])
    assert "amplitude_damping" not in {a.key for a in found.assumed}


def test_a_log_without_a_frequency_hides_nothing_of_one():
    """A step of first order (closed form): no frequency of its plate may depend on the amplitude."""
    time = np.arange(-0.05, 0.4, 0.002)
    rise = 6.6 * (1 - np.exp(-np.maximum(time, 0.0) / 0.045))
    noise = 0.02 * np.random.default_rng(5).standard_normal(len(time))
    fit = sysid.fit([sysid.Log("step", rise + noise, time, np.where(time >= 0, 2.0, 0.0))])
    assert "duffing" not in {a.key for a in fit.assumed}
    assert abs(fit.parameters["tau"].value - 0.045) < 4 * fit.parameters["tau"].std < 0.004


def test_what_would_move_k_t_alone_is_not_told(linear):
    """A sentence on it would name no parameter."""
    fit, tried = linear
    each, logs = averaging.Hidden.each(fit, tried), [v.trial.log.name for v in fit.views]
    assert averaging.assumed(each, fit.names, fit.std, logs)
    assert not averaging.assumed(each, ["k_T"] * len(fit.names), fit.std, logs)


@pytest.mark.study
def test_a_slow_sweep_of_one_direction_hides_that_the_plate_heats_itself():
    """A second at each of 101 frequencies: what would not show of it is told, and a plate that heats itself,
    with f0 15 standard deviations too low, has an error that spans it."""
    scene = Scene.from_toml(SYNTHETIC / "scenes" / "figure_6_sweep.toml")
    second = np.arange(101.0)
    frequency = sysid.Profile(second, scene.inputs["frequency"].at(second))
    inputs = {**scene.inputs, "frequency": frequency}
    slow = replace(scene, kind="transient", rows=102, rate=1.0, inputs=inputs)
    plain, heated = (
        sysid.fit([replace(slow, effects=(*scene.effects, *more)).simulate(31)])
        for more in ((), (EFFECTS["self_heating"](),))
    )
    (told,) = [a for a in plain.assumed if a.key == "self_heating"]
    assert told.size.unit == "Hz" and told.shown_by == "a sweep back as well"
    assert told.moves["f0"] > 4 * plain.parameters["f0"].std
    f0 = heated.parameters["f0"]
    assert [f.key for f in heated.findings] == ["self_heating"]
    assert abs(f0.value - plain.parameters["f0"].value) < 3 * f0.std


def test_sweeps_of_one_direction_hide_that_all_of_them_drift_alike(bench):
    """Settled points: a drift along the frequencies is another scale of these, by which tau is off; as much as
    is told moves tau as far as it says (closed form: frequencies stretched by the drift over their span). A
    sweep back shows it."""
    there, back = bench.sweep(seed=3), bench.sweep(seed=4)
    told = {a.key: a for a in sysid.fit([there, bench.sweep(seed=5)]).assumed}["f0_drift"]
    assert len(told.logs) == 2 and set(told.moves) == {"tau"}
    stretched = abs(told.size.value) / np.ptp(there.frequency)
    assert told.moves["tau"] == pytest.approx(stretched, rel=0.05)
    turned = sysid.Log("back", back.response[::-1], None, *(x[::-1] for x in (back.drive, back.frequency)))
    assert "f0_drift" not in {a.key for a in sysid.fit([there, turned]).assumed}


def test_a_lone_step_hides_that_its_drive_overshoots(bench):
    """It looks like another tau, by as much as the note says: a drive that is too high by s exp(-t/T) (closed
    form, T = tau: w = 1 - (1 - s t/tau) exp(-t/tau)). A sweep shows it."""
    step, sweep = bench.transient(seed=1, frequency=bench.plant.f0), bench.sweep(seed=2)
    plain = sysid.fit([step])
    hidden = {a.key: a for a in plain.assumed}
    told = hidden["drive_overshoot"]
    assert hidden["second_mode"].shown_by == told.shown_by
    assert hidden["second_mode"].size.unit == "of the largest response"
    assert told.shown_by == "a sweep of settled points as well" and "tau" in told.moves
    assert told.moves["tau"] > 4 * plain.parameters["tau"].std / plain.parameters["tau"].value
    tau = plain.parameters["tau"].value
    after = np.maximum(step.time - step.time[np.flatnonzero(step.drive)[0]], 0.0) / tau
    turn = plain.modes[0].trials[0].bench.turn
    over = plain.parameters["G"].value * np.max(step.drive) * told.size.value * after * np.exp(-after) * turn
    found = sysid.fit([replace(step, response=step.response + over)], effects="rotation,offset,late")
    moved = np.log(found.parameters["tau"].value / tau)
    assert -moved == pytest.approx(told.moves["tau"], rel=0.25)  # what moves it is of first order
    assert not {"drive_overshoot", "second_mode"} & {a.key for a in sysid.fit([step, sweep]).assumed}


def test_what_is_assumed_is_one_sentence():
    shown_by, row, damping = "levels of the drive that are far apart", "of the largest row", "of the damping"
    each = [
        Assumed("saturation", ("a", "b"), shown_by, Number(0.02, 0.0, row), {"G": 0.031}),
        Assumed("saturation", ("b",), shown_by, Number(0.05, 0.0, row), {"G": 0.011}),
        Assumed("amplitude_damping", ("b",), shown_by, Number(0.03, 0.0, damping), {"tau": 0.01, "f0": 3.4}),
        Assumed("f0_drift", ("b",), "a sweep back as well", Number(-204.3, 0.0, "Hz"), {"tau": 0.2}),
    ]
    assert wording.assumed(each) == [
        "a, b: taken as without saturation (5 % of the largest row), amplitude damping (3 % of the damping); as"
        " much would not show here, and would move G by 3.1 %, tau by 1 %, f0 by 3.4 Hz; record levels of the"
        " drive that are far apart",
        "b: taken as without f0 drift (204 Hz); as much would not show here, and would move tau by 20 %; record"
        " a sweep back as well",
    ]
