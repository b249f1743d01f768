"""All effects that a fit may adopt, in the order in which they act on a log."""

from sysid.effects.beside import FEEDTHROUGH, SLOPE, TONE_BESIDE
from sysid.effects.blur import BLUR
from sysid.effects.clock import DELAY, DWELL, EDGES, FILTERS, PHASE_DELAY, ROWS_LOST, SCATTER
from sysid.effects.drift import (
    F0_DRIFT,
    OFFSET_DRIFTS,
    OWN_RESONANCE,
    PHASE_DRIFT,
    SELF_HEATING,
    THERMOMETER_LAG,
)
from sysid.effects.drive import COMPRESSED, DEAD_BAND, LIMIT, POWER
from sysid.effects.effect import Effect
from sysid.effects.mode import SECOND_MODE, SECOND_POLE
from sysid.effects.plate import AMPLITUDE_DAMPING, ASYMMETRIC, CURVED, DUFFING, OVERSHOOT, TEMPERATURE_DAMPING
from sysid.effects.sensor import AC_COUPLING, IMAGE, SATURATIONS
from sysid.effects.stretch import STRETCH
from sysid.trials.trial import NUISANCES

EFFECTS: tuple[Effect, ...] = (
    *SATURATIONS,
    IMAGE,
    PHASE_DRIFT,
    AC_COUPLING,
    *ROWS_LOST,
    DELAY,
    EDGES,
    *FILTERS,
    OVERSHOOT,
    DUFFING,
    *AMPLITUDE_DAMPING,
    TEMPERATURE_DAMPING,
    CURVED,
    ASYMMETRIC,
    POWER,
    DEAD_BAND,
    LIMIT,
    COMPRESSED,
    SCATTER,
    F0_DRIFT,
    SELF_HEATING,
    OWN_RESONANCE,
    SECOND_MODE,
    SECOND_POLE,
    FEEDTHROUGH,
    SLOPE,
    TONE_BESIDE,
    BLUR,
    *OFFSET_DRIFTS,
    DWELL,
    PHASE_DELAY,
    THERMOMETER_LAG,
    STRETCH,
)
ADOPTED = tuple(dict.fromkeys(e.name for e in EFFECTS))  # as they are asked for
EVERY = (*NUISANCES, *ADOPTED)  # unless less is asked for
