"""Inputs held from one change to the next, as the plant takes them; and how a finger's contact goes with its
force."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

Leaf = Any  # an array of numpy outside a compiled program, of JAX inside


class Hold(NamedTuple):
    """Inputs held from one change to the next, and where each row falls among them.

    (M,) per interval: `duration` s, `drive`, `omega` rad/s (NaN: at resonance), `offset` = reference - drive
    frequency Hz, `warming` = temperature - reference degC, `contact` of a finger, 0 to 1 and above, `damped`
    the factor by which the plate is damped besides. (N,) per row: `interval` index, `elapsed` s since it
    began, `spread` s^2, the variance of the times that were averaged into the row (0: a single sample).
    Settled points are intervals of their own. `turn` (M,) is e^{-2j theta} where the interval begins, 0 where
    the carrier's phase is not known. `begun` (M,) is 1 where the response has settled as the interval begins,
    which is the first. `smoothing` s, the time constant of a pole of the lock-in's filter."""

    duration: Leaf
    drive: Leaf
    omega: Leaf
    offset: Leaf
    warming: Leaf
    contact: Leaf
    damped: Leaf
    interval: Leaf
    elapsed: Leaf
    spread: Leaf
    turn: Leaf
    begun: Leaf
    smoothing: Leaf = 0.0


FULL_TOUCH = 1.5  # N, at which `contact` is one


def contact(
    force: Leaf, law: str = "saturating", scale: Leaf = 0.6, exponent: Leaf = 2 / 3, xp: Any = np
) -> Any:
    """How much a finger damps at `force` (N), over what it does at FULL_TOUCH; arrays of the module `xp`.

    saturating: (1 - exp(-(F/scale)^n)) / (1 - exp(-(1.5 N/scale)^n));  power: (F/1.5 N)^n, as contact areas
    grow. The power has an infinite slope at F = 0: its derivative is taken of ((F + e)^n - e^n), e = 1e-9 N.
    """
    tiny = 1e-9

    def power(x):
        return (x + tiny) ** exponent - tiny**exponent

    force = xp.maximum(force, 0.0)
    if law == "power":
        return power(force) / power(FULL_TOUCH)
    return xp.expm1(-power(force / scale)) / xp.expm1(-power(FULL_TOUCH / scale))


def force_of(full: np.ndarray, scale: float = 0.6, exponent: float = 2 / 3) -> np.ndarray:
    """The force (N) of a saturating `contact`."""
    share = np.minimum(-full * np.expm1(-((FULL_TOUCH / scale) ** exponent)), 1 - 1e-12)
    return scale * (-np.log1p(-share)) ** (1 / exponent)


def hold_inputs(
    time,
    drive,
    frequency=None,
    temperature=None,
    contact=None,
    *,
    settled=False,
    reference=(0.0, 0.0),
    at_rest=False,
    delay=0.0,
    early=None,
    theta=None,
) -> Hold:
    """Inputs held from row to row as a `Hold` of their runs of equal values; numpy, nothing is changed in
    place.

    `reference`: frequency (Hz) and temperature (degC) that offsets are taken from. Without a frequency: at
    resonance. `at_rest`: there was no drive before the first row. `delay` (s): by which a row's response is
    behind its time. `early` (N,) s: by which the inputs of a row began before it, less than a row. `theta`
    (rad): the carrier's phase at each row's time."""
    columns, last = _columns(len(time), drive, frequency, temperature, contact), len(time) - 1
    changed = np.zeros(len(time), bool)  # from the row before
    for c in columns:
        changed[1:] |= (c[1:] != c[:-1]) & ~(np.isnan(c[1:]) & np.isnan(c[:-1]))
    if settled:  # the inputs of row k have held since row k-1
        changed = np.append(changed[1:], False)
    changed[0] = True
    first = np.flatnonzero(changed)  # rows at which an interval begins
    inputs = np.stack([c[np.minimum(first + settled, last)] for c in columns])
    held = np.cumsum(changed, dtype=np.int32) - changed  # of each row, how many begin before it
    if at_rest and inputs[0, 0] != 0:
        before = np.array([[0.0], [1.0], [1.0], [1.0]]) * inputs[:, :1]
        first, inputs = np.append(0, first), np.concatenate([before, inputs], axis=1)
        held += 1
    begin = time[first] if early is None else time[first] - early[first]
    read = time - delay if delay else time
    moved = delay or early is not None
    row = np.maximum(
        (np.searchsorted(begin, read) if moved else held) - 1, 0
    )  # of the interval that ends at or after the row
    return Hold(
        duration=np.diff(np.append(begin, time[-1])),
        interval=row.astype(np.int32),
        elapsed=np.maximum(read - begin[row], 0.0),
        spread=np.zeros(len(row)),
        turn=np.zeros(len(first), complex) if theta is None else np.exp(-2j * np.asarray(theta)[first]),
        begun=np.zeros(len(first)),
        **_offsets(inputs, reference),
    )


def read_at(hold: Hold, time: np.ndarray, delay: float, moving: bool = False) -> Hold:
    """The same inputs, with rows (N,) that are behind `time` by `delay` (s); `time` begins with the first
    interval. Before that the plate rests, or is `moving` as in it: it then begins with the first row."""
    sooner = max(delay, 0.0) if moving else 0.0
    duration = hold.duration + sooner * (np.arange(len(hold.duration)) == 0)
    begin, read = time[0] - sooner + np.append(0.0, np.cumsum(duration)[:-1]), time - delay
    row = np.maximum(np.searchsorted(begin, read) - 1, 0)
    elapsed = np.maximum(read - begin[row], 0.0)
    return hold._replace(duration=duration, interval=row.astype(np.int32), elapsed=elapsed)


def cut(hold: Hold) -> tuple[Hold, np.ndarray]:
    """The same inputs in shorter intervals (M'), that end where a row is read as well; and the row that each
    leads to (M')."""
    begin = np.append(0.0, np.cumsum(hold.duration)[:-1])
    read = begin[hold.interval] + hold.elapsed
    when, of = np.append(read, begin), np.append(hold.interval, np.arange(len(begin)))
    order = np.argsort(when, kind="stable")  # what is read as an interval begins belongs to the one before
    place = np.argsort(order, kind="stable")[: len(read)]
    when, of = when[order], np.maximum.accumulate(of[order])
    row = np.maximum(place - 1, 0)
    held = {
        name: getattr(hold, name)[of]
        for name in ("drive", "omega", "offset", "warming", "contact", "damped", "turn", "begun")
    }
    end = max(begin[-1] + hold.duration[-1], when[-1])
    finer = hold._replace(
        duration=np.diff(np.append(when, end)),
        interval=row.astype(np.int32),
        elapsed=when[place] - when[row],
        **held,
    )
    return finer, np.minimum(np.searchsorted(place, np.arange(len(when)), side="right"), len(read) - 1)


def settled_points(drive, frequency=None, temperature=None, contact=None, *, reference=(0.0, 0.0)) -> Hold:
    """Settled points (n,) as a `Hold`: each is an interval of its own; without a frequency: at resonance."""
    n = len(drive)
    zeros, own = np.zeros(n), np.arange(n, dtype=np.int32)
    inputs = _offsets(_columns(n, drive, frequency, temperature, contact), reference)
    return Hold(
        duration=zeros, interval=own, elapsed=zeros, spread=zeros, turn=zeros + 0j, begun=zeros, **inputs
    )


def _columns(n: int, drive, frequency, temperature, contact) -> list[np.ndarray]:
    """Drive, frequency, temperature and contact, (n,) each; NaN where there is none."""
    columns = (np.nan if column is None else column for column in (drive, frequency, temperature, contact))
    return [np.broadcast_to(np.asarray(column, float), n) for column in columns]


def _offsets(inputs: Iterable[np.ndarray], reference: tuple[float, float]) -> dict[str, np.ndarray]:
    drive, frequency, temperature, contact = inputs
    return {
        "drive": drive,
        "omega": 2 * np.pi * frequency,
        "offset": reference[0] - frequency,
        "warming": np.nan_to_num(temperature - reference[1]),
        "contact": np.nan_to_num(contact),
        "damped": np.ones(len(drive)),
    }
