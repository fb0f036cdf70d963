"""`sj.sweep`: many runs of one scene builder, over all cores or machines, stored as they come."""

import os
from collections.abc import Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import diffrax
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import whole_number
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.lanes import Block
from spherejax.motion.integration.widths import block_for
from spherejax.motion.results.dataset import NOT_UNIQUE
from spherejax.motion.runs.many import batch_settings, check_parameters, check_sensitivities, warn_of_starts
from spherejax.motion.runs.simulate import checked_times
from spherejax.motion.runs.traced_functions import Build, known_build
from spherejax.motion.settings import DEFAULT_MAX_STEPS, RunSettings
from spherejax.motion.start.redundancy import undetermined_reactions_of
from spherejax.runtime import require_float64
from spherejax.studies.sweep.chunks import ChunkWork
from spherejax.studies.sweep.grids import Grid, as_grid
from spherejax.studies.sweep.identity import identity_of, with_known_functions
from spherejax.studies.sweep.lock import held
from spherejax.studies.sweep.progress import Report, reporting
from spherejax.studies.sweep.provenance import example_of, provenance
from spherejax.studies.sweep.records import TAKEN, Record, Wanted, record_of
from spherejax.studies.sweep.results import Results
from spherejax.studies.sweep.store import check_path, stored_chunk_size
from spherejax.studies.sweep.worker_pool import default_workers, paced, run_chunks, worker_pool_for

if TYPE_CHECKING:
    import xarray

LARGEST_CHUNK = 2048
"""Runs in a chunk, at most: what is lost when a sweep is stopped, and what is in memory at a time. Where they take long
there are fewer; see `studies.sweep.worker_pool.paced`."""

LARGEST_FOR_EACH_LANE = 4
"""Runs in a chunk for each lane that there may be even so: the blocks of an accelerator are wide."""

LARGEST_SAMPLES = 2**28
"""Bytes that the samples of a chunk's states may take."""


def sweep(
    build: Build,
    grid: Grid | Mapping[str, Any],
    ts: Float[Array, " n"],
    *,
    record: Wanted,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    derivative_rtol: float | None = None,
    max_steps: int = DEFAULT_MAX_STEPS,
    block: Block | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    store: str | os.PathLike | None = None,
    progress: bool | Report = True,
) -> "xarray.Dataset":
    """Simulate a scene for many parameters.

    Args:
        build: makes a `Scene` from the parameters, given by keyword. It is traced: all scenes share one structure.
        grid: lists of values by name, whose product is swept; or a grid of `sj.studies.zipped`,
            `sj.studies.random_samples`, `sj.studies.sobol_samples`.
        ts: sample times [s], increasing; every run goes from the first to the last.
        record: what is kept of each run: names such as `"final position.rocker"`, `"peak acceleration.rocker"`,
            `"onsets.coupler_rocker"`, or functions from a `Trajectory` to an array; see `studies.sweep.records`.
            Derivatives by the parameters: `"sensitivity final position.rocker"`, or `sj.studies.Sensitivity`.

    Other args:
        rtol, atol, solver, derivative_rtol, max_steps: as in `simulate`.
        block: lanes that run side by side on a core or an accelerator; by default by its kind (`motion.widths`).
        chunk: runs that are handed out at a time, to a core or an accelerator; what is lost when a sweep is stopped. By
            default as many as memory and workers call for; in a long sweep on processors, as many as take two seconds.
        workers: chunks that are computed at the same time in this process: all cores, or one for each device where
            there are several or they are no CPUs. Several devices share one program, sharded by `jax.shard_map`.
        executor: anything with the interface of `concurrent.futures.Executor` (a process pool; a Dask client's
            `get_executor()`), which gets the chunks instead. A chunk whose worker dies runs again.
        store: folder of a Zarr store that takes the chunks as they come. A sweep that was stopped goes on from there,
            with the same results as if it had not been. The store of another sweep is refused. The result is then read
            from the store where it is looked at (`sj.open_sweep` does so later), and memory is bounded by a chunk.
        progress: a bar in terminals and notebooks and nothing in logs (True), nothing (False), or a function that is
            given what `studies.sweep.progress.SweepProgress` holds.

    Returns:
        A data set with the parameters as coordinates, what was asked for, and each run's `status`, `t_reached`,
        `n_steps` and `n_rejected`; the attributes tell lane efficiency, seconds, failures, methods and versions, and in
        `not_unique_for` joints of which a reaction is kept that the motion does not determine.

    Raises:
        SceneError: for a request that cannot be simulated, before anything is computed: among them a store that another
            process is writing, the store of another sweep, and one that is not what was written.
        SweepError: for a disk that is full, workers that die, an executor that stops, memory that does not suffice.
            What a store has got it keeps; the same call goes on from there.
    """
    require_float64()
    grid = as_grid(grid)
    times = np.asarray(checked_times(ts))
    settings = RunSettings(rtol, atol, solver, derivative_rtol=derivative_rtol, max_steps=max_steps).checked()
    if chunk is not None:
        chunk = whole_number("chunk", chunk, "Leave it out for a size by memory and workers.")
    if workers is not None:
        workers = whole_number("workers", workers, "Leave it out for all cores.")
    path = None if store is None else Path(store).expanduser()
    if path is not None:
        check_path(path)
    with held(path):
        stored = None if path is None else stored_chunk_size(path)
        example = example_of(build, grid)
        system = compile_scene(example, track_work=True).system
        wanted = record_of(record, system, grid.names)
        _check_names(grid, wanted)
        lanes = block or block_for()
        some = _some_runs(grid)
        warn_of_starts(build, _some_runs(grid, 16), times)
        check_parameters(wanted.by, some, derivative_rtol)
        batch = batch_settings(build, some, settings.replaced(track_work=wanted.needs_work), lanes)
        batch = batch._replace(watch=wanted.watched, by=wanted.by)
        check_sensitivities(build, batch, some)
        build = known_build(build, grid.row(0), wanted.needs_work, batch.by)
        wanted = with_known_functions(wanted, build, batch, grid, times)
        workers = workers or default_workers()
        size = stored or chunk or _chunk_size(grid.n_runs, workers, lanes, len(times) * len(system.bodies))
        work = ChunkWork(build, batch, wanted, tuple(times.tolist()), min(size, grid.n_runs))
        if stored is None and chunk is None and executor is None:
            work = paced(work, some_runs=partial(_some_runs, grid), n_runs=grid.n_runs, workers=workers)
        facts = {**provenance(example, grid, batch, times, wanted), **_marks(example, wanted, float(times[0]))}
        results = Results(grid, work, path, facts, identity_of(build, grid, wanted))
        with reporting(progress, grid.n_runs) as report:
            run_chunks(results, worker_pool_for(results, workers, executor), report)
        return results.dataset()


def _chunk_size(n_runs: int, workers: int, block: Block, n_samples: int) -> int:
    """As many equal chunks as keep all workers busy, of no more runs than memory should hold at a time.

    Args:
        n_runs: of the sweep.
        workers: chunks at the same time.
        block: lanes of each.
        n_samples: samples of bodies in one run, of 13 numbers each.
    """
    largest = max(LARGEST_CHUNK, LARGEST_FOR_EACH_LANE * block.width)
    largest = min(largest, max(LARGEST_SAMPLES // (n_samples * 13 * 8), block.width))
    rounds = -(-n_runs // (workers * largest))
    return -(-n_runs // (workers * rounds))


def _some_runs(grid: Grid, n: int = 4) -> dict[str, Float[np.ndarray, " n"]]:
    """Runs that stand for all: the first, the last, and some in between."""
    rows = [grid.row(run) for run in sorted({(grid.n_runs - 1) * k // (n - 1) for k in range(n)})]
    return {name: np.array([row[name] for row in rows]) for name in grid.names}


def _marks(example: Scene, wanted: Record, t: float) -> dict[str, str]:
    """Which reactions that are kept the motion does not determine, as an attribute of the result; none where all are.

    Of the first run: redundancy belongs to the structure, which all runs share.
    """
    quantities = [kept.quantity for kept in ((one.inner or one) for one in wanted.kept) if kept.quantity is not None]
    parts = {"reaction": "force", "reaction_moment": "moment"}
    asked = [(quantity.owner, parts[quantity.kind]) for quantity in quantities if quantity.kind in parts]
    if not asked:
        return {}
    undetermined = undetermined_reactions_of(example, t)
    names = dict.fromkeys(str(joint) for joint, part in asked if part in undetermined.get(str(joint), ()))
    return {"not_unique_for": ", ".join(names), "comment": NOT_UNIQUE} if names else {}


def _check_names(grid: Grid, wanted: Record) -> None:
    taken = {*TAKEN, "axis", "component", "parameter", "chunk", *(kept.name for kept in wanted.kept)}
    name = next((name for name in grid.names if name in taken), None)
    if name is not None:
        raise SceneError(f"a parameter is called {name!r}, as something in the result is; choose another name")
