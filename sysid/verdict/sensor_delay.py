"""A sweep's feedthrough that may be the delay of a sensor, as far as settled points tell.

A sensor that is late by t turns them by -2 pi j (f - f0) t W = -(t/tau) G V + (t/tau) W: but for a
feedthrough that is real in the plate's own frame, G is larger by 1 + t/tau. Where a sweep shows such a
feedthrough, within its errors, it is the one or the other, and the log gets a gain of its own with a prior of
that size: the error of G spans both. As all logs may be late alike, the size grows with their number, and
what each of several sweeps shows too little of, they may show together. By chance one that is there is real
within ASIDE in one sweep of ten. Where no more than a part can be a delay, only a sentence says so.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.model.theta import std_of
from sysid.trials.trial import Trial
from sysid.verdict.gain_confounding import complex_of
from sysid.verdict.linearised import LinearisedLog

REAL, FELT = (
    4.0,
    2.0,
)  # errors of it, and of G, from which it is there; so many of its imaginary part are none,
ASIDE = 0.15  # and so is so much of it: what a turn of a tenth of a radian makes to second order
MOST = 0.25  # of tau, that settled points may be late: of more the first order says nothing
SAID = (
    "{0}: a feedthrough of {1} of the response, or a {2} that is late by {3:.2g} s{4}, in which case G"
    " would be {1} {5}; state"
    " delay_s (0 if nothing is late)"
)


class Share(NamedTuple):
    """A feedthrough in the plate's own frame, over the settled response, with the errors of its real and its
    imaginary part."""

    size: complex
    along: float
    across: float

    def may_be_late(self, error: float) -> bool:
        """Whether it is seen, would move G by more than its relative `error` does, and may at least in part
        be a delay."""
        return max(REAL * self.along, FELT * error, abs(self.size.imag)) < abs(self.size.real) < MOST

    @property
    def all(self) -> bool:
        """Whether all of it may be a delay."""
        return abs(self.size.imag) < max(REAL * self.across, ASIDE * abs(self.size.real))


class Delays(NamedTuple):
    """The trials, those of settled points whose feedthrough may be a delay with the gain that this would be;
    sentences that say so, once for all logs that show the same; and sentences on those that may be a delay in
    part, which no error spans."""

    trials: tuple[Trial, ...]
    spanned: list[str]
    partly: list[str]
    logs: int  # that these are about


def with_delays(state: State, reference: tuple[float, float]) -> Delays:
    """What settled points tell of a sensor's delay."""
    trials, error = list(state.trials), std_of(state.covariance, "G")
    swept = [i for i, t in enumerate(trials) if _may_be_late(t)]
    seen = {
        i: _share(LinearisedLog(trials[i], state.models[i], state, reference, coloured=True), state)
        for i in swept
    }
    shares = _together(seen, error) | {i: s for i, s in seen.items() if s.may_be_late(error)}
    held = sum(s.all for s in shares.values()) + sum(t.lateness > 0 for t in trials)
    for i, share in shares.items():
        if share.all:
            nuisances = tuple(dict.fromkeys((*trials[i].nuisances, "gain")))
            narrow = trials[i].bench.narrow | {"gain": abs(share.size.real) * np.sqrt(held)}
            trials[i] = replace(trials[i], nuisances=nuisances).with_bench(narrow=narrow)
    alike: dict[tuple[Share, float | None], list[str]] = {}
    for i, share in shares.items():
        alike.setdefault((share, trials[i].log.bench.get("delay_s")), []).append(trials[i].log.name)
    said = [
        (bool(share.all), told(", ".join(names), share, stated, state.tau))
        for (share, stated), names in alike.items()
    ]
    spanned, partly = ([s for every, s in said if every is which] for which in (True, False))
    return Delays(tuple(trials), spanned, partly, len(shares))


def _may_be_late(trial: Trial) -> bool:
    """Settled points along the frequency, of which not stated is that nothing is late: what is measured at
    the terminals that drive it has no sensor of its own."""
    swept = trial.steady and trial.driven and not (trial.at_one_frequency or trial.log.analysed)
    return swept and "feedthrough" in trial.shapes and trial.log.bench.get("delay_s") != 0


def _share(view: LinearisedLog, state: State) -> Share:
    """That of one log."""
    settled = state.G * float(np.max(np.abs(view.trial.log.drive)))
    form = complex_of(view, "feedthrough", np.conj(view.turn)) / settled
    share, covariance = (
        complex(form @ np.array([c.value for c in view.columns])),
        view.covariance(state.covariance),
    )
    along, across = (float(np.sqrt(part @ covariance @ part)) for part in (form.real, form.imag))
    return Share(share, along, across)


def _together(seen: dict[int, Share], error: float) -> dict[int, Share]:
    """The mean of what the logs show, for each of two or more whose own are within FELT errors of it; none
    where even that may not be late."""
    if len(seen) < 2:
        return {}
    sizes = np.array([s.size for s in seen.values()])
    along, across = (
        np.array(v) ** -2.0 for v in zip(*((s.along, s.across) for s in seen.values()), strict=True)
    )
    size = complex(along @ sizes.real / np.sum(along), across @ sizes.imag / np.sum(across))
    mean = Share(size, float(np.sum(along) ** -0.5), float(np.sum(across) ** -0.5))
    near = [i for i, s in seen.items() if abs(s.size.real - size.real) < FELT * s.along]
    return dict.fromkeys(near, mean) if len(near) > 1 and mean.may_be_late(error) else {}


def told(names: str, share: Share, stated: float | None, tau: float) -> str:
    """A sentence on what the logs of these `names` share; `stated`: the delay (s) that they state."""
    real = share.size.real
    late = -real / (1 + real) * tau
    which, change = ("sensor", "smaller") if late > 0 else ("reference", "larger")
    beside, size = f" beside the {stated:.3g} s that are stated" if stated else "", f"{100 * abs(real):.2g} %"
    return SAID.format(
        names, size, which, abs(late), beside, f"{change}: its error spans both" if share.all else change
    )
