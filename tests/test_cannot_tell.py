"""A short version of the study benchmarks/cannot_tell.py: the first seed of the causes whose logs share a few
programs."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import seeds

import sysid

STUDY = Path(__file__).parents[1] / "benchmarks" / "cannot_tell.py"


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("cannot_tell_study", STUDY)
    found = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    yield found
    del sys.modules[spec.name]


def seed_of(study, cause):
    return next(seed for seed in range(1000) if study.bench(seed)[0] == cause)


@pytest.mark.parametrize(
    "cause",
    [
        "one temperature",
        "no temperature",
        "window of 0.1 to 0.5 tau",
        "noise hides the transient",
        "rows coarser than the transient",
        "rotation or f0",
        "fixed frequency while it warms",
        "sweep too narrow",
        "amplitude of a step at resonance",
        "amplitude of a step off resonance",
    ],
)
def test_what_the_logs_cannot_tell_is_said_with_its_cause(study, cause):
    found = study.outcome(seed_of(study, cause), follow=False)
    assert found.open, found.text
    assert found.named, found.text
    assert found.z < study.FAR, found.text


def test_the_record_that_is_asked_for_settles_it(study):
    found = study.outcome(seed_of(study, "window of 0.1 to 0.5 tau"))
    assert found.followed, found.text
    assert found.z_after < study.FAR, found.text


@pytest.mark.parametrize(
    ("sentence", "before", "unit", "expected"),
    [
        ("record 2.5 ms or more after a step", "record", "s", 2.5e-3),
        ("record rows 40 us apart", "record rows", "s", 40e-6),
        ("sweep over at least 1.2e+03 Hz about", "at least", "Hz", 1200.0),
        ("record a larger step", "record", "s", None),
    ],
)
def test_the_record_that_a_sentence_asks_for_is_read(study, sentence, before, unit, expected):
    found = study.asked(sentence, before, unit)
    assert found is None if expected is None else found == pytest.approx(expected, rel=1e-12)


# --- nothing at all
# ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [2, 3, 4])
def test_as_many_unknowns_as_numbers_tell_nothing(bench, points):
    """Of d and q at four points two numbers are left beside G, tau, f0, a rotation and a feedthrough."""
    for seed in range(5):
        found = sysid.fit([bench.sweep(seed=seed, frequency=np.linspace(32200, 32400, points))])
        assert found.result.name == "undetermined" and not any(
            p.determined for p in found.parameters.values()
        )
        assert "hardly more than the unknowns" in found.parameters["tau"].why


@pytest.mark.study
@seeds(6, 40)
def test_few_points_that_tell_their_noise_are_fitted(bench, seeds):
    z = []
    for seed in seeds:
        p = sysid.sample(
            sysid.fit([bench.sweep(seed=seed, frequency=np.linspace(32200, 32400, 8))])
        ).summary()
        z += [p[n].ci95[0] < getattr(bench.plant, n) < p[n].ci95[1] for n in ("tau", "f0") if p[n].determined]
    # of 70 intervals 95 % +- 2.6 % hold the truth: less 3.5 of these
    assert np.mean(z) > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / len(z)) and len(z) > 1.5 * len(seeds)


@pytest.mark.parametrize("value", [0.0, 1.5 - 0.2j])
@pytest.mark.parametrize("kind", ["sweep", "transient"])
def test_a_response_that_is_the_same_in_every_row_is_called_that(bench, kind, value):
    log = getattr(bench, kind)()
    found = sysid.fit([replace(log, response=np.full(len(log), value, complex))])
    assert found.result.name == "undetermined" and not any(p.determined for p in found.parameters.values())
    assert "the same in every row" in found.parameters["G"].why
    assert not any("phase" in w or "late" in w for w in found.warnings)
    shown = sysid.sample(found).summary()
    assert not any(p.determined for p in shown.values())


def test_a_drive_that_only_moves_slowly_is_why_nothing_is_told(bench):
    """Up and down in a thousand rows, three tau apart: by the seed it was noise, a log too short, or a faster
    part of the plant."""
    for seed in range(3):
        up = np.linspace(0.0, 100.0, 500)
        log = bench.transient(seed=seed, volts=np.concatenate([np.zeros(20), up, up[::-1]]), dt=5e-3)
        found = sysid.fit([log])
        assert found.result.name == "undetermined"
        for name in ("G", "tau"):
            assert "the drive only moves slowly" in found.parameters[name].why
        assert not any(f.outcome == "refused" for f in found.findings)


@pytest.mark.parametrize("drive", [0.0, 100.0])
def test_a_line_in_noise_is_no_resonance(bench, drive):
    """White noise about a constant: some line of it fits a sharp resonance, whose f0 seems to be known."""
    for seed in range(10):
        rng, log = np.random.default_rng(seed), bench.transient()
        noise = 1.0 + rng.standard_normal(len(log)) + 1j * rng.standard_normal(len(log))
        found = sysid.fit([replace(log, response=noise, drive=np.full(len(log), drive))])
        assert not found.parameters["f0"].determined or found.result.name == "misfit"
        assert not found.parameters["tau"].determined


@seeds(2, 20)
def test_where_tau_is_not_told_f0_is_not_either_but_to_the_narrowest_half_bandwidth(bench, seeds):
    """Five rows of a step, in noise: of a tau ten times too short the half bandwidth is ten times too wide,
    and f0 was determined to hundreds of hertz; and of what the logs do not bound, the report's draws were
    never wider than 1 Hz."""
    for seed in seeds:
        fit = sysid.fit([bench.transient(seed=seed, volts=np.repeat([0.0, 100.0], [20, 5]))])
        f0 = sysid.sample(fit, seed=seed).summary()["f0"]
        for p in (fit.parameters["f0"], f0):
            assert not p.determined or (abs(p.value - bench.plant.f0) < 5 * p.std and p.std < 60.0)


def plate(rng, f, noise):
    """Settled points of 20 V: f0 5200 Hz, a half bandwidth of 13.3 Hz."""
    y = 20.0 / (1 + 1j * (f - 5200.0) / 13.3)
    return sysid.Log(
        "sweep",
        y + noise * (rng.standard_normal((2, len(f))).T @ (1, 1j)),
        drive=np.full(len(f), 20.0),
        frequency=f,
        temperature=np.full(len(f), 24.0),
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_sweep_much_narrower_than_its_peak_is_not_called_a_flank_nor_noise(seed):
    """In noise of a tenth, over a tenth of the width: what lies outside of it nobody can tell."""
    rng = np.random.default_rng(seed)
    fit = sysid.fit([plate(rng, np.linspace(5199.0, 5201.5, 30), 1.5)])
    for name in ("G", "tau"):
        why = fit.parameters[name].why
        assert "a sweep over 2.5 Hz does not show the width" in why and "at least 25 Hz" in why
    assert "25 Hz wide or more" in fit.parameters["f0"].why
    wide = sysid.fit([plate(rng, np.linspace(5180.0, 5220.0, 40), 1.5)])  # "at least"
    assert wide.result is sysid.Result.successful


def test_a_short_step_of_little_noise_says_that_of_its_gain_too():
    rng = np.random.default_rng(0)
    t = 1e-3 * np.arange(40)
    drive = np.where(t < 0.01, 0.0, 10.0)
    y = 0.5 * 10 * (1 - np.exp(-np.maximum(t - 0.01, 0.0) / 0.1))
    log = sysid.Log("step", y + 0.03 * rng.standard_normal(40), drive=drive, time=t)
    found = sysid.fit([log]).parameters
    assert "the longest log covers" in found["G"].why and found["G"].why == found["tau"].why


@pytest.mark.parametrize("ends", [2.0, 20.0])
def test_a_plant_that_integrates_is_called_that(ends):
    """A motor's angle behind a step of its voltage: longer records say the same, until nobody is asked to
    wait."""
    rng = np.random.default_rng(0)
    t = ends / 200 * np.arange(200)
    drive = np.where(t < 0.1 * ends, 0.0, 12.0)
    angle = 7.5 * 12 / ends * np.maximum(t - 0.1 * ends, 0.0)
    log = sysid.Log("angle", angle + 0.05 * rng.standard_normal(200), drive=drive, time=t)
    found = sysid.fit([log]).parameters
    for name in ("G", "tau"):
        assert "a plant that integrates" in found[name].why and "record its rate of change" in found[name].why
