"""`sj.optimize`: the design whose motion keeps its limits and makes one measure least."""

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.studies.design.constrained import Constrained, Interrupted, Search, search
from spherejax.studies.design.design_result import Design, design_of
from spherejax.studies.design.measures import Function
from spherejax.studies.design.problem import Build, DesignProblem, checked_limits
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed

SHARPNESSES = (10.0, 50.0, 250.0)
"""Exponents of smooth peaks, round by round: first the broad outline of the histories, in the end their peaks."""

SPREAD = np.log(10.0)
"""Other starts of a number without bounds lie within this of the given one, in u: within a factor of ten."""


class _Begun(NamedTuple):
    """Searches from all starts.

    Attributes:
        searches: in the order of the starts.
        interrupted: whether Ctrl-C has ended them.
    """

    searches: list[Search]
    interrupted: bool


@rng_was_seed
def optimize(
    build: Build,
    start: Mapping[str, Any],
    ts: Float[Array, " n"],
    *,
    minimize: str,
    limits: Mapping[str, Any] | None = None,
    measures: Mapping[str, Function] | None = None,
    starts: int = 1,
    sharpnesses: tuple[float, ...] = SHARPNESSES,
    tolerance: float = 1e-4,
    max_iterations: int = 50,
    rng: Rng = 0,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 1_000_000,
    progress: bool = True,
) -> Design:
    """Find the parameters that make a measure of the motion least, within limits on other measures.

        min f(p)    with    l_j <= g_j(p) <= h_j,    lower <= p <= upper

    by sequential quadratic programming on forward sensitivities. Peaks are replaced by smooth ones, sharper from
    round to round, and each round begins with smooth peaks scaled to the true ones, so that in the end the true peaks
    keep their limits.

    Args:
        build: makes a `Scene` from the parameters, by keyword. It is traced.
        start: the parameters to begin with, numbers or `sj.Parameter` with bounds; the optimum may lie on a bound.
            Positive numbers are searched by their logarithms.
        ts: sample times [s]; peaks are those of the samples, which must resolve them.

    Other args:
        minimize: name of the measure to make least, e.g. `"peak reaction.a_arm_pivot"`; see `studies.design.measures`.
        limits: largest value by name of a measure, or a pair (lower, upper).
        measures: functions from a `Trajectory` to a number, by name, for `minimize` and `limits`. Inside, take
            `sj.studies.smooth_peak` in place of a largest sample.
        starts: searches; the first begins as given, the others anywhere within the bounds (of a number without bounds:
            within a factor of ten). The best design is returned.
        sharpnesses: exponents of smooth peaks, one for each round.
        tolerance: how closely limits are kept, as a share of the limit, and how little the last iteration gains.
        max_iterations: of one round.
        rng: of the other starts, a whole number or a generator.
        rtol, atol, solver, max_steps: as in `simulate`.
        progress: print a line for each round.

    Returns:
        The best design among all that were tried and keep the limits. Ctrl-C ends the search with the best so far.

    Raises:
        SceneError: for a request that cannot be computed, or a start whose run fails.
    """
    began = time.perf_counter()
    allowed = checked_limits(limits)
    names = list(dict.fromkeys([minimize, *allowed]))
    problem = DesignProblem(
        build, start, ts, names, measures or {}, rtol=rtol, atol=atol, solver=solver, max_steps=max_steps
    )
    if starts < 1:
        raise SceneError(f"starts = {starts} must be at least 1")
    first = problem.evaluate(problem.u0, sharpnesses[0])
    if not first.succeeded:
        raise SceneError(f"the run of the start failed: {first.diagnosis} Begin with another design, or a looser rtol")
    task = Constrained(problem, first, list(allowed.values()), [names.index(name) for name in allowed], tolerance)
    begun = _searched(task, _starts(problem, starts, rng), sharpnesses, max_iterations, progress)
    return design_of(task, begun.searches, begun.interrupted, allowed, time.perf_counter() - began)


def _searched(task: Constrained, starts, sharpnesses, max_iterations: int, progress: bool) -> _Begun:
    searches = []
    for number, u in enumerate(starts):
        label = f"start {number + 1} of {len(starts)}, " if len(starts) > 1 else ""
        try:
            searches.append(search(task, u, sharpnesses, max_iterations, label if progress else None))
        except Interrupted as stopped:
            return _Begun([*searches, stopped.search], True)
    return _Begun(searches, False)


def _starts(problem: DesignProblem, n: int, rng: Rng) -> np.ndarray:
    """Unknowns where each search begins, the first as given."""
    low, high = problem.bounds.T
    low = np.where(np.isfinite(low), low, problem.u0 - SPREAD)
    high = np.where(np.isfinite(high), high, problem.u0 + SPREAD)
    others = generator(rng).uniform(low, high, (n - 1, problem.u0.size))
    return np.concatenate([np.asarray(jnp.asarray(problem.u0))[None], others])
