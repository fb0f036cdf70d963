"""How a run ended: a value, with a diagnosis and a remedy."""

import enum
from collections.abc import Callable

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from spherejax.foundations.types import Flag


class SimulationWarning(UserWarning):
    """A run did not reach its end, or not its accuracy; the message says when, why and what to do."""


class OutOfRangeWarning(UserWarning):
    """A run reached its end and used a law beyond the range for which it holds; the message says which and how far."""


class SimulationError(RuntimeError):
    """As `SimulationWarning`, for `throw=True`."""


class Status(enum.IntEnum):
    """How a run ended. `SUCCEEDED` is zero, so a lane has failed where the status is not."""

    SUCCEEDED = 0
    TOO_MANY_STEPS = 1
    STEP_TOO_SMALL = 2
    BAD_VALUE = 3
    START_NOT_CLOSED = 4
    SOLVER_FAILED = 5
    AUDIT_FAILED = 6
    INACCURATE = 7

    def __str__(self) -> str:
        return f"Status.{self.name}"

    def __repr__(self) -> str:
        return str(self)

    def __format__(self, spec: str) -> str:
        return format(int(self), spec) if spec else str(self)


REMEDIES = {
    Status.TOO_MANY_STEPS: (
        "the number of steps reached max_steps. Raise max_steps, loosen rtol, or, when the steps are tiny, choose a "
        "stiff solver (solver=spherejax.Rodas5P())"
    ),
    Status.STEP_TOO_SMALL: (
        "the step size shrank to the rounding of time: the accelerations are not finite or grow without bound there. "
        "Check the forces at that instant, loosen rtol, or soften the contact or film"
    ),
    Status.BAD_VALUE: (
        "a physical number is not legal (for instance a clearance that is not positive). Simulate this lane alone, "
        "outside jit and vmap, to get the error that names the joint and the value"
    ),
    Status.START_NOT_CLOSED: (
        "the joints cannot be closed at the start. Simulate this lane alone, outside jit and vmap, to get the error "
        "that names the joint"
    ),
    Status.AUDIT_FAILED: (
        "the audit found what cannot be (`run.audit` says what); the motion is wrong there, and may be from shortly "
        "before. Tighten rtol, choose another solver or drift control, and check the laws and forces of your own"
    ),
    Status.INACCURATE: (
        "no tolerance gives the accuracy that was asked for (`run.accuracy` has the estimated errors). Shorten the "
        "run, allow larger errors, or ask for statistics of many runs in place of one history"
    ),
    Status.SOLVER_FAILED: (
        "the solver could not make a step (a linear or nonlinear solve failed). Choose another solver or loosen rtol"
    ),
}


AUDIT_RESULT = diffrax.RESULTS.internal_error
"""What a solver says where the audit of its step failed; diffrax, whose results cannot be added to, does not use it."""

STOPPED_IN_MOTION = (Status.TOO_MANY_STEPS, Status.STEP_TOO_SMALL, Status.SOLVER_FAILED)
"""Endings that the motion itself may have brought about, for instance a singular configuration."""


def status_of(result: diffrax.RESULTS, values_are_legal: Flag, start_is_closed: Flag) -> Int[Array, ""]:
    """The status as an integer array, from diffrax's result and the checks made inside the program."""
    results = diffrax.RESULTS
    failed = jnp.where(result == results.successful, Status.SUCCEEDED, Status.SOLVER_FAILED)
    failed = jnp.where(result == results.max_steps_reached, Status.TOO_MANY_STEPS, failed)
    failed = jnp.where(result == results.dt_min_reached, Status.STEP_TOO_SMALL, failed)
    failed = jnp.where(result == AUDIT_RESULT, Status.AUDIT_FAILED, failed)
    failed = jnp.where(start_is_closed, failed, Status.START_NOT_CLOSED)
    return jnp.where(values_are_legal, failed, Status.BAD_VALUE)


def diagnosis(status, t_reached, t_end, found: Callable[[tuple], str] = lambda lane: "") -> str:
    """What happened, in one sentence a lane; empty when all lanes succeeded.

    Args:
        status: integers, any shape (one an entry is a lane).
        t_reached: times reached [s], same shape.
        t_end: times asked for [s], same shape.
        found: what the audit of a lane found, by its index.
    """
    status, t_reached, t_end = (np.atleast_1d(np.asarray(value)) for value in (status, t_reached, t_end))
    sentences = []
    for lane in np.argwhere(status != Status.SUCCEEDED):
        index = tuple(lane)
        which = "" if status.size == 1 else f"lane {', '.join(map(str, index))}: "
        ended = Status(status[index])
        why = f"{found(index)}: " if ended == Status.AUDIT_FAILED and found(index) else ""
        sentences.append(
            f"{which}stopped at t = {t_reached[index]:.9g} s of {t_end[index]:.9g} s: {why}{REMEDIES[ended]}."
        )
    return "\n".join(sentences)
