"""Two logs of each plate of a batch that differ by more than their errors: what that adds to the covariance,
as `verdict.differing` has it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaincc

from sysid.fleet.batch import Batch, Reduced, both, narrow, sized, solved
from sysid.fleet.near import FREE
from sysid.fleet.screen import cancelling
from sysid.verdict.differing import ALARM, CHANCE, COMPARED, TOLD, Differ, Said, sentence


def dispersion(batch: Batch, names: Sequence[Sequence[str]]) -> tuple[np.ndarray, list[list[Said]]]:
    """(P, 3, 3) added to the covariance of each plate, and what is said of it; `names`: of its logs."""
    added, said = np.zeros_like(batch.covariance), [list[Said]() for _ in batch.theta]
    if len(batch.logs) != 2:
        return added, said
    grams = np.stack([x.information for x in batch.logs])
    inverse = solved(grams.sum(axis=0))
    for k, name in enumerate(FREE):
        logs = [_alone(batch, i) for i in range(2)] if name == "G" else batch.logs
        off, error, std, rare = _differing(logs, k)
        if name == "G":
            off, error, std = _in_full(batch, off, error, std)
        some = (rare > CHANCE) & (std > 0)
        moves = np.stack([inverse @ gram[:, :, k, None] for gram in grams])[:, :, :, 0]
        added += np.where(some, std**2, 0.0)[:, None, None] * np.einsum("lpi,lpj->pij", moves, moves)
        for p in np.flatnonzero(some).tolist():
            found = Differ((0, 1), off[p], error[p], float(std[p]), float(rare[p]))
            said[p].append(Said(name, sentence(name, found, names[p]), bool(rare[p] > ALARM)))
    return added, said


def _alone(batch: Batch, i: int) -> Reduced:
    """The i-th log with what makes up for a gain as small as it looks."""
    log, turn = batch.logs[i], batch.turns[i]
    if log.block.swept:
        return log
    values = log.values(batch.step)
    _, left, error, rise = both(log, batch.theta, turn, values, batch.covariance)
    size, rest = sized(left, error), np.zeros_like(values)
    rest[:, 0] = rest[:, 2] = 1
    ring = sized(values[:, 0] + values[:, 2], log.error(rest, batch.covariance))
    ring = np.where(log.block.rest < batch.tau, ring, np.inf)
    sizes = {"feedthrough": size, "late": size / rise, "offset": ring, "start": ring}
    return Reduced.of(batch.seen[i], log.std, narrow(log, sizes), log.gain)


def _differing(logs: Sequence[Reduced], k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the k-th parameter: by how much each log is off the other, (P, 2), with its error; the size (P,) of
    what each has for itself; and one over the chance of as much."""
    grams, slopes = np.stack([x.information for x in logs]), np.stack([x.slope for x in logs])
    inverse = solved(grams.sum(axis=0))
    cross = np.moveaxis(grams[:, :, :, k], 0, 2)  # (P, 3, 2)
    own = cross[:, k]
    back = cross.swapaxes(1, 2) @ inverse
    score = slopes[:, :, k].T - (back @ slopes.sum(axis=0)[:, :, None])[:, :, 0]
    left = own[:, :, None] * np.eye(2) - back @ cross
    size = np.sqrt(np.maximum(own, 1e-300))
    values, vectors = np.linalg.eigh(left / size[:, :, None] / size[:, None])
    told = values > COMPARED
    along = (vectors.swapaxes(1, 2) @ (score / size)[:, :, None])[:, :, 0]
    square = np.sum(np.where(told, along**2 / np.where(told, values, 1.0), 0.0), axis=1)
    rank, total = told.sum(axis=1), np.einsum("pll->p", left)
    held = np.all(own > TOLD * np.max(own, axis=1, keepdims=True), axis=1) & (rank > 0) & (total > 0)
    std = np.where(held, np.sqrt(np.maximum(square - rank, 0.0) / np.maximum(total, 1e-300)), 0.0)
    rare = 1 / np.maximum(gammaincc(0.5 * np.maximum(rank, 1), 0.5 * square), 1e-300)
    diagonal = np.maximum(np.einsum("pll->pl", left), TOLD * own)
    return score / diagonal, 1 / np.sqrt(diagonal), std, np.where(held, rare, 1.0)


def _in_full(
    batch: Batch, off: np.ndarray, error: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains that differ, in the size of a feedthrough and a lateness that cancel (`differing._in_full`)."""
    for i, (log, turn) in enumerate(zip(batch.logs, batch.turns, strict=True)):
        if log.block.swept:
            continue
        gain = cancelling(batch, log, turn)[0] - 1
        full = (gain != 0) & (np.abs(gain) >= np.sqrt(2) * std)
        off = np.where(full[:, None], gain[:, None] * (np.arange(2) == i), off)
        error, std = np.where(full[:, None], 1.0, error), np.where(full, np.abs(gain) / np.sqrt(2), std)
    return off, error, std


def widened(batch: Batch, added: np.ndarray) -> Batch:
    """The batch with what logs that differ add to its covariance."""
    return replace(batch, covariance=batch.covariance + added)
