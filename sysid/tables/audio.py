"""WAV files: a channel is a column of samples, as a fraction of full scale, at the file's sample rate."""

import warnings
from typing import Any

import numpy as np

from sysid.tables.store import Store, library, readable
from sysid.tables.textfile import LogError


def read_wav(path: str, kind: str) -> Store:
    """The contents of a WAV file. Raises LogError where it is damaged, or cut off."""
    wavfile, store = library("scipy.io.wavfile", path, kind, "files"), Store(path, kind)
    with readable(store, "WAV file"), warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rate, samples = _samples(wavfile, path)
        store.claim("the samples", samples.size)
        store.claimed = 0
    if cut := next((str(of.message) for of in said if "EOF" in str(of.message)), ""):
        raise LogError(
            f"{path}: found a WAV file that is cut off ({cut}), expected one that was written to its end"
        )
    if not rate or not samples.size:
        raise LogError(f"{path}: found a WAV file of {samples.size} samples at {rate} Hz, expected some")
    kinds = {"i": float(2 ** (8 * samples.dtype.itemsize - 1)), "u": 128.0}
    scale, zero = kinds.get(samples.dtype.kind, 1.0), 128.0 if samples.dtype.kind == "u" else 0.0
    for k, channel in enumerate(np.atleast_2d(samples.T), 1):
        store.add("", f"channel {k}", (channel.astype(np.float64) - zero) / scale)
    store.constants["sample_rate_Hz"] = f"{rate}"
    return store


def _samples(wavfile: Any, path: str) -> tuple[int, np.ndarray]:
    """Sample rate and samples, which stay in the file where their width is one of numpy's."""
    try:
        return wavfile.read(path, mmap=True)
    except ValueError:  # of 24 bits
        return wavfile.read(path)
