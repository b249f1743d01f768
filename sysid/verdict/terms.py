"""What a log may hold that the model leaves out: one more term each, as a shape to first order and a
sentence."""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from sysid.model.carry import accumulated
from sysid.trials.extra import possible
from sysid.trials.heat import HEATED, clock, warmed
from sysid.trials.trial import LEAST_WARMING
from sysid.verdict.between import between
from sysid.verdict.moments import moments
from sysid.verdict.term import UNNAMED, Term, of_one
from sysid.verdict.throughout import of_all
from sysid.verdict.view import View

SLOW = 1e4  # time constants in a sweep that lasts long enough for the plate to warm
BESIDE = 2.0 ** np.arange(
    -1, 6
)  # half bandwidths from the resonance at which a second one is looked for, on both sides
LEAST = 1e-9  # of a shape: less is rounding
ABSURD = 100.0  # half bandwidths, of which a shape to first order says nothing
HIDDEN = (
    "{}: a resonance that drifts by {{:.2g}} Hz as the plate heats itself does not show in a slow sweep of"
    " one direction, and"
    " would move {{}}; sweep back as well, or record the temperature of every row"
)
RUNNING = (
    "{}: its frequency is taken to stay from row to row; if it runs on between them, as a chirp's, f0 is"
    " {:.2g} Hz {}, {:.2g} of"
    " its standard deviations; sweep back as well, or leave delay_s out"
)
RINGING = (0.25, 1.0)  # half bandwidths beside the resonance, at which an amplitude rings
PLACES = 24  # in a transient, at which rows may be missing: between two, some rows
OF_PHASE = "of settled points state what turns their phase, a sensor's or a cable's, and 0 if nothing does"


def terms(views: list[View], free: Sequence[str], away: float) -> list[Term]:
    """All that is tried; parameters are reported `away` (degC) from the mean temperature of the logs."""
    return list(
        chain(*(_of_one(i, v) for i, v in enumerate(views)), of_all(views, away, free), between(views, free))
    )


def _of_one(i: int, view: View) -> Iterator[Term]:
    """What one log may hold for itself."""
    trial = view.trial
    if not trial.driven and not trial.steady:
        return
    yield from saturations(i, view)
    if trial.resonant:
        yield from _second_resonance(i, view)
        yield from chain(_drift(i, view), _lag(i, view))
    elif trial.driven and not trial.steady:
        yield from _beating(i, view) if trial.log.amplitude_only else _off_resonance(i, view)
    if trial.steady:
        yield from chain(_too_fast(i, view), _background(i, view))
    else:
        yield from chain(_under_amplitude(i, view), _creeping(i, view), moments(i, view), _rows_lost(i, view))


def saturations(i: int, view: View) -> Iterator[Term]:
    """A response, or each of its channels, that is compressed at its largest."""
    trial, size = view.trial, np.abs(view.model)
    name = trial.log.name
    for power in (2, 6):
        said = f"{name}: {{}} is compressed at its largest: saturated; record it again within the range"
        yield of_one(i, "saturation", size**power * view.model, said.format("the response"), -1)
        if not trial.log.amplitude_only:
            each = view.model.real ** (power + 1) + 1j * view.model.imag ** (power + 1)
            yield of_one(i, "saturation", each, said.format("a channel"), -1)


def _rows_lost(i: int, view: View) -> Iterator[Term]:
    """Rows that a recorder lost amid a transient, though the times go on: those behind are ahead of them.
    Looked for at PLACES between which the response moves alike."""
    trial, moved = view.trial, np.cumsum(np.abs(view.course.rate))
    if trial.log.time is None or trial.whole is not None or moved[-1] == 0 or trial.spacing == 0:
        return
    ahead = view.observed(view.course.rate[None])[0]
    for row in np.unique(np.searchsorted(moved, moved[-1] * (np.arange(PLACES) + 0.5) / PLACES)):

        def say(value: np.ndarray, _: View, row: int = int(row)) -> str | None:
            lost = value[0] / trial.spacing
            if not 0.5 < lost < 0.1 * len(trial.log):
                return None
            return (
                f"{trial.log.name}: from about {trial.log.time[row]:.4g} s on it is ahead by about"
                f" {lost:.2g} rows: rows seem to"
                " be missing there, though the times go on; record it again, or leave it out"
            )

        yield Term("rows_lost", {i: (ahead * (np.arange(len(ahead)) >= row))[:, None]}, say, i, freedom=2)


def _second_resonance(i: int, view: View) -> Iterator[Term]:
    c = view.course
    half_bandwidth = 1 / (2 * np.pi * c.tau)
    one = view.trial.log.frequency is not None and np.ptp(view.trial.log.frequency) == 0
    out = "drive at another frequency, or record a sweep without it" if one else "leave its frequencies out"
    places = np.append(-BESIDE, BESIDE)
    # Outside of all frequencies it shows no peak, and whatever is nearly even looks like it; so does one that
    # is the larger.
    below, above = (np.min(c.detuning), np.max(c.detuning)) if view.trial.swept else (-np.inf, np.inf)
    others = c.at(np.tile(2j * np.pi * half_bandwidth * places, (len(c.hold.drive), 1))).forced
    for beside, shape in zip(places, others.T, strict=True):
        shapes = view.observed(np.stack([shape, 1j * shape])).T
        size = np.max(np.abs(shape)) / max(np.max(np.abs(view.plate)), 1e-300)

        def say(value: np.ndarray, view: View, beside: float = beside, size: float = size) -> str:
            share = 100 * size * np.hypot(*value)
            if share > 100 or not below < -2 * np.pi * half_bandwidth * beside < above:
                return UNNAMED
            return (
                f"{view.trial.log.name}: a second resonance, about {abs(beside) * half_bandwidth:.3g} Hz"
                f" {'above' if beside > 0 else 'below'} the first and of {share:.2g} % of its response; {out}"
            )

        yield Term("second_mode", {i: shapes}, say, i, freedom=3)


def _off_resonance(i: int, view: View) -> Iterator[Term]:
    """A d/q transient whose frequency is not recorded, and which was not driven at the resonance as it is
    taken to be. By x half bandwidths it settles at G V/(1 + j x), and looks so much faster that tau is off by
    about x^2."""
    name, x = view.trial.log.name, 2 * np.pi * view.course.tau

    def say(value: np.ndarray, _: View) -> str:
        return (
            f"{name}: it was driven about {abs(value[0]):.2g} Hz off the resonance, and no frequency is"
            f" recorded; add a"
            " frequency_* column, or its value as metadata"
        )

    yield Term(
        "off_resonance",
        {i: view.along(np.full(len(view.plate), 2j * np.pi))[None].T},
        say,
        i,
        squared=("tau", x**2),
    )


def _beating(i: int, view: View) -> Iterator[Term]:
    """The same of an amplitude: it rises as |1 - exp(-(1 - j x) t/tau)|, a part of x^2 faster, and rings."""
    name, c = view.trial.log.name, view.course
    along = np.exp(1j * np.angle(c.forced))
    said = f"{name}: it seems to be driven beside the resonance, and no frequency is recorded"
    for x in RINGING:
        beside = np.abs(c.at(np.full((len(c.hold.drive), 1), 1j * x / c.tau)).forced[:, 0])
        shape = view.observed(((beside - np.abs(c.forced)) * along)[None])[0]
        yield of_one(i, "off_resonance", shape, f"{said}; record wd, wq and the frequency", 1)


def _drift(i: int, view: View) -> Iterator[Term]:
    """A resonance that moves in proportion to the time, or to the heat that the plate has made since the
    first row."""
    c, log = view.course, view.trial.log
    order = clock(log)
    heats = [warmed(order, np.abs(view.plate) ** 2, time) for time in HEATED]
    told = log.temperature is not None and np.ptp(log.temperature) > LEAST_WARMING
    swept = float(np.ptp(log.frequency))  # Hz; moved by most of it, the resonance has left the sweep
    for along, why in ((order, "drifts"), *((heat, "drifts as the plate heats itself,") for heat in heats)):
        if np.ptp(along) == 0:
            continue
        shape = view.along(2j * np.pi * along)

        def say(value: np.ndarray, _: View, why: str = why) -> str | None:
            if 2 * np.pi * c.tau * abs(value[0]) > ABSURD or (swept and abs(value[0]) > 0.5 * swept):
                return None
            warm = (
                "read its temperature in finer steps, on the plate"
                if told
                else "record the temperature of every row"
            )
            return (
                f"{log.name}: its resonance {why} by {value[0]:+.3g} Hz from the first row to the last;"
                f" {warm}, wait until it is"
                " constant, or fit a drift (--effects=+drift)"
            )

        unseen = HIDDEN.format(log.name) if along is heats[-1] and _slow_one_way(view) else ""
        yield Term("drift", {i: shape[:, None]}, say, i, unseen=unseen)


def _lag(i: int, view: View) -> Iterator[Term]:
    """A temperature that its sensor tells late."""
    name, warm = view.trial.log.name, view.trial.log.temperature
    if warm is None or np.ptp(warm) < LEAST_WARMING or "lag" in view.trial.extra:
        return
    lag = possible(view.trial, view.course, view.beside).get("lag")
    if lag is None:
        return

    def say(value: np.ndarray, _: View) -> str | None:
        return (
            f"{name}: the temperature that is recorded lags the plate's by about {value[0]:.2g} s; warm it"
            f" more slowly, wait"
            " until it is constant, or fit the lag (--effects=+lag)"
        )

    yield Term("lag", {i: view.observed(lag.shape[None]).T}, say, i)


def _slow_one_way(view: View) -> bool:
    """A sweep in one direction that lasts long, at a temperature that is not recorded or does not change."""
    log = view.trial.log
    if not one_way(view) or (log.temperature is not None and np.ptp(log.temperature) > LEAST_WARMING):
        return False
    return bool(log.time[-1] - log.time[0] > SLOW * view.course.tau)


def one_way(view: View) -> bool:
    """A sweep with its times whose frequency only rises, or only falls."""
    if view.trial.steady or not view.trial.resonant or len(view.trial.log) < 8:
        return False
    turns = np.sign(np.diff(view.trial.log.frequency))
    return bool(np.any(turns) and (np.all(turns >= 0) or np.all(turns <= 0)))


def _too_fast(i: int, view: View) -> Iterator[Term]:
    """Settled points that had not settled: after a dwell d each, Z_k = S_k + (Z_(k-1) - S_k) e^{a_k d}, S
    what it settles at."""
    log, c = view.trial.log, view.course
    if log.frequency is None or len(log) < 8 or np.mean(np.sign(np.diff(log.frequency))) ** 2 < 0.5:
        return
    for dwell in (0.5, 1.0, 2.0, 4.0):
        decay = np.exp(c.pole * c.tau * dwell)
        left = accumulated(decay[1:], -decay[1:] * np.diff(view.plate))
        said = (
            f"{log.name}: swept too fast for settled points (dwell about {dwell:.2g} tau); dwell"
            f" {6 * c.tau:.2g} s or longer at"
            " each frequency, or record the time of every row and say kind: transient"
        )
        yield of_one(i, "dwell", view.observed(np.append(0.0, left)[None])[0], said, 1)


def _background(i: int, view: View) -> Iterator[Term]:
    """What lies in parallel to the resonance or behind it, over a sweep: a cable's delay, a background that
    bends."""
    log = view.trial.log
    if log.frequency is None or np.ptp(log.frequency) == 0 or not view.trial.signed:
        return
    x = (log.frequency - np.mean(log.frequency)) / np.ptp(log.frequency)

    def late(value: np.ndarray, _: View) -> str:
        seconds, stated = -value[0] / (2 * np.pi * np.ptp(log.frequency)), log.bench.get("delay_s", 0.0)
        if stated:
            said = f"its phase does not fall along the sweep as behind the {stated:.2g} s that delay_s states"
            return f"{log.name}: {said}; {OF_PHASE}"
        return (
            f"{log.name}: its phase falls along the sweep as behind a delay of {seconds:.2g} s; state delay_s"
        )

    def bent(value: np.ndarray, _: View) -> str:
        return (
            f"{log.name}: a background that is not a straight line of the frequency; sweep a narrower range"
            f" about the peak"
        )

    yield Term("phase_delay", {i: (1j * x * view.model)[:, None]}, late, i)
    shape = (x**2 * view.trial.inputs.drive[view.trial.inputs.interval] + 0j)[:, None]
    yield Term("background", {i: np.concatenate([shape, 1j * shape], axis=1)}, bent, i, freedom=2)


def _creeping(i: int, view: View) -> Iterator[Term]:
    """An output offset of a transient that goes on in proportion to the time."""
    log = view.trial.log
    if (
        not view.trial.signed
        or "baseline" in view.trial.nuisances
        or len(log) < 8
        or log.time[-1] == log.time[0]
    ):
        return
    along = ((log.time - log.time[0]) / (log.time[-1] - log.time[0]) + 0j)[:, None]
    shapes = along if log.amplitude_only else np.concatenate([along, 1j * along], axis=1)

    def say(value: np.ndarray, view: View) -> str:
        share = 100 * float(np.hypot(*value) if len(value) > 1 else abs(value[0])) / view.trial.scale
        said = f"its output offset drifts by {share:.2g} % of the response from the first row to the last"
        return (
            f"{log.name}: {said}; record a shorter log, wait until it is constant, or fit it"
            f" (--effects=+baseline)"
        )

    yield Term("offset", {i: shapes}, say, i, freedom=shapes.shape[1])


def _under_amplitude(i: int, view: View) -> Iterator[Term]:
    """An offset o of d and q of which an amplitude |W + o| is all that was recorded."""
    if view.trial.signed or view.trial.standing:
        return
    constant = np.ones(len(view.plate), complex)
    shapes = view.observed(np.stack([constant, 1j * constant])).T
    shapes = shapes[
        :, np.linalg.norm(shapes, axis=0) > LEAST * np.linalg.norm(shapes)
    ]  # no phase turns at resonance

    def say(value: np.ndarray, view: View) -> str:
        share = 100 * float(np.hypot(*value)) / view.trial.scale
        return (
            f"{view.trial.log.name}: an offset of d and q lies under its amplitude, of {share:.2g} % of the"
            f" response; record wd"
            " and wq, or subtract what these read at rest before taking the amplitude"
        )

    yield Term("offset", {i: shapes}, say, i, freedom=shapes.shape[1])
