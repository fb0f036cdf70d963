"""Runs in lanes as one operation of JAX, whose `jax.vmap` is more runs in the same lanes.

`jax.vmap` of a loop waits for its slowest lane and carries every buffer through every step: 256 runs of a four-bar cost
seven to nine times what they cost one after the other. Here the batching rule hands all runs to the queue; nested maps
become one longer queue. What cannot be queued, because it is shared by all runs of a queue (sample times, numbers of
the solver, `max_steps`), is worked off one after the other, with a `SerialRunsWarning`.

The operation has no derivative of its own: its callers have a rule for that.
"""

import warnings
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array, Float, Int

from spherejax.motion.integration.audit import CHECKS
from spherejax.motion.integration.lanes.engine import run_in_lanes
from spherejax.motion.integration.lanes.lane import Block, LaneOutcome, LaneProblem
from spherejax.program_cache import cached_jit, disk_cache, gc_paused
from spherejax.program_cache.several_devices import lowered_replicated

ONE_AFTER_THE_OTHER = (
    "jax.vmap of runs whose sample times, max_steps or numbers of the solver differ: they are made one after the "
    "other, for several times the price of lanes. Map over the numbers of the scene alone, with the sample times of "
    "all runs in one ts. Steps of sj.advance are such runs where the equations read the time (a driver, a function of "
    "time, a sampled controller): give its value as an input of the step instead"
)


class SerialRunsWarning(UserWarning):
    """Runs under `jax.vmap` that cannot share lanes are made one after the other; the message says why."""


class Kind(Protocol):
    """What is integrated in all runs of a queue (static: it is hashed and compared)."""

    @property
    def n_contacts(self) -> int:
        """Contacts whose onsets are counted."""
        ...

    def problem(self, ts: Float[Array, " n"], shared: Any) -> LaneProblem:
        """What every lane integrates, from what the runs share."""
        ...

    def of_many(self, numbers: Any) -> tuple["Kind", Any]:
        """The kind of many runs, and their numbers with a leading axis of runs, from those of a single one."""
        ...


class _Form(NamedTuple):
    """All that is static of the operation."""

    kind: Kind
    block: Block
    shared: Any  # trees of what the runs share and of what is their own
    own: Any
    n_shared: int


def runs(
    kind: Kind,
    parameters: Any,
    y0: Float[Array, "n_jobs ..."],
    ts: Float[Array, " n"],
    may_run: Array,
    status: Int[Array, " n_jobs"],
    shared: Any,
    block: Block,
) -> LaneOutcome:
    """As `run_in_lanes`, for what `kind` describes.

    Args:
        kind: what is integrated.
        parameters, y0, ts, may_run, status, block: as there.
        shared: arrays that all runs share.
    """
    shared_leaves, shared_tree = jax.tree.flatten(shared)
    own_leaves, own_tree = jax.tree.flatten((parameters, y0, may_run, status))
    form = _Form(kind, block, shared_tree, own_tree, len(shared_leaves) + 1)
    operands = [jnp.asarray(leaf) for leaf in (ts, *shared_leaves, *own_leaves)]
    return LaneOutcome(*_runs.bind(*operands, form=form))


def _made(*operands: Array, form: _Form) -> tuple[Array, ...]:
    ts, *shared = operands[: form.n_shared]
    parameters, y0, may_run, status = jax.tree.unflatten(form.own, operands[form.n_shared :])
    with gc_paused():  # JAX traces this while it lowers a caller's program
        problem = form.kind.problem(ts, jax.tree.unflatten(form.shared, shared))
        return tuple(run_in_lanes(problem, parameters, y0, ts, may_run, status, form.block))


@cached_jit(what="runs in lanes")
def _made_now(form: _Form, operands: tuple[Array, ...]) -> tuple[Array, ...]:
    return _made(*operands, form=form)


def _shapes(ts, *others, form: _Form):
    _, y0, _, _ = jax.tree.unflatten(form.own, others[form.n_shared - 1 :])
    n_jobs, *state = y0.shape
    n_contacts = form.kind.n_contacts
    # No kind that comes here watches peaks: `simulate_many`, which does, calls `run_in_lanes` itself.
    number, count = jnp.dtype(jnp.float64), jnp.dtype(jnp.int64)
    outcome: dict[str, tuple[tuple[int, ...], Any]] = {
        "ys": ((n_jobs, *ts.shape, *state), number),
        "t_reached": ((n_jobs,), number),
        "status": ((n_jobs,), count),
        "n_accepted": ((n_jobs,), count),
        "n_rejected": ((n_jobs,), count),
        "n_onsets": ((n_jobs, n_contacts), count),
        "touching": ((n_jobs, n_contacts), number),
        "peaks": ((n_jobs, 0), number),
        "y_reached": ((n_jobs, *state), number),
        "audit": ((n_jobs, len(CHECKS)), number),
        "n_lane_steps": ((), count),
    }
    return [ShapedArray(*outcome[name]) for name in LaneOutcome._fields]


def _batched(operands, dims, *, form: _Form):
    """More runs in the same queue; one queue after the other where something shared differs."""
    is_mapped = [dim is not None for dim in dims]
    n = next(x.shape[dim] for x, dim in zip(operands, dims, strict=True) if dim is not None)
    front = [jnp.moveaxis(x, dim, 0) if mapped else x for x, dim, mapped in zip(operands, dims, is_mapped, strict=True)]
    if any(is_mapped[: form.n_shared]):
        disk_cache.note_warning()
        warnings.warn(ONE_AFTER_THE_OTHER, SerialRunsWarning, stacklevel=2)

        def one(mapped):
            mapped = iter(mapped)
            return _runs.bind(
                *(next(mapped) if is_it else x for x, is_it in zip(front, is_mapped, strict=True)), form=form
            )

        found = jax.lax.map(one, [x for x, is_it in zip(front, is_mapped, strict=True) if is_it])
        return found, [0] * len(found)
    whole = [x if mapped else jnp.broadcast_to(x, (n, *x.shape)) for x, mapped in zip(front, is_mapped, strict=True)]
    joined = [x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]) for x in whole[form.n_shared :]]
    form, joined = _of_many(form, joined)
    *found, n_lane_steps = _runs.bind(*operands[: form.n_shared], *joined, form=form)
    return [*(x.reshape(n, x.shape[0] // n, *x.shape[1:]) for x in found), n_lane_steps], [0] * len(found) + [None]


def _of_many(form: _Form, joined: list) -> tuple[_Form, list]:
    """A queue that was made for a single run, as one of many."""
    numbers, *others = jax.tree.unflatten(form.own, joined)
    if others[0].shape[0] == 1:
        return form, joined
    kind, numbers = form.kind.of_many(numbers)
    leaves, tree = jax.tree.flatten((numbers, *others))
    return form._replace(kind=kind, own=tree), leaves


_runs = Primitive("runs")
_runs.multiple_results = True
_runs.def_impl(lambda *operands, form: _made_now(form, operands))
_runs.def_abstract_eval(_shapes)
batching.primitive_batchers[_runs] = _batched
mlir.register_lowering(_runs, lowered_replicated(_made))
