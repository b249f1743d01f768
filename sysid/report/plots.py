"""The figures of the report, which `plot()` of a result gives too: those of logs, of the plate, and of a
prediction."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from sysid.posterior.each import own_estimates
from sysid.report import logplots, loopplots, plateplots, residualplots
from sysid.report.canvas import (
    BLUE,
    DOTS,
    GREY,
    ORANGE,
    Drawn,
    Figures,
    Picture,
    blank,
    drawn,
    styled,
    thin,
    time_axis,
)
from sysid.report.text import clean

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.posterior import Posterior
    from sysid.posterior.prediction import Prediction
    from sysid.verdict.fitted import Fit

__all__ = ["BLUE", "GREY", "ORANGE", "Figures", "blank", "styled", "time_axis"]


def fit_figures(fit: "Fit") -> tuple[Drawn, ...]:
    """The figures of a fit, for a page."""
    return drawn(of_fit(fit))


def of_fit(fit: "Fit") -> list[Picture]:
    """What there is to draw of a fit: logs, what is left of them, and what each says of the plate."""
    logs = logplots.of_logs(fit.logs)
    return [*logs, *plateplots.of_plate(fit, own_estimates(fit)), *residualplots.of_residuals(fit.logs)]


def of_posterior(posterior: "Posterior", parameters: Mapping[str, Any]) -> list[Picture]:
    """The draws of the parameters that the logs bound; `parameters` as in fit.json or in a summary."""
    return plateplots.of_posterior(posterior, parameters)


def log_figure(log: "Log") -> Figure:
    """A log as it was recorded."""
    return styled(lambda: logplots.log_figure(log))


def loop_figures(controller: Mapping[str, Any]) -> tuple[Figure, Figure]:
    """The step and the loop over frequency, of controller.json's content."""
    return styled(lambda: loopplots.step_of(controller)), styled(lambda: loopplots.bode_of(controller))


def prediction_figure(prediction: "Prediction") -> Figure:
    """What was recorded of a log, what is predicted, the model's error about that, and the noise's beside
    it."""
    return styled(lambda: _predicted(prediction))


def _predicted(prediction: "Prediction") -> Figure:
    """A panel each of Wd and Wq, or of W."""
    log, keep = prediction.log, thin(len(prediction.log))
    sweep = logplots.is_sweep(prediction)
    x, label = (log.frequency, "frequency (Hz)") if sweep else logplots.inputs(prediction)
    order = np.argsort(x, kind="stable")[keep]
    parts = logplots.parts(log)
    figure = blank(5.0 * len(parts), 2.9)
    for axes, (part, colour, name) in zip(
        figure.subplots(1, len(parts), squeeze=False).flat, parts, strict=True
    ):
        middle, std, noise = (
            part(v)[order] for v in (prediction.response, prediction.std, prediction.total_std)
        )
        for width, alpha, said in ((noise, 0.15, "with the noise"), (std, 0.5, "of the model")):
            axes.fill_between(
                x[order],
                middle - width,
                middle + width,
                color=colour,
                alpha=alpha,
                lw=0,
                label=f"± 1 std {said}",
            )
        axes.plot(x[order], part(log.response)[order], color=colour, label="recorded", **DOTS)
        axes.plot(x[order], middle, color=colour, label="predicted")
        axes.set_ylabel(clean(f"{name} ({log.response_unit})"))
        axes.set_xlabel(label)
        axes.legend(frameon=False)
    figure.subplots_adjust(0.35 / figure.get_figwidth() * 1.6, 0.17, 0.985, 0.97, 0.22)
    return figure
