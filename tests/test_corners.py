"""A short version of the study benchmarks/corners.py: finite, and right to rounding, where numbers are at their ends."""

import importlib.util
from pathlib import Path

import jax
import numpy as np
import pytest

STUDY = Path(__file__).parents[1] / "benchmarks" / "corners.py"
SAMPLE = 12
# Each of some ten operations rounds by half an eps, and so do the sine, the cosine and the exponential.
ROUNDINGS = 16.0


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("corners_study", STUDY)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_values_and_derivatives_are_finite(study):
    with jax.enable_x64(True):
        for name, (values, slopes) in study.finite(study.corners(500, seed=1)).items():
            assert values.all() and slopes.all(), name


def test_values_are_those_of_sixty_digits(study):
    corners = study.corners(500, seed=1)
    with jax.enable_x64(True):
        found = [study.errors(corners, k) for k in range(SAMPLE)]
    for name in found[0]:
        worst = int(np.argmax([errors[name] for errors in found]))
        assert found[worst][name] < ROUNDINGS, (name, worst)
