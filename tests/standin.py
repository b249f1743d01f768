"""A posterior without a fit: what the files and the report look at, in milliseconds and with numbers known by
heart."""

from types import SimpleNamespace

import numpy as np

from sysid.logs.log import Log
from sysid.posterior.diagnostics import Convergence
from sysid.verdict.result import Parameter, Result

UNITS = {"G": "um/V", "tau": "s", "f0": "Hz", "k_T": "Hz/degC"}
MEANS = {"G": 0.02, "tau": 1.669e-3, "f0": 32300.0}
STDS = {"G": 5e-5, "tau": 7e-6, "f0": 0.4}


def fitted(
    name="step.csv", kind="transient", rows=50, amplitude_only=False, noise_time=0.0, nrmse=1.25, **changes
):
    """A log and its fit: a rise for a transient, a circle for a sweep, a line for settled points of one
    frequency."""
    x = np.linspace(0, 1, rows)
    model = 1 / (1 + 1j * (8 * x - 4)) if kind == "steady" else (1 - np.exp(-5 * x)) * (1 + 0.2j)
    noise = np.random.default_rng(0).normal(0, 0.01, (2, rows))
    residual = noise[0] + 1j * noise[1]
    if amplitude_only:
        model, residual = np.abs(model), residual.real
    inputs = {
        "drive": np.full(rows, 50.0),
        "frequency": 32000 + 500 * x if kind == "steady" else np.full(rows, 32290.0),
    }
    inputs |= {} if kind == "steady" else {"time": 0.02 * x}
    described = (
        "settled points, 32000 to 32500 Hz" if kind == "steady" else "transient, drive changes 1 times"
    )
    return SimpleNamespace(
        log=Log(
            name, model + residual, kind=kind, path=f"logs/{name}", sha256="0" * 64, **(inputs | changes)
        ),
        kind=kind,
        response=model,
        residual=residual,
        nrmse_percent=nrmse,
        noise_std=0.01,
        noise_time=noise_time,
        noise="correlated" if noise_time else "white",
        levels=(),
        description=described,
    )


def posterior(logs=None, result=Result.successful, missing=(), ess=1300.0, modes=()):
    """A posterior of (4 chains, 100 draws); the parameters in `missing`, and k_T, are not determined."""
    rng = np.random.default_rng(1)
    draws = {
        name: MEANS[name] + STDS[name] * rng.standard_normal((4, 100))
        for name in MEANS
        if name not in missing
    }
    found = {
        name: Parameter(None, None, None, UNITS[name], False, f"cannot tell {name}; record more", modes)
        for name in UNITS
    }
    for name, x in draws.items():
        low, high = np.quantile(x, [0.025, 0.975])
        found[name] = Parameter(float(x.mean()), float(x.std()), (float(low), float(high)), UNITS[name], True)
    logs = tuple(logs or (fitted(), fitted("sweep.csv", "steady", 60)))
    told = {"parameters": found, "units": UNITS, "reference_temperature": 24.0, "warnings": (), "priors": {}}
    names = tuple(MEANS)
    covariance = np.diag([STDS[name] ** 2 for name in names])
    told |= {"notes": (), "findings": (), "assumed": (), "modes": ()}
    fit = SimpleNamespace(logs=logs, result=result, names=names, covariance=covariance, **told)
    off = {
        name: SimpleNamespace(value=0.002 * STDS[name], std=0.001 * STDS[name], low=0.0, high=0.0)
        for name in draws
    }
    given = {
        "fit": fit,
        "draws": draws,
        "summary": lambda: found,
        "ess": ess,
        "rhat": 1.004,
        "result": result,
        "seed": 3,
    }
    given |= {"convergence": {name: Convergence.of(x) for name, x in draws.items()}}
    given |= {"errors": off, "twice": lambda: 0.84, "offer": lambda: None}
    quick = SimpleNamespace(accuracy="quick", evaluations=32, error=0.04, moved=None, below=None, **given)
    given |= {
        "method": "emcee",
        "accuracy": "standard",
        "evaluations": 1376,
        "error": 0.004,
        "moved": 0.03,
        "below": quick,
    }
    return SimpleNamespace(**given)
