"""The synthetic logs: they remake byte for byte, their physics is that of direct integration, their truth fits them."""

import csv
import runpy
import subprocess
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

FOLDER = Path(__file__).parents[1] / "data" / "synthetic"
make = SimpleNamespace(**runpy.run_path(str(FOLDER / "make.py")))

PLANTS = {name: plant for name, (plant, _) in make.FOLDERS.items()}
LOGS = [pytest.param(folder, log.name, id=log.name) for folder, (_, logs) in make.FOLDERS.items() for log in logs]
EXACT = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13}


def named(folder, name):
    """The definition of one log in make.py."""
    return next(log for log in make.FOLDERS[folder][1] if log.name == name)


def files_below(folder):
    return {path.relative_to(folder) for kind in ("*.csv", "*.toml") for path in folder.rglob(kind)}


def mechanics(plant, w0):
    """ds, c, N for m = 1:  tau = 2 m/ds,  w0^2 = c/m,  G = N/(ds w0)  (w0: 2 pi f0 at 24 degC, where G is stated)."""
    ds = 2 / plant.tau
    return ds, w0**2, plant.G * ds * w0


def stretches(*inputs):
    """(first, last) rows between which no input changes; `last` is the row at which the next one acts."""
    changes = np.flatnonzero(np.any([np.diff(column) != 0 for column in inputs], axis=0)) + 1
    edges = [0, *changes, len(inputs[0]) - 1]
    return [(a, b) for a, b in pairwise(edges) if b > a]


# --- the files --------------------------------------------------------------------------------------------------------


def test_the_command_remakes_every_file_byte_for_byte(tmp_path):
    subprocess.run([sys.executable, FOLDER / "make.py", tmp_path], check=True)
    assert files_below(tmp_path) == files_below(FOLDER)
    for path in files_below(FOLDER):
        assert (tmp_path / path).read_bytes() == (FOLDER / path).read_bytes(), path


def test_make_does_not_import_the_package():
    assert not {"sysid", "controller"} & {line.split()[1] for line in import_lines()}


def import_lines():
    lines = (FOLDER / "make.py").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith(("import ", "from "))]


# --- the physics of make.py, against direct integration ---------------------------------------------------------------


def rotating_frame(plant, time, voltage, frequency):
    """m Z'' + (2 j omega m + ds) Z' + (c - m omega^2 + j omega ds) Z = j N V  from rest, omega constant."""
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    omega = 2 * np.pi * frequency
    state, out = np.zeros(2, complex), np.zeros(len(time), complex)
    for a, b in stretches(voltage):

        def slope(_, y, push=1j * N * voltage[a]):
            return [y[1], push - (2j * omega + ds) * y[1] - (c - omega**2 + 1j * omega * ds) * y[0]]

        path = solve_ivp(slope, (time[a], time[b]), state, t_eval=time[a : b + 1], **EXACT).y
        out[a : b + 1], state = path[0], path[:, -1]
    return out


def test_low_q_log_solves_the_rotating_frame_equation():
    log = named("low_q", "step_and_release")
    plant, frequency = PLANTS["low_q"], log.frequency[0]
    expected = rotating_frame(plant, log.time, log.voltage, frequency)
    got = make.ringing(plant, log.time, log.voltage, log.frequency, log.temperature)
    # 1e-8 of the final amplitude: ten times the integrator's accumulated error at rtol 1e-10.
    assert np.max(np.abs(got - expected)) < 1e-8 * np.max(np.abs(expected))


def test_low_q_needs_its_fast_mode():
    """The check above can fail: with the fast mode settled, the error is the ripple, about 1/(4 Q) = 3 %."""
    log, plant = named("low_q", "step_and_release"), PLANTS["low_q"]
    inputs = log.time, log.voltage, log.frequency, log.temperature
    error = make.ringing(replace(plant, ripple=False), *inputs) - make.ringing(plant, *inputs)
    assert np.max(np.abs(error)) > 0.02 * plant.G * np.max(log.voltage)


def complex_carrier(plant, time, voltage, frequency):
    """Z from  m w'' + ds w' + c w = N jV e^{j theta}, whose real part is the bench's carrier; theta is continuous."""
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    theta = np.append(0.0, np.cumsum(2 * np.pi * frequency[:-1] * np.diff(time)))
    state, out = np.zeros(2, complex), np.zeros(len(time), complex)
    for a, b in stretches(voltage, frequency):

        def slope(t, y, omega=2 * np.pi * frequency[a], push=1j * N * voltage[a], start=time[a], phase=theta[a]):
            return [y[1], push * np.exp(1j * (phase + omega * (t - start))) - ds * y[1] - c * y[0]]

        path = solve_ivp(slope, (time[a], time[b]), state, t_eval=time[a : b + 1], **EXACT).y
        out[a : b + 1], state = path[0] * np.exp(-1j * theta[a : b + 1]), path[:, -1]
    return out


def test_frequency_and_voltage_changes_match_the_carrier():
    """Both modes, continuous across changes of V and of f: the phase of the drive is continuous."""
    plant = replace(PLANTS["."], ripple=True)
    time = 1e-4 * np.arange(61)
    voltage = np.repeat([0.0, 100.0, 40.0], [5, 40, 16])
    frequency = np.repeat([32200.0, 32350.0, 32280.0], [20, 15, 26])
    got = make.ringing(plant, time, voltage, frequency, np.full(61, 24.0))
    # 1e-6 of G V: the integrator's error over 200 cycles of the carrier at rtol 1e-10, with a margin of ten.
    assert np.max(np.abs(got - complex_carrier(plant, time, voltage, frequency))) < 1e-6 * plant.G * 100


def phase_space_pair(plant, time, voltage, frequency):
    """Z of the real carrier  m w'' + ds w' + c w = N V Re[j e^{j theta}]:  2 e^{-j theta} times its mode e^{j wd t}."""
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    omega, wd = 2 * np.pi * frequency, np.sqrt(c - 1 / plant.tau**2)

    def slope(t, y):
        return [y[1], -N * voltage * np.sin(omega * t) - ds * y[1] - c * y[0]]

    w, w_dot = solve_ivp(slope, (time[0], time[-1]), [0.0, 0.0], t_eval=time, **EXACT).y
    return (w_dot - (-1 / plant.tau - 1j * wd) * w) / (1j * wd) * np.exp(-1j * omega * time)


@pytest.mark.parametrize("detuning", [-40.0, 0.0, 30.0])
def test_detuned_step_matches_the_real_carrier_within_its_ripple(detuning):
    plant, time = PLANTS["."], 2.3e-5 * np.arange(400)  # 2.3e-5 s is no multiple of the carrier's period
    columns = np.ones(400), np.full(400, plant.f0 + detuning), np.full(400, 24.0)
    error = make.ringing(plant, time, *columns) - phase_space_pair(plant, time, 1.0, plant.f0 + detuning)
    ripple = 1 / (2 * np.pi * plant.f0 * plant.tau)  # 1/(2 Q): 1/(4 Q) of the pair, 1/(4 Q) of the settled fast mode
    # The bound holds when the start has decayed; before that, what is left of it adds at most a few per cent.
    assert np.max(np.abs(error)) < 1.05 * ripple * plant.G
    assert np.max(np.abs(error)) > 0.9 * ripple * plant.G  # and it is the ripple that one sees


def test_signs_below_and_above_resonance():
    plant = replace(PLANTS["."], G=1.0)
    below, above = (complex(make.steady(plant, 1.0, plant.f0 + detuning, 24.0)) for detuning in (-50, 50))
    # Numbers demodulated from an integration of the carrier, to three decimals: its ripple 1/(2 Q) = 3e-3 is in them.
    assert below == pytest.approx(0.785 + 0.412j, abs=3e-3)
    assert above == pytest.approx(0.785 - 0.411j, abs=3e-3)
    assert below.imag > 0 > above.imag


@pytest.mark.parametrize("folder", PLANTS)
def test_the_steady_response_is_the_transfer_function(folder):
    """Z = j N V / (c - m omega^2 + j omega ds), far from resonance and at it."""
    plant = PLANTS[folder]
    ds, c, N = mechanics(plant, 2 * np.pi * plant.f0)
    frequency = plant.f0 + np.linspace(-5, 5, 11) / (2 * np.pi * plant.tau)
    omega = 2 * np.pi * frequency
    # Differences of squares lose Q, here up to 5e4, of the last bits (1e-16).
    expected = 3j * N / (c - omega**2 + 1j * omega * ds)
    np.testing.assert_allclose(make.steady(plant, 3.0, frequency, 24.0), expected, rtol=1e-10)


@pytest.mark.parametrize("folder", PLANTS)
@pytest.mark.parametrize("half_bandwidths", [-3.0, 0.0, 1.0])
def test_a_step_settles_on_the_steady_response(folder, half_bandwidths):
    plant = PLANTS[folder]
    frequency = plant.f0 + half_bandwidths / (2 * np.pi * plant.tau)
    columns = np.ones(2), np.full(2, frequency), np.full(2, 24.0)
    limit = make.ringing(plant, np.array([0.0, 60 * plant.tau]), *columns)[-1]
    # w0^2 - omega^2 loses Q, here up to 5e4, of the last bits (1e-16): 1e-10 leaves a margin of ten.
    assert limit == pytest.approx(complex(make.steady(plant, 1.0, frequency, 24.0)), rel=1e-10)


def test_a_step_at_resonance_rises_as_one_exponential():
    plant, time = PLANTS["."], 1e-4 * np.arange(200)
    got = make.ringing(plant, time, np.full(200, 50.0), np.full(200, plant.f0), np.full(200, 24.0))
    Q = np.pi * plant.f0 * plant.tau
    expected = plant.G * 50 * (1 - np.exp(-time / plant.tau))
    # Wd differs in second order of 1/Q (3.5e-5), Wq by the 1/(4 Q) of the fast mode (1.5e-3).
    assert np.max(np.abs(got.real - expected)) < plant.G * 50 / Q**2
    assert np.max(np.abs(got.imag)) < plant.G * 50 / (2 * Q)


def test_the_resonance_moves_with_temperature():
    """k_T (T - 24) in Hz moves the peak: the plate 4 degC warmer, at its old resonance, loses 8 %."""
    plant = PLANTS["."]
    loss = 1 - abs(make.steady(plant, 1.0, plant.f0, 28.0) / make.steady(plant, 1.0, plant.f0, 24.0))
    assert loss == pytest.approx(0.08, abs=0.002)  # "8 %" has one digit; w0/omega adds 0.1 %
    assert make.steady(plant, 1.0, plant.f0, 28.0).imag < 0  # warmer: the resonance is below the drive


@pytest.mark.parametrize(("folder", "name"), [(".", "step_100V_24C"), (".", "ring_down"), ("low_q", "step_and_release")])
def test_the_row_at_which_a_step_acts_does_not_feel_it_yet(folder, name):
    """`sampling: instant`, for the state and for the feedthrough (too small to show under the noise of one row)."""
    log = replace(named(folder, name), noise=0.0)
    rows, _ = make.record(PLANTS[folder], log, 0)
    z, step = rows["wd"] + 1j * rows["wq"], np.flatnonzero(log.voltage)[0]
    leak = PLANTS[folder].G * log.feedthrough * log.voltage[step]
    assert z[step] == log.offset  # still at rest
    # One row later there is the plate, turned, and the leak; 1e-9 is for rounding.
    state = make.ringing(PLANTS[folder], log.time, log.voltage, log.frequency, log.temperature)[step + 1]
    turned = np.exp(1j * np.deg2rad(log.rotation_deg)) * state
    assert z[step + 1] - log.offset - turned == pytest.approx(leak, rel=1e-9)


# --- the committed files, against their truth -------------------------------------------------------------------------

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


def response(plant, values, settled):
    """Z from (E) alone: its transfer function, or its state (Z, Z'/omega) stepped by the exponential of its matrix."""
    w0 = 2 * np.pi * (plant["f0"] + plant["k_T"] * (values.get("temperature", 24.0) - 24.0))
    omega = 2 * np.pi * values["frequency"]
    w0 = np.broadcast_to(w0, omega.shape)
    ds = 2 / plant["tau"]
    push = 1j * plant["G"] * ds * w0 * values["voltage"]
    if settled:
        return push / (w0**2 - omega**2 + 1j * omega * ds)
    return step_by_step(values["time"], omega, w0, ds, push)


def step_by_step(time, omega, w0, ds, push):
    out, y = np.zeros(len(time), complex), np.zeros(3, complex)
    for k, duration in enumerate(np.diff(time)):
        y[2] = 1.0
        if k:  # w and w' are continuous: Z' = (w_c' - j omega w_c) e^{-j theta} jumps where omega does
            y[1] = (y[1] * omega[k - 1] - 1j * (omega[k] - omega[k - 1]) * y[0]) / omega[k]
        stiffness = w0[k] ** 2 - omega[k] ** 2 + 1j * omega[k] * ds
        rate = [[0, omega[k], 0], [-stiffness / omega[k], -2j * omega[k] - ds, push[k] / omega[k]], [0, 0, 0]]
        y = expm(np.array(rate) * duration) @ y
        out[k + 1] = y[0]
    return out


def residual(folder, name):
    """Measured minus (E) behind the bench of truth.toml, with that bench."""
    truth = tomllib.loads((FOLDER / folder / "truth.toml").read_text(encoding="utf-8"))
    bench = truth["logs"][name]
    metadata, values = read(FOLDER / folder / f"{name}.csv")
    settled = "sampling" not in metadata
    clean = response(truth["plant"], values, settled)
    felt = values["voltage"] if settled else np.append(0.0, values["voltage"][:-1])
    model = clean * np.exp(1j * np.deg2rad(bench["rotation_deg"])) + complex(*bench["feedthrough_um_per_V"]) * felt
    model += complex(*bench["offset_um"])
    return values["w"] - np.abs(model) if "w" in values else values["wd"] + 1j * values["wq"] - model, bench, values


@pytest.mark.parametrize(("folder", "name"), LOGS)
def test_a_log_differs_from_its_truth_by_the_stated_noise(folder, name):
    left, bench, values = residual(folder, name)
    if bench["noise_time_s"]:  # the innovations of an Ornstein-Uhlenbeck process are white
        keep = np.exp(-np.diff(values["time"]) / bench["noise_time_s"])
        left = (left[1:] - keep * left[:-1]) / np.sqrt(1 - keep**2)
    parts = left if np.isrealobj(left) else np.concatenate([left.real, left.imag])
    parts = parts / bench["noise_um"]
    n = len(parts)
    # Five standard errors of n white values, and 0.015 for the ringing of the fast mode, which (E) has and the logs of
    # the plate have not: at most 0.15 % of G V where the noise is 0.6 %, so (0.15/0.6)^2/2 = 3 % on half the rows.
    assert abs(np.mean(parts)) < 5 / np.sqrt(n)
    assert abs(np.std(parts) - 1) < 5 / np.sqrt(2 * n) + 0.015
    assert np.max(np.abs(parts)) < 6  # an outlier, or a row at the wrong place
    assert abs(np.mean(parts[1:] * parts[:-1])) < 5 / np.sqrt(n) + 0.015  # nothing of the response is left


@pytest.mark.parametrize(("folder", "name"), LOGS)
def test_a_log_keeps_to_the_format(folder, name):
    metadata, values = read(FOLDER / folder / f"{name}.csv")
    assert metadata["plate"] == PLANTS[folder].name
    assert {"voltage", "frequency"} <= values.keys()
    assert np.any(values["voltage"] > 0)
    assert ("w" in values) != ({"wd", "wq"} <= values.keys())
    if "sampling" in metadata:
        assert metadata["sampling"] == "instant"
        assert 200 <= len(values["time"]) <= 400
        assert np.all(np.diff(values["time"]) > 0)
        assert np.all(values["voltage"][:10] == 0)  # a baseline


def test_dwells_stand_clear_of_the_rule_for_settled_points():
    """Four tau separates a settled sweep from one that rings."""
    tau = PLANTS["."].tau
    timed, ringing = (read(FOLDER / f"{name}.csv")[1] for name in ("timed_sweep", "sweep_while_ringing"))
    assert np.all(np.diff(timed["frequency"]) != 0) and np.all(np.diff(ringing["frequency"]) != 0)
    assert np.min(np.diff(timed["time"])) > 10 * tau
    assert np.all(np.abs(np.diff(ringing["time"]) / tau - 0.5) < 0.05)


def test_seeds_count_up_in_the_order_of_the_files():
    truths = [tomllib.loads((FOLDER / folder / "truth.toml").read_text(encoding="utf-8")) for folder in PLANTS]
    assert [log["seed"] for truth in truths for log in truth["logs"].values()] == list(range(len(LOGS)))
