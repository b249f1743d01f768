"""What is the matter with the time of a log: a delay before the response, a sweep that was not waited for."""

from dataclasses import replace

import numpy as np

from sysid.effects.effect import About, Effect, read_anew
from sysid.rows.hold import read_at
from sysid.trials.trial import Trial
from sysid.verdict.hurried import ENOUGH, one_way
from sysid.verdict.late import THROUGH

ROWS = np.array([-2.0, -1.0, 1.0, 2.0, 4.0, 8.0])  # by which a log may be late, or early
TAUS = np.array([0.02, 0.06, 0.2, 0.5, 1.0, 2.0])
DWELLS = 2.0 ** np.arange(-2, 2.5, 0.5)[:, None]  # tau: of less a sweep shows no resonance, of more its points settle


def _delay_shows(trial: Trial) -> bool:
    return not trial.steady and trial.driven and trial.changes > 0 and trial.log.theta is None and "late" in trial.nuisances


def _delayed(trial: Trial, values: np.ndarray, about: About) -> Trial:
    delay = trial.log.bench.get("delay_s", 0.0) + float(values[0])
    log = replace(trial.log, bench={**trial.log.bench, "delay_s": delay})
    inputs, narrow = read_at(trial.inputs, log.time, delay), trial.narrow | {"feedthrough": THROUGH * trial.scale}
    return replace(trial, log=log, inputs=inputs, narrow=narrow, extra={}, resonance=None, late=0.0)


def _delay_said(trial: Trial, values: np.ndarray, stds: np.ndarray) -> str:
    way = "behind" if values[0] > 0 else "before"
    return (
        f"the response is {abs(values[0]):.3g} ± {stds[0]:.1g} s {way} the inputs that are recorded, which is fitted; state"
        f" delay_s ({trial.log.bench.get('delay_s', 0.0):.4g}), or the demodulator's lockin_tau_s and lockin_order"
    )


DELAY = Effect(
    name="delay",
    shows=_delay_shows,
    stds=lambda trial, about: np.array([max(about.tau, ROWS[-1] * trial.spacing)]),
    starts=lambda trial, about: np.append(ROWS * trial.spacing, TAUS * about.tau)[:, None],
    applied=_delayed,
    said=_delay_said,
    alike=("late", "early", "rows lost", "astray"),
)


def _hurried(trial: Trial, values: np.ndarray, about: About) -> Trial:
    time = max(float(values[0]), 1e-3) * about.tau * np.arange(len(trial.log))
    return read_anew(trial, time=time, kind="transient", sampling="settled")


DWELL = Effect(
    name="dwell",
    shows=one_way,
    stds=lambda trial, about: np.array([ENOUGH]),
    starts=lambda trial, about: DWELLS,
    applied=_hurried,
    said=lambda trial, values, stds: (
        f"swept too fast for settled points (dwell about {values[0]:.2g} ± {stds[0]:.1g} tau), and read as such a sweep; dwell"
        f" {ENOUGH:.0f} tau or longer at each frequency, or record the time of every row and say kind: transient"
    ),
    alike=("swept too fast", "second resonance"),
)
