"""Logs made in Python: what a table, arrays or samples give is what a file of the same columns gives."""

import dataclasses
import doctest

import numpy as np
import pandas as pd
import pytest

import sysid
from sysid import Log, LogError


def same(log, other):
    """All that a fit looks at."""
    for name in ("response", "time", "drive", "frequency", "temperature", "force", "theta"):
        mine, theirs = getattr(log, name), getattr(other, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_array_equal(mine, theirs, name)
    for name in ("kind", "sampling", "response_unit", "drive_unit", "bench", "relative_noise"):
        assert getattr(log, name) == getattr(other, name), name
    return True


COLUMNS = {
    "time_ms": [0.0, 0.1, 0.2, 0.3],
    "voltage_V_rms": [0.0, 50.0, 50.0, 50.0],
    "wd_nm": [0.0, 100.0, 180.0, 250.0],
    "wq_nm": [0.0, 20.0, 35.0, 50.0],
}
CONSTANTS = {
    "plate": "A7",
    "frequency_kHz": 32.3,
    "temperature_degC": 24.0,
    "sampling": "instant",
    "lockin_tau_s": 1e-4,
}


@pytest.mark.parametrize("kind", [dict, pd.DataFrame])
def test_a_table_is_read_as_a_file_of_it(kind, save):
    head = "".join(f"# {key}: {value}\n" for key, value in CONSTANTS.items())
    path = save(head + pd.DataFrame(COLUMNS).to_csv(index=False))
    (read,) = sysid.read_logs(path)
    made = Log.from_frame(kind(COLUMNS), name="step", **CONSTANTS)
    assert same(made, read) and made.name == "step" and made.path == made.sha256 == ""
    assert made.metadata["plate"] == "A7" and made.drive[1] == pytest.approx(50 * np.sqrt(2), rel=1e-15)


@pytest.mark.parametrize("kind", ["sweep", "transient"])
def test_a_log_s_table_is_the_log_again(bench, kind):
    log = getattr(bench, kind)(seed=1)
    assert same(Log.from_frame(log.to_frame(), name=log.name), dataclasses.replace(log, bench=bench_of(log)))


def bench_of(log):
    """What `to_frame` adds: a temperature that nobody read is exact."""
    return {**log.bench, "temperature_std_degC": 0.0}


REFUSED = {
    "a misspelt name": (
        {"time_s": [0, 1], "volage_V": [1, 1], "wd_um": [0, 1], "wq_um": [0, 1]},
        {},
        "voltage_V",
    ),
    "a wrong unit": ({"time_V": [0, 1], "wd_um": [0, 1], "wq_um": [0, 1]}, {}, "time_V"),
    "time going back": (
        {"time_s": [1.0, 0.0], "voltage_V": [1, 1], "wd_um": [0, 1], "wq_um": [0, 1]},
        {},
        "row 2",
    ),
    "two experiments": (
        {"log": ["a", "b"], "frequency_Hz": [1, 2], "w_um": [1, 2]},
        {},
        "found 2 experiments, expected one",
    ),
    "no rows": ({"frequency_Hz": [], "w_um": []}, {}, "without columns of numbers"),
    "a word": ({"frequency_Hz": [1, 2], "w_um": [1, 2]}, {"kind": "stedy"}, "did you mean 'steady'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_log_is_refused_as_a_file_is(case):
    columns, constants, said = REFUSED[case]
    with pytest.raises(LogError, match=said) as refusal:
        Log.from_frame(columns, name="bench 3", **constants)
    assert "bench 3" in str(refusal.value)


def test_arrays_are_a_log_with_constants_spread():
    response = np.array([1 + 1j, 2.0, 1 - 1j])
    log = Log.from_arrays(
        response, frequency=[32200, 32300, 32400], drive=100, temperature=None, kind="steady", name="s"
    )
    assert (
        log.drive.tolist() == [100.0] * 3
        and log.temperature is None
        and log.name == "s"
        and log.kind == "steady"
    )
    assert same(log, Log("s", response, frequency=[32200, 32300, 32400], drive=[100] * 3, kind="steady"))
    with pytest.raises(LogError, match="frequency of shape"):
        Log.from_arrays(response, frequency=[1, 2], drive=100)
    with pytest.raises(TypeError, match="volts"):
        Log.from_arrays(response, volts=3)


RATE, CARRIER = 1e6, 32_300.0


def samples(count=40_000):
    """A plate that follows at once: w = 0.02 um/V of the drive, turned back by a right angle and 0.3 rad."""
    theta = 2 * np.pi * CARRIER * np.arange(count) / RATE
    return 100 * np.cos(theta), 2.0 * np.cos(theta - np.pi / 2 - 0.3)


def test_samples_are_demodulated_as_a_waveform_file_is(save):
    drive, response = samples()
    lines = "".join(f"{a!r},{b!r}\n" for a, b in zip(drive.tolist(), response.tolist(), strict=True))
    path = save(
        f"# kind: waveform\n# sample_rate_Hz: {RATE}\n# temperature_degC: 24\ndrive_V,response_um\n{lines}"
    )
    made = Log.from_waveform(drive, response, RATE, temperature_degC=24)
    assert same(made, sysid.read_logs(path)[0])
    # v = Re[j V e^{j theta}], so that this w is 2 um e^{-0.3 j} in the frame of the drive
    np.testing.assert_allclose(made.response[3:], 2.0 * np.exp(-0.3j), rtol=1e-3)
    assert made.frequency[0] == pytest.approx(CARRIER, rel=1e-6)


def test_samples_in_other_units_and_none_at_all():
    drive, response = samples()
    made = Log.from_waveform(drive, response, RATE, drive_unit="mV", response_unit="nm")
    assert (made.drive_unit, made.response_unit) == ("mV", "nm") and np.max(made.drive) == pytest.approx(
        100, rel=1e-3
    )
    with pytest.raises(LogError, match="shapes"):
        Log.from_waveform(drive, response[:-1], RATE)
    with pytest.raises(LogError, match="probe: found a drive"):
        Log.from_waveform(np.ones(20_000), response[:20_000], RATE, name="probe")


@pytest.mark.parametrize(
    "module", ["sysid.logs.log", "sysid.model.plant", "sysid.verdict.result", "sysid.scene.profile"]
)
def test_examples_in_docstrings_are_true(module):
    import importlib

    found = doctest.testmod(importlib.import_module(module), extraglobs={"np": np, "sysid": sysid})
    assert found.failed == 0 and found.attempted > 0


def test_a_masked_number_is_no_number():
    """Its value was read as if it were there."""
    frequency = np.linspace(32000.0, 32600.0, 61)
    response = 2 / (1 + 2j * np.pi * (frequency - 32300) * 1.67e-3)
    gone = np.arange(61) == 3
    with pytest.raises(LogError, match=r"log, row 3 \(counted from 0\): found response masked"):
        Log.from_arrays(np.ma.masked_array(response, gone), frequency=frequency, drive=100.0)
    with pytest.raises(LogError, match="found temperature masked"):
        Log.from_arrays(response, frequency=frequency, temperature=np.ma.masked_array(frequency, gone))
    columns = {"frequency_Hz": frequency, "wd_um": response.real, "wq_um": response.imag}
    log = Log.from_frame(columns | {"wd_um": np.ma.masked_array(response.real, gone)}, voltage_V=100)
    assert log.response.tolist() == response[~gone].tolist() and "1 of 61 rows left out" in log.notes[0]
    whole = Log.from_arrays(np.ma.masked_array(response), frequency=frequency, drive=100.0)
    assert whole.response.tolist() == response.tolist()
