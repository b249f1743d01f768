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


def test_over_a_narrow_sweep_rows_count_alike(tmp_path):
    (log,) = sysid.read_logs(sweep(tmp_path, 1, 2, 0.0, 165.0, 188.0))
    assert log.std is None
