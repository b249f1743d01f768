"""A peak that is blurred over the frequency: by the bandwidth of an analyser, or as the mean of sweeps
between which the resonance moved.

Each row shows the mean over a distribution of the detuning, of standard deviation s: of the response itself,
or of its power,

    y = E[W(f - s x)],    |y|^2 = E[|W(f - s x)|^2],    x = (z - E z)/std z,
    p(z) ~ (1 - z)^(c (1 + t) - 1) (1 + z)^(c (1 - t) - 1),    c = 1 + e^(2 + 2 shape),    t = tanh skew,

a Beta distribution, by Gauss-Jacobi quadrature: from even over a band (c = 1), as of a window or a drift, to
normal (c large), as of many sweeps. What is more at the ends than between them is no blur but two modes. A
Cauchy distribution of half width s would lower tau, 1/tau + 2 pi s, and no more: most of what blurs is taken
for tau, and it is told by what is left alone. So it is named and not adopted.
"""

import numpy as np
from scipy.special import roots_jacobi

from sysid.effects.effect import LEAST_ROWS, About, Effect, Told, always, fixed, nowhere, one, positive, sweep
from sysid.effects.number import Number
from sysid.trials.perturbed import LogResponse
from sysid.trials.trial import Trial

SHAPE, SKEW = 1.0, 0.5  # from nearly even to nearly normal, and from one end over the middle
WIDTHS = np.array([0.2, 0.5, 1.0])  # half bandwidths, of which it seems to have more than it has
FLAT = 5.0  # of the shape: as even, or as normal, as it can be seen to be
NODES = 24  # by which a blur of one half bandwidth is right to 2e-4 of the peak


def _blurred(trial: Trial, values: np.ndarray, about: About) -> Trial:
    """d and q as the mean of the response, an amplitude as that of its power."""
    std, skew, shape = values
    x, weight = _distribution(float(skew), float(shape))
    course = LogResponse.of(trial, about.reference, about.near)
    away = np.tile(2j * np.pi * about.half_bandwidth * std * x, (len(course.hold.drive), 1))
    each, plate = course.at(away).forced, course.forced
    if trial.signed:
        mean = each @ weight
    else:
        mean = plate / np.abs(plate) * np.sqrt(np.maximum(np.abs(each) ** 2 @ weight, 0.0))
    return trial.with_bench(alongside=trial.bench.moves + mean - plate)


def _distribution(skew: float, shape: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (NODES,) of mean 0 and of standard deviation 1, and their weights."""
    c, t = 1 + np.exp(np.clip(2 + 2 * shape, -FLAT, FLAT)), np.tanh(np.clip(skew, -1.0, 1.0))
    z, weight = roots_jacobi(NODES, c * (1 + t) - 1, c * (1 - t) - 1)
    weight = weight / np.sum(weight)
    z = z - weight @ z
    return z / np.sqrt(weight @ z**2), weight


def _said(trial: Trial, found: dict[str, Number]) -> Told:
    std = found["std_Hz"]
    return Told(
        f"its peak is blurred over the frequency, as by a standard deviation of {std:.3g} Hz:"
        " by an analyser's bandwidth, as a mean of sweeps between which the resonance"
        " moved, or by two modes that are nearer than they are wide",
        "record a single sweep, of a bandwidth much below that of the plate",
    )


BLUR = Effect(
    name="blur",
    shows=lambda trial: trial.swept and len(trial.log) >= LEAST_ROWS and (not trial.signed or sweep(trial)),
    stds=fixed(np.array([WIDTHS[-1], SKEW, SHAPE])),
    starts=fixed(WIDTHS[:, None] * np.eye(1, 3)),
    applied=_blurred,
    numbers=one("std_Hz", "Hz", lambda trial, about: about.half_bandwidth),
    said=_said,
    rough=always,
    settles=True,
    places=nowhere,
    makes_sense=positive,
)
