"""Amplitudes of a sweep in noise that lifts them, against Rice's distribution itself."""

import numpy as np
import pytest
import reference
from conftest import study
from scipy.special import i0e, i1e

import sysid
from sysid.model import rice

HALF = 95.3  # Hz, half bandwidth


def information(size: np.ndarray) -> np.ndarray:
    """(2, 2, n) Fisher's, of an amplitude over its noise, `size` (n,), and of the noise's logarithm, by a sum
    over Rice's law."""
    x = np.linspace(0, np.max(size) + 9, 1000)
    ratio, z = i1e(x * size[:, None]) / i0e(x * size[:, None]), x * size[:, None]
    law = x * np.exp(-0.5 * (x - size[:, None]) ** 2) * i0e(z)
    scores = np.array([x * ratio - size[:, None], x**2 + size[:, None] ** 2 - 2 - 2 * z * ratio])
    return np.einsum("inx,jnx,nx->ijn", scores, scores, law) * (x[1] - x[0])


def bound(plant, frequency: np.ndarray, drive: np.ndarray, noise: float) -> np.ndarray:
    """Cramer and Rao's for G and tau, relative, f0 and the noise unknown."""

    def size(shift: np.ndarray) -> np.ndarray:
        other = reference.Plant(
            plant.G * np.exp(shift[0]), plant.tau * np.exp(shift[1]), plant.f0 + shift[2], 0.0
        )
        return np.abs(reference.steady(other, drive, frequency, 24.0))

    steps = np.diag([1e-5, 1e-5, 1e-3])
    slopes = np.array([(size(h) - size(-h)) / (2 * np.max(h)) for h in steps]) / noise
    rows = np.zeros((4, 2, len(frequency)))
    rows[:3, 0], rows[3, 1] = slopes, 1.0
    total = np.einsum("ain,ijn,bjn->ab", rows, information(size(np.zeros(3)) / noise), rows)
    return np.sqrt(np.diag(np.linalg.inv(total))[:2])


@pytest.mark.study
@pytest.mark.parametrize("noise", [study(0.03), 0.2])
def test_the_noise_that_lifts_the_amplitudes_is_no_better_known_than_its_scatter_tells(noise):
    """At a fifth of the peak, with it taken as known, tau was said to be known a twentieth better than Rice's
    law allows."""
    plant = reference.Plant(G=0.02, tau=1.67e-3, f0=32300.0, k_T=0.0)
    frequency, drive = np.linspace(plant.f0 - 5 * HALF, plant.f0 + 5 * HALF, 101), np.full(101, 50.0)
    stated = []
    for seed in range(20):
        w = np.abs(reference.steady(plant, drive, frequency, 24.0) + noise * reference.noise(101, 1.0, seed))
        fit = sysid.fit([sysid.Log("sweep", w, drive=drive, frequency=frequency, kind="steady")])
        found = reference.Plant(fit.plant.G, fit.plant.tau, fit.plant.f0, 0.0)
        least = bound(found, frequency, drive, fit.modes[0].trials[0].noise.std)
        stated.append([fit.parameters[n].std / getattr(fit.plant, n) for n in ("G", "tau")] / least)
    # Rice's law tells G and tau a little better than its mean and spread, of which the fit is made: by 1 % at
    # most here.
    np.testing.assert_allclose(np.median(stated, axis=0), 1, atol=0.03)


@pytest.mark.parametrize("offset", [0.0, 0.06, 0.1])
def test_rows_at_rest_tell_an_amplitude_from_a_signed_output(offset):
    """Of 200 bursts in noise of 2 %, twenty rows before and 35 long after; eight rows of a time constant."""
    drive, decays = np.repeat([0.0, 100.0, 0.0], [20, 100, 140]), np.exp(-1 / 8)
    clean = np.zeros(260)
    for k in range(1, 260):
        clean[k] = decays * clean[k - 1] + (1 - decays) * (drive[k - 1] > 0)
    called = 0
    for seed in range(200):
        rows = clean + reference.noise(260, 0.02, seed)
        rows = rows.real + offset if offset else rows
        given = {"drive": drive, "kind": "transient", "sampling": "instant"}
        called += rice.rectified(sysid.Log("burst", np.abs(rows), time=2e-4 * np.arange(260), **given))
    assert called >= 196 if not offset else called <= 4  # two in a hundred


def test_rows_that_rest_at_one_value_are_on_an_offset():
    """As a recorder in coarse steps has them."""
    rows, drive = (np.repeat(each, [20, 100, 140]) for each in ([0.05, 1.0, 0.05], [0.0, 100.0, 0.0]))
    rows[20:120] += 0.01 * np.random.default_rng(0).standard_normal(100)
    given = {"drive": drive, "kind": "transient", "sampling": "instant"}
    assert not rice.rectified(sysid.Log("burst", rows, time=1e-4 * np.arange(260), **given))


def test_an_acceleration_taken_for_a_displacement_is_named():
    """Its amplitude w^2/|w0^2 - w^2 + 2j w/tau| is that of a displacement and a feedthrough of 1/Q of the peak
    (closed form)."""
    f, f0, Q = np.linspace(120, 240, 121), 180.0, 25.0
    x = f / f0
    clean = x**2 / np.abs(1 - x**2 + 1j * x / Q)
    noise = 0.02 * np.random.default_rng(2).standard_normal(len(f))
    fit = sysid.fit(sysid.Log("shaker", clean + noise, None, np.ones(len(f)), f, kind="steady"))
    (found,) = (found for found in fit.findings if found.key == "feedthrough")
    size = found.numbers["in_quadrature"]
    assert abs(abs(size.value) - 1 / Q) < 4 * size.std < 0.01 and "quantity" in found.sentence
    assert abs(fit.parameters["f0"].value - f0) < 4 * fit.parameters["f0"].std
