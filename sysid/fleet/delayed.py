"""Sweeps of a batch whose feedthrough may be the delay of a sensor, as `verdict.sensor_delay` has it: where a
step stands beside, the sweep gets a gain of its own, and the error of G spans both."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.fleet.batch import Batch, with_gains
from sysid.verdict.sensor_delay import Share, told


def shares(batch: Batch, k: int) -> list[Share | None]:
    """Of each plate the feedthrough of its k-th log, a sweep, over the settled response, if that is seen and
    may at least in part be a delay."""
    log, values = batch.logs[k], batch.logs[k].values(batch.step)
    form = np.zeros_like(values)
    form[:, 0] = batch.turns[k].conj() / (np.exp(batch.theta[:, 0]) * np.abs(log.block.drive))
    errors, sizes = log.error(form, batch.covariance), np.sum(form * values, axis=1)
    found = [Share(complex(size), float(e), float(e)) for size, e in zip(sizes, errors, strict=True)]
    limits = np.sqrt(batch.covariance[:, 0, 0])
    return [s if s.may_be_late(float(e)) else None for s, e in zip(found, limits, strict=True)]


def spanned(batch: Batch, names: Sequence[Sequence[str]]) -> Batch:
    """The batch, of pairs of a step and a sweep, with a gain for each sweep whose feedthrough may be a delay,
    of that size for each log that may be late; with a sentence where the error of G is that of the gain.
    `names`: of each plate's logs."""
    swept = [k for k, x in enumerate(batch.logs) if x.block.swept and not x.block.timed]
    if len(batch.logs) != 2 or len(swept) != 1:
        return batch
    late = [s if s is not None and s.all else None for s in shares(batch, swept[0])]
    if not any(late):
        return batch
    from sysid.fitting import WIDER

    size = np.array([0.0 if s is None else abs(s.size.real) * np.sqrt(len(batch.logs)) for s in late])
    again = with_gains(batch, [size if k == swept[0] else 0 * size for k in range(2)])
    before, after = (np.exp(x.theta[:, 0]) * np.sqrt(x.covariance[:, 0, 0]) for x in (batch, again))
    notes = [
        ()
        if s is None or after[p] <= WIDER * before[p]
        else (told(names[p][swept[0]], s, None, batch.tau[p]),)
        for p, s in enumerate(late)
    ]
    return replace(again, notes=tuple(notes))
