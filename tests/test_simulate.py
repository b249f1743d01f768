"""The command `simulate`, scene files, and what they are refused for."""

import dataclasses
import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import sysid
from sysid.scene import EFFECTS, Profile, Scene, SceneError
from sysid.scene.carrier import waveform
from sysid.scene.cli import main

SCENE = """
[plant]
G_nm_per_V = 20
tau_ms = 1.669
f0_kHz = 32.3
k_T = -10.16
[log]
rate_kHz = 10
duration_ms = 20
plate = "A7"
[inputs]
voltage_V = {steps = [[0, 0], [2e-3, 100]]}
frequency_kHz = 32.3
force_mN = {ramp = [[5e-3, 0], [10e-3, 1500]]}
[effects.finger_damping]
[effects.white_noise]
std_nm = 20
"""


@pytest.fixture
def scene_file(tmp_path):
    def write(text=SCENE, name="press.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_units_are_those_of_the_keys(scene_file):
    scene = Scene.from_toml(scene_file())
    assert (scene.plant.G, scene.plant.tau, scene.plant.f0) == (0.02, 1.669e-3, 32300.0)
    assert (scene.rate, scene.rows) == (10000.0, 201)
    assert scene.inputs["force"].values.tolist() == [0.0, 1.5]
    assert scene.inputs["frequency"].values.tolist() == [32300.0]  # 32.3 * 1000 is not, in binary
    assert [e.std for e in scene.effects if e.name == "white_noise"] == [0.02]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("white_noise", "white_nois", "effects.white_nois: .*did you mean 'white_noise'"),
        ("std_nm", "std_kg", "effects.white_noise.std_kg: .*'kg', expected um"),
        ("1500]", '"x"]', r"inputs.force_mN.ramp\[1\]: .*expected \[time in s, value\]"),
        ("force_mN", "forc_mN", "inputs.forc_mN: .*did you mean 'force'"),
        ("tau_ms", "tau_mm", "plant.tau_mm: .*'mm', expected s"),
        ("[10e-3", "[4e-3", "inputs.force_mN.ramp: .*times that increase"),
        ("[log]", "[lag]", "lag: .*did you mean 'log'"),
        ("rate_kHz = 10", "rate_kHz = true", "log.rate_kHz: found True, expected a number"),
        ("rate_kHz = 10", "rate_kHz = 10\nrows = 5", "log.duration.*: found log.rows as well"),
        ("G_nm_per_V = 20", "", "plant.G: found nothing"),
        ("tau_ms = 1.669", "tau_ms = -1", "plant: .*both above zero"),
        ("frequency_kHz = 32.3\n", "", "no profile of the frequency"),
        ("force_mN = {ramp = [[5e-3, 0], [10e-3, 1500]]}", "", "finger_damping and no force"),
        ("[effects.finger_damping]", "[effects.curved]", "curved and no temperature"),
        (
            "[effects.finger_damping]",
            "[effects.finger_detuning]",
            "finger_detuning without effects.finger_damping",
        ),
        (
            "[effects.finger_damping]",
            "[effects.lock_in]\norder = 1.5\n[effects.finger_damping]",
            "lock_in.order: .*whole number",
        ),
        (
            "[effects.finger_damping]",
            '[effects.finger_damping]\nlaw = "linear"',
            "law: found linear, expected saturating or power",
        ),
        (
            "[effects.finger_damping]",
            "[effects.finger_damping]\nrhoo = 2",
            "rhoo: found an unknown key.*did you mean 'rho'",
        ),
        (
            'plate = "A7"',
            'plate = "A7"\nkind = "steady"\n[effects.duffing]',
            "effects.duffing in a scene of settled points",
        ),
        ("[plant]", 'fidelity = "best"\n[plant]', "fidelity: found best, expected steady or"),
        ("[plant]", "fidelity = ", "cannot be read"),
        (
            "force_mN = {ramp = [[5e-3, 0], [10e-3, 1500]]}",
            "force_N = {csv = 'none.csv'}",
            "force_N.csv: .*cannot be read",
        ),
    ],
)
def test_a_scene_that_cannot_be_is_refused_at_its_key(scene_file, capsys, old, new, said):
    assert old in SCENE
    path = scene_file(SCENE.replace(old, new, 1))
    with pytest.raises(SceneError, match=f"(?s)press.toml: .*{said}" if "cannot" not in said else said):
        Scene.from_toml(path)
    assert main([str(path), "-o", str(path.parent / "out")]) == 2
    assert "press.toml" in capsys.readouterr().err
    assert not list(path.parent.glob("out/*"))


def test_a_profile_from_a_table(scene_file, tmp_path):
    (tmp_path / "press.csv").write_text(
        "# a press\ntime_s,force_mN\n0,0\n5e-3,0\n10e-3,1500\n", encoding="utf-8"
    )
    text = SCENE.replace("force_mN = {ramp = [[5e-3, 0], [10e-3, 1500]]}", "force_mN = {csv = 'press.csv'}")
    same = Scene.from_toml(scene_file(text)).simulate(3)
    np.testing.assert_array_equal(same.response, Scene.from_toml(scene_file()).simulate(3).response)
    wrong = text.replace("'press.csv'", "'press.csv', column = 'forc'")
    with pytest.raises(SceneError, match=r"no column 'forc'.*did you mean 'force_mN'"):
        Scene.from_toml(scene_file(wrong))


def test_logs_from_successive_seeds_are_read_back(scene_file, tmp_path, capsys):
    path = scene_file()
    assert main([str(path), "-o", str(tmp_path / "logs"), "--seed", "5", "--logs", "2"]) == 0
    assert capsys.readouterr().out == ""
    first, second = sysid.read_logs(tmp_path / "logs" / "press_*.csv")
    assert not np.array_equal(first.response, second.response)
    assert first.metadata["plate"] == "A7" and first.sampling == "instant" and first.kind == "transient"
    np.testing.assert_array_equal(second.response, Scene.from_toml(path).simulate(6).response)
    assert sorted(p.name for p in (tmp_path / "logs").iterdir()) == ["press_5.csv", "press_6.csv"]


def test_the_plant_of_a_fit_and_of_its_draws(scene_file, tmp_path):
    import h5netcdf

    parameters = {"G": 0.03, "tau": 2e-3, "f0": 32290.0, "k_T": None}
    content = {"parameters": {k: {"value": v, "why": "one temperature"} for k, v in parameters.items()}}
    (tmp_path / "fit.json").write_text(
        json.dumps(content | {"reference_temperature_degC": 26.0}), encoding="utf-8"
    )
    with h5netcdf.File(tmp_path / "posterior.nc", "w") as file:
        drawn = file.create_group("posterior")
        drawn.dimensions = {"chain": 2, "draw": 3}
        for name in ("G", "tau", "f0"):
            drawn.create_variable(
                name, ("chain", "draw"), data=parameters[name] * (1 + 0.01 * np.arange(6).reshape(2, 3))
            )
    plain = SCENE.split("[log]")[1]
    mean = Scene.from_toml(scene_file(f"[plant]\nfit = 'fit.json'\n[log]{plain}")).plant
    assert mean == sysid.Plant(0.03, 2e-3, 32290.0, None, reference_temperature=26.0)
    drawn = Scene.from_toml(scene_file(f"[plant]\nfit = 'fit.json'\ndraw = 4\n[log]{plain}")).plant
    np.testing.assert_allclose([drawn.tau, drawn.G], [2e-3 * 1.04, 0.03 * 1.04])
    for draw in (6, -1):
        with pytest.raises(SceneError, match=f"found draw {draw}, expected one from 0 to 5"):
            Scene.from_toml(scene_file(f"[plant]\nfit = 'fit.json'\ndraw = {draw}\n[log]{plain}"))
    out = tmp_path / "out"
    assert main([str(scene_file()), "-o", str(out), "--fit", str(tmp_path / "fit.json")]) == 0
    log = sysid.read_logs(out / "press.csv")[0]
    quiet = Scene.from_toml(scene_file(SCENE.split("[effects.white")[0])).with_plant(mean)
    assert np.std(log.response - quiet.simulate().response) < 0.04  # noise of 0.02 in each part, nothing else


def test_every_effect_is_listed_with_defaults_that_a_scene_takes(capsys, scene_file):
    assert main(["--effects"]) == 0
    listed = capsys.readouterr().out
    assert list(tomllib.loads(listed)["effects"]) == list(EFFECTS)
    tables = [part for part in listed.split("\n\n") if "[effects." in part]
    bare = SCENE.split("[effects.")[0]
    for table in tables:
        text = bare + ("[effects.finger_damping]\n" if "finger_detuning]" in table else "") + table
        text = text.replace("voltage_V", "duty") if "inverter]" in table else text
        warm = "curved]" in table or "temperature_damping]" in table
        text = text.replace("frequency_kHz", "temperature_degC = 30\nfrequency_kHz") if warm else text
        Scene.from_toml(scene_file(text))


def test_a_command_of_its_own_says_how_it_is_used():
    done = subprocess.run([sys.executable, "-m", "sysid.scene.cli"], capture_output=True, text=True)
    assert done.returncode == 2 and "usage" in done.stderr


# --- the carrier
# -----------------------------------------------------------------------------------------------------------


def test_the_waveform_is_the_envelope_on_its_carrier(scene_file):
    text = SCENE.split("[effects.")[0].replace(
        "frequency_kHz = 32.3", "frequency_Hz = {ramp = [[0, 32200], [15e-3, 32400]]}"
    )
    scene = Scene.from_toml(scene_file(text))
    samples = next(iter(waveform(scene, 1e6)))
    t = samples.time
    # the integral of the ramp by hand, in turns
    turns = 32200 * t + 0.5 * 200 / 15e-3 * np.minimum(t, 15e-3) ** 2 + 200 * np.maximum(t - 15e-3, 0)
    drive = -np.where(t >= 2e-3, 100.0, 0.0) * np.sin(2 * np.pi * turns)  # Re[jV e^{j theta}]
    np.testing.assert_allclose(
        samples.drive, drive, atol=100 * 1e-8
    )  # 600 turns in float64, times 2 pi, and their sum
    exact = dataclasses.replace(scene, substeps=100).simulate()  # held over a microsecond, as the samples are
    every = slice(None, None, 100)
    carried = (exact.response * np.exp(2j * np.pi * turns[every])).real
    # a ramp held over a microsecond is off by 13 kHz/s (1 us)^2/8 of a turn, both ways alike up to how they
    # were summed
    np.testing.assert_allclose(samples.response[every], carried, atol=2 * 1e-7)


def test_the_carrier_behind_a_lock_in_is_the_exact_envelope_but_for_what_switching_leaves(scene_file):
    scene = Scene.from_toml(
        scene_file(SCENE.split("[effects.white")[0].replace("duration_ms = 20", "duration_ms = 30"))
    )
    exact, carrier = scene.simulate(), dataclasses.replace(scene, fidelity="carrier").simulate()
    assert len(carrier) == len(exact) and carrier.response[0] == 0
    off, size = np.abs(carrier.response - exact.response), np.max(np.abs(exact.response))
    Q = scene.plant.Q
    assert np.max(off) < size / (2 * Q) * 1.1  # the free part of the fast mode, as a real signal shows it
    # ten tau after the last change that is gone; what is left is the fast mode's settled ripple, seen as it
    # is
    assert off[-1] < 1e-4 * size
    filtered = SCENE.split("[effects.white")[0] + "[effects.lock_in]\ntau_us = 100\norder = 2\n"
    scene = Scene.from_toml(scene_file(filtered))
    off = np.abs(
        dataclasses.replace(scene, fidelity="carrier").simulate().response - scene.simulate().response
    )
    # (1/(2 omega tau))^2 of the image at twice the carrier is left; a filter of samples, 16 a period, is not
    # quite one of time
    assert np.max(off) < size * (1.1 / (2 * Q) + 1 / (4 * np.pi * 32300 * 1e-4) ** 2 + 0.01)


def test_rows_closer_than_two_periods_are_refused(scene_file):
    scene = dataclasses.replace(Scene.from_toml(scene_file()), rate=40e3, fidelity="carrier")
    with pytest.raises(SceneError, match="closer than two periods"):
        scene.simulate()


def test_a_carrier_that_aliases_is_refused(scene_file):
    with pytest.raises(SceneError, match=r"found 60000 samples a second, expected more than 2.2 times"):
        next(waveform(Scene.from_toml(scene_file()), 6e4))


# --- profiles
# -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("profile", "at", "integral"),
    [
        (Profile.constant(4.0), [4.0, 4.0, 4.0], [0.0, 6.0, 12.0]),
        (Profile([0, 1, 2], [1, 3, 2]), [1.0, 3.0, 2.0], [0.0, 2.5, 6.0]),
        (Profile([0, 1, 2], [1, 3, 2], held=False), [1.0, 2.5, 2.0], [0.0, 2 + 1.375, 2 + 2.5 + 2.0]),
        (Profile([0.5, 1, 2], [1, 3, 2], held=False), [1.0, 2.5, 2.0], [0.0, 1.5 + 1.375, 1.5 + 2.5 + 2.0]),
    ],
)
def test_profiles_and_their_integrals(profile, at, integral):
    time = np.array([0.0, 1.5, 3.0])
    np.testing.assert_allclose(profile.at(time), at)
    np.testing.assert_allclose(profile.integral(time), integral)
    np.testing.assert_allclose(profile.integral(time, less=0.5), np.array(integral) - 0.5 * time, atol=1e-14)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--draw", "5"], "--draw without --fit"),
        (["--logs", "0"], "found --logs 0"),
        (["--seed", "-1"], "found -1, expected a whole number from 0"),
        (["-o", ""], "found nothing, expected a folder"),
    ],
)
def test_options_that_would_do_nothing_are_refused(scene_file, capsys, given, said):
    with pytest.raises(SystemExit) as left:
        main([str(scene_file()), *given])
    assert left.value.code == 2 and said in capsys.readouterr().err
