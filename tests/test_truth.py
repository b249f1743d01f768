"""Every bundled log against its truth: each by itself and all of a folder together."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import sysid

DATA = Path(__file__).parents[1] / "data" / "synthetic"
FOLDERS = {"plate": DATA, "quartz": DATA / "quartz", "low_q": DATA / "low_q"}
PER_UM = {"um": 1.0, "nm": 1e3}


def truth(folder: Path, fit: sysid.Fit) -> dict[str, float]:
    """The folder's truth in the units and at the temperature of the fit."""
    plant = tomllib.loads((folder / "truth.toml").read_text())["plant"]
    unit = fit.units["G"].split("/")[0]
    at = plant["reference_temperature_degC"] if fit.reference_temperature is None else fit.reference_temperature
    return {
        "G": plant["G"] * PER_UM[unit],
        "tau": plant["tau"],
        "f0": plant["f0"] + plant["k_T"] * (at - plant["reference_temperature_degC"]),
        "k_T": plant["k_T"],
    }


def pulls(folder: Path, fit: sysid.Fit) -> dict[str, float]:
    """(value - truth)/std of each parameter that is determined."""
    true = truth(folder, fit)
    return {n: (p.value - true[n]) / p.std for n, p in fit.parameters.items() if p.determined}


@pytest.fixture(scope="module")
def joint() -> dict[str, sysid.Fit]:
    return {name: sysid.fit(sysid.read_logs(sorted(folder.glob("*.csv")))) for name, folder in FOLDERS.items()}


@pytest.fixture(scope="module")
def single() -> list[tuple[Path, sysid.Fit]]:
    paths = [path for folder in FOLDERS.values() for path in sorted(folder.glob("*.csv"))]
    return [(path.parent, sysid.fit(sysid.read_logs([path]))) for path in paths]


def test_all_logs_of_a_folder_together(joint):
    for name, fit in joint.items():
        assert fit.result is sysid.Result.successful, name
        expected = {"G", "tau", "f0"} | ({"k_T"} if name != "low_q" else set())
        assert {n for n, p in fit.parameters.items() if p.determined} == expected
    found = [z for name, fit in joint.items() for z in pulls(FOLDERS[name], fit).values()]
    assert np.max(np.abs(found)) < 4.5
    # Parameters of one fit are correlated, but less than wholly; 11 of them as one chi-square errs on the strict side.
    assert stats.chi2.sf(np.sum(np.square(found)), len(found)) > 1e-3


def test_every_log_by_itself(single):
    found = [z for folder, fit in single for z in pulls(folder, fit).values()]
    assert len(found) > 40
    assert np.max(np.abs(found)) < 4.5
    # Different logs have independent noise; within a log G, tau and f0 are correlated by 0.9 at most.
    assert stats.kstest(found, "norm").pvalue > 1e-3


def test_joint_errors_are_smaller_than_those_of_any_log(joint, single):
    best = min(fit.parameters["tau"].std for folder, fit in single if folder == DATA and fit.parameters["tau"].determined)
    assert joint["plate"].parameters["tau"].std < best


def test_one_temperature_is_named(single):
    fit = next(fit for _, fit in single if fit.logs[0].log.name == "sweep_28C.csv")
    assert "one temperature" in fit.parameters["k_T"].why
    assert fit.reference_temperature == pytest.approx(28.0)


def test_the_posterior_agrees_with_the_fit_and_its_seed_is_true(joint):
    fit = joint["quartz"]
    first, again, other = sysid.sample(fit, seed=1), sysid.sample(fit, seed=1), sysid.sample(fit, seed=2)
    assert first.result is sysid.Result.successful
    for name, draws in first.draws.items():
        np.testing.assert_array_equal(draws, again.draws[name])
        assert np.any(draws != other.draws[name])
        p = fit.parameters[name]
        # 400 effective draws: the mean is known to 5 % of a standard deviation, the standard deviation to 3.5 %; four times that
        assert abs(draws.mean() - p.value) < 0.2 * p.std
        assert abs(draws.std() / p.std - 1) < 0.15


def test_a_timed_sweep_backwards_gives_the_same_resonance():
    (log,) = sysid.read_logs([DATA / "timed_sweep.csv"])
    back = sysid.Log(
        name="back.csv",
        response=log.response[::-1],
        time=log.time,
        drive=log.drive[::-1],
        frequency=log.frequency[::-1],
        temperature=log.temperature[::-1],
    )
    forth = sysid.fit([log])
    turned = sysid.fit([back])
    assert forth.logs[0].kind == turned.logs[0].kind == "steady"
    # settled points have no order: only rounding is left
    assert abs(forth.plant.f0 - turned.plant.f0) < 1e-3 * forth.parameters["f0"].std


def test_fits_repeat_and_leave_the_logs_alone():
    (log,) = sysid.read_logs([DATA / "sweep_24C.csv"])
    before = log.response.copy()
    a, b = sysid.fit([log]), sysid.fit([log])
    assert a.plant == b.plant
    np.testing.assert_array_equal(log.response, before)
