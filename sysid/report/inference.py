"""A posterior as ArviZ's own type, for its plots and statistics: draws, log density, the logs, stated
priors."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sysid.posterior.posterior import Posterior

PRIOR = 1000  # draws of what is stated beforehand


def of_posterior(posterior: "Posterior") -> Any:
    """`arviz.InferenceData` of ArviZ 0.x, an `xarray.DataTree` of ArviZ 1.x. Raises ImportError, with what
    to install."""
    try:
        import arviz
    except ImportError:
        raise ImportError("to_inferencedata needs ArviZ: pip install 'sysid[arviz]'") from None
    groups = _groups(posterior)
    observed, names = _observed(posterior)
    groups["observed_data"] = observed
    dims = {name: [f"row_{name.partition('_')[2]}"] for name in observed}
    if int(arviz.__version__.partition(".")[0]) >= 1:
        found = arviz.from_dict(groups, dims=dims)
    else:
        found = arviz.from_dict(**groups, dims=dims)  # type: ignore[arg-type]
    units = posterior.fit.units
    for name in posterior.draws:
        found["posterior"][name].attrs["units"] = units.get(name, "1")
    for name, (log, unit) in names.items():
        found["observed_data"][name].attrs |= {"log": log, "units": unit}
    told = {"seed": posterior.seed, "accuracy": posterior.accuracy, "method": posterior.method}
    found["posterior"].attrs |= {"inference_library": "sysid", "result": posterior.result.value, **told}
    return found


def _groups(posterior: "Posterior") -> dict[str, dict[str, np.ndarray]]:
    """Draws (chain, draw), their log density, and draws of the priors that were stated."""
    groups = {"posterior": dict(posterior.draws), "sample_stats": {"lp": posterior.log_density}}
    if stated := posterior.fit.priors:
        rng = np.random.default_rng(posterior.seed)
        groups["prior"] = {name: rng.normal(value, std, (1, PRIOR)) for name, (value, std) in stated.items()}
    return groups


def _observed(posterior: "Posterior") -> tuple[dict[str, np.ndarray], dict[str, tuple[str, str]]]:
    """The responses of each log, such as wd_1 and wq_1, with the log's name and their unit."""
    values: dict[str, np.ndarray] = {}
    names: dict[str, tuple[str, str]] = {}
    for number, fitted in enumerate(posterior.fit.logs, 1):
        log = fitted.log
        parts = (
            {"w": log.response} if log.amplitude_only else {"wd": log.response.real, "wq": log.response.imag}
        )
        values |= {f"{part}_{number}": x for part, x in parts.items()}
        names |= {f"{part}_{number}": (log.name, log.response_unit) for part in parts}
    return values, names
