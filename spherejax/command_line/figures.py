"""The figures of a comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spherejax.studies.subject import Comparison, Subject


def figures_of(comparison: Comparison) -> dict[str, Callable]:
    """Functions that draw the figures of the mechanism that was compared, by file name."""
    return comparison.subject.figures(comparison)


def figures_ahead(subject: Subject) -> dict[str, Callable]:
    """Those of them that need no run."""
    return {subject.numbered(name): draw for name, draw in subject.figures_ahead(subject).items()}
