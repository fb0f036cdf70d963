"""Linearization: state-space matrices, modes and frequency response of any mechanism about any of its states."""

from spherejax.studies.linear.linear_result import Linearization, LinearizationWarning
from spherejax.studies.linear.modes import Modes
from spherejax.studies.linear.study import linearize

__all__ = ["Linearization", "LinearizationWarning", "Modes", "linearize"]
