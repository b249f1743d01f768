"""What the logs say about a plant: whitened residuals and the log density, with every nuisance of the bench eliminated.

For given (G, tau, f0, k_T) a d/q log is linear in all that the bench adds to it,

    y = G e^{j phi} h + sum_c nu_c column_c + noise,     columns: free decay from the unknown start, offset, feedthrough, slope

with h the plant's response per unit G. The nu_c are projected out by an orthogonal basis of the whitened columns (variable
projection; Golub & Pereyra, SIAM J. Numer. Anal. 10, 413, 1973), phi by its closed-form optimum, so that a fit and a posterior
over any number of logs have four parameters. Each nu_c has a zero-mean normal prior ten times as wide as the log's
response, which enters as one more row; it keeps columns apart that a log cannot separate. An amplitude log,
w = sqrt(|G h + nu_1 e|^2 + nu_2), is linear in its nuisances only about their current values, which the fit updates.

The noise level of each log has the scale-free prior 1/sigma and is integrated out: a Student-t form in the residual sum S,
log p = -sum_logs (degrees of freedom / 2) log S.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.export
import jax.numpy as jnp
from jax import Array

from sysid.plant import Hold, Leaf, respond


class Layout(NamedTuple):
    """What decides which program evaluates an experiment; experiments of one layout are stacked and share one."""

    amplitude: bool  # amplitude only: |W|
    own_gain: bool  # no drive recorded: a gain of its own
    both_modes: bool  # low Q
    rows: int


class Experiment(NamedTuple):
    """One log as arrays, padded to its layout; in a group each has a leading axis of logs.

    `hold`: inputs, with room for an interval per row. `response` (N,) complex d/q or real amplitude;
    `weight` (N,) of a row's noise, 0 for padding; `columns` (K, N), largest magnitude 1; `memory` (N,) correlation of the
    noise with the row before; `sigma` its standard deviation per channel; `looseness` standard deviation of the nuisances' prior;
    `freedom` degrees of freedom of the residual; `rotated` 1 when the demodulator's phase is unknown; `start` and `floor` the
    amplitude log's nu_1 (complex) and nu_2, `start_free` and `floor_free` 1 when they are to be found.
    """

    hold: Hold
    response: Leaf
    weight: Leaf
    columns: Leaf
    memory: Leaf
    sigma: Leaf
    looseness: Leaf
    freedom: Leaf
    rotated: Leaf
    start: Leaf
    floor: Leaf
    start_free: Leaf
    floor_free: Leaf


class Residual(NamedTuple):
    """Whitened residual rows (the prior's rows last), the modelled rows (N,), and the nuisances' values."""

    rows: Array
    model: Array
    start: Array
    floor: Array
    gain: Array


for _type in (Hold, Experiment, Residual):  # so that a traced program can be kept
    jax.export.register_namedtuple_serialization(_type, serialized_name=f"sysid.{_type.__name__}")


def parameters(theta: Array) -> tuple[Array, Array, Array, Array]:
    """(G, tau, f0 - reference in rad/s, k_T in rad/s/degC) of theta = (log G, log tau, f0 - reference in Hz,
    k_T in Hz/degC)."""
    return jnp.exp(theta[0]), jnp.exp(theta[1]), 2 * jnp.pi * theta[2], 2 * jnp.pi * theta[3]


def basis(theta: Array, hold: Hold, layout: Layout) -> tuple[Array, Array]:
    """The plant's response per unit G, and its free decay from a unit start: two (N,) complex arrays."""
    _, tau, shift, drift = parameters(theta)
    return respond(tau, hold.offset + shift + drift * hold.warming, hold, layout.both_modes)


@partial(jax.jit, static_argnames="layout")  # traced once, however many programs call it
def residual(theta: Array, x: Experiment, layout: Layout) -> Residual:
    """Whitened residual of one experiment in units of its noise, all nuisances at their optimum."""
    forced, free = basis(theta, x.hold, layout)
    gain = jnp.exp(theta[0])
    if layout.amplitude and not layout.own_gain:
        return _amplitude(gain, forced, free, x)
    return _complex(gain, forced, free, x, layout)


def _complex(gain: Array, forced: Array, free: Array, x: Experiment, layout: Layout) -> Residual:
    if layout.amplitude:  # a gain of its own: the shape |h| is all there is
        forced, free = jnp.abs(forced), jnp.abs(free)
    first = [x.start_free * free]
    if layout.own_gain:
        first, forced = [*first, forced], jnp.zeros_like(forced)
    columns = jnp.concatenate([jnp.stack(first), x.columns])
    project = _Projection(_whiten(columns, x), x)
    y, h = _whiten(x.response, x), _whiten(forced, x)
    left, shape = project(y), project(h)
    overlap = jnp.vdot(shape, left)
    safe = jnp.where(overlap == 0, 1.0, overlap)
    turn = jnp.where((x.rotated > 0) & (overlap != 0), safe / jnp.abs(safe), 1.0)
    coefficients = project.coefficients(y - gain * turn * h)
    model = gain * turn * forced + coefficients @ columns
    own = jnp.abs(coefficients[1]) if layout.own_gain else gain
    return Residual((left - gain * turn * shape) / x.sigma, model, x.start, x.floor, own)


def _amplitude(gain: Array, forced: Array, free: Array, x: Experiment) -> Residual:
    w = gain * forced + x.start * free
    size = jnp.sqrt(w.real**2 + w.imag**2 + x.floor)
    along = jnp.conj(w) * free / size * x.start_free
    columns = jnp.stack([along.real, -along.imag, 0.5 / size * x.floor_free * x.looseness])
    now = jnp.stack([x.start.real, x.start.imag, x.floor / x.looseness])
    project = _Projection(_whiten(columns, x), x)
    target = _whiten(x.response - size + now @ columns, x)
    free_ones = jnp.stack([x.start_free, x.start_free, x.floor_free]) > 0
    found = jnp.where(free_ones, project.coefficients(target), now)
    return Residual(project(target) / x.sigma, size, found[0] + 1j * found[1], found[2] * x.looseness, gain)


def _whiten(v: Array, x: Experiment) -> Array:
    """Remove what the noise of each row shares with the row before (Ornstein-Uhlenbeck, any time grid)."""
    v = v * x.weight
    before = jnp.concatenate([jnp.zeros_like(v[..., :1]), v[..., :-1]], axis=-1)
    return (v - x.memory * before) / jnp.sqrt(1 - x.memory**2)


class _Projection:
    """Projection off the span of `columns` (K, N), each held by its prior's row; an orthonormal basis by Cholesky QR, twice."""

    def __init__(self, columns: Array, x: Experiment):
        self.size = len(columns)
        held = jnp.concatenate([columns, x.sigma / x.looseness * jnp.eye(self.size)], axis=1)
        length = jnp.sqrt(jnp.sum(jnp.abs(held) ** 2, axis=1))
        self.basis, self.back = held / length[:, None], jnp.diag(1 / length).astype(held.dtype)
        for _ in range(2):
            gram = self.basis.conj() @ self.basis.T
            lower = jnp.linalg.cholesky(gram + 4e-16 * self.size * jnp.eye(self.size))
            inverse = jax.scipy.linalg.solve_triangular(lower, jnp.eye(self.size, dtype=lower.dtype), lower=True)
            # a sum, not a matrix product: several times faster for a handful of columns
            self.basis = jnp.sum(inverse.conj()[:, :, None] * self.basis, axis=1)
            self.back = inverse.conj() @ self.back

    def _components(self, v: Array) -> tuple[Array, Array]:
        v = jnp.concatenate([v, jnp.zeros(self.size, v.dtype)])
        return v, self.basis.conj() @ v

    def __call__(self, v: Array) -> Array:
        v, along = self._components(v)
        return v - along @ self.basis

    def coefficients(self, v: Array) -> Array:
        """Least-squares weights of the columns in `v`."""
        return self._components(v)[1] @ self.back


Groups = tuple[tuple[Layout, Experiment], ...]


def details(theta: Array, layouts: tuple[Layout, ...], groups: tuple[Experiment, ...]) -> tuple[Residual, ...]:
    """Residual of each log, group by group."""
    return tuple(
        jax.vmap(lambda e, layout=layout: residual(theta, e, layout))(x) for layout, x in zip(layouts, groups, strict=True)
    )


def stacked_rows(theta: Array, layouts: tuple[Layout, ...], groups: tuple[Experiment, ...]) -> Array:
    """All residual rows of all logs as one real vector: what Levenberg-Marquardt makes small."""
    parts = []
    for found in details(theta, layouts, groups):
        rows = found.rows.ravel()
        parts += [rows.real, rows.imag] if jnp.iscomplexobj(rows) else [rows]
    return jnp.concatenate(parts)


def sums(theta: Array, layouts: tuple[Layout, ...], groups: tuple[Experiment, ...]) -> tuple[Array, ...]:
    """Residual sum of squares of each log, group by group, in units of its noise."""

    return tuple(jnp.sum(jnp.abs(found.rows) ** 2, axis=-1) for found in details(theta, layouts, groups))


def log_density(theta: Array, layouts: tuple[Layout, ...], groups: tuple[Experiment, ...]) -> Array:
    """Log posterior density of theta up to a constant: flat in log G, log tau, f0 and k_T, noise levels integrated out."""
    total = jnp.zeros(())
    for s, x in zip(sums(theta, layouts, groups), groups, strict=True):
        # Below its expectation S counts as with a known noise: noise-free logs have a level, that of rounding. A log without
        # degrees of freedom is padding of its group.
        f = jnp.maximum(x.freedom, 1e-300)
        shape = jnp.where(s > f, f * jnp.log(jnp.maximum(s, f) / f), s - f)
        total = total - 0.5 * jnp.sum(jnp.where(x.freedom > 0, shape, 0.0))
    return total
