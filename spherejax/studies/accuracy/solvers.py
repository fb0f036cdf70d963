"""The solvers that are compared, by name; a program may add its own."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import diffrax

from spherejax.motion.solvers.rosenbrock import Rodas4P, Rodas5P, Ros34PW2

SolverOf = Callable[[float, float], diffrax.AbstractSolver]
"""Makes a solver from the relative and the absolute tolerance of a step (traced numbers)."""

SOLVERS: Mapping[str, diffrax.AbstractSolver | SolverOf] = MappingProxyType(
    {
        "Tsit5": diffrax.Tsit5(),
        "Dopri8": diffrax.Dopri8(),
        "Rodas4P": Rodas4P(),
        "Rodas5P": Rodas5P(),
        "Ros34PW2": Ros34PW2(),
        "Kvaerno5": diffrax.Kvaerno5(),  # `simulate` gives it a root finder that converges
    }
)
"""What is compared when nothing else is said: explicit, linearly implicit and implicit methods. Whether a scene is too
stiff for a method is not guessed: the budget of a run ends it."""


def made(solver: diffrax.AbstractSolver | SolverOf, rtol, atol) -> diffrax.AbstractSolver:
    """The solver for a tolerance."""
    return solver if isinstance(solver, diffrax.AbstractSolver) else solver(rtol, atol)
