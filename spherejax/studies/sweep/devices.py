"""Chunks on several devices: one program, sharded over them by `jax.shard_map`, a chunk for each device.

Each device works off the queue of its own chunk; nothing is exchanged, and results are, bit for bit, those of the same
chunks on one device. The devices wait for each other at the end of a chunk, which costs little, since neighboring
chunks cost alike. A thread for each device would not wait, but XLA compiles its program anew for each device: on four
host devices 105 s of processor time for a dry four-bar, instead of 23, and then it ran as fast.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from spherejax.studies.sweep.chunks import ChunkResult, ChunkWork, Rows, filled, made, n_rows, result_of

AXIS = "runs"


def compiled_for_all(work: ChunkWork, rows: Rows, devices: Sequence[Any]) -> Callable:
    """The program of a chunk on each of several devices, compiled once."""
    mesh = Mesh(np.array(devices), (AXIS,))
    over_runs = PartitionSpec(AXIS)

    def of_shard(rows, is_wanted):
        return made(work, rows, is_wanted)

    # Nothing crosses devices, so there is nothing for the check of what varies over them to find.
    sharded = jax.shard_map(of_shard, mesh=mesh, in_specs=over_runs, out_specs=over_runs, check_vma=False)
    placed = NamedSharding(mesh, over_runs)
    return jax.jit(sharded, in_shardings=placed).lower(*_side_by_side(work, [rows], len(devices))).compile()


def run_side_by_side(work: ChunkWork, several: Sequence[Rows], program: Callable, n_devices: int) -> list[ChunkResult]:
    """Make the runs of as many chunks as there are devices, or fewer."""
    begin = time.perf_counter()
    kept, outcome = jax.block_until_ready(program(*_side_by_side(work, several, n_devices)))
    seconds = time.perf_counter() - begin
    kept = {name: np.asarray(values) for name, values in kept.items()}
    return [result_of(kept, outcome, i, n_rows(rows), work.size, seconds) for i, rows in enumerate(several)]


def _side_by_side(work: ChunkWork, several: Sequence[Rows], n_devices: int) -> tuple[Rows, np.ndarray]:
    """Parameters of all devices' runs, and which are wanted; devices without a chunk get runs that are not made."""
    parts = [filled(work, rows) for rows in several]
    rows, is_wanted = parts[-1]
    parts += [(rows, np.zeros_like(is_wanted))] * (n_devices - len(parts))
    together = {name: np.concatenate([rows[name] for rows, _ in parts]) for name in rows}
    return together, np.concatenate([is_wanted for _, is_wanted in parts])
