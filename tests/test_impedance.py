"""Impedance and admittance, as analysers write them: read as the current that 1 V drives, drafted so, never
taken as a response.

The truth is that of the circuit R, L, C in series beside the capacitance C0, all of whose impedances are
added here.
"""

import numpy as np
import pytest
from refusal import changed, draft_of, refused

import sysid
from sysid.logs.read import read_logs

R, L, C, C0 = (
    20.0,
    0.0568,
    5.7e-10,
    4e-9,
)  # a Langevin transducer: 27.97 kHz, Q of 499, its antiresonance 1.9 kHz above
OMEGA0 = 1 / np.sqrt(L * C)
TRUTH = {"G": 1 / (R * OMEGA0), "tau": 2 * L / R, "f0": OMEGA0 / (2 * np.pi)}
FREQUENCY = np.linspace(27e3, 29.5e3, 801)
NOISE = 0.002


def impedance(frequency, seed=None):
    """Of the circuit, with what is read of it: a fraction of it is noise."""
    s = 2j * np.pi * frequency
    Z = 1 / (s * C0 + 1 / (R + s * L + 1 / (s * C)))
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(len(s)) + 1j * rng.standard_normal(len(s))
    return Z if seed is None else Z * (1 + NOISE * noise)


Z_PARTS = {
    "f_Hz,R_ohm,X_ohm": lambda Z: (Z.real, Z.imag),
    "Frequency[Hz],R[kOhm],X[kOhm]": lambda Z: (Z.real / 1e3, Z.imag / 1e3),
    "Freq(Hz),|Z|(ohm)-data,θz(deg)-data": lambda Z: (np.abs(Z), np.degrees(np.angle(Z))),
    "Frequency (Hz),Impedance (Ω),Phase (deg)": lambda Z: (np.abs(Z), np.degrees(np.angle(Z))),
    "f_Hz,Rs [\u2126],Xs [\u2126]": lambda Z: (Z.real, Z.imag),
    "f_Hz,R,X": lambda Z: (Z.real, Z.imag),
    "Frequency[Hz],G[S],B[S]": lambda Z: ((1 / Z).real, (1 / Z).imag),
    "Frequency (Hz),|Y| (mS),θy (°)": lambda Z: (1e3 / np.abs(Z), np.degrees(np.angle(1 / Z))),
}


def table(header, Z, frequency=FREQUENCY):
    rows = zip(frequency, *Z_PARTS[header](Z), strict=True)
    return header + "\n" + "".join(",".join(f"{x:.12g}" for x in row) + "\n" for row in rows)


@pytest.mark.parametrize("header", Z_PARTS)
def test_a_draft_reads_it_as_it_stands(save, header):
    """Wd + jWq is the charge of the current, (1/Z) / omega: of C0 a constant, of R, L, C the resonance."""
    path = save(table(header, impedance(FREQUENCY)))
    (log,) = read_logs(path, columns=save(draft_of(path), "map.toml"))
    np.testing.assert_array_equal(
        read_logs(path)[0].response, log.response
    )  # which is what is done without it
    np.testing.assert_allclose(log.response, 1 / impedance(FREQUENCY) / (2 * np.pi * FREQUENCY), rtol=1e-10)
    assert log.response_unit == "C"
    assert (log.kind, set(log.drive.tolist()), log.drive_unit, log.relative_noise) == (
        "steady",
        {1.0},
        "V",
        True,
    )
    assert not [note for note in log.notes if "taken as" in note]  # nothing is left to be assumed


@pytest.mark.parametrize("header", [*Z_PARTS][:3:2] + ["Frequency[Hz],G[S],B[S]"])
def test_its_resonance_is_found_and_not_the_antiresonance(save, header):
    z = []
    for seed in range(10):
        path = save(table(header, impedance(FREQUENCY, seed)))
        fit = sysid.fit(read_logs(path))
        assert fit.result.name == "successful", fit.warnings
        z += [(fit.parameters[name].value - true) / fit.parameters[name].std for name, true in TRUTH.items()]
    assert (
        np.sqrt(np.mean(np.square(z))) < 1.6 and np.max(np.abs(z)) < 4.0
    )  # 30 numbers of which thirds are correlated
    assert fit.parameters["G"].unit == "C/V"


MAP = """quantity = "impedance"
[columns]
frequency = "f_Hz"
x = "R_ohm"
y = "X_ohm"
"""


def test_an_amplitude_alone_and_the_sign_of_its_phase(save):
    path, Z = save(table("f_Hz,R_ohm,X_ohm", impedance(FREQUENCY))), impedance(FREQUENCY)
    (log,) = read_logs(
        path, columns=save(MAP.replace('x = "R_ohm"\ny = "X_ohm"', 'magnitude = "R_ohm"'), "map.toml")
    )
    np.testing.assert_allclose(log.response, 1 / Z.real / (2 * np.pi * FREQUENCY), rtol=1e-10)
    (log,) = read_logs(
        path, columns=save("phase_sign = -1\n" + MAP + '[constants]\nvoltage = "1 V"\n', "map.toml")
    )
    np.testing.assert_allclose(log.response, 1 / np.conj(Z) / (2 * np.pi * FREQUENCY), rtol=1e-10)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "impedance",
            "displacement",
            ["column 'R_ohm'", "found ohm", 'expected quantity = "impedance"', "map.toml"],
        ),
        ("impedance", "current", ["column 'R_ohm'", "found ohm", 'expected quantity = "impedance"']),
        ('quantity = "impedance"', "", ["column 'R_ohm'", 'expected quantity = "impedance"']),
        (
            '"R_ohm"',
            '{ column = "R_ohm", unit = "V" }',
            ["[columns] x", "'V' of an impedance", "expected ohm"],
        ),
        ("[columns]", 'amplitude = "rms"\n[columns]', ["[columns] ", "'rms' of an impedance", "ratio"]),
        (
            "[columns]",
            '[constants]\ndrive = "2 A"\n[columns]',
            ["quantity", "[constants] drive", "expected no drive"],
        ),
        (
            'frequency = "f_Hz"',
            'time = { column = "f_Hz", unit = "s" }',
            ["the current through an impedance", "no frequency"],
        ),
    ],
)
def test_what_is_refused(save, old, new, words):
    path = save(table("f_Hz,R_ohm,X_ohm", impedance(FREQUENCY)))
    refused(path, *words, columns=save(changed(MAP, old, new), "map.toml"))


def test_columns_of_the_contract_s_names_in_ohm_are_refused(save):
    text = "f_Hz,w_ohm\n" + "".join(f"{100 + k},{k + 1}\n" for k in range(9))
    assert (
        'quantity = "impedance"'
        in refused(save(text), "column 'w_ohm'", 'expected quantity = "impedance"').mapping
    )


def test_an_impedance_of_zero_is_refused_by_its_row(save):
    text = "f_Hz,R_ohm,X_ohm\n" + "".join(f"{100 + k},{k - 4},0\n" for k in range(9))
    refused(save(text), "log.csv, row 4", "0 ohm", columns=save(MAP, "map.toml"))


def test_a_thermistor_s_ohms_are_no_impedance(save):
    text = "f_Hz,X (V),Y (V),NTC (ohm)\n" + "".join(f"{100 + k},{k},1,5\n" for k in range(9))
    assert 'quantity = "?"' in refused(save(text)).mapping


ADMITTANCE = """quantity = "current"
phase_sign = 1
[columns]
frequency = "Frequency[Hz]"
x = "G[S]"
y = "B[S]"
"""


def admittance(save, extra=""):
    path = save(table("Frequency[Hz],G[S],B[S]", impedance(FREQUENCY)))
    return read_logs(path, columns=save(ADMITTANCE + extra, "map.toml"))[0]


@pytest.mark.parametrize(
    ("stated", "volts"), [("", 1.0), ("1 V", 1.0), ("0.5 V", 0.5), ("500 mV", 0.5), ("1 V_rms", np.sqrt(2))]
)
def test_an_admittance_is_a_current_under_its_own_voltage(save, stated, volts):
    """The charge per volt is the admittance over omega, at whatever level the analyser was set to."""
    log = admittance(save, f'[constants]\nvoltage = "{stated}"\n' if stated else "")
    unit = {"V": 1.0, "mV": 1e-3}[log.drive_unit]
    np.testing.assert_allclose(log.drive * unit, volts, rtol=1e-12)
    expected = 1 / impedance(FREQUENCY) / (2 * np.pi * FREQUENCY)
    np.testing.assert_allclose(log.response / (log.drive * unit), expected, rtol=1e-9)
    assert log.response_unit == "C"


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ('[constants]\nduty = "0.5"\n', ["quantity", "beside an admittance", "expected a voltage"]),
        ('[constants]\ndrive = "1 A"\n', ["quantity", "in A beside an admittance", "or no drive"]),
    ],
)
def test_an_admittance_has_no_other_drive(save, extra, words):
    path = save(table("Frequency[Hz],G[S],B[S]", impedance(FREQUENCY)))
    refused(path, *words, columns=save(ADMITTANCE + extra, "map.toml"))


def test_an_admittance_has_no_effective_value(save):
    path = save(table("Frequency[Hz],G[S],B[S]", impedance(FREQUENCY)))
    mapping = save('amplitude = "rms"\n' + ADMITTANCE, "map.toml")
    refused(path, "[columns] x", "'rms' of an admittance", "ratio", columns=mapping)


def test_standard_errors_of_an_admittance_follow_its_voltage(save):
    Y = 1 / impedance(FREQUENCY)
    rows = zip(FREQUENCY, Y.real, Y.imag, 1e-6 * np.abs(Y), strict=True)
    text = "Frequency[Hz],G[S],B[S],std[S]\n" + "".join(",".join(f"{x:.12g}" for x in r) + "\n" for r in rows)
    given = ADMITTANCE + 'std = "std[S]"\n[constants]\nvoltage = "0.5 V"\n'
    (log,) = read_logs(save(text), columns=save(given, "map.toml"))
    np.testing.assert_allclose(log.std / np.abs(log.response), 1e-6, rtol=1e-9)


def coil(frequency, seed=None):
    """Impedance (ohm) of a coil of 25 ohm and 0.3 mH in a magnet: R + j w L and the motion of a resonance at
    175 Hz, Q of 15, which adds 15 ohm at its peak."""
    x = 1j * frequency / 175
    z = 25 + 2j * np.pi * frequency * 3e-4 + 15 * (x / 15) / (1 + x / 15 + x**2)
    rng = np.random.default_rng(seed)
    return z * (1 + NOISE * (rng.standard_normal((2, len(frequency))).T @ [1, 1j]))


COIL = """quantity = "velocity"
[columns]
frequency = { column = "f_Hz", unit = "Hz" }
x = { column = "R_ohm", unit = "ohm" }
y = { column = "X_ohm", unit = "ohm" }
"""


@pytest.mark.parametrize(("low", "high"), [(120, 260), (20, 2000)])
def test_a_coil_is_read_by_the_voltage_of_its_motion(save, low, high):
    """Over two octaves and a half, and two decades: what its resistance adds to the flux goes with 1/f."""
    f, truth, z = np.geomspace(low, high, 281), {"tau": 15 / (np.pi * 175), "f0": 175.0}, []
    truth["G"] = 15 / (2 * np.pi * 175)
    for seed in range(4):
        Z = coil(f, seed)
        path = save(
            "f_Hz,R_ohm,X_ohm\n" + "".join(f"{a},{b.real},{b.imag}\n" for a, b in zip(f, Z, strict=True))
        )
        fit = sysid.fit(read_logs(path, columns=save(COIL, "map.toml")))
        assert fit.result is sysid.Result.successful, fit.warnings
        assert fit.parameters["G"].unit == "V*s/A"
        z += [(fit.parameters[name].value - true) / fit.parameters[name].std for name, true in truth.items()]
    assert np.sqrt(np.mean(np.square(z))) < 1.8 and np.max(np.abs(z)) < 4.0


def test_an_impedance_of_a_coil_is_told_from_that_of_a_plate(save):
    """By its ends, a resistance where a plate's are capacitances, and by what grows between."""
    f, head = np.linspace(120, 260, 281), "f_Hz,R_ohm,X_ohm\n"
    for Z, at, told in ((coil(f, 0), f, True), (impedance(FREQUENCY, 0), FREQUENCY, False)):
        rows = "".join(f"{a},{b.real},{b.imag}\n" for a, b in zip(at, Z, strict=True))
        (log,) = read_logs(save(head + rows))
        assert any("that of a coil" in said for said in log.warnings) is told


def test_a_coil_in_volts_per_ampere_is_one_in_ohm(save):
    f = np.linspace(120, 260, 41)
    rows = "".join(f"{a},{b.real},{b.imag}\n" for a, b in zip(f, coil(f), strict=True))
    path, units = save("f_Hz,R_ohm,X_ohm\n" + rows), ("ohm", "V/A")
    logs = [read_logs(path, columns=save(COIL.replace('"ohm"', f'"{of}"'), "map.toml"))[0] for of in units]
    np.testing.assert_allclose(logs[0].response, logs[1].response, rtol=1e-12)
    assert {(log.response_unit, log.drive_unit) for log in logs} == {("V*s", "A")}


def test_an_impedance_may_state_its_drive(tmp_path):
    """R1, L1 and C1 beside C0 by what an analyser shows: at 0.5 V half the charge moves, of the same plate."""
    f = np.linspace(27400.0, 28900.0, 301)
    w = 2 * np.pi * f
    z = 1 / (1j * w * 3.4e-9 + 1 / (34.0 + 1j * w * 0.0867 + 1 / (1j * w * 3.69e-10)))
    head = "Frequency(Hz),Z(Ohm),Phase(deg)"
    found = []
    for name, more, volts in (("plain", "", None), ("level", ",Osc Level(V)", 0.5)):
        cells = [f, np.abs(z), np.degrees(np.angle(z)), *([] if volts is None else [np.full(301, volts)])]
        rows = "".join(",".join(f"{c:.9g}" for c in row) + "\n" for row in zip(*cells, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"{head}{more}\n{rows}")
        found += sysid.read_logs(tmp_path / f"{name}.csv")
    plain, level = found
    np.testing.assert_allclose(level.drive, 0.5)
    np.testing.assert_allclose(level.response, 0.5 * plain.response, rtol=1e-12)
    assert (level.response_unit, level.drive_unit) == ("C", "V")
