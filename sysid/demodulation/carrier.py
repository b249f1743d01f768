"""The drive as its samples show it: cut where its amplitude or frequency changes, with a line for its phase
in each stretch.

    v(t) = Re[jV e^{j theta}] = V cos(phase + omega (t - middle))    theta = phase + omega (t - middle) - pi/2

Times are counted in samples, frequencies in rad/sample.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sysid.demodulation.lockin import blocks
from sysid.demodulation.switched import fundamental, is_switched
from sysid.tables.csvfile import LogError

# of the largest drive: noise level that it has at least, so that changes much smaller are left unseen
FLOOR = 2e-4
FINE = 18  # samples in a period of a switched drive, at least: its noise is then a ninth of it
HARMONICS = 0.03  # of a switched drive that its harmonics leave in a block
ON = 8.0  # noise levels of a block above which the drive counts as on
WORTH = 60.0  # gain in log-likelihood, times two, for which the drive is cut
SHARP = 12.0  # noise levels from a block to the next that are a change for certain
SURE = 4.0  # standard deviations within which two lines are one
JUMP = 0.1  # rad by which the phase may jump while the drive is on
NEAR = 16  # blocks within which two phases may meet
AROUND = np.array([-1.15, 0.15])  # samples about a cut within which a drive that goes on unbroken changes
WIDEST = 4  # blocks that a change of the drive may take
FEWEST, LEVELS = 8, 257  # steps of a recorder of up to eight bits, whose rounding shows


HELD = (
    "expected a carrier of one frequency and one level for a few periods or more between its changes; of a"
    " drive that goes on changing, or of a chirp over more than a tenth of its frequency, record steps of"
    " frequency or level or a narrower chirp instead, or demodulate the samples by the drive and record"
    " rows: wd, wq, and the level and frequency of the drive in each"
)
HOLDS = f"found no carrier in the drive that holds for a few periods, {HELD}"


class Stretches(NamedTuple):
    """The drive, piece by piece: `edge` (m + 1,) when each begins, and the last ends; `start` the first
    sample after it; of each (m,) its `level` (signed), `omega`, `theta` at `start`, and `error` (standard
    deviation) of omega, inf while it is off. `switched`: they are those of its fundamental."""

    edge: np.ndarray
    start: np.ndarray
    level: np.ndarray
    omega: np.ndarray
    theta: np.ndarray
    error: np.ndarray
    switched: bool


@dataclass(frozen=True)
class Line:
    """One stretch's level (0: off) and phase; standard deviations `spread` of the phase at `middle`, `error`
    of omega."""

    level: float
    middle: float
    phase: float
    omega: float
    spread: float = np.inf
    error: float = np.inf

    def at(self, t):
        """The phase (rad) at t (s)."""
        return self.phase + self.omega * (t - self.middle)

    def doubt(self, t: float) -> float:
        """Standard deviation of the phase at t."""
        return float(np.hypot(self.spread, self.error * (t - self.middle)))


def strongest(signal: np.ndarray) -> float:
    """Strongest frequency (rad/sample) in the liveliest part of a signal, to a small part of its resolution;
    0: constant."""
    size = min(len(signal), 1 << 16)
    begins = range(0, len(signal) - size + 1, max(size // 2, 1))
    part = max((signal[b : b + size] for b in begins), key=np.var)
    part = part - np.mean(part)
    if not np.any(part):
        return 0.0
    peaks = np.abs(np.fft.rfft(part * np.hanning(size), 4 * size))
    top = int(np.clip(np.argmax(peaks), 1, len(peaks) - 2))
    low, high = peaks[top - 1] - peaks[top], peaks[top + 1] - peaks[top]
    return np.pi * (top + (0.5 * (low - high) / (low + high) if low + high < 0 else 0.0)) / (2 * size)


def filling(start: int, stop: int, n: int) -> np.ndarray:
    """First samples of blocks of `n` from edge to edge: what is left over lies before the last one."""
    found = np.arange(start, stop - n + 1, n)
    found[-1:] = stop - n
    return found


def follow(drive: np.ndarray, omega: float, n: int) -> Stretches:
    """The stretches of `drive` (samples), whose frequency is near `omega`, seen in blocks of `n`. Of a drive
    that is switched between levels they are those of its fundamental, whose phase each block tells to a
    sample: its edges stand at whole ones.

    Where the phases, or else the carriers, before and after a cut meet, the cut is there; otherwise it is
    taken to be at the first sample that shows it, and may lie up to one earlier. Stretches whose phases lie
    on one line share it, also across a pause; in a pause theta goes from the phase before it to the phase
    after. Raises LogError when the drive is no carrier, when it changes more often than every second block,
    and when its phase jumps while it is on (by half a turn: a change of sign).
    """
    start = n * np.arange(len(drive) // n)
    base = Line(1.0, 0.0, 0.0, omega)
    seen = blocks(drive, start, n, base.at(start), omega)[:, 0]
    size, middle = np.abs(seen), start + (n - 1) / 2
    switched = is_switched(drive, omega)
    if switched and 2 * np.pi / omega < FINE:
        found = f"found a drive that is switched between levels, {2 * np.pi / omega:.3g} samples a period"
        raise LogError(f"{found}, expected {FINE} or more, or a sine")
    jitter = omega + HARMONICS if switched else 0.0
    floor = max(FLOOR, 0.3 * jitter)
    own = 2.2 * np.quantile(np.abs(np.diff(size)), 0.25)  # of normal numbers
    noise = float(np.linalg.norm([own, floor * np.max(size), _rounded(drive, omega)]))
    pieces = _pieces(seen, noise, jitter) if noise else []
    lines = [_fitted(middle[a:b], seen[a:b], base, noise, jitter) for a, b in pieces]
    if not any(line.level for line in lines):
        raise LogError(HOLDS)
    for (_, a), (b, _), left, right in zip(pieces, pieces[1:], lines, lines[1:], strict=False):
        _refuse_pulse(size[a:b], left.level, right.level, noise, (a * n, b * n))
    cuts = np.array(_cuts(drive, [(a * n, b * n) for a, b in pieces], lines, n))
    edges = np.ceil(cuts).astype(int).tolist()
    spans = [filling(a, b, n) for a, b in pairwise(edges)]
    times = [k + (n - 1) / 2 for k in spans]
    rows = [blocks(drive, k, n, line.at(k), line.omega)[:, 0] for k, line in zip(spans, lines, strict=True)]
    fitted = [_fitted(*row, noise, jitter) for row in zip(times, rows, lines, strict=True)]
    if not any(line.level for line in fitted):
        raise LogError(HOLDS)
    if switched:
        fitted = [
            _switched(drive[a:b], a, line) for line, (a, b) in zip(fitted, pairwise(edges), strict=True)
        ]
    joined = _as_one(fitted, edges)
    turned = [
        z * np.exp(1j * (old.at(t) - new.at(t)))
        for t, z, old, new in zip(times, rows, lines, joined, strict=True)
    ]
    level = np.array([_level(z.real, line, noise) for z, line in zip(turned, joined, strict=True)])
    if switched:
        level = np.where(level == 0, 0.0, np.copysign([line.level for line in fitted], level))
    if np.sum(level**2 * np.diff(edges)) < np.var(drive) * len(drive):  # less than half of its power
        raise LogError(
            f"found a drive that is no carrier of {2 * np.pi / omega:.4g} samples a period, {HELD}"
        )
    theta = [line.at(edge) - np.pi / 2 for line, edge in zip(joined, edges, strict=False)]
    omegas, errors = ([getattr(line, name) for line in joined] for name in ("omega", "error"))
    return Stretches(
        cuts, np.array(edges), level, np.array(omegas), np.array(theta), np.array(errors), switched
    )


def _rounded(drive: np.ndarray, omega: float) -> float:
    """What a recorder of few steps adds to a block, which is what it adds to a period: the next ones are
    rounded alike. 0 where steps are many, or so few that a drive is switched between them."""
    levels = np.unique(drive)
    if not FEWEST < len(levels) < LEVELS:
        return 0.0
    step = float(np.min(np.diff(levels)))
    whole = (levels - levels[0]) / step
    each = step / np.sqrt(6 * max(2 * np.pi / omega, 1.0))
    return each if np.allclose(whole, np.round(whole), atol=0.1) else 0.0


def _pieces(z: np.ndarray, noise: float, jitter: float) -> list[tuple[int, int]]:
    """Blocks (first, last + 1) of stretches of two or more in which z has one amplitude and a phase on one
    line, to `jitter`."""
    size = np.abs(z) / noise
    weight = np.where(size > ON, size**2 / (1 + (jitter * size) ** 2), 0.0)
    seen = np.stack([np.unwrap(np.angle(z)), weight, size])
    sharp = np.flatnonzero(np.abs(np.diff(size)) > SHARP) + 1
    found, left = [], list(pairwise([0, *sharp.tolist(), len(z)]))
    while left:
        a, b = left.pop()
        gain, cut = _best_cut(*seen[:, a:b])
        if gain > WORTH:
            left += [(a, a + cut), (a + cut, b)]
        else:
            found.append((a, b))
    pieces: list[tuple[int, int]] = []
    for a, b in sorted(found):  # a cut may have become needless by later ones
        if pieces and a not in sharp and _best_cut(*seen[:, pieces[-1][0] : b])[0] <= WORTH:
            a = pieces.pop()[0]
        pieces.append((a, b))
    return [(a, b) for a, b in pieces if b - a > 1]


def _best_cut(angle: np.ndarray, weight: np.ndarray, size: np.ndarray) -> tuple[float, int]:
    """By how much two lines and sizes fit better than one, in the best of all cuts, and that cut."""
    if len(angle) < 2:
        return 0.0, 0
    x = np.linspace(-1, 1, len(angle))
    y, some = angle - angle[np.argmax(weight)], weight + 1e-300
    for _ in range(2):  # what is left of a line is small enough for sums of squares
        y = y - np.average(y, weights=some)
        off = x - np.average(x, weights=some)
        y = y - off * np.sum(weight * off * y) / max(np.sum(weight * off**2), 1e-300)
    terms = [
        np.ones(len(x)),
        size,
        size**2,
        weight,
        weight * x,
        weight * x**2,
        weight * y,
        weight * x * y,
        weight * y**2,
    ]
    sums = np.cumsum(terms, axis=1)
    total, sums = sums[:, -1:], sums[:, :-1]
    least = 1e-9 * total[3]  # weights below it are rounding
    costs = _cost(sums, least) + _cost(total - sums, least)
    best = int(np.argmin(costs))
    return float(_cost(total, least)[0] - costs[best]), best + 1


def _cost(sums: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Squares that the mean size and the best line leave, in units of the noise."""
    n, a, aa, w, wx, wxx, wy, wxy, wyy = sums
    lit = w > least
    w = np.where(lit, w, 1.0)
    width = wxx - wx**2 / w
    steep = width > 1e-9 * wxx
    straight = wyy - wy**2 / w - np.where(steep, (wxy - wx * wy / w) ** 2 / np.where(steep, width, 1.0), 0.0)
    return aa - a**2 / n + np.where(lit, np.maximum(straight, 0.0), 0.0)


def _fitted(t: np.ndarray, z: np.ndarray, base: Line, noise: float, jitter: float) -> Line:
    """The line of blocks z at times t, which were demodulated at `base`'s phase; that of each is known to
    `jitter` at best."""
    level, middle = float(np.median(np.abs(z))), float(np.mean(t))
    if level <= ON * noise:
        return Line(0.0, middle, base.at(middle), base.omega)
    angle, x = np.unwrap(np.angle(z)), t - middle
    width = np.sum(x**2)
    slope = np.sum(x * angle) / width if width else 0.0
    each = float(np.hypot(noise / level, jitter))
    error = each / np.sqrt(width) if width else np.inf
    return Line(
        level, middle, base.at(middle) + np.mean(angle), base.omega + slope, each / np.sqrt(len(t)), error
    )


def _switched(drive: np.ndarray, start: int, line: Line) -> Line:
    """The line of the fundamental of a drive that is switched, whose samples begin at `start`."""
    found = fundamental(drive, line.omega) if line.level else None
    if found is None:
        return line
    level, middle, omega = found
    whole = 2 * np.pi * round(line.at(start + middle) / (2 * np.pi))
    return replace(line, level=level, middle=start + middle, phase=whole, omega=omega)


def _level(z: np.ndarray, line: Line, noise: float) -> float:
    """Mean of z, the in-phase part of blocks; 0 while the drive is off, unless it is seen to leak."""
    leaks = np.isfinite(line.spread) and abs(np.mean(z)) > ON * noise / np.sqrt(len(z))
    return float(np.mean(z)) if line.level or leaks else 0.0


def _refuse_pulse(
    between: np.ndarray, left: float, right: float, noise: float, where: tuple[int, int]
) -> None:
    """LogError when what lies between two stretches is not a step from one to the other."""
    low, high = min(left, right) - ON * noise, 1.5 * max(left, right) + ON * noise
    pulse = np.any(between > high) or (len(between) > 1 and np.any(between < low))
    if pulse or len(between) > WIDEST:
        raise LogError(
            f"rows {where[0]} to {where[1]} (counted from 0): found a drive that does not hold, {HELD}"
        )


def _cuts(drive: np.ndarray, spans: list[tuple[int, int]], lines: list[Line], n: int) -> list[float]:
    """When the stretches begin, and the last ends: where phases meet when frequency alone changes (any other
    cut would turn the frame), else at the sample where a cut leaves the least squares."""
    offset, cuts = np.mean(drive), [float(spans[0][0])]
    for (_, last), (first, end), left, right in zip(spans, spans[1:], lines, lines[1:], strict=False):
        least = int(np.ceil(cuts[-1])) + n
        t = np.arange(max(last - n, least), first + n)
        met = _meeting(left, right, (last + first) / 2)
        if met is not None and least <= met <= end - 2 * n and abs(met - t.mean()) < NEAR * n:
            cuts.append(met)
            continue
        v = drive[t] - offset
        worse = (v - left.level * np.cos(left.at(t))) ** 2 - (v - right.level * np.cos(right.at(t))) ** 2
        cut = t[0] + np.argmin(np.append(0.0, np.cumsum(worse)))
        gap = left.level * np.cos(left.at(cut + AROUND)) - right.level * np.cos(right.at(cut + AROUND))
        crosses = gap[0] * gap[1] < 0
        cuts.append(float(cut + AROUND[0] + np.ptp(AROUND) * gap[0] / (gap[0] - gap[1]) if crosses else cut))
    return [*cuts, float(spans[-1][1])]


def _meeting(a: Line, b: Line, near: float) -> float | None:
    """When the phases of two lines of one level meet, the time nearest to `near`; None for lines of other
    kinds."""
    same = a.level and abs(b.level - a.level) < SURE * np.hypot(a.spread * a.level, b.spread * b.level)
    if not same or abs(b.omega - a.omega) < SURE * np.hypot(a.error, b.error):
        return None
    away = (b.at(near) - a.at(near) + np.pi) % (2 * np.pi) - np.pi
    return near - away / (b.omega - a.omega)


def _as_one(lines: list[Line], edges: list[int]) -> list[Line]:
    """The same lines, those that are one line joined, signs continued, and pauses led from one to the
    next."""
    groups: list[tuple[Line, list[int]]] = []
    for i, line in enumerate(lines):
        if not line.level:
            continue
        both = _joined(groups[-1][0], line) if groups else None
        if both:
            groups[-1] = (both, [*groups[-1][1], i])
        else:
            groups.append((line, [i]))
    found, last = list(lines), -1
    for line, members in groups:
        first = members[0]
        if last >= 0 and first == last + 1:
            line = _continued(found[last], line, edges[first])
        for i in members:
            found[i] = line
        for i, j in pairwise([k for k in (last, *members) if k >= 0]):
            if j > i + 1:
                found[i + 1 : j] = [_pause(found[i], found[j], edges[i + 1], edges[j])] * (j - i - 1)
        last = members[-1]
    first = groups[0][1][0]
    found[:first] = [replace(found[first], level=0.0, error=np.inf)] * first
    found[last + 1 :] = [replace(found[last], level=0.0, error=np.inf)] * (len(lines) - last - 1)
    return found


def _joined(a: Line, b: Line) -> Line | None:
    """The one line that both are, from what either tells of phase (but for half turns) and omega; None when
    they differ."""
    away = b.phase - a.at(b.middle)
    away -= np.pi * round(away / np.pi)
    doubt = np.hypot(a.doubt(b.middle), b.spread)
    alike = abs(b.omega - a.omega) <= SURE * np.hypot(a.error, b.error)
    if not alike or doubt > 0.3 or abs(away) > SURE * doubt + 5 * FLOOR:
        return None
    p, q, u, v = (x**-2.0 for x in (a.spread, b.spread, a.error, b.error))
    middle = (p * a.middle + q * b.middle) / (p + q)
    far, near = b.middle - middle, a.middle - middle
    tied = p * near**2 + q * far**2 + u + v
    phase, slope = q * away / (p + q), (q * far * away + v * (b.omega - a.omega)) / tied
    return Line(a.level, middle, a.at(middle) + phase, a.omega + slope, (p + q) ** -0.5, tied**-0.5)


def _continued(before: Line, line: Line, edge: int) -> Line:
    """`line`, turned by half turns towards the phase before `edge`."""
    t = edge - 0.5
    jump = line.at(t) - before.at(t)
    half = round(jump / np.pi)
    jump -= np.pi * half
    if abs(jump) > JUMP + SURE * np.hypot(before.doubt(t), line.doubt(t)):
        found = (
            f"row {edge} (counted from 0): found a drive whose phase jumps by {jump:.2g} rad while it is on"
        )
        raise LogError(f"{found}, expected it to go on")
    return replace(line, phase=line.phase - np.pi * (half % 2))


def _pause(before: Line, after: Line, start: int, stop: int) -> Line:
    """Off from `start` to `stop`, with the frequency nearest to that before which leads to the phase
    after."""
    if after is before:
        return replace(before, level=0.0, error=np.inf)
    left = after.at(stop) - before.at(stop)
    left -= 2 * np.pi * round(left / (2 * np.pi))
    return Line(0.0, start, before.at(start), before.omega + left / (stop - start))
