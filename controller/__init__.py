"""The controller of an identified plate: gains from the fit, the steps a DSP runs, their export. Needs no JAX."""

from controller.design import Loop, design
from controller.export import as_dict, export_c
from controller.pi import PI
from controller.tracker import Tracker

__all__ = ["PI", "Loop", "Tracker", "as_dict", "design", "export_c"]
