"""What there is to say of a lot in words, on the screen and in its report."""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from sysid.fleet.lot import FEWEST, UNITS
from sysid.fleet.plate import NOISES
from sysid.model.theta import POSITIVE
from sysid.report.text import measured
from sysid.tables.cells import listed

ALARMS = 5  # of a number that is 1 on the average: by chance in one of three hundred runs
NUMBER = re.compile(r"(?<![A-Za-z_])[-+]?\d[\d.]*(e[-+]?\d+)?")


def counted(frame: pd.DataFrame) -> list[tuple[str, int]]:
    """How plates ended, and how many so, the most frequent first."""
    return [(str(result), int(count)) for result, count in frame["result"].value_counts().items()]


def unit_of(frame: pd.DataFrame, name: str) -> str:
    """The unit in which a lot's parameter is told."""
    found = frame[f"{name}_unit"].dropna().mode()
    return str(found.iloc[0]) if name == "G" and len(found) else UNITS.get(name, "")


def measures(frame: pd.DataFrame) -> list[list[str]]:
    """Of each parameter of the lot: its name, median, standard deviation, a plate's own error, unit."""
    rows = []
    for name, p in frame.attrs["lot"].get("parameters", {}).items():
        numbers, unit = measured(p["middle"], p["std"], unit=unit_of(frame, name))
        rows.append([name, *numbers[:2], one(p["error"], p["error"], unit_of(frame, name)), unit])
    return rows


def one(value: float, std: float, unit: str) -> str:
    """A number to two digits of its error, and its unit."""
    (number, _), shown = measured(value, std, unit=unit)
    return f"{number} {shown}"


def said(frame: pd.DataFrame) -> list[str]:
    """Sentences on the lot."""
    told, aside = frame.attrs["lot"], frame.attrs.get("left_out")
    left = [f"left out, no log of a plate: {listed(aside)}"] if aside else []
    if not told["judged"]:
        return [*left, f"too few plates to be judged as a lot: {FEWEST} that are identified are needed"]
    each = f"of all {told['judged']} plates chance alone makes {told['alarms']:g} odd on the average"
    lines = [_two(frame, told["halves"])] if "halves" in told else []
    lines += _noise(frame)
    lines += [_drifts(drift) for drift in told["drifts"]]
    if told["tails"] is not None:
        lines.append(
            "the lot has longer tails than a normal one, by which its plates are judged: those of Student's t"
            f" of {told['tails']:g} degrees of freedom"
        )
    return [*left, *lines, each]


def _noise(frame: pd.DataFrame) -> list[str]:
    """What more plates show of their noise than chance makes, which is one of a run, and so ALARMS in few."""
    counts = frame["way_why"].value_counts()
    return [
        f"{kind} shows in {counts[kind]} plates, which are fitted by themselves; others may have as much, not"
        " shown, and then their errors do not include it"
        for kind in NOISES
        if counts.get(kind, 0) >= ALARMS
    ]


def _two(frame: pd.DataFrame, halves: Mapping[str, Any]) -> str:
    name = halves["parameter"]
    width = 0.1 * abs(halves["places"][0] - halves["places"][1])
    places = [one(place, width, unit_of(frame, name)) for place in halves["places"]]
    second = halves["second"]
    return (
        f"the lot is two, by {name}: {second} plates lie about {places[1]}, the others about {places[0]};"
        " each plate is judged among its own (column group)"
    )


def _drifts(drift: Mapping[str, Any]) -> str:
    name, change = drift["parameter"], drift["change"]
    by = f"{100 * (change - 1):+.2g} %" if name in POSITIVE else f"{change:+.3g} {UNITS[name]}"
    over = (
        "lowest temperature to the highest"
        if drift["along"] == "temperature"
        else f"first {drift['along']} to the last"
    )
    return (
        f"{name} goes by {by} from the {over} (rank correlation {drift['correlation']:+.2f});"
        " plates are judged beside that"
    )


def repeated(frame: pd.DataFrame) -> list[tuple[int, str]]:
    """The plates' warnings, each once, numbers aside, with how many plates have it, the most frequent
    first."""
    found: Counter[str] = Counter()
    for warnings, logs in zip(frame["warnings"], frame["logs"], strict=True):
        names = sorted((Path(name).name for name in logs), key=len, reverse=True)
        found.update({NUMBER.sub("#", _without(warning, names)) for warning in warnings})
    return [(count, sentence) for sentence, count in found.most_common()]


def _without(sentence: str, names: list[str]) -> str:
    """A sentence that names no log."""
    for name in names:
        sentence = sentence.replace(f"{name}: ", "").replace(name, "a log")
    return sentence
