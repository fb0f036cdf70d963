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
