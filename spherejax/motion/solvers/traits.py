"""What a method of integration can do, by which everything else chooses its way."""

from typing import Any

import diffrax
import numpy as np

from spherejax.motion.solvers.rosenbrock import AbstractRosenbrock


def is_linearly_implicit(solver: Any) -> bool:
    """A Rosenbrock method of ours: one linear system a stage, in the structure of the mechanism."""
    return isinstance(solver, AbstractRosenbrock)


def is_explicit(solver: Any) -> bool:
    """An explicit Runge-Kutta method with one tableau: states inside its steps follow from that."""
    is_such = isinstance(solver, diffrax.AbstractERK)
    return is_such and isinstance(getattr(solver, "tableau", None), diffrax.ButcherTableau)


def n_stages_of_end(tableau: diffrax.ButcherTableau) -> int:
    """How many stages the end of an explicit step and its error need; those behind are for states inside it."""
    return 1 + max(int(np.flatnonzero(weights)[-1]) for weights in (tableau.b_sol, tableau.b_error))


def defect_weights(tableau: diffrax.ButcherTableau) -> np.ndarray | None:
    """Weights over the stages of how far the last stage at a step's end, other than the end itself, is from it.

    None of a method without such a stage.
    """
    weights = np.asarray(tableau.b_sol)
    rows = [np.append(row, np.zeros(len(weights) - len(row))) for row in tableau.a_lower]
    differences = [row - weights for row, c in zip(rows, tableau.c, strict=True) if c == 1]
    others = [difference for difference in differences if np.any(np.abs(difference) > 1e-12)]
    return others[-1] if others else None


def stage_defect(solver: Any, dense_info: Any) -> Any:
    """How far the stage of `defect_weights` is from the end of a step of an explicit method; None of other methods.

    Args:
        solver: the method, or one that wraps it.
        dense_info: of its step, with the increments `k` of its stages on the first axis.
    """
    while isinstance(solver, diffrax.AbstractWrappedSolver):
        solver = solver.solver
    weights = defect_weights(solver.tableau) if is_explicit(solver) else None
    if weights is None:
        return None
    k = dense_info["k"]
    return sum(weight * k[i] for i, weight in enumerate(weights) if weight)
