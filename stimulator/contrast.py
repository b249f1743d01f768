"""The contrast of friction along a stroke: of its plateaus, and at the texture's own spatial frequency."""

from typing import Any

import numpy as np

from stimulator.errors import refuse


def plateau(x: np.ndarray, mu: np.ndarray, period: float) -> float:
    """(high - low)/high of friction `mu` (n,), high and low the means of its largest and smallest values in
    each period (mm) that the finger at `x` (n,) mm crosses from one side to the other.

    It sees how deep a grating is and not whether it is where it should be: see `spectral`. Raises
    StimulatorError for a stroke that crosses no whole period.
    """
    begins, ends = _crossings(x, period)
    if not len(begins):
        refuse(
            "stroke.x",
            f"{np.min(x):g} to {np.max(x):g} mm",
            f"a stroke across a whole period of {period:g} mm",
        )
    most = np.maximum.reduceat(mu, begins)
    least = np.minimum.reduceat(mu, begins)
    keep = ends > begins
    high, low = float(np.mean(most[keep])), float(np.mean(least[keep]))
    return (high - low) / high if high > 0 else 0.0


def spectral(x: np.ndarray, mu: np.ndarray, period: float) -> float:
    """pi |<mu exp(-2 pi j x/period)>|/<mu>, means over the way of the finger, of `mu` (n,) at `x` (n,) mm:
    (high - low)/mean of an ideal square grating of duty 1/2, and little where edges are late, missing or
    elsewhere.

    Each pass in one direction counts by itself, by the length of its way: a grating that is late as a whole
    is still one. Raises StimulatorError for a finger that does not move.
    """
    step = np.gradient(x)
    way, wave = np.abs(step), mu * np.exp(-2j * np.pi * x / period)
    if not way.sum() > 0:
        refuse("stroke.x", f"{x[0]:g} mm throughout", "a finger that moves: a contrast is felt along a way")
    begins = np.flatnonzero(np.diff(np.sign(step), prepend=np.nan))
    length, waves, mean = (np.add.reduceat(way * v, begins) for v in (np.ones(len(x)), wave, mu))
    moves = length > 0
    return float(np.pi * np.sum(length[moves] * np.abs(waves[moves]) / mean[moves]) / length.sum())


def _crossings(x: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """First row of each stretch within one period, and the row after it where it is a whole crossing, else
    its first again."""
    cell = np.floor(x / period + 1e-9).astype(int)
    begins = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
    if len(begins) < 3:
        return np.empty(0, int), np.empty(0, int)
    ends = np.append(begins[1:], len(x))
    steps = np.diff(cell[begins])
    whole = np.zeros(len(begins), bool)
    whole[1:-1] = (steps[:-1] == steps[1:]) & (np.abs(steps[1:]) == 1)
    return begins, np.where(whole, ends, begins)


def plateau_contrast(touch: Any) -> float:
    """`plateau` of a Touch with friction and a texture that has a period. Raises StimulatorError for one
    without."""
    return plateau(touch.x, _friction(touch), _period(touch))


def spectral_contrast(touch: Any) -> float:
    """`spectral` of a Touch with friction and a texture that has a period. Raises StimulatorError for one
    without."""
    return spectral(touch.x, _friction(touch), _period(touch))


CONTRASTS = {"plateau": plateau_contrast, "spectral": spectral_contrast}


def _friction(touch: Any) -> np.ndarray:
    if touch.friction is None:
        refuse("friction", "nothing", "a law of friction: a contrast is one of friction")
    return touch.friction


def _period(touch: Any) -> float:
    period = getattr(touch.scene.texture, "period", None)
    if period is None or touch.scene.texture.kind == "noise":
        refuse(
            "texture", "nothing with a period", "kind = 'square' or 'sine': a contrast is one of a grating"
        )
    return float(period)
