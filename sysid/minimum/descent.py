"""The way down to a minimum: Levenberg-Marquardt, then single Gauss-Newton steps between noise estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sysid.model import course
from sysid.model.course import by_differences, by_program
from sysid.model.experiment import Experiment, Groups, Layout, Residual
from sysid.model.likelihood import linearised
from sysid.model.prior import Prior
from sysid.precision import seldom

SHORTEST = 1e-8  # a step that is not shortened any further
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


def _in_group(
    theta: np.ndarray, directions: np.ndarray, layout: Layout, x: Experiment, plain: bool
) -> tuple[np.ndarray, np.ndarray, Residual]:
    """Of each log of a group J^T J (logs, d, d) and the gradient (logs, d) along the directions (6, d), and
    the residual."""
    now, change = (by_differences if plain else by_program)(theta, directions, x, layout)
    found, jacobian = linearised(now, change, x, layout)
    jacobian, rows = (np.ascontiguousarray(v).view(float) for v in (jacobian, found.rows))
    return jacobian @ np.swapaxes(jacobian, 1, 2), (jacobian @ rows[..., None])[..., 0], found


@seldom
def _stepped(_, given):
    """Whether the last step is taken, the next one, and the radius of trust.

    The damped Newton step and the trust region are those of optimistix, which is imported only where the
    program is made: one that was kept on disk does not need it.
    """
    import lineax
    import optimistix

    def info(sums: Sums) -> Any:
        hessian = lineax.MatrixLinearOperator(sums.gram, lineax.positive_semidefinite_tag)
        return optimistix.FunctionInfo.EvalGradHessian(sums.cost, sums.gradient, hessian)

    before, after, step, radius, first = given
    descent: Any = optimistix.DampedNewtonDescent()
    region: Any = optimistix.ClassicalTrustRegion()
    rest = jnp.zeros_like(step)
    trust = jax.tree.map(lambda _: radius, region.init(rest, info(before)))
    radius, taken, *_ = region.step(first, rest, step, info(before), info(after), trust)
    better = jax.tree.map(lambda a, b: jnp.where(taken, a, b), after, before)
    step, _ = descent.step(radius, descent.query(rest, info(better), None))
    return taken, step, radius


def prepare(groups: Groups, theta: np.ndarray, directions: np.ndarray) -> None:
    """Begin to make the programs of a descent, where that goes on beside."""
    for layout, x in groups:
        course.prepare(theta, directions, x, layout)
    d = directions.shape[1]
    rest, none, nothing = np.zeros(d), np.zeros(()), np.zeros((d, d))
    sums = Sums(none, rest, nothing)
    _stepped.prepare((), (sums, sums, rest, np.ones(()), np.asarray(True)))


def levenberg_marquardt(
    groups: Groups, theta: np.ndarray, directions: np.ndarray, most: int, prior: Prior, plain: bool = False
) -> Seen:
    """The point theta + directions @ x of the least sum of squares, reached in at most `most` steps, and what
    is seen there. `plain`: by differences, with nothing to compile."""
    now = _seen(groups, theta, directions, prior, plain)
    if not most:
        return now
    nothing = Sums(*(np.zeros_like(x) for x in now.sums))
    best, step, radius = now._replace(sums=nothing), np.zeros(directions.shape[1]), np.ones(())
    for looks in range(most + 1):
        first = looks == 0
        given = (best.sums, now.sums, step, radius, np.asarray(first))
        taken, step, radius = (np.asarray(x) for x in _stepped((), given))
        best = now if taken else best
        size, gained = np.max(np.abs(step)), -best.sums.gradient @ step
        if looks == most or not size >= SHORTEST or (taken and gained < CLOSE) or not np.isfinite(size):
            break
        now = _seen(_nearer(groups, best.found), best.theta + directions @ step, directions, prior, plain)
    return best


def _nearer(groups: Groups, found: Sequence[Residual]) -> Groups:
    """The groups with what transients' amplitudes began with, their lateness and offset as they were found:
    these are looked for from where they were."""
    return tuple(
        (layout, x._replace(start=f.start, late=f.late, offset=f.offset))
        if layout.amplitude and not (layout.steady or layout.own_gain)
        else (layout, x)
        for (layout, x), f in zip(groups, found, strict=True)
    )


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a step that leads there is not taken
def _seen(groups: Groups, theta: np.ndarray, directions: np.ndarray, prior: Prior, plain: bool) -> Seen:
    """What is seen at theta."""
    seen = [_in_group(theta, directions, layout, x, plain) for layout, x in groups]
    grams, gradients, found = map(list, zip(*seen, strict=True))
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
