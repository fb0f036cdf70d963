"""What happens to the state at the end of a step: correction of drift, contact events, samples of force elements."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from spherejax.motion.integration.sampling import SampledElements
from spherejax.motion.solvers.landing import ContactFunctions, state_at_start


class StepEnd(NamedTuple):
    """The parts of it, each None where the system has none; all functions are of one run.

    The error estimate and the states inside a step stay those of the uncorrected one: between two steps they jump by
    the correction, which is of the size of the local error, so samples are corrected as well.

    Attributes:
        correct: drift control's correction (parameters, t, y).
        contacts: contacts whose onsets are located.
        samples: of force elements that sample.
    """

    correct: Callable | None
    contacts: ContactFunctions | None
    samples: SampledElements | None

    @property
    def no_onsets(self) -> Int[Array, " n_contacts"]:
        """Onsets of each contact before the first step."""
        return jnp.zeros(0 if self.contacts is None else self.contacts.n_contacts, jnp.int64)

    def changed(self, parameters: Any, t0, y0: Array, t1, y1: Array) -> tuple[Array, Bool[Array, " n_contacts"]]:
        """The state behind the end of a step from y0 to y1, and which contacts began there."""
        began = jnp.zeros(0, bool)
        if self.correct is not None:
            y1 = self.correct(parameters, t1, y1)
        if self.contacts is not None:
            y0 = state_at_start(self.contacts, parameters, t0, y0)
            y1 = self.contacts.update(parameters, t1, y0, y1)
            began = ~self.contacts.is_touching(y0) & self.contacts.is_touching(y1)
        if self.samples is not None:
            y1 = self.samples.update(parameters, t1, y1)
        return y1, began

    def sampled(self, parameters: Any, t, y: Array) -> Array:
        """A state inside a step as a sample: corrected, and behind the samples of force elements that are due there."""
        y = y if self.correct is None else self.correct(parameters, t, y)
        return y if self.samples is None else self.samples.update(parameters, t, y)
