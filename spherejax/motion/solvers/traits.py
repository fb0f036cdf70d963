"""What a method of integration can do, by which everything else chooses its way."""

from typing import Any

import diffrax

from spherejax.motion.solvers.rosenbrock import AbstractRosenbrock


def is_linearly_implicit(solver: Any) -> bool:
    """A Rosenbrock method of ours: one linear system a stage, in the structure of the mechanism."""
    return isinstance(solver, AbstractRosenbrock)


def is_explicit(solver: Any) -> bool:
    """An explicit Runge-Kutta method with one tableau: states inside its steps follow from that."""
    return isinstance(solver, diffrax.AbstractERK) and isinstance(solver.tableau, diffrax.ButcherTableau)


def can_step_in_lanes(solver: Any) -> bool:
    """Whether our own loop can make its steps; others are made by diffrax."""
    return is_explicit(solver) or is_linearly_implicit(solver)
