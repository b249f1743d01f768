"""A sweep's feedthrough that may be the delay of a sensor, as far as settled points tell.

A sensor that is late by t turns them by -2 pi j (f - f0) t W = -(t/tau) G V + (t/tau) W: but for a feedthrough that is real in
the plate's own frame, G is larger by 1 + t/tau. Where a sweep shows such a feedthrough, within its errors, it is the one or the
other, and the log gets a gain of its own with a prior of that size: the error of G spans both. As all logs may be late alike,
the size grows with their number. By chance one that is there is real within ASIDE in one sweep of ten. Where no more than a
part can be a delay, only a sentence says so.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.trials.trial import Trial
from sysid.verdict.coincidence import complex_of
from sysid.verdict.view import View

REAL, FELT = 4.0, 2.0  # errors of it, and of G, from which it is there; so many of its imaginary part are none,
ASIDE = 0.15  # and so is so much of it: what a turn of a tenth of a radian makes to second order
MOST = 0.25  # of tau, that settled points may be late: of more the first order says nothing
SAID = (
    "{0}: a feedthrough of {1} of the response, or a {2} that is late by {3:.2g} s{4}, by which G would be {1} {5}; state delay_s"
    " (0 if nothing is late)"
)


class _Share(NamedTuple):
    """The real part of a feedthrough in the plate's own frame, over the settled response; whether it is all of it."""

    real: float
    all: bool


def with_delays(state: State, reference: tuple[float, float]) -> tuple[tuple[Trial, ...], list[str]]:
    """The trials, those of settled points whose feedthrough may be a delay with the gain that this would be; and sentences that
    say so, and where it may be a delay in part."""
    trials, shares = list(state.trials), dict[int, _Share]()
    for i in (i for i, t in enumerate(trials) if _may_be_late(t)):
        if share := _share(View(trials[i], state.models[i], state, reference, coloured=True), state):
            shares[i] = share
    alike = sum(s.all for s in shares.values()) + sum(t.lateness > 0 for t in trials)
    for i, share in shares.items():
        if share.all:
            nuisances = tuple(dict.fromkeys((*trials[i].nuisances, "gain")))
            narrow = trials[i].narrow | {"gain": abs(share.real) * np.sqrt(alike)}
            trials[i] = replace(trials[i], nuisances=nuisances, narrow=narrow)
    return tuple(trials), [_said(trials[i], share, float(np.exp(state.theta[1]))) for i, share in shares.items()]


def _may_be_late(trial: Trial) -> bool:
    """Settled points along the frequency, of which not stated is that nothing is late."""
    swept = trial.steady and trial.driven and not trial.at_one_frequency
    return swept and "feedthrough" in trial.shapes and trial.log.bench.get("delay_s") != 0


def _share(view: View, state: State) -> _Share | None:
    """None where it is not seen, or no delay."""
    settled = float(np.exp(state.theta[0])) * float(np.max(np.abs(view.trial.log.drive)))
    form = complex_of(view, "feedthrough", np.conj(view.turn)) / settled
    share, covariance = complex(form @ np.array([c.value for c in view.columns])), view.covariance(state.covariance)
    along, across = (float(np.sqrt(part @ covariance @ part)) for part in (form.real, form.imag))
    error = float(np.sqrt(state.covariance[0, 0]))
    if not max(REAL * along, FELT * error, abs(share.imag)) < abs(share.real) < MOST:
        return None
    return _Share(share.real, abs(share.imag) < max(REAL * across, ASIDE * abs(share.real)))


def _said(trial: Trial, share: _Share, tau: float) -> str:
    late, stated = -share.real / (1 + share.real) * tau, trial.log.bench.get("delay_s")
    which, change = ("sensor", "smaller") if late > 0 else ("reference", "larger")
    beside, size = f" beside the {stated:.3g} s that are stated" if stated else "", f"{100 * abs(share.real):.2g} %"
    return SAID.format(trial.log.name, size, which, abs(late), beside, f"{change}: its error spans both" if share.all else change)
