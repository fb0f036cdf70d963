"""A solver whose steps are audited. It wraps any diffrax solver."""

import diffrax
import equinox as eqx
import jax

from spherejax.motion.integration.audit import Audit, Watch
from spherejax.motion.integration.status import AUDIT_RESULT
from spherejax.motion.solvers.wrapping import AbstractForwardingSolver


class AuditingSolver(AbstractForwardingSolver):
    """A solver that checks invariants at the end of each step, and ends the run where one is violated.

    Attributes:
        solver: the solver that makes the steps.
        audit: what is looked at.
    """

    solver: diffrax.AbstractSolver
    audit: Audit = eqx.field(static=True)

    def init(self, terms, t0, t1, y0, args):
        """The wrapped solver's state, and the audit of the start."""
        return self.solver.init(terms, t0, t1, y0, args), self.audit.begun(*jax.lax.stop_gradient((args, t0, y0)))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """A step of the wrapped solver, and its audit."""
        inner, watch = solver_state
        y1, error, dense_info, inner, result = self.solver.step(terms, t0, t1, y0, args, inner, made_jump)
        watch = self.audit.seen(*jax.lax.stop_gradient((args, watch, t1, y1)))
        is_wrong = ~watch.is_sound & (result == diffrax.RESULTS.successful)
        result = diffrax.RESULTS.where(is_wrong, AUDIT_RESULT, result)
        return y1, error, dense_info, (inner, watch), result


def of_audited(solver_state):
    """The final state of the wrapped solver, from that of an `AuditingSolver`."""
    return solver_state[0]


def watch_of(solver_state) -> Watch:
    """The audit, from the final state of an `AuditingSolver`."""
    return solver_state[1]
