"""The tests of a cell at its nodes, as arrays that can be kept: the single fit's own terms, linearised
there; and those of plates between the nodes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid.fleet.near import Near, matched
from sysid.verdict.averaged import side_by_side
from sysid.verdict.firstorder import Place
from sysid.verdict.linear import Linear, Scored
from sysid.verdict.term import Term

RANK = 1e-2  # of a test's size, less than which of it is left out: of its number a hundredth, in white noise


class Tests(NamedTuple):
    """The tests of a cell, side by side, q numbers of all of them: at its first node `values` (q, M), of each
    number those of a coefficient, and `usual` (q,), as `linear.Scored` has them. At its N nodes `weights` (k,
    N, q) of a `basis` (R, k), whose products with rows they are; `moves` (N, 3, q), what they move; `larger`
    (N, K), by what the variance of what is usual is larger there, as a logarithm; `second` (N, logs, 3): by
    what G, tau and f0 move, in their errors, with the square (s^2) of a lateness; `refused` (N,): why the
    batch does not cover plates there."""

    values: np.ndarray
    usual: np.ndarray
    basis: np.ndarray
    weights: np.ndarray
    moves: np.ndarray
    larger: np.ndarray
    second: np.ndarray
    refused: np.ndarray

    @classmethod
    def of(cls, terms: Near, nodes: "Sequence[tuple[Near | None, str]]") -> "Tests":
        """Of these `terms` at the nodes of a cell. What there is not at the first is as it is where the terms
        are of, and what there is not at another as it is at the first."""
        first = nodes[0][0] or terms
        known = _known(terms, first)
        own = [(*k.fit.rows(k.term, k.scored), 0.0) for k in known]
        found = [
            own if near is None or near is first else _elsewhere(terms, known, near, own) for near, _ in nodes
        ]
        rows, moves, larger = ([[test[part] for test in tests] for tests in found] for part in range(3))
        values = [_in_units(x.term, k) for x, k in zip(terms.tried, known, strict=True)]
        weights = np.stack([np.concatenate(each, axis=1) for each in rows], axis=1)
        basis, parts = (x.astype(np.float32) for x in _compressed(weights))
        return cls(
            side_by_side(values),
            np.concatenate([k.scored.usual for k in known]),
            basis,
            parts,
            np.array([np.concatenate(each, axis=1) for each in moves]),
            np.array(larger),
            np.array([_second(near or first) for near, _ in nodes]),
            np.array([why for _, why in nodes]),
        )


class Placed(NamedTuple):
    """Of plates all tests of one template, q numbers side by side: what the plates' logs hold, `numbers` (P,
    q); the coefficients of each number, `values` (P, q, M), what it moves of G, tau and f0, in errors,
    `moves` (P, 3, q), and the variance of what is `usual` (P, q). In which PHASES of a quarter turn each
    rotation is, `phases` (P, logs); the noise of the first log over that of the template, `loud` (P,); by how
    much `wider` (P, 3) errors are than those of the fit, as harm is measured."""

    numbers: np.ndarray
    values: np.ndarray
    moves: np.ndarray
    usual: np.ndarray
    phases: np.ndarray
    loud: np.ndarray
    wider: np.ndarray

    def of(self, which: np.ndarray) -> "Placed":
        """Some of them."""
        return Placed(*(each[which] for each in self))

    @classmethod
    def together(cls, parts: Sequence["Placed"]) -> "Placed":
        """One after another."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class _Known(NamedTuple):
    """A term with its test, and the fit that it is beside."""

    fit: Linear
    term: Term
    scored: Scored


Elsewhere = tuple[np.ndarray, np.ndarray, float]


def _known(terms: Near, first: Near) -> list[_Known]:
    """The terms, at the first node."""
    found = []
    for x, term in zip(terms.tried, matched(terms, first), strict=True):
        scored = first.fit.scored([term])[0] if term else None
        if term and scored and scored.values.shape == x.scored.values.shape:
            found.append(_Known(first.fit, term, scored))
        else:
            found.append(_Known(terms.fit, x.term, x.scored))
    return found


def _elsewhere(
    terms: Near, known: Sequence[_Known], other: Near, own: Sequence[Elsewhere]
) -> list[Elsewhere]:
    """Of each term rows, moves and how much larger what is usual is, `own` at the first node."""
    found = []
    for k, term, here in zip(known, matched(terms, other), own, strict=True):
        if term is None:
            found.append(here)
            continue
        rows, moves = other.fit.rows(term, k.scored)
        (scored,) = other.fit.scored([term])
        # in numbers of the first's test, whatever axes either has: the trace is that of coefficients
        before = np.sum(k.scored.usual * np.sum(rows**2, axis=0))
        found.append((rows, moves, float(np.log(np.sum(scored.usual) / before)) if scored else 0.0))
    return found


def _in_units(term: Term, known: _Known) -> np.ndarray:
    """(m, r) the values of a test in the units of the `term` that is the same elsewhere."""
    ours, theirs = (getattr(t.say, "__self__", None) for t in (term, known.term))
    if not (isinstance(ours, Place) and isinstance(theirs, Place)):
        return known.scored.values
    shown = ours.shown if ours.shown == theirs.shown else []
    return known.scored.values * (theirs.stds / ours.stds)[shown][:, None] if shown else known.scored.values


def _second(near: Near) -> list[list[float]]:
    """(logs, 3) as `Tests.second` has it."""
    shapes = [v.observed((v.course.pole * v.course.rate)[None])[0] for v in near.views]
    return [list(near.fit.moved(i, shape).values()) for i, shape in enumerate(shapes)]


def _compressed(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A basis (R, k) and in terms of it weights (R, N, q), each but for RANK of its size."""
    rows, *others = weights.shape
    flat = weights.reshape(rows, -1)
    flat = (flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)).astype(np.float32)
    basis = np.linalg.eigh(flat @ flat.T)[1][:, ::-1]
    left = 1 - np.cumsum((basis.T @ flat) ** 2, axis=0)  # (R, N q)
    basis = basis[:, : 1 + int(np.count_nonzero(np.max(left, axis=1) > RANK**2))]
    return basis, (basis.T @ weights.reshape(rows, -1)).reshape(-1, *others)
