"""Write the synthetic logs and their truth:  python data/synthetic/make.py [DIR]   (DIR: the folder of this file).

Each log is the exact response of a resonator  m w'' + ds w' + c w = N v(t)  to inputs that hold from row to row, as a
lock-in would report it, with a rotation, a feedthrough, an offset and noise added. Nothing is shared with the package
`sysid`, so a fit that returns the numbers of `truth.toml` has been compared with something else than itself.

    v = Re[jV e^{j theta}],  w = Re[Z e^{j theta}],  Z = Wd + j Wq (peak),  theta' = omega = 2 pi f,  theta continuous

Lengths are in um, times in s, frequencies in Hz, voltages in V (peak), temperatures in degC.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

REFERENCE_TEMPERATURE = 24.0

UNITS = {"G": "um/V", "tau": "s", "f0": "Hz", "k_T": "Hz/degC"}

# From the units above to the unit that ends a column's name ("" for the duty).
FACTORS = {"": 1, "s": 1, "ms": 1e3, "V": 1, "Hz": 1, "kHz": 1e-3, "degC": 1, "um": 1, "nm": 1e3}
VOLTS_PER_DUTY = 200


@dataclass(frozen=True)
class Plant:
    """A resonator: G (um/V), tau (s), f0 at 24 degC (Hz), k_T (Hz/degC)."""

    name: str
    G: float
    tau: float
    f0: float
    k_T: float
    ripple: bool = False  # True: the fast mode rings too. False: it is settled, as behind a lock-in's filter.


@dataclass(frozen=True)
class Log:
    """One experiment: inputs row by row, and what the bench does to the response."""

    name: str
    constants: str  # names written once, as metadata
    columns: str  # names written on every row
    time: np.ndarray | None
    voltage: np.ndarray
    frequency: np.ndarray
    temperature: np.ndarray
    rotation_deg: float = 0.0
    feedthrough: complex = 0j  # parts of G
    offset: complex = 0j  # um
    noise: float = 0.01  # standard deviation of Wd and of Wq, parts of the largest |Z|
    noise_time: float = 0.0  # s, correlation time; 0: white
    settled: bool = False  # every point has settled; time, if there is one, is a mere stamp
    notes: tuple[str, ...] = ()  # further metadata lines


# --- physics ----------------------------------------------------------------------------------------------------------


def resonance(plant: Plant, temperature):
    """w0 = 2 pi (f0 + k_T (T - 24)), in rad/s."""
    return 2 * np.pi * (plant.f0 + plant.k_T * (temperature - REFERENCE_TEMPERATURE))


def steady(plant: Plant, voltage, frequency, temperature):
    """Z = G V (w0/omega) / (1 - j (w0^2 - omega^2) tau / (2 omega)), exact."""
    w0, omega = resonance(plant, temperature), 2 * np.pi * frequency
    return plant.G * voltage * (w0 / omega) / (1 - 1j * (w0**2 - omega**2) * plant.tau / (2 * omega))


def modes(plant: Plant, frequency: float, temperature: float) -> tuple[complex, complex, float]:
    """Poles s1 (slow), s2 (fast) in the rotating frame and the gain b:  Z1' = s1 Z1 + b V,  Z2' = s2 Z2 - b V."""
    w0, omega = resonance(plant, temperature), 2 * np.pi * frequency
    wd = np.sqrt(w0**2 - plant.tau**-2)
    return -1 / plant.tau + 1j * (wd - omega), -1 / plant.tau - 1j * (wd + omega), plant.G * w0 / (plant.tau * wd)


def advance(state: complex, pole: complex, push: complex, duration: float) -> complex:
    """The solution of  z' = pole z + push  after `duration`, push being constant."""
    target = -push / pole
    return target + (state - target) * np.exp(pole * duration)


def ringing(plant: Plant, time, voltage, frequency, temperature) -> np.ndarray:
    """Z just before each row's inputs act, from rest. The phase is continuous, so the modes are, where f changes."""
    response = np.zeros(len(time), complex)
    slow = fast = 0j
    for k in range(len(time) - 1):
        s1, s2, b = modes(plant, frequency[k], temperature[k])
        duration = time[k + 1] - time[k]
        slow = advance(slow, s1, b * voltage[k], duration)
        fast = advance(fast, s2, -b * voltage[k], duration) if plant.ripple else b * voltage[k] / s2
        response[k + 1] = slow + fast
    return response


# --- the bench --------------------------------------------------------------------------------------------------------


def noise(log: Log, std: float, seed: int) -> np.ndarray:
    """Complex noise of `std` in each part: white, or with covariance std^2 exp(-|t|/noise_time)."""
    real, imaginary = np.random.default_rng(seed).standard_normal((2, len(log.voltage)))
    white = std * (real + 1j * imaginary)
    if not log.noise_time:
        return white
    keep = np.exp(-np.diff(log.time) / log.noise_time)
    coloured = white.copy()  # the first value is drawn from the stationary distribution
    for k in range(1, len(white)):
        coloured[k] = keep[k - 1] * coloured[k - 1] + np.sqrt(1 - keep[k - 1] ** 2) * white[k]
    return coloured


def record(plant: Plant, log: Log, seed: int) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """The quantities of a log, row by row, and its truth:  z = e^{j phi} Z + kappa V + offset + noise."""
    inputs = log.voltage, log.frequency, log.temperature
    if log.settled:
        clean, felt = steady(plant, *inputs), log.voltage
    else:  # just before a row's inputs act, it is the voltage of the row before that leaks into the response
        clean, felt = ringing(plant, log.time, *inputs), np.append(0.0, log.voltage[:-1])
    std = float(f"{log.noise * np.max(np.abs(clean)):.3g}")  # what the truth file prints is what is used
    leak = plant.G * log.feedthrough
    z = np.exp(1j * np.deg2rad(log.rotation_deg)) * clean + leak * felt + log.offset + noise(log, std, seed)
    rows = {"voltage": log.voltage, "frequency": log.frequency, "temperature": log.temperature}
    rows |= {"duty": log.voltage / VOLTS_PER_DUTY, "wd": z.real, "wq": z.imag, "w": np.abs(z)}
    if log.time is not None:
        rows["time"] = log.time
    truth = {"seed": seed, "rotation_deg": log.rotation_deg, "feedthrough_um_per_V": [leak.real, leak.imag]}
    truth |= {"offset_um": [log.offset.real, log.offset.imag], "noise_um": std, "noise_time_s": log.noise_time}
    return rows, truth


# --- files ------------------------------------------------------------------------------------------------------------


def printed(rows: dict[str, np.ndarray], name: str) -> list[str]:
    """A column as text: inputs to ten digits, which is all they have; responses to seven, so that machines agree."""
    quantity, _, unit = name.partition("_")
    digits = 7 if quantity in ("wd", "wq", "w") else 10
    return [f"{value * FACTORS[unit]:.{digits}g}" for value in rows[quantity]]


def log_text(plant: Plant, log: Log, rows: dict[str, np.ndarray]) -> str:
    """A log file: metadata, header, rows."""
    names = log.columns.split()
    lines = [f"# plate: {plant.name}"]
    lines += [f"# {name}: {printed(rows, name)[0]}" for name in log.constants.split()]
    lines += [f"# {note}" for note in log.notes]
    lines += [",".join(names)]
    lines += [",".join(row) for row in zip(*(printed(rows, name) for name in names), strict=True)]
    return "\n".join(lines) + "\n"


def toml_value(value: object) -> str:
    """A number (to ten digits), a text or a list of numbers as TOML."""
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        text = f"{value:.10g}"
        return text if "." in text or "e" in text else text + ".0"
    return str(value) if isinstance(value, int) else f'"{value}"'


def truth_text(plant: Plant, truths: dict[str, dict[str, object]]) -> str:
    """The truth of one folder: the plant at the reference temperature, and the bench of every log."""
    values = {"name": plant.name} | {name: getattr(plant, name) for name in UNITS}
    values["reference_temperature_degC"] = REFERENCE_TEMPERATURE
    tables = {"plant": values, "units": UNITS} | {f"logs.{name}": truth for name, truth in truths.items()}
    lines = ["# Written by make.py: what the logs of this folder were made from. Complex numbers: [real, imaginary]."]
    for title, table in tables.items():
        lines += ["", f"[{title}]", *(f"{name} = {toml_value(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


def write_folder(folder: Path, plant: Plant, logs: list[Log], first_seed: int) -> int:
    """Write the logs and the truth of one plant; the seed for the next log."""
    folder.mkdir(parents=True, exist_ok=True)
    truths = {}
    for seed, log in enumerate(logs, first_seed):
        rows, truths[log.name] = record(plant, log, seed)
        (folder / f"{log.name}.csv").write_text(log_text(plant, log, rows), encoding="utf-8", newline="\n")
    (folder / "truth.toml").write_text(truth_text(plant, truths), encoding="utf-8", newline="\n")
    return first_seed + len(logs)


# --- the experiments --------------------------------------------------------------------------------------------------

PLATE = Plant("A7", G=0.02, tau=5e-3 / np.log(20), f0=32300.0, k_T=-10.16)
QUARTZ = Plant("QZ5", G=0.07, tau=50_000 / (np.pi * 5e6), f0=4_999_999.0, k_T=1.0)  # 5 MHz at 25 degC
LOW_Q = Plant("B2", G=0.5, tau=8 / (np.pi * 900), f0=900.0, k_T=0.0, ripple=True)

INSTANT, DUTY = "sampling: instant", f"volts_per_duty: {VOLTS_PER_DUTY}"


def transient(name: str, constants: str, columns: str, dt: float, voltage, frequency, temperature=24.0, **bench) -> Log:
    """A log sampled every dt. voltage, frequency: a number, or (rows, level) pairs one after the other, or an array."""
    volts = held(voltage)
    frequencies, temperatures = (np.broadcast_to(held(value), volts.shape) for value in (frequency, temperature))
    time = np.round(dt * np.arange(len(volts)), 9)
    notes = (INSTANT, *bench.pop("notes", ()))
    return Log(name, constants, columns, time, volts, frequencies, temperatures, notes=notes, **bench)


def held(value) -> np.ndarray:
    """A number or an array as it is; (rows, level) pairs as rows of constant level."""
    if isinstance(value, tuple):
        rows, levels = zip(*value, strict=True)
        return np.repeat(np.array(levels, float), rows)
    return np.asarray(value, float)


def sweep(name: str, constants: str, columns: str, frequency, voltage: float, temperature=24.0, **bench) -> Log:
    """Settled points over `frequency`, without time unless `time` is given."""
    temperatures = np.broadcast_to(held(temperature), frequency.shape)
    volts = np.full(frequency.shape, float(voltage))
    return Log(name, constants, columns, bench.pop("time", None), volts, frequency, temperatures, settled=True, **bench)


def around(centre: float, half_width: float, points: int = 101) -> np.ndarray:
    """Evenly spaced frequencies, to a tenth of a Hz."""
    return np.round(np.linspace(centre - half_width, centre + half_width, points), 1)


DQ, DQ_NM = "wd_um wq_um", "wd_nm wq_nm"
T, T_F, T_V = "temperature_degC", "temperature_degC frequency_Hz", "temperature_degC voltage_V"
WANDER = ((20, 32270), *((40, f) for f in (32270, 32310, 32260, 32330, 32290, 32240, 32300)))
STAIRS = ((20, 0), *((50, VOLTS_PER_DUTY * duty) for duty in (0.2, 0.4, 0.6, 0.8, 0.3, 0)))
COLOURED = ("comment: the noise of the response has a correlation time of 0.3 ms",)


def step(volts: float, rows: int) -> tuple[tuple[int, float], ...]:
    """Twenty rows of baseline, then `rows` rows at `volts`."""
    return (20, 0), (rows, volts)


# fmt: off
PLATE_LOGS = [
    transient("step_100V_24C", T_F, f"time_s voltage_V {DQ}", 1e-4, step(100, 220), 32290.0, 24.0,
              rotation_deg=6.0, feedthrough=0.008 - 0.006j, offset=0.004 - 0.003j),
    transient("step_60V_27C", T, f"time_ms voltage_V frequency_Hz {DQ}", 1e-4, step(60, 220), 32280.0, 27.0,
              rotation_deg=-14.0, feedthrough=-0.004 + 0.009j, offset=-0.003 - 0.002j, noise=0.008),
    transient("step_140V_31C", T_F, f"time_s voltage_V {DQ}", 5e-5, step(140, 340), 32200.0, 31.0,
              rotation_deg=23.0, feedthrough=0.012 + 0.010j, offset=0.006 + 0.005j, noise=0.007),
    sweep("sweep_24C", T, f"frequency_Hz voltage_V {DQ}", around(32300, 500), 100, 24.0,
          rotation_deg=8.0, feedthrough=0.010 + 0.004j, offset=-0.004 + 0.003j),
    sweep("sweep_28C", T_V, f"frequency_kHz {DQ}", around(32260, 500), 100, 28.0,
          rotation_deg=-31.0, feedthrough=-0.006 - 0.012j, offset=0.002 - 0.005j, noise=0.006),
    sweep("sweep_32C", T_V, f"frequency_Hz {DQ_NM}", around(32220, 500), 80, 32.0,
          rotation_deg=17.0, feedthrough=0.005 - 0.003j, offset=0.003 + 0.004j, noise=0.008),
    sweep("amplitude_only_sweep", T_V, "frequency_Hz w_um", around(32280, 500), 100, 26.0, noise=0.005),
    transient("duty_staircase", T_F, f"time_s duty {DQ}", 1e-4, STAIRS, 32310.0, 25.0,
              rotation_deg=12.0, feedthrough=0.007 + 0.007j, offset=-0.006 + 0.002j, notes=(DUTY,)),
    transient("ring_down", T_F, f"time_s voltage_V {DQ}", 5e-5, ((20, 0), (140, 100), (140, 0)), 32220.0, 24.0,
              rotation_deg=-9.0, feedthrough=0.014 - 0.008j, offset=0.003 - 0.003j, noise=0.006),
    transient("frequency_staircase", T, f"time_s voltage_V frequency_Hz {DQ}", 1e-4, step(100, 280), WANDER, 25.5,
              rotation_deg=35.0, feedthrough=-0.009 + 0.005j, offset=-0.005 - 0.004j, noise=0.007),
    transient("coloured_step", T_F, f"time_s voltage_V {DQ}", 5e-5, step(80, 380), 32310.0, 24.0,
              rotation_deg=4.0, feedthrough=0.006 + 0.011j, offset=0.002 + 0.003j, noise_time=3e-4, notes=COLOURED),
    transient("two_steps", T_F, f"time_s voltage_V {DQ}", 1e-4, ((20, 0), (90, 60), (90, 120), (90, 40)), 32240.0, 28.5,
              rotation_deg=-20.0, feedthrough=0.004 - 0.013j, offset=0.005 - 0.002j, noise=0.009),
    sweep("timed_sweep", "voltage_V", f"time_s frequency_Hz {T} {DQ}", around(32250, 500, 201), 100,
          np.round(np.linspace(29.0, 29.6, 201), 2), time=np.round(0.02 * np.arange(1, 202), 9),
          rotation_deg=27.0, feedthrough=-0.008 - 0.004j, offset=0.004 + 0.004j, noise=0.008),
    transient("sweep_while_ringing", T, f"time_s voltage_V frequency_Hz {DQ}", 8e-4, ((10, 0), (290, 100)),
              around(32295, 478.4, 300), 24.5, rotation_deg=-5.0, feedthrough=0.011 + 0.009j, offset=-0.002 + 0.005j,
              noise=0.006, notes=("kind: transient",)),
]
QUARTZ_LOGS = [
    sweep("sweep_15C", T_V, f"frequency_Hz {DQ_NM}", around(4_999_990, 500), 0.5, 15.0,
          rotation_deg=11.0, feedthrough=0.009 + 0.006j, offset=1e-4 - 5e-5j, noise=0.006),
    sweep("sweep_35C", T_V, f"frequency_Hz {DQ_NM}", around(5_000_010, 500), 0.5, 35.0,
          rotation_deg=-7.0, feedthrough=0.010 + 0.005j, offset=8e-5 + 6e-5j, noise=0.006),
    transient("ring_down_25C", T_F, f"time_ms voltage_V {DQ_NM}", 1e-4, ((20, 0), (150, 0.5), (150, 0)), 4_999_970.0,
              25.0, rotation_deg=19.0, feedthrough=0.008 + 0.007j, offset=-6e-5 + 9e-5j, noise=0.008),
]
LOW_Q_LOGS = [
    sweep("wide_sweep", "voltage_V", f"frequency_Hz {DQ}", around(1050, 750, 151), 10,
          rotation_deg=5.0, feedthrough=0.012 - 0.005j, offset=0.02 + 0.01j, noise=0.006),
    transient("step_and_release", "frequency_Hz", f"time_s voltage_V {DQ}", 5e-5, ((20, 0), (200, 10), (130, 0)), 860.0,
              rotation_deg=-12.0, feedthrough=0.006 + 0.008j, offset=-0.01 + 0.015j, noise=0.006),
]
# fmt: on

FOLDERS = {".": (PLATE, PLATE_LOGS), "quartz": (QUARTZ, QUARTZ_LOGS), "low_q": (LOW_Q, LOW_Q_LOGS)}


def main(folder: Path) -> None:
    """Write every file; the noise of the logs is seeded 0, 1, 2, ... in the order above."""
    seed = 0
    for name, (plant, logs) in FOLDERS.items():
        seed = write_folder(folder / name, plant, logs, seed)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
