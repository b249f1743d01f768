"""A lock-in in software: samples of a carrier become Wd + j Wq, by blocks of a few periods or through
one-pole filters.

    w(t) = Re[(Wd + j Wq) e^{j theta}]

Times are counted in samples, frequencies in rad/sample.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

CHUNK = 1 << 18  # samples that are worked on at a time


QUADRATIC, CUBIC = 2, 3  # the degree of W's course over a block


def lock_in(
    signal: np.ndarray,
    phase: np.ndarray,
    rate: np.ndarray | float = 0.0,
    order: int = 0,
    degree: int = QUADRATIC,
) -> np.ndarray:
    """(m, degree + 1) complex c of `signal` (m, n), a block a row, at theta = `phase` (m, n):

        signal = offset + Re[(c0 + c1 x + c2 (x^2 - mean) + c3 x^3) e^{j theta}],   x from -1/2 to 1/2,

    by least squares. c0 is the mean of W over the block: that of 2 signal e^{-j theta}, freed of its image at
    twice the carrier also where the block is no whole number of periods, an offset is there, or W changes
    within it, but for the image of what is of a higher degree. Two periods are enough: the noise of c0 is
    then 1.5 % above sqrt(2/n) of a sample's, and 10 % above it for a cubic. Of an
    `order` of 1 or 2 the signal is that derivative of the right side, per sample, where theta turns by
    `rate`, omega (m,). Raises LinAlgError when the shapes cannot be told apart.
    """
    n = signal.shape[1]
    x = (np.arange(n) - (n - 1) / 2) / n
    one, none, spin = np.ones(n), np.zeros(n), 1j * np.reshape(rate, (-1, 1, 1))
    # each with its derivatives; that of s e^{j theta} is (j omega s + s') e^{j theta}
    powers = [
        [one, none, none],
        [x, one, none],
        [x**2 - np.mean(x**2), 2 * x, 2 * one],
        [x**3, 3 * x**2, 6 * x],
    ]
    shapes, *more = (np.stack(s) / n**k for k, s in enumerate(zip(*powers[: degree + 1], strict=True)))
    for _ in range(order):
        shapes, *more = (spin * s + d for s, d in pairwise([shapes, *more, 0 * more[-1]]))
    turned = shapes * np.exp(1j * phase)[:, None]
    design = np.concatenate([np.ones((len(turned), 1, n)), turned.real, -turned.imag], axis=1)
    found = np.linalg.solve(design @ design.transpose(0, 2, 1), design @ signal[..., None])[..., 0]
    return found[:, 1 : degree + 2] + 1j * found[:, degree + 2 :]


def blocks(
    signal: np.ndarray,
    start: np.ndarray,
    n: int,
    phase: np.ndarray,
    omega: np.ndarray | float,
    order: int = 0,
    degree: int = QUADRATIC,
) -> np.ndarray:
    """`lock_in` of the blocks of `n` samples that begin at `start` (m,), where theta is `phase` (m,) and
    turns by `omega`."""
    t, omega = np.arange(n), np.broadcast_to(omega, len(start))
    found = np.empty((len(start), degree + 1), complex)
    for k in _chunks(len(start), n):
        theta = phase[k, None] + omega[k, None] * t
        found[k] = lock_in(signal[start[k, None] + t], theta, omega[k], order, degree)
    return found


def low_pass(
    signal: np.ndarray, phase: np.ndarray, tau: float, order: int = 1, start: complex = 0.0
) -> np.ndarray:
    """(n,) complex: 2 signal e^{-j phase} of samples (n,) through `order` one-pole filters of `tau` samples.

    `start` is what they held before. Of the image at twice the carrier (1/(2 omega tau))^order of W is left.
    """
    from scipy.signal import lfilter

    found, keep = np.empty(len(signal), complex), np.exp(-1 / tau)
    states = np.full((order, 1), keep * start, complex)
    for part in _chunks(len(signal), 1):
        found[part] = 2 * signal[part] * np.exp(-1j * phase[part])
        for state in states:
            found[part], state[:] = lfilter([1 - keep], [1, -keep], found[part], zi=state)
    return found


def _chunks(rows: int, width: int) -> Iterator[slice]:
    step = max(CHUNK // width, 1)
    return (slice(k, k + step) for k in range(0, rows, step))
