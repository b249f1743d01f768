"""Random numbers by name: each part of a scene has a stream of its own, so that adding one changes no
other's."""

from zlib import crc32

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """The generator of what is called `name`."""
    return np.random.default_rng([seed, crc32(name.encode())])
