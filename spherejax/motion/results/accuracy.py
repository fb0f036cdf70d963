"""The accuracy that was asked of a run, read from what users write, and what came of it."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.units import in_si
from spherejax.model.system import System
from spherejax.motion.equations.quantities import quantity

POSITIONS = "positions"
"""Stands for the positions of all bodies among the names of quantities."""

Limits = tuple[tuple[str, float], ...]
"""Names of quantities, or `POSITIONS`, with the largest error that each may have, in its SI unit."""


class Accuracy(eqx.Module):
    """The accuracy that a run was asked for, and what came of it; prints as a sentence.

    Attributes:
        names: the quantities; `"positions"` are those of all bodies (static).
        units: their SI units (static).
        limits: largest errors allowed, shape (k,).
        errors: largest estimated errors over the samples, shape (k,).
        until: time until which all estimates are within their limits [s].
        rtol: relative tolerance of a step that was chosen.
        n_steps: steps of all runs that were made to choose it.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    limits: Float[Array | np.ndarray, " k"]
    errors: Float[Array | np.ndarray, " k"]
    until: Float[Array | np.ndarray, ""]
    rtol: Float[Array | np.ndarray, ""]
    n_steps: Any

    @property
    def pairs(self) -> Limits:
        """Names and limits."""
        return tuple(zip(self.names, map(float, np.asarray(self.limits)), strict=True))

    def __str__(self) -> str:
        if not is_concrete(self.until):
            return "accuracy (traced)"
        rows = zip(self.names, self.units, np.asarray(self.limits), np.asarray(self.errors), strict=True)
        told = ", ".join(f"{name} {error:.1e} of {limit:.1e} {unit}" for name, unit, limit, error in rows)
        return f"estimated errors: {told}, at rtol {float(self.rtol):.0e}; {int(self.n_steps):,} steps in all"


def limits_from(accuracy: Any, system: System) -> Limits:
    """What `accuracy=` asks for.

    Args:
        accuracy: a length for the positions of all bodies, "1 um" or a number [m]; or such by name of a quantity.
        system: what is simulated.

    Raises:
        SceneError: for a quantity that does not exist, a number of another dimension, or one that is not positive.
    """
    asked = accuracy if isinstance(accuracy, Mapping) else {POSITIONS: accuracy}
    if not asked:
        raise SceneError('accuracy = {} names no quantity; write e.g. "1 um" or {"position.rocker": "1 um"}')
    return tuple((name, _limit(name, value, system)) for name, value in asked.items())


def unit_of(name: str, system: System) -> str:
    """The SI unit of a quantity, or of the positions; empty where it is not known."""
    return "m" if name == POSITIONS else quantity(name, system).unit


def _limit(name: Any, value: Any, system: System) -> float:
    if not isinstance(name, str):
        raise SceneError(f"accuracy: {shown(name)} names no quantity; write e.g. 'position.rocker'")
    unit = unit_of(name, system)
    if name != POSITIONS and quantity(name, system).needs_work() and not system.tracks_work:
        raise SceneError(f"accuracy: {name!r} needs the work of the joints; pass track_work=True")
    if not is_concrete(value):
        raise SceneError(f"accuracy: {name!r} is traced; the accuracy decides how many runs are made. Give a number")
    if isinstance(value, str):
        # A unit of two kinds ("m or 1") is no dimension to check by.
        limit = in_si(value, unit if unit and " or " not in unit else None)
    elif isinstance(value, bool) or not isinstance(value, int | float | np.number):
        limit = _of_array(name, value, unit)
    else:
        limit = float(value)
    if not 0 < limit < np.inf:
        raise SceneError(f"accuracy: {name!r} = {limit:.3g} must be a positive {unit or 'number'}; e.g. 1e-6")
    return limit


def _of_array(name: str, value: Any, unit: str) -> float:
    if isinstance(value, bool) or np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iuf":
        raise SceneError(
            f'accuracy: {name!r} = {shown(value)} is no number; write e.g. "1 um", or a number [{unit or "1"}]'
        )
    return float(np.asarray(value))
