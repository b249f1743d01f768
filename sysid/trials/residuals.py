"""The noise of a log and its outliers, estimated anew from the residual in each round of a fit."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from sysid.model import rice
from sysid.model.span import times
from sysid.trials.noise import (
    SHARES,
    WORTH,
    Level,
    apart,
    apart_in_colour,
    estimate,
    independent,
    proportional,
    scatter_of_stamps,
    spikes,
    tails,
)
from sysid.trials.perturbed import LogResponse
from sysid.trials.projected import efficiency
from sysid.trials.rounded import with_rounding
from sysid.trials.rounds import HELD, SETTLED, WHOLE, halfway
from sysid.trials.trial import Trial, freedom, with_noise
from sysid.trials.whitening import joined

MUCH = 0.3  # of a log's variation: a larger residual is not noise
COARSE = 0.6  # of a recorder's step: less noise than this is mostly rounding somewhere in the log
# rounds in which noise proportional to the response is looked for in a transient; later ones only refine it
EARLY = 2
# rows after a change that show no scatter of stamps: a response may begin differently, as behind a filter
BEGINS = 5
FEW = 100  # rows: fewer may look white although their noise is coloured enough to matter


def update_noise(
    trial: Trial, model: np.ndarray, course: LogResponse, floor: float, round_: int, white: bool = False
) -> Trial:
    """The trial with the noise that its residual shows; `floor`: square of the noise that lifts amplitudes,
    of an amplitude log. `white`: nothing but its level is asked for."""
    decaying = (
        trial.log.relative_noise and not trial.steady
    )  # what a first model makes of a tail in dB is no level
    trial = trial if decaying else _with_spread(trial, model, course, floor, round_)
    new = with_rounding(trial, model, round_) if any(trial.steps) else None
    new = new or _with_noise_of(
        trial.in_noise(replace(trial.noise, rounded=None, own=None)),
        model,
        course.design,
        round_,
        white,
    )
    new = _with_spread(new, model, course, floor, round_) if decaying else new
    if new.noise.time > 0 and not new.signed:
        return new.in_noise(replace(new.noise, efficiency=efficiency(new, course)))
    return new


def _with_spread(trial: Trial, model: np.ndarray, course: LogResponse, floor: float, round_: int) -> Trial:
    """The trial with the variation of its noise from row to row: Rice's for amplitudes, a share proportional
    to the response, or the effect of time stamps that scatter while the response moves. Where the log states
    it, it is known; of noise that is even in what was measured all is over that."""
    if trial.noise.stated is not None and not trial.log.even:
        return trial
    least, size = _of_amplitudes(trial, model, floor), np.abs(model) / trial.scale / _law(trial)
    size = size if trial.noise.stated is None else size / max(np.max(size), 1.0)
    share = _share(trial, model, size, least, round_)
    scatter, speed = _scatter(trial, model, course, round_) if share == 0 else (0.0, np.zeros(len(size)))
    if round_ >= HELD and share == trial.noise.share and (trial.signed or not trial.steady):
        return trial
    flat = share == 0 and scatter == 0 and np.all(least == 1)
    if flat and trial.noise.spread is None:
        return trial
    spread = None if flat else np.sqrt((1 - share) * least**2 + share * size**2 + (scatter * speed) ** 2)
    return trial.in_noise(replace(trial.noise, share=share, scatter=scatter, spread=spread))


def _law(trial: Trial) -> np.ndarray | float:
    """(n,) the noise of each row, if it is even in what was measured, over that of a usual one."""
    return 1.0 if trial.noise.stated is None else trial.noise.stated


def _scatter(trial: Trial, model: np.ndarray, course: LogResponse, round_: int) -> tuple[float, np.ndarray]:
    """By how much a transient's time stamps scatter, over its noise level, judged from rows past which the
    response moves; and how fast it moves, (n,). A scatter of more than a row has another cause."""
    log, still = trial.log, (0.0, np.zeros(len(model)))
    if (
        trial.steady
        or trial.whole is not None
        or log.relative_noise
        or any(trial.steps)
        or trial.noise.time > 0
    ):
        return still
    anew = 0 < round_ < HELD and _is_noise(trial, model)
    if not (anew or trial.noise.scatter):
        return still
    rate = course.rate + trial.bench.start * course.pole * course.free
    if trial.signed:
        rate = trial.bench.turn * rate
    else:
        rate = (rice.towards(course.plate, trial.lift) * rate).real + 0j
    if not anew:
        return trial.noise.scatter, np.abs(rate)
    first = np.searchsorted(trial.inputs.interval, trial.inputs.interval)
    told = trial.there & (np.arange(len(model)) - first >= BEGINS)
    return scatter_of_stamps(trial.residual(model)[told], rate[told], trial.spacing), np.abs(rate)


def _of_amplitudes(trial: Trial, model: np.ndarray, floor: float) -> np.ndarray:
    """(n,) noise of each row over that of a strong response: Rice's, in a transient only where that is
    likelier than even noise."""
    even = np.ones(len(model))
    if trial.signed or floor <= 0 or (trial.log.relative_noise and not trial.steady):
        return even
    least = rice.spread(model / np.sqrt(floor))
    if trial.steady:
        return least
    there = trial.there
    left = (trial.residual(model) * np.sqrt(trial.noise.count) / _law(trial))[there]
    own = least[there]
    gained = -0.5 * len(left) * np.log(np.mean((left / own) ** 2) / np.mean(left**2)) - np.sum(np.log(own))
    return least if gained > 0 else even


def _share(trial: Trial, model: np.ndarray, size: np.ndarray, least: np.ndarray, round_: int) -> float:
    """The share of the noise's variance that is proportional to the response."""
    known = trial.log.relative_noise
    if not trial.steady and not known and (trial.noise.time > 0 or trial.noise.left_out > trial.lost):
        return 0.0  # of a colour few rows are independent, and of those at rest fewer
    if not trial.steady and not trial.noise.share and round_ > EARLY:
        return 0.0
    scatters = trial.undriven_sweep or _is_noise(trial, model)  # one periodogram by half of itself
    if not 0 < round_ < HELD or not scatters:
        return trial.noise.share
    there = trial.there
    left = (trial.residual(model) * np.sqrt(trial.noise.count) / _law(trial))[there]
    if trial.steps and np.std(left) < COARSE * np.linalg.norm(trial.steps):
        return 0.0  # at rest there is less of rounding than of noise
    # a mean of periodograms scatters as it is large
    usual = float(SHARES[-1]) if trial.undriven_sweep else 0.0
    return proportional(left, size[there], least[there], known, usual)


class _Residual(NamedTuple):
    """The weighted residual of the rows with a signal; arrays are over these rows.

    `trial` is the log without knowledge of its outliers. `used` are the rows that are not left out.
    """

    trial: Trial
    rows: np.ndarray
    clock: np.ndarray
    left: np.ndarray
    design: Callable[[], np.ndarray]  # (n, K) of all rows, what the fit can make of them
    used: slice | np.ndarray = slice(None)

    @classmethod
    def of(cls, trial: Trial, model: np.ndarray, design: Callable[[], np.ndarray]) -> "_Residual":
        plain = trial.in_noise(replace(trial.noise, tail=None, kept=trial.there))
        rows = np.arange(len(trial.log))[plain.noise.used]
        left = times(joined([p.weight for p in plain.noise.parts]), trial.log.response - model)[rows]
        return cls(plain, rows, trial.noise.clock[rows], left, design)

    def without(self, regular: np.ndarray) -> "_Residual":
        """Without the outliers."""
        used = np.flatnonzero(regular)
        kept = np.isin(np.arange(len(self.trial.log)), self.rows[used])
        return self._replace(trial=self.trial.in_noise(replace(self.trial.noise, kept=kept)), used=used)

    def shapes(self) -> np.ndarray:
        return (self.design() * self.trial.noise.weight[:, None])[self.rows][self.used]

    def level(self, ratio: float, time: float | None, worth: float = WORTH) -> tuple[float, float]:
        """Standard deviation and correlation time, with q's noise `ratio` times that of d. `time`: the
        correlation time, where it is fixed; `worth`: the log-likelihood that colour must gain."""
        even = _scaled(self.left, ratio)[self.used]
        return estimate(
            even, self.clock[self.used], freedom(self.trial), self.shapes if ratio == 1 else None, time, worth
        )

    def outliers(self, ratio: float, time: float) -> tuple[np.ndarray, float, np.ndarray]:
        """Weight of each row; the information per row, relative to normal noise; and which rows are not
        outliers of coloured noise."""
        even = _scaled(self.left, ratio)
        weight, told = tails(independent(even, self.clock, time))
        regular = spikes(even, self.clock) if told < 1 else None
        return weight, told, np.ones(len(even), bool) if regular is None else regular

    def apart(self, weight: np.ndarray, time: float) -> float:
        """Ratio of q's noise to d's."""
        if time > 0:
            return apart_in_colour(self.left[self.used], self.clock[self.used])
        return apart(self.left, weight)

    def levels(self, weight: np.ndarray, before: tuple[Level, ...], round_: int) -> tuple[Level, ...]:
        """Noise of d and of q. The fit adjusts complex multiples of its shapes, which both channels share.
        Weighted rows have white noise."""
        left, counted = (np.sqrt(weight) * self.left)[self.used], 0.5 * freedom(self.trial)
        held, clock = before if round_ > SETTLED else (), self.clock[self.used]
        shapes = None if held or np.any(weight != 1) else self.shapes()
        found = []
        for k, (channel, turn) in enumerate(((left.real, 1.0), (left.imag, -1j))):
            if shapes is None:
                std, time = estimate(channel, clock, counted, time=held[k].time if held else 0.0)
            else:
                made = np.concatenate([(turn * shapes).real, -(turn * shapes).imag], axis=1)
                std, time = estimate(channel, clock, counted, partial(np.asarray, made))
                time = halfway(time, before[k].time) if before and round_ > WHOLE else time
            found.append(Level(std, time))
        return tuple(found)


def _with_noise_of(
    trial: Trial, model: np.ndarray, design: Callable[[], np.ndarray], round_: int, white: bool
) -> Trial:
    """The trial with the noise that its residual shows. Outliers, and whether d and q differ, are decided
    anew in each round between the first and HELD; correlation times are fixed after SETTLED."""
    trial = trial if round_ else trial.in_noise(replace(trial.noise, kept=trial.there, levels=(), tail=None))
    known = trial.noise
    found, chosen = _Residual.of(trial, model, design), 0 < round_ < HELD
    held = 0.0 if white else known.time if round_ > SETTLED else None
    ratio = known.levels[1].std / known.levels[0].std if known.levels else 1.0
    std, time = found.level(ratio, held)
    weight, told, regular = np.ones(len(found.left)), 1.0, known.kept[found.rows]
    if chosen:
        weight, told, regular = found.outliers(ratio, time)
    elif known.tail is not None:
        weight, told = known.tail[found.rows], known.efficiency
    if not np.all(regular):
        found = found.without(regular)
        std, time = found.level(ratio, held)
    if time > 0 or found.trial.noise.left_out > found.trial.lost:
        weight, told = np.ones(len(found.left)), 1.0
    even = not known.share and not known.scatter
    plain = time == 0 and told == 1 and ratio == 1 and even and found.trial.noise.left_out == found.trial.lost
    if plain and trial.signed and 0 < round_ <= SETTLED and len(found.left) < FEW:
        std, time = found.level(
            ratio, held, -np.inf
        )  # too few rows to show a colour that matters: as likely as it is
    time = halfway(time, known.time) if round_ > WHOLE else time
    if chosen and np.iscomplexobj(found.left) and _is_noise(trial, model):
        ratio = found.apart(weight, time)
        if ratio != 1 and told < 1:
            weight, told = tails(_scaled(found.left, ratio))
    if told < 1:
        std = float(np.sqrt(np.sum(weight * np.abs(found.left) ** 2) / freedom(found.trial)))
    levels = () if ratio == 1 else found.levels(weight, known.levels, round_)
    if levels:
        std = float(np.sqrt(np.mean([x.std**2 for x in levels])))
    new = with_noise(found.trial, std, time, levels)
    if told == 1:
        return new.in_noise(replace(new.noise, efficiency=told))
    tail = np.ones(len(trial.log))
    tail[found.rows] = weight
    return new.in_noise(replace(new.noise, efficiency=told, tail=tail))


def _is_noise(trial: Trial, model: np.ndarray) -> bool:
    """Whether the residual is small enough to be noise: the error of a wrong model differs between d and q
    too."""
    return bool(np.std(trial.log.response - model) < MUCH * np.std(trial.log.response))


def _scaled(left: np.ndarray, ratio: float) -> np.ndarray:
    """The residual with q, whose noise is `ratio` times that of d, scaled to the same level."""
    return left if ratio == 1 else left.real + 1j * left.imag / ratio
