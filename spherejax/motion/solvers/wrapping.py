"""A diffrax solver or step-size controller around another: what passes through unchanged."""

import math
from typing import Any

import diffrax
import equinox as eqx


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
        """As the wrapped controller's; any error where that judges none (`diffrax.StepTo`)."""
        return getattr(self.controller, "rtol", math.inf)

    @property
    def atol(self):
        """As the wrapped controller's; any error where that judges none."""
        return getattr(self.controller, "atol", math.inf)

    @property
    def norm(self):
        """As the wrapped controller's."""
        return self.controller.norm
