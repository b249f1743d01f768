"""The plate as a design sees it: means, and how far the posterior spreads them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sysid.asked import number, refuse
from sysid.columns.metadata import stated


class Known(NamedTuple):
    """A parameter of a bare plant, in the form that a fit and a posterior give theirs."""

    value: float | None
    determined: bool
    why: str | None


@dataclass(frozen=True)
class Plate:
    """The plate of a design: means, and how far the posterior spreads G/tau upwards (99 %)."""

    G: float
    tau: float
    f0: float | None
    k_T: float | None
    spread: float
    source: Any
    fit: Any
    why: str  # no f0
    finger: Known  # what one of 1.5 N adds to the damping, in units of the plate's own
    name: str | None  # as the logs have it

    @property
    def half_bandwidth(self) -> float:
        """Hz, beside the resonance, at which |Wq| = |Wd|."""
        return 1 / (2 * math.pi * self.tau)

    @property
    def means(self) -> dict[str, float]:
        """The parameters that are known, by name."""
        values = {"G": self.G, "tau": self.tau, "f0": self.f0, "k_T": self.k_T}
        return {name: value for name, value in values.items() if value is not None}


def plate_of(source: Any) -> Plate:
    """The plate of a posterior, a fit or a plant. Raises ValueError without a G or tau to make a loop for."""
    parameters, fit = _read(source)
    G, tau = _needed(parameters, "G"), _needed(parameters, "tau")
    if G == 0.0 or tau <= 0.0:
        raise ValueError(f"no controller: a plant with G = {G:g} and tau = {tau:g} s cannot be controlled")
    f0, why = _value(parameters, "f0")
    draws = getattr(source, "draws", {})
    spread = 1.0
    if "G" in draws and "tau" in draws:
        spread = max(float(np.quantile(np.ravel(draws["G"]) / np.ravel(draws["tau"]), 0.99)) / (G / tau), 1.0)
    touched, unknown = _value(parameters, "finger_damping")
    finger = Known(touched, touched is not None, unknown)
    return Plate(G, tau, f0, _value(parameters, "k_T")[0], spread, source, fit, why, finger, _name(fit))


def _read(source: Any) -> tuple[Mapping[str, Any], Any]:
    """The parameters by name, and the object that knows units and reference temperature."""
    if hasattr(source, "summary"):
        # A posterior may name only what was sampled; for the rest the fit says why.
        return {**source.fit.parameters, **source.summary()}, source.fit
    if hasattr(source, "parameters"):
        return source.parameters, source
    if not hasattr(source, "G") and not hasattr(source, "tau"):
        refuse("source", source, "a posterior, a fit, or a plant with G, tau and f0")
    values = ((name, getattr(source, name, None)) for name in ("G", "tau", "f0", "k_T"))
    return {name: Known(v, v is not None, f"the plant has no {name}") for name, v in values}, source


def _value(parameters: Mapping[str, Any], name: str) -> tuple[float | None, str]:
    """The value, None when not determined, and then why."""
    p = parameters.get(name, Known(None, False, "the fit does not have it"))
    if p.determined and p.value is not None and math.isfinite(p.value):
        return float(p.value), ""
    return None, f"{name} is not determined: {p.why or 'the fit gives no reason'}"


def _name(fit: Any) -> str | None:
    """The plate that the logs name, which is one."""
    metadata = (getattr(fitted.log, "metadata", {}) for fitted in getattr(fit, "logs", ()))
    return next((name for m in metadata if (name := stated(m, "plate"))), None)


def _needed(parameters: Mapping[str, Any], name: str) -> float:
    value, why = _value(parameters, name)
    if value is None:
        raise ValueError(f"no controller: {why}")
    return value


def units_of(fit: Any) -> tuple[str | None, str | None]:
    """Response and drive unit, None when not stated: "m/s/V" is m/s per V."""
    response, slash, drive = getattr(fit, "units", {}).get("G", "").rpartition("/")
    return (response, drive) if slash else (None, None)


def positive(name: str, value: float) -> float:
    """The value as a float. Raises ValueError, with its `name`, where it is not finite and above zero,
    TypeError where it is no number."""
    value = number(name, value)
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value:g} must be a finite number above 0")
    return float(value)
