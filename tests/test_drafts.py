"""Drafts of mapping files, for the heads that instruments, spreadsheets and people write: what is asked, and
what is read.

The truth is a resonance in closed form, written under each head; a person answers every "?" of the draft and
nothing else.
"""

import re
import tomllib

import numpy as np
import pytest
from refusal import draft_of, refused

from sysid.columns.labels import parse
from sysid.logs.read import read_logs
from sysid.tables import units

F = np.arange(31800.0, 32801.0, 20.0)
S = 0.05 / (1 + 2j * np.pi * (F - 32300) * 1.67e-3) * np.exp(0.4j)  # a lock-in's X + jY
Y = 2j * np.pi * F * 2e-9 + 5e-4 / (
    1 + 2j * np.pi * (F - 32300) * 1.67e-3
)  # S, of a plate with its capacitance
T = 0.05 * np.arange(len(F))
DRIVE = np.where(T > 0.3, 5.0, 0.0)
SPEED = 90 * (1 - np.exp(-np.clip(T - 0.3, 0, None) / 0.4)) - 3.0


def re_im(w):
    return w.real, w.imag


def polar(w):
    return np.abs(w), np.degrees(np.angle(w))


def decibel(w):
    return 20 * np.log10(np.abs(w)), np.degrees(np.angle(w))


def table(head, *columns):
    mark = ";" if ";" in head else ","
    rows = zip(*columns, strict=True)
    return (head + "\n" if head else "") + "".join(mark.join(f"{x:.15g}" for x in row) + "\n" for row in rows)


ANSWERS = {"amplitude": '"peak"', "quantity": '"displacement"', "phase_sign": "1"}
UNITS = {"time": "s", "frequency": "Hz", "phase": "deg", "voltage": "V", "duty": "1"}


def live(draft):
    """The lines of a draft that are no comments, less the comments behind them."""
    return [line.partition("  #")[0] for line in draft.splitlines() if line and not line.startswith("#")]


def answered(draft, unit="V"):
    """The draft with every "?" answered: by what the columns here hold."""
    lines = []
    for line in live(draft):
        key = line.partition(" =")[0]
        lines.append(line.replace('"?"', ANSWERS.get(key, f'"{UNITS.get(key, unit)}"')))
    return "\n".join(lines)


def asked(draft):
    return [line.partition(" =")[0] for line in live(draft) if '"?"' in line]


RATIOS = {
    "Frequency (Hz),Y re (S),Y im (S)": (0, re_im, Y),
    "Frequency (Hz),Z re (Ohm),Z im (Ohm)": (0, re_im, 1 / Y),
    "f / Hz,Re[Z] / Ohm,Im[Z] / Ohm": (0, re_im, 1 / Y),
    "Frequency (Hz),Re[Z],Im[Z]": (0, re_im, 1 / Y),
    "freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm": (0, lambda z: (z.real, -z.imag), 1 / Y),
    "Frequency (Hz),Z' (Ω),-Z'' (Ω)": (0, lambda z: (z.real, -z.imag), 1 / Y),
    "Freq(Hz),Zreal(ohm),Zimag(ohm)": (0, re_im, 1 / Y),
    "FREQUENCY[Hz],Z[ohm],PHASE[deg]": (0, polar, 1 / Y),
    "Freq [Hz];|Z| [Ohm];Phase [Deg]": (0, polar, 1 / Y),
    "FREQ.(HZ),RS(OHM),XS(OHM)": (0, re_im, 1 / Y),
    "Frequency (Hz),Trace 1: Impedance: Magnitude (Ω),Trace 2: Impedance: Phase (°)": (0, polar, 1 / Y),
    "Frequency Hz,Impedance Ohm,Phase deg": (0, polar, 1 / Y),
    "Frequency(Hz), |Z|(Ohm)-data, theta-z(deg)-data": (0, polar, 1 / Y),
    "Frequency(Hz), |Y|(S)-data, theta-y(deg)-data": (0, polar, Y),
    "FrequencyHz,ZabsOhm,PhaseDeg": (0, polar, 1 / Y),
    "Frequency,Zmod,Zphz": (1, polar, 1 / Y),  # its frequency may be in kHz
}


@pytest.mark.parametrize("head", RATIOS)
def test_an_impedance_or_an_admittance_needs_no_answer_but_a_unit_that_is_not_stated(save, head):
    edits, write, ratio = RATIOS[head]
    path = save(table(head, F, *write(ratio)))
    draft = draft_of(path)
    assert len(asked(draft)) == edits, draft
    (log,) = read_logs(path, columns=save(answered(draft) if edits else draft, "map.toml"))
    np.testing.assert_allclose(log.response, Y / (2 * np.pi * F), rtol=1e-12)
    assert not [note for note in log.notes if "taken as" in note]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("units", ["um", "V"])
@pytest.mark.parametrize("head", ["Frequency [Hz];X [{}];Y [{}]", "f (Hz),Amplitude ({}),Phase (deg)"])
def test_what_the_heads_leave_open_is_taken_as_usual_and_told(save, head, units, sign):
    """A displacement, peak, with the sign by which its phase falls with the frequency."""
    signal = S if sign > 0 else S.conj()
    path = save(table(head.format(units, units), F, *(polar if "Phase" in head else re_im)(signal)))
    (log,) = read_logs(path)
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-9)
    told = " ".join(log.notes)
    assert "read by the heads of its columns: " in told and "is taken as peak" in told
    assert "of its conjugate where it rises with the frequency" in told
    assert ("nothing says what the signal shows" in " ".join(log.warnings)) == (units == "V")


def test_peak_amplitudes_beside_a_drive_are_a_warning(save):
    (log,) = read_logs(save(table("Frequency [Hz],Voltage [V],X [um],Y [um]", F, 0 * F + 5, *re_im(S))))
    (said,) = log.warnings
    assert "both are taken as peak, by which G goes" in said
    beside = table("Frequency [Hz],X [um],Y [um],励振[V],湿度", F, *re_im(S), 0 * F + 5, 0 * F + 40)
    (log,) = read_logs(save(beside))
    assert any("'励振[V]' as voltage; not 湿度; a mapping file" in said for said in log.notes)
    stated = table("Frequency [Hz],Voltage [Vrms],X [um rms],Y [um rms]", F, 0 * F + 5, *re_im(S))
    assert not read_logs(save(stated))[0].warnings
    half = table("Frequency [Hz],Voltage [Vrms],X [um],Y [um]", F, 0 * F + 5, *re_im(S))
    (said,) = read_logs(save(half))[0].warnings
    assert said.startswith("nothing says whether the amplitude of the response is peak")
    told = "# amplitude: rms\n" + table("Frequency [Hz],Drive [V],X [um],Y [um]", F, 0 * F + 5, *re_im(S))
    (log,) = read_logs(save(told))
    assert not log.warnings
    np.testing.assert_allclose(np.abs(log.response), np.sqrt(2) * np.abs(S), rtol=1e-9)


@pytest.mark.parametrize(
    "head, values, unit, peak",
    [
        ("Current (mA rms)", 10.0, "mA", 10 * np.sqrt(2)),  # of the one column of a drive's kind, by its unit
        ("Amp out (V pk)", 3.0, "V", 3.0),
        ("Drive (dBV)", 6.0, "V", np.sqrt(2) * 10**0.3),  # 0 dBV is one of 1 V rms
        ("Drive (dBV pk)", 6.0, "V", 10**0.3),
        ("Drive (dBmV)", 60.0, "mV", 1e3 * np.sqrt(2)),
    ],
)
def test_a_held_column_of_a_drive_s_kind_beside_a_sweep_is_the_drive(save, head, values, unit, peak):
    (log,) = read_logs(
        save(table(f"Frequency (Hz),{head},X (um pk),Y (um pk)", F, 0 * F + values, *re_im(S)))
    )
    assert log.drive_unit == unit and not log.warnings
    np.testing.assert_allclose(log.drive, peak, rtol=1e-9)


@pytest.mark.parametrize("head", [
    "Humidity (%)", "Laser power (mW)", "Bias (V)", "Sensor supply (V)", "Sensitivity (V)", "Input range (mV)",
    "Current limit (A)", "Trigger level (V)",
])  # fmt: skip
def test_what_is_held_beside_a_sweep_and_drives_nothing_is_no_drive(save, head):
    (log,) = read_logs(save(table(f"Frequency (Hz),{head},X (um),Y (um)", F, 0 * F + 5, *re_im(S))))
    assert log.drive is None and any(f"not {head}" in said for said in log.notes)


def test_an_acceleration_in_g_is_one_in_metres_per_second_squared(save):
    """Of x = w cos(omega t) it is -omega^2 x, in multiples of 9.80665 m/s^2."""
    g = -((2 * np.pi * F) ** 2) * S * 1e-6 / 9.80665
    for head in ("Accel (g)", "Acceleration (g)", "acc [g]", "Beschleunigung [g]", "acc_g", "accel_mg"):
        milli = 1e3 if "mg" in head else 1.0
        columns = F, 0 * F + 2, *polar(g * milli)
        (log,) = read_logs(save(table(f"Freq (Hz),Current (A),{head},Phase (deg)", *columns)))
        np.testing.assert_allclose(log.response, 1e-6 * 1j * S, rtol=1e-9)
        assert log.response_unit == "m" and log.drive_unit == "A"
    for name in ("acceleration_g^2/Hz", "acc_g_phase_deg", "accuracy_g"):
        assert parse(name).unit != "g", name
    (log,) = read_logs(save(table("Freq (Hz);Mag [dB re 1 g/V];Phase [deg]", F, *decibel(g))))
    np.testing.assert_allclose(log.response, 1e-6 * 1j * S, rtol=1e-9)
    assert log.response_unit == "m" and np.all(log.drive == 1)


def test_x_and_y_of_one_signal_beside_a_frequency_are_its_parts(save):
    (log,) = read_logs(save(table("Frequency (Hz),Signal X (um),Signal Y (um)", F, *re_im(S))))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-9)
    three = table("Frequency (Hz),Velocity X (m/s),Velocity Y (m/s),Velocity Z (m/s)", F, *re_im(S), F)
    refused(save(three), "Velocity X (m/s) or Velocity Y (m/s)")  # directions


def test_decibels_of_the_largest_are_of_a_ratio(save):
    (log,) = read_logs(
        save(table("Frequency (Hz),Magnitude (dB re max),Phase (deg)", F, *decibel(S / np.max(np.abs(S)))))
    )
    np.testing.assert_allclose(log.response, 1j * S / np.max(np.abs(S)), rtol=1e-9)


def test_a_temperature_with_a_word_before_it_is_the_response_where_nothing_else_is(save):
    rows = table("Elapsed (s),Heater (V),Oven temperature (degC)", T, 5.0 * (T > 1), 20 + T)
    (log,) = read_logs(save(rows))
    assert log.response_unit == "degC" and np.max(log.drive) == 5.0
    whole = table("time_s,voltage_V,w_um,Oven temperature (degC)", T, 0 * T + 5, 1 + T, 20 + T)
    refused(save(whole), "did you mean temperature_degC?")


def test_what_matters_and_is_not_told_is_refused(save):
    wide = np.geomspace(20.0, 200.0, 50)
    w = 1 / (1 - (wide / 60) ** 2 + 0.5j * wide / 60)
    told = "quantity: over so wide a sweep a displacement and a velocity differ"
    error = refused(
        save(table("Freq (Hz),Level (V),Phase (deg)", wide, *polar(w))), "from 20 to 200 Hz", told
    )
    assert set(asked(error.mapping)) == {"amplitude", "quantity", "phase_sign"}
    head = "Time [s],Frequency [Hz],X [um],Y [um]"
    refused(save(table(head, T, 0 * T + 32300, *re_im(S))), "phase_sign: at one frequency")
    s_parameters = "freq [Hz],S11 [dB],S11 [deg]"  # no response as they stand
    refused(save(table(s_parameters, F, *decibel(S))), "found no response")
    refused(save(table("Frequency [Hz],X,Y", F, *re_im(S))), "found no response")  # in no unit


REFERRED = [
    ("Frequency (Hz),dB(m/s/V),Phase (deg)", ""),
    ("Frequency [Hz],Magnitude [dB(m/s/V)],Phase [deg]", ""),
    ("f / Hz,Mag dB(m/s/V),Phase / deg", ""),
    ("Frequency [Hz],Magnitude [dB re 1 m/s/V],Phase [°]", ""),
    ("[ Hz ],[ dB(m/s/V) ],[ deg ]", ""),
    ("[ Hz ]\t[ dB re 1 m/s/V ]\t[ deg ]", "Signal:\tH1 Velocity / Voltage\n\nFrequency\tMagnitude\tPhase\n"),
    (
        "[ Hz ]\t[ dB(m/s/V) ]\t[ deg ]",
        "Source:\tfork.pvd\n\nPoint Index:\t1\n\nFrequency\tMagnitude\tPhase\n",
    ),
]


@pytest.mark.parametrize(("head", "above"), REFERRED)
def test_decibels_of_a_reference_are_decibels(save, head, above):
    """As a vibrometer writes them; they were read as m/s/V, and the phase was lost."""
    text = above + table(head, F, *decibel(S))
    path = save(text.replace(",", "\t") if above else text)
    draft = draft_of(path)
    assert asked(draft) == ["phase_sign"], draft
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(log.response, S / (2 * np.pi * F), rtol=1e-11)
    assert (log.response_unit, log.drive.tolist(), log.drive_unit) == ("m", [1.0] * len(F), "V")


@pytest.mark.parametrize(
    "head, unit, drive",
    [
        ("Real [ (m/s) / V ],Imaginary [ (m/s) / V ]", "m", "V"),
        ("Re [um/s/mV],Im [um/s/mV]", "um", "mV"),
        ("Real ((m/s)/N),Imag ((m/s)/N)", "m", "N"),
    ],
)
def test_what_is_stated_by_its_drive_is_driven_by_one(save, head, unit, drive):
    """As the response of H1: its G is by that drive, whatever drove it."""
    path = save(table(f"Frequency [Hz],{head}", F, *re_im(S)))
    draft = draft_of(path)
    assert asked(draft) == ["phase_sign"], draft
    text = answered(draft)
    for stated, mapping in ((1.0, text), (20.0, text.replace(f'"1 {drive}"', f'"20 {drive}"'))):
        (log,) = read_logs(path, columns=save(mapping, "map.toml"))
        np.testing.assert_allclose(log.response, stated * S / (2 * np.pi * F), rtol=1e-11)
        assert (log.response_unit, log.drive_unit, log.drive[0]) == (unit, drive, stated)
    (log,) = read_logs(path, columns=save(text.partition("[constants]")[0], "without.toml"))
    assert (log.drive_unit, log.drive[0]) == (drive, 1.0)
    other = {"V": "N", "mV": "N", "N": "V"}[drive]
    wrong = text.replace(f'"1 {drive}"', f'"1 {other}"').replace("voltage =", "drive =")
    refused(path, "expected", columns=save(wrong, "wrong.toml"))


@pytest.mark.parametrize(
    "level, quantity, unit, order",
    [
        ("Schnelle [dB(mm/s)]", "velocity", "mm", 1),
        ("Level (dBµV)", "displacement", "µV", 0),
        ("Mag dB re 1 nm", "displacement", "nm", 0),
        ("Level [dBm]", "displacement", "mW^0.5", 0),
        ("Accel. dB(m/s^2)", "acceleration", "m", 2),
    ],
)
def test_decibels_of_a_unit_keep_it(save, level, quantity, unit, order):
    path = save(table(f"Frequency [Hz];{level};Phase [°]", F, *decibel(S)))
    text = answered(draft_of(path))
    assert f'quantity = "{quantity}"' in text
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S / (2j * np.pi * F) ** order, rtol=1e-10)
    assert log.response_unit == unit


def test_an_acceleration_is_divided_by_its_frequency_twice(save):
    """x = X cos(omega t) has the acceleration -omega^2 x; its unit is that of the whole head."""
    moves = -((2 * np.pi * F) ** 2) * S
    path = save(table("frequency_Hz,X_m/s^2,Y_m/s^2", F, *re_im(moves)))
    text = answered(draft_of(path))
    assert 'quantity = "acceleration"' in text
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-11)
    assert log.response_unit == "m"
    assert parse("acceleration_m/s^2").unit == "m/s^2"


def test_a_magnitude_below_zero_is_no_magnitude(save):
    """Decibels that are taken for linear were read as an amplitude with its sign turned."""
    path = save(table("f,a,b", F, *decibel(S)))
    columns = '[columns]\nfrequency = { column = "f", unit = "Hz" }\nphase = { column = "b", unit = "deg" }\n'
    text = f'amplitude = "peak"\nquantity = "displacement"\nphase_sign = 1\n{columns}'
    linear = save(f'{text}magnitude = {{ column = "a", unit = "um" }}\n', "map.toml")
    refused(path, "line 2, column 'a'", "a magnitude of 0 or more; is it in dB?", columns=linear)
    (log,) = read_logs(path, columns=save(f'{text}magnitude = {{ column = "a", unit = "dB" }}\n', "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-11)


SIGNALS = {
    "Frequency in Hz,TR1: Gain (Real),TR1: Gain (Imag)": re_im,
    "Frequency (Hz),S21 (dB),S21 (deg)": decibel,
    "FREQ(HZ),S21(DB),S21(DEG)": decibel,
    "FREQ(HZ),S11(REAL),S11(IMAG)": re_im,
    "freq[Hz];re:Trc1_S21;im:Trc1_S21": re_im,
    "freq,ReS11,ImS11": re_im,
    "Frequency,Gain (dB),Phase (Deg)": decibel,
    "Frequency (Hz),Amplitude (V),Phase (°)": polar,
    "f,abs,arg": polar,
    "frequency,real,imag": re_im,
    "Frequenz [Hz];Betrag [V];Phase [°]": polar,
    "f_Hz,In-phase (V),Quadrature (V)": re_im,
    "freq_hz,Vx,Vy": re_im,
    "f_Hz,Quadrature (V),In-phase (V)": lambda s: (s.imag, s.real),
    "Index,Frequency (Hz),Real (V),Imaginary (V)": lambda s: re_im(s),
    "Frequency (Hz),Lock-in X (V),Lock-in Y (V)": re_im,
    "Frequency (Hz),Mag,Phase,Mag std,Phase std": lambda s: (*polar(s), 0.1 + 0 * F, 0.2 + 0 * F),
}


@pytest.mark.parametrize("head", SIGNALS)
def test_the_parts_of_a_signal_are_known_whatever_they_are_called(save, head):
    columns = (F, *SIGNALS[head](S))
    path = save(table(head, *((np.arange(len(F)), *columns) if head.startswith("Index") else columns)))
    draft = draft_of(path)
    ratio = {"amplitude"} if re.search("S21|S11|Gain", head) else set()
    told = ratio | (
        {"phase_sign"} if re.search("S21|S11|TR1", head) else set()
    )  # by definition, or by its instrument
    assert {"amplitude", "quantity", "phase_sign"} & {*asked(draft)} == {
        "amplitude",
        "quantity",
        "phase_sign",
    } - told
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-11)  # of decibels with 15 digits


HALVES = {
    "Frequency(Hz),Ls(H),Rs(Ohm)": {"x": "Rs(Ohm)", "y": "?"},
    "Frequency(Hz),Cp(F),Rp(Ohm)": {},
    "Frequency(Hz),Cp(F),D": {},
    "Frequency (Hz),Vin (V),Vout (V),Phase (deg)": {
        "voltage": "Vin (V)",
        "magnitude": "Vout (V)",
        "phase": "Phase (deg)",
    },
    "f_Hz,U_in,U_out,phi": {"voltage": "U_in", "magnitude": "U_out", "phase": "phi"},
}


@pytest.mark.parametrize("head", HALVES)
def test_what_is_half_of_a_response_is_not_taken_for_the_whole(save, head):
    columns = [F, *(np.abs(S) + k * F for k in range(head.count(",")))]
    given = tomllib.loads(draft_of(save(table(head, *columns))))["columns"]
    assert {name: of["column"] for name, of in given.items() if name != "frequency"} == HALVES[head]


LONE = {
    "Time (s),Voltage (V),Speed (rpm)": (T, DRIVE, SPEED),
    "Time (s),Voltage (V),Temperature (degC)": (T, DRIVE, SPEED),
    "time,heater_pct,temp_C": (T, DRIVE, SPEED),
    "t [ms],u [V],n [1/min]": (1e3 * T, DRIVE, SPEED),
    "Time (s),PWM (%),Angle (deg)": (T, DRIVE, SPEED),
    "seconds,Motor voltage,Velocity (m/s)": (T, DRIVE, SPEED),
    "Time (s),Illuminance (lux)": (T, SPEED),
    "t,V,T": (T, DRIVE, SPEED),
    "time,pwm,rpm": (T, DRIVE / 5, SPEED),
    "time (s),ax (m/s^2)": (T, SPEED),
    "time_s,voltage_V,speed_rad_s": (T, DRIVE, SPEED),
    "TIME_S,VOLTAGE_V,SPEED_RAD/S": (T, DRIVE, SPEED),
    "Zeit_s,Spannung_V,Geschwindigkeit_mm_s": (T, DRIVE, SPEED),
}


@pytest.mark.parametrize("head", LONE)
def test_a_signal_of_any_unit_is_offered_as_w(save, head):
    columns = LONE[head]
    path = save(table(head, *columns))
    draft = draft_of(path)
    known = "(" in head or "[" in head or "_" in head  # its unit, that is
    assert not {"amplitude", "quantity", "phase_sign", *(["w"] if known else [])} & {*asked(draft)}, draft
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    scale = np.pi / 180 if "Angle" in head else 1.0
    np.testing.assert_allclose(log.response, scale * SPEED, rtol=1e-12)
    assert log.kind == "transient"
    if len(columns) == 3:
        assert np.ptp(log.drive) > 0 and np.array_equal(log.drive > 0, DRIVE > 0)


RNG = np.random.default_rng(4)
LATE = np.where(T > 1.0, 5.0, 0.0)
PRESSURE = 1.013 + 0.3 * (1 - np.exp(-np.clip(T - 1.0, 0, None) / 0.4)) + 0.004 * RNG.standard_normal(len(T))
RAMP = np.clip((T - 1.0) / 0.4, 0, 1) * 4.0
PAIRS = {  # of units that are not known, and of readings of few digits
    "Temps (s),Rapport cyclique (%),Vitesse (tr/min)": (LATE, SPEED, ("duty", "%", "tr/min")),
    "Zeit (s),Tastgrad (%),Drehzahl (U/min)": (LATE, SPEED, ("duty", "%", "U/min")),
    "Time (s),Heater (%),Speed (rpm)": (LATE, SPEED, ("duty", "%", "rpm")),
    "t_ms,valve_V,p_bar": (RAMP, PRESSURE, ("voltage", "V", "?")),
    "Time (s),Heater (W),TC1 (F)": (LATE, 70 + SPEED, ("drive", "W", "degF")),
    "Time (s),Heater (W),TC2 (C)": (LATE, 20 + SPEED, ("drive", "W", "degC")),
    "Time (s),Heater (W),TC2 (°C)": (LATE, np.round(PRESSURE, 2), ("drive", "W", "°C")),
    "Time (s),Pump (V),Flow (Nl/min)": (RAMP, PRESSURE, ("voltage", "V", "?")),
}


@pytest.mark.parametrize("head", PAIRS)
def test_a_drive_beside_a_signal_of_an_unknown_unit_is_the_drive(save, head):
    drive, signal, (name, unit, other) = PAIRS[head]
    draft = draft_of(save(table(head, T, drive, signal)))
    first, second = head.split(",")[1:]
    given = tomllib.loads(draft)["columns"]
    assert given.pop("time")["column"] == head.partition(",")[0]
    assert given == {name: {"column": first, "unit": unit}, "w": {"column": second, "unit": other}}, draft
    turned = table(",".join([head.partition(",")[0], second, first]), T, signal, drive)
    assert tomllib.loads(draft_of(save(turned)))["columns"] | {"time": 0} == {**given, "time": 0}


@pytest.mark.parametrize("head", ["Time (s),Pressure (bar),Flow (l/min)", "Time (s),valve_V,p_bar"])
def test_of_two_that_tell_nothing_the_response_is_asked_for(save, head):
    path = save(table(head, T, *RNG.standard_normal((2, len(T)))))
    draft = draft_of(path)
    assert tomllib.loads(draft)["columns"]["w"] == {"column": "?", "unit": "?"}
    assert "quantity" not in draft and "phase_sign" not in draft
    refused(path, "no column '?'", columns=save(answered(draft).replace('"V"', '"?"'), "map.toml"))


def test_a_response_in_seconds_is_asked_for_its_unit(save):
    draft = draft_of(save(table("time_s,voltage_V,speed_A_s", T, DRIVE, SPEED)))
    assert tomllib.loads(draft)["columns"]["w"] == {"column": "speed_A_s", "unit": "?"}


@pytest.mark.parametrize(
    "head",
    [
        "Frequenz [Hz],Betrag [um],Phasenverschiebung [°]",
        "Fréquence (Hz),Amplitude (um),Déphasage (°)",
        "Frecuencia (Hz),Amplitud (um),Fase (°)",
        "Frequenza (Hz),Ampiezza (um),Fase (°)",
        "Частота (Гц),Амплитуда (мкм),Фаза (град)",
        "FREQUENCY_HZ,AMPLITUDE_UM,PHASE_DEG",
    ],
)
def test_a_response_is_known_in_other_languages(save, head):
    path = save(table(head, F, *polar(S)))
    names = tomllib.loads(answered(draft_of(path)))["columns"]
    assert {name: of["column"] for name, of in names.items()} == dict(
        zip(("frequency", "magnitude", "phase"), head.split(","), strict=True)
    )
    assert [units.short(of["unit"]) for of in names.values()][:2] == ["Hz", "um"]


def test_what_counts_the_rows_is_no_response(save):
    swing = 12 * np.cos(5 * T)
    for name in ("frame", "bild", "Datensatz"):
        draft = draft_of(save(table(f"{name},time_s,angle_deg", np.arange(len(T)), T, swing)))
        assert tomllib.loads(draft)["columns"]["w"] == {"column": "angle_deg", "unit": "deg"}, draft


def test_remarks_are_offered_as_nothing(save):
    lines = (
        table("Nr\tf / Hz\tRe / um\tIm / um", np.arange(len(F)), F, *re_im(S)).replace(",", "\t").splitlines()
    )
    for remark in ("", "ok"):
        rows = [f"{line}\t{'door' if k == 40 else remark}" for k, line in enumerate(lines[1:])]
        draft = draft_of(save("\n".join([f"{lines[0]}\tBemerkung", *rows])))
        assert draft.count("Bemerkung") == 1 and "# not used: Nr, Bemerkung" in draft, draft


def test_an_amplitude_is_not_asked_for_the_sign_of_its_phase(save):
    for head in (
        "Frequency (Hz),S21 (dB)",
        "Frequency (Hz),Voltage (V)",
        "Frequency (Hz),Velocity RMS (mm/s)",
    ):
        draft = draft_of(save(table(head, F, np.abs(S))))
        assert "phase_sign" not in draft
        assert "magnitude" in tomllib.loads(draft)["columns"]
    assert 'amplitude = "rms"' in draft and 'quantity = "velocity"' in draft


def test_an_angle_is_never_offered_as_time(save):
    heads = (
        "Frequency(Hz),theta(deg)",
        "Frequency(Hz),x1,theta-z(deg)-data",
        "f_Hz,a,b,Phase (rad)",
        "a,b,Phase [°]",
    )
    for head in heads:
        text = draft_of(save(table(head, *(F - k for k in range(head.count(",") + 1)))))
        assert not re.search(r"time = .*(theta|Phase)", text), text


HEADLESS = [
    ((F, *re_im(S)), ["frequency", "x", "y"]),
    ((F, *polar(S)), ["frequency", "magnitude", "phase"]),
    ((F, *decibel(S)), ["frequency", "magnitude", "phase"]),
    ((F, np.abs(S)), ["frequency", "magnitude"]),
    ((T, SPEED), ["time", "w"]),
    ((T, DRIVE, SPEED), ["time", "voltage", "w"]),
    ((T, F, *re_im(S)), ["time", "frequency", "x", "y"]),
]


@pytest.mark.parametrize(("columns", "names"), HEADLESS)
def test_a_file_without_a_header_is_told_by_its_numbers(save, columns, names):
    """Every unit is asked, so that nobody takes the guess for knowledge."""
    path = save(table("", *columns))
    given = tomllib.loads(refused(path, "without a header").mapping)["columns"]
    assert list(given) == names
    assert [given[name] for name in names] == [{"column": k, "unit": "?"} for k in range(len(names))]


@pytest.mark.parametrize(
    "text, lost",
    [
        ("a,b,c\n" + "1,red,x\n2,green,y\n" * 3, "the response or a time or frequency"),
        ("f_Hz,name\n" + "1,red\n2,green\n" * 3, "the response"),
        ("X [V],Y [V]\n" + "1,2\n2,3\n" * 3, "a time or frequency"),
    ],
)
def test_a_draft_says_what_it_lacks(save, text, lost):
    """Whatever else is known, nothing is ready to save."""
    first = draft_of(save(text)).splitlines()[0]
    assert f"no column is known to be {lost}: name it under [columns]; " in first


def test_numbers_at_a_header_s_end_that_count_the_columns_are_no_row(save):
    """As LabOne's sweeps across, and frames of numbered columns."""
    across = "chunk;fieldname;" + ";".join(map(str, range(len(F)))) + "\n"
    for name, values in (("frequency", F), ("x", S.real), ("y", S.imag)):
        across += f"0;{name};" + ";".join(f"{v:.15g}" for v in values) + "\n"
    path = save(across)
    text = answered(draft_of(path)).replace("split_by", "# split_by")
    (log,) = read_logs(path, columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.response, 1j * S, rtol=1e-11)


def test_what_is_commented_out_names_each_column_once(save):
    """Two rows tell nothing of three columns without names."""
    text = draft_of(save("1,5,9\n2,6,7\n"))
    columns = re.findall(r"column = (\d)", text)
    assert columns == ["0", "1", "2"]


def test_a_response_of_which_half_is_there_is_asked_for_the_other(save):
    path = save(table("Frequency (Hz),Gain (Real),status", F, S.real, 0 * F))
    draft = draft_of(path)
    assert tomllib.loads(draft)["columns"]["y"] == {"column": "?", "unit": "?"}
    refused(
        path,
        "map.toml",
        "[columns] y",
        "no column '?'",
        columns=save(answered(draft).replace('column = "V"', 'column = "?"'), "map.toml"),
    )


@pytest.mark.parametrize(
    ("head", "words", "unit", "part"),
    [
        ("S21(DB)", ("s21",), "dB", "magnitude"),
        ("dBS21", ("s21", "db"), "dB", "magnitude"),
        ("A |Z|: Data Trace Real", ("|", "z"), "", "magnitude"),
        ("B THETA: Data Trace Imag", ("theta",), "", "phase"),
        ("Amplitude (mVrms)", ("amplitude",), "mV", "magnitude"),
        ("-Z'' (ohm)", ("z", "imag"), "ohm", "y"),
        ("Quadrature (V)", ("quadrature",), "V", "y"),
        ("Temp C", ("temp", "c"), "", ""),
        ("Z (Re)", ("z", "re"), "", "x"),  # no degrees of Réaumur
        ("", (), "", ""),
        ("-", (), "", ""),
        (": ", (), "", ""),
        ("()[]||", ("|",), "", "magnitude"),
    ],
)
def test_a_head_is_taken_apart(head, words, unit, part):
    label = parse(head)
    assert (label.words, label.unit, label.part) == (words, unit, part)


def test_what_lock_ins_are_known_to_state_is_not_asked(save):
    path = save("# SR865A SN 004512\n" + table("t (s),Freq (Hz),X (V),Y (V)", T, F, *re_im(S)))
    draft = draft_of(path)
    assert asked(draft) == ["quantity"]
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(log.response, np.sqrt(2) * 1j * S, rtol=1e-12)


def test_names_of_several_words_between_blanks_are_the_header(save):
    """As finite-element programs write them, in a comment above columns of blanks."""
    names = "% freq (Hz)             abs(w) (um)              arg(w) (rad)"
    rows = "".join(f"{f:.6f}    {abs(s):.9e}    {np.angle(s):.9e}\n" for f, s in zip(F, S, strict=True))
    path = save(f"% Model:              plate.mph\n% Version:            6.1\n{names}\n{rows}")
    draft = draft_of(path)
    assert tomllib.loads(answered(draft))["columns"] == {
        "frequency": {"column": "freq (Hz)", "unit": "Hz"},
        "magnitude": {"column": "abs(w) (um)", "unit": "um"},
        "phase": {"column": "arg(w) (rad)", "unit": "rad"},
    }
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(np.abs(log.response), np.abs(S), rtol=1e-8)


def test_a_header_in_cyrillic_whose_names_hold_commas(save, tmp_path):
    """Of Windows-1251, parted by semicolons, with decimal commas."""
    rows = "".join(
        f"{f:.2f};{abs(s):.6f};{np.degrees(np.angle(s)):.4f}\n".replace(".", ",")
        for f, s in zip(F, S, strict=True)
    )
    path = tmp_path / "data.csv"
    path.write_bytes(("Частота, Гц;Амплитуда, мкм;Фаза, град\n" + rows).encode("cp1251"))
    draft = draft_of(path)
    assert tomllib.loads(answered(draft))["columns"] == {
        "frequency": {"column": "Частота, Гц", "unit": "Hz"},
        "magnitude": {"column": "Амплитуда, мкм", "unit": "um"},
        "phase": {"column": "Фаза, град", "unit": "deg"},
    }
    (log,) = read_logs(path, columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(log.frequency, np.round(F, 2))
    assert "line 1 is not UTF-8: read as Windows-1251" in log.notes
    umlauts = "Frequenz [Hz];Größe [µm];Phase [°]\n"
    path.write_bytes((umlauts + rows).encode("cp1252"))
    assert '"Größe [µm]"' in draft_of(path)


def test_elements_of_a_circuit_are_told_to_be_no_response(save):
    draft = draft_of(save(table("FREQ[Hz],CP[F],D", F, np.full(len(F), 1e-9), 1e-3 * F / F[0])))
    assert "# Cp, D and the like are elements of a circuit" in draft


def test_a_drive_is_known_by_its_names(save):
    draft = draft_of(save(table("Time(us),Vdrive(V),F(kHz),Wd(nm),Wq(nm)", T, *re_im(S), *re_im(S))))
    assert tomllib.loads(answered(draft))["columns"]["voltage"] == {"column": "Vdrive(V)", "unit": "V"}


SETTINGS = """Type;FSV-7;
Version;1.70;
Center Freq;32300;Hz
RBW;10;Hz
Trace 1:;;
x-Unit;Hz;
Values;51;
"""


def test_settings_above_rows_without_a_header_are_no_header(save):
    """As spectrum analysers save a trace; each line of the rows ends in a mark that parts nothing."""
    rows = table("", F, 20 * np.log10(np.abs(S))).replace(",", ";").replace("\n", ";\n")
    path = save(SETTINGS + rows)
    draft = draft_of(path)
    assert tomllib.loads(answered(draft))["columns"].keys() == {"frequency", "magnitude"}
    (log,) = read_logs(path, columns=save(answered(draft, "dB"), "map.toml"))
    np.testing.assert_allclose(log.frequency, F)
    np.testing.assert_allclose(log.response, np.abs(S), rtol=1e-9)
    assert "lines 1 to 7, settings above rows without a header, left out" in log.notes
    with_header = SETTINGS + "Frequenz;Betrag;\n" + rows
    assert (
        "lines 1 to 7, above the header, left out"
        in read_logs(
            save(with_header),
            columns=save(
                '[columns]\nfrequency = { column = 0, unit = "Hz" }\nw = { column = 1, unit = "dB" }\n',
                "by_place.toml",
            ),
        )[0].notes
    )


def test_a_bad_first_cell_below_a_header_is_no_setting(save):
    rows = table("", F, *re_im(S))
    refused(save("frequency_Hz,wd_um,wq_um\n" + "".join(f"OVLD,{k},1\n" for k in range(4)) + rows), "line 2")
