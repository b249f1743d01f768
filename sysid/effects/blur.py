"""A peak that is blurred over the frequency: by the bandwidth of an analyser, or as the mean of sweeps
between which the resonance moved.

Each row shows the mean over a distribution of the detuning, of standard deviation s: of the response itself,
or of its power,

    y = E[W(f - s x)],    |y|^2 = E[|W(f - s x)|^2],
    p(x) = phi(x) (1 + skew He_3(x)/6 + excess He_4(x)/24),

as of a window, or of a few sweeps, by Gauss-Hermite quadrature (p: Gram-Charlier). A Cauchy distribution of
half width s would lower tau, 1/tau + 2 pi s, and no more: most of what blurs is taken for tau, and it is told
by what is left alone. So it is named and not adopted.
"""

import numpy as np
from numpy.polynomial.hermite_e import hermegauss, hermeval

from sysid.effects.effect import LEAST_ROWS, About, Effect, Told, always, nowhere, positive, sweep
from sysid.effects.number import Number, number, pm
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

SHAPE = 1.0  # of the skewness and the excess: those of six sweeps, and of two to twenty-four
WIDTHS = np.array([0.2, 0.5, 1.0])  # half bandwidths, of which it seems to have more than it has
NODES = 24  # by which a blur of one half bandwidth is right to 2e-4 of the peak


def _blurred(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """d and q as the mean of the response, an amplitude as that of its power."""
    std, skew, excess = values
    x, weight = hermegauss(NODES)
    weight = weight / np.sum(weight) * hermeval(x, [1.0, 0.0, 0.0, skew / 6, excess / 24])
    course = LogResponse.of(trial, about.reference, about.near)
    away = np.tile(2j * np.pi * about.half_bandwidth * std * x, (len(course.hold.drive), 1))
    each, plate = course.at(away).forced, course.forced
    if trial.signed:
        mean = each @ weight
    else:
        mean = plate / np.abs(plate) * np.sqrt(np.maximum(np.abs(each) ** 2 @ weight, 0.0))
    return trial.with_bench(alongside=trial.bench.moves + mean - plate)


def _said(trial: Trial, found: dict[str, Number]) -> Told:
    std = found["std_Hz"]
    return Told(
        f"its peak is blurred over the frequency, as by a standard deviation of {std.value:.3g} ±"
        f" {pm(std.std)} Hz: by an analyser's bandwidth, as a mean of sweeps between which the resonance"
        " moved, or by two modes that are nearer than they are wide",
        "record a single sweep, of a bandwidth much below that of the plate",
    )


BLUR = Effect(
    name="blur",
    shows=lambda trial: trial.swept and len(trial.log) >= LEAST_ROWS and (not trial.signed or sweep(trial)),
    stds=lambda trial, about: np.array([WIDTHS[-1], SHAPE, SHAPE]),
    starts=lambda trial, about: WIDTHS[:, None] * np.eye(1, 3),
    applied=_blurred,
    numbers=lambda trial, values, stds, about: {
        "std_Hz": number(values[0], stds[0], "Hz", about.half_bandwidth)
    },
    said=_said,
    rough=always,
    settles=True,
    places=nowhere,
    makes_sense=positive,
)
