"""Column names and units: what a name says, what is refused, and that conversions give the numbers a table
gives."""

import math
import subprocess
import sys

import numpy as np
import pint
import pytest

from sysid.tables import units


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("time_ms", ("time", "ms", "peak")),
        ("TIME_ms", ("time", "ms", "peak")),
        ("Frequency [kHz]", ("frequency", "kHz", "peak")),
        ("frequency(kHz)", ("frequency", "kHz", "peak")),
        ("Voltage (V)", ("voltage", "V", "peak")),
        (" wd_m/s ", ("wd", "m/s", "peak")),
        ("voltage_V_rms", ("voltage", "V", "rms")),
        ("voltage_Vrms", ("voltage", "V", "rms")),
        ("Voltage RMS [V]", ("voltage", "V", "rms")),
        ("Voltage [V rms]", ("voltage", "V", "rms")),
        ("w_um_pp", ("w", "um", "pp")),
        ("w_um_peak", ("w", "um", "peak")),
        ("drive_%", ("drive", "%", "peak")),
        ("duty", ("duty", "1", "peak")),
        ("time", ("time", "", "peak")),
        ("Frequency/Hz", ("frequency", "Hz", "peak")),
        ("Temperature / °C", ("temperature", "°C", "peak")),
        ("wd/mm/s", ("wd", "mm/s", "peak")),
        ("Voltage/Vrms", ("voltage", "V", "rms")),
        ("FREQUENCY (HZ)", ("frequency", "Hz", "peak")),
        ("frequency_khz", ("frequency", "kHz", "peak")),
        ("W_UM", ("w", "um", "peak")),
        ("Temperature (C)", ("temperature", "degC", "peak")),
        ("FREQUENCY_MHZ", ("frequency", "MHZ", "peak")),
        ("w_C", ("w", "C", "peak")),
        ("w_rad_s", ("w", "rad/s", "peak")),
        ("wd_mm_s_rms", ("wd", "mm/s", "rms")),
        ("w_um_s2", ("w", "um/s^2", "peak")),
        ("W_RAD_S", ("w", "rad/s", "peak")),
        ("w_um_per_V", ("w", "um/V", "peak")),
        ("temperature_deg_C", ("temperature", "degC", "peak")),
        ("voltage_V_pk", ("voltage", "V", "peak")),
        ("Voltage (Vp-p)", ("voltage", "V", "pp")),
        ("W_d (um)", ("wd", "um", "peak")),
        ("w_q_nm", ("wq", "nm", "peak")),
        ("wd, мкм", ("wd", "um", "peak")),
    ],
)
def test_a_name_says_quantity_unit_and_amplitude(label, expected):
    assert units.parse_name(label) == expected


@pytest.mark.parametrize(
    "label",
    [
        "temperature_ambient_degC",
        "time_unix_s",
        "w/wmax",
        "time/channel",
        "T_degC",
        "note",
        "wd_err_um",
        "w_A_s",  # a charge, or the rate of a current
        "log",
        "",
    ],
)
def test_other_names_are_not_ours(label):
    assert units.parse_name(label) is None


def test_the_unit_keeps_its_case():
    assert units.parse_name("FREQUENCY_MHz").unit == "MHz"


@pytest.mark.parametrize(
    ("unit", "to", "value", "expected"),
    [
        ("ms", "s", 12.5, 0.0125),
        ("us", "s", 3.0, 3e-6),
        ("kHz", "Hz", 32.25, 32250.0),
        ("K", "degC", 273.15, 0.0),
        ("nm", "um", 250.0, 0.25),
        ("%", "1", 30.0, 0.3),
        ("1", "1", 0.3, 0.3),
        ("min", "s", 2.0, 120.0),
    ],
)
def test_decimal_conversions_are_exact(unit, to, value, expected):
    assert units.convert(np.array([value]), unit, to)[0] == expected


@pytest.mark.parametrize(
    ("unit", "to", "value", "expected"),
    [
        ("degF", "degC", 75.2, 24.0),
        ("rad/s", "Hz", 2 * math.pi, 1.0),
        ("rpm", "Hz", 60.0, 1.0),
        ("rev/min", "Hz", 60.0, 1.0),
    ],
)
def test_other_conversions(unit, to, value, expected):
    # 1e-9: the line through two converted points carries a few roundings of numbers near 300
    assert units.convert(np.array([value]), unit, to)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("quantity", "unit", "words"),
    [
        ("frequency", "khz", ["'khz'", "frequency", "did you mean 'kHz'"]),
        ("frequency", "s", ["unit of frequency", "Hz"]),
        ("time", "S", ["did you mean 's'"]),
        ("temperature", "C", ["did you mean 'degC'"]),
        ("voltage", "A", ["unit of voltage", "V, mV"]),
        ("voltage", "MV", ["'MV'", "of a million", "did you mean 'mV'"]),
        ("w", "MM", ["'MM'", "of a million", "did you mean 'mm'"]),
        ("time", "", ["no unit", "time_s"]),
        ("w", "foo", ["'foo'"]),
        ("voltage", "V~", ["'V~'", "unit of voltage"]),
        ("w", "um!", ["'um!'", "unit of w"]),
        ("wd", "dBm", ["decibels", "mapping file"]),
        ("w", "__import__('os')", ["unit of w"]),
        ("force", "Np–K", ["'Np–K'", "unit of force"]),
    ],
)
def test_a_wrong_unit_says_what_was_expected(quantity, unit, words):
    with pytest.raises(ValueError) as error:
        units.check_unit(quantity, unit)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize("unit", ["um", "m/s", "V", "S", "degC", "1", "%", "mm^2/s", "A*s", "µm"])
def test_a_response_takes_any_unit(unit):
    units.check_unit("w", unit)


def test_units_of_one_kind():
    assert units.same_kind("nm", "um")
    assert not units.same_kind("um", "m/s")
    assert not units.same_kind("duty", "V")


def test_the_usual_units_do_not_load_pint():
    code = (
        "import sys; from sysid.tables import units;"
        "[units.check_unit(*pair) for pair in (('time', 's'), ('frequency', 'Hz'), ('voltage', 'V'), ('wd',"
        " 'um'))];"
        "assert not {'pint', 'pandas'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_prefix_alone_is_taken_as_the_library_takes_it():
    """Every pair of prefixes of every such unit, against pint itself, to the rounding of its own products."""
    registry = pint.UnitRegistry()
    for base in ("s", "Hz", "m", "V", "A", "N", "m/s"):
        for first in units._POWERS:
            for second in units._POWERS:
                exact = registry.Quantity(3.7, first + base).to(second + base).magnitude
                assert units.convert(3.7, first + base, second + base) == pytest.approx(exact, rel=1e-14)
    assert (
        units._power("min", "s") is None
        and units._power("mm", "ms") is None
        and units._power("degC", "K") is None
    )
