"""fleet.html: the report of a lot, one file that asks for nothing else: odd plates first."""

from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

import pandas as pd

from sysid.fleet import words
from sysid.fleet.lot import Judged
from sysid.fleet.pictures import of_lot, of_plate
from sysid.fleet.plate import Row, folder_of
from sysid.model.theta import PLANT
from sysid.report.html import template
from sysid.verdict.result import Result

PAGE = "fleet.html"
PICTURED = 40  # odd plates with a picture, the farthest out first
LISTED = 2000  # plates in the page's table; fleet.csv has all


Rows = Mapping[int, Row] | Sequence[Row]  # by their place in the table


def pictured(frame: pd.DataFrame) -> list[int]:
    """Which plates of a table are drawn, by their place: the first that are odd, and that have no numbers."""
    return [int(at) for part in _first(frame) for at in part.index[:PICTURED]]


def _first(frame: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The odd plates, the farthest out first; and those without numbers."""
    good = frame["result"] == Result.successful.value
    return frame[frame["odd"] & good].sort_values("odd_chance", kind="stable"), frame[~good]


def render(frame: pd.DataFrame, found: Judged | None, rows: Rows, full: str | None) -> str:
    """The page of a table; `rows`: those of the plates that are `pictured`. `full`: the folder beside it that
    has each plate's own report."""
    odd, lost = _first(frame)
    return template("fleet.html.j2").render(
        counts=words.counted(frame),
        plates=len(frame),
        measures=words.measures(frame),
        said=words.said(frame),
        odd=_cards(odd, frame, found, rows, full),
        lost=_cards(lost, frame, found, rows, full),
        unnamed=max(len(odd) - LISTED, 0) + max(len(lost) - LISTED, 0),
        figures={} if found is None else of_lot(frame, found),
        warnings=words.repeated(frame)[:PICTURED],
        table=_table(frame.iloc[:LISTED], full),
        names=_names(frame),
        pooled=bool(_pooled(frame)),
        more=max(len(frame) - LISTED, 0),
    )


def _cards(
    part: pd.DataFrame, frame: pd.DataFrame, found: Judged | None, rows: Rows, full: str | None
) -> list:
    """Plates with their reasons, and with their pictures where they are the first."""
    told = []
    for k, at in enumerate(part.index[:LISTED]):
        row = frame.loc[at]
        picture = of_plate(rows[at], frame, found, at) if k < PICTURED else None
        told.append(
            {"plate": row["plate"], "why": row["odd_why"], "link": _link(row, full), "picture": picture}
        )
    return told


def _pooled(frame: pd.DataFrame) -> list[str]:
    """The parameters that plates have by the lot as well."""
    return [name for name in PLANT if f"{name}_pooled" in frame and frame[f"{name}_pooled"].notna().any()]


def _names(frame: pd.DataFrame) -> list[str]:
    """The columns of numbers in the page's table."""
    found, pooled = [name for name in PLANT if frame[f"{name}_determined"].any()], _pooled(frame)
    return [column for name in found for column in (name, *([f"{name} pooled"] if name in pooled else ()))]


def _table(frame: pd.DataFrame, full: str | None) -> list[dict[str, Any]]:
    """Of each plate what the page's table shows."""
    rows, pooled = [], _pooled(frame)
    for _, row in frame.iterrows():
        cells = {
            name: words.one(row[name], row[f"{name}_std"], row[f"{name}_unit"])
            for name in PLANT
            if row[f"{name}_determined"]
        } | {
            f"{name} pooled": words.one(row[f"{name}_pooled"], row[f"{name}_pooled_std"], row[f"{name}_unit"])
            for name in pooled
            if pd.notna(row[f"{name}_pooled"])
        }
        rows.append(
            {
                "plate": row["plate"],
                "odd": row["odd"],
                "result": row["result"],
                "cells": cells,
                "link": _link(row, full),
            }
        )
    return rows


def _link(row: pd.Series, full: str | None) -> str | None:
    """Where a plate's own report is; None where there is none."""
    if full is None or row["error"] is not None:
        return None
    return f"{quote(str(folder_of(row['plate'], full)))}/report.html"
