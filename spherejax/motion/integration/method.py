"""How a run is integrated, once everything is decided: solver, step-size control, and how many steps at most."""

import math
from functools import lru_cache
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.model.system import Structure, System
from spherejax.motion.integration.audit import Limits, limits_of
from spherejax.motion.integration.implicit_rows import slack_of
from spherejax.motion.integration.plan import Plan
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import AtStart
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.start.tolerances import Tolerances, controller_for, tolerances_of


class RunMethod(eqx.Module):
    """How a run is integrated. What is static makes another program; arrays and numbers may be traced.

    Attributes:
        arrays: those of the solver.
        rest: the solver without them (static).
        tolerances: relative and absolute; of a step-size controller of the user's all of its arrays.
        control: that controller without them (static); None for that of this package.
        are_shared: whether all runs of a queue have the same tolerances (static).
        max_steps: largest number of steps.
        tangent_tolerance_factor: how much larger the errors of derivatives may be than the state's; None for what the
            method has.
        stiff_arrays: arrays of the solver of a run whose joints act faster than the limit when it starts.
        stiff_rest: that solver without them (static); None where there is no choice left.
        limit: a rate [1/s] (static).
    """

    arrays: Any
    rest: Any = eqx.field(static=True)
    tolerances: Any
    control: Any = eqx.field(static=True)
    are_shared: bool = eqx.field(static=True)
    max_steps: Any
    tangent_tolerance_factor: Any = None
    stiff_arrays: Any = None
    stiff_rest: Any = eqx.field(static=True, default=None)
    limit: float = eqx.field(static=True, default=math.inf)

    @classmethod
    def of(
        cls,
        structure: Structure,
        solver: diffrax.AbstractSolver,
        controller: Any,
        max_steps: Any,
        at_start: AtStart | None = None,
        tangent_tolerance_factor: Any = None,
    ) -> "RunMethod":
        """From diffrax objects: the controller is that of this package, `controller_for`, or one of the user's."""
        arrays, rest = eqx.partition(solver, eqx.is_array)
        controller, control = _numbers_apart(controller), None
        if _rest(controller) == _own_rest(structure):
            tolerances = controller.rtol, controller.atol
        else:
            tolerances, control = eqx.partition(controller, eqx.is_array)
        are_shared = all(is_concrete(each) for each in jax.tree.leaves(tolerances))
        steps = np.asarray(max_steps, np.int64) if is_concrete(max_steps) else max_steps
        method = cls(arrays, rest, tolerances, control, are_shared, steps, tangent_tolerance_factor)
        if at_start is None:
            return method
        stiff_arrays, stiff_rest = eqx.partition(at_start.solver, eqx.is_array)
        return method._replaced(stiff_arrays=stiff_arrays, stiff_rest=stiff_rest, limit=at_start.limit)

    @classmethod
    def by_tolerances(
        cls,
        structure: Structure,
        solver: diffrax.AbstractSolver,
        tolerances: Tolerances,
        rtol: Any,
        max_steps: Any,
        at_start: AtStart | None = None,
    ) -> "RunMethod":
        """That of this package's step-size control; `rtol` is what a root finder has to converge below."""
        controller = controller_for(structure, tolerances.rtol, tolerances.atol)
        return cls.of(structure, with_converging_root_finder(solver, rtol), controller, max_steps, at_start)

    @classmethod
    def of_settings(
        cls, system: System, structure: Structure, settings: RunSettings, at_start: AtStart | None = None
    ) -> "RunMethod":
        """That of settings whose solver is decided; `structure` may be that of the system with traced numbers."""
        tolerances = tolerances_of(system, settings.rtol, settings.atol)
        rtol, max_steps = settings.rtol, settings.max_steps
        return cls.by_tolerances(structure, settings.solver, tolerances, rtol, max_steps, at_start)

    def _replaced(self, **fields: Any) -> "RunMethod":
        return RunMethod(**{**vars(self), **fields})

    @property
    def solver(self) -> Any:
        """The solver, whole."""
        return eqx.combine(self.arrays, self.rest)

    def controller(self, structure: Structure) -> Any:
        """The step-size controller, whole."""
        if self.control is None:
            return controller_for(structure, *self.tolerances)
        return eqx.combine(self.tolerances, self.control)

    def with_solver(self, solver: Any) -> "RunMethod":
        """The same with another solver, and no choice left."""
        arrays, rest = eqx.partition(solver, eqx.is_array)
        return self._replaced(arrays=arrays, rest=rest, stiff_arrays=None, stiff_rest=None, limit=math.inf)

    @property
    def decided(self) -> "RunMethod":
        """The same with the usual solver alone."""
        return self if self.stiff_rest is None else self.with_solver(self.solver)

    @property
    def of_stiff(self) -> "RunMethod":
        """The same with the other solver."""
        return self.with_solver(eqx.combine(self.stiff_arrays, self.stiff_rest))

    def factor(self, structure: Structure) -> Any:
        """How much larger the errors of derivatives may be than the state's."""
        if self.tangent_tolerance_factor is None:
            return slack_of(self.rest, structure)
        return self.tangent_tolerance_factor

    @property
    def own_tolerances(self) -> Any:
        """Of a run whose tolerances are its own; None where all runs of a queue share them."""
        return None if self.are_shared else self.tolerances

    @property
    def shared(self) -> Any:
        """What all runs of a queue share: arrays of the solver, tolerances, and the largest number of steps."""
        return self.arrays, self.tolerances if self.are_shared else None, self.max_steps

    def limits(self, plan: Plan, theta: Any) -> Limits:
        """Of the audit."""
        if self.control is None:
            rtol, _ = self.tolerances
        else:
            rtol = getattr(eqx.combine(self.tolerances, self.control), "rtol", None)
        return audit_limits(plan.structure.system(theta), rtol, self.rest)


def audit_limits(system: System, rtol, solver: Any) -> Limits:
    """From where on a run is wrong; constant where it is differentiated."""
    return jax.lax.stop_gradient(jax.tree.map(jnp.asarray, limits_of(system, rtol, solver)))


@lru_cache(maxsize=64)
def _own_rest(structure: Structure) -> Any:
    return _rest(controller_for(structure, 1.0, 1.0))


def _rest(controller: Any) -> Any:
    """What there is to a controller besides tolerances."""
    if type(controller) is not diffrax.PIDController:
        return controller
    return tuple(value for name, value in vars(controller).items() if name not in ("rtol", "atol"))


def _numbers_apart(controller: Any) -> Any:
    """A controller whose tolerances and times are arrays: other ones need no other program."""
    numbers = [name for name in ("rtol", "atol") if isinstance(getattr(controller, name, None), int | float)]
    if type(controller) is diffrax.PIDController and numbers:
        values = [jnp.asarray(getattr(controller, name), jnp.float64) for name in numbers]
        controller = eqx.tree_at(lambda c: [getattr(c, name) for name in numbers], controller, values)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf, controller)
