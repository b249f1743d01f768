"""The noise of a log recorded in coarse steps, where rows that read alike share one rounding error
(`rows.rounding`)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.rows import rounding
from sysid.trials.noise import SURE, Level, estimate, tails
from sysid.trials.rounds import HELD, SETTLED, WHOLE, halfway
from sysid.trials.trial import Trial, freedoms, with_noise
from sysid.trials.whitening import joined

ROUNDS = 3  # the noise level depends on which rows share their rounding, and that on the level


class _Channel(NamedTuple):
    """One channel of a log, d or q; arrays are (n,). `spread` and `own` as `rounding.spread` returns them."""

    left: np.ndarray  # weighted residual, the weights of the rounding aside
    model: np.ndarray
    step: float  # of the recorder
    spread: np.ndarray
    own: np.ndarray
    time: float  # correlation time of its noise, as known so far

    @classmethod
    def of(cls, trial: Trial, left: np.ndarray, model: np.ndarray) -> list["_Channel"]:
        """Both channels of a d/q log, or the only one."""
        d_q = [(left.real, model.real), (left.imag, model.imag)] if np.iscomplexobj(left) else [(left, model)]
        if trial.noise.rounded is None:
            return [
                cls(*pair, step, *2 * (np.ones(len(left)),), 0.0)
                for pair, step in zip(d_q, trial.steps, strict=True)
            ]
        known = zip(d_q, trial.steps, trial.noise.parts, strict=True)
        return [cls(*pair, step, p.rounded, p.own, p.time) for pair, step, p in known]


def with_rounding(trial: Trial, model: np.ndarray, round_: int) -> Trial | None:
    """The trial with noise that includes the rounding to the recorder's steps; None where the noise blurs
    these, so that rows share no rounding error. Which rows share one is fixed after HELD rounds."""
    if round_ >= HELD and trial.noise.rounded is None:
        return None
    plain = replace(
        trial, noise=replace(trial.noise, levels=(), rounded=None, own=None, tail=None, kept=trial.there)
    )
    channels = _Channel.of(trial, trial.residual(model) * plain.noise.weight, model)
    tail, told = np.ones(len(model)), 1.0
    if round_ and trial.noise.tail is not None:
        tail, told = trial.noise.tail, trial.noise.efficiency
    stds = _levels_beside(plain, channels, tail)
    for _ in range(ROUNDS if round_ < HELD else 0):
        shares = [
            rounding.spread(c.model, c.step, std, trial.noise.count)
            for c, std in zip(channels, stds, strict=True)
        ]
        channels = [c._replace(spread=s, own=own) for c, (s, own) in zip(channels, shares, strict=True)]
        stds = _levels_beside(plain, channels, tail)
    if np.mean([c.own[plain.noise.used] for c in channels]) > 1 - rounding.LITTLE:
        return None
    if 0 < round_ < HELD:
        scaled = joined([c.left[plain.noise.used] / std for c, std in zip(channels, stds, strict=True)])
        tail, told = np.ones(len(model)), 1.0
        if np.max(np.abs(scaled)) ** 2 > SURE:  # rounding leaves none, and many that are small, on plateaus
            tail[plain.noise.used], told = tails(scaled)
    levels = [Level(std, 0.0) for std in stds]
    if told == 1:
        counts = freedoms(_sharing(plain, channels))
        levels = [
            _coloured(plain, c, n, trial.noise.rounded is None, round_)
            for c, n in zip(channels, counts, strict=True)
        ]
    new = _sharing(plain, channels)
    new = new.in_noise(replace(new.noise, tail=None if told == 1 else tail, efficiency=told))
    std = float(np.sqrt(np.mean([x.std**2 for x in levels])))
    return with_noise(new, std, levels[0].time, tuple(levels) if len(levels) == 2 else ())


def _sharing(plain: Trial, channels: Sequence[_Channel]) -> Trial:
    """The trial with these shares of the rounding errors; the levels of d and q, where there are two, are
    still to be found."""
    levels = 2 * (Level(1.0, 0.0),) if len(channels) == 2 else ()
    rounded, own = joined([c.spread for c in channels]), joined([c.own for c in channels])
    return plain.in_noise(replace(plain.noise, levels=levels, rounded=rounded, own=own))


def _levels_beside(plain: Trial, channels: Sequence[_Channel], tail: np.ndarray) -> list[float]:
    """Standard deviation of each channel's noise, with rows weighted by `tail`; never below that of its
    rounding."""
    counts = freedoms(_sharing(plain, channels))
    powers = [float(np.sum(tail * (c.left / c.spread) ** 2)) for c in channels]
    return [
        max(float(np.sqrt(p / n)), rounding.least(c.step))
        for c, p, n in zip(channels, powers, counts, strict=True)
    ]


def _coloured(plain: Trial, channel: _Channel, count: float, first: bool, round_: int) -> Level:
    """Level of a channel's noise of `count` degrees of freedom. Its correlation time is estimated from rows
    that share no rounding error, one of each group that does."""
    used = plain.noise.used
    left, clock = channel.left[used], plain.noise.clock[used]
    alone = np.flatnonzero(np.diff(np.floor(np.cumsum(channel.own[used])), prepend=-1.0))
    time = channel.time
    if round_ <= SETTLED:
        time = estimate(left[alone], clock[alone], float(len(alone)))[1]
        time = time if first or round_ <= WHOLE else halfway(time, channel.time)
    std, time = estimate(left / channel.spread[used], clock, count, time=time)
    return Level(max(std, rounding.least(channel.step)), time)
