"""A trial over all rows of its file, of which a long log's are means over several."""

from dataclasses import replace

import numpy as np

from sysid.rows.prepare import prepare
from sysid.trials.trial import Trial, as_stated
from sysid.trials.whitening import joined


def uncondensed(trial: Trial) -> Trial:
    """The trial over all rows of the file, with the same noise but without the weights of single rows.
    The spread of each row's noise, and its share of rounding errors, are interpolated from the means
    about it: a single row, with its own noise, shows neither."""
    if trial.whole is None:
        return trial
    read = prepare(trial.whole, trial.kind, len(trial.whole))
    rows = (
        1.0 if read.log.time is not None else len(read.log) / len(trial.log)
    )  # times are in rows where none is recorded
    noise = trial.noise.of_rows(read.log, read.count, read.there, rows, as_stated(read.log, trial.whole))
    swept = trial.steady and trial.resonant
    now, at = (trial.log.frequency, read.log.frequency) if swept else (trial.noise.clock, noise.clock)
    order = np.argsort(now, kind="stable")

    def over(x: np.ndarray | None) -> np.ndarray | None:
        return None if x is None else np.interp(at, now[order], x[order])

    spread, under, alongside = over(trial.noise.spread), over(trial.bench.under), over(trial.bench.alongside)
    noise = replace(noise, spread=spread)
    rounded = [
        np.interp(at, now[order], p.rounded[order]) for p in trial.noise.parts if p.rounded is not None
    ]
    if rounded:
        noise = replace(noise, rounded=joined(rounded), own=joined([x**-2.0 for x in rounded]))
    new = trial.with_bench(extra={}, under=under, alongside=alongside, fed=0.0)
    return replace(new, log=read.log, inputs=read.inputs, noise=noise, there=read.there, whole=None)
