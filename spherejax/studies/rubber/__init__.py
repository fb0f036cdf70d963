"""Rubber on a test stand: dynamic stiffness and loss angle over frequency and amplitude, and fits of them."""

from spherejax.studies.rubber.fitting import StiffnessFit, fit_stiffness
from spherejax.studies.rubber.stiffness import DynamicStiffness, dynamic_stiffness

__all__ = ["DynamicStiffness", "StiffnessFit", "dynamic_stiffness", "fit_stiffness"]
