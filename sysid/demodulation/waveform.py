"""Raw carrier samples of drive and response as rows of Wd + j Wq, which a fit takes like any other
transient's.

Blocks of a few periods fill each stretch of the drive from edge to edge, so that none holds a change of the
drive. A row stands at the end of its block, where the next block's inputs begin, and holds the block's mean:
it is behind its time by half a block, `delay`. The first row stands before the first block and holds what the
block's own curve says of its beginning. The mean of e^{st} over a block of width T is 1 + (sT)^2/24 + ... of
its middle: a fit that knows `width` allows for it. What an edge does to W depends on the carrier's phase
there, by 1/(2 Q): a fit that knows `theta` allows for that.

An edge of the drive is known to a sample, and the gain G to as large a part of tau: one in a thousand or
less. Unless a delay is stated the response may be late by a block, `delay_std_s`: more of G is then open.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from sysid.columns import signal as signals
from sysid.columns.metadata import rate_key, sample_rate
from sysid.columns.plan import Plan
from sysid.demodulation.carrier import SURE, Stretches, filling, follow, strongest
from sysid.demodulation.lockin import CUBIC, QUADRATIC, blocks, low_pass
from sysid.tables.csvfile import Head, LogError

NAMES = "; columns drive and response are samples of a carrier: amplitudes are called voltage and w"
PERIODS = 2  # in a block, at least: in fewer the mean cannot be told from slope and curvature
SAMPLES = 32  # in a block, at least
ROWS = 1 << 18  # at most, about
LEAST = 16  # blocks in a waveform
# of the sample rate: above, the image at |2f - rate| of the carrier comes near a block's bandwidth
NYQUIST = 0.45
RATE = 1e-3  # by which a stated sample rate may differ from that of the time stamps
STATED = 1e-3  # by which a stated frequency may differ from the drive's
TIED = 20  # samples on one value, of which fewer may be chance
RUN = 3  # of them in a row, on the average: of few samples a period two may lie on either side of its top
LONGER = 2.0  # times as long as a carrier stays there


class Rows(NamedTuple):
    """Demodulated rows, (n,) each: `time` s, peak `drive` (signed), `frequency` Hz and `theta` rad of the
    inputs that begin there, `response` Wd + j Wq. `start`: samples where the stretches of held inputs begin,
    and the end; `stretch` of each row. `width` s of a block, `periods` in it, `delay` s by which a response
    is behind its time."""

    time: np.ndarray
    drive: np.ndarray
    frequency: np.ndarray
    theta: np.ndarray
    response: np.ndarray
    stretch: np.ndarray
    start: np.ndarray
    width: float
    periods: int
    delay: float
    notes: tuple[str, ...]


def demodulate(
    time: np.ndarray,
    drive: np.ndarray,
    response: np.ndarray,
    frequency: np.ndarray | None = None,
    *,
    delay: float = 0.0,
    tau: float = 0.0,
    order: int = 1,
    derivative: int = 0,
) -> Rows:
    """Rows of samples (n,) of drive and response at even `time` (s), the drive's own phase being the
    reference.

    frequency: (n,) Hz, stated; it names the frequencies where the drive bears it out. delay (s): by which the
    response is behind the drive. tau (s), order: one-pole filters that the response passes besides.
    derivative: of which order the samples are one of w, 1 of a velocity, and Wd + j Wq still that of w.
    Raises LogError when time is not even, periods are few or sampled too seldom, the drive is no carrier that
    holds, or a stated frequency is another than the drive's.
    """
    if (odd := uneven(time)) is not None:
        raise LogError(
            f"row {odd} (counted from 0): found {time[odd]} s, expected even steps of {_step(time):.6g} s"
        )
    step = _step(time)
    late = round(delay / step)
    first, count = max(-late, 0), len(drive) - abs(late)
    omega, periods = _measure(drive, step, frequency, count)
    n = round(2 * np.pi * periods / omega)
    ahead = late - delay / step  # samples by which the response then still lies ahead of the drive
    drive, response = drive[first:][:count], response[max(late, 0) :][:count]
    held = follow(drive, omega, n)
    spans = [filling(a, b, n) for a, b in pairwise(held.start)]
    own = np.repeat(np.arange(len(spans)), [len(k) for k in spans])  # stretch of each block
    begin = np.concatenate(spans)
    found = _in_blocks(response, held, own, begin, n, ahead, derivative)
    if tau > 0:
        spin = (1j * held.omega[own]) ** derivative
        smooth = _filtered(response, held, ahead, begin, n, tau / step, int(order), found[0] * spin[0])
        found[1:] = smooth / spin
    last = np.cumsum([len(k) for k in spans])  # rows at the ends of the stretches
    at = np.append(begin[0], begin + n).astype(float)
    at[last[:-1]] = held.edge[1:-1]
    stretch = np.append(own, len(spans) - 1)
    named, notes = _named(held, step, None if frequency is None else frequency[first:])
    if held.switched:
        notes = (*notes, "the drive is switched between levels: taken as its fundamental")
    return Rows(
        time=time[0] + (first + at) * step,
        drive=held.level[stretch],
        frequency=named[stretch],
        theta=held.theta[stretch] + held.omega[stretch] * (at - held.start[stretch]),
        response=found * step**derivative,
        stretch=stretch,
        start=first + held.start,
        width=n * step,
        periods=periods,
        delay=((n + 1) / 2 - ahead) * step,
        notes=notes,
    )


def _in_blocks(
    response: np.ndarray,
    held: Stretches,
    own: np.ndarray,
    begin: np.ndarray,
    n: int,
    ahead: float,
    derivative: int,
) -> np.ndarray:
    """Means of the response over blocks of `n` samples from `begin`, turned by the phase of each one's
    stretch `own`; before them what it is at the first sample, by the curve of the first block."""
    omega = held.omega[own]
    phase = (held.theta + ahead * held.omega)[own] + omega * (begin - held.start[own])
    curve = blocks(response, begin, n, phase, omega, derivative, CUBIC)
    if not _bent(curve[:, CUBIC]):
        curve = blocks(response, begin, n, phase, omega, derivative, QUADRATIC)
    x = (1 - n) / (2 * n)  # of a block's first sample
    powers = [1.0, x, x**2 - (n**2 - 1) / (12 * n**2), x**3]
    return np.append(curve[0] @ powers[: curve.shape[1]], curve[:, 0])


def _bent(cubic: np.ndarray) -> bool:
    """Whether blocks hold a cubic course (m,) of W, as at a Q of a few, beyond what noise makes of the
    largest in one of twenty logs: its image in the mean is then more than the noise of one more shape."""
    size = np.abs(cubic)
    noise = float(np.median(size)) / np.sqrt(np.log(4))  # of one of two parts
    return bool(np.max(size) > noise * np.sqrt(2 * np.log(20 * len(size))))


def _measure(drive: np.ndarray, step: float, stated: np.ndarray | None, count: int) -> tuple[float, int]:
    """Frequency (rad/sample) of the drive and periods in a block. Raises LogError when it is sampled too
    seldom, or when `count` samples of it are too few."""
    rate = f"sampled at {1 / step:.6g} Hz"
    if stated is not None and np.max(stated) * step > 0.5:
        raise LogError(f"found {np.max(stated):.6g} Hz {rate}, expected more than two samples a period")
    omega = strongest(drive)
    turns = omega / (2 * np.pi)
    if omega == 0:
        raise LogError(f"found a drive that is {drive[0]:g} throughout, expected samples of its carrier")
    if turns > NYQUIST:
        found = (
            f"a carrier at {turns / step:.6g} Hz {rate}, whose image is at {(1 - 2 * turns) / step:.3g} Hz"
        )
        raise LogError(f"found {found}; expected {1 / NYQUIST:.3g} samples a period or more")
    periods = int(np.ceil(max(PERIODS, SAMPLES * turns, len(drive) * turns / ROWS)))
    if count * turns < LEAST * periods:
        found = f"found {max(count * turns, 0.0):.3g} periods of the drive"
        raise LogError(f"{found}, expected {LEAST * periods} or more{NAMES}")
    return omega, periods


def _filtered(
    response: np.ndarray,
    held: Stretches,
    ahead: float,
    begin: np.ndarray,
    n: int,
    tau: float,
    order: int,
    start: complex,
) -> np.ndarray:
    """Means over the blocks from `begin` of the response behind `order` one-pole filters of `tau` samples."""
    origin = held.start[0]
    parts = zip(held.theta + ahead * held.omega, held.omega, np.diff(held.start), strict=True)
    phase = np.concatenate([theta + omega * np.arange(count) for theta, omega, count in parts])
    total = np.append(0.0, np.cumsum(low_pass(response[origin : held.start[-1]], phase, tau, order, start)))
    return (total[begin + n - origin] - total[begin - origin]) / n


def _named(held: Stretches, step: float, stated: np.ndarray | None) -> tuple[np.ndarray, tuple[str, ...]]:
    """Frequency (Hz) of each stretch: the stated one where it is the drive's within its error, else the
    drive's."""
    found, lit = held.omega / (2 * np.pi * step), np.isfinite(held.error)
    if stated is None:
        return found, ()
    said = stated[(held.start[:-1] + held.start[1:]) // 2]
    away = np.abs(found - said)
    if (bad := lit & (away > STATED * said)).any():
        k = int(np.argmax(bad))
        raise LogError(
            f"row {held.start[k]} (counted from 0): found {said[k]:.6g} Hz stated and {found[k]:.6g} Hz in"
            f" the drive's samples,"
            " expected one frequency"
        )
    right = lit & (away <= SURE * held.error / (2 * np.pi * step) + 1e-12 * said)
    names = dict(zip(held.omega[right], said[right], strict=True))
    notes = [
        f"the drive is at {f:.3f} Hz by its samples, stated are {s:.3f} Hz: taken as the samples say"
        for f, s in zip(found[lit & ~right][:1], said[lit & ~right][:1], strict=True)
    ]
    return np.array([names.get(w, f) for w, f in zip(held.omega, found, strict=True)]), tuple(notes)


def sample_times(head: Head, metadata: Mapping[str, str], time: np.ndarray | None, count: int) -> np.ndarray:
    """Times (s) of the samples: by a stated `sample_rate_Hz`, from the first time stamp on, else the stamps
    themselves."""
    if (rate := sample_rate(head, metadata)) is None:
        if time is None:
            raise LogError(
                f"{head.path}: found a waveform without time, expected a column time_s, or metadata"
                f" sample_rate_Hz{NAMES}"
            )
        return time
    if time is not None and abs(_step(time) * rate - 1) > RATE:
        stamps = f"{1 / _step(time):.6g} Hz as in the time stamps"
        raise LogError(
            f"{head.path}, metadata {rate_key(metadata)!r}: found {rate:.6g} Hz, expected {stamps}"
        )
    return (0.0 if time is None else time[0]) + np.arange(count) / rate


def from_samples(
    head: Head, plan: Plan, given: Mapping[str, Any], raw: tuple[np.ndarray, str] | None
) -> dict[str, Any]:
    """A log's fields, in rows, from those of its samples (`given`) and the samples of the response with their
    unit.

    Raises LogError as `demodulate` does, and when drive or response are missing or not as they were sampled.
    """
    if raw is None or given["drive"] is None or "duty" in plan.sources:
        raise LogError(
            f"{head.path}: found a waveform without its samples, expected columns such as drive_V and"
            f" response_um"
        )
    if odd := next((s for s in plan.sources.values() if s.amplitude != "peak"), None):
        raise LogError(
            f"{head.path}: found {odd.label} in {odd.amplitude} of a waveform, expected its samples as they"
            f" are"
        )
    bench = dict(given["bench"])
    derivative = signals.ORDERS.get(plan.quantity, 0)
    options = {"delay": "delay_s", "tau": "lockin_tau_s", "order": "lockin_order"}
    stated = {name: bench[key] for name, key in options.items() if key in bench}
    try:
        rows = demodulate(
            given["time"], given["drive"], raw[0], given.get("frequency"), derivative=derivative, **stated
        )
    except LogError as error:
        raise LogError(f"{head.path}: {error}") from None
    signal = rows.response * (2j * np.pi * rows.frequency) ** derivative / 1j
    response, unit = signals.lock_in(signal, plan, rows.frequency, raw[1], head.path)
    lit = rows.frequency[rows.drive != 0]
    span = f"{np.min(lit):.3f}" + (f" to {np.max(lit):.3f}" if np.ptp(lit) > 0 else "")
    said = f"demodulated at {span} Hz, boxcar of {rows.periods} periods, {len(response)} rows"
    found = {"time": rows.time, "drive": rows.drive, "frequency": rows.frequency, "theta": rows.theta}
    found |= {key: _held(given[key], rows) for key in ("temperature", "force") if key in given}
    # the drive may have changed anywhere between two samples
    doubt = np.hypot(
        bench.get("delay_std_s", 0.0 if "delay_s" in bench else rows.width), _step(given["time"]) / 12**0.5
    )
    bench |= {"delay_s": rows.delay, "delay_std_s": float(doubt), "lockin_boxcar_s": rows.width}
    return found | {
        "response": response,
        "response_unit": unit,
        "kind": "transient",
        "sampling": "instant",
        "bench": bench,
        "notes": (*given["notes"], said, *rows.notes),
        "warnings": (*given["warnings"], *_saturated(head.name, raw[0], unit)),
    }


def _saturated(name: str, samples: np.ndarray, unit: str) -> tuple[str, ...]:
    """What to say of samples that lie on their largest or smallest value for longer than a carrier stays
    within the step to the next value below: of a share arccos(1 - step/amplitude)/pi of a period."""
    half = 0.5 * float(np.ptp(samples))
    for sign in (1, -1):
        top = float(np.max(sign * samples))
        tied = np.flatnonzero(sign * samples == top)
        below = np.max(sign * samples, where=sign * samples < top, initial=-np.inf)
        if len(tied) < TIED or not np.isfinite(below):
            continue
        share = len(tied) / (tied[-1] - tied[0] + 1)
        if len(tied) < RUN * (1 + np.count_nonzero(np.diff(tied) > 1)):
            continue
        if share > LONGER * np.arccos(1 - min((top - below) / half, 2.0)) / np.pi:
            said = f"{len(tied)} samples lie exactly at {sign * top:.4g} {unit}"
            return (f"{name}: saturated: {said}; record it again within the range",)
    return ()


def _held(values: np.ndarray, rows: Rows) -> np.ndarray:
    """Mean of the samples in each stretch of the drive, for its rows; so that few values change."""
    if np.ptp(values) == 0:
        return np.full(len(rows.time), values[0])
    means = np.add.reduceat(values[: rows.start[-1]], rows.start[:-1]) / np.diff(rows.start)
    return means[rows.stretch]


def uneven(time: np.ndarray) -> int | None:
    """The row that stands least evenly behind the one before, where samples are missing or time stamps too
    coarse; else None."""
    steps, step = np.diff(time), _step(time)
    if step > 0 and 0.5 * step <= np.min(steps) and np.max(steps) <= 1.5 * step:
        return None
    return int(np.argmax(np.abs(steps - np.median(steps)))) + 1 if len(steps) else 0


def _step(time: np.ndarray) -> float:
    return float(time[-1] - time[0]) / max(len(time) - 1, 1)
