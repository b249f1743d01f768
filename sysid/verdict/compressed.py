"""Whether a log is compressed at its largest, tried in full: undone, and all else fitted anew.

To first order a compression explains much of what other things do to the largest rows, an overshoot among them. Undone by what it
takes from the largest row, y (1 + c (|y|/y_max)^p), the log of a channel that saturates is that of the plate, and only noise is
left; of anything else as much is left as before.
"""

from dataclasses import replace

import numpy as np

from sysid.minimum.minimise import Minimiser, State
from sysid.trials.trial import Trial
from sysid.verdict.unexplained import SIGNIFICANT, shared

TAKEN = (0.02, 0.07, 0.2, 0.5)  # of the largest row
POWERS = (2, 6)
LEFT = 0.1  # of the power that neighbouring rows share: what a grid that coarse leaves of a compression


def compressed(minimiser: Minimiser, state: State, i: int) -> bool:
    """Whether what is left of the i-th log is explained by a compression of its response, or of each of its channels."""
    before, _ = shared(state.trials[i], state.models[i])
    for power in POWERS:
        for each in (False, True) if np.iscomplexobj(state.trials[i].log.response) else (False,):
            for taken in TAKEN:
                trial = _undone(state.trials[i], taken, power, each)
                anew = minimiser.refine((*state.trials[:i], trial, *state.trials[i + 1 :]), state.theta, rounds=4)
                left, chance = shared(anew.trials[i], anew.models[i])
                if left <= LEFT * before or chance < SIGNIFICANT:
                    return True
    return False


def _undone(trial: Trial, taken: float, power: int, each: bool) -> Trial:
    y = trial.log.response

    def of(part: np.ndarray) -> np.ndarray:
        return part * (1 + taken * (np.abs(part) / np.max(np.abs(y))) ** power)

    return replace(trial, log=replace(trial.log, response=of(y.real) + 1j * of(y.imag) if each else of(y)))
