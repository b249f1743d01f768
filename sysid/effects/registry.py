"""All effects that a fit may adopt, in the order in which they act on a log."""

from collections.abc import Iterable

from sysid.effects.beside import CROSSTALK, FEEDTHROUGH, SLOPE, TONE
from sysid.effects.blur import BLUR
from sysid.effects.clock import DELAY, DWELL, EDGES, PHASE_DELAY, ROWS_LOST, SCATTER
from sysid.effects.drift import (
    F0_DRIFTS,
    OFFSET_DRIFTS,
    OWN_RESONANCE,
    PHASE_DRIFT,
    SELF_HEATING,
    THERMOMETER_LAGS,
)
from sysid.effects.drive import COMPRESSED, DEAD_BAND, DRIVE_OVERSHOOT, DRIVE_SAG, LIMIT, POWER
from sysid.effects.effect import Effect
from sysid.effects.filter import FILTERS
from sysid.effects.mode import SECOND_MODE, SECOND_POLE
from sysid.effects.plate import (
    AMPLITUDE_DAMPING,
    ASYMMETRIC,
    CURVED,
    DUFFING,
    OFF_RESONANCE,
    OVERSHOOT,
    TEMPERATURE_DAMPING,
    TEMPERATURE_GAIN,
)
from sysid.effects.sensor import AC_COUPLING, IMAGE, SATURATIONS
from sysid.effects.stretch import STRETCH
from sysid.trials.extra import EXTRA
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
    *OFF_RESONANCE,
    OVERSHOOT,
    DUFFING,
    *AMPLITUDE_DAMPING,
    TEMPERATURE_DAMPING,
    TEMPERATURE_GAIN,
    CURVED,
    ASYMMETRIC,
    POWER,
    DEAD_BAND,
    LIMIT,
    COMPRESSED,
    DRIVE_OVERSHOOT,
    DRIVE_SAG,
    SCATTER,
    *F0_DRIFTS,
    SELF_HEATING,
    OWN_RESONANCE,
    SECOND_MODE,
    SECOND_POLE,
    FEEDTHROUGH,
    SLOPE,
    *CROSSTALK,
    TONE,
    BLUR,
    *OFFSET_DRIFTS,
    DWELL,
    PHASE_DELAY,
    *THERMOMETER_LAGS,
    STRETCH,
)
ADOPTED = tuple(dict.fromkeys(e.name for e in EFFECTS))  # as they are asked for
EVERY = (*NUISANCES, *ADOPTED)  # unless less is asked for


def chosen(text: str | Iterable[str]) -> tuple[str, ...]:
    """`rotation,late`: those alone; `-late,+drift`: the usual ones without one and with another; `none`; in
    one text or in several. Raises ValueError for others."""
    known = (*EVERY, *EXTRA)
    text = text if isinstance(text, str) else ",".join(text) or "none"
    names = [] if text == "none" else [name.strip() for name in text.split(",")]
    if unknown := {name[1:] if name[:1] in ("+", "-") else name for name in names} - set(known):
        raise ValueError(
            f"found {', '.join(sorted(unknown)) or 'nothing'}, expected some of {', '.join(known)}, or none"
        )
    changed = {name[1:]: name[0] == "+" for name in names if name[0] in "+-"}
    if changed and len(changed) < len(names):
        raise ValueError(f"found {text}, expected names alone, or each with a minus or a plus before it")
    return tuple(name for name in known if (changed.get(name, name in EVERY) if changed else name in names))
