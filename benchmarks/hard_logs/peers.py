"""The same logs in other programs, as a careful user of each would write it.

`scipy.optimize.least_squares` and `lmfit` take the exact model, with a rotation and an offset per log, from the peak and the width
of a sweep or from the rise of a step. `scikit-rf` (Qfactor, transmission) and `resonator_tools` (transmission_port) take one
complex sweep; where a case holds none they have no answer. `scikit-rf` states no errors, and is judged by LEAST.
"""

import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import lmfit
import numpy as np
import skrf
from bench import HALF, PLATE, reference
from cases import Case
from resonator_tools.circuit import transmission_port
from scipy.optimize import least_squares
from skrf.qfactor import Qfactor
from verdicts import FAR, Answer, logs_of, truths

from sysid import Log, LogError

LEAST = {"tau": 0.005 * PLATE.tau, "f0": 0.005 * HALF}  # what noise of 1 % leaves of a sweep of 120 rows
PATIENCE = 20.0  # s
NO_SWEEP = Answer("no sweep")


@dataclass(frozen=True)
class Problem:
    """Residuals, in units of the response, of p = (log(G/unit), log(tau/time), (f0 - near) time, and a rotation and an offset per
    log): nought to begin with."""

    logs: list[Log]
    scale: float
    unit: float  # of G
    near: float  # Hz
    time: float  # s

    @classmethod
    def of(cls, logs: list[Log]) -> "Problem":
        scale = max(float(np.max(np.abs(log.response))) for log in logs) or 1.0
        return cls(
            logs,
            scale,
            scale / (max(float(np.max(np.abs(log.drive))) for log in logs) or 1.0),
            *guessed(logs),
        )

    def values(self, p: np.ndarray) -> dict[str, float]:
        return {
            "G": np.exp(p[0]) * self.unit,
            "tau": np.exp(p[1]) * self.time,
            "f0": self.near + p[2] / self.time,
        }

    def residual(self, p: np.ndarray) -> np.ndarray:
        plant, parts = reference.Plant(**self.values(p), k_T=0.0), []
        for log, (turn, real, imaginary) in zip(self.logs, np.reshape(p[3:], (-1, 3)), strict=True):
            cold = np.full(len(log), 24.0)
            if log.time is None or log.kind == "steady":
                z = reference.steady(plant, log.drive, log.frequency, cold)
            else:
                z = rung(plant, log)
            z = z * np.exp(1j * turn) + self.scale * (real + 1j * imaginary)
            parts.append(((np.abs(z) if log.amplitude_only else z) - log.response) / self.scale)
        stacked = np.concatenate(parts)
        return np.concatenate([stacked.real, stacked.imag]) if np.iscomplexobj(stacked) else stacked

    def errors(self, p: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
        """Standard deviations of `values`, by the covariance of `p`."""
        G, tau, _ = self.values(p).values()
        return dict(
            zip(("G", "tau", "f0"), np.sqrt(np.diag(covariance)[:3]) * [G, tau, 1 / self.time], strict=True)
        )

    def start(self) -> np.ndarray:
        return np.zeros(3 + 3 * len(self.logs))


def guessed(logs: list[Log]) -> tuple[float, float]:
    """f0 and tau of the peak and the width of a sweep, or of the rise of a step."""
    sweep = next((log for log in logs if log.kind == "steady"), None)
    if sweep is not None:
        size = np.abs(sweep.response)
        near = sweep.frequency[size > np.max(size) / np.sqrt(2)]
        return float(sweep.frequency[np.argmax(size)]), 1 / (np.pi * max(float(np.ptp(near)), 1e-3))
    size, log = np.abs(logs[0].response), logs[0]
    risen = log.time[np.argmax(size > 0.63 * np.median(size[-10:]))] - log.time[np.argmax(log.drive != 0)]
    return float(log.frequency[-1]), max(float(risen), 1e-9)


def rung(plant: reference.Plant, log: Log) -> np.ndarray:
    """`reference.ringing` of a log at 24 degC, all rows' exponentials at once."""
    volts = log.drive[:-1]
    slow, fast, gain = reference.modes(plant, log.frequency[:-1], 24.0, plant.tau)
    settled, target, kept = gain * volts / fast, -gain * volts / slow, np.exp(slow * np.diff(log.time))
    z = np.zeros(len(log), complex)
    state = 0j
    for k in range(len(volts)):
        state = target[k] + (state - target[k]) * kept[k]
        z[k + 1] = state + settled[k]
    return z


def judged(values: dict[str, float], std: dict[str, float], truth: dict[str, float]) -> Answer:
    """By the errors that are stated, of what they determine: G and tau to a fifth, f0 to half a bandwidth."""
    limits = {
        "G": 0.2 * abs(values.get("G", 0.0)),
        "tau": 0.2 * abs(values["tau"]),
        "f0": 0.5 / (np.pi * abs(values["tau"])),
    }
    told = [n for n in values if np.isfinite(std[n]) and std[n] < limits[n]]
    z = max((abs(values[n] - truth[n]) / std[n] for n in told), default=0.0)
    verdict = "silently wrong" if z > FAR else "right" if "tau" in told else "open"
    return Answer(verdict, z, ", ".join(f"{n} {v:.6g} +- {std[n]:.2g}" for n, v in values.items()))


def by_scipy(logs: list[Log], truth: dict[str, float]) -> Answer:
    problem = Problem.of(logs)
    found = least_squares(problem.residual, problem.start(), max_nfev=300)
    rows = len(found.fun)
    if not found.success or rows <= len(found.x):
        return Answer("refused", said="did not converge")
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (rows - len(found.x))
    return judged(problem.values(found.x), problem.errors(found.x, covariance), truth)


def by_lmfit(logs: list[Log], truth: dict[str, float]) -> Answer:
    problem = Problem.of(logs)
    parameters = lmfit.Parameters()
    for k, value in enumerate(problem.start()):
        parameters.add(f"p{k}", value=float(value))
    found = lmfit.minimize(
        lambda p: problem.residual(np.array(list(p.valuesdict().values()))), parameters, max_nfev=1000
    )
    if not found.success or not found.errorbars:
        return Answer("refused", said=f"{found.message} error bars: {found.errorbars}")
    p = np.array(list(found.params.valuesdict().values()))
    return judged(problem.values(p), problem.errors(p, found.covar), truth)


def _sweep(logs: list[Log]) -> Log | None:
    return next((log for log in logs if log.kind == "steady" and not log.amplitude_only), None)


def by_skrf(logs: list[Log], truth: dict[str, float]) -> Answer:
    if (log := _sweep(logs)) is None:
        return NO_SWEEP
    order = np.argsort(log.frequency)
    network = skrf.Network(
        f=log.frequency[order], f_unit="Hz", s=log.response[order].reshape(-1, 1, 1), z0=50
    )
    found = Qfactor(network, "transmission").fit()
    if not found["success"]:
        return Answer("refused", said="did not converge")
    values = {"tau": found["Q_L"] / (np.pi * found["f_L"]), "f0": found["f_L"]}
    return judged(values, LEAST, truth)


def by_resonator_tools(logs: list[Log], truth: dict[str, float]) -> Answer:
    if (log := _sweep(logs)) is None:
        return NO_SWEEP
    port = transmission_port(log.frequency, log.response)
    port.fit()
    found = port.fitresults
    tau, error = (
        abs(found[name]) / (np.pi * found["fr"]) for name in ("Ql", "Ql_err")
    )  # its model holds Ql squared
    return judged({"tau": tau, "f0": found["fr"]}, {"tau": error, "f0": found["fr_err"]}, truth)


PEERS: dict[str, Callable[[list[Log], dict[str, float]], Answer]] = {
    "scipy": by_scipy,
    "lmfit": by_lmfit,
    "scikit-rf": by_skrf,
    "resonator_tools": by_resonator_tools,
}


def theirs(name: str, case: Case, seed: int) -> Answer:
    """The answer of a peer; the package reads its files for it. An error, or none in PATIENCE seconds, is a refusal."""
    try:
        logs = logs_of(case, seed)
    except LogError:
        return Answer("refused")
    warm = logs[0].temperature
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), patience():
            warnings.simplefilter("ignore")
            return PEERS[name](logs, truths(case, None if warm is None else float(np.mean(warm))))
    except Exception as error:
        return Answer("refused", said=f"{type(error).__name__}: {error}")


@contextmanager
def patience() -> Iterator[None]:
    def late(*_):
        raise TimeoutError(f"no answer in {PATIENCE:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
