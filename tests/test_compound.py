"""Cells that hold more than a number: complex ones, and numbers with their unit."""

import numpy as np
import pytest
from refusal import draft_of, refused

from sysid.logs.read import read_logs

F = 32000.0 + 10.0 * np.arange(40)
Z = 0.05 / (1 + 2j * np.pi * (F - 32200.0) * 1.6e-3)
MAP = """amplitude = "peak"
quantity = "displacement"
phase_sign = 1
delimiter = "{}"
[columns]
frequency = {{ column = "f", unit = "Hz" }}
{}
[constants]
voltage = "1 V"
"""
PARTS = 'x = { column = "H re", unit = "um" }\ny = { column = "H im", unit = "um" }'
POLAR = 'magnitude = { column = "H [dB]", unit = "dB" }\nphase = { column = "H phase [deg]", unit = "deg" }'


def text(cells, delimiter=","):
    return f"f{delimiter}H\n" + "".join(
        f"{f!r}{delimiter}{c}\n" for f, c in zip(F.tolist(), cells, strict=True)
    )


@pytest.mark.parametrize(
    ("write", "delimiter", "columns"),
    [
        (lambda z: repr(complex(z)), ",", PARTS),
        (lambda z: f"{z.real!r}{z.imag:+.17g}i", ",", PARTS),
        (lambda z: f"{z.real:.17g} {'-' if z.imag < 0 else '+'} {abs(z.imag):.17g}*j", ";", PARTS),
        (lambda z: f"{z.real:.17e},{z.imag:.17e}", "\\t", PARTS),
        (lambda z: f"({z.real:.17e},{z.imag:.17e})", "\\t", PARTS),
        (lambda z: f"({20 * np.log10(abs(z)):.15e}dB,{np.degrees(np.angle(z)):.15e}°)", "\\t", POLAR),
    ],
)
def test_complex_cells_are_two_columns(save, write, delimiter, columns):
    content = text([write(complex(z)) for z in Z], delimiter.replace("\\t", "\t"))
    mapping = save(MAP.format(delimiter, columns), "map.toml")
    (log,) = read_logs(save(content), columns=mapping)
    np.testing.assert_allclose(log.response, 1j * Z, rtol=1e-12)
    assert all(line.partition(" =")[0] + " = {" in draft_of(save(content)) for line in columns.split("\n"))


def test_a_cell_that_is_not_complex_among_those_is_refused_by_its_line(save):
    cells = [repr(complex(z)) for z in Z]
    mapping = save(MAP.format(",", PARTS), "map.toml")
    refused(save(text([*cells[:20], "OVLD", *cells[21:]])), "line 22", "'OVLD'", columns=mapping)
    refused(save(text(cells) + "33000.0\n"), "line 42", "found 1 cells, expected 2", columns=mapping)


def test_cells_with_units_are_numbers_of_the_unit_in_the_head_or_in_the_first_of_them(save):
    rows = [
        f"{f / 1e3!r} kHz,{z.real!r} um,{1e3 * z.imag!r} nm,5 V"
        for f, z in zip(F.tolist(), Z.tolist(), strict=True)
    ]
    rows[3] = rows[3].replace(f"{F[3] / 1e3!r} kHz", f"{F[3]!r} Hz")
    (log,) = read_logs(save("\n".join(["frequency,wd_um,wq_um,voltage", *rows]) + "\n"))
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)
    np.testing.assert_allclose(log.response, Z, rtol=1e-12)
    assert (log.response_unit, log.drive_unit, log.drive[0]) == ("um", "V", 5.0)


def test_a_row_of_units_is_still_one(save):
    (log,) = read_logs(
        save("frequency,wd,wq\nkHz,um,um\n" + "".join(f"{f / 1e3!r},1,{f!r}\n" for f in F.tolist()))
    )
    np.testing.assert_allclose(log.frequency, F, rtol=1e-12)
