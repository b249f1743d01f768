"""Steps of a recorder, an ADC or a text with few decimals, where the noise is too small to blur them.

A channel in steps of q shows x + n as the nearest whole multiple. With noise n of standard deviation s, the
error has the variance q^2/12 beside that of n, averaged over the position of x between two steps. The part

    b^2 = q^2/(2 pi^2) sum_m exp(-(2 pi m s/q)^2)/m^2

of it is a function of x alone (Widrow & Kollar, Quantization Noise, Cambridge 2008, ch. 19): with noise of
half a step it vanishes, without noise it is all there is. Rows of the same x share it, however many there
are: a plateau is off by up to half a step, and averaging does not help. The correlation of the error falls as
1 - 6 d + ... with the distance d of two x in steps, so its range is a sixth of a step.

A row that shares its rounding error with r - 1 others is therefore given r - 1 times that variance in
addition. No sum of rows then has too little variance: a diagonal matrix of the row sums of a covariance
without negative entries is no smaller than it (Gershgorin).
"""

import numpy as np

ALIKE = 1 / 6  # of a step, within which rows have one rounding error
DIGITS = 9  # of the largest value, of which steps are looked for; the last two of them are steps of these
ROWS = 100_000  # of a log, at most, in which steps are looked for
REPEATED = 0.9  # distinct values over rows, above which rows hardly ever read the same, and share nothing
OFF = 0.1  # of a step, by which a level may be off: printed with few digits, levels are
NEXT = 1.5  # of the least gap between two values, below which another is of one step as well
# steps from a value to the next, above which an error of the step hides whether they are whole ones
NEAR = 10
FEW = 6  # of these, which are whole steps by chance in one of 3000 logs
TERMS = np.arange(1, 33)
LITTLE = 0.05  # of the rows' information, which is not worth a model of how they share their errors


def steps(response: np.ndarray) -> tuple[float, ...]:
    """The steps in which the d and q of a response (n,), or its only channel, are recorded; 0.0 where none
    show. A channel that hardly moves is taken to have the steps of the other; where neither shows more than
    two values, the step is from one to the other."""
    rows = response[:: len(response) // ROWS + 1]
    channels = (rows.real, rows.imag) if np.iscomplexobj(rows) else (rows,)
    found = [_step(v) for v in channels]
    seen = [s for s in found if s]
    if not seen and all(s is None for s in found):
        seen = [float(np.ptp(v)) for v in channels if 1 < len(np.unique(v)) <= REPEATED * len(v)]
    return tuple(float(seen[0] if s is None and seen else s or 0.0) for s in found)


def _step(values: np.ndarray) -> float | None:
    """The step of one channel; 0.0 where none shows, None where the values are too few to tell."""
    scale = float(np.max(np.abs(values))) or 1.0
    distinct = np.unique(np.round(values / scale, DIGITS))  # beyond which texts and units round
    if len(distinct) < 3:
        return None
    if len(distinct) > REPEATED * len(values):
        return 0.0
    gaps = np.diff(distinct)
    step = np.mean(gaps[gaps < NEXT * np.min(gaps)])
    for _ in range(2):
        near = gaps[gaps < (NEAR + 0.5) * step]
        step = np.sum(near) / np.sum(np.rint(near / step))
    whole = len(near) >= min(FEW, len(gaps)) and np.all(np.abs(near / step - np.rint(near / step)) < OFF)
    return float(step * scale) if whole and step > 100 * 10.0**-DIGITS else 0.0


def shared(variance: float) -> float:
    """Share of the variance (steps squared) of a row's noise, rounding included, that rows of one value have
    in common."""
    blur = max(variance - 1 / 12, 0.0)
    part = np.sum(np.exp(-((2 * np.pi * TERMS) ** 2) * blur) / TERMS**2) / (2 * np.pi**2)
    return float(min(part / max(variance, 1 / 12), 1.0))


def spread(model: np.ndarray, step: float, std: float, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each modelled row (n,) of a channel, the mean of `count` rows with noise `std`: its noise relative
    to the mean of independent rows, as it shares the rounding error of all rows of its value; and the
    fraction of it that is its own (0 to 1)."""
    if not step:
        return np.ones(len(model)), np.ones(len(model))
    order = np.argsort(model)
    level, rows = model[order], np.append(0.0, np.cumsum(count[order]))
    begin, end = (np.searchsorted(level, model + side * ALIKE * step) for side in (-1, 1))
    part = shared((std / step) ** 2)
    square, within = (
        1 + part * np.maximum(rows[end] - rows[begin] - 1, 0.0),
        1 + part * np.maximum(count - 1, 0.0),
    )
    return np.sqrt(square), np.minimum(within / square, 1.0)


def least(step: float) -> float:
    """The least noise that rounding to a step makes."""
    return step / np.sqrt(12)
