"""The figures of a comparison."""

from collections.abc import Callable

from spherejax.studies.subject import Comparison


def figures_of(comparison: Comparison) -> dict[str, Callable]:
    """Functions that draw the figures of the mechanism that was compared, by file name."""
    return comparison.subject.figures(comparison)
