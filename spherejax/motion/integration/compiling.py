"""How the compiler is told to make the program of a run: soon, where it is large."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
from jax import Array
from jax.extend import core as jex

from spherejax.compiler import hooks, native_code
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import MOST_ROWS_ALONE, path_of, program_for
from spherejax.motion.solvers.traits import is_explicit

LARGE = 10_000
"""Scalar operations of a right-hand side above which compile time is favoured over run time.

A four-bar has 2,000 of them, a robot arm of nine joints (Panda) 15,000. Where XLA compiles the programs, LLVM takes
more than half of the time that it needs for so many; not asked to optimise, it saves a quarter to a third of Panda's
first call. Where they are machine code it has little to do, and this saves a tenth (`benchmarks/robot_start.py`)."""

# A stiff method's program is thousands of scalars. With `LESS_ALIASING` its first call takes a sixth to a quarter less
# processor time, and it runs the same within the noise, with the same bits (`benchmarks/fewer_words.py`). So it is with
# large programs of all methods.


def options_for(plan: Any, *_: Any) -> Mapping[str, Any]:
    """The compiler's options for a run.

    Args:
        plan: what the run is compiled for.
    """
    return hooks.FAST_COMPILE if is_large(plan) else {}


def options_for_stiff(plan: Any, *_: Any) -> Mapping[str, Any]:
    """As `options_for`, for a run of diffrax's loop."""
    return hooks.FAST_COMPILE if is_large(plan) else hooks.LESS_ALIASING


def in_machine_code(plan: Any) -> bool:
    """Whether the programs of a run become machine code of their own."""
    return program_for(state_rate, plan.structure, plan.scalar).scalar is not None


def arrays_in_machine_code(plan: Any, solver: Any) -> bool:
    """Whether the array code of a run is machine code: of an explicit method, which calls it stage by stage."""
    return is_explicit(solver) and not in_machine_code(plan)


def for_one_run(plan: Any, solver: Any, n_rows: int = 0) -> Any:
    """The plan of a run that is made alone: on array code where its first result is there sooner so.

    Args:
        plan: a `Plan`.
        solver: the method.
        n_rows: rows of sensitivities beside the state.
    """
    may_be = plan.scalar is None and is_explicit(solver) and n_rows <= MOST_ROWS_ALONE
    if not (may_be and path_of(plan.structure).alone_on_arrays):
        return plan
    return replace(plan, scalar=False, is_alone=True)


def native_run(function: Callable[[], Any], is_native: bool, joins: bool = True) -> Any:
    """What a function returns that holds the loop of a run.

    Args:
        function: without arguments, not to be differentiated.
        is_native: whether its programs become machine code, and its loop as a whole where that can be.
        joins: whether what lies between the programs of another loop is put into few kernels.
    """
    return native_code(is_native, joins)(function)()


def is_faster_one_by_one(program: Any) -> bool:
    """Whether several runs take less time one by one than side by side.

    Args:
        program: the scalar program of their right-hand side.
    """
    return native_code.is_available() and program.is_of_long_sums


def in_one_call(function: Callable[[], Any], is_native: bool, joins: bool = True) -> Any:
    """What a function returns that holds a run and what is around its loops: by one call, where that can be.

    Args:
        function: without arguments, not to be differentiated.
        is_native, joins: as of `native_run`.
    """
    return native_code(is_native, joins, is_one_call=True)(function)()


def for_each(function: Callable, mapped: Any) -> Any:
    """The results of a function for each entry of arrays along their first axis; it may have loops of any length.

    As machine code the entries are computed on all processors, otherwise one after the other: side by side, loops of
    XLA's would wait for the longest in every turn.
    """
    leaves = jax.tree.leaves(mapped)
    of_one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), mapped)
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(of_one)
    evaluated = jex.jaxpr_as_fun(closed)
    if native_code.leaves_loops(closed.jaxpr):
        results = jax.lax.map(lambda parts: evaluated(*parts), leaves)
    else:
        results = jax.vmap(evaluated)(*leaves)
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def uninitialized(shape: tuple[int, ...]) -> Array:
    """An array for rows that a loop writes before it reads them: what is in it before is undetermined."""
    return native_code.uninitialized(shape)


def is_large(plan: Any) -> bool:
    """Whether a run is on a scalar program that takes long to compile; array code does not, and needs the compiler."""
    scalar = program_for(state_rate, plan.structure, plan.scalar).scalar
    return scalar is not None and scalar.n_operations > LARGE
