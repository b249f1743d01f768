"""The rig that a controller will run on: its clock, its limits, and the loop's own sensor. A TOML file:

sample_time_us = 100
latency_us = 100             # from a sample to when its command takes effect; one sample unless stated
voltage_limit_V = 350        # the logs' largest drive is a limit as well, of what the plate is known for: the
                             # smaller holds
bipolar = true               # false: an amplifier that cannot turn its voltage round
voltage_slew_V_per_s = 1e6   # abrupt changes are heard
tracker_period_ms = 1        # the shortest time between two updates of the frequency
timer_MHz = 100              # what makes it: a timer that counts whole ticks; or dds_MHz, the clock of an
                             # accumulator of 32 bits; or frequency_step_Hz, multiples of it
thermometer = true           # the loop is told the plate's temperature
coldest_degC = 14            # the plate's temperatures that the promise has to hold for; unless stated the
                             # logs' reference alone
warmest_degC = 39
lowest_frequency_kHz = 31.8  # the tracker's window; unless stated, half a bandwidth beyond what the logs were
                             # driven at
highest_frequency_kHz = 32.6
force_N = 1.5                # the hardest press, by the fit's finger_damping; or finger = 1, what it adds to
                             # the damping, in units of the plate's own; unless stated none
arithmetic = "single"        # of the exported C: single, or double
drive_update_MHz = 0.5       # how often the drive's own samples are put out: held in between it is late by
                             # half of that time, 11 degrees of 32 kHz at 0.5 MHz; unless stated it is as fine
                             # as if it were continuous
method = "pi"                # pi, paper, pll or adaptive
amplitude_um = 2             # the largest that will be asked for
settling_ms = 1.5            # to 5 %, to be kept by 99 % of the plates that the logs allow

[adc]                        # of the loop's sensor; its samples are what the exported demodulator takes
bits = 12
full_scale = 5               # in what the sensor shows, for 2^(bits-1) counts
rate_MHz = 1

[dac]                        # the peak voltage as a code
bits = 12
full_scale_V = 400

[inverter]                   # the voltage as a duty ratio
supply_V = 300
law = "sine"                 # V = (4/pi) supply sin(pi duty/2); or "linear", V = supply duty

[sensor]                     # where the loop's sensor is not that of the logs
gain = 0.98                  # what it shows of one unit of the logs' response
rotation_deg = 3
delay_us = 1
gain_error = 0.01            # standard deviations: of the gain, and of the whole angle at the carrier
angle_error_deg = 0.5
calibration = "both.csv"     # or instead of these a log of both sensors at once: see
                             # controller/calibration.py
"""

import cmath
import math
import tomllib
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, get_args

from controller import scalar
from controller.actuator import Adc, Dac, Inverter
from controller.demodulator import SAMPLES, Demodulator
from controller.scalar import NO_LIMIT
from controller.source import Multiples, Source, Timer

Method = Literal["pi", "paper", "pll", "adaptive"]
METHODS = get_args(Method)
FLAG = (True, False)
# What a key may be one of.
WORDS = {"bipolar": FLAG, "thermometer": FLAG, "arithmetic": ("single", "double"), "method": METHODS}
# Numbers of a rig in units of their own; the voltages and the amplitude are in the logs'.
UNITS = dict.fromkeys(("sample_time", "latency", "tracker_period", "settling"), "s")
UNITS |= dict.fromkeys(("frequency_step", "timer", "dds", "drive_update"), "Hz")
UNITS |= dict.fromkeys(("lowest_frequency", "highest_frequency"), "Hz")
UNITS |= {"coldest": "degC", "warmest": "degC", "force": "N", "finger": "1"}
SENSOR = {"gain": "1", "rotation": "deg", "delay": "s", "gain_error": "1", "angle_error": "deg"}
# Parts of a rig that are tables of their own, with the units of their keys, of which none may be missing, and
# their words: "" is the drive's.
TABLES: dict[str, tuple[Any, dict[str, str], dict[str, Any]]] = {
    "adc": (Adc, {"bits": "1", "full_scale": "1", "rate": "Hz"}, {}),
    "dac": (Dac, {"bits": "1", "full_scale": ""}, {}),
    "inverter": (
        lambda supply, law="linear": Inverter(supply, law == "sine"), {"supply": ""},
        {"law": ("linear", "sine")},
    ),
}  # fmt: skip
ANY_SIGN = ("coldest", "warmest", "rotation", "gain_error", "angle_error")
OR_ZERO = ("latency", "force", "finger", "delay")  # the others are above zero


class RigError(ValueError):
    """A rig file that is not understood: says the file, the key, what was found and what was expected."""


class Sensor(NamedTuple):
    """The loop's sensor beside that of the logs: it shows `gain` e^{j rotation} W of `delay` s before.
    `rotation` in degrees.

    Standard deviations: `gain_error`, and `angle_error`, degrees, of the whole angle at the carrier, in which
    errors of rotation and delay make up for each other."""

    gain: float = 1.0
    rotation: float = 0.0
    delay: float = 0.0
    gain_error: float = 0.0
    angle_error: float = 0.0

    def correction(self, frequency: float, hold: float = 0.0) -> complex:
        """What its reading is multiplied by at a carrier of `frequency` Hz: a delay turns W by -360 f delay
        degrees, and so does the drive's, `hold` s."""
        angle = 2 * math.pi * frequency * (self.delay + hold) - math.radians(self.rotation)
        return cmath.exp(1j * angle) / self.gain


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

    def step(
        self, state: Any, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar, **knobs: Any
    ) -> tuple[Any, Any, Any]:
        """As the controller's own, of the corrected reading."""
        turned = Vector(W.real * self.d - W.imag * self.q, W.real * self.q + W.imag * self.d)
        return self.control.step(state, reference, turned, temperature, xp, **knobs)


class Rig(NamedTuple):
    """Times in s, the voltage in the drive unit, None: not known, or no limit. `sensor` None: that of the
    logs. Of `frequency_step` (Hz), `timer` and `dds` (clocks, Hz) one at most."""

    sample_time: float = 1e-4
    latency: float | None = None
    voltage_limit: float | None = None
    bipolar: bool = True
    voltage_slew: float | None = None  # drive unit per s
    frequency_step: float | None = None
    thermometer: bool = False
    sensor: Sensor | None = None
    tracker_period: float = 1e-3
    timer: float | None = None
    dds: float | None = None
    adc: Adc | None = None
    dac: Dac | None = None
    inverter: Inverter | None = None
    arithmetic: str = "single"
    coldest: float | None = None  # degC
    warmest: float | None = None
    lowest_frequency: float | None = None
    highest_frequency: float | None = None
    force: float | None = None  # N
    finger: float | None = None
    drive_update: float | None = None  # Hz
    method: str | None = None
    amplitude: float | None = None  # response unit
    settling: float | None = None

    @classmethod
    def from_toml(cls, path: str | Path, drive_unit: str = "V", response_unit: str = "um") -> "Rig":
        """The rig of a TOML file, its voltages in `drive_unit`. Raises RigError."""
        try:
            document = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise RigError(f"{path}: cannot be read: {error}") from None
        read = _Reader(Path(path))
        parts = {name: read.part(document, name) for name in ("sensor", *TABLES)}
        units = UNITS | {"voltage_limit": drive_unit, "voltage_slew": f"{drive_unit}/s"}
        values = read.table("", document, units | {"amplitude": response_unit}, WORDS)
        if parts["sensor"] is not None:
            values["sensor"] = read.sensor(parts["sensor"])
        for name, (make, keys, words) in TABLES.items():
            if (table := parts[name]) is not None:
                keys = {key: unit or drive_unit for key, unit in keys.items()}
                found = read.table(f"{name}.", table, keys, words)
                for key in keys:
                    read.suits(f"{name}.", key, found.get(key))
                values[name] = make(**found)
        read.agree(values)
        return cls(**values)

    def source(self, start: float) -> Source | None:
        """The frequencies that can be made, near `start` Hz; None: any (a synthesiser's are so fine)."""
        if self.timer is not None:
            return Timer.of(self.timer, start)
        return None if self.frequency_step is None else Multiples.of(self.frequency_step, start)

    def delay(self, f0: float | None) -> float:
        """Seconds by which a reading is late: the drive's hold, the sensor, the exported demodulator."""
        return self.late if f0 is None else self.late + self.demodulator(f0, 1.0).delay

    @property
    def late(self) -> float:
        """The same without the demodulator."""
        return self.hold + self.shown.delay

    @property
    def shown(self) -> Sensor:
        """The loop's sensor beside that of the logs, or that one."""
        return self.sensor or Sensor()

    @property
    def hold(self) -> float:
        """Seconds by which a drive that is held from one of its own samples to the next is late."""
        return 0.0 if self.drive_update is None else 0.5 / self.drive_update

    def demodulator(self, f0: float, sample_time: float) -> Demodulator:
        """What gives Wd and Wq, missing when all samples of a controller step are. Raises ValueError."""
        adc = self.adc
        rate = SAMPLES * f0 if adc is None else adc.rate
        patience = max(1.0, math.ceil(rate * sample_time))
        if adc is None:
            return Demodulator.of(rate, f0, patience)
        return Demodulator.of(rate, f0, patience, adc.unit, 2.0 ** (adc.bits - 1) - 1)

    def slew(self, sample_time: float) -> float:
        """The most that the voltage may change in one sample."""
        return NO_LIMIT if self.voltage_slew is None else self.voltage_slew * sample_time


class _Reader:
    """Keys with units, of one file."""

    def __init__(self, path: Path):
        self.path = path

    def part(self, document: dict[str, Any], name: str) -> dict[str, Any] | None:
        """The table of that name, taken out of the document; None where there is none."""
        found = document.pop(name, None)
        if found is not None and not isinstance(found, dict):
            self.refuse(name, found, f"a table, [{name}]")
        return found

    def sensor(self, table: dict[str, Any]) -> Sensor:
        """As it is stated, or as a log of both sensors shows it."""
        if "calibration" not in table:
            return Sensor(**self.table("sensor.", table, SENSOR, {}))
        from controller.calibration import calibrate

        path = table["calibration"]
        if len(table) > 1 or not isinstance(path, str):
            self.refuse("sensor.calibration", table, "the path of a log, and nothing beside it")
        try:
            found = calibrate(self.path.parent / path)
        except (ValueError, OSError) as error:
            raise RigError(f"{self.path}: sensor.calibration: {error}") from None
        if found.delay < 0 and -found.delay > 3 * found.delay_error:
            early = f"a delay of {found.delay:.3g} s"
            self.refuse("sensor.calibration", early, "a sensor that is no earlier than the logs'")
        if found.delay < 0:  # within its error none; the whole angle is what counts
            found = found._replace(rotation=found.rotation - 360 * found.frequency * found.delay, delay=0.0)
        self.suits("sensor.", "gain", found.gain)
        turn = (found.rotation + 180) % 360 - 180
        return Sensor(found.gain, turn, found.delay, found.gain_error, found.angle_error)

    def table(
        self, prefix: str, values: dict[str, Any], units: dict[str, str], words: dict[str, Any]
    ) -> dict[str, Any]:
        """Numbers in `units`, by the longest name that a key begins with; one of the `words` of a name."""
        from sysid.tables.units import convert, did_you_mean, same_kind

        found: dict[str, Any] = {}
        names = sorted(units, key=len, reverse=True)
        for key, value in values.items():
            name = next((n for n in names if key == n or key.startswith(f"{n}_")), key)
            if name in found:
                self.refuse(prefix + key, "it twice", "it once")
            if name in words:
                if type(value) is not type(words[name][0]) or value not in words[name]:
                    said = "true or false" if words[name] == FLAG else f"one of {', '.join(words[name])}"
                    self.refuse(prefix + key, value, said)
                found[name] = value
                continue
            if name not in units:
                known = (*units, *words)
                said = f"one of {', '.join(known)}{did_you_mean(key, known)}"
                self.refuse(prefix + key, "an unknown key", said)
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                self.refuse(prefix + key, value, f"a number in {units[name]}")
            unit = key[len(name) + 1 :].replace("_per_", "/") or units[name]
            if unit != units[name] and not same_kind(unit, units[name]):
                self.refuse(prefix + key, f"the unit {unit!r}", f"{units[name]} or another of its kind")
            found[name] = float(value if unit == units[name] else convert(float(value), unit, units[name]))
            self.suits(prefix, name, found[name])
        return found

    def suits(self, prefix: str, name: str, value: float | None) -> None:
        """Refuses a number that is missing, of the wrong sign, or no number of bits."""
        if name == "bits" and value not in range(4, 25):
            self.refuse(prefix + name, value, "4 to 24")
        if name in OR_ZERO and value < 0:
            self.refuse(prefix + name, value, "zero or more")
        if name not in (*ANY_SIGN, *OR_ZERO) and not (value is not None and value > 0):
            self.refuse(prefix + name, value, f"a {'gain' if name == 'gain' else 'number'} above zero")

    def agree(self, values: dict[str, Any]) -> None:
        """Refuses numbers that contradict each other."""
        if "force" in values and "finger" in values:
            self.refuse("finger", "force as well", "one of them: each decides the other")
        for low, high in (("coldest", "warmest"), ("lowest_frequency", "highest_frequency")):
            if low in values and high in values and values[low] > values[high]:
                self.refuse(high, values[high], f"{low}, {values[low]:g}, or more")
        made = [name for name in ("frequency_step", "timer", "dds") if name in values]
        if len(made) > 1:
            self.refuse(made[1], f"{made[0]} as well", "one source of the frequency")

    def refuse(self, key: str, found: Any, expected: str) -> NoReturn:
        """RigError with the file, the key, what was found and what was expected."""
        raise RigError(f"{self.path}: {key}: found {found!r}, expected {expected}")
