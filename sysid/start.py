"""From the candidates of each log to starting points for all logs together."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sysid.experiment import SEARCH_ROWS, Trial, freedom, group
from sysid.guess import candidates
from sysid.likelihood import details
from sysid.precision import compiled

BATCH = 64  # candidates per call: one compiled program for any number of them


@compiled
def _sums_and_gains(thetas, layouts, groups):
    def one(theta):
        return tuple((jnp.sum(jnp.abs(d.rows) ** 2, axis=-1), d.gain) for d in details(theta, layouts, groups))

    return jax.vmap(one)(thetas)


class Search:
    """Residual sums of logs that each have a gain of their own, over candidates of (tau, f0, k_T)."""

    def __init__(self, trials: Sequence[Trial], reference: tuple[float, float]):
        self.trials, self.reference = trials, reference
        groups, self.members = group(trials, reference, search=True)
        self.layouts, self.groups = tuple(g[0] for g in groups), tuple(g[1] for g in groups)
        self.freedom = np.array([min(freedom(t), 2 * SEARCH_ROWS) for t in trials])

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual sums of squares and gains, both (n, logs), at points (n, 3) of log tau, f0 - reference, k_T."""
        n = len(points)
        thetas = np.zeros((-(-n // BATCH) * BATCH, 4))
        thetas[:, 1:] = np.concatenate([points, np.repeat(points[-1:], len(thetas) - n, axis=0)])
        found = np.empty((2, len(thetas), len(self.trials)))
        for i in range(0, len(thetas), BATCH):
            parts = jax.device_get(_sums_and_gains(thetas[i : i + BATCH], self.layouts, self.groups))
            for members, part in zip(self.members, parts, strict=True):
                found[:, i : i + BATCH, members] = np.stack(part)[..., : len(members)]
        sums, gains = found[:, :n]
        return np.where(np.isfinite(sums), sums, np.inf), gains

    def sums(self, points: np.ndarray) -> np.ndarray:
        """(n, logs) residual sums of squares."""
        return self(points)[0]


def local(search: Search, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Best (log tau, local resonance - reference) of each log by itself, (logs, 3) with k_T = 0, and its residual sum."""
    pool = [candidates(t) for t in search.trials]
    points = np.concatenate([p for p in pool if len(p)]) if any(len(p) for p in pool) else np.array([[1e-3, np.nan]])
    points[:, 1] = np.nan_to_num(points[:, 1] - search.reference[0])
    points = np.column_stack([np.log(points[:, 0]), points[:, 1], np.zeros(len(points))])
    points = np.unique(np.round(points, 6), axis=0)
    found = search.sums(points)
    best, cost = points[np.argmin(found, axis=0)], found.min(axis=0)
    for size in (1.0, 0.3, 0.1):
        nearby = np.repeat(best, 12, axis=0)
        nearby[:, 0] += size * 0.7 * rng.standard_normal(len(nearby))
        nearby[:, 1] += size * rng.standard_normal(len(nearby)) / (2 * np.pi * np.exp(nearby[:, 0]))
        found = search.sums(nearby)
        better = found.min(axis=0) < cost
        best = np.where(better[:, None], nearby[np.argmin(found, axis=0)], best)
        cost = np.minimum(cost, found.min(axis=0))
    return best, cost


def joint(search: Search, best: np.ndarray, cost: np.ndarray, warming: np.ndarray, drifts: bool) -> np.ndarray:
    """Points (n, 3) for all logs together, best first: each log's own, and lines through pairs of temperatures."""
    points = [best]
    if drifts:
        first, second = np.triu_indices(len(best), 1)
        apart = np.abs(warming[first] - warming[second]) > 0.05
        first, second = first[apart], second[apart]
        if len(first) > 200:
            keep = np.argsort(-np.abs(warming[first] - warming[second]))[:200]
            first, second = first[keep], second[keep]
        slope = (best[second, 1] - best[first, 1]) / (warming[second] - warming[first])
        level = best[first, 1] - slope * warming[first]
        for tau in (first, second):
            points.append(np.column_stack([best[tau, 0], level, slope]))
        median = np.array([np.median(best[:, 0]), np.median(best[:, 1]), 0.0])
        slopes = np.concatenate([-np.geomspace(0.03, 10, 6), np.geomspace(0.03, 10, 6)])
        slopes = slopes / (2 * np.pi * np.exp(median[0])) / max(np.ptp(warming), 0.05)
        points.append(np.column_stack([np.tile(median[:2], (len(slopes), 1)), slopes]))
    points = np.concatenate(points)
    level = np.maximum(cost, 1e-300)
    score = np.sum(0.5 * search.freedom * np.log(np.maximum(search.sums(points), level) / level), axis=1)
    return points[np.argsort(score, kind="stable")]
