"""What is the matter with the time of a log: a delay before the response, a sweep that was not waited for, a
phase that falls along a sweep."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid.effects.effect import (
    About,
    Effect,
    Told,
    course,
    fixed,
    in_order,
    nowhere,
    one,
    shifted,
    undone,
)
from sysid.effects.number import Number, number, pm
from sysid.model.theta import NAMES
from sysid.rows.hold import read_at
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial, with_noise

ROWS = np.array([-2.0, -1.0, 1.0, 2.0, 4.0, 8.0])  # by which a log may be late, or early
TAUS = np.array([0.02, 0.06, 0.2, 0.5, 1.0, 2.0])
LEAST = 1e-3  # of tau: of a filter and of a dwell, which are not negative
# of the response: in a step a delay of less than a row looks like a gain and a feedthrough that cancel
THROUGH = 0.03
DWELLS = (
    2.0 ** np.arange(-2, 2.5, 0.5)[:, None]
)  # tau: of less a sweep shows no resonance, of more its points settle
PLACES = 16  # of a transient, between which the response moves alike, where rows may be missing
CHANGES = 8  # of the inputs of a log, whose edges may lie between its rows
WITHIN = np.array([-0.75, -0.5, -0.25, 0.25, 0.5])  # of a row, by which all of them may be late
EVEN = 12**-0.5  # standard deviation of what is even over a row
MISSING = 2.0  # rows, from which the search for how many are missing begins
ENOUGH = 6.0  # tau to dwell at each frequency, e^-6 of the change is left
LEAST_ROWS = 8
WHOLLY = 0.5  # by which a share is nearer to all than to nothing
PHASES = np.array([0.1, 0.3, 1.0, 3.0, 6.0])  # rad from one end of a sweep to the other


def timed(trial: Trial) -> bool:
    """A transient whose inputs change, of which it is not known how late it is."""
    moved = not trial.steady and trial.driven and trial.changes > 0 and trial.log.theta is None
    return moved and "late" in trial.nuisances


def timed_sweep(trial: Trial) -> bool:
    """A sweep of settled points with the time of each, which may be behind a filter that has not settled."""
    timed = trial.swept and trial.driven and trial.log.time is not None and trial.log.theta is None
    return timed and "late" in trial.nuisances and bool(np.all(np.diff(trial.log.time) > 0))


def on_time(trial: Trial) -> Trial:
    """The trial whose lateness is known, with as little feedthrough as a bench has."""
    narrow = trial.bench.narrow | {"feedthrough": THROUGH * trial.scale}
    return trial.with_bench(narrow=narrow, extra={}, resonance=None, late=0.0)


def _delayed(trial: Trial, values: np.ndarray, about: About) -> Trial:
    delay = trial.log.bench.get("delay_s", 0.0) + float(values[0])
    log = replace(trial.log, bench={**trial.log.bench, "delay_s": delay})
    return replace(on_time(trial), log=log, inputs=read_at(trial.inputs, log.time, delay, trial.start_free))


def _delay_said(trial: Trial, found: dict[str, Number]) -> Told:
    late, stated = found["delay_s"], trial.log.bench["delay_s"]
    way = "behind" if late.value > 0 else "before"
    or_else = ", or the demodulator's lockin_tau_s and lockin_order" if late.value > 0 else ""
    return Told(
        f"the response is {abs(late):.3g} s {way} the inputs that are recorded",
        f"state delay_s ({stated:.4g}){or_else}",
    )


DELAY = Effect(
    name="delay",
    shows=timed,
    stds=lambda trial, about: np.array([max(about.tau, ROWS[-1] * trial.spacing)]),
    starts=lambda trial, about: np.append(ROWS * trial.spacing, TAUS * about.tau)[:, None],
    applied=_delayed,
    numbers=one("delay_s", "s"),
    said=_delay_said,
    scope="bench",
    steps=lambda trial, about: np.array([min(trial.spacing, about.tau)]),  # less is a feedthrough
    places=nowhere,
    known_as=("late", "early"),
)


def _gapped(trial: Trial) -> bool:
    """A transient of every row of its file. An amplitude without a frequency may also have been driven beside
    the resonance, with which it rises in another way."""
    whole = not trial.steady and trial.whole is None and trial.spacing > 0 and trial.changes > 0
    return whole and (trial.signed or trial.resonant)


def _changing(trial: Trial) -> bool:
    """A transient whose inputs change a few times."""
    return timed(trial) and trial.signed and 2 <= trial.changes <= CHANGES and trial.spacing > 0


def _apart(trial: Trial, values: np.ndarray, about: About) -> Trial:
    hold = trial.inputs
    begins = np.append(0.0, np.cumsum(hold.duration))
    read = begins[hold.interval] + hold.elapsed
    begins[1:-1] += values * trial.spacing
    begins = np.maximum.accumulate(begins)
    interval = np.maximum(np.searchsorted(begins[:-1], read) - 1, 0)
    inputs = hold._replace(
        duration=np.diff(begins), interval=interval.astype(np.int32), elapsed=read - begins[interval]
    )
    log = replace(trial.log, bench={"delay_s": 0.0, **trial.log.bench})
    return replace(on_time(trial), log=log, inputs=inputs)


def _apart_numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
    k = int(np.argmax(np.abs(values)))
    begin = float(np.cumsum(trial.inputs.duration)[k])
    return {"late_s": number(values[k], stds[k], "s", trial.spacing), "of_s": number(begin, 0.0, "s")}


def _apart_said(trial: Trial, found: dict[str, Number]) -> Told:
    late, of = found["late_s"], found["of_s"]
    way = "later" if late.value > 0 else "earlier"
    return Told(
        f"its inputs change between its rows: that of {of.value:.4g} s after its first row by"
        f" {abs(late):.2g} s {way}, others by less",
        "run the recorder by the clock of the generator, or record faster",
    )


EDGES = Effect(
    name="edges",
    shows=_changing,
    stds=lambda trial, about: np.full(trial.changes, EVEN),
    starts=lambda trial, about: np.outer(WITHIN, np.ones(trial.changes)),
    applied=_apart,
    numbers=_apart_numbers,
    said=_apart_said,
    linear=tuple(range(CHANGES)),
    makes_sense=lambda trial, fitted: bool(np.max(np.abs(fitted.values)) <= 1),
)


@lru_cache(maxsize=4)  # for all places in a log
def _moved(trial: Trial, reference: tuple[float, float], theta: tuple[float, ...]) -> np.ndarray:
    """(n,) by how much the response has moved until each row."""
    plate = LogResponse.of(trial, reference, np.array(theta)).forced
    return np.cumsum(np.abs(np.diff(plate, prepend=plate[:1])))


def _row_at(trial: Trial, about: About, share: float) -> int:
    """The row at which the response has made that share of its moves."""
    moved = _moved(trial, about.reference, tuple(about.theta.tolist()))
    return int(np.searchsorted(moved, share * moved[-1]))


def _lost(share: float) -> Effect:
    """Rows that are missing, though the times go on, before about the row at which the response has made that
    share of its moves. Its numbers: how many, and by how many rows it is beside that one."""

    def place(trial: Trial, values: np.ndarray, about: About) -> int:
        return int(np.clip(_row_at(trial, about, share) + np.rint(values[1]), 0, len(trial.log)))

    def stds(trial: Trial, about: About) -> np.ndarray:
        first, last = (_row_at(trial, about, share + x / PLACES) for x in (-0.5, 0.5))
        return np.array([ROWS[-1], 1.0 + EVEN * (last - first)])

    def applied(trial: Trial, values: np.ndarray, about: About) -> Trial:
        after = np.arange(len(trial.log)) >= (row := place(trial, values, about))
        inputs, gap = trial.inputs, max(float(values[0]), 0.0) * trial.spacing
        here = inputs.interval[min(row, len(after) - 1)]
        longer = inputs._replace(
            duration=inputs.duration + gap * (np.arange(len(inputs.duration)) == here),
            elapsed=inputs.elapsed + gap * (after & (inputs.interval == here)),
        )
        return replace(trial, log=replace(trial.log, time=trial.log.time + gap * after), inputs=longer)

    def numbers(trial: Trial, values: np.ndarray, stds: np.ndarray, about: About) -> dict[str, Number]:
        before = max(place(trial, values, about) - 1, 0)  # the times behind it are moved
        begins = trial.log.time[before] + trial.spacing - trial.log.time[0]
        error = stds[1] * trial.spacing
        return {"rows": number(values[0], stds[0], "rows"), "after_s": number(begins, error, "s")}

    def said(trial: Trial, found: dict[str, Number]) -> Told:
        rows, begins = found["rows"], found["after_s"]
        return Told(
            f"from about {begins.value:.2g} s after its first row on it is ahead by {rows:.2g} rows:"
            " rows seem to be missing there, though the times go on",
            "record it again, or leave it out",
        )

    return Effect(
        name="rows_lost",
        shows=_gapped,
        stds=stds,
        starts=fixed([[MISSING, 0.0]]),
        steps=fixed([0.25, 1.0]),  # of a row nothing shows where in it it is
        applied=applied,
        numbers=numbers,
        said=said,
        many=True,
        makes_sense=lambda trial, fitted: fitted.positive() and bool(fitted.values[0] > 0.5),
    )


ROWS_LOST = tuple(_lost((k + 0.5) / PLACES) for k in range(PLACES))


def _unsettled(trial: Trial) -> bool:
    """A sweep of settled points that may have been too fast: driven, in one direction, or there and back, and
    without times, which tell how long it dwelt."""
    if trial.signed and "background" not in trial.nuisances:
        return False  # what is left is then rather that
    if not (trial.swept and trial.driven) or timed_sweep(trial):
        return False
    ways = np.sign(np.diff(trial.log.frequency))
    turns = np.count_nonzero(np.diff(ways[ways != 0]))
    return bool(turns <= 1 and np.count_nonzero(ways == 0) <= turns)


def _hurried(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """The trial as a transient of that dwell."""
    return as_transient(trial, max(float(values[0]), LEAST) * about.tau * np.arange(len(trial.log)))


def as_transient(trial: Trial, time: np.ndarray) -> Trial:
    """A sweep as a transient of these times (n,), which is not late: its own frequencies are its clock. What
    a recorder spoilt was found once, and stays out."""
    bench = {"delay_s": 0.0, **trial.log.bench}
    log = replace(trial.log, time=time, kind="transient", sampling="settled", bench=bench)
    new = Trial.of(log, "transient", trial.nuisances, np.zeros(len(log), bool))
    if len(new.log) == len(trial.log):
        there = new.there & trial.there
        new = replace(new, there=there, noise=replace(new.noise, kept=there), dark=trial.dark)
        new = replace(new, spoilt=trial.spoilt).with_bench(alongside=trial.bench.alongside)
    return with_noise(new, trial.noise.std, 0.0)


def _hurried_said(trial: Trial, found: dict[str, Number]) -> Told:
    dwell = found["dwell_s"]
    return Told(
        f"swept too fast for settled points (dwell about {dwell:.2g} s)",
        f"dwell {ENOUGH:.0f} tau or longer at each frequency, or record the time of every row and say kind:"
        f" transient",
    )


DWELL = Effect(
    name="dwell",
    shows=_unsettled,
    stds=fixed([ENOUGH]),
    starts=fixed(DWELLS),
    applied=_hurried,
    numbers=one("dwell_s", "s", lambda trial, about: about.tau),
    said=_hurried_said,
    scope="bench",
    linear=(),
    places=fixed(DWELLS[2::2]),
)


def _unwound(trial: Trial, values: np.ndarray, about: About) -> Trial:
    middle, span = np.mean(trial.log.frequency), np.ptp(trial.log.frequency)
    return undone(trial, lambda log: log.response * np.exp(1j * values[0] * (log.frequency - middle) / span))


def _unwound_said(trial: Trial, found: dict[str, Number]) -> Told:
    delay, stated = found["delay_s"], trial.log.bench.get("delay_s", 0.0)
    if stated:
        return Told(
            f"its phase does not fall along the sweep as behind the {stated:.2g} s that delay_s states",
            "of settled points state what turns their phase, a sensor's or a cable's, and 0 if nothing does",
        )
    if delay.value < 0:
        return Told(
            f"its phase rises along the sweep, as if a delay of {-delay.value:.4g} ± {pm(delay.std)} s that"
            " is not there had been undone",
            "see what the instrument takes off, or state delay_s below zero",
        )
    return Told(
        f"its phase falls along the sweep as behind a delay of {delay:.4g} s",
        "state delay_s",
    )


PHASE_DELAY = Effect(
    name="phase_delay",
    shows=lambda trial: trial.swept and np.iscomplexobj(trial.log.response) and len(trial.log) >= LEAST_ROWS,
    stds=fixed(np.array([PHASES[-1]])),
    starts=fixed(np.concatenate([-PHASES, PHASES])[:, None]),
    applied=_unwound,
    numbers=one("delay_s", "s", lambda trial, about: 1 / (2 * np.pi * float(np.ptp(trial.log.frequency)))),
    said=_unwound_said,
    scope="bench",
)


def _scattered(trial: Trial, values: np.ndarray, about: About) -> Trial:
    f = trial.log.frequency
    return shifted(trial, "frequency", values[0] * (course(f) - f))


def _scattered_said(trial: Trial, found: dict[str, Number]) -> Told:
    return Told(
        "its frequencies scatter about even steps, as those of a counter or of few digits do; they are taken"
        " as even",
        "write what the source was asked for, with all digits",
    )


def _unsure(trial: Trial, values: np.ndarray) -> np.ndarray:
    """Of n frequencies that scatter by s about a cubic its middle is known to s sqrt(9/4n), and its slope to
    s sqrt(3/n) over half of the sweep."""
    f, n = trial.log.frequency, len(trial.log)
    scatter = float(np.std(f - course(f)))
    known = {"f0": scatter * np.sqrt(2.25 / n), "tau": scatter * np.sqrt(3 / n) / (0.5 * np.ptp(f))}
    return np.array([known.get(name, 0.0) for name in NAMES])


# The frequencies of a sweep are read back with an error, by which each point lies beside the plate's curve.
SCATTER = Effect(
    name="frequency_scatter",
    shows=in_order,
    stds=fixed(np.ones(1)),
    starts=fixed(np.ones((1, 1))),  # all of it
    applied=_scattered,
    numbers=one("share", "1"),
    said=_scattered_said,
    leaves=_unsure,
    places=nowhere,  # as large as it is: to first order nothing holds it to that
    makes_sense=lambda trial, fitted: fitted.positive() and bool(abs(fitted.values[0] - 1) < WHOLLY),
)
