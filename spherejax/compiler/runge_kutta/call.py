"""All stages of a Runge-Kutta step (`recipe`) as one operation of JAX, which is one call of machine code.

One by one, the stages would cost XLA one or two calls and several kernels each, as much as the right-hand side of a
mechanism takes. Here they are a loop around its function (`text`). Many runs are a loop around all of this, over groups
of them (`native.groups`).
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

from spherejax.compiler.emit.llvm import widest_for
from spherejax.compiler.lanes import by_a_loop
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.groups import Operand, RunGroups, function_of
from spherejax.compiler.operations import BOOL, FLOAT
from spherejax.compiler.runge_kutta.recipe import N_MADE, SLOPE, StepRecipe
from spherejax.compiler.runge_kutta.text import step_text

LARGEST_EXPLICIT_STATE, LARGEST_STATE = 512, 128
"""Vectors of a state, with its rows, up to which stages are kept on the stack: of explicit and of Rosenbrock steps. An
elimination makes some hundred times the size of a state beside them."""

LARGEST_ROOM = 2**19
"""Bytes of what is made in a Rosenbrock step of a group of runs, at most: threads of XLA's pool have few megabytes."""


def can_be_called(step: StepRecipe, size: int) -> bool:
    """Whether the stages of a step of a state of so many entries can be one call."""
    n = size * (1 + RunGroups().lanes_for(step.n_rows))
    # As one run, in vectors of several entries; of a group of runs each entry is a vector.
    if not machine_code.native_code_enabled() or not 0 < n <= _largest_state(step) * RunGroups().at_a_time:
        return False
    if not all(part.line.in_machine_code and part.line.can_be_called for part in step.parts):
        return False
    lines = [part.line for part in (step.rate, step.solve) if part is not None]
    return all(line.outputs[0].shape == (size,) and line.dtype(line.outputs[0]) == FLOAT for line in lines)


def _largest_state(step: StepRecipe) -> int:
    return LARGEST_EXPLICIT_STATE if step.solve is None else LARGEST_STATE


def all_stages(step: StepRecipe, *arguments: Array, n_runs: int | None = None) -> list[Array]:
    """The increments k, shape (s, size), or (s, 1 + rows, size); and sums of them, (m, size), if some are wanted.

    Args:
        step: what is done.
        arguments: in the order of `recipe`; with `n_runs` each has a last axis of runs, but how many stages are made.
        n_runs: how many runs; None for one. More of them may come by `jax.vmap`.
    """
    # All runs make the same number of stages: it is the end of one loop for a whole group.
    shared = tuple(n_runs is None or x.ndim == 0 for x in arguments)
    return _step.bind(*arguments, step=step, n_runs=n_runs, shared=shared)


_step = Primitive("runge_kutta_step")
_step.multiple_results = True


@_step.def_abstract_eval
def _shapes(t: Any, h: Any, y: Any, *others: Any, step: StepRecipe, **how: Any) -> list:
    del t, h, others, how
    assert step.tableau is not None
    numbers = len(step.tableau.c), len(step.tableau.sums)
    return [ShapedArray((n, *y.shape), y.dtype) for n in numbers if n]


def _batched(arguments: Sequence, dims: Sequence, **how: Any) -> tuple[Sequence, Sequence]:
    """More runs, on a last axis; a run alone needs none, and of two axes one is gone along."""
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    if n == 1:  # without an axis of runs its text, and so its machine code, is that of a run alone
        alone = [x if dim is None else jnp.squeeze(x, dim) for x, dim in zip(arguments, dims, strict=True)]
        results = [x[None] for x in _step.bind(*alone, **how)]
        return results, [0] * len(results)
    step: StepRecipe = how["step"]
    # Groups have one axis of runs, and one number of stages for all of them.
    if how["n_runs"] is not None or step.solve is None:
        return by_a_loop(partial(_step.bind, **how), arguments, dims)
    behind = [x if dim is None else jnp.moveaxis(x, dim, -1) for x, dim in zip(arguments, dims, strict=True)]
    shared = [dim is None for dim in dims]
    # Where a step begins differs between runs as a rule; what the caller shares, its seeds, say, is read once for all.
    for i in range(SLOPE + 1):
        behind[i] = jnp.broadcast_to(behind[i][..., None], (*behind[i].shape, n)) if shared[i] else behind[i]
        shared[i] = False
    results = _step.bind(*behind, step=step, n_runs=n, shared=tuple(shared))
    return results, [x.ndim - 1 for x in results]


batching.primitive_batchers[_step] = _batched


def _target(avals: Sequence, *, step: StepRecipe, n_runs: int | None, shared: tuple[bool, ...]) -> str:
    operands = _operands(avals, step, n_runs, shared)
    key = "runge_kutta_step", operands, n_runs, step
    # Kept with the solver, whose factors belong to its step.
    line = (step.solve or step.rate).line
    # LLVM takes a third longer with its passes, and films run as fast without; explicit steps do not.
    return machine_code.called_text(
        key, line, lambda: _text(step, operands, n_runs), is_wide=n_runs is not None, is_optimised=step.solve is None
    )


def _lowered(context: Any, *arguments: Any, **how: Any) -> Sequence:
    return jax.ffi.ffi_lowering(_target(context.avals_in, **how))(context, *arguments)


machine_code.TARGETS["runge_kutta_step"] = _target
mlir.register_lowering(_step, _lowered, platform="cpu")


def _operands(avals: Sequence, step: StepRecipe, n_runs: int | None, shared: tuple[bool, ...]) -> tuple[Operand, ...]:
    """The arguments of the call."""
    # By the recipe, not by what is passed: the state of one run may have an axis of length one behind it.
    state = _state(step)
    operands = [Operand(1), Operand(1), state]
    for i, aval in enumerate(avals[len(operands) :], len(operands)):
        n = aval.size // (1 if n_runs is None or shared[i] else n_runs)
        kind = "i8" if aval.dtype == BOOL else "double"
        if i == SLOPE and step.solve is not None:
            operands.append(state)
        elif i == N_MADE and step.solve is None:
            operands.append(Operand(1, kind="i64", is_shared=True))
        elif step.rows is not None and i in step.rows.arguments:
            operands.append(Operand(0, n // step.n_rows, step.n_rows, kind, shared[i]))
        else:
            operands.append(Operand(n, kind=kind, is_shared=shared[i]))
    return tuple(operands)


def _state(step: StepRecipe, n: int = 1) -> Operand:
    """So many arrays of the shape of a state with its rows."""
    below: Any = (step.size, step.n_rows) if step.n_rows else ()
    return Operand(step.size, *below, n=n)


def _groups(step: StepRecipe, n_runs: int | None) -> RunGroups:
    """As wide as the values of the parts, and what is made in a step, allow."""
    size = step.size * (1 + step.n_rows)
    # A state with rows that is beyond the stack goes one run at a time.
    if n_runs is None or size > _largest_state(step):
        return RunGroups(n_runs)
    widest = widest_for(*(part.line for part in step.parts))
    if step.solve is not None:
        assert step.tableau is not None
        # Rows are counted for every output: which of them are over lanes is not looked at for an upper bound.
        made = sum(output.size for part in step.parts for output in part.line.outputs) * max(1, step.n_rows)
        # Increments of all stages, and five more arrays of the size of a state (`%moved` to `%nothing`, and y).
        made += size * (len(step.tableau.c) + 5)
        widest = min(widest, max(1, LARGEST_ROOM // (8 * made)))
    return RunGroups.of(n_runs, widest)


def _text(step: StepRecipe, operands: Sequence[Operand], n_runs: int | None) -> str:
    """The function that XLA calls."""
    assert step.tableau is not None
    groups = _groups(step, n_runs)
    results = [_state(step, n) for n in (len(step.tableau.c), len(step.tableau.sums)) if n]
    declared, inner = step_text(step, len(operands), groups)
    # Sorted: the name of the function is a digest of its text, which has to be the same in every process.
    return "\n".join([*sorted(declared), inner, function_of(operands, results, groups, "step")])
