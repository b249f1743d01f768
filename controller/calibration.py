"""The loop's own sensor calibrated against that of the logs, from one log of both: a CSV file with the
columns

    frequency_Hz, wd_*, wq_*, sensor_wd_*, sensor_wq_*

of settled points, the last two as the loop's demodulator shows them, in any unit. The sensor shows

    S = gain e^{j (rotation - 2 pi f delay)} W.

Over the few hundred Hz of a resonance this is nearly a straight line,  S = (a + b (f - mean)) W,  fitted by
least squares:

    gain = |a|,     delay = -Im(b/a) / (2 pi),     rotation = arg a + 2 pi mean delay.

The angle at the carrier is that of a. It is far better known than rotation or delay, whose errors compensate
each other. Noise in W is assumed small: of relative size s it makes the gain s^2 too small.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sysid.tables.cells import Dialect
from sysid.tables.csvbody import read_body
from sysid.tables.csvfile import LogError, read_head
from sysid.tables.units import convert

LEAST = 3  # rows


class Calibration(NamedTuple):
    """Gain, rotation in degrees, delay in s; standard deviations of the gain, of the angle at the mean
    `frequency` (Hz) in degrees, and of the delay, inf where all rows are at one frequency: it is taken as
    zero, and the rotation is the angle."""

    gain: float
    rotation: float
    delay: float
    gain_error: float
    angle_error: float
    delay_error: float
    frequency: float


def calibrate(path: str | Path) -> Calibration:
    """The sensor of a log of both. Raises LogError."""
    f, W, S = _read(str(path))
    mean = float(np.mean(f))
    spread = bool(np.ptp(f) > 1e-9 * mean)
    shapes = np.stack([W, (f - mean) * W], 1)[:, : 2 if spread else 1]
    least = LEAST + shapes.shape[1]
    if len(f) < least or not np.any(W):
        raise LogError(f"{path}: found {len(f)} rows, expected {least} or more, with a response")
    found, *_ = np.linalg.lstsq(shapes, S, rcond=None)
    left = S - shapes @ found
    # variance of each of the real and the imaginary part
    variance = float(np.sum(np.abs(left) ** 2)) / (2 * (len(f) - shapes.shape[1]))
    covariance = variance * np.linalg.inv((shapes.conj().T @ shapes).real)
    a = found[0]
    gain, error = abs(a), math.sqrt(covariance[0, 0]) / abs(a)
    delay, delay_error = 0.0, math.inf
    if spread:
        delay = -float((found[1] / a).imag) / (2 * math.pi)
        delay_error = math.sqrt(covariance[1, 1]) / gain / (2 * math.pi)
    turn = (math.degrees(float(np.angle(a)) + 2 * math.pi * mean * delay) + 180) % 360 - 180
    return Calibration(gain, turn, delay, error * gain, math.degrees(error), delay_error, mean)


def _read(path: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequency (n,) Hz, both responses (n,)."""
    head = read_head(path, Dialect())
    wanted = {}
    for name in ("frequency", "wd", "wq", "sensor_wd", "sensor_wq"):
        at = [k for k, label in enumerate(head.names) if label == name or label.startswith(f"{name}_")]
        if len(at) != 1:
            why = "expected one of each sensor's wd and wq, and frequency"
            raise LogError(f"{path}: found {len(at)} columns {name}_*, {why}")
        wanted[name] = at[0]
    body = read_body(head, list(wanted.values()))
    found = {name: body.numbers[at] for name, at in wanted.items()}
    there = np.all([np.isfinite(v) for v in found.values()], 0)
    units = {name: head.names[at].removeprefix(name).strip("_") for name, at in wanted.items()}
    pairs = (("wd", "wq"), ("sensor_wd", "sensor_wq"))
    for d, q in pairs:
        if units[d] != units[q]:
            raise LogError(f"{path}: found {d} in {units[d]!r} and {q} in {units[q]!r}, expected one unit")
    f = np.asarray(convert(found["frequency"], units["frequency"] or "Hz", "Hz"), float)
    W, S = (found[d] + 1j * found[q] for d, q in pairs)
    return f[there], W[there], S[there]
