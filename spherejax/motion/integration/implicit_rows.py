"""A Rosenbrock method on a state and its sensitivities (`sensitivity_rows`): the derivative of each of its steps.

The Jacobian of all rows together is

    [ J              0 ]
    [ (dJ/dy) Y + ..., J ]

with second derivatives of the right-hand side below the diagonal. To differentiate the step is to solve with this
matrix: the method keeps its order for the sensitivities too, and they follow the steps that the state asks for. With
the blocks below the diagonal left out, which a W-method bears, the sensitivities of a film needed thirty times the
motion's steps, or were wrong by 6 to 20 percent on the motion's own (`benchmarks/film_gradient.py`).

For second derivatives the matrix is held fixed.
"""

from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from spherejax.model.system import Structure
from spherejax.motion.equations.contacts import kinks_of, may_have_abrupt_contacts
from spherejax.motion.equations.programs import Program
from spherejax.motion.solvers.implicit import LinearSystems, systems_for, with_structure
from spherejax.motion.solvers.rosenbrock import (
    AbstractRosenbrock,
    Ros34PW2,
    RosenbrockInterpolation,
    linearize_dense,
    solve_one_by_one,
    step_from,
)
from spherejax.motion.solvers.traits import is_linearly_implicit


class DifferentiatedRosenbrock(diffrax.AbstractAdaptiveSolver):
    """A Rosenbrock method whose step moves the state in the first row, and the step's derivatives in those below.

    Attributes:
        own: the method on the state alone, with the system's linear algebra.
        rate: right-hand side of the state (static).
        systems: that linear algebra (static); None where it has none of its own.
        by: numbers of the system that the sensitivities are by (static); None for all.
    """

    own: AbstractRosenbrock
    rate: Program = eqx.field(static=True)
    systems: LinearSystems | None = eqx.field(static=True)
    by: tuple[int, ...] | None = eqx.field(static=True, default=None)

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar = RosenbrockInterpolation

    def order(self, terms) -> int:
        """That of the method."""
        return self.own.order(terms)

    def init(self, terms, t0, t1, y0, args) -> None:
        """A one-step method remembers nothing."""

    def func(self, terms, t0, y0, args) -> Any:
        """The right-hand side of the state, zeros below: by it the first step is chosen, and by nothing else."""
        of_state = self.rate.inside(args.value.theta, args.value.ahead, t0, y0[0])
        return jnp.concatenate([of_state[None], jnp.zeros_like(y0[1:])])

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        """All rows at `t1`, their error estimates, and what the dense output needs."""
        del terms, solver_state
        t0, t1 = jnp.asarray(t0), jnp.asarray(t1)
        if self.systems is not None:
            tableau = self.own.tableau
            stages = self.systems.stages_of_rows(tableau, t0, t1 - t0, y0, args.value, args.slopes, self.by)
            if stages is not None:
                return (*step_from(tableau, stages, y0, jnp.array(True)), None, diffrax.RESULTS.successful)
        term = diffrax.ODETerm(lambda t, y, numbers: self.rate.inside(numbers.theta, numbers.ahead, t, y))

        def of_state(numbers, y):
            y1, error, dense, _, _ = self.own.step(term, t0, t1, y, numbers, None, jnp.asarray(made_jump))
            return y1, error, dense["bends"]

        def along(tangents):
            return eqx.filter_jvp(of_state, (args.value, y0[0]), tangents)

        value, slopes = eqx.filter_vmap(along, out_axes=(None, 0))((args.slopes, y0[1:]))
        y1, error, bends = jax.tree.map(lambda x, dx: jnp.concatenate([x[None], dx]), value, slopes)
        return y1, error, dict(y0=y0, y1=y1, bends=bends), None, diffrax.RESULTS.successful


SLACK = 1e3
"""How much larger than the state's the errors of sensitivities by a Rosenbrock method may be before a step is repeated.

Their error estimate is that of a step of low order, and much larger than their error: with 1e3 the lubricated four-bar
makes the motion's own steps, and its derivatives are right to 2e-4 at an rtol of 1e-8, to 1e-6 at 1e-10. Judged as the
state, they cost 180 values and were right to 2e-4 as well."""


EXPLICIT_SLACK = 2.0
"""Errors of sensitivities may be this many times those of the state, each in units of their own size.

Through thirty onsets on the four-bar, at an rtol of 1e-8, gradients are good to 1e-7 with 2, 1e-6 with 20, 3e-6 with
100 and 1,000, and 4e-3 if nobody looks at them; steps are 1.9, 1.4, 1.2, 1.03 and 1 times the plain run's
(`benchmarks/sensitivity_tolerance.py`; a bushing needs the 2). But a
ball that bounces ten times in its socket multiplies errors: there 2 gives 1e-6, 5 gives 3e-6, and at an rtol of 1e-6
50 gives a derivative that is wrong by a tenth."""


INEXACT_SLACK_THROUGH_KINKS = 0.02
"""The same for W-methods through stops and contacts whose stiffness is there at once.

Their order is low, and their error is what they estimate: with 2 derivatives of a ball of 1 kg between stops of 1e6,
1e8 and 1e10 N/m are right to 5e-7, 4e-6 and 6e-5, with 0.02 to 7e-9, 6e-7 and what rounding leaves."""


SLACK_THROUGH_KINKS = 0.1
"""The same for Rosenbrock methods with an exact Jacobian.

Derivatives of a ball of 1 kg through one linear contact of 1e7 N/m with hysteresis are wrong by 5e-6 with 2, 7e-7 with
0.2 and 4e-7 with 0.1, those through a second stop behind the first by 4e-6, 7e-9 and 3e-9; 0.1 takes a fourth more
steps than 2."""


def usual_tangent_factor(solver: Any, structure: Structure) -> float:
    """How much larger the errors of sensitivities may be than the state's, where nobody says.

    Through stops and contacts whose stiffness K is there at once much less than elsewhere: within them the
    sensitivities of velocities are sqrt(K/m) times as large as outside, and what errors are judged by is so, too. With
    `SLACK` a ball of 1 kg that bounces between stops of 1e8 N/m had derivatives that were wrong by 3e-4. Through
    contacts that stiffen abruptly (`stiffens_abruptly`) shorter steps of Rosenbrock methods do not help: with an
    exponent of 1.05 errors grew from 1e-5 to 1e-4, or the steps shrank to nothing.

    Args:
        solver: the method.
        structure: of the system.
    """
    if not is_linearly_implicit(solver):
        return EXPLICIT_SLACK
    if not kinks_of(structure):
        return SLACK
    if solver.tolerates_inexact_jacobian:
        return INEXACT_SLACK_THROUGH_KINKS
    return EXPLICIT_SLACK if may_have_abrupt_contacts(structure) else SLACK_THROUGH_KINKS


def solver_of_rows(solver: Any, structure: Structure, rate: Program, by: tuple[int, ...] | None = None) -> Any:
    """The method that integrates the state and its sensitivities by some numbers; an explicit one is the same."""
    if not is_linearly_implicit(solver):
        return solver
    return DifferentiatedRosenbrock(differentiable_solver(solver, structure), rate, systems_for(solver, structure), by)


def differentiable_solver(solver: AbstractRosenbrock, structure: Structure) -> Any:
    """A Rosenbrock method on the state alone whose steps are differentiated, with the system's own linear algebra."""
    systems = systems_for(solver, structure)
    if systems is None:
        return solver
    return _with_hooks(solver, systems.jacobian, systems.factorize_differentiated)


def rows_with_fixed_matrix(solver: Any, structure: Structure, rate: Program) -> Any:
    """The method for the state and its sensitivities with the state's matrix for all; an explicit one is the same.

    For runs whose steps are differentiated once more, with that matrix held fixed: their errors are judged as the
    state's, which such a matrix needs.
    """
    if not is_linearly_implicit(solver):
        return solver
    own = _w_method(solver, structure)

    def jacobian(t, rows, args):
        matrix, by_time = _matrix_of_state(own, rate, t, rows[0], args.value)
        return (matrix, rows.shape), jnp.zeros(rows.shape).at[0].set(by_time).ravel()

    def factorize(matrix_and_shape, gamma_h):
        matrix, shape = matrix_and_shape
        solve, is_regular = own.factorize(matrix, gamma_h)
        solve = solve_one_by_one(solve)
        return lambda rhs: jax.vmap(solve)(rhs.reshape(shape)).ravel(), is_regular

    return _with_hooks(own, jacobian, factorize)


def _w_method(solver: AbstractRosenbrock, structure: Structure) -> Any:
    """The method, or Ros34PW2, with the system's own linear algebra."""
    return with_structure(solver if solver.tolerates_inexact_jacobian else Ros34PW2(), structure)


def _matrix_of_state(own: Any, rate: Program, t, y, args):
    if own.jacobian is not None:
        return own.jacobian(t, y, args)
    return linearize_dense(lambda t, y: rate.inside(args.theta, args.ahead, t, y), t, y, own.tangents_per_pass)


def _with_hooks(solver: Any, jacobian, factorize) -> Any:
    hooks = (jacobian, factorize)
    return eqx.tree_at(lambda s: (s.jacobian, s.factorize), solver, hooks, is_leaf=lambda x: x is None)
