"""The rig that a controller will run on: its clock, its limits, and the loop's own sensor. A TOML file:

sample_time_us = 100
latency_us = 100             # from a sample to when its command takes effect; one sample unless stated
voltage_limit_V = 350
bipolar = true               # false: an amplifier that cannot turn its voltage round
voltage_slew_V_per_s = 1e6   # abrupt changes are heard
frequency_step_Hz = 10.4     # what the source can make: multiples of it
thermometer = true           # the loop is told the plate's temperature

[sensor]                     # where the loop's sensor is not that of the logs
gain = 0.98                  # what it shows of one unit of the logs' response
rotation_deg = 3
delay_us = 1
"""

import cmath
import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from controller import scalar
from controller.scalar import NO_LIMIT


class RigError(ValueError):
    """A rig file that is not understood: says the file, the key, what was found and what was expected."""


class Sensor(NamedTuple):
    """The loop's sensor beside that of the logs: it shows `gain` e^{j rotation} W of `delay` s before. `rotation` in degrees."""

    gain: float = 1.0
    rotation: float = 0.0
    delay: float = 0.0

    def correction(self, frequency: float) -> complex:
        """What its reading is multiplied by at a carrier of `frequency` Hz: a delay turns W by -360 f delay degrees."""
        return cmath.exp(1j * (2 * math.pi * frequency * self.delay - math.radians(self.rotation))) / self.gain


class Vector(NamedTuple):
    """Wd and Wq under the names that complex numbers have."""

    real: Any
    imag: Any


class Calibrated(NamedTuple):
    """A controller whose readings are first multiplied by `d` + j `q`, the correction of its sensor."""

    control: Any
    d: float
    q: float

    def init(self) -> Any:
        """As the controller's own."""
        return self.control.init()

    def rest(self) -> Any:
        """As the controller's own."""
        return self.control.rest()

    def step(self, state: Any, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar) -> tuple[Any, Any, Any]:
        """As the controller's own, of the corrected reading."""
        turned = Vector(W.real * self.d - W.imag * self.q, W.real * self.q + W.imag * self.d)
        return self.control.step(state, reference, turned, temperature, xp)


class Rig(NamedTuple):
    """Times in s, the voltage in the drive unit, None: not known, or no limit. `sensor` None: that of the logs."""

    sample_time: float = 1e-4
    latency: float | None = None
    voltage_limit: float | None = None
    bipolar: bool = True
    voltage_slew: float | None = None  # drive unit per s
    frequency_step: float | None = None  # Hz
    thermometer: bool = False
    sensor: Sensor | None = None

    @classmethod
    def from_toml(cls, path: str | Path, drive_unit: str = "V") -> "Rig":
        """The rig of a TOML file, its voltages in `drive_unit`. Raises RigError."""
        try:
            document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise RigError(f"{path}: cannot be read: {error}") from None
        units = {
            "sample_time": "s",
            "latency": "s",
            "voltage_limit": drive_unit,
            "voltage_slew": f"{drive_unit}/s",
            "frequency_step": "Hz",
        }
        read = _Reader(str(path))
        sensor = document.pop("sensor", None)
        if sensor is not None and not isinstance(sensor, dict):
            read.refuse("sensor", sensor, "a table, [sensor]")
        values = read.table("", document, units, ("bipolar", "thermometer"))
        if sensor is not None:
            values["sensor"] = Sensor(**read.table("sensor.", sensor, {"gain": "1", "rotation": "deg", "delay": "s"}, ()))
        rig = cls(**values)
        for name in ("sample_time", "voltage_limit", "voltage_slew", "frequency_step"):
            if (value := getattr(rig, name)) is not None and not value > 0:
                read.refuse(name, value, "a number above zero")
        if rig.latency is not None and rig.latency < 0:
            read.refuse("latency", rig.latency, "zero or more")
        if rig.sensor is not None and not (rig.sensor.gain > 0 and rig.sensor.delay >= 0):
            read.refuse("sensor", tuple(rig.sensor), "a gain above zero and a delay of zero or more")
        return rig

    @property
    def sensor_delay(self) -> float:
        """Seconds by which the loop's sensor is late."""
        return 0.0 if self.sensor is None else self.sensor.delay

    def slew(self, sample_time: float) -> float:
        """The most that the voltage may change in one sample."""
        return NO_LIMIT if self.voltage_slew is None else self.voltage_slew * sample_time


class _Reader:
    """Keys with units, of one file."""

    def __init__(self, path: str):
        self.path = path

    def table(self, prefix: str, values: dict[str, Any], units: dict[str, str], switches: tuple[str, ...]) -> dict[str, Any]:
        from sysid.units import convert, did_you_mean, same_kind

        found: dict[str, Any] = {}
        for key, value in values.items():
            name = next((n for n in units if key == n or key.startswith(f"{n}_")), key)
            if name in found:
                self.refuse(prefix + key, "it twice", "it once")
            if name in switches:
                if not isinstance(value, bool):
                    self.refuse(prefix + key, value, "true or false")
                found[name] = value
                continue
            if name not in units:
                known = (*units, *switches)
                self.refuse(prefix + key, "an unknown key", f"one of {', '.join(known)}{did_you_mean(key, known)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                self.refuse(prefix + key, value, f"a number in {units[name]}")
            unit = key[len(name) + 1 :].replace("_per_", "/") or units[name]
            if unit != units[name] and not same_kind(unit, units[name]):
                self.refuse(prefix + key, f"the unit {unit!r}", f"{units[name]} or another of its kind")
            found[name] = float(value) if unit == units[name] else float(convert(float(value), unit, units[name]))
        return found

    def refuse(self, key: str, found: Any, expected: str) -> None:
        raise RigError(f"{self.path}: {key}: found {found!r}, expected {expected}")
