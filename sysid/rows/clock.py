"""Rounded time stamps of an even clock: rows 0.3 ms apart whose stamps are whole milliseconds."""

import numpy as np

LEAST = 20  # rows, of which the clock is told
ALIKE = 1e-6  # of the longest step, within which two are one
# digits, by which a line through the stamps may miss them: half of one, and what a line is off by at its ends
WITHIN = 0.6
FIRM = 2e-3  # of its period, to which the clock has to be known: half of what tau is told to by a good step


def even(time: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The times (n,) of the even clock behind rounded stamps (n,), and the digit (s) they were rounded to;
    None where the stamps are even already, or show no such clock.

    Rounded to a digit q, a period of (m + x) q appears as m q or (m + 1) q between stamps. A line through n
    stamps with rounding errors q/sqrt(12) gives the period to q n^(-3/2).
    """
    n = len(time)
    if n < LEAST or time[-1] <= time[0]:
        return None
    steps = np.unique(np.rint(np.diff(time) / (ALIKE * (np.max(np.diff(time)) or 1.0))))
    if len(steps) != 2 or steps[0] < 0:
        return None
    digit = float(np.diff(steps)[0]) * ALIKE * float(np.max(np.diff(time)))
    power = np.log10(digit)
    if abs(power - np.rint(power)) > LEAST * ALIKE:
        return None
    digit, rows = float(10.0 ** np.rint(power)), np.arange(n)
    period, first = np.polyfit(rows, time, 1)
    line = first + period * rows
    if np.max(np.abs(time - line)) > WITHIN * digit or digit > FIRM * period * n**1.5:
        return None
    return line, digit
