"""Where else a fit that sees amplitudes alone may have its minimum: images of one that was found, as trials and theta."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.trials.trial import LEAST_WARMING, Trial

Begin = tuple[tuple[Trial, ...], np.ndarray]


def images(trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float], drifts: bool) -> list[Begin]:
    """All of a minimum at theta; `drifts`: whether k_T is free."""
    begun = any(t.begun for t in trials)
    return [*_mirrored(trials, theta, reference, drifts), *([as_settled(trials, theta)] if begun else [])]


def _mirrored(trials: Sequence[Trial], theta: np.ndarray, reference: tuple[float, float], drifts: bool) -> list[Begin]:
    """The resonance as far on the other side of each constant drive of which only the amplitude is known, as of settled points
    that a demodulator of any phase has turned: by its level; by its temperature coefficient, about the temperature of the other
    logs. That log's start is mirrored with it."""
    resonant = [t for t in trials if t.resonant]
    level, drift = theta[2:4] * [1, drifts]
    warming = {id(t): float(np.mean(t.hold(reference).warming)) for t in resonant}
    mirrored = {}
    for trial in (t for t in resonant if _of_size_alone(t) and np.ptp(t.log.frequency) == 0):
        turned = tuple(replace(t, start=np.conj(t.start)) if t is trial else t for t in trials)
        image = 2 * (trial.log.frequency[0] - reference[0]) - level - drift * warming[id(trial)]
        mirrored[image - drift * warming[id(trial)], drift] = turned
        others = [warming[id(t)] for t in resonant if abs(warming[id(t)] - warming[id(trial)]) > LEAST_WARMING]
        if drifts and others:
            pivot = float(np.mean(others))
            slope = (image - level - drift * pivot) / (warming[id(trial)] - pivot)
            mirrored[level + (drift - slope) * pivot, slope] = turned
    return [(turned, np.array([*theta[:2], *to, *theta[4:]])) for to, turned in sorted(mirrored.items())]


def _of_size_alone(trial: Trial) -> bool:
    return trial.log.amplitude_only or (trial.steady and "rotation" in trial.nuisances)


def as_settled(trials: Sequence[Trial], theta: np.ndarray, more: float = 1.0) -> Begin:
    """Amplitudes that had settled as they began: another start and another G may look alike. `more`: times as much G besides."""
    size = next(abs(1 + t.start) for t in trials if t.begun) or 1.0
    settled = tuple(replace(t, start=0.0) if t.begun else t for t in trials)
    return settled, theta + np.log(size * more) * np.eye(1, len(theta))[0]
