"""The noise of one log, from its residual: a level, and white or coloured by an Ornstein-Uhlenbeck process.

OU noise has correlation exp(-|t - t'| / noise_time), on any time grid: what a first-order low-pass makes of white noise.
"""

import numpy as np
from scipy.optimize import minimize_scalar

WORTH = 4.0  # log-likelihood that colour must gain over white noise: less is within the chance of one more parameter


def estimate(residual: np.ndarray, clock: np.ndarray, freedom: float) -> tuple[float, float]:
    """Standard deviation per channel and correlation time (0: white) of a residual (n,), real or complex."""
    std, time, _ = _fitted(residual, clock, freedom)
    return std, time


def log_likelihood(residual: np.ndarray, clock: np.ndarray, freedom: float) -> float:
    """Log-likelihood of a residual at its best level and correlation time, up to a constant of `clock` and `freedom`."""
    std, _, gained = _fitted(residual, clock, freedom)
    return float(gained - freedom * np.log(max(std, 1e-300)))


def _fitted(residual: np.ndarray, clock: np.ndarray, freedom: float) -> tuple[float, float, float]:
    """Level, correlation time, and what the determinant of its correlation adds to the log-likelihood."""
    channels = 2 if np.iscomplexobj(residual) else 1
    steps = np.diff(clock)
    power = float(np.sum(np.abs(residual) ** 2))
    white = float(np.sqrt(power / freedom))
    if power == 0 or len(residual) < 8 or not np.any(steps > 0):
        return white, 0.0, 0.0

    def cost(log_time: float) -> float:
        innovations, shrink = innovate(residual, steps, np.exp(log_time))
        return 0.5 * channels * (len(residual) * np.log(innovations / power) + np.sum(np.log(shrink)))

    typical = np.median(steps[steps > 0])
    grid = np.log(np.geomspace(0.2 * typical, max(0.3 * (clock[-1] - clock[0]), typical), 16))
    costs = [cost(t) for t in grid]
    best = int(np.argmin(costs))
    if costs[best] > -WORTH:
        return white, 0.0, 0.0
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    time = float(np.exp(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x))
    innovations, shrink = innovate(residual, steps, time)
    return float(np.sqrt(innovations / freedom)), time, -0.5 * channels * float(np.sum(np.log(shrink)))


def innovate(residual: np.ndarray, steps: np.ndarray, time: float) -> tuple[float, np.ndarray]:
    """Sum of squares of the whitened residual, and the variance (relative) that each row has given the one before."""
    rho = np.minimum(np.exp(-steps / time), 1 - 1e-9)
    shrink = 1 - rho**2
    new = residual[1:] - rho * residual[:-1]
    return float(np.abs(residual[0]) ** 2 + np.sum(np.abs(new) ** 2 / shrink)), shrink
