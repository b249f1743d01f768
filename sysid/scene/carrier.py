"""The carrier: raw samples of drive and response as from a fast recorder, and rows from a lock-in behind it.

    v(t) = Re[jV e^{j theta}]        w(t) = Re[(Wd + j Wq) e^{j theta}]        theta' = omega

The envelope is exact, so the samples are exact too. A phase shift of a sensor or a demodulator turns the
response and not the drive. theta is counted in whole turns from the beginning of each chunk.
"""

import dataclasses
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sysid.demodulation.lockin import lock_in, low_pass
from sysid.scene import engine
from sysid.scene.effects import FrequencyResolution, LockIn, PhaseReset, Quantisation, Saturation
from sysid.scene.profile import Profile
from sysid.scene.scene import Scene, SceneError
from sysid.scene.timeline import Columns, inputs_at, rows
from sysid.whole import in_place_of


class Samples(NamedTuple):
    """Raw samples (n,): `time` s, `drive`, `response`, and the `phase` theta (rad, within one turn of zero)
    behind them."""

    time: np.ndarray
    drive: np.ndarray
    response: np.ndarray
    phase: np.ndarray


def waveform(scene: Scene, rate: float, seed: int = 0) -> Iterator[Samples]:
    """Raw samples of a scene at `rate` Hz, chunk by chunk. Noise is that of each sample; a recorder's
    clipping and steps act on the carrier. Raises SceneError for a rate at which the carrier aliases."""
    highest = float(np.max(scene.inputs["frequency"].values))
    if not rate > 2.2 * highest:
        raise SceneError(
            f"{scene.name}: found {rate:g} samples a second, expected more than 2.2 times {highest:g} Hz"
        )
    if scene.kind == "steady":
        raise SceneError(
            f"{scene.name}: found a scene of settled points, expected kind = 'transient': a carrier has time"
        )
    if scene.find(PhaseReset):
        raise SceneError(
            f"{scene.name}: found effects.phase_reset, expected a source whose phase goes on: a waveform"
            f" has no frame"
        )
    recorder = [e for e in scene.effects if isinstance(e, Saturation | Quantisation)]
    rest = tuple(e for e in scene.effects if not isinstance(e, Saturation | Quantisation | LockIn))
    count = int(np.floor(scene.duration * rate * (1 + 1e-12))) + 1
    fast = dataclasses.replace(
        scene, effects=rest, rate=rate, rows=count, fidelity="exact", substeps=1, amplitude_only=False
    )
    theta, first = partial(_phase, fast, _made(scene)), 0
    for columns in rows(fast, seed, 0, fast.rows, theta):
        time = columns["time"]
        phase = theta(first, len(time))
        first += len(time)
        drive = inputs_at(fast, time)["drive"]
        response = (columns["response"] * np.exp(1j * phase)).real
        with jax.enable_x64(True):
            for e in recorder:
                response = np.asarray(e.noise(jnp.asarray(response, complex), None, None, None)[0]).real
        yield Samples(time, -drive * np.sin(phase), response, phase)


PER_PERIOD = 16  # samples, of the carrier that a lock-in is given
MOST = 50_000_000  # samples


def behind_lock_in(scene: Scene, seed: int = 0) -> Columns:
    """Columns of the scene's rows from its carrier, by the scene's lock-in or by one that looks at two
    periods before each row.

    The carrier of a plate that is switched holds a free decay, up to 1/(2Q) of the step, that depends on the
    phase at the switch and that no envelope has. Raises SceneError when rows are closer than two periods, or
    too many samples were needed.
    """
    frequency = _made(scene).values
    each = int(np.ceil(PER_PERIOD * np.max(frequency) / scene.rate))
    n = int(np.ceil(2 * each * scene.rate / np.min(frequency)))
    if scene.rows * each > MOST:
        raise SceneError(
            f"{scene.name}: found {scene.rows * each} samples of a carrier, expected {MOST} at most"
        )
    if (filtered := scene.find(LockIn)) is None and n > each:
        most = scene.rate * each / n
        raise SceneError(
            f"{scene.name}: found rows closer than two periods of the carrier, expected a rate below"
            f" {most:g} Hz"
        )
    quiet = dataclasses.replace(
        scene, effects=tuple(e for e in scene.effects if e.kind != "noise"), fidelity="exact"
    )
    parts = list(waveform(quiet, scene.rate * each))
    signal, phase = (np.concatenate([getattr(p, name) for p in parts]) for name in ("response", "phase"))
    if filtered is not None:
        response = low_pass(signal, phase, float(filtered.tau) * scene.rate * each, filtered.order)[::each]
    else:
        response = np.append(0.0, _ends(signal, phase, each * np.arange(1, scene.rows), n))
    with jax.enable_x64(True):
        key = engine.key_of(seed, scene.name)
        states = engine.start(scene.plant, scene.effects, key).noise
        response = np.asarray(
            engine.noisy(scene.effects, jnp.asarray(response), states, key, 0, 1 / scene.rate)[0]
        )
    time = np.arange(scene.rows) / scene.rate
    return {
        "time": time,
        **inputs_at(scene, time, commanded=True),
        "response": np.abs(response) if scene.amplitude_only else response,
    }


def _ends(signal: np.ndarray, phase: np.ndarray, last: np.ndarray, n: int) -> np.ndarray:
    """W at the samples `last`, each from the `n` samples up to it."""
    found = np.empty(len(last), complex)
    end, mean = (n - 1) / (2 * n), (n**2 - 1) / (12 * n**2)
    for k in np.array_split(np.arange(len(last)), max(len(last) * n // 1_000_000, 1)):
        block = last[k, None] + np.arange(1 - n, 1)
        found[k] = lock_in(signal[block], phase[block]) @ np.array([1.0, end, end**2 - mean])
    return found


def write_waveform(scene: Scene, rate: float, seed: int, path: str | Path) -> Iterator[int]:
    """Write the raw samples as a log of `kind: waveform`; yields the number of samples written so far."""
    done = 0
    with in_place_of(path) as (fresh,), open(fresh, "w", encoding="utf-8", newline="\n") as file:
        plate = {"plate": scene.metadata["plate"]} if "plate" in scene.metadata else {}
        file.writelines(f"# {key}: {value}\n" for key, value in (plate | {"kind": "waveform"}).items())
        file.write(f"time_s,drive_{scene.drive_unit},response_{scene.response_unit}\n")
        for samples in waveform(scene, rate, seed):
            columns = (samples.time.tolist(), samples.drive.tolist(), samples.response.tolist())
            file.writelines(f"{t!r},{v:.9g},{w:.9g}\n" for t, v, w in zip(*columns, strict=True))
            done += len(samples.time)
            yield done


def _phase(scene: Scene, frequency: Profile, first: int, count: int) -> np.ndarray:
    """theta of `count` samples from sample `first`: that of the reference in whole turns, exact, and how far
    the drive is off."""
    reference = Fraction(scene.reference)
    turns = float(reference * first / Fraction(scene.rate) % 1) + scene.reference / scene.rate * np.arange(
        count
    )
    time = (first + np.arange(count)) / scene.rate
    return 2 * np.pi * ((turns + frequency.integral(time, less=scene.reference)) % 1.0)


def _made(scene: Scene) -> Profile:
    """The frequency that the source makes. Raises SceneError for a ramp that the source rounds: when, nothing
    says."""
    frequency, resolution = scene.inputs["frequency"], scene.find(FrequencyResolution)
    if resolution is None:
        return frequency
    if not (frequency.held or frequency.is_constant):
        raise SceneError(
            f"{scene.name}: found a ramp of the frequency and effects.frequency_resolution, expected steps"
        )
    return Profile(frequency.times, resolution.step * np.round(frequency.values / resolution.step))
