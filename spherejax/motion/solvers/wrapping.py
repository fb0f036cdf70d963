"""A diffrax solver or step-size controller around another: what passes through unchanged."""

from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array


class AbstractForwardingSolver(diffrax.AbstractWrappedSolver):
    """A solver that makes the steps of another one, and changes what is at their ends.

    Attributes:
        solver: the solver that makes the steps.
    """

    @property
    def term_structure(self):
        """As the wrapped solver's."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        """As the wrapped solver's."""
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self):
        """As the wrapped solver's."""
        return self.solver.term_compatible_contr_kwargs

    @property
    def root_finder(self):
        """As the wrapped solver's, if it is implicit."""
        solver: Any = self.solver
        return solver.root_finder

    @property
    def root_find_max_steps(self):
        """As the wrapped solver's, if it is implicit."""
        solver: Any = self.solver
        return solver.root_find_max_steps

    @property
    def scan_kind(self):
        """As the wrapped solver's, if it is a Runge-Kutta method."""
        return getattr(self.solver, "scan_kind", None)

    def order(self, terms):
        """As the wrapped solver's."""
        return self.solver.order(terms)

    def strong_order(self, terms):
        """As the wrapped solver's."""
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        """As the wrapped solver's."""
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        """As the wrapped solver's."""
        return self.solver.func(terms, t0, y0, args)


class AbstractForwardingController(diffrax.AbstractAdaptiveStepSizeController):
    """A step-size controller that leaves the judgment of errors to another one, its field `controller`."""

    controller: eqx.AbstractVar[Any]  # diffrax.AbstractAdaptiveStepSizeController

    @property
    def rtol(self):
        """As the wrapped controller's."""
        return self.controller.rtol

    @property
    def atol(self):
        """As the wrapped controller's."""
        return self.controller.atol

    @property
    def norm(self):
        """As the wrapped controller's."""
        return self.controller.norm


class StepBudget(AbstractForwardingController):
    """A step-size controller that ends the integration after a number of steps, which may be traced.

    `max_steps` of diffrax is part of the program; this budget is a number, so one program serves all budgets.

    Attributes:
        controller: the controller that judges errors.
        n_steps: largest number of steps tried.
    """

    controller: Any  # diffrax.AbstractAdaptiveStepSizeController
    n_steps: Array

    def wrap(self, direction):
        """Wrap the wrapped controller."""
        return StepBudget(self.controller.wrap(direction), self.n_steps)  # pyright: ignore[reportCallIssue]

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """The wrapped controller's first step."""
        first, inner = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return first, (inner, jnp.zeros((), jnp.int64))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The wrapped controller's judgment, and the end when the budget is spent."""
        inner, n_tried = controller_state
        *judgment, inner, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, inner
        )
        is_spent = (n_tried + 1 >= self.n_steps) & (result == diffrax.RESULTS.successful)
        result = diffrax.RESULTS.where(is_spent, diffrax.RESULTS.max_steps_reached, result)
        return *judgment, (inner, n_tried + 1), result
