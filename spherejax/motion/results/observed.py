"""What a run's states say: their parts by name, and everything that the equations of motion know at the samples."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.numerics import safe_norm
from spherejax.motion.derivatives.known_jacobians import columns_of
from spherejax.motion.equations.observables import Observation, looked_up, observe
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.row_blocks import as_numbers, in_blocks
from spherejax.physics.state import Layout, State, unpack
from spherejax.program_cache import cached_jit

BLOCK = 1024
"""Samples that are evaluated in one call: one program for any number of them. One of a four-bar takes 0.4 us."""


def state_of(layout: Layout, ys) -> State:
    """The states by name, with a leading axis of samples."""
    return _taken(lambda ys: unpack(layout, ys), ys) if is_concrete(ys) else _unpacked(layout, ys)


# Each a function of its own within a trace: under `jax.grad`, outside of `jax.jit`, each of its ten operations would
# take 0.3 ms, a third of the time of a gradient by one number.
_unpacked = partial(jax.jit, static_argnums=0)(unpack)


def motion_of_body(layout: Layout, ys, name: str, body: int):
    """Position, quaternion, velocity or angular velocity of one body, by its number, of all states."""
    first, last = layout.columns(name, body)
    if is_concrete(ys):
        return _taken(lambda ys: ys[..., first:last], ys)
    columns = columns_of(ys, first, last)
    return _columns(ys, first, last) if columns is None else columns


@partial(jax.jit, static_argnums=(1, 2))
def _columns(ys, first: int, last: int):
    return ys[..., first:last]


def body_of(quantity, body: int):
    """Of one body, by its number."""
    return _taken(lambda quantity: quantity[..., body, :], quantity) if is_concrete(quantity) else _row(quantity, body)


@partial(jax.jit, static_argnums=1)
def _row(quantity, body: int):
    return quantity[..., body, :]


def lengths_of(vectors):
    """|v| of each row."""
    return (
        _taken(lambda v: np.sqrt(np.sum(v * v, axis=-1)), vectors)
        if is_concrete(vectors)
        else jax.vmap(safe_norm)(vectors)
    )


def _taken(take: Callable, array: Any) -> Any:
    """What is taken from an array; from numbers without a program, which would be another for each number of rows."""
    if not is_concrete(array):
        return take(array)
    with as_numbers():
        return jax.tree.map(jnp.asarray, take(np.asarray(array)))


def observation_of(structure, use_scalars: bool | None, theta, ts, ys) -> Observation:
    """All observables at all samples; of numbers block after block."""
    if not _is_one_run((structure, theta, ts, ys), ys):
        return observed(structure, use_scalars, theta, ts, ys)
    return in_blocks(observed, (structure, use_scalars, theta), BLOCK, ts, ys)


def looked_up_of(structure, theta, ys) -> dict[str, dict[str, Array]]:
    """What is looked up at all samples; of numbers block after block."""
    if not _is_one_run((structure, theta, ys), ys):
        return looked_up_at(structure, theta, ys)
    return in_blocks(looked_up_at, (structure, theta), BLOCK, ys)


def _is_one_run(given: Any, ys) -> bool:
    """Whether all that is given are numbers, of states with a row for each sample."""
    return all(map(is_concrete, jax.tree.leaves(given))) and ys.ndim == 2 and ys.shape[0] > 0


@cached_jit(what="what is looked up of a run")
def looked_up_at(structure, theta, ys) -> dict[str, dict[str, Array]]:
    """As array code: what is looked up may search and loop, which scalar programs do not."""
    return jax.vmap(lambda y: looked_up(structure.system(theta), y))(ys)


@cached_jit(what="the quantities of a run")
def observed(structure, use_scalars: bool | None, theta, ts, ys) -> Observation:
    """Observe all samples in one call of machine code; or else one after the other, in a loop that writes rows."""
    program = program_for(observe, structure, use_scalars)
    if program.scalar is not None and program.scalar.can_be_machine_code:
        with program.native_code():
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
