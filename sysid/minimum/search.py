"""How well plants fit logs that each have a gain of their own: residual sums over many candidates, in plain
numpy.

At most SEARCH_ROWS rows of each log are used, and their noise is taken as white. For each candidate (tau, f0,
k_T)

    y = a h + s e + sum_c nu_c column_c + noise,     |h| and |e| for an amplitude y

where h is the plant's response per unit G and e the free decay from the unknown start. The bench's columns
are projected out once; the gain a and s at each plant, by Gram-Schmidt over all candidates side by side.
Priors are those of `model.likelihood`, one row each. An undriven amplitude, |s e| lifted by its floor, is
linearised in its start and floor about their present values.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid.model import rice
from sysid.model.carry import ONE_LANE
from sysid.model.plant import respond, steady
from sysid.trials.experiment import bucket, padded
from sysid.trials.trial import Trial, freedom

SEARCH_ROWS = 160
OWN = 3  # rows of the priors of what depends on the plant
TOGETHER = 1 << 16  # numbers in an array of candidates side by side, which stay in the cache of a processor


class Search:
    """Residual sums of logs that each have a gain of their own, over candidates of (tau, f0, k_T)."""

    def __init__(self, trials: Sequence[Trial], reference: tuple[float, float]):
        self.trials, self.reference = trials, reference
        self.logs = [Thinned(t, reference) for t in trials]
        self.freedom = np.array([min(freedom(t), 2 * SEARCH_ROWS) for t in trials])

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual sums of squares and gains, both (n, logs), at points (n, 3) of log tau, f0 - reference,
        k_T."""
        sums, gains = np.stack([self._found(log, points) for log in self.logs], axis=-1)
        return sums, gains

    def sums(self, points: np.ndarray) -> np.ndarray:
        """(n, logs) residual sums of squares."""
        return self(points)[0]

    def of(self, k: int, points: np.ndarray) -> np.ndarray:
        """(n,) residual sums of one log."""
        return self._found(self.logs[k], points)[0]

    def _found(self, log: "Thinned", points: np.ndarray) -> np.ndarray:
        """(2, n) residual sums and gains of one log."""
        found = np.empty((2, len(points)))
        with np.errstate(all="ignore"):  # what overflows is far from any log
            for i in range(0, len(points), log.together):
                found[:, i : i + log.together] = log(points[i : i + log.together].T)
        found[0, ~np.isfinite(found[0])] = np.inf
        return found

    def score(self, points: np.ndarray, best: np.ndarray) -> np.ndarray:
        """(n,) log-likelihood by which each point falls short of every log's `best` residual sum."""
        least = np.maximum(best, 1e-300)
        return np.sum(0.5 * self.freedom * np.log(np.maximum(self.sums(points), least) / least), axis=1)


class Thinned:
    """One log at as many rows as a search needs. Arrays are (N + priors, B): its rows, and B candidates side
    by side."""

    def __init__(self, trial: Trial, reference: tuple[float, float]):
        rows = _thin(trial)
        kept = np.isin(np.arange(len(trial.log)), rows)
        self.trial = trial = replace(
            trial, noise=replace(trial.noise, time=0.0, levels=(), rounded=None, own=None, kept=kept)
        )
        hold = trial.hold(reference)
        held, count = (rows, len(rows)) if trial.steady else (slice(None), len(hold.drive))
        hold = padded(
            hold, rows, held, len(rows), count if trial.steady or count <= ONE_LANE else bucket(count)
        )
        self.hold = hold._replace(
            **{k: v[:, None] for k, v in hold._asdict().items() if np.ndim(v) and k != "interval"}
        )
        self.together = max(TOGETHER // max(len(rows), len(hold.drive)), 1)
        self.weight = trial.noise.whitening()[0][:, None]
        ((basis, _),) = trial.spans
        self.priors = len(basis)  # where the rows of the priors of what depends on the plant begin
        self.bench = [self._with_priors(column[:, None].astype(complex)) for column in basis.T]
        self.response = _off(self.bench, self._with_priors(self.weight * trial.log.response[rows, None]))
        self.drive = (
            float(np.max(np.abs(hold.drive))) or 1.0
        )  # by which the prior of what settles is in the response's unit
        self.start_free = trial.start_free * (trial.scale / trial.looseness if trial.begun else trial.started)

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual sums of squares and gains (B,) at points (3, B)."""
        trial, (forced, free) = self.trial, self._shapes(points)
        if not trial.signed and not trial.driven and not trial.steady:
            return self._undriven(self.start_free * free)
        columns = [self.start_free * free] if self.start_free else []
        columns += [forced / self.drive] if trial.driven or trial.log.drive is None else []
        left, settled = self._explained([c if trial.signed else np.abs(c) for c in columns], self.response)
        return left, settled / self.drive

    def _shapes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Response per unit G to the drive from rest, and of a unit start."""
        hold, (log_tau, shift, drift) = self.hold, points
        tau, detuning = np.exp(log_tau), 2 * np.pi * (hold.offset + shift + drift * hold.warming)
        if self.trial.steady:
            forced = hold.drive * steady(tau, detuning, hold.omega, np)
            return forced, np.zeros_like(forced)
        carrier = self.trial.resonant and self.trial.log.theta is not None
        order = min(self.trial.smoothing[1], 0)  # a filter of a lock-in leaves the start where it is
        found = respond(tau, detuning, hold, carrier=carrier, begun=self.trial.begun, order=order, xp=np)
        return found.forced, found.free / np.abs(found.free[:1]) if self.trial.begun else found.free

    def _undriven(self, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same for an amplitude that only decays."""
        trial, scale, floor = self.trial, self.trial.looseness, self.trial.lift
        bench, start = trial.bench, complex(trial.bench.start)
        plate = start * free + bench.offset
        size, along = rice.mean(plate, floor), rice.towards(plate, floor) * free
        shapes = [along.real, -along.imag, rice.by_floor(plate, floor) * float(bench.floor_free) * scale]
        begun = start.real * shapes[0] + start.imag * shapes[1] + floor / scale * shapes[2]
        return self._explained(shapes, self.response + self._with_priors(self.weight * (begun - size)))

    def _with_priors(self, rows: np.ndarray) -> np.ndarray:
        """The rows, followed by zeros in the rows of the priors."""
        found = np.zeros((self.priors + OWN, rows.shape[1]), rows.dtype)
        found[: len(rows)] = rows
        return found

    def _explained(
        self, columns: Sequence[np.ndarray], response: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual sums of squares (B,) after fitting columns (N, B), and the magnitude of the last column's
        coefficient."""
        units, left, gain = list(self.bench), response, np.ones(response.shape[1])
        for i, column in enumerate(columns):
            column = self._with_priors(self.weight * column)
            column[self.priors + i] = 1 / self.trial.looseness
            column = _off(2 * units, column)  # twice is enough
            size = np.sqrt(_along(column, column).real)
            units.append(column / size)
            along = _along(units[-1], left)
            left, gain = left - along * units[-1], np.abs(along) / size
        return _along(left, left).real, gain


def _off(units: Sequence[np.ndarray], v: np.ndarray) -> np.ndarray:
    """`v` (n, B) less its projections on the units, one after the other: for a handful, a threaded library
    does not pay."""
    for unit in units:
        v = v - _along(unit, v) * unit
    return v


def _along(unit: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.einsum("nb,nb->b", unit.conj(), v)


def _thin(trial: Trial) -> np.ndarray:
    """The rows for a search: evenly spread over a sweep; in each stretch of constant inputs densest at its
    start."""
    rows = _evenly(trial)
    return rows[trial.there[rows]]


def _evenly(trial: Trial) -> np.ndarray:
    n, hold = len(trial.log), trial.inputs
    edges = (
        np.array([0, n]) if trial.steady else np.searchsorted(hold.interval, np.arange(len(hold.drive) + 1))
    )
    if n <= SEARCH_ROWS:
        return np.arange(n)
    if len(edges) - 1 > SEARCH_ROWS // 8:
        return np.unique(np.linspace(0, n - 1, SEARCH_ROWS).astype(int))
    share = np.linspace(0, 1, SEARCH_ROWS // (len(edges) - 1)) ** (1 if trial.steady else 2)
    rows = np.concatenate([a + share * (b - 1 - a) for a, b in pairwise(edges)])
    return np.unique(np.rint(rows).astype(int))
