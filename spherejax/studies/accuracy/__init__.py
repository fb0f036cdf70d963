"""What accuracy costs in time."""

from spherejax.studies.accuracy.accuracy_result import Row, WorkPrecision
from spherejax.studies.accuracy.reference import Reference
from spherejax.studies.accuracy.solvers import SOLVERS
from spherejax.studies.accuracy.study import work_precision

__all__ = ["SOLVERS", "Reference", "Row", "WorkPrecision", "work_precision"]
