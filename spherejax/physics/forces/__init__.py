"""Force elements."""

from spherejax.physics.forces.applied import AppliedWrench
from spherejax.physics.forces.base import AbstractForce, Wrench

__all__ = ["AbstractForce", "AppliedWrench", "Wrench"]
