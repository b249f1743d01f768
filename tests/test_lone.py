"""A value that one reading decides is none: of a sweep in coarse steps one point shows the peak, and none
whether it is right."""

from dataclasses import replace

import numpy as np
import pytest
import reference
from conftest import seeds

import sysid
from sysid.model.theta import NAMES
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.lone import _on_a_floor, _without_one

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
HALF = 1 / (2 * np.pi * PLANT.tau)  # half bandwidth, Hz
WARM = reference.REFERENCE_TEMPERATURE


def swept(apart, seed, *, rows=61, amplitude=True, at=None, wrong=1.0, noise=0.003):
    """Settled points `apart` half bandwidths apart, of which one lies `at` such beside the resonance, else
    anywhere within half a step; noise of the peak. The nearest reads `wrong` times what it should."""
    rng = np.random.default_rng(seed)
    at = apart * rng.uniform(-0.5, 0.5) if at is None else at
    frequency = PLANT.f0 + HALF * (at + apart * (np.arange(rows) - rows // 2))
    clean = reference.steady(PLANT, np.ones(rows), frequency, WARM)
    y = clean + noise * PLANT.G * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    y[rows // 2] *= wrong
    return sysid.Log(
        "sweep", np.abs(y) if amplitude else y, drive=np.ones(rows), frequency=frequency, kind="steady"
    )


def stepped(seed, rows=150, noise=0.01):
    """A step on the resonance, twenty rows in one tau."""
    rng, time = np.random.default_rng(seed), 0.05 * PLANT.tau * np.arange(rows)
    drive, frequency = np.where(np.arange(rows) < 20, 0.0, 1.0), np.full(rows, PLANT.f0)
    clean = reference.ringing(PLANT, time, drive, frequency, np.full(rows, WARM))
    y = clean + noise * PLANT.G * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    return sysid.Log("step", y, time=time, drive=drive, frequency=frequency, sampling="instant")


def errors_off(fit):
    """Of each parameter that is determined by how many of its standard deviations it is off."""
    found = {name: fit.parameters[name] for name in ("G", "tau", "f0")}
    return {name: abs(p.value - getattr(PLANT, name)) / p.std for name, p in found.items() if p.determined}


@seeds(12, 40)
def test_no_sweep_in_steps_of_ten_half_bandwidths_is_many_errors_off(seeds):
    """Its tau was where noise had made it look narrow enough: 5 errors off and more, in 4 of 10 that
    determined one."""
    for seed in seeds:
        fit = sysid.fit([swept(10, seed)])
        off = errors_off(fit)
        assert max(off.values(), default=0.0) < 4, (seed, off)
        assert fit.result.name == "undetermined"


@pytest.mark.parametrize("wrong", [1.0, 0.9])
def test_the_reading_that_decides_is_named_right_or_wrong(wrong):
    """A reading that is off leaves no trace, as G and tau follow it."""
    fit = sysid.fit([swept(8, 0, at=0.2, wrong=wrong)])
    for name in ("G", "tau"):
        why = fit.parameters[name].why
        assert (
            f"that at {PLANT.f0 + 0.2 * HALF:.7g} Hz in sweep" in why
            and "record ten points or more from" in why
        ), why
    assert fit.parameters["f0"].determined and max(errors_off(fit).values()) < 4


@pytest.mark.parametrize("amplitude", [True, False])
@pytest.mark.parametrize("apart", [0.1, 0.5, 1.0])
def test_a_peak_of_several_points_is_told(apart, amplitude):
    for seed in range(6):
        fit = sysid.fit([swept(apart, seed, amplitude=amplitude)])
        assert fit.result.name == "successful", (seed, fit.warnings)
        off = errors_off(fit)
        assert len(off) == 3 and max(off.values()) < 4, (seed, off)


def test_other_logs_tell_what_one_reading_of_a_sweep_would_decide():
    fit = sysid.fit([swept(10, 0, at=0.3), stepped(1)])
    assert fit.result.name == "successful" and len(errors_off(fit)) == 3 and max(errors_off(fit).values()) < 4


def _bench(view):
    return view.weighted(view.columns) if view.columns else np.zeros((0, 0))


@pytest.mark.parametrize("amplitude", [True, False])
def test_what_is_left_without_a_reading_is_what_a_fit_without_it_has(amplitude):
    """C(-R) by the normal equations of all columns, the bench's among them, without the reading's rows."""
    fit = sysid.fit([swept(2, 4, rows=21, amplitude=amplitude), swept(3, 5, rows=15, amplitude=amplitude)])
    state, index = fit.modes[0], [NAMES.index(n) for n in fit.names]
    views = [
        _on_a_floor(LinearisedLog(t, m, state, fit.reference))
        for t, m in zip(state.trials, state.models, strict=True)
    ]
    shown = np.eye(len(NAMES))[index]
    grown, _ = _without_one(views, shown, index)
    size = np.linalg.norm(np.concatenate([v.rows(v.derivatives.T).T[:, index] for v in views]), axis=0)

    def variances(left_out, among):
        gram = np.zeros((len(index), len(index)))
        for i, view in enumerate(views):
            plant, bench = view.rows(view.derivatives.T).T[:, index] / size, _bench(view)
            if i == among:
                keep = np.ones(len(plant), bool)
                keep[[left_out + k * len(view.residual) for k in range(1 if amplitude else 2)]] = False
                plant, bench = plant[keep], bench[keep] if view.columns else bench
            if view.columns:
                bench = bench / np.linalg.norm(bench, axis=0)
                plant = plant - bench @ np.linalg.lstsq(bench, plant, rcond=None)[0]
            gram += plant.T @ plant
        return np.diag(np.linalg.inv(gram))

    for i, view in enumerate(views):
        for row in range(0, len(view.residual), 3):
            np.testing.assert_allclose(grown[i][row], variances(row, i) / variances(0, -1), rtol=1e-5)


@seeds(12, 30)
def test_what_a_drive_would_leave_to_one_reading_is_not_told_without_one(seeds):
    """The noise of so few rows may go with the response, as a periodogram's, or be alike in all of them."""
    told = 0
    for seed in seeds:
        log = swept(1.5, seed, rows=11, noise=0.02)
        driven, alone = (sysid.fit([x]).parameters["tau"] for x in (log, replace(log, drive=None)))
        assert driven.determined or not alone.determined, seed
        told += alone.determined
    assert told > len(seeds) / 3
