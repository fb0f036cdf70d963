"""Arrays that are sharded over several devices.

A loop over runs, and the machine code that it calls, work on one device. XLA's partitioner does not know that: it would
put collective operations into kernels that cannot hold them (jax 0.10, CPU: "INTERNAL: Failed to materialize symbols",
for `__xla_cpu_runtime_AllGather`). So arguments of compiled functions are gathered, and within programs of a user's
they are replicated: every device makes all runs. `sj.sweep` distributes runs over devices (see
`spherejax.studies.sweep.devices`), and does so by `jax.shard_map`, which leaves nothing to partition.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import jax
import numpy as np
from jax.interpreters import mlir
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec

from spherejax.program_cache import private


@cache
def _has_several_devices() -> bool:
    # Once in a process: JAX starts its backends once, and every call of a compiled function asks.
    return jax.device_count() > 1


def gathered(leaves: Sequence) -> Sequence:
    """The arguments of a compiled function; arrays on several devices as NumPy arrays, which lie on none."""
    if not _has_several_devices():
        return leaves
    return [np.asarray(leaf) if _is_sharded(leaf) else leaf for leaf in leaves]


def _is_sharded(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and len(leaf.sharding.device_set) > 1


def is_partitioned(context: Any) -> bool:
    """Whether the program that is lowered is one that XLA partitions over several devices.

    Under `jax.shard_map` it does not: there each device has a program of its own.
    """
    return private.n_devices(context) > 1


def lowered_replicated(function: Callable) -> Callable:
    """A lowering rule of JAX, by a function of arrays to a sequence of arrays, all replicated over devices."""

    def lowering(context: Any, *values: Any, **parameters: Any) -> Sequence:
        def whole(*arguments: Any) -> Sequence:
            return function(*arguments, **parameters)

        if not is_partitioned(context):
            return mlir.lower_fun(whole, multiple_results=True)(context, *values)
        # JAX does not say which devices, and which they are does not matter to arrays that are on all of them.
        mesh = AbstractMesh((private.n_devices(context),), ("device",))
        everywhere = NamedSharding(mesh, PartitionSpec())

        def replicated(arrays: Sequence) -> list:
            return [jax.lax.with_sharding_constraint(array, everywhere) for array in arrays]

        # Of the results too: the partitioner would carry how they are used back into the loop.
        return mlir.lower_fun(lambda *arguments: replicated(whole(*replicated(arguments))), multiple_results=True)(
            context, *values
        )

    return lowering
