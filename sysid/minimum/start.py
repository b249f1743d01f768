"""From the candidates of each log to starting points for all logs together."""

from collections.abc import Sequence

import numpy as np

from sysid.minimum.guess import candidates
from sysid.minimum.search import Search
from sysid.trials.trial import LEAST_WARMING

NEARBY = 9  # random points about each log's best, twice
# logs whose points all logs try: of more, each tries its own besides, and the time goes with their number
SHARED = 24
PAIRS = 40  # pairs of logs at different temperatures, furthest apart first


def local(search: Search, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The best point (log tau, local resonance - reference, k_T = 0) of each log by itself, (logs, 3), and
    its residual sum."""
    pools = [_points(candidates(t), search.reference[0]) for t in search.trials]
    if not any(map(len, pools)):
        pools[0] = np.array([[np.log(1e-3), 0.0, 0.0]])
    best, cost = _tried(search, pools, thin=True)
    for size in (0.7, 0.15):
        nearby = np.repeat(best, NEARBY, axis=0)
        nearby[:, 0] += size * 0.7 * rng.standard_normal(len(nearby))
        nearby[:, 1] += size * rng.standard_normal(len(nearby)) / (2 * np.pi * np.exp(nearby[:, 0]))
        found, least = _tried(search, np.split(nearby, len(best)), thin=False)
        better = least < cost
        best, cost = np.where(better[:, None], found, best), np.minimum(cost, least)
    return best, cost


def _points(guessed: np.ndarray, reference: float) -> np.ndarray:
    """(n, 3) of log tau, f0 - reference and k_T = 0, from candidates (n, 2)."""
    guessed = np.reshape(guessed, (-1, 2))
    return np.column_stack(
        [np.log(guessed[:, 0]), np.nan_to_num(guessed[:, 1] - reference), np.zeros(len(guessed))]
    )


def _tried(search: Search, pools: Sequence[np.ndarray], thin: bool) -> tuple[np.ndarray, np.ndarray]:
    """The best point (logs, 3) for each log, and its residual sum (logs,). `pools`: the points (n, 3) that
    each log proposes. Each log tries its own points and those of at most SHARED logs, which help where it
    says little itself; with `thin`, only one of those that are alike."""
    proposing = [k for k, points in enumerate(pools) if len(points)]
    shared = proposing[:: -(-len(proposing) // SHARED)]
    points = np.concatenate([pools[k] for k in shared])
    points = _thinned(points) if thin else points
    found = search.sums(points)
    best, cost = points[np.argmin(found, axis=0)], found.min(axis=0)
    for k in set(proposing).difference(shared):
        own = search.of(k, pools[k])
        if np.min(own) < cost[k]:
            best[k], cost[k] = pools[k][np.argmin(own)], np.min(own)
    return best, cost


def _thinned(points: np.ndarray) -> np.ndarray:
    """One point of each cell a sixth wide in log tau and in bandwidths."""
    cells = np.column_stack(
        [points[:, 0] * 6, points[:, 1] * 6 * 2 * np.pi * np.exp(np.round(points[:, 0] * 6) / 6)]
    )
    return points[np.sort(np.unique(np.round(cells), axis=0, return_index=True)[1])]


def joint(search: Search, best: np.ndarray, cost: np.ndarray, drifts: bool) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) for all logs and their scores, best first: each log's own, and lines through pairs of
    temperatures."""
    points = [best if len(best) <= SHARED else _thinned(best)]
    temperatures = [
        search.reference[1] if t.log.temperature is None else t.log.temperature.mean() for t in search.trials
    ]
    warming = np.array(temperatures) - search.reference[1]
    if drifts:
        first, second = np.triu_indices(len(best), 1)
        apart = np.abs(warming[first] - warming[second]) > LEAST_WARMING
        first, second = first[apart], second[apart]
        keep = np.argsort(-np.abs(warming[first] - warming[second]), kind="stable")[:PAIRS]
        first, second = first[keep], second[keep]
        slope = (best[second, 1] - best[first, 1]) / (warming[second] - warming[first])
        level = best[first, 1] - slope * warming[first]
        points.append(np.column_stack([(best[first, 0] + best[second, 0]) / 2, level, slope]))
        median = np.array([np.median(best[:, 0]), np.median(best[:, 1]), 0.0])
        slopes = np.concatenate([-np.geomspace(0.03, 10, 6), np.geomspace(0.03, 10, 6)])
        slopes = slopes / (2 * np.pi * np.exp(median[0])) / max(np.ptp(warming), LEAST_WARMING)
        points.append(np.column_stack([np.tile(median[:2], (len(slopes), 1)), slopes]))
    together = np.concatenate(points)
    score = search.score(together, cost)
    order = np.argsort(score, kind="stable")
    return together[order], score[order]
