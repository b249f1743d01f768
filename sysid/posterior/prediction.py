"""What a fit predicts of a log that it has not seen, with the error of the model and of the noise beside
it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid import reading
from sysid.asked import LOG, given
from sysid.logs.log import Log, LogError
from sysid.model.span import orthonormal
from sysid.shown import Shown
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial
from sysid.trials.whole import uncondensed
from sysid.verdict.fitted import Fit, FittedLog

BENCH = ("rotation", "background", "offset")  # of a log's own: what is found from its rows
ALIKE = 1e-9  # of a column: what is left of one that is nearly a sum of others


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Shown):
    """The response (n,) predicted at the inputs of `log`, which is the one given as it is read, in its
    `response_unit`.

    Of d/q logs `response`, `std` and `noise_std` are complex: their real parts are of Wd, their imaginary
    ones of Wq. `std` (n,): one standard deviation of the model, from the covariance of the fit's
    parameters and what is left open of the log's bench; `noise_std`: of one reading's noise, as the logs
    of the fit that are of the same `kind` have it.
    """

    log: Log
    kind: str
    response: np.ndarray
    std: np.ndarray
    noise_std: complex

    @property
    def total_std(self) -> np.ndarray:
        """(n,) standard deviation of a reading about `response`: of model and noise together."""
        d = np.hypot(self.std.real, self.noise_std.real)
        return d + 1j * np.hypot(self.std.imag, self.noise_std.imag) if np.iscomplexobj(self.std) else d

    @property
    def residual(self) -> np.ndarray:
        """(n,) recorded - predicted."""
        return self.log.response - self.response

    def to_frame(self) -> Any:
        """A pandas DataFrame: the log's rows, and beside each response prediction and errors; names end in
        their units."""
        from sysid.report.frames import of_prediction

        return of_prediction(self)

    def plot(self) -> Any:
        """A figure of matplotlib: the rows, the prediction, and bands of one standard deviation."""
        from sysid.report.plots import prediction_figure

        return prediction_figure(self)

    def _brief(self) -> Any:
        from sysid.report.brief import of_prediction

        return of_prediction(self)


def predict(fit: Fit, log: Log, bench: bool = True) -> Prediction:
    """The plate's response to the inputs of `log`, from rest where it is a transient; see `Fit.predict`."""
    _check(fit, log)
    (first,), _ = reading.trials([log], BENCH if bench else ())
    state = fit.modes[0]
    trial = uncondensed(reading.read_as(first, log.sampling, state.tau))
    course, noise = LogResponse.of(trial, fit.reference, state.theta), _noise(fit.logs, trial)
    response, jacobian = course.forced, course.derivatives()
    if log.amplitude_only:
        along = np.ones(len(trial.log)) if trial.signed else np.exp(-1j * np.angle(response))
        variance = _variance((along[:, None] * jacobian).real, state.spread)
        return Prediction(trial.log, trial.kind, (along * response).real, np.sqrt(variance), noise)
    turn, added = _bench(trial, response) if bench else (1.0, np.zeros_like(response))
    rows, left_open = (
        _beside(trial, turn * response, turn * jacobian) if bench else (_real(turn * jacobian), 0.0)
    )
    each = np.repeat([noise.real, noise.imag], len(response))
    d, q = np.split(np.sqrt(_variance(rows, state.spread) + left_open * each**2), 2)
    return Prediction(trial.log, trial.kind, turn * response + added, d + 1j * q, noise)


def _bench(trial: Trial, plate: np.ndarray) -> tuple[complex, np.ndarray]:
    """By what the log's demodulator turns the plate's response (n,), and the rest (n,) that its bench
    adds, by least squares."""
    use, shapes = trial.there, trial.columns.astype(complex).T
    gain = np.linalg.lstsq(np.column_stack([plate, shapes])[use], trial.log.response[use], rcond=ALIKE)[0][0]
    turn = gain / abs(gain) if gain else 1.0
    rest = np.linalg.lstsq(shapes[use], (trial.log.response - turn * plate)[use], rcond=ALIKE)[0]
    return turn, shapes @ rest


def _beside(trial: Trial, plate: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (2n, 6) of the derivatives less what the bench's numbers take up of them; and the share (2n,)
    of each row's noise that is in those numbers, its leverage."""
    shapes = trial.columns.astype(complex)
    basis = orthonormal(_real(np.column_stack([1j * plate, *shapes, *(1j * shapes)])), ALIKE)
    rows = _real(jacobian)
    return rows - basis @ (basis.T @ rows), np.sum(basis**2, axis=1)


def _real(rows: np.ndarray) -> np.ndarray:
    """(2n, ...) real rows of complex ones (n, ...): those of d, then those of q."""
    return np.concatenate([rows.real, rows.imag])


def _check(fit: Fit, log: Log) -> None:
    """LogError for a log of another plate's units or without a drive; ValueError for a fit that tells no
    plate."""
    given("log", log, Log, LOG)
    if not fit.result.bounded or fit.plant.G is None:
        raise ValueError(
            f"no prediction: {'no drive was recorded' if fit.result.bounded else fit.result.value}"
        )
    like = fit.logs[0].log
    if log.drive is None:
        raise LogError(
            f"{log.path or log.name}: found a log without a drive, expected what the plate answers to"
        )
    for what in ("response_unit", "drive_unit"):
        if (found := getattr(log, what)) != (wanted := getattr(like, what)):
            raise LogError(f"{log.path or log.name}: found {what} {found}, expected {wanted} as in the fit")


def _variance(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n,) of J theta, J (n, 6)."""
    return np.maximum(np.einsum("ni,ij,nj->n", rows, covariance, rows), 0.0)


def _noise(logs: tuple[FittedLog, ...], trial: Trial) -> complex:
    """Medians of the noise of d and q over the logs of the same kind, else over all."""
    alike = [f for f in logs if f.kind == trial.kind] or logs
    each = [[level.std for level in f.levels] or [f.noise_std, f.noise_std] for f in alike]
    d, q = np.median(each, axis=0).tolist()
    return complex(d, 0.0 if trial.log.amplitude_only else q)
