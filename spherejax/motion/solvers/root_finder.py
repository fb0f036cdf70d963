"""Root finders for diffrax's implicit methods that converge on stiff mechanisms."""

from typing import Any

import diffrax
import equinox as eqx
import numpy as np
import optimistix
from diffrax import AbstractSolver

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.types import Number

ROOT_FINDER_RATIO = 0.1
"""Tolerance of the iteration, relative and absolute, as a share of the step's relative one. It must lie below the
step's, or the noise of the iteration counts as error of the step, and above rounding: at a tenth of the step's absolute
tolerance the iteration never ends on a stiff bushing."""


def with_converging_root_finder(solver: AbstractSolver, rtol: Number) -> Any:
    """An implicit method with a chord iteration that converges below the step's tolerance.

    diffrax's default, `VeryChord` at the step's own tolerance, rejects steps of a mechanism because its noise counts as
    error. Only that default is replaced: a root finder that the user gave, with
    tolerances of its own, stays; so does any solver that has none.
    """
    if not isinstance(solver, diffrax.AbstractImplicitSolver):
        return solver
    finder: Any = solver.root_finder
    if not isinstance(finder, diffrax.VeryChord) or _is_number(finder.rtol):
        return solver
    tolerance: Any = ROOT_FINDER_RATIO * rtol
    return eqx.tree_at(lambda s: s.root_finder, solver, optimistix.Chord(rtol=tolerance, atol=tolerance))


def _is_number(value: Any) -> bool:
    """Whether a tolerance was given; diffrax's default is an object that stands for the controller's."""
    return not is_concrete(value) or isinstance(value, int | float | np.ndarray | np.generic)
