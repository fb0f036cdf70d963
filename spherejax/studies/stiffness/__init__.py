"""How a mechanism at rest gives way to a load on one of its points."""

from spherejax.studies.stiffness.study import EndCompliance, end_compliance

__all__ = ["EndCompliance", "end_compliance"]
