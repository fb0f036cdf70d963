"""Whether a solver, a step-size controller and an adjoint of diffrax fit a mechanism and each other; asked before
anything is computed.
"""

import inspect
from typing import Any

import diffrax
import numpy as np

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError

CONSTANT_STEPS = (
    "stepsize_controller = ConstantStepSize() knows no size: diffrax takes it from an argument dt0 of its own loop. "
    "Give the ends of the steps, stepsize_controller=diffrax.StepTo(ts=jnp.linspace(t0, t1, n)), from the first sample "
    "time to the last"
)


def check_solver(solver: Any, is_judged: bool) -> None:
    """Raise `SceneError` for what is no solver of a mechanism.

    Args:
        solver: a diffrax solver.
        is_judged: whether steps are chosen by the errors that it estimates.
    """
    name = type(solver).__name__
    if not isinstance(solver, diffrax.AbstractSolver):
        raise SceneError(f"solver = {shown(solver)} is no solver; give an object, e.g. diffrax.Dopri8()")
    if not _takes_one_term(solver):
        raise SceneError(
            f"solver = {name}() integrates sums of terms that it treats apart (noise beside drift, an implicit part "
            "beside an explicit one); the equations of a mechanism are one term. Take an explicit method "
            "(diffrax.Dopri8()), a Rosenbrock method (sj.solvers.Rodas5P()), or an implicit one of one term "
            "(diffrax.Kvaerno5())"
        )
    if is_judged and not isinstance(solver, diffrax.AbstractAdaptiveSolver):
        raise SceneError(
            f"solver = {name}() estimates no error, so that no tolerance can choose its steps. Take another method "
            f"(diffrax.HalfSolver(diffrax.{name}()) estimates one), or give sj.simulate the ends of its steps: "
            "stepsize_controller=diffrax.StepTo(ts=...)"
        )


def check_control(controller: Any, adjoint: Any, ts: Any) -> None:
    """Raise `SceneError` for a step-size controller or an adjoint that cannot be used.

    Args:
        controller: a diffrax step-size controller; None for that of this package.
        adjoint: a diffrax adjoint; None for derivatives of this package.
        ts: sample times [s].
    """
    if controller is not None:
        _check_kind("stepsize_controller", controller, diffrax.AbstractStepSizeController, "diffrax.PIDController(...)")
        _check_controller(controller, ts)
    if adjoint is not None:
        _check_kind("adjoint", adjoint, diffrax.AbstractAdjoint, "diffrax.RecursiveCheckpointAdjoint()")


def _takes_one_term(solver: Any) -> bool:
    """Whether a solver integrates dy/dt = f(t, y, args) as it stands."""
    structure = solver.term_structure
    return inspect.isclass(structure) and issubclass(diffrax.ODETerm, structure)


def _check_kind(argument: str, value: Any, kind: type, example: str) -> None:
    if isinstance(value, kind):
        return
    if inspect.isclass(value) and issubclass(value, kind):
        raise SceneError(f"{argument} = {value.__name__} is a class; give an object, {value.__name__}(...)")
    raise SceneError(f"{argument} = {shown(value)} is none of diffrax's; give an object such as {example}")


def _check_controller(controller: Any, ts: Any) -> None:
    if isinstance(controller, diffrax.ConstantStepSize):
        raise SceneError(CONSTANT_STEPS)
    if not isinstance(controller, diffrax.StepTo) or not (is_concrete(controller.ts) and is_concrete(ts)):
        return
    own, times = np.asarray(controller.ts), np.asarray(ts)
    if own[0] != times[0] or own[-1] != times[-1]:
        raise SceneError(
            f"stepsize_controller = StepTo(ts=...) steps from {own[0]:.9g} s to {own[-1]:.9g} s, and the run goes from "
            f"{times[0]:.9g} s to {times[-1]:.9g} s; give it the same first and last time"
        )
    if np.any(np.diff(own) <= 0):
        raise SceneError("stepsize_controller = StepTo(ts=...) must have times that increase")
