"""What the bench added to a log is found with its error: rotation, offset, feedthrough, delay, start,
noise."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from conftest import SYNTHETIC

import sysid
from sysid.verdict.bench import nuisances

SEEDS = 40
# tests/conftest.py adds them to every d/q log
ADDED = {"rotation": np.rad2deg(0.3), "offset_d": 0.004, "offset_q": -0.003}
ADDED |= {"feedthrough_d": 1.6e-4, "feedthrough_q": -1.2e-4, "noise": 0.02}


# All but "late": nothing is late here, and what its prior adds to the error of the others would hide what
# theirs is.
EFFECTS = ("rotation", "background", "offset", "start")


def scores(make, truth):
    """(value - truth)/std by name, over SEEDS logs."""
    found = [nuisances(sysid.fit([make(seed)], nuisances=EFFECTS))[0] for seed in range(SEEDS)]
    return {
        name: np.array([(f[name].value - true) / f[name].std for f in found]) for name, true in truth.items()
    }


def unit_normal(z):
    """Mean and spread within three and a half of their own errors: one chance in two thousand each."""
    return abs(z.mean()) < 3.5 / np.sqrt(SEEDS) and abs(z.std(ddof=1) - 1) < 3.5 / np.sqrt(2 * SEEDS)


@pytest.mark.study
def test_of_a_sweep_with_its_plant_known_from_the_same_rows(bench):
    truth = {n: v for n, v in ADDED.items() if n in ("rotation", "noise")}
    # at one drive an offset is part of the background
    truth |= {f"feedthrough_{c}": ADDED[f"feedthrough_{c}"] + ADDED[f"offset_{c}"] / 100.0 for c in "dq"}
    assert {
        n: unit_normal(z) for n, z in scores(lambda seed: bench.sweep(seed=seed), truth).items()
    } == dict.fromkeys(truth, True)


@pytest.mark.study
def test_of_a_step(bench):
    assert {
        n: unit_normal(z) for n, z in scores(lambda seed: bench.transient(seed=seed), ADDED).items()
    } == dict.fromkeys(ADDED, True)


def test_a_step_alone_does_not_tell_a_delay_from_a_feedthrough_and_a_gain(bench):
    delay = nuisances(sysid.fit([bench.transient()]))[0]["delay"]
    assert not delay.determined and delay.value is None and "cannot tell" in delay.why


def test_beside_a_sweep_a_late_trigger_shows(bench):
    log = bench.transient()
    late = replace(log, response=np.append(log.response[:1], log.response[:-1]))
    delay = nuisances(sysid.fit([late, bench.sweep(seed=1)]))[0]["delay"]
    assert abs(delay.value - 1e-4) < 4 * delay.std and delay.std < 5e-5


def test_an_amplitude_log_has_noise_and_delay_alone(bench):
    assert set(nuisances(sysid.fit([bench.transient(amplitude=True)]))[0]) <= {"noise", "delay"}


def test_of_all_logs_of_a_plate_together(joint_fit):
    made = tomllib.loads((SYNTHETIC / "truth.toml").read_text(encoding="utf-8"))["logs"]
    fit, z = joint_fit("plate"), []
    for fitted, found in zip(fit.logs, nuisances(fit), strict=True):
        truth = made[fitted.log.name.removesuffix(".csv")]
        true = {
            "rotation": truth["rotation_deg"],
            **dict(zip(("offset_d", "offset_q"), truth["offset_um"], strict=True)),
        }
        told = ["rotation", *(["offset_d", "offset_q"] if fitted.kind == "transient" else [])]
        z += [] if fitted.log.amplitude_only else [(found[n].value - true[n]) / found[n].std for n in told]
    # 13 angles and 18 offsets: one beyond four of its errors has a chance of one in five hundred; nor are all
    # far within
    assert len(z) == 31 and np.max(np.abs(z)) < 4 and 0.4 < np.std(z) < 1.5
