"""Plates that were fitted together as rows of the table: what a batch has as arrays is told of all of its
plates at once."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sysid.fleet.batch import Batch
from sysid.fleet.cells import Cells
from sysid.fleet.groups import Group
from sysid.fleet.near import FREE
from sysid.fleet.plate import BY_BATCH, TRACED, Row, blank, stated, traces
from sysid.fleet.screen import Screened
from sysid.fleet.settings import Settings
from sysid.verdict.differing import Said
from sysid.verdict.result import NORMAL95

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.verdict.finding import Assumed, Finding

NUMBERS = ("value", "std", "ci95_low", "ci95_high")
UNITS = {"tau": "s", "f0": "Hz"}  # that of G is the logs'


def told(
    batch: Batch,
    good: Sequence[int],
    plates: "Sequence[tuple[Group, list[Log]]]",
    lefts: Sequence[np.ndarray],
    said: Sequence[Sequence[Said]],
    seen: Screened,
    cells: Cells,
    settings: Settings,
) -> list[Row]:
    """The rows of those of a batch's plates that are `good`; `lefts` (P, n): what is left of each log,
    `said`: of logs that differ, `seen`: by the screen."""
    if not len(good):
        return []
    numbers, covariances = _parameters(batch.theta[good], batch.covariance[good])
    responses = [log.block.response[good] for log in batch.logs]
    parts = [left[good] for left in lefts]
    percents = np.max([_percent(y, left) for y, left in zip(responses, parts, strict=True)], axis=0)
    first = plates[0][1]
    drawn = [
        traces(log, log.kind or "", y, y - left) for log, y, left in zip(first, responses, parts, strict=True)
    ]
    rows = []
    for k, p in enumerate(good):
        group, logs = plates[p]
        at = _temperature(logs)
        units = {"G": f"{logs[0].response_unit}/{logs[0].drive_unit}", **UNITS}
        sentences = _sentences(batch, p, said[p], seen, logs, cells.logs)
        rows.append(
            blank(group, settings, BY_BATCH, read=logs)
            | {
                "result": "successful",
                "parameters": {
                    **{name: _known(n, units[name]) for name, n in zip(FREE, numbers[k], strict=True)},
                    "k_T": _unknown(cells.why("k_T", at)),
                },
                "names": list(FREE),
                "covariance": covariances[k],
                "reference_temperature_degC": at,
                "nrmse_percent": float(percents[k]),
                **sentences,
                "traces": [
                    {"name": log.name, **each[k]}
                    for log, each in zip(logs[:TRACED], drawn[:TRACED], strict=True)
                ],
                "stated": stated(logs),
            }
        )
    return rows


def _sentences(
    batch: Batch,
    p: int,
    said: Sequence[Said],
    seen: Screened,
    logs: "Sequence[Log]",
    first: "Sequence[Log]",
) -> Row:
    """What is warned of, found and noted of the p-th plate, by the names of its logs instead of those of the
    `first` plate."""
    alarms, notes = ([x.told(True) for x in said if x.rare is which] for which in (True, False))
    late = _late(float(np.sqrt(batch.covariance[p, 0, 0]))) if batch.hung[0, p] else []
    hint, doubt = seen.said[p], seen.doubts[p]
    spanned = [] if hint is None else [_named(hint, logs, first)]
    same = hint is not None and doubt is not None and (hint.key, hint.logs) == (doubt.key, doubt.logs)
    doubts = [] if doubt is None or same else [_named(doubt, logs, first)]
    hinted, findings = [f["sentence"] for f in spanned], [*doubts, *late, *spanned]
    assumed = _assumed(seen.assumed[p], {f["key"] for f in findings}, logs, first)
    spans = batch.notes[p] if batch.notes else ()
    return {
        "warnings": [*alarms, *(hinted if same else ()), *(f["sentence"] for f in (*doubts, *late))],
        "findings": findings,
        "notes": [*spans, *notes, *(() if same else hinted), *assumed],
    }


def _late(error: float) -> list[Row]:
    """What is found where G hangs on a lateness."""
    from sysid.command.outputs import finding, plain
    from sysid.verdict.finding import Finding
    from sysid.verdict.wording import hangs_on_lateness

    return [plain(finding(Finding("late", "noted", hangs_on_lateness(error))))]


def _assumed(
    some: "Sequence[Assumed]", found: set[str], logs: "Sequence[Log]", first: "Sequence[Log]"
) -> list[str]:
    """Sentences on what a plate's logs would not show and that is not `found`, by the names of these logs
    instead of those of the `first` plate."""
    from sysid.verdict import wording

    names = {old.name: new.name for old, new in zip(first, logs, strict=True)}
    return wording.assumed(
        [replace(a, logs=tuple(names[name] for name in a.logs)) for a in some if a.key not in found]
    )


def _named(hint: "Finding", logs: "Sequence[Log]", first: "Sequence[Log]") -> Row:
    """What is found of a plate's logs, by the names of this plate's logs instead of those of the
    `first` plate."""
    from sysid.command.outputs import finding, plain

    names = {old.name: new.name for old, new in zip(first, logs, strict=True)}
    about = tuple(names[name] for name in hint.logs)
    sentence = hint.sentence
    for old, new in zip(hint.logs, about, strict=True):
        sentence = f"{new}: {sentence.removeprefix(f'{old}: ')}"
    return plain(finding(replace(hint, logs=about, sentence=sentence)))


def _temperature(logs: "Sequence[Log]") -> float | None:
    """degC, at which f0 is told; None where none is recorded."""
    warm = [float(log.temperature[0]) for log in logs if log.temperature is not None]
    return sum(warm) / len(warm) if warm else None


def _parameters(theta: np.ndarray, covariance: np.ndarray) -> tuple[list, list]:
    """NUMBERS of G, tau and f0 of each plate as the normal approximation of the posterior has them, by which
    logarithms of G and tau are normal; and the covariance of the values."""
    std = np.sqrt(np.einsum("pii->pi", covariance))
    ends = np.stack([theta - NORMAL95 * std, theta + NORMAL95 * std], axis=2)
    value, size = theta.copy(), std.copy()
    value[:, :2] = np.exp(theta[:, :2] + 0.5 * std[:, :2] ** 2)
    size[:, :2] = value[:, :2] * np.sqrt(np.expm1(std[:, :2] ** 2))
    ends[:, :2] = np.exp(ends[:, :2])
    scale = size / std
    whole = covariance * scale[:, :, None] * scale[:, None]
    return np.concatenate([value[:, :, None], size[:, :, None], ends], axis=2).tolist(), whole.tolist()


def _known(numbers: Sequence[float], unit: str) -> Row:
    row: Row = dict(zip(NUMBERS, numbers, strict=True))
    return row | {"unit": unit, "determined": True, "why": None}


def _unknown(why: str) -> Row:
    none: Row = dict.fromkeys(NUMBERS)
    return none | {"unit": "Hz/degC", "determined": False, "why": why}


def _percent(response: np.ndarray, left: np.ndarray) -> np.ndarray:
    """(P,) % of the scatter of each response (P, n) that is left."""
    middle = np.mean(response, axis=1, keepdims=True)
    return 100 * np.linalg.norm(left, axis=1) / np.linalg.norm(response - middle, axis=1)
