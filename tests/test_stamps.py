"""Stamps of too few digits, and stamps that scatter, as those of a program that polls its instrument."""

import numpy as np
import pytest
import reference
from conftest import most, seeds, study

import sysid
from sysid import Result
from sysid.rows.clock import even, even_sweep, of_one_moment

PLANT = reference.Plant(G=1.0, tau=1.67e-3, f0=32300.0, k_T=0.0)
N, EARLY, DT, LEVEL = 220, 20, 1e-4, 0.005


def step(scatter, seed, detuning):
    """1 V from row EARLY on; rows are read `scatter` (s, a standard deviation) off their stamps."""
    rng, frequency = np.random.default_rng(1000 + seed), np.full(N, PLANT.f0 + detuning)
    time, drive = DT * np.arange(N), 1.0 * (np.arange(N) >= EARLY)
    response = reference.ringing(PLANT, time, drive, frequency, np.full(N, 24.0)) + reference.noise(
        N, LEVEL, seed
    )
    stamps = np.sort(time + scatter * rng.standard_normal(N))
    return sysid.Log(
        "step", response, time=stamps, drive=drive, frequency=frequency, kind="transient", sampling="instant"
    )


@pytest.mark.parametrize("detuning", [study(0.0), 60.0])
@seeds(6, 20)
def test_stamps_that_scatter_are_in_the_intervals(seeds, detuning):
    """By half of a row: a third of these logs were misfits, and tau of the others was 2 of its errors off."""
    z, heard = [], 0
    for seed in seeds:
        fit = sysid.fit([step(0.5 * DT, seed, detuning)])
        heard += "in time stamps that scatter by" in fit.logs[0].noise
        if fit.result is Result.successful:
            z.append((fit.plant.tau - PLANT.tau) / fit.parameters["tau"].std)
    assert (
        min(len(z), heard) >= 0.9 * len(seeds) - 0.5
    )  # one in twenty scatters least where it tells most, and is called late
    assert np.sqrt(np.mean(np.square(z))) < most(seeds, 2.8)


@seeds(5, 20)
def test_stamps_that_do_not_scatter_are_taken_as_they_are(seeds):
    for seed in seeds:
        fit = sysid.fit([step(0.0, seed, 30.0)])
        assert fit.result is Result.successful
        assert "stamps" not in fit.logs[0].noise


@pytest.mark.parametrize(
    "digit, period, rounded",
    [(1e-3, 3e-4, np.rint), study(1e-3, 1e-4, np.floor), study(1e-4, 1.2e-4, np.rint)],
)
def test_stamps_that_were_rounded_are_those_of_an_even_clock(digit, period, rounded):
    """Whole milliseconds of rows 0.3 ms apart: taken as rows of one moment they were a misfit, or tau was 5
    of its errors off."""
    rows, z = np.arange(320), []
    time, drive = period * rows, 1.0 * (rows >= EARLY)
    clean = reference.ringing(PLANT, time, drive, np.full(320, PLANT.f0 + 60), np.full(320, 24.0))
    stamps = digit * rounded(time / digit + 1e-9)
    for seed in range(10):
        log = sysid.Log(
            "step", clean + reference.noise(320, LEVEL, seed), time=stamps, drive=drive, frequency=np.full(320, PLANT.f0 + 60),
            kind="transient", sampling="instant",
        )  # fmt: skip
        fit = sysid.fit([log])
        assert fit.result is Result.successful, fit.warnings
        z += [
            (fit.plant.tau - PLANT.tau) / fit.parameters["tau"].std,
            (fit.plant.f0 - PLANT.f0) / fit.parameters["f0"].std,
        ]
    assert np.sqrt(np.mean(np.square(z))) < 1.45  # of 20, a root mean square is known to 16 %: three of these
    assert any("whole multiples of" in w for w in fit.warnings)


@pytest.mark.parametrize(
    "time",
    [
        3e-4 * np.arange(300),  # as it is
        np.delete(1e-3 * np.rint(0.3 * np.arange(400)), slice(150, 180)),  # rows are missing: two clocks
        np.sort(3e-4 * np.arange(300) + 1e-4 * np.random.default_rng(0).standard_normal(300)),
        np.append(1e-4 * np.arange(100), 0.01 + 1e-3 * np.arange(200)),  # dense, and then not
        1e-3 * np.rint(0.3 * np.arange(30)),  # the clock is told to 2 %
        np.delete(1e-4 * np.arange(300), 150),  # a row is lost
        np.delete(1e-4 * np.arange(300), [75, 225]),
    ],
)
def test_other_stamps_are_left_alone(time):
    assert even(time) is None


def test_the_clock_is_told_as_well_as_it_says():
    for period in (1.1e-4, 2.7e-4, 5e-4, 9.3e-4):
        line, digit = even(1e-3 * np.rint(1e3 * period * np.arange(400)))
        assert digit == pytest.approx(1e-3)
        assert np.mean(np.diff(line)) == pytest.approx(period, rel=2e-3)


@seeds(8, 100)
@pytest.mark.parametrize("often", [2, 3])
def test_readings_of_one_moment_are_told_from_rows_of_a_faster_clock(seeds, often):
    """By the response: of two or three rows of each stamp, which the stamps alone do not tell apart."""
    stamps = np.repeat(1e-4 * np.arange(120), often)
    clock = 1e-4 / often * np.arange(120 * often)
    for seed in seeds:
        noise = reference.noise(120 * often, 0.01, seed)
        for time, once in ((stamps, True), (clock, False)):
            rise = (1 - np.exp((-1 / PLANT.tau - 400j) * time)) * (1 + 0.5j)
            assert of_one_moment(stamps, rise + noise) is once
        assert not of_one_moment(clock, rise + noise)  # no two share a stamp
        assert not of_one_moment(np.sort(np.append(stamps[:-1], 1.0)), rise + noise)  # nor as many each


def test_two_readings_of_each_moment_are_no_rounded_clock():
    """Errors as of one reading of half the variance: the pairs were parted by half a row, and the trigger late."""
    one = step(0.0, 1, 60.0)
    twice = {name: np.repeat(getattr(one, name), 2) for name in ("time", "drive", "frequency")}
    noise = reference.noise(2 * N, LEVEL, 2)
    clean = one.response - reference.noise(N, LEVEL, 1)
    fit = sysid.fit(
        sysid.Log("twice", np.repeat(clean, 2) + noise, kind="transient", sampling="instant", **twice)
    )
    (said,) = [w for w in fit.warnings if "stamp" in w]
    assert said.endswith("taken as rows of one moment")
    for name in ("G", "tau", "f0"):
        p = fit.parameters[name]
        assert abs(p.value - getattr(PLANT, name)) < 4 * p.std


def test_rounded_frequencies_of_a_sweep_up_and_down():
    up = 25100 + 7.5 * np.arange(81)
    for path in (up, up[::-1], np.append(up, up[::-1]), np.append(up, up[-2::-1])):
        found, digit = even_sweep(10 * np.rint(path / 10))
        assert digit == pytest.approx(10)
        assert np.max(np.abs(found - path)) < 2.5  # half of the digit at each row, unless it is taken off
        assert even_sweep(path) is None
        assert even_sweep(np.round(path + 0.123 * np.arange(len(path)), 1)) is None  # fine enough
    points = np.repeat(25100 + 10.0 * np.arange(40), 2)  # each measured twice
    for path in (points, points[::-1], np.append(points, points[::-1])):
        assert even_sweep(path) is None


@pytest.mark.parametrize("stated, parts", [({"delay_s": 0.0}, 10), study({"delay_s": 0.0}, 1), ({}, 10)])
def test_a_frequency_that_runs_on_between_rows(stated, parts):
    """A chirp of 2 Hz a row, in so many parts of a row: f0 is half a row off if it is taken to stay, which no
    log tells."""
    rows, dwell = 500, 2e-4
    fine = PLANT.f0 - 500 + 2.0 / parts * np.arange(rows * parts)
    at = dwell / parts * np.arange(rows * parts)
    before = np.append(at[0] - 40 * PLANT.tau, at[1:])  # settled where it begins
    z = reference.ringing(PLANT, before, np.ones(len(at)), fine, np.full(len(at), 24.0))[::parts]
    log = sysid.Log(
        "chirp", z + reference.noise(rows, LEVEL, 0), time=at[::parts], drive=np.ones(rows), frequency=fine[::parts],
        kind="transient", sampling="instant", bench=stated,
    )  # fmt: skip
    fit = sysid.fit([log])
    f0 = fit.parameters["f0"]
    said = [w for w in fit.warnings if "if it runs on between them" in w]
    assert bool(said) == bool(stated)
    off = 1.0 if stated and parts > 1 else 0.0  # Hz, half a row, of which a tenth is a part's own
    assert abs(f0.value + off - PLANT.f0) < 4 * f0.std + 0.1
    assert not said or "f0 is 1 Hz higher" in said[0]


def test_a_row_that_is_there_twice_counts_once():
    """Points of a sweep that were written twice were rounded frequencies, with f0 seven errors off."""
    rng, f = np.random.default_rng(3), 32000 + 10.0 * np.arange(61)
    y = 1 / (1 + 2j * np.pi * (f - 32300) * 1.6e-3) + 0.01 * (rng.normal(size=61) + 1j * rng.normal(size=61))
    twice, once = (
        sysid.fit(sysid.Log("sweep", y[rows], drive=np.ones(len(rows)), frequency=f[rows], kind="steady"))
        for rows in (np.repeat(np.arange(61), 2), np.arange(61))
    )
    assert twice.parameters == once.parameters
    assert any("61 of 122 rows are the row before once more" in said for said in twice.warnings)
