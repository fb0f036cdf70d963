"""A solver that corrects the state at the end of each step. It wraps any diffrax solver."""

from collections.abc import Callable

import diffrax
import equinox as eqx

from spherejax.motion.solvers.wrapping import AbstractForwardingSolver


class CorrectingSolver(AbstractForwardingSolver):
    """A solver that corrects the state after each step.

    The error estimate and the dense output stay those of the uncorrected step: between two steps the dense output
    jumps by the correction, which is of the size of the local error, so that samples are to be corrected as well. A
    method whose last stage is the first of the next step (FSAL) keeps the rate at the uncorrected end; that changes
    the next step by a fraction of the correction. To evaluate the rate anew costs a stage in thirteen, and changes
    the error of the four-bar by a few percent of itself: not worth it.

    Attributes:
        solver: the solver that makes the steps.
        correct: the corrected state; takes (parameters, t, y).
    """

    solver: diffrax.AbstractSolver
    correct: Callable = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """As the wrapped solver's."""
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step of the wrapped solver, then the correction."""
        y1, error, dense_info, state, result = self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        return self.correct(args, t1, y1), error, dense_info, state, result
