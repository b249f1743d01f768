"""The exported demodulator: against the lock-in that reads waveforms, against the truth, in C against
Python."""

import dataclasses
import math
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from replay import DEMODULATE_C, KIND, SANITIZERS, array_of, compiled, full, run

import controller
from controller import Rig
from controller.actuator import Adc
from controller.demodulator import IMAGE, Demodulator, Turn, cosine_and_sine
from controller.scalar import typed
from sysid.demodulation.lockin import low_pass

TAU = 5e-3 / math.log(20)
F0, RATE = 32300.0, 1e6
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=F0, k_T=None)
FULL = 5.0  # um, of 2048 counts
COUNT = FULL / 2048
W = 1.6 - 0.9j


def designed(adc=True, **given):
    rig = Rig(adc=Adc(12.0, FULL, RATE)) if adc else None
    return controller.design(
        PLATE, voltage_limit=150.0, frequency_window=(32000.0, 32600.0), rig=rig, **given
    )


def carrier(n, frequency=F0, rate=RATE):
    """Accumulator (n,), and w in um of a response that begins to rise at sample 500, with tau, by the
    definition in words."""
    phase = (np.arange(n) * round(frequency / rate * 2**32) + 12345) % 2**32
    p = 2 * np.pi * phase / 2**32
    envelope = W * -np.expm1(-np.maximum(np.arange(n) - 500, 0) / (TAU * rate))
    theta = p + np.pi  # v = V sin p = Re[jV e^{j theta}] = -V sin theta
    return phase, np.real(envelope * np.exp(1j * theta)), envelope


def through(demodulator, samples, phase):
    state, found = demodulator.init(), []
    u, odd, half = Turn.of(phase)
    for sample, turn in zip(
        samples.tolist(), zip(u.tolist(), odd.tolist(), half.tolist(), strict=True), strict=True
    ):
        state, d, q = demodulator.step(state, sample, Turn(*turn))
        found.append(complex(d, q))
    return np.array(found)


def in_rows(demodulator, samples, phase, kind):
    """Sequences (n, m) side by side, in arrays of `kind`; complex, missing where either is; and what is
    clipped."""
    state, found, xp = (
        full(demodulator.init(), len(samples), kind),
        np.zeros(samples.shape, complex),
        array_of(kind),
    )
    clipped = np.zeros(samples.shape, bool)
    u, odd, half = Turn.of(phase)
    for k, sample in enumerate(samples.astype(kind).T):
        state, d, q = demodulator.step(state, sample, Turn(u[:, k].astype(kind), odd[:, k], half[:, k]), xp)
        assert d.dtype == kind
        found[:, k], clipped[:, k] = d + 1j * q, state.clipped > 0
    return found, clipped


def test_cosine_and_sine():
    phase = np.concatenate([np.arange(0, 2**32, 2**20), [2**32 - 1, 2**29 - 1, 2**29, 3 * 2**29]])
    c, s = cosine_and_sine(Turn.of(phase), np)
    angle = 2 * np.pi * phase / 2**32
    assert max(np.abs(c - np.cos(angle)).max(), np.abs(s - np.sin(angle)).max()) < 3.2e-7  # as is stated


def test_it_is_the_lock_in_that_reads_waveforms():
    demodulator = Demodulator.of(RATE, F0, 100.0)
    phase, w, _ = carrier(8000)
    theta = 2 * np.pi * phase / 2**32 + np.pi
    tau = -1 / math.log1p(-demodulator.share)
    # a sine that is right to 3.2e-7, twice, of 2 |w| < 4
    np.testing.assert_allclose(
        through(demodulator, w, phase), low_pass(w, theta, tau, demodulator.order), rtol=0, atol=4e-6
    )


def test_what_it_is_late_and_leaves_of_the_image():
    demodulator = Demodulator.of(RATE, F0, 100.0)
    phase, w, envelope = carrier(20000)
    found = through(demodulator, w, phase)
    settled = np.abs(found[15000:] - envelope[15000:])
    assert (
        0.5 * IMAGE < settled.max() / abs(W) < 1.05 * IMAGE
    )  # the image is what is left, no more and not much less
    # while it rises it is late by the group delay: of a rise with tau, by that to second order in delay/tau
    rising = slice(1000, 4000)
    lag = demodulator.delay * RATE
    late = np.interp(np.arange(20000) - lag, np.arange(20000), np.abs(envelope))[rising]
    assert np.abs(np.abs(found[rising]) - late).max() < (IMAGE + (demodulator.delay / TAU) ** 2) * abs(W)
    assert 40 < lag < 60  # samples: 53 us


def test_a_rate_at_which_the_image_falls_on_the_response_is_refused():
    for rate in (2 * F0, F0, 2 * F0 / 3, 64600.0 * 1.01):
        with pytest.raises(ValueError, match="image of the carrier"):
            Demodulator.of(rate, F0, 1.0)
    assert (
        Demodulator.of(4 * F0, F0, 1.0).delay * 4 * F0 < 10
    )  # four samples a period: the image lies at half the sampling rate


def example_that_are_missing():
    demodulator = Demodulator.of(RATE, F0, 100.0)
    phase, w, _ = carrier(12000)
    some = np.where(np.random.default_rng(0).random(12000) < 0.01, np.nan, w)
    some[9000:9090] = np.nan
    found = through(demodulator, some, phase)
    assert np.isfinite(found).all()
    # one in a hundred is left out, two or three of those that the filters remember; the largest weight of a
    # sample is 0.016 (of four poles: 0.224 times their share), and its value up to 2 |W|
    assert np.abs(found[8000:9000] - through(demodulator, w, phase)[8000:9000]).max() < 3 * 0.016 * 2 * abs(W)
    gone = np.where(np.arange(12000) >= 10000, np.nan, w)
    found = through(demodulator, gone, phase)
    assert np.isfinite(found[:10099]).all() and np.isnan(found[10099:]).all()


SEQUENCES, SAMPLES = 200, 500


def hard():
    """Accumulator and counts (SEQUENCES, SAMPLES): with noise, drops, stretches out of range, at zero,
    without any."""
    rng = np.random.default_rng(2)
    shape = (SEQUENCES, SAMPLES)
    phase = (np.arange(SAMPLES) * round(F0 / RATE * 2**32) + rng.integers(0, 2**32, (SEQUENCES, 1))) % 2**32
    p = 2 * np.pi * phase / 2**32
    size = rng.uniform(0, 2, (SEQUENCES, 1)) * np.exp(2j * np.pi * rng.random((SEQUENCES, 1)))
    w = -size.real * np.cos(p) + size.imag * np.sin(p) + 0.02 * rng.standard_normal(shape)
    kind, t = np.arange(SEQUENCES)[:, None] % 4, np.arange(SAMPLES)
    counts = np.round(np.where((kind == 1) & (t > 200), np.clip(5 * w, -FULL, FULL - COUNT), w) / COUNT)
    counts = np.where((kind == 2) & (t > 300) & (t < 350), 0, counts)
    counts = np.where((kind == 3) & (t > 250) & (t < 400), np.nan, counts)
    return phase, np.where(rng.random(shape) < 1e-2, np.nan, counts)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_gives_the_same_bits_as_python(tmp_path, precision):
    loop = designed()
    loop = dataclasses.replace(loop, demodulator=loop.demodulator._replace(patience=60.0))
    kind, demodulator = KIND[precision], typed(loop.demodulator, KIND[precision])
    phase, counts = hard()
    given = np.zeros(phase.shape, np.dtype([("value", kind), ("phase", np.uint32)], align=True))
    given["value"], given["phase"] = counts, phase
    out = run(
        compiled(loop, tmp_path, precision, DEMODULATE_C, *SANITIZERS, f"-DSAMPLES={SAMPLES}"),
        given.tobytes(),
    )
    shown = np.dtype([("wd", kind), ("wq", kind), ("clipped", np.int32), ("samples", np.uint32)], align=True)
    theirs = np.frombuffer(out, shown).reshape(phase.shape)
    mine, clipped = in_rows(demodulator, counts, phase, kind)
    assert 1000 < np.isnan(mine).sum() < 10000 and 1000 < clipped.sum() < 50000
    np.testing.assert_array_equal(np.stack([theirs["wd"], theirs["wq"]]), np.stack([mine.real, mine.imag]))
    np.testing.assert_array_equal(theirs["clipped"], clipped)


def test_a_clipped_converter_is_seen_as_long_as_a_step_lasts():
    """Counts of 2047 and -2048 are the ends of 12 bits: it is said for a hundred samples, a step of the
    controller."""
    demodulator = designed().demodulator
    assert (demodulator.most, demodulator.patience) == (2047.0, 100.0)
    state, said = demodulator.init(), []
    turn = Turn.of(0)
    for k in range(400):
        sample = 2047.0 if k == 50 else -2048.0 if k == 250 else math.nan if k == 60 else 2046.0
        state, *_ = demodulator.step(state, sample, Turn(float(turn.u), bool(turn.odd), bool(turn.half)))
        said.append(state.clipped > 0)
    assert [k for k in range(400) if said[k] != said[k - 1]] == [
        50,
        151,
        250,
        350,
    ]  # the missing one does not count


def test_the_self_test_can_fail(tmp_path):
    """Sine and cosine exchanged, or a filter more: the program on the target says so."""
    compiled(designed(), tmp_path, "single", DEMODULATE_C, "-DSAMPLES=1")
    source = (tmp_path / "dq_pi.c").read_text()
    for good, bad in (
        ("near_cos = odd ? -s : c", "near_cos = odd ? s : c"),
        ("k < 4; k++) {\n            d = s", "k < 3; k++) {\n            d = s"),
    ):
        assert good in source
        (tmp_path / "dq_pi.c").write_text(source.replace(good, bad))
        subprocess.run(
            ["cc", "-O0", "main.c", "dq_pi.c", "-DSAMPLES=1", "-o", "bad"], cwd=tmp_path, check=True
        )
        assert subprocess.run([tmp_path / "bad"], input=b"").returncode == 2
