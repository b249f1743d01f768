"""Which plates of a table are not like the others, and why, a sentence each."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from sysid.fleet.lot import UNITS, Judged, judged, summary
from sysid.fleet.table import texts
from sysid.model.prior import POSITIVE
from sysid.verdict.result import Result

FAR = 3.0  # standard deviations of a lot, from which on a parameter is named


def with_odd(frame: pd.DataFrame) -> tuple[pd.DataFrame, Judged | None]:
    """The table with the columns `odd`, `odd_why`, `odd_chance` (the probability that a plate of the lot lies
    as far out; NaN: not judged) and `group` (1; 2 of the smaller half of a lot that is two), and what is
    known of the lot.

    Odd is what does not belong to the lot, and what nothing vouches for: a plate that is not identified.
    """
    found = judged(frame)
    why = [_unidentified(row) for row in frame.itertuples()]
    chance, group = np.full(len(frame), np.nan), np.ones(len(frame), int)
    if found is not None:
        chance[found.index] = found.chances
        if found.parted is not None:
            group[found.index] = 1 + found.parted[1].second
        for k in np.flatnonzero(found.odd):
            why[found.index[k]] = "; ".join(_reasons(found, int(k)))
    told = pd.DataFrame(
        {"odd": [bool(said) for said in why], "odd_why": texts([said or None for said in why])}
    )
    told["odd_chance"], told["group"] = chance, group
    at = frame.columns.get_loc("plate") + 1
    whole = pd.concat([frame.iloc[:, :at], told, frame.iloc[:, at:]], axis=1)
    whole.attrs = frame.attrs | {"lot": summary(frame, found)}
    return whole, found


def _unidentified(row: Any) -> str:
    """Why a plate has no numbers to vouch for it; empty where it has."""
    if row.result == Result.successful.value:
        return ""
    said = row.error or next(iter(row.warnings), "")
    return f"{row.result}: {said}" if said else row.result


def _reasons(found: Judged, k: int) -> Iterator[str]:
    """What is far off in a plate: each parameter that is by itself, else the one that is beside the
    others."""
    single, left = found.lot.single[k], found.lot.left[k]
    far = [j for j in np.argsort(-np.abs(single)) if abs(single[j]) >= FAR]
    of = "the lot's median" if found.lot.given.shape[1] == 1 else "what the lot has there"
    for j in far:
        name, sd = found.names[j], f"{abs(single[j]):.2g} sd"
        if name in POSITIVE:
            yield f"{name} at {np.exp(left[j]):.2f} of {of}, {sd}"
        else:
            yield f"{name} {abs(left[j]):.3g} {UNITS[name]} {'above' if left[j] > 0 else 'below'} {of}, {sd}"
    if not far:
        beside = found.lot.beside[k]
        j = int(np.argmax(np.abs(beside)))
        others = " and ".join(n for i, n in enumerate(found.names) if i != j and found.lot.known[k, i])
        yield f"{found.names[j]} is {abs(beside[j]):.2g} sd from where plates of its {others} are"
