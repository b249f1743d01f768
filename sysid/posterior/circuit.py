r"""The circuit that an impedance analyser sees in the plate (Butterworth and Van Dyke): R1, L1 and C1 in
series, and beside them C0 with its losses.

    Y = 1/(R1 + j w L1 + 1/(j w C1)) + j w C0 (1 - j tan d)

A log of it holds the charge of the current that V drives, W = Y V/w. The plant's steady response
W = G V (w0/w)/(1 - j (w0^2 - w^2) tau/(2 w)) is that of the first term, exactly, and the feedthrough nu (per
volt, at w0, with its slope) is the second:

    R1 = 1/(w0 G)        L1 = R1 tau/2        C1 = 1/(w0^2 L1)        C0 = Im nu        tan d = Re nu/Im nu

    f_s = f0             f_p = f_s sqrt(1 + C1/C0)         k_eff^2 = (f_p^2 - f_s^2)/f_p^2 = C1/(C0 + C1)

The figure of merit is M = Q C1/C0 = 1/(w0 C0 R1) (IEEE Std 177-1966). f_p is that of the circuit without
losses, as is k_eff (IEEE Std 176-1987). Of a log in A or S itself, which is no charge, W = Y V and R1 =
1/G; the plant's factor w0/w is none of such a log's. To first order in 1/Q it turns the branch by 1/(w0
tau) and adds w0 C1/2 beside it, both of which are taken out. Amplitudes show C0 where the fit has found a
feedthrough under them.

A network analyser is a source of impedance Zg across the plate: its reference R at one port, 2 R where the
plate is in series between two, R/2 where it is across them. The motional branch sees Zs = 1/(1/Zg + Y0), and

    coupling = Re Zs/R1 = Q/Q_ext        loaded Q = w_l L1/(R1 + Re Zs)        w_l L1 - 1/(w_l C1) + Im Zs = 0

(Pozar, Microwave Engineering, 6.6). All of it is worked out at each draw of the posterior, with the
feedthrough drawn beside it (`LinearisedLog.drawn`): errors and correlations are those of the draws.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sysid.effects.number import Number
from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.model.theta import NAMES, POSITIVE, carried
from sysid.posterior.estimate import Estimate
from sysid.shown import Shown
from sysid.tables import units
from sysid.verdict.bench import TOLD
from sysid.verdict.fitted import Fit
from sysid.verdict.linearised import LinearisedLog
from sysid.verdict.result import Parameter

CALIBRATED = 0.1  # rad, up to which an analyser's phase may be off and is taken as calibrated
SEEN = 5.0  # standard deviations above zero, from which a capacitance is one: none of its draws is below
BEHIND = {"one port": 1.0, "in series": 2.0, "across the line": 0.5}  # Zg over the reference impedance
BOTH_PARTS = "the logs hold amplitudes alone; record both parts of the admittance, or magnitude and phase"
NO_SWEEP = (
    "no feedthrough of the drive was fitted; record a sweep across the resonance, and fit its background"
)
UNTOLD = "the logs say no more about the feedthrough than what was assumed; record a wider sweep"
UNSEEN = "the feedthrough, {} pF, is within five of its errors; record a wider sweep, or with less noise"
INDUCTIVE = "the feedthrough is no capacitance, {} pF: leads, or a resonance outside of the sweep"
LOSSY = 1.0  # of tan d: beyond, what is beside the branch is rather a resistance
UNTOLD_LOSS = "the logs allow tan d from {:.2g} to {:.2g}; record both parts of the admittance"
SEVERAL = "the admittances were driven at several voltages; state the drive as 1 V, as they are per volt"


class Drawn(NamedTuple):
    """Draws, (n,) each: w0 (rad/s), tau (s), the motional branch's conductance at w0 (S), and what is beside
    it (S, complex); `behind` is Zg (ohm)."""

    omega: np.ndarray
    tau: np.ndarray
    peak: np.ndarray
    beside: np.ndarray
    behind: float

    @property
    def C1(self) -> np.ndarray:
        return 2 * self.peak / (self.omega**2 * self.tau)

    @property
    def C0(self) -> np.ndarray:
        return self.beside.imag / self.omega

    @property
    def seen(self) -> np.ndarray:
        """The impedance that the motional branch sees, ohm."""
        return 1 / (1 / self.behind + self.beside)

    @property
    def loaded(self) -> np.ndarray:
        """Q with the source's losses, at the resonance that its reactance pulls."""
        pull = self.seen.imag * self.peak / (self.omega * self.tau)  # Im Zs over 2 w0 L1
        loss = 1 + self.seen.real * self.peak
        return 0.5 * self.omega * self.tau * (np.hypot(1, pull) - pull) / loss


class Quantity(NamedTuple):
    """A number of the circuit: its unit, what has to be known for it, and how it follows from the draws."""

    unit: str
    needs: tuple[str, ...]
    of: Callable[[Drawn], np.ndarray]


PLATE = ("G", "tau", "f0")
QUANTITIES = {
    "G_s": Quantity("S", ("G", "f0"), lambda d: d.peak),
    "R1": Quantity("ohm", ("G", "f0"), lambda d: 1 / d.peak),
    "L1": Quantity("H", PLATE, lambda d: 0.5 * d.tau / d.peak),
    "C1": Quantity("F", PLATE, lambda d: d.C1),
    "C0": Quantity("F", ("f0", "C0"), lambda d: d.C0),
    "tan_d": Quantity("1", ("f0", "loss"), lambda d: d.beside.real / d.beside.imag),
    "f_s": Quantity("Hz", ("f0",), lambda d: d.omega / (2 * np.pi)),
    "f_p": Quantity("Hz", (*PLATE, "C0"), lambda d: d.omega / (2 * np.pi) * np.sqrt(1 + d.C1 / d.C0)),
    "k_eff": Quantity("1", (*PLATE, "C0"), lambda d: np.sqrt(d.C1 / (d.C0 + d.C1))),
    "figure_of_merit": Quantity("1", ("G", "f0", "C0"), lambda d: d.peak / d.beside.imag),
}
PORTS = {
    "unloaded_Q": Quantity("1", ("tau", "f0"), lambda d: 0.5 * d.omega * d.tau),
    "loaded_Q": Quantity("1", (*PLATE, "feedthrough"), lambda d: d.loaded),
    "coupling": Quantity("1", (*PLATE, "feedthrough"), lambda d: d.seen.real * d.peak),
}


@dataclass(frozen=True, eq=False, repr=False)
class Circuit(Shown):
    """The equivalent circuit: its numbers by name, and the `correlation` (k, k) of those that are determined,
    in their order. `reference` (ohm) and `device`, the plate's place, are those of a network analyser's
    ports."""

    parameters: dict[str, Parameter]
    correlation: np.ndarray
    reference: float | None = None
    device: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the determined numbers."""
        return tuple(name for name, p in self.parameters.items() if p.determined)

    def to_frame(self) -> Any:
        """A pandas DataFrame, a row for each number, as a fit's `to_frame` has its parameters."""
        from sysid.report.frames import of_parameters

        return of_parameters(self.parameters)

    def _brief(self) -> Any:
        from sysid.report.brief import of_circuit

        return of_circuit(self)


def circuit(
    fit: Fit, draws: Mapping[str, np.ndarray], parameters: Mapping[str, Parameter], seed: int
) -> Circuit | None:
    """The circuit of a fit by the draws of its posterior and the `parameters` that these determine; None
    where the logs are no current, charge or admittance under a voltage."""
    if (scale := per_drive(fit.logs[0].log)) is None:
        return None
    siemens, power = scale
    known = {name: draws[name].ravel() for name in PLATE if name in draws and parameters[name].determined}
    missing = {name: f"{name} is not determined" for name in PLATE if name not in known}
    count = next(iter(draws.values())).size
    nothing = np.full(count, np.nan)
    omega = 2 * np.pi * known.get("f0", nothing)
    if "f0" in missing:
        missing["feedthrough"] = missing["f0"]
        beside = nothing + 0j
    else:
        extra = 1 / (omega * known["tau"]) if power == 0 and "tau" in known else np.zeros(count)
        through, why = _feedthrough(fit, draws, seed, extra)
        beside = siemens * omega**power * through
        missing |= {"feedthrough": why} if why else {}
    tau, peak = known.get("tau", nothing), siemens * omega**power * known.get("G", nothing)
    if power == 0:
        beside = beside + 1j * peak / (omega * tau)  # w0 C1/2
        missing |= next(({"feedthrough": missing[n]} for n in ("G", "tau") if n in missing), {})
    if why := _volts_why(fit):
        missing |= dict.fromkeys(("G", "feedthrough"), why)
    if why := missing.get("feedthrough") or _no_capacitance(beside.imag / omega):
        missing |= {"C0": why, "loss": why}
    elif why := _no_loss(beside.real / beside.imag):
        missing["loss"] = why
    reference, device = _ports(fit)
    behind = np.nan if reference is None or device is None else reference * BEHIND[device]
    drawn = Drawn(omega, tau, peak, beside, behind)
    wanted = QUANTITIES | (PORTS if device else {})
    values = {name: q.of(drawn) for name, q in wanted.items() if not any(need in missing for need in q.needs)}
    found = {
        name: _summed(values[name], q.unit) if name in values else _open(q, missing)
        for name, q in wanted.items()
    }
    together = np.atleast_2d(np.corrcoef(list(values.values()))) if values else np.zeros((0, 0))
    return Circuit(found, together, reference, device)


def _summed(x: np.ndarray, unit: str) -> Parameter:
    e = Estimate.of(x, np.full(x.size, 1 / x.size))
    return Parameter(e.value, e.std, (e.low, e.high), unit, True)


def _open(quantity: Quantity, missing: Mapping[str, str]) -> Parameter:
    why = next(missing[need] for need in quantity.needs if need in missing)
    return Parameter(None, None, None, quantity.unit, False, f"cannot tell, because {why}")


def per_drive(log: Log) -> tuple[float, int] | None:
    """(S, power): the admittance is S w^power times the response per unit of the drive. None of what is
    none."""
    if log.drive is None or log.frequency is None or not _is_of(log.drive_unit, "V"):
        return None
    volt = units.convert(1.0, log.drive_unit, "V")
    if _is_of(log.response_unit, "S"):
        return units.convert(1.0, log.response_unit, "S") * float(np.max(np.abs(log.drive))), 0
    for unit, power in (("C", 1), ("A", 0)):
        if _is_of(log.response_unit, unit):
            return units.convert(1.0, log.response_unit, unit) / volt, power
    return None


def admittance(log: Log) -> np.ndarray | None:
    """(n,) by which the response of an impedance analyser's log is its admittance in S; None of another
    log."""
    if (
        not log.relative_noise
        or log.drive is None
        or not log.drive.all()
        or (scale := per_drive(log)) is None
    ):
        return None
    siemens, power = scale
    return siemens * (2 * np.pi * log.frequency) ** power / log.drive


def _is_of(unit: str, kind: str) -> bool:
    """Whether a unit is a multiple of V, A, S or C; of others without loading the library of units."""
    return unit.endswith(kind) and units.same_kind(unit, kind)


def _volts_why(fit: Fit) -> str:
    """Why responses in S, which are per volt already, tell no circuit: their drives differ."""
    if not _is_of(fit.logs[0].log.response_unit, "S"):
        return ""
    drives = [np.abs(f.log.drive) for f in fit.logs if f.log.drive is not None]
    return SEVERAL if np.ptp(np.concatenate(drives)) > 0 else ""


def _ports(fit: Fit) -> tuple[float | None, str | None]:
    """Reference impedance (ohm) and place of the plate that all logs state; None where they do not."""
    stated = {(f.log.metadata.get("reference_ohm"), f.log.metadata.get("device")) for f in fit.logs}
    ((ohm, device), *others) = stated
    if others or not ohm or device not in BEHIND:
        return None, None
    return float(ohm), device


def _feedthrough(
    fit: Fit, draws: Mapping[str, np.ndarray], seed: int, extra: np.ndarray
) -> tuple[np.ndarray, str]:
    """(n,) draws of the feedthrough per unit of the drive at f0, in the frame of the admittance; or why there
    are none. `extra` (n,) rad: by what the model turns the plate without a demodulator."""
    state, rng, told = fit.modes[0], np.random.default_rng(seed), []
    away, resonance = _away(fit, draws), draws["f0"].ravel()
    views = LinearisedLog.each(state, fit.reference, coloured=True)
    views = [v for v in views if any(c.name == "feedthrough_d" for c in v.columns) and v.trial.resonant]
    views = [v for v in views if np.iscomplexobj(v.trial.log.response) and v.trial.log.drive is not None]
    under = ((f.log, _fed(fit, f.log)) for f in fit.logs)
    turn = np.exp(1j * extra)
    told += [turn * _under(log, numbers, state, rng, len(away)) for log, numbers in under if numbers]
    for view in views:
        covariance = view.covariance(state.spread)
        errors = zip(view.columns, np.sqrt(np.diag(covariance)), strict=True)
        if all(e <= TOLD * c.prior for c, e in errors if c.name.startswith("feedthrough")):
            told.append(_of_log(view, away, resonance, covariance, rng, extra))
    if not told:
        lost = all(f.log.amplitude_only for f in fit.logs)
        return np.full(len(away), np.nan + 0j), UNTOLD if views else BOTH_PARTS if lost else NO_SWEEP
    return _joined(np.array([x.real for x in told])) + 1j * _joined(np.array([x.imag for x in told])), ""


def _of_log(
    view: LinearisedLog,
    away: np.ndarray,
    resonance: np.ndarray,
    covariance: np.ndarray,
    rng: np.random.Generator,
    extra: np.ndarray,
) -> np.ndarray:
    """(n,) draws of a log's feedthrough per unit of the drive at the `resonance` (n,).

    A demodulator turns all that it sees, and so it is turned back by what it turns the plate. An analyser's
    phase is calibrated, and its feedthrough stands as recorded: what turns the plate by more than its error
    is an error, that of the feedthrough beside it and of the phase of the losses."""
    trial, names = view.trial, [c.name for c in view.columns]
    drawn, beyond = view.drawn(away, rng), 0.0
    k = names.index("rotation") if "rotation" in names else None
    rotation = 0.0 if k is None else view.columns[k].value - float(np.mean(extra))
    turned = k is not None and not (trial.log.relative_noise and abs(rotation) < CALIBRATED)
    if k is not None and not turned:
        beyond = np.sqrt(max(rotation**2 - covariance[k, k], 0.0))
        drawn = drawn + beyond * rng.standard_normal((len(drawn), 1)) * covariance[k] / covariance[k, k]

    def part(name: str) -> np.ndarray:
        size = float(np.max(np.abs(trial.shapes[name])))
        d, q = (drawn[:, names.index(f"{name}_{x}")] for x in "dq")
        return (d + 1j * q) / size

    found = part("feedthrough")
    if "slope_d" in names:
        found = found + part("slope") * (resonance - np.mean(trial.log.frequency))
    if turned:
        return found * np.exp(-1j * (drawn[:, k] - extra))
    return found + beyond * rng.standard_normal(len(found)) * found.imag


def _fed(fit: Fit, log: Log) -> Mapping[str, Number] | None:
    """The feedthrough that the fit has found under a log's amplitudes, where it has an error."""
    found = (f for f in fit.findings if f.key == "feedthrough" and f.outcome == "fitted")
    numbers = next((f.numbers for f in found if not f.logs or log.name in f.logs), None)
    shown = log.amplitude_only and log.drive is not None and numbers is not None
    return numbers if shown and all(n.std for n in numbers.values()) else None


def _under(
    log: Log, numbers: Mapping[str, Number], state: State, rng: np.random.Generator, count: int
) -> np.ndarray:
    """(n,) draws of the feedthrough under a log's amplitudes, per unit of the drive, by the errors that the
    fit has of it: in the plate's frame, in units of the largest response of all logs."""
    assert log.drive is not None
    top = max(trial.scale for trial in state.trials) / np.max(np.abs(log.drive))
    d, q = (rng.normal(numbers[n].value, numbers[n].std, count) for n in ("in_phase", "in_quadrature"))
    return top * (d + 1j * q)


def _joined(draws: np.ndarray) -> np.ndarray:
    """(n,) of draws (logs, n) of one number: their mean by weight, spread more widely where the logs differ
    by more than their errors (Birge, Phys. Rev. 40, 207, 1932)."""
    weight = 1 / np.var(draws, axis=1)
    mean = weight @ draws / weight.sum()
    if len(draws) == 1:
        return mean
    centre = float(mean.mean())
    ratio = float(weight @ (draws.mean(axis=1) - centre) ** 2) / (len(draws) - 1)
    return centre + (mean - centre) * np.sqrt(max(ratio, 1.0))


def _away(fit: Fit, draws: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n, 6) by how much draws are off the fit's theta."""
    theta, count = fit.modes[0].theta, next(iter(draws.values())).size
    found = np.tile(theta @ carried(fit.warming).T, (count, 1))
    for name, x in draws.items():
        value = np.log(x) if name in POSITIVE else x - (fit.reference[0] if name == "f0" else 0.0)
        found[:, NAMES.index(name)] = value.ravel()
    return found @ carried(-fit.warming).T - theta


def _no_loss(tangent: np.ndarray) -> str:
    """Why draws (n,) of tan d tell none; empty where they do."""
    e = Estimate.of(tangent, np.full(tangent.size, 1 / tangent.size))
    return UNTOLD_LOSS.format(e.low, e.high) if max(-e.low, e.high) > LOSSY else ""


def _no_capacitance(farad: np.ndarray) -> str:
    """Why draws (n,) of C0 are no capacitance; empty where they are one."""
    mean, std = float(np.mean(farad)), float(np.std(farad))
    said = f"{1e12 * mean:.3g} ± {1e12 * std:.2g}"
    if mean > SEEN * std and np.min(farad) > 0:
        return ""
    return (UNSEEN if mean > -SEEN * std else INDUCTIVE).format(said)
