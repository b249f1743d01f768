"""Touch files that cannot be, each refused with its key; what is named as a warning; the command."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import sysid
from stimulator import TouchScene
from stimulator.cli import main
from sysid import SceneError

FILES = Path(__file__).parents[1] / "data" / "synthetic" / "touch_scenes"
GRATING = (FILES / "grating.toml").read_text(encoding="utf-8")
RAMP = "x_mm = {ramp = [[0, 54], [0.6, 144], [1.2, 54]]}"


@pytest.fixture
def folder(tmp_path):
    shutil.copy(FILES / "plate.toml", tmp_path)
    return tmp_path


def written(folder, *changes, plate=()):
    """The grating with each (old, new), `old` a whole table's name in brackets: that table."""
    text = GRATING
    for old, new in changes:
        if re.fullmatch(r"\[[a-z.]+\]", old):
            text, found = re.subn(
                re.escape(old) + r".*?(?=\n\[|\Z)", lambda _, new=new: new, text, flags=re.S
            )
            assert found == 1, old
        else:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
    content = (folder / "plate.toml").read_text()
    for old, new in plate:
        assert content.count(old) == 1, old
        content = content.replace(old, new)
    (folder / "plate.toml").write_text(content)
    (folder / "touch.toml").write_text(text)
    return folder / "touch.toml"


WRONG = {
    "a force twice": (
        [("force_N = 0.5", "force_N = 0.5\nforce_mN = 500")],
        "stroke.force: found force_N and force_mN",
    ),
    "no plate": ([('plate_scene = "plate.toml"', "")], "plate_scene: found nothing"),
    "no such plate": ([('"plate.toml"', '"none.toml"')], "none.toml: cannot be read"),
    "a number for a plate": ([('"plate.toml"', "3")], "plate_scene: found 3"),
    "an unknown table": ([("[observer]", "[watcher]\nweber = 0.18")], "watcher: found an unknown key"),
    "a table that is a number": (
        [("[observer]", ""), ("seed = 1 ", "observer = 1\nseed = 1 ")],
        "observer: found 1, expected a table",
    ),
    "a seed that is none": ([("seed = 1 ", "seed = -1 ")], "seed: found -1"),
    "a plate without area": ([("seed = 1 ", "plate_mm = [198, 0]\nseed = 1 ")], "plate_mm"),
    "texture without stroke": (
        [("[stroke]", ""), ("[finger]", ""), ("[forces]", ""), ("[forces.filter]", "")],
        "stroke: found nothing",
    ),
    "observer without friction": (
        [("[friction]", "")],
        r"friction: found nothing, expected a table \[friction\]",
    ),
    "observer without texture": (
        [("[texture]", "")],
        r"texture: found nothing, expected a table \[texture\]",
    ),
    "no x": ([(RAMP, "")], "stroke.x_mm: found nothing"),
    "no force": ([("force_N = 0.5", "")], "stroke.force_N: found nothing"),
    "a position in newtons": ([("x_mm =", "x_N =")], "stroke.x_N.ramp: found the unit 'N'"),
    "a position that is NaN": (
        [("[0.6, 144]", "[0.6, nan]")],
        "stroke.x_mm.ramp: found a time or a value that is not finite",
    ),
    "times that go back": ([("[1.2, 54]", "[0.5, 54]")], "stroke.x_mm.ramp: found time 0.5 s after 0.6 s"),
    "a negative force": ([("force_N = 0.5", "force_N = -0.5")], "stroke.force: found -0.5 N"),
    "a force that becomes negative": (
        [("force_N = 0.5", "force_N = {ramp = [[0, 1], [1, -0.2]]}")],
        "stroke.force: found -0.2 N at 1 s",
    ),
    "a force that is NaN": (
        [("force_N = 0.5", "force_N = nan")],
        "stroke.force_N: found a time or a value that is not finite",
    ),
    "a stroke off the end": (
        [("[0.6, 144]", "[0.6, 204]")],
        "stroke.x: found 204 mm at 0.6 s, expected 0 to 198 mm",
    ),
    "a stroke off the side": ([("y_mm = 69", "y_mm = -1")], "stroke.y: found -1 mm"),
    "a stroke off a smaller plate": (
        [("seed = 1 ", "plate_mm = [76, 41]\nseed = 1 ")],
        "stroke.x: found 144 mm",
    ),
    "an unknown key of the stroke": (
        [("y_mm = 69", "y_mm = 69\nspeed = 3")],
        "stroke.speed: found an unknown key",
    ),
    "no such recording": (
        [(RAMP, 'csv = "none.csv"'), ("y_mm = 69\nforce_N = 0.5", "")],
        "none.csv: cannot be read",
    ),
    "a wave without length": ([("wavelength_mm = 18.7", "wavelength_mm = 0")], "finger.wavelength"),
    "a finger of seconds": ([("width_mm = 10", "width_s = 10")], "finger.width_s: found the unit 's'"),
    "sensors at no rate": ([("rate_kHz = 1", "rate_kHz = 0")], "forces.rate"),
    "sensors of negative noise": ([("noise_mN = 1.5", "noise_mN = -1.5")], "forces.noise"),
    "a contact of nothing": ([("contact_N = 0.05", "contact_N = 0")], "forces.contact"),
    "an unknown filter": (
        [('kind = "kalman"', 'kind = "butterworth"')],
        "forces.filter.kind: found butterworth, expected none or",
    ),
    "a filter's unknown key": (
        [("latency_ms = 1", "latency_ms = 1\ntau_ms = 5")],
        "forces.filter.tau_ms: found an unknown key",
    ),
    "an unknown texture": ([('kind = "square"', 'kind = "saw"')], "texture.kind: found saw"),
    "a period of nothing": ([("period_mm = 5", "period_mm = 0")], "texture.period"),
    "an amplitude of neither kind": (
        [("amplitude_um_peak", "amplitude_um")],
        "texture.amplitude_um: .*peak or peak to peak",
    ),
    "two amplitudes": (
        [("period_mm = 5", "period_mm = 5\namplitude_um_pp = 2")],
        "texture.amplitude: .*once",
    ),
    "an amplitude in volts": (
        [("amplitude_um_peak", "amplitude_V_peak")],
        "texture.amplitude_V_peak: found the unit 'V'",
    ),
    "a negative amplitude": ([("amplitude_um_peak = 1.0", "amplitude_um_peak = -1.0")], "texture.amplitude"),
    "no image": (
        [('kind = "square"', 'kind = "image"'), ("period_mm = 5", "pixel_mm = 1")],
        "texture.image: found nothing",
    ),
    "an unknown law": ([('"partial_levitation"', '"coulomb"')], "friction.law: found coulomb"),
    "friction below zero": ([("mu0 = 0.8", "mu0 = -0.8")], "friction.mu0"),
    "an unknown key of friction": ([("mu0 = 0.8", "mu = 0.8")], "friction.mu: found an unknown key"),
    "an unknown method": ([('method = "paper"', 'method = "magic"')], "loop: .*method = 'magic'"),
    "a limit in hertz": (
        [("voltage_limit_V = 350", "voltage_limit_Hz = 350")],
        "loop.voltage_limit_Hz: found the unit 'Hz'",
    ),
    "a limit that is too low": ([("voltage_limit_V = 350", "voltage_limit_V = 20")], "loop: "),
    "a lapse of more than all": ([("lapse = 0.03", "lapse = 1.5")], "observer.lapse"),
    "a Weber fraction of nothing": ([("weber = 0.18", "weber = 0")], "observer.weber"),
    "an unknown intensity": ([("floor = 0.02", 'intensity = "felt"')], "observer.intensity: found felt"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_refused_with_its_key(name, folder):
    changes, said = WRONG[name]
    path = written(folder, *changes)
    with pytest.raises(SceneError, match=said) as refused:
        TouchScene.from_toml(path).designed  # noqa: B018
    assert "toml: " in str(refused.value) or "csv: " in str(refused.value)


def test_a_finger_needs_a_damping_to_place(folder):
    text = (folder / "plate.toml").read_text()
    path = written(folder, plate=[(text[text.index("[effects") :], "")])
    with pytest.raises(SceneError, match=r"plate_scene: found no effects\.finger_damping"):
        TouchScene.from_toml(path)


def test_a_texture_is_a_length_asked_for_in_volts(folder):
    duty = [
        ("voltage_V = 50", "duty = 0.1"),
        ("[effects.finger_damping]", "[effects.inverter]\n[effects.finger_damping]"),
    ]
    with pytest.raises(SceneError, match=r"plate_scene: found effects\.inverter"):
        TouchScene.from_toml(written(folder, plate=duty))
    shutil.copy(FILES / "plate.toml", folder)
    speed = [("G_um_per_V = 0.02", "G = 0.02"), ('plate = "A7"', 'response_unit = "m/s"')]
    with pytest.raises(SceneError, match="plate_scene: found a response in m/s"):
        TouchScene.from_toml(written(folder, plate=speed))


def test_a_plate_in_other_units_is_the_same_plate(folder):
    in_um = TouchScene.from_toml(written(folder, *OPENED, plate=[SHORT])).run()
    other = [("G_um_per_V = 0.02", "G_um_per_V = 0.02"), ('plate = "A7"', 'response_unit = "nm"')]
    in_nm = TouchScene.from_toml(written(folder, *OPENED, plate=other)).run()
    np.testing.assert_allclose(in_nm.W, 1e3 * in_um.W, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(in_nm.friction, in_um.friction, rtol=1e-9)


def test_a_touch_takes_time(folder):
    path = written(folder, plate=[("duration_s = 1.2", 'rows = 10\nkind = "steady"')])
    with pytest.raises(SceneError, match="plate_scene: found a scene of settled points"):
        TouchScene.from_toml(path)


SHORT = ("duration_s = 1.2", "duration_s = 0.1")
OPENED = [("[observer]", ""), ("[loop]", "")]
NAMED = {
    "an observer who compares nothing": (
        [("[observer]", "[observer]\nweber = 0.2")],
        [SHORT],
        "observer: there is no loop",
    ),
    "a period below what the sensors resolve": (
        [("period_mm = 5", "period_mm = 0.5")],
        [SHORT],
        "below what the sensors resolve",
    ),
    "a period below a reading": ([("rate_kHz = 1", "rate_Hz = 20")], [SHORT], "between two readings"),
    "a stroke that goes on": ([], [SHORT], "stroke: it goes on to 1.2 s"),
    "a finger that is too light": (
        [("force_N = 0.5", "force_N = 0.04")],
        [SHORT],
        "forces.contact: the force falls to 0.04 N",
    ),
    "a finger that is too heavy": (
        [("contact_N", "range_N = 0.2\ncontact_N")],
        [SHORT],
        "forces.range: found a force of 0.5 N",
    ),
    "an amplitude below the film's": (
        [("amplitude_um_peak", "amplitude_um_pp")],
        [SHORT],
        "friction: the texture asks for 0.5 um",
    ),
    "a frequency below the film's": (
        [],
        [SHORT, ("f0_Hz = 32300", "f0_Hz = 22000")],
        "friction: the plate vibrates at 22000 Hz",
    ),
}


@pytest.mark.parametrize("name", NAMED)
def test_what_lies_beyond_is_named(name, folder):
    changes, plate, said = NAMED[name]
    opened = [change for change in OPENED if change[0] not in {old for old, _ in changes}]
    touch = TouchScene.from_toml(written(folder, *changes, *opened, plate=plate)).run()
    assert any(said in warning for warning in touch.warnings), touch.warnings


def test_a_voltage_at_its_limit_is_named(folder):
    # 1 um is 50 V, and under 1.5 N 100 V: a loop that was told of no finger has no more than 60
    changes = [("[observer]", ""), ("force_N = 0.5", "force_N = 1.5")]
    small = ("voltage_limit_V = 350", "voltage_limit_V = 60\nfinger = 0")
    scene = TouchScene.from_toml(written(folder, *changes, small, plate=[SHORT]))
    assert any(warning.startswith("loop.voltage_limit") for warning in scene.run().warnings)


def test_the_amplitude_is_what_its_name_says(folder):
    peak = TouchScene.from_toml(written(folder)).texture
    pp = TouchScene.from_toml(written(folder, ("amplitude_um_peak = 1.0", "amplitude_nm_pp = 2000"))).texture
    assert peak == pp and peak.amplitude == 1.0


def test_the_command_plays_touches_and_scenes(folder, capsys):
    path = written(folder, *OPENED, ("period_mm = 5", "period_mm = 0.5"), plate=[SHORT])
    assert main([str(path), str(folder / "plate.toml"), "-o", str(folder / "logs"), "--seed", "2"]) == 0
    assert "warning: texture: " in capsys.readouterr().err
    touch, plate = sysid.read_logs([folder / "logs" / "touch.csv", folder / "logs" / "plate.csv"])
    assert len(touch) == len(plate) == 1001 and touch.force[0] == 0.5
    again = TouchScene.from_toml(path)
    assert again.seed == 1  # the command's seed is added to the file's


def test_the_command_names_what_is_wrong(folder, capsys):
    path = written(folder, ("force_N = 0.5", "force_N = -0.5"))
    assert main([str(path), "-o", str(folder / "logs")]) == 2
    assert "touch.toml: stroke.force: found -0.5 N" in capsys.readouterr().err
    assert main([str(written(folder, *OPENED)), "--waveform", "1e6", "-o", str(folder / "logs")]) == 2
    assert "--waveform" in capsys.readouterr().err and not list((folder / "logs").glob("*"))
