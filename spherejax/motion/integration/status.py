"""How a run ended: a value, with a diagnosis and a remedy."""

import enum
from collections.abc import Callable

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Flag, Scalar
from spherejax.motion.solvers.landing import NOT_FINITE_RESULT
from spherejax.motion.start.assembly import CLOSING_TOLERANCE


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
    NOT_FINITE = 8

    def __str__(self) -> str:
        return f"Status.{self.name}"

    def __repr__(self) -> str:
        return str(self)

    def __format__(self, spec: str) -> str:
        return format(int(self), spec) if spec else str(self)


REMEDIES = {
    Status.TOO_MANY_STEPS: (
        "the number of steps reached max_steps. Raise max_steps, loosen rtol, or, when the steps are tiny, choose a "
        "stiff solver (solver=spherejax.solvers.Rodas5P())"
    ),
    Status.STEP_TOO_SMALL: (
        "the step size shrank to the rounding of time: the accelerations are not finite or grow without bound there. "
        "Check the forces at that instant, loosen rtol, or soften the contact or film"
    ),
    Status.BAD_VALUE: (
        "a physical number is not valid (for instance a clearance that is not positive), or the sample times do "
        "not increase, or do not begin where the run that goes on ended. Simulate this lane alone, outside jit and "
        "vmap, to get the error that names the joint and the value"
    ),
    Status.START_NOT_CLOSED: (
        "the joints cannot be closed at the start. Simulate this lane alone, outside jit and vmap, to get the error "
        "that names the joint"
    ),
    Status.AUDIT_FAILED: (
        "the audit found a violated invariant (`run.audit` says which); the motion is wrong there, and may be from "
        "shortly before. Tighten rtol, choose another solver or drift control "
        "(sj.solvers.PostStabilization() where the "
        "mechanism passes singular positions), and check the laws and forces of your own"
    ),
    Status.INACCURATE: (
        "no tolerance gives the accuracy that was asked for (`run.accuracy` has the estimated errors). Shorten the "
        "run, allow larger errors, or ask for statistics of many runs in place of one history"
    ),
    Status.NOT_FINITE: (
        "a number of the motion, or of a derivative that is integrated beside it, is not finite there (NaN or "
        "infinity), so no step can be made. Check functions and laws of your own at that instant: a division by zero, "
        "a power, root or norm whose derivative is infinite at zero (a driver is differentiated twice by time), a "
        "branch of jnp.where that is not taken and not finite"
    ),
    Status.SOLVER_FAILED: (
        "the solver could not make a step (a linear or nonlinear solve failed). Choose another solver or loosen rtol"
    ),
}


AUDIT_RESULT = diffrax.RESULTS.internal_error
"""What a solver says where the audit of its step failed; diffrax, whose results cannot be added to, does not use it."""

STOPPED_IN_MOTION = (Status.TOO_MANY_STEPS, Status.STEP_TOO_SMALL, Status.SOLVER_FAILED, Status.AUDIT_FAILED)
"""Endings that the motion itself may have brought about, for instance a singular configuration."""


EXPLAINED = (Status.AUDIT_FAILED, Status.NOT_FINITE, Status.STEP_TOO_SMALL, Status.BAD_VALUE)
"""Endings of which the cause may be found: what the audit saw, or whose value is not finite."""


def start_status(values_are_legal: Flag, residual: Scalar, y0: Float[Array, " *state"]) -> Int[Array, ""]:
    """The status of a run before its first step; it may run if that is `SUCCEEDED`.

    Args:
        values_are_legal: whether the conditions of the scene and of the request hold.
        residual: of the joints' equations once the start is assembled [m or 1].
        y0: flat state at the start, with sensitivities as rows below it or without.
    """
    is_finite = jnp.all(jnp.isfinite(y0)) & jnp.isfinite(residual)
    status = jnp.where(residual < CLOSING_TOLERANCE, Status.SUCCEEDED, Status.START_NOT_CLOSED)
    status = jnp.where(is_finite, status, Status.NOT_FINITE)
    return jnp.asarray(jnp.where(values_are_legal, status, Status.BAD_VALUE), jnp.int64)


def status_of(result: diffrax.RESULTS) -> Int[Array, ""]:
    """The status that a result of diffrax stands for, as an integer array."""
    results = diffrax.RESULTS
    failed = jnp.where(result == results.successful, Status.SUCCEEDED, Status.SOLVER_FAILED)
    failed = jnp.where(result == results.max_steps_reached, Status.TOO_MANY_STEPS, failed)
    failed = jnp.where(result == results.dt_min_reached, Status.STEP_TOO_SMALL, failed)
    failed = jnp.where(result == NOT_FINITE_RESULT, Status.NOT_FINITE, failed)
    return jnp.where(result == AUDIT_RESULT, Status.AUDIT_FAILED, failed)


def end_status(status: Int[Array, ""], t_reached: Scalar, t_end: Scalar, states_are_finite: Flag) -> Int[Array, ""]:
    """The status of a run that has ended: `SUCCEEDED` only at its end, with samples and a last state that are finite.

    Every road of a run reports what this returns, whatever its loop said: the loop judges errors, and an error that is
    not judged (of a controller of the user's, of a stage for dense output alone) may hide a NaN.

    Args:
        status: as the loop ended, an integer of `Status`.
        t_reached: time reached [s].
        t_end: last sample time [s].
        states_are_finite: whether all samples and the last state are.
    """
    status = jnp.where((status == Status.SUCCEEDED) & ~(t_reached >= t_end), Status.SOLVER_FAILED, status)
    return jnp.where((status == Status.SUCCEEDED) & ~states_are_finite, Status.NOT_FINITE, status)


def diagnosis(status, t_reached, t_end, found: Callable[[tuple], str] = lambda lane: "") -> str:
    """What happened, in one sentence a lane; empty when all lanes succeeded.

    Args:
        status: integers, any shape (one an entry is a lane).
        t_reached: times reached [s], same shape.
        t_end: times asked for [s], same shape.
        found: what was found to be the cause of a lane's end, by its index; asked for endings in `EXPLAINED`.
    """
    status, t_reached, t_end = (np.atleast_1d(np.asarray(value)) for value in (status, t_reached, t_end))
    sentences = []
    for lane in np.argwhere(status != Status.SUCCEEDED):
        index = tuple(lane)
        which = "" if status.size == 1 else f"lane {', '.join(map(str, index))}: "
        ended = Status(status[index])
        cause = found(index) if ended in EXPLAINED else ""
        why = f"{cause}: " if cause else ""
        sentences.append(
            f"{which}stopped at t = {t_reached[index]:.9g} s of {t_end[index]:.9g} s: {why}{REMEDIES[ended]}."
        )
    return "\n".join(sentences)
