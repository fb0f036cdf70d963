"""The mechanisms whose joint models can be compared: one file for each."""

from spherejax.studies.subjects.four_bar import FOUR_BAR
from spherejax.studies.subjects.suspension import SUSPENSION

__all__ = ["FOUR_BAR", "SUSPENSION"]
