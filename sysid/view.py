"""One log at the fit, as the tests of misfits see it: rows less all that the bench may have added."""

from typing import Any

import numpy as np

from sysid.experiment import Trial, freedom
from sysid.minimise import State
from sysid.noise import log_likelihood
from sysid.perturbed import Course


class View:
    """One log at the fit: its residual and derivatives, less all that its nuisances can make of them, as real rows.

    `plate` (n,) is the part of the model that is the plate's, not turned by the demodulator, `turn`; `own` the gain of a log
    whose drive is not recorded, else 1; `late` (s) how late the response comes; `bench` (n,) what else a d/q log holds.
    `coloured`: rows of correlated noise are made independent.
    """

    def __init__(self, trial: Trial, model: np.ndarray, state: State, reference: tuple[float, float], coloured: bool = False):
        self.trial, self.own, self.late, self.bench = trial, 1.0, 0.0, np.zeros_like(model)
        self._memory = trial.memory() if coloured else np.zeros(len(model))
        self.course = Course(trial, trial.hold(reference), state.theta)
        self.model = model.real if trial.log.amplitude_only else model
        self.residual = trial.log.response - self.model
        self.weight = trial.weight / (trial.noise_std or trial.scale)
        self.basis = self._orthonormal(self._nuisances())
        self.recorded = self._rows(self.residual)
        self.r = self.off(self.residual)
        self.derivatives = self.own * self.observed(self.course.derivatives(self.plate / self.own).T).T
        self.jacobian = np.stack([self.off(c) for c in self.derivatives.T], axis=1)

    def _nuisances(self) -> list[tuple[np.ndarray, float]]:
        """Real columns that the bench may add, with the standard deviation of the prior of each."""
        trial, c, loose = self.trial, self.course, self.trial.looseness
        own: list[Any] = [] if trial.steady else [c.free]
        lateness = trial.lateness
        if not trial.signed:
            self.turn, start = 1.0, trial.start if trial.start_free else 0.0
            self.plate = c.forced + start * c.free - trial.late * c.rate * (lateness > 0)
            if trial.log.drive is None:
                self.own = float(np.abs(self.plate) @ self.model / np.maximum(np.sum(np.abs(self.plate) ** 2), 1e-300)) or 1.0
                self.plate = self.own * self.plate
            self.late = trial.late
            columns = [(s * f, loose) for s in (1.0, 1j) for f in own if trial.start_free]
            columns += [(-c.rate, lateness)] if lateness else []
            real = [(self.observed(s[None])[0], std) for s, std in columns]
            if trial.log.drive is None:
                real.append((np.abs(c.forced), loose))
            return real + ([] if trial.steady else [(0.5 / np.maximum(self.model, 1e-300) * loose**2, 1.0)])
        columns = [*trial.columns.astype(complex)]
        complexes: list[Any] = [*columns, *(own if trial.start_free else []), *([-c.rate * lateness / loose] if lateness else [])]
        rows = self.weight[:, None] * np.stack([c.exact, *complexes], axis=1)
        rows = np.concatenate([rows, np.eye(1 + len(complexes)) / loose])
        rows[len(self.model), 0] = 0.0  # the gain has no prior
        size = np.linalg.norm(rows, axis=0) + 1e-300
        seen = np.append(self.weight * self.model, np.zeros(1 + len(complexes)))
        found = np.linalg.lstsq(rows / size, seen, rcond=1e-12)[0] / size
        self.turn = found[0] / abs(found[0]) if found[0] else 1.0
        start = found[1 + len(columns)] if own and trial.start_free else 0.0
        if lateness:
            self.late = float((found[-1] / self.turn).real) * lateness / loose
        self.bench = np.stack([np.zeros_like(c.forced), *complexes], axis=1) @ np.append(0.0, found[1:])
        self.own = abs(found[0]) if trial.log.drive is None and found[0] else 1.0
        self.plate = self.own * c.exact + start / self.turn * c.free
        turned = [self.turn * 1j * self.plate] if "rotation" in trial.nuisances or trial.log.drive is None else []
        turned += [self.turn * self.plate] if trial.log.drive is None else []
        return [(s * f, loose) for f in complexes for s in (1.0, 1j)] + [(t, np.inf) for t in turned]

    def observed(self, shapes: np.ndarray) -> np.ndarray:
        """(m, n) shapes of the plate's part as they show in the log."""
        if self.trial.signed:
            return self.turn * shapes
        return (np.conj(self.plate) * shapes).real / np.maximum(self.model, 1e-300)

    def _orthonormal(self, columns: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Basis of the weighted columns, with a row for each one's prior."""
        self.priors = len(columns)
        if not columns:
            return np.zeros((len(self._rows(self.residual)), 0))
        rows = np.stack([np.append(self._rows(c)[: -self.priors or None], np.zeros(self.priors)) for c, _ in columns], axis=1)
        for k, (_, std) in enumerate(columns):
            rows[len(rows) - self.priors + k, k] = 0.0 if np.isinf(std) else 1 / std
        size = np.linalg.norm(rows, axis=0)
        u, s, _ = np.linalg.svd(rows[:, size > 0] / size[size > 0], full_matrices=False)
        return u[:, s > 1e-9 * (s[0] if len(s) else 1.0)]

    def _rows(self, shape: np.ndarray) -> np.ndarray:
        """Real, weighted rows of a shape, and zeros where the priors' rows are."""
        v = self.weight * shape
        v = np.append(v[:1], (v[1:] - self._memory[1:] * v[:-1]) / np.sqrt(1 - self._memory[1:] ** 2))
        real = np.concatenate([v.real, v.imag]) if np.iscomplexobj(self.residual) else v.real
        return np.append(real, np.zeros(self.priors))

    def off(self, shape: np.ndarray) -> np.ndarray:
        rows = self._rows(shape)
        return rows - self.basis @ (self.basis.T @ rows)

    def likelihood(self, rows: np.ndarray) -> float:
        """Log-likelihood of real rows as this log's noise, at its best level and correlation time."""
        n = len(self.trial.log)
        left = rows[:n] + 1j * rows[n : 2 * n] if np.iscomplexobj(self.residual) else rows[:n]
        return log_likelihood(left, self.trial.clock, freedom(self.trial))
