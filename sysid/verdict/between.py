"""What one log would have for itself if it contradicts the others, one term each, and what is said of it."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sysid.logs.log import Log
from sysid.rows.thermometer import was_read
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Term

OFF = 3.0  # degC, by which a thermometer may be off; of more something else is the likelier cause


def between(views: list[LinearisedLog], free: Sequence[str]) -> Iterator[Term]:
    """What one log would have for itself if it contradicts the others. Of two logs either may be the one to
    believe."""
    if len(views) < 2:
        return

    def doubted(parameter: str) -> tuple[str, float] | None:
        return (parameter, 1.0) if len(views) == 2 else None

    logs = [v.trial.log for v in views]
    for i, v in enumerate(views):
        name, columns = v.trial.log.name, v.derivatives
        yield Term(
            "finger",
            {i: -columns[:, :2].sum(axis=1, keepdims=True)},
            finger(name, warmer(logs, [i])),
            i,
            between=True,
        )
        yield Term("gain", {i: columns[:, :1]}, _own(name, "G", times), i, beside=doubted("G"), between=True)
        yield Term(
            "tau", {i: columns[:, 1:2]}, _own(name, "tau", times), i, beside=doubted("tau"), between=True
        )
        believed = len(views) == 2 and was_read(logs[i]) and not was_read(logs[1 - i])
        if (
            "f0" in free and not believed
        ):  # of two, the one whose temperature is not recorded is the one to doubt
            say = _elsewhere(v, [log for log in logs if log is not v.trial.log], "k_T" in free)
            yield Term("resonance", {i: columns[:, 2:3]}, say, i, beside=doubted("f0"), between=True)


def finger(name: str, warmer: float) -> Callable[[np.ndarray, np.ndarray], str | None]:
    """Of a log whose G and tau are both off those of the others by the factor e^-value; it is `warmer` degC
    than they are."""
    by_heat = (
        f", or G and tau fall with the temperature, {warmer:+.2g} degC there; record another such log to tell"
    )

    def say(value: np.ndarray, _: np.ndarray | None = None) -> str | None:
        if value[0] <= 0:
            return None
        return (
            f"{name}: G and tau are both lower than in the other logs, by about the factor"
            f" {np.exp(-value[0]):.2g}: a finger, or"
            f" something else that damps, was left on the plate{by_heat if abs(warmer) > OFF else ''};"
            f" leave this log out"
        )

    return say


def warmer(logs: Sequence[Log], some: Sequence[int]) -> float:
    """By how many degC some logs are warmer than the others on average; 0 where that is not recorded."""
    read = {k: float(np.mean(log.temperature)) for k, log in enumerate(logs) if was_read(log)}
    own, others = ([x for k, x in read.items() if (k in some) is here] for here in (True, False))
    return float(np.mean(own)) - float(np.mean(others)) if own and others else 0.0


def times(x: float) -> str:
    """A factor to first order: 1 + x, and never below 0."""
    return f"{1 + x if x > 0 else np.exp(x):.4g} times that"


def own(name: str, what: str, about: str, several: bool = False) -> str:
    """Of a log, or of `several`, that contradict the others in `what`, by `about` so much."""
    its, it = ("their", "them") if several else ("its", "it")
    return (
        f"{name}: {what} contradicts the other logs, about {about} of theirs; check {its} units, {its} sensor"
        f" and {its} temperature, or"
        f" leave {it} out{' (or fit a gain of each log, --effects=+gain)' if what == 'G' else ''}"
    )


def elsewhere(name: str, logs: Sequence[Log], others: Sequence[Log], hertz: float, k_T: float) -> str:
    """Of logs whose resonance is elsewhere than that of the others, and by how much their thermometer would
    be off if it was that, where k_T (Hz/degC; 0 where none is known) tells."""
    off = hertz / k_T if k_T else np.inf
    read = any(map(was_read, logs))
    if not read and any(map(was_read, others)):
        would = f", and would be {off:+.2g} degC off what is assumed" if np.isfinite(off) else ""
        about = f"{hertz:+.4g} Hz off that of the other logs"
        return f"{name}: the resonance is {about}; its temperature is not recorded{would}: record it"
    said = own(name, "the resonance", f"{hertz:+.4g} Hz off that", len(logs) > 1)
    if not read or abs(off) > OFF:
        return said
    return (
        f"{said}; or the plate was {off:+.2g} degC off what was read: state temperature_std_degC, how"
        f" far that may be"
    )


def _own(name: str, what: str, put: Callable[[float], str]) -> Callable[[np.ndarray, np.ndarray], str]:
    return lambda value, _: own(name, what, put(float(value[0])))


def _elsewhere(
    view: LinearisedLog, others: Sequence[Log], warmed: bool
) -> Callable[[np.ndarray, np.ndarray], str]:
    """`warmed`: k_T is fitted."""
    k_T = float(view.course.named.k_T) if warmed else 0.0
    log = view.trial.log
    return lambda value, _: elsewhere(log.name, [log], others, float(value[0]), k_T)
