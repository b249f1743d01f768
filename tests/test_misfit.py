"""What the model leaves out is named, and logs that it describes are not doubted."""

import re
from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import SYNTHETIC, most, seeds, study
from scipy.stats import binom

import sysid
from sysid import Result, Scene
from sysid.reading import read_as
from sysid.rows.condense import taken
from sysid.rows.gap import gaps
from sysid.scene import EFFECTS
from sysid.trials.trial import NUISANCES, Trial

SCENES = SYNTHETIC / "scenes" / "plate"


def simulated(name, seed, *effects, **changes):
    """A log of a scene of data/synthetic with further effects, as someone writes it down who does not know of
    them."""
    scene = Scene.from_toml(SCENES / f"{name}.toml")
    kept = tuple(e for e in scene.effects if e.name not in {new.name for new in effects})
    log = replace(scene, effects=(*kept, *effects)).simulate(seed)
    return replace(log, bench={}, force=None, **changes)


def other_plant(bench, **changes):
    """The bench with another plate on it."""
    other = object.__new__(type(bench))
    other.plant = replace(bench.plant, **changes)
    return other


def finger_on_the_third(bench):
    touched = other_plant(bench, G=0.6 * bench.plant.G, tau=0.6 * bench.plant.tau)
    volts = np.repeat([0.0, 100.0], [20, 220])
    logs = [bench.transient(seed=1), bench.transient(seed=2, volts=0.6 * volts), touched.transient(seed=3)]
    return [replace(log, name=f"step {k + 1}") for k, log in enumerate(logs)]


def late_trigger(bench):
    log = bench.transient(seed=4)
    return [replace(log, response=np.concatenate([log.response[:4], log.response[:-4]]))]


def fourth_order_lock_in(bench):
    return [simulated("step_100V_24C", 5, EFFECTS["lock_in"](tau=100e-6, order=4))]


def lock_in_of_a_sweep(bench):
    """Rows 0.8 ms apart tell how late they are, 0.3 ms; more than the first order of that moves G."""
    return [simulated("sweep_while_ringing", 21, EFFECTS["lock_in"](tau=300e-6))]


def softening(bench):
    return [simulated("sweep_while_ringing", 6, EFFECTS["duffing"]())]


def sine_law(bench):
    return [simulated("duty_staircase", 7, EFFECTS["inverter"](supply=100.0, law="sine"))]


def second_resonance(bench):
    return [simulated("sweep_24C", 8, EFFECTS["second_mode"](f0=32450.0))]


def saturated(bench):
    return [simulated("step_100V_24C", 9, EFFECTS["saturation"](limit=1.5))]


def hurried_sweep(bench):
    """A sweep with a row per time constant, called settled; so it was at its first row."""
    rows, tau = 101, bench.plant.tau
    time, frequency = tau * np.arange(rows), np.linspace(31800, 32800, rows)
    held = np.append(-40 * tau, time[1:])
    clean = reference.ringing(bench.plant, held, np.full(rows, 100.0), frequency, np.full(rows, 24.0))
    clean[0] = reference.steady(bench.plant, np.full(1, 100.0), frequency[:1], np.full(1, 24.0))[0]
    settled = bench.sweep(seed=10)
    return [replace(settled, response=clean + reference.noise(rows, 0.02, 10, time, 0.0))]


def two_resonances(bench):
    warmer = other_plant(bench, f0=bench.plant.f0 - 20.0)
    return [bench.sweep(seed=11), replace(warmer.sweep(seed=12), name="other")]


def softer_when_warm(bench):
    return [
        other_plant(bench, tau=bench.plant.tau * (1 + 0.01 * (degC - 24.0))).sweep(seed=13, temperature=degC)
        for degC in (20.0, 24.0, 28.0, 32.0)
    ]


def millimetres(bench):
    """One log a thousand times too large: nm called um."""
    log = bench.transient(seed=15)
    return [
        bench.transient(seed=14),
        bench.sweep(seed=16),
        replace(log, name="slipped", response=1000 * log.response),
    ]


def millivolts(bench):
    """One log of two whose drive is a thousand times too large: mV called V."""
    log = bench.sweep(seed=16)
    return [bench.transient(seed=14), replace(log, name="slipped", drive=1000 * log.drive)]


@pytest.mark.parametrize(
    ("logs", "said"),
    [
        study(finger_on_the_third, "step 3: G and tau are both lower than in the other logs"),
        (sine_law, "not proportional to the drive"),
        (saturated, "saturated"),
        study(two_resonances, "the resonance contradicts the other logs"),
        study(softer_when_warm, "tau changes with the temperature"),
        study(millimetres, "about 1001 times that of theirs"),
        (millivolts, "G contradicts the other logs"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_the_model_leaves_out_is_named(bench, logs, said, nuisances):
    fit = sysid.fit(logs(bench), nuisances=nuisances)
    assert fit.result is Result.misfit, fit.parameters
    assert any(said in warning for warning in fit.warnings), fit.warnings


@pytest.mark.parametrize(
    ("logs", "effects"),
    [
        study(late_trigger, {"delay", "filter"}),
        study(fourth_order_lock_in, {"filter"}),
        study(lock_in_of_a_sweep, {"filter"}),
        (second_resonance, {"second_mode"}),
        (softening, {"duffing"}),
        (hurried_sweep, {"dwell"}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_logs_call_for_is_fitted(bench, logs, effects, among):
    """The plate is right with it, and without it, as of a bench that is known not to have it, a misfit."""
    made = logs(bench)
    fit = sysid.fit(made, nuisances=among(*effects))
    assert (
        fit.result is Result.successful and {f.key for f in fit.findings if f.outcome == "fitted"} <= effects
    ), fit.warnings
    warm = np.mean([log.temperature.mean() for log in made])
    truth = {
        "G": bench.plant.G,
        "tau": bench.plant.tau,
        "f0": bench.plant.f0 + bench.plant.k_T * (warm - 24.0),
    }
    for name, value in truth.items():
        assert abs(fit.parameters[name].value - value) < 4.5 * fit.parameters[name].std, (name, fit.warnings)
    assert sysid.fit(made, nuisances=NUISANCES).result is Result.misfit


@seeds(8, 40)
def test_logs_that_the_model_describes_are_not_doubted(bench, seeds):
    """One of a hundred is the design: three or more of forty, or two or more of eight, have a probability
    below 1 %."""
    ends = [sysid.fit([bench.transient(seed=100 + k), bench.sweep(seed=200 + k)]).result for k in seeds]
    assert sum(end is not Result.successful for end in ends) <= binom.ppf(0.99, len(seeds), 0.01), ends


def test_noise_too_small_to_hide_the_ripple_of_the_fast_mode_tells_whether_it_is_there(bench):
    """At Q = 169 it rings with 0.15 % of the response after the step (tests/reference.py), or a lock-in's
    filter removes it: tau is told as well."""
    fits = [
        sysid.fit(other_plant(bench, ripple=rings).transient(seed=4, noise=1e-5)) for rings in (True, False)
    ]
    rung, settled = (fit.parameters["tau"] for fit in fits)
    assert all(fit.result is Result.successful for fit in fits)
    assert rung.std == pytest.approx(settled.std, rel=0.2)  # 11 times that, where it passes for noise
    for tau in (rung, settled):
        assert abs(tau.value - bench.plant.tau) < 4 * tau.std


@pytest.mark.study
def test_a_coarse_recorder_is_named_and_not_called_saturated():
    for seed in range(4):
        fine, coarse = (
            simulated("step_100V_24C", 70 + seed, EFFECTS["quantisation"](step=um)) for um in (0.01, 0.2)
        )
        assert not any(
            "recorded in steps" in said or "saturated" in said for said in sysid.fit([fine]).warnings
        )
        said = sysid.fit([coarse]).warnings
        assert any("recorded in steps of 0.2 um" in warning for warning in said), said
        assert not any("saturated" in warning for warning in said), said


@pytest.mark.study
def test_a_filter_that_is_stated_is_modelled():
    """Eight steps through four poles of 100 us, which alone would make tau 28 % too long."""
    scene = Scene.from_toml(SCENES / "step_100V_24C.toml")
    filtered = replace(scene, effects=(*scene.effects, EFFECTS["lock_in"](tau=100e-6, order=4)))
    fits = [sysid.fit([filtered.simulate(50 + k)]) for k in range(8)]
    assert all(fit.result is Result.successful for fit in fits)
    scores = np.array([(fit.plant.tau - scene.plant.tau) / np.sqrt(fit.covariance[1, 1]) for fit in fits])
    # eight unit normals: a mean within 4/sqrt(8), a sum of squares below 26.1 in 99.9 % of cases
    assert abs(scores.mean()) < 1.42
    assert np.sum(scores**2) < 26.1


def test_a_delay_within_a_row_is_covered(bench):
    """Half a row late, not stated: the intervals of G and tau hold the truth, of a step and of a step beside
    a sweep."""
    scene = Scene.from_toml(SCENES / "step_100V_24C.toml")
    late = replace(
        replace(scene, effects=(*scene.effects, EFFECTS["delay"](time=50e-6))).simulate(60), bench={}
    )
    for logs in ([late], [late, simulated("sweep_24C", 61)]):
        fit = sysid.fit(logs)
        assert fit.result is Result.successful
        for name in ("G", "tau"):
            p = fit.parameters[name]
            assert abs(p.value - getattr(scene.plant, name)) < 4 * p.std
    # beside a sweep the lateness is known, and without it G would be off by half a row's share of tau, 3 %,
    # in 0.2 % of error
    assert fit.parameters["G"].std < 0.01 * scene.plant.G


@pytest.mark.parametrize("late", [True, False])
def test_a_sweep_of_one_direction_says_what_it_takes_for_a_resonance_elsewhere(late, nuisances):
    """A response that is late by a row shows at each frequency what belongs to the one before: by the log
    alone the resonance is a step of the sweep away, with as good a fit."""
    plant = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=0.0)
    up = plant.f0 + np.linspace(-500, 500, 101)

    def swept(f, held, **bench):
        time = plant.tau * np.arange(len(f))
        begun = np.append(-40 * plant.tau, time[1:])  # settled at the first row
        noise = 2e-4 * np.random.default_rng(3).standard_normal((2, len(f))).T @ [1, 1j]
        rows = reference.ringing(plant, begun, np.ones(len(f)), held, np.full(len(f), 24.0)) + noise
        return sysid.Log(
            "swept", rows, time=time, drive=np.ones(len(f)), frequency=f, kind="transient", bench=bench
        )

    def said(found):
        return any("the logs do not tell: read half way" in w for w in found.warnings)

    if late:
        found = sysid.fit([swept(up, np.append(up[0], up[:-1]))], nuisances=nuisances)
        f0 = found.parameters["f0"]
        # a row behind those before it, which no reading is: in little noise it shows
        assert found.result is Result.misfit or abs(f0.value - plant.f0) < 4 * f0.std
        assert said(found) or found.result is Result.misfit
        return
    assert not said(sysid.fit([swept(up, up, delay_s=0.0)], nuisances=nuisances))
    both = np.concatenate([up, up[::-1]])
    found = sysid.fit([swept(both, both)], nuisances=nuisances)
    assert not said(found) and abs(found.parameters["f0"].value - plant.f0) < 4 * found.parameters["f0"].std


@pytest.mark.study
def test_a_step_without_its_drive_is_not_taken_for_ringing_in_silence(bench, nuisances):
    """A plate that rings freely dies away; this response grows from rest."""
    found = sysid.fit([bench.transient(drive=False)], nuisances=nuisances)
    assert any("no drive is recorded, or only zero, and the response grows" in w for w in found.warnings)
    log = bench.transient()
    found = sysid.fit([replace(log, drive=np.zeros(len(log)))], nuisances=nuisances)
    assert any("no drive is recorded, or only zero, and the response grows" in w for w in found.warnings)
    ringing = bench.transient(volts=np.repeat([100.0, 0.0], [60, 180]))
    kept = {name: getattr(ringing, name)[70:] for name in ("response", "time", "frequency")}
    free = sysid.fit([replace(ringing, **kept, drive=None, temperature=None)])
    assert not any("grows" in w for w in free.warnings) and free.parameters["tau"].determined


@pytest.mark.study
def test_steps_of_a_recorder_are_no_second_resonance(bench):
    """A twentieth of the response: what it leaves looks like anything, and is named as what it is."""
    for seed in range(10):
        log = bench.transient(seed=seed, noise=0.001)
        coarse = 0.1 * (np.round(log.response.real / 0.1) + 1j * np.round(log.response.imag / 0.1))
        warnings = sysid.fit([replace(log, response=coarse)]).warnings
        assert any("recorded in steps of 0.1 um" in w for w in warnings)
        assert not any("resonance" in w for w in warnings)


@pytest.mark.parametrize("digits", [3, 5])
def test_rows_that_share_their_time_stamps_are_named(bench, digits, nuisances):
    """Rows 0.1 ms apart whose time is written in ms, and in steps of ten us: these differ."""
    log = bench.transient(seed=5, frequency=32300.0)
    coarse = replace(log, time=np.round(log.time, digits))
    distinct = len(set(coarse.time.tolist()))
    found = sysid.fit([coarse], nuisances=nuisances)
    said = [said for said in found.warnings if "time stamp of the row before" in said]
    if digits == 5:
        assert not said and found.result is sysid.Result.successful
        return
    assert (
        said[0].startswith(f"step: {len(log) - distinct} of {len(log)} rows") and "of one moment" in said[0]
    )
    assert not any("check its columns" in said for said in found.warnings)
    assert found.result is not sysid.Result.successful


def test_two_rows_of_one_moment_are_counted_and_fitted(bench):
    log = bench.transient(seed=6)
    time = log.time.copy()
    time[150] = time[149]
    found = sysid.fit([replace(log, time=time)])
    assert found.result is sysid.Result.successful
    assert any(
        said.startswith("step: 1 of 240 rows have the time stamp of the row before")
        for said in found.warnings
    )


def misread(bench):
    """Of four sweeps one has its temperature read 3 degC too high."""
    logs = [bench.sweep(seed=20 + k, temperature=degC) for k, degC in enumerate((18.0, 24.0, 30.0, 36.0))]
    return [
        *logs[:2],
        replace(logs[2], name="odd", temperature=logs[2].temperature + 3.0),
        logs[3],
    ], -3.0 * bench.plant.k_T


def of_another_plate(bench):
    """Far enough off for most of the sweep to be left."""
    odd = replace(other_plant(bench, f0=bench.plant.f0 + 120.0).sweep(seed=31), name="odd")
    return [bench.sweep(seed=30), odd, bench.sweep(seed=32), bench.transient(seed=33)], 120.0


@pytest.mark.parametrize("made", [misread, study(of_another_plate)])
def test_a_log_that_is_well_described_by_itself_is_named_by_what_it_contradicts(bench, made, nuisances):
    """Not by an effect that could make it so: neither a drift nor a gain."""
    logs, off = made(bench)
    fit = sysid.fit(logs, nuisances=nuisances)
    said = [said for said in fit.warnings if "contradicts" in said or "drifts" in said or "residual" in said]
    assert fit.result is Result.misfit and len(said) == 1
    found = re.fullmatch(
        r"odd: the resonance contradicts the other logs, about ([-+.\d]+) Hz off that of theirs; .*", said[0]
    )
    assert (
        abs(float(found[1]) - off) < 1.5
    )  # four times what a sweep and three others tell of their f0, 0.3 Hz


@pytest.mark.study
def test_logs_of_two_plates_are_named_as_two_groups(bench):
    """Half of them contradicts the other half; none of them holds anything else."""
    other = other_plant(bench, f0=bench.plant.f0 - 50.0)
    logs = [b.sweep(seed=40 + k) for k, b in enumerate((bench, bench, bench, other, other))]
    logs = [replace(log, name=f"sweep {k}") for k, log in enumerate(logs)]
    fit = sysid.fit(logs)
    (found,) = (f for f in fit.findings if f.outcome == "refused")
    assert found.key == "odd" and found.logs == ("sweep 3", "sweep 4")
    said = re.search(r"the resonance contradicts the other logs, about ([-+.\d]+) Hz off", found.sentence)
    assert abs(float(said[1]) + 50.0) < 1.5


@pytest.mark.study
def test_a_gain_that_is_far_off_is_told_as_it_is(bench, nuisances):
    """To first order a gain ten times as large is two and a half times as large."""
    odd = bench.transient(seed=51)
    odd = replace(odd, name="odd", response=10 * odd.response)
    logs = [bench.transient(seed=50), odd, bench.transient(seed=52), bench.sweep(seed=53)]
    fit = sysid.fit(logs, nuisances=nuisances)
    (found,) = (f for f in fit.findings if f.outcome == "refused")
    assert (found.key, found.logs) == ("odd", ("odd",))
    times = float(re.search(r"about ([.\d]+) times that", found.sentence)[1])
    assert times == pytest.approx(10, rel=0.02)  # what a step tells of its gain


@pytest.mark.study
def test_sweeps_of_a_gain_each_are_described_one_by_one(bench):
    gains = (1.0, 1.03, 0.97, 1.015)
    logs = [bench.sweep(seed=60 + k) for k in range(len(gains))]
    logs = [
        replace(x, name=f"sweep {k}", response=g * x.response)
        for k, (x, g) in enumerate(zip(logs, gains, strict=True))
    ]
    fit = sysid.fit(logs)
    assert fit.result is Result.misfit
    (found,) = (f for f in fit.findings if f.outcome == "refused")
    assert found.key == "odd" and "G differs from one to the next, by 2.5 %" in found.sentence


def steps_that_drift(hertz, seeds):
    """Steps of 200 rows, in each of which the resonance goes up by as much, at a temperature that nobody
    recorded."""
    plant = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=1.0)
    time, logs = 1e-4 * np.arange(200), []
    for seed in seeds:
        volts, frequency = np.where(np.arange(200) < 20, 0.0, 100.0), np.full(200, 32270.0)
        clean = reference.ringing(plant, time, volts, frequency, 24 + hertz * np.linspace(0, 1, 200))
        rows = clean + reference.noise(200, 3e-3, seed)
        given = {"drive": volts, "frequency": frequency, "kind": "transient", "sampling": "instant"}
        logs.append(sysid.Log(f"step {seed}", rows, time=time, **given))
    return logs


@pytest.mark.study
@seeds(1, 20)
def test_what_all_logs_hold_alike_is_found_though_none_contradicts_the_others(seeds, nuisances):
    """A drift of a tenth of a bandwidth in each of three: each alone was a misfit, and all together were
    called successful."""
    fit = sysid.fit(steps_that_drift(20.0, (1, 2, 3)), nuisances=nuisances)
    if len(nuisances) == len(NUISANCES):  # no drift is fitted
        assert fit.result is Result.misfit and "; and so in 2 other logs" in " ".join(fit.warnings)
    else:
        assert fit.result is Result.successful and len(fit.findings) == 3
        for found in fit.findings:  # its error, by the noise, is 0.1 Hz
            assert found.key == "f0_drift" and found.numbers["shift_Hz"].value == pytest.approx(20, abs=0.5)
    for k in seeds:
        assert sysid.fit(steps_that_drift(0.0, range(3 * k, 3 * k + 3))).result is Result.successful


def test_a_time_in_another_unit_is_named_by_tau(bench, nuisances):
    step, sweep = bench.transient(seed=40), bench.sweep(seed=41)
    fit = sysid.fit([sweep, replace(step, time=1000 * step.time)], nuisances=nuisances)
    assert fit.result is Result.misfit
    found = re.search(r": tau contradicts the other logs, about (\S+) times that", " ".join(fit.warnings))
    alone = [sysid.fit([log]).parameters["tau"] for log in (step, sweep)]
    error = np.hypot(*[p.std / p.value for p in alone])
    # of two logs either may be the one to believe: the factor is a thousand or its inverse
    assert found and abs(abs(np.log(float(found[1]))) - np.log(1000)) < 4 * error


def without_the_edge(log):
    """Of the rows about the step, at the 20th, eight are missing: the first that is left has risen by a
    third."""
    return taken(log, np.delete(np.arange(len(log)), np.arange(18, 26)))


def test_a_step_whose_edge_is_missing_is_known_as_well_as_its_moment(bench):
    """The drive changed anywhere in a gap of nine rows. Called a change at the row after it, G would be 6 of
    its errors off."""
    for seed in range(4):
        step, sweep = without_the_edge(bench.transient(seed=80 + seed)), bench.sweep(seed=90 + seed)
        alone, both = sysid.fit([step]), sysid.fit([step, sweep])
        for fit in (alone, both):
            assert fit.result is Result.successful, fit.warnings
            for name in ("G", "tau", "f0"):
                p = fit.parameters[name]
                assert abs(p.value - getattr(bench.plant, name)) < 4 * p.std, (seed, name)
        # beside a sweep the moment is known, and hides nothing of G: the sweep's error alone is 0.1 %
        assert both.parameters["G"].std < 0.004 * bench.plant.G


def test_a_gap_before_a_step_that_is_recorded_where_it_was_is_none(bench):
    """A recorder that is slow at rest and fast from the step on: no response before the row of the step."""
    log = bench.transient(seed=7)
    assert not np.any(gaps(taken(log, np.append([0, 6, 12], np.arange(20, len(log))))))
    assert np.flatnonzero(gaps(without_the_edge(log))).tolist() == [18]


@seeds(2, 4)
def test_rows_that_are_missing_and_whose_times_do_not_say_so_are_named(bench, seeds, nuisances):
    """The recorder counts on. What is then left might pass for noise that rows share, where there is less of
    it, or for an outlier."""
    for seed in seeds:
        log = without_the_edge(bench.transient(seed=70 + seed, noise=(0.01, 0.002)[seed % 2]))
        fit = sysid.fit([replace(log, time=1e-4 * np.arange(len(log)))], nuisances=nuisances)
        assert fit.result is Result.misfit, fit.parameters
        assert any("as if the change had come earlier" in said for said in fit.warnings), fit.warnings


@seeds(1, 4)
def test_rows_that_are_lost_amid_a_rise_are_fitted(bench, seeds, among):
    """Three rows of a twentieth of tau, and the recorder counts on: tau was 7 of its errors off, or something
    else was named."""
    for seed in seeds:
        log = bench.transient(seed=seed, noise=0.005)
        kept = np.delete(np.arange(len(log)), slice(32, 35))
        fit = sysid.fit(
            [replace(taken(log, kept), time=log.time[: len(kept)])], nuisances=among("rows_lost", "delay")
        )
        assert fit.result is Result.successful, fit.warnings
        lost = next(f for f in fit.findings if f.key == "rows_lost")
        rows = lost.numbers["rows"]
        assert abs(rows.value - 3) < 4.5 * rows.std
        # places are a sixteenth of the moves apart: two rows here
        assert lost.numbers["after_s"].value == pytest.approx(log.time[32] - log.time[0], abs=2.1e-4)
        for name in ("G", "tau", "f0"):
            p = fit.parameters[name]
            assert abs(p.value - getattr(bench.plant, name)) < 4.5 * p.std, (seed, name)


@pytest.mark.study
def test_of_two_logs_the_one_whose_temperature_is_not_recorded_is_doubted(bench, nuisances):
    warm = replace(bench.transient(seed=1, temperature=28.0), temperature=None)
    logs = [warm, replace(bench.sweep(seed=2), name="sweep")]
    said = " ".join(sysid.fit(logs, nuisances=nuisances).warnings)
    assert "step: the resonance is" in said and "its temperature is not recorded" in said


@pytest.mark.parametrize(("degC", "heat"), [(24.0, False), (34.0, True)])
def test_less_gain_and_damping_in_a_warmer_log_may_be_its_temperature(bench, degC, heat, nuisances):
    """A finger, or a plate whose damping grows with the temperature: of two logs nobody can tell."""
    other = other_plant(bench, G=0.9 * bench.plant.G, tau=0.9 * bench.plant.tau)
    logs = [
        replace(b.sweep(seed=k, temperature=t), name=f"{t:g}")
        for k, (b, t) in enumerate(((bench, 24.0), (other, degC)))
    ]
    fit = sysid.fit(logs, nuisances=nuisances)
    assert fit.result is Result.misfit
    said = next(w for w in fit.warnings if "was left on the plate" in w)
    assert ("G and tau fall with the temperature" in said) is heat


@pytest.mark.parametrize(
    ("aside", "expected"), [(-1.0, Result.successful), (1j, Result.successful), (1.0, Result.misfit)]
)
@pytest.mark.parametrize(("rows", "spoilt"), [(240, 3), study(1000, 9)])
def test_an_outlier_at_a_change_is_one_unless_it_shows_what_comes_later(
    bench, aside, expected, rows, spoilt, nuisances
):
    """The largest of ten in a thousand rows, and the response is not where it is: it was an outlier whose row
    is the change's."""
    log = bench.transient(seed=3, volts=np.repeat([0.0, 100.0], [20, rows - 20]))
    rng, row = np.random.default_rng(3), int(np.flatnonzero(np.diff(log.drive))[0]) + 1
    later, response = log.response[row + 4] - log.response[row], log.response.copy()
    response[rng.choice(np.arange(row + 20, rows), spoilt, replace=False)] += (
        0.7 * abs(later) * np.exp(1j * np.arange(spoilt))
    )
    response[row] += aside * later
    assert sysid.fit([replace(log, response=response)], nuisances=nuisances).result is expected


def behind(log, late, **bench):
    """A sweep through a sensor that is `late` (s): e^{-j omega t}."""
    return replace(log, response=log.response * np.exp(-2j * np.pi * log.frequency * late), bench=bench)


def off(bench, fit, name="G"):
    """By how many of its errors a parameter is off."""
    p = fit.parameters[name]
    return (p.value - getattr(bench.plant, name)) / p.std


@pytest.mark.study
def test_the_delay_of_a_settled_sweep_is_undone_where_it_is_stated(bench, nuisances):
    """30 us turn the phase by a degree in 100 Hz, and G by 1.8 %. With times, a sweep may be settled or not
    at first."""
    for seed, dwell in enumerate((None, 20e-3, 20e-3)):
        time = None if dwell is None else dwell * np.arange(101)
        log = bench.sweep(seed=100 + seed, noise=0.002, time=time)
        late = behind(log, 30e-6)
        fit = sysid.fit([late], nuisances=nuisances)
        assert off(bench, fit) > 6 and "or a sensor that is late by" in " ".join(fit.warnings)
        stated = sysid.fit([replace(late, bench={"delay_s": 30e-6})])
        assert stated.result is Result.successful and all(
            abs(off(bench, stated, name)) < 4 for name in ("G", "tau", "f0")
        )
    wrong = sysid.fit([behind(log, 0.0, delay_s=1e-3)])  # said, and undone as well
    assert any("does not fall along the sweep" in said for said in wrong.warnings), wrong.warnings
    assert wrong.findings[0].key == "phase_delay" and all(
        abs(off(bench, wrong, name)) < 4 for name in ("G", "tau", "f0")
    )


def test_a_sweep_that_turns_out_not_to_be_settled_has_its_turn_again():
    """What is undone where it is settled is done again, to the rounding of a turn and its inverse."""
    frequency, time = 32300 + np.linspace(-500, 500, 401), 4e-4 * np.arange(401)
    rows = np.exp(2j * np.pi * np.arange(401) / 401)
    log = sysid.Log(
        "swept", rows, time=time, drive=np.ones(401), frequency=frequency, bench={"delay_s": 2e-4}
    )
    settled = Trial.of(log, "steady")
    back = read_as(settled, None, 1.67e-3)
    assert back.kind == "transient"
    assert (
        np.max(np.abs(settled.log.response - rows)) > 0.1 and np.max(np.abs(back.log.response - rows)) < 1e-14
    )


def unfed(bench, seed, noise=0.01):
    """A sweep with nothing but noise and a turn beside the plate."""
    log = bench.sweep(seed=seed)
    clean = reference.steady(bench.plant, log.drive, log.frequency, log.temperature)
    return replace(log, response=np.exp(0.3j) * clean + reference.noise(101, noise, seed))


def test_a_sensor_that_may_be_late_is_named_and_a_clean_sweep_is_not(bench):
    def said(log):
        fit = sysid.fit([log])
        return [w for w in (*fit.warnings, *fit.notes) if "a sensor that is late" in w]

    clean = [unfed(bench, seed) for seed in range(20)]
    assert not any(said(log) for log in clean)  # each by chance in one of 16 000
    late = behind(clean[0], 100e-6)
    told = re.search(r"a feedthrough of (.+) % .* late by (.+) s, in which case", said(late)[0])
    # D = r tau/(1 - r), to second order in D (f - f0): a tenth
    assert float(told[2]) == pytest.approx(100e-6, rel=0.1) and float(told[1]) == pytest.approx(5.7, rel=0.1)
    assert not said(replace(late, bench={"delay_s": 0.0}))


@pytest.mark.parametrize(
    ("late", "noise"),
    [(10e-6, 0.001), study(50e-6, 0.001), (-60e-6, 0.01), study(50e-6, 0.01), study(150e-6, 0.01)],
)
def test_a_sweep_whose_points_may_be_late_leaves_G_open(bench, late, noise):
    """By as much as a feedthrough that looks like the delay; tau and f0 do not hang on it."""
    scores = {name: [] for name in ("G", "tau", "f0")}
    for seed in range(6):
        log = unfed(bench, seed, noise)
        fit, stated = sysid.fit([behind(log, late)]), sysid.fit([replace(log, bench={"delay_s": 0.0})])
        assert fit.result is Result.successful
        for name, found in scores.items():
            found.append(off(bench, fit, name))
        share = abs(late) / bench.plant.tau * bench.plant.G
        if share > 6 * stated.parameters["G"].std:
            assert fit.parameters["G"].std == pytest.approx(
                share, rel=0.15
            )  # a tenth of it is its second order
    assert max(map(abs, scores["G"])) < 4.5  # what is not seen, of less than four errors, is not in them
    assert all(
        np.sqrt(np.mean(np.square(scores[name]))) < 1.9 for name in ("tau", "f0")
    )  # six numbers: by chance in one of 1000


@pytest.mark.study
def test_sweeps_that_are_all_late_show_together_what_each_does_not(bench):
    """By about 3 errors of each one's feedthrough: G was 2.4 of its own off, in most without a word."""

    def fits(late):
        swept = [
            [replace(behind(unfed(bench, 3 * s + k, 0.01), late), name=f"sweep {k}") for k in range(3)]
            for s in range(8)
        ]
        return [sysid.fit(logs) for logs in swept]

    scores = np.array([off(bench, fit, "G") for fit in fits(4e-6)])
    assert (
        np.sqrt(np.mean(scores**2)) < 1.6
    )  # one, for a prior of the size itself; eight numbers: by chance in one of 300
    assert not any("late by" in w for fit in fits(0.0) for w in (*fit.warnings, *fit.notes))


@pytest.mark.parametrize("turn", [study(1.0), 1j])
@seeds(2, 12)
def test_an_offset_that_drifts_in_a_step_is_named_and_fitted_on_request(bench, seeds, turn, nuisances):
    """By 2 % of the response from the first row to the last: it was a resonance that drifts, or a second one,
    or no misfit."""
    z = []
    for seed in seeds:
        log = bench.transient(seed=seed, noise=0.005)
        creeping = 0.02 * 2.0 * turn * np.linspace(0, 1, len(log))
        log = replace(log, response=log.response + creeping)
        fit = sysid.fit([log], nuisances=nuisances)
        assert fit.result is Result.misfit and "its output offset drifts by" in fit.warnings[-1], fit.warnings
        assert 1 < float(re.search(r"offset drifts by (\S+) ±", fit.warnings[-1])[1]) < 3
        fit = sysid.fit([log], nuisances=(*NUISANCES, "baseline"))
        assert fit.result is Result.successful, fit.warnings
        per_second = [sysid.nuisances(fit)[0][name] for name in ("baseline_d", "baseline_q")]
        truth = 0.04 * np.array([turn.real, turn.imag, 0.0, 0.0]) / (log.time[-1] - log.time[0])
        truth[2:] = bench.plant.tau, bench.plant.f0
        told = (*per_second, fit.parameters["tau"], fit.parameters["f0"])
        z.append([(p.value - t) / p.std for p, t in zip(told, truth, strict=True)])
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds))


@pytest.mark.study
def test_steps_of_a_gain_each_on_their_resonance_are_not_turned(bench, among):
    """A feedthrough and a lateness that cancel make up for a gain: with them a log that is turned is
    described, as it is unturned, and no better."""
    given = {"frequency": bench.plant.f0, "dt": 5e-5, "volts": np.repeat([0.0, 100.0], [40, 440])}
    logs = [
        replace(log, name=f"step {k}", response=gain * log.response)
        for k, gain in enumerate((1.0, 1.03, 0.97, 1.06, 1.0))
        for log in (bench.transient(seed=80 + k, **given),)
    ]
    fit = sysid.fit(logs, nuisances=among("delay"))
    (found,) = (f for f in fit.findings if f.outcome == "refused")
    assert found.key == "odd" and "G contradicts the other logs" in found.sentence


@pytest.mark.study
def test_a_step_that_is_late_does_not_contradict_the_others(among):
    """Alone it is described by a gain 1.25 times as large, with an error that spans that it may be late: it
    is, which is fitted."""
    plant = sysid.Plant(0.02, 1.669e-3, 32300.0, -10.0)
    late = 0.25 * plant.tau

    def step(seed, drive, rows, beside, temperature):
        at, length = 0.7 * plant.tau, 7 * plant.tau
        warm = plant.f0 + plant.k_T * (temperature - plant.reference_temperature)
        inputs = {
            "drive": sysid.Profile(np.array([0, at]), np.array([0.0, drive])),
            "frequency": sysid.Profile.constant(warm + beside / (2 * np.pi * plant.tau)),
            "temperature": sysid.Profile.constant(temperature),
        }
        noise = EFFECTS["white_noise"](std=0.003 * plant.G * drive)
        return Scene(plant, inputs, rows, rows / length, (EFFECTS["delay"](time=late), noise)).simulate(seed)

    logs = step(6, 100.0, 300, 0.49, 28.8), step(7, 100.0, 800, 1.12, 24.0), step(8, 43.0, 800, 0.92, 24.0)
    logs = [replace(logs[0], name="first"), replace(logs[1], name="late", bench={}), logs[2]]
    fit = sysid.fit(logs, nuisances=among("delay"))
    (found,) = (f for f in fit.findings if f.outcome == "fitted")
    assert (found.key, found.logs, fit.result) == ("delay", ("late",), Result.successful)
    assert found.numbers["delay_s"].value == pytest.approx(late, abs=4 * found.numbers["delay_s"].std)
    for name in ("G", "tau", "f0"):
        value = fit.parameters[name]
        assert abs(value.value - getattr(plant, name)) < 4 * value.std
