"""A plate of a batch as the single fit sees it: its own logs, linearised about its own fit, and of all that
they may hold what the template of plates that are nearly alike has seen something of."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid import reading
from sysid.effects.effect import About
from sysid.fleet.batch import Batch
from sysid.fleet.closed import Block, Step
from sysid.fleet.template import FREE, Template
from sysid.minimum.minimise import State
from sysid.model.theta import NAMES
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.averaged import Kind, averaged
from sysid.verdict.finding import Finding
from sysid.verdict.linear import Found, Linear
from sysid.verdict.terms import of_some
from sysid.verdict.view import View


class End(NamedTuple):
    """How the fits of a batch end in one of their logs: what is `left` of it, in its noise, (P, n); the level
    of this, and the rotation, (P,)."""

    left: np.ndarray
    std: np.ndarray
    turn: np.ndarray

    @classmethod
    def each(cls, batch: Batch, lefts: Sequence[np.ndarray]) -> "list[End]":
        """Of all logs."""
        return [
            cls(
                left,
                log.noise(batch.step, log.values(batch.step)),
                turn * np.exp(1j * log.full(batch.step)[:, 3]),
            )
            for log, left, turn in zip(batch.logs, lefts, batch.turns, strict=True)
        ]


class Closer(NamedTuple):
    """What a plate's logs hold, by the thresholds of the single fit; what effects that they allow add to its
    covariance, (3, 3), and what is said of these."""

    found: list[Found]
    spans: np.ndarray
    said: Finding | None


def closer(
    batch: Batch,
    p: int,
    ends: Sequence[End],
    template: Template,
    which: Sequence[int],
    shown: Mapping[Kind, int],
) -> Closer:
    """The p-th plate, by `which` of the tests of its template; `shown`: how many effects of each kind its
    logs would show."""
    state = _minimum(batch, p, ends, template.trials)
    reference = reading.reference(state.trials)
    views = View.each(state, reference)
    fit, about = Linear(views, state, list(FREE), 0.0), About.of(state, reference)
    chances = {x.kind: x.chance for x in template.tried}
    tried = of_some(views, FREE, about, 0.0, [template.tried[k].term for k in which])
    tried = [t for t in tried if (t.name, t.log) in chances]
    fit.look(tried)
    found = fit.worth_more(tried, [chances[t.name, t.log] for t in tried])
    whole = {(t.name, t.log) for t in tried if t.source is None}
    average = averaged(fit, tried, {kind: n for kind, n in shown.items() if n and kind not in whole})
    return Closer(found, average.covariance[:3, :3], average.hint and average.hint.told(True))


def _minimum(batch: Batch, p: int, ends: Sequence[End], alike: Sequence[Trial]) -> State:
    """That of the p-th plate, whose logs are read as those of `alike`."""
    trials, models = [], []
    for log, end, trial in zip(batch.logs, ends, alike, strict=True):
        block, std = log.block, float(end.std[p])
        prior = dict(zip(block.names, log.prior[p].tolist(), strict=True))
        narrow = {"feedthrough": prior["feedthrough"], "lateness": prior["late"]} if "late" in prior else {}
        own = _read(trial, block, p).with_bench(turn=end.turn[p], narrow=narrow if batch.tight[p] else {})
        trials.append(with_noise(own, std, 0.0))
        models.append(block.response[p] - std * end.left[p])
    theta, covariance = np.zeros(len(NAMES)), np.zeros((len(NAMES), len(NAMES)))
    theta[:3], covariance[:3, :3] = batch.theta[p], batch.covariance[p]
    theta[2] -= reading.reference(trials)[0]
    return State(theta, covariance, tuple(trials), tuple(models), 0.0, 0.0, True, False, covariance)


def _read(trial: Trial, block: Block, p: int) -> Trial:
    """The p-th plate's log of a block, read as that of another plate of the layout."""
    log, inputs = trial.log, trial.inputs
    share = block.drive[p] / log.drive[-1]
    told, inputs = {"drive": log.drive * share}, inputs._replace(drive=inputs.drive * share)
    if isinstance(block, Step) and (more := block.frequency[p] - log.frequency[0]):
        told["frequency"] = log.frequency + more
        inputs = inputs._replace(offset=inputs.offset - more, omega=inputs.omega + 2 * np.pi * more)
    return replace(trial, log=log.again(block.response[p], **told), inputs=inputs)
