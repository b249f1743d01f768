"""A lock-in's filter that no log states, or another than is stated."""

from dataclasses import replace
from math import factorial

import numpy as np

from sysid.effects.clock import ENOUGH, LEAST, as_transient, on_time, timed, timed_sweep
from sysid.effects.effect import SEEN, About, Effect, Fitted, Told, fixed, lasted, nowhere
from sysid.effects.number import Number, number
from sysid.trials.trial import Trial

FILTERED = np.array([0.03, 0.1, 0.3, 1.0, 3.0])  # of tau, the delay of all poles


def _matern(order: int, x: np.ndarray) -> np.ndarray:
    """Correlation of white noise behind p equal poles, x time constants apart (Matern's of order p - 1/2;
    Rasmussen & Williams, Gaussian Processes, 2006, 4.16)."""
    p = order - 1
    each = ((factorial(p + i) / factorial(i) / factorial(p - i), p - i) for i in range(p + 1))
    return np.exp(-x) * factorial(p) / factorial(2 * p) * sum(c * (2 * x) ** k for c, k in each)


def _shows(trial: Trial) -> bool:
    # means over longer than the stated filter would have to be of fewer rows
    own = trial.whole is None or trial.spacing <= abs(trial.smoothing[0])
    return (timed(trial) or timed_sweep(trial)) and trial.signed and own


def _starts(trial: Trial, about: About) -> np.ndarray:
    # a sweep waits for its points: of what is over before the next one it shows nothing
    told = FILTERED * ENOUGH * about.tau > trial.spacing if trial.steady else FILTERED > 0
    return FILTERED[told, None]


def _said(trial: Trial, found: dict[str, Number]) -> Told:
    order, time = round(found["lockin_order"].value), found["lockin_tau_s"]
    bench = trial.log.bench  # where what was found may have been entered
    if "lockin_tau_s" in bench and time.value < SEEN * time.std:
        what = f"the lock-in's filter of {bench['lockin_tau_s']:.3g} s that it states is not there"
        return Told(what, "leave lockin_tau_s out, or state that of this log")
    another = abs(bench.get("lockin_tau_s", time.value) - time.value) > SEEN * time.std
    another |= "lockin_tau_s" in bench and bench.get("lockin_order", 1) != order
    says = "another lock-in's filter is stated than" if another else "no lock-in's filter is stated;"
    poles = f"{order} poles" if order > 1 else "one pole"
    what = f"{says} one of {poles} of {time:.3g} s"
    return Told(what, "state lockin_tau_s and lockin_order, or the delay_s of a late trigger")


def _is_none(trial: Trial, fitted: Fitted) -> bool:
    """Whether a filter that a log states is not there: of none at all nothing shows how far it is from
    that."""
    bench, value = trial.log.bench, float(fitted.values[0])
    stated = bench.get("lockin_tau_s", 0.0) * bench.get("lockin_order", 1) / fitted.before
    seen = 0.0 if value <= LEAST else SEEN * float(fitted.stds[0])
    return stated > LEAST and value - LEAST <= seen < stated - value


def _filter(order: int) -> Effect:
    """A lock-in's filter of so many poles, that no log states, or another than is stated. Its number: the
    delay of all poles together, in tau."""

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        time = max(float(values[0]), LEAST) * about.tau / order
        trial = as_transient(trial, trial.log.time) if trial.steady else trial
        if trial.resonant:  # one that is shorter than a radian of the carrier leaves the carrier
            time = max(time, 1 / (2 * np.pi * float(np.max(trial.log.frequency))))
        return on_time(trial).with_bench(filter=(time, order))

    def stated(values: np.ndarray, about: About) -> dict[str, float]:
        return {"lockin_tau_s": max(float(values[0]), LEAST) * about.tau / order, "lockin_order": order}

    def numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
        time = number(max(values[0], 0.0), stds[0], "s", about.tau / order)
        if trial.whole is not None:  # means hide where within them it acts
            time = time._replace(std=float(np.hypot(time.std, trial.spacing / (12**0.5 * order))))
        return {"lockin_tau_s": time, "lockin_order": number(order, 0.0, "1")}

    def makes_sense(trial: Trial, fitted: Fitted) -> bool:
        # without a frequency either of two poles may be the plant's, and the slower one is taken for it
        mirrored = not trial.resonant and fitted.values[0] * fitted.before > order * fitted.tau
        # nor is it one of a plant that the log does not last for: such a one is whatever the filter is not
        known = fitted.positive() or _is_none(trial, fitted)
        return known and not mirrored and fitted.tau < lasted(trial)

    return Effect(
        name="filter",
        shows=_shows,
        stds=fixed([1.0]),
        starts=_starts,
        applied=applied,
        numbers=numbers,
        said=_said,
        scope="bench",
        places=nowhere,
        known_as=("late",),
        stated=stated,
        colour=lambda values, about, apart: _matern(order, apart / stated(values, about)["lockin_tau_s"]),
        makes_sense=makes_sense,
    )


ORDERS = {order: _filter(order) for order in (1, 2, 3, 4, 6, 8)}  # 6 to 48 dB per octave, as lock-ins have
# of a filter that a log states, none of whatever order: to first order nothing shows that it is not there
NONE = replace(
    ORDERS[1],
    shows=lambda trial: "lockin_tau_s" in trial.log.bench and _shows(trial),
    starts=lambda trial, about: np.zeros((1, 1)),
    known_as=(),
)
FILTERS = (*ORDERS.values(), NONE)
