"""The noise of one log, estimated from its residual: a level, white or Ornstein-Uhlenbeck, with or without
outliers.

OU noise has correlation exp(-|t - t'|/noise_time) on any time grid: the result of a first-order low-pass on
white noise. A fit takes slow noise for signal, so its residual looks whiter than the noise is. The likelihood
of the correlation time is therefore the restricted one, in which all that the fit can adjust is integrated
out (Harville, JASA 72, 320, 1977). From its posterior, under a prior flat in log time, one time is chosen:
that of the mean error due to slow noise, which goes as the square root of its power sigma^2 (1 + rho)/(1 -
rho). The mean of the time itself would make intervals of a few hundred rows too narrow, the mean of the power
those of a few dozen too wide.

Outliers in white noise follow a Student-t distribution, with degrees of freedom chosen from a few values; the
weight of a row is the one expected under it. Outliers in coloured noise (a recorder's spikes) are rows that
their neighbours do not predict; without them the noise is an OU process on another grid. Both channels share
one noise unless separate levels are worth their cost.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from sysid.model.span import orthonormal

Design = Callable[[], np.ndarray]
WORTH = 4.0  # log-likelihood that colour must gain over white noise: less may be chance
# the same of every other kind, of which a log is tried for half a dozen: odds of a thousand to one. White
# noise in their place costs some information and leaves errors nearly what they are; in that of colour it
# makes them small
ODD = 6.9
TIMES = 24  # number of correlation times, and of scatters of stamps, that are tried
# of the longest step between rows: closer ones are alike, as stamps of a steady clock have few digits
ALIKE_STEPS = 1e-6
FEW_STEPS = 8  # different steps between rows: those of a steady clock with outliers left out
MOST_APART = 100.0  # largest ratio of the channels' noise: a channel without any noise is not a quiet one
SHARE = 0.25  # largest share of the rows that may be outliers
MEDIAN = {1: 0.455, 2: 1.386}  # of chi-square, by its degrees of freedom
SURE = 12.0  # of chi-square: rows above are outliers at first; of two channels, one normal row in 400
ALIKE = 1e-4  # of a unit column: what is left of one that is nearly a sum of others
ROUNDING = 1e-13  # relative rounding error of a sum of squares, which could otherwise leave less than nothing
SHARES = np.append(
    0.0, 1 / (1 + np.geomspace(3.0, 1e-3, 16) ** 2)
)  # of the noise, proportional to the response, to be tried
ALONE = 3.0  # standard deviations of a lag-one correlation, from which neighbours share noise
TAILS = np.array([1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0])  # tried degrees of freedom


class Level(NamedTuple):
    """The noise of one channel: its standard deviation and its correlation time (0: white)."""

    std: float
    time: float


def estimate(
    residual: np.ndarray,
    clock: np.ndarray,
    freedom: float,
    design: Design | None = None,
    time: float | None = None,
    worth: float = WORTH,
) -> tuple[float, float]:
    """Standard deviation per channel and correlation time (0: white) of a residual (n,), real or complex.

    `design()` (n, K): what the fit can adjust, with coefficients of the residual's own kind; called only if
    needed. `time`: the correlation time, where it is known. `worth`: the log-likelihood that colour must
    gain.
    """
    if time is None:
        std, time, _ = _fitted(residual, clock, freedom, design, worth)
        return std, time
    return float(np.sqrt(power_of(independent(residual, clock, time)) / freedom)), time


def log_likelihood(residual: np.ndarray, clock: np.ndarray, freedom: float) -> float:
    """Log-likelihood of a residual at its best level and correlation time, up to a constant of `clock` and
    `freedom`."""
    std, _, gained = _fitted(residual, clock, freedom, None)
    return float(gained - freedom * np.log(max(std, 1e-300)))


def _fitted(
    residual: np.ndarray, clock: np.ndarray, freedom: float, design: Design | None, worth: float = WORTH
) -> tuple[float, float, float]:
    """Level, correlation time, and what the determinant of its correlation adds to the log-likelihood."""
    channels = 2 if np.iscomplexobj(residual) else 1
    steps = np.diff(clock)
    power = float(np.sum(np.abs(residual) ** 2))
    white = float(np.sqrt(power / freedom))
    if power == 0 or len(residual) < 8 or not np.any(steps > 0):
        return white, 0.0, 0.0
    typical = np.median(steps[steps > 0])
    times = np.geomspace(0.2 * typical, max(0.3 * (clock[-1] - clock[0]), typical), TIMES)
    left, shrunk = _grams(residual[None], steps, times)
    shrunk = 0.5 * channels * shrunk
    cost = shrunk + 0.5 * channels * len(residual) * np.log(left[:, 0, 0].real / power)
    if np.min(cost) > -worth:
        return white, 0.0, 0.0
    if design is not None:
        made = design()
        basis = orthonormal(made if channels == 2 else made.real, ALIKE)
        cost = _restricted(residual, basis, steps, times, channels) + shrunk
    share = np.exp(np.min(cost) - cost)
    gap, shrink = forgotten(typical, times)
    error = np.maximum.accumulate(
        np.sqrt(left[:, 0, 0].real * shrink) / gap
    )  # of slow noise, but for a factor
    time = np.exp(np.interp([np.log(share @ error / np.sum(share))], np.log(error), np.log(times)))
    left, shrunk = _grams(residual[None], steps, time)
    return float(np.sqrt(left[0, 0, 0].real / freedom)), float(time[0]), -0.5 * channels * float(shrunk[0])


def _restricted(
    residual: np.ndarray, basis: np.ndarray, steps: np.ndarray, times: np.ndarray, channels: int
) -> np.ndarray:
    """(T,) minus the restricted log-likelihood, its level integrated out, less the determinant of the
    correlation; `basis` (n, K) of what the fit can make.

    Of the Gram matrix of whitened basis and residual the Cholesky factor's diagonal holds the determinant of
    the basis' own and, last, the norm of what the basis leaves of the residual.
    """
    n, K = basis.shape
    grams, _ = _grams(np.concatenate([basis.T, residual[None] / np.linalg.norm(residual)]), steps, times)
    factors = np.linalg.cholesky(grams * (1 + ROUNDING * np.eye(K + 1)))
    diagonal = np.log(np.diagonal(factors, axis1=1, axis2=2).real)
    return channels * (np.sum(diagonal[:, :K], axis=1) + (n - K) * diagonal[:, K])


def _grams(rows: np.ndarray, steps: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, C, C) Gram matrices of rows (C, n) whitened with each correlation time, and (T,) sums of the log
    variances left in the rows.

    With x = a + d, a row after the one before it, and g = 1 - rho, whitening leaves (d + g a)/sqrt(1 -
    rho^2). If there are few different steps between rows, the sums of d d^H, d a^H and a a^H over each serve
    all times.
    """
    kinds, which = np.unique(np.rint(steps / (ALIKE_STEPS * np.max(steps))), return_inverse=True)
    if len(kinds) > FEW_STEPS:
        found = [_whitened(rows, steps, time) for time in times]
        return np.stack([w @ w.conj().T for w, _ in found]), np.array(
            [np.sum(np.log(shrink)) for _, shrink in found]
        )
    groups = [slice(None)] if len(kinds) == 1 else [np.flatnonzero(which == k) for k in range(len(kinds))]
    before, change = rows[:, :-1], np.diff(rows, axis=1)
    sums = []
    for group in groups:
        a, d = before[:, group], change[:, group]
        across = d @ a.conj().T
        sums.append((d @ d.conj().T, across + across.conj().T, a @ a.conj().T))
    moments = np.array(sums)  # (S, 3, C, C)
    gap, shrink = forgotten(np.array([np.mean(steps[group]) for group in groups]), times[:, None])
    parts = np.stack([1 / shrink, gap / shrink, gap**2 / shrink], axis=-1)
    first = rows[:, :1] @ rows[:, :1].conj().T
    return first + np.tensordot(parts, moments, 2), np.log(shrink) @ np.bincount(which)


def forgotten(steps: np.ndarray, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1 - rho, at least 1e-9, and 1 - rho^2, of the correlation rho that rows so many steps apart have."""
    gap = np.maximum(-np.expm1(-steps / time), 1e-9)
    return gap, gap * (2 - gap)


def power_of(v: np.ndarray) -> np.ndarray:
    """Sum of squares along the rows (..., n)."""
    return np.sum(v.real**2 + v.imag**2, axis=-1)


def independent(residual: np.ndarray, clock: np.ndarray, time: float) -> np.ndarray:
    """The residual with the part that each row shares with the one before removed."""
    return _whitened(residual, np.diff(clock), time)[0] if time > 0 else residual


def _whitened(values: np.ndarray, steps: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows (..., n) less what each shares with the row before, of unit variance; and the variance (n - 1,)
    left of each."""
    gap, shrink = forgotten(steps, time)
    new = (values[..., 1:] - (1 - gap) * values[..., :-1]) / np.sqrt(shrink)
    first = np.broadcast_to(values[..., :1], (*new.shape[:-1], 1))
    return np.concatenate([first, new], axis=-1), shrink


def tails(residual: np.ndarray) -> tuple[np.ndarray, float]:
    """Weight (n,) of each row of a white residual, real or complex, and the information per row relative to
    normal noise of the same level; all 1 where the noise is normal.

    Student-t of nu degrees of freedom in d channels, by its EM: w = (nu + d)/(nu + |u|^2), u = residual/level
    (Lange, Little & Taylor, JASA 84, 881, 1989), expanded to converge in few steps (Kent, Tyler & Vardi,
    Commun. Stat. 23, 441, 1994). The noise need not be Student-t: the information on a location is A^2/B with
    psi = w u, A = E psi' and B = E psi^2 (Huber, Robust Statistics, 1981).
    """
    channels, square = 2 if np.iscomplexobj(residual) else 1, np.abs(residual) ** 2
    _, weight, nu = _likeliest(square, channels)
    if nu is None:
        return weight, 1.0
    u = weight * square / np.mean(weight * square) * channels  # w |u|^2
    slope = np.mean(weight) - 2 * np.mean(weight * u) / (channels * (nu + channels))
    return weight, float(min(slope**2 / (np.mean(weight * u) / channels * np.mean(weight)), 1.0))


def _likeliest(square: np.ndarray, channels: int) -> tuple[float, np.ndarray, float | None]:
    """Minus the log-likelihood of rows of given squares (n,), their weights, and the degrees of freedom;
    None: normal."""
    n = len(square)
    normal = 0.5 * n * channels * (np.log(max(np.mean(square) / channels, 1e-300)) + 1)
    if n < 20 or not np.any(square):
        return normal, np.ones(n), None
    # Of rows so many of which are exactly zero, as where a recorder repeats one value, a Student-t
    # distribution has no level (Kent & Tyler, Ann. Stat. 19, 2102, 1991).
    exact = np.mean(square <= ROUNDING * np.mean(square))
    nu = TAILS[TAILS / (TAILS + channels) > exact]
    if not len(nu):
        return normal, np.ones(n), None
    costs, weights = _student(square, nu[:, None], channels)
    best = int(np.argmin(costs))
    if costs[best] > normal - ODD:
        return normal, np.ones(n), None
    return costs[best], weights[best], float(nu[best])


def apart(residual: np.ndarray, weight: np.ndarray) -> float:
    """Ratio of q's noise to d's in a white complex residual (n,); 1.0 where that is not worth a number of its
    own.

    `weight` (n,): from `tails`. With outliers both levels belong to one elliptical Student-t distribution.
    """
    d, q = residual.real**2, residual.imag**2
    if len(residual) < 20 or not (np.any(d) and np.any(q)):
        return 1.0
    gained = len(d) * np.log((np.mean(d) + np.mean(q)) / (2 * np.sqrt(np.mean(d) * np.mean(q))))
    if gained < ODD and np.all(weight == 1):
        return 1.0
    alike, ratio = _likeliest(d + q, 2)[0], 1.0
    for _ in range(20):
        ratio, before = float(np.sqrt(np.sum(weight * q) / np.sum(weight * d))), ratio
        cost, weight, _ = _likeliest(d + q / ratio**2, 2)
        if abs(ratio / before - 1) < 1e-3:
            break
    worth = alike - cost - len(d) * np.log(ratio) > ODD
    return ratio if worth and 1 / MOST_APART < ratio < MOST_APART else 1.0


def apart_in_colour(residual: np.ndarray, clock: np.ndarray) -> float:
    """`apart` for coloured noise, whose channels may differ in level and in correlation time: two numbers of
    their own."""
    n, channels = float(len(residual)), (residual.real, residual.imag)
    if len(residual) < 20 or not all(np.any(v) for v in channels):
        return 1.0
    (d, _, gained_d), (q, _, gained_q) = (_fitted(v, clock, n, None) for v in channels)
    gained = gained_d + gained_q - n * float(np.log(max(d, 1e-300)) + np.log(max(q, 1e-300)))
    worth = gained - log_likelihood(residual, clock, 2 * n) > WORTH + 1
    return q / d if worth and 1 / MOST_APART < q / d < MOST_APART else 1.0


def goes_with(residual: np.ndarray, size: np.ndarray) -> float:
    """The log-likelihood by which noise that is proportional to the response's `size` (n,) is likelier than
    one that is alike in all rows."""
    even, own = (0.5 * len(size) * np.log(np.mean(x**2)) for x in (residual, residual / size))
    return float(even - own - np.sum(np.log(size)))


def proportional(
    residual: np.ndarray, size: np.ndarray, least: np.ndarray, known: bool, usual: float = 0.0
) -> float:
    """Share of the noise's variance, at the largest response, that is proportional to the response. The noise
    is `least` (n,) times one level and `size` (n,), the response over its largest, times another; the share
    is the likeliest of SHARES. It is the `usual` one of them, unless the noise is `known` to be proportional,
    where a level of its own is not worth its cost beside outliers, or where neighbours share what is left, as
    they do for a wrong model at a peak."""
    n, channels = len(residual), 2 if np.iscomplexobj(residual) else 1
    square = np.abs(residual) ** 2
    if n < 20 or not np.any(square):
        return SHARES[-1] if known else usual
    spread = np.sqrt((1 - SHARES[:, None]) * least**2 + SHARES[:, None] * size**2)
    cost = channels * (0.5 * n * np.log(np.mean(square / spread**2, axis=1)) + np.sum(np.log(spread), axis=1))
    best = int(np.argmin(cost))
    if known:
        return float(SHARES[best])
    without = int(np.searchsorted(SHARES, usual))
    if cost[without] - cost[best] < ODD:
        return usual
    robust = [
        _likeliest(square / spread[k] ** 2, channels)[0] + channels * np.sum(np.log(spread[k]))
        for k in (without, best)
    ]
    left = residual / spread[best]
    shared = np.sum((left[1:] * left[:-1].conj()).real) / np.sum(np.abs(left) ** 2) * np.sqrt(n * channels)
    return float(SHARES[best]) if robust[0] - robust[1] > ODD and shared < ALONE else usual


def scatter_of_stamps(residual: np.ndarray, rate: np.ndarray, longest: float) -> float:
    """Standard deviation (s) of scattering time stamps, over the level of the white noise beside it. 0.0
    where that is not worth a number of its own beside outliers, or where neighbours share what is left, as
    they do for a wrong model.

    A row read t late, while the response moves at `rate` (n,), complex, is off by t rate: along the rate, not
    across it. Scatters up to `longest` (s) are tried.
    """
    n, speed = len(residual), np.abs(rate)
    along = (residual * np.exp(-1j * np.angle(rate))).real
    level = float(np.sqrt(np.median(along**2) / MEDIAN[1])) if n >= 20 else 0.0
    if level == 0 or not np.any(speed):
        return 0.0
    least = 0.3 / np.max(speed)  # over the level, as it is tried
    tried = np.append(0.0, np.geomspace(least, max(longest / level, 2 * least), TIMES))
    spread = np.sqrt(1 + (tried[:, None] * speed) ** 2)
    cost = 0.5 * n * np.log(np.mean((along / spread) ** 2, axis=1)) + np.sum(np.log(spread), axis=1)
    best = int(np.argmin(cost))
    if cost[0] - cost[best] < ODD:
        return 0.0
    robust = [_likeliest((along / spread[k]) ** 2, 1)[0] + np.sum(np.log(spread[k])) for k in (0, best)]
    moved = (along / spread[best])[tried[best] * speed > 1]
    shared = np.sum(moved[1:] * moved[:-1]) / max(np.sum(moved**2), 1e-300) * np.sqrt(len(moved))
    return float(tried[best]) if robust[0] - robust[1] > ODD and shared < ALONE else 0.0


def spikes(residual: np.ndarray, clock: np.ndarray) -> np.ndarray | None:
    """(n,) which rows of coloured noise are regular; None where there are no outliers, or the noise is white
    without them.

    The noise is an OU process; a share of the rows has an additional normal deviation of another size. Rows
    are assigned to the likelier of the two, given their neighbours, in turn with time, levels and share
    (classification EM; Celeux & Govaert, Comput. Stat. Data Anal. 14, 315, 1992).
    """
    n, channels = len(residual), 2 if np.iscomplexobj(residual) else 1
    square = np.abs(residual) ** 2
    if n < 40 or not np.any(square):
        return None
    kept, gain = square < SURE * np.median(square) / MEDIAN[channels], -np.inf
    for _ in range(20):
        if np.mean(kept) < 1 - SHARE:
            return None
        std, time, gained = _fitted(residual[kept], clock[kept], channels * float(np.sum(kept)), None)
        if time == 0:
            return None
        away, variance = _surprise(residual, clock, kept, time)
        share = max(1 - float(np.mean(kept)), 1 / n)
        spread = np.mean(away[~kept]) / channels if not np.all(kept) else 100 * std**2
        inside = (
            np.log1p(-share) - 0.5 * away / (std**2 * variance) - 0.5 * channels * np.log(std**2 * variance)
        )
        outside = np.log(share) - 0.5 * away / spread - 0.5 * channels * np.log(spread)
        regular = float(np.sum(kept)) * (np.log1p(-share) - 0.5 * channels - channels * np.log(std)) + gained
        gain, before, kept = regular + float(np.sum(outside[~kept])), kept, inside >= outside
        if np.all(kept == before):
            break
    std, _, gained = _fitted(residual, clock, channels * n, None)
    plain = gained - channels * n * (np.log(std) + 0.5)
    return (
        before if gain - plain > WORTH + 1 and _lone(~before) else None
    )  # one more number than colour or tails


def _lone(outlier: np.ndarray) -> bool:
    """Whether there are outliers, not nearly all with others beside them: a crowd is what a wrong model
    leaves at a peak."""
    beside = np.append(outlier[1:], False) | np.append(False, outlier[:-1])
    return bool(np.any(outlier) and np.mean(beside[outlier]) < 0.7)


def _surprise(
    residual: np.ndarray, clock: np.ndarray, kept: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Square of what the nearest rows that are kept, on both sides, leave of each row; and its variance, of a
    process of 1."""
    rows, before = np.flatnonzero(kept), np.cumsum(kept) - kept
    precision, mean = np.ones(len(residual)), np.zeros_like(residual)
    for at in (before - 1, before + kept):
        there = (at >= 0) & (at < len(rows))
        row = rows[np.clip(at, 0, len(rows) - 1)]
        rho = np.where(there, np.minimum(np.exp(-np.abs(clock - clock[row]) / time), 1 - 1e-9), 0.0)
        precision = precision + rho**2 / (1 - rho**2)
        mean = mean + rho / (1 - rho**2) * residual[row]
    return np.abs(residual - mean / precision) ** 2, 1 / precision


def _student(square: np.ndarray, nu: np.ndarray, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Minus the log-likelihood (T,) at the best level, and the weights (T, n) there, for degrees of freedom
    `nu` (T, 1)."""
    level = np.full(nu.shape, np.median(square) / channels + 1e-300)
    for _ in range(50):
        weight = (nu + channels) / (nu + square / level)
        expanded = np.sum(weight * square, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
        level, before = expanded / channels, level
        if np.all(np.abs(level / before - 1) < 1e-6):
            break
    norm = gammaln(0.5 * (nu + channels)) - gammaln(0.5 * nu) + 0.5 * channels * np.log(2 / nu)
    cost = 0.5 * (nu + channels) * np.log1p(square / (nu * level)) + 0.5 * channels * np.log(level) - norm
    return np.sum(cost, axis=1), weight
