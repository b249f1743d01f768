"""Presets: each on a file of the layout that its instrument writes, of a resonance in closed form; the
recognised need none."""

import re
import tomllib
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
import test_layouts
from refusal import refused
from test_files import citi, one_port, touchstone
from test_layouts import blocks_e4990a, labone, named_4294a, one_table, raw_4294a

import sysid
from sysid.columns import preset
from sysid.columns.mapfile import load_mapping
from sysid.command import presets as command
from sysid.logs.read import read_logs

F0, TAU = 32300.0, 1.67e-3
F = np.arange(31800.0, 32801.0, 20.0)
S = (
    0.05 / (1 + 2j * np.pi * (F - F0) * TAU) * np.exp(0.4j)
)  # a signal X + jY against cos(omega t), e^{+j omega t}
Y = 2j * np.pi * F * 2e-9 + 5e-4 / (1 + 2j * np.pi * (F - F0) * TAU)  # S, of a plate with its capacitance
Z = 1 / Y
CURRENT = Y / (2 * np.pi * F)  # the charge that 1 V drives, as Wd + jWq of a current
RMS = np.sqrt(2)
# Raw samples of an oscilloscope: the response lags by 0.6 rad.
DT, CARRIER = 2e-6, 32000.0
T = -1e-3 + DT * np.arange(4000)
DRIVE, ANSWER = 5 * np.cos(2 * np.pi * CARRIER * T), 0.7 * np.cos(2 * np.pi * CARRIER * T - 0.6)
SAMPLED = 0.7 * np.exp(-0.6j) * 1j  # Wd + jWq = j s of a displacement s, against the drive
# A demodulator over time: the plate rings down beside its resonance, from 10 mV.
TICK = {"mfli-stream": 60e6, "uhfli-stream": 1.8e9, "hf2li-stream": 210e6}
RING = 0.01 * np.exp((-1 / TAU + 2j * np.pi * 30.0) * 1e-4 * np.arange(60))


def rows(*columns, sep=",", form="%.11e", end=""):
    return "".join(sep.join(form % x for x in row) + end + "\n" for row in zip(*columns, strict=True))


def parts(z):
    return np.abs(z), np.degrees(np.angle(z))


def decibel(z):
    return 20 * np.log10(np.abs(z)), np.degrees(np.angle(z))


def stream(name):
    ticks = 7_000_000 + np.rint(1e-4 * np.arange(60) * TICK[name]).astype(int)
    head = "chunk;timestamp;x;y;freq;phase;dio;trigger;auxin0;auxin1\n"
    return head + "".join(
        f"0;{t};{s.real:.12g};{s.imag:.12g};32290;0.1;0;0;0;0\n" for t, s in zip(ticks, RING, strict=True)
    )


def siglent(*more):
    head = "Record Length,Analog:4000\nSample Interval,Analog:0.000002000\nVertical Units,CH1:V,CH2:V\n"
    head += "Vertical Scale,CH1:2.00,CH2:0.20\nVertical Offset,CH1:0.00000,CH2:0.00000\nHorizontal Units,s\n"
    head += "Horizontal Scale,0.000400000\nModel Number,SDS1104X-E\nSerial Number,SDSMMFCC000000\n"
    return head + "Software Version,8.1.6.1.33\nSource,CH1,CH2\nSecond,Volt,Volt\n" + rows(T, DRIVE, ANSWER)


TEKTRONIX = """Model,MDO3024
Firmware Version,1.26

Waveform Type,ANALOG,ANALOG,
Point Format,Y,Y,
Horizontal Units,s,s,
Horizontal Scale,0.0004,0.0004,
Sample Interval,2e-06,2e-06,
Record Length,4000,4000,
Gating,0.0% to 100.0%,0.0% to 100.0%,
Probe Attenuation,1,1,
Vertical Units,V,V,
Vertical Offset,0,0,
Vertical Scale,2,0.2,
Label,,,
TIME,CH1,CH2
"""
RIGOL = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.000000e-03,2.000000e-06\n"
DIGILENT = """#Digilent WaveForms {} Analyzer{}
#Device Name: Discovery2
#Serial Number: SN:210321A35FCC
#Date Time: 2018-10-29 18:31:51.647
#Start: 31800 Hz
#Stop: 32800 Hz
#Steps: 51
"""
BODE = 'Frequency (Hz);"Trace 1: Gain: Real ";"Trace 1: Gain: Imaginary ";Trace 1: Gain: Magnitude (dB);"Trace 2: Gain: Real ";'
BODE += '"Trace 2: Gain: Imaginary ";Trace 2: Gain: Phase (°)\n'
BODE_Z = "Frequency (Hz);Trace 1: Impedance: Magnitude (Ω);Trace 2: Impedance: Phase (°)\n"
MOKU = (
    "% Moku:Go Frequency Response Analyzer\n% Channel 1 - DC coupling, 10 Vpp range, amplitude 100 mVpp,"
    " offset 0.000 0 V\n"
)
MOKU += "% Linear sweep, measuring fundamental\n% Acquired 2024-03-31 T 12:00:00 +0200\n"
MOKU += "% Frequency (Hz), Channel 1 Magnitude (dB), Channel 1 Phase (deg)\n"
ENA = (
    "!CSV A.01.01\n!Keysight Technologies,E5061B,MY49304567,A.03.50\n!Date: Monday, March 31, 2024 12:00:00\n"
)
TIMES = 0.05 * np.arange(len(F))
# Of each preset: a file and what it is in the plate's frame (a response, or None of raw samples), with its
# name and mode.
FILES = {
    "e4990a": [("log.csv", one_table, None), ("log.csv", blocks_e4990a, None)],
    "hp4294a": [("log.txt", raw_4294a, None), ("log.txt", named_4294a, None)],
    "touchstone": [
        ("log.s1p", touchstone("# Hz S RI R 50", (F, one_port(Y, 50).real, one_port(Y, 50).imag)), CURRENT)
    ],
    "citi": [("log.cti", citi(F, {"S[1,1]": one_port(Y, 50)}), CURRENT)],
    "nanovna": [
        ("log.s1p", touchstone("# HZ S RI R 50", (F, one_port(Y, 50).real, one_port(Y, 50).imag)), CURRENT)
    ],
    "labone": [("log.csv", labone((F, S)), 1j * RMS * S)],
    "sr865": [
        (
            "log.txt",
            "# SR865A SN 004512\nt (s)\tFreq (Hz)\tX (V)\tY (V)\n" + rows(TIMES, F, S.real, S.imag, sep="\t"),
            1j * RMS * S,
        )
    ],
    "bode100": [
        (
            "log.csv",
            BODE + rows(F, S.real, S.imag, decibel(S)[0], S.real, S.imag, decibel(S)[1], sep=";"),
            1j * S,
        ),
        ("log.csv", BODE_Z + rows(F, *parts(Z), sep=";"), CURRENT),
    ],
    "moku": [("log.csv", MOKU + rows(F, *decibel(S), sep=", "), 1j * S)],
    "digilent": [
        (
            "log.csv",
            DIGILENT.format("Network", " - Bode")
            + "Frequency (Hz),Channel 1 Magnitude (dB),Channel 2 Magnitude (dB),Channel 2 Phase (°)\n"
            + rows(F, 0 * F - 3.1, *decibel(S)),
            1j * S,
        ),
        (
            "log.csv",
            DIGILENT.format("Impedance", "")
            + "Frequency (Hz),Trace θ (deg),Trace |Z| (Ohm),Trace Rs (Ohm),Trace Xs (Ohm)\n"
            + rows(F, parts(Z)[1], parts(Z)[0], Z.real, Z.imag),
            CURRENT,
        ),
    ],
    "keysight-vna": [
        (
            "log.csv",
            ENA + "BEGIN CH1_DATA\nFREQ(HZ),S21(DB),S21(DEG)\n" + rows(F, *decibel(S)) + "END\n",
            1j * S,
        ),
        (
            "log.csv",
            ENA + "BEGIN CH1_DATA\nFREQ(HZ),S21(REAL),S21(IMAG)\n" + rows(F, S.real, S.imag) + "END\n",
            1j * S,
        ),
    ],
    "rs-vna": [("log.csv", "freq[Hz];re:Trc1_S21;im:Trc1_S21\n" + rows(F, S.real, S.imag, sep=";"), 1j * S)],
    "hioki": [("log.csv", "FREQUENCY[Hz],Z[ohm],PHASE[deg]\n" + rows(F, *parts(Z)), CURRENT)],
    "keysight-scope": [("log.csv", "x-axis,1,2\nsecond,Volt,Volt\n" + rows(T, DRIVE, ANSWER), None)],
    "tektronix-scope": [("log.csv", TEKTRONIX + rows(T, DRIVE, ANSWER), None)],
    "rigol-scope": [
        ("log.csv", RIGOL + rows(np.arange(4000), DRIVE, ANSWER, end=","), None),
        ("log.csv", "Time(s),CH1(V),CH2(V)\n" + rows(T, DRIVE, ANSWER), None),
    ],
    "siglent-scope": [("log.csv", siglent(), None)],
    "picoscope": [
        ("log.csv", "Time,Channel A,Channel B\n(ms),(V),(V)\n\n" + rows(1e3 * T, DRIVE, ANSWER), None)
    ],
    **{name: [("log.csv", stream(name), RING * RMS * 1j)] for name in TICK},
}
SAMPLES = [
    pytest.param(name, *of, id=f"{name}-{k}") for name, files in FILES.items() for k, of in enumerate(files)
]
TRACES = ("e4990a", "hp4294a")  # over the frequencies of their own module
SCOPES = [name for name in FILES if name.endswith("scope")]
AUTOMATIC = ("e4990a", "hp4294a", "touchstone", "citi", "hioki")


def written(save, name, content):
    return save(content(test_layouts.Z) if callable(content) else content, name)


def is_what_it_should_be(log, name, expected):
    if name in SCOPES:
        np.testing.assert_allclose(log.drive, 5.0, rtol=1e-6)
        np.testing.assert_allclose(log.response, SAMPLED, rtol=1e-5)
        np.testing.assert_allclose(log.frequency, CARRIER, rtol=1e-9)
        return
    if name in TRACES:
        expected = 1 / test_layouts.Z / (2 * np.pi * test_layouts.F)
    np.testing.assert_allclose(
        log.response, expected, rtol=1e-8
    )  # of twelve digits, some of them in decibels
    if name in TICK:
        np.testing.assert_allclose(log.time - log.time[0], 1e-4 * np.arange(60), atol=1 / TICK[name])
        assert log.kind == "transient" and np.all(log.frequency == 32290)


def test_every_preset_has_a_sample_and_reads_as_a_mapping_file(save):
    assert set(FILES) == set(preset.presets())
    for name, one in preset.presets().items():
        mapping = load_mapping(save(one.text, f"{name}.toml"))
        assert mapping.finds and set(one.assumed) <= {*mapping.options, "columns"}
        assert one.text.startswith("#") and len(one.title) < 110 and one.instrument


def test_no_preset_recognises_the_files_of_another():
    for name, one in preset.presets().items():
        for other, files in FILES.items():
            if not one.recognised or other == name or {name, other} == {"touchstone", "nanovna"}:
                continue
            lines = [
                line.lstrip('#%! "')
                for _, text, _ in files
                if isinstance(text, str)
                for line in text.splitlines()[:20]
            ]
            assert not one.wrote(lines), (name, other)


@pytest.mark.parametrize(("name", "file", "content", "expected"), SAMPLES)
def test_a_preset_reads_the_files_of_its_instrument(save, name, file, content, expected):
    (log,) = read_logs(written(save, file, content), columns=f"preset:{name}")
    is_what_it_should_be(log, name, expected)
    said = " ".join(log.notes)
    assert f"read as preset:{name} says" in said
    ratio = name in (*AUTOMATIC, "nanovna") or expected is CURRENT
    assert ("taken as a displacement" in said) == (not ratio)  # what no file tells is said
    assert ("drive" in said and "response" in said) == (name in SCOPES)
    assert not log.warnings


RECOGNISED = [p for p in SAMPLES if preset.presets()[p.values[0]].recognised or p.values[0] == "nanovna"]


@pytest.mark.parametrize(("name", "file", "content", "expected"), RECOGNISED)
def test_a_recognised_instrument_needs_no_preset_or_is_asked_what_its_signal_shows_alone(
    save, name, file, content, expected
):
    path = written(save, file, content)
    if name in (*AUTOMATIC, "nanovna") or expected is CURRENT:
        (log,) = read_logs(path)
        is_what_it_should_be(log, name, expected)
        assert any(note.startswith("read as preset:") for note in log.notes)
        return
    if name not in SCOPES:
        (log,) = read_logs(path)
        is_what_it_should_be(log, name, expected)
        (said,) = (w for w in log.warnings if "nothing says what the signal shows" in w)
        assert "taken as a displacement" in said
        return
    error = refused(path, "quantity", f'--columns preset:{name} assumes quantity = "displacement"')
    live = [line for line in error.mapping.splitlines() if not line.startswith("#")]
    assert [line.partition(" =")[0] for line in live if '"?"' in line.partition("  #")[0]] == ["quantity"]
    (log,) = read_logs(path, columns=save(f'preset = "{name}"\nquantity = "displacement"\n', "map.toml"))
    is_what_it_should_be(log, name, expected)
    assert "taken as a displacement" not in " ".join(log.notes)


def test_oscilloscopes_are_read_without_a_preset_by_nobody(save):
    """Which channel is the drive no file tells."""
    for name in SCOPES:
        refused(written(save, *FILES[name][0][:2]), "expected")


def test_a_mapping_file_says_what_its_preset_leaves_or_says_otherwise(save):
    text = 'preset = "keysight-scope"\nquantity = "velocity"\n[columns]\nresponse = { unit = "m/s", scale = 0.125 }\n'
    path = written(save, *FILES["keysight-scope"][0][:2])
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 0.125 * SAMPLED / 1j / (2 * np.pi * CARRIER), rtol=1e-5)
    assert log.response_unit == "m" and "taken as a" not in " ".join(log.notes)
    text = 'preset = "keysight-scope"\n[columns]\ndrive = "2_Volt"\nresponse = "1_Volt"\n'
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(np.abs(log.response / log.drive), 5 / 0.7, rtol=1e-5)
    text = 'preset = "sr865"\namplitude = "peak"\nquantity = "velocity"\n'
    text += '[constants]\nvoltage = "2 V_rms"\n[metadata]\nplate = "A7"\n'
    (log,) = read_logs(written(save, *FILES["sr865"][0][:2]), columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, S / (2 * np.pi * F), rtol=1e-10)
    assert np.all(log.drive == 2 * RMS) and log.metadata["plate"] == "A7"


def test_a_gain_is_driven_by_one_and_an_impedance_by_its_own_volt(save):
    for (file, content, _), volts in zip(FILES["bode100"], (1.0, 1.0), strict=True):
        (log,) = read_logs(written(save, file, content), columns="preset:bode100")
        assert np.all(log.drive == volts) and log.drive_unit == "V"


def test_labone_s_hdf5_holds_a_chunk_a_log(tmp_path):
    with h5py.File(tmp_path / "sweep.h5", "w") as file:
        for k in range(2):
            group = file.create_group(f"{k:03d}/dev4220/demods/0/sample")
            header = np.zeros(1, [("systemtime", "u8"), ("name", "S32")])
            header["name"] = f"History_{k}"
            group["chunkheader"] = header
            for name, values in {
                "frequency": F,
                "grid": F,
                "x": S.real,
                "y": S.imag,
                "r": abs(S),
                "phase": np.angle(S),
            }.items():
                group[name] = (1 + k) * values if name in "xyr" else values
            group["timestamp"] = np.array([148203983402 + k], "u8")
    first, second = read_logs(tmp_path / "sweep.h5", columns="preset:labone")
    np.testing.assert_allclose(first.response, 1j * RMS * S, rtol=1e-12)
    np.testing.assert_allclose(second.response, 2j * RMS * S, rtol=1e-12)
    assert not first.warnings
    again, _ = read_logs(tmp_path / "sweep.h5")
    np.testing.assert_array_equal(again.response, first.response)
    assert "nothing says what the signal shows" in " ".join(again.warnings)


def test_names_of_presets(save):
    assert preset.named("mfli") is preset.named("labone")
    refused(save("a,b\n1,2\n"), "preset:e4990b", "did you mean 'e4990a'?", columns="preset:e4990b")
    refused(
        save("a,b\n1,2\n"), "map.toml, preset", "expected one of", columns=save('preset = "x"\n', "map.toml")
    )


def test_a_preset_of_another_kind_of_file_says_what_it_found(save):
    for text in (
        "time_ms,T (degC)\n0,1\n1,2\n2,4\n",
        "Frequency(Hz), Cp(F)-data, D-data\n1,2e-9,3\n2,2e-9,4\n3,2e-9,5\n",
    ):
        error = refused(save(text), "found no response", "preset:e4990a", columns="preset:e4990a")
        assert error.mapping


@pytest.mark.parametrize(
    "line", ["find = 3", 'find = true\n[columns]\nx = { scale = 2 }\n[units]\nx = "parsec"']
)
def test_what_a_mapping_file_gets_wrong_is_named(save, line):
    refused(written(save, *FILES["sr865"][0][:2]), "map.toml", "expected", columns=save(line, "map.toml"))


def test_the_command_lists_them_and_prints_one(capsys, save):
    assert command.main([]) == 0
    out = capsys.readouterr().out
    assert (
        all(re.search(rf"^{name}\s+\S", out, re.M) for name in FILES)
        and max(map(len, out.splitlines())) <= 80
    )
    assert command.main(["sr865"]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text)["amplitude"] == "rms"
    (log,) = read_logs(written(save, *FILES["sr865"][0][:2]), columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 1j * RMS * S, rtol=1e-10)
    assert command.main(["sr86"]) == 2 and "did you mean" in capsys.readouterr().err


def test_what_is_recognised_is_fitted_as_the_preset_is(save):
    """f0 and tau of an analyser's file without a word, within four of their errors."""
    s = one_port(1 / test_layouts.impedance(3), 50)
    path = save(touchstone("# Hz S RI R 50", (test_layouts.F, s.real, s.imag)), "plate.s1p")
    fit = sysid.fit(read_logs(path))
    assert fit.result == "successful", fit.warnings
    for name, true in (("f0", test_layouts.F0), ("tau", test_layouts.TAU)):
        assert abs(fit.parameters[name].value - true) < 4 * fit.parameters[name].std, name


def test_the_documentation_has_a_line_for_each():
    page = (Path(__file__).parents[1] / "docs" / "instruments.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| `([\w-]+)`", page, re.M)
    assert sorted(named) == sorted(FILES) and all(a != b for a, b in pairwise(named))
