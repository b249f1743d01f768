"""The lot that a table's plates make: what is like in it, whether it drifts or is two, and which plates are
not like it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from sysid.fleet.halves import Halves, halves
from sysid.fleet.robust import Lot, lot
from sysid.fleet.tails import Tails, tails
from sysid.model.theta import PLANT, POSITIVE
from sysid.tables import units
from sysid.verdict.result import Result

ALARMS = 0.2  # plates of a whole lot that chance alone makes odd, on the average
FEWEST = 8  # plates that make a lot
MOST = 0.5  # of the plates, that must determine a parameter by which plates are judged
UNITS = {"tau": "s", "f0": "Hz", "k_T": "Hz/degC"}
SURE = 1e-3  # probability of a rank correlation by chance, below which a lot drifts


@dataclass(frozen=True)
class Along:
    """What a lot is followed along: `name`, its `place` (n,) of each plate (NaN: not stated), from 0 to 1."""

    name: str
    place: np.ndarray


@dataclass(frozen=True)
class Drift:
    """How a parameter goes `along` something: Spearman's `correlation`, and `change` from the first to the
    last, a factor of G and tau, else in its unit."""

    parameter: str
    along: str
    correlation: float
    chance: float
    change: float


@dataclass(frozen=True)
class Judged:
    """The plates `index` of a table by the parameters `names`; `chances` (n,) of a plate that belongs to the
    lot to lie as far out; `parted` by one parameter, where the lot is two."""

    names: tuple[str, ...]
    index: np.ndarray
    lot: Lot
    chances: np.ndarray
    tails: Tails | None
    drifts: tuple[Drift, ...]
    parted: tuple[str, Halves] | None
    followed: tuple[Along, ...]

    @property
    def odd(self) -> np.ndarray:
        """(n,) which do not belong to the lot: by chance ALARMS plates of it all."""
        return self.chances < ALARMS / len(self.chances)


def judged(frame: pd.DataFrame) -> Judged | None:
    """The lot of a table's plates that are identified; None where they are too few."""
    good = np.flatnonzero((frame["result"] == Result.successful.value).to_numpy())
    told = frame.iloc[good]
    names = [n for n in PLANT if told[f"{n}_determined"].sum() >= max(MOST * len(told), FEWEST)]
    if not names:
        return None
    values, covariances = _numbers(told, names)
    parted = _parted(values, names)
    second = parted[1].second if parted else np.zeros(len(told), bool)
    given = np.column_stack([np.ones(len(told)), second])[:, : 1 + (parted is not None)]
    found = lot(values, covariances, given)
    drifts, used = [], []
    for along in _followed(told):
        here = [d for j, name in enumerate(names) if (d := _drift(found, j, name, along)) is not None]
        if not here:
            continue
        used.append(along)
        place = np.where(np.isfinite(along.place), along.place, np.nanmedian(along.place))
        given = np.column_stack([given, place - np.median(place)])
        found = lot(values, covariances, given)
        drifts += [_changed(found, names, d) for d in here]
    out = tails(found.distances[found.known.all(1)], len(names))
    chances = found.chances if out is None else out.chance(found.distances, np.maximum(found.known.sum(1), 1))
    return Judged(tuple(names), good, found, chances, out, tuple(drifts), parted, tuple(used))


def _numbers(told: pd.DataFrame, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """(n, p) parameters, logarithms of those that are positive, and (n, p, p) their covariances, by the
    fits."""
    values = np.full((len(told), len(names)), np.nan)
    errors = np.zeros_like(values)
    for j, name in enumerate(names):
        x, std = told[name].to_numpy(float), told[f"{name}_std"].to_numpy(float)
        if name == "G":
            factor = in_one_unit(told["G_unit"])
            x, std = x * factor, std * factor
        positive = name in POSITIVE
        with np.errstate(invalid="ignore", divide="ignore"):
            values[:, j] = np.where(x > 0, np.log(x), np.nan) if positive else x
        errors[:, j] = std / np.abs(x) if positive else std
    covariances = np.zeros((len(told), len(names), len(names)))
    for i, one in enumerate(names):
        covariances[:, i, i] = errors[:, i] ** 2
        for j, other in enumerate(names[:i]):
            column = f"correlation_{other}_{one}"
            if column in told:
                product = told[column].to_numpy(float) * errors[:, i] * errors[:, j]
                covariances[:, i, j] = covariances[:, j, i] = np.nan_to_num(product)
    values[~np.isfinite(errors)] = np.nan
    return values, np.nan_to_num(covariances)


def in_one_unit(column: pd.Series) -> np.ndarray:
    """(n,) what takes each plate's G to the unit that most have; NaN where it is of another kind."""
    common = str(column.mode().iloc[0])
    factors = {
        unit: float(units.convert(1.0, unit, common)) if units.same_kind(unit, common) else np.nan
        for unit in column.dropna().unique()
    }
    return column.map(factors).to_numpy(float)


def with_pooled(frame: pd.DataFrame, found: Judged | None) -> pd.DataFrame:
    """The table with columns p_pooled and p_pooled_std beside each parameter p by which plates are judged:
    what the plate has by its own logs and by the lot (`Lot.pooled`), in the unit of its own value; NaN of a
    plate that is odd, as that is not of the lot, or whose logs do not determine p."""
    names = PLANT if found is None else found.names
    told = {f"{name}_pooled{end}": np.full(len(frame), np.nan) for name in names for end in ("", "_std")}
    if found is not None:
        values, covariances = found.lot.pooled
        for j, name in enumerate(names):
            middle, std = values[:, j], np.sqrt(covariances[:, j, j])
            if name in POSITIVE:
                middle = np.exp(middle)
                std = middle * std
            own = 1 / in_one_unit(frame.iloc[found.index]["G_unit"]) if name == "G" else 1.0
            here = found.lot.known[:, j] & ~frame["odd"].to_numpy(bool)[found.index]
            told[f"{name}_pooled"][found.index] = np.where(here, middle * own, np.nan)
            told[f"{name}_pooled_std"][found.index] = np.where(here, std * own, np.nan)
    whole = pd.concat([frame, pd.DataFrame(told, index=frame.index)], axis=1)
    whole.attrs = frame.attrs
    return whole


def _parted(values: np.ndarray, names: list[str]) -> tuple[str, Halves] | None:
    """The parameter by which the lot is two most of all."""
    found = [(name, h) for name, x in zip(names, values.T, strict=True) if (h := halves(x)) is not None]
    return max(found, key=lambda item: item[1].gain, default=None)


def _followed(told: pd.DataFrame) -> list[Along]:
    """What a lot may drift along: its dates, or else its serial numbers, by their order; and the temperature
    at which f0 is told."""
    found = []
    dates = pd.to_datetime(told["date"], errors="coerce", utc=True, format="ISO8601")
    order = (
        dates.astype("int64").where(dates.notna()).astype(float)
        if dates.notna().sum() > 1
        else told["serial"]
    )
    if order.nunique() > 1:
        ranks = order.rank(method="average").to_numpy(float)
        name = "date" if dates.notna().sum() > 1 else "serial number"
        found.append(Along(name, (ranks - np.nanmin(ranks)) / np.ptp(ranks[np.isfinite(ranks)])))
    warm = told["reference_temperature_degC"].to_numpy(float)
    if np.isfinite(warm).sum() > 1 and np.nanmax(warm) > np.nanmin(warm):
        found.append(Along("temperature", (warm - np.nanmin(warm)) / (np.nanmax(warm) - np.nanmin(warm))))
    return found


def _drift(found: Lot, j: int, name: str, along: Along) -> Drift | None:
    """That a parameter goes along with something, by ranks; None where chance does as much."""
    here = found.known[:, j] & np.isfinite(along.place)
    if here.sum() < FEWEST:
        return None
    a, b = (pd.Series(v).rank().to_numpy() for v in (along.place[here], found.left[here, j]))
    correlation = float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) and np.ptp(b) else 0.0
    chance = float(2 * ndtr(-abs(correlation) * np.sqrt(here.sum() - 1)))
    return Drift(name, along.name, correlation, chance, np.nan) if chance < SURE else None


def _changed(found: Lot, names: list[str], drift: Drift) -> Drift:
    """The drift with what its parameter changes from the first to the last."""
    slope = float(found.centre[-1, names.index(drift.parameter)])
    change = float(np.exp(slope)) if drift.parameter in POSITIVE else slope
    return Drift(drift.parameter, drift.along, drift.correlation, drift.chance, change)


def summary(frame: pd.DataFrame, found: Judged | None) -> dict[str, Any]:
    """What there is to say of a lot as plain values, for `attrs` of the table."""
    if found is None:
        return {"judged": 0, "alarms": ALARMS}
    width = np.sqrt(np.diag(found.lot.scatter))
    middle = found.lot.centre[0] + np.median(found.lot.given[:, 1:], axis=0) @ found.lot.centre[1:]
    told: dict[str, Any] = {"judged": len(found.index), "alarms": ALARMS, "parameters": {}}
    for name, m, w in zip(found.names, middle.tolist(), width.tolist(), strict=True):
        positive = name in POSITIVE
        std = np.exp(m) * w if positive else w
        error = float(np.nanmedian(frame.iloc[found.index][f"{name}_std"]))
        told["parameters"][name] = {
            "middle": float(np.exp(m)) if positive else m,
            "std": float(std),
            "error": error,
        }
    scale = np.sqrt(np.outer(np.diag(found.lot.scatter), np.diag(found.lot.scatter)))
    told["correlation"] = (found.lot.scatter / scale).tolist()
    told["tails"] = None if found.tails is None else found.tails.degrees
    told["drifts"] = [vars(drift) for drift in found.drifts]
    if found.parted is not None:
        name, parts = found.parted
        places = np.exp(parts.places) if name in POSITIVE else np.array(parts.places)
        told["halves"] = {"parameter": name, "places": places.tolist(), "second": int(parts.second.sum())}
    return told
