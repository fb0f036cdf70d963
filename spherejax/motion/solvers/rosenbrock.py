"""Rosenbrock methods for stiff equations, as diffrax solvers: `Rodas4P`, `Rodas5P` and `Ros34PW2`.

They are linearly implicit: a step costs one Jacobian, one factorization and s - 1 evaluations of the vector
field, and has no iteration that could fail to converge. The equations, letters and sources are in
`rosenbrock_tableaus`.

The order of Rodas4P and Rodas5P rests on the exact Jacobian: one that is merely close lowers it. Ros34PW2 keeps its
order with any.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from diffrax import RESULTS, AbstractAdaptiveSolver, AbstractLocalInterpolation, ODETerm
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, PyTree

from spherejax.compiler.runge_kutta import Tableau, combined
from spherejax.foundations.types import Flag, Scalar
from spherejax.motion.solvers.dense_lu import dense_solver
from spherejax.motion.solvers.rosenbrock_tableaus import RODAS4P, RODAS5P, ROS34PW2, RosenbrockTableau

Vector = Float[Array, " n"]
LinearSolve = Callable[[Vector], Vector]


class SolveOfStages(NamedTuple):
    """The linear systems of a step whose stages can be made all at once.

    Attributes:
        one_by_one: () -> the solver of (I - gamma h J) x = rhs.
        all_stages: (tableau, t0, dt, h, y, slope) -> the increments of all stages, as `Tableau.stages` returns them.
    """

    one_by_one: Callable[[], LinearSolve]
    all_stages: Callable[..., Float[Array, "s n"]]


def solve_one_by_one(solve: LinearSolve | SolveOfStages) -> LinearSolve:
    """The solver of a step's linear systems."""
    return solve.one_by_one() if isinstance(solve, SolveOfStages) else solve


def factorize_dense(jacobian: Float[Array, "n n"], gamma_h: Scalar) -> tuple[LinearSolve, Flag]:
    """The solver of (I - gamma h J) x = rhs by LU factors, and whether the matrix is regular.

    Args:
        jacobian: J [1/s], with the units of the state's components.
        gamma_h: gamma times the signed step [s].
    """
    return dense_solver(jnp.eye(jacobian.shape[0], dtype=jacobian.dtype) - gamma_h * jacobian)


def linearize_dense(
    rate: Callable[[Scalar, Vector], Vector], t: Scalar, y: Vector, tangents_per_pass: int
) -> tuple[Float[Array, "n n"], Vector]:
    """df/dy and df/dt at (t, y) by forward mode, `tangents_per_pass` directions at a time.

    For states of up to about 60 components one pass is fastest (40 components, one core: 7 us, against 16 us
    in passes of 8 and 29 us one by one); for larger ones the loop bounds the memory.
    """
    n = y.shape[0]
    # The directions are those of the state, and of time behind them.
    n_passes = -(-(n + 1) // tangents_per_pass)
    width = -(-(n + 1) // n_passes)
    # Rows beyond the last direction are zero, so that all passes have the same width.
    seeds = jnp.eye(n_passes * width, n + 1, dtype=y.dtype).reshape(n_passes, width, n + 1)

    def differentiate(seed: Float[Array, " m"]) -> Vector:
        return jax.jvp(rate, (t, y), (seed[-1].astype(t.dtype), seed[:-1]))[1]

    columns = lax.map(jax.vmap(differentiate), seeds).reshape(n_passes * width, n)
    return columns[:n].T, columns[n]


class RosenbrockInterpolation(AbstractLocalInterpolation):
    """The methods' own dense output, of order p - 1: a polynomial through both ends of the step.

    Its polynomial is written out in `rosenbrock_tableaus`.
    """

    t0: Scalar
    t1: Scalar
    y0: PyTree[ArrayLike]
    y1: PyTree[ArrayLike]
    bends: tuple[PyTree[ArrayLike], ...]
    """u_1, u_2, ...: states."""

    def evaluate(self, t0: ArrayLike, t1: ArrayLike | None = None, left: bool = True) -> PyTree[Array]:
        """The state at `t0`, or its increment from `t0` to `t1`."""
        del left
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        length = self.t1 - self.t0
        # A step of length zero occurs in lanes that have ended; its derivative must be finite as well.
        theta = jnp.where(length == 0.0, 0.0, (t0 - self.t0) / jnp.where(length == 0.0, 1.0, length))

        def interpolate(y0: Array, y1: Array, *bends: Array) -> Array:
            x = theta.astype(jnp.result_type(y0))
            # Horner's scheme; the factors x and 1 - x make the ends those of the step to the last bit.
            bend = bends[-1]
            for lower in reversed(bends[:-1]):
                bend = lower + x * bend
            return (1 - x) * y0 + x * (y1 + (1 - x) * bend)

        return jax.tree.map(interpolate, self.y0, self.y1, *self.bends)


class AbstractRosenbrock(AbstractAdaptiveSolver):
    """A stiffly accurate Rosenbrock method with dense output, for an `ODETerm` and any pytree state."""

    tableau: eqx.AbstractClassVar[RosenbrockTableau]
    jacobian: eqx.AbstractVar[Callable[[Scalar, PyTree, Any], tuple[Any, Array]] | None]
    factorize: eqx.AbstractVar[Callable[[Any, Scalar], tuple[Any, Flag]]]
    tangents_per_pass: eqx.AbstractVar[int]

    tolerates_inexact_jacobian: ClassVar[bool] = False
    """Whether the order holds with any matrix for the Jacobian and any vector for the derivative by time."""

    term_structure: ClassVar = ODETerm
    interpolation_cls: ClassVar = RosenbrockInterpolation

    def order(self, terms: ODETerm) -> int:
        """The order p. The error estimate then counts, as diffrax has it, as one of local order p."""
        return self.tableau.order

    def init(self, terms: ODETerm, t0: Scalar, t1: Scalar, y0: PyTree, args: Any) -> None:
        """A one-step method remembers nothing."""

    def func(self, terms: ODETerm, t0: Scalar, y0: PyTree, args: Any) -> PyTree:
        """The vector field at one point."""
        return terms.vf(t0, y0, args)

    def step(
        self,
        terms: ODETerm,
        t0: Scalar,
        t1: Scalar,
        y0: PyTree,
        args: Any,
        solver_state: None,
        made_jump: Flag,
    ) -> tuple[PyTree, PyTree, dict[str, PyTree], None, RESULTS]:
        """The state at `t1`, its error estimate, and what the dense output needs.

        A step whose matrix is singular, or in which a number overflows, has an infinite error estimate: an
        adaptive controller rejects it.
        """
        del solver_state, made_jump
        t0, t1 = jnp.asarray(t0), jnp.asarray(t1)
        # Linear algebra needs a vector; a user's state may be any pytree.
        y, unravel = ravel_pytree(y0)
        # The control of the term, not t1 - t0: it is negative where diffrax integrates backward in time.
        h = jnp.asarray(terms.contr(t0, t1)).astype(y.dtype)

        def rate(t: Scalar, y: Vector) -> Vector:
            return ravel_pytree(terms.vf(t, unravel(y), args))[0]

        # One matrix and one factorization serve all stages: that is what makes the method cheap.
        J, f_t = self._linearize(rate, t0, y, h, y0, args)
        solve, regular = self.factorize(J, self.tableau.gamma * h)
        # h and t1 - t0 differ in sign where diffrax integrates backward.
        slope = h * (t1 - t0).astype(y.dtype) * f_t
        # A mechanism's own systems take all stages in one call of machine code, where each call would pass its factors.
        if isinstance(solve, SolveOfStages):
            stages = solve.all_stages(self.tableau, t0, t1 - t0, h, y, slope)
        else:
            stages = Tableau.rosenbrock(self.tableau).stages(rate, t0, t1 - t0, h, y, solve=solve, slope=slope)

        y1, error, dense = step_from(self.tableau, stages, y, regular)
        dense = dict(y0=y0, y1=unravel(y1), bends=tuple(map(unravel, dense["bends"])))
        return unravel(y1), unravel(error), dense, None, RESULTS.successful

    def _linearize(
        self,
        rate: Callable[[Scalar, Vector], Vector],
        t0: Scalar,
        y: Vector,
        h: Scalar,
        y0: PyTree,
        args: Any,
    ) -> tuple[Any, Vector]:
        """J and df/dt0 at the start of the step."""
        if self.jacobian is None:
            return linearize_dense(rate, t0, y, self.tangents_per_pass)
        # diffrax integrates backward in time over t0 = -t, with a negative control.
        direction = jnp.sign(h)
        J, f_t = self.jacobian(direction.astype(t0.dtype) * t0, y0, args)
        return J, direction * f_t


def step_from(
    tableau: RosenbrockTableau, stages: Float[Array, "s *size"], y: Float[Array, "*size"], regular: Flag
) -> tuple[Array, Array, dict[str, Any]]:
    """The state at the end of a step, its error estimate, and what the dense output needs.

    Args:
        tableau: of the method.
        stages: all of them.
        y: state at the start.
        regular: whether they could be solved for.
    """
    y1 = y + combined(tableau.b, stages)
    # An infinite error has the step rejected and made again, shorter; of NaN a controller could make no size.
    valid = regular & jnp.all(jnp.isfinite(stages))
    error = jnp.where(valid, combined(tableau.e, stages), jnp.inf)
    return y1, error, dict(y0=y, y1=y1, bends=tuple(combined(row, stages) for row in tableau.H))


@final
class Rodas4P(AbstractRosenbrock):
    """Rodas4P: order 4(3), 6 stages, L-stable, dense output of order 3.

    For moderate accuracy, relative tolerances of about 1e-3 to 1e-6.

    Attributes:
        jacobian: None for forward-mode differentiation of the vector field, or a function (t, y, args) ->
            (J, f_t) called once a step with the time [s], the state as the vector field gets it, and its
            arguments. f_t = df/dt (zero if autonomous) is a vector in the order of
            `jax.flatten_util.ravel_pytree(y)`; J is whatever `factorize` understands, by default the (n, n)
            matrix of df_i/dy_j. It must be exact for the method's order, and differentiable if the solution
            is to be.
        factorize: Function (J, gamma_h) -> (solve, regular). `solve(rhs)` returns x with (I - gamma_h J) x =
            rhs, called once per stage, and differentiable if the solution is to be; `regular` is a boolean
            scalar, False to have the step rejected. Structure is exploited here: for q' = T(q) v, say, J may
            be a tuple of blocks and `solve` eliminate q. gamma_h is negative when integrating backward in
            time.
        tangents_per_pass: How many columns of the default Jacobian are computed together, at most.

    Source: Steinebach (1995), see `rosenbrock_tableaus`.
    """

    tableau: ClassVar[RosenbrockTableau] = RODAS4P

    jacobian: Callable[[Scalar, PyTree, Any], tuple[Any, Array]] | None = None
    factorize: Callable[[Any, Scalar], tuple[LinearSolve, Flag]] = factorize_dense
    tangents_per_pass: int = eqx.field(default=64, static=True)


@final
class Rodas5P(AbstractRosenbrock):
    """Rodas5P: order 5(4), 8 stages, L-stable, dense output of order 4.

    For high accuracy, relative tolerances of about 1e-5 and below.

    Attributes:
        jacobian: As for `Rodas4P`.
        factorize: As for `Rodas4P`.
        tangents_per_pass: As for `Rodas4P`.

    Source: Steinebach (2023), see `rosenbrock_tableaus`.
    """

    tableau: ClassVar[RosenbrockTableau] = RODAS5P

    jacobian: Callable[[Scalar, PyTree, Any], tuple[Any, Array]] | None = None
    factorize: Callable[[Any, Scalar], tuple[LinearSolve, Flag]] = factorize_dense
    tangents_per_pass: int = eqx.field(default=64, static=True)


@final
class Ros34PW2(AbstractRosenbrock):
    """ROS34PW2: a W-method of order 3(2), 4 stages, L-stable, dense output of order 2.

    For low accuracy, relative tolerances of about 1e-3 to 1e-5, and cheap approximations of the Jacobian.

    Attributes:
        jacobian: As for `Rodas4P`, but neither J nor f_t need be exact: the order holds with any, the stability where
            J has what is stiff.
        factorize: As for `Rodas4P`.
        tangents_per_pass: As for `Rodas4P`.

    Source: Rang & Angermann (2005), see `rosenbrock_tableaus`.
    """

    tableau: ClassVar[RosenbrockTableau] = ROS34PW2
    tolerates_inexact_jacobian: ClassVar[bool] = True

    jacobian: Callable[[Scalar, PyTree, Any], tuple[Any, Array]] | None = None
    factorize: Callable[[Any, Scalar], tuple[LinearSolve, Flag]] = factorize_dense
    tangents_per_pass: int = eqx.field(default=64, static=True)
