"""What every log would hold, one term each: what plate, amplifier and temperature do everywhere."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sysid.model.theta import FINGER
from sysid.rows.hold import contact, force_of
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.term import Term

ANOTHER_LAW = (
    "the effect of the finger grows with its force by another law than that of the contact area, which is"
    " fitted, so that"
    " finger_damping holds at no force; fit logs of a single force with logs of none"
)


def of_all(views: list[LinearisedLog], away: float, free: Sequence[str]) -> Iterator[Term]:
    """What every log would hold: the plate's own nonlinearity, the amplifier's, what changes with
    temperature; parameters are reported `away` (degC) from the logs' mean temperature."""
    yield from _finger(views, free)
    yield from _temperature(views, away)


def _finger(views: list[LinearisedLog], free: Sequence[str]) -> Iterator[Term]:
    """A finger that damps by another law of its force."""
    touched = {i: v for i, v in enumerate(views) if v.trial.touched}
    if touched and FINGER[0] in free:
        power = {
            i: contact(force_of(v.course.hold.contact), "power", exponent=0.6) for i, v in touched.items()
        }
        grown = {i: _either(v, power[i][v.course.hold.interval] / v.course.tau) for i, v in touched.items()}
        yield Term("law_of_the_finger", grown, lambda *_: ANOTHER_LAW, freedom=2)


def _temperature(views: list[LinearisedLog], away: float) -> Iterator[Term]:
    """G and tau that change with the temperature."""
    warm = [float(np.mean(v.course.hold.warming)) for v in views]
    if np.ptp(warm) > 1.0:
        for k, symbol in enumerate(("G", "tau")):
            shapes = {
                i: v.derivatives[:, k : k + 1] * w for i, (v, w) in enumerate(zip(views, warm, strict=True))
            }
            yield Term("temperature", shapes, _per_degree(symbol), beside=(symbol, away))


def _per_degree(symbol: str) -> Callable[[np.ndarray, np.ndarray], str]:
    return lambda value, _: (
        f"{symbol} changes with the temperature, by {100 * value[0]:+.2g} % per degC; fit logs of one"
        f" temperature, or hold it"
    )


def _either(view: LinearisedLog, rates: np.ndarray) -> np.ndarray:
    """(n, 2): what damping and frequency that change by `rates` (n,), rad/s, add."""
    return np.stack([view.along(rates + 0j), view.along(1j * rates)], axis=1)
