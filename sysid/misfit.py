"""Does the model describe the logs? Each thing that it leaves out is tried as one more term, to first order.

For a term with shapes A, its coefficients are fitted beside the plant's parameters and the nuisances of every log (white
weights), the noise of the logs is estimated anew from what is then left, and the gain in log-likelihood is what the term is
worth. A term counts as found when that exceeds ENOUGH plus the logarithm of the number of terms that were tried. It makes the
fit a misfit when including it would move G, tau or f0 out of their intervals; else it is a warning.

Cook & Weisberg, Residuals and Influence in Regression (1982), added variables and one-step influence.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from sysid.experiment import Trial, freedom
from sysid.minimise import NAMES, State
from sysid.noise import log_likelihood
from sysid.perturbed import Course, accumulated

ENOUGH = 5.0  # log-likelihood: one of a hundred good fits is doubted
UNCHANGED = 0.01  # sum of squares in units of the noise
ROUGH = 5.0  # by which a residual is larger than the noise between its neighbours, and
MOST = 0.3  # share of a log that it is, when the log is not what the model is about
LATE = 2.0  # standard deviations of its prior, by which a response may be late before more than its first order matters
MOVES = 2.0  # standard deviations of G, tau or f0
BESIDE = 2.0 ** np.arange(-1, 6)  # half bandwidths from the resonance at which a second one is looked for, on both sides


@dataclass(frozen=True)
class Term:
    """Something left out: `shapes`, of some logs (by position), (n, m) in the unit of the response, complex or real."""

    name: str
    shapes: dict[int, np.ndarray] = field(repr=False)
    say: Callable[[np.ndarray, "View"], str | None]  # of the m coefficients; None: that sign or size makes no sense
    log: int | None = None  # the one log that it is about
    freedom: int = 1  # numbers that it has, its place on a grid among them
    beside: tuple[str, float] | None = None  # a parameter that it moves besides, by so much for a coefficient of one


@dataclass(frozen=True)
class Found:
    """A term that the logs hold."""

    sentence: str
    worth: float  # log-likelihood
    moves: dict[str, float]  # by parameter, in its standard deviations
    name: str
    log: int | None

    freedom: int  # numbers that it has

    @property
    def harmful(self) -> bool:
        return any(abs(m) > MOVES for n, m in self.moves.items() if n != "k_T")


class View:
    """One log at the fit: its residual and derivatives, less all that its nuisances can make of them, as real rows.

    `plate` (n,) is the part of the model that is the plate's, not turned by the demodulator; `late` (s) how late it comes.
    """

    def __init__(self, trial: Trial, model: np.ndarray, state: State, reference: tuple[float, float]):
        self.trial, self.late = trial, 0.0
        self.course = Course(trial, trial.hold(reference), state.theta)
        self.model = model.real if trial.log.amplitude_only else model
        self.residual = trial.log.response - self.model
        self.weight = trial.weight / (trial.noise_std or trial.scale)
        self._basis = self._orthonormal(self._nuisances())
        self.recorded = self._rows(self.residual)
        self.r = self.off(self.residual)
        self.derivatives = self.observed(self.course.derivatives(self.plate).T).T
        self.jacobian = np.stack([self.off(c) for c in self.derivatives.T], axis=1)

    def _nuisances(self) -> list[tuple[np.ndarray, float]]:
        """Real columns that the bench may add, with the standard deviation of the prior of each."""
        trial, c, loose = self.trial, self.course, self.trial.looseness
        own: list[Any] = [] if trial.steady else [c.free]
        lateness = trial.lateness
        if not trial.signed:
            self._turn, start = 1.0, trial.start if trial.start_free else 0.0
            self.plate = c.forced + start * c.free - trial.late * c.rate * (lateness > 0)
            self.late = trial.late
            columns = [(s * f, loose) for s in (1.0, 1j) for f in own if trial.start_free]
            columns += [(-c.rate, lateness)] if lateness else []
            real = [(self.observed(s[None])[0], std) for s, std in columns]
            if trial.log.drive is None:
                real.append((np.abs(c.forced), loose))
            return real + ([] if trial.steady else [(0.5 / np.maximum(self.model, 1e-300) * loose**2, 1.0)])
        columns = [*trial.columns.astype(complex)]
        complexes: list[Any] = [*columns, *(own if trial.start_free else []), *([-c.rate * lateness / loose] if lateness else [])]
        rows = self.weight[:, None] * np.stack([c.forced, *complexes], axis=1)
        rows = np.concatenate([rows, np.eye(1 + len(complexes)) / loose])
        rows[len(self.model), 0] = 0.0  # the gain has no prior
        size = np.linalg.norm(rows, axis=0) + 1e-300
        seen = np.append(self.weight * self.model, np.zeros(1 + len(complexes)))
        found = np.linalg.lstsq(rows / size, seen, rcond=1e-12)[0] / size
        self._turn = found[0] / abs(found[0]) if found[0] else 1.0
        start = found[1 + len(columns)] if own and trial.start_free else 0.0
        if lateness:
            self.late = float((found[-1] / self._turn).real) * lateness / loose
        self.plate = (abs(found[0]) if trial.log.drive is None else 1.0) * c.forced + start / self._turn * c.free
        turned = [self._turn * 1j * self.plate] if "rotation" in trial.nuisances or trial.log.drive is None else []
        turned += [self._turn * self.plate] if trial.log.drive is None else []
        return [(s * f, loose) for f in complexes for s in (1.0, 1j)] + [(t, np.inf) for t in turned]

    def observed(self, shapes: np.ndarray) -> np.ndarray:
        """(m, n) shapes of the plate's part as they show in the log."""
        if self.trial.signed:
            return self._turn * shapes
        return (np.conj(self.plate) * shapes).real / np.maximum(self.model, 1e-300)

    def _orthonormal(self, columns: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Basis of the weighted columns, with a row for each one's prior."""
        self._priors = len(columns)
        if not columns:
            return np.zeros((len(self._rows(self.residual)), 0))
        rows = np.stack([np.append(self._rows(c)[: -self._priors or None], np.zeros(self._priors)) for c, _ in columns], axis=1)
        for k, (_, std) in enumerate(columns):
            rows[len(rows) - self._priors + k, k] = 0.0 if np.isinf(std) else 1 / std
        size = np.linalg.norm(rows, axis=0)
        u, s, _ = np.linalg.svd(rows[:, size > 0] / size[size > 0], full_matrices=False)
        return u[:, s > 1e-9 * (s[0] if len(s) else 1.0)]

    def _rows(self, shape: np.ndarray) -> np.ndarray:
        """Real, weighted rows of a shape, and zeros where the priors' rows are."""
        v = self.weight * shape
        real = np.concatenate([v.real, v.imag]) if np.iscomplexobj(self.residual) else v.real
        return np.append(real, np.zeros(self._priors))

    def off(self, shape: np.ndarray) -> np.ndarray:
        rows = self._rows(shape)
        return rows - self._basis @ (self._basis.T @ rows)

    def likelihood(self, rows: np.ndarray) -> float:
        """Log-likelihood of real rows as this log's noise, at its best level and correlation time."""
        n = len(self.trial.log)
        left = rows[:n] + 1j * rows[n : 2 * n] if np.iscomplexobj(self.residual) else rows[:n]
        return log_likelihood(left, self.trial.clock, freedom(self.trial))


def misfits(state: State, reference: tuple[float, float], free: Sequence[str], at: float | None) -> list[Found]:
    """What the logs hold that the model leaves out, the most significant first. `at` (degC): where parameters are reported."""
    views = [View(t, m, state, reference) for t, m in zip(state.trials, state.models, strict=True)]
    index = [NAMES.index(n) for n in free]
    fit = _Linear(views, index, np.sqrt(np.diag(state.covariance))[index], [NAMES[i] for i in index])
    away = 0.0 if at is None else at - reference[1]
    terms = list(chain(*(_of_one(i, v) for i, v in enumerate(views)), _of_all(views, away), _between(views, free)))
    threshold = ENOUGH + np.log(max(len(terms), 1))
    found = [f for t in terms if (f := fit.worth(t, threshold + t.freedom - 1)) is not None]
    found += [strange for i, v in enumerate(views) if (strange := _strange(i, v)) is not None]
    std = float(np.sqrt(state.covariance[1, 1]))
    found += [late for i, v in enumerate(views) if (late := _very_late(i, v, std)) is not None]
    return sorted(found, key=lambda f: 2 * f.freedom - f.worth)


def _very_late(i: int, view: View, std: float) -> Found | None:
    """A response so late that more than the first order of it matters, for log tau of the given standard deviation."""
    lateness = view.trial.lateness
    if not lateness or (abs(view.late) < LATE * lateness and 0.5 * (view.late / view.course.tau) ** 2 < std):
        return None
    column = view.off(view.observed(view.course.rate[None])[0])  # its own prior keeps it from vanishing
    if np.sum(column**2) * view.late**2 < 2 * ENOUGH:
        return None
    return Found(_LATE.format(view.trial.log.name, view.late), 0.5 * (view.late / lateness) ** 2, {"tau": np.inf}, "late", i, 1)


def _strange(i: int, view: View) -> Found | None:
    """A log of which the model leaves most, smooth as it is: by what its own gain is off, if that is what it is."""
    y, left = view.trial.log.response, view.residual
    if len(y) < 8 or view.trial.log.drive is None:
        return None
    rough, total = np.sqrt(np.mean(np.abs(np.diff(left)) ** 2) / 2), np.sqrt(np.mean(np.abs(left) ** 2))
    if total < ROUGH * rough or total < MOST * np.std(y):
        return None
    shape = view.course.forced if view.trial.signed else np.abs(view.course.forced)
    ratio = float(np.abs(np.vdot(shape, y)) / max(np.vdot(shape, shape).real, 1e-300))
    said = (
        f"{view.trial.log.name}: the model leaves {100 * total / np.std(y):.2g} % of it; G contradicts the other logs, about"
        f" {ratio:.3g} times that of theirs; check its units, or leave it out"
    )
    return Found(said, len(y) * float(np.log(total / rough)), {"G": np.inf}, "gain", i, 1)


_LATE = (
    "{}: the response begins late, by a trigger or a demodulator's filter of about {:.2g} s, which cannot be told from tau; state"
    " delay_s, or lockin_tau_s and lockin_order"
)


class _Linear:
    """The joint fit, linearised: what one more term would change."""

    def __init__(self, views: list[View], index: list[int], std: np.ndarray, names: list[str]):
        self.views, self.std, self.names = views, std, names
        self.jacobians = [v.jacobian[:, index] for v in views]
        gram = sum(j.T @ j for j in self.jacobians)
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        self.inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
        self.slope = sum(j.T @ v.r for j, v in zip(self.jacobians, views, strict=True))
        self.before = [v.likelihood(v.recorded) for v in views]

    def worth(self, term: Term, threshold: float) -> Found | None:
        """The term with its gain in log-likelihood and what it moves; None when that is not above `threshold`."""
        rows = {i: np.stack([self.views[i].off(s) for s in shapes.T], axis=1) for i, shapes in term.shapes.items()}
        scale = np.sqrt(sum(np.sum(a**2, axis=0) for a in rows.values()))
        if not np.all(np.isfinite(scale)) or np.all(scale == 0):
            return None
        rows = {i: a / np.where(scale > 0, scale, 1.0) for i, a in rows.items()}
        cross = sum(self.jacobians[i].T @ a for i, a in rows.items())
        own = sum(a.T @ a for a in rows.values()) - cross.T @ self.inverse @ cross
        score = sum(a.T @ self.views[i].r for i, a in rows.items()) - cross.T @ self.inverse @ self.slope
        if np.any(np.diag(own) < 1e-6):  # the plant and the nuisances can do the same
            return None
        value = np.linalg.lstsq(own, score, rcond=1e-10)[0]
        if 0.5 * score @ value < threshold:
            return None
        shift = self.inverse @ (self.slope - cross @ value)
        gained = 0.0
        for i, (view, jacobian) in enumerate(zip(self.views, self.jacobians, strict=True)):
            change = jacobian @ shift + (rows[i] @ value if i in rows else 0.0)
            if change @ change > UNCHANGED:
                gained += view.likelihood(view.r - change) - self.before[i]
        said = term.say(value / np.where(scale > 0, scale, 1.0), self.views[term.log or 0])
        if gained < threshold or said is None:
            return None
        moves = dict(zip(self.names, shift / self.std, strict=True))
        if term.beside is not None and term.beside[0] in moves:
            moves[term.beside[0]] += term.beside[1] * value[0] / scale[0] / self.std[self.names.index(term.beside[0])]
        return Found(said, float(gained), moves, term.name, term.log, term.freedom)


# --- what is tried ----------------------------------------------------------------------------------------------------------


def _of_one(i: int, view: View) -> Iterator[Term]:
    """What one log may hold for itself."""
    trial = view.trial
    if not trial.driven and not trial.steady:
        return
    name, size = trial.log.name, np.abs(view.model)
    for power in (2, 6):
        said = f"{name}: {{}} is compressed at its largest: saturated; record it again within the range"
        yield _term(i, "saturation", size**power * view.model, said.format("the response"), -1)
        if not trial.log.amplitude_only:
            each = view.model.real ** (power + 1) + 1j * view.model.imag ** (power + 1)
            yield _term(i, "saturation", each, said.format("a channel"), -1)
    if trial.resonant:
        yield from _second_resonance(i, view)
        yield from _drift(i, view)
    yield from chain(_too_fast(i, view), _background(i, view)) if trial.steady else _later(i, view)


def _term(i: int, name: str, shape: np.ndarray, sentence: str, sign: int = 0) -> Term:
    """A term of one real number in one log, of the given sign (0: either)."""
    return Term(name, {i: shape[:, None]}, lambda value, _: sentence if value[0] * sign >= 0 else None, i)


def _second_resonance(i: int, view: View) -> Iterator[Term]:
    c = view.course
    half_bandwidth = 1 / (2 * np.pi * c.tau)
    for beside in (*-BESIDE, *BESIDE):
        shape = c.forced_at(c._poles + 2j * np.pi * beside * half_bandwidth)
        shapes = view.observed(np.stack([shape, 1j * shape])).T
        size = np.max(np.abs(shape)) / max(np.max(np.abs(view.plate)), 1e-300)

        def say(value: np.ndarray, view: View, beside: float = beside, size: float = size) -> str:
            share = 100 * size * np.hypot(*value)
            return (
                f"{view.trial.log.name}: a second resonance, about {abs(beside) * half_bandwidth:.3g} Hz"
                f" {'above' if beside > 0 else 'below'} the first and of {share:.2g} % of its response; leave its frequencies out"
            )

        yield Term("second resonance", {i: shapes}, say, i, freedom=3)


def _drift(i: int, view: View) -> Iterator[Term]:
    """A resonance that moves in proportion to the time, or to the heat that the plate has made since the first row."""
    c, log = view.course, view.trial.log
    order = np.arange(len(log)) if log.time is None else log.time
    heat = np.append(0.0, np.cumsum(np.diff(order) * np.abs(view.plate[1:]) ** 2))
    for along, why in ((order - order[0], "drifts"), (heat, "drifts as the plate heats itself,")):
        if np.ptp(along) == 0:
            continue
        shape = view.observed(c.response_to(2j * np.pi * along / np.ptp(along) * view.plate)[None])[0]

        def say(value: np.ndarray, _: View, why: str = why) -> str:
            return (
                f"{log.name}: its resonance {why} by {value[0]:+.3g} Hz from the first row to the last; record the temperature of"
                " every row, or wait until it is constant"
            )

        yield Term("drift", {i: shape[:, None]}, say, i)


def _too_fast(i: int, view: View) -> Iterator[Term]:
    """Settled points that had not settled: after a dwell d each, Z_k = S_k + (Z_(k-1) - S_k) e^{a_k d}, S what it settles at."""
    log, c = view.trial.log, view.course
    if log.frequency is None or len(log) < 8 or np.mean(np.sign(np.diff(log.frequency))) ** 2 < 0.5:
        return
    for dwell in (0.5, 1.0, 2.0, 4.0):
        decay = c.pole * c.tau * dwell
        left = accumulated(decay[1:], -np.exp(decay[1:]) * np.diff(view.plate))
        said = (
            f"{log.name}: swept too fast for settled points (dwell about {dwell:.2g} tau); dwell {6 * c.tau:.2g} s or longer at"
            " each frequency, or record the time of every row and say kind: transient"
        )
        yield _term(i, "swept too fast", view.observed(np.append(0.0, left)[None])[0], said, 1)


def _background(i: int, view: View) -> Iterator[Term]:
    """What lies in parallel to the resonance or behind it, over a sweep: a cable's delay, a background that bends."""
    log = view.trial.log
    if log.frequency is None or np.ptp(log.frequency) == 0 or not view.trial.signed:
        return
    x = (log.frequency - np.mean(log.frequency)) / np.ptp(log.frequency)

    def late(value: np.ndarray, _: View) -> str:
        seconds = -value[0] / (2 * np.pi * np.ptp(log.frequency))
        return f"{log.name}: its phase falls along the sweep as behind a delay of {seconds:.2g} s; take that out of the phase"

    def bent(value: np.ndarray, _: View) -> str:
        return f"{log.name}: a background that is not a straight line of the frequency; sweep a narrower range about the peak"

    yield Term("phase delay", {i: (1j * x * view.model)[:, None]}, late, i)
    shape = (x**2 * view.trial.inputs.drive[view.trial.inputs.interval] + 0j)[:, None]
    yield Term("background", {i: np.concatenate([shape, 1j * shape], axis=1)}, bent, i, freedom=2)


def _later(i: int, view: View) -> Iterator[Term]:
    """A transient whose response comes late by more than a row, or through a filter."""
    c, log = view.course, view.trial.log
    if not view.trial.changes and not view.trial.from_rest:
        return
    for rows in (1.5, 3, 6, 12):
        delay = rows * view.trial.spacing
        if delay < 2 * c.tau:
            shape = view.observed((c.forced_at(c._poles, delay) - c.forced)[None])[0]
            yield _term(i, "late", shape, _LATE.format(log.name, delay), 1)
    for share in (0.1, 0.3):
        for order in (1, 4):
            shape = view.observed((c.filtered(c.forced, share * c.tau / order, order) - c.forced)[None])[0]
            yield _term(i, "late", shape, _LATE.format(log.name, share * c.tau), 1)


def _of_all(views: list[View], away: float) -> Iterator[Term]:
    """What every log would hold: the plate's own nonlinearity, the amplifier's, what changes with temperature; parameters are
    reported `away` (degC) from the logs' mean temperature."""
    resonant = {i: v for i, v in enumerate(views) if v.trial.resonant and (v.trial.driven or not v.trial.steady)}
    top = max((float(np.max(np.abs(v.plate))) for v in resonant.values()), default=0.0)
    if top > 0:
        moved = {i: _changed(v, np.abs(v.plate / top) ** 2 * v.plate) for i, v in resonant.items()}
        unit = views[0].trial.log.response_unit

        def softer(value: np.ndarray, view: View) -> str:
            hz, slower = value[1] / (2 * np.pi), -value[0] * view.course.tau
            about = f"by about {hz:+.2g} Hz in f0 and {100 * slower:+.2g} % in 1/tau at {top:.2g} {unit}"
            return f"damping and frequency depend on the amplitude, {about} (hysteresis in a sweep); record at a smaller drive"

        yield Term("amplitude", moved, softer, freedom=2)
    levels = np.concatenate([np.abs(v.trial.inputs.drive) for v in views if v.trial.log.drive is not None] or [np.zeros(1)])
    if len(np.unique(levels[levels > 0])) > 1:
        cubed = {i: _driven(v, v.course.push * (v.trial.inputs.drive[v.trial.inputs.interval] / levels.max()) ** 2)
                 for i, v in enumerate(views) if v.trial.log.drive is not None}  # fmt: skip
        yield Term("drive", cubed, _out_of_proportion)
    warm = [float(np.mean(v.course.hold.warming)) for v in views]
    if np.ptp(warm) > 1.0:
        for k, symbol in enumerate(("G", "tau")):
            shapes = {i: v.derivatives[:, k : k + 1] * w for i, (v, w) in enumerate(zip(views, warm, strict=True))}
            yield Term("temperature", shapes, _per_degree(symbol), beside=(symbol, away))


def _out_of_proportion(value: np.ndarray, _: View) -> str:
    return (
        f"the response is not proportional to the drive, by about {100 * value[0]:+.2g} % at its largest: an amplifier that"
        " clips, or a duty ratio whose voltage is not stated; state the voltage itself"
    )


def _per_degree(symbol: str) -> Callable[[np.ndarray, View], str]:
    return lambda value, _: (
        f"{symbol} changes with the temperature, by {100 * value[0]:+.2g} % per degC; fit logs of one temperature, or hold it"
    )


def _changed(view: View, epsilon: np.ndarray) -> np.ndarray:
    """(n, 2): what real and imaginary multiples of epsilon add."""
    return view.observed(np.stack([view.course.response_to(epsilon), view.course.response_to(1j * epsilon)])).T


def _driven(view: View, push: np.ndarray) -> np.ndarray:
    """(n, 1): what one more push adds."""
    return view.observed(view.course.response_to(push, push)[None]).T


def _between(views: list[View], free: Sequence[str]) -> Iterator[Term]:
    """What one log would have for itself if it contradicts the others."""
    if len(views) < 2:
        return
    for i, v in enumerate(views):
        name, columns = v.trial.log.name, v.derivatives
        yield Term("finger", {i: -columns[:, :2].sum(axis=1, keepdims=True)}, _finger(name), i)
        yield Term("gain", {i: columns[:, :1]}, _own(name, "G", lambda x: f"{np.exp(x):.4g} times that"), i)
        yield Term("tau", {i: columns[:, 1:2]}, _own(name, "tau", lambda x: f"{np.exp(x):.4g} times that"), i)
        if "f0" in free:
            yield Term("resonance", {i: columns[:, 2:3]}, _own(name, "the resonance", lambda x: f"{x:+.4g} Hz off that"), i)


def _finger(name: str) -> Callable[[np.ndarray, View], str | None]:
    def say(value: np.ndarray, _: View) -> str | None:
        if value[0] <= 0:
            return None
        return (
            f"{name}: G and tau are both lower than in the other logs, by about the factor {np.exp(-value[0]):.2g}: a finger, or"
            " something else that damps, was left on the plate; leave this log out"
        )

    return say


def _own(name: str, what: str, put: Callable[[float], str]) -> Callable[[np.ndarray, View], str]:
    return lambda value, _: (
        f"{name}: {what} contradicts the other logs, about {put(float(value[0]))} of theirs; check its units, its sensor and its"
        " temperature, or leave it out"
    )
