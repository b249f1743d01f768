"""What a sweep shows besides a single, linear resonance: it softens, or something else moves with it."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import About, Effect, Told, number, read_anew
from sysid.trials.perturbed import Course
from sysid.trials.trial import Trial
from sysid.verdict.finding import Number

SHIFTS = 2.0 ** np.arange(-7, 0)  # of the sweep, at the largest response: what shifts by more has left it
APART = 2.0 ** np.arange(0, 5)  # half bandwidths from the resonance, to both sides: nearer ones show as a single peak
TURNS = np.exp(0.5j * np.pi * np.arange(4))
LEAST_ROWS = 8
# Of the largest response: a capacitance in parallel is in quadrature; its loss, and a path that is resistive,
# are in phase.
CAPACITIVE, RESISTIVE = 0.3, 0.05


def _sweep(trial: Trial) -> bool:
    """Settled points of a sweep, each of them driven."""
    return trial.swept and trial.driven and len(trial.log) >= LEAST_ROWS and bool(np.all(trial.inputs.drive != 0))


def _sweep_or_transient(trial: Trial) -> bool:
    """A sweep, or d and q of a transient whose inputs change."""
    return _sweep(trial) or _moving(trial)


def _moving(trial: Trial) -> bool:
    moved = not trial.steady and trial.resonant and trial.signed and trial.driven and trial.changes > 0
    return moved and trial.log.theta is None


def _softened(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """A Duffing plate is one whose resonance is f0 + kappa |W|^2 (Nayfeh & Mook, Nonlinear Oscillations, 1979,
    4.1): row k shows, whichever way a sweep came, what a linear plate shows at f_k - kappa |W_k|^2, and so from
    one row of a transient to the next."""
    power = (np.abs(trial.log.response) / about.top) ** 2
    power = power if trial.steady else 0.5 * (power + np.append(power[1:], power[-1]))
    moved = read_anew(trial, frequency=trial.log.frequency - values[0] * about.span * power)
    return replace(moved, narrow=trial.narrow)


def _softened_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift, at = found["shift_Hz"], found["at"]
    return Told(
        f"the frequency depends on the amplitude, by {shift.value:+.3g} ± {shift.std:.1g} Hz at {at.value:.2g}"
        f" {trial.log.response_unit}",
        "f0 is that of a small one; a sweep jumps where the peak leans over (hysteresis); record at a smaller drive",
    )


DUFFING = Effect(
    name="duffing",
    shows=_sweep_or_transient,
    stds=lambda trial, about: np.array([SHIFTS[-1]]),
    starts=lambda trial, about: np.concatenate([-SHIFTS, SHIFTS])[:, None],
    applied=_softened,
    numbers=lambda values, stds, about: {
        "shift_Hz": number(values[0], stds[0], "Hz", about.span),
        "at": number(about.top, 0.0, "of the response"),
    },
    said=_softened_said,
    scope="plate",
    afresh=True,
    known_as=("amplitude",),
    alike=("amplitude", "saturation", "second resonance", "drift", "background", "swept too fast"),
)


def _second(trial: Trial, place: float, width: float, about: About) -> np.ndarray:
    """(n,) response of a mode `place` half bandwidths above the first and e^width times as slow, from rest, of size one where
    the largest drive of the logs holds it at its resonance."""
    theta = about.theta + np.array([0.0, width, place * about.half_bandwidth, 0.0, 0.0, 0.0])
    theta[0] = -np.log(about.drive)
    return Course.of(trial, about.reference, theta).forced


def _second_said(trial: Trial, found: dict[str, Number]) -> Told:
    apart = found["apart_Hz"]
    side = "above" if apart.value > 0 else "below"
    return Told(
        f"a second resonance, {abs(apart.value):.4g} ± {apart.std:.1g} Hz {side} the first and of"
        f" {100 * found['size'].value:.2g} % of its response",
        "a controller of the first alone does not know it: keep it away from there",
    )


def _second_numbers(values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time, size = float(np.exp(values[1])) * about.tau, float(np.hypot(*values[2:]))
    return {
        "apart_Hz": number(values[0], stds[0], "Hz", about.half_bandwidth),
        "tau_s": number(time, time * stds[1], "s"),
        "size": number(size, np.max(stds[2:]), "of the largest response"),
    }


def _second_beside(trial: Trial, values: np.ndarray, about: About) -> Trial:
    size = (values[2] + 1j * values[3]) * about.top
    more = size * _second(trial, values[0], values[1], about)
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


SECOND_MODE = Effect(
    name="second_mode",
    shows=_sweep_or_transient,
    stds=lambda trial, about: np.array([APART[-1], 1.0, 1.0, 1.0]),
    starts=lambda trial, about: np.array(
        [[way * x, 0.0, 0.5 * turn.real, 0.5 * turn.imag] for x in APART for way in (-1, 1) for turn in TURNS]
    ),
    applied=_second_beside,
    numbers=_second_numbers,
    said=_second_said,
    many=True,
    scope="bench",
    known_as=("second resonance",),
    alike=("second resonance", "background", "amplitude", "drift", "swept too fast"),
    makes_sense=lambda values, stds: bool(abs(values[0]) >= APART[0] > stds[0]),
)


def _fed_through(trial: Trial, values: np.ndarray, about: About) -> Trial:
    drive = trial.inputs.drive[trial.inputs.interval]
    more = (values[0] + 1j * values[1]) * about.top * drive / np.max(np.abs(drive))
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


def _fed_said(trial: Trial, found: dict[str, Number]) -> Told:
    in_phase, across = found["in_phase"], found["in_quadrature"]
    share, error = (100 * float(np.hypot(*x)) for x in ((in_phase.value, across.value), (in_phase.std, across.std)))
    return Told(
        f"under its amplitude lies a feedthrough of the drive, {share:.2g} ± {error:.1g} % of the largest response",
        "of a capacitance in parallel, or of a resonance outside of the sweep; record wd and wq, or both parts of the admittance",
    )


FEEDTHROUGH = Effect(
    name="feedthrough",
    shows=lambda trial: _sweep(trial) and not trial.signed and "background" in trial.nuisances,
    stds=lambda trial, about: np.array([RESISTIVE, CAPACITIVE]),
    starts=lambda trial, about: np.array([[s * turn.real, s * turn.imag] for s in (0.01, 0.05, 0.2, 0.6) for turn in TURNS]),
    applied=_fed_through,
    numbers=lambda values, stds, about: {
        "in_phase": number(values[0], stds[0], "of the largest response"),
        "in_quadrature": number(values[1], stds[1], "of the largest response"),
    },
    said=_fed_said,
    alike=("second resonance", "background", "amplitude", "drift", "offset", "saturation"),
)
