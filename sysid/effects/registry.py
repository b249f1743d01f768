"""All effects that a fit may adopt, in the order in which they act on a log."""

from sysid.effects.clock import DELAY, DWELL
from sysid.effects.effect import Effect
from sysid.effects.plate import DUFFING, FEEDTHROUGH, SECOND_MODE

EFFECTS: tuple[Effect, ...] = (DELAY, DUFFING, SECOND_MODE, FEEDTHROUGH, DWELL)
ADOPTED = tuple(e.name for e in EFFECTS)  # as they are asked for
