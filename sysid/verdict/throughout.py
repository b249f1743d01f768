"""What every log would hold, one term each: what plate, amplifier and temperature do everywhere."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sysid.model.prior import FINGER
from sysid.rows.hold import contact, force_of
from sysid.trials.trial import LEAST_WARMING
from sysid.verdict.term import Term
from sysid.verdict.view import View

CURVED = "curved"
ANOTHER_LAW = (
    "the effect of the finger grows with its force by another law than that of the contact area, which is"
    " fitted, so that"
    " finger_damping holds at no force; fit logs of a single force with logs of none"
)


def of_all(views: list[View], away: float, free: Sequence[str]) -> Iterator[Term]:
    """What every log would hold: the plate's own nonlinearity, the amplifier's, what changes with
    temperature; parameters are reported `away` (degC) from the logs' mean temperature."""
    yield from _softening(views)
    yield from _drive(views)
    yield from _finger(views, free)
    yield from _curved(views, away, free)
    yield from _temperature(views, away)


def _softening(views: list[View]) -> Iterator[Term]:
    """A plate whose damping and frequency depend on its amplitude."""
    moving = {
        i: v for i, v in enumerate(views) if not v.trial.steady or (v.trial.resonant and v.trial.driven)
    }
    top = max((float(np.max(np.abs(v.plate))) for v in moving.values()), default=0.0)
    if top == 0:
        return
    # Of amplitudes at one frequency, and without any, f0 is not seen to move.
    turns = any(
        v.trial.resonant and (v.trial.signed or np.ptp(v.trial.log.frequency) > 0) for v in moving.values()
    )
    moved = {i: _either(v, np.abs(v.plate / top) ** 2)[:, : 1 + turns] for i, v in moving.items()}
    unit = views[0].trial.log.response_unit

    def softer(value: np.ndarray, view: View) -> str | None:
        if not turns and value[0] > 0 and view.trial.noise.coloured:
            # without a frequency noise of long memory looks so, and friction seldom falls with the
            # amplitude
            return None
        slower = f"{-100 * value[0] * view.course.tau:+.2g} % in 1/tau at {top:.2g} {unit}"
        if not turns:
            return f"damping depends on the amplitude, by about {slower}; record at a smaller drive"
        about = f"by about {value[1] / (2 * np.pi):+.2g} Hz in f0 and {slower}"
        return (
            f"damping and frequency depend on the amplitude, {about} (hysteresis in a sweep); record at"
            f" a smaller drive"
        )

    def bent(value: np.ndarray, _: View) -> str:
        about = f"by about {value[0] / (2 * np.pi):+.2g} Hz in f0 at {top:.2g} {unit}"
        return (
            f"the frequency seems to depend on the amplitude, {about} (hysteresis in a sweep); record"
            f" at a smaller drive"
        )

    yield Term("duffing", moved, softer, freedom=1 + turns)
    # Every plate softens or hardens a little, and a peak that leans by 1 % of a half bandwidth moves f0
    # by several of its errors. Of settled points in even noise that is all that looks so; of a transient
    # a drift or a lateness does, elsewhere noise of long memory, or one whose weights follow the
    # residual.
    if turns and all(
        v.trial.steady and not (v.trial.noise.coloured or v.trial.noise.share) for v in moving.values()
    ):
        yield Term("duffing", {i: shapes[:, 1:] for i, shapes in moved.items()}, bent, expected=True)


def _drive(views: list[View]) -> Iterator[Term]:
    """A response that is not in proportion to the drive."""
    levels = np.concatenate(
        [np.abs(v.trial.inputs.drive) for v in views if v.trial.log.drive is not None] or [np.zeros(1)]
    )
    if _of_several_sizes(levels):
        driven = {i: (v, v.course.hold.drive) for i, v in enumerate(views) if v.trial.log.drive is not None}
        cubed = {
            i: v.observed(v.course.driven(drive * (drive / levels.max()) ** 2)[None]).T
            for i, (v, drive) in driven.items()
        }
        yield Term("drive", cubed, _out_of_proportion)


def _finger(views: list[View], free: Sequence[str]) -> Iterator[Term]:
    """A finger that damps by another law of its force."""
    touched = {i: v for i, v in enumerate(views) if v.trial.touched}
    if touched and FINGER[0] in free:
        power = {
            i: contact(force_of(v.course.hold.contact), "power", exponent=0.6, xp=np)
            for i, v in touched.items()
        }
        grown = {i: _either(v, power[i][v.course.hold.interval] / v.course.tau) for i, v in touched.items()}
        yield Term("law_of_the_finger", grown, lambda *_: ANOTHER_LAW, freedom=2)


def _temperature(views: list[View], away: float) -> Iterator[Term]:
    """G and tau that change with the temperature."""
    warm = [float(np.mean(v.course.hold.warming)) for v in views]
    if np.ptp(warm) > 1.0:
        for k, symbol in enumerate(("G", "tau")):
            shapes = {
                i: v.derivatives[:, k : k + 1] * w for i, (v, w) in enumerate(zip(views, warm, strict=True))
            }
            yield Term("temperature", shapes, _per_degree(symbol), beside=(symbol, away))


def _curved(views: list[View], away: float, free: Sequence[str]) -> Iterator[Term]:
    """A resonance f0 + k_T (T - T0) + k_T2 (T - T0)^2 about the temperature T0 at which f0 and k_T are told,
    where three temperatures or more show it; in half bandwidths at the warmest, so that more than a first
    order tells of is seen."""
    warm = {
        i: v.course.hold.warming[v.course.hold.interval] - away
        for i, v in enumerate(views)
        if v.trial.resonant
    }
    if "k_T" not in free or len(warm) < 1:
        return
    told = np.concatenate([w if np.ptp(w) > LEAST_WARMING else w[:1] for w in warm.values()])
    if len(np.unique(np.round(told / LEAST_WARMING))) < 3:
        return

    def say(value: np.ndarray, _: View) -> str:
        return (
            f"f0 is not linear in the temperature: k_T changes by {2 * value[0]:+.2g} Hz/degC per degC; fit"
            " logs of a narrower range of temperatures, about that of use, or record some nearer to it"
        )

    yield Term(CURVED, {i: views[i].along(2j * np.pi * w**2)[:, None] for i, w in warm.items()}, say)


def _of_several_sizes(levels: np.ndarray) -> bool:
    """Whether the cubes of these drives are more than a number times them, a tenth of all: not so of on and
    off, or of + and -, however they were measured."""
    cubes = levels**3
    left = cubes - levels * (levels @ cubes) / max(levels @ levels, 1e-300)
    return bool(np.linalg.norm(left) > 0.1 * np.linalg.norm(cubes))


def _out_of_proportion(value: np.ndarray, _: View) -> str:
    return (
        f"the response is not proportional to the drive, by about {100 * value[0]:+.2g} % at its largest:"
        f" an amplifier that"
        " clips, or a duty ratio whose voltage is not stated; state the voltage itself"
    )


def _per_degree(symbol: str) -> Callable[[np.ndarray, View], str]:
    return lambda value, _: (
        f"{symbol} changes with the temperature, by {100 * value[0]:+.2g} % per degC; fit logs of one"
        f" temperature, or hold it"
    )


def _either(view: View, rates: np.ndarray) -> np.ndarray:
    """(n, 2): what damping and frequency that change by `rates` (n,), rad/s, add."""
    return np.stack([view.along(rates + 0j), view.along(1j * rates)], axis=1)
