"""The work-precision diagram of the user's own logs: for each accuracy the error, and the wall time until its
numbers are there.

Cold: nothing compiled, as after an installation. Warm: all programs in the user's cache folder, as in every
later run of logs of these lengths. Both are measured, in one process each stage of which begins as it would
in a new one; imports are measured once.
"""

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from sysid.command.bill import ladder
from sysid.posterior.accuracy import NAMES
from sysid.report.text import span

if TYPE_CHECKING:
    from sysid.posterior.posterior import Posterior


@dataclass(frozen=True)
class Point:
    """One accuracy. Seconds from the command to the numbers. `error` as the rung states it and `distance` of
    its estimates from those of the last, None for itself: largest of means and intervals' ends, in standard
    deviations of the parameter."""

    accuracy: str
    cold_s: float
    warm_s: float
    evaluations: int
    error: float
    distance: float | None


@dataclass(frozen=True)
class CostCurve:
    """The points, and the seconds of each stage, cold and warm, from which their times are sums."""

    points: tuple[Point, ...]
    cold: dict[str, float]
    warm: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """The content of cost_curve.json."""
        return {"schema": 1, **asdict(self)}


def measure(read: Callable[[], list], settings: Mapping[str, Any], seed: int) -> "CostCurve | Posterior":
    """Climb the whole ladder cold and warm, over the logs that `read()` gives, `settings` for the fit. A
    posterior instead where the logs do not bound one: nothing is approached then."""
    imports = {
        name: math.fsum(_seconds(partial(import_module, module))[0] for module in of)
        for name, of in MODULES.items()
    }
    from sysid.posterior.target import bounded
    from sysid.precision import forget_programs, keep_programs

    with tempfile.TemporaryDirectory() as folder:
        keep_programs(Path(folder))
        passes = []
        for _ in ("cold", "warm"):
            forget_programs()
            stages, top = _climb(read, settings, seed)
            if not bounded(top.fit):
                return top
            passes.append(imports | stages)
    return curve(top, *passes)


MODULES = {"load": ("pandas", "sysid.posterior.posterior"), "load chains": ("sysid.posterior.chain",)}


def _climb(
    read: Callable[[], list], settings: Mapping[str, Any], seed: int
) -> "tuple[dict[str, float], Posterior]":
    from sysid.fitting import fit
    from sysid.posterior.posterior import sample

    stages = {}
    stages["read"], logs = _seconds(read)
    stages["fit"], fitted = _seconds(lambda: fit(logs, **settings))
    top = sample(fitted, seed, NAMES[-1])
    return stages | {p.accuracy: p.seconds for p in ladder(top)}, top


def curve(top: "Posterior", cold: dict[str, float], warm: dict[str, float]) -> CostCurve:
    """The points of a climbed ladder: a rung stands on all below it, and on the chains' libraries if it has
    chains."""
    points, rungs = [], ladder(top)
    for i, rung in enumerate(rungs):
        used = ["load", "read", "fit", *(p.accuracy for p in rungs[: i + 1]), *(["load chains"] if i else [])]
        apart = None if rung is top else max(e.distance(top.estimates[n]) for n, e in rung.estimates.items())
        took = [math.fsum(stages[name] for name in used) for stages in (cold, warm)]
        points.append(Point(rung.accuracy, took[0], took[1], rung.evaluations, rung.error, apart))
    return CostCurve(tuple(points), cold, warm)


def table(points: Sequence[Point]) -> list[tuple[str, ...]]:
    """The rows of the screen's table, a header first."""
    head = ("accuracy", "first run", "later runs", "evaluations", "error", f"from {points[-1].accuracy}")
    rows = [
        (p.accuracy, span(p.cold_s), span(p.warm_s), str(p.evaluations), f"{p.error:.1g}", _or_none(p))
        for p in points
    ]
    return [head, *rows]


def _or_none(point: Point) -> str:
    return "" if point.distance is None else f"{point.distance:.1g}"


def _seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    begun = perf_counter()
    done = work()
    return perf_counter() - begun, done
