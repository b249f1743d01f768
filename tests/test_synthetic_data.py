"""The synthetic logs: they remake byte for byte, their scenes agree with the reference physics, their truth
fits them."""

import csv
import runpy
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import reference
from scipy.linalg import expm

import sysid

FOLDER = Path(__file__).parents[1] / "data" / "synthetic"
make = SimpleNamespace(**runpy.run_path(str(FOLDER / "make.py")))

FOLDERS = dict.fromkeys(make.place(sheet)[0] for sheet in make.SHEETS)
LOGS = [pytest.param(*make.place(sheet), id=make.place(sheet)[1]) for sheet in make.SHEETS]
every_log = pytest.mark.parametrize(("folder", "name"), LOGS)


def truth_of(folder):
    return tomllib.loads((FOLDER / folder / "truth.toml").read_text(encoding="utf-8"))


def files_below(folder):
    """The logs and their truth, which make.py writes; the scenes are what it reads."""
    return {path.relative_to(folder) for kind in ("*.csv", "truth.toml") for path in folder.rglob(kind)}


# --- the files
# --------------------------------------------------------------------------------------------------------


@pytest.mark.study
def test_the_command_remakes_every_file_byte_for_byte(tmp_path):
    subprocess.run([sys.executable, FOLDER / "make.py", tmp_path], check=True)
    assert files_below(tmp_path) == files_below(FOLDER)
    for path in files_below(FOLDER):
        assert (tmp_path / path).read_bytes() == (FOLDER / path).read_bytes(), path


def test_every_scene_of_a_log_is_written():
    """A scene that is put into a folder and forgotten in make.py would be no log."""
    scenes = FOLDER / "scenes"
    below = {path.relative_to(scenes).with_suffix("").as_posix() for path in scenes.glob("*/*.toml")}
    assert below | {"touch"} == {sheet.scene for sheet in make.SHEETS}


def test_the_logs_at_the_top_are_one_untouched_plate():
    """`identify data/synthetic/*.csv` reads them all as one plant without a finger."""
    assert not [log for log in truth_of(".")["logs"].values() if "finger_rho" in log]
    assert not [path for path in FOLDER.glob("*.csv") if "force" in path.read_text(encoding="utf-8")]


# --- the scenes, against numbers read without the package, and against the reference physics
# --------------------------

UNIT = {
    "": 1.0,
    "um": 1.0,
    "nm": 1e-3,
    "pm": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "deg": 1.0,
    "V": 1.0,
    "N": 1.0,
    "Hz": 1.0,
}
UNIT |= {"um_per_V": 1.0, "nm_per_V": 1e-3, "Hz_per_degC": 1.0}


def stated(table, name):
    """The number of `name_unit` in a table of a scene file, in um, s, V, Hz; None where there is none."""
    for key, value in table.items():
        if key == name or key.startswith(f"{name}_"):
            return value * UNIT[key[len(name) + 1 :]]
    return None


@every_log
def test_the_truth_is_what_the_scene_says(folder, name):
    truth = truth_of(folder)
    bench = truth["logs"][name]
    scene = tomllib.loads((FOLDER / bench["scene"]).read_text(encoding="utf-8"))
    for key in ("G", "tau", "f0", "k_T"):
        assert truth["plant"][key] == pytest.approx(stated(scene["plant"], key), rel=1e-12)
    effects = scene["effects"]
    pairs = {
        key: [stated(effects.get(key, {}), axis) or 0.0 for axis in "dq"] for key in ("feedthrough", "offset")
    }
    noise = effects.get("white_noise") or effects["coloured_noise"]
    assert bench["rotation_deg"] == effects.get("rotation", {"angle_deg": 0})["angle_deg"]
    assert bench["feedthrough_um_per_V"] == pytest.approx(pairs["feedthrough"], rel=1e-12)
    assert bench["offset_um"] == pytest.approx(pairs["offset"], rel=1e-12)
    assert bench["noise_um"] == pytest.approx(stated(noise, "std"), rel=1e-12)
    assert bench["noise_time_s"] == pytest.approx(stated(noise, "time") or 0.0, rel=1e-12)
    assert ("finger_damping" in effects) == ("finger_rho" in bench)


def behind_the_bench(clean, felt, bench):
    """e^{j rotation} (Z + feedthrough V) + offset."""
    leak = complex(*bench["feedthrough_um_per_V"])
    return np.exp(1j * np.deg2rad(bench["rotation_deg"])) * (clean + leak * felt) + complex(
        *bench["offset_um"]
    )


def expected(plant, log, bench):
    """The rows of a noise-free log by the reference physics; inputs that ramp are taken at the middle of each
    interval."""
    plate = reference.Plant(plant["G"], plant["tau"], plant["f0"], plant["k_T"], ripple=True)
    temperature = np.full(len(log), 24.0) if log.temperature is None else log.temperature
    volts = log.drive * (200 if log.drive_unit == "duty" else 1)
    force = (
        np.zeros(len(log))
        if log.force is None
        else 0.5 * (log.force + np.append(log.force[1:], log.force[-1]))
    )
    _, tau = reference.touched(plate, force)
    if log.kind == "steady":
        return behind_the_bench(reference.steady(plate, volts, log.frequency, temperature), volts, bench)
    clean = reference.ringing(plate, log.time, volts, log.frequency, temperature, tau)
    return behind_the_bench(clean, np.append(0.0, volts[:-1]), bench)


def quiet(scene):
    return replace(scene, effects=tuple(effect for effect in scene.effects if effect.kind != "noise"))


@every_log
def test_a_scene_without_its_noise_is_the_reference_physics(folder, name):
    """To rounding: both solve the two modes exactly."""
    truth = truth_of(folder)
    scene = quiet(sysid.Scene.from_toml(FOLDER / truth["logs"][name]["scene"]))
    log = scene.simulate()
    wanted = expected(truth["plant"], log, truth["logs"][name])
    wanted = np.abs(wanted) if log.amplitude_only else wanted
    # 1e-9 of the response, for phases of 1e4 rad between two rows; a finger's law is softened by 1e-6 where
    # it begins
    allowed = 1e-6 if "finger_rho" in truth["logs"][name] else 1e-9
    assert np.max(np.abs(log.response - wanted)) < allowed * np.max(np.abs(wanted))


@every_log
def test_the_rows_of_a_file_are_those_of_its_scene(folder, name):
    """Units, constants and digits of the printed inputs; responses are noisy, and compared below."""
    truth = truth_of(folder)
    log = quiet(sysid.Scene.from_toml(FOLDER / truth["logs"][name]["scene"])).simulate()
    _, values = read(FOLDER / folder / f"{name}.csv")
    volts = log.drive * (200 if log.drive_unit == "duty" else 1)
    inputs = {
        "time": log.time,
        "voltage": volts,
        "frequency": log.frequency,
        "temperature": log.temperature,
        "force": log.force,
    }
    for key, column in inputs.items():
        assert (key in values) == (column is not None) or key == "temperature"
        if key in values:
            np.testing.assert_allclose(values[key], column, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["step_100V_24C", "ring_down", "duty_staircase"])
def test_the_row_at_which_a_step_acts_does_not_feel_it_yet(name):
    """`sampling: instant`, for the state and for the feedthrough (too small to show under the noise of one
    row)."""
    bench = truth_of(".")["logs"][name]
    log = quiet(sysid.Scene.from_toml(FOLDER / bench["scene"])).simulate()
    step = np.flatnonzero(log.drive)[0]
    assert log.response[step] == pytest.approx(complex(*bench["offset_um"]), rel=1e-12)  # still at rest
    assert abs(log.response[step + 1] - log.response[step]) > 0.02  # b V dt: a twentieth of 2 um


# --- the committed files, against their truth
# -------------------------------------------------------------------------

SCALES = {"ms": 1e-3, "kHz": 1e3, "nm": 1e-3}  # to s, Hz, um


def read(path):
    """(metadata, quantities in s, V, Hz, degC, um) of a log, without the package's own reader."""
    lines = path.read_text(encoding="utf-8").splitlines()
    metadata = dict(line[2:].split(": ", 1) for line in lines if line.startswith("#"))
    header, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    columns = dict(zip(header, np.array(rows, float).T, strict=True))
    constants = {key: np.full(len(rows), float(value)) for key, value in metadata.items() if is_column(key)}
    values = {}
    for name, column in (constants | columns).items():
        quantity, _, unit = name.partition("_")
        values[quantity] = column * SCALES.get(unit, 1.0)
    if "duty" in values:
        values["voltage"] = values["duty"] * float(metadata["volts_per_duty"])
    return metadata, values


def is_column(key):
    return key.startswith(("voltage_", "frequency_", "temperature_"))


def response(plant, values, settled, damped):
    """Z from (E) alone: its transfer function, or its state (Z, Z'/omega) stepped by the exponential of its
    matrix."""
    w0 = 2 * np.pi * (plant["f0"] + plant["k_T"] * (values.get("temperature", 24.0) - 24.0))
    omega = 2 * np.pi * values["frequency"]
    w0 = np.broadcast_to(w0, omega.shape)
    ds = 2 / plant["tau"]
    push = 1j * plant["G"] * ds * w0 * values["voltage"]
    if settled:
        return push / (w0**2 - omega**2 + 1j * omega * ds)
    return step_by_step(values["time"], omega, w0, ds * damped, push)


def finger(values, bench):
    """What a finger makes of the damping over each interval, at the mean of the forces that bound it."""
    force = values.get("force", np.zeros(len(values["frequency"])))
    plate = reference.Plant(1.0, 1.0, 0.0, 0.0)
    law = {
        key: bench.get(f"finger_{name}", 1.0)
        for key, name in (("rho", "rho"), ("scale", "scale_N"), ("exponent", "exponent"))
    }
    return 1 / reference.touched(plate, 0.5 * (force + np.append(force[1:], force[-1])), **law)[1]


def step_by_step(time, omega, w0, ds, push):
    out, y = np.zeros(len(time), complex), np.zeros(3, complex)
    for k, duration in enumerate(np.diff(time)):
        y[2] = 1.0
        if k:  # w and w' are continuous: Z' = (w_c' - j omega w_c) e^{-j theta} jumps where omega does
            y[1] = (y[1] * omega[k - 1] - 1j * (omega[k] - omega[k - 1]) * y[0]) / omega[k]
        stiffness = w0[k] ** 2 - omega[k] ** 2 + 1j * omega[k] * ds[k]
        rate = [
            [0, omega[k], 0],
            [-stiffness / omega[k], -2j * omega[k] - ds[k], push[k] / omega[k]],
            [0, 0, 0],
        ]
        y = expm(np.array(rate) * duration) @ y
        out[k + 1] = y[0]
    return out


def residual(folder, name):
    """Measured minus (E) behind the bench of truth.toml, with that bench."""
    truth = truth_of(folder)
    bench = truth["logs"][name]
    metadata, values = read(FOLDER / folder / f"{name}.csv")
    settled = "sampling" not in metadata
    clean = response(truth["plant"], values, settled, finger(values, bench))
    model = behind_the_bench(
        clean, values["voltage"] if settled else np.append(0.0, values["voltage"][:-1]), bench
    )
    return (
        values["w"] - np.abs(model) if "w" in values else values["wd"] + 1j * values["wq"] - model,
        bench,
        values,
    )


@every_log
def test_a_log_differs_from_its_truth_by_the_stated_noise(folder, name):
    left, bench, values = residual(folder, name)
    if bench["noise_time_s"]:  # the innovations of an Ornstein-Uhlenbeck process are white
        keep = np.exp(-np.diff(values["time"]) / bench["noise_time_s"])
        left = (left[1:] - keep * left[:-1]) / np.sqrt(1 - keep**2)
    parts = left if np.isrealobj(left) else np.concatenate([left.real, left.imag])
    parts = parts / bench["noise_um"]
    n = len(parts)
    # Five standard errors of n white values.
    assert abs(np.mean(parts)) < 5 / np.sqrt(n)
    assert abs(np.std(parts) - 1) < 5 / np.sqrt(2 * n)
    assert np.max(np.abs(parts)) < 6  # an outlier, or a row at the wrong place
    assert abs(np.mean(parts[1:] * parts[:-1])) < 5 / np.sqrt(n)  # nothing of the response is left


@every_log
def test_a_log_keeps_to_the_format(folder, name):
    metadata, values = read(FOLDER / folder / f"{name}.csv")
    assert metadata["plate"] == truth_of(folder)["plant"]["name"]
    assert {"voltage", "frequency"} <= values.keys()
    assert np.any(values["voltage"] > 0)
    assert ("w" in values) != ({"wd", "wq"} <= values.keys())
    if "sampling" in metadata:
        assert metadata["sampling"] == "instant"
        assert 200 <= len(values["time"]) <= 601
        assert np.all(np.diff(values["time"]) > 0)
        assert np.all(values["voltage"][:10] == 0)  # a baseline


def test_dwells_stand_clear_of_the_rule_for_settled_points():
    """Four tau separates a settled sweep from one that rings."""
    tau = truth_of(".")["plant"]["tau"]
    timed, ringing = (read(FOLDER / f"{name}.csv")[1] for name in ("timed_sweep", "sweep_while_ringing"))
    assert np.all(np.diff(timed["frequency"]) != 0) and np.all(np.diff(ringing["frequency"]) != 0)
    assert np.min(np.diff(timed["time"])) > 10 * tau
    assert np.all(np.abs(np.diff(ringing["time"]) / tau - 0.5) < 0.05)


def test_seeds_count_up_in_the_order_of_the_files():
    seeds = [log["seed"] for folder in FOLDERS for log in truth_of(folder)["logs"].values()]
    assert seeds == list(range(len(LOGS)))
