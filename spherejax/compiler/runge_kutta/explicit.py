"""The explicit step of a scalar program: its recipe, and its arguments."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.primitive import ActiveInputs
from spherejax.compiler.program import ScalarProgram
from spherejax.compiler.runge_kutta.call import all_stages, can_be_called
from spherejax.compiler.runge_kutta.recipe import MOVED, N_MADE, TIME, LinePart, Rows, StepRecipe, Tangents, entries_at
from spherejax.compiler.runge_kutta.tableau import Tableau

FIRST = N_MADE + 1
"""The first argument of the call that belongs to the program."""


def explicit_stages(
    program: ScalarProgram,
    tableau: Tableau,
    t: Array,
    h: Array,
    bend: Array,
    y: Array,
    n_made: Any,
    numbers: Array,
    ahead: tuple[Array, ...],
    slopes: tuple[Array, tuple[Array | None, ...]] | None = None,
    moving: tuple[int, ...] | None = None,
) -> tuple[Array, Array] | None:
    """All stages of an explicit Runge-Kutta step of many runs by one call; None where it cannot be machine code.

    Args:
        program: of a rate f(numbers, t, y) that returns dy/dt. The numbers are its leading argument.
        tableau: the coefficients.
        t, h, bend: time, length of the step, and how the time within it is stretched (0: not at all), shape (n_runs,).
        y: state, shape (size, n_runs), or with tangents below it (1 + rows, size, n_runs).
        n_made: how many stages are evaluated, the first ones; increments of the others are zero.
        numbers: shape (n, n_runs).
        ahead: what `program.ahead` has evaluated, with a last axis of runs.
        slopes: tangents of `numbers` and of `ahead`, with an axis of rows in front; None without rows.
        moving: entries of `numbers` that have tangents; None for all.

    Returns:
        The increments k of the stages, shape (s, size, n_runs), and their sums, shape (m, size, n_runs). With rows each
        has an axis of 1 + rows in front of its size.
    """
    if not machine_code.native_code_enabled():
        return None
    # How arguments are passed on is the same for all runs: the first one shows it.
    first = jax.tree.map(lambda x: x[..., 0], ahead)
    line, hoisted = program.line_inside(first)
    # A line that returns more than the rate would need a place for it in each stage.
    if len(line.outputs) > 1:
        return None
    # Numbers that were evaluated ahead one by one become vectors, in each run by itself.
    arguments = _over_runs(lambda x, ahead: (x, *program.line_inside(ahead)[1]))(numbers, ahead)
    places = range(FIRST + 1, FIRST + 1 + len(hoisted))
    step = StepRecipe((), LinePart(line, (FIRST, TIME, MOVED, *places)), None, tableau)
    if not can_be_called(step, y.shape[-2]):
        return None
    if slopes is not None:
        with_numbers = _over_runs(lambda x, *both: (x, *program.slopes_inside(*both)))
        along = with_numbers(slopes[0], ahead, slopes[1])
        some = [True] * len(along) if moving is None else program.moving_inside(first, moving)
        moves: dict[int, ActiveInputs] = {
            place: entries
            for place, x, entries in zip((FIRST, *places), along, some, strict=True)
            if x is not None and entries
        }
        # Behind all other arguments, so that the sources of the parts without tangents stay what they are.
        tangents = Tangents(y.shape[0] - 1, moves, FIRST + len(arguments))
        rate, rows = tangents.of_rate(step.rate)
        step = step._replace(rate=rate, rows=Rows(tangents.n, tangents.arguments, rows))
        entries = (entries_at(x, moves.get(place, False)) for place, x in zip((FIRST, *places), along, strict=True))
        arguments += tuple(x for x in entries if x is not None)
        if not can_be_called(step, y.shape[-2]):  # the rows may be too many
            return None
    # One run is written without groups: its entries are the vectors then, and its numbers stay numbers.
    n_runs = None if y.shape[-1] == 1 else y.shape[-1]
    if n_runs is None:
        t, h, bend, *arguments = (jnp.squeeze(x, -1) for x in (t, h, bend, *arguments))
    # The text reads 64 bits, whatever the caller counts with.
    k, sums = all_stages(step, t, h, y, bend, jnp.asarray(n_made, jnp.int64), *arguments, n_runs=n_runs)
    return k, sums


def _over_runs(function: Callable) -> Callable:
    return jax.vmap(function, in_axes=-1, out_axes=-1)
