"""Logs of the kinds that people bring: nothing silently wrong, no cause that is not there. The study is
benchmarks/kinds.py."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import most, seeds, study

import sysid

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import kinds

CASES = {
    ("half of the step settles at once", "fast 1 ms"): ("told", "is there within a row"),
    ("half of the step settles at once", "at once"): ("told", "is there within a row"),
    ("a second-order step", "zeta 0.3"): ("told", "of second order: it overshoots"),
    ("a second-order step", "zeta 0.6"): ("told", "of second order: it overshoots"),
    ("ring-down of amplitudes on an offset", "below"): ("right", "successful"),
    ("sweep, set, wait, read", "own"): ("right", "the logs do not tell"),
    ("sweep, set, wait, read", "own, back"): ("right", "sampling: settled, as the logs show"),
    ("sweep too fast, without times", "dwell 0.4 tau"): ("right", "swept too fast"),
    ("feedthrough under amplitudes", "5%"): ("right", "lies a feedthrough"),
    ("a low-pass", "tau 0.0007 s"): ("told", "no resonance is seen"),
    ("a drive of 1e-9 to 1e7 V", "1e-07 V"): ("right", "successful"),
    ("a step that is late, beside a sweep", "0.3 ms"): ("right", "s behind the inputs"),
    ("restless, then a decay", "swing 0.1"): ("right", "restless"),
}


LATER = {  # the study's: other variants of these kinds, or tests of their own, say as much
    ("half of the step settles at once", "at once"),
    ("a second-order step", "zeta 0.3"),
    ("a second-order step", "zeta 0.6"),
    ("ring-down of amplitudes on an offset", "below"),
    ("sweep, set, wait, read", "own, back"),
    ("restless, then a decay", "swing 0.1"),
    ("a step that is late, beside a sweep", "0.3 ms"),
    ("sweep too fast, without times", "dwell 0.4 tau"),
    ("feedthrough under amplitudes", "5%"),
}


@pytest.mark.parametrize(
    ("kind", "variant"), [study(*c) if c in LATER else c for c in CASES], ids=lambda x: x
)
def test_what_is_said_of_a_kind(kind, variant):
    answer, said = CASES[kind, variant]
    of = kinds.KINDS[kind]
    found, words = kinds.verdict(of, *of.variants[variant](np.random.default_rng(7)))
    assert found == answer and said in words, words


def test_the_side_of_a_ring_down_on_an_offset_is_not_told():
    """|W + o| is the same for a resonance below the reference and one above it."""
    logs, truth = kinds.ring_down(-0.3, 0.6)(np.random.default_rng(1))
    f0 = sysid.fit(logs).parameters["f0"]
    assert not f0.determined and len(f0.modes) == 2
    assert min(abs(mode["value"] - truth["f0"]) / mode["std"] for mode in f0.modes) < 4


@pytest.mark.parametrize("own", [True, False])
def test_the_error_of_a_sweep_read_half_way_spans_both_readings(own):
    """A step of the sweep is 40 errors of f0; half of it is what is not known."""
    logs, truth = kinds.wait_and_read(own, 2.5)(np.random.default_rng(3))
    f0 = sysid.fit(logs).parameters["f0"]
    step = float(np.diff(logs[0].frequency[:2])[0])
    assert abs(f0.value - truth["f0"]) < 1.5 * f0.std and f0.std == pytest.approx(step / 2, rel=0.05)
    stated = sysid.fit(
        [sysid.Log(**{**_fields(logs[0]), "sampling": "settled" if own else "instant"})]
    ).parameters["f0"]
    assert abs(stated.value - truth["f0"]) < 4 * stated.std < f0.std


def _fields(log):
    return {n: getattr(log, n) for n in ("name", "response", "time", "drive", "frequency", "kind")}


@pytest.mark.parametrize("how", ["as it is", "of a current", study("conjugate"), study("amplitude")])
@seeds(4, 16)
def test_a_low_pass_is_told_with_its_numbers(seeds, how):
    """A coil's current: G 0.28, tau 0.7 ms."""
    off = []
    for seed in seeds:
        ((log,), _) = kinds.low_pass(7e-4)(np.random.default_rng(seed))
        ways = {"as it is": 1, "of a current": 1 / (2 * np.pi * log.frequency)}  # as that is read
        seen = {"conjugate": np.conj, "amplitude": np.abs}.get(how, lambda w: w)(log.response)
        (found,) = sysid.fit([replace(log, response=ways.get(how, 1) * seen)]).findings
        assert found.key == "overdamped" and found.outcome == "refused"
        off.append(
            [(found.numbers[n].value - v) / found.numbers[n].std for n, v in (("G", 0.28), ("tau", 7e-4))]
        )
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < most(seeds))
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) > 0.1)  # no guess


def test_what_falls_otherwise_is_no_low_pass_of_first_order():
    ((log,), _) = kinds.low_pass(7e-4)(np.random.default_rng(0))
    twice = log.response / (1 + 2j * np.pi * log.frequency * 2e-4)
    (found,) = sysid.fit([replace(log, response=twice)]).findings
    assert found.key == "overdamped" and not found.numbers


def test_nothing_is_called_noise_or_frequency_of_a_log_that_is_not_described():
    """No number below zero, and no advice on what the logs would tell."""
    logs, _ = kinds.low_pass(7e-4)(np.random.default_rng(0))
    fit = sysid.fit(logs)
    assert fit.result is sysid.Result.misfit
    assert all(p.value is None and "noise" not in (p.why or "") for p in fit.parameters.values())


@pytest.mark.parametrize("dwell", [0.08, study(0.28)])
@seeds(1, 4)
def test_a_fast_sweep_of_amplitudes_that_begins_settled_is_told_by_its_dwell(seeds, dwell):
    """The plate is integrated point by point, from where it had settled; taken as from rest, G was 14 of its
    errors off and a second resonance beside it, "fitted"."""
    G, tau, f0, f = 0.042, 3e-3, 25310.0, np.arange(25600.0, 25000.0, -0.6 if dwell < 0.1 else -2.0)
    own = np.sqrt((2 * np.pi * f0) ** 2 - tau**-2)  # of both poles, in the frame of each point
    slow, fast = -1 / tau + 1j * (own - 2 * np.pi * f), -1 / tau - 1j * (own + 2 * np.pi * f)
    push = 40.0 * G * 2 * np.pi * f0 / (tau * own)
    z = [-push / slow[0]]
    for pole in slow:
        z.append((z[-1] + push / pole) * np.exp(pole * dwell * tau) - push / pole)
    w = np.abs(np.array(z[1:]) + push / fast)
    for seed in seeds:
        noise = 0.003 * np.random.default_rng(seed).standard_normal((2, len(f))).T @ [1, 1j]
        log = sysid.Log("fast", np.abs(w + noise), frequency=f, drive=np.full(len(f), 40.0))
        fit = sysid.fit([log])
        assert [(x.key, x.outcome) for x in fit.findings if x.outcome == "fitted"] == [("dwell", "fitted")]
        assert fit.findings[0].numbers["dwell_s"].value == pytest.approx(dwell * tau, rel=0.05)
        for name, truth in (("G", G), ("tau", tau), ("f0", f0)):
            assert abs(fit.parameters[name].value - truth) < 4 * fit.parameters[name].std, name


def test_an_oven_whose_loss_grows_is_called_that():
    """dz/dt = (G u - z (1 + 0.15 z/72))/tau, by 0, 12, 24 and 8 V. What no linear plant follows was noise of long
    memory, with G ten of its errors off."""
    G, tau, dt = 3.0, 500.0, 10.0
    drive = np.repeat([0.0, 12.0, 24.0, 8.0], [30, 190, 190, 190])
    z = [0.0]
    for u in np.repeat(drive[:-1], 100):  # a hundred steps of Euler a row are off by 1e-4 of what they move
        z.append(z[-1] + dt / 100 * (G * u - z[-1] * (1 + 0.15 * z[-1] / 72)) / tau)
    noise = 0.06 * np.random.default_rng(0).standard_normal(len(drive))
    log = sysid.Log("oven", 21 + np.array(z[::100]) + noise, time=dt * np.arange(len(drive)), drive=drive,
                    response_unit="degC")  # fmt: skip
    fit = sysid.fit([log])
    (found,) = (x for x in fit.findings if x.outcome == "refused")
    assert found.key == "amplitude_damping" and found.numbers["more"].value > 0
    assert fit.result is sysid.Result.misfit


def test_what_leaves_f0_open_is_why_it_is_not_told():
    """A sweep wide enough, up and back, whose resonance falls by a bandwidth meanwhile: it was to be recorded
    wider."""
    f = np.concatenate([np.arange(25110.0, 25510.0, 4.0), np.arange(25510.0, 25110.0, -4.0)])
    f0 = 25310 - 60 * np.linspace(0, 1, len(f))
    x = 2 * np.pi * (f0 - f) * 3e-3
    noise = 0.004 * np.random.default_rng(0).standard_normal((2, len(f))).T @ [1, 1j]
    log = sysid.Log("ud", 0.042 * 40 / (1 - 1j * x) + noise, frequency=f, drive=np.full(len(f), 40.0))
    fit = sysid.fit([log])
    assert [x.key for x in fit.findings if x.outcome == "fitted"] == ["f0_drift"]
    assert "cannot tell, because what was found (f0 drift) leaves it open" in fit.parameters["f0"].why
    assert fit.parameters["tau"].value == pytest.approx(3e-3, rel=0.02)


def test_a_peak_of_impedance_is_no_low_pass():
    """A voice coil: Z of 6 ohm, 0.5 mH and a motion at 62 Hz, whose admittance has a dip there. A low-pass that
    leaves half of it described "the sweep"."""
    f = np.geomspace(10, 400, 200)
    z = 6 + 2j * np.pi * f * 5e-4 + 31 / (1 + 4j * (f / 62 - 62 / f))
    noise = 0.002 * np.random.default_rng(0).standard_normal((2, len(f))).T @ [1, 1j]
    log = sysid.Log("woofer", (1 / z + noise / 6) / (2 * np.pi * f), frequency=f, drive=np.ones(len(f)))
    fit = sysid.fit([log])
    assert fit.result is sysid.Result.misfit and not any(x.numbers for x in fit.findings)


def test_of_sweeps_whose_force_is_the_square_of_the_voltage_that_is_said():
    """An electrostatic drive at three levels, a file each: G was to differ from one log to the next by 70 %."""
    f, rng = np.arange(25100.0, 25520.0, 10.0), np.random.default_rng(0)
    w = 1e-3 / (1 - 2j * np.pi * (25310 - f) * 3e-3)
    logs = [
        sysid.Log(f"{v:.0f} V", v**2 * w + 0.01 * rng.standard_normal((2, len(f))).T @ [1, 1j], frequency=f,
                  drive=np.full(len(f), v)) for v in (10.0, 20.0, 40.0)
    ]  # fmt: skip
    (found,) = (
        x for x in sysid.fit(logs).findings if x.key == "drive"
    )  # beside three plates, if not before them
    assert (
        len(found.logs) == 3 and abs(found.numbers["power"].value - 2) < 4 * found.numbers["power"].std < 0.1
    )


def test_a_drift_along_a_sweep_up_and_back_is_no_reading_of_other_rows():
    """Settled points, a second each, whose resonance falls by a bandwidth meanwhile: the peak is late on the way
    back, as if rows showed the inputs before. So read, "no known effect" explained the rest."""
    up = np.linspace(25100.0, 25500.0, 61)
    f, time, rng = np.append(up, up[::-1]), 1.0 * np.arange(122), np.random.default_rng(0)
    w = 0.042 * 40 / (1 - 2j * np.pi * (25310 - 60 * time / time[-1] - f) * 3e-3)
    log = sysid.Log("ud", w + 0.01 * rng.standard_normal((2, 122)).T @ [1, 1j], frequency=f, time=time,
                    drive=np.full(122, 40.0))  # fmt: skip
    fit = sysid.fit([log])
    assert [x.key for x in fit.findings if x.outcome == "fitted"] == ["f0_drift"]
    assert any("taken as sampling: settled" in said for said in fit.warnings)
    for name, truth in (("G", 0.042), ("tau", 3e-3)):
        # of the envelope, which is off by 2 parts in a thousand from one end to the other
        assert fit.parameters[name].value == pytest.approx(truth, rel=5e-3)


def relaxing(inputs, step, tau, detuning, begin):
    """W' = (j 2 pi detuning - 1/tau) W + u/tau at rows a `step` apart, exact for inputs (n,) held between."""
    pole = 2j * np.pi * detuning - 1 / tau
    settled, decay = -inputs / (tau * pole), np.exp(pole * step)
    w = np.empty(len(inputs), complex)
    w[0] = settled[0] if begin is None else begin
    for k in range(1, len(inputs)):
        w[k] = settled[k - 1] + (w[k - 1] - settled[k - 1]) * decay
    return w


@seeds(1, 6)
def test_a_second_mode_that_was_settled_as_well_beats_in_a_decay(seeds):
    """60 Hz above, 40 % of the first; the drive is on from before the first row and ends at 20 ms. It was "a
    stretch as if a finger were in it", as a mode at rest at the first row had to make up for it."""
    t = 2.5e-4 * np.arange(240)
    u = 0.03 * 60 * (t < 0.02 - 1e-9)
    w = relaxing(u, 2.5e-4, 4e-3, 0.0, None) + 0.4 * relaxing(u, 2.5e-4, 4e-3, 60.0, None)
    truth = {"G": 0.03, "tau": 4e-3, "f0": 32150.0}
    for seed in seeds:
        noise = 0.004 * np.random.default_rng(seed).standard_normal((2, 240)).T @ [1, 1j]
        log = sysid.Log.from_arrays(w + noise, time=t, drive=60.0 * (u > 0), frequency=32150.0)
        fit = sysid.fit(log)
        assert fit.result is sysid.Result.successful and fit.findings[0].key == "second_mode"
        for name, true in truth.items():
            assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std


def test_a_second_time_constant_that_was_settled_as_well_is_named():
    t = np.arange(0, 600.0)
    u = np.where(t < 100, 5.0, np.where(t < 350, 10.0, 2.0))
    w = 2 * relaxing(u, 1.0, 20.0, 0.0, None) + relaxing(u, 1.0, 90.0, 0.0, None)
    rng = np.random.default_rng(0)
    log = sysid.Log.from_arrays(
        20 + w.real + 0.05 * rng.standard_normal(600), time=t, drive=u, response_unit="degC"
    )
    (finding,) = sysid.fit(log).findings
    assert finding.key == "second_pole"
    assert abs(finding.numbers["tau_s"].value - 90) < 4 * finding.numbers["tau_s"].std


def test_a_resonance_and_its_alias_are_both_told():
    """A decay 5 Hz above its reference, in rows 0.15 s apart: it turns by 3/4 of a turn from row to row, as one
    1.67 Hz below does by 1/4 the other way. f0 was 1300 of its errors off."""
    t = 0.15 * np.arange(60)
    rng = np.random.default_rng(0)
    w = np.exp((10j * np.pi - 1 / 0.4) * t) + 2e-3 * rng.standard_normal((2, 60)).T @ [1, 1j]
    fit = sysid.fit(sysid.Log.from_arrays(w, time=t, frequency=31720.0))
    f0, tau = fit.parameters["f0"], fit.parameters["tau"]
    assert not f0.determined and "separate solutions" in f0.why
    assert min(abs(mode["value"] - 31725) / mode["std"] for mode in f0.modes) < 4
    assert abs(tau.value - 0.4) < 4 * tau.std


def test_a_seldom_alias_is_named_beside_the_likelier():
    """A step 430 Hz beside the resonance, in rows 2 ms apart: as likely as one 70 Hz beside it but by where
    plates are driven, by |h|^2: (1 + (2 pi 430 tau)^2)/(1 + (2 pi 70 tau)^2) = 37."""
    tau, t = 0.02, 2e-3 * np.arange(150)
    u = 1.0 * (t >= 0.02 - 1e-9)
    w = relaxing(u / tau, 2e-3, tau, 430.0, 0.0)
    w = w + 1e-4 * np.random.default_rng(0).standard_normal((2, 150)).T @ [1, 1j]
    fit = sysid.fit(sysid.Log.from_arrays(w, time=t, drive=u, frequency=31720.0, sampling="instant"))
    (found,) = (f for f in fit.findings if f.key == "alias")
    assert found.outcome == "noted" and "500 Hz higher" in found.sentence and "by 37 to one" in found.sentence
    near = sysid.fit(sysid.Log.from_arrays(
        relaxing(u / tau, 2e-3, tau, 5.0, 0.0) + 1e-4 * np.random.default_rng(0).standard_normal(150),
        time=t, drive=u, frequency=31720.0, sampling="instant",
    ))  # fmt: skip
    assert not any(f.key == "alias" for f in near.findings)  # 3300 to one


@seeds(1, 4)
def test_a_supply_that_sags_slowly_is_told(seeds):
    """By 15 %, with 25 tau, as long as the step: du/dt = (0.85 - u)/T, with the plate integrated in closed form,
    a settled part and two that decay. It was a second mode at the drive's own frequency, or AC coupling."""
    tau, T, t = 4e-3, 0.1, 2.5e-4 * np.arange(440)
    pole, since = 2j * np.pi * -10.0 - 1 / tau, np.maximum(t - 0.01, 0.0)
    w = sum(
        share / tau / (rate - pole) * (np.exp(rate * since) - np.exp(pole * since))
        for share, rate in ((0.85, 0.0), (0.15, -1 / T))
    )
    for seed in seeds:
        noise = 0.003 * np.random.default_rng(seed).standard_normal((2, 440)).T @ [1, 1j]
        log = sysid.Log.from_arrays(
            1.8 * w + noise, time=t, drive=60.0 * (t >= 0.01 - 1e-9), frequency=32140.0, response_unit="um"
        )
        fit = sysid.fit(log)
        assert fit.findings[0].key == "drive_overshoot" and fit.result is sysid.Result.successful
        for name, true in {"G": 0.03, "tau": tau, "f0": 32130.0}.items():
            assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std


def test_rows_at_one_time_have_no_alias():
    """They have no distance; the fit says what they leave open."""
    rng = np.random.default_rng(0)
    w = 1 + 0.01 * rng.standard_normal((2, 30)).T @ [1, 1j]
    log = sysid.Log.from_arrays(w, time=np.zeros(30), drive=40.0, frequency=31720.0, kind="transient")
    fit = sysid.fit(log)
    assert fit.result is not sysid.Result.successful and not fit.parameters["f0"].determined


def test_what_begins_at_rest_amid_a_drive_was_not_settled():
    """Of an oven at 20 degC that is switched on at the first row and rises by 9 degC, nearer to where it ends
    than to 0 degC: its offset is not its response."""
    t = np.arange(0, 600.0)
    u = np.where(t < 350, 10.0, 2.0)
    w = 0.6 * relaxing(u, 1.0, 20.0, 0.0, 0.0) + 0.3 * relaxing(u, 1.0, 90.0, 0.0, 0.0)
    rng = np.random.default_rng(0)
    log = sysid.Log.from_arrays(
        20 + w.real + 0.015 * rng.standard_normal(600), time=t, drive=u, response_unit="degC"
    )
    (finding,) = sysid.fit(log).findings
    assert finding.key == "second_pole"
    assert abs(finding.numbers["tau_s"].value - 90) < 4 * finding.numbers["tau_s"].std


@pytest.mark.parametrize("sags", [True, False])
def test_the_error_of_g_spans_both_readings_of_an_overshoot(sags):
    """A drive that begins 18 % higher than it ends, recorded as constant, of a supply that sags or of an
    amplifier that overshoots: a step does not tell. G of the former was 100 of its errors off."""
    t = 2.5e-4 * np.arange(400)
    on, shape = t >= 0.01 - 1e-9, np.exp(-np.maximum(t - 0.01, 0) / 0.015)
    u = 0.03 * 60 * on * (0.85 + 0.15 * shape) / (1.0 if sags else 0.85)
    fine = np.repeat(u, 20)  # rows hold their drive: what the plate gets moves within them
    w = relaxing(fine, 2.5e-4 / 20, 4e-3, 10.0, 0.0)[::20]
    rng = np.random.default_rng(0)
    w += 0.004 * rng.standard_normal((2, 400)).T @ [1, 1j]
    fit = sysid.fit(sysid.Log.from_arrays(w, time=t, drive=60.0 * on, frequency=32140.0))
    assert fit.findings[0].key == "drive_overshoot"
    for name, true in {"G": 0.03, "tau": 4e-3, "f0": 32150.0}.items():
        if fit.parameters[name].determined:
            assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std


def sweep(name, seed, f0=25310.0, gain=1.0, **bench):
    """A settled sweep under 50 V, of a plate of 0.042 um/V and 3 ms, or of one like it."""
    f = np.arange(25100.0, 25521.0, 4.0)
    w = gain * 0.042 * 50 / (1 + 2j * np.pi * (f - f0) * 3e-3)
    w = w + 0.002 * np.random.default_rng(seed).standard_normal((2, len(f))).T @ [1, 1j]
    return sysid.Log(
        name, w, drive=np.full(len(f), 50.0), frequency=f, kind="steady", response_unit="um", **bench
    )


@seeds(1, 3)
def test_errors_of_logs_that_contradict_one_another_span_them(seeds):
    """The fit is a misfit, as one plate is none of theirs, but its numbers are no truer than the logs agree: G was
    that of the log in Vpp, half of the others', to 0.08 %."""
    for seed in seeds:
        odd = sysid.fit([sweep(f"{k}", 10 * seed + k, gain=0.5 if k == 1 else 1.0) for k in range(3)])
        assert odd.result is sysid.Result.misfit and odd.findings[0].key == "odd"
        G = odd.parameters["G"]
        assert not G.determined or abs(G.value - 0.042) < 4 * G.std


@seeds(1, 3)
def test_errors_of_sweeps_up_and_back_in_temperature_span_their_hysteresis(seeds):
    """25 Hz between warming and cooling."""
    read = ((20, 25310.0), (30, 25240.0), (40, 25170.0), (40, 25195.0), (30, 25265.0), (20, 25335.0))
    for seed in seeds:
        logs = [
            sweep(
                f"{k}",
                10 * seed + k,
                f0,
                temperature=np.full(106, 1.0 * T),
                bench={"temperature_std_degC": 0.01},
            )
            for k, (T, f0) in enumerate(read)
        ]
        fit = sysid.fit(logs)
        assert fit.result is sysid.Result.misfit
        k_T, f0 = fit.parameters["k_T"], fit.parameters["f0"]
        assert not k_T.determined or abs(k_T.value + 7.0) < 4 * k_T.std
        assert not f0.determined or abs(f0.value - (25310.0 - 7 * 4 + 12.5)) < 4 * f0.std


def test_logs_at_resonance_throughout_ask_for_a_sweep():
    """A loop keeps the drive at the resonance while the plate warms: no row is without drive, none beside it."""
    t = 0.05 * np.arange(400)
    f = 32150 - 20 * (1 - np.exp(-t / 8))
    w = 1.5 + 0.005 * np.random.default_rng(0).standard_normal((2, 400)).T @ [1, 1j]
    fit = sysid.fit(
        sysid.Log.from_arrays(w, time=t, drive=np.full(400, 50.0), frequency=f, response_unit="um")
    )
    G = fit.parameters["G"]
    assert not G.determined and "sweep across the resonance" in G.why and "larger" not in G.why


@seeds(2, 6)
def test_a_peak_that_noise_hides_tells_no_gain(seeds):
    """Amplitudes of a sweep in noise of half of its peak: G was 28 % too low by 3.3 of its errors, of a width that
    the noise made up."""
    f = np.arange(31850, 32450.1, 3.0)
    w = 1.5 / (1 + 2j * np.pi * (f - 32150) * 4e-3)
    for seed in seeds:
        noise = 0.8 * np.random.default_rng(seed).standard_normal((2, len(f))).T @ [1, 1j]
        log = sysid.Log.from_arrays(np.abs(w + noise), drive=0 * f + 50, frequency=f, response_unit="um")
        for name, true in {"G": 0.03, "tau": 4e-3, "f0": 32150.0}.items():
            found = sysid.fit(log).parameters[name]
            assert not found.determined or abs(found.value - true) < 4 * found.std


def test_a_decay_of_a_power_is_told_as_one(tmp_path):
    """A cavity's light: |exp(-t/tau)|^2 = exp(-2 t/tau)."""
    t = 5e-8 * np.arange(200)
    power = 3 * np.exp(-2 * t / 3.18e-6) + 1e-3 * np.random.default_rng(0).standard_normal(200)
    for name, unit, values, tau in (("p", "mW", power, 1.59e-6), ("a", "V", power, 1.59e-6)):
        path = tmp_path / f"{name}.csv"
        rows = "\n".join(f"{1e6 * a:.9g},{b:.9g}" for a, b in zip(t, values, strict=True))
        path.write_text(f"time (us),detector ({unit})\n{rows}\n")
        (log,) = sysid.read_logs([path])
        assert any("is a power" in said for said in log.warnings) == (unit == "mW")
        found = sysid.fit(log).parameters["tau"]
        assert abs(found.value - tau) < 4 * found.std
