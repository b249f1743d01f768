"""python-control's own analysis of the exported systems against the margins, the steps and the plant of this
package."""

import dataclasses
import math

import numpy as np
import pytest
from conftest import study

import controller
from controller.interop import loop_systems, plant_system
from sysid import Plant

control = pytest.importorskip("control")
PLATE = Plant(0.02, 5e-3 / math.log(20), 32300.0, -10.16)
LOOPS = [{}, study({"latency": 2.5e-4}), study({"method": "adaptive"})]


@pytest.mark.parametrize("changes", LOOPS, ids=str)
def test_margins_are_those_that_are_promised(changes):
    loop = controller.design(PLATE, voltage_limit=160.0, frequency_window=(31800.0, 32800.0), **changes)
    law, plant = loop_systems(loop)
    omega = np.geomspace(10.0, math.pi / loop.sample_time, 20001)
    gain, phase, *_ = control.margin(control.frd(law * plant, omega))
    # the promise's are read off 400 frequencies, on straight lines
    assert loop.promise.phase == pytest.approx(phase, rel=1e-2)
    if math.isfinite(gain) and loop.method != "adaptive":
        assert loop.promise.gain == pytest.approx(gain, rel=5e-3)
    for share, stable in ((0.99, True), (1.01, False)):
        law, plant = loop_systems(loop, share * loop.promise.gain)
        assert (np.max(np.abs(control.feedback(law * plant, 1).poles())) < 1) == stable


def test_without_delay_the_open_loop_is_an_integrator():
    loop = dataclasses.replace(
        controller.design(PLATE, voltage_limit=160.0, latency=0.0), f0=None
    )  # and no demodulator
    law, plant = loop_systems(loop)
    K, z = (
        -math.expm1(-2 * math.pi * loop.bandwidth_hz * loop.sample_time),
        np.exp(1j * np.array([0.01, 0.3, 2.0, np.pi])),
    )
    assert np.max(np.abs((law * plant)(z) * (z - 1) / K - 1)) < 1e-9


def test_the_closed_loop_settles_as_promised():
    loop = controller.design(
        PLATE, voltage_limit=1e4, amplitude=1.0, bandwidth_hz=300.0
    )  # stated: nothing is fed forward
    law, plant = loop_systems(loop)
    t, W = control.step_response(control.feedback(law * plant, 1), T=np.arange(200) * loop.sample_time)
    late = np.flatnonzero(np.abs(W - 1.0) > 0.05)[-1] + 1
    # python-control's plant answers late, the promise's at once, and a late reading of it is what is
    # controlled
    assert 0 <= t[late] - loop.promise.settling <= 1.01 * loop.sample_time


def test_the_plant_is_that_of_the_package():
    time = np.linspace(0.0, 8e-3, 81)
    system = plant_system(PLATE, frequency=32350.0, temperature=20.0)
    _, (Wd, Wq) = control.forced_response(system, T=time, inputs=np.full(81, 100.0))
    expected = PLATE.transient(time, np.full(81, 100.0), np.full(81, 32350.0), np.full(81, 20.0))
    # the package's has the ripple at twice the carrier besides, G V/(2 Q)
    assert np.max(np.abs(Wd + 1j * Wq - expected)) < 1.01 * 2.0 / (2 * PLATE.Q)
    assert np.max(np.abs(np.squeeze(plant_system(PLATE).dcgain()) - [0.02, 0.0])) < 1e-15
