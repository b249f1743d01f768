"""The controller of an identified plate: gains from the fit, the steps a DSP runs, their export, and the
closed loop.

Only the closed loop needs JAX; it is loaded when it is first used.
"""

from importlib import import_module

from controller.adaptive import Adaptive
from controller.demodulator import Demodulator
from controller.design import Loop, design
from controller.document import as_dict
from controller.dq import DQ, Command
from controller.export import export_c
from controller.guard import Guard
from controller.machine import Machine
from controller.pi import PI
from controller.rig import Rig, RigError, Sensor
from controller.tracker import PLL, SignTracker, Tracker

_LATER = {name: "controller.loop" for name in ("closed_loop", "closed_loops")}
_LATER |= {name: "controller.trace" for name in ("Trace", "settling_time")}
_LATER |= {name: "controller.interop" for name in ("loop_systems", "plant_system")}
__all__ = [
    "DQ", "PI", "PLL", "Adaptive", "Command", "Demodulator", "Guard", "Loop", "Machine", "Rig", "RigError",
    "Sensor", "SignTracker", "Trace", "Tracker",
    "as_dict", "closed_loop", "closed_loops", "design", "export_c", "loop_systems", "plant_system",
    "settling_time",
]  # fmt: skip


def __getattr__(name: str):
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module 'controller' has no attribute {name!r}")
