"""What each log of a fit would make of the plant by itself, beside what all logs make of it.

With J and r a log's whitened derivatives and residual at the joint fit, projected off all that its bench can
adjust, the log alone is best described, to first order, by

    theta_own - theta = C J^T r,    C = (J^T J)^-1

over those of ln G, ln tau and f0 that it tells; f0 is that at the log's own temperature. The joint estimate
holds the log too, so that the variance of the difference is C less the joint one, V, without what that spans
besides."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.model.theta import NAMES
from sysid.verdict.fitted import Fit
from sysid.verdict.linearised import LinearisedLog

OWN = ("G", "tau", "f0")
TOLD = 1e-6  # of the information of the log that tells most of a parameter; less is rounding
# of a log's own variance; less is left beside the joint one only where the log is nearly all there is
LEFT = 0.02


@dataclass(frozen=True)
class Own:
    """Of the log `number` (from 1): by how much its own estimate of each parameter is `off` the joint one,
    with its `error`, of G and tau as a share of the value, of f0 in Hz; and `apart`, the difference in its
    standard deviations.

    `warming`: degC from the temperature of the fit's f0 to the log's, None where none is recorded. `circle`:
    of a d/q sweep (n,) recorded and (n,) fitted response over the drive, without the turn of its demodulator
    and what else the bench added; None of any other log."""

    number: int
    name: str
    warming: float | None
    off: dict[str, float]
    error: dict[str, float]
    apart: dict[str, float]
    circle: tuple[np.ndarray, np.ndarray] | None = field(default=None, repr=False)

    @property
    def worst(self) -> float:
        """The largest difference of any parameter, in standard deviations; 0 of a log that tells none."""
        return max((abs(z) for z in self.apart.values()), default=0.0)


def own_estimates(fit: Fit) -> tuple[Own, ...]:
    """Of each log of a fit, in their order; none where the fit has no covariance that says anything."""
    if not fit.result.bounded:
        return ()
    return tuple(
        own
        for state in fit.modes[:1]
        for own in _own(fit, LinearisedLog.each(state, fit.reference, coloured=True))
    )


def _own(fit: Fit, views: Sequence[LinearisedLog]) -> list[Own]:
    names = [n for n in OWN if n in fit.names]
    index, joint = [NAMES.index(n) for n in names], fit.modes[0].covariance
    shares = [
        np.sqrt(v.trial.noise.told) for v in views
    ]  # of outliers, and noise of the phase, rows say less than weights do
    jacobians = [v.jacobian[:, index] * share for v, share in zip(views, shares, strict=True)]
    grams = np.array([j.T @ j for j in jacobians])
    most = np.max(np.diagonal(grams, axis1=1, axis2=2), axis=0)
    found = []
    for number, (view, fitted, share) in enumerate(zip(views, fit.logs, shares, strict=True), 1):
        gram, slope = grams[number - 1], jacobians[number - 1].T @ view.r / share
        told = np.flatnonzero(np.diag(gram) > TOLD * most)
        numbers = _estimate(
            gram[np.ix_(told, told)], slope[told], _joint(view, joint)[np.ix_(index, index)], told
        )
        off, error, apart = (dict(zip([names[k] for k in told], x.tolist(), strict=True)) for x in numbers)
        at = None if fitted.log.temperature is None else view.course.warming - fit.warming
        found.append(Own(number, fitted.log.name, at, off, error, apart, _circle(view)))
    return found


def _joint(view: LinearisedLog, joint: np.ndarray) -> np.ndarray:
    """(6, 6) covariance of the joint estimate, with f0 at the log's temperature."""
    carry = np.eye(len(NAMES))
    carry[NAMES.index("f0"), NAMES.index("k_T")] = view.course.warming
    return carry @ joint @ carry.T


def _estimate(
    gram: np.ndarray, slope: np.ndarray, joint: np.ndarray, told: np.ndarray
) -> tuple[np.ndarray, ...]:
    """By how much a log alone is off, with what error, and how far that is apart, of the parameters that it
    tells."""
    size = np.sqrt(np.diag(gram))
    inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=TOLD, hermitian=True) / np.outer(size, size)
    off, own = inverse @ slope, np.diag(inverse)
    left = np.maximum(own - np.diag(joint)[told], LEFT * own)
    return off, np.sqrt(own), off / np.sqrt(left)


def _circle(view: LinearisedLog) -> tuple[np.ndarray, np.ndarray] | None:
    """Recorded and fitted response per unit of the drive, of the plate alone."""
    trial = view.trial
    if not (trial.swept and trial.signed and np.iscomplexobj(trial.log.response)):
        return None
    drive = np.ones(len(view.model)) if trial.log.drive is None else trial.log.drive
    if not np.all(drive):
        return None
    there = trial.there
    size = drive * view.own
    return ((trial.log.response - view.bench) / view.turn / size)[there], (view.plate / size)[there]
