"""What a plate is besides linear and of first order: it softens, is damped by how much or which way it moves,
or overshoots."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import (
    LEAST_ROWS,
    About,
    Effect,
    Told,
    always,
    at_others,
    fixed,
    followed,
    lasted,
    nowhere,
    one,
    oscillating,
    positive,
    resonating,
    shifted,
    sweep,
    sweep_or_moving,
)
from sysid.effects.number import Number, number, pm
from sysid.model.plant import SECOND
from sysid.model.theta import Theta
from sysid.rows.hold import cut
from sysid.trials.perturbed import FAR, LogResponse
from sysid.trials.trial import Trial

SHIFTS = 2.0 ** np.arange(-7, 0)  # of the sweep, at the largest response: what shifts by more has left it
MORE = np.array([-0.5, -0.1, 0.1, 0.5, 2.0])  # of the damping, at the largest response
PER_DEGREE = 0.03  # of the damping, per degC: of glue that softens, or of a liquid
BEND = 0.01  # half bandwidths per degC^2: one 10 degC from where f0 is told
BENDS = np.array([0.1, 0.5, 2.0])  # of it
AMPLITUDE = "amplitude"  # the law of what goes with how far the plate itself moves
LEAST_DAMPED = 0.05  # of the damping: with none of it the plate would run away
LEAST = 1e-6  # of a log: less is a plant of first order
SLOW = 0.25  # of a log, which is then little more than a period
SLOWER = 2.0 ** np.arange(-1, 3)  # of tau, the root of what the second derivative counts
PHASES = (-1.0, 0.0, 1.0)  # rad, of a decay


def _moves(trial: Trial, about: About) -> np.ndarray:
    """(n,) by how much the plate itself moves, over the largest response."""
    return np.abs(trial.log.response - trial.bench.fed) / about.top


def _softened(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """A Duffing plate is one whose resonance is f0 + kappa |W|^2 (Nayfeh & Mook, Nonlinear Oscillations,
    1979, 4.1): row k shows, whichever way a sweep came, what a linear plate shows at f_k - kappa |W_k|^2, and
    so from one row of a transient to the next."""
    power = _moves(trial, about) ** 2
    return shifted(trial, "frequency", -values[0] * about.span * power)


def _softened_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift = found["shift_Hz"]
    return Told(
        f"the frequency depends on the amplitude, by {shift:+.3g} Hz at the largest response",
        "f0 is that of a small one; a sweep jumps where the peak leans over (hysteresis); record at a"
        " smaller drive",
    )


DUFFING = Effect(
    name="duffing",
    law=AMPLITUDE,
    shows=resonating,
    stds=fixed(np.array([SHIFTS[-1]])),
    starts=fixed(np.concatenate([-SHIFTS, SHIFTS])[:, None]),
    applied=_softened,
    numbers=lambda trial, values, stds, about: {
        "shift_Hz": number(values[0], stds[0], "Hz", about.span),
        "at": number(about.top, 0.0, "of the response"),
    },
    said=_softened_said,
    scope="plate",
    afresh=lambda trial, about: trial.steady,  # of a transient a row is not as good as the next
    expected=True,
    shown_by=at_others(sweep_or_moving),
    vague=lambda trial, values: not trial.steady,  # rows of a transient tell one another, whatever it is
    makes_sense=followed,
)


BESIDE = np.array([0.3, 1.0, 3.0, 8.0])  # half bandwidths, from where the drive is looked for
WITHIN = 2.0  # half bandwidths, by which it is mostly missed where it was meant
RINGING = np.array([0.25, 0.5, 1.0, 2.0])  # half bandwidths beside the resonance, at which an amplitude rings


def _off_resonance(signed: bool) -> Effect:
    """A transient without a frequency, taken as driven at the resonance, was driven so many half bandwidths
    above it, or d and q of a decay are of a reference there. An amplitude is the same from either side, and
    decays as it does anywhere."""

    def shows(trial: Trial) -> bool:
        unknown = not (trial.steady or trial.resonant) and trial.signed is signed and (trial.driven or signed)
        turned = np.iscomplexobj(trial.log.response) or not signed  # one real channel may be of anything
        return unknown and turned and len(trial.log) >= LEAST_ROWS

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        inputs, f0 = trial.inputs, Theta.of(about.theta).f0
        driven = f0 + np.nan_to_num(about.reference[0]) + values[0] * about.half_bandwidth
        return replace(
            trial,
            inputs=inputs._replace(
                omega=np.full_like(inputs.omega, FAR), offset=np.full_like(inputs.offset, -driven)
            ),
        )

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        off = found["off_Hz"]
        what = "it was driven" if trial.driven else "the reference of d and q was"
        return Told(
            f"{what} about {abs(off):.3g} Hz off the resonance, and no frequency is recorded",
            "add a frequency_* column, or its value as metadata",
        )

    ways = BESIDE if not signed else np.concatenate([BESIDE, -BESIDE])
    return Effect(
        name="off_resonance",
        shows=shows,
        stds=fixed([WITHIN]),
        starts=fixed(ways[:, None]),
        applied=applied,
        numbers=lambda trial, values, stds, about: {
            "off_Hz": number(
                values[0] * about.half_bandwidth - about.moved, stds[0] * about.half_bandwidth, "Hz"
            )
        },
        said=said,
        linear=(0,) if signed else (),
        places=None if signed else lambda trial, about: RINGING[:, None],
        afresh=lambda trial, about: True,
        makes_sense=None if signed else positive,
    )


OFF_RESONANCE = (_off_resonance(True), _off_resonance(False))


def _turns(trial: Trial) -> bool:
    """Whether a log shows how far its plate is from its resonance."""
    return trial.resonant and (trial.signed or bool(np.ptp(trial.log.frequency) > 0))


def _amplitude_damped(power: int) -> Effect:
    """A plate that is damped by 1 + c (|W|/W_max)^power, |W| as recorded: by friction within it (2), by air
    that it stirs (1) (Baltanas et al., Am. J. Phys. 71, 2001, 2003). Of a transient the noise of |W| adds up
    from row to row, which its errors do not hold."""

    def shows(trial: Trial) -> bool:
        if trial.steady:
            return sweep(trial) and trial.whole is None
        level = trial.signed and not np.iscomplexobj(trial.log.response)  # a heater's, a motor's: no phase
        seen = trial.resonant or not trial.driven or level  # else it may be driven beside its resonance
        return seen and len(trial.log) >= LEAST_ROWS and trial.log.theta is None

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        inputs, size = trial.inputs, _moves(trial, about) ** power
        if not trial.steady:  # of the row before: its own noise would explain a part of each row
            inputs, row = cut(inputs)
            size = np.append(size[:1], size[:-1])[row]
        damped = np.maximum(1 + values[0] * size, LEAST_DAMPED)
        return replace(trial, inputs=inputs._replace(damped=damped))

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        more = found["more"]
        return Told(
            f"damping depends on the amplitude, by about {more:+.3g%} at the largest response",
            "G and tau are those of a small one; record at a smaller drive",
        )

    return Effect(
        name="amplitude_damping",
        law=AMPLITUDE,
        shows=shows,
        stds=fixed([1.0]),
        starts=fixed(MORE[:, None]),
        applied=applied,
        numbers=lambda trial, values, stds, about: {
            "more": number(values[0], stds[0], "of the damping"),
            "at": number(about.top, 0.0, "of the response"),
        },
        said=said,
        scope="plate",
        rough=lambda trial, values: not trial.steady,
        vague=lambda trial, values: not trial.steady,
        shown_by=at_others(shows),
        makes_sense=followed,
        # of long memory, where no phase turns; and friction seldom falls with the amplitude
        noise_like=lambda trial, values: values[0] < 0 and trial.noise.coloured and not _turns(trial),
    )


AMPLITUDE_DAMPING = tuple(map(_amplitude_damped, (1, 2)))


def _warm_damped(trial: Trial, values: np.ndarray, about: About) -> Trial:
    more = PER_DEGREE * values[0] * (trial.inputs.warming - about.reference[1])
    damped = trial.inputs.damped * np.maximum(1 + more, LEAST_DAMPED)
    return replace(trial, inputs=trial.inputs._replace(damped=damped))


def _warm_damped_said(trial: Trial, found: dict[str, Number]) -> Told:
    more, at = found["more"], found["at"]
    return Told(
        f"damping changes with the temperature, by {more:+.3g%} per degC",
        f"G and tau are those at {at.value:.4g} degC",
    )


TEMPERATURE_DAMPING = Effect(
    name="temperature_damping",
    law="temperature",
    shows=lambda trial: trial.resonant and trial.log.temperature is not None,
    stds=fixed([1.0]),
    starts=fixed(np.zeros((1, 1))),  # it is linear
    applied=_warm_damped,
    numbers=lambda trial, values, stds, about: {
        "more": number(values[0], stds[0], "1/degC", PER_DEGREE),
        "at": number(about.reference[1], 0.0, "degC"),
    },
    said=_warm_damped_said,
    scope="plate",
    known_as=("temperature",),
)


def _warm_gained(trial: Trial, values: np.ndarray, about: About) -> Trial:
    more = PER_DEGREE * values[0] * (trial.inputs.warming - about.reference[1])
    return replace(trial, inputs=trial.inputs._replace(drive=trial.inputs.drive * (1 + more)))


def _warm_gained_said(trial: Trial, found: dict[str, Number]) -> Told:
    more, at = found["more"], found["at"]
    return Told(
        f"G changes with the temperature, by {more:+.2g%} per degC",
        f"it is that at {at.value:.4g} degC; where force, mass and damping stay it goes as 1/f0",
    )


TEMPERATURE_GAIN = replace(
    TEMPERATURE_DAMPING,
    name="temperature_gain",
    applied=_warm_gained,
    said=_warm_gained_said,
    shows=lambda trial: trial.resonant and trial.driven and trial.log.temperature is not None,
    usual=True,
)


def _bent(trial: Trial, values: np.ndarray, about: About) -> Trial:
    away = trial.log.temperature - about.told
    return shifted(trial, "frequency", -BEND * values[0] * about.half_bandwidth * away**2)


def _bends(trial: Trial, about: About) -> np.ndarray:
    if about.bend:
        return np.array([[about.bend / (BEND * about.half_bandwidth)]])
    return np.concatenate([-BENDS, [0.0], BENDS])[:, None]


def _bent_said(trial: Trial, found: dict[str, Number]) -> Told:
    change, at = found["change"], found["at"]
    return Told(
        f"f0 is not linear in the temperature: k_T changes by {change:+.3g} Hz/degC per degC",
        f"f0 and k_T are those at {at.value:.4g} degC",
    )


# f0 + k_T (T - T0) + c (T - T0)^2 about the temperature T0 at which f0 and k_T are told. Of one temperature
# or two it is no more than another f0 and k_T.
CURVED = Effect(
    name="curved",
    law="temperature",
    shows=lambda trial: trial.resonant and trial.log.temperature is not None,
    stds=fixed([1.0]),
    starts=_bends,
    afresh=lambda trial, about: about.bend != 0,
    applied=_bent,
    numbers=lambda trial, values, stds, about: {
        "change": number(values[0], stds[0], "Hz/degC^2", 2 * BEND * about.half_bandwidth),
        "at": number(about.told, 0.0, "degC"),
    },
    said=_bent_said,
    scope="plate",
)


def _falls(trial: Trial) -> np.ndarray:
    """(M,) whether the drive of each interval, or else of the last that changed it, is lower than before."""
    change = np.diff(np.abs(trial.inputs.drive), prepend=0.0)
    last = np.maximum.accumulate(np.where(change != 0, np.arange(len(change)), 0))
    return change[last] < 0


def _asymmetric(trial: Trial, values: np.ndarray, about: About) -> Trial:
    damped = np.where(_falls(trial), max(1 + values[0], LEAST_DAMPED), 1.0)
    return replace(trial, inputs=trial.inputs._replace(damped=damped))


def _asymmetric_said(trial: Trial, found: dict[str, Number]) -> Told:
    more = found["more"]
    return Told(
        f"it falls with another time constant than it rises with: 1/tau is larger by {100 * more.value:+.3g}"
        f" ± {pm(100 * more.std)} % behind a drive that was lowered",
        "make logs of their own of what rises and of what falls",
    )


ASYMMETRIC = Effect(
    name="asymmetric",
    shows=lambda trial: (
        not trial.steady and trial.driven and bool(np.any(_falls(trial))) and trial.log.theta is None
    ),
    stds=fixed([1.0]),
    starts=fixed(MORE[:, None]),
    applied=_asymmetric,
    numbers=one("more", "of the damping"),
    said=_asymmetric_said,
    scope="plate",
    rough=always,
)


def _baseband(trial: Trial) -> bool:
    """A transient without a frequency, which is not behind a lock-in's filter."""
    alone = not trial.steady and not trial.resonant and trial.signed and len(trial.log) >= LEAST_ROWS
    return (
        alone
        and not np.iscomplexobj(trial.log.response)
        and trial.log.theta is None
        and trial.smoothing[1] == 0
        and lasted(trial) > 0
    )


def _ringing(trial: Trial, about: About) -> np.ndarray:
    """(m, 2): times as shares of the log, 1/(2 pi f) at the largest peaks f of the periodogram of what the
    first order leaves, and about tau; and phases (rad) of the oscillation at the first row."""
    course, whole = LogResponse.of(trial, about.reference, about.theta), lasted(trial)
    shapes = np.stack([course.forced.real, course.free.real, np.ones(len(trial.log))], axis=1)
    left = trial.log.response - shapes @ np.linalg.lstsq(shapes, trial.log.response, rcond=None)[0]
    largest = 1 / oscillating(trial.log.time, left) / whole
    if not trial.driven:
        return np.array([[x, phase] for x in largest for phase in PHASES])
    return np.array([[x, 0.0] for x in (*largest, *SLOWER * about.tau / whole)])


def _overshot(trial: Trial, values: np.ndarray, about: About) -> Trial:
    time = max(float(values[0]), LEAST) * lasted(trial)
    return trial.with_bench(filter=(time * np.exp(1j * values[1]), SECOND), extra={}, late=0.0)


def _overshot_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time, error = values[0] * lasted(trial), stds[0] / values[0]
    hertz, ratio = 1 / (2 * np.pi * time), about.fitted[0] / (2 * time)
    most = error + about.fitted[1]  # however the two go together
    return {
        "natural_Hz": number(hertz, hertz * error, "Hz"),
        "damping_ratio": number(ratio, ratio * most, "1"),
    }


def _overshot_said(trial: Trial, found: dict[str, Number]) -> Told:
    hertz, ratio = found["natural_Hz"], found["damping_ratio"]
    seen = f"natural frequency {hertz:.5g} Hz, damping ratio {ratio.value:.3g}"
    if not trial.driven:
        what = f"an oscillation itself, which was not demodulated ({seen})"
        return Told(what, "record it 20 times a period or more with its drive, or its amplitude, or d and q")
    to_do = "the controllers here are for its resonance: drive it there, and record d and q"
    return Told(f"of second order: it overshoots ({seen})", to_do)


OVERSHOOT = Effect(
    name="overshoot",
    shows=_baseband,
    stds=fixed(np.array([SLOW, PHASES[-1]])),
    starts=_ringing,
    applied=_overshot,
    numbers=_overshot_numbers,
    said=_overshot_said,
    scope="plate",
    rough=always,
    another=True,
    afresh=lambda trial, about: not trial.driven,
    places=nowhere,
    makes_sense=lambda trial, fitted: (  # more damped it is behind a filter
        fitted.positive() and fitted.tau < 2 * fitted.values[0] * lasted(trial)
    ),
)
