"""Root finders for implicit methods that make their own steps: those of a user, and of diffrax with its adjoints."""

from typing import Any

import equinox as eqx
import optimistix
from diffrax import AbstractSolver

from spherejax.foundations.types import Number
from spherejax.motion.solvers.diagonally_implicit import has_default_root_finder, tableau_of

ROOT_FINDER_RATIO = 0.1
"""Tolerance of the iteration, relative and absolute, as a share of the step's relative one. It must lie below the
step's, or the noise of the iteration counts as error of the step, and above rounding: at a tenth of the step's absolute
tolerance the iteration never ends on a stiff bushing."""


def with_converging_root_finder(solver: AbstractSolver, rtol: Number, makes_own_steps: bool = False) -> Any:
    """An implicit method with a chord iteration that converges below the step's tolerance.

    diffrax's default, `VeryChord` at the step's own tolerance, rejects steps of a mechanism because its noise counts as
    error. Only that default is replaced: a root finder that the user gave, with tolerances of its own, stays; so does
    any solver that has none.

    Args:
        solver: a diffrax solver.
        rtol: relative tolerance of a step.
        makes_own_steps: whether diffrax makes the steps of methods that `diagonally_implicit` could make.
    """
    if not has_default_root_finder(solver) or (tableau_of(solver) is not None and not makes_own_steps):
        return solver
    tolerance: Any = ROOT_FINDER_RATIO * rtol
    return eqx.tree_at(lambda s: s.root_finder, solver, optimistix.Chord(rtol=tolerance, atol=tolerance))
