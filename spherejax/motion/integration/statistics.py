"""What a run cost."""

from dataclasses import fields

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.checks import is_concrete


class Statistics(eqx.Module):
    """What a run cost.

    Attributes:
        n_steps: steps tried.
        n_accepted: steps kept.
        n_rejected: steps repeated, for their error or to land on a contact onset or release.
        n_evaluations: evaluations of the right-hand side; without those for states inside explicit steps, and without
            the Newton iterations of an implicit method.
        n_onsets: contact onsets of each joint in the system's `contact_joints`, shape (n_contacts,).
        audit: of each of `audit.CHECKS` the worst that was found, as a share of what is allowed, one each: above 1
            the run has failed. `run.audit` says it in words.
        explanation: which method and which tolerances were used, and why (static).
    """

    n_steps: Int[Array, ""]
    n_accepted: Int[Array, ""]
    n_rejected: Int[Array, ""]
    n_evaluations: Int[Array, ""]
    n_onsets: Int[Array, " n_contacts"]
    audit: Float[Array, " n_checks"]
    explanation: str = eqx.field(static=True, default="")

    def __repr__(self) -> str:
        """The numbers, where they are known."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if not all(is_concrete(value) for value in values.values()):
            return super().__repr__()
        said = {name: repr(np.asarray(x).tolist()) for name, x in values.items() if not isinstance(x, str)}
        said["audit"] = "[" + ", ".join(f"{x:.2g}" for x in np.ravel(self.audit)) + "]"
        words = [*(f"{name}={value}" for name, value in said.items()), f"explanation={self.explanation!r}"]
        return f"Statistics({', '.join(words)})"
