"""`sj.sweep`: many runs of one scene builder, over all cores or machines, stored as they come."""

import os
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED as FIRST
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import jax
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import SceneError
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.lanes import Block
from spherejax.motion.many import Build, Method, built, method_for
from spherejax.motion.simulate import check_tolerances, checked_times
from spherejax.runtime import require_float64
from spherejax.studies.sweep.chunks import (
    ChunkResult,
    Rows,
    Work,
    compiled_for,
    packed,
    run_chunk,
    run_packed_chunk,
    shapes_of,
)
from spherejax.studies.sweep.dataset import dataset_of
from spherejax.studies.sweep.grids import Grid, as_grid
from spherejax.studies.sweep.progress import Report, Seen, reporting
from spherejax.studies.sweep.records import Wanted, record_of
from spherejax.studies.sweep.store import Store, open_store, stored_chunk_size

if TYPE_CHECKING:
    import xarray

LARGEST_CHUNK = 4096
"""Runs in a chunk, at most: what is lost when a sweep is stopped, and what is in memory at a time."""

ATTEMPTS = 3
"""How often a chunk is sent out when the worker that has it dies."""


def sweep(
    build: Build,
    grid: Grid | Mapping[str, Any],
    ts: Float[Array, " n"],
    *,
    record: Wanted,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
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
        grid: lists of values by name, whose product is swept; or a grid of `sj.zipped`, `sj.random_samples`,
            `sj.sobol_samples`.
        ts: sample times [s], increasing; every run goes from the first to the last.
        record: what is kept of each run: names such as `"final position.rocker"`, `"peak acceleration.rocker"`,
            `"onsets.coupler_rocker"`, or functions from a `Trajectory` to an array; see `studies.sweep.records`.

    Other args:
        rtol, atol, solver, max_steps: as in `simulate`.
        block: lanes that run side by side on a core.
        chunk: runs that are handed out at a time.
        workers: chunks that are computed at the same time in this process: all cores, or one for each accelerator.
        executor: anything with the interface of `concurrent.futures.Executor` (a process pool; a Dask client's
            `get_executor()`), which gets the chunks instead. A chunk whose worker dies runs again.
        store: folder of a Zarr store that takes the chunks as they come. A sweep that was stopped goes on from there,
            with the same results as if it had not been. The store of another sweep is refused.
        progress: a bar in terminals and notebooks and nothing in logs (True), nothing (False), or a function that is
            given what `studies.sweep.progress.Seen` holds.

    Returns:
        A data set with the parameters as coordinates, what was asked for, and each run's `status`, `t_reached`,
        `n_steps` and `n_rejected`; the attributes tell lane efficiency, seconds, failures, methods and versions.

    Raises:
        SceneError: for a request that cannot be simulated, before anything is computed.
    """
    require_float64()
    grid = as_grid(grid)
    times = np.asarray(checked_times(ts))
    check_tolerances(rtol, atol)
    example = _example(build, grid)
    wanted = record_of(record, compile_scene(example, track_work=True).system)
    method = method_for(build, dict(grid.values), rtol, atol, solver, max_steps, wanted.needs_work, block or Block())
    method = method._replace(watch=wanted.watched)
    workers = workers or _default_workers()
    path = None if store is None else Path(store).expanduser()
    size = (path and stored_chunk_size(path)) or chunk or _chunk_size(grid.n_runs, workers)
    work = Work(build, method, wanted, tuple(times.tolist()), min(size, grid.n_runs))
    facts = _provenance(example, grid, method, times, wanted)
    results = _Results(grid, work, path, facts)
    with reporting(progress, grid.n_runs) as report:
        _run_all(results, _submitting(work, results, workers, executor), report)
    values = results.values()
    return dataset_of(grid, wanted, times, values, {**facts, **results.account(values)})


class _Results:
    """The chunks that are there: in memory, or in a store."""

    def __init__(self, grid: Grid, work: Work, path: Path | None, facts: dict):
        self.grid, self.work = grid, work
        self.n_chunks = -(-grid.n_runs // work.size)
        self.chunks: dict[int, ChunkResult] = {}
        self.store: Store | None = None
        if path is not None:
            # Where the user's folder stands does not make it another sweep.
            identity = {"grid": grid.fingerprint, "chunk_size": work.size, **facts}
            del identity["commit"]
            shapes = shapes_of(work, self.rows(0))
            self.store = open_store(path, identity, shapes, grid.n_runs, work.size)

    def rows(self, chunk: int) -> Rows:
        """Parameters of a chunk's runs."""
        return self.grid.rows(chunk * self.work.size, min((chunk + 1) * self.work.size, self.grid.n_runs))

    def missing(self) -> list[int]:
        """Chunks still to be computed."""
        return list(range(self.n_chunks)) if self.store is None else self.store.missing()

    def put(self, chunk: int, result: ChunkResult) -> None:
        """Take a chunk."""
        if self.store is None:
            self.chunks[chunk] = result
        else:
            self.store.put(chunk, result)

    def values(self) -> dict[str, np.ndarray]:
        """All runs, by name."""
        if self.store is not None:
            return self.store.values()
        parts = [self.chunks[chunk] for chunk in range(self.n_chunks)]
        kept = {name: np.concatenate([part.kept[name] for part in parts]) for name in parts[0].kept}
        counted = ("status", "t_reached", "n_steps", "n_rejected")
        return {**kept, **{name: np.concatenate([getattr(part, name) for part in parts]) for name in counted}}

    def account(self, values: dict[str, np.ndarray]) -> dict:
        """Time and lanes, for the attributes."""
        if self.store is None:
            parts = [self.chunks[chunk] for chunk in range(self.n_chunks)]
            seconds = np.array([part.seconds for part in parts])
            lane_steps = np.array([part.n_lane_steps for part in parts])
        else:
            seconds, lane_steps = self.store.of_chunks("seconds"), self.store.of_chunks("n_lane_steps")
        n_steps = int(values["n_steps"].sum())
        return {
            "seconds_of_chunks": seconds,
            "n_lane_steps": int(lane_steps.sum()),
            "lane_efficiency": n_steps / max(int(lane_steps.sum()), 1),
        }


# Who computes the chunks -------------------------------------------------------------------------------------------

Submit = Callable[[int], "Future[ChunkResult]"]


class _Submitting(NamedTuple):
    """Where chunks go.

    Attributes:
        opened: a context in which `Submit` works.
        at_once: chunks that are under way at the same time; more wait here, where they can be stopped.
    """

    opened: Callable
    at_once: int


def _submitting(work: Work, results: _Results, workers: int, executor: Executor | None) -> _Submitting:
    if executor is not None:
        sent = packed(work)

        @contextmanager
        def elsewhere() -> Iterator[Submit]:
            yield lambda chunk: executor.submit(run_packed_chunk, sent, results.rows(chunk))

        return _Submitting(elsewhere, 4 * (getattr(executor, "_max_workers", None) or os.cpu_count() or 1))

    @contextmanager
    def here() -> Iterator[Submit]:
        devices = jax.local_devices()
        program = compiled_for(work, results.rows(0)) if len(devices) == 1 else None
        with ThreadPoolExecutor(workers) as pool:
            yield lambda chunk: pool.submit(
                run_chunk, work, results.rows(chunk), program, devices[chunk % len(devices)]
            )

    return _Submitting(here, workers)


def _run_all(results: _Results, submitting: _Submitting, report: Report) -> None:
    """Hand out the missing chunks, take what comes back, and hand out again what was lost."""
    waiting = results.missing()
    seen = Seen.beginning(results.grid.n_runs, results.n_chunks, results.n_chunks - len(waiting), results.work.size)
    if not waiting:
        report(seen)
        return
    attempts: Counter[int] = Counter()
    with submitting.opened() as submit:
        under_way: dict[Future, int] = {}
        try:
            while waiting or under_way:
                while waiting and len(under_way) < submitting.at_once:
                    chunk = waiting.pop(0)
                    attempts[chunk] += 1
                    under_way[submit(chunk)] = chunk
                for future in wait(under_way, return_when=FIRST).done:
                    chunk = under_way.pop(future)
                    error = future.exception()
                    if error is None:
                        results.put(chunk, future.result())
                        seen = seen.with_chunk(future.result())
                        report(seen)
                    elif attempts[chunk] < ATTEMPTS and not isinstance(error, SceneError):
                        waiting.append(chunk)
                    else:
                        raise error
        finally:
            for future in under_way:
                future.cancel()


def _default_workers() -> int:
    devices = jax.local_devices()
    if devices[0].platform == "cpu" and len(devices) == 1:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return len(devices)


def _chunk_size(n_runs: int, workers: int) -> int:
    """As many equal chunks as keep all workers busy, of at most `LARGEST_CHUNK` runs."""
    rounds = -(-n_runs // (workers * LARGEST_CHUNK))
    return -(-n_runs // (workers * rounds))


# What is said about it -------------------------------------------------------------------------------------------


def _example(build: Build, grid: Grid):
    """The scene of the first run that can be built; the others' errors become their status."""
    problem: SceneError | None = None
    for run in sorted({0, grid.n_runs // 2, grid.n_runs - 1}):
        try:
            scene = built(build, {name: values[run] for name, values in grid.values.items()})
            compile_scene(scene)
            return scene
        except SceneError as error:
            problem = problem or error
        except TypeError as error:
            raise SceneError(f"build cannot be called with the parameters {', '.join(grid.values)}: {error}") from error
    assert problem is not None
    raise problem


def _provenance(scene, grid: Grid, method: Method, ts, wanted) -> dict[str, Any]:
    """What makes a sweep the same sweep, and what a reader wants to know about it."""
    from importlib.metadata import version

    structure, theta = flatten_system(compile_scene(scene).system)
    # A function in the scene is printed with its address, which is another one in each process.
    described = re.sub(r" at 0x[0-9a-f]+", "", repr((structure.tree, structure.shapes)))
    return {
        "scene": f"bodies {', '.join(scene.bodies)}; joints {', '.join(scene.joints)}",
        "structure": _digest(described),
        "numbers": _digest(np.asarray(theta).tobytes().hex()),
        "grid_kind": grid.kind,
        "record": [f"{kept.kind}: {kept.name}" for kept in wanted.kept],
        "times": _digest(ts.tobytes().hex()),
        "rtol": float(method.rtol),
        "atol": "by component" if method.atol is None else float(method.atol),
        "method": method.choice.reason,
        "max_steps": method.max_steps,
        **{f"{name}_version": version(name) for name in ("spherejax", "jax", "diffrax")},
        "commit": _commit(),
    }


def _digest(text: str) -> str:
    import hashlib

    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _commit() -> str:
    """The commit of the user's working folder."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, timeout=5, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return found.stdout.strip() or "unknown"
