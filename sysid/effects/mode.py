"""Another mode of the plate, or a second time constant of what is none."""

from functools import lru_cache

import numpy as np

from sysid.effects.effect import (
    LEAST_ROWS,
    SEEN,
    SWEEP,
    About,
    Effect,
    Fitted,
    Told,
    always,
    beside,
    fixed,
    moving,
    nowhere,
    resonating,
)
from sysid.effects.number import Number, number
from sysid.model.theta import NAMES, Theta
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

APART = 2.0 ** np.arange(
    0, 5
)  # half bandwidths from the resonance, to both sides: nearer ones show as a single peak
# Two modes that show as one peak: half bandwidths of the peak from its middle, how much slower than it seems
# the log of tau is, and the share of each in it.
SPLIT = (0.5, 0.5, 0.5)
TURNS = np.exp(0.5j * np.pi * np.arange(4))
WIDTHS = np.log([0.5, 1.0, 2.0])  # of another mode's tau over the plate's
CLOSE, PLACES = 0.5, 400  # half bandwidths between places where it is looked for, and at most so many
PEAKS = 4  # of these, that are followed
RATIOS = np.log([0.125, 0.25, 0.5, 2.0, 4.0, 8.0])  # of a second time constant over tau
DRIFTS = 0.1  # half bandwidths per degC, by which two modes drift apart: as much as each of them drifts


def _second(trial: Trial, place: float, width: float, drift: float, about: About) -> np.ndarray:
    """(n,) response of a mode `place` half bandwidths above the first and e^width times as slow, which each
    degC takes `drift` half bandwidths farther above it; it begins at rest or settled, as the log does. It is
    of size one where the largest drive of the logs holds it at the frequency, of those driven, that is
    nearest to its resonance; of a decay, of size one at its first row."""
    theta = about.theta + np.array([0.0, width, *(about.half_bandwidth * np.array([place, drift])), 0.0, 0.0])
    theta[NAMES.index("G")] = np.log(_unseen(place, width, about) / about.drive)
    return _beside_the_first(trial, theta, about)


def _beside_the_first(trial: Trial, theta: np.ndarray, about: About) -> np.ndarray:
    """(n,) response of another plate, at theta, that begins as the first does."""
    settled = LogResponse.of(trial, about.reference, about.theta).begins_settled
    return _response(trial, about.reference, tuple(theta.tolist()), settled)


@lru_cache(maxsize=1)  # for both of its quadratures
def _response(
    trial: Trial, reference: tuple[float, float], theta: tuple[float, ...], settled: bool
) -> np.ndarray:
    """(n,) response of a plate at theta, from rest or `settled`."""
    course = LogResponse.of(trial, reference, np.array(theta))
    if not trial.driven:
        return course.free
    return course.forced + course.settled * course.free if settled else course.forced


def _unseen(place: float, width: float, about: About) -> float:
    """How many times what is driven shows of a mode it would be at its resonance."""
    at = Theta.of(about.theta).f0 + place * about.half_bandwidth
    outside = max(about.driven[0] - at, 0.0, at - about.driven[1])
    return float(np.hypot(1.0, outside / about.half_bandwidth * np.exp(width)))


BOTH = "; record a sweep across both, which tells them apart"
# half bandwidths, within which a mean over one that moves looks as if it were two, and of which share then
BLURRED, MUCH = 3.0, 0.25
TURNED = 0.35  # sine of 20 degrees: what feedthroughs and delays that are not described turn it by
MEAN = "or else each point is a mean over one that moved meanwhile, whose G and tau are others"


def _second_said(trial: Trial, found: dict[str, Number]) -> Told:
    apart = found["apart_Hz"]
    side, both = "above" if apart.value > 0 else "below", "" if trial.steady else BOTH
    near = abs(apart.value) < BLURRED / (2 * np.pi * found["tau_s"].value)
    doubt = f" ({MEAN})" if trial.swept and near and found["size"].value > MUCH else ""
    return Told(
        f"a second resonance, {abs(apart):.4g} Hz {side} the first and of"
        f" {100 * found['size'].value:.3g} % of its response{doubt}",
        f"a controller of the first alone does not know it: keep it away from there{both}",
    )


def _second_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time, whole = float(np.exp(values[1])) * about.tau, 1.0
    if trial.driven:
        whole = _unseen(float(values[0]), float(values[1]), about)
    share = float(np.hypot(*values[2:4]))
    unseen = share * stds[1] * (1 - whole**-2)  # its width tells how much of it is not in the logs
    error = np.hypot(np.max(stds[2:4]), unseen)
    return {
        "apart_Hz": number(
            values[0] * about.half_bandwidth - about.moved, stds[0] * about.half_bandwidth, "Hz"
        ),
        "tau_s": number(time, time * stds[1], "s"),
        "size": number(share, error, "of the largest response", whole),
    } | (
        {"drift": number(values[4], stds[4], "Hz/degC", about.half_bandwidth)}
        if stds[4] < 0.5 * DRIFTS
        else {}
    )


def _mode_places(trial: Trial, about: About) -> np.ndarray:
    """Those among what was driven: outside of a sweep no peak shows."""
    places = np.append(-APART, APART)
    if trial.swept:
        shift = about.reference[0] + Theta.of(about.theta).f0
        at = (trial.log.frequency - shift) / about.half_bandwidth
        places = places[(places > np.min(at)) & (places < np.max(at))]
    return places[:, None] * np.eye(1, 5)


def _second_starts(trial: Trial, about: About) -> np.ndarray:
    """Places to both sides. d and q are linear in a mode of given place and width, which gives its size, and
    the places where it would take most of what the plate leaves; of amplitudes, what turns them by a right
    angle shows only once it is there."""
    each = [(way * x, 0.0) for x in APART for way in (-1, 1)]
    apart, slower, share = SPLIT
    split = [[way * apart, slower, share, 0.0, 0.0] for way in (-1, 1)]
    if not trial.signed:
        turned = [[x, width, z.real, z.imag, 0.0] for x, width in each for z in 0.5 * TURNS]
        return np.array([*split, *turned])
    left = Left(trial, about)
    each += [] if moving(trial) else left.likely()
    sizes = [left.by(_second(trial, x, width, 0.0, about)[:, None])[0] for x, width in each]
    alone = [[x, width, z.real, z.imag, 0.0] for (x, width), z in zip(each, sizes, strict=True)]
    return np.array([*split, *alone])


class Left:
    """What the plate leaves of d and q of a log beside its own derivatives and what the bench adds."""

    def __init__(self, trial: Trial, about: About):
        self.course = course = LogResponse.of(trial, about.reference, about.theta)
        self.about, self.trial = about, trial
        one = np.ones(len(course.hold.drive), complex)
        known = [course.plate, course.changed(one), *trial.columns, np.ones(len(trial.log))]
        self.basis = np.linalg.qr(np.stack(known, axis=1))[0]
        turn = np.exp(-1j * np.angle(np.vdot(course.plate, trial.log.response)))
        self.rows = self.off(trial.log.response[:, None] * turn / about.top)[:, 0]

    def off(self, shapes: np.ndarray) -> np.ndarray:
        """Complex shapes (n, K), less what the plate and the bench can make of them."""
        return shapes - self.basis @ (np.conj(self.basis.T) @ shapes)

    def by(self, shapes: np.ndarray) -> np.ndarray:
        """(K,) complex size of each shape, over the largest response."""
        apart = self.off(shapes)
        return np.conj(apart.T) @ self.rows / np.maximum(np.sum(np.abs(apart) ** 2, axis=0), 1e-300)

    def likely(self) -> list[tuple[float, float]]:
        """Places (half bandwidths) and widths of the PEAKS modes that would explain most by themselves."""
        course, tau = self.course, self.about.tau
        if self.trial.steady:
            below, above = (float(x(-course.detuning)) * tau for x in (np.min, np.max))
        else:
            above = np.pi * tau / max(self.trial.spacing, 1e-300)
            below = -above
        places = np.arange(below, above, max(CLOSE, (above - below) / PLACES))
        places = places[np.abs(places) >= APART[0]]
        gained = np.array([self.gained(places, width) for width in WIDTHS])
        best = np.max(gained, axis=0)
        tops = [k for k in np.argsort(-best) if best[k] >= np.max(best[max(k - 1, 0) : k + 2])][:PEAKS]
        return [(float(places[k]), float(WIDTHS[np.argmax(gained[:, k])])) for k in tops]

    def gained(self, places: np.ndarray, width: float) -> np.ndarray:
        """(K,) power that a mode of that width takes at each of the places."""
        rates = (1 - np.exp(-width) + 1j * places) / self.about.tau
        found = self.course.at(np.tile(rates, (len(self.course.hold.drive), 1)))
        shapes = found.forced if self.trial.driven else found.free
        return np.abs(self.by(shapes)) ** 2 * np.sum(np.abs(self.off(shapes)) ** 2, axis=0)


def _seems_a_mode(trial: Trial, fitted: Fitted) -> bool:
    """Whether it stands apart, at a place that is known, and has a size, no larger than the first's."""
    values, stds = fitted.values, fitted.stds
    size, beside = float(np.hypot(*values[2:4])), abs(values[0]) > SEEN * stds[0] and stds[0] < 1.0
    return bool(beside and SEEN * np.min(stds[2:4]) < size <= fitted.own)


def _overlaps(trial: Trial, values: np.ndarray) -> bool:
    """Whether it is nearer to the first than both are wide."""
    return bool(abs(values[0]) < APART[0])


def _is_turned(trial: Trial, values: np.ndarray) -> bool:
    """Whether one that overlaps with the first moves neither in phase with it nor against it, as the modes of
    a structure of little damping do: so looks a mean over a resonance that moved."""
    turned = abs(values[3]) > TURNED * np.hypot(*values[2:4])
    return bool(trial.swept and trial.signed and turned and _overlaps(trial, values))


def _second_beside(trial: Trial, values: np.ndarray, about: About) -> Trial:
    return beside(trial, values[2:4], about, _second(trial, values[0], values[1], values[4], about))


SECOND_MODE = Effect(
    name="second_mode",
    shows=resonating,
    stds=fixed(np.array([APART[-1], 1.0, 1.0, 1.0, DRIFTS])),
    starts=_second_starts,
    applied=_second_beside,
    numbers=_second_numbers,
    said=_second_said,
    linear=(2, 3),
    places=_mode_places,
    shown_by=lambda trial, about: SWEEP if moving(trial) else "",
    many=True,
    scope="bench",
    vague=_overlaps,
    rough=_is_turned,
    makes_sense=_seems_a_mode,
)


def _slower(trial: Trial, ratio: float, about: About) -> np.ndarray:
    """(n,) response of a plant that is e^ratio times as slow, begun as the log is; of size one where it has
    settled at the largest drive of the logs."""
    theta = about.theta + np.array([0.0, ratio, 0.0, 0.0, 0.0, 0.0])
    theta[NAMES.index("G")] = -np.log(about.drive)
    return _beside_the_first(trial, theta, about)


def _pole_starts(trial: Trial, about: About) -> np.ndarray:
    left = Left(trial, about)
    sizes = [left.by(_slower(trial, ratio, about)[:, None])[0].real for ratio in RATIOS]
    return np.stack([sizes, RATIOS], axis=1)


def _pole_beside(trial: Trial, values: np.ndarray, about: About) -> Trial:
    return beside(trial, np.array([values[0], 0.0]), about, _slower(trial, float(values[1]), about))


def _pole_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    time = float(np.exp(values[1])) * about.tau
    return {
        "tau_s": number(time, time * stds[1], "s"),
        "size": number(values[0], stds[0], "of the largest response"),
    }


def _pole_said(trial: Trial, found: dict[str, Number]) -> Told:
    time, share = found["tau_s"], 100 * found["size"].value
    return Told(
        f"a second time constant of {time:.4g} s, with {share:.2g} % of the response",
        "drive what has a resonance there, or fit the part that is asked for by itself",
    )


def _seems_a_pole(trial: Trial, fitted: Fitted) -> bool:
    """Whether it has a size and a time of its own: their product is what there is of it to first order."""
    along = fitted.values[::-1]
    std = float(np.sqrt(along @ fitted.covariance @ along))
    return bool(abs(np.prod(fitted.values)) > SEEN * std)


SECOND_POLE = Effect(
    name="second_pole",
    shows=lambda trial: (
        not (trial.steady or trial.resonant or np.iscomplexobj(trial.log.response))
        and trial.signed
        and trial.driven
        and len(trial.log) >= LEAST_ROWS
        and trial.smoothing[1] == 0
    ),
    stds=fixed(np.array([1.0, float(RATIOS[-1])])),
    starts=_pole_starts,
    applied=_pole_beside,
    numbers=_pole_numbers,
    said=_pole_said,
    places=nowhere,
    scope="plate",
    rough=always,
    another=True,
    makes_sense=_seems_a_pole,
)
