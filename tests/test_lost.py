"""Rows in which the signal was lost read exactly zero: they are left out, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds
from scipy import stats

import sysid
from sysid.rows.lost import lost

PLANT = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=-8.0)
RATE, ROWS, STD = 2e4, 600, 0.02


def recorded(seed, drive=100.0, std=STD, early=100):
    """A step after rest, d/q rows with white noise."""
    time, held = np.arange(ROWS) / RATE, np.where(np.arange(ROWS) < early, 0.0, drive)
    frequency = np.full(ROWS, PLANT.f0)
    clean = reference.ringing(PLANT, time, held, frequency, np.full(ROWS, reference.REFERENCE_TEMPERATURE))
    rng = np.random.default_rng(seed)
    noise = std * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    return sysid.Log(
        "step",
        clean + noise,
        time=time,
        drive=held,
        frequency=frequency,
        kind="transient",
        sampling="instant",
    ), rng


def dark(log, rng, rows=12, times=5):
    """The log with as many stretches of zeros, one of which always hides some of the rise; and where they
    are."""
    begins = np.append(rng.integers(5, len(log) - rows, times - 1), rng.integers(95, 120))
    gone = np.isin(np.arange(len(log)), (begins[:, None] + np.arange(rows)).ravel())
    return replace(log, response=np.where(gone, 0.0, log.response)), gone


@seeds(6, 24)
def test_a_fit_is_as_good_as_that_of_the_rows_that_are_left(seeds):
    scores = []
    for seed in seeds:
        log, gone = dark(*recorded(seed))
        found = sysid.fit([log])
        assert found.result is sysid.Result.successful, found.warnings
        assert found.warnings[0] == (
            f"step: {gone.sum()} of {ROWS} rows read exactly zero, or what the row before them reads, amid"
            f" a response that moves:"
            " the signal was lost; they are left out"
        )
        assert len(found.logs[0].residual) == ROWS - gone.sum() and found.logs[0].rows == ROWS
        assert np.std(found.logs[0].residual) < 2 * STD
        scores.append(
            [
                (p.value - t) / p.std
                for p, t in zip(found.parameters.values(), (PLANT.G, PLANT.tau, PLANT.f0), strict=False)
            ]
        )
    for name, z in zip(
        ("tau", "f0"), np.array(scores).T[1:], strict=True
    ):  # G's interval is wider by what could be late
        assert 0.005 < stats.chi2.cdf(np.sum(z**2), len(z)) < 0.995, name


@seeds(6, 24)
def test_a_recorder_that_goes_on_with_its_last_reading_is_seen(seeds):
    """Rows of which Wd and Wq both repeat the row before; a fit is as good as that of the others."""
    scores = []
    for seed in seeds:
        log, rng = recorded(seed)
        y, begins = log.response.copy(), [rng.integers(10, 30), rng.integers(50, 70), rng.integers(101, 115)]
        gone = np.zeros(len(log), bool)
        for begin in begins:
            y[begin + 1 : begin + 13], gone[begin + 1 : begin + 13] = y[begin], True
        log = replace(log, response=y)
        assert np.array_equal(lost(log), gone)
        found = sysid.fit([log])
        assert (
            found.result is sysid.Result.successful and "what the row before them reads" in found.warnings[0]
        )
        scores.append(
            [(p.value - getattr(PLANT, n)) / p.std for n, p in found.parameters.items() if p.determined]
        )
    for name, z in zip(("tau", "f0"), np.array(scores).T[1:], strict=True):
        assert 0.005 < stats.chi2.cdf(np.sum(z**2), len(z)) < 0.995, name


def twice(log, rng):
    """Every reading stored twice."""
    return np.repeat(log.response[::2], 2), np.arange(len(log)) % 2 == 1


def some(log, rng):
    """A tenth of the rows were not read in time."""
    gone = np.arange(len(log)) > 0
    gone &= rng.random(len(log)) < 0.1
    return log.response[np.maximum.accumulate(np.where(gone, 0, np.arange(len(log))))], gone


@pytest.mark.parametrize("stored", [twice, some])
@seeds(6, 24)
def test_single_rows_that_repeat_the_one_before_are_seen(seeds, stored):
    """A fit is as good as that of the other rows, and knows no more."""
    scores = []
    for seed in seeds:
        log, rng = recorded(seed)
        y, gone = stored(log, rng)
        log = replace(log, response=y)
        differ = np.flatnonzero(lost(log) != gone)
        assert not np.any(lost(log) & ~gone)
        # where the drive steps, and at the end, a row that repeats may be of a plate at rest
        assert set(differ) <= {99, 100, 101, ROWS - 2, ROWS - 1}
        found = sysid.fit([log])
        assert (
            found.result is sysid.Result.successful
            and f"{np.sum(lost(log))} of {ROWS} rows" in found.warnings[0]
        )
        scores.append(
            [(p.value - getattr(PLANT, n)) / p.std for n, p in found.parameters.items() if p.determined]
        )
    for name, z in zip(("tau", "f0"), np.array(scores).T[1:], strict=True):
        assert 0.005 < stats.chi2.cdf(np.sum(z**2), len(z)) < 0.995, name


def test_points_of_a_sweep_that_repeat_the_one_before_are_seen():
    f = PLANT.f0 + np.linspace(-500, 500, 201)
    rng = np.random.default_rng(3)
    y = reference.steady(PLANT, np.full(201, 100.0), f, reference.REFERENCE_TEMPERATURE)
    y = y + 0.01 * (rng.standard_normal(201) + 1j * rng.standard_normal(201))
    at = [20, 60, 99, 100, 150]
    for k in at:
        y[k] = y[k - 1]
    log = sysid.Log("sweep", y, drive=np.full(201, 100.0), frequency=f, kind="steady")
    assert np.flatnonzero(lost(log)).tolist() == at


def test_a_recorder_is_coarse_where_its_own_numbers_are():
    """Four digits: about 2 um the steps are as large as the noise, and rows repeat; about 0.01 um they are a
    thousandth of it."""
    log, _ = recorded(1, std=6e-4)
    rounded = [float(f"{v:.3e}") for v in (log.response * np.exp(0.7j)).view(float)]
    log = replace(log, response=np.array(rounded).view(complex))
    assert np.sum(np.diff(log.response) == 0) > 20
    assert not np.any(lost(log))


def test_what_rests_without_noise_is_kept():
    """Settled points of which each is read again, in succession or on the way back, and stairs, all to ten
    digits."""
    up = PLANT.f0 + np.linspace(-500, 500, 51)
    for f in (np.repeat(up, 3), np.repeat(up, 2), np.append(up, up[::-1])):
        y = reference.steady(PLANT, np.full(len(f), 100.0), f, reference.REFERENCE_TEMPERATURE)
        log = sysid.Log("sweep", np.round(y, 10), drive=np.full(len(f), 100.0), frequency=f, kind="steady")
        assert np.any(np.diff(log.response) == 0) and not np.any(lost(log))
    for dwell in (3, 5, 7, 30):  # tau, from row to row
        levels = np.repeat(np.tile([20.0, 100.0, 40.0, 80.0, 55.0], 30), 12)
        rows, time = len(levels), dwell * PLANT.tau * np.arange(len(levels))
        y = reference.ringing(
            PLANT, time, levels, np.full(rows, PLANT.f0 + 30), np.full(rows, reference.REFERENCE_TEMPERATURE)
        )
        for digits in (3, 5, 10):
            log = sysid.Log(
                "stairs", np.round(y, digits), time=time, drive=levels, frequency=np.full(rows, PLANT.f0 + 30)
            )
            assert np.sum(np.diff(log.response) == 0) > 20 and not np.any(lost(log)), (dwell, digits)


def test_rows_that_a_sound_log_repeats_are_kept():
    """Of an amplitude that is clipped, or both channels; a coarse recorder, a rest that reads zero, stairs
    without noise."""
    noisy, _ = recorded(1)
    turned = noisy.response * np.exp(0.7j)
    both = replace(noisy, response=np.minimum(turned.real, 1.0) + 1j * np.minimum(turned.imag, 1.0))
    clipped = replace(noisy, response=np.minimum(np.abs(noisy.response), 1.0))
    rough = replace(
        noisy, response=0.1 * (np.round(noisy.response.real / 0.1) + 1j * np.round(noisy.response.imag / 0.1))
    )
    exact = replace(recorded(0, std=0.0)[0], response=np.round(recorded(0, std=0.0)[0].response, 2))
    time, levels = (
        2e-3 * np.arange(90),
        np.repeat([0.0, 100.0, 40.0, 80.0], [5, 30, 30, 25]),
    )  # comes to rest within a few rows
    drives = reference.ringing(
        PLANT, time, levels, np.full(90, PLANT.f0), np.full(90, reference.REFERENCE_TEMPERATURE)
    )
    stairs = sysid.Log(
        "stairs",
        np.round(drives, 4),
        time=time,
        drive=levels,
        frequency=np.full(90, PLANT.f0),
        kind="transient",
    )
    for log in (both, clipped, rough, exact, stairs):
        assert not np.any(lost(log)), log.name
        assert np.sum(np.diff(log.response) == 0) > 20


def test_zeros_that_a_sound_log_holds_are_kept():
    exact, _ = recorded(0, std=0.0)  # rest reads exactly zero
    time = np.arange(400) * 1e-3
    decays = sysid.Log(
        "decay", np.round(np.exp(-time / 0.02) * np.cos(40 * time), 3) + 0j, time=time, kind="transient"
    )
    coarse = replace(exact, response=0.05 * np.round(exact.response / 0.05))
    noisy, _ = recorded(1)
    rough = replace(
        noisy,
        response=0.05 * (np.round(noisy.response.real / 0.05) + 1j * np.round(noisy.response.imag / 0.05)),
    )
    for log in (exact, coarse, noisy, rough, decays):
        assert not np.any(lost(log)), log.name
    assert np.any(rough.response == 0) and np.any(decays.response == 0)


@pytest.mark.parametrize("kind", ["complex", "amplitude"])
def test_a_settled_sweep_loses_points(kind):
    f = PLANT.f0 + np.linspace(-500, 500, 101)
    rng = np.random.default_rng(3)
    y = reference.steady(PLANT, np.full(101, 100.0), f, reference.REFERENCE_TEMPERATURE)
    y = y + 0.01 * (rng.standard_normal(101) + 1j * rng.standard_normal(101))
    y = np.abs(y) if kind == "amplitude" else y
    y[[20, 48, 49, 70]] = 0
    log = sysid.Log("sweep", y, drive=np.full(101, 100.0), frequency=f, kind="steady")
    found = sysid.fit([log])
    assert found.result is sysid.Result.successful and len(found.logs[0].residual) == 97
    for name in ("G", "tau", "f0"):
        p = found.parameters[name]
        assert abs(p.value - getattr(PLANT, name)) < 4 * p.std, name


@pytest.mark.parametrize("digits", [1, 2])
def test_noise_about_zero_that_is_zero_now_and_then_is_kept(digits):
    """Of noise of 1 in steps of 0.1 one row in 600 reads exactly zero in both channels: that is no signal
    that was lost."""
    rng = np.random.default_rng(digits)
    noise = np.round(rng.standard_normal((2, 100_000)), digits)
    log = sysid.Log(
        "rest", noise[0] + 1j * noise[1], time=1e-4 * np.arange(100_000), kind="transient", sampling="instant"
    )
    assert digits == 2 or np.count_nonzero(log.response == 0) > 50
    assert not np.any(lost(log))
