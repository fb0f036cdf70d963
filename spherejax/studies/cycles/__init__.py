"""Periodic motions: their computation, stability, and continuation in a parameter."""

from spherejax.studies.cycles.branch_result import Branch
from spherejax.studies.cycles.continuation import continuation
from spherejax.studies.cycles.cycle_result import Cycle
from spherejax.studies.cycles.study import CycleWarning, steady_cycle
from spherejax.studies.cycles.swept_sine import SweptSine, swept_sine

__all__ = ["Branch", "Cycle", "CycleWarning", "SweptSine", "continuation", "steady_cycle", "swept_sine"]
