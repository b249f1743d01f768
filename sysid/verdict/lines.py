"""A line in the spectrum of what is left of a log: a tone, such as hum, of which neighbouring rows may share
no more than of noise, and which as noise that is coloured would hide all that is no larger.

Of the power of N independent numbers that are noise, sinusoids of k numbers at a given frequency hold the
share g with Beta(k/2, (N - k)/2); at the best of m frequencies more than g in fewer than m P(g) of all logs
(Fisher, Proc. Roy. Soc. A 125, 54, 1929, where k = 2).
"""

import numpy as np
from scipy.special import betainc

from sysid.effects.beside import MANY, TONE, turning
from sysid.effects.effect import lasted, oscillating
from sysid.trials.whitening import whitened
from sysid.verdict.linear import ENOUGH, Found, Linear
from sysid.verdict.linearised import LinearisedLog

CERTAIN = 2 * ENOUGH  # log of one over the chance, as a log may also be beaten by two modes


def line(i: int, view: LinearisedLog, fit: Linear) -> Found | None:
    """The strongest of the i-th log, where chance makes none like it."""
    trial = view.trial
    if not TONE.shows(trial) or trial.noise.rounded is not None:
        return None
    used = trial.noise.used
    left = whitened(view.residual[used], *trial.noise.whitening(coloured=True))
    rates = oscillating(trial.log.time[used], left)
    if not len(rates):
        return None
    turns = float(rates[0]) * lasted(trial) / (2 * np.pi)
    shapes = turning(trial, turns)[used]
    rows, target = (
        np.concatenate([x.real, x.imag]) if trial.channels > 1 else x.real for x in (shapes, left)
    )
    target = target - np.mean(target)
    size, *_ = np.linalg.lstsq(rows, target, rcond=None)
    share = 1 - float(np.sum((target - rows @ size) ** 2) / max(np.sum(target**2), 1e-300))
    k, n = rows.shape[::-1]
    rare = -np.log(max(len(left) * betainc((n - k) / 2, k / 2, 1 - share), 1e-300))
    if turns < MANY or rare < CERTAIN:
        return None
    moves = fit.moved(i, np.zeros(len(trial.log), complex))
    return Found(
        f"{trial.log.name}: {SAID.format(turns / lasted(trial))}", float(rare), moves, TONE.name, i, k
    )


SAID = "what is left of it holds a tone of {:.4g} Hz, as of hum; find what it comes from, or record longer"
