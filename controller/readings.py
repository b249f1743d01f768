"""What a controller reads in a closed loop: the noise of its sensor, and its recorder."""

from typing import Any

import jax
import jax.numpy as jnp

from sysid.scene import engine
from sysid.scene.effects import Quantisation, Saturation

RECORDER = (Saturation, Quantisation)


def noise_of(effects: tuple, seed: Any, sample_time: Any, samples: int) -> tuple[Any, Any] | None:
    """What noise adds to each reading, and the share of the reading that it leaves: those effects are linear
    in it."""
    drawn = tuple(e for e in effects if e.kind == "noise" and not isinstance(e, RECORDER))
    if not drawn:
        return None
    key = jax.random.key(seed)
    states = tuple(e.init(engine.key_for(key, e, 0)) if hasattr(e, "init") else None for e in drawn)

    def made(value: float) -> Any:
        """(samples,) readings of a response that stays at `value`."""
        return engine.noisy(drawn, jnp.full(samples, value, complex), states, key, 0, sample_time)[0]

    offset = made(0.0)
    return offset, jnp.round((made(1.0) - offset).real)


def recorded(effects: tuple, response: Any, noise: Any) -> Any:
    """The reading of a response, in the noise that `noise_of` made of it."""
    response = response if noise is None else noise[0] + noise[1] * response
    for e in effects:
        if isinstance(e, RECORDER):
            response = e.noise(response, None, None, None)[0]
    return response
