"""The program that a scene compiles to, as names of equations."""

import jax
import jax.numpy as jnp

from sysid.scene import engine, timeline

WRAPPERS = ("pjit", "jit", "closed_call", "custom_jvp_call")


def equations(jaxpr):
    """Names of a program's equations in order, those of inner programs in their place."""
    names = []
    for equation in jaxpr.eqns:
        names += [] if equation.primitive.name in WRAPPERS else [equation.primitive.name]
        for value in equation.params.values():
            if hasattr(value, "eqns") or hasattr(value, "jaxpr"):
                names += equations(getattr(value, "jaxpr", value))
    return names


def program(scene):
    """(equations, number of leaves that go in) of the program that advances a scene."""
    rung = scene.fidelity

    def advance(*args):  # a function of its own: what JAX keeps of an earlier one is not looked at
        return engine.advance.function(*args, rung, scene.plant.f0)

    with jax.enable_x64(True):
        key, plant = jax.random.key(0), jax.tree.map(float, scene.plant)
        state, (chunk, _) = engine.start(plant, scene.effects, key), timeline.chunk(scene, 0, scene.rows)
        traced = jax.make_jaxpr(advance)(
            plant, scene.effects, state, chunk, key, jnp.asarray(0), 1 / scene.rate
        )
    return equations(traced.jaxpr), len(traced.jaxpr.invars)
