"""Columns as instruments write them: frequencies in whole hertz, a drive that was measured, a thermometer of
tenths of a degree, an amplitude whose noise has no sign. What they leave is noise, and no misfit."""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import most, study, tiers

import sysid


@pytest.fixture(params=tiers(range(2), range(12)))
def seeds(request):
    return request.param


def scores(bench, seeds, made, names=("G", "tau", "f0"), **given):
    """(seeds, names): (fit - truth)/std of logs that are all to be successful."""
    found = []
    for seed in seeds:
        fit = sysid.fit(made(np.random.default_rng(seed)), **given)
        assert fit.result is sysid.Result.successful, fit.warnings
        found.append(
            [(fit.parameters[n].value - getattr(bench.plant, n)) / fit.parameters[n].std for n in names]
        )
    return np.array(found)


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def swept(bench, rng, drive=None, frequency=None, temperature=24.0, level=0.01, **given):
    """A sweep of settled points over six half bandwidths at 100 V; recorded are a drive and a frequency of
    their own."""
    true = 32300.0 + bench.plant.k_T * (np.mean(temperature) - 24.0) + np.linspace(-285, 285, 81)
    warm = np.broadcast_to(temperature, 81)
    clean = reference.steady(bench.plant, np.full(81, 100.0), true, warm)
    response = np.exp(0.3j) * clean + level * (rng.standard_normal(81) + 1j * rng.standard_normal(81))
    given = {"temperature": warm, "kind": "steady"} | given
    drive = np.full(81, 100.0) if drive is None else drive
    return sysid.Log(
        "sweep", response, drive=drive, frequency=true if frequency is None else frequency(true), **given
    )


@pytest.mark.parametrize("digit", [study(0.5), 1.0, study(2.0)])
def test_frequencies_that_are_rounded(bench, seeds, digit):
    """Points 7.1 Hz apart. A drift fits any rounding, by more than the sweep is wide."""
    made = lambda rng: [swept(bench, rng, frequency=lambda f: np.round(f / digit) * digit)]  # noqa: E731
    assert np.all(rms(scores(bench, seeds, made)) < most(seeds))


@pytest.mark.parametrize("share", [study(0.003), 0.01])
@pytest.mark.parametrize("followed", [False, True])
def test_a_drive_that_was_measured(bench, seeds, share, followed):
    """Noise of the meter is not the plate's drive; a drive that does vary is."""

    def made(rng):
        drive = 100 * (1 + share * rng.standard_normal(81))
        log = swept(bench, rng, drive)
        return [replace(log, response=log.response * drive / 100) if followed else log]

    z = scores(bench, seeds, made)
    assert np.all(rms(z[:, 1:]) < most(seeds))
    # the mean of the meter's 81 readings is G's error too, of a tenth of its noise
    assert followed or rms(z[:, 0]) < 2 * most(seeds)


def test_a_step_whose_drive_was_measured(bench, seeds):
    def made(rng):
        log = bench.transient(seed=int(rng.integers(1000)))
        return [replace(log, drive=log.drive * (1 + 0.01 * rng.standard_normal(len(log))))]

    assert np.all(rms(scores(bench, seeds, made)) < most(seeds))


@pytest.mark.study
@pytest.mark.parametrize("kind", ["of two values", "normal"])
def test_a_drive_that_is_made_to_vary_about_its_level_is_not_a_meters_noise(bench, seeds, kind):
    """By 1 % of 100 V in each row of a log that tells tau by nothing else."""

    def made(rng):
        beside = np.sign(rng.standard_normal(4000)) if kind == "of two values" else rng.standard_normal(4000)
        return [
            bench.transient(seed=int(rng.integers(1000)), volts=100 + beside, noise=1e-4, frequency=32300.0)
        ]

    z = scores(bench, seeds, made, ("tau", "f0"))
    assert np.all(rms(z) < most(seeds))


@pytest.mark.parametrize(
    ("digit", "flicker", "ramp"),
    [study(0.1, 0.0, 3.0), (0.25, 0.0, 3.0), study(0.0, 0.4, 0.0), (0.1, 0.3, 0.0)],
)
def test_temperatures_as_thermometers_tell_them(bench, seeds, digit, flicker, ramp):
    """Creeping and read to a tenth of a degree; constant and read with noise. Of this k_T took nothing, and
    was zero."""

    def made(rng):
        logs = []
        for middle in (24.0, 34.0):
            warm = middle + ramp * np.linspace(-0.5, 0.5, 81)
            read = warm + flicker * rng.standard_normal(81)
            log = swept(bench, rng, temperature=warm)
            logs.append(replace(log, temperature=np.round(read / digit) * digit if digit else read))
        return logs

    z = scores(bench, seeds, made, ("G", "tau", "k_T"))
    assert np.all(rms(z) < most(seeds))


def test_one_temperature_that_flickers_tells_no_k_T(bench, seeds):
    def made(rng):
        log = swept(bench, rng)
        return [replace(log, temperature=24 + 0.4 * rng.standard_normal(81))]

    for seed in seeds:
        assert not sysid.fit(made(np.random.default_rng(seed))).parameters["k_T"].determined


@pytest.mark.parametrize(("rest", "level"), [study(30, 0.01), study(120, 0.01), (30, 0.03), study(120, 0.03)])
def test_an_amplitude_without_a_frequency_has_no_offset(bench, seeds, rest, level):
    """Driven at resonance: noise at rest reads 1.25 of its standard deviation, by which G was too small."""

    def made(rng, sign=1.0, offset=0.0):
        time, drive = 1e-4 * np.arange(rest + 250), np.repeat([0.0, 100.0], [rest, 250])
        grown = bench.plant.G * 100 * -np.expm1(-np.maximum(time - time[rest], 0) / bench.plant.tau)
        noise = 2 * level * (rng.standard_normal(len(time)) + 1j * rng.standard_normal(len(time)))
        response = np.abs(grown + noise) if sign else grown + noise.real + offset
        return [sysid.Log("step", response, time=time, drive=drive, kind="transient", sampling="instant")]

    assert np.all(rms(scores(bench, seeds, made, ("G", "tau"))) < most(seeds))
    signed = lambda rng: made(rng, 0.0, 6 * level)  # noqa: E731, an offset of three standard deviations
    assert np.all(rms(scores(bench, seeds, signed, ("G", "tau"))) < most(seeds))


def test_a_reference_that_may_be_late_is_named(bench):
    """The mirror image of a sensor that is late; G is too small."""

    def said(log):
        return [w for w in sysid.fit([log]).notes if "a reference that is late by" in w]

    log = swept(bench, np.random.default_rng(0))
    turned = lambda t: replace(log, response=log.response * np.exp(2j * np.pi * t * (log.frequency - 32300)))  # noqa: E731
    assert not said(log)
    assert said(turned(60e-6)) and not said(turned(-60e-6))
    assert "beside the 2e-05 s that are stated" in said(replace(turned(60e-6), bench={"delay_s": 2e-5}))[0]
    assert not said(replace(turned(60e-6), bench={"delay_s": 0.0}))


def test_a_frequency_of_zero_throughout_is_none(bench):
    log = bench.transient(seed=3, frequency=bench.plant.f0)
    fit = sysid.fit([replace(log, frequency=np.zeros(len(log)))])
    assert any("its frequency is 0 in every row" in said for said in fit.warnings)
    assert abs(fit.parameters["tau"].value - bench.plant.tau) < 4 * fit.parameters["tau"].std
    assert "no frequency is recorded" in fit.parameters["f0"].why


def test_a_force_that_steps_is_held_from_row_to_row(bench, seeds):
    """Rows a twelfth of tau apart: with half of the press in the row before, G was 6 % low, 7 of its standard
    deviations."""
    force = np.repeat([0.0, 1.5, 0.5], [80, 80, 80])
    time, frequency = bench.plant.tau / 12 * np.arange(240), np.full(240, bench.plant.f0)
    drive = np.where(np.arange(240) < 20, 0.0, 100.0)
    _, tau = reference.touched(bench.plant, force)
    inputs = time, drive, frequency, np.full(240, 24.0)

    def made(rng):
        clean = reference.ringing(bench.plant, *inputs, tau=tau)
        response = clean + 0.02 * (rng.standard_normal(240) + 1j * rng.standard_normal(240))
        given = {"time": time, "drive": drive, "frequency": frequency, "force": force}
        return [sysid.Log("pressed", response, kind="transient", sampling="instant", **given)]

    assert np.all(rms(scores(bench, seeds, made)) < most(seeds))


@pytest.mark.parametrize("dwell", [5.0, study(20.0)])
def test_rows_of_the_inputs_before_are_that_however_long_they_dwell(bench, seeds, dwell):
    """A timed sweep says sampling: instant, and not its kind; taken for points of their own inputs, f0 is a
    point of it off."""
    frequency = bench.plant.f0 + np.linspace(-300, 300, 61)
    time, drive = dwell * bench.plant.tau * np.arange(61), np.full(61, 100.0)
    clean = reference.ringing(bench.plant, time, drive, frequency, np.full(61, 24.0))

    def made(rng):
        response = clean + 0.01 * (rng.standard_normal(61) + 1j * rng.standard_normal(61))
        return [sysid.Log("timed", response, time=time, drive=drive, frequency=frequency, sampling="instant")]

    assert np.all(rms(scores(bench, seeds, made)) < most(seeds))


def test_a_timed_sweep_that_does_not_say_to_which_inputs_its_rows_belong_is_told_what_was_taken(bench):
    log = swept(bench, np.random.default_rng(0), time=0.05 * np.arange(81), kind=None)
    assert any(
        "not stated and matters here; taken as sampling: settled" in w for w in sysid.fit([log]).warnings
    )
    assert not any("taken as sampling" in w for w in sysid.fit([replace(log, sampling="settled")]).warnings)


def test_a_drive_that_is_fed_back_from_the_response(bench, seeds):
    """An amplitude controller's drive goes with the noise of its sensor. So would rows that show their own
    inputs, by another number."""
    n, spacing, plant = 400, bench.plant.tau / 20, bench.plant
    pole = -1 / plant.tau + 2j * np.pi * -40.0  # driven 40 Hz above the resonance
    asked = np.repeat([0.0, 1.0, 1.6], [20, 180, 200])

    def made(rng):
        noise = 0.02 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
        z, summed, drive, rows = 0j, 0.0, np.zeros(n), np.zeros(n, complex)
        for k in range(n):
            rows[k] = z + noise[k]
            error = asked[k] - abs(rows[k]) if asked[k] else 0.0
            summed += 2 * error * spacing / plant.tau / plant.G
            drive[k] = 2 * error / plant.G + summed if asked[k] else 0.0
            z = np.exp(pole * spacing) * z + plant.G / plant.tau * drive[k] * np.expm1(pole * spacing) / pole
        given = {"drive": drive, "frequency": np.full(n, plant.f0 + 40.0), "sampling": "instant"}
        return [sysid.Log("closed loop", rows, time=spacing * np.arange(n), kind="transient", **given)]

    assert np.all(rms(scores(bench, seeds, made)) < most(seeds))


def test_a_drive_of_one_size_that_was_measured_is_not_out_of_proportion(bench, seeds):
    """On and off, plus and minus: the cubes of the meter's noise say nothing of an amplifier."""
    drive = 100.0 * np.random.default_rng(7).choice([-1.0, 0.0, 1.0], 60).repeat(6)
    time, n = bench.plant.tau / 5 * np.arange(len(drive)), len(drive)
    clean = reference.ringing(bench.plant, time, drive, np.full(n, bench.plant.f0 + 30.0), np.full(n, 24.0))

    def made(rng):
        response = clean + 0.02 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
        given = {"frequency": np.full(n, bench.plant.f0 + 30.0), "drive": drive + rng.standard_normal(n)}
        return [
            sysid.Log("random levels", response, time=time, kind="transient", sampling="instant", **given)
        ]

    z = scores(bench, seeds, made)
    assert np.all(rms(z) < most(seeds))


@pytest.mark.parametrize("points", [9, study(11)])
def test_few_points_on_a_background_that_slopes(bench, seeds, points):
    """A tenth of the response, from one end of the sweep to the other."""
    frequency = bench.plant.f0 + np.linspace(-250, 250, points)
    clean = reference.steady(bench.plant, np.full(points, 100.0), frequency, np.full(points, 24.0))

    def made(rng):
        noise = 0.01 * (rng.standard_normal(points) + 1j * rng.standard_normal(points))
        response = clean + 0.2 * np.exp(1j) * np.linspace(-0.5, 0.5, points) + noise
        return [sysid.Log("few", response, drive=np.full(points, 100.0), frequency=frequency, kind="steady")]

    z = scores(bench, seeds, made)
    # Of nine points eight of eighteen numbers are taken: scores are Student's of ten degrees of freedom, rms
    # 1.12.
    assert np.all(rms(z) < 1.12 * most(seeds))
