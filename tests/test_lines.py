"""A line in the spectrum of what is left: hum whose rows share no more than noise does. Steps of closed form at the
resonance, their noise of each row's own."""

import numpy as np
import pytest
from conftest import most, seeds

import sysid
from sysid.fitting import fit

G, TAU, F0 = 0.3, 0.15, 860.0
TIME = 4e-3 * np.arange(300)
DRIVE = np.where(TIME > 0.1, 1.0, 0.0)


def step(seed, hertz=(), size=0.06):
    """A step with tones of these frequencies, the first the largest, in one channel and in both alike."""
    rng = np.random.default_rng(seed)
    since = np.clip(TIME - 0.1 - 2e-3, 0.0, None)  # the drive changes half way between rows
    w = G * (1 - np.exp(-since / TAU))
    for k, f in enumerate(hertz, 1):
        w = w + size * G / k * np.exp(0.3j * k) * np.cos(2 * np.pi * f * TIME + k)
    w = w + 0.005 * G * (rng.standard_normal(len(TIME)) + 1j * rng.standard_normal(len(TIME)))
    return sysid.Log.from_arrays(
        w, time=TIME, drive=DRIVE, frequency=np.full(len(TIME), F0), bench={"delay_s": 2e-3}
    )


@pytest.mark.parametrize("hertz", [(50.0,), (62.0,), (50.0, 100.0)], ids=["fifth", "quarter", "two"])
@seeds(1, 12)
def test_hum_is_found_where_it_looks_like_noise(seeds, hertz):
    """At a fifth and a quarter of a turn a row neighbours share a third of it, and nothing: it was noise, and G was
    known ten times less well."""
    pulls = []
    for seed in seeds:
        found = fit([step(seed, hertz)])
        tones = [f.numbers["tone_Hz"] for f in found.findings if f.key == "tone" and f.outcome == "fitted"]
        assert found.usable and len(tones) == len(hertz)
        assert sorted(t.value for t in tones) == pytest.approx(hertz, abs=0.05)
        assert found.parameters["G"].std < 0.01 * G  # 0.5 % a row and channel: it is 0.1 %
        pulls += [
            (found.parameters[n].value - true) / found.parameters[n].std
            for n, true in (("tau", TAU), ("f0", F0))
        ]
    assert np.sqrt(np.mean(np.square(pulls))) < most(pulls)


@pytest.mark.parametrize("colour", [0.0, 0.6, 0.95])
@seeds(5, 200)
def test_noise_is_no_tone(seeds, colour):
    """Two in 100 000 would be one by chance."""
    for seed in seeds:
        rng, log = np.random.default_rng(seed), step(seed)
        noise = rng.standard_normal(len(TIME)) + 1j * rng.standard_normal(len(TIME))
        for k in range(1, len(noise)):
            noise[k] = colour * noise[k - 1] + np.sqrt(1 - colour**2) * noise[k]
        found = fit(
            [
                sysid.Log.from_arrays(
                    log.response + 0.02 * G * noise,
                    time=TIME,
                    drive=DRIVE,
                    frequency=log.frequency,
                    bench=log.bench,
                )
            ],
            effects="none",
        )
        assert all(f.key != "tone" for f in found.findings)
