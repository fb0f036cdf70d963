"""Cycles: motions that repeat themselves, their stability, and how they change with a number."""

from spherejax.studies.cycles.cycle_result import Cycle
from spherejax.studies.cycles.study import CycleWarning, steady_cycle

__all__ = ["Cycle", "CycleWarning", "steady_cycle"]
