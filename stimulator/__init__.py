"""The tactile stimulator around an identified plate: plate and modes, air film and friction, the touching
finger and its judge.

It builds on `sysid` and `controller`, which know nothing of it. Nothing is loaded before it is used.
"""

from importlib import import_module

_HOME = {
    "CornerForces": "stimulator.forces",
    "Exponential": "stimulator.friction",
    "Finger": "stimulator.finger",
    "Intensities": "stimulator.experiment",
    "Material": "stimulator.plate",
    "Mode": "stimulator.modal",
    "Modes": "stimulator.modes",
    "Neighbour": "stimulator.modal",
    "Observer": "stimulator.observer",
    "OnMode": "stimulator.finger",
    "Pad": "stimulator.film",
    "PartialLevitation": "stimulator.friction",
    "Patch": "stimulator.plate",
    "Piezo": "stimulator.plate",
    "PlateGeometry": "stimulator.plate",
    "Prior": "stimulator.experiment",
    "RangeWarning": "stimulator.errors",
    "Reynolds": "stimulator.film",
    "StimulatorError": "stimulator.errors",
    "Stroke": "stimulator.stroke",
    "Touch": "stimulator.touch",
    "TouchScene": "stimulator.touch",
    "film_pressure": "stimulator.film",
    "neighbours": "stimulator.finger",
    "overpressure": "stimulator.film",
    "plateau_contrast": "stimulator.contrast",
    "predicted": "stimulator.experiment",
    "run_all": "stimulator.touch",
    "spectral_contrast": "stimulator.contrast",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'stimulator' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
