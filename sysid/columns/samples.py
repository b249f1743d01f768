"""Which column of a file that looks like raw samples of a carrier is probably which, and in which file of its
capture."""

import re
from collections.abc import Mapping
from typing import Any

from sysid.columns.survey import Columns, fits

QUICK = 1e-5  # s from row to row, below which rows are samples of a carrier rather than its amplitudes


def waveform(columns: Columns, guessed: Mapping[str, int]) -> dict[str, int]:
    """Time, drive and response of what looks like an oscilloscope's record: steps too short for amplitudes,
    or a column beside two of volts. Empty for any other file."""
    time, count = guessed.get("time"), len(columns.labels)
    others = [k for k in range(count) if k != time and columns.holds_data(k) and not columns.repeats(k, time)]
    volts = [index for index in others if fits("voltage", columns.unit(index))]
    pair = count == 3 and len(volts) == 2
    sampled = any(key.casefold().startswith("sample_rate") for key in columns.head.metadata)
    quick = sampled if time is None else 0 < columns.step(time) < QUICK
    if guessed.keys() & {"wd", "x", "magnitude", "frequency"} or len(others) < 2 or not (pair or quick):
        return {}
    others = volts if pair else others
    drive = guessed.get("voltage", next(index for index in others if index != guessed.get("w")))
    response = guessed.get("w", next(index for index in others if index != drive))
    response = response if response != drive else next(index for index in others if index != drive)
    return ({} if time is None else {"time": time}) | {"drive": drive, "response": response}


def channels(columns: Columns, guessed: Mapping[str, int]) -> dict[str, Any]:
    """Of one channel of an oscilloscope whose others are in files of their own, by the name of this one:
    patterns of the files of the drive and of the response, and the column `of` the samples in each. Empty of
    any other file."""
    head = columns.head
    named = re.fullmatch(
        r"(.*?)(ch|chan|channel|c)([-_ ]?)([1-8])(?!\d)(.*?)(\.\w+)?", head.name, re.IGNORECASE
    )
    others = [k for k in range(len(head.names)) if k != guessed.get("time") and columns.holds_data(k)]
    if (
        named is None
        or "time" not in guessed
        or len(others) != 1
        or not 0 < columns.step(guessed["time"]) < QUICK
    ):
        return {}
    before, word, mark, number, behind, ending = named.groups(default="")
    pair = ("1", "2" if number == "1" else number)
    patterns = [f"{'*' if before else ''}{word}{mark}{k}{'*' if behind else ''}{ending}" for k in pair]
    return {"of": others[0], "drive": patterns[0], "response": patterns[1]}
