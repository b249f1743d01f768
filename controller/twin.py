"""A step in fixed point as it runs in Python: on integers or arrays of them, bit for bit what the exported C computes."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from controller import operations as op
from controller.operations import MISSING


class Twin(NamedTuple):
    """The recorded `operations` by the names of their results, for words of `bits` bits.

    `first` is the state at the beginning, `then` and `output` which words become the next state and what is given out;
    `states` and `points` are the scales of the state and of inputs and outputs by name.
    """

    bits: int
    operations: dict[str, op.Operation]
    first: dict[str, int]
    then: dict[str, int | str]
    output: dict[str, int | str]
    states: dict[str, int]
    points: dict[str, int]

    def step(self, state: Mapping[str, Any], **words: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """One sample: the next state, and the output by name, all in words."""
        top = 2 ** (self.bits - 1) - 1
        values: dict[str, Any] = {MISSING: -top - 1, **words}
        for name, made in self.operations.items():
            values[name] = made.run(values, state, top)
        said = [{k: op.value(values, v) for k, v in names.items()} for names in (self.then, self.output)]
        return said[0], said[1]

    def number(self, name: str, word: Any) -> Any:
        """What a word of an input or an output stands for."""
        return np.ldexp(np.asarray(word, float), -self.points[name])

    def word(self, name: str, value: Any) -> Any:
        """The word for a number, saturated; for one that is not finite, the word that says so."""
        top = 2 ** (self.bits - 1) - 1
        there = np.isfinite(value)
        scaled = np.ldexp(np.where(there, value, 0.0), self.points[name])
        near = np.where(scaled < 0, -np.floor(0.5 - scaled), np.floor(0.5 + scaled))
        return np.where(there, np.clip(near, -top, top), -top - 1).astype(np.int64)
