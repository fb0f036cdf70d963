"""What makes a sweep the same sweep: what it computes, from the traced programs of its builder and its functions.

Two builders may agree at one run and differ at the others; so what is compared is the program for all runs. Renaming,
comments and moving code about leave it as it is: a store is resumed as long as the numbers are the same.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.motion.integration.audit import CHECKS
from spherejax.motion.integration.lanes import LaneOutcome
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.batch_setup import BatchSettings, PreparedRuns
from spherejax.motion.runs.traced_functions import built, numbers_fingerprint
from spherejax.program_cache.fingerprints import (
    Traced,
    TracedFunction,
    combined,
    program_fingerprint,
    value_fingerprint,
)
from spherejax.studies.sweep.grids import Grid
from spherejax.studies.sweep.records import Kept, Record

N_POINTS = 8
"""Runs at which the numbers of the scene are compared as well: the first, the middle, the last, and others by chance.

What a builder asks Python or a file for (`jax.pure_callback`) shows in numbers alone."""


def points_of(grid: Grid) -> list[int]:
    """The runs at which numbers are compared: the same in every call with this grid."""
    n = grid.n_runs
    by_chance = np.random.default_rng(n).integers(n, size=N_POINTS - 3)
    return sorted({0, n // 2, n - 1, *(int(run) for run in by_chance)})


def identity_of(build: TracedFunction, grid: Grid, wanted: Record) -> dict[str, Any]:
    """Fingerprints of the program of the builder, of numbers of its scenes, and of the functions that are recorded."""
    return {
        "program": build.fingerprint,
        "points": combined(*(numbers_fingerprint(build.function, grid.row(run)) for run in points_of(grid))),
        "functions": {kept.name: traced.fingerprint for kept in wanted.kept if (traced := _traced_function(kept))},
    }


def _traced_function(kept: Kept) -> TracedFunction | None:
    """The function that is recorded, its own or that of its derivatives, when it has been traced."""
    function = (kept.inner or kept).function
    return function if isinstance(function, TracedFunction) else None


def with_known_functions(
    wanted: Record, build: TracedFunction, settings: BatchSettings, grid: Grid, ts: np.ndarray
) -> Record:
    """The record, its functions identified by what they compute: two calls with equal lambdas share one program."""
    if not any((kept.inner or kept).function for kept in wanted.kept):
        return wanted
    one = {name: jax.ShapeDtypeStruct((), jnp.float64) for name in grid.names}
    run = jax.eval_shape(partial(_run_of, build, settings, jnp.asarray(ts)), one)
    return Record(tuple(_known(kept, run, False) for kept in wanted.kept))


def _known(kept: Kept, run: Trajectory, has_slopes: bool) -> Kept:
    if kept.inner is not None:
        return replace(kept, inner=_known(kept.inner, run, True))
    if kept.function is None:
        return kept
    traced = program_fingerprint(kept.function, run)
    if has_slopes:
        # Rules of derivatives are no part of the program; they are in the code.
        traced = Traced(combined(traced.fingerprint, value_fingerprint(kept.function)), traced.is_bound)
    return replace(kept, function=TracedFunction.of(kept.function, traced))


def _run_of(build: TracedFunction, settings: BatchSettings, ts, parameters) -> Trajectory:
    """What a function is given, with zeros where the integration would be: only shapes matter."""
    prepared = PreparedRuns(partial(built, build), settings, ts)
    start = prepared.start_of_state(parameters)
    zero, n_contacts = jnp.zeros((), jnp.int64), len(prepared.contact_joints)
    ys = jnp.zeros((len(ts), len(start.y0)))
    none = jnp.zeros(n_contacts, jnp.int64)
    touching, peaks, audit = jnp.zeros(n_contacts), jnp.zeros(0), jnp.zeros(len(CHECKS))
    outcome = LaneOutcome(ys, ts[0], zero, zero, zero, none, touching, peaks, start.y0, audit, zero)
    return prepared.trajectory(start, outcome)
