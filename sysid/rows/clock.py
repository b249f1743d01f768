"""Rounded values of an even scale: rows 0.3 ms apart whose stamps are whole milliseconds, points 7.5 Hz apart
whose frequencies are whole tens."""

import numpy as np

LEAST = 20  # rows, of which the clock is told
ALIKE = 1e-6  # of the longest step, within which two are one
# digits, by which a line through the stamps may miss them: half of one, and what a line is off by at its ends
WITHIN = 0.6
# rows lost, which lie as evenly as the steps of a clock by chance once in a thousand: the next stamp is then
# twice as far
LOST = 5
# of its period, to which a scale has to be known: half of what tau is told to by a good step, and by a sweep
FIRM, FIRM_SWEEP = 2e-3, 5e-3
COARSE = 0.05  # of a step between frequencies: finer digits are nothing beside what resolves a peak


def even(time: np.ndarray, firm: float = FIRM) -> tuple[np.ndarray, float] | None:
    """The times (n,) of the even clock behind rounded stamps (n,), and the digit (s) they were rounded to;
    None where the stamps are even already, or show no such clock, or where a few rows may be lost instead.

    Rounded to a digit q, a period of (m + x) q appears as m q or (m + 1) q between stamps. A line through n
    stamps with rounding errors q/sqrt(12) gives the period to q n^(-3/2).
    """
    n = len(time)
    if n < LEAST or time[-1] <= time[0]:
        return None
    steps, often = np.unique(
        np.rint(np.diff(time) / (ALIKE * (np.max(np.diff(time)) or 1.0))), return_counts=True
    )
    if len(steps) != 2 or steps[0] < 0:
        return None
    if often[1] <= LOST and abs(steps[1] - 2 * steps[0]) <= 1:
        return None
    digit = float(np.diff(steps)[0]) * ALIKE * float(np.max(np.diff(time)))
    power = np.log10(digit)
    if abs(power - np.rint(power)) > LEAST * ALIKE:
        return None
    digit, rows = float(10.0 ** np.rint(power)), np.arange(n)
    period, first = np.polyfit(rows, time, 1)
    line = first + period * rows
    line = line + 0.5 * (np.max(time - line) + np.min(time - line))  # rounding errors may all be of one sign
    if np.max(np.abs(time - line)) > WITHIN * digit or digit > firm * period * n**1.5:
        return None
    return line, digit


def of_one_moment(time: np.ndarray, response: np.ndarray) -> bool:
    """Whether rows that share a stamp, as many at each, are readings of that moment, and no rows of a faster
    clock, whose response (n,) goes on between them as it does from stamp to stamp. What is likelier, by least
    squares; where the response hardly moves it makes no difference."""
    begins = np.flatnonzero(np.diff(time, prepend=-np.inf))
    often = np.diff(np.append(begins, len(time)))
    if len(often) < LEAST or often[0] < 2 or np.ptp(often) > 0:
        return False
    runs = response.reshape(-1, often[0])
    within, means = (runs[:, -1] - runs[:, 0])[1:-1], runs.mean(axis=1)
    course = 0.5 * (1 - 1 / often[0]) * (means[2:] - means[:-2])
    return float(np.vdot(course, within).real) < 0.5 * float(np.vdot(course, course).real)


def even_sweep(frequency: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The same of the frequencies (n,) of a sweep (Hz), of all its ways up and down; None where each point is
    there as often as any other: it was measured so often, and no step is just that part of a digit."""
    way = np.sign(np.diff(frequency))
    moves = np.flatnonzero(way)
    turns = moves[1:][np.diff(way[moves]) != 0]  # rows from which it goes back
    begins = np.where(way[turns - 1] == 0, turns, turns + 1)
    found, digits = [], []
    for part in np.split(frequency, begins):
        falls, often = part[-1] < part[0], np.diff(np.flatnonzero(np.diff(part)))
        if len(often) and often[0] > 1 and np.ptp(often) == 0:
            return None
        if (line := even(-part if falls else part, FIRM_SWEEP)) is None:
            return None
        if line[1] < COARSE * abs(line[0][1] - line[0][0]):
            return None
        found.append(-line[0] if falls else line[0])
        digits.append(line[1])
    return np.concatenate(found), max(digits)
