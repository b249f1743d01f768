"""What is exported, in Python, at many simulated plates side by side: each is wired as it should be, or
not."""

import numpy as np
from replay import array_of, full

TAU, T, F0, G = 1.6690410034766704e-3, 1e-4, 32300.0, 0.02
AT = 1500  # the sample at which what is wrong in run begins


class Lane:
    """A plate and its wiring: `polarity` and `gain` of the sensor, its `rotation` in degrees; the plate's `G`
    and `f0` over, and beside, those of the design; `clip`: largest |W| that the sensor shows; `spoil` changes
    the reading of sample k. `at`: the sample from which on it is so."""

    def __init__(self, gain=1.0, rotation=0.0, G=1.0, f0=0.0, clip=np.inf, spoil=None, at=0):
        self.gain, self.rotation, self.G, self.f0, self.clip, self.spoil, self.at = (
            gain,
            rotation,
            G,
            f0,
            clip,
            spoil,
            at,
        )


def play(loop, lanes, samples, asked, noise=0.004, late=0.53, **knobs):
    """Records (samples, lanes) of V, f, mode, fault, |W|, by name. A command takes effect a sample later; a
    reading is `late`."""
    rng, count, xp = np.random.default_rng(0), len(lanes), array_of(np.float64)
    machine, state = loop.machine, full(loop.machine.init(), len(lanes), float)
    Z, before = np.zeros(count, complex), np.zeros(count, complex)
    voltage, frequency = np.zeros(count), np.full(count, F0)
    rows = {name: np.zeros((samples, count)) for name in ("V", "f", "mode", "fault", "W")}
    rows["told"] = np.zeros((samples, count), complex)
    knobs = {"enable": True, "reset": False} | knobs
    for k in range(samples):
        there = np.array([k >= lane.at for lane in lanes])
        turn = np.where(there, [lane.gain * np.exp(1j * np.deg2rad(lane.rotation)) for lane in lanes], 1.0)
        told = (
            Z + late * (before - Z) + noise * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
        ) * turn
        size = np.abs(told)
        most = np.where(there, [lane.clip for lane in lanes], np.inf)
        told = told * np.minimum(most / np.maximum(size, 1e-12), 1.0)
        for n, lane in enumerate(lanes):
            if lane.spoil is not None and k >= lane.at:
                told[n] = lane.spoil(told[n], k)
        now = {name: value(k) if callable(value) else value for name, value in knobs.items()}
        given = {name: np.full(count, v) for name, v in now.items() if name != "temperature"}
        wanted = np.full(count, asked(k) if callable(asked) else asked)
        state, command, said = machine.step(state, wanted, told, now.get("temperature"), xp, **given)
        gains = np.where(there, [lane.G for lane in lanes], 1.0)
        before = Z
        pole = -1 / TAU + 2j * np.pi * (F0 + np.where(there, [lane.f0 for lane in lanes], 0.0) - frequency)
        settled = -G * gains / TAU * voltage / pole
        Z = settled + (Z - settled) * np.exp(pole * T)
        voltage, frequency = command
        for name, value in zip(rows, (*command, said.mode, said.fault, np.abs(Z), told), strict=True):
            rows[name][k] = value
    return rows
