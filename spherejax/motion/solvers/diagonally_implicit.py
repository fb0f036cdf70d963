"""Diagonally implicit Runge-Kutta methods of diffrax (Kvaerno3, 4 and 5, `ImplicitEuler`) on a mechanism.

A stage i solves for its increment

    k_i = h f(t + c_i h, y + sum_j<i a_ij k_j + gamma k_i)

by a chord iteration k := k + (I - gamma h J)^-1 (h f - k), with J at the start of the step: one factorization a step,
in the structure of the mechanism, as the Rosenbrock methods have it (`solvers.implicit`). diffrax's own iteration makes
the Jacobian by differentiating f along every entry of the state and eliminates a full matrix.

Rows of sensitivities below a state are integrated as they stand. The Jacobian of all rows together has J on its
diagonal and second derivatives of f below it, in the first column only; with J for each row the iteration still
converges, for those entries only carry on what the first row has not yet settled.

Source: Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.8 (the iteration, and when it ends).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.forms import is_numeric
from spherejax.foundations.types import Flag, Scalar
from spherejax.model.system import Structure
from spherejax.motion.equations.programs import Program
from spherejax.motion.solvers.implicit import LinearSystems, systems_of
from spherejax.motion.solvers.rosenbrock import factorize_dense, linearize_dense, solve_one_by_one

SETTLED = 0.02
"""The iteration ends where what it would still change is this share of the tolerance of a step. What is left counts as
error of the step."""

AT_ONCE = 1e-3 * SETTLED
"""A first change of less than this ends it: no rate of convergence is known yet."""

WITHOUT_TOLERANCE = 1e-9
"""Relative and absolute tolerance of the iteration where a controller has none, as `diffrax.StepTo`."""

TANGENTS_PER_PASS = 64
"""Columns of the Jacobian that array code evaluates at once."""


class ImplicitTableau(NamedTuple):
    """Coefficients of a diagonally implicit method whose implicit stages share one gamma.

    Attributes:
        gamma: of all implicit stages.
        lower: a_ij for j < i, shape (s, s).
        instants: c_i, shape (s,).
        predictor: weights of the stages before for the first guess of k_i, shape (s, s).
        weights, error_weights: of the step's end and of its error, shape (s,).
        first_is_explicit: whether the first stage is h f at the start.
    """

    gamma: float
    lower: Float[np.ndarray, "s s"]
    instants: Float[np.ndarray, " s"]
    predictor: Float[np.ndarray, "s s"]
    weights: Float[np.ndarray, " s"]
    error_weights: Float[np.ndarray, " s"]
    first_is_explicit: bool


# Backward Euler's step, with the increment at its start for the estimate of the error, as diffrax has it.
_IMPLICIT_EULER = ImplicitTableau(
    1.0,
    np.zeros((2, 2)),
    np.array([0.0, 1.0]),
    np.array([[0.0, 0.0], [1.0, 0.0]]),
    np.array([0.0, 1.0]),
    np.array([-0.5, 0.5]),
    True,
)


def tableau_of(solver: Any) -> ImplicitTableau | None:
    """The coefficients of a method that can be stepped so; None for others, and where the user gave a root finder."""
    if not has_default_root_finder(solver):
        return None
    if type(solver) is diffrax.ImplicitEuler:
        return _IMPLICIT_EULER
    return _coefficients(type(solver)) if isinstance(solver, diffrax.AbstractRungeKutta) else None


def has_default_root_finder(solver: Any) -> bool:
    """Whether an implicit method has diffrax's own root finder, with tolerances that stand for the controller's."""
    finder: Any = getattr(solver, "root_finder", None) if isinstance(solver, diffrax.AbstractImplicitSolver) else None
    return finder is not None and hasattr(finder, "rtol") and not is_numeric(finder.rtol)


@lru_cache(maxsize=16)
def _coefficients(method: Any) -> ImplicitTableau | None:
    tableau: Any = getattr(method, "tableau", None)
    diagonal: Any = getattr(tableau, "a_diagonal", None)
    if not isinstance(tableau, diffrax.ButcherTableau) or diagonal is None:
        return None
    # Stages with other factors would each need a factorization of their own.
    if len({*diagonal[1:]} | ({diagonal[0]} - {0.0})) > 1:
        return None
    n = len(tableau.b_sol)

    def below(rows: Any) -> np.ndarray:
        matrix = np.zeros((n, n))
        for i, row in enumerate(rows, start=1):
            matrix[i, :i] = row
        return matrix

    # The first stage of most methods is h f at the start, and needs no solve.
    is_explicit = diagonal[0] == 0
    instants = np.concatenate([[0.0 if tableau.c1 is None else tableau.c1], tableau.c])
    weights, errors = np.asarray(tableau.b_sol), np.asarray(tableau.b_error)
    return ImplicitTableau(
        float(diagonal[-1]), below(tableau.a_lower), instants, below(tableau.a_predictor), weights, errors, is_explicit
    )


def with_structured_stages(solver: Any, structure: Structure, rate: Program, tolerances: Callable) -> Any:
    """A diagonally implicit method of diffrax, alone or in a `HalfSolver`, with the system's own linear algebra.

    Any other solver is returned as it is.

    Args:
        solver: a diffrax solver.
        structure: of the system.
        rate: right-hand side of the state.
        tolerances: of a step, a function of what the right-hand side is given -> (relative, absolute), or None where a
            controller has none.
    """
    if type(solver) is diffrax.HalfSolver:
        # Its three steps are those of the method within it.
        inner = with_structured_stages(solver.solver, structure, rate, tolerances)
        return eqx.tree_at(lambda half: half.solver, solver, inner)
    if tableau_of(solver) is None:
        return solver
    # Array code has no elimination of its own; dense matrices serve it.
    systems = systems_of(structure) if rate.scalar is not None else None
    return DiagonallyImplicit(solver, rate, systems, tolerances)


class DiagonallyImplicit(diffrax.AbstractAdaptiveSolver):
    """A diagonally implicit Runge-Kutta method on the state of a mechanism, or on that and rows of sensitivities.

    Attributes:
        own: the method of diffrax.
        rate: right-hand side of the state (static).
        systems: its linear algebra (static); None where array code has none of its own.
        tolerances: see `with_structured_stages` (static).
    """

    own: Any
    rate: Program = eqx.field(static=True)
    systems: LinearSystems | None = eqx.field(static=True)
    tolerances: Callable = eqx.field(static=True)

    term_structure: ClassVar = diffrax.ODETerm

    @property
    def interpolation_cls(self):
        """The method's."""
        return self.own.interpolation_cls

    def order(self, terms):
        """The method's."""
        return self.own.order(terms)

    def error_order(self, terms):
        """The method's."""
        return self.own.error_order(terms)

    def init(self, terms, t0, t1, y0, args) -> None:
        """Nothing is carried on: the rate at the end of a step is not that behind its correction and its events."""

    def func(self, terms, t0, y0, args) -> Any:
        """The right-hand side at one point."""
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump) -> Any:
        """The state at `t1`, its error estimate (infinite where an iteration failed), and what dense output needs."""
        del solver_state, made_jump
        tableau: Any = tableau_of(self.own)
        t0, h = jnp.asarray(t0), jnp.asarray(t1) - t0
        # A chord iteration: the matrix at the start of the step serves all stages and all turns.
        solve, is_regular = self._linear_solver(t0, y0, tableau.gamma * h, args)
        scale = self._scale(y0, args)
        lower, predictor, instants = map(jnp.asarray, (tableau.lower, tableau.predictor, tableau.instants))
        first = h * terms.vf(t0, y0, args)

        def stage(i, found):
            k, is_sound = found
            # The later rows of k are still zero, and so are their coefficients.
            base = y0 + jnp.tensordot(lower[i], k, 1)
            # The method's own predictor, from the stages before.
            guess = jnp.where(i == 0, first, jnp.tensordot(predictor[i], k, 1))

            def remainder(increment):
                return h * terms.vf(t0 + instants[i] * h, base + tableau.gamma * increment, args) - increment

            increment, has_settled = self._settled(remainder, solve, guess, scale / tableau.gamma)
            return k.at[i].set(increment), is_sound & has_settled

        k = jnp.zeros((len(tableau.weights), *y0.shape)).at[0].set(first)
        begin = 1 if tableau.first_is_explicit else 0
        k, is_sound = jax.lax.fori_loop(begin, len(tableau.weights), stage, (k, is_regular))
        y1 = y0 + jnp.tensordot(tableau.weights, k, 1)
        # A stage that was not found makes the step's error infinite: it is made again, shorter.
        error = jnp.where(is_sound, jnp.tensordot(tableau.error_weights, k, 1), jnp.inf)
        results: Any = diffrax.RESULTS
        result = results.where(is_sound, results.successful, results.nonlinear_divergence)
        dense = dict(y0=y0, y1=y1) if tableau is _IMPLICIT_EULER else dict(y0=y0, y1=y1, k=k)
        return y1, error, dense, None, result

    def _linear_solver(self, t0: Scalar, y0: Array, gamma_h: Scalar, args) -> tuple[Callable, Flag]:
        """The solver of (I - gamma h J) x = rhs for all rows, and whether the matrix is regular."""
        state = y0 if y0.ndim == 1 else y0[0]
        if self.systems is None:

            def of_state(t, y):
                return self.rate.inside(args.theta, args.ahead, t, y)

            # Of the state alone: the rows' equations have the same matrix in their diagonal blocks.
            jacobian, _ = linearize_dense(of_state, t0, state, TANGENTS_PER_PASS)
            solve, is_regular = factorize_dense(jacobian, gamma_h)
        else:
            found, is_regular = self.systems.factorize(self.systems.jacobian(t0, state, args)[0], gamma_h)
            solve = solve_one_by_one(found)
        return (solve if y0.ndim == 1 else jax.vmap(solve)), is_regular

    def _scale(self, y0: Array, args) -> Array:
        """What a change of the state may be before it counts."""
        given = self.tolerances(args)
        relative, absolute = (WITHOUT_TOLERANCE,) * 2 if given is None else given
        return absolute + relative * jnp.abs(y0)

    def _settled(self, remainder: Callable, solve: Callable, guess: Array, scale: Array) -> tuple[Array, Flag]:
        """The increment of a stage, and whether the iteration came to an end."""
        most = self.own.root_find_max_steps or 10

        def goes_on(found):
            _, _, n, is_done, is_lost = found
            return ~is_done & ~is_lost & (n < most)

        def changed(found):
            increment, before, n, _, _ = found
            # A Newton step with the matrix of the start of the step.
            change = solve(remainder(increment))
            size = jnp.max(jnp.abs(change) / scale)
            rate = jnp.where(n == 0, 0.0, size / jnp.where(before > 0, before, 1.0))
            # What is left of a geometric series of changes.
            ahead = size * rate / jnp.where(rate < 1, 1 - rate, 1.0)
            is_done = jnp.where(n == 0, size <= AT_ONCE, (rate < 1) & (ahead <= SETTLED) | (size <= AT_ONCE))
            # Changes that double will not settle in the few turns that there are.
            is_lost = ~jnp.isfinite(size) | (rate > 2)
            return increment + change, size, n + 1, is_done, is_lost

        no = jnp.array(False)
        increment, _, _, is_done, _ = jax.lax.while_loop(goes_on, changed, (guess, jnp.array(1.0), 0, no, no))
        return increment, is_done
