"""A posterior with its fit as one file of arrays (.npz) and a tree of plain values (JSON): no pickle, nothing
that runs.

The tree holds None, booleans, numbers, texts and lists as they are; all else as an object of one key:

    {"array": k}  {"complex": [re, im]}  {"tuple": [...]}  {"dict": {...}}  {"Trial": {"log": {"Log": {...}}}}

Types are those of TYPES, by name; a field that an older file lacks takes its default. An object that was
one stays one: where it comes again stands {"same": n}, the n-th that was complete. Arrays of the same
content are one.
"""

import dataclasses
import hashlib
import io
import json
import struct
import zipfile
import zlib
from enum import Enum
from typing import Any

import numpy as np

from sysid import __version__
from sysid.effects.number import Number
from sysid.logs.log import Log
from sysid.minimum.minimise import State
from sysid.model.plant import Plant
from sysid.model.prior import Prior
from sysid.posterior.estimate import Estimate
from sysid.posterior.posterior import Posterior
from sysid.rows.hold import Hold
from sysid.trials.bench import Bench, Extra
from sysid.trials.noise import Level
from sysid.trials.trial import Trial
from sysid.trials.whitening import Jitter, Noise
from sysid.verdict.finding import Assumed, Finding
from sysid.verdict.fitted import Fit, FittedLog
from sysid.verdict.result import Parameter, Result

TYPES = {
    t.__name__: t
    for t in (
        *(Posterior, Estimate, Fit, FittedLog, Parameter, Result, State, Plant, Prior),
        *(Trial, Bench, Log, Hold, Noise, Level, Jitter, Extra, Finding, Assumed, Number),
    )
}
TIMES = ("seconds", "pace", "exact_pace")  # of a run, which the same result does not share
TREE = "tree.json"
FAST = 1  # zlib's level: noise hardly shrinks, and inputs that are held do at any
LARGEST = 1 << 32  # bytes of all that is in a file
# What reading a file of any other content may raise.
UNUSABLE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, AttributeError, LookupError),
    *(MemoryError, OverflowError, RuntimeError, TypeError, ValueError),
)
KINDS = "biufcU"  # of arrays: numbers and texts


class KeptError(ValueError):
    """A file that is no kept result: says what was found and what was expected."""


def pack(posterior: Posterior) -> bytes:
    """The file's bytes: the same for the same posterior, times aside, which are not kept."""
    packer = _Packer()
    tree = {"version": __version__, "posterior": packer.plain(posterior)}
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(zipfile.ZipInfo(TREE), json.dumps(tree), zipfile.ZIP_DEFLATED, FAST)
        for k, array in packer.arrays.values():
            entry = io.BytesIO()
            np.lib.format.write_array(entry, array, allow_pickle=False)
            file.writestr(zipfile.ZipInfo(f"{k}.npy"), entry.getbuffer(), zipfile.ZIP_DEFLATED, FAST)
    return whole.getvalue()


def unpack(whole: bytes) -> Any:
    """What was packed. Raises KeptError."""
    try:
        with zipfile.ZipFile(io.BytesIO(whole)) as file:
            if (claimed := sum(info.file_size for info in file.infolist())) > LARGEST:
                raise ValueError(f"{claimed} bytes")
            tree = json.loads(file.read(TREE))
            names = [name for name in file.namelist() if name != TREE]
            arrays = {name.removesuffix(".npy"): _array(file.read(name)) for name in names}
    except UNUSABLE as error:
        raise KeptError(f"found no kept result ({error}), expected what identify or fit.save wrote") from None
    version = tree.get("version") if isinstance(tree, dict) else None
    try:
        return _Unpacker(arrays).made(tree["posterior"])
    except UNUSABLE as error:
        said = f"found a result of version {version} that this one, {__version__}, cannot take up ({error})"
        raise KeptError(f"{said}, expected one of its own; run identify again on the logs") from None


def _array(content: bytes) -> np.ndarray:
    array = np.array(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))
    if array.dtype.kind not in KINDS:
        raise ValueError(f"an array of {array.dtype}")
    array.flags.writeable = False
    return array


class _Packer:
    """Trees of values; their `arrays` by content, numbered, and the numbers of complete `objects` by
    identity."""

    def __init__(self) -> None:
        self.arrays: dict[tuple, tuple[int, np.ndarray]] = {}
        self.objects: dict[int, int] = {}

    def plain(self, value: Any) -> Any:
        """The tree of a value."""
        if isinstance(value, Enum):
            return {type(value).__name__: value.name}
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, complex):
            return {"complex": [value.real, value.imag]}
        if isinstance(value, list):
            return [self.plain(item) for item in value]
        if isinstance(value, dict):
            return {"dict": {key: self.plain(item) for key, item in value.items()}}
        if type(value).__name__ in TYPES:
            return self._object(value)
        return (
            {"tuple": [self.plain(item) for item in value]}
            if isinstance(value, tuple)
            else self._array(value)
        )

    def _object(self, value: Any) -> dict[str, Any]:
        if id(value) in self.objects:
            return {"same": self.objects[id(value)]}
        names = getattr(value, "_fields", None) or [f.name for f in dataclasses.fields(value)]
        held = {name: float("nan") if name in TIMES else self.plain(getattr(value, name)) for name in names}
        self.objects[id(value)] = len(self.objects)
        return {type(value).__name__: held}

    def _array(self, value: Any) -> dict[str, int]:
        array = np.ascontiguousarray(value) if np.ndim(value) else np.asarray(value)
        if array.dtype.kind not in KINDS:
            raise TypeError(
                f"found a {type(value).__name__}, expected numbers, texts or one of {', '.join(TYPES)}"
            )
        key = (array.dtype.str, array.shape, hashlib.sha256(array.tobytes()).digest())
        return {"array": self.arrays.setdefault(key, (len(self.arrays), array))[0]}


class _Unpacker:
    """Values of trees, with the arrays by their numbers."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.arrays = arrays
        self.objects: list[Any] = []

    def made(self, tree: Any) -> Any:
        """The value of a tree."""
        if isinstance(tree, list):
            return [self.made(item) for item in tree]
        if not isinstance(tree, dict):
            return tree
        ((kind, content),) = tree.items()
        match kind:
            case "array":
                return self.arrays[str(content)]
            case "same":
                return self.objects[content]
            case "complex":
                return complex(*content)
            case "tuple":
                return tuple(self.made(item) for item in content)
            case "dict":
                return {key: self.made(item) for key, item in content.items()}
            case "Result":
                return Result[content]
        self.objects.append(TYPES[kind](**{name: self.made(item) for name, item in content.items()}))
        return self.objects[-1]
