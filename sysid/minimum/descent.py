"""The way down to a minimum: Levenberg-Marquardt as one compiled program, then single Gauss-Newton steps
between noise estimates."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sysid.model.experiment import Residual
from sysid.model.likelihood import linearised
from sysid.precision import seldom

SHORTEST = 1e-8  # a step that is not shortened any further
# step and relative fall at which a search ends; the rounds' Gauss-Newton steps add the last digits
ROUGH = 1e-5
NONE = 1e-10  # of a sum of squares, below which a step changes nothing
DONE = 1e-7  # of a sum of squares, below which nothing is left to gain
LEAST_DAMPING = 0.01  # the least factor on a step, which is then taken in any case
STILL = 1e-3  # relative move of the noise, above which gains before and after a step do not compare


class _Look(NamedTuple):
    """The problem at one theta: half the sum of squares; for each log, group by group, J^T J and the gradient
    along the directions, and the residual. The prior comes last, as a group of its own without a residual."""

    cost: Array
    grams: tuple[Array, ...]
    gradients: tuple[Array, ...]
    found: tuple[Residual, ...]


class _Progress(NamedTuple):
    """A search under way: the best point so far and what it looks like there, the point to look at next, the
    step to it."""

    theta: Array
    look: _Look
    next: Array
    step: Array
    trust: Any  # of the trust region: its radius, one over the damping
    looks: Array
    done: Array


@partial(jax.jit, static_argnames="layouts")  # traced once: for its shapes, and in the loop
def _looked(theta, directions, mean, precision, layouts, groups) -> _Look:
    def one(x, layout):
        found, change = linearised(theta, x, layout)
        jacobian = jax.vmap(change, in_axes=1)(directions)
        return (jacobian @ jacobian.conj().T).real, (jacobian.conj() @ found.rows).real, found

    parts = [
        jax.vmap(lambda x, layout=layout: one(x, layout))(x)
        for layout, x in zip(layouts, groups, strict=True)
    ]
    grams, gradients, found = zip(*parts, strict=True)
    slope = precision @ (theta - mean)
    cost = 0.5 * (jnp.stack([jnp.sum(jnp.abs(f.rows) ** 2) for f in found]).sum() + (theta - mean) @ slope)
    held, pull = directions.T @ precision @ directions, directions.T @ slope
    return _Look(cost, (*grams, held[None]), (*gradients, pull[None]), found)


def _summed(look: _Look) -> Any:
    """Cost, gradient and J^T J of all logs, as optimistix takes them."""
    import lineax
    import optimistix

    gram, gradient = (jnp.concatenate(parts).sum(axis=0) for parts in (look.grams, look.gradients))
    hessian = lineax.MatrixLinearOperator(gram, lineax.positive_semidefinite_tag)
    return optimistix.FunctionInfo.EvalGradHessian(look.cost, gradient, hessian)


@seldom
def levenberg_marquardt(theta, directions, most, mean, precision, layouts, groups):
    """The point theta + directions @ x of the least sum of squares, reached in at most `most` steps; J^T J,
    gradients and residuals there.

    The damped Newton step and the trust region are those of optimistix. Its loop is not used: it evaluates
    the plant in several places, and a program takes longer to compile and to load the more equations it has.
    optimistix is imported only where a program is made: one that was kept on disk does not need it.
    """
    import optimistix

    descent: Any = optimistix.DampedNewtonDescent()
    region: Any = optimistix.ClassicalTrustRegion()

    def body(s: _Progress) -> _Progress:
        new = _looked(s.next, directions, mean, precision, layouts, groups)
        fall, first = s.look.cost - new.cost, s.looks == 0
        radius, taken, _, trust = region.step(first, rest, s.step, _summed(s.look), _summed(new), s.trust)
        theta, look = jax.tree.map(lambda a, b: jnp.where(taken, a, b), (s.next, new), (s.theta, s.look))
        step, _ = descent.step(radius, descent.query(rest, _summed(look), None))
        size = jnp.max(jnp.abs(s.step))
        still = taken & (size < ROUGH) & (fall < ROUGH * (1 + s.look.cost))
        done = (~first & (still | (size < SHORTEST))) | ~jnp.all(jnp.isfinite(step))
        return _Progress(theta, look, theta + directions @ step, step, trust, s.looks + 1, done)

    shapes = jax.eval_shape(lambda: _looked(theta, directions, mean, precision, layouts, groups))
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    rest = jnp.zeros(directions.shape[1])
    trust = region.init(rest, _summed(blank))
    begin = _Progress(theta, blank, theta, rest, trust, jnp.zeros((), int), jnp.zeros((), bool))
    end = jax.lax.while_loop(lambda s: (s.looks <= most) & ~s.done, body, begin)
    return end.theta, end.look.grams, end.look.gradients, end.look.found


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
