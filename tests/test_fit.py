"""The fit: bundled logs against their truth, against an independent least squares, and what it says when logs
cannot tell."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
import reference
from conftest import seeds, study
from scipy.optimize import least_squares
from scipy.stats import chi2

import sysid
from sysid import Result
from sysid.minimum.minimise import shares
from sysid.rows.level import levelled

FAR = 4.5  # standard deviations: seen once in 150 000 normal numbers, and there are about fifty here
# Logs fitted alone: no two share a row, so that their errors are independent of each other.
ALONE = [("plate", name) for name in (
    "amplitude_only_sweep", "duty_staircase", "frequency_staircase", "ring_down", "step_100V_24C", "step_140V_31C",
    "step_60V_27C", "sweep_24C", "sweep_28C", "sweep_32C", "sweep_while_ringing", "two_steps",
)] + [("quartz", name) for name in ("ring_down_25C", "sweep_15C", "sweep_35C")]  # fmt: skip


@pytest.fixture(scope="module")
def alone(bundled):
    """{(folder, name): the fit of that log by itself}."""
    return {key: sysid.fit([bundled[key[0]][key[1]]]) for key in ALONE}


@pytest.fixture(scope="module")
def step_fit(bench):
    return sysid.fit([bench.transient()])


@pytest.fixture(scope="module")
def sweep_fit(bench):
    return sysid.fit([bench.sweep()])


def errors(fit, truth):
    """(value - truth) over `fit.names`, the truth carried to the fit's temperature and gain unit (nm for um:
    1000)."""
    at = fit.reference_temperature
    warming = 0.0 if at is None else at - truth["reference_temperature_degC"]
    scale = 1000.0 if fit.units["G"].startswith("nm") else 1.0
    known = {
        "G": scale * truth["G"],
        "tau": truth["tau"],
        "f0": truth["f0"] + truth["k_T"] * warming,
        "k_T": truth["k_T"],
    }
    return np.array([getattr(fit.plant, name) - known[name] for name in fit.names])


def distance(fit, truth):
    """Squared Mahalanobis distance of the fit from the truth: chi-square with as many degrees of freedom as
    parameters."""
    e = errors(fit, truth)
    return float(e @ np.linalg.solve(fit.covariance, e)), len(e)


# --- against the truth
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", [pytest.param("plate", marks=pytest.mark.always), "quartz", "low_q"])
def test_all_logs_of_a_folder_together(folder, joint_fit, truths):
    fit = joint_fit(folder)
    assert fit.result is Result.successful
    scores = errors(fit, truths[folder]) / np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(scores) < FAR), dict(zip(fit.names, scores, strict=True))
    value, size = distance(fit, truths[folder])
    assert 0.001 < chi2.cdf(value, size) < 0.999


@pytest.mark.parametrize("key", ALONE, ids=lambda key: key[1])
def test_each_log_by_itself(key, alone, truths):
    fit = alone[key]
    assert fit.result is Result.successful
    scores = errors(fit, truths[key[0]]) / np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(scores) < FAR), dict(zip(fit.names, scores, strict=True))


def test_errors_of_independent_logs_are_as_large_as_stated(alone, truths):
    # Parameters of one fit are correlated and a joint fit shares rows with the others. The squared
    # Mahalanobis distances of fits of single logs are independent, each chi-square, and so is their sum.
    found = [distance(alone[key], truths[key[0]]) for key in ALONE]
    value, size = (sum(part) for part in zip(*found, strict=True))
    assert 0.001 < chi2.cdf(value, size) < 0.999, (value, size)


def test_a_sweep_that_moves_while_the_plate_rings(alone):
    fit = alone["plate", "sweep_while_ringing"]
    assert fit.logs[0].kind == "transient"
    # rows 0.48 tau apart hold as much about tau as a settled sweep of 300 points: better than a per cent
    assert fit.parameters["tau"].std < 0.01 * fit.plant.tau


def test_the_noise_of_each_log_is_that_of_its_making(joint_fit, bundled):
    import tomllib
    from pathlib import Path

    text = (Path(__file__).parents[1] / "data" / "synthetic" / "truth.toml").read_text(encoding="utf-8")
    made = tomllib.loads(text)["logs"]
    for fitted in joint_fit("plate").logs:
        truth = made[fitted.log.name.removesuffix(".csv")]
        scale = 1000.0 if fitted.log.response_unit == "nm" else 1.0
        if truth["noise_time_s"]:
            # 400 rows are 66 correlation times: the level is known to 1/sqrt(2 * 66), 9 %, the time to twice
            # that
            assert fitted.noise_std == pytest.approx(truth["noise_um"] * scale, rel=0.3)
            assert fitted.noise_time == pytest.approx(truth["noise_time_s"], rel=0.6)
        else:
            # 100 to 360 rows of one or two channels: 2.6 to 7 %; four of the larger
            assert fitted.noise_std == pytest.approx(
                truth["noise_um"] * scale, rel=0.28 if fitted.log.amplitude_only else 0.2
            )
            assert fitted.noise_time == 0.0


# --- against an independent least squares
# -----------------------------------------------------------------------------------


def slow_modes(tau, f0, time, frequency):
    """Slow pole, fast pole, and b/G of a plant driven at one frequency."""
    w0, omega = 2 * np.pi * f0, 2 * np.pi * frequency
    wd = np.sqrt(w0**2 - tau**-2)
    return -1 / tau + 1j * (wd - omega), -1 / tau - 1j * (wd + omega), w0 / (tau * wd)


def step_model(p, log, through, seconds):
    """Rotation, start, offset, feedthrough and lateness free: p = log G, log tau, f0, phi, two complex
    numbers, and two more in units of the standard deviation of their priors, `through` um and `seconds`."""
    G, tau, f0 = np.exp(p[0]), np.exp(p[1]), 32290 + p[2]
    s1, s2, b = slow_modes(tau, f0, log.time, 32290.0)
    begin = int(np.flatnonzero(log.drive)[0])
    since = np.maximum(log.time - log.time[begin], 0.0)
    on = np.arange(len(log)) > begin  # a row is read just before its inputs act
    W = np.where(on, b * 100 * ((np.exp(s1 * since) - 1) / s1 + 1 / s2), 0)
    start, offset, leak, late = p[4] + 1j * p[5], p[6] + 1j * p[7], p[8] + 1j * p[9], p[10] + 1j * p[11]
    driven = G * np.exp(1j * p[3]) * W - seconds * late * G * b * 100 * on * np.exp(s1 * since)
    return driven + start * np.exp(s1 * (log.time - log.time[0])) + offset + through * leak * on


def sweep_model(p, log):
    """Rotation, and a background with slope: p = log G, log tau, f0, phi, and two complex numbers."""
    G, tau, f0 = np.exp(p[0]), np.exp(p[1]), 32300 + p[2]
    w0, w = 2 * np.pi * f0, 2 * np.pi * log.frequency
    W = 100 * (w0 / w) / (1 - 1j * (w0**2 - w**2) * tau / (2 * w))
    u = (log.frequency - log.frequency.mean()) / 500
    return G * np.exp(1j * p[3]) * W + p[4] + 1j * p[5] + (p[6] + 1j * p[7]) * u


def independent(model, log, size, noise_std, held=()):
    """Estimates of (G, tau, f0 - its reference) and their standard deviations, by scipy; p[held] have a unit
    normal prior."""

    def rows(p):
        left = (log.response - model(p, log)) / noise_std
        return np.concatenate([left.real, left.imag, p[list(held)]])

    begin = np.zeros(size)
    begin[:4] = np.log(0.018), np.log(1.5e-3), 5.0, 0.2
    scale = np.ones(size)
    scale[2] = 30.0
    found = least_squares(rows, begin, x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=2000)
    level = 2 * found.cost / (2 * len(log) + len(held) - size)
    std = np.sqrt(np.diag(level * np.linalg.inv(found.jac.T @ found.jac)))
    p = found.x
    return np.array([np.exp(p[0]), np.exp(p[1]), p[2]]), np.array(
        [np.exp(p[0]) * std[0], np.exp(p[1]) * std[1], std[2]]
    )


@pytest.mark.parametrize("kind", ["step", "sweep"])
def test_agrees_with_an_independent_least_squares(kind, step_fit, sweep_fit):
    trial = step_fit.modes[0].trials[0]
    step = partial(
        step_model, through=trial.bench.narrow["feedthrough"], seconds=trial.bench.narrow["lateness"]
    )
    fit, model, at, size, held = {
        "step": (step_fit, step, 32290, 12, (8, 9, 10, 11)),
        "sweep": (sweep_fit, sweep_model, 32300, 8, ()),
    }[kind]
    values, std = independent(model, fit.logs[0].log, size, fit.logs[0].noise_std, held)
    found = np.array([fit.plant.G, fit.plant.tau, fit.plant.f0 - at])
    assert fit.logs[0].noise_time == 0.0
    # 1e-4 of a standard deviation: the two optimisers stop within 1e-5, the wide prior of the nuisances moves
    # less than that
    np.testing.assert_array_less(np.abs(found - values) / std, 1e-4)
    # scipy's linear covariance at a finite-difference Jacobian, its level from three more degrees of freedom:
    # under 1 %
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), std, rtol=0.02)


# --- reproducible and harmless
# ----------------------------------------------------------------------------------------------


def test_the_same_logs_give_the_same_bytes_and_stay_as_they_were(bench, step_fit):
    log = bench.transient()
    before = {
        name: getattr(log, name).tobytes()
        for name in ("response", "time", "drive", "frequency", "temperature")
    }
    state = np.random.get_state()[1].tobytes()
    again = sysid.fit([log])
    assert again.covariance.tobytes() == step_fit.covariance.tobytes()
    assert again.plant == step_fit.plant
    assert again.cost == step_fit.cost
    assert {name: getattr(log, name).tobytes() for name in before} == before
    assert np.random.get_state()[1].tobytes() == state
    assert not jax.config.jax_enable_x64


def test_from_the_truth_it_ends_where_it_ends_from_nothing(bench, step_fit):
    plant = sysid.Plant(bench.plant.G, bench.plant.tau, bench.plant.f0)
    # the same minimum: its cost to what rounding leaves of a few hundred logarithms
    assert sysid.fit([bench.transient()], start=plant).cost == pytest.approx(step_fit.cost, abs=1e-6)


def test_a_fit_is_shown_in_a_few_lines(step_fit):
    """No arrays: what a notebook or an assertion prints of it."""
    assert len(repr(step_fit.logs[0].log)) < 200 and "rows of Wd + j Wq" in repr(step_fit.logs[0].log)
    assert len(repr(step_fit)) < 2000


def test_an_unknown_nuisance_and_no_logs_are_refused(bench):
    with pytest.raises(ValueError, match="no logs"):
        sysid.fit([])
    with pytest.raises(ValueError, match="unknown nuisance"):
        sysid.fit([bench.sweep()], nuisances=("rotations",))


# --- what the logs cannot tell
# ------------------------------------------------------------------------------------------------


def told(parameter):
    """A determined parameter has its numbers; one that is not has none, and a sentence."""
    numbers = (parameter.value, parameter.std, parameter.ci95)
    assert parameter.determined == all(x is not None for x in numbers) == (parameter.why is None)
    assert parameter.determined or all(x is None for x in numbers)
    return parameter


def test_every_parameter_has_numbers_or_a_reason(joint_fit, alone):
    for fit in [*map(joint_fit, ("plate", "quartz", "low_q")), *alone.values()]:
        assert set(fit.parameters) == {"G", "tau", "f0", "k_T"}
        assert all(told(p) for p in fit.parameters.values())


def test_one_temperature_says_so_and_f0_is_at_it(bench):
    fit = sysid.fit([bench.sweep(temperature=29.5)])
    assert "one temperature (29.5 degC)" in told(fit.parameters["k_T"]).why
    assert fit.reference_temperature == pytest.approx(29.5)
    assert fit.plant.reference_temperature == pytest.approx(29.5)
    p = fit.parameters["f0"]
    assert abs(p.value - (32300 - 10.16 * 5.5)) < FAR * p.std
    assert fit.result is Result.successful  # k_T is not what a controller needs


def test_without_a_temperature_there_is_no_reference(joint_fit):
    assert joint_fit("low_q").reference_temperature is None
    assert "no temperature" in told(joint_fit("low_q").parameters["k_T"]).why


def test_the_amplitude_of_a_step_beside_resonance_has_two_solutions(bench):
    volts = np.repeat([0.0, 100.0], [10, 111])
    fit = sysid.fit([bench.transient(volts=volts, frequency=32220.0, amplitude=True, noise=0.005)])
    f0 = told(fit.parameters["f0"])
    assert not f0.determined
    assert len(f0.modes) == 2
    assert "side of the drive" in f0.why
    below, above = sorted(mode["value"] for mode in f0.modes)
    # +-80 Hz about the drive; the bound at 50 Hz and twice the noise is 1.3 Hz
    assert below == pytest.approx(32140, abs=10)
    assert above == pytest.approx(32300, abs=10)
    assert sum(mode["weight"] for mode in f0.modes) == pytest.approx(1)
    assert fit.parameters["tau"].determined


def test_a_mode_weighs_as_much_as_the_posterior_about_it(bench):
    fit = sysid.fit([bench.sweep()])
    best, p = fit.modes[0], len(fit.names)
    # Twice as wide in p directions a normal density holds 2^p times as much; nuisances that are half as free
    # halve it.
    wide = replace(best, covariance=4 * best.covariance, cost=best.cost + p * np.log(2))
    assert shares([best, wide]) == pytest.approx([0.5, 0.5])
    assert shares([best, replace(best, volume=best.volume + np.log(3))]) == pytest.approx([0.75, 0.25])


def test_without_a_drive_there_is_no_gain(bench):
    fit = sysid.fit([bench.sweep(drive=False)])
    assert "no drive is recorded" in told(fit.parameters["G"]).why
    assert fit.plant.G is None
    assert fit.result is Result.successful
    for name, truth in (("tau", bench.plant.tau), ("f0", 32300.0)):
        assert abs(fit.parameters[name].value - truth) < FAR * fit.parameters[name].std


def test_a_window_of_a_third_of_tau_is_too_short(bench):
    window = 0.3 * bench.plant.tau
    fit = sysid.fit([bench.transient(dt=window / 220)])
    tau = told(fit.parameters["tau"])
    assert fit.result is Result.undetermined
    assert "the longest log covers" in tau.why
    assert "record" in tau.why


def test_a_step_without_a_frequency_is_first_order(bench):
    log = bench.transient(frequency=32300.0)
    plain = replace(log, response=(np.exp(-0.3j) * log.response).real, frequency=None)
    fit = sysid.fit([plain])
    assert fit.plant.f0 is None
    assert "no frequency" in told(fit.parameters["f0"]).why
    for name, truth in (("G", bench.plant.G), ("tau", bench.plant.tau)):
        p = fit.parameters[name]
        assert abs(p.value - truth) < FAR * p.std + (0.03 * truth if name == "tau" else 0.0)


# --- what the model cannot describe
# -----------------------------------------------------------------------------------------


def test_a_clipped_sweep_is_a_misfit(bench, nuisances):
    fit = sysid.fit([bench.sweep(limit=1.2)], nuisances=nuisances)
    assert fit.result is Result.misfit
    assert any("sweep: saturated" in said for said in fit.warnings)
    assert not fit.usable and any(p.determined for p in fit.parameters.values())


def test_a_second_resonance_is_fitted(bench, among):
    def two(clean, frequency):
        return clean + 0.3 * 2.0 / (1 + 1j * (frequency - 32550) / 60)

    fit = sysid.fit([bench.sweep(distort=two)], nuisances=among("second_mode"))
    (found,) = fit.findings
    assert fit.result is Result.successful and (found.key, found.outcome) == ("second_mode", "fitted")
    for name in ("G", "tau", "f0"):
        assert abs(fit.parameters[name].value - getattr(bench.plant, name)) < 4.5 * fit.parameters[name].std
    apart = found.numbers["apart_Hz"]
    assert abs(apart.value - (32550 - bench.plant.f0)) < 4.5 * apart.std


def test_a_fit_that_did_not_converge_says_so(bench, monkeypatch):
    from sysid.minimum.minimise import Minimiser

    whole = Minimiser.refine
    monkeypatch.setattr(
        Minimiser, "refine", lambda *args, **more: replace(whole(*args, **more), converged=False)
    )
    assert sysid.fit([bench.sweep()]).result is Result.not_converged


# --- order and stamps
# -------------------------------------------------------------------------------------------------------


def test_settled_points_are_the_same_in_any_order(bench):
    plain = bench.sweep(noise_time=0.0)
    time = 0.05 * np.arange(101)  # 30 tau apart
    stamped = replace(plain, time=time, kind=None)
    columns = ("response", "drive", "frequency", "temperature")
    reversed_ = replace(stamped, **{name: getattr(stamped, name)[::-1] for name in columns})
    fits = [sysid.fit([log]) for log in (plain, stamped, reversed_)]
    assert [fit.logs[0].kind for fit in fits] == ["steady"] * 3
    values = np.array([[fit.plant.G, fit.plant.tau, fit.plant.f0] for fit in fits])
    std = np.sqrt(np.diag(fits[0].covariance))
    # sums of the same numbers in another order: 1e-6 of a standard deviation
    assert np.all(np.ptp(values, axis=0) / std < 1e-6)


def slow_sweep(bench, times, back, sampling, amplitude):
    """`times` readings at each of 60 frequencies, and `back` again, 5 tau apart; of its own inputs or of the
    row's before."""
    frequency = np.repeat(np.linspace(31800.0, 32800.0, 60), times)
    frequency = np.concatenate([frequency, frequency[::-1]]) if back else frequency
    rows = len(frequency)
    time, volts, warm = 5 * bench.plant.tau * np.arange(rows), np.full(rows, 100.0), np.full(rows, 24.0)
    held = (
        np.append(frequency, frequency[-1]) if sampling == "settled" else np.append(frequency[0], frequency)
    )
    begun = np.append(-40 * bench.plant.tau, time)  # settled at the first row
    clean = reference.ringing(bench.plant, begun, np.full(rows + 1, 100.0), held, np.full(rows + 1, 24.0))[1:]
    response = clean + reference.noise(rows, 0.02, seed=rows)
    response = np.abs(response) if amplitude else response
    return sysid.Log("slow", response, time=time, drive=volts, frequency=frequency, temperature=warm)


@pytest.mark.parametrize("sampling", ["settled", "instant"])
@pytest.mark.parametrize(
    ("times", "back", "amplitude"), [(3, False, False), study(2, False, True), study(1, True, False)]
)
def test_a_slow_sweep_that_repeats_frequencies_is_read_as_its_rows_agree(
    bench, times, back, amplitude, sampling
):
    """By the contract it is a transient; which inputs its rows belong to is not stated."""
    log = slow_sweep(bench, times, back, sampling, amplitude)
    found = sysid.fit([log])
    assert found.result is Result.successful, found.warnings
    assert found.logs[0].kind == log.kind == "transient"
    said = [said for said in found.warnings if "belongs to its own inputs" in said]
    assert len(said) == 1 and f"taken as sampling: {sampling}" in said[0]
    assert not any("late by a row" in said for said in found.warnings)
    for name in ("G", "tau", "f0"):
        p = found.parameters[name]
        assert abs(p.value - getattr(bench.plant, name)) < FAR * p.std, name


@pytest.mark.parametrize("stated", ["settled", "instant"])
def test_a_sampling_that_is_stated_is_kept(bench, stated):
    log = replace(slow_sweep(bench, 3, False, "settled", False), sampling=stated)
    found = sysid.fit([log])
    assert found.logs[0].log.sampling == stated
    assert not any("belongs to its own inputs" in said for said in found.warnings)


def test_a_quick_sweep_that_repeats_frequencies_stays_as_it_is_read(bench):
    """Rows a tenth of tau apart: the response is not settled, so that rows of the same inputs do not agree in
    any case."""
    slow = slow_sweep(bench, 3, True, "settled", False)
    clean = reference.ringing(bench.plant, 0.02 * slow.time, slow.drive, slow.frequency, slow.temperature)
    log = replace(slow, time=0.02 * slow.time, response=clean + reference.noise(len(slow), 0.02, 1))
    found = sysid.fit([log])
    assert found.result is Result.successful and found.logs[0].log.sampling is None
    assert any("taken as sampling: instant" in said for said in found.warnings)


# --- coloured noise
# -----------------------------------------------------------------------------------------------------------


def test_coloured_noise_widens_the_intervals(bench, step_fit):
    fit = sysid.fit([bench.transient(seed=5, noise_time=5e-4)])  # five rows
    assert fit.logs[0].noise_time == pytest.approx(5e-4, rel=0.7)  # 44 correlation times: known to a third
    white, coloured = np.sqrt(np.diag(step_fit.covariance)), np.sqrt(np.diag(fit.covariance))
    # sqrt((1 + rho)/(1 - rho)) = 3.2 for what varies slowly against 0.5 ms; tau is 1.7 ms. G hangs on how
    # late a step is.
    assert np.all(coloured[1:] > 1.6 * white[1:])
    e = np.array([fit.plant.G - bench.plant.G, fit.plant.tau - bench.plant.tau, fit.plant.f0 - 32300])
    assert np.all(np.abs(e) < FAR * coloured)


def test_images_at_two_temperatures_are_all_listed(bench):
    volts = np.repeat([0.0, 100.0], [10, 111])
    logs = [
        bench.transient(seed, volts=volts, frequency=f, amplitude=True, noise=0.005, temperature=t)
        for seed, (f, t) in enumerate(((32220.0, 24.0), (32330.0, 27.0)))
    ]
    fit = sysid.fit(logs)
    # Each log's resonance may lie on either side of its drive: at 24 degC 32140 or 32300 Hz, at 27 degC
    # 32269.5 or 32390.5 Hz.
    assert len(fit.modes) == 4
    T = np.array([24.0, 27.0])
    at = [fit.reference[0] + s.theta[2] + s.theta[3] * (T - fit.reference[1]) for s in fit.modes]
    at.sort(key=lambda pair: tuple(np.round(pair, -2)))
    wanted = [(a, b) for a in (32140.0, 32300.0) for b in (32269.5, 32390.5)]
    np.testing.assert_allclose(at, wanted, atol=10)  # the bound at 50 Hz and twice the noise is 1.3 Hz
    assert not told(fit.parameters["k_T"]).determined and not told(fit.parameters["f0"]).determined
    assert fit.parameters["tau"].determined


def test_a_finger_that_never_leaves_the_plate_is_named(bench, nuisances):
    import dataclasses

    pressed = dataclasses.replace(bench.sweep(), force=np.full(101, 0.5))
    fit = sysid.fit([pressed], nuisances=nuisances)
    assert fit.result is Result.misfit
    assert any("force of 0.5 N" in warning for warning in fit.warnings)
    idle = dataclasses.replace(
        bench.sweep(), force=np.full(101, 0.002)
    )  # a force sensor that shows its noise
    assert sysid.fit([idle]).result is Result.successful


def test_a_temperature_that_drifts_along_with_the_frequency_is_the_reason(bench):
    import dataclasses

    steady = bench.sweep()
    drifting = dataclasses.replace(steady, temperature=np.linspace(24.0, 24.6, 101))
    fit = sysid.fit([drifting])
    assert fit.result is Result.undetermined
    assert "drifted along with the frequency" in told(fit.parameters["tau"]).why
    back = dataclasses.replace(bench.sweep(seed=1), temperature=np.linspace(25.2, 24.6, 101))
    assert sysid.fit([drifting, back]).parameters["tau"].determined  # what it says to record


@pytest.mark.parametrize("rows", [1, 2])
def test_a_moment_holds_no_time_constant(rows):
    inputs = {"drive": np.full(rows, 100.0), "frequency": np.full(rows, 32300.0)}
    log = sysid.Log("moment", np.full(rows, 1 + 1j), time=np.zeros(rows), **inputs)
    fit = sysid.fit([log])
    assert fit.result is Result.undetermined and "cannot tell" in told(fit.parameters["tau"]).why


@pytest.mark.parametrize("offset", [0.0, 0.05])
@seeds(8, 40)
def test_an_output_offset_of_a_step_without_a_baseline_is_in_the_interval_of_g(seeds, offset):
    """Driven at resonance, as no frequency says otherwise: its first row alone tells the offset."""
    time, z = 1e-4 * np.arange(200), []
    for seed in seeds:
        noise = 0.02 * np.random.default_rng(seed).standard_normal(200)
        told = {"time": time, "drive": np.full(200, 100.0), "bench": {"delay_s": 0.0}}
        fit = sysid.fit([sysid.Log("step", 2 * (1 - np.exp(-time / 1.67e-3)) + offset + noise, **told)])
        assert any("its first row, which alone tells an output offset from G" in w for w in fit.warnings)
        z.append(
            [
                (fit.parameters[n].value - truth) / fit.parameters[n].std
                for n, truth in (("G", 0.02), ("tau", 1.67e-3))
            ]
        )
    n = len(seeds)  # three of what so many seeds leave: of 40, 0.35 and 0.5
    assert np.std(z, axis=0) == pytest.approx([1, 1], abs=3.1 / np.sqrt(2 * n))
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.1 / np.sqrt(n))


@pytest.mark.study
@pytest.mark.parametrize("flickers", ["drive", study("frequency")])
def test_a_long_log_whose_inputs_were_measured_is_condensed_like_one_whose_inputs_were_set(bench, flickers):
    """Row by row it would be 40 000 changes of the inputs."""
    rng, n = np.random.default_rng(0), 40_000
    time, volts = 1e-6 * np.arange(n), np.where(np.arange(n) < 4000, 0.0, 100.0)
    rise = 2 * -np.expm1(-np.maximum(time - time[3999], 0) / 1.67e-3)
    rows = rise + 0.02 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    log = sysid.Log(
        "long",
        rows,
        time=time,
        drive=volts,
        frequency=np.full(n, 32300.0),
        kind="transient",
        sampling="instant",
    )
    measured = getattr(log, flickers) + {"drive": 0.05, "frequency": 0.2}[flickers] * rng.standard_normal(n)
    as_set, as_measured = sysid.fit([log]), sysid.fit([replace(log, **{flickers: measured})])
    assert len(as_measured.modes[0].trials[0].log) == len(as_set.modes[0].trials[0].log) < 5000
    for name in ("G", "tau", "f0"):
        a, b = as_set.parameters[name], as_measured.parameters[name]
        assert abs(a.value - b.value) < 0.1 * a.std  # what is left of 0.05 % in 40 000 rows


def test_frequencies_in_any_order_are_kept():
    frequency = np.random.default_rng(0).permutation(np.linspace(32200, 32400, 20_000))
    log = sysid.Log("sweep", np.ones(20_000, complex), drive=np.ones(20_000), frequency=frequency)
    np.testing.assert_array_equal(levelled(log).frequency, frequency)


@pytest.mark.parametrize(
    "drive",
    [
        pytest.param(np.linspace(0, 100, 20_000), id="a ramp"),
        pytest.param(100 + np.sin(np.arange(20_000) / 300), id="a slow modulation"),
        pytest.param(100 + np.sin(np.arange(20_000) / 3), id="a quick one"),
        pytest.param(100 + 10 * np.random.default_rng(0).standard_normal(20_000), id="noise that drives it"),
        pytest.param(np.repeat([0.0, 100.0], 10_000), id="levels that were set"),
    ],
)
def test_a_drive_that_does_more_than_flicker_is_kept(drive):
    log = sysid.Log(
        "long", np.zeros(20_000, complex), time=np.arange(20_000.0), drive=drive, kind="transient"
    )
    np.testing.assert_array_equal(levelled(log).drive, drive)
