"""Design: parameters that make a measure of a motion least, within limits, by gradients."""

from spherejax.studies.design.design_result import Design
from spherejax.studies.design.optimize import optimize
from spherejax.studies.design.peaks import smooth_peak

__all__ = ["Design", "optimize", "smooth_peak"]
