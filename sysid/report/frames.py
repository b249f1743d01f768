"""Results as tables of pandas: a log's rows, a fit's parameters, a posterior's draws, a prediction's band."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sysid.logs.written import columns, label, words

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.change import Change
    from sysid.posterior.posterior import Posterior
    from sysid.posterior.prediction import Prediction
    from sysid.verdict.fitted import Fit
    from sysid.verdict.result import Parameter


def of_log(log: "Log") -> pd.DataFrame:
    """The rows by the contract's names, which end in their units; what a CSV file has above its header
    stands in `attrs`."""
    frame = pd.DataFrame(columns(log))
    frame.attrs = {key: str(value) for key, value in words(log).items()}
    return frame


def of_fit(fit: "Fit") -> pd.DataFrame:
    """A row for each parameter, as fit.json has it: value, std, ends of the 95 % interval, unit,
    determined, why."""
    frame = of_parameters(fit.parameters)
    frame.attrs = {"result": fit.result.value, "reference_temperature_degC": fit.reference_temperature}
    return frame


def of_parameters(parameters: "Mapping[str, Parameter]") -> pd.DataFrame:
    """A row for each, as fit.json has it."""
    rows = {name: _parameter(p) for name, p in parameters.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")


def of_posterior(posterior: "Posterior") -> pd.DataFrame:
    """A row for each draw, by chain and draw; a column for each parameter, whose units stand in `attrs`."""
    chains, draws = next(iter(posterior.draws.values())).shape
    index = pd.MultiIndex.from_product([range(chains), range(draws)], names=["chain", "draw"])
    frame = pd.DataFrame({name: values.ravel() for name, values in posterior.draws.items()}, index)
    frame.attrs = {"units": {name: posterior.fit.units.get(name, "1") for name in posterior.draws}}
    return frame


def of_prediction(prediction: "Prediction") -> pd.DataFrame:
    """The log's rows, beside each response what is predicted of it, the model's standard deviation and
    that with the noise."""
    frame, unit = of_log(prediction.log), prediction.log.response_unit
    parts = {"w": np.real} if prediction.log.amplitude_only else {"wd": np.real, "wq": np.imag}
    for name, part in parts.items():
        told = {"predicted": prediction.response, "std": prediction.std, "total_std": prediction.total_std}
        for what, values in told.items():
            frame[label(unit, f"{name}_{what}")] = part(values)
    return frame


def of_change(change: "Change") -> pd.DataFrame:
    """A row for each parameter: old, new, change, its standard deviation, that in standard deviations, its
    probability."""
    fields = ("old", "new", "change", "std", "sigmas", "p", "unit")
    rows = {name: [getattr(d, field) for field in fields] for name, d in change.parameters.items()}
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=list(fields)).rename_axis("parameter")
    frame.attrs = {"chi_square": change.chi_square, "p": change.p, "changed": change.changed}
    return frame


def _parameter(p: Any) -> dict[str, Any]:
    low, high = p.ci95 or (None, None)
    numbers = {"value": p.value, "std": p.std, "ci95_low": low, "ci95_high": high}
    known = {name: np.nan if x is None else x for name, x in numbers.items()}
    return known | {"unit": p.unit, "determined": p.determined, "why": p.why}
