"""Wide sweeps of a velocity or an acceleration: noise and crosstalk are even in these, and uneven in the
displacement that they are read as.

The truth is m w'' + c w' + k w = F in closed form.
"""

import numpy as np
import pytest
from conftest import most, seeds, study

import sysid

G, TAU, F0 = 1.1e-5, 0.0245, 176.3


def sweep(folder, seed, order, crosstalk, low=60.0, high=400.0, rows=171):
    """A file of the `order`-th derivative per volt, with crosstalk and noise as shares of its peak."""
    f, rng = np.linspace(low, high, rows), np.random.default_rng(seed)
    w, w0 = 2 * np.pi * f, 2 * np.pi * F0
    y = (1j * w) ** order * 2 * G * w0 / TAU / (w0**2 - w**2 + 2j * w / TAU)
    peak = G * w0**order
    y = y + crosstalk * peak
    y = y + 0.002 * peak * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    unit = "m/s^2/V" if order == 2 else "m/s/V"
    path = folder / f"{seed}.csv"
    path.write_text(
        f"Frequency (Hz),Real ({unit}),Imag ({unit})\n"
        + "".join(f"{a:.3f},{b.real:.7e},{b.imag:.7e}\n" for a, b in zip(f, y, strict=True))
    )
    return path


def scores(fit):
    """Of the plate, in its errors."""
    truth = {"G": G, "tau": TAU, "f0": F0}
    return [(fit.parameters[n].value - truth[n]) / fit.parameters[n].std for n in truth]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("crosstalk", [0.03 + 0.02j, study(0.1j)])
@seeds(1, 12)
def test_crosstalk_is_fitted(seeds, tmp_path, order, crosstalk):
    """It was a second resonance, or a finger."""
    z = []
    for seed in seeds:
        fit = sysid.fit(sysid.read_logs(sweep(tmp_path, seed, order, crosstalk)))
        assert fit.result.name == "successful", fit.warnings
        assert [f.key for f in fit.findings if f.outcome == "fitted"] == ["crosstalk"]
        z.append(scores(fit))
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds))


@pytest.mark.parametrize("order", [1, 2])
@seeds(12, 60)
def test_noise_is_even_in_what_was_recorded(seeds, tmp_path, order):
    """From 20 to 1000 Hz it is 2500 times as large at one end of a displacement as at the other."""
    z = []
    for seed in seeds:
        (log,) = sysid.read_logs(sweep(tmp_path, seed, order, 0.0, 20.0, 1000.0, 245))
        np.testing.assert_allclose(log.std / log.std[0], (log.frequency[0] / log.frequency) ** order)
        fit = sysid.fit([log], effects=["-crosstalk"])
        assert fit.result.name == "successful", fit.warnings
        assert not any(f.outcome in ("fitted", "refused") for f in fit.findings)
        z.append(scores(fit))
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds))


COIL = """quantity = "velocity"
phase_sign = 1
amplitude = "peak"
[columns]
frequency = "f_Hz"
magnitude = { column = "Z_ohm", unit = "ohm" }
phase = { column = "phase_deg", unit = "deg" }
"""
R, L, MOTION, SPEAKER, Q = 6.2, 0.3e-3, 30.0, 45.0, 5.0  # ohm, H, ohm, Hz


@pytest.mark.parametrize("relative", [0.0, 0.002])
@seeds(12, 60)
def test_a_loudspeaker_by_its_impedance(seeds, tmp_path, relative):
    """Its resistance was taken for a delay of a seventh of tau, and G not told, or to 17 %; and of noise that
    goes with the impedance, as an analyser's does, G, tau and f0 were 2.3 of their errors off."""
    z = []
    (tmp_path / "map.toml").write_text(COIL)
    for seed in seeds:
        rng, f = np.random.default_rng(seed), np.geomspace(20.0, 120.0, 81)
        Z = R + 2j * np.pi * f * L + MOTION / (1 + 1j * Q * (f / SPEAKER - SPEAKER / f))
        noise = rng.standard_normal(81) + 1j * rng.standard_normal(81)
        Z = Z + noise * (relative * np.abs(Z) if relative else 0.02)
        rows = zip(f, np.abs(Z), np.degrees(np.angle(Z)), strict=True)
        text = "f_Hz,Z_ohm,phase_deg\n" + "".join(f"{a:.5f},{b:.7g},{c:.6g}\n" for a, b, c in rows)
        (tmp_path / "z.csv").write_text(text)
        fit = sysid.fit(sysid.read_logs(tmp_path / "z.csv", columns=tmp_path / "map.toml"))
        assert fit.result.name == "successful", fit.warnings
        assert fit.parameters["G"].std < 0.005 * fit.parameters["G"].value
        truth = {"G": MOTION / (2 * np.pi * SPEAKER), "tau": Q / (np.pi * SPEAKER), "f0": SPEAKER}
        z.append([(fit.parameters[n].value - truth[n]) / fit.parameters[n].std for n in truth])
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds))


@pytest.mark.parametrize("order", [1, 2])
@seeds(12, 60)
def test_noise_that_goes_with_the_response_is_told_from_noise_that_is_even(seeds, tmp_path, order):
    """As of a drive that flickers: weights that are right for even noise alone made errors too small."""
    z, noise = [], "of the response"
    for seed in seeds:
        path, rng = sweep(tmp_path, seed, order, 0.0, 80.0, 400.0), np.random.default_rng([1, seed])
        (log,) = sysid.read_logs(path)
        flicker = 1 + 0.02 * (rng.standard_normal(len(log)) + 1j * rng.standard_normal(len(log)))
        fit = sysid.fit([log.again(log.response * flicker)], effects=["-crosstalk"])
        assert fit.result.name == "successful" and noise in fit.logs[0].noise, fit.logs[0].noise
        z.append(scores(fit))
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < most(seeds))


def test_over_a_narrow_sweep_rows_count_alike(tmp_path):
    (log,) = sysid.read_logs(sweep(tmp_path, 1, 2, 0.0, 165.0, 188.0))
    assert log.std is None


def test_how_noise_goes_with_the_rows_is_written_with_a_log(tmp_path):
    """A file in the contract's names gives the fit that the instrument's own gave; it forgot once that its
    standard errors are weights, and that noise may go with the response."""
    (log,) = sysid.read_logs(sweep(tmp_path, 3, 2, 0.0))
    assert log.even and not log.relative_noise
    sysid.write_log(log, tmp_path / "again.csv")
    for again in (*sysid.read_logs(tmp_path / "again.csv"), sysid.Log.from_frame(log.to_frame())):
        assert again.even
        first, second = (sysid.fit(one) for one in (log, again))
        for name in ("G", "tau", "f0"):
            assert second.parameters[name].value == first.parameters[name].value
            assert second.parameters[name].std == first.parameters[name].std


def test_a_log_may_say_how_it_was_measured(tmp_path):
    """The words of the contract, and those of others, which mean nothing."""
    rows = "frequency_Hz,voltage_V,wd_um,wq_um\n1,1,0,1\n2,1,1,0\n3,1,0,-1\n"
    for said, relative, analysed in (
        ("# noise: relative\n# measured_at: terminals\n", True, True),
        ("# Noise: Relative\n", True, False),
        ("# noise: 3 nV\n# measured_at: ETH\n", False, False),
    ):
        (tmp_path / "log.csv").write_text(said + rows)
        (log,) = sysid.read_logs(tmp_path / "log.csv")
        assert (log.relative_noise, log.analysed) == (relative, analysed)
