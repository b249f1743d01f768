"""All effects that a fit may adopt, in the order in which they act on a log."""

from sysid.effects.clock import DELAY, DWELL, FILTERS, ROWS_LOST, THERMOMETER_LAG
from sysid.effects.effect import Effect
from sysid.effects.plate import (
    AMPLITUDE_DAMPING,
    DUFFING,
    F0_DRIFT,
    FEEDTHROUGH,
    OVERSHOOT,
    SECOND_MODE,
    SELF_HEATING,
)
from sysid.effects.sensor import OFFSET_DRIFT, SATURATIONS, SLOPE
from sysid.trials.trial import NUISANCES

EFFECTS: tuple[Effect, ...] = (
    *SATURATIONS,
    *ROWS_LOST,
    DELAY,
    *FILTERS,
    OVERSHOOT,
    DUFFING,
    *AMPLITUDE_DAMPING,
    F0_DRIFT,
    SELF_HEATING,
    SECOND_MODE,
    FEEDTHROUGH,
    SLOPE,
    OFFSET_DRIFT,
    DWELL,
    THERMOMETER_LAG,
)
ADOPTED = tuple(dict.fromkeys(e.name for e in EFFECTS))  # as they are asked for
EVERY = (*NUISANCES, *ADOPTED)  # unless less is asked for
