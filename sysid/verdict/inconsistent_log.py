"""Of logs that one plant does not explain: those that contradict the others, and in what.

Logs that the model describes by themselves, beside others that it describes as well, are of another plate, at
another temperature, or in other units: what the two groups leave, if anything, is worth next to nothing
beside what they gain as two. That asks for less than an effect that would explain it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import ESTIMATED, Minimiser, State
from sysid.model.theta import NAMES, carried
from sysid.rows.thermometer import was_read
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial
from sysid.verdict.between import OFF, elsewhere, finger, own, times, warmer
from sysid.verdict.finding import Finding
from sysid.verdict.identify import buried
from sysid.verdict.linear import PROMISES
from sysid.verdict.misfit import described, misfits
from sysid.verdict.recorder import clipped, touched

APART = 5.0  # standard deviations by which logs have to contradict the others: once in a million
SAME = 6.0  # of chi^2: odds of twenty to one
UNKNOWN = 1e150  # standard deviations of what a log says nothing of, whose weight is still a number
DIFFER = ("G", "tau", "f0")  # of which G and tau as logarithms


BENT = 4  # temperatures: a line and what bends it go through any three
SHOWS = 4.0  # times a log's noise, as a response that would be seen
DEAD = (
    "{}: its rows are noise, and do not answer its drive as the other logs do; see whether the drive and the"
    " sensor were on, or leave it out"
)


class Told(NamedTuple):
    """What each log, fitted alone, tells of a parameter, less what all tell of it together there: values (n,)
    and standard deviations; they follow columns (n, K) if no log is odd."""

    values: np.ndarray
    errors: np.ndarray
    columns: np.ndarray

    def scatter(self, odd: Sequence[int] = ()) -> float:
        """chi^2 about these columns, and about an offset that the odd logs share."""
        shared = np.isin(np.arange(len(self.values)), odd)[:, None] * 1.0
        rows = np.hstack([self.columns, shared]) / self.errors[:, None]
        target = self.values / self.errors
        return float(np.sum((target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]) ** 2))

    def dispersion(self) -> np.ndarray:
        """(K, K) covariance of the columns' coefficients about the joint fit's, which are 0, where each
        log has a value of its own beside what it tells: that of the weighted mean, and how far the joint one
        is off it (DerSimonian & Laird, see `verdict.differing`); 0 where they agree."""
        known = self.errors < UNKNOWN
        values, variance, x = self.values[known], self.errors[known] ** 2, self.columns[known]
        left = max(len(values) - int(np.linalg.matrix_rank(x)), 0)
        rest = values - x @ np.linalg.lstsq(x, values, rcond=None)[0]
        own = float(np.sum(rest**2)) / left - float(np.mean(variance)) if left else 0.0
        if own <= 0:
            return np.zeros((x.shape[1], x.shape[1]))
        inverse = np.linalg.pinv(x.T @ (x / (own + variance)[:, None]))
        off = inverse @ x.T @ (values / (own + variance))
        return inverse + np.outer(off, off)

    def bend(self) -> float:
        """The coefficient of the square of the second column, beside these: how a resonance bends over the
        temperature; 0 where no four logs of temperatures of their own tell it."""
        rows = np.column_stack([self.columns, self.columns[:, 1] ** 2]) / self.errors[:, None]
        if len(np.unique(self.columns[:, 1])) < BENT:
            return 0.0
        return float(np.linalg.lstsq(rows, self.values / self.errors, rcond=None)[0][2])

    def cut(self) -> tuple[float, list[int]]:
        """The odd logs, a single one or the smaller of two groups by their values or by their order, as
        before and after something was changed: the fewest of those beside which all scatter hardly more than
        least, and of these the farthest off; by how much less than without them."""
        n = len(self.values)
        orders = np.argsort(self.values), np.arange(n)
        groups = [min(order[:k], order[k:], key=len) for order in orders for k in range(1, n)]
        left = {x: self.scatter(x) for x in [(k,) for k in range(n)] + [tuple(np.sort(x)) for x in groups]}
        likely = [x for x in left if left[x] <= min(left.values()) + SAME]
        best = min(likely, key=lambda x: (len(x), -np.max(np.abs(self.values / self.errors)[list(x)])))
        return self.scatter() - left[best], list(map(int, best))


class Odd(NamedTuple):
    """Logs that contradict others; what they add to the covariance (6, 6) of theta: one plate is no better
    known than they agree, and what does not answer adds nothing; and by how much the resonances that each
    tells by itself bend over the temperature, Hz/degC^2."""

    finding: Finding
    dispersion: np.ndarray
    bend: float = 0.0


def odd_ones(minimiser: Minimiser, trials: Sequence[Trial], together: State) -> Odd | None:
    """The logs, the fewest, that contradict the others, where they and the others are each described well,
    or next to nothing is left beside what they differ by; all, where each is described by itself; else
    None."""
    if len(trials) < 2 or any(touched(t) or clipped(t) for t in together.trials):
        return None
    if dead := _dead(minimiser, trials, together):
        return Odd(_found([trials[k] for k in dead], DEAD), np.zeros((len(NAMES), len(NAMES))))
    each = [_alone(minimiser, (t,), together) for t in trials]
    told = _told(minimiser, trials, each, together)
    found = _odd(minimiser, trials, together, each, told)
    bend = told["f0"].bend() if "k_T" in minimiser.free else 0.0
    return None if found is None else Odd(found, _dispersion(told), bend)


def _dead(minimiser: Minimiser, trials: Sequence[Trial], together: State) -> list[int]:
    """Logs whose rows are noise, and in which the plate of the others would show at their drive."""
    noise = [k for k, t in enumerate(trials) if t.driven and buried((t,))]
    others = tuple(t for k, t in enumerate(trials) if k not in noise)
    if not (noise and others):
        return []
    theta = _alone(minimiser, others, together).theta
    asked = {k: LogResponse.of(trials[k], minimiser.reference, theta).forced for k in noise}
    response = {k: trials[k].log.response for k in noise}
    still = [k for k in noise if abs(np.mean(response[k])) < SHOWS * np.std(response[k])]  # else it answers
    return [k for k in still if np.ptp(np.abs(asked[k])) > SHOWS * np.std(response[k])]


def _odd(
    minimiser: Minimiser,
    trials: Sequence[Trial],
    together: State,
    each: Sequence[State],
    told: Mapping[str, Told],
) -> Finding | None:
    """The same without what it adds, by what each log tells by itself."""
    for odd in _splits(trials, together, told):
        parts = [[k for k in range(len(trials)) if (k in odd) is own] for own in (True, False)]
        alone, rest = (
            each[part[0]] if len(part) == 1 else _alone(minimiser, tuple(trials[k] for k in part), together)
            for part in parts
        )
        beside = PROMISES * (alone.likelihood + rest.likelihood - together.likelihood)
        found = _contradiction(minimiser, trials, odd, alone, rest)
        if found and all(described(minimiser.beside(s.trials), s, beside) for s in (alone, rest)):
            return found
    said = _scattered(told, trials, together.named.k_T) if len(trials) > 2 else None
    if said and all(described(minimiser.beside(s.trials), s) for s in each):
        return _found(trials, said)
    return None


def _dispersion(told: Mapping[str, Told]) -> np.ndarray:
    """(6, 6) of theta, of logs that are of no one plate."""
    added = np.zeros((len(NAMES), len(NAMES)))
    for name, of in told.items():
        index = [NAMES.index(n) for n in (("f0", "k_T") if name == "f0" else (name,))]
        added[np.ix_(index, index)] += of.dispersion()[: len(index), : len(index)]
    return added


def _alone(minimiser: Minimiser, trials: tuple[Trial, ...], together: State) -> State:
    """What these logs say by themselves, of images of a plate the one that is nearest to what all say, and
    what all say of k_T, if they are at one temperature. Its errors span what they may hold and do not show,
    as a delay of a lone step."""
    state = min(minimiser.minima(trials), key=lambda s: abs(s.named.f0 - together.named.f0))
    beside = minimiser.beside(trials)
    if beside.free != minimiser.free:
        theta, k_T = state.theta.copy(), NAMES.index("k_T")
        theta[NAMES.index("f0")] += (theta[k_T] - together.theta[k_T]) * warmth(minimiser, trials)
        theta[k_T] = together.theta[k_T]
        state = beside.refine(trials, theta, ESTIMATED)
    looked = misfits(state, minimiser.reference, beside.free, None).in_colour(state, minimiser.reference)
    return replace(state, dispersion=looked.average().covariance)


def _found(trials: Sequence[Trial], said: str) -> Finding:
    names = tuple(t.log.name for t in trials)
    return Finding("odd", "refused", said.format(", ".join(names)), names)


def _told(
    minimiser: Minimiser, trials: Sequence[Trial], each: Sequence[State], together: State
) -> dict[str, Told]:
    """By name of a parameter. The resonance is free to follow the temperature."""
    warm, found = np.array([warmth(minimiser, (t,)) for t in trials]), {}
    for name in (n for n in DIFFER if n in minimiser.free):
        values, errors = np.array([apart(s, together, name, w) for s, w in zip(each, warm, strict=True)]).T
        follows = name == "f0" and "k_T" in minimiser.free
        found[name] = Told(values, errors, np.stack([np.ones(len(warm)), follows * warm], axis=1))
    return found


def _splits(trials: Sequence[Trial], together: State, told: Mapping[str, Told]) -> list[list[int]]:
    """The logs that may be odd: the smaller of two groups by what each tells alone, and the one that the fit
    of all leaves most of. Of two either may be."""
    left = int(np.argmax([_left(t, m) for t, m in zip(together.trials, together.models, strict=True)]))
    if len(trials) == 2:
        known = [was_read(t.log) for t in trials]
        return [[known.index(False) if sum(known) == 1 else left]]
    _, fewest = max(x.cut() for x in told.values())
    return [fewest] if fewest == [left] else [fewest, [left]]


def _contradiction(
    minimiser: Minimiser, trials: Sequence[Trial], odd: Sequence[int], alone: State, rest: State
) -> Finding | None:
    """What `odd` logs, described by `alone`, are beside the others; None where that may be chance."""
    some, logs = [trials[k] for k in odd], [t.log for t in trials]
    others = [log for k, log in enumerate(logs) if k not in odd]
    warm = warmth(minimiser, some)
    differ = {n: apart(alone, rest, n, warm) for n in DIFFER if n in minimiser.free}
    name = max(differ, key=lambda n: abs(differ[n][0]) / differ[n][1])
    value, error = differ[name]
    if abs(value) < APART * error:
        return None
    said: str | None
    if touch := _touch(differ):
        said = finger("{}", warmer(logs, odd))(np.array([touch]), None)
    elif name == "f0":
        k_T = float(rest.named.k_T) if "k_T" in minimiser.free else 0.0
        said = elsewhere("{}", [t.log for t in some], others, value, k_T)
    else:
        said = own("{}", name, times(float(np.expm1(value)) if value > 0 else value), len(odd) > 1)
    found = None if said is None else _found(some, said)
    return replace(found, key="finger") if found is not None and touch else found


def _touch(apart: dict[str, tuple[float, float]]) -> float:
    """By how much log G and log tau are both lower than those of the others, as under a finger; 0 where they
    are not, or not by the same, or where it may as well be one of them alone."""
    values, errors = np.array([apart.get(n, (0.0, 1.0)) for n in ("G", "tau")]).T
    alike, one = (values[0] - values[1]) ** 2 / np.sum(errors**2), np.min((values / errors) ** 2)
    if np.any(values > 0) or alike > SAME or one < alike + SAME:
        return 0.0
    return float(-np.sum(values / errors**2) / np.sum(errors**-2.0))


def _scattered(told: Mapping[str, Told], trials: Sequence[Trial], k_T: float) -> str | None:
    """Of logs of which each tells another value of a parameter; None where that may be chance."""
    name = max(told, key=lambda n: told[n].scatter())
    (values, errors, _), hertz = told[name], name == "f0"
    if told[name].scatter() < APART**2 * (len(values) - 1):
        return None
    by, error = (x if hertz else 100 * x for x in (np.std(values, ddof=1), np.median(errors)))
    what, unit = ("the resonance", "Hz") if hertz else (name, "%")
    or_else = "; or fit a gain of each log, --effects=+gain" if name == "G" else ""
    if hertz and k_T and by < OFF * abs(k_T) and all(was_read(t.log) for t in trials):
        or_else = f"; or the plate was {by / abs(k_T):.2g} degC off what was read: state temperature_std_degC"
    return (
        f"{{}}: each is described by itself, but {what} differs from one to the next, by {by:.2g} {unit}"
        f" (standard deviation), and is known to {error:.1g} {unit}; check what was changed between"
        f" them{or_else}"
    )


def warmth(minimiser: Minimiser, trials: Sequence[Trial]) -> float:
    """Mean temperature of logs, in degC above the reference."""
    return float(np.mean([np.mean(t.hold(minimiser.reference).warming) for t in trials]))


def _left(trial: Trial, model: np.ndarray) -> float:
    """Root mean square of what the model leaves of a log, over what its neighbouring rows do not share."""
    left = trial.residual(model)
    if len(left) < 3:
        return 0.0
    return float(np.sqrt(2 * np.mean(np.abs(left) ** 2) / max(np.mean(np.abs(np.diff(left)) ** 2), 1e-300)))


def apart(alone: State, rest: State, name: str, warm: float) -> tuple[float, float]:
    """By how much log G, log tau, or the resonance at `warm` degC, differ, and the standard deviation of
    that."""
    row = carried(warm)[DIFFER.index(name)]
    value, variance = row @ (alone.theta - rest.theta), row @ (alone.spread + rest.spread) @ row
    return float(value), float(np.sqrt(variance)) if 0 < variance < np.inf else UNKNOWN
