"""Steps whose ends are given, whatever their errors: `diffrax.StepTo` on a mechanism."""

from typing import Any

import diffrax
import jax.numpy as jnp
from jaxtyping import Array, Float


class GivenSteps(diffrax.AbstractStepSizeController):
    """Each step ends at the next of the given times.

    `diffrax.StepTo` counts its steps, and would leave out one of the times for each step that ends on a contact event;
    here a step goes to the first time that lies behind its start.

    Attributes:
        ts: ends of the steps [s], increasing.
    """

    ts: Float[Array, " n"]

    def wrap(self, direction):
        """Itself: time never goes back here."""
        del direction
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order) -> Any:
        """The end of the first step [s], and no state."""
        return self._next(t0), ()

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state) -> Any:
        """Every step is kept."""
        return jnp.array(True), t1, self._next(t1), jnp.array(False), (), diffrax.RESULTS.successful

    def _next(self, t):
        at = jnp.searchsorted(self.ts, t, side="right")
        return self.ts[jnp.minimum(at, self.ts.shape[0] - 1)]
