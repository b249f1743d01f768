"""Plant and loop as objects of python-control (the extra `control`), for its own analysis and plots.

The plant driven at one frequency is, in its slowly varying frame,

    Wd' = -Wd/tau - delta Wq + (G/tau) V,    Wq' = delta Wd - Wq/tau,    delta = 2 pi (f0 + k_T (T - T0) - f).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from controller.design import Loop
from controller.ensemble import Ensemble
from controller.margins import held, linearised
from sysid.asked import LOOP, given


class Systems(NamedTuple):
    """Discrete systems of one sample time: `controller`, from the amplitude's error to the voltage; `plant`,
    from the voltage, with the whole delay, to Wd at resonance. `controller * plant` is the open loop."""

    controller: Any
    plant: Any


def plant_system(plant: Any, frequency: float | None = None, temperature: float | None = None) -> Any:
    """control.StateSpace from V (drive unit) to Wd, Wq (response unit) of a `sysid.Plant`, driven at
    `frequency` Hz (None: at resonance) and at `temperature` degC (None: its reference temperature)."""
    import control

    shift = 0.0 if temperature is None else (plant.k_T or 0.0) * (temperature - plant.reference_temperature)
    delta = 0.0 if frequency is None else 2 * math.pi * (plant.f0 + shift - frequency)
    A = [[-1 / plant.tau, -delta], [delta, -1 / plant.tau]]
    B = [[plant.G / plant.tau], [0.0]]
    return control.ss(A, B, np.eye(2), np.zeros((2, 1)), inputs=["V"], outputs=["Wd", "Wq"], name="plant")


def loop_systems(loop: Loop, gain: float = 1.0) -> Systems:
    """The amplitude loop of a design about its settled state, without limits, and without what it feeds
    forward, with a plate of `gain` times its G: an observer then learns another damping."""
    import control

    given("loop", loop, Loop, LOOP)
    T = loop.sample_time
    A, B, C, D = (m[0] for m in linearised(loop.law, np.array([T / loop.tau]), gain))
    law = control.ss(
        A, B[:, None], -C[None, :], [[-D]], T, inputs=["error"], outputs=["V"], name="controller"
    )
    one = Ensemble(np.array([gain * loop.G / loop.tau]), np.array([1 / loop.tau]), np.zeros(1))
    (g0,), (g1,), (alpha,), whole = held(one, T, loop.delay)
    within = abs(g1) > 1e-9 * abs(g0)  # a command takes effect within a sample
    delayed = control.tf([g0, g1][: 1 + within], [1.0, -alpha, *[0.0] * (whole + within)], T)
    return Systems(law, control.ss(delayed, inputs=["V"], outputs=["Wd"], name="plant"))
