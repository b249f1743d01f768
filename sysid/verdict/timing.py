"""What the rows of a transient may show of another moment than theirs: late, early, astray at a change,
between two rows."""

from collections.abc import Iterator

import numpy as np

from sysid.trials.trial import Trial
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Term, of_one
from sysid.verdict.wording import OFTEN

LIKE_ONE = 4.0  # the factor about one within which a shape that is what it is taken for has its coefficient
JUMP = 5.0  # times the usual change of the drive from row to row: an edge
OFF = (1.5, 3, 6, 12)  # rows by which a response is looked for to be late, or early
FEW = 16  # changes of the inputs, at each of which a row may be astray
LATE = (
    "{}: the response begins late, by a trigger or a demodulator's filter{}, which cannot be told from tau;"
    " state delay_s, or"
    " lockin_tau_s and lockin_order"
)
ASTRAY = (
    "{}: what is recorded at {:.6g} s, where an input changes, does not fit the rows around it, as if the"
    " change had come"
    " earlier: rows may be missing, or their times or a stated delay may be wrong; record it again, or"
    " leave it out"
)
EARLY = (
    "{}: the response begins about {:.2g} s before it should by the inputs that are recorded; record these"
    " when they change, say"
    " sampling: settled if rows belong to their own inputs (they are a row early), or state a delay_s of"
    " {:.2g}"
)
NOT_HELD = (
    "rows do not show the response to inputs that are held from the row before; say sampling: settled if"
    " they belong to their own"
    " inputs, and record a voltage step if the drive runs on between rows"
)


def moments(i: int, view: LinearisedLog) -> Iterator[Term]:
    """Of the i-th log."""
    yield from _later(i, view)
    yield from _astray(i, view)
    yield from _unheld(i, view)


def _later(i: int, view: LinearisedLog) -> Iterator[Term]:
    """A transient whose response comes late by more than a row, or through a filter; or early."""
    c, log = view.course, view.trial.log
    if not view.trial.changes and not view.trial.from_rest:
        return
    stated = log.bench.get("delay_s", 0.0)
    for off in (rows * view.trial.spacing for rows in OFF):
        if off < 2 * c.tau:
            late, early = (view.observed((c.later(t) - c.forced)[None])[0] for t in (off, -off))
            yield of_one(i, "late", late, LATE.format(log.name, f" of about {off:.2g} s"), True)
            yield of_one(i, "early", early, EARLY.format(log.name, off, stated - off), True)
    taus = c.tau * np.array([0.1, 0.3])
    for order in (1, 4):
        for late, shape in zip(taus, view.observed(c.behind(taus / order, order).T - c.forced), strict=True):
            yield of_one(i, "late", shape, LATE.format(log.name, f" of about {late:.2g} s"), True)


def _unheld(i: int, view: LinearisedLog) -> Iterator[Term]:
    """Of a transient whose inputs change on many of its rows: that rows show the response to their own
    inputs; and that the drive runs straight from row to row, where it does not jump, and is not held from
    each to the next."""
    c, trial = view.course, view.trial
    if trial.changes < OFTEN * len(trial.log) or trial.log.theta is not None:
        return
    own, drive = trial.log.sampling == "settled", c.hold.drive[c.hold.interval]
    ahead = np.append(np.diff(drive), 0.0)
    smooth = np.where(
        np.abs(ahead) > JUMP * np.median(np.abs(ahead[ahead != 0]) if np.any(ahead) else 0.0), 0.0, ahead
    )
    running = c.by_row.driven(0.5 * (np.append(0.0, -smooth[:-1]) if own else smooth)[c.towards])
    shapes = [
        s
        for s in (*([] if own else [np.append(c.forced[1:], c.forced[-1]) - c.forced]), running)
        if np.any(s)
    ]
    runs = (
        "the drive runs on from row to row, and is not held from each to the next; hold it, or record a"
        " voltage step"
    )
    said = f"{trial.log.name}: {runs if own else NOT_HELD}"
    if shapes:

        def say(value: np.ndarray, _: np.ndarray) -> str | None:
            # A drive that is fed back from the response goes with its noise, by another number than one.
            return said if np.any(np.abs(np.log(np.maximum(value, 1e-9))) < np.log(LIKE_ONE)) else None

        yield Term("sampling", {i: view.observed(np.stack(shapes)).T}, say, i, freedom=len(shapes))


def _astray(i: int, view: LinearisedLog) -> Iterator[Term]:
    """The row at a change of the inputs does not belong there: it shows what came of a change that was
    earlier. It may pass for noise that rows share, and the gain follow it."""
    for row in at_changes(view.trial):
        at = (np.arange(len(view.trial.log)) == row).astype(complex)[:, None]
        said = ASTRAY.format(view.trial.log.name, view.trial.log.time[row])
        shapes = at if view.trial.log.amplitude_only else np.concatenate([at, 1j * at], axis=1)
        yield Term("astray", {i: shapes}, lambda *_, said=said: said, i, freedom=2)


def at_changes(trial: Trial) -> list[int]:
    """The rows of a transient at which its inputs change, if they are few."""
    if trial.steady or not 0 < trial.changes <= FEW:
        return []
    begun = np.cumsum(trial.inputs.duration)[:-1] + trial.log.time[0] + trial.log.bench.get("delay_s", 0.0)
    last = (
        np.searchsorted(trial.log.time, begun + 0.01 * trial.spacing, side="right") - 1
    )  # that does not show the change
    return [int(row) for row in last if row >= 0]
