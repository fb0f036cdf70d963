"""What a run's states say: their parts by name, and everything that the equations of motion know at the samples."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from spherejax.foundations.kept.bounded_jit import bounded_jit
from spherejax.foundations.machine import code as machine_code
from spherejax.motion.equations.observables import Observation, looked_up, observe
from spherejax.motion.equations.programs import program_for
from spherejax.physics.state import Layout, State, unpack


# Compiled, though it is little: by themselves a dozen kernels would be kept for each number of samples, 1.5 MB each.
@bounded_jit(what="the state of a run")
def unpacked(layout: Layout, ys) -> State:
    """The states by name, with a leading axis of samples."""
    return unpack(layout, ys)


@bounded_jit(what="the state of a body")
def of_body(quantity, body: int):
    """Of one body, by its number."""
    return quantity[..., body, :]


@bounded_jit(what="what is looked up of a run")
def looked_up_at(structure, theta, ys) -> dict[str, dict[str, Array]]:
    """As array code: what is looked up may search and loop, which scalar programs do not."""
    return jax.vmap(lambda y: looked_up(structure.system(theta), y))(ys)


@bounded_jit(what="the quantities of a run")
def observed(structure, use_scalars: bool | None, theta, ts, ys) -> Observation:
    """Observe all samples in one call of machine code; or else one after the other, in a loop that writes rows."""
    program = program_for(observe, structure, use_scalars)
    if program.scalar is not None and program.scalar.can_be_machine_code:
        with machine_code.wanted():
            ahead = program.ahead(theta)
            return jax.vmap(lambda t, y: program.inside(theta, ahead, t, y))(ts, ys)
    ahead = program.ahead(theta)

    def flat(t, y):
        return ravel_pytree(program.inside(theta, ahead, t, y))[0]

    rows = jax.lax.map(lambda sample: flat(*sample), (ts, ys))
    example = jax.eval_shape(program, theta, ts[0], ys[0])
    leaves, tree = jax.tree.flatten(example)
    sizes = [int(np.prod(leaf.shape)) for leaf in leaves]
    columns = jnp.split(rows, np.cumsum(sizes)[:-1].tolist(), axis=1)
    return jax.tree.unflatten(tree, [c.reshape(-1, *leaf.shape) for c, leaf in zip(columns, leaves, strict=True)])
