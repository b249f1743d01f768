"""What a log may hold that the model leaves out: one more term each, as a shape to first order and a
sentence."""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from sysid.effects.effect import About
from sysid.verdict.between import between
from sysid.verdict.firstorder import of_effects
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Term
from sysid.verdict.throughout import of_all
from sysid.verdict.timing import moments

LEAST = 1e-9  # of a shape: less is rounding
RUNNING = (
    "{}: its frequency is taken to stay from row to row; if it runs on between them, as a chirp's, f0 is"
    " {:.2g} Hz {}, {:.2g} of"
    " its standard deviations; sweep back as well, or leave delay_s out"
)
RIPPLING = (
    "{}: after a change of the drive it rings at twice its frequency, by a part of what a plate does, as"
    " behind a lock-in's filter; state lockin_tau_s and lockin_order"
)


def terms(views: list[LinearisedLog], free: Sequence[str], about: About, away: float) -> list[Term]:
    """All that is tried, of what looks alike the simplest first: a log of another gain before a law of the
    drive. Parameters are reported `away` (degC) from the mean temperature of the logs."""
    return list(
        chain(
            between(views, free),
            *(_of_one(i, v) for i, v in enumerate(views)),
            of_all(views, away, free),
            of_effects(dict(enumerate(views)), about),
        )
    )


def _of_one(i: int, view: LinearisedLog) -> Iterator[Term]:
    """What one log may hold for itself."""
    trial = view.trial
    if not trial.driven and not trial.steady:
        return
    if trial.steady:
        yield from _background(i, view)
    else:
        yield from chain(_under_amplitude(i, view), moments(i, view), _rippling(i, view))


def _rippling(i: int, view: LinearisedLog) -> Iterator[Term]:
    """A part of the fast mode's ringing, all of which a filter removes or none."""
    trial = view.trial
    if trial.resonant and trial.driven and trial.log.theta is None:
        shape = view.observed(view.course.ripple[None]).T
        if np.any(shape):
            said = RIPPLING.format(trial.log.name)
            yield Term("filter", {i: shape}, lambda *_: said, i, alike=True)


def _background(i: int, view: LinearisedLog) -> Iterator[Term]:
    """What lies in parallel to the resonance, over a sweep, and bends."""
    log = view.trial.log
    if log.frequency is None or np.ptp(log.frequency) == 0 or not view.trial.signed:
        return
    x = (log.frequency - np.mean(log.frequency)) / np.ptp(log.frequency)
    said = f"{log.name}: a background that is not a straight line of the frequency; sweep a narrower range"
    shape = (x**2 * view.trial.inputs.drive[view.trial.inputs.interval] + 0j)[:, None]
    shapes = {i: np.concatenate([shape, 1j * shape], axis=1)}
    yield Term("background", shapes, lambda *_: f"{said} about the peak", i, freedom=2, alike=True)


def _under_amplitude(i: int, view: LinearisedLog) -> Iterator[Term]:
    """An offset o of d and q of which an amplitude |W + o| is all that was recorded."""
    if view.trial.signed or view.trial.bench.standing:
        return
    constant = np.ones(len(view.plate), complex)
    shapes = view.observed(np.stack([constant, 1j * constant])).T
    shapes = shapes[
        :, np.linalg.norm(shapes, axis=0) > LEAST * np.linalg.norm(shapes)
    ]  # no phase turns at resonance

    def say(value: np.ndarray, _: np.ndarray) -> str:
        share = 100 * float(np.linalg.norm(value)) / view.trial.scale
        return (
            f"{view.trial.log.name}: an offset of d and q lies under its amplitude, of {share:.2g} % of the"
            f" response; record wd"
            " and wq, or subtract what these read at rest before taking the amplitude"
        )

    yield Term("offset", {i: shapes}, say, i, freedom=shapes.shape[1])
