"""From trials to the padded arrays of the likelihood, in groups of one layout."""

from collections.abc import Iterable, Sequence

import numpy as np

from sysid.model.experiment import Experiment, Groups, Layout
from sysid.model.likelihood import OWN
from sysid.rows.hold import Hold
from sysid.trials.trial import Trial, freedom
from sysid.trials.whitening import joined, whitened


def group(
    trials: Sequence[Trial], reference: tuple[float, float], *, low_q: bool = False
) -> tuple[Groups, list[list[int]]]:
    """Stack the trials by layout. Returns the groups and, for each, the positions of its logs in `trials`.

    `low_q`: with the fast mode's ripple.
    """
    rows = _sizes([len(t.log) + SPARE + max(t.smoothing[1], 0) for t in trials], [t.steady for t in trials])
    most = max((len(t.inputs.drive) for t in trials if not t.steady), default=0)
    intervals = FEW if most <= FEW else bucket(most, 64)
    swept = any(
        t.sideways < 1 for t in trials
    )  # then all share what these need: one layout less is a smaller program
    stacks: dict[Layout, list[tuple[int, Experiment]]] = {}
    for i, trial in enumerate(trials):
        size = (rows[i], rows[i] if trial.steady else intervals)
        layout, x = _experiment(trial, trial.hold(reference), size, low_q, swept)
        stacks.setdefault(layout, []).append((i, x))
    groups, members = [], []
    for layout, stack in sorted(stacks.items(), key=lambda item: item[0]):
        stacked = [np.array(leaves) for leaves in zip(*[(*x.hold, *x[1:]) for _, x in stack], strict=True)]
        inputs = len(Hold._fields)
        groups.append((layout, Experiment(Hold(*stacked[:inputs]), *stacked[inputs:])))
        members.append([i for i, _ in stack])
    return tuple(groups), members


def _sizes(lengths: Sequence[int], kinds: Sequence[bool]) -> list[int]:
    """Rows that each log is padded to: as many as the longest of its kind has, unless that is over twice its
    own."""
    pairs = list(zip(lengths, kinds, strict=True))
    return [bucket(max(m for m, other in pairs if other == kind and m <= 2 * n), 64) for n, kind in pairs]


def bucket(n: int, least: int = 1) -> int:
    """The next of four sizes per octave, 8, 10, 12, 14, 16, ..., so that logs of new lengths find a compiled
    program."""
    step = 1 << max((max(n, least) - 1).bit_length() - 3, 0)
    return max(-(-n // step) * step, least)


def _pad(values: Iterable, n: int, fill: complex = 0.0) -> np.ndarray:
    values = np.asarray(values)
    return np.concatenate([values, np.full(n - len(values), fill, values.dtype)])


# offset, feedthrough, slope or baseline, and one more for each pole of a filter: absent ones are zero
COLUMNS = 3
SPARE = COLUMNS + OWN  # rows of the priors
# degrees of freedom of a level that is known: sums of squares S of a log beside it make exp(-S/2)
KNOWN = 1e6
FEW = 16  # intervals: a step, a ring-down, a staircase of the drive


def _experiment(
    trial: Trial, hold: Hold, shape: tuple[int, int], low_q: bool, swept: bool
) -> tuple[Layout, Experiment]:
    (rows, intervals), noise, keep = shape, trial.noise, trial.noise.order
    amplitude = not trial.signed
    own_gain = trial.steady and trial.log.drive is None
    moving = bool(not trial.steady and trial.resonant)
    carrier = moving and trial.log.theta is not None
    both, order = low_q and trial.ripples, trial.smoothing[1]
    size = abs(trial.bench.turn) or 1.0
    apart, toward = bool(noise.levels), trial.bench.turn / size
    extra = [_pad(x[keep], rows) for x in trial.extra_columns.values()]
    split = apart or (swept and not (trial.steady or amplitude)) or bool(extra)
    beside = trial.bench.alongside
    flags = (
        amplitude,
        own_gain,
        both,
        carrier,
        trial.touched or trial.slowed,
        apart,
        split,
        order,
        len(extra),
        trial.steady,
    )
    now, before = noise.whitening()
    y = trial.log.response[noise.used] if amplitude else np.asarray(trial.log.response[noise.used], complex)
    y = _pad(whitened(y, now, before), rows)
    bases = [_pad_rows(q, rows, COLUMNS + max(order, 0)) for q, _ in trial.spans]
    channels = (y.real, y.imag) if apart else (y,)
    return Layout(*flags, rows, intervals), Experiment(
        hold=padded(hold, keep, keep if trial.steady else slice(None), rows, intervals),
        response=joined([v - (basis @ v) @ basis for basis, v in zip(bases, channels, strict=True)]),
        now=_pad(now, rows),
        before=_pad(before, rows),
        basis=joined(bases),
        tightness=np.asarray(1 / trial.looseness),
        freedom=np.asarray(noise.told * freedom(trial) if noise.rounded is None else KNOWN),
        rounding=np.asarray(trial.rounding),
        rotated=np.asarray(float(trial.turned)),
        lateness=np.asarray(trial.lateness / trial.looseness),
        toward=np.asarray(toward * np.array([1, 1j * trial.sideways])),
        start=np.asarray(complex(trial.bench.start) / trial.started),
        floor=np.asarray(max(trial.lift, trial.bench.floor) / (size**2 if trial.undriven_sweep else 1.0)),
        late=np.asarray(trial.bench.late * trial.looseness / (trial.lateness or 1.0)),
        offset=np.asarray(complex(0.0 if beside is not None else trial.bench.offset)),
        alongside=_pad(np.zeros(rows, complex) if beside is None else beside[keep], rows),
        start_free=np.asarray(trial.start_free * trial.started),
        floor_free=np.asarray(float(trial.bench.floor_free and not trial.steady)),
        offset_free=np.asarray(trial.bench.standing * trial.prior("offset") / trial.looseness),
        extra=np.array(extra, complex).reshape(len(extra), rows),
        tied=_tied(trial, hold),
    )


def _tied(trial: Trial, hold: Hold) -> np.ndarray:
    """The log's own resonance (Hz), its mean warming (degC), one over the error of its thermometer, and k_T
    (Hz/degC) at the shape of that error; zeros if it has none."""
    if not (trial.tied and "thermometer" in trial.bench.extra):
        return np.zeros(4)
    known = 1 / trial.bench.extra["thermometer"].prior
    return np.array([trial.bench.resonance, np.mean(hold.warming[hold.interval]), known, trial.bench.k_T])


def _pad_rows(basis: np.ndarray, rows: int, columns: int) -> np.ndarray:
    found = np.zeros((columns, rows))
    found[: basis.shape[1], : len(basis)] = basis.T
    return found


def padded(hold: Hold, keep: np.ndarray, held: np.ndarray | slice, rows: int, intervals: int) -> Hold:
    """The rows `keep` and the intervals `held`, padded to so many of each."""
    return Hold(
        duration=_pad(hold.duration[held], intervals),
        drive=_pad(hold.drive[held], intervals),
        omega=_pad(hold.omega[held], intervals, np.nan),
        offset=_pad(hold.offset[held], intervals),
        warming=_pad(hold.warming[held], intervals),
        contact=_pad(hold.contact[held], intervals),
        damped=_pad(hold.damped[held], intervals, 1.0),
        interval=_pad(hold.interval[keep], rows),
        elapsed=_pad(hold.elapsed[keep], rows),
        spread=_pad(hold.spread[keep], rows),
        turn=_pad(hold.turn[held], intervals),
        begun=_pad(hold.begun[held], intervals),
        smoothing=np.asarray(hold.smoothing or 1.0),
    )
