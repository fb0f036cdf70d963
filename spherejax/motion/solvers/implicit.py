"""A Rosenbrock method on a mechanism: its linear systems in the mechanism's own structure."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import compress
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from spherejax.compiler.runge_kutta import RosenbrockSystems, Tableau
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import Program, program_for
from spherejax.motion.solvers.linearization import freeze, pattern_of, residual_change, sizes_of, stage_solver
from spherejax.motion.solvers.low_rank import inexact_product, solve_inexact_stage
from spherejax.motion.solvers.rosenbrock import SolveOfStages, factorize_dense
from spherejax.motion.solvers.traits import is_linearly_implicit


class StepLinearization(NamedTuple):
    """Where a step's linear systems are those of.

    Attributes:
        theta: numbers of the system.
        t: time [s].
        y: flat state.
        ahead: what the right-hand side has evaluated ahead of the integration.
    """

    theta: Float[Array, " p"]
    t: Scalar
    y: Float[Array, " size"]
    ahead: Any


def with_structure(solver: Any, structure: Structure) -> Any:
    """A Rosenbrock method with the system's own linear algebra; any other solver, or one with its own, unchanged."""
    systems = systems_for(solver, structure)
    if systems is None:
        return solver
    hooks = systems.jacobian, systems.factorize
    return eqx.tree_at(lambda s: (s.jacobian, s.factorize), solver, hooks, is_leaf=lambda x: x is None)


def systems_for(solver: Any, structure: Structure) -> "LinearSystems | None":
    """Those of a Rosenbrock method that has none of its own; None for other methods, and for array code."""
    if not is_linearly_implicit(solver) or solver.jacobian is not None or solver.factorize is not factorize_dense:
        return None
    return inexact_systems_of(structure) if solver.tolerates_inexact_jacobian else systems_of(structure)


@dataclass(frozen=True, eq=False)
class LinearSystems:
    """The linear systems (I - gamma h J) k = rhs of a system: what a Rosenbrock method calls, and their derivatives.

    Attributes:
        rate: the right-hand side.
        stage: what solves one of them, (theta, t, (y, gamma h, *known, rhs)) -> k.
        by_time: (theta, t, y) -> df/dt; None where it is zero, or left out.
        known_at: (theta, t, y) -> known.
        product_at: linearization -> a line, the place of one of its arguments, and all of them: J k is the derivative
            of what the line gives by that argument, along k.
        called: the same as parts of one call of machine code, where that can be.
    """

    rate: Program
    stage: Program
    by_time: Callable[..., Float[Array, " size"]] | None
    known_at: Callable[..., tuple[Array, ...]]
    product_at: Callable[[StepLinearization], tuple[Any, int, tuple[Array, ...]]]
    called: RosenbrockSystems

    def jacobian(self, t, y, args) -> tuple[StepLinearization, Float[Array, " size"]]:
        """Where the systems are those of, and df/dt there."""
        # Most mechanisms do not know the time: its derivative is not evaluated then.
        slope = jnp.zeros_like(y) if self.by_time is None else self.by_time(args.theta, t, y)
        return StepLinearization(args.theta, t, y, args.ahead), slope

    def factorize(self, at: StepLinearization, gamma_h: Scalar):
        """The solver of the systems, and that they can be solved."""
        # Machine code makes all stages in one call, where the program has become machine code; elsewhere each stage is
        # a call of the elimination.
        step = self.called.step(self.rate.scalar, at.ahead, at.y.shape[0])
        if step is None:
            return self._solver(at, gamma_h, None), jnp.array(True)
        at_once = partial(self._all_stages, step, at, gamma_h)
        return SolveOfStages(lambda: self._solver(at, gamma_h, None), at_once), jnp.array(True)

    def factorize_differentiated(self, at: StepLinearization, gamma_h: Scalar):
        """As `factorize`, for steps that are differentiated and not evaluated alone.

        What the derivatives of all stages share is evaluated once: half of the time.
        """
        return self._solver(at, gamma_h, self._coefficients(at)), jnp.array(True)

    def _product(self, at: StepLinearization) -> tuple[Any, Any, tuple[Array, ...]]:
        line, place, arguments = self.product_at(at)
        return line, line.derivative(tuple(i == place for i in range(len(arguments)))), arguments

    def _coefficients(self, at: StepLinearization) -> list[Array]:
        """What J k is linear in k with."""
        # The line's own outputs come first; behind them are its partial derivatives at this point.
        line, derivative, arguments = self._product(at)
        return derivative.values(*arguments)[len(line.outputs) :]

    def _solver(self, at: StepLinearization, gamma_h: Scalar, coefficients: list[Array] | None):
        """The solver rhs -> k, with a derivative rule that never enters the elimination.

        dk = (I - gamma h J)^-1 (d rhs + d(gamma h) J k + gamma h dJ k).
        """
        # The matrix itself is not differentiated: the rule below says what follows from its change.
        theta, t, y, fixed = jax.lax.stop_gradient((at.theta, at.t, at.y, gamma_h))
        known = (y, fixed[None], *self.known_at(theta, t, y))
        # The elimination's pivots and multipliers, once for all stages of the step: they do not depend on rhs.
        factors = self.stage.ahead(theta, t, known)

        # Forward and backward substitution.
        def eliminate(given, rhs):
            theta, factors, t, known = given
            return self.stage.inside(theta, factors, t, (*known, rhs))

        def multiply(coefficients, at: StepLinearization, k):
            given = self._coefficients(at) if coefficients is None else coefficients
            return self._product(at)[1].slopes(k, *given)[0]

        @jax.custom_jvp
        def solution(given, coefficients, at: StepLinearization, gamma_h, rhs):
            del coefficients, at, gamma_h
            return eliminate(given, rhs)

        @solution.defjvp
        def solution_jvp(primals, tangents):
            given, coefficients, at, gamma_h, rhs = primals
            _, coefficients_dot, at_dot, gamma_h_dot, rhs_dot = tangents
            k = eliminate(given, rhs)
            along = partial(multiply, k=k)
            # J k, and what of it changes with the point at which J is taken.
            slope, bend = jax.jvp(along, (coefficients, at), (coefficients_dot, at_dot))
            # The same factors solve for the derivative: the system's matrix is the same.
            return k, eliminate(given, rhs_dot + gamma_h_dot * slope + gamma_h * bend)

        return lambda rhs: solution((theta, factors, t, known), coefficients, at, gamma_h, rhs)

    def _all_stages(self, step: Any, at: StepLinearization, gamma_h, tableau, *start):
        """What `Tableau.stages` returns by one call of machine code; its derivative is that of the loop."""

        @jax.custom_jvp
        def at_once(at: StepLinearization, gamma_h, start):
            return step(tableau, at.theta, at.ahead, gamma_h, start)

        def in_turn(at: StepLinearization, gamma_h, start):
            def of_state(t, y):
                return self.rate.inside(at.theta, at.ahead, t, y)

            *start, slope = start
            coefficients, solve = Tableau.rosenbrock(tableau), self._solver(at, gamma_h, None)
            return coefficients.stages(of_state, *start, solve=solve, slope=slope)

        @partial(at_once.defjvp, symbolic_zeros=True)
        def _(primals, tangents):
            leaves, tree = jax.tree.flatten(primals)
            along = jax.tree.leaves(tangents, is_leaf=lambda x: isinstance(x, SymbolicZero))
            # What does not move is left out: its derivative would be compiled and be zero.
            moves = [not isinstance(tangent, SymbolicZero) for tangent in along]

            def of_moving(*numbers):
                moved = iter(numbers)
                every = [next(moved) if is_moving else x for x, is_moving in zip(leaves, moves, strict=True)]
                return in_turn(*jax.tree.unflatten(tree, every))

            return jax.jvp(of_moving, [*compress(leaves, moves)], [*compress(along, moves)])

        return at_once(at, gamma_h, start)

    def stages_of_rows(self, tableau, t0, h, rows, value, slopes, by: tuple[int, ...] | None = None):
        """All stages of the state and of its sensitivities, by one call of machine code; None where there is none.

        Args:
            tableau: of the method.
            t0, h: start and length of the step [s].
            rows: the state, its sensitivities below.
            value, slopes: what the right-hand side is given (theta, ahead), and its derivatives.
            by: entries of theta that these are by; None for all.
        """
        step = self.called.step(self.rate.scalar, value.ahead, rows.shape[1], slopes, by)
        if step is None:
            return None
        # The rows' share of df/dt is its derivative by the numbers and by the state, along each row.
        slope = jnp.zeros_like(rows)
        if self.by_time is not None:
            by_time = self.by_time

            def along(theta_dot, y_dot):
                return jax.jvp(lambda theta, y: by_time(theta, t0, y), (value.theta, rows[0]), (theta_dot, y_dot))

            first, others = jax.vmap(along, out_axes=(None, 0))(slopes.theta, rows[1:])
            slope = h * h * jnp.concatenate([first[None], others])
        return step(tableau, value.theta, value.ahead, tableau.gamma * h, (t0, h, h, rows, slope), slopes)


@lru_cache(maxsize=64)
def systems_of(structure: Structure) -> LinearSystems | None:
    """The linear systems with the exact matrix; None on the array path."""
    layout, n_constraints = sizes_of(structure)
    n_v, n_x = layout.n_velocity, layout.size - layout.n_position
    frozen_at = program_for(freeze, structure)
    change = program_for(residual_change, structure, None, (layout.size, n_v, n_constraints, n_v + n_x))
    # Which entries of the matrix can be other than zero is read off the program: the elimination is made for these.
    pattern = pattern_of(structure, change)
    rate = program_for(state_rate, structure)
    if pattern is None or rate.scalar is None:
        return None
    n_changes = pattern.n_colors * (n_x + n_constraints)
    stage = program_for(stage_solver(pattern), structure, None, (layout.size, 1, n_changes, layout.size), 5)
    scalar = rate.scalar

    def by_time(theta, t, y):
        # One direction, in forward mode: it costs about as much as the rate.
        return jax.jvp(lambda t: rate(theta, t, y), (t,), (jnp.ones_like(t),))[1]

    def known_at(theta, t, y):
        frozen = frozen_at(theta, t, y)

        # Columns that share no row are evaluated together: `seeds` has one vector for each color.
        def along(seed):
            return change(theta, t, (y, frozen.accelerations, frozen.multipliers, seed))

        return (jax.vmap(along, out_axes=-1)(jnp.asarray(pattern.seeds)).reshape(-1),)

    def product_at(at: StepLinearization):
        line, ahead = scalar.line_inside(at.ahead)
        return line, _STATE, (at.theta, at.t, at.y, *ahead)

    called = RosenbrockSystems.exact(stage.scalar, frozen_at.scalar, change.scalar, pattern.seeds)
    return LinearSystems(rate, stage, by_time if scalar.reads(1) else None, known_at, product_at, called)


@lru_cache(maxsize=64)
def inexact_systems_of(structure: Structure) -> LinearSystems | None:
    """The linear systems of a W-method: the joint forces alone are implicit.

    A system with bristles, whose rate is as stiff as a joint force, gets the exact ones; None on the array path.
    """
    layout, _ = sizes_of(structure)
    rate = program_for(state_rate, structure)
    stage = program_for(solve_inexact_stage, structure, None, (layout.size, 1, layout.size), 4)
    product = program_for(inexact_product, structure, None, (layout.size, layout.size))
    if rate.scalar is None or stage.scalar is None or product.scalar is None:
        return systems_of(structure)
    multiplied = product.scalar
    # Memories whose rates follow the state, such as bristles, are as stiff as the joint's force.
    if np.any(rate.scalar.dependence(_STATE)[layout.memory_start : layout.work_start]):
        return systems_of(structure)

    def product_at(at: StepLinearization):
        return multiplied.line_called(), _VECTOR, (at.theta, at.t, at.y, jnp.zeros_like(at.y))

    called = RosenbrockSystems.inexact(stage.scalar, product.scalar)
    return LinearSystems(rate, stage, None, lambda theta, t, y: (), product_at, called)


_STATE = 2
"""Leaf of the arguments (theta, t, y) that is the state."""

_VECTOR = 3
"""Leaf of the arguments (theta, t, (y, vector)) of a product that is the vector."""
