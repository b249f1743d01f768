"""Whether a plate has changed: as often by chance as it says, and surely where it has."""

import dataclasses
import json

import numpy as np
import pytest
import reference
from conftest import PLATE
from scipy.stats import chi2, kstest

import sysid
from sysid.posterior.change import Told, compare_fits

NAMES = ("G", "tau", "f0", "k_T")
UNITS = ("um/V", "s", "Hz", "Hz/degC")
VALUES = np.array([0.02, 1.669e-3, 32300.0, -10.0])
STD = np.array([1e-5, 2e-6, 0.1, 0.04])
CORRELATED = np.array([[1, 0.8, 0, 0], [0.8, 1, 0.1, 0], [0, 0.1, 1, -0.9], [0, 0, -0.9, 1.0]])


def told(values=VALUES, scale=1.0, at=24.0, names=NAMES, logs=(), plate="A7"):
    covariance = scale**2 * CORRELATED * np.outer(STD, STD)
    whole = Told(NAMES, np.array(values), covariance, UNITS, at, plate, frozenset(logs))
    return whole.only(names)


def test_without_a_change_p_is_even():
    """Of 400 pairs: Kolmogorov-Smirnov against the uniform distribution, which is missed at 0.001 once in
    a thousand."""
    rng = np.random.default_rng(0)
    factor = np.linalg.cholesky(told().covariance)
    draws = VALUES + rng.standard_normal((400, 2, 4)) @ factor.T
    found = [compare_fits(told(a), told(b, scale=1.0)).p for a, b in draws]
    assert kstest(found, "uniform").pvalue > 1e-3
    assert np.mean(np.array(found) < 0.01) < 0.03  # 4 expected of 400; 12 or more once in a thousand


def test_chi_square_and_each_error_are_those_of_the_equations():
    change = compare_fits(told(VALUES + 3 * STD), told(scale=2.0))
    total = (1 + 4) * CORRELATED * np.outer(STD, STD)
    d = 3 * STD
    assert change.chi_square == pytest.approx(d @ np.linalg.inv(total) @ d, rel=1e-9)
    assert change.p == pytest.approx(chi2.sf(change.chi_square, 4), rel=1e-9)
    assert [x.sigmas for x in change.parameters.values()] == pytest.approx([3 / np.sqrt(5)] * 4, rel=1e-6)
    assert change.parameters["tau"].p == pytest.approx(
        0.17971, rel=1e-3
    )  # of 1.3416 normal standard deviations


def test_correlated_errors_show_what_each_alone_hides():
    """G and tau that part against their correlation: neither by three standard deviations, both by much
    more."""
    moved = VALUES + np.array([2, -2, 0, 0]) * np.sqrt(2) * STD
    change = compare_fits(told(moved), told())
    assert (
        max(abs(d.sigmas) for d in change.parameters.values()) < 2.01 and change.changed and change.p < 1e-6
    )
    assert str(change).startswith("the plate has changed (chi-square")


def test_f0_is_compared_at_one_temperature():
    """The same plate, told at 30 degC without k_T, and at 24 degC with it: 60 Hz apart, and no change."""
    warm = told(VALUES + np.array([0, 0, -60.0, 0]), at=30.0, names=("G", "tau", "f0"))
    change = compare_fits(warm, told())
    assert abs(change.parameters["f0"].change) < 1e-9 and not change.changed
    # f0 at 30 degC: 0.1 Hz and 6 degC times 0.04, correlated by -0.9; beside 0.1 Hz of the other
    other = 0.1**2 + 0.24**2 - 2 * 0.9 * 0.1 * 0.24
    assert change.parameters["f0"].std == pytest.approx(np.sqrt(other + 0.1**2), rel=1e-9)
    assert list(change.left_out) == ["k_T"] and "new fit does not determine it" in change.left_out["k_T"]
    back = compare_fits(told(), warm)
    assert back.parameters["f0"].std == pytest.approx(change.parameters["f0"].std, rel=1e-9)
    apart = compare_fits(warm, told(names=("G", "tau", "f0")))
    assert "neither determines k_T" in apart.left_out["f0"] and "f0" not in apart.parameters


def test_what_spoils_a_comparison_is_said():
    shared = compare_fits(told(logs=("a", "b")), told(logs=("b",), plate="B2"))
    assert "share logs" in shared.notes[0] and "two plates, B2 and A7" in shared.notes[1]
    with pytest.raises(ValueError, match="found G in nm/V and in um/V"):
        compare_fits(dataclasses.replace(told(), units=("nm/V", *UNITS[1:])), told())
    nothing = compare_fits(told(names=("G",)), told(names=("tau",)))
    assert (
        not nothing.changed
        and "no parameter in common" in str(nothing)
        and len(repr(nothing).split("\n")) <= 12
    )


@pytest.fixture(scope="module")
def fits(bench):
    """The plate, the same once more, and one whose tau is 1 % longer."""
    other = type(bench)()
    other.plant = reference.Plant(**(PLATE | {"tau": 1.01 * PLATE["tau"]}))
    return [sysid.fit(b.sweep(seed=seed, noise=0.003)) for b, seed in ((bench, 1), (bench, 2), (other, 3))]


def test_a_longer_tau_is_seen_and_nothing_else_is(fits):
    first, again, longer = fits
    assert not compare_fits(again, first).changed
    change = sysid.compare_fits(longer, first)
    assert change.changed and "most of all tau by +" in str(change)
    tau = change.parameters["tau"]
    assert tau.change == pytest.approx(0.01 * PLATE["tau"], abs=4.5 * tau.std) and tau.sigmas > 4
    assert list(change.to_frame().index) == ["G", "tau", "f0"] and change.to_frame().attrs["changed"]
    assert (
        repr(change).startswith("Change: the plate has changed") and change._repr_html_().count("<tr>") == 4
    )


def test_a_file_tells_what_its_fit_tells(fits, tmp_path):
    first, again, _ = fits
    folder = first.save(tmp_path / "first")
    change = compare_fits(again.posterior, first.posterior)
    for old in (folder, folder / "fit.json", json.loads((folder / "fit.json").read_text())):
        assert compare_fits(again.posterior, old).chi_square == pytest.approx(change.chi_square, rel=1e-9)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"parameters": {"G": 3}}'])
def test_a_file_that_is_no_fit_is_refused_by_name(save, text):
    with pytest.raises(ValueError, match=r"old\.json: found no"):
        Told.of(save(text, "old.json"))
    with pytest.raises(ValueError, match=r"absent\.json: cannot be read"):
        Told.of("absent.json")
