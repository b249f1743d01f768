"""One log linearised about the fit, for misfits, comparisons and plans: its rows, and what the bench may have
added."""

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.minimum.minimise import State
from sysid.model import rice
from sysid.model.span import REAL, orthonormal
from sysid.trials.noise import log_likelihood
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial, freedom
from sysid.trials.whitening import whitened

ALIKE = 1e-9  # of a column of the bench, which is a sum of others but for as little


class Column(NamedTuple):
    """What the bench may add to a log: `shape` (n,), the standard deviation of its coefficient's `prior`, its
    `value` here."""

    name: str
    shape: np.ndarray
    prior: float
    value: float


class LinearisedLog:
    """One log at the fit: its residual and derivatives as real rows, projected off all that its nuisances can
    adjust.

    `plate` (n,) is the plate's part of the model, not turned by the demodulator, `turn`; `own` the gain of a
    log whose drive is not recorded, else 1; `late` (s) the lateness of the response; `bench` (n,) what else a
    d/q log holds. `n` rows are used. `coloured`: rows of correlated noise are made independent. The fitted
    value of each of the bench's numbers, in standard deviations of its prior, stands in the row of that
    prior, so that other effects can be tried as its explanation.
    """

    def __init__(
        self,
        trial: Trial,
        model: np.ndarray,
        state: State,
        reference: tuple[float, float],
        coloured: bool = False,
    ):
        self.trial, self.late, self.bench = trial, 0.0, np.zeros_like(model)
        self.reference = reference
        size = abs(trial.bench.turn) or 1.0
        self.free_gain = trial.steady and trial.log.drive is None
        self.turn, self.own = trial.bench.turn / size, size if self.free_gain else 1.0
        self._whitening = trial.noise.whitening(coloured=coloured)
        self.n = len(self._whitening[0])
        self.course = LogResponse.of(trial, reference, state.theta)
        self.model = trial.as_recorded(model)
        self.residual = trial.residual(self.model)
        self.columns = self._in_dq() if trial.signed else self._in_amplitude()
        self.priors = len(self.columns)

    @classmethod
    def each(
        cls, state: State, reference: tuple[float, float], coloured: bool = False
    ) -> list["LinearisedLog"]:
        """Of all logs, at a minimum."""
        return [
            cls(t, m, state, reference, coloured) for t, m in zip(state.trials, state.models, strict=True)
        ]

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal, of the bench's columns."""
        if not self.columns:
            return np.zeros((len(self.rows(self.residual, 0)), 0))
        return orthonormal(self.weighted(self.columns), ALIKE)

    @cached_property
    def recorded(self) -> np.ndarray:
        """Rows of the residual; those of the priors hold the fitted values of the bench's numbers."""
        rows = self.rows(self.residual)
        rows[len(rows) - self.priors :] = [-c.value / c.prior for c in self.columns]
        return rows

    @cached_property
    def r(self) -> np.ndarray:
        """The same, projected off all that the nuisances can adjust."""
        return self.recorded - (self.recorded @ self.basis) @ self.basis.T

    @cached_property
    def derivatives(self) -> np.ndarray:
        """(n, 6) of the log by the numbers of theta."""
        return self.own * self.observed(self.course.derivatives(*self.beside).T).T

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Rows of the derivatives, projected off all that the nuisances can adjust."""
        return self.off(self.derivatives.T).T

    def _in_amplitude(self) -> list[Column]:
        """What the bench may add to amplitudes, linearised about the fit."""
        trial, c, bench, loose = self.trial, self.course, self.trial.bench, self.trial.looseness
        start, self.late = bench.start if trial.start_free else 0.0, bench.late
        late = -bench.late * (trial.lateness > 0)
        self.beside = start, late
        self.plate = self.own * (c.forced + start * c.free + late * c.rate + bench.moves) + bench.offset
        size = float(np.abs(c.free[0])) if trial.begun else 1.0  # as the log records it
        shape, wide = c.free / size, size * trial.started * loose
        columns = [
            Column("start_d", shape, wide, size * start.real),
            Column("start_q", 1j * shape, wide, size * start.imag),
        ]
        columns = columns if trial.start_free else []
        parts = (("d", 1.0 + 0j, bench.offset.real), ("q", 1j, bench.offset.imag)) if bench.standing else ()
        columns += [
            Column(f"offset_{n}", by * np.ones(len(c.free)), trial.prior("offset"), value)
            for n, by, value in parts
        ]
        columns += [Column("late", -c.rate, trial.lateness, bench.late)] if trial.lateness else []
        columns = [x._replace(shape=self.observed(x.shape[None])[0]) for x in columns]
        if self.free_gain:
            columns.append(Column("gain", self.observed(c.forced + bench.moves), loose, self.own))
        if not trial.steady:
            return [*columns, Column("floor", rice.by_floor(self.plate, trial.lift), loose**2, bench.floor)]
        return columns if bench.under is None else [*columns, self._floor(bench.under)]

    def _floor(self, under: np.ndarray) -> Column:
        """Of a sweep: what is fitted of a rise of the amplitudes that is `under` (n,) of a floor."""
        without, prior = self.trial.sized(self.plate), self.trial.prior("floor") / float(np.max(under))
        return Column("floor", under, prior, float((self.model - without) @ under / (under @ under)))

    def _in_dq(self) -> list[Column]:
        """What the bench may add to Wd and Wq."""
        trial, c, loose = self.trial, self.course, self.trial.looseness
        forced = self.turn * self.own * (c.forced + trial.bench.moves)
        shapes = dict(zip(trial.shapes, trial.columns.astype(complex), strict=True))
        shapes |= {"start": c.free} if trial.start_free else {}
        # In the plate's own frame: its real part is how late the response is.
        shapes |= {"late": -self.turn * c.rate * trial.lateness / loose} if trial.lateness else {}
        shapes |= {name: self.turn * shape for name, shape in trial.extra_columns.items()}
        parts = (("d", 1.0), ("q", 1j))[: trial.channels]
        columns = [
            Column(f"{n}_{part}", by * x, trial.prior(n), 0.0)
            for n, x in shapes.items()
            for part, by in parts
        ]
        sideways = {"late_q": trial.sideways} | {f"{name}_q": REAL for name in trial.extra_columns}
        columns = [c._replace(prior=c.prior * sideways.get(c.name, 1.0)) for c in columns]
        target = self.rows(trial.log.response - forced, len(columns))
        there = np.zeros(len(columns))  # of each, what the plate already has: a thermometer's error
        if trial.tied:
            k, pull = 2 * list(shapes).index("thermometer"), c.warmer / trial.bench.extra["thermometer"].prior
            target[k - len(columns)], there[k] = -pull, pull * columns[k].prior
        found = self._fitted(columns, target) + there
        columns = [x._replace(value=v) for x, v in zip(columns, found, strict=True)]
        value = dict(
            zip(shapes, found.reshape(len(shapes), len(parts)) @ [by for _, by in parts], strict=True)
        )
        self.bench = sum((v * shapes[name] for name, v in value.items()), np.zeros_like(forced))
        self.plate = (forced + value.get("start", 0.0) * c.free) / self.turn
        self.beside = (
            value.get("start", 0j) / self.turn / self.own,
            0.0,
        )  # where much is wrong, lateness more than all
        self.late = float(value.get("late", 0j).real) * trial.lateness / loose
        if np.iscomplexobj(trial.log.response) and (trial.turned or self.free_gain):
            columns.append(Column("rotation", 1j * forced, np.inf, float(np.angle(self.turn))))
        if self.free_gain:
            columns.append(Column("gain", forced / self.own, np.inf, self.own))
        return columns

    def along(self, rates: np.ndarray) -> np.ndarray:
        """(n,) change of the log by `rates` (n,), rad/s, added to the slow pole."""
        return self.observed(self.own * self.course.along(rates, *self.beside)[None])[0]

    def observed(self, shapes: np.ndarray) -> np.ndarray:
        """(m, n) shapes of the plate's part as the log records them."""
        if self.trial.signed:
            return self.turn * shapes
        return (self.trial.towards(self.plate) * shapes).real

    @cached_property
    def ideal(self) -> Trial:
        """The log as if it were what is modelled, and all of that the plate: what an effect does to noise
        would explain that noise, and what seems to be fed beside a plate that is not described is its own."""
        log = replace(self.trial.log, response=self.model)
        return replace(self.trial, log=log).with_bench(fed=0.0)

    @cached_property
    def base(self) -> np.ndarray:
        """(n,) `modelled` of the log as it is."""
        return self.modelled(self.ideal)

    def modelled(self, trial: Trial) -> np.ndarray:
        """(n,) the plate's part of the log read as `trial`, as it is recorded, less what is recorded."""
        moved = trial.inputs is not self.trial.inputs or trial.bench.filter is not self.trial.bench.filter
        course = self._moved(trial) if moved else self.course
        start, late = self.beside
        plate = self.own * (course.forced + start * course.free + late * course.rate + trial.bench.moves)
        seen = self.turn * plate if trial.signed else trial.sized(plate + trial.bench.offset)
        return seen - trial.log.response

    def _moved(self, trial: Trial) -> LogResponse:
        """The log read as `trial`, as warm as it is then: by what its own thermometer is off it stays off."""
        course = LogResponse.of(trial, self.reference, self.course.theta)
        if not trial.tied:
            return course
        warmer = course.named.k_T * (course.warming - self.course.warming)
        trial = trial.with_bench(resonance=trial.bench.resonance + warmer)
        return LogResponse.of(trial, self.reference, self.course.theta)

    def weighted(self, columns: list[Column]) -> np.ndarray:
        """Columns as real, weighted rows, with a row for each one's prior."""
        rows = self.rows(np.stack([c.shape for c in columns]), len(columns)).T
        rows[len(rows) - len(columns) :] = np.diag([1 / c.prior for c in columns])
        return rows

    def _fitted(self, columns: list[Column], target: np.ndarray) -> np.ndarray:
        """Least-squares coefficients of the columns in `target`, rows with those of their priors."""
        if not columns:
            return np.zeros(0)
        rows = self.weighted(columns)
        size = _sizes(rows)
        return np.linalg.lstsq(rows / size, target, rcond=1e-12)[0] / size

    def covariance(self, plant: np.ndarray | None = None) -> np.ndarray:
        """Covariance of the columns' coefficients, with the plant's parameters held, or of the covariance
        `plant` of theta."""
        found, size, by_theta = self._open()
        if plant is not None:
            found = found + by_theta @ plant @ by_theta.T
        return found / np.outer(size, size)

    def drawn(self, away: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(m, K) coefficients of the columns beside plants that are `away` (m, 6) from the fit's theta: the
        best ones there, and a draw of what the log leaves open of them."""
        found, size, by_theta = self._open()
        left = rng.multivariate_normal(np.zeros(len(size)), found, len(away), method="eigh")
        return np.array([c.value for c in self.columns]) + (left - away @ by_theta.T) / size

    def _open(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Covariance (K, K) of the columns' coefficients with the plant held, in units of 1/size; the
        columns' sizes (K,); and by how much the coefficients fall with theta, (K, 6), in the same units."""
        a = self.weighted(self.columns)
        size = _sizes(a)
        found = np.linalg.pinv((a / size).T @ (a / size), rcond=1e-12, hermitian=True)
        return found, size, found @ (a / size).T @ self.rows(self.derivatives.T).T

    def rows(self, shape: np.ndarray, priors: int | None = None) -> np.ndarray:
        """Real, weighted rows of shapes (..., n), and zeros where the rows of `priors` (of all columns,
        unless given) are."""
        v = whitened(shape[..., self.trial.noise.used], *self._whitening)
        channels = [v.real, v.imag] if np.iscomplexobj(self.residual) else [v.real]
        return np.concatenate(
            [*channels, np.zeros((*v.shape[:-1], self.priors if priors is None else priors))], axis=-1
        )

    def off(self, shape: np.ndarray) -> np.ndarray:
        """Rows of shapes (..., n), projected off the bench's columns."""
        rows = self.rows(shape)
        return rows - (rows @ self.basis) @ self.basis.T

    def shared(self, rows: np.ndarray) -> float:
        """Sum of the products of neighbouring rows, of a sweep in the order of its frequencies: of what is
        smooth nearly its sum of squares, of noise of each row's own 0, with a standard deviation of its sum
        of squares over the root of the rows."""
        log, channels = self.trial.log, 2 if np.iscomplexobj(self.residual) else 1
        order = (
            np.argsort(log.frequency[self.trial.noise.used], kind="stable")
            if self.trial.swept
            else slice(None)
        )
        parts = rows[: channels * self.n].reshape(channels, self.n)[:, order]
        return float(np.sum(parts[:, 1:] * parts[:, :-1]))

    def likelihood(self, rows: np.ndarray) -> float:
        """Log-likelihood of real rows as this log's noise, at its best level and correlation time, and of
        those of the priors."""
        there = len(rows) - self.priors
        return self._noisy(rows[:there]) - 0.5 * float(np.sum(rows[there:] ** 2))

    def _noisy(self, rows: np.ndarray) -> float:
        noise = self.trial.noise
        if noise.rounded is not None and not noise.coloured:  # whose level is known
            return -0.5 * float(rows @ rows)
        n, clock, dof = self.n, noise.clock[noise.used], freedom(self.trial)
        if noise.levels:
            return sum(log_likelihood(v, clock, 0.5 * dof) for v in (rows[:n], rows[n : 2 * n]))
        left = rows[:n] + 1j * rows[n : 2 * n] if np.iscomplexobj(self.residual) else rows[:n]
        return log_likelihood(left, clock, dof)


def _sizes(columns: np.ndarray) -> np.ndarray:
    """Of each column; 1 of one that is zero throughout and has no prior, as the turn of a response that
    vanished."""
    size = np.linalg.norm(columns, axis=0)
    return np.where(size > 0, size, 1.0)
