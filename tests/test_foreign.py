"""Files as other programs write them whose tables lie otherwise than a row a line, each from a plate in closed form."""

import numpy as np
import pytest
from refusal import refused

from sysid.logs.read import read_logs

TIME = 1e-4 * np.arange(60)
DRIVE = np.where(TIME > 0.00105, 50.0, 0.0)
STEP = 1.0 - np.exp(-np.clip(TIME - 0.0011, 0, None) / 1.67e-3) + 1e-4j * np.cos(1e4 * TIME)


def rows(*columns, mark=","):
    return "".join(mark.join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def step(stamps, name="time_us"):
    return f"{name},voltage_V,wd_um,wq_um\n" + rows(stamps, DRIVE, STEP.real, STEP.imag)


# A clock of 32 bits


@pytest.mark.parametrize("name, scale, begin", [("time_us", 1, 0), ("time_ms", 1e-3, 0), ("time_s", 1e-6, -(2**31))])
@pytest.mark.parametrize("start", [2**32 - 2500, 3 * 2**31 - 1000])
def test_a_counter_of_microseconds_goes_on_past_its_end(save, name, scale, begin, start):
    """As micros() is printed after 71.6 minutes, also as a number with a sign."""
    counts = (start + 100 * np.arange(60) - begin) % 2**32 + begin
    (log,) = read_logs(save(step([f"{scale * count:.6f}" for count in counts], name)))
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-9)
    assert ("a clock of 32 bits" in " ".join(log.notes)) == (np.diff(counts) < 0).any()


@pytest.mark.parametrize("change", [-5000, 700, -3e6])
def test_another_jump_back_is_no_end_of_a_counter(save, change):
    """By less than a turn and a step, or by more."""
    counts = (2**32 - 2500 + 100.0 * np.arange(60)) % 2**32
    counts[counts < 2**31] += change
    refused(save(step([*map(int, counts)])), "line 27", "expected a time not below the one before")
