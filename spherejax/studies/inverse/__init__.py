"""Forces from motions: inverse dynamics."""

from spherejax.studies.inverse.inverse_result import InverseDynamics, InverseWarning
from spherejax.studies.inverse.sampled_motion import SampledMotion
from spherejax.studies.inverse.study import inverse_dynamics

__all__ = ["InverseDynamics", "InverseWarning", "SampledMotion", "inverse_dynamics"]
