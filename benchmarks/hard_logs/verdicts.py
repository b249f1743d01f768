"""What a program makes of a case, judged by the plate that its logs were made from."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from bench import PLATE, Bench
from cases import UNDETECTABLE, Case

from sysid import Log, LogError, fit

FAR = 4.0  # standard deviations: chance does it once in 16 000
VERDICTS = ("right", "open", "refused", "flagged", "silently wrong", "raised")


@dataclass(frozen=True)
class Answer:
    """The verdict; z: largest |value - truth|/std of what was called determined; what was printed."""

    verdict: str
    z: float = 0.0
    said: str = ""
    shown: Mapping[str, float] | None = None  # values by name


def logs_of(case: Case, seed: int) -> list[Log]:
    """The logs of a case; raises LogError where they are not read."""
    return case.make(Bench(np.random.default_rng(seed)))


def truths(case: Case, at: float | None = 24.0) -> dict[str, float]:
    """Of the plate that the case is about; f0 at the temperature (degC) `at` which it is told."""
    warm = (
        24.0 if at is None or abs(at - 24.0) > 100 else at
    )  # kelvin called degC: the number is another, the temperature is not
    known = {
        "G": PLATE.G,
        "tau": PLATE.tau,
        "f0": PLATE.f0,
        "k_T": PLATE.k_T,
        "finger_damping": 1.0,
        "finger_detuning": 0.0,
    }
    return {**known, **case.truth, "f0": case.truth.get("f0", PLATE.f0 + PLATE.k_T * (warm - 24.0))}


def ours(case: Case, seed: int, **given: Any) -> Answer:
    """The answer of this package; what else is `given` to its fit."""
    try:
        logs = logs_of(case, seed)
        found = fit(logs, **given)
    except LogError as error:
        return Answer("refused", said=str(error).rpartition("/")[2])
    except Exception as error:
        return Answer("raised", np.inf, f"{type(error).__name__}: {error}")
    values = {n: p for n, p in found.parameters.items() if p.determined}
    truth = truths(case, found.reference_temperature)
    apart = {n: (p.value - truth[n]) / p.std for n, p in values.items()}
    z = max(map(abs, apart.values()), default=0.0)
    lines = [f"{n} {p.value:.6g} +- {p.std:.2g} ({apart[n]:+.1f})" for n, p in values.items()]
    why = [f"{n}: {p.why}" for n, p in found.parameters.items() if not p.determined]
    notes = [note for one in logs for note in one.notes]
    said = " | ".join([found.result.name, *lines, *why, *(f"warning: {w}" for w in found.warnings), *notes])
    answer = partial(Answer, z=z, said=said, shown={n: p.value for n, p in values.items()})
    if found.result.name != "successful":
        return answer("open" if found.result.name == "undetermined" else "refused")
    if z <= FAR:
        return answer("right" if "tau" in values else "open")
    return answer("flagged" if found.warnings or notes else "silently wrong")


def as_it_must(case: Case, answer: Answer) -> bool:
    """Whether the answer is one that the case allows, in words that say what is wrong."""
    if case.must == UNDETECTABLE:
        return answer.verdict != "raised"
    return answer.verdict in case.must.split(" or ") and (
        answer.verdict == "right" or re.search(case.says, answer.said) is not None
    )
