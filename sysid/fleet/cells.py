"""Cells of plates of one layout that are nearly alike, and the tests of each.

A plate's own test is a polynomial of its place through those of the cell's nodes: its rows w, by whose size
the numbers w^T r/|w| have unit variance, and what they move. What is usual is that of the cell in its own
noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from sysid.fleet import nodes
from sysid.fleet.arrays import Rows, on_rows, padding, there
from sysid.fleet.batch import Batch
from sysid.fleet.closed import Block
from sysid.fleet.near import Near, near_at, products_of, size_of
from sysid.fleet.nodes import AXES
from sysid.fleet.plate import digest
from sysid.fleet.template import Template
from sysid.fleet.tests import Placed, Tests
from sysid.kept import arrays
from sysid.logs.log import Log

# width of a cell: in log tau and in half bandwidths, of which the nodes follow half of the tests to 0.04 of
# their noise, and those that change by leaps, as of rows that are clipped, to 0.2 to 0.5; in the logarithm of
# narrowed priors over the noise, which tests follow in proportion; factors of noise over the response, by
# which no more than priors of the bench differ, and of that of a log over that of the first
WIDTHS = (0.4, 0.8, 1.4, 4.0, 2.0)
BLOCK = (
    3  # cells along each axis that have terms in common: with those beside it a middle has neighbours only
)
KEPT = 40  # nodes that are not linearised anew: those of a cell and of the four beside it, which share edges


@dataclass(frozen=True, eq=False)
class Cell:
    """The `tests` of a cell, which are those of a `template`; `narrowed`: its priors are."""

    template: Template
    tests: Tests = field(repr=False)
    narrowed: bool

    def share(self, away: np.ndarray) -> np.ndarray:
        """(P, N) what each node counts for plates that are `away` (P, AXES) from the middle."""
        return nodes.shares(away, self.narrowed)

    def placed(
        self,
        rows: Rows,
        which: np.ndarray,
        share: np.ndarray,
        phases: np.ndarray,
        power: np.ndarray,
        wider: np.ndarray,
    ) -> Placed:
        """Of these plates (p,) of all, by the residuals (P, R) of all in the plate's frame, with those of the
        priors; for which the nodes have a `share` (p, N); `power` (p, logs) of the noise, over that of the
        cell."""
        size, each = self.sizes(share), power[:, self.template.logs]
        values = self.tests.values * (np.sqrt(each) / size)[:, :, None]
        moves = np.tensordot(share, self.tests.moves, 1) / size[:, None]
        larger = np.exp(share @ self._larger)
        usual = self.tests.usual * size**2 * larger / each
        numbers = self.numbers(rows, which, share) / size
        return Placed(numbers, values, moves, usual, phases, np.sqrt(power[:, 0]), wider)

    def sizes(self, share: np.ndarray) -> np.ndarray:
        """(P, q) of the rows of all tests of plates with such shares."""
        return size_of(self._products, share)

    def numbers(self, rows: Rows, which: np.ndarray, share: np.ndarray) -> np.ndarray:
        """(p, q) products of the rows of these plates with those of the tests there."""
        more = padding(len(which))
        some = np.pad(which, (0, more), mode="edge") if more else which
        found = np.asarray(_products(rows, some, *self._weights))[: len(which)]
        return (share[:, None] @ found.reshape(len(found), *self.tests.weights.shape[1:]))[:, 0]

    @cached_property
    def _weights(self) -> tuple[Rows, Rows]:
        weights = self.tests.weights
        return there(self.tests.basis), there(weights.reshape(len(weights), -1))

    @cached_property
    def _products(self) -> np.ndarray:
        return products_of(self.tests.weights.astype(float))

    @cached_property
    def _larger(self) -> np.ndarray:
        return np.repeat(self.tests.larger, self.template.sizes, axis=1)


class Cells:
    """The cells of one layout, and their templates, made as they are needed: of the inputs of `logs`, whose
    `blocks` are of one plate."""

    def __init__(self, logs: Sequence[Log], blocks: Sequence[Block]):
        self.logs, self.blocks = logs, blocks
        self.made: dict[tuple, Cell | str] = {}
        self.templates: dict[tuple, Template | str] = {}
        self.said: dict[str, str] = {}
        self._near_at = lru_cache(KEPT)(
            lambda theta, narrow, levels: near_at(logs, blocks, np.array(theta), narrow, levels)
        )

    def why(self, name: str, at: float | None) -> str:
        """Why a parameter that is not free is not determined, at that temperature (degC)."""
        key = "" if at is None else f"{at:.1f}"  # as the sentence has it
        if key not in self.said:
            template = next(t for t in self.templates.values() if not isinstance(t, str))
            self.said[key] = template.why(name, at)
        return self.said[key]

    def places(self, batch: Batch) -> np.ndarray:
        """(P, AXES) where each plate is, in cells."""
        detuning = 2 * np.pi * batch.tau * (batch.theta[:, 2] - batch.blocks[-1].middle)
        narrow = np.zeros(len(detuning))
        for x in (x for x in batch.logs if not x.block.swept):
            width = x.prior[:, x.block.names.index("feedthrough")]
            narrow = np.where(batch.tight, np.log(width / np.maximum(x.std, 1e-300)), 0.0)
        found = np.stack([batch.theta[:, 1], detuning, narrow], axis=1) / WIDTHS[:AXES]
        return np.nan_to_num(np.clip(found, -1e6, 1e6))

    def keys(self, batch: Batch) -> np.ndarray:
        """(P, AXES + logs + 1) whole numbers of each plate's cell."""
        first, *others = np.log(_levels(batch)).T
        found = [first / np.log(WIDTHS[-2]), *((other - first) / np.log(WIDTHS[-1]) for other in others)]
        levels = np.nan_to_num(np.clip(np.stack(found, axis=1), -1e6, 1e6))
        whole = np.rint(np.concatenate([self.places(batch), levels], axis=1))
        return np.concatenate([whole, batch.tight[:, None]], axis=1).astype(int)

    def powers(self, batch: Batch, keys: np.ndarray) -> np.ndarray:
        """(P, logs) of each plate's noise, over that of its cell."""
        return (_levels(batch) / _of_cells(keys)) ** 2

    def cell(self, key: np.ndarray) -> Cell | str:
        """One of them; why the batch does not cover it."""
        if (known := self.made.get(tuple(key))) is None:
            known = self.made[tuple(key)] = self._made(key)
        return known

    def _made(self, key: np.ndarray) -> Cell | str:
        """That of this key, by its tests on disk, if they are there."""
        template = self._template(key)
        if isinstance(template, str):
            return template

        def tests() -> Mapping[str, np.ndarray]:
            each = nodes.places(bool(key[-1])) * nodes.turned(key)
            return Tests.of(template.terms, [self._near(key, place) for place in each])._asdict()

        kept = arrays("tests", f"{self.inputs} {key.tolist()}", tests)
        return Cell(template, Tests(**kept), bool(key[-1]))

    def _template(self, key: np.ndarray) -> Template | str:
        """That of a cell and of those beside it; why the batch does not cover them."""
        middle = np.concatenate([BLOCK * ((key[:AXES] + BLOCK // 2) // BLOCK), key[AXES:]])
        if (known := self.templates.get(tuple(middle))) is None:
            near, why = self._near(middle)
            known = self.templates[tuple(middle)] = why if near is None else Template(near)
        return known

    def _near(self, key: np.ndarray, away: np.ndarray | float = 0.0) -> tuple[Near | None, str]:
        """What is tried `away` (AXES,) from the middle of a cell; why plates there are not for the batch."""
        levels, gain = _of_cells(key[None])[0], 1 / np.abs(self.blocks[-1].drive[0])
        sizes = [float(x * gain * np.abs(b.drive[0])) for x, b in zip(levels, self.blocks, strict=True)]
        theta, narrow = self.place(key[:AXES] + away, gain, sizes, bool(key[-1]))
        return self._near_at(tuple(theta.tolist()), narrow, tuple(sizes))

    @cached_property
    def inputs(self) -> str:
        """A digest of all that tests hang on but the plate."""
        silent = [np.zeros_like(log.response) for log in self.logs]
        plain = [
            replace(log, response=r, name="", path="", sha256="", metadata={}, notes=())
            for log, r in zip(self.logs, silent, strict=True)
        ]
        return " ".join(map(digest, plain))

    def place(
        self, place: np.ndarray, gain: float, levels: Sequence[float], tight: bool
    ) -> tuple[np.ndarray, float]:
        """What a plate of that gain in noise of these levels is there, as `Template.of` has it."""
        tau, detuning, narrow = place * WIDTHS[:AXES]
        f0 = self.blocks[-1].middle[0] + detuning / (2 * np.pi * np.exp(tau))
        noise = next((s for s, b in zip(levels, self.blocks, strict=True) if not b.swept), 0.0)
        return np.array([np.log(gain), tau, f0]), float(np.exp(narrow) * noise) if tight else np.inf


def _levels(batch: Batch) -> np.ndarray:
    """(P, logs) the noise of each log over its settled response."""
    gain = np.exp(batch.theta[:, 0])
    return np.stack([np.maximum(x.std, 1e-300) / (gain * np.abs(x.block.drive)) for x in batch.logs], axis=1)


def _of_cells(keys: np.ndarray) -> np.ndarray:
    """(P, logs) the same in the middle of cells."""
    first = WIDTHS[-2] ** keys[:, AXES : AXES + 1]
    return np.concatenate([first, first * WIDTHS[-1] ** keys[:, AXES + 1 : -1]], axis=1)


@on_rows()
def _products(xp: Any, rows: Rows, which: np.ndarray, basis: Rows, weights: Rows) -> Rows:
    return rows[which] @ basis @ weights
