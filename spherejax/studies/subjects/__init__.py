"""The mechanisms whose joint models can be compared: one file for each."""

from collections.abc import Mapping

from spherejax.studies.subject import Subject
from spherejax.studies.subjects.four_bar import FOUR_BAR
from spherejax.studies.subjects.suspension import SUSPENSION

SUBJECTS: Mapping[str, Subject] = {subject.name: subject for subject in (FOUR_BAR, SUSPENSION)}
"""By their names on the command line."""

__all__ = ["FOUR_BAR", "SUBJECTS", "SUSPENSION"]
