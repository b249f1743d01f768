"""Starting values from the data alone: candidates (tau, local resonance) of a log, in plain numpy, without an
optimiser.

Sweeps: a rational function with one pole, linear in its coefficients (Sanathanan & Koerner, IEEE TAC 8, 56,
1963), so that a complex, sloping background does no harm. Transients: poles of a matrix pencil on each
stretch of constant inputs (Hua & Sarkar, IEEE TASSP 38, 814, 1990), which needs neither start nor offset nor
gain.
"""

import numpy as np

from sysid.trials.record import FLUX
from sysid.trials.trial import Trial

# rows of a stretch that the pencil sees: enough for the pole, and its decomposition stays below a millisecond
SAMPLES = 240
STILL = 1e-8  # half widths of a window, by which a pole no longer moves


def candidates(trial: Trial) -> np.ndarray:
    """(n, 2) of tau in s and local resonance in Hz (NaN: none), the likely ones first; coarse ones fill the
    range."""
    log = trial.log
    if log.frequency is not None and np.ptp(log.frequency) > 0:
        found = _sweep(trial)
        if not trial.steady:
            found += _transient(trial)
    elif trial.steady:
        return np.empty((0, 2))
    else:
        found = _transient(trial)
    found = [(tau, f) for tau, f in found if np.isfinite(tau) and tau > 0 and not f <= 0]
    return np.array(found).reshape(-1, 2)


def _sweep(trial: Trial) -> list[tuple[float, float]]:
    log = trial.log
    order = np.argsort(log.frequency, kind="stable")
    f, y = log.frequency[order], log.response[order]
    if log.drive is not None and np.all(log.drive != 0):
        y = y / log.drive[order]
    y = y * f if log.response_unit == FLUX else y  # the impedance: in the flux its resistance goes with 1/f
    found = []
    for half in (1.0, 0.5, 0.25, 0.12):  # the whole sweep, then windows about its liveliest place
        window = _about_peak(f, y, half)
        if window.sum() >= 6 and len(np.unique(f[window])) >= 4:
            found += _lorentzian(f[window], y[window]) if log.amplitude_only else _pole(f[window], y[window])
    peak, span = f[np.argmax(np.abs(y - np.median(y)))], np.ptp(f)
    step = np.median(np.diff(np.unique(f)))
    widths = np.geomspace(max(step, 1e-4 * span), span, 6)
    return found + [(1 / (np.pi * w), p) for w in widths for p in {peak, f[np.argmax(np.abs(y))]}]


def _about_peak(f: np.ndarray, y: np.ndarray, fraction: float) -> np.ndarray:
    if fraction >= 1:
        return np.ones(len(f), bool)
    background = y[[0, -1]].mean()
    centre = f[np.argmax(np.abs(y - background))]
    return np.abs(f - centre) <= 0.5 * fraction * np.ptp(f)


def _pole(f: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    centre, half = f.mean(), max(np.ptp(f) / 2, 1e-300)
    poles = [_rational_pole((f - centre) / half, y, degree) for degree in (1, 2)]
    return [(1 / (2 * np.pi * half * abs(p.imag)), centre + half * p.real) for p in poles if p.imag != 0]


def _rational_pole(u: np.ndarray, y: np.ndarray, degree: int) -> complex:
    """Pole p of y = (A + B u + C u^2)/(u - p): u y = p y + A + B u + C u^2, reweighted by the last |u -
    p|."""
    weight, pole, before = np.ones(len(u)), 0j, np.inf
    design = np.column_stack([y] + [u**k for k in range(degree + 1)])
    for _ in range(8):
        pole = np.linalg.lstsq(design * weight[:, None], u * y * weight, rcond=None)[0][0]
        if abs(pole - before) < STILL:
            break
        distance = np.abs(u - pole)
        weight, before = 1 / np.maximum(distance, 1e-3 * np.max(distance) + 1e-12), pole
    return pole


def phase_falls(trial: Trial) -> bool:
    """Whether the phase of a d/q sweep falls through the resonance, as e^{+j omega t} makes it: a pole above
    the real axis."""
    log = trial.log
    f, y = (
        log.frequency,
        log.response if log.drive is None else log.response / np.where(log.drive == 0, 1.0, log.drive),
    )
    if np.ptp(f) == 0 or len(f) < 6:
        return True
    return bool(_rational_pole((f - f.mean()) / (np.ptp(f) / 2), y, 2).imag > 0)


def _lorentzian(f: np.ndarray, w: np.ndarray) -> list[tuple[float, float]]:
    """1/w^2 is a parabola in f: its vertex is the resonance, and its width at twice the vertex the half
    bandwidth."""
    centre, half = f.mean(), max(np.ptp(f) / 2, 1e-300)
    u = (f - centre) / half
    if not np.any(w):
        return []
    w = np.maximum(np.abs(w), 1e-9 * np.max(np.abs(w)))
    weight = w**3
    c0, c1, c2 = np.linalg.lstsq(
        np.column_stack([np.ones(len(u)), u, u**2]) * weight[:, None], weight / w**2, rcond=None
    )[0]
    if c2 <= 0:
        return []
    vertex = -c1 / (2 * c2)
    least = c0 - c2 * vertex**2
    width = np.sqrt(least / c2) if least > 0 else 0.1
    return [(1 / (2 * np.pi * half * width), centre + half * vertex)]


def _transient(trial: Trial) -> list[tuple[float, float]]:
    log = trial.log
    inputs = np.stack(
        [np.nan_to_num(np.zeros(len(log)) if c is None else c) for c in (log.drive, log.frequency)]
    )
    if log.sampling == "settled":
        inputs = np.concatenate([inputs[:, 1:], inputs[:, -1:]], axis=1)
    edges = np.flatnonzero(np.append(True, np.any(inputs[:, 1:] != inputs[:, :-1], axis=0)))
    ends = np.append(edges[1:], len(log) - 1)
    stretches = sorted(
        zip(edges, ends, strict=True), key=lambda s: _liveliness(log, int(s[0]), int(s[1])), reverse=True
    )
    found = []
    for begin, end in stretches[:3]:
        drive_frequency = np.nan if log.frequency is None else log.frequency[begin]
        for pole in _pencil(log.time[begin : end + 1], log.response[begin : end + 1], trial.signed):
            found.append((-1 / pole.real, drive_frequency + pole.imag / (2 * np.pi)))
    at = [np.nan] if log.frequency is None else [float(np.median(log.frequency))]
    span = (log.time[-1] - log.time[0]) or 1.0  # of a single moment any time constant is as good
    return found + [(t, f) for t in np.geomspace(2e-4 * span, 2 * span, 13) for f in at]


def _liveliness(log, begin: int, end: int) -> float:
    """How much happens in a stretch: its variation, less that due to the noise of its rows."""
    y = log.response[begin : end + 1]
    if len(y) < 8:
        return 0.0
    jitter = np.median(np.abs(np.diff(y))) if len(y) > 8 else 0.0
    return float(np.std(y) * np.sqrt(len(y)) - jitter)


def _pencil(t: np.ndarray, y: np.ndarray, signed: bool) -> list[complex]:
    """Decaying poles of y (or of w^2, where only the amplitude is known) beside the constant."""
    if len(t) < 8 or t[-1] <= t[0]:
        return []
    found: list[complex] = []
    for share in (1.0, 0.3, 0.1, 0.03, 0.01):
        n = int(share * len(t))
        if n < 8:
            break
        grid = np.linspace(t[0], t[0] + share * (t[-1] - t[0]), min(max(n, 8), SAMPLES))
        values = _averaged(grid, t, y if signed else np.abs(y) ** 2)
        found += _matrix_pencil(values, grid[1] - grid[0], 2 if signed else 4, signed)
    return found


def _averaged(grid: np.ndarray, t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """y on `grid`: means of the rows nearest to each point where there are many, else interpolated."""
    near = np.clip(np.rint((t - grid[0]) / (grid[1] - grid[0])).astype(int), 0, len(grid))
    near[t > grid[-1] + 0.5 * (grid[1] - grid[0])] = len(grid)
    count = np.bincount(near, minlength=len(grid) + 1)[:-1]
    if np.all(count > 1):
        total = (
            np.bincount(near, y.real, len(grid) + 1)[:-1]
            + 1j * np.bincount(near, np.imag(y), len(grid) + 1)[:-1]
        )
        return total / count
    return np.interp(grid, t, y.real) + 1j * np.interp(grid, t, np.imag(y))


def _matrix_pencil(y: np.ndarray, dt: float, order: int, signed: bool) -> list[complex]:
    length = len(y) // 3
    hankel = np.lib.stride_tricks.sliding_window_view(y, length + 1)
    right = np.linalg.eigh(hankel.T @ hankel.conj())[1][
        :, ::-1
    ]  # its right singular vectors, in a quarter of the time
    found = []
    for rank in {2, order}:
        v = right[:, :rank]
        shift = np.linalg.lstsq(v[:-1], v[1:], rcond=None)[0]
        z = np.linalg.eigvals(shift)
        poles = np.log(np.where(z == 0, 1e-12, z)) / dt
        span = dt * len(y)
        for p in poles[poles.real < 0]:
            if abs(p) * span < 0.05 or -p.real * dt > 8:
                continue
            if signed:
                found.append(p)
            else:  # w^2 holds exp(2 s t), exp(s t) and exp(s t) cos(detuning t)
                found += [p, p.conjugate(), p.real + 0j, p.real / 2 + 0j]
    return found
