"""Which parameter matters when: derivatives of what is observed by every parameter, along time."""

from spherejax.studies.sensitivity.sensitivity_result import Influence, Sensitivities
from spherejax.studies.sensitivity.study import sensitivity

__all__ = ["Influence", "Sensitivities", "sensitivity"]
