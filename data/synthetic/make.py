"""Write the synthetic logs and their truth:  python data/synthetic/make.py [DIR]   (DIR: the folder of this
file).

Each log is a scene of the folder `scenes`, simulated with a seed of its own and written as one lab or another
might have written it: its own units, columns that are constant as metadata, what need not be said left
unsaid. `truth.toml` keeps the numbers that the scenes are made of.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from sysid import Log, Scene

HERE = Path(__file__).parent
UNITS = {"G": "um/V", "tau": "s", "f0": "Hz", "k_T": "Hz/degC"}
# From the units of a simulated log to the unit that ends a column's name ("" for the duty).
FACTORS = {"": 1, "s": 1, "ms": 1e3, "V": 1, "Hz": 1, "kHz": 1e-3, "degC": 1, "N": 1, "um": 1, "nm": 1e3}


class Sheet(NamedTuple):
    """How one log is written: the quantities that stand once above the header, those on every row, and what
    is said besides."""

    scene: str  # below `scenes`; also the place of the log
    constants: str
    columns: str
    said: tuple[str, ...] = ()


DQ, DQ_NM = "wd_um wq_um", "wd_nm wq_nm"
T, T_F, T_V = "temperature_degC", "temperature_degC frequency_Hz", "temperature_degC voltage_V"
INSTANT = "sampling: instant"
DUTY, COLOURED = "volts_per_duty: 200", "comment: the noise of the response has a correlation time of 0.3 ms"

# The place of a log in this list is the seed of its noise.
SHEETS = [
    Sheet("plate/step_100V_24C", T_F, f"time_s voltage_V {DQ}", (INSTANT,)),
    Sheet("plate/step_60V_27C", T, f"time_ms voltage_V frequency_Hz {DQ}", (INSTANT,)),
    Sheet("plate/step_140V_31C", T_F, f"time_s voltage_V {DQ}", (INSTANT,)),
    Sheet("plate/sweep_24C", T, f"frequency_Hz voltage_V {DQ}"),
    Sheet("plate/sweep_28C", T_V, f"frequency_kHz {DQ}"),
    Sheet("plate/sweep_32C", T_V, f"frequency_Hz {DQ_NM}"),
    Sheet("plate/amplitude_only_sweep", T_V, "frequency_Hz w_um"),
    Sheet("plate/duty_staircase", T_F, f"time_s duty {DQ}", (INSTANT, DUTY)),
    Sheet("plate/ring_down", T_F, f"time_s voltage_V {DQ}", (INSTANT,)),
    Sheet("plate/frequency_staircase", T, f"time_s voltage_V frequency_Hz {DQ}", (INSTANT,)),
    Sheet("plate/coloured_step", T_F, f"time_s voltage_V {DQ}", (INSTANT, COLOURED)),
    Sheet("plate/two_steps", T_F, f"time_s voltage_V {DQ}", (INSTANT,)),
    Sheet("plate/timed_sweep", "voltage_V", f"time_s frequency_Hz {T} {DQ}"),
    Sheet(
        "plate/sweep_while_ringing", T, f"time_s voltage_V frequency_Hz {DQ}", (INSTANT, "kind: transient")
    ),
    Sheet("quartz/sweep_15C", T_V, f"frequency_Hz {DQ_NM}"),
    Sheet("quartz/sweep_35C", T_V, f"frequency_Hz {DQ_NM}"),
    Sheet("quartz/ring_down_25C", T_F, f"time_ms voltage_V {DQ_NM}", (INSTANT,)),
    Sheet("low_q/wide_sweep", "voltage_V", f"frequency_Hz {DQ}"),
    Sheet("low_q/step_and_release", "frequency_Hz", f"time_s voltage_V {DQ}", (INSTANT,)),
    Sheet("touch", T_F, f"time_s voltage_V force_N {DQ}", (INSTANT,)),
]


def place(sheet: Sheet) -> tuple[str, str]:
    """Folder and name of a log: those of the plate lie at the top, the touched plate has a folder of its
    own."""
    folder, _, name = sheet.scene.rpartition("/")
    return {"plate": ".", "": name}.get(folder, folder), name


# --- a log's text
# -----------------------------------------------------------------------------------------------------


def printed(log: Log, name: str) -> list[str]:
    """A column as text: inputs to ten digits, which is all they have; responses to seven, so that machines
    agree."""
    quantity, _, unit = name.partition("_")
    columns = {
        "time": log.time,
        "frequency": log.frequency,
        "temperature": log.temperature,
        "force": log.force,
    }
    columns |= {
        "voltage": log.drive,
        "duty": log.drive,
        "wd": log.response.real,
        "wq": log.response.imag,
        "w": log.response,
    }
    digits = 7 if quantity in ("wd", "wq", "w") else 10
    return [f"{value * FACTORS[unit]:.{digits}g}" for value in columns[quantity]]


def log_text(log: Log, sheet: Sheet) -> str:
    """A log file: metadata, header, rows."""
    names = sheet.columns.split()
    lines = [f"# plate: {log.metadata['plate']}"]
    lines += [f"# {name}: {printed(log, name)[0]}" for name in sheet.constants.split()]
    lines += [f"# {said}" for said in sheet.said]
    lines += [",".join(names)]
    lines += [",".join(row) for row in zip(*(printed(log, name) for name in names), strict=True)]
    return "\n".join(lines) + "\n"


# --- the truth
# --------------------------------------------------------------------------------------------------------


def bench(scene: Scene, seed: int) -> dict[str, object]:
    """What the bench makes of Z,  e^{j rotation} (Z + feedthrough V) + offset + noise,  and the finger if
    there is one."""
    of = {effect.name: effect for effect in scene.effects}
    noise = of.get("white_noise") or of["coloured_noise"]
    truth: dict[str, object] = {"seed": seed}
    truth["rotation_deg"] = of["rotation"].angle if "rotation" in of else 0.0
    truth["feedthrough_um_per_V"] = pair(of.get("feedthrough"))
    truth["offset_um"] = pair(of.get("offset"))
    truth |= {"noise_um": noise.std, "noise_time_s": getattr(noise, "time", 0.0)}
    if finger := of.get("finger_damping"):
        truth |= {
            "finger_rho": finger.rho,
            "finger_scale_N": finger.scale,
            "finger_exponent": finger.exponent,
        }
    return truth


def pair(effect) -> list[float]:
    return [effect.d, effect.q] if effect else [0.0, 0.0]


def toml_value(value: object) -> str:
    """A number (to ten digits), a text or a list of numbers as TOML."""
    if isinstance(value, list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        text = f"{value:.10g}"
        return text if "." in text or "e" in text else text + ".0"
    return str(value) if isinstance(value, int) else f'"{value}"'


def truth_text(scene: Scene, truths: dict[str, dict[str, object]]) -> str:
    """The truth of one folder: the plant at the reference temperature, and the bench of every log."""
    plant = {"name": scene.metadata["plate"]} | {name: getattr(scene.plant, name) for name in UNITS}
    plant["reference_temperature_degC"] = scene.plant.reference_temperature
    tables = {"plant": plant, "units": UNITS} | {f"logs.{name}": truth for name, truth in truths.items()}
    lines = [
        "# Written by make.py: what the logs of this folder were made from. Complex numbers: [real,"
        " imaginary]."
    ]
    for title, table in tables.items():
        lines += ["", f"[{title}]", *(f"{name} = {toml_value(value)}" for name, value in table.items())]
    return "\n".join(lines) + "\n"


# --- files
# ------------------------------------------------------------------------------------------------------------


def made() -> Iterator[tuple[str, str]]:
    """Every file: its place below DIR, and its text."""
    truths: dict[str, dict[str, dict[str, object]]] = {}
    scenes: dict[str, Scene] = {}
    for seed, sheet in enumerate(SHEETS):
        folder, name = place(sheet)
        scene = Scene.from_toml(HERE / "scenes" / f"{sheet.scene}.toml")
        if folder in scenes and scene.plant != scenes[folder].plant:
            raise ValueError(
                f"{sheet.scene}: found another plant than in {scenes[folder].name}, expected one for a folder"
            )
        scenes[folder] = scene
        truths.setdefault(folder, {})[name] = {"scene": f"scenes/{sheet.scene}.toml"} | bench(scene, seed)
        yield f"{folder}/{name}.csv", log_text(scene.simulate(seed), sheet)
    for folder, scene in scenes.items():
        yield f"{folder}/truth.toml", truth_text(scene, truths[folder])


def main(folder: Path) -> None:
    for name, text in made():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
