"""All effects that a fit may adopt, in the order in which they act on a log."""

from sysid.effects.clock import DELAY, DWELL, FILTERS, ROWS_LOST
from sysid.effects.effect import Effect
from sysid.effects.plate import DUFFING, FEEDTHROUGH, OVERSHOOT, SECOND_MODE
from sysid.effects.sensor import SATURATIONS, SLOPE
from sysid.trials.trial import NUISANCES

EFFECTS: tuple[Effect, ...] = (
    *SATURATIONS,
    *ROWS_LOST,
    DELAY,
    *FILTERS,
    OVERSHOOT,
    DUFFING,
    SECOND_MODE,
    FEEDTHROUGH,
    SLOPE,
    DWELL,
)
ADOPTED = tuple(dict.fromkeys(e.name for e in EFFECTS))  # as they are asked for
EVERY = (*NUISANCES, *ADOPTED)  # unless less is asked for
