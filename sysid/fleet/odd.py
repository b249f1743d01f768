"""Which plates of a table are not like the others, and why, a sentence each."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from sysid.fleet.lot import ALARMS, UNITS, Judged, judged, summary
from sysid.fleet.table import texts
from sysid.model.theta import PLANT, POSITIVE
from sysid.verdict.result import Result

COMMON = 0.1  # of the plates: what more of them show is the lot's own
SAME = 1e-6  # of its error: two plates whose parameters all are as near are one reading, by any chance
FAR = 3.0  # standard deviations of a lot, from which on a parameter is named


def with_odd(frame: pd.DataFrame) -> tuple[pd.DataFrame, Judged | None]:
    """The table with the columns `odd`, `odd_why`, `odd_chance` (the probability that a plate of the lot lies
    as far out; NaN: not judged) and `group` (1; 2 of the smaller half of a lot that is two), and what is
    known of the lot.

    Odd is what does not belong to the lot, and what nothing vouches for: a plate that is not identified, or
    that shows another's readings.
    """
    found = judged(frame)
    why = [_unidentified(row) for row in frame.itertuples()]
    chance, group = np.full(len(frame), np.nan), np.ones(len(frame), int)
    for at, said in (_shown(frame) | _copied(frame)).items():
        why[at] = said
    if found is not None:
        chance[found.index] = found.chances
        if found.parted is not None:
            group[found.index] = 1 + found.parted[1].second
        for k in np.flatnonzero(found.odd):
            at = int(found.index[k])
            beside = _elsewhere(frame, at)
            why[at] = "; ".join([*_reasons(found, int(k)), *filter(None, [beside, why[at]])])
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


def _shown(frame: pd.DataFrame) -> dict[int, str]:
    """Of identified plates whose logs show what few others' do, with more evidence than chance gives in any
    plate of the whole lot: by their place in the table, a sentence."""
    good = np.flatnonzero(frame["result"] == Result.successful.value)
    held = {
        int(k): {f["key"]: f for f in frame["findings"].iloc[k] if f["outcome"] == "fitted"} for k in good
    }
    counts = Counter(key for found in held.values() for key in found)
    rare = {key for key, count in counts.items() if count <= COMMON * len(good)}
    least = np.log(len(good) / ALARMS) if len(good) else 0.0
    told: dict[int, str] = {}
    for k, found in held.items():
        for key in sorted(rare & found.keys()):
            f = found[key]
            if f["evidence"] is None or f["evidence"] > least:
                told.setdefault(k, f"{f['sentence']} (so in {counts[key]} of {len(good)} plates)")
    return told


def _copied(frame: pd.DataFrame) -> dict[int, str]:
    """Of plates whose parameters are another's to the digit: by their place in the table, a sentence."""
    good = frame[frame["result"] == Result.successful.value].sort_values("tau", kind="stable")
    names = [name for name in PLANT if f"{name}_std" in good]
    values, errors = (good[[f"{n}{end}" for n in names]].to_numpy(float) for end in ("", "_std"))
    apart = np.abs(np.diff(values, axis=0)) <= SAME * errors[1:]
    same = (apart | np.isnan(values[1:])).all(axis=1) & (np.isnan(values[1:]) == np.isnan(values[:-1])).all(
        axis=1
    )
    told, plates, at = {}, list(good["plate"]), list(good.index)
    for k in np.flatnonzero(same):
        for one, other in ((k, k + 1), (k + 1, k)):
            told[at[one]] = (
                f"its readings are those of {plates[other]}: one of the two is a copy under another name"
            )
    return told


def _elsewhere(frame: pd.DataFrame, at: int) -> str:
    """That a plate's numbers hold at a temperature at which few others' do; else nothing."""
    warm = frame["reference_temperature_degC"].to_numpy(float)
    apart = np.abs(warm - np.nanmedian(warm)) if np.isfinite(warm[at]) else np.zeros(len(warm))
    if not apart[at] or np.mean(apart >= apart[at]) > COMMON:
        return ""
    return f"at {warm[at]:.3g} degC, where the lot is at {np.nanmedian(warm):.3g} degC"


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
