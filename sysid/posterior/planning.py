"""Which experiment next: the step or sweep that shrinks the error of one parameter, or betters what is
promised of the closed loop, most per second at the bench.

What a log of known noise would tell is known before it is recorded: its Fisher information J^T J about theta,
less what its own nuisances take (Atkinson, Donev & Tobias, Optimum Experimental Designs, 2007). It adds to
that of the logs there are, and the error that is then left, or what a controller promises with it, stands
against the seconds that recording takes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from sysid.asked import FIT, every, given, number
from sysid.logs.log import Log
from sysid.model.theta import NAMES, PLANT, std_of
from sysid.posterior.foreseen import PROMISES, Advised, Design, Raised, promised
from sysid.posterior.mixture import Mixture
from sysid.shown import Shown
from sysid.trials.noise import Level
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial, with_noise
from sysid.verdict.fitted import Fit
from sysid.verdict.gain_confounding import loosened
from sysid.verdict.identify import RELATIVE, limits, seconds, shows_transient
from sysid.verdict.linearised import LinearisedLog

# times the limit of what counts as determined: the error of a parameter of which the logs say nothing
UNKNOWN = 10.0
KNOWN = 1.0  # of the error of log tau: beyond, no experiment can be laid out in units of tau
PLATES = 32  # that the logs leave possible, for each of which an experiment is foreseen
# the same of where the resonance is, to foresee what an experiment laid out for another place brings
ASIDE = 2.0
BETWEEN = (0.05, 0.5, 0.95)  # quantiles of what it leaves of an error
SAME = 1.2  # ratio of the outer two below which they are one number
AWAY = 10.0  # degC, to another temperature
FINE = 20  # rows per tau, where the logs do not say what the bench can do
MOST = 4000  # rows of a step
DWELL = 6.0  # tau at each point of a sweep
WORTH = 0.95  # of its error is what an experiment must leave of it at most
EXACT = 1e-16  # variance of what is known exactly
REST = 0.1  # share of a step's rows before it


@dataclass(frozen=True)
class Experiment:
    """A voltage step at one frequency, or settled points over a range of them; `record` seconds long."""

    kind: str  # "step" | "sweep"
    drive: float
    frequency: tuple[float, float]  # Hz, the first and the last row's
    temperature: float | None  # degC
    rows: int
    record: float  # s
    unit: str  # of the drive

    def __str__(self) -> str:
        at = "" if self.temperature is None else f", at {self.temperature:.1f} degC"
        low, high = self.frequency
        if self.kind == "step":
            span = f"{seconds(self.record)} long, {seconds(REST * self.record)} at rest before"
            return f"a step to {self.drive:.3g} {self.unit} at {low:.8g} Hz, {span}, {self.rows} rows{at}"
        dwell = seconds(self.record / self.rows)
        return (
            f"a sweep from {low:.8g} to {high:.8g} Hz at {self.drive:.3g} {self.unit}, {self.rows} points,"
            f" {dwell} at each{at}"
        )

    def log(self, response: np.ndarray, like: Log) -> Log:
        """Its log, with units as those of another."""
        step, rest = self.kind == "step", int(REST * self.rows)
        return Log(
            self.kind,
            response,
            time=np.linspace(0.0, self.record, self.rows) if step else None,
            drive=np.where((np.arange(self.rows) < rest) & step, 0.0, self.drive),
            frequency=np.linspace(*self.frequency, self.rows),
            temperature=None if self.temperature is None else np.full(self.rows, self.temperature),
            kind="transient" if step else "steady",
            sampling="instant" if step else None,
            response_unit=like.response_unit,
            drive_unit=self.unit,
        )


@dataclass(frozen=True, repr=False)
class Advice(Shown):
    """An experiment, with the standard deviation of a parameter before and after it and its seconds at the
    bench; `limit` is the largest standard deviation that counts as determined. What is left after it depends
    on the plate, of which the logs leave several possible: `after` is the median over them, `between` the 5
    and 95 % quantiles."""

    experiment: Experiment
    parameter: str
    before: float
    after: float
    seconds: float
    limit: float
    unit: str
    between: tuple[float, float]

    def _brief(self) -> Any:
        from sysid.report.brief import of_advice

        return of_advice(self)

    def __str__(self) -> str:
        before = (
            "what the logs do not tell"
            if self.before > 0.9 * UNKNOWN * self.limit
            else f"± {self.before:.2g}"
        )
        low, high = self.between
        after = f"between ± {low:.2g} and ± {high:.2g}" if self.rough else f"± {self.after:.2g}"
        return (
            f"{self.experiment}: {self.parameter} from {before} to {after} {self.unit}, in"
            f" {self.seconds:.3g} s"
        )

    @property
    def rough(self) -> bool:
        """Whether the logs leave open what it brings."""
        low, high = self.between
        return high > SAME * low

    @property
    def rate(self) -> float:
        """Factors of e that the error loses per second."""
        return float(np.log(self.before / self.after)) / self.seconds

    @property
    def settles(self) -> bool:
        """Whether the parameter is determined afterwards."""
        return self.after <= self.limit

    @property
    def worthwhile(self) -> bool:
        """Whether the error shrinks by more than a little."""
        return self.after < WORTH * self.before


UNFORESEEN = (
    "no step or sweep can be laid out: no log with a drive and a frequency tells tau well enough to count in"
    " it; record what open parameters ask for"
)
NO_HELP = f"no step or sweep takes as much as {100 * (1 - WORTH):.0f} % off the error of {{}}"


def advise(
    fit: Fit,
    parameter: str = "worst",
    *,
    design: Design | None = None,
    drive: float | None = None,
    temperatures: Sequence[float] | None = None,
    setup: float = 10.0,
    warming: float = 600.0,
) -> Advised:
    """What to record next for `parameter` (worst: the one furthest from what counts as determined), the best
    first: of each kind of experiment and temperature the one that shrinks its error most per second, those
    that settle it before others, none that hardly shrinks it.

    Or for what is promised of the closed loop: "margin" (its disk margin), "settling" (its settling time), as
    `design`, for example `functools.partial(controller.design, finger=1.0)`, promises it of a posterior: the
    one that raises the margin, or the inverse of the settling time, most per second.

    `drive`: peak, default the largest of the logs. `temperatures` (degC) that the bench can reach, default
    the logs' own and AWAY on either side. `setup` s for each experiment, `warming` s for each that is not at
    the logs' temperature. Noise is that of the logs of that kind, else of all. Empty, with the reason for
    `why`, when no log has a drive and a frequency, or tau is a guess, or nothing helps. Raises ValueError
    for a parameter that there is not, for k_T where no log has a temperature, for a promise without a design,
    and where the design refuses a plate that is known exactly; TypeError for what is no fit.
    """
    given("fit", fit, Fit, FIT)
    given("design", design, Callable | None, "controller.design, or functools.partial of it")
    drive = None if drive is None else number("drive", drive)
    temperatures = None if temperatures is None else every("temperatures", temperatures, Real, "degC")
    _refuse_asked(fit, parameter, design)
    benches = [b for mode in fit.modes if (b := _Bench.of(replace(fit, modes=(mode,)))) is not None]
    if not benches:
        return Advised.none(UNFORESEEN)
    if design and parameter in PROMISES:
        promises = [_promise(b, parameter, design) for b in benches]
        judges, none = [judge for judge, _ in promises], promises[0][1].had
        if not any(most.worthwhile for _, most in promises):
            return Advised.none(none)
    else:
        judges = [_error(b, parameter) for b in benches]
        none = NO_HELP.format("the least known parameter" if parameter == "worst" else parameter)
    best: dict[tuple, Advice | Raised] = {}
    for e in benches[0].experiments(drive, temperatures):
        took, key = setup + e.record + (warming if benches[0].elsewhere(e) else 0.0), (e.kind, e.temperature)
        # It must help whichever of the solutions is true.
        found = min(
            (judge(e, b.after(e), took) for b, judge in zip(benches, judges, strict=True)), key=_merit
        )
        if found.worthwhile:
            best[key] = max(best.get(key, found), found, key=_merit)
    if not best:
        return Advised.none(none)
    spread = [_spread(a, benches) if isinstance(a, Advice) else a for a in best.values()]
    return Advised(sorted(spread, key=_merit, reverse=True))


def _refuse_asked(fit: Fit, parameter: str, design: Design | None) -> None:
    """What no experiment can be laid out for: ValueError."""
    if parameter not in (*PLANT, "worst", *PROMISES):
        raise ValueError(f"found {parameter!r}, expected one of {', '.join((*PLANT, 'worst', *PROMISES))}")
    if parameter in PROMISES and design is None:
        raise ValueError(
            f"{parameter!r} is promised by a design, and none is given; expected design=controller.design"
        )
    if parameter == "k_T" and all(f.log.temperature is None for f in fit.logs):
        raise ValueError(
            "found no temperature in any log, expected one where k_T is asked for; record sweeps at two"
            " temperatures, 10 degC apart, with the temperature of each"
        )


def _spread(advice: Advice, benches: "Sequence[_Bench]") -> Advice:
    """What it brings, over the plates that the logs leave possible, whichever of the solutions is true."""
    index = PLANT.index(advice.parameter)
    low, after, high = np.quantile(
        [e[index] for b in benches for e in b.foreseen(advice.experiment)], BETWEEN
    )
    return replace(advice, after=float(after), between=(float(low), float(high)))


def _merit(advice: Advice | Raised) -> tuple[bool, float]:
    return advice.settles, advice.rate


# by the information (6, 6) after it, and its seconds
Judge = Callable[[Experiment, np.ndarray, float], Advice | Raised]


def _error(bench: "_Bench", parameter: str) -> Judge:
    """By the error of a parameter."""
    error = bench.errors(bench.information)
    known = len(PLANT) if bench.warm else PLANT.index("k_T")  # without a thermometer no experiment tells k_T
    chosen = PLANT[int(np.argmax((error / bench.limits)[:known]))] if parameter == "worst" else parameter
    index, unit = PLANT.index(chosen), bench.fit.units[chosen]
    before, limit = float(error[index]), float(bench.limits[index])

    def judge(e: Experiment, told: np.ndarray, took: float) -> Advice:
        after = float(bench.errors(told)[index])
        return Advice(e, chosen, before, after, took, limit, unit, (after, after))

    return judge


def _promise(bench: "_Bench", name: str, design: Design) -> tuple[Judge, Raised]:
    """By what is promised of the closed loop; and the most that any experiment can bring."""

    def of(covariance: np.ndarray) -> float:
        try:
            return promised(bench.fit, covariance, design, PROMISES[name])
        except ValueError:  # too little is known for a controller
            return PROMISES[name].without

    best = promised(bench.fit, EXACT * np.eye(len(NAMES)), design, PROMISES[name])
    before = of(bench.covariance(bench.information))
    return (lambda e, told, took: Raised(e, name, before, of(bench.covariance(told)), best, took)), Raised(
        None, name, before, best, best, 1.0
    )


def _information(trials: Sequence[Trial], fit: Fit) -> np.ndarray:
    """(6, 6) of theta, from the logs of the fit and what was known before."""
    state = fit.modes[0]
    found = state.prior.precision.copy()
    for trial, model in zip(trials, state.models, strict=True):
        jacobian = LinearisedLog(trial, model, state, fit.reference, coloured=True).jacobian
        found += trial.noise.told * jacobian.T @ jacobian
    if not np.any(state.dispersion):
        return found
    spread = np.linalg.solve(
        np.eye(len(found)) + state.dispersion @ found, state.dispersion
    )  # (A^-1 + D)^-1, A singular or not
    return found - found @ spread @ found


@dataclass(frozen=True)
class _Bench:
    """What the fit knows of plant and bench. Errors are standard deviations of the parameters in their
    units."""

    fit: Fit
    trials: tuple[Trial, ...]  # with a drive and a frequency
    information: np.ndarray  # (6, 6) of theta, from all logs
    beside: np.ndarray  # the same beside a sweep: with wide priors of what a lone step does not tell from G
    limits: np.ndarray
    units: np.ndarray  # of the parameters per unit of theta

    @classmethod
    def of(cls, fit: Fit) -> "_Bench | None":
        """None where there is nothing to go by."""
        state = fit.modes[0]
        trials = tuple(t for t in state.trials if t.resonant and t.driven)
        if not trials or std_of(state.spread, "tau") > (KNOWN if shows_transient(state.trials) else RELATIVE):
            return None
        alone, beside = (_information(t, fit) for t in (state.trials, [loosened(t) for t in state.trials]))
        known = limits(state.G, state.tau)
        units = np.array([state.G, state.tau, 1.0, 1.0, 1.0, 1.0])
        return cls(fit, trials, alone, beside, np.array([known[n] for n in NAMES]), units)

    def covariance(self, information: np.ndarray, aside: float = UNKNOWN) -> np.ndarray:
        """(6, 6) of theta, with the little that is known of a parameter of which the logs say nothing;
        `aside` of f0 and k_T."""
        unknown = np.where(np.isin(NAMES, ("f0", "k_T")), aside, UNKNOWN)
        return np.linalg.inv(information + np.diag((self.units / (unknown * self.limits)) ** 2))

    def errors(self, information: np.ndarray) -> np.ndarray:
        """(6,) standard deviations of the parameters."""
        return self.units * np.sqrt(np.diag(self.covariance(information)))

    def after(self, experiment: Experiment, theta: np.ndarray | None = None) -> np.ndarray:
        """(6, 6) information of theta with a log of it, of the plate `theta` (the fitted one), beside those
        there are."""
        return (self.beside if experiment.kind == "sweep" else self.information) + self.told_by(
            experiment, theta
        )

    def foreseen(self, experiment: Experiment) -> Iterator[np.ndarray]:
        """(6,) errors of the parameters after an experiment, for one plate after the other that the logs
        leave possible."""
        scale = np.linalg.cholesky(self.covariance(self.information, ASIDE))
        even = Mixture(self.fit.modes[0].theta[None], scale[None], np.ones(1)).spread(
            PLATES, np.random.default_rng(0)
        )
        return (self.errors(self.after(experiment, theta)) for theta in even)

    def told_by(self, experiment: Experiment, theta: np.ndarray | None = None) -> np.ndarray:
        """(6, 6) information of theta that a log of it would hold."""
        state, reference = self.fit.modes[0], self.fit.reference
        state = state if theta is None else replace(state, theta=theta)
        steady = experiment.kind == "sweep"
        kind = "steady" if steady else "transient"
        silent = Trial.of(experiment.log(np.ones(experiment.rows, complex), self.trials[0].log), kind)
        response = LogResponse.of(silent, reference, state.theta).forced
        std, time, levels = self._noise(steady)
        if all(t.log.amplitude_only for t in self.trials):
            response = np.hypot(np.abs(response), std)  # noise lifts an amplitude
        trial = with_noise(replace(silent, log=replace(silent.log, response=response)), std, time, levels)
        view = LinearisedLog(trial, response.astype(complex), state, reference, coloured=True)
        return view.jacobian.T @ view.jacobian

    def _noise(self, steady: bool) -> tuple[float, float, tuple[Level, ...]]:
        """Standard deviation per channel and correlation time (s) to be expected; and of d and q, where they
        differ."""
        alike = [t for t in self.trials if t.steady == steady] or self.trials
        std, time = _usual([Level(t.noise.std, 0.0 if t.steady else t.noise.time) for t in alike], steady)
        if not any(t.noise.levels for t in alike):
            return std, time, ()
        each = [[Level(p.std, 0.0 if t.steady else p.time) for p in (2 * t.noise.parts)[:2]] for t in alike]
        return std, time, tuple(_usual(channel, steady) for channel in zip(*each, strict=True))

    def experiments(self, drive: float | None, temperatures: Sequence[float] | None) -> Iterator[Experiment]:
        """Steps on resonance and beside it, sweeps narrow and wide, at each temperature."""
        state, (f, degC) = self.fit.modes[0], self.fit.reference
        tau, hb = state.tau, state.half_bandwidth
        seen = [t.spacing for t in self.trials if t.spacing > 0 and not t.steady]
        spacing = max(min([*seen, tau / FINE]), tau / 200)
        drive = max(float(np.max(np.abs(t.log.drive))) for t in self.trials) if drive is None else drive
        unit = self.trials[0].log.drive_unit
        reached = temperatures or (degC, degC + AWAY, degC - AWAY)
        for at in reached if self.warm else (None,):
            f0 = float(f + state.named.f0 + state.named.k_T * (0.0 if at is None else at - degC))
            for window in (5.0, 10.0, 20.0):
                rows = min(int(window * tau / spacing / (1 - REST)) + 1, MOST)
                for beside in (0.0, -1.0, 1.0):
                    yield Experiment(
                        "step", drive, (f0 + beside * hb,) * 2, at, rows, window * tau / (1 - REST), unit
                    )
            for half in (2.0, 5.0):
                for rows in (21, 101):
                    low = max(f0 - half * hb, 0.05 * f0)
                    yield Experiment(
                        "sweep", drive, (low, f0 + half * hb), at, rows, rows * DWELL * tau, unit
                    )

    @property
    def warm(self) -> bool:
        """Whether temperatures are recorded."""
        return any(t.log.temperature is not None for t in self.trials)

    def elsewhere(self, experiment: Experiment) -> bool:
        """Whether it is at a temperature that no log was recorded at."""
        logs = [t.log.temperature for t in self.trials if t.log.temperature is not None]
        at = experiment.temperature
        return at is not None and not any(np.min(w) - 1.0 <= at <= np.max(w) + 1.0 for w in logs)


def _usual(levels: Sequence[Level], steady: bool) -> Level:
    """Their medians; settled points have no time."""
    std, time = (float(np.median(x)) for x in zip(*levels, strict=True))
    return Level(std, 0.0 if steady else time)
