"""The way down to a minimum: Levenberg-Marquardt, then single Gauss-Newton steps between noise estimates."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.linalg import lapack

from sysid.model.experiment import Groups, Residual
from sysid.model.likelihood import linearised
from sysid.model.prior import Prior
from sysid.precision import seldom
from sysid.trials.experiment import stacks

SHORTEST = 1e-8  # a step that is not shortened any further
# of what a step is foreseen to gain: a step that gains less is not taken, one that gains more lets the next
# go farther; by which factors it may
LITTLE, MUCH, NARROWER, WIDER = 0.01, 0.99, 0.25, 3.5
# of a sum of squares, which one more step would gain, at which a search ends: the errors of what is found are
# its root, in standard deviations, and the rounds' Gauss-Newton steps add the last digits
CLOSE = 1e-5
NONE = 1e-10  # of a sum of squares, below which a step changes nothing
DONE = 1e-7  # of a sum of squares, below which nothing is left to gain
LEAST_DAMPING = 0.01  # the least factor on a step, which is then taken in any case
STILL = 1e-3  # relative move of the noise, above which gains before and after a step do not compare


class Sums(NamedTuple):
    """Half the sum of squares of all logs and of the prior, its gradient and J^T J along the directions."""

    cost: Any
    gradient: Any
    gram: Any


class Seen(NamedTuple):
    """The problem at theta: its sums; of each group J^T J of each log (logs, d, d), and the residuals."""

    theta: np.ndarray
    sums: Sums
    grams: list[np.ndarray]
    found: list[Residual]


@seldom
def _looked(theta, directions, layout, x):
    """J^T J and the gradient along the directions, and the residual, of each log of a stack of one layout. A
    program for each layout is smaller than one for each set of layouts, and there are fewer of them."""

    def one(x):
        found, change = linearised(theta, x, layout)
        jacobian = jax.vmap(change, in_axes=1)(directions)
        return (jacobian @ jacobian.conj().T).real, (jacobian.conj() @ found.rows).real, found

    return jax.vmap(one)(x)


def prepare(groups: Groups, theta: np.ndarray, directions: np.ndarray) -> None:
    """Begin to make the programs of a descent, where that goes on beside."""
    for layout, x in groups:
        for stack in stacks(x):
            _looked.prepare(theta, directions, layout, stack)


def levenberg_marquardt(
    groups: Groups, theta: np.ndarray, directions: np.ndarray, most: int, prior: Prior
) -> Seen:
    """The point theta + directions @ x of the least sum of squares, reached in at most `most` steps, and what
    is seen there.

    A step is -(J^T J + 1/radius)^-1 g, of which the sum of squares tells whether it is taken and how far the
    next one may go (Gould, Orban, Sartenaer & Toint, 4OR 3, 227, 2005).
    """
    best, radius, taken = _seen(groups, theta, directions, prior), 1.0, True
    for _ in range(most):
        _, gradient, gram = best.sums
        step = _damped(gram, 1 / radius, gradient)
        if not np.max(np.abs(step)) >= SHORTEST or (taken and -gradient @ step < CLOSE):
            break
        there = _seen(groups, best.theta + directions @ step, directions, prior)
        gained, foreseen = there.sums.cost - best.sums.cost, gradient @ step + 0.5 * step @ gram @ step
        taken = bool(gained <= LITTLE * foreseen < 0)
        radius *= (WIDER if gained < MUCH * foreseen else 1.0) if taken else NARROWER
        best = there if taken else best
    return best


def _damped(gram: np.ndarray, damping: float, gradient: np.ndarray) -> np.ndarray:
    """-(gram + damping)^-1 gradient; no step where that is not known."""
    factor, failed = lapack.dpotrf(gram + damping * np.eye(len(gram)))
    return 0.0 * gradient if failed else -lapack.dpotrs(factor, gradient)[0]


@np.errstate(over="ignore", invalid="ignore")  # a step that leads there is not taken
def _seen(groups: Groups, theta: np.ndarray, directions: np.ndarray, prior: Prior) -> Seen:
    """What is seen at theta."""
    grams, gradients, found = [], [], []
    for layout, x in groups:
        parts = [_looked(theta, directions, layout, stack) for stack in stacks(x)]
        gram, gradient, residual = jax.tree.map(lambda *each: np.concatenate(each), *parts)
        grams.append(gram)
        gradients.append(gradient)
        found.append(residual)
    squares = sum(float(np.sum(np.abs(f.rows) ** 2)) for f in found)
    sums = Sums(
        np.asarray(0.5 * squares + prior.cost(theta)),
        np.concatenate(gradients).sum(axis=0) + directions.T @ prior.slope(theta),
        np.concatenate(grams).sum(axis=0) + directions.T @ prior.precision @ directions,
    )
    return Seen(theta, sums, grams, found)


@dataclass
class GaussNewton:
    """Single Gauss-Newton steps, one in each round of noise estimates; `next` is the step to take, None where
    a search is needed.

    Where a derivative vanishes on resonance a whole step leads away from the minimum. `left` = g^T (J^T J)^-1
    g, what the step would gain, shows it: it should fall on the way to the minimum, and where it rises the
    step is shortened.
    """

    next: np.ndarray | None = None
    left: float = np.inf  # where the next step begins
    damping: float = 1.0
    still: bool = False  # the noise hardly changed before it
    measured: bool = False  # `left` is that of the noise with which the next one will be judged

    def taken_back(self, left: float, newton: np.ndarray | None) -> bool:
        """Whether to go back to where the last step began: it was too long; or the noise had changed before
        it, so that `left` is first measured anew, by a step of no length."""
        if self.next is None:
            return False
        if not (np.any(self.next) or self.measured):
            self._begin(left, newton, measured=True)
            return True
        if not self.still or left <= max(self.left, DONE) or self.damping <= LEAST_DAMPING:
            return False
        if (
            self.left < NONE and not self.measured
        ):  # the step was nothing: what is left now comes from the new noise alone
            self._begin(left, newton, measured=True)
            return True
        shrink = 0.25 if self.measured else 0.0
        self.next, self.damping = shrink * self.next, self.damping * (shrink or 1.0)
        return True

    def kept(self, left: float, newton: np.ndarray | None, moved: float) -> None:
        """Go on from here, after the noise `moved` by so much; `newton` is the whole step, None where it is
        too long to trust."""
        self.still = moved < STILL
        self._begin(left, newton, measured=False)

    def _begin(self, left: float, newton: np.ndarray | None, measured: bool) -> None:
        self.next, self.left, self.measured = (
            None if newton is None else self.damping * newton,
            left,
            measured,
        )
