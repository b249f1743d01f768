"""What an effect is to a fit: a few numbers, what is known of them beforehand, and what they do to a log.

    log --applied(numbers)--> the same log, read as with the effect          (`Trial` to `Trial`)

All else is fitted as ever: an effect knows nothing of plants, noise or minima. An effect is absent at zero.
Its numbers have normal priors about zero, in units of physics (a delay in time constants, a shift in half
bandwidths, a share of the response), so that no verdict hangs on the units of a log."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sysid.effects.number import Number, number
from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.model.theta import NAMES
from sysid.rows.hold import cut
from sysid.trials.trial import Trial, with_noise
from sysid.trials.whitening import uneven

LEAST_ROWS = 8  # of a log that can show more than a plate
WIDE = 8.0  # half bandwidths, as of a usual sweep, where none is wider
EXACT = 1e-6  # of a step of a sweep, by which its frequencies are even
ORDER = 3  # of the smooth course of a sweep: even steps, in Hz or in their ratios, and a little of both
SEEN = 3.0  # standard deviations from zero
FINER, PEAKS = 2, 3  # steps of a periodogram over its own, and how many of its peaks are followed
GRID = 4  # points of its grid over rows
SWEEP = "a sweep of settled points as well"  # shows what looks like another tau in a step
HELD = 0.25  # of tau, for which the motion of one row may stand: a fifth of it is then gone


class Told(NamedTuple):
    """What there is, and what to do about it."""

    what: str
    to_do: str


class About(NamedTuple):
    """What is known of plant and log before an effect is fitted: `reference` Hz and degC; theta, and that of
    the plate `near` which it is fitted; tau s; the half bandwidth Hz; `top`, the largest response of the
    logs, `drive` the largest drive, and `span` (Hz) the widest sweep, or what is usual; `driven` Hz, the
    lowest and the highest frequency, less the reference; `told` degC, where f0 is told; `fitted` s, tau as it
    is with the effect, and its relative error; `moved` Hz, by how much the effect moves f0; `bend`
    Hz/degC^2, by which the resonances of logs that one plate does not describe bend over the temperature."""

    reference: tuple[float, float]
    theta: np.ndarray
    near: np.ndarray
    tau: float
    half_bandwidth: float
    top: float
    drive: float
    span: float
    driven: tuple[float, float] = (0.0, 0.0)
    told: float = 0.0
    fitted: tuple[float, float] = (0.0, 0.0)
    moved: float = 0.0
    bend: float = 0.0

    @classmethod
    def of(cls, state: State, reference: tuple[float, float], away: float = 0.0) -> "About":
        """Of the logs at a minimum, whose parameters are told `away` (degC) from the reference."""
        top = max(t.scale for t in state.trials)
        each = [t.log.frequency - reference[0] for t in state.trials if t.resonant]
        span = max([WIDE * state.half_bandwidth, *(float(np.ptp(x)) for x in each)])
        ends = [(float(np.min(x)), float(np.max(x))) for x in each] or [(0.0, 0.0)]
        driven = (min(low for low, _ in ends), max(high for _, high in ends))
        drive = max((float(np.max(np.abs(t.log.drive))) for t in state.trials if t.driven), default=1.0)
        known = reference, state.theta, state.theta, state.tau, state.half_bandwidth
        return cls(*known, top, drive, span, driven, reference[1] + away)


class Fitted(NamedTuple):
    """Numbers (d,) of an effect as they are fitted to a log, and their covariance; tau (s) of the plate that
    is fitted beside it, that without it, which numbers may be in, and the plate's largest response over that
    of the logs, or 1 where it is less."""

    values: np.ndarray
    covariance: np.ndarray
    tau: float
    before: float
    own: float = 1.0

    @property
    def stds(self) -> np.ndarray:
        """(d,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    def seen(self, *numbers: int) -> bool:
        """Whether these, or all of them, are together not zero."""
        some = list(numbers) or list(range(len(self.values)))
        stds = self.stds[some]
        values = self.values[some] / stds
        if len(some) == 1:
            return bool(abs(values[0]) > SEEN)
        correlation = self.covariance[np.ix_(some, some)] / np.outer(stds, stds)
        return bool(values @ np.linalg.pinv(correlation, hermitian=True) @ values > SEEN**2)

    def positive(self) -> bool:
        """Whether the first is not zero, and larger."""
        return bool(self.values[0] > SEEN * self.stds[0])


@dataclass(frozen=True)
class Effect:
    """An effect by the name that it has in scenes.

    `shows`: whether a log can show it. `stds`: (d,) prior standard deviation of its numbers. `starts`:
    (m, d) from where they are looked for. `applied`: the log read as with it. `numbers`: these, and their
    standard deviations, by name, in units of the bench. `said`: a sentence in two parts on the log and
    these. `scope`: "log", each log has numbers of its own; "plate", they are the same in all logs that
    show it; "bench", they may be either. `many`: a log may have more than one. `rough`: in which logs,
    with which numbers, its law is not known well enough for the errors that the fit states, so that it is
    named and not adopted. `another`: with it the plant is not of first order, and G and tau are none of
    it. `afresh`: with it the plant of that log may be far from what it seems without, and is looked for
    anew from each start. `stretched`: of one that changes what was recorded, the log of by how much it
    stretches that. `linear`: numbers that the response follows in proportion from zero, as far as a log
    has them, by which logs show it to first order, beside others at each of its `places` (m, d); where
    none is, all that it does at a place. `known_as`: what else shows it to first order (`verdict.terms`);
    with neither it has to be tried. `noise_like`: whether noise of a log looks like such numbers.
    `expected`: every plate has a little of it; `usual`: every bench, so that of settled d and q it is
    always fitted. `shown_by`: what to record so that it shows, where as much of it as moves the
    parameters far may hide in a log; else "". `stated`: what a log's metadata would have said of it, by
    which rows are read in another way. `colour`: of noise that went through it, the correlation of rows
    that are so many seconds apart. `relative`: it is what a log is beside others, and not what all are.
    `vague`: whether in such a log, with such numbers, it may look like anything, so that all others are
    tried as well. `hop`: of numbers that a log follows in steps, but for linear ones, where they had
    better be, seen from the plate near by. `settles`: it follows the plate that is fitted beside it,
    until both settle. `law`: of the plate, of which several are parts, as of what its amplitude does.
    `steps`: (d,) over which the response changes with its numbers, where it does so from row to row.
    `leaves`: (6,) standard deviations of theta that it leaves open, where all driven logs have it as a given
    one does. `makes_sense`: whether numbers as they are fitted are those of the effect; unless stated,
    whether one that is linear is seen at all."""

    name: str
    shows: Callable[[Trial], bool]
    stds: Callable[[Trial, About], np.ndarray]
    starts: Callable[[Trial, About], np.ndarray]
    applied: Callable[[Trial, np.ndarray, About], Trial]
    numbers: Callable[[Trial, np.ndarray, np.ndarray, About], dict[str, Number]]
    said: Callable[[Trial, dict[str, Number]], Told]
    scope: str = "log"
    many: bool = False
    rough: Callable[[Trial, np.ndarray], bool] = lambda trial, values: False
    another: bool = False
    afresh: Callable[[Trial, About], bool] = lambda trial, about: False
    stretched: Callable[[Trial, np.ndarray, About], float] = lambda trial, values, about: 0.0
    law: str = ""
    linear: tuple[int, ...] = (0,)
    places: Callable[[Trial, About], np.ndarray] | None = None
    known_as: Sequence[str] = ()
    noise_like: Callable[[Trial, np.ndarray], bool] = lambda trial, values: False
    expected: bool = False
    usual: bool = False
    shown_by: Callable[[Trial, About], str] = lambda trial, about: ""
    colour: Callable[[np.ndarray, About, np.ndarray], np.ndarray] | None = None
    relative: bool = False
    vague: Callable[[Trial, np.ndarray], bool] = lambda trial, values: False
    hop: Callable[[Trial, About], np.ndarray] | None = None
    stated: Callable[[np.ndarray, About], dict[str, float]] | None = None
    settles: bool = False
    steps: Callable[[Trial, About], np.ndarray] | None = None
    leaves: Callable[[Trial, np.ndarray], np.ndarray] = lambda trial, values: np.zeros(len(NAMES))
    makes_sense: Callable[[Trial, Fitted], bool] | None = None

    def sensible(self, trial: Trial, fitted: Fitted) -> bool:
        """Whether numbers as they are fitted to a log are those of the effect."""
        if self.makes_sense is not None:
            return self.makes_sense(trial, fitted)
        return fitted.seen(*(k for k in self.linear if k < len(fitted.values)))


def always(trial: Trial, values: np.ndarray | None = None) -> bool:
    """In any log, with any numbers."""
    return True


def fixed(values: ArrayLike) -> Callable[[Trial, About], np.ndarray]:
    """The same for every log."""
    array = np.array(values, float)
    return lambda trial, about: array


def one(
    name: str, unit: str, per: Callable[[Trial, About], float] = lambda trial, about: 1.0
) -> Callable[[Trial, np.ndarray, np.ndarray, About], dict[str, Number]]:
    """The first number by its name, of which one is `per` of the unit."""
    return lambda trial, values, stds, about: {name: number(values[0], stds[0], unit, per(trial, about))}


def positive(trial: Trial, fitted: Fitted) -> bool:
    """Whether the first number is larger than zero."""
    return fitted.positive()


def followed(trial: Trial, fitted: Fitted) -> bool:
    """Whether the first number is seen, of what takes how the plate moves from the row before: that has to be
    much nearer than tau, else, as inputs stand still, each row would tell the next one."""
    still = not trial.steady and 2 * trial.changes < len(trial.log)
    return fitted.seen(0) and not (still and trial.spacing > HELD * fitted.tau)


def at_others(shows: Callable[[Trial], bool]) -> Callable[[Trial, About], str]:
    """What shows, of logs that do, what goes with the amplitude."""
    return lambda trial, about: "levels of the drive that are far apart" if shows(trial) else ""


def nowhere(trial: Trial, about: About) -> np.ndarray:
    """Places of what the first order does not show."""
    return np.zeros((0, 1))


def plain(trial: Trial, std: float) -> Trial:
    """The trial with white noise of that level: what another description left of it is none."""
    spread = uneven(trial.noise.share, trial.log.response)
    noise = replace(trial.noise, spread=spread, tail=None, kept=trial.there, efficiency=1.0)
    levels = () if trial.noise.rounded is None else tuple(x._replace(time=0.0) for x in trial.noise.levels)
    trial = trial.in_noise(replace(noise, jitter=None, slow=1.0))
    if trial.bench.under is not None and trial.driven:  # noise as large as what is left would lift amplitudes
        narrow = {name: wide for name, wide in trial.bench.narrow.items() if name != "floor"}
        trial = trial.with_bench(under=None, narrow=narrow, floor=0.0)
    return with_noise(trial, std, 0.0, levels)


def shifted(trial: Trial, column: str, more: np.ndarray) -> Trial:
    """The trial whose "frequency" or "temperature" is higher by `more` (n,) than what is recorded: between
    rows of a transient, halfway."""
    inputs, held = trial.inputs, more
    if not trial.steady:
        inputs, row = cut(inputs)
        held = 0.5 * (more[np.maximum(row - 1, 0)] + more[row])
    if column == "frequency":
        inputs = inputs._replace(offset=inputs.offset - held, omega=inputs.omega + 2 * np.pi * held)
    else:
        inputs = inputs._replace(warming=inputs.warming + held)
    log = replace(trial.log, **{column: getattr(trial.log, column) + more})
    return replace(trial, log=log, inputs=inputs)


def undone(trial: Trial, response: Callable[[Log], np.ndarray]) -> Trial:
    """The trial of its log, and of all rows where these are means, with another response."""
    whole = None if trial.whole is None else replace(trial.whole, response=response(trial.whole))
    return replace(trial, log=replace(trial.log, response=response(trial.log)), whole=whole)


def sweep(trial: Trial) -> bool:
    """Settled points of a sweep, each of them driven."""
    return (
        trial.swept
        and trial.driven
        and len(trial.log) >= LEAST_ROWS
        and bool(np.all(trial.inputs.drive != 0))
    )


def one_way(trial: Trial) -> bool:
    """A sweep, with its times or of settled points, whose frequency only rises, or only falls."""
    if not trial.resonant or len(trial.log) < LEAST_ROWS:
        return False
    turns = np.sign(np.diff(trial.log.frequency))
    return bool(np.any(turns) and (np.all(turns >= 0) or np.all(turns <= 0)))


def course(frequency: np.ndarray) -> np.ndarray:
    """(n,) a smooth course of frequencies over their rows: a cubic of these, or of their logarithms if they
    are nearer to that."""
    row, fit = np.linspace(-1, 1, len(frequency)), np.polynomial.Legendre.fit
    even = fit(row, frequency, ORDER)(row)
    if np.min(frequency) <= 0:
        return even
    ratios = np.exp(fit(row, np.log(frequency), ORDER, w=frequency)(row))  # errors in Hz are alike
    return min((even, ratios), key=lambda f: float(np.std(frequency - f)))


def in_order(trial: Trial) -> bool:
    """Whether points of a sweep scatter about a smooth course by less than a step, so that they mostly keep
    their order."""
    f = trial.log.frequency
    if not sweep(trial) or trial.whole is not None:
        return False
    step = np.ptp(f) / len(f)
    return bool(EXACT * step < np.std(f - course(f)) < step)


def sweep_or_moving(trial: Trial) -> bool:
    """A sweep, or d and q of a transient whose inputs change."""
    return sweep(trial) or moving(trial)


def resonating(trial: Trial) -> bool:
    """The same, or d and q of a decay at a recorded frequency."""
    decays = not (trial.steady or trial.driven) and trial.signed and trial.resonant
    return sweep_or_moving(trial) or (decays and trial.log.theta is None and len(trial.log) >= LEAST_ROWS)


def moving(trial: Trial) -> bool:
    """d and q of a transient at a recorded frequency, whose inputs change."""
    moved = not trial.steady and trial.resonant and trial.signed and trial.driven and trial.changes > 0
    return moved and trial.log.theta is None


def driven_for_a_while(trial: Trial) -> bool:
    """Signed rows of a driven transient, enough for what is none of its plate."""
    transient = not trial.steady and trial.signed and trial.driven
    return transient and len(trial.log) >= LEAST_ROWS and lasted(trial) > 0


def lasted(trial: Trial) -> float:
    """s, from the first row to the last."""
    return float(trial.log.time[-1] - trial.log.time[0])


def oscillating(time: np.ndarray, left: np.ndarray) -> np.ndarray:
    """(m,) rad/s of the largest peaks of the periodogram of what is left (n,) at any times, in either
    direction, up to half a turn a row: of rows that are shared out to the nearest two points of a grid, so
    fine that it leaves nine tenths of the power there."""
    from scipy.signal import find_peaks  # takes a third of a second to load

    whole, most = time[-1] - time[0], FINER * len(left)
    at = (time - time[0]) / whole * (GRID * len(left))
    first = np.floor(at).astype(int)
    shared = np.zeros(2 * GRID * most, complex)
    np.add.at(shared, first, (first + 1 - at) * left)
    np.add.at(shared, first + 1, (at - first) * left)
    size = np.abs(np.fft.fft(shared)) ** 2
    power = size[1 : most + 1] + size[: -most - 1 : -1]
    peaks = find_peaks(power)[0]
    return np.pi / (FINER * whole) * (1 + peaks[np.argsort(-power[peaks])][:PEAKS])


def beside(trial: Trial, values: np.ndarray, about: About, shape: np.ndarray) -> Trial:
    """The trial with a shape (n,) in phase and in quadrature, as shares of the largest response."""
    more = (values[0] + 1j * values[1]) * about.top * shape
    return trial.with_bench(alongside=trial.bench.moves + more)


def shares(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    """The two numbers of `beside`; the first alone of a real log."""
    names = ("in_phase", "in_quadrature")[: trial.channels]
    each = zip(names, values, stds, strict=False)
    return {name: number(value, std, "of the largest response") for name, value, std in each}


def size(found: dict[str, Number]) -> tuple[float, float]:
    """Of such shares together, in percent, with its error."""
    each = np.array([(n.value, n.std) for n in found.values()])
    value, std = 100 * np.hypot.reduce(each)
    return float(value), float(std)
