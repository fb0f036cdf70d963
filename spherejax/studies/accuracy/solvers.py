"""The solvers that are compared, by name; a program may add its own."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import diffrax
import optimistix

from spherejax.motion.solvers.rosenbrock import Rodas4P, Rodas5P

SolverOf = Callable[[float, float], diffrax.AbstractSolver]
"""Makes a solver from the relative and the absolute tolerance of a step (traced numbers)."""

ROOT_FINDER_RATIO = 0.1
"""Tolerance of the root finder inside an implicit method, relative and absolute, as a share of the step's relative one.
It must lie below the step's, or the noise of the iteration counts as error of the step (diffrax's default, `VeryChord`
at the step's own tolerance, rejects more steps than it keeps), and above rounding: at a tenth of the step's absolute
tolerance the iteration never ends on a stiff bushing, and the step is rejected too."""


def kvaerno5(rtol: float, atol: float) -> diffrax.AbstractSolver:
    """Kvaerno5 with a chord iteration that converges below the step's tolerance."""
    del atol
    root_finder = optimistix.Chord(rtol=ROOT_FINDER_RATIO * rtol, atol=ROOT_FINDER_RATIO * rtol)
    return diffrax.Kvaerno5(root_finder=root_finder)


SOLVERS: Mapping[str, diffrax.AbstractSolver | SolverOf] = MappingProxyType(
    {
        "Tsit5": diffrax.Tsit5(),
        "Dopri8": diffrax.Dopri8(),
        "Rodas4P": Rodas4P(),
        "Rodas5P": Rodas5P(),
        "Kvaerno5": kvaerno5,
    }
)
"""What is compared when nothing else is said: explicit, linearly implicit and implicit methods. Whether a scene is too
stiff for a method is not guessed: the budget of a run ends it."""


def made(solver: diffrax.AbstractSolver | SolverOf, rtol, atol) -> diffrax.AbstractSolver:
    """The solver for a tolerance."""
    return solver if isinstance(solver, diffrax.AbstractSolver) else solver(rtol, atol)
