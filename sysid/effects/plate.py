"""What a plate shows besides a single, linear resonance: it softens, drifts, or heats itself, something else
moves with it, it overshoots."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import SEEN, About, Effect, Told, number, read_anew
from sysid.model.plant import SECOND
from sysid.rows.hold import cut
from sysid.trials.heat import HEATED, clock, warmed
from sysid.trials.perturbed import Course
from sysid.trials.trial import Trial
from sysid.verdict.finding import Number

SHIFTS = 2.0 ** np.arange(-7, 0)  # of the sweep, at the largest response: what shifts by more has left it
APART = 2.0 ** np.arange(
    0, 5
)  # half bandwidths from the resonance, to both sides: nearer ones show as a single peak
TURNS = np.exp(0.5j * np.pi * np.arange(4))
DRIFTS = 0.1  # half bandwidths per degC, by which two modes drift apart: as much as each of them drifts
LEAST_ROWS = 8
MORE = np.array([-0.5, -0.1, 0.1, 0.5, 2.0])  # of the damping, at the largest response
LEAST_DAMPED = 0.05  # of the damping: with none of it the plate would run away
LEAST = 1e-6  # of a log: less is a plant of first order
SLOW = 0.25  # of a log, which is then little more than a period
SLOWER = 2.0 ** np.arange(-1, 3)  # of tau, the root of what the second derivative counts
PHASES = (-1.0, 0.0, 1.0)  # rad, of a decay
FINER, PEAKS = 2, 3  # steps of a periodogram over its own, and how many of its peaks are followed
# Of the largest response: a capacitance in parallel is in quadrature; its loss, and a path that is resistive,
# are in phase.
CAPACITIVE, RESISTIVE = 0.3, 0.05


def _sweep(trial: Trial) -> bool:
    """Settled points of a sweep, each of them driven."""
    return (
        trial.swept
        and trial.driven
        and len(trial.log) >= LEAST_ROWS
        and bool(np.all(trial.inputs.drive != 0))
    )


def _sweep_or_transient(trial: Trial) -> bool:
    """A sweep, or d and q of a transient whose inputs change."""
    return _sweep(trial) or _moving(trial)


def _moving(trial: Trial) -> bool:
    moved = not trial.steady and trial.resonant and trial.signed and trial.driven and trial.changes > 0
    return moved and trial.log.theta is None


def _softened(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """A Duffing plate is one whose resonance is f0 + kappa |W|^2 (Nayfeh & Mook, Nonlinear Oscillations,
    1979, 4.1): row k shows, whichever way a sweep came, what a linear plate shows at f_k - kappa |W_k|^2, and
    so from one row of a transient to the next."""
    power = (np.abs(trial.log.response) / about.top) ** 2
    power = power if trial.steady else 0.5 * (power + np.append(power[1:], power[-1]))
    moved = read_anew(trial, frequency=trial.log.frequency - values[0] * about.span * power)
    return replace(moved, narrow=trial.narrow)


def _softened_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift, at = found["shift_Hz"], found["at"]
    return Told(
        f"the frequency depends on the amplitude, by {shift.value:+.3g} ± {shift.std:.1g} Hz at"
        f" {at.value:.2g}"
        f" {trial.log.response_unit}",
        "f0 is that of a small one; a sweep jumps where the peak leans over (hysteresis); record at a"
        " smaller drive",
    )


DUFFING = Effect(
    name="duffing",
    shows=_sweep_or_transient,
    stds=lambda trial, about: np.array([SHIFTS[-1]]),
    starts=lambda trial, about: np.concatenate([-SHIFTS, SHIFTS])[:, None],
    applied=_softened,
    numbers=lambda trial, values, stds, about: {
        "shift_Hz": number(values[0], stds[0], "Hz", about.span),
        "at": number(about.top, 0.0, "of the response"),
    },
    said=_softened_said,
    scope="plate",
    afresh=lambda trial: trial.steady,  # of a transient a row is not as good as the next
    alike=("duffing", "saturation", "second_mode", "drift", "background", "dwell"),
)


def _timed(trial: Trial) -> bool:
    """A sweep or a transient whose rows are in the order in which they were recorded."""
    whole = trial.whole is None or not trial.steady
    return whole and (_sweep(trial) or _moving(trial)) and len(trial.log) >= LEAST_ROWS


def _shifted(trial: Trial, shift: np.ndarray) -> Trial:
    """The trial of a plate whose resonance is `shift` (n,) Hz above f0: a row shows what a plate that stays
    shows by as much below."""
    return replace(read_anew(trial, frequency=trial.log.frequency - shift), narrow=trial.narrow)


def _drifted_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift = found["shift_Hz"]
    return Told(
        f"its resonance drifts by {shift.value:+.3g} ± {shift.std:.1g} Hz from the first row to the last",
        "f0 is that amid the log; record the temperature of every row, or wait until it is constant",
    )


F0_DRIFT = Effect(
    name="f0_drift",
    shows=_timed,
    stds=lambda trial, about: np.array([SHIFTS[-1]]),
    starts=lambda trial, about: np.concatenate([-SHIFTS, SHIFTS])[:, None],
    applied=lambda trial, values, about: _shifted(trial, values[0] * about.span * (clock(trial.log) - 0.5)),
    numbers=lambda trial, values, stds, about: {"shift_Hz": number(values[0], stds[0], "Hz", about.span)},
    said=_drifted_said,
    known_as=("drift",),
    alike=("drift", "duffing", "saturation", "second_mode", "background", "dwell", "offset", "lag"),
)


def _heated(trial: Trial, values: np.ndarray, about: About) -> Trial:
    power, time = np.abs(trial.log.response) ** 2, HEATED[1] * float(np.exp(values[1]))
    return _shifted(trial, values[0] * about.span * warmed(clock(trial.log), power, time, 0.5 + values[2]))


def _heated_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift, time = found["shift_Hz"], found["time_s"]
    return Told(
        f"its resonance drifts by up to {shift.value:+.3g} ± {shift.std:.1g} Hz as the plate heats itself,"
        f" within about {time.value:.2g} s",
        "f0 is that before; record the temperature of every row on the plate, or drive it less",
    )


SELF_HEATING = Effect(
    name="self_heating",
    shows=lambda trial: _timed(trial) and trial.log.time is not None,
    stds=lambda trial, about: np.array([SHIFTS[-1], np.log(HEATED[2] / HEATED[1]), 0.5]),
    starts=lambda trial, about: np.array(
        [[x, np.log(t / HEATED[1]), 0.0] for t in HEATED for x in (*-SHIFTS[::2], *SHIFTS[::2])]
    ),
    applied=_heated,
    numbers=lambda trial, values, stds, about: {
        "shift_Hz": number(values[0], stds[0], "Hz", about.span),
        "time_s": number(
            float(np.exp(values[1])), float(np.exp(values[1])) * stds[1], "s", HEATED[1] * _lasted(trial)
        ),
    },
    said=_heated_said,
    known_as=("drift",),
    alike=("drift", "duffing", "saturation", "second_mode", "background", "dwell", "offset", "lag"),
    makes_sense=lambda values, stds: bool(abs(values[0]) > SEEN * stds[0]),
)


def _amplitude_damped(power: int, moving: bool) -> Effect:
    """A plate that is damped by 1 + c (|W|/W_max)^power, |W| as recorded: by friction within it (2), by air
    that it stirs (1) (Baltanas et al., Am. J. Phys. 71, 2001, 2003). Of a transient (`moving`) the noise of
    |W| adds up from row to row, which its errors do not hold."""

    def shows(trial: Trial) -> bool:
        if trial.steady:
            return not moving and _sweep(trial)
        return moving and len(trial.log) >= LEAST_ROWS and trial.log.theta is None

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        inputs, size = trial.inputs, np.abs(trial.log.response) / about.top
        between = size**power
        if moving:  # from row to row it decays about as an exponential: Simpson's rule
            (inputs, row), before = cut(inputs), np.append(size[:1], size[:-1])
            between = ((before**power + 4 * (before * size) ** (power / 2) + size**power) / 6)[row]
        damped = np.maximum(1 + values[0] * between, LEAST_DAMPED)
        return replace(trial, inputs=inputs._replace(damped=damped))

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        more, at = found["more"], found["at"]
        return Told(
            f"the damping depends on the amplitude, by {100 * more.value:+.3g} ± {100 * more.std:.1g} % at"
            f" {at.value:.2g} {trial.log.response_unit}",
            "G and tau are those of a small one; record at a smaller drive",
        )

    return Effect(
        name="amplitude_damping",
        shows=shows,
        stds=lambda trial, about: np.array([1.0]),
        starts=lambda trial, about: MORE[:, None],
        applied=applied,
        numbers=lambda trial, values, stds, about: {
            "more": number(values[0], stds[0], "of the damping"),
            "at": number(about.top, 0.0, "of the response"),
        },
        said=said,
        scope="plate",
        rough=moving,
        alike=(
            "saturation",
            "duffing",
            "late",
            "early",
            "astray",
            "second_mode",
            "background",
            "drift",
            "rows_lost",
        ),
    )


AMPLITUDE_DAMPING = tuple(_amplitude_damped(power, moving) for power in (1, 2) for moving in (False, True))


def _second(trial: Trial, place: float, width: float, drift: float, about: About) -> np.ndarray:
    """(n,) response of a mode `place` half bandwidths above the first and e^width times as slow, which each
    degC takes `drift` half bandwidths farther above it; from rest, of size one where the largest drive of the
    logs holds it at its resonance."""
    place, drift = place * about.half_bandwidth, drift * about.half_bandwidth
    theta = about.theta + np.array([0.0, width, place, drift, 0.0, 0.0])
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


def _second_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time, size = float(np.exp(values[1])) * about.tau, float(np.hypot(*values[2:4]))
    return {
        "apart_Hz": number(values[0], stds[0], "Hz", about.half_bandwidth),
        "tau_s": number(time, time * stds[1], "s"),
        "size": number(size, np.max(stds[2:4]), "of the largest response"),
    } | (
        {"drift": number(values[4], stds[4], "Hz/degC", about.half_bandwidth)}
        if stds[4] < 0.5 * DRIFTS
        else {}
    )


def _second_starts(trial: Trial, about: About) -> np.ndarray:
    """Places to both sides, from no size at all: d and q are linear in a mode of given place and width, so
    that one step leads to its size. Amplitudes are not: what turns them by a right angle shows only once it
    is there."""
    sizes = [0j] if trial.signed else list(0.5 * TURNS)
    return np.array([[way * x, 0.0, z.real, z.imag, 0.0] for x in APART for way in (-1, 1) for z in sizes])


def _seems_a_mode(values: np.ndarray, stds: np.ndarray) -> bool:
    """Whether it stands where another mode can, and has a size."""
    return bool(abs(values[0]) >= APART[0] > stds[0] and np.hypot(*values[2:4]) > SEEN * np.max(stds[2:4]))


def _second_beside(trial: Trial, values: np.ndarray, about: About) -> Trial:
    size = (values[2] + 1j * values[3]) * about.top
    more = size * _second(trial, values[0], values[1], values[4], about)
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


SECOND_MODE = Effect(
    name="second_mode",
    shows=_sweep_or_transient,
    stds=lambda trial, about: np.array([APART[-1], 1.0, 1.0, 1.0, DRIFTS]),
    starts=_second_starts,
    applied=_second_beside,
    numbers=_second_numbers,
    said=_second_said,
    many=True,
    scope="bench",
    alike=("second_mode", "background", "duffing", "drift", "dwell"),
    makes_sense=_seems_a_mode,
)


def _fed_through(trial: Trial, values: np.ndarray, about: About) -> Trial:
    drive = trial.inputs.drive[trial.inputs.interval]
    more = (values[0] + 1j * values[1]) * about.top * drive / np.max(np.abs(drive))
    return replace(trial, alongside=more if trial.alongside is None else trial.alongside + more)


def _fed_said(trial: Trial, found: dict[str, Number]) -> Told:
    in_phase, across = found["in_phase"], found["in_quadrature"]
    share, error = (
        100 * float(np.hypot(*x)) for x in ((in_phase.value, across.value), (in_phase.std, across.std))
    )
    return Told(
        f"under its amplitude lies a feedthrough of the drive, {share:.2g} ± {error:.1g} % of the largest"
        f" response",
        "of a capacitance in parallel, or of a resonance outside of the sweep; record wd and wq, or both"
        " parts of the admittance",
    )


FEEDTHROUGH = Effect(
    name="feedthrough",
    shows=lambda trial: _sweep(trial) and not trial.signed and "background" in trial.nuisances,
    stds=lambda trial, about: np.array([RESISTIVE, CAPACITIVE]),
    starts=lambda trial, about: np.array(
        [[s * turn.real, s * turn.imag] for s in (0.01, 0.05, 0.2, 0.6) for turn in TURNS]
    ),
    applied=_fed_through,
    numbers=lambda trial, values, stds, about: {
        "in_phase": number(values[0], stds[0], "of the largest response"),
        "in_quadrature": number(values[1], stds[1], "of the largest response"),
    },
    said=_fed_said,
    alike=("second_mode", "background", "duffing", "drift", "offset", "saturation"),
)


def _baseband(trial: Trial) -> bool:
    """A transient without a frequency, which is not behind a lock-in's filter."""
    alone = not trial.steady and not trial.resonant and trial.signed and len(trial.log) >= LEAST_ROWS
    return (
        alone
        and not np.iscomplexobj(trial.log.response)
        and trial.log.theta is None
        and trial.smoothing[1] == 0
        and _lasted(trial) > 0
    )


def _lasted(trial: Trial) -> float:
    """s, from the first row to the last."""
    return float(trial.log.time[-1] - trial.log.time[0])


def _ringing(trial: Trial, about: About) -> np.ndarray:
    """(m, 2): times as shares of the log, 1/(2 pi f) at the largest peaks f of the periodogram of what the
    first order leaves, and about tau; and phases (rad) of the oscillation at the first row."""
    from scipy.signal import find_peaks, lombscargle  # takes a third of a second to load

    course, lasted = Course.of(trial, about.reference, about.theta), _lasted(trial)
    shapes = np.stack([course.forced.real, course.free.real, np.ones(len(trial.log))], axis=1)
    left = trial.log.response - shapes @ np.linalg.lstsq(shapes, trial.log.response, rcond=None)[0]
    rates = np.pi / (FINER * lasted) * np.arange(1, FINER * len(left) + 1)
    power = lombscargle(trial.log.time - trial.log.time[0], left, rates)
    peaks = find_peaks(power)[0]
    largest = 1 / rates[peaks[np.argsort(-power[peaks])][:PEAKS]] / lasted
    if not trial.driven:
        return np.array([[x, phase] for x in largest for phase in PHASES])
    return np.array([[x, 0.0] for x in (*largest, *SLOWER * about.tau / lasted)])


def _overshot(trial: Trial, values: np.ndarray, about: About) -> Trial:
    time = max(float(values[0]), LEAST) * _lasted(trial)
    return replace(trial, filter=(time * np.exp(1j * values[1]), SECOND), extra={}, late=0.0)


def _overshot_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time, error = values[0] * _lasted(trial), stds[0] / values[0]
    hertz, ratio = 1 / (2 * np.pi * time), about.fitted[0] / (2 * time)
    most = error + about.fitted[1]  # however the two go together
    return {
        "natural_Hz": number(hertz, hertz * error, "Hz"),
        "damping_ratio": number(ratio, ratio * most, "1"),
    }


def _overshot_said(trial: Trial, found: dict[str, Number]) -> Told:
    hertz, ratio = found["natural_Hz"], found["damping_ratio"]
    seen = f"natural frequency {hertz.value:.5g} ± {hertz.std:.1g} Hz, damping ratio {ratio.value:.3g}"
    if not trial.driven:
        what = f"an oscillation itself, which was not demodulated ({seen})"
        return Told(what, "record it 20 times a period or more with its drive, or its amplitude, or d and q")
    to_do = "the controllers here are for its resonance: drive it there, and record d and q"
    return Told(f"of second order: it overshoots ({seen})", to_do)


OVERSHOOT = Effect(
    name="overshoot",
    shows=_baseband,
    stds=lambda trial, about: np.array([SLOW, PHASES[-1]]),
    starts=_ringing,
    applied=_overshot,
    numbers=_overshot_numbers,
    said=_overshot_said,
    scope="plate",
    rough=True,
    another=True,
    afresh=lambda trial: not trial.driven,
    alike=("late", "early", "rows_lost", "astray", "saturation", "duffing", "drift", "offset", "drive"),
    makes_sense=lambda values, stds: bool(values[0] > SEEN * stds[0]),
)
