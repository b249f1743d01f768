"""What a sweep shows besides a single, linear resonance: it softens, or something else moves with it."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import About, Effect, read_anew
from sysid.model.plant import steady
from sysid.trials.trial import Trial

SHIFTS = np.array([0.25, 0.7, 2.0, 6.0])  # half bandwidths at the largest response
APART = 2.0 ** np.arange(0, 5)  # half bandwidths from the resonance, to both sides: nearer ones show as a single peak
TURNS = np.exp(0.5j * np.pi * np.arange(4))
LEAST_ROWS = 8
# Of the largest response: a capacitance in parallel is in quadrature; its loss, and a path that is resistive, are in phase.
CAPACITIVE, RESISTIVE = 0.3, 0.05


def _sweep(trial: Trial) -> bool:
    """Settled points of a sweep, each of them driven."""
    return trial.swept and trial.driven and len(trial.log) >= LEAST_ROWS and bool(np.all(trial.inputs.drive != 0))


def _softened(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """A Duffing plate settles like one whose resonance is f0 + kappa |W|^2 (Nayfeh & Mook, Nonlinear Oscillations, 1979, 4.1):
    row k shows, whichever way the sweep came, what a linear plate shows at f_k - kappa |W_k|^2."""
    size = np.abs(trial.log.response)
    return read_anew(trial, frequency=trial.log.frequency - values[0] * about.half_bandwidth * (size / about.top) ** 2)


DUFFING = Effect(
    name="duffing",
    shows=_sweep,
    stds=lambda trial, about: np.array([SHIFTS[-1]]),
    starts=lambda trial, about: np.concatenate([-SHIFTS, SHIFTS])[:, None],
    applied=_softened,
    said=lambda trial, values, stds: (
        f"its resonance moves by {values[0]:+.3g} ± {stds[0]:.1g} half bandwidths at the largest response, which is fitted: f0 is"
        " that of a small one; a sweep jumps where the peak leans; record at a smaller drive"
    ),
    plate=True,
    alike=("amplitude", "saturation", "second resonance", "drift", "background", "swept too fast"),
)


def _second(trial: Trial, place: float, width: float, about: About) -> np.ndarray:
    """(n,) settled response, of size one, of a mode `place` half bandwidths above the first and `width` of its time constant."""
    hold = trial.hold(about.reference)
    detuning = 2 * np.pi * (hold.offset + about.theta[2] + place * about.half_bandwidth)
    shape = (hold.drive * steady(np.exp(width) * about.tau, detuning, hold.omega, np))[hold.interval]
    return shape / np.max(np.abs(shape))


def _second_said(place: float, std: float) -> str:
    side = "above" if place > 0 else "below"
    return (
        f"a second resonance, {abs(place):.3g} ± {std:.1g} half bandwidths {side} the first, is fitted; a controller of the first"
        " alone does not know it: keep it away from there"
    )


def _second_beside(trial: Trial, values: np.ndarray, about: About) -> Trial:
    size = (values[2] + 1j * values[3]) * about.top
    more = size * _second(trial, values[0], values[1], about)
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


SECOND_MODE = Effect(
    name="second_mode",
    shows=_sweep,
    stds=lambda trial, about: np.array([APART[-1], 1.0, 1.0, 1.0]),
    starts=lambda trial, about: np.array(
        [[way * x, 0.0, 0.5 * turn.real, 0.5 * turn.imag] for x in APART for way in (-1, 1) for turn in TURNS]
    ),
    applied=_second_beside,
    said=lambda trial, values, stds: _second_said(values[0], stds[0]),
    alike=("second resonance", "background", "amplitude", "drift", "swept too fast"),
    makes_sense=lambda values, stds: bool(abs(values[0]) >= APART[0] > stds[0]),
)


def _fed_through(trial: Trial, values: np.ndarray, about: About) -> Trial:
    drive = trial.inputs.drive[trial.inputs.interval]
    more = (values[0] + 1j * values[1]) * about.top * drive / np.max(np.abs(drive))
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


FEEDTHROUGH = Effect(
    name="feedthrough",
    shows=lambda trial: _sweep(trial) and not trial.signed and "background" in trial.nuisances,
    stds=lambda trial, about: np.array([RESISTIVE, CAPACITIVE]),
    starts=lambda trial, about: np.array([[s * turn.real, s * turn.imag] for s in (0.01, 0.05, 0.2, 0.6) for turn in TURNS]),
    applied=_fed_through,
    said=lambda trial, values, stds: (
        f"under its amplitude lies a feedthrough of the drive, {100 * float(np.hypot(*values)):.2g} ±"
        f" {100 * float(np.max(stds)):.1g} % of the largest response, as of a capacitance in parallel, which is fitted"
    ),
    alike=("second resonance", "background", "amplitude", "drift", "offset", "saturation"),
)
