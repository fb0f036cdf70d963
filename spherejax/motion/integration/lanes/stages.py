"""A trial step of a block of lanes. Arrays have their lanes on the last axis.

An explicit Runge-Kutta method evaluates its stages in one loop over all lanes, on contiguous vectors: `solver.step`
under `jax.vmap` gives each lane an axis in front and calls a matrix product for each stage, and takes twice as long.
Any other method is mapped as it is.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.compiler import ScalarProgram
from spherejax.compiler.runge_kutta import Tableau, explicit_stages
from spherejax.foundations.lanes import in_lanes
from spherejax.motion.integration.lanes.first_step import can_look
from spherejax.motion.integration.lanes.inside import extension
from spherejax.motion.solvers.dop853 import TwoErrors
from spherejax.motion.solvers.traits import defect_weights, is_explicit, n_stages_of_end


class TrialStep(NamedTuple):
    """A step that nobody has judged yet.

    Attributes:
        y: state at its end.
        error: estimate of its error; None of a method that makes none.
        dense_info: what the solver's interpolation is made from.
        solver_state: the solver's state at its end.
        result: whether the solver could make it, as `diffrax.RESULTS`; None where it always can.
        stage_defect: how far the last stage at the step's end, other than the end itself, is from it; None without one.
    """

    y: Array
    error: Array | None
    dense_info: dict[str, Any]
    solver_state: Any
    result: Any
    stage_defect: Array | None = None


def own_time(share: Array, bend: Array) -> Array:
    """x of a share of a step's time: the root of (1 - bend) x + bend x^2 = share, for bends from -1 to 1."""
    straight = 1 - bend
    root = straight + jnp.sqrt(jnp.maximum(straight * straight + 4 * bend * share, 0.0))
    return 2 * share / jnp.where(root > 0, root, 1.0)


class ExplicitStages:
    """Trial steps by the tableau of an explicit Runge-Kutta method.

    Of all `n_stages` the first `n_used` make the step and its error; the others are for states inside it.

    Args:
        tableau: of the method.
        rate: takes (t, y, parameters) of one lane.
        with_dense_output: whether states inside a step are wanted from the method's own interpolation.
        program: that `rate` evaluates inside, with the parameters' `theta` and `ahead`, or None. Of a state with rows
            below it the rates of these are the program's derivative, with the parameters' `slopes`.
        moving: entries of `theta` that have such slopes; None for all.
    """

    def __init__(
        self,
        tableau: diffrax.ButcherTableau,
        rate: Callable,
        with_dense_output: bool,
        program: ScalarProgram | None = None,
        moving: tuple[int, ...] | None = None,
    ):
        self.program, self.moving = program, moving
        # diffrax keeps a triangle row by row; here it is a matrix with a first row of zeros.
        every = explicit_tableau(tableau, len(tableau.b_sol), ())
        self.coefficients, self.instants = np.array(every.A), np.array(every.c)
        self.weights, self.error_weights = np.asarray(tableau.b_sol), np.asarray(tableau.b_error)
        self.n_used = n_used = n_stages_of_end(tableau)
        self.n_stages = len(self.weights) if with_dense_output else n_used
        # Polynomials for states inside a step are made from the stages of the step itself: no evaluation is added.
        self.inside = extension(self.coefficients[:n_used, :n_used], self.weights[:n_used])
        stage_defect = defect_weights(tableau)
        lower = tableau.b_lower if isinstance(tableau, TwoErrors) else None
        sums = [self.weights, self.error_weights, *(each for each in (lower, stage_defect) if each is not None)]
        self.tableau = explicit_tableau(tableau, self.n_stages, sums)
        self.has_two_errors = lower is not None
        self.can_look = can_look(self.coefficients, self.instants)
        self.rate = rate

    def init(self, t, t_next, y, parameters) -> tuple:
        """An explicit method carries nothing from step to step."""
        del t, t_next, y, parameters
        return ()

    def step(self, t, t_next, y, parameters, solver_state, made_jump, bend, n_evaluated=None) -> TrialStep:
        """All stages of all lanes, in a time of their own: t = t0 + h ((1 - bend) x + bend x^2).

        With `n_evaluated` only so many, which may be traced: then of the trial only their increments say something.
        """
        del solver_state, made_jump
        h, n = t_next - t, self.n_stages
        # Looks at the start need two stages, steps without a sample inside them not the last ones.
        n_made = n if n_evaluated is None else n_evaluated
        found = self._called(t, h, y, parameters, bend, n_made)
        # Array code, and programs that are differentiated: the stages are a loop of XLA.
        if found is None:
            rate = in_lanes(self.rate)
            k = self.tableau.stages(
                lambda t, y: rate(t, y, parameters), t, h, h, y, bend=bend, n_made=n_made, in_lanes=True
            )
            sums = self.tableau.sums_of(k)
        else:
            k, sums = found
        change, error, *others = sums
        if self.has_two_errors:
            error = TwoErrors.together(error, others.pop(0))
        # Sums over the stages come from the loop that makes them, while they are in the processor's cache.
        end = y + change
        return TrialStep(end, error, {"y0": y, "y1": end, "k": k}, (), None, *others)

    def nothing_made(self, t, y, *_) -> dict[str, Any]:
        """What states inside a step are made from, before there was one."""
        del t
        return {"y0": y, "y1": y, "k": jnp.zeros((self.n_stages, *y.shape))}

    def _called(self, t, h, y, parameters, bend, n_made) -> tuple[Array, Array] | None:
        """The increments of all stages and their sums by one call of machine code; None where there is none."""
        if self.program is None:
            return None
        # Rows below the state are tangents, which come with those of the numbers.
        slopes = (parameters.slopes.theta, parameters.slopes.ahead) if y.ndim == 3 else None
        given = parameters.theta, parameters.ahead
        return explicit_stages(self.program, self.tableau, t, h, bend, y, n_made, *given, slopes, self.moving)


class MappedSteps:
    """Trial steps by any diffrax solver, lane by lane."""

    def __init__(self, solver: diffrax.AbstractSolver, rate: Callable):
        self.solver = solver
        self.term = diffrax.ODETerm(rate)

    def init(self, t, t_next, y, parameters):
        """The solver's state of one lane."""
        return self.solver.init(self.term, t, t_next, y, parameters)

    def step(self, t, t_next, y, parameters, solver_state, made_jump, bend, n_evaluated=None) -> TrialStep:
        """One step of every lane."""
        del bend, n_evaluated

        def of_one(t, t_next, y, parameters, solver_state, made_jump):
            step: Any = self.solver.step(self.term, t, t_next, y, parameters, solver_state, made_jump)
            return TrialStep(*step)

        return in_lanes(of_one)(t, t_next, y, parameters, solver_state, made_jump)

    def nothing_made(self, t, y, parameters, solver_state, made_jump) -> Any:
        """What states inside a step are made from, before there was one."""
        # Only the forms are asked for; nothing is evaluated.
        made = jax.eval_shape(self.step, t, t, y, parameters, solver_state, made_jump, t)
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), made.dense_info)


def steps_of(
    solver: Any,
    rate: Callable,
    with_dense_output: bool,
    program: ScalarProgram | None = None,
    moving: tuple[int, ...] | None = None,
) -> ExplicitStages | MappedSteps:
    """How a solver makes the trial steps of a block; arguments as for `ExplicitStages`."""
    if is_explicit(solver):
        return ExplicitStages(solver.tableau, rate, with_dense_output, program, moving)
    return MappedSteps(solver, rate)


def explicit_tableau(tableau: diffrax.ButcherTableau, n: int, sums: Sequence[np.ndarray]) -> Tableau:
    """The coefficients of the first n stages, with weights of the wanted sums over them."""
    coefficients = np.zeros((len(tableau.b_sol), len(tableau.b_sol)))
    for i, row in enumerate(tableau.a_lower, start=1):
        coefficients[i, :i] = row
    return Tableau.explicit(coefficients[:n, :n], np.concatenate([[0.0], tableau.c])[:n], sums)
