"""A Rosenbrock method on a mechanism: its linear systems in the mechanism's own structure."""

from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.solvers.linearization import freeze, pattern_of, residual_change, sizes_of, stage_solver
from spherejax.motion.solvers.low_rank import inexact_product, solve_inexact_stage
from spherejax.motion.solvers.rosenbrock import factorize_dense
from spherejax.motion.solvers.traits import is_linearly_implicit


class Linearization(NamedTuple):
    """What a step's linear systems are made of.

    Attributes:
        theta: numbers of the system.
        t: time [s].
        y: flat state.
        changes: derivatives of the residuals along the seeds of the pattern, shape (n_colors, n_rows).
    """

    theta: Float[Array, " p"]
    t: Scalar
    y: Float[Array, " size"]
    changes: Float[Array, "n_colors n_rows"]


def with_structure(solver: Any, structure: Structure) -> Any:
    """A Rosenbrock method with the system's own linear algebra; any other solver, or one with its own, unchanged."""
    if not is_linearly_implicit(solver):
        return solver
    if solver.jacobian is not None or solver.factorize is not factorize_dense:
        return solver
    hooks = inexact_hooks_of(structure) if solver.tolerates_inexact_jacobian else hooks_of(structure)
    if hooks is None:
        return solver
    return eqx.tree_at(lambda s: (s.jacobian, s.factorize), solver, hooks, is_leaf=lambda x: x is None)


@lru_cache(maxsize=64)
def hooks_of(structure: Structure):
    """The functions `jacobian` and `factorize` of a system for a Rosenbrock method; None on the array path."""
    layout, n_constraints = sizes_of(structure)
    n_v, n_x = layout.n_velocity, layout.size - layout.n_position
    n_rows = n_x + n_constraints
    frozen_at = program_for(freeze, structure)
    change = program_for(residual_change, structure, None, (layout.size, n_v, n_constraints, n_v + n_x))
    pattern = pattern_of(structure, change)
    if pattern is None:
        return None
    stage = program_for(
        stage_solver(pattern), structure, None, (layout.size, 1, pattern.n_colors * n_rows, layout.size), 5
    )
    rate = program_for(state_rate, structure)
    depends_on_time = rate.scalar is None or rate.scalar.reads(1)

    def jacobian(t, y, args):
        theta = args.theta
        by_time = jnp.zeros_like(y)
        if depends_on_time:
            by_time = jax.jvp(lambda t: rate(theta, t, y), (t,), (jnp.ones_like(t),))[1]
        # The matrix is not differentiated; `solution` below has the rule.
        here = jax.lax.stop_gradient((theta, t, y))
        frozen = frozen_at(*here)

        def along(seed):
            return change(*here[:2], (here[2], frozen.accelerations, frozen.multipliers, seed))

        return Linearization(theta, t, y, jax.vmap(along)(jnp.asarray(pattern.seeds))), by_time

    def eliminate(fixed, rhs):
        theta, factors, t, known = fixed
        return stage.inside(theta, factors, t, (*known, rhs))

    def multiply(theta, t, y, vector):
        return jax.jvp(lambda y: rate(theta, t, y), (y,), (vector,))[1]

    solution = _differentiable(multiply, eliminate)

    def factorize(at: Linearization, gamma_h: Scalar):
        theta, t, y, fixed_gamma_h = jax.lax.stop_gradient((at.theta, at.t, at.y, gamma_h))
        known = (y, fixed_gamma_h[None], at.changes.reshape(-1))
        fixed = (theta, stage.ahead(theta, t, known), t, known)

        def solve(rhs):
            return solution(fixed, (at.theta, at.t, at.y, gamma_h), rhs)

        return solve, jnp.array(True)

    return jacobian, factorize


@lru_cache(maxsize=64)
def inexact_hooks_of(structure: Structure):
    """The functions `jacobian` and `factorize` of a system for a W-method: the joint forces alone are implicit.

    A system with bristles, whose rate is as stiff as a joint force, gets the exact ones; None on the array path.
    """
    layout, _ = sizes_of(structure)
    rate = program_for(state_rate, structure)
    stage = program_for(solve_inexact_stage, structure, None, (layout.size, 1, layout.size), 4)
    product = program_for(inexact_product, structure, None, (layout.size, layout.size))
    if rate.scalar is None or stage.scalar is None or product.scalar is None:
        return hooks_of(structure)
    if np.any(rate.scalar.dependence(_STATE)[layout.memory_start : layout.work_start]):
        return hooks_of(structure)

    def jacobian(t, y, args):
        return (args.theta, t, y), jnp.zeros_like(y)

    def multiply(theta, t, y, vector):
        return product(theta, t, (y, vector))

    def eliminate(fixed, rhs):
        theta, factors, t, known = fixed
        return stage.inside(theta, factors, t, (*known, rhs))

    solution = _differentiable(multiply, eliminate)

    def factorize(at, gamma_h: Scalar):
        theta, t, y, fixed_gamma_h = jax.lax.stop_gradient((*at, gamma_h))
        known = (y, fixed_gamma_h[None])
        fixed = (theta, stage.ahead(theta, t, known), t, known)

        def solve(rhs):
            return solution(fixed, (*at, gamma_h), rhs)

        return solve, jnp.array(True)

    return jacobian, factorize


_STATE = 2
"""Leaf of the arguments (theta, t, y) that is the state."""


def _differentiable(multiply, eliminate):
    """The function (fixed, (theta, t, y, gamma_h), rhs) -> k with (I - gamma h J) k = rhs, with a derivative rule.

    dk = (I - gamma h J)^-1 (d rhs + d(gamma h) J k + gamma h dJ k), with the same elimination: nothing is
    differentiated through it.

    Args:
        multiply: (theta, t, y, k) -> J k, for the J that `eliminate` solves with.
        eliminate: (fixed, rhs) -> k.
    """

    @jax.custom_jvp
    def solution(fixed, at, rhs):
        del at
        return eliminate(fixed, rhs)

    @solution.defjvp
    def solution_jvp(primals, tangents):
        fixed, (theta, t, y, gamma_h), rhs = primals
        _, (theta_dot, t_dot, y_dot, gamma_h_dot), rhs_dot = tangents
        k = eliminate(fixed, rhs)

        def along_k(theta, t, y):
            return multiply(theta, t, y, k)

        slope, bend = jax.jvp(along_k, (theta, t, y), (theta_dot, t_dot, y_dot))
        return k, eliminate(fixed, rhs_dot + gamma_h_dot * slope + gamma_h * bend)

    return solution
