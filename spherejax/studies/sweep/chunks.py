"""The work of a sweep in chunks of runs: what one core, or another machine, is given at a time.

A chunk has always the same runs and the same length (the last one is filled up with runs that are not made), so its
results do not depend on who computes it, nor on what was computed before.
"""

import pickle
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.files.fields.code import modules_in, run_again
from spherejax.foundations.errors import SceneError
from spherejax.motion.integration.audit import cautions
from spherejax.motion.integration.status import Status
from spherejax.motion.results.run_flags import flags_of
from spherejax.motion.runs.batch_setup import BatchSettings
from spherejax.motion.runs.many import many
from spherejax.motion.runs.traced_functions import Build
from spherejax.program_cache import cached_jit
from spherejax.studies.sweep.records import Record


@dataclass(frozen=True)
class ChunkWork:
    """What is done with every chunk.

    Attributes:
        build: makes a scene from the parameters.
        settings: how to integrate.
        record: what is kept.
        ts: sample times [s].
        size: runs in a chunk.
    """

    build: Build
    settings: BatchSettings
    record: Record
    ts: tuple[float, ...]
    size: int


class ChunkResult(NamedTuple):
    """The results of one chunk, in NumPy.

    Attributes:
        kept: what is kept, by name, with a leading axis of runs.
        status: integers of `Status`.
        t_reached: [s].
        n_steps: steps of each run, kept or repeated.
        n_rejected: steps repeated.
        n_lane_steps: steps that the lanes made, those of idle ones included.
        seconds: time that it took [s].
        warnings: bits of `motion.results.run_flags`: that a run failed, or left the range of a law.
        cautions: what runs were used for beyond the range of their laws, in words; empty for nothing.
    """

    kept: dict[str, np.ndarray]
    status: np.ndarray
    t_reached: np.ndarray
    n_steps: np.ndarray
    n_rejected: np.ndarray
    n_lane_steps: int
    seconds: float
    warnings: np.ndarray
    cautions: str = ""


Rows = dict[str, Float[np.ndarray, " n"]]
"""Parameters of the runs of a chunk."""


def compiled_for(work: ChunkWork, rows: Rows) -> Callable:
    """The program of a chunk, compiled: threads that share it do not compile it again."""
    return _program.compiled(work, *filled(work, rows))


def shapes_of(work: ChunkWork, rows: Rows) -> dict[str, jax.ShapeDtypeStruct]:
    """Shape and type of what is kept of one run, by name."""
    kept, _ = _program.shapes(work, *filled(work, rows))
    return {name: jax.ShapeDtypeStruct(each.shape[1:], each.dtype) for name, each in kept.items()}


def run_chunk(work: ChunkWork, rows: Rows, program: Callable | None = None) -> ChunkResult:
    """Make the runs of one chunk on the default device."""
    begin = time.perf_counter()
    kept, outcome = jax.block_until_ready((program or _program)(work, *filled(work, rows)))
    seconds = time.perf_counter() - begin
    return result_of(kept, outcome, 0, n_rows(rows), work.size, seconds)


def result_of(kept: Mapping[str, Any], outcome: tuple, chunk: int, n: int, size: int, seconds: float) -> ChunkResult:
    """The first `n` runs of one of several chunks that a program has made one after the other, or side by side."""
    runs = slice(chunk * size, chunk * size + n)
    status, t_reached, n_steps, n_rejected, n_lane_steps, audit = (np.asarray(values) for values in outcome)
    return ChunkResult(
        {name: np.asarray(values)[runs] for name, values in kept.items()},
        status[runs],
        t_reached[runs],
        n_steps[runs],
        n_rejected[runs],
        int(n_lane_steps[chunk]),
        seconds,
        flags_of(status[runs], audit[runs]),
        cautions(audit[runs][status[runs] == Status.SUCCEEDED]),
    )


def n_rows(rows: Rows) -> int:
    """Number of runs."""
    return len(next(iter(rows.values())))


def filled(work: ChunkWork, rows: Rows) -> tuple[Rows, np.ndarray]:
    """The parameters of a whole chunk, and which of its runs are wanted."""
    n = n_rows(rows)
    filled = {name: np.concatenate([values, np.repeat(values[-1:], work.size - n)]) for name, values in rows.items()}
    return filled, np.arange(work.size) < n


def made(work: ChunkWork, rows, is_wanted) -> tuple[dict[str, Any], tuple]:
    """The runs of a chunk: what is kept of them, and status, time, steps, steps of lanes (of each chunk), audit."""
    runs = many(work.build, work.settings, rows, jnp.asarray(work.ts), is_wanted)
    stats = runs.trajectories.stats
    status, t_reached = runs.trajectories.status, runs.trajectories.t_reached
    outcome = (status, t_reached, stats.n_steps, stats.n_rejected, runs.n_lane_steps[None], stats.audit)
    return work.record.of(runs), outcome


_program = cached_jit(made, what="the runs of a sweep")


# In other processes ------------------------------------------------------------------------------------------------


def packed(work: ChunkWork) -> bytes:
    """The work for another process.

    Raises:
        SceneError: when it cannot be pickled.
    """
    for pickler in (pickle, _cloudpickle()):
        if pickler is None:
            continue
        try:
            pickled = pickler.dumps(work)
            # Classes from beside a scene file, which was read with allow_code=True: the worker runs the same files.
            return pickle.dumps((modules_in(pickled), pickled))
        except (pickle.PicklingError, AttributeError, TypeError):
            continue
    raise SceneError(
        "the sweep's build (or a function in record=) cannot be sent to another process: define it at the top level of "
        "a module, or install cloudpickle (it comes with spherejax[distributed])"
    )


def run_packed_chunk(work: bytes, rows: Rows) -> list[ChunkResult]:
    """`run_chunk` in another process; what was compiled for the same work is kept there."""
    return [run_chunk(_unpacked(work), rows)]


@lru_cache(maxsize=8)
def _unpacked(work: bytes) -> ChunkWork:
    files, pickled = pickle.loads(work)
    run_again(files)
    return pickle.loads(pickled)


def _cloudpickle() -> Any:
    try:
        import cloudpickle
    except ImportError:
        return None
    return cloudpickle
