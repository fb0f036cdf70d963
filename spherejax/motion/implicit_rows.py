"""A Rosenbrock method on a state and its sensitivities (`sensitivity_rows`), without second derivatives.

The Jacobian of all rows together is

    [ J              0 ]
    [ (dJ/dy) Y + ..., J ]

with second derivatives of the right-hand side below the diagonal. A W-method keeps its order with any matrix for the
Jacobian, and what is stiff lies on the diagonal: every row gets the matrix of the state alone, factorized once a step.
Methods whose order rests on the exact Jacobian (Rodas4P, Rodas5P) leave the sensitivities to Ros34PW2.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from spherejax.model.system import Structure
from spherejax.motion.implicit import with_structure
from spherejax.motion.programs import Program
from spherejax.motion.solvers.rosenbrock import AbstractRosenbrock, Ros34PW2, linearize_dense


def solver_of_rows(solver: Any, structure: Structure, rate: Program) -> Any:
    """The method that integrates the state and its sensitivities; an explicit one is the same."""
    if not isinstance(solver, AbstractRosenbrock):
        return solver
    own = _w_method(solver, structure)

    def jacobian(t, rows, args):
        matrix, by_time = _matrix_of_state(own, rate, t, rows[0], args.value)
        return (matrix, rows.shape), jnp.zeros(rows.shape).at[0].set(by_time).ravel()

    def factorize(matrix_and_shape, gamma_h):
        matrix, shape = matrix_and_shape
        solve, is_regular = own.factorize(matrix, gamma_h)
        return lambda rhs: jax.vmap(solve)(rhs.reshape(shape)).ravel(), is_regular

    return _with_hooks(own, jacobian, factorize)


def solver_with_fixed_matrix(solver: AbstractRosenbrock, structure: Structure, rate: Program) -> Any:
    """The same method on the state alone, differentiable as its rows are: with its matrix held fixed."""
    own = _w_method(solver, structure)

    def jacobian(t, y, args):
        return jax.lax.stop_gradient(_matrix_of_state(own, rate, t, y, args))

    def factorize(matrix, gamma_h):
        solve, is_regular = own.factorize(matrix, gamma_h)
        return _linear(solve), is_regular

    return _with_hooks(own, jacobian, factorize)


def _w_method(solver: AbstractRosenbrock, structure: Structure) -> Any:
    """The method, or Ros34PW2, with the system's own linear algebra."""
    return with_structure(solver if solver.tolerates_inexact_jacobian else Ros34PW2(), structure)


def _matrix_of_state(own: Any, rate: Program, t, y, args):
    if own.jacobian is not None:
        return own.jacobian(t, y, args)
    return linearize_dense(lambda t, y: rate.inside(args.theta, args.ahead, t, y), t, y, own.tangents_per_pass)


def _linear(solve):
    """A linear function whose derivative is itself: nothing is differentiated by what it is made of."""

    @jax.custom_jvp
    def linear(rhs):
        return solve(rhs)

    @linear.defjvp
    def linear_jvp(primals, tangents):
        return solve(*primals), solve(*tangents)

    return linear


def _with_hooks(solver: Any, jacobian, factorize) -> Any:
    hooks = (jacobian, factorize)
    return eqx.tree_at(lambda s: (s.jacobian, s.factorize), solver, hooks, is_leaf=lambda x: x is None)
