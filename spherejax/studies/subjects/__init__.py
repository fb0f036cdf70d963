"""The mechanisms whose joint models are compared: any, and the two of the paper, which have more to show."""

from spherejax.studies.subjects.four_bar import FOUR_BAR
from spherejax.studies.subjects.suspension import SUSPENSION

__all__ = ["FOUR_BAR", "SUSPENSION"]
