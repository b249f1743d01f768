"""The example for a Cortex-M4F, built and run in an emulator: the exported C in two interrupts, its record,
its instructions."""

import csv
import io
import re
from types import SimpleNamespace

import emulator
import numpy as np
import pytest

import controller

UNITS = {"units": {"G": "um/V"}}
PLATE = SimpleNamespace(G=0.02, tau=1.669e-3, f0=32300.0, k_T=-10.16, **UNITS)
ASKED = 1.8


@pytest.fixture(scope="module")
def loop():
    rig = controller.Rig.from_toml(emulator.EXAMPLE / "rig.toml")
    return controller.design(PLATE, voltage_limit=160.0, amplitude=ASKED, rig=rig)


@pytest.fixture(scope="module")
def target(loop, tmp_path_factory):
    """The folder of the built example."""
    if (why := emulator.missing()) is not None:
        pytest.skip(why)
    folder = emulator.exported(loop, tmp_path_factory.mktemp("target"))
    emulator.made(folder, "all")
    return folder


@pytest.fixture(scope="module")
def record(target):
    return emulator.made(target, "run")


@pytest.fixture(scope="module")
def rows(record):
    """{column: (600,)}."""
    table = list(csv.DictReader(line for line in io.StringIO(record) if not line.startswith("#")))
    return {name: np.array([float(row[name]) for row in table]) for name in table[0]}


def said(record, name):
    """A number of the record's metadata."""
    return int(re.search(rf"^# {name}: (\d+)$", record, re.MULTILINE)[1])


def test_the_loop_starts_and_holds_the_amplitude(record, rows):
    assert (said(record, "mode"), said(record, "fault")) == (4, 0)
    last = {name: values[-100:] for name, values in rows.items()}
    # rounding of the 12 bits: 1/4 of 2.4 nm, through a filter over tens of samples
    np.testing.assert_allclose(last["wd_um"].mean(), ASKED, rtol=2e-3)
    # half a hold of 1/16.1 period that was not counted would settle 19 Hz beside
    assert abs(last["frequency_Hz"].mean() - PLATE.f0) < 0.5


def test_the_record_is_that_of_a_plate_under_its_voltage(loop, rows):
    """By the envelope W' = -W/tau + G/tau V, seen a delay later: no interrupt was lost, and rows and
    commands are those of one another. The filters round the corners of the delay: by half of it, times
    the steepest rise."""
    T, keep = loop.sample_time, np.exp(-loop.sample_time / loop.tau)
    held = loop.G * np.sinc(loop.f0 / loop.rig.adc.rate)  # of a sine that is held from sample to sample
    W = np.zeros(len(rows["voltage_V"]) + 1)
    for k, volts in enumerate(rows["voltage_V"]):
        W[k + 1] = W[k] * keep + held * volts * (1 - keep)
    seen = np.interp(rows["time_s"] - loop.demodulator.delay, rows["time_s"], W[:-1])
    steepest = np.abs(np.diff(W)).max() / T
    np.testing.assert_allclose(rows["wd_um"], seen, rtol=0, atol=0.5 * loop.demodulator.delay * steepest)


def test_the_record_is_what_check_reads(loop, record, save):
    import sysid
    from controller.check import check
    from controller.document import as_dict

    log = sysid.read_logs([save(record, "start.csv")])[0]
    assert [f for f in check(as_dict(loop), log) if not f.kept] == []


def test_instructions_fit_the_processor(loop, target):
    """At 168 MHz and one instruction in a cycle or two: half of the time of a sample, a tenth of that of a
    step."""
    rows = {row["function"]: row for row in csv.DictReader(io.StringIO(emulator.made(target, "count")))}
    assert int(rows["dq_demodulate"]["most"]) < 168e6 / loop.rig.adc.rate / 2
    assert int(rows["dq_step"]["most"]) < 168e6 * 1e-4 / 10


def test_the_stack_is_small(record):
    # a quarter of what the linker sets aside: two interrupts, one within the other, each with its
    # floating-point registers
    assert said(record, "stack_bytes") < 2000
