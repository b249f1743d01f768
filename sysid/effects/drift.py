"""What drifts while a log is recorded, or from one to the next: the resonance with the time or by the plate's
own heat, a thermometer behind its plate, an output offset, the phase of a demodulator."""

from collections.abc import Callable

import numpy as np

from sysid.effects.effect import (
    LEAST_ROWS,
    SEEN,
    About,
    Effect,
    Fitted,
    Told,
    beside,
    fixed,
    in_order,
    lasted,
    moving,
    nowhere,
    one,
    one_way,
    shares,
    shifted,
    size,
    sweep,
    undone,
)
from sysid.effects.number import Number, number, pm
from sysid.rows.thermometer import was_read
from sysid.trials.heat import HEATED, clock, warmed
from sysid.trials.trial import LEAST_WARMING, Trial

SHIFTS = 2.0 ** np.arange(-7, 0)  # of the sweep: what shifts by more has left it
RATES, EVEN = (3.0,), 0.01  # one over the time constant of a drift that levels off, of the log; of none
LAGS = np.array([0.003, 0.03, 0.3])  # of a log's duration, to both sides
SLOW = 1e4  # time constants in a sweep that lasts long enough for the plate to warm
HELD = "logs at temperatures that are held"  # show what a thermometer's lag would hide
BACK = "a sweep back as well"  # shows what goes with the time
TURNED = 0.5  # rad from end to end: of more a demodulator is seen to be at another frequency
WARMED = 4.0  # half bandwidths: of a plate at some other temperature
BESIDE = 0.01  # of a drift's power, a tenth of it, that has to be beside the recorded temperature
CREPT = 0.5  # of the largest response


def _timed(trial: Trial) -> bool:
    """A sweep or a transient whose rows are in the order in which they were recorded."""
    whole = trial.whole is None or not trial.steady
    return whole and (sweep(trial) or moving(trial)) and len(trial.log) >= LEAST_ROWS


def _drifts(trial: Trial) -> bool:
    """Not what is `_scaled`: there a drift is another scale of these, that tau
    takes up, and what shows is how they scatter; nor where a recorded temperature goes with the time: that is
    k_T's, and what shows is how it was read."""
    return _timed(trial) and not _scaled(trial) and not _goes_along(trial)


def _scaled(trial: Trial) -> bool:
    """Settled points in the order of their frequencies."""
    return trial.steady and (one_way(trial) or in_order(trial))


def _goes_along(trial: Trial) -> bool:
    passed = clock(trial.log)
    if not _warmer(trial) or np.ptp(passed) == 0:
        return False
    return bool(np.corrcoef(trial.log.temperature, passed)[0, 1] ** 2 > 1 - BESIDE)


def _drift(rates: tuple[float, ...]) -> Effect:
    """A resonance that goes with the time t of a log or, where it has `rates`, as (1 - e^(-r t))/(1 - e^-r),
    as of a plate that warms up. Its numbers: how far, where in the log f0 is told, and r."""
    each: list[list[float]] = [[r] for r in rates] or [[]]
    shifts = np.concatenate([-SHIFTS[::2], SHIFTS[::2]] if rates else [-SHIFTS, SHIFTS])

    def course(t: np.ndarray, values: np.ndarray) -> np.ndarray:
        if not rates:
            return t
        rate = max(float(values[2]), EVEN)
        return np.expm1(-rate * t) / np.expm1(-rate)

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        away = course(clock(trial.log), values) - 0.5 - values[1]
        return shifted(trial, "frequency", -values[0] * about.span * away)

    def numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
        each = {
            "shift_Hz": number(values[0], stds[0], "Hz", about.span),
            "at": number(0.5 + values[1], stds[1], "of the log"),
        }
        if not rates or trial.log.time is None:
            return each
        rate = max(float(values[2]), EVEN)
        return each | {"time_s": number(1 / rate, float(stds[2]) / rate**2, "s", lasted(trial))}

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        shift, time = found["shift_Hz"], found.get("time_s")
        as_it_warms = f", as it warms up within {time:.2g} s" if time else ""
        return Told(
            f"its resonance drifts by {shift:+.3g} Hz from the first row to the last{as_it_warms}",
            "f0 may be that of any row; record the temperature of every row, or wait until it is constant",
        )

    return Effect(
        name="f0_drift",
        shows=_drifts,
        shown_by=lambda trial, about: BACK if not rates and _timed(trial) and _scaled(trial) else "",
        stds=fixed(np.array([SHIFTS[-1], 0.5, *rates[-1:]])),
        starts=fixed(np.array([[x, 0.0, *r] for r in each for x in shifts])),
        applied=applied,
        numbers=numbers,
        said=said,
        places=(lambda trial, about: np.array([[0.0, 0.0, r] for r in rates])) if rates else None,
        makes_sense=_levels_off if rates else None,
    )


def _levels_off(trial: Trial, fitted: Fitted) -> bool:
    """Whether it is seen to; else it goes on."""
    return bool(fitted.values[2] > SEEN * fitted.stds[2]) and fitted.seen(0)


F0_DRIFTS = _drift(()), _drift(RATES)


def _heated(trial: Trial, values: np.ndarray, about: About) -> Trial:
    power, time = np.abs(trial.log.response) ** 2, HEATED[1] * float(np.exp(values[1]))
    heat = warmed(clock(trial.log), power, time, 0.5 + values[2])
    return shifted(trial, "frequency", -values[0] * about.span * heat)


def _heated_said(trial: Trial, found: dict[str, Number]) -> Told:
    shift, time = found["shift_Hz"], found["time_s"]
    return Told(
        f"its resonance drifts by up to {shift:+.3g} Hz as the plate heats itself,"
        f" within about {time.value:.2g} s",
        "f0 is that before; record the temperature of every row on the plate, or drive it less",
    )


def _warms(trial: Trial, about: About) -> str:
    """Of a sweep in one direction that lasts long, whose temperature is not recorded or does not change."""
    log = trial.log
    read = log.temperature is not None and np.ptp(log.temperature) > LEAST_WARMING
    hides = not (trial.steady or read) and one_way(trial) and lasted(trial) > SLOW * about.tau
    return BACK if hides else ""


SELF_HEATING = Effect(
    name="self_heating",
    shows=lambda trial: _timed(trial) and trial.log.time is not None,
    stds=fixed(np.array([SHIFTS[-1], np.log(HEATED[2] / HEATED[1]), 0.5])),
    starts=lambda trial, about: np.array(
        [[x, np.log(t / HEATED[1]), 0.0] for t in HEATED for x in (*-SHIFTS[1::3], *SHIFTS[1::3])]
    ),
    applied=_heated,
    numbers=lambda trial, values, stds, about: {
        "shift_Hz": number(values[0], stds[0], "Hz", about.span),
        "time_s": number(
            float(np.exp(values[1])), float(np.exp(values[1])) * stds[1], "s", HEATED[1] * lasted(trial)
        ),
    },
    said=_heated_said,
    places=fixed(np.array([[0.0, np.log(t / HEATED[1]), 0.0] for t in HEATED])),
    shown_by=_warms,
)


def _warming(trial: Trial) -> bool:
    """A log of a plate that warms, or cools, meanwhile."""
    log = trial.log
    timed = trial.resonant and trial.driven and log.temperature is not None and log.time is not None
    if not timed or "lag" in trial.nuisances or len(log) < LEAST_ROWS or log.time[-1] == log.time[0]:
        return False
    return bool(np.ptp(log.temperature) > LEAST_WARMING) and (trial.whole is None or not trial.steady)


def _lagged(trial: Trial, lag: float, over: float) -> Trial:
    """A sensor behind the plate, lag dT/dt + T = T of the plate (to first order, whatever lies between), its
    rate that `over` so many s before and behind."""
    log = trial.log
    stamps, first = np.unique(log.time, return_index=True)
    ends = [np.clip(log.time + way * max(over, trial.spacing), stamps[0], stamps[-1]) for way in (-1, 1)]
    before, behind = (np.interp(at, stamps, log.temperature[first]) for at in ends)
    return shifted(trial, "temperature", lag * (behind - before) / (ends[1] - ends[0]))


def _lagged_said(trial: Trial, found: dict[str, Number]) -> Told:
    lag = found["lag_s"]
    return Told(
        f"the temperature that is recorded is {abs(lag):.3g} s"
        f" {'behind' if lag.value > 0 else 'ahead of'} the plate's",
        "warm it more slowly, or wait until it is constant",
    )


def _behind(noisy: bool) -> Effect:
    """A thermometer behind its plate. From row to row the rate of a `noisy` one is that of its noise: it is
    taken over a lag before and behind, which rounds where the plate turns."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        lag = float(values[0])
        return _lagged(trial, lag, noisy * abs(lag))

    return Effect(
        name="thermometer_lag",
        shows=_warming,
        stds=lambda trial, about: LAGS[-1:] * lasted(trial),
        starts=lambda trial, about: np.concatenate([-LAGS, LAGS])[:, None] * lasted(trial),
        applied=applied,
        numbers=one("lag_s", "s"),
        said=_lagged_said,
        scope="bench",
        places=nowhere if noisy else None,  # of a short lag both are the same
        shown_by=lambda trial, about: "" if noisy or not _warming(trial) else HELD,
    )


THERMOMETER_LAGS = (_behind(noisy=False), _behind(noisy=True))


def _creeping(trial: Trial) -> bool:
    """A transient of d and q, or of a signed output, whose offset is not known to stay."""
    log, asked = trial.log, trial.nuisances
    moving = not trial.steady and trial.signed and "offset" in asked and "baseline" not in asked
    return moving and len(log) >= LEAST_ROWS and log.time[-1] > log.time[0]


def _along(trial: Trial) -> np.ndarray:
    """(n,) the time, from 0 to 1."""
    time = trial.log.time
    return (time - time[0]) / (time[-1] - time[0])


def _read(trial: Trial) -> np.ndarray:
    """(n,) the temperature, from 0 to 1."""
    degC = trial.log.temperature
    return (degC - np.min(degC)) / np.ptp(degC)


def _offset_drift(
    what: str, to_do: str, shapes: dict[str, Callable[[Trial], np.ndarray]], warm: bool = False
) -> Effect:
    """An output offset that goes with the sum of these shapes (n,), each from 0 to 1 or -1 to 1."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        for part, shape in zip(values.reshape(-1, 2), shapes.values(), strict=True):
            trial = beside(trial, part, about, shape(trial))
        return trial

    def numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
        each = zip(shapes, values.reshape(-1, 2), stds.reshape(-1, 2), strict=True)
        return {name + k: n for k, v, s in each for name, n in shares(trial, v, s, about).items()}

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        share, error = size(found)
        by = f"by {share:.2g} ± {pm(error)} % of the largest response"
        return Told(f"its output offset {what.format(by)}", to_do)

    return Effect(
        name="offset_drift",
        shows=lambda trial: _creeping(trial) and (not warm or _warmer(trial)),
        stds=fixed(np.full(2 * len(shapes), CREPT)),
        starts=fixed(np.zeros((1, 2 * len(shapes)))),  # it is linear
        applied=applied,
        numbers=numbers,
        said=said,
        linear=tuple(range(2 * len(shapes))),
        places=None if len(shapes) == 1 else nowhere,
    )


def _warmer(trial: Trial) -> bool:
    """Whether the temperature is recorded, and changes."""
    degC = trial.log.temperature
    return degC is not None and bool(np.ptp(degC) > LEAST_WARMING)


# with the time, straight or as a curve that bends twice; or with the temperature that was recorded
OFFSET_DRIFTS = (
    _offset_drift(
        "drifts {} from the first row to the last",
        "wait until it is constant, or record a shorter log",
        {"": _along},
    ),
    _offset_drift(
        "drifts, and bends, {}",
        "wait until it is constant, or record a shorter log",
        {
            "": _along,
            "_second": lambda trial: np.polynomial.Legendre([0, 0, 1])(2 * _along(trial) - 1),
            "_third": lambda trial: np.polynomial.Legendre([0, 0, 0, 1])(2 * _along(trial) - 1),
        },
    ),
    _offset_drift(
        "follows the temperature, {}",
        "wait until it is constant, or subtract what the sensor shows of the temperature alone",
        {"": _read},
        True,
    ),
)


def _turning(trial: Trial, values: np.ndarray, about: About) -> Trial:
    return undone(
        trial, lambda log: log.response * np.exp(-1j * values[0] * (clock(log) - np.mean(clock(log))))
    )


def _turning_said(trial: Trial, found: dict[str, Number]) -> Told:
    turn = found["turn_deg"]
    return Told(
        f"its phase turns by {turn:+.3g} degrees from the first row to the last",
        "lock the demodulator to the source of the drive, or record faster",
    )


PHASE_DRIFT = Effect(
    name="phase_drift",
    shows=lambda trial: (
        np.iscomplexobj(trial.log.response) and len(trial.log) >= LEAST_ROWS and not one_way(trial)
    ),
    stds=fixed([TURNED]),
    starts=fixed(np.array([[-TURNED], [0.0], [TURNED]])),
    applied=_turning,
    numbers=one("turn_deg", "deg", lambda trial, about: np.degrees(1.0)),
    said=_turning_said,
)


def _elsewhere(trial: Trial, values: np.ndarray, about: About) -> Trial:
    hertz = values[0] * about.half_bandwidth
    return shifted(trial, "frequency", np.full(len(trial.log), -hertz))


def _elsewhere_said(trial: Trial, found: dict[str, Number]) -> Told:
    off = found["off_Hz"]
    return Told(
        f"its resonance is {off:+.4g} Hz off that of the other logs, and its temperature is not recorded",
        "record it: f0 is that of the logs of which this is not said",
    )


OWN_RESONANCE = Effect(
    name="resonance",
    shows=lambda trial: trial.resonant and not was_read(trial.log),
    stds=fixed([WARMED]),
    starts=fixed(np.array([[-2.0], [-0.5], [0.5], [2.0]])),
    applied=_elsewhere,
    numbers=one("off_Hz", "Hz", lambda trial, about: about.half_bandwidth),
    said=_elsewhere_said,
    relative=True,
    places=nowhere,  # `between` shows it
)
