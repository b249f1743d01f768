"""Spectral densities: of a power the root is read, of an amplitude the numbers as they are, however people
write their units."""

import numpy as np
import pytest
from refusal import draft_of, refused

import sysid
from sysid.columns import labels
from sysid.logs.read import read_logs
from sysid.tables import densities, units

F0, TAU = 75000.0, 2e-3
F = np.linspace(F0 - 400, F0 + 400, 101)


def spectrum(seed=0):
    """The density of a power, in pm^2/Hz, of a resonator in even noise, of which many spectra are averaged."""
    size = 200.0 / np.abs(1 + 2j * np.pi * (F - F0) * TAU)
    return size**2 * np.random.default_rng(seed).gamma(400, 1 / 400, len(F))


def table(head, values, above="# kind: steady\n"):
    return (
        above
        + f"frequency_Hz,{head}\n"
        + "".join(f"{f!r},{v!r}\n" for f, v in zip(F.tolist(), values.tolist(), strict=True))
    )


@pytest.mark.parametrize(
    ("written", "plain"),
    [
        ("V^2/Hz", "V^2/Hz"),
        ("V²/Hz", "V^2/Hz"),
        ("V**2/Hz", "V^2/Hz"),
        ("V2/Hz", "V^2/Hz"),
        ("(m/s)^2/Hz", "m^2/s^2/Hz"),
        ("V/sqrt(Hz)", "V/Hz^0.5"),
        ("V/√Hz", "V/Hz^0.5"),
        ("V/rtHz", "V/Hz^0.5"),
        ("V/Hz^(1/2)", "V/Hz^0.5"),
        ("V Hz^-1/2", "V/Hz^0.5"),
        ("kHz", "kHz"),
    ],
)
def test_units_as_people_write_them(written, plain):
    assert units.split_unit(f"PSD [{written}]")[1] == plain == labels.parse(f"PSD ({written})").unit
    assert units.is_known(plain)


@pytest.mark.parametrize("name", ["start_Hz", "start Hz", "f/Hz", "f2/Hz", "Ch2/Hz", "start (Hz)"])
def test_heads_that_are_none(name):
    assert densities.plain(name) == name


@pytest.mark.parametrize("head", ["w_pm^2/Hz", "w [pm²/Hz]", "w (pm**2/Hz)"])
def test_of_a_power_the_root_is_read(save, head):
    """The resonator whose noise it is: read as its amplitude, the peak was narrower by far."""
    (log,) = read_logs(save(table(head, spectrum())))
    np.testing.assert_allclose(log.response, np.sqrt(spectrum()), rtol=1e-12)
    assert log.response_unit == "pm/Hz^0.5"
    assert log.notes[-1].endswith("is a power density, in pm^2/Hz: its root is read, in pm/Hz^0.5")
    fit = sysid.fit([log])
    for name, truth in (("tau", TAU), ("f0", F0)):
        found = fit.parameters[name]
        assert found.determined and abs(found.value - truth) < 4 * found.std < 0.2 * truth


def test_the_density_of_an_amplitude_is_one(save):
    (log,) = read_logs(save(table("w_pm/sqrt(Hz)", spectrum())))
    assert log.response.tolist() == spectrum().tolist() and log.response_unit == "pm/Hz^0.5"
    assert not log.notes
    (log,) = read_logs(save(table("w_V^2/Hz_rms", spectrum())))
    np.testing.assert_allclose(
        log.response, np.sqrt(2 * spectrum()), rtol=1e-12
    )  # the root, and then its peak


@pytest.mark.parametrize("head", ["PSD (pm^2/Hz)", "Sxx [pm²/Hz]", "ASD (pm/sqrt(Hz))", "PSD (dBm/Hz)"])
def test_the_draft_knows_them(save, tmp_path, head):
    power = "2" in head or "²" in head
    values = spectrum() if power else np.sqrt(spectrum())
    path = save(table(head, 20 * np.log10(values) if "dB" in head else values))
    draft = draft_of(path)
    (line,) = [line for line in draft.splitlines() if line.startswith("magnitude")]
    assert ("a power density: its root is read" in line) == power
    if "dB" not in head:
        assert (
            '"?"' not in draft.partition("[columns]")[0].replace('unit = "?"', "") and "displacement" in draft
        )
    (tmp_path / "map.toml").write_text(
        draft.replace('amplitude = "?"', 'amplitude = "peak"').replace(
            'quantity = "?"', 'quantity = "displacement"'
        ),
        encoding="utf-8",
    )
    (log,) = read_logs(path, columns=tmp_path / "map.toml")
    np.testing.assert_allclose(log.response, np.sqrt(spectrum()), rtol=1e-9)


def test_a_square_has_no_parts_and_is_not_negative(save, tmp_path):
    refused(
        save("# kind: steady\nfrequency_Hz,wd_pm^2/Hz,wq_pm^2/Hz\n1,2,3\n2,3,4\n"),
        *("wd_pm^2/Hz", "pm^2/Hz, a power density", "alone, as w or magnitude"),
    )
    refused(
        save(table("w_pm^2/Hz", np.where(F == F0, -1.0, spectrum()))),
        *("w_pm^2/Hz", "-1.0", "a power density of 0 or more"),
    )


@pytest.mark.parametrize(("unit", "error"), [("pm^2/Hz", lambda s: 0.1 * s), ("%", lambda s: 0 * s + 10.0)])
def test_standard_errors_of_a_power_are_halved_as_a_share(save, unit, error):
    """d(w^2) = 2 w dw: a tenth of the power is a twentieth of the amplitude."""
    rows = np.column_stack([F, spectrum(), error(spectrum())]).tolist()
    text = f"# kind: steady\nfrequency_Hz,w_pm^2/Hz,std_{unit}\n"
    (log,) = read_logs(save(text + "".join(f"{f!r},{s!r},{e!r}\n" for f, s, e in rows)))
    np.testing.assert_allclose(log.std, 0.05 * log.response, rtol=1e-12)
