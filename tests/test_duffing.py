"""A plate whose resonance goes with the square of its amplitude: fitted, from a peak that leans a little to
one that jumps."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
import reference
from conftest import seeds, study

import sysid

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
HALF = 1 / (2 * np.pi * PLANT.tau)  # half bandwidth, Hz
ROWS, NOISE = 101, 0.005  # of the peak
WARM = reference.REFERENCE_TEMPERATURE
LEANS = "on the amplitude"


def leaned(frequency, softer):
    """Settled responses, in G, of a plate whose resonance falls by `softer` half bandwidths at G V, each
    reached from the one before. At x half bandwidths the square w of the amplitude is a root of w (1 + (x +
    softer w)^2) = 1."""
    w, squares = 0.0, []
    for x in (frequency - PLANT.f0) / HALF:
        roots = np.roots([softer**2, 2 * softer * x, 1 + x**2, -1.0])
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        # Of three the middle one is unstable, and the response stays on the branch where it is.
        w = real[0] if w < real[len(real) // 2] else real[-1]
        squares.append(w)
    moved = replace(PLANT, k_T=1.0)  # per degC as many Hz
    return reference.steady(
        moved, np.full(ROWS, 1 / PLANT.G), frequency, WARM - softer * HALF * np.array(squares)
    )


def sweeps(softer, seed, amplitude=True, directions=(1, -1), clean=leaned):
    """A sweep of 6 half bandwidths about the resonance for each direction."""
    rng, logs = np.random.default_rng(seed), []
    for way in directions:
        frequency = PLANT.f0 + HALF * np.linspace(-6, 6, ROWS)[::way]
        noise = NOISE * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
        y = PLANT.G * (clean(frequency, softer) + noise) * np.exp(0.4j)
        y = np.abs(y) if amplitude else y
        logs.append(sysid.Log(f"sweep {way}", y, drive=np.ones(ROWS), frequency=frequency, kind="steady"))
    return logs


def said(fit):
    return [warning for warning in fit.warnings if LEANS in warning]


def told(fit, off=4.5):
    """Whether the lean is fitted or spanned by the errors, with a right plate, or named."""
    if fit.result.name != "successful":
        return bool(said(fit))
    truth = {"G": PLANT.G, "tau": PLANT.tau, "f0": PLANT.f0}
    near = all(abs(fit.parameters[n].value - v) < off * fit.parameters[n].std for n, v in truth.items())
    return near and "duffing" in {f.key for f in fit.findings if f.outcome in ("fitted", "widened")}


@pytest.mark.study  # from twice that on it is fitted in every one
@seeds(5, 20)
def test_a_peak_that_leans_by_a_few_hundredths_of_a_half_bandwidth_is_named_or_fitted(seeds):
    """f0 is off by 5 to 9 of its errors then, and noise hides how: without a word it was, and successful, in
    every second."""
    assert sum(told(sysid.fit(sweeps(0.03, seed))) for seed in seeds) >= 0.6 * len(seeds) - (
        len(seeds) < 20
    )  # one more of few


@seeds(1, 20)
def test_from_twice_that_on_it_is_fitted(seeds, among):
    fits = [sysid.fit(sweeps(0.06, seed), nuisances=among("duffing")) for seed in seeds]
    assert all(told(fit) for fit in fits) and sum(
        fit.result.name == "successful" for fit in fits
    ) >= 0.9 * len(seeds)


@seeds(6, 30)
def test_a_peak_that_does_not_lean_is_not_said_to(seeds):
    """By chance one of a thousand is."""
    fits = [sysid.fit(sweeps(0.0, seed, amplitude)) for seed in seeds for amplitude in (True, False)]
    assert all(fit.result.name == "successful" for fit in fits)
    assert sum(bool(said(fit)) for fit in fits) <= 2


QUICK = {(1.0, True, (1, -1)), (-4.0, False, (1,))}  # of the peaks that lean over


@pytest.mark.parametrize(
    ("softer", "amplitude", "directions"),
    [
        case if case in QUICK else study(*case)
        for case in product((1.0, 4.0, -4.0), (True, False), ((1, -1), (1,), (-1,)))
    ],
)
def test_a_peak_that_leans_over_is_fitted_with_its_lean(softer, amplitude, directions, among):
    fit = sysid.fit(sweeps(softer, 3, amplitude, directions), nuisances=among("duffing"))
    assert fit.result.name == "successful" and told(fit), fit.warnings
    shift, size = (fit.findings[0].numbers[name] for name in ("shift_Hz", "at"))
    lean = -softer * HALF * (size.value / PLANT.G) ** 2
    assert abs(shift.value - lean) < 4.5 * shift.std
    (warning,) = said(fit)
    assert "leans over" in warning and f"{shift.value:+.3g}" in warning
    driven = f"{PLANT.f0 - 6 * HALF:.6g} to {PLANT.f0 + 6 * HALF:.6g} Hz"  # as it was, not as it acts
    assert all(driven in log.description for log in fit.logs)


def second(frequency, _, beside=3.0, share=0.5):
    x = (frequency - PLANT.f0) / HALF
    return 1 / (1 + 1j * x) + share / (1 + 1j * (x - beside))


def compressed(frequency, _):
    z = 1 / (1 + 1j * (frequency - PLANT.f0) / HALF)
    return z * np.minimum(1, 0.7 / np.abs(z))


def hurried(frequency, _, dwell=1.0):
    """What each point had settled to after `dwell` tau."""
    x, z, found = (frequency - PLANT.f0) / HALF, 0j, []
    for here in x:
        at = 1 / (1 + 1j * here)
        z = at + (z - at) * np.exp(-(1 + 1j * here) * dwell)
        found.append(z)
    return np.array(found)


def drifting(frequency, _, half_bandwidths=1.0):
    """The resonance goes up from the first point to the last."""
    x = (frequency - PLANT.f0) / HALF - half_bandwidths * np.linspace(-0.5, 0.5, len(frequency))
    return 1 / (1 + 1j * x)


OTHERS = (  # and what they are
    (second, "second_mode"),
    (partial(second, beside=1.5), "second_mode"),
    (compressed, "saturation"),
    (hurried, "dwell"),
    (partial(hurried, dwell=0.3), "dwell"),
    (drifting, "f0_drift"),
)


@pytest.mark.study
@pytest.mark.parametrize(
    ("other", "amplitude", "directions"),
    [
        (OTHERS[2], True, (1, -1)),
        (OTHERS[5], False, (1,)),
        *(study(*case) for case in product(OTHERS, (True, False), ((1, -1), (1,)))),
    ],
)
def test_what_else_bends_a_peak_is_not_said_to_lean_over(other, amplitude, directions, among):
    clean, name = other
    names = among("duffing", "saturation", "f0_drift", name)
    fit = sysid.fit(sweeps(0.0, 5, amplitude, directions, clean), nuisances=names)
    assert not any("leans over" in warning for warning in fit.warnings), fit.warnings


@pytest.mark.parametrize("amplitude", [True, study(False)])
@pytest.mark.parametrize(("row", "factor"), [(30, 10.0), study(55, 0.1), study(70, 0.001)])
def test_a_range_that_was_changed_within_a_sweep_is_named(row, factor, amplitude):
    for seed in range(4):
        log, other = sweeps(0.0, seed, amplitude)
        log = replace(log, response=np.where(np.arange(ROWS) < row, 1.0, factor) * log.response)
        for logs in ([log], [log, other]):
            fit = sysid.fit(logs)
            assert fit.result.name != "successful"
            said = f"sweep 1: from row {row} (counted from 0) on its response is {factor:g} times as large"
            assert any(said in warning for warning in fit.warnings), fit.warnings
